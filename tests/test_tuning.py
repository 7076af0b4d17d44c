"""Tuning against measurements around its recommendations, and against the exponents of theory."""

from __future__ import annotations

import json
from fractions import Fraction

import pytest

from sphtrunc.cli import main
from sphtrunc.convention import convert
from sphtrunc.operators import Operator
from sphtrunc.parse import kernel
from sphtrunc.scene import jittered, lattice
from sphtrunc.tuning import (
    Problem,
    best_at_cost,
    best_at_error,
    best_at_particles,
    explain,
    exponents,
    read_table,
    setting,
    walk,
)
from sphtrunc.waves import waves

STANDARD = Operator("gradient")
DIFFERENCE = Operator("gradient", "difference")
CSPH = Operator("gradient", "difference", "csph")
FEW = 64 * 2.0**-53  # two ways of some thirty roundings each to the same number


def measured(problem: Problem, name: str, r: float, x: float, rtol: float = 0.01) -> float:
    extent = 2**20 if problem.dim == 1 else 1000
    home = lattice(problem.dim, None, Fraction(r).limit_denominator(10**6), extent=extent)
    scene = jittered(home, problem.sigma)
    ((one,),) = waves(scene, name, [problem.operator], [x], rtol=rtol)
    return one.error["rms"]


@pytest.mark.parametrize(
    ("dim", "operator", "name", "sigma", "particles"),
    [
        (1, STANDARD, "cubic-spline", 0.05, 30.0),
        (1, CSPH, "quintic-spline", 0.1, 15.0),
        (2, DIFFERENCE, "wendland-c4", 0.08, 12.0),
        (2, Operator("gradient", "standard", "shepard"), "polynomial:4", 0.03, 20.0),
    ],
)
def test_nothing_around_the_recommendation_is_better(dim, operator, name, sigma, particles):
    problem = Problem(dim, operator, sigma)
    best = best_at_cost(problem, name, best_at_particles(problem, name, particles).cost)
    here = measured(problem, name, best.dx_over_h, best.h_over_lambda)
    assert abs(here / best.error.total - 1) < 0.1  # corrections: to first order in their algebra
    for factor in (0.6, 0.75, 0.9, 1.1, 1.3, 1.6):
        r, x = best.dx_over_h * factor, best.h_over_lambda / factor**2  # equal cost
        if r < 0.95 * float(kernel(name).support) and x < 0.5:
            assert setting(problem, kernel(name), r, x).cost == pytest.approx(best.cost, rel=FEW)
            assert measured(problem, name, r, x, 0.02) > 0.9 * here


# (2+d)/(8+d), (2+d)/(6+d), (2+d)/(4+d): h ∝ Δx^p; error ∝ Δx^{2p}; neighbours ∝ N^{1−p}
PATHS = {
    (1, STANDARD): (Fraction(1, 3), 1e-3, (300, 600, 1200)),
    (1, DIFFERENCE): (Fraction(3, 7), 1e-3, (2000, 4000, 8000)),
    (1, CSPH): (Fraction(3, 5), 0.1, (9600, 19200, 38400)),
    (2, STANDARD): (Fraction(2, 5), 1e-3, (120, 200, 320)),
    (2, DIFFERENCE): (Fraction(1, 2), 4e-3, (400, 800, 1600)),
    (2, CSPH): (Fraction(2, 3), 0.1, (500, 1000, 2000)),
    (3, STANDARD): (Fraction(5, 11), 2e-3, (100, 160, 250)),
    (3, DIFFERENCE): (Fraction(5, 9), 0.02, (150, 220, 320)),
    (3, CSPH): (Fraction(5, 7), 0.1, (300, 600, 1200)),
}


@pytest.mark.parametrize(("dim", "operator"), PATHS)
def test_the_path_and_its_exponents(dim, operator):
    p, sigma, particles = PATHS[dim, operator]
    exact = exponents(operator, dim)
    assert (exact.p, exact.order, exact.neighbours) == (p, 2 * p, 1 - p)
    _, fitted, order = walk(Problem(dim, operator, sigma), "polynomial:6", particles)
    assert abs(fitted - float(p)) < 0.03
    assert abs(order - 2 * float(p)) < 0.03


def test_the_wanted_error_is_reached_at_the_least_cost():
    problem = Problem(2, CSPH, 0.05)
    found = best_at_error(problem, "cubic-spline", 0.01)
    assert 0.9 * 0.01 < found.error.total <= 0.01
    again = best_at_cost(problem, "cubic-spline", found.cost)
    assert again.error.total == pytest.approx(found.error.total, rel=0.02)
    cheaper = best_at_cost(problem, "cubic-spline", 0.8 * found.cost)
    assert cheaper.error.total > 0.01


def test_costs_and_conventions_agree():
    here = setting(Problem(3, STANDARD, 0.1), kernel("cubic-spline"), 5 / 6, 0.06)
    assert here.neighbours == pytest.approx(
        float(convert("cubic-spline", 3, hfact="1.2")["neighbours"]), rel=FEW
    )
    assert here.particles == pytest.approx(20.0, rel=FEW)
    assert here.cost == pytest.approx(20.0**3 * here.neighbours, rel=FEW)
    assert here.dominant == "disorder"


def test_a_plateau_is_explained(tmp_path):
    file = tmp_path / "runs.csv"
    file.write_text(
        "h, dx, error\n0.2, 0.16, 0.16\n0.02,0.016,\n2e-4,1.6e-4,nan\n".replace(",\n", ",0.1\n")
    )
    rows = read_table(file, 1, 2.0)
    assert rows[0] == (0.08, 0.1, 0.16)
    found = explain(Problem(1, STANDARD, 0.0), "polynomial:4", rows)
    assert [run["dominant"] for run in found] == ["smoothing", "discretisation", "discretisation"]
    assert "neighbours" in found[1]["advice"]
    noisy = explain(Problem(1, STANDARD, 0.1), "polynomial:4", rows)
    assert [run["dominant"] for run in noisy][1:] == ["disorder", "disorder"]
    assert noisy[2]["predicted"] > 50 * noisy[1]["predicted"]  # 1/h
    fine = explain(Problem(1, STANDARD, 0.0), "polynomial:4", [(2e-17, 1e-16, 0.5)])
    assert fine[0]["dominant"] == "rounding"


@pytest.mark.parametrize(
    ("text", "says"),
    [("a,b\n1,2\n", "columns"), ("dx,h,error\n1,x,2\n", "line 2"), ("dx,h,error\n", "one row")],
)
def test_tables_that_cannot_be_read(tmp_path, text, says):
    file = tmp_path / "runs.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=says):
        read_table(file, 1, 1.0)


def test_numbers_of_particles_in_a_table(tmp_path):
    file = tmp_path / "runs.csv"
    file.write_text("N,h,error\n1000,0.15,0.1\n")
    assert read_table(file, 3, 1.0) == [(pytest.approx(0.1, rel=FEW), 0.15, 0.1)]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda p: best_at_error(p, "cubic-spline", 2.0), "between 0 and 1"),
        (lambda p: best_at_error(p, "cubic-spline", 1e-9), "not reached"),
        (lambda p: best_at_cost(p, "cubic-spline", -1.0), "positive"),
        (lambda p: best_at_particles(p, "cubic-spline", 0.0), "positive"),
        (lambda p: best_at_particles(p, "cubic-spline", 0.2), "more particles"),
        (lambda p: setting(p, kernel("cubic-spline"), 2.5, 0.1), "too few neighbours"),
        (lambda _: Problem(sigma=-1.0), "jitter"),
    ],
)
def test_wrong_input_is_told(call, says):
    with pytest.raises(ValueError, match=says):
        call(Problem(1, CSPH, 0.1))


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(["tune", *arguments])
    streams = capsys.readouterr()
    return stop.value.code, streams.out, streams.err


def test_the_command(capsys, tmp_path):
    common = ("--kernel", "cubic-spline", "--dim", "2", "--jitter", "0.1")
    aim = ("--particles-per-wavelength", "20")
    code, text, _ = run(capsys, *common, *aim, "--kernel", "wendland-c2", "--now", "neighbours=20")
    assert code == 0
    assert max(len(line) for line in text.splitlines()) <= 100
    assert "h ∝ Δx^2/5" in text
    code, out, _ = run(capsys, *common, *aim, "--format", "json", "--now", "hdx=1.2")
    document = json.loads(out)
    assert document["schema"] == "sphtrunc.tune/1"
    assert document["recommended"][0]["particles"] == pytest.approx(20, rel=FEW)
    assert document["loss"]["error"] >= 0.999
    now = setting(Problem(2, STANDARD, 0.1), kernel("cubic-spline"), 5 / 6, 1.2 / 20)
    assert document["now"]["error"]["total"] == pytest.approx(now.error.total, rel=FEW)
    # the same particles, said in another way: 20 per wavelength in a box of 2 λ
    code, out, _ = run(capsys, *common, "--particles", "1600", "--box", "2", "--format", "json")
    other = json.loads(out)
    assert other["recommended"] == document["recommended"]
    pairs = document["recommended"][0]["cost"]
    code, out, _ = run(
        capsys, *common, "--seconds", repr(pairs / 1e6), "--pairs-per-second", "1e6",
        "--format", "json",
    )  # fmt: skip
    assert json.loads(out)["recommended"][0]["cost"] == pytest.approx(pairs, rel=FEW)
    file = tmp_path / "runs.csv"
    file.write_text("dx,h,error\n0.01,0.02,0.3\n")
    code, text, _ = run(capsys, *common, "--table", str(file))
    assert code == 0
    assert "disorder" in text
    code, _, error = run(capsys, *common)
    assert code == 2
    assert "--error" in error
