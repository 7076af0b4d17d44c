"""Many wavelengths and operators at once: one look at the particles serves them all.

The estimate of sin(φ + k s₁) is the sum of its discrete moments along the wave, M_n = Σ_b w_b s₁ⁿ:

    ⟨D A⟩ = Σ_n kⁿ/n! M_n sin(φ + nπ/2),

so that the moments of a target, once summed, give the error at every h/λ by a small matrix product,
and, the exact moments being subtracted one by one, without the cancellation of nearby values at
small h/λ. The series ends where its terms are below the last bit; waves too short for that
(kκ > 12) are summed one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import factorial, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.arithmetic.plain import Plain
from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment import nested
from sphtrunc.experiment.blocks import evaluated, in_order
from sphtrunc.experiment.fields import Sinusoid, sinusoid
from sphtrunc.experiment.measurement import Block, Measurement
from sphtrunc.experiment.neighbour_sums import Weights, exact_derivatives
from sphtrunc.experiment.statistics import _chosen, gathered, relative_width, squares, until
from sphtrunc.experiment.task import Task, is_still
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.scenes.neighbourhood import CELLS, Indices
from sphtrunc.scenes.scene import Scene, paired

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.neighbourhood import Neighbourhood

LONGEST = 12.0  # kκ up to which the series is used: it loses e^12 of 2^53 there
MOST = 1 << 17  # targets, when rtol decides


def waves(
    scene: Scene,
    kernel: Kernel | str,
    operators: Sequence[Operator],
    h_over_lambda: Sequence[object],
    *,
    targets: object = None,
    rtol: float | None = None,
    most: int = MOST,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[list[Measurement]]:
    """`measure` for every operator (rows) and every h/λ (columns), along the first axis.

    The figures are those of `measure` with the same targets, to rounding. With `rtol` the targets
    are as many as the hardest of them needs.

    Raises ValueError for bad arguments, and for divergence and curl, which need a vector field.
    """
    started = time.perf_counter()
    from sphtrunc.kernels.parse import kernel as parse_kernel

    kernel = parse_kernel(kernel)
    for operator in operators:
        if operator.name in ("divergence", "curl"):
            raise ValueError(f"operator: {operator.name} needs a vector field; expected a scalar's")
        operator.require_pairs(paired(scene))
    fields = [sinusoid(x, dim=scene.dim) for x in h_over_lambda]
    tasks = [
        [Task(scene, kernel, operator, (field,), None, seed, "plain", False) for field in fields]
        for operator in operators
    ]
    found: list[list[list[Block]]] = [[[] for _ in fields] for _ in operators]
    size = max(1, min(4096, CELLS // max(row[0].cells for row in tasks)))

    def run(batch: Indices, expected: int) -> None:
        done = sum(block.target.size for block in found[0][0])
        chunks = [batch[i : i + size] for i in range(0, batch.size, size)]
        for table in in_order(partial(_look, tasks), chunks, workers):
            for rows, blocks in zip(found, table, strict=True):
                for row, block in zip(rows, blocks, strict=True):
                    row.append(block)
            done += table[0][0].target.size
            if progress is not None:
                progress(done, expected)

    if rtol is None or is_still(scene):
        chosen = _chosen(scene, targets, seed)
        run(chosen, chosen.size)
    else:

        def width() -> float:
            return max(
                relative_width(squares(row, operator, scene.dim))
                for rows, operator in zip(found, operators, strict=True)
                for row in rows
            )

        until(width, rtol, scene, most, seed, run)
    seconds = (time.perf_counter() - started) / (len(operators) * max(1, len(fields)))
    return [
        [gathered(task, row, False, seconds) for task, row in zip(tasks_of, rows, strict=True)]
        for tasks_of, rows in zip(tasks, found, strict=True)
    ]


def _look(tasks: Sequence[Sequence[Task]], target: Indices) -> list[list[Block]]:
    """One block of targets: the neighbourhood once, every operator on it."""
    first = tasks[0][0]
    block = first.scene.neighbourhood(target, first.kernel)
    distance = block.distance
    inside = distance <= float(first.kernel.support)
    if block.particle is not None:
        inside &= block.particle >= 0
    counts = inside.sum(axis=0), (inside & (distance > 0.0)).sum(axis=0)
    result = []
    for row in tasks:
        if row[0].operator.form == NESTED:
            result.append(_twice(row, block, target, counts))
            continue
        reach = [float(np.linalg.norm(_wave(t))) * float(t.kernel.support) for t in row]
        short = [x <= LONGEST for x in reach]
        if row[0].operator.form == SYMMETRIC and block.volume.shape != (1, 1):
            short = [False] * len(row)
        if block.ghosts is not None:  # they carry other values than those at their places
            short = [False] * len(row)
        series: list[Block] = []
        if any(short):
            kept = [t for t, s in zip(row, short, strict=True) if s]
            top = max(x for x, s in zip(reach, short, strict=True) if s)
            series = _series(kept, block, target, counts, top)
        taken = iter(series)
        result.append(
            [
                next(taken) if s else evaluated(task, target)
                for task, s in zip(row, short, strict=True)
            ]
        )
    return result


def _wave(task: Task) -> Array:
    (field,) = task.fields
    assert isinstance(field, Sinusoid)
    return field.wave()


def degree_of_series(reach: float, derivatives: int) -> int:
    """The n from which kⁿκⁿ/n! is below the last bit of (kκ)^derivatives."""
    n, term = derivatives + 2, reach**2 / factorial(derivatives + 2)
    while term > 2.0**-56 and n < 60:
        n += 1
        term *= reach / n
    return n


def _series(
    tasks: Sequence[Task],
    block: Neighbourhood,
    target: Indices,
    counts: tuple[Indices, Indices],
    reach: float,
) -> list[Block]:
    """Blocks of one operator at several wavelengths, from its moments along the wave."""
    scene, kernel, operator = tasks[0].scene, tasks[0].kernel, tasks[0].operator
    dim, m = scene.dim, operator.derivatives
    number, health = Plain(), Health()
    s = list(block.offset)
    volume = np.asarray(block.volume)
    terms = Weights(number, s, volume, kernel, operator, block.stretches(number)).terms

    def weight(term: Any, alpha: tuple[int, ...]) -> Array:
        result = terms[term]
        for axis, n in enumerate(alpha):
            for _ in range(n):
                result = result * s[axis]
        return np.asarray(result)

    sums = {}
    if not operator.uncorrected:
        sums = {key: number.total(weight(*key)) for key in operator.needed(dim, 0)}
    parts = operator.coefficients(sums, dim, partial(number.solve, health=health))
    powers = degree_of_series(reach, m) + 1
    moments = np.empty((powers, len(parts), target.size))
    for c, part in enumerate(parts):
        rows = [x if isinstance(x, int) and x == 1 else None for x in part.values()]
        total = sum(
            weight(*key) if one else x * weight(*key)
            for one, (key, x) in zip(rows, part.items(), strict=True)
        )
        work = np.array(total)
        exact = operator.target(dim, c)
        for n in range(powers):
            if n:
                work *= s[0]
            along = (n, *(0,) * (dim - 1))
            moments[n, c] = number.total(work) - exact.get(along, 0)
    moments[0] *= operator.copies
    k = np.array([float(np.linalg.norm(_wave(t))) for t in tasks])
    series = np.array([k**n / factorial(n) for n in range(powers)]).T
    sign = np.array([(1.0, 1.0, -1.0, -1.0)[n % 4] for n in range(powers)])
    series *= sign
    flat = moments.reshape(powers, -1)
    even = (series[:, ::2] @ flat[::2]).reshape(len(tasks), len(parts), -1)
    odd = (series[:, 1::2] @ flat[1::2]).reshape(len(tasks), len(parts), -1)
    if is_still(scene):
        sine, cosine = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    else:
        (field,) = tasks[0].fields
        assert isinstance(field, Sinusoid)
        sine, cosine = field.own(target, tasks[0].seed, 0)
    return _blocks(target, counts, health, list(even * sine + odd * cosine))


def _twice(
    tasks: Sequence[Task], block: Neighbourhood, target: Indices, counts: tuple[Indices, Indices]
) -> list[Block]:
    """Blocks of a nested operator at several wavelengths: its gradients once, applied to each."""
    fields = tuple(field for task in tasks for field in task.fields)
    task, number, health = replace(tasks[0], fields=fields), Plain(), Health()
    s, volume = list(block.offset), np.asarray(block.volume)
    phases = (np.array([0.0, 1.0]), np.array([1.0, 0.0]))
    lattice = is_still(task.scene)
    owns: list[Any] = [phases if lattice else f.own(target, task.seed, 0) for f in fields]
    found, _ = nested.estimate(task, number, block, s, volume, owns, health)
    errors = []
    for field, own, parts in zip(fields, owns, found, strict=True):
        truth = exact_derivatives(task.operator, [field.at(number, block, s, own)], len(s))
        assert truth is not None
        errors.append(np.stack([p - t for p, t in zip(parts, truth, strict=True)]))
    return _blocks(target, counts, health, errors)


def _blocks(
    target: Indices, counts: tuple[Indices, Indices], health: Health, errors: Sequence[Array]
) -> list[Block]:
    """One block for each wavelength."""
    shared = Block(
        target=target,
        estimates=None,
        errors=None,
        moments={},
        rest=None,
        moment_rest=None,
        pairs=counts[0],
        neighbours=counts[1],
        condition=np.broadcast_to(np.asarray(health.condition, dtype=np.float64), target.shape),
    )
    return [replace(shared, errors=one) for one in errors]


def wavenumber(h_over_lambda: float) -> float:
    """kh = 2π h/λ."""
    return 2.0 * pi * h_over_lambda
