"""Variable h, measured less derived: within the rounding bound on lattices, within 4 standard
errors where particles are displaced, and the atmosphere within 2 %."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from sphtrunc import derive, kernel
from sphtrunc.experiment.engine import volumes
from sphtrunc.experiment.fields import polynomial, sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.operators.h_rules import RULES
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.particles import Particles, particles
from sphtrunc.scenes.smoothing_lengths import linear, sloped
from sphtrunc.study.comparison import compare, predict_error, predict_moments
from sphtrunc.study.conservation.atmosphere import atmosphere_errors
from sphtrunc.theory.variable_h.atmosphere import acceleration_errors

UNIT = 2.0**-53
OPERATORS = [
    Operator("value"),
    Operator("gradient"),
    Operator("laplacian", "brookshaw"),
    Operator("gradient", "difference", "csph"),
    Operator("gradient", "standard", "rkpm-1"),
]
GRADIENTS = {1: ["1/5"], 2: ["1/7", "-1/9"], 3: ["1/7", "0", "-1/9"]}


@pytest.mark.parametrize("operator", OPERATORS, ids=str)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(("dim", "kind"), [(1, "uniform"), (2, "square"), (2, "hexagonal")])
def test_lattices_agree_within_rounding(dim: int, kind: str, rule: str, operator: Operator) -> None:
    scene = sloped(lattice(dim, kind, "4/5"), GRADIENTS[dim], rule)
    found = compare(scene, "cubic-spline", operator, degree=2)
    for alpha, difference in found.difference.items():
        assert abs(difference) <= found.expected[alpha]
        assert found.expected[alpha] < 1e-11


@pytest.mark.parametrize("kind", ["cubic", "fcc"])
def test_space_agrees_within_rounding(kind: str) -> None:
    scene = sloped(lattice(3, kind, "1"), GRADIENTS[3], "scatter")
    found = compare(scene, "wendland-c2", degree=1)
    for alpha, difference in found.difference.items():
        assert abs(difference) <= found.expected[alpha] < 1e-12


def test_a_small_change_is_seen() -> None:
    """The same comparison with g off by a millionth fails by far."""
    near = sloped(lattice(1, "uniform", "4/5"), Fraction(1, 5) + Fraction(1, 10**6), "scatter")
    measured = measure(near, "cubic-spline", "gradient", moments=2, bound=True)
    derived = derive("cubic-spline", degree=2, dx_over_h="4/5", h_gradient="1/5")
    difference = abs(float(measured.moments[2][0]) - float(derived.discrete[2]))
    assert difference > 1e6 * float(measured.moment_bound[2,].max())


@pytest.mark.parametrize("rule", RULES)
def test_precisions_agree(rule: str) -> None:
    """Pairs of floats and 60 digits give the derived fractions, to their own rounding."""
    scene = sloped(lattice(1, "uniform", "10/13"), "1/5", rule)
    derived = derive(
        "cubic-spline", degree=3, dx_over_h="10/13", h_gradient="1/5", h_rule=rule
    ).discrete
    for precision in ("extended", "exact"):
        found = measure(scene, "cubic-spline", moments=3, precision=precision)
        for k in range(4):
            assert abs(float(found.moments[k][0]) - float(derived[k])) <= UNIT * abs(derived[k])


@pytest.mark.parametrize(
    "operator",
    [Operator("value"), Operator("gradient"), Operator("gradient", "difference", "csph")],
    ids=str,
)
@pytest.mark.parametrize(("dim", "rule"), [(1, "scatter"), (1, "mean-kernel"), (2, "mean")])
def test_disorder_agrees_within_four_standard_errors(
    dim: int, rule: str, operator: Operator
) -> None:
    """The mean within four standard errors, and the spread within four of its own, 1/√(2n)."""
    home = lattice(dim, None, "1/2")
    scene = sloped(jittered(home, 0.01, seed=4), GRADIENTS[dim], rule)
    found = compare(scene, "quintic-spline", operator, degree=2, targets=600, seed=2)
    for alpha, difference in found.difference.items():
        assert abs(difference) <= 4.0 * found.expected[alpha] + 1e-12
    assert found.ratio
    for ratio in found.ratio.values():
        assert abs(ratio - 1.0) <= 4.0 / np.sqrt(2 * 600)


def test_graded_scenes_carry_h_too() -> None:
    """Fine graded spacing with a gradient of h: the limit, to the order (Δx/h)² of its cells."""
    limit = derive("quintic-spline", degree=2, h_gradient="1/5").varying.limit
    errors = []
    for step in (0.2, 0.1):
        scene = sloped(graded(lambda x, dx=step: dx * (1.0 + 0.1 * x)), "1/5", "scatter")
        found = measure(scene, "quintic-spline", moments=2)
        errors.append([abs(float(found.moments[k][0]) - float(limit[k])) for k in (1, 2)])
    for coarse, fine in zip(*errors, strict=True):
        assert 1.3 < np.log2(coarse / fine) < 2.4


@pytest.mark.parametrize("operator", [Operator("value"), Operator("gradient")], ids=str)
def test_graded_spacing_is_predicted(operator: Operator) -> None:
    """Spacing that changes slowly: what theory leaves out is a small part of what it predicts."""
    x = np.linspace(-3.0, 3.0, 40)
    scene = graded(lambda s: 0.4 * (1.0 + 0.02 * s), x)
    found = measure(scene, "cubic-spline", operator, moments=2)
    derived = predict_moments(scene, "cubic-spline", operator, 2)
    limit = derive("cubic-spline", operator, degree=2).limit
    for k in range(3):
        seen = float(np.std(found.moments[k]))
        assert seen == pytest.approx(derived.std[k,], rel=0.05)
        effect = abs(float(limit[k]) - derived.mean[k,]) + derived.std[k,]
        assert abs(float(np.mean(found.moments[k])) - derived.mean[k,]) < 0.05 * effect
    split = predict_error("cubic-spline", operator, scene, {(1,): 1.0, (2,): 0.3})
    field = polynomial({(1,): 1.0, (2,): 0.15}, 1)
    rms = measure(scene, "cubic-spline", operator, field).error["rms"]
    assert rms == pytest.approx(split.total, rel=0.05)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("operator", OPERATORS, ids=str)
@pytest.mark.parametrize("dim", [1, 2])
def test_errors_of_fields_with_a_gradient_of_h(dim: int, operator: Operator, rule: str) -> None:
    """On lattices to the rounding, of waves over all phases and of polynomials at the target."""
    scene = sloped(lattice(dim, None, "1/2"), GRADIENTS[dim], rule)
    first = (1,) + (0,) * (dim - 1)
    for field in (sinusoid("1/50", dim=dim), polynomial({first: 1.0, (2, *first[1:]): 0.3}, dim)):
        split = predict_error("wendland-c2", operator, scene, field)
        found = measure(scene, "wendland-c2", operator, field)
        assert abs(found.error["rms"] - split.total) <= 1e-12 + 1e-9 * split.total
        assert split.total <= split.smoothing + split.discretisation + 1e-12


@pytest.mark.parametrize("rule", ["scatter", "mean-kernel"])
@pytest.mark.parametrize("operator", [OPERATORS[1], OPERATORS[3]], ids=str)
def test_errors_of_waves_in_disorder_with_a_gradient_of_h(operator: Operator, rule: str) -> None:
    """The rms of 1500 targets of random phase is known to 4/√3000, displacements to first order."""
    scene = sloped(jittered(lattice(2, None, "1/2"), 0.02, seed=6), GRADIENTS[2], rule)
    field = sinusoid("1/50", [1, 2], 2)
    split = predict_error("quintic-spline", operator, scene, field)
    found = measure(scene, "quintic-spline", operator, field, targets=1500)
    assert found.error["rms"] == pytest.approx(split.total, rel=4.0 / np.sqrt(3000))
    assert split.disorder > 0


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("operator", [OPERATORS[0], OPERATORS[1]], ids=str)
def test_graded_spacing_with_a_gradient_of_h_is_predicted(operator: Operator, rule: str) -> None:
    """h and spacing change slowly: what is left out is a small part of what is predicted."""
    x = np.linspace(-3.0, 3.0, 40)
    scene = sloped(graded(lambda s: 0.4 * (1.0 + 0.02 * s), x), "1/50", rule)
    found = measure(scene, "cubic-spline", operator, moments=2)
    derived = predict_moments(scene, "cubic-spline", operator, 2)
    limit = derive("cubic-spline", operator, degree=2).limit
    for k in range(3):
        effect = abs(float(limit[k]) - derived.mean[k,]) + derived.std[k,]
        assert abs(float(np.mean(found.moments[k])) - derived.mean[k,]) < 0.1 * effect + 1e-6
    split = predict_error("cubic-spline", operator, scene, {(1,): 1.0, (2,): 0.3})
    field = polynomial({(1,): 1.0, (2,): 0.15}, 1)
    rms = measure(scene, "cubic-spline", operator, field).error["rms"]
    assert rms == pytest.approx(split.total, rel=0.01)


def test_explicit_particles_with_linear_h_are_the_scene() -> None:
    x = np.arange(-12, 13) * 0.5
    h = linear(x[x > -4.9], 1.0, [0.2], [0.0])
    scene = particles(x[x > -4.9], h=h, volume=0.5, mode="scatter")
    at = int(np.argmin(np.abs(scene.x[0])))
    found = measure(scene, "cubic-spline", moments=3, targets=np.array([at]), bound=True)
    derived = derive("cubic-spline", degree=3, dx_over_h="1/2", h_gradient="1/5").discrete
    for k in range(4):
        room = float(found.moment_bound[k,].max()) + 4.0 * UNIT  # 0.2 is not 1/5
        assert abs(float(found.moments[k][0]) - float(derived[k])) <= room
    with pytest.raises(ValueError, match=r"h-gradient: h is -1\.4 at particle 0"):
        linear(x, 1.0, [0.4], [0.0])


def cloud_of(rule: str, **weights: object) -> Particles:
    random = np.random.default_rng(11)
    return particles(random.random((60, 2)), h=random.uniform(0.2, 0.5, 60), mode=rule, **weights)


def test_the_mean_kernel_is_the_mean_of_two() -> None:
    """Sums are linear in the kernel: on particles with an h each the moments are the mean of those
    of gather and scatter, within the bounds of all three."""
    gather, scatter, mean = (
        measure(cloud_of(rule, volume=1 / 60), "cubic-spline", moments=1, bound=True)
        for rule in ("gather", "scatter", "mean-kernel")
    )
    for alpha, values in mean.moments.values.items():
        wanted = (gather.moments[alpha] + scatter.moments[alpha]) / 2
        room = sum(one.moment_bound[alpha] for one in (gather, scatter, mean))
        assert np.all(np.abs(values - wanted) <= room + UNIT * np.abs(wanted))
        assert np.any(np.abs(gather.moments[alpha] - scatter.moments[alpha]) > 1e-2)


def test_summed_densities_of_the_mean_kernel() -> None:
    """1/V is as linear; sums of 60 positive terms, a dozen roundings each."""
    gather, scatter, mean = (
        1 / volumes(cloud_of(rule, mass=1.0), kernel("cubic-spline"))
        for rule in ("gather", "scatter", "mean-kernel")
    )
    assert np.all(np.abs(mean - (gather + scatter) / 2) <= 100 * UNIT * mean)
    assert np.any(np.abs(gather - scatter) > 1e-2 * mean)


@pytest.mark.parametrize("rule", ["scatter", "mean-kernel"])
def test_many_waves_at_once_with_a_gradient_of_h(rule: str) -> None:
    scene = sloped(jittered(lattice(2, None, "1/2"), 0.1), ["1/7", "0"], rule)
    operators = [Operator("gradient"), Operator("gradient", "difference", "csph")]
    for operator, row in zip(
        operators, waves(scene, "cubic-spline", operators, ["1/50"], targets=50), strict=True
    ):
        alone = measure(scene, "cubic-spline", operator, sinusoid("1/50", dim=2), targets=50)
        assert np.abs(row[0].errors - alone.errors).max() < 1e-11


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_atmosphere_within_two_percent(dim: int) -> None:
    """Particles of an isothermal atmosphere at h/L = 0.02: the error of the acceleration of all six
    rules is the derived fraction to 2 % of the largest."""
    smooth = kernel("b-spline:12")  # its transform vanishes at 4π/h: the lattice is not felt
    derived = acceleration_errors(smooth, dim)
    measured = atmosphere_errors(smooth, dim, 0.02, 0.5)
    largest = max(abs(float(value)) for value in derived.values())
    assert measured.keys() == derived.keys()
    for rule, value in derived.items():
        assert abs(measured[rule] - float(value)) <= 0.02 * largest


@pytest.mark.parametrize("dim", [1, 2])
def test_the_rest_of_the_atmosphere_is_of_the_next_order(dim: int) -> None:
    smooth = kernel("b-spline:12")
    derived = acceleration_errors(smooth, dim)
    small, large = (
        max(abs(found[rule] - float(value)) for rule, value in derived.items())
        for found in (atmosphere_errors(smooth, dim, e, 0.5) for e in (0.02, 0.04))
    )
    assert 3.0 < large / small < 5.0


def test_what_is_refused() -> None:
    home = lattice(1, "uniform", "1/2")
    with pytest.raises(ValueError, match="h-rule: got 'largest', expected one of gather"):
        sloped(home, "1/5", "largest")
    with pytest.raises(ValueError, match="h-gradient: got 2 numbers, expected 1 or 1"):
        sloped(home, ["1/5", "1/5"])
    with pytest.raises(ValueError, match=r"h-gradient: .* expected \|g\| below 1/2"):
        measure(sloped(home, "1/2"), "cubic-spline")
    with pytest.raises(ValueError, match="volume: got summation"):
        sloped(lattice(1, "uniform", "1/2", volume="summation"), "1/5")
    gradient, nested = Operator("gradient"), Operator("laplacian", "nested")
    off = lattice(1, "uniform", "1/2", offset="1/3")
    for operator, scene, message in (
        (gradient, sloped(off, "1/5"), "targets that are particles"),
        (nested, sloped(home, "1/5"), "nested sums see every particle's own h"),
        (gradient, sloped(jittered(home, 0.1, "blue"), "1/5"), "blue displacements depend"),
    ):
        with pytest.raises(ValueError, match=message):
            predict_error("cubic-spline", operator, scene, {(1,): 1.0})
    with pytest.raises(ValueError, match="blue displacements depend"):
        compare(sloped(jittered(home, 0.1, "blue"), "1/5"), "cubic-spline", targets=10)
