"""A scene is any of the kinds of particles there are; which of its targets are looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sphtrunc.scenes import random_numbers as jitter
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.graded import Graded
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.neighbourhood import Indices as Indices

if TYPE_CHECKING:
    from sphtrunc.scenes.particles import Particles
    from sphtrunc.scenes.probes import Probes
    from sphtrunc.scenes.smoothing_lengths import Sloped

Scene: TypeAlias = "Lattice | Jittered | Graded | Particles | Sloped | Probes"


def paired(scene: Scene) -> bool:
    """The neighbours of every target lie at ±s."""
    return isinstance(scene, Arrangement) and scene.paired


def sample(scene: Scene, first: int, last: int, seed: int) -> Indices:
    """Targets `first` … `last` − 1 of a random order of all targets of the scene."""
    drawn = jitter.permuted(np.arange(first, last, dtype=np.int64), target_count(scene), seed)
    walls = _walls(scene)
    return drawn if walls is None else np.flatnonzero(~walls)[drawn]


def target_count(scene: Scene) -> int:
    """How many targets the scene has: all its particles, but for the walls of a file."""
    walls = _walls(scene)
    return scene.population if walls is None else int(np.count_nonzero(~walls))


def every_target(scene: Scene) -> Indices:
    """All targets of the scene."""
    walls = _walls(scene)
    if walls is None:
        return np.arange(scene.population, dtype=np.int64)
    return np.flatnonzero(~walls)


def _walls(scene: Scene) -> NDArray[np.bool_] | None:
    return getattr(scene, "walls", None)
