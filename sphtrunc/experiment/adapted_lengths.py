"""Smoothing lengths that follow the density, h = η (m/ρ)^{1/d}, solved with the density that they
give, and Ω, what a change of h does to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.engine import pair_sums
from sphtrunc.operators.moments import unit
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.particles import Particles, particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

_MOST_STEPS = 60


def grad_h(
    scene: Particles, kernel: Kernel, workers: int | None = None, targets: object = None
) -> tuple[Array, Array]:
    """ρ_a = Σ m_b W(x_ab, h_a) and Ω_a = 1 + (h_a/dρ_a) ∂ρ_a/∂h_a of particles whose volumes are
    their masses; (T,) each, at the targets, (n,) at all.

    h^{−d−1}(dW + x·∇W) is −∂W/∂h, so Ω = Σ_i m[e_i, e_i]/(d ρ) in base sums.
    """
    dim = scene.dim
    zero = unit(dim, 0, 0)
    axes = [unit(dim, i) for i in range(dim)]
    keys: list[Key] = [(zero, zero), *((e, e) for e in axes)]
    sums = pair_sums(scene, kernel, keys, targets=targets, workers=workers).base
    density = sums[zero, zero]
    return density, np.asarray(sum(sums[e, e] for e in axes) / (dim * density))


@dataclass(frozen=True)
class Adapted:
    """h_a = η (m_a/ρ_a)^{1/d} with ρ_a = Σ m_b W(x_ab, h_a), solved.

    h, density, omega: (n,), Ω = 1 + (h/dρ) ∂ρ/∂h; steps: of Newton's iteration
    """

    h: Array
    density: Array
    omega: Array
    steps: int


def adapted(
    x: object,
    mass: object,
    kernel: Kernel | str,
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
    kernel: a Kernel, or any text that `sphtrunc.kernel` takes

    >>> found = adapted([0, 1, 2, 3, 4, 5, 6, 7], 1, "cubic-spline", eta=1.2, period=8)
    >>> round(float(found.h[0] * found.density[0]), 9)
    1.2

    Raises ValueError where it does not settle.
    """
    from sphtrunc.kernels.parse import kernel as parse_kernel

    kernel = parse_kernel(kernel)
    start = particles(x, h=1.0, mass=mass, period=period)
    dim, masses = start.dim, start.mass
    places = start.x.T
    if not eta > 0.0:
        raise ValueError(f"eta: got {eta:g}, expected a positive number such as 1.2")
    h = np.full(start.population, _guess(start, eta))
    for step in range(1, _MOST_STEPS + 1):
        scene = particles(places, h=h, volume=masses, period=period)
        density, omega = grad_h(scene, kernel, workers)
        if not np.all(density > 0.0):
            raise ValueError("h: a particle has no density; expected a kernel positive at 0")
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
