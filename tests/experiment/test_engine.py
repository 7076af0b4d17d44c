"""Pair engines against 50 digits, against each other, and against themselves in another order."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import mpmath
import numpy as np
import pytest
from mpmath import mp
from oracle import monomial, normalised, shape_of, terms

import sphtrunc
from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.experiment.engine import available, pair_sums
from sphtrunc.experiment.engine import tree as neighbours
from sphtrunc.experiment.matrices import weights
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.one_pass import estimates
from sphtrunc.operators.h_rules import RULES
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import BROOKSHAW, FATEHI_MANZARI
from sphtrunc.scenes.particles import particles

ENGINES = available()
engines = pytest.mark.parametrize("engine", ENGINES)
UNIT = 2.0**-53


def test_both_engines_are_tested() -> None:
    assert ENGINES == ("numba", "numpy")


@pytest.mark.parametrize("side", [5, 26])  # few particles and many: 17576
def test_the_engine_asked_for_is_the_one_that_sums(side) -> None:
    """However many particles there are; unasked, the compiled one sums as soon as it pays."""
    scene = particles(np.stack(np.indices((side,) * 3), -1).reshape(-1, 3), h=1.2, volume=1.0)
    kernel, key = sphtrunc.kernel("cubic-spline"), ((0, 0, 0), (0, 0, 0))
    for engine in ENGINES:
        found = pair_sums(scene, kernel, [key], engine=engine, targets=[0, 1])
        assert found.engine == engine
    unasked = pair_sums(scene, kernel, [key], targets=[0, 1])
    assert unasked.engine == {5: "numpy", 26: "numba"}[side]


# ------------------------------------------------------------------------------ 50 digits


@cache
def kernel_terms(name, dim):
    """σ_d and the terms of a kernel, in 50 digits."""
    shape = shape_of(sphtrunc.kernel(name))
    return normalised(shape, dim), terms(shape)


def truth(name, x, h, volume, field, key, a):
    """(−1)^{|δ|} Σ V_b/h^d s^α ∂^δŴ A_b in 50 digits from the exact polynomials; x (d, n)."""
    delta, alpha = key
    sigma, term = kernel_terms(name, len(x))
    total = mp.mpf(0)
    places = [[mp.mpf(float(c)) for c in column] for column in x.T]
    for b, place in enumerate(places):
        s = [(p - o) / h for p, o in zip(place, places[a], strict=True)]
        weight = mp.mpf(float(volume[b])) * mp.mpf(float(field[b]))
        total += term(delta, s) * monomial(s, alpha) * weight
    return sigma * total / mp.mpf(h) ** len(x)


def clusters(dim, count, rng, size=6, h=1.0):
    """Many small scenes that do not see each other: positions (d, n), volumes, field, cluster."""
    centre = np.zeros((dim, count))
    centre[0] = 8.0 * np.arange(count)
    x = centre[:, :, None] + rng.uniform(-0.8, 0.8, (dim, count, size)) * h
    n = count * size
    return (
        x.reshape(dim, n),
        rng.uniform(0.1, 1.0, n),
        rng.standard_normal(n),
        np.repeat(np.arange(count), size),
    )


CASES = [  # … and how many times the true error the bound may be in the median
    (1, "polynomial:2", [((0,), (0,)), ((1,), (1,)), ((2,), (2,))], 50),
    (1, "cubic-spline", [((0,), (2,)), ((1,), (0,)), ((2,), (0,)), (BROOKSHAW, (1,))], 60),
    (2, "wendland-c4", [((0, 0), (1, 0)), ((1, 0), (0, 1)), (FATEHI_MANZARI, (2, 1))], 50),
    (
        3,
        "cubic-spline",
        [((0, 0, 0), (0, 0, 0)), ((0, 1, 0), (0, 0, 0)), ((1, 0, 1), (1, 0, 1))],
        50,
    ),
    (3, "b-spline:6", [((1, 0, 0), (1, 0, 0)), ((0, 2, 0), (0, 0, 0))], 80),
]


@engines
@pytest.mark.parametrize("precision", ["plain", "compensated"])
@pytest.mark.parametrize(("dim", "name", "keys", "tightness"), CASES)
def test_sums_are_within_their_bound_of_50_digits(
    engine, precision, dim, name, keys, tightness
) -> None:
    rng = np.random.default_rng([dim, len(keys)])
    kernel = sphtrunc.kernel(name)
    x, volume, field, cluster = clusters(dim, 60, rng)
    scene = particles(x.T, h=1.0, volume=volume)
    sums = pair_sums(
        scene,
        kernel,
        keys,
        fields=field,
        field_keys=keys,
        precision=precision,
        bound=True,
        engine=engine,
    )
    ratios = []
    with mpmath.workdps(50):
        for a in range(0, x.shape[1], 4):
            here = cluster == cluster[a]
            mine = int(np.flatnonzero(np.flatnonzero(here) == a)[0])
            for key in keys:
                for values, found, bound in (
                    (np.ones(here.sum()), sums.base[key][a], sums.base_bound[key][a]),
                    (field[here], sums.fields[key][0, a], sums.fields_bound[key][0, a]),
                ):
                    exact = truth(name, x[:, here], 1.0, volume[here], values, key, mine)
                    error = abs(mp.mpf(float(found)) - exact)
                    assert error <= bound
                    if error:
                        ratios.append(float(bound / error))
    assert len(ratios) > 100
    assert np.median(ratios) < tightness


def test_a_sum_may_lose_all_that_its_bound_allows() -> None:
    """One neighbour of weight 1 and 1,023 of almost half a step of the floats, all of them lost:
    nine tenths of the bound of the compiled sum would not do, and no half of it."""
    n, small = 1024, UNIT * (1 - 2.0**-20)
    volume = np.full(n, 4 * small)  # Ŵ = 1/4 exactly
    volume[0] = 4.0
    scene = particles(np.arange(n) / n, h=1.0, volume=volume)
    kernel, key = sphtrunc.kernel("polynomial:-1"), ((0,), (0,))
    sums = pair_sums(scene, kernel, [key], bound=True, engine="numba", targets=[0, 5])
    lost = (n - 1) * Fraction(small)
    for found, bound in zip(sums.base[key], sums.base_bound[key], strict=True):
        assert Fraction(float(found)) == 1
        assert Fraction(9, 10) * Fraction(float(bound)) < lost <= Fraction(float(bound))


# ------------------------------------------------------------------ one result, however it is made


def cloud(dim, n1, rng, **options):
    grid = np.stack(np.meshgrid(*[np.arange(n1)] * dim, indexing="ij")).reshape(dim, -1)
    x = grid + 0.2 * rng.standard_normal(grid.shape)
    options = {"h": 1.3, "volume": rng.uniform(0.5, 1.5, x.shape[1])} | options
    return particles(x.T, **options)


def gradient(scene, engine, field, **options):
    kernel = sphtrunc.kernel("cubic-spline")
    keys = Operator("gradient").needed(scene.dim, 1)
    return pair_sums(
        scene,
        kernel,
        keys,
        fields=field,
        field_keys=keys[:: scene.dim + 1],
        engine=engine,
        **options,
    )


def rows(sums) -> np.ndarray:
    return np.concatenate([np.stack(list(sums.base.values())), *sums.fields.values()])


@engines
@pytest.mark.parametrize("period", [None, 11.0])
@pytest.mark.parametrize("precision", ["plain", "compensated"])
def test_threads_blocks_and_selections_change_no_bit(
    engine, period, precision, monkeypatch
) -> None:
    rng = np.random.default_rng(3)
    scene = cloud(3, 11, rng, period=period)
    field = rng.standard_normal(scene.population)
    whole = gradient(scene, engine, field, workers=1, precision=precision)
    for workers in (2, 3, 7):
        again = gradient(scene, engine, field, workers=workers, precision=precision)
        assert np.array_equal(rows(whole), rows(again))
        assert np.array_equal(whole.neighbours, again.neighbours)
    monkeypatch.setattr(neighbours, "_PAIRS", 999)
    for targets in (rng.permutation(scene.population)[:100], np.array([7]), np.arange(40, 60)):
        some = gradient(scene, engine, field, targets=targets, precision=precision)
        assert np.array_equal(some.targets, targets)
        assert np.array_equal(rows(whole)[:, targets], rows(some))


@engines
@pytest.mark.parametrize("period", [None, 9.0])
def test_the_order_of_the_particles_matters_within_the_bound(engine, period) -> None:
    rng = np.random.default_rng(4)
    scene = cloud(3, 9, rng, period=period)
    n = scene.population
    field = rng.standard_normal(n)
    order = rng.permutation(n)
    other = particles(scene.x[:, order].T, h=1.3, volume=scene.given[order], period=period)
    a = gradient(scene, engine, field, bound=True)
    b = gradient(other, engine, field[order], bound=True)
    for key in a.base:
        bound = a.base_bound[key][order] + b.base_bound[key]
        assert np.all(np.abs(a.base[key][order] - b.base[key]) <= bound)
    assert np.array_equal(a.neighbours[order], b.neighbours)


@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "spiky"])
@pytest.mark.parametrize("mode", RULES)
def test_the_engines_agree(name, mode) -> None:
    rng = np.random.default_rng(5)
    h = 1.2 * rng.uniform(0.8, 1.3, 12**2)
    scene = cloud(2, 12, rng, h=h, mode=mode, period=12.0)
    kernel = sphtrunc.kernel(name)
    keys = [((0, 0), (1, 1)), ((1, 0), (0, 1)), ((0, 1), (0, 0))]
    field = rng.standard_normal((2, scene.population))
    a, b = (
        pair_sums(
            scene,
            kernel,
            keys,
            fields=field,
            field_keys=keys,
            difference=True,
            bound=True,
            engine=engine,
        )
        for engine in ENGINES
    )
    assert np.array_equal(a.neighbours, b.neighbours)
    for key in keys:
        for mine, its, bound in (
            (a.base[key], b.base[key], a.base_bound[key] + b.base_bound[key]),
            (a.fields[key], b.fields[key], a.fields_bound[key] + b.fields_bound[key]),
        ):
            assert np.all(np.abs(mine - its) <= bound)
            assert np.all(bound <= 1e-12)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("far", [0, 10**6])
@pytest.mark.parametrize("one_reach", [True, False])
def test_pairs_are_those_of_whole_numbers(dim, far, one_reach) -> None:
    """On whole numbers, some of them far away, every distance is exact: no pair is lost or added,
    many of them as far apart as the reach itself."""
    rng = np.random.default_rng(dim + far)
    x = rng.integers(0, {1: 900, 2: 40, 3: 14}[dim], (900, dim)).astype(np.float64)
    x[:40] *= 1 + far
    reach = np.array([5.0]) if one_reach else rng.integers(0, 7, 900).astype(np.float64)
    order = neighbours.ordered(x)
    slots = np.sort(rng.permutation(900)[:700])
    radius = np.broadcast_to(reach if one_reach else reach[order.slots], (900,))
    found = {
        (int(block[a]), int(b))
        for block, i, j in neighbours.pairs_of(order, slots, radius, 20)
        for a, b in zip(i, j, strict=True)
    }
    places = order.x.T
    square = ((places[slots][:, None] - places[None]) ** 2).sum(axis=2)
    i, j = np.nonzero(square <= radius[slots][:, None] ** 2)
    assert (square == radius[slots][:, None] ** 2).sum() > 900
    assert found == set(zip(slots[i].tolist(), j.tolist(), strict=True))


def lonely_pairs() -> tuple[np.ndarray, np.ndarray, float]:
    """Positions (160, 2), h and the period: pairs exactly 2h apart, on both sides of the seam of a
    box of 2²⁴, each pair far from the others; inside the box their places have to be rounded."""
    rng, n = np.random.default_rng(8), 80
    h = rng.integers(2**49, 2**50, n) * 2.0**-51
    a = rng.integers(1, 2**49, n) * 2.0**-51
    y = 10.0 * np.arange(n)
    left, right = np.stack([-a, y], 1), np.stack([2.0 * h - a, y], 1)
    for k in range(n):
        assert Fraction(right[k, 0]) - Fraction(left[k, 0]) == 2 * Fraction(h[k])
    return np.concatenate([left, right]), np.tile(h, 2), 2.0**24


@engines
@pytest.mark.parametrize("one_h", [True, False])
def test_a_neighbour_at_the_edge_is_seen_from_far_away(engine, one_h) -> None:
    """The search looks a little further than κh, by what the places are rounded: half the value of
    a kernel that jumps at its edge is counted, on either side of the seam."""
    x, h, period = lonely_pairs()
    kernel, key = sphtrunc.kernel("polynomial:-1"), ((0, 0), (0, 0))
    scenes = [(x, h)]
    if one_h:
        scenes = [(x[[k, k + 80]], float(h[k])) for k in range(0, 80, 4)]
    for places, length in scenes:
        scene = particles(places, h=length, volume=1.0, period=period)
        sums = pair_sums(scene, kernel, [key], engine=engine)
        assert set(sums.neighbours.tolist()) == {2}


def test_a_neighbour_at_the_edge_is_measured_from_far_away() -> None:
    x, h, period = lonely_pairs()
    scene = particles(x, h=h, volume=h**2, period=period)
    found = measure(scene, "polynomial:-1", "value", moments=0, targets="all", bound=True)
    assert found.moment_bound is not None
    block = scene.neighbourhood(np.arange(160), sphtrunc.kernel("polynomial:-1"))
    assert set((block.particle >= 0).sum(axis=0).tolist()) == {2}
    # 1 + 1/2 times 1/(4π), or 1 or 2 times that where the place of the edge is not known so well
    assert np.all(np.abs(found.moments[0, 0] - 1.5 / (4 * np.pi)) <= found.moment_bound[0, 0])


@engines
@pytest.mark.parametrize("mode", RULES)
@pytest.mark.parametrize("period", [None, 10.0])
def test_against_every_pair_and_the_kernel_itself(engine, mode, period) -> None:
    """All pairs, nearest images by rounding, Ŵ and Ŵ′ from `Kernel.w` and `dw`."""
    rng = np.random.default_rng(6)
    n = 100
    h = rng.uniform(0.9, 1.4, n)
    scene = cloud(2, 10, rng, h=h, mode=mode, period=period)
    kernel = sphtrunc.kernel("quintic-spline")
    field = rng.standard_normal(n)
    d = scene.x[:, None, :] - scene.x[:, :, None]  # (d, target, source)
    if period:
        d -= period * np.rint(d / period)
    gather, scatter = h[:, None] + 0 * h, h + 0 * h[:, None]
    pair_h = {"gather": [gather], "scatter": [scatter], "mean": [(gather + scatter) / 2]}
    kernels = pair_h.get(mode, [gather, scatter])
    r = np.sqrt((d**2).sum(axis=0))
    w = np.mean([kernel.w(r / length, 2) / length**2 for length in kernels], axis=0)
    slope = np.mean([kernel.dw(r / length, 2) / length**3 for length in kernels], axis=0)
    w, slope = w * scene.given, slope * scene.given / np.where(r, r, 1)
    keys = [((0, 0), (0, 0)), ((1, 0), (0, 0))]
    sums = pair_sums(scene, kernel, keys, fields=field, field_keys=keys, bound=True, engine=engine)
    value = (w * field).sum(axis=1)
    first = -(slope * d[0] * field).sum(axis=1) * h
    assert np.array_equal(sums.neighbours, (r / np.max(kernels, axis=0) <= 3).sum(axis=1))
    for found, expected, size, key in (
        (sums.fields[keys[0]][0], value, np.abs(w * field).sum(axis=1), keys[0]),
        (sums.fields[keys[1]][0], first, np.abs(slope * d[0] * field).sum(axis=1) * h, keys[1]),
    ):
        # 4 ULP of the kernel, n additions, and a handful of roundings on the way
        tolerance = sums.fields_bound[key][0] + (n + 20) * UNIT * size + 40 * UNIT * size.max()
        assert np.all(np.abs(found - expected) <= tolerance)


@engines
def test_images_are_found_wherever_the_particles_are_written(engine) -> None:
    """Whole periods added to coordinates (exactly) change nothing."""
    rng = np.random.default_rng(7)
    x = rng.integers(0, 8 * 64, (3, 200)) / 64.0
    volume = rng.uniform(0.5, 1.5, 200)
    far = x + 8.0 * rng.integers(-3, 4, x.shape)
    a, b = (
        gradient(particles(p.T, h=1.0, volume=volume, period=8.0), engine, volume) for p in (x, far)
    )
    assert np.array_equal(rows(a), rows(b))


# ------------------------------------------------------------------------ operators on particles

OPERATORS = [
    Operator("gradient", "difference", "csph"),
    Operator("gradient", "symmetric"),
    Operator("value", "difference", "shepard"),
    Operator("laplacian", "brookshaw"),
    Operator("laplacian", "fatehi-manzari"),
    Operator("hessian", "direct", "rkpm-2"),
]


@pytest.mark.parametrize("operator", OPERATORS, ids=lambda o: f"{o.name}-{o.form}-{o.correction}")
def test_estimates_and_matrices_are_the_same_operator(operator) -> None:
    rng = np.random.default_rng(8)
    n1 = 8
    base = cloud(2, n1, rng)
    n = base.population
    scene = particles(
        base.x.T, h=1.4, mass=rng.uniform(0.5, 1.5, n), density=rng.uniform(0.9, 1.1, n), period=8.0
    )
    kernel = sphtrunc.kernel("wendland-c4")
    fields = rng.standard_normal((2, n))
    found = estimates(scene, kernel, operator, fields, engine="numpy")
    assert not found.flagged.any()
    for axis in range(found.values.shape[1]):
        matrix = weights(scene, kernel, operator, axis=axis)
        assert matrix.format == "csr"
        assert matrix.shape == (n, n)
        per_h = 1.4**-operator.derivatives
        size = np.abs(matrix) @ np.abs(fields.T)
        tolerance = 64 * UNIT * size * (1 + found.condition[:, None]) * found.neighbours.max()
        assert np.all(np.abs(matrix @ fields.T - found.values[:, axis].T * per_h) <= tolerance)
        some = weights(scene, kernel, operator, axis=axis, targets=[5, 3])
        assert np.array_equal(some.toarray(), matrix[[5, 3]].toarray())


@engines
def test_corrected_gradients_are_exact_for_linear_fields(engine) -> None:
    rng = np.random.default_rng(9)
    scene = cloud(3, 7, rng)
    kernel = sphtrunc.kernel("cubic-spline")
    operator = Operator("gradient", "difference", "csph")
    slope = np.array([2.0, -3.0, 0.5])
    quadratic = (scene.x[0] - 3.0) ** 2
    found = estimates(scene, kernel, operator, [slope @ scene.x, quadratic], engine=engine)
    assert not found.flagged.any()
    size = 1.3 * np.abs(slope)[:, None] * found.condition * found.neighbours
    assert np.all(np.abs(found.values[0] - 1.3 * slope[:, None]) <= 256 * UNIT * size)
    inner = (np.abs(scene.x - 3.0) < 1.5).all(axis=0)
    assert np.any(np.abs(found.values[1, 0] - 2.6 * (scene.x[0] - 3.0))[inner] > 1e-3)


def test_lonely_and_aligned_targets_are_flagged() -> None:
    x = np.array([[0, 0], [1, 0], [2.5, 0], [50, 0], [90, 0], [90.5, 0.1], [90.2, 0.6]])
    scene = particles(x, h=1.0, volume=1.0)
    kernel = sphtrunc.kernel("cubic-spline")
    operator = Operator("gradient", "difference", "csph")
    found = estimates(scene, kernel, operator, x[:, 0], engine="numpy")
    assert found.flagged.tolist() == [True, True, True, True, False, False, False]
    with pytest.raises(ValueError, match="the first is particle 0 with 2 neighbours"):
        weights(scene, kernel, operator)


def test_small_systems_by_cofactors_and_by_singular_values() -> None:
    rng = np.random.default_rng(10)
    for n in (1, 2, 3):
        a = rng.standard_normal((n, n, 400)) + 2 * np.eye(n)[:, :, None]
        a[..., 0] = 0.0
        health = Health()
        identity = np.eye(n, dtype=int).tolist()
        inverse = np.array(solve([list(row) for row in a], identity, health))[..., 1:]
        matrices = a[..., 1:].transpose(2, 0, 1)
        condition = np.linalg.cond(matrices)
        assert health.condition[0] == np.inf
        assert np.all(health.condition[1:] >= 0.5)
        error = np.abs(inverse - np.linalg.inv(matrices).transpose(1, 2, 0))
        assert np.all(error <= 200 * UNIT * condition**2 * np.abs(inverse).max(axis=(0, 1)))


# ------------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fields": np.ones(3)}, r"fields: got shape"),
        ({"fields": np.full(64, np.nan)}, "fields: got NaN"),
        ({"targets": [0, 64]}, "targets: got 0 to 64, expected 0 to 63"),
        ({"targets": [-1]}, "targets: got -1"),
        ({"targets": [0.5]}, "targets: expected a list of whole numbers"),
        ({"engine": "fortran"}, "engine: got 'fortran', expected one of"),
        ({"precision": "quadruple"}, "precision: got 'quadruple'"),
        ({"workers": 0}, "workers: got 0"),
    ],
)
def test_bad_arguments_are_refused(options, message) -> None:
    scene = cloud(2, 8, np.random.default_rng(0))
    with pytest.raises(ValueError, match=message):
        pair_sums(scene, sphtrunc.kernel("cubic-spline"), [((0, 0), (0, 0))], **options)


@engines
def test_sums_that_overflow_are_refused(engine) -> None:
    scene = cloud(1, 8, np.random.default_rng(0), volume=1e200)
    with pytest.raises(ValueError, match="the sums overflow"):
        gradient(scene, engine, np.full(8, 1e200))


@engines
def test_a_box_must_be_wider_than_two_supports(engine) -> None:
    scene = cloud(2, 8, np.random.default_rng(0), period=5.0)
    with pytest.raises(ValueError, match="a particle would meet its own image"):
        gradient(scene, engine, np.ones(64))
