"""Relaxation: particles move along −∇ΣVW until that is small, and form a glass.

For equal volumes h∇ΣVW is the gradient of an energy, Σ_{a<b} VW up to a factor, which is brought
down by the quasi-Newton steps of Liu & Nocedal (1989, doi:10.1007/BF01589116) with the last
`MEMORY` of them, no particle further than a fifth of Δx; where they are reached, the steady state
of the particle shifting of Lind, Xu, Stansby & Rogers (2012, doi:10.1016/j.jcp.2011.10.027). One
pass of the pair engine a step; the result depends on the recipe alone, whatever the number of
threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
GROWTH = 2.0  # of a step over the last one, where the slope has not changed along it as it should
_FLAT = 1e-9  # cosine of a step and of the change of slope below which there is no curvature
WAY = "lbfgs/1"  # what the particles of a recipe depend on beside the recipe
MEMORY = 8  # steps that the curvature is known from


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
    moves: list[_Move] = []
    while size[-1] > recipe.residual and len(size) <= recipe.steps:
        step = _downhill(slope, moves, rate)
        if _sum(step * slope) >= 0.0:  # what was remembered does not hold here
            moves, step = [], -rate * slope
        longest = float(np.sqrt((step * step).sum(axis=0)).max())
        if longest > FARTHEST:
            step *= FARTHEST / longest
        x = np.mod(x + step, recipe.side)
        after = climb(x)
        change = after - slope
        along, square = _sum(step * change), _sum(change * change)
        if along > _FLAT * (_sum(step * step) * square) ** 0.5:
            moves, rate = [*moves[1 - MEMORY :], (step, change, along)], along / square
        else:
            moves, rate = [], GROWTH * rate
        slope = after
        size.append(_rms(slope))
        best = x if size[-1] <= min(size) else best
        if progress is not None:
            progress(len(size) - 1, size[-1])
    return relaxed(recipe, best, np.array(size))


def relaxed(recipe: Recipe, x: Array, history: Array) -> Relaxation:
    """What became of a recipe: positions (d, N) in its box, with the volumes of its profile."""
    volume = np.broadcast_to(1.0 / recipe.density(x[0]), x.shape[1:])
    scene = particles(x.T, h=recipe.h, volume=volume, period=recipe.side)
    return Relaxation(recipe, scene, history)


_Move = tuple[Array, Array, float]  # a step, how the slope changed along it, and their product


def _downhill(slope: Array, moves: Sequence[_Move], rate: float) -> Array:
    """−H g, H the inverse of the curvature as `moves` show it, `rate` times the identity without
    them: the recursion of Nocedal (1980)."""
    found, parts = slope, []
    for step, change, along in reversed(moves):
        parts.append(_sum(step * found) / along)
        found = found - parts[-1] * change
    found = rate * found
    for step, change, along in moves:
        found = found + (parts.pop() - _sum(change * found) / along) * step
    return -found


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
    the nearest neighbour in Δx, with "nearest_std"; "disorder", λ of Antuono et al. (2014).

    Raises ValueError for particles without a box.
    """
    from sphtrunc.kernels.parse import kernel as parse_kernel
    from sphtrunc.scenes.spacing import disorder, tree

    if scene.period is None:
        raise ValueError("particles: expected a periodic box")
    dim, zero = scene.dim, (0,) * scene.dim
    keys = [(unit(dim, axis), zero) for axis in range(dim)]
    sums = pair_sums(scene, parse_kernel(kernel), [(zero, zero), *keys])
    density = sums.base[zero, zero]
    spacing = float(np.prod(scene.period) / scene.population) ** (1 / dim)
    near, length, _ = tree(scene.x, scene.period)
    nearest = near.query(near.data, k=2)[0][:, 1] / (length * spacing)
    return {
        "density": float(density.mean()),
        "density_std": float(density.std()),
        "gradient": _rms(np.stack([sums.base[key] for key in keys])),
        "nearest": float(nearest.mean()),
        "nearest_std": float(nearest.std()),
        "disorder": disorder(scene.x, scene.period),
    }
