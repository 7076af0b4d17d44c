"""Glasses are made once: they come back to the last bit, and a damaged file is not believed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sphtrunc
from sphtrunc.cli import main
from sphtrunc.experiment import glasses
from sphtrunc.scenes.relaxed import Recipe

RECIPE = Recipe(count=64, steps=6)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: Any) -> Path:
    monkeypatch.setenv("SPHTRUNC_CACHE", str(tmp_path / "kept"))
    monkeypatch.setattr(glasses, "_made", {})
    return tmp_path / "kept"


def again(monkeypatch: Any, recipe: Recipe) -> Any:
    """From the disk, or made: what is in memory is forgotten."""
    monkeypatch.setattr(glasses, "_made", {})
    return glasses.glass(recipe)


def test_a_glass_is_made_once(place: Path, monkeypatch: Any) -> None:
    made = glasses.glass(RECIPE)
    assert glasses.glass(RECIPE) is made
    assert [path.name for path in place.iterdir()] == [glasses.name(RECIPE)]

    def refuse(*given: Any, **options: Any) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(glasses, "relax", refuse)
    found = again(monkeypatch, RECIPE)
    assert found is not made
    assert np.array_equal(found.particles.x, made.particles.x)
    assert np.array_equal(found.history, made.history)
    assert np.array_equal(found.particles.given, made.particles.given)
    assert glasses.name(RECIPE) != glasses.name(Recipe(count=64, steps=7))


def test_a_damaged_file_is_made_again(place: Path, monkeypatch: Any) -> None:
    made = glasses.glass(RECIPE)
    (file,) = place.iterdir()
    whole = file.read_bytes()
    wrong = made.particles.x.copy()
    wrong[0, 0] = np.nan
    bad = [whole[: len(whole) // 2], b"", b"PK\x03\x04", whole.replace(b"history", b"histori")]
    for data in bad:
        file.write_bytes(data)
        assert np.array_equal(again(monkeypatch, RECIPE).particles.x, made.particles.x)
        assert file.read_bytes() == whole
    for x in (wrong, made.particles.x[:, :60], made.particles.x.astype(np.float32)):
        with open(file, "wb") as stream:
            np.savez(stream, x=x, history=made.history)
        assert np.array_equal(again(monkeypatch, RECIPE).particles.x, made.particles.x)


def test_without_a_folder_nothing_is_kept(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(glasses, "_made", {})
    monkeypatch.setenv("SPHTRUNC_CACHE", "")
    assert glasses.folder() is None
    first = glasses.glass(RECIPE).particles.x
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv("SPHTRUNC_CACHE", str(tmp_path / "file" / "below"))
    assert np.array_equal(again(monkeypatch, RECIPE).particles.x, first)
    monkeypatch.delenv("SPHTRUNC_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert glasses.folder() == tmp_path / "sphtrunc"


@pytest.mark.parametrize("suffix", ["npz", "csv", "hdf5", "h5", "vtp"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_command_writes_what_is_read_back(
    suffix: str, dim: int, place: Path, tmp_path: Path, capsys: Any
) -> None:
    path = tmp_path / f"glass.{suffix}"
    with pytest.raises(SystemExit) as stop:
        main(["relax", "-n", "64", "--dim", str(dim), "--steps", "4", "--contrast", "0.2",
              "-o", str(path), "--format", "json"])  # fmt: skip
    assert stop.value.code == 0
    said = json.loads(capsys.readouterr().out)
    made = glasses.glass(Recipe(count=64, dim=dim, steps=4, contrast=0.2)).particles
    boxed = {} if suffix in ("hdf5", "h5") else {"period": said["period"]}
    found = sphtrunc.snapshot(path, **boxed)
    assert found.dim == dim
    np.testing.assert_array_equal(found.x, made.x)
    np.testing.assert_array_equal(found.h, made.h)
    np.testing.assert_array_equal(found.period, made.period)
    volume = found.given if found.given is not None else found.mass / found.fields["density"]
    np.testing.assert_allclose(volume, made.given, rtol=1e-15)
    assert 0 < said["disorder"] < 0.5
