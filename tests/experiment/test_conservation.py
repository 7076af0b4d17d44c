"""Conservation: the table of momentum equations, by residual and by adjointness, row by row."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sphtrunc import kernel
from sphtrunc.experiment.adapted_lengths import adapted, grad_h
from sphtrunc.experiment.conservation import combinations, kept
from sphtrunc.experiment.engine import available
from sphtrunc.experiment.momentum import FORMS, State, partner, parts_of, rate_parts, rates
from sphtrunc.experiment.pair_matrices import Cloud, act, adjoint, matrix, same
from sphtrunc.operators.forces import RATES
from sphtrunc.operators.h_rules import FORCE_RULES, RULES
from sphtrunc.scenes.particles import particles

CUBIC = kernel("cubic-spline")
NONE = None
#: (form, rule): momentum, angular momentum, the density rate that keeps the energy
CONSTANT = {
    "symmetric": (True, True, "summation"),
    "symmetric-product": (True, True, "continuity"),
    "difference": (False, False, "flux"),
    "grad-h": (True, True, "summation (grad-h)"),
    "csph": (False, False, NONE),
    "csph-sum": (False, False, NONE),
    "csph-symmetric": (True, True, "continuity (csph)"),
    "csph-mean": (True, False, "mean-continuity (csph)"),
    "rkpm-strong": (False, False, NONE),
    "rkpm-galerkin": (True, True, "−ρ_a Σ v_b·∇ψ_b(x_a)"),
}
VARYING = {
    ("symmetric", "gather"): (False, False, NONE),
    ("symmetric", "scatter"): (False, False, NONE),
    ("symmetric", "mean"): (True, True, "summation"),
    ("symmetric", "mean-kernel"): (True, True, "summation"),
    ("symmetric", "no-omega"): (True, True, "summation"),
    ("grad-h", "grad-h"): (True, True, "summation (grad-h)"),
    ("symmetric-product", "mean"): (True, True, "continuity"),
    ("difference", "mean"): (False, False, "flux"),
    ("csph-symmetric", "gather"): (False, False, NONE),
    ("csph-symmetric", "mean"): (True, True, "continuity (csph)"),
    ("csph-symmetric", "no-omega"): (True, True, "continuity (csph)"),
    ("csph-mean", "no-omega"): (True, False, "mean-continuity (csph)"),
    ("rkpm-galerkin", "gather"): (True, True, "−ρ_a Σ v_b·∇ψ_b(x_a)"),
}


def random_state(dim: int, varying: bool, n: int | None = None, seed: int = 1) -> State:
    """Random particles of unequal masses, densities and pressures, and h if asked for."""
    n = n or {2: 250, 3: 320}[dim]
    random = np.random.default_rng(seed)
    x = random.random((dim, n))
    h = np.full(n, {2: 0.17, 3: 0.27}[dim])
    if varying:
        h = h * random.uniform(0.8, 1.25, n)
    mass = random.uniform(0.5, 2.0, n) / n
    return State(
        Cloud(x, h, CUBIC, workers=1),
        mass,
        random.uniform(0.5, 2.0, n),
        random.uniform(0.5, 2.0, n),
    )


CONSTANT_STATES = {dim: random_state(dim, False) for dim in (2, 3)}
VARYING_STATES = {dim: random_state(dim, True) for dim in (2, 3)}


def judged(one: Any) -> bool:
    """Exact below the bound of rounding; if not, a million times above it at least."""
    assert one.exact or one.residual > 1e6 * one.bound
    assert one.bound < 1e-10
    return bool(one.exact)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_table_for_constant_h(dim: int) -> None:
    found = kept(CONSTANT_STATES[dim], list(combinations((), (), False)))
    table = {one.form: (judged(one.linear), judged(one.angular), one.partner) for one in found}
    assert table == CONSTANT
    assert [judged(one.energy) for one in found] == [one.partner is not None for one in found]


@pytest.mark.parametrize("dim", [2, 3])
def test_the_table_for_an_h_each(dim: int) -> None:
    found = kept(VARYING_STATES[dim], list(VARYING))
    table = {
        (one.form, one.rule): (judged(one.linear), judged(one.angular), one.partner)
        for one in found
    }
    assert table == VARYING
    assert [judged(one.energy) for one in found] == [one.partner is not None for one in found]


def test_every_form_is_in_the_table() -> None:
    assert set(CONSTANT) == set(FORMS)
    assert {rule for _, rule in VARYING} == set(FORCE_RULES) - {"constant"}
    # five forms with a gradient at each end, two with one, grad-h and RKPM twice
    assert len(list(combinations((), (), True))) == 5 * 5 + 2 * 4 + 3


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("varying", [False, True])
def test_partners_are_transposed_matrices(name: str, varying: bool) -> None:
    """The adjoint in factors is the transposed sparse matrix, entry by entry, and with
    D = −(ρ²/m) Qᵀ the energy v·QP + P·(m/ρ²)Dv vanishes: no code of one in the other."""
    state = random_state(2, varying, n=60)
    rule = FORMS[name].rules(varying)[-1]
    parts = parts_of(state, name, rule)
    rate = partner(state, parts)
    for axis in range(2):
        q = matrix(state.cloud, parts, axis).toarray()
        d = matrix(state.cloud, rate, axis).toarray()
        wanted = -(state.density**2 / state.mass)[:, None] * q.T
        # entries are products of a dozen factors, each rounded; own parts add up 60 of them
        assert np.abs(d - wanted).max() <= 100 * 2.0**-53 * np.abs(wanted).max()
        assert np.abs(wanted).max() > 0.0


@pytest.mark.parametrize("rule", ["mean", "no-omega", "mean-kernel"])
def test_matrices_are_what_acts(rule: str) -> None:
    state = random_state(2, True, n=60)
    parts = parts_of(state, "symmetric", rule)
    (done,) = act(state.cloud, [(parts, state.pressure)], bound=True)
    assert done.bound is not None
    for axis in range(2):
        there = matrix(state.cloud, parts, axis) @ state.pressure
        assert np.all(np.abs(there - done.value[axis]) <= 2.0 * done.bound[axis])
        assert np.all(done.bound[axis] <= 1e-11 * np.abs(done.size).max())


def test_a_wrong_partner_is_no_partner() -> None:
    """Same signs, one factor changed by a part in a million."""
    state = CONSTANT_STATES[2]
    rate = partner(state, parts_of(state, "symmetric", "constant"))
    right = rate_parts(state, RATES["summation"], "constant")
    assert same(rate, right)
    wrong = [replace(right[0], left=right[0].left * (1.0 + 1e-6)), *right[1:]]
    bent = right[0].left.copy()
    bent[7] *= 1.0 + 1e-6
    assert not same(rate, wrong)
    assert not same(rate, [replace(right[0], left=bent), *right[1:]])
    assert not same(rate, right[:-1])
    assert same(adjoint(adjoint(rate)), rate)


def test_galilean_invariance_is_momentum() -> None:
    """The adjoint of a force sees no common velocity exactly where the force keeps momentum."""
    state = VARYING_STATES[2]
    ones = np.ones((2, state.cloud.count))
    for (name, rule), (linear, _, _) in VARYING.items():
        rate = partner(state, parts_of(state, name, rule))
        (done,) = act(state.cloud, [(rate, ones)], bound=True)
        assert done.bound is not None
        shift = np.zeros(state.cloud.count)
        if name == "rkpm-galerkin":  # as exact as the correction is solved
            shift = state.density * state.reproducing[1] / state.cloud.h
        still = np.abs(done.value) <= done.bound + shift
        assert bool(np.all(still)) is linear


def test_energy_with_the_density_that_it_is() -> None:
    """grad-h: d/dt Σ m W(h_a), h following, by finite differences of h solved anew, is the rate
    that is its partner, to the error of the difference; without Ω it is not."""
    random = np.random.default_rng(5)
    n, step = 120, 1e-5
    x, v = random.random((n, 2)), random.normal(size=(n, 2))
    mass = random.uniform(0.5, 2.0, n) / n
    ahead, back = (
        adapted(x + sign * step * v, mass, CUBIC, eta=1.3, workers=1).density for sign in (1, -1)
    )
    now = adapted(x, mass, CUBIC, eta=1.3, workers=1)
    state = State(Cloud(x.T.copy(), now.h, CUBIC, workers=1), mass, now.density, now.density)
    slope = (ahead - back) / (2.0 * step)
    named = rates(state, "grad-h", "grad-h")
    exact, plain = (
        act(state.cloud, [(named[name](), v.T.copy())])[0].value[0]
        for name in ("summation (grad-h)", "summation")
    )
    assert np.abs(exact - slope).max() < 1e-6 * np.abs(slope).max()
    assert np.abs(plain - slope).max() > 1e-2 * np.abs(slope).max()


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_lengths_that_follow_the_density(dim: int) -> None:
    """h (ρ/m)^{1/d} = η to the tolerance, with the density summed by the pairs themselves."""
    random = np.random.default_rng(dim)
    n = {1: 40, 2: 90, 3: 150}[dim]
    x = random.random((n, dim))
    mass = random.uniform(0.5, 2.0, n) / n
    found = adapted(x, mass, CUBIC, eta=1.3, workers=1)
    r = np.sqrt(((x[:, None] - x) ** 2).sum(axis=2))
    w = CUBIC.w(r / found.h[:, None], dim) / found.h[:, None] ** dim
    density = w @ mass
    assert np.abs(found.h * (density / mass) ** (1.0 / dim) / 1.3 - 1.0).max() < 1e-11
    # Ω is the slope of ln h + ln ρ(h)/d, by a difference
    far = found.h * (1.0 + 1e-6)
    there = (CUBIC.w(r / far[:, None], dim) / far[:, None] ** dim) @ mass
    slope = 1.0 + np.log(there / density) / np.log(far / found.h) / dim
    assert np.abs(slope - found.omega).max() < 1e-4
    with pytest.raises(ValueError, match="eta: got -1"):
        adapted(x, mass, CUBIC, eta=-1.0)


@pytest.mark.parametrize("mode", RULES)
def test_an_h_each_on_both_engines(mode: str) -> None:
    """h at random from 1/2 to 2: all sums of both engines within their bounds of each other."""
    from sphtrunc.experiment.engine import pair_sums
    from sphtrunc.operators.operator import Operator

    random = np.random.default_rng(3)
    scene = particles(
        random.random((400, 2)), h=0.1 * random.uniform(0.5, 2.0, 400), volume=1 / 400, mode=mode
    )
    keys = Operator("gradient").needed(2, 1)
    found = [
        pair_sums(scene, CUBIC, keys, bound=True, engine=engine, workers=1)
        for engine in available()
    ]
    assert len(found) == 2
    for key in keys:
        one, two = (f.base[key] for f in found)
        room = sum(f.base_bound[key] for f in found)  # type: ignore[index]
        assert np.all(np.abs(one - two) <= room)
        assert np.any(one != 0.0)


def test_omega_on_a_smooth_density() -> None:
    """Ω − 1 = (R₂/d²) h²∇²ρ/ρ at the crest of ρ = 1 + ½ cos kx, kh = 0.1, 3D: −3.330503e−4 with all
    orders; the lattice is summed plane by plane."""
    dx, k = 0.25, 0.1
    planes = np.arange(-8, 9) * dx
    grid = np.stack(np.meshgrid(planes, planes, planes, indexing="ij")).reshape(3, -1)
    mass = (1.0 + 0.5 * np.cos(k * grid[0])) * dx**3
    smooth = kernel("wendland-c6")
    scene = particles(grid.T, h=1.0, volume=mass)
    at = int(np.flatnonzero(~np.any(np.abs(grid) > 1e-9, axis=0))[0])
    found = grad_h(scene, smooth, 1)[1][at]
    uniform = grad_h(particles(grid.T, h=1.0, volume=dx**3), smooth, 1)[1][at]
    r2 = float(smooth.moment(2, 3))
    law = -(r2 / 9.0) * k**2 * 0.5 / 1.5
    assert (found - uniform) / law == pytest.approx(1.0, abs=3.0 * k**2 * r2)
    assert abs(uniform - 1.0) < 1e-2 * abs(law)  # of the lattice itself


def test_what_is_refused() -> None:
    state = CONSTANT_STATES[2]
    with pytest.raises(ValueError, match="form: got 'monaghan', expected one of symmetric"):
        kept(state, [("monaghan", "constant")])
    with pytest.raises(ValueError, match="h-rule: got 'grad-h' for the form csph"):
        kept(state, [("csph", "grad-h")])
    lonely = State(
        replace(state.cloud, h=state.cloud.h * 1e-3), state.mass, state.density, state.pressure
    )
    with pytest.raises(ValueError, match="correction: the matrix of csph at 250 particles"):
        kept(lonely, [("csph", "constant")])
