"""Values of a kernel and its derivatives in every arithmetic."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.bounded import SLACK, Ball, Bounded
from sphtrunc.arithmetic.exact import DIGITS, Exact
from sphtrunc.arithmetic.extended import Extended, Pair, pair
from sphtrunc.arithmetic.summation import TINY, UNIT, Array

if TYPE_CHECKING:
    from sphtrunc.arithmetic.plain import Plain
    from sphtrunc.kernels.kernel import Kernel


def kernel_values(number: Any, kernel: Kernel, q: Any, derivative: int, dim: int) -> Any:
    """Ŵ^(derivative)(q) = σ_d w^(derivative)(q) in the arithmetic `number`, of whose numbers q is.

    At a knot where it jumps, the mean of both sides; at q = 0 the limit from outside.
    """
    if isinstance(number, Bounded):
        return _bounded(number.base, kernel, q, derivative, dim)
    if isinstance(number, Extended):
        return _extended(kernel, q, derivative, dim)
    if isinstance(number, Exact):
        return _exact(kernel, q, derivative, dim)
    return float_kernel(kernel, q, derivative, dim)


def _bounded(base: Plain, kernel: Kernel, q: Ball, derivative: int, dim: int) -> Ball:
    """The rounding of the evaluation, and the slope times the radius of q."""
    value = kernel_values(base, kernel, q.middle, derivative, dim)
    own = (8.0 if kernel.degree > 11 else 4.0) * SLACK * UNIT * np.abs(value) + TINY
    # ends a float further out: what is not known exactly may lie on either side of a knot
    some = q.radius > 0.0
    right = np.where(some, np.nextafter(q.middle + q.radius * SLACK, np.inf), q.middle)
    left = np.maximum(q.middle - q.radius * SLACK, 0.0)
    left = np.where(some, np.nextafter(left, 0.0), q.middle)
    slope = np.maximum(
        np.abs(float_kernel(kernel, left, derivative + 1, dim)),
        np.abs(float_kernel(kernel, right, derivative + 1, dim)),
    )
    curvature = _largest(kernel, derivative + 2, dim)
    own = own + 2.0**-77 * _largest(kernel, derivative, dim)  # for pairs: see FINER
    radius = own + q.radius * (slope * SLACK + curvature * (right - left))
    if jumps_anywhere(kernel, derivative):
        ends = (
            float_kernel(kernel, left, derivative, dim),
            float_kernel(kernel, right, derivative, dim),
        )
        radius = radius + SLACK * sum(np.abs(end - value) for end in ends)
    return Ball(value, radius)


def _extended(kernel: Kernel, q: Pair, derivative: int, dim: int) -> Pair:
    high = np.zeros_like(q.high)
    low = np.zeros_like(q.high)
    ends = _expansions(kernel, derivative, dim)
    place = np.searchsorted([float(end[0]) for end, _ in ends], q.high, side="left")
    for piece, (end, coefficients) in enumerate(ends):
        here = np.nonzero(place == piece)
        if not here[0].size:
            continue
        t = Pair(*end) - Pair(q.high[here], q.low[here])
        high[here], low[here] = _horner(coefficients, t)
    if jumps_anywhere(kernel, derivative):  # the mean of both sides
        for (end, rows), (_, beyond) in zip(ends, [*ends[1:], (None, [])], strict=True):
            here = np.nonzero((q.high == end[0]) & (q.low == end[1]))
            if here[0].size:
                t = Pair(*end) - Pair(q.high[here], q.low[here])
                left = Pair(*_horner(rows, t))
                right = pair(np.zeros_like(left.high))
                if beyond:
                    after = ends[[e[0] for e in ends].index(end) + 1][0]
                    right = Pair(*_horner(beyond, t + (Pair(*after) - Pair(*end))))
                mean = (left + right) * 0.5
                high[here], low[here] = mean.high, mean.low
    return Pair(high, low)


def _exact(kernel: Kernel, q: Any, derivative: int, dim: int) -> Any:
    """The exact polynomials; the mean of both sides at a knot, but at 0 the limit."""
    from mpmath import mp

    sigma = _mp_normalisation(kernel, dim)
    knots = [mp.mpf(int(k.p)) / int(k.q) for k in kernel.knots]
    rows = [
        [mp.mpf(int(c.p)) / int(c.q) for c in p.diff((p.gen, derivative)).all_coeffs()]
        for p in kernel.pieces
    ]

    def one(x: Any) -> Any:
        sides = [
            mp.polyval(row, x)
            for a, b, row in zip(knots, knots[1:], rows, strict=False)
            if a <= x <= b
        ]
        if not sides:
            return mp.mpf(0)
        if x in knots[1:] and len(sides) == 1:
            sides.append(mp.mpf(0))
        return sigma * sum(sides) / len(sides)

    return np.frompyfunc(one, 1, 1)(q)


def _horner(coefficients: Any, t: Pair) -> tuple[Any, Any]:
    value = pair(np.zeros_like(t.high))
    for c in coefficients:
        value = value * t + Pair(*c)
    return value.high, value.low


@lru_cache(maxsize=64)
def _expansions(kernel: Kernel, derivative: int, dim: int) -> Any:
    """Per piece: the outer end, and the coefficients in t = end − q, highest first, as pairs."""
    from mpmath import mp, workdps

    def split(x: Any) -> tuple[Any, Any]:
        high = float(x)
        return np.array(high), np.array(float(x - high))

    rows = []
    with workdps(DIGITS):
        sigma = _mp_normalisation(kernel, dim)
        for end, piece in zip(kernel.knots[1:], kernel.pieces, strict=True):
            local = piece.diff((piece.gen, derivative)).shift(end).all_coeffs()
            degree = len(local) - 1
            rows.append(
                (
                    split(mp.mpf(int(end.p)) / int(end.q)),
                    [
                        split(sigma * (-1) ** (degree - i) * mp.mpf(int(c.p)) / int(c.q))
                        for i, c in enumerate(local)
                    ],
                )
            )
    return rows


def _mp_normalisation(kernel: Kernel, dim: int) -> Any:
    """σ_d from its exact value, a rational or a rational over π."""
    from mpmath import mp
    from sympy import pi

    exact = kernel.normalisation(dim) * (1 if dim == 1 else pi)
    return mp.mpf(int(exact.p)) / int(exact.q) / (1 if dim == 1 else mp.pi)


def float_kernel(kernel: Kernel, q: Array, derivative: int, dim: int) -> Array:
    if derivative < 3:
        return np.asarray((kernel.w, kernel.dw, kernel.d2w)[derivative](q, dim), dtype=np.float64)
    from sphtrunc.kernels.floats import evaluate, tabulate

    return np.asarray(evaluate(tabulate(kernel, dim, derivative), q), dtype=np.float64)


@lru_cache(maxsize=128)
def jumps_anywhere(kernel: Kernel, derivative: int) -> bool:
    """Does the derivative jump at a knot other than the origin?"""
    return any(jump != 0 for knot, jump in kernel.jumps(derivative).items() if knot != 0)


@lru_cache(maxsize=128)
def _largest(kernel: Kernel, derivative: int, dim: int) -> float:
    """A bound of |σ w^(derivative)|: Σ|terms| of each piece about its ends."""
    from sympy import Abs

    sigma = float(kernel.normalisation(dim))
    most = 0.0
    for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.pieces, strict=False):
        for end in (a, b):
            local = piece.diff((piece.gen, derivative)).shift(end)
            most = max(most, float(sum(Abs(c) * (b - a) ** n for (n,), c in local.terms())))
    return abs(sigma) * most * SLACK
