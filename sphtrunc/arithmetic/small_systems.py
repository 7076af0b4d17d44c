"""Linear systems up to 3 × 3 by cofactors, where they are safe, for many targets at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.arithmetic.plain import Plain

_SAFE = 1e5  # condition up to which a small matrix is inverted by its cofactors


def solve(
    matrix: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]], health: Health
) -> list[list[Any]]:
    """Linear systems of many targets: up to 3 × 3 by cofactors, wherever that is safe, and by
    singular values otherwise."""
    n = len(matrix)
    if n > 3:
        return Plain().solve(matrix, columns, health)  # type: ignore[no-any-return]
    a = [[np.asarray(x) for x in row] for row in matrix]
    with np.errstate(all="ignore"):
        # a diagonal of ones first: the axes of a flat cloud differ in scale
        d = [1.0 / np.sqrt(np.where(a[i][i] != 0.0, np.abs(a[i][i]), 1.0)) for i in range(n)]
        scaled = [[a[i][j] * d[i] * d[j] for j in range(n)] for i in range(n)]
        inverse, size = _inverse(scaled)
        norm = sum(x * x for row in scaled for x in row)
        condition = np.sqrt(norm * size)  # Frobenius: between the condition and n times it
        inverse = [[inverse[i][j] * d[i] * d[j] for j in range(n)] for i in range(n)]
    bad = np.flatnonzero(~(condition <= _SAFE))
    health.condition = np.maximum(health.condition, np.where(condition <= _SAFE, condition, 0.0))
    with np.errstate(all="ignore"):  # what is not safe is overwritten
        result = [
            [_dot(row, [column[j] for column in columns]) for j in range(len(columns[0]))]
            for row in inverse
        ]
    if bad.size:
        rest = Health()
        wide = np.broadcast(*(x for row in a for x in row)).shape
        some = [[np.broadcast_to(x, wide)[bad] for x in row] for row in a]
        right = [[np.broadcast_to(x, wide)[bad] for x in row] for row in columns]
        exact = Plain().solve(some, right, rest)
        for i, row in enumerate(exact):
            for j, x in enumerate(row):
                result[i][j] = np.array(np.broadcast_to(result[i][j], wide))
                result[i][j][bad] = x
        worst = np.array(np.broadcast_to(health.condition, wide))
        worst[bad] = np.maximum(worst[bad], rest.condition)
        health.condition = worst
    return result


def _inverse(a: list[list[Any]]) -> tuple[list[list[Any]], Any]:
    """Inverse of a matrix up to 3 × 3 by cofactors, and the square of its Frobenius norm."""
    n = len(a)
    if n == 1:
        cofactor: list[list[Any]] = [[1.0]]
    elif n == 2:
        cofactor = [[a[1][1], -a[1][0]], [-a[0][1], a[0][0]]]
    else:
        cofactor = [
            [
                a[(i + 1) % 3][(j + 1) % 3] * a[(i + 2) % 3][(j + 2) % 3]
                - a[(i + 1) % 3][(j + 2) % 3] * a[(i + 2) % 3][(j + 1) % 3]
                for j in range(3)
            ]
            for i in range(3)
        ]
    per_determinant = 1.0 / _dot(a[0], cofactor[0])
    inverse = [[cofactor[j][i] * per_determinant for j in range(n)] for i in range(n)]
    return inverse, sum(x * x for row in inverse for x in row)


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Σ a_i b_i, without the terms whose factor is the number 0."""
    terms = [
        x if isinstance(y, int) and y == 1 else x * y
        for x, y in zip(a, b, strict=True)
        if not (isinstance(y, int) and y == 0)
    ]
    return sum(terms[1:], terms[0]) if terms else 0.0
