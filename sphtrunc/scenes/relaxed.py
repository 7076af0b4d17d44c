"""Recipes of relaxed particles: periodic glasses, of which only the start is made here; an
experiment lets the particles move apart.

Lengths are in Δx, Δx^d = volume of the box over the number of particles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.rational import exact
from sphtrunc.arithmetic.summation import Array
from sphtrunc.scenes import random_numbers as jitter

if TYPE_CHECKING:
    pass

REPULSION = "pos(1-q)^2"  # whose gradient is a force that falls linearly, to nothing at q = 1
RANGE = 1.6  # of that force, in Δx
STARTS = ("jittered", "random")
SHAKEN = 0.5  # σ/Δx of the lattice at the start
PREFIX = "relaxed:"
MOST = 10**7


@dataclass(frozen=True)
class Recipe:
    """How to make a glass.

    count: N; dim; seed: of the start
    kernel, h_over_dx: shifting along −∇ΣVW with this kernel and h; None: pair repulsion, a force
        1 − r/R with R = 1.6 Δx, which is the same with another kernel
    start: "jittered", a square lattice with σ/Δx = 0.5 (N is a power of d then), or "random", which
        leaves long waves that heal by diffusion only
    residual: stop where the root mean square of |h∇ΣVW| is less; steps: after so many at most
    contrast: c of a density profile 1 + c cos(2πx/L) along the first axis, −1 < c < 1; 0: none

    Raises ValueError for what is out of range.
    """

    count: int
    dim: int = 2
    kernel: str | None = None
    h_over_dx: float | None = None
    seed: int = 0
    start: str = "jittered"
    residual: float = 1e-3
    steps: int = 400
    contrast: float = 0.0

    def __post_init__(self) -> None:
        if self.dim not in (1, 2, 3):
            raise ValueError(f"dim: got {self.dim!r}, expected 1, 2 or 3")
        for name, low, high in (("count", 8, MOST), ("seed", 0, 2**63 - 1), ("steps", 1, 10**6)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                shown = "N" if name == "count" else name
                raise ValueError(
                    f"{shown}: got {value!r}, expected a whole number from {low} to {high}"
                )
        if self.start not in STARTS:
            raise ValueError(f"start: got {self.start!r}, expected one of {', '.join(STARTS)}")
        if self.start == "jittered" and _no_power(self.count, self.dim):
            near = round(self.count ** (1 / self.dim))
            raise ValueError(
                f"N: got {self.count}, which is no power {self.dim} of a whole number; expected"
                f" {near**self.dim} or {(near + 1) ** self.dim}, or start=random"
            )
        if (self.kernel is None) != (self.h_over_dx is None):
            raise ValueError("kernel, h_over_dx: expected both, or neither for pair repulsion")
        if self.h_over_dx is not None and not (0 < self.h_over_dx <= 100):
            raise ValueError(f"h_over_dx: got {self.h_over_dx!r}, expected about 1.5")
        if not (isfinite(self.residual) and self.residual > 0):
            raise ValueError(f"residual: got {self.residual!r}, expected a small positive number")
        if not -1 < self.contrast < 1:
            raise ValueError(f"contrast: got {self.contrast!r}, expected a number from −1 to 1")

    @property
    def side(self) -> float:
        """Of the box, in Δx."""
        return float(self.count ** (1 / self.dim))

    @property
    def shape(self) -> str:
        """The kernel whose sum is evened out."""
        return self.kernel or REPULSION

    @property
    def h(self) -> float:
        """Its smoothing length, in Δx."""
        return self.h_over_dx or RANGE

    def density(self, x: Array) -> Array:
        """The wanted density at positions x along the first axis; its mean over the box is 1."""
        return np.asarray(1.0 + self.contrast * np.cos(2 * np.pi * x / self.side))

    def begin(self) -> Array:
        """Positions (d, N) before relaxation, a pure function of the recipe."""
        number = np.arange(self.count, dtype=np.int64)
        if self.start == "random":
            bits = number.astype(np.uint64)
            x = self.side * np.stack(
                [jitter.uniform01(bits, self.seed, 300 + axis) for axis in range(self.dim)]
            )
        else:
            n = round(self.side)
            rest, steps = number, []
            for _ in range(self.dim):
                rest, step = np.divmod(rest, n)
                steps.append(step)
            index = np.stack(steps)
            bits = jitter.noise(jitter.place(index), self.seed)
            moved = [jitter.component(bits, axis, "gaussian") for axis in range(self.dim)]
            x = index + 0.5 + SHAKEN * np.stack(moved)
        x = np.mod(x, self.side)
        if self.contrast:
            x[0] = self._stretched(x[0])
        return np.ascontiguousarray(x)

    def _stretched(self, u: Array) -> Array:
        """x with ∫₀ˣ ρ = u, by Newton's method."""
        q = 2 * np.pi / self.side
        x = u.copy()
        for _ in range(60):
            x -= (x + self.contrast / q * np.sin(q * x) - u) / np.maximum(self.density(x), 0.05)
            x = np.clip(x, 0.0, self.side)
        return x

    def __str__(self) -> str:
        """The recipe as it is written where particles are named."""
        given = [f"N={self.count}"] + [
            f"{f.name}={getattr(self, f.name)}"
            for f in fields(self)
            if f.name != "count" and getattr(self, f.name) != f.default
        ]
        return f"{PREFIX}glass,{','.join(given)}"


_READ: dict[str, Callable[[str, str], Any]] = {
    "N": lambda text, name: _whole(text, name),
    "dim": lambda text, name: _whole(text, name),
    "seed": lambda text, name: _whole(text, name),
    "steps": lambda text, name: _whole(text, name),
    "kernel": lambda text, name: text,
    "start": lambda text, name: text,
    "h_over_dx": lambda text, name: float(exact(text, name)),
    "residual": lambda text, name: float(exact(text, name)),
    "contrast": lambda text, name: float(exact(text, name)),
}


def _whole(text: str, name: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise ValueError(f"{name}: got {text[:40]!r}, expected a whole number")
    return int(text)


def recipe(text: str, dim: int | None = None) -> Recipe:
    """The recipe that a text such as relaxed:glass,N=4096,kernel=wendland-c2,h_over_dx=1.5,seed=1
    says. dim: where the text does not say it.

    Raises ValueError for anything else.
    """
    sort, *options = text.removeprefix(PREFIX).split(",")
    if sort.strip() != "glass":
        raise ValueError(f"relaxed: got {sort[:40]!r}, expected glass,N=4096 and options")
    given: dict[str, Any] = {} if dim is None else {"dim": dim}
    for option in options:
        name, equals, value = (part.strip() for part in option.partition("="))
        if not equals or name not in _READ:
            raise ValueError(
                f"relaxed: got {option[:40]!r}, expected NAME=VALUE of {', '.join(_READ)}"
            )
        given["count" if name == "N" else name] = _READ[name](value, name)
    if "count" not in given:
        raise ValueError("relaxed: no number of particles; expected N=4096 or another")
    return Recipe(**given)


def _no_power(count: int, dim: int) -> bool:
    return bool(round(count ** (1 / dim)) ** dim != count)
