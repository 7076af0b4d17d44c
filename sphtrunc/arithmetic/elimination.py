"""Elimination: linear systems over any exact field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def eliminate(matrix: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Solve matrix · X = columns by elimination in any exact field; ValueError if singular."""
    n = len(matrix)
    rows = [[*a, *b] for a, b in zip(matrix, columns, strict=True)]
    for i in range(n):
        pivot = next((r for r in range(i, n) if rows[r][i] != 0), None)
        if pivot is None:
            raise ValueError(
                "correction: its moment matrix is singular here: too few neighbours, or neighbours"
                " on one line or plane; expected a smaller Δx/h, or a lower correction"
            )
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for r in range(n):
            if r != i and rows[r][i] != 0:
                factor = rows[r][i]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i], strict=True)]
    return [row[n:] for row in rows]
