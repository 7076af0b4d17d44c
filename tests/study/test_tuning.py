"""Tuning against measurements around its recommendations, and against the exponents of theory."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from random import Random

import numpy as np
import pytest

from sphtrunc import measure, particles, sinusoid
from sphtrunc.cli import main
from sphtrunc.experiment.fields import Values
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.kernels.conventions import convert
from sphtrunc.kernels.parse import kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.study.boundary_layer import boundary_layer
from sphtrunc.study.plateaus import explain, explanations, findings, read_table
from sphtrunc.study.structure import disorder
from sphtrunc.study.tuning import (
    Problem,
    _minimum,
    best_at_cost,
    best_at_error,
    best_at_particles,
    exponents,
    setting,
    walk,
)

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


SHEPARD = Operator("gradient", "standard", "shepard")
KERNELS = ("cubic-spline", "quintic-spline", "wendland-c2", "wendland-c4", "polynomial:4")


@pytest.mark.parametrize("number", range(10))
def test_nothing_around_the_recommendation_is_better(number):
    rng = Random(number)
    dim = (1, 1, 1, 1, 1, 2, 2, 2, 2, 3)[number]
    operator = rng.choice((STANDARD, DIFFERENCE, CSPH, SHEPARD))
    name, sigma = rng.choice(KERNELS), rng.uniform(0.02, 0.1)
    problem = Problem(dim, operator, sigma)
    cost = best_at_particles(problem, name, rng.uniform(8, (0, 40, 20, 10)[dim])).cost
    best = best_at_cost(problem, name, cost)
    here = measured(problem, name, best.dx_over_h, best.h_over_lambda)
    assert abs(here / best.error.total - 1) < 0.1  # corrections: to first order in their algebra
    looked = 0
    for factor in (0.6, 0.75, 0.9, 1.1, 1.3, 1.6):
        r, x = best.dx_over_h * factor, best.h_over_lambda / factor**2  # equal cost
        if r < 0.95 * float(kernel(name).support) and x < 0.5:
            assert setting(problem, kernel(name), r, x).cost == pytest.approx(best.cost, rel=FEW)
            assert measured(problem, name, r, x, 0.02) > 0.9 * here
            looked += 1
    assert looked >= 3


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
    cheaper = best_at_cost(problem, "cubic-spline", 0.98 * found.cost)
    assert cheaper.error.total > 0.01


@pytest.mark.parametrize(
    ("alpha", "paths"),
    [
        (0, (("1/3", "2/3", "2/3"), ("3/7", "6/7", "4/7"), ("3/5", "6/5", "2/5"))),
        (1, (("2/5", "4/5", "3/5"), ("1/2", "1", "1/2"), ("2/3", "4/3", "1/3"))),
        (2, (("5/11", "10/11", "6/11"), ("5/9", "10/9", "4/9"), ("5/7", "10/7", "2/7"))),
        (4, (("7/13", "14/13", "6/13"), ("7/11", "14/11", "4/11"), ("7/9", "14/9", "2/9"))),
    ],
)
def test_paths_of_kinds_of_disorder(alpha, paths):
    """p = (d + α)/(d + α + 6 − 2m) in 3D for the standard, difference and first-order consistent
    gradients, m = 0, 1, 2; found by hand."""
    forms = (("standard", "none"), ("difference", "none"), ("difference", "csph"))
    for (form, correction), expected in zip(forms, paths, strict=True):
        found = exponents(Operator("gradient", form, correction), 3, alpha)
        assert (found.p, found.order, found.neighbours) == tuple(map(Fraction, expected))


def test_the_ceiling_of_a_rough_kernel():
    """q = min((d + α)/2, β + 1 + (d−1)/2): α = 4 in 1D with β = 1 has 2, not 5/2."""
    assert exponents(Operator("gradient"), 1, 4, beta=1).p == Fraction(2, 2 + 3)
    assert exponents(Operator("gradient"), 1, 4, beta=2).p == Fraction(5, 5 + 6)
    with pytest.raises(ValueError, match="alpha: got -1"):
        exponents(Operator("gradient"), 1, -1)


def test_disorder_by_its_name_and_by_particles():
    """The best number of neighbours in independent particles, predicted by the structure factor,
    is that of an error measured around it; names that mean nothing are refused."""
    factor, alpha = disorder("poisson", 1)
    assert (alpha, float(factor(np.ones((1, 1)))[0])) == (0, 1.0)
    assert disorder("jitter:0.1", 2)[1] == 2
    with pytest.raises(ValueError, match="disorder: got 'gas', expected jitter"):
        disorder("gas", 2)
    problem = Problem(1, Operator("gradient", "difference"), disorder=factor)
    best = best_at_particles(problem, "wendland-c2-1d", 40)
    rng = np.random.default_rng(1)
    count = 40000
    scene = particles(rng.random(count) * count, h=1 / best.dx_over_h, volume=1.0, period=count)
    seen = measure(
        scene,
        "wendland-c2-1d",
        problem.operator,
        sinusoid(best.h_over_lambda),
        targets=4000,
    ).error
    assert seen["rms"] == pytest.approx(best.error.total, rel=0.06)


@pytest.mark.parametrize(
    ("operator", "name", "sigma", "error"),
    [
        (SHEPARD, "cubic-spline", 0.02, 0.003),  # the least cost is in a dip of Δx/h near 1
        (
            Operator("value"),
            "quintic-spline",
            0.02,
            0.03,
        ),  # with the fewest particles that there may be
        (STANDARD, "wendland-c2", 0.0, 0.01),  # where smoothing and discretisation cancel
    ],
)
def test_no_cheaper_setting_has_the_wanted_error(operator, name, sigma, error):
    problem, shape = Problem(1, operator, sigma), kernel(name)
    found = best_at_error(problem, name, error)
    assert found.error.total <= error
    lengths = [1e-3 * 500 ** (i / 150) for i in range(151)]
    costs = []
    for i in range(150):
        r = 0.1 * (9.5 * float(shape.support)) ** (i / 149)
        splits = problem.split(shape, r, lengths) or []
        pairs = zip(lengths, splits, strict=False)
        fit = [x for x, split in pairs if split.total <= error and r * x <= 0.5]
        costs += [setting(problem, shape, r, fit[-1]).cost] if fit else []
    assert len(costs) > 20
    assert found.cost <= 1.002 * min(costs)


def test_a_wave_has_two_particles():
    """Where parts of the error cancel below that, it is no answer."""
    found = best_at_error(Problem(2, Operator("value"), 0.05), "cubic-spline", 0.05)
    assert found.particles >= 2
    assert found.error.total <= 0.05


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
    assert found[0]["predicted_order"] is None
    assert 0 < found[1]["predicted_order"] < 2  # from smoothing into the plateau
    assert abs(found[2]["predicted_order"]) < 0.02
    told = [{**run, "error": None} for run in found]  # what is to be expected, without errors
    said = findings(Problem(1, STANDARD, 0.0), "polynomial:4", told)
    assert "take more neighbours" in said[-1]
    noisy = explain(Problem(1, STANDARD, 0.1), "polynomial:4", rows)
    assert [run["dominant"] for run in noisy][1:] == ["disorder", "disorder"]
    assert noisy[2]["predicted"] > 50 * noisy[1]["predicted"]  # 1/h
    fine = explain(Problem(1, STANDARD, 0.0), "polynomial:4", [(2e-17, 1e-16, 0.5)])
    assert fine[0]["dominant"] == "rounding"


def runs_of(operator: Operator, sigma: float) -> list[tuple[float, float, float]]:
    """(Δx/λ, h/λ, error) at Δx/h = 1/2, measured on particles."""
    lengths = (0.1, 0.03, 0.01, 0.003, 0.001)
    problem = Problem(1, operator, sigma)
    return [(x / 2, x, measured(problem, "wendland-c4", 0.5, x, 0.02)) for x in lengths]


@pytest.mark.parametrize(
    ("operator", "order", "says"),
    [
        (STANDARD, -1.0, "grows as 1/h: refinement makes it worse. Take the difference form"),
        (DIFFERENCE, 0.0, "A plateau: at a fixed number of neighbours refinement does not lower"),
        (CSPH, 1.0, "falls as h. Take a form that is consistent of higher order"),
    ],
)
def test_measured_runs_are_explained(operator, order, says):
    rows = runs_of(operator, 0.1)
    problem = Problem(1, operator, 0.1)
    found = explain(problem, "wendland-c4", rows)
    assert {run["dominant"] for run in found[1:]} == {"disorder"}
    # two measurements to 2 % a factor of 3 apart: log(1.04)/log(3); the law sets in by then
    assert abs(found[-1]["order"] - order) < 0.04
    agree, *parts = findings(problem, "wendland-c4", found)
    assert agree.startswith("Measured and predicted agree within a factor 1")
    assert says in parts[-1]
    # somebody who does not know the disorder is told it
    blind = Problem(1, operator, 0.0)
    first = findings(blind, "wendland-c4", explain(blind, "wendland-c4", rows))[0]
    sigma = re.search(r"--jitter ([0-9.]+) in place of 0 would explain that", first)
    assert sigma is not None, first
    assert abs(float(sigma[1]) / 0.1 - 1) < 0.05


def test_advice_is_that_of_the_model_that_explains_the_runs(capsys, tmp_path):
    """One run of a 3D lattice of unknown disorder. Its error is that of particles displaced by
    0.14 Δx, measured here: smoothing, which dominates without them, gives no advice."""
    file = tmp_path / "runs.csv"
    file.write_text("dx,h,error\n0.01,0.0173,0.12\n")
    problem = Problem(3, STANDARD, 0.14)
    assert measured(problem, "wendland-c2", 1 / 1.73, 0.0173 / 0.2, 0.03) == pytest.approx(
        0.12, rel=0.1
    )
    options = ("--kernel", "wendland-c2", "--dim", "3", "--wavelength", "0.2", "--table", str(file))
    code, text, _ = run(capsys, *options)
    assert code == 0
    said = " ".join(text.split())
    assert "--jitter 0.14 in place of 0 would explain that" in said
    assert "disorder dominates. At a fixed number of neighbours it grows as 1/h: refinement" in said
    assert "smoothing dominates" not in said
    assert "smaller h" not in said
    # one run is met by a shorter wave as well: which run would tell, and what either predicts
    found = re.search(
        r"as well with a wave of ([\d.]+) λ, where they are mostly smoothing. To decide, a run with"
        r" Δx/λ = ([\d.]+) and h/λ = ([\d.]+): its error is ([\d.]+) by --jitter 0.14 and ([\d.]+)"
        r" by a wave of \1 λ",
        said,
    )
    assert found is not None, said
    wave, dx, h, disorder, smoothing = map(float, found.groups())
    assert measured(problem, "wendland-c2", dx / h, h, 0.03) == pytest.approx(disorder, rel=0.1)
    still = measured(Problem(3, STANDARD), "wendland-c2", dx / h, h / wave)
    assert still == pytest.approx(smoothing, rel=0.03)  # two digits of the wave are printed
    code, text, _ = run(capsys, *options, "--format", "json")
    document = json.loads(text)
    assert [m["name"].split()[0] for m in document["explanations"]] == ["--jitter", "a"]
    assert [m["runs"][0]["dominant"] for m in document["explanations"]] == ["disorder", "smoothing"]
    assert document["runs"][0]["dominant"] == "smoothing"  # of the particles that were given


def test_the_slope_of_the_table_decides():
    """Errors measured with a wave half as long fall as Δx², as no disorder lets them; with disorder
    they grow as 1/Δx, as no wave does. Within a factor of two of Δx either."""
    problem, name = Problem(1, STANDARD), "wendland-c4"
    lengths = (0.1, 0.07, 0.05)
    shorter = [(x / 2, x, measured(problem, name, 0.5, 2 * x)) for x in lengths]
    (model,) = explanations(problem, name, explain(problem, name, shorter))
    assert model.problem.sigma == 0
    assert model.wave == pytest.approx(0.5, rel=0.02)
    assert model.runs[-1]["dominant"] == "smoothing"
    rough = [(x / 2, x, measured(Problem(1, STANDARD, 0.1), name, 0.5, x)) for x in lengths]
    runs = explain(problem, name, rough)
    (model,) = explanations(problem, name, runs)
    assert (model.wave, model.problem.sigma) == (1, pytest.approx(0.1, rel=0.03))
    still = [(x / 2, x, measured(problem, name, 0.5, x)) for x in lengths]
    powers = [
        np.polyfit(np.log([dx for dx, _, _ in rows]), np.log([e for _, _, e in rows]), 1)[0]
        for rows in (rough, rough, still)
    ]
    assert powers[0] < -0.8
    said = re.search(
        r"go as Δx\^(\S+), as predicted with it, Δx\^(\S+), rather than without, Δx\^(\S+)\.",
        findings(problem, name, runs)[0],
    )
    assert said is not None
    # one printed decimal, and two measurements to 1 % a factor of two apart
    assert [float(x) for x in said.groups()] == pytest.approx(powers, abs=0.05 + 0.03)
    # too much disorder given: less explains them
    rougher = Problem(1, STANDARD, 0.2)
    (model,) = explanations(rougher, name, explain(rougher, name, still))
    assert model.name == "--jitter 0"


def test_what_no_disorder_explains_is_said_to_be():
    problem = Problem(1, CSPH, 0.05)
    rows = [(0.05, 0.1, 0.5), (0.005, 0.01, 0.5), (0.0005, 0.001, 0.5)]
    said = findings(problem, "wendland-c4", explain(problem, "wendland-c4", rows))[0]
    assert "no disorder explains that: look for an error that is not the estimate's" in said
    # with the powers as evidence, and no advice from a model that is not that of the runs
    assert said.endswith("go as Δx^0; at this Δx/h smoothing goes as Δx^2, discretisation as Δx^0,"
                         " disorder as Δx^1.")  # fmt: skip
    assert len(findings(problem, "wendland-c4", explain(problem, "wendland-c4", rows))) == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "got columns a, b, expected dx"),
        ("dx,h,error\n1,x,2\n", "line 2"),
        ("dx,h,error\n1,1,2\n-1,1,2\n", "line 3: expected positive"),
        ("n,h,error\n-1,1,2\n", "line 2"),
        ("dx,h,error\n", "one row"),
        ("", "got columns none"),
    ],
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
    assert read_table(file, 3, 1.0, 2.0) == [(pytest.approx(0.2, rel=FEW), 0.15, 0.1)]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda p: best_at_error(p, "cubic-spline", 2.0), "between 0 and 1"),
        (lambda p: best_at_error(p, "cubic-spline", 1e-9), "not reached"),
        (lambda p: best_at_cost(p, "cubic-spline", -1.0), "positive"),
        (lambda p: best_at_particles(p, "cubic-spline", 0.0), "positive"),
        (lambda p: best_at_particles(p, "cubic-spline", 0.2), "another number of particles"),
        (
            lambda p: setting(p, kernel("cubic-spline"), 2.5, 0.1),
            "at Δx/h = 2.5: .*expected a smaller Δx/h",
        ),
        (lambda _: best_at_error(Problem(3, STANDARD), "cubic-spline", -1.0), "between 0 and 1"),
        (
            lambda _: best_at_error(Problem(2, Operator("divergence")), "cubic-spline", 0.1),
            "no prediction for divergence",
        ),
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
    assert "Take wendland-c2 with h = " in text or "Take cubic-spline with h = " in text
    assert "h ∝ Δx^(2/5); then the error falls as Δx^(4/5)" in text
    assert "Now (neighbours=20, cubic-spline, as many particles): the error is " in text
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
    assert "got no aim" in error
    assert "--error" in error
    code, _, error = run(capsys, *common, *aim, "--table", str(file))
    assert code == 2
    assert "got --particles-per-wavelength and --table" in error
    code, text, _ = run(capsys, *common, "--dim", "1", "--particles", "1e6")
    assert "No more neighbours than 200 are looked at" in text


def test_the_deeper_of_two_valleys_is_found_between_the_points_of_the_grid():
    """On the grid the valley at 2 seems deepest; the other one is, half-way between 7 and 8. A
    third, shallower on the grid than both, is not looked at."""

    def function(x):
        return min((x - 2.0) ** 2 + 1.0, 3.0 * abs(x - 7.5), 0.5 + 9.0 * abs(x - 4.75))

    grid = [float(x) for x in range(11)]
    values = [function(x) for x in grid]
    assert min(values) == function(2.0) == 1.0
    assert function(7.0) == function(8.0) == 1.5
    assert _minimum(function, grid) == 7.5
    mirrored = _minimum(lambda x: function(10.0 - x), grid)
    assert mirrored == 2.5


def test_a_minimum_at_either_end_of_the_grid_is_found():
    grid = [0.5 * n for n in range(9)]
    assert _minimum(lambda x: x, grid) == 0.0
    assert _minimum(lambda x: -x, grid) == 4.0
    assert _minimum(lambda x: (x - 1.3) ** 2, grid) == pytest.approx(1.3, abs=0.5 / 2**5)


# ------------------------------------------------------------------------------ beside a wall


@pytest.mark.parametrize(("dim", "name"), [(1, "cubic-spline"), (2, "wendland-c2")])
@pytest.mark.parametrize("operator", [STANDARD, CSPH], ids=str)
def test_the_boundary_layer_is_that_of_particles_between_walls(dim, name, operator) -> None:
    """All particles of a slab, of sin and cos: the mean square of all phases, to rounding; the
    slab is explicit particles, and nobody tells them of a wall."""
    ratio, x, n = 0.5, 0.02, 200
    problem = Problem(dim, operator)
    chosen = setting(problem, kernel(name), ratio, x)
    found = boundary_layer(problem, kernel(name), chosen, n * ratio * x)
    line = (np.arange(n) + 0.5) * ratio
    across = np.arange(9) * ratio
    grid = np.stack(np.meshgrid(line, *[across] * (dim - 1), indexing="ij")).reshape(dim, -1)
    period = None if dim == 1 else [np.inf, 9 * ratio]
    scene = particles(grid.T, h=1.0, volume=ratio**dim, period=period)
    k = 2 * np.pi * x
    square = 0.0
    for values, slope in ((np.sin, np.cos), (np.cos, lambda s: -np.sin(s))):
        estimate = measure(scene, name, operator, Values(values(k * grid[0]))).estimates
        exact = np.zeros_like(grid)
        exact[0] = k * slope(k * grid[0])
        square += np.mean(((estimate - exact) ** 2).sum(axis=0)) / (2 * k**2)
    assert found.rms == pytest.approx(square**0.5, rel=1e-9)
    far = chosen.error.total**2
    assert found.error == pytest.approx(1 - far / square, rel=1e-9)
    assert 0 < found.reach < 2
    assert found.particles == 2 * sum(eta <= found.reach for eta in found.eta) / n


def test_orders_on_and_off_the_wall() -> None:
    orders = {STANDARD: (-1, 2), DIFFERENCE: (0, 2), CSPH: (1, 2), SHEPARD: (0, 2)}
    for operator, wanted in orders.items():
        problem = Problem(1, operator)
        chosen = setting(problem, kernel("cubic-spline"), 0.5, 0.02)
        found = boundary_layer(problem, kernel("cubic-spline"), chosen, 4.0)
        assert (found.order, found.order_inside) == wanted


def test_tune_with_a_wall(capsys: pytest.CaptureFixture[str]) -> None:
    command = ("--kernel", "cubic-spline", "--particles-per-wavelength", "20", "--wall")
    status, out, _ = run(capsys, *command, "--box", "5", "--format", "json")
    wall = json.loads(out)["wall"]
    assert (status, wall["domain"], wall["at"], wall["order"]) == (0, 5.0, "half-way", -1)
    status, out, _ = run(capsys, *command, "--box", "5")
    said = " ".join(out.split())
    assert f"another up to {wall['reach']:.3g} h" in said
    assert "Between two walls 5 λ apart" in said
    for extra, message in (
        (["--box", "0.05"], "expected more than two supports"),
        (["--disorder", "poisson"], "expected --jitter"),
        (["--operator", "laplacian", "--form", "nested"], "not for the nested form"),
    ):
        status, _, error = run(capsys, *command, *extra)
        assert status == 2
        assert message in " ".join(error.split())
