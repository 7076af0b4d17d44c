"""What a recognised kernel is, in words: shape, convention, smoothness, inflection points."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from sympy import Expr, Poly, Rational

from sphtrunc.audit.analytic import Analytic
from sphtrunc.audit.constants import exact_or_float, number, simplest_between
from sphtrunc.audit.explanations import expected_constant
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.recognition import Match, conventions, derived
from sphtrunc.audit.reconstruction import fixed, values
from sphtrunc.audit.report import Audit
from sphtrunc.audit.samples import Array, Samples
from sphtrunc.kernels.kernel import Kernel


def described(
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
    w = match.derivative(q, 0)[0]
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
