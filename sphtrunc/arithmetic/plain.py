"""The arithmetics in which a sum over neighbours can be evaluated: one formula, many numbers.

plain        float64, every sum folded in fixed order
compensated  float64, products and sums of the last step carried to twice the precision
bounded      either of these with a radius: a rigorous bound of everything that was rounded
extended     pairs of floats: terms and sums to about 31 digits
exact        50 digits and more, one target at a time

An arithmetic makes numbers from arrays, and knows lengths, sines, sums and linear systems; the
numbers know + − × themselves. Sums run over axis 0.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from sphtrunc.arithmetic import summation as sm
from sphtrunc.arithmetic.linear_systems import Health, Scaled, stacked, unstacked
from sphtrunc.arithmetic.summation import Array


class Arithmetic(Protocol):
    """What the experiment asks of an arithmetic.

    wide, bounded: what it wants beside floats: the digits that follow, or a bound of what they are
        off by
    """

    wide: bool
    bounded: bool

    def number(self, high: Any, low: Any = None, error: Any = None) -> Any: ...
    def length(self, s: list[Any]) -> Any: ...
    def directions(self, s: list[Any], q: Any) -> list[Any]: ...
    def sincos(self, x: Any) -> tuple[Any, Any]: ...
    def total(self, x: Any) -> Any: ...
    def dot(self, x: Any, y: Any) -> Any: ...
    def ratio(self, x: Any, y: Any) -> Any: ...
    def drop(self, x: Any, where: Any) -> Any: ...
    def solve(self, matrix: Any, columns: Any, health: Health) -> Any: ...
    def value(self, x: Any) -> Array: ...
    def rest(self, x: Any) -> Array: ...


# --------------------------------------------------------------------------------- float64


class Plain:
    """float64, folded sums."""

    wide = bounded = False

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
        a, b = stacked(matrix), stacked(columns)
        return unstacked(Scaled(a, health).solve(b))

    def value(self, x: Any) -> Array:
        return np.asarray(x, dtype=np.float64)

    def rest(self, x: Any) -> Array:
        """What a number holds beside its value: nothing, a radius, or the digits that follow."""
        return np.zeros(np.shape(x))


PLAIN = Plain()


class Compensated(Plain):
    """float64, sums and products of the last step compensated."""

    def total(self, x: Array) -> Array:
        high, low = sm.compensated_total(x)
        return np.asarray(high + low)

    def dot(self, x: Array, y: Array) -> Array:
        return sm.compensated_dot(*np.broadcast_arrays(x, y))
