"""Forces: the forms of the momentum equation as values, each with the density rate that belongs to
it.

A particle feels

    a_a = −Σ_b m_b (own·K_a + other·K_b)                                              (momentum)
    ρ̇_a = Σ_b m_b (v_a − μ v_b)·(own·K_a + other·K_b)                                 (density)

with weights `own` and `other` of pressures and densities at both ends, and gradients with respect
to x_a that the two ends see: K = ∇W of the pair; ∇W(h_a)/Ω_a and ∇W(h_b)/Ω_b where h follows the
density; C_a∇W and C_b∇W where a correction makes the gradient of linear fields exact. With
u̇ = (P/ρ²) ρ̇ the energy is conserved exactly if the force is the `adjoint` of the rate,

    m_a a_a = −Σ_b (m_a P_a/ρ_a² G_ab − m_b P_b/ρ_b² G_ba),       ρ̇_a = Σ_b G_ab·v_ab.

Everything here is algebra: weights take numbers, fractions, complex numbers or arrays alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: (P_a, P_b, ρ_a, ρ_b) -> coefficient
Weight = Callable[[Any, Any, Any, Any], Any]
#: (ρ_a, ρ_b) -> coefficient
RateWeight = Callable[[Any, Any], Any]

#: the gradients that the two ends of a pair see
PLAIN = "plain"  # K_a = K_b = ∇W
GRAD_H = "grad-h"  # K_a = ∇W(h_a)/Ω_a
CORRECTED = "csph"  # K_a = C_a∇W,  C_a = (Σ_b V_b (x_b − x_a)⊗∇W)⁻¹
REFERENCE = "reference"  # K_a = J_a F_a⁻ᵀ∇W(X), of the positions X that the particles started from
STAGGERED = "staggered"  # K_b = ∇W from stress points b, which lie between the particles a


@dataclass(frozen=True)
class Rate:
    """A density rate, ρ̇_a = Σ_b m_b (v_a − mirror·v_b)·(own·K_a + other·K_b).

    mirror: 1 for differences of velocities; −1 for their sum, which is not Galilean invariant
    """

    name: str
    says: str
    own: RateWeight
    other: RateWeight
    mirror: int = 1


@dataclass(frozen=True)
class Force:
    """A form of the momentum equation, a_a = −Σ_b m_b (own·K_a + other·K_b).

    says: the formula; gradient: which K; rate: the name in `RATES` of its energy partner with the
    same K, None where there is none. For the gradient `REFERENCE` the densities are those of the
    reference state.
    """

    name: str
    says: str
    own: Weight
    other: Weight
    gradient: str = PLAIN
    rate: str | None = None
    source: str = ""

    def pull(self, P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
        """Φ = own + other: what multiplies ∇W where both ends see the same gradient."""
        return self.own(P_a, P_b, rho_a, rho_b) + self.other(P_a, P_b, rho_a, rho_b)


def _nothing(rho_a: Any, rho_b: Any) -> Any:
    return 0


RATES: dict[str, Rate] = {
    rate.name: rate
    for rate in (
        Rate(
            "summation",
            "ρ̇_a = Σ m_b (v_a − v_b)·K_a, the rate of ρ_a = Σ m_b W",
            lambda rho_a, rho_b: 1,
            _nothing,
        ),
        Rate(
            "continuity",
            "ρ̇_a = ρ_a Σ V_b (v_a − v_b)·K_a",
            lambda rho_a, rho_b: rho_a / rho_b,
            _nothing,
        ),
        Rate(
            "mean-continuity",
            "ρ̇_a = ρ_a Σ V_b (v_a − v_b)·(K_a + K_b)/2",
            lambda rho_a, rho_b: rho_a / rho_b / 2,
            lambda rho_a, rho_b: rho_a / rho_b / 2,
        ),
        Rate(
            "flux",
            "ρ̇_a = −ρ_a Σ V_b (v_a + v_b)·K_a",
            lambda rho_a, rho_b: -rho_a / rho_b,
            _nothing,
            mirror=-1,
        ),
    )
}


def adjoint(rate: Rate, gradient: str = PLAIN) -> Force:
    """The force that conserves energy with this density rate, from the rule above."""
    mu = rate.mirror

    def own(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
        return P_a / rho_a**2 * rate.own(rho_a, rho_b) + mu * P_b / rho_b**2 * rate.other(
            rho_b, rho_a
        )

    def other(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
        return P_a / rho_a**2 * rate.other(rho_a, rho_b) + mu * P_b / rho_b**2 * rate.own(
            rho_b, rho_a
        )

    return Force(f"adjoint of {rate.name}", "", own, other, gradient, rate.name)


def _own_square(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return P_a / rho_a**2


def _other_square(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return P_b / rho_b**2


def _own_product(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return P_a / (rho_a * rho_b)


def _other_product(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return P_b / (rho_a * rho_b)


def _minus_own(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return -P_a / (rho_a * rho_b)


def _difference(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return (P_b - P_a) / (rho_a * rho_b)


def _half_sum(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return (P_a + P_b) / (2 * rho_a * rho_b)


def _sum(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return (P_a + P_b) / (rho_a * rho_b)


def _zero(P_a: Any, P_b: Any, rho_a: Any, rho_b: Any) -> Any:
    return 0


_BONET = "Bonet & Lok (1999) doi:10.1016/S0045-7825(99)00051-1"
_RANDLES = "Randles & Libersky (1996) doi:10.1016/S0045-7825(96)01090-0"

FORCES: dict[str, Force] = {
    force.name: force
    for force in (
        Force(
            "symmetric",
            "a_a = −Σ m_b (P_a/ρ_a² + P_b/ρ_b²) ∇W",
            _own_square,
            _other_square,
            rate="summation",
            source="Monaghan (1992) doi:10.1146/annurev.aa.30.090192.002551",
        ),
        Force(
            "symmetric-product",
            "a_a = −Σ m_b (P_a + P_b)/(ρ_aρ_b) ∇W",
            _own_product,
            _other_product,
            rate="continuity",
            source="Monaghan (1992) doi:10.1146/annurev.aa.30.090192.002551",
        ),
        Force(
            "difference",
            "a_a = −(1/ρ_a) Σ V_b (P_b − P_a) ∇W",
            _minus_own,
            _other_product,
            rate="flux",
            source="Monaghan (1992) doi:10.1146/annurev.aa.30.090192.002551",
        ),
        Force(
            "grad-h",
            "a_a = −Σ m_b (P_a/(Ω_aρ_a²) ∇W(h_a) + P_b/(Ω_bρ_b²) ∇W(h_b))",
            _own_square,
            _other_square,
            GRAD_H,
            rate="summation",
            source="Springel & Hernquist (2002) doi:10.1046/j.1365-8711.2002.05445.x",
        ),
        Force(
            "csph",
            "a_a = −(1/ρ_a) Σ V_b (P_b − P_a) C_a∇W",
            _difference,
            _zero,
            CORRECTED,
            source=_RANDLES,
        ),
        Force(
            "csph-sum",
            "a_a = −(1/ρ_a) Σ V_b (P_a + P_b) C_a∇W",
            _sum,
            _zero,
            CORRECTED,
            source=_RANDLES,
        ),
        Force(
            "csph-symmetric",
            "a_a = −(1/ρ_a) Σ V_b (P_aC_a + P_bC_b)∇W",
            _own_product,
            _other_product,
            CORRECTED,
            rate="continuity",
            source=_BONET,
        ),
        Force(
            "csph-mean",
            "a_a = −(1/ρ_a) Σ V_b (P_a + P_b) (C_a + C_b)/2 ∇W",
            _half_sum,
            _half_sum,
            CORRECTED,
            rate="mean-continuity",
            source=_BONET,
        ),
        Force(
            "total-lagrangian",
            "a_a = −(1/ρ₀²) Σ m_b (P_aJ_aF_a⁻ᵀ + P_bJ_bF_b⁻ᵀ)∇W(X)",
            _own_product,
            _other_product,
            REFERENCE,
            source="Belytschko, Guo, Liu & Xiao (2000)"
            " doi:10.1002/1097-0207(20000730)48:9<1359::AID-NME829>3.0.CO;2-U;"
            " Rabczuk, Belytschko & Xiao (2004) doi:10.1016/j.cma.2003.12.018",
        ),
        Force(
            "stress-points",
            "a_a = −(1/ρ_a) Σ_s V_s P_s ∇W(x_a − x_s), stress points s midway between particles",
            _zero,
            _other_product,
            STAGGERED,
            source="Dyka & Ingel (1995) doi:10.1016/0045-7949(95)00059-P",
        ),
    )
}


def force(name: str) -> Force:
    """The form of that name; ValueError with the names there are otherwise."""
    if name not in FORCES:
        raise ValueError(f"form: got {name!r}, expected one of {', '.join(FORCES)}")
    return FORCES[name]


@dataclass(frozen=True)
class ArtificialStress:
    """A repulsion between particles under tension: P/ρ² becomes (1 − ε fⁿ) P/ρ² where P < 0, with
    f = W(r)/W(Δp) (Monaghan 2000, doi:10.1006/jcph.2000.6439; Gray, Monaghan & Swift 2001,
    doi:10.1016/S0045-7825(01)00254-7).

    epsilon: ε; power: n; spacing: Δp in units of Δx
    frozen: whether the repulsion keeps the pressure that the particles have at rest

    Raises ValueError for ε < 0, n < 1 or a spacing that is not positive.
    """

    epsilon: Any
    power: int = 4
    spacing: Any = 1
    frozen: bool = False

    def __post_init__(self) -> None:
        if not self.epsilon >= 0:
            raise ValueError(f"artificial stress: got ε = {self.epsilon}, expected ε >= 0")
        if self.power < 1:
            raise ValueError(f"artificial stress: got n = {self.power}, expected n >= 1")
        if not self.spacing > 0:
            raise ValueError(f"artificial stress: got Δp = {self.spacing} Δx, expected Δp > 0")

    def repulsion(self, weight: Any, pressure: Any, f: Any) -> Any:
        """What is added to the weight of one end of a pair: −ε fⁿ of it where its P < 0."""
        return -self.epsilon * f**self.power * weight * (pressure.real < 0)


@dataclass(frozen=True)
class EquationOfState:
    """P(ρ) = P₀ + (c²ρ₀/γ) ((ρ/ρ₀)^γ − 1): pressure P₀ and sound speed c at the density ρ₀.

    γ = 1 is a straight line, γ = 7 Cole's form; with P₀ = c²ρ₀/γ it is P ∝ ρ^γ.

    Raises ValueError unless c² > 0, γ > 0 and ρ₀ > 0.
    """

    c2: Any = 1
    pressure: Any = 0
    gamma: Any = 1
    density: Any = 1

    def __post_init__(self) -> None:
        for name, value in (("c²", self.c2), ("γ", self.gamma), ("ρ₀", self.density)):
            if not value > 0:
                raise ValueError(f"equation of state: got {name} = {value}, expected {name} > 0")

    def __call__(self, rho: Any) -> Any:
        """P(ρ)."""
        stiffness = self.c2 * self.density / self.gamma
        return self.pressure + stiffness * ((rho / self.density) ** self.gamma - 1)

    def slope(self, rho: Any) -> Any:
        """dP/dρ, the square of the sound speed: c² at ρ₀."""
        return self.c2 * (rho / self.density) ** (self.gamma - 1)
