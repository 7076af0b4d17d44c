"""Which kernels let particles pair: their transforms by mpmath, the modes of the lattice."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction

import mpmath
import numpy as np
import pytest

from sphtrunc.cli import main
from sphtrunc.kernels.parse import kernel
from sphtrunc.operators.forces import FORCES
from sphtrunc.study.pairing import DENSEST, GAS, pairing, pairing_limit, sign_change
from sphtrunc.study.stability import COARSE, ratio_of
from sphtrunc.theory.dispersion.modes import Rest

WENDLAND = ("wendland-c2", "wendland-c4", "wendland-c6")
SPLINES = ("cubic-spline", "quartic-spline", "quintic-spline")  # M4, M5, M6


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(["tune", *arguments])
    streams = capsys.readouterr()
    assert stop.value.code == 0, streams.err
    return streams.out


@pytest.mark.parametrize("dim", [2, 3])
def test_splines_change_sign_and_wendland_kernels_do_not(dim):
    """By quadrature of the polynomial pieces: ∫ q J₀(kq) w dq, ∫ q² sin(kq)/(kq) w dq."""

    def by_quadrature(name, k):
        shape = kernel(name)
        wave = (lambda x: mpmath.besselj(0, x)) if dim == 2 else mpmath.sinc
        return sum(
            mpmath.quad(
                lambda q, row=row: q ** (dim - 1) * wave(k * q) * mpmath.polyval(row[::-1], q),
                [mpmath.mpf(int(a.p)) / int(a.q), mpmath.mpf(int(b.p)) / int(b.q)],
            )
            for a, b, row in zip(
                shape.knots,
                shape.knots[1:],
                [[mpmath.mpf(int(c.p)) / int(c.q) for c in row] for row in shape.coefficients()],
                strict=False,
            )
        )

    for name in SPLINES:
        first = sign_change(kernel(name), dim)
        assert first is not None
        step = np.pi / (10 * float(kernel(name).support))
        assert by_quadrature(name, first) < 0 < by_quadrature(name, first - 2 * step)
    for name in WENDLAND:
        assert sign_change(kernel(name), dim) is None
        assert min(by_quadrature(name, k) for k in np.linspace(0.5, 15, 15)) > 0


@pytest.mark.parametrize(("order", "changes"), [(4, False), (5, True), (6, False), (7, True)])
def test_in_1d_the_transform_of_a_spline_is_a_power_of_a_sinc(order, changes):
    """sinc(k/2)^n is negative from k = 2π on for odd n only."""
    found = sign_change(kernel(f"b-spline:{order}"), 1)
    assert (found is not None) == changes
    step = np.pi / (5 * order)  # the support is order/2
    assert found is None or 2 * np.pi < found < 2 * np.pi + 1.01 * step


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", [*SPLINES, "wendland-c2", "spiky", "poly6", "polynomial:4"])
def test_a_sign_is_what_decides_whether_there_is_a_limit(name, dim):
    """The modes of the lattice themselves, looked at for every kernel."""
    shape = kernel(name)
    rest = Rest(shape, DENSEST[dim], Fraction(1, 2), FORCES["symmetric"], GAS)
    limit = pairing(rest).neighbours
    assert (limit is not None) == (sign_change(shape, dim) is not None)
    assert pairing_limit(shape, dim) == limit


def test_no_setting_is_recommended_that_pairs(capsys):
    """M4 in 3D, where 1775 neighbours would have the least error: fewer than 64.1156512426, from
    which its longitudinal mode at W has no restoring force."""
    common = ("--kernel", "cubic-spline", "--dim", "3", "--jitter", "0.1", "--particles", "2e5")
    text = " ".join(run(capsys, *common).split())
    assert "64.1 neighbours (particles pair from 64.1 on)" in text
    assert "No more are recommended" in text
    assert "transform of cubic-spline changes sign in 3D, and holds them apart up to 64.1" in text
    assert "compare --kernel wendland-c2" in text
    document = json.loads(run(capsys, *common, "--now", "neighbours=100", "--format", "json"))
    (row,) = document["recommended"]
    assert row["pairing_limit"] == pytest.approx(64.1156512426, abs=1e-9)
    assert 64.1 < row["neighbours"] < row["pairing_limit"]
    assert row["pairs"] is False
    assert document["now"]["pairs"] is True
    assert document["loss"]["error"] < 1  # what pairs would have less


def test_a_wanted_error_is_reached_without_pairing_or_not_at_all(capsys):
    common = ("--kernel", "cubic-spline", "--dim", "2", "--jitter", "0.1")
    with pytest.raises(SystemExit) as stop:
        main(["tune", *common, "--error", "0.1"])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert "not reached by cubic-spline with at most 21.77 neighbours" in said
    assert "another kernel" in said
    corrected = (*common, "--form", "difference", "--error", "0.1", "--format", "json")
    (row,) = json.loads(run(capsys, *corrected))["recommended"]
    assert row["neighbours"] < row["pairing_limit"]
    assert 0.09 < row["error"]["total"] <= 0.1


def test_a_kernel_without_limit_is_preferred(capsys):
    common = ("--dim", "2", "--jitter", "0.1", "--particles-per-wavelength", "20")
    kernels = ("--kernel", "wendland-c2", "--kernel", "cubic-spline")
    document = json.loads(run(capsys, *common, *kernels, "--format", "json"))
    first, second = document["recommended"]
    assert (first["kernel"], first["pairs"], first["pairing_limit"]) == ("wendland-c2", False, None)
    assert (second["kernel"], second["pairs"]) == ("cubic-spline", False)
    assert second["neighbours"] < second["pairing_limit"] < first["neighbours"]
    assert "Take wendland-c2 with h" in run(capsys, *common, *kernels)


def test_a_narrow_window_between_the_waves_of_a_coarser_grid_is_found():
    """M7 on fcc pairs from 384.4 neighbours at a wave near W: at 384.5 a longitudinal mode of 50
    digits has ω² < 0, at 384.3 none of the waves around does."""
    limit = pairing_limit(kernel("b-spline:7"), 3)
    assert limit is not None
    rest = Rest(kernel("b-spline:7"), "fcc", Fraction(1, 2), FORCES["symmetric"], GAS)
    found = pairing(rest)
    assert found.neighbours == limit
    assert pairing(rest, divisions=COARSE[3]).neighbours > 2 * limit
    kappa = (Fraction(11, 12), Fraction(7, 12), Fraction(0))
    for count, fails in ((0.9999 * limit, False), (1.0001 * limit, True)):
        at = replace(rest, ratio=Fraction(ratio_of(rest.kernel, 3, count)))
        along = [m for m in at.modes(kappa, exact=False) if m.branch == "longitudinal"]
        assert (along[0].omega2 < 0) == fails
