"""Explicit particles: arrays somebody has, free or periodic, one h for all or an h for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.arithmetic.plain import PLAIN
from sphtrunc.arithmetic.precision import for_volumes
from sphtrunc.arithmetic.rational import fraction, fractions
from sphtrunc.arithmetic.summation import (
    TINY,
    UNIT,
    Array,
    dd,
    dd_add,
    dd_div,
    two_product,
    two_sum,
)
from sphtrunc.kernels.values import kernel_values
from sphtrunc.operators.h_rules import RULES
from sphtrunc.scenes.neighbourhood import EDGE, Beside, Indices, Neighbourhood

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

_PLAIN = 128  # 2^±128: cubes of such lengths are far from the ends of the range


@dataclass(frozen=True, eq=False)
class Particles:
    """Particles at given positions. Made by `particles`.

    x: (d, n); h: (n,); values of volume (n,) in units of length^d, or None for `rule`
    period: (d,) sides of the box, infinite along axes that are open; None where all are
    walls: (n,) particles that are sources and no targets, boundaries of a file; None: no such
    fields: values that came with the particles, by name, (n,) or (c, n)
    """

    x: Array
    h: Array
    given: Array | None
    volume: str
    period: Array | None
    mass: Array
    mode: str
    one_h: bool  # h_ab = h_a for every pair
    walls: NDArray[np.bool_] | None = None
    fields: Mapping[str, Array] = field(default_factory=dict)
    _trees: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def dim(self) -> int:
        """d."""
        return int(self.x.shape[0])

    @property
    def population(self) -> int:
        """The number of targets: the particles."""
        return int(self.x.shape[1])

    @property
    def particles(self) -> int:
        """The number of particles."""
        return self.population

    def in_plain_units(self) -> Particles:
        """The same particles in a unit, a power of two, in which h is about 1, if h is so small or
        so large that squares would leave the range of floats: sums in units of h are the same."""
        exponent = int(np.frexp(float(self.h.max()))[1])
        if abs(exponent) < _PLAIN:
            return self

        def scaled(values: Array | None, power: int = 1) -> Array | None:
            if values is None:
                return None
            for _ in range(power):
                values = np.ldexp(values, -exponent)
            return values

        return replace(
            self,
            x=np.ldexp(self.x, -exponent),
            h=np.ldexp(self.h, -exponent),
            given=scaled(self.given, self.dim),
            period=scaled(self.period),
            _trees={},
        )

    def rows(self, kernel: Kernel) -> int:
        """The number of neighbours of a typical target, from a small sample."""
        some = np.linspace(0, self.population - 1, min(64, self.population)).astype(np.int64)
        return max(8, *(len(n) for n in self._neighbours(some, kernel)))

    def _tree(self) -> Any:
        if "tree" not in self._trees:
            from scipy.spatial import cKDTree

            box = None  # a side of 0 is an open one
            if self.period is not None:
                box = np.where(np.isfinite(self.period), self.period, 0.0) * self._unit
            self._trees["tree"] = cKDTree(self._wrapped(self.x), boxsize=box)
        return self._trees["tree"]

    @property
    def _unit(self) -> float:
        """A power of two that brings all coordinates to about 1, whose squares the search takes."""
        size = max(self._spread, float(self.h.max()))
        return float(2.0 ** -np.clip(np.frexp(size)[1], -1000, 1000))

    @property
    def _spread(self) -> float:
        """The largest coordinate that the search meets."""
        if self.period is None:
            return float(np.abs(self.x).max())
        closed = np.isfinite(self.period)
        open_axes = np.abs(self.x[~closed]).max(initial=0.0)
        return float(max(open_axes, self.period[closed].max(initial=0.0)))

    def _wrapped(self, x: Array) -> Array:
        """Positions (n, d) inside the box, in the unit of the search."""
        if self.period is None:
            return np.ascontiguousarray(x.T) * self._unit
        closed = np.isfinite(self.period)
        sides = np.where(closed, self.period, 1.0)
        inside = np.mod(x.T, sides)
        inside = np.where(inside < sides, inside, 0.0)
        return np.where(closed, inside, x.T) * self._unit

    def _neighbours(self, target: Indices, kernel: Kernel, times: int = 1) -> list[list[int]]:
        support = float(kernel.support)
        if self.period is not None:
            reach = 2.0 * support * float(self.h.max())
            if np.any(self.period <= reach):
                raise ValueError(
                    f"period: got {self.period.tolist()}, expected more than twice the support,"
                    f" {reach:g}: a particle would meet its own image"
                )
        h = self.h[target]
        if self.mode in ("scatter", "mean-kernel"):
            h = np.full_like(h, self.h.max())
        elif self.mode == "mean":
            h = 0.5 * (h + self.h.max())
        # the search squares: what is left out by its rounding has to be added
        radius = times * support * h * EDGE + 4.0 * UNIT * self._spread
        found: list[list[int]] = list(
            self._tree().query_ball_point(
                self._wrapped(self.x[:, target]), radius * self._unit, return_sorted=True
            )
        )
        return found

    def _difference(self, particle: Indices, target: Indices, axis: int) -> tuple[Array, Array]:
        """x_b − x_a and what rounding took off it; to the nearest image in a periodic box."""
        x = self.x[axis]
        hi, lo = two_sum(x[particle], np.broadcast_to(-x[target], particle.shape))
        if self.period is not None and np.isfinite(self.period[axis]):
            box = self.period[axis]
            turns = np.rint(hi / box)
            hi, lo = dd_add((hi, lo), two_product(-turns, np.full_like(hi, box)))
        return hi, lo

    def neighbourhood(self, target: Indices, kernel: Kernel, number: Any = PLAIN) -> Neighbourhood:
        """All neighbours of the targets, (d, N, T), in the order of the particles."""
        block = self.around(target, kernel, number)
        particle, h = block.particle, self.h[target]
        assert particle is not None
        more = np.zeros(particle.shape)
        if self.given is not None:
            v = self.given[particle]
        elif self.volume == "cell":
            v = self._cells()[particle]
        else:
            volume, rest = self._summed(kernel, number)
            v, more = volume[particle], rest[particle]
        v, more = (np.where(particle < 0, 0.0, x) for x in (v, more))
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(self.dim):
                if number.wide:
                    v, more = dd_div((v, more), dd(np.broadcast_to(h, v.shape)))
                else:
                    v, more = v / h, more / h
        if not np.all(v < 1e100):
            raise ValueError(
                f"volume: got V/h^d = {float(v.max()):.1e}, expected a volume of about h^d"
            )
        if block.beside is None:
            return replace(block, volume=v)
        if number.bounded:
            more = (more + (self.dim + 3) * UNIT * v) * EDGE
        return replace(block, volume=v, beside=block.beside._replace(volume=more))

    def around(self, target: Indices, kernel: Kernel, number: Any = PLAIN) -> Neighbourhood:
        """The neighbours of the targets without their volumes, whatever the kernel but its support:
        (d, N, T) as `neighbourhood`."""
        lists = self._neighbours(target, kernel)
        counts = np.array([len(one) for one in lists], dtype=np.int64)
        flat = np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=int(counts.sum()))
        column = np.repeat(np.arange(target.size), counts)
        row = np.arange(flat.size) - np.repeat(np.cumsum(counts) - counts, counts)
        particle = np.full((int(counts.max(initial=0)), target.size), -1, dtype=np.int64)
        particle[row, column] = flat
        absent = particle < 0
        h = self.h[target]
        far = 2.0 * float(kernel.support) + 1.0
        offset, low = [], []
        for axis in range(self.dim):
            hi, lo = self._difference(particle, target, axis)
            if number.wide:
                hi, lo = dd_div((hi, lo), dd(np.broadcast_to(h, hi.shape)))
                low.append(np.where(absent, 0.0, lo))
            else:
                hi = hi / h
            hi[absent] = far if axis == 0 else 0.0
            offset.append(hi)
        s = np.stack(offset)
        stretch: Array | None = None
        more: Array | None = None
        if not self.one_h:
            h_b = self.h[particle]
            both = two_sum(0.5 * h, 0.5 * h_b) if self.mode == "mean" else dd(h_b)
            stretch = h / both[0]
            if number.wide:
                stretch, more = dd_div(dd(np.broadcast_to(h, h_b.shape)), both)
        beside, none = None, np.zeros((1, 1))
        if number.wide:
            beside = Beside(np.stack(low), none, more)
        elif number.bounded:
            rounded = (2.0 + 1e-9) * UNIT  # a difference or a sum, and a quotient
            more = None if stretch is None else rounded * stretch
            beside = Beside(rounded * np.abs(s), none, more)
        return Neighbourhood(
            offset=s,
            volume=np.zeros((1, 1)),
            target=target,
            particle=particle,
            stretch=stretch,
            mean_kernel=self.mode == "mean-kernel",
            h=h,
            beside=beside,
        )

    def _cells(self) -> Array:
        """1D volumes: half the distance between the two neighbours; the end cells of a free line
        are as wide as the half that there is, twice."""
        if "cells" not in self._trees:
            x = self.x[0]
            period = None if self.period is None or np.isinf(self.period[0]) else self.period[0]
            if period is not None:
                x = np.mod(x, period)
            order = np.argsort(x, kind="stable")
            s = x[order]
            if period is not None:
                gaps = np.diff(np.concatenate([s[-1:] - period, s, s[:1] + period]))
            else:
                inner = np.diff(s)
                gaps = np.concatenate([inner[:1], inner, inner[-1:]])
            volume = np.empty_like(x)
            volume[order] = 0.5 * (gaps[1:] + gaps[:-1])
            self._trees["cells"] = volume
        return np.asarray(self._trees["cells"])

    def _summed(self, kernel: Kernel, number: Any = PLAIN) -> tuple[Array, Array]:
        """m_a/ρ_a, ρ_a = Σ_b m_b W(x_b − x_a, h_ab), and what is wanted beside it, (n,): for all
        particles, once for a kernel."""
        number = for_volumes(number)
        name = f"summed {type(number).__name__}"
        if self._trees.get(f"{name} for") != kernel:
            volume, rest = np.empty((2, self.population))
            for first in range(0, self.population, 256):
                target = np.arange(first, min(first + 256, self.population), dtype=np.int64)
                block = self.around(target, kernel, number)
                assert block.particle is not None
                mass = np.where(block.particle < 0, 0.0, self.mass[block.particle])
                q, weight = number.length(block.offsets(number)), number.number(mass)
                each = [
                    _density_terms(number, kernel, q, weight, one, self.dim)
                    for one in block.stretches(number)
                ]
                terms = each[0] if len(each) == 1 else (each[0] + each[1]) * 0.5
                density = number.total(terms)  # h_a^d ρ_a
                size = number.value(density)
                if not np.all(size > 0):
                    a = int(np.argmin(size > 0))
                    raise ValueError(
                        f"volume: particle {first + a} has a summed density of {size[a]:g}, so no"
                        " volume m/ρ; expected a kernel that is positive at the origin"
                    )
                own = number.ratio(number.number(self.mass[target]), density)
                for _ in range(self.dim):
                    own = own * number.number(self.h[target])
                volume[target], rest[target] = number.value(own), number.rest(own)
            self._trees[f"{name} for"], self._trees[name] = kernel, (volume, rest)
        volume, rest = self._trees[name]
        return volume, rest

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (d, N) and volumes (N,) of one target as arrays of Fractions; the arrays given
        are the floats that they are."""
        return self._exactly(target, kernel, reach)[:2]

    def exact_pairs(self, target: int, kernel: Kernel) -> tuple[Indices, Any]:
        """Which particles these are, (N,), and h_a/h_ab of them, (N,), None where it is 1."""
        _, _, stretch, near = self._exactly(target, kernel, 1)
        return near, None if self.one_h else stretch

    def _exactly(self, target: int, kernel: Kernel, reach: int) -> tuple[Any, Any, Any, Indices]:
        found = self._neighbours(np.array([target]), kernel, reach)
        near = np.array(found[0], dtype=np.int64)
        x, place = fractions(self.x[:, near]), fractions(self.x[:, target])
        h, h_b = fractions(self.h[target][None])[0], fractions(self.h[near])
        offset = x - place[:, None]
        if self.period is not None:
            for axis in np.flatnonzero(np.isfinite(self.period)):
                box = fractions(self.period[axis][None])[0]
                offset[axis] = np.array([d - box * round(d / box) for d in offset[axis]])
        offset = offset / h
        v = self.given if self.given is not None else self._cells()
        volume = fractions(v[near]) / h**self.dim
        own = 0 * h_b + h
        stretch = h / {"gather": own, "mean": (h + h_b) / 2}.get(self.mode, h_b)
        square, most = (offset * offset).sum(axis=0), (reach * fraction(kernel.support)) ** 2
        inside = square * stretch**2 <= most
        if self.mode == "mean-kernel":
            inside |= square <= most
        return offset[:, inside], volume[inside], stretch[inside], near[inside]


def _density_terms(number: Any, kernel: Kernel, q: Any, mass: Any, stretch: Any, dim: int) -> Any:
    """m_b Ŵ with h_a/h = stretch, times h_a^d."""
    terms = kernel_values(number, kernel, q if stretch is None else q * stretch, 0, dim) * mass
    for _ in range(0 if stretch is None else dim):
        terms = terms * stretch
    return terms


def particles(
    x: object,
    *,
    h: object,
    volume: object = None,
    mass: object = None,
    density: object = None,
    period: object = None,
    mode: str = "gather",
) -> Particles:
    """Explicit particles.

    x: positions, (n,) in 1D or (n, d).
    h: smoothing length, one number or (n,).
    volume: (n,) or one number; or "cell" (1D, midpoints); or "summation", m/ρ with ρ_a = Σ_b m W.
        With mass and density instead, m/ρ; with mass alone, "summation".
    period: lengths of a periodic box, one number or d of them, inf along axes that are open; None
        for free particles.
    mode: whose h a pair takes: "gather" h_a, "scatter" h_b, "mean" (h_a + h_b)/2; "mean-kernel"
        the mean of the kernels of h_a and of h_b.

    Integers and single precision are taken as the numbers that they are. Raises ValueError for
    wrong shapes, NaN, infinities, and for lengths, volumes, masses that are not positive.
    """
    positions = _numbers("x", x)
    if positions.ndim == 1:
        positions = positions[:, None]
    if positions.ndim != 2 or not 1 <= positions.shape[1] <= 3:
        raise ValueError(
            f"x: got shape {_numbers('x', x).shape}, expected (n,) in 1D or (n, d), d = 1, 2 or 3"
        )
    n, dim = positions.shape
    if n == 0:
        raise ValueError("x: got no particles, expected at least one")
    lengths = _per_particle("h", h, n)
    if mode not in RULES:
        raise ValueError(f"mode: got {mode!r}, expected one of {', '.join(RULES)}")
    if volume is not None and (mass is not None or density is not None):
        raise ValueError("volume: got a volume and mass or density; expected one or the other")
    if density is not None and mass is None:
        raise ValueError("density: got no mass; expected both, or a volume")
    rule, given = "given", None
    weights = np.ones(n) if mass is None else _per_particle("mass", mass, n)
    if isinstance(volume, str):
        if volume not in ("cell", "summation"):
            raise ValueError(
                f"volume: got {volume!r}, expected numbers, 'summation' or, in 1D, 'cell'"
            )
        if volume == "cell" and (dim > 1 or n < 2):
            raise ValueError("volume: cell needs at least two particles in 1D")
        rule = volume
    elif volume is not None:
        given = _per_particle("volume", volume, n)
    elif density is not None:
        given = weights / _per_particle("density", density, n)
    else:
        rule = "summation"
    box = None
    if period is not None:
        lengths_of_box = _numbers("period", period, infinite=True)
        if lengths_of_box.ndim > 1 or lengths_of_box.size not in (1, dim):
            raise ValueError(f"period: expected one length or {dim} of them")
        box = np.broadcast_to(lengths_of_box, (dim,)).copy()
        if not np.all(box > 0):
            raise ValueError(
                f"period: got {box.tolist()}, expected positive lengths, inf along open axes"
            )
        if np.all(np.isinf(box)):
            box = None
    return Particles(
        x=np.ascontiguousarray(positions.T),
        h=lengths,
        given=given,
        volume=rule,
        period=box,
        mass=weights,
        mode=mode,
        one_h=mode == "gather" or bool(np.all(lengths == lengths[0])),
    )


def _numbers(name: str, value: object, infinite: bool = False) -> Array:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise ValueError
        numbers = array.astype(np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected an array of real numbers") from None
    allowed = np.isfinite(numbers) | (numbers == np.inf) if infinite else np.isfinite(numbers)
    bad = np.flatnonzero(~allowed.reshape(-1))
    if bad.size:
        raise ValueError(
            f"{name}: got {numbers.reshape(-1)[bad[0]]} at position {bad[0]}, expected finite"
            " numbers"
        )
    return numbers


def _per_particle(name: str, value: object, n: int) -> Array:
    """(n,) positive numbers from one number or n of them."""
    numbers: NDArray[np.float64] = _numbers(name, value)
    if numbers.ndim == 2 and numbers.shape[1] == 1:
        numbers = numbers[:, 0]
    if numbers.ndim > 1 or (numbers.ndim == 1 and numbers.size != n):
        raise ValueError(f"{name}: got shape {numbers.shape}, expected one number or ({n},)")
    if not np.all(numbers >= TINY * 2.0**52):
        raise ValueError(f"{name}: expected positive numbers, got {float(numbers.min()):g}")
    return np.broadcast_to(numbers, (n,)).copy()
