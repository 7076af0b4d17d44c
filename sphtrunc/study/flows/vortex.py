"""The Taylor–Green vortex: its decay as an eigenvalue of the operator.

u = (sin kx cos ky, −cos kx sin ky) in a periodic square of side 1, k = 2π, decays as e^{−2νk²t},
and its pressure balances what it carries: the decay of each component is an eigenvalue of ν∇². On a
lattice a wave is an eigenvector of every matrix of estimates, and its eigenvalue is the symbol
Σ_b w_b e^{ik·s_b}.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.experiment.matrices import weights
from sphtrunc.study.flows.enclosure import FEWEST
from sphtrunc.theory.stencil import stencils

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.scenes.lattice import Lattice
    from sphtrunc.scenes.particles import Particles


@dataclass(frozen=True)
class Decay:
    """A decay rate over ν: exact 2k² (Σ k_i² of a box that is no square), of particles, of theory.

    rate: of the eigenvector most like the vortex; likeness: their cosine; quotient: the Rayleigh
    quotient of the vortex itself, with which the decay begins; predicted: by the symbol, None with
    the reason in `none` where there is none; spread: max and min of the eigenvalues that are one
    eigenvalue in the continuum
    """

    exact: float
    rate: float
    quotient: float
    likeness: float
    spread: tuple[float, float]
    predicted: float | None
    none: str

    @property
    def error(self) -> float:
        """rate/exact − 1."""
        return self.rate / self.exact - 1.0

    @property
    def predicted_error(self) -> float | None:
        """predicted/exact − 1."""
        return None if self.predicted is None else self.predicted / self.exact - 1.0


def symbol(kernel: Kernel, operator: Operator, lattice: Lattice, kappa: Array) -> float:
    """Σ_b w_b cos κ·s_b of an estimate of even derivatives on a lattice, in 1/h²; κ in 1/h."""
    (stencil,) = stencils(kernel, operator, lattice)
    return float(stencil.symbol(kappa.tolist()).real)


def decay(
    scene: Particles, kernel: Kernel, operator: Operator, lattice: Lattice | None = None
) -> Decay:
    """The decay of the vortex on particles in a periodic box, and on `lattice`, if they are one.

    Raises ValueError for particles that are not in a box of two dimensions, and where the operator
    is singular near the rate.
    """
    from scipy.sparse import csc_matrix, eye_array
    from scipy.sparse.linalg import LinearOperator, eigs, splu

    if scene.dim != 2 or scene.period is None or not np.all(np.isfinite(scene.period)):
        raise ValueError(
            "taylor-green: expected particles in a periodic box of two dimensions, as"
            " relaxed:glass,N=1024"
        )
    k = 2 * pi / scene.period
    exact = float((k * k).sum())
    matrix = weights(scene, kernel, operator)
    mode = np.sin(k[0] * scene.x[0]) * np.cos(k[1] * scene.x[1])
    mode /= np.sqrt(mode @ mode)
    quotient = -float(mode @ (matrix @ mode))
    # beside the eigenvalues, by more than rounding: they may be those of the lattice exactly
    shift = -quotient * (1.0 + 1e-4)
    n = scene.population
    factors = splu(csc_matrix(matrix - shift * eye_array(n)), permc_spec="COLAMD")
    inverse = LinearOperator((n, n), factors.solve, dtype=float)
    found, vectors = eigs(inverse, k=4, v0=mode + 1e-3 * np.sin(1.0 + np.arange(n)), tol=1e-13)
    rates = np.real(-(shift + 1.0 / found))
    # of the four that go together: what of the vortex lies along each
    cosine = np.abs(np.conj(vectors.T) @ mode) / np.sqrt((np.abs(vectors) ** 2).sum(axis=0))
    best = int(cosine.argmax())
    predicted, none = None, "only on lattices a wave is an eigenvector"
    if lattice is not None:
        h = float(scene.h[0])
        predicted, none = -symbol(kernel, operator, lattice, k * h) / h**2, ""
    return Decay(
        exact,
        float(rates[best]),
        quotient,
        float(cosine[best]),
        (float(rates.min()), float(rates.max())),
        predicted,
        none,
    )


def fewest_along(kernel: Kernel, dx_over_h: float, reach: int) -> int:
    """Particles along a periodic axis, so that none meets its own image."""
    return max(FEWEST, ceil(2.0 * reach * float(kernel.support) / dx_over_h) + 1)
