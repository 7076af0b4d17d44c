"""Cells: the compiled pair engine for explicit particles.

Particles are sorted into columns along the first axis, and along a column into short cells. Eight
neighbouring targets of a column are taken at a time; the particles of the columns around them that
come within reach of their bounding box are listed once, and the pair formula runs down this list
with the eight targets side by side. A target sees its neighbours in the order of the sorted
particles, whatever it is grouped with: its sums are the same to the last bit for any number of
threads and any selection of targets.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.engine.lanes import (
    WIDTH,
    add_pair,
    empty_sums,
    list_near,
    load_targets,
    store_sums,
)
from sphtrunc.experiment.engine.pairs import Plan, row_counts

_OPTIONS: dict[str, Any] = {"nogil": True, "cache": True, "error_model": "numpy"}
_PER_CELL = 2.0  # particles of a cell on average


# ------------------------------------------------------------------------------ the pair loop


@njit(**_OPTIONS)
def sum_pairs(
    plan: Any,
    sources: Any,
    keys: Any,
    starts: Any,
    grid: Any,
    counts: Any,
    slots: Any,
    order: Any,
    per_h: Any,
    reach: Any,
    out: Any,
    places: int,
    seen: int,
) -> None:
    """The sums of the targets in `slots` (places among the sorted particles, increasing).

    sources: (rows, n) sorted particles; keys: (n,) their cells; starts: (cells + 1,)
    grid: (3, d) origin, 1/size and the first of the cells; counts: (d,) cells along each axis
    order: (n,) which particle each is; per_h, reach: of targets by particle, (n,) or (1,)
    out: (targets of the scene, sums)
    places: rows of the sources that hold the position; seen: fields that targets have of their own
    """
    dim = counts.size
    along = counts[0]
    buffer = np.empty((places + 1 + seen, WIDTH))
    result = np.empty((out.shape[1], WIDTH))
    low, high = np.empty(dim), np.empty(dim)
    near = np.empty(1024, np.int64)
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    at = 0
    while at < slots.size:
        # neighbours in memory and in space: as many as fit the lanes of this column
        column_end = starts[(keys[slots[at]] // along + 1) * along]
        size = 1
        while size < WIDTH and at + size < slots.size and slots[at + size] < column_end:
            size += 1
        radius = 0.0
        low[:], high[:] = np.inf, -np.inf
        for lane in range(WIDTH):
            slot = slots[at + min(lane, size - 1)]
            for i in range(places):
                buffer[i, lane] = sources[i, slot]
            for i in range(dim):
                low[i], high[i] = min(low[i], buffer[i, lane]), max(high[i], buffer[i, lane])
            buffer[places, lane] = per_h[order[slot] if per_h.size > 1 else 0]
            for i in range(seen):
                buffer[places + 1 + i, lane] = sources[places + 1 + i, slot]
            radius = max(radius, reach[order[slot] if reach.size > 1 else 0])
        for i in range(dim):
            first[i] = _cell(low[i] - radius, grid[:, i], counts[i])
            last[i] = _cell(high[i] + radius, grid[:, i], counts[i])
        number, square = 0, radius * radius
        for k in range(first[2], last[2] + 1):
            for j in range(first[1], last[1] + 1):
                row = (k * (counts[1] if dim > 1 else 1) + j) * along
                begin, end = starts[row + first[0]], starts[row + last[0] + 1]
                if number + end - begin + WIDTH > near.size:
                    near = np.concatenate((near, np.empty(near.size + end - begin, np.int64)))
                for i in range(begin, end, WIDTH):
                    number = list_near(plan, sources, i, end, low, high, square, near, number)
        targets = load_targets(plan, buffer)
        sums = empty_sums(plan)
        for i in range(number):
            sums = add_pair(plan, sums, targets, sources, near[i])
        store_sums(plan, sums, result)
        for lane in range(size):
            target = order[slots[at + lane]]
            for i in range(out.shape[1]):
                out[target, i] = result[i, lane]
        at += size


@njit(**_OPTIONS, inline="always")
def _cell(x: float, grid: Any, count: int) -> int:
    """The cell of a coordinate along one axis, monotone in x. Taking off a whole number is exact:
    a particle is in the same cell wherever the count begins."""
    return int(min(max((x - grid[0]) * grid[1] - grid[2], 0.0), count - 1.0))


# ------------------------------------------------------------------------------------ sorting


@njit(**_OPTIONS)
def _count(x: Any, begin: int, end: int, grid: Any, counts: Any, keys: Any, histogram: Any) -> None:
    """The cell of each particle, and how many there are of each."""
    dim = counts.size
    for i in range(begin, end):
        key = 0
        for axis in range(dim - 1, -1, -1):
            key = key * counts[axis] + _cell(x[axis][i], grid[:, axis], counts[axis])
        keys[i] = key
        histogram[key] += 1


@njit(**_OPTIONS)
def _offsets(histograms: Any, starts: Any) -> None:
    """Turn counts, (threads, cells), into the place where each thread puts its next particle."""
    total = 0
    for cell in range(histograms.shape[1]):
        starts[cell] = total
        for thread in range(histograms.shape[0]):
            number = histograms[thread, cell]
            histograms[thread, cell] = total
            total += number
    starts[histograms.shape[1]] = total


@njit(**_OPTIONS)
def _place(
    columns: Any,
    begin: int,
    end: int,
    keys: Any,
    places: Any,
    sources: Any,
    sorted_keys: Any,
    order: Any,
) -> None:
    """Copy the particles to where they belong."""
    for i in range(begin, end):
        at = places[keys[i]]
        places[keys[i]] = at + 1
        order[at] = i
        sorted_keys[at] = keys[i]
        for row in range(len(columns)):
            sources[row, at] = columns[row][i]


@dataclass(frozen=True)
class Sorted:
    """Particles sorted into cells: arrays as `sum_pairs` takes them."""

    sources: Array
    keys: Any
    starts: Any
    grid: Array
    counts: Any
    order: Any


def grid_for(x: tuple[Array, ...], reach: float) -> tuple[Array, Any]:
    """Cells for positions, d rows of (n,): origin, 1/size and the first, 0, (3, d), and how many
    along each axis.

    Columns as wide as the reach or a whole part of it, so that eight particles fill a cube of a
    column; along the column short cells. Widened until there are at most 4 n of them.
    """
    dim, n = len(x), x[0].size
    low = np.array([row.min() for row in x])
    extent = np.array([row.max() for row in x]) - low
    floor = np.maximum(extent, reach)
    volume = float(np.prod(floor / reach))  # in units of the reach
    if not np.isfinite(volume):
        volume = 1e300
    parts = max(1, int((n / volume / WIDTH) ** (1.0 / dim) + 0.5))
    size = np.full(dim, reach / parts)
    size[0] = min(reach, _PER_CELL * volume / n * reach * float(parts) ** (dim - 1))
    while True:
        counts = np.minimum(np.floor(extent / size) + 1.0, 2.0**40)
        if np.prod(counts) <= 4.0 * n + 4096.0:
            return np.stack([low, 1.0 / size, np.zeros(dim)]), counts.astype(np.int64)
        size = size * 2.0


def part_of(grid: Array, x: tuple[Array, ...]) -> tuple[Array, Any]:
    """The same cells, as far as there are particles of x in them: with them a target sees its
    neighbours in the same order as with all particles."""
    cells = [
        np.floor((np.array([row.min(), row.max()]) - grid[0, i]) * grid[1, i])
        for i, row in enumerate(x)
    ]
    first, last = np.maximum(np.array(cells).T, 0.0)
    return np.stack([grid[0], grid[1], first]), (last - first + 1.0).astype(np.int64)


def sort(
    columns: tuple[Array, ...],
    dim: int,
    cells_: tuple[Array, Any],
    pool: ThreadPoolExecutor,
    threads: int,
) -> Sorted:
    """Sort particles, given as columns of n numbers (positions first), into cells: stable, so that
    the result depends on no number of threads."""
    x = columns[:dim]
    n = x[0].size
    grid, counts = cells_
    cells = int(np.prod(counts))
    keys = np.empty(n, dtype=np.int32)
    histograms = np.zeros((threads, cells), dtype=np.int32)
    edges = np.linspace(0, n, threads + 1).astype(np.int64)
    list(
        pool.map(
            lambda t: _count(x, edges[t], edges[t + 1], grid, counts, keys, histograms[t]),
            range(threads),
        )
    )
    starts = np.empty(cells + 1, dtype=np.int64)
    _offsets(histograms, starts)
    sources = np.zeros((len(columns), n + WIDTH))  # lanes may look beyond the last particle
    sorted_keys, order = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    list(
        pool.map(
            lambda t: _place(
                columns, edges[t], edges[t + 1], keys, histograms[t], sources, sorted_keys, order
            ),
            range(threads),
        )
    )
    return Sorted(sources, sorted_keys, starts, grid, counts, order)


def sums(
    plan: Plan,
    columns: tuple[Array, ...],
    per_h: Array,
    reach: Array,
    wanted: Any,
    workers: int,
    within: tuple[Array, Any] | None = None,
) -> Array:
    """The sums of a plan, (population, row_counts(plan)[2]).

    columns: rows of the sources, n numbers each; per_h: (population,) 1/h of the targets
    reach: (population,) or (1,), beyond which nothing contributes
    wanted: (population,) bool, or None for all; particles beyond the population are images
    within: the cells, from `grid_for` or `part_of`; None: those for these particles
    """
    population = per_h.size
    out = np.zeros((population, row_counts(plan)[2]))
    places = plan.dim * (2 if plan.low else 1)
    if plan.mode == "one" and reach.size == 1:
        per_h = per_h[:1]  # one h for all
    with ThreadPoolExecutor(workers) as pool:
        grid = within or grid_for(columns[: plan.dim], float(reach.max()))
        done = sort(columns, plan.dim, grid, pool, workers)
        slots = np.arange(done.order.size)
        if wanted is not None or done.order.size > population:
            keep = done.order < population
            if wanted is not None:
                keep &= wanted[np.minimum(done.order, population - 1)]
            slots = np.flatnonzero(keep)
        pieces = np.array_split(slots, max(1, min(16 * workers, slots.size // 512)))
        list(
            pool.map(
                lambda part: sum_pairs(
                    plan,
                    done.sources,
                    done.keys,
                    done.starts,
                    done.grid,
                    done.counts,
                    part,
                    done.order,
                    per_h,
                    reach,
                    out,
                    places,
                    plan.fields if plan.difference else 0,
                ),
                pieces,
            )
        )
    return out


def crowd(x: tuple[Array, ...], reach: Array) -> float:
    """How many particles share the cells that a target looks into, on average (sampled)."""
    grid, counts = grid_for(x, float(reach.max()))
    some = [row[:: max(1, row.size // 16384)] for row in x]
    keys = np.zeros(some[0].size, dtype=np.int64)
    for axis in range(len(x) - 1, -1, -1):
        cell = np.clip((some[axis] - grid[0, axis]) * grid[1, axis], 0, counts[axis] - 1)
        keys = keys * counts[axis] + cell.astype(np.int64)
    _, number = np.unique(keys, return_counts=True)
    return float((number.astype(np.float64) ** 2).sum() / keys.size * x[0].size / keys.size)
