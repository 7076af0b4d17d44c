"""Symmetry: moments that are equal because turning the lattice about exchanges them.

A permutation π of the axes that takes the lattice and the target's place in it to themselves takes
Σ_b V_b g(s_b) to the sum of g∘π, on displaced particles in distribution. So moments are equal whose
functions g_α = s^α g_0 are exchanged by such a π; of a corrected estimate g_0 is not known before
the sums are, but it turns with the derivative that the estimate stands for.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import permutations
from typing import Any

from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.disorder.leading_law import moment_rows


def classes(
    operator: Operator,
    kind: str,
    offset: Sequence[Any],
    alphas: Iterable[MultiIndex],
    axis: int = 0,
) -> list[list[MultiIndex]]:
    """Multi-indices whose moments are equal, each once, in the order given.

    kind, offset: the lattice, and where it lies relative to the target, in Δx; axis: the component
    of the estimate
    """
    dim = KINDS[kind].dim
    turns = [turn for turn in permutations(range(dim)) if _keeps(kind, offset, turn)]
    part = operator.coefficients({}, dim)[axis] if operator.uncorrected else None
    target = operator.components(dim)[axis]

    def name(alpha: MultiIndex, turn: Sequence[int]) -> Any:
        """The function that a moment samples, turned."""
        if part is None:
            return sorted(_turned(mu, turn) for mu in target), _turned(alpha, turn)
        rows: dict[Any, Any] = {}
        for c, beta, k in moment_rows(part, alpha):
            row = _turned(beta, turn), k
            rows[row] = rows.get(row, 0) + c
        return sorted(rows.items())

    found: dict[str, list[MultiIndex]] = {}
    for alpha in alphas:
        first = min(name(alpha, turn) for turn in turns)
        found.setdefault(repr(first), []).append(alpha)
    return list(found.values())


def _turned(beta: Sequence[Any], turn: Sequence[int]) -> tuple[Any, ...]:
    return tuple(beta[i] for i in turn)


def _keeps(kind: str, offset: Sequence[Any], turn: Sequence[int]) -> bool:
    """Whether the lattice and the place of the target are the same with their axes permuted."""
    import numpy as np

    lattice = KINDS[kind]
    steps = np.array([_turned(step, turn) for step in lattice.primitive]).T
    return (
        _turned(lattice.units, turn) == lattice.units
        and _turned(offset, turn) == tuple(offset)
        and bool(lattice.contains(steps).all())
    )
