"""Scenes: which particles there are. A scene is a rule; only what the targets need is made.

Rules are dimensionless: offsets s = (x_b − x_a)/h from the target, volumes V_b/h^d. Positions are
never absolute: on lattices an offset is the difference of the indices plus the difference of two
displacements, so no digit is lost however large the scene is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from numbers import Rational
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sphtrunc import jitter
from sphtrunc.graded import Graded
from sphtrunc.jitter import MOST_INDICES as MOST_INDICES
from sphtrunc.lattice import DEFAULT, KINDS, in_pairs, sites, units
from sphtrunc.neighbourhood import EDGE, arithmetic_for, assemble, fraction, fractions, summed
from sphtrunc.neighbourhood import Indices as Indices
from sphtrunc.neighbourhood import Neighbourhood as Neighbourhood
from sphtrunc.summation import (
    Array,
    dd_add,
    dd_from_ratio,
    dd_mul,
    two_sum,
)

if TYPE_CHECKING:
    from sphtrunc.kernel import Kernel
    from sphtrunc.particles import Particles

Scene: TypeAlias = "Lattice | Jittered | Graded | Particles"

VOLUMES = ("constant", "cell", "summation")


#: a fraction, or a decimal with an exponent of at most three digits: a longer one fills the memory
_NUMBER = re.compile(r"\s*[+-]?(\d+/\d+|(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?)\s*\Z", re.ASCII)


def exact(value: object, name: str) -> Fraction:
    """The rational that a number or a text such as "10/13", "0.7" or "1e-8" says; a float is what
    it is.

    Raises ValueError for anything else, NaN and infinities included.
    """
    if isinstance(value, (np.floating, np.integer)):
        value = value.item()
    text_fits = not isinstance(value, str) or (len(value) <= 200 and bool(_NUMBER.match(value)))
    if isinstance(value, (str, Rational, float)) and not isinstance(value, bool) and text_fits:
        try:
            found = Fraction(value)
            float(found)
            return found
        except (ValueError, ZeroDivisionError, OverflowError):
            pass
    raise ValueError(f'{name}: got {str(value)[:60]!r}, expected a number such as 0.7 or "10/13"')


# ------------------------------------------------------------------------------------- lattices


@dataclass(frozen=True)
class Lattice:
    """An undisplaced lattice: one target stands for all. Made by `lattice`."""

    kind: str
    dx_over_h: Fraction
    offset: tuple[Fraction, ...]
    volume: str
    extent: int

    @property
    def dim(self) -> int:
        """d."""
        return KINDS[self.kind].dim

    @property
    def population(self) -> int:
        """The number of different targets."""
        return 1

    @property
    def particles(self) -> int:
        """The number of particles of a scene of this extent."""
        return int(self.extent**self.dim)

    def rows(self, kernel: Kernel) -> int:
        """The number of neighbours."""
        return int(_stencil(self, kernel).shape[1])

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        *,
        extended: bool = False,
        errors: bool = False,
        reach: int = 1,
    ) -> Neighbourhood:
        """The stencil out to so many supports, (d, N, 1): exact numbers, rounded once."""
        m = _stencil(self, kernel, reach=reach)
        s, low = _positions(self, m, self.dx_over_h, extended or errors)
        rest = None if low is None else low[:, :, None]
        volume, volume_low = dd_from_ratio(*(self.dx_over_h**self.dim).as_integer_ratio())
        hi, lo = np.full((1, 1), volume), np.full((1, 1), volume_low)
        error: Array | None = np.abs(lo) * EDGE
        if self.volume == "summation":
            home = Lattice(self.kind, self.dx_over_h, (Fraction(0),) * self.dim, "constant", 1)
            sites = _stencil(home, kernel)
            around, after = _positions(home, sites, self.dx_over_h, extended or errors)
            there: list[Any] = [(s_i[:, None], None, None) for s_i in around]
            if after is not None:
                there = [
                    (a[:, None], b[:, None], np.abs(b[:, None]) * EDGE)
                    for a, b in zip(around, after, strict=True)
                ]
            origin = [(np.zeros((1, 1)), None, None)] * self.dim
            hi, lo = summed(arithmetic_for(extended, errors), origin, there, kernel)
            error = lo
        return Neighbourhood(
            offset=s[:, :, None],
            volume=hi,
            target=target,
            offset_low=rest if extended else None,
            volume_low=lo if extended else None,
            offset_error=np.abs(rest) * EDGE if errors and rest is not None else None,
            volume_error=error if errors else None,
        )

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (d, N) and volumes (N,) as arrays of Fractions."""
        m = _stencil(self, kernel, reach=reach)
        offset = _exact_positions(self, m) * self.dx_over_h
        return offset, np.full(m.shape[1], self.dx_over_h**self.dim, dtype=object)


@dataclass(frozen=True)
class Jittered:
    """A lattice whose particles are displaced at random: u, of standard deviation σ/Δx along each
    axis, is a pure function of (seed, lattice index). Made by `jittered`."""

    lattice: Lattice
    sigma: float
    distribution: str
    seed: int

    @property
    def dim(self) -> int:
        """d."""
        return self.lattice.dim

    @property
    def volume(self) -> str:
        """The rule for the volumes."""
        return self.lattice.volume

    @property
    def population(self) -> int:
        """The number of different targets: the particles of the scene."""
        return self.lattice.particles

    @property
    def particles(self) -> int:
        """The number of particles of the scene."""
        return self.lattice.particles

    @property
    def largest(self) -> float:
        """The largest displacement along one axis, in Δx."""
        most = self.sigma * jitter.largest(self.distribution) * EDGE
        if self.distribution == "blue":
            most *= 2.0 / (1.0 + 1.0 / len(KINDS[self.lattice.kind].nearest)) ** 0.5
        return most

    @property
    def target_moves(self) -> bool:
        """A target is a particle and moves with it, unless the lattice has an offset."""
        return not any(self.lattice.offset)

    def _sites(self, kernel: Kernel, reach: int = 1) -> Indices:
        slack = self.largest * (2.0 if self.target_moves else 1.0)
        margin = 1.0 + 3.0 * slack if self.volume == "cell" else 0.0
        reach += self.volume == "summation"
        return _stencil(self.lattice, kernel, slack, margin, reach)

    def rows(self, kernel: Kernel) -> int:
        """The number of candidates that are looked at for a target."""
        return int(self._sites(kernel).shape[1])

    def displacement(self, index: Indices) -> Array:
        """u, (d, …) in Δx, of the particles at integer points `index`, (d, …)."""
        return np.stack(list(self._displacement(jitter.place(index))))

    def _displacement(self, place: jitter.Bits) -> Iterator[Array]:
        """u along one axis after the other."""
        bits = jitter.noise(place, self.seed)
        if self.distribution != "blue":
            for axis in range(self.dim):
                u = jitter.component(bits, axis, self.distribution)
                u *= self.sigma
                yield u
            return
        # less the mean over the nearest neighbours: spectrum (1 − mean cos)², none at long waves
        steps = KINDS[self.lattice.kind].nearest
        scale = self.sigma / (1.0 + 1.0 / len(steps)) ** 0.5
        around = [
            jitter.noise(place + jitter.place(np.array(step, dtype=np.int64)), self.seed)
            for step in steps
        ]
        for axis in range(self.dim):
            u = jitter.component(around[0], axis, "blue")
            for other in around[1:]:
                u += jitter.component(other, axis, "blue")
            u *= -1.0 / len(steps)
            u += jitter.component(bits, axis, "blue")
            u *= scale
            yield u

    def origin(self, target: Indices) -> Indices:
        """Integer points (d, T) of the targets 0 … extent^d − 1."""
        rest, steps = target, []
        for _ in range(self.dim):
            rest, step = np.divmod(rest, self.lattice.extent)
            steps.append(step)
        primitive = np.array(KINDS[self.lattice.kind].primitive, dtype=np.int64)
        return np.asarray(primitive.T @ np.stack(steps))

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        *,
        extended: bool = False,
        errors: bool = False,
        reach: int = 1,
    ) -> Neighbourhood:
        """All particles within so many supports of the targets, (d, N, T), N the largest number."""
        m = self._sites(kernel, reach)
        base, base_low = _positions(self.lattice, m, Fraction(1), extended or errors)
        dx_over_h = dd_from_ratio(*self.lattice.dx_over_h.as_integer_ratio())
        origin = jitter.place(self.origin(target))
        place = jitter.place(m)[:, None] + origin
        own = list(self._displacement(origin))
        offset = np.empty((self.dim, *place.shape))
        low, error = [], []
        for axis, u in enumerate(self._displacement(place)):
            row, mine = base[axis][:, None], own[axis] if self.target_moves else 0.0 * own[axis]
            if base_low is not None:
                difference = two_sum(u, np.broadcast_to(-mine, u.shape))
                both = dd_add(difference, (row, base_low[axis][:, None]))
                fine = dd_mul(both, (np.array(dx_over_h[0]), np.array(dx_over_h[1])))
            u -= mine
            s = np.add(u, row, out=offset[axis])
            s *= dx_over_h[0]
            if extended:
                offset[axis], rest = fine
                low.append(rest)
            elif errors:  # what the rounded formula is off by
                gap = np.abs((fine[0] - s) + fine[1])
                error.append(gap * EDGE + 2.0**-84 * np.abs(s))
        volume = dd_from_ratio(*(self.lattice.dx_over_h**self.dim).as_integer_ratio())
        return assemble(self.volume, volume, offset, low, error, target, kernel, reach)

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (d, N) and volumes (N,) of one target as arrays of Fractions."""
        m = self._sites(kernel, reach)
        origin = self.origin(np.array([target]))
        moved = fractions(self.displacement(m + origin))
        if self.target_moves:
            moved -= fractions(self.displacement(origin))
        offset = (_exact_positions(self.lattice, m) + moved) * self.lattice.dx_over_h
        volume = np.full(m.shape[1], self.lattice.dx_over_h**self.dim, dtype=object)
        if self.volume == "cell":
            offset = np.sort(offset, axis=1)
            volume = (offset[0, 2:] - offset[0, :-2]) / 2
            offset = offset[:, 1:-1]
        near = (offset * offset).sum(axis=0) <= (reach * fraction(kernel.support)) ** 2
        return offset[:, near], volume[near]


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
    kind = DEFAULT[dim] if kind is None else kind
    names = [name for name, data in KINDS.items() if data.dim == dim]
    if kind not in names:
        raise ValueError(f"lattice: got {kind!r}, expected one of {', '.join(names)} in {dim}D")
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
    if volume not in VOLUMES or (volume == "cell" and dim > 1):
        raise ValueError(f"volume: got {volume!r}, expected constant, summation or, in 1D, cell")
    extent = {1: 10**6, 2: 10**4, 3: 10**3}[dim] if extent is None else extent
    _whole("extent", extent, 1, MOST_INDICES)
    return Lattice(kind, ratio, shift, volume, int(extent))


def jittered(
    lattice: Lattice, sigma: float, distribution: str = "gaussian", seed: int = 0
) -> Jittered:
    """The lattice with every particle displaced, the target too (unless it sits at an offset).

    sigma: standard deviation σ/Δx of the displacement along each axis.
    distribution: "gaussian", cut at four standard deviations and of unit variance all the same;
        "uniform", of equal standard deviation; "blue", v less the mean of v over the nearest
        lattice neighbours, v Gaussian: u_n = (v_n − mean v)/√(1 + 1/z), so that the spectrum is
        that of v times (1 − mean cos k·e)²/(1 + 1/z), z the number of neighbours.
    seed: 0 … 2⁶³ − 1.

    Raises ValueError for what is out of range.
    """
    value = float(exact(sigma, "jitter"))
    if not 0 <= value <= 10:
        raise ValueError(f"jitter: got {value:g}, expected a standard deviation σ/Δx from 0 to 10")
    if distribution not in jitter.DISTRIBUTIONS:
        raise ValueError(
            f"distribution: got {distribution!r}, expected one of {', '.join(jitter.DISTRIBUTIONS)}"
        )
    if distribution == "blue" and not KINDS[lattice.kind].nearest:
        raise ValueError(
            f"distribution: blue needs the same neighbours at every site, {lattice.kind} has two"
            " sorts; expected gaussian or uniform, or another lattice"
        )
    _whole("seed", seed, 0, 2**63 - 1)
    return Jittered(lattice, value, distribution, int(seed))


def graded(dx: Callable[[Array], Array], x: object = 0.0, offset: object = 0) -> Graded:
    """1D particles whose spacing varies smoothly: x(ξ) with dx/dξ = Δx(x), particles at whole
    numbers ξ + θ counted from the target, each in the cell between the midpoints to the next ones.

    dx: function from positions x/h (array) to spacings Δx/h (array of the same shape).
    x: positions of the targets in units of h, one number or many.
    offset: θ.

    Raises ValueError for what is out of range.
    """
    if not callable(dx):
        raise ValueError("dx: expected a function from positions to spacings")
    try:
        at = np.atleast_1d(np.asarray(x, dtype=np.float64))
    except (TypeError, ValueError):
        raise ValueError("x: expected the positions of the targets, numbers") from None
    if at.ndim != 1 or not at.size or not np.all(np.isfinite(at)):
        raise ValueError("x: expected one or more finite positions of targets")
    shift = exact(offset, "offset")
    if not abs(shift) <= 1:
        raise ValueError("offset: expected a number from -1 to 1")
    return Graded(dx, tuple(at.tolist()), shift)


def paired(scene: Scene) -> bool:
    """The neighbours of every target lie at ±s."""
    home = getattr(scene, "lattice", scene)
    still = not getattr(scene, "sigma", 0.0)
    return isinstance(home, Lattice) and still and in_pairs(home.kind, home.offset)


def sample(scene: Scene, first: int, last: int, seed: int) -> Indices:
    """Targets `first` … `last` − 1 of a random order of all targets of the scene."""
    return jitter.permuted(np.arange(first, last, dtype=np.int64), scene.population, seed)


# --------------------------------------------------------------------------------------- the parts


def _whole(name: str, value: object, low: int, high: int) -> None:
    if (
        not isinstance(value, (int, np.integer))
        or isinstance(value, bool)
        or not (low <= value <= high)
    ):
        raise ValueError(f"{name}: got {value!r}, expected a whole number from {low} to {high}")


def _stencil(
    lattice: Lattice, kernel: Kernel, slack: float = 0.0, margin: float = 0.0, reach: int = 1
) -> Indices:
    """Sites that may come within reach·κh (+ margin·Δx) of the target, (d, N)."""
    radius = reach * float(kernel.support) / float(lattice.dx_over_h) + margin
    found = _cached_sites(lattice.kind, radius, lattice.offset, slack)
    if not slack and not _any_inside(lattice, found, kernel):
        raise ValueError(
            f"dx_over_h: at Δx/h = {float(lattice.dx_over_h):g} no neighbour lies within the"
            f" support of {float(kernel.support):g} h; did you mean h/Δx?"
        )
    return found


def _any_inside(lattice: Lattice, m: Indices, kernel: Kernel) -> bool:
    """At least one particle, not at the target, strictly inside the support."""
    if m.shape[1] > 1000:
        return True
    position = _exact_positions(lattice, m) * lattice.dx_over_h
    square = (position * position).sum(axis=0)
    return any(0 < r2 < fraction(kernel.support) ** 2 for r2 in square)


@lru_cache(maxsize=16)
def _cached_sites(kind: str, radius: float, offset: tuple[Fraction, ...], slack: float) -> Indices:
    return sites(kind, radius, offset, slack)


def _positions(
    lattice: Lattice, m: Indices, scale: Fraction, extended: bool = False
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


def _exact_positions(lattice: Lattice, m: Indices) -> NDArray[Any]:
    """m·unit + offset, (d, N), as Fractions (irrational units to 256 bits)."""
    return np.array(
        [
            [int(k) * unit + offset for k in row]
            for row, unit, offset in zip(m, units(lattice.kind), lattice.offset, strict=True)
        ],
        dtype=object,
    )
