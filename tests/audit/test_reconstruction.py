"""Piecewise polynomials recovered exactly from noisy samples, and nothing else claimed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sphtrunc import kernel
from sphtrunc.audit.reconstruction import reconstruct
from sphtrunc.kernels.kernel import Kernel

NAMES = [
    "cubic-spline",
    "quartic-spline",
    "quintic-spline",
    "wendland-c2",
    "wendland-c4",
    "wendland-c6",
    "wendland-c2-1d",
    "wendland-c4-1d",
    "wendland-c6-1d",
    "hyperbolic",
    "core-triangle",
    "linear-quartic",
    "poly6",
    "polynomial:4",
    "b-spline:2",
    "b-spline:7",
]


def normal_form(shape: Kernel) -> Kernel:
    """On a support of one, with value one at the origin: what `reconstruct` promises."""
    one = shape.scaled(1)
    top = one.pieces[0].eval(0)
    return Kernel(one.knots, [piece * (1 / top) for piece in one.pieces])


def noisy(y, seed):
    """Every value moved to one of its two neighbours among the floats."""
    up = np.random.default_rng(seed).random(len(y)) < 0.5
    moved = np.where(up, np.nextafter(y, np.inf), np.nextafter(y, 0))
    return np.where(y == 0, 0.0, moved)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("reach", [1, 1.02])
def test_a_kernel_is_recovered_exactly_from_2000_samples_with_one_ulp_of_noise(name, reach):
    shape = kernel(name)
    q = np.linspace(0, float(shape.support) * reach, 2000)
    found = reconstruct(q, noisy(shape.w(q, 3), 1))
    assert found is not None
    assert found[0] == normal_form(shape)
    assert found[1] == float(shape.support)


@pytest.mark.parametrize("seed", range(5))
def test_the_noise_does_not_matter(seed):
    shape = kernel("quintic-spline")
    q = np.sort(np.random.default_rng(100 + seed).random(2000)) * 3.01
    found = reconstruct(q, noisy(shape.w(q, 2), seed))
    assert found is not None
    assert found[0] == normal_form(shape)


@given(
    st.fractions(-4, 4, max_denominator=8),
    st.fractions(-4, 4, max_denominator=8),
    st.integers(1, 7),
    st.integers(2, 4),
)
@settings(max_examples=25)
def test_random_two_piece_kernels_are_recovered_exactly(a, b, cut, order):
    """(1−u)^m outside; inside the same plus a rational multiple of (k−u)²(1 + a u + b u²)."""
    text = f"0..{cut}/8: (1-q)^{order} + 3/4*({cut}/8-q)^2*(1+({a})*q+({b})*q^2)"
    shape = kernel(f"{text}; {cut}/8..1: (1-q)^{order}")
    q = np.linspace(0, 1, 2000)
    found = reconstruct(q, noisy(shape.w(q, 1), 3), support=1.0)
    assert found is not None
    assert found[0] == normal_form(shape)


def test_what_is_no_polynomial_is_not_recognised_as_one():
    q = np.linspace(0, 1.02, 2000)
    assert reconstruct(q, np.where(q < 1, 1 + np.cos(np.pi * q), 0)) is None
    assert reconstruct(q, np.where(q < 1, np.exp(-3 * q**2), 0)) is None


def test_irrational_coefficients_are_not_called_rational():
    q = np.linspace(0, 1.02, 2000)
    root = np.sqrt(2.0)
    y = np.where(q < 1, (1 - q) ** 3 * (1 + root * q + np.pi * q**2), 0)
    assert reconstruct(q, y) is None


def test_one_sample_that_disagrees_is_enough_to_refuse():
    shape = kernel("cubic-spline")
    q = np.linspace(0, 2, 2000)
    y = shape.w(q, 3)
    y[700] *= 1 + 1e-9
    assert reconstruct(q, y) is None


def test_too_few_samples_are_no_evidence():
    q = np.linspace(0, 2, 12)
    assert reconstruct(q, kernel("cubic-spline").w(q, 3)) is None
