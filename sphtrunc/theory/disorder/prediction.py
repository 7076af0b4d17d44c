"""Disorder: predicted mean and spread of discrete moments when particles are displaced at random.

Every particle of a lattice moves by u, independent, of standard deviation σ along each axis (in Δx
here), the target too unless it sits at an offset. Four levels, from the formula to the particles:

- the leading law for Δx/h → 0, std(M) = (σ/Δx) (Δx/h)^{1+d/2} ‖∇g‖₂, where g is the function that
  the particles sample; ‖∇g‖₂ is exact for piecewise polynomials;
- for Gaussian displacements of any size and constant volumes, mean and variance in closed form:
  every term of the reciprocal sum is damped by the Debye–Waller factor (Debye 1913,
  doi:10.1002/andp.19133480105), and V ∫ |ĝ|² (1 − e^{−σ²k²}) d^d k/(2π)^d is the variance;
- propagation through the lattice, Var = σ² Σ_b |∂M/∂x_b|², for any operator, correction and rule
  for the volumes, by carrying ∂/∂x_b with every number; to order σ⁴ where there are few neighbours
  and none is near a knot where the kernel is too rough for that (of the nested form always the
  mean, see `sphtrunc.theory.disorder.nested`);
- for independent displacements and constant volumes, averages over the displacements of every
  particle, of any size (`sphtrunc.theory.disorder.averages`), to first order in the algebra of a
  correction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.sites import in_pairs
from sphtrunc.theory.disorder.averages import scattered_moments
from sphtrunc.theory.disorder.debye_waller import finite_ratio, gaussian_shift
from sphtrunc.theory.disorder.leading_law import moment_rows
from sphtrunc.theory.disorder.nested import SecondNeighbours, mean_shift
from sphtrunc.theory.disorder.propagation import propagate
from sphtrunc.theory.disorder.sensitivities import Stencil, is_smooth, mixing, second_order
from sphtrunc.theory.fields import Taylor
from sphtrunc.theory.lattice_sums import lattice_moments

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian

SECOND_ORDER = 240  # displacements, up to which second derivatives are taken; a sixth where every
# neighbour has a correction of its own
LARGE = 0.1  # σ/Δx from which the closed form, where there is one, is better than two orders in σ


@dataclass(frozen=True)
class Prediction:
    """Predicted moments of an estimate over the targets of a disordered scene.

    jitter: σ/Δx; distribution: of the displacements; None where it is not a lattice that they are
        of; mean, std: multi-index -> float
    how: the level of theory behind them, in a few words
    """

    jitter: float | None
    distribution: str | None
    mean: Mapping[MultiIndex, float]
    std: Mapping[MultiIndex, float]
    how: str


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
    arguments = (kernel, operator, kind, dx_over_h, offset, volume, degree, axis)
    slopes, index = propagate(*arguments)
    mixed = mixing(kind, index, distribution)
    by_source = {a: row if mixed is None else mixed.T @ row for a, row in slopes.items()}
    variance = {a: sigma**2 * float((row * row).sum()) for a, row in by_source.items()}
    how = "first-order propagation through the lattice"
    # what is zero by a mirror symmetry of the lattice stays so, and so does what a form has exactly
    moving = [a for a, m in values.items() if m != 0 or any(offset)]
    if operator.uses_difference:
        moving = [a for a in moving if any(a)]
    size = (index.shape[1], dim)
    s = Stencil(kernel, kind, dx_over_h, offset, "constant").s
    smooth = is_smooth(kernel, operator, s, sigma * float(dx_over_h))
    nested = operator.form == NESTED
    independent = volume == "constant" and distribution != "blue" and not nested
    most = SECOND_ORDER // 6 if nested and operator.correction != "none" else SECOND_ORDER
    if size[0] * dim <= most and smooth and not (independent and sigma > LARGE):
        how = "second-order propagation through the lattice"
        excess = -1.2 if distribution == "uniform" else 0.0
        second = second_order(lambda at: propagate(*arguments, at)[0], size, mixed, excess)
        variance = {a: max(v + sigma**4 * second[a][1], 0.0) for a, v in variance.items()}
        mean |= {a: mean[a] + sigma**2 * second[a][0] for a in moving}
    elif independent:
        alphas = [a for a in variance if any(a) or not operator.uses_difference]
        found = scattered_moments(
            kernel, operator, kind, dx_over_h, offset, alphas, sigma, distribution, axis
        )
        if found is not None:
            how = "displacements of any size, particle by particle"
            variance |= {a: v for a, (_, v) in found.items()}
            mean |= {a: found[a][0] for a in moving}
    elif nested and distribution != "blue":
        seen = SecondNeighbours(kernel, operator, kind, dx_over_h, offset, volume)
        shift = mean_shift(kernel, seen, Taylor([{a: 1.0} for a in moving]), sigma)
        if shift is not None:
            how += "; its mean to second order"
            mean |= {a: mean[a] + float(x) for a, x in zip(moving, shift[:, axis, 0], strict=True)}
    elif not smooth:
        how += "; rough, as particles lie near knots where the kernel is not smooth"
    if operator.uncorrected and independent and distribution == "gaussian":
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
