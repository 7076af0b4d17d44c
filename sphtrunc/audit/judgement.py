"""The judgement: what samples, or a formula, of a kernel say about it, fault by fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sympy import Rational

from sphtrunc.audit import faults, numeric
from sphtrunc.audit.constants import Constant, exact_or_float, number
from sphtrunc.audit.description import described
from sphtrunc.audit.explanations import explain_constant, explain_truncation
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.recognition import Match, cut_off, recognise_samples
from sphtrunc.audit.report import Audit
from sphtrunc.audit.samples import DOUBLE, SINGLE, Samples
from sphtrunc.audit.scaling import Scaling, explain_scaling, scalings
from sphtrunc.audit.shapes import divided, explain_shape
from sphtrunc.audit.slopes import WORDS, explain_derivative
from sphtrunc.kernels.kernel import Kernel


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
    return report_of(match, samples, dim, subject, notes, seen)


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


def report_of(
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
    return described(match, samples, dim, subject, slopes, found, said, _powers(samples, seen))


def _or_divided(fault: Fault, match: Match) -> Fault:
    """The fault, or that whole-number division has made one catalogue kernel of another."""
    assert isinstance(match.shape, Kernel)
    support = exact_or_float(match.support)
    other = divided(match.shape.scaled(support) if isinstance(support, Rational) else match.shape)
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
