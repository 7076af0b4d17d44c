"""LAMMPS: text dumps, frames of ITEM sections; the last frame is read.

Thompson et al. (2022) doi:10.1016/j.cpc.2021.108171. Columns are named by the dump; xs is scaled by
the box, xu not wrapped into it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.table import Box, Budget, Table, whole
from sphtrunc.scenes.snapshots.vtk_legacy import numbers

SIGNATURE = b"ITEM: "
_FRAME = b"ITEM: TIMESTEP"


def read(path: Path, kind: str | None) -> Table:
    """The particles of the last frame."""
    data = path.read_bytes()
    frames = data.count(_FRAME)
    if not frames:
        raise ValueError("it has no ITEM: TIMESTEP")
    begin = data.rfind(_FRAME)
    sections = _sections(data[begin:])
    if any(name not in sections for name in ("NUMBER OF ATOMS", "BOX BOUNDS", "ATOMS")):
        raise ValueError(f"the last frame has only {', '.join(sections)}: it is truncated")
    _, lines = sections["NUMBER OF ATOMS"]
    count = whole("NUMBER OF ATOMS", lines.strip())
    box = _box(*sections["BOX BOUNDS"])
    names, body = sections["ATOMS"]
    words = body.split()
    if not names or len(words) != count * len(names):
        raise ValueError(
            f"{count:,} atoms with {len(names)} columns are {count * len(names):,} numbers, and"
            f" {len(words):,} are there"
        )
    Budget(path).take("ATOMS", len(words), 8)
    if len(set(names)) < len(names):
        raise ValueError("ATOMS: a column appears twice")
    step = sections.get("TIMESTEP", ([], b"?"))[1].decode("ascii", "replace").strip()[:20]
    arrays, kinds, labels = {}, None, ["1"]
    for i, name in enumerate(names):
        column = words[i :: len(names)]
        if name == "element":
            continue
        values = numbers(name, column, np.dtype("f8"))
        if name == "type":
            types, kinds = np.unique(values, return_inverse=True)
            labels = [f"{t:g}" for t in types]
        else:
            # a compute, a fix, a variable or a property of that name
            plain = name[2:] if name[:2] in ("c_", "f_", "v_", "d_") else name
            arrays[plain if plain not in names else name] = values
    arrays, notes = _positions(arrays, box)
    _forces(arrays, len(labels), notes)
    counts = None if kinds is None else dict(zip(labels, np.bincount(kinds).tolist(), strict=True))
    if kind is not None:
        if kind not in labels:
            raise ValueError(f"type: got {kind[:20]!r}, and there are {', '.join(labels)}")
        if kinds is not None:
            keep = kinds == labels.index(kind)
            arrays, kinds = {name: v[keep] for name, v in arrays.items()}, kinds[keep]
    if frames > 1:
        notes.append(f"the last of {frames} frames, step {step}")
    return Table(
        format="lammps",
        arrays=arrays,
        code="LAMMPS",
        kinds=kinds,
        names=labels,
        counts=counts,
        box=box,
        notes=notes,
    )


def _sections(data: bytes) -> dict[str, tuple[list[str], bytes]]:
    """Section -> (the words after its name, what stands below it)."""
    found: dict[str, tuple[list[str], bytes]] = {}
    for part in data.split(SIGNATURE)[1:]:
        head, _, body = part.partition(b"\n")
        line = head.decode("ascii", "replace").strip()
        if "ATOMS" in found:
            raise ValueError(f"ITEM: {line[:40]} after the atoms of a frame: it is damaged")
        for name in ("TIMESTEP", "NUMBER OF ATOMS", "BOX BOUNDS", "ATOMS"):
            if line == name or line.startswith(name + " "):
                found[name] = (line[len(name) :].split(), body)
                break
    return found


def _box(words: list[str], body: bytes) -> Box:
    flags = [word for word in words if len(word) == 2 and set(word) <= set("pfsm")]
    rows = [line.split() for line in body.splitlines() if line.strip()]
    if len(rows) != 3 or len(flags) != 3 or any(len(row) != 2 for row in rows):
        if any(len(row) == 3 for row in rows):
            raise ValueError("BOX BOUNDS: a tilted box is not supported")
        raise ValueError("BOX BOUNDS: expected three pairs of numbers, and pp, ff, … for each")
    sides = numbers("BOX BOUNDS", [word for row in rows for word in row], np.dtype("f8"))
    low, high = sides[::2], sides[1::2]
    if not np.all(np.isfinite(sides)) or not np.all(high > low):
        raise ValueError("BOX BOUNDS: expected low < high, finite")
    return Box(low.copy(), high - low, np.array([flag == "pp" for flag in flags]))


def _positions(
    arrays: dict[str, NDArray[Any]], box: Box
) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Coordinates as they are, or out of those scaled by the box."""
    notes = []
    for axis, letter in enumerate("xyz"):
        for suffix in ("su", "s"):
            name = f"{letter}{suffix}"
            if name in arrays and letter not in arrays and f"{letter}u" not in arrays:
                arrays[letter] = box.low[axis] + arrays[name] * box.size[axis]
                notes.append(f"{letter} is {name} times the box")
        if letter in arrays:
            for name in (f"{letter}u", f"{letter}s", f"{letter}su"):
                arrays.pop(name, None)
    return arrays, notes


def _forces(arrays: dict[str, NDArray[Any]], types: int, notes: list[str]) -> None:
    """Accelerations out of forces and masses; of particles of one type, the forces themselves."""
    names = [f"f{letter}" for letter in "xyz"]
    if not all(name in arrays for name in names) or ("mass" not in arrays and types > 1):
        return
    for name in names:
        with np.errstate(all="ignore"):  # a mass of zero is reported when masses are looked at
            arrays[f"a{name[1]}"] = arrays.pop(name) / arrays.get("mass", np.ones(1))
    if "mass" not in arrays:
        notes.append("no masses: forces are taken as accelerations of particles of mass 1")
