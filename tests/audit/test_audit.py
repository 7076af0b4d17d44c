"""Planted faults are all found and named, right kernels are not accused, bad input is refused."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sphtrunc
from sphtrunc import kernel
from sphtrunc.audit import PUBLISHED, audit, audit_formula, audit_list, audit_table
from sphtrunc.audit import faults as slips
from sphtrunc.audit.recognition import conventions, profiles
from sphtrunc.testing import assert_kernel

PI = math.pi


# -- kernels as other codes write them, sharing nothing with the package --------------------------


def cubic(q, sigma=1 / PI):
    return sigma * np.where(
        q < 1, 1 - 1.5 * q**2 + 0.75 * q**3, 0.25 * np.clip(2 - q, 0, None) ** 3
    )


def cubic_slope(q, sigma=1 / PI):
    return sigma * np.where(q < 1, -3 * q + 2.25 * q**2, -0.75 * np.clip(2 - q, 0, None) ** 2)


def quintic(q, sigma=1 / (120 * PI)):
    a, b, c = (np.clip(k - q, 0, None) ** 5 for k in (3, 2, 1))
    return sigma * (a - 6 * b + 15 * c)


def quintic_slope(q, sigma=1 / (120 * PI)):
    a, b, c = (np.clip(k - q, 0, None) ** 4 for k in (3, 2, 1))
    return -5 * sigma * (a - 6 * b + 15 * c)


def wendland(q, sigma=21 / (16 * PI)):
    return sigma * np.clip(1 - q / 2, 0, None) ** 4 * (1 + 2 * q)


def wendland_slope(q, sigma=21 / (16 * PI)):
    return -5 * sigma * q * np.clip(1 - q / 2, 0, None) ** 3


def wendland_c4(q, sigma=495 / (256 * PI)):
    return sigma * np.clip(1 - q / 2, 0, None) ** 6 * (35 * q**2 / 12 + 3 * q + 1)


def gaussian(q, sigma, end):
    return np.where(q < end, sigma * np.exp(-(q**2)), 0)


def johnson(q, sigma=15 / (64 * PI)):
    return sigma * np.clip(2 - q, 0, None) ** 2


def hyperbolic_slope(q, sigma=15 / (62 * PI)):
    return sigma * np.where(q < 1, 3 * q**2 - 6, -3 * np.clip(2 - q, 0, None) ** 2)


def b_spline_8(q, sigma):
    return sigma * sum(
        (-1) ** j * math.comb(8, j) * np.clip(4 - j - q, 0, None) ** 7 for j in range(4)
    )


M8 = float(kernel("b-spline:8").normalisation(3).evalf(20))


def lost_digits(q):
    return cubic(q.astype(np.float32), np.float32(1 / PI)).astype(np.float32).astype(np.float64)


FORMULAS = [
    ("quintic-spline", "3/(359*pi)", 3, slips.MISPRINT, "360/359"),
    ("quintic-spline", "1/(478*pi)", 2, slips.MISPRINT, "1/7"),
    ("quintic-spline", "120", 1, slips.MISPRINT, "14400"),
    ("double-cosine", "pi^2/(4*pi^2-30)", 3, slips.FACTOR_PI, "pi"),
    ("0..1: (1-q^2)^3", "35/16", 1, slips.HALF_RANGE, "2"),
    ("0..1: (1-q^2)^3", "35/(32*pi)", 2, slips.MISSING_Q, "35/128"),
    ("cubic-spline", "4/3", 1, slips.HALF_RANGE, "2"),
    ("cubic-spline", "10/(7*pi)", 3, slips.OTHER_DIMENSION, "10/7"),
    ("wendland-c4", "495/(256*pi)", 2, slips.OTHER_DIMENSION, "55/64"),
    ("cubic-spline", "8/pi", 3, slips.CONVENTION, "8"),
    ("0..1/2: 1-6*q^2+6*q^3; 1/2..1: 2*(1-q)^3", "1/pi", 3, slips.CONVENTION, "1/8"),
    ("quintic-spline", "1/(40*pi)", 3, slips.POWER_OF_SUPPORT, "3"),
    ("cubic-spline", "15/(7*pi)", 2, slips.OTHER_FORM, "3/2"),
    ("wendland-c4", "21/(16*pi)", 3, slips.OTHER_CONSTANT, "112/165"),
    ("wendland-c2", "21/(16)", 3, slips.FACTOR_PI, "pi"),
    ("quartic-spline", "96/(1189*pi)", 2, slips.MISPRINT, "1199/1189"),
    ("cubic-spline", "0.318", 3, slips.ROUNDED, "159*pi/500"),
    ("gaussian", "1/sqrt(pi)", 2, slips.OTHER_DIMENSION, "sqrt(pi)"),
    ("wendland-c2", "16*pi/21", 3, slips.RECIPROCAL, "256*pi**2/441"),
    ("cubic-spline", "7*pi/10", 2, slips.RECIPROCAL, "49*pi**2/100"),
    ("cubic-spline", "7/22", 3, slips.ROUNDED, "7*pi/22"),
]


@pytest.mark.parametrize(("formula", "constant", "dim", "kind", "factor"), FORMULAS)
def test_a_planted_constant_is_found_and_named(formula, constant, dim, kind, factor):
    report = audit_formula(formula, constant, dim)
    assert [f.kind for f in report.faults] == [kind], report.to_text()
    assert f"integrates to {factor} " in report.faults[0].message


CALLABLES = {
    "quintic 3/(359 pi)": (lambda q: quintic(q, 3 / (359 * PI)), None, 3, slips.MISPRINT),
    "M8 a sixteenth": (lambda q: b_spline_8(q, M8 / 16), None, 3, slips.POWER_OF_SUPPORT),
    "cubic half range": (lambda q: cubic(q, 4 / 3), None, 1, slips.HALF_RANGE),
    "cubic 2D in 3D": (lambda q: cubic(q, 10 / (7 * PI)), None, 3, slips.OTHER_DIMENSION),
    "cubic on 1h": (lambda q: cubic(2 * q), None, 3, slips.CONVENTION),
    "gauss cut at 3": (lambda q: gaussian(q, PI**-1.5, 3), None, 3, slips.TRUNCATION),
    "gauss cut at 2": (lambda q: gaussian(q, PI**-0.5, 2), None, 1, slips.TRUNCATION),
    "other derivative": (johnson, hyperbolic_slope, 3, slips.OTHER_DERIVATIVE),
    "no q in W'": (wendland, lambda q: wendland_slope(q) / q, 3, slips.MISSING_Q),
    "q W'": (wendland, lambda q: wendland_slope(q) * q, 3, slips.SURPLUS_Q),
    "sign": (cubic, lambda q: -cubic_slope(q), 3, slips.SIGN),
    "chain rule": (
        lambda q: 8 * cubic(2 * q),
        lambda q: 8 * cubic_slope(2 * q),
        3,
        slips.POWER_OF_SUPPORT,
    ),
    "W' another h": (cubic, lambda q: 16 * cubic_slope(2 * q), 3, slips.CONVENTION),
    "W' term": (
        cubic,
        lambda q: np.where(q < 1, cubic_slope(q) + q**2 / PI, cubic_slope(q)),
        3,
        slips.MISPRINT,
    ),
    "W' constant": (cubic, lambda q: cubic_slope(q, 10 / (7 * PI)), 3, slips.OTHER_DIMENSION),
    "float32 inside": (lost_digits, None, 3, slips.SINGLE_PRECISION),
    "pi in single": (lambda q: cubic(q, 1 / 3.1415927), None, 3, slips.SINGLE_PRECISION),
    "pi as 3.14": (lambda q: cubic(q, 0.3185), None, 3, slips.WRONG_CONSTANT),
    "four digits": (lambda q: cubic(q, 0.3183), None, 3, slips.ROUNDED),
    "q^3 coefficient": (
        lambda q: np.where(q < 1, cubic(q) + q**3 / 4 / PI, cubic(q)),
        None,
        3,
        slips.MISPRINT,
    ),
    "wendland (1+q)": (
        lambda q: 21 / (16 * PI) * np.clip(1 - q / 2, 0, None) ** 4 * (1 + q),
        None,
        3,
        slips.MISPRINT,
    ),
    "C2's constant": (lambda q: wendland_c4(q, 21 / (16 * PI)), None, 3, slips.OTHER_CONSTANT),
    "no q in the integral": (
        lambda q: wendland(q, 1 / (2 * PI * 2 / 3)),
        None,
        2,
        slips.MISSING_Q,
    ),
}


@pytest.mark.parametrize("name", CALLABLES)
def test_a_planted_fault_of_a_callable_is_found_and_named(name):
    function, slope, dim, kind = CALLABLES[name]
    report = audit(function, dim, derivative=slope)
    assert [f.kind for f in report.faults] == [kind], report.to_text()


def test_the_power_of_h_is_checked():
    report = audit(lambda r, h: cubic(r / h) / h**2, 3, "W(r,h)")
    assert [f.kind for f in report.faults] == [slips.POWER_OF_H]
    assert "power of h in W: −2, should be −3" in report.faults[0].message


def test_a_right_derivative_beside_a_wrong_constant_is_told():
    report = audit(lambda q: quintic(q, 3 / (359 * PI)), 3, derivative=quintic_slope)
    assert [f.kind for f in report.faults] == [slips.MISPRINT, slips.WRONG_CONSTANT]
    assert "right constant, which W does not" in report.faults[1].message


@pytest.mark.parametrize(
    ("formula", "constant", "dim", "said"),
    [
        ("wendland-c2", "16*pi/21", 3, "the reciprocal of the right constant"),
        ("cubic-spline", "7*pi/10", 2, "the reciprocal of the right constant"),
        ("cubic-spline", "7/22", 3, "π was taken as 22/7"),
        ("cubic-spline", "70/154", 2, "π was taken as 22/7"),
        ("cubic-spline", "50/157", 3, "π was taken as 3.14;"),
        ("cubic-spline", "1250/3927", 3, "π was taken as 3.1416;"),
    ],
)
def test_the_slip_behind_a_constant_is_told(formula, constant, dim, said):
    (fault,) = audit_formula(formula, constant, dim).faults
    assert said in fault.message


@pytest.mark.parametrize(
    ("name", "kappa", "meaning"),
    [
        ("cubic", 1.0, "the support radius"),
        ("cubic", 4.0, "something else"),
        ("cubic", 2 * math.sqrt(5 / 6), "2σ"),  # 1.825742, Dehnen & Aly (2012), table 1
        ("quintic", 1.0, "the support radius"),
        ("quintic", 1.5, "something else"),
        ("quintic", 6.0, "something else"),
    ],
)
def test_a_slope_of_another_h_is_named_with_its_support(name, kappa, meaning):
    """W as written, dW of the same kernel with support κ, which is not always 1."""
    w, slope, support = {"cubic": (cubic, cubic_slope, 2), "quintic": (quintic, quintic_slope, 3)}[
        name
    ]
    stretch = support / kappa
    report = audit(w, 3, derivative=lambda q: stretch**4 * slope(stretch * q))
    assert [f.kind for f in report.faults] == [slips.CONVENTION], report.to_text()
    where = f"support at {kappa:.7g}h (as if h were {meaning}), W at {support}h"
    assert where in report.faults[0].message


@pytest.mark.parametrize("power", [-1, 1, 2])
def test_a_lost_chain_rule_is_told_for_any_support(power):
    """W of support 3, its slope times 3^power."""
    report = audit(quintic, 3, derivative=lambda q: 3.0**power * quintic_slope(q))
    assert [f.kind for f in report.faults] == [slips.POWER_OF_SUPPORT], report.to_text()
    assert f"the chain rule's factor 3^{-power} is lost" in report.faults[0].message


def test_the_size_of_a_truncation_is_that_of_the_error_function():
    report = audit(lambda q: gaussian(q, PI**-0.5, 2), 1)
    assert f"{math.erfc(2):.4g} of its integral" in report.faults[0].message


def test_a_truncated_gaussian_with_its_own_constant_is_clean():
    sigma = PI**-0.5 / math.erf(3)
    assert audit(lambda q: gaussian(q, sigma, 3), 1).clean


# -- no false alarm -------------------------------------------------------------------------------

SHAPES = [k for k, _ in profiles() if k.name not in ("polynomial:20", "b-spline:20")]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda k: k.name)
def test_no_catalogue_kernel_is_accused(shape, tmp_path):
    """Each once as a callable and once as a table; dimension, precision and h take turns."""
    turn = SHAPES.index(shape)
    dim = 1 + turn % 3
    real = (np.float64, np.float32)[turn // 3 % 2]
    wanted = ("h", "the support radius", "2σ")[turn // 2 % 3]
    support = dict(conventions(shape, dim))[wanted]
    stretch = float(shape.support) / support

    def w(q):
        return shape.w((q * stretch).astype(real), dim) * real(stretch**dim)

    def dw(q):
        return shape.dw((q * stretch).astype(real), dim) * real(stretch ** (dim + 1))

    report = audit(w, dim, derivative=dw)
    assert report.clean, report.to_text()
    assert kernel(report.kernel) == shape  # which may have another name in another dimension
    same = [name for name, one in conventions(shape, dim) if math.isclose(one, support)]
    assert any({"h": "the catalogue's h"}.get(name, name) in report.convention for name in same)
    q = np.linspace(0, support, 1000)
    np.savez(tmp_path / "table.npz", q=q, W=w(q), dW=dw(q))
    report = audit_table(tmp_path / "table.npz", dim)
    assert report.clean, report.to_text()
    assert kernel(report.kernel) == shape


@pytest.mark.parametrize("digits", [4, 7, 10, 17])
def test_a_table_is_judged_within_its_digits(digits, tmp_path):
    q = np.linspace(0, 2.1, 1000)
    lines = [f"{a:.{digits}g},{b:.{digits}g}" for a, b in zip(q, cubic(q), strict=True)]
    (tmp_path / "t.csv").write_text("q,W\n" + "\n".join(dict.fromkeys(lines)) + "\n")
    report = audit_table(tmp_path / "t.csv", 3)
    assert report.clean, report.to_text()
    assert report.kernel == "cubic-spline"


def test_an_interpolated_kernel_is_judged_within_its_interpolation():
    nodes = np.linspace(0, 2, 1001)
    table = wendland(nodes)
    report = audit(lambda q: np.interp(q, nodes, table, right=0.0), 3)
    assert report.clean, report.to_text()
    assert report.kernel == "wendland-c2"
    wrong = audit(lambda q: np.interp(q, nodes, 1.01 * table, right=0.0), 3)
    assert [f.kind for f in wrong.faults] == [slips.WRONG_CONSTANT]


def test_scalar_callables_and_units_of_h_are_taken():
    def scalar(r, h, dim):
        q = r / h
        if q >= 2:
            return 0
        sigma = {1: 2 / 3, 2: 10 / (7 * PI), 3: 1 / PI}[dim]
        return sigma / h**dim * (1 - 1.5 * q**2 + 0.75 * q**3 if q < 1 else 0.25 * (2 - q) ** 3)

    for dim in (1, 2, 3):
        report = audit(scalar, dim, "W(r,h,dim)")
        assert report.clean
        assert report.kernel == "cubic-spline"


def test_a_kernel_of_ones_own_is_recovered_and_clean():
    own = kernel("0..1/2: 3-2*q^2; 1/2..3/2: 5/2*(3/2-q)^2")
    report = audit(lambda q: own.w(q, 2), 2, derivative=lambda q: own.dw(q, 2))
    assert report.clean
    assert report.shape.startswith("0..1/3: ")
    assert report.continuity == {"q = 0": "smooth", "q = 1/2": "C0", "q = 3/2": "C1"}


# -- unusable input -------------------------------------------------------------------------------


def returns(value):
    return lambda q: value


BROKEN = {
    "raises": (lambda q: 1 / 0, "ZeroDivisionError"),
    "exits": (lambda q: sys.exit(3), "SystemExit"),
    "shape": (lambda q: np.zeros((2, 2)), "shape"),
    "nan": (lambda q: np.full(np.shape(q), np.nan), "NaN"),
    "integers": (returns(3), "integers"),
    "object": (returns(object()), "object"),
    "text": (returns("1.0"), "str"),
    "none": (returns(None), "NoneType"),
    "complex": (lambda q: q * 1j, "complex"),
    "zero": (lambda q: 0.0 * q, "zero everywhere"),
    "endless": (lambda q: 1.0 + q, "vanished"),
    "no arguments": (lambda: 1.0, "TypeError"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_an_unusable_callable_is_refused_in_one_line(name):
    function, said = BROKEN[name]
    with pytest.raises(ValueError, match=said) as caught:
        audit(function, 3)
    assert "\n" not in str(caught.value)


TABLES = {
    "q,W\n0,1\n1,0\n": "points",
    "q,V\n0,1\n": "no column W",
    "r,W\n0,1\n": "no column q",
    "q,W,W\n0,1,1\n": "twice",
    "q,W\n" + "".join(f"{20 - i},1.5\n" for i in range(20)): "falls",
    "q,W\n" + "".join(f"{i // 2},1.5\n" for i in range(40)): "repeats",
    "q,W\n" + "".join(f"{i},nan\n" for i in range(40)): "NaN",
    "q,W\n0,x\n": "not a number",
    "q,W\n0,1,2\n": "columns",
    "q,W\n" + "".join(f"{i},0\n" for i in range(40)): "zero everywhere",
    "": "empty",
}


@pytest.mark.parametrize("text", TABLES, ids=TABLES.values())
def test_an_unusable_table_is_refused(text, tmp_path):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ValueError, match=TABLES[text]):
        audit_table(tmp_path / "t.csv", 3)


def test_a_pickle_in_an_npz_is_not_opened(tmp_path):
    np.savez(tmp_path / "t.npz", q=np.array([object()] * 20), W=np.zeros(20))
    with pytest.raises(ValueError, match="not a readable NPZ"):
        audit_table(tmp_path / "t.npz", 3)


def run(*arguments, cwd):
    code = "from sphtrunc.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=cwd
    )


def test_the_command_line_from_module_to_exit_status(tmp_path):
    (tmp_path / "mine.py").write_text(
        "def W(r, h):\n"
        "    q = r / h\n"
        "    return 0.75 / h * (1 - q * q) if q < 1 else 0.0\n"
        "class Own:\n"
        "    def W(self, r, h):\n"
        "        return 2 * W(r, h)\n"
    )
    clean = run("audit", "--python", "mine:W", "--dim", "1", "--format", "json", cwd=tmp_path)
    assert clean.returncode == 0, clean.stderr
    assert json.loads(clean.stdout)[0]["kernel"] == "polynomial:0"
    wrong = run("audit", "--python", "mine:Own.W", "--dim", "1", cwd=tmp_path)
    assert wrong.returncode == 1
    assert slips.HALF_RANGE in wrong.stdout
    for bad in ("nowhere:W", "mine:V", "mine", "mine:W;x", "mine:__name__"):
        refused = run("audit", "--python", bad, "--dim", "1", cwd=tmp_path)
        assert refused.returncode == 2
        assert refused.stderr.startswith("Error: ")
        assert refused.stderr.count("\n") == 1


def test_only_what_is_named_is_executed(tmp_path):
    (tmp_path / "sly.py").write_text(
        "from pathlib import Path\n"
        "def W(r, h):\n"
        "    return 1.0 / h if r < h else 0.0\n"
        "def other():\n"
        "    Path('executed').touch()\n"
        "main = other\n"
    )
    run("audit", "--python", "sly:W", "--dim", "1", cwd=tmp_path)
    assert not (tmp_path / "executed").exists()


# -- the oracle and the published list ------------------------------------------------------------


def test_assert_kernel_passes_and_fails():
    assert_kernel(quintic, "quintic-spline", dim=3, derivative=quintic_slope, support=3)
    with pytest.raises(AssertionError, match="360/359"):
        assert_kernel(lambda q: quintic(q, 3 / (359 * PI)), "quintic-spline", dim=3)
    with pytest.raises(AssertionError, match="it is cubic-spline, not quintic-spline"):
        assert_kernel(cubic, "quintic-spline", dim=3)
    with pytest.raises(AssertionError, match="support"):
        assert_kernel(cubic, "cubic-spline", dim=3, support=1)


def test_the_published_list_is_readable_and_finds_what_is_known():
    reports = audit_list(PUBLISHED)
    assert len(reports) >= 20
    found = {r.integral for r in reports}
    assert "360/359" in found
    assert sum(r.clean for r in reports) >= len(reports) // 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no \\[\\[kernel\\]\\]"),
        ("[[kernel]]\ndim=3\n", "expected formula"),
        ("[[kernel]]\ndim=3\nformula='q'\nconstant='1'\nspeed=1\n", "unknown key"),
        ("[[kernel]]\ndim=[2,3]\nformula='cubic-spline'\nconstant='1'\n", "1 constants for 2"),
        ("[[kernel]]\ndim=3\nformula='q'\nconstant='1'\noperator='x'\n", "expected project"),
        ("[[", "malformed"),
    ],
)
def test_a_list_that_cannot_be_read_is_refused(text, said, tmp_path):
    (tmp_path / "l.toml").write_text(text)
    with pytest.raises(ValueError, match=said):
        audit_list(tmp_path / "l.toml")


LAMMPS = """
[[kernel]]
project = "LAMMPS"
operator = "density"
dim = 3
formula = "0..1: (1-q^2)^4"
constant = "3465/(512*pi)"

[[kernel]]
project = "LAMMPS"
operator = "pressure force"
dim = 3
formula = "0..1: (1+3*q)*(1-q)^3"
derivative = "0..1: -12*q*(1-q)^2"
constant = "105/(16*pi)"
"""


def test_operators_of_one_code_share_a_kernel(tmp_path):
    """Both are right by themselves; the second is not the kernel of the first."""
    (tmp_path / "l.toml").write_text(LAMMPS)
    density, force = audit_list(tmp_path / "l.toml")
    assert density.clean
    assert [fault.kind for fault in force.faults] == [slips.MIXED]
    assert (
        "pressure force takes lucy with support 1 h, and density of the same code polynomial:3"
        in (force.faults[0].message)
    )
    for change in (("LAMMPS", "another", 1), ('operator = "pressure force"\n', "", -1)):
        (tmp_path / "l.toml").write_text(LAMMPS.replace(*change))
        assert all(report.clean for report in audit_list(tmp_path / "l.toml"))
    same = LAMMPS.replace("(1-q^2)^4", "(1+3*q)*(1-q)^3").replace("3465/(512*pi)", "105/(16*pi)")
    (tmp_path / "l.toml").write_text(same)
    assert all(report.clean for report in audit_list(tmp_path / "l.toml"))
    wide = same.replace("0..1: (1+3*q)*(1-q)^3", "0..2: (1+3*q/2)*(1-q/2)^3", 1)
    (tmp_path / "l.toml").write_text(wide.replace("105/(16*pi)", "105/(128*pi)", 1))
    assert audit_list(tmp_path / "l.toml")[1].faults[0].kind == slips.MIXED


def test_the_slope_of_another_kernel_is_named():
    """Forces from Lucy's gradient beside densities of (1 − q²)⁴, as LAMMPS has them."""

    def w(q):
        return 3465 / (512 * PI) * np.clip(1 - q**2, 0, None) ** 4

    def dw(q):
        return 105 / (16 * PI) * -12 * q * np.clip(1 - q, 0, None) ** 2

    (fault,) = audit(w, 3, derivative=dw).faults
    assert fault.kind == slips.OTHER_DERIVATIVE
    assert "dW is that of lucy, not of polynomial:3" in fault.message


def test_every_report_can_be_written_in_every_format():
    report = audit_formula("quintic-spline", "3/(359*pi)", 3)
    assert json.loads(report.to_json())["faults"][0]["kind"] == slips.MISPRINT
    assert report.to_markdown().count("|") == 7
    assert "FAULT" in report.to_text()


def test_the_list_is_part_of_the_package():
    assert Path(PUBLISHED).parent == Path(sphtrunc.__file__).with_name("audit")
