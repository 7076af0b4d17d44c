"""Sums of floating-point numbers that know their own error: error-free transformations, compensated
and double-double sums, and the bounds that go with them.

Everything works elementwise on float64 arrays, rounding to nearest, without fused multiply-add.
``UNIT`` is the unit round-off u = 2⁻⁵³ and γ_n = n·u/(1 − n·u).

Sums run over axis 0, the neighbours, and are vectorised over the rest, the targets. They fold the
array in halves, ``x[i] + x[i + 2^m]``, the largest power of two first. This order depends on the
index of a term and on nothing else: zeros appended to a row leave its sum the same to the last bit,
whatever block it was summed in, and the depth of the tree, ⌈log₂ n⌉, takes the place of n in the
bounds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
DoubleDouble: TypeAlias = tuple[Array, Array]  # hi + lo, |lo| <= u |hi|

#: either precision; the error-free transformations are exact in both
Floats: TypeAlias = NDArray[np.floating[Any]]

UNIT = 2.0**-53
TINY = 2.0**-1074  # the smallest positive number: what a product may lose to underflow
_SPLITTER = {np.dtype(np.float64): 2.0**27 + 1.0, np.dtype(np.float32): 2.0**12 + 1.0}


def two_sum(a: Floats, b: Floats) -> tuple[Any, Any]:
    """s = fl(a + b) and the exact rest e: a + b = s + e (Knuth 1969; |a|, |b| in any order)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def fast_two_sum(a: Floats, b: Floats) -> tuple[Any, Any]:
    """s = fl(a + b) and the exact rest, for |a| >= |b| or a = 0 (Dekker 1971,
    doi:10.1007/BF01397083)."""
    s = a + b
    return s, b - (s - a)


def split(a: Floats) -> tuple[Any, Any]:
    """a = hi + lo, half of the bits each (Veltkamp 1968); overflows above |a| = 2⁹⁹⁶ (float64) or
    2¹¹⁵ (float32)."""
    t = a.dtype.type(_SPLITTER[a.dtype]) * a
    hi = t - (t - a)
    return hi, a - hi


def two_product(a: Floats, b: Floats) -> tuple[Any, Any]:
    """p = fl(a·b) and the exact rest e: a·b = p + e (Dekker 1971, doi:10.1007/BF01397083).

    In float64, exact as long as a, b stay below 2⁹⁹⁶ and the product above 2⁻⁹⁶⁹; below that the
    rest is off by at most a few ``TINY``.
    """
    p = a * b
    a_hi, a_lo = split(a)
    b_hi, b_lo = split(b)
    return p, a_lo * b_lo - (((p - a_hi * b_hi) - a_lo * b_hi) - a_hi * b_lo)


def gamma(n: int) -> float:
    """γ_n = n·u/(1 − n·u): the relative error bound of n roundings (Higham 2002, lemma 3.1),
    rounded up."""
    if not 0 <= n < 2**52:
        raise ValueError(f"gamma: n = {n} roundings; 0 <= n < 2**52 is allowed")
    return n * UNIT / (1.0 - n * UNIT) * (1.0 + 4.0 * UNIT)


def depth(n: int) -> int:
    """⌈log₂ n⌉, the number of additions that a term goes through when n terms are folded."""
    return (n - 1).bit_length() if n > 1 else 0


def _folds(n: int) -> Iterator[tuple[int, int]]:
    """(half, rest): rows half … half + rest − 1 are added to rows 0 … rest − 1."""
    while n > 1:
        half = 1 << (depth(n) - 1)
        yield half, n - half
        n = half


# ------------------------------------------------------------------------------- sums over axis 0


def total(x: Array) -> Array:
    """Σ_b x_b over axis 0 in working precision: error at most γ_L Σ|x_b|, L = ``depth(n)``.

    Shape (n, …) -> (…); an empty sum is 0.
    """
    n = x.shape[0]
    if n == 0:
        return np.zeros(x.shape[1:])
    if n == 1:
        return np.array(x[0])
    (half, rest), *folds = _folds(n)
    out = x[:half].copy()
    out[:rest] += x[half:]
    for half, rest in folds:
        out[:rest] += out[half : half + rest]
    return np.asarray(out[0])


def total_error(x: Array) -> Array:
    """Bound of |total(x) − Σ x_b|: u Σ |partial sums|, the running error analysis of the same tree
    (Wilkinson 1986; Higham 2002, §3.3). Far below γ_L Σ|x_b| when the terms cancel."""
    n = x.shape[0]
    bound = np.zeros(x.shape[1:])
    out = x.copy()
    for half, rest in _folds(n):
        out[:rest] += out[half : half + rest]
        bound += total(np.abs(out[:rest]))
    return np.asarray(bound * (UNIT * (1.0 + gamma(2 * depth(n) + 8))))


def compensated_total(hi: Array, lo: Array | None = None) -> DoubleDouble:
    """Σ_b (hi_b + lo_b) over axis 0, every rounding error of the hi tree collected in the lo tree.

    Returns the pair (hi, lo); round it with ``hi + lo``.
    """
    n = hi.shape[0]
    if n == 0:
        zero = np.zeros(hi.shape[1:])
        return zero, zero.copy()
    hi = hi.copy()
    lo = np.zeros_like(hi) if lo is None else lo.copy()
    for half, rest in _folds(n):
        s, e = two_sum(hi[:rest], hi[half : half + rest])
        hi[:rest] = s
        lo[:rest] += lo[half : half + rest] + e
    return fast_two_sum(hi[0], lo[0])


def dot(a: Array, b: Array) -> Array:
    """Σ_b a_b b_b over axis 0 in working precision; error at most γ_{L+1} Σ|a_b b_b| + n·TINY."""
    return total(a * b)


def compensated_dot(a: Array, b: Array) -> Array:
    """Σ_b a_b b_b over axis 0 as if in twice the working precision, then rounded once.

    Dot2 of Ogita, Rump & Oishi (2005, doi:10.1137/030601818) on the folded tree; error at most
    ``compensated_dot_error``.
    """
    hi, lo = compensated_total(*two_product(a, b))
    return np.asarray(hi + lo)


def dot_error(n: int, magnitude: Array) -> Array:
    """Bound of |dot(a, b) − Σ a_b b_b|; ``magnitude`` is Σ|a_b b_b| or more."""
    return np.asarray(gamma(depth(n) + 1) * magnitude + n * TINY)


def compensated_dot_error(n: int, value: Array, magnitude: Array) -> Array:
    """Bound of |compensated_dot(a, b) − Σ a_b b_b| = u|value| + γ_{2L} γ_{L+1} Σ|a_b b_b|.

    The errors collected sum up to at most γ_{L+1} Σ|a_b b_b| in magnitude, L from the tree and one
    from the products, and each goes through at most 2L additions on its way down the lo tree.
    """
    level = depth(n)
    second = gamma(2 * level + 1) * gamma(level + 2)
    return np.asarray(UNIT * np.abs(value) + second * magnitude + 8 * (n + 1) * TINY)


# ------------------------------------------------------------------------- double-double arithmetic
# Relative errors from Joldes, Muller & Popescu (2017, doi:10.1145/3121432), u = 2^-53:
# sum 3u^2/(1 - 4u), product 5u^2 (without FMA), quotient 10u^2.

DD_UNIT = 16.0 * UNIT**2  # bounds the relative error of each operation below


def dd(a: Array | float) -> DoubleDouble:
    """The pair (a, 0)."""
    a = np.asarray(a, dtype=np.float64)
    return a, np.zeros_like(a)


def dd_add(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """x + y, relative error below ``DD_UNIT`` also when they cancel."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = fast_two_sum(s, e + t)
    return fast_two_sum(s, e + f)


def dd_neg(x: DoubleDouble) -> DoubleDouble:
    """−x."""
    return -x[0], -x[1]


def dd_mul(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """x·y, relative error below ``DD_UNIT``."""
    p, e = two_product(x[0], y[0])
    return fast_two_sum(p, e + (x[0] * y[1] + x[1] * y[0]))


def dd_div(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """x/y, relative error below ``DD_UNIT``; y must not be 0."""
    q = x[0] / y[0]
    r = dd_add(x, dd_neg(dd_mul(dd(q), y)))
    q, e = fast_two_sum(q, r[0] / y[0])
    r = dd_add(x, dd_neg(dd_mul((q, e), y)))
    return fast_two_sum(q, e + r[0] / y[0])


def dd_sqrt(x: DoubleDouble) -> DoubleDouble:
    """√x for x >= 0, relative error below ``DD_UNIT``: one Newton step from the rounded root."""
    root = np.sqrt(x[0])
    r = dd_add(x, dd_neg(two_product(root, root)))
    safe = np.where(root > 0.0, root, 1.0)
    return fast_two_sum(root, np.where(root > 0.0, r[0] / (2.0 * safe), 0.0))


def dd_total(x: DoubleDouble) -> DoubleDouble:
    """Σ_b x_b over axis 0, folded like ``total``; error at most L·DD_UNIT·Σ|x_b|."""
    hi, lo = x[0].copy(), x[1].copy()
    n = hi.shape[0]
    if n == 0:
        zero = np.zeros(hi.shape[1:])
        return zero, zero.copy()
    for half, rest in _folds(n):
        hi[:rest], lo[:rest] = dd_add(
            (hi[:rest], lo[:rest]), (hi[half : half + rest], lo[half : half + rest])
        )
    return hi[0].copy(), lo[0].copy()


def dd_from_ratio(p: int, q: int) -> tuple[float, float]:
    """p/q to twice the working precision, both parts correctly rounded."""
    hi = p / q
    a, b = hi.as_integer_ratio()
    return hi, (p * b - a * q) / (q * b)
