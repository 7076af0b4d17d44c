"""What is wrong with a shape: cut off, whole-number division in its terms, a term misprinted.

The alternatives are tried in that order of what they assume; each is exact, not a resemblance.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import trunc
from typing import Any

from sympy import QQ, Poly, Rational

from sphtrunc.audit import faults
from sphtrunc.audit.constants import exact_or_float, number, recognise
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.forms import MOST_DEGREE, forms
from sphtrunc.audit.recognition import Match, profiles
from sphtrunc.kernels.conventions import lengths
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import q


def explain_shape(match: Match) -> Fault | None:
    """A kernel that is one of the catalogue but for a cut, or for a term or two.

    It is wrong where it is not normalised, or less smooth than the one it resembles; what is
    normalised and as smooth is a kernel of its author's own.
    """
    if not isinstance(match.shape, Kernel):
        return None
    normalised = abs(number(match.integral) - 1) <= max(match.integral_error, 1e-40)
    if match.whole is not None:
        return None if normalised else _cut(match)
    if match.known:
        return None
    whole_numbers = None if normalised else divided(match.shape)
    if whole_numbers is not None:
        return whole_numbers
    best: list[str] = []
    name = ""
    for kernel, _ in profiles():
        if normalised and kernel.smoothness <= match.shape.smoothness:
            continue
        for differing in (
            _pieces_scaled(match.shape, kernel),
            _differences(match.shape, kernel),
            _factored(match.shape, kernel),
        ):
            if differing and (not best or len(differing) < len(best)):
                best, name = differing, kernel.name
    if best:
        terms = "one place of it" if len(best) == 1 else f"{len(best)} places of it"
        return Fault(
            faults.MISPRINT,
            f"not quite {name}: {'; '.join(best)}",
            f"with {terms} changed it is {name}; it is no catalogue kernel cut off, and none with"
            " its fractions divided as whole numbers",
        )
    for knot, order in match.shape.knot_smoothness().items():
        if order == -1 and 0 < knot < match.shape.support:
            return Fault(faults.DISCONTINUOUS, f"w jumps at q = {knot}, inside its support")
    return None


def _cut(match: Match) -> Fault:
    """The kernel ends before its support does."""
    whole = match.whole
    assert whole is not None
    assert isinstance(match.shape, Kernel)
    left = recognise(number(match.integral), max(match.integral_error, 1e-15))
    shown = (
        str(left)
        if left is not None and len(str(left)) < 30
        else f"{float(number(match.integral)):.8g}"
    )
    part = exact_or_float(match.support / whole.support)
    edge, centre = (match.shape.pieces[i].eval(x) for i, x in ((-1, match.shape.support), (0, 0)))
    share = f", {float(edge / centre):.3g} of its central value" if centre else ""
    where = f"q = {exact_or_float(match.support)}"
    right = abs(number(whole.integral) - 1) <= max(whole.integral_error, 1e-13)
    constant = "its constant is that of the whole kernel" if right else (
        f"its constant is not that of the whole kernel either, which would integrate to"
        f" {float(number(whole.integral)):.8g}")  # fmt: skip
    return Fault(
        faults.CUT,
        f"{match.name} evaluated at {where.replace('=', '<')} only, {part} of its support: the"
        f" integral there is {shown}, and at {where} W jumps to 0 from"
        f" {abs(match.amplitude * float(edge)):.4g}{share}; {constant}",
        f"every value agrees with {match.name} of support {whole.support:.7g}h, within rounding",
    )


def exact_cut(shape: Kernel, dim: int) -> tuple[Kernel, Rational] | None:
    """The catalogue kernel, and its support, of which an exact shape is the first part."""
    for kernel, _ in profiles():
        for length in lengths(kernel, dim).values():
            support = kernel.support / length
            if not support.is_Rational or support <= shape.support:
                continue
            own = kernel.scaled(support)
            count = len(shape.pieces)
            if count > len(own.pieces) or own.knots[:count] != shape.knots[:-1]:
                continue
            if own.knots[count] >= shape.support and _proportional(shape.pieces, own.pieces):
                return kernel, support
    return None


def _proportional(some: Sequence[Poly], others: Sequence[Poly]) -> bool:
    scale = some[0].LC() / others[0].LC()
    return all(a == b * scale for a, b in zip(some, others, strict=False))


def divided(found: Kernel) -> Fault | None:
    """A catalogue kernel with fractions in its terms taken as whole numbers, 3/2 = 1, 1/4 = 0."""
    best: tuple[int, str, list[str]] | None = None
    for kernel, _ in profiles():
        if kernel.degree > MOST_DEGREE or found.degree > kernel.degree:
            continue
        for length in {Rational(1), kernel.support}:
            ends = [knot / length for knot in kernel.knots[: len(found.pieces) + 1]]
            if [*ends] != [*found.knots]:  # a piece may be missing, no knot moves
                continue
            own = kernel.scaled(kernel.support / length)
            for form in forms(kernel, "h" if length == 1 else "support"):
                written = [piece * (1 / form.scale) for piece in own.pieces]
                for told in (
                    _truncated(found, written),
                    _truncated_cofactor(found, own, written),
                ):
                    if told and (best is None or len(told) < best[0]):
                        best = len(told), kernel.name, told
    if best is None:
        return None
    _, name, told = best
    return Fault(
        faults.INTEGER_DIVISION,
        f"it is {name} with fractions divided as whole numbers: {', '.join(told)}",
        f"every term agrees with {name} once these are",
    )


def _truncated(found: Kernel, written: Sequence[Poly]) -> list[str]:
    """What became what, term by term in powers of q; empty where it is something else."""
    count = len(found.pieces)
    told: dict[str, None] = {}
    first = written[0].nth(0)
    scale = found.pieces[0].nth(0) / first if first.is_Integer and first else None
    if scale is None or not scale:
        return []
    for piece, right in zip(found.pieces, written, strict=False):
        for power in range(max(piece.degree(), right.degree()) + 1):
            has, of = piece.nth(power) / scale, right.nth(power)
            if has == of:
                continue
            if has != trunc(of):
                return []
            told[f"{of} became {has}"] = None
    for piece in written[count:]:  # a piece that begins with a fraction below one is gone
        factor = abs(piece.LC())
        if factor.is_Integer:
            return []
        told[f"{factor} became 0"] = None
    return list(told)


def _truncated_cofactor(found: Kernel, own: Kernel, written: Sequence[Poly]) -> list[str]:
    """The same for (1 − q/κ)^m times a polynomial."""
    if len(found.pieces) != 1 or len(written) != 1 or found.support != own.support:
        return []
    order = own.boundary_smoothness + 1
    power = Poly(1 - q / own.support, q, domain=QQ) ** order
    left, rest = found.pieces[0].div(power)
    right = written[0].quo(power)
    if not order or not rest.is_zero or not left.nth(0) or not right.nth(0).is_Integer:
        return []
    scale = left.nth(0) / right.nth(0)
    told = []
    for n in range(1, max(left.degree(), right.degree()) + 1):
        has, of = left.nth(n) / scale, right.nth(n)
        if has != of:
            if has != trunc(of):
                return []
            told.append(f"{of} became {has}")
    return told


def _pieces_scaled(found: Kernel, known: Kernel) -> list[str]:
    """The pieces that are a multiple of what the first one asks for: a factor lost in them."""
    own = known.scaled(found.support)
    if found.knots != own.knots or len(found.pieces) < 2:
        return []
    scales: list[Any] = []
    for piece, right in zip(found.pieces, own.pieces, strict=True):
        scale = piece.LC() / right.LC()
        if piece != right * scale:
            return []
        scales.append(scale / scales[0] if scales else scale)
    return [
        f"on {a}..{b} it is {scale} times what the first piece asks for"
        for (a, b), scale in zip(pairwise(found.knots[1:]), scales[1:], strict=True)
        if scale != 1
    ]


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
