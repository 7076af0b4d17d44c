"""More digits than a float has: pairs of floats, and numbers of sixty digits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic import summation as sm
from sphtrunc.arithmetic.linear_systems import Health, Scaled, stacked, unstacked
from sphtrunc.arithmetic.summation import Array

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, eq=False)
class Pair:
    """The unevaluated sum of two floats."""

    high: Any
    low: Any
    __array_ufunc__ = None

    def __getitem__(self, rows: Any) -> Pair:
        return Pair(self.high[rows], self.low[rows])

    def __add__(self, other: Any) -> Pair:
        other = pair(other)
        return Pair(*sm.dd_add((self.high, self.low), (other.high, other.low)))

    __radd__ = __add__

    def __neg__(self) -> Pair:
        return Pair(-self.high, -self.low)

    def __sub__(self, other: Any) -> Pair:
        return self.__add__(-pair(other))

    def __rsub__(self, other: Any) -> Pair:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Pair:
        other = pair(other)
        return Pair(*sm.dd_mul((self.high, self.low), (other.high, other.low)))

    __rmul__ = __mul__


def pair(x: Any) -> Pair:
    return x if isinstance(x, Pair) else Pair(*sm.dd(x))


class Extended:
    """Pairs of floats; kernels by Horner's rule from coefficients to twice the precision."""

    wide, bounded = True, False

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
            moved = [[pair(c) for c in row] for row in step]
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
                    b - sum((a * x[k][j] for k, a in enumerate(row)), pair(0.0))
                    for j, b in enumerate(right)
                ]
                for row, right in zip(matrix, columns, strict=True)
            ]
        return x

    def value(self, x: Any) -> Array:
        x = pair(x)
        return np.asarray(x.high + x.low)

    def rest(self, x: Any) -> Array:
        """The low part."""
        return np.asarray(pair(x).low)


@lru_cache(maxsize=64)
def _inverse(n: int) -> Pair:
    high, low = sm.dd_from_ratio(1, n)
    return Pair(np.array(high), np.array(low))
