"""Response: the predicted error of any operator for a field, on lattices and in disorder.

The estimate of sin(φ + k·s) is sin φ E_c + cos φ E_s with sums E = Σ_b w_b f(s_b) of f = cos k·s
and sin k·s; that of a field given by its derivatives is the sum for its Taylor polynomial. The
weights of a corrected operator depend on base sums m. Around their means

    E ≈ E(m̄) + V Σ_b [ψ(s_b) − ⟨ψ(s_b)⟩],   ψ = Σ_key c_key g_key f + Σ_key (∂E/∂m_key) g_key,

so that the spread of any estimate is that of a plain sum of one function ψ: first order in the
algebra of a correction, but of any size in the displacements η_b = u_b − u_a. They have u_a in
common: with the slope D and the curvature H of ⟨ψ⟩ there (D = ⟨ψ η⟩/⟨η²⟩, and so on),

    var E = V² { Σ_b [⟨ψ_b²⟩ − ⟨ψ_b⟩² − σ²|D_b|² − ½σ⁴|H_b|²] + σ²|Σ_b D_b|² + ½σ⁴|Σ_b H_b|² + … }.

Averages over η are Gauss quadratures. Where volumes or displacements depend on one another, sums
carry their derivatives with respect to every displacement instead (`propagation`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, depth
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.scenes.sites import in_pairs
from sphtrunc.theory.disorder.averages import _Particles
from sphtrunc.theory.disorder.nested import SecondNeighbours, mean_shift
from sphtrunc.theory.disorder.sensitivities import (
    Stencil,
    dual_coefficients,
    is_smooth,
    mixing,
    second_order,
)
from sphtrunc.theory.fields import Signals, Waves

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
FEW = 60  # displacements, up to which the second order in them is taken
ROUNDED = 0.42  # rms of the rounding to nearest of one number, in units of u times its size


@dataclass(frozen=True)
class Split:
    """The rms error over disorder, and over the phase of a sinusoid, relative to the largest exact
    derivative of the order of the operator.

    smoothing: of the continuous limit; discretisation: of the lattice, less the smoothing part;
    disorder: what displacements add, spread and shift of the mean; rounding: what the arithmetic
    typically adds, see `floor`; total: all of them, as they combine
    """

    total: float
    smoothing: float
    discretisation: float
    disorder: float
    rounding: float


def predict_waves(
    kernel: Kernel,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    h_over_lambda: Sequence[float],
    *,
    direction: Sequence[float] | None = None,
    sigma: float = 0.0,
    distribution: str = "gaussian",
    volume: str = "constant",
    precision: str = "plain",
) -> list[Split]:
    """The error for sinusoids along `direction` (default: the first axis), one Split for every h/λ.

    The rest is as for `predict_fields`.
    """
    along = np.array(direction or (1.0,) + (0.0,) * (len(offset) - 1))
    kappa = 2 * pi * np.asarray(h_over_lambda, dtype=np.float64)
    return predict_fields(
        kernel, operator, kind, dx_over_h, offset, Waves(kappa, along / np.linalg.norm(along)),
        sigma=sigma, distribution=distribution, volume=volume, precision=precision,
    )  # fmt: skip


def predict_fields(
    kernel: Kernel,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    signals: Signals,
    *,
    sigma: float = 0.0,
    distribution: str = "gaussian",
    volume: str = "constant",
    precision: str = "plain",
) -> list[Split]:
    """The error for each of K signals.

    kind, dx_over_h, offset: the lattice and where it lies relative to the target, in Δx
    sigma, distribution: of the displacements, σ/Δx along each axis
    volume: "constant", or "cell" (1D) or "summation": displacements to first order, as those of
        "blue" are, and to second order where they are few. So is the spread of the nested form,
        but its mean is of second order where volumes are constant and displacements independent
    precision: in which the sums are evaluated, as for `measure`

    Elsewhere displacements may be of any size, and only the algebra of a correction is taken to
    first order. At Δx/h = 0.7 this leaves the errors of RKPM and of Fatehi–Manzari within 3 % at
    σ/Δx = 0.05, up to 12 % too low at 0.1 and 20 % at 0.2, in 1D, where neighbours are fewest, and
    about half of that in 2D and 3D; those of Shepard and CSPH within 2 %. Those of the nested form
    are within 3 % at 0.05 and 5 % at 0.1 of the prediction, and up to 35 % off at 0.2, in 1D.

    Raises ValueError for vector operators, and where a correction is singular.
    """
    if operator.name in ("divergence", "curl"):
        raise ValueError(f"operator: no prediction for {operator.name}, expected a scalar operator")
    pairs = not sigma and in_pairs(kind, offset)
    operator.require_pairs(pairs)
    dim = len(offset)
    nested = operator.form == NESTED
    exact = _exact(operator, dim, signals)
    limit = signals.limit_error(kernel, operator)
    if nested:
        seen = SecondNeighbours(kernel, operator, kind, dx_over_h, offset, volume)
        value, noise = seen.estimate(signals)
        neighbours = len(seen.near)
    else:
        particles = _Particles(kernel, kind, dx_over_h, offset, volume)
        here = particles.points[:, None, :]
        value, _, noise = particles.estimate(operator, signals, here, np.ones(1))
        neighbours = particles.neighbours
    if pairs and isinstance(signals, Waves):  # of odd and even weights at ±s
        value[:, :, 1 - operator.derivatives % 2] = 0.0
    # what the rounding of these very sums can explain is no discretisation error
    unresolved = (depth(neighbours) + 8) * UNIT * neighbours**0.5 * noise
    noise = floor(noise, value, neighbours, precision)
    still = value - exact
    still = np.where(np.abs(still - limit) <= unresolved, limit, still)
    mean, variance = still, np.zeros_like(still)
    if sigma:
        if nested or volume != "constant" or distribution == "blue":
            stencil = (
                partial(SecondNeighbours, kernel, operator) if nested else partial(Stencil, kernel)
            )
            shift, variance = _propagated(
                kernel,
                lambda moved: stencil(kind, dx_over_h, offset, volume, moved),
                operator, signals, sigma, distribution, kind,
            )  # fmt: skip
            mean = still + shift
        else:
            mean, variance = particles.scattered(operator, signals, sigma, distribution)
            mean = mean - exact
    scale = 1.0 / signals.size(operator.derivatives)

    def rms(parts: Array) -> Array:
        return np.asarray(np.sqrt((parts**2).sum(axis=(1, 2))) * scale)

    rounding = rms(noise)
    total = np.sqrt(((mean**2 + variance).sum(axis=(1, 2))) * scale**2 + rounding**2)
    disorder = np.sqrt((((mean - still) ** 2 + variance).sum(axis=(1, 2))) * scale**2)
    columns = (total, rms(limit), rms(still - limit), disorder, rounding)
    return [Split(*(float(x) for x in row)) for row in zip(*columns, strict=True)]


def floor(noise: Array, estimate: Array, neighbours: int, precision: str) -> Array:
    """The rms rounding error of a sum Σ w_b A_b in plain, compensated, extended, exact precision.

    noise: √Σ (w_b A_b)²; estimate: what the terms add up to. A term is rounded five times (kernel
    2, volume, field, product); folded, it takes part in a rounded sum at each of ⌈log₂ n⌉ levels,
    if the sum is not compensated; the estimate is rounded as such and less the exact derivative.
    """
    unit = {"extended": UNIT**2, "exact": 0.0}.get(precision, UNIT)
    levels = 0 if precision == "compensated" else depth(neighbours)
    return np.asarray(ROUNDED * unit * np.sqrt((5 + levels) * noise**2 + 2 * estimate**2))


def _exact(operator: Operator, dim: int, signals: Signals) -> Array:
    """What E should be, (K, C, F), less what the form adds itself."""
    rows = [sum(signals.derivative(mu) for mu in row) for row in operator.components(dim)]
    result = np.stack([np.asarray(row) for row in rows], axis=1)
    return np.zeros_like(result) if operator.adds_own else result


def _propagated(
    kernel: Kernel,
    stencil: Callable[[Array | None], Stencil | SecondNeighbours],
    operator: Operator,
    signals: Signals,
    sigma: float,
    distribution: str,
    kind: str,
) -> tuple[Array, Array]:
    """The shift of the mean of E and its variance, (K, C, F), to first order in the displacements,
    and to the next where they are few; of the nested form the shift always, see `curvature`."""
    still = stencil(None)
    mixed = mixing(kind, still.index, distribution)
    slopes = _slopes(still, operator, signals)
    shape = tuple(1 + max(axis) for axis in zip(*slopes, strict=True))
    shift, variance = np.zeros(shape), np.zeros(shape)
    for key, slope in slopes.items():
        own = slope if mixed is None else mixed.T @ slope
        variance[key] = sigma**2 * float((own**2).sum())
    if still.s.size <= FEW and is_smooth(kernel, operator, still.s, sigma * still.ratio):
        excess = -1.2 if distribution == "uniform" else 0.0
        found = second_order(
            lambda moved: _slopes(stencil(moved), operator, signals), still.s.shape, mixed, excess
        )
        for key, (curved, more) in found.items():
            shift[key] = sigma**2 * curved
            variance[key] += sigma**4 * more
    elif isinstance(still, SecondNeighbours) and mixed is None:
        moved = mean_shift(kernel, still, signals, sigma)
        shift = shift if moved is None else moved
    return shift, np.maximum(variance, 0.0)


def _slopes(
    stencil: Stencil | SecondNeighbours, operator: Operator, signals: Signals
) -> dict[tuple[int, ...], Array]:
    """∂E/∂u_b, (N, d), of every signal, component and part."""
    if isinstance(stencil, SecondNeighbours):
        return stencil.slopes(signals)
    needed = [] if operator.uncorrected else operator.needed(stencil.dim, 0)
    rows = dual_coefficients(operator, {key: stencil.base_sum(key) for key in needed}, stencil.dim)
    sampled = {key: stencil.sampled(key) for key in dict.fromkeys(k for part in rows for k in part)}
    difference, ahead = signals.difference(stencil.s), signals.gradient(stencil.s)
    symmetric = operator.form == SYMMETRIC
    result: dict[tuple[int, ...], Array] = {}
    for c, part in enumerate(rows):
        g, dg = (
            np.sum([x.value * sampled[key][i] for key, x in part.items()], axis=0) for i in (0, 1)
        )
        for i, f in np.ndindex(*difference.shape[:2]):
            own = 0.0 if operator.uses_difference else signals.own[i, f]
            seen = difference[i, f] + own
            climb = dg * seen[:, None] + g[:, None] * ahead[i, f]
            slope = stencil.total(g * seen, climb, 2 if symmetric else 1).slope
            if symmetric:
                slope = slope + own * stencil.total(g, dg, 0).slope
            for key, x in part.items():
                slope = slope + float(stencil.volumes @ (sampled[key][0] * seen)) * x.slope
            result[i, c, f] = slope
    return result
