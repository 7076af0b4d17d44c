"""The isothermal atmosphere on particles: what `theory.variable_h.atmosphere` derives, measured."""

from __future__ import annotations

import numpy as np

from sphtrunc.experiment.adapted_lengths import grad_h
from sphtrunc.experiment.momentum import VARYING, State, parts_of
from sphtrunc.experiment.pair_matrices import Cloud, act
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.scenes.particles import particles


def atmosphere_errors(kernel: Kernel, dim: int, epsilon: float, dx: float) -> dict[str, float]:
    """rule: error of the acceleration at a particle of a cubic lattice with masses e^{−x/L}, over
    μ₂ (h/L)² c²/L.

    epsilon: h/L at the target; dx: spacing over h there; h ∝ e^{x/(dL)}, P = c²ρ, ρ the summation

    Densities depend on x alone and are summed once for each plane. Raises ValueError where supports
    have no end (see `sphtrunc.theory.variable_h.atmosphere`) or there would be more than a million
    particles.
    """
    support = float(kernel.support)
    if not 0.0 < epsilon * support < 0.25 * dim:
        raise ValueError(
            f"epsilon: got {epsilon:g}, expected a ratio h/L below {0.25 * dim / support:g}"
        )
    # the farthest whose own support holds the target: s = κ e^{εs/d}
    reach = support
    for _ in range(60):
        reach = support * np.exp(epsilon * reach / dim)
    wide = reach + support * float(np.exp(epsilon * reach / dim))
    along = np.arange(-int(wide / dx) - 1, int(wide / dx) + 2) * dx
    radius = support * float(np.exp(epsilon * reach / dim)) + dx
    across = np.arange(-int(radius / dx) - 1, int(radius / dx) + 2) * dx
    if along.size * across.size ** (dim - 1) > 1_000_000:
        raise ValueError(f"dx: got {dx:g}, expected a spacing that gives fewer particles")
    grid = np.meshgrid(along, *[across] * (dim - 1), indexing="ij")
    x = np.stack([axis.ravel() for axis in grid])
    x = x[:, (x[1:] ** 2).sum(axis=0) <= radius**2]
    h, mass = np.exp(epsilon * x[0] / dim), np.exp(-epsilon * x[0]) * dx**dim
    on_axis = np.flatnonzero(~np.any(x[1:] != 0.0, axis=0))
    planes = on_axis[np.abs(x[0, on_axis]) <= reach + dx]
    at = planes[np.argmin(np.abs(x[0, planes]))][None]
    scene = particles(x.T, h=h, volume=mass)
    density, omega = grad_h(scene, kernel, 1, planes)
    level = np.rint(x[0] / dx).astype(np.int64)
    known = np.abs(x[0]) <= reach + dx
    x, h, mass, level = x[:, known], h[known], mass[known], level[known]
    at = np.flatnonzero(~np.any(x != 0.0, axis=0))
    level -= level.min()
    order = np.argsort(scene.x[0, planes])
    density, omega = density[order][level], omega[order][level]
    state = State(Cloud(x, h, kernel, workers=1), mass, density, density)
    requests = [
        # P/Ω in place of P is the form with Ω: its sums need not be taken again
        (
            parts_of(state, "symmetric", "no-omega" if rule == "grad-h" else rule),
            density / omega if rule == "grad-h" else density,
        )
        for rule in VARYING
    ]
    forces = act(state.cloud, requests, targets=at)
    scale = float(kernel.moment(2, dim)) / dim * epsilon**3
    return {
        rule: float((force.value[0, 0] / mass[at[0]] - epsilon) / scale)
        for rule, force in zip(VARYING, forces, strict=True)
    }
