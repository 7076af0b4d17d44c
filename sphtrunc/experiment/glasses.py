"""Glasses: relaxed particles that are made once and kept, in memory and on the disk.

The folder is that of the environment variable SPHTRUNC_CACHE, of which nothing keeps none, or else
`sphtrunc` among the user's caches. A file is named by the digest of everything that its particles
depend on; one that is not what it should be is made again.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.relaxation import WAY, Relaxation, relax, relaxed
from sphtrunc.output import digest, write_atomically
from sphtrunc.scenes.relaxed import Recipe
from sphtrunc.version import __version__


def glass(
    recipe: Recipe,
    *,
    workers: int | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Relaxation:
    """`relax`, remembered: made once in a lifetime, the same to the last bit."""
    found = _made.get(recipe) or _read(recipe)
    if found is None:
        found = relax(recipe, workers=workers, progress=progress)
        _write(found)
    _made[recipe] = found
    while len(_made) > _MOST:
        del _made[next(iter(_made))]
    return found


_MOST = 8
_made: dict[Recipe, Relaxation] = {}


def folder() -> Path | None:
    """Where glasses are kept; None where they are not."""
    said = os.environ.get("SPHTRUNC_CACHE")
    if said is not None:
        return Path(said) if said else None
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join("~", ".cache")
    path = Path(os.path.expanduser(home)) / "sphtrunc"
    return path if path.is_absolute() else None


def name(recipe: Recipe) -> str:
    """Of the file of a recipe: the digest of the recipe, its kernel, the way of relaxing and the
    version."""
    from sphtrunc.kernels.parse import definition

    settings = {
        "recipe": asdict(recipe),
        "kernel": definition(recipe.shape),
        "way": WAY,
        "version": __version__,
    }
    return f"glass-{digest(settings)[:32]}.npz"


def _read(recipe: Recipe) -> Relaxation | None:
    """The glass as it was kept; None where it was not, or not whole."""
    place = folder()
    if place is None:
        return None
    try:
        data = io.BytesIO((place / name(recipe)).read_bytes())
        with np.load(data, allow_pickle=False) as file:
            x, history = file["x"], file["history"]
    except (OSError, ValueError, KeyError, BadZipFile, EOFError):
        return None
    return relaxed(recipe, x, history) if _whole(recipe, x, history) else None


def _whole(recipe: Recipe, x: Array, history: Array) -> bool:
    return bool(
        x.shape == (recipe.dim, recipe.count)
        and history.ndim == 1
        and 1 <= history.size <= recipe.steps + 1
        and x.dtype == history.dtype == np.float64
        and np.all((x >= 0) & (x <= recipe.side))
        and np.all(history >= 0)
    )


def _write(made: Relaxation) -> None:
    """Keep it where that is possible; what is not kept is made again."""
    place = folder()
    if place is None:
        return
    buffer = io.BytesIO()
    np.savez(buffer, x=made.particles.x, history=made.history)
    try:
        place.mkdir(parents=True, exist_ok=True)
        write_atomically(place / name(made.recipe), buffer.getvalue())
    except (OSError, ValueError):
        return
