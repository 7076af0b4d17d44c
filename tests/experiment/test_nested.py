"""The nested form, the gradient of the gradient, against double sums by hand: in fractions on a
line, in 40 digits on lattices in the plane and in space, built from their own basis vectors."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb, factorial, sqrt
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, workdps
from numpy.polynomial.hermite_e import hermeval
from oracle import mass, mean_value, shape_of, sites
from sympy import Rational, log

from sphtrunc import derive, kernel
from sphtrunc.cli import group
from sphtrunc.experiment.fields import Values, field, sinusoid
from sphtrunc.experiment.matrices import weights
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.one_pass import estimates
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.kernels.catalogue import names
from sphtrunc.kernels.transform import smoothing_error
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.particles import particles
from sphtrunc.theory.disorder.prediction import predict
from sphtrunc.theory.field_error import predict_waves

U = 2.0**-53
NESTED = Operator("laplacian", "nested")
SMOOTH = [n for n in names() if kernel(n).smoothness >= 1]


# ------------------------------------------------------------------- by hand, in fractions, 1D


def slope_of(name: str) -> Any:
    """x -> Ŵ′(x) in fractions, the mean of both sides at a knot; 0 at the origin."""
    shape = shape_of(kernel(name))
    sigma = 1 / mass(shape)
    return cache(lambda x: sigma * mean_value(shape, x, 1))


def by_hand(
    slope: Any, x: list[Fraction], volume: list[Fraction], a: Any, csph: bool, degree: int
) -> list[Fraction]:
    """⟨⟨A′⟩′⟩ of A = (x − x_a)^k, k <= degree: −Σ_b V_b (⟨A′⟩_b − ⟨A′⟩_a) Ŵ′(x_b − x_a), both
    gradients divided by their first moment if csph; lengths in units of h."""
    support = next(k for k in range(1, 99) if slope(Fraction(k)) == 0)

    @cache
    def row(at: Fraction) -> dict[int, Fraction]:
        near = {
            i: -v * slope(y - at)
            for i, (y, v) in enumerate(zip(x, volume, strict=True))
            if abs(y - at) < support
        }
        first = sum(w * (x[i] - at) for i, w in near.items()) if csph else 1
        return {i: w / first for i, w in near.items()}

    def gradient(at: Fraction, values: list[Fraction], own: Fraction) -> Fraction:
        return sum((w * (values[i] - own) for i, w in row(at).items()), Fraction(0))

    result = []
    for k in range(degree + 1):
        values = [(y - a) ** k for y in x]
        inner = [
            gradient(y, values, v) if abs(y - a) < support else Fraction(0)
            for y, v in zip(x, values, strict=True)
        ]
        own = Fraction(1 if k == 0 else 0)
        result.append(gradient(a, inner, gradient(a, values, own)))
    return result


@settings(max_examples=30)
@given(
    st.sampled_from(SMOOTH),
    st.fractions(Fraction(1, 5), Fraction(9, 10), max_denominator=30),
    st.sampled_from([Fraction(0), Fraction(1, 2), Fraction(2, 7)]),
    st.booleans(),
)
def test_what_is_derived_is_the_double_sum(
    name: str, ratio: Fraction, offset: Fraction, csph: bool
) -> None:
    """Exactly, on a lattice in 1D seen from a particle and from beside one."""
    reach = 2 * int(kernel(name).support / ratio) + 3
    x = [(j + offset) * ratio for j in range(-reach, reach + 1)]
    hand = by_hand(slope_of(name), x, [ratio] * len(x), Fraction(0), csph, 4)
    correction = "csph" if csph else "none"
    for operator in ("laplacian", "hessian"):
        found = derive(
            name,
            operator,
            form="nested",
            correction=correction,
            degree=4,
            dx_over_h=ratio,
            offset=offset,
        ).discrete
        assert found is not None
        assert [Fraction(str(found[k])) for k in range(5)] == hand


def line(n: int, seed: int) -> tuple[list[Fraction], list[Fraction]]:
    """n particles on a line at irregular places, with volumes of their own."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.2, 0.6, n))
    return [Fraction(float(v)) for v in x], [Fraction(float(v)) for v in rng.uniform(0.3, 0.5, n)]


@pytest.mark.parametrize("correction", ["none", "csph"])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c4", "polynomial:4"])
def test_what_is_measured_is_the_double_sum(name: str, correction: str) -> None:
    """Explicit particles: within the bound, in sixty digits to the last of a float."""
    x, volume = line(40, 1)
    scene = particles([float(v) for v in x], h=1.0, volume=[float(v) for v in volume])
    targets = [12, 20]
    operator = Operator("laplacian", "nested", correction)
    bounded = measure(scene, name, operator, moments=4, targets=targets, bound=True)
    exact = measure(scene, name, operator, moments=4, targets=targets, precision="exact")
    assert bounded.moment_bound is not None
    slope = slope_of(name)
    for t, a in enumerate(targets):
        hand = by_hand(slope, x, volume, x[a], correction == "csph", 4)
        for k, value in enumerate(hand):
            gap = abs(Fraction(float(bounded.moments[k,][t])) - value)
            assert gap <= Fraction(float(bounded.moment_bound[k,][t]))
            gap = abs(Fraction(float(exact.moments[k,][t])) - value)
            assert gap <= Fraction(U) * abs(value) + Fraction(1, 10**50)


def test_displaced_particles_are_the_same_seen_from_anywhere() -> None:
    """Jittered in 1D: the double sum over the displacements themselves, from a particle and from
    beside one, for cells as well."""
    slope = slope_of("cubic-spline")
    ratio = Fraction(2, 5)
    for offset, rule in ((Fraction(0), "constant"), (Fraction(1, 3), "constant"), (0, "cell")):
        scene = jittered(lattice(1, None, ratio, offset, volume=rule, extent=100), 0.1, seed=3)
        (target,) = (7,)
        sites = np.arange(target - 20, target + 21)
        u = [Fraction(float(v)) for v in scene.displacement(sites[None])[0]]
        x = [(int(j) - target + offset + v) * ratio for j, v in zip(sites, u, strict=True)]
        a = x[20] if offset == 0 else Fraction(0)
        volume = [ratio] * len(x)
        if rule == "cell":
            volume = [ratio, *((r - p) / 2 for p, r in zip(x, x[2:], strict=False)), ratio]
        hand = by_hand(slope, x, volume, a, False, 3)
        found = measure(scene, "cubic-spline", NESTED, moments=3, targets=[target], bound=True)
        assert found.moment_bound is not None
        for k, value in enumerate(hand):
            gap = abs(Fraction(float(found.moments[k,][0])) - value)
            assert gap <= Fraction(float(found.moment_bound[k,][0]))


# --------------------------------------------------------------- by hand, in 40 digits, 2D and 3D


@pytest.mark.parametrize(
    ("kind", "ratio", "shift"),
    [
        ("hexagonal", Fraction(7, 10), (Fraction(0), Fraction(0))),
        ("hexagonal", Fraction(7, 10), (Fraction(1, 3), Fraction(-1, 5))),
        ("bcc", Fraction(1), (Fraction(1, 4), Fraction(0), Fraction(1, 7))),
        ("hcp", Fraction(1), (Fraction(0), Fraction(0), Fraction(0))),
        ("hcp", Fraction(1), (Fraction(1, 4), Fraction(1, 5), Fraction(-1, 3))),
    ],
)
def test_lattices_in_space(kind: str, ratio: Fraction, shift: tuple[Fraction, ...]) -> None:
    """Derived to 28 digits and measured within the bound, for Ŵ ∝ (4 − q²)⁵."""
    dim = len(shift)
    with workdps(40):
        # ∫ (4 − q²)⁵ d^d x by Beta functions: S_d 2^{10+d} B(d/2, 6)/2
        sphere = 2 * mp.pi ** (mp.mpf(dim) / 2) / mp.gamma(mp.mpf(dim) / 2)
        sigma = 2 / (sphere * mp.mpf(2) ** (10 + dim) * mp.beta(mp.mpf(dim) / 2, 6))
        step = mp.mpf(ratio.numerator) / ratio.denominator
        theta = [mp.mpf(o.numerator) / o.denominator for o in shift]
        volume = step**dim
        lengths = mp.sqrt(mp.fsum(t * t for t in theta))
        x = [
            [step * (v + t) for v, t in zip(place, theta, strict=True)]
            for place in sites(kind, 4 / step + lengths)
        ]

        def gradient(at: list[Any]) -> list[tuple[list[Any], list[Any]]]:
            """Neighbours and −V ∂Ŵ(s) = 10 V σ s (4 − s²)⁴ for each."""
            rows = []
            for other in x:
                s = [p - q for p, q in zip(other, at, strict=True)]
                inner = 4 - mp.fsum(v * v for v in s)
                if inner > 0:
                    factor = 10 * volume * sigma * inner**4
                    rows.append((other, [factor * v for v in s]))
            return rows

        origin = [mp.zero] * dim
        outer = gradient(origin)
        seen = [gradient(b) for b, _ in outer]

        def twice(power: tuple[int, ...], i: int, j: int) -> Any:
            def value(p: list[Any]) -> Any:
                return mp.fprod(v**n for v, n in zip(p, power, strict=True))

            def inner(at: list[Any], rows: list[tuple[list[Any], list[Any]]]) -> Any:
                own = value(at)
                return mp.fsum(w[j] * (value(p) - own) for p, w in rows)

            here = inner(origin, outer)
            return mp.fsum(
                w[i] * (inner(b, rows) - here) for (b, w), rows in zip(outer, seen, strict=True)
            )

        powers = [
            (2, *(0,) * (dim - 1)),
            (1, 1, *(0,) * (dim - 2)),
            *([(1, 0), (2, 1)] if dim == 2 else [(2, 1, 0), (1, 0, 0)]),
        ]
        scene = lattice(dim, kind, ratio, list(shift))
        derived = derive(
            "polynomial:4",
            "laplacian",
            form="nested",
            dim=dim,
            degree=3,
            dx_over_h=ratio,
            offset=list(shift),
            lattice=kind,
        ).discrete
        assert derived is not None
        found = measure(scene, "polynomial:4", NESTED, moments=3, bound=True)
        bounds: Any = found.moment_bound
        for power in powers:
            hand = mp.fsum(twice(power, i, i) for i in range(dim))
            exact = mp.mpf(str(derived[power].evalf(35))) if derived[power] else mp.zero
            assert abs(exact - hand) <= mp.mpf(10) ** -28
            gap = abs(mp.mpf(float(found.moments[power][0])) - hand)
            assert gap <= float(bounds[power][0])


# --------------------------------------------------------------------------- smoothing and orders


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "polynomial:4", "gaussian"])
def test_twice_the_smoothing_error_of_the_direct_form(name: str, dim: int) -> None:
    """F(k)² against F(k): 2 c₁ R₂, and at the next order 2 c₂ R₄ + (c₁ R₂)²."""
    twice = derive(name, "laplacian", form="nested", dim=dim, degree=6).smoothing_error
    once = derive(name, "laplacian", dim=dim, degree=6).smoothing_error
    assert [row[:2] for row in twice] == [(4, 2), (6, 4)]
    assert twice[0][2] == 2 * once[0][2]
    assert twice[1][2] == 2 * once[1][2] + once[0][2] ** 2


def test_the_limit_of_a_hessian_is_the_hessian() -> None:
    limit = derive("wendland-c4", "hessian", form="nested", dim=3, degree=3).limit
    assert all(error == 0 for error in limit.error.values())


@pytest.mark.parametrize(
    ("correction", "order"), [("none", 2), ("shepard", 2), ("csph", 2), ("rkpm-2", 4)]
)
def test_smoothing_orders(correction: str, order: int) -> None:
    for dim in (1, 2, 3):
        found = derive("quintic-spline", "laplacian", form="nested", correction=correction, dim=dim)
        assert found.orders.smoothing == order


@pytest.mark.parametrize("offset", [Fraction(0), Fraction(1, 7)])
@pytest.mark.parametrize("beta", [2, 3])
def test_discretisation_orders_are_attained_and_not_exceeded(beta: int, offset: Fraction) -> None:
    """Along ratios of one phase the exact error of M_2 falls with the order derived."""
    shape = kernel(f"polynomial:{beta}")

    def steepness(numbers: tuple[int, int], step: Any) -> float:
        errors = [
            derive(
                shape, "laplacian", form="nested", degree=2, dx_over_h=step(n), offset=offset
            ).discretisation[2]
            for n in numbers
        ]
        first, last = step(numbers[0]), step(numbers[1])
        return float(log(abs(float(errors[0] / errors[1]))) / log(float(first / last)))

    orders = derive(shape, "laplacian", form="nested", degree=2, offset=offset).orders
    generic = steepness((40, 400), lambda n: Rational(4 * 7, 7 * n + 2))
    assert orders.generic is not None
    assert orders.generic - 0.1 < generic < orders.generic + 0.1
    if offset == 0:
        return
    assert orders.generic == beta + 1


@pytest.mark.parametrize(("dim", "ratio"), [(1, "1/10"), (2, "1/6")])
def test_second_order_in_h_and_no_more(dim: int, ratio: str) -> None:
    """On a lattice so fine that smoothing is all that is left."""
    rms = [
        measure(lattice(dim, None, ratio), "quintic-spline", NESTED, sinusoid(x, dim=dim)).error
        for x in ("1/40", "1/80")
    ]
    assert rms[0] is not None
    assert rms[1] is not None
    slope = np.log2(rms[0]["rms"] / rms[1]["rms"])
    assert 1.95 < slope < 2.05


# ---------------------------------------------------------------------- one estimate, three ways


@pytest.mark.parametrize("mode", ["gather", "mean"])
@pytest.mark.parametrize("correction", ["none", "csph", "rkpm-1"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_pairs_passes_and_matrices_agree(dim: int, correction: str, mode: str) -> None:
    """Neighbour by neighbour, in two passes over all pairs, and as a product of matrices; h differs
    from particle to particle."""
    rng = np.random.default_rng(dim)
    x = rng.random((120, dim))
    values = np.sin(3.0 * x.sum(axis=1))
    h = {1: 0.1, 2: 0.2, 3: 0.3}[dim] * (1.0 + 0.2 * x[:, 0])
    scene = particles(x, h=h, volume=1 / 120, mode=mode)
    shape = kernel("wendland-c4")
    targets = [3, 50, 77]
    for name in ("laplacian", "hessian"):
        operator = Operator(name, "nested", correction)
        found = estimates(scene, shape, operator, values, targets=targets)
        alone = measure(scene, shape, operator, Values(values), moments=1, targets=targets)
        assert alone.flagged == 0
        assert not found.flagged.any()
        assert alone.estimates is not None
        for c, row in enumerate(operator.axes(dim)):
            matrix = weights(scene, shape, operator, axis=c, targets=targets)
            slopes = [weights(scene, shape, operator.gradient, axis=i) for i in range(dim)]
            size = sum(abs(slopes[i][targets]) @ (abs(slopes[j]) @ np.abs(values)) for i, j in row)
            # each way rounds a few times per pair; matrices of condition c lose as many digits
            loss = 1e3 * U * size * max(1.0, float(found.condition.max()))
            product_ = matrix @ values
            assert np.all(np.abs(found.values[0, c] / h[targets] ** 2 - product_) <= loss)
            assert np.all(np.abs(alone.estimates[c] - product_) <= loss)


SCENES: dict[str, Any] = {
    "displaced": jittered(lattice(2, "hexagonal", "3/5"), 0.1),
    "blue cells": jittered(lattice(1, None, "2/5", volume="cell"), 0.1, "blue"),
    "summation": jittered(lattice(1, None, "3/5", volume="summation"), 0.1),
    "graded": graded(lambda x: 0.4 + 0.1 * np.sin(x), np.linspace(0, 5, 9)),
    "lattice": lattice(3, "hcp", "9/10"),
    "offset": lattice(2, "square", "1/2", ["1/3", "1/5"]),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_many_wavelengths_are_one_by_one(scene: Any) -> None:
    operators = [NESTED, Operator("hessian", "nested", "csph")]
    targets = None if scene.population < 10 else 9
    table = waves(scene, "cubic-spline", operators, [0.03, 0.2], targets=targets)
    for operator, row in zip(operators, table, strict=True):
        for length, found in zip((0.03, 0.2), row, strict=True):
            wave = sinusoid(length, dim=scene.dim)
            alone = measure(scene, "cubic-spline", operator, wave, targets=targets)
            assert np.array_equal(found.errors, alone.errors)  # type: ignore[arg-type]


def test_the_result_depends_on_no_block_and_no_thread() -> None:
    scene = SCENES["displaced"]
    wave = sinusoid("1/30", dim=2)
    many = measure(scene, "cubic-spline", NESTED, wave, moments=2, targets=np.arange(40), workers=2)
    for one in (0, 17, 39):
        alone = measure(scene, "cubic-spline", NESTED, wave, moments=2, targets=[one], workers=1)
        assert many.errors is not None
        assert alone.errors is not None
        assert many.errors[0, one] == alone.errors[0, 0]
        assert all(many.moments[a][one] == v[0] for a, v in alone.moments.values.items())


def test_a_polynomial_is_the_moments_of_its_series() -> None:
    """⟨∇²A⟩ = Σ c_α M_α."""
    scene = jittered(lattice(2, None, "1/2"), 0.1, seed=5)
    one = field("polynomial:2 x^2 - 3 x y + y^3 + 1", 2)
    found = measure(scene, "wendland-c4", NESTED, one, moments=3, targets=12, bound=False)
    assert found.estimates is not None
    m = found.moments
    series = 2 * m[2, 0] - 3 * m[1, 1] + m[0, 3]
    size = 2 * np.abs(m[2, 0]) + 3 * np.abs(m[1, 1]) + np.abs(m[0, 3]) + 100
    assert np.all(np.abs(found.estimates[0] - series) <= 100 * U * size)


def test_a_wide_bump_is_the_moments_of_its_series() -> None:
    """e^{−x²/2w²} by its derivatives at the target, He_n(x/w)/wⁿ, to the sixth; the next are below
    √7!/w⁷ (Cramér's bound of Hermite functions), over a reach of 4h along either axis."""
    scene = jittered(lattice(2, None, "1/2"), 0.1, seed=5)
    width, degree = 300.0, 6
    found = measure(scene, "wendland-c4", NESTED, field("bump:300", 2), moments=degree, targets=12)
    assert found.estimates is not None
    place = field("bump:300", 2).own(found.target, found.settings["seed"])

    def slope(n: int, x: Any) -> Any:
        return hermeval(x, [0] * n + [1]) * np.exp(-(x**2) / 2) / (-width) ** n

    series = sum(
        m * np.prod([slope(n, x) / factorial(n) for n, x in zip(alpha, place, strict=True)], axis=0)
        for alpha, m in found.moments.values.items()
    )
    weights_of_a_laplacian = 100  # Σ|w|, in 1/h²
    rest = weights_of_a_laplacian * (8 / width) ** 7 / sqrt(factorial(7))
    assert rest < 1e-5 * np.abs(series).max()
    assert np.all(np.abs(found.estimates[0] - series) <= rest + 1000 * U)


def test_a_neighbour_without_neighbours_is_flagged() -> None:
    """A correction is needed at the neighbours too; a lone pair on a line has no second axis."""
    x = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.4], [0.1, 0.5], [1.95, 0.0]])
    scene = particles(x, h=0.75, volume=0.25)
    operator = Operator("laplacian", "nested", "rkpm-1")
    values = x[:, 0] ** 2
    found = measure(scene, "cubic-spline", operator, Values(values))
    passes = estimates(scene, kernel("cubic-spline"), operator, values)
    # the last has one neighbour beside itself, the second; they are the two
    assert passes.flagged.tolist() == [False, True, False, False, True]
    assert found.flagged == 2
    assert found.first_flagged == (1, 4)


# ------------------------------------------------------------------------------------- prediction


@pytest.mark.parametrize(
    ("kind", "ratio", "offset"),
    [
        ("uniform", "7/10", ("0",)),
        ("uniform", "2/5", ("1/3",)),
        ("hexagonal", "3/5", ("1/3", "1/5")),
        ("hcp", "4/5", ("0", "0", "0")),
    ],
)
def test_a_sinusoid_is_predicted_on_lattices(
    kind: str, ratio: str, offset: tuple[str, ...]
) -> None:
    """The response K_i K_j, from particles and from beside them, one and two to a cell."""
    dim = len(offset)
    scene = lattice(dim, kind, ratio, list(offset))
    lengths = (0.02, 0.3)
    for operator in (
        NESTED,
        Operator("hessian", "nested"),
        Operator("laplacian", "nested", "csph"),
    ):
        (row,) = waves(scene, "wendland-c4", [operator], lengths)
        theory = predict_waves(kernel("wendland-c4"), operator, scene, lengths)
        for length, one, split in zip(lengths, row, theory, strict=True):
            # Σ|w| <= 100/h² and a few roundings, relative to k²
            rounding = 1e3 * U * 100 / min(1.0, 2 * np.pi * length) ** 2
            assert one.error is not None
            assert abs(one.error["rms"] - split.total) <= rounding
            assert split.disorder == 0.0


def test_the_smoothing_part_is_one_less_the_square_of_the_transform() -> None:
    shape = kernel("wendland-c2")
    for dim in (1, 2, 3):
        one_less = smoothing_error(shape, [2 * np.pi * 0.1], dim)
        scene = lattice(dim, None, "1/2")
        (split,) = predict_waves(shape, NESTED, scene, [0.1])
        f = 1.0 - float(one_less[0])
        assert split.smoothing * np.sqrt(2.0) == pytest.approx(1.0 - f * f, rel=1e-9)


@pytest.mark.parametrize(
    ("ratio", "sigma", "distribution", "rule"),
    [
        ("2/5", 0.2, "gaussian", "constant"),
        ("1/2", 0.05, "blue", "constant"),
        ("2/5", 0.05, "uniform", "cell"),
    ],
)
def test_a_sinusoid_is_predicted_in_disorder(
    ratio: str, sigma: float, distribution: str, rule: str
) -> None:
    """Within 5 % or three standard errors, in 1D."""
    scene = jittered(lattice(1, None, ratio, volume=rule), sigma, distribution)
    lengths = (0.02, 0.1)
    operators = [NESTED, Operator("laplacian", "nested", "csph")]
    table = waves(scene, "wendland-c4", operators, lengths, targets=4000)
    for operator, row in zip(operators, table, strict=True):
        theory = predict_waves(kernel("wendland-c4"), operator, scene, lengths)
        for one, split in zip(row, theory, strict=True):
            assert one.error is not None
            low, high = one.error["rms_ci95"]
            allowed = max(0.05 * one.error["rms"], 3 / 1.96 * (high - low) / 2)
            assert abs(one.error["rms"] - split.total) <= allowed


@pytest.mark.parametrize(
    ("kind", "ratio", "correction", "sigma", "targets"),
    [
        ("square", "3/5", "none", 0.05, 1500),
        ("square", "3/5", "csph", 0.1, 1500),
        ("hexagonal", "1/2", "none", 0.1, 1000),
        ("cubic", "7/10", "none", 0.1, 300),
        ("cubic", "7/10", "csph", 0.1, 300),
    ],
)
def test_the_mean_in_disorder_is_not_that_of_the_lattice(
    kind: str, ratio: str, correction: str, sigma: float, targets: int
) -> None:
    """M_(2,0) and M_(0,2) within 4 standard errors, of which the lattice is farther."""
    dim = 3 if kind == "cubic" else 2
    scene = jittered(lattice(dim, kind, ratio), sigma)
    shape, operator = kernel("wendland-c4"), Operator("laplacian", "nested", correction)
    moments = measure(scene, shape, operator, moments=2, targets=targets).moments
    still, moved = (predict(shape, operator, s, degree=2) for s in (scene.lattice, scene))
    away = []
    for alpha in (unit(dim, 0, 2), unit(dim, 1, 2)):
        error = moments[alpha].std() / targets**0.5
        assert abs(moments[alpha].mean() - moved.mean[alpha]) <= 4 * error
        away.append(abs(moments[alpha].mean() - still.mean[alpha]) / error)
    assert max(away) > (2 if dim == 3 else 5)
    assert moved.how.startswith("averages over sampled displacements")


# ------------------------------------------------------------------------------ the command line


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--operator", "gradient", "--form", "nested"], "expected one of standard"),
        (["--operator", "value", "--form", "nested"], "expected one of standard"),
        (["--operator", "laplacian", "--form", "brookshaw", "--correction", "csph"], "csph"),
    ],
)
def test_wrong_combinations_say_so(arguments: list[str], says: str) -> None:
    for command in ("measure", "derive"):
        options = [command, "-k", "cubic-spline", "--dx-over-h", "1/2", *arguments]
        done = CliRunner().invoke(group, options)
        assert isinstance(done.exception, ValueError)
        assert says in str(done.exception)


def test_moments_of_two_passes_are_refused() -> None:
    scene = particles(np.arange(9.0), h=1.2, volume=1.0)
    with pytest.raises(ValueError, match="nested"):
        estimates(scene, kernel("cubic-spline"), NESTED, np.arange(9.0), degree=2)


def test_the_binomials_of_the_composition() -> None:
    """On one lattice seen from a particle M_α = Σ C(α, β) M_β M_{α−β}, with gradients twice."""
    once = derive("cubic-spline", degree=5, dx_over_h="2/5").discrete
    twice = derive("cubic-spline", "laplacian", form="nested", dx_over_h="2/5").discrete
    assert once is not None
    assert twice is not None
    for k in range(6):
        assert twice[k] == sum(comb(k, j) * once[j] * once[k - j] for j in range(k + 1))
