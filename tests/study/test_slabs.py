"""Maps in slabs: the same bytes as in one piece, whatever is held at once and wherever it is made,
and nothing lost where one is stopped."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sphtrunc
from sphtrunc import Operator
from sphtrunc.cli import main
from sphtrunc.study.snapshots.error_map import error_map
from sphtrunc.study.snapshots.map_files import write
from sphtrunc.study.snapshots.slabs import map_in_slabs

KERNEL = "wendland-c2"
ESTIMATES = (
    Operator("gradient", "standard"),
    Operator("gradient", "symmetric"),
    Operator("gradient", "difference", "csph"),
)
SMALL = 3e5  # bytes: slabs of some hundreds of particles


def scene() -> Any:
    rng = np.random.default_rng(3)
    x = rng.random((3000, 2)) * [1.0, 0.7]
    h = 0.04 * (1 + 0.2 * rng.random(3000))
    box = [1.0, 0.7]
    return sphtrunc.particles(x, h=h, mass=np.ones(3000), density=3000 / 0.7 + x[:, 0], period=box)


def whole(particles: Any, path: Path, **options: Any) -> bytes:
    write(error_map(particles, KERNEL, ESTIMATES, engine="numba", workers=1, **options), path)
    return path.read_bytes()


def piecewise(particles: Any, path: Path, **options: Any) -> int:
    """Writes the map; how many slabs were made."""
    made: list[int] = []
    options = {"memory": SMALL, "workers": 1, **options}
    with map_in_slabs(
        particles, KERNEL, ESTIMATES, output=path,
        progress=lambda done, of: made.append(of), **options,
    ):  # fmt: skip
        assert path.exists()
    return len(made)


@pytest.mark.parametrize("suffix", ["npz", "hdf5", "csv", "vtp"])
def test_slabs_and_one_piece_are_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    particles = scene()
    expected = whole(particles, tmp_path / f"whole.{suffix}")
    assert piecewise(particles, tmp_path / f"slabs.{suffix}") >= 4
    assert (tmp_path / f"slabs.{suffix}").read_bytes() == expected
    names = {f"whole.{suffix}", f"slabs.{suffix}"}
    assert {path.name for path in tmp_path.iterdir()} == names


@pytest.mark.parametrize("options", [{"memory": 1e5}, {"processes": 2}, {"executor": 2}])
def test_wherever_it_is_made(options: dict[str, Any], tmp_path: Path) -> None:
    """Smaller slabs, processes, another executor; of a part of the particles."""
    particles = scene()
    more = {"targets": 2500}
    expected = whole(particles, tmp_path / "whole.npz", **more)
    with ThreadPoolExecutor(2) as pool:
        if "executor" in options:
            options = {"executor": pool}
        assert piecewise(particles, tmp_path / "slabs.npz", **options, **more) >= 3
    assert (tmp_path / "slabs.npz").read_bytes() == expected


def test_what_is_done_is_kept(tmp_path: Path) -> None:
    """Stopped after two slabs: the others are made, and of the two the one that was damaged."""
    particles, path = scene(), tmp_path / "map.npz"
    expected = whole(particles, tmp_path / "whole.npz")

    def stop(done: int, of: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    options: Any = {"output": path, "memory": SMALL, "workers": 1}
    with (
        pytest.raises(KeyboardInterrupt),
        map_in_slabs(particles, KERNEL, ESTIMATES, progress=stop, **options),
    ):
        pass
    assert not path.exists()
    files = sorted((tmp_path / "map.npz.slabs").iterdir())
    assert [file.name for file in files] == ["slab-00000.npz", "slab-00001.npz"]
    with (
        pytest.raises(ValueError, match=r"it belongs to other settings \(estimates\)"),
        map_in_slabs(particles, KERNEL, ESTIMATES[::-1], **options),
    ):
        pass
    files[0].write_bytes(files[0].read_bytes()[:-1] + b"?")
    count = len((tmp_path / "map.npz.journal").read_text().splitlines()) - 1
    assert count == 2
    made = piecewise(particles, path)
    with open(tmp_path / "again.npz", "wb"):
        pass
    assert made == piecewise(particles, tmp_path / "again.npz") - 1
    assert path.read_bytes() == expected


def run(capsys: Any, *options: str) -> tuple[str, str, Any]:
    with pytest.raises(SystemExit) as stop:
        main(["map", *options])
    streams = capsys.readouterr()
    return streams.out, streams.err, stop.value.code


def test_the_command(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    x = np.random.default_rng(5).random((2000, 2))
    np.savez("a.npz", x=x, h=0.06)
    options = ["a.npz", "--period", "1", "-k", KERNEL]
    for one in ESTIMATES:
        options += ["--estimate", f"{one.name}/{one.form}/{one.correction}"]
    out, _, status = run(
        capsys, *options, "--memory", "300kB", "-o", "map.npz", "--format", "json",
        "--picture", "map.png",
    )  # fmt: skip
    assert status == 0
    assert json.loads(out)["targets"] == 2000
    assert np.load("map.npz")["gamma"].shape == (2000,)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "map.npz", "map.png"]
    for wrong, says in (
        (["--memory", "1GB"], "slabs go into a file; expected -o FILE"),
        (["--memory", "much", "-o", "m.npz"], "memory: got 'much', expected a size such as 512MB"),
        (["--memory", "-1GB", "-o", "m.npz"], "memory: got '-1GB'"),
        (["--processes", "2", "-o", "m.xlsx"], "expected a name ending in .npz"),
    ):
        out, err, status = run(capsys, *options, *wrong)
        assert (out, status) == ("", 2)
        assert says in err
    assert not list(tmp_path.glob("m.*"))
