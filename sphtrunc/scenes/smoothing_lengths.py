"""Smoothing lengths that vary with the position: every particle of a scene has an h of its own.

Seen from a target of smoothing length 1, h(x) = 1 + g·(x − x_a) at the places where the particles
are, wherever they were displaced to. The scene itself stays what it is: a lattice, displaced or
not, or graded spacing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.plain import PLAIN
from sphtrunc.arithmetic.rational import exact, fraction, fractions
from sphtrunc.arithmetic.summation import (
    UNIT,
    Array,
    DoubleDouble,
    dd,
    dd_add,
    dd_div,
    dd_from_ratio,
    dd_mul,
)
from sphtrunc.operators.h_rules import require_rule, require_support, slope_share
from sphtrunc.scenes.graded import Graded
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.neighbourhood import EDGE, Indices, Neighbourhood

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


@dataclass(frozen=True)
class Sloped:
    """A scene whose smoothing length is h = h_a (1 + g·s). Made by `sloped`.

    gradient: g along each axis; rule: whose h a pair takes, of `sphtrunc.operators.h_rules`
    """

    base: Lattice | Jittered | Graded
    gradient: tuple[Fraction, ...]
    rule: str

    @property
    def dim(self) -> int:
        """d."""
        return self.base.dim

    @property
    def volume(self) -> str:
        """The rule for the volumes."""
        return self.base.volume

    @property
    def population(self) -> int:
        """The number of different targets."""
        return self.base.population

    @property
    def particles(self) -> int:
        """The number of particles."""
        return self.base.particles

    @property
    def slope(self) -> tuple[Fraction, ...]:
        """The gradient of h_ab."""
        return tuple(slope_share(self.rule) * g for g in self.gradient)

    def reach(self, kernel: Kernel) -> int:
        """How many supports of the target hold every particle whose own support holds it.

        Raises ValueError where there is no end to it: |g|κ >= 1.
        """
        require_support(fraction(kernel.support), self.gradient, self.rule)
        steep = sum(float(g) ** 2 for g in self.slope) ** 0.5 * float(kernel.support)
        return int(max(1, ceil(EDGE / (1.0 - steep))))

    def rows(self, kernel: Kernel) -> int:
        """An estimate of the number of candidates."""
        return int(self.base.rows(kernel) * self.reach(kernel) ** self.dim)

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        number: Any = PLAIN,
        *,
        reach: int = 1,
    ) -> Neighbourhood:
        """The neighbours of the scene, with h_a/h_ab beside each."""
        wider = reach * self.reach(kernel)
        block = self.base.neighbourhood(target, kernel, number, reach=wider)
        beside = block.beside
        length = np.ones(block.offset.shape[1:])
        wide: DoubleDouble = dd(length)
        error = np.zeros_like(length)
        for axis, g in enumerate(self.slope):
            if not g:
                continue
            high, low = dd_from_ratio(*g.as_integer_ratio())
            s = block.offset[axis]
            length = length + high * s
            error += abs(high) * (4.0 * UNIT * np.abs(s))
            if number.bounded and beside is not None:
                error += abs(high) * beside.offset[axis]
            if number.wide and beside is not None:
                steep = (np.full_like(s, high), np.full_like(s, low))
                wide = dd_add(wide, dd_mul(steep, (s, beside.offset[axis])))
        # where h falls to 0 is beyond any support: the offset itself says so
        inside = length > 0.5 * UNIT
        length = np.where(inside, length, 1.0)
        stretch, more = 1.0 / length, None
        if number.wide:
            high_part, low_part = (
                np.where(inside, part, value) for part, value in zip(wide, (1.0, 0.0), strict=True)
            )
            stretch, more = dd_div(dd(np.ones_like(length)), (high_part, low_part))
        elif number.bounded:
            off = error + (self.dim + 1.0) * UNIT * np.abs(length)
            room = np.maximum(length - off, UNIT * length)
            more = np.where(inside, (off / room + UNIT) * stretch * EDGE, 0.0)
        return replace(
            block,
            stretch=stretch,
            mean_kernel=self.rule == "mean-kernel",
            beside=None if beside is None else beside._replace(stretch=more),
        )

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (d, N) and volumes (N,) of one target as arrays of Fractions."""
        offset, volume, _ = self._exactly(target, kernel, reach)
        return offset, volume

    def exact_stretch(self, target: int, kernel: Kernel) -> Any:
        """h_a/h_ab of the same particles, (N,) Fractions."""
        return self._exactly(target, kernel, 1)[2]

    def _exactly(self, target: int, kernel: Kernel, reach: int) -> tuple[Any, Any, Any]:
        around = reach * self.reach(kernel)
        offset, volume = self.base.exact_neighbourhood(target, kernel, reach=around)
        length = sum((g * s for g, s in zip(self.slope, offset, strict=True)), Fraction(1))
        length = length + fractions(np.zeros(offset.shape[1]))
        square = (offset * offset).sum(axis=0)
        most = (reach * fraction(kernel.support)) ** 2
        near = np.array([h > 0 and q <= most * h * h for h, q in zip(length, square, strict=True)])
        if self.rule == "mean-kernel":
            near |= square <= most
        return offset[:, near], volume[near], 1 / length[near]


def sloped(scene: Lattice | Jittered | Graded, gradient: object, rule: str = "scatter") -> Sloped:
    """The scene with a smoothing length that grows linearly, h = h_a (1 + g·s).

    gradient: g = dh/dx, one number (along the first axis) or d of them, taken exactly: write
        Fractions or "1/5"
    rule: whose h a pair takes: "gather" h_a, "scatter" h_b, "mean" (h_a + h_b)/2; "mean-kernel" the
        mean of the kernels of h_a and of h_b

    Raises ValueError for a rule that is unknown, and volumes by summation, whose h would vary too.
    """
    require_rule(rule)
    if not isinstance(scene, (Lattice, Jittered, Graded)):
        raise ValueError("h-gradient: particles have an h each; expected a lattice or graded scene")
    if scene.volume == "summation":
        raise ValueError("volume: got summation with a gradient of h, expected constant or cell")
    given: Sequence[object] = (
        list(gradient) if isinstance(gradient, (tuple, list, np.ndarray)) else [gradient]
    )
    slopes = [exact(g, "h-gradient") for g in given]
    if len(slopes) == 1:
        slopes += [Fraction(0)] * (scene.dim - 1)
    if len(slopes) != scene.dim:
        raise ValueError(f"h-gradient: got {len(slopes)} numbers, expected 1 or {scene.dim}")
    return Sloped(scene, tuple(slopes), rule)


def linear(x: Array, h: float, gradient: Sequence[float], origin: Sequence[float]) -> Array:
    """h(x) = h + g·(x − x₀), (n,), at positions (n, d) or (n,), for `particles`.

    Raises ValueError where that is not positive.
    """
    places = np.asarray(x, dtype=np.float64)
    places = places[:, None] if places.ndim == 1 else places
    lengths = h + (places - np.asarray(origin, dtype=np.float64)) @ np.asarray(gradient)
    if not np.all(lengths > 0.0):
        a = int(np.argmin(lengths))
        raise ValueError(
            f"h-gradient: h is {lengths[a]:g} at particle {a}, expected positive lengths; take a"
            " smaller gradient, or fewer particles"
        )
    return np.asarray(lengths)
