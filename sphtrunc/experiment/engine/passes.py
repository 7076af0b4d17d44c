"""Passes over the pairs of explicit particles: every sum that operators need, in one of them.

Two engines evaluate the same formula (`pairs`): one compiled by Numba (`cells`, the extra `fast`),
one on NumPy and SciPy (`tree`). Both sum the neighbours of a target in an order that depends
on the particles alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.arrays import MOST
from sphtrunc.arithmetic.summation import UNIT, Array
from sphtrunc.experiment.engine.pairs import (
    COUNT,
    Plan,
    Term,
    base_sum,
    needed_terms,
    plan,
)
from sphtrunc.experiment.engine.sources import REACH, columns
from sphtrunc.operators.terms import Key, parts
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

ENGINES = ("numba", "numpy")
_WORTH = 1 << 14  # particles from which on a compiled loop pays for its compilation
_CROWD = 4096.0  # candidates for a target beyond which cells of one size do not fit the particles


@dataclass(frozen=True)
class PairSums:
    """Sums over the neighbours of T targets, in units of h.

    targets: (T,); neighbours: (T,) particles within the support, the target included, and others:
        (T,) those of them that are not where the target is
    base: (δ, α) -> (T,) m[δ, α] = (−1)^{|δ|} Σ V_b/h^d s^α ∂^δŴ
    fields: (δ, α) -> (F, T), the same with A_b (or A_b − A_a) in every term
    base_bound, fields_bound: bounds of the rounding errors, if asked for
    engine: which one summed
    """

    targets: Any
    neighbours: Any
    others: Any
    base: Mapping[Key, Array]
    fields: Mapping[Key, Array]
    base_bound: Mapping[Key, Array] | None
    fields_bound: Mapping[Key, Array] | None
    engine: str


def available() -> tuple[str, ...]:
    """The engines that can be used here, the fastest first."""
    return ENGINES if find_spec("numba") else ENGINES[1:]


def threads(workers: int | None) -> int:
    """The number of threads asked for; None: one for each core there is."""
    if workers is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else os.cpu_count() or 1
        )
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= 1024:
        raise ValueError(f"workers: got {workers!r}, expected a number of threads from 1")
    return workers


def prepared(
    scene: Particles,
    kernel: Kernel,
    keys: Iterable[Key] = (),
    *,
    fields: object = (),
    field_keys: Iterable[Key] = (),
    difference: bool = False,
    targets: object = None,
    precision: str = "plain",
    bound: bool = False,
    quantum: float = 0.0,
    workers: int | None = None,
    engine: str | None = None,
) -> Work:
    """One pass over the pairs of an explicit scene, before it is made.

    keys: base sums (δ, α), as from `Operator.needed`
    fields: values at the particles, (n,) or (F, n); field_keys: the (δ, α) they are summed with
    difference: A_b − A_a in place of A_b
    targets: indices (T,), None for all
    precision: "plain" or "compensated"; bound: add bounds of all rounding errors
    quantum: relative error that the positions came with, 2⁻²⁴ for single precision; the bound
        carries it
    workers: threads, None for all cores; the results do not depend on it
    engine: "numba" or "numpy"; None: Numba if it is there and the scene is large enough to be worth
        the compilation

    Raises ValueError for fields of a wrong shape or not finite, targets that are no particles, an
    unknown engine, and where the box is smaller than twice the support.
    """
    scene = scene.in_plain_units()
    keys, field_keys = list(keys), list(field_keys)
    values = _field_values(fields, scene.population)
    if precision not in ("plain", "compensated"):
        raise ValueError(f"precision: got {precision!r}, expected plain or compensated")
    zero = (0,) * scene.dim
    task = plan_for(
        scene,
        kernel,
        [*needed_terms(keys, len(values), field_keys), Term(COUNT, zero, -1)],
        fields=len(values),
        difference=difference,
        compensated=precision == "compensated",
        bound=bound,
        quantum=quantum,
    )
    return work(scene, kernel, task, values, targets, keys, field_keys, workers, engine)


def one_pass(scene: Particles, kernel: Kernel, keys: Iterable[Key] = (), **options: Any) -> Pass:
    """The pass that is `prepared`, whose arguments these are; its sums are read by `Pass.sums`."""
    return prepared(scene, kernel, keys, **options).run()


def plan_for(scene: Particles, kernel: Kernel, terms: Iterable[Term] = (), **more: Any) -> Plan:
    """The plan of these terms on particles of one h or several, in a box or in the open."""
    mode = "one" if scene.one_h else scene.mode
    return plan(kernel, scene.dim, terms, mode=mode, low=scene.period is not None, **more)


def work(
    scene: Particles,
    kernel: Kernel,
    task: Plan,
    values: Sequence[Array] | Array,
    targets: object,
    keys: list[Key],
    field_keys: list[Key],
    workers: int | None,
    engine: str | None,
) -> Work:
    """A plan on the particles, by the engine that is asked for or pays.

    Raises ValueError for an engine that is not there.
    """
    names = available()
    if engine is not None and engine not in names:
        raise ValueError(f"engine: got {engine!r}, expected one of {', '.join(names)}")
    chosen, wanted = _targets(targets, scene.population)
    per_h = 1.0 / scene.h
    rows, reach, _ = columns(scene, kernel, task, values, per_h)
    name = engine or names[0 if scene.population >= _WORTH else -1]
    if name == "numba":
        from sphtrunc.experiment.engine import cells

        if engine is None and cells.crowd(rows[: scene.dim], reach) > _CROWD:
            name = "numpy"
    return Work(task, rows, per_h, reach, wanted, chosen, keys, field_keys, name, workers)


def pair_sums(
    scene: Particles, kernel: Kernel, keys: Iterable[Key] = (), **options: Any
) -> PairSums:
    """The sums of all targets in one pass, as it is `prepared`, whose arguments these are."""
    return one_pass(scene, kernel, keys, **options).sums()


@dataclass(frozen=True, eq=False)
class Work:
    """A pass over the pairs before it is made.

    columns: rows of the sources, particles first, then images; reach: (n,) or (1,)
    wanted: (n,) bool, None for all; targets: indices (T,), or the slice of all
    within: the cells that particles are sorted into; None: those for these particles
    """

    plan: Plan
    columns: tuple[Array, ...]
    per_h: Array
    reach: Array
    wanted: Any
    targets: Any
    keys: list[Key]
    field_keys: list[Key]
    engine: str
    workers: int | None
    within: Any = None

    def run(self) -> Pass:
        """Make it."""
        number = threads(self.workers)
        if self.engine == "numba":
            from sphtrunc.experiment.engine import cells

            out = cells.sums(
                self.plan, self.columns, self.per_h, self.reach, self.wanted, number, self.within
            )
        else:
            from sphtrunc.experiment.engine import tree

            out = tree.sums(self.plan, self.columns, self.per_h, self.reach, self.wanted, number)
        return Pass(
            self.plan, out, self.per_h, self.targets, self.keys, self.field_keys, self.engine
        )

    def cut(self, count: int) -> list[Any]:
        """Which of the targets, (T,) of them in all, are in each of so many slabs across the
        longest axis, as many in each."""
        along = self._along()
        targets = np.arange(self.per_h.size) if isinstance(self.targets, slice) else self.targets
        order = np.argsort(along[targets], kind="stable")
        return [np.sort(one) for one in np.array_split(order, max(1, min(count, order.size)))]

    def slab(self, which: Any) -> Work:
        """The work on one of `cut`, with the particles that its targets see and no others: its sums
        are those of the whole to the last bit.

        Raises ValueError for the NumPy engine, whose order of neighbours depends on all particles.
        """
        if self.engine != "numba":
            raise ValueError(
                "memory: slabs need the compiled engine; pip install 'sphtrunc[fast]', or leave it"
            )
        from sphtrunc.experiment.engine import cells

        x, n = self.columns[: self.plan.dim], self.per_h.size
        along = self._along()
        targets = which if isinstance(self.targets, slice) else self.targets[which]
        one_reach = self.reach.size == 1
        far = float((self.reach if one_reach else self.reach[targets]).max()) * REACH
        low, high = along[targets].min() - far, along[targets].max() + far
        seen = np.flatnonzero((along >= low) & (along <= high))
        own = seen[: np.searchsorted(seen, n)]
        local = np.searchsorted(own, targets)
        wanted = np.zeros(own.size, dtype=np.bool_)
        wanted[local] = True
        columns = tuple(row[seen] for row in self.columns)
        grid, _ = cells.grid_for(x, float(self.reach.max()))
        return replace(
            self,
            columns=columns,
            per_h=self.per_h[own],
            reach=self.reach if one_reach else self.reach[own],
            wanted=wanted,
            targets=local,
            within=cells.part_of(grid, columns[: self.plan.dim]),
        )

    def _along(self) -> Array:
        """Positions along the longest axis, images included."""
        x = self.columns[: self.plan.dim]
        return x[int(np.argmax([np.ptp(row) for row in x]))]


@dataclass(frozen=True)
class Pass:
    """What an engine summed, before it is read: radial sums in `rows`, (n, sums).

    targets: indices (T,), or the slice of all
    """

    plan: Plan
    rows: Array
    per_h: Array
    targets: Any
    keys: list[Key]
    field_keys: list[Key]
    engine: str

    def sums(self, part: slice = slice(None)) -> PairSums:
        """The sums of these targets; raises ValueError where they overflow."""
        everyone = isinstance(self.targets, slice)
        chosen = part if everyone else self.targets[part]
        index = np.arange(*part.indices(self.per_h.size)) if everyone else chosen
        return _gathered(
            self.plan,
            self.rows[chosen].T,
            self.per_h[chosen],
            index,
            self.keys,
            self.field_keys,
            self.engine,
        )


def _gathered(
    task: Plan,
    out: Array,
    per_h: Array,
    chosen: Any,
    keys: list[Key],
    field_keys: list[Key],
    engine: str,
) -> PairSums:
    """Base sums out of the rows of an engine, scaled by 1/h^d."""
    n = len(task.terms)
    high = out[:n] + out[n : 2 * n] if task.compensated else out[:n]
    scale = per_h.copy()
    for _ in range(task.dim - 1):
        scale *= per_h
    sums = {t: high[i] * (1.0 if t.k == COUNT else scale) for i, t in enumerate(task.terms)}
    if not all(np.all(np.isfinite(row)) for row in sums.values()):
        raise ValueError(
            "fields: the sums overflow; expected values, volumes and 1/h^d whose products stay"
            " below 1e308"
        )
    errors: dict[Term, Array] | None = None
    if task.bound:
        # compensated sums: γ² of what the terms add up to, and one rounding
        more = UNIT * (2.0 * task.dim + 4.0)
        inflation = 1.0 + 1e-9 + (1e-2 if task.compensated else 0.0)
        errors = {
            t: out[len(out) - n + i] * scale * inflation + more * np.abs(sums[t])
            for i, t in enumerate(task.terms)
        }
    count = range(task.fields)
    seen = sums[task.terms[-1]].astype(np.int64)

    def bound(key: Key, field: int) -> Array:
        assert errors is not None
        total: Array = UNIT * np.abs(base_sum(key, field, sums))
        for _, beta, k in parts(key):
            total = total + errors[Term(k, beta, field)]
        return total

    return PairSums(
        targets=chosen,
        neighbours=seen & (int(MOST) - 1),
        others=seen >> 26,
        base={key: base_sum(key, -1, sums) for key in keys},
        fields={key: np.stack([base_sum(key, f, sums) for f in count]) for key in field_keys},
        base_bound={key: bound(key, -1) for key in keys} if task.bound else None,
        fields_bound={key: np.stack([bound(key, f) for f in count]) for key in field_keys}
        if task.bound
        else None,
        engine=engine,
    )


def _field_values(fields: object, n: int) -> Array:
    """(F, n) float64."""
    values = np.asarray(fields, dtype=np.float64)
    values = values.reshape(0, n) if values.size == 0 else np.atleast_2d(values)
    if values.ndim != 2 or values.shape[1] != n:
        raise ValueError(f"fields: got shape {values.shape}, expected ({n},) or (F, {n})")
    if not np.all(np.isfinite(values)):
        raise ValueError("fields: got NaN or an infinity, expected finite values")
    return values


def _targets(targets: object, n: int) -> tuple[Any, Any]:
    """Indices (T,) and which particles they are, (n,) bool or None for all."""
    if targets is None:
        return slice(None), None
    chosen = np.asarray(targets)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu":
        raise ValueError("targets: expected a list of whole numbers, the indices of particles")
    if chosen.size and not (chosen.min() >= 0 and chosen.max() < n):
        raise ValueError(f"targets: got {chosen.min()} to {chosen.max()}, expected 0 to {n - 1}")
    wanted = np.zeros(n, dtype=np.bool_)
    wanted[chosen] = True
    return chosen.astype(np.int64), wanted


def pairs_with_terms(
    scene: Particles, kernel: Kernel, keys: list[Key], targets: Any
) -> tuple[Any, Any, Mapping[Key, Array]]:
    """Every pair within the support: number of the target in `targets`, particle, and for each
    (δ, γ) the term (−1)^{|δ|} V_b/h^d s^γ ∂^δŴ; (P,) each, a block of targets after the other."""
    from sphtrunc.experiment.engine import tree as neighbours

    scene = scene.in_plain_units()
    wanted = [*needed_terms(keys, 0, ()), Term(COUNT, (0,) * scene.dim, -1)]
    task = plan_for(scene, kernel, wanted)
    per_h = 1.0 / scene.h
    rows_of, reach, source = columns(scene, kernel, task, np.empty((0, scene.population)), per_h)
    scale = per_h**scene.dim
    rows, particles, found = [], [], []
    for block, i, j, terms in neighbours.listed(task, rows_of, per_h, reach, targets):
        sums = dict(zip(task.terms, terms, strict=True))
        inside = sums[task.terms[-1]] > 0.0
        here = targets[block[i[inside]]]
        rows.append(block[i[inside]])
        particles.append(j[inside] if source is None else source[j[inside]])
        found.append([base_sum(key, -1, sums)[inside] * scale[here] for key in keys])
    return (
        np.concatenate(rows),
        np.concatenate(particles),
        {key: np.concatenate([part[n] for part in found]) for n, key in enumerate(keys)},
    )
