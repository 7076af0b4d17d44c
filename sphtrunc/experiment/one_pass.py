"""Estimates of an operator on explicit particles, and operators as matrices, from one pass over the
pairs: sums first, then for each target the few numbers that correct them.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import MOST_CONDITION, Health
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.engine import one_pass, threads, volumes
from sphtrunc.experiment.fields import Sample, Values
from sphtrunc.experiment.measurement import Block
from sphtrunc.experiment.neighbour_sums import _contracted, exact_derivatives
from sphtrunc.operators.corrections import combine
from sphtrunc.operators.moments import MultiIndex, add, multi_indices, unit
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

if TYPE_CHECKING:
    from sphtrunc.experiment.task import Task

_NUMBERS = 1 << 19  # sums that are held at once while corrections are solved


@dataclass(frozen=True)
class Estimates:
    """An operator at T targets.

    values: (F, C, T), C components for each of F fields, in units of A/h^k
    moments: multi-index -> (T,) of each component
    neighbours, others: as in `PairSums`
    condition: (T,) of the worst correction matrix; where it is above 1e12 the estimate is flagged
        and means nothing
    """

    targets: Any
    values: Array
    moments: tuple[Mapping[MultiIndex, Array], ...]
    neighbours: Any
    others: Any
    condition: Array

    @property
    def flagged(self) -> Any:
        """(T,) where the correction matrix was too near to a singular one."""
        return ~(self.condition <= MOST_CONDITION)


def estimates(
    scene: Particles,
    kernel: Kernel,
    operator: Operator,
    fields: object = (),
    *,
    degree: int | None = None,
    targets: object = None,
    precision: str = "plain",
    workers: int | None = None,
    engine: str | None = None,
) -> Estimates:
    """The components of an operator (of divergence and curl: the gradient) applied to fields.

    fields: values at the particles, (n,) or (F, n); degree: also measure moments up to this one
    Other arguments as for `pair_sums`. The nested form takes a pass for each of its gradients.

    Raises ValueError as `pair_sums` does, and for moments of forms whose moments it does not have.
    """
    operator.require_pairs(False)
    dim = scene.dim
    if operator.form == NESTED:
        if degree is not None:
            raise ValueError("degree: moments of the nested form are measured by `measure` alone")
        options = {"precision": precision, "workers": workers, "engine": engine}
        return _nested(scene, kernel, operator, fields, targets, options)
    keys = [] if operator.uncorrected else operator.needed(dim, 0)
    shape = _structure(operator, dim)
    alphas = [] if degree is None else list(multi_indices(dim, degree))
    field_keys = list(dict.fromkeys(key for part in shape for key in part))
    if alphas:
        keys += [(d, add(a, gamma)) for part in shape for d, gamma in part for a in alphas]
    values = np.atleast_2d(np.asarray(fields, dtype=np.float64))
    count = 0 if values.size == 0 else len(values)
    density = None
    if operator.form == SYMMETRIC:
        if degree is not None:
            raise ValueError("degree: moments of the symmetric form depend on the field's density")
        density = scene.mass / volumes(scene, kernel)
        values = np.concatenate([values.reshape(count, -1) / density, density[None]])
    summed = one_pass(
        scene,
        kernel,
        dict.fromkeys(keys),
        fields=values if values.size else (),
        field_keys=field_keys if values.size else (),
        difference=operator.uses_difference,
        targets=targets,
        precision=precision,
        workers=workers,
        engine=engine,
    )
    index = np.arange(scene.population)[summed.targets]
    neighbours, others = np.empty((2, index.size), dtype=np.int64)
    out = np.empty((count, len(shape), index.size))
    moments = tuple({a: np.empty(index.size) for a in alphas} for _ in shape if alphas)
    condition = np.zeros(index.size)

    block = max(1, min(1 << 15, _NUMBERS // summed.rows.shape[1]))

    def finish(first: int) -> None:
        part = slice(first, first + block)
        health = Health()
        sums = summed.sums(part)
        base, weighted = sums.base, sums.fields
        neighbours[part], others[part] = sums.neighbours, sums.others
        found = operator.coefficients(base, dim, partial(solve, health=health))
        for c, row in enumerate(found):
            for f in range(count):
                out[f, c, part] = sum(x * weighted[key][f] for key, x in row.items())
                if density is not None:
                    own, a = density[index[part]], values[f, index[part]]
                    back = sum(x * weighted[key][-1] for key, x in row.items())
                    out[f, c, part] = own * out[f, c, part] + a * back
        for row, of_row in zip(found, moments, strict=False):
            for alpha, into in of_row.items():
                into[part] = combine(row, base, alpha)
        condition[part] = health.condition

    with ThreadPoolExecutor(threads(workers)) as pool:
        list(pool.map(finish, range(0, index.size, block)))
    for of_row in moments if operator.uses_difference else ():
        of_row[unit(dim, 0, 0)][:] = float(operator.adds_own)
    if operator.adds_own:
        out += values[:count, None, index]
    return Estimates(index, out, moments, neighbours, others, condition)


def _nested(
    scene: Particles,
    kernel: Kernel,
    operator: Operator,
    fields: object,
    targets: object,
    options: dict[str, Any],
) -> Estimates:
    """The gradient of the gradients of the fields at the targets and at their neighbours."""
    dim, gradient = scene.dim, operator.gradient
    values = np.atleast_2d(np.asarray(fields, dtype=np.float64))
    near, lists = None, []
    corrected = operator.correction != "none"
    if targets is not None or corrected:
        chosen = np.arange(scene.population) if targets is None else np.asarray(targets)
        lists = scene._neighbours(chosen, kernel)
        near = None if targets is None else np.unique(np.concatenate([chosen, *lists]).astype(int))
    inner = estimates(scene, kernel, gradient, values, targets=near, **options)
    slopes = np.zeros((len(values), dim, scene.population))
    slopes[:, :, inner.targets] = inner.values / scene.h[inner.targets]
    flat = slopes.reshape(-1, scene.population)
    outer = estimates(scene, kernel, gradient, flat, targets=targets, **options)
    second = outer.values.reshape(len(values), dim, dim, -1) * scene.h[outer.targets]
    condition = outer.condition
    if corrected:  # a gradient is as good as the worst of those that it is made of
        seen = np.zeros(scene.population)
        seen[inner.targets] = inner.condition
        around = [float(seen[one].max(initial=0.0)) for one in lists]
        condition = np.maximum(condition, np.array(around))
    parts = [sum(second[:, j, i] for i, j in row) for row in operator.axes(dim)]
    return Estimates(
        outer.targets,
        np.stack(parts, axis=1),
        (),
        outer.neighbours,
        outer.others,
        condition,
    )


def _structure(operator: Operator, dim: int) -> list[dict[Key, Any]]:
    """Which (δ, γ) the components are made of: the coefficients, of whatever value."""
    ones = dict.fromkeys(operator.needed(dim, 0), 1.0)
    return operator.coefficients(
        ones, dim, lambda matrix, columns: [[1.0] * len(columns[0]) for _ in matrix]
    )


def in_one_pass(task: Task, targets: Any, workers: int) -> Block | None:
    """What a measurement of explicit particles asks for, in one pass over the pairs; None where it
    asks for more than sums of values given at the particles."""
    scene, operator = task.scene, task.operator
    fields = [one for one in task.fields if isinstance(one, Values)]
    if not (
        isinstance(scene, Particles)
        and task.kernel.is_polynomial
        and task.precision in ("plain", "compensated")
        and not task.bound
        and len(fields) == len(task.fields)
        and not (operator.form in (SYMMETRIC, NESTED) and task.degree is not None)
    ):
        return None
    found = estimates(
        scene,
        task.kernel,
        operator,
        [one.values for one in fields],
        degree=task.degree,
        targets=targets,
        precision=task.precision,
        workers=workers,
    )
    at, h = found.targets, scene.h[found.targets]
    samples = []
    for one in fields:
        known = one.derivatives
        if known is not None:
            known = {mu: values[at] * h ** sum(mu) for mu, values in known.items()}
        samples.append(Sample(None, one.values[at], known))
    parts = _contracted(
        Operator(operator.name), [list(f) for f in found.values], samples, scene.dim
    )
    truth = exact_derivatives(operator, samples, scene.dim) if samples else None
    return Block(
        target=found.targets,
        estimates=np.stack(parts) if parts else None,
        errors=None
        if truth is None
        else np.stack([p - t for p, t in zip(parts, truth, strict=True)]),
        moments=found.moments,
        rest=None,
        moment_rest=None,
        pairs=found.neighbours,
        neighbours=found.others,
        condition=found.condition,
    )
