"""Linear systems in floats, one for every target, and their condition: near-singular matrices are
reported, never silently inverted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import Array

MOST_CONDITION = 1e12  # of a scaled correction matrix; beyond, less than four digits are left


@dataclass(eq=False)
class Health:
    """Condition of the correction matrices met: the worst of each target, (T,) or what there is of
    them at once."""

    condition: Any = 0.0

    @property
    def singular(self) -> Any:
        """Targets whose matrix is too near to a singular one to be used."""
        return self.condition > MOST_CONDITION


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
