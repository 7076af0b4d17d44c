"""Fourier transforms against mpmath's hypergeometric functions, reciprocal sums against direct."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import mpmath
import numpy as np
import pytest

from sphtrunc import kernel
from sphtrunc.kernels.catalogue import names
from sphtrunc.kernels.transform import (
    decay,
    radial,
    smoothing_error,
    terms,
    transform,
    transform_mp,
)
from sphtrunc.operators.moments import unit
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.aliasing import lattice_order
from sphtrunc.theory.lattice_sums import lattice_sums
from sphtrunc.theory.reciprocal_sums import poisson_sum, response, shortest

THREE = ("cubic-spline", "wendland-c4", "polynomial:4")


def oracle(name: str, k: float, dim: int, derivative: int) -> float:
    """F, F′, F″ from ∫₀^a q^{n−1} ₀F₁(; ν/2; −k²q²/4) dq = a^n/n ₁F₂(n/2; ν/2, n/2+1; −k²a²/4)."""
    shape = kernel(name)
    knots = [mpmath.mpf(int(x.p)) / int(x.q) for x in shape.knots]

    def integral(extra: int, nu: int) -> mpmath.mpf:
        total = mpmath.mpf(0)
        for a, b, piece in zip(knots, knots[1:], shape.coefficients(), strict=False):
            for j, c in enumerate(piece):
                n = j + dim + extra
                for end, sign in ((a, -1), (b, 1)):
                    if end and c:
                        z = -((mpmath.mpf(k) * end) ** 2) / 4
                        value = mpmath.hyp1f2(
                            mpmath.mpf(n) / 2, mpmath.mpf(nu) / 2, mpmath.mpf(n) / 2 + 1, z
                        )
                        total += sign * end**n / n * value * int(c.p) / int(c.q)
        return total

    # Λ_ν′ = −(x/ν) Λ_{ν+2}
    with mpmath.workdps(40):
        kk = mpmath.mpf(k)
        mass = sum(
            (b ** (j + dim) - a ** (j + dim)) / (j + dim) * int(c.p) / int(c.q)
            for a, b, piece in zip(knots, knots[1:], shape.coefficients(), strict=False)
            for j, c in enumerate(piece)
        )
        if derivative == 0:
            return float(integral(0, dim) / mass)
        first = integral(2, dim + 2) / dim
        if derivative == 1:
            return float(-kk * first / mass)
        return float((kk**2 * integral(4, dim + 4) / (dim * (dim + 2)) - first) / mass)


@pytest.mark.parametrize("name", THREE)
def test_transform_is_right_to_fourteen_digits_at_two_hundred_wavenumbers(name: str) -> None:
    rng = np.random.default_rng(7)
    reach = float(kernel(name).support)
    k = np.concatenate([np.exp(rng.uniform(-9, 5, 100)), rng.uniform(0, 150, 100)]) / reach
    for dim, derivative in product((1, 2, 3), (0, 1, 2)):
        mine = transform(kernel(name), k, dim, derivative)
        chosen = slice(dim - 1 + 3 * derivative, None, 9)  # every k once, for one (dim, derivative)
        exact = [oracle(name, x, dim, derivative) for x in k[chosen]]
        assert np.abs(mine[chosen] - exact).max() <= 1e-14 * reach**derivative
        assert mine.shape == k.shape


def test_every_k_in_three_dimensions() -> None:
    k = np.exp(np.random.default_rng(3).uniform(-7, 4.5, 200))
    for name in THREE:
        exact = [oracle(name, x, 3, 0) for x in k]
        assert np.abs(transform(kernel(name), k, 3) - exact).max() <= 1e-14


@pytest.mark.parametrize(
    "name", [n for n in names() if n not in ("b-spline:20", "b-spline:19")][::3]
)
def test_the_three_ways_meet(name: str) -> None:
    """Series, quadrature and closed form agree with the 30-digit series around their borders."""
    shape = kernel(name)
    reach = float(shape.support)
    for dim in (1, 2, 3):
        k = np.array([0.0, 1e-3, 0.999, 1.001, 4.0, 9.0, 17.0, 30.0]) / reach
        exact = [float(transform_mp(shape, x, dim)) for x in k]
        weight = float(abs(shape.moment(0, dim)))
        assert np.abs(transform(shape, k, dim) - exact).max() <= 1e-14 * max(1.0, weight)


def test_small_wavenumbers_keep_their_digits() -> None:
    for dim in (1, 2, 3):
        shape = kernel("wendland-c2")
        with mpmath.workdps(40):
            exact = [
                float(1 - transform_mp(shape, mpmath.mpf(k), dim, 0, 40)) for k in (1e-7, 1e-3, 0.2)
            ]
        mine = smoothing_error(shape, [1e-7, 1e-3, 0.2], dim)
        assert np.abs(mine / exact - 1).max() <= 1e-14


def test_b_splines_are_powers_of_sinc() -> None:
    k = np.linspace(0.01, 40, 500)
    for n in (2, 3, 4, 5, 6, 9):
        exact = (np.sin(k / 2) / (k / 2)) ** n
        assert np.abs(transform(kernel(f"b-spline:{n}"), k) - exact).max() <= 1e-14


@pytest.mark.parametrize(
    ("name", "first"),
    [("cubic-spline", 4 * np.pi), ("quartic-spline", 22.467), ("quintic-spline", 6 * np.pi)],
)
def test_first_change_of_sign_in_three_dimensions(name: str, first: float) -> None:
    """M_n in 3D is −3 sinc^{n−1}(x) sinc′(x)/x, x = k/2: for even n the sign changes at x = π, for
    odd n (M5 touches zero there) at tan x = x."""
    shape = kernel(name)
    reach = int(2 * shape.support) / mpmath.mpf(2)
    before = [transform_mp(shape, x / reach, 3) for x in mpmath.linspace(0.05, first - 0.001, 150)]
    assert all(f > 0 for f in before)
    assert transform_mp(shape, (first + 0.001) / reach, 3) < 0
    floats = transform(shape, np.linspace(0.05, first - 0.001, 5000) / float(reach), 3)
    assert floats.min() > -1e-14


@pytest.mark.parametrize("name", ["wendland-c2", "wendland-c4", "wendland-c6", "wendland-c8"])
def test_wendland_transforms_do_not_change_sign(name: str) -> None:
    """Positive definite (Wendland 1995): up to kκh = 200, in doubles and sampled in 30 digits."""
    shape = kernel(name)
    k = np.linspace(0.0, 100.0, 20_001)
    f = transform(shape, k, 3)
    assert (f > -1e-15).all()
    with mpmath.workdps(30):
        sampled = [transform_mp(shape, x, 3) for x in (30.0, 61.3, 77.7, 100.0)]
    assert all(x > 0 for x in sampled)


def test_closed_form_in_exact_numbers() -> None:
    """Cubic spline in 1D, sinc⁴(k/2) = (6 − 8 cos k + 2 cos 2k)/k⁴."""
    assert terms(kernel("cubic-spline"), 1) == {
        (Fraction(0), 4): Fraction(6),
        (Fraction(1), 4): Fraction(-8),
        (Fraction(2), 4): Fraction(2),
    }


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_decay_is_a_bound(dim: int) -> None:
    k = np.exp(np.linspace(0, 5.5, 400))
    for name, m in product((*THREE, "spiky", "linear-quartic", "polynomial:0"), (0, 1, 2)):
        bound = sum(c * k**-a for a, c in decay(kernel(name), dim, m))
        assert (np.abs(radial(kernel(name), k, dim, m)) <= bound + 1e-13).all()


def test_order_and_its_reason() -> None:
    cubic = lattice_order(kernel("cubic-spline"), 3)
    assert (cubic.power, cubic.limits) == (4, ((1, 3), (2, 3)))
    wendland = lattice_order(kernel("wendland-c2"), 1)
    assert (wendland.power, wendland.limits) == (4, ((0, 3), (2, 4)))
    assert [lattice_order(kernel("polynomial:4"), d).power for d in (1, 2, 3)] == [
        5,
        Fraction(11, 2),
        6,
    ]
    assert lattice_order(kernel("polynomial:-1"), 1).power == 0


@pytest.mark.parametrize(
    ("name", "dim", "kind"),
    [("polynomial:2", 1, "uniform"), ("wendland-c2", 2, "square"), ("wendland-c2", 3, "cubic"),
     ("cubic-spline", 3, "bcc"), ("core-triangle", 3, "cubic")],
)  # fmt: skip
def test_order_is_attained_and_not_exceeded(name: str, dim: int, kind: str) -> None:
    """The largest |M_1 − 1| over a window of ratios, halved, falls with the predicted power."""
    shape = kernel(name)
    key = (unit(dim, 0), unit(dim, 0))

    def largest(centre: Fraction) -> float:
        ratios = [centre * (1 + Fraction(i, 40)) for i in range(12)]
        return max(
            abs(float(lattice_sums(shape, [key], Arrangement(kind, r), False)[key]) - 1)
            for r in ratios
        )

    measured = np.log2(largest(Fraction(1, 4)) / largest(Fraction(1, 8)))
    assert abs(measured - float(lattice_order(shape, dim).power)) < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_direct_and_reciprocal_sums_agree_to_the_stated_tail(kind: str) -> None:
    dim = KINDS[kind].dim
    offsets = ((Fraction(0),) * dim, tuple(Fraction(i + 1, 7) for i in range(dim)))
    zero = (0,) * dim
    keys = [
        (unit(dim, 0), unit(dim, 0)),
        (zero, zero),
        (zero, unit(dim, dim - 1, 2)),
        (unit(dim, dim - 1), unit(dim, 0, 3)),
        (unit(dim, 0, 2), unit(dim, 0, 2)),
    ]
    for name, key, ratio, offset in product(
        ("wendland-c4", "quintic-spline"), keys, (Fraction(1, 2), Fraction(9, 10)), offsets
    ):
        shape = kernel(name)
        scene = Arrangement(kind, ratio, offset)
        series = poisson_sum(shape, key, scene, 60)
        direct = float(lattice_sums(shape, [key], scene, False)[key])
        assert series.tail < 1.0
        assert abs(series.value - direct) <= series.tail + 1e-13


def test_a_missing_shell_is_seen() -> None:
    """The agreement above is not one of large tails: dropping the largest shell breaks it."""
    shape, key, ratio = kernel("wendland-c4"), (unit(3, 0), unit(3, 0)), Fraction(9, 10)
    for kind in ("cubic", "bcc", "fcc", "hcp"):
        scene = Arrangement(kind, ratio)
        series = poisson_sum(shape, key, scene, 400)
        direct = float(lattice_sums(shape, [key], scene, False)[key])
        largest = max((s.contribution for s in series.shells), key=abs)
        assert abs(series.value - largest - direct) > series.tail


def test_which_lattice_is_best() -> None:
    """Hexagonal and bcc have the longest shortest reciprocal vector at equal number density."""
    assert shortest("hexagonal")[0] > shortest("square")[0]
    assert max(("cubic", "bcc", "fcc", "hcp"), key=lambda k: shortest(k)[0]) == "bcc"
    assert shortest("cubic") == (2 * np.pi, 6)
    # bcc of two particles a cell: a = 2^{1/3}, shortest (110)·2π/a, twelve of them
    assert shortest("bcc")[0] == pytest.approx(2 * np.pi * 2**0.5 / 2 ** (1 / 3), rel=1e-14)
    assert shortest("bcc")[1] == 12


def test_response_to_a_wave_is_the_sum_over_the_particles() -> None:
    shape, ratio, wave = kernel("wendland-c2"), Fraction(3, 5), np.array([0.4, 0.2])
    scene = Arrangement("hexagonal", ratio, (Fraction(1, 5), Fraction(1, 3)))
    main, aliases = response(shape, wave, scene, 300)
    a = (2 / 3**0.5) ** 0.5
    i, j = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
    s = 0.6 * (
        np.stack([(i + j / 2) * a, j * a * 3**0.5 / 2]) + np.array([0.2, 1 / 3])[:, None, None]
    )
    r = np.sqrt((s**2).sum(0))
    slope = shape.dw(r, 2) * s[0] / r
    direct = -0.36 * (slope * np.exp(1j * (0.4 * s[0] + 0.2 * s[1]))).sum() / (1j * 0.4)
    assert abs(main + sum(aliases) - direct) < 1e-6
    assert abs(main - direct) > 1e-4
    assert main.real == pytest.approx(float(transform(shape, 0.2**0.5, 2)), rel=1e-14)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1j, "k"])
def test_bad_wavenumbers(bad: object) -> None:
    with pytest.raises(ValueError, match="k:"):
        transform(kernel("cubic-spline"), bad)


def test_bad_requests() -> None:
    with pytest.raises(ValueError, match="derivative"):
        transform(kernel("cubic-spline"), 1.0, 1, 3)
    with pytest.raises(ValueError, match="jumps"):
        poisson_sum(kernel("polynomial:-1"), ((1,), (1,)), Arrangement("uniform", Fraction(1, 2)))
    with pytest.raises(ValueError, match="multi-index"):
        poisson_sum(
            kernel("cubic-spline"), ("brookshaw", (1,)), Arrangement("uniform", Fraction(1, 2))
        )
    with pytest.raises(ValueError, match="components"):
        response(kernel("cubic-spline"), [0.0, 1.0], Arrangement("square", Fraction(1, 2)))
