"""Conventions against published ratios, and there and back."""

from __future__ import annotations

import json
from fractions import Fraction

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from sympy import Rational, log, pi, simplify, sqrt

from sphtrunc import kernel
from sphtrunc.cli import main
from sphtrunc.kernels.catalogue import names
from sphtrunc.kernels.conventions import CONVENTIONS, convert

# H/h with h = 2σ: Dehnen & Aly (2012), doi:10.1111/j.1365-2966.2012.21439.x, table 1
DEHNEN_ALY = {
    "cubic-spline": (1.732051, 1.778002, 1.825742),
    "quartic-spline": (1.936492, 1.977173, 2.018932),
    "quintic-spline": (2.121321, 2.158131, 2.195775),
    "wendland-c2-1d": (1.620185, None, None),
    "wendland-c2": (None, 1.897367, 1.936492),
    "wendland-c4": (None, 2.171239, 2.207940),
    "wendland-c6": (None, 2.415230, 2.449490),
}
PUBLISHED = [
    (name, dim, value)
    for name, row in DEHNEN_ALY.items()
    for dim, value in enumerate(row, start=1)
    if value is not None
]


@pytest.mark.parametrize(("name", "dim", "ratio"), PUBLISHED)
def test_support_over_two_sigma_is_the_published_one(name, dim, ratio):
    resolution = convert(name, dim, hdx=1)
    # published to six decimals, of which the last is off by up to 1.6 units
    assert abs(float(resolution["support"] / resolution["two-sigma"]) - ratio) < 2e-6


def test_neighbours_of_well_known_codes():
    # Price et al. (2018), doi:10.1017/pasa.2018.25: hfact 1.2 is 57.9, quintic 1.0 is 113
    assert convert("cubic-spline", 3, hfact="1.2")["neighbours"] == Rational(2304, 125) * pi
    assert round(float(convert("quintic-spline", 3, hfact=1)["neighbours"]), 1) == 113.1
    # Schaller et al. (2024), doi:10.1093/mnras/stae922: η = 1.2348 is 48 for the cubic spline
    assert round(float(convert("cubic-spline", 3, eta="1.2348")["neighbours"])) == 48
    assert convert("cubic-spline", 3, coefh=1)["hdx"] == sqrt(3)


def test_half_maximum_is_exact():
    # (4−q²)/4 = 1/2 at q = √2; a hat at 1/2
    assert convert("polynomial:0", 2, fwhm=2)["h"] == sqrt(2) / 2
    assert convert("0..1: 1-q", 1, h=3)["fwhm"] == 3
    shape = kernel("cubic-spline")
    for name in ("cubic-spline", "quintic-spline", "wendland-c6"):
        shape = kernel(name)
        half = convert(name, 1, h=1)["fwhm"] / 2
        piece = next(
            p
            for a, b, p in zip(shape.knots, shape.knots[1:], shape.pieces, strict=False)
            if a <= half <= b
        )
        with_40_digits = piece.as_expr().subs(piece.gen, half.evalf(40)) * 2
        assert abs(with_40_digits - shape.pieces[0].eval(0)) < 1e-35


positive = st.fractions(Fraction(1, 100), 1000, max_denominator=1000)


@given(
    name=st.sampled_from(["cubic-spline", "wendland-c4", "polynomial:4", "lucy", "b-spline:7"]),
    dim=st.integers(1, 3),
    value=positive,
    convention=st.sampled_from([c for c in CONVENTIONS if c != "fwhm"]),
    other=st.sampled_from([c for c in CONVENTIONS if c != "fwhm"]),
)
@example(name="cubic-spline", dim=3, value=Fraction(57), convention="neighbours", other="two-sigma")
def test_there_and_back_is_the_identity(name, dim, value, convention, other):
    there = convert(name, dim, **{convention: value})
    assert there[convention].equals(Rational(value.numerator, value.denominator))
    scaled = convert(name, dim, **{convention: 2 * value})
    power = {"dx-over-h": -1, "neighbours": dim}
    ratio = (scaled[other] / there[other]) ** power.get(convention, 1)
    assert ratio.equals(2 ** power.get(other, 1))


@pytest.mark.parametrize("name", names())
def test_every_kernel_reads_in_every_convention(name):
    for dim in (1, 2, 3):
        rows = convert(name, dim, hdx="1.3").to_dict(dx="0.5")
        missing = {"polynomial:-1": ["fwhm"]}.get(name, [])  # the top-hat has no half maximum
        assert [c for c in CONVENTIONS if rows[c]["value"] is None] == missing
        assert rows["h"]["exact"] == "13/20"
        assert rows["hfact"]["exact"] == "13/10"


def test_lengths_scale_with_dx_and_numbers_do_not():
    near = convert("cubic-spline", 3, h="0.012", dx="0.01")
    assert near["hdx"] == Rational(6, 5)
    assert near.to_dict("0.01")["support"]["exact"] == "3/125"
    assert near.to_dict("0.01")["dx-over-h"]["exact"] == "5/6"


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"hdx": 1.2}, '"6/5"'),
        ({"hdx": "0"}, "positive"),
        ({"hdx": "-1"}, "positive"),
        ({"hdx": "nan"}, "expected a rational"),
        ({"h": 1, "dx": 0}, "dx"),
        ({}, "expected one of"),
        ({"h": 1, "hdx": 2}, "got 2 quantities"),
        ({"hsml": 1}, "'hsml'"),
    ],
)
def test_wrong_input_is_told(given, says):
    with pytest.raises(ValueError, match=says):
        convert("cubic-spline", 3, **given)


def test_no_half_maximum_is_told():
    with pytest.raises(ValueError, match="half"):
        convert("0..1: 1", 1, fwhm=1)


def test_the_command(capsys):
    command = "convert --kernel cubic-spline --dim 3 --neighbours 57 --dx 0.01"
    with pytest.raises(SystemExit) as stop:
        main(command.split())
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert all(name in text for name in CONVENTIONS)
    assert max(len(line) for line in text.splitlines()) <= 100
    with pytest.raises(SystemExit) as stop:
        main([*command.split(), "--format", "json"])
    assert stop.value.code == 0
    document = json.loads(capsys.readouterr().out)
    assert document["conventions"]["neighbours"]["exact"] == "57"
    with pytest.raises(SystemExit) as stop:
        main(["convert", "--kernel", "cubic-spline", "--hdx", "1", "--h", "1"])
    assert stop.value.code == 2
    assert "exactly one" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["gaussian", "gaussian:3", "gaussian:2:infinite"])
def test_gaussians_have_conventions_too(name):
    """exp(−q²) falls to a half at q² = log 2, wherever it is cut; 2σ of the whole one is √2 h."""
    found = convert(name, 3, hdx="6/5")
    assert simplify(found["fwhm"] - Rational(12, 5) * sqrt(log(2))) == 0
    assert simplify(convert("gaussian", 3, hdx="6/5")["eta"] - Rational(6, 5) * sqrt(2)) == 0
    assert simplify(convert(name, 3, fwhm="2")["hdx"] - 1 / sqrt(log(2))) == 0
