"""The arithmetics in which a sum over neighbours can be evaluated: one formula, many numbers.

plain        float64, every sum folded in fixed order
compensated  float64, products and sums of the last step carried to twice the precision
bounded      either of these with a radius: a rigorous bound of everything that was rounded
extended     pairs of floats: terms and sums to about 31 digits
exact        50 digits and more, one target at a time

An arithmetic makes numbers from arrays, and knows lengths, sines, kernels, sums and linear
systems; the numbers know + − × themselves. Sums run over axis 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from sphtrunc import summation as sm
from sphtrunc.operators import eliminate
from sphtrunc.summation import TINY, UNIT, Array

if TYPE_CHECKING:
    from sphtrunc.kernel import Kernel

DIGITS = 60  # of the exact arithmetic
MOST_CONDITION = 1e12  # of a scaled correction matrix; beyond, less than four digits are left
SINE_ERROR = 4.0 * 2.0 * UNIT  # NumPy's sine and cosine: at most 4 units in the last place


class Arithmetic(Protocol):
    """What the experiment asks of an arithmetic."""

    def number(self, high: Any, low: Any = None, error: Any = None) -> Any: ...
    def length(self, s: list[Any]) -> Any: ...
    def directions(self, s: list[Any], q: Any) -> list[Any]: ...
    def sincos(self, x: Any) -> tuple[Any, Any]: ...
    def kernel(self, kernel: Kernel, q: Any, derivative: int, dim: int) -> Any: ...
    def total(self, x: Any) -> Any: ...
    def dot(self, x: Any, y: Any) -> Any: ...
    def ratio(self, x: Any, y: Any) -> Any: ...
    def drop(self, x: Any, where: Any) -> Any: ...
    def solve(self, matrix: Any, columns: Any, health: Health) -> Any: ...
    def value(self, x: Any) -> Array: ...


@dataclass(eq=False)
class Health:
    """Condition of the correction matrices met: the worst of each target, (T,)."""

    condition: Any = 0.0

    @property
    def singular(self) -> Any:
        """Targets whose matrix is too near to a singular one to be used."""
        return self.condition > MOST_CONDITION


# --------------------------------------------------------------------------------- float64


class Plain:
    """float64, folded sums."""

    def number(self, high: Any, low: Any = None, error: Any = None) -> Array:
        return np.asarray(high, dtype=np.float64)

    def length(self, s: list[Array]) -> Array:
        """|s|."""
        if len(s) == 1:
            return np.abs(s[0])
        return np.asarray(np.sqrt(sum(x * x for x in s)))

    def directions(self, s: list[Array], q: Array) -> list[Array]:
        """s/|s|, and 0 where s is 0."""
        return [np.sign(s[0])] if len(s) == 1 else [self.ratio(x, q) for x in s]

    def sincos(self, x: Array) -> tuple[Array, Array]:
        return np.sin(x), np.cos(x)

    def kernel(self, kernel: Kernel, q: Array, derivative: int, dim: int) -> Array:
        return _kernel(kernel, q, derivative, dim)

    def total(self, x: Array) -> Array:
        return sm.total(x)

    def dot(self, x: Array, y: Array) -> Array:
        return sm.total(x * y)

    def ratio(self, x: Array, y: Array) -> Array:
        """x/y, and 0 where y is 0."""
        return np.asarray(x / np.where(y == 0.0, np.inf, y))

    def drop(self, x: Array, where: Any) -> Array:
        return np.where(where, 0.0, x)

    def solve(self, matrix: Any, columns: Any, health: Health) -> Any:
        """The systems of all targets; where one is singular, something finite."""
        a, b = _stacked(matrix), _stacked(columns)
        return _rows(_Scaled(a, health).solve(b))

    def value(self, x: Any) -> Array:
        return np.asarray(x, dtype=np.float64)


class _Scaled:
    """Inverses of matrices (T, n, n) by singular values, after scaling rows and columns to 1."""

    def __init__(self, a: Array, health: Health) -> None:
        size = np.abs(a)
        row = _inverse_size(size.max(axis=2))
        column = _inverse_size((size * row[:, :, None]).max(axis=1))
        scaled = a * row[:, :, None] * column[:, None, :]
        u, values, v = np.linalg.svd(scaled)
        least = values[:, -1]
        positive = least > 0.0
        condition = np.where(positive, values[:, 0] / np.where(positive, least, 1.0), np.inf)
        health.condition = np.maximum(health.condition, condition)
        bad = condition > MOST_CONDITION
        values = np.where(bad[:, None], 1.0, values)
        self.left = u.swapaxes(1, 2) * row[:, None, :]  # (T, n, n)
        self.values = values
        self.right = v.swapaxes(1, 2) * column[:, :, None]

    def solve(self, b: Array) -> Array:
        """(T, n, k) -> (T, n, k)."""
        return np.asarray(self.right @ ((self.left @ b) / self.values[:, :, None]))

    def inverse(self) -> Array:
        """(T, n, n)."""
        return np.asarray(self.right @ (self.left / self.values[:, :, None]))


def _inverse_size(x: Array) -> Array:
    """1/x, or 0 where there is next to nothing."""
    return np.asarray(np.where(x > 1e-290, 1.0 / np.maximum(x, 1e-290), 0.0))


def _stacked(rows: Any) -> Array:
    """A list of rows of numbers or arrays (T,) as one array (T, n, k)."""
    shape = np.broadcast_shapes(*(np.shape(x) for row in rows for x in row), (1,))
    out = np.empty((*shape, len(rows), len(rows[0])))
    for i, row in enumerate(rows):
        for j, x in enumerate(row):
            out[..., i, j] = x
    return out


def _rows(x: Array) -> list[list[Array]]:
    return [[x[:, i, j] for j in range(x.shape[2])] for i in range(x.shape[1])]


class Compensated(Plain):
    """float64, sums and products of the last step compensated."""

    def total(self, x: Array) -> Array:
        high, low = sm.compensated_total(x)
        return np.asarray(high + low)

    def dot(self, x: Array, y: Array) -> Array:
        return sm.compensated_dot(*np.broadcast_arrays(x, y))


def _kernel(kernel: Kernel, q: Array, derivative: int, dim: int) -> Array:
    if derivative < 3:
        return np.asarray((kernel.w, kernel.dw, kernel.d2w)[derivative](q, dim), dtype=np.float64)
    from sphtrunc.evaluation import evaluate, tabulate

    return np.asarray(evaluate(tabulate(kernel, dim, derivative), q), dtype=np.float64)


# --------------------------------------------------------------------------------- with a bound


class Ball:
    """All numbers middle + Σ_i parts_i ε_i + rest·ε with |ε| <= 1 (affine arithmetic: Stolfi & de
    Figueiredo 1997). Each sum over neighbours has an ε_i of its own, so that what the coefficients
    of a correction take from it and what the moments take from it can cancel. The middles are what
    plain arithmetic gives; radii are rounded themselves, for which SLACK makes up."""

    __array_ufunc__ = None
    __slots__ = ("middle", "parts", "rest")

    def __init__(self, middle: Any, rest: Any, parts: Mapping[int, Any] | None = None) -> None:
        self.middle, self.rest, self.parts = middle, rest, parts or {}

    @property
    def radius(self) -> Any:
        """The largest distance from the middle."""
        return sum((np.abs(c) for c in self.parts.values()), self.rest)

    def __add__(self, other: Any) -> Ball:
        if isinstance(other, int) and other == 0:
            return self
        other = _ball(other)
        middle = self.middle + other.middle
        parts = dict(self.parts)
        for i, c in other.parts.items():
            parts[i] = parts[i] + c if i in parts else c
        return Ball(middle, self.rest + other.rest + UNIT * np.abs(middle), parts)

    __radd__ = __add__

    def __neg__(self) -> Ball:
        return Ball(-self.middle, self.rest, {i: -c for i, c in self.parts.items()})

    def __sub__(self, other: Any) -> Ball:
        return self.__add__(-_ball(other))

    def __rsub__(self, other: Any) -> Ball:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Ball:
        if isinstance(other, int) and other in (1, 2, -1, -2):
            parts = {i: c * other for i, c in self.parts.items()}
            return Ball(self.middle * other, self.rest * abs(other), parts)
        other = _ball(other)
        middle = self.middle * other.middle
        rest = np.abs(self.middle) * other.rest + np.abs(other.middle) * self.rest
        rest = rest + self.radius * other.radius + UNIT * np.abs(middle) + TINY
        parts = {i: c * other.middle for i, c in self.parts.items()}
        for i, c in other.parts.items():
            parts[i] = parts[i] + self.middle * c if i in parts else self.middle * c
        return Ball(middle, rest, parts)

    __rmul__ = __mul__


_symbols = count()


def _fresh(middle: Any, radius: Any) -> Ball:
    """A ball with an ε of its own."""
    return Ball(middle, np.zeros_like(radius), {next(_symbols): radius})


SLACK = 1.0 + 1e-9

#: Extended arithmetic errs by less than this part of the radius of a ball: each of its operations
#: to 2^-102 instead of 2^-53, for which series, Horner's rule and refinement leave 2^29
FINER = 2.0**-20


def _ball(x: Any) -> Ball:
    return (
        x if isinstance(x, Ball) else Ball(np.asarray(x, dtype=np.float64), np.zeros(np.shape(x)))
    )


@dataclass(frozen=True)
class Bounded:
    """Balls around the numbers of `base`."""

    base: Plain

    def number(self, high: Any, low: Any = None, error: Any = None) -> Ball:
        middle = np.asarray(high, dtype=np.float64)
        radius = np.zeros_like(middle) if error is None else np.broadcast_to(error, middle.shape)
        return Ball(middle, radius)

    def length(self, s: list[Ball]) -> Ball:
        """|s|: off by at most the length of the radii, and by the roundings of the formula."""
        middle = self.base.length([x.middle for x in s])
        if len(s) == 1:
            return Ball(middle, s[0].radius)
        radius = np.sqrt(sum(x.radius * x.radius for x in s))
        return Ball(middle, radius * SLACK + (0.5 * len(s) + 1.5) * UNIT * middle)

    def directions(self, s: list[Ball], q: Ball) -> list[Ball]:
        """Whatever the error, components of a unit vector are off by 2 at most."""
        if len(s) == 1:
            sure = np.abs(s[0].middle) > s[0].radius
            sure |= (s[0].middle == 0.0) & (s[0].radius == 0.0)
            return [Ball(np.sign(s[0].middle), np.where(sure, 0.0, 2.0))]
        found = [self.ratio(x, q) for x in s]
        return [Ball(e.middle, np.minimum(e.radius, 2.0)) for e in found]

    def sincos(self, x: Ball) -> tuple[Ball, Ball]:
        sine, cosine = self.base.sincos(x.middle)
        return (
            Ball(sine, SINE_ERROR * np.abs(sine) + np.minimum(x.radius, 2.0)),
            Ball(cosine, SINE_ERROR * np.abs(cosine) + np.minimum(x.radius, 2.0)),
        )

    def kernel(self, kernel: Kernel, q: Ball, derivative: int, dim: int) -> Ball:
        """The rounding of the evaluation, and the slope times the radius of q."""
        value = self.base.kernel(kernel, q.middle, derivative, dim)
        own = (8.0 if kernel.degree > 11 else 4.0) * SLACK * UNIT * np.abs(value) + TINY
        right = q.middle + q.radius * SLACK
        left = np.maximum(q.middle - q.radius * SLACK, 0.0)
        slope = np.maximum(
            np.abs(_kernel(kernel, left, derivative + 1, dim)),
            np.abs(_kernel(kernel, right, derivative + 1, dim)),
        )
        curvature = _largest(kernel, derivative + 2, dim)
        own = own + 2.0**-77 * _largest(kernel, derivative, dim)  # for pairs: see FINER
        radius = own + q.radius * (slope * SLACK + 2.0 * curvature * q.radius)
        if _jumps(kernel, derivative):
            ends = (_kernel(kernel, left, derivative, dim), _kernel(kernel, right, derivative, dim))
            radius = radius + sum(np.abs(end - value) for end in ends)
        if _jumps(kernel, derivative + 1):  # the larger slope may be on the other side of the knot
            middle = np.abs(_kernel(kernel, q.middle, derivative + 1, dim))
            radius = radius + q.radius * middle
        return Ball(value, radius)

    def total(self, x: Ball) -> Ball:
        value = self.base.total(x.middle)
        if isinstance(self.base, Compensated):
            size = sm.total(np.abs(x.middle)) * SLACK
            error = sm.compensated_dot_error(x.middle.shape[0], value, size)
        else:
            error = sm.total_error(x.middle)
        return _fresh(value, sm.total(x.radius) + error)

    def dot(self, x: Ball, y: Ball) -> Ball:
        if not isinstance(self.base, Compensated):
            return self.total(x * y)
        a, b, r, s = np.broadcast_arrays(x.middle, y.middle, x.radius, y.radius)
        value = self.base.dot(a, b)
        size = sm.total(np.abs(a * b)) * SLACK
        carried = sm.total(np.abs(a) * s + np.abs(b) * r + r * s)
        return _fresh(value, carried + sm.compensated_dot_error(a.shape[0], value, size))

    def ratio(self, x: Ball, y: Ball) -> Ball:
        """x/y, and 0 where y is exactly 0."""
        zero = (y.middle == 0.0) & (y.radius == 0.0)
        middle = self.base.ratio(x.middle, y.middle)
        least = np.maximum(np.abs(y.middle) - y.radius * SLACK, 0.0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            radius = (x.radius + np.abs(middle) * y.radius) / least + UNIT * np.abs(middle) + TINY
        return Ball(middle, np.where(zero, 0.0, np.where(least > 0.0, radius, np.inf)))

    def drop(self, x: Ball, where: Any) -> Ball:
        return Ball(np.where(where, 0.0, x.middle), np.where(where, 0.0, x.radius))

    def solve(self, matrix: Any, columns: Any, health: Health) -> Any:
        """For every A' and B' in the balls A and B: A'(X' − X) = B' − A'X. With R near the inverse
        the part of it that is linear in the ε_i is R(B_i − A_i X); all else is at most
        |R||rest| + e/(1 − e) max |R||B' − A'X| where ‖I − RA'‖ <= e < 1 in the row-sum norm (Rump
        2010, doi:10.1017/S096249291000005X, section 10)."""
        matrix = [[_ball(x) for x in row] for row in matrix]
        columns = [[_ball(x) for x in row] for row in columns]
        a, b = _stacked(_each(matrix, "middle")), _stacked(_each(columns, "middle"))
        ra, rb = _stacked(_each(matrix, "rest")), _stacked(_each(columns, "rest"))
        wide = _stacked(_each(matrix, "radius"))
        scaled = _Scaled(a, health)
        x, inverse = scaled.solve(b), scaled.inverse()
        n = a.shape[1]
        gamma = sm.gamma(2 * n + 4)
        rounding = np.abs(b - a @ x) + gamma * (np.abs(b) + np.abs(a) @ np.abs(x))
        rest = np.abs(inverse) @ (rounding + rb + ra @ np.abs(x))
        parts, linear = {}, np.zeros_like(rest)
        for i in dict.fromkeys(i for row in (*matrix, *columns) for one in row for i in one.parts):
            moved = _stacked([[one.parts.get(i, 0.0) for one in row] for row in columns])
            moved = moved - _stacked([[one.parts.get(i, 0.0) for one in row] for row in matrix]) @ x
            parts[i] = inverse @ moved
            linear += np.abs(parts[i])
        off = np.abs(np.eye(n) - inverse @ a) + gamma * (np.eye(n) + np.abs(inverse) @ np.abs(a))
        e = (off + np.abs(inverse) @ wide).sum(axis=2).max(axis=1) * SLACK
        safe = np.where(e < 1.0, e, 0.0)
        spread = (safe / (1.0 - safe))[:, None, None] * (rest + linear).max(axis=1, keepdims=True)
        radius = np.where((e < 1.0)[:, None, None], (rest + spread) * SLACK, np.inf)
        return [
            [
                Ball(x[:, i, j], radius[:, i, j], {k: c[:, i, j] for k, c in parts.items()})
                for j in range(x.shape[2])
            ]
            for i in range(n)
        ]

    def value(self, x: Any) -> Array:
        return self.base.value(_ball(x).middle)


def _each(rows: Any, name: str) -> Any:
    return [[getattr(x, name) for x in row] for row in rows]


@lru_cache(maxsize=128)
def _largest(kernel: Kernel, derivative: int, dim: int) -> float:
    """A bound of |σ w^(derivative)|: Σ|terms| of each piece about its ends."""
    from sympy import Abs

    sigma = float(kernel.normalisation(dim))
    most = 0.0
    for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.pieces, strict=False):
        for end in (a, b):
            local = piece.diff((piece.gen, derivative)).shift(end)
            most = max(most, float(sum(Abs(c) * (b - a) ** n for (n,), c in local.terms())))
    return abs(sigma) * most * SLACK


@lru_cache(maxsize=128)
def _jumps(kernel: Kernel, derivative: int) -> bool:
    """Does the derivative jump at a knot other than the origin?"""
    return any(jump != 0 for knot, jump in kernel.jumps(derivative).items() if knot != 0)


# --------------------------------------------------------------------------------- double-double


@dataclass(frozen=True, eq=False)
class Pair:
    """The unevaluated sum of two floats."""

    high: Any
    low: Any
    __array_ufunc__ = None

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
        if _jumps(kernel, derivative):  # the mean of both sides
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
        scaled = _Scaled(_stacked([[self.value(x) for x in row] for row in matrix]), health)
        rest, x = columns, None
        for _ in range(4):
            step = _rows(scaled.solve(_stacked([[self.value(r) for r in row] for row in rest])))
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
        _Scaled(_stacked([[float(x) for x in row] for row in matrix]), health)
        if np.any(health.singular):
            raise ValueError("correction: the correction matrix is singular to working precision")
        return eliminate(matrix, columns)

    def value(self, x: Any) -> Array:
        return np.asarray(x, dtype=np.float64)


PRECISIONS = ("plain", "compensated", "extended", "exact")


def arithmetic(precision: str, bound: bool = False) -> Any:
    """The arithmetic of a precision level, with a bound if asked for."""
    made: dict[str, Any] = {
        "plain": Plain(),
        "compensated": Compensated(),
        "extended": Extended(),
        "exact": Exact(),
    }
    if precision not in made:
        raise ValueError(f"precision: got {precision!r}, expected one of {', '.join(PRECISIONS)}")
    if not bound:
        return made[precision]
    if precision not in ("plain", "compensated"):
        raise ValueError(f"bound: bounds the precisions plain and compensated, not {precision}")
    return Bounded(made[precision])
