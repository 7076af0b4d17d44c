"""Faults of real codes, planted in kernels that share nothing with the package.

Each must be named. Where several slips leave the very same factor, as 4/3 for M4 in 1D, the planted
one must be among those that are listed. The right kernels are accused of nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import floor, pi, sqrt
from typing import Any

import numpy as np
import pytest
from planted import (
    C2,
    C2_UNIT,
    C4,
    C6_UNIT,
    KERNELS,
    M4,
    M4_UNIT,
    M5,
    M6,
    POLY6,
    SPIKY,
    Written,
    code,
    pos,
)

from sphtrunc.audit import Audit, audit, audit_table, faults
from sphtrunc.testing import assert_kernel

EVERY = [(kernel, dim) for kernel in KERNELS for dim in kernel.constants]


def ids(value: Any) -> str | None:
    if isinstance(value, Written):
        return f"{value.name}-{value.support}h"
    return None


# -- constants ------------------------------------------------------------------------------------


def constants() -> Iterator[tuple[str, Written, int, float]]:
    """(class, kernel, dimension, wrong constant); none of these factors has a likelier reason."""
    for kernel, dim, other in (
        (M4, 1, 2), (M4, 1, 3), (M4, 2, 3), (M4, 3, 2), (M4_UNIT, 2, 3), (M4_UNIT, 3, 1),
        (M5, 1, 2), (M5, 2, 3), (M5, 3, 2), (M6, 1, 2), (M6, 2, 3), (M6, 3, 2), (C2, 2, 3),
        (C2, 3, 2), (C2_UNIT, 3, 2), (C4, 2, 3), (C6_UNIT, 3, 2), (POLY6, 2, 3), (POLY6, 3, 1),
        (SPIKY, 2, 3), (SPIKY, 3, 2),
    ):  # fmt: skip
        yield faults.OTHER_DIMENSION, kernel, dim, kernel.constants[other]
    for kernel, dim, support in (
        (M4, 2, 1), (M4, 3, 1), (M4_UNIT, 2, 2), (M4_UNIT, 3, 2), (M5, 2, 1), (M5, 3, 2),
        (M6, 2, 1), (M6, 3, 1), (M6, 3, 2), (C2, 2, 1), (C2, 3, 1), (C4, 3, 1), (POLY6, 3, 2),
        (SPIKY, 2, 2), (C6_UNIT, 2, 2),
    ):  # fmt: skip
        wrong = kernel.constants[dim] * (kernel.support / support) ** dim
        yield faults.CONVENTION, kernel, dim, wrong
    for kernel, dim in ((M4, 1), (M4, 2), (M5, 3), (M6, 2), (C2_UNIT, 3), (POLY6, 1), (SPIKY, 3)):
        yield faults.HALF_RANGE, kernel, dim, 2 * kernel.constants[dim]
    for kernel, dim in ((M4, 3), (M6, 2), (C2, 2), (POLY6, 3), (SPIKY, 1)):
        yield faults.FACTOR_PI, kernel, dim, sqrt(pi) * kernel.constants[dim]
    for kernel, dim in ((M4, 2), (M5, 3), (C4, 2), (C6_UNIT, 3)):
        yield faults.FACTOR_PI, kernel, dim, pi * kernel.constants[dim]
        yield faults.ROUNDED, kernel, dim, pi / (22 / 7) * kernel.constants[dim]
    for kernel, dim in ((C2, 2), (C4, 2), (C4, 3), (C6_UNIT, 3), (C2_UNIT, 3), (C6_UNIT, 2)):
        # in C, 495/256/M_PI is 1/M_PI
        yield faults.INTEGER_DIVISION, kernel, dim, floor(kernel.constants[dim] * pi + 1e-9) / pi
    for kernel, dim in ((M4, 2), (M5, 2), (M6, 3), (C2_UNIT, 2), (POLY6, 2)):
        yield faults.RECIPROCAL, kernel, dim, 1 / kernel.constants[dim]
    for kernel, dim, other in (
        (C2, 2, M4_UNIT), (C2, 2, M4), (C2_UNIT, 3, M4_UNIT), (M4, 2, C2), (C4, 2, C2), (C4, 3, C2),
        (POLY6, 3, SPIKY), (SPIKY, 3, POLY6), (M4, 3, C4), (M6, 2, M5), (M5, 2, M6),
    ):  # fmt: skip
        yield faults.OTHER_CONSTANT, kernel, dim, other.constants[dim]
    for kernel, dim in ((M4, 3), (C2, 2), (SPIKY, 1)):
        yield faults.SIGN, kernel, dim, -kernel.constants[dim]


CONSTANTS = list(constants())


@pytest.mark.parametrize(("kind", "kernel", "dim", "constant"), CONSTANTS, ids=ids)
def test_a_wrong_constant_is_named(kind: str, kernel: Written, dim: int, constant: float) -> None:
    report = audit(code(kernel, dim, constant), dim)
    assert report.kernel == kernel.name
    assert [f.kind for f in report.faults] == [kind], report.to_text()


#: factors that two slips leave alike: (planted, kernel, dim, constant)
AMBIGUOUS = [
    (faults.CONVENTION, M4, 1, 4 / 3),  # the half range as well
    (faults.INTEGER_DIVISION, M4, 2, 1 / pi),  # the constant of 3D as well
    (faults.OTHER_DIMENSION, M6, 3, 1 / 120),  # a factor π as well
    (faults.RECIPROCAL, M6, 1, 120.0),  # printed so, and copied, as well
    (faults.OTHER_CONSTANT, C2, 3, 1 / pi),  # 21/16 = 1 as well
]


@pytest.mark.parametrize(("kind", "kernel", "dim", "constant"), AMBIGUOUS, ids=ids)
def test_explanations_that_fit_as_well_are_listed(
    kind: str, kernel: Written, dim: int, constant: float
) -> None:
    (fault,) = audit(code(kernel, dim, constant), dim).faults
    assert fault.kind != kind
    assert any(other.startswith(f"{kind}: ") for other in fault.also), fault
    assert "explanations tried" in fault.surely


def test_a_factor_without_a_reason_is_not_given_one() -> None:
    """0.8137… is no slip's factor, and no digit explains it."""
    (fault,) = audit(code(M4, 3, 0.8137261549 / pi), 3).faults
    assert fault.kind == faults.WRONG_CONSTANT
    assert fault.surely.startswith("none of ")


# -- shapes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kernel", "dim"), EVERY, ids=ids)
def test_a_cut_support_is_named(kernel: Written, dim: int) -> None:
    """At half of it, or three quarters, in turn."""
    part = (0.5, 0.75)[EVERY.index((kernel, dim)) % 2]
    whole, end = code(kernel, dim), part * kernel.support

    def cut(r: Any, h: float) -> Any:
        return np.where(r < end * h, whole(r, h), 0.0)

    (fault,) = audit(cut, dim).faults
    assert fault.kind == faults.CUT
    assert fault.message.startswith(f"{kernel.name} evaluated at q < ")


def test_what_is_cut_at_half_its_support_is_said_exactly() -> None:
    """M4 for r < h alone: ∫ (1 − 3/2 q² + 3/4 q³) 4 q² dq = 4/3 − 6/5 + 1/2 = 19/30."""

    def cut(r: Any, h: float) -> Any:
        return np.where(r < h, code(M4, 3)(r, h), 0.0)

    report = audit(cut, 3)
    (fault,) = report.faults
    assert "1/2 of its support" in fault.message
    assert "the integral there is 19/30" in fault.message
    assert f"jumps to 0 from {0.25 / pi:.4g}" in fault.message
    assert report.constant == "1/pi"


TERMS = {
    "3/2 q² is 1 q², 3/4 q³ nothing": lambda q: np.where(q < 1, 1 - q**2, 0.25 * (2 - q) ** 3),
    "3/4 q³ is nothing": lambda q: np.where(q < 1, 1 - 1.5 * q**2, 0.25 * (2 - q) ** 3),
    "1/4 (2 − q)³ is nothing": lambda q: np.where(q < 1, 1 - 1.5 * q**2 + 0.75 * q**3, 0.0),
}


@pytest.mark.parametrize("name", TERMS)
def test_whole_number_division_in_the_shape_is_named(name: str) -> None:
    report = audit(code(M4, 3, function=TERMS[name]), 3)
    (fault,) = report.faults
    expected = faults.CUT if "1/4" in name else faults.INTEGER_DIVISION
    assert fault.kind == expected, report.to_text()


def test_a_factor_that_one_piece_lacks_is_named() -> None:
    """(2 − q)³ for (2 − q)³/4: four times too much beyond q = 1."""
    lost = code(M4, 3, function=lambda q: np.where(q < 1, M4.shape(q), pos(2 - q) ** 3))
    (fault,) = audit(lost, 3).faults
    assert fault.kind == faults.MISPRINT
    assert "cubic-spline: on 1..2 it is 4 times what the first piece asks for" in fault.message


def test_a_shape_without_an_integral_is_judged_by_its_values() -> None:
    """1 − 3/2 q² − 3/4 q³, then (2 − q)³/4: ∫ w q² dq = 1/3 − 3/10 − 1/8 + 11/120 = 0."""
    wrong = code(
        M4, 3, function=lambda q: np.where(q < 1, 1 - 1.5 * q**2 - 0.75 * q**3, M4.shape(q))
    )
    (fault,) = audit(wrong, 3).faults
    assert fault.kind == faults.WRONG_CONSTANT


def test_a_kernel_that_is_no_polynomial_is_judged_by_its_values() -> None:
    """The viscosity kernel of Müller et al. (2003): 15/(2π h³) (−q³/2 + q² + 1/(2q) − 1)."""

    def viscosity(r: Any, h: float) -> Any:
        q = np.where(r > 0, r, h) / h
        w = 15 / (2 * pi * h**3) * (-(q**3) / 2 + q**2 + 1 / (2 * q) - 1)
        return np.where((r > 0) & (r < h), w, 0.0)

    report = audit(viscosity, 3)
    assert report.kernel == ""
    assert report.scaling.startswith("W ∝ h^−3")


def test_a_constant_that_is_divided_away_is_hinted_at() -> None:
    with pytest.raises(ValueError, match="2/3 an integer division"):
        audit(lambda r, h: 2 // 3 / h * M4.shape(r / h), 1)


# -- powers of h ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("kernel", "dim"), EVERY, ids=ids)
def test_a_wrong_power_of_h_is_named_in_w_and_in_both_derivatives(
    kernel: Written, dim: int
) -> None:
    """One too many or too few, in turn."""
    right = [code(kernel, dim, order=order) for order in range(3)]
    for order, name in enumerate(("W", "dW", "d²W")):
        surplus = (1, -1)[(EVERY.index((kernel, dim)) + order) % 2]
        wrong = list(right)
        wrong[order] = code(kernel, dim, order=order, power=-(dim + order) + surplus)
        report = audit(wrong[0], dim, derivative=wrong[1], second_derivative=wrong[2])
        (fault,) = report.faults
        assert fault.kind == faults.POWER_OF_H
        said = f"power of h in {name}: {surplus - dim - order}, should be {-dim - order}"
        assert fault.message.replace("−", "-").startswith(said)
        assert ("did you return dW/dq?" in fault.message) == (order == 1 and surplus == 1)


def test_a_derivative_of_the_wrong_power_is_refused_by_the_oracle() -> None:
    """W right, dW with h⁻³ for h⁻⁴; and with h⁻⁵."""
    right = code(M4, 3)
    assert_kernel(right, "cubic-spline", dim=3, derivative=code(M4, 3, order=1))
    for power in (-3, -5):
        with pytest.raises(AssertionError, match=f"power of h in dW: −{-power}, should be −4"):
            assert_kernel(
                right, "cubic-spline", dim=3, derivative=code(M4, 3, order=1, power=power)
            )
    with pytest.raises(AssertionError, match="d²W/dq²"):
        assert_kernel(
            right, "cubic-spline", dim=3, second_derivative=code(M4, 3, order=2, power=-3)
        )


def test_the_kernel_of_another_dimension_is_told_by_both() -> None:
    """All of M4 in 2D used in 3D: constant and powers of h."""
    report = audit(code(M4, 2), 3, derivative=code(M4, 2, order=1))
    assert [f.kind for f in report.faults] == [faults.OTHER_DIMENSION, faults.POWER_OF_H]
    assert "in dW likewise −3; −2 is that of 2D" in report.faults[1].message


NOT_OF_Q = {
    "the end is a length": lambda r, h: np.where(r < 2, code(M4, 3)(r, h), 0.0) + 0 * h,
    "a softening": lambda r, h: code(M4, 3)(np.sqrt(r**2 + 0.01), h),
    "two powers": lambda r, h: code(M4, 3)(r, h) * (1 + h) / 2,
}


@pytest.mark.parametrize("name", NOT_OF_Q)
def test_what_is_no_power_of_h_is_named(name: str) -> None:
    report = audit(NOT_OF_Q[name], 3, "W(r,h)")
    kinds = {f.kind for f in report.faults}
    assert kinds & {faults.NOT_SIMILAR, faults.POWER_OF_H}, report.to_text()


# -- derivatives ----------------------------------------------------------------------------------

SLOPES = {
    "sign": (faults.SIGN, lambda k, d: lambda q: -k.slope(q), 0),
    "W'/q": (faults.MISSING_Q, lambda k, d: lambda q: k.slope(q) / q, 0),
    "W'/r": (faults.MISSING_Q, lambda k, d: lambda q: k.slope(q) / q, -1),
    "q W'": (faults.SURPLUS_Q, lambda k, d: lambda q: k.slope(q) * q, 0),
    "dW/dh": (faults.OTHER_FUNCTION, lambda k, d: lambda q: -d * k.shape(q) - q * k.slope(q), 0),
    "W''": (faults.OTHER_FUNCTION, lambda k, d: k.bend, 0),
}


@pytest.mark.parametrize("name", SLOPES)
@pytest.mark.parametrize(
    ("kernel", "dim"), [(M4, 3), (M5, 1), (M6, 2), (C2_UNIT, 3), (C4, 2), (POLY6, 3), (SPIKY, 2)],
    ids=ids,
)  # fmt: skip
def test_a_wrong_derivative_is_named(name: str, kernel: Written, dim: int) -> None:
    kind, make, surplus = SLOPES[name]
    slope = code(kernel, dim, order=1, power=-(dim + 1) + surplus, function=make(kernel, dim))
    report = audit(code(kernel, dim), dim, derivative=slope)
    assert [f.kind for f in report.faults] == [kind], report.to_text()


SECONDS = {
    "sign": (faults.SIGN, lambda k, d: lambda q: -k.bend(q)),
    "W'/q": (faults.MISSING_Q, lambda k, d: lambda q: k.bend(q) / q),
    "W'": (faults.OTHER_FUNCTION, lambda k, d: k.slope),
    "the Laplacian": (
        faults.OTHER_FUNCTION,
        lambda k, d: lambda q: k.bend(q) + (d - 1) * k.slope(q) / q,
    ),
}


@pytest.mark.parametrize("name", SECONDS)
@pytest.mark.parametrize(("kernel", "dim"), [(M4, 3), (M6, 2), (C2, 3), (POLY6, 2)], ids=ids)
def test_a_wrong_second_derivative_is_named(name: str, kernel: Written, dim: int) -> None:
    kind, make = SECONDS[name]
    bend = code(kernel, dim, order=2, function=make(kernel, dim))
    report = audit(code(kernel, dim), dim, second_derivative=bend)
    assert [f.kind for f in report.faults] == [kind], report.to_text()
    assert report.second_derivative == "not the second derivative of W"


def test_a_lost_factor_of_the_power_rule_is_named() -> None:
    """(1 − q)³ differentiated to −(1 − q)²."""
    lost = code(SPIKY, 3, order=1, function=lambda q: -(pos(1 - q) ** 2))
    (fault,) = audit(code(SPIKY, 3), 3, derivative=lost).faults
    assert fault.kind == faults.WRONG_DERIVATIVE
    assert "the factor 3 of the power rule is lost" in fault.message


def test_a_derivative_that_is_wrong_on_one_piece_says_where() -> None:
    lost = code(M4, 3, order=1, function=lambda q: np.where(q < 1, M4.slope(q), 0.0))
    (fault,) = audit(code(M4, 3), 3, derivative=lost).faults
    assert fault.kind == faults.CUT
    assert "for 1 < q < 2 it is 0" in fault.message
    turned = code(M4, 3, order=1, function=lambda q: np.where(q < 1, 1, -1) * M4.slope(q))
    (fault,) = audit(code(M4, 3), 3, derivative=turned).faults
    assert fault.kind == faults.SIGN
    assert "for 1 < q < 2 it is -1 times W′" in fault.message


# -- no false alarm -------------------------------------------------------------------------------


@pytest.mark.parametrize(("kernel", "dim"), EVERY, ids=ids)
def test_right_kernels_are_accused_of_nothing(kernel: Written, dim: int) -> None:
    w, dw, d2w = (code(kernel, dim, order=order) for order in range(3))
    report = assert_kernel(w, kernel.name, dim, derivative=dw, second_derivative=d2w)
    assert report.derivative == "the derivative of W"
    assert report.second_derivative == "the second derivative of W"
    assert report.scaling.startswith(f"W ∝ h^−{dim}, dW ∝ h^−{dim + 1}, d²W ∝ h^−{dim + 2} ")


def table(path: Any, lengths: tuple[float, ...], columns: dict[str, Any], common: bool) -> Audit:
    """Written with 12 digits, r evenly to 2.2 h of each, or to that of the largest for all."""
    rows = ["r,h," + ",".join(columns)]
    for h in lengths:
        for r in np.linspace(0, 2.2 * (max(lengths) if common else h), 80):
            row = (r, h, *(f(r, h) for f in columns.values()))
            rows.append(",".join(f"{float(v):.12g}" for v in row))
    path.write_text("\n".join(rows) + "\n")
    return audit_table(path, 3)


@pytest.mark.parametrize("lengths", [(0.1, 0.2), (5.0, 6.0, 7.0, 20.0)])
@pytest.mark.parametrize("common", [False, True])
@pytest.mark.parametrize("kernel", [M4, C4], ids=ids)
def test_a_table_of_several_h_shows_the_power(
    tmp_path: Any, lengths: tuple[float, ...], common: bool, kernel: Written
) -> None:
    w, dw = code(kernel, 3), code(kernel, 3, order=1)
    right = {"W": w, "dW": dw, "d2W": code(kernel, 3, order=2)}
    report = table(tmp_path / "t.csv", lengths, right, common)
    assert report.clean, report.to_text()
    assert report.kernel == kernel.name
    for column, order, power, expected in (("dW", 1, -3, -4), ("W", 0, -2, -3), ("dW", 1, -5, -4)):
        wrong = {**right, column: code(kernel, 3, order=order, power=power)}
        (fault,) = table(tmp_path / "t.csv", lengths, wrong, common).faults
        assert fault.kind == faults.POWER_OF_H
        said = f"power of h in {column}: {power}, should be {expected}"
        assert fault.message.replace("−", "-").startswith(said)


def test_a_table_of_one_h_shows_it_as_a_factor(tmp_path: Any) -> None:
    """With h = 0.1 a derivative by q is a tenth of that by r."""
    columns = {"W": code(M4, 3), "dW": code(M4, 3, order=1, power=-3)}
    report = table(tmp_path / "t.csv", (0.1,), columns, False)
    (fault,) = report.faults
    assert fault.kind == faults.POWER_OF_H
    assert "did you return dW/dq?" in fault.message
    assert report.scaling == "not checked: all values are of h = 0.1"


def test_a_column_that_says_it_is_a_derivative_by_q_is_believed(tmp_path: Any) -> None:
    for lengths in ((0.1,), (0.1, 0.3)):
        columns = {"W": code(M4, 3), "dW/dq": code(M4, 3, order=1, power=-3)}
        report = table(tmp_path / "t.csv", lengths, columns, False)
        assert report.clean, report.to_text()
        assert report.derivative == "the derivative of W"


def test_unknown_columns_are_left_alone_and_that_is_said(tmp_path: Any) -> None:
    columns = {"W": code(M4, 3), "F": code(M4, 3, order=1, power=-3)}
    report = table(tmp_path / "t.csv", (0.1,), columns, False)
    assert report.clean
    assert report.notes[0] == "columns of no known meaning, left alone: f"
