"""PySPH: output of its solver as HDF5 and as NPZ.

Ramachandran et al. (2021) doi:10.1145/3460773. The NPZ holds dictionaries as Python dumps them.
They are read opcode by opcode: numbers, text, containers and arrays are known, nothing is run.
"""

from __future__ import annotations

import io
import pickletools
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
    """The one object of a member of shape () that holds objects."""
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
        held = _told(file.read())
    except ValueError:
        raise
    except Exception as error:  # what reads noise fails in every way there is
        raise ValueError(f"{name}: damaged: {str(error)[:80]}") from None
    # the array around the one object
    inside = held.state if isinstance(held, Plain) else None
    if not isinstance(inside, tuple) or len(inside) != 5 or not isinstance(inside[4], list):
        raise ValueError(f"{name}: expected one object in an array")
    return inside[4][0] if inside[4] else None


class Plain:
    """What stands in a dump for an array or a dtype of NumPy: its state, and no code of NumPy."""

    def __init__(self, name: str, arguments: tuple[Any, ...]) -> None:
        self.name, self.arguments = name, arguments
        self.state: Any = None

    def array(self) -> NDArray[Any]:
        """The numbers; raises ValueError for a state that is not one of an array of numbers."""
        state = self.state
        if not isinstance(state, tuple) or len(state) != 5:
            raise ValueError("damaged: an array without numbers")
        _, shape, dtype, fortran, data = state
        if not isinstance(shape, tuple) or not all(isinstance(n, int) for n in shape):
            raise ValueError("damaged: an array without a shape")
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


_MARK = object()
_ARRAYS = ("_reconstruct", "ndarray", "dtype", "scalar")
#: opcodes that push what stands behind them
_VALUES = {
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "STRING",
    "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8",
    "BINBYTES", "SHORT_BINBYTES", "BINBYTES8",
}  # fmt: skip
_CONSTANTS: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}


def _told(data: bytes) -> Any:
    """What the opcodes of a dump of Python objects build, of numbers, text and containers; nothing
    that is named in it is looked up or called.

    Raises ValueError for any other opcode, and for names that are not those of NumPy's arrays.
    """
    stack: list[Any] = []
    memo: dict[Any, Any] = {}

    def since_mark() -> list[Any]:
        at = max(i for i, value in enumerate(stack) if value is _MARK)
        found = stack[at + 1 :]
        del stack[at:]
        return found

    for opcode, argument, _ in pickletools.genops(data):
        name = opcode.name
        if name in _VALUES:
            stack.append(argument)
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name == "MARK":
            stack.append(_MARK)
        elif name in ("EMPTY_DICT", "EMPTY_LIST", "EMPTY_TUPLE"):
            stack.append({"EMPTY_DICT": {}, "EMPTY_LIST": [], "EMPTY_TUPLE": ()}[name])
        elif name in ("DICT", "LIST", "TUPLE"):
            parts = since_mark()
            pairs = zip(parts[::2], parts[1::2], strict=False)
            stack.append({"DICT": dict(pairs), "LIST": parts, "TUPLE": tuple(parts)}[name])
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            count = int(name[-1])
            stack[-count:] = [tuple(stack[-count:])]
        elif name in ("MEMOIZE", "PUT", "BINPUT", "LONG_BINPUT"):
            memo[len(memo) if argument is None else argument] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(memo[argument])
        elif name in ("APPEND", "APPENDS"):
            parts = since_mark() if name == "APPENDS" else [stack.pop()]
            stack[-1].extend(parts)
        elif name in ("SETITEM", "SETITEMS"):
            parts = since_mark() if name == "SETITEMS" else [stack.pop(-2), stack.pop()]
            stack[-1].update(zip(parts[::2], parts[1::2], strict=True))
        elif name in ("GLOBAL", "STACK_GLOBAL"):
            module, member = argument.split(" ") if argument else (stack.pop(-2), stack.pop())
            stack.append(_known(str(module), str(member)))
        elif name == "REDUCE":
            arguments = stack.pop()
            stack[-1] = _made(stack[-1], arguments)
        elif name == "BUILD":
            state = stack.pop()
            if not isinstance(stack[-1], Plain):
                raise ValueError("damaged: the state of something that is no array")
            stack[-1].state = state
        elif name == "POP":
            stack.pop()
        elif name not in ("PROTO", "FRAME", "STOP"):
            raise ValueError(f"it says {name}, which is not done; expected numbers and text")
    return stack[-1]


def _known(module: str, member: str) -> str:
    """The name of something that stands in the dump of an array; raises ValueError for others."""
    if module.split(".")[0] == "numpy" and member in _ARRAYS:
        return member
    if (module, member) == ("_codecs", "encode"):
        return member
    raise ValueError(f"it names {module}.{member}, which is not run; expected numbers and text")


def _made(name: Any, arguments: Any) -> Any:
    if not isinstance(name, str) or not isinstance(arguments, tuple):
        raise ValueError("damaged: something is called that is no array")
    if name == "encode":  # how the second protocol writes bytes
        text, encoding = arguments
        if encoding not in ("latin1", b"latin1"):
            raise ValueError("damaged text")
        return text.encode("latin1") if isinstance(text, str) else bytes(text)
    return Plain(name, arguments)
