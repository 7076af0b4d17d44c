"""Floating-point values of a piecewise polynomial: the one place where exact numbers become floats.

Each piece [a, b] is expanded about its outer end, p(b − t) = t^m r(t), from exact coefficients that
are rounded once; where Horner's rule for r would lose digits, the piece is cut in half until its
roundings, Σ 2i|r_i| t^i in units of u, stay below 3|r| on each part. What is left is the rounding
error of t^m, which is carried as a compensated product from m = 4 on (Graillat 2009,
doi:10.1109/TC.2008.215). Terms below 2^-62 of r(0) are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.summation import two_product

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from sympy import Poly, Rational

    from sphtrunc.kernel import Kernel

_BLOCK = 8192  # points at a time: the handful of arrays of a block stay in the first caches
_DEPTH = 8  # a piece is cut into at most 2^8 parts; reached only next to a change of sign
_DIGITS = 60


@dataclass(frozen=True)
class Table:
    """Local expansions of one piecewise polynomial, ready for arrays.

    breaks: (n,) largest float not beyond the outer end of each part, increasing
    end, end_low: (n+1,) the outer end b of each part as an unevaluated sum of two floats
    coefficients: (degree+1, n+1) of r(t), t = b − q; the last column is the zero outside
    multiplicity: (n,) the m of t^m
    knots: exactly representable knots at which the function jumps, with the mean of both sides
    """

    breaks: NDArray[np.floating[Any]]
    end: NDArray[np.floating[Any]]
    end_low: NDArray[np.floating[Any]]
    coefficients: NDArray[np.floating[Any]]
    multiplicity: tuple[int, ...]
    knots: tuple[tuple[float, float], ...]


def checked(argument: ArrayLike) -> NDArray[np.floating[Any]]:
    """q as a float64 or float32 array; ValueError where it is negative, NaN or not real."""
    try:
        points = np.asarray(argument)
    except ValueError as error:
        raise ValueError(f"q: {error}; expected an array of numbers") from None
    if points.dtype not in (np.float64, np.float32):
        if points.dtype.kind not in "iuf":
            raise ValueError(f"q: got an array of type {points.dtype}, expected real numbers")
        points = points.astype(np.float64)
    if points.size and not points.min() >= 0:
        raise ValueError("q: got a negative value or NaN, expected distances q = r/h >= 0")
    return points


@lru_cache(maxsize=256)
def tabulate(kernel: Kernel, dim: int, derivative: int, dtype: str = "float64") -> Table:
    """The table of σ_d w^{(derivative)}(q) in the given precision."""
    from mpmath import mp, workdps
    from sympy import Rational

    real = np.dtype(dtype).type
    pieces = list(kernel.pieces)
    for _ in range(derivative):
        pieces = [p.diff() for p in pieces]
    parts = [
        part
        for a, b, piece in zip(kernel.knots, kernel.knots[1:], pieces, strict=False)
        for part in _cut(piece, a, b, dtype, _DEPTH)
    ]
    degree = max(len(r) for _, _, r in parts)
    with workdps(_DIGITS):
        sigma = mp.mpf(1) / (
            {1: 2, 2: 2 * mp.pi, 3: 4 * mp.pi}[dim] * _mp(kernel._mass(dim))  # noqa: SLF001
        )
        coefficients = np.zeros((degree, len(parts) + 1), dtype=real)
        for column, (_, _, r) in enumerate(parts):
            for row, c in enumerate(r):
                coefficients[row, column] = real(sigma * _mp(c))
        means = []
        for i, knot in enumerate(kernel.knots[1:]):
            left = pieces[i].eval(knot)
            right = pieces[i + 1].eval(knot) if i + 1 < len(pieces) else Rational(0)
            if left != right and Rational(float(real(float(knot)))) == knot:
                means.append((float(knot), float(sigma * _mp((left + right) / 2))))
    ends = [b for b, _, _ in parts]
    high = np.array([float(b) for b in ends], dtype=real)
    low = np.array([float(b - Rational(float(x))) for b, x in zip(ends, high, strict=True)], real)
    breaks = np.where(low < 0, np.nextafter(high, real(0)), high)
    pad = np.zeros(1, dtype=real)
    return Table(
        breaks=breaks,
        end=np.concatenate([high, pad]),
        end_low=np.concatenate([low, pad]),
        coefficients=coefficients,
        multiplicity=tuple(m for _, m, _ in parts),
        knots=tuple(means),
    )


def evaluate(table: Table, q: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """The tabulated function at q >= 0 (any shape, unchecked): r(t) by Horner, then t^m."""
    result = np.empty(q.shape, dtype=q.dtype)
    flat_in, flat_out = q.reshape(-1), result.reshape(-1)
    for start in range(0, flat_in.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        _evaluate_block(table, flat_in[part], flat_out[part])
    return result


def _evaluate_block(
    table: Table, q: NDArray[np.floating[Any]], out: NDArray[np.floating[Any]]
) -> None:
    outside = len(table.breaks)
    index = np.searchsorted(table.breaks, q)
    t = table.end[index]
    t -= q
    if table.end_low.any():
        t += table.end_low[index]
    t[index == outside] = 0  # also keeps an infinite q from becoming NaN
    rows = table.coefficients
    rows[-1].take(index, out=out, mode="clip")
    for row in rows[-2::-1]:
        out *= t
        out += row[index]
    for piece, m in enumerate(table.multiplicity):
        if m:
            here = np.nonzero(index == piece)[0]
            if here.size:
                power, low = _power(t[here], m)
                r = out[here]
                out[here] = power * r + low * r
    for knot, mean in table.knots:
        out[q == knot] = mean


def _power(
    t: NDArray[np.floating[Any]], m: int
) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]] | float]:
    """t^m as an unevaluated sum of two arrays: to one rounding from m = 4 on."""
    if m < 4:
        power = t.copy()
        for _ in range(m - 1):
            power *= t
        return power, 0.0
    power, low = t, np.zeros_like(t)
    for bit in bin(m)[3:]:
        square, error = two_product(power, power)
        low = 2 * power * low + error
        power = square
        if bit == "1":
            product, error = two_product(power, t)
            low = low * t + error
            power = product
    return power, low


def _cut(
    piece: Poly, a: Rational, b: Rational, dtype: str, depth: int
) -> list[tuple[Rational, int, list[Rational]]]:
    """Parts (outer end, multiplicity m, coefficients of r) of a piece, from the inside out."""
    from sympy import Rational

    local = list(reversed(piece.shift(b).all_coeffs()))  # in powers of q − b = −t
    local[1::2] = [-c for c in local[1::2]]
    m = next((i for i, c in enumerate(local) if c), 0)
    r = local[m:]
    width = b - a
    terms = [c * width**i for i, c in enumerate(r)]
    against = sum(abs(c) for c in terms if c * terms[0] < 0)
    roundings = sum(2 * i * abs(c) for i, c in enumerate(terms))
    if depth and roundings > 3 * (abs(terms[0]) - against):
        middle = Rational(float(np.dtype(dtype).type(float((a + b) / 2))))
        if a < middle < b:
            return [
                *_cut(piece, a, middle, dtype, depth - 1),
                *_cut(piece, middle, b, dtype, depth - 1),
            ]
    tiny = abs(terms[0]) / 2**62
    while len(r) > 1 and abs(terms[-1]) * len(r) < tiny:
        r.pop()
        terms.pop()
    return [(b, m, r)]


def _mp(value: Rational) -> Any:
    from mpmath import mp

    return mp.mpf(int(value.p)) / int(value.q)
