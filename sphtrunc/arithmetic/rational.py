"""Exact numbers from what people write, and floats as the fractions that they are."""

from __future__ import annotations

import re
from fractions import Fraction
from numbers import Rational
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array

#: a fraction, or a decimal with an exponent of at most three digits: a longer one fills the memory
_NUMBER = re.compile(r"\s*[+-]?(\d+/\d+|(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?)\s*\Z", re.ASCII)


def exact(value: object, name: str) -> Fraction:
    """The rational that a number or a text such as "10/13", "0.7" or "1e-8" says; a float is what
    it is.

    Raises ValueError for anything else, NaN and infinities included.
    """
    if getattr(value, "ndim", None) == 0 and hasattr(value, "item"):  # a number of NumPy's
        value = value.item()
    text_fits = not isinstance(value, str) or (len(value) <= 200 and bool(_NUMBER.match(value)))
    if isinstance(value, (str, Rational, float)) and not isinstance(value, bool) and text_fits:
        try:
            found = Fraction(value)
            float(found)
            return found
        except (ValueError, ZeroDivisionError, OverflowError):
            pass
    raise ValueError(f'{name}: got {str(value)[:60]!r}, expected a number such as 0.7 or "10/13"')


def fractions(values: Array) -> NDArray[Any]:
    """The floats as an array of Fractions."""
    import numpy as np

    return np.array([Fraction(v) for v in values.ravel().tolist()], dtype=object).reshape(
        values.shape
    )


def fraction(value: Any) -> Fraction:
    """A rational of SymPy, or anything with numerator p and denominator q, as a Fraction."""
    return Fraction(int(value.p), int(value.q))
