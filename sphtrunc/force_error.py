"""The truncation error of an acceleration: measured on particles, and predicted from the lattice.

The error of a = Q P/m against −∇P/ρ is a function of all displacements u of the particles. On a
lattice it is e₀; displaced at random by σ along each axis it has, to first order in σ,

    ⟨|e|²⟩ = |e₀|² + σ² Σ_b |∂e_a/∂u_b|²,        ∂e_a/∂u_b = ∂e_{a−b}/∂u_0,

so one particle of the lattice is moved, and what all others feel is added up: every form, with
whatever corrections, is predicted by its own sums. A pressure P₀ + P₁ sin(k·x + φ) gives
P₀² ⟨|e|²⟩ of a constant, and half of P₁² ⟨|e|²⟩ of exp(ik·x), at random phase.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np

from sphtrunc.kernel import Kernel
from sphtrunc.lattice import sites, units
from sphtrunc.momentum import State, parts_of
from sphtrunc.pairwise import Cloud, act
from sphtrunc.scene import Jittered, Lattice
from sphtrunc.summation import Array

_STEP = 1e-5  # Δx, of the central difference


@dataclass(frozen=True)
class Wave:
    """P = background + amplitude sin(k·x), k along the first axis. lengths as of the positions."""

    wavenumber: float
    background: float = 1.0
    amplitude: float = 0.5

    def pressure(self, x: Array) -> Array:
        """(n,) at (d, n)."""
        return np.asarray(self.background + self.amplitude * np.sin(self.wavenumber * x[0]))

    def slope(self, x: Array) -> Array:
        """∇P, (d, n)."""
        result = np.zeros_like(x)
        result[0] = self.amplitude * self.wavenumber * np.cos(self.wavenumber * x[0])
        return result

    @property
    def largest(self) -> float:
        """max |∇P|."""
        return abs(self.amplitude * self.wavenumber)


def ball(lattice: Lattice, radius: float) -> tuple[Any, Array]:
    """The sites of a lattice within a radius in Δx: integer points (d, n), positions in h."""
    points = sites(lattice.kind, radius, (lattice.offset[0] * 0,) * lattice.dim, 0.0)
    scale = np.array([float(u) for u in units(lattice.kind)])
    return points, points * scale[:, None] * float(lattice.dx_over_h)


def displaced(scene: Lattice | Jittered, radius: float) -> tuple[Array, Array]:
    """Positions (d, n) in h of a ball of particles, and their distance from its centre before they
    were displaced."""
    home = scene.lattice if isinstance(scene, Jittered) else scene
    points, x = ball(home, radius)
    distance = np.sqrt((x * x).sum(axis=0))
    if isinstance(scene, Jittered):
        x = x + scene.displacement(points) * float(home.dx_over_h)
    return x, distance


def measured_error(state: State, force: Array, wave: Wave, inside: Any) -> float:
    """rms over the particles `inside` of |F/m + ∇P/ρ| over max |∇P|/ρ."""
    off = force / state.mass + wave.slope(state.cloud.x) / state.density
    relative = np.sqrt((off * off).sum(axis=0)) * state.density / wave.largest
    return float(np.sqrt(np.mean(relative[inside] ** 2)))


def predicted_errors(
    pairs: Sequence[tuple[str, str]],
    lattice: Lattice,
    kernel: Kernel,
    sigma: float,
    wave: Wave,
) -> list[float]:
    """The rms error of each (form, rule) that `measured_error` measures, for equal masses, constant
    h and displacements of standard deviation σ (in Δx), to first order in σ."""
    dx, dim = float(lattice.dx_over_h), lattice.dim
    support = float(kernel.support) / dx
    _, x = ball(lattice, 4.0 * support + 2.0)
    near = np.sqrt((x * x).sum(axis=0)) <= (2.0 * support + 1.0) * dx
    at = int(np.flatnonzero(~np.any(x, axis=0))[0])

    def errors(places: Array) -> list[list[Array]]:
        return _errors(pairs, places, kernel, dx**dim, wave.wavenumber)

    home = errors(x)
    square = [[float((abs(one[:, at]) ** 2).sum()) for one in row] for row in home]
    if sigma:
        for axis in range(dim):
            moved = []
            for sign in (1.0, -1.0):
                places = x.copy()
                places[axis, at] += sign * _STEP * dx
                moved.append(errors(places))
            for row, forward, backward in zip(square, *moved, strict=True):
                for i in range(2):
                    slope = (forward[i] - backward[i])[:, near] / (2.0 * _STEP)
                    row[i] += sigma**2 * float((abs(slope) ** 2).sum())
    scale = wave.wavenumber * wave.amplitude
    return [
        sqrt(wave.background**2 * constant + 0.5 * wave.amplitude**2 * waving) / abs(scale)
        for constant, waving in square
    ]


def _errors(
    pairs: Sequence[tuple[str, str]], x: Array, kernel: Kernel, volume: float, wavenumber: float
) -> list[list[Array]]:
    """F/m + ∇P/ρ, (d, n), of P = 1 and of P = exp(ik·x), for every form; ρ = 1."""
    n = x.shape[1]
    ones = np.ones(n)
    cloud = Cloud(x, ones, kernel, workers=1)
    state = State(cloud, volume * ones, ones, ones)
    fields = [ones, np.cos(wavenumber * x[0]), np.sin(wavenumber * x[0])]
    requests = [(parts_of(state, *pair), field) for pair in pairs for field in fields]
    done = [one.value / volume for one in act(cloud, requests)]
    found = []
    for i in range(len(pairs)):
        constant, cosine, sine = done[3 * i : 3 * i + 3]
        waving = cosine + 1j * sine
        waving[0] += 1j * wavenumber * (fields[1] + 1j * fields[2])
        found.append([constant, waving])
    return found


def wave_of(h_over_lambda: float, background: float, amplitude: float) -> Wave:
    """The wave whose length is λ, h = 1."""
    return Wave(2.0 * pi * h_over_lambda, background, amplitude)


Progress = Callable[[int, int], None]
