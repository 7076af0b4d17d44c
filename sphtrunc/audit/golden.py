"""Golden values of a kernel for the tests of other codes: exact strings, correctly rounded digits.

Everything is computed in exact rational arithmetic and multiplied by σ_d at 50 digits more than
are written.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import mpmath
from sympy import Rational

from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.version import __version__

SCHEMA = "sphtrunc.golden/1"
DIGITS = (17, 30)
FORMATS = ("json", "csv", "c", "fortran")
MOMENTS = (0, 2, 4, 6)


def golden(
    kernel: Kernel | str, dim: int = 3, points: int = 200, digits: int = 17
) -> dict[str, Any]:
    """σ_d, kernel moments ∫|s|ⁿ Ŵ d^d s and a table of q, Ŵ, Ŵ′, Ŵ″, as strings.

    points: evenly spaced over [0, κ], both ends included, exact rationals. At a knot where a
    derivative jumps the value is that from the left (at q = 0, from the right).

    Raises ValueError for fewer than 2 or more than 100,000 points, for digits other than 17 or 30,
    and for a kernel that is not a polynomial.
    """
    shape, dim = parse_kernel(kernel), dimension(dim)
    if not shape.is_polynomial:
        raise ValueError(
            f"kernel: {shape.name} is not piecewise polynomial, so that its values are not exact;"
            " expected another kernel"
        )
    if not 2 <= points <= 100_000:
        raise ValueError(f"points: got {points}, expected 2 to 100000")
    if digits not in DIGITS:
        raise ValueError(f"digits: got {digits}, expected 17 or 30")
    sigma = shape.normalisation(dim)
    return {
        "schema": SCHEMA,
        "kernel": shape.name,
        "source": shape.source,
        "dim": dim,
        "support": str(shape.support),
        "normalisation": str(sigma),
        "normalisation_digits": _digits(sigma.evalf(digits + 50), digits),
        "moments": {str(n): str(shape.moment(n, dim)) for n in MOMENTS},
        "columns": ["q", "W", "dW", "d2W"],
        "rows": list(_rows(shape, sigma.evalf(digits + 50), points, digits)),
        "version": __version__,
    }


def export(
    kernel: Kernel | str,
    dim: int = 3,
    points: int = 200,
    digits: int = 17,
    format: str = "json",
) -> str:
    """The golden values as a text: JSON, CSV, a C header or a Fortran include file.

    Raises ValueError for an unknown format, and as `golden`.
    """
    if format not in FORMATS:
        raise ValueError(f"format: got {format!r}, expected one of {', '.join(FORMATS)}")
    data = golden(kernel, dim, points, digits)
    writers = {"json": _json, "csv": _csv, "c": _c, "fortran": _fortran}
    return writers[format](data)


def _rows(shape: Kernel, sigma: Any, points: int, digits: int) -> Iterator[list[str]]:
    orders = [shape.pieces, shape.derivative(), tuple(p.diff() for p in shape.derivative())]
    for i in range(points):
        at = shape.support * Rational(i, points - 1)
        piece = next(j for j, k in enumerate(shape.knots[1:]) if at <= k)
        values = [pieces[piece].eval(at) for pieces in orders]
        yield [_digits(at, digits), *(_digits(sigma * v, digits) for v in values)]


def _digits(value: Any, digits: int) -> str:
    """Rounded once to so many significant digits."""
    with mpmath.workdps(digits + 50):
        exact = mpmath.mpf(int(value.p)) / int(value.q) if value.is_Rational else mpmath.mpf(value)
        return str(mpmath.nstr(exact, digits, min_fixed=0, max_fixed=0, strip_zeros=False))


def _json(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False)


def _csv(data: dict[str, Any]) -> str:
    return "\n".join([",".join(data["columns"]), *(",".join(row) for row in data["rows"])])


def _head(data: dict[str, Any]) -> list[str]:
    return [
        f"{data['kernel']} in {data['dim']}D, support {data['support']} h,"
        f" sigma = {data['normalisation']}",
        "columns q, h^d W, h^(d+1) W', h^(d+2) W''; moments "
        + ", ".join(f"{n}: {m}" for n, m in data["moments"].items()),
        f"exact values, rounded once; sphtrunc {data['version']}",
    ]


def _c(data: dict[str, Any]) -> str:
    name = _identifier(data)
    lines = ["/* " + "\n   ".join(_head(data)) + " */", f"#ifndef {name.upper()}_H"]
    lines += [f"#define {name.upper()}_H", f"static const int {name}_points = {len(data['rows'])};"]
    lines.append(f"static const double {name}_sigma = {data['normalisation_digits']};")
    lines.append(f"static const double {name}[][4] = {{")
    lines += ["  {" + ", ".join(row) + "}," for row in data["rows"]]
    return "\n".join([*lines, "};", "#endif"])


def _fortran(data: dict[str, Any]) -> str:
    name, rows = _identifier(data), data["rows"]
    real = [[v.replace("e", "d") if "e" in v else f"{v}d0" for v in row] for row in rows]
    sigma = data["normalisation_digits"]
    sigma = sigma.replace("e", "d") if "e" in sigma else f"{sigma}d0"
    lines = [f"! {line}" for line in _head(data)]
    lines.append(f"integer, parameter :: {name}_points = {len(rows)}")
    lines.append(f"double precision, parameter :: {name}_sigma = {sigma}")
    # one array a column and at most 60 values a statement: compilers limit continuation lines
    for column, letters in enumerate(("q", "w", "dw", "d2w")):
        lines.append(f"double precision :: {name}_{letters}({len(rows)})")
        for start in range(0, len(real), 60):
            part = [row[column] for row in real[start : start + 60]]
            first, last = start + 1, start + len(part)
            lines.append(f"data {name}_{letters}({first}:{last}) / &")
            lines += [f"  {v}, &" for v in part[:-1]]
            lines.append(f"  {part[-1]} /")
    return "\n".join(lines)


def _identifier(data: dict[str, Any]) -> str:
    text = "".join(c if c.isalnum() and c.isascii() else "_" for c in data["kernel"])[:24]
    return f"golden_{text}_{data['dim']}d"
