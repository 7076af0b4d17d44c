"""The Brillouin zone: which plane waves of displacements a lattice tells apart.

A wavevector is written κ, one number per axis, for k_i = π κ_i/u_i with the unit u_i of
`sphtrunc.scenes.sites` along that axis, so that the phase of an integer point m is π Σ κ_i m_i:
rational turns for every rational κ, on every lattice. Waves that differ by a reciprocal vector are
the same displacement, so κ is taken as short as it can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import product
from math import pi
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.elimination import eliminate
from sphtrunc.scenes.sites import KINDS, units

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Kappa = tuple[Fraction, ...]

#: divisions of each primitive reciprocal vector in a scan: all named points are among them
DIVISIONS = {1: 360, 2: 48, 3: 24}
_HEXAGONAL = ("hexagonal", "hcp")

_THIRD, _HALF, _QUARTER = Fraction(1, 3), Fraction(1, 2), Fraction(1, 4)

#: the points of the zone that have a name (Bradley & Cracknell 1972), as κ
POINTS: dict[str, dict[str, tuple[Any, ...]]] = {
    "uniform": {"X": (1,)},
    "square": {"X": (1, 0), "M": (1, 1)},
    "hexagonal": {"K": (2 * _THIRD, 0), "M": (0, 1)},
    "cubic": {"X": (1, 0, 0), "M": (1, 1, 0), "R": (1, 1, 1)},
    "bcc": {"H": (0, 0, 1), "N": (_HALF, _HALF, 0), "P": (_HALF, _HALF, _HALF)},
    "fcc": {
        "X": (1, 0, 0),
        "L": (_HALF, _HALF, _HALF),
        "W": (1, _HALF, 0),
        "K": (3 * _QUARTER, 3 * _QUARTER, 0),
        "U": (1, _QUARTER, _QUARTER),
    },
    "hcp": {
        "K": (2 * _THIRD, 0, 0),
        "M": (0, _THIRD, 0),
        "A": (0, 0, _HALF),
        "L": (0, _THIRD, _HALF),
        "H": (2 * _THIRD, 0, _HALF),
    },
}


def point(kind: str, name: str) -> Kappa:
    """κ of a named point; ValueError with the names there are otherwise."""
    known = POINTS[kind]
    if name not in known:
        raise ValueError(
            f"k: the zone of the lattice {kind} has no point {name!r}, expected one of"
            f" {', '.join(known)} or numbers in π/Δx"
        )
    return tuple(Fraction(c) for c in known[name])


@lru_cache(maxsize=16)
def reciprocal(kind: str) -> tuple[Kappa, ...]:
    """The primitive reciprocal vectors, exactly: rows b_i with b_i·a_j = 2π δ_ij."""
    steps = [[Fraction(c) for c in row] for row in KINDS[kind].primitive]
    dim = len(steps)
    unit = [[Fraction(2 * (i == j)) for j in range(dim)] for i in range(dim)]
    columns = eliminate(steps, unit)  # b_i is column i
    return tuple(tuple(columns[axis][i] for axis in range(dim)) for i in range(dim))


def scale(kind: str) -> Array:
    """π/u_i, (d,): what takes κ to k in 1/Δx."""
    import numpy as np

    return np.array([pi / float(u) for u in units(kind)])


def shortest(kind: str, kappa: Array) -> Array:
    """The shortest wavevectors, (K, d), that are the same waves as these."""
    import numpy as np

    b = np.array([[float(c) for c in row] for row in reciprocal(kind)])
    dim = len(b)
    steps = np.array(list(product((-1, 0, 1), repeat=dim))) @ b  # these bases are reduced
    length = scale(kind)
    turned = np.rint(kappa @ np.linalg.inv(b)) @ b
    moved = (kappa - turned)[:, None, :] + steps
    squares = ((moved * length) ** 2).sum(axis=-1)
    return np.asarray(moved[np.arange(len(kappa)), np.argmin(squares.round(9), axis=1)])


def inside(kind: str, kappa: Sequence[Fraction]) -> bool:
    """Whether no wavevector that is the same wave is shorter."""
    import numpy as np

    given = np.array([[float(c) for c in kappa]])
    length = scale(kind)
    best = shortest(kind, given)
    return bool(((given * length) ** 2).sum() <= ((best * length) ** 2).sum() * (1 + 1e-9))


@lru_cache(maxsize=32)
def grid(kind: str, divisions: int = 0) -> Array:
    """κ of a grid over the zone without k = 0, (K, d): one wave of those that mirrors, exchanges of
    axes on the square and the cubic lattices and turns by π/3 on hexagonal planes make equal."""
    import numpy as np

    dim = KINDS[kind].dim
    n = divisions or DIVISIONS[dim]
    b = np.array([[float(c) for c in row] for row in reciprocal(kind)])
    steps = np.array(list(product(range(n), repeat=dim)))[1:] / n
    points = np.abs(shortest(kind, steps @ b))
    if len(set(KINDS[kind].units)) == 1:
        points = np.sort(points, axis=1)[:, ::-1]
    if kind in _HEXAGONAL:
        points[:, :2] = _first_twelfth(points[:, :2] * scale(kind)[:2]) / scale(kind)[:2]
    # 3·1e6 keeps thirds apart from what rounding makes of them
    found = np.unique(np.rint(points * 3e6), axis=0) / 3e6
    return np.ascontiguousarray(found)


def _first_twelfth(k: Array) -> Array:
    """Wavevectors of a hexagonal plane in the first quadrant, (K, 2), turned and mirrored into the
    sector of π/6 from the first axis on."""
    import numpy as np

    size, angle = np.hypot(k[:, 0], k[:, 1]), np.arctan2(k[:, 1], k[:, 0])
    angle = np.abs(angle - pi / 3 * np.rint(angle / (pi / 3)))
    return np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1)


def directions(kind: str) -> Array:
    """Directions of long waves, (K, d), as κ of length π/Δx: along axes, diagonals and between."""
    import numpy as np

    dim = KINDS[kind].dim
    steps = np.array([s for s in product(range(5), repeat=dim) if any(s)], dtype=float)
    steps /= np.sqrt((steps**2).sum(axis=1))[:, None]
    if len(set(KINDS[kind].units)) == 1:
        steps = np.sort(steps, axis=1)[:, ::-1]
    return np.asarray(np.unique(steps.round(12), axis=0) * pi / scale(kind))


def halves(kind: str) -> list[Kappa]:
    """Every κ ≠ 0 with 2κ a reciprocal vector: waves that only change sign from site to site."""
    b = reciprocal(kind)
    found = []
    for picks in product((0, 1), repeat=len(b)):
        if any(picks):
            kappa = _moved((Fraction(0),) * len(b), picks, b)
            found.append(_short(kind, tuple(c / 2 for c in kappa)))
    return found


def _moved(kappa: Kappa, picks: Sequence[int], b: Sequence[Kappa]) -> Kappa:
    """κ + Σ n_i b_i."""
    for n, row in zip(picks, b, strict=True):
        kappa = tuple(c + n * r for c, r in zip(kappa, row, strict=True))
    return kappa


def _short(kind: str, kappa: Kappa) -> Kappa:
    """The shortest of the same wave, exactly, with as few minus signs as there can be."""
    b = reciprocal(kind)
    squares = [Fraction(s * s).limit_denominator(10**9) for s in scale(kind) / scale(kind)[0]]

    def length(k: Kappa) -> tuple[Fraction, int, Kappa]:
        size = sum((c * c * s for c, s in zip(k, squares, strict=True)), Fraction(0))
        return size, sum(c < 0 for c in k), tuple(-c for c in k)

    same = (_moved(kappa, picks, b) for picks in product((-1, 0, 1), repeat=len(b)))
    return min(same, key=length)
