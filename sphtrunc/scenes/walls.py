"""Walls: where a plane wall lies in a lattice, and what is beyond it."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

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

    @property
    def share(self) -> Fraction:
        """What counts of a fluid particle on the wall."""
        return {"none": self.weight, "dummy": Fraction(1)}.get(self.ghosts, Fraction(1, 2))
