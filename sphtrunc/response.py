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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import pi, prod, sqrt
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.curvature import mean_shift
from sphtrunc.lattice import in_pairs, sites, units
from sphtrunc.lattice_sums import parts
from sphtrunc.moments import MultiIndex
from sphtrunc.operators import NESTED, PAIRED, Key, Operator
from sphtrunc.propagation import is_smooth, mixing, second_order
from sphtrunc.second_neighbours import SecondNeighbours
from sphtrunc.signals import Signals, Taylor, Waves
from sphtrunc.stencil import Dual, Stencil, dual_coefficients, radial_values
from sphtrunc.summation import UNIT, depth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.gaussian import Gaussian
    from sphtrunc.kernel import Kernel

    Array = NDArray[np.float64]

NODES = {1: (11, 21), 2: (5, 9), 3: (3, 5)}  # of the quadrature over η along each axis:
CALM = 0.1  # for displacements of at most this many h, and for larger ones
MOST_NODES = 1 << 17  # of that quadrature for all particles
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
    limit = signals.limit(kernel, operator) - exact
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
    noise = floor(noise, value, neighbours, precision)
    still = value - exact
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


def scattered_moments(
    kernel: Kernel | Gaussian,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    alphas: Sequence[MultiIndex],
    sigma: float,
    distribution: str,
    axis: int = 0,
) -> dict[MultiIndex, tuple[float, float]] | None:
    """Mean and variance of M_α of one component for independent displacements of any size, to first
    order in the algebra of a correction; None where there are too many particles for that.

    M_α is the estimate of s^α.
    """
    particles = _Particles(kernel, kind, dx_over_h, offset, "constant")
    if len(particles.points) * max(NODES[particles.dim]) ** particles.dim > MOST_NODES:
        return None
    result: dict[MultiIndex, tuple[float, float]] = {}
    for start in range(0, len(alphas), 8):  # few at a time, for the sake of memory
        some = alphas[start : start + 8]
        signals = Taylor([{alpha: 1.0} for alpha in some])
        mean, variance = particles.scattered(operator, signals, sigma, distribution)
        rows = zip(mean[:, axis, 0], variance[:, axis, 0], strict=True)
        result |= {a: (float(m), float(v)) for a, (m, v) in zip(some, rows, strict=True)}
    return result


def _exact(operator: Operator, dim: int, signals: Signals) -> Array:
    """What E should be, (K, C, F), less what the form adds itself."""
    rows = [sum(signals.derivative(mu) for mu in row) for row in operator.components(dim)]
    result = np.stack([np.asarray(row) for row in rows], axis=1)
    adds_own = operator.derivatives == 0 and operator.uses_difference
    return np.zeros_like(result) if adds_own else result


def _seen(operator: Operator, signals: Signals, s: Array) -> Array:
    """The fields as the form sees them, (K, F, …), for equal densities."""
    if operator.form == PAIRED:
        return np.asarray(0.5 * (signals.difference(s) - signals.difference(-s)))
    copies = 0.0 if operator.uses_difference else 2.0 if operator.form == "symmetric" else 1.0
    return np.asarray((signals.difference(s).T + copies * signals.own.T).T)


class _Particles:
    """The particles around a target on a lattice, in units of h."""

    def __init__(
        self,
        kernel: Kernel | Gaussian,
        kind: str,
        dx_over_h: Fraction,
        offset: Sequence[Fraction],
        volume: str,
    ) -> None:
        self.kernel, self.dim = kernel, len(offset)
        self.ratio = ratio = float(dx_over_h)
        self.index = sites(kind, float(kernel.support) / ratio + 1.5, tuple(offset))
        length = np.array([float(u) for u in units(kind)])
        self.points = ratio * (self.index.T * length + np.array([float(o) for o in offset]))
        self.volume = ratio**self.dim
        within = (self.points**2).sum(axis=1) < float(kernel.support) ** 2
        self.neighbours = int(within.sum())
        if volume == "summation":  # the same for all
            around = sites(kind, float(kernel.support) / ratio, (Fraction(0),) * self.dim)
            q = ratio * np.linalg.norm(around.T * length, axis=1)
            self.volume = 1.0 / float(kernel.w(q, self.dim).sum())
        self.moving = not any(offset)  # the target is a particle and moves with it
        own = (self.points == 0.0).all(axis=1)
        self.moves = np.where(own & self.moving, 0.0, 1.0)  # relative to the target

    def terms(self, keys: Sequence[Key], s: Array) -> dict[Key, Array]:
        """g_key at the offsets s, (…, d)."""
        q = np.sqrt((s * s).sum(axis=-1))
        near = q > 0
        radial: dict[str, Array] = {}

        def factor(name: str) -> Array:
            if name not in radial:
                value = np.zeros_like(q)
                value[near] = radial_values(self.kernel, name, q[near], self.dim)
                if name == "w":
                    value[~near] = self.kernel.w(0.0, self.dim)
                elif name == "w1" and not near.all() and self.kernel.curved_at_0:
                    value[~near] = self.kernel.d2w(0.0, self.dim)
                radial[name] = value
            return radial[name]

        result: dict[Key, Array] = {}
        for key in keys:
            total = np.zeros_like(q)
            for c, beta, name in parts(key):
                value = c * factor(name)
                for axis, n in enumerate(beta):
                    for _ in range(n):
                        value = value * s[..., axis]
                total += value
            if isinstance(key[0], str):
                total = np.where(near, total, 0.0)
            result[key] = total
        return result

    def scattered(
        self, operator: Operator, signals: Signals, sigma: float, distribution: str
    ) -> tuple[Array, Array]:
        """Mean and variance of E, (K, C, F), for independent displacements of any size."""
        spread = sigma * self.ratio
        eta, weight = _nodes(distribution, spread, self.dim, self.moving)
        moved = self.points[:, None, :] + eta * self.moves[:, None, None]
        kurtosis = {"gaussian": 3.0, "uniform": 1.8}[distribution]
        return self.estimate(operator, signals, moved, weight, eta, spread, kurtosis)[:2]

    def estimate(
        self,
        operator: Operator,
        signals: Signals,
        s: Array,
        weight: Array,
        eta: Array | None = None,
        spread: float = 0.0,
        kurtosis: float = 3.0,
    ) -> tuple[Array, Array, Array]:
        """Mean and variance of E, (K, C, F), and √Σ ψ², for offsets s (N, Q, d)."""
        mean, psis = self._linear(operator, signals, s, weight)
        noise = np.empty_like(mean)
        variance = np.zeros_like(mean)
        for i, c, f, psi in psis:
            center = psi @ weight
            noise[i, c, f] = self.volume * sqrt(float((psi * psi @ weight).sum()))
            if eta is None:
                continue
            scatter = float(((psi * psi) @ weight - center * center).sum())
            if self.moving:  # η_b and η_c have u_a in common: order by order in it
                for shared in self._shared(psi, weight, eta, spread, kurtosis):
                    scatter += float((shared.sum(axis=0) ** 2).sum() - (shared**2).sum())
            variance[i, c, f] = self.volume**2 * scatter
        return mean, np.maximum(variance, 0.0), noise

    def _shared(
        self, psi: Array, weight: Array, eta: Array, spread: float, kurtosis: float
    ) -> tuple[Array, Array]:
        """What u_a alone does to ⟨ψ_b⟩, in standard deviations of D·u_a (N, d) and of the parts of
        u_a·H u_a/2 (N, d, d)."""
        each = float((weight * eta[:, 0] ** 2).sum())
        fourth = float((weight * eta[:, 0] ** 4).sum()) - each**2
        still = self.moves[:, None]
        first = spread / each * ((psi * weight) @ eta) * still
        square = np.einsum("qi,qj->qij", eta, eta)
        norm = np.full((self.dim, self.dim), each**2)
        np.fill_diagonal(norm, 0.5 * fourth)
        for axis in range(self.dim):
            square[:, axis, axis] -= each
        second = np.einsum("nq,qij->nij", psi * weight, square)
        second = sqrt(0.5) * spread**2 * second / norm * still[:, :, None]
        for axis in range(self.dim):
            second[:, axis, axis] *= sqrt(0.5 * (kurtosis - 1.0))
        return first, second

    def _linear(
        self, operator: Operator, signals: Signals, s: Array, weight: Array
    ) -> tuple[Array, Iterator[tuple[int, int, int, Array]]]:
        """E at the mean base sums, and ψ of every signal, component and part, one by one."""
        dim = self.dim
        needed = [] if operator.uncorrected else operator.needed(dim, 0)
        g = self.terms(needed, s)
        slopes = np.eye(len(needed))
        means = {
            key: Dual(self.volume * float((g[key] @ weight).sum()), slope)
            for key, slope in zip(needed, slopes, strict=True)
        }
        rows = dual_coefficients(operator, means, dim)
        used = list(dict.fromkeys(key for part in rows for key in part))
        g |= self.terms([key for key in used if key not in g], s)
        seen = _seen(operator, signals, s)
        sums = {key: self.volume * np.einsum("nq,kfnq,q->kf", g[key], seen, weight) for key in used}
        mean = np.stack(
            [np.sum([x.value * sums[key] for key, x in part.items()], axis=0) for part in rows],
            axis=1,
        )

        def psis() -> Iterator[tuple[int, int, int, Array]]:
            for c, part in enumerate(rows):
                own = sum(x.value * g[key] for key, x in part.items())
                for i, f in np.ndindex(*seen.shape[:2]):
                    psi = own * seen[i, f]
                    slope = sum(x.slope * sums[key][i, f] for key, x in part.items())
                    for n, key in enumerate(needed):
                        if not slope[n]:
                            continue
                        psi = psi + float(slope[n]) * g[key]
                    yield i, c, f, psi

        return mean, psis()


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
    symmetric = operator.form == "symmetric"
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


def _nodes(distribution: str, spread: float, dim: int, moving: bool) -> tuple[Array, Array]:
    """Nodes η (Q, d) and weights (Q,) of the displacement relative to the target."""
    n = NODES[dim][spread > CALM]
    if distribution == "gaussian":
        x, w = np.polynomial.hermite_e.hermegauss(n)
        x, w = x * spread * (sqrt(2.0) if moving else 1.0), w / w.sum()
    elif not moving:
        t, w = np.polynomial.legendre.leggauss(n)
        x, w = t * spread * sqrt(3.0), w / 2.0
    else:  # the difference of two: a triangle, by a rule on each half
        t, w = np.polynomial.legendre.leggauss((n + 1) // 2)
        half = 0.5 * (1.0 + t)
        density = w * (1.0 - half)
        x = 2.0 * sqrt(3.0) * spread * np.concatenate([-half[::-1], half])
        w = np.concatenate([density[::-1], density]) / (2.0 * density.sum())
    axes = np.meshgrid(*[x] * dim, indexing="ij")
    weights = np.meshgrid(*[w] * dim, indexing="ij")
    return (
        np.stack([a.ravel() for a in axes], axis=1),
        np.asarray(prod(weights[1:], start=weights[0])).ravel(),
    )
