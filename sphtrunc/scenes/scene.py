"""A scene is any of the kinds of particles there are; which of its targets are looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sphtrunc.scenes import random_numbers as jitter
from sphtrunc.scenes.graded import Graded
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.neighbourhood import Indices as Indices
from sphtrunc.scenes.sites import in_pairs

if TYPE_CHECKING:
    from sphtrunc.scenes.particles import Particles
    from sphtrunc.scenes.smoothing_lengths import Sloped

Scene: TypeAlias = "Lattice | Jittered | Graded | Particles | Sloped"


def paired(scene: Scene) -> bool:
    """The neighbours of every target lie at ±s."""
    home = getattr(scene, "lattice", scene)
    still = not getattr(scene, "sigma", 0.0)
    whole = isinstance(home, Lattice) and home.wall is None
    return whole and still and in_pairs(home.kind, home.offset)


def sample(scene: Scene, first: int, last: int, seed: int) -> Indices:
    """Targets `first` … `last` − 1 of a random order of all targets of the scene."""
    return jitter.permuted(np.arange(first, last, dtype=np.int64), scene.population, seed)
