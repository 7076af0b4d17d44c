"""Table: the columns of a file under the names of the code that wrote it, and what its header says.

Readers make it and nothing else: what the columns mean is decided once, for all formats.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 1 << 34  # of arrays in memory
_ALWAYS = 1 << 26  # bytes that any file may unfold to
_FOLD = 200  # how many times larger than its file what is read may be: more is a bomb


@dataclass(frozen=True)
class Box:
    """low, size: (d,) of the box; periodic: (d,) along which axes it repeats."""

    low: NDArray[np.float64]
    size: NDArray[np.float64]
    periodic: NDArray[np.bool_]


@dataclass(kw_only=True)
class Table:
    """What a reader found.

    arrays: name -> (n,) or (n, c) numbers as the file has them
    kinds: (n,) what kind of particle each is, an index into `names`; None where there is one kind
    names: of the kinds; counts: of all kinds in the file, those not read included
    walls: kinds that are boundary particles; ghosts: (n,) further particles that are no targets
    kernel: as the header names it; h, mass: one number that the header gives for all
    """

    format: str
    arrays: dict[str, NDArray[Any]]
    code: str | None = None
    kinds: NDArray[np.int64] | None = None
    names: Sequence[str] = ("0",)
    counts: dict[str, int] | None = None
    walls: frozenset[str] = frozenset()
    ghosts: NDArray[np.bool_] | None = None
    box: Box | None = None
    kernel: str | None = None
    h: float | None = None
    notes: list[str] = field(default_factory=list)


class Budget:
    """How much a file may unfold to: sizes are compared with it before memory is taken."""

    def __init__(self, path: str | Path) -> None:
        self.left = min(MOST_BYTES, max(_ALWAYS, _FOLD * os.stat(path).st_size))

    def take(self, what: str, count: int, size: int) -> None:
        """Raises ValueError where `count` items of `size` bytes are more than is left."""
        wanted = int(count) * int(size)
        if count < 0 or wanted > self.left:
            raise ValueError(
                f"{what}: claims {count:,} × {size} bytes, more than a file of this size holds;"
                " it is damaged, or made to fill the memory"
            )
        self.left -= wanted


def whole(name: str, value: object, least: int = 0) -> int:
    """A whole number out of a header; raises ValueError for anything else."""
    try:
        number = np.asarray(value).reshape(-1)[0].item()
        if isinstance(number, bytes):
            number = number.decode("ascii")
        count = int(number)
        if count != float(number) or count < least:
            raise ValueError
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError):
        raise ValueError(f"{name}: got {str(value)[:40]}, expected a whole number") from None
    return count
