"""Sums and their bounds against exact rational arithmetic."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sphtrunc.arithmetic import summation as sm

U = Fraction(1, 2**53)
moderate = st.floats(-1e100, 1e100).filter(lambda a: a == 0 or abs(a) > 1e-100)


def exact(values: np.ndarray) -> Fraction:
    return sum((Fraction(float(v)) for v in np.ravel(values)), Fraction(0))


def pair(x: sm.DoubleDouble) -> Fraction:
    return Fraction(float(x[0])) + Fraction(float(x[1]))


def ill_conditioned(
    rng: np.random.Generator, n: int, decades: float
) -> tuple[np.ndarray, np.ndarray]:
    """Products spread over many decades whose second half nearly cancels the first."""
    a = rng.standard_normal(n) * 10 ** rng.uniform(-decades / 2, decades / 2, n)
    b = rng.standard_normal(n) * 10 ** rng.uniform(-decades / 2, decades / 2, n)
    a[n // 2 : 2 * (n // 2)] = -a[: n // 2]
    b[n // 2 : 2 * (n // 2)] = b[: n // 2] * (1 + 1e-13 * rng.standard_normal(n // 2))
    return a, b


@given(moderate, moderate)
def test_two_sum_and_two_product_are_exact(a: float, b: float) -> None:
    x, y = np.array([a]), np.array([b])
    s, e = sm.two_sum(x, y)
    assert pair((s[0], e[0])) == Fraction(a) + Fraction(b)
    assert s[0] == a + b
    p, f = sm.two_product(x, y)
    assert pair((p[0], f[0])) == Fraction(a) * Fraction(b)
    assert p[0] == a * b


def test_error_free_transformations_in_single_precision() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 2000)).astype(np.float32)
    for result, operate in (
        (sm.two_sum(a, b), Fraction.__add__),
        (sm.two_product(a, b), Fraction.__mul__),
    ):
        assert result[0].dtype == result[1].dtype == np.float32
        for i in range(2000):
            assert pair((result[0][i], result[1][i])) == operate(
                Fraction(float(a[i])), Fraction(float(b[i]))
            )


def test_two_product_below_the_underflow_threshold_is_off_by_a_few_tiny() -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal(1000) * 1e-160
    b = rng.standard_normal(1000) * 1e-155
    p, e = sm.two_product(a, b)
    for i in range(1000):
        rest = Fraction(a[i]) * Fraction(b[i]) - pair((p[i], e[i]))
        assert abs(rest) <= 4 * Fraction(sm.TINY)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 8, 9, 100, 129])
def test_gamma_and_depth(n: int) -> None:
    assert Fraction(sm.gamma(n)) >= n * U / (1 - n * U)
    assert sm.depth(n) == (math.ceil(math.log2(n)) if n else 0)


def test_gamma_refuses_what_it_cannot_bound() -> None:
    with pytest.raises(ValueError, match="gamma"):
        sm.gamma(2**52)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5, 16, 17, 100, 257])
def test_sums_do_not_depend_on_padding_nor_on_the_other_targets(n: int) -> None:
    rng = np.random.default_rng(n)
    x = rng.standard_normal((n, 5)) * 10 ** rng.uniform(-8, 8, (n, 5))
    y = rng.standard_normal((n, 5))
    for extra in (1, 7, 64, 300):
        padded = np.concatenate([x, np.zeros((extra, 5))])
        weights = np.concatenate([y, np.zeros((extra, 5))])
        assert np.array_equal(sm.total(padded), sm.total(x))
        assert np.array_equal(sm.dot(padded, weights), sm.dot(x, y))
        assert np.array_equal(sm.compensated_dot(padded, weights), sm.compensated_dot(x, y))
        for a, b in zip(sm.dd_total(sm.dd(padded)), sm.dd_total(sm.dd(x)), strict=True):
            assert np.array_equal(a, b)
    for t in range(5):
        assert sm.total(x)[t] == sm.total(np.ascontiguousarray(x[:, t]))


def test_empty_sums_are_zero() -> None:
    nothing = np.zeros((0, 3))
    assert np.array_equal(sm.total(nothing), np.zeros(3))
    assert np.array_equal(sm.compensated_dot(nothing, nothing), np.zeros(3))
    assert np.array_equal(sm.total_error(nothing), np.zeros(3))


@settings(max_examples=200)
@given(st.integers(1, 300), st.integers(0, 2**32), st.floats(0, 24))
def test_errors_are_within_their_bounds(n: int, seed: int, decades: float) -> None:
    a, b = ill_conditioned(np.random.default_rng(seed), n, decades)
    true = sum((Fraction(x) * Fraction(y) for x, y in zip(a, b, strict=True)), Fraction(0))
    size = sum((abs(Fraction(x) * Fraction(y)) for x, y in zip(a, b, strict=True)), Fraction(0))
    magnitude = np.array(float(size) * (1 + 1e-15))

    plain = abs(Fraction(float(sm.dot(a, b))) - true)
    assert plain <= Fraction(float(sm.dot_error(n, magnitude)))

    value = sm.compensated_dot(a, b)
    compensated = abs(Fraction(float(value)) - true)
    assert compensated <= Fraction(float(sm.compensated_dot_error(n, value, magnitude)))

    extended = abs(pair(sm.dd_total(sm.two_product(a, b))) - true)
    assert extended <= sm.depth(n) * Fraction(sm.DD_UNIT) * size * (1 + U) ** 4

    products = a * b
    running = abs(Fraction(float(sm.total(products))) - exact(products))
    assert running <= Fraction(float(sm.total_error(products)))


def test_compensation_gains_what_the_theory_says() -> None:
    """Condition 1e12: plain loses twelve digits, the compensated sum none of the sixteen."""
    rng = np.random.default_rng(1)
    gain, kept = [], []
    for _ in range(200):
        a, b = ill_conditioned(rng, 128, 0.0)
        true = sum((Fraction(x) * Fraction(y) for x, y in zip(a, b, strict=True)), Fraction(0))
        plain = abs(Fraction(float(sm.dot(a, b))) / true - 1)
        value = abs(Fraction(float(sm.compensated_dot(a, b))) / true - 1)
        gain.append(float(plain))
        kept.append(float(value))
    assert np.median(gain) > 1e-5
    assert np.median(kept) <= 2.0**-53


def test_the_running_bound_is_tight_when_terms_cancel() -> None:
    """Terms that cancel in the first fold: the partial sums are small, and so is the bound."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal(512)
    x = np.concatenate([x, -x * (1 + 1e-3 * rng.standard_normal(512))])
    assert sm.total_error(x) < 0.01 * sm.gamma(sm.depth(1024)) * np.abs(x).sum()


@settings(max_examples=300)
@given(moderate, moderate, moderate, moderate)
def test_double_double_operations(a: float, b: float, c: float, d: float) -> None:
    x = sm.two_sum(np.array([a]), np.array([b * 1e-17]))
    y = sm.two_sum(np.array([c]), np.array([d * 1e-17]))
    ex, ey = pair((x[0][0], x[1][0])), pair((y[0][0], y[1][0]))
    tolerance = Fraction(sm.DD_UNIT)

    def error(result: sm.DoubleDouble, true: Fraction) -> Fraction:
        return abs(pair((result[0][0], result[1][0])) - true)

    assert error(sm.dd_add(x, y), ex + ey) <= tolerance * abs(ex + ey)
    assert error(sm.dd_mul(x, y), ex * ey) <= tolerance * abs(ex * ey) + Fraction(1, 2**1000)
    safe = np.where(y[0] == 0.0, 1.0, y[0]), y[1]
    es = pair((safe[0][0], safe[1][0]))
    assert error(sm.dd_div(x, safe), ex / es) <= tolerance * abs(ex / es) + Fraction(1, 2**1000)
    positive = np.abs(x[0]), np.where(x[0] < 0, -x[1], x[1])
    root = sm.dd_sqrt(positive)
    er = pair((root[0][0], root[1][0]))
    ep = pair((positive[0][0], positive[1][0]))
    assert abs(er * er - ep) <= 3 * tolerance * ep


def test_double_double_constants() -> None:
    hi, lo = sm.dd_from_ratio(1, 3)
    assert hi == 1 / 3
    assert abs(pair((np.float64(hi), np.float64(lo))) - Fraction(1, 3)) <= U**2 / 3


# ----------------------------------------------------------- bounds that cannot be made any smaller


def test_the_unit_is_half_a_step_of_the_floats() -> None:
    assert np.finfo(np.float64).eps == 2 * sm.UNIT
    assert 1.0 + sm.UNIT == 1.0 < 1.0 + sm.UNIT * (1 + 2 * sm.UNIT)


@pytest.mark.parametrize("levels", [1, 4, 10])
def test_a_total_may_lose_all_that_its_bound_allows(levels: int) -> None:
    """A summand of almost half a step is lost at each level of the tree: half the bound would not
    do, nor nine tenths of it."""
    x = np.full(2**levels, 1e-40)
    x[0] = 1.0
    x[[2**level for level in range(levels)]] = sm.UNIT * (1 - 2.0**-20)
    lost = abs(Fraction(float(sm.total(x))) - exact(x))
    bound = Fraction(float(sm.total_error(x)))
    assert Fraction(9, 10) * bound < lost <= bound
