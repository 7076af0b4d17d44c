"""Terms: the base sums that operators are built from, and the one table of what each sums.

A base sum m[δ, α] = Σ_b V_b g(s_b) samples g = (−1)^{|δ|} s^α ∂^δ Ŵ, or a term of its own:
−s^α Ŵ′/q (Brookshaw), −s^α Ŵ′/q³ (Fatehi–Manzari). Each g is a sum of monomials times radial
factors f_k of the kernel (`sphtrunc.kernels.factors`): Σ c s^β f_k(q).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from math import prod
from typing import Any

from sphtrunc.operators.moments import MultiIndex, add

Term = Any  # δ, or the name of a term of its own
Key = tuple[Term, MultiIndex]  # (δ, α)
Row = tuple[Any, MultiIndex, int]  # (c, β, k): c s^β f_k(q)
Sums = Mapping[Key, Any]
Around = Sequence[tuple[Sums, Sums]]  # see `Operator.correct`
Reader = Callable[[Mapping[Key, Any], MultiIndex], Any]  # likewise
Solver = Callable[[Sequence[Sequence[Any]], Sequence[Sequence[Any]]], list[list[Any]]]

#: terms beside the derivatives of the kernel: −Ŵ′/q and −Ŵ′/q³ (without the particle at s = 0)
BROOKSHAW, FATEHI_MANZARI = "brookshaw", "fatehi-manzari"

#: k of the radial factors f_k: Ŵ, Ŵ′/q, (Ŵ′/q)′/q; Ŵ′/q³ and Ŵ′/q, both 0 at q = 0
VALUE, SLOPE, CURVATURE, STEEP, OTHERS = range(5)


def parts(key: Key) -> list[Row]:
    """The term of a base sum as rows (c, β, k): Σ c s^β f_k(q)."""
    term, alpha = key
    if term == BROOKSHAW:
        return [(-1, alpha, OTHERS)]
    if term == FATEHI_MANZARI:
        return [(-1, alpha, STEEP)]
    delta = tuple(int(n) for n in term)
    if sum(delta) == 0:
        return [(1, alpha, VALUE)]
    if sum(delta) == 1:
        return [(-1, add(alpha, delta), SLOPE)]
    rows = [(1, add(alpha, delta), CURVATURE)]
    return [(1, alpha, SLOPE), *rows] if max(delta) == 2 else rows


def angular(total: MultiIndex) -> Fraction:
    """The mean of e^total over directions e: ∏(n_i − 1)!!/(d(d+2)…), 0 for odd entries."""
    if any(n % 2 for n in total):
        return Fraction(0)
    top = prod(prod(range(n - 1, 0, -2)) for n in total)
    dim = len(total)
    return Fraction(top, prod(range(dim, dim + sum(total), 2)))


def monomial(s: Any, beta: MultiIndex) -> Any:
    """s^β of an array of offsets, (…, d), as an array (…) or the number 1.0."""
    result: Any = 1.0
    for axis, n in enumerate(beta):
        for _ in range(n):
            result = result * s[..., axis]
    return result


def lowered(beta: MultiIndex, axis: int, by: int = 1) -> MultiIndex:
    """β − by·e_axis."""
    return tuple(n - by * (i == axis) for i, n in enumerate(beta))
