"""Experiment: evaluate the discrete sums on any particles, and take statistics.

A block of targets at a time, so that memory is bounded; no result depends on the size of blocks,
on their order or on the number of threads.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from sphtrunc.arithmetic.precision import PRECISIONS, arithmetic
from sphtrunc.experiment.blocks import evaluated, in_order
from sphtrunc.experiment.fields import Bump, Field, Polynomial, Sinusoid, Values
from sphtrunc.experiment.measurement import Block, Measurement
from sphtrunc.experiment.one_pass import in_one_pass
from sphtrunc.experiment.statistics import MOST, _chosen, gathered, relative_width, squares, until
from sphtrunc.experiment.task import Task
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.neighbourhood import CELLS, Indices
from sphtrunc.scenes.particles import Particles
from sphtrunc.scenes.scene import Scene, paired

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

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
    from sphtrunc.kernels.parse import kernel as parse_kernel

    kernel = parse_kernel(kernel)
    if isinstance(operator, str):
        operator = Operator(operator, form, correction)
    operator.require_pairs(paired(scene))
    if not kernel.is_polynomial and (bound or precision in ("extended", "exact")):
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

    def run(batch: Indices, expected: int) -> None:
        size = max(1, min(4096, CELLS // task.cells))
        done = sum(block.target.size for block in blocks)
        some = [batch[first : first + size] for first in range(0, batch.size, size)]
        for block in in_order(partial(evaluated, task), some, threads):
            blocks.append(block)
            done += block.target.size
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
        if not blocks:
            raise
        interrupted = True
    return gathered(task, blocks, interrupted, time.perf_counter() - started)


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
