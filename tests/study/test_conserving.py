"""The table of conservation beside truncation error, its command, and the drift of densities."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sphtrunc.cli import group
from sphtrunc.cli.conserve import _FORMS
from sphtrunc.experiment.momentum import FORMS
from sphtrunc.operators.h_rules import FORCE_RULES
from sphtrunc.study.conservation.conserving import conserve, conserve_particles
from sphtrunc.study.conservation.density_drift import SCHEMES, drift, predicted_drift, tube
from sphtrunc.study.conservation.force_errors import Wave


def test_lattice_errors_are_predicted_to_rounding() -> None:
    """Without displacements every particle inside has the predicted error: one lattice."""
    found = conserve("wendland-c2", 2, jitter=0, radius=14.0, workers=1)
    assert {row.kept.form for row in found.rows} == set(FORMS)
    for row in found.rows:
        assert row.measured == pytest.approx(row.predicted, rel=1e-9)
        assert row.order_h == (2 if FORMS[row.kept.form].correction != "none" else 0)


def test_displaced_errors_are_predicted() -> None:
    """To first order in the displacements; some 300 particles inside, so that the rms of the error
    is known to about 1/√(2·300), wherever they are independent: 4 of those and the next order."""
    found = conserve("wendland-c2", 2, jitter="1/50", radius=17.0, seed=3, workers=1)
    inside = found.settings["inside"]
    assert inside > 300
    for row in found.rows:
        assert row.measured == pytest.approx(row.predicted, rel=4.0 / np.sqrt(2 * inside) + 0.02)
        assert row.order_h == FORMS[row.kept.form].consistency


@pytest.mark.parametrize(("jitter", "radius"), [("0", 16.0), ("1/50", 20.0)])
def test_errors_with_an_h_that_follows_are_predicted(jitter: str, radius: float) -> None:
    """On a lattice to what h is solved to, 1e-12, over the smallest error of 1e-4; displaced as
    above: the displacements move h and densities as well."""
    forms = ["symmetric", "difference", "grad-h", "csph"]
    options = {"jitter": jitter, "radius": radius, "lengths": "adapted", "seed": 3, "workers": 1}
    found = conserve("wendland-c2", 2, forms=forms, **options)
    inside = found.settings["inside"]
    within = {"0": 1e-7, "1/50": 4.0 / np.sqrt(2 * inside) + 0.02}[jitter]
    assert {row.kept.rule for row in found.rows} == set(FORCE_RULES) - {"constant"}
    for row in found.rows:
        assert row.measured == pytest.approx(row.predicted, rel=within)


@pytest.mark.parametrize(("form", "order"), [("difference", 0), ("csph", 1), ("symmetric", -1)])
def test_orders_are_two_sided(form: str, order: int) -> None:
    """h/λ halved at one arrangement of particles: the error falls as h^order, no more, no less."""
    errors = [
        conserve(
            "wendland-c2",
            2,
            forms=[form],
            radius=14.0,
            jitter="1/10",
            h_over_lambda=h,
            predict=False,
            workers=1,
        )
        .rows[0]
        .measured
        for h in (1e-3, 5e-4)
    ]
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.05


def test_conservation_and_consistency_exclude_each_other() -> None:
    """On displaced particles: momentum is exact where the error is of order 1/h, and there alone,
    but for the one-sided sum, which has neither."""
    found = conserve("cubic-spline", 2, radius=12.0, predict=False, workers=1)
    for row in found.rows:
        neither = row.kept.form == "csph-sum"
        assert row.kept.linear.exact is (row.order_h == -1 and not neither)


def test_the_contract() -> None:
    arguments = ["conserve", "--kernel", "cubic-spline", "--radius", "12", "--format", "json"]
    result = CliRunner().invoke(group, [*arguments, "--lengths", "adapted", "--workers", "1"])
    assert result.exit_code == 0, result.output
    data = json.loads(result.output)
    assert data["schema"] == "sphtrunc.conserve/1"
    assert len(data["rows"]) == 36
    for row in data["rows"]:
        assert set(row) == {
            *("form", "correction", "h_rule", "linear", "angular", "energy"),
            "acceleration_error",
        }
        for name in ("linear", "angular"):
            assert set(row[name]) == {"residual", "bound", "exact"}
        assert set(row["energy"]) == {"partner", "residual", "bound", "exact"}
        assert set(row["acceleration_error"]) == {"measured", "predicted", "order_h"}
        assert row["energy"]["exact"] is (row["energy"]["partner"] is not None)


def test_the_command_and_its_text(tmp_path: Path) -> None:
    assert set(_FORMS) == set(FORMS)
    run = CliRunner().invoke
    text = run(group, ["conserve", "-k", "cubic-spline", "--dim", "1", "--workers", "1"]).output
    assert "csph-symmetric" in text
    assert max(map(len, text.splitlines())) <= 100
    random = np.random.default_rng(2)
    path = tmp_path / "mine.npz"
    np.savez(path, x=random.random((200, 2)), mass=np.full(200, 1 / 200), pressure=np.ones(200))
    read = ["conserve", "-k", "cubic-spline", "--particles", str(path)]
    assert "h: the file has no smoothing length" in str(run(group, read).exception)
    result = run(group, [*read, "--h", "0.2", "--format", "json"])
    rows = json.loads(result.output)["rows"]
    assert len(rows) == 10
    assert all(row["acceleration_error"]["measured"] is None for row in rows)
    boxed = run(group, [*read, "--h", "0.2", "--period", "1", "--format", "json"])
    assert all(row["angular"] is None for row in json.loads(boxed.output)["rows"])
    for more, message in (
        (["--jitter", "0.1"], "jitter: a file of particles has none"),
        (["--lengths", "adapted"], "lengths: particles of a file have theirs"),
    ):
        assert message in str(run(group, [*read, *more]).exception)
    wrong = run(group, ["conserve", "-k", "cubic-spline", "--radius", "3"])
    assert "radius: got 3 Δx, expected more than" in str(wrong.exception)
    unfit = run(group, ["conserve", "-k", "cubic-spline", "--h-rule", "scatter"])
    assert "h-rule: scatter goes with none" in str(unfit.exception)


def test_a_wave_on_given_particles() -> None:
    random = np.random.default_rng(2)
    x = random.random((300, 2))
    columns = {"x": x, "mass": np.full(300, 1 / 300)}
    wave = Wave(2.0 * np.pi)
    found = conserve_particles("cubic-spline", columns, h=0.1, wave=wave, workers=1)
    assert all(row.measured is not None and row.measured > 0.0 for row in found.rows)
    with pytest.raises(ValueError, match="pressure: the particles have none"):
        conserve_particles("cubic-spline", columns, h=0.15)
    with pytest.raises(ValueError, match="mass: the particles have none"):
        conserve_particles("cubic-spline", {"x": x}, h=0.15)


# ------------------------------------------------------------------------------- density drift

#: M6, h = Δx = 1/40, T = 0.4, Δt = 0.0025: largest drift, of a prototype that shares no code
DRIFT = {
    "leapfrog-start": 1.734044e-4,
    "leapfrog-middle": 3.222997e-8,
    "leapfrog-mean": 6.445996e-8,
    "rk2": 2.608987e-7,
    "rk4": 9.21e-12,
}
#: 160 steps of sums of 7 terms and 40 densities of about 1, each rounded: what cannot be known
ROUNDING = 160 * 64 * 2.0**-53


@pytest.mark.parametrize("scheme", DRIFT)
def test_drift_against_an_independent_run(scheme: str) -> None:
    digits = 5e-3 if scheme == "rk4" else 5e-7
    found = float(np.abs(drift(tube(), scheme, 160)).max())
    assert abs(found - DRIFT[scheme]) <= digits * DRIFT[scheme] + ROUNDING


@pytest.mark.parametrize("scheme", SCHEMES)
def test_orders_of_drift_are_two_sided(scheme: str) -> None:
    """Between 160 and 320 steps; for RK4 between 40 and 80, where rounding is far below."""
    steps = 40 if scheme == "rk4" else 160
    coarse, fine = (float(np.abs(drift(tube(), scheme, n)).max()) for n in (steps, 2 * steps))
    assert abs(np.log2(coarse / fine) - SCHEMES[scheme]) < 0.1


@pytest.mark.parametrize("scheme", [name for name in SCHEMES if name != "rk4"])
def test_drift_is_the_predicted_integral(scheme: str) -> None:
    """Particle by particle, sign included; what is left over falls in proportion to the step."""
    left = []
    for steps in (160, 320):
        found = drift(tube(), scheme, steps)
        predicted = predicted_drift(tube(), scheme, steps)
        left.append(float(np.abs(found - predicted).max() / np.abs(found).max()))
    assert left[1] < 0.03
    assert left[1] < 0.7 * left[0]


def test_middle_and_mean_are_minus_one_to_two() -> None:
    middle, mean = (drift(tube(), f"leapfrog-{name}", 160) for name in ("middle", "mean"))
    assert np.abs(mean + 2.0 * middle).max() < 1e-4 * np.abs(mean).max()
    with pytest.raises(ValueError, match="scheme: got 'verlet', expected one of euler"):
        drift(tube(), "verlet", 10)
    with pytest.raises(ValueError, match="steps: got 0"):
        drift(tube(), "rk2", 0)
