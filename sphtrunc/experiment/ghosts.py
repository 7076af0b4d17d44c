"""Ghosts: the values that particles beyond a wall carry, and the moments they make.

A mirrored ghost has A(s*) of its original, an odd one 2 A_wall − A(s*), A_wall on the wall between
them; a dummy has Σ_c V A_c W(s_c − s_b) / Σ_c V W(s_c − s_b) over the fluid. Fields are read at
these places, so a moment M_α is what an estimate gives for the field s^α.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.fields import Field, Polynomial, Sample
from sphtrunc.kernels.values import kernel_values
from sphtrunc.operators.moments import MultiIndex, multi_indices
from sphtrunc.scenes.neighbourhood import Neighbourhood

if TYPE_CHECKING:
    from sphtrunc.experiment.task import Task


def sampled(
    task: Task, number: Any, block: Neighbourhood, s: list[Any], one: Field, own: Any
) -> Sample:
    """A field around the targets: at the particles, or where the ghosts among them read it."""
    ghosts = block.ghosts
    if ghosts is None:
        return one.at(number, block, s, own)
    if ghosts.kind == "dummy":
        return _extrapolated(task, number, block, s, one, own, ghosts.rows)
    image = number.number(ghosts.image, ghosts.beside, ghosts.beside)
    seen = one.at(number, block, [image, *s[1:]], own)
    if ghosts.kind == "mirror":
        return seen
    there = (*ghosts.wall, np.abs(ghosts.wall[1]))
    wall = number.number(*(np.atleast_2d(np.asarray(x, dtype=np.float64)) for x in there))
    foot = one.at(number, block, [wall + 0 * s[0], *s[1:]], own).difference
    beyond = number.drop(2 * foot - seen.difference, ~ghosts.rows)
    return replace(seen, difference=number.drop(seen.difference, ghosts.rows) + beyond)


def _extrapolated(
    task: Task,
    number: Any,
    block: Neighbourhood,
    s: list[Any],
    one: Field,
    own: Any,
    rows: Any,
) -> Sample:
    """Dummies with the Shepard mean of A_c − A_a over the fluid within their own supports."""
    scene: Any = task.scene
    wide = scene.bare().neighbourhood(block.target, task.kernel, number, reach=2)
    around, volume = wide.offsets(number), wide.volumes(number)
    difference = one.at(number, wide, around, own).difference
    here = one.at(number, block, s, own)
    total = number.drop(here.difference, rows)
    for b in np.flatnonzero(rows[:, 0]):
        t = [c - a[b] for c, a in zip(around, s, strict=True)]
        weight = kernel_values(number, task.kernel, number.length(t), 0, len(t)) * volume
        density = number.total(weight)
        # a dummy without fluid in its support is beyond that of the target, too
        density = density + number.number((number.value(density) <= 0.0).astype(np.float64))
        mean = number.ratio(number.dot(weight, difference), density)
        alone = np.arange(len(rows))[:, None] != b
        total = total + number.drop(mean + 0 * s[0], alone)
    return replace(here, difference=total)


def monomials(
    task: Task, number: Any, block: Neighbourhood, s: list[Any], degree: int
) -> Iterator[tuple[MultiIndex, Sample]]:
    """s^α around the targets for |α| <= degree."""
    for alpha in multi_indices(len(s), degree):
        yield alpha, sampled(task, number, block, s, Polynomial({alpha: 1.0}), None)
