"""Gaussian kernels: constants against mpmath, spectra against quadrature, lattice sums against
theta functions, and the cut that overtakes."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import product
from typing import Any

import mpmath
import numpy as np
import pytest
from sympy import Rational, pi, sqrt

from sphtrunc import derive, kernel
from sphtrunc.experiment.measuring import measure
from sphtrunc.kernels.gaussian import CUTS, Gaussian, named, names
from sphtrunc.kernels.transform import radial, transform
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.study.comparison import compare
from sphtrunc.theory.lattice_sums import lattice_sums
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.theory.reciprocal_sums import poisson_sum


def shape(gauss: Gaussian, q: Any, dim: int) -> Any:
    """The definition, in mpmath, without the constant."""
    if gauss.cut is not None and q > gauss.cut:
        return mpmath.mpf(0)
    factor = mpmath.mpf(dim) / 2 + 1 - q * q if gauss.power else 1
    return factor * mpmath.exp(-q * q)


def integral(gauss: Gaussian, n: int, dim: int) -> Any:
    end = mpmath.mpf(gauss.cut) if gauss.cut is not None else mpmath.mpf(12)
    sphere = {1: 2, 2: 2 * mpmath.pi, 3: 4 * mpmath.pi}[dim]
    return sphere * mpmath.quad(lambda q: shape(gauss, q, dim) * q ** (n + dim - 1), [0, 1, 2, end])


@pytest.mark.parametrize("name", names())
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_constants(name: str, dim: int) -> None:
    gauss: Any = kernel(name)
    sigma = gauss.normalisation(dim)
    with mpmath.workdps(25):
        infinite = gauss.cut is None or not gauss.renormalised
        mass = mpmath.pi ** (mpmath.mpf(dim) / 2) if infinite else integral(gauss, 0, dim)
        assert abs(mpmath.mpf(str(sigma.evalf(25))) * mass - 1) < mpmath.mpf(10) ** -20
        for n in (0, 2, 4):
            exact = mpmath.mpf(str(sigma.evalf(25))) * integral(gauss, n, dim)
            mine = mpmath.mpf(str(gauss.moment(n, dim).evalf(25)))
            assert abs(mine - exact) < mpmath.mpf(10) ** -20
    x = np.linspace(0, 5, 400)
    value = [float(sigma * mpmath.mpf(shape(gauss, mpmath.mpf(float(q)), dim))) for q in x[::40]]
    assert np.allclose(gauss.w(x, dim)[::40], value, rtol=1e-14, atol=0)
    step = 1e-5
    inside = x[(x > 0.1) & (np.abs(x - (gauss.cut or 9)) > 0.05)]
    numeric = (gauss.w(inside + step, dim) - gauss.w(inside - step, dim)) / (2 * step)
    # |∂⁴(5/2 − q²) e^{−q²}| <= 54, σ <= 1/√π; values good to 4 u
    allowed = 54 * 0.57 * step**2 / 6 + 8 * 2.0**-53 / step
    assert np.allclose(gauss.dw(inside, dim), numeric, rtol=0, atol=allowed)
    numeric = (gauss.dw(inside + step, dim) - gauss.dw(inside - step, dim)) / (2 * step)
    assert np.allclose(gauss.d2w(inside, dim), numeric, rtol=0, atol=allowed)


def test_exact_constants() -> None:
    infinite, better = kernel("gaussian"), kernel("super-gaussian")
    assert infinite.normalisation(1) == 1 / sqrt(pi)
    assert infinite.normalisation(3) == pi ** Rational(-3, 2)
    assert [infinite.moment(2, d) for d in (1, 2, 3)] == [Rational(d, 2) for d in (1, 2, 3)]
    assert [better.moment(2, d) for d in (1, 2, 3)] == [0, 0, 0]
    assert infinite.gradient_moment(1) == -1
    assert derive("super-gaussian", degree=6).orders.smoothing == 4
    assert (infinite.boundary_smoothness, kernel("gaussian:3").boundary_smoothness) == (
        float("inf"),
        -1,
    )


@pytest.mark.parametrize("name", names())
def test_spectrum(name: str) -> None:
    gauss: Any = kernel(name)
    for dim, m in product((1, 2, 3), (0, 1, 2)):
        k = np.array([0.0, 0.3, 2.0, 7.0, 23.0])
        q, w = np.polynomial.legendre.leggauss(300)
        end = float(gauss.support)
        q, w = end * (1 + q) / 2, w * end / 2
        from scipy.special import hyp0f1

        nu = dim + 2 * m
        sphere = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}[dim] / np.prod(range(dim, nu, 2))
        waves = hyp0f1(nu / 2, -0.25 * np.multiply.outer(k, q) ** 2)
        exact = sphere * waves @ (w * gauss.w(q, dim) * q ** (dim - 1 + 2 * m))
        assert np.abs(radial(gauss, k, dim, m) - exact).max() < 1e-11 * max(1, abs(exact[0]))
    assert abs(transform(kernel("gaussian"), 2.0, 3) - np.exp(-1.0)) < 1e-16


@pytest.mark.parametrize("kind", ["uniform", "square", "bcc"])
def test_lattice_sums_are_exponentially_exact(kind: str) -> None:
    """Direct = Poisson; in 1D Σ Ŵ Δs is a theta function."""
    dim = {"uniform": 1, "square": 2, "bcc": 3}[kind]
    gauss: Any = kernel("gaussian")
    offset = tuple(Fraction(i + 1, 6) for i in range(dim))
    for key in (((0,) * dim, (0,) * dim), (unit(dim, 0), unit(dim, 0))):
        for ratio in (Fraction(4, 5), Fraction(6, 5)):
            scene = Arrangement(kind, ratio, offset)
            direct = float(lattice_sums(gauss, [key], scene)[key])
            series = poisson_sum(gauss, key, scene, 40)
            assert abs(series.value - direct) <= series.tail + 4e-15
    if dim == 1:
        with mpmath.workdps(40):
            nome = mpmath.exp(-(mpmath.pi**2) / mpmath.mpf("1.44"))
            theta = mpmath.jtheta(3, mpmath.pi / 6, nome)
            zero = ((0,), (0,))
            mine = lattice_sums(gauss, [zero], scene)[zero]
            assert abs(mpmath.mpf(str(mine)) - theta) < mpmath.mpf(10) ** -19


def test_the_error_falls_faster_than_any_power_until_the_cut_overtakes() -> None:
    """|M_1 − 1| of the infinite kernel ~ e^{−π²h²/Δx²}; of the cut one the size of its jump times
    Δx/h. They cross near Δx/h = π/κ."""

    def error(name: str, ratio: Fraction) -> float:
        gauss: Any = kernel(name)
        key = ((1,), (1,))
        limit = float(continuous_sum(gauss, key))
        scene = Arrangement("uniform", ratio, (Fraction(1, 4),))
        return abs(float(lattice_sums(gauss, [key], scene)[key]) - limit)

    for ratio in (Fraction(1, 2), Fraction(3, 5), Fraction(7, 10)):
        g = 2 * np.pi / float(ratio)
        first = abs(2 * (1 - g * g / 2) * np.exp(-g * g / 4) * np.cos(g * float(ratio) / 4))
        second = abs(2 * (1 - 2 * g * g) * np.exp(-g * g))
        # at an offset of a quarter the first shell cancels: what is left is the second
        assert first < 1e-15
        assert error("gaussian", ratio) == pytest.approx(second, rel=0.01, abs=1e-24)
    for cut in CUTS:
        gauss: Any = kernel(f"gaussian:{cut}")
        jump = abs(float(gauss.edge_jump(1)))
        fine = max(error(f"gaussian:{cut}", Fraction(1, 10) + Fraction(i, 997)) for i in range(40))
        assert 0.02 * jump * cut * cut * 2 < fine < jump * cut * cut * 4


def test_the_same_names_everywhere() -> None:
    assert kernel("Gaussian:3") == named("gaussian:3")
    assert kernel(named("gaussian")) == named("gaussian")  # type: ignore[arg-type]
    data = json.loads(derive("gaussian:2", dx_over_h="1/2").to_json())
    assert data["kernel"]["name"] == "gaussian:2"
    assert derive("gaussian", dim=3).to_latex()
    with pytest.raises(ValueError, match="gaussian:2, :3 or :4"):
        kernel("gaussian:7")


@pytest.mark.parametrize("name", ["gaussian", "gaussian:3", "super-gaussian"])
def test_measured_as_derived(name: str) -> None:
    still = lattice(1, "uniform", "7/10")
    found = measure(still, name, "gradient", moments=1).moments[1][0]
    sums = lattice_sums(
        kernel(name), Operator().needed(1, 1), Arrangement("uniform", Fraction(7, 10))
    )
    assert float(found) == pytest.approx(float(sums[(1,), (1,)]), rel=1e-14)
    together = compare(jittered(lattice(2, "square", "7/10"), 0.02), name, degree=1, targets=1500)
    assert together.ratio
    assert all(abs(r - 1) < 0.12 for r in together.ratio.values())
