"""Neighbour lists: the pair engine without a compiler, on SciPy's k-d tree and NumPy arrays.

Targets are taken leaf by leaf of the tree: boxes of boxes tell what comes within reach of a leaf,
and one product of matrices the distances of that from all targets of the leaf. The arrays of a
block stay in the caches, and memory is bounded. The neighbours of a target are summed in the order
of the tree, folded (`sphtrunc.arithmetic.summation`), which no choice of blocks, threads or targets
changes.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sphtrunc.arithmetic.arrays import ArrayNumbers
from sphtrunc.arithmetic.summation import UNIT, Array, compensated_total, total, total_error
from sphtrunc.experiment.engine.bounds import Bounded
from sphtrunc.experiment.engine.pairs import Plan, pair_terms, row_counts

_PAIRS = 1 << 15  # of one block
_LEAF = 64  # particles of a leaf of the tree, at most
_FAN = 64  # boxes in a box of the next level
_ROUNDING = 32.0 * UNIT  # of a squared distance, relative to the largest squares in it
_WIDER = 1.0 + 1e-12  # boxes are taken a little larger than the reach


def pairs_of(
    order: Order, slots: Any, reach: Array, typical: int
) -> Iterator[tuple[Any, Any, Any]]:
    """Blocks of pairs of the particles in `slots`, increasing: slots (T,) of a block; for each pair
    the number of its target in the block and the slot of its source, both increasing.

    reach: (n,) in the order of the slots, or (1,)
    """
    most = max(1, _PAIRS // max(1, typical))
    held: list[tuple[Any, Any, Any]] = []
    number = 0
    for target, near in order.groups(slots, reach):
        radius = reach[target] if reach.size > 1 else reach
        i, j = _within(order.x[:, target], order.x[:, near], radius)
        held.append((target, i + number, near[j]))
        number += target.size
        if number >= most:
            yield _joined(held)
            held, number = [], 0
    if held:
        yield _joined(held)


def _joined(held: list[tuple[Any, Any, Any]]) -> tuple[Any, Any, Any]:
    block, i, j = (np.concatenate(part) for part in zip(*held, strict=True))
    return block, i, j


def _within(target: Array, source: Array, reach: Array) -> tuple[Any, Any]:
    """Which sources (d, C) are within reach, (T,) or (1,), of which of the targets (d, T).

    |x − t|² = (x, |x|², 1)·(−2t, 1, |t|²) is one product of matrices. Where its rounding matters
    the differences decide, so that a pair is in or out by itself, whatever it is looked at with.
    """
    d, width = source.shape
    middle = target.mean(axis=1)[:, None]
    t, x = target - middle, source - middle
    left, right = np.empty((t.shape[1], d + 2)), np.empty((d + 2, width))
    left[:, :d], left[:, d] = -2.0 * t.T, 1.0
    right[:d], right[d + 1] = x, 1.0
    np.einsum("ij,ij->j", t, t, out=left[:, d + 1])
    np.einsum("ij,ij->j", x, x, out=right[d])
    distance = left @ right
    rounding = _ROUNDING * float(left[:, d + 1].max() + right[d].max())
    square = reach * reach
    inside = distance <= (square + rounding)[:, None]
    flat = np.flatnonzero(inside)
    i = np.repeat(np.arange(t.shape[1]), np.count_nonzero(inside, axis=1))
    j = flat - i * width
    limit = square[i] if square.size > 1 else square
    edge = np.flatnonzero(distance.reshape(-1)[flat] > limit - rounding)
    if edge.size:
        gap = source[:, j[edge]] - target[:, i[edge]]
        limit = np.broadcast_to(limit, i.shape)[edge]
        beyond = edge[np.einsum("ij,ij->j", gap, gap) > limit]
        i, j = np.delete(i, beyond), np.delete(j, beyond)
    return i, j


@dataclass(frozen=True)
class Order:
    """Particles in the order of a k-d tree, slot by slot, with the boxes of its leaves and, level
    by level, of _FAN of those together.

    x: (d, n); slots: (n,) which particle each is; leaves: (L + 1,) their first slots
    boxes: per level, the finest first, lower and upper corners (d, boxes)
    """

    x: Array
    slots: Any
    leaves: Any
    boxes: list[tuple[Array, Array]]

    def groups(self, slots: Any, reach: Array) -> Iterator[tuple[Any, Any]]:
        """The slots leaf by leaf, and beside each group the slots, increasing, that come within
        reach of its box."""
        starts = np.unique(np.searchsorted(slots, self.leaves))
        for first in range(0, starts.size - 1, _FAN):
            some = starts[first : first + _FAN + 1]
            target = slots[some[0] : some[-1]]
            here, begin = self.x[:, target], some[:-1] - some[0]
            low, high = _boxes(here, here, begin)
            radius = np.maximum.reduceat(reach[target], begin) if reach.size > 1 else reach
            owner, near = self._near(low, high, np.broadcast_to(radius, begin.shape))
            edges = np.searchsorted(owner, np.arange(begin.size + 1))
            for g in range(begin.size):
                yield slots[some[g] : some[g + 1]], near[edges[g] : edges[g + 1]]

    def _near(self, low: Array, high: Array, radius: Array) -> tuple[Any, Any]:
        """Which slots come within reach of which of the boxes low … high: numbers of boxes, slots,
        both increasing."""
        low, high = low - radius * _WIDER, high + radius * _WIDER
        top = self.boxes[-1][0].shape[1]
        owner = np.repeat(np.arange(radius.size), top)
        node = np.tile(np.arange(top), radius.size)
        levels = [(self.x, self.x), *self.boxes]
        for level in range(len(levels) - 1, -1, -1):
            lower, upper = levels[level]
            meets = np.ones(node.size, dtype=np.bool_)
            for axis in range(low.shape[0]):
                meets &= lower[axis, node] <= high[axis, owner]
                meets &= upper[axis, node] >= low[axis, owner]
            owner, node = owner[meets], node[meets]
            if level == 1:
                begin, length = self.leaves[node], self.leaves[node + 1] - self.leaves[node]
            elif level:
                begin = node * _FAN
                length = np.minimum(begin + _FAN, levels[level - 1][0].shape[1]) - begin
            if level:
                owner, node = np.repeat(owner, length), _ranges(begin, length)
        return owner, node


def _ranges(begin: Any, length: Any) -> Any:
    """begin[0] … begin[0] + length[0] − 1, begin[1] … and so on."""
    last = np.cumsum(length)
    return np.arange(last[-1] if last.size else 0) + np.repeat(begin - last + length, length)


def ordered(x: Array) -> Order:
    """Particles (n, d) in the order of a k-d tree."""
    tree = cKDTree(x, leafsize=_LEAF)
    leaves, waiting = [], [tree.tree]
    while waiting:
        node = waiting.pop()
        if node.lesser is None:
            leaves.append(node.start_idx)
        else:
            waiting += [node.greater, node.lesser]
    slots = np.asarray(tree.indices, dtype=np.int64)
    places = np.ascontiguousarray(x[slots].T)
    starts = np.array(leaves, dtype=np.int64)
    boxes = [_boxes(places, places, starts)]
    while boxes[-1][0].shape[1] > _FAN:
        lower, upper = boxes[-1]
        boxes.append(_boxes(lower, upper, np.arange(0, lower.shape[1], _FAN)))
    return Order(places, slots, np.append(starts, slots.size), boxes)


def _boxes(lower: Array, upper: Array, starts: Any) -> tuple[Array, Array]:
    return np.minimum.reduceat(lower, starts, axis=1), np.maximum.reduceat(upper, starts, axis=1)


def sums(
    plan: Plan, columns: tuple[Array, ...], per_h: Array, reach: Array, wanted: Any, workers: int
) -> Array:
    """As `cells.sums`."""
    population = per_h.size
    out = np.zeros((population, row_counts(plan)[2]))
    x, reach = _scaled(columns[: plan.dim], reach)
    order = ordered(x)
    sources = np.stack([column[order.slots] for column in columns])
    keep = order.slots < population
    if wanted is not None:
        keep &= wanted[np.minimum(order.slots, population - 1)]
    chosen = np.flatnonzero(keep)
    reach = _by_slot(order, reach)
    typical = _typical(order, chosen, reach)

    def work(part: Any) -> None:
        for block, i, j in pairs_of(order, part, reach, typical):
            target = order.slots[block]
            with np.errstate(all="ignore"):
                out[target] = _block(plan, sources, block, per_h[target], i, j).T

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, np.array_split(chosen, max(1, min(4 * workers, chosen.size)))))
    return out


def _by_slot(order: Order, reach: Array) -> Array:
    """Reach in the order of the slots; images look for nothing."""
    return reach if reach.size == 1 else np.take(reach, np.minimum(order.slots, reach.size - 1))


def _scaled(rows: tuple[Array, ...], reach: Array) -> tuple[Array, Array]:
    """Positions (n, d) and reach by a power of two, so that they can be squared."""
    power = -int(np.frexp(reach.max())[1])
    return np.ldexp(np.ascontiguousarray(np.stack(rows).T), power), np.ldexp(reach, power)


def _typical(order: Order, slots: Any, reach: Array) -> int:
    """How many neighbours a target has, from a few groups of them."""
    some = np.unique(slots[np.linspace(0, slots.size - 1, min(16, slots.size)).astype(np.int64)])
    pairs = sum(i.size for _, i, _ in pairs_of(order, some, reach, 1))
    return int(pairs / max(1, some.size))


def listed(
    plan: Plan, columns: tuple[Array, ...], per_h: Array, reach: Array, targets: Any
) -> Iterator[tuple[Any, Any, Any, list[Array]]]:
    """Blocks of pairs with their terms one by one: which of the targets (T,), for each pair the
    number of its target in the block, its source, and a row for each term of the plan."""
    x, reach = _scaled(columns[: plan.dim], reach)
    unique, at = np.unique(targets, return_inverse=True)
    if unique.size != targets.size:
        raise ValueError("targets: got a particle twice, expected each once")
    where = np.empty(x.shape[0], dtype=np.int64)
    where[unique] = np.argsort(at)
    order = ordered(x)
    sources = np.stack([column[order.slots] for column in columns])
    chosen = np.flatnonzero(np.isin(order.slots, unique))
    reach = _by_slot(order, reach)
    for block, i, j in pairs_of(order, chosen, reach, _typical(order, chosen, reach)):
        target = order.slots[block]
        with np.errstate(all="ignore"):
            terms = _terms(plan, sources, block, per_h[target], i, j)
        yield where[target], i, order.slots[j], terms


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
    row *= shape[1]
    row += i

    def table(values: Any) -> Array:
        padded = np.zeros(shape)
        padded.reshape(-1)[row] = values
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
