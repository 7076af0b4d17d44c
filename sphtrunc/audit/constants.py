"""Constants: reading one that somebody wrote, and recognising the exact form of a number.

A constant is read by a small grammar (numbers, pi, sqrt, + - * / ^) into an exact expression; a
decimal of five or more significant digits stands for every number that rounds to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

import mpmath
from sympy import Expr, Integer, Rational, Symbol, pi, sqrt

if TYPE_CHECKING:
    from lark import Lark

MAX_LENGTH = 200  # characters of a constant
MAX_EXPONENT = 64
MAX_BITS = 2048
ROUNDED_DIGITS = 5  # a decimal with so many significant digits was rounded by its author
DIGITS = 50  # working precision of comparisons
_H = Symbol("h", positive=True)

_GRAMMAR = r"""
    ?start: sum
    sum: SIGN? product (SIGN product)*
    product: power (OPERATOR power)*
    power: atom (_POWER exponent)?
    exponent: SIGN? NUMBER | "(" sum ")"
    ?atom: NUMBER -> number
        | ("pi" | "PI" | "Pi") -> pi
        | "h" -> length
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
    """An exact value and how far, relative to it, the number that was meant may lie from it.

    power_of_h: of the smoothing length beside it, as in "1/(pi*h^3)"; None where there is none
    """

    value: Expr
    error: Fraction
    text: str
    power_of_h: Rational | None = None


def constant(text: str) -> Constant:
    """The constant that a text says: '3/(359*pi)', '0.0026599711937', 'pi^(-3/2)', '1/(pi*h^3)'.

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
    if not value.has(_H):
        return Constant(value, error, text.strip())
    rest, length = value.as_independent(_H)
    base, power = length.as_base_exp()
    if base != _H or not power.is_Rational:
        raise ValueError(f"constant: {shown}: h may only be a factor, as in 1/(pi*h^3)")
    return Constant(rest, error, text.strip(), power)


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
        case ("length",):
            return _H, Fraction(0)
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
                absolute += (
                    abs(number(value.subs(_H, 1))) * mpmath.mpf(error.numerator) / error.denominator
                )
            size = abs(number(total.subs(_H, 1)))
            if not size:
                return Integer(0), Fraction(0)
            return _capped(total), Fraction(float(absolute / size))
    raise ValueError("constant: unreadable")


def _capped(value: Expr) -> Expr:
    for part in value.atoms(Rational):
        if max(int(part.p).bit_length(), int(part.q).bit_length()) > MAX_BITS:
            raise ValueError(f"constant: a number of more than {MAX_BITS} bits")
    return value


def number(value: Any) -> Any:
    """The value of an exact expression, or of a number, as an mpmath number of 50 digits."""
    with mpmath.workdps(DIGITS):
        return mpmath.mpf(value.evalf(DIGITS + 5) if isinstance(value, Expr) else value)


def exact_or_float(value: float) -> Any:
    """The fraction of denominator up to 64 that a float is, or the float."""
    simple = Fraction(value).limit_denominator(64)
    if float(simple) == value:
        return Rational(simple.numerator, simple.denominator)
    return value


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


def slip_of_pen(wrong: Fraction, right: Fraction) -> tuple[int, int] | None:
    """The right and the wrong whole number, where two fractions differ by one of them alone.

    >>> slip_of_pen(Fraction(96, 1189), Fraction(96, 1199))
    (1199, 1189)
    """
    for a, b, c, d in (
        (right.numerator, right.denominator, wrong.numerator, wrong.denominator),
        (right.denominator, right.numerator, wrong.denominator, wrong.numerator),
    ):
        # over the same numerator, or under the same denominator, b became d
        if a % c == 0 and alike(b, d * (a // c)):
            return b, d * (a // c)
        if c % a == 0 and alike(b * (c // a), d):
            return b * (c // a), d
    return None


def alike(a: int, b: int) -> bool:
    """Whether whole numbers of two and more digits differ by one digit, a swap or a lost digit.

    >>> alike(1199, 1189), alike(478, 487), alike(12, 120), alike(19, 30)
    (True, True, True, False)
    """
    left, right = str(abs(int(a))), str(abs(int(b)))
    if len(left) == len(right):
        wrong = [i for i, (x, y) in enumerate(zip(left, right, strict=True)) if x != y]
        swapped = len(wrong) == 2 and wrong[1] == wrong[0] + 1 and left[wrong[0]] == right[wrong[1]]
        swapped = swapped and left[wrong[1]] == right[wrong[0]]
        return len(left) > 1 and (len(wrong) == 1 or swapped)
    short, long = sorted((left, right), key=len)
    return (
        len(short) > 1
        and len(long) - len(short) == 1
        and any(long[:i] + long[i + 1 :] == short for i in range(len(long)))
    )


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

        def length(self, _: list[Any]) -> Any:
            return ("length",)

        def root(self, children: list[Any]) -> Any:
            return ("root", children[0])

    return Lark(_GRAMMAR, parser="lalr", transformer=ToTuples(), maybe_placeholders=False)
