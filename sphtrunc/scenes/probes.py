"""Probes: points between the particles of a periodic box, at which sums over these are taken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.plain import PLAIN
from sphtrunc.arithmetic.summation import Array
from sphtrunc.scenes import random_numbers
from sphtrunc.scenes.neighbourhood import Indices, Neighbourhood
from sphtrunc.scenes.particles import Particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

POINTS = 4096  # drawn where no number is given


@dataclass(frozen=True, eq=False)
class Probes:
    """Points, (d, T), in the box of `home`. Made by `probes`."""

    home: Particles
    points: Array

    @property
    def dim(self) -> int:
        """d."""
        return self.home.dim

    @property
    def population(self) -> int:
        """The number of targets: the points."""
        return int(self.points.shape[1])

    @property
    def particles(self) -> int:
        """The number of particles."""
        return self.home.particles

    @property
    def volume(self) -> str:
        """The rule for the volumes of the particles."""
        return self.home.volume

    @property
    def h(self) -> Array:
        """(T,), the smoothing length of all particles."""
        return np.full(self.population, self.home.h[0])

    def rows(self, kernel: Kernel) -> int:
        """The number of neighbours of a typical target, from a small sample."""
        return self.home.rows(kernel)

    @cached_property
    def _cache(self) -> dict[str, Any]:
        return {}

    def _joint(self, kernel: Kernel) -> Particles:
        """The particles, and after them the points as particles of no volume."""
        if self._cache.get("for") != kernel:
            home = self.home
            given = home.given
            if given is None:
                given = home._cells() if home.volume == "cell" else home._summed(kernel)[0]
            more = self.population
            joint = replace(
                home,
                x=np.concatenate([home.x, self.points], axis=1),
                h=np.concatenate([home.h, self.h]),
                given=np.concatenate([given, np.zeros(more)]),
                mass=np.concatenate([home.mass, np.ones(more)]),
                _trees={"tree": home._tree()},  # so that only particles are found
            )
            self._cache["joint"] = joint
            self._cache["for"] = kernel
        found: Particles = self._cache["joint"]
        return found

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        number: Any = PLAIN,
        *,
        reach: int = 1,
    ) -> Neighbourhood:
        """All particles around the points, as `Particles.neighbourhood`.

        Raises ValueError for a reach of more than one support.
        """
        if reach != 1:
            raise ValueError("at: the nested form has no random points; expected particles")
        joint = self._joint(kernel)
        return replace(
            joint.neighbourhood(target + self.home.population, kernel, number), target=target
        )

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Raises ValueError: points at random are not exact numbers of anybody."""
        raise ValueError("precision: exact is for targets that are particles; expected extended")


def probes(home: Particles, count: int = POINTS, seed: int = 0) -> Probes:
    """`count` points at random in the periodic box of `home`, a pure function of the seed.

    Raises ValueError for particles without a box, or with more than one h.
    """
    if home.period is None or not np.all(np.isfinite(home.period)):
        raise ValueError(
            "at: random points need a periodic box; expected a period, or targets at particles"
        )
    if not np.all(home.h == home.h[0]):
        raise ValueError("at: random points need one smoothing length for all particles")
    bits = np.arange(count, dtype=np.uint64)
    points = [
        side * random_numbers.uniform01(bits, seed, 400 + axis)
        for axis, side in enumerate(home.period)
    ]
    return Probes(home, np.stack(points))
