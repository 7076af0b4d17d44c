"""Periodic Bernoulli polynomials B̃_n(x) = B_n(x − ⌊x⌋), and what is left of them in a sum."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

from sympy import QQ, Expr, Poly, Rational, Symbol, factorial, floor, radsimp
from sympy.polys.appellseqs import bernoulli_poly

from sphtrunc.kernels.factors import laurent
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import jumps, q, steps
from sphtrunc.operators.terms import BROOKSHAW, FATEHI_MANZARI, Key, parts

_x = Symbol("x")


def periodic_bernoulli(n: int, x: Expr) -> Expr:
    """B̃_n(x), with B̃_1(integer) = 0."""
    x = fractional_part(x)
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


def fractional_part(x: Expr) -> Expr:
    """x − ⌊x⌋."""
    return simple(x - floor(x))


def simple(x: Expr) -> Expr:
    """A rational as it is; an algebraic number with its roots out of the denominator."""
    return x if x.is_Rational else radsimp(x.expand()).expand()


@dataclass(frozen=True)
class KnotTerm:
    """One term of the discretisation error of a base sum in 1D.

    It adds coefficient · (Δx/h)^dx_power · B̃_dx_power(knot·h/Δx − θ) to m[term, moment]
    (see `sphtrunc.operators.terms`); for an operator without correction that sum is M_moment
    itself.
    """

    term: Any
    moment: int
    dx_power: int
    knot: Rational
    coefficient: Rational


_FIRST = {BROOKSHAW: 1, FATEHI_MANZARI: 3}  # the first k for which s^k Ŵ′/|s|, … has no pole


# -- uniform particles in 1D ----------------------------------------------------------------------


@lru_cache(maxsize=4096)
def euler_maclaurin(
    kernel: Kernel, term: Any, k: int
) -> tuple[tuple[int, Rational, Rational], ...]:
    """Rows (n, p, c) of the discretisation error of m[term, k], c ≠ 0.

    Δs Σ_j f(s_j) − ∫ f ds = Σ c Δs^n B̃_n(p/Δs − θ), f(s) = (−1)^δ s^k Ŵ^{(δ)}(s), or −s^k Ŵ′/|s|
    and −s^k Ŵ′/|s|³. Where such a term has a pole at the origin, k < 1 and k < 3, it belongs to a
    moment that difference forms do not have, and nothing is returned; else f is 0 there, as it
    should be without the particle at the target.
    """
    if k < _FIRST.get(term, 0):
        return ()
    parity = (-1) ** (k if isinstance(term, str) else k + term[0])
    sigma = kernel.normalisation(1)
    result = []
    for m, at in enumerate(jumps(kernel.knots, _steps(kernel, term, k), parity)):
        scale = sigma * (-1) ** m / factorial(m + 1)
        result += [(m + 1, p, scale * jump) for p, jump in at.items() if jump != 0]
    return tuple(result)


@lru_cache(maxsize=4096)
def _steps(kernel: Kernel, term: Any, k: int) -> list[list[Rational]]:
    """The steps of f at the knots: from its pieces, or from those of s^{k−1} times s = p + t."""
    if k > _FIRST.get(term, 0):
        lower = _steps(kernel, term, k - 1)
        return [
            [p * c + d for c, d in zip([*row, 0], [0, *row], strict=True)]
            for p, row in zip(kernel.knots, lower, strict=True)
        ]
    rows = parts((term, (k,)))
    pieces = []
    for i in range(len(kernel.pieces)):
        total: dict[int, Rational] = {}
        for c, (power,), f in rows:
            for j, x in laurent(kernel, f)[i].items():
                value = Rational(c * x.numerator, x.denominator)
                total[j + power] = total.get(j + power, Rational(0)) + value
        total = {j: c for j, c in total.items() if c}
        pieces.append(Poly({(j,): c for j, c in total.items()} or 0, q, domain=QQ))
    return steps(kernel.knots, pieces)


def euler_maclaurin_sums(
    continuous: Mapping[Key, Any], terms: Iterable[KnotTerm], ratio: Expr, theta: Rational
) -> dict[Key, Any]:
    """The base sums on the lattice: the integral and its Euler–Maclaurin terms."""
    sums = dict(continuous)
    power = cache(lambda n: simple(ratio**n))
    phase = cache(lambda p: fractional_part(p / ratio - theta))
    wave = cache(lambda n, p: simple(periodic_bernoulli(n, phase(p)) * power(n)))
    for term in terms:
        key = (term.term, (term.moment,))
        sums[key] += term.coefficient * wave(term.dx_power, term.knot)
    return {key: simple(value) for key, value in sums.items()}
