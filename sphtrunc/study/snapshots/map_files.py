"""Files of an error map: NPZ, CSV, HDF5, and VTK XML for ParaView."""

from __future__ import annotations

from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.targets import write_columns
from sphtrunc.output import replacing, write_atomically
from sphtrunc.scenes.particle_files import library, vtp

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.study.snapshots.error_map import ErrorMap

SUFFIXES = (".npz", ".csv", ".h5", ".hdf5", ".vtp", ".json")


def check(path: str | Path) -> None:
    """Raises ValueError for a name that does not end in one of SUFFIXES."""
    if Path(path).suffix not in SUFFIXES:
        raise ValueError(f"output {path}: expected a name ending in {', '.join(SUFFIXES)}")


def write(found: ErrorMap, path: str | Path) -> None:
    """The map in the format that the name of the file says.

    .npz and .hdf5 hold `ErrorMap.arrays`, .csv its `columns`, .vtp the lengths of the moment errors
    and the errors of fields at the particles, .json the summary. Raises ValueError for another
    name, and where the file cannot be written.
    """
    check(path)
    suffix = Path(path).suffix
    if suffix == ".csv":
        write_columns(found.columns(), str(path))
    elif suffix == ".npz":
        with replacing(path) as file:
            np.savez(file, **found.arrays())
    elif suffix in (".h5", ".hdf5"):
        with replacing(path) as file:
            _hdf5(found, file)
    elif suffix == ".json":
        write_atomically(path, found.to_json() + "\n")
    else:
        write_atomically(path, vtp(found.x, shown(found)))


def shown(found: ErrorMap) -> dict[str, Array]:
    """One number for each target and quantity: γ, condition, flag, the length of the moment error
    of each degree, and the lengths of the errors of fields."""
    arrays: dict[str, Any] = {"gamma": found.gamma, "condition": found.condition}
    arrays["flag"] = found.flag
    for name in found.moments:
        for degree, values in found.sizes(name).items():
            arrays[f"{degree} {name}"] = values
    for field, rows in found.fields.items():
        for name, one in rows.items():
            arrays[f"error of {field} {name}"] = np.sqrt((one.error**2).sum(axis=1))
    return arrays


def _hdf5(found: ErrorMap, stream: IO[bytes]) -> None:
    with library().File(stream, "w") as file:
        for name, values in found.arrays().items():
            file.create_dataset(name, data=values)
        file.attrs["kernel"] = found.kernel
