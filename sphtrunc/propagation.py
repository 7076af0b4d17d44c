"""Propagation: what a small displacement of every particle does to the moments of an estimate.

Every base sum over a lattice carries its derivatives with respect to the displacements u_b, and the
algebra of the operators carries them on, through corrections and volumes, to ∂M_α/∂u_b.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from sphtrunc.moments import MultiIndex
from sphtrunc.operators import NESTED, Operator
from sphtrunc.second_neighbours import moment_slopes
from sphtrunc.stencil import Dual, Stencil, dual_solve

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sphtrunc.gaussian import Gaussian
    from sphtrunc.kernel import Kernel

    Array = NDArray[np.float64]


def propagate(
    kernel: Kernel | Gaussian,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    volume: str,
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
        return moment_slopes(kernel, operator, kind, dx_over_h, offset, volume, degree, axis, moved)
    stencil = Stencil(kernel, kind, dx_over_h, offset, volume, moved)
    symmetric = operator.form == "symmetric"
    keys = operator.needed(stencil.dim, degree)
    sums = {key: stencil.base_sum(key, 2 if symmetric else 1) for key in keys}
    moments = operator.correct(sums, stencil.dim, degree, axis, dual_solve)
    if symmetric:
        zero = (0,) * stencil.dim
        (own,) = operator.coefficients(sums, stencil.dim)[axis]
        moments[zero] = sums[own] + stencil.base_sum(own, 0)
    none = np.zeros_like(stencil.s)
    slopes = {a: v.slope if isinstance(v, Dual) else none for a, v in moments.items()}
    return slopes, stencil.index


def mixing(kind: str, index: NDArray[Any], distribution: str) -> Array | None:
    """F with u = F v, v independent and of unit variance, for particles at integer points, (N, K);
    None where the displacements u are independent themselves.

    Blue displacements are u_n = (v_n − mean v over the z nearest)/√(1 + 1/z).
    """
    import numpy as np

    from sphtrunc.lattice import KINDS

    if distribution != "blue":
        return None
    steps = KINDS[kind].nearest
    if not steps:
        raise ValueError(
            f"distribution: blue needs the same neighbours at every site, {kind} has two sorts;"
            " expected gaussian or uniform, or another lattice"
        )
    scale = (1.0 + 1.0 / len(steps)) ** -0.5
    taps = [((0,) * KINDS[kind].dim, scale), *((e, -scale / len(steps)) for e in steps)]
    places = np.concatenate([index.T + np.array(step) for step, _ in taps])
    _, inverse = np.unique(places, axis=0, return_inverse=True)
    columns = inverse.reshape(len(taps), -1)
    weights = np.zeros((index.shape[1], int(columns.max()) + 1))
    for row, (_, factor) in zip(columns, taps, strict=True):
        weights[np.arange(index.shape[1]), row] += factor
    return weights


def is_smooth(
    kernel: Kernel | Gaussian, operator: Operator, s: Array, spread: float, order: int = 3
) -> bool:
    """Whether so many derivatives of the terms exist where displacements of that standard
    deviation, in h, take most particles at s, (N, d): the second order needs three of them, and
    the mean alone two."""
    import numpy as np

    terms = {1} if operator.form == NESTED else {t for t, _ in operator.needed(s.shape[1], 0)}
    top = max(sum(term) if isinstance(term, tuple) else 1 for term in terms)
    smoothness = kernel.knot_smoothness()
    rough = [float(knot) for knot, n in smoothness.items() if knot and n < top + order - 1]
    q = np.sqrt((s * s).sum(axis=1))
    return all(np.abs(q - knot).min() > 2.5 * spread for knot in rough)


def second_order(
    slopes: Callable[[Array | None], Mapping[tuple[int, ...], Array]],
    shape: tuple[int, ...],
    mixed: Array | None,
    excess: float,
) -> dict[tuple[int, ...], tuple[float, float]]:
    """What the second and third derivatives H, T of figures M by v add: Σ H_kk/2 to the
    mean (times σ²), Σ H_kl²/2 + Σ M_k T_kll + (kurtosis − 3) Σ H_kk²/4 to the variance (times σ⁴).
    Both are differences of the slopes on both sides."""
    import numpy as np

    step = 1e-3
    count, dim = shape
    directions = np.kron(np.eye(count) if mixed is None else mixed, np.eye(dim))  # (N·d, K)
    here = slopes(None)
    curved: dict[tuple[int, ...], list[Array]] = {alpha: [] for alpha in here}
    third = {alpha: np.zeros(count * dim) for alpha in here}
    for direction in directions.T:
        moved = step * direction.reshape(shape)
        up, down = slopes(moved), slopes(-moved)
        for alpha, middle in here.items():
            curved[alpha].append((up[alpha] - down[alpha]).ravel() / (2 * step))
            third[alpha] += (up[alpha] + down[alpha] - 2 * middle).ravel() / step**2
    result = {}
    for alpha, rows in curved.items():
        h = np.array(rows) @ directions
        own = np.diag(h)
        cross = float((directions.T @ here[alpha].ravel()) @ (directions.T @ third[alpha]))
        variance = 0.5 * float((h * h).sum()) + cross + 0.25 * excess * float((own * own).sum())
        result[alpha] = 0.5 * float(own.sum()), variance
    return result
