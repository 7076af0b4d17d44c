"""Operators as sparse matrices on explicit particles."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import MOST_CONDITION, Health
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.experiment.engine import pair_sums, pairs_with_terms, volumes
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


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
    if operator.form == SYMMETRIC:
        density = scene.mass / volumes(scene, kernel)
        ratio = density[index[row]] / density[column]
        own += np.bincount(row, weights=entries / ratio, minlength=index.size)
        entries *= ratio
    elif operator.uses_difference:
        own -= np.bincount(row, weights=entries, minlength=index.size)
        own += float(operator.adds_own)
    size = (index.size, scene.population)
    matrix = csr_array((entries, (row, column)), shape=size)
    if np.any(own):
        matrix = csr_array(matrix + csr_array((own, (np.arange(index.size), index)), shape=size))
    matrix.sort_indices()
    return matrix
