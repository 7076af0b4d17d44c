"""Blocks of targets: the discrete sums of a task, evaluated for some targets at once.

A block at a time, so that memory is bounded; no result depends on the size of blocks, on their
order or on the number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from sphtrunc.arithmetic.bounded import FINER, SLACK, Bounded
from sphtrunc.arithmetic.exact import DIGITS
from sphtrunc.arithmetic.extended import Extended
from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.arithmetic.precision import arithmetic
from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment import ghosts, nested
from sphtrunc.experiment.fields import Bump, Values
from sphtrunc.experiment.measurement import Block
from sphtrunc.experiment.neighbour_sums import (
    Weights,
    estimate,
    exact_derivatives,
    moments_by_fields,
)
from sphtrunc.experiment.task import Task, is_still, is_wave
from sphtrunc.operators.operator import NESTED, PAIRED, SYMMETRIC
from sphtrunc.scenes.neighbourhood import Indices, Neighbourhood, Stretches
from sphtrunc.scenes.particles import Particles
from sphtrunc.scenes.smoothing_lengths import Sloped

Chunk = TypeVar("Chunk")
Done = TypeVar("Done")


def in_order(
    work: Callable[[Chunk], Done], chunks: Sequence[Chunk], threads: int
) -> Iterator[Done]:
    """work(chunk) of every chunk, in their order; where one thread is enough none is started."""
    if threads == 1 or len(chunks) == 1:
        yield from map(work, chunks)
        return
    waiting: deque[Future[Done]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for chunk in chunks:
            waiting.append(pool.submit(work, chunk))
            if len(waiting) > 2 * threads:  # so that memory does not grow with their number
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def evaluated(task: Task, target: Indices) -> Block:
    """Measure these targets."""
    if task.precision == "exact":
        return _exactly(task, target)
    if not task.bound:
        return _evaluate(task, target, arithmetic(task.precision))
    bounded = _evaluate(task, target, Bounded(arithmetic(task.precision)))
    return _nearer(bounded, _evaluate(task, target, Extended()))


def _evaluate(task: Task, target: Indices, number: Any) -> Block:
    block = task.scene.neighbourhood(target, task.kernel, number)
    s, volume, stretches = block.offsets(number), block.volumes(number), block.stretches(number)
    owns = [one.own(target, task.seed, i) for i, one in enumerate(task.fields)]
    if is_still(task.scene) and is_wave(task.fields):
        owns = [(np.array([0.0, 1.0]), np.array([1.0, 0.0]))] * len(task.fields)
    return _sum(task, number, block, s, volume, stretches, owns, target)


def _sum(
    task: Task,
    number: Any,
    block: Neighbourhood,
    s: list[Any],
    volume: Any,
    stretches: Stretches,
    owns: list[Any],
    target: Indices,
) -> Block:
    cut = block.ghosts is not None
    samples = [
        ghosts.sampled(task, number, block, s, one, own)
        if cut
        else one.at(number, block, s, own, task.operator.form == PAIRED)
        for one, own in zip(task.fields, owns, strict=True)
    ]
    health = Health()
    if task.operator.form == NESTED:
        found, moments = nested.estimate(task, number, block, s, volume, owns, health)
        parts = found[0] if found else []
    else:
        weights = Weights(number, s, volume, task.kernel, task.operator, stretches)
        density = _density(task, number, block, volume)
        parts, moments = estimate(weights, None if cut else task.degree, samples, health, density)
        if cut and task.degree is not None:
            fields = dict(ghosts.monomials(task, number, block, s, task.degree))
            moments = moments_by_fields(weights, fields, health)
    truth = exact_derivatives(task.operator, samples, len(s)) if samples else None
    errors = None
    if truth is not None:
        errors = [p - t for p, t in zip(parts, truth, strict=True)]
    distance = block.distance
    inside = distance <= float(task.kernel.support)
    if block.particle is not None:
        inside &= block.particle >= 0
    within = inside & (distance < float(task.kernel.support))
    away = (within & (distance > 0.0)).sum(axis=0)
    return Block(
        target=target,
        estimates=_stacked(number.value, parts),
        errors=_stacked(number.value, errors),
        moments={a: _wide(number.value(m), target.size) for a, m in moments.items()},
        rest=_stacked(number.rest, errors or parts),
        moment_rest={a: _wide(number.rest(m), target.size) for a, m in moments.items()},
        pairs=inside.sum(axis=0),
        neighbours=away,
        condition=_wide(np.asarray(health.condition), target.size),
    )


def _density(task: Task, number: Any, block: Neighbourhood, volume: Any) -> Any:
    """ρ_a/ρ_b = (m_a V_b)/(m_b V_a), None where it is 1 throughout."""
    alike = block.volume.shape == (1, 1) or getattr(task.scene, "wall", None) is not None
    if task.operator.form != SYMMETRIC or (alike and block.particle is None):
        return None
    particle = block.particle
    at_target = np.all(block.offset == 0.0, axis=0)
    here = at_target if particle is None else particle == block.target
    # where there is padding the volume is 0: any finite density does
    empty = np.broadcast_to(block.volume == 0.0, here.shape)
    if np.ndim(volume) == 1:  # exact numbers, of one target
        here, empty = here[:, 0], empty[:, 0]
        particle = None if particle is None else particle[:, 0]
    if not np.all(here.any(axis=0)):
        raise ValueError("form: symmetric needs targets that are particles; expected offset 0")
    here &= np.cumsum(here, axis=0) == 1
    wide = np.ones(here.shape)
    own = number.total(number.drop(volume * number.number(wide), ~here))
    density = number.ratio(volume * number.number(wide), own)
    mass = getattr(task.scene, "mass", None)
    if mass is not None and particle is not None:
        theirs = number.number(mass[np.maximum(particle, 0)])
        density = density * number.ratio(number.number(mass[block.target] * wide), theirs)
    return number.drop(density, empty) + number.number(empty.astype(np.float64))


def _stacked(read: Callable[[Any], Array], parts: list[Any] | None) -> Array | None:
    return np.stack(np.broadcast_arrays(*[read(p) for p in parts])) if parts else None


def _nearer(bounded: Block, fine: Block) -> Block:
    """The bound by comparison with pairs of floats: the distance from them, and what they may be
    off by, a small part of the bound by error analysis; which holds as well, so that an error of
    the floats beyond it is not taken for rounding."""

    def bound(rough: Any, value: Any, rest: Any, radius: Any) -> Any:
        return np.minimum((np.abs((value - rough) + rest) + FINER * radius) * SLACK, radius)

    shown = "estimates" if bounded.errors is None else "errors"
    moments = bounded.moment_rest or {}
    return replace(
        bounded,
        rest=None
        if bounded.rest is None
        else bound(getattr(bounded, shown), getattr(fine, shown), fine.rest, bounded.rest),
        moment_rest={
            a: bound(bounded.moments[a], fine.moments[a], (fine.moment_rest or {})[a], radius)
            for a, radius in moments.items()
        },
    )


def _wide(values: Array, size: int) -> Array:
    return np.broadcast_to(values, (size,)) if np.ndim(values) < 1 else np.asarray(values)


def _exactly(task: Task, target: Indices) -> Block:
    """One target after the other in 60 digits."""
    from mpmath import workdps

    if any(isinstance(one, (Bump, Values)) for one in task.fields):
        raise ValueError("precision: exact needs a sinusoid or a polynomial as the field")
    if task.scene.volume == "summation":
        raise ValueError("precision: exact needs constant, cell or given volumes")
    number = arithmetic("exact")
    blocks = []
    with workdps(DIGITS):
        for one in target:
            offset, volume = task.scene.exact_neighbourhood(int(one), task.kernel)
            if offset.size > 30_000:
                raise ValueError(
                    f"precision: exact is for small scenes, this target has {offset.shape[1]}"
                    " neighbours; expected at most 10000"
                )
            s = [number.number(x) for x in offset]
            particle = stretch = None
            if isinstance(task.scene, Particles):
                particle, stretch = task.scene.exact_pairs(int(one), task.kernel)
            elif isinstance(task.scene, Sloped):
                stretch = task.scene.exact_stretch(int(one), task.kernel)
            seen = Neighbourhood(
                offset=offset.astype(np.float64)[:, :, None],
                volume=volume.astype(np.float64)[:, None],
                target=np.array([one]),
                particle=None if particle is None else particle[:, None],
                stretch=None if stretch is None else stretch.astype(np.float64)[:, None],
                mean_kernel=_takes_both(task.scene),
            )
            stretches: Stretches = (None,)
            if stretch is not None:
                there = number.number(stretch)
                stretches = (None, there) if seen.mean_kernel else (there,)
            owns = [f.own(np.array([one]), task.seed, i) for i, f in enumerate(task.fields)]
            waves = is_still(task.scene) and is_wave(task.fields)
            rounds = [(0.0, 1.0), (1.0, 0.0)] if waves else [None]
            for phase in rounds:
                mine = [phase or (None if own is None else (own[0][0], own[1][0])) for own in owns]
                v = number.number(volume)
                blocks.append(_sum(task, number, seen, s, v, stretches, mine, np.array([one])))
    return _joined(blocks, np.asarray(target))


def _takes_both(scene: Any) -> bool:
    """A pair takes the mean of the kernels of both its particles."""
    return "mean-kernel" in (getattr(scene, "rule", None), getattr(scene, "mode", None))


def _joined(blocks: list[Block], target: Indices) -> Block:
    """Blocks of one target each, side by side."""

    def side(values: list[Any]) -> Any:
        return (
            None
            if values[0] is None
            else np.concatenate([np.reshape(v, (*np.shape(v)[:1], -1)) for v in values], axis=1)
        )

    return Block(
        target=target,
        estimates=side([b.estimates for b in blocks]),
        errors=side([b.errors for b in blocks]),
        moments={
            a: np.concatenate([b.moments[a] for b in blocks])[: target.size]
            for a in blocks[0].moments
        },
        rest=side([b.rest for b in blocks]),
        moment_rest=None,
        pairs=np.concatenate([b.pairs for b in blocks])[: target.size],
        neighbours=np.concatenate([b.neighbours for b in blocks])[: target.size],
        condition=np.concatenate([b.condition for b in blocks])[: target.size],
    )
