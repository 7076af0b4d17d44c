"""Response: the predicted error of any operator for a field, on lattices and in disorder.

The estimate of sin(φ + k·s) is sin φ E_c + cos φ E_s with sums E = Σ_b w_b f(s_b) of f = cos k·s
and sin k·s; that of a field given by its derivatives is the sum for its Taylor polynomial. Where
weights are the kernel's own, E is a plain sum of one function ψ = g f of the displacements
η_b = u_b − u_a. They have u_a in common: with the slope D and the curvature H of ⟨ψ⟩ there
(D = ⟨ψ η⟩/⟨η²⟩, and so on),

    var E = V² { Σ_b [⟨ψ_b²⟩ − ⟨ψ_b⟩² − σ²|D_b|² − ½σ⁴|H_b|²] + σ²|Σ_b D_b|² + ½σ⁴|Σ_b H_b|² + … },

in which averages over η are Gauss quadratures. Where volumes, corrections, second neighbours or
correlations tie the particles together, displacements of all of them are sampled (`sampling`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, depth
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.theory.disorder.averages import Particles
from sphtrunc.theory.disorder.nested import SecondNeighbours
from sphtrunc.theory.disorder.sampling import displaced
from sphtrunc.theory.fields import Signals, Waves
from sphtrunc.theory.walls.moments import cut_number, require

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.arrangement import Arrangement
    from sphtrunc.theory.fields import Moment
    from sphtrunc.theory.variable_h.scenes import Slope

ROUNDED = 0.42  # rms of the rounding to nearest of one number, in units of u times its size


@dataclass(frozen=True)
class Split:
    """The rms error over disorder, and over the phase of a sinusoid, relative to the largest exact
    derivative of the order of the operator.

    smoothing: of the continuous limit; discretisation: of the lattice, less the smoothing part;
    disorder: what displacements add, spread and shift of the mean; rounding: what the arithmetic
    typically adds, see `floor`; total: all of them, as they combine
    uncertainty: what the total is good to where displacements were sampled, as a part of it: three
    standard errors; 0 where nothing was
    """

    total: float
    smoothing: float
    discretisation: float
    disorder: float
    rounding: float
    uncertainty: float = 0.0


def predict_waves(
    kernel: Kernel,
    operator: Operator,
    scene: Arrangement,
    h_over_lambda: Sequence[float],
    *,
    direction: Sequence[float] | None = None,
    precision: str = "plain",
) -> list[Split]:
    """The error for sinusoids along `direction` (default: the first axis), one Split for every h/λ.

    The rest is as for `predict_fields`.
    """
    along = np.array(direction or (1.0,) + (0.0,) * (scene.dim - 1))
    waves = Waves(2 * pi * np.asarray(h_over_lambda, float), along / np.linalg.norm(along))
    return predict_fields(kernel, operator, scene, waves, precision=precision)


def predict_fields(
    kernel: Kernel,
    operator: Operator,
    scene: Arrangement,
    signals: Signals,
    *,
    precision: str = "plain",
    slope: Slope | None = None,
) -> list[Split]:
    """The error for each of K signals.

    precision: in which the sums are evaluated, as for `measure`
    slope: how h changes from particle to particle, which carry theirs along

    Displacements may be of any size. Where they are sampled, the uncertainty of the total is given;
    elsewhere it is good to 1 %, which are the orders beyond the curvature that u_a has in common.

    Raises ValueError for vector operators, where a correction is singular, beside a wall for ghosts
    and the nested form, and with a gradient of h for all that `slope` is not followed in.
    """
    if operator.name in ("divergence", "curl"):
        raise ValueError(f"operator: no prediction for {operator.name}, expected a scalar operator")
    if scene.wall is not None and (scene.wall.ghosts != "none" or operator.form == NESTED):
        raise ValueError(
            "ghosts: of fields beside a wall there is theory without ghosts, and not for the nested"
            " form; expected ghosts none and another form, or moments alone"
        )
    operator.require_pairs(scene.paired)
    dim = scene.dim
    nested = operator.form == NESTED
    exact = _exact(operator, dim, signals)
    limit = signals.limit_error(kernel, operator, _base_sums(kernel, operator, scene, slope))
    if nested:
        seen = SecondNeighbours(kernel, operator, scene)
        value, noise = seen.estimate(signals)
        neighbours = len(seen.near)
    else:
        particles = Particles(kernel, scene, slope)
        here = particles.points[:, None, :]
        value, _, noise = particles.estimate(operator, signals, here, np.ones(1))
        neighbours = particles.neighbours
    if (
        scene.paired and slope is None and isinstance(signals, Waves)
    ):  # of odd and even weights at ±s
        value[:, :, 1 - operator.derivatives % 2] = 0.0
    # what the rounding of these very sums can explain is no discretisation error
    unresolved = (depth(neighbours) + 8) * UNIT * neighbours**0.5 * noise
    noise = floor(noise, value, neighbours, precision)
    still = value - exact
    still = np.where(np.abs(still - limit) <= unresolved, limit, still)
    mean, variance, known = still, np.zeros_like(still), np.zeros(len(still))
    if scene.sigma:
        apart = scene.volume == "constant" and scene.distribution != "blue"
        if (operator.uncorrected and apart) or slope is not None:
            mean, variance = particles.scattered(operator, signals)
            mean = mean - exact
        else:
            spread = displaced(kernel, operator, scene, signals, still)
            mean = still + spread.shift
            variance = np.maximum(spread.second - spread.shift**2, 0.0)
            known = spread.known_to
    scale = 1.0 / signals.size(operator.derivatives)

    def rms(parts: Array) -> Array:
        return np.asarray(np.sqrt((parts**2).sum(axis=(1, 2))) * scale)

    rounding = rms(noise)
    total = np.sqrt(((mean**2 + variance).sum(axis=(1, 2))) * scale**2 + rounding**2)
    disorder = np.sqrt((((mean - still) ** 2 + variance).sum(axis=(1, 2))) * scale**2)
    uncertainty = known * scale**2 / np.where(known > 0, 2.0 * total**2, 1.0)
    columns = (total, rms(limit), rms(still - limit), disorder, rounding, uncertainty)
    return [Split(*(float(x) for x in row)) for row in zip(*columns, strict=True)]


def _base_sums(
    kernel: Kernel, operator: Operator, scene: Arrangement, slope: Slope | None
) -> Moment | None:
    """m[δ, α] for Δx/h → 0 beside a wall or with a gradient of h; None without either."""
    if slope is not None:
        slope.require(kernel, operator, scene)
        return partial(slope.moment, kernel)
    if scene.wall is not None:
        return partial(cut_number, require(kernel, operator), operator, eta=scene.wall.eta)
    return None


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
