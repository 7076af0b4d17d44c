"""More digits than a float has: pairs of floats, and numbers of sixty digits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc import summation as sm
from sphtrunc.arithmetic import Health, Scaled, jumps_anywhere, stacked, unstacked
from sphtrunc.elimination import eliminate
from sphtrunc.summation import Array

if TYPE_CHECKING:
    from sphtrunc.kernel import Kernel

DIGITS = 60  # of the exact arithmetic


@dataclass(frozen=True, eq=False)
class Pair:
    """The unevaluated sum of two floats."""

    high: Any
    low: Any
    __array_ufunc__ = None

    def __getitem__(self, rows: Any) -> Pair:
        return Pair(self.high[rows], self.low[rows])

    def __add__(self, other: Any) -> Pair:
        other = _pair(other)
        return Pair(*sm.dd_add((self.high, self.low), (other.high, other.low)))

    __radd__ = __add__

    def __neg__(self) -> Pair:
        return Pair(-self.high, -self.low)

    def __sub__(self, other: Any) -> Pair:
        return self.__add__(-_pair(other))

    def __rsub__(self, other: Any) -> Pair:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Pair:
        other = _pair(other)
        return Pair(*sm.dd_mul((self.high, self.low), (other.high, other.low)))

    __rmul__ = __mul__


def _pair(x: Any) -> Pair:
    return x if isinstance(x, Pair) else Pair(*sm.dd(x))


class Extended:
    """Pairs of floats; kernels by Horner's rule from coefficients to twice the precision."""

    def number(self, high: Any, low: Any = None, error: Any = None) -> Pair:
        high = np.asarray(high, dtype=np.float64)
        return Pair(high, np.zeros_like(high) if low is None else np.asarray(low))

    def length(self, s: list[Pair]) -> Pair:
        square = sum((x * x for x in s[1:]), s[0] * s[0])
        return Pair(*sm.dd_sqrt((square.high, square.low)))

    def directions(self, s: list[Pair], q: Pair) -> list[Pair]:
        return [self.ratio(x, q) for x in s]

    def sincos(self, x: Pair) -> tuple[Pair, Pair]:
        """Taylor's series of x/2^8, then doubled eight times: sin 2y = 2 sin y cos y and
        1 − cos 2y = 2 sin² y keep the small parts."""
        y = x * 2.0**-8
        square = y * y
        sine, versine = Pair(*sm.dd(0.0)), Pair(*sm.dd(0.0))
        for n in range(12, 0, -1):  # |y| < 0.1 for |x| < 25: the rest is below 2^-110
            sine = (1.0 + -1.0 * sine) * square * _inverse((2 * n) * (2 * n + 1))
            versine = (1.0 + -1.0 * versine) * square * _inverse((2 * n + 1) * (2 * n + 2))
        sine = y * (1.0 - sine)
        versine = square * _inverse(2) * (1.0 - versine)
        for _ in range(8):
            sine, versine = 2.0 * sine * (1.0 - versine), 2.0 * (sine * sine)
        return sine, 1.0 - versine

    def kernel(self, kernel: Kernel, q: Pair, derivative: int, dim: int) -> Pair:
        high = np.zeros_like(q.high)
        low = np.zeros_like(q.high)
        ends = _expansions(kernel, derivative, dim)
        place = np.searchsorted([float(end[0]) for end, _ in ends], q.high, side="left")
        for piece, (end, coefficients) in enumerate(ends):
            here = np.nonzero(place == piece)
            if not here[0].size:
                continue
            t = Pair(*end) - Pair(q.high[here], q.low[here])
            high[here], low[here] = _horner(coefficients, t)
        if jumps_anywhere(kernel, derivative):  # the mean of both sides
            for (end, rows), (_, beyond) in zip(ends, [*ends[1:], (None, [])], strict=True):
                here = np.nonzero((q.high == end[0]) & (q.low == end[1]))
                if here[0].size:
                    t = Pair(*end) - Pair(q.high[here], q.low[here])
                    left = Pair(*_horner(rows, t))
                    right = _pair(np.zeros_like(left.high))
                    if beyond:
                        after = ends[[e[0] for e in ends].index(end) + 1][0]
                        right = Pair(*_horner(beyond, t + (Pair(*after) - Pair(*end))))
                    mean = (left + right) * 0.5
                    high[here], low[here] = mean.high, mean.low
        return Pair(high, low)

    def total(self, x: Pair) -> Pair:
        return Pair(*sm.dd_total((x.high, x.low)))

    def dot(self, x: Pair, y: Pair) -> Pair:
        return self.total(x * y)

    def ratio(self, x: Pair, y: Pair) -> Pair:
        zero = y.high == 0.0
        safe = Pair(np.where(zero, 1.0, y.high), y.low)
        return self.drop(Pair(*sm.dd_div((x.high, x.low), (safe.high, safe.low))), zero)

    def drop(self, x: Pair, where: Any) -> Pair:
        return Pair(np.where(where, 0.0, x.high), np.where(where, 0.0, x.low))

    def solve(self, matrix: Any, columns: Any, health: Health) -> Any:
        """Refined twice from residuals in pairs: each step gains the digits of a float solution."""
        scaled = Scaled(stacked([[self.value(x) for x in row] for row in matrix]), health)
        rest, x = columns, None
        for _ in range(4):
            step = unstacked(scaled.solve(stacked([[self.value(r) for r in row] for row in rest])))
            moved = [[_pair(c) for c in row] for row in step]
            x = (
                moved
                if x is None
                else [
                    [a + b for a, b in zip(p, q, strict=True)]
                    for p, q in zip(x, moved, strict=True)
                ]
            )
            rest = [
                [
                    b - sum((a * x[k][j] for k, a in enumerate(row)), _pair(0.0))
                    for j, b in enumerate(right)
                ]
                for row, right in zip(matrix, columns, strict=True)
            ]
        return x

    def value(self, x: Any) -> Array:
        x = _pair(x)
        return np.asarray(x.high + x.low)

    def rest(self, x: Any) -> Array:
        """The low part."""
        return np.asarray(_pair(x).low)


def _horner(coefficients: Any, t: Pair) -> tuple[Any, Any]:
    value = _pair(np.zeros_like(t.high))
    for c in coefficients:
        value = value * t + Pair(*c)
    return value.high, value.low


@lru_cache(maxsize=64)
def _inverse(n: int) -> Pair:
    high, low = sm.dd_from_ratio(1, n)
    return Pair(np.array(high), np.array(low))


@lru_cache(maxsize=64)
def _expansions(kernel: Kernel, derivative: int, dim: int) -> Any:
    """Per piece: the outer end, and the coefficients in t = end − q, highest first, as pairs."""
    from mpmath import mp, workdps

    def pair(x: Any) -> tuple[Any, Any]:
        high = float(x)
        return np.array(high), np.array(float(x - high))

    rows = []
    with workdps(DIGITS):
        sigma = _mp_normalisation(kernel, dim)
        for end, piece in zip(kernel.knots[1:], kernel.pieces, strict=True):
            local = piece.diff((piece.gen, derivative)).shift(end).all_coeffs()
            degree = len(local) - 1
            rows.append(
                (
                    pair(mp.mpf(int(end.p)) / int(end.q)),
                    [
                        pair(sigma * (-1) ** (degree - i) * mp.mpf(int(c.p)) / int(c.q))
                        for i, c in enumerate(local)
                    ],
                )
            )
    return rows


def _mp_normalisation(kernel: Kernel, dim: int) -> Any:
    """σ_d from its exact value, a rational or a rational over π."""
    from mpmath import mp
    from sympy import pi

    exact = kernel.normalisation(dim) * (1 if dim == 1 else pi)
    return mp.mpf(int(exact.p)) / int(exact.q) / (1 if dim == 1 else mp.pi)


# --------------------------------------------------------------------------------- exact


class Exact:
    """Object arrays of mpmath numbers; to be used inside ``mpmath.workdps(DIGITS)``."""

    def number(self, high: Any, low: Any = None, error: Any = None) -> Any:
        from mpmath import mp

        def convert(x: Any) -> Any:
            if hasattr(x, "numerator") and not isinstance(x, (int, float)):
                return mp.mpf(int(x.numerator)) / int(x.denominator)
            return mp.mpf(x)

        return np.frompyfunc(convert, 1, 1)(np.asarray(high, dtype=object))

    def length(self, s: list[Any]) -> Any:
        from mpmath import mp

        if len(s) == 1:
            return np.abs(s[0])
        return np.frompyfunc(mp.sqrt, 1, 1)(sum(x * x for x in s))

    def directions(self, s: list[Any], q: Any) -> list[Any]:
        return [self.ratio(x, q) for x in s]

    def sincos(self, x: Any) -> tuple[Any, Any]:
        from mpmath import mp

        return np.frompyfunc(mp.sin, 1, 1)(x), np.frompyfunc(mp.cos, 1, 1)(x)

    def kernel(self, kernel: Kernel, q: Any, derivative: int, dim: int) -> Any:
        """The exact polynomials; the mean of both sides at a knot, but at 0 the limit."""
        from mpmath import mp

        sigma = _mp_normalisation(kernel, dim)
        knots = [mp.mpf(int(k.p)) / int(k.q) for k in kernel.knots]
        rows = [
            [mp.mpf(int(c.p)) / int(c.q) for c in p.diff((p.gen, derivative)).all_coeffs()]
            for p in kernel.pieces
        ]

        def one(x: Any) -> Any:
            sides = [
                mp.polyval(row, x)
                for a, b, row in zip(knots, knots[1:], rows, strict=False)
                if a <= x <= b
            ]
            if not sides:
                return mp.mpf(0)
            if x in knots[1:] and len(sides) == 1:
                sides.append(mp.mpf(0))
            return sigma * sum(sides) / len(sides)

        return np.frompyfunc(one, 1, 1)(q)

    def total(self, x: Any) -> Any:
        return np.asarray(x, dtype=object).sum(axis=0)

    def dot(self, x: Any, y: Any) -> Any:
        return self.total(x * y)

    def ratio(self, x: Any, y: Any) -> Any:
        return np.frompyfunc(lambda a, b: a / b if b else b, 2, 1)(x, y)

    def drop(self, x: Any, where: Any) -> Any:
        return np.where(where, self.number(0), x)

    def solve(self, matrix: Any, columns: Any, health: Health) -> Any:
        """Elimination, after the condition has been looked at."""
        Scaled(stacked([[self.value(x) for x in row] for row in matrix]), health)
        if np.any(health.singular):
            raise ValueError("correction: the correction matrix is singular to working precision")
        return eliminate(matrix, columns)

    def value(self, x: Any) -> Array:
        return np.asarray(x, dtype=np.float64)

    def rest(self, x: Any) -> Array:
        """What the nearest floats leave."""
        return np.asarray(x - self.number(self.value(x)), dtype=np.float64)
