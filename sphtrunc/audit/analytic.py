"""Kernels that are no polynomials, as they are met in codes: Gaussian, cosine, double cosine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from sympy import Expr, Rational, pi


@dataclass(frozen=True)
class Analytic:
    """A kernel that is no polynomial: its shape on [0, end], and σ_d = 1/∫ over that range."""

    name: str
    shape: Callable[[Any], Any]  # with NumPy functions; q in units of the smoothing length
    slope: Callable[[Any], Any]
    bend: Callable[[Any], Any]
    end: float
    normalisation: Callable[[int], Expr]
    source: str


_YANG = "Yang, Peng & Liu (2014) doi:10.1016/j.apm.2013.12.001"
ANALYTIC = {
    a.name: a
    for a in (
        Analytic(
            "gaussian",
            lambda q: np.exp(-q * q),
            lambda q: -2 * q * np.exp(-q * q),
            lambda q: (4 * q * q - 2) * np.exp(-q * q),
            math.inf,
            lambda dim: pi ** Rational(-dim, 2),
            "Gingold & Monaghan (1977) doi:10.1093/mnras/181.3.375",
        ),
        Analytic(
            "double-cosine",
            lambda u: 4 * np.cos(np.pi * u) + np.cos(2 * np.pi * u) + 3,
            lambda u: -np.pi * (4 * np.sin(np.pi * u) + 2 * np.sin(2 * np.pi * u)),
            lambda u: -4 * np.pi**2 * (np.cos(np.pi * u) + np.cos(2 * np.pi * u)),
            1.0,
            lambda dim: {1: Rational(1, 6), 2: pi / (3 * pi**2 - 16), 3: pi / (4 * pi**2 - 30)}[
                dim
            ],
            _YANG,
        ),
        Analytic(
            "cosine",
            lambda u: 1 + np.cos(np.pi * u),
            lambda u: -np.pi * np.sin(np.pi * u),
            lambda u: -(np.pi**2) * np.cos(np.pi * u),
            1.0,
            lambda dim: {1: Rational(1, 2), 2: pi / (pi**2 - 4), 3: 3 * pi / (4 * pi**2 - 24)}[dim],
            "Hann window; elementary integral",
        ),
    )
}
