"""Smoothing lengths that are linear in the position, and the neighbours of a target with them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.arithmetic.summation import Array
from sphtrunc.operators.h_rules import require_support
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.particles import MODES, Particles, particles
from sphtrunc.scenes.sites import sites, units

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


def linear(x: Array, h: float, gradient: Sequence[float], origin: Sequence[float]) -> Array:
    """h(x) = h (1 + g·(x − x₀)/h), (n,), at positions (n, d) or (n,).

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


def around(
    lattice: Lattice,
    kernel: Kernel,
    gradient: Sequence[Fraction],
    mode: str = "scatter",
    displacement: Array | None = None,
) -> tuple[Particles, int]:
    """The neighbours of a target on a lattice, with h_b = h_a (1 + g·(x_b − x_a)/h_a), h_a = 1, as
    explicit particles, and the index of the target.

    displacement: (n, d) added to the positions, in Δx, h following; (d, …) rows as many as there
        are particles, see the first call; None for the lattice itself
    The target is a particle of its own, of vanishing weight, where the lattice has an offset.

    Raises ValueError for a mode that is unknown, and |g|κ >= 1.
    """
    if mode not in MODES:
        raise ValueError(f"h-rule: got {mode!r}, expected one of {', '.join(MODES)}")
    require_support(fraction(kernel.support), list(gradient), mode)
    dim = lattice.dim
    if any(lattice.offset):
        raise ValueError("offset: a target with an h of its own is a particle; expected offset 0")
    share = {"gather": 0.0, "mean": 0.5, "scatter": 1.0}[mode]
    steep = share * float(sum(g * g for g in gradient)) ** 0.5
    support = float(kernel.support)
    radius = support / (1.0 - steep * support) / float(lattice.dx_over_h)
    extra = 0.0 if displacement is None else 2.0 * float(np.abs(displacement).max())
    points = sites(lattice.kind, radius * (1.0 + 1e-9) + extra, lattice.offset, 0.0)
    scale = [float(u) for u in units(lattice.kind)]
    x = np.stack([m * u for m, u in zip(points, scale, strict=True)], axis=1)
    at = int(np.flatnonzero(~np.any(points, axis=0))[0])
    if displacement is not None:
        x = x + displacement
    x = (x - x[at]) * float(lattice.dx_over_h)
    h = 1.0 + x @ np.array([float(g) for g in gradient])
    keep = h > 0.0
    at -= int(np.count_nonzero(~keep[:at]))
    volume = float(lattice.dx_over_h**dim)
    return particles(x[keep], h=h[keep], volume=volume, mode=mode), at
