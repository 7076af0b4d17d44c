"""Graded particles: a line whose spacing varies smoothly with the position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.extended import Extended
from sphtrunc.arithmetic.plain import PLAIN
from sphtrunc.arithmetic.rational import exact, fractions
from sphtrunc.arithmetic.summation import Array
from sphtrunc.scenes.neighbourhood import Indices, Neighbourhood, assemble
from sphtrunc.scenes.random_numbers import MOST_INDICES

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


@dataclass(frozen=True)
class Graded:
    """1D particles of smoothly varying spacing. Made by `sphtrunc.scenes.graded.graded`."""

    spacing: Callable[[Array], Array]
    positions: tuple[float, ...]
    offset: Fraction
    dim: int = 1
    volume: str = "cell"

    @property
    def population(self) -> int:
        """The number of different targets."""
        return len(self.positions)

    @property
    def particles(self) -> int:
        """The number of targets; the particles themselves have no end."""
        return self.population

    def rows(self, kernel: Kernel) -> int:
        """An estimate of the number of neighbours, for the size of blocks."""
        dx = self._dx(np.array(self.positions))
        return int(4.0 * float(kernel.support) / float(dx.min())) + 8

    def _dx(self, x: Array) -> Array:
        dx = np.asarray(self.spacing(x), dtype=np.float64)
        if dx.shape not in (x.shape, ()) or not np.all(dx > 0) or not np.all(np.isfinite(dx)):
            raise ValueError(
                "dx: expected a function that returns a positive, finite spacing Δx/h for an array"
                " of positions x/h"
            )
        return np.broadcast_to(dx, x.shape)

    def _march(self, s: Array, at: Array, step: float) -> Array:
        """s(ξ + step) from s(ξ), by the classical Runge–Kutta rule in 32 substeps a unit."""
        substeps = max(1, round(32 * abs(step)))
        d = step / substeps
        for _ in range(substeps):
            k1 = self._dx(at + s)
            k2 = self._dx(at + (s + 0.5 * d * k1))
            k3 = self._dx(at + (s + 0.5 * d * k2))
            k4 = self._dx(at + (s + d * k3))
            s = s + d / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return s

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        number: Any = PLAIN,
        *,
        reach: int = 1,
    ) -> Neighbourhood:
        """All particles within so many supports of the targets, (1, N, T); the offsets are the
        floats that they are."""
        at = np.array(self.positions)[target]
        support = reach * float(kernel.support)
        start = self._march(np.zeros_like(at), at, float(self.offset))
        rows = [start]
        for direction in (1.0, -1.0):
            s, beyond = start, 0
            while beyond < 2:  # one more than the support holds: the last cell ends half-way to it
                s = self._march(s, at, direction)
                beyond += bool(np.all(direction * s > support))
                rows.append(s)
                if len(rows) > MOST_INDICES:
                    raise ValueError(
                        f"dx: a target has more than {MOST_INDICES} neighbours; expected a larger"
                        " spacing"
                    )
        offset = np.stack(rows)[None]
        nothing = [np.zeros_like(offset[0])] if number.wide or number.bounded else []
        return assemble(number, "cell", (0.0, 0.0), offset, nothing, target, kernel, reach)

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (1, N) and volumes (N,) of one target as arrays of Fractions."""
        block = self.neighbourhood(np.array([target]), kernel, Extended(), reach=reach)
        assert block.beside is not None
        low = block.beside.volume
        inside = np.abs(block.offset[0, :, 0]) <= reach * float(kernel.support)
        volume = fractions(block.volume[inside, 0]) + fractions(low[inside, 0])
        return fractions(block.offset[:, inside, 0]), volume


def graded(dx: Callable[[Array], Array], x: object = 0.0, offset: object = 0) -> Graded:
    """1D particles whose spacing varies smoothly: x(ξ) with dx/dξ = Δx(x), particles at whole
    numbers ξ + θ counted from the target, each in the cell between the midpoints to the next ones.

    dx: function from positions x/h (array) to spacings Δx/h (array of the same shape).
    x: positions of the targets in units of h, one number or many.
    offset: θ.

    Raises ValueError for what is out of range.
    """
    if not callable(dx):
        raise ValueError("dx: expected a function from positions to spacings")
    try:
        at = np.atleast_1d(np.asarray(x, dtype=np.float64))
    except (TypeError, ValueError):
        raise ValueError("x: expected the positions of the targets, numbers") from None
    if at.ndim != 1 or not at.size or not np.all(np.isfinite(at)):
        raise ValueError("x: expected one or more finite positions of targets")
    shift = exact(offset, "offset")
    if not abs(shift) <= 1:
        raise ValueError("offset: expected a number from -1 to 1")
    return Graded(dx, tuple(at.tolist()), shift)
