"""Studies: the product of lists of options, measured with as little work as possible, resumably.

Points that differ only in wavelength or operator share their particles (see
`sphtrunc.experiment.wavelengths`); such a group is the unit of work. Every finished group is a line
in a journal beside the output, so that a study that was stopped, in whatever way, continues where
it was, to the same bytes.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.parse import definition
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.output import digest, write_atomically
from sphtrunc.study.executors import results
from sphtrunc.study.journal import Journal, Row
from sphtrunc.version import __version__

#: options that may be lists, in the order in which they vary (the last one fastest); their default
AXES: dict[str, str] = {
    "kernel": "cubic-spline",
    "dim": "1",
    "particles": "",
    "lattice": "",
    "dx-over-h": "1/2",
    "offset": "0",
    "jitter": "0",
    "distribution": "gaussian",
    "volume": "constant",
    "wall": "",
    "wall-at": "",
    "wall-weight": "",
    "ghosts": "none",
    "operator": "gradient",
    "form": "",
    "correction": "none",
    "h-over-lambda": "0.01",
}
NUMERIC = ("dx-over-h", "offset", "jitter", "wall", "h-over-lambda")
_SCENE = tuple(AXES)[: tuple(AXES).index("operator")]
FIGURES = ("targets", "pairs", "flagged", "rms", "rms_low", "rms_high", "p50", "p99", "max")
THEORY = ("predicted", "smoothing", "discretisation", "disorder", "rounding")
COLUMNS = (*AXES, *FIGURES, *THEORY)
FORMATS = {".csv": "csv", ".jsonl": "jsonl", ".nc": "netcdf"}
MOST_POINTS = 1_000_000

Group = dict[str, Any]


@dataclass(frozen=True)
class Study:
    """What is to be measured: for every axis its values, as texts; the rest is fixed.

    rtol: as many targets as make the rms error of every point known to this part at 95 %; or
    targets: a number of them. predict: whether every point gets its prediction.

    Raises ValueError for an unknown axis, a value that cannot be read, or an operator that does not
    exist.
    """

    axes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    rtol: float | None = 0.02
    targets: int | None = None
    seed: int = 0
    predict: bool = True

    def __post_init__(self) -> None:
        unknown = [name for name in self.axes if name not in AXES]
        if unknown:
            raise ValueError(f"sweep: got {unknown[0]!r}, expected axes among {', '.join(AXES)}")
        resolved = {
            name: tuple(self.axes.get(name) or (default,)) for name, default in AXES.items()
        }
        object.__setattr__(self, "axes", resolved)
        if self.size > MOST_POINTS:
            raise ValueError(f"sweep: {self.size} points, expected at most {MOST_POINTS}")
        for name, values in resolved.items():
            if len(set(values)) != len(values):
                raise ValueError(f"{name}: a value occurs twice in {', '.join(values)[:80]}")
        if (self.rtol is None) == (self.targets is None):
            raise ValueError("sweep: expected either rtol or a number of targets")
        if self.rtol is not None and not 1e-6 <= self.rtol < 1:
            raise ValueError(f"rtol: got {self.rtol:g}, expected a number from 1e-6 to below 1")
        if self.targets is not None and self.targets < 1:
            raise ValueError(f"targets: got {self.targets}, expected at least 1")
        for one in resolved["kernel"]:
            parse_kernel(one)
        for combination in product(*(resolved[n] for n in ("operator", "form", "correction"))):
            operator_of(*combination)

    @property
    def size(self) -> int:
        """The number of points."""
        total = 1
        for values in self.axes.values():
            total *= len(values)
        return total

    def settings(self) -> dict[str, Any]:
        """Everything that the result depends on."""
        kernels = [definition(name) for name in self.axes["kernel"]]
        return {
            "axes": {name: list(values) for name, values in self.axes.items()},
            "kernels": kernels,
            "rtol": self.rtol,
            "targets": self.targets,
            "seed": self.seed,
            "predict": self.predict,
            "version": __version__,
        }

    def digest(self) -> str:
        """A fingerprint of the settings."""
        return digest(self.settings())

    def groups(self) -> list[Group]:
        """The units of work: one scene each, with all operators and wavelengths on it."""
        rest = {name: list(self.axes[name]) for name in AXES if name not in _SCENE}
        shared = {
            "rtol": self.rtol,
            "targets": self.targets,
            "seed": self.seed,
            "predict": self.predict,
        }
        return [
            {"scene": dict(zip(_SCENE, values, strict=True)), **rest, **shared}
            for values in product(*(self.axes[name] for name in _SCENE))
        ]


def operator_of(name: str, form: str, correction: str) -> Operator:
    """The operator of one row; `name` may hold all three, as gradient/difference/csph."""
    parts = name.split("/")
    if len(parts) > 3 or (len(parts) > 1 and form) or (len(parts) > 2 and correction != "none"):
        raise ValueError(
            f"operator: got {name!r} beside form {form!r} and correction {correction!r};"
            " expected name, name/form or name/form/correction, and each given once"
        )
    form = parts[1] if len(parts) > 1 else form
    correction = parts[2] if len(parts) > 2 else correction
    return Operator(parts[0], form or None, correction)


def values(text: str, numeric: bool = False) -> tuple[str, ...]:
    """A list "a,b,c", or a range "first:last:n" (evenly) or "first:last:nlog" (in the logarithm).

    >>> values("1e-2:1:3log", numeric=True)
    ('0.01', '0.1', '1.0')

    Raises ValueError for a range that cannot be read.
    """
    if not numeric or ":" not in text:
        found = tuple(part.strip() for part in text.split(","))
        if not all(found):
            raise ValueError(f"got {text[:60]!r}, expected values between the commas")
        return found
    import numpy as np

    from sphtrunc.arithmetic.rational import exact

    first, _, rest = text.partition(":")
    last, _, count = rest.partition(":")
    log = count.endswith("log")
    number = count.removesuffix("log")
    if not (number.isascii() and number.isdigit() and 2 <= int(number) <= 100_000):
        raise ValueError(
            f"got {text[:60]!r}, expected first:last:n or first:last:nlog, such as 1e-4:0.5:25log"
        )
    low, high = _float(first, exact), _float(last, exact)
    if log and not (low > 0 and high > 0):
        raise ValueError(f"got {text[:60]!r}, expected positive ends of a logarithmic range")
    grid = np.geomspace(low, high, int(number)) if log else np.linspace(low, high, int(number))
    return tuple(repr(float(f"{x:.12g}")) for x in grid)


def _float(text: str, exact: Callable[[object, str], Any]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float(exact(text.strip(), "range"))
    if not abs(value) < 1e300:
        raise ValueError(f"got {text[:40]!r}, expected a finite number")
    return value


# ------------------------------------------------------------------------------------ one group


def scene_of(given: Mapping[str, str], seed: int) -> Any:
    """The scene that the texts of one group describe."""
    from sphtrunc.scenes.jittered import jittered
    from sphtrunc.scenes.lattice import beside_wall, lattice
    from sphtrunc.scenes.random_numbers import MOST_INDICES

    if given["dim"] not in ("1", "2", "3"):
        raise ValueError(f"dim: got {given['dim'][:20]!r}, expected 1, 2 or 3")
    dim = int(given["dim"])
    if given["particles"]:
        return _relaxed(given, dim)
    extent = MOST_INDICES if dim == 1 else 1000
    offset = given["offset"].split() if " " in given["offset"] else given["offset"]
    made = lattice(
        dim,
        given["lattice"] or None,
        _number(given["dx-over-h"]),
        offset,
        volume=given["volume"],
        extent=extent,
    )
    if given["wall"]:
        made = beside_wall(
            made,
            _number(given["wall"]),
            at=given["wall-at"] or None,
            ghosts=given["ghosts"],
            weight=given["wall-weight"] or None,
        )
    elif given["wall-at"] or given["wall-weight"] or given["ghosts"] != "none":
        raise ValueError(
            "wall-at, wall-weight, ghosts: need a wall; expected distances of --wall as well"
        )
    if float(_number(given["jitter"])) == 0.0:
        return made
    return jittered(made, _number(given["jitter"]), given["distribution"], seed)


def _relaxed(given: Mapping[str, str], dim: int) -> Any:
    """A glass by its recipe, with h such that Δx/h is what is asked for."""
    from dataclasses import replace

    from sphtrunc.arithmetic.rational import exact
    from sphtrunc.experiment.glasses import glass
    from sphtrunc.experiment.relaxation import with_h
    from sphtrunc.scenes.relaxed import recipe

    free = ("kernel", "dim", "particles", "dx-over-h", "volume")
    for name in _SCENE:
        if name not in free and given[name] != AXES[name]:
            raise ValueError(f"{name}: belongs to a lattice; of particles expected none")
    made = recipe(given["particles"], dim)
    if made.dim != dim:
        raise ValueError(f"dim: got {dim}, and {given['particles'][:60]} is {made.dim}D")
    ratio = exact(_number(given["dx-over-h"]), "dx-over-h")
    if not ratio > 0:
        raise ValueError(f"dx-over-h: got {given['dx-over-h'][:40]}, expected a positive number")
    scene = with_h(glass(made).particles, 1.0 / float(ratio))
    if given["volume"] != "constant":
        scene = replace(scene, given=None, volume=given["volume"], _trees={})
    return scene


def _number(text: str) -> Any:
    """A number as it is written: exact where it is a fraction or a decimal, else a float."""
    return float(text) if "e" in text.lower() else text


def check(groups: Sequence[Group]) -> None:
    """Nothing is begun that cannot be finished: every scene and every wave can be made.

    Raises ValueError for the first that cannot.
    """
    from sphtrunc.experiment.fields import sinusoid

    for group in groups:
        scene = scene_of(group["scene"], group["seed"])
        kernel = parse_kernel(group["scene"]["kernel"])
        if group["scene"]["particles"]:
            scene.rows(kernel)  # the box may be too small
            continue
        scene.require_seen(fraction(kernel.support))
        if float(scene.dx_over_h) > 0.5 * float(kernel.support) or scene.wall is not None:
            (scene.lattice if scene.sigma else scene).rows(kernel)  # there may be no neighbour
    for text in groups[0]["h-over-lambda"]:
        sinusoid(_number(text))


def run_group(group: Group) -> list[Row]:
    """The rows of one group, in the order of the study."""
    from sphtrunc.experiment.wavelengths import waves

    scene = scene_of(group["scene"], group["seed"])
    kernel = parse_kernel(group["scene"]["kernel"])
    combinations = list(product(group["operator"], group["form"], group["correction"]))
    operators = [operator_of(*names) for names in combinations]
    lengths = [float(_number(x)) for x in group["h-over-lambda"]]
    many = bool(group["scene"]["particles"]) or bool(scene.sigma)  # all see another thing
    table = waves(
        scene,
        kernel,
        operators,
        lengths,
        rtol=group["rtol"],
        targets=group["targets"] if many else None,
        seed=group["seed"],
    )
    rows = []
    for operator, found in zip(operators, table, strict=True):
        theory = _theory(scene, kernel, operator, lengths) if group["predict"] else None
        for i, (text, one) in enumerate(zip(group["h-over-lambda"], found, strict=True)):
            error = one.error
            row: Row = dict(group["scene"])
            row |= {
                "lattice": getattr(scene, "kind", ""),
                "operator": operator.name,
                "form": operator.form,
                "correction": operator.correction,
                "h-over-lambda": text,
                "targets": one.targets,
                "pairs": one.pairs,
                "flagged": one.flagged,
            }
            if error is not None:
                row |= {name: error[name] for name in ("rms", "p50", "p99", "max")}
                row["rms_low"], row["rms_high"] = error["rms_ci95"]
            if theory is not None:
                row |= theory[i]
            rows.append({name: row.get(name) for name in COLUMNS})
    return rows


def _theory(
    scene: Any, kernel: Any, operator: Operator, lengths: Sequence[float]
) -> list[dict[str, float]] | None:
    """Predicted rms errors and their parts; None where there is no theory for the scene."""
    from dataclasses import asdict

    from sphtrunc.scenes.arrangement import Arrangement
    from sphtrunc.study.structure import by_structure, waves_by_structure
    from sphtrunc.theory.field_error import predict_waves

    try:
        if by_structure(scene):
            splits = waves_by_structure(scene, kernel, operator, lengths)
        else:
            splits = predict_waves(kernel, operator, scene, lengths)
    except ValueError:
        if isinstance(scene, Arrangement) and scene.wall is None:
            raise
        return None  # ghosts, short waves, forms that the structure factor does not know
    rows = []
    for split in splits:
        row = asdict(split)
        rows.append({"predicted": row.pop("total"), **row})
    return rows


# ------------------------------------------------------------------------------------ the sweep


def sweep(
    study: Study,
    output: str | Path | None = None,
    *,
    executor: Executor | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Row]:
    """Measure all points of a study.

    output: a .csv, .jsonl or .nc file; its journal is OUTPUT.journal, removed when the file is
        whole. None: only the rows are returned, nothing is kept
    executor: any `concurrent.futures` executor, such as those of loky, mpi4py or Dask; else
    workers: processes
    progress: called with the numbers of groups done and of all

    Raises ValueError for a journal of other settings, an unknown suffix, a full disk, or a worker
    that died; what was finished is in the journal.
    """
    path = None if output is None else Path(output)
    if path is not None and path.suffix not in FORMATS:
        raise ValueError(f"output {path}: expected a name that ends in {', '.join(FORMATS)}")
    if path is not None and path.suffix == ".nc":
        _xarray()
    groups = study.groups()
    check(groups)
    journal = (
        None if path is None else Journal(path.with_name(path.name + ".journal"), study.settings())
    )
    done: dict[int, list[Row]] = {} if journal is None else journal.done
    try:
        open_groups = [i for i in range(len(groups)) if i not in done]
        finished = results(
            run_group, groups.__getitem__, open_groups, executor=executor, workers=workers
        )
        for count, (i, rows) in enumerate(finished):
            if journal is None:
                done[i] = rows
            else:
                journal.add(i, rows)
            if progress is not None:
                progress(len(groups) - len(open_groups) + count + 1, len(groups))
    finally:
        if journal is not None:
            journal.close()
    rows = [row for i in range(len(groups)) for row in done[i]]
    if path is not None and journal is not None:
        _write(path, rows, study)
        journal.path.unlink(missing_ok=True)
    return rows


# ----------------------------------------------------------------------------------- the table


def _write(path: Path, rows: Sequence[Row], study: Study) -> None:
    kind = FORMATS[path.suffix]
    if kind == "netcdf":
        _write_netcdf(path, rows, study)
        return
    write_atomically(path, to_csv(rows) if kind == "csv" else to_jsonl(rows))


def to_csv(rows: Sequence[Row]) -> str:
    """One line a point, every digit kept."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow(["" if row[name] is None else _cell(row[name]) for name in COLUMNS])
    return out.getvalue()


def _cell(value: Any) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def to_jsonl(rows: Sequence[Row]) -> str:
    """One JSON object a line."""
    return "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows)


def to_xarray(rows: Sequence[Row], study: Study) -> Any:
    """An xarray Dataset with the axes of more than one value as dimensions."""
    import numpy as np

    xarray = _xarray()
    axes = {name: study.axes[name] for name in AXES if len(study.axes[name]) > 1}
    shape = tuple(len(v) for v in axes.values())
    dims = [name.replace("-", "_") for name in axes]
    data = {}
    for name in (*FIGURES, *THEORY):
        column = [np.nan if row[name] is None else float(row[name]) for row in rows]
        data[name] = (dims, np.array(column).reshape(shape))
    coords = {}
    for dim, (name, texts) in zip(dims, axes.items(), strict=True):
        numeric = name in NUMERIC and not any("/" in t or " " in t for t in texts)
        coords[dim] = [float(t) for t in texts] if numeric else list(texts)
    fixed = {name: study.axes[name][0] for name in AXES if name not in axes}
    return xarray.Dataset(data, coords, attrs={**fixed, "version": __version__})


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        raise ValueError(
            "output: NetCDF needs xarray, which is not installed; pip install xarray scipy, or"
            " choose .csv or .jsonl"
        ) from None
    return xarray


def _write_netcdf(path: Path, rows: Sequence[Row], study: Study) -> None:
    write_atomically(path, bytes(to_xarray(rows, study).to_netcdf(engine="scipy")))
