"""Constants: read by a grammar, recognised exactly, never evaluated as code."""

from __future__ import annotations

from fractions import Fraction

import mpmath
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sympy import Rational, pi, sqrt

from sphtrunc.audit.constants import constant, recognise, simplest_between
from sphtrunc.audit.identification import identify

VALUES = {
    "3/(359*pi)": 3 / (359 * pi),
    "7/478/pi": 7 / (478 * pi),
    "pi^2/(4*pi^2-30)": pi**2 / (4 * pi**2 - 30),
    "pi**(-3/2)": pi ** Rational(-3, 2),
    "1/sqrt(pi)": 1 / sqrt(pi),
    "-1.5e-3": Rational(-3, 2000),
    "2^-3": Rational(1, 8),
    " 21 / (16 * PI) ": 21 / (16 * pi),
}


@pytest.mark.parametrize("text", VALUES)
def test_a_constant_means_what_it_says(text):
    assert constant(text).value == VALUES[text]


def test_many_digits_stand_for_what_rounds_to_them():
    read = constant("0.3183098862")
    assert read.value == Rational(3183098862, 10**10)
    assert 0 < read.error < Fraction(2, 10**10)
    assert constant("0.5").error == 0


HOSTILE = [
    "",
    " ",
    "pi pi",
    "__import__('os').system('touch executed')",
    "9**9**9",
    "2**(10**9)",
    "(9^64)^64",
    "1e999",
    "1/0",
    "1/(pi-pi)",
    "sqrt(-1)",
    "(0-1)^(1/2)",
    "3/(359*π)",
    "(" * 90,
    "1" * 300,
    "lambda: 1",
    "nan",
    "inf",
    "1_0",
    "pi.evalf()",
]


@pytest.mark.parametrize("text", HOSTILE)
def test_what_is_no_constant_is_refused_in_one_line(text):
    with pytest.raises(ValueError, match="constant") as caught:
        constant(text)
    assert "\n" not in str(caught.value)


@given(st.text(alphabet="0123456789.+-*/^()episqrt e", max_size=40))
def test_random_texts_are_read_or_refused(text):
    try:
        read = constant(text)
    except ValueError:
        pass
    else:
        assert read.value.is_number


@given(st.fractions(-50, 50, max_denominator=300), st.integers(1, 10**6))
def test_the_simplest_fraction_of_an_interval(centre, width):
    low, high = centre - Fraction(1, width), centre + Fraction(1, width)
    found = simplest_between(low, high)
    assert low <= found <= high
    smaller = range(1, found.denominator)
    assert not any((low * d).__ceil__() <= (high * d).__floor__() for d in smaller)


@given(st.integers(1, 400), st.integers(1, 400), st.sampled_from([0, -1, 1]))
def test_rationals_times_powers_of_pi_are_recognised(p, q, power):
    with mpmath.workdps(30):
        value = mpmath.mpf(p) / q * mpmath.pi**power
        found = recognise(float(value), 2.0**-50)
    assert found == Rational(p, q) * pi**power


@pytest.mark.parametrize("value", [0.5772156649015329, 1.2020569031595942, 1.6180339887498949])
def test_no_exact_form_is_invented(value):
    assert recognise(value, 2.0**-50) is None


def test_the_copied_constant_of_the_quintic_spline_is_told_from_the_right_one():
    found = identify("0.0026599711937")
    assert found.form == 3 / (359 * pi)
    first = found.candidates[0]
    assert (first.kernel, first.dim, first.ratio) == ("quintic-spline", 3, Rational(360, 359))
    assert not first.match
    assert "ratio 360/359" in found.to_text()


# published constants, from the papers cited in the catalogue; support 2h unless they say otherwise
PUBLISHED = [
    ("2/3", "cubic-spline", 1),
    ("10/(7*pi)", "cubic-spline", 2),
    ("1/pi", "cubic-spline", 3),
    ("8/pi", "cubic-spline", 3),
    ("15/(7*pi)", "cubic-spline", 2),
    ("7/(478*pi)", "quintic-spline", 2),
    ("1/(120*pi)", "quintic-spline", 3),
    ("96/(1199*pi)", "quartic-spline", 2),
    ("1/(20*pi)", "quartic-spline", 3),
    ("21/(16*pi)", "wendland-c2", 3),
    ("495/(256*pi)", "wendland-c4", 3),
    ("1365/(64*pi)", "wendland-c6", 3),
    ("315/(64*pi)", "poly6", 3),
    ("pi/(4*pi^2-30)", "double-cosine", 3),
    ("pi^(-3/2)", "gaussian", 3),
]


@pytest.mark.parametrize(("text", "name", "dim"), PUBLISHED)
def test_published_constants_are_identified_exactly_and_from_ten_digits(text, name, dim):
    exact = identify(text)
    assert (name, dim) in {(c.kernel, c.dim) for c in exact.candidates if c.match}
    digits = identify(f"{exact.value:.10g}")
    assert (name, dim) in {(c.kernel, c.dim) for c in digits.candidates if c.match}


@pytest.mark.parametrize("text", ["0", "-1", "pi-pi"])
def test_zero_and_negative_constants_are_refused(text):
    with pytest.raises(ValueError, match="positive"):
        identify(text)
