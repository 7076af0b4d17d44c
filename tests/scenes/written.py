"""Files as SPH codes write them, made from a few particles, format by format."""

from __future__ import annotations

import base64
import csv
import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np


@dataclass(frozen=True)
class Cloud:
    """x, v: (n, 3); h, m, rho, p: (n,); box: side of the cube that x lies in, from `low`."""

    x: np.ndarray
    v: np.ndarray
    h: np.ndarray
    m: np.ndarray
    rho: np.ndarray
    p: np.ndarray
    box: float = 1.0
    low: float = 0.0

    @property
    def n(self) -> int:
        return len(self.x)

    def single(self) -> Cloud:
        """What is left of the numbers in single precision."""
        rounded = {
            name: getattr(self, name).astype(np.float32).astype(np.float64)
            for name in ("x", "v", "h", "m", "rho", "p")
        }
        return replace(self, **rounded)


def cloud(side: int = 4, seed: int = 1, dim: int = 3, jitter: float = 0.15) -> Cloud:
    """side^dim particles about a lattice in the unit box; in 2D z is 0."""
    rng = np.random.default_rng(seed)
    axes = [(np.arange(side) + 0.5) / side] * dim
    x = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    x = x + rng.normal(scale=jitter / side, size=x.shape)
    x = np.clip(x, 1e-6, 1 - 1e-6)
    x = np.concatenate([x, np.zeros((len(x), 3 - dim))], axis=1)
    n = len(x)
    return Cloud(
        x=x,
        v=rng.normal(size=(n, 3)) * (np.arange(3) < dim),
        h=(1.2 + 0.1 * rng.random(n)) / side,
        m=np.full(n, 1.0 / n),
        rho=1.0 + 0.1 * rng.random(n),
        p=rng.normal(size=n),
    )


# ---------------------------------------------------------------------------------------- HDF5


def swift(path: Path, c: Cloud, *, plural: bool = False, kernel: str = "Cubic spline (M4)") -> None:
    s = "ies" if plural else "y"
    with h5py.File(path, "w") as f:
        header = f.create_group("Header").attrs
        header["BoxSize"] = [c.box] * 3
        header["NumFilesPerSnapshot"] = [1]
        header["NumPart_ThisFile"] = [c.n, 7, 0, 0, 0, 0]
        header["NumPart_Total"] = np.array([c.n, 7, 0, 0, 0, 0], np.uint32)
        header["NumPart_Total_HighWord"] = np.zeros(6, np.uint32)
        header["MassTable"] = np.zeros(6)
        f.create_group("Code").attrs["Code Version"] = np.bytes_(b"0.9.0")
        f.create_group("HydroScheme").attrs["Kernel function"] = np.bytes_(kernel.encode())
        f.create_group("RuntimePars").attrs["PeriodicBoundariesOn"] = [1]
        gas = f.create_group("PartType0")
        gas["Coordinates"] = c.x
        gas["Velocities"] = c.v.astype(np.float32)
        gas["Masses"] = c.m
        gas[f"Densit{s}"] = c.rho
        gas["SmoothingLengths" if plural else "SmoothingLength"] = c.h
        gas["Pressures" if plural else "Pressure"] = c.p
        gas["ParticleIDs"] = np.arange(c.n, dtype=np.uint64)
        f.create_group("PartType1")["Coordinates"] = np.zeros((7, 3))
        f["GasParticles"] = h5py.SoftLink("/PartType0")


def gadget(path: Path, c: Cloud, *, single: bool = True, cosmology: bool = False) -> None:
    """Gadget-2: one mass in the header, single precision, nothing said of the period."""
    kind = np.float32 if single else np.float64
    with h5py.File(path, "w") as f:
        header = f.create_group("Header").attrs
        header["BoxSize"] = c.box
        header["NumFilesPerSnapshot"] = 1
        header["NumPart_ThisFile"] = np.array([c.n, 0, 0, 0, 0, 0], np.int32)
        header["NumPart_Total"] = np.array([c.n, 0, 0, 0, 0, 0], np.uint32)
        header["MassTable"] = [c.m[0], 0, 0, 0, 0, 0]
        header["Time"], header["Redshift"] = (0.5, 1.0) if cosmology else (0.0, 0.0)
        header["HubbleParam"], header["Omega0"] = (0.7, 0.3) if cosmology else (1.0, 0.0)
        gas = f.create_group("PartType0")
        gas["Coordinates"] = c.x.astype(kind)
        gas["Velocities"] = c.v.astype(kind)
        gas["Density"] = c.rho.astype(kind)
        gas["SmoothingLength"] = c.h.astype(kind)


def gadget_pieces(path: Path, c: Cloud) -> None:
    """Two files, of which `path`, NAME.0.hdf5, is the first."""
    for i, part in enumerate((slice(0, c.n // 3), slice(c.n // 3, None))):
        with h5py.File(path.with_name(path.name.replace(".0.", f".{i}.")), "w") as f:
            header = f.create_group("Header").attrs
            header["BoxSize"], header["NumFilesPerSnapshot"] = 0.0, 2
            header["NumPart_ThisFile"] = [len(c.x[part])]
            header["NumPart_Total"] = [c.n]
            gas = f.create_group("PartType0")
            gas["Coordinates"], gas["Masses"] = c.x[part], c.m[part]
            gas["Density"], gas["SmoothingLength"] = c.rho[part], c.h[part]


def arepo(path: Path, c: Cloud) -> None:
    with h5py.File(path, "w") as f:
        header = f.create_group("Header").attrs
        header["BoxSize"], header["NumFilesPerSnapshot"] = c.box, 1
        header["NumPart_ThisFile"], header["NumPart_Total"] = [c.n], [c.n]
        f.create_group("Config").attrs["VORONOI"] = ""
        gas = f.create_group("PartType0")
        gas["Coordinates"], gas["Masses"], gas["Density"] = c.x, c.m, c.rho
        gas["SmoothingLength"] = c.h


def phantom(path: Path, c: Cloud, *, hfact: float = 1.2, types: np.ndarray | None = None) -> None:
    with h5py.File(path, "w") as f:
        header = f.create_group("header")
        header["fileident"] = np.bytes_(b"FT:Phantom:2023.0.0:abc1234 (hydro): 01/01/2024")
        header["hfact"], header["nparttot"] = hfact, np.int32(c.n)
        masses = np.zeros(56)
        masses[[0, 2]] = c.m[0]
        header.create_dataset("massoftype", data=masses, compression="gzip")
        for axis in "xyz":
            header[f"{axis}min"], header[f"{axis}max"] = c.low, c.low + c.box
        part = f.create_group("particles")
        part.create_dataset("xyz", data=c.x, compression="gzip")
        part["vxyz"], part["h"] = c.v, c.h
        part["itype"] = np.ones(c.n, np.int8) if types is None else types.astype(np.int8)


def pysph_hdf5(path: Path, c: Cloud, walls: int = 0) -> None:
    with h5py.File(path, "w") as f:
        f.create_group("solver_data").attrs["t"] = 0.25
        particles = f.create_group("particles")
        for name, part in _pysph_parts(c, walls).items():
            arrays = particles.create_group(name).create_group("arrays")
            particles[name].create_group("constants")
            for prop, values in part.items():
                data = arrays.create_dataset(prop, data=values, compression="gzip")
                data.attrs["stored"] = True
            arrays.create_dataset("tmp", (0,), "f8").attrs["stored"] = False


def _pysph_parts(c: Cloud, walls: int) -> dict[str, dict[str, np.ndarray]]:
    def part(s: slice) -> dict[str, np.ndarray]:
        v, x = c.v[s], c.x[s]
        props = {"x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "u": v[:, 0], "v": v[:, 1], "w": v[:, 2]}
        props |= {"h": c.h[s], "m": c.m[s], "rho": c.rho[s], "p": c.p[s]}
        props["tag"] = np.zeros(len(x), np.int32)
        return {name: np.ascontiguousarray(values) for name, values in props.items()}

    first = {"fluid": part(slice(0, c.n - walls))}
    return first | ({"solid": part(slice(c.n - walls, None))} if walls else {})


def pysph_npz(path: Path, c: Cloud, walls: int = 0) -> None:
    particles = {
        name: {"arrays": part, "properties": {p: {"name": p, "type": "double"} for p in part},
               "constants": {}, "output_property_arrays": list(part)}
        for name, part in _pysph_parts(c, walls).items()
    }  # fmt: skip
    np.savez(path, version=2, particles=particles, solver_data={"t": 0.25, "dt": np.float64(0.1)})


def sph_exa(path: Path, c: Cloud, steps: int = 2, periodic: int = 1) -> None:
    with h5py.File(path, "w") as f:
        f.attrs["sincIndex"] = [6.0]
        for i in range(steps):
            step = f.create_group(f"Step#{i}")
            step.attrs["box"] = [c.low, c.low + c.box] * 3
            step.attrs["boundaryType"] = np.full(3, periodic, np.int8)
            for axis, name in enumerate("xyz"):
                step[name] = c.x[:, axis] if i == steps - 1 else np.zeros(c.n)
                step[f"v{name}"] = c.v[:, axis]
            step["h"], step["rho"], step["m"], step["p"] = c.h, c.rho, c.m, c.p


# -------------------------------------------------------------------------------- DualSPHysics

_CODES = {"text": 1, "i4": 7, "u4": 8, "u8": 10, "f4": 11, "f8": 12, "3f4": 22, "3f8": 23}


def _text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def _item(
    name: str,
    values: dict[str, tuple[str, object]],
    arrays: dict[str, tuple[str, np.ndarray]],
    items: list[bytes],
) -> bytes:
    block = b""
    if values:
        block = _text("\nVALUES") + struct.pack("<I", len(values))
        for key, (kind, value) in values.items():
            block += _text(key) + struct.pack("<I", _CODES[kind])
            dtype = np.dtype("<" + kind.removeprefix("3")) if kind != "text" else None
            block += _text(str(value)) if dtype is None else np.asarray(value, dtype).tobytes()
    head = _text("\nITEM\n") + _text(name) + struct.pack("<II", 0, 0)
    head += _text("%.7E") + _text("%.15E")
    head += struct.pack("<III", len(arrays), len(items), len(block))
    found = struct.pack("<I", len(head)) + head + block
    for key, (kind, data) in arrays.items():
        raw = np.ascontiguousarray(data, "<" + kind.removeprefix("3")).tobytes()
        entry = _text("\nARRAY") + _text(key)
        entry += struct.pack("<IIII", 0, _CODES[kind], len(data), len(raw))
        found += struct.pack("<I", len(entry)) + entry + raw
    return found + b"".join(items)


def bi4(path: Path, c: Cloud, walls: int = 5, double: bool = False, periodic: bool = False) -> None:
    kind = "3f8" if double else "3f4"
    case: dict[str, tuple[str, object]] = {
        "AppName": ("text", "DualSPHysics5 v5.2"),
        "MapPosMin": ("3f8", [c.low] * 3),
        "MapPosMax": ("3f8", [c.low + c.box] * 3),
        "PeriMode": ("i4", 3 if periodic else 0),
        "PeriXinc": ("3f8", [-c.box * periodic, 0, 0]),
        "PeriYinc": ("3f8", [0, -c.box * periodic, 0]),
        "PeriZinc": ("3f8", [0, 0, 0]),
        "CaseNfixed": ("u8", walls),
        "CaseNmoving": ("u8", 0),
        "CaseNfloat": ("u8", 0),
        "CaseNfluid": ("u8", c.n - walls),
        "Dp": ("f8", 0.25),
        "H": ("f8", c.h[0]),
        "MassBound": ("f8", c.m[0]),
        "MassFluid": ("f8", c.m[0]),
    }
    arrays = {
        "Idp": ("u4", np.arange(c.n)),
        "Posd" if double else "Pos": (kind, c.x),
        "Vel": ("3f4", c.v),
        "Rhop": ("f4", c.rho),
    }
    part = _item("PART_0000", {"Npok": ("u4", c.n), "TimeStep": ("f8", 0.0)}, arrays, [])
    head = "#FileJBD JPartDataBi4".ljust(58).encode() + b"\n\0" + bytes(4)
    path.write_bytes(head + _item("JPartDataBi4", case, {}, [part]))


# ------------------------------------------------------------------------------------------ VTK

_XML = {"f4": "Float32", "f8": "Float64", "i4": "Int32", "i8": "Int64"}


def _packed(raw: bytes, header: str, compress: bool, coded: bool, block: int = 200) -> bytes:
    """Header and data of an array, as VTK writes them."""
    code = base64.b64encode if coded else bytes
    if not compress:
        return code(np.array([len(raw)], header).tobytes() + raw)
    blocks = [zlib.compress(raw[i : i + block]) for i in range(0, len(raw), block)]
    last = len(raw) % block
    head = np.array([len(blocks), block, last, *map(len, blocks)], header).tobytes()
    return code(head) + code(b"".join(blocks))


def vtk_xml(
    path: Path,
    c: Cloud,
    *,
    grid: str = "PolyData",
    mode: str = "ascii",
    header: str = "u4",
    compress: bool = False,
    order: str = "<",
    floats: str = "f8",
    capital: bool = False,
    pieces: int = 1,
) -> None:
    """mode: ascii, binary (inline base64), raw or base64 (appended); capital: `Format`."""
    appended = b""
    body = ""
    word = "Format" if capital else "format"

    def array(name: str, data: np.ndarray, kind: str) -> str:
        nonlocal appended
        parts = data.shape[1] if data.ndim == 2 else 1
        told = f'<DataArray type="{_XML[kind]}" Name="{name}" NumberOfComponents="{parts}"'
        if mode == "ascii":
            text = " ".join(repr(v) for v in data.astype(kind).reshape(-1).tolist())
            return f'{told} {word}="ascii">\n{text}\n</DataArray>\n'
        raw = data.astype(order + kind).tobytes()
        packed = _packed(raw, order + header, compress, mode != "raw")
        if mode == "binary":
            return f'{told} {word}="binary">\n{packed.decode()}\n</DataArray>\n'
        at = len(appended)
        appended += packed
        return f'{told} {word}="appended" offset="{at}"/>\n'

    for part in np.array_split(np.arange(c.n), pieces):
        body += f'<Piece NumberOfPoints="{len(part)}" NumberOfVerts="0">\n<Points>\n'
        body += array("Points", c.x[part], floats) + "</Points>\n<PointData>\n"
        for name, data in (("Velocity", c.v), ("Density", c.rho), ("mass", c.m), ("h", c.h)):
            body += array(name, data[part], floats)
        body += array("Label", np.arange(len(part)), "i4") + "</PointData>\n</Piece>\n"
    endian = "LittleEndian" if order == "<" else "BigEndian"
    packer = ' compressor="vtkZLibDataCompressor"' if compress else ""
    wide = "UInt32" if header == "u4" else "UInt64"
    text = f'<?xml version="1.0"?>\n<VTKFile type="{grid}" version="1.0" byte_order="{endian}"'
    text += f' header_type="{wide}"{packer}>\n<{grid}>\n{body}</{grid}>\n'
    data = text.encode()
    if mode in ("raw", "base64"):
        data += f'<AppendedData encoding="{mode}">\n _'.encode() + appended + b"\n</AppendedData>\n"
    path.write_bytes(data + b"</VTKFile>\n")


def vtk_legacy(
    path: Path, c: Cloud, *, binary: bool = False, grid: str = "POLYDATA", version: str = "3.0"
) -> None:
    out = io.BytesIO()
    mode = "BINARY" if binary else "ASCII"
    out.write(f"# vtk DataFile Version {version}\nvtk output\n{mode}\nDATASET {grid}\n".encode())

    def block(data: np.ndarray, kind: str) -> None:
        if binary:
            out.write(data.astype(">" + kind).tobytes() + b"\n")
        else:
            rows = data.reshape(-1).tolist()
            lines = [" ".join(map(repr, rows[i : i + 7])) for i in range(0, len(rows), 7)]
            out.write(("\n".join(lines) + "\n").encode())

    out.write(f"POINTS {c.n} double\n".encode())
    block(c.x, "f8")
    if version == "5.1":
        out.write(f"VERTICES {c.n + 1} {c.n}\nOFFSETS vtktypeint64\n".encode())
        block(np.arange(c.n + 1), "i8")
        out.write(b"CONNECTIVITY vtktypeint64\n")
        block(np.arange(c.n), "i8")
    else:
        word = "VERTICES" if grid == "POLYDATA" else "CELLS"
        out.write(f"{word} {c.n} {2 * c.n}\n".encode())
        block(np.stack([np.ones(c.n, int), np.arange(c.n)], axis=1), "i4")
        if grid != "POLYDATA":
            out.write(f"CELL_TYPES {c.n}\n".encode())
            block(np.ones(c.n, int), "i4")
    out.write(f"POINT_DATA {c.n}\nSCALARS density double 1\nLOOKUP_TABLE default\n".encode())
    block(c.rho, "f8")
    out.write(b"VECTORS velocity double\n")
    block(c.v, "f8")
    out.write(b"METADATA\nINFORMATION 0\n\n" if version == "5.1" else b"")
    out.write(f"FIELD FieldData 2\nh 1 {c.n} double\n".encode())
    block(c.h, "f8")
    out.write(f"mass 1 {c.n} double\n".encode())
    block(c.m, "f8")
    path.write_bytes(out.getvalue())


# ------------------------------------------------------------------------------------------ text


def lammps(path: Path, c: Cloud, *, scaled: bool = False, frames: int = 1, types: int = 1) -> None:
    lines = []
    for frame in range(frames):
        lines += ["ITEM: TIMESTEP", str(100 * frame), "ITEM: NUMBER OF ATOMS", str(c.n)]
        lines += ["ITEM: BOX BOUNDS pp pp ff"] + [f"{c.low!r} {c.low + c.box!r}"] * 3
        names = "xs ys zs" if scaled else "x y z"
        lines.append(f"ITEM: ATOMS id type {names} vx vy vz mass c_rho c_h")
        x = (c.x - c.low) / c.box if scaled else c.x
        for i in range(c.n):
            row = [*x[i], *c.v[i], c.m[i], c.rho[i], c.h[i]]
            row = [float(v) * (frame == frames - 1) for v in row]
            lines.append(f"{i + 1} {1 + i % types} " + " ".join(map(repr, row)))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


_TABLE = ("x", "y", "z", "vx", "vy", "vz", "h", "m", "rho", "p")


def table(path: Path, c: Cloud, *, separator: str = ",", comment: bool = False) -> None:
    """A table in text; comment: the names stand behind a #."""
    rows = np.column_stack([c.x, c.v, c.h, c.m, c.rho, c.p]).tolist()
    with open(path, "w", newline="", encoding="utf-8") as file:
        file.write("# made for a test\n")
        file.write("# " if comment else "")
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerow(_TABLE)
        writer.writerows([[repr(v) for v in row] for row in rows])


def npz(path: Path, c: Cloud, *, apart: bool = False) -> None:
    x = {"x": c.x[:, 0], "y": c.x[:, 1], "z": c.x[:, 2]} if apart else {"x": c.x}
    np.savez(path, **x, vel=c.v, h=c.h, m=c.m, rho=c.rho, P=c.p, note=np.array("text"))


Writer = Callable[[Path, Cloud], None]


def with_options(writer: Callable[..., None], **options: object) -> Writer:
    return lambda path, c: writer(path, c, **options)


#: format -> (suffix, writer, whether single precision is what it keeps)
FORMATS: dict[str, tuple[str, Writer, bool]] = {
    "swift": ("s.hdf5", swift, False),
    "swift-plural": ("s.hdf5", with_options(swift, plural=True), False),
    "gadget": ("s.hdf5", gadget, True),
    "gadget-double": ("s.hdf5", with_options(gadget, single=False), False),
    "gadget-two-files": ("s.0.hdf5", gadget_pieces, False),
    "arepo": ("s.hdf5", arepo, False),
    "phantom": ("s.h5", phantom, False),
    "pysph-hdf5": ("s.hdf5", pysph_hdf5, False),
    "pysph-npz": ("s.npz", pysph_npz, False),
    "sph-exa": ("s.h5", sph_exa, False),
    "bi4": ("Part_0001.bi4", bi4, True),
    "bi4-double": ("Part_0001.bi4", with_options(bi4, double=True), False),
    "vtp-ascii": ("s.vtp", vtk_xml, False),
    "vtp-capital-single": ("s.vtp", with_options(vtk_xml, capital=True, floats="f4"), True),
    "vtp-inline": ("s.vtp", with_options(vtk_xml, mode="binary", pieces=2), False),
    "vtu-inline-zlib": (
        "s.vtu",
        with_options(vtk_xml, grid="UnstructuredGrid", mode="binary", compress=True),
        False,
    ),
    "vtu-raw": (
        "s.vtu",
        with_options(vtk_xml, grid="UnstructuredGrid", mode="raw", header="u8"),
        False,
    ),
    "vtu-raw-zlib": (
        "s.vtu",
        with_options(vtk_xml, grid="UnstructuredGrid", mode="raw", header="u8", compress=True),
        False,
    ),
    "vtp-base64": ("s.vtp", with_options(vtk_xml, mode="base64"), False),
    "vtp-base64-zlib": ("s.vtp", with_options(vtk_xml, mode="base64", compress=True), False),
    "vtp-big-endian": ("s.vtp", with_options(vtk_xml, mode="raw", order=">"), False),
    "vtk-ascii": ("s.vtk", vtk_legacy, False),
    "vtk-binary": ("s.vtk", with_options(vtk_legacy, binary=True), False),
    "vtk-cells": ("s.vtk", with_options(vtk_legacy, grid="UNSTRUCTURED_GRID"), False),
    "vtk-5.1": ("s.vtk", with_options(vtk_legacy, version="5.1", binary=True), False),
    "lammps": ("s.dump", lammps, False),
    "lammps-frames": ("s.dump", with_options(lammps, frames=3, types=2), False),
    "csv": ("s.csv", table, False),
    "semicolons": ("s.csv", with_options(table, separator=";"), False),
    "tabs": ("s.txt", with_options(table, separator="\t"), False),
    "blanks-comment": ("s.dat", with_options(table, separator=" ", comment=True), False),
    "npz": ("s.npz", npz, False),
    "npz-apart": ("s.npz", with_options(npz, apart=True), False),
}


def write(folder: Path, name: str, c: Cloud) -> tuple[Path, Cloud]:
    """The file of that format, and the particles as it keeps them."""
    file, writer, single = FORMATS[name]
    path = folder / file
    writer(path, c)
    return path, c.single() if single else c
