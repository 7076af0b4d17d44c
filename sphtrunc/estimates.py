"""Estimates of an operator on explicit particles, and operators as matrices, from one pass over the
pairs: sums first, then for each target the few numbers that correct them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic import MOST_CONDITION, Health, Plain
from sphtrunc.engine import one_pass, pair_sums, pairs_with_terms, threads, volumes
from sphtrunc.fields import Sample, Values
from sphtrunc.kernel import Kernel
from sphtrunc.measurement import Block
from sphtrunc.moments import MultiIndex, add, multi_indices, unit
from sphtrunc.operators import NESTED, Key, Operator, combine
from sphtrunc.particles import Particles
from sphtrunc.summation import Array
from sphtrunc.sums import _contracted, exact_derivatives

if TYPE_CHECKING:
    from sphtrunc.experiment import Task

_NUMBERS = 1 << 19  # sums that are held at once while corrections are solved
_SAFE = 1e5  # condition up to which a small matrix is inverted by its cofactors


@dataclass(frozen=True)
class Estimates:
    """An operator at T targets.

    values: (F, C, T), C components for each of F fields, in units of A/h^k
    moments: multi-index -> (T,) of the first component
    neighbours, others: as in `PairSums`
    condition: (T,) of the worst correction matrix; where it is above 1e12 the estimate is flagged
        and means nothing
    """

    targets: Any
    values: Array
    moments: Mapping[MultiIndex, Array]
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
    field_keys = list(dict.fromkeys(key for part in shape for key in part))
    if degree is not None:
        alphas = list(multi_indices(dim, degree))
        keys += [(d, add(alpha, gamma)) for d, gamma in shape[0] for alpha in alphas]
    values = np.atleast_2d(np.asarray(fields, dtype=np.float64))
    count = 0 if values.size == 0 else len(values)
    density = None
    if operator.form == "symmetric":
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
    moments = (
        {a: np.empty(index.size) for a in multi_indices(dim, degree)} if degree is not None else {}
    )
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
        for alpha, into in moments.items():
            into[part] = combine(found[0], base, alpha)
        condition[part] = health.condition

    with ThreadPoolExecutor(threads(workers)) as pool:
        list(pool.map(finish, range(0, index.size, block)))
    if operator.uses_difference and moments:
        moments[unit(dim, 0, 0)][:] = float(operator.derivatives == 0)
    if operator.uses_difference and operator.derivatives == 0:
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
        {},
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


def solve(
    matrix: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]], health: Health
) -> list[list[Any]]:
    """Linear systems of many targets: up to 3 × 3 by cofactors, wherever that is safe, and by
    singular values otherwise."""
    n = len(matrix)
    if n > 3:
        return Plain().solve(matrix, columns, health)  # type: ignore[no-any-return]
    a = [[np.asarray(x) for x in row] for row in matrix]
    with np.errstate(all="ignore"):
        # a diagonal of ones first: the axes of a flat cloud differ in scale
        d = [1.0 / np.sqrt(np.where(a[i][i] != 0.0, np.abs(a[i][i]), 1.0)) for i in range(n)]
        scaled = [[a[i][j] * d[i] * d[j] for j in range(n)] for i in range(n)]
        inverse, size = _inverse(scaled)
        norm = sum(x * x for row in scaled for x in row)
        condition = np.sqrt(norm * size)  # Frobenius: between the condition and n times it
        inverse = [[inverse[i][j] * d[i] * d[j] for j in range(n)] for i in range(n)]
    bad = np.flatnonzero(~(condition <= _SAFE))
    health.condition = np.maximum(health.condition, np.where(condition <= _SAFE, condition, 0.0))
    with np.errstate(all="ignore"):  # what is not safe is overwritten
        result = [
            [_dot(row, [column[j] for column in columns]) for j in range(len(columns[0]))]
            for row in inverse
        ]
    if bad.size:
        rest = Health()
        wide = np.broadcast(*(x for row in a for x in row)).shape
        some = [[np.broadcast_to(x, wide)[bad] for x in row] for row in a]
        right = [[np.broadcast_to(x, wide)[bad] for x in row] for row in columns]
        exact = Plain().solve(some, right, rest)
        for i, row in enumerate(exact):
            for j, x in enumerate(row):
                result[i][j] = np.array(np.broadcast_to(result[i][j], wide))
                result[i][j][bad] = x
        worst = np.array(np.broadcast_to(health.condition, wide))
        worst[bad] = np.maximum(worst[bad], rest.condition)
        health.condition = worst
    return result


def _inverse(a: list[list[Any]]) -> tuple[list[list[Any]], Any]:
    """Inverse of a matrix up to 3 × 3 by cofactors, and the square of its Frobenius norm."""
    n = len(a)
    if n == 1:
        cofactor: list[list[Any]] = [[1.0]]
    elif n == 2:
        cofactor = [[a[1][1], -a[1][0]], [-a[0][1], a[0][0]]]
    else:
        cofactor = [
            [
                a[(i + 1) % 3][(j + 1) % 3] * a[(i + 2) % 3][(j + 2) % 3]
                - a[(i + 1) % 3][(j + 2) % 3] * a[(i + 2) % 3][(j + 1) % 3]
                for j in range(3)
            ]
            for i in range(3)
        ]
    per_determinant = 1.0 / _dot(a[0], cofactor[0])
    inverse = [[cofactor[j][i] * per_determinant for j in range(n)] for i in range(n)]
    return inverse, sum(x * x for row in inverse for x in row)


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Σ a_i b_i, without the terms whose factor is the number 0."""
    terms = [
        x if isinstance(y, int) and y == 1 else x * y
        for x, y in zip(a, b, strict=True)
        if not (isinstance(y, int) and y == 0)
    ]
    return sum(terms[1:], terms[0]) if terms else 0.0


def in_one_pass(task: Task, targets: Any, workers: int) -> Block | None:
    """What a measurement of explicit particles asks for, in one pass over the pairs; None where it
    asks for more than sums of values given at the particles."""
    scene, operator = task.scene, task.operator
    fields = [one for one in task.fields if isinstance(one, Values)]
    if not (
        isinstance(scene, Particles)
        and isinstance(task.kernel, Kernel)
        and task.precision in ("plain", "compensated")
        and not task.bound
        and len(fields) == len(task.fields)
        and not (operator.form in ("symmetric", NESTED) and task.degree is not None)
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


def weights(
    scene: Particles,
    kernel: Kernel,
    operator: Operator,
    *,
    axis: int = 0,
    targets: object = None,
    workers: int | None = None,
) -> Any:
    """The operator as a matrix: a scipy.sparse CSR array (T, n) that takes the values of a field at
    the particles to its estimate at the targets, ⟨D A⟩ = w A, in units of A/length^k.

    axis: which component of the estimate; targets: indices (T,), None for all.
    Raises ValueError as `pair_sums` does, and where a correction matrix is too near to singular.
    """
    from scipy.sparse import csr_array

    operator.require_pairs(False)
    count = len(operator.components(scene.dim))
    if not 0 <= axis < count:
        raise ValueError(f"axis: got {axis}, expected 0 to {count - 1}")
    if operator.form == NESTED:
        gradient = partial(weights, scene, kernel, operator.gradient, workers=workers)
        row = operator.axes(scene.dim)[axis]
        return sum(gradient(axis=i, targets=targets) @ gradient(axis=j) for i, j in row)
    keys = [] if operator.uncorrected else operator.needed(scene.dim, 0)
    sums = pair_sums(scene, kernel, keys, targets=targets, workers=workers)
    index = np.arange(scene.population)[sums.targets]
    health = Health()
    part = operator.coefficients(sums.base, scene.dim, partial(solve, health=health))[axis]
    condition = np.broadcast_to(health.condition, index.shape)
    bad = np.flatnonzero(~(condition <= MOST_CONDITION))
    if bad.size:
        raise ValueError(
            f"correction: the matrix of {bad.size} targets is too near to singular; the first is"
            f" particle {index[bad[0]]} with {sums.neighbours[bad[0]]} neighbours; expected a"
            " lower correction, a larger h, or other targets"
        )
    row, column, terms = pairs_with_terms(scene, kernel, list(part), index)
    per_h = 1.0 / scene.h[index]
    scale = np.ones(index.size)
    for _ in range(operator.derivatives):
        scale *= per_h
    entries = np.zeros(row.size)
    for key, c in part.items():
        entries += terms[key] * (c[row] if isinstance(c, np.ndarray) else c)
    entries *= scale[row]
    own = np.zeros(index.size)
    if operator.form == "symmetric":
        density = scene.mass / volumes(scene, kernel)
        ratio = density[index[row]] / density[column]
        own += np.bincount(row, weights=entries / ratio, minlength=index.size)
        entries *= ratio
    elif operator.uses_difference:
        own -= np.bincount(row, weights=entries, minlength=index.size)
        own += float(operator.derivatives == 0)
    size = (index.size, scene.population)
    matrix = csr_array((entries, (row, column)), shape=size)
    if np.any(own):
        matrix = csr_array(matrix + csr_array((own, (np.arange(index.size), index)), shape=size))
    matrix.sort_indices()
    return matrix
