"""Scenes: which particles there are. A scene is a rule; only what the targets need is made.

Rules are dimensionless: offsets s = (x_b − x_a)/h from the target, volumes V_b/h^d. Positions are
never absolute: on lattices an offset is the difference of the indices plus the difference of two
displacements, so no digit is lost however large the scene is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.arithmetic.plain import PLAIN
from sphtrunc.arithmetic.rational import exact, fraction
from sphtrunc.arithmetic.summation import Array, dd_from_ratio
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.neighbourhood import Beside, Ghosts, summed, wanted
from sphtrunc.scenes.neighbourhood import Indices as Indices
from sphtrunc.scenes.neighbourhood import Neighbourhood as Neighbourhood
from sphtrunc.scenes.random_numbers import MOST_INDICES as MOST_INDICES
from sphtrunc.scenes.sites import DEFAULT, lattice_of, sites, units
from sphtrunc.scenes.walls import PLACES, Wall

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


# ------------------------------------------------------------------------------------- lattices


@dataclass(frozen=True)
class Lattice(Arrangement):
    """An undisplaced lattice: one target stands for all. By `lattice` and `beside_wall`."""

    @property
    def population(self) -> int:
        """The number of different targets."""
        return 1

    def rows(self, kernel: Kernel) -> int:
        """The number of neighbours."""
        return int(_stencil(self, kernel).shape[1])

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        number: Any = PLAIN,
        *,
        reach: int = 1,
    ) -> Neighbourhood:
        """The stencil out to so many supports, (d, N, 1): exact numbers, rounded once."""
        if self.wall is not None:
            return _cut(self, self.wall, target, kernel, number, reach)
        m = _stencil(self, kernel, reach=reach)
        exactly = number.wide or number.bounded
        s, low = _positions(self, m, self.dx_over_h, exactly)
        volume, volume_low = dd_from_ratio(*(self.dx_over_h**self.dim).as_integer_ratio())
        hi, more = np.full((1, 1), volume), wanted(number, np.full((1, 1), volume_low))
        if self.volume == "summation":
            home = self.seen_from()
            sites = _stencil(home, kernel)
            around, after = _positions(home, sites, self.dx_over_h, exactly)
            there: list[Any] = [(s_i[:, None], None) for s_i in around]
            if after is not None:
                there = [
                    (a[:, None], wanted(number, b[:, None]))
                    for a, b in zip(around, after, strict=True)
                ]
            hi, more = summed(number, [(np.zeros((1, 1)), None)] * self.dim, there, kernel)
        return Neighbourhood(
            offset=s[:, :, None],
            volume=hi,
            target=target,
            beside=None if low is None else Beside(wanted(number, low[:, :, None]), more),
        )

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (d, N) and volumes (N,) as arrays of Fractions."""
        m = _stencil(self, kernel, reach=reach)
        offset = _exact_positions(self, m) * self.dx_over_h
        volume = np.full(m.shape[1], self.dx_over_h**self.dim, dtype=object)
        if self.wall is not None:
            if self.wall.ghosts != "none":
                raise ValueError("precision: exact sums have no ghosts; expected ghosts none")
            volume[_on_wall(self, m)] *= self.wall.share
        return offset, volume


# ---------------------------------------------------------------------------- how scenes are made


def lattice(
    dim: int = 1,
    kind: str | None = None,
    dx_over_h: object = "1/2",
    offset: object = 0,
    *,
    volume: str = "constant",
    extent: int | None = None,
) -> Lattice:
    """An endless lattice, seen from one of its particles or from `offset` beside it.

    kind: "uniform" (1D); "square", "hexagonal" (2D); "cubic", "bcc", "fcc", "hcp" (3D).
    dx_over_h: Δx/h, where Δx^d is the volume per particle, for every kind.
    offset: position of the lattice relative to the target in units of Δx, x_j = (j + θ)Δx in 1D;
        one number per axis. Together with Δx/h it is taken exactly: write Fractions or "10/13".
    volume: "constant" Δx^d, or "summation" 1/Σ W (the same for all particles of a lattice).
    extent: particles along each axis that a full scene would have: the targets of a jittered one,
        and the count of all pairs. Default: 10⁶, 10⁴, 10³ in 1, 2, 3 dimensions, so many that the
        neighbourhoods of a sample do not overlap, as confidence intervals suppose.

    Raises ValueError for what is out of range.
    """
    if dim not in DEFAULT:
        raise ValueError(f"dim: got {dim!r}, expected 1, 2 or 3")
    kind = lattice_of(dim, kind, volume)
    ratio = exact(dx_over_h, "dx_over_h")
    if not 0 < ratio <= 2**20 or ratio < Fraction(1, 2**40):
        raise ValueError(
            f"dx_over_h: got {float(ratio):g}, expected a positive ratio Δx/h such as 1/2"
        )
    values: Sequence[object]
    if isinstance(offset, (tuple, list, np.ndarray)):
        values = list(offset)
    else:
        values = [offset] if dim == 1 or exact(offset, "offset") else [0] * dim
    if len(values) != dim:
        raise ValueError(f"offset: got {len(values)} numbers, expected {dim}, one per axis")
    shift = tuple(exact(value, "offset") for value in values)
    if any(abs(s) > MOST_INDICES for s in shift):
        raise ValueError("offset: expected a few particle spacings at most")
    extent = {1: 10**6, 2: 10**4, 3: 10**3}[dim] if extent is None else extent
    _whole("extent", extent, 1, MOST_INDICES)
    return Lattice(kind, ratio, shift, volume, extent=int(extent))


def beside_wall(
    scene: Lattice,
    eta: object,
    *,
    at: object = None,
    ghosts: str = "none",
    weight: object = None,
) -> Lattice:
    """The lattice on one side of a plane wall, or of a free surface, normal to the first axis.

    eta: η, the distance of the target from the wall in h
    at: where the lattice has the wall: "particle", "half-way", or the steps of its planes from the
        wall to the first one; this decides the offset along the first axis. None: where the offset
        puts the wall.
    ghosts: beyond the wall "none"; "mirror" or "odd", images of the particles with the value A or
        2 A_wall − A of their original; "dummy", the lattice continued, with Shepard means of the
        fluid
    weight: what part of a particle on the wall counts, 1/2 unless given

    Raises ValueError for what is out of range.
    """
    if scene.volume != "constant":
        raise ValueError(f"wall: got volumes {scene.volume}, expected constant ones beside a wall")
    if weight is not None and ghosts != "none":
        raise ValueError(
            f"wall-weight: with {ghosts} ghosts a particle on the wall counts once; expected none"
        )
    place = None if at is None else exact(PLACES.get(str(at), at), "wall-at")
    wall = Wall(exact(eta, "wall"), place, ghosts, exact(weight or "1/2", "wall-weight"))
    return scene.beside(wall)


# --------------------------------------------------------------------------------------- the parts


def _on_wall(lattice: Arrangement, m: Indices) -> NDArray[np.bool_]:
    phase = lattice.wall_phase
    on: NDArray[np.bool_] = m[0] == -phase if phase.denominator == 1 else np.zeros(m.shape[1], bool)
    return on


def _cut(
    lattice: Lattice,
    wall: Wall,
    target: Indices,
    kernel: Kernel,
    number: Any,
    reach: int,
) -> Neighbourhood:
    """The stencil on the fluid's side of a wall, (d, N, 1), and behind it the ghosts."""
    lattice.require_seen(fraction(kernel.support))
    m = _stencil(lattice, kernel, reach=reach)
    wide, edge = number.wide or number.bounded, -lattice.wall_phase
    here = _positions(lattice, m, lattice.dx_over_h, wide)
    parts, images, on_wall = [here], [here], [_on_wall(lattice, m)]
    mirrored = wall.ghosts in ("mirror", "odd")
    shift = 2 * wall.eta / lattice.dx_over_h if mirrored else Fraction(0)
    there = lattice.seen_from((lattice.offset[0] + shift, *lattice.offset[1:]))
    radius = reach * float(kernel.support) / float(lattice.dx_over_h)
    others = _cached_sites(lattice.kind, radius, there.offset, 0.0)
    others = others[:, others[0] >= edge if mirrored else others[0] < edge]
    if wall.ghosts != "none" and others.size:
        s, low = _positions(there, others, lattice.dx_over_h, wide)
        on_wall.append(_on_wall(lattice, others))
        if mirrored:  # originals, as the image of the target sees them
            images.append(_positions(lattice, others, lattice.dx_over_h, wide))
            s[0] *= -1.0
            if low is not None:
                low[0] *= -1.0
        parts.append((s, low))
    s, low = _joined(parts)
    cell = lattice.dx_over_h**lattice.dim
    volumes = np.array([dd_from_ratio(*v.as_integer_ratio()) for v in (cell, cell * wall.share)])
    volume, volume_low = volumes[np.concatenate(on_wall).astype(np.intp)].T[:, :, None]
    ghosts = None
    if len(parts) > 1:
        ghosts = Ghosts(
            kind=wall.ghosts,
            rows=(np.arange(s.shape[1]) >= m.shape[1])[:, None],
            wall=dd_from_ratio(*(-wall.eta).as_integer_ratio()),
        )
        if mirrored:
            image, below = _joined(images)
            ghosts = replace(
                ghosts,
                image=image[0][:, None],
                beside=None if below is None else wanted(number, below[0][:, None]),
            )
    return Neighbourhood(
        offset=s[:, :, None],
        volume=volume,
        target=target,
        beside=None
        if low is None
        else Beside(wanted(number, low[:, :, None]), wanted(number, volume_low)),
        ghosts=ghosts,
    )


def _joined(parts: Sequence[tuple[Array, Array | None]]) -> tuple[Array, Array | None]:
    """Positions side by side, and their rests where there are any."""
    low = [rest for _, rest in parts if rest is not None]
    rest = np.concatenate(low, axis=1) if low else None
    return np.concatenate([s for s, _ in parts], axis=1), rest


def _whole(name: str, value: object, low: int, high: int) -> None:
    if (
        not isinstance(value, (int, np.integer))
        or isinstance(value, bool)
        or not (low <= value <= high)
    ):
        raise ValueError(f"{name}: got {value!r}, expected a whole number from {low} to {high}")


def _stencil(
    lattice: Arrangement, kernel: Kernel, slack: float = 0.0, margin: float = 0.0, reach: int = 1
) -> Indices:
    """Sites that may come within reach·κh (+ margin·Δx) of the target, (d, N)."""
    radius = reach * float(kernel.support) / float(lattice.dx_over_h) + margin
    found = _cached_sites(lattice.kind, radius, lattice.offset, slack)
    if lattice.wall is not None:
        found = found[:, found[0] >= -lattice.wall_phase]
    if not slack and not _any_inside(lattice, found, fraction(kernel.support)):
        raise ValueError(
            f"dx_over_h: at Δx/h = {float(lattice.dx_over_h):g} no neighbour lies within the"
            f" support of {float(kernel.support):g} h; did you mean h/Δx?"
        )
    return found


def _any_inside(lattice: Arrangement, m: Indices, support: Fraction) -> bool:
    """At least one particle, not at the target, strictly inside the support."""
    place = _positions(lattice, m, lattice.dx_over_h)[0]
    square = (place * place).sum(axis=0) / float(support) ** 2
    if np.any((square > 1e-9) & (square < 1 - 1e-9)):  # far beyond rounding
        return True
    position = _exact_positions(lattice, m) * lattice.dx_over_h
    return any(0 < r2 < support**2 for r2 in (position * position).sum(axis=0))


@lru_cache(maxsize=16)
def _cached_sites(kind: str, radius: float, offset: tuple[Fraction, ...], slack: float) -> Indices:
    return sites(kind, radius, offset, slack)


def _positions(
    lattice: Arrangement, m: Indices, scale: Fraction, extended: bool = False
) -> tuple[Array, Array | None]:
    """(m·unit + offset)·scale along each axis, (d, N), correctly rounded; with the rest if asked
    for. Each is a ratio of integers, found once per coordinate and axis."""
    high, low = [], []
    for row, unit, offset in zip(m, units(lattice.kind), lattice.offset, strict=True):
        slope, start = unit * scale, offset * scale
        bottom = slope.denominator * start.denominator
        a, b = slope.numerator * start.denominator, start.numerator * slope.denominator
        first, last = int(row.min()), int(row.max())
        most = max(abs(first), abs(last)) * abs(a) + abs(b)
        if most < 2**53 and bottom < 2**53 and not extended:
            high.append((row * a + b) / float(bottom))
            continue
        values = [dd_from_ratio(k * a + b, bottom) for k in range(first, last + 1)]
        table = np.array(values)
        high.append(table[row - first, 0])
        low.append(table[row - first, 1])
    return np.stack(high), np.stack(low) if extended else None


def _exact_positions(lattice: Arrangement, m: Indices) -> NDArray[Any]:
    """m·unit + offset, (d, N), as Fractions (irrational units to 256 bits)."""
    return np.array(
        [
            [int(k) * unit + offset for k in row]
            for row, unit, offset in zip(m, units(lattice.kind), lattice.offset, strict=True)
        ],
        dtype=object,
    )
