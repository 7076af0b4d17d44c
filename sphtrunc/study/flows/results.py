"""Results of flows: what was asked, what was solved, and what theory says of its error."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.study.flows.annulus import INNER
from sphtrunc.study.flows.cases import CASES
from sphtrunc.study.flows.cavity import published

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.operators.operator import Operator
    from sphtrunc.study.flows.cavity import Cavity
    from sphtrunc.study.flows.predicted import Predicted
    from sphtrunc.study.flows.vortex import Decay

#: name -> what flows, and in which dimensions
FLOWS: dict[str, tuple[str, tuple[int, ...]]] = {
    "poiseuille": (CASES["poiseuille"].says, (1, 2, 3)),
    "couette": (CASES["couette"].says, (1, 2, 3)),
    "duct": (CASES["duct"].says, (2, 3)),
    "rotating-couette": ("between two circles, of which the inner one turns", (2,)),
    "taylor-green": ("a vortex in a periodic box, and the rate at which it decays", (2,)),
    "cavity": ("in a square box under a lid that moves", (2,)),
}


@dataclass(frozen=True, eq=False)
class Asked:
    """What a flow was asked for: names and numbers, as they are written."""

    flow: str
    kernel: str
    dim: int
    lattice: str
    across: int
    particles: int
    dx_over_h: float
    jitter: float
    distribution: str
    seed: int
    form: str
    correction: str
    wall: str | None


@dataclass(frozen=True, eq=False)
class Steady:
    """A steady flow with a known solution, in the size of its velocity.

    rms, largest, mean: of the error at the particles whose velocity is unknown; x, exact, solution,
    error: there, (d, n) and (n,); plane: (n,) of the first axis
    predicted: the error that theory expects, None with the reason in `none`
    amplification: ‖L⁻¹‖₂, and exact_amplification that of the continuum, in squares of the width;
    None where L was not factorised
    slowest: rates over ν at which the slowest transients decay, and that of the continuum
    singular: why the solution is not to be trusted, "" where it is
    bytes: of the matrix and of its factors; seconds: of making and of solving
    """

    asked: Asked
    rms: float
    largest: float
    mean: float
    x: Array
    exact: Array
    solution: Array
    predicted: Predicted | None
    none: str
    amplification: float | None
    exact_amplification: float
    slowest: list[complex]
    exact_slowest: float
    singular: str
    bytes: int
    seconds: dict[str, float]

    @property
    def error(self) -> Array:
        """solution − exact."""
        return self.solution - self.exact

    @property
    def ratio(self) -> float | None:
        """Measured over predicted; None where either is rounding."""
        if self.predicted is None:
            return None
        floor = 1e-13 * (self.amplification or self.exact_amplification) / self.spacing2
        if self.rms <= floor or self.predicted.total <= floor:
            return None
        return self.rms / self.predicted.total

    @property
    def spacing2(self) -> float:
        """Δx², which the terms of L are divided by."""
        return float(self.asked.across) ** -2

    def profile(self) -> dict[str, Array]:
        """Across the flow, plane by plane (ring by ring of the annulus), of those with unknowns:
        x, the distance from the first wall, and means of exact, solution, error; scatter, the
        standard deviation of the error; predicted_error and predicted_scatter, if there are any."""
        across = self.asked.across
        distance = self.x[0]
        if self.asked.flow == "rotating-couette":
            distance = np.sqrt((self.x * self.x).sum(axis=0)) - INNER
        place = np.clip((distance * across * (1 + 1e-12)).astype(np.int64), 0, across - 1)
        size = np.bincount(place, minlength=across)
        kept = size > 0

        def mean(values: Array) -> Array:
            total = np.bincount(place, weights=values, minlength=across)
            return np.asarray(total[kept] / size[kept])

        rows = {
            "x": mean(distance),
            "exact": mean(self.exact),
            "solution": mean(self.solution),
            "error": mean(self.error),
        }
        rows["scatter"] = np.sqrt(np.maximum(mean(self.error**2) - rows["error"] ** 2, 0.0))
        if self.predicted is not None:
            rows["predicted_error"] = self.predicted.mean[kept]
            rows["predicted_scatter"] = self.predicted.spread[kept]
        return rows


@dataclass(frozen=True, eq=False)
class Vortex:
    """The decay of the Taylor–Green vortex."""

    asked: Asked
    decay: Decay
    seconds: float


@dataclass(frozen=True, eq=False)
class Lid:
    """Flows in the cavity, beside published ones."""

    asked: Asked
    gradient: Operator
    cavity: Cavity

    def compared(self) -> list[dict[str, Any]]:
        """For every Re and extremum: value, that of Ghia et al. and of Botella & Peyret where they
        have it, and the differences in parts of these."""
        ghia, fine = published()["ghia"], published()["botella-peyret"]
        rows = []
        for profile in self.cavity.profiles:
            name = f"{profile.re:g}"
            table = {
                "u_min": min(ghia["u"].get(name, [inf])),
                "v_max": max(ghia["v"].get(name, [-inf])),
                "v_min": min(ghia["v"].get(name, [inf])),
            }
            for extremum, value in profile.extrema.items():
                other = fine[extremum].get(name)
                known = table[extremum] if abs(table[extremum]) < inf else None
                rows.append(
                    {
                        "re": profile.re,
                        "extremum": extremum,
                        "value": value,
                        "ghia": known,
                        "from_ghia": None if known is None else value / known - 1.0,
                        "botella_peyret": other,
                        "from_botella_peyret": None if other is None else value / other - 1.0,
                    }
                )
        return rows
