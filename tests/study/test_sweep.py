"""Studies: every row is a measurement, and nothing is lost whatever happens on the way."""

from __future__ import annotations

import csv
import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from math import prod

import pytest

from sphtrunc.cli import main
from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.glasses import glass
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.relaxation import with_h
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.relaxed import recipe
from sphtrunc.scenes.walls import GHOSTS
from sphtrunc.study.sweep import AXES, COLUMNS, Study, operator_of, scene_of, sweep, to_csv, values

SMALL = Study(
    axes={
        "kernel": ("cubic-spline", "0..1: 1-3/2*q^2+3/4*q^3; 1..2: (2-q)^3/4"),
        "dx-over-h": ("0.3", "4/11", "0.7"),
        "jitter": ("0", "0.1"),
        "operator": ("value", "gradient/difference/csph"),
        "h-over-lambda": ("0.003", "0.1"),
    },
    rtol=None,
    targets=60,
    predict=False,
)


def run(study, path, **options):
    sweep(study, path, **options)
    return path.read_bytes()


def test_every_row_is_a_measurement(tmp_path):
    rows = sweep(SMALL)
    assert len(rows) == SMALL.size == 2 * 3 * 2 * 2 * 2
    seen = set()
    for row in rows:
        seen.add(tuple(row[name] for name in AXES))
        text = {name: str(row[name]) for name in AXES}
        scene = scene_of(text, 0)
        alone = measure(
            scene,
            row["kernel"],
            operator_of(row["operator"], row["form"], row["correction"]),
            sinusoid(row["h-over-lambda"]),
            targets=60 if scene.sigma else None,
        )
        assert row["targets"] == alone.targets
        # both ways round differently: 40 terms of the series, Σ|w| <= 10, kh = 2π h/λ
        within = 40 * 2.0**-53 * 10 / (6 * float(row["h-over-lambda"]))
        assert abs(row["rms"] - alone.error["rms"]) <= within
        assert abs(row["max"] - alone.error["max"]) <= within
        assert row["rms_low"] <= row["rms"] <= row["rms_high"]
    assert len(seen) == len(rows)


def test_the_order_is_that_of_the_product():
    rows = sweep(SMALL)
    columns = ("kernel", "dx-over-h", "jitter", "operator", "h-over-lambda")
    places = []
    for row in rows:
        index = 0
        for name in columns:
            choices = [v.split("/")[0] if name == "operator" else v for v in SMALL.axes[name]]
            index = index * len(choices) + choices.index(row[name])
        places.append(index)
    assert places == sorted(places)


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_the_table_is_whole_and_the_journal_gone(tmp_path, suffix):
    path = tmp_path / f"table{suffix}"
    rows = sweep(SMALL, path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    if suffix == ".csv":
        found = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))
        assert tuple(found[0]) == COLUMNS
        assert [float(r["rms"]) for r in found] == [r["rms"] for r in rows]
    else:
        assert [json.loads(x) for x in path.read_text(encoding="utf-8").splitlines()] == rows


def test_any_executor_gives_the_same_bytes(tmp_path):
    alone = run(SMALL, tmp_path / "a.csv")
    with ThreadPoolExecutor(3) as pool:
        assert run(SMALL, tmp_path / "b.csv", executor=pool) == alone
    assert run(SMALL, tmp_path / "c.csv", workers=2) == alone


class StopError(Exception):
    """Raised by a progress callback."""


def interrupted(study, path, after):
    """Run until `after` groups are done."""

    def progress(done, expected):
        if done >= after:
            raise StopError

    with pytest.raises(StopError):
        sweep(study, path, progress=progress)


def test_a_journal_cut_at_any_byte_is_continued(tmp_path):
    whole = run(SMALL, tmp_path / "whole.csv")
    path = tmp_path / "table.csv"
    journal = tmp_path / "table.csv.journal"
    interrupted(SMALL, path, 7)
    data = journal.read_bytes()
    assert data.count(b"\n") == 8
    rng = random.Random(5)
    cuts = [0, 1, data.index(b"\n"), data.index(b"\n") + 1, len(data) - 1, len(data)]
    cuts += [rng.randrange(len(data)) for _ in range(6)]
    for cut in cuts:
        journal.write_bytes(data[:cut])
        counted = []
        sweep(SMALL, path, progress=lambda done, _: counted.append(done))  # noqa: B023
        kept = max(0, data[:cut].count(b"\n") - 1)
        assert counted[0] == kept + 1
        assert path.read_bytes() == whole
        path.unlink()


def test_a_journal_of_other_settings_is_refused(tmp_path):
    path = tmp_path / "table.csv"
    interrupted(SMALL, path, 2)
    before = (tmp_path / "table.csv.journal").read_bytes()
    other = Study(axes={**SMALL.axes, "jitter": ("0", "0.2")}, rtol=None, targets=60)
    with pytest.raises(ValueError, match=r"other settings \(predict, jitter\)"):
        sweep(other, path)
    assert (tmp_path / "table.csv.journal").read_bytes() == before


def test_a_kernel_file_that_changed_is_other_settings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "my.toml"
    text = 'name = "mine"\nknots = [0, 2]\npieces = ["(2-q)^3"]\n'
    file.write_text(text)
    study = Study(axes={"kernel": ("my.toml",)}, predict=False)
    first = study.digest()
    file.write_text(text.replace("^3", "^4"))
    assert Study(axes={"kernel": ("my.toml",)}, predict=False).digest() != first


COMMAND = [
    *(sys.executable, "-m", "sphtrunc", "sweep", "--no-predict", "--targets", "400"),
    *("--dx-over-h", "0.1:0.7:12", "--jitter", "0.05,0.1", "--kernel", "polynomial:4"),
    *("--operator", "gradient,gradient/difference/csph", "--h-over-lambda", "1e-3:0.3:5log"),
]


@pytest.mark.parametrize("workers", [1, 2])
def test_killed_and_repeated_it_ends_with_the_same_bytes(tmp_path, workers):
    """SPHTRUNC_KILLS=20 kills it that often; the last run is left alone."""
    whole, path = tmp_path / "whole.csv", tmp_path / "table.csv"
    subprocess.run([*COMMAND, "-o", str(whole)], check=True, capture_output=True)
    command = [*COMMAND, "--workers", str(workers), "-o", str(path)]
    rng = random.Random(workers)
    groups = 0
    journal = tmp_path / "table.csv.journal"
    for _ in range(int(os.environ.get("SPHTRUNC_KILLS", "2"))):
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        until = time.monotonic() + rng.uniform(0.3, 1.6)
        while time.monotonic() < until and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
        groups = 0 if path.exists() else groups  # it came to its end in time: begin again
        path.unlink(missing_ok=True)
        lines = journal.read_bytes().count(b"\n") if journal.exists() else 0
        assert lines >= groups  # nothing that was finished is lost
        groups = lines
    last = subprocess.run(command, capture_output=True, text=True, check=True)
    assert last.stderr == ""  # no progress bar in a pipe
    assert path.read_bytes() == whole.read_bytes()
    assert not journal.exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_interrupted_it_says_how_to_go_on(tmp_path, workers):
    path, journal = tmp_path / "table.csv", tmp_path / "table.csv.journal"
    command = [*COMMAND, "--dim", "2", "--targets", "5000", "--workers", str(workers)]
    process = subprocess.Popen(
        [*command, "-o", str(path)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    until = time.monotonic() + 60
    while time.monotonic() < until and not (
        journal.exists() and journal.read_bytes().count(b"\n") > 2
    ):
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, workers included
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines()[-1].startswith("interrupted")
    assert "repeat to go on" in said
    assert "Traceback" not in said
    assert journal.read_bytes().count(b"\n") > 2


LIMITED = """
import resource, sys
from sphtrunc.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))
main(sys.argv[1:])
"""


def test_a_full_disk_ends_with_a_message_and_a_usable_journal(tmp_path):
    resource = pytest.importorskip("resource", reason="limits of a process are a Unix matter")
    assert resource
    whole, path = tmp_path / "whole.csv", tmp_path / "table.csv"
    subprocess.run([*COMMAND, "-o", str(whole)], check=True, capture_output=True)
    limited = [sys.executable, "-c", LIMITED, *COMMAND[3:], "-o", str(path)]
    first = subprocess.run(limited, capture_output=True, text=True)
    assert first.returncode == 2
    assert "journal" in first.stderr
    assert "repeat the command" in first.stderr
    assert first.stderr.count("\n") == 1
    assert (tmp_path / "table.csv.journal").stat().st_size <= 6000
    subprocess.run([*COMMAND, "-o", str(path)], check=True, capture_output=True)
    assert path.read_bytes() == whole.read_bytes()


def test_a_dataset_has_the_axes_as_dimensions(tmp_path):
    xarray = pytest.importorskip("xarray", reason="NetCDF is written where xarray is installed")
    study = Study(
        axes={"jitter": ("0", "0.1"), "h-over-lambda": ("0.01", "0.1", "0.2")},
        rtol=None,
        targets=50,
        predict=False,
    )
    rows = sweep(study, tmp_path / "table.nc")
    with xarray.open_dataset(tmp_path / "table.nc", engine="scipy") as found:
        assert dict(found.sizes) == {"jitter": 2, "h_over_lambda": 3}
        assert found.rms.values.ravel().tolist() == [row["rms"] for row in rows]
        assert found.attrs["kernel"] == "cubic-spline"


def test_netcdf_without_xarray_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ValueError, match="pip install xarray"):
        sweep(SMALL, tmp_path / "table.nc")
    assert not list(tmp_path.iterdir())


def test_dask_without_distributed_is_told(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SystemExit) as stop:
        main(["sweep", "--dask", "127.0.0.1:1"])
    assert stop.value.code == 2
    assert "pip install distributed" in capsys.readouterr().err


def until_true(what, process, seconds=120.0):
    """Wait for it, as long as the process runs."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and process.poll() is None and not what():
        time.sleep(0.02)
    assert what()


def test_a_cluster_that_loses_a_worker_gives_the_same_bytes(tmp_path):
    """A scheduler of Dask and two worker processes on this machine, one killed in the middle."""
    pytest.importorskip("distributed", reason="--dask is tested where it is installed")
    command = [*COMMAND, "--dim", "2", "--targets", "800"]
    whole, path = tmp_path / "whole.csv", tmp_path / "table.csv"
    subprocess.run([*command, "-o", str(whole)], check=True, capture_output=True)
    file, journal = tmp_path / "scheduler.json", tmp_path / "table.csv.journal"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    program = [sys.executable, "-m", "distributed.cli.dask_{}", "--scheduler-file", str(file)]
    local = ["--host", "127.0.0.1", "--no-dashboard"]
    worker = [*program, *local, "--no-nanny", "--nthreads", "1"]
    starts = [[*program, *local, "--port", "0"], worker, worker]
    made = []
    try:
        for role, start in zip(("scheduler", "worker", "worker"), starts, strict=True):
            made.append(subprocess.Popen([part.format(role) for part in start], **quiet))
        until_true(file.exists, made[0])
        address = json.loads(file.read_text())["address"]
        run = subprocess.Popen(
            [*command, "--dask", address, "-o", str(path)], stderr=subprocess.PIPE, text=True
        )
        until_true(lambda: journal.exists() and journal.read_bytes().count(b"\n") > 3, run)
        made[1].kill()
        kept = journal.read_bytes().count(b"\n")
        _, said = run.communicate(timeout=120)
    finally:
        for process in made:
            process.kill()
            process.wait()
    assert run.returncode == 0, said
    assert 3 < kept < 25  # the head and 24 groups: it was in the middle
    assert path.read_bytes() == whole.read_bytes()


def test_predictions_stand_beside_and_agree():
    study = Study(
        axes={
            "jitter": ("0", "0.1"),
            "operator": ("gradient", "gradient/difference/csph"),
            "h-over-lambda": ("0.001", "0.05"),
        },
        rtol=None,
        targets=5000,
    )
    for row in sweep(study):
        spread = (row["rms_high"] - row["rms_low"]) / 2
        assert abs(row["rms"] - row["predicted"]) <= max(0.05 * row["rms"], 1.5 * spread)
        assert (row["disorder"] > 0) == (row["jitter"] != "0")


def test_lists_and_ranges():
    assert values("a, b,c") == ("a", "b", "c")
    assert values("0:1:5", numeric=True) == ("0.0", "0.25", "0.5", "0.75", "1.0")
    assert values("1/4:1/2:2", numeric=True) == ("0.25", "0.5")
    assert values("4/11,0.7", numeric=True) == ("4/11", "0.7")
    grid = [float(v) for v in values("1e-4:0.5:25log", numeric=True)]
    assert (len(grid), grid[0], grid[-1]) == (25, 1e-4, 0.5)
    steps = [b / a for a, b in pairwise(grid)]
    assert max(steps) / min(steps) - 1 < 1e-10  # twelve digits are kept
    assert values("0..1: 1-q; 1..2: 0") == ("0..1: 1-q; 1..2: 0",)


@pytest.mark.parametrize(
    "text", ["1:2", "1:2:1", "1:2:3lin", "0:1:3log", ":::", "1:nan:3", "a:b:3", "1:2:-3", "1,,2"]
)
def test_ranges_that_cannot_be_read(text):
    with pytest.raises(ValueError, match=r"got|range"):
        values(text, numeric=True)


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ({"colour": ("red",)}, "axes among"),
        ({"kernel": ("cubic-splin",)}, "cubic-spline"),
        ({"operator": ("gradient/brookshaw",)}, "form"),
        ({"operator": ("gradient/difference",), "form": ("standard",)}, "each given once"),
        ({"operator": ("laplacian",), "correction": ("csph",)}, "correction"),
        ({"jitter": ("0", "0")}, "twice"),
        ({"h-over-lambda": tuple(str(i) for i in range(1001)),
          "dx-over-h": tuple(str(i) for i in range(1001))}, "1002001 points"),
    ],
)  # fmt: skip
def test_studies_that_cannot_be(axes, says):
    with pytest.raises(ValueError, match=says):
        Study(axes=axes)


def test_outputs_that_cannot_be(tmp_path):
    with pytest.raises(ValueError, match=r"\.csv, \.jsonl, \.nc"):
        sweep(SMALL, tmp_path / "table.xlsx")
    with pytest.raises(ValueError, match=r"journal .*expected an output in a folder that exists"):
        sweep(SMALL, tmp_path / "no" / "table.csv")


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ({"dx-over-h": ("0.2", "3")}, "no neighbour"),
        ({"jitter": ("0", "-1")}, "jitter: got -1"),
        ({"dim": ("1", "4")}, "dim: got '4'"),
        ({"lattice": ("uniform", "bcc")}, "lattice: got 'bcc'"),
        ({"distribution": ("gaussian", "green"), "jitter": ("0.1",)}, "distribution: got 'green'"),
        ({"h-over-lambda": ("0.1", "0")}, "h_over_lambda: got 0"),
    ],
)
def test_nothing_is_begun_that_cannot_be_finished(tmp_path, axes, says):
    with pytest.raises(ValueError, match=says):
        sweep(Study(axes=axes), tmp_path / "table.csv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("much", [{"rtol": 0.0}, {"rtol": 1.0}, {"rtol": None, "targets": 0}])
def test_measures_of_how_much_that_cannot_be(much):
    with pytest.raises(ValueError, match=r"^(rtol|targets): got"):
        Study(**much)


def test_points_share_one_look_at_their_particles(monkeypatch):
    """25 wavelengths and three operators look at as many targets as one point does; independent
    measurements look at 75 times as many."""
    looked = []
    whole = Jittered.neighbourhood

    def counted(self, target, kernel, *more, **named):
        looked.append(len(target))
        return whole(self, target, kernel, *more, **named)

    monkeypatch.setattr(Jittered, "neighbourhood", counted)
    study = Study(
        axes={
            "dim": ("3",),
            "dx-over-h": ("0.7",),
            "jitter": ("0.1",),
            "operator": ("gradient", "gradient/difference", "gradient/difference/csph"),
            "h-over-lambda": values("1e-3:0.5:25log", numeric=True),
        },
        rtol=None,
        targets=100,
        predict=False,
    )
    rows = sweep(study)
    assert len(rows) == 75
    assert sum(looked) == 100
    looked.clear()
    measure(scene_of({n: str(rows[0][n]) for n in AXES}, 0), rows[0]["kernel"], targets=100)
    assert sum(looked) == 100


def test_three_dimensions_lattices_and_volumes():
    study = Study(
        axes={
            "dim": ("3",),
            "lattice": ("bcc", "fcc"),
            "dx-over-h": ("0.8",),
            "jitter": ("0", "0.1"),
            "h-over-lambda": ("0.05", "0.1"),
            "operator": ("laplacian/brookshaw", "gradient"),
        },
        rtol=None,
        targets=20,
        predict=False,
    )
    rows = sweep(study)
    assert [row["lattice"] for row in rows] == ["bcc"] * 8 + ["fcc"] * 8
    assert all(0 < row["rms"] < 10 for row in rows)


def test_the_command(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["sweep", "--dx-over-h", "0.2:0.4:3", "--no-predict"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert text.splitlines()[0] == ",".join(COLUMNS)
    study = Study(axes={"dx-over-h": ("0.2", "0.3", "0.4")}, predict=False)
    assert text == to_csv(sweep(study))
    assert len(text.splitlines()) == 1 + prod((3, 1))
    with pytest.raises(SystemExit) as stop:
        main(["sweep", "--dx-over-h", "0.2:0.4"])
    assert stop.value.code == 2
    assert "dx-over-h" in capsys.readouterr().err


# ------------------------------------------------------------------------------ beside a wall


BESIDE = Study(
    axes={
        "wall": ("0", "1/3", "2"),
        "wall-at": ("half-way",),
        "dx-over-h": ("3/10",),
        "operator": ("value", "gradient/difference/csph", "laplacian/brookshaw"),
        "h-over-lambda": ("0.003", "0.1"),
    },
    rtol=None,
    targets=40,
)


@pytest.mark.parametrize("ghosts", GHOSTS)
def test_rows_beside_a_wall_are_measurements(ghosts):
    """By many wavelengths at once, and one by one; with ghosts there is no prediction."""
    distances = ("3/10", "2") if ghosts == "dummy" else BESIDE.axes["wall"]  # dummies see fluid
    rows = sweep(replace(BESIDE, axes={**BESIDE.axes, "wall": distances, "ghosts": (ghosts,)}))
    assert len(rows) == len(distances) * 3 * 2
    for row in rows:
        scene = scene_of({name: str(row[name] or "") for name in AXES}, 0)
        operator = operator_of(row["operator"], row["form"], row["correction"])
        alone = measure(scene, row["kernel"], operator, sinusoid(row["h-over-lambda"]))
        within = 1e-13 / float(row["h-over-lambda"]) ** operator.derivatives
        assert abs(row["rms"] - alone.error["rms"]) <= within
        assert (row["predicted"] is None) == (ghosts != "none")


@pytest.mark.parametrize("jitter", ["0", "0.05"])
def test_rows_beside_a_wall_are_predicted(jitter):
    """On a lattice to its rounding; of 40 targets the rms of waves of random phase to 5/√80."""
    within = {"0": 1e-9, "0.05": 5 / 80**0.5}[jitter]
    rows = sweep(replace(BESIDE, axes={**BESIDE.axes, "jitter": (jitter,)}))
    assert len(rows) == 18
    for row in rows:
        assert abs(row["rms"] / row["predicted"] - 1) <= within
    at_wall, far = (
        [r["smoothing"] for r in rows if r["wall"] == eta and r["operator"] == "gradient"]
        for eta in ("0", "2")
    )
    assert at_wall[0] > 20 * far[0]  # of first order at the wall, of second inside


def test_walls_that_are_refused():
    for axes, message in (
        ({"ghosts": ("mirror",)}, "need a wall"),
        ({"wall": ("0",), "jitter": ("0.1",), "wall-at": ("particle",)}, "not on the wall"),
        ({"wall": ("0",), "wall-at": ("half-way",), "ghosts": ("dummy",)}, "see no fluid"),
        ({"wall": ("-1",)}, "wall: got η = -1"),
    ):
        with pytest.raises(ValueError, match=message):
            sweep(Study(axes=axes))


def test_relaxed_particles_are_an_axis():
    """Two glasses, measured as `measure` measures them, with the prediction of their S(k)."""
    recipes = ("relaxed:glass,N=225,steps=20", "relaxed:glass,N=225,steps=20,seed=1")
    axes = {
        "kernel": ("wendland-c2",), "dim": ("2",), "particles": recipes, "dx-over-h": ("2/3",),
        "h-over-lambda": ("0.05",), "operator": ("gradient/difference/csph", "laplacian/nested"),
    }  # fmt: skip
    rows = sweep(Study(axes=axes, rtol=None, targets=200))
    assert [row["particles"] for row in rows] == [recipes[0]] * 2 + [recipes[1]] * 2
    for text, row in zip(recipes, rows[::2], strict=True):
        scene = with_h(glass(recipe(text, 2)).particles, 1.5)
        operator = Operator("gradient", "difference", "csph")
        one = measure(scene, "wendland-c2", operator, sinusoid("0.05", dim=2), targets=200)
        assert row["rms"] == pytest.approx(one.error["rms"], rel=1e-12)
        assert row["rms"] == pytest.approx(row["predicted"], rel=0.1)
        assert row["lattice"] == ""
    assert all(row["predicted"] is None for row in rows[1::2])  # no S(k) predicts the nested form
    for more, says in (
        ({"jitter": ("0.1",)}, "jitter: belongs to a lattice"),
        ({"dim": ("3",)}, "N: got 225, which is no power 3"),
        ({"particles": ("relaxed:glass,N=225,dim=1",)}, "dim: got 2, and relaxed:glass"),
        ({"dx-over-h": ("1/8",)}, "more than twice the support"),
    ):
        with pytest.raises(ValueError, match=says):
            sweep(Study(axes=axes | more, rtol=None, targets=200))
