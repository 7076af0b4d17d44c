"""HDF5 as something hostile: no link out of the file is followed, no size is believed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes.snapshots.table import Budget

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MOST_MEMBERS = 4096  # of a group


@contextmanager
def opened(path: Path) -> Iterator[Group]:
    """The root of a file, to read.

    Raises ValueError where h5py is missing, and for whatever the library finds wrong inside.
    """
    try:
        import h5py
    except ImportError:
        raise ValueError(
            f"{path}: HDF5 needs h5py; install it with pip install 'sphtrunc[snapshots]'"
        ) from None
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield Group(file, Budget(path), "")
    except ValueError:
        raise
    except (OSError, RuntimeError, KeyError, TypeError, OverflowError, MemoryError) as error:
        raise ValueError(f"damaged HDF5: {' '.join(str(error).split())[:120]}") from None


class Group:
    """A group of which only what lies in the same file is seen."""

    def __init__(self, group: Any, budget: Budget, name: str) -> None:
        self._group, self._budget, self._name = group, budget, name
        if len(group) > _MOST_MEMBERS:
            raise ValueError(f"{name or '/'} has {len(group)} members, expected a snapshot")

    def __contains__(self, name: str) -> bool:
        return bool(name in self._group)

    def names(self) -> list[str]:
        """Of everything in the group."""
        return [str(name) for name in self._group]

    def _member(self, name: str) -> Any:
        import h5py

        if name not in self:
            raise ValueError(f"{self._name}/{name} is missing")
        link = self._group.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            raise ValueError(
                f"{self._name}/{name} is a link to somewhere else; links are not followed: give the"
                " file that holds the data"
            )
        return self._group[name]

    def group(self, name: str) -> Group:
        """A group in this one; raises ValueError where there is none."""
        import h5py

        member = self._member(name)
        if not isinstance(member, h5py.Group):
            raise ValueError(f"{self._name}/{name} is no group")
        return Group(member, self._budget, f"{self._name}/{name}")

    def groups(self) -> list[str]:
        """The names of the groups in this one."""
        import h5py

        return [
            name
            for name in self.names()
            if isinstance(self._group.get(name, getlink=True), h5py.HardLink)
            and self._group.get(name, getclass=True) is h5py.Group
        ]

    def attributes(self) -> dict[str, Any]:
        """Attributes that are numbers, text or short arrays of them."""
        found = {}
        for name in list(self._group.attrs)[:_MOST_MEMBERS]:
            identity = self._group.attrs.get_id(name)
            self._budget.take(f"attribute {name}", int(np.prod(identity.shape or (1,))), 8)
            value = self._group.attrs[name]
            if isinstance(value, bytes | np.bytes_):
                value = value.decode("utf-8", "replace")
            found[str(name)] = value
        return found

    def array(self, name: str) -> NDArray[Any]:
        """The numbers of a dataset, as they are; raises ValueError for anything that is not a plain
        array of numbers in this file."""
        data = self._dataset(name)
        where = f"{self._name}/{name}"
        if data.dtype.kind not in "iufb" or data.dtype.itemsize > 16:
            raise ValueError(f"{where} holds {data.dtype}, expected numbers")
        if len(data.shape) > 2:
            raise ValueError(f"{where} has shape {data.shape}, expected (n,) or (n, c)")
        self._budget.take(where, int(np.prod(data.shape, dtype=object)), data.dtype.itemsize)
        return np.asarray(data[()])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All datasets of numbers with one or two axes."""
        found = {}
        for name in self.names():
            data = self._plain(name)
            if data is not None:
                found[name] = self.array(name)
        return found

    def shape(self, name: str) -> tuple[int, ...]:
        """Of a dataset."""
        return tuple(self._dataset(name).shape)

    def text(self, name: str) -> str:
        """A dataset that is one piece of text; "" where there is none."""
        if name not in self:
            return ""
        data = self._dataset(name)
        if data.dtype.kind != "S" or data.shape not in ((), (1,)) or data.dtype.itemsize > 4096:
            return ""
        return bytes(np.asarray(data[()]).reshape(-1)[0]).decode("utf-8", "replace").strip()

    def _plain(self, name: str) -> Any:
        """The dataset if it holds numbers along one or two axes; None otherwise."""
        import h5py

        if self._group.get(name, getclass=True, getlink=True) is not h5py.HardLink:
            return None
        if self._group.get(name, getclass=True) is not h5py.Dataset:
            return None
        data = self._group[name]
        fits = data.shape is not None and len(data.shape) in (1, 2) and data.dtype.kind in "iufb"
        return data if fits else None

    def _dataset(self, name: str) -> Any:
        import h5py

        data = self._member(name)
        where = f"{self._name}/{name}"
        if not isinstance(data, h5py.Dataset) or data.shape is None:
            raise ValueError(f"{where} is no array")
        if data.is_virtual or data.external:
            raise ValueError(
                f"{where} has its numbers in another file; such files are not followed: give the"
                " files that hold the data"
            )
        if data.size and data.chunks is not None and not data.id.get_storage_size():
            raise ValueError(f"{where} claims {data.size:,} numbers and holds none")
        return data
