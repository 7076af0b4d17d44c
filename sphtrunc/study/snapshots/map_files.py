"""Files of an error map: NPZ, CSV, HDF5, and VTK XML for ParaView."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.targets import write_columns
from sphtrunc.output import write_atomically

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.study.snapshots.error_map import ErrorMap

SUFFIXES = (".npz", ".csv", ".h5", ".hdf5", ".vtp", ".json")


def write(found: ErrorMap, path: str | Path) -> None:
    """The map in the format that the name of the file says.

    .npz and .hdf5 hold `ErrorMap.arrays`, .csv its `columns`, .vtp the lengths of the moment errors
    and the errors of fields at the particles, .json the summary. Raises ValueError for another
    name, and where the file cannot be written.
    """
    suffix = Path(path).suffix
    if suffix == ".csv":
        write_columns(found.columns(), str(path))
    elif suffix == ".npz":
        buffer = io.BytesIO()
        np.savez(buffer, **found.arrays())
        write_atomically(path, buffer.getvalue())
    elif suffix in (".h5", ".hdf5"):
        write_atomically(path, _hdf5(found))
    elif suffix == ".json":
        write_atomically(path, found.to_json() + "\n")
    elif suffix == ".vtp":
        write_atomically(path, vtp(found.x, shown(found)))
    else:
        raise ValueError(f"output {path}: expected a name ending in {', '.join(SUFFIXES)}")


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


def _hdf5(found: ErrorMap) -> bytes:
    try:
        import h5py
    except ImportError:
        raise ValueError(
            "output: HDF5 needs h5py; install it with pip install 'sphtrunc[snapshots]', or write"
            " .npz"
        ) from None
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for name, values in found.arrays().items():
            file.create_dataset(name, data=values)
        file.attrs["kernel"] = found.kernel
    return buffer.getvalue()


def vtp(x: Array, arrays: dict[str, Array]) -> bytes:
    """VTK XML PolyData: a vertex at every point, numbers appended as they are.

    x: (n, d), filled up with zeros to three coordinates; arrays: name -> (n,)
    """
    n = len(x)
    points = np.zeros((n, 3))
    points[:, : x.shape[1]] = x
    blob = io.BytesIO()

    def entry(name: str, values: Any, width: int = 1) -> str:
        kind, dtype = ("Int64", "<i8") if values.dtype.kind in "biu" else ("Float64", "<f8")
        raw = np.ascontiguousarray(values, dtype=dtype).tobytes()
        at = blob.tell()
        blob.write(np.array([len(raw)], dtype="<u8").tobytes() + raw)
        name = name.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}"'
            f' format="appended" offset="{at}"/>'
        )

    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f'<Piece NumberOfPoints="{n}" NumberOfVerts="{n}">',
        "<Points>",
        entry("Points", points, 3),
        "</Points>",
        "<PointData>",
        *(entry(name, values) for name, values in arrays.items()),
        "</PointData>",
        "<Verts>",
        entry("connectivity", np.arange(n)),
        entry("offsets", np.arange(1, n + 1)),
        "</Verts>",
        "</Piece>",
        "</PolyData>",
        '<AppendedData encoding="raw">',
        "_",
    ]
    text = "\n".join(lines).encode()
    return text + blob.getvalue() + b"\n</AppendedData>\n</VTKFile>\n"
