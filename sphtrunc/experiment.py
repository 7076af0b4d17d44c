"""Experiment: evaluate the discrete sums on any particles, and take statistics.

A block of targets at a time, so that memory is bounded; no result depends on the size of blocks,
on their order or on the number of threads.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sphtrunc import nested
from sphtrunc.arithmetic import PRECISIONS, Health, arithmetic
from sphtrunc.bounded import FINER, SLACK, Bounded
from sphtrunc.digits import DIGITS, Extended
from sphtrunc.estimates import in_one_pass
from sphtrunc.fields import Bump, Field, Polynomial, Sinusoid, Values
from sphtrunc.kernel import Kernel
from sphtrunc.measurement import Block, Measurement, gathered, relative_width, squares
from sphtrunc.neighbourhood import CELLS
from sphtrunc.operators import NESTED, PAIRED, Operator
from sphtrunc.parse import kernel as parse_kernel
from sphtrunc.particles import Particles
from sphtrunc.scene import Indices, Jittered, Lattice, Neighbourhood, Scene, paired, sample
from sphtrunc.summation import Array
from sphtrunc.sums import estimate, exact_derivatives

FIRST, MOST = 2048, 1 << 20  # targets of the first batch, and at most, when rtol decides


# ------------------------------------------------------------------------------- blocks of targets


@dataclass(frozen=True)
class Task:
    """What is to be measured, fixed for all blocks."""

    scene: Scene
    kernel: Kernel
    operator: Operator
    fields: tuple[Field, ...]
    degree: int | None
    seed: int
    precision: str
    bound: bool
    rtol: float | None = None

    @property
    def cells(self) -> int:
        """The number of pairs that are looked at for a target, about."""
        rows = max(1, self.scene.rows(self.kernel))
        nested = self.operator.form == NESTED and not isinstance(self.scene, Lattice)
        return rows * rows if nested else rows

    def run(self, target: Indices) -> Block:
        """Measure these targets."""
        if self.precision == "exact":
            return _exactly(self, target)
        if not self.bound:
            return self._evaluate(target, arithmetic(self.precision))
        bounded = self._evaluate(target, Bounded(arithmetic(self.precision)))
        return _nearer(bounded, self._evaluate(target, Extended()))

    def _evaluate(self, target: Indices, number: Any) -> Block:
        extended, errors = isinstance(number, Extended), isinstance(number, Bounded)
        block = self.scene.neighbourhood(target, self.kernel, extended=extended, errors=errors)
        s, volume, stretch = block.offsets(number), block.volumes(number), block.stretches(number)
        owns = [one.own(target, self.seed, i) for i, one in enumerate(self.fields)]
        if isinstance(self.scene, Lattice) and _is_wave(self.fields):
            owns = [(np.array([0.0, 1.0]), np.array([1.0, 0.0]))] * len(self.fields)
        return self._sum(number, block, s, volume, stretch, owns, target)

    def _sum(
        self,
        number: Any,
        block: Neighbourhood,
        s: list[Any],
        volume: Any,
        stretch: Any,
        owns: list[Any],
        target: Indices,
    ) -> Block:
        samples = [
            one.at(number, block, s, own, self.operator.form == PAIRED)
            for one, own in zip(self.fields, owns, strict=True)
        ]
        health = Health()
        if self.operator.form == NESTED:
            found, moments = nested.estimate(self, number, block, s, volume, owns, health)
            parts = found[0] if found else []
        else:
            parts, moments = estimate(
                number,
                s,
                volume,
                self.kernel,
                self.operator,
                self.degree,
                samples,
                health,
                stretch,
                self._density(number, block, volume),
            )
        truth = exact_derivatives(self.operator, samples, len(s)) if samples else None
        errors = None
        if truth is not None:
            errors = [p - t for p, t in zip(parts, truth, strict=True)]
        distance = np.sqrt(sum(x * x for x in block.offset))
        if block.stretch is not None:
            distance = distance * block.stretch
        inside = distance <= float(self.kernel.support)
        if block.particle is not None:
            inside &= block.particle >= 0
        within = inside & (distance < float(self.kernel.support))
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

    def _density(self, number: Any, block: Neighbourhood, volume: Any) -> Any:
        """ρ_a/ρ_b = (m_a V_b)/(m_b V_a), None where it is 1 throughout."""
        if self.operator.form != "symmetric" or (
            block.volume.shape == (1, 1) and block.particle is None
        ):
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
        mass = getattr(self.scene, "mass", None)
        if mass is not None and particle is not None:
            theirs = number.number(mass[np.maximum(particle, 0)])
            density = density * number.ratio(number.number(mass[block.target] * wide), theirs)
        return number.drop(density, empty) + number.number(empty.astype(np.float64))


def _is_wave(fields: tuple[Field, ...]) -> bool:
    return bool(fields) and all(isinstance(one, Sinusoid) for one in fields)


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
            seen = Neighbourhood(
                offset=offset.astype(np.float64)[:, :, None],
                volume=volume.astype(np.float64)[:, None],
                target=np.array([one]),
                particle=None if particle is None else particle[:, None],
                stretch=None if stretch is None else stretch.astype(np.float64)[:, None],
            )
            stretch = None if stretch is None else number.number(stretch)
            owns = [f.own(np.array([one]), task.seed, i) for i, f in enumerate(task.fields)]
            waves = isinstance(task.scene, Lattice) and _is_wave(task.fields)
            rounds = [(0.0, 1.0), (1.0, 0.0)] if waves else [None]
            for phase in rounds:
                mine = [phase or (None if own is None else (own[0][0], own[1][0])) for own in owns]
                v = number.number(volume)
                blocks.append(task._sum(number, seen, s, v, stretch, mine, np.array([one])))
    return _joined(blocks, np.asarray(target))


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


# ------------------------------------------------------------------------------------------ measure


def measure(
    scene: Scene,
    kernel: Kernel | str,
    operator: Operator | str = "gradient",
    field: Field | list[Field] | None = None,
    *,
    form: str | None = None,
    correction: str = "none",
    moments: int | None = None,
    targets: object = None,
    rtol: float | None = None,
    most: int = MOST,
    seed: int = 0,
    precision: str = "plain",
    bound: bool = False,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Measurement:
    """Evaluate an SPH operator on the particles of a scene.

    scene: from `lattice`, `jittered`, `graded` or `particles`
    kernel, operator, form, correction: as for `derive`
    field: from `sinusoid`, `polynomial`, `field`, or `Values`; a list of d for divergence and curl
        (one field there: all components alike, with phases of their own); None: moments only
    moments: measure M_α of the first component up to this degree (default: 3 without a field)
    targets: a number of them, drawn at random; "all"; or an index array. Default: all of explicit
        particles and lattices, 4096 of a jittered scene
    rtol: instead, as many as make the half-width of the 95 % confidence interval of the rms error
        (without a field: of the rms of M_α − M_α^exact for the operator's own α) less than this
        part of it, at most `most`
    precision: "plain", "compensated", "extended" or "exact"
    bound: add a rigorous bound of all rounding errors (plain and compensated)
    workers: threads; the result does not depend on it
    progress: called with the numbers of targets done and expected

    Raises ValueError for bad arguments.
    """
    started = time.perf_counter()
    kernel = parse_kernel(kernel)
    if isinstance(operator, str):
        operator = Operator(operator, form, correction)
    operator.require_pairs(paired(scene))
    if not isinstance(kernel, Kernel) and (bound or precision in ("extended", "exact")):
        raise ValueError(
            f"precision: sums with {kernel.name}, which is not a polynomial, are plain or"
            " compensated and have no bound; expected another kernel"
        )
    fields = _fields(field, operator, scene)
    degree = _degree(moments, operator, bool(fields))
    if precision not in PRECISIONS or bound:
        arithmetic(precision, bound)
    task = Task(scene, kernel, operator, fields, degree, seed, precision, bound, rtol)
    blocks: list[Block] = []
    interrupted = False
    threads = _threads(workers, precision)
    ahead = 2 * threads  # blocks under way, so that memory does not grow with their number
    with ThreadPoolExecutor(threads) as pool:

        def run(batch: Indices, expected: int) -> None:
            size = max(1, min(4096, CELLS // task.cells))
            done = sum(block.target.size for block in blocks)
            waiting: deque[Future[Block]] = deque()
            for first in range(0, batch.size + ahead * size, size):
                if first < batch.size:
                    waiting.append(pool.submit(task.run, batch[first : first + size]))
                if waiting and (len(waiting) > ahead or first >= batch.size):
                    blocks.append(waiting.popleft().result())
                    done += blocks[-1].target.size
                    if progress is not None:
                        progress(done, expected)

        try:
            if rtol is None:
                chosen = _chosen(scene, targets, seed)
                whole = in_one_pass(task, chosen, threads)
                if whole is None:
                    run(chosen, chosen.size)
                else:
                    blocks.append(whole)
            else:
                if targets is not None:
                    raise ValueError("targets: got targets and rtol; expected one of them")

                def width() -> float:
                    return relative_width(squares(blocks, operator, scene.dim))

                until(width, rtol, scene, most, seed, run)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            if not blocks:
                raise
            interrupted = True
    return gathered(task, blocks, interrupted, time.perf_counter() - started)


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
    limit = min(most, scene.population)
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
        targets = 4096 if isinstance(scene, Jittered) else "all"
    if isinstance(targets, str):
        if targets != "all":
            raise ValueError(f"targets: got {targets!r}, expected a number, 'all' or indices")
        if population > 2**26:
            raise ValueError(
                f"targets: this scene has {population} particles; expected a number of them"
            )
        return np.arange(population, dtype=np.int64)
    if isinstance(targets, (int, np.integer)) and not isinstance(targets, bool):
        if not 1 <= targets <= 2**26:
            raise ValueError(f"targets: got {targets}, expected at least 1 and at most 2^26")
        return sample(scene, 0, min(int(targets), population), seed)
    index = np.asarray(targets)
    if index.ndim != 1 or index.dtype.kind not in "iu" or not index.size:
        raise ValueError("targets: expected a number, 'all' or a list of indices")
    if index.min() < 0 or index.max() >= population:
        raise ValueError(f"targets: expected indices from 0 to {population - 1}")
    return index.astype(np.int64)


def _fields(
    field: Field | list[Field] | None, operator: Operator, scene: Scene
) -> tuple[Field, ...]:
    dim = scene.dim
    vector = operator.name in ("divergence", "curl")
    if field is None:
        return ()
    fields = tuple(field) if isinstance(field, (list, tuple)) else (field,) * (dim if vector else 1)
    if len(fields) != (dim if vector else 1):
        raise ValueError(
            f"field: got {len(fields)} components for {operator.name} in {dim}D, expected"
            f" {dim if vector else 1}"
        )
    for one in fields:
        if not isinstance(one, (Sinusoid, Polynomial, Bump, Values)):
            raise ValueError(
                f"field: got {type(one).__name__}, expected a field made by sinusoid, polynomial,"
                " field or Values"
            )
        if isinstance(one, Values) and one.values.shape != (scene.population,):
            raise ValueError(
                f"field: got values of shape {one.values.shape}, expected ({scene.population},)"
            )
        if isinstance(one, Values) and not isinstance(scene, Particles):
            raise ValueError("field: values belong to explicit particles; expected another field")
        if isinstance(one, Sinusoid) and len(one.direction) != dim:
            raise ValueError(
                f"field: got a sinusoid in {len(one.direction)}D, expected one in {dim}D"
            )
    return fields


def _degree(moments: int | None, operator: Operator, has_field: bool) -> int | None:
    if moments is None:
        return None if has_field else 3
    if isinstance(moments, bool) or not isinstance(moments, int) or not 0 <= moments <= 20:
        raise ValueError(f"moments: got {moments!r}, expected a degree from 0 to 20")
    return moments


def _threads(workers: int | None, precision: str) -> int:
    if workers is None:
        return 1 if precision == "exact" else min(8, os.cpu_count() or 1)
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= 1024:
        raise ValueError(f"workers: got {workers!r}, expected a number of threads from 1 to 1024")
    return 1 if precision == "exact" else workers
