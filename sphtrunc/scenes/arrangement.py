"""Arrangements: how the particles of a lattice lie about a target, as one value without arrays.

Theory is asked about an arrangement; a scene is one of which a neighbourhood can be made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, floor
from typing import TYPE_CHECKING, Any, TypeVar

from sphtrunc.scenes.sites import KINDS, in_pairs, sites, units
from sphtrunc.scenes.walls import Wall

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.scenes.sites import Indices

A = TypeVar("A", bound="Arrangement")


@dataclass(frozen=True)
class Arrangement:
    """Particles at (m·unit + offset + u_m) Δx from the target, for the points m of a lattice.

    kind: the lattice, a key of `sites.KINDS`; dx_over_h: Δx/h, Δx^d the volume per particle
    offset: in Δx, one number per axis; none: the target is a particle
    volume: "constant" Δx^d, "cell" (1D) or "summation" 1/Σ W
    sigma, distribution: of the displacements u along each axis, σ/Δx; "gaussian", "uniform", "blue"
    wall: the plane that ends it, if one does; see `beside`
    extent: particles along each axis that a full scene has, of which targets are taken
    """

    kind: str
    dx_over_h: Fraction
    offset: tuple[Fraction, ...] = ()
    volume: str = "constant"
    sigma: float = 0.0
    distribution: str = "gaussian"
    wall: Wall | None = None
    extent: int = 1

    def __post_init__(self) -> None:
        if not self.offset:
            object.__setattr__(self, "offset", (Fraction(0),) * self.dim)

    @property
    def dim(self) -> int:
        """d."""
        return KINDS[self.kind].dim

    @property
    def particles(self) -> int:
        """The number of particles of a scene of this extent."""
        return int(self.extent**self.dim)

    @property
    def at_particle(self) -> bool:
        """The target is a particle, and moves with it."""
        return not any(self.offset)

    @property
    def paired(self) -> bool:
        """The neighbours of the target lie at ±s."""
        return not self.sigma and self.wall is None and in_pairs(self.kind, self.offset)

    @property
    def wall_phase(self) -> Fraction:
        """φ of the wall: the planes m with m + φ > 0 are fluid, that with m + φ = 0 is on it."""
        if self.wall is None:
            raise ValueError("wall: this lattice has none")
        return (self.wall.eta / self.dx_over_h + self.offset[0]) / units(self.kind)[0]

    def seen_from(self: A, offset: Sequence[Fraction] = ()) -> A:
        """The same particles without wall and displacements, from another place."""
        return replace(self, offset=tuple(offset), wall=None, sigma=0.0)

    def bare(self: A) -> A:
        """The particles beside the wall without their ghosts."""
        assert self.wall is not None
        return replace(self, wall=replace(self.wall, ghosts="none", weight=self.wall.share))

    def beside(self: A, wall: Wall) -> A:
        """The particles on one side of a wall; where `wall.at` says how it lies among them, the
        offset along the first axis follows from that.

        Raises ValueError where both say where the lattice is, and differ.
        """
        step, shift = units(self.kind)[0], self.offset[0]
        if wall.at is not None:
            there = wall.at * step - wall.eta / self.dx_over_h
            there -= step * ceil(there / step - Fraction(1, 2))
            if shift and (shift - there) % step:
                raise ValueError(
                    f"offset: got {shift}, and with wall-at {wall.at} the lattice is at {there};"
                    " expected one of the two options"
                )
            shift = there
        offset = (shift, *self.offset[1:])
        return replace(self, offset=offset, wall=replace(wall, at=None))

    def require_seen(self, support: Fraction) -> None:
        """Raises ValueError where a dummy within the support of the target sees no fluid."""
        if self.wall is None or self.wall.ghosts != "dummy":
            return
        step, phase = units(self.kind)[0], self.wall_phase
        far = floor((-support / self.dx_over_h - self.offset[0]) / step) + 1
        gap = (ceil(-phase) - far) * step * self.dx_over_h
        if far < -phase and gap >= support:
            raise ValueError(
                "ghosts: the farthest dummies see no fluid, as the target is nearer to the wall"
                f" than the first particles, at {phase % 1} of a step; expected a larger distance"
            )

    def require_unmoved_wall(self) -> None:
        """Raises ValueError for displaced particles on the wall."""
        wall = self.wall
        if wall is not None and wall.share != 1 and self.wall_phase.denominator == 1:
            raise ValueError(
                "jitter: a displaced particle is not on the wall; expected wall-weight 1, or"
                " wall-at half-way"
            )

    def sites(self, reach: float) -> Indices:
        """Integer points m, (d, N), of the particles within `reach` of the target, in Δx, on the
        fluid's side of a wall."""
        found = sites(self.kind, reach, self.offset)
        return found if self.wall is None else found[:, found[0] >= ceil(-self.wall_phase)]

    def shares(self, m: Indices) -> NDArray[Any]:
        """What counts of the particles at integer points m, (N,): less of those on a wall."""
        import numpy as np

        on = None if self.wall is None else -self.wall_phase
        if self.wall is None or on is None or on.denominator > 1:
            return np.ones(m.shape[1])
        return np.where(m[0] == int(on), float(self.wall.share), 1.0)

    def positions(self, m: Indices) -> NDArray[Any]:
        """s, (N, d) in h, of the particles at integer points m without their displacements."""
        import numpy as np

        unit = np.array([float(u) for u in units(self.kind)])
        shift = np.array([float(o) for o in self.offset])
        return np.asarray(float(self.dx_over_h) * (m.T * unit + shift))

    def exact_positions(self, m: Indices) -> list[list[Fraction]]:
        """The same as fractions, those of irrational units to 256 bits."""
        axes = list(zip(units(self.kind), self.offset, strict=True))
        return [
            [(n * u + o) * self.dx_over_h for n, (u, o) in zip(point, axes, strict=True)]
            for point in m.T.tolist()
        ]
