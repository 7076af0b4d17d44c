"""The lid-driven cavity: its equations, its convergence, and published solutions."""

from __future__ import annotations

from functools import cache
from math import log2
from typing import Any

import numpy as np
import pytest

from sphtrunc import Operator, jittered, kernel, lattice
from sphtrunc.study.flows import cavity as module
from sphtrunc.study.flows.cavity import Cavity, Estimates, cavity, published

C2 = kernel("wendland-c2")
CORRECTED = Estimates(
    Operator("laplacian", "difference", "rkpm-2"), Operator("gradient", "difference", "csph")
)
BARE = Estimates(Operator("laplacian", "brookshaw"), Operator("gradient", "difference"))
RATIO = 10 / 13
SHAKEN = jittered(lattice(2), "1/10", seed=1).displacement


@cache
def solved(side: int, corrected: bool = True, shaken: bool = False) -> Cavity:
    return cavity(
        C2, CORRECTED if corrected else BARE, side, RATIO, (100.0,),
        displacement=SHAKEN if shaken else None,
    )  # fmt: skip


def off(found: Cavity, source: str = "botella-peyret") -> dict[str, float]:
    table = published()[source]
    return {k: abs(v / table[k]["100"] - 1.0) for k, v in found.profiles[-1].extrema.items()}


@pytest.mark.parametrize("shaken", [False, True])
def test_newtons_matrix_is_the_derivative_of_the_residual(shaken: bool) -> None:
    """The residual is quadratic, so that its central difference of any step is exact."""
    square = module._Square(C2, CORRECTED, 11, RATIO, SHAKEN if shaken else None)
    newton = module._Newton(square)
    generator = np.random.default_rng(5)
    psi = np.zeros(square.count)
    psi[newton.inside] = generator.normal(size=newton.inside.size)
    omega = generator.normal(size=square.count)
    change = generator.normal(size=newton.unknowns)
    left, right = newton._scales(70.0)
    found = newton._jacobian(70.0, psi, omega) @ change
    step = np.zeros(newton.unknowns)
    step[newton.order] = right * change
    m = newton.inside.size
    more = np.zeros(square.count)
    more[newton.inside] = step[:m]
    up = newton._residual(70.0, psi + more, omega + step[m:])
    down = newton._residual(70.0, psi - more, omega - step[m:])
    exact = left * (up - down) / 2
    assert np.abs(found - exact).max() < 1e-11 * np.abs(exact).max()


def test_the_lid_moves_and_the_walls_do_not() -> None:
    """The estimates of the velocity on the walls themselves, without their being set: where ψ is
    continued evenly, what is left is of the second order."""
    square = module._Square(C2, CORRECTED, 33, RATIO, None)
    profile = solved(33).profiles[0]
    u = square.u @ profile.psi + square.u_lid
    v = square.v @ profile.psi + square.v_lid
    x, y = square.x
    middle = (x > 0.2) & (x < 0.8)
    assert np.abs(u[middle & (y == 1)] - 1).max() < 1e-12
    assert np.abs(u[middle & (y == 0)]).max() < 1e-12
    assert np.abs(v[(x == 0) & (y < 0.8)]).max() < 1e-12


def test_convergence_to_the_spectral_solution() -> None:
    """Botella & Peyret (1998), Re 100: within 1 % on 65² particles, of an order of 2 to 3.5 from
    33² on (what is left of higher orders speeds it up)."""
    coarse, fine = off(solved(33)), off(solved(65))
    for name, error in fine.items():
        assert error < 0.01, name
        assert 1.8 < log2(coarse[name] / error) < 3.5, name


def test_the_table_of_ghia_and_others() -> None:
    """At all places of Ghia, Ghia & Shin (1982), Re 100: their v is 2.4 and 3.3 % weaker at its
    extrema than the spectral solution, and so than ours."""
    table = published()["ghia"]
    profile = solved(65).profiles[0]
    for name, along in (("u", "y"), ("v", "x")):
        places, values = np.array(table[along]), np.array(table[name]["100"])
        assert places.size == values.size == 17
        assert np.abs(profile.at(name, places) - values).max() < 0.0085
    fine = published()["botella-peyret"]
    assert min(table["v"]["100"]) / fine["v_min"]["100"] - 1 == pytest.approx(-0.0334, abs=5e-4)
    assert max(table["v"]["100"]) / fine["v_max"]["100"] - 1 == pytest.approx(-0.0240, abs=5e-4)


def test_every_column_of_the_published_table_is_whole() -> None:
    table = published()["ghia"]
    for re in table["re"]:
        u, v = table["u"][str(re)], table["v"][str(re)]
        assert len(u) == len(table["y"])
        assert len(v) == len(table["x"])
        assert (u[0], u[-1], v[0], v[-1]) == (1.0, 0.0, 0.0, 0.0)


def test_correction_is_what_disorder_needs() -> None:
    """σ/Δx = 0.1 changes the centre line of the uncorrected flow at least twice as much, and on the
    lattice already it is further from the spectral solution than the corrected one."""
    changes = []
    for corrected in (True, False):
        still, shaken = (solved(33, corrected, moved).profiles[0] for moved in (False, True))
        changes.append(float(np.sqrt(np.mean((shaken.u_line - still.u_line) ** 2))))
    assert changes[1] > 2 * changes[0]
    even, bare = off(solved(33)), off(solved(33, corrected=False))
    for name in even:
        assert bare[name] > 2 * even[name], name


def test_where_newton_stops_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a single step nothing but rest converges; the last flow is kept."""
    monkeypatch.setattr(module, "STEPS", 1)
    found = cavity(C2, CORRECTED, 11, RATIO, (100.0, 200.0))
    assert found.stopped == 100.0
    assert found.profiles == []
    monkeypatch.setattr(module, "STEPS", 14)
    wanted: Any = module._Newton.at

    def until(self: Any, re: float, psi: Any, omega: Any) -> Any:
        return wanted(self, re, psi, omega) if re < 150 else None

    monkeypatch.setattr(module._Newton, "at", until)
    found = cavity(C2, CORRECTED, 11, RATIO, (100.0, 200.0))
    assert found.stopped == 200.0
    assert [p.re for p in found.profiles] == [100.0]


def test_continuation_goes_on_in_smaller_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a step fails its middle is tried."""
    tried = []
    wanted: Any = module._Newton.at

    def picky(self: Any, re: float, psi: Any, omega: Any) -> Any:
        tried.append(re)
        return None if re > 60 and len(tried) < 3 else wanted(self, re, psi, omega)

    monkeypatch.setattr(module._Newton, "at", picky)
    found = cavity(C2, CORRECTED, 11, RATIO, (50.0, 100.0))
    assert found.stopped is None
    assert tried[:2] == [50.0, 100.0]
    assert tried[2] == pytest.approx(50 * 2**0.5)
    assert [p.re for p in found.profiles] == [50.0, 100.0]


@pytest.mark.parametrize(
    ("side", "ratio", "reynolds", "reason"),
    [
        (8, RATIO, (100.0,), "got 8 particles along a side"),
        (11, 0.2, (100.0,), "expected less than half"),
        (11, RATIO, (), "growing numbers above 0"),
        (11, RATIO, (100.0, 50.0), "growing numbers above 0"),
        (11, RATIO, (-1.0,), "growing numbers above 0"),
    ],
)
def test_bad_input(side: int, ratio: float, reynolds: tuple, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        cavity(C2, CORRECTED, side, ratio, reynolds)
