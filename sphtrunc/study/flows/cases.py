"""Cases: flows whose exact solution is known, as rows of data; lengths in the width between walls.

A velocity u along the walls obeys ∇²u = f, f the pressure gradient over the viscosity, and the
walls at 0 and 1 along the first axes have its values. Sources: any text on viscous flow; the duct
is White, Viscous Fluid Flow (3rd ed. 2006), eq. 3-48.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import pi
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.operators.moments import MultiIndex

_TERMS = 400  # odd ones, of the series of the duct: to 1e-10 of its velocity


@dataclass(frozen=True)
class Case:
    """A steady flow.

    walls: axes that end in walls; u: the exact velocity at points (d, n), of size 1; forcing: ∇²u,
    a constant; slowest: the eigenvalue of −∇² that the slowest transient decays with; derivatives:
    n -> dⁿu/dx₁ⁿ as a function of x₁ where u depends on x₁ alone as a polynomial, else empty
    """

    name: str
    says: str
    walls: int
    u: Callable[[Array], Array]
    forcing: float
    slowest: float
    derivatives: tuple[Callable[[Array], Array], ...] = ()

    def taylor(self, x: float, h: float, dim: int) -> dict[MultiIndex, float]:
        """c_α = h^{|α|} u^{(α)}/α! at a point x along the first axis."""
        at = np.array([x])
        rows, factor = {}, 1.0
        for n, derivative in enumerate(self.derivatives):
            factor *= n or 1
            rows[(n, *(0,) * (dim - 1))] = h**n * float(derivative(at)[0]) / factor
        return rows


def _constant(c: float) -> Callable[[Array], Array]:
    return lambda x: np.full_like(x, c)


def _series(x: Array) -> Array:
    """u = Σ over odd n of 4/(nπ)³ sin nπx [1 − cosh nπ(y − ½)/cosh nπ/2], for which ∇²u = −1."""
    t = np.abs(x[1] - 0.5)
    total = np.zeros_like(t)
    for n in range(1, 2 * _TERMS, 2):
        k = n * pi
        # cosh kt/cosh k/2 without its overflow
        ratio = np.exp(k * (t - 0.5)) * (1 + np.exp(-2 * k * t)) / (1 + np.exp(-k))
        total += 4.0 / k**3 * np.sin(k * x[0]) * (1.0 - ratio)
    return np.asarray(total)


@cache
def _middle() -> float:
    """Of the series in the middle of the duct."""
    return float(_series(np.array([[0.5], [0.5]]))[0])


CASES = {
    "poiseuille": Case(
        "poiseuille",
        "between plane walls at rest, driven by a pressure gradient: u = 4x(1 − x)",
        1,
        lambda x: 4.0 * x[0] * (1.0 - x[0]),
        -8.0,
        pi**2,
        (lambda x: 4.0 * x * (1.0 - x), lambda x: 4.0 - 8.0 * x, _constant(-8.0)),
    ),
    "couette": Case(
        "couette",
        "between a plane wall at rest and one that moves: u = x",
        1,
        lambda x: x[0].copy(),
        0.0,
        pi**2,
        (lambda x: x.copy(), _constant(1.0)),
    ),
    "duct": Case(
        "duct",
        "in a square duct with walls at rest, driven by a pressure gradient",
        2,
        lambda x: _series(x) / _middle(),
        -1.0 / _middle(),
        2 * pi**2,
    ),
}
