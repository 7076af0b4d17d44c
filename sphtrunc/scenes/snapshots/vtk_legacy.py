"""VTK legacy files, ASCII and binary: the points of a data set and what is given at them.

File formats for VTK version 4.2 (Kitware); binary numbers are big-endian.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.table import Budget, Table, whole

SIGNATURE = b"# vtk DataFile"
_DTYPES = {
    "bit": "u1", "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2",
    "int": "i4", "unsigned_int": "u4", "long": "i8", "unsigned_long": "u8", "float": "f4",
    "double": "f8", "vtkidtype": "i8", "vtktypeint64": "i8",
}  # fmt: skip
_WORD = re.compile(rb"[\r\n]\s*(?!(?:nan|inf)\b)[A-Za-z]", re.IGNORECASE)


class _Reader:
    """The rest of a file, read line by line or number by number."""

    def __init__(self, data: bytes, budget: Budget) -> None:
        self.data, self.budget, self.at, self.binary = data, budget, 0, False

    def line(self) -> list[str]:
        """The words of the next line that has any; [] at the end."""
        while self.at < len(self.data):
            end = self.data.find(b"\n", self.at)
            end = len(self.data) if end < 0 else end
            line, self.at = self.data[self.at : end], end + 1
            if len(line) > 4096:
                raise ValueError(f"a line of {len(line):,} letters where a word should stand")
            if line.strip():
                return line.decode("latin1").split()
        return []

    def numbers(self, name: str, kind: str, count: int) -> NDArray[Any]:
        """The next `count` numbers."""
        if kind.lower() not in _DTYPES:
            raise ValueError(f"{name[:20]}: type {kind[:20]!r} is none of numbers")
        dtype = np.dtype(">" + _DTYPES[kind.lower()])
        self.budget.take(name, count, max(8, dtype.itemsize))
        if self.binary:
            size = count * dtype.itemsize
            if self.at + size > len(self.data):
                raise ValueError(f"{name}: it ends before {count:,} numbers are read")
            self.at += size
            return np.frombuffer(self.data, dtype, count, self.at - size)
        match = _WORD.search(self.data, max(0, self.at - 1))
        end = match.start() if match else len(self.data)
        words = self.data[self.at : end].split()
        if len(words) != count:
            raise ValueError(f"{name}: expected {count:,} numbers, got {len(words):,}")
        self.at = end
        return numbers(name, words, dtype)


def numbers(name: str, words: list[bytes], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Numbers out of words; raises ValueError for the first that is none."""
    for wanted in (np.int64 if dtype.kind in "iu" else np.float64, np.float64):
        try:
            return np.array(words, dtype="S48").astype(wanted)
        except (ValueError, OverflowError):
            continue
    for i, word in enumerate(words):
        try:
            float(word)
        except ValueError:
            shown = word[:20].decode("latin1")
            raise ValueError(f"{name}: number {i + 1:,} is {shown!r}") from None
    raise ValueError(f"{name}: not all are numbers")


def read(path: Path, kind: str | None) -> Table:
    """The points and what is given at them."""
    if kind not in (None, "0"):
        raise ValueError(f"type: got {kind!r}, expected 0: a VTK file has points of one type")
    data = path.read_bytes()
    source = _Reader(data, Budget(path))
    source.line()
    end = data.find(b"\n", source.at)
    title = data[source.at : max(end, source.at)].decode("latin1").strip()
    source.at = end + 1 if end >= 0 else len(data)
    mode = [word.upper() for word in source.line()]
    if mode not in (["ASCII"], ["BINARY"]):
        raise ValueError(f"line 3: got {' '.join(mode)[:20]!r}, expected ASCII or BINARY")
    source.binary = mode == ["BINARY"]
    return Table(
        format="vtk",
        arrays=_arrays(source),
        code=title[:80] if title and "vtk output" not in title.lower() else None,
    )


def _arrays(source: _Reader) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    count, here, points = 0, "", -1
    while words := source.line():
        word = words[0].upper()
        if word == "DATASET":
            if (words[1:] or [""])[0].upper() not in ("POLYDATA", "UNSTRUCTURED_GRID"):
                raise ValueError(f"{' '.join(words)[:40]}: expected POLYDATA or UNSTRUCTURED_GRID")
        elif word == "POINTS":
            _expect(words, 3)
            points = whole("POINTS", words[1])
            arrays["Points"] = source.numbers("POINTS", words[2], 3 * points).reshape(-1, 3)
        elif word in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS"):
            _expect(words, 3)
            _skip_cells(source, word, whole(word, words[1]), whole(word, words[2]))
        elif word == "CELL_TYPES":
            _expect(words, 2)
            source.numbers(word, "int", whole(word, words[1]))
        elif word in ("POINT_DATA", "CELL_DATA"):
            _expect(words, 2)
            here, count = word, whole(word, words[1])
            if word == "POINT_DATA" and count != points:
                raise ValueError(f"POINT_DATA {count:,} for {points:,} points")
        elif word in ("SCALARS", "VECTORS", "NORMALS", "TENSORS"):
            _expect(words, 3)
            width = {"SCALARS": 1, "TENSORS": 9}.get(word, 3)
            if word == "SCALARS":
                width = whole(words[1], words[3], 1) if len(words) > 3 else 1
                mark = source.at
                if (source.line() or [""])[0].upper() != "LOOKUP_TABLE":
                    source.at = mark
            _keep(arrays, here, words[1], source.numbers(words[1], words[2], width * count), width)
        elif word == "FIELD":
            _expect(words, 3)
            for _ in range(whole("FIELD", words[2])):
                name, parts, rows, kind, *_ = [*source.line(), "", "", "", ""]
                cells, tuples = whole(name, parts, 1), whole(name, rows)
                if here == "POINT_DATA" and tuples != points:
                    raise ValueError(f"{name[:40]}: {tuples:,} entries for {points:,} points")
                _keep(arrays, here, name, source.numbers(name, kind, cells * tuples), cells)
        elif word == "METADATA":
            _skip_metadata(source)
        else:
            raise ValueError(f"{word[:20]!r} where a word of the format should stand")
    if "Points" not in arrays:
        raise ValueError("it has no POINTS")
    return arrays


def _expect(words: list[str], least: int) -> None:
    if len(words) < least:
        raise ValueError(f"{' '.join(words)[:40]}: the line ends too early")


def _keep(
    arrays: dict[str, NDArray[Any]], here: str, name: str, values: NDArray[Any], width: int
) -> None:
    """Data of points by its name; that of cells is not of particles."""
    if here == "POINT_DATA" and width <= 3:
        arrays[name] = values.reshape(-1, width) if width > 1 else values


def _skip_cells(source: _Reader, word: str, first: int, second: int) -> None:
    mark = source.at
    words = source.line()
    if words and words[0].upper() == "OFFSETS":  # since version 5.1
        source.numbers("OFFSETS", words[1] if len(words) > 1 else "", first)
        words = source.line()
        if (words or [""])[0].upper() != "CONNECTIVITY":
            raise ValueError(f"{word}: CONNECTIVITY is missing")
        source.numbers("CONNECTIVITY", words[1] if len(words) > 1 else "", second)
    else:
        source.at = mark
        source.numbers(word, "int", second)


def _skip_metadata(source: _Reader) -> None:
    """Up to the empty line that ends it."""
    while source.at < len(source.data):
        end = source.data.find(b"\n", source.at)
        end = len(source.data) if end < 0 else end
        line, source.at = source.data[source.at : end], end + 1
        if not line.strip():
            return
