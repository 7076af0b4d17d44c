"""Kernels as codes write them, with the constants of the literature, and the faults of codes.

Nothing here comes from the package: shapes are typed out, constants are published ones (Dehnen &
Aly 2012, doi:10.1111/j.1365-2966.2012.21439.x; Morris, Fox & Zhu 1997, doi:10.1006/jcph.1997.5776;
Müller, Charypar & Gross 2003, doi:10.2312/SCA03/154-159; Desbrun & Gascuel 1996).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

Function = Callable[[Any], Any]


@dataclass(frozen=True)
class Written:
    """A kernel as code: shape, w′ and w″ in q = r/h, its support and its constants by dimension."""

    name: str
    support: float
    shape: Function
    slope: Function
    bend: Function
    constants: dict[int, float]


def pos(x: Any) -> Any:
    return np.clip(x, 0, None)


def powers(terms: list[tuple[float, float]], n: int) -> tuple[Function, Function, Function]:
    """Σ a (k − q)₊ⁿ and its two derivatives."""
    return (
        lambda q: sum(a * pos(k - q) ** n for a, k in terms),
        lambda q: sum(-n * a * pos(k - q) ** (n - 1) for a, k in terms),
        lambda q: sum(n * (n - 1) * a * pos(k - q) ** (n - 2) for a, k in terms),
    )


M4 = Written(
    "cubic-spline", 2, *powers([(0.25, 2), (-1, 1)], 3),
    {1: 2 / 3, 2: 10 / (7 * pi), 3: 1 / pi},
)  # fmt: skip
M4_UNIT = Written(
    "cubic-spline", 1, *powers([(2, 1), (-8, 0.5)], 3),
    {1: 4 / 3, 2: 40 / (7 * pi), 3: 8 / pi},
)  # fmt: skip
M5 = Written(
    "quartic-spline", 2.5, *powers([(1, 2.5), (-5, 1.5), (10, 0.5)], 4),
    {1: 1 / 24, 2: 96 / (1199 * pi), 3: 1 / (20 * pi)},
)  # fmt: skip
M6 = Written(
    "quintic-spline", 3, *powers([(1, 3), (-6, 2), (15, 1)], 5),
    {1: 1 / 120, 2: 7 / (478 * pi), 3: 1 / (120 * pi)},
)  # fmt: skip
C2 = Written(
    "wendland-c2", 2,
    lambda q: pos(1 - q / 2) ** 4 * (1 + 2 * q),
    lambda q: -5 * q * pos(1 - q / 2) ** 3,
    lambda q: 5 * pos(1 - q / 2) ** 2 * (2 * q - 1),
    {2: 7 / (4 * pi), 3: 21 / (16 * pi)},
)  # fmt: skip
C2_UNIT = Written(
    "wendland-c2", 1,
    lambda q: pos(1 - q) ** 4 * (1 + 4 * q),
    lambda q: -20 * q * pos(1 - q) ** 3,
    lambda q: 20 * pos(1 - q) ** 2 * (4 * q - 1),
    {2: 7 / pi, 3: 21 / (2 * pi)},
)  # fmt: skip
C4 = Written(
    "wendland-c4", 2,
    lambda q: pos(1 - q / 2) ** 6 * (35 / 12 * q**2 + 3 * q + 1),
    lambda q: -7 / 6 * q * pos(1 - q / 2) ** 5 * (5 * q + 2) * 2,
    lambda q: 7 / 6 * pos(1 - q / 2) ** 4 * (35 * q**2 - 8 * q - 4),
    {2: 9 / (4 * pi), 3: 495 / (256 * pi)},
)  # fmt: skip
C6_UNIT = Written(
    "wendland-c6", 1,
    lambda q: pos(1 - q) ** 8 * (1 + 8 * q + 25 * q**2 + 32 * q**3),
    lambda q: -22 * q * pos(1 - q) ** 7 * (16 * q**2 + 7 * q + 1),
    lambda q: 22 * pos(1 - q) ** 6 * (160 * q**3 + 15 * q**2 - 6 * q - 1),
    {2: 78 / (7 * pi), 3: 1365 / (64 * pi)},
)  # fmt: skip
POLY6 = Written(
    "poly6", 1,
    lambda q: pos(1 - q**2) ** 3,
    lambda q: -6 * q * pos(1 - q**2) ** 2,
    lambda q: -6 * pos(1 - q**2) * (1 - 5 * q**2),
    {1: 35 / 32, 2: 4 / pi, 3: 315 / (64 * pi)},
)  # fmt: skip
SPIKY = Written(
    "spiky", 1, *powers([(1, 1)], 3), {1: 2, 2: 10 / pi, 3: 15 / pi},
)  # fmt: skip

KERNELS = (M4, M4_UNIT, M5, M6, C2, C2_UNIT, C4, C6_UNIT, POLY6, SPIKY)


def code(
    kernel: Written,
    dim: int,
    constant: float | None = None,
    order: int = 0,
    power: float | None = None,
    function: Function | None = None,
) -> Callable[[Any, float], Any]:
    """(r, h) -> c h^power f(r/h), f the shape or a derivative; right where nothing is said."""
    c = kernel.constants[dim] if constant is None else constant
    p = -(dim + order) if power is None else power
    f = function or (kernel.shape, kernel.slope, kernel.bend)[order]

    def called(r: Any, h: float) -> Any:
        q = r / h
        return np.where(q < kernel.support, c * h**p * f(q), 0.0)

    return called
