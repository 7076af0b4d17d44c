"""The heart: what is measured on particles less what is derived, over all that both can do.

On a lattice the difference stays within the computed rounding bound of the measurement; on
displaced particles within 4 standard errors. Theory and experiment share the definition of the
operators and of the lattices, and nothing else: exact or 50-digit sums by shells on one side,
floating-point sums over stencils on the other. The lattices have an oracle of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mpmath import mp, workdps
from oracle import CRYSTALS, monomial, normalised, number, shape_of, sites, terms
from strategies import operators

from sphtrunc import derive, kernel
from sphtrunc.experiment.fields import Bump, sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.kernels.catalogue import names
from sphtrunc.kernels.transform import smoothing_error
from sphtrunc.operators.moments import Moments, multi_indices
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.sites import KINDS
from sphtrunc.study.comparison import compare, predict_error
from sphtrunc.theory.lattice_sums import lattice_moments, lattice_sums

UNIT = 2.0**-53
DEEP = settings().max_examples if settings().max_examples > 1000 else None

#: drawn at random: every family, smooth or not; the rest of the catalogue is visited once each
SMOOTH = [
    *("cubic-spline", "quartic-spline", "quintic-spline", "wendland-c2", "wendland-c4"),
    *("wendland-c6-1d", "polynomial:0", "polynomial:1", "polynomial:4", "core-triangle"),
    *("linear-quartic", "spiky"),
]
SHAPES = {n: kernel(n) for n in SMOOTH}
SECOND = [n for n in SMOOTH if SHAPES[n].smoothness >= 1]

PLAIN = [
    Operator("value"),
    Operator("value", "difference"),
    Operator("gradient"),
    Operator("gradient", "difference"),
    Operator("gradient", "symmetric"),
]
LAPLACIANS = [
    Operator("laplacian", "difference"),
    Operator("laplacian", "brookshaw"),
    Operator("hessian", "difference"),
]
CORRECTED = [
    *(Operator("value", "standard", c) for c in ("shepard", "rkpm-1", "rkpm-2")),
    *(Operator("gradient", f, c) for f in ("standard", "difference") for c in ("shepard", "csph")),
    *(Operator("gradient", "standard", c) for c in ("csph-shepard", "rkpm-1", "rkpm-2")),
    Operator("laplacian", "difference", "rkpm-2"),
    Operator("laplacian", "fatehi-manzari"),
]
NESTED = [
    *(Operator("laplacian", "nested", c) for c in ("none", "csph")),
    *(Operator("hessian", "nested", c) for c in ("none", "shepard")),
]


def examples(count: int, of: Sequence[Operator] = (Operator(),)) -> settings:
    """`count` cases in CI, more in the deep profile; in an example a case for every operator `of`
    what is drawn, since the sites of a lattice cost more than a sum over them."""
    return settings(max_examples=(DEEP or count) // len(of))


def kinds(dim: int) -> list[str]:
    return [name for name, data in KINDS.items() if data.dim == dim]


@st.composite
def scenes(
    draw: st.DrawFn,
    low: dict[int, Fraction],
    high: Fraction,
    dims: tuple[int, ...] = (1, 1, 2, 2, 3),
) -> Any:
    """A lattice that is not too fine, seen from a particle or from beside it."""
    dim = draw(st.sampled_from(dims))
    kind = draw(st.sampled_from(kinds(dim)))
    ratio = draw(st.fractions(low[dim], high, max_denominator=48))
    offset: Any = 0
    if draw(st.booleans()):
        axis = st.fractions(Fraction(-1, 2), Fraction(1, 2), max_denominator=12)
        offset = [draw(axis) for _ in range(dim)]
    return lattice(dim, kind, ratio, offset if dim > 1 or not offset else offset[0])


LOW = {1: Fraction(1, 8), 2: Fraction(2, 5), 3: Fraction(3, 5)}


def assert_within_bound(scene: Any, shape: Any, operator: Operator, degree: int) -> Any:
    """measured − derived, in 50 digits, against the bound of the measurement, which is returned."""
    derived = lattice_moments(shape, operator, scene, degree, exact=False)
    found = measure(scene, shape, operator, moments=degree, bound=True, workers=1)
    bounds: Any = found.moment_bound
    for alpha in multi_indices(scene.dim, degree):
        value = found.moments[alpha]
        assert value.size == 1
        difference = abs(derived[alpha] - float(value[0]))
        assert difference <= float(bounds[alpha][0]), (alpha, float(difference))
    return found


# ------------------------------------------------------------------ the lattices, by themselves


@pytest.mark.parametrize("beside", [False, True], ids=["a particle", "beside"])
@pytest.mark.parametrize("kind", CRYSTALS)
def test_every_lattice_is_the_crystal_that_it_is_called(kind: str, beside: bool) -> None:
    """Derived and measured moments against sums over the sites of the unit cell, turned as they
    are: what theory and experiment share, the list of sites, would agree with itself."""
    dim = CRYSTALS[kind]
    name, ratio = "wendland-c4", Fraction(4, 5)
    offset = [Fraction(i + 1, 7 + 2 * i) * beside for i in range(dim)]
    scene = lattice(dim, kind, ratio, offset if dim > 1 else offset[0])
    shape = shape_of(SHAPES[name])
    with workdps(40):
        term, sigma, step = terms(shape), normalised(shape, dim), number(ratio)
        places = [
            [step * x for x in site] for site in sites(kind, number(shape.knots[-1]) / step, offset)
        ]
        for operator in (
            *(Operator("value"), Operator("gradient"), Operator("laplacian")),
            Operator("laplacian", "brookshaw"),
        ):
            row = operator.components(dim)[0]
            factors: dict[Any, int] = dict.fromkeys(row, 1)
            if operator.form == "brookshaw":
                factors = {"brookshaw": 2}
            weights = [
                sigma * step**dim * mp.fsum(c * term(mu, s) for mu, c in factors.items())
                for s in places
            ]
            derived: Any = derive(
                name, operator, degree=3, dim=dim, lattice=kind, dx_over_h=ratio, offset=offset
            ).discrete
            found = measure(scene, name, operator, moments=3, bound=True, workers=1)
            bounds: Any = found.moment_bound
            for alpha in multi_indices(dim, 3):
                summands = [w * monomial(s, alpha) for w, s in zip(weights, places, strict=True)]
                truth = mp.fsum(summands) * (operator.form != "brookshaw" or any(alpha))
                size = mp.fsum(abs(x) for x in summands)
                assert abs(mp.mpf(str(derived.values[alpha])) - truth) <= 1e-27 * size
                assert abs(float(found.moments[alpha][0]) - truth) <= float(bounds[alpha][0])


def test_every_lattice_is_among_them() -> None:
    assert set(CRYSTALS) == set(KINDS)


# ------------------------------------------------------------------------------------- lattices


@examples(6500, of=PLAIN)
@given(scenes(LOW, Fraction(11, 10)), st.sampled_from(SMOOTH), st.integers(0, 3))
@example(lattice(1, "uniform", "1/8"), "cubic-spline", 0)  # a gradient that is zero by symmetry
def test_uncorrected_sums_on_every_lattice(scene: Any, name: str, degree: int) -> None:
    for operator in PLAIN:
        assert_within_bound(scene, SHAPES[name], operator, degree)


@examples(1800, of=LAPLACIANS)
@given(scenes(LOW, Fraction(9, 10)), st.sampled_from(SECOND), st.integers(2, 3))
def test_second_derivatives_on_every_lattice(scene: Any, name: str, degree: int) -> None:
    for operator in LAPLACIANS:
        assert_within_bound(scene, SHAPES[name], operator, degree)


@examples(900)
@given(
    scenes(
        {1: Fraction(1, 5), 2: Fraction(1, 2), 3: Fraction(4, 5)}, Fraction(9, 10), (1, 1, 1, 2)
    ),
    st.sampled_from(
        ["cubic-spline", "quintic-spline", "wendland-c2", "wendland-c4", "polynomial:4"]
    ),
    st.sampled_from(CORRECTED),
)
def test_corrections_on_lattices(scene: Any, name: str, operator: Operator) -> None:
    """And the bound is not wide: a matrix is solved with a bound from the residual, whatever that
    is, and 10⁵ u times the condition is too much."""
    found = assert_within_bound(scene, SHAPES[name], operator, 2)
    condition = max(1.0, float(found.condition.max()))
    for alpha, bound in found.moment_bound.items():
        assert bound[0] <= 1e5 * UNIT * condition * max(1.0, abs(found.moments[alpha][0]))


@examples(150)
@given(
    scenes({1: Fraction(1, 6), 2: Fraction(2, 5), 3: Fraction(7, 10)}, Fraction(9, 10)),
    st.sampled_from(["cubic-spline", "quintic-spline", "wendland-c2", "wendland-c4"]),
    st.sampled_from(NESTED),
)
def test_gradients_of_gradients_on_every_lattice(scene: Any, name: str, operator: Operator) -> None:
    assert_within_bound(scene, SHAPES[name], operator, 3)


@pytest.mark.parametrize("name", names())
def test_every_kernel_of_the_catalogue(name: str) -> None:
    dim = 1 + len(name) % 3
    shape = kernel(name)
    ratio = max(LOW[dim], Fraction(int(shape.support.p), int(5 * shape.support.q)))
    scene = lattice(dim, kinds(dim)[-1], ratio, [Fraction(i + 1, 7) for i in range(dim)])
    assert_within_bound(scene, shape, Operator(), 2)
    assert_within_bound(scene, shape, Operator("laplacian", "brookshaw"), 2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("operator", [CORRECTED[3], *CORRECTED[-3:], NESTED[1]], ids=str)
def test_corrections_on_every_kind_of_lattice(kind: str, operator: Operator) -> None:
    dim = KINDS[kind].dim
    scene = lattice(dim, kind, "4/5", [Fraction(i + 1, 9) for i in range(dim)])
    assert_within_bound(scene, SHAPES["wendland-c4"], operator, 2)


EVERY = [
    pytest.param(dim, operator, id=f"{dim}-{operator.name}-{operator.form}-{operator.correction}")
    for dim in (1, 2, 3)
    for operator in operators(dim)
    if (dim, operator.correction) != (3, "rkpm-3")  # a minute of exact elimination
]


@pytest.mark.parametrize(("dim", "operator"), EVERY)
def test_every_operator_in_every_dimension(dim: int, operator: Operator) -> None:
    """From a particle where neighbours have to lie in pairs, else from beside one."""
    kind = {1: "uniform", 2: "hexagonal", 3: "bcc"}[dim]
    offset = [Fraction(i + 1, 9) for i in range(dim)] if operator.form != "paired" else [0] * dim
    scene = lattice(dim, kind, "3/5" if dim == 1 else "4/5", offset if dim > 1 else offset[0])
    assert_within_bound(scene, SHAPES["wendland-c4"], operator, 4 - dim)


LINES = [*PLAIN[:4], *LAPLACIANS[:2]]


@examples(2600, of=LINES)
@given(
    st.sampled_from(SMOOTH),
    st.fractions(Fraction(1, 9), 1, max_denominator=48),
    st.fractions(Fraction(-1, 2), Fraction(1, 2), max_denominator=12),
)
def test_euler_maclaurin_is_the_sum_particle_by_particle(
    name: str, ratio: Fraction, offset: Fraction
) -> None:
    """In 1D two derivations and one measurement: exact fractions, and within the rounding bound."""
    scene = lattice(1, "uniform", ratio, offset)
    chosen = LINES if SHAPES[name].smoothness >= 1 else PLAIN[:4]
    keys = dict.fromkeys(key for operator in chosen for key in operator.needed(1, 3))
    sums = lattice_sums(SHAPES[name], keys, scene)
    for operator in chosen:
        derived = derive(SHAPES[name], operator, degree=3, dx_over_h=ratio, offset=offset).discrete
        assert isinstance(derived, Moments)
        assert operator.correct(sums, 1, 3) == dict(derived.values)
        found = measure(scene, SHAPES[name], operator, moments=3, bound=True, workers=1)
        bounds: Any = found.moment_bound
        for alpha, exact in derived.values.items():
            difference = abs(Fraction(float(found.moments[alpha][0])) - Fraction(str(exact)))
            assert difference <= Fraction(float(bounds[alpha][0]))


# --------------------------------------------------------------------------------------- disorder


@st.composite
def disordered(draw: st.DrawFn) -> Any:
    dim = draw(st.sampled_from((1, 1, 1, 2, 3)))
    kind = draw(st.sampled_from(kinds(dim)))
    low = {1: Fraction(1, 4), 2: Fraction(1, 2), 3: Fraction(7, 10)}[dim]
    ratio = draw(st.fractions(low, Fraction(4, 5), max_denominator=24))
    volume = draw(st.sampled_from(("constant", "cell") if dim == 1 else ("constant",)))
    sigma = draw(st.sampled_from((0.01, 0.03, 0.05)))
    choices = ("gaussian", "uniform") if kind == "hcp" else ("gaussian", "uniform", "blue")
    distribution = draw(st.sampled_from(choices))
    seed = draw(st.integers(0, 2**40))
    return jittered(lattice(dim, kind, ratio, volume=volume), sigma, distribution, seed)


@examples(300)
@given(
    disordered(),
    st.sampled_from(["quintic-spline", "wendland-c4", "polynomial:4"]),
    st.sampled_from(
        [*PLAIN[1:5], CORRECTED[3], CORRECTED[6], CORRECTED[8], LAPLACIANS[1], CORRECTED[-1]]
    ),
)
def test_means_and_spreads_under_disorder(scene: Any, name: str, operator: Operator) -> None:
    assert_within_standard_errors(scene, name, operator, 2000)


@examples(12)
@given(
    disordered(),
    st.sampled_from(["quintic-spline", "wendland-c4", "polynomial:4"]),
    st.sampled_from([NESTED[0], NESTED[2]]),
)
def test_gradients_of_gradients_under_disorder(scene: Any, name: str, operator: Operator) -> None:
    targets = {1: 2000, 2: 300, 3: 100}[scene.dim]
    assert_within_standard_errors(scene, name, operator, targets)


def assert_within_standard_errors(scene: Any, name: str, operator: Operator, targets: int) -> None:
    """|mean − predicted| <= 4 std/√n, |std − predicted| <= 4 √((κ − 1)/4n) std, κ the kurtosis, and
    what a prediction that was sampled is said to be good to; where nothing is spread, rounding."""
    degree = max(2, operator.consistency + 1)  # up to its consistency nothing is spread
    found = compare(scene, SHAPES[name], operator, degree=degree, targets=targets)
    neighbours = found.measured.pairs / targets
    rounding = 8 * UNIT * neighbours * max(1.0, float(found.measured.condition.max()))
    for alpha, measured in found.measured.moments.values.items():
        std, known = found.predicted.std[alpha], found.predicted.uncertainty.get(alpha, 0.0)
        fourth = float(((measured - measured.mean()) ** 4).mean())
        kurtosis = max(3.0, fourth / max(float(measured.var()) ** 2, rounding**4))
        width = sqrt((kurtosis - 1) / (4 * targets))
        assert abs(found.difference[alpha]) <= 4 * std / sqrt(targets) + rounding
        assert abs(measured.std() - std) <= (4 * width + known) * std + rounding


@pytest.mark.parametrize(("dim", "kind"), [(1, "uniform"), (2, "hexagonal")])
def test_summation_volumes_under_disorder(dim: int, kind: str) -> None:
    scene = jittered(lattice(dim, kind, "7/10", volume="summation"), 0.03, seed=5)
    assert_within_standard_errors(scene, "wendland-c4", Operator(), 800)


# ------------------------------------------------------------------------- errors of whole fields


@pytest.mark.parametrize(
    "operator", [PLAIN[2], PLAIN[3], CORRECTED[4], Operator("laplacian", "brookshaw")], ids=str
)
@pytest.mark.parametrize(("dim", "kind"), [(1, "uniform"), (2, "hexagonal"), (3, "bcc")])
def test_error_of_a_sinusoid(operator: Operator, dim: int, kind: str) -> None:
    """Total rms error, on the lattice to rounding, on displaced particles to the sampling error."""
    field = sinusoid("1/20", None, dim)
    still = lattice(dim, kind, "4/5")
    theory = predict_error("wendland-c4", operator, still, field)
    found: Any = measure(still, "wendland-c4", operator, field).error
    assert found["rms"] == pytest.approx(theory.total, rel=1e-9)
    moved = jittered(still, 0.05, seed=3)
    theory = predict_error("wendland-c4", operator, moved, field)
    found = measure(moved, "wendland-c4", operator, field, targets=6000).error
    assert found["rms"] == pytest.approx(theory.total, rel=0.06)
    assert theory.disorder > 0


def test_parts_of_an_error() -> None:
    """Smoothing is 1 − F; on a fine lattice nothing else is left; derivatives at a point agree."""
    shape, k = kernel("wendland-c6"), 2 * np.pi / 50
    fine = lattice(1, "uniform", "1/40")
    parts = predict_error(shape, PLAIN[2], fine, sinusoid("1/50", None, 1))
    exact = float(smoothing_error(shape, k)) / sqrt(2)
    assert parts.smoothing == pytest.approx(exact, rel=1e-9)
    assert parts.total == pytest.approx(exact, rel=1e-7)
    assert parts.discretisation < 1e-6 * exact
    field = {(n,): k ** (n - 1) * (1, 0, -1, 0)[(n - 1) % 4] for n in range(1, 7)}  # sin at 0
    taylor = predict_error(shape, PLAIN[2], fine, field)
    assert taylor.total == pytest.approx(parts.total * sqrt(2), rel=1e-4)
    assert taylor.smoothing == pytest.approx(parts.smoothing * sqrt(2), rel=1e-4)
    moved = predict_error(shape, PLAIN[2], jittered(fine, 0.1), field)
    assert moved.disorder > 0
    assert moved.smoothing == taylor.smoothing


def test_what_there_is_no_theory_for_is_said() -> None:
    from sphtrunc.scenes.graded import graded

    scene = graded(lambda x: 0.3 + 0.0 * x)
    with pytest.raises(ValueError, match="for graded particles there is theory for polynomials"):
        compare(scene, "gaussian")
    with pytest.raises(ValueError, match="no prediction for bump"):
        predict_error("cubic-spline", PLAIN[2], lattice(1), Bump(2.0, 1))  # type: ignore[arg-type]


# ---------------------------------------------------------------- that these tests can fail at all


@pytest.mark.parametrize(
    "operator", [PLAIN[0], PLAIN[2], CORRECTED[3], LAPLACIANS[1], NESTED[0]], ids=str
)
def test_a_slightly_wrong_kernel_is_seen(operator: Operator) -> None:
    """One coefficient of the measured kernel changed by one part in 10¹²."""
    from sphtrunc import Kernel

    shape = kernel("wendland-c4")
    first = list(shape.coefficients()[0])
    first[4] = first[4] * (1 + Fraction(1, 10**12))
    wrong = Kernel(shape.knots, [first])
    scene = lattice(2, "hexagonal", "1/2", ["1/5", "1/7"])
    derived = lattice_moments(shape, operator, scene, 3, exact=False)
    found = measure(scene, wrong, operator, moments=3, bound=True)
    bounds: Any = found.moment_bound
    outside = [
        a for a, m in derived.items() if abs(m - float(found.moments[a][0])) > float(bounds[a][0])
    ]
    assert outside
