"""NumPy's .npy and .npz, read without pickles and without believing their sizes."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots import pysph
from sphtrunc.scenes.snapshots.table import Budget, Table

NPY, NPZ = b"\x93NUMPY", b"PK\x03\x04"
_MOST_MEMBERS = 1024


def read_npy(path: Path, kind: str | None) -> Table:
    """An array of positions, (n,) or (n, d), or of records with named fields."""
    _one_type(kind)
    array = _array("the array", path.read_bytes())
    if array.dtype.names:
        return Table(format="npy", arrays={name: array[name] for name in array.dtype.names})
    return Table(format="npy", arrays={"x": array})


def read_npz(path: Path, kind: str | None) -> Table:
    """Arrays by their names; or, where it is one of PySPH's, its particle arrays."""
    budget = Budget(path)
    try:
        with zipfile.ZipFile(path) as file:
            entries = file.infolist()
            if len(entries) > _MOST_MEMBERS:
                raise ValueError(f"{len(entries)} members, expected the arrays of a snapshot")
            members = {}
            for entry in entries:
                budget.take(entry.filename[:40], entry.file_size, 1)
                with file.open(entry) as member:
                    data = member.read(entry.file_size + 1)
                if len(data) != entry.file_size:
                    raise ValueError(f"{entry.filename[:40]} has not the size that is stated")
                members[entry.filename.removesuffix(".npy")] = data
    # a password is a RuntimeError, an unknown packer a NotImplementedError
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
        raise ValueError(f"damaged archive: {str(error)[:80]}") from None
    if {"particles", "solver_data"} <= members.keys():
        return pysph.npz(members, kind)
    _one_type(kind)
    arrays = {name: _array(name, data) for name, data in members.items() if data[:6] == NPY}
    rows = max((len(a) for a in arrays.values() if a.ndim), default=0)
    spread = {name: np.full(rows, a) if a.ndim == 0 else a for name, a in arrays.items()}
    return Table(format="npz", arrays={n: a for n, a in spread.items() if a.dtype.kind in "iufb"})


def _one_type(kind: str | None) -> None:
    if kind not in (None, "0"):
        raise ValueError(f"type: got {kind!r}, expected 0: the file has one type of particles")


def _array(name: str, data: bytes) -> NDArray[Any]:
    """The array of a .npy, whose size has to be what its header says."""
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, fortran, dtype = header(file)
    except Exception as error:  # its header is parsed as Python text, which fails in many ways
        raise ValueError(f"{name[:40]}: damaged header: {str(error)[:80]}") from None
    if dtype.hasobject:
        raise ValueError(f"{name[:40]} holds pickled objects, which are not read")
    count = 1
    for n in shape:
        count *= n
    rest = data[file.tell() :]
    if count < 0 or count * dtype.itemsize != len(rest):
        raise ValueError(f"{name[:40]}: shape {shape} does not fit {len(rest):,} bytes of numbers")
    if not count:
        return np.empty(shape, dtype)
    return np.frombuffer(rest, dtype).reshape(shape, order="F" if fortran else "C")
