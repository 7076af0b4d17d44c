"""Piecewise polynomials: pieces, steps at the knots, and the jumps of an even extension."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import factorial

from sympy import QQ, Poly, Rational, Symbol

from sphtrunc.kernels.arguments import _shown, rational

q = Symbol("q", nonnegative=True)


def polynomial(coefficients: Iterable[object], name: str = "coefficient") -> Poly:
    """The polynomial in q with the given rational coefficients, lowest degree first."""
    exact = [rational(c, name) for c in coefficients]
    return Poly(list(reversed(exact)) or [0], q, domain=QQ)


def _piece(piece: object) -> Poly:
    """A piece of a kernel over QQ, from a Poly or from its coefficients."""
    if isinstance(piece, Poly):
        if piece.gens == (q,) and (piece.domain.is_QQ or piece.domain.is_ZZ):
            return piece.set_domain(QQ)
    elif isinstance(piece, Iterable) and not isinstance(piece, str | bytes):
        return polynomial(piece, "pieces")
    raise ValueError(
        f"pieces: got {_shown(piece)}, expected rational coefficients, lowest degree first, or a"
        " Poly in sphtrunc.kernels.piecewise.q with such coefficients"
    )


def valuation(piece: Poly, point: Rational) -> int | float:
    """How often the polynomial vanishes at the point: 0 if it does not, inf for the zero one."""
    if piece.is_zero:
        return float("inf")
    count = 0
    while piece.eval(point) == 0:
        piece = piece.diff(q)
        count += 1
    return count


def steps(knots: Sequence[Rational], pieces: Sequence[Poly]) -> list[list[Rational]]:
    """Taylor coefficients of f(p + t) − f(p⁻ + t) in t at every knot p >= 0, with f(0⁻) = 0."""
    zero = Poly(0, q, domain=QQ)
    changes = [right - left for left, right in pairwise([zero, *pieces, zero])]
    return [list(reversed(s.shift(k).all_coeffs())) for k, s in zip(knots, changes, strict=True)]


def jumps(
    knots: Sequence[Rational], taylor: Sequence[Sequence[Rational]], parity: int
) -> list[dict[Rational, Rational]]:
    """Jumps of a piecewise polynomial: entry m holds those of the m-th derivative, knot -> jump.

    f is given by its `steps` at q >= 0 and continued by f(−s) = parity · f(s); then
    [f^{(m)}](−p) = −(−1)^m parity [f^{(m)}](p), and at the origin (1 − (−1)^m parity) f^{(m)}(0⁺).
    """
    orders = max(len(c) for c in taylor)
    line = [*(-knot for knot in knots[:0:-1]), *knots]
    none = Rational(0)  # most jumps are zero: nothing is multiplied for them
    result = []
    for m in range(orders):
        mirror = -parity * (-1) ** m
        right = [factorial(m) * c[m] if m < len(c) and c[m] else none for c in taylor]
        left = [mirror * jump if jump else none for jump in right[:0:-1]]
        right[0] *= 1 + mirror
        result.append(dict(zip(line, left + right, strict=True)))
    return result
