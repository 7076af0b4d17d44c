"""Statistics of many targets: which are drawn, when they are enough, what their spread says."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import MOST_CONDITION
from sphtrunc.arithmetic.summation import UNIT, Array, dd, dd_div
from sphtrunc.experiment.fields import Sinusoid, Values
from sphtrunc.experiment.measurement import PHASES, SIGMAS, Block, Measurement
from sphtrunc.experiment.task import described, is_still
from sphtrunc.operators.moments import Moments
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.neighbourhood import Indices
from sphtrunc.scenes.scene import Scene, every_target, sample, target_count

if TYPE_CHECKING:
    from sphtrunc.experiment.task import Task

FIRST, MOST = 2048, 1 << 20  # targets of the first batch, and at most, when rtol decides


def until(
    width: Callable[[], float],
    rtol: float,
    scene: Scene,
    most: int,
    seed: int,
    run: Callable[[Indices, int], None],
) -> None:
    """Draw targets, and run them, until the statistic whose relative width is `width()` is known to
    `rtol`; how many depends on nothing else."""
    if not 1e-6 <= rtol < 1:
        raise ValueError(f"rtol: got {rtol:g}, expected a number from 1e-6 to below 1")
    limit = min(most, target_count(scene))
    done, goal = 0, min(FIRST, limit)
    while done < goal:
        run(sample(scene, done, goal, seed), goal)
        done, found = goal, width()
        if found > rtol:
            wanted = int(1.05 * done * (found / rtol) ** 2) + FIRST // 8
            goal = min(limit, 8 * done, wanted)


def _chosen(scene: Scene, targets: object, seed: int) -> Indices:
    """The targets asked for, as indices."""
    population = scene.population
    if targets is None:
        targets = 4096 if isinstance(getattr(scene, "base", scene), Jittered) else "all"
    if isinstance(targets, str):
        if targets != "all":
            raise ValueError(f"targets: got {targets!r}, expected a number, 'all' or indices")
        if population > 2**26:
            raise ValueError(
                f"targets: this scene has {population} particles; expected a number of them"
            )
        return every_target(scene)
    if isinstance(targets, (int, np.integer)) and not isinstance(targets, bool):
        if not 1 <= targets <= 2**26:
            raise ValueError(f"targets: got {targets}, expected at least 1 and at most 2^26")
        return sample(scene, 0, min(int(targets), target_count(scene)), seed)
    index = np.asarray(targets)
    if index.ndim != 1 or index.dtype.kind not in "iu" or not index.size:
        raise ValueError("targets: expected a number, 'all' or a list of indices")
    if index.min() < 0 or index.max() >= population:
        raise ValueError(f"targets: expected indices from 0 to {population - 1}")
    return index.astype(np.int64)


# ------------------------------------------------------------------------------- from many blocks


def squares(blocks: list[Block], operator: Operator, dim: int) -> Array:
    """Per target, the square of the error vector; without a field, Σ (M_α − M_α^exact)² over the
    moments that the operator stands for."""
    if blocks[0].errors is not None:
        parts = [(b.errors**2).sum(axis=0) for b in blocks if b.errors is not None]
        if blocks[0].errors.shape[1] == blocks[0].target.size:
            parts = [p[_fit(b)] for p, b in zip(parts, blocks, strict=True)]
        return np.concatenate(parts)
    exact = operator.target(dim)
    if not all(alpha in blocks[0].moments for alpha in exact):
        raise ValueError("rtol: expected a field, or moments up to those of the operator")
    return np.concatenate(
        [
            np.sum([(b.moments[a] - m) ** 2 for a, m in exact.items()], axis=0)[_fit(b)]
            for b in blocks
        ]
    )


def relative_width(square: Array) -> float:
    """Half of the 95 % confidence interval of the rms, relative to it."""
    mean = float(square.mean()) if square.size else 0.0
    if mean == 0.0:
        return 0.0
    return SIGMAS * float(square.std()) / sqrt(square.size) / (2.0 * mean)


def _fit(block: Block) -> Any:
    return (block.condition <= MOST_CONDITION) & (block.neighbours > 0)


def gathered(task: Task, blocks: list[Block], interrupted: bool, seconds: float) -> Measurement:
    """The blocks put together, the flagged targets left out."""
    target = np.concatenate([b.target for b in blocks])
    fit = np.concatenate([_fit(b) for b in blocks])
    pairs = np.concatenate([b.pairs for b in blocks])
    neighbours = np.concatenate([b.neighbours for b in blocks])
    condition = np.concatenate([b.condition for b in blocks])
    lattice = is_still(task.scene)
    waves = bool(task.fields) and all(isinstance(f, Sinusoid) for f in task.fields)
    k = task.operator.derivatives
    scale: Any = max((f.amplitude(k) for f in task.fields), default=1.0)
    if any(isinstance(f, Values) for f in task.fields):
        scale = scale * task.scene.h[target] ** k  # type: ignore[union-attr]

    def side(name: str) -> Array | None:
        found = [getattr(b, name) for b in blocks]
        return None if found[0] is None else np.concatenate(found, axis=1)

    errors, rest, estimates = side("errors"), side("rest"), side("estimates")
    low: Array | None = None
    bound = rest / scale if rest is not None and task.bound else None
    if errors is not None and rest is not None and task.precision in ("extended", "exact"):
        errors, low = dd_div((errors, rest), dd(np.broadcast_to(scale, errors.shape)))
    elif errors is not None:
        errors = errors / scale
    if lattice and waves and errors is not None:
        phi = 2.0 * np.pi * (np.arange(PHASES) + 0.5) / PHASES
        errors = errors[:, :1] * np.cos(phi) + errors[:, 1:] * np.sin(phi)
        errors, low = errors if fit.all() else errors[:, :0], None
        # |e_c cos φ + e_s sin φ| at the worst phase
        bound = None if bound is None else np.hypot(bound[:, :1], bound[:, 1:])[:, fit]
    else:
        errors, low, bound = (None if x is None else x[:, fit] for x in (errors, low, bound))
    if estimates is not None and any(isinstance(f, Values) for f in task.fields):
        estimates = estimates / task.scene.h[target] ** k  # type: ignore[union-attr]
    moments = {a: np.concatenate([b.moments[a] for b in blocks])[fit] for a in blocks[0].moments}
    moment_bound = None
    if task.bound:
        moment_bound = {
            a: np.concatenate([b.moment_rest[a] for b in blocks if b.moment_rest])[fit]
            for a in moments
        }
    worst = None
    if task.bound:
        every = [] if bound is None else [np.linalg.norm(bound, axis=0)]
        every = every or list((moment_bound or {}).values())
        sizes = [float(b.max()) for b in every if b.size]
        worst = max(sizes, default=0.0)
        if errors is not None and errors.size:  # scaling, phases, squares and their mean
            worst += 16.0 * UNIT * float(np.abs(errors).max())
        worst = worst if np.isfinite(worst) else None
    for figures in (errors, *moments.values()):
        if figures is not None and not np.all(np.isfinite(figures)):
            raise ValueError(
                "scene: a sum is beyond the range of floats; expected volumes of about h^d"
            )
    bad = np.flatnonzero(~fit)
    corrected = not task.operator.uncorrected
    bounds = sum(0 if b is None else b.size for b in [bound, *(moment_bound or {}).values()])
    return Measurement(
        settings=described(task),
        target=target,
        pairs=int(pairs.sum()),
        pairs_full=round(float(pairs.mean()) * task.scene.particles),
        corrections=int(target.size) if corrected else 0,
        bounds=int(bounds),
        flagged=int(bad.size),
        first_flagged=(int(target[bad[0]]), int(neighbours[bad[0]])) if bad.size else None,
        condition=np.where(fit, condition, np.inf),
        errors=errors,
        errors_low=low,
        estimates=estimates,
        moments=Moments(moments, task.operator.target(task.scene.dim), k, "measured"),
        error_bound=bound,
        moment_bound=moment_bound,
        rounding_bound=worst,
        exact_statistics=lattice,
        interrupted=interrupted,
        seconds=seconds,
    )
