"""The ways in which one kernel is written: which length is called h, and how its shape is scaled.

With ℓ in place of h, W = c ℓ^−d w(r/ℓ): c = σ_d (ℓ/h)^d s, where s is the factor between the shape
of the catalogue and the one that is written (s = w(0) if that is 1 at the origin).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from math import lcm

from sympy import QQ, Poly, Rational, igcd

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import q, valuation

MOST_DEGREE = 14  # of kernels that are written in other forms than the catalogue's
CATALOGUE = "constant"
ORIGIN = "value at the origin"
UNIT_1D = "constant for a shape of unit 1D integral"
LED = "constant for a shape led by"
WHOLE = "constant for a shape with whole coefficients"

#: length: (words, how unusual it is in bits)
LENGTHS: dict[str, tuple[str, float]] = {
    "h": ("h", 0.0),
    "support": ("the support radius", 0.5),
    "two-sigma": ("2σ", 2.5),
    "sigma": ("σ", 3.5),
    "fwhm": ("the full width at half maximum", 3.0),
    "hwhm": ("the half width at half maximum", 4.0),
}


@dataclass(frozen=True)
class Form:
    """A way to scale the shape: words; s as a rational; how unusual it is, in bits."""

    words: str
    scale: Rational
    odd: float


@cache
def forms(kernel: Kernel, length: str) -> tuple[Form, ...]:
    """The forms in which a shape is written in units of that length, the usual ones first.

    Forms that depend on the length, (2 − q)³ or (1 − u)³, are given for "h" and "support" only;
    the unit integral in 1D is left to the caller, who knows ℓ: s = 1/(σ_1 ℓ/h).
    """
    top = kernel.central()
    found = [Form(CATALOGUE, Rational(1), 0.0 if top == 1 or length == "h" else 1.0)]
    if top not in (0, 1):
        found.append(Form(ORIGIN, top, 0.5))
    if length in ("h", "support") and kernel.degree <= MOST_DEGREE:
        found += _coefficients(kernel, Rational(1) if length == "h" else kernel.support)
    first: dict[Rational, Form] = {}
    for form in found:
        first.setdefault(form.scale, form)
    return tuple(first.values())


def _coefficients(kernel: Kernel, length: Rational) -> Iterator[Form]:
    """(κ − x)^m with coefficient 1, and whole coefficients without a common divisor, x = r/ℓ."""
    own = kernel.scaled(kernel.support / length) if length != 1 else kernel
    edge, last = own.support, own.pieces[-1]
    order = int(valuation(last, edge))
    power = Poly(edge - q, q, domain=QQ) ** order
    leading = last.quo(power)
    shown = f"({edge} - q)" + (f"^{order}" if order > 1 else "")
    if order and leading.degree() == 0:
        yield Form(f"{LED} {shown}", leading.nth(0), 1.0)
    elif order and len(own.pieces) == 1:
        factor = _whole(leading)
        beside = str(leading.as_expr() / factor).replace("**", "^").replace("*", " ")
        yield Form(f"{WHOLE}, {shown} ({beside})", factor, 2.0)
        if edge != 1:  # the same beside (1 − x/κ)^m
            unit = factor * edge**order
            yield Form(f"{WHOLE}, (1 - q/{edge})^{order} ({beside})", unit, 1.5)
    if not (order and len(own.pieces) == 1):
        yield Form(WHOLE, _whole(*own.pieces), 2.0)


def _whole(*pieces: Poly) -> Rational:
    """What is divided out to leave coprime whole coefficients."""
    table = [c for piece in pieces for c in piece.coeffs()]
    over = igcd(*(int(c.p) for c in table)) if len(table) > 1 else abs(int(table[0].p))
    return Rational(int(over), lcm(*(int(c.q) for c in table)))
