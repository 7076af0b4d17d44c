"""Sources of the pair sums: positions, volumes and fields by columns, images of a periodic box
among them, and how far each target looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array, dd_add, two_product, two_sum
from sphtrunc.experiment.engine.pairs import Plan
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

REACH = 1.0 + 1e-12  # what is looked at beyond the support: the formula decides what is inside


def volumes(scene: Particles, kernel: Kernel) -> Array:
    """V_b of every particle, (n,), by the rule of the scene."""
    if scene.given is not None:
        return scene.given
    return scene._cells() if scene.volume == "cell" else scene._summed(kernel)[0]


def columns(
    scene: Particles, kernel: Kernel, task: Plan, values: Sequence[Array] | Array, per_h: Array
) -> tuple[tuple[Array, ...], Array, Any]:
    """Rows of the sources, images of a periodic box included; how far each target looks; which
    particle each source is, None where there are no images."""
    support = float(kernel.support)
    h = scene.h
    if scene.one_h:
        reach = h[:1] if np.all(h == h[0]) else h
    else:
        reach = 0.5 * (h + h.max()) if scene.mode == "mean" else np.full(1, h.max())
    # positions carry their own rounding where they are far from the origin of the box
    closed = np.empty(0) if scene.period is None else scene.period[np.isfinite(scene.period)]
    spread = max(float(np.abs(scene.x).max()), float(closed.max(initial=0.0)))
    reach = support * reach * REACH + 4.0 * UNIT * spread
    volume = volumes(scene, kernel)
    extra = [per_h] if task.mode != "one" else []
    if scene.period is None:
        return (*scene.x, volume, *values, *extra), reach, None
    widest = float(reach.max())
    if np.any(scene.period <= 2.0 * widest):
        raise ValueError(
            f"period: got {scene.period.tolist()}, expected more than twice the support,"
            f" {2.0 * widest:g}: a particle would meet its own image"
        )
    places, source = _with_images(scene.x, scene.period, widest)
    return (*places, *(row[source] for row in (volume, *values, *extra))), reach, source


def _with_images(x: Array, period: Array, reach: float) -> tuple[list[Array], Any]:
    """Positions in the box as pairs of floats (d high, d low), then the images within `reach` of
    it, and which particle each one is."""
    high, low = [], []
    for row, box in zip(x, period, strict=True):
        if np.isinf(box):  # an open axis
            high.append(row)
            low.append(np.zeros_like(row))
            continue
        turns = np.floor(row / box)
        # row − turns·box without error: the product of a small integer and a float in two parts
        big = turns * box
        rest = _product_rest(turns, float(box), big)
        hi, lo = dd_add(two_sum(row, -big), (-rest, np.zeros_like(rest)))
        high.append(hi)
        low.append(lo)
    parts_high, parts_low = [np.stack(high)], [np.stack(low)]
    source = [np.arange(x.shape[1])]
    for shift in product(*((0,) if np.isinf(side) else (-1, 0, 1) for side in period)):
        if not any(shift):
            continue
        near = np.ones(x.shape[1], dtype=np.bool_)
        for i, k in enumerate(shift):
            if k:
                near &= high[i] < reach if k > 0 else high[i] >= period[i] - reach
        which = np.flatnonzero(near)
        if not which.size:
            continue
        moved_high, moved_low = parts_high[0][:, which].copy(), parts_low[0][:, which].copy()
        for i, k in enumerate(shift):
            if k:
                both = (moved_high[i], moved_low[i])
                box = np.full(which.size, k * period[i])
                moved_high[i], moved_low[i] = dd_add(both, (box, np.zeros_like(box)))
        parts_high.append(moved_high)
        parts_low.append(moved_low)
        source.append(which)
    places = [*np.concatenate(parts_high, axis=1), *np.concatenate(parts_low, axis=1)]
    return places, np.concatenate(source)


def _product_rest(a: Array, b: float, product_: Array) -> Array:
    """a·b − fl(a·b)."""
    high, rest = two_product(a, np.full_like(a, b))
    return np.asarray(rest + (high - product_))
