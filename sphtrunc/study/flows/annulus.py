"""Rotating Couette flow: an annulus cut from a lattice, walls with a curvature.

Between circles of radius 1 and 2, in widths of the gap; the inner one turns: u_θ = (4/r − r)/3.
Each Cartesian component of it obeys ∇²u = 0, so that the scalar operator is put to the test.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.particles import particles
from sphtrunc.scenes.sites import KINDS, units
from sphtrunc.study.flows.enclosure import (
    FEWEST,
    Beyond,
    Enclosure,
    joined,
    known,
    scaled,
    with_dummies,
)

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.lattice import Lattice

INNER, OUTER = 1.0, 2.0


def velocity(x: Array) -> Array:
    """The exact velocity at points (2, n), (2, n)."""
    r2 = (x * x).sum(axis=0)
    return np.asarray(np.stack([-x[1], x[0]]) * ((4.0 / r2 - 1.0) / 3.0))


@cache
def slowest() -> float:
    """The smallest eigenvalue of −∇² in the annulus: k² of the first root of
    J₀(k)Y₀(2k) − J₀(2k)Y₀(k)."""
    from scipy.optimize import brentq
    from scipy.special import j0, y0

    def cross(k: float) -> float:
        return float(j0(INNER * k) * y0(OUTER * k) - j0(OUTER * k) * y0(INNER * k))

    root = float(brentq(cross, 3.0, 3.3, xtol=1e-14))
    return root * root


def annulus(
    scene: Lattice | Jittered, kernel: Kernel, across: int, wall: str, *, reach: int = 1
) -> Enclosure:
    """The particles of a lattice, displaced or not, between the circles, `across` of them in the
    gap. Images lie on the same radius as far beyond the wall, with the volume that the mirror
    leaves, V r*/r; dummies continue the lattice.

    Raises ValueError for fewer than 5 particles across, and for wall "none".
    """
    known(wall)
    if across < FEWEST:
        raise ValueError(f"N: got {across} particles across the gap, expected {FEWEST} or more")
    if wall == "none":
        raise ValueError(
            "wall: no particles of a lattice are on a circle, so that with none nothing gives the"
            " flow the walls' values; expected mirror, dummy or extrapolate"
        )
    home = scene.lattice if isinstance(scene, Jittered) else scene
    ratio = float(home.dx_over_h)
    gap = across * ratio  # in h
    far = reach * float(kernel.support)
    if far >= gap * INNER:
        raise ValueError(
            f"N: a row reaches {far / gap:.3g} of the gap, beyond the middle of the inner circle;"
            " expected more particles across, or a smaller h"
        )
    length = np.array([float(u) for u in units(home.kind)]) * ratio
    most = [int((OUTER * gap + far) / u) + 2 for u in length]
    axes = np.meshgrid(*(np.arange(-m, m) for m in most), indexing="ij")
    index = np.stack([a.ravel() for a in axes])
    index = index[:, KINDS[home.kind].contains(index)]
    site = (index + 0.5) * length[:, None]
    r = np.sqrt((site * site).sum(axis=0))
    inside = (r > INNER * gap) & (r < OUTER * gap)
    x = site[:, inside]
    if isinstance(scene, Jittered):
        x = x + scene.displacement(index[:, inside]) * ratio
        radius = np.sqrt((x * x).sum(axis=0))
        # a displaced particle stays on its side of the wall, as elsewhere: at least as a mirror
        kept = np.clip(radius, INNER * gap + 0.01 * ratio, OUTER * gap - 0.01 * ratio)
        x = x * (kept / radius)
    cell = ratio**2
    fluid = particles(x.T, h=1.0, volume=cell)
    if wall == "mirror":
        found = _mirrored(fluid, gap, far)
    else:
        outside = ~inside & (r > INNER * gap - far) & (r < OUTER * gap + far)
        ghosts = site[:, outside]
        radius = r[outside]
        circle = np.where(radius < INNER * gap, INNER, OUTER) * gap
        found = with_dummies(fluid, kernel, ghosts, ghosts * (circle / radius), wall, cell)
    on_wall = np.zeros(fluid.population, dtype=bool)
    return scaled(found, 1.0 / gap, wall, on_wall, ratio, index[:, inside])


def _mirrored(fluid: Any, gap: float, far: float) -> Beyond:
    """The fluid with its odd images in both circles."""
    from scipy.sparse import csr_array

    n = fluid.population
    radius = np.sqrt((fluid.x**2).sum(axis=0))
    images, sources, feet, volumes = [], [], [], []
    for circle in (INNER * gap, OUTER * gap):
        image = 2.0 * circle - radius
        near = np.flatnonzero(np.abs(circle - radius) <= far)
        images.append(fluid.x[:, near] * (image / radius)[near])
        feet.append(fluid.x[:, near] * (circle / radius)[near])
        volumes.append(fluid.given[near] * (image / radius)[near])
        sources.append(near)
    source = np.concatenate(sources)
    row = n + np.arange(source.size)
    total = n + source.size
    column = np.concatenate([np.arange(n), source])
    values = np.concatenate([np.ones(n), np.full(source.size, -1.0)])
    return Beyond(
        joined(fluid, np.concatenate(images, axis=1), np.concatenate(volumes)),
        n,
        csr_array((values, (np.arange(total), column)), shape=(total, n)),
        np.concatenate(feet, axis=1),
        csr_array((np.full(row.size, 2.0), (row, np.arange(row.size))), shape=(total, row.size)),
    )
