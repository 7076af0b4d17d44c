"""Relaxation: particles move along −∇ΣVW until that is small, and form a glass.

Steps are those of Barzilai & Borwein (1988, doi:10.1093/imanum/8.1.141) along the gradient, no
particle further than a fifth of Δx; the particle shifting of Lind, Xu, Stansby & Rogers (2012,
doi:10.1016/j.jcp.2011.10.027) in its steady state. One pass of the pair engine a step; the result
depends on the recipe alone, whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.summation import Array, total
from sphtrunc.experiment.engine import pair_sums
from sphtrunc.operators.moments import unit
from sphtrunc.scenes.particles import particles
from sphtrunc.scenes.relaxed import Recipe

if TYPE_CHECKING:
    from sphtrunc.scenes.particles import Particles

FARTHEST = 0.2  # of a particle in one step, in Δx
GROWTH = 2.0  # of a step over the last one


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Relaxed particles and how they came about.

    particles: in a periodic box, lengths in Δx, as they were when the residual was least; history:
    the root mean square of |h∇ΣVW| before each step and after the last (it does not fall steadily)
    """

    recipe: Recipe
    particles: Particles
    history: Array

    @property
    def residual(self) -> float:
        """That of the particles."""
        return float(self.history.min())

    @property
    def converged(self) -> bool:
        """The residual asked for was reached."""
        return self.residual <= self.recipe.residual


def relax(
    recipe: Recipe,
    *,
    workers: int | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Relaxation:
    """Make the glass of a recipe.

    progress: called with the steps done and the residual

    Raises ValueError for an unknown kernel, and a box smaller than two supports.
    """
    from sphtrunc.kernels.parse import kernel as parse_kernel

    shape = parse_kernel(recipe.shape)
    keys = [(unit(recipe.dim, axis), (0,) * recipe.dim) for axis in range(recipe.dim)]

    def climb(x: Array) -> Array:
        """h∇ΣVW at the particles, (d, N)."""
        volume = np.broadcast_to(1.0 / recipe.density(x[0]), x.shape[1:])
        scene = particles(x.T, h=recipe.h, volume=volume, period=recipe.side)
        sums = pair_sums(scene, shape, keys, workers=workers)
        return np.stack([sums.base[key] for key in keys])

    x = recipe.begin()
    slope = climb(x)
    size, best = [_rms(slope)], x
    rate = 0.5 * FARTHEST / max(size[0], 1e-300)
    while size[-1] > recipe.residual and len(size) <= recipe.steps:
        step = -rate * slope
        longest = float(np.sqrt((step * step).sum(axis=0)).max())
        if longest > FARTHEST:
            step *= FARTHEST / longest
        x = np.mod(x + step, recipe.side)
        after = climb(x)
        change = after - slope
        along = _sum(step * change)
        wanted = _sum(step * step) / along if along > 0 else GROWTH * rate
        rate = min(wanted, GROWTH * rate)
        slope = after
        size.append(_rms(slope))
        best = x if size[-1] <= min(size) else best
        if progress is not None:
            progress(len(size) - 1, size[-1])
    volume = np.broadcast_to(1.0 / recipe.density(best[0]), best.shape[1:])
    made = particles(best.T, h=recipe.h, volume=volume, period=recipe.side)
    return Relaxation(recipe, made, np.array(size))


@lru_cache(maxsize=8)
def glass(recipe: Recipe) -> Relaxation:
    """`relax`, remembered."""
    return relax(recipe)


def with_h(scene: Particles, h: float) -> Particles:
    """The same particles with another smoothing length; what is known of given volumes is kept."""
    name = "structure factor"
    kept = {name: scene._trees[name]} if scene.given is not None and name in scene._trees else {}
    return replace(scene, h=np.full(scene.population, h), _trees=kept)


def _sum(x: Array) -> float:
    return float(total(x.reshape(-1)))


def _rms(x: Array) -> float:
    return float(np.sqrt(_sum(x * x) / x.shape[1]))


def regularity(scene: Particles, kernel: str) -> dict[str, float]:
    """How even particles in a periodic box are: "density", the mean of ΣVW with its standard
    deviation "density_std"; "gradient", the root mean square of |h∇ΣVW|; "nearest", the distance of
    the nearest neighbour in Δx, with "nearest_std".

    Raises ValueError for particles without a box.
    """
    from scipy.spatial import cKDTree

    from sphtrunc.kernels.parse import kernel as parse_kernel

    if scene.period is None:
        raise ValueError("particles: expected a periodic box")
    dim, zero = scene.dim, (0,) * scene.dim
    keys = [(unit(dim, axis), zero) for axis in range(dim)]
    sums = pair_sums(scene, parse_kernel(kernel), [(zero, zero), *keys])
    density = sums.base[zero, zero]
    spacing = float(np.prod(scene.period) / scene.population) ** (1 / dim)
    inside = np.mod(scene.x.T, scene.period)
    tree = cKDTree(np.where(inside < scene.period, inside, 0.0), boxsize=scene.period)
    nearest = tree.query(tree.data, k=2)[0][:, 1] / spacing
    return {
        "density": float(density.mean()),
        "density_std": float(density.std()),
        "gradient": _rms(np.stack([sums.base[key] for key in keys])),
        "nearest": float(nearest.mean()),
        "nearest_std": float(nearest.std()),
    }
