"""Audit somebody's kernel: which one it is, whether it is right, and what the fault is if not."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sympy import Expr

import sphtrunc.audit.faults as slips
from sphtrunc.audit.constants import Constant, constant, number
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.recognition import (
    ANALYTIC,
    Analytic,
    Match,
    conventions,
    exact_match,
    recognise_samples,
)
from sphtrunc.audit.reconstruction import fixed, values
from sphtrunc.audit.samples import DOUBLE, SINGLE, Samples, from_callable, from_table, load
from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.kernel import SPHERE, Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.version import __version__

SCHEMA = "sphtrunc.audit/1"
PUBLISHED = Path(__file__).with_name("published.toml")


@dataclass(frozen=True)
class Audit:
    """What was found about a kernel in one dimension. All exact numbers are strings.

    kernel: its name in the catalogue, "reconstructed", or "" where no exact form was recognised
    integral: ∫ W d^d r; constant: the σ_d that the shape, as written here, should have
    convention: what the smoothing length is; continuity: derivatives continuous at each knot
    """

    subject: str
    dim: int
    kernel: str
    shape: str
    support: float
    convention: str
    integral: str
    constant: str
    boundary_smoothness: int | None
    smoothness: float | None
    continuity: dict[str, str]
    positive: bool
    monotonic: bool
    inflection: tuple[float, ...]
    second_moment: str
    derivative: str
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]

    @property
    def clean(self) -> bool:
        return not self.faults

    def to_dict(self) -> dict[str, Any]:
        return {"schema": SCHEMA, **asdict(self), "clean": self.clean, "version": __version__}

    def to_json(self) -> str:
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False)

    def to_text(self) -> str:
        rows = [
            ("kernel", self.kernel or "no exact form recognised"),
            ("shape", self.shape),
            ("support", f"{self.support:.9g} h"),
            ("h is", self.convention),
            ("integral", self.integral),
            ("constant", self.constant),
            ("dW/dr", self.derivative),
            ("β", "" if self.boundary_smoothness is None else str(self.boundary_smoothness)),
            ("continuity", ", ".join(f"{k}: {v}" for k, v in self.continuity.items())),
            ("signs", _signs(self)),
            ("∫r²W", self.second_moment),
        ]
        verdict = "clean" if self.clean else f"{len(self.faults)} fault(s)"
        lines = [f"{self.subject}, {self.dim}D: {verdict}"]
        lines += [f"  {name:<11}{said}" for name, said in rows if said]
        for fault in self.faults:
            lines.append(f"  FAULT      {fault.kind}: {fault.message}")
            lines += [f"             or {other}" for other in fault.also]
        lines += [f"  note       {note}" for note in self.notes]
        return "\n".join(lines)

    def to_markdown(self) -> str:
        """One row of the table whose head is `MARKDOWN_HEAD`."""
        said = "; ".join(f"**{f.kind}**: {f.message}" for f in self.faults) or "clean"
        cells = [
            self.subject,
            str(self.dim),
            self.kernel or "–",
            f"{self.support:.7g} h",
            self.integral,
            said,
        ]
        return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


MARKDOWN_HEAD = (
    "| subject | dim | kernel | support | integral | finding |\n|---|---|---|---|---|---|"
)


def _signs(report: Audit) -> str:
    parts = [
        "positive" if report.positive else "changes sign",
        "falls monotonically" if report.monotonic else "does not fall monotonically",
    ]
    if report.inflection:
        parts.append("inflection at q = " + ", ".join(f"{x:.5g}" for x in report.inflection))
    return ", ".join(parts)


# -- the three ways in ----------------------------------------------------------------------------


def audit(
    function: Callable[..., Any] | str,
    dim: int,
    signature: str = "w(q)",
    derivative: Callable[..., Any] | str | None = None,
    support: float | None = None,
    subject: str | None = None,
) -> Audit:
    """Audit a callable, or the one that 'package.module:name' names.

    signature: "w(q)", "w(q,dim)", "W(r,h)" or "W(r,h,dim)"; derivative: the same for dw/dq, or
    dW/dr. w(q) returns h^d W. Numbers or float arrays in, the same shape out.

    >>> audit(lambda q: max(0.0, 1 - q), dim=1).clean
    True

    Raises ValueError where the callable cannot be used; a kernel that is wrong is reported.
    """
    dim = dimension(dim)
    name = subject or (function if isinstance(function, str) else _named(function))
    kernel = load(function) if isinstance(function, str) else function
    slope = load(derivative) if isinstance(derivative, str) else derivative
    samples = from_callable(kernel, dim, signature, slope, support=support)
    return judge(samples, dim, name)


def audit_table(path: str | Path, dim: int, subject: str | None = None) -> Audit:
    """Audit a table of values (see `samples.from_table`)."""
    return judge(from_table(path, dimension(dim)), dim, subject or Path(path).name)


def audit_formula(
    formula: str | Kernel,
    value: str | Constant,
    dim: int,
    derivative: str | None = None,
    support: str | None = None,
    subject: str | None = None,
) -> Audit:
    """Audit a formula with the constant that a code uses: W = constant · h^{-d} · formula(r/h).

    formula: a kernel as everywhere (name, pieces, truncated powers), or gaussian, cosine,
    double-cosine, then cut off at `support`; derivative: of the formula, as pieces, multiplied by
    the same constant.
    """
    dim = dimension(dim)
    given = constant(value) if isinstance(value, str) else value
    if not given.value.is_real or number(given.value) == 0:
        raise ValueError(f"constant: got {given.text!r}, expected a real number that is not zero")
    name = subject or f"{given.text} × {formula if isinstance(formula, str) else formula.name}"
    if isinstance(formula, str) and formula.strip().lower() in ANALYTIC:
        return judge(_sampled_analytic(formula, given, support), dim, name, given)
    kernel = parse_kernel(formula)
    if support is not None:
        kernel = kernel.scaled(support)
    match = exact_match(kernel, given.value, float(given.error), dim)
    samples = None
    if derivative is not None:
        samples = _sampled_formula(kernel, parse_kernel(derivative), given)
    return _report(match, samples, dim, name, [])


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
        "support", "python", "signature", "table", "note",
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
                entry["formula"], str(c), d, entry.get("derivative"), entry.get("support"), subject
            )
            for c, d in zip(texts, dims, strict=True)
        ]
    if "python" in entry:
        return [
            audit(
                entry["python"], d, entry.get("signature", "w(q)"), entry.get("derivative"),
                entry.get("support"), subject,
            )
            for d in dims
        ]  # fmt: skip
    if "table" in entry:
        return [audit_table(folder / entry["table"], d, subject) for d in dims]
    raise ValueError("expected formula and constant, python, or table")


# -- judging --------------------------------------------------------------------------------------


def judge(samples: Samples, dim: int, subject: str, given: Constant | None = None) -> Audit:
    """What samples of a kernel say about it."""
    notes: list[str] = []
    match = recognise_samples(samples, dim)
    if match is None:
        return _numeric(samples, dim, subject, notes)
    if match.spacing:
        notes.append(f"interpolated linearly between nodes {match.spacing:.3g} h apart")
    if given is not None:
        match = replace(match, integral_error=max(match.integral_error, float(given.error)))
    return _report(match, samples, dim, subject, notes)


def _report(
    match: Match, samples: Samples | None, dim: int, subject: str, notes: Sequence[str]
) -> Audit:
    found: list[Fault] = []
    said = list(notes)
    shape = slips.explain_shape(match, dim)
    wrong = slips.explain_truncation(match, dim)
    if shape is not None:
        whole = float(slips.number_of(match.integral))
        found.append(replace(shape, message=f"{shape.message}; it integrates to {whole:.8g}"))
    elif wrong is not None:
        found.append(wrong)
    else:
        wrong = slips.explain_constant(match, dim)
        if wrong is not None:
            found.append(wrong)
    slope = "not given"
    if samples is not None:
        if samples.power_of_h is not None:
            found.append(slips.power_of_h(samples.power_of_h, dim))
        if match.unit == SINGLE and samples.unit == DOUBLE and samples.function is not None:
            found.append(
                Fault(
                    slips.SINGLE_PRECISION,
                    "the values are accurate to single precision, their type is double",
                )
            )
        if samples.declared == SINGLE:
            said.append("values in single precision")
        if samples.dw is not None:
            fault = slips.explain_derivative(match, samples, dim)
            slope = "the derivative of W" if fault is None else "not the derivative of W"
            found += [fault] if fault is not None else []
    if isinstance(match.shape, Kernel) and not match.known:
        said.append("not in the catalogue; recovered from its values" if samples else "a new one")
    return _described(match, dim, subject, slope, found, said)


def _described(
    match: Match, dim: int, subject: str, slope: str, found: list[Fault], notes: list[str]
) -> Audit:
    shape = match.shape
    q = np.linspace(0, 1, 1025)[:-1] * match.support
    continuity: dict[str, str] = {}
    pieces, moment = "", ""
    beta: int | None = None
    smooth: float | None = None
    if isinstance(shape, Kernel):
        points = fixed(q * match.scale)
        w = values(shape.knots, shape.pieces, points)
        second = [p.diff() for p in shape.derivative()]
        dw = values(shape.knots, shape.derivative(), points)
        d2w = values(shape.knots, second, points)
        beta, smooth = int(shape.boundary_smoothness), float(shape.smoothness)
        for knot, order in shape.knot_smoothness().items():
            text = "smooth" if order == float("inf") else "jumps" if order < 0 else f"C{order}"
            continuity[f"q = {float(knot) / match.scale:.6g}"] = text
        own = shape.scaled(1)
        pieces = "; ".join(
            f"{a}..{b}: {p.as_expr()}"
            for a, b, p in zip(own.knots, own.knots[1:], own.pieces, strict=False)
        ).replace("**", "^")
        pieces = pieces.replace("q", "u") + "  (u = q/κ)" if len(pieces) < 400 else ""
        exact = slips.exact_or_float(match.support)
        moment = f"{shape.moment(2, dim) * (exact / shape.support) ** 2} h²"
    else:
        w, dw = shape.shape(q * match.scale), shape.slope(q * match.scale)
        d2w = np.gradient(dw, q)
    return Audit(
        subject=subject,
        dim=dim,
        kernel=shape.name,
        shape=pieces,
        support=match.support,
        convention=_convention(match, dim),
        integral=_shown(match),
        constant=slips.expected_constant(match, dim),
        boundary_smoothness=beta,
        smoothness=smooth,
        continuity=continuity,
        positive=bool(np.all(w >= 0)) if match.amplitude > 0 else False,
        monotonic=bool(np.all(np.diff(np.abs(w)) <= 0)),
        inflection=_crossings(q, d2w),
        second_moment=moment,
        derivative=slope,
        faults=tuple(found),
        notes=tuple(notes),
    )


def _shown(match: Match) -> str:
    value = float(slips.number_of(match.integral))
    if isinstance(match.integral, Expr) and not match.integral_error:
        return str(match.integral)
    if abs(value - 1) <= match.integral_error:
        return f"1 (to {max(match.integral_error, 1e-16):.0e})"
    return f"{value:.12g}"


def _crossings(
    q: NDArray[np.floating[Any]], values_: NDArray[np.floating[Any]]
) -> tuple[float, ...]:
    """Where the sampled function changes sign, between neighbours by a straight line."""
    v = np.where(np.abs(values_) < 1e-12 * np.max(np.abs(values_)), 0, values_)
    keep = np.nonzero(v)[0]
    places = [
        float(q[a] + (q[b] - q[a]) * abs(v[a]) / (abs(v[a]) + abs(v[b])))
        for a, b in pairwise(keep)
        if v[a] * v[b] < 0
    ]
    return tuple(round(p, 5) for p in places)


def _convention(match: Match, dim: int) -> str:
    """What h is, compared with the catalogue's: the same, the support, 2σ, σ, FWHM."""
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


def _numeric(samples: Samples, dim: int, subject: str, notes: Sequence[str]) -> Audit:
    """No exact form: the integral by quadrature, its error by halving the step."""
    q, w = samples.q, samples.w
    inside = q <= samples.support[0]
    whole, error = _quadrature(samples, dim)
    top = float(np.max(np.abs(w)))
    found = []
    if abs(whole - 1) > max(error, 1e-9, 64 * samples.unit):
        found.append(
            Fault(
                slips.WRONG_CONSTANT,
                f"it integrates to {whole:.8g} ± {error:.1g} in {dim}D, not to 1",
            )
        )
    if samples.power_of_h is not None:
        found.append(slips.power_of_h(samples.power_of_h, dim))
    slope = "not given"
    if samples.dw is not None:
        fault = _numeric_derivative(samples)
        slope = "the derivative of W" if fault is None else "not the derivative of W"
        found += [fault] if fault else []
    return Audit(
        subject=subject,
        dim=dim,
        kernel="",
        shape="",
        support=float(samples.support[0]),
        convention="unknown",
        integral=f"{whole:.10g} ± {error:.1g}",
        constant="",
        boundary_smoothness=None,
        smoothness=None,
        continuity={},
        positive=bool(np.all(w >= -8 * DOUBLE * top)),
        monotonic=bool(np.all(np.diff(w[inside]) <= 8 * samples.unit * top)),
        inflection=(),
        second_moment="",
        derivative=slope,
        faults=tuple(found),
        notes=(*notes, "no exact form recognised: judged numerically"),
    )


def _quadrature(samples: Samples, dim: int) -> tuple[float, float]:
    surface = float(number(SPHERE[dim]))
    if samples.function is None:
        f = surface * samples.w * samples.q ** (dim - 1)
        fine = float(np.trapezoid(f, samples.q)) + f[0] * samples.q[0] / dim
        half = float(np.trapezoid(f[::2], samples.q[::2])) + f[0] * samples.q[0] / dim
        spread = surface * float(np.trapezoid(samples.error * samples.q ** (dim - 1), samples.q))
        return fine, abs(fine - half) + spread
    nodes, weights = np.polynomial.legendre.leggauss(6)
    sums = []
    for cells in (60, 120):
        edges = np.linspace(0, samples.support[1], cells + 1)
        half_width = np.diff(edges)[:, None] / 2
        x = (edges[:-1, None] + edges[1:, None]) / 2 + half_width * nodes
        w = samples.function(x.reshape(-1), 1.0).reshape(x.shape)
        sums.append(surface * float(np.sum(w * x ** (dim - 1) * weights * half_width)))
    return sums[1], 2 * abs(sums[1] - sums[0]) + 1e-13


def _numeric_derivative(samples: Samples) -> Fault | None:
    """∫ dW between samples against the differences of W, by the trapezoid rule and its error."""
    if samples.dw is None:
        return None
    keep = (samples.q > 0) & (samples.q < samples.support[0])
    q, w, dw = samples.q[keep], samples.w[keep], samples.dw[keep]
    steps = np.diff(q)
    trapezoid = steps * (dw[1:] + dw[:-1]) / 2
    bend = np.abs(np.gradient(np.gradient(dw, q), q))
    room = steps**3 * np.maximum(bend[1:], bend[:-1]) / 6 + steps * np.max(np.abs(dw)) * 1e-5
    off = np.abs(np.diff(w) - trapezoid) > room + 64 * samples.unit * np.max(np.abs(w))
    if np.count_nonzero(off) <= len(off) // 20:
        return None
    at = int(np.argmax(off))
    return Fault(slips.WRONG_DERIVATIVE, f"dW is not the derivative of W near q = {q[at]:.4g}")


def _sampled_analytic(formula: str, given: Constant, support: str | None) -> Samples:
    shape = ANALYTIC[formula.strip().lower()]
    end = float(number(constant(support).value)) if support else min(shape.end, 12.0)
    size = float(number(given.value))
    scale = 1.0 if shape.name == "gaussian" else 1 / end
    q = np.linspace(0, end, 2001)[:-1]
    w = size * shape.shape(q * scale)
    none = np.zeros_like(w)
    return Samples(q, w, None, DOUBLE, none, none, (end, end), DOUBLE, None, None)


def _sampled_formula(kernel: Kernel, derivative: Kernel, given: Constant) -> Samples:
    size, end = float(number(given.value)), float(kernel.support)
    q = (np.arange(2000) + 0.5) / 2000 * end
    points = fixed(q)
    w = size * values(kernel.knots, kernel.pieces, points)
    dw = size * values(derivative.knots, derivative.pieces, points)
    none = np.zeros_like(w)
    return Samples(q, w, dw, DOUBLE, none, none, (end, end), DOUBLE, None, None)


def _named(function: Callable[..., Any]) -> str:
    return str(getattr(function, "__qualname__", type(function).__name__))
