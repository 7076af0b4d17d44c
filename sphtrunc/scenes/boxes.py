"""Boxes: the particles of a lattice between walls, a slab, a corner or a closed box, as explicit
particles; what is not walled is periodic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.arithmetic.rational import exact
from sphtrunc.arithmetic.summation import Array
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.particles import Particles, particles
from sphtrunc.scenes.sites import KINDS, units
from sphtrunc.scenes.walls import PLACES

MOST = 10**7  # particles


@dataclass(frozen=True, eq=False)
class Box:
    """Particles between walls; lengths in units of h.

    particles: for `measure`; sides: of the box, (d,), a wall at 0 and at the side of a walled axis
    walled: (d,) which axes end in walls, the others are periodic
    """

    particles: Particles
    sides: Array
    walled: tuple[bool, ...]

    @property
    def distance(self) -> Array:
        """Of every particle from the nearest wall, (n,), in h; infinite without walls."""
        x = self.particles.x
        rows = [
            np.minimum(x[i], side - x[i])
            for i, (side, wall) in enumerate(zip(self.sides, self.walled, strict=True))
            if wall
        ]
        return np.min(rows, axis=0) if rows else np.full(x.shape[1], np.inf)

    def targets(self, low: float, high: float) -> NDArray[np.int64]:
        """The particles at low <= η < high from the nearest wall, for `measure(targets=...)`."""
        eta = self.distance
        return np.flatnonzero((low <= eta) & (eta < high)).astype(np.int64)


def box(
    scene: Lattice | Jittered,
    planes: Sequence[int],
    *,
    walled: Sequence[bool] | None = None,
    at: object = "half-way",
) -> Box:
    """So many planes of a lattice along every axis, displaced or not, between walls.

    planes: their number along each axis (of the points that `sites` numbers: a step of every axis
        is a plane)
    walled: which axes end in walls, default all: a closed box, whose corners are corners; one of
        them: a slab, of as many planes as its width; the others are periodic
    at: steps from a wall to the first plane: "half-way", "particle" (then a particle on one wall
        counts half, on an edge of two a quarter), or a number

    Raises ValueError for what is out of range, and for periodic axes that the lattice does not fit.
    """
    lattice = scene.lattice if isinstance(scene, Jittered) else scene
    kind, dim = KINDS[lattice.kind], lattice.dim
    counts = [int(n) for n in planes]
    ends = [True] * dim if walled is None else [bool(x) for x in walled]
    if len(counts) != dim or len(ends) != dim:
        raise ValueError(f"planes, walled: expected {dim} entries, one per axis")
    if min(counts) < 1 or np.prod([float(n) for n in counts]) > MOST:
        raise ValueError(f"planes: got {counts}, expected 1 or more, {MOST} points at most")
    if lattice.wall is not None or any(lattice.offset) or lattice.volume != "constant":
        raise ValueError("box: expected a lattice without wall and offset, of constant volumes")
    place = exact(PLACES.get(str(at), at), "at")
    if not 0 <= place < 1:
        raise ValueError(f"at: got {place}, expected particle, half-way or a fraction from 0 to 1")
    if isinstance(scene, Jittered) and place == 0 and any(ends):
        raise ValueError("at: displaced particles are not on a wall; expected half-way")
    axes = np.meshgrid(*(np.arange(n, dtype=np.int64) for n in counts), indexing="ij")
    m = np.stack([axis.ravel() for axis in axes])
    m = m[:, kind.contains(m)]
    for i, n in enumerate(counts):
        along = np.zeros((dim, 1), dtype=np.int64)
        along[i] = n
        if not ends[i] and not np.all(kind.contains(m + along)):
            raise ValueError(
                f"planes: {n} along axis {i + 1} are no period of {lattice.kind}; expected an even"
                " number (a multiple of 6 for hcp)"
            )
    unit = [float(u * lattice.dx_over_h) for u in units(lattice.kind)]
    x = np.stack([
        (row + (float(place) if end else 0.0)) * u
        for row, u, end in zip(m, unit, ends, strict=True)
    ])  # fmt: skip
    if isinstance(scene, Jittered):
        x = x + scene.displacement(m) * float(lattice.dx_over_h)
    sides = np.array([
        (n - 1 + 2 * float(place) if end else n) * u
        for n, u, end in zip(counts, unit, ends, strict=True)
    ])  # fmt: skip
    share = np.ones(m.shape[1])
    for i, n in enumerate(counts):
        if ends[i] and place == 0:
            share[(m[i] == 0) | (m[i] == n - 1)] *= 0.5
    volume = float(Fraction(lattice.dx_over_h) ** dim) * share
    period: Any = [np.inf if end else side for side, end in zip(sides, ends, strict=True)]
    made = particles(x.T, h=1.0, volume=volume, period=None if all(ends) else period)
    return Box(made, sides, tuple(ends))
