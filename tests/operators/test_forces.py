"""Momentum forms: each is the adjoint of its density rate, in fractions."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphtrunc.operators.forces import (
    FORCES,
    RATES,
    ArtificialStress,
    EquationOfState,
    adjoint,
    force,
)

positive = st.fractions(Fraction(1, 9), 9, max_denominator=9)
pressures = st.fractions(-9, 9, max_denominator=9)
CONSERVING = [f for f in FORCES.values() if f.rate is not None]


def test_which_forms_conserve_energy_with_a_partner() -> None:
    assert {f.name: f.rate for f in FORCES.values()} == {
        "symmetric": "summation",
        "symmetric-product": "continuity",
        "difference": "flux",
        "grad-h": "summation",
        "csph": None,
        "csph-sum": None,
        "csph-symmetric": "continuity",
        "csph-mean": "mean-continuity",
        "total-lagrangian": None,
        "stress-points": None,
    }


@pytest.mark.parametrize("form", CONSERVING, ids=lambda f: f.name)
@given(P_a=pressures, P_b=pressures, rho_a=positive, rho_b=positive)
def test_a_force_is_the_adjoint_of_its_rate(
    form, P_a: Fraction, P_b: Fraction, rho_a: Fraction, rho_b: Fraction
) -> None:
    """Both weights, as identities in ℚ."""
    partner = adjoint(RATES[form.rate], form.gradient)
    ends = (P_a, P_b, rho_a, rho_b)
    assert form.own(*ends) == partner.own(*ends)
    assert form.other(*ends) == partner.other(*ends)


@given(
    P=st.tuples(pressures, pressures),
    rho=st.tuples(positive, positive),
    K=st.tuples(pressures, pressures),
    v=st.tuples(pressures, pressures),
    m=st.tuples(positive, positive),
    name=st.sampled_from(sorted(RATES)),
)
def test_the_adjoint_exchanges_energy_without_loss(P, rho, K, v, m, name: str) -> None:
    """Two particles on a line: Σ m v·a + Σ m (P/ρ²) ρ̇ = 0, from the two sums themselves."""
    rate = RATES[name]
    push = adjoint(rate)
    power = Fraction(0)
    for a, b, sign in ((0, 1, 1), (1, 0, -1)):
        ends = (P[a], P[b], rho[a], rho[b])
        K_a, K_b = sign * K[a], sign * K[b]
        acceleration = -m[b] * (push.own(*ends) * K_a + push.other(*ends) * K_b)
        seen = rate.own(rho[a], rho[b]) * K_a + rate.other(rho[a], rho[b]) * K_b
        density_rate = m[b] * (v[a] - rate.mirror * v[b]) * seen
        power += m[a] * v[a] * acceleration + m[a] * P[a] / rho[a] ** 2 * density_rate
    assert power == 0


@given(P=pressures, rho=positive)
def test_uniform_pressure_pulls_by_twice_p_over_rho_squared_or_not_at_all(
    P: Fraction, rho: Fraction
) -> None:
    for form in FORCES.values():
        pull = form.pull(P, P, rho, rho)
        expected = {"difference": 0, "csph": 0, "stress-points": P / rho**2}
        assert pull == expected.get(form.name, 2 * P / rho**2)


@given(c2=positive, P0=pressures, gamma=st.integers(1, 7), rho0=positive)
def test_equation_of_state(c2: Fraction, P0: Fraction, gamma: int, rho0: Fraction) -> None:
    state = EquationOfState(c2, P0, gamma, rho0)
    assert state(rho0) == P0
    assert state.slope(rho0) == c2
    x = Fraction(1, 7)  # an exact difference quotient of a polynomial tends to its slope
    step = Fraction(1, 10**9)
    quotient = (state(rho0 + x + step) - state(rho0 + x - step)) / (2 * step)
    assert abs(quotient - state.slope(rho0 + x)) <= 10**-12 * c2 * (1 + 1 / rho0) ** 9


def test_artificial_stress_acts_under_tension_only() -> None:
    stress = ArtificialStress(Fraction(1, 5))
    weight = Fraction(-3)
    assert stress.repulsion(weight, Fraction(-1), Fraction(1, 2)) == Fraction(3, 80)
    assert stress.repulsion(weight, Fraction(1), Fraction(1, 2)) == 0


def test_bad_arguments_are_named() -> None:
    with pytest.raises(ValueError, match=r"form: got 'symetric', expected one of symmetric"):
        force("symetric")
    for wrong in ({"c2": -1}, {"gamma": 0}, {"density": 0}):
        with pytest.raises(ValueError, match="equation of state: got"):
            EquationOfState(**wrong)
    for wrong in ({"epsilon": -1}, {"epsilon": 1, "power": 0}, {"epsilon": 1, "spacing": 0}):
        with pytest.raises(ValueError, match="artificial stress: got"):
            ArtificialStress(**wrong)
