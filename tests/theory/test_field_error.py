"""Predicted errors of sinusoids against measured ones, and against the transform of the kernel."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import factorial, pi, prod, sqrt

import pytest
from strategies import OPERATORS, operators

from sphtrunc.experiment.fields import polynomial, sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.kernels.parse import kernel
from sphtrunc.kernels.transform import smoothing_error
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.sites import DEFAULT
from sphtrunc.study.comparison import predict_error
from sphtrunc.theory.disorder.leading_law import leading_coefficient
from sphtrunc.theory.field_error import predict_waves
from sphtrunc.theory.lattice_sums import lattice_sums
from sphtrunc.theory.limit import continuous_sum

LENGTHS = (1e-3, 0.02, 0.1, 0.3)
SHAPE = kernel("polynomial:4")


def predicted(
    operator, dim, ratio, lengths=LENGTHS, shape=SHAPE, offset=0, kind=None, along=None, **disorder
):
    shift = (Fraction(offset),) * dim
    scene = Arrangement(kind or DEFAULT[dim], Fraction(ratio), shift, **disorder)
    return predict_waves(shape, operator, scene, lengths, direction=along)


@pytest.mark.parametrize(
    ("dim", "kind", "ratio", "name"),
    [
        (1, "uniform", "7/10", "polynomial:4"),
        (1, "uniform", "10/13", "cubic-spline"),
        (2, "hexagonal", "3/5", "quintic-spline"),
        (3, "bcc", "19/20", "wendland-c4"),
    ],
)
def test_on_lattices_the_prediction_is_the_measurement(dim, kind, ratio, name):
    shape = kernel(name)
    every = [o for o in operators(dim) if o.name not in ("divergence", "curl")]
    table = waves(lattice(dim, kind, ratio), shape, every, LENGTHS)
    for operator, row in zip(every, table, strict=True):
        theory = predicted(operator, dim, ratio, shape=shape, kind=kind)
        for length, one, split in zip(LENGTHS, row, theory, strict=True):
            k = 2 * pi * length
            # sums of Σ|w| <= 100 in units of 1/h^m, some ten roundings in each of their terms,
            # grown by the condition of the matrix of a correction
            grown = max(1.0, float(one.condition.max()))
            rounding = 10 * 2.0**-53 * 100 * grown / min(k, 1.0) ** operator.derivatives
            assert abs(one.error["rms"] - split.total) <= rounding, (operator, length)
            assert split.disorder == 0.0


def test_an_offset_is_taken_into_account():
    for operator in (Operator("gradient"), Operator("gradient", "difference", "csph")):
        ((one,),) = waves(lattice(1, None, "0.9", "1/3"), SHAPE, [operator], [0.05])
        (split,) = predicted(operator, 1, "9/10", [0.05], offset="1/3")
        assert one.error["rms"] == pytest.approx(split.total, rel=1e-9)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "polynomial:2"])
def test_the_smoothing_part_is_one_less_the_transform(dim, name):
    shape = kernel(name)
    exact = smoothing_error(shape, [2 * pi * x for x in LENGTHS], dim) / sqrt(2)
    for operator in (Operator("value"), Operator("gradient"), Operator("hessian", "difference")):
        found = predicted(operator, dim, "1/2", shape=shape)
        for split, value, length in zip(found, exact, LENGTHS, strict=True):
            rounding = 1e3 * 2.0**-53 / (2 * pi * length) ** operator.derivatives
            assert abs(split.smoothing - value) <= rounding + 1e-12 * value


def test_brookshaws_smoothing_is_half_that_of_the_second_derivative():
    for dim in (1, 2, 3):
        (half,) = predicted(Operator("laplacian", "brookshaw"), dim, "1/2", [0.001])
        (whole,) = predicted(Operator("laplacian", "difference"), dim, "1/2", [0.001])
        # the next terms are smaller by k² R_4/R_2 <= 4k²
        assert abs(half.smoothing / whole.smoothing - 0.5) < 4 * (2 * pi * 0.001) ** 2


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_leading_law_of_disorder(dim):
    """(σ/Δx)(Δx/h)^{1+d/2} ‖∇g‖ for the first moment that a form does not have for free."""
    ratio, sigma, h_over_lambda = Fraction(2, 5), 0.005, 1e-5
    k = 2 * pi * h_over_lambda
    for operator, n in ((Operator("gradient"), 0), (Operator("gradient", "difference"), 1)):
        (split,) = predicted(operator, dim, ratio, [h_over_lambda], sigma=sigma)
        parts = [leading_coefficient(SHAPE, operator, unit(dim, 0, n), axis) for axis in range(dim)]
        norm = sqrt(sum(float(part) for part in parts))
        law = sigma * float(ratio) ** (1 + dim / 2) * norm * k ** (n - 1) / sqrt(2)
        assert abs(split.disorder / law - 1) < 0.02


@pytest.mark.parametrize(
    ("dim", "ratio", "sigma", "distribution", "volume", "targets"),
    [
        (1, "2/5", 0.05, "gaussian", "constant", 20000),
        (1, "7/10", 0.2, "gaussian", "constant", 20000),
        (1, "7/10", 0.2, "uniform", "constant", 20000),
        (1, "1/2", 0.05, "blue", "constant", 20000),
        (1, "2/5", 0.02, "gaussian", "cell", 20000),
        (2, "4/5", 0.2, "gaussian", "constant", 2000),
        (3, "19/20", 0.1, "gaussian", "constant", 600),
    ],
)
def test_in_disorder_the_prediction_is_as_good_as_it_says(
    dim, ratio, sigma, distribution, volume, targets
):
    """Within 4 standard errors and what the prediction is said to be good to, 1 % where nothing
    is said (`predict_fields`)."""
    extent = 2**20 if dim == 1 else 1000
    scene = jittered(lattice(dim, None, ratio, volume=volume, extent=extent), sigma, distribution)
    table = waves(scene, SHAPE, OPERATORS, LENGTHS, targets=targets)
    for operator, row in zip(OPERATORS, table, strict=True):
        theory = predicted(
            operator, dim, ratio, sigma=sigma, distribution=distribution, volume=volume
        )
        for length, one, split in zip(LENGTHS, row, theory, strict=True):
            rms = one.error["rms"]
            low, high = one.error["rms_ci95"]
            allowed = 4 / 1.96 * (high - low) / 2 + max(0.01, split.uncertainty) * rms
            assert abs(rms - split.total) <= allowed, (operator, length)


def test_the_parts_say_which_one_dominates():
    (smooth, _, _, coarse) = predicted(Operator("gradient"), 1, "1/4", [0.3, 0.1, 0.01, 1e-4])
    assert smooth.smoothing > 100 * smooth.discretisation
    (fine,) = predicted(Operator("gradient"), 1, "4/5", [1e-4])
    assert fine.discretisation > 100 * fine.smoothing
    (far,) = predicted(Operator("gradient"), 1, "4/5", [1e-16])
    assert far.rounding > far.discretisation
    assert coarse.rounding < 1e-10


def test_what_has_no_prediction_is_told():
    with pytest.raises(ValueError, match="divergence"):
        predicted(Operator("divergence"), 2, "1/2")
    with pytest.raises(ValueError, match="symmetric needs a target that is a particle"):
        predicted(
            Operator("gradient", "symmetric"), 1, "1/2", offset="1/3", sigma=0.1, volume="cell"
        )


# ------------------------------------------------------------------- any direction, any field

FATEHI_MANZARI = Operator("laplacian", "fatehi-manzari")
NESTED = Operator("laplacian", "nested")
OBLIQUE = {1: (-1.0,), 2: (0.6, -0.8), 3: (1.0, 2.0, -2.0)}
POLYNOMIALS = {
    1: {(0,): 0.5, (1,): 0.25, (2,): 0.375, (5,): -0.0625},
    2: {(0, 0): 0.75, (1, 0): 0.25, (0, 1): -0.5, (1, 1): 0.25, (2, 0): 0.5, (0, 3): 0.125},
    3: {(0, 0, 0): 0.75, (1, 0, 0): 0.25, (0, 1, 1): -0.5, (0, 0, 2): 0.5, (1, 2, 0): 0.125},
}


def fields(dim):
    return [sinusoid("1/20", OBLIQUE[dim], dim), polynomial(POLYNOMIALS[dim], dim)]


@pytest.mark.parametrize(
    ("dim", "kind", "ratio", "volume", "offset"),
    [
        (1, "uniform", "7/10", "constant", "1/5"),
        (1, "uniform", "7/10", "summation", 0),
        (2, "square", "7/10", "constant", 0),
        (2, "square", "7/10", "summation", 0),
        (2, "hexagonal", "3/5", "constant", "1/5"),
        (3, "cubic", "4/5", "constant", "1/7"),
        (3, "bcc", "4/5", "constant", 0),
        (3, "hcp", "4/5", "constant", 0),
    ],
)
def test_any_direction_and_any_polynomial_on_a_lattice(dim, kind, ratio, volume, offset):
    """Within the rounding of the measurement, rigorously bounded where volumes are constant, and
    that of the prediction: sums of Σ|w| <= 100 in 1/h^m of terms good to 10³ u."""
    shape = kernel("wendland-c4")
    scene = lattice(dim, kind, ratio, [Fraction(offset)] * dim, volume=volume)
    for operator, field in product(OPERATORS, fields(dim)):
        theory = predict_error(shape, operator, scene, field)
        one = measure(scene, shape, operator, field, bound=volume == "constant")
        rounding = 1e5 * 2.0**-53 / field.amplitude(operator.derivatives)
        allowed = rounding + (one.rounding_bound or rounding)
        assert allowed < 1e-9
        assert abs(one.error["rms"] - theory.total) <= allowed, (operator, field)
        assert theory.disorder == 0.0


@pytest.mark.parametrize(("dim", "kind"), [(1, "uniform"), (2, "hexagonal"), (3, "fcc")])
def test_a_polynomial_is_the_sum_of_its_moments(dim, kind):
    """Σ c_α (M_α − M_α^exact) of every component, from lattice sums of 50 digits, and the smoothing
    part from exact integrals; given as derivatives α! c_α it is the same."""
    shape, ratio = kernel("quintic-spline"), Fraction(7, 10)
    scene = lattice(dim, kind, ratio)
    terms = POLYNOMIALS[dim]
    derivatives = {a: c * prod(factorial(n) for n in a) for a, c in terms.items()}
    degree = max(map(sum, terms))
    for operator in [o for o in OPERATORS if o.derivatives]:
        keys = operator.needed(dim, degree)
        direct = lattice_sums(shape, keys, scene, False)
        integrals = {key: continuous_sum(shape, key) for key in keys}
        squares = {"whole": 0.0, "smooth": 0.0, "rest": 0.0}
        for axis in range(len(operator.components(dim))):
            target = operator.target(dim, axis)
            lattice_moments = operator.correct(direct, dim, degree, axis)
            limits = operator.correct(integrals, dim, degree, axis)
            whole = sum(c * float(lattice_moments[a] - target.get(a, 0)) for a, c in terms.items())
            smooth = sum(c * float(limits[a] - target.get(a, 0)) for a, c in terms.items())
            squares["whole"] += whole**2
            squares["smooth"] += smooth**2
            squares["rest"] += (whole - smooth) ** 2
        found = predict_error(shape, operator, scene, derivatives)
        scale = polynomial(terms, dim).amplitude(operator.derivatives)
        assert found == predict_error(shape, operator, scene, polynomial(terms, dim))
        rounding = 1e5 * 2.0**-53 / scale
        assert abs(found.total - sqrt(squares["whole"]) / scale) <= rounding
        assert abs(found.smoothing - sqrt(squares["smooth"]) / scale) <= rounding
        assert abs(found.discretisation - sqrt(squares["rest"]) / scale) <= rounding


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_smoothing_part_does_not_depend_on_the_direction(dim):
    """Kernels are isotropic: only the components of a Hessian i <= j are weighted unevenly."""
    for operator in [o for o in OPERATORS if o.name != "hessian"]:
        (ahead,) = predicted(operator, dim, "1/2", [0.1])
        (oblique,) = predicted(operator, dim, "1/2", [0.1], along=OBLIQUE[dim])
        assert abs(ahead.smoothing - oblique.smoothing) <= 1e3 * 2.0**-53


@pytest.mark.parametrize("dim", [2, 3])
def test_a_hessian_tends_to_its_turned_limit(dim):
    """∂ᵢ∂ⱼ of e^{ik·s} is −kᵢ kⱼ F(k) e^{ik·s}: the error of the components i <= j together."""
    (found,) = predicted(Operator("hessian"), dim, "1/2", [0.1], along=OBLIQUE[dim])
    n = [x / sqrt(sum(y * y for y in OBLIQUE[dim])) for x in OBLIQUE[dim]]
    size = sqrt(sum((n[i] * n[j]) ** 2 for i in range(dim) for j in range(i, dim)))
    exact = float(smoothing_error(SHAPE, 2 * pi * 0.1, dim)) * size / sqrt(2)
    assert abs(found.smoothing - exact) <= 1e-12


def within(scene, operator, field, targets, beyond=0.0):
    """Whether measured = predicted to 4 standard errors, what the prediction says that it is good
    to, and `beyond` relative to the error."""
    theory = predict_error("wendland-c4", operator, scene, field)
    error = measure(scene, "wendland-c4", operator, field, targets=targets, workers=1).error
    low, high = error["rms_ci95"]
    assert theory.disorder > 0
    allowed = 4 * (high - low) / (2 * 1.96) + (theory.uncertainty + beyond) * error["rms"]
    return abs(error["rms"] - theory.total) <= allowed


@pytest.mark.parametrize(
    ("dim", "kind", "ratio", "distribution", "targets"),
    [
        (1, "uniform", "7/10", "uniform", 8000),
        (2, "hexagonal", "3/5", "gaussian", 4000),
        (3, "bcc", "4/5", "gaussian", 1500),
    ],
)
def test_any_direction_and_any_polynomial_in_disorder(dim, kind, ratio, distribution, targets):
    """Within 4 standard errors, and what is said of a sampled prediction."""
    scene = jittered(lattice(dim, kind, ratio), 0.05, distribution, seed=3)
    for operator, field in product(OPERATORS, fields(dim)):
        assert within(scene, operator, field, targets), (operator, field)


@pytest.mark.parametrize(
    ("volume", "sigma", "distribution"),
    [("cell", 0.05, "gaussian"), ("cell", 0.05, "uniform"), ("summation", 0.03, "gaussian")],
)
def test_volumes_that_vary_in_1d(volume, sigma, distribution):
    """In 1D at Δx/h = 0.7 within 4 standard errors, for every operator."""
    scene = jittered(lattice(1, "uniform", "7/10", volume=volume), sigma, distribution, seed=3)
    for operator, field in product(OPERATORS, fields(1)):
        assert within(scene, operator, field, 8000), (operator, field)


@pytest.mark.parametrize(
    ("dim", "kind", "ratio", "volume", "distribution"),
    [
        (2, "square", "7/10", "constant", "blue"),
        (2, "square", "7/10", "summation", "gaussian"),
        (3, "cubic", "4/5", "summation", "gaussian"),
    ],
)
def test_volumes_that_vary_in_space(dim, kind, ratio, volume, distribution):
    scene = jittered(lattice(dim, kind, ratio, volume=volume), 0.1, distribution, seed=3)
    wave = fields(dim)[0]
    for operator in [o for o in OPERATORS if o.name == "gradient" and o.correction != "rkpm-2"]:
        assert within(scene, operator, wave, 120 if dim == 3 else 600), operator


@pytest.mark.parametrize("sigma", [0.05, 0.2])
@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_second_neighbours_and_corrections_at_displacements_of_any_size(sigma, distribution):
    """In 1D at Δx/h = 0.7, where neighbours are few: the nested form, RKPM and Fatehi–Manzari."""
    scene = jittered(lattice(1, None, "7/10", extent=2**20), sigma, distribution)
    operators = [NESTED, FATEHI_MANZARI, *(o for o in OPERATORS if "rkpm" in o.correction)]
    table = waves(scene, SHAPE, operators, [0.05], targets=20000)
    for operator, (one,) in zip(operators, table, strict=True):
        (split,) = predicted(operator, 1, "7/10", [0.05], sigma=sigma, distribution=distribution)
        low, high = one.error["rms_ci95"]
        sampling = 4 * (high - low) / (2 * 1.96) / split.total
        assert abs(one.error["rms"] / split.total - 1) <= split.uncertainty + sampling, operator
        assert split.uncertainty < 0.1
