"""Curvature: what the second derivatives of the nested form add to its mean in disorder,

    ⟨E⟩ − E = ½ σ² Σ_p ∇²_p E + O(σ⁴),

over all particles p that are displaced, the target among them. E = Σ_b λ_b R_b, R_b = G_b − G_a,
is a sum of products, and ∇²(X Y) = X ∇²Y + Y ∇²X + 2 ∇X·∇Y, through corrections as well: their
coefficients c(m) have ∇²c = c_m ∇²m_m + c_mn ∇m_m·∇m_n.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.propagation import is_smooth
from sphtrunc.second_neighbours import SecondNeighbours, binned
from sphtrunc.signals import Signals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.gaussian import Gaussian
    from sphtrunc.kernel import Kernel
    from sphtrunc.operators import Key

    Array = NDArray[np.float64]

_STEP = 1e-5  # of the base sums, for c_mn


@dataclass(frozen=True)
class _Slope:
    """∇ of a sum at each of B places, with respect to offsets from the target.

    c: (P, d), the particle of each pair; b: (B, d), that at the place; all: (B, d), all together
    """

    c: Array
    b: Array
    all: Array

    def __add__(self, other: _Slope) -> _Slope:
        return _Slope(self.c + other.c, self.b + other.b, self.all + other.all)


def mean_shift(
    kernel: Kernel | Gaussian, seen: SecondNeighbours, signals: Signals, sigma: float
) -> Array | None:
    """½ σ² Σ_p ∇²_p E of every signal, component and part, (K, C, F), for independent displacements
    of standard deviation σ, in Δx, along each axis.

    None where volumes depend on displacements, and where the terms of some particle have no second
    derivatives.
    """
    spread = sigma * seen.ratio
    if seen.variation is not None or not is_smooth(kernel, seen.operator, seen.s, spread, 2):
        return None
    sums = _Sums(seen)
    values, ahead = signals.difference(seen.s), signals.gradient(seen.s)
    bends = signals.laplacian(seen.s)
    rows = seen.operator.axes(seen.dim)
    result = np.zeros((values.shape[0], len(rows), values.shape[1]))
    for k, f in np.ndindex(*values.shape[:2]):
        difference = seen.differences(values[k, f])
        inner = [sums.inner(j, difference, ahead[k, f], bends[k, f]) for j in range(seen.dim)]
        for c, row in enumerate(rows):
            result[k, c, f] = sum(sums.outer(i, *inner[j]) for i, j in row)
    return np.asarray(0.5 * spread**2 * result)


class _Sums:
    """Sums at the places of a lattice at rest, with their slopes and Laplacians."""

    def __init__(self, seen: SecondNeighbours) -> None:
        self.seen, self.v = seen, seen.ratio**seen.dim
        particle = np.append(seen.near, seen.target)[seen.b]
        self.apart = (seen.c != particle)[:, None]
        self.free_c = (seen.c != seen.target) & self.apart[:, 0]
        self.particle = particle
        self.moving = seen.target >= 0  # the target, and all offsets with it
        self.free = np.append(seen.near != seen.target, False)
        self.lap = {key: seen.terms.laplacian(key) * self.apart[:, 0] for key in seen.g}
        twice = 1.0 + (self.free | self.moving)
        self.means = [self.slope(seen.g[key][1], -seen.g[key][1]) for key in seen.keys]
        lap_m = [twice * self.total(self.lap[key]) for key in seen.keys]
        pairs = [[self.dot(m, n) for n in self.means] for m in self.means]
        second = self._second() if seen.keys else []
        #: ∇²c of every axis and key, (B,)
        self.bent: list[Mapping[Key, Array]] = []
        for j in range(seen.dim):
            bent = {}
            for key, slope in seen.slope[j].items():
                bent[key] = np.zeros(len(self.free))
                for m, own in enumerate(lap_m):
                    bent[key] += slope[:, m] * own
                    for n, product in enumerate(pairs[m]):
                        bent[key] += second[j][key][seen.sort, m, n] * product
            self.bent.append(bent)

    def _second(self) -> list[dict[Key, Array]]:
        """c_mn of every axis and key, for each sort of place, by differences of c_m."""
        seen = self.seen
        found = [{key: [] for key in row} for row in seen.slope]  # type: ignore[var-annotated]
        for place in seen.first:
            sides = [
                [seen.coefficients(int(place), list(side * row)) for side in (_STEP, -_STEP)]
                for row in np.eye(len(seen.keys))
            ]
            for j, row in enumerate(found):
                for key, sorts in row.items():
                    sorts.append([(up[j][key].slope - down[j][key].slope) / (2 * _STEP)
                                  for up, down in sides])  # fmt: skip
        return [{key: np.array(sorts) for key, sorts in row.items()} for row in found]

    def total(self, x: Array) -> Array:
        """V Σ_c x at every place, (B,) or (B, d)."""
        if x.ndim > 1:
            return np.stack([self.total(axis) for axis in x.T], axis=1)
        return self.v * binned(self.seen.b, x, len(self.free))

    def slope(self, at_c: Array, at_b: Array) -> _Slope:
        """Of V Σ_c x, from ∂x/∂s_c and ∂x/∂s_b of every pair, (P, d)."""
        c = at_c * self.free_c[:, None]
        b = self.total(at_b * self.apart) * self.free[:, None]
        return _Slope(self.v * c, b, self.total(c) + b)

    def scaled(self, slope: _Slope, factor: Array) -> _Slope:
        """Times a factor at every place, (B,)."""
        x = factor[:, None]
        return _Slope(x[self.seen.b] * slope.c, x * slope.b, x * slope.all)

    def dot(self, x: _Slope, y: _Slope) -> Array:
        """Σ_p ∇_p X·∇_p Y at every place, (B,)."""
        each = binned(self.seen.b, (x.c * y.c).sum(axis=1), len(self.free))
        return np.asarray(
            each + (x.b * y.b).sum(axis=1) + self.moving * (x.all * y.all).sum(axis=1)
        )

    def inner(
        self, j: int, difference: Array, ahead: Array, bend: Array
    ) -> tuple[Array, _Slope, Array]:
        """G, its slope and its Laplacian; ahead, bend: ∇A and ∇²A, (M, d) and (M,)."""
        seen, at, c = self.seen, self.particle, self.seen.c
        slopes, value, lap = [], np.zeros(len(self.free)), np.zeros(len(self.free))
        for key, coefficient in seen.value[j].items():
            g, dg = seen.g[key]
            climb = dg * difference[:, None]
            own = self.slope(climb + g[:, None] * ahead[c], -climb - g[:, None] * ahead[at])
            own_sum = self.total(g * difference)
            value += coefficient * own_sum
            at_c, at_b, both = (
                self.lap[key] * difference + x + g * y
                for x, y in (
                    (2 * (dg * ahead[c]).sum(axis=1), bend[c]),
                    (2 * (dg * ahead[at]).sum(axis=1), -bend[at]),
                    (-self.lap[key] * difference, bend[c] - bend[at]),
                )
            )
            free_b, free_c = self.free[seen.b], seen.c != seen.target
            each = at_c * free_c + at_b * free_b
            if self.moving:
                each += np.where(free_b, np.where(free_c, both, at_b), at_c)
            lap += coefficient * self.total(each * self.apart[:, 0]) + self.bent[j][key] * own_sum
            slopes.append(self.scaled(own, coefficient))
            for m, mean in enumerate(self.means):
                factor = seen.slope[j][key][:, m]
                lap += 2 * factor * self.dot(mean, own)
                slopes.append(self.scaled(mean, factor * own_sum))
        return value, reduce(add, slopes), lap

    def outer(self, i: int, value: Array, slope: _Slope, lap: Array) -> float:
        """Σ_p ∇²_p Σ_b λ_b (G_b − G_a)."""
        seen, out = self.seen, self.seen.outer
        rise = value[:-1] - value[-1]
        together = self.moving * (slope.all[:-1] - slope.all[-1])
        total = float(self.v * seen.w[i][out] @ (lap[:-1] - lap[-1]))
        own = self.v * seen.dw[i][out] * self.free[:-1, None]
        total += 2.0 * float((own * (slope.b[:-1] - slope.c[out] + together)).sum())
        for key, coefficient in seen.value[i].items():
            g, dg = (x[out] for x in seen.g[key])
            bent = (1 + self.moving) * float(coefficient[-1]) * self.lap[key][out]
            bent += self.bent[i][key][-1] * g
            for m, mean in enumerate(self.means):
                factor = float(seen.slope[i][key][-1, m])
                here = mean.c[out] + self.moving * mean.all[-1]
                bent += 2 * factor * (here * dg).sum(axis=1) * self.free[:-1]
                weight = self.v * factor * g
                total += 2.0 * self._across(mean, slope, weight)
                total += 2.0 * float(mean.all[-1] @ (weight @ together))
            total += float(self.v * bent @ rise)
        return total

    def _across(self, mean: _Slope, slope: _Slope, weight: Array) -> float:
        """Σ_b weight_b Σ_p ∇_p m_a·∇_p (G_b − G_a), over offsets of the neighbours p."""
        seen, at = self.seen, self.seen.near
        rows = np.zeros_like(seen.s)
        rows[at] = mean.c[seen.outer]
        each = np.append(weight, -weight.sum())
        return float(
            (each[seen.b, None] * slope.c * rows[seen.c]).sum()
            + (weight[:, None] * slope.b[:-1] * rows[at]).sum()
        )
