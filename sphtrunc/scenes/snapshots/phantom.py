"""Phantom: its HDF5 files, and its native dumps where sarracen is installed.

Price et al. (2018) doi:10.1017/pasa.2018.25: the density is ρ = m (hfact/h)^3, and particles with
h ≤ 0 are dead or accreted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.hdf5 import Group
from sphtrunc.scenes.snapshots.table import Box, Table

#: itype -> what it is called (part.F90 of Phantom)
TYPES = {1: "gas", 2: "dust", 3: "boundary", 4: "star", 5: "dark matter", 6: "bulge"}
#: 60769 in either byte order, with which a native dump begins, after the length of a record
NATIVE = (b"\x61\xed\x00\x00", b"\x00\x00\xed\x61", b"\x00\x00\x00\x00\x00\x00\xed\x61")


def recognises(root: Group) -> bool:
    """Whether the layout is this one."""
    return {"header", "particles"} <= set(root.names()) and "xyz" in root.group("particles")


def read(path: Path, root: Group, kind: str | None) -> Table:
    """The particles of an HDF5 file."""
    header = root.group("header")
    told: dict[str, float] = {}
    for name in (
        "hfact",
        "nparttot",
        *(f"{axis}{end}" for axis in "xyz" for end in ("min", "max")),
    ):
        if name in header and header.shape(name) in ((), (1,)):
            told[name] = float(header.array(name).reshape(-1)[0])
    masses = header.array("massoftype") if "massoftype" in header else np.empty(0)
    arrays = root.group("particles").arrays()
    return table(arrays, told, masses, header.text("fileident"), kind)


def native(path: Path, kind: str | None) -> Table:
    """The particles of a native dump, read by sarracen.

    Raises ValueError where sarracen is missing or cannot read it.
    """
    try:
        import sarracen
    except ImportError:
        raise ValueError(
            "a native dump of Phantom: reading it needs sarracen; install it with pip install"
            " sarracen"
        ) from None
    try:
        found = sarracen.read_phantom(str(path), separate_types="sinks", ignore_inactive=False)
    except Exception as error:
        raise ValueError(f"sarracen: {' '.join(str(error).split())[:120]}") from None
    frames = found if isinstance(found, list) else [found]
    arrays = {str(name): np.asarray(frames[0][name]) for name in frames[0].columns}
    parameters = {str(k): v for k, v in frames[0].params.items()}
    told = {k: float(v) for k, v in parameters.items() if np.ndim(v) == 0 and _is_number(v)}
    masses = [told.get("massoftype", 0.0)]
    masses += [told.get(f"massoftype_{n}", 0.0) for n in range(2, 57)]
    return table(arrays, told, np.array(masses), str(parameters.get("file_identifier", "")), kind)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number)


def table(
    arrays: dict[str, Any],
    told: Mapping[str, float],
    masses: NDArray[Any],
    identity: str,
    kind: str | None,
) -> Table:
    """What the particles are, by the rules of the code."""
    if "h" not in arrays or not ("xyz" in arrays or all(axis in arrays for axis in "xyz")):
        raise ValueError("particles/h or particles/xyz is missing")
    n = len(arrays["h"])
    if "nparttot" in told and told["nparttot"] != n:
        raise ValueError(f"the header counts {told['nparttot']:.0f} particles, and {n:,} are there")
    types = np.abs(np.asarray(arrays.pop("itype", np.ones(n)))).astype(np.int64).reshape(-1)
    if len(types) != n or (n and not (types.min() >= 1 and types.max() <= 56)):
        raise ValueError("particles/itype: expected one number from 1 to 56 for each particle")
    notes = []
    dead = ~(np.asarray(arrays["h"], dtype=np.float64) > 0) & np.isfinite(arrays["h"])
    present, number = np.unique(types, return_counts=True)
    counts = {TYPES.get(int(t), str(t)): int(c) for t, c in zip(present, number, strict=True)}
    keep = ~dead
    if np.any(dead):
        # unlike walls they are no sources either: Phantom takes them out of its neighbour lists,
        # and the mass of an accreted one is in its sink
        notes.append(
            f"{np.count_nonzero(dead)} dead or accreted particles (h ≤ 0) left out, as Phantom"
            " leaves them out of its sums"
        )
    if kind is not None:
        numbers = {name: number for number, name in TYPES.items()}
        wanted = numbers.get(kind, int(kind) if kind.isascii() and kind.isdigit() else 0)
        keep &= types == wanted
        if not np.any(keep):
            raise ValueError(f"type: no living particles of type {kind[:20]}; there are {counts}")
    arrays = {name: np.asarray(values)[keep] for name, values in arrays.items()}
    types = types[keep]
    if "mass" not in arrays and "m" not in arrays:
        if masses.size < (types.max() if types.size else 0):
            raise ValueError("header/massoftype is missing")
        arrays["mass"] = np.asarray(masses, dtype=np.float64)[types - 1]
    if "rho" not in arrays and "density" not in arrays and told.get("hfact", 0.0) > 0:
        mass = arrays["mass"] if "mass" in arrays else arrays["m"]
        arrays["rho"] = mass * (told["hfact"] / np.asarray(arrays["h"], dtype=np.float64)) ** 3
        notes.append(f"density is m (hfact/h)^3, hfact = {told['hfact']:.6g}")
    order = np.unique(types)
    low = np.array([told.get(f"{axis}min", np.nan) for axis in "xyz"])
    size = np.array([told.get(f"{axis}max", np.nan) for axis in "xyz"]) - low
    box = None
    x = arrays["xyz"] if "xyz" in arrays else np.stack([arrays[axis] for axis in "xyz"], axis=1)
    inside = np.all((x >= low) & (x <= low + size))  # a periodic run keeps its particles inside
    if np.all(np.isfinite(size)) and np.all(size > 0) and inside:
        box = Box(low, size, np.ones(3, dtype=np.bool_))
        notes.append(
            "the header has the limits of a periodic box; whether the run was periodic is not told:"
            " taken as periodic; --period none if not"
        )
    return Table(
        format="phantom",
        arrays=arrays,
        code=_code(identity),
        kinds=np.searchsorted(order, types),
        names=[TYPES.get(int(t), str(t)) for t in order],
        counts=counts,
        walls=frozenset({"boundary"}),
        box=box,
        notes=notes,
    )


def _code(identity: str) -> str:
    """ "FT:Phantom:1.2.1:gitsha …" or whatever the file calls itself."""
    parts = [part.strip() for part in identity.split(":")]
    if len(parts) > 2 and parts[1].lower().startswith("phantom"):
        return f"Phantom {parts[2]}"
    return "Phantom"
