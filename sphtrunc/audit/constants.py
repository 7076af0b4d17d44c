"""Constants: reading one that somebody wrote, and recognising the exact form of a number.

A constant is read by a small grammar (numbers, pi, sqrt, + - * / ^) into an exact expression; a
decimal of five or more significant digits stands for every number that rounds to it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

import mpmath
from sympy import Expr, Integer, Rational, pi, sqrt

from sphtrunc.kernels import catalogue
from sphtrunc.kernels.kernel import Kernel

if TYPE_CHECKING:
    from lark import Lark

MAX_LENGTH = 200  # characters of a constant
MAX_EXPONENT = 64
MAX_BITS = 2048
ROUNDED_DIGITS = 5  # a decimal with so many significant digits was rounded by its author
DIGITS = 50  # working precision of comparisons

_GRAMMAR = r"""
    ?start: sum
    sum: SIGN? product (SIGN product)*
    product: power (OPERATOR power)*
    power: atom (_POWER exponent)?
    exponent: SIGN? NUMBER | "(" sum ")"
    ?atom: NUMBER -> number
        | ("pi" | "PI" | "Pi") -> pi
        | "sqrt" "(" sum ")" -> root
        | "(" sum ")"
    SIGN: "+" | "-"
    OPERATOR: "*" | "/"
    _POWER.2: "**" | "^"
    NUMBER: /([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,3})?/
    %ignore /[ \t]+/
"""


@dataclass(frozen=True)
class Constant:
    """An exact value and how far, relative to it, the number that was meant may lie from it."""

    value: Expr
    error: Fraction
    text: str


def constant(text: str) -> Constant:
    """The constant that a text says: '3/(359*pi)', '0.0026599711937', 'pi^(-3/2)'.

    >>> constant("3/(359*pi)").value
    3/(359*pi)

    Raises ValueError, in one line, for anything that is not such a text or is not finite.
    """
    from lark.exceptions import UnexpectedInput

    shown = repr(text if len(text) <= 40 else text[:37] + "...")
    if not text.strip() or len(text) > MAX_LENGTH or not text.isascii():
        raise ValueError(
            f"constant: got {shown}, expected plain text of 1 to {MAX_LENGTH} characters"
        )
    try:
        value, error = _value(_parser().parse(text))
    except UnexpectedInput:
        raise ValueError(
            f"constant: {shown} is not a number; write a decimal or an expression in pi,"
            " such as 3/(359*pi), 0.31831 or pi^(-3/2)"
        ) from None
    return Constant(value, error, text.strip())


def _value(tree: Any) -> tuple[Expr, Fraction]:
    """The exact value of a syntax tree and its relative error."""
    match tree:
        case ("number", token):
            decimal = Decimal(token)
            digits = decimal.as_tuple()
            rounded = "." in token and len(token.split("e")[0].strip("0.")) > ROUNDED_DIGITS
            exact = Rational(Fraction(decimal))
            ulp = Fraction(10) ** int(digits.exponent) / 2
            _capped(exact)
            if not rounded or not exact:
                return exact, Fraction(0)
            # a decimal of many digits was printed from a double, itself computed in doubles
            return exact, max(abs(ulp / Fraction(decimal)), Fraction(1, 2**51))
        case ("pi",):
            return pi, Fraction(0)
        case ("root", inner):
            value, error = _value(inner)
            if not value.is_positive:
                raise ValueError("constant: sqrt of something not positive")
            return sqrt(value), error / 2
        case ("power", base, exponent):
            value, error = _value(base)
            power, _ = _value(exponent)
            if not power.is_Rational or abs(power) > MAX_EXPONENT or power.q > MAX_EXPONENT:
                raise ValueError(
                    f"constant: exponents are rational, at most {MAX_EXPONENT} in size"
                )
            if not (value.is_positive or (power.is_Integer and value.is_nonzero)):
                raise ValueError("constant: a power of something not positive")
            return _capped(value**power), abs(Fraction(power.p, power.q)) * error
        case ("product", first, *rest):
            value, error = _value(first)
            for operator, factor in rest:
                other, more = _value(factor)
                if operator == "/" and not other.is_nonzero:
                    raise ValueError("constant: division by zero")
                value = _capped(value * other if operator == "*" else value / other)
                error += more
            return value, error
        case ("sum", *terms):
            total, absolute = Integer(0), mpmath.mpf(0)
            for sign, term in terms:
                value, error = _value(term)
                total = total + value if sign == "+" else total - value
                absolute += abs(number(value)) * mpmath.mpf(error.numerator) / error.denominator
            size = abs(number(total))
            if not size:
                return Integer(0), Fraction(0)
            return _capped(total), Fraction(float(absolute / size))
    raise ValueError("constant: unreadable")


def _capped(value: Expr) -> Expr:
    for part in value.atoms(Rational):
        if max(int(part.p).bit_length(), int(part.q).bit_length()) > MAX_BITS:
            raise ValueError(f"constant: a number of more than {MAX_BITS} bits")
    return value


def number(value: Expr) -> Any:
    """The value of an exact expression as an mpmath number of 50 digits."""
    with mpmath.workdps(DIGITS):
        return mpmath.mpf(value.evalf(DIGITS + 5))


def simplest_between(low: Fraction, high: Fraction) -> Fraction:
    """The fraction of least denominator in [low, high] (Stern–Brocot).

    >>> simplest_between(Fraction(333, 1000), Fraction(334, 1000))
    Fraction(1, 3)
    """
    if low > high:
        raise ValueError(f"low: got {low} > {high}")
    if low <= 0 <= high:
        return Fraction(0)
    if high < 0:
        return -simplest_between(-high, -low)
    whole = low.__floor__()
    if whole == low:
        return Fraction(whole)
    if whole + 1 <= high:
        return Fraction(whole + 1)
    return whole + 1 / simplest_between(1 / (high - whole), 1 / (low - whole))


def significance(found: Fraction, half_width: Fraction) -> float:
    """About how many fractions as simple as `found` a random interval of that width contains.

    Fractions of denominator up to q are 1/q² apart: a value far below one is no coincidence.
    """
    return float(2 * half_width * found.denominator**2)


def recognise(value: Any, error: float) -> Expr | None:
    """The rational multiple of a power of pi that a number is, or None.

    value: an mpmath number, a float or a Fraction; error: its relative error. The form is accepted
    only where less than one random number in a thousand would have one as simple.
    """
    best: tuple[float, Expr] | None = None
    with mpmath.workdps(DIGITS):
        for halves in (0, -2, 2, -1, -3, 4, -4, 1, 3):
            scaled = mpmath.mpf(value) / mpmath.pi ** (mpmath.mpf(halves) / 2)
            exact = Fraction(int(mpmath.nint(scaled * 2**150)), 2**150)
            width = abs(exact) * Fraction(max(error, 2.0**-120))
            found = simplest_between(exact - width, exact + width)
            chance = significance(found, width) * (1 + abs(halves))
            if found and chance < 1e-3 and (best is None or chance < best[0]):
                form = Rational(found.numerator, found.denominator) * pi ** Rational(halves, 2)
                best = (chance, form)
    return best[1] if best else None


@dataclass(frozen=True)
class Candidate:
    """A constant that the catalogue derives, beside the number that was asked about.

    ratio: number / constant, exact where it has a simple form; match: they agree within the digits.
    """

    kernel: str
    dim: int
    convention: str
    meaning: str
    exact: Expr
    ratio: Expr | float
    match: bool


@dataclass(frozen=True)
class Identification:
    """What a number is: its exact form, if it has one, and the constants equal or near to it."""

    text: str
    value: float
    form: Expr | None
    candidates: tuple[Candidate, ...]

    def to_dict(self) -> dict[str, Any]:
        return {
            "schema": "sphtrunc.identify/1",
            "text": self.text,
            "value": self.value,
            "form": None if self.form is None else str(self.form),
            "candidates": [
                {**vars(c), "exact": str(c.exact), "ratio": str(c.ratio)} for c in self.candidates
            ],
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
                else f"  near  {c.exact}: {what}; ratio {c.ratio}"
            )
        return "\n".join(lines)


def identify(text: str, most: int = 12) -> Identification:
    """Recognise a kernel's constant: which kernel, dimension and convention it belongs to.

    Constants are those of W = c h^{-d} w(r/h) with w as in the catalogue ("constant") or scaled to
    w(0) = 1 ("value at the origin") or to unit integral in 1D; h is the
    catalogue's smoothing length or the support radius.

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
    rows = []
    for name, dim, convention, meaning, exact in known_constants():
        with mpmath.workdps(DIGITS):
            ratio = value / number(exact)
            match = bool(abs(ratio - 1) <= max(error, 1e-40))
            near = float(abs(ratio - 1))
        exactly = read.value if error == 0 else form
        found = Integer(1) if match else None
        if found is None and exactly is not None:
            found = _rational_times_pi(exactly / exact)
        elif found is None:
            found = recognise(ratio, error)
        height = _height(found)
        if match or height <= 64 or (near < 0.05 and height <= 10**6) or near < 1e-3:
            shown = float(ratio) if found is None else found
            odd = 0.0 if match else min(near, 1.0) * 100 + height / 1e3
            rows.append((odd, Candidate(name, dim, convention, meaning, exact, shown, match)))
    rows.sort(key=lambda row: row[0])
    if any(c.match for _, c in rows):
        rows = [row for row in rows if row[1].match]
    return Identification(read.text, float(value), form, tuple(c for _, c in rows[:most]))


def _rational_times_pi(value: Expr | None) -> Expr | None:
    """The value itself if it is a rational times a power of pi."""
    if value is None:
        return None
    rest = value / value.as_coeff_Mul()[0]
    return value if rest == 1 or rest == pi or (rest.is_Pow and rest.base == pi) else None


def _height(value: Expr | None) -> float:
    """How complicated the factor is: numerator times denominator, 8 for each power of pi."""
    if value is None:
        return float("inf")
    factor, rest = value.as_coeff_Mul()
    return float(abs(factor.p) * factor.q) * (1 if rest == 1 else 8)


@cache
def known_constants() -> tuple[tuple[str, int, str, str, Expr], ...]:
    """(kernel, dim, convention, meaning, exact constant) of everything in the catalogue."""
    return tuple(_known())


def _known() -> Iterator[tuple[str, int, str, str, Expr]]:
    seen: dict[Kernel, str] = {}
    for name in catalogue.names():
        kernel = catalogue.named(name)
        if kernel in seen:
            continue
        seen[kernel] = name
        top = kernel.pieces[0].eval(0)
        for dim in (1, 2, 3):
            sigma = kernel.normalisation(dim)
            for convention, factor in (
                (f"support {kernel.support}h", Integer(1)),
                ("support 1h", kernel.support**dim),
            ):
                if convention == "support 1h" and kernel.support == 1:
                    continue
                yield name, dim, convention, "constant", sigma * factor
                if dim > 1 and kernel.normalisation(1) != 1:
                    unit = sigma * factor / kernel.normalisation(1)
                    yield name, dim, convention, "constant for a shape of unit 1D integral", unit
                if top != 1:
                    yield name, dim, convention, "value at the origin", sigma * factor * top
    for dim in (1, 2, 3):
        yield "gaussian", dim, "exp(-q^2)", "constant", pi ** Rational(-dim, 2)
    for dim, exact in (
        (1, Rational(1, 6)),
        (2, pi / (3 * pi**2 - 16)),
        (3, pi / (4 * pi**2 - 30)),
    ):
        yield "double-cosine", dim, "support 1h", "constant", exact


@cache
def _parser() -> Lark:
    from lark import Lark, Transformer

    class ToTuples(Transformer):  # type: ignore[type-arg]
        def sum(self, children: list[Any]) -> Any:
            if isinstance(children[0], tuple):
                children = ["+", *children]
            signs, terms = [str(s) for s in children[::2]], children[1::2]
            return terms[0] if signs == ["+"] else ("sum", *zip(signs, terms, strict=True))

        def product(self, children: list[Any]) -> Any:
            if len(children) == 1:
                return children[0]
            pairs = zip([str(o) for o in children[1::2]], children[2::2], strict=True)
            return ("product", children[0], *pairs)

        def power(self, children: list[Any]) -> Any:
            return children[0] if len(children) == 1 else ("power", *children)

        def exponent(self, children: list[Any]) -> Any:
            if isinstance(children[-1], tuple):
                return children[-1]
            term = ("number", str(children[-1]))
            return ("sum", ("-", term)) if str(children[0]) == "-" else term

        def number(self, children: list[Any]) -> Any:
            return ("number", str(children[0]))

        def pi(self, _: list[Any]) -> Any:
            return ("pi",)

        def root(self, children: list[Any]) -> Any:
            return ("root", children[0])

    return Lark(_GRAMMAR, parser="lalr", transformer=ToTuples(), maybe_placeholders=False)
