"""Why a kernel does not integrate to one: the slips that give the factor found, likeliest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mpmath
from sympy import Expr

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.audit import faults
from sphtrunc.audit.analytic import Analytic
from sphtrunc.audit.constants import (
    DIGITS,
    exact_or_float,
    number,
    recognise,
    slip_of_pen,
)
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.forms import forms
from sphtrunc.audit.identification import exact
from sphtrunc.audit.recognition import Match
from sphtrunc.audit.samples import DOUBLE, SINGLE
from sphtrunc.audit.slips import (
    ROUGH_PI,
    Slip,
    borrowed,
    constant_slips,
    normalisations,
    pairs,
    written_scales,
)
from sphtrunc.kernels.kernel import Kernel

MOST_ALSO = 4  # other explanations that are shown
FEW_DIGITS = 0.02  # expected number of accidental agreements from which on they are spoken of


def explain_constant(match: Match, dim: int, h: float | None = None) -> Fault | None:
    """Why the kernel does not integrate to one; None if it does, within the error of the input.

    h: the smoothing length at which the values were taken, where its power could not be seen.
    """
    with mpmath.workdps(DIGITS):
        found = number(match.integral)
        error = max(match.integral_error, 1e-40)
        if abs(found - 1) <= error:
            return None
    exactly = match.integral if isinstance(match.integral, Expr) else recognise(found, error)
    short = exactly is not None and len(str(exactly)) < 40
    shown = f"{exactly}" if short else f"{float(found):.10g}"
    lead = f"it integrates to {shown} in {dim}D, not to 1"
    right = expected_constant(match, dim)
    tail = f"; the constant should be {right}" if right else ""
    fault = explain_factor(match, dim, float(found), float(error), shown, h)
    if fault.kind == faults.WRONG_CONSTANT:
        return Fault(fault.kind, f"{lead}{tail}", fault.surely, fault.also)
    return Fault(fault.kind, f"{lead}: {fault.message}{tail}", fault.surely, fault.also)


def explain_factor(
    match: Match,
    dim: int,
    found: float,
    error: float,
    shown: str,
    h: float | None = None,
    more: Sequence[Slip] = (),
) -> Fault:
    """The class of a factor by which W, or a derivative of it, is off; its words alone.

    more: slips to be tried beside those of a constant.
    """
    sign = -1.0 if found < 0 else 1.0
    size, room = abs(found), max(error, 1e-13)
    if abs(size - 1) <= room and sign < 0:
        return Fault(faults.SIGN, "the sign is wrong", "the size is right")
    slips = [*more, *constant_slips(match, dim, h)]
    fits = [slip for slip in slips if abs(size / slip.factor - 1) <= room]
    others, count = borrowed(match, dim, size, error)
    fits += others
    count += len(slips)
    if not fits:
        double = list(pairs(slips))
        count += len(double)
        fits = [slip for slip in double if abs(size / slip.factor - 1) <= room]
    if fits and abs(size - 1) > SINGLE:
        return _ranked(fits, count, size, error, shown, sign)
    kept = _lost_digits(match, dim, size, error)
    if kept is not None:
        return kept
    if fits:
        return _ranked(fits, count, size, error, shown, sign)
    digit = _wrong_digit(match, dim, size, error) if sign > 0 else ""
    none = f"none of {count} other explanations gives {shown}"
    if digit:
        return Fault(faults.MISPRINT, digit, f"a guess: {none}, and this one only looks alike")
    return Fault(faults.WRONG_CONSTANT, "its constant is wrong", none)


def _ranked(
    fits: list[Slip], count: int, size: float, error: float, shown: str, sign: float
) -> Fault:
    fits = sorted(fits, key=lambda slip: slip.bits)
    first = fits[0]
    minus = "the sign is wrong, and " if sign < 0 else ""
    also = dict.fromkeys(f"{s.kind}: {s.words}" for s in fits[1:] if s.words != first.words)
    alone = not also
    if alone:
        surely = f"of {count} explanations tried, no other gives {shown}"
    else:
        surely = (
            f"of {count} explanations tried, {len(also) + 1} give {shown}; this is the most usual"
        )
    chance = count * error / 2  # explanations are spread over factors of about e² around 1
    if chance > FEW_DIGITS:
        surely += f"; with so few digits about {chance:.1g} would do so by chance"
    return Fault(first.kind, minus + first.words, surely, tuple(also)[:MOST_ALSO])


def explain_truncation(match: Match, dim: int) -> list[Fault]:
    """A Gaussian with the constant of the infinite range, cut off where it still has weight.

    Where that constant is wrong by a known slip as well, both are said.
    """
    if not (isinstance(match.shape, Analytic) and match.shape.name == "gaussian"):
        return []
    with mpmath.workdps(DIGITS):
        reach = (mpmath.mpf(match.support) * mpmath.mpf(match.scale)) ** 2
        kept = mpmath.gammainc(mpmath.mpf(dim) / 2, 0, reach, regularized=True)
        integral = number(match.integral)
        whole, error = integral / kept, max(match.integral_error, 1e-40)
        if abs(integral - 1) <= error or 1 - kept <= error:
            return []
        cut = Fault(
            faults.TRUNCATION,
            f"the constant is that of the infinite range, the kernel is cut off at"
            f" {match.support:.6g}h: {float(1 - kept):.4g} of its integral is missing",
        )
        if abs(whole - 1) <= error:
            return [cut]
    plain = explain_constant(match, dim)
    endless = explain_constant(replace(match, integral=whole), dim)
    if plain is None or endless is None or plain.kind != faults.WRONG_CONSTANT:
        return []
    return [] if endless.kind == faults.WRONG_CONSTANT else [endless, cut]


def expected_constant(match: Match, dim: int) -> str:
    """The exact constant of the shape as the catalogue (or the author's formula) writes it."""
    if match.whole is not None:
        return expected_constant(match.whole, dim)
    if match.written is not None:
        return f"{match.written.normalisation(dim)}"
    shape = match.shape
    right = shape.normalisation(dim)
    if isinstance(shape, Analytic):
        return f"{right} (times {match.scale:.12g}^{dim})" if match.scale != 1 else f"{right}"
    support = exact_or_float(match.support)
    if isinstance(support, Expr):
        # on a support of 1h a shape of one piece is written with w(0) = 1
        top = shape.central() if support == 1 and len(shape.pieces) == 1 else 1
        return f"{right * (shape.support / support) ** dim * (top or 1)}"
    return f"{right * shape.support**dim}/{match.support:.9g}^{dim}"


def _lost_digits(match: Match, dim: int, size: float, error: float) -> Fault | None:
    """Single precision, π to a few digits, or a constant given to a few digits."""
    if SINGLE / 64 < abs(size - 1) <= 4 * SINGLE:
        return Fault(faults.SINGLE_PRECISION, "its constant is accurate to single precision only")
    own = exact(match.shape.normalisation(dim))
    halves = own.halves if own is not None else -2
    for text, rough in ROUGH_PI.items():
        predicted = (rough / float(mpmath.pi)) ** (halves / 2) if halves else 1.0
        if predicted != 1.0 and abs(size - predicted) <= max(abs(predicted - 1) / 100, error):
            return Fault(
                faults.ROUNDED,
                f"a relative {size - 1:.2g}: π was taken as {text}",
                f"the factor agrees to {max(abs(size / predicted - 1), 1e-16):.0e}",
            )
    digits = _rounded_digits(match, dim, size, error)
    if digits:
        return Fault(faults.ROUNDED, f"its constant is given to {digits} digits only")
    return None


def _rounded_digits(match: Match, dim: int, size: float, error: float) -> int:
    """The number of digits, if the right constant in some usual form was rounded to so many."""
    sigma = normalisations(match)[dim]
    scales = {1.0, match.support**dim}
    if isinstance(match.shape, Kernel):
        scales |= {scale for scale, _ in written_scales(match, match.shape, dim).values()}
    for digits in range(2, 9):
        for scale in scales:
            right = sigma * scale
            rounded = float(f"{right:.{digits - 1}e}")
            if abs(size * right / rounded - 1) <= max(error, 4 * DOUBLE):
                return digits
    return 0


def _wrong_digit(match: Match, dim: int, size: float, error: float) -> str:
    """The right and the wrong constant, where in some form they differ by a slip of the pen."""
    if not isinstance(match.shape, Kernel):
        return ""
    support = exact_or_float(match.support)
    if not isinstance(support, Expr):
        return ""
    sigma = exact(match.shape.normalisation(dim) * (match.shape.support / support) ** dim)
    wrong = recognise(size, max(error, 4 * DOUBLE))
    if sigma is None or wrong is None or not wrong.is_Rational:
        return ""
    factor = sigma.factor * fraction(wrong)
    lengths = [n for n, k in (("h", match.shape.support), ("support", 1)) if k == support]
    scales = [fraction(form.scale) for n in lengths for form in forms(match.shape, n)]
    for scale in dict.fromkeys(scales):
        right, given = sigma.factor * scale, factor * scale
        told = slip_of_pen(given, right)
        if told:
            return f"a digit is wrong: {told[0]} became {told[1]}"
    return ""
