"""Gadget-2, Gadget-3, Gadget-4, AREPO and SWIFT in HDF5: PartType0 and a Header.

Springel (2005) doi:10.1111/j.1365-2966.2005.09655.x; Schaller et al. (2024)
doi:10.1093/mnras/stae922.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from sphtrunc.scenes.snapshots.hdf5 import Group, opened
from sphtrunc.scenes.snapshots.table import Box, Table, whole

_MOST_FILES = 4096


def recognises(root: Group) -> bool:
    """Whether the layout is this one."""
    return "Header" in root and any(name.startswith("PartType") for name in root.names())


def read(path: Path, root: Group, kind: str | None) -> Table:
    """The particles of one type, of all files of the snapshot."""
    kind = "0" if kind is None else kind.removeprefix("PartType")
    if not re.fullmatch("[0-9]", kind):
        raise ValueError(f"type: got {kind[:20]!r}, expected the number of a PartType, 0 to 9")
    header = root.group("Header").attributes()
    files = whole("NumFilesPerSnapshot", header.get("NumFilesPerSnapshot", 1), 1)
    parts = [_part(root, header, kind)]
    if files > 1:
        parts = []
        for one in _siblings(path, files):
            with opened(one) as other:
                parts.append(_part(other, other.group("Header").attributes(), kind))
    names = set(parts[0])
    if any(set(part) != names for part in parts):
        raise ValueError("the files of the snapshot do not hold the same fields")
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    total = _counts(header, "NumPart_Total")
    high = _counts(header, "NumPart_Total_HighWord")
    counts = {n: total[n] + (high.get(n, 0) << 32) for n in total}
    found = len(next(iter(arrays.values())))
    if counts and counts.get(kind, 0) != found:
        raise ValueError(
            f"the header counts {counts.get(kind, 0):,} particles of type {kind}, and"
            f" {found:,} are there"
        )
    groups = {name: root.group(name).attributes() for name in root.groups() if name in _TOLD}
    notes = _units(header, groups)
    box = _box(header, groups, notes)
    return Table(
        format="gadget",
        arrays=arrays,
        code=_code(header, groups),
        names=(kind,),
        counts={name: count for name, count in counts.items() if count} or {kind: found},
        box=box,
        kernel=_text(groups.get("HydroScheme", {}).get("Kernel function")),
        notes=notes,
    )


#: groups whose attributes say something about the particles
_TOLD = ("Code", "HydroScheme", "RuntimePars", "Cosmology", "Parameters", "Config")


def _part(root: Group, header: dict[str, Any], kind: str) -> dict[str, Any]:
    """The fields of one type in one file."""
    name = f"PartType{kind}"
    if name not in root:
        there = sorted(n.removeprefix("PartType") for n in root.names() if n.startswith("PartType"))
        raise ValueError(f"type: there are no particles of type {kind}, only {', '.join(there)}")
    arrays = root.group(name).arrays()
    if "Coordinates" not in arrays:
        raise ValueError(f"{name} has no Coordinates")
    count = len(arrays["Coordinates"])
    stated = _counts(header, "NumPart_ThisFile").get(kind)
    if stated is not None and stated != count:
        raise ValueError(
            f"the header counts {stated:,} particles of type {kind} in this file, and"
            f" {count:,} are there"
        )
    masses = np.asarray(header.get("MassTable", ())).reshape(-1)
    if "Masses" not in arrays and int(kind) < masses.size and masses[int(kind)] != 0:
        arrays["Masses"] = np.full(count, float(masses[int(kind)]))
    return arrays


def _counts(header: dict[str, Any], name: str) -> dict[str, int]:
    """type -> how many; empty where the header does not say."""
    if name not in header:
        return {}
    return {str(i): whole(name, n) for i, n in enumerate(np.asarray(header[name]).reshape(-1)[:10])}


def _siblings(path: Path, files: int) -> list[Path]:
    """name.0.hdf5, name.1.hdf5, …: every file of the snapshot."""
    match = re.fullmatch(r"(.*)\.\d+(\.\w+)", path.name)
    if match is None or files > _MOST_FILES:
        raise ValueError(
            f"it is one of {files} files, and its name is not NAME.0{path.suffix}: the others"
            " cannot be found"
        )
    found = [path.with_name(f"{match[1]}.{i}{match[2]}") for i in range(files)]
    missing = [one.name for one in found if not one.is_file()]
    if missing:
        raise ValueError(f"it is one of {files} files, and {missing[0]} is missing")
    return found


def _code(header: dict[str, Any], groups: dict[str, dict[str, Any]]) -> str | None:
    told = groups.get("Code", {})
    if "Code Version" in told or "Code" in told or "Code" in header:
        name = _text(told.get("Code") or header.get("Code")) or "SWIFT"
        version = _text(told.get("Code Version")) or ""
        return f"{name} {version}".strip()
    if "HydroScheme" in groups or "RuntimePars" in groups:
        return "SWIFT"
    if "Config" in groups:
        return "AREPO" if "VORONOI" in groups["Config"] else "Gadget-4"
    return None


def _text(value: Any) -> str | None:
    return None if value is None else str(value).strip()[:80] or None


def _number(value: Any) -> float:
    """The first number of a header's value, or NaN."""
    try:
        return float(np.asarray(value).reshape(-1)[0])
    except (ValueError, TypeError, IndexError):
        return float("nan")


def _units(header: dict[str, Any], groups: dict[str, dict[str, Any]]) -> list[str]:
    """What lengths and masses are measured in, where that is not one plain unit."""
    notes = []
    cosmology = groups.get("Cosmology", {})
    running = _number(cosmology.get("Cosmological run", header.get("ComovingIntegrationOn", 0)))
    if running == 1.0 or (_number(header.get("Redshift", 0)) > 0 and "Omega0" in header):
        factor = _number(cosmology.get("Scale-factor", header.get("Time", 1.0)))
        notes.append(f"lengths are comoving, at scale factor {factor:.6g}; taken as they are")
    little = _number(header.get("HubbleParam", 1.0))
    if "HydroScheme" not in groups and little not in (0.0, 1.0) and np.isfinite(little):
        notes.append(f"lengths and masses carry factors 1/h, h = {little:.4g}; taken as they are")
    return notes


def _box(header: dict[str, Any], groups: dict[str, dict[str, Any]], notes: list[str]) -> Box | None:
    size = np.asarray(header.get("BoxSize", 0.0), dtype=np.float64).reshape(-1)
    if size.size not in (1, 2, 3) or not np.all(np.isfinite(size)) or not np.all(size >= 0):
        raise ValueError(f"BoxSize: got {size[:4].tolist()}, expected one to three lengths")
    if not np.all(size > 0):
        return None
    size = np.resize(size, 3) if size.size < 3 else size
    stated = groups.get("RuntimePars", {}).get("PeriodicBoundariesOn")
    if stated is None:
        notes.append(
            "the header does not say whether the box is periodic; taken as it is, since it has a"
            " size; --period none if not"
        )
    periodic = stated is None or _number(stated) == 1.0
    return Box(np.zeros(3), size, np.full(3, periodic))
