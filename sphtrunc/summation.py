"""Sums of floating-point numbers that know their own error: error-free transformations, compensated
and double-double sums, and the bounds that go with them.

Everything works elementwise on float64 arrays, rounding to nearest, without fused multiply-add.
``UNIT`` is the unit round-off u = 2⁻⁵³ and γ_n = n·u/(1 − n·u).

Sums run over axis 0, the neighbours, and are vectorised over the rest, the targets. They fold the
array in halves, ``x[i] + x[i + 2^m]``, the largest power of two first. This order depends on nothing
but the index of a term: zeros appended to a row leave its sum the same to the last bit, whatever
the block it was summed in, and the depth of the tree, ⌈log₂ n⌉, takes the place of n in the bounds.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
DoubleDouble: TypeAlias = tuple[Array, Array]  # hi + lo, |lo| <= u |hi|

UNIT = 2.0**-53
TINY = 2.0**-1074  # the smallest positive number: what a product may lose to underflow
_SPLITTER = 2.0**27 + 1.0


def two_sum(a: Array, b: Array) -> DoubleDouble:
    """s = fl(a + b) and the exact rest e: a + b = s + e (Knuth 1969; no order of |a|, |b| needed)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def fast_two_sum(a: Array, b: Array) -> DoubleDouble:
    """s = fl(a + b) and the exact rest, for |a| >= |b| or a = 0 (Dekker 1971,
    doi:10.1007/BF01397083)."""
    s = a + b
    return s, b - (s - a)


def split(a: Array) -> DoubleDouble:
    """a = hi + lo with at most 26 bits each (Veltkamp 1968); overflows above |a| = 2⁹⁹⁶."""
    t = _SPLITTER * a
    hi = t - (t - a)
    return hi, a - hi


def two_product(a: Array, b: Array) -> DoubleDouble:
    """p = fl(a·b) and the exact rest e: a·b = p + e (Dekker 1971, doi:10.1007/BF01397083).

    Exact as long as a, b stay below 2⁹⁹⁶ and the product above 2⁻⁹⁶⁹; below that the rest is off by
    at most a few ``TINY``.
    """
    p = a * b
    a_hi, a_lo = split(a)
    b_hi, b_lo = split(b)
    return p, a_lo * b_lo - (((p - a_hi * b_hi) - a_lo * b_hi) - a_hi * b_lo)
