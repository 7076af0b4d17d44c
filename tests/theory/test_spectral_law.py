"""The law of disorder from the structure factor, against exact norms, closed forms of others, and
Monte Carlo that shares only kernel values."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import exp, sqrt
from typing import Any

import numpy as np
import pytest
from scipy import integrate
from sympy import Rational, log, pi

from sphtrunc import kernel
from sphtrunc.kernels.transform import transform
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import SLOPE, VALUE
from sphtrunc.theory.disorder.leading_law import gradient_norm, squared_norm
from sphtrunc.theory.disorder.spectral_law import evaluate, interpolated, predict_from
from sphtrunc.theory.disorder.structure_factor import (
    StructureFactor,
    correlated,
    displaced,
    poisson,
)
from sphtrunc.theory.reciprocal_sums import symbol

C2_1D = "0..2: (1-q/2)^3*(3*q/2+1)"
STANDARD = Operator("gradient")
CSPH = Operator("gradient", "difference", "csph")
RKPM = Operator("gradient", "standard", "rkpm-1")
KIND = {1: "uniform", 2: "square", 3: "cubic"}


def row(dim: int, power: int, k: int, c: Any = 1) -> tuple[Any, tuple[int, ...], int]:
    """c s₁^power f_k."""
    return (c, (power, *(0,) * (dim - 1)), k)


# ------------------------------------------------------------------------------ exact norms (A7)


@pytest.mark.parametrize(
    ("rows", "cubic", "c2"),
    [
        ([row(1, 0, VALUE)], Rational(151, 315), Rational(25, 56)),
        ([row(1, 1, SLOPE)], Rational(2, 3), Rational(15, 28)),
        ([row(1, 2, SLOPE)], Rational(8, 21), Rational(5, 14)),
        ([row(1, 3, SLOPE)], Rational(109, 315), Rational(30, 77)),
    ],
    ids=["W", "W'", "sW'", "s2W'"],
)
def test_norms_in_1d(rows: list[Any], cubic: Rational, c2: Rational) -> None:
    """The spread over independent particles; fractions found by hand integration."""
    assert squared_norm(kernel("cubic-spline"), tuple(rows)) == cubic
    assert squared_norm(kernel(C2_1D), tuple(rows)) == c2


@pytest.mark.parametrize(
    ("rows", "cubic", "c2"),
    [
        ([row(1, 1, SLOPE)], Rational(8, 3), Rational(15, 8)),
        ([row(1, 2, SLOPE)], Rational(4, 3), Rational(15, 14)),
        ([row(1, 3, SLOPE)], Rational(136, 105), Rational(10, 7)),
    ],
    ids=["W''", "(sW')'", "(s2W')', of CSPH"],
)
def test_gradient_norms_in_1d(rows: list[Any], cubic: Rational, c2: Rational) -> None:
    assert gradient_norm(kernel("cubic-spline"), tuple(rows)) == cubic
    assert gradient_norm(kernel(C2_1D), tuple(rows)) == c2


@pytest.mark.parametrize(
    ("name", "mu2", "norm"),
    [
        ("cubic-spline", Fraction(1, 3), Rational(3064, 945)),
        (C2_1D, Fraction(8, 21), Rational(475, 147)),
    ],
)
def test_norm_of_the_reproducing_gradient(name: str, mu2: Fraction, norm: Rational) -> None:
    """‖((s² − μ₂)Ŵ)″‖²: the first derivative as rows, the second by the norm of its gradient."""
    assert Fraction(str(kernel(name).moment(2))) == mu2
    rows = (row(1, 1, VALUE, 2), row(1, 3, SLOPE), row(1, 1, SLOPE, -mu2))
    assert gradient_norm(kernel(name), rows) == norm


@pytest.mark.parametrize(
    ("name", "dim", "value", "slope", "curvature"),
    [
        (
            "cubic-spline",
            2,
            Rational(515, 686) / pi,
            Rational(15, 14) / pi,
            225 * (8 * log(2) - 3) / (98 * pi),
        ),
        (
            "wendland-c2",
            2,
            Rational(343, 396) / pi,
            Rational(35, 24) / pi,
            Rational(315, 32) / pi,
        ),
        ("cubic-spline", 3, Rational(491, 1260) / pi, Rational(4, 7) / pi, 4 / pi),
        ("wendland-c2", 3, Rational(49, 104) / pi, Rational(35, 44) / pi, Rational(105, 16) / pi),
    ],
)
def test_norms_in_space(name: str, dim: int, value: Any, slope: Any, curvature: Any) -> None:
    shape = kernel(name)
    assert squared_norm(shape, (row(dim, 0, VALUE),)) - value == 0
    assert squared_norm(shape, (row(dim, 1, SLOPE),)) - slope == 0
    assert (gradient_norm(shape, (row(dim, 1, SLOPE),)) - curvature).equals(0)


# ---------------------------------------------------------------------------- the test functions


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_angular_means_of_the_gradient_moments(dim: int) -> None:
    """Means over directions of |ĝ|² from F and its derivatives, against nodes on the sphere."""
    shape = kernel("wendland-c2")
    kappa = np.array([0.3, 1.7, 4.2])
    f, df, ddf = (transform(shape, kappa, dim, n) for n in range(3))
    d = dim
    curved = ddf - df / kappa  # D/κ … μ³(κF″ − F′) = μ³κ(F″ − F′/κ)
    a2, a4, a6 = 1 / d, 3 / (d * (d + 2)), 15 / (d * (d + 2) * (d + 4))
    e = [1] + [0] * (dim - 1)
    expected = {
        0: kappa**2 * f**2 * a2,
        1: f**2 + 2 * kappa * f * df * a2 + (kappa * df) ** 2 * a4,
        2: 9 * a2 * df**2 + 6 * a4 * df * kappa * curved + a6 * (kappa * curved) ** 2,
    }
    nodes, weight = directions(dim)
    for n, mean in expected.items():
        alpha = tuple(n * x for x in e)
        found = [
            float((weight * np.abs(evaluate(shape, symbol(tuple(e), alpha), k * nodes)) ** 2).sum())
            for k in kappa
        ]
        np.testing.assert_allclose(found, mean, rtol=1e-7)
    assert dim == 1 or expected[1][0] > 0.9


def directions(dim: int) -> tuple[Any, Any]:
    """Unit vectors (d, D) and weights of a mean over the sphere, Gauss in z and even in φ."""
    if dim == 1:
        return np.array([[1.0, -1.0]]), np.array([0.5, 0.5])
    phi = 2 * np.pi * np.arange(24) / 24
    if dim == 2:
        return np.stack([np.cos(phi), np.sin(phi)]), np.full(24, 1 / 24)
    z, w = np.polynomial.legendre.leggauss(12)
    s = np.sqrt(1 - z**2)
    e = [np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(24))]
    return np.stack([x.ravel() for x in e]), np.outer(w / 2, np.full(24, 1 / 24)).ravel()


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_interpolated_transforms_keep_their_digits(dim: int) -> None:
    shape = kernel("cubic-spline")
    k = np.linspace(0.003, 40, 700)
    from sphtrunc.kernels.transform import radial

    for m in (0, 1, 2):
        envelope = float(radial(shape, np.zeros(1), dim, m)[0])
        error = np.abs(interpolated(shape, k, dim, m) - radial(shape, k, dim, m))
        assert error.max() < 1e-8 * envelope


def test_transform_of_the_brookshaw_term() -> None:
    """Φ₋₁ is that of −Ŵ′/q: in 3D ∫ 4πq² (−Ŵ′/q) sin(kq)/(kq), by another quadrature."""
    from sphtrunc.kernels.transform import radial

    shape = kernel("wendland-c2")
    for k in (0.5, 3.0, 11.0):
        value, _ = integrate.quad(
            lambda q, k=k: -4 * np.pi * float(shape.dw(q, 3)) * np.sin(k * q) / k, 0, 2, limit=200
        )
        assert float(radial(shape, k, 3, -1)) == pytest.approx(value, rel=1e-9)


# ------------------------------------------------------------------------- processes (A2, A4, A5)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2"])
def test_independent_particles_have_the_norm(name: str, dim: int) -> None:
    shape = kernel(name)
    found = predict_from(shape, STANDARD, poisson(dim), 0.5, degree=1)
    zero, one = (0,) * dim, (1,) + (0,) * (dim - 1)
    norms = [
        float(squared_norm(shape, (row(dim, 1, SLOPE),))),
        float(squared_norm(shape, (row(dim, 2, SLOPE),))),
    ]
    assert found.std[zero] ** 2 == pytest.approx(0.5**dim * norms[0], rel=2e-6)
    assert found.std[one] ** 2 == pytest.approx(0.5**dim * norms[1], rel=2e-6)
    assert found.mean[one] == pytest.approx(1.0, abs=1e-9)


def test_offset_averaged_jitter_of_any_size() -> None:
    """V∫[g² − (g∗N_σ)²] at r = ½, σ = 0.2 Δx in 1D, by quadrature in real space."""
    shape, r, sigma = kernel("cubic-spline"), 0.5, 0.1
    factor = replace(displaced("uniform", 0.2), home=None)
    found = predict_from(shape, STANDARD, factor, r, degree=1)
    s = np.linspace(-3, 3, 24001)
    step = s[1] - s[0]
    t = np.linspace(-0.7, 0.7, 5601)
    normal = np.exp(-0.5 * (t / sigma) ** 2)
    normal /= normal.sum()
    for n, known in ((0, 1.28859910e-2), (1, 6.3054027e-3)):
        g = -np.sign(s) * shape.dw(np.abs(s)) * s**n
        smooth = np.convolve(g, normal, mode="same")
        variance = r * step * float((g * g - smooth * smooth).sum())
        assert found.std[(n,)] ** 2 == pytest.approx(variance, rel=1e-4)
        assert found.std[(n,)] ** 2 == pytest.approx(known, rel=2e-7)


def test_means_seen_from_a_displaced_particle() -> None:
    """1D cubic at r = 1, σ = 0.2 Δx: the sum over sites of ⟨g⟩ over the difference of two Gaussian
    displacements, and the particle itself, in real space."""
    shape, sigma = kernel("cubic-spline"), 0.2 * sqrt(2)
    factor = displaced("uniform", 0.2)
    value = predict_from(shape, Operator("value"), factor, 1, at="particles", degree=0).mean[(0,)]
    slope = predict_from(shape, STANDARD, factor, 1, at="particles", degree=1).mean[(1,)]
    t = np.linspace(-6, 6, 4001) * sigma
    weight = np.exp(-0.5 * (t / sigma) ** 2)
    weight /= weight.sum()
    seen = [n + t for n in (-3, -2, -1, 1, 2, 3)]
    expected = float(shape.w(0.0)) + sum(float((weight * shape.w(np.abs(s))).sum()) for s in seen)
    assert value == pytest.approx(expected, abs=3e-6)
    expected = sum(float((weight * -np.abs(s) * shape.dw(np.abs(s))).sum()) for s in seen)
    assert slope == pytest.approx(expected, abs=3e-6)


@pytest.mark.parametrize(
    ("name", "operator", "norm"),
    [
        ("cubic-spline", CSPH, 136 / 105),
        ("cubic-spline", RKPM, 3064 / 945),
        (C2_1D, CSPH, 10 / 7),
        (C2_1D, RKPM, 475 / 147),
    ],
)
def test_corrected_gradients_have_test_functions_of_their_own(
    name: str, operator: Operator, norm: float
) -> None:
    """M_2 at small σ and Δx/h: σ²r³ times the norms above, which differ by more than a half."""
    sigma, r = 1e-3, 0.1
    factor = replace(displaced("uniform", sigma), home=None)
    found = predict_from(kernel(name), operator, factor, r, degree=2)
    assert found.std[(2,)] ** 2 == pytest.approx(sigma**2 * r**3 * norm, rel=1e-4)
    assert found.std[(0,)] == found.std[(1,)] == 0.0


def test_third_moment_of_csph_is_less_its_mean_share_of_the_first() -> None:
    """ψ = g₃ − M̄₃ g₁ (symmetric means, M̄₁ = 1): its norm by integration of s(s²−M̄₃)Ŵ′."""
    shape = kernel("cubic-spline")
    found = predict_from(shape, CSPH, poisson(1), 0.25, degree=3)
    third = float(3 * shape.moment(2))
    knots = [0.0, *(float(k) for k in shape.knots[1:])]
    norm = 2 * sum(
        integrate.quad(lambda s: ((s**3 - third * s) * float(shape.dw(s))) ** 2, a, b)[0]
        for a, b in pairwise(knots)
    )
    assert found.std[(3,)] ** 2 == pytest.approx(0.25 * norm, rel=1e-5)


def test_small_displacements_with_summed_volumes() -> None:
    """The spread of summation over constant volumes: 0.65 (M_0) and 0.82 (M_1) in 1D, 0.70 and 0.80
    in 2D, to the digits given."""
    for name, kind, ratios in (
        ("cubic-spline", "uniform", (0.65, 0.82)),
        ("cubic-spline", "square", (0.70, 0.80)),
        ("wendland-c2", "square", (0.73, 0.79)),
        ("cubic-spline", "cubic", (0.75, 0.81)),
    ):
        factor = replace(displaced(kind, 1e-3), home=None)
        plain = predict_from(kernel(name), STANDARD, factor, 0.3, degree=1)
        summed = predict_from(kernel(name), STANDARD, factor, 0.3, degree=1, volume="summation")
        zero, one = list(plain.std)[:2]
        assert summed.std[zero] / plain.std[zero] == pytest.approx(ratios[0], abs=0.006)
        assert summed.std[one] / plain.std[one] == pytest.approx(ratios[1], abs=0.006)


# ----------------------------------------------------------------------------------- Monte Carlo


def sums(name: str, dim: int, r: float, place: Any, count: int, n: int) -> Any:
    """M_0, M_{e₁} and M_{2e₁} about the middle of boxes of points place(rng) (N, d) in Δx."""
    shape, rng = kernel(name), np.random.default_rng(n)
    rows = []
    for _ in range(count):
        s = r * place(rng)
        q = np.sqrt((s**2).sum(axis=1))
        near = (q > 0) & (q < 2)
        s, q = s[near], q[near]
        g = -(r**dim) * shape.dw(q, dim) * s[:, 0] / q
        rows.append([g.sum(), (g * s[:, 0]).sum(), (g * s[:, 0] ** 2).sum()])
    return np.array(rows)


def grid(dim: int, reach: int) -> Any:
    axis = np.arange(-reach, reach + 1)
    return np.stack([x.ravel() for x in np.meshgrid(*[axis] * dim, indexing="ij")], 1)


@pytest.mark.parametrize(("dim", "count"), [(1, 3000), (2, 2000), (3, 1200)])
@pytest.mark.parametrize("process", ["poisson", 0.05, 0.3, "correlated"])
def test_spread_about_random_points(dim: int, count: int, process: Any) -> None:
    """Within four standard errors of the spread, 1/√(2n); S ~ k⁴ for the correlated ones, u = v −
    mean of v over the nearest neighbours."""
    r, name = 0.6, "wendland-c2"
    reach = int(2 / r + 3)
    points = grid(dim, reach)
    side = 2 * reach + 1

    def place(rng: Any) -> Any:
        if process == "poisson":
            return (rng.random((rng.poisson(side**dim), dim)) - 0.5) * side
        offset = rng.random(dim) - 0.5
        if process == "correlated":
            v = rng.normal(size=(*[side] * dim, dim))
            mean = sum(np.roll(v, s, i) for i in range(dim) for s in (1, -1)) / (2 * dim)
            u = 0.2 * (v - mean) / sqrt(1 + 1 / (2 * dim))
            return points + offset + u.reshape(-1, dim)
        return points + offset + process * rng.normal(size=points.shape)

    factor = {"poisson": poisson(dim), "correlated": displaced(KIND[dim], 0.2, "blue")}.get(
        process, displaced(KIND[dim], process if isinstance(process, float) else 0.1)
    )
    found = predict_from(kernel(name), STANDARD, factor, r, degree=2)
    seen = sums(name, dim, r, place, count, 5)
    for n in range(3):
        alpha = (n, *(0,) * (dim - 1))
        ratio = seen[:, n].std() / found.std[alpha]
        kurtosis = float(((seen[:, n] - seen[:, n].mean()) ** 4).mean()) / seen[:, n].var() ** 2
        assert abs(ratio - 1) < 4 * sqrt((kurtosis - 1) / (4 * count))
        assert abs(seen[:, n].mean() - found.mean[alpha]) < 4 * found.std[alpha] / sqrt(count)


def test_agreement_would_see_a_wrong_coefficient() -> None:
    """A spread off by a tenth is more than four standard errors of the tests above."""
    assert 4 * sqrt((3.5 - 1) / (4 * 1200)) < 0.1


def test_correlated_displacements_in_one_dimension() -> None:
    """c₀ = σ², c₁ = −σ²/2: S = e^{−k²c₀}[e^{k²c₀} − 1 + 2cos k (e^{k²c₁} − 1)], ~ k⁴ at small k."""
    c = 0.04
    factor = correlated("uniform", {(0,): c, (1,): -c / 2, (-1,): -c / 2})
    k = np.array([[0.05, 0.4, 2.0]])
    expected = [
        exp(-q * q * c) * (exp(q * q * c) - 1 + 2 * np.cos(q) * (exp(-q * q * c / 2) - 1))
        for q in k[0]
    ]
    np.testing.assert_allclose(factor(k), expected, rtol=1e-9)
    assert factor(np.array([[0.1]]))[0] / factor(np.array([[0.05]]))[0] == pytest.approx(16, 0.02)


# ------------------------------------------------------------------------------------- exponents


@pytest.mark.parametrize(
    ("name", "alpha", "slope", "tolerance"),
    [
        ("cubic-spline", 0, 0.500, 0.02),
        ("cubic-spline", 1, 1.000, 0.02),
        ("cubic-spline", 2, 1.500, 0.02),
        ("cubic-spline", 4, 2.500, 0.02),
        ("polynomial:1", 4, 2.000, 0.06),
    ],
)
def test_exponents_two_sided(name: str, alpha: int, slope: float, tolerance: float) -> None:
    """std(M_0) ∝ (Δx/h)^q between h/Δx = 8 and 16 for S = min(1, (kΔx/2π)^α): q = (1 + α)/2, and
    for α = 4 the ceiling β + 1 of a kernel with β = 1."""

    def law(k: Any) -> Any:
        return np.minimum(1.0, (np.abs(k[0]) / (2 * np.pi)) ** alpha)

    factor = StructureFactor(1, "a power law", law=law)
    std = [
        predict_from(kernel(name), STANDARD, factor, r, degree=0).std[(0,)] for r in (1 / 8, 1 / 16)
    ]
    assert np.log2(std[0] / std[1]) == pytest.approx(slope, abs=tolerance)


# ---------------------------------------------------------------------------------- bad arguments


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"at": "nowhere"}, "at: got 'nowhere', expected random or particles"),
        ({"volume": "cell"}, "volume: no prediction from a structure factor"),
        ({"operator": Operator("laplacian", "nested")}, "form: no prediction"),
        ({"name": "polynomial:0", "operator": Operator("laplacian", "difference")}, "jumps"),
    ],
)
def test_what_is_not_known_is_refused(options: dict[str, Any], says: str) -> None:
    options = {"name": "cubic-spline", "operator": STANDARD, **options}
    shape, operator = kernel(options.pop("name")), options.pop("operator")
    with pytest.raises(ValueError, match=says):
        predict_from(shape, operator, poisson(1), 0.5, **options)


def test_displacements_are_checked() -> None:
    with pytest.raises(ValueError, match="lattice: got 'cube'"):
        displaced("cube", 0.1)
    with pytest.raises(ValueError, match="distribution: got 'lognormal'"):
        displaced("cubic", 0.1, "lognormal")
    with pytest.raises(ValueError, match="covariance: got"):
        correlated("uniform", {(0,): 1.0, (1,): 0.5})
