"""Passes over the pairs of explicit particles: every sum that operators need, in one of them.

Two engines evaluate the same formula (`pairs`): one compiled by Numba (`cells`, the extra `fast`),
one on NumPy and SciPy (`neighbours`). Both sum the neighbours of a target in an order that depends
on the particles alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.arrays import MOST
from sphtrunc.arithmetic.summation import UNIT, Array, dd_add, two_sum
from sphtrunc.experiment.engine.pairs import (
    COUNT,
    Plan,
    Term,
    base_sum,
    needed_terms,
    plan,
)
from sphtrunc.operators.terms import Key, parts
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

ENGINES = ("numba", "numpy")
_REACH = 1.0 + 1e-12  # what is looked at beyond the support: the formula decides what is inside
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


def one_pass(
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
) -> Pass:
    """One pass over the pairs of an explicit scene; its sums are read out by `Pass.sums`.

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
    return prepared(
        scene, kernel, keys, fields=fields, field_keys=field_keys, difference=difference,
        targets=targets, precision=precision, bound=bound, quantum=quantum, workers=workers,
        engine=engine,
    ).run()  # fmt: skip


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
    """The work of `one_pass`, whose arguments these are, before it is done."""
    scene = scene.in_plain_units()
    keys, field_keys = list(keys), list(field_keys)
    values = _field_values(fields, scene.population)
    if precision not in ("plain", "compensated"):
        raise ValueError(f"precision: got {precision!r}, expected plain or compensated")
    zero = (0,) * scene.dim
    task = plan(
        kernel,
        scene.dim,
        [*needed_terms(keys, len(values), field_keys), Term(COUNT, zero, -1)],
        fields=len(values),
        difference=difference,
        mode="one" if scene.one_h else scene.mode,
        low=scene.period is not None,
        compensated=precision == "compensated",
        bound=bound,
        quantum=quantum,
    )
    return _work(scene, kernel, task, values, targets, keys, field_keys, workers, engine)


def _work(
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
    columns, reach, _ = _columns(scene, kernel, task, values, per_h)
    name = engine or names[0 if scene.population >= _WORTH else -1]
    if name == "numba":
        from sphtrunc.experiment.engine import cells

        if engine is None and cells.crowd(columns[: scene.dim], reach) > _CROWD:
            name = "numpy"
    return Work(task, columns, per_h, reach, wanted, chosen, keys, field_keys, name, workers)


@dataclass(frozen=True, eq=False)
class Grouped:
    """Sums as an engine left them, (n, sums), read out a part of the targets at a time.

    scale: (T,) 1/h^d; sign: (G,) of the sums that are read; targets: indices (T,), or all
    """

    rows: Array
    scale: Array
    sign: Array
    targets: Any

    def block(self, part: slice) -> Array:
        """(G, T) of these targets, in units of h."""
        rows = self.rows[part] if isinstance(self.targets, slice) else self.rows[self.targets[part]]
        found = np.array(rows[:, : self.sign.size].T, order="C")
        found *= self.scale[part]
        found *= self.sign[:, None]
        return found

    @property
    def neighbours(self) -> int:
        """How many a target has at most: the last of the rows counts them."""
        seen = self.rows[self.targets, -1].astype(np.int64) & (int(MOST) - 1)
        return int(seen.max(initial=0))


def grouped(
    scene: Particles,
    kernel: Kernel,
    fields: Sequence[Array],
    groups: Sequence[Sequence[tuple[Key, int]]],
    *,
    targets: object = None,
    workers: int | None = None,
    engine: str | None = None,
) -> Grouped:
    """Σ_b Σ (key) A_b of each group of (key, number of the field), without volumes.

    fields: (n,) each; keys: of at most one derivative, all of a group of the same order
    """
    scene = scene.in_plain_units()
    terms = [tuple(_term(key, field) for key, field in group) for group in groups]
    count = (Term(COUNT, (0,) * scene.dim, -1),)
    task = _grouped_plan(scene, kernel, groups=[*terms, count], fields=len(fields))
    done = _work(scene, kernel, task, fields, targets, [], [], workers, engine).run()
    sign = np.array([(-1.0) ** sum(group[0][0][0]) for group in groups])
    return Grouped(done.rows, done.per_h[done.targets] ** scene.dim, sign, done.targets)


def sizes(
    scene: Particles,
    kernel: Kernel,
    fields: Sequence[Array],
    keys: Iterable[Key],
    room: int,
    *,
    targets: object = None,
    workers: int | None = None,
    engine: str | None = None,
) -> Grouped:
    """A bound of what rounding makes of Σ_b (key) A_b for any of the keys and any |A| <= the field,
    of every field: that of the pair formula, and `room` more roundings of every term, u each.

    fields: (n,) each, not negative
    """
    scene = scene.in_plain_units()
    zero = (0,) * scene.dim
    task = _grouped_plan(
        scene,
        kernel,
        terms=dict.fromkeys(_term(key, -1) for key in keys),
        groups=[(Term(COUNT, zero, i),) for i in range(len(fields))],
        fields=len(fields),
        room=room,
    )
    done = _work(scene, kernel, task, fields, targets, [], [], workers, engine).run()
    more = np.full(len(fields), 1.0 + 1e-9)
    return Grouped(done.rows, done.per_h[done.targets] ** scene.dim, more, done.targets)


def _term(key: Key, field: int) -> Term:
    ((_, beta, k),) = parts(key)
    return Term(k, beta, field)


def _grouped_plan(
    scene: Particles, kernel: Kernel, terms: Iterable[Term] = (), **more: Any
) -> Plan:
    return plan(
        kernel,
        scene.dim,
        terms,
        mode="one" if scene.one_h else scene.mode,
        low=scene.period is not None,
        **more,
    )


def pair_sums(
    scene: Particles, kernel: Kernel, keys: Iterable[Key] = (), **options: Any
) -> PairSums:
    """The sums of all targets of `one_pass`, whose arguments these are."""
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
        far = float((self.reach if one_reach else self.reach[targets]).max()) * _REACH
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


def volumes(scene: Particles, kernel: Kernel) -> Array:
    """V_b of every particle, (n,), by the rule of the scene."""
    if scene.given is not None:
        return scene.given
    return scene._cells() if scene.volume == "cell" else scene._summed(kernel)[0]


def _columns(
    scene: Particles, kernel: Kernel, task: Plan, values: Sequence[Array] | Array, per_h: Array
) -> tuple[tuple[Array, ...], Array, Any]:
    """Rows of the sources, images of a periodic box included; how far each target looks; which
    particle each source is, None where there are no images."""
    support = float(kernel.support)
    h = scene.h
    if scene.one_h:
        reach = h[:1] if np.all(h == h[0]) else h
    else:
        reach = 0.5 * (h + h.max()) if scene.mode == "mean" else np.full(1, h.max())
    # positions carry their own rounding where they are far from the origin of the box
    closed = np.empty(0) if scene.period is None else scene.period[np.isfinite(scene.period)]
    spread = max(float(np.abs(scene.x).max()), float(closed.max(initial=0.0)))
    reach = support * reach * _REACH + 4.0 * UNIT * spread
    volume = volumes(scene, kernel)
    extra = [per_h] if task.mode != "one" else []
    if scene.period is None:
        return (*scene.x, volume, *values, *extra), reach, None
    widest = float(reach.max())
    if np.any(scene.period <= 2.0 * widest):
        raise ValueError(
            f"period: got {scene.period.tolist()}, expected more than twice the support,"
            f" {2.0 * widest:g}: a particle would meet its own image"
        )
    places, source = _with_images(scene.x, scene.period, widest)
    return (*places, *(row[source] for row in (volume, *values, *extra))), reach, source


def _with_images(x: Array, period: Array, reach: float) -> tuple[list[Array], Any]:
    """Positions in the box as pairs of floats (d high, d low), then the images within `reach` of
    it, and which particle each one is."""
    high, low = [], []
    for row, box in zip(x, period, strict=True):
        if np.isinf(box):  # an open axis
            high.append(row)
            low.append(np.zeros_like(row))
            continue
        turns = np.floor(row / box)
        # row − turns·box without error: the product of a small integer and a float in two parts
        big = turns * box
        rest = _product_rest(turns, float(box), big)
        hi, lo = dd_add(two_sum(row, -big), (-rest, np.zeros_like(rest)))
        high.append(hi)
        low.append(lo)
    parts_high, parts_low = [np.stack(high)], [np.stack(low)]
    source = [np.arange(x.shape[1])]
    for shift in product(*((0,) if np.isinf(side) else (-1, 0, 1) for side in period)):
        if not any(shift):
            continue
        near = np.ones(x.shape[1], dtype=np.bool_)
        for i, k in enumerate(shift):
            if k:
                near &= high[i] < reach if k > 0 else high[i] >= period[i] - reach
        which = np.flatnonzero(near)
        if not which.size:
            continue
        moved_high, moved_low = parts_high[0][:, which].copy(), parts_low[0][:, which].copy()
        for i, k in enumerate(shift):
            if k:
                both = (moved_high[i], moved_low[i])
                box = np.full(which.size, k * period[i])
                moved_high[i], moved_low[i] = dd_add(both, (box, np.zeros_like(box)))
        parts_high.append(moved_high)
        parts_low.append(moved_low)
        source.append(which)
    places = [*np.concatenate(parts_high, axis=1), *np.concatenate(parts_low, axis=1)]
    return places, np.concatenate(source)


def _product_rest(a: Array, b: float, product_: Array) -> Array:
    """a·b − fl(a·b)."""
    from sphtrunc.arithmetic.summation import two_product

    high, rest = two_product(a, np.full_like(a, b))
    return np.asarray(rest + (high - product_))


def pairs_with_terms(
    scene: Particles, kernel: Kernel, keys: list[Key], targets: Any
) -> tuple[Any, Any, Mapping[Key, Array]]:
    """Every pair within the support: number of the target in `targets`, particle, and for each
    (δ, γ) the term (−1)^{|δ|} V_b/h^d s^γ ∂^δŴ; (P,) each, a block of targets after the other."""
    from sphtrunc.experiment.engine import tree as neighbours

    scene = scene.in_plain_units()
    task = plan(
        kernel,
        scene.dim,
        [*needed_terms(keys, 0, ()), Term(COUNT, (0,) * scene.dim, -1)],
        mode="one" if scene.one_h else scene.mode,
        low=scene.period is not None,
    )
    per_h = 1.0 / scene.h
    columns, reach, source = _columns(scene, kernel, task, np.empty((0, scene.population)), per_h)
    scale = per_h**scene.dim
    rows, particles, found = [], [], []
    for block, i, j, terms in neighbours.listed(task, columns, per_h, reach, targets):
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
