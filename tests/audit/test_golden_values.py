"""Golden values against mpmath, the headers compiled, the strategy, the verification page."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
import sys
from pathlib import Path

import mpmath
import pytest
from hypothesis import given, settings

from sphtrunc import kernel
from sphtrunc.audit.golden import export, golden
from sphtrunc.testing import kernels

ROOT = Path(__file__).parents[2]


def quintic(q):
    """(σ = 1/(120π)) the quintic spline and its derivatives, from truncated powers."""
    terms = [(3, 1), (2, -6), (1, 15)]
    parts = [(max(mpmath.mpf(k) - q, mpmath.mpf(0)), c) for k, c in terms]
    scale = 1 / (120 * mpmath.pi)
    return [
        scale * sum(c * x**5 for x, c in parts),
        scale * sum(-5 * c * x**4 for x, c in parts),
        scale * sum(20 * c * x**3 for x, c in parts),
    ]


@pytest.mark.parametrize("digits", [17, 30])
def test_golden_values_are_correctly_rounded(digits):
    data = golden("quintic-spline", 3, points=31, digits=digits)
    with mpmath.workdps(60):
        for i, row in enumerate(data["rows"]):
            q = mpmath.mpf(3 * i) / 30
            for text, exact in zip(row, [q, *quintic(q)], strict=True):
                assert abs(mpmath.mpf(text) - exact) <= abs(exact) * mpmath.mpf(10) ** (1 - digits)
    assert data["normalisation"] == "1/(120*pi)"
    assert data["moments"]["2"] == "7/5"


def test_csv_and_json_say_the_same():
    data = json.loads(export("wendland-c2", 2, points=11))
    table = list(csv.reader(io.StringIO(export("wendland-c2", 2, points=11, format="csv"))))
    assert table[0] == data["columns"] == ["q", "W", "dW", "d2W"]
    assert table[1:] == data["rows"]
    assert len(data["rows"]) == 11


def test_seventeen_digits_determine_the_double():
    shape = kernel("cubic-spline")
    for q, w, *_ in golden(shape, 3, points=9)["rows"]:
        assert abs(float(w) - shape.w(float(q), 3)) <= 4 * 2.0**-52 * float(w)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_c_header_compiles_and_holds_the_values(tmp_path):
    (tmp_path / "golden.h").write_text(export("quintic-spline", 3, points=7, format="c"))
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "golden.h"\n'
        "int main(void) {\n"
        "  for (int i = 0; i < golden_quintic_spline_3d_points; i++)\n"
        '    printf("%.17g\\n", golden_quintic_spline_3d[i][1]);\n'
        "  return 0;\n}\n"
    )
    subprocess.run(["cc", "-Wall", "-Werror", "main.c", "-o", "main"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    rows = golden("quintic-spline", 3, points=7)["rows"]
    assert [float(x) for x in said.split()] == [float(row[1]) for row in rows]


def test_the_fortran_include_is_well_formed():
    text = export("cubic-spline", 1, points=130, format="fortran")
    lines = text.splitlines()
    assert all(len(line) <= 132 for line in lines)
    values = [line for line in lines if line.endswith((", &", " /")) and "d" in line]
    assert sum(not line.startswith("data") for line in values) == 4 * 130
    assert text.count("data golden_cubic_spline_1d_w(") == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"points": 1}, "points"),
        ({"points": 10**9}, "points"),
        ({"digits": 5}, "digits"),
        ({"format": "xml"}, "format"),
        ({"dim": 4}, "dim"),
    ],
)
def test_bad_requests_are_refused(arguments, said):
    with pytest.raises(ValueError, match=said):
        export("cubic-spline", **arguments)


@given(kernels())
@settings(max_examples=30)
def test_the_strategy_draws_continuous_kernels_that_can_be_normalised(shape):
    assert shape.boundary_smoothness >= 0
    assert all(order >= 0 for order in shape.knot_smoothness().values())
    assert shape.moment(0, 2) == 1


def test_the_verification_page_runs_without_the_packages_and_carries_no_outputs():
    page = ROOT / "notebooks" / "verification.ipynb"
    cells = json.loads(page.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)
    assert "assert" in "".join(code[-1]["source"])
    program = "\n".join("".join(cell["source"]) for cell in code)
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "published and" in ran.stdout


def test_a_gaussian_has_no_exact_rows():
    with pytest.raises(ValueError, match="kernel: gaussian:3 is not piecewise polynomial"):
        golden("gaussian:3")
