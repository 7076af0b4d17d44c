"""The arithmetics in which a sum over neighbours can be evaluated: one formula, many numbers.

plain        float64, every sum folded in fixed order
compensated  float64, products and sums of the last step carried to twice the precision
bounded      either of these with a radius: a rigorous bound of everything that was rounded
extended     pairs of floats: terms and sums to about 31 digits
exact        50 digits and more, one target at a time

An arithmetic makes numbers from arrays, and knows square roots, sines, kernels, sums and linear
systems; the numbers know + − × themselves. Sums run over axis 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
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
    def sqrt(self, x: Any) -> Any: ...
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

    def sqrt(self, x: Array) -> Array:
        return np.asarray(np.sqrt(x))

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
        row = size.max(axis=2)
        row = 1.0 / np.where(row > 0.0, row, 1.0)
        column = (size * row[:, :, None]).max(axis=1)
        column = 1.0 / np.where(column > 0.0, column, 1.0)
        scaled = a * row[:, :, None] * column[:, None, :]
        u, values, v = np.linalg.svd(scaled)
        least = values[:, -1]
        condition = values[:, 0] / np.where(least > 0.0, least, np.finfo(float).tiny)
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


@dataclass(frozen=True, eq=False)
class Ball:
    """All numbers within `radius` of `middle`. The middles are what plain arithmetic gives; radii
    are themselves rounded, for which SLACK makes up when they are read."""

    middle: Any
    radius: Any
    __array_ufunc__ = None

    def __add__(self, other: Any) -> Ball:
        if isinstance(other, int) and other == 0:
            return self
        other = _ball(other)
        middle = self.middle + other.middle
        return Ball(middle, self.radius + other.radius + UNIT * np.abs(middle))

    __radd__ = __add__

    def __neg__(self) -> Ball:
        return Ball(-self.middle, self.radius)

    def __sub__(self, other: Any) -> Ball:
        return self.__add__(-_ball(other))

    def __rsub__(self, other: Any) -> Ball:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Ball:
        if isinstance(other, int) and other in (1, 2, -1, -2):
            return Ball(self.middle * other, self.radius * abs(other))
        other = _ball(other)
        middle = self.middle * other.middle
        radius = np.abs(self.middle) * other.radius + np.abs(other.middle) * self.radius
        radius = radius + self.radius * other.radius + UNIT * np.abs(middle) + TINY
        return Ball(middle, radius)

    __rmul__ = __mul__


SLACK = 1.0 + 1e-9


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

    def sqrt(self, x: Ball) -> Ball:
        """√x: error r/√x, or √r near 0."""
        root = np.sqrt(x.middle)
        low = np.sqrt(np.maximum(x.middle - x.radius, 0.0))
        width = np.sqrt(x.middle + x.radius) - low + 4.0 * UNIT * root
        relative = x.radius / np.maximum(root + low, 1e-300) + UNIT * root
        return Ball(root, np.where(x.radius == 0.0, UNIT * root, np.minimum(width, relative)))

    def sincos(self, x: Ball) -> tuple[Ball, Ball]:
        sine, cosine = self.base.sincos(x.middle)
        return (
            Ball(sine, SINE_ERROR * np.abs(sine) + np.minimum(x.radius, 2.0)),
            Ball(cosine, SINE_ERROR * np.abs(cosine) + np.minimum(x.radius, 2.0)),
        )

    def kernel(self, kernel: Kernel, q: Ball, derivative: int, dim: int) -> Ball:
        """The rounding of the evaluation, and the slope times the radius of q."""
        value = self.base.kernel(kernel, q.middle, derivative, dim)
        own = (16.0 if kernel.degree > 11 else 8.0) * UNIT * np.abs(value) + TINY
        right = q.middle + q.radius * SLACK
        left = np.maximum(q.middle - q.radius * SLACK, 0.0)
        slope = np.maximum(
            np.abs(_kernel(kernel, left, derivative + 1, dim)),
            np.abs(_kernel(kernel, right, derivative + 1, dim)),
        )
        curvature = _largest(kernel, derivative + 2, dim)
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
        return Ball(value, sm.total(x.radius) + error)

    def dot(self, x: Ball, y: Ball) -> Ball:
        if not isinstance(self.base, Compensated):
            return self.total(x * y)
        a, b, r, s = np.broadcast_arrays(x.middle, y.middle, x.radius, y.radius)
        value = self.base.dot(a, b)
        size = sm.total(np.abs(a * b)) * SLACK
        carried = sm.total(np.abs(a) * s + np.abs(b) * r + r * s)
        return Ball(value, carried + sm.compensated_dot_error(a.shape[0], value, size))

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
        """For every A' and B' in the balls A and B: A'(X' − X) = B' − A'X, and with R near the
        inverse and ‖I − RA'‖ <= e < 1 in the row-sum norm (Rump 2010,
        doi:10.1017/S096249291000005X, section 10), |X' − X| <= |R||B' − A'X| + e/(1 − e) max."""
        a, b = _stacked(_middles(matrix)), _stacked(_middles(columns))
        ra, rb = _stacked(_radii(matrix)), _stacked(_radii(columns))
        scaled = _Scaled(a, health)
        x, inverse = scaled.solve(b), scaled.inverse()
        n = a.shape[1]
        size = np.abs(inverse)
        gamma = sm.gamma(2 * n + 4)
        rest = np.abs(b - a @ x) + gamma * (np.abs(b) + np.abs(a) @ np.abs(x))
        rest = rest + rb + ra @ np.abs(x)
        first = size @ rest
        off = np.abs(np.eye(n) - inverse @ a) + size @ ra + gamma * (np.eye(n) + size @ np.abs(a))
        e = off.sum(axis=2).max(axis=1) * SLACK
        safe = np.where(e < 1.0, e, 0.0)
        spread = (safe / (1.0 - safe))[:, None, None] * first.max(axis=1, keepdims=True)
        radius = np.where((e < 1.0)[:, None, None], (first + spread) * SLACK, np.inf)
        return [
            [Ball(m, r) for m, r in zip(ms, rs, strict=True)]
            for ms, rs in zip(_rows(x), _rows(radius), strict=True)
        ]

    def value(self, x: Any) -> Array:
        return self.base.value(_ball(x).middle)


def _middles(rows: Any) -> Any:
    return [[_ball(x).middle for x in row] for row in rows]


def _radii(rows: Any) -> Any:
    return [[_ball(x).radius for x in row] for row in rows]


@lru_cache(maxsize=128)
def _largest(kernel: Kernel, derivative: int, dim: int) -> float:
    """A bound of |σ w^(derivative)|: Σ|coefficients| about the inner end of each piece."""
    from sympy import Abs

    sigma = float(kernel.normalisation(dim))
    most = 0.0
    for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.pieces, strict=False):
        local = piece.diff((piece.gen, derivative)).shift(a)
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

    def sqrt(self, x: Pair) -> Pair:
        return Pair(*sm.dd_sqrt((x.high, x.low)))

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
            value = _pair(0.0)
            for c in coefficients:
                value = value * t + Pair(*c)
            high[here], low[here] = np.broadcast_arrays(value.high, t.high)[0], value.low
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

    def sqrt(self, x: Any) -> Any:
        from mpmath import mp

        return np.frompyfunc(mp.sqrt, 1, 1)(x)

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
