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

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.theory.disorder.averages import scattered_moments
from sphtrunc.theory.disorder.debye_waller import finite_ratio, gaussian_shift
from sphtrunc.theory.disorder.ghosts import moved_with_ghosts
from sphtrunc.theory.disorder.leading_law import moment_rows
from sphtrunc.theory.disorder.propagation import propagate
from sphtrunc.theory.disorder.sampling import displaced
from sphtrunc.theory.disorder.sensitivities import is_smooth, mixing, second_order
from sphtrunc.theory.fields import Taylor
from sphtrunc.theory.lattice_sums import lattice_moments

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.scenes.arrangement import Arrangement

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
    scene: Arrangement,
    *,
    degree: int = 3,
    axis: int = 0,
) -> Prediction:
    """Mean and standard deviation of the moments M_α, |α| <= degree, of one component.

    Beside a wall every particle is on the side of its site; there displacements are propagated, to
    order σ⁴ where particles are few and the kernel is smooth.

    Raises ValueError for a correction whose matrix is singular on this lattice, and beside a wall
    for displaced particles on the wall, or in the nested form.
    """
    sigma, ratio, walled = scene.sigma, float(scene.dx_over_h), scene.wall is not None
    where = " on one side of a wall" if walled else ""
    if walled:
        from sphtrunc.theory.walls.moments import wall_lattice_moments as lattice_values
    else:
        lattice_values = lattice_moments
        operator.require_pairs(scene.paired)
    values = lattice_values(kernel, operator, scene, degree, axis=axis, exact=False)
    mean = {alpha: float(m) for alpha, m in values.items()}
    if sigma == 0:
        still = dict.fromkeys(mean, 0.0)
        return Prediction(sigma, scene.distribution, mean, still, f"lattice sum{where}")
    if walled and operator.form == NESTED:
        raise ValueError(
            "jitter: beside a wall there is no theory for the nested form; expected another form"
        )
    scene.require_unmoved_wall()
    if scene.wall is not None and scene.wall.ghosts != "none":
        from sphtrunc.theory.walls.moments import require

        shift, spread = moved_with_ghosts(require(kernel, operator), operator, scene, degree, axis)
        mean = {alpha: m + shift[alpha] for alpha, m in mean.items()}
        how = f"propagation through the lattice and its {scene.wall.ghosts} ghosts{where}"
        return Prediction(sigma, scene.distribution, mean, spread, how)
    # what is zero by a mirror symmetry of the lattice stays so, and so does what a form has exactly
    alphas = [a for a in values if any(a) or not operator.uses_difference]
    moving = [a for a in alphas if values[a] != 0 or not scene.at_particle or walled]
    plain = operator.uncorrected and scene.volume == "constant" and scene.distribution != "blue"
    if not plain and not walled:
        return _sampled(kernel, operator, scene, mean, alphas, moving, axis)
    slopes, index = propagate(kernel, operator, scene, degree, axis)
    mixed = mixing(scene, index)
    by_source = {a: row if mixed is None else mixed.T @ row for a, row in slopes.items()}
    variance = {a: sigma**2 * float((row * row).sum()) for a, row in by_source.items()}
    how = "first-order propagation through the lattice"
    few = mixed is None and index.size <= SECOND_ORDER and (sigma <= LARGE or walled)
    if few and is_smooth(kernel, operator, scene.positions(index), sigma * ratio):
        how = "second-order propagation through the lattice"
        excess = -1.2 if scene.distribution == "uniform" else 0.0
        more = second_order(
            lambda at: propagate(kernel, operator, scene, degree, axis, at)[0],
            index.T.shape,
            excess,
        )
        variance = {a: max(v + sigma**4 * more[a][1], 0.0) for a, v in variance.items()}
        mean |= {a: mean[a] + sigma**2 * more[a][0] for a in moving}
    elif not walled:
        averaged = scattered_moments(kernel, operator, scene, alphas, axis)
        if averaged is not None:
            how = "displacements of any size, particle by particle"
            variance |= {a: v for a, (_, v) in averaged.items()}
            mean |= {a: averaged[a][0] for a in moving}
    if scene.distribution == "gaussian" and not walled:
        part = operator.coefficients({}, scene.dim)[axis]
        for alpha in moving:
            damped = gaussian_shift(kernel, moment_rows(part, alpha), scene)
            mean[alpha] = float(values[alpha]) + (1 if any(alpha) else operator.copies) * damped
        if how.startswith("first"):
            how = "closed form for Gaussian displacements"
            for alpha in variance:
                rows = moment_rows(part, alpha)
                variance[alpha] *= finite_ratio(kernel, rows, ratio * sigma, scene.dim) ** 2
    std = {a: v**0.5 for a, v in variance.items()}
    return Prediction(sigma, scene.distribution, mean, std, how + where)


def _sampled(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    mean: dict[MultiIndex, float],
    alphas: list[MultiIndex],
    moving: list[MultiIndex],
    axis: int,
) -> Prediction:
    """From displacements of all particles, around the moments on the lattice."""
    signals = Taylor([{alpha: 1.0} for alpha in alphas])
    found = displaced(kernel, operator, scene, signals, 0.0, axis)
    shift, second = found.shift[:, 0, 0], found.second[:, 0, 0]
    spreads = np.sqrt(np.maximum(second - shift**2, 0.0))
    std = dict.fromkeys(mean, 0.0) | dict(zip(alphas, map(float, spreads), strict=True))
    known = found.known_to / np.where(second > 0, 2.0 * second, 1.0)
    mean |= {a: mean[a] + float(x) for a, x in zip(alphas, shift, strict=True) if a in moving}
    how = (
        "averages over sampled displacements of all particles, standard deviations good to"
        f" {percent(float(known.max()))}"
    )
    uncertainty = dict(zip(alphas, map(float, known), strict=True))
    return Prediction(scene.sigma, scene.distribution, mean, std, how, uncertainty)


def percent(x: float) -> str:
    """A relative uncertainty as it is said, rounded up: 0.3 %, 2.7 % or 15 %."""
    digits = 1 if x < 0.1 else 0
    return f"{ceil(100 * x * 10**digits) / 10**digits:g} %"
