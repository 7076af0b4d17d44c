"""Smoothing lengths: constant, linear in the position, or following the density, h ∝ ρ^{−1/d}."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.engine import pair_sums
from sphtrunc.lattice import sites, units
from sphtrunc.moments import unit
from sphtrunc.particles import MODES, Particles, particles
from sphtrunc.scene import Lattice
from sphtrunc.summation import Array

if TYPE_CHECKING:
    from sphtrunc.kernel import Kernel

_MOST_STEPS = 60


@dataclass(frozen=True)
class Adapted:
    """h_a = η (m_a/ρ_a)^{1/d} with ρ_a = Σ m_b W(x_ab, h_a), solved.

    h, density, omega: (n,), Ω = 1 + (h/dρ) ∂ρ/∂h; steps: of Newton's iteration
    """

    h: Array
    density: Array
    omega: Array
    steps: int


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


def adapted(
    x: object,
    mass: object,
    kernel: Kernel,
    *,
    eta: float = 1.2,
    period: object = None,
    tolerance: float = 1e-12,
    workers: int | None = None,
) -> Adapted:
    """Smoothing lengths that follow the summation density, h = η (m/ρ)^{1/d}, ρ itself of h.

    Newton's iteration on ln h: f = ln h − ln η + (ln ρ − ln m)/d has f′ = Ω, the same sum that the
    equations of motion need (Springel & Hernquist 2002, doi:10.1046/j.1365-8711.2002.05445.x;
    Price & Monaghan 2007, doi:10.1111/j.1365-2966.2006.11241.x). A step is at most a factor two.

    x: (n, d) or (n,); mass: (n,) or one number; tolerance: of h, relative
    Raises ValueError where it does not settle.
    """
    start = particles(x, h=1.0, mass=mass, period=period)
    dim, masses = start.dim, start.mass
    places = start.x.T
    if not eta > 0.0:
        raise ValueError(f"eta: got {eta:g}, expected a positive number such as 1.2")
    h = np.full(start.population, _guess(start, eta))
    zero = unit(dim, 0, 0)
    axes = [unit(dim, i) for i in range(dim)]
    keys: list[Any] = [(zero, zero), *((e, e) for e in axes)]
    for step in range(1, _MOST_STEPS + 1):
        scene = particles(places, h=h, volume=masses, period=period)
        sums = pair_sums(scene, kernel, keys, workers=workers).base
        density = sums[zero, zero]
        if not np.all(density > 0.0):
            raise ValueError("h: a particle has no density; expected a kernel positive at 0")
        omega = np.asarray(sum(sums[e, e] for e in axes) / (dim * density))
        off = np.log(h / eta) + np.log(density / masses) / dim
        if np.all(np.abs(off) <= tolerance):
            return Adapted(h, density, omega, step)
        # a lonely particle has Ω → 0: h is doubled until it is one no longer
        slope = np.maximum(omega, 0.3)
        h = h * np.exp(np.clip(-off / slope, -np.log(2.0), np.log(2.0)))
    raise ValueError(
        f"h: {int(np.count_nonzero(np.abs(off) > tolerance))} smoothing lengths did not settle in"
        f" {_MOST_STEPS} steps; expected a larger eta or a larger tolerance"
    )


def _guess(scene: Particles, eta: float) -> float:
    """η times the mean distance, from the volume that the particles span."""
    if scene.period is not None:
        volume = float(np.prod(scene.period))
    else:
        span = scene.x.max(axis=1) - scene.x.min(axis=1)
        volume = float(np.prod(np.where(span > 0.0, span, span.max(initial=1.0) or 1.0)))
    return float(eta * (volume / scene.population) ** (1.0 / scene.dim))


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
    from sphtrunc.variable_h import require_support

    if mode not in MODES:
        raise ValueError(f"h-rule: got {mode!r}, expected one of {', '.join(MODES)}")
    require_support(kernel, list(gradient), mode)
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
