"""Arguments that kernels and their users check: rationals, counts, dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from numbers import Integral

from sympy import Rational


def rational(value: object, name: str = "value") -> Rational:
    """The exact rational that `value` says: an int, a Fraction, a SymPy Rational or a string "p/q".

    A string may be a decimal ("0.7" is exactly 7/10). A float is refused, because it is not the
    number that its author wrote: 0.7 is 3152519739159347/4503599627370496.

    >>> rational("10/13"), rational("0.7")
    (10/13, 7/10)

    Raises ValueError for anything else.
    """
    if isinstance(value, Rational):
        return value
    if isinstance(value, Fraction):
        return Rational(value.numerator, value.denominator)
    if isinstance(value, Integral) and not isinstance(value, bool):
        return Rational(int(value))
    if isinstance(value, str):
        text = value.strip()
        if len(text) <= 1000 and text.isascii() and "_" not in text and "e" not in text.lower():
            try:
                fraction = Fraction(text)
            except (ValueError, ZeroDivisionError):
                pass
            else:
                return Rational(fraction.numerator, fraction.denominator)
    hint = ""
    if isinstance(value, float):
        simple = Fraction(value).limit_denominator(1000) if abs(value) < 1e9 else None
        hint = f'; a float is not exact: write "{simple}" or Fraction(...)' if simple else ""
    raise ValueError(
        f'{name}: got {_shown(value)}, expected a rational such as 3, "10/13" or "0.7"{hint}'
    )


def count(value: object, name: str) -> int:
    """`value` if it is a whole number n >= 0; ValueError otherwise."""
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 0:
        return int(value)
    raise ValueError(f"{name}: got {_shown(value)}, expected a whole number >= 0")


def dimension(dim: object) -> int:
    """`dim` if it is 1, 2 or 3; ValueError otherwise."""
    if isinstance(dim, Integral) and not isinstance(dim, bool) and 1 <= int(dim) <= 3:
        return int(dim)
    raise ValueError(f"dim: got {_shown(dim)}, expected 1, 2 or 3")


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _listed(values: Sequence[object], most: int = 6) -> str:
    shown = ", ".join(str(v) for v in values[:most])
    return f"[{shown}{', …' if len(values) > most else ''}]"
