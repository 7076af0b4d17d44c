"""Momentum equations and density rates on particles, each as the parts of a pair matrix.

A force is linear in the pressure, m a = Q P, and a density rate in the velocity, ρ̇ = D v. With
u̇ = (P/ρ²) ρ̇ the rate of the total energy is v·(Q P) + P·(m/ρ²) D v, which is zero for every v and
P if and only if D = −(ρ²/m) Qᵀ: a force has one partner, its adjoint. Momentum is conserved for
every P if and only if the columns of Q add up to zero, which says of the partner that it sees
differences of velocities alone.

The forms are those of `sphtrunc.forces`; here their weights become arrays, their gradients kernels
of h_a or h_b. Beside them RKPM-1: collocated, Σ P_b ∇ψ_b(x_a), and Galerkin's, Σ V_qP_q ∇ψ_a(x_q)
(Bonet & Kulasegaram 2000, doi:10.1002/(SICI)1097-0207(20000228)47:6<1189::AID-NME830>3.0.CO;2-I,
on corrected kernels and the energy).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from sphtrunc.arithmetic.bounded import Ball, Bounded
from sphtrunc.arithmetic.linear_systems import MOST_CONDITION, Health
from sphtrunc.arithmetic.plain import Plain
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.arithmetic.summation import UNIT, Array
from sphtrunc.experiment.adapted_lengths import grad_h
from sphtrunc.experiment.engine import pair_sums
from sphtrunc.experiment.pair_matrices import Action, Cloud, Part, act, adjoint, scaled
from sphtrunc.operators.forces import CORRECTED, FORCES, GRAD_H, PLAIN, RATES, Force, Rate
from sphtrunc.operators.h_rules import FORCE_RULES, Sides
from sphtrunc.operators.moments import add, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.particles import particles

VARYING = tuple(rule for rule in FORCE_RULES if rule != "constant")


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
    def per_square(self) -> Array:
        """m/ρ²."""
        return self.mass / (self.density * self.density)

    def some(self, index: Any) -> State:
        """Some of the particles with the factors that they have among all."""
        cloud = replace(self.cloud, x=self.cloud.x[:, index], h=self.cloud.h[index])
        part = State(cloud, self.mass[index], self.density[index], self.pressure[index])
        known: dict[str, Any] = {
            "_corrections": {
                sides: [[x[index] for x in row] for row in c]
                for sides, c in self._corrections.items()
            },
        }
        if "omega" in self.__dict__:
            known["omega"] = self.omega[index]
        if "reproducing" in self.__dict__:
            rows, off = self.reproducing
            small = [{key: c[index] for key, c in row.items()} for row in rows]
            known["reproducing"] = (small, off[index])
        part.__dict__.update(known)
        return part

    @cached_property
    def omega(self) -> Array:
        """Ω = 1 + (h/dρ) ∂ρ/∂h of the summation ρ = Σ m W(h_a), which is Σ_i m[e_i, e_i]/(d ρ)."""
        cloud = self.cloud
        scene = particles(cloud.x.T, h=cloud.h, volume=self.mass, period=cloud.period)
        return grad_h(scene, cloud.kernel, cloud.workers)[1]

    @cached_property
    def _products(self) -> dict[Any, tuple[Array, ...]]:
        """Factors that have been made, by what they are of: forms have many in common."""
        return {}

    def product(self, one: Array, other: Array) -> Array:
        """one·other, made once for the same two."""
        name = id(one), id(other)
        if name not in self._products:
            self._products[name] = one * other, one, other  # kept, so that their ids stay theirs
        return self._products[name][0]

    @cached_property
    def _corrections(self) -> dict[Sides, list[list[Array]]]:
        return {}

    def correction(self, sides: Sides) -> list[list[Array]]:
        """C = B⁻¹, d rows of d (n,), B_ij = Σ_b V_b (x_b − x_a)_j ∂_iW on these sides."""
        if sides not in self._corrections:
            dim, n = self.dim, self.cloud.count
            columns = act(self.cloud, self.moment_matrix(sides))
            b = [[columns[j].value[i] for j in range(dim)] for i in range(dim)]
            health = Health()
            c = solve(b, [[float(i == j) for j in range(dim)] for i in range(dim)], health)
            _require(health, n, "csph")
            self._corrections[sides] = [[np.broadcast_to(x, (n,)) for x in row] for row in c]
        return self._corrections[sides]

    def moment_matrix(self, sides: Sides) -> list[tuple[list[Part], Array]]:
        """What makes the columns of B."""
        dim, ones = self.dim, np.ones(self.cloud.count)
        return [
            (
                [
                    Part(i, side, (unit(dim, i), unit(dim, j)), share * ones, self.volume, True)
                    for side, share in sides
                    for i in range(dim)
                ],
                ones,
            )
            for j in range(dim)
        ]

    def deviation(self, sides: Sides, columns: Sequence[Action]) -> Array:
        """How far any entry of C B may be from 1, (n,), by the rounding of the sums and of the
        solution; columns: of B, with their bounds."""
        dim, c = self.dim, self.correction(sides)
        b = [[columns[j].value[i] for j in range(dim)] for i in range(dim)]
        off = np.zeros(self.cloud.count)
        for i in range(dim):
            for j in range(dim):
                terms = [c[i][k] * b[k][j] for k in range(dim)]
                size = float(i == j) + sum(np.abs(x) for x in terms)
                off += np.abs(sum(terms) - float(i == j)) + (dim + 2.0) * UNIT * size
                for k in range(dim):
                    bound = columns[j].bound
                    assert bound is not None
                    off += np.abs(c[i][k]) * bound[k]
        return off

    @cached_property
    def reproducing(self) -> tuple[list[dict[Key, Array]], Array]:
        """c[δ, γ] of the gradient of the RKPM-1 kernel at every particle, in units of 1/h, and how
        far its sums of linear fields may be from their values, (n,), in the same units."""
        operator = Operator("gradient", "standard", "rkpm-1")
        cloud, dim = self.cloud, self.dim
        needed = operator.needed(dim, 1)
        scene = particles(cloud.x.T, h=cloud.h, volume=self.volume, period=cloud.period)
        found = pair_sums(scene, cloud.kernel, needed, bound=True, workers=cloud.workers)
        assert found.base_bound is not None
        number, health = Bounded(Plain()), Health()
        none = np.zeros(cloud.count)
        balls = {
            key: Ball(found.base[key], none, {i: found.base_bound[key]})
            for i, key in enumerate(needed)
        }
        rows = operator.coefficients(
            balls, dim, lambda matrix, columns: number.solve(matrix, columns, health)
        )
        _require(health, cloud.count, "rkpm-1")
        off = np.zeros(cloud.count)
        middles: list[dict[Key, Array]] = []
        for axis, row in enumerate(rows):
            middles.append(
                {k: np.broadcast_to(number.value(c), none.shape) for k, c in row.items()}
            )
            for alpha in (unit(dim, 0, 0), *(unit(dim, i) for i in range(dim))):
                total = sum((c * balls[d, add(alpha, g)] for (d, g), c in row.items()), 0)
                off += np.abs(number.value(total) - float(alpha == unit(dim, axis)))
                off += number.rest(total)
        return middles, off


def _require(health: Health, count: int, name: str) -> None:
    condition = np.broadcast_to(health.condition, (count,))
    bad = np.flatnonzero(~(condition <= MOST_CONDITION))
    if bad.size:
        raise ValueError(
            f"correction: the matrix of {name} at {bad.size} particles is too near to singular; the"
            f" first is particle {bad[0]}; expected a larger h, or no correction"
        )


# ------------------------------------------------------------------------ weights become factors


def _factors(weight: Callable[..., Any], density: Array) -> tuple[Array, Array] | None:
    """l, r with weight(ρ_a, ρ_b) = l_a r_b, of a weight that is such a product; None if it is 0.

    Raises ValueError where it is not such a product.
    """
    one = np.float64(1.0)
    scale = float(weight(one, one))
    if scale == 0.0:
        return None
    left = np.broadcast_to(np.asarray(weight(density, one), dtype=np.float64), density.shape)
    right = np.broadcast_to(np.asarray(weight(one, density), dtype=np.float64), density.shape)
    right = right / scale
    two, three = np.float64(2.0), np.float64(3.0)
    product = weight(two, one) * weight(one, three) / scale
    if abs(weight(two, three) - product) > 8.0 * UNIT * abs(product):
        raise ValueError("form: its weight is not a product of one factor for each particle")
    return left, right


def _ends(
    state: State, rule: str, gradient: str, end: str, left: Array, right: Array, own: bool
) -> Iterator[Part]:
    """Parts of l_a Σ r_b K A: K = K_a or K_b (`end`) on the sides of the rule, with Ω or C."""
    sides = FORCE_RULES[rule][end == "b"]
    dim = state.dim
    zero = unit(dim, 0, 0)
    diagonal = [(i, i) for i in range(dim)]
    rows = [(left, right, diagonal)]
    if gradient == GRAD_H:
        per = 1.0 / state.omega
        rows = [(left * per, right, diagonal) if end == "a" else (left, right * per, diagonal)]
    elif gradient == CORRECTED:
        c = state.correction(FORCE_RULES[rule][0])
        axes = [(i, j) for i in range(dim) for j in range(dim)]
        rows = [
            (state.product(left, c[i][j]), right, [(i, j)])
            if end == "a"
            else (left, state.product(right, c[i][j]), [(i, j)])
            for i, j in axes
        ]
    for l_row, r_row, axes in rows:
        for side, share in sides:
            for component, axis in axes:
                l_part = l_row if share == 1.0 else share * l_row
                yield Part(component, side, (unit(dim, axis), zero), l_part, r_row, own)


def _weighed(
    state: State, weight: Callable[..., Any], pressures: tuple[float, float]
) -> tuple[Array, Array] | None:
    """−m l and m r of the weight of one of the pressures, made once."""
    name = weight, pressures
    if name not in state._products:
        found = _factors(lambda a, b: weight(*pressures, a, b), state.density)
        left_right = () if found is None else (-state.mass * found[0], state.mass * found[1])
        state._products[name] = left_right
    made = state._products[name]
    return (made[0], made[1]) if made else None


def force_parts(state: State, force: Force, rule: str) -> list[Part]:
    """Q of m a = Q P."""
    parts: list[Part] = []
    for end, weight in (("a", force.own), ("b", force.other)):
        for own in (True, False):
            pressures = (1.0, 0.0) if own else (0.0, 1.0)
            found = _weighed(state, weight, pressures)
            if found is not None:
                left, right = found
                parts += _ends(state, rule, force.gradient, end, left, right, own)
    return parts


def rate_parts(state: State, rate: Rate, rule: str, gradient: str = PLAIN) -> list[Part]:
    """D of ρ̇ = D v."""
    parts: list[Part] = []
    for end, weight in (("a", rate.own), ("b", rate.other)):
        name = rate.name, end
        if name not in state._products:
            found = _factors(weight, state.density)
            made: tuple[Array, ...] = ()
            if found is not None:
                made = found[0], -rate.mirror * found[0], state.mass * found[1]
            state._products[name] = made
        if state._products[name]:
            left, back, right = state._products[name]
            parts += _ends(state, rule, gradient, end, left, right, True)
            parts += _ends(state, rule, gradient, end, back, right, False)
    return parts


def _strong(state: State) -> list[Part]:
    """−V_a Σ_b P_b ∇ψ_b(x_a), ψ_b(x) = V_b c(x)·(1, x_b − x) W."""
    rows, _ = state.reproducing
    h = state.cloud.h
    return [
        Part(
            axis,
            "a",
            (delta, gamma),
            -state.volume * c * h ** float(sum(delta) - sum(gamma) - 1),
            state.volume,
            False,
        )
        for axis, row in enumerate(rows)
        for (delta, gamma), c in row.items()
    ]


def _galerkin(state: State) -> list[Part]:
    """m_a a_a = Σ_q V_qP_q ∇ψ_a(x_q): the transposed collocation, less its sign."""
    return scaled(adjoint(_strong(state)), -1.0)


# -------------------------------------------------------------------------------- what there is


@dataclass(frozen=True)
class Form:
    """A momentum equation as it is offered: formula; correction; the degree of pressures whose
    force is exact on any arrangement (−1: none); the (form, correction) of the `Operator` that it
    is where all densities are equal, if it is one; and the forces entry, None for RKPM."""

    says: str
    correction: str
    consistency: int
    operator: tuple[str, str] | None
    force: Force | None

    def rules(self, varying: bool) -> tuple[str, ...]:
        """The rules for h that it can take."""
        if not varying:
            return ("constant",)
        if self.force is None:
            return ("gather",)
        if self.force.gradient == GRAD_H:
            return ("grad-h",)
        ends = ("grad-h",) if self.two_ended else ("grad-h", "no-omega")
        return tuple(rule for rule in VARYING if rule not in ends)

    @property
    def two_ended(self) -> bool:
        """Both ends of a pair bring a gradient of their own."""
        return self.force is not None and self.force.other(1.0, 2.0, 3.0, 5.0) != 0

    def degree(self, rule: str) -> int:
        """`consistency` under a rule: a difference of two kernels is not exact for constants."""
        apart = FORCE_RULES[rule][0] != FORCE_RULES[rule][1]
        return -1 if apart and self.two_ended else self.consistency


_KNOWN = {  # what no algebra of weights says: consistency, and the operator at equal densities
    "symmetric": (-1, ("symmetric", "none")),
    "symmetric-product": (-1, ("symmetric", "none")),
    "difference": (0, ("difference", "none")),
    "grad-h": (-1, None),
    "csph": (1, ("difference", "csph")),
    "csph-sum": (-1, None),
    "csph-symmetric": (-1, None),
    "csph-mean": (-1, None),
}
FORMS: dict[str, Form] = {
    name: Form(
        FORCES[name].says,
        "csph" if FORCES[name].gradient == CORRECTED else "none",
        *_KNOWN[name],
        FORCES[name],
    )
    for name in _KNOWN
} | {
    "rkpm-strong": Form(
        "a_a = −(1/ρ_a) Σ P_b ∇ψ_b(x_a)", "rkpm-1", 1, ("standard", "rkpm-1"), None
    ),
    "rkpm-galerkin": Form("m_a a_a = Σ_q V_qP_q ∇ψ_a(x_q)", "rkpm-1", -1, None, None),
}


def parts_of(state: State, name: str, rule: str) -> list[Part]:
    """Q of a form under a rule for h."""
    force = FORMS[name].force
    if force is not None:
        return force_parts(state, force, rule)
    return _strong(state) if name == "rkpm-strong" else _galerkin(state)


def rates(state: State, name: str, rule: str) -> dict[str, Callable[[], list[Part]]]:
    """The density rates beside which a form is looked at, each as what makes its parts: of the
    catalogue, with the gradient that the form has, and with the plain one."""
    force = FORMS[name].force
    if force is None:
        return {
            "−ρ_a Σ v_b·∇ψ_b(x_a)": lambda: scaled(_strong(state), state.density / state.volume),
            **{r.name: partial(rate_parts, state, r, rule) for r in RATES.values()},
        }
    gradients = dict.fromkeys((force.gradient, PLAIN))
    first = sorted(RATES.values(), key=lambda rate: rate.name != force.rate)
    return {
        rate.name if gradient == PLAIN else f"{rate.name} ({gradient})": partial(
            rate_parts, state, rate, rule, gradient
        )
        for gradient in gradients
        for rate in first
    }


def partner(state: State, parts: Sequence[Part]) -> list[Part]:
    """The density rate with which a force keeps the energy: −(ρ²/m) Qᵀ, computed."""
    return scaled(adjoint(parts), -1.0 / state.per_square)
