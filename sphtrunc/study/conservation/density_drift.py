"""Density by summation against density by continuity, as a time step lets them drift apart.

d/dt Σ m_b W = Σ m_b v_ab·∇W is an identity, so both densities are one until time is cut in steps.
What a step of length τ leaves is, with ρ⁽ⁿ⁾[v, …] = Σ m_b ∂ⁿW v_ab… at the particle,

    Euler, and leapfrog with kernels at xⁿ      −½ τ² ρ″[v, v]                     order 1
    leapfrog, kernels at the midpoint           −τ³/24 ρ‴[v, v, v]                 order 2
    leapfrog, mean of the kernels at both ends  +τ³/12 ρ‴[v, v, v]                 order 2
    RK2 (midpoint)                              −τ³ (¼ ρ″[a, v] + ρ‴[v, v, v]/24)  order 2
    RK4                                         of order τ⁵                        order 4

and the drift after a time T is the sum of these along the motion: one integral, divided by a power
of τ, predicts it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from sphtrunc.arithmetic.plain import Plain
from sphtrunc.arithmetic.summation import Array
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.kernels.values import kernel_values

#: scheme: order of the drift
SCHEMES = {
    "euler": 1,
    "leapfrog-start": 1,
    "leapfrog-middle": 2,
    "leapfrog-mean": 2,
    "rk2": 2,
    "rk4": 4,
}
_FINE = 160  # steps of the motion that a prediction integrates along, at least


@dataclass(frozen=True)
class Tube:
    """1D particles in a periodic box of length 1 with P = c²ρ, c = 1: x₀ = (j + ½)/n, masses 1/n,
    v₀ = amplitude·sin 2πx; ρ = Σ m W, the symmetric momentum equation.

    h: in units of the spacing 1/n
    """

    kernel: Kernel
    count: int = 40
    h: float = 1.0
    amplitude: float = 0.1

    def start(self) -> tuple[Array, Array]:
        """x, v, (n,) each."""
        x = (np.arange(self.count) + 0.5) / self.count
        return x, self.amplitude * np.sin(2.0 * pi * x)

    def derivative(
        self, x: Array, n: int, vectors: list[Array], factor: Array | float = 1.0
    ) -> Array:
        """Σ_b m_b ∂ⁿW factor_ab Π (v_a − v_b) over the vectors v, (n,); nearest images."""
        h = self.h / self.count
        gap = x[:, None] - x
        gap -= np.rint(gap)
        values = kernel_values(Plain(), self.kernel, np.abs(gap) / h, n, 1)
        terms = values * np.sign(gap) ** n / (h ** (n + 1) * self.count) * factor
        for v in vectors:
            terms = terms * (v[:, None] - v)
        return np.asarray(terms.sum(axis=1))

    def density(self, x: Array) -> Array:
        """Σ m W."""
        return self.derivative(x, 0, [])

    def rate(self, x: Array, v: Array) -> Array:
        """Σ m v_ab W′."""
        return self.derivative(x, 1, [v])

    def acceleration(self, x: Array) -> Array:
        """−Σ m (P_a/ρ_a² + P_b/ρ_b²) W′ with P = ρ."""
        per = 1.0 / self.density(x)
        return -self.derivative(x, 1, [], per[:, None] + per)


State = tuple[Array, Array, Array]  # x, v, integrated ρ


def _slopes(tube: Tube, state: State) -> State:
    x, v, _ = state
    return v, tube.acceleration(x), tube.rate(x, v)


def _moved(state: State, slopes: State, step: float) -> State:
    x, v, rho = (one + step * slope for one, slope in zip(state, slopes, strict=True))
    return x, v, rho


def _euler(tube: Tube, state: State, step: float) -> State:
    return _moved(state, _slopes(tube, state), step)


def _rk2(tube: Tube, state: State, step: float) -> State:
    return _moved(state, _slopes(tube, _moved(state, _slopes(tube, state), 0.5 * step)), step)


def _rk4(tube: Tube, state: State, step: float) -> State:
    k1 = _slopes(tube, state)
    k2 = _slopes(tube, _moved(state, k1, 0.5 * step))
    k3 = _slopes(tube, _moved(state, k2, 0.5 * step))
    k4 = _slopes(tube, _moved(state, k3, step))
    mean = tuple(
        (a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)
    )
    return _moved(state, mean, step)  # type: ignore[arg-type]


def _leapfrog(where: str) -> Callable[[Tube, State, float], State]:
    """v is half a step ahead of x."""

    def step_on(tube: Tube, state: State, step: float) -> State:
        x, v, rho = state
        after = x + step * v
        if where == "mean":
            rate = 0.5 * (tube.rate(x, v) + tube.rate(after, v))
        else:
            rate = tube.rate(x if where == "start" else x + 0.5 * step * v, v)
        return after, v + step * tube.acceleration(after), rho + step * rate

    return step_on


_STEPS: dict[str, Callable[[Tube, State, float], State]] = {
    "euler": _euler,
    "rk2": _rk2,
    "rk4": _rk4,
    **{f"leapfrog-{where}": _leapfrog(where) for where in ("start", "middle", "mean")},
}


def drift(tube: Tube, scheme: str, steps: int, time: float = 0.4) -> Array:
    """Integrated less summed density after `steps` steps to `time`, (n,).

    Raises ValueError for an unknown scheme and fewer than one step.
    """
    if scheme not in SCHEMES:
        raise ValueError(f"scheme: got {scheme!r}, expected one of {', '.join(SCHEMES)}")
    if steps < 1:
        raise ValueError(f"steps: got {steps}, expected at least 1")
    step = time / steps
    x, v = tube.start()
    if scheme.startswith("leapfrog"):
        v = v + 0.5 * step * tube.acceleration(x)
    state = (x, v, tube.density(x))
    for _ in range(steps):
        state = _STEPS[scheme](tube, state, step)
    return np.asarray(state[2] - tube.density(state[0]))


def predicted_drift(tube: Tube, scheme: str, steps: int, time: float = 0.4) -> Array | None:
    """The leading term of `drift`, (n,): the integral of what a step leaves, along the motion; None
    for RK4, of which only the order is known."""
    if scheme == "rk4":
        return None
    step = time / steps
    fine = max(_FINE, steps)
    dt = time / fine
    x, v = tube.start()
    state = (x, v, tube.density(x))
    total: Any = 0.0
    for n in range(fine + 1):
        weight = dt * (0.5 if n in (0, fine) else 1.0)
        total = total + weight * _left(tube, scheme, state[0], state[1])
        if n < fine:
            state = _rk4(tube, state, dt)
    return np.asarray(total * step ** SCHEMES[scheme])


def _left(tube: Tube, scheme: str, x: Array, v: Array) -> Array:
    """What a step leaves, over the power of its length that is one more than the order."""
    if scheme in ("euler", "leapfrog-start"):
        return -0.5 * tube.derivative(x, 2, [v, v])
    third = tube.derivative(x, 3, [v, v, v])
    if scheme == "leapfrog-middle":
        return -third / 24.0
    if scheme == "leapfrog-mean":
        return third / 12.0
    return -0.25 * tube.derivative(x, 2, [tube.acceleration(x), v]) - third / 24.0


def tube(kernel: Kernel | str = "quintic-spline", **options: Any) -> Tube:
    """The setting of the table: M6, h = Δx = 1/40, v₀ = 0.1 sin 2πx.

    Raises ValueError for a kernel that is not a polynomial.
    """
    found = parse_kernel(kernel)
    if not isinstance(found, Kernel):
        raise ValueError(f"kernel: expected a piecewise polynomial, got {found.name}")
    return Tube(found, **options)
