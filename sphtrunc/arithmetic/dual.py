"""Dual numbers: numbers that carry their derivatives, with respect to every displacement or to one
thing, over floats or exactly over a field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array


class Dual:
    """A number with its derivatives: value + slope·u, u² = 0."""

    __slots__ = ("slope", "value")
    __array_priority__ = 1000

    def __init__(self, value: Any, slope: Any) -> None:
        self.value, self.slope = value, slope

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> Dual:
        return self.__add__(-other)

    def __rsub__(self, other: Any) -> Dual:
        return self.__neg__().__add__(other)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(
                self.value * other.value, self.value * other.slope + other.value * self.slope
            )
        return Dual(self.value * other, self.slope * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            ratio = self.value / other.value
            return Dual(ratio, (self.slope - ratio * other.slope) / other.value)
        return Dual(self.value / other, self.slope / other)

    def __eq__(self, other: object) -> bool:
        y = other if isinstance(other, Dual) else Dual(other, 0)
        return bool(self.value == y.value and self.slope == y.slope)

    __hash__ = None  # type: ignore[assignment]

    def __rtruediv__(self, other: Any) -> Dual:
        ratio = other / self.value
        return Dual(ratio, -ratio / self.value * self.slope)


def dual_solve(
    matrix: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]]
) -> list[list[Any]]:
    """X with A X = B, and ∂X = A⁻¹ (∂B − ∂A X); ValueError where A is singular."""
    import numpy as np

    shape = next(x.slope.shape for row in (*matrix, *columns) for x in row if isinstance(x, Dual))

    def values(rows: Sequence[Sequence[Any]]) -> Array:
        return np.array([[x.value if isinstance(x, Dual) else float(x) for x in r] for r in rows])

    def slopes(rows: Sequence[Sequence[Any]]) -> Array:
        return np.array(
            [[x.slope if isinstance(x, Dual) else np.zeros(shape) for x in r] for r in rows]
        )

    a, b = values(matrix), values(columns)
    scale = 1.0 / np.sqrt(np.maximum(np.abs(a).max(axis=1), 1e-300))
    if np.linalg.cond(a * scale[:, None] * scale) > 1e12:
        raise ValueError(
            "correction: its moment matrix is singular on this lattice; expected a smaller Δx/h, or"
            " a lower correction"
        )
    x = np.linalg.solve(a, b)
    rest = slopes(columns) - np.einsum("ij...,jk->ik...", slopes(matrix), x)
    dx = np.linalg.solve(a, rest.reshape(len(a), -1)).reshape(rest.shape)
    return [
        [Dual(float(v), d) for v, d in zip(*row, strict=True)] for row in zip(x, dx, strict=True)
    ]
