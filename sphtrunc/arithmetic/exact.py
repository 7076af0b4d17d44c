"""Numbers of sixty digits, one target at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from sphtrunc.arithmetic.elimination import eliminate
from sphtrunc.arithmetic.linear_systems import Health, Scaled, stacked
from sphtrunc.arithmetic.summation import Array

DIGITS = 60  # of the exact arithmetic


# --------------------------------------------------------------------------------- exact


class Exact:
    """Object arrays of mpmath numbers; to be used inside ``mpmath.workdps(DIGITS)``."""

    wide = bounded = False

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
