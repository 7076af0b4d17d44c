"""Pairing: the neighbours up to which a kernel holds particles apart in a fluid under pressure.

A kernel whose Fourier transform is nowhere negative does so with any number of neighbours (Dehnen &
Aly 2012, doi:10.1111/j.1365-2966.2012.21439.x): Wendland's are made so. Where the transform changes
sign, a longitudinal wave of the densest lattice loses its restoring force at some number of
neighbours, and from there on particles close up in pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.transform import transform
from sphtrunc.operators.forces import FORCES, GRAD_H, PLAIN
from sphtrunc.study.stability import NEIGHBOURS, in_spacings, lowest, named, ratio_of, root
from sphtrunc.theory.dispersion.brillouin import grid
from sphtrunc.theory.dispersion.lattice_waves import Scan
from sphtrunc.theory.dispersion.modes import LONGITUDINAL, Rest

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

DENSEST = {1: "uniform", 2: "hexagonal", 3: "fcc"}
MOST_NEIGHBOURS = 1000.0  # that `pairing` looks at
GAS = Fraction(3, 5)  # P₀/(ρc²) of a monatomic gas
NEGATIVE = -1e-13  # ten times what the transform is good to
LOBES = 12  # of the transform, in which its sign is looked at: it decays from one to the next


@dataclass(frozen=True)
class Pairing:
    """The first number of neighbours at which the longitudinal branch fails under pressure, and
    where in the zone; neighbours None where it does not up to `most`, the least that was looked at
    where it always does."""

    neighbours: float | None
    dx_over_h: float | None
    k: tuple[float, ...] | None
    point: str | None
    most: float


def pairing(rest: Rest, most: float = MOST_NEIGHBOURS, divisions: int = 0) -> Pairing:
    """The pairing limit of a kernel on a lattice: neighbours are added until a longitudinal mode
    of the zone loses its restoring force.

    Where S(k) = 0, as at the points of symmetry, this depends on the kernel and the lattice alone.
    The limit is good to the digits of the sums at a point of the grid of the zone, which has all
    points of symmetry; between its points modes that are part longitudinal, part a shear may fail
    some percent earlier. Windows of neighbours that are narrower than a step, a 60th of a factor e,
    are found where a wave of the grid dips towards them.

    divisions: of the grid, as for `brillouin.grid`

    Raises ValueError unless p > 0, and for forms whose modes have no stiffness to lose.
    """
    if rest.pressure <= 0:
        raise ValueError(
            f"pairing: got p = {rest.pressure}, expected a pressure: under tension particles clump"
            " at any number of neighbours"
        )
    if rest.zero_modes() or (rest.force.gradient not in (PLAIN, GRAD_H) and not rest.force.rate):
        raise ValueError(
            f"pairing: in the form {rest.force.name} the pressure holds no particles apart, so that"
            " no number of neighbours is the first; expected symmetric, grad-h or csph-symmetric"
        )
    fewest = NEIGHBOURS[rest.dim][0]
    reach = float(rest.kernel.support) / ratio_of(rest.kernel, rest.dim, most)
    scan = rest.scan(grid(rest.kind, divisions), reach)

    def branch(count: float, waves: Scan = scan) -> tuple[Array, float]:
        """ω² of all waves, and what rounding did to it."""
        at = replace(rest, ratio=Fraction(ratio_of(rest.kernel, rest.dim, count)))
        seen = at.frequencies(waves)
        return lowest(seen, LONGITUDINAL), seen.rounding

    def lowest_of(wave: int, before: float, after: float) -> tuple[float, float]:
        """Where ω² of one wave is least between two numbers, and that."""
        one = scan.of(scan.kappa[wave : wave + 1])
        n = _lowest_between(lambda n: float(branch(n, one)[0][0]), before, after)
        return n, float(branch(n, one)[0][0])

    def edge(before: float, count: float) -> Pairing:
        """Where the weakest wave fails between two numbers."""
        n = root(lambda n: float(branch(n)[0].min()), (before, count))
        return found(n, int(branch(n)[0].argmin()))

    def found(count: float, worst: int) -> Pairing:
        kappa = scan.kappa[worst]
        ratio = ratio_of(rest.kernel, rest.dim, count)
        k = in_spacings(rest.kind, kappa)
        return Pairing(count, ratio, k, named(rest.kind, kappa), most)

    steps = [float(n) for n in np.geomspace(fewest, most, int(60 * np.log(most / fewest)) + 2)]
    rows: list[Array] = []
    stable, never = False, True
    for i, count in enumerate(steps):
        values, rounding = branch(count)
        rows.append(values)
        for wave in _dips(rows[-3:]) if stable else ():
            n, value = lowest_of(wave, steps[i - 2], count)
            if value < -rounding:
                return edge(steps[i - 2], n)
        if stable and values.min() < -rounding:
            return edge(steps[i - 1], count)
        stable |= bool(values.min() > rounding)
        never &= bool(values.min() < -rounding)
    return (
        found(steps[0], int(rows[0].argmin())) if never else Pairing(None, None, None, None, most)
    )


def _dips(rows: Sequence[Array]) -> list[int]:
    """The waves whose least value lies between three steps and may be below zero: by the parabola
    through them, twice as deep."""
    if len(rows) < 3:
        return []
    before, here, after = rows
    bend, slope = before - 2 * here + after, (after - before) / 2
    dips = (here > 0) & (here <= np.minimum(before, after)) & (bend > 0)
    depth = slope**2 / np.where(dips, 2 * bend, 1.0)
    return [int(wave) for wave in np.flatnonzero(dips & (here < 2 * depth + bend / 8))]


def _lowest_between(function: Callable[[float], float], a: float, b: float) -> float:
    """Where a function with one valley is least, to 1e-6 of the interval (golden section)."""
    part = (sqrt(5) - 1) / 2
    width = b - a
    c, d = b - part * (b - a), a + part * (b - a)
    fc, fd = function(c), function(d)
    while b - a > 1e-6 * width:
        if fc < fd:
            b, d, fd = d, c, fc
            c = b - part * (b - a)
            fc = function(c)
        else:
            a, c, fc = c, d, fd
            d = a + part * (b - a)
            fd = function(d)
    return c if fc < fd else d


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
