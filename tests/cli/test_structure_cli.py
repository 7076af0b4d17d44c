"""structure and relax on the command line, and relaxed scenes, random points and constant volumes
in measure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphtrunc.cli import main


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    assert end.value.code == 0
    return capsys.readouterr().out


def error(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    assert end.value.code == 2
    text = capsys.readouterr().err
    assert text.count("Error:") == 1
    return text


@pytest.fixture(scope="module")
def squares(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Displaced squares in a box of side 2."""
    path = tmp_path_factory.mktemp("structure") / "squares.npz"
    x = np.stack([a.ravel() for a in np.meshgrid(*[np.arange(16.0)] * 2)], 1) / 8
    np.savez(path, x=x + 0.01 * np.random.default_rng(1).normal(size=x.shape))
    return str(path)


def test_the_structure_of_a_file_as_json(squares: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(run(capsys, "structure", squares, "--period", "2", "--format", "json"))
    assert found["schema"] == "sphtrunc.structure/1"
    assert len(found["k_dx"]) == len(found["S"]) == len(found["error"]) > 10
    assert found["k_dx"] == sorted(found["k_dx"])
    assert abs(found["exponent"] - 2) < 4 * found["exponent_error"]
    assert found["plateau"] < 0.01
    assert (found["particles"], found["dim"], found["blur"]) == (256, 2, None)


def test_the_structure_as_text_and_csv(squares: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = run(capsys, "structure", squares, "--period", "2")
    assert "all modes of the box" in text
    assert "S ∝ k^" in text
    assert max(map(len, text.splitlines())) <= 100
    rows = run(capsys, "structure", squares, "--period", "2,2", "--format", "csv").splitlines()
    assert rows[0] == "k_dx,S,error"
    assert all(float(value) >= 0 for row in rows[1:] for value in row.split(","))
    assert "a free set: smeared over" in run(capsys, "structure", squares)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--period", "1,2,3"), "expected one length or 2"),
        (("--period", "x"), "period: got 'x'"),
        (("--period", "2", "--reach", "1e4"), "reach:"),
    ],
)
def test_bad_boxes(
    squares: str, arguments: Any, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert says in error(capsys, "structure", squares, *arguments)


def test_bad_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no such file" in error(capsys, "structure", str(tmp_path / "none.npz"))
    for name, x, says in (
        ("three", np.random.default_rng(0).random((3, 2)), "got 3, expected at least 8"),
        ("point", np.ones((30, 2)), "at one place"),
    ):
        np.savez(tmp_path / f"{name}.npz", x=x)
        assert says in error(capsys, "structure", str(tmp_path / f"{name}.npz"), "--period", "2")


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_a_glass_is_written_and_read(
    tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """relax -o, then structure and measure of the file: the same particles as by the recipe."""
    path = str(tmp_path / f"glass.{suffix}")
    options = ("-n", "144", "-k", "wendland-c2", "--h-over-dx", "1.2", "--seed", "2")
    made = json.loads(run(capsys, "relax", *options, "-o", path, "--format", "json"))
    assert made["schema"] == "sphtrunc.relax/1"
    assert made["converged"]
    assert made["residual"] <= 1e-3
    one = run(capsys, "structure", path, "--period", "12", "--format", "csv")
    two = run(capsys, "structure", made["recipe"], "--format", "csv")
    for a, b in zip(one.splitlines()[1:], two.splitlines()[1:], strict=True):
        numbers = [[float(v) for v in row.split(",")] for row in (a, b)]
        np.testing.assert_allclose(*numbers, rtol=1e-9, atol=1e-15)
    common = (
        "measure",
        "-k",
        "wendland-c2",
        "--moments",
        "1",
        "--at",
        "random",
        "--format",
        "json",
    )
    found = json.loads(run(capsys, *common, "--particles", path, "--period", "12"))
    assert found["schema"] == "sphtrunc.measure/1"
    assert found["predicted"]["by"] == "structure factor"
    assert found["targets"] == 4096
    for row in found["predicted"]["moments"].values():
        assert row["std_ratio"] == pytest.approx(1, abs=0.06)
    other = json.loads(run(capsys, *common, "--particles", made["recipe"]))
    assert other["predicted"]["moments"]["1,0"]["std"] == pytest.approx(
        found["predicted"]["moments"]["1,0"]["std"], rel=1e-6
    )


def test_constant_volumes_of_a_file(squares: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("measure", "-k", "cubic-spline", "--particles", squares, "--h", "0.2")
    arguments = (*arguments, "--moments", "1", "--volume", "constant", "--format", "json")
    found = json.loads(run(capsys, *arguments, "--period", "2"))
    assert found["predicted"]["by"] == "structure factor"
    assert found["moments"]["1,0"]["mean"] == pytest.approx(
        found["predicted"]["moments"]["1,0"]["mean"], abs=2e-4
    )
    assert "expected a period" in error(capsys, *arguments)


def test_random_points_of_a_rule(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("measure", "-k", "cubic-spline", "--dx-over-h", "3/5", "--moments", "1")
    arguments = (*arguments, "--at", "random", "--format", "json")
    found = json.loads(run(capsys, *arguments, "--jitter", "0.1"))
    assert found["predicted"]["by"] == "structure factor"
    for row in found["predicted"]["moments"].values():
        assert row["std_ratio"] == pytest.approx(1, abs=0.06)
    assert "every offset" in error(capsys, *arguments, "--offset", "1/2")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("-n", "10"), "expected 9 or 16, or start=random"),
        (("-n", "100", "-k", "lucy"), "expected both, or neither"),
        (("-n", "100", "-o", "glass.txt"), "expected a name ending in .npz, .csv, .h5"),
        (("-n", "100", "-k", "lucy", "--h-over-dx", "4"), "more than twice the support"),
    ],
)
def test_bad_glasses(arguments: Any, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert says in error(capsys, "relax", *arguments)
