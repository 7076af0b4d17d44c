"""Audit somebody's kernel: which one it is, whether it is right, and what the fault is if not."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from sympy import Expr, Poly, Rational

from sphtrunc.audit import faults, numeric
from sphtrunc.audit.constants import (
    Constant,
    constant,
    exact_or_float,
    number,
    simplest_between,
)
from sphtrunc.audit.explanations import (
    expected_constant,
    explain_constant,
    explain_truncation,
)
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.recognition import (
    ANALYTIC,
    Analytic,
    Match,
    conventions,
    cut_off,
    derived,
    exact_match,
    recognise_samples,
    shortened,
)
from sphtrunc.audit.reconstruction import fixed, values
from sphtrunc.audit.report import Audit
from sphtrunc.audit.samples import DOUBLE, SINGLE, Array, Samples, from_callable, load
from sphtrunc.audit.scaling import Scaling, explain_scaling, scalings
from sphtrunc.audit.shapes import divided, exact_cut, explain_shape
from sphtrunc.audit.slopes import WORDS, explain_derivative
from sphtrunc.audit.tables import from_table
from sphtrunc.kernels.arguments import dimension, rational
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel

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
    return _report(match, samples, dim, name, [], scaled)


def audit_list(path: str | Path) -> list[Audit]:
    """Audit every kernel of a TOML list: [[kernel]] tables, with the arguments above.

    Each has `subject` (or `project`, `file`, `version`) and `dim` with either `formula` and
    `constant` (a text, or one for each dimension), `python`, or `table`.

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
            reports += _entry(entry, file.parent)
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"list {file}, kernel {place}: {error}") from None
    return reports


def _entry(entry: Mapping[str, Any], folder: Path) -> list[Audit]:
    known = {
        "subject", "project", "file", "version", "dim", "formula", "constant", "derivative",
        "derivative_constant", "second_derivative", "second_constant", "support", "python",
        "signature", "table", "note",
    }  # fmt: skip
    unknown = sorted(set(entry) - known)
    if unknown:
        raise ValueError(f"unknown key {unknown[0]!r}, expected some of {', '.join(sorted(known))}")
    places = [str(entry[k]) for k in ("project", "version", "file") if k in entry]
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
        if not 0 < end:
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
    q = (np.arange(2000) + 0.5) / 2000 * end
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
    return Samples(
        q, w, slopes[0], DOUBLE, none, none, (end, end), DOUBLE, None, slopes[1], none
    )


# -- judging --------------------------------------------------------------------------------------


def judge(
    samples: Samples,
    dim: int,
    subject: str,
    given: Constant | None = None,
    scaled: tuple[Scaling, ...] = (),
) -> Audit:
    """What samples of a kernel say about it."""
    seen = scaled or scalings(samples, dim)
    samples = _at_unit_h(samples, seen)
    match = recognise_samples(samples, dim)
    if match is None or not (match.known or _normalised(match)):
        cut = cut_off(samples, dim)
        match = match if cut is None or _normalised(cut) else cut
    if match is None:
        return _numeric(samples, dim, subject, list(samples.notes), seen)
    notes = list(samples.notes)
    if match.spacing:
        notes.append(f"interpolated linearly between nodes {match.spacing:.3g} h apart")
    if given is not None:
        match = replace(match, integral_error=max(match.integral_error, float(given.error)))
    return _report(match, samples, dim, subject, notes, seen)


def _normalised(match: Match) -> bool:
    return bool(abs(number(match.integral) - 1) <= max(match.integral_error, 1e-40))


def _at_unit_h(samples: Samples, seen: Sequence[Scaling]) -> Samples:
    """The samples without the powers of h that they have too many, so that constants are judged."""
    if samples.h is None or samples.h == 1:
        return samples
    too_much = {scaling.order: samples.h**scaling.surplus for scaling in seen}
    one, two, three = (too_much.get(order, 1.0) for order in range(3))
    return replace(
        samples,
        w=samples.w / one,
        error=samples.error / one,
        dw=None if samples.dw is None else samples.dw / two,
        derivative_error=samples.derivative_error / two,
        d2w=None if samples.d2w is None else samples.d2w / three,
        second_error=samples.second_error / three,
    )


def _report(
    match: Match,
    samples: Samples | None,
    dim: int,
    subject: str,
    notes: Sequence[str],
    seen: Sequence[Scaling],
) -> Audit:
    found: list[Fault] = []
    said = list(notes)
    h = samples.h if samples is not None and not seen else None
    shape = explain_shape(match)
    wrong = explain_truncation(match, dim)
    if shape is not None:
        whole = float(number(match.integral))
        tail = "" if shape.kind == faults.CUT else f"; it integrates to {whole:.8g}"
        found.append(replace(shape, message=f"{shape.message}{tail}"))
        if match.whole is not None:
            fault = explain_constant(match.whole, dim, h)
            found += [fault] if fault is not None else []
    elif wrong:
        found += wrong
    else:
        fault = explain_constant(match, dim, h)
        if fault is not None and isinstance(match.shape, Kernel) and match.known:
            fault = _or_divided(fault, match)
        found += [fault] if fault is not None else []
    slopes = ["not given", "not given"]
    found += explain_scaling(0, seen)
    if samples is not None:
        if match.unit == SINGLE and samples.unit == DOUBLE and samples.function is not None:
            found.append(
                Fault(
                    faults.SINGLE_PRECISION,
                    "the values are accurate to single precision, their type is double",
                )
            )
        if samples.declared == SINGLE:
            said.append("values in single precision")
        for order, part in ((1, samples.dw), (2, samples.d2w)):
            if part is not None:
                surplus = sum(s.surplus for s in seen if s.order == order)
                fault = explain_derivative(match, samples, dim, order, surplus)
                power = explain_scaling(order, seen)
                if fault is not None and "factor r" in fault.message:
                    power = []  # W′/r has both from one division
                wrong_ones = [fault, *power] if fault is not None else power
                slopes[order - 1] = WORDS[order] if not wrong_ones else f"not {WORDS[order]}"
                found += wrong_ones
    if isinstance(match.shape, Kernel) and not match.known:
        said.append("not in the catalogue; recovered from its values" if samples else "a new one")
    return _described(match, samples, dim, subject, slopes, found, said, _powers(samples, seen))


def _or_divided(fault: Fault, match: Match) -> Fault:
    """The fault, or that whole-number division has made one catalogue kernel of another."""
    assert isinstance(match.shape, Kernel)
    own = match.shape.scaled(rational(exact_or_float(match.support))) if isinstance(
        exact_or_float(match.support), Rational) else match.shape  # fmt: skip
    other = divided(own)
    if other is None:
        return fault
    if fault.kind in (faults.WRONG_CONSTANT, faults.OTHER_CONSTANT):
        return replace(other, also=(f"{fault.kind}: {fault.message}", *fault.also))
    return replace(fault, also=(*fault.also, f"{other.kind}: {other.message}"))


def _powers(samples: Samples | None, seen: Sequence[Scaling]) -> str:
    """The powers of h in words."""
    if not seen:
        if samples is None or samples.h is None:
            return ""
        return f"not checked: all values are of h = {samples.h:g}"
    parts = [scaling.said() for scaling in seen]
    lengths = ", ".join(f"{h:g}" for h in seen[0].lengths[:6])
    return ", ".join(parts) + (f" (at h = {lengths})" if lengths else " (as written)")


def _described(
    match: Match,
    samples: Samples | None,
    dim: int,
    subject: str,
    slopes: Sequence[str],
    found: list[Fault],
    notes: list[str],
    powers: str,
) -> Audit:
    shape = match.shape
    q = np.linspace(0, 1, 1025)[:-1] * match.support
    continuity: dict[str, str] = {}
    pieces, moment = "", ""
    beta: int | None = None
    smooth: float | None = None
    w, dw = (match.derivative(q, order)[0] for order in (0, 1))
    inflection: tuple[str, ...]
    if isinstance(shape, Kernel):
        stretch = exact_or_float(match.support)
        unit = stretch / shape.support if isinstance(stretch, Expr) else 1 / match.scale
        beta, smooth = int(shape.boundary_smoothness), float(shape.smoothness)
        for knot, order in shape.knot_smoothness().items():
            text = "smooth" if order == float("inf") else "jumps" if order < 0 else f"C{order}"
            continuity[f"q = {_in_text(knot * unit)}"] = text
        own = shape.scaled(1)
        pieces = "; ".join(
            f"{a}..{b}: {p.as_expr()}"
            for a, b, p in zip(own.knots, own.knots[1:], own.pieces, strict=False)
        ).replace("**", "^")
        pieces = pieces.replace("q", "u") + "  (u = q/κ)" if len(pieces) < 400 else ""
        moment = f"{shape.moment(2, dim) * (stretch / shape.support) ** 2} h²"
        inflection = tuple(_in_text(place * unit) for place in inflections(shape))
    else:
        bend = match.derivative(q, 2)[0]
        inflection = tuple(f"{p:.5g}" for p in _crossings(q, bend))
    sign = 1.0 if match.amplitude > 0 else -1.0
    return Audit(
        subject=subject,
        dim=dim,
        signature=samples.signature if samples is not None else "",
        kernel=shape.name,
        shape=pieces,
        support=match.support,
        convention=_convention(match, dim),
        integral=_shown(match),
        constant=expected_constant(match, dim),
        boundary_smoothness=beta,
        smoothness=smooth,
        continuity=continuity,
        positive=bool(np.all(w >= 0)) if sign > 0 else False,
        monotonic=bool(np.all(np.diff(np.abs(w)) <= 0)),
        inflection=inflection,
        second_moment=moment,
        derivative=slopes[0],
        second_derivative=slopes[1],
        scaling=powers,
        faults=tuple(found),
        notes=tuple(notes),
    )


def _in_text(value: Any) -> str:
    """A fraction where it is a simple one, else a decimal."""
    exact = value if isinstance(value, Rational) else exact_or_float(float(value))
    simple = isinstance(exact, Rational) and exact.q <= 4096
    return str(exact) if simple else f"{float(value):.9g}"


def inflections(kernel: Kernel) -> list[Any]:
    """Where w″ changes sign inside the support, in the kernel's own q: exactly where rational."""
    q = np.linspace(0, 1, 1025)[1:-1] * float(kernel.support)
    bends = derived(kernel, 2)
    curvature = values(kernel.knots, bends, fixed(q))
    places = []
    keep = np.nonzero(np.abs(curvature) >= 1e-12 * np.max(np.abs(curvature)))[0]
    for a, b in pairwise(keep):
        if curvature[a] * curvature[b] < 0:
            places.append(_sign_change(kernel, bends, Fraction(q[a]), Fraction(q[b])))
    return places


def _sign_change(kernel: Kernel, bends: Sequence[Poly], low: Fraction, high: Fraction) -> Any:
    """The root, or the knot, at which a piecewise polynomial changes sign between two points."""

    def value(x: Fraction) -> Any:
        at = Rational(x.numerator, x.denominator)
        piece = next(i for i, k in enumerate(kernel.knots[1:]) if at <= k)
        return bends[piece].eval(at)

    first = value(low)
    while high - low > Fraction(1, 1 << 44):
        middle = (low + high) / 2
        low, high = (middle, high) if value(middle) * first > 0 else (low, middle)
    simple = simplest_between(low, high)
    if value(simple) == 0 or simple in [Fraction(int(k.p), int(k.q)) for k in kernel.knots]:
        return Rational(simple.numerator, simple.denominator)
    return float(low)


def _crossings(q: Array, values_: Array) -> tuple[float, ...]:
    """Where the sampled function changes sign, between neighbours by a straight line."""
    v = np.where(np.abs(values_) < 1e-12 * np.max(np.abs(values_)), 0, values_)
    return tuple(
        float(q[a] + (q[b] - q[a]) * abs(v[a]) / (abs(v[a]) + abs(v[b])))
        for a, b in pairwise(np.nonzero(v)[0])
        if v[a] * v[b] < 0
    )


def _shown(match: Match) -> str:
    value = float(number(match.integral))
    if isinstance(match.integral, Expr) and not match.integral_error:
        return str(match.integral)
    if abs(value - 1) <= match.integral_error:
        return f"1 (to {max(match.integral_error, 1e-16):.0e})"
    return f"{value:.12g}"


def _convention(match: Match, dim: int) -> str:
    """What h is, compared with the catalogue's: the same, the support, 2σ, σ, FWHM."""
    if match.whole is not None:
        return f"{_convention(match.whole, dim)}, cut off at {_in_text(match.support)}h"
    if isinstance(match.shape, Analytic):
        if match.shape.name == "gaussian":
            return f"the h of exp(-({match.scale:.9g} r/h)²), cut off at {match.support:.6g}h"
        return "the support radius" if match.support == 1 else f"{1 / match.support:.6g} supports"
    for what, support in conventions(match.shape, dim):
        # constants such as 1.825742 are written to seven digits
        if abs(match.support / support - 1) <= max(1e-6, 2 * match.support_error):
            if what == "h":
                return "the catalogue's h" if match.known else "the author's h"
            return what
    return f"the support radius divided by {match.support:.7g}"


def _numeric(
    samples: Samples, dim: int, subject: str, notes: Sequence[str], seen: Sequence[Scaling]
) -> Audit:
    """No exact form: the integral by quadrature, its error by halving the step."""
    whole, error = numeric.quadrature(samples, dim)
    wrong = numeric.wrong_integral(whole, error, samples, dim)
    found = [wrong] if wrong is not None else []
    found += explain_scaling(0, seen)
    slopes = ["not given", "not given"]
    for order, part in ((1, samples.dw), (2, samples.d2w)):
        if part is None:
            continue
        fault = numeric.wrong_derivative(samples, order)
        wrong_ones = ([fault] if fault is not None else []) + explain_scaling(order, seen)
        slopes[order - 1] = WORDS[order] if not wrong_ones else f"not {WORDS[order]}"
        if order == 2 and samples.dw is None:
            slopes[1] = "not checked: without an exact form or dW there is nothing to compare with"
        found += wrong_ones
    positive, monotonic = numeric.signs(samples)
    return Audit(
        subject=subject,
        dim=dim,
        signature=samples.signature,
        kernel="",
        shape="",
        support=float(samples.support[0]),
        convention="unknown",
        integral=f"{whole:.10g} ± {error:.1g}",
        constant="",
        boundary_smoothness=None,
        smoothness=None,
        continuity={},
        positive=positive,
        monotonic=monotonic,
        inflection=(),
        second_moment="",
        derivative=slopes[0],
        second_derivative=slopes[1],
        scaling=_powers(samples, seen),
        faults=tuple(found),
        notes=(*notes, "no exact form recognised: judged numerically"),
    )


def _named(function: Callable[..., Any]) -> str:
    return str(getattr(function, "__qualname__", type(function).__name__))
