"""Text and files to kernels: a grammar into exact polynomials; nothing is evaluated as code."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from re import findall
from typing import TYPE_CHECKING, Any

from sympy import QQ, Poly, Rational

from sphtrunc.kernels import catalogue, gaussian
from sphtrunc.kernels.arguments import rational
from sphtrunc.kernels.gaussian import Gaussian
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import q

if TYPE_CHECKING:
    from lark import Lark

MAX_LENGTH = 4096  # characters of a formula
MAX_NESTING = 64
MAX_DEGREE = 64
MAX_DIGITS = 1000  # of a number as it is written
MAX_BITS = 4096  # numerator and denominator of a coefficient: about 1,200 digits
MAX_PIECES = 32
MAX_FILE = 1 << 20  # bytes

_GRAMMAR = r"""
    ?start: pieces | sum
    pieces: piece (";" piece)* ";"?
    piece: sum ".." sum ":" sum
    sum: SIGN? product (SIGN product)*
    product: signed (OPERATOR signed)*
    signed: SIGN* power
    power: atom (_POWER WHOLE)?
    ?atom: "q" -> variable
        | (WHOLE | DECIMAL) -> number
        | "(" sum ")"
        | "pos" "(" sum ")" -> positive
    SIGN: "+" | "-"
    OPERATOR: "*" | "/"
    _POWER.2: "**" | "^"
    WHOLE: /[0-9]+/
    DECIMAL.2: /[0-9]*\.[0-9]+/
    %ignore /[ \t\r\n]+/
"""


def kernel(spec: Kernel | Gaussian | str) -> Kernel:
    """The kernel that a text names or describes; a Kernel passes through.

    A name of the catalogue (`cubic-spline`, `b-spline:7`, `polynomial:4`), a Gaussian (`gaussian`,
    `gaussian:3`, `super-gaussian`; see `sphtrunc.kernels.gaussian`), pieces
    ('0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4'), truncated powers
    ('pos(2-q)^3 - 4*pos(1-q)^3'), or the path of a .toml or .json file with `knots` and `pieces`.

    >>> kernel("pos(2-q)^3 - 4*pos(1-q)^3").normalisation(1)
    1/6

    Raises ValueError, in one line that says what to do, for anything else.
    """
    if isinstance(spec, (Kernel, Gaussian)):
        return spec  # type: ignore[return-value]
    if not isinstance(spec, str):
        raise ValueError(f"kernel: got {type(spec).__name__}, expected a Kernel or a text")
    text = spec.strip()
    if not text:
        raise ValueError("kernel: got an empty text, expected a name, a formula or a file")
    if Path(text[:MAX_LENGTH]).suffix.lower() in (".toml", ".json"):
        return from_file(Path(text))
    words = set(findall("[A-Za-z]+", text[:MAX_LENGTH]))
    if words <= {"q", "pos"} or ".." in text or any(c in text for c in "()*/^+;="):
        return formula(text)
    smooth = gaussian.named(text) if "gaussian" in text.lower() else None
    return catalogue.named(text) if smooth is None else smooth  # type: ignore[return-value]


def definition(spec: Kernel | Gaussian | str) -> list[Any]:
    """What a kernel is, not how it was called, for a fingerprint: its file may change. Name, knots
    and the coefficients of its pieces, as texts."""
    found = kernel(spec)
    coefficients = getattr(found, "coefficients", None)
    pieces = [] if coefficients is None else coefficients()
    knots = [str(k) for k in found.knots]
    return [found.name, knots, [[str(c) for c in piece] for piece in pieces]]


def formula(text: str, name: str = "custom", source: str = "") -> Kernel:
    """The kernel of a formula in pieces or in truncated powers (see `kernel`)."""
    tree = _parse(text)
    if tree[0] == "pieces":
        return _from_pieces(tree[1], name, source)
    return _from_powers(tree, name, source)


def from_file(path: Path) -> Kernel:
    """The kernel of a TOML or JSON file: name, source, knots and pieces.

    `knots` is a list of rationals, `pieces` a list with, for each interval, a polynomial in q as
    text or its coefficients, lowest degree first. Decimals are taken as exact decimals.

    Raises ValueError for a file that cannot be read or does not say that.
    """
    shown = str(path) if len(str(path)) <= 200 else str(path)[:200] + "..."
    shown = shown if shown.isprintable() else ascii(shown)
    try:
        content = path.read_bytes() if path.is_file() and path.stat().st_size <= MAX_FILE else None
        size = path.stat().st_size
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(
            f"kernel file {shown}: {reason}; expected the path of a readable file"
        ) from None
    if size > MAX_FILE:
        raise ValueError(f"kernel file {shown}: {size} bytes, expected at most {MAX_FILE}")
    if content is None:
        raise ValueError(f"kernel file {shown}: not a file, expected a TOML or JSON file")
    try:
        data = _loaded(content.decode(), path.suffix.lower())
    except RecursionError:
        raise ValueError(f"kernel file {shown}: nested too deeply, expected plain lists") from None
    except ValueError as error:
        raise ValueError(
            f"kernel file {shown}: malformed, {error}; expected {path.suffix[1:].upper()} in UTF-8"
        ) from None
    if not isinstance(data, dict):
        raise ValueError(f"kernel file {shown}: a list, expected an object with knots and pieces")
    unknown = sorted(set(data) - {"name", "source", "knots", "pieces"})
    if unknown:
        raise ValueError(
            f"kernel file {shown}: unknown key {unknown[0]!r},"
            " expected name, source, knots and pieces"
        )
    knots, pieces = data.get("knots"), data.get("pieces")
    if not isinstance(knots, list) or not isinstance(pieces, list):
        raise ValueError(f"kernel file {shown}: expected a list of knots and a list of pieces")
    if len(pieces) > MAX_PIECES:
        raise ValueError(
            f"kernel file {shown}: {len(pieces)} pieces, expected at most {MAX_PIECES}"
        )
    name, source = data.get("name", path.stem), data.get("source", "")
    if not isinstance(name, str) or not isinstance(source, str):
        raise ValueError(f"kernel file {shown}: name and source: expected texts")
    exact = [_number(k, f"kernel file {shown}: knots") for k in knots[: MAX_PIECES + 2]]
    return Kernel(exact, [_file_piece(p, shown) for p in pieces], name=name, source=source)


def _loaded(text: str, suffix: str) -> Any:
    """TOML or JSON with its decimals, and JSON's integers, as the texts that they are."""
    if suffix == ".toml":
        return tomllib.loads(text, parse_float=str)
    return json.loads(text, parse_float=str, parse_int=str, parse_constant=str)


def _file_piece(piece: object, shown: str) -> Poly:
    if isinstance(piece, str):
        tree = _parse(piece)
        if tree[0] != "pieces":
            return _expand(tree, None)
    if isinstance(piece, list):
        if len(piece) > MAX_DEGREE + 1:
            raise ValueError(
                f"kernel file {shown}: a piece of degree {len(piece) - 1}, expected at most"
                f" {MAX_DEGREE}"
            )
        exact = [_number(c, f"kernel file {shown}: pieces") for c in piece]
        return Poly(list(reversed(exact)) or [0], q, domain=QQ)
    raise ValueError(
        f"kernel file {shown}: pieces: expected a polynomial in q as text, or its coefficients"
    )


def _from_pieces(items: Sequence[Any], name: str, source: str) -> Kernel:
    _check_pieces(len(items))
    knots: list[Rational] = []
    polynomials = []
    for _, low, high, body in items:
        a, b = (_constant(bound) for bound in (low, high))
        if knots and knots[-1] != a:
            raise ValueError(
                f"kernel: a piece ends at {knots[-1]} and the next starts at {a}; "
                "expected pieces that follow each other"
            )
        knots = [*(knots or [a]), b]
        polynomials.append(_expand(body, None))
    return Kernel(knots, polynomials, name=name, source=source)


def _from_powers(tree: Any, name: str, source: str) -> Kernel:
    ends = sorted({Rational(0), *_truncations(tree)})
    _check_pieces(len(ends) - 1)
    if len(ends) < 2:
        raise ValueError(
            "kernel: a formula must say where it ends:"
            " write '0..2: (2-q)^3' or truncated powers such as 'pos(2-q)^3'"
        )
    middles = [(a + b) / 2 for a, b in pairwise(ends)]
    if not _expand(tree, ends[-1] + 1).is_zero:
        raise ValueError(
            f"kernel: the formula does not vanish beyond its last knot {ends[-1]};"
            " expected truncated powers such as pos(2-q)"
        )
    return Kernel(ends, [_expand(tree, m) for m in middles], name=name, source=source)


def _truncations(tree: Any) -> list[Rational]:
    """The positive points at which the pos(…) of a formula change sign."""
    if not isinstance(tree, tuple):
        return []
    if tree[0] == "positive":
        inner = _linear(tree[1])
        root = -inner.nth(0) / inner.nth(1)
        return [root] if root > 0 else []
    return [root for child in tree[1:] for root in _truncations(child)]


def _constant(tree: Any) -> Rational:
    value = _expand(tree, None)
    if value.degree() > 0:
        raise ValueError("kernel: a knot contains q, expected a rational number")
    return value.nth(0)


def _expand(tree: Any, at: Rational | None) -> Poly:
    """The polynomial of a syntax tree; pos(…) is resolved by its sign at the point `at`."""
    match tree:
        case ("number", text):
            return Poly(_number(text, "kernel"), q, domain=QQ)
        case ("variable",):
            return Poly(q, q, domain=QQ)
        case ("positive", inner):
            if at is None:
                raise ValueError(
                    "kernel: pos(...) in a piece or another pos(...), expected a polynomial there"
                )
            value = _linear(inner)
            return value if value.eval(at) > 0 else Poly(0, q, domain=QQ)
        case ("sum", *signed):
            total = Poly(0, q, domain=QQ)
            for sign, term in signed:
                value = _expand(term, at)
                total = total + value if sign == "+" else total - value
            return _capped(total)
        case ("product", first, *rest):
            product = _expand(first, at)
            for operator, factor in rest:
                value = _expand(factor, at)
                if operator == "*":
                    _check_degree(max(product.degree(), 0) + max(value.degree(), 0))
                    product = _capped(product * value)
                elif value.degree() > 0:
                    raise ValueError("kernel: division by an expression in q, expected a number")
                elif value.is_zero:
                    raise ValueError("kernel: division by zero, expected another number")
                else:
                    product = _capped(product * Poly(1 / value.nth(0), q, domain=QQ))
            return product
        case ("power", base, exponent):
            value = _expand(base, at)
            if len(exponent) > 4 or int(exponent) > MAX_DEGREE:
                raise ValueError(
                    f"kernel: exponent {exponent[:20]}, expected a whole number up to {MAX_DEGREE}"
                )
            _check_degree(max(value.degree(), 0) * int(exponent))
            return _power(value, int(exponent))
    raise ValueError("kernel: unreadable formula, expected a polynomial in q")


@lru_cache(maxsize=1024)  # each pos(...) is met once for every piece
def _linear(inner: Any) -> Poly:
    value = _expand(inner, None)
    if value.degree() != 1:
        raise ValueError("kernel: pos(...) takes an expression linear in q, such as pos(2-q)")
    return value


@lru_cache(maxsize=1024)
def _power(base: Poly, exponent: int) -> Poly:
    """Factor by factor, so that the caps stop it before anything becomes large."""
    result = Poly(1, q, domain=QQ)
    for _ in range(exponent):
        result = _capped(result * base)
    return result


def _number(value: object, name: str) -> Rational:
    """The exact rational, within the cap."""
    if isinstance(value, str) and len(value) > MAX_DIGITS:
        raise ValueError(f"{name}: {len(value)} digits, expected at most {MAX_DIGITS}")
    exact = rational(value, name)
    _check_size(exact)
    return exact


def _check_pieces(number: int) -> None:
    if number > MAX_PIECES:
        raise ValueError(f"kernel: {number} pieces, expected at most {MAX_PIECES}")


def _check_size(c: Rational) -> None:
    if max(int(c.p).bit_length(), int(c.q).bit_length()) > MAX_BITS:
        raise ValueError(f"kernel: a coefficient too large, expected at most {MAX_BITS} bits")


def _check_degree(degree: int) -> None:
    if degree > MAX_DEGREE:
        raise ValueError(f"kernel: degree {degree}, expected at most {MAX_DEGREE}")


def _capped(value: Poly) -> Poly:
    for c in value.coeffs():
        _check_size(c)
    return value


def _parse(text: str) -> Any:
    """The syntax tree, as nested tuples; ValueError where the text is not a formula."""
    from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken

    if len(text) > MAX_LENGTH:
        raise ValueError(f"kernel: {len(text)} characters, expected at most {MAX_LENGTH}")
    if not text.isascii():
        odd = next(c for c in text if not c.isascii())
        raise ValueError(f"kernel: character {odd!r} (U+{ord(odd):04X}), expected plain ASCII")
    depth = deepest = 0
    for c in text:
        depth += (c == "(") - (c == ")")
        deepest = max(deepest, depth)
    if deepest > MAX_NESTING:
        raise ValueError(f"kernel: {deepest} nested parentheses, expected at most {MAX_NESTING}")
    try:
        return _parser().parse(text)
    except UnexpectedInput as error:
        at = error.pos_in_stream or 0
        kind = "character" if isinstance(error, UnexpectedCharacters) else "text"
        found = f"unexpected {kind} at {text[at : at + 12]!r}"
        if isinstance(error, UnexpectedToken) and error.token.type == "$END":
            found = "unfinished at the end"
        raise ValueError(
            f"kernel: {found}; a formula is made of q, rationals, + - * / ^ ( )"
            " and pos(...), as in '0..1: 1 - q^2/2; 1..2: (2-q)^2/2'"
        ) from None


@cache
def _parser() -> Lark:
    from lark import Lark, Transformer, v_args

    class ToTuples(Transformer):  # type: ignore[type-arg]
        """Builds the tree during the parse, so that no recursion depends on the text."""

        def pieces(self, children: list[Any]) -> Any:
            return ("pieces", children)

        def piece(self, children: list[Any]) -> Any:
            return ("piece", *children)

        def sum(self, children: list[Any]) -> Any:
            if isinstance(children[0], tuple):
                children = ["+", *children]
            signs, terms = [str(s) for s in children[::2]], children[1::2]
            if signs == ["+"]:
                return terms[0]
            return ("sum", *zip(signs, terms, strict=True))

        def product(self, children: list[Any]) -> Any:
            if len(children) == 1:
                return children[0]
            pairs = zip([str(o) for o in children[1::2]], children[2::2], strict=True)
            return ("product", children[0], *pairs)

        def signed(self, children: list[Any]) -> Any:
            negative = sum(str(s) == "-" for s in children[:-1]) % 2
            return ("sum", ("-", children[-1])) if negative else children[-1]

        def power(self, children: list[Any]) -> Any:
            return children[0] if len(children) == 1 else ("power", children[0], str(children[1]))

        @v_args(inline=True)
        def number(self, token: Any) -> Any:
            return ("number", str(token))

        @v_args(inline=True)
        def positive(self, inner: Any) -> Any:
            return ("positive", inner)

        def variable(self, _: list[Any]) -> Any:
            return ("variable",)

    return Lark(_GRAMMAR, parser="lalr", transformer=ToTuples(), maybe_placeholders=False)
