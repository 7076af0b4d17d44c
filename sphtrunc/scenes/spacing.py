"""Spacing: how far particles are from their nearest neighbours, which of them coincide, and how
unlike the distances to them are in different directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array

_AROUND = {1: 8, 2: 32, 3: 96}  # nearest particles that sectors are searched among
_SEEN = 20_000  # particles whose surroundings are looked at
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


def disorder(x: Array, period: Array | None) -> float:
    """λ = ⟨(d_M − d_m)/(d_M + d_m)⟩ of positions (d, n): 0 on a lattice, about 0.5 at random.

    d_m is the distance to the nearest particle and d_M the largest of those to the nearest particle
    in each of the 2d sectors about it, the first of which has the nearest particle in its middle:
    the two sides in 1D, quadrants in 2D, and in 3D the cones over the faces of a cube that is
    turned about that direction until the nearest particle outside the first two stands upright.

    The measure of Antuono, Bouscasse, Colagrossi & Marrone (2014, Comput. Phys. Commun. 185, 2609);
    at most 20,000 particles, evenly chosen, are looked at.
    """
    dim, n = x.shape
    near, unit, _ = tree(x, period)
    sides = None if period is None else np.where(np.isfinite(period), period, np.inf) * unit
    chosen = np.unique(np.linspace(0, n - 1, min(n, _SEEN)).astype(np.int64))
    total = 0.0
    for part in np.array_split(chosen, -(-chosen.size // 1024)):
        r, who = near.query(near.data[part], k=min(n, _AROUND[dim] + 1))
        s, r = (near.data[who] - near.data[part][:, None])[:, 1:], r[:, 1:]
        if sides is not None:
            s = s - np.where(np.isfinite(sides), sides * np.round(s / sides), 0.0)
        along = _frame(s) @ s.transpose(0, 2, 1)
        farthest = np.zeros(len(part))
        for axis in range(dim):
            for sign in (1.0, -1.0):
                # of a neighbour on the edge of two sectors, both have it
                inside = np.abs(along).max(axis=1) <= sign * along[:, axis] * (1.0 + 1e-9)
                nearest = np.where(inside, r, r[:, -1:]).min(axis=1)
                farthest = np.maximum(farthest, nearest)
        total += float(((farthest - r[:, 0]) / np.maximum(farthest + r[:, 0], 1e-300)).sum())
    return total / chosen.size


def _frame(s: Array) -> Array:
    """Axes (T, d, d) about T particles from the offsets (T, K, d) of their neighbours, the nearest
    first: the direction to the nearest, and of those outside the cones about it again the nearest,
    made upright."""
    dim = s.shape[2]
    first = s[:, 0] / np.maximum(np.sqrt((s[:, 0] ** 2).sum(axis=1)), 1e-300)[:, None]
    if dim == 1:
        return np.expand_dims(first, 1)
    if dim == 2:
        return np.stack([first, np.stack([-first[:, 1], first[:, 0]], axis=1)], axis=1)
    along = np.einsum("tkd,td->tk", s, first)
    beside = along**2 * 2.0 < (s**2).sum(axis=2)
    second = s[np.arange(len(s)), beside.argmax(axis=1)]
    second = second - np.einsum("td,td->t", second, first)[:, None] * first
    second = second / np.maximum(np.sqrt((second**2).sum(axis=1)), 1e-300)[:, None]
    return np.stack([first, second, np.cross(first, second)], axis=1)
