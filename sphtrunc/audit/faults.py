"""What may be wrong with a kernel: factors that known slips leave behind, and slips in w and w′.

Every slip predicts an exact factor; a fault is named where the factor found agrees with one within
its error. Several slips may leave the same factor: all are reported, the likeliest first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray
from sympy import QQ, Expr, Integer, Poly, Rational, pi

from sphtrunc.audit.constants import DIGITS, number, recognise
from sphtrunc.audit.recognition import ANALYTIC, Analytic, Match, conventions, profiles
from sphtrunc.audit.reconstruction import reconstruct
from sphtrunc.audit.samples import DOUBLE, SINGLE, Samples
from sphtrunc.kernels.kernel import SPHERE, Kernel
from sphtrunc.kernels.piecewise import q

Array = NDArray[np.floating[Any]]

HALF_RANGE = "half-range integral"
POWER_OF_SUPPORT = "wrong power of the support"
POWER_OF_H = "wrong power of h"
OTHER_DIMENSION = "constant of another dimension"
TRUNCATION = "truncated range"
MISPRINT = "misprint"
OTHER_DERIVATIVE = "derivative of another kernel"
MISSING_Q = "missing factor q"
CONVENTION = "convention mismatch"
SINGLE_PRECISION = "single precision"
ROUNDED = "rounded constant"
OTHER_CONSTANT = "constant of another kernel"
OTHER_FORM = "constant of another form"
FACTOR_PI = "factor of pi"
SIGN = "wrong sign"
WRONG_CONSTANT = "wrong constant"
WRONG_DERIVATIVE = "wrong derivative"
DISCONTINUOUS = "discontinuous"

#: constants that were printed wrongly and copied since: (kernel, dimension, constant of its shape)
MISPRINTS: tuple[tuple[str, int, Expr], ...] = (
    ("quintic-spline", 1, Integer(120)),
    ("quintic-spline", 2, 1 / (478 * pi)),
    ("quintic-spline", 3, 3 / (359 * pi)),
)

ROUGH_PI = ("3.14", "3.142", "3.1416", "3.14159", "3.141593", "22/7")


@dataclass(frozen=True)
class Fault:
    """A class of fault, what it is here, and other classes that would look the same."""

    kind: str
    message: str
    also: tuple[str, ...] = ()


def constant_slips(match: Match, dim: int) -> Iterator[tuple[str, str, Any]]:
    """(class, words, the factor by which the kernel would integrate to something else than one)."""
    shape = match.shape
    support = exact_or_float(match.support)
    if dim == 1:
        yield HALF_RANGE, "the constant comes from ∫₀ instead of ∫₋∞: twice the right one", 2
    if isinstance(shape, Kernel):
        yield from _misprinted(shape, dim)
    for power in (1, -1, 2, -2):
        yield (
            FACTOR_PI,
            f"a factor π^{power} too many" if power != 1 else "a factor π too many",
            (pi**power),
        )
    if dim != 1:
        yield HALF_RANGE, "the constant comes from half the range: twice the right one", 2
    yield HALF_RANGE, "half the right constant: the range was counted twice", Rational(1, 2)
    sigma = _normalisations(match)
    for other in (1, 2, 3):
        if other != dim:
            yield (
                OTHER_DIMENSION,
                f"the constant of {other}D in {dim}D",
                sigma[other] / sigma[dim],
            )
    if isinstance(shape, Kernel):
        yield from _kernel_slips(match, shape, dim, support, sigma)


def exact_or_float(value: float) -> Any:
    simple = Fraction(value).limit_denominator(64)
    if float(simple) == value:
        return Rational(simple.numerator, simple.denominator)
    return mpmath.mpf(value)


def _normalisations(match: Match) -> dict[int, Any]:
    """σ_d of the shape as written in the author's h, for every dimension."""
    shape = match.shape
    if isinstance(shape, Analytic):
        return {d: shape.normalisation(d) * exact_or_float(match.scale) ** d for d in (1, 2, 3)}
    return {
        d: shape.normalisation(d) * (shape.support / exact_or_float(match.support)) ** d
        for d in (1, 2, 3)
    }


def _misprinted(kernel: Kernel, dim: int) -> Iterator[tuple[str, str, Any]]:
    for name, where, constant in MISPRINTS:
        if name == kernel.name and where == dim:
            right = kernel.normalisation(dim)
            yield (
                MISPRINT,
                f"a widely copied misprint: {constant} for {right}",
                constant / right,
            )


def _kernel_slips(
    match: Match, kernel: Kernel, dim: int, support: Any, sigma: dict[int, Any]
) -> Iterator[tuple[str, str, Any]]:
    for power in (dim, -dim):
        for what, other in conventions(kernel, dim):
            ratio = support / exact_or_float(other)
            if power == dim and abs(float(number_of(ratio)) - 1) > 1e-9:
                yield (
                    CONVENTION,
                    f"the constant is the one for h = {what} (support {other:.7g}h),"
                    f" but the support here is {match.support:.7g}h",
                    ratio**dim,
                )
    supports = {support, kernel.support}
    for kappa in supports:
        for power in (1, -1, 2, -2, 3, -3):
            if kappa != 1:
                yield (
                    POWER_OF_SUPPORT,
                    f"a factor {kappa}^{power} too many, the support to the power {power}",
                    kappa**power,
                )
    radial = {n: kernel._radial(kernel.pieces, n) for n in (0, 1, 2)}
    for surface in (1, 2, 3):
        for power in (0, 1, 2):
            if (surface, power) != (dim, dim - 1) and radial[power] and radial[dim - 1]:
                stretch = (kernel.support / support) ** (power + 1 - dim)
                factor = SPHERE[dim] * radial[dim - 1] / (SPHERE[surface] * radial[power])
                missing = dim - 1 - power
                element = "1" if power == 0 else "q" if power == 1 else "q²"
                words = (
                    f"the constant is 1/({SPHERE[surface]} ∫ w {element} dq): the volume element"
                    f" q^{dim - 1} of {dim}D is not in it"
                )
                yield (MISSING_Q if missing > 0 else OTHER_DIMENSION), words, factor * stretch
    top = kernel.pieces[0].eval(0)
    forms = {
        "scaled to w(0) = 1": 1 / top if top else None,
        "scaled to unit integral in 1D": 1 / kernel.normalisation(1) if dim > 1 else None,
    }
    for what, scale in forms.items():
        if scale and scale != 1:
            yield OTHER_FORM, f"the constant belongs to the shape {what}", 1 / scale
            yield OTHER_FORM, f"the shape is {what}, its constant is not", scale
            first = kernel.normalisation(1)
            yield OTHER_FORM, "the constant belongs to another form", scale / first / top
    yield OTHER_FORM, "the reciprocal of the right constant", 1 / kernel.normalisation(dim) ** 2
    for other_kernel, _ in profiles():
        if other_kernel != kernel:
            there = other_kernel.normalisation(dim) * (other_kernel.support / support) ** dim
            yield OTHER_CONSTANT, f"the constant of {other_kernel.name}", there / sigma[dim]


def number_of(value: Any) -> Any:
    return number(value) if isinstance(value, Expr) else mpmath.mpf(value)


def explain_constant(match: Match, dim: int) -> Fault | None:
    """Why the kernel does not integrate to one; None if it does, within the error of the input."""
    with mpmath.workdps(DIGITS):
        found = number_of(match.integral)
        error = max(match.integral_error, 1e-40)
        if abs(found - 1) <= error:
            return None
        exact = match.integral if isinstance(match.integral, Expr) else recognise(found, error)
        shown = f"{exact}" if exact is not None and len(str(exact)) < 40 else f"{float(found):.10g}"
        lead = f"it integrates to {shown} in {dim}D, not to 1"
        right = expected_constant(match, dim)
        tail = f"; the constant should be {right}" if right else ""
        explained: list[tuple[str, str]] = []
        for kind, words, factor in constant_slips(match, dim):
            predicted = number_of(factor)
            if abs(found / predicted - 1) <= error and abs(predicted - 1) > error:
                explained.append((kind, words))
        if explained:
            (kind, words), rest = explained[0], explained[1:]
            also = dict.fromkeys(f"{k}: {w}" for k, w in rest if k != kind)
            return Fault(kind, f"{lead}: {words}{tail}", tuple(also)[:4])
        if SINGLE / 64 < abs(found - 1) <= 4 * SINGLE:
            return Fault(
                SINGLE_PRECISION, f"{lead}: its constant is accurate to single precision only{tail}"
            )
        for text in ROUGH_PI:
            rough = mpmath.mpf(text) if "/" not in text else mpmath.mpf(22) / 7
            for predicted in (mpmath.pi / rough, rough / mpmath.pi):
                if abs(found - predicted) <= abs(predicted - 1) / 100:
                    return Fault(
                        ROUNDED,
                        f"{lead}, a relative {float(found - 1):.2g}: π was taken as {text}{tail}",
                    )
        digits = _rounded_digits(match, dim, error)
        if digits:
            return Fault(ROUNDED, f"{lead}: its constant is given to {digits} digits only{tail}")
        if exact is not None and exact.is_Rational and _one_digit_off(match, dim, found, error):
            return Fault(MISPRINT, f"{lead}: one digit differs from the right constant{tail}")
        return Fault(WRONG_CONSTANT, f"{lead}{tail}")


def expected_constant(match: Match, dim: int) -> str:
    """The exact constant of the shape as the catalogue (or the author's formula) writes it."""
    if match.written is not None:
        return f"{match.written.normalisation(dim)}"
    shape = match.shape
    right = shape.normalisation(dim)
    if isinstance(shape, Analytic):
        return f"{right} (times {match.scale:.12g}^{dim})" if match.scale != 1 else f"{right}"
    support = exact_or_float(match.support)
    if support == shape.support:
        return f"{right}"
    if isinstance(support, Rational):
        return f"{right * (shape.support / support) ** dim}"
    return f"{right * shape.support**dim}/{match.support:.9g}^{dim}"


def _rounded_digits(match: Match, dim: int, error: float) -> int:
    """The number of digits, if the right constant in some usual form was rounded to so many."""
    found = number_of(match.integral)
    sigma = number_of(_normalisations(match)[dim])
    shape = match.shape
    scales: list[Any] = [1]
    if isinstance(shape, Kernel):
        top = shape.pieces[0].eval(0)
        scales += [number_of(top)] if top else []
        scales += [1 / number_of(shape.normalisation(1))]
        scales += [number_of(exact_or_float(match.support)) ** dim]
    for digits in range(2, 9):
        for scale in scales:
            right = sigma * scale
            rounded = mpmath.mpf(f"{float(right):.{digits - 1}e}")
            if abs(found * right / rounded - 1) <= max(error, 4 * DOUBLE):
                return digits
    return 0


def _one_digit_off(match: Match, dim: int, found: Any, error: float) -> bool:
    """Whether wrong and right constants, over a common numerator or denominator, look alike."""
    right = _normalisations(match)[dim]
    if not isinstance(right, Expr):
        return False
    wrong = recognise(found * number(right), error)
    if wrong is None:
        return False
    a, b = right.as_coeff_Mul()[0], wrong.as_coeff_Mul()[0]
    if right / a != wrong / b:
        return False
    if a.q == b.q:
        return _alike(a.p, b.p) or 1 in (abs(a.p), abs(b.p))
    if a.p == b.p:
        return _alike(a.q, b.q)
    return bool(b.p % a.p == 0 and _alike(a.q * (b.p // a.p), b.q)) or bool(
        a.p % b.p == 0 and _alike(b.q * (a.p // b.p), a.q)
    )


def _alike(a: int, b: int) -> bool:
    left, right = str(abs(int(a))), str(abs(int(b)))
    if len(left) == len(right):
        return len(left) > 1 and sum(x != y for x, y in zip(left, right, strict=True)) <= 2
    short, long = sorted((left, right), key=len)
    return len(long) - len(short) == 1 and any(
        long[:i] + long[i + 1 :] == short for i in range(len(long))
    )


# -- shapes ---------------------------------------------------------------------------------------


def explain_shape(match: Match, dim: int) -> Fault | None:
    """A reconstructed kernel that is one of the catalogue but for a term or two.

    It is a misprint where it is not normalised, or less smooth than the one it resembles.
    """
    if match.known or not isinstance(match.shape, Kernel):
        return None
    normalised = abs(number_of(match.integral) - 1) <= max(match.integral_error, 1e-40)
    best: list[str] = []
    name = ""
    for kernel, _ in profiles():
        if normalised and kernel.smoothness <= match.shape.smoothness:
            continue
        for differing in (_differences(match.shape, kernel), _factored(match.shape, kernel)):
            if differing and (not best or len(differing) < len(best)):
                best, name = differing, kernel.name
    if best:
        return Fault(MISPRINT, f"not quite {name}: {'; '.join(best)}")
    for knot, order in match.shape.knot_smoothness().items():
        if order == -1 and 0 < knot < match.shape.support:
            return Fault(DISCONTINUOUS, f"w jumps at q = {knot}, inside its support")
    return None


def _differences(found: Kernel, known: Kernel) -> list[str]:
    """The terms in powers of q in which two kernels differ; empty where it is not a few of many."""
    if len(found.pieces) != len(known.pieces):
        return []
    other = known.scaled(found.support)
    flat = [
        (i, power, left.nth(power), right.nth(power))
        for i, (left, right) in enumerate(zip(found.pieces, other.pieces, strict=True))
        for power in range(max(found.degree, other.degree) + 1)
    ]
    right_terms = sum(1 for *_, b in flat if b)
    best: list[tuple[int, int, Rational, Rational]] = []
    for scale in {a / b for *_, a, b in flat if a and b}:
        wrong = [(i, power, a, b * scale) for i, power, a, b in flat if a != b * scale]
        if 4 * len(wrong) <= right_terms and (not best or len(wrong) < len(best)):
            best = wrong
    told = [
        f"on {found.knots[i]}..{found.knots[i + 1]} the term q^{power} has {a},"
        f" where the other terms ask for {b}"
        for i, power, a, b in best
    ]
    if told and found.knots != other.knots:
        told.append(f"its knots should be {', '.join(str(k) for k in other.knots[1:-1])}")
    return told


def _factored(found: Kernel, known: Kernel) -> list[str]:
    """The same for kernels of one piece, (1 − u)^m times a short polynomial in u = q/κ."""
    if len(found.pieces) != 1 or len(known.pieces) != 1:
        return []
    order = known.boundary_smoothness + 1
    if found.boundary_smoothness + 1 != order or order < 3:
        return []
    power = Poly(1 - q, q, domain=QQ) ** order
    left, right = (k.scaled(1).pieces[0].quo(power) for k in (found, known))
    if left.degree() != right.degree() or not left.nth(0) or not right.nth(0):
        return []
    wrong = [
        (n, left.nth(n) / left.nth(0), right.nth(n) / right.nth(0))
        for n in range(1, left.degree() + 1)
    ]
    told = [
        f"the factor beside (1 - u)^{order}, u = q/κ, has {a} u^{n}, expected {b} u^{n}"
        for n, a, b in wrong
        if a != b
    ]
    return told if len(told) == 1 else []


# -- derivatives ----------------------------------------------------------------------------------


def explain_derivative(match: Match, samples: Samples, dim: int) -> Fault | None:
    """Why dW/dr is not the derivative of W; None if it is, within the rounding bound."""
    if samples.dw is None:
        return None
    keep = (samples.q > 0) & (samples.q < match.support)
    if isinstance(match.shape, Kernel):
        for knot in match.shape.knots[1:]:
            where = float(knot) / match.scale
            keep &= np.abs(samples.q - where) > max(8 * DOUBLE, match.support_error) * where
    x, dw, extra = samples.q[keep], samples.dw[keep], samples.derivative_error[keep]
    right, noise = match.slope(x)
    noise = noise + extra + np.max(np.abs(right)) * max(match.support_error, 4 * match.unit)
    if np.all(np.abs(dw - right) <= 2 * noise):
        return None
    for power, kind, words in (
        (0, WRONG_DERIVATIVE, ""),
        (1, MISSING_Q, "dW is W′/q: a factor q is missing"),
        (2, MISSING_Q, "dW is W′/q²: a factor q² is missing"),
        (-1, MISSING_Q, "dW is q W′: a factor q is too many"),
    ):
        factor = _constant_ratio(dw, right * x ** float(-power), noise * x ** float(-power), extra)
        if factor is not None:
            return _factor_of_derivative(match, dim, factor, kind, words)
    for name, shape, scale in _other_slopes(match):
        other = Match(
            shape, True, match.support, match.support_error, 1.0, scale, 1, 0.0, match.unit
        )
        there, spread = other.slope(x)
        factor = _constant_ratio(dw, there, spread + np.max(np.abs(there)) * 4 * match.unit, extra)
        if factor is not None:
            return Fault(
                OTHER_DERIVATIVE,
                f"dW is the derivative of {name}, not of {match.name}"
                f" (largest difference {np.max(np.abs(dw - right)):.3g})",
            )
    return _shifted(match, x, dw, extra) or _termwise(match, x, dw, right)


def _constant_ratio(dw: Array, right: Array, noise: Array, extra: Array) -> float | None:
    """c with dw = c · right at every sample, or None."""
    norm = float(right @ right)
    if not norm > 0:
        return None
    factor = float(dw @ right) / norm
    if not factor:
        return None
    return (
        factor if np.all(np.abs(dw - factor * right) <= 2 * (abs(factor) * noise + extra)) else None
    )


def _factor_of_derivative(match: Match, dim: int, factor: float, kind: str, words: str) -> Fault:
    error = 1e-10 if match.unit == DOUBLE else 1e-4
    shown = recognise(factor, error)
    by = f"{shown if shown is not None else f'{factor:.10g}'}"
    if kind == MISSING_Q:
        return Fault(
            MISSING_Q, words if abs(factor - 1) < error else f"{words}; also a factor {by}"
        )
    lead = f"dW is {by} times the derivative of W"
    whole = float(number_of(match.integral))
    if abs(factor * whole - 1) < error:
        return Fault(WRONG_CONSTANT, f"{lead}: it carries the right constant, which W does not", ())
    if abs(factor + 1) < error:
        return Fault(SIGN, f"{lead}: the sign is wrong")
    kappas = {match.support, float(match.shape.support) if isinstance(match.shape, Kernel) else 1.0}
    for kappa in kappas - {1.0}:
        for power in (-1, 1, -2, 2):
            if abs(factor / kappa**power - 1) < error:
                return Fault(
                    POWER_OF_SUPPORT, f"{lead}: the chain rule's factor {kappa:g}^{-power} is lost"
                )
    for slip, told, predicted in constant_slips(match, dim):
        if abs(factor / float(number_of(predicted)) - 1) < error:
            return Fault(slip, f"{lead}: {told}")
    return Fault(WRONG_DERIVATIVE, f"{lead}: its constant is wrong")


def _other_slopes(match: Match) -> Iterator[tuple[str, Kernel | Analytic, float]]:
    for kernel, _ in profiles():
        if kernel != match.shape:
            yield kernel.name, kernel, float(kernel.support) / match.support
    for shape in ANALYTIC.values():
        if shape != match.shape:
            yield shape.name, shape, 1.0 if shape.name == "gaussian" else 1 / match.support


def _shifted(match: Match, x: Array, dw: Array, extra: Array) -> Fault | None:
    """The derivative of the same kernel for another meaning of h."""
    if not isinstance(match.shape, Kernel):
        return None
    kernel = match.shape
    others = {support: what for what, support in conventions(kernel, 3)}
    for kappa in {*others, match.support * 2, match.support / 2}:
        if abs(kappa - match.support) < 1e-9:
            continue
        scale = float(kernel.support) / kappa
        other = Match(kernel, True, kappa, 2 * DOUBLE, 1.0, scale, 1, 0.0, match.unit)
        there, spread = other.slope(x)
        factor = _constant_ratio(dw, there, spread + np.max(np.abs(there)) * 8 * match.unit, extra)
        if factor is not None:
            what = others.get(kappa, "something else")
            return Fault(
                CONVENTION,
                f"dW has its support at {kappa:.7g}h (as if h were {what}),"
                f" W at {match.support:.7g}h",
            )
    return None


def _termwise(match: Match, x: Array, dw: Array, right: Array) -> Fault:
    """Which terms of the derivative are wrong, if it is a piecewise polynomial at all."""
    worst = int(np.argmax(np.abs(dw - right)))
    where = f"largest at q = {x[worst]:.4g}: {dw[worst]:.6g} where W′ is {right[worst]:.6g}"
    if isinstance(match.shape, Kernel):
        # in units of the coefficients of w(u), u = q/κ: rational where w′ is a usual polynomial
        unit = match.amplitude / match.support
        kernel = match.shape.scaled(1)
        found = reconstruct(x, dw, match.unit, match.support, unit)
        if found is not None and found[0].knots == kernel.knots:
            wrong = []
            for i, (has, of) in enumerate(zip(found[0].pieces, kernel.derivative(), strict=True)):
                step = Poly(has - of, q, domain=QQ)
                for (power,), _ in step.terms():
                    if not step.is_zero:
                        wrong.append(
                            f"on {kernel.knots[i]}..{kernel.knots[i + 1]} the term u^{power} has"
                            f" {has.nth(power)}, not {of.nth(power)}"
                        )
            if wrong:
                listed = "; ".join(wrong[:4])
                return Fault(
                    MISPRINT if len(wrong) <= 2 else WRONG_DERIVATIVE,
                    f"dW is not the derivative of W: {listed} (u = q/κ, {where})",
                )
    return Fault(WRONG_DERIVATIVE, f"dW is not the derivative of W, {where}")


def explain_truncation(match: Match, dim: int) -> Fault | None:
    """A Gaussian with the constant of the infinite range, cut off where it still has weight."""
    if not (isinstance(match.shape, Analytic) and match.shape.name == "gaussian"):
        return None
    with mpmath.workdps(DIGITS):
        reach = (mpmath.mpf(match.support) * mpmath.mpf(match.scale)) ** 2
        kept = mpmath.gammainc(mpmath.mpf(dim) / 2, 0, reach, regularized=True)
        whole = number_of(match.integral) / kept
        error = max(match.integral_error, 1e-40)
        if abs(whole - 1) > error or 1 - kept <= error:
            return None
        return Fault(
            TRUNCATION,
            f"the constant is that of the infinite range, the kernel is cut off at"
            f" {match.support:.6g}h: {float(1 - kept):.4g} of its integral is missing",
        )


def power_of_h(power: float, dim: int) -> Fault:
    """W ∝ h^power where it should be h^−d."""
    return Fault(POWER_OF_H, f"W scales as h^{power:.4g} at fixed r/h, expected h^{-dim}")
