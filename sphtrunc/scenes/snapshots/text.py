"""Tables in text: names of columns in the first line, then a line for each particle.

Columns are separated by commas, semicolons, tabs or blanks; lines that begin with # are comments,
of which the last before the numbers may be the names.
"""

from __future__ import annotations

import csv
import re
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.table import Budget, Table

_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_MOST_COLUMNS = 4096


def read(path: Path, kind: str | None) -> Table:
    """The columns of the table."""
    if kind not in (None, "0"):
        raise ValueError(f"type: got {kind!r}, expected 0: a table has one type of particles")
    data = path.read_bytes()
    if b"\0" in data:
        raise ValueError("unknown format: it is no text, and begins like no snapshot known here")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start:,} is no UTF-8 text") from None
    comment = ""
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#"):
            comment = comment if lines else line.lstrip().lstrip("#").strip()
        elif line.strip():
            lines.append((number, line))
    if not lines:
        raise ValueError("expected a header and at least one particle; it is empty")
    separator = _separator(lines[0][1])
    first = _cells(lines[0][1], separator)
    if all(_is_number(cell) for cell in first if cell):
        names = _cells(comment, _separator(comment)) if comment else []
        if len(names) != len(first):
            raise ValueError(
                "expected a header: the first line has numbers and no line before it names them,"
                " such as x,y,h"
            )
    else:
        names, lines = first, lines[1:]
    if not lines:
        raise ValueError("expected a header and at least one particle")
    if len(names) > _MOST_COLUMNS:
        raise ValueError(f"{len(names):,} columns, expected a table of particles")
    Budget(path).take("the table", len(lines) * len(names), 8)
    rows = [_cells(line, separator) for _, line in lines]
    for (number, _), row in zip(lines, rows, strict=True):
        if len(row) != len(names):
            hint = ""
            if separator == "," and len(row) == 2 * len(names):
                hint = "; a decimal comma? write 0.5 for 0,5"
            raise ValueError(f"line {number} has {len(row)} entries, expected {len(names)}{hint}")
    table = _numbers(rows, lines, names)
    named = [name.strip() for name in names]
    if len({n for n in named if n}) < len([n for n in named if n]):
        raise ValueError(f"columns {', '.join(named)[:80]}: a name appears twice")
    arrays: dict[str, NDArray[Any]] = {n: table[:, i] for i, n in enumerate(named) if n}
    return Table(format="csv", arrays=arrays)


def _separator(line: str) -> str:
    for mark in (";", "\t", ","):
        if mark in line:
            return mark
    return " "


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    except csv.Error as error:
        raise ValueError(f"a line of {len(line):,} letters: {error}") from None


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _numbers(
    rows: list[list[str]], lines: list[tuple[int, str]], names: list[str]
) -> NDArray[np.float64]:
    try:
        flat = np.fromiter(map(float, chain.from_iterable(rows)), np.float64)
        return flat.reshape(len(rows), len(names))
    except ValueError:
        pass
    for (number, _), row in zip(lines, rows, strict=True):
        for name, cell in zip(names, row, strict=True):
            try:
                float(cell)
            except ValueError:
                hint = ""
                if _COMMA.fullmatch(cell):
                    hint = f"; a decimal comma? write {cell.replace(',', '.')[:20]}"
                raise ValueError(
                    f"line {number}, column {name[:40]!r}: {cell[:40]!r} is not a number{hint}"
                ) from None
    raise ValueError("not all are numbers")
