"""Files of particles: columns by name, checked before anything is kept."""

from __future__ import annotations

import csv
import zipfile

import numpy as np

from sphtrunc.arithmetic.summation import Array

_COLUMNS = ("h", "volume", "mass", "density", "values")


def read(path: str) -> dict[str, Array]:
    """Particles from a file, as arguments of `particles` and their values.

    .npy: x; .npz: x and any of h, volume, mass, density, values; .csv: columns x, y, z and these.
    Raises ValueError, naming the file and the reason, for anything that is not that.
    """
    suffix = path.rpartition(".")[2].lower()
    try:
        if suffix == "npy":
            columns = {"x": np.load(path, allow_pickle=False)}
        elif suffix == "npz":
            with np.load(path, allow_pickle=False) as file:
                columns = {name: file[name] for name in ("x", *_COLUMNS) if name in file.files}
        elif suffix == "csv":
            columns = _read_csv(path)
        else:
            raise ValueError("expected a file ending in .npz, .csv or .npy")
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(f"particles: {path}: {reason}") from None
    if "x" not in columns:
        raise ValueError(f"particles: {path} has no x; expected the positions of the particles")
    return columns


def _read_csv(path: str) -> dict[str, Array]:
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file) if row]
    if len(rows) < 2:
        raise ValueError("expected a header and at least one particle")
    names = [name.strip() for name in rows[0]]
    unknown = [n for n in names if n not in ("x", "y", "z", *_COLUMNS)]
    if unknown or len(set(names)) < len(names):
        raise ValueError(
            f"columns {', '.join(names)[:80]}, expected x, y, z, {', '.join(_COLUMNS)}"
        )
    table = np.empty((len(rows) - 1, len(names)))
    for i, row in enumerate(rows[1:]):
        if len(row) != len(names):
            raise ValueError(f"line {i + 2} has {len(row)} entries, expected {len(names)}")
        for j, text in enumerate(row):
            try:
                table[i, j] = float(text)
            except ValueError:
                raise ValueError(f"line {i + 2}: {text[:40]!r} is not a number") from None
    columns = {name: table[:, names.index(name)] for name in names if name in _COLUMNS}
    axes = [names.index(axis) for axis in ("x", "y", "z") if axis in names]
    return columns | ({"x": table[:, axes]} if "x" in names else {})
