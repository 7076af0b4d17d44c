"""Lattices as integer points: which points, and the length of the unit along each axis.

Every lattice here, turned the right way, is the set of integer points m that satisfy a congruence,
stretched by one unit per axis. The units are roots of rationals such that the volume per particle
is 1: the spacing Δx is defined by Δx^d = volume per particle, for every lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import lcm
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

Rule = Callable[["Indices"], Any]  # integer points (d, …) -> whether each is a site

MOST_SITES = 2**23  # of one stencil; 3D at Δx/h = 0.02 and κ = 2 has half of that
_BITS = 256  # of an irrational unit


@dataclass(frozen=True)
class Kind:
    """units: (p, q, n) for (p/q)^(1/n) along each axis; primitive: index step -> integer point;
    nearest: integer steps to the nearest neighbours, empty where they differ from site to site;
    turned: whether a site belongs to the second sublattice, from which the lattice is the mirror
        image s → −s; None where all sites see the same
    """

    dim: int
    units: tuple[tuple[int, int, int], ...]
    contains: Rule
    primitive: tuple[tuple[int, ...], ...]
    nearest: tuple[tuple[int, ...], ...]
    turned: Rule | None = None


def _everywhere(m: Indices) -> NDArray[np.bool_]:
    import numpy as np

    return np.ones(m.shape[1:], dtype=bool)


def _even_sum(m: Indices) -> NDArray[np.bool_]:
    even: NDArray[np.bool_] = m.sum(axis=0) % 2 == 0
    return even


def _same_parity(m: Indices) -> NDArray[np.bool_]:
    same: NDArray[np.bool_] = ((m[0] - m[1]) % 2 == 0) & ((m[0] - m[2]) % 2 == 0)
    return same


def _stacked(m: Indices) -> NDArray[np.bool_]:
    """Close-packed layers A B A B …: layer z is odd for B, which is shifted by (1, 1)."""
    layer = m[2] % 2
    row = m[1] - layer
    stacked: NDArray[np.bool_] = (row % 3 == 0) & ((m[0] - layer - row // 3) % 2 == 0)
    return stacked


def _signs(*steps: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Each step and its opposite."""
    return tuple(s for step in steps for s in (step, tuple(-c for c in step)))


KINDS: dict[str, Kind] = {
    "uniform": Kind(1, ((1, 1, 1),), _everywhere, ((1,),), _signs((1,))),
    "square": Kind(2, ((1, 1, 1),) * 2, _everywhere, ((1, 0), (0, 1)), _signs((1, 0), (0, 1))),
    "hexagonal": Kind(
        2, ((1, 12, 4), (3, 4, 4)), _even_sum, ((2, 0), (1, 1)), _signs((2, 0), (1, 1), (1, -1))
    ),
    "cubic": Kind(
        3,
        ((1, 1, 1),) * 3,
        _everywhere,
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        _signs((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ),
    "bcc": Kind(
        3,
        ((1, 4, 3),) * 3,
        _same_parity,
        ((-1, 1, 1), (1, -1, 1), (1, 1, -1)),
        _signs((1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)),
    ),
    "fcc": Kind(
        3,
        ((1, 2, 3),) * 3,
        _even_sum,
        ((0, 1, 1), (1, 0, 1), (1, 1, 0)),
        _signs((0, 1, 1), (1, 0, 1), (1, 1, 0), (0, 1, -1), (1, 0, -1), (1, -1, 0)),
    ),
    # two particles in the cell: indices step through the A layers only
    "hcp": Kind(
        3,
        ((1, 32, 6), (1, 864, 6), (16, 27, 6)),
        _stacked,
        ((2, 0, 0), (1, 3, 0), (0, 0, 2)),
        (),
        lambda m: m[2] % 2 == 1,
    ),
}
DEFAULT = {1: "uniform", 2: "square", 3: "cubic"}
VOLUMES = ("constant", "cell", "summation")


def lattice_of(dim: int, kind: str | None, volume: str = "constant") -> str:
    """The lattice of that name, by default the simplest of its dimension.

    Raises ValueError for one of another dimension, and for volumes that it cannot have.
    """
    names = [name for name, data in KINDS.items() if data.dim == dim]
    if kind is not None and kind not in names:
        raise ValueError(f"lattice: got {kind!r}, expected one of {', '.join(names)} in {dim}D")
    if volume not in VOLUMES or (volume == "cell" and dim > 1):
        raise ValueError(f"volume: got {volume!r}, expected constant, summation or, in 1D, cell")
    return DEFAULT[dim] if kind is None else kind


def in_pairs(kind: str, offset: Sequence[Any]) -> bool:
    """For every particle at s there is one at −s: all sites alike, seen from one of them."""
    return bool(KINDS[kind].nearest) and not any(offset)


def units(kind: str) -> tuple[Fraction, ...]:
    """The unit along each axis for Δx = 1: exact where rational, to 256 bits otherwise."""
    return tuple(_root(*u) for u in KINDS[kind].units)


@lru_cache(maxsize=64)
def _root(p: int, q: int, n: int) -> Fraction:
    """(p/q)^(1/n), by Newton's iteration on integers."""
    if n == 1:
        return Fraction(p, q)
    target = (p << (n * _BITS)) // q
    x = 1 << (target.bit_length() // n + 1)
    while True:
        y = ((n - 1) * x + target // x ** (n - 1)) // n
        if y >= x:
            return Fraction(x, 1 << _BITS)
        x = y


def sites(
    kind: str, reach: float, offset: tuple[Fraction, ...], slack: float = 0.0, what: str = ""
) -> Indices:
    """Integer points m, (d, N), whose position m·unit + offset lies within `reach` of the origin
    after moving by at most `slack` along each axis (lengths in Δx). In lexicographic order.

    Raises ValueError where there are more than MOST_SITES.
    """
    import numpy as np

    lattice = KINDS[kind]
    scale = [float(u) for u in units(kind)]
    shift = [float(o) for o in offset]
    grown = (reach + slack) * (1.0 + 1e-12)
    low = [int(-((grown + o) // u)) - 1 for u, o in zip(scale, shift, strict=True)]
    high = [int((grown - o) // u) + 1 for u, o in zip(scale, shift, strict=True)]
    count = 1.0
    for a, b in zip(low, high, strict=True):
        count *= max(0, b - a + 1)
    if not count <= 16 * MOST_SITES:
        raise ValueError(
            f"dx_over_h: a target would have about {count:.1e} neighbours, at most "
            f"{MOST_SITES} are allowed; take a larger Δx/h{what}"
        )
    axes = [np.arange(a, b + 1, dtype=np.int64) for a, b in zip(low, high, strict=True)]
    distance: Any = 0.0  # of the nearest place that the particle can move to
    for axis, (m, u, o) in enumerate(zip(axes, scale, shift, strict=True)):
        shape = [1] * lattice.dim
        shape[axis] = -1
        distance = distance + (np.maximum(np.abs(m * u + o) - slack, 0.0) ** 2).reshape(shape)
    near = distance <= (reach * (1.0 + 1e-12)) ** 2
    found = np.stack([m[i] for m, i in zip(axes, np.nonzero(near), strict=True)], axis=0)
    found = found[:, lattice.contains(found)]
    if found.shape[1] > MOST_SITES:
        raise ValueError(
            f"dx_over_h: a target would have {found.shape[1]} neighbours, at most "
            f"{MOST_SITES} are allowed; take a larger Δx/h{what}"
        )
    return np.ascontiguousarray(found)


def metric(roots: Sequence[tuple[int, int, int]]) -> tuple[int, ...]:
    """Integers in the ratio of the squared units, which are (p/q)^(2/n)."""
    p0, q0, _ = roots[0]
    ratios = []
    for p, q, n in roots:
        square = Fraction(p * q0, q * p0)  # (u_i/u_0)^n
        if n == 1:
            ratios.append(square**2)
            continue
        top, bottom = (_whole_root(v**2, n) for v in (square.numerator, square.denominator))
        ratios.append(Fraction(top, bottom))
    bottom = lcm(*(r.denominator for r in ratios))
    return tuple(int(r * bottom) for r in ratios)


def _whole_root(value: int, n: int) -> int:
    """The whole n-th root of a whole number that has one."""
    root: int = round(value ** (1 / n))
    if root**n != value:
        raise ValueError("lattice: the ratios of its squared units are not rational")
    return root
