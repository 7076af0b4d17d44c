"""The truncation error of an acceleration: measured on particles, and predicted from the lattice.

The error of a = Q P/m against −∇P/ρ is a function of all displacements u of the particles. On a
lattice it is e₀; displaced at random by σ along each axis it has, to first order in σ,

    ⟨|e|²⟩ = |e₀|² + σ² Σ_b |∂e_a/∂u_b|²,        ∂e_a/∂u_b = ∂e_{a−b}/∂u_0,

so one particle of the lattice is moved, and what all others feel is added up: every form, with
whatever corrections, is predicted by its own sums. A pressure P₀ + P₁ sin(k·x + φ) has, over all
phases φ, P₀² ⟨|e|²⟩ of a constant and ½P₁² ⟨|e|²⟩ of exp(ik·x).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.adapted_lengths import adapted
from sphtrunc.experiment.momentum import State, parts_of
from sphtrunc.experiment.pair_matrices import Cloud, act
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.sites import sites, units

_STEP = 1e-6  # Δx, of the difference


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


def measured_errors(
    state: State, pairs: Sequence[tuple[str, str]], wave: Wave, inside: Any
) -> list[float]:
    """The rms error of each (form, rule) over the particles `inside` and over all phases of the
    wave: |F/m + ∇P/ρ| over max |∇P|/ρ."""
    found = []
    for constant, waving in _errors(state, pairs, wave.wavenumber):
        size = wave.background**2 * (constant**2).sum(axis=0)
        size = size + 0.5 * wave.amplitude**2 * (abs(waving) ** 2).sum(axis=0)
        found.append(float(np.sqrt(np.mean((size * state.density**2)[inside]))) / wave.largest)
    return found


def predicted_errors(
    pairs: Sequence[tuple[str, str]],
    lattice: Lattice,
    kernel: Kernel,
    sigma: float,
    wave: Wave,
    follows: bool = False,
) -> list[float]:
    """What `measured_errors` measures, for equal masses and displacements of standard deviation σ
    (in Δx), to first order in σ.

    follows: h is h₀ (ρ₀/ρ)^{1/d}, ρ the summation, and follows the displacements; else all have one
    """
    dx, dim = float(lattice.dx_over_h), lattice.dim
    support = float(kernel.support) / dx
    _, x = ball(lattice, (5.0 if follows else 4.0) * support + 2.0)
    near = np.sqrt((x * x).sum(axis=0)) <= (2.0 * support + 1.0) * dx
    at = int(np.flatnonzero(~np.any(x, axis=0))[0])

    def errors(places: Array) -> list[list[Array]]:
        ones = np.ones(places.shape[1])
        h, density = ones, ones
        if follows:
            found = adapted(places.T, dx**dim, kernel, eta=1.0 / dx, workers=1)
            h, density = found.h, found.density
        state = State(Cloud(places, h, kernel, workers=1), dx**dim * ones, density, ones)
        rows = _errors(state, pairs, wave.wavenumber)
        return [[density * one for one in row] for row in rows]

    home = errors(x)
    square = [[float((abs(one[:, at]) ** 2).sum()) for one in row] for row in home]
    # the wave runs along x: where y and z are alike, one of them stands for both
    alike = dim == 3 and lattice.kind != "hcp"
    for axis in range((2 if alike else dim) if sigma else 0):
        places = x.copy()
        places[axis, at] += _STEP * dx
        weight = sigma**2 * (2.0 if alike and axis else 1.0)
        for row, moved, rest in zip(square, errors(places), home, strict=True):
            for i in range(2):
                slope = (moved[i] - rest[i])[:, near] / _STEP
                row[i] += weight * float((abs(slope) ** 2).sum())
    return [
        sqrt(wave.background**2 * constant + 0.5 * wave.amplitude**2 * waving) / wave.largest
        for constant, waving in square
    ]


def _errors(state: State, pairs: Sequence[tuple[str, str]], wavenumber: float) -> list[list[Array]]:
    """F/m + ∇P/ρ, (d, n), of P = 1 and of P = exp(ik·x), for every form."""
    along = wavenumber * state.cloud.x[0]
    fields = [np.ones_like(along), np.cos(along), np.sin(along)]
    requests = [(parts_of(state, *pair), field) for pair in pairs for field in fields]
    done = [one.value / state.mass for one in act(state.cloud, requests)]
    found = []
    for i in range(len(pairs)):
        constant, cosine, sine = done[3 * i : 3 * i + 3]
        waving = cosine + 1j * sine
        waving[0] += 1j * wavenumber * (fields[1] + 1j * fields[2]) / state.density
        found.append([constant, waving])
    return found


def wave_of(h_over_lambda: float, background: float, amplitude: float) -> Wave:
    """The wave whose length is λ, h = 1."""
    return Wave(2.0 * pi * h_over_lambda, background, amplitude)
