"""VTK XML files, .vtp and .vtu: points and point data, written as text, inline base64, or appended.

VTK XML formats (Kitware): binary data begins with a header of UInt32 or UInt64 numbers, the bytes
that follow, or, compressed, blocks, their size, the size of the last and the packed size of each.
"""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.table import Budget, Table, whole
from sphtrunc.scenes.snapshots.vtk_legacy import numbers

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4",
    "Int64": "i8", "UInt64": "u8", "Float32": "f4", "Float64": "f8",
}  # fmt: skip
_APPENDED = re.compile(rb"<AppendedData\b([^>]*)>\s*_", re.IGNORECASE)
_ENDED = re.compile(rb"</\s*AppendedData\s*>", re.IGNORECASE)
_BASE64 = re.compile(r"[A-Za-z0-9+/]+={0,2}")


def recognises(data: bytes) -> bool:
    """Whether the beginning of a file is that of this format."""
    return b"<VTKFile" in data[:4096]


def read(path: Path, kind: str | None) -> Table:
    """The points of all pieces and what is given at them."""
    if kind not in (None, "0"):
        raise ValueError(f"type: got {kind!r}, expected 0: a VTK file has points of one type")
    data = path.read_bytes()
    match = _APPENDED.search(data)
    appended, text = b"", data
    if match:
        ends = list(_ENDED.finditer(data, match.end()))
        if not ends:
            raise ValueError("the appended data does not end: it is truncated")
        appended = data[match.end() : ends[-1].start()]
        text = data[: match.end() - 1] + data[ends[-1].start() :]
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ValueError("it declares entities, which no file of particles needs")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ValueError(f"not XML: {str(error)[:80]}") from None
    coded = bool(match and b"base64" in match[1].lower())
    return _table(root, _Source(_told(root), appended, coded, Budget(path)))


def _told(element: ElementTree.Element) -> dict[str, str]:
    """Attributes, their names in small letters."""
    return {name.lower(): value for name, value in element.attrib.items()}


def _table(root: ElementTree.Element, source: _Source) -> Table:
    if root.tag != "VTKFile":
        raise ValueError(f"<{root.tag[:20]}>: expected <VTKFile>")
    kind = _told(root).get("type", "")
    grid = root.find(kind) if kind in ("PolyData", "UnstructuredGrid") else None
    if grid is None:
        raise ValueError(f"type {kind[:20]!r}: expected PolyData or UnstructuredGrid, whole")
    source.offsets = sorted(
        whole("offset", told["offset"])
        for told in map(_told, root.iter("DataArray"))
        if told.get("format", "").lower() == "appended" and "offset" in told
    )
    pieces = []
    for piece in grid.findall("Piece"):
        count = whole("NumberOfPoints", _told(piece).get("numberofpoints"))
        if not count:
            continue
        points = piece.find("Points/DataArray")
        if points is None:
            raise ValueError("a piece has no Points")
        found = {"Points": source.array(points, "Points", count)}
        if found["Points"].ndim != 2 or found["Points"].shape[1] != 3:
            raise ValueError("Points: expected three components")
        for array in piece.findall("PointData/DataArray"):
            name = _told(array).get("name", "")
            if _told(array).get("type") in _TYPES and name not in found:
                found[name] = source.array(array, name, count)
        pieces.append(found)
    if not pieces:
        raise ValueError("it has no points")
    shared = [name for name in pieces[0] if all(name in piece for piece in pieces)]
    version = next((_told(e)["solver_version"] for e in root.iter("FieldData")
                    if "solver_version" in _told(e)), None)  # fmt: skip
    return Table(
        format="vtk-xml",
        arrays={name: np.concatenate([piece[name] for piece in pieces]) for name in shared},
        code=f"solver version {version}"[:80] if version else None,
    )


class _Source:
    """How the numbers of a file are coded, and its appended data."""

    def __init__(self, told: dict[str, str], appended: bytes, coded: bool, budget: Budget) -> None:
        order = {"littleendian": "<", "bigendian": ">"}.get(
            told.get("byte_order", "LittleEndian").lower()
        )
        width = {"UInt32": "u4", "UInt64": "u8"}.get(told.get("header_type", "UInt32"))
        packer = told.get("compressor", "")
        if order is None or width is None or packer not in ("", "vtkZLibDataCompressor"):
            raise ValueError(
                f"byte_order {told.get('byte_order')}, header_type {told.get('header_type')},"
                f" compressor {packer or 'none'}: expected little or big endian, UInt32 or UInt64,"
                " and vtkZLibDataCompressor or none"
            )
        self.order, self.header = order, np.dtype(order + width)
        self.packed = bool(packer)
        self.appended, self.coded, self.budget = appended, coded, budget
        self.offsets: list[int] = []

    def array(self, element: ElementTree.Element, name: str, count: int) -> NDArray[Any]:
        """(n,) or (n, c) numbers of one DataArray."""
        told = _told(element)
        if told.get("type") not in _TYPES:
            raise ValueError(f"{name[:40]}: type {told.get('type')!r} is none of numbers")
        dtype = np.dtype(self.order + _TYPES[told["type"]])
        width = whole(f"{name[:40]} NumberOfComponents", told.get("numberofcomponents") or 1, 1)
        coding = told.get("format", "").lower()
        self.budget.take(name, count * width, max(8, dtype.itemsize))
        if coding == "ascii":
            words = (element.text or "").encode("ascii", "replace").split()
            if len(words) != count * width:
                raise ValueError(f"{name}: expected {count * width:,} numbers, got {len(words):,}")
            values = numbers(name, words, dtype)
            if dtype.kind == "f":
                values = values.astype(dtype).astype(np.float64)
        elif coding in ("binary", "appended"):
            if coding == "binary":
                raw = self._decoded(element.text or "", name)
            else:
                raw = self._appended(whole(f"{name} offset", told.get("offset")), name)
            values = np.frombuffer(self._bytes(raw, name, count * width * dtype.itemsize), dtype)
        else:
            raise ValueError(
                f"{name[:40]}: format {coding[:20]!r}; expected ascii, binary, appended"
            )
        return values.reshape(count, width) if width > 1 else values

    def _appended(self, offset: int, name: str) -> bytes:
        if offset >= len(self.appended):
            raise ValueError(f"{name}: offset {offset:,} is beyond the appended data")
        if not self.coded:
            return self.appended[offset:]
        later = [o for o in self.offsets if o > offset]
        text = self.appended[offset : later[0] if later else None].decode("ascii", "replace")
        return self._decoded(text, name)

    def _decoded(self, text: str, name: str) -> bytes:
        """Base64; header and data may be coded one by one, each with its padding."""
        text = "".join(text.split())
        parts = _BASE64.findall(text)
        if "".join(parts) != text:
            raise ValueError(f"{name}: it is not base64")
        try:
            return b"".join(base64.b64decode(part, validate=True) for part in parts)
        except binascii.Error as error:
            raise ValueError(f"{name}: {error}") from None

    def _bytes(self, raw: bytes, name: str, size: int) -> bytes:
        """The bytes of an array behind its header, unpacked."""
        word = self.header.itemsize

        def header(first: int, number: int) -> list[int]:
            if len(raw) < (first + number) * word:
                raise ValueError(f"{name}: it ends within its header")
            return [int(n) for n in np.frombuffer(raw, self.header, number, first * word)]

        if not self.packed:
            (stated,) = header(0, 1)
            if stated != size or len(raw) < word + size:
                raise ValueError(f"{name}: {size:,} bytes expected, {stated:,} stated")
            return raw[word : word + size]
        blocks, each, last = header(0, 3)
        stated = (blocks - 1) * each + (last or each) if blocks else 0
        if stated != size or last > each:
            raise ValueError(f"{name}: {blocks:,} blocks hold {stated:,} bytes, expected {size:,}")
        at, found = (3 + blocks) * word, []
        for i, packed in enumerate(header(3, blocks)):
            wanted = last if i == blocks - 1 and last else each
            if at + packed > len(raw):
                raise ValueError(f"{name}: it ends within block {i + 1} of {blocks}")
            try:
                machine = zlib.decompressobj()
                found.append(machine.decompress(raw[at : at + packed], wanted + 1))
            except zlib.error as error:
                raise ValueError(f"{name}: block {i + 1}: {error}") from None
            if len(found[-1]) != wanted or not machine.eof:
                raise ValueError(f"{name}: block {i + 1} is not {wanted:,} bytes")
            at += packed
        return b"".join(found)
