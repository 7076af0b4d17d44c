"""Groups of sums that share a field or a factor: summed as one number each, without volumes, and
bounds of what rounding makes of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.arrays import MOST
from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.engine.pairs import COUNT, Term
from sphtrunc.experiment.engine.passes import plan_for, work
from sphtrunc.operators.terms import Key, parts
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


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
    task = plan_for(scene, kernel, groups=[*terms, count], fields=len(fields))
    done = work(scene, kernel, task, fields, targets, [], [], workers, engine).run()
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
    task = plan_for(
        scene,
        kernel,
        terms=dict.fromkeys(_term(key, -1) for key in keys),
        groups=[(Term(COUNT, zero, i),) for i in range(len(fields))],
        fields=len(fields),
        room=room,
    )
    done = work(scene, kernel, task, fields, targets, [], [], workers, engine).run()
    more = np.full(len(fields), 1.0 + 1e-9)
    return Grouped(done.rows, done.per_h[done.targets] ** scene.dim, more, done.targets)


def _term(key: Key, field: int) -> Term:
    ((_, beta, k),) = parts(key)
    return Term(k, beta, field)
