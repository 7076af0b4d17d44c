"""The structure factor of particles, S(k) = ⟨|Σ_b e^{−ik·x_b}|²⟩/N at k ≠ 0: all that the spread of
a sum over them depends on (`spectral_law`).

In closed form for a Poisson process, S = 1, and for lattices whose particles are displaced at
random (Klatt, Kim & Torquato 2020, doi:10.1103/PhysRevE.101.032118),

    S = e^{−k²c₀} Σ_R e^{ik·R} (e^{k²c_R} − 1) + Bragg,   c_R = covariance of two displacements,

independent Gaussian ones being 1 − e^{−σ²k²}; measured for particles in a periodic box, mode by
mode, and with a taper for free ones. Wave numbers are in units of 1/Δx, Δx^d = volume per particle.

S ∝ k^α as k → 0: α = 0 for a plateau, α > 0 for hyperuniform arrangements (Torquato & Stillinger
2003, doi:10.1103/PhysRevE.68.041113).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.kernels.arguments import dimension
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.scenes.sites import KINDS, units
from sphtrunc.theory.disorder.box_modes import amplitudes, half_space, tapered

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

REACH = {1: 40.0, 2: 16.0, 3: 10.0}  # kΔx up to which a box is measured
FEWEST = 40  # modes that an exponent is read off
LONG = 1.0  # kΔx up to which it is, where there are that many
PANEL = 16  # Gauss nodes of a panel of the radial quadrature
PHASE = 6.0  # phase of the test function over half of such a panel
MOST_MODES = 2e7


@dataclass(frozen=True)
class Fit:
    """S = plateau·(kΔx)^α over long waves.

    exponent, exponent_error: α and one standard error, None where S vanishes there
    plateau, plateau_error: the mean of S over the same modes, and one standard error
    upto: kΔx of the shortest of them; modes: how many
    """

    exponent: float | None
    exponent_error: float | None
    plateau: float
    plateau_error: float
    upto: float
    modes: int

    @property
    def power(self) -> Fraction:
        """α as it is taken to be: the nearest half, 0 where it is not known to differ from that."""
        if self.exponent is None or self.exponent_error is None:
            raise ValueError("particles: S vanishes at long waves, it has no exponent there")
        if self.exponent < max(2 * self.exponent_error, 0.25):
            return Fraction(0)
        return Fraction(round(2 * self.exponent), 2)


@dataclass(frozen=True)
class Nodes:
    """Where a sum over S is taken: Σ weight f(k) stands for Δx^d ∫ f d^d k/(2π)^d, k and −k as one.

    k: (d, M) in 1/Δx; weight: (M,); S: (M,), of sums seen from anywhere; pairs: (M,), of a sum and
    the particle that sees it (S where all weights are alike)
    bragg: (d, B) reciprocal vectors with `strength` (B,): S has (2π/Δx)^d Σ strength δ(k − G), k
    and −k as one
    """

    k: Array
    weight: Array
    S: Array
    pairs: Array
    bragg: Array
    strength: Array


@dataclass(frozen=True, eq=False)
class StructureFactor:
    """S(k) of a stationary arrangement of particles.

    by: where it comes from, in a few words
    law: k (d, M) in 1/Δx -> the diffuse part of S (M,); None where it is measured
    isotropic: the law depends on |k| alone
    home, damping: lattice, and G (d, B) -> strength of its Bragg peaks; None where there are none
    k, S: (d, M) and (M,), modes of a box, one of k and −k; pairs: (M,) see `Nodes`
    particles: N; reach: kΔx up to which S is measured; own: ⟨w²⟩, what S tends to beyond
    fill: volume of the particles over that of the box; box: its sides, (d,) in Δx
    blur: of a free set, the resolution in k along each axis, in 1/Δx; None in a box
    """

    dim: int
    by: str
    law: Callable[[Array], Array] | None = None
    isotropic: bool = True
    home: str | None = None
    damping: Callable[[Array], Array] | None = None
    k: Array | None = None
    S: Array | None = None
    pairs: Array | None = None
    particles: int = 0
    reach: float = 0.0
    own: float = 1.0
    fill: float = 1.0
    box: Array | None = None
    blur: Array | None = None

    def __call__(self, k: Array) -> Array:
        """The diffuse part of S at k, (d, M) in 1/Δx.

        Raises ValueError where S is measured, at modes of its own.
        """
        if self.law is None:
            raise ValueError("k: S was measured at the modes of a box; see its `k`, `S`, `radial`")
        return self.law(np.atleast_2d(np.asarray(k, dtype=np.float64)))

    def nodes(self, reach: float, extent: float) -> Nodes:
        """Nodes of sums over S up to kΔx = reach, for test functions as wide as `extent` Δx.

        In a box these are its modes and, beyond the ones measured, a quadrature with S = ⟨w²⟩.

        Raises ValueError for free particles, whose S is known smeared only, and for a box that the
        test function does not fit in.
        """
        none = np.zeros((self.dim, 0))
        if self.law is not None:
            k, weight = _quadrature(self.dim, 0.0, reach, extent, self.isotropic)
            S = self.law(k)
            bragg, strength = none, np.zeros(0)
            if self.home is not None and self.damping is not None:
                bragg = _reciprocal_half(self.home, reach)
                strength = 2.0 * self.damping(bragg)
            return Nodes(k, weight, S, S, bragg, strength)
        if self.blur is not None:
            raise ValueError(
                "particles: a free set has no prediction, its structure factor is known smeared"
                " only; expected a periodic box"
            )
        assert self.k is not None
        assert self.S is not None
        assert self.pairs is not None
        assert self.box is not None
        if 2 * extent > float(self.box.min()):
            raise ValueError(
                f"period: the shortest side is {float(self.box.min()):.3g} Δx, expected more than"
                f" twice the support, {2 * extent:.3g} Δx: a particle would meet its own image"
            )
        k, weight = _quadrature(self.dim, self.reach, max(reach, self.reach), extent, True)
        more = np.ones(k.shape[1])
        return Nodes(
            np.concatenate([self.k, k], axis=1),
            np.concatenate([np.full(self.k.shape[1], 2.0 / self.particles), weight]),
            np.concatenate([self.S, self.own * more]),
            np.concatenate([self.pairs, more]),
            none,
            np.zeros(0),
        )

    # -- how a measured one is read ----------------------------------------------------------------

    def _measured(self) -> tuple[Array, Array]:
        if self.k is None or self.S is None:
            raise ValueError("structure factor: in closed form it has no modes; call it instead")
        return np.sqrt((self.k**2).sum(axis=0)), self.S

    def radial(self, bins: int = 60) -> tuple[Array, Array, Array]:
        """(kΔx, S, error): means over n modes of a shell, and a standard error, √(Σ|ρ|⁴/2N²)/n, as
        each |ρ|²/N of a disordered arrangement is exponentially distributed about its S.

        Shells widen in proportion to k as far as that leaves at least eight modes in each.
        """
        length, S = self._measured()
        order = np.argsort(length, kind="stable")
        length, S = length[order], S[order]
        edges = np.geomspace(length[0], length[-1] * (1 + 1e-9), bins + 1)
        starts = [0]
        for stop in np.searchsorted(length, edges[1:]):
            if stop - starts[-1] >= min(8, length.size):
                starts.append(int(stop))
        if starts[-1] != length.size:
            starts = [*(starts[:-1] or [0]), length.size]
        wide = self._shared
        rows = [
            (length[a:b].mean(), S[a:b].mean(), wide * sqrt(0.5 * (S[a:b] ** 2).sum()) / (b - a))
            for a, b in pairwise(starts)
        ]
        k, mean, error = (np.array(column) for column in zip(*rows, strict=True))
        return k, mean, error

    def fit(self) -> Fit:
        """Exponent and plateau at long waves, kΔx <= 1 or, where these are fewer than 40, the 40
        longest: the maximum of the likelihood of exponentially distributed modes (Whittle 1953),
        errors enlarged by as much as they scatter more than that.
        """
        length, S = self._measured()
        count = max(int((length <= LONG).sum()), min(FEWEST, length.size))
        chosen = np.argsort(length, kind="stable")[:count]
        k, y = length[chosen], S[chosen]
        mean = float(y.mean())
        if count < 3 or not mean > 1e-20 or k.max() <= k.min() * (1 + 1e-9):
            return Fit(None, None, mean, mean / sqrt(count), float(k.max()), count)
        x = np.stack([np.ones(count), np.log(k)])
        x[1] -= x[1].mean()
        at = np.array([np.log(mean), 0.0])
        fisher = x @ x.T
        for _ in range(200):
            step = np.linalg.solve(fisher, x @ (y / np.exp(at @ x) - 1.0))
            at = at + step / max(1.0, float(np.abs(step).max()))
            if np.abs(step).max() < 1e-10:
                break
        scatter = max(1.0, sqrt(float(((y / np.exp(at @ x) - 1.0) ** 2).mean())))
        error = sqrt(float(np.linalg.inv(fisher)[1, 1])) * scatter
        spread = max(float(y.std()), mean) / sqrt(count)
        return Fit(float(at[1]), error, mean, spread, float(k.max()), count)

    def smoothed(self) -> StructureFactor:
        """The measured S as a law of |k|: through the means of shells, a power below them (a
        plateau where the exponent is not known to differ from 0), and ⟨w²⟩ beyond.

        Raises ValueError for an anisotropic arrangement, and for one that is a lattice.
        """
        if self.anisotropic:
            raise ValueError("particles: S differs between directions; expected an isotropic set")
        fit = self.fit()
        if fit.exponent is None or fit.exponent_error is None:
            raise ValueError("particles: S vanishes at long waves; expected disordered particles")
        alpha = fit.power
        k, S, _ = self.radial()
        low = np.log(np.maximum(S, 1e-300))
        first = np.log(fit.plateau) if not alpha else low[0]

        def law(wave: Array) -> Array:
            length = np.sqrt((wave * wave).sum(axis=0))
            inside = np.exp(np.interp(np.log(np.maximum(length, 1e-300)), np.log(k), low))
            below = np.exp(first) * (np.minimum(length, k[0]) / k[0]) ** float(alpha)
            return np.where(length > k[-1], self.own, np.where(length < k[0], below, inside))

        return StructureFactor(self.dim, f"{self.by}, means over shells", law=law)

    def directions(self) -> list[tuple[float, float]]:
        """For each axis: S of the waves within 30° of it over the mean of all of the same length,
        and one standard error; 1 where the arrangement is isotropic. Up to kΔx = 4."""
        length, S = self._measured()
        assert self.k is not None
        order = np.argsort(length, kind="stable")
        order = order[length[order] <= 4.0]
        relative = np.empty(order.size)
        for part in np.array_split(np.arange(order.size), max(1, order.size // 200)):
            mean = S[order[part]].mean() if part.size else 1.0
            relative[part] = S[order[part]] / mean if mean > 0 else 1.0
        result = []
        for row in self.k[:, order]:
            near = np.abs(row) >= sqrt(0.75) * length[order]
            n = max(1, int(near.sum()))
            value = float(relative[near].mean()) if near.any() else 1.0
            result.append((value, self._shared * value / sqrt(n)))
        return result

    @property
    def _shared(self) -> float:
        """How much larger the errors of means are than of as many independent modes: those next to
        each other of a Hann window share 4/9 of their squares, the next but one 1/36."""
        return 1.0 if self.blur is None else sqrt((1.0 + 8 / 9 + 1 / 18) ** self.dim)

    @property
    def anisotropic(self) -> bool:
        """An axis stands out by more than a tenth, and by more than five standard errors."""
        return any(abs(v - 1.0) > max(0.1, 5.0 * e) for v, e in self.directions())


# ------------------------------------------------------------------------------- in closed form


def poisson(dim: int) -> StructureFactor:
    """Independent particles: S = 1."""
    return StructureFactor(dimension(dim), "Poisson process", law=lambda k: np.ones(np.shape(k)[1]))


def displaced(kind: str, sigma: float, distribution: str = "gaussian") -> StructureFactor:
    """A lattice whose particles are displaced by σ/Δx along each axis.

    distribution: "gaussian" and "uniform", independent, or "blue", each particle's less the mean of
    those of its nearest neighbours, see `jittered`
    """
    dim = _lattice(kind).dim
    if not sigma >= 0:
        raise ValueError(f"sigma: got {sigma!r}, expected a standard deviation σ/Δx of at least 0")
    by = f"{kind} lattice, displaced by σ/Δx = {sigma:g}, {distribution}"
    if distribution == "gaussian":

        def gaussian(k: Array) -> Array:
            return np.asarray(-np.expm1(-(sigma**2) * (k * k).sum(axis=0)))

        return _crystal(dim, by, gaussian, True, kind, lambda k: 1.0 - gaussian(k))
    if distribution == "uniform":

        def still(k: Array) -> Array:
            return np.asarray(np.prod(np.sinc(sqrt(3.0) * sigma / pi * k) ** 2, axis=0))

        return _crystal(dim, by, lambda k: 1.0 - still(k), dim == 1, kind, still)
    if distribution != "blue":
        raise ValueError(f"distribution: got {distribution!r}, expected gaussian, uniform or blue")
    steps = _lattice(kind).nearest
    if not steps:
        raise ValueError(f"distribution: blue needs the same neighbours everywhere, not {kind}")
    filtered = {(0,) * dim: 1.0, **dict.fromkeys(steps, -1.0 / len(steps))}
    covariance: dict[MultiIndex, float] = {}
    for a, f in filtered.items():
        for b, g in filtered.items():
            step = tuple(y - x for x, y in zip(a, b, strict=True))
            covariance[step] = covariance.get(step, 0.0) + f * g * sigma**2 / (1 + 1 / len(steps))
    return correlated(kind, covariance, by)


def correlated(
    kind: str, covariance: Mapping[MultiIndex, float], by: str | None = None
) -> StructureFactor:
    """A lattice with Gaussian displacements that are not independent.

    covariance: step between two particles, in the integer points of the lattice -> c_R, the
        covariance of their displacements along each axis, in Δx²; the step 0 has σ². Those that are
        not named are 0.

    Raises ValueError where a step and its opposite differ.
    """
    dim = _lattice(kind).dim
    zero = (0,) * dim
    variance = float(covariance.get(zero, 0.0))
    for step, c in covariance.items():
        opposite = tuple(-n for n in step)
        if abs(covariance.get(opposite, 0.0) - c) > 1e-12 * max(variance, abs(c)):
            raise ValueError(f"covariance: got {c:g} at {step} and another at {opposite}")
    places = np.array(list(covariance), dtype=np.float64).T
    places = places * np.array([float(u) for u in units(kind)])[:, None]
    sizes = np.array(list(covariance.values()))

    def diffuse(k: Array) -> Array:
        square = (k * k).sum(axis=0)
        total = np.zeros(k.shape[1])
        for place, c in zip(places.T, sizes, strict=True):
            rise = np.exp((c - variance) * square) - np.exp(-variance * square)
            total += np.cos(place @ k) * rise
        return np.maximum(total, 0.0)

    alone = all(step == zero for step in covariance)
    return _crystal(
        dim,
        by or f"{kind} lattice, correlated displacements of σ/Δx = {sqrt(variance):g}",
        diffuse,
        alone,
        kind,
        lambda k: np.exp(-variance * (k * k).sum(axis=0)),
    )


def _crystal(
    dim: int,
    by: str,
    law: Callable[[Array], Array],
    isotropic: bool,
    kind: str,
    damping: Callable[[Array], Array],
) -> StructureFactor:
    from sphtrunc.theory.reciprocal_sums import reciprocal_vectors

    def strength(g: Array) -> Array:
        """e^{−…}, and what the cell of the lattice lets through."""
        if _lattice(kind).turned is None:
            return damping(g)
        vectors, _, _, weight = reciprocal_vectors(kind, _shells_upto(kind, float(np.abs(g).max())))
        known = {tuple(np.round(v, 6)): abs(w) ** 2 for v, w in zip(vectors, weight, strict=True)}
        return np.asarray(damping(g) * [known[tuple(np.round(v, 6))] for v in g.T])

    return StructureFactor(dim, by, law, isotropic, kind, strength)


def _lattice(kind: str) -> Any:
    if kind not in KINDS:
        raise ValueError(f"lattice: got {kind!r}, expected one of {', '.join(KINDS)}")
    return KINDS[kind]


@lru_cache(maxsize=32)
def _shells_upto(kind: str, reach: float) -> int:
    """How many shells of the reciprocal lattice hold all vectors up to this length in 1/Δx."""
    from sphtrunc.theory.reciprocal_sums import reciprocal_vectors

    shells = 8
    while reciprocal_vectors(kind, shells)[1][-1] < 1.8 * reach:
        shells *= 2
    return shells


def _reciprocal_half(kind: str, reach: float) -> Array:
    """Reciprocal vectors G ≠ 0 up to this length, (d, B), one of G and −G."""
    from sphtrunc.theory.reciprocal_sums import reciprocal_vectors

    g = reciprocal_vectors(kind, _shells_upto(kind, reach))[0].T
    g = g[:, (g * g).sum(axis=0) <= reach**2]
    leading = np.zeros(g.shape[1])
    for row in g:
        leading = np.where(leading == 0, np.sign(np.round(row, 9)), leading)
    return np.asarray(g[:, leading > 0])


def _quadrature(
    dim: int, low: float, high: float, extent: float, isotropic: bool
) -> tuple[Array, Array]:
    """Nodes k (d, M) and weights of ∫ d^d k/(2π)^d over low < |k| < high, k and −k as one: panels
    along |k|, and directions that are exact for polynomials of degree 22 (dense ones otherwise)."""
    if not high > low:
        return np.zeros((dim, 0)), np.zeros(0)
    t, w = np.polynomial.legendre.leggauss(PANEL)
    count = max(1, int(np.ceil((high - low) * max(extent, 1.0) / (2 * PHASE))))
    edges = np.linspace(low, high, count + 1)
    half = np.diff(edges) / 2
    k = (edges[:-1, None] + half[:, None] * (1 + t)).ravel()
    weight = (half[:, None] * w).ravel() * k ** (dim - 1)
    e, share = _directions(dim, 12 if isotropic else 96 if dim == 2 else 32)
    nodes = (e[:, None, :] * k[:, None]).reshape(dim, -1)
    return nodes, (weight[:, None] * share).ravel() / (2 * pi) ** dim


@lru_cache(maxsize=8)
def _directions(dim: int, n: int) -> tuple[Array, Array]:
    """Unit vectors (d, D) of half the sphere and weights that add up to the whole."""
    if dim == 1:
        return np.ones((1, 1)), np.array([2.0])
    if dim == 2:
        phi = (np.arange(n) + 0.5) * pi / n
        return np.stack([np.cos(phi), np.sin(phi)]), np.full(n, 2 * pi / n)
    z, w = np.polynomial.legendre.leggauss(n)
    z, w = z[n // 2 :], 2 * w[n // 2 :]  # n even: the upper half
    phi = (np.arange(2 * n) + 0.5) * pi / n
    s = np.sqrt(1 - z * z)
    e = np.stack([np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(2 * n))])
    return e.reshape(3, -1), np.outer(w, np.full(2 * n, pi / n)).ravel()


# ------------------------------------------------------------------------------------- measured


def measured(
    x: Array,
    period: Array | None = None,
    *,
    volumes: Array | None = None,
    reach: float | None = None,
    way: str | None = None,
) -> StructureFactor:
    """S of particles at x, (d, N), in a periodic box with sides `period` (d,), all its modes up to
    kΔx = reach (default: 40, 16, 10 in 1, 2, 3 dimensions); or, without a box, of a free set under
    a Hann taper over its bounding box.

    volumes: (N,) weights of the particles, Σ_b V_b e^{−ik·x_b}; S then is that of what they fill
    way: "direct" or "grid", see `box_modes`; None chooses

    Of a free set S is smeared over 2π/L along each axis, so that it shows no plateau below about
    (2π Δx/L)²; edges, density gradients and empty places show as a rise to small k.

    Raises ValueError for fewer than 8 particles, for particles on one place, and where there would
    be too many modes.
    """
    dim, count = x.shape
    if count < 8:
        raise ValueError(f"particles: got {count}, expected at least 8 for a structure factor")
    weights = np.ones(count) if volumes is None else volumes / volumes.mean()
    sides = x.max(axis=1) - x.min(axis=1) if period is None else period
    spacing = float(np.prod(sides) / count) ** (1.0 / dim)
    if not spacing > 0 or np.all(np.ptp(x, axis=1) == 0):
        raise ValueError("particles: all of them lie on one place or in a plane, expected a volume")
    top = REACH[dim] if reach is None else float(reach)
    if not 0 < top < 1e4:
        raise ValueError(f"reach: got {reach!r}, expected kΔx of about 10")
    modes = count * {1: 1 / pi, 2: 0.25 / pi, 3: 1 / (6 * pi**2)}[dim] * top**dim
    if modes > MOST_MODES:
        raise ValueError(
            f"reach: {modes:.1e} modes up to kΔx = {top:g}, at most {MOST_MODES:.0e} are measured;"
            f" expected at most kΔx = {top * (MOST_MODES / modes) ** (1 / dim):.3g}"
        )
    if period is None:
        k, rho, blur, norm = tapered(x, top / spacing, weights)
        S = np.abs(rho) ** 2 / norm
        by = "measured on free particles, tapered"
        return StructureFactor(
            dim, by, k=k * spacing, S=S, particles=count, reach=top, blur=blur * spacing
        )
    if np.any(np.ptp(x, axis=1) > 1.05 * period):
        wide = ", ".join(f"{v:.6g}" for v in np.ptp(x, axis=1))
        raise ValueError(
            f"period: got {period.tolist()}, and the particles extend over {wide}; expected a box"
            " that holds them once"
        )
    n = half_space(period, top / spacing)
    if n.shape[1] < 3:
        raise ValueError(f"reach: no modes of the box up to kΔx = {top:g}, expected a larger one")
    rho = amplitudes(x, weights, period, n, way)
    alike = volumes is None or bool(np.all(weights == weights[0]))
    seen = rho if alike else amplitudes(x, np.ones(count), period, n, way)
    return StructureFactor(
        dim,
        "measured, all modes of the box",
        k=2 * pi * n * (spacing / period)[:, None],
        S=np.abs(rho) ** 2 / count,
        pairs=(rho * seen.conj()).real / count,
        particles=count,
        reach=top,
        box=period / spacing,
        own=float((weights**2).mean()),
        fill=1.0 if volumes is None else float(volumes.sum() / np.prod(period)),
    )
