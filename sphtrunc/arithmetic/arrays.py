"""Arrays as numbers: what formulas that run on arrays and on SIMD lanes alike ask of NumPy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array

MOST = 2.0**26  # two counts in one float: the second in units of this


class ArrayNumbers:
    """The functions of such a formula for NumPy arrays."""

    def constant(self, c: float, error: float = 0.0) -> float:
        return c

    def difference(self, a: Array, b: Array) -> Array:
        return a - b

    def scale(self, x: Any) -> Any:
        """The power of two at or below |x|, 0 for denormal numbers."""
        bits = np.asarray(x, dtype=np.float64).view(np.int64) & 0x7FF0000000000000
        return bits.view(np.float64)

    def sqrt(self, x: Array) -> Array:
        return np.asarray(np.sqrt(x))

    def size(self, x: Any) -> Any:
        return np.abs(x)

    def larger(self, a: Any, b: Any) -> Any:
        return np.maximum(a, b)

    def smaller(self, a: Any, b: Any) -> Any:
        return np.minimum(a, b)

    def positive(self, x: Any) -> Any:
        return np.maximum(x, 0.0)

    def others(self, squares: Array, x: Any) -> Any:
        return np.where(squares > 0.0, x, 0.0)

    def within(self, x: Array, edge: float, squares: Array) -> Any:
        return np.where(x <= edge, np.where(squares > 0.0, 1.0 + MOST, 1.0), 0.0)

    def pick(self, x: Array, knot: float, inner: Any, outer: Any, mean: float | None) -> Any:
        value = np.where(x < knot, inner, outer)
        return value if mean is None else np.where(x == knot, mean, value)
