"""Lattice sums over the reciprocal lattice, which explain the direct ones: Poisson's formula

    (Δx/h)^d Σ_b g(s_b) = Σ_G ĝ(G) S(G) e^{iG·θ},   ĝ(k) = ∫ g(s) e^{−ik·s} d^d s,

shell by shell, with a bound on what is left out. For a base sum g = (−1)^{|δ|} s^α ∂^δ Ŵ

    ĝ(k) = (−1)^{|δ|} i^{|α|+|δ|} ∂^α [k^δ F(k)],

a polynomial in k times the radial functions Φ_m of `sphtrunc.kernels.transform`. G = 0 is the
continuous limit; every other shell is an aliasing error. S is the structure factor of a lattice
with several particles in its cell (hcp).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import comb, factorial, inf, pi, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.transform import decay, radial, transform
from sphtrunc.operators.moments import MultiIndex, add
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.sites import KINDS, units

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.scenes.arrangement import Arrangement

#: {(γ, m): c} stands for Σ c k^γ Φ_m(|k|)
Symbol = dict[tuple[MultiIndex, int], complex]


@dataclass(frozen=True)
class Shell:
    """Reciprocal vectors of equal length: |G| in 1/h, how many, and what they add to the sum."""

    length: float
    count: int
    contribution: float


@dataclass(frozen=True)
class PoissonSum:
    """A base sum over the reciprocal lattice.

    limit: the term G = 0, the integral; shells: the others, by length; tail: a bound on the sum of
    all that follow, inf where none is known to converge absolutely.
    """

    limit: float
    shells: tuple[Shell, ...]
    tail: float

    @property
    def value(self) -> float:
        """The sum of all shells that were taken."""
        return self.limit + sum(shell.contribution for shell in reversed(self.shells))


def poisson_sum(
    kernel: Kernel | Gaussian,
    key: Key,
    scene: Arrangement,
    shells: int = 40,
) -> PoissonSum:
    """The base sum m[δ, α] over `shells` shells of the reciprocal lattice.

    key: (δ, α) with δ a multi-index; the volumes are constant, and nothing is displaced.

    Raises ValueError for a term that is not a derivative of the kernel, for a kernel that jumps
    under a derivative (the particles sum its classical derivative, which is not what F describes).
    """
    delta, alpha = key
    if isinstance(delta, str):
        raise ValueError(f"key: got the term {delta}, expected a multi-index of derivatives")
    smooth = getattr(kernel, "smoothness", inf)
    if sum(delta) > smooth + 1:
        raise ValueError(
            f"kernel {kernel.name!r}: its derivative number {sum(delta) - 1} jumps, so its"
            " reciprocal sum is not that of the particles; expected a smoother kernel"
        )
    dim = len(alpha)
    table = symbol(delta, alpha)
    lengths, values, counts = shells_of(kernel, table, scene, shells)
    rows = tuple(
        Shell(float(k), int(n), float(v)) for k, n, v in zip(lengths, counts, values, strict=True)
    )
    zero = (0,) * dim
    limit = sum(
        c.real * float(radial(kernel, 0.0, dim, m))
        for (gamma, m), c in table.items()
        if gamma == zero
    )
    last = float(lengths[-1])
    return PoissonSum(limit, rows[1:], _tail(kernel, table, scene, last))


def shells_of(
    kernel: Kernel | Gaussian,
    table: Symbol,
    scene: Arrangement,
    shells: int,
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """|G| in 1/h, Σ ĝ(G) S(G) e^{iG·θ} and the number of vectors, shell by shell, G = 0 first."""
    ratio = float(scene.dx_over_h)
    g, lengths, starts, weight = reciprocal_vectors(scene.kind, shells)
    g, lengths = g / ratio, lengths / ratio
    dim = g.shape[1]
    weight = weight * np.exp(1j * (g @ (ratio * np.array([float(o) for o in scene.offset]))))
    total = np.zeros(len(lengths))
    for (gamma, m), c in table.items():
        value = c * weight
        for axis, n in enumerate(gamma):
            for _ in range(n):
                value = value * g[:, axis]
        total += np.add.reduceat(value.real, starts) * radial(kernel, lengths, dim, m)
    return lengths, total, np.diff([*starts, len(g)])


def symbol(delta: MultiIndex, alpha: MultiIndex) -> Symbol:
    """ĝ of (−1)^{|δ|} s^α ∂^δ Ŵ as a polynomial in k with coefficients Φ_m."""
    factor = (-1) ** sum(delta) * 1j ** ((sum(alpha) + sum(delta)) % 4)
    result: Symbol = {}
    for tau in _below(delta):  # Leibniz: ∂^τ falls on k^δ
        if any(t > a for t, a in zip(tau, alpha, strict=True)):
            continue
        falling = prod(
            comb(a, t) * factorial(n) // factorial(n - t)
            for a, t, n in zip(alpha, tau, delta, strict=True)
        )
        left = tuple(n - t for n, t in zip(delta, tau, strict=True))
        rest = tuple(a - t for a, t in zip(alpha, tau, strict=True))
        for (gamma, m), c in monomial_derivatives(rest).items():
            key = add(gamma, left), m
            result[key] = result.get(key, 0) + factor * falling * c
    return result


def monomial_derivatives(alpha: MultiIndex) -> dict[tuple[MultiIndex, int], float]:
    """∂^α f(k²), f^{(n)} = (−½)^n Φ_n: ∂_x^n f(x²) = Σ_j n!/(j!(n−2j)!) (2x)^{n−2j} f^{(n−j)}."""
    result: dict[tuple[MultiIndex, int], float] = {}
    for j in _below(tuple(n // 2 for n in alpha)):
        gamma = tuple(n - 2 * i for n, i in zip(alpha, j, strict=True))
        m = sum(alpha) - sum(j)
        c = prod(
            factorial(n) / (factorial(i) * factorial(n - 2 * i)) * 2 ** (n - 2 * i)
            for n, i in zip(alpha, j, strict=True)
        )
        result[gamma, m] = result.get((gamma, m), 0.0) + c * (-0.5) ** m
    return result


def _below(mu: MultiIndex) -> list[MultiIndex]:
    from itertools import product

    return list(product(*(range(n + 1) for n in mu)))


# ------------------------------------------------------------------------------ reciprocal lattices


def shortest(kind: str) -> tuple[float, int]:
    """The length of the shortest reciprocal vectors that count, in 1/Δx, and their number.

    The longer it is, the less a smooth kernel sees of the lattice: at equal number density it is
    longest for the hexagonal lattice in 2D and for bcc in 3D, whose reciprocals are the densest
    packings (Petersen & Middleton 1962, doi:10.1016/S0019-9958(62)90633-2).
    """
    g, lengths, starts, weight = reciprocal_vectors(kind, 8)
    counts = np.diff([*starts, len(g)])
    for length, start, count in zip(lengths[1:], starts[1:], counts[1:], strict=True):
        if np.any(np.abs(weight[start : start + count]) > 1e-9):
            return float(length), int(count)
    raise ValueError(f"lattice {kind}: no reciprocal vector found")


@lru_cache(maxsize=32)
def reciprocal_vectors(
    kind: str, shells: int
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """The first shells (G = 0 is one more), in 1/Δx: vectors (N, d), length of every shell, where
    it starts, and the structure factor of every vector."""
    lattice = KINDS[kind]
    dim = lattice.dim
    dual, basis = _dual(kind)
    length_unit = [float(u) for u in units(kind)]
    metric = _inverse_metric(kind)
    vectors = [[float(x) * 2 * pi / u for x, u in zip(b, length_unit, strict=True)] for b in dual]
    volume = abs(np.linalg.det(np.array(vectors)))
    wanted = 2.0 * shells + 4.0  # vectors: grown until there are enough shells
    bottom = int(np.lcm.reduce([x.denominator for b in dual for x in b]))
    whole = np.array([[int(x * bottom) for x in b] for b in dual], dtype=np.int64)
    while True:
        sphere = {1: 2.0, 2: pi, 3: 4 * pi / 3}[dim]
        reach = (wanted * volume / sphere) ** (1 / dim)
        # |h_i| <= |a_i| reach/(2π) with the direct primitive vectors a_i
        direct = 2 * pi * np.linalg.inv(np.array(vectors)).T
        most = [int(reach * np.linalg.norm(a) / (2 * pi)) + 1 for a in direct]
        h = np.stack(
            [x.ravel() for x in np.meshgrid(*(np.arange(-n, n + 1) for n in most), indexing="ij")]
        )
        y = whole.T @ h
        square = sum(w * row * row for w, row in zip(metric, y, strict=True))
        g = np.stack([row / bottom * 2 * pi / u for row, u in zip(y, length_unit, strict=True)], 1)
        near = np.flatnonzero((g * g).sum(axis=1) <= reach**2)
        order = near[np.argsort(square[near], kind="stable")]
        starts = np.flatnonzero(np.diff(square[order], prepend=-1))
        if len(starts) > shells + 1:
            order, starts = order[: starts[shells + 1]], starts[: shells + 1]
            break
        wanted *= 2.0
    factor = np.zeros(len(order), dtype=complex)
    for point in basis:
        factor += np.exp(2j * pi / bottom * (y[:, order].T @ np.array(point)))
    lengths = np.sqrt((g[order][starts] ** 2).sum(axis=1))
    return g[order], lengths, starts, factor / len(basis)


def _dual(kind: str) -> tuple[list[list[Fraction]], list[MultiIndex]]:
    """Rows b_i with b_i·a_j = δ_ij for the primitive vectors in integer points, and the particles
    of one cell."""
    from sympy import Matrix

    lattice = KINDS[kind]
    inverse = Matrix(lattice.primitive).inv()
    dual = [[fraction(x) for x in inverse.col(i)] for i in range(lattice.dim)]
    reach = [sum(abs(a[i]) for a in lattice.primitive) for i in range(lattice.dim)]
    grid = np.stack(
        [x.ravel() for x in np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij")]
    )
    inside = []
    for point in grid[:, lattice.contains(grid)].T:
        cell = [sum(int(p) * x for p, x in zip(point, b, strict=True)) for b in dual]
        if all(0 <= x < 1 for x in cell):
            inside.append(tuple(int(p) for p in point))
    return dual, inside


def _inverse_metric(kind: str) -> tuple[int, ...]:
    from sphtrunc.scenes.sites import metric

    ratios = metric(KINDS[kind].units)
    common = prod(ratios)
    return tuple(common // r for r in ratios)


def _tail(kernel: Kernel | Gaussian, table: Symbol, scene: Arrangement, last: float) -> float:
    """Σ_{|G|>K} |ĝ| by an integral: a decreasing φ(|G|) is at most its mean over the cell around G,
    moved inwards by the cell's radius ρ, so Σ φ <= (S_d/v) ∫_{K−2ρ}^∞ φ(t) (t+ρ)^{d−1} dt."""
    dim = scene.dim
    dual, _ = _dual(scene.kind)
    length_unit = [float(u) * float(scene.dx_over_h) for u in units(scene.kind)]
    vectors = np.array(
        [[float(x) * 2 * pi / u for x, u in zip(b, length_unit, strict=True)] for b in dual]
    )
    cell = abs(float(np.linalg.det(vectors)))
    radius = 0.5 * float(np.linalg.norm(vectors, axis=1).sum())
    start = last - 2 * radius
    if start <= 0:
        return inf
    bounds = [
        (a - sum(gamma), abs(c) * size)
        for (gamma, m), c in table.items()
        for a, size in _decay(kernel, dim, m)
    ]
    if not bounds or min(e for e, _ in bounds) <= dim:
        return inf
    total = sum(
        size * comb(dim - 1, j) * radius ** (dim - 1 - j) * start ** (j + 1 - e) / (e - j - 1)
        for e, size in bounds
        for j in range(dim)
    )
    sphere = {1: 2.0, 2: 2 * pi, 3: 4 * pi}[dim]
    return float(sphere / cell * total)


def _decay(kernel: Kernel | Gaussian, dim: int, m: int) -> tuple[tuple[int, float], ...]:
    return decay(kernel, dim, m) if isinstance(kernel, Kernel) else kernel.decay(dim, m)


# -------------------------------------------------------------------------------------- sinusoids


def response(
    kernel: Kernel | Gaussian,
    k: Sequence[float],
    scene: Arrangement,
    shells: int = 40,
) -> tuple[complex, tuple[complex, ...]]:
    """What the standard gradient makes of e^{ik·x}, as a fraction of i k₁ e^{ik·x} (k in 1/h).

    Returns F(|k|), which is one less the smoothing error, and the aliasing part of every shell,
    Σ_G (k₁−G₁)/k₁ F(|k−G|) S(G) e^{iG·θ}. The modified wavenumber is k₁ times the sum of all.

    Raises ValueError for a wave without a component along the first axis.
    """
    wave = np.asarray(k, dtype=np.float64).reshape(-1)
    if len(wave) != scene.dim or not np.all(np.isfinite(wave)) or wave[0] == 0:
        raise ValueError(f"k: expected {scene.dim} finite components, the first of them not 0")
    ratio = float(scene.dx_over_h)
    g, _, starts, weight = reciprocal_vectors(scene.kind, shells)
    g = g / ratio
    shift = np.array([float(o) for o in scene.offset])
    moved = wave - g
    size = np.sqrt((moved * moved).sum(axis=1))
    value = (
        weight
        * np.exp(1j * ratio * (g @ shift))
        * moved[:, 0]
        / wave[0]
        * transform(kernel, size, len(wave))
    )
    parts = np.add.reduceat(value, starts)
    return complex(parts[0]), tuple(complex(p) for p in parts[1:])
