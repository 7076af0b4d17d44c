"""sphtrunc info: what is installed here, for a report of a bug."""

from __future__ import annotations

import json
import platform
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from re import fullmatch, search
from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit
from sphtrunc.version import __version__


@click.command(name="info")
@options.formats("text", "json")
@options.output
def command(format_: str, output: str | None) -> None:
    """Say which versions are installed, which extras are complete, on what machine.

    Paste it into a report of a bug. Nothing is sent anywhere, and no path but that of the cache of
    compiled loops is named.

    \b
    sphtrunc info
    sphtrunc info --format json -o info.json
    """
    found = information()
    if format_ == "json":
        emit(json.dumps(found, indent=1, ensure_ascii=False), output)
        return
    wide = max(map(len, found["packages"]))
    packages = [
        f"  {name:<{wide}}  {number or 'not installed'}"
        for name, number in found["packages"].items()
    ]
    extras = [
        f"  {name:<{wide}}  {'present' if not missing else 'without ' + ', '.join(missing)}"
        for name, missing in found["extras"].items()
    ]
    emit(
        "\n".join(
            [
                f"sphtrunc {found['version']}, Python {found['python']}, {found['platform']}",
                f"{found['cores']} cores, all of which the pair engine takes",
                f"compiled loops: {_loops(found['cache'])}",
                "packages",
                *packages,
                "extras",
                *extras,
            ]
        ),
        output,
    )


def information() -> dict[str, Any]:
    """Versions, extras and the machine, ready for JSON."""
    from sphtrunc.experiment.engine import threads

    wanted = _requirements()
    names = dict.fromkeys(name for packages in wanted.values() for name in packages)
    return {
        "schema": "sphtrunc.info/1",
        "version": __version__,
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "platform": platform.platform(),
        "cores": threads(None),
        "cache": _cache(),
        "packages": {name: _version(name) for name in names},
        "extras": {
            extra: [name for name in packages if _version(name) is None]
            for extra, packages in wanted.items()
            if extra
        },
    }


def _requirements() -> dict[str, list[str]]:
    """extra ("" for none) -> the packages that it needs, as the installed package says."""
    found: dict[str, list[str]] = {}
    for line in requires("sphtrunc") or ():
        package, _, condition = line.partition(";")
        name = fullmatch(r"([\w.-]+).*", package.strip())
        extra = search(r"extra == ['\"](.+?)['\"]", condition)
        if name and not name[1].startswith("sphtrunc"):
            found.setdefault(extra[1] if extra else "", []).append(name[1])
    return found


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _cache() -> dict[str, Any] | None:
    """Where compiled loops are kept between processes, and how many; None without Numba."""
    if _version("numba") is None:
        return None
    from sphtrunc.experiment.engine.cells import sum_pairs

    folder = Path(sum_pairs.stats.cache_path)
    return {"folder": str(folder), "loops": len(list(folder.glob("*.nbi")))}


def _loops(cache: dict[str, Any] | None) -> str:
    if cache is None:
        return "none, numba is not installed: sphtrunc[fast] has it"
    return f"{cache['loops']} in {cache['folder']}"
