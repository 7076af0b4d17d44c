"""The nested form on particles: the gradient at every neighbour of a target, then the gradient of
these gradients,

    ⟨∂ᵢ⟨∂ⱼA⟩⟩_a = Σ_b G_ab,i (⟨∂ⱼA⟩_b − ⟨∂ⱼA⟩_a),   ⟨∂ⱼA⟩_b = Σ_c G_bc,j (A_c − A_b).

Of the neighbours of neighbours only those are made that there are. On a lattice with one particle
in its cell all neighbours see the same, and one stencil serves them all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import isinf
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.exact import Exact
from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.arithmetic.rational import fraction, fractions
from sphtrunc.arithmetic.summation import UNIT, Array, dd, dd_add, dd_div, two_sum
from sphtrunc.experiment.neighbour_sums import Weights
from sphtrunc.operators.corrections import combine, shifted
from sphtrunc.operators.moments import MultiIndex, add, multi_indices
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.neighbourhood import (
    CELLS,
    EDGE,
    Beside,
    Indices,
    Neighbourhood,
    Stretches,
    compact,
)
from sphtrunc.scenes.particles import Particles
from sphtrunc.scenes.scene import Scene
from sphtrunc.scenes.sites import KINDS

if TYPE_CHECKING:
    from sphtrunc.experiment.task import Task
    from sphtrunc.kernels.kernel import Kernel


@dataclass(frozen=True, kw_only=True)
class View:
    """What R of the N neighbours of T targets see: M neighbours of their own, in an arithmetic.

    rows: which of the N; s: offsets from them along each axis, (M, R, T), in units of their own h,
    and volume, V/h^d: or shapes that broadcast to it
    stretches: as of `Neighbourhood`
    pair: which particles (c, b), (M, R, T) and (R, T), if explicit
    scale: h_b/h_a and its inverse, numbers (R, T), where the smoothing lengths differ, else None
    """

    rows: slice
    s: list[Any]
    volume: Any
    stretches: Stretches = (None,)
    pair: tuple[Indices, Indices] | None = None
    scale: tuple[Any, Any] | None = None


def estimate(
    task: Task,
    number: Any,
    block: Neighbourhood,
    s: list[Any],
    volume: Any,
    owns: Sequence[Any],
    health: Health,
) -> tuple[list[list[Any]], dict[MultiIndex, Any]]:
    """Components for each field of a task, [field][component], and moments, (T,).

    s, volume: of the block as numbers; owns: what the fields have drawn for the targets

    Raises ValueError where the arithmetic asks for more than the scene can give.
    """
    kernel, operator, fields, degree = task.kernel, task.operator, task.fields, task.degree
    if block.ghosts is not None:
        raise ValueError(
            "ghosts: the nested form has gradients at the ghosts as well, which are not given by"
            " their values; expected none, or the form brookshaw"
        )
    gradient, dim = operator.gradient, len(s)
    alphas = [] if degree is None else list(multi_indices(dim, degree))
    axes = operator.axes(dim)

    def slopes(weights: Weights, well: Health) -> tuple[list[Any], list[Any]]:
        """The coefficients and the moments of the gradient, [axis]."""
        parts, sums = weights.coefficients(well)
        found = []
        for part in parts:
            keys = [(delta, add(alpha, gamma)) for delta, gamma in part for alpha in alphas]
            sums |= {key: weights.total(key) for key in keys if key not in sums}
            moments = {a: combine(part, sums, a) for a in alphas}
            found.append({a: m if any(a) else 0 for a, m in moments.items()})
        return parts, found

    def applied(weights: Weights, part: Any, factor: Any) -> Any:
        return sum(x * weights.total(key, factor) for key, x in part.items())

    stretched = block.stretches(number)
    here = Weights(number, s, volume, kernel, gradient, stretched)
    outer, own_moments = slopes(here, health)
    own = []
    for one, drawn in zip(fields, owns, strict=True):
        difference = one.at(number, block, s, drawn).difference
        own.append([applied(here, part, difference) for part in outer])
    parts: list[list[Any]] = [[0 for _ in axes] for _ in fields]
    moments: dict[MultiIndex, Any] = dict.fromkeys(alphas, 0)
    for view in views(number, task.scene, kernel, block):
        rows = view.rows
        near = [x[rows] for x in s]
        shared = np.shape(block.volume)[0] == 1
        some = tuple(x if x is None else x[rows] for x in stretched)
        at = Weights(number, near, volume if shared else volume[rows], kernel, gradient, some)
        well = Health()
        there = Weights(number, view.s, view.volume, kernel, gradient, view.stretches)
        inner, seen = slopes(there, well)
        _worst(health, well, block, rows, float(kernel.support))
        t, back = view.s, None
        if view.scale is not None:
            ratio, back = view.scale
            t = [x * ratio for x in t]
            for by_alpha in seen:
                for alpha in alphas:
                    for _ in range(sum(alpha) - 1):
                        by_alpha[alpha] = by_alpha[alpha] * ratio
        for f, (one, drawn) in enumerate(zip(fields, owns, strict=True)):
            difference = one.between(number, near, t, drawn, view.pair)
            rise = []
            for j, part in enumerate(inner):
                g = applied(there, part, difference)
                rise.append((g if back is None else g * back) - own[f][j])
            for c, row in enumerate(axes):
                for i, j in row:
                    parts[f][c] = parts[f][c] + applied(at, outer[i], rise[j])
        powers = {alpha: at.monomial(alpha) for alpha in alphas}
        for alpha in alphas[1:]:
            for i, j in axes[0]:
                rise_j = shifted(powers, seen[j], alpha) - own_moments[j][alpha]
                moments[alpha] = moments[alpha] + applied(at, outer[i], rise_j)
    zeros = number.number(np.zeros(block.target.shape))
    parts = [[zeros if isinstance(x, int) else x for x in row] for row in parts]
    return parts, {a: zeros if isinstance(m, int) else m for a, m in moments.items()}


def _worst(health: Health, well: Health, block: Neighbourhood, rows: slice, support: float) -> None:
    """The condition of a target is the worst among those of its neighbours and its own."""
    inside = block.distance[rows] < support
    condition = np.where(inside, well.condition, 0.0)
    health.condition = np.maximum(health.condition, condition.max(axis=0, initial=0.0))


# -------------------------------------------------------------------- neighbours of neighbours


def views(number: Any, scene: Scene, kernel: Kernel, block: Neighbourhood) -> Iterator[View]:
    """What the neighbours of a block see, a few of them at a time: how many, and so every sum,
    depends on the scene alone."""
    rows, count = max(1, CELLS // max(1, scene.rows(kernel))), block.offset.shape[1]
    steps = [slice(first, min(first + rows, count)) for first in range(0, count, rows)]
    if isinstance(number, Exact):
        yield from _exact_views(number, scene, kernel, block)
        return
    if isinstance(scene, Particles):
        for part in steps:
            yield _of_particles(number, scene, kernel, block, part)
    elif isinstance(scene, Lattice) and scene.wall is None and KINDS[scene.kind].turned is None:
        home = replace(scene, offset=(Fraction(0),) * scene.dim)
        around = _shaped(home.neighbourhood(np.zeros(1, dtype=np.int64), kernel, number), (1, 1))
        for part in steps:
            yield View(rows=part, s=around.offsets(number), volume=around.volumes(number))
    else:
        wide = scene.neighbourhood(block.target, kernel, number, reach=2)
        for part in steps:
            seen = _seen_from(number, block, wide, part, float(kernel.support))
            yield View(rows=part, s=seen.offsets(number), volume=seen.volumes(number))


def _shaped(block: Neighbourhood, shape: tuple[int, ...]) -> Neighbourhood:
    """The block with its targets in an array of that shape."""

    def shaped(values: Any, axes: int) -> Any:
        if values is None:
            return None
        wide = values.shape[axes - 1] == 1
        return values.reshape(*values.shape[: axes - 1], *((1,) * len(shape) if wide else shape))

    beside = block.beside
    return replace(
        block,
        offset=shaped(block.offset, 3),
        volume=shaped(block.volume, 2),
        particle=shaped(block.particle, 2),
        stretch=shaped(block.stretch, 2),
        beside=beside and Beside(*map(shaped, beside, (3, 2, 2))),
    )


def _seen_from(
    number: Any, block: Neighbourhood, wide: Neighbourhood, rows: slice, support: float
) -> Neighbourhood:
    """The particles of `wide` within the support of the neighbours `rows` of a block: s_c − s_b."""
    dim, here = block.offset.shape[0], block.offset[:, rows]
    shape = here.shape[1:]
    arrays: dict[str, Array] = {}
    distance: Any = 0.0
    for i in range(dim):
        t = wide.offset[i][:, None] - here[i]
        if wide.beside is not None and block.beside is not None:
            there, mine = wide.beside.offset[i][:, None], block.beside.offset[i][rows]
            if number.wide:
                both = two_sum(wide.offset[i][:, None], -here[i])
                t, arrays[f"beside{i}"] = dd_add(both, two_sum(there, -mine))
            else:
                arrays[f"beside{i}"] = (there + mine + UNIT * np.abs(t)) * EDGE
        arrays[f"s{i}"] = t
        distance = distance + t * t
    volumes = {"volume": wide.volume, "more": None if wide.beside is None else wide.beside.volume}
    for name, values in volumes.items():
        if values is not None and values.shape[0] > 1:
            arrays[name] = np.broadcast_to(values[:, None], distance.shape)
    itself = distance == 0.0
    itself &= itself.sum(axis=0) == 1  # b among the c: no error there
    for i in range(dim if number.bounded else 0):
        arrays[f"beside{i}"] = np.where(itself, 0.0, arrays[f"beside{i}"])
    flat = {name: values.reshape(len(values), -1) for name, values in arrays.items()}
    near = (distance <= (support * EDGE) ** 2).reshape(len(distance), -1)
    kept = {n: a.reshape(-1, *shape) for n, a in compact(near, flat, 2.0 * support + 1.0).items()}

    def of(name: str) -> Any:
        values = volumes[name]
        return kept.get(name, None if values is None else values[:, None])

    beside = None
    if wide.beside is not None:
        beside = Beside(np.stack([kept[f"beside{i}"] for i in range(dim)]), of("more"))
    return Neighbourhood(
        offset=np.stack([kept[f"s{i}"] for i in range(dim)]),
        volume=of("volume"),
        target=block.target,
        beside=beside,
    )


def _of_particles(
    number: Any,
    scene: Particles,
    kernel: Kernel,
    block: Neighbourhood,
    rows: slice,
) -> View:
    """Explicit particles are targets themselves."""
    assert block.particle is not None
    b = np.maximum(block.particle[rows], 0)
    seen = _shaped(scene.neighbourhood(b.ravel(), kernel, number), b.shape)
    assert seen.particle is not None
    scale = None
    if not np.all(scene.h == scene.h[0]):
        here, there = scene.h[block.target] + 0.0 * b, scene.h[b]
        scale = (_quotient(number, there, here), _quotient(number, here, there))
    return View(
        rows=rows,
        s=seen.offsets(number),
        volume=seen.volumes(number),
        stretches=seen.stretches(number),
        pair=(seen.particle, b),
        scale=scale,
    )


def _quotient(number: Any, x: Array, y: Array) -> Any:
    high, low = dd_div(dd(x), dd(y))
    return number.number(high, low, UNIT * high * EDGE)


def _exact_views(number: Any, scene: Scene, kernel: Kernel, block: Neighbourhood) -> Iterator[View]:
    """One neighbour after the other, all offsets differences of rationals."""
    if isinstance(scene, Particles) and not np.all(scene.h == scene.h[0]):
        raise ValueError("precision: exact needs one h for all particles in the nested form")
    target = int(block.target[0])
    near, _ = scene.exact_neighbourhood(target, kernel)
    wide, volume = scene.exact_neighbourhood(target, kernel, reach=2)
    most = fraction(kernel.support) ** 2
    box = None
    if isinstance(scene, Particles) and scene.period is not None:
        own = fractions(scene.h[:1])[0]
        box = [None if isinf(side) else Fraction(side) / own for side in scene.period.tolist()]
    for row, here in enumerate(near.T):
        t = wide - here[:, None]
        if box is not None:
            t = np.array(
                [
                    axis if side is None else [x - side * round(x / side) for x in axis]
                    for axis, side in zip(t, box, strict=True)
                ],
                dtype=object,
            )
        inside = (t * t).sum(axis=0) <= most
        yield View(
            rows=slice(row, row + 1),
            s=[number.number(x[inside][:, None]) for x in t],
            volume=number.number(volume[inside][:, None]),
        )
