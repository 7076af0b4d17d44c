"""Walls: where a plane wall lies in a lattice, and what is beyond it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor

from sphtrunc.scenes.sites import units

#: names for where a lattice may have a wall, in steps of its planes before the first one
PLACES = {"particle": Fraction(0), "half-way": Fraction(1, 2)}
#: what may be beyond a wall: nothing; images with the value A(s*) or 2 A_wall − A(s*) of their
#: original; dummy particles with the Shepard mean of the fluid around them
GHOSTS = ("none", "mirror", "odd", "dummy")


@dataclass(frozen=True)
class Wall:
    """A plane wall, normal to the first axis, on the side of negative s₁.

    eta: η, its distance from the target in h
    at: where it lies in the lattice, in steps of its planes before the first one: 0 at a particle,
        1/2 half-way; None where the offset of the lattice decides
    ghosts: what is beyond: "none", "mirror", "odd" or "dummy"
    weight: what part of a particle on the wall counts; images complete it, so that it is 1/2 with
        them, and 1 before dummies
    """

    eta: Fraction
    at: Fraction | None = None
    ghosts: str = "none"
    weight: Fraction = Fraction(1, 2)

    def __post_init__(self) -> None:
        if self.ghosts not in GHOSTS:
            raise ValueError(f"ghosts: got {self.ghosts!r}, expected one of {', '.join(GHOSTS)}")
        if not self.eta >= 0:
            raise ValueError(f"wall: got η = {self.eta}, expected a distance >= 0")
        if self.at is not None and not 0 <= self.at < 1:
            raise ValueError(
                f"wall-at: got {self.at}, expected particle, half-way or a fraction from 0 to 1,"
                " the steps from the wall to the first particles"
            )
        if not 0 <= self.weight <= 1:
            raise ValueError(f"wall-weight: got {self.weight}, expected a number from 0 to 1")

    def phase(self, kind: str, dx_over_h: Fraction, offset: Sequence[Fraction]) -> Fraction:
        """φ: the planes m of the lattice with m + φ > 0 are fluid, that with m + φ = 0 is on the
        wall."""
        return (self.eta / dx_over_h + offset[0]) / units(kind)[0]

    @property
    def share(self) -> Fraction:
        """What counts of a fluid particle on the wall."""
        return {"none": self.weight, "dummy": Fraction(1)}.get(self.ghosts, Fraction(1, 2))

    def placed(
        self, kind: str, dx_over_h: Fraction, offset: Sequence[Fraction]
    ) -> tuple[tuple[Fraction, ...], Fraction]:
        """The offset of the lattice from the target, in Δx, and `phase`.

        Raises ValueError where both `at` and the offset say where the lattice is, and differ.
        """
        step = units(kind)[0]
        distance = self.eta / dx_over_h
        shift = offset[0]
        if self.at is not None:
            there = self.at * step - distance
            there -= step * ceil(there / step - Fraction(1, 2))
            if shift and (shift - there) % step:
                raise ValueError(
                    f"offset: got {shift}, and with wall-at {self.at} the lattice is at {there};"
                    " expected one of the two options"
                )
            shift = there
        placed = (shift, *offset[1:])
        return placed, self.phase(kind, dx_over_h, placed)

    def require_seen(
        self, kind: str, dx_over_h: Fraction, offset: Sequence[Fraction], support: Fraction
    ) -> None:
        """Raises ValueError where a dummy within the support of the target sees no fluid."""
        if self.ghosts != "dummy":
            return
        step, phase = units(kind)[0], self.phase(kind, dx_over_h, offset)
        far = floor((-support / dx_over_h - offset[0]) / step) + 1
        gap = (ceil(-phase) - far) * step * dx_over_h
        if far < -phase and gap >= support:
            raise ValueError(
                "ghosts: the farthest dummies see no fluid, as the target is nearer to the wall"
                f" than the first particles, at {phase % 1} of a step; expected a larger distance"
            )
