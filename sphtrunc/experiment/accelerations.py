"""Accelerations: the equations of motion themselves, on periodic particles of equal mass.

Nothing here knows a dispersion relation. Positions may be complex: the kernel is continued by its
derivative, f(q + iε) = f(q) + iε f′(q), so with ε = 1e-40 the imaginary part of an acceleration is
its derivative along a displacement to the last digit (complex step, Squire & Trapp 1998,
doi:10.1137/S003614459631241X).

Lengths are in any one unit, masses are 1/N of what fills the box at the density 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.operators.forces import (
    CORRECTED,
    GRAD_H,
    REFERENCE,
    STAGGERED,
    ArtificialStress,
    EquationOfState,
    Force,
    Rate,
)
from sphtrunc.scenes.sites import KINDS, units

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel

Array = NDArray[np.float64]

STEP = 1e-40  # of the complex step: its square is nothing
_ROUNDS = 60  # of Newton's iteration for h


@dataclass(frozen=True, eq=False)
class Fluid:
    """What moves, and by which law.

    start: (N, d) positions at rest, which the densities of "constant", the total Lagrangian form
        and stress points refer to; period: (d,), the box; h: the smoothing length, at rest where
        it follows the density
    density: "summation", ρ = Σ m W; "constant", 1 at the start, and the rate of the same sum;
        "corrected", 1 at the start, and the corrected divergence of small displacements

    Raises ValueError where the box is not longer than twice the support.
    """

    kernel: Kernel | Gaussian
    force: Force
    state: EquationOfState
    start: Array
    period: Array
    h: float
    stress: ArtificialStress | None = None
    density: str = "summation"
    _near: dict[Any, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        reach = 2 * float(self.kernel.support) * self.h
        if np.any(self.period <= reach):
            raise ValueError(
                f"period: got {self.period.tolist()}, expected more than twice the support,"
                f" {reach:g}: a particle would meet its own image"
            )

    @property
    def dim(self) -> int:
        """d."""
        return int(self.start.shape[1])

    @property
    def spacing(self) -> float:
        """Δx, with Δx^d the volume of a particle."""
        return float(self.mass ** (1 / self.dim))

    @property
    def mass(self) -> float:
        """m, of every particle."""
        return float(np.prod(self.period)) / len(self.start)

    def kernel_at(self, q: Any, derivative: int) -> Any:
        """Ŵ, Ŵ′ or Ŵ″ at real or complex q."""
        tables = (self.kernel.w, self.kernel.dw, self.kernel.d2w)
        value = tables[derivative](np.ascontiguousarray(q.real), self.dim)
        if not np.iscomplexobj(q) or derivative == 2:
            return value
        slope = tables[derivative + 1](np.ascontiguousarray(q.real), self.dim)
        return value + 1j * q.imag * slope


@dataclass(frozen=True, eq=False)
class Pairs:
    """Every ordered pair a ≠ b within reach. a, b: (P,); r: (P, d), x_a − x_b to the nearest image;
    n: the number of targets; length: (P,)."""

    a: Any
    b: Any
    r: Any
    n: int

    @property
    def length(self) -> Any:
        return np.sqrt((self.r * self.r).sum(axis=1))

    def total(self, terms: Any) -> Any:
        """Σ_b of terms (P, …), for every a: (n, …)."""
        flat = terms.reshape(len(terms), -1)
        columns = []
        for column in flat.T:
            value = np.bincount(self.a, column.real, self.n)
            if np.iscomplexobj(column):
                value = value + 1j * np.bincount(self.a, column.imag, self.n)
            columns.append(value)
        return np.stack(columns, axis=1).reshape(self.n, *terms.shape[1:])


def pairs(fluid: Fluid, x: Any, others: Any = None, reach: float = 1.0) -> Pairs:
    """The pairs of particles at x (N, d), or of particles with `others`, within reach supports.

    Those of the start are looked for once: a complex step does not move them.
    """
    if others is None and np.array_equal(x.real, fluid.start):
        if reach not in fluid._near:
            fluid._near[reach] = _search(fluid, fluid.start, None, reach)
        a, b = fluid._near[reach]
    else:
        a, b = _search(fluid, x.real, None if others is None else others.real, reach)
    r = x[a] - (x if others is None else others)[b]
    return Pairs(a, b, r - fluid.period * np.rint(r.real / fluid.period), len(x))


def _search(fluid: Fluid, x: Array, others: Array | None, reach: float) -> tuple[Any, Any]:
    from scipy.spatial import cKDTree

    box = fluid.period
    here = np.mod(x, box)
    here = np.where(here < box, here, 0.0)
    there = here if others is None else np.mod(others, box)
    tree = cKDTree(np.where(there < box, there, 0.0), boxsize=box)
    radius = reach * float(fluid.kernel.support) * fluid.h * (1 + 1e-12)
    near = tree.query_ball_point(here, radius, return_sorted=True)
    a = np.repeat(np.arange(len(x)), [len(row) for row in near])
    b = np.concatenate([np.asarray(row, dtype=np.int64) for row in near])
    return (a[a != b], b[a != b]) if others is None else (a, b)


# ---------------------------------------------------------------------------------- accelerations


def accelerations(fluid: Fluid, x: Any) -> Any:
    """a_a = −Σ_b m_b (own·K_a + other·K_b), (N, d), at positions x (N, d), real or complex.

    Raises ValueError where h cannot follow the density.
    """
    if fluid.force.gradient == STAGGERED:
        return _from_stress_points(fluid, x)
    near = pairs(fluid, x, reach=1.25 if fluid.force.gradient == GRAD_H else 1.0)
    if fluid.force.gradient == REFERENCE:
        return _lagrangian(fluid, x)
    rho, K_a, K_b = gradients(fluid, x, near)
    P = fluid.state(rho)
    return _sum(fluid, near, P, rho, K_a, K_b)


def _sum(fluid: Fluid, near: Pairs, P: Any, rho: Any, K_a: Any, K_b: Any) -> Any:
    ends = (P[near.a], P[near.b], rho[near.a], rho[near.b])
    own, other = fluid.force.own(*ends), fluid.force.other(*ends)
    if fluid.stress is not None:
        far = np.array([fluid.stress.spacing * fluid.spacing / fluid.h], dtype=float)
        f = fluid.kernel_at(near.length / fluid.h, 0) / fluid.kernel_at(far, 0)
        held = (own, other)
        if fluid.stress.frozen:
            rest = (fluid.state.pressure,) * 2 + (fluid.state.density,) * 2
            held = (fluid.force.own(*rest), fluid.force.other(*rest))
        own = own + fluid.stress.repulsion(held[0], ends[0], f)
        other = other + fluid.stress.repulsion(held[1], ends[1], f)
    terms = _times(own, K_a) + _times(other, K_b)
    return -fluid.mass * near.total(terms)


def _times(weight: Any, vectors: Any) -> Any:
    return np.asarray(weight).reshape(-1, 1) * vectors


def gradients(fluid: Fluid, x: Any, near: Pairs) -> tuple[Any, Any, Any]:
    """ρ (N,), and what both ends of every pair see, K_a and K_b (P, d)."""
    h = fluid.h
    if fluid.force.gradient == GRAD_H:
        return _adaptive(fluid, x, near)
    rho = densities(fluid, x, near)
    K = _gradient(fluid, near.r, near.length, h)
    if fluid.force.gradient != CORRECTED:
        return rho, K, K
    C = _corrections(fluid, near, K, rho)
    return (
        rho,
        np.einsum("pij,pj->pi", C[near.a], K),
        np.einsum("pij,pj->pi", C[near.b], K),
    )


def densities(fluid: Fluid, x: Any, near: Pairs) -> Any:
    """ρ_a, (N,), at fixed h."""
    rho = _summed(fluid, near)
    if fluid.density == "summation":
        return rho
    if fluid.density == "corrected":
        return 1 + _divergence(fluid, x)
    return 1 + rho - _summed(fluid, pairs(fluid, fluid.start))


def _summed(fluid: Fluid, near: Pairs) -> Any:
    scale = fluid.mass / fluid.h**fluid.dim
    home = fluid.kernel_at(np.zeros(1), 0)
    return scale * (home + near.total(fluid.kernel_at(near.length / fluid.h, 0)))


def _divergence(fluid: Fluid, x: Any) -> Any:
    """Σ_b V_b (u_a − u_b)·C_a∇W about the start, (N,): δρ/ρ of the corrected divergence."""
    near = pairs(fluid, fluid.start)
    K = _gradient(fluid, near.r, near.length, fluid.h)
    C = _corrections(fluid, near, K, np.ones(len(x)))
    u = x - fluid.start
    moved = u[near.a] - u[near.b]
    return fluid.mass * near.total(np.einsum("pi,pij,pj->p", moved, C[near.a], K))


def _corrections(fluid: Fluid, near: Pairs, K: Any, rho: Any) -> Any:
    """C_a = (Σ_b V_b (x_b − x_a)⊗∇W)⁻¹, (N, d, d)."""
    d = fluid.dim
    weighted = -(fluid.mass / rho[near.b])[:, None, None] * K[:, :, None] * near.r[:, None, :]
    return np.linalg.inv(near.total(weighted).reshape(-1, d, d))


def _gradient(fluid: Fluid, r: Any, length: Any, h: Any) -> Any:
    """∇_aW, (P, d)."""
    return _times(fluid.kernel_at(length / h, 1) / (h ** (fluid.dim + 1) * length), r)


def _adaptive(fluid: Fluid, x: Any, near: Pairs) -> tuple[Any, Any, Any]:
    """h_a^d Σ_b m W(r, h_a) = constant by Newton's iteration; K_a = ∇W(h_a)/Ω_a."""
    m, d, length = fluid.mass, fluid.dim, near.length
    rest = pairs(fluid, fluid.start)
    constant = float(_summed(fluid, rest)[0]) * fluid.h**d
    home = float(fluid.kernel_at(np.zeros(1), 0)[0])
    h = np.full(len(x), fluid.h, dtype=near.r.dtype)
    steps = 0
    while True:
        at = h[near.a]
        q = length / at
        w, dw = fluid.kernel_at(q, 0), fluid.kernel_at(q, 1)
        total = m * (home + near.total(w))  # h^d ρ
        slope = -m * near.total(q * dw) / h  # of that
        change = (total - constant) / slope
        h = h - change
        steps += 1
        if np.abs(change.real).max() <= 1e-14 * fluid.h and steps > 2:
            break
        if steps == _ROUNDS or not np.all(np.abs(h.real / fluid.h - 1) < 0.2):
            raise ValueError(
                "grad-h: h cannot follow the density here: it leaves 0.8 to 1.2 of its value at"
                " rest; expected particles nearer to rest"
            )
    at = h[near.a]
    q = length / at
    w, dw = fluid.kernel_at(q, 0), fluid.kernel_at(q, 1)
    rho = m * (home + near.total(w)) / h**d
    # Ω = 1 + (h/(dρ)) Σ m ∂_hW,   ∂_hW = −h^{−d−1} (dŴ + qŴ′)
    grown = -m * (d * home + near.total(d * w + q * dw)) / h ** (d + 1)
    omega = 1 + h * grown / (d * rho)
    K_a = _times(dw / (at ** (d + 1) * length * omega[near.a]), near.r)
    far = h[near.b]
    slope_b = fluid.kernel_at(length / far, 1)
    K_b = _times(slope_b / (far ** (d + 1) * length * omega[near.b]), near.r)
    return rho, K_a, K_b


def _lagrangian(fluid: Fluid, x: Any) -> Any:
    """Everything on the positions of the start: F = 1 + Σ V (u_b − u_a)⊗∇W, from displacements."""
    near = pairs(fluid, fluid.start)
    d = fluid.dim
    rho = densities(fluid, fluid.start, near)
    K = _gradient(fluid, near.r, near.length, fluid.h)
    u = x - fluid.start
    moved = (u[near.b] - u[near.a])[:, :, None] * K[:, None, :]
    F = np.eye(d) + near.total((fluid.mass / rho[near.b])[:, None, None] * moved)
    J = np.linalg.det(F)
    Q = J[:, None, None] * np.swapaxes(np.linalg.inv(F), 1, 2)
    K_a = np.einsum("pij,pj->pi", Q[near.a], K)
    K_b = np.einsum("pij,pj->pi", Q[near.b], K)
    P = fluid.state(rho / J)
    return _sum(fluid, near, P, rho, K_a, K_b)


def _from_stress_points(fluid: Fluid, x: Any) -> Any:
    """1D: stress points midway between neighbours, their density by continuity from 1."""

    def between(x: Any) -> Any:
        after = np.roll(x, -1, axis=0)
        after[-1] += fluid.period
        return (x + after) / 2

    def summed(points: Any, x: Any) -> Any:
        near = pairs(fluid, points, x)
        return fluid.mass / fluid.h * near.total(fluid.kernel_at(near.length / fluid.h, 0))

    points = between(x)
    rho = 1 + summed(points, x) - summed(between(fluid.start), fluid.start)
    near = pairs(fluid, x, points)
    K = _gradient(fluid, near.r, near.length, fluid.h)
    P = fluid.state(rho)
    other = fluid.force.other(0, P[near.b], 1, rho[near.b])
    return -fluid.mass * near.total(_times(other, K))


# ------------------------------------------------------------------------------------- about rest


def linearised(fluid: Fluid, x: Any, displacement: Any) -> Any:
    """The derivative of the accelerations along a displacement, (N, d), by a complex step."""
    return accelerations(fluid, x + 1j * STEP * displacement).imag / STEP


def crystal(kind: str, cells: tuple[int, ...]) -> tuple[Array, Array, Any]:
    """Positions (N, d) of a lattice in Δx, the box (d,), and the sublattice of each particle (N,).

    cells: how many rectangular cells along each axis; see `cell`
    """
    size = cell(kind)
    kinds = KINDS[kind]
    axes = [np.arange(n * c) for n, c in zip(cells, size, strict=True)]
    m = np.array(list(product(*axes)), dtype=np.int64).T
    m = m[:, kinds.contains(m)]
    unit = np.array([float(u) for u in units(kind)])
    other = np.zeros(m.shape[1], dtype=np.int64)
    if kinds.turned is not None:
        other = np.asarray(kinds.turned(m)).astype(np.int64)
    return m.T * unit, np.array(cells) * np.array(size) * unit, other


def cell(kind: str) -> tuple[int, ...]:
    """The integer steps along each axis after which the lattice repeats."""
    if all(len(set(map(abs, row)) - {0}) <= 1 and sum(map(abs, row)) == 1
           for row in KINDS[kind].primitive):  # fmt: skip
        return (1,) * KINDS[kind].dim
    return (2, 6, 2) if kind == "hcp" else (2,) * KINDS[kind].dim


def wave_matrix(fluid: Fluid, k: Any, site: Any) -> Any:
    """D(k), (nd, nd), seen in the linearised accelerations: each column is the answer to one
    particle of the cell moving along one axis like exp(ik·X).

    k: (d,), a wave of the box; site: (N,), which particle of the cell each one is
    """
    x, d = fluid.start, fluid.dim
    cells = int(site.max()) + 1
    phase = np.exp(1j * x @ k)
    columns = []
    for j in range(cells):
        for axis in range(d):
            answer: Any = 0
            for part, factor in ((phase.real, 1), (phase.imag, 1j)):
                move = np.zeros_like(x)
                move[:, axis] = np.where(site == j, part, 0.0)
                answer = answer + factor * linearised(fluid, x, move)
            seen = -answer * np.conj(phase)[:, None]
            columns.append(np.concatenate([seen[site == i].mean(axis=0) for i in range(cells)]))
    return np.array(columns).T


# --------------------------------------------------------------------------------------- in time


def leapfrog(fluid: Fluid, x: Array, v: Array, dt: float) -> Iterator[tuple[Array, Array]]:
    """Kick, drift, kick: x and v (N, d) after every step."""
    a = accelerations(fluid, x)
    while True:
        v = v + 0.5 * dt * a
        x = x + dt * v
        a = accelerations(fluid, x)
        v = v + 0.5 * dt * a
        yield x, v


def growth_rate(
    fluid: Fluid, shape: Array, dt: float, factor: float = 30.0, most: int = 4000
) -> float:
    """The growth rate of a mode, from a run: displaced by 1e-7 of Δx along `shape` (N, d) and let
    go, its amplitude is cosh γt until it is `factor` times as large.

    Raises ValueError where it does not grow within so many steps.
    """
    small = 1e-7 * fluid.spacing
    x = fluid.start + small * shape
    for step, (now, _) in enumerate(leapfrog(fluid, x, np.zeros_like(x), dt), start=1):
        size = float(((now - fluid.start) * shape).sum() / (shape * shape).sum()) / small
        if size >= factor:
            return float(np.arccosh(size)) / (step * dt)
        if step == most:
            break
    raise ValueError(f"growth: the mode has not grown {factor:g} times within {most} steps")


# --------------------------------------------------------------------------- disordered particles


def at_rest(fluid: Fluid, rate: Rate, x: Array) -> tuple[Array, Array]:
    """The two matrices that a uniform pressure leaves of the equations at positions x:

        a = G δP, (Nd, N),        ρ̇ = R v, (N, Nd)

    Waves at rest have ω² = −c² eig(R G).
    """
    near = pairs(fluid, x, reach=1.25 if fluid.force.gradient == GRAD_H else 1.0)
    rho, K_a, K_b = gradients(fluid, x, near)
    n, d = len(x), fluid.dim
    m = fluid.mass
    a, b = near.a, near.b
    zero, one = np.zeros(len(a)), np.ones(len(a))
    G = np.zeros((n, n, d))  # a, b, axis
    for target, P_a, P_b in ((a, one, zero), (b, zero, one)):
        ends = (P_a, P_b, rho[a], rho[b])
        terms = _times(fluid.force.own(*ends) + zero, K_a) + _times(
            fluid.force.other(*ends) + zero, K_b
        )
        np.add.at(G, (a, target), -m * terms)
    R = np.zeros((n, n, d))
    seen = _times(rate.own(rho[a], rho[b]) + zero, K_a) + _times(
        rate.other(rho[a], rho[b]) + zero, K_b
    )
    np.add.at(R, (a, a), m * seen)
    np.add.at(R, (a, b), -rate.mirror * m * seen)
    return G.transpose(0, 2, 1).reshape(n * d, n), R.reshape(n, n * d)


def growth_at_rest(fluid: Fluid, rate: Rate, x: Array) -> float:
    """The largest growth rate of particles at rest under a uniform pressure, max Im ω with
    ω² = −c² eig(R G), for c² = 1."""
    G, R = at_rest(fluid, rate, x)
    values = -np.linalg.eigvals(R @ G)
    return float(np.abs(np.sqrt(values.astype(complex)).imag).max())


def displaced(kind: str, n: int, sigma: float, seed: int) -> tuple[Array, Array]:
    """A lattice of n rectangular cells along each axis with Gaussian displacements σ (in Δx along
    each axis), and the box."""
    x, period, _ = crystal(kind, (n,) * KINDS[kind].dim)
    random = np.random.default_rng(seed)
    return x + sigma * random.standard_normal(x.shape), period


def fluid_on(
    kernel: Kernel | Gaussian,
    kind: str,
    ratio: Fraction | float,
    force: Force,
    pressure: Fraction | float = 0.0,
    *,
    cells: tuple[int, ...],
    stress: ArtificialStress | None = None,
    density: str = "summation",
    gamma: float = 1.0,
) -> tuple[Fluid, Any]:
    """A fluid at rest on a lattice with Δx = 1 and c² = 1 at its own density, and the sublattices.

    pressure: p = P₀/(ρc²), ρ the density that the scheme itself has on the lattice
    """
    x, period, site = crystal(kind, cells)
    base = Fluid(kernel, force, EquationOfState(), x, period, 1 / float(ratio), stress, density)
    rho = 1.0 if force.gradient == STAGGERED else float(densities(base, x, pairs(base, x))[0])
    if stress is not None:
        stress = replace(stress, epsilon=float(stress.epsilon), spacing=float(stress.spacing))
    state = EquationOfState(1.0, float(pressure) * rho, gamma, rho)
    return replace(base, state=state, stress=stress), site
