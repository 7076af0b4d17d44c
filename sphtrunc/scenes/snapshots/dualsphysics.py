"""DualSPHysics: its binary parts, .bi4.

Domínguez et al. (2022) doi:10.1007/s40571-021-00404-2. A tree of items; an item has values (name,
type, number) and arrays (name, type, how many, numbers), little-endian unless the header says not.
Boundary particles come first by identity: fixed, moving, floating, then fluid.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.table import Box, Budget, Table

SIGNATURE = b"#FileJBD "
#: type of a value or an array: (NumPy's, components); 1 is text, 2 a truth value
_TYPES = {
    2: ("i4", 1), 3: ("i1", 1), 4: ("u1", 1), 5: ("i2", 1), 6: ("u2", 1), 7: ("i4", 1),
    8: ("u4", 1), 9: ("i8", 1), 10: ("u8", 1), 11: ("f4", 1), 12: ("f8", 1),
    20: ("i4", 3), 21: ("u4", 3), 22: ("f4", 3), 23: ("f8", 3),
}  # fmt: skip
_TEXT = 1
_DEEPEST = 8


@dataclass
class _Item:
    values: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    items: list[_Item] = field(default_factory=list)


class _Bytes:
    """What is left of a file; raises ValueError where more is asked for."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data, self.order, self.at = data, order, 0

    def take(self, size: int) -> bytes:
        if size < 0 or self.at + size > len(self.data):
            raise ValueError(f"it ends at byte {len(self.data):,}, in the middle of an entry")
        self.at += size
        return self.data[self.at - size : self.at]

    def number(self) -> int:
        return int(struct.unpack(f"{self.order}I", self.take(4))[0])

    def text(self) -> str:
        size = self.number()
        if size > 4096:
            raise ValueError(f"a name of {size:,} letters at byte {self.at:,}: it is damaged")
        return self.take(size).decode("utf-8", "replace")

    def marked(self, mark: str) -> int:
        """The size of an entry, whose beginning is checked."""
        size = self.number()
        if self.text().strip() != mark:
            raise ValueError(f"no {mark} at byte {self.at:,}: it is damaged")
        return size


def read(path: Path, kind: str | None) -> Table:
    """The particles of a part."""
    data = path.read_bytes()
    if len(data) < 64:
        raise ValueError("it ends within its header")
    if data[60] not in (0, 1):
        raise ValueError(f"byte order: got {data[60]}, expected 0 or 1")
    source = _Bytes(data, "<" if data[60] == 0 else ">")
    source.at = 64
    root = _item(source, Budget(path), 0)
    if source.at != len(data):
        raise ValueError(f"{len(data) - source.at:,} bytes follow the last entry: it is damaged")
    if not root.items or not root.items[0].arrays:
        raise ValueError("it holds no particles; expected a file Part_NNNN.bi4")
    case, part = root.values, root.items[0]
    arrays = part.arrays
    count = int(_value(part.values, "Npok", len(next(iter(arrays.values())))))
    for name, values in arrays.items():
        if len(values) != count:
            raise ValueError(f"{name} has {len(values):,} entries for {count:,} particles")
    if "Idp" not in arrays:
        raise ValueError("Idp is missing: which particles are boundary is not known")
    return _table(case, arrays, kind)


def _item(source: _Bytes, budget: Budget, depth: int) -> _Item:
    if depth > _DEEPEST:
        raise ValueError("items within items within items: it is damaged")
    source.marked("ITEM")
    source.text()  # its name
    source.take(8)  # whether it and its values are hidden
    source.text(), source.text()  # formats
    arrays, items, size = source.number(), source.number(), source.number()
    found = _Item()
    end = source.at + size
    if size:
        if source.text().strip() != "VALUES":
            raise ValueError(f"no VALUES at byte {source.at:,}: it is damaged")
        for _ in range(source.number()):
            name, code = source.text(), source.number()
            if code == _TEXT:
                found.values[name] = source.text()
            else:
                dtype, width = _type(code, name, source)
                raw = np.frombuffer(source.take(dtype.itemsize * width), dtype)
                found.values[name] = raw if width > 1 else raw[0].item()
        if source.at != end:
            raise ValueError(f"values end at byte {source.at:,}, not at {end:,}: it is damaged")
    for _ in range(arrays):
        source.marked("ARRAY")
        name = source.text()
        source.take(4)
        code, count, size = source.number(), source.number(), source.number()
        dtype, width = _type(code, name, source)
        if size != count * dtype.itemsize * width:
            raise ValueError(f"{name}: {size:,} bytes for {count:,} entries: it is damaged")
        budget.take(name, size, 1)
        values = np.frombuffer(source.take(size), dtype)
        found.arrays[name] = values.reshape(count, width) if width > 1 else values
    for _ in range(items):
        found.items.append(_item(source, budget, depth + 1))
    return found


def _type(code: int, name: str, source: _Bytes) -> tuple[np.dtype[Any], int]:
    if code not in _TYPES:
        raise ValueError(f"{name[:20]} has type {code}, which is none: it is damaged")
    dtype, width = _TYPES[code]
    return np.dtype(source.order + dtype), width


def _value(values: dict[str, Any], name: str, default: float = float("nan")) -> float:
    value = values.get(name, default)
    if isinstance(value, int | float):
        return float(value)
    raise ValueError(f"{name}: expected a number")


def _table(case: dict[str, Any], arrays: dict[str, NDArray[Any]], kind: str | None) -> Table:
    identity = arrays["Idp"].astype(np.int64)
    ends = np.cumsum([_value(case, f"CaseN{part}", 0.0) for part in _KINDS])
    if not ends[-1] >= 1 or (identity.size and identity.max() >= ends[-1]):
        raise ValueError("Idp: identities beyond the number of particles of the case")
    kinds = np.searchsorted(ends, identity, side="right")
    counts = {p: int(np.count_nonzero(kinds == i)) for i, p in enumerate(_KINDS)}
    bound, fluid = _value(case, "MassBound"), _value(case, "MassFluid")
    arrays = {**arrays, "mass": np.where(kinds == len(_KINDS) - 1, fluid, bound)}
    if kind is not None:
        if kind not in _KINDS or not counts[kind]:
            raise ValueError(f"type: got {kind[:20]!r}, and there are {counts}")
        keep = kinds == _KINDS.index(kind)
        arrays, kinds = {name: values[keep] for name, values in arrays.items()}, kinds[keep]
    walls = frozenset(_KINDS[:-1]) if kind is None and counts["fluid"] else frozenset()
    low, high = (np.asarray(case.get(f"MapPos{end}", np.full(3, np.nan))) for end in ("Min", "Max"))
    mode = int(_value(case, "PeriMode", 0.0))
    box = None
    if mode and np.all(high > low):
        # 1: x, 2: y, 3: x and y, 4: z, 5: x and z, 6: y and z, of a box without a shift
        shifts = [np.asarray(case.get(f"Peri{axis}inc", np.zeros(3))) for axis in "XYZ"]
        if mode > 7 or any(np.any(np.delete(s, i)) for i, s in enumerate(shifts)):
            raise ValueError(f"PeriMode {mode}: a periodic box with a shift is not supported")
        size = np.array([abs(s[i]) or high[i] - low[i] for i, s in enumerate(shifts)])
        box = Box(low, size, np.array([bool(mode & 1), bool(mode & 2), bool(mode & 4)]))
    h = _value(case, "H", 0.0)
    spacing = _value(case, "Dp", 0.0)
    return Table(
        format="dualsphysics",
        arrays=arrays,
        code=str(case.get("AppName", "DualSPHysics"))[:80],
        kinds=kinds,
        names=_KINDS,
        counts={name: number for name, number in counts.items() if number},
        walls=walls,
        box=box,
        h=h if h > 0 else None,
        notes=[f"Dp = {spacing:g}"] if spacing > 0 else [],
    )


_KINDS = ("fixed", "moving", "float", "fluid")
