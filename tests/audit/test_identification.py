"""Every constant of every kernel, dimension and convention is recognised, the usual owner first."""

from __future__ import annotations

from fractions import Fraction
from math import pi

import mpmath
import pytest
from sympy import Rational
from sympy import pi as exact_pi

from sphtrunc import kernel
from sphtrunc.audit.identification import identify, known_constants, resemblance
from sphtrunc.audit.recognition import same_shape
from sphtrunc.kernels import catalogue, gaussian
from sphtrunc.kernels.conventions import CONVENTIONS, convert, half_width

#: Dehnen & Aly (2012), doi:10.1111/j.1365-2966.2012.21439.x, table 1: C of C (1 − u)₊^n …, u = r/H
DEHNEN_ALY = {
    "cubic-spline": {1: "8/3", 2: "80/(7*pi)", 3: "16/pi"},
    "quartic-spline": {1: "3125/768", 2: "46875/(2398*pi)", 3: "15625/(512*pi)"},
    "quintic-spline": {1: "243/40", 2: "15309/(478*pi)", 3: "2187/(40*pi)"},
    "wendland-c2": {2: "7/pi", 3: "21/(2*pi)"},
    "wendland-c4": {2: "9/pi", 3: "495/(32*pi)"},
    "wendland-c6": {2: "78/(7*pi)", 3: "1365/(64*pi)"},
    "wendland-c2-1d": {1: "5/4"},
    "wendland-c4-1d": {1: "3/2"},
    "wendland-c6-1d": {1: "55/32"},
}
TABLE = [(name, dim, text) for name, row in DEHNEN_ALY.items() for dim, text in row.items()]


@pytest.mark.parametrize(("name", "dim", "text"), TABLE)
def test_constants_on_the_support_come_first(name: str, dim: int, text: str) -> None:
    """As printed in a table of the field; none is given to a kernel that nobody uses."""
    first = identify(text).candidates[0]
    assert first.match
    assert (first.dim, first.convention) == (dim, "support 1h")
    assert first.kernel == name


#: (constant, kernel, dimension): of h with support 2h, 5/2 h and 3h, and of unit integral in 1D
FIRST = [
    ("2/3", "cubic-spline", 1),
    ("10/(7*pi)", "cubic-spline", 2),
    ("15/(7*pi)", "cubic-spline", 2),  # Monaghan & Lattanzio (1985): ∫ dq of the shape is 1
    ("3/(2*pi)", "cubic-spline", 3),
    ("1/(4*pi)", "cubic-spline", 3),
    ("40/(7*pi)", "cubic-spline", 2),
    ("96/(1199*pi)", "quartic-spline", 2),
    ("1/(20*pi)", "quartic-spline", 3),
    ("7/(478*pi)", "quintic-spline", 2),
    ("1/(120*pi)", "quintic-spline", 3),
    ("63/(478*pi)", "quintic-spline", 2),
    ("7/(4*pi)", "wendland-c2", 2),
    ("21/(16*pi)", "wendland-c2", 3),
    ("7/(64*pi)", "wendland-c2", 2),  # of (2 − q)^4 (1 + 2q)
    ("21/(256*pi)", "wendland-c2", 3),
    ("495/(256*pi)", "wendland-c4", 3),
    ("165/(32*pi)", "wendland-c4", 3),  # of (1 − u)^6 (3 + 18u + 35u²)
    ("1365/(512*pi)", "wendland-c6", 3),
    ("357/(64*pi)", "wendland-c8", 3),  # of (1 − u)^10 (5 + 50u + …)
    ("315/(64*pi)", "poly6", 3),
    ("4/pi", "poly6", 2),
    ("15/pi", "spiky", 3),
    ("10/pi", "spiky", 2),
    ("105/(16*pi)", "lucy", 3),
    ("5/pi", "lucy", 2),
    ("pi^(-3/2)", "gaussian", 3),
    ("(2/pi)^(3/2)", "gaussian", 3),  # of exp(−2 r²/h²), h = 2σ
]


@pytest.mark.parametrize(("text", "name", "dim"), FIRST)
def test_the_usual_owner_comes_first(text: str, name: str, dim: int) -> None:
    first = identify(text).candidates[0]
    assert first.match
    assert (first.kernel, first.dim) == (name, dim)


def lengths(name: str, dim: int) -> dict[str, mpmath.mpf]:
    """ℓ/h of every convention of `convert` that is a length, from `convert` itself, as numbers."""
    resolution = convert(name, dim, h=1)
    found = {}
    for what, data in CONVENTIONS.items():
        if data.length:
            try:
                found[what] = mpmath.mpf(resolution[what].evalf(30))
            except ValueError:  # a top-hat has no half maximum, a super-Gaussian no 2σ
                continue
    return found


NAMES = [name for name in [*catalogue.names(), *gaussian.names()] if not name.endswith("infinite")]


@pytest.mark.parametrize("name", NAMES)
def test_every_kernel_in_every_dimension_and_convention_is_recognised(name: str) -> None:
    """From 14 digits of σ_d (ℓ/h)^d; aliases and kernels of equal shape answer for each other."""
    shape = kernel(name)
    tried = 0
    for dim in (1, 2, 3):
        sigma = mpmath.mpf(shape.normalisation(dim).evalf(30))
        for what, length in lengths(name, dim).items():
            if what == "support" and not shape.is_polynomial and shape.cut is None:
                continue
            found = identify(mpmath.nstr(sigma * length**dim, 14), most=40)
            owners = {(c.kernel, c.dim) for c in found.candidates if c.match}
            assert any(d == dim and alike(owner, name) for owner, d in owners), (what, found)
            tried += 1
    assert tried >= 5 or name == "polynomial:-1"


def alike(one: str, other: str) -> bool:
    a, b = kernel(one) if one not in ("double-cosine", "cosine") else None, kernel(other)
    if a is None or not (a.is_polynomial and b.is_polynomial):
        return one == other
    return same_shape(a, b)


def test_half_widths_are_roots_to_fifty_digits() -> None:
    with mpmath.workdps(50):
        root = half_width(kernel("cubic-spline"))
        assert abs(mpmath.mpf(3) / 4 * root**3 - mpmath.mpf(3) / 2 * root**2 + 0.5) < 1e-48
        assert abs(half_width(kernel("gaussian")) - mpmath.sqrt(mpmath.log(2))) < 1e-48
    assert half_width(kernel("polynomial:-1")) == 0
    assert half_width(kernel("0..1: 1; 1..2: 1/4")) == 0


# -- near misses ----------------------------------------------------------------------------------


def test_a_wrong_power_of_a_support_is_a_near_miss() -> None:
    """7/(478 π) × (5/2)³: M6 in 2D, with a power of another support."""
    found = identify("875/(3824*pi)")
    first = found.candidates[0]
    assert (first.kernel, first.dim, first.ratio) == ("quintic-spline", 2, Rational(125, 8))
    assert "ratio 125/8 = (5/2)^3" in found.to_text()


@pytest.mark.parametrize(
    ("text", "name", "dim", "ratio"),
    [
        ("3/(359*pi)", "quintic-spline", 3, Rational(360, 359)),
        ("96/(1189*pi)", "quartic-spline", 2, Rational(1199, 1189)),
        ("7/(487*pi)", "quintic-spline", 2, Rational(478, 487)),
        ("7/478", "quintic-spline", 2, exact_pi),
        ("2*15309/(478*pi)", "quintic-spline", 2, Rational(2)),
    ],
)
def test_misprints_and_lost_factors_are_near_misses(
    text: str, name: str, dim: int, ratio: object
) -> None:
    first = identify(text).candidates[0]
    assert not first.match
    assert (first.kernel, first.dim, first.ratio) == (name, dim, ratio)


def test_what_is_no_constant_gets_no_owner() -> None:
    assert identify("1.2345").candidates == ()
    assert identify("17/(1301*pi)").candidates == ()


def test_the_power_of_h_says_the_dimension() -> None:
    assert {c.dim for c in identify("1/(pi*h^3)").candidates} == {3}
    assert {c.dim for c in identify("1/(pi*h^2)").candidates} == {2}


def test_few_digits_are_said_to_be_few() -> None:
    assert "by chance" in identify("0.3183").to_text()
    assert "by chance" not in identify("0.31830988618").to_text()


@pytest.mark.parametrize("ratio", ["2", "1/8", "27/8", "360/359"])
def test_simple_ratios_say_more_than_others(ratio: str) -> None:
    """A power, or a number near one, is rarer than a ratio of the same size that is neither."""
    middling, worse = resemblance(Fraction(113, 71)), resemblance(Fraction(853, 127))
    assert resemblance(Fraction(ratio)) < 10 < middling < worse
    assert resemblance(Fraction(1)) == 0


def test_the_table_of_constants_is_what_the_catalogue_derives() -> None:
    """σ_d of the shapes, integrated here in fractions, for the B-splines and the polynomials."""
    known = {(k.kernel, k.dim, k.length, k.form): k.value for k in known_constants()}
    for beta in (0, 1, 3, 4):  # ∫ (4 − q²)^n q^(d−1) dq by the beta function
        for dim, surface in ((1, 2.0), (2, 2 * pi), (3, 4 * pi)):
            n, half = beta + 1, dim / 2
            whole = 4**n * 2**dim * float(mpmath.beta(half, n + 1)) / 2
            value = known[f"polynomial:{beta}", dim, "h", "constant"]
            assert value == pytest.approx(1 / (surface * whole), rel=1e-12)
    assert known["cubic-spline", 1, "h", "constant"] == pytest.approx(2 / 3, rel=1e-15)
    assert known["b-spline:2", 1, "h", "constant"] == 1.0
