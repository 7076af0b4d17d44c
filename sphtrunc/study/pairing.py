"""Pairing: the neighbours up to which a kernel holds particles apart in a fluid under pressure.

A kernel whose Fourier transform is nowhere negative does so with any number of neighbours (Dehnen &
Aly 2012, doi:10.1111/j.1365-2966.2012.21439.x): Wendland's are made so. Where the transform changes
sign, a longitudinal wave of the densest lattice loses its restoring force at some number of
neighbours, and from there on particles close up in pairs.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import pi

import numpy as np

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.transform import transform
from sphtrunc.operators.forces import FORCES
from sphtrunc.study.stability import pairing
from sphtrunc.theory.dispersion.modes import Rest

DENSEST = {1: "uniform", 2: "hexagonal", 3: "fcc"}
GAS = Fraction(3, 5)  # P₀/(ρc²) of a monatomic gas
NEGATIVE = -1e-13  # ten times what the transform is good to
LOBES = 12  # of the transform, in which its sign is looked at: it decays from one to the next


def sign_change(kernel: Kernel, dim: int) -> float | None:
    """The least kh at which the Fourier transform of the kernel is negative, None where it is not,
    to a twentieth of a lobe."""
    k = np.arange(1, 20 * LOBES) * pi / (10 * float(kernel.support))
    below = k[transform(kernel, k, dim) < NEGATIVE]
    return float(below[0]) if below.size else None


@lru_cache(maxsize=64)
def pairing_limit(kernel: Kernel, dim: int) -> float | None:
    """The number of neighbours from which particles on the densest lattice pair, in the symmetric
    form, as `pairing` finds it; None where they do not up to a thousand."""
    if sign_change(kernel, dim) is None:
        return None
    rest = Rest(kernel, DENSEST[dim], Fraction(1, 2), FORCES["symmetric"], GAS)
    return pairing(rest).neighbours
