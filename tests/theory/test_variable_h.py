"""Variable h in theory: the inversion formula against integrals, and what it says exactly."""

from __future__ import annotations

from fractions import Fraction
from math import comb, factorial
from typing import Any

import mpmath
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sympy import Rational

from sphtrunc import derive, kernel
from sphtrunc.kernels.catalogue import names
from sphtrunc.kernels.gaussian import Gaussian
from sphtrunc.operators.h_rules import RULES
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.theory.variable_h.atmosphere import acceleration_errors, omega_slope
from sphtrunc.theory.variable_h.moments import (
    lattice_sums_of,
    limit_moments,
    mean_along,
    orders,
    series,
    varying,
)

#: whose gradient is a function: not the top hat's
POLYNOMIAL = [
    name
    for name in names()
    if not isinstance(kernel(name), Gaussian) and kernel(name).smoothness >= 0
]
CUBIC = kernel("cubic-spline")


def shape(name: str, q: Any, derivative: int) -> Any:
    """Ŵ^(n)(q) of the cubic spline or Wendland's C2 in 1D, typed in from the literature."""
    if name == "cubic-spline":
        pieces = [[1, 0, -1.5, 0.75], [2, -3, 1.5, -0.25]]
        sigma, ends = mpmath.mpf(2) / 3, (1, 2)
    else:  # (1 − q/2)³ (1 + 3q/2), Dehnen & Aly (2012) doi:10.1111/j.1365-2966.2012.21439.x
        pieces, sigma, ends = [[1, 0, -1.5, 1, -0.1875]], mpmath.mpf(5) / 8, (2,)
    for piece, end in zip(pieces, ends, strict=True):
        if q <= end:
            c = [mpmath.mpf(x) for x in piece]
            for _ in range(derivative):
                c = [n * x for n, x in enumerate(c)][1:]
            return sigma * sum(x * q**n for n, x in enumerate(c))
    return mpmath.mpf(0)


def integral(name: str, k: int, alpha: int, g: Any) -> Any:
    """(−1)^k ∫ s^α H^{−1−k} Ŵ^(k)(s/H) ds with H = 1 + g s, piece by piece."""

    def f(s: Any) -> Any:
        stretch = 1 + g * s
        t = s / stretch
        sign = mpmath.sign(t) ** k
        return (-1) ** k * s**alpha * sign * shape(name, abs(t), k) / stretch ** (1 + k)

    knots = [mpmath.mpf(p) / (1 - g * p) for p in (-2, -1, 0, 1, 2)]
    return mpmath.quad(f, knots)


@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2-1d"])
@pytest.mark.parametrize(("operator", "k"), [("value", 0), ("gradient", 1)])
@pytest.mark.parametrize("g", [Fraction(1, 5), Fraction(-2, 7)])
def test_limits_are_the_integrals(name: str, operator: str, k: int, g: Fraction) -> None:
    found = limit_moments(kernel(name), Operator(operator), [g], "scatter", 3)
    half = limit_moments(kernel(name), Operator(operator), [g], "mean", 3)
    with mpmath.workdps(25):
        slope = mpmath.mpf(g.numerator) / g.denominator
        for alpha in range(4):
            for moments, seen in ((found, slope), (half, slope / 2)):
                value = mpmath.mpf(str(moments[alpha]))
                assert abs(value - integral(name, k, alpha, seen)) < mpmath.mpf(10) ** -20


def test_a_limit_in_space_is_the_integral() -> None:
    """3D value and gradient of the cubic spline, g off the axes: a double integral in spherical
    coordinates about the direction of g."""
    g = [Fraction(1, 7), Fraction(-1, 9), Fraction(1, 11)]
    steep = mpmath.sqrt(sum(mpmath.mpf(x.numerator) ** 2 / x.denominator**2 for x in g))
    value = limit_moments(CUBIC, Operator("value"), g, "scatter", 0)[0, 0, 0]
    gradient = limit_moments(CUBIC, Operator("gradient"), g, "scatter", 1)

    def shell(t: Any, derivative: int) -> Any:
        ratio = mpmath.mpf(3) / 2 / mpmath.pi  # σ₃/σ₁ = (1/π)/(2/3)
        return ratio * shape("cubic-spline", t, derivative) * 2 * mpmath.pi * t**2

    def over(f: Any) -> Any:
        return mpmath.quad(f, [0, 1, 2], [-1, 1], maxdegree=4)

    # in t: ∫ (1 − g·t)^{−1} Ŵ, and the trace of −∫ t_j (1 − g·t)^{−1} ∂_iŴ
    assert float(value) == pytest.approx(
        float(over(lambda t, c: shell(t, 0) / (1 - steep * t * c))), abs=1e-12
    )
    trace = sum(
        limit_moments(CUBIC, Operator("gradient"), [*g[i:], *g[:i]], "scatter", 1)[1, 0, 0]
        for i in range(3)
    )
    assert gradient[1, 0, 0] != 1
    assert float(trace) == pytest.approx(
        float(over(lambda t, c: -t * shell(t, 1) / (1 - steep * t * c))), abs=1e-12
    )


@given(
    beta=st.tuples(*[st.integers(0, 3)] * 3),
    g=st.tuples(*[st.fractions(-2, 2, max_denominator=5)] * 3),
    n=st.integers(0, 4),
)
@settings(max_examples=60)
def test_means_over_directions(beta: Any, g: Any, n: int) -> None:
    """⟨e^β (g·e)^n⟩ against its multinomial expansion, in fractions."""
    total = Fraction(0)
    for i in range(n + 1):
        for j in range(n - i + 1):
            powers = (i, j, n - i - j)
            ways = comb(n, i) * comb(n - i, j)
            top, size = 1, 1
            for p, b in zip(powers, beta, strict=True):
                for m in range(p + b - 1, 0, -2):
                    top *= m
                size *= int((p + b) % 2 == 0)
            bottom = 1
            for m in range(3, 3 + n + sum(beta), 2):
                bottom *= m
            weight = g[0] ** i * g[1] ** j * g[2] ** powers[2]
            total += ways * weight * Fraction(top * size, bottom)
    assert mean_along(beta, g, n) == total


REFERENCE = {  # cubic spline, 1D, g = 1/5, twelve decimals (three routes: series, map, quadrature)
    ("value", "scatter", 0): "1.013841154879",
    ("gradient", "scatter", 1): "1.042598920932",
    ("gradient", "scatter", 2): "0.454162680037",
    ("gradient", "scatter", 3): "1.441149040187",
    ("gradient", "mean", 1): "1.010152896873",
    ("gradient", "mean", 2): "0.206175114836",
}


@pytest.mark.parametrize("case", REFERENCE)
def test_reference_values(case: tuple[str, str, int]) -> None:
    name, rule, k = case
    value = limit_moments(CUBIC, Operator(name), [Fraction(1, 5)], rule, k)[k]
    assert abs(Rational(str(value)) - Rational(REFERENCE[case])) <= Rational(1, 2 * 10**12)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", POLYNOMIAL)
def test_second_order_in_g(name: str, dim: int) -> None:
    """M₀ = 0, M₁ = 1 + {3, 3/4, 3/2}μ₂g², M₂ = {6, 3, 3}μ₂g, M_y = 0 and the transverse first
    moment 1 + μ₂g²·{1, 1/4, 1/2}, exactly, for every kernel; value 1 + μ₂g²."""
    shape_, zero = kernel(name), (0,) * dim
    mu = shape_.moment(2, dim) / dim
    e = (1, *zero[1:])
    two = (2, *zero[1:])
    for rule, square, first in (
        ("scatter", 3, 6),
        ("mean", Rational(3, 4), 3),
        ("mean-kernel", Rational(3, 2), 3),
        ("gather", 0, 0),
    ):
        found = series(shape_, Operator("gradient"), dim, rule, 2, 2)
        assert found[zero] == [0, 0, 0]
        assert found[e] == [1, 0, square * mu]
        assert found[two][1] == first * mu
        across = [(axis, key) for axis in range(1, dim) for key in [(*zero[:axis], 1)]]
        for axis, short in across:
            alpha = (*short, *zero[axis + 1 :])
            rows = orders(shape_, (alpha, alpha), {e: Fraction(1)}, rule, 2)
            assert [Rational(c.numerator, c.denominator) for c in rows] == [1, 0, square * mu / 3]
    assert series(shape_, Operator("value"), dim, "scatter", 0, 2)[zero] == [1, 0, mu]


@given(
    g=st.fractions(-1, 1, max_denominator=9),
    b=st.fractions(-1, 1, max_denominator=9),
    c=st.fractions(-1, 1, max_denominator=9),
)
def test_curvature_of_h(g: Fraction, b: Fraction, c: Fraction) -> None:
    """h = h_a (1 + gs + bs²/2 + cs³/6): scatter M₀ = μ₂(c + 3gb) and M₁ += 3bμ₂ at their orders;
    mean h M₀ = μ₂(c/2 + 3gb/4)."""
    profile = {(1,): g, (2,): b / 2, (3,): c / 6}
    mu = Fraction(1, 3)
    e = (1,)
    assert orders(CUBIC, (e, (0,)), profile, "scatter", 3)[3] == mu * (c + 3 * g * b)
    assert orders(CUBIC, (e, (1,)), profile, "scatter", 2)[2] == 3 * mu * (b + g * g)
    assert orders(CUBIC, (e, (0,)), profile, "mean", 3)[3] == mu * (c / 2 + 3 * g * b / 4)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("correction", ["csph", "rkpm-1", "rkpm-2"])
def test_corrections_stay_consistent(rule: str, correction: str) -> None:
    """A correction is algebra on whatever the sums are: exactly consistent under every rule."""
    form = "difference" if correction == "csph" else "standard"
    operator = Operator("gradient", form, correction)
    found = limit_moments(CUBIC, operator, [Fraction(1, 5)], rule, 2)
    for k in range(operator.consistency + 1):
        assert found[k] == operator.target(1).get((k,), 0)
        assert found[k].is_Rational


def test_lattice_sums_are_sums() -> None:
    """1D sums with a gradient of h, against fractions added up here."""
    g, step = Fraction(1, 5), Fraction(10, 13)

    def w(q: Fraction, k: int) -> Fraction:
        if k:
            inner = -3 * q + Fraction(9, 4) * q**2
            outer = -3 + 3 * q - Fraction(3, 4) * q**2
        else:
            inner = 1 - Fraction(3, 2) * q**2 + Fraction(3, 4) * q**3
            outer = 2 - 3 * q + Fraction(3, 2) * q**2 - Fraction(1, 4) * q**3
        return Fraction(2, 3) * (inner if q < 1 else outer if q < 2 else Fraction(0))

    keys = [((k,), (a,)) for k in (0, 1) for a in range(4)]
    found = lattice_sums_of(CUBIC, keys, Arrangement("uniform", step), [g], "scatter")
    for (k,), (a,) in keys:
        total = Fraction(0)
        for j in range(-20, 21):
            s = j * step
            stretch = 1 + g * s
            if stretch > 0:
                sign = (s > 0) - (s < 0)
                t = abs(s / stretch)
                total += (-1) ** k * s**a * sign**k * w(t, k) / stretch ** (1 + k) * step
        assert found[(k,), (a,)] == Rational(total.numerator, total.denominator)


@pytest.mark.parametrize("name", POLYNOMIAL)
def test_the_atmosphere_in_fractions(name: str) -> None:
    """Six rules in three dimensions: cubic polynomials in 1/d times μ₂, whatever the kernel."""
    for d in (1, 2, 3):
        x = Rational(1, d)
        assert acceleration_errors(kernel(name), d) == {
            "gather": x,
            "scatter": -2 * x + 6 * x**2 - 8 * x**3,
            "mean": -x / 2 + 9 * x**2 / 4 - 5 * x**3 / 2,
            "mean-kernel": -x / 2 + 3 * x**2 - 4 * x**3,
            "no-omega": x - 4 * x**3,
            "grad-h": 2 * x**2 - 4 * x**3,
        }
        slope = omega_slope(kernel(name), d)
        assert Rational(slope.numerator, slope.denominator) == kernel(name).moment(2, d) * x**2


def test_omega_of_a_wave() -> None:
    """Ω − 1 at the crest of ρ = 1 + ½ cos kx, kh = 0.1, cubic spline in 3D, with all orders: from
    exact moments of the summation, ρ = Σ (−k²)ⁿ h²ⁿ M_2n/(2n)!, of which h ∂ρ/∂h takes 2n times
    every term; and by quadrature of its Fourier transform. The leading term is −1/3000."""
    limit = derive(CUBIC, "value", dim=3, degree=12).limit
    k = Fraction(1, 10)
    terms = [
        Fraction(str(limit[2 * n, 0, 0])) * (-1) ** n * k ** (2 * n) / factorial(2 * n)
        for n in range(7)
    ]
    density = 1 + sum(terms) / 2
    omega = sum(2 * n * term for n, term in enumerate(terms)) / 2 / (3 * density)
    assert float(omega) == pytest.approx(-3.330503e-4, abs=5e-11)
    assert abs(float(omega) + 1 / 3000) < 4e-7

    def transform(kappa: Any) -> Any:
        """4π/κ ∫ q W sin κq with W of 3D, whose constant is 1/π in place of 2/3."""
        wave = mpmath.quad(
            lambda q: q * shape("cubic-spline", q, 0) * mpmath.sin(kappa * q), [0, 1, 2]
        )
        return 6 * wave / kappa

    slope = mpmath.diff(transform, 0.1) * 0.1
    assert float(slope / 6 / (1 + transform(0.1) / 2)) == pytest.approx(float(omega), rel=1e-7)


def test_what_is_refused() -> None:
    with pytest.raises(ValueError, match=r"h-gradient: .* below 1/2"):
        derive("cubic-spline", h_gradient="1/2")
    assert derive("cubic-spline", h_gradient="1/2", h_rule="gather").varying.limit[1] == 1
    assert derive("cubic-spline", h_gradient="3/5", h_rule="mean").varying is not None
    with pytest.raises(ValueError, match="h-rule: got 'both'"):
        derive("cubic-spline", h_gradient="1/5", h_rule="both")
    with pytest.raises(ValueError, match="h-gradient: the kernel has no edge"):
        derive("gaussian", h_gradient="1/5")
    with pytest.raises(ValueError, match="h-gradient: got 2 numbers"):
        derive("cubic-spline", dim=3, h_gradient=["1/5", "1/5"])
    with pytest.raises(ValueError, match="jitter: got a gradient of h"):
        derive("cubic-spline", dx_over_h="1/2", jitter="0.1", h_gradient="1/5")
    with pytest.raises(ValueError, match="volume: got summation"):
        varying(derive("cubic-spline", dx_over_h="1/2", volume="summation"), "1/5")
    with pytest.raises(ValueError, match="form: nested"):
        derive("cubic-spline", "laplacian", form="nested", h_gradient="1/5")


def test_the_derivation_says_it() -> None:
    found = derive("cubic-spline", degree=3, h_gradient="1/5", h_rule="mean", dx_over_h="1/2")
    data = found.to_dict()
    assert data["schema"] == "sphtrunc.derive/1"
    assert data["limit_moments"]["1"].startswith("1.010152896873")
    assert data["limit_moments"]["0"] == "0"
    assert (data["h_gradient"], data["h_rule"]) == (["1/5"], "mean")
    assert "rule mean" in found.to_text()
    assert "limit_moments" not in derive("cubic-spline").to_dict()
