"""Response: the predicted error of any operator for a sinusoid, on lattices and in disorder.

The estimate of sin(φ + k s₁) is sin φ E_c + cos φ E_s with sums E = Σ_b w_b f(s_b) of f = cos k s₁
and sin k s₁, and the weights of a corrected operator depend on base sums m. Around their means

    E ≈ E(m̄) + V Σ_b [ψ(s_b) − ⟨ψ(s_b)⟩],   ψ = Σ_key c_key g_key f + Σ_key (∂E/∂m_key) g_key,

so that the spread of any estimate is that of a plain sum of one function ψ: first order in the
algebra of a correction, but of any size in the displacements η_b = u_b − u_a. They have u_a in
common: with the slope D and the curvature H of ⟨ψ⟩ there (D = ⟨ψ η⟩/⟨η²⟩, and so on),

    var E = V² { Σ_b [⟨ψ_b²⟩ − ⟨ψ_b⟩² − σ²|D_b|² − ½σ⁴|H_b|²] + σ²|Σ_b D_b|² + ½σ⁴|Σ_b H_b|² + … }.

Averages over η are Gauss quadratures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import factorial, pi, prod, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.kernel import SPHERE
from sphtrunc.lattice import sites, units
from sphtrunc.lattice_sums import parts
from sphtrunc.moments import MultiIndex, unit
from sphtrunc.operators import Key, Operator
from sphtrunc.propagation import Dual, dual_solve, mixing, radial_values

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernel import Kernel

    Array = NDArray[np.float64]

NODES = {1: (11, 21), 2: (5, 9), 3: (3, 5)}  # of the quadrature over η along each axis:
CALM = 0.1  # for displacements of at most this many h, and for larger ones
UNIT = 2.0**-53
_SERIES = 60  # terms of the continuous limit


@dataclass(frozen=True)
class Split:
    """The rms over phase and disorder of the error, relative to the largest exact derivative.

    smoothing: of the continuous limit; discretisation: of the lattice, less the smoothing part;
    disorder: what displacements add, spread and shift of the mean; rounding: what double precision
    typically adds; total: all of them, as they combine
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
    sigma: float = 0.0,
    distribution: str = "gaussian",
    volume: str = "constant",
) -> list[Split]:
    """The error for sinusoids along the first axis, one Split for every h/λ.

    kind, dx_over_h, offset: the lattice and where it lies relative to the target, in Δx
    sigma, distribution: of the displacements, σ/Δx along each axis
    volume: "constant", or "cell" (1D; disorder to first order)

    Raises ValueError for vector operators, for summation volumes, for the symmetric form with
    volumes that differ, and where a correction is singular.
    """
    if operator.name in ("divergence", "curl"):
        raise ValueError(f"operator: no prediction for {operator.name}, expected a scalar operator")
    if volume == "summation" or (volume == "cell" and operator.form == "symmetric"):
        raise ValueError(f"volume: no prediction for {volume} volumes here, expected constant")
    k = 2 * pi * np.asarray(h_over_lambda, dtype=np.float64)
    dim, m = len(offset), operator.derivatives
    particles = _Particles(kernel, kind, dx_over_h, offset)
    exact = _exact(operator, dim, k)
    limit = _continuous(kernel, operator, dim, k) - exact
    still, _, noise = particles.estimate(operator, k, particles.points[:, None, :], np.ones(1))
    still = still - exact
    mean, variance = still, np.zeros_like(still)
    if sigma:
        spread = sigma * float(dx_over_h)
        if volume == "cell" or distribution == "blue":
            variance = particles.first_order(operator, k, kind, spread, distribution, volume)
        else:
            eta, weight = _nodes(distribution, spread, dim, particles.moving)
            moved = particles.points[:, None, :] + eta * particles.moves[:, None, None]
            kurtosis = {"gaussian": 3.0, "uniform": 1.8}[distribution]
            mean, variance, _ = particles.estimate(
                operator, k, moved, weight, eta, spread, kurtosis
            )
            mean = mean - exact
    scale = sqrt(0.5) / k**m

    def rms(parts: Array) -> Array:
        return np.asarray(np.sqrt((parts**2).sum(axis=(1, 2))) * scale)

    rounding = rms(UNIT * noise)
    total = np.sqrt(((mean**2 + variance).sum(axis=(1, 2))) * scale**2 + rounding**2)
    disorder = np.sqrt((((mean - still) ** 2 + variance).sum(axis=(1, 2))) * scale**2)
    columns = (total, rms(limit), rms(still - limit), disorder, rounding)
    return [Split(*(float(x) for x in row)) for row in zip(*columns, strict=True)]


def _exact(operator: Operator, dim: int, k: Array) -> Array:
    """What E_c and E_s should be, (len(k), components, 2), less what the form adds itself."""
    m = operator.derivatives
    rows = operator.components(dim)
    result = np.zeros((len(k), len(rows), 2))
    along = unit(dim, 0, m)
    for c, row in enumerate(rows):
        if along in row:
            result[:, c, m % 2] = (1.0, 1.0, -1.0)[m] * k**m
    if m == 0 and operator.uses_difference:
        result[:] = 0.0
    return result


def _field(operator: Operator, k: Array, x: Array) -> Array:
    """cos and sin of k s₁ as the form sees them, (len(k), 2, …)."""
    phase = np.multiply.outer(k, x)
    if operator.uses_difference:
        even = -2.0 * np.sin(0.5 * phase) ** 2
    else:
        even = np.cos(phase) + (1.0 if operator.form == "symmetric" else 0.0)
    return np.stack([even, np.sin(phase)], axis=1)


def _coefficients(
    operator: Operator, means: Mapping[Key, float], dim: int
) -> list[dict[Key, Dual]]:
    """c_key of every component, with their slopes with respect to the base sums, in their order."""
    keys = list(means)
    sums = {key: Dual(means[key], np.eye(len(keys))[i]) for i, key in enumerate(keys)}
    none = np.zeros(len(keys))
    return [
        {key: c if isinstance(c, Dual) else Dual(float(c), none) for key, c in part.items()}
        for part in operator.coefficients(sums, dim, dual_solve)
    ]


class _Particles:
    """The particles around a target on a lattice, in units of h."""

    def __init__(
        self, kernel: Kernel, kind: str, dx_over_h: Fraction, offset: Sequence[Fraction]
    ) -> None:
        self.kernel, self.dim = kernel, len(offset)
        ratio = float(dx_over_h)
        self.index = sites(kind, float(kernel.support) / ratio + 1.5, tuple(offset))
        length = np.array([float(u) for u in units(kind)])
        self.points = ratio * (self.index.T * length + np.array([float(o) for o in offset]))
        self.volume = ratio**self.dim
        self.ratio = ratio
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
                elif name == "w1" and not near.all() and _curvature_at_0(self.kernel):
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

    def estimate(
        self,
        operator: Operator,
        k: Array,
        s: Array,
        weight: Array,
        eta: Array | None = None,
        spread: float = 0.0,
        kurtosis: float = 3.0,
    ) -> tuple[Array, Array, Array]:
        """Mean and variance of E_c and E_s, (len(k), C, 2), and √Σ ψ², for offsets s (N, Q, d)."""
        mean, psis = self._linear(operator, k, s, weight)
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

    def _linear(self, operator: Operator, k: Array, s: Array, weight: Array) -> tuple[Array, Any]:
        """E at the mean base sums, and ψ of every length, component and part, one by one."""
        dim = self.dim
        needed = operator.needed(dim, 0)
        corrected = operator.correction != "none" or operator.form == "fatehi-manzari"
        g = self.terms(needed, s)
        means = (
            {key: self.volume * float((g[key] @ weight).sum()) for key in needed}
            if corrected
            else {}
        )
        rows = _coefficients(operator, means, dim)
        extra = [key for part in rows for key in part if key not in g]
        g |= self.terms(list(dict.fromkeys(extra)), s)
        field = _field(operator, k, s[..., 0])
        sums = {
            key: self.volume * np.einsum("nq,kfnq,q->kf", g[key], field, weight)
            for key in dict.fromkeys(key for part in rows for key in part)
        }
        mean = np.zeros((len(k), len(rows), 2))
        for c, part in enumerate(rows):
            for key, x in part.items():
                mean[:, c] += x.value * sums[key]

        def psis() -> Any:
            for c, part in enumerate(rows):
                own = sum(x.value * g[key] for key, x in part.items())
                for i in range(len(k)):
                    for f in range(2):
                        psi = own * field[i, f]
                        if corrected:
                            slope = sum(x.slope * sums[key][i, f] for key, x in part.items())
                            for key, y in zip(means, slope, strict=True):
                                if y:
                                    psi = psi + float(y) * g[key]
                        yield i, c, f, psi

        return mean, psis()

    def first_order(
        self,
        operator: Operator,
        k: Array,
        kind: str,
        spread: float,
        distribution: str,
        volume: str,
    ) -> Array:
        """The variance to first order in the displacements, for cells and correlated particles."""
        step = 1e-4
        eta = np.concatenate([step * np.eye(self.dim), -step * np.eye(self.dim)])
        moved = self.points[:, None, :] + eta * self.moves[:, None, None]
        all_points = np.concatenate([self.points[:, None, :], moved], axis=1)
        weight = np.zeros(1 + 2 * self.dim)
        weight[0] = 1.0
        mix = mixing(kind, self.index, distribution)
        order = np.argsort(self.points[:, 0])
        mean, psis = self._linear(operator, k, all_points, weight)
        variance = np.zeros_like(mean)
        for i, c, f, psi in psis:
            slope = (psi[:, 1 : 1 + self.dim] - psi[:, 1 + self.dim :]) / (2 * step)
            slope = slope * self.moves[:, None] * self.volume
            if self.moving:
                slope[self.moves == 0.0] -= slope.sum(axis=0)
            if volume == "cell":
                here = psi[order, 0]
                slope[order[1:-1], 0] += 0.5 * (here[:-2] - here[2:])
            own = slope if mix is None else mix.T @ slope
            variance[i, c, f] = spread**2 * float((own**2).sum())
        return variance


def _curvature_at_0(kernel: Kernel) -> bool:
    """Whether Ŵ″(0) exists; a Gaussian has no pieces and is smooth there."""
    pieces = getattr(kernel, "pieces", ())
    return not pieces or bool(pieces[0].diff().eval(0) == 0)


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


# -------------------------------------------------------------------------- the continuous limit


def _continuous(kernel: Kernel, operator: Operator, dim: int, k: Array) -> Array:
    """E_c and E_s for Δx/h → 0, (len(k), C, 2), from the kernel moments along the wave."""
    moment = _integral(kernel, dim)
    means = {key: moment(key) for key in operator.needed(dim, 0)}
    rows = operator.coefficients(means, dim)
    result = np.zeros((len(k), len(rows), 2))
    for c, part in enumerate(rows):
        for n in range(_SERIES):
            if n == 0 and operator.uses_difference:
                continue
            along = unit(dim, 0, n)
            value = sum(
                float(x) * moment((term, tuple(a + b for a, b in zip(gamma, along, strict=True))))
                for (term, gamma), x in part.items()
            )
            if n == 0 and operator.form == "symmetric":
                value *= 2.0
            sign = (1.0, 1.0, -1.0, -1.0)[n % 4]
            result[:, c, n % 2] += sign * k**n / factorial(n) * value
    return result


@cache
def _integral(kernel: Kernel, dim: int) -> Any:
    """key -> its continuous base sum ∫ g_key d^d s, by Gauss quadrature of the radial part."""
    t, w = np.polynomial.legendre.leggauss(64)
    knots = [float(x) for x in kernel.knots]
    pairs = list(pairwise(knots))
    q = np.concatenate([a + (b - a) / 2 * (1 + t) for a, b in pairs])
    weight = np.concatenate([(b - a) / 2 * w for a, b in pairs])
    sphere = float(SPHERE[dim])

    @cache
    def radial(name: str) -> Array:
        return np.asarray(radial_values(kernel, name, q, dim) * weight * sphere)

    @cache
    def moment(key: Key) -> float:
        total = 0.0
        for c, beta, name in parts(key):
            angle = _angular(beta)
            if angle:
                total += c * angle * float((radial(name) * q ** (sum(beta) + dim - 1)).sum())
        return total

    return moment


def _angular(beta: MultiIndex) -> float:
    """The mean of e^β over directions e: ∏(β_i − 1)!!/(d(d+2)…)."""
    if any(n % 2 for n in beta):
        return 0.0
    top = prod(prod(range(n - 1, 0, -2)) for n in beta)
    dim = len(beta)
    return top / prod(range(dim, dim + sum(beta), 2))
