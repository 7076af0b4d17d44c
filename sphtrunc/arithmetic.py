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

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from sphtrunc import summation as sm
from sphtrunc.summation import Array

if TYPE_CHECKING:
    from sphtrunc.kernel import Kernel

MOST_CONDITION = 1e12  # of a scaled correction matrix; beyond, less than four digits are left


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
    def rest(self, x: Any) -> Array: ...


@dataclass(eq=False)
class Health:
    """Condition of the correction matrices met: the worst of each target, (T,) or what there is of
    them at once."""

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
        return float_kernel(kernel, q, derivative, dim)

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


class Scaled:
    """Inverses of matrices (…, n, n) by singular values, after scaling: the diagonal to 1, which
    for a positive definite matrix is within a factor n of the best there is (van der Sluis 1969,
    doi:10.1007/BF02165096), and then rows and columns to 1, for those whose diagonal is small."""

    def __init__(self, a: Array, health: Health) -> None:
        unit = np.sqrt(_inverse_size(np.abs(np.diagonal(a, axis1=-2, axis2=-1))))
        unit = np.where(unit > 0.0, unit, 1.0)
        size = np.abs(a) * unit[..., None] * unit[..., None, :]
        row = _inverse_size(size.max(axis=-1))
        column = unit * _inverse_size((size * row[..., None]).max(axis=-2))
        row = unit * row
        scaled = a * row[..., None] * column[..., None, :]
        u, values, v = np.linalg.svd(scaled)
        least = values[..., -1]
        positive = least > 0.0
        condition = np.where(positive, values[..., 0] / np.where(positive, least, 1.0), np.inf)
        health.condition = np.maximum(health.condition, condition)
        bad = condition > MOST_CONDITION
        values = np.where(bad[..., None], 1.0, values)
        self.left = u.swapaxes(-1, -2) * row[..., None, :]  # (…, n, n)
        self.values = values
        self.right = v.swapaxes(-1, -2) * column[..., None]

    def solve(self, b: Array) -> Array:
        """(…, n, k) -> (…, n, k)."""
        return np.asarray(self.right @ ((self.left @ b) / self.values[..., None]))

    def inverse(self) -> Array:
        """(…, n, n)."""
        return np.asarray(self.right @ (self.left / self.values[..., None]))


def _inverse_size(x: Array) -> Array:
    """1/x, or 0 where there is next to nothing."""
    return np.asarray(np.where(x > 1e-290, 1.0 / np.maximum(x, 1e-290), 0.0))


def stacked(rows: Any) -> Array:
    """A list of rows of numbers or arrays (…) as one array (…, n, k)."""
    shape = np.broadcast_shapes(*(np.shape(x) for row in rows for x in row), (1,))
    out = np.empty((*shape, len(rows), len(rows[0])))
    for i, row in enumerate(rows):
        for j, x in enumerate(row):
            out[..., i, j] = x
    return out


def unstacked(x: Array) -> list[list[Array]]:
    return [[x[..., i, j] for j in range(x.shape[-1])] for i in range(x.shape[-2])]


class Compensated(Plain):
    """float64, sums and products of the last step compensated."""

    def total(self, x: Array) -> Array:
        high, low = sm.compensated_total(x)
        return np.asarray(high + low)

    def dot(self, x: Array, y: Array) -> Array:
        return sm.compensated_dot(*np.broadcast_arrays(x, y))


def float_kernel(kernel: Kernel, q: Array, derivative: int, dim: int) -> Array:
    if derivative < 3:
        return np.asarray((kernel.w, kernel.dw, kernel.d2w)[derivative](q, dim), dtype=np.float64)
    from sphtrunc.evaluation import evaluate, tabulate

    return np.asarray(evaluate(tabulate(kernel, dim, derivative), q), dtype=np.float64)


@lru_cache(maxsize=128)
def jumps_anywhere(kernel: Kernel, derivative: int) -> bool:
    """Does the derivative jump at a knot other than the origin?"""
    return any(jump != 0 for knot, jump in kernel.jumps(derivative).items() if knot != 0)


PRECISIONS = ("plain", "compensated", "extended", "exact")


def arithmetic(precision: str, bound: bool = False) -> Any:
    """The arithmetic of a precision level, with a bound if asked for."""
    from sphtrunc.bounded import Bounded
    from sphtrunc.digits import Exact, Extended

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
