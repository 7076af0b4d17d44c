"""Steady flows: L u = f on the particles of an enclosure, what amplifies its error, its decay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.matrices import weights

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.study.flows.enclosure import Enclosure

DIRECT = 12_000  # unknowns in 3D up to which a system is factorised; in 2D all are
TOLERANCE = 1e-11  # of the residual of an iterative solution
DROPPED = 0.02  # of an incomplete factorisation
FILL = 2.0  # of an incomplete factorisation, times the entries of the matrix
SINGULAR = 1e-3  # of the smallest eigenvalue over the exact one: below, the system is singular


@dataclass(frozen=True, eq=False)
class System:
    """L u = f − k for the particles that are not on a wall.

    matrix: L, CSR (m, m), or the rows of some targets; known: k, what the values on and beyond the
    walls add to L u, (m,); free: which particles of the fluid these are
    """

    matrix: Any
    known: Array
    free: NDArray[np.int64]


def system(
    enclosure: Enclosure,
    kernel: Kernel,
    operator: Operator,
    wall: Callable[[Array], Array],
    targets: NDArray[np.int64] | None = None,
) -> System:
    """The Laplacian on an enclosure with wall values given at points (d, P).

    targets: only these rows, particles of the fluid that are on no wall
    Raises ValueError as `weights` does, and for a particle without neighbours.
    """
    from scipy.sparse import csr_array

    free = np.flatnonzero(~enclosure.on_wall)
    here = free if targets is None else targets
    try:
        rows = weights(enclosure.particles, kernel, operator, targets=here)
    except ValueError as error:
        _lonely(enclosure, kernel, str(error))
        raise
    few = np.flatnonzero(np.diff(rows.indptr) < 2)
    if few.size:
        _lonely(enclosure, kernel, "")
    whole = csr_array(rows @ enclosure.continued)
    on = np.flatnonzero(enclosure.on_wall)
    known = rows @ enclosure.wall_part(wall)
    if on.size:
        known = known + whole[:, on] @ wall(enclosure.x[:, on])
        whole = csr_array(whole[:, free])
    return System(whole, np.asarray(known), free)


def _lonely(enclosure: Enclosure, kernel: Kernel, why: str) -> None:
    """Raises ValueError, naming the first, where particles of the fluid have no neighbours."""
    from scipy.spatial import cKDTree

    found = enclosure.particles
    reach = float(kernel.support) * enclosure.h
    x = found.x.T
    box = None
    if found.period is not None:
        box = np.where(np.isfinite(found.period), found.period, 0.0)
        inside = np.where(box > 0, np.mod(x, np.where(box > 0, box, 1.0)), x)
        low = np.where(box > 0, 0.0, inside.min(axis=0))
        x = inside - low
        box = np.where(box > 0, box, 4.0 * (np.ptp(x, axis=0) + reach))
    counts = cKDTree(x, boxsize=box).query_ball_point(
        x[: enclosure.count], reach * (1 - 1e-12), return_length=True
    )
    alone = np.flatnonzero(counts < 2)
    if alone.size:
        place = ", ".join(f"{c:.4g}" for c in enclosure.x[:, alone[0]])
        raise ValueError(
            f"dx_over_h: {alone.size} of {enclosure.count} particles have no neighbours within the"
            f" support, {reach:.4g}; the first is particle {alone[0]} at ({place}); expected a"
            " larger h"
        )
    if why:
        raise ValueError(why)


class Solver:
    """L⁻¹, by a sparse factorisation, or by lgmres with an incomplete one where that is too large.

    Raises ValueError where the matrix is singular, and where iteration does not converge.
    """

    def __init__(self, matrix: Any, dim: int) -> None:
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import spilu, splu

        self.matrix = matrix
        self.direct = dim < 3 or matrix.shape[0] <= DIRECT
        try:
            if self.direct:
                self.factors = splu(csc_matrix(matrix), permc_spec="COLAMD")
            else:
                self.factors = spilu(csc_matrix(matrix), drop_tol=DROPPED, fill_factor=FILL)
        except RuntimeError as error:
            raise ValueError(
                f"the operator has no inverse on these particles: {error}; expected another form,"
                " another wall, or other particles"
            ) from None

    @property
    def entries(self) -> int:
        """Of the factors."""
        return int(self.factors.nnz)

    def __call__(self, right: Array) -> Array:
        """x of L x = right."""
        from scipy.sparse.linalg import LinearOperator, lgmres

        if self.direct:
            return np.asarray(self.factors.solve(right))
        close = LinearOperator(self.matrix.shape, self.factors.solve, dtype=float)
        x, failed = lgmres(self.matrix, right, M=close, rtol=TOLERANCE, atol=0.0, maxiter=400)
        if failed:
            raise ValueError(
                "the system did not converge in 400 rounds of lgmres; expected another form, a"
                " larger h, or fewer particles"
            )
        return np.asarray(x)

    def transposed(self, right: Array) -> Array:
        """x of Lᵀ x = right; factorised systems only."""
        return np.asarray(self.factors.solve(right, trans="T"))


def amplification(solver: Solver) -> float | None:
    """‖L⁻¹‖₂, the largest factor between the rms of τ and of e; None where L is not factorised."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    if not solver.direct:
        return None
    n = solver.matrix.shape[0]
    square = LinearOperator((n, n), lambda y: solver(solver.transposed(y)), dtype=float)
    start = np.sin(1.0 + np.arange(n))  # the same every time
    found = eigsh(square, k=1, v0=start, which="LM", return_eigenvectors=False, tol=1e-6)
    return float(np.sqrt(found[0]))


@dataclass(frozen=True, eq=False)
class Mode:
    """An eigenvalue of −L, by which a transient decays (grows, where its real part is negative),
    and its eigenvector (m,), the real part of it, of size 1."""

    value: complex
    vector: Array


def slowest(solver: Solver, count: int = 1) -> list[Mode]:
    """The modes of −L with the smallest |λ|, smallest first; empty where L is not factorised or has
    too few rows."""
    from scipy.sparse.linalg import LinearOperator, eigs

    n = solver.matrix.shape[0]
    if not solver.direct or n < count + 3:
        return []
    inverse = LinearOperator((n, n), solver, dtype=float)
    start = np.sin(1.0 + np.arange(n))
    found, vectors = eigs(inverse, k=count, v0=start, which="LM", tol=1e-10)
    order = np.argsort(-np.abs(found))
    return [
        Mode(complex(-1.0 / found[i]), np.real(vectors[:, i]) / np.abs(vectors[:, i]).max())
        for i in order
    ]


def roughness(mode: Array, index: NDArray[np.int64]) -> Array:
    """Along each axis of a lattice the part of neighbouring particles between which a mode changes
    its sign, (d,): 0 for the smoothest, 1 for a sawtooth."""
    order = {tuple(m): i for i, m in enumerate(index.T)}
    result = []
    for axis in range(len(index)):
        step = np.zeros(len(index), dtype=np.int64)
        step[axis] = 1
        pairs = [
            (i, order[tuple(m + step)]) for i, m in enumerate(index.T) if tuple(m + step) in order
        ]
        here, there = np.array(pairs).T
        strong = np.abs(mode[here] * mode[there]) > 1e-6
        result.append(float(np.mean((mode[here] * mode[there] < 0)[strong])) if strong.any() else 0)
    return np.array(result)
