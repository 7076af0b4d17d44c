"""PySPH: output of its solver as HDF5 and as NPZ.

Ramachandran et al. (2021) doi:10.1145/3460773. The NPZ holds pickled dictionaries; they are read by
`Plain`, which knows numbers, text, containers and arrays, and runs nothing.
"""

from __future__ import annotations

import io
import pickle
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.hdf5 import Group
from sphtrunc.scenes.snapshots.table import Table

#: properties whose names mean something else in other codes
_RENAMED = {"u": "vx", "v": "vy", "w": "vz", "au": "ax", "av": "ay", "aw": "az"}
_WALLS = re.compile("solid|bound|wall|body|bodies|rigid|tank|channel|obstacle|cylinder|dummy")


def recognises(root: Group) -> bool:
    """Whether the layout is this one."""
    return {"particles", "solver_data"} <= set(root.names())


def read(path: Path, root: Group, kind: str | None) -> Table:
    """The particle arrays of an HDF5 file."""
    particles = root.group("particles")
    found = {}
    for name in particles.groups():
        group = particles.group(name).group("arrays")
        found[name] = {
            prop: group.array(prop)
            for prop in group.names()
            if not (len(group.shape(prop)) == 1 and group.shape(prop)[0] == 0)
        }
    return table(found, kind)


def table(found: Mapping[str, Mapping[str, NDArray[Any]]], kind: str | None) -> Table:
    """All arrays together; walls are those called solid, boundary, wall and the like."""
    if not found:
        raise ValueError("there are no particle arrays")
    sizes = {name: len(props["x"]) if "x" in props else 0 for name, props in found.items()}
    if kind is not None and kind not in found:
        raise ValueError(f"type: there is no array {kind[:20]!r}, only {', '.join(found)}")
    used = [name for name in ([kind] if kind else found) if sizes[name]]
    if not used:
        raise ValueError(f"particle arrays {', '.join(found)} hold no particles")
    shared = [p for p in found[used[0]] if all(p in found[name] for name in used)]
    arrays = {}
    for prop in shared:
        parts = [np.asarray(found[name][prop]).reshape(-1) for name in used]
        if all(len(part) == sizes[name] for part, name in zip(parts, used, strict=True)):
            arrays[_RENAMED.get(prop, prop)] = np.concatenate(parts)
    tag = arrays.pop("tag", None)
    walls = frozenset(n for n in used if _WALLS.search(n.lower())) if len(used) > 1 else frozenset()
    return Table(
        format="pysph",
        arrays=arrays,
        code="PySPH",
        kinds=np.repeat(np.arange(len(used)), [sizes[name] for name in used]),
        names=used,
        counts=sizes,
        walls=walls if len(walls) < len(used) else frozenset(),
        ghosts=None if tag is None else tag != 0,
    )


def npz(arrays: Mapping[str, bytes], kind: str | None) -> Table:
    """The particle arrays of an NPZ file, given as the bytes of its members."""
    told = _unpickled("particles", arrays["particles"])
    found: dict[str, dict[str, NDArray[Any]]] = {}
    if not isinstance(told, dict):
        raise ValueError("particles: expected a dictionary of particle arrays")
    for name, info in told.items():
        held = info.get("arrays") if isinstance(info, dict) else None
        if not isinstance(held, dict):
            raise ValueError(f"particles: {_name(name)} has no arrays")
        found[_name(name)] = {
            _name(prop): data.array()
            for prop, data in held.items()
            if isinstance(data, Plain) and data.array().ndim == 1
        }
    return table(found, kind)


def _name(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _unpickled(name: str, data: bytes) -> Any:
    """The one object of a pickled .npy member of shape ()."""
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        reader = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, _, dtype = reader(file)
        if dtype.kind != "O" or shape not in ((), (1,)):
            raise ValueError(f"{name}: expected one object")
        held = _Reader(file, encoding="bytes").load()
    except (ValueError, KeyError):
        raise
    except Exception as error:  # a pickle machine that reads noise fails in every way there is
        raise ValueError(f"{name}: damaged: {str(error)[:80]}") from None
    # the array around the one object
    inside = held.state if isinstance(held, Plain) else None
    if not isinstance(inside, tuple) or len(inside) != 5 or not isinstance(inside[4], list):
        raise ValueError(f"{name}: expected one object in an array")
    return inside[4][0] if inside[4] else None


class Plain:
    """What stands in a pickle for an array or a dtype of NumPy: its state, and no code of NumPy."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments, self.state = arguments, None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def array(self) -> NDArray[Any]:
        """The numbers; raises ValueError for a state that is not one of an array of numbers."""
        state = self.state
        if not isinstance(state, tuple) or len(state) != 5:
            raise ValueError("damaged: an array without numbers")
        _, shape, dtype, fortran, data = state
        code = dtype.arguments[0] if isinstance(dtype, Plain) and dtype.arguments else None
        if isinstance(code, bytes):
            code = code.decode("ascii", "replace")
        if not isinstance(code, str) or not re.fullmatch("[iufb][1248]", code):
            return np.empty((0, 0, 0))  # text or objects: no column
        told = dtype.state
        order = told[1] if isinstance(told, tuple) and len(told) > 1 else "<"
        order = order.decode("ascii", "replace") if isinstance(order, bytes) else order
        exact = np.dtype((">" if order == ">" else "<") + code)
        count = 1
        for n in shape:
            count *= int(n)
        if not isinstance(data, bytes) or count * exact.itemsize != len(data) or fortran:
            raise ValueError("damaged: an array whose size is not that of its numbers")
        return np.frombuffer(data, dtype=exact).reshape(shape)


class _Reader(pickle.Unpickler):
    """A pickle machine for which every name is `Plain`."""

    def find_class(self, module: str, name: str) -> Any:
        if module.split(".")[0] == "numpy" and name in (
            "_reconstruct",
            "ndarray",
            "dtype",
            "scalar",
        ):
            return Plain
        if (module, name) == ("_codecs", "encode"):
            return _encoded
        raise ValueError(f"it names {module}.{name}, which is not run; expected numbers and text")


def _encoded(text: str, encoding: str) -> bytes:
    """How pickles of the second protocol write bytes."""
    if encoding not in ("latin1", b"latin1"):
        raise ValueError("damaged text")
    return text.encode("latin1") if isinstance(text, str) else bytes(text)
