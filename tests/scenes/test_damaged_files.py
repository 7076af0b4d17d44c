"""Damaged files: a clear refusal or all particles, whatever happened to the bytes."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from sphtrunc.scenes.snapshots.formats import read
from tests.scenes import written

C = written.cloud()
TEXT = ("vtp-ascii", "vtp-inline", "vtk-ascii", "lammps", "csv", "blanks-comment")
TABLES = ("csv", "semicolons", "tabs", "blanks-comment")  # a shorter table is a table
CHANGES = 61  # of bytes, in each of the formats


def attempt(path, expected) -> str:
    """What became of the file: "refused" by one clear line, or "read" with every particle."""
    found = outcome(path)
    if isinstance(found, str):
        assert found.startswith(str(path))
        assert len(found) < 600
        return "refused"
    # a particle whose h is no longer positive is dead for Phantom, and that is said
    dead = [int(note.split()[0]) for note in found.notes if "dead or accreted" in note]
    assert found.count + sum(dead) == expected.count
    assert (found.dim, found.axes) == (expected.dim, expected.axes)
    assert all(np.all(np.isfinite(v)) for v in (found.x, *found.fields.values()))
    return "read"


def outcome(path):
    """The snapshot, or what was said against it."""
    try:
        return read(path)
    except ValueError as error:
        return str(error)


def damages(data: bytes, rng: np.random.Generator) -> list[tuple[str, bytes]]:
    """Twenty: cut off, a piece lost, a piece twice, noise, zeros."""
    n = len(data)
    made = [(f"cut at {part:.0%}", data[: int(part * n)]) for part in np.linspace(0.02, 0.97, 8)]
    for _ in range(3):
        at = int(rng.integers(n // 8, n - n // 8))
        size = n // 20
        made += [
            (f"lost at {at}", data[:at] + data[at + size :]),
            (f"twice at {at}", data[: at + size] + data[at:]),
            (f"zeros at {at}", data[:at] + bytes(size) + data[at + size :]),
            (f"noise at {at}", data[:at] + rng.bytes(size) + data[at + size :]),
        ]
    assert len(made) == 20
    return made


@pytest.mark.parametrize("name", written.FORMATS)
def test_twenty_damaged_files(name, tmp_path):
    path, _ = written.write(tmp_path, name, C)
    data, whole = path.read_bytes(), read(path)
    for what, damaged in damages(data, np.random.default_rng(5)):
        path.write_bytes(damaged)
        if name in TABLES and what.split()[0] in ("cut", "lost", "twice"):
            outcome(path)  # rows more or less are not seen
        else:
            assert attempt(path, whole) == "refused" or not what.startswith("cut"), what


@pytest.mark.parametrize("name", written.FORMATS)
def test_random_changes_of_bytes(name, tmp_path):
    path, _ = written.write(tmp_path, name, C)
    data, whole = path.read_bytes(), read(path)
    rng = np.random.default_rng(len(data))
    outcomes = Counter()
    for _ in range(CHANGES):
        changed = bytearray(data)
        for at in rng.integers(len(data), size=rng.integers(1, 4)):
            changed[at] = rng.integers(32, 127) if name in TEXT else rng.integers(256)
        path.write_bytes(changed)
        outcomes[attempt(path, whole)] += 1
    assert outcomes["refused"] > 0


def test_the_changes_are_as_many_as_they_should_be():
    assert CHANGES * len(written.FORMATS) >= 2000
