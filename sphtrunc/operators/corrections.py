"""Corrections: Shepard, CSPH, RKPM, renormalised second derivatives and Fatehi–Manzari.

Algebra on base sums: the same functions for fractions, symbols and arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import comb, perm, prod
from typing import Any

from sphtrunc.operators.moments import MultiIndex, add, multi_indices, unit
from sphtrunc.operators.terms import FATEHI_MANZARI, Key, Solver, Sums


def shifted(
    powers: Mapping[MultiIndex, Any], moments: Mapping[MultiIndex, Any], alpha: MultiIndex
) -> Any:
    """Σ_{β <= α} C(α, β) powers_{α−β} moments_β: the estimate of s^α at a place from its moments
    there and the powers of its offset, or from the sums of either."""
    return sum(
        _times(_times(powers[_minus(alpha, beta)], moments[beta]), _binomial(alpha, beta))
        for beta in below(alpha)
    )


def _times(x: Any, y: Any) -> Any:
    """x y, and the number 0 where one of them is: an exact zero is not made a rounded one."""
    known = (one for one in (x, y) if not hasattr(one, "dtype"))
    return 0 if any(one == 0 for one in known) else x * y


def combine(part: Mapping[Key, Any], sums: Sums, alpha: MultiIndex) -> Any:
    """M_α = Σ c[δ, γ] m[δ, α + γ]."""
    return sum(c * sums[delta, add(alpha, gamma)] for (delta, gamma), c in part.items())


def _weighted(parts: Iterable[tuple[Any, Mapping[Key, Any]]]) -> dict[Key, Any]:
    """Σ factor · part."""
    result: dict[Key, Any] = {}
    for factor, part in parts:
        for key, c in part.items():
            result[key] = result.get(key, 0) + factor * c
    return result


def _renormalised(
    parts: Sequence[Mapping[Key, Any]], sums: Sums, dim: int, solve: Solver
) -> list[dict[Key, Any]]:
    """The gradient times the inverse of its own first moments."""
    axes = range(dim)
    slopes = [[combine(part, sums, unit(dim, j)) for j in axes] for part in parts]
    inverse = solve(slopes, [[int(i == j) for j in axes] for i in axes])
    return [_weighted(zip(row, parts, strict=True)) for row in inverse]


def _fatehi_manzari(sums: Sums, dim: int, solve: Solver) -> dict[Key, Any]:
    """Σ_p B_p · 2 Σ_b [A_b − A_a − s·⟨∇A⟩] s^p (−Ŵ′/q³) V over the pairs p = e_j + e_k, ⟨∇A⟩ from
    CSPH, and B such that Σ_p B_p L_p[s^{e_m + e_n}] is the Laplacian of s^{e_m + e_n}."""
    zero = unit(dim, 0, 0)
    axes = range(dim)
    pairs = [mu for mu in multi_indices(dim, 2) if sum(mu) == 2]
    gradient = _renormalised([{(unit(dim, i), zero): 1} for i in axes], sums, dim, solve)
    rows = [
        _weighted(
            [
                (2, {(FATEHI_MANZARI, p): 1}),
                *((-2 * sums[FATEHI_MANZARI, add(p, unit(dim, i))], gradient[i]) for i in axes),
            ]
        )
        for p in pairs
    ]
    matrix = [[combine(row, sums, p) for row in rows] for p in pairs]
    factors = solve(matrix, [[2 * int(max(p) == 2)] for p in pairs])
    return _weighted((b, row) for (b,), row in zip(factors, rows, strict=True))


def _reproducing(
    sums: Sums, dim: int, degree: int, targets: Sequence[MultiIndex], solve: Solver
) -> list[dict[Key, Any]]:
    """Exact derivatives ∂^μ of the RKPM kernel Σ_j c_j s^{α_j} W, μ in targets, with respect to the
    point of evaluation (in units of 1/h).

    The moment matrix P_jk = m[0, α_j + α_k] gives P c = e₀; its derivatives are base sums again, so
    P ∂^ν c = −Σ_{0<τ≤ν} C(ν, τ) (∂^τ P) ∂^{ν−τ} c.
    """
    zero = unit(dim, 0, 0)
    basis = list(multi_indices(dim, degree))
    matrix = [[sums[zero, add(a, b)] for b in basis] for a in basis]
    c = {zero: [row[0] for row in solve(matrix, [[int(a == zero)] for a in basis])]}
    lower = dict.fromkeys(nu for mu in targets for nu in below(mu))
    for order in range(1, 1 + max(sum(mu) for mu in targets)):
        level = [nu for nu in lower if sum(nu) == order]
        columns = [
            [
                -sum(
                    _binomial(nu, tau) * _slope(sums, tau, add(a, b)) * x
                    for tau in below(nu)
                    if tau != zero
                    for b, x in zip(basis, c[_minus(nu, tau)], strict=True)
                )
                for nu in level
            ]
            for a in basis
        ]
        solved = solve(matrix, columns)
        c |= {nu: [row[i] for row in solved] for i, nu in enumerate(level)}
    return [
        _weighted(
            (_binomial(mu, nu) * x, _derived(nu, a))
            for nu in below(mu)
            for a, x in zip(basis, c[_minus(mu, nu)], strict=True)
        )
        for mu in targets
    ]


def _derived(nu: MultiIndex, alpha: MultiIndex) -> dict[Key, int]:
    """∂^ν of s^α Ŵ(s) with respect to the point of evaluation, in the terms of base sums."""
    return {
        (_minus(nu, k), _minus(alpha, k)): (-1) ** sum(k)
        * _binomial(nu, k)
        * prod(perm(a, n) for a, n in zip(alpha, k, strict=True))
        for k in below(nu)
        if all(n <= a for n, a in zip(k, alpha, strict=True))
    }


def _slope(sums: Sums, nu: MultiIndex, alpha: MultiIndex) -> Any:
    """∂^ν m[0, α] with respect to the point of evaluation."""
    return sum(c * sums[key] for key, c in _derived(nu, alpha).items())


def below(mu: MultiIndex) -> list[MultiIndex]:
    """All ν <= μ."""
    return list(product(*(range(n + 1) for n in mu)))


def _minus(a: MultiIndex, b: MultiIndex) -> MultiIndex:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _binomial(a: MultiIndex, b: MultiIndex) -> int:
    return prod(comb(x, y) for x, y in zip(a, b, strict=True))
