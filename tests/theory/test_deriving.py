"""Exact theory against sums and integrals that share no code with it, as fractions."""

from __future__ import annotations

from fractions import Fraction
from math import factorial, log

import pytest
from hypothesis import assume, example, given, settings
from oracle import fraction, horner, line_sum, shape_of
from strategies import kernels, offsets, ratios
from sympy import Rational, bernoulli, sqrt

from sphtrunc import Kernel, Operator, derive, kernel
from sphtrunc.kernels.catalogue import names
from sphtrunc.operators.operator import CORRECTIONS, FORMS

HAT = Kernel([0, 1], [[1, -1]])
TOP_HAT = Kernel([0, 2], [[1]])


def has_neighbour(k: Kernel, ratio: Fraction, theta: Fraction) -> bool:
    near = (abs(j + theta) * ratio for j in (-int(theta // 1) - 1, -int(theta // 1), 1))
    return any(0 < distance < fraction(k.support) for distance in near)


@settings(max_examples=1000)
@given(k=kernels(), ratio=ratios, theta=offsets)
@example(k=HAT, ratio=Fraction(1, 3), theta=Fraction(0))
@example(k=TOP_HAT, ratio=Fraction(1, 2), theta=Fraction(0))
@example(k=TOP_HAT, ratio=Fraction(4, 3), theta=Fraction(1, 2))
def test_euler_maclaurin_is_the_lattice_sum(k, ratio, theta):
    """1,000 random kernels, seven moments of the value and of the gradient: equal as fractions."""
    assume(has_neighbour(k, ratio, theta))
    shape = shape_of(k)
    for derivative, operator in enumerate(("value", "gradient")):
        derived = derive(k, operator, degree=6, dx_over_h=ratio, offset=theta)
        summed = [line_sum(shape, derivative, n, ratio, theta) for n in range(7)]
        assert [fraction(derived.discrete[n]) for n in range(7)] == summed


def test_the_lattice_sum_notices_a_wrong_coefficient():
    """The agreement above can fail: one coefficient off by 1/1000 is seen in every moment."""
    right = kernel("cubic-spline")
    wrong = Kernel([0, 1, 2], [[1, 0, Fraction(-3, 2) + Fraction(1, 1000), "3/4"], right.pieces[1]])
    derived = derive(right, dx_over_h="10/13")
    summed = [line_sum(shape_of(wrong), 1, n, Fraction(10, 13)) for n in (1, 3, 5)]
    assert all(fraction(derived.discrete[n]) != s for n, s in zip((1, 3, 5), summed, strict=True))


@pytest.mark.parametrize(
    ("name", "m1"),
    [
        ("cubic-spline", "29200/28561"),
        ("quintic-spline", "4833775/4826809"),
        ("wendland-c2-1d", "375000/371293"),
    ],
)
def test_first_moment_at_ten_thirteenths(name, m1):
    assert str(derive(name, dx_over_h="10/13").discrete[1]) == m1


@pytest.mark.parametrize("n", [2, 3, 4, 7, 100])
def test_wendland_c2_with_knots_on_particles(n):
    """M_1 = 1 − 1/N⁴ for N = 2h/Δx: what the |s|³ kink at the origin leaves."""
    assert derive("wendland-c2", dx_over_h=Fraction(2, n)).discrete[1] == 1 - Rational(1, n**4)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 1000])
def test_cubic_spline_with_knots_on_particles_is_fraction(n):
    assert derive("cubic-spline", dx_over_h=Fraction(1, n)).discrete[1] == 1


def test_cubic_spline_is_exact_at_an_irrational_ratio():
    """h/Δx = √6 − 1, in exact algebraic numbers."""
    assert derive("cubic-spline", dx_over_h=1 / (sqrt(6) - 1)).discrete[1] == 1
    assert derive("cubic-spline", dx_over_h=1 / (sqrt(7) - 1)).discrete[1] != 1


def test_discretisation_part_at_four_elevenths():
    """The values of Quinlan, Basa & Lastiwka's special case, with and without interior knots."""
    poly = derive("polynomial:4", dx_over_h="4/11").discretisation[1]
    cubic = derive("cubic-spline", dx_over_h="4/11").discretisation[1]
    assert round(float(poly), 12) == -0.000228926475
    assert round(float(cubic), 12) == -0.003346765931


@pytest.mark.parametrize("beta", [2, 4, 6, 8])
@pytest.mark.parametrize("n", [5, 11, 101])
def test_the_aligned_formula_is_the_leading_term(beta, n):
    """Single piece, even β, edges half-way between particles: the closed form of the source.

    +(Δx/h)^{β+2} B_{β+2}/(β+2)! (1 − 2^{−β−1}) [2κ Ŵ^{(β+2)}(κ) + 2(β+1) Ŵ^{(β+1)}(κ)], with the
    sign that makes it agree (the source has the opposite one).
    """
    k = kernel(f"polynomial:{beta}")
    ratio = Rational(4, n)
    inner = {m: -k.jumps(m)[k.support] for m in (beta + 1, beta + 2)}
    formula = (
        ratio ** (beta + 2)
        * bernoulli(beta + 2)
        / factorial(beta + 2)
        * (1 - Rational(1, 2 ** (beta + 1)))
        * (4 * inner[beta + 2] + 2 * (beta + 1) * inner[beta + 1])
    )
    derived = derive(k, dx_over_h=ratio)
    leading = sum(
        t.coefficient * ratio**t.dx_power * bernoulli(t.dx_power, Rational(1, 2))
        for t in derived.terms
        if t.moment == 1 and t.dx_power == beta + 2
    )
    assert leading == formula
    assert derived.orders.aligned == beta + 2


# -- corrections ----------------------------------------------------------------------------------


class Dual:
    """a + b ε with ε² = 0: the oracle's derivative with respect to the point of evaluation."""

    def __init__(self, a, b=0):
        self.a, self.b = Fraction(a), Fraction(b)

    def __add__(self, o):
        o = o if isinstance(o, Dual) else Dual(o)
        return Dual(self.a + o.a, self.b + o.b)

    __radd__ = __add__

    def __neg__(self):
        return Dual(-self.a, -self.b)

    def __sub__(self, o):
        return self + (-o)

    def __mul__(self, o):
        o = o if isinstance(o, Dual) else Dual(o)
        return Dual(self.a * o.a, self.a * o.b + self.b * o.a)

    __rmul__ = __mul__

    def __truediv__(self, o):
        return Dual(self.a / o.a, (self.b * o.a - self.a * o.b) / o.a**2)


def cramer(matrix, column):
    """First unknown of a linear system, by determinants."""

    def det(m):
        if not m:
            return Dual(1)
        return sum(
            (
                (-1) ** j * m[0][j] * det([row[:j] + row[j + 1 :] for row in m[1:]])
                for j in range(len(m))
            ),
            Dual(0),
        )

    def replaced(i):
        return [[*row[:i], c, *row[i + 1 :]] for row, c in zip(matrix, column, strict=True)]

    whole = det(matrix)
    return [det(replaced(i)) / whole for i in range(len(matrix))]


def rkpm_moments(k: Kernel, m: int, dx: Fraction, theta: Fraction, degree: int):
    """(M_n of the value, M_n of the gradient) of the RKPM interpolant, by Dual arithmetic."""
    knots, pieces = shape_of(k)
    span = range(int(-knots[-1] / dx - theta) - 2, int(knots[-1] / dx - theta) + 3)
    points = [(j + theta) * dx for j in span]
    points = [s for s in points if abs(s) < knots[-1]]
    moved = [Dual(s, -1) for s in points]  # s = (x_b − x)/h, differentiated by x
    weights = []
    for s in moved:
        x = s if s.a >= 0 else -s
        piece = next(p for a, b, p in zip(knots, knots[1:], pieces, strict=False) if a <= x.a < b)
        weights.append(horner(piece, x))

    def power(s, n):
        out = Dual(1)
        for _ in range(n):
            out = out * s
        return out

    matrix = [
        [
            sum((w * power(s, i + j) for w, s in zip(weights, moved, strict=True)), Dual(0))
            for j in range(m + 1)
        ]
        for i in range(m + 1)
    ]
    c = cramer(matrix, [Dual(int(i == 0)) for i in range(m + 1)])
    corrected = [
        w * sum((c_i * power(s, i) for i, c_i in enumerate(c)), Dual(0))
        for w, s in zip(weights, moved, strict=True)
    ]
    sums = [
        sum((w * s**n for w, s in zip(corrected, points, strict=True)), Dual(0))
        for n in range(degree + 1)
    ]
    return [x.a for x in sums], [x.b for x in sums]


@pytest.mark.parametrize("m", [0, 1, 2, 3])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c4", "polynomial:4", "hyperbolic"])
@pytest.mark.parametrize("theta", [Fraction(1, 3), Fraction(1, 7)])
def test_corrected_moments_are_those_of_the_corrected_interpolant(name, m, theta):
    k, ratio = kernel(name), Fraction(5, 13)
    correction = f"rkpm-{m}" if m else "shepard"
    value, gradient = rkpm_moments(k, m, ratio, theta, 5)
    for operator, summed in (("value", value), ("gradient", gradient)):
        derived = derive(k, operator, correction=correction, dx_over_h=ratio, offset=theta)
        assert [fraction(derived.discrete[n]) for n in range(6)] == summed


OPERATORS = [
    Operator(name, form, correction)
    for name in ("value", "gradient")
    for form in FORMS
    for correction in CORRECTIONS
    if name == "gradient" or not correction.startswith("csph")
]


@pytest.mark.parametrize("operator", OPERATORS, ids=str)
def test_consistency_is_attained_and_not_exceeded(operator):
    """Every kernel of the catalogue: exact up to the degree that the operator says, no further.

    Not further on every lattice: on one of two a spline may happen to be exact.
    """
    m = operator.consistency
    for name in sorted(set(names()) - {"polynomial:-1"}):  # the top-hat has no gradient
        k = kernel(name)
        exceeded = True
        for ratio, theta in (("2/7", "1/5"), ("4/19", "2/5")):
            at = {"dx_over_h": k.support * Rational(ratio), "offset": theta}
            errors = derive(k, operator, degree=4, **at).discrete.error
            assert all(e == 0 for (n,), e in errors.items() if n <= m)
            exceeded = exceeded and errors[m + 1,] == 0
        assert not exceeded, name


def test_a_kernel_without_gradient_has_no_gradient_to_correct():
    with pytest.raises(ValueError, match="singular"):
        derive("polynomial:-1", correction="csph", dx_over_h="3/7")


# -- the continuous limit -------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "polynomial:4", "lucy"])
def test_smoothing_error_is_the_series_of_kernel_moments(name, dim):
    """c_n R_{2n} h^{2n} D∇^{2n}A, c_n = 1/(2^n n! d(d+2)…(d+2n−2)), for value and gradient."""
    k = kernel(name)
    for operator in ("value", "gradient"):
        rows = derive(k, operator, dim=dim, degree=7).smoothing_error
        for _, p, c in rows:
            n = p // 2
            product = 1
            for i in range(n):
                product *= dim + 2 * i
            assert c == k.moment(2 * n, dim) / (2**n * factorial(n) * product)
        assert [p for _, p, _ in rows] == [2, 4, 6]


@pytest.mark.parametrize(
    ("correction", "operator", "order"),
    [
        ("none", "value", 2),
        ("none", "gradient", 2),
        ("rkpm-1", "value", 2),
        ("rkpm-2", "value", 4),
        ("rkpm-3", "value", 4),
        ("rkpm-2", "gradient", 4),
        ("rkpm-3", "gradient", 4),
        ("csph", "gradient", 2),
    ],
)
def test_smoothing_orders(correction, operator, order):
    form = "difference" if correction == "csph" else "standard"
    for dim in (1, 2, 3):
        derived = derive("quintic-spline", operator, form=form, correction=correction, dim=dim)
        assert derived.orders.smoothing == order


@pytest.mark.parametrize(
    ("name", "generic", "aligned"),
    [
        # (4 − q²)^{β+1}: β + 1, and at aligned ratios β + 2 for even β, β + 1 for odd β
        *[(f"polynomial:{b}", b + 1, b + 2 - b % 2) for b in range(1, 21)],
        ("cubic-spline", 3, 3),  # the interior knot is not aligned
        ("wendland-c2", 4, 4),  # the origin decides: |s|³ there, β = 3 at the edge
    ],
)
def test_discretisation_orders(name, generic, aligned):
    derived = derive(name)
    assert (derived.orders.generic, derived.orders.aligned) == (generic, aligned)


@pytest.mark.parametrize("beta", [1, 2, 3, 4])
def test_discretisation_orders_are_attained_and_not_exceeded(beta):
    """The exact error along aligned and generic ratios, over a factor of ten in Δx/h."""
    k = kernel(f"polynomial:{beta}")
    derived = derive(k)

    def slope_of(numbers, step):
        errors = [abs(derive(k, dx_over_h=step(n)).discretisation[1]) for n in numbers]
        first, last = step(numbers[0]), step(numbers[1])
        return float(log(float(errors[0] / errors[1])) / log(float(first / last)))

    aligned = slope_of((41, 401), lambda n: Rational(4, n))
    generic = slope_of((40, 400), lambda n: Rational(4 * 7, 7 * n + 2))  # one phase, 2/7
    assert derived.orders.aligned - 0.1 < aligned < derived.orders.aligned + 0.1
    assert derived.orders.generic - 0.1 < generic < derived.orders.generic + 0.1


# -- arguments ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"dx_over_h": 0}, "positive rational"),
        ({"dx_over_h": "-1/2"}, "positive rational"),
        ({"dx_over_h": 0.5}, 'write "1/2"'),
        ({"dx_over_h": "13/2"}, "did you mean h/Δx"),
        ({"dx_over_h": 2}, "did you mean h/Δx"),
        ({"offset": 0.5, "dx_over_h": "1/2"}, "offset"),
        ({"dim": 4}, "expected 1, 2 or 3"),
        ({"degree": 41}, "degree"),
        ({"degree": -1}, "degree"),
        ({"operator": "rotation"}, "expected one of value, gradient"),
        ({"form": "brookshaw"}, "standard, difference"),
        ({"correction": "rkpm-4"}, "expected one of none"),
        ({"operator": "value", "correction": "csph"}, "corrects a gradient"),
        ({"correction": "rkpm-3", "dx_over_h": "3/2"}, "singular"),
        ({"kernel": "0..2: q - 1"}, "cannot be normalised"),
    ],
)
def test_bad_arguments_say_what_to_do(arguments, says):
    with pytest.raises(ValueError, match=says) as caught:
        derive(**{"kernel": "cubic-spline", **arguments})
    assert len(str(caught.value).splitlines()) == 1
