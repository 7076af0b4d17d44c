"""Round-off: floors of forms and precisions, where errors turn up, neighbours taken in pairs."""

from __future__ import annotations

from fractions import Fraction
from math import log10
from typing import Any

import numpy as np
import pytest

from sphtrunc import derive
from sphtrunc.bench.stability import floor as measured_floor
from sphtrunc.cli import main
from sphtrunc.experiment import fields as fd
from sphtrunc.experiment.matrices import weights
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.one_pass import estimates
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.figures import make
from sphtrunc.kernels.parse import kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.particles import particles
from sphtrunc.scenes.sites import KINDS
from sphtrunc.study.comparison import compare, predict_error

U = 2.0**-53
FORMS = ("standard", "difference", "paired")
PRECISIONS = ("plain", "compensated", "extended")
LENGTHS = (1e-1, 1e-2, 1e-4, 1e-6, 1e-8)


def still(dx_over_h: str, dim: int = 1) -> Any:
    """Undisplaced particles, every target with a phase of its own."""
    return jittered(lattice(dim, None, dx_over_h, extent=1000), 0.0)


def rounding(
    scene: Any, name: str, form: str, x: float, precision: str, targets: int = 100
) -> float:
    """The rms rounding error of the gradient, relative to its amplitude, by more digits."""
    field = fd.sinusoid(x, dim=scene.dim)
    finer = "exact" if precision == "extended" else "extended"
    rough, fine = (
        measure(scene, name, field=field, form=form, targets=targets, precision=p)
        for p in (precision, finer)
    )
    low = np.zeros(1) if rough.errors_low is None else rough.errors_low
    gap = (rough.errors - fine.errors) + (low - fine.errors_low)
    return float(np.sqrt((gap**2).sum(axis=0).mean()))


# ----------------------------------------------------------------------------------------- floors


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("name", "ratio"),
    [("quintic-spline", "1/2"), ("cubic-spline", "10/13"), ("wendland-c4-1d", "1/10")],
)
def test_floors_are_predicted_within_a_factor_of_five(
    name: str, ratio: str, form: str, precision: str
) -> None:
    """In both directions; and where a floor rises as 1/h or stays level, so does what is seen."""
    scene, operator = still(ratio), Operator("gradient", form)
    seen = []
    for x in LENGTHS:
        found = rounding(scene, name, form, x, precision)
        floor = predict_error(name, operator, scene, fd.sinusoid(x), precision).rounding
        assert floor / 5 < found < 5 * floor, x
        seen.append(found)
    order = log10(seen[1] / seen[-1]) / 6  # from h/λ = 1e-2 to 1e-8
    assert abs(order - (-1 if form == "standard" else 0)) < 0.1


@pytest.mark.parametrize("form", FORMS)
def test_precisions_gain_what_they_should_and_no_more(form: str) -> None:
    """Compensated: the rounding of the sum, which folds 21 neighbours in 5 levels beside the 5
    roundings of each term; extended: u more, on the same terms."""
    scene = still("1/5")
    for x in (1e-3, 1e-7):
        plain, compensated, extended = (
            rounding(scene, "wendland-c4-1d", form, x, p, 300 if p != "extended" else 60)
            for p in PRECISIONS
        )
        assert np.sqrt(5 / 10) / 1.5 < compensated / plain < 1.02
        assert U / 5 < extended / plain < 5 * U


def test_compensation_gains_the_error_of_the_sum_and_no_more() -> None:
    """300 neighbours in 2D, displaced."""
    scene = jittered(lattice(2, "square", "1/5", extent=1000), 0.1, seed=1)
    plain, compensated = (
        rounding(scene, "quintic-spline", "standard", 1e-5, p, 300)
        for p in ("plain", "compensated")
    )
    assert 0.2 * plain < compensated < plain


def whole(form: str, precision: str, lengths: list[float]) -> tuple[list[float], list[float]]:
    """Measured and predicted rms errors at h/Δx = 2, where a B-spline has no discretisation error
    to speak of: smoothing alone, until rounding overtakes it."""
    scene, operator = still("1/2"), Operator("gradient", form)
    seen, theory = [], []
    for x in lengths:
        field = fd.sinusoid(x)
        found: Any = measure(
            scene, "quintic-spline", operator, field, targets=400, precision=precision
        ).error
        seen.append(found["rms"])
        theory.append(predict_error("quintic-spline", operator, scene, field, precision).total)
    return seen, theory


@pytest.mark.parametrize("precision", ["plain", "compensated"])
def test_the_error_of_the_standard_form_turns_up_where_predicted(precision: str) -> None:
    """Smoothing ½ R₂ k² falls below the floor, which goes as 1/k, at k³ ~ u."""
    lengths = [10.0 ** (-n / 4) for n in range(8, 33)]
    seen, theory = whole("standard", precision, lengths)
    turn, predicted = lengths[int(np.argmin(seen))], lengths[int(np.argmin(theory))]
    assert 1e-7 < predicted < 1e-5
    assert predicted / 3 < turn < 3 * predicted
    above = [s / t for s, t, x in zip(seen, theory, lengths, strict=True) if x > 10 * predicted]
    assert max(abs(r - 1) for r in above) < 4 * 0.36 / 20  # 4 σ of the rms of 400 phases
    below = [s / t for s, t, x in zip(seen, theory, lengths, strict=True) if x < predicted / 3]
    assert all(1 / 5 < r < 5 for r in below)
    assert abs(log10(seen[-1] / seen[-5]) - 1) < 0.15


@pytest.mark.parametrize(
    ("form", "precision"),
    [("difference", "plain"), ("paired", "plain"), ("standard", "extended")],
)
def test_other_forms_and_more_digits_do_not_turn_up(form: str, precision: str) -> None:
    seen, _ = whole(form, precision, [1e-2, 1e-4, 1e-6, 1e-7])
    assert abs(log10(seen[0] / seen[1]) - 4) < 0.02
    assert abs(log10(seen[1] / seen[2]) - 4) < 0.02
    assert abs(log10(seen[2] / seen[3]) - 2) < 0.02


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_large_box_costs_no_digits(dim: int) -> None:
    """Indices plus displacements: at most 1e-15 in the median in a box of 100 Δx."""
    scene = jittered(lattice(dim, None, "1/2", extent=100), 0.2, seed=1)
    field = fd.sinusoid("1/50", dim=dim)
    rough, fine = (
        measure(scene, "quintic-spline", field=field, targets=300, precision=p)
        for p in ("plain", "extended")
    )
    assert np.median(np.abs(rough.errors[0] - fine.errors[0])) <= 1e-15


def test_from_absolute_coordinates_the_digits_are_lost() -> None:
    """The same particles as positions in the box: x_b − x_a costs a factor of ten and more."""
    scene = jittered(lattice(1, None, "1/2", extent=100), 0.2, seed=1)
    index = np.arange(-10, 110)
    x = 0.5 * (index + scene.displacement(index[None])[0])
    targets = np.arange(20, 110)
    explicit = measure(particles(x, h=1.0, volume=0.5), "quintic-spline", moments=1,
                       targets=targets)  # fmt: skip
    home = measure(scene, "quintic-spline", moments=1, targets=targets - 10, precision="extended")
    gap = np.median(np.abs(explicit.moments[0] - home.moments[0]))
    near = measure(scene, "quintic-spline", moments=1, targets=targets - 10)
    best = np.median(np.abs(near.moments[0] - home.moments[0]))
    assert best <= 1e-15
    assert gap > 5 * best


def test_the_reported_floor_of_the_stability_suite_is_a_bound() -> None:
    for form in ("standard", "difference"):
        error, bound = measured_floor(1e-6, 0.5, form)
        assert 0 < error <= bound


def test_the_figure_shows_all_three_floors() -> None:
    picture = make("round-off", quick=True)
    titles = [panel.title for panel in picture.panels]
    assert titles == [*PRECISIONS, "whole error"]
    for panel in picture.panels[:3]:
        points = {c.label: c for c in panel.curves if c.kind == "measured"}
        assert tuple(points) == FORMS
        for curve in points.values():
            assert curve.predicted is not None
            assert curve.x.min() == pytest.approx(1e-8, rel=1e-12)
            assert curve.x.max() == pytest.approx(0.1, rel=1e-12)
            assert np.all(curve.y < 5 * curve.predicted)
            assert np.all(curve.y > curve.predicted / 5)


# ------------------------------------------------------------------------------------------ pairs


def bounded(scene: Any, name: str, form: str, field: Any) -> Any:
    return measure(scene, name, field=field, form=form, bound=True)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "hcp"])
@pytest.mark.parametrize("volume", ["constant", "summation"])
def test_paired_is_the_standard_form_on_lattices(kind: str, volume: str) -> None:
    """To the last digit of either in 60-digit arithmetic, within both bounds in floats."""
    dim = KINDS[kind].dim
    direction = [1.0, 0.3, -0.7][:dim]
    for field in (fd.sinusoid("1/7", direction, dim), fd.field("polynomial: 1 + x^2 + 3x^3", dim)):
        scene = lattice(dim, kind, "9/10", volume=volume)
        standard, paired = (
            measure(scene, "wendland-c4", field=field, form=form, bound=volume == "constant")
            for form in ("standard", "paired")
        )
        assert standard.errors.shape == paired.errors.shape
        gap = np.abs(standard.errors - paired.errors).max()
        allowed = 64 * U  # Σ|w||A| below 4 in units of the amplitude; some ten roundings each
        if volume == "constant":
            allowed = standard.rounding_bound + paired.rounding_bound
            assert paired.rounding_bound < standard.rounding_bound
        assert gap <= allowed


@pytest.mark.parametrize("form", FORMS)
def test_all_forms_are_one_in_sixty_digits(form: str) -> None:
    field = fd.sinusoid("1/9")
    scene = lattice(1, None, "10/13")
    standard, other = (
        measure(scene, "cubic-spline", field=field, form=f, precision="exact")
        for f in ("standard", form)
    )
    assert np.abs(standard.errors - other.errors).max() <= 4 * U * np.abs(standard.errors).max()


def test_paired_gradients_of_polynomials_are_the_derived_moments() -> None:
    """Σ c_k M_k, in fractions; even powers do not count."""
    ratio, c = Fraction(4, 11), (5, 3, 7, -2, 1, 4)
    spec = "polynomial: " + " + ".join(f"{n} x^{k}" for k, n in enumerate(c)).replace("+ -", "- ")
    derived = derive("wendland-c2", form="paired", degree=5, dx_over_h=ratio).discrete
    assert derived is not None
    assert derived.values[(0,)] == 0
    truth = sum(n * Fraction(str(derived.values[(k,)])) for k, n in enumerate(c)) - c[1]
    found = bounded(lattice(1, None, ratio), "wendland-c2", "paired", fd.field(spec, 1))
    gap = abs(Fraction(float(found.errors[0, 0])) * c[1] - truth)
    assert 0 < found.rounding_bound < 1e-13
    assert gap <= Fraction(c[1] * found.rounding_bound)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_paired_bump_vector_operators_and_waves(dim: int) -> None:
    scene = lattice(dim, None, "3/4")
    for name, field in (
        ("gradient", fd.field("bump:2", dim)),
        ("divergence", [fd.sinusoid("1/8", dim=dim)] * dim),
    ):
        standard, paired = (
            measure(scene, "wendland-c4", name, field, form=f) for f in ("standard", "paired")
        )
        assert np.abs(standard.errors - paired.errors).max() <= 256 * U
    ((one,),) = waves(scene, "wendland-c4", [Operator("gradient", "paired")], [0.1])
    alone = measure(scene, "wendland-c4", field=fd.sinusoid(0.1, dim=dim), form="paired")
    assert np.abs(one.errors - alone.errors).max() <= 256 * U


def test_paired_needs_pairs() -> None:
    """Whoever is asked for the form says why there is none."""
    operator, wave = Operator("gradient", "paired"), fd.sinusoid(0.1)
    x = np.arange(9.0)
    cloud = particles(x, h=2.0, volume=1.0)
    moved = jittered(lattice(1), 0.1)
    asked: list[Any] = [
        lambda: measure(moved, "cubic-spline", operator, wave),
        lambda: measure(lattice(1, None, "1/2", "1/3"), "cubic-spline", operator),
        lambda: measure(lattice(3, "hcp", "4/5"), "cubic-spline", operator),
        lambda: measure(graded(lambda x: 0.5 + 0.0 * x), "cubic-spline", operator),
        lambda: measure(cloud, "cubic-spline", operator, fd.Values(x)),
        lambda: waves(moved, "cubic-spline", [operator], [0.1]),
        lambda: compare(moved, "cubic-spline", operator),
        lambda: predict_error("cubic-spline", operator, moved, wave),
        lambda: predict_error("cubic-spline", operator, moved, {(1,): 1.0}),
        lambda: derive("cubic-spline", operator, offset="1/3"),
        lambda: derive("cubic-spline", operator, dim=3, dx_over_h=1, lattice="hcp"),
        lambda: estimates(cloud, kernel("cubic-spline"), operator, x),
        lambda: weights(cloud, kernel("cubic-spline"), operator),
    ]
    for ask in asked:
        with pytest.raises(ValueError, match="paired takes the neighbours at s and −s together"):
            ask()
    with pytest.raises(ValueError, match="got csph for the form paired, expected none"):
        Operator("gradient", "paired", "csph")


def test_the_command_measures_pairs(capsys: pytest.CaptureFixture[str]) -> None:
    common = ["measure", "-k", "quintic-spline", "--dx-over-h", "1/2", "--h-over-lambda", "1e-7"]
    common += ["--jitter", "0", "--targets", "400"]  # a lattice, every target at its own phase
    rms = {}
    for form in FORMS:
        with pytest.raises(SystemExit) as stop:
            main([*common, "--form", form, "--format", "csv"])
        assert stop.value.code == 0
        rows = dict(line.split(",", 1) for line in capsys.readouterr().out.splitlines())
        rms[form] = float(rows["error_rms"].split(",")[0])
    exact = (2 * np.pi * 1e-7) ** 2 / 4 / np.sqrt(2)  # ½ R₂ k², R₂ = 1/2
    assert rms["paired"] == pytest.approx(exact, rel=4 * 0.36 / 20)  # 4 σ of 400 phases
    assert rms["standard"] > 10 * exact  # its rounding, u/k
    with pytest.raises(SystemExit) as stop:
        main([*common, "--form", "paired", "--jitter", "0.1"])
    assert stop.value.code == 2
    assert "undisplaced lattice" in capsys.readouterr().err
