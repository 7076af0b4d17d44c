"""Audit somebody's kernel: which one it is, whether it is right, and what the fault is if not."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sympy import Rational

from sphtrunc.audit.analytic import ANALYTIC
from sphtrunc.audit.codes import across
from sphtrunc.audit.constants import Constant, constant, number
from sphtrunc.audit.judgement import judge, report_of
from sphtrunc.audit.recognition import Match, exact_match, shortened
from sphtrunc.audit.reconstruction import fixed, values
from sphtrunc.audit.report import Audit
from sphtrunc.audit.samples import DOUBLE, Array, Samples, from_callable, load
from sphtrunc.audit.scaling import Scaling
from sphtrunc.audit.shapes import exact_cut
from sphtrunc.audit.tables import from_table
from sphtrunc.kernels.arguments import dimension, rational
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel

POINTS = 600  # at which the derivatives of a formula are compared
PUBLISHED = Path(__file__).with_name("published.toml")


# -- the ways in ----------------------------------------------------------------------------------


def audit(
    function: Callable[..., Any] | str,
    dim: int,
    signature: str | None = None,
    derivative: Callable[..., Any] | str | None = None,
    support: float | None = None,
    subject: str | None = None,
    second_derivative: Callable[..., Any] | str | None = None,
) -> Audit:
    """Audit a callable, or the one that 'package.module:name' names.

    signature: "w(q)", "w(q,dim)", "W(r,h)", "W(r,h,dim)", "kernel(xij,rij,h)"; None: by the names
        of the arguments of each callable. w(q) returns h^d W. Numbers or float arrays in, the same
        shape out.
    derivative, second_derivative: dW/dr and d²W/dr² (of w(q): dw/dq and d²w/dq²)
    support: where its caller cuts it off, in units of h

    >>> audit(lambda q: max(0.0, 1 - q), dim=1).clean
    True

    Raises ValueError where the callable cannot be used; a kernel that is wrong is reported.
    """
    dim = dimension(dim)
    name = subject or (function if isinstance(function, str) else _named(function))
    kernel, slope, bend = (
        load(one, dim) if isinstance(one, str) else one
        for one in (function, derivative, second_derivative)
    )
    if kernel is None:
        raise ValueError("function: got None, expected a callable or 'package.module:name'")
    return judge(from_callable(kernel, dim, signature, slope, bend, support=support), dim, name)


def audit_table(path: str | Path, dim: int, subject: str | None = None) -> Audit:
    """Audit a table of values (see `tables.from_table`)."""
    return judge(from_table(path, dimension(dim)), dim, subject or Path(path).name)


def audit_formula(
    formula: str | Kernel,
    value: str | Constant,
    dim: int,
    derivative: str | None = None,
    support: str | None = None,
    subject: str | None = None,
    derivative_constant: str | None = None,
    second_derivative: str | None = None,
    second_constant: str | None = None,
) -> Audit:
    """Audit a formula with the constant that a code uses: W = constant · h^{-d} · formula(r/h).

    formula: a kernel as everywhere (name, pieces, truncated powers), or gaussian, cosine,
        double-cosine; cut off at `support`
    value: the constant; where it contains h, as in "1/(pi*h^3)", the power is checked
    derivative, second_derivative: of the formula with respect to q, as pieces, multiplied by their
        own constant, such as "1/(pi*h^4)", or by the same, and then by the 1/h that it takes

    Raises ValueError for what cannot be read, and for a derivative of what is no polynomial.
    """
    dim = dimension(dim)
    given = _constant(value, "constant")
    name = subject or f"{given.text} × {formula if isinstance(formula, str) else formula.name}"
    for what, pieces, its in (
        ("derivative", derivative, derivative_constant),
        ("second derivative", second_derivative, second_constant),
    ):
        if its is not None and pieces is None:
            raise ValueError(f"{what}: its constant is given, but not its pieces")
    own: list[Constant] = []
    for of, its in ((derivative, derivative_constant), (second_derivative, second_constant)):
        own.append(given if its is None or of is None else _constant(its, "derivative constant"))
    seen = _powers_of_constants(given, derivative_constant and own[0], second_constant and own[1])
    scaled = tuple(_written_scaling(order, power, dim) for order, power in seen.items())
    text = formula.strip().lower() if isinstance(formula, str) else ""
    kernel: Any = None if text in ANALYTIC else parse_kernel(formula)
    if kernel is None or not kernel.is_polynomial:
        if derivative is not None or second_derivative is not None:
            raise ValueError(
                "derivative: of a formula that is no polynomial none can be given; audit the"
                " callable, or a table of it"
            )
        cut = support
        if kernel is not None:
            if kernel.power:
                raise ValueError(f"formula: {kernel.name} is not known here; audit a table of it")
            text, cut = "gaussian", support or (str(kernel.cut) if kernel.cut else None)
        return judge(_sampled_analytic(text, given, cut), dim, name, given, scaled)
    match = exact_match(kernel, given.value, float(given.error), dim)
    end = None if support is None else rational(support, "support")
    match = _cut_formula(match, kernel, given, dim, end)
    samples = None
    if derivative is not None or second_derivative is not None:
        samples = _sampled_formula(match.support, given, (derivative, own[0]),
                                   (second_derivative, own[1]), kernel)  # fmt: skip
    return report_of(match, samples, dim, name, [], scaled)


def audit_list(path: str | Path) -> list[Audit]:
    """Audit every kernel of a TOML list: [[kernel]] tables, with the arguments above.

    Each has `subject` (or `project`, `file`, `version`) and `dim` with either `formula` and
    `constant` (a text, or one for each dimension), `python`, or `table`. Entries of one `project`
    and `version` that say their `operator`, such as density or force, have to share a kernel.

    Raises ValueError, naming the entry, for anything it cannot read.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream:
            entries = tomllib.load(stream).get("kernel", [])
    except OSError as error:
        raise ValueError(f"list {file}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"list {file}: malformed: {error}") from None
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"list {file}: no [[kernel]] in it")
    reports = []
    for place, entry in enumerate(entries, start=1):
        try:
            code = " ".join(str(entry[k]) for k in ("project", "version") if k in entry)
            operator = str(entry.get("operator", ""))
            if operator and not code:
                raise ValueError("operator: of which code is not told; expected project")
            reports += [(report, code, operator) for report in _entry(entry, file.parent)]
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"list {file}, kernel {place}: {error}") from None
    return across(reports)


def _entry(entry: Mapping[str, Any], folder: Path) -> list[Audit]:
    known = {
        "subject", "project", "file", "version", "dim", "formula", "constant", "derivative",
        "derivative_constant", "second_derivative", "second_constant", "support", "python",
        "signature", "table", "note", "operator",
    }  # fmt: skip
    unknown = sorted(set(entry) - known)
    if unknown:
        raise ValueError(f"unknown key {unknown[0]!r}, expected some of {', '.join(sorted(known))}")
    places = [str(entry[k]) for k in ("project", "version", "file", "operator") if k in entry]
    subject = str(entry.get("subject", " ".join(places))) or None
    dims = entry["dim"] if isinstance(entry["dim"], list) else [entry["dim"]]
    if "formula" in entry:
        texts = entry["constant"] if isinstance(entry["constant"], list) else [entry["constant"]]
        if len(texts) != len(dims):
            raise ValueError(f"{len(texts)} constants for {len(dims)} dimensions")
        return [
            audit_formula(
                entry["formula"], str(c), d, entry.get("derivative"), entry.get("support"),
                subject, entry.get("derivative_constant"), entry.get("second_derivative"),
                entry.get("second_constant"),
            )
            for c, d in zip(texts, dims, strict=True)
        ]  # fmt: skip
    if "python" in entry:
        return [
            audit(
                entry["python"], d, entry.get("signature"), entry.get("derivative"),
                entry.get("support"), subject, entry.get("second_derivative"),
            )
            for d in dims
        ]  # fmt: skip
    if "table" in entry:
        return [audit_table(folder / entry["table"], d, subject) for d in dims]
    raise ValueError("expected formula and constant, python, or table")


# -- formulas -------------------------------------------------------------------------------------


def _constant(value: str | Constant, name: str) -> Constant:
    given = constant(value) if isinstance(value, str) else value
    if not given.value.is_real or number(given.value) == 0:
        raise ValueError(f"{name}: got {given.text!r}, expected a real number that is not zero")
    return given


def _powers_of_constants(*given: Constant | str | None) -> dict[int, Rational]:
    """order -> power of h, of the constants that contain it."""
    return {
        order: one.power_of_h
        for order, one in enumerate(given)
        if isinstance(one, Constant) and one.power_of_h is not None
    }


def _written_scaling(order: int, power: Rational, dim: int) -> Scaling:
    return Scaling(order, float(power), -(dim + order), ())


def _cut_formula(
    match: Match, kernel: Kernel, given: Constant, dim: int, end: Rational | None
) -> Match:
    """The match with its whole kernel, where the formula or `support` cuts one off."""
    if end is not None:
        if not end > 0:
            raise ValueError(f"support: got {end}, expected a positive number")
        return match if end >= kernel.support else shortened(match, float(end), dim)
    if match.known or kernel.boundary_smoothness >= 0:
        return match
    found = exact_cut(kernel, dim)
    if found is None:
        return match
    whole, support = found
    own = whole.scaled(support)
    scale = kernel.pieces[0].LC() / own.pieces[0].LC()
    written = Kernel(own.knots, [piece * scale for piece in own.pieces])
    one = exact_match(written, given.value, float(given.error), dim)
    return shortened(one, float(kernel.support), dim)


def _sampled_analytic(name: str, given: Constant, support: str | None) -> Samples:
    shape = ANALYTIC[name]
    end = float(number(constant(support).value)) if support else min(shape.end, 12.0)
    size = float(number(given.value))
    scale = 1.0 if shape.name == "gaussian" else 1 / end
    q = np.linspace(0, end, 2001)[:-1]
    w = size * shape.shape(q * scale)
    none = np.zeros_like(w)
    return Samples(q, w, None, DOUBLE, none, none, (end, end), DOUBLE, None)


def _sampled_formula(
    end: float,
    given: Constant,
    first: tuple[str | None, Constant],
    second: tuple[str | None, Constant],
    kernel: Kernel,
) -> Samples:
    q = (np.arange(POINTS) + 0.5) / POINTS * end
    points = fixed(q)
    none = np.zeros_like(q)
    slopes: list[Array | None] = []
    for text, its in (first, second):
        if text is None:
            slopes.append(None)
            continue
        shape = parse_kernel(text)
        slopes.append(float(number(its.value)) * values(shape.knots, shape.pieces, points))
    w = float(number(given.value)) * values(kernel.knots, kernel.pieces, points)
    return Samples(q, w, slopes[0], DOUBLE, none, none, (end, end), DOUBLE, None, slopes[1], none)


def _named(function: Callable[..., Any]) -> str:
    return str(getattr(function, "__qualname__", type(function).__name__))
