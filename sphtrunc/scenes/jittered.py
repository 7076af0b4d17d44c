"""Displaced lattices: every particle moved at random, as a pure function of seed and place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sphtrunc.arithmetic.plain import PLAIN
from sphtrunc.arithmetic.rational import exact, fraction, fractions
from sphtrunc.arithmetic.summation import Array, dd_add, dd_from_ratio, dd_mul, two_sum
from sphtrunc.scenes import random_numbers as jitter
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.lattice import Lattice, _exact_positions, _positions, _stencil, _whole
from sphtrunc.scenes.neighbourhood import EDGE, Beside, Ghosts, assemble, wanted
from sphtrunc.scenes.neighbourhood import Indices as Indices
from sphtrunc.scenes.neighbourhood import Neighbourhood as Neighbourhood
from sphtrunc.scenes.sites import KINDS, units

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


#: s, (d, N, T), and by axis what an arithmetic wants beside it, if it does
Offsets: TypeAlias = tuple[Array, list[Array]]
UNMOVED: Any = {"sigma": 0.0, "distribution": "gaussian"}


@dataclass(frozen=True)
class Jittered(Arrangement):
    """A lattice whose particles are displaced at random: u, of standard deviation σ/Δx along each
    axis, is a pure function of (seed, lattice index). Made by `jittered`.

    anywhere: the targets are not the particles but points of space, one at random for each
    """

    seed: int = 0
    anywhere: bool = False

    @property
    def lattice(self) -> Lattice:
        """The lattice without displacements."""
        rules = (field.name for field in fields(Arrangement))
        return Lattice(**{name: getattr(self, name) for name in rules} | UNMOVED)

    @property
    def population(self) -> int:
        """The number of different targets: the particles of the scene."""
        return self.particles

    @property
    def largest(self) -> float:
        """The largest displacement along one axis, in Δx."""
        most = self.sigma * jitter.largest(self.distribution) * EDGE
        if self.distribution == "blue":
            most *= 2.0 / (1.0 + 1.0 / len(KINDS[self.kind].nearest)) ** 0.5
        return most

    @property
    def target_moves(self) -> bool:
        """A target is a particle and moves with it, unless the lattice has an offset."""
        return self.at_particle and not self.anywhere

    @property
    def _cell(self) -> Array:
        """The primitive vectors as rows, in Δx: targets anywhere lie in the cell that they span."""
        length = np.array([float(u) for u in units(self.kind)])
        return np.asarray(np.array(KINDS[self.kind].primitive) * length)

    def _sites(self, kernel: Kernel, reach: int = 1) -> Indices:
        slack = self.largest * (2.0 if self.target_moves else 1.0)
        slack += 0.5 * float(np.abs(self._cell).sum(axis=0).max()) if self.anywhere else 0.0
        margin = 1.0 + 3.0 * slack if self.volume == "cell" else 0.0
        reach += self.volume == "summation"
        return _stencil(self, kernel, slack, margin, reach)

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
        steps = KINDS[self.kind].nearest
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

    def _own(self, origin: jitter.Bits) -> list[Array]:
        """Where the targets are, beside their sites, along each axis in Δx."""
        if self.anywhere:
            u = [jitter.uniform01(origin, self.seed, 500 + i) - 0.5 for i in range(self.dim)]
            return list(np.tensordot(self._cell.T, np.stack(u), axes=1))
        own = list(self._displacement(origin))
        return own if self.target_moves else [0.0 * u for u in own]

    def origin(self, target: Indices) -> Indices:
        """Integer points (d, T) of the targets 0 … extent^d − 1."""
        rest, steps = target, []
        for _ in range(self.dim):
            rest, step = np.divmod(rest, self.extent)
            steps.append(step)
        primitive = np.array(KINDS[self.kind].primitive, dtype=np.int64)
        return np.asarray(primitive.T @ np.stack(steps))

    def neighbourhood(
        self,
        target: Indices,
        kernel: Kernel,
        number: Any = PLAIN,
        *,
        reach: int = 1,
    ) -> Neighbourhood:
        """All particles within so many supports of the targets, (d, N, T), N the largest number."""
        m = self._sites(kernel, reach)
        base = _positions(self, m, Fraction(1), number.wide or number.bounded)
        origin = jitter.place(self.origin(target))
        place = jitter.place(m)[:, None] + origin
        own = self._own(origin)
        fluid = self._offsets(base, self._displacement(place), own, number)
        volume = dd_from_ratio(*(self.dx_over_h**self.dim).as_integer_ratio())
        if self.wall is not None and self.wall.ghosts != "none":
            return self._with_ghosts(fluid, volume, target, kernel, origin, number)
        return assemble(number, self.volume, volume, *fluid, target, kernel, reach)

    def _offsets(
        self,
        base: tuple[Array, Array | None],
        displacement: Iterator[Array],
        own: list[Array],
        number: Any,
    ) -> Offsets:
        """(base + u − u_a) Δx/h."""
        dx_over_h = dd_from_ratio(*self.dx_over_h.as_integer_ratio())
        rows, base_low = base
        offset = np.empty((self.dim, rows.shape[1], own[0].size))
        beside = []
        for axis, u in enumerate(displacement):
            row, mine = rows[axis][:, None], own[axis]
            if base_low is not None:
                difference = two_sum(u, np.broadcast_to(-mine, u.shape))
                both = dd_add(difference, (row, base_low[axis][:, None]))
                fine = dd_mul(both, (np.array(dx_over_h[0]), np.array(dx_over_h[1])))
            u -= mine
            s = np.add(u, row, out=offset[axis])
            s *= dx_over_h[0]
            if number.wide:
                offset[axis], rest = fine
                beside.append(rest)
            elif number.bounded:  # what the rounded formula is off by
                gap = np.abs((fine[0] - s) + fine[1])
                beside.append(gap * EDGE + 2.0**-84 * np.abs(s))
        return offset, beside

    def _with_ghosts(
        self,
        fluid: Offsets,
        volume: tuple[float, float],
        target: Indices,
        kernel: Kernel,
        origin: jitter.Bits,
        number: Any,
    ) -> Neighbourhood:
        """The fluid and behind it the images of displaced particles, as the displaced target sees
        them, or dummies, which stay where the lattice would go on."""
        home, wall = self.lattice, self.wall
        assert wall is not None
        wide, own = number.wide or number.bounded, self._own(origin)
        mirrored = wall.ghosts in ("mirror", "odd")
        shift = 2 * wall.eta / home.dx_over_h if mirrored else Fraction(0)
        there = replace(home, offset=(home.offset[0] + shift, *home.offset[1:]), wall=None)
        slack = self.largest * (2.0 if self.target_moves else 1.0)
        others = _stencil(there, kernel, slack)
        edge = -home.wall_phase
        others = others[:, others[0] >= edge if mirrored else others[0] < edge]
        s, s_low = _positions(there, others, Fraction(1), wide)
        if mirrored:
            s[0] *= -1.0  # −(x + 2η) − u_b − u_a along the normal
            if s_low is not None:
                s_low[0] *= -1.0
            place = jitter.place(others)[:, None] + origin
            moved = self._displacement(place)
            moved = (-u if axis == 0 else u for axis, u in enumerate(moved))
            before = _positions(home, others, Fraction(1), wide)
            originals = self._offsets(before, self._displacement(place), own, number)
        else:
            none = np.zeros((others.shape[1], target.size))
            moved = (none.copy() for _ in range(self.dim))
        beyond = self._offsets((s, s_low), moved, own, number)
        offset, beside = _joined(fluid, beyond)
        ratio = dd_from_ratio(*home.dx_over_h.as_integer_ratio())
        far = dd_from_ratio(*(-wall.eta).as_integer_ratio())
        step = dd_mul((-own[0], np.zeros_like(own[0])), (np.array(ratio[0]), np.array(ratio[1])))
        ghosts = Ghosts(
            kind=wall.ghosts,
            rows=(np.arange(offset.shape[1]) >= fluid[0].shape[1])[:, None],
            wall=dd_add(step, (np.array(far[0]), np.array(far[1]))),
        )
        if mirrored:
            image, more = _joined(fluid, originals)
            ghosts = replace(ghosts, image=image[0], beside=more[0] if wide else None)
        rest = wanted(number, np.full((1, 1), volume[1])) if wide else None
        return Neighbourhood(
            offset=offset,
            volume=np.full((1, 1), volume[0]),
            target=target,
            beside=None if rest is None else Beside(np.stack(beside), rest),
            ghosts=ghosts,
        )

    def exact_neighbourhood(self, target: int, kernel: Kernel, reach: int = 1) -> tuple[Any, Any]:
        """Offsets (d, N) and volumes (N,) of one target as arrays of Fractions."""
        m = self._sites(kernel, reach)
        origin = self.origin(np.array([target]))
        moved = fractions(self.displacement(m + origin))
        moved -= fractions(np.stack(self._own(jitter.place(origin))))
        offset = (_exact_positions(self, m) + moved) * self.dx_over_h
        volume = np.full(m.shape[1], self.dx_over_h**self.dim, dtype=object)
        if self.volume == "cell":
            offset = np.sort(offset, axis=1)
            volume = (offset[0, 2:] - offset[0, :-2]) / 2
            offset = offset[:, 1:-1]
        near = (offset * offset).sum(axis=0) <= (reach * fraction(kernel.support)) ** 2
        return offset[:, near], volume[near]


def _joined(one: Offsets, other: Offsets) -> Offsets:
    """The rows of both, one after the other."""
    beside = [np.concatenate(pair) for pair in zip(one[1], other[1], strict=True)]
    return np.concatenate([one[0], other[0]], axis=1), beside


def jittered(
    lattice: Lattice,
    sigma: object,
    distribution: str = "gaussian",
    seed: int = 0,
    *,
    anywhere: bool = False,
) -> Jittered:
    """The lattice with every particle displaced, the target too (unless it sits at an offset).

    sigma: standard deviation σ/Δx of the displacement along each axis.
    distribution: "gaussian", cut at four standard deviations and of unit variance all the same;
        "uniform", of equal standard deviation; "blue", v less the mean of v over the nearest
        lattice neighbours, v Gaussian: u_n = (v_n − mean v)/√(1 + 1/z), so that the spectrum is
        that of v times (1 − mean cos k·e)²/(1 + 1/z), z the number of neighbours.
    seed: 0 … 2⁶³ − 1.
    anywhere: targets are points of space at random, not particles.

    Beside a wall every target is at the same distance from it, less its own displacement, and a
    particle is on the side where its site is.

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
    lattice.require_unmoved_wall()
    _whole("seed", seed, 0, 2**63 - 1)
    moved = {"sigma": value, "distribution": distribution, "seed": int(seed), "anywhere": anywhere}
    return Jittered(**vars(lattice) | moved)
