"""What is wrong with a derivative: a factor, a power of q, a sign, another function, a term."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from sympy import QQ, Poly

from sphtrunc.audit import faults
from sphtrunc.audit.analytic import ANALYTIC, Analytic
from sphtrunc.audit.constants import exact_or_float, number, recognise
from sphtrunc.audit.explanations import explain_factor
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.recognition import Match, conventions, derived, profiles
from sphtrunc.audit.reconstruction import reconstruct
from sphtrunc.audit.samples import DOUBLE, Array, Samples
from sphtrunc.audit.slips import Slip
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import q

NAME = ("W", "dW", "d²W")
RIGHT = ("W", "W′", "W″")
WORDS = ("W", "the derivative of W", "the second derivative of W")
#: powers of q that are divided out: what the derivative then lacks
Q_POWERS = (
    (1, faults.MISSING_Q, "{has} is {of}/{q}: a factor {q} is missing"),
    (2, faults.MISSING_Q, "{has} is {of}/{q}²: a factor {q}² is missing"),
    (-1, faults.SURPLUS_Q, "{has} is {q} {of}: a factor {q} too many"),
    (-2, faults.SURPLUS_Q, "{has} is {q}² {of}: a factor {q}² too many"),
)


def explain_derivative(
    match: Match, samples: Samples, dim: int, order: int = 1, surplus: float = 0.0
) -> Fault | None:
    """Why dW/dr (d²W/dr²) is not the derivative of W; None if it is, within the rounding bound.

    surplus: the power of h that it has too many, which W′/r shares with a factor 1/q.
    """
    given = (samples.w, samples.dw, samples.d2w)[order]
    error = (samples.error, samples.derivative_error, samples.second_error)[order]
    if given is None:
        return None
    keep = (samples.q > 0) & (samples.q < match.support)
    if isinstance(match.shape, Kernel):
        for knot in match.shape.knots[1:]:
            where = float(knot) / match.scale
            keep &= np.abs(samples.q - where) > max(8 * DOUBLE, match.support_error) * where
    x, has, extra = samples.q[keep], given[keep], error[keep]
    right, noise = match.derivative(x, order)
    noise = noise + extra + np.max(np.abs(right)) * max(match.support_error, 4 * match.unit)
    if np.all(np.abs(has - right) <= 2 * noise):
        return None
    factor = _constant_ratio(has, right, noise, extra)
    if factor is not None:
        h = samples.h if len(samples.scaled) < 2 else None
        return _factor_of_derivative(match, dim, order, factor, h)
    for power, kind, words in Q_POWERS:
        scale = x ** float(-power)
        factor = _constant_ratio(has, right * scale, noise * scale, extra)
        if factor is not None:
            letter = "r" if surplus == -power else "q"
            told = words.format(has=NAME[order], of=RIGHT[order], q=letter)
            return Fault(kind, told + _besides(factor), _agreement(x))
    return (
        _other_function(match, x, has, extra, dim, order)
        or _other_kernel(match, x, has, extra, dim, order)
        or _shifted(match, x, has, extra, dim, order)
        or _piece_by_piece(match, x, has, right, noise, extra, order)
        or _termwise(match, x, has, right, order)
    )


def _agreement(x: Array) -> str:
    return f"it agrees at all {len(x)} distances, within rounding"


def _constant_ratio(has: Array, right: Array, noise: Array, extra: Array) -> float | None:
    """c with has = c · right at every sample, or None."""
    norm = float(right @ right)
    if not norm > 0:
        return None
    factor = float(has @ right) / norm
    if not factor:
        return None
    off = np.abs(has - factor * right) > 2 * (abs(factor) * noise + extra)
    return None if np.any(off) else factor


def _besides(factor: float) -> str:
    """A factor that is left over, in words."""
    if abs(factor - 1) < 1e-9:
        return ""
    if abs(factor + 1) < 1e-9:
        return "; also the sign is wrong"
    shown = recognise(factor, 1e-10)
    return f"; also a factor {shown if shown is not None else f'{factor:.10g}'}"


def _factor_of_derivative(
    match: Match, dim: int, order: int, factor: float, h: float | None
) -> Fault:
    error = 1e-10 if match.unit == DOUBLE else 1e-4
    simple = recognise(factor, error)
    shown = f"{simple if simple is not None else f'{factor:.10g}'}"
    lead = f"{NAME[order]} is {shown} times {WORDS[order]}"
    whole = float(number(match.integral))
    if abs(factor * whole - 1) < error:
        return Fault(
            faults.WRONG_CONSTANT, f"{lead}: it carries the right constant, which W does not"
        )
    if abs(factor + 1) < error:
        return Fault(faults.SIGN, f"{lead}: the sign is wrong")
    if h is not None and h != 1:
        for power in (1, -1, 2, -2):
            if abs(factor / h**power - 1) < error:
                hint = _of_h(order, power)
                return Fault(faults.POWER_OF_H, f"{lead}, which is h^{power} with h = {h:g}{hint}")
    chain = [
        Slip(
            faults.POWER_OF_SUPPORT,
            f"the chain rule's factor {kappa:g}^{-power} is lost",
            kappa**power,
            (1.2 if power * natural > 0 else 2.4) + 0.2 * abs(power),
        )
        for kappa, natural in _supports(match).items()
        for power in (-1, 1, -2, 2)
    ]
    if isinstance(match.shape, Kernel) and (n := match.shape.boundary_smoothness + 1) > 1:
        words = f"the factor {n} of the power rule is lost"
        chain.append(Slip(faults.WRONG_DERIVATIVE, words, 1 / n, 1.3))
    fault = explain_factor(match, dim, factor, error, shown, more=chain)
    return Fault(
        fault.kind if fault.kind != faults.WRONG_CONSTANT else faults.WRONG_DERIVATIVE,
        f"{lead}: {fault.message}",
        fault.surely,
        fault.also,
    )


def _supports(match: Match) -> dict[float, int]:
    """Supports κ that the chain rule brings, and whether w(r/κh) is written, which lacks 1/κ where
    it is forgotten (1), or w(κr/h), which lacks κ (−1)."""
    found = {float(match.shape.support): -1} if isinstance(match.shape, Kernel) else {}
    found[match.support] = 1
    return {kappa: natural for kappa, natural in found.items() if kappa != 1}


def _of_h(order: int, power: float) -> str:
    """What a power of h too many suggests."""
    if power == 1 and order:
        return "; did you return dW/dq?" if order == 1 else "; is one 1/h missing?"
    if power == 2 and order == 2:
        return "; did you return d²W/dq²?"
    if power == -1 and order:
        return "; is 1/h multiplied once too often?"
    return ""


def _functions(match: Match, x: Array, dim: int) -> dict[str, tuple[int, Array, Array]]:
    """Other functions that are returned for a derivative: words -> (order it is, values, noise)."""
    (w, e0), (slope, e1), (bend, e2) = (match.derivative(x, order) for order in range(3))
    return {
        "W itself": (0, w, e0),
        "the derivative of W": (1, slope, e1),
        "the second derivative of W": (2, bend, e2),
        "the derivative of W with respect to h, −(d W + q W′)": (
            9, -(dim * w + x * slope), dim * e0 + x * e1,
        ),
        "the Laplacian of W, W″ + (d − 1) W′/q": (
            9, bend + (dim - 1) * slope / x, e2 + (dim - 1) * e1 / x,
        ),
        "(d − 1) W′/q, a part of the Laplacian,": (9, (dim - 1) * slope / x, (dim - 1) * e1 / x),
    }  # fmt: skip


def _other_function(
    match: Match, x: Array, has: Array, extra: Array, dim: int, order: int
) -> Fault | None:
    for words, (which, there, spread) in _functions(match, x, dim).items():
        if which == order:
            continue
        spread = spread + np.max(np.abs(there)) * max(4 * match.unit, match.support_error)
        factor = _constant_ratio(has, there, spread, extra)
        if factor is not None:
            return Fault(
                faults.OTHER_FUNCTION,
                f"{NAME[order]} is {words}, not {WORDS[order]}{_besides(factor)}",
                _agreement(x),
            )
    return None


def _other_kernel(
    match: Match, x: Array, has: Array, extra: Array, dim: int, order: int
) -> Fault | None:
    right, _ = match.derivative(x, order)
    for name, shape, scale in _other_slopes(match, dim):
        other = Match(
            shape, True, match.support, match.support_error, 1.0, scale, 1, 0.0, match.unit
        )
        there, spread = other.derivative(x, order)
        factor = _constant_ratio(has, there, spread + np.max(np.abs(there)) * 4 * match.unit, extra)
        if factor is not None:
            return Fault(
                faults.OTHER_DERIVATIVE,
                f"{NAME[order]} is that of {name}, not of {match.name}"
                f" (largest difference {np.max(np.abs(has - right)):.3g})",
                _agreement(x),
            )
    return None


def _other_slopes(match: Match, dim: int) -> Iterator[tuple[str, Kernel | Analytic, float]]:
    for kernel, _ in profiles(dim):
        if kernel != match.shape:
            yield kernel.name, kernel, float(kernel.support) / match.support
    for shape in ANALYTIC.values():
        if shape != match.shape:
            yield shape.name, shape, 1.0 if shape.name == "gaussian" else 1 / match.support


def _shifted(
    match: Match, x: Array, has: Array, extra: Array, dim: int, order: int
) -> Fault | None:
    """The derivative of the same kernel for another meaning of h."""
    if not isinstance(match.shape, Kernel):
        return None
    kernel = match.shape
    others = {support: what for what, support in conventions(kernel, dim)}
    for kappa in {*others, match.support * 2, match.support / 2}:
        if abs(kappa - match.support) < 1e-9:
            continue
        scale = float(kernel.support) / kappa
        other = Match(kernel, True, kappa, 2 * DOUBLE, 1.0, scale, 1, 0.0, match.unit)
        there, spread = other.derivative(x, order)
        factor = _constant_ratio(has, there, spread + np.max(np.abs(there)) * 8 * match.unit, extra)
        if factor is not None:
            what = others.get(kappa, "something else")
            return Fault(
                faults.CONVENTION,
                f"{NAME[order]} has its support at {kappa:.7g}h (as if h were {what}),"
                f" W at {match.support:.7g}h",
                _agreement(x),
            )
    return None


def _piece_by_piece(
    match: Match, x: Array, has: Array, right: Array, noise: Array, extra: Array, order: int
) -> Fault | None:
    """Right on some pieces and a multiple of the right one, or of q^±1 times it, on the others."""
    if not isinstance(match.shape, Kernel):
        return None
    knots = [float(k) / match.scale for k in match.shape.knots]
    told: list[str] = []
    kinds: list[str] = []
    fine = 0
    for a, b in pairwise(knots):
        here = (x > a) & (x < b)
        if np.count_nonzero(here) < 4:
            return None
        y, of, spread, more = has[here], right[here], noise[here], extra[here]
        if np.all(np.abs(y - of) <= 2 * spread):
            fine += 1
            continue
        place = f"for {exact_or_float(a)} < q < {exact_or_float(b)}"
        if not np.any(y):
            told.append(f"{place} it is 0")
            kinds.append(faults.CUT)
            continue
        for power in (0, 1, -1):
            scale = x[here] ** float(-power)
            factor = _constant_ratio(y, of * scale, spread * scale, more)
            if factor is not None:
                simple = recognise(factor, 1e-9 if match.unit == DOUBLE else 1e-4)
                times = f"{simple if simple is not None else f'{factor:.8g}'}"
                by = {0: "", 1: "/q", -1: " q"}[power]
                told.append(f"{place} it is {times} times {RIGHT[order]}{by}")
                sign = abs(factor + 1) < 1e-9 and not power
                kinds.append(
                    faults.SIGN if sign else faults.MISSING_Q if power == 1 else
                    faults.SURPLUS_Q if power == -1 else faults.WRONG_DERIVATIVE
                )  # fmt: skip
                break
        else:
            return None
    if not fine or not told:
        return None
    if match.shape.pieces and kinds == [faults.CUT] * len(kinds):
        return Fault(
            faults.CUT,
            f"{NAME[order]} is {WORDS[order]} only in part: {'; '.join(told)}",
            _agreement(x),
        )
    return Fault(
        kinds[0], f"{NAME[order]} is {WORDS[order]} only in part: {'; '.join(told)}", _agreement(x)
    )


def _termwise(match: Match, x: Array, has: Array, right: Array, order: int) -> Fault:
    """Which terms of the derivative are wrong, if it is a piecewise polynomial at all."""
    worst = int(np.argmax(np.abs(has - right)))
    here, there = f"{has[worst]:.6g}", f"{right[worst]:.6g}"
    where = f"largest at q = {x[worst]:.4g}: {here} where {RIGHT[order]} is {there}"
    lead = f"{NAME[order]} is not {WORDS[order]}"
    if isinstance(match.shape, Kernel):
        # in units of the coefficients of w(u), u = q/κ: rational where w′ is a usual polynomial
        unit = match.amplitude / match.support**order
        kernel = match.shape.scaled(1)
        found = reconstruct(x, has, match.unit, match.support, unit)
        if found is not None and found[0].knots == kernel.knots:
            wrong = []
            pieces = derived(kernel, order)
            for i, (own, of) in enumerate(zip(found[0].pieces, pieces, strict=True)):
                step = Poly(own - of, q, domain=QQ)
                for (power,), _ in step.terms():
                    if not step.is_zero:
                        wrong.append(
                            f"on {kernel.knots[i]}..{kernel.knots[i + 1]} the term u^{power} has"
                            f" {own.nth(power)}, not {of.nth(power)}"
                        )
            if wrong:
                listed = "; ".join(wrong[:4])
                return Fault(
                    faults.MISPRINT if len(wrong) <= 2 else faults.WRONG_DERIVATIVE,
                    f"{lead}: {listed} (u = q/κ, {where})",
                    "no other kernel, function, power of q or meaning of h gives these values",
                )
    return Fault(
        faults.WRONG_DERIVATIVE,
        f"{lead}, {where}",
        "no other kernel, function, power of q or meaning of h gives these values",
    )
