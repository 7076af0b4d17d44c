"""Reports: timings that can be compared, tables of figures, and the machine they were taken on."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np

from sphtrunc.experiment.engine import threads
from sphtrunc.version import __version__


@dataclass(frozen=True)
class Table:
    """Rows of figures under their columns; `note` says how they were taken."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    note: str = ""

    def to_text(self) -> str:
        """The table in columns of text."""
        cells = [list(self.columns), *([_shown(value) for value in row] for row in self.rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.columns))]
        lines = [
            "  ".join(
                cell.ljust(w) if i == 0 else cell.rjust(w)
                for i, (cell, w) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in cells
        ]
        return "\n".join([self.title, *lines, *([self.note] if self.note else [])])


@dataclass(frozen=True)
class Report:
    """What a benchmark found: the machine, the day, and tables by suite."""

    machine: dict[str, Any]
    suites: dict[str, list[Table]]
    seconds: float

    def to_text(self) -> str:
        """For a terminal."""
        parts = [heading(self.machine)]
        for name, tables in self.suites.items():
            parts += [f"== {name} ==", *(table.to_text() for table in tables)]
        return "\n\n".join([*parts, f"{self.seconds:.0f} s in all"])

    def to_json(self) -> str:
        """schema sphtrunc.bench/1."""
        suites = {
            name: [
                {
                    "title": table.title,
                    "columns": table.columns,
                    "rows": [[_plain(value) for value in row] for row in table.rows],
                    "note": table.note,
                }
                for table in tables
            ]
            for name, tables in self.suites.items()
        }
        return json.dumps(
            {
                "schema": "sphtrunc.bench/1",
                "date": date.today().isoformat(),
                "machine": self.machine,
                "suites": suites,
                "seconds": self.seconds,
                "version": __version__,
            },
            indent=1,
            ensure_ascii=False,
        )


def heading(machine: Mapping[str, Any]) -> str:
    """The first line of a report."""
    head = ", ".join(f"{name} {value}" for name, value in machine.items())
    return f"sphtrunc {__version__} on {date.today().isoformat()}: {head}"


def machine() -> dict[str, Any]:
    """The machine and what runs on it."""
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":")[1].strip() for line in file if line.startswith("model name")]
        model = names[0] if names else model
    except OSError:
        pass
    found: dict[str, Any] = {
        "processor": model,
        "cores": threads(None),
        "python": platform.python_version(),
    }
    found["numpy"] = np.__version__
    if find_spec("numba"):
        import numba

        found["numba"] = numba.__version__
    if hasattr(os, "getloadavg"):
        found["load"] = round(os.getloadavg()[0], 1)
    return found


# --------------------------------------------------------------------------------------- timing


def alternately(
    tasks: Mapping[str, Callable[[], Any]], repeats: int, most: float = 20.0
) -> dict[str, list[float]]:
    """Seconds of each task, run in turn: `repeats` rounds, or as many as fit in `most` seconds."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    started = time.perf_counter()
    for _ in range(repeats):
        for name, task in tasks.items():
            begin = time.perf_counter()
            task()
            times[name].append(time.perf_counter() - begin)
        if time.perf_counter() - started > most:
            break
    return times


def spread(values: Sequence[float]) -> float:
    """Half of the range of the middle half, relative to the median."""
    ordered = sorted(values)
    n = len(ordered)
    return (ordered[(3 * n) // 4 if n > 1 else 0] - ordered[n // 4]) / (2.0 * median(ordered))


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int | np.integer):
        return f"{int(value)}"
    size = abs(float(value))
    return f"{float(value):.3g}" if 1e-3 <= size < 1e6 or size == 0 else f"{float(value):.2e}"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value
