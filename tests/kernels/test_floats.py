"""Kernel values in floating point against the exact ones, which `ulp_table` finds in integers."""

from __future__ import annotations

import csv
from fractions import Fraction
from functools import cache
from math import inf, nan

import numpy as np
import pytest
from hypothesis import example, given, settings
from strategies import positive_shapes, shapes
from ulp_table import (
    DTYPES,
    FIELDS,
    FUNCTIONS,
    TABLE,
    Exact,
    bound,
    errors,
    sample,
)

from sphtrunc import Kernel, kernel
from sphtrunc.kernels.catalogue import names

DIMS = (1, 2, 3)
Shape = tuple[list[Fraction], list[list[Fraction]]]


def computed(k: Kernel, function: str, points: np.ndarray) -> dict[int, np.ndarray]:
    return {d: getattr(k, function)(points, d) for d in DIMS}


def worst(k: Kernel, function: str, points: np.ndarray, in_terms: bool) -> float:
    found = computed(k, function, points)
    for values in found.values():
        assert values.dtype == points.dtype
        assert np.isfinite(values).all()
    by_dim = errors(Exact(k, FUNCTIONS[function]), points, found, in_terms)
    return max(float(error.max()) for error in by_dim.values())


# -- the committed table ---------------------------------------------------------------------------


@cache
def table() -> list[dict[str, str]]:
    with TABLE.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_table_covers_the_catalogue() -> None:
    """Every name, dimension, precision and function, 10⁵ points each, and all within the bounds."""
    assert list(table()[0]) == FIELDS
    keys = [(r["kernel"], int(r["dim"]), r["dtype"], r["function"]) for r in table()]
    wanted = {(n, d, t, f) for n in names() for d in DIMS for t in DTYPES for f in FUNCTIONS}
    assert set(keys) == wanted
    assert len(keys) == len(wanted)
    for row in table():
        assert int(row["points"]) >= 100_000
        assert float(row["max"]) <= bound(row["kernel"], row["function"])


@pytest.mark.parametrize("name", names())
def test_the_table_is_of_this_code(name: str) -> None:
    """The worst inputs of the table give the errors that it states."""
    k = kernel(name)
    for function, derivative in FUNCTIONS.items():
        exact = Exact(k, derivative)
        for row in (r for r in table() if r["kernel"] == name and r["function"] == function):
            q = np.array([float.fromhex(row["worst_q"])]).astype(DTYPES[row["dtype"]])
            dim = int(row["dim"])
            value = {dim: getattr(k, function)(q, dim)}
            error = errors(exact, q, value, derivative > 0)[dim][0]
            assert abs(error - float(row["max"])) < 0.002


# -- the bounds ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", names())
@pytest.mark.parametrize("dtype", list(DTYPES))
def test_bounds_over_the_catalogue(name: str, dtype: str) -> None:
    """With other points than the table's: w in ULP, dw and d2w in eps Σ|terms|."""
    k = kernel(name)
    points = sample(k, DTYPES[dtype], 500, seed=1, parts=3)
    for function in FUNCTIONS:
        assert worst(k, function, points, function != "w") <= bound(name, function)


@pytest.mark.parametrize("name", ["cubic-spline", "quintic-spline", "wendland-c4", "polynomial:4"])
def test_derivatives_keep_their_digits_at_their_roots(name: str) -> None:
    """Pieces are cut at their roots, rational or not: even dw near 0 and d2w near its change of
    sign are right to a few units in the last place."""
    k = kernel(name)
    near = [np.float64(0), np.float64(2) / 3, np.float64(1)]
    if name == "polynomial:4":
        near.append(np.float64(2) / np.sqrt(9))  # (4 − q²)³ (9 q² − 4)
    points = np.concatenate([x + np.spacing(x) * np.arange(-40, 41) for x in near])
    points = np.concatenate([points[points >= 0], sample(k, np.float64, 500, seed=2, parts=3)])
    knots = [float(x) for x in k.knots]
    points = points[~np.isin(points, knots)]
    for function in ("dw", "d2w"):
        assert worst(k, function, points, in_terms=False) <= 4


def awkward() -> list[tuple[str, str]]:
    """Knots that no float can say, high powers on wide pieces, tiny and large supports."""
    return [
        ("thirds", "0..1/3: 1-q; 1/3..2/3: 2*(2/3-q)"),
        ("fifths", "0..3/5: 2-q; 3/5..7/5: (7/5-q)^3*(2+q)"),
        ("power", "0..2: (2-q)^11"),
        ("power to 7/3", "0..7/3: (7/3-q)^11"),
        ("power to 1/3", "0..1/3: (1/3-q)^9*(1+q^2)"),
        ("ring", "0..2: q^2*(2-q)^3"),
        ("ring of thirds", "0..1/3: 0; 1/3..5/3: (q-1/3)^4*(5/3-q)^2"),
        ("two humps", "0..1: (1-q)^2; 1..3: (q-1)^3*(3-q)^2"),
        ("touches zero", "0..2: (q-1)^2*(2-q)^2"),
        ("touches zero at a third", "0..2: (q-1/3)^2*(2-q)^2"),
        ("touches zero off the rationals", "0..2: (q^2-2)^2"),
        ("nearly touches zero", "0..2: ((q-1)^2+1/1000)*(2-q)^2"),
        ("small", "0..1/1000000: (1/1000000-q)^7*(1+q)"),
        ("large", "0..1000000: (1000000-q)^7*(1+q)"),
        ("high on a small support", "0..1/16: (1/16-q)^11"),
        ("negative", "0..2: -(2-q)^3*(1+q)"),
    ]


@pytest.mark.parametrize(("label", "text"), awkward())
@pytest.mark.parametrize("dtype", list(DTYPES))
def test_awkward_kernels(label: str, text: str, dtype: str) -> None:
    k = kernel(text)
    points = sample(k, DTYPES[dtype], 2000, seed=3, parts=8)
    assert worst(k, "w", points, in_terms=False) <= 4
    assert worst(k, "dw", points, in_terms=True) <= 4
    assert worst(k, "d2w", points, in_terms=True) <= 4


def test_a_high_power_is_not_lost_to_underflow() -> None:
    """t^64 underflows where σ t^64 does not: σ is 65·4^65 in 1D."""
    k = kernel("0..1/4: (1/4-q)^63")
    t = 2.0 ** -np.linspace(10, 19, 200)
    points = 0.25 - t
    assert (k.w(points[-40:]) > 1e-300).any()
    assert worst(k, "w", points, in_terms=False) <= 8
    assert worst(k, "d2w", points, in_terms=False) <= 8


def test_values_that_change_sign() -> None:
    """A fourth-order kernel with a negative lobe: on either side of its root it has one sign."""
    k = kernel("0..2: (2-q)^3*(1+3/2*q-7/3*q^2)")
    exact = Exact(k, 0)
    low, high = 0.5, 1.5
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if exact.rational(middle) > 0 else (low, middle)
    points = low + np.spacing(low) * np.arange(-200, 201)
    assert (k.w(points) > 0).any()
    assert (k.w(points) < 0).any()
    assert worst(k, "w", points, in_terms=False) <= 4


@given(positive_shapes())
@settings(max_examples=60)
def test_random_positive_kernels(shape: Shape) -> None:
    """To 4 ULP everywhere, in float64 and float32."""
    k = Kernel(*shape)
    for dtype in DTYPES.values():
        points = sample(k, dtype, 150, parts=2)
        assert worst(k, "w", points, in_terms=False) <= 4


@given(shapes())
@settings(max_examples=40)
@example(([Fraction(0), Fraction(1, 3)], [[Fraction(1, 27), Fraction(-1, 3), Fraction(1)]]))
def test_random_kernels(shape: Shape) -> None:
    """Derivatives, and values too, of kernels of any sign: within 4 eps Σ|terms|."""
    k = Kernel(*shape)
    points = sample(k, np.float64, 150, parts=2)
    for function in FUNCTIONS:
        assert worst(k, function, points, in_terms=True) <= 4


# -- at knots, at the edge and beyond --------------------------------------------------------------


def test_a_jump_takes_the_mean_of_both_sides() -> None:
    hat = Kernel([0, 1, 2], [[3], [1]])  # σ₁ = 1/8
    below, above = np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0)
    assert hat.w([0, below, 1, above]).tolist() == [3 / 8, 3 / 8, 2 / 8, 1 / 8]
    assert hat.w([np.nextafter(2.0, 0.0), 2, np.nextafter(2.0, 3.0)]).tolist() == [1 / 8, 1 / 16, 0]
    single = np.array([1, 2], dtype=np.float32)
    assert hat.w(single).tolist() == [2 / 8, 1 / 16]


def test_a_kink_takes_the_mean_slope() -> None:
    hat = Kernel([0, 1], [[1, -1]])
    assert hat.dw([0, 0.5, 1, 2]).tolist() == [-1, -1, -0.5, 0]
    assert hat.w([0, 0.25, 1]).tolist() == [1, 0.75, 0]


def test_a_jump_where_no_float_is() -> None:
    """The floats next to 1/3 lie on one side each."""
    k = Kernel([0, "1/3", 1], [[2], [1]])
    third = 1 / 3  # below
    assert Fraction(third) < Fraction(1, 3)
    sigma = k.w(0.0) / 2
    assert k.w(third) == 2 * sigma
    assert k.w(np.nextafter(third, 1)) == sigma
    single = np.float32(1 / 3)  # above
    assert Fraction(float(single)) > Fraction(1, 3)
    assert k.w(single) == np.float32(sigma)
    assert k.w(np.nextafter(single, np.float32(0))) == np.float32(2 * sigma)


@pytest.mark.parametrize("name", ["cubic-spline", "polynomial:-1", "b-spline:20", "linear-quartic"])
@pytest.mark.parametrize("dtype", list(DTYPES))
def test_beyond_the_support(name: str, dtype: str) -> None:
    k = kernel(name)
    edge = DTYPES[dtype](float(k.support))
    far = np.array([np.nextafter(edge, DTYPES[dtype](inf)), 2 * edge, 1e30, inf], DTYPES[dtype])
    for function in FUNCTIONS:
        for dim in DIMS:
            assert getattr(k, function)(far, dim).tolist() == [0, 0, 0, 0]


def test_next_to_the_edge() -> None:
    """σ₁ (2 − q)³/4 of the cubic spline at the floats before the edge: t³/6, no digit lost."""
    t = 2.0**-52 * np.array([1, 2, 4, 1024])
    assert (kernel("cubic-spline").w(2 - t) * 6 == t**3).all()


@pytest.mark.parametrize("q", [5e-324, 1e-310, 2.0**-1022, 1e-200, 0.0])
def test_denormal_distances(q: float) -> None:
    k = kernel("cubic-spline")
    assert k.w(q) == k.w(0.0) == 2 / 3
    assert k.dw(q) == -2 * q  # σ (−3q)
    assert k.d2w(q) == -2


# -- arguments -------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [-1.0, -1e-320, nan, [1, nan], [0.5, -0.5], -inf, np.float32(-1)])
def test_negative_or_nan(bad: object) -> None:
    k = kernel("cubic-spline")
    for call in (k.w, k.dw, k.d2w):
        with pytest.raises(ValueError, match="negative value or NaN"):
            call(bad)


@pytest.mark.parametrize(
    "bad",
    ["1", ["a"], 1j, None, [None], True, [[1], [1, 2]], {}, [Fraction(1, 2)], np.datetime64("now")],
)
def test_not_real_numbers(bad: object) -> None:
    with pytest.raises(ValueError, match="q: "):
        kernel("cubic-spline").w(bad)


def test_shapes_and_types() -> None:
    k = kernel("wendland-c4")
    grid = np.linspace(0, 2.2, 30_000).reshape(100, 3, 100)
    whole = k.w(grid, 2)
    assert whole.shape == grid.shape
    assert whole.dtype == np.float64
    one_by_one = [k.w(x, 2) for x in grid.reshape(-1)[::997]]
    assert whole.reshape(-1)[::997].tolist() == [float(x) for x in one_by_one]
    assert (k.w(np.asfortranarray(grid), 2) == whole).all()
    assert (k.w(grid[::2, ::-1, 3:7], 2) == whole[::2, ::-1, 3:7]).all()
    assert k.w(np.float64(1)).shape == ()
    assert k.w([]).shape == (0,)
    assert k.w(np.zeros((3, 0, 2))).shape == (3, 0, 2)
    assert k.w([0, 1, 2]).tolist() == k.w([0.0, 1.0, 2.0]).tolist()
    assert k.w(np.array([0, 1, 2], dtype=np.uint8)).dtype == np.float64
    assert k.w(np.array([1], dtype=np.float16)).dtype == np.float64
    assert k.w(np.array([1], dtype=np.float32)).dtype == np.float32
    assert k.w(np.array([1.0], dtype=">f8")).tolist() == k.w([1.0]).tolist()


def test_the_argument_is_left_alone() -> None:
    q = np.linspace(0, 3, 1000)
    q.flags.writeable = False
    before = q.copy()
    first = kernel("quintic-spline").dw(q)
    first[:] = 7
    assert (q == before).all()
    assert (kernel("quintic-spline").dw(q) != 7).all()
