"""Periodic Bernoulli polynomials B̃_n(x) = B_n(x − ⌊x⌋), and what is left of them in a sum."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from sympy import Expr, Poly, Rational, Symbol, floor, radsimp
from sympy.polys.appellseqs import bernoulli_poly

_x = Symbol("x")


def periodic_bernoulli(n: int, x: Expr) -> Expr:
    """B̃_n(x), with B̃_1(integer) = 0."""
    x = fraction(x)
    if n == 1 and x == 0:
        return Rational(0)
    return _bernoulli(n).eval(x) if x.is_Rational else _bernoulli(n).as_expr().subs(_x, x)


@cache
def _bernoulli(n: int) -> Poly:
    return bernoulli_poly(n, _x, polys=True)


def phased(row: Mapping[Rational, Any], n: int, theta: Rational) -> dict[Rational, Any]:
    """Knot -> coefficient of B̃_n(p h/Δx − θ), as far as it is left at a generic ratio.

    For θ = 0 and ½ the knots ±p share a phase, B̃_n(−x) = (−1)^n B̃_n(x), and are taken together.
    """
    result: dict[Rational, Any] = {}
    symmetric = (2 * theta).is_integer
    for p, c in row.items():
        if p == 0:
            if periodic_bernoulli(n, -theta) != 0:
                result[p] = c
        elif symmetric:
            result[abs(p)] = result.get(abs(p), 0) + (c if p > 0 else (-1) ** n * c)
        else:
            result[p] = c
    return {p: c for p, c in sorted(result.items()) if c != 0}


def fraction(x: Expr) -> Expr:
    """x − ⌊x⌋."""
    return simple(x - floor(x))


def simple(x: Expr) -> Expr:
    """A rational as it is; an algebraic number with its roots out of the denominator."""
    return x if x.is_Rational else radsimp(x.expand()).expand()
