"""Terms: the base sums that operators are built from, and the one table of what each sums."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from math import prod
from typing import Any

from sphtrunc.operators.moments import MultiIndex, add


def parts(key: Key) -> list[tuple[int, MultiIndex, str]]:
    """The term of a base sum, (−1)^{|δ|} s^α ∂^δ Ŵ, as rows (c, β, f): Σ c s^β f(q)."""
    term, alpha = key
    if term == BROOKSHAW:
        return [(-1, alpha, "w1")]
    if term == FATEHI_MANZARI:
        return [(-1, alpha, "w3")]
    delta = tuple(int(n) for n in term)
    if sum(delta) == 0:
        return [(1, alpha, "w")]
    if sum(delta) == 1:
        return [(-1, add(alpha, delta), "w1")]
    rows = [(1, add(alpha, delta), "w2")]
    return [(1, alpha, "w1"), *rows] if max(delta) == 2 else rows


def angular(total: MultiIndex) -> Fraction:
    """The mean of e^total over directions e: ∏(n_i − 1)!!/(d(d+2)…), 0 for odd entries."""
    if any(n % 2 for n in total):
        return Fraction(0)
    top = prod(prod(range(n - 1, 0, -2)) for n in total)
    dim = len(total)
    return Fraction(top, prod(range(dim, dim + sum(total), 2)))


Term = Any  # δ, or the name of a term of its own


Key = tuple[Term, MultiIndex]  # (δ, α)


Sums = Mapping[Key, Any]


Around = Sequence[tuple[Sums, Sums]]  # see `Operator.correct`


Solver = Callable[[Sequence[Sequence[Any]], Sequence[Sequence[Any]]], list[list[Any]]]

#: terms beside the derivatives of the kernel: −Ŵ′/q and −Ŵ′/q³ (without the particle at s = 0)
BROOKSHAW, FATEHI_MANZARI = "brookshaw", "fatehi-manzari"
