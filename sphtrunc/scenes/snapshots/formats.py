"""The table of formats: how a file is recognised, and who reads it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

from sphtrunc.scenes.particles import Particles
from sphtrunc.scenes.snapshots import (
    dualsphysics,
    gadget,
    hdf5,
    lammps,
    numpy_files,
    phantom,
    pysph,
    sph_exa,
    text,
    vtk_legacy,
    vtk_xml,
)
from sphtrunc.scenes.snapshots.columns import listed
from sphtrunc.scenes.snapshots.snapshot import Snapshot, snapshot_of
from sphtrunc.scenes.snapshots.table import Table

Reader = Callable[[Path, str | None], Table]


@dataclass(frozen=True)
class Format:
    """begins: whether the first bytes of a file are those of the format; read: who reads it."""

    says: str
    begins: Callable[[bytes], bool]
    read: Reader


#: layouts inside HDF5, the first that recognises its groups reads them
LAYOUTS: tuple[ModuleType, ...] = (gadget, phantom, pysph, sph_exa)


def _hdf5(path: Path, kind: str | None) -> Table:
    with hdf5.opened(path) as root:
        for layout in LAYOUTS:
            if layout.recognises(root):
                found = layout.read(path, root, kind)
                assert isinstance(found, Table)
                return found
        raise ValueError(
            f"unknown layout: it has {listed(root.names(), 8) or 'nothing'}; expected the"
            " groups of Gadget, AREPO, SWIFT, Phantom, PySPH or SPH-EXA"
        )


#: the first whose beginning fits reads the file; a table in text has none of its own
FORMATS: tuple[Format, ...] = (
    Format("HDF5", lambda b: b.startswith(hdf5.SIGNATURE), _hdf5),
    Format("DualSPHysics .bi4", lambda b: b.startswith(dualsphysics.SIGNATURE), dualsphysics.read),
    Format("VTK legacy", lambda b: b.startswith(vtk_legacy.SIGNATURE), vtk_legacy.read),
    Format("VTK XML", vtk_xml.recognises, vtk_xml.read),
    Format("LAMMPS dump", lambda b: b.startswith(lammps.SIGNATURE), lammps.read),
    Format("NumPy .npz", lambda b: b.startswith(numpy_files.NPZ), numpy_files.read_npz),
    Format("NumPy .npy", lambda b: b.startswith(numpy_files.NPY), numpy_files.read_npy),
    Format("Phantom, native", lambda b: b[4:16].startswith(phantom.NATIVE), phantom.native),
    Format("table in text", lambda b: True, text.read),
)


def read(
    path: str | Path,
    *,
    type: str | None = None,
    dim: int | None = None,
    columns: Mapping[str, str] | None = None,
    period: object = None,
    h: float | None = None,
) -> Snapshot:
    """The snapshot in a file of any of FORMATS.

    type: which kind of particles, by the name or number that the code gives it
    Other arguments as for `snapshot_of`.

    Raises ValueError, naming the file and the reason, for anything that cannot be read whole.
    """
    file = Path(path)
    try:
        if not file.exists():
            raise ValueError("there is no such file")
        if not file.is_file():
            raise ValueError("it is no regular file")
        with open(file, "rb") as source:
            beginning = source.read(4096)
        if not beginning:
            raise ValueError("it is empty")
        found = next(one for one in FORMATS if one.begins(beginning))
        with np.errstate(all="ignore"):  # whatever is not finite in the end is refused, and named
            table = found.read(file, type)
            return snapshot_of(table, dim=dim, columns=columns, period=period, h=h)
    except OSError as error:
        raise ValueError(f"{str(path)[:200]}: {error.strerror or error}") from None
    except MemoryError:
        raise ValueError(f"{str(path)[:200]}: it does not fit into memory") from None
    except ValueError as error:
        raise ValueError(f"{str(path)[:200]}: {error}") from None


def snapshot(
    path: str | Path,
    *,
    type: str | None = None,
    dim: int | None = None,
    columns: Mapping[str, str] | None = None,
    period: object = None,
    h: float | None = None,
    volume: str | None = None,
    mode: str = "gather",
    allow_duplicates: bool = False,
) -> Particles:
    """The particles of a file that an SPH code wrote, as a scene.

    Read are Gadget, AREPO and SWIFT HDF5, Phantom, PySPH, SPH-EXA, DualSPHysics .bi4, VTK (.vtk,
    .vtp, .vtu), LAMMPS dumps, and tables (CSV, NPZ, NPY). Positions (d, n), h, masses and fields
    are in the units of the file; `fields` of what comes back holds them by name.

    type: which kind of particles; of Gadget and its relatives type 0 unless told otherwise
    dim: what the dimension has to be; columns: quantity -> name of its column, {"h": "hsml"}
    period: lengths of the box, inf along open axes, in place of the file's; "none": no period
    h: one smoothing length in place of the file's
    volume, mode: as for `particles`; allow_duplicates: take particles that coincide

    Raises ValueError, naming the file and the reason, for a file that cannot be read whole.
    """
    found = read(path, type=type, dim=dim, columns=columns, period=period, h=h)
    return found.particles(volume=volume, mode=mode, allow_duplicates=allow_duplicates)
