"""Sums at targets: the moments of every estimate at every one of them, from one pass over the
pairs, and what they make of a field whose derivatives are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from math import factorial, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.experiment.engine import prepared, threads, volumes
from sphtrunc.experiment.engine.pairs import row_counts
from sphtrunc.experiment.one_pass import estimates as estimated
from sphtrunc.operators.corrections import combine
from sphtrunc.operators.moments import MultiIndex, add, multi_indices, unit
from sphtrunc.operators.operator import SYMMETRIC, Operator
from sphtrunc.study.snapshots.surfaces import half_space_sums
from sphtrunc.theory.limit import continuous_sum

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.experiment.engine import Work
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.terms import Key
    from sphtrunc.scenes.particles import Particles
    from sphtrunc.scenes.scene import Indices

_NUMBERS = 1 << 19  # sums that are held at once while corrections are solved


@dataclass(frozen=True, eq=False)
class Asked:
    """What is wanted of T targets, and the pass that gives it.

    own: (T,) densities of the targets, of symmetric forms
    normals: whether the gradient of γ is wanted too
    """

    work: Work
    operators: tuple[Operator, ...]
    dim: int
    degree: int
    own: Array
    normals: bool

    def cut(self, count: int) -> list[Indices]:
        """Which of the targets are in each of so many slabs (see `Work.cut`)."""
        return self.work.cut(count)

    def slab(self, which: Indices) -> Asked:
        """What is wanted of one slab."""
        return replace(self, work=self.work.slab(which), own=self.own[which])

    @property
    def size(self) -> int:
        """Bytes that are held for each target while its moments are made."""
        alphas = len(list(multi_indices(self.dim, self.degree)))
        components = sum(len(one.components(self.dim)) for one in self.operators)
        return 8 * (row_counts(self.work.plan)[2] + components * alphas + 8)


def name_of(operator: Operator) -> str:
    """Of an estimate, as part of a name of an array."""
    return f"{operator.name}_{operator.form}_{operator.correction}"


def asked(
    scene: Particles,
    kernel: Kernel,
    operators: Sequence[Operator],
    degree: int,
    targets: Indices,
    *,
    normals: bool = False,
    workers: int | None = None,
    engine: str | None = None,
) -> Asked:
    """The base sums that moments up to this degree need of all operators, nothing twice."""
    dim = scene.dim
    zero = unit(dim, 0, 0)
    alphas = list(multi_indices(dim, degree))
    keys: dict[Key, None] = {(zero, zero): None}
    weighted: dict[Key, None] = {}
    for one in operators:
        needed = {
            (delta, add(alpha, gamma)): None
            for part in _structure(one, dim)
            for delta, gamma in part
            for alpha in alphas
        }
        if one.form == SYMMETRIC:
            weighted |= needed
        else:
            keys |= needed
        if not one.uncorrected:
            keys |= dict.fromkeys(one.needed(dim, 0))
    if normals:
        keys |= {(unit(dim, axis), zero): None for axis in range(dim)}
    fields: Any = ()
    density = np.ones(scene.population)
    if weighted:
        density = scene.mass / volumes(scene, kernel)
        fields = np.stack([1.0 / density, density])
    everyone = targets.size == scene.population
    work = prepared(
        scene, kernel, keys, fields=fields, field_keys=weighted,
        targets=None if everyone else targets, workers=workers, engine=engine,
    )  # fmt: skip
    return Asked(work, tuple(operators), dim, degree, density[targets], normals)


def _structure(operator: Operator, dim: int) -> list[dict[Key, Any]]:
    """Which (δ, γ) the components are made of: the coefficients, of whatever value."""
    ones = dict.fromkeys(operator.needed(dim, 0), 1.0)
    return operator.coefficients(
        ones, dim, lambda matrix, columns: [[1.0] * len(columns[0]) for _ in matrix]
    )


def at_targets(wanted: Asked) -> dict[str, Array]:
    """gamma, condition of the worst correction, others (neighbours that are elsewhere), (T,) each;
    moments_<estimate> (T, C, A); and normal (T, d), h∇γ, if asked for."""
    dim, operators, count = wanted.dim, wanted.operators, wanted.own.size
    zero = unit(dim, 0, 0)
    alphas = list(multi_indices(dim, wanted.degree))
    summed = wanted.work.run()
    found: dict[str, Any] = {
        "gamma": np.empty(count),
        "condition": np.zeros(count),
        "others": np.empty(count, dtype=np.int64),
    }
    for one in operators:
        shape = (count, len(one.components(dim)), len(alphas))
        found[f"moments_{name_of(one)}"] = np.empty(shape)
    if wanted.normals:
        found["normal"] = np.empty((count, dim))

    def finish(first: int) -> None:
        part = slice(first, first + block)
        sums = summed.sums(part)
        found["gamma"][part], found["others"][part] = sums.base[zero, zero], sums.others
        if wanted.normals:
            for axis in range(dim):
                found["normal"][part, axis] = sums.base[unit(dim, axis), zero]
        own = wanted.own[part]
        for one in operators:
            health = Health()
            rows = one.coefficients(sums.base, dim, partial(solve, health=health))
            found["condition"][part] = np.maximum(found["condition"][part], health.condition)
            into = found[f"moments_{name_of(one)}"]
            for c, row in enumerate(rows):
                for i, alpha in enumerate(alphas):
                    if one.form == SYMMETRIC:
                        seen = {key: values[0] for key, values in sums.fields.items()}
                        into[part, c, i] = own * combine(row, seen, alpha)
                    else:
                        into[part, c, i] = combine(row, sums.base, alpha)
                if one.form == SYMMETRIC:
                    back = {key: values[1] for key, values in sums.fields.items()}
                    into[part, c, 0] += combine(row, back, zero) / own
                elif one.uses_difference:
                    into[part, c, 0] = float(one.adds_own)

    block = max(1, min(1 << 15, _NUMBERS // summed.rows.shape[1]))
    with ThreadPoolExecutor(threads(wanted.work.workers)) as pool:
        list(pool.map(finish, range(0, count, block)))
    return found


def exact_moments(operator: Operator, dim: int, degree: int) -> Array:
    """(C, A): what the moments of an estimate without error are."""
    should = [operator.target(dim, c) for c in range(len(operator.components(dim)))]
    alphas = list(multi_indices(dim, degree))
    return np.array([[float(t.get(a, 0)) for a in alphas] for t in should])


# ------------------------------------------------------------------------------ errors of a field


def derivatives_of(
    scene: Particles, kernel: Kernel, values: object, degree: int, options: Mapping[str, Any]
) -> list[Array]:
    """∂^αA of every α up to the degree at all particles, (A, n), from gradients of gradients with
    RKPM of degree 3, and the same of one degree less.

    Where too few neighbours, at surfaces, make the correction unsteady, the next lower degree
    stands for each; nothing, 0, where there is none.
    """
    dim = scene.dim
    alphas = list(multi_indices(dim, degree))
    found, levels = [], np.zeros(scene.population, dtype=np.int64)
    for less in (0, 1):
        known: dict[MultiIndex, Array] = {alphas[0]: np.asarray(values, dtype=np.float64)}
        for n in range(degree):
            lower = [alpha for alpha in alphas if sum(alpha) == n]
            rows = np.stack([known[alpha] for alpha in lower])
            slopes = np.zeros((len(lower), dim, scene.population))
            for level, order in enumerate(_ORDERS[less:]):
                here = np.flatnonzero(levels == level)
                if not here.size:
                    continue
                gradient = Operator("gradient", "difference", order)
                made = estimated(scene, kernel, gradient, rows, targets=here, **options)
                steady = made.condition <= _STEADY
                slopes[:, :, here[steady]] = made.values[:, :, steady] / scene.h[here[steady]]
                if not less:
                    levels[here[~steady]] += 1
            parts: dict[MultiIndex, list[Array]] = {}
            for row, alpha in zip(slopes, lower, strict=True):
                for axis in range(dim):
                    parts.setdefault(add(alpha, unit(dim, axis)), []).append(row[axis])
            known |= {alpha: np.mean(rows, axis=0) for alpha, rows in parts.items()}
        found.append(np.stack([known[alpha] for alpha in alphas]))
    return found


_ORDERS = ("rkpm-3", "rkpm-2", "csph")
_STEADY = 1e3  # condition of a correction: 20 of RKPM-3 inside, 1e4 and more at a surface


@dataclass(frozen=True, eq=False)
class Surface:
    """Targets whose support a plane surface cuts: which, (S,); n into the fluid, (S, d); η (S,)."""

    which: Indices
    normal: Array
    distance: Array


def errors_of_field(
    operator: Operator,
    kernel: Kernel,
    h: Array,
    moments: Array,
    derivatives: Sequence[Array],
    surface: Surface,
) -> dict[str, Any]:
    """error, own, smoothing and boundary, (T, C) each, and scale, as in `FieldErrors`.

    moments: (T, C, A); derivatives: two sets of (A, T), the better one first
    """
    dim, k = surface.normal.shape[1], operator.derivatives
    degree = next(n for n in range(99) if len(list(multi_indices(dim, n))) == moments.shape[2])
    alphas = list(multi_indices(dim, degree))
    exact = exact_moments(operator, dim, degree)
    powers = np.stack([h ** (sum(a) - k) / prod(map(factorial, a)) for a in alphas])
    first, second = (powers * d for d in derivatives)
    error = np.einsum("tca,at->tc", moments - exact, first)
    keys = operator.needed(dim, degree)
    components = range(exact.shape[0])
    sums: Any = {key: continuous_sum(kernel, key) for key in keys}
    smooth = np.array(
        [[float(row[a]) for a in alphas] for row in _corrected(operator, sums, dim, degree)]
    )
    boundary = np.zeros_like(error)
    if surface.which.size:
        sums = half_space_sums(kernel, keys, surface.normal, surface.distance)
        rows = _corrected(operator, sums, dim, degree, partial(solve, health=Health()))
        there = first[:, surface.which]
        for c in components:
            cut = np.stack([rows[c][a] + 0.0 * surface.distance for a in alphas])
            boundary[surface.which, c] = ((cut - smooth[c][:, None]) * there).sum(axis=0)
    true = np.einsum("ca,at->tc", exact, first)
    return {
        "error": error,
        "own": np.einsum("tca,at->tc", moments - exact, second) - error,
        "smoothing": np.einsum("ca,at->tc", smooth - exact, first),
        "boundary": np.where(np.isfinite(boundary), boundary, 0.0),
        "scale": float(np.sqrt((true**2).sum(axis=1).mean())),
    }


def _corrected(
    operator: Operator, sums: Any, dim: int, degree: int, solver: Any = None
) -> list[dict[MultiIndex, Any]]:
    components = range(len(operator.components(dim)))
    return [operator.correct(sums, dim, degree, c, solver) for c in components]
