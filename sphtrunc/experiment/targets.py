"""Targets: what was measured at every one of them, as a table."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.operators.moments import label
from sphtrunc.output import write_atomically

if TYPE_CHECKING:
    from sphtrunc.experiment.measurement import Measurement
    from sphtrunc.scenes.particles import Particles

_AXES = "xyz"


def table(measured: Measurement, scene: Particles) -> dict[str, Any]:
    """Column -> (T,): particle, its position and h, whether it was flagged, the components of the
    estimate in units of A/length^k, of the error relative to the largest exact derivative, and the
    moments of the first component, M(α), and of the others, "M(α) of y"; NaN where a target was
    flagged."""
    at, used = measured.target, measured.used
    columns: dict[str, Any] = {"particle": at}
    columns |= {_AXES[i]: axis[at] for i, axis in enumerate(scene.x)}
    columns |= {"h": scene.h[at], "flagged": ~used}

    def spread(values: Any) -> Any:
        everyone = np.full(at.size, np.nan)
        everyone[used] = values
        return everyone

    if measured.estimates is not None:
        for name, values in zip(measured.components, measured.estimates, strict=True):
            columns[f"estimate {name}"] = spread(values[used])
    if measured.errors is not None:
        for name, values in zip(measured.components, measured.errors, strict=False):
            columns[f"error {name}"] = spread(values)
    for i, (row, moments) in enumerate(zip(measured.rows, measured.moments_of, strict=True)):
        for alpha, values in moments.values.items():
            columns[f"M({label(alpha)})" + (f" of {row}" if i else "")] = spread(values)
    return columns


def write(measured: Measurement, scene: Any, path: str) -> None:
    """The table as CSV or NPZ, by the name of the file.

    Raises ValueError for another name, for a scene that is not explicit particles, and where the
    file cannot be written.
    """
    if not measured.explicit:
        raise ValueError(
            f"output {path}: a table of targets belongs to --particles FILE; expected a name that"
            " does not end in .csv or .npz, or --format csv"
        )
    write_columns(table(measured, scene), path)


def write_columns(columns: dict[str, Any], path: str) -> None:
    """Columns as CSV (a flag as 0 or 1, NaN as an empty cell) or NPZ, atomically."""
    suffix = Path(path).suffix
    if suffix == ".npz":
        buffer = io.BytesIO()
        np.savez(buffer, **columns)
        write_atomically(path, buffer.getvalue())
        return
    if suffix != ".csv":
        raise ValueError(f"output {path}: expected a name ending in .csv or .npz")
    lines = [",".join(f'"{name}"' if "," in name else name for name in columns)]
    cells = [_cells(values) for values in columns.values()]
    lines += [",".join(row) for row in zip(*cells, strict=True)]
    write_atomically(path, "\n".join(lines) + "\n")


def _cells(values: Any) -> list[str]:
    if values.dtype.kind in "biu":
        return [str(int(v)) for v in values.tolist()]
    return ["" if v != v else repr(v) for v in values.tolist()]
