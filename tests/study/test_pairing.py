"""Which kernels let particles pair: their transforms by mpmath, the modes of the lattice."""

from __future__ import annotations

import json
from fractions import Fraction

import mpmath
import numpy as np
import pytest

from sphtrunc.cli import main
from sphtrunc.kernels.parse import kernel
from sphtrunc.operators.forces import FORCES
from sphtrunc.study.pairing import DENSEST, GAS, pairing_limit, sign_change
from sphtrunc.study.stability import COARSE, pairing
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
    limit = pairing(rest, divisions=COARSE[dim]).neighbours
    assert (limit is not None) == (sign_change(shape, dim) is not None)
    assert pairing_limit(shape, dim) == limit


def test_a_recommended_setting_that_pairs_is_said_to(capsys):
    """M4 in 3D with 1775 neighbours: nearest neighbours are where W″ < 0."""
    common = ("--kernel", "cubic-spline", "--dim", "3", "--jitter", "0.1", "--particles", "2e5")
    text = " ".join(run(capsys, *common).split())
    assert "Warning: with 1775 neighbours particles pair in a fluid under pressure." in text
    assert "transform of cubic-spline changes sign in 3D, and holds them apart up to 64.1" in text
    assert "compare --kernel wendland-c2" in text
    document = json.loads(run(capsys, *common, "--format", "json"))
    (row,) = document["recommended"]
    assert row["pairs"] is True
    assert row["dx_over_h"] < 2 / 3  # w = 1 − (3/2) q² + (3/4) q³ has its inflection at 2/3


def test_a_kernel_without_limit_is_preferred(capsys):
    common = ("--dim", "2", "--jitter", "0.1", "--particles-per-wavelength", "20")
    kernels = ("--kernel", "wendland-c2", "--kernel", "cubic-spline")
    document = json.loads(run(capsys, *common, *kernels, "--format", "json"))
    first, second = document["recommended"]
    assert (first["kernel"], first["pairs"], first["pairing_limit"]) == ("wendland-c2", False, None)
    assert (second["kernel"], second["pairs"]) == ("cubic-spline", True)
    assert second["error"]["total"] < first["error"]["total"]
    text = " ".join(run(capsys, *common, *kernels).split())
    assert "Take wendland-c2 with h" in text
    assert "cubic-spline is not preferred, though its error is less: with 64 neighbours" in text
    assert "Warning" not in text
