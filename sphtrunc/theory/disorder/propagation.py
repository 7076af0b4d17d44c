"""Propagation: what a small displacement of every particle does to the moments of an estimate.

Every base sum over a lattice carries its derivatives with respect to the displacements u_b, and the
algebra of the operators carries them on, through corrections and volumes, to ∂M_α/∂u_b.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.dual import Dual, dual_solve
from sphtrunc.operators.moments import MultiIndex, multi_indices
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.theory.disorder.nested import SecondNeighbours
from sphtrunc.theory.disorder.sensitivities import FirstNeighbours
from sphtrunc.theory.fields import Taylor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.arrangement import Arrangement


def propagate(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    degree: int,
    axis: int = 0,
    moved: Array | None = None,
) -> tuple[dict[MultiIndex, Array], NDArray[Any]]:
    """∂M_α/∂u_b, (N, d), for displacements u in Δx, and the integer points b, (d, N).

    The target's own displacement moves every offset s_b = (x_b − x_a)/h; a fixed target (an offset)
    has none. moved: displacements, (N, d) in Δx, at which the derivative is taken.
    """
    import numpy as np

    if operator.form == NESTED:
        seen = SecondNeighbours(kernel, operator, scene, moved)
        alphas = multi_indices(seen.dim, degree)
        return {a: seen.slopes(Taylor([{a: 1.0}]))[0, axis, 0] for a in alphas}, seen.index
    near = FirstNeighbours(kernel, scene, moved)
    symmetric = operator.form == SYMMETRIC
    keys = operator.needed(near.dim, degree)
    sums = {key: near.base_sum(key, 2 if symmetric else 1) for key in keys}
    moments = operator.correct(sums, near.dim, degree, axis, dual_solve)
    if symmetric:
        zero = (0,) * near.dim
        (own,) = operator.coefficients(sums, near.dim)[axis]
        moments[zero] = sums[own] + near.base_sum(own, 0)
    none = np.zeros_like(near.s)
    slopes = {a: v.slope if isinstance(v, Dual) else none for a, v in moments.items()}
    return slopes, near.index
