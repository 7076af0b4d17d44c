"""Snapshot: what the columns of a file mean, decided by one rule for all formats.

Columns by the table of names, the dimension from the coordinates that vary, particles outside a
periodic box taken at their images, every number checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.arithmetic.summation import Array
from sphtrunc.scenes.particles import Particles, particles
from sphtrunc.scenes.snapshots.columns import AXES, QUANTITIES, assigned, listed
from sphtrunc.scenes.snapshots.table import Box, Table
from sphtrunc.scenes.spacing import coincident

_POSITIVE = ("h", "volume", "mass", "density")
_MOST_TURNS = 1 << 20  # boxes that a particle may be away from its own
_SINGLE = 2.0**-24  # relative rounding of single precision


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """The particles of a file.

    x: (d, n) coordinates along `axes`; fields: quantity -> (n,), or (d, n) for vectors, or (F, n)
        for `values`, in the units of the file
    counts: kind -> how many the file holds; kinds: (n,) of those read, an index into `names`
    target: (n,) which particles are targets: boundary and ghost particles are sources alone
    box: along `axes`, None where there is none; kernel: as the header names it; h: its one h
    notes: what was decided, a sentence each; ignored: columns that mean nothing here
    """

    format: str
    code: str | None
    axes: tuple[str, ...]
    x: Array
    fields: Mapping[str, Array]
    counts: Mapping[str, int]
    kinds: NDArray[np.int64]
    names: tuple[str, ...]
    target: NDArray[np.bool_]
    box: Box | None
    kernel: str | None
    notes: tuple[str, ...]
    ignored: tuple[str, ...] = ()
    _known: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def dim(self) -> int:
        """d."""
        return len(self.axes)

    @property
    def count(self) -> int:
        """n, the number of particles read."""
        return int(self.x.shape[1])

    @property
    def period(self) -> Array | None:
        """(d,) lengths of the periodic box, infinite where it is open; None where all of it is."""
        if self.box is None or not np.any(self.box.periodic):
            return None
        return np.where(self.box.periodic, self.box.size, np.inf)

    def _share(self) -> float:
        """The volume of the box over the number of particles."""
        if self.period is None or not np.all(np.isfinite(self.period)):
            raise ValueError(
                "volume: constant is that of the box over the number of particles; expected a"
                " period along every axis, or another volume"
            )
        return float(np.prod(self.period)) / self.count

    def duplicates(self) -> str | None:
        """How many particles coincide, and the first two that do; None where none do."""
        number, first = coincident(self.x, self.period)
        if first is None:
            return None
        return (
            f"particles: {number} of {self.count} are where another one is"
            f"{'' if self.period is None else ', modulo the period'}; the first are"
            f" {first[0]} and {first[1]}, counted from 0"
        )

    def particles(
        self,
        *,
        h: object = None,
        volume: str | None = None,
        mode: str = "gather",
        allow_duplicates: bool = False,
    ) -> Particles:
        """The scene that the particles are.

        h: in place of the file's; volume: "summation", "cell" or "constant" (the box over the
            number) in place of what the file says: its volume, or m/ρ, or m and the summed density
        allow_duplicates: take particles that coincide

        Raises ValueError where there is no h, and where particles coincide.
        """
        length = self.fields.get("h") if h is None else h
        if length is None:
            raise ValueError(
                "h: the file has no smoothing length; expected --h H, or --columns h=NAME if it"
                " has one by another name"
            )
        duplicates = None if allow_duplicates else self.duplicates()
        if duplicates is not None:
            raise ValueError(f"{duplicates}; remove them, or say --allow-duplicates")
        given: dict[str, Any] = {}
        known = self.fields
        if volume is not None:
            if volume not in ("cell", "summation", "constant"):
                raise ValueError(
                    f"volume: got {volume!r}, expected constant, cell, summation, or None for what"
                    " the file says"
                )
            by_mass = volume == "summation" and "mass" in known
            given = {"mass": known["mass"]} if by_mass else {"volume": volume}
            if volume == "constant":
                given = {"volume": self._share()}
        elif "volume" in known:
            given = {"volume": known["volume"]}
        elif "mass" in known:
            given = {name: known[name] for name in ("mass", "density") if name in known}
        scene = particles(self.x.T, h=length, period=self.period, mode=mode, **given)
        return replace(
            scene, walls=None if np.all(self.target) else ~self.target, fields=dict(known)
        )


def snapshot_of(
    table: Table,
    *,
    dim: int | None = None,
    columns: Mapping[str, str] | None = None,
    period: object = None,
    h: float | None = None,
) -> Snapshot:
    """The snapshot that a table is.

    dim: what the dimension has to be; columns: quantity -> name of its column
    period: lengths of the box in place of the file's, inf along open axes; "none": no period
    h: in place of the file's

    Raises ValueError for columns that are missing or mean the same, for a dimension that is not
    that of the particles, and for numbers that are not finite, or not positive where they have to
    be, with their row and column.
    """
    arrays = {
        name: a[:, 0] if a.ndim == 2 and a.shape[1] == 1 else a for name, a in table.arrays.items()
    }
    sizes = {name: len(a) for name, a in arrays.items() if a.ndim}
    widths = {name: a.shape[1] if a.ndim == 2 else 1 for name, a in arrays.items()}
    found, ignored = assigned(widths, columns or {})
    if "position" not in found and "x" not in found:
        raise ValueError(
            f"x: no column holds positions; there are {listed(arrays) or 'no columns'};"
            " say which, --columns x=NAME,y=NAME"
        )
    n = sizes[found.get("position", found.get("x", ""))]
    if n == 0:
        raise ValueError("it has no particles")
    for quantity, name in found.items():
        if sizes.get(name, 0) != n:
            raise ValueError(
                f"{name[:40]} ({quantity}): {sizes.get(name, 0):,} rows, expected {n:,}"
            )
    notes = list(table.notes)
    coordinates, single = _coordinates(found, arrays)
    if len({len(c) for c in coordinates.values()}) != 1:
        raise ValueError("x, y, z: expected as many of each")
    for axis, column in coordinates.items():
        _finite(axis, found.get(axis, found.get("position", axis)), column)
    axes = _axes(coordinates, dim, notes)
    x = np.stack([coordinates[axis] for axis in axes])
    fields = _fields(found, arrays, axes, list(coordinates))
    if table.h is not None and "h" not in fields:
        fields["h"] = np.full(n, table.h)
        notes.append(f"h = {table.h:.7g} for all, from the header")
    if h is not None:
        if "h" in fields:
            notes.append(f"h = {h:.7g} as given; that of the file is not used")
        fields["h"] = np.full(n, h)
    _check(fields, found)
    box = _box(table.box, axes, period, notes)
    if box is not None:
        x, outside = _wrapped(x, box)
        if outside:
            notes.append(f"{outside} particles lie outside the periodic box: taken at their images")
    if single:
        size = float(np.abs(x).max())
        notes.append(
            f"positions are in single precision: offsets are known to {_SINGLE * size:.1e}"
        )
    ghosts = np.zeros(n, bool) if table.ghosts is None else np.asarray(table.ghosts)
    kinds = np.zeros(n, np.int64) if table.kinds is None else np.asarray(table.kinds)
    if len(kinds) != n or len(ghosts) != n:
        raise ValueError("the kinds of the particles are not as many as the particles")
    wall = np.array([name in table.walls for name in table.names])[kinds]
    if np.any(wall):
        notes.append(f"{np.count_nonzero(wall):,} boundary particles are sources, no targets")
    target = ~(wall | ghosts)
    if not np.any(target):
        raise ValueError("it has boundary particles alone, and so no targets")
    held = np.bincount(kinds, minlength=len(table.names)).tolist()
    return Snapshot(
        format=table.format,
        code=table.code,
        axes=axes,
        x=x,
        fields=fields,
        counts=table.counts or dict(zip(table.names, held, strict=True)),
        kinds=kinds,
        names=tuple(table.names),
        target=target,
        box=box,
        kernel=table.kernel,
        notes=tuple(notes),
        ignored=tuple(ignored),
    )


def _coordinates(
    found: Mapping[str, str], arrays: Mapping[str, NDArray[Any]]
) -> tuple[dict[str, Array], bool]:
    """axis -> (n,), and whether they were in single precision."""
    if "position" in found:
        position = arrays[found["position"]]
        position = position[:, None] if position.ndim == 1 else position
        if not 1 <= position.shape[1] <= 3:
            raise ValueError(
                f"{found['position'][:40]}: got shape {position.shape}, expected (n, d)"
            )
        columns = dict(zip(AXES, position.T, strict=False))
    else:
        columns = {axis: arrays[found[axis]] for axis in AXES if axis in found}
    single = any(c.dtype == np.float32 for c in columns.values())
    return {axis: c.astype(np.float64) for axis, c in columns.items()}, single


def _axes(coordinates: Mapping[str, Array], dim: int | None, notes: list[str]) -> tuple[str, ...]:
    """The axes along which the particles spread."""
    constant = [a for a, c in coordinates.items() if c.size > 1 and bool(np.all(c == c[0]))]
    axes = tuple(a for a in coordinates if a not in constant)
    said = " and ".join(f"{a} = {coordinates[a][0]:g}" for a in constant)
    if not axes:
        raise ValueError(f"all particles are at one place, {said}")
    if dim is not None and dim != len(axes):
        spread = f"the particles have {', '.join(axes)}" + (
            f" and {said} throughout" if constant else ""
        )
        raise ValueError(f"dim: got {dim}, and {spread}: they are in {len(axes)}D")
    if constant:
        notes.append(f"{said} throughout: the particles are in {len(axes)}D, {', '.join(axes)}")
    return axes


def _fields(
    found: Mapping[str, str],
    arrays: Mapping[str, NDArray[Any]],
    axes: tuple[str, ...],
    all_axes: list[str],
) -> dict[str, Array]:
    """quantity -> (n,) or (d, n), floats."""
    fields: dict[str, Array] = {}
    for quantity, name in found.items():
        whole, _, part = quantity.partition(".")
        if whole in AXES or whole in ("position", "id"):
            continue
        array = np.asarray(arrays[name], dtype=np.float64)
        if part:
            continue
        if array.ndim == 2:
            if QUANTITIES[whole][0] == 3 and array.shape[1] in (len(all_axes), len(AXES)):
                array = array[:, [AXES.index(axis) for axis in axes]]
            array = array.T
        fields[whole] = np.ascontiguousarray(array)
    for whole in ("velocity", "acceleration"):
        parts = [found.get(f"{whole}.{AXES.index(axis)}") for axis in axes]
        if whole not in fields and all(parts):
            fields[whole] = np.stack([np.asarray(arrays[str(p)], np.float64) for p in parts])
    return fields


def _finite(quantity: str, name: str, values: Array) -> None:
    """Raises ValueError for the first number that is not finite, with its row and column."""
    if np.all(np.isfinite(values)):
        return
    flat = np.atleast_2d(values)
    row, part = (int(i) for i in np.argwhere(~np.isfinite(flat.T))[0])
    raise ValueError(
        f"{quantity}: {flat[part, row]} in row {row + 1}, column {name[:40]!r}"
        f"{f', component {part}' if len(flat) > 1 else ''}; expected finite numbers"
    )


def _check(fields: Mapping[str, Array], found: Mapping[str, str]) -> None:
    """Raises ValueError for numbers that are not finite, or not positive where they have to be."""
    for quantity, values in fields.items():
        name = found.get(quantity, quantity)
        _finite(quantity, name, values)
        if quantity in _POSITIVE:
            bad = np.flatnonzero(~(values > 0))
            if bad.size:
                raise ValueError(
                    f"{quantity}: {values[bad[0]]:g} in row {bad[0] + 1}, column {name[:40]!r}, and"
                    f" {bad.size - 1} more; expected positive numbers"
                )


def _box(box: Box | None, axes: tuple[str, ...], period: object, notes: list[str]) -> Box | None:
    """The box along the axes that are used, with the period that was asked for."""
    chosen = [AXES.index(axis) for axis in axes]
    if box is not None:
        box = Box(box.low[chosen], box.size[chosen], box.periodic[chosen])
    if period is None:
        return box
    if isinstance(period, str) and period == "none":
        return None if box is None else replace(box, periodic=np.zeros(len(axes), bool))
    sides = np.asarray(period, dtype=np.float64).reshape(-1)
    if sides.size not in (1, len(axes)) or not np.all(sides > 0):
        raise ValueError(
            f"period: got {sides[:4].tolist()}, expected one length or {len(axes)}, inf along"
            " open axes"
        )
    sides = np.broadcast_to(sides, (len(axes),))
    low = np.zeros(len(axes)) if box is None else box.low
    if box is not None and np.any(box.periodic):
        notes.append("the period as given; that of the file is not used")
    return Box(low, sides.copy(), np.isfinite(sides))


def _wrapped(x: Array, box: Box) -> tuple[Array, int]:
    """Positions with those outside a periodic box moved to their images, and how many these are."""
    safe = np.where(box.periodic, box.size, 1.0)[:, None]
    turns = np.floor((x - box.low[:, None]) / safe) * box.periodic[:, None]
    if not np.all(np.abs(turns) <= _MOST_TURNS):
        raise ValueError(
            f"box: sides {box.size.tolist()}, and particles lie more than {_MOST_TURNS:,} of them"
            " away; expected the box of these particles"
        )
    # the far side of the box is the near one: nobody has to be moved for that
    turns = np.where(x == (box.low + np.where(box.periodic, box.size, 0.0))[:, None], 0.0, turns)
    outside = np.any(turns != 0.0, axis=0)
    return np.where(turns != 0.0, x - turns * safe, x), int(np.count_nonzero(outside))
