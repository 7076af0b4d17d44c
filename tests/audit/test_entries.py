"""Formulas with powers of h, options of the command, exact numbers, and no false alarm."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from sympy import Rational

from sphtrunc import kernel
from sphtrunc.audit import audit, audit_formula, audit_table, faults
from sphtrunc.audit.recognition import derived, profiles
from sphtrunc.cli import main
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.testing import assert_kernel

M4 = "0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4"
SLOPE = "0..1: -3*q + 9/4*q^2; 1..2: -3/4*(2-q)^2"
BEND = "0..1: -3 + 9/2*q; 1..2: 3/2*(2-q)"


# -- formulas -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("constants", "wrong"),
    [
        (("1/(pi*h^3)", "1/(pi*h^4)", "1/(pi*h^5)"), []),
        (("1/(pi*h^2)", "1/(pi*h^4)", "1/(pi*h^5)"), ["W: −2, should be −3"]),
        (("1/(pi*h^3)", "1/(pi*h^3)", "1/(pi*h^5)"), ["dW: −3, should be −4; did you return"]),
        (("1/(pi*h^3)", "1/(pi*h^5)", "1/(pi*h^5)"), ["dW: −5, should be −4"]),
        (("1/(pi*h^3)", "1/(pi*h^4)", "1/(pi*h^3)"), ["d²W: −3, should be −5"]),
        (("h^(-3)/pi", "h^-4/pi", "1/pi/h**5"), []),
        (("1/pi", "1/pi", "1/pi"), []),
    ],
)
def test_powers_of_h_in_constants_are_checked(
    constants: tuple[str, str, str], wrong: list[str]
) -> None:
    one, two, three = constants
    report = audit_formula(
        M4, one, 3, SLOPE, derivative_constant=two, second_derivative=BEND, second_constant=three
    )
    assert [f.message.removeprefix("power of h in ")[: len(w)] for f, w in
            zip(report.faults, wrong, strict=True)] == wrong  # fmt: skip
    assert {f.kind for f in report.faults} <= {faults.POWER_OF_H}


@pytest.mark.parametrize("text", ["1/(pi*h^3) + 1", "sqrt(1+h)", "h^h", "(1+h)^2"])
def test_h_is_only_a_factor(text: str) -> None:
    with pytest.raises(ValueError, match="constant: "):
        audit_formula(M4, text, 3)


def test_a_formula_that_is_cut_is_the_kernel_that_goes_on() -> None:
    for report in (
        audit_formula("0..1: 1 - 3/2*q^2 + 3/4*q^3", "1/pi", 3),
        audit_formula(M4, "1/pi", 3, support="1"),
    ):
        (fault,) = report.faults
        assert fault.kind == faults.CUT
        assert "the integral there is 19/30" in fault.message
        assert (report.kernel, report.integral, report.constant) == (
            "cubic-spline",
            "19/30",
            "1/pi",
        )
    assert audit_formula("0..1: 1 - 3/2*q^2 + 3/4*q^3", "30/(19*pi)", 3).clean  # one's own kernel


def test_the_constant_of_another_dimension_is_no_misprint() -> None:
    (fault,) = audit_formula("0..1: (1-q^2)^3", "315/(64*pi)", 2).faults
    assert fault.kind == faults.OTHER_DIMENSION
    assert "no other gives 315/256" in fault.surely


def test_a_wrong_digit_is_called_a_guess() -> None:
    (fault,) = audit_formula("quartic-spline", "96/(1189*pi)", 2).faults
    assert fault.kind == faults.MISPRINT
    assert fault.surely.startswith("a guess")


def test_a_gaussian_may_be_wrong_and_cut() -> None:
    report = audit_formula("gaussian:3", "1/sqrt(pi)", 2)
    assert [f.kind for f in report.faults] == [faults.OTHER_DIMENSION, faults.TRUNCATION]
    with pytest.raises(ValueError, match="no polynomial"):
        audit_formula("gaussian", "1/pi", 2, "0..1: q")


# -- exact numbers --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("wendland-c2", ("1/2",)),  # w″ = 5 (1 − q/2)² (2q − 1)
        ("cubic-spline", ("2/3",)),  # w″ = −3 + 9q/2
        ("wendland-c4", ("0.4711427",)),  # 35 q² − 8 q − 4 = 0: (4 + √156)/35
        ("polynomial:0", ()),
        ("b-spline:3", ("1/2",)),  # at the knot
    ],
)
def test_inflection_points_are_exact_where_they_are_rational(
    name: str, places: tuple[str, ...]
) -> None:
    shape = kernel(name)
    for dim in (2, 3):
        for report in (
            audit_formula(name, str(shape.normalisation(dim)), dim),
            audit(lambda q, dim=dim: shape.w(q, dim), dim, "w(q)"),
        ):
            assert len(report.inflection) == len(places)
            assert all(
                seen.startswith(wanted)
                for seen, wanted in zip(report.inflection, places, strict=True)
            )


def test_inflection_and_knots_are_in_the_author_s_h() -> None:
    shape = kernel("wendland-c2").scaled(1)
    report = audit(lambda q: shape.w(q, 3), 3)
    assert report.inflection == ("1/4",)
    assert list(audit_formula("quintic-spline", "1/120", 1).continuity)[1] == "q = 1"
    small = kernel("quintic-spline").scaled(1)
    assert list(audit(lambda q: small.w(q, 1), 1).continuity)[1] == "q = 1/3"


# -- no false alarm -------------------------------------------------------------------------------

SHAPES = [k for k, _ in profiles() if 1 <= k.degree <= 10]


def pieces(shape: Kernel, order: int) -> str:
    return "; ".join(
        f"{a}..{b}: {p.as_expr()}"
        for a, b, p in zip(shape.knots, shape.knots[1:], derived(shape, order), strict=False)
    )


@pytest.mark.parametrize("shape", SHAPES, ids=lambda k: k.name)
def test_no_formula_of_the_catalogue_is_accused(shape: Kernel) -> None:
    """In every dimension, on its support and on 1h, with both derivatives and powers of h."""
    for own in (shape, shape.scaled(1)):
        for dim in (1, 2, 3):
            c = own.normalisation(dim)
            report = audit_formula(
                own,
                f"({c})/h^{dim}",
                dim,
                pieces(own, 1),
                derivative_constant=f"({c})/h^{dim + 1}",
                second_derivative=pieces(own, 2) if own.degree > 1 else None,
                second_constant=f"({c})/h^{dim + 2}" if own.degree > 1 else None,
            )
            assert report.clean, report.to_text()
            assert kernel(report.kernel) == shape  # lucy in space is a Wendland function on a line


SMOOTH = [k for k in SHAPES if k.smoothness >= 0]


@pytest.mark.parametrize("shape", SMOOTH, ids=lambda k: k.name)
def test_no_callable_or_table_of_several_h_is_accused(shape: Kernel, tmp_path: Any) -> None:
    """With h as here, the support radius or 4/3 of it, in turn; dimensions in turn."""
    turn = SMOOTH.index(shape)
    dim = 1 + turn % 3
    stretch = float((Rational(1), shape.support, Rational(3, 4) * shape.support)[turn // 3 % 3])

    def called(order: int) -> Any:
        values = (shape.w, shape.dw, shape.d2w)[order]
        power = dim + order

        def function(r: Any, h: float) -> Any:
            length = h / stretch
            return values(r / length, dim) / length**power

        return function

    w, dw, d2w = (called(order) for order in range(3))
    second = d2w if shape.smoothness > 0 else None
    report = assert_kernel(w, shape, dim, derivative=dw, second_derivative=second)
    assert f"W ∝ h^−{dim}, dW ∝ h^−{dim + 1}" in report.scaling
    end = float(shape.support) / stretch
    h = np.repeat([0.2, 0.3, 0.7], 400)
    r = np.concatenate([np.linspace(0, 1.01 * end * x, 400) for x in (0.2, 0.3, 0.7)])
    values = [np.concatenate([f(r[h == x], x) for x in (0.2, 0.3, 0.7)]) for f in (w, dw)]
    np.savez(tmp_path / "t.npz", r=r, h=h, W=values[0], dW=values[1])
    report = audit_table(tmp_path / "t.npz", dim)
    assert report.clean, report.to_text()
    assert report.kernel == shape.name


# -- the command ----------------------------------------------------------------------------------


def run(*arguments: str, capsys: Any) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stop:
        main(["audit", *arguments])
    streams = capsys.readouterr()
    return int(stop.value.code or 0), streams.out + streams.err


def test_options_that_would_be_ignored_are_refused(tmp_path: Any, capsys: Any) -> None:
    (tmp_path / "t.csv").write_text("q,W\n")
    table = ("--table", str(tmp_path / "t.csv"))
    formula = ("--formula", M4, "--constant", "1/pi")
    for way, option in (
        (table, ("--signature", "w(q)")),
        (table, ("--derivative", SLOPE)),
        (table, ("--support", "1")),
        (formula, ("--signature", "w(q)")),
        (formula, ("--derivative-constant", "1/pi")),
        (("--list", "x.toml"), ("--dim", "3")),
    ):
        status, said = run(*way, *option, capsys=capsys)
        assert status == 2
        assert said.count("\n") == 1
        assert option[0].lstrip("-").partition("-")[0] in said


def test_the_command_takes_second_derivatives_and_says_the_evidence(capsys: Any) -> None:
    status, said = run(
        "--formula", M4, "--constant", "1/(pi*h^3)", "--derivative", SLOPE,
        "--derivative-constant", "1/(pi*h^3)", "--second-derivative", BEND,
        "--second-constant", "1/(pi*h^5)", capsys=capsys,
    )  # fmt: skip
    assert status == 1
    assert "power of h in dW: −3, should be −4; did you return dW/dq?" in said
    assert "d²W/dr²    the second derivative of W" in said
    status, said = run(
        "--formula", "poly6", "--constant", "2", "--dim", "2", "--format", "json", capsys=capsys
    )
    (document,) = json.loads(said)
    assert document["schema"] == "sphtrunc.audit/2"
    assert "explanations" in document["faults"][0]["surely"]
