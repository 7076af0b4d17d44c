"""`sphtrunc measure` as a user calls it."""

import json
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sphtrunc.cli import main

BASE = ["measure", "--kernel", "cubic-spline"]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sphtrunc", *arguments], capture_output=True, text=True, timeout=120
    )


def out(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main([*BASE, *arguments])
    captured = capsys.readouterr()
    assert ended.value.code == 0, captured.err
    return captured.out


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main([*BASE, *arguments])
    captured = capsys.readouterr()
    assert ended.value.code == 2
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("Error: ")
    return captured.err


def test_json_has_its_schema(capsys: pytest.CaptureFixture[str]) -> None:
    text = out(
        capsys,
        *"--dim 3 --dx-over-h 0.6 --jitter 0.2 --form difference".split(),  # noqa: SIM905
        *"--correction csph --h-over-lambda 1/50 --moments 1".split(),  # noqa: SIM905
        *"--targets 300 --bound --format json".split(),  # noqa: SIM905
    )
    data = json.loads(text)
    assert data["schema"] == "sphtrunc.measure/1"
    expected = {
        "kernel", "dim", "operator", "form", "correction", "lattice", "dx_over_h", "offset",
        "jitter", "distribution", "volume", "field", "h_over_lambda", "seed", "precision", "bound",
        "targets", "pairs", "pairs_full", "flagged", "error", "moments", "rounding_bound",
        "seconds", "version", "corrections", "bounds", "interrupted", "rtol",
    }  # fmt: skip
    assert expected <= set(data)
    assert data["dx_over_h"] == "3/5"
    assert data["targets"] == data["corrections"] == 300
    assert set(data["error"]) >= {"rms", "rms_ci95", "max", "p50", "p99"}
    low, high = data["error"]["rms_ci95"]
    assert low < data["error"]["rms"] < high
    assert data["error"]["p50"] < data["error"]["p99"] <= data["error"]["max"]
    assert set(data["moments"]) == {"0,0,0", "1,0,0", "0,1,0", "0,0,1"}
    assert abs(data["moments"]["1,0,0"]["mean"] - 1) < 1e-12
    assert 0 < data["rounding_bound"] < 1e-12
    assert data["pairs_full"] == round(data["pairs"] / 300 * 10**9)


def test_csv_and_text(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--dx-over-h", "10/13", "--h-over-lambda", "0.01", "--moments", "2"]
    rows = dict(
        line.split(",", 1) for line in out(capsys, *options, "--format", "csv").splitlines()
    )
    assert float(rows["moment 1"].split(",")[0]) == pytest.approx(29200 / 28561, rel=1e-15)
    assert rows["targets"].startswith("1,")
    text = out(capsys, *options)
    assert "cubic-spline" in text
    assert "1.0223731662057" in text
    assert max(map(len, text.splitlines())) <= 100
    target = tmp_path / "result.json"
    assert out(capsys, *options, "--format", "json", "-o", str(target)) == ""
    assert json.loads(target.read_text())["moments"]["1"]["mean"] == pytest.approx(
        29200 / 28561, rel=1e-15
    )


OPERATORS = ["value", "gradient", "laplacian", "hessian", "divergence", "curl"]


@pytest.mark.parametrize("operator", OPERATORS)
def test_every_operator_in_every_precision(
    operator: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rms = []
    for precision in ("exact", "plain", "compensated", "extended"):
        text = out(
            capsys,
            *f"--dim 2 --operator {operator} --precision {precision} --dx-over-h 4/5".split(),
            *"--jitter 0.1 --h-over-lambda 0.05 --targets 2 --format json".split(),  # noqa: SIM905
        )
        data = json.loads(text)
        assert (data["operator"], data["precision"]) == (operator, precision)
        rms.append(data["error"]["rms"])
    assert rms[1:] == pytest.approx([rms[0]] * 3, rel=1e-10)


@pytest.mark.parametrize("suffix", ["npy", "npz", "csv"])
def test_particles_from_a_file(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grid = (np.arange(20) + 0.5) / 20
    x = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    path = tmp_path / f"particles.{suffix}"
    if suffix == "npy":
        np.save(path, x)
    elif suffix == "npz":
        np.savez(path, x=x, h=0.08, volume=1 / 400, values=np.sin(2 * np.pi * x[:, 0]))
    else:
        rows = "\n".join(f"{a!r},{b!r},{0.08},{1 / 400}" for a, b in x.tolist())
        path.write_text(f"x,y,h,volume\n{rows}\n")
    extra = {"npy": ["--h", "0.08"], "npz": ["--field", "values"], "csv": []}[suffix]
    text = out(
        capsys,
        "--particles",
        str(path),
        "--period",
        "1",
        *extra,
        "--format",
        "json",
        "--moments",
        "1",
    )
    data = json.loads(text)
    assert data["targets"] == 400
    assert data["moments"]["1,0"]["mean"] == pytest.approx(1, abs=0.05)
    assert data["moments"]["1,0"]["std"] < 1e-12


WRONG = {
    "nothing": [],
    "ratio": ["--dx-over-h", "x"],
    "zero": ["--dx-over-h", "0"],
    "no float": ["--dx-over-h", "1e400"],
    "no float either": ["--dx-over-h", "1/2", "--h-over-lambda", "1e400"],
    "Gaussian and bound": ["--kernel", "gaussian", "--dx-over-h", "1/2", "--bound"],
    "Gaussian in 60 digits": ["--kernel", "gaussian", "--dx-over-h=1/2", "--precision=exact"],
    "paired": ["--dx-over-h", "1/2", "--form", "paired", "--offset", "1/3"],
    "file and offset": ["--particles", "x.npz", "--offset", "1/2"],
    "file and extent": ["--particles", "x.npz", "--extent", "5"],
    "no file name": ["--dx-over-h", "1/2", "-o", ""],
    "coarse": ["--dx-over-h", "3"],
    "lattice": ["--dx-over-h", "1/2", "--lattice", "bcc"],
    "offset": ["--dx-over-h", "1/2", "--offset", "1,2"],
    "jitter": ["--dx-over-h", "1/2", "--jitter", "-1"],
    "blue": ["--dim=3", "--dx-over-h=1", "--lattice=hcp", "--jitter=0.1", "--distribution=blue"],
    "form": ["--dx-over-h", "1/2", "--form", "odd"],
    "form of value": ["--dx-over-h", "1/2", "--operator", "value", "--form", "brookshaw"],
    "curl in 1D": ["--dx-over-h", "1/2", "--operator", "curl", "--h-over-lambda", "0.1"],
    "targets": ["--dx-over-h", "1/2", "--targets", "many"],
    "rtol": ["--dx-over-h", "1/2", "--jitter", "0.1", "--rtol", "7"],
    "bound": ["--dx-over-h", "1/2", "--bound", "--precision", "extended"],
    "field": ["--dx-over-h", "1/2", "--field", "__import__('os').system('true')"],
    "two fields": ["--dx-over-h", "1/2", "--field", "bump:1", "--h-over-lambda", "0.1"],
    "no values": ["--dx-over-h", "1/2", "--field", "values"],
    "direction": ["--dx-over-h", "1/2", "--direction", "1"],
    "cells": ["--dx-over-h", "1/2", "--volume", "cell"],
    "h": ["--dx-over-h", "1/2", "--h", "1"],
    "missing file": ["--particles", "no-such-file.npz"],
    "file and ratio": ["--particles", "x.npz", "--dx-over-h", "1/2"],
    "suffix": ["--particles", "x.pickle"],
    "moments": ["--dx-over-h", "1/2", "--moments", "99"],
    "unwritable": ["--dx-over-h", "1/2", "-o", "/no/such/folder/file"],
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_options_end_in_one_line(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(fails(capsys, *WRONG[case])) > 30


BAD_FILES = {
    "empty.npz": b"",
    "text.npz": b"hello",
    "text.npy": b"hello",
    "empty.csv": b"",
    "header.csv": b"x,h\n",
    "unknown.csv": b"x,colour\n1,2\n",
    "ragged.csv": b"x,h\n1,2\n1\n",
    "words.csv": b"x,h\n1,two\n",
    "nan.csv": b"x,h,volume\n1,1,1\nnan,1,1\n",
    "no x.csv": b"y,h\n1,2\n",
    "binary.csv": b"\xff\xfe\x00",
    "zero h.csv": b"x,h,volume\n1,0,1\n",
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_end_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(BAD_FILES[name])
    assert len(fails(capsys, "--particles", str(path))) > 20


def test_a_byte_order_mark_is_no_part_of_a_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "exported.csv"
    path.write_text("x,h,volume\n0,1,1\n0.5,1,1\n", encoding="utf-8-sig")
    assert "2 targets" in out(capsys, "--particles", str(path))


def test_values_without_derivatives_have_no_error_and_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "values.npz"
    np.savez(path, x=np.arange(9.0), h=2.0, volume=1.0, values=np.ones(9))
    text = out(capsys, "--particles", str(path), "--field", "values")
    assert "No error: no exact derivatives" in text
    assert "no theory for explicit particles" in text


def test_a_pickle_is_not_opened(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "objects.npz"
    np.savez(path, x=np.array([{"a": 1}], dtype=object))
    fails(capsys, "--particles", str(path))


def test_no_progress_bar_in_a_pipe() -> None:
    found = run(*BASE, "--dim", "3", "--dx-over-h", "1/2", "--jitter", "0.2", "--targets", "9000",
                "--moments", "1")  # fmt: skip
    assert found.returncode == 0
    assert found.stderr == ""


BILLION = [*BASE, "--dim", "3", "--dx-over-h", "0.6", "--jitter", "0.2", "--h-over-lambda", "0.05",
           "--rtol", "0.01", "--workers", "2", "--format", "csv"]  # fmt: skip


def test_a_billion_particles_fit_into_200_megabytes() -> None:
    """1000 × 1000 × 1000 indices, the rms error to 1 %: only what the sample needs is made."""
    text = (  # ru_maxrss would hold what the parent had when it was forked
        "import sys\nfrom sphtrunc.cli import main\n"
        "try:\n    main(sys.argv[1:])\nfinally:\n"
        "    lines = open('/proc/self/status').readlines()\n"
        "    print(*[l.split()[1] for l in lines if l.startswith('VmHWM')], file=sys.stderr)\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", text, *BILLION], capture_output=True, text=True, timeout=120
    )
    assert found.returncode == 0
    rows = dict(line.split(",", 1) for line in found.stdout.splitlines())
    rms, _, low, high = (float(x or 0) for x in rows["error_rms"].split(","))
    assert (high - low) / 2 <= 0.0101 * rms
    assert float(rows["pairs_full"].split(",")[0]) > 1.4e11
    assert float(rows["pairs"].split(",")[0]) < 1e7
    assert int(found.stderr.splitlines()[-1]) * 1024 <= 200e6


LONG = [*BASE, "--dim", "3", "--dx-over-h", "0.3", "--jitter", "0.2", "--targets", "9000000",
        "--h-over-lambda", "0.1", "--format", "json"]  # fmt: skip


def test_progress_on_a_terminal_and_interruption(tmp_path: Path) -> None:
    """Standard error is a terminal: a bar appears; Ctrl-C ends with what was measured so far."""
    leader, follower = pty.openpty()
    target = tmp_path / "out.json"
    process = subprocess.Popen(
        [sys.executable, "-m", "sphtrunc", *LONG, "-o", str(target)],
        stderr=follower,
        stdout=subprocess.DEVNULL,
    )
    os.close(follower)
    seen = b""
    deadline = time.monotonic() + 90
    while b"targets" not in seen and time.monotonic() < deadline:
        seen += os.read(leader, 4096)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 130
    os.close(leader)
    assert b"targets" in seen
    data = json.loads(target.read_text())
    assert data["interrupted"] is True
    assert 0 < data["targets"] < 9_000_000
    assert data["error"]["rms"] > 0
