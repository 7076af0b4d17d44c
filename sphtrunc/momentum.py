"""Momentum equations and density rates of SPH, each as the parts of a pair matrix.

A force is linear in the pressure, m a = Q P, and a density rate in the velocity, ρ̇ = D v. With
u̇ = (P/ρ²) ρ̇ the rate of the total energy is v·(Q P) + P·(m/ρ²) D v, which is zero for every v and
P if and only if D = −(ρ²/m) Qᵀ: a force has one partner, its adjoint. Momentum is conserved for
every P if and only if the columns of Q add up to zero, which says of the partner that it sees
differences of velocities alone.

Forms: Monaghan (1992) doi:10.1146/annurev.aa.30.090192.002551; corrected: Bonet & Lok (1999)
doi:10.1016/S0045-7825(99)00051-1; the geometric mean: Hernquist & Katz (1989) doi:10.1086/191344;
grad-h: Springel & Hernquist (2002) doi:10.1046/j.1365-8711.2002.05445.x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sphtrunc.arithmetic import MOST_CONDITION, Health
from sphtrunc.bounded import Ball, Bounded
from sphtrunc.arithmetic import Plain
from sphtrunc.engine import pair_sums
from sphtrunc.estimates import solve
from sphtrunc.moments import unit
from sphtrunc.operators import Key, Operator
from sphtrunc.pairwise import Cloud, Part, adjoint, gradient_parts, scaled
from sphtrunc.particles import particles
from sphtrunc.summation import UNIT, Array

#: rule: sides of the kernel in the particle's own term and in the neighbours', each with its
#: weight, and whether both are divided by their particle's Ω
H_RULES: dict[str, tuple[tuple[tuple[str, float], ...], tuple[tuple[str, float], ...], bool]] = {
    "gather": ((("a", 1.0),), (("a", 1.0),), False),
    "scatter": ((("b", 1.0),), (("b", 1.0),), False),
    "mean": ((("mean", 1.0),), (("mean", 1.0),), False),
    "mean-kernel": ((("a", 0.5), ("b", 0.5)), (("a", 0.5), ("b", 0.5)), False),
    "no-omega": ((("a", 1.0),), (("b", 1.0),), False),
    "grad-h": ((("a", 1.0),), (("b", 1.0),), True),
}


@dataclass(frozen=True, eq=False)
class State:
    """Particles with what a momentum equation needs.

    cloud: positions and h; mass, density, pressure: (n,); the volumes are m/ρ
    """

    cloud: Cloud
    mass: Array
    density: Array
    pressure: Array

    @property
    def dim(self) -> int:
        return self.cloud.dim

    @cached_property
    def volume(self) -> Array:
        return self.mass / self.density

    @cached_property
    def ones(self) -> Array:
        return np.ones(self.cloud.count)

    @cached_property
    def per_square(self) -> Array:
        """m/ρ²."""
        return self.mass / (self.density * self.density)

    @cached_property
    def omega(self) -> Array:
        """Ω_a = Σ_i m[e_i, e_i]/(d ρ_a): 1 + (h/dρ) ∂ρ/∂h, the sums weighted with m, h of a."""
        zero = unit(self.dim, 0, 0)
        axes = [unit(self.dim, i) for i in range(self.dim)]
        keys: list[Key] = [(zero, zero), *((e, e) for e in axes)]
        scene = self._weighted(self.mass)
        sums = pair_sums(scene, self.cloud.kernel, keys, workers=self.cloud.workers).base
        return sum(sums[e, e] for e in axes) / (self.dim * sums[zero, zero])

    @cached_property
    def correction(self) -> Array:
        """C = B⁻¹, (d, d, n), B_ij = Σ_b V_b (x_b − x_a)_j ∂_iW of h_a."""
        return self._correction[0]

    @cached_property
    def defect(self) -> Array:
        """(n,) how far C B may be from 1, every entry: the sums' rounding and the solution's."""
        return self._correction[1]

    @cached_property
    def _correction(self) -> tuple[Array, Array]:
        dim = self.dim
        axes = [unit(dim, i) for i in range(dim)]
        keys: list[Key] = [(e, f) for e in axes for f in axes]
        found = pair_sums(
            self._weighted(self.volume),
            self.cloud.kernel,
            keys,
            bound=True,
            workers=self.cloud.workers,
        )
        assert found.base_bound is not None
        b = [[found.base[e, f] for f in axes] for e in axes]
        health = Health()
        identity = [[float(i == j) for j in range(dim)] for i in range(dim)]
        c = solve(b, identity, health)
        _require(health, found.others, "csph")
        off = np.zeros(self.cloud.count)
        for i in range(dim):
            for j in range(dim):
                rest: Any = -float(i == j)
                size: Any = float(i == j)
                for k in range(dim):
                    rest = rest + c[i][k] * b[k][j]
                    size = size + np.abs(c[i][k] * b[k][j])
                    off = np.maximum(off, 0.0) + np.abs(c[i][k]) * (
                        found.base_bound[axes[k], axes[j]]
                    )
                off = off + np.abs(rest) + (dim + 2.0) * UNIT * size
        return np.stack([np.stack(row) for row in c]), off

    @cached_property
    def reproducing(self) -> tuple[list[dict[Key, Array]], Array]:
        """c[δ, γ] of the gradient of the RKPM-1 kernel at every particle, in units of 1/h, and how
        far its sums of constant fields may be from zero, (n,), in units of 1/h."""
        operator = Operator("gradient", "standard", "rkpm-1")
        needed = operator.needed(self.dim, 0)
        found = pair_sums(
            self._weighted(self.volume),
            self.cloud.kernel,
            needed,
            bound=True,
            workers=self.cloud.workers,
        )
        assert found.base_bound is not None
        number, health = Bounded(Plain()), Health()
        balls = {
            key: Ball(found.base[key], np.zeros(self.cloud.count), {i: found.base_bound[key]})
            for i, key in enumerate(needed)
        }
        rows = operator.coefficients(
            balls, self.dim, lambda matrix, columns: number.solve(matrix, columns, health)
        )
        _require(health, found.others, "rkpm-1")
        zero = unit(self.dim, 0, 0)
        off = np.zeros(self.cloud.count)
        middles: list[dict[Key, Array]] = []
        for row in rows:
            part = {key: np.broadcast_to(number.value(c), off.shape) for key, c in row.items()}
            total = sum((c * balls[d, _sum(zero, g)] for (d, g), c in row.items()), 0)
            off = off + np.abs(number.value(total)) + number.rest(total)
            middles.append({key: np.array(c) for key, c in part.items()})
        return middles, off

    def _weighted(self, weight: Array) -> Any:
        cloud = self.cloud
        return particles(cloud.x.T, h=cloud.h, volume=weight, period=cloud.period, mode="gather")


def _sum(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _require(health: Health, others: Any, name: str) -> None:
    condition = np.broadcast_to(health.condition, others.shape)
    bad = np.flatnonzero(~(condition <= MOST_CONDITION))
    if bad.size:
        raise ValueError(
            f"correction: the matrix of {name} at {bad.size} particles is too near to singular; the"
            f" first is particle {bad[0]} with {others[bad[0]]} neighbours; expected a larger h,"
            " or no correction"
        )


# ------------------------------------------------------------------------------ building blocks

Column = list[tuple[Array, Array]]  # rows (l, r) of a scalar factor


def _pair(
    state: State,
    rule: str,
    own: list[tuple[Array, Array]],
    other: list[tuple[Array, Array]],
    axes: list[tuple[int, int]] | None = None,
) -> list[Part]:
    """Parts of −Σ [own_a ∇W A_a + other ∇W A_b] for rows (l, r), on the sides of the rule.

    axes: for each row of both, (component, axis of ∇W); None: every component from its own axis
    """
    sides, others, omega = H_RULES[rule]
    dim = state.dim
    made = []
    per_omega = 1.0 / state.omega if omega else None
    for rows, where, mine in ((own, sides, True), (other, others, False)):
        for n, (left, right) in enumerate(rows):
            if per_omega is not None:
                left, right = (left * per_omega, right) if mine else (left, right * per_omega)
            pairs = [(i, i) for i in range(dim)] if axes is None else [axes[n]]
            for side, weight in where:
                for component, axis in pairs:
                    part = gradient_parts(side, axis, dim, -weight * left, right, own=mine)
                    made.append(Part(component, side, part.key, part.left, part.right, mine))
    return made


# --------------------------------------------------------------------------------------- forces


def _symmetric(state: State, rule: str) -> list[Part]:
    """−m_a Σ m_b (P_a/ρ_a² + P_b/ρ_b²) ∇W."""
    return _pair(
        state, rule, [(state.per_square, state.mass)], [(state.mass, state.per_square)]
    )


def _product(state: State, rule: str) -> list[Part]:
    """−m_a Σ m_b (P_a + P_b)/(ρ_aρ_b) ∇W."""
    volume = state.volume
    return _pair(state, rule, [(volume, volume)], [(volume, volume)])


def _geometric(state: State, rule: str) -> list[Part]:
    """−m_a Σ m_b 2√(P_aP_b)/(ρ_aρ_b) ∇W, as it acts on P_a and P_b alike."""
    if not np.all(state.pressure > 0.0):
        raise ValueError("form: geometric takes the root of P_aP_b; expected positive pressures")
    root = np.sqrt(state.pressure)
    over, times = state.volume / root, state.volume * root
    return _pair(state, rule, [(over, times)], [(times, over)])


def _difference(state: State, rule: str) -> list[Part]:
    """−m_a Σ m_b (P_b − P_a)/(ρ_aρ_b) ∇W."""
    volume = state.volume
    return _pair(state, rule, [(-volume, volume)], [(volume, volume)])


def _tensor(state: State, where: str, weight: Array) -> tuple[list[Any], list[tuple[int, int]]]:
    """Rows of factors weight·C, of the particle ("a") or of the neighbour, and their axes."""
    c, dim = state.correction, state.dim
    axes = [(i, j) for i in range(dim) for j in range(dim)]
    rows = [
        (weight * c[i, j], state.volume) if where == "a" else (state.volume, weight * c[i, j])
        for i, j in axes
    ]
    return rows, axes


def _corrected_difference(state: State, rule: str) -> list[Part]:
    """−V_a Σ V_b (P_b − P_a) C_a∇W."""
    rows, axes = _tensor(state, "a", state.volume)
    own = [(-left, right) for left, right in rows]
    return [*_pair(state, rule, own, [], axes), *_pair(state, rule, [], rows, axes)]


def _one_sided(state: State, rule: str) -> list[Part]:
    """−V_a Σ V_b (P_a + P_b) C_a∇W."""
    rows, axes = _tensor(state, "a", state.volume)
    return [*_pair(state, rule, rows, [], axes), *_pair(state, rule, [], rows, axes)]


def _bonet_lok(state: State, rule: str) -> list[Part]:
    """−V_a Σ V_b (P_aC_a + P_bC_b)∇W."""
    rows, axes = _tensor(state, "a", state.volume)
    others, _ = _tensor(state, "b", state.volume)
    return [*_pair(state, rule, rows, [], axes), *_pair(state, rule, [], others, axes)]


def _mean_corrected(state: State, rule: str) -> list[Part]:
    """−V_a Σ V_b (P_a + P_b) ½(C_a + C_b)∇W."""
    rows, axes = _tensor(state, "a", 0.5 * state.volume)
    others, _ = _tensor(state, "b", 0.5 * state.volume)
    parts: list[Part] = []
    for one in (rows, others):
        parts += [*_pair(state, rule, one, [], axes), *_pair(state, rule, [], one, axes)]
    return parts


def _strong(state: State, rule: str) -> list[Part]:
    """−V_a Σ_b P_b ∇ψ_b(x_a), ψ_b(x) = V_b c(x)·(1, x_b − x) W: consistent of first order."""
    rows, _ = state.reproducing
    h = state.cloud.h
    parts = []
    for axis, row in enumerate(rows):
        for (delta, gamma), c in row.items():
            left = -state.volume * c * h ** float(sum(delta) - sum(gamma) - 1)
            parts.append(Part(axis, "a", (delta, gamma), left, state.volume, False))
    return parts


def _galerkin(state: State, rule: str) -> list[Part]:
    """m_a a_a = Σ_q V_qP_q ∇ψ_a(x_q): the transposed strong form, less the sign."""
    return scaled(adjoint(_strong(state, rule)), -1.0)


@dataclass(frozen=True)
class Form:
    """A momentum equation: formula, the degree of the pressure up to which it is exact on any
    arrangement (−1: none), the `Operator` (form, correction) that it is where ρ is constant, and
    its parts. `fixed`: its kernel takes h of a particle for its correction, and no other."""

    formula: str
    consistency: int
    operator: tuple[str, str] | None
    parts: Callable[[State, str], list[Part]]
    fixed: bool = False


#: (form, correction): the momentum equations
FORCES: dict[tuple[str, str], Form] = {
    ("symmetric", "none"): Form("P_a/ρ_a² + P_b/ρ_b²", -1, ("symmetric", "none"), _symmetric),
    ("product", "none"): Form("(P_a + P_b)/ρ_aρ_b", -1, ("symmetric", "none"), _product),
    ("geometric", "none"): Form("2√(P_aP_b)/ρ_aρ_b", -1, None, _geometric),
    ("difference", "none"): Form("(P_b − P_a)/ρ_aρ_b", 0, ("difference", "none"), _difference),
    ("difference", "csph"): Form(
        "C_a(P_b − P_a)/ρ_aρ_b", 1, ("difference", "csph"), _corrected_difference
    ),
    ("one-sided", "csph"): Form("C_a(P_a + P_b)/ρ_aρ_b", -1, None, _one_sided),
    ("symmetric", "csph"): Form("(P_aC_a + P_bC_b)/ρ_aρ_b", -1, None, _bonet_lok),
    ("mean", "csph"): Form("½(C_a + C_b)(P_a + P_b)/ρ_aρ_b", -1, None, _mean_corrected),
    ("strong", "rkpm-1"): Form("P_b ∇ψ_b(x_a)", 1, ("standard", "rkpm-1"), _strong, True),
    ("galerkin", "rkpm-1"): Form("V_qP_q ∇ψ_a(x_q)", -1, None, _galerkin, True),
}


# ---------------------------------------------------------------------------------------- rates


def _rate(
    state: State, sides: str, own: list[Any], other: list[Any], axes: Any = None
) -> list[Part]:
    """Parts of Σ [own v_a − other v_b]·∇W, the kernel on the sides of a rule, in both alike."""
    flat = H_RULES[sides][0]
    made = []
    for rows, sign, mine in ((own, 1.0, True), (other, -1.0, False)):
        for n, (left, right) in enumerate(rows):
            pairs = [(i, i) for i in range(state.dim)] if axes is None else [axes[n]]
            for side, weight in flat:
                for component, axis in pairs:
                    key = unit(state.dim, axis), unit(state.dim, 0, 0)
                    made.append(Part(component, side, key, sign * weight * left, right, mine))
    return made


def _summation(state: State, sides: str) -> list[Part]:
    rows = [(state.ones, state.mass)]
    return _rate(state, sides, rows, rows)


def _omega(state: State, sides: str) -> list[Part]:
    return scaled(_summation(state, sides), 1.0 / state.omega)


def _continuity(state: State, sides: str) -> list[Part]:
    rows = [(state.density, state.volume)]
    return _rate(state, sides, rows, rows)


def _mean_velocity(state: State, sides: str) -> list[Part]:
    rows = [(-state.density, state.volume)]
    return _rate(state, sides, rows, [(state.density, state.volume)])


def _geometric_rate(state: State, sides: str) -> list[Part]:
    root = np.sqrt(state.pressure)
    rows = [(state.density / root, state.volume * root)]
    return _rate(state, sides, rows, rows)


def _corrected_rate(state: State, sides: str) -> list[Part]:
    c, dim = state.correction, state.dim
    axes = [(i, j) for i in range(dim) for j in range(dim)]
    rows = [(state.density * c[i, j], state.volume) for i, j in axes]
    return [*_rate(state, sides, rows, [], axes), *_rate(state, sides, [], rows, axes)]


def _mean_corrected_rate(state: State, sides: str) -> list[Part]:
    c, dim = state.correction, state.dim
    axes = [(i, j) for i in range(dim) for j in range(dim)]
    mine = [(0.5 * state.density * c[i, j], state.volume) for i, j in axes]
    theirs = [(0.5 * state.density, state.volume * c[i, j]) for i, j in axes]
    parts: list[Part] = []
    for rows in (mine, theirs):
        parts += [*_rate(state, sides, rows, [], axes), *_rate(state, sides, [], rows, axes)]
    return parts


def _reproduced_rate(state: State, sides: str) -> list[Part]:
    """−ρ_a Σ v_b·∇ψ_b(x_a)."""
    rows, _ = state.reproducing
    h = state.cloud.h
    parts = []
    for axis, row in enumerate(rows):
        for (delta, gamma), c in row.items():
            left = -state.density * c * h ** float(sum(delta) - sum(gamma) - 1)
            parts.append(Part(axis, "a", (delta, gamma), left, state.volume, False))
    return parts


@dataclass(frozen=True)
class Rate:
    """A density rate: formula, and its parts for a rule whose sides the kernel takes."""

    formula: str
    parts: Callable[[State, str], list[Part]]
    needs: str = "none"


RATES: dict[str, Rate] = {
    "summation": Rate("Σ m_b v_ab·∇W", _summation),
    "continuity": Rate("ρ_a Σ V_b v_ab·∇W", _continuity),
    "geometric": Rate("ρ_a Σ V_b √(P_b/P_a) v_ab·∇W", _geometric_rate, "positive"),
    "mean-velocity": Rate("−ρ_a Σ V_b (v_a + v_b)·∇W", _mean_velocity),
    "corrected": Rate("ρ_a Σ V_b v_ab·C_a∇W", _corrected_rate, "csph"),
    "mean-corrected": Rate("ρ_a Σ V_b v_ab·½(C_a + C_b)∇W", _mean_corrected_rate, "csph"),
    "omega": Rate("Ω_a⁻¹ Σ m_b v_ab·∇W(h_a)", _omega),
    "rkpm-1": Rate("−ρ_a Σ v_b·∇ψ_b(x_a)", _reproduced_rate, "rkpm-1"),
}


def partner(state: State, parts: list[Part]) -> list[Part]:
    """The density rate with which a force keeps the energy: −(ρ²/m) Qᵀ, computed."""
    return scaled(adjoint(parts), -1.0 / state.per_square)
