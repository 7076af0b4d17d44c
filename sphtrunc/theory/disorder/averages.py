"""Averages over displacements of any size: mean and spread of an estimate by quadrature over the
displacement of every particle, to first order in the algebra of a correction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from math import prod, sqrt
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.dual import Dual
from sphtrunc.kernels.factors import factor_values
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import PAIRED, Operator
from sphtrunc.operators.terms import Key, monomial, parts
from sphtrunc.theory.disorder.sensitivities import dual_coefficients
from sphtrunc.theory.fields import Signals, Taylor

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.arrangement import Arrangement
    from sphtrunc.theory.variable_h.scenes import Slope


NODES = {1: (11, 21), 2: (5, 9), 3: (3, 5)}  # of the quadrature over η along each axis:


CALM = 0.1  # for displacements of at most this many h, and for larger ones


MOST_NODES = 1 << 17  # of that quadrature for all particles


def scattered_moments(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    alphas: Sequence[MultiIndex],
    axis: int = 0,
) -> dict[MultiIndex, tuple[float, float]] | None:
    """Mean and variance of M_α of one component for independent displacements of any size, to first
    order in the algebra of a correction; None where there are too many particles for that.

    M_α is the estimate of s^α.
    """
    particles = Particles(kernel, scene)
    if len(particles.points) * max(NODES[particles.dim]) ** particles.dim > MOST_NODES:
        return None
    result: dict[MultiIndex, tuple[float, float]] = {}
    for start in range(0, len(alphas), 8):  # few at a time, for the sake of memory
        some = alphas[start : start + 8]
        signals = Taylor([{alpha: 1.0} for alpha in some])
        mean, variance = particles.scattered(operator, signals)
        rows = zip(mean[:, axis, 0], variance[:, axis, 0], strict=True)
        result |= {a: (float(m), float(v)) for a, (m, v) in zip(some, rows, strict=True)}
    return result


def _seen(operator: Operator, signals: Signals, s: Array) -> Array:
    """The fields as the form sees them, (K, F, …), for equal densities."""
    if operator.form == PAIRED:
        return np.asarray(0.5 * (signals.difference(s) - signals.difference(-s)))
    return np.asarray((signals.difference(s).T + operator.copies * signals.own.T).T)


class Particles:
    """The particles around a target on a lattice, in units of h."""

    def __init__(
        self, kernel: Kernel | Gaussian, scene: Arrangement, slope: Slope | None = None
    ) -> None:
        """slope: how h changes from particle to particle, if it does."""
        self.kernel, self.scene, self.dim, self.slope = kernel, scene, scene.dim, slope
        self.ratio = ratio = float(scene.dx_over_h)
        support = float(kernel.support) * (1.0 if slope is None else slope.wider(kernel))
        index = scene.sites(support / ratio + 1.5)
        self.points, self.shares = scene.positions(index), scene.shares(index)[:, None]
        self.volume = ratio**self.dim
        within = (self.points**2).sum(axis=1) < float(kernel.support) ** 2
        self.neighbours = int(within.sum())
        if scene.volume == "summation":  # the same for all
            home = scene.seen_from()
            q = np.linalg.norm(home.positions(home.sites(float(kernel.support) / ratio)), axis=1)
            self.volume = 1.0 / float(kernel.w(q, self.dim).sum())
        self.moving = scene.at_particle
        own = (self.points == 0.0).all(axis=1)
        self.moves = np.where(own & self.moving, 0.0, 1.0)  # relative to the target

    def terms(self, keys: Sequence[Key], s: Array) -> dict[Key, Array]:
        """g_key of the particles at the offsets s, (N, Q, d)."""
        if self.slope is not None:
            return {key: self.slope.term(self.kernel, key, s) for key in keys}
        q = np.sqrt((s * s).sum(axis=-1))
        factor = cache(lambda k: self.shares * factor_values(self.kernel, k, q, self.dim))
        return {
            key: sum(c * monomial(s, beta) * factor(k) for c, beta, k in parts(key)) for key in keys
        }

    def scattered(self, operator: Operator, signals: Signals) -> tuple[Array, Array]:
        """Mean and variance of E, (K, C, F), for independent displacements of any size."""
        spread, distribution = self.scene.sigma * self.ratio, self.scene.distribution
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
