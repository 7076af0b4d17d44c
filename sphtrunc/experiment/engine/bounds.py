"""Bounds of the rounding errors of pair sums."""

from __future__ import annotations

from typing import Any

from sphtrunc.arithmetic.summation import TINY, UNIT

# ------------------------------------------------------------------------------ bounded numbers


class Bounded:
    """A number with a bound of its error: |value − truth| <= error. Works on any numbers.

    A rounding costs at most u times the power of two below the result. The errors themselves are
    rounded; whoever reads them out adds a little.
    """

    __slots__ = ("error", "number", "value")

    def __init__(self, number: Any, value: Any, error: Any) -> None:
        self.number, self.value, self.error = number, value, error

    def _other(self, other: Any) -> Bounded:
        return other if isinstance(other, Bounded) else Bounded(self.number, other, 0.0)

    def __add__(self, other: Any) -> Bounded:
        other = self._other(other)
        value = self.value + other.value
        error = self.error + other.error
        return Bounded(self.number, value, error + self.number.scale(value) * UNIT)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Bounded:
        return self + -self._other(other)

    def __rsub__(self, other: Any) -> Bounded:
        return self._other(other) - self

    def __neg__(self) -> Bounded:
        return Bounded(self.number, -self.value, self.error)

    def __mul__(self, other: Any) -> Bounded:
        other, n = self._other(other), self.number
        value = self.value * other.value
        error = (n.size(self.value) + self.error) * other.error + self.error * n.size(other.value)
        return Bounded(n, value, error + (n.scale(value) * UNIT + TINY))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Bounded:
        other, n = self._other(other), self.number
        value = self.value / other.value
        room = n.positive(n.size(other.value) - other.error)
        error = (self.error + n.size(value) * other.error) / room
        return Bounded(n, value, error + (n.scale(value) * UNIT + TINY))


class BoundedNumbers:
    """The functions of the formula for bounded numbers, on top of those for plain ones."""

    def __init__(self, number: Any, quantum: float = 0.0) -> None:
        self.plain, self.quantum = number, quantum

    def constant(self, c: float, error: float = 0.0) -> Bounded:
        return Bounded(self.plain, self.plain.constant(c), error)

    def difference(self, a: Bounded, b: Bounded) -> Bounded:
        """a − b of positions, and exactly what rounding took off (Knuth 1969)."""
        d = a.value - b.value
        back = a.value - d
        rest = (a.value - (d + back)) + (back - b.value)
        error = self.plain.size(rest)
        if self.quantum:
            error = error + (self.plain.size(a.value) + self.plain.size(b.value)) * self.quantum
        return Bounded(self.plain, d, error)

    def sqrt(self, x: Bounded) -> Bounded:
        n = self.plain
        root = n.sqrt(x.value)
        error = n.smaller(x.error / n.larger(root, TINY), n.sqrt(x.error))
        return Bounded(n, root, error + n.scale(root) * UNIT)

    def larger(self, a: Bounded, b: Bounded) -> Bounded:
        n = self.plain
        return Bounded(n, n.larger(a.value, b.value), n.larger(a.error, b.error))

    def positive(self, x: Bounded) -> Bounded:
        n = self.plain
        error = n.pick(x.value + x.error, 0.0, 0.0, x.error, None)
        return Bounded(n, n.positive(x.value), error)

    def others(self, squares: Bounded, x: Bounded) -> Bounded:
        """x, or 0 at s = 0."""
        n = self.plain
        error = n.others(squares.value, x.error)
        return Bounded(n, n.others(squares.value, x.value), error)

    def within(self, x: Bounded, edge: float, squares: Bounded) -> Bounded:
        return Bounded(self.plain, self.plain.within(x.value, edge, squares.value), 0.0)

    def pick(self, x: Bounded, knot: float, inner: Any, outer: Any, mean: float | None) -> Bounded:
        """inner below the knot, outer above; where rounding may have crossed it, both errors and
        their difference."""
        n = self.plain
        if not isinstance(outer, Bounded):
            outer = Bounded(n, n.constant(outer), n.constant(0.0))
        value = n.pick(x.value, knot, inner.value, outer.value, mean)
        error = n.pick(x.value, knot, inner.error, outer.error, None)
        both = inner.error + outer.error + n.size(inner.value - outer.value)
        near = n.size(x.value - knot) - x.error - 2.0 * UNIT * knot
        return Bounded(n, value, n.pick(near, 0.0, both, error, None))
