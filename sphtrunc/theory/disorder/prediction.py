"""Disorder: predicted mean and spread of discrete moments when particles are displaced at random.

Every particle of a lattice moves by u, independent, of standard deviation σ along each axis (in Δx
here), the target too unless it sits at an offset. Five levels, from the formula to the particles:

- the leading law for Δx/h → 0, std(M) = (σ/Δx) (Δx/h)^{1+d/2} ‖∇g‖₂, where g is the function that
  the particles sample; ‖∇g‖₂ is exact for piecewise polynomials;
- for Gaussian displacements of any size and constant volumes, mean and variance in closed form:
  every term of the reciprocal sum is damped by the Debye–Waller factor (Debye 1913,
  doi:10.1002/andp.19133480105), and V ∫ |ĝ|² (1 − e^{−σ²k²}) d^d k/(2π)^d is the variance;
- propagation through the lattice, Var = σ² Σ_b |∂M/∂x_b|², for any operator, correction and rule
  for the volumes, by carrying ∂/∂x_b with every number; to order σ⁴ where displacements are small
  and few, and no particle is near a knot where the kernel is too rough for that;
- for independent displacements and constant volumes, averages over the displacements of every
  particle, of any size (`sphtrunc.theory.disorder.averages`);
- where volumes, corrections, second neighbours or correlations tie the particles together, averages
  over sampled displacements of all of them, around the propagation through the lattice, with what
  they are good to (`sphtrunc.theory.disorder.sampling`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.sites import in_pairs
from sphtrunc.theory.disorder.averages import scattered_moments
from sphtrunc.theory.disorder.debye_waller import finite_ratio, gaussian_shift
from sphtrunc.theory.disorder.leading_law import moment_rows
from sphtrunc.theory.disorder.propagation import propagate
from sphtrunc.theory.disorder.sampling import displaced
from sphtrunc.theory.disorder.sensitivities import Stencil, is_smooth, second_order
from sphtrunc.theory.fields import Taylor
from sphtrunc.theory.lattice_sums import lattice_moments

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian

SECOND_ORDER = 240  # displacements, up to which second derivatives are taken
LARGE = 0.1  # σ/Δx from which the closed form, where there is one, is better than two orders in σ


@dataclass(frozen=True)
class Prediction:
    """Predicted moments of an estimate over the targets of a disordered scene.

    jitter: σ/Δx; distribution: of the displacements; None where it is not a lattice that they are
        of; mean, std: multi-index -> float
    how: the level of theory behind them, in a few words
    uncertainty: multi-index -> what the standard deviation is good to where displacements were
        sampled, as a part of it: three standard errors; empty where none were
    """

    jitter: float | None
    distribution: str | None
    mean: Mapping[MultiIndex, float]
    std: Mapping[MultiIndex, float]
    how: str
    uncertainty: Mapping[MultiIndex, float] = field(default_factory=dict)


def predict(
    kernel: Kernel | Gaussian,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    *,
    sigma: float = 0.0,
    distribution: str = "gaussian",
    volume: str = "constant",
    degree: int = 3,
    axis: int = 0,
) -> Prediction:
    """Mean and standard deviation of the moments M_α, |α| <= degree, of one component.

    kind, dx_over_h, offset: the lattice, and where it lies relative to the target, in Δx
    sigma: σ/Δx along each axis; distribution: "gaussian", "uniform" or "blue"
    volume: "constant", "cell" (1D) or "summation"

    Raises ValueError for a correction whose matrix is singular on this lattice.
    """
    operator.require_pairs(not sigma and in_pairs(kind, offset))
    dim = len(offset)
    values = lattice_moments(
        kernel, operator, kind, dx_over_h, offset, degree, axis=axis, exact=False, volume=volume
    )
    mean = {alpha: float(m) for alpha, m in values.items()}
    if sigma == 0:
        return Prediction(sigma, distribution, mean, dict.fromkeys(mean, 0.0), "lattice sum")
    # what is zero by a mirror symmetry of the lattice stays so, and so does what a form has exactly
    alphas = [a for a in values if any(a) or not operator.uses_difference]
    moving = [a for a in alphas if values[a] != 0 or any(offset)]
    lattice = (kernel, operator, kind, dx_over_h, offset, volume)
    if not operator.uncorrected or volume != "constant" or distribution == "blue":
        signals = Taylor([{alpha: 1.0} for alpha in alphas])
        found = displaced(*lattice, signals, 0.0, sigma, distribution, axis)
        shift, second = found.shift[:, 0, 0], found.second[:, 0, 0]
        mean |= {a: mean[a] + float(x) for a, x in zip(alphas, shift, strict=True) if a in moving}
        spreads = np.sqrt(np.maximum(second - shift**2, 0.0))
        known = found.known_to / np.where(second > 0, 2.0 * second, 1.0)
        std = dict.fromkeys(values, 0.0) | dict(zip(alphas, map(float, spreads), strict=True))
        how = (
            "averages over sampled displacements of all particles, standard deviations good to"
            f" {percent(float(known.max()))}"
        )
        uncertainty = dict(zip(alphas, map(float, known), strict=True))
        return Prediction(sigma, distribution, mean, std, how, uncertainty)
    slopes, index = propagate(*lattice, degree, axis)
    variance = {a: sigma**2 * float((row * row).sum()) for a, row in slopes.items()}
    how = "first-order propagation through the lattice"
    size = (index.shape[1], dim)
    s = Stencil(kernel, kind, dx_over_h, offset, "constant").s
    smooth = is_smooth(kernel, operator, s, sigma * float(dx_over_h))
    if size[0] * dim <= SECOND_ORDER and smooth and sigma <= LARGE:
        how = "second-order propagation through the lattice"
        excess = -1.2 if distribution == "uniform" else 0.0
        more = second_order(lambda at: propagate(*lattice, degree, axis, at)[0], size, excess)
        variance = {a: max(v + sigma**4 * more[a][1], 0.0) for a, v in variance.items()}
        mean |= {a: mean[a] + sigma**2 * more[a][0] for a in moving}
    else:
        averaged = scattered_moments(
            kernel, operator, kind, dx_over_h, offset, alphas, sigma, distribution, axis
        )
        if averaged is not None:
            how = "displacements of any size, particle by particle"
            variance |= {a: v for a, (_, v) in averaged.items()}
            mean |= {a: averaged[a][0] for a in moving}
    if distribution == "gaussian":
        part = operator.coefficients({}, dim)[axis]
        for alpha in moving:
            rows = moment_rows(part, alpha)
            damped = gaussian_shift(kernel, rows, kind, dx_over_h, offset, sigma)
            mean[alpha] = float(values[alpha]) + (1 if any(alpha) else operator.copies) * damped
        if how.startswith("first"):
            how = "closed form for Gaussian displacements"
            for alpha in variance:
                rows = moment_rows(part, alpha)
                variance[alpha] *= finite_ratio(kernel, rows, float(dx_over_h) * sigma, dim) ** 2
    std = {a: v**0.5 for a, v in variance.items()}
    return Prediction(sigma, distribution, mean, std, how)


def percent(x: float) -> str:
    """A relative uncertainty as it is said, rounded up: 0.3 %, 2.7 % or 15 %."""
    digits = 1 if x < 0.1 else 0
    return f"{ceil(100 * x * 10**digits) / 10**digits:g} %"
