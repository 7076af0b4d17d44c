"""Files of particles that other programs open: NPZ, CSV, HDF5 as Gadget and SWIFT read it, VTK XML.

`sphtrunc.scenes.snapshots` reads all of them back.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.output import write_atomically

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.scenes.particles import Particles

SUFFIXES = (".npz", ".csv", ".h5", ".hdf5", ".vtp")


def check(path: str | Path) -> None:
    """Raises ValueError for a name that does not end in one of SUFFIXES, and without h5py for one
    that needs it."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"output {path}: expected a name ending in {', '.join(SUFFIXES)}")
    if suffix in (".h5", ".hdf5"):
        library()


def write(scene: Particles, path: str | Path) -> None:
    """Positions, h and volumes of particles with given volumes, in the format that the name says.

    .npz and .csv hold `volume`; .hdf5 and .vtp masses of 1 and the densities 1/volume, since codes
    expect these. Positions have three coordinates there, and a box goes into the header of .hdf5.

    Raises ValueError for another name, and where the file cannot be written.
    """
    check(path)
    assert scene.given is not None
    x, volume = scene.x.T, scene.given
    suffix = Path(path).suffix.lower()
    if suffix == ".npz":
        buffer = io.BytesIO()
        np.savez(buffer, x=x, h=scene.h, volume=volume)
        write_atomically(path, buffer.getvalue())
    elif suffix == ".csv":
        lines = [",".join([*"xyz"[: scene.dim], "h", "volume"])]
        table = np.column_stack([x, scene.h, volume])
        lines += [",".join(repr(value) for value in row) for row in table.tolist()]
        write_atomically(path, "\n".join(lines) + "\n")
    elif suffix == ".vtp":
        arrays = {"h": scene.h, "mass": np.ones(len(x)), "density": 1.0 / volume}
        write_atomically(path, vtp(x, arrays))
    else:
        write_atomically(path, _gadget(scene, volume))


def library() -> Any:
    """h5py; raises ValueError, which says how to get it, where it is not installed."""
    try:
        import h5py
    except ImportError:
        raise ValueError(
            "output: HDF5 needs h5py; install it with pip install 'sphtrunc[snapshots]', or write"
            " .npz"
        ) from None
    return h5py


def _gadget(scene: Particles, volume: Array) -> bytes:
    count = scene.population
    buffer = io.BytesIO()
    with library().File(buffer, "w") as file:
        header = file.create_group("Header").attrs
        for name in ("NumPart_ThisFile", "NumPart_Total"):
            header[name] = np.array([count, 0, 0, 0, 0, 0], dtype=np.uint32)
        header["NumPart_Total_HighWord"] = np.zeros(6, dtype=np.uint32)
        header["MassTable"] = np.zeros(6)
        header["NumFilesPerSnapshot"] = 1
        header["Code"] = "sphtrunc"
        header["Dimension"] = scene.dim
        header["Time"], header["Redshift"] = 0.0, 0.0
        if scene.period is not None:
            header["BoxSize"] = np.concatenate([scene.period, scene.period[:1].repeat(3)])[:3]
            file.create_group("RuntimePars").attrs["PeriodicBoundariesOn"] = 1
        gas = file.create_group("PartType0")
        gas["Coordinates"] = _spatial(scene.x.T)
        gas["SmoothingLength"] = scene.h
        gas["Masses"] = np.ones(count)
        gas["Density"] = 1.0 / volume
        gas["Velocities"] = np.zeros((count, 3))
        gas["InternalEnergy"] = np.ones(count)
        gas["ParticleIDs"] = np.arange(1, count + 1)
    return buffer.getvalue()


def _spatial(x: Array) -> Array:
    """Positions (n, d), filled up with zeros to three coordinates."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def vtp(x: Array, arrays: Mapping[str, Array]) -> bytes:
    """VTK XML PolyData: a vertex at every point, numbers appended as they are.

    x: (n, d), filled up with zeros to three coordinates; arrays: name -> (n,)
    """
    n = len(x)
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
        entry("Points", _spatial(x), 3),
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
