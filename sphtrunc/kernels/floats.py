"""Floating-point values of a piecewise polynomial: the one place where exact numbers become floats.

Each piece is cut at its real roots and expanded about the end c of a part where it vanishes, else
about the outer end: p(c − t) = t^m r(t), from exact coefficients that are rounded once. Where the
roundings of Horner's rule for r, of t and of t^m could add up to more than 4u of the value (8u
above degree 11; u = 2^-53), t^m is carried as a compensated product (Graillat 2009,
doi:10.1109/TC.2008.215), and where that is not enough the part is cut in half. Terms below 2^-62
of r(0) are dropped. A float32 argument is evaluated in float64 and rounded once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from mpmath import mp, workdps
from sympy import Poly, Rational

from sphtrunc.arithmetic.summation import two_product, two_sum

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from sphtrunc.kernels.kernel import Kernel

_BLOCK = 8192  # points at a time: the handful of arrays of a block stay in the first caches
_DEPTH = 32  # cuts of a piece; more than a few only next to roots outside it
_DIGITS = 60
_ROOT_WIDTH = Rational(1, 2**160)


@dataclass(frozen=True)
class Power:
    """The factor t^m of a part: (scale·t)^m, whose scale the coefficients of r already contain.

    scale is the power of two that makes |r(0)| at most 1, so that t^m is not lost to underflow
    where the value is not; rest is what the two floats of the centre leave of it.
    """

    exponent: int
    scale: float
    compensated: bool
    rest: float


@dataclass(frozen=True)
class Table:
    """Local expansions of one piecewise polynomial, ready for arrays.

    breaks: (n,) largest float not beyond the outer end of each part, increasing
    centre, centre_low: (n+1,) the point c of expansion as an unevaluated sum of two floats
    coefficients: (degree+1, n+1) of r(t), t = c − q; the last column is the zero outside
    powers: (n,) the t^m of each part
    knots: exactly representable knots at which the function jumps, with the mean of both sides
    """

    breaks: NDArray[np.float64]
    centre: NDArray[np.float64]
    centre_low: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    powers: tuple[Power, ...]
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
def tabulate(kernel: Kernel, dim: int, derivative: int) -> Table:
    """The table of σ_d w^{(derivative)}(q)."""
    pieces, parts = _expanded(kernel, derivative)
    centre = np.array([float(part.centre) for part in parts])
    centre_low = np.array([float(part.centre - _exact(float(part.centre))) for part in parts])
    coefficients = np.zeros((max(len(part.r) for part in parts), len(parts) + 1))
    powers, means = [], []
    with workdps(_DIGITS):
        sigma = mp.mpf(1) / ({1: 2, 2: 2 * mp.pi, 3: 4 * mp.pi}[dim] * _mp(kernel._mass(dim)))
        for column, part in enumerate(parts):
            m, r = part.multiplicity, part.r
            rest = float(part.centre - _exact(centre[column]) - _exact(centre_low[column]))
            size = mp.frexp(sigma * _mp(r[0]))[1]  # |r(0)| <= 2^size
            shift = -(-size // m) if m and r[0] else 0
            powers.append(Power(m, 2.0**shift, part.compensated, rest))
            for row, c in enumerate(r):
                coefficients[row, column] = float(mp.ldexp(sigma * _mp(c), -m * shift))
        for i, knot in enumerate(kernel.knots[1:]):
            left = pieces[i].eval(knot)
            right = pieces[i + 1].eval(knot) if i + 1 < len(pieces) else Rational(0)
            if left != right and _is_float(knot):
                means.append((float(knot), float(sigma * _mp((left + right) / 2))))
    return Table(
        breaks=np.array([_below(part.end) for part in parts]),
        centre=np.append(centre, 0.0),
        centre_low=np.append(centre_low, 0.0),
        coefficients=coefficients,
        powers=tuple(powers),
        knots=tuple(means),
    )


def evaluate(table: Table, q: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """The tabulated function at q >= 0 (any shape, unchecked), in the precision of q."""
    result = np.empty(q.shape, dtype=q.dtype)
    flat_in, flat_out = q.reshape(-1), result.reshape(-1)
    for start in range(0, flat_in.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        flat_out[part] = _evaluate_block(table, flat_in[part].astype(np.float64, copy=False))
    return result


def _evaluate_block(table: Table, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """r(t) by Horner's rule, then times t^m."""
    index = np.searchsorted(table.breaks, q)
    t = table.centre[index]
    t -= q
    if table.centre_low.any():
        t += table.centre_low[index]
    t[index == len(table.breaks)] = 0  # also keeps an infinite q from becoming NaN
    rows = table.coefficients
    out: NDArray[np.float64] = rows[-1][index]
    for row in rows[-2::-1]:
        out *= t
        out += row[index]
    for part, power in enumerate(table.powers):
        if power.exponent:
            here = np.nonzero(index == part)[0]
            if here.size and power.compensated:
                high, low = two_sum(np.broadcast_to(table.centre[part], here.shape), -q[here])
                high, error = two_sum(high, table.centre_low[part])
                low += error + power.rest
                out[here] = _times_power(out[here], high, low, power)
            elif here.size:
                factor = power.scale * t[here]
                for _ in range(power.exponent):
                    out[here] *= factor
    for knot, mean in table.knots:
        out[q == knot] = mean
    return out


def _times_power(
    r: NDArray[np.float64], t: NDArray[np.float64], t_low: NDArray[np.float64], power: Power
) -> NDArray[np.float64]:
    """r·(scale·(t + t_low))^m, the power as an unevaluated sum of two arrays."""
    t, t_low = power.scale * t, power.scale * t_low
    high, low = t, t_low
    for bit in bin(power.exponent)[3:]:
        square, error = two_product(high, high)
        high, low = square, 2 * high * low + error
        if bit == "1":
            product, error = two_product(high, t)
            high, low = product, low * t + high * t_low + error
    return high * r + low * r


class Part(NamedTuple):
    """p(c − t) = t^m r(t) for q = c − t up to `end`."""

    end: Rational
    centre: Rational
    multiplicity: int
    r: list[Rational]
    compensated: bool


@lru_cache(maxsize=256)
def _expanded(kernel: Kernel, derivative: int) -> tuple[list[Poly], list[Part]]:
    """The derivative's pieces, and their parts from the inside out; the same in any dimension."""
    pieces = list(kernel.pieces)
    for _ in range(derivative):
        pieces = [p.diff() for p in pieces]
    parts = [
        part
        for a, b, piece in zip(kernel.knots, kernel.knots[1:], pieces, strict=False)
        for part in _parts(piece, a, b)
    ]
    return pieces, parts


def _parts(piece: Poly, a: Rational, b: Rational) -> list[Part]:
    """The parts of a piece on [a, b], from the inside out: between its real roots, cut to fit."""
    roots: dict[Rational, int] = {}
    if piece.degree() > 0:
        simple = piece.sqf_part()
        for (low, high), multiplicity in piece.intervals(inf=a, sup=b):
            roots[_root(simple, low, high)] = multiplicity
    marks = sorted({a, *roots, b})
    return [
        part for left, right in pairwise(marks) for part in _cut(piece, left, right, roots, _DEPTH)
    ]


def _root(simple: Poly, low: Rational, high: Rational) -> Rational:
    """The root between the two, where a polynomial without multiple roots changes sign."""
    rising = bool(simple.eval(high) > 0 or simple.eval(low) < 0)
    while high - low > _ROOT_WIDTH:
        middle = (low + high) / 2
        value = simple.eval(middle)
        if value == 0:
            return middle
        low, high = (low, middle) if (value > 0) == rising else (middle, high)
    return (low + high) / 2


def _cut(
    piece: Poly, a: Rational, b: Rational, roots: dict[Rational, int], depth: int
) -> list[Part]:
    """The parts of [a, b], which has no root of the piece inside."""
    centre, far = (a, b) if a in roots and b not in roots else (b, a)
    m = roots.get(centre, 0)
    local = list(reversed(piece.shift(centre).all_coeffs()))  # in powers of q − c = −t
    local[1::2] = [-c for c in local[1::2]]
    r = local[m:]
    width = _exact(float(centre - far))
    terms = [c * width**i for i, c in enumerate(r)]
    inexact = [bool(2 * a < b and centre != 0), not _is_float(centre)].count(True)  # in t
    # roundings, each at most u: (2 + inexact)i + 1 in the term i of r, and in t^m as follows
    allowed = 4 if piece.degree() <= 11 else 8
    plain, compensated = m * (1 + inexact), 2 if m else 0
    if depth and not _fits(terms, inexact, allowed - min(plain, compensated)):
        middle = Rational(float((a + b) / 2))
        if a < middle < b:
            return [
                *_cut(piece, a, middle, roots, depth - 1),
                *_cut(piece, middle, b, roots, depth - 1),
            ]
    tiny = abs(terms[0]) / 2**62
    while len(r) > 1 and abs(terms[-1]) * len(r) < tiny:
        r.pop()
        terms.pop()
    return [Part(b, centre, m, r, m > 1 and not _fits(terms, inexact, allowed - plain))]


def _fits(terms: list[Rational], inexact: int, allowed: int) -> bool:
    """Whether the roundings of Horner's rule stay below allowed·|r| on the part.

    It is so where Σ (allowed·c_i − ((2 + inexact)i + 1)|c_i|) t^i >= 0 (with c_0 > 0); for that the
    negative terms are taken at the far end and the positive ones, but the first, as 0.
    """
    sign = 1 if terms[0] > 0 else -1
    room = [allowed * sign * c - ((2 + inexact) * i + 1) * abs(c) for i, c in enumerate(terms)]
    return bool(room[0] + sum(c for c in room[1:] if c < 0) >= 0)


def _below(value: Rational) -> float:
    """The largest float not above the value."""
    near = float(value)
    return near if _exact(near) <= value else float(np.nextafter(near, -np.inf))


def _is_float(value: Rational) -> bool:
    return bool(_exact(float(value)) == value)


def _exact(value: float) -> Rational:
    return Rational(*value.as_integer_ratio())


def _mp(value: Rational) -> Any:
    return mp.mpf(int(value.p)) / int(value.q)
