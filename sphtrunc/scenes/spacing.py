"""Spacing: how far particles are from their nearest neighbours, and which of them coincide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array

_ROUNDING = 8.0 * UNIT  # of coordinates in a box, relative to the largest: what coincides


@dataclass(frozen=True)
class Spacing:
    """Distances to nearest neighbours of n particles, those that coincide left out.

    nearest: (n,), 0 for particles that coincide with another; least, median: of the others
    close: pairs nearer than half of the median (pairing); coincident: particles that are where an
    earlier one is; first: the first two of these, or None
    """

    nearest: Array
    least: float
    median: float
    close: int
    coincident: int
    first: tuple[int, int] | None


def tree(x: Array, period: Array | None) -> tuple[Any, float, float]:
    """A k-d tree of positions (d, n) in a box (d,) whose sides may be infinite, the unit that its
    lengths are multiplied with, and the rounding of a distance in that unit."""
    from scipy.spatial import cKDTree

    size = float(np.abs(x).max(initial=0.0))
    sides = None
    if period is not None:
        sides = np.where(np.isfinite(period), period, 0.0)
        size = max(size, float(sides.max()))
    unit = float(2.0 ** -np.clip(np.frexp(size)[1], -1000, 1000)) if size else 1.0
    points = np.ascontiguousarray(x.T) * unit
    if sides is not None:
        sides = sides * unit
        safe = np.where(sides > 0.0, sides, 1.0)
        inside = points - np.floor(points / safe) * safe
        points = np.where(sides > 0.0, np.where(inside < sides, inside, 0.0), points)
    return cKDTree(points, boxsize=sides), unit, _ROUNDING * size * unit


def coincident(x: Array, period: Array | None) -> tuple[int, tuple[int, int] | None]:
    """How many of the particles (d, n) are where an earlier one is, up to the rounding of their
    coordinates and modulo the period, and the first two of them."""
    near, _, rounding = tree(x, period)
    return _same(near, rounding)


def _same(near: Any, rounding: float) -> tuple[int, tuple[int, int] | None]:
    # a box looked at from a corner sees its other side at a distance of rounding, too
    pairs = near.query_pairs(rounding, output_type="ndarray")
    if not len(pairs):
        return 0, None
    pairs = np.sort(pairs, axis=1)
    first = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))[0]]
    return int(np.unique(pairs[:, 1]).size), (int(first[0]), int(first[1]))


def spacing(x: Array, period: Array | None) -> Spacing:
    """Of positions (d, n), n >= 2, in a box (d,) with infinite sides where it is open."""
    near, unit, rounding = tree(x, period)
    count, first = _same(near, rounding)
    distance, _ = near.query(near.data, k=2)
    # which of the two is the particle itself is open where two coincide
    nearest = distance[:, 1]
    apart = nearest > rounding
    if not np.any(apart):
        return Spacing(nearest / unit, 0.0, 0.0, 0, count, first)
    median = float(np.median(nearest[apart]))
    close, same = (len(near.query_pairs(r, output_type="ndarray")) for r in (median / 2, rounding))
    return Spacing(
        nearest=np.where(apart, nearest, 0.0) / unit,
        least=float(nearest[apart].min()) / unit,
        median=median / unit,
        close=close - same,
        coincident=count,
        first=first,
    )
