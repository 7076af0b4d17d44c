"""Debye–Waller factors: displacements of any size damp a lattice sum, and bound its spread."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

from sphtrunc.kernels.factors import factor_values
from sphtrunc.kernels.kernel import SPHERE, Kernel
from sphtrunc.operators.moments import MultiIndex, unit
from sphtrunc.operators.terms import OTHERS, SLOPE, VALUE, Row, angular

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.scenes.arrangement import Arrangement


# ------------------------------------------------------------------------ finite Gaussian disorder


def finite_ratio(kernel: Kernel | Gaussian, rows: Sequence[Row], sigma: float, dim: int) -> float:
    """√[∫|ĝ|²(1 − e^{−σ²k²}) / ∫|ĝ|² σ²k²], how far the spread stays behind the leading law;
    σ in units of h. 1 where the law does not apply (its integral diverges) or no closed form of the
    function is at hand."""
    import numpy as np

    x, weight = _correlation(kernel, tuple(rows), dim)
    if x is None:
        return 1.0
    k2 = x * x
    full = float((weight * -np.expm1(-(sigma**2) * k2)).sum())
    first = float((weight * sigma**2 * k2).sum())
    return float(np.sqrt(full / first)) if first > 0 else 1.0


@lru_cache(maxsize=256)
def _correlation(
    kernel: Kernel | Gaussian, rows: tuple[Row, ...], dim: int
) -> tuple[Array | None, Array]:
    """Nodes k and weights of ∫ |ĝ(k)|² d^d k, averaged over a set of directions."""
    import numpy as np

    from sphtrunc.kernels.transform import radial

    if getattr(kernel, "smoothness", 0) < 1:
        return None, np.zeros(0)
    table = _symbol(rows)
    if table is None:
        return None, np.zeros(0)
    reach = 160.0 / min(float(kernel.support), 3.0)
    t, w = np.polynomial.legendre.leggauss(24)
    edges = np.linspace(0.0, reach, 33)
    half = np.diff(edges) / 2
    k = (edges[:-1, None] + half[:, None] * (1 + t)).ravel()
    weight = (half[:, None] * w).ravel() * k ** (dim - 1)
    powers: dict[int, Any] = {m: radial(kernel, k, dim, m) for m in {m for _, m in table}}
    total = np.zeros_like(k)
    for ((gamma, m), c), ((delta, n), e) in product(table.items(), table.items()):
        both = tuple(a + b for a, b in zip(gamma, delta, strict=True))
        angle = float(angular(both))
        if angle:
            factor = (c * np.conj(e)).real * angle
            total += factor * k ** sum(both) * powers[m] * powers[n]
    return k, weight * total


def _symbol(rows: Sequence[Row]) -> dict[tuple[MultiIndex, int], complex] | None:
    """ĝ for terms made of Ŵ and its gradient; None for others."""
    from sphtrunc.theory.reciprocal_sums import symbol

    result: dict[tuple[MultiIndex, int], complex] = {}
    for c, beta, factor in rows:
        dim = len(beta)
        if factor == VALUE:
            key = (unit(dim, 0, 0), beta)
        elif factor in (SLOPE, OTHERS) and any(beta):
            axis = next(i for i, n in enumerate(beta) if n)
            lower = tuple(n - (i == axis) for i, n in enumerate(beta))
            key, c = (unit(dim, axis), lower), -c
        else:
            return None
        for entry, value in symbol(*key).items():
            result[entry] = result.get(entry, 0) + complex(c) * value
    return result


def gaussian_shift(
    kernel: Kernel | Gaussian,
    rows: Sequence[Row],
    scene: Arrangement,
) -> float:
    """What Gaussian displacements add to the mean of a moment: the reciprocal terms, damped by
    e^{−σ²G²} (e^{−σ²G²/2} at a target that does not move), less undamped; and the particle at the
    target, which does not move relative to it, taken out of the damping."""
    import numpy as np

    from sphtrunc.theory.reciprocal_sums import shells_of

    table = _symbol(rows)
    dim, moving = scene.dim, scene.at_particle
    if table is None or getattr(kernel, "smoothness", 0) < 1:
        return 0.0
    spread = scene.sigma * float(scene.dx_over_h) * (2.0**0.5 if moving else 1.0)
    lengths, values, _ = shells_of(kernel, table, scene, 60)
    shift = float((values * np.expm1(-0.5 * (spread * lengths) ** 2)).sum())
    if moving:
        own = float(scene.dx_over_h) ** dim
        shift -= own * (
            _smeared(kernel, tuple(rows), dim, spread) - _smeared(kernel, tuple(rows), dim, 0.0)
        )
    return shift


def _smeared(kernel: Kernel | Gaussian, rows: tuple[Row, ...], dim: int, spread: float) -> float:
    """The mean of g over a Gaussian of that width around the origin."""
    import numpy as np

    rows = tuple(row for row in rows if not any(n % 2 for n in row[1]))
    if not rows:
        return 0.0
    if spread == 0:
        return float(
            sum(c * kernel.w(0.0, dim) for c, beta, k in rows if k == VALUE and not any(beta))
        )
    t, w = np.polynomial.legendre.leggauss(40)
    inner = (float(k) for k in kernel.knots if 0 < k < 9 * spread)
    cuts = sorted({0.0, 9.0 * spread, *inner})
    total = 0.0
    for a, b in pairwise(cuts):
        q = a + (b - a) / 2 * (1 + t)
        weight = (b - a) / 2 * w * q ** (dim - 1) * np.exp(-0.5 * (q / spread) ** 2)
        weight *= float(SPHERE[dim]) / (2 * np.pi * spread**2) ** (dim / 2)
        for c, beta, k in rows:
            f = factor_values(kernel, k, q, dim)
            total += float(c) * float(angular(beta)) * float((weight * q ** sum(beta) * f).sum())
    return total
