"""Neighbour lists: the pair engine without a compiler, on SciPy's k-d tree and NumPy arrays.

Targets are taken in blocks that are near to each other in the tree, so that the arrays of a block
stay in the caches and memory is bounded. The neighbours of a target are summed in the order of the
tree, folded (`sphtrunc.summation`), which no choice of blocks, threads or targets changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sphtrunc.engine.pairs import MOST, Bounded, Plan, pair_terms, row_counts
from sphtrunc.summation import Array, compensated_total, total, total_error

_PAIRS = 1 << 15  # of one block


class ArrayNumbers:
    """The functions of the pair formula for NumPy arrays."""

    def constant(self, c: float, error: float = 0.0) -> float:
        return c

    def difference(self, a: Array, b: Array) -> Array:
        return a - b

    def scale(self, x: Any) -> Any:
        """The power of two at or below |x|, 0 for denormal numbers."""
        bits = np.asarray(x, dtype=np.float64).view(np.int64) & 0x7FF0000000000000
        return bits.view(np.float64)

    def sqrt(self, x: Array) -> Array:
        return np.asarray(np.sqrt(x))

    def size(self, x: Any) -> Any:
        return np.abs(x)

    def larger(self, a: Any, b: Any) -> Any:
        return np.maximum(a, b)

    def smaller(self, a: Any, b: Any) -> Any:
        return np.minimum(a, b)

    def positive(self, x: Any) -> Any:
        return np.maximum(x, 0.0)

    def others(self, squares: Array, x: Any) -> Any:
        return np.where(squares > 0.0, x, 0.0)

    def within(self, x: Array, edge: float, squares: Array) -> Any:
        return np.where(x <= edge, np.where(squares > 0.0, 1.0 + MOST, 1.0), 0.0)

    def pick(self, x: Array, knot: float, inner: Any, outer: Any, mean: float | None) -> Any:
        value = np.where(x < knot, inner, outer)
        return value if mean is None else np.where(x == knot, mean, value)


def pairs_of(
    tree: Any, place: Any, x: Array, targets: Any, reach: Array, typical: int
) -> Iterator[tuple[Any, Any, Any]]:
    """Blocks of pairs: targets (T,) in the order of the tree; for each pair the number of its
    target in the block and its source, both increasing.

    place: (n,) place of each particle in the order of the tree; x: (n, d)
    """
    size = max(1, _PAIRS // max(1, typical))
    for first in range(0, targets.size, size):
        block = targets[first : first + size]
        radius = float(reach[block].max() if reach.size > 1 else reach[0])
        found = cKDTree(x[block], balanced_tree=False, compact_nodes=False).sparse_distance_matrix(
            tree, radius, output_type="ndarray"
        )
        key = found["i"].astype(np.int64)
        key <<= 32
        key += place[found["j"]]
        key.sort()
        yield block, key >> 32, key & 0xFFFFFFFF


def sums(
    plan: Plan, columns: tuple[Array, ...], per_h: Array, reach: Array, wanted: Any, workers: int
) -> Array:
    """As `cells.sums`."""
    population = per_h.size
    out = np.zeros((population, row_counts(plan)[2]))
    x, reach = _scaled(columns[: plan.dim], reach)
    tree = cKDTree(x)
    order = np.asarray(tree.indices, dtype=np.int64)
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    sources = np.stack([column[order] for column in columns])
    keep = order < population
    if wanted is not None:
        keep &= wanted[np.minimum(order, population - 1)]
    slots = np.flatnonzero(keep)
    typical = _typical(tree, x, order[slots], reach)

    def work(part: Any) -> None:
        for block, i, j in pairs_of(tree, place, x, part, reach, typical):
            with np.errstate(all="ignore"):
                out[block] = _block(plan, sources, place[block], per_h[block], i, j).T

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, np.array_split(order[slots], max(1, min(4 * workers, slots.size)))))
    return out


def _scaled(rows: tuple[Array, ...], reach: Array) -> tuple[Array, Array]:
    """Positions (n, d) and reach by a power of two, so that the tree can square them."""
    power = -int(np.frexp(reach.max())[1])
    return np.ldexp(np.ascontiguousarray(np.stack(rows).T), power), np.ldexp(reach, power)


def _typical(tree: Any, x: Array, targets: Any, reach: Array) -> int:
    some = targets[np.linspace(0, targets.size - 1, min(64, targets.size)).astype(np.int64)]
    radius = reach[some] if reach.size > 1 else reach[0]
    return int(np.mean(tree.query_ball_point(x[some], radius, return_length=True)))


def listed(
    plan: Plan, columns: tuple[Array, ...], per_h: Array, reach: Array, targets: Any
) -> Iterator[tuple[Any, Any, Any, list[Array]]]:
    """Blocks of pairs with their terms one by one: which of the targets (T,), for each pair the
    number of its target in the block, its source, and a row for each term of the plan."""
    x, reach = _scaled(columns[: plan.dim], reach)
    tree = cKDTree(x)
    place = np.arange(x.shape[0])
    unique, at = np.unique(targets, return_inverse=True)
    if unique.size != targets.size:
        raise ValueError("targets: got a particle twice, expected each once")
    where = np.empty(x.shape[0], dtype=np.int64)
    where[unique] = np.argsort(at)
    order = np.asarray(tree.indices)
    near = order[np.isin(order, unique)]
    for block, i, j in pairs_of(tree, place, x, near, reach, _typical(tree, x, near, reach)):
        with np.errstate(all="ignore"):
            terms = _terms(plan, np.stack(columns), block, per_h[block], i, j)
        yield where[block], i, j, terms


def _terms(plan: Plan, sources: Array, slots: Any, per_h: Array, i: Any, j: Any) -> list[Any]:
    """The contribution of every pair to every sum."""
    places = plan.dim * (2 if plan.low else 1)
    source = [row[j] for row in sources]
    own = sources[places + 1 : places + 1 + (plan.fields if plan.difference else 0)]
    target = [
        *(row[slots][i] for row in sources[:places]),
        per_h[i],
        *(row[slots][i] for row in own),
    ]
    return [
        t if isinstance(t, Bounded) else np.broadcast_to(t, i.shape)
        for t in pair_terms(plan, ArrayNumbers(), target, source)
    ]


def _block(plan: Plan, sources: Array, slots: Any, per_h: Array, i: Any, j: Any) -> Array:
    """The sums of one block, (rows, T), from its pairs."""
    terms = _terms(plan, sources, slots, per_h, i, j)
    begin = np.searchsorted(i, np.arange(per_h.size + 1))
    row = np.arange(i.size) - begin[i]
    shape = (int(row.max(initial=0)) + 1, per_h.size)

    def table(values: Any) -> Array:
        padded = np.zeros(shape)
        padded[row, i] = values
        return padded

    values = [table(t.value if plan.bound else t) for t in terms]
    if plan.compensated:
        pairs = [compensated_total(v) for v in values]
        result = [p[0] for p in pairs] + [p[1] for p in pairs]
    else:
        result = [total(v) for v in values]
    if plan.bound:
        for v, term in zip(values, terms, strict=True):
            error = total(table(term.error))
            result.append(error if plan.compensated else error + total_error(v))
    return np.stack(result)
