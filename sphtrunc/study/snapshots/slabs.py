"""Slabs: an error map of more particles than their sums fit into memory for.

The sums of a slab across the longest axis need the particles in it and within a support of it, and
are those of the whole to the last bit. Every finished slab is a file, and a line in a journal
beside the output: a map that was stopped, in whatever way, continues where it was.
"""

from __future__ import annotations

import hashlib
import io
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.kernels.parse import definition
from sphtrunc.output import write_atomically
from sphtrunc.study.executors import results
from sphtrunc.study.journal import Journal
from sphtrunc.study.snapshots.error_map import DEFAULT, ErrorMap, Question
from sphtrunc.study.snapshots.map_files import check, write
from sphtrunc.study.snapshots.target_sums import at_targets, name_of
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.scenes.particles import Particles

MEMORY = 1 << 30  # bytes of sums, where nothing else is said
_LEAST = 64  # targets of a slab


@contextmanager
def map_in_slabs(
    particles: Particles,
    kernel: Kernel | str,
    estimates: Sequence[Operator] = DEFAULT,
    *,
    output: str | Path,
    memory: float = MEMORY,
    degree: int = 2,
    fields: Mapping[str, object] | None = None,
    targets: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    processes: int = 1,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[ErrorMap]:
    """The map of `error_map`, written to `output` as `map_files.write` does; its arrays lie on the
    disk, and are there inside of the `with` only.

    memory: bytes of the sums that are held at once; the particles come on top of that
    workers: threads of one process; processes, executor: as for `sphtrunc.study.sweep.sweep`
    progress: called with the numbers of slabs done and of all

    OUTPUT.journal and OUTPUT.slabs keep what is finished, until the output is whole. Raises
    ValueError as `error_map` does, for a journal of other settings, and for a full disk.
    """
    if not memory > 0:
        raise ValueError(f"memory: got {memory!r}, expected a number of bytes")
    check(output)
    question = Question.of(particles, kernel, estimates, degree, fields, targets, seed)
    asked = question.asked(workers=workers, engine="numba")
    together = processes if executor is None else 1
    most = max(_LEAST, int(memory / (asked.size * together)))
    slabs = asked.cut(-(-question.targets.size // most))
    path = Path(output)
    folder = path.with_name(path.name + ".slabs")
    journal = Journal(path.with_name(path.name + ".journal"), _settings(question, len(slabs)))
    try:
        folder.mkdir(exist_ok=True)
        left = [i for i in range(len(slabs)) if not _kept(folder, i, journal)]
        made = results(
            at_targets, lambda i: asked.slab(slabs[i]), left, executor=executor, workers=processes,
            ahead=2 * together,
        )  # fmt: skip
        for done, (i, found) in enumerate(made):
            journal.add(i, [{"sha256": _keep(folder, i, found)}])
            if progress is not None:
                progress(len(slabs) - len(left) + done + 1, len(slabs))
        whole = question.answered(_joined(folder, slabs), {"workers": workers})
        write(whole, path)
    except OSError as error:
        raise ValueError(f"output {folder}: {error.strerror or error}") from None
    finally:
        journal.close()
    journal.path.unlink(missing_ok=True)
    try:
        yield whole
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _settings(question: Question, count: int) -> dict[str, Any]:
    """Everything that the slabs depend on."""
    it = question.particles
    data = hashlib.sha256()
    for values in (it.x, it.h, it.mass, it.given, it.period, it.walls, question.targets):
        data.update(b"none" if values is None else np.ascontiguousarray(values).data)
    return {
        "axes": {},
        "particles": data.hexdigest(),
        "volume": [it.volume, it.mode],
        "kernel": definition(question.kernel),
        "estimates": [name_of(one) for one in question.operators],
        "degree": question.degree,
        "fields": bool(question.fields),
        "slabs": count,
        "version": __version__,
    }


def _file(folder: Path, slab: int) -> Path:
    return folder / f"slab-{slab:05d}.npz"


def _keep(folder: Path, slab: int, found: Mapping[str, Any]) -> str:
    """Write the sums of a slab; their digest."""
    buffer = io.BytesIO()
    np.savez(buffer, **found)
    data = buffer.getvalue()
    write_atomically(_file(folder, slab), data)
    return hashlib.sha256(data).hexdigest()


def _kept(folder: Path, slab: int, journal: Journal) -> bool:
    """Whether a slab is finished, and its file as it was."""
    if slab not in journal.done:
        return False
    try:
        data = _file(folder, slab).read_bytes()
    except OSError:
        return False
    return bool(journal.done[slab][0].get("sha256") == hashlib.sha256(data).hexdigest())


def _joined(folder: Path, slabs: Sequence[Any]) -> dict[str, Any]:
    """Arrays of all targets, on the disk, from those of the slabs."""
    count = sum(which.size for which in slabs)
    found: dict[str, Any] = {}
    for i, which in enumerate(slabs):
        with np.load(_file(folder, i), allow_pickle=False) as part:
            for name in part.files:
                values = part[name]
                if name not in found:
                    found[name] = np.lib.format.open_memmap(
                        folder / f"{name}.npy", "w+", values.dtype, (count, *values.shape[1:])
                    )
                found[name][which] = values
    return found
