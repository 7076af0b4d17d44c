"""Whose constant a number is: the constants of every kernel, dimension, convention and form.

W = c ℓ^−d w(r/ℓ), with ℓ any length that codes call h and w in any usual form (see `forms`). The
constants are ranked by plausibility, counted in bits: what is half as usual costs one more.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import inf, isqrt, log, log2
from typing import Any

import mpmath
from sympy import Expr, Float, Integer, Rational, pi, sqrt

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.audit.analytic import ANALYTIC
from sphtrunc.audit.constants import DIGITS, constant, number, recognise, slip_of_pen
from sphtrunc.audit.forms import CATALOGUE, LENGTHS, UNIT_1D, Form, forms
from sphtrunc.kernels import catalogue, gaussian
from sphtrunc.kernels.conventions import half_width, lengths

MOST = 12  # candidates that are shown
NEAREST = 5  # near misses that are shown
NEAR_BITS = 12.0  # a ratio that is one of so many, 2^12, as simple is no resemblance any more
WORSE_BITS = 5.0  # near misses that are so much less plausible than the first are not shown
PEN_BITS = 8.0  # of a constant that differs by a digit
FEW_DIGITS = 0.02  # expected number of accidental matches from which on it is said

#: how unusual a kernel is, in bits; what is not here is one of a family
USUAL: dict[str, float] = {
    "cubic-spline": 0.0, "wendland-c2": 0.2, "quintic-spline": 0.3, "wendland-c4": 0.4,
    "wendland-c6": 0.5, "quartic-spline": 0.6, "gaussian": 0.7, "poly6": 0.8, "spiky": 0.9,
    "wendland-c2-1d": 1.0, "wendland-c4-1d": 1.1, "wendland-c6-1d": 1.2, "lucy": 1.5,
    "johnson-quadratic": 1.5, "wendland-c8": 2.0, "hyperbolic": 2.0, "double-cosine": 2.0,
    "cosine": 2.5, "core-triangle": 2.5, "super-gaussian": 2.5, "linear-quartic": 3.0,
}  # fmt: skip


@dataclass(frozen=True)
class Exact:
    """c π^(k/2) √s, c and s rational: what constants are, unless a half width enters."""

    factor: Fraction
    halves: int = 0
    square: Fraction = Fraction(1)

    def __mul__(self, other: Exact) -> Exact:
        square = self.square * other.square
        up, down = isqrt(square.numerator), isqrt(square.denominator)
        factor = self.factor * other.factor
        if up * up == square.numerator and down * down == square.denominator:
            factor, square = factor * Fraction(up, down), Fraction(1)
        return Exact(factor, self.halves + other.halves, square)

    def inverse(self) -> Exact:
        """1/x."""
        return Exact(1 / self.factor, -self.halves, 1 / self.square)

    def __pow__(self, power: int) -> Exact:
        result = Exact(Fraction(1))
        for _ in range(power):
            result = result * self
        return result

    def expression(self) -> Expr:
        """As a SymPy expression."""
        factor, square = (Rational(x.numerator, x.denominator) for x in (self.factor, self.square))
        return factor * sqrt(square) * pi ** Rational(self.halves, 2)

    def value(self) -> Any:
        """As an mpmath number, in the precision that is set."""
        root = mpmath.sqrt(mpmath.mpf(self.square.numerator) / self.square.denominator)
        factor = mpmath.mpf(self.factor.numerator) / self.factor.denominator
        return factor * root * mpmath.sqrt(mpmath.pi) ** self.halves

    def __float__(self) -> float:
        root = math.sqrt(self.square)
        return float(self.factor) * root * math.pow(math.pi, self.halves / 2)


def exact(value: Expr) -> Exact | None:
    """The expression as c π^(k/2) √s, if it is that."""
    factor, rest = value.as_coeff_Mul()
    if not factor.is_Rational:
        return None
    found = Exact(fraction(factor))
    for part in rest.args if rest.is_Mul else (rest,):
        base, power = part.as_base_exp()
        if base == 1:
            continue
        if not (2 * power).is_Integer:
            return None
        twice = int(2 * power)
        if base == pi:
            found = found * Exact(Fraction(1), twice)
        elif base.is_Rational and base > 0:
            found = found * Exact(Fraction(1), 0, fraction(base) ** twice)
        else:
            return None
    return found


@dataclass(frozen=True)
class Known:
    """A constant that the catalogue derives: whose it is, its value, how unusual it is in bits.

    length: a key of `forms.LENGTHS`; support: in units of it, None where it is infinite; form:
    words; value: to double precision; exact: None where it is no root of a rational times a power
    of π, and `special` may be
    """

    kernel: str
    dim: int
    length: str
    support: Exact | float | None
    form: str
    value: float
    exact: Exact | None
    bits: float
    special: Expr | None = None

    @property
    def convention(self) -> str:
        """The support in units of what is called h, and what that is where it is not usual."""
        ends = f"support {_in_text(self.support)}h" if self.support else "infinite support"
        words, _ = LENGTHS[self.length]
        return ends if self.length in ("h", "support") else f"{ends}, h = {words}"

    def expression(self) -> Expr:
        """Exactly; a decimal where a half width enters."""
        if self.exact is not None:
            return self.exact.expression()
        return Float(self.value) if self.special is None else self.special


@cache
def known_constants() -> tuple[Known, ...]:
    """Everything that the catalogue derives, each value of a kernel in a dimension once."""
    best: dict[tuple[str, int, object], Known] = {}
    for known in _known():
        key = (known.kernel, known.dim, known.exact or known.value)
        if key not in best or known.bits < best[key].bits:
            best[key] = known
    return tuple(best.values())


def _known() -> Iterator[Known]:
    seen: set[Any] = set()
    for name in [*catalogue.names(), *gaussian.names()]:
        kernel = catalogue.named(name) if name in catalogue.names() else gaussian.named(name)
        assert kernel is not None
        aliased = kernel in seen and name != "lucy"  # which in 1D is a Wendland function
        if not aliased:
            seen.add(kernel)
            yield from _of_kernel(name, kernel)
    for name, shape in ANALYTIC.items():
        if name != "gaussian":
            for dim in (1, 2, 3):
                whole = shape.normalisation(dim)
                yield Known(
                    name, dim, "support", 1.0, CATALOGUE, float(number(whole)), exact(whole),
                    USUAL[name], whole,
                )  # fmt: skip


def _of_kernel(name: str, kernel: Any) -> Iterator[Known]:
    half = half_width(kernel, DIGITS)
    endless = not kernel.is_polynomial and kernel.cut is None
    first = exact(kernel.normalisation(1))
    for dim in (1, 2, 3):
        sigma = kernel.normalisation(dim)
        whole = float(number(sigma))
        of_sigma = exact(sigma)
        ratios: dict[str, Any] = dict(lengths(kernel, dim))
        if endless:
            del ratios["support"]
        if half:
            ratios |= {"fwhm": 2 * _simple(half), "hwhm": _simple(half)}
        for length, ratio in ratios.items():
            of_ratio = exact(ratio) if isinstance(ratio, Expr) else None
            bits = kernel_bits(name, dim) + LENGTHS[length][1]
            ends = None if endless else _over(Exact(fraction(kernel.support)), of_ratio, ratio)
            special = sigma if length == "h" else None
            for form, scale in _all_forms(kernel, length, of_ratio, first, dim):
                if of_sigma is not None and of_ratio is not None:
                    found: Exact | None = of_sigma * of_ratio**dim * scale
                    value = float(found) if found is not None else 0.0
                else:
                    found, value = None, whole * float(ratio) ** dim * float(scale)
                yield Known(
                    name, dim, length, ends, form.words, value, found, bits + form.odd, special
                )


def _simple(half: Any) -> Any:
    """A half width as a rational, or the root of one, where the denominator is small."""
    with mpmath.workdps(DIGITS):
        square = half**2
        near = Fraction(float(square)).limit_denominator(64)
        same = abs(square - mpmath.mpf(near.numerator) / near.denominator) < 1e-40
    return sqrt(Rational(near.numerator, near.denominator)) if same else half


def _over(support: Exact, of_ratio: Exact | None, ratio: Any) -> Exact | float:
    return float(support) / float(ratio) if of_ratio is None else support * of_ratio.inverse()


def _all_forms(
    kernel: Any, length: str, of_ratio: Exact | None, first: Exact | None, dim: int
) -> Iterator[tuple[Form, Exact]]:
    """The forms of the shape and their factors; that of unit integral in 1D among them."""
    if not kernel.is_polynomial:
        yield Form(CATALOGUE, Rational(1), 0.0), Exact(Fraction(1))
        return
    for form in forms(kernel, length):
        yield form, Exact(fraction(form.scale))
    if dim > 1 and first is not None and of_ratio is not None:
        scale = (first * of_ratio).inverse()
        if scale != Exact(Fraction(1)):
            yield Form(UNIT_1D, Rational(0), 1.2), scale


def kernel_bits(name: str, dim: int) -> float:
    """How unusual a kernel is in that dimension."""
    if name in USUAL:
        strange = name.startswith("wendland") and (dim == 1) != name.endswith("-1d")
        return USUAL[name] + 3.0 * strange - (name == "lucy" and dim > 1)
    family, _, member = name.partition(":")
    if family == "gaussian":
        return 2.5
    count = int(member) if member.lstrip("-").isdigit() else 0
    return {"b-spline": 2.5, "polynomial": 3.5}.get(family, 3.0) + 0.15 * abs(count)


def _in_text(support: Exact | float) -> str:
    if isinstance(support, Exact) and support.square == 1 and not support.halves:
        return str(support.factor)
    return f"{float(support):.6g}"


def resemblance(factor: Fraction, halves: int = 0) -> float:
    """How remarkable a ratio is: log2 of how many are as simple, or as simple and as near to 1.

    (a/b)^n is one of a b n, p/q one of 2 p q |p/q − 1| that lie as near to 1; or of p q, and more
    the farther it is from 1. 0 for 1 itself.

    >>> resemblance(Fraction(125, 8)) < resemblance(Fraction(360, 359)) < 10
    True
    """
    if factor == 1 and not halves:
        return 0.0
    up, down = abs(factor.numerator), factor.denominator
    away = abs(log(up) - log(down))
    count = up * down * (1 + away if halves or away > 0.5 else 2 * abs(float(factor) - 1))
    for n in range(2, 7):
        a, b = round(up ** (1 / n)), round(down ** (1 / n))
        if a**n == up and b**n == down:
            count = min(count, float(a * b * n))
    return max(log2(max(count, 1.0)), 1.0) + {0: 0.0, 1: 4.0, 2: 2.5}.get(abs(halves), 6.0)


@dataclass(frozen=True)
class Candidate:
    """A constant that the catalogue derives, beside the number that was asked about.

    ratio: number / constant, exact where it has a simple form; match: they agree within the digits;
    bits: how unusual it is, less being better.
    """

    kernel: str
    dim: int
    convention: str
    meaning: str
    exact: Expr
    ratio: Expr | float
    match: bool
    bits: float


@dataclass(frozen=True)
class Identification:
    """What a number is: its exact form, if it has one, and the constants equal or near to it.

    accidental: how many constants would agree with its digits by chance.
    """

    text: str
    value: float
    form: Expr | None
    candidates: tuple[Candidate, ...]
    accidental: float

    def to_dict(self) -> dict[str, Any]:
        return {
            "schema": "sphtrunc.identify/2",
            "text": self.text,
            "value": self.value,
            "form": None if self.form is None else str(self.form),
            "candidates": [
                {**vars(c), "exact": str(c.exact), "ratio": str(c.ratio)} for c in self.candidates
            ],
            "accidental": self.accidental,
        }

    def to_json(self) -> str:
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False)

    def to_text(self) -> str:
        form = "no simple exact form" if self.form is None else str(self.form)
        lines = [f"{self.text} = {form}" if form != self.text else self.text]
        if not self.candidates:
            lines.append("  no constant of the catalogue is this or near it")
        for c in self.candidates:
            what = f"{c.kernel} in {c.dim}D, {c.convention}, {c.meaning}"
            lines.append(
                f"  is    {c.exact}: {what}"
                if c.match
                else f"  near  {c.exact}: {what}; ratio {powers(c.ratio)}"
            )
        if self.accidental > FEW_DIGITS and self.candidates:
            lines.append(
                f"  note  with so few digits about {self.accidental:.1g} of the constants agree by"
                " chance"
            )
        return "\n".join(lines)


def powers(ratio: Expr | float) -> str:
    """A ratio as text, with a perfect power as one: 125/8 = (5/2)^3."""
    if isinstance(ratio, float):
        return f"{ratio:.10g}"
    factor = ratio.as_coeff_Mul()[0]
    for n in range(6, 1, -1):
        a, b = round(int(factor.p) ** (1 / n)), round(int(factor.q) ** (1 / n))
        if factor != 1 and a**n == factor.p and b**n == factor.q:
            base = f"({a}/{b})" if b > 1 and a > 1 else f"{a}" if b == 1 else f"(1/{b})"
            return f"{ratio} = {base}^{n}" if ratio == factor else str(ratio)
    return str(ratio)


def identify(text: str, most: int = MOST) -> Identification:
    """Recognise a kernel's constant: which kernel, dimension and convention it belongs to.

    Constants are those of W = c ℓ^{-d} w(r/ℓ), ℓ being the catalogue's smoothing length, the
    support radius, 2σ, σ, or the full or half width at half maximum, and w as in the catalogue
    ("constant"), scaled to w(0) = 1 ("value at the origin"), to unit integral in 1D, to a leading
    (1 − q)^m, or to whole coefficients. The most plausible comes first.

    >>> identify("16/pi").candidates[0].kernel
    'cubic-spline'

    Raises ValueError for a text that is not a constant, and for zero or a negative one.
    """
    read = constant(text)
    value = number(read.value)
    if not value > 0:
        raise ValueError(f"constant: got {read.text!r}, expected a positive number")
    error = float(read.error)
    if read.value.is_Rational and not error and "." in text:
        digits = len(text.split("e")[0].strip("0.").replace(".", "")) or 1
        error = 0.5 * 10.0 ** -(digits - 1) if digits > 3 else 0.0
    form = recognise(value, error) if read.value.is_Rational else read.value
    everything = known_constants()
    given = exact(read.value if error == 0 or form is None else form)
    plain = float(value)
    near_by = sum(1 for k in everything if plain < math.e * k.value < math.e**2 * plain)
    found = [
        Candidate(k.kernel, k.dim, k.convention, k.form, k.expression(), Integer(1), True, k.bits)
        for k in everything
        if abs(plain / k.value - 1) < 2 * error + 1e-13 and _agrees(k, value, error, given)
    ]
    if not found:
        found = _near(everything, value, error, given)
    if read.power_of_h is not None:  # 1/(pi*h^3) says its dimension
        found = [c for c in found if c.dim == -read.power_of_h] or found
    found.sort(key=lambda c: c.bits)
    if found and found[0].match and form is None:
        form = found[0].exact
    return Identification(read.text, float(value), form, tuple(found[:most]), near_by * error)


def _agrees(known: Known, value: Any, error: float, given: Exact | None) -> bool:
    if not abs(float(value) / known.value - 1) <= max(error, 1e-14) * 1.001:
        return False
    if known.exact is None or (error and given is None):
        return True
    if error:
        return given == known.exact or abs(float(value) / known.value - 1) <= error
    if given is not None:
        return given == known.exact
    with mpmath.workdps(DIGITS):
        return bool(abs(value / known.exact.value() - 1) < mpmath.mpf(10) ** (5 - DIGITS))


def _near(
    everything: tuple[Known, ...], value: Any, error: float, given: Exact | None
) -> list[Candidate]:
    """The constants of which the number is a simple multiple, one for each kernel and dimension."""
    best: dict[tuple[str, int], tuple[float, Known, Exact | float]] = {}
    # a resemblance says less than the number itself does, or it says nothing
    own = inf if given is None else log2(given.factor.numerator * given.factor.denominator)
    most = min(NEAR_BITS, own - 0.4)
    for known in everything:
        odd, ratio = _ratio(known, value, error, given)
        if odd > most:
            continue
        bits = odd + known.bits
        key = (known.kernel, known.dim)
        if key not in best or bits < best[key][0]:
            best[key] = bits, known, ratio
    ranked = sorted(best.values(), key=lambda row: row[0])[:NEAREST]
    return [
        Candidate(
            known.kernel,
            known.dim,
            known.convention,
            known.form,
            known.expression(),
            ratio.expression() if isinstance(ratio, Exact) else ratio,
            False,
            bits,
        )
        for bits, known, ratio in ranked
        if bits <= ranked[0][0] + WORSE_BITS
    ]


def _ratio(
    known: Known, value: Any, error: float, given: Exact | None
) -> tuple[float, Exact | float]:
    """How remarkable number/constant is, in bits, and the ratio."""
    none = (inf, 0.0)
    if given is not None and known.exact is not None:
        ratio = given * known.exact.inverse()
        if ratio.square != 1 or abs(ratio.halves) > 4:
            return none
        odd = resemblance(ratio.factor, ratio.halves)
        if given.halves == known.exact.halves and slip_of_pen(given.factor, known.exact.factor):
            odd = min(odd, PEN_BITS)
        return odd, ratio
    plain = float(value) / known.value
    if given is not None or abs(plain - 1) > 0.05:
        return none
    simple = recognise(plain, max(error, 1e-14))
    of = exact(simple) if simple is not None else None
    if of is not None:
        return resemblance(of.factor, of.halves), of
    return (NEAR_BITS, plain) if abs(plain - 1) < 1e-3 else none
