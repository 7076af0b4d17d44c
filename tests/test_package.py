"""The package as it is shipped and cited: what is in the wheel, and that all versions are one."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest

import sphtrunc
from sphtrunc.explorer.assembly import COMPUTING, DRAWING

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
BUILD = "import sys; from hatchling import build as b; print(getattr(b, sys.argv[1])(sys.argv[2]))"


def built(what: str, folder: Path) -> Path:
    """build_wheel or build_sdist, from the checkout."""
    run = subprocess.run(
        [sys.executable, "-c", BUILD, what, str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return folder / run.stdout.split()[-1]


def test_the_wheel_has_everything_that_is_read_when_it_runs(tmp_path):
    with ZipFile(built("build_wheel", tmp_path)) as wheel:
        names = set(wheel.namelist())
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        said = wheel.read(metadata).decode()
    page = ["explorer.html", "explorer.css", *(f"{name}.js" for name in (*COMPUTING, *DRAWING))]
    wanted = {"sphtrunc/py.typed", "sphtrunc/audit/published.toml"}
    wanted |= {f"sphtrunc/explorer/page/{name}" for name in page}
    wanted |= {path.relative_to(ROOT).as_posix() for path in ROOT.glob("sphtrunc/**/*.py")}
    assert wanted <= names
    assert not {name for name in names if not name.startswith("sphtrunc")}
    assert f"Version: {sphtrunc.__version__}\n" in said
    assert "Description-Content-Type: text/markdown" in said


def test_the_source_has_what_is_needed_to_test_and_to_cite_it(tmp_path):
    with tarfile.open(built("build_sdist", tmp_path)) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    assert {"pyproject.toml", "README.md", "CHANGELOG.md", "CITATION.cff", "LICENSE"} <= names
    assert {"tests/test_package.py", "notebooks/guide/explore.md"} <= names


def test_versions_are_one():
    assert PROJECT["version"] == sphtrunc.__version__
    assert f"\nversion: {sphtrunc.__version__}\n" in CITATION
    first = re.search(
        r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert first[1] == sphtrunc.__version__


def test_the_citation_says_what_the_format_asks_for():
    """Citation File Format 1.2.0 (Druskat et al. 2021, doi:10.5281/zenodo.5171937): these keys."""
    keys = dict(re.findall(r"^([\w-]+): ?(.*)$", CITATION, flags=re.MULTILINE))
    assert keys["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "version", "license"} <= set(keys)
    assert keys["license"] == PROJECT["license"]
    assert PROJECT["authors"][0]["name"] in CITATION


def test_the_extra_all_is_every_extra_for_users():
    extras = PROJECT["optional-dependencies"]
    (everything,) = extras["all"]
    named = re.fullmatch(r"sphtrunc\[(.*)\]", everything)[1].split(",")
    assert set(named) == set(extras) - {"all", "test", "lint", "mutation", "docs"}


@pytest.mark.parametrize("minor", [11, 12, 13, 14])
def test_pythons_are_named(minor):
    assert f"Programming Language :: Python :: 3.{minor}" in PROJECT["classifiers"]
    assert PROJECT["requires-python"] == ">=3.11"
