"""SPH-EXA in HDF5 (H5Part): groups Step#0, Step#1, …, a dataset for each coordinate.

Cabezón et al. (2025) SPH-EXA, https://github.com/unibas-dmi-hpc/SPH-EXA.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from sphtrunc.scenes.snapshots.hdf5 import Group
from sphtrunc.scenes.snapshots.table import Box, Table

_STEP = re.compile(r"Step#(\d{1,9})")


def recognises(root: Group) -> bool:
    """Whether the layout is this one."""
    return any(_STEP.fullmatch(name) for name in root.names())


def read(path: Path, root: Group, kind: str | None) -> Table:
    """The particles of the last step."""
    if kind not in (None, "0"):
        raise ValueError(f"type: got {kind!r}, expected 0: SPH-EXA has one type")
    steps = [name for name in root.names() if _STEP.fullmatch(name)]
    last = max(steps, key=lambda name: int(name[5:]))
    group = root.group(last)
    arrays = group.arrays()
    told = {**root.attributes(), **group.attributes()}
    for name in ("m", "h"):  # one number for all where particles are equal
        if name not in arrays and name in told and "x" in arrays:
            arrays[name] = np.full(len(arrays["x"]), float(np.ravel(told[name])[0]))
    box = None
    sides = np.asarray(told.get("box", ()), dtype=np.float64).reshape(-1)
    if sides.size == 6 and np.all(np.isfinite(sides)) and np.all(sides[1::2] > sides[::2]):
        kinds = np.asarray(told.get("boundaryType", (0, 0, 0))).reshape(-1)[:3]
        periodic = np.array([int(k) == 1 for k in kinds]) if kinds.size == 3 else np.zeros(3, bool)
        box = Box(sides[::2].copy(), sides[1::2] - sides[::2], periodic)
    kernel = None
    if "sincIndex" in told:
        kernel = f"sinc, n = {float(np.ravel(told['sincIndex'])[0]):g}"
    return Table(
        format="sph-exa",
        arrays=arrays,
        code="SPH-EXA",
        box=box,
        kernel=kernel,
        notes=[f"{last}, the last of {len(steps)} steps"] if len(steps) > 1 else [],
    )
