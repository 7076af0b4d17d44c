"""The catalogue against the literature: constants are derived here and published there."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from math import comb, factorial, inf, sqrt

import mpmath
import pytest
from mpmath import mp
from oracle import fraction, mass, one_sided, shape_of
from sympy import Expr, Rational, pi

from sphtrunc import kernel
from sphtrunc.kernels.catalogue import ALIASES, FAMILIES, SHAPES, named, names

R = Rational


def as_mp(x: Expr) -> mpmath.mpf:
    numerator, denominator = x.as_numer_denom()
    return (
        (mp.pi if numerator.has(pi) else 1)
        * mp.mpf(int(numerator.subs(pi, 1)))
        / ((mp.pi if denominator.has(pi) else 1) * int(denominator.subs(pi, 1)))
    )


def pos(x: Fraction) -> Fraction:
    return max(x, Fraction(0))


# -- everything in the catalogue -------------------------------------------------------------------


@pytest.mark.parametrize("name", names())
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_integral_is_one(name: str, dim: int) -> None:
    """∫Ŵ = 1 exactly, integrated here as fractions; π cancels against the sphere's."""
    k = kernel(name)
    total = mass(shape_of(k), dim)
    assert k.normalisation(dim) * (1 if dim == 1 else pi) * R(str(total)) == 1
    assert k.moment(0, dim) == 1


@pytest.mark.parametrize("name", names())
def test_every_kernel_is_one_a_person_would_expect(name: str) -> None:
    """Named, cited, positive, decreasing, and zero at its edge unless it says otherwise."""
    k = kernel(name)
    assert k.name == name
    assert len(k.source) > 20
    assert any(mark in k.source for mark in ("doi:10.", "Astrophys."))
    shape, support = shape_of(k), fraction(k.support)
    points = [support * i / 64 for i in range(65)]
    values = [one_sided(shape, x, -1) for x in points]
    assert all(v > 0 for v in values[:-1])
    assert all(a >= b for a, b in pairwise(values))
    assert (values[-1] == 0) == (name != "polynomial:-1")


def test_the_list_is_complete() -> None:
    assert len(names()) == len(set(names())) == len(ALIASES) + len(SHAPES) + 19 + 22
    assert FAMILIES == {"b-spline": (2, 20), "polynomial": (-1, 20)}
    wanted = [
        *["cubic-spline", "quartic-spline", "quintic-spline", "wendland-c2", "wendland-c4"],
        *["wendland-c6", "wendland-c8", "wendland-c2-1d", "wendland-c4-1d", "wendland-c6-1d"],
        *["poly6", "lucy", "johnson-quadratic", "spiky", "hyperbolic", "core-triangle"],
        *["linear-quartic", "thomas-couchman", "b-spline:2", "b-spline:20", "polynomial:-1"],
    ]
    assert set(wanted) <= set(names())


@pytest.mark.parametrize(
    ("alias", "target"),
    [
        ("cubic-spline", "b-spline:4"),
        ("quartic-spline", "b-spline:5"),
        ("quintic-spline", "b-spline:6"),
        ("poly6", "polynomial:2"),
        ("thomas-couchman", "core-triangle"),
        ("lucy", "wendland-c2-1d"),
    ],
)
def test_two_names_of_one_shape(alias: str, target: str) -> None:
    assert kernel(alias) == kernel(target)
    assert kernel(alias).name == alias


# -- published formulas and constants --------------------------------------------------------------

PRICE = "Price (2012) doi:10.1016/j.jcp.2010.12.011, eqs. 6-8"
DEHNEN = "Dehnen & Aly (2012) doi:10.1111/j.1365-2966.2012.21439.x, table 1"
MUELLER = "Müller, Charypar & Gross (2003) doi:10.2312/SCA03/154-159, eqs. 20-21"
LUCY = "Lucy (1977) doi:10.1086/112164"
JOHNSON = "Johnson, Stryk & Beissel (1996) doi:10.1016/S0045-7825(96)01089-4"
YANG = "Yang, Peng & Liu (2014) doi:10.1016/j.apm.2013.12.001"

Formula = Callable[[Fraction], Fraction]


def m4(q: Fraction) -> Fraction:
    return (pos(2 - q) ** 3 - 4 * pos(1 - q) ** 3) / 4


def m5(q: Fraction) -> Fraction:
    half = Fraction(1, 2)
    return pos(5 * half - q) ** 4 - 5 * pos(3 * half - q) ** 4 + 10 * pos(half - q) ** 4


def m6(q: Fraction) -> Fraction:
    return pos(3 - q) ** 5 - 6 * pos(2 - q) ** 5 + 15 * pos(1 - q) ** 5


def unit(formula: Formula) -> Formula:
    """A formula on a support of 1."""
    return lambda r: formula(r) if r < 1 else Fraction(0)


c2 = unit(lambda r: (1 - r) ** 4 * (1 + 4 * r))
c4 = unit(lambda r: (1 - r) ** 6 * (1 + 6 * r + Fraction(35, 3) * r**2))
c6 = unit(lambda r: (1 - r) ** 8 * (1 + 8 * r + 25 * r**2 + 32 * r**3))
c2_1d = unit(lambda r: (1 - r) ** 3 * (1 + 3 * r))
c4_1d = unit(lambda r: (1 - r) ** 5 * (1 + 5 * r + 8 * r**2))
c6_1d = unit(lambda r: (1 - r) ** 7 * (1 + 7 * r + 19 * r**2 + 21 * r**3))


def quadratic(q: Fraction) -> Fraction:
    return 3 * q**2 / 16 - 3 * q / 4 + Fraction(3, 4) if q < 2 else Fraction(0)


def hyperbolic(q: Fraction) -> Fraction:
    return q**3 - 6 * q + 6 if q < 1 else pos(2 - q) ** 3


#: catalogue name, support of the published formula, formula, {dim: its constant}, source
PUBLISHED: list[tuple[str, int | Rational, Formula, dict[int, Expr], str]] = [
    ("cubic-spline", 2, m4, {1: R(2, 3), 2: 10 / (7 * pi), 3: 1 / pi}, PRICE),
    ("quartic-spline", R(5, 2), m5, {1: R(1, 24), 2: 96 / (1199 * pi), 3: 1 / (20 * pi)}, PRICE),
    ("quintic-spline", 3, m6, {1: R(1, 120), 2: 7 / (478 * pi), 3: 1 / (120 * pi)}, PRICE),
    ("wendland-c2", 1, c2, {2: 7 / pi, 3: 21 / (2 * pi)}, DEHNEN),
    ("wendland-c4", 1, c4, {2: 9 / pi, 3: 495 / (32 * pi)}, DEHNEN),
    ("wendland-c6", 1, c6, {2: 78 / (7 * pi), 3: 1365 / (64 * pi)}, DEHNEN),
    ("wendland-c2-1d", 1, c2_1d, {1: R(5, 4)}, DEHNEN),
    ("wendland-c4-1d", 1, c4_1d, {1: R(3, 2)}, DEHNEN),
    ("wendland-c6-1d", 1, c6_1d, {1: R(55, 32)}, DEHNEN),
    ("poly6", 1, lambda r: pos(1 - r * r) ** 3, {3: 315 / (64 * pi)}, MUELLER),
    ("spiky", 1, lambda r: pos(1 - r) ** 3, {3: 15 / pi}, MUELLER),
    ("lucy", 1, c2_1d, {3: 105 / (16 * pi)}, LUCY),
    ("johnson-quadratic", 2, quadratic, {1: R(1), 2: 2 / pi, 3: 5 / (4 * pi)}, JOHNSON),
    ("hyperbolic", 2, hyperbolic, {1: R(1, 7), 2: 1 / (3 * pi), 3: 15 / (62 * pi)}, YANG),
]
CASES = [(n, s, f, d, c) for n, s, f, constants, _ in PUBLISHED for d, c in constants.items()]


@pytest.mark.parametrize(("name", "support", "formula", "dim", "constant"), CASES)
def test_published_kernel(
    name: str, support: Rational, formula: Formula, dim: int, constant: Expr
) -> None:
    """σ_d w equals constant times formula at more points than two polynomials could share."""
    k = kernel(name).scaled(support)
    ratio = fraction(constant / k.normalisation(dim))
    shape, edge = shape_of(k), fraction(support)
    for i in range(211):
        x = edge * i / 210
        assert one_sided(shape, x, -1) == ratio * formula(x)


@pytest.mark.parametrize(("name", "support", "formula", "dim", "constant"), CASES)
def test_published_constant_by_quadrature(
    name: str, support: Rational, formula: Formula, dim: int, constant: Expr
) -> None:
    """The published constants are right, and so is the second moment: Gauss-Legendre in mpmath."""
    with mpmath.workdps(40):
        edge = mp.mpf(int(R(support).p)) / int(R(support).q)
        knots = sorted({mp.mpf(0), *(mp.mpf(j) / 2 for j in range(1, 6) if mp.mpf(j) / 2 < edge)})

        def exact(x: mpmath.mpf) -> mpmath.mpf:
            man, exp = mp.frexp(x)
            whole = Fraction(int(mp.ldexp(man, 160))) * Fraction(2) ** (int(exp) - 160)
            value = formula(whole)
            return mp.mpf(value.numerator) / value.denominator

        def integral(power: int) -> mpmath.mpf:
            value = mp.quad(
                lambda x: x**power * exact(x), [*knots, edge], method="gauss-legendre", maxdegree=4
            )
            return {1: mp.mpf(2), 2: 2 * mp.pi, 3: 4 * mp.pi}[dim] * as_mp(constant) * value

        mass, second = integral(dim - 1), integral(dim + 1)
        found = kernel(name).scaled(support).moment(2, dim)
        assert abs(mass - 1) < mp.mpf(10) ** -35
        assert abs(second - mp.mpf(int(found.p)) / int(found.q)) < mp.mpf(10) ** -35


#: Dehnen & Aly (2012), table 1: {kernel: {dim: (σ²/H², H/h)}}; H: support, σ² = ∫ s² W / d, h = 2σ
STANDARD_DEVIATIONS = {
    "cubic-spline": {1: ("1/12", 1.732051), 2: ("31/392", 1.778002), 3: ("3/40", 1.825742)},
    "quartic-spline": {
        1: ("1/15", 1.936492),
        2: ("9759/152600", 1.977173),
        3: ("23/375", 2.018932),
    },
    "quintic-spline": {
        1: ("1/18", 2.121321),
        2: ("2771/51624", 2.158131),
        3: ("7/135", 2.195775),
    },
    "wendland-c2-1d": {1: ("2/21", 1.620185)},
    "wendland-c4-1d": {1: ("1/15", 1.936492)},
    "wendland-c6-1d": {1: ("2/39", 2.207940)},
    "wendland-c2": {2: ("5/72", 1.897367), 3: ("1/15", 1.936492)},
    "wendland-c4": {2: ("7/132", 2.171239), 3: ("2/39", 2.207940)},
    "wendland-c6": {2: ("3/70", 2.415230), 3: ("1/24", 2.449490)},
}


@pytest.mark.parametrize(
    ("name", "dim", "variance", "scale"),
    [(n, d, *row) for n, by_dim in STANDARD_DEVIATIONS.items() for d, row in by_dim.items()],
)
def test_second_moments(name: str, dim: int, variance: str, scale: float) -> None:
    """The fractions exactly; H/h to two units of its last decimal, which is not always rounded."""
    k = kernel(name)
    assert k.moment(2, dim) / (dim * k.support**2) == R(variance)
    assert abs(1 / (2 * sqrt(float(Fraction(variance)))) - scale) < 2e-6


def test_wendland_c8() -> None:
    """Positive definite in 3D and C⁸: (1 − r)₊^10 times a quartic, 5 + 50r + … (Wendland 1995).

    The polynomial follows from its smoothness: an even function at the origin up to r⁸.
    """
    k = kernel("wendland-c8").scaled(1)
    assert k.knot_smoothness() == {0: 8, 1: 9}
    piece = k.coefficients()[0]
    assert [bool(piece[i]) for i in (1, 3, 5, 7, 9)] == [False, False, False, False, True]
    assert k.degree == 14


@pytest.mark.parametrize("n", range(2, 21))
def test_b_splines(n: int) -> None:
    """M_n is the n-fold convolution of a box: C^{n−2}, of mass 1 and variance n/12, a partition of
    unity on the integers (Schoenberg 1946)."""
    k = named(f"b-spline:{n}")
    assert k.support == R(n, 2)
    assert k.degree == n - 1
    assert k.boundary_smoothness == n - 2
    assert set(k.knot_smoothness().values()) <= {n - 2, inf}
    assert k.moment(2, 1) == R(n, 12)
    assert k.moment(4, 1) == R(n, 12) ** 2 * 3 - R(n, 120)
    shape, sigma = shape_of(k), fraction(k.normalisation(1))
    x = Fraction(2, 7)
    assert sigma * sum(one_sided(shape, abs(x + j), -1) for j in range(-n, n + 1)) == 1
    factor = 4 if n == 4 else 1
    assert sigma == Fraction(factor, factorial(n - 1))


@pytest.mark.parametrize("beta", range(-1, 21))
def test_polynomials(beta: int) -> None:
    """(4 − q²)^{β+1}: β at the edge, smooth inside, ∫ by the beta function."""
    k = named(f"polynomial:{beta}")
    assert (k.boundary_smoothness, k.smoothness) == (beta, beta)
    assert k.knot_smoothness() == {0: inf, 2: beta}
    n = beta + 1
    wallis = Fraction(2 ** (2 * n + 1) * factorial(n) ** 2, factorial(2 * n + 1)) * 2 ** (2 * n + 1)
    assert fraction(k.normalisation(1)) == 1 / wallis
    assert [fraction(c) for c in k.coefficients()[0][::2]] == [
        (-1) ** i * comb(n, i) * 4 ** (n - i) for i in range(n + 1)
    ]


def test_core_triangle() -> None:
    """Read, Hayfield & Agertz (2010): the cubic spline, its slope held constant inside its steepest
    point q = 2/3 (1/3 of the support), where value and slope are continuous."""
    core, cubic = named("core-triangle"), named("cubic-spline")
    assert core.knots == (0, R(2, 3), 1, 2)
    assert core.coefficients()[1:] == cubic.coefficients()
    assert core.coefficients()[0][1] == -1
    assert core.knot_smoothness() == {0: 0, R(2, 3): 2, 1: 2, 2: 2}


def test_linear_quartic() -> None:
    """Valcke et al. (2010): F − x up to x = 0.3 of the support, then a quartic that joins with its
    first two derivatives and vanishes with them at the edge."""
    k = named("linear-quartic").scaled(1)
    assert k.knots == (0, R(3, 10), 1)
    assert k.knot_smoothness() == {0: 0, R(3, 10): 2, 1: 2}
    linear, quartic = k.coefficients()
    assert linear[1] == -1
    assert len(linear) == 2
    assert len(quartic) == 5


# -- names -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("spelling", [" Cubic-Spline ", "CUBIC-SPLINE", "b-spline:4", "B-Spline:4"])
def test_spelling_is_forgiven(spelling: str) -> None:
    assert named(spelling) == named("cubic-spline")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("cubic-splin", "did you mean cubic-spline"),
        ("cubicspline", "did you mean cubic-spline"),
        ("wendland", "did you mean wendland-c2?"),
        ("Wendland2C", "did you mean wendland-c2?"),
        ("WendlandQuinticC4", "did you mean wendland-c4?"),
        ("wendland_c6", "did you mean wendland-c6?"),
        ("wendlnd", "did you mean wendland-c2?"),
        ("quartic", "did you mean quartic-spline"),
        ("M6", "did you mean quintic-spline"),
        ("wendlandc2", "did you mean wendland-c2"),
        ("quintic", "did you mean quintic-spline"),
        ("spikey", "did you mean spiky"),
        ("bspline", "did you mean b-spline:N"),
        ("b-spline", "did you mean b-spline:N"),
        ("polynom", "did you mean polynomial:N"),
        ("gaussian", "sphtrunc kernels"),
        ("hoct4", "irrational"),
        ("b-spline:1", "N from 2 to 20"),
        ("b-spline:21", "N from 2 to 20"),
        ("b-spline:-4", "N from 2 to 20"),
        ("b-spline:4.0", "N from 2 to 20"),
        ("b-spline:", "N from 2 to 20"),
        ("b-spline:٤", "N from 2 to 20"),
        ("b-spline:--4", "N from 2 to 20"),
        ("b-spline:4-", "N from 2 to 20"),
        ("b-spline:-", "N from 2 to 20"),
        ("b-spline:1e1", "N from 2 to 20"),
        ("b-spline:" + "9" * 5000, "N from 2 to 20"),
        ("polynomial:-2", "N from -1 to 20"),
        ("polynomial:21", "N from -1 to 20"),
        ("x" * 5000, "sphtrunc kernels"),
    ],
)
def test_unknown_names(name: str, hint: str) -> None:
    with pytest.raises(ValueError, match="kernel") as error:
        named(name)
    assert hint in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250
