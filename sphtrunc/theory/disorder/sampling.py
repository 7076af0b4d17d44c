"""Sampling: averages of an estimate over displacements of all particles together, of any size.

Where volumes, corrections or second neighbours tie the displacements u of many particles together,
no quadrature over one of them is enough. Of an estimate E(u), with E₀ and its slopes g on the
lattice, only what is neither is averaged, over pairs of opposite displacements ±u:

    c = [E(u) + E(−u)]/2 − E₀,   t = [E(u) − E(−u)]/2 − g·u,
    ⟨E⟩ = E₀ + ⟨c⟩,   ⟨(E − E₀)²⟩ = σ²|g|² + ⟨c² + 2 (g·u) t + t²⟩,

and of the last what goes with (g·u)², whose mean is known, is taken out by regression (Hammersley &
Handscomb 1964, Monte Carlo Methods, ch. 5). The draws are always the same; how much they leave open
is estimated from their spread.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import MOST_CONDITION, Health
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.kernels.factors import factor_values
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.operators.terms import VALUE, monomial, parts
from sphtrunc.theory.disorder.nested import SecondNeighbours, pairs_within
from sphtrunc.theory.disorder.sensitivities import FirstNeighbours, dual_coefficients, mixing
from sphtrunc.theory.fields import Signals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.arrangement import Arrangement

CUT = 4.0  # standard deviations, which no Gaussian displacement passes
CLOSER = 5.0  # standard deviations by which two particles come closer to each other at most
WORK = 1 << 23  # terms of all draws together, about a second
FEWEST, MOST = 32, 4096  # pairs of draws
ROUNDED = 2.0**10 * UNIT  # of an estimate: what is smaller is not looked at
_BLOCK = 1 << 20  # terms at a time
ENOUGH = 0.01  # relative, to which an rms need not be known better
ERRORS = 3.0  # standard errors that a prediction is said to be good to


@dataclass(frozen=True)
class Spread:
    """What displacements do to estimates: shift is ⟨E⟩ − E₀, second ⟨(E − E₀)²⟩, both (K, C, F);
    known_to: what their sum still² + 2 still·shift + second over components and parts is good to,
    (K,), for E₀ − exact = still"""

    shift: Array
    second: Array
    known_to: Array


def displaced(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    signals: Signals,
    still: Array | float,
    axis: int | None = None,
    enough: float = ENOUGH,
) -> Spread:
    """What the displacements of a scene do to every signal, component and part.

    still: E₀ − exact on the lattice, (K, C, F), for what the mean of (E − exact)² is good to
    axis: the only component that is looked at; enough: relative, to which an rms has to be known

    Raises ValueError where the correction is singular at all displacements.
    """
    near: FirstNeighbours | SecondNeighbours
    if operator.form == NESTED:
        near = SecondNeighbours(kernel, operator, scene)
    else:
        near = FirstNeighbours(kernel, scene)
    around = Around(kernel, operator, scene)
    rows = around.rows_of(near.index)
    slopes = slopes_of(near, operator, signals)
    shape = tuple(1 + max(axis) for axis in zip(*slopes, strict=True))
    linear = np.zeros((*shape, *around.points.shape))
    for key, slope in slopes.items():
        linear[key][rows] = slope
    sources = linear if around.mixed is None else np.matmul(around.mixed.T, linear)
    first = scene.sigma**2 * (sources**2).sum(axis=(-2, -1))
    flat = linear.reshape(*shape, -1)
    chosen = slice(None) if axis is None else slice(axis, axis + 1)
    flat, first = flat[:, chosen], first[:, chosen]
    lattice = around.estimates(signals, np.zeros((1, *around.points.shape)))[0][0][:, chosen]
    rounded = (ROUNDED * np.abs(lattice).max()) ** 2
    kept: list[tuple[Array, Array, Array]] = []
    for u in around.draws(int(np.prod(shape))):
        (up, well), (down, too) = around.estimates(signals, u), around.estimates(signals, -u)
        up, down = up[:, :, chosen], down[:, :, chosen]
        well &= too  # no estimate at a correction matrix that is near to singular, as in `measure`
        along = np.tensordot(u.reshape(len(u), -1), flat, axes=(1, flat.ndim - 1))
        even, odd = 0.5 * (up + down) - lattice, 0.5 * (up - down) - along
        kept.append((even[well], odd[well], along[well]))
        c, t, linear = (np.concatenate(x) for x in zip(*kept, strict=True))
        if len(c) < 2:
            raise ValueError(
                "correction: its matrix is near to singular at most displacements; expected more"
                " neighbours, or less disorder"
            )
        found = _averaged(c, t, linear, first, still)
        whole = (still**2 + 2.0 * still * found.shift + found.second).sum(axis=(1, 2))
        if (found.known_to <= 2.0 * enough * whole + rounded).all():
            break
    return replace(
        found,
        second=np.where(found.second > rounded, found.second, 0.0),
        known_to=np.where(whole > rounded, found.known_to, 0.0),
    )


def _averaged(c: Array, t: Array, along: Array, first: Array, still: Array | float) -> Spread:
    """The averages of pairs of draws, (m, K, C, F), and what they are good to."""
    rest = c * c + (2.0 * along + t) * t
    known = along * along - first
    centred = known - known.mean(axis=0)
    square = (centred**2).sum(axis=0)
    slope = (rest * centred).sum(axis=0) / np.where(square > 0, square, 1.0)
    rest = rest - slope * known
    each = (2.0 * still * c + rest).sum(axis=(2, 3))
    error = np.std(each, axis=0, ddof=1) / len(each) ** 0.5
    second = np.maximum(first + rest.mean(axis=0), 0.0)
    return Spread(c.mean(axis=0), second, np.asarray(ERRORS * error))


def slopes_of(
    near: FirstNeighbours | SecondNeighbours, operator: Operator, signals: Signals
) -> dict[tuple[int, ...], Array]:
    """∂E/∂u_b, (N, d), of every signal, component and part."""
    if isinstance(near, SecondNeighbours):
        return near.slopes(signals)
    needed = [] if operator.uncorrected else operator.needed(near.dim, 0)
    rows = dual_coefficients(operator, {key: near.base_sum(key) for key in needed}, near.dim)
    sampled = {key: near.sampled(key) for key in dict.fromkeys(k for part in rows for k in part)}
    difference, ahead = signals.difference(near.s), signals.gradient(near.s)
    symmetric = operator.form == SYMMETRIC
    result: dict[tuple[int, ...], Array] = {}
    for c, part in enumerate(rows):
        g, dg = (
            np.sum([x.value * sampled[key][i] for key, x in part.items()], axis=0) for i in (0, 1)
        )
        for i, f in np.ndindex(*difference.shape[:2]):
            own = 0.0 if operator.uses_difference else signals.own[i, f]
            seen = difference[i, f] + own
            climb = dg * seen[:, None] + g[:, None] * ahead[i, f]
            slope = near.total(g * seen, climb, 2 if symmetric else 1).slope
            if symmetric:
                slope = slope + own * near.total(g, dg, 0).slope
            for key, x in part.items():
                slope = slope + float(near.volumes @ (sampled[key][0] * seen)) * x.slope
            result[i, c, f] = slope
    return result


class Around:
    """The particles that an estimate may see, from where they are on the lattice.

    points: (M, d) in h; near: those that may come within the support of the target
    """

    def __init__(self, kernel: Kernel | Gaussian, operator: Operator, scene: Arrangement) -> None:
        self.kernel, self.operator, self.scene, self.volume = kernel, operator, scene, scene.volume
        self.dim, self.ratio = scene.dim, float(scene.dx_over_h)
        nested = operator.form == NESTED
        support = float(kernel.support)
        margin = CLOSER * scene.sigma
        levels = 1 + nested + (self.volume == "summation")
        reach = levels * (support / self.ratio + margin)
        reach += 1.5 + 2.0 * margin if self.volume == "cell" else 0.0
        self.index = scene.sites(reach)
        self.points = scene.positions(self.index)
        square = (self.points**2).sum(axis=1)
        self.target = int(square.argmin()) if scene.at_particle else -1
        self.limit = limit = (support + margin * self.ratio) ** 2 * (1 + 1e-9)
        self.near = np.flatnonzero(square <= limit)
        self.mixed = mixing(scene, self.index)
        self.seen = self.near  # the particles whose volumes are needed
        if nested:
            at = np.concatenate([self.points[self.near], np.zeros((1, self.dim))])
            self.b, self.c = pairs_within(self.points, at, limit)
            self.seen = np.unique(self.c)
        if self.volume == "summation":
            self.i, self.j = pairs_within(self.points, self.points[self.seen], limit)
            self.own = self.seen[self.i]
        gradient = operator.gradient if nested else operator
        self.keys = [] if gradient.uncorrected else gradient.needed(self.dim, 0)
        terms = len(self.c) if nested else len(self.near)
        self.size = terms * (1 + len(self.keys) // 4)
        self.size += len(self.i) if self.volume == "summation" else 0

    def rows_of(self, index: NDArray[Any]) -> NDArray[Any]:
        """Where particles at integer points stand."""
        place = {tuple(m): row for row, m in enumerate(self.index.T.tolist())}
        return np.array([place[tuple(m)] for m in index.T.tolist()])

    def draws(self, figures: int) -> Iterator[Array]:
        """Displacements in Δx, (D, M, d), block by block, always the same; for so many figures."""
        size = max(self.size, figures * len(self.near))
        most = min(max(WORK // (2 * size), FEWEST), MOST)
        random = np.random.RandomState(0)  # whose stream never changes
        sources = len(self.points) if self.mixed is None else self.mixed.shape[1]
        done = 0
        while done < most:
            block = min(max(1, _BLOCK // size), max(done, FEWEST), most - done)
            shape = (block, sources, self.dim)
            if self.scene.distribution == "uniform":
                v = random.uniform(-(3**0.5), 3**0.5, shape)
            else:
                v = np.clip(random.standard_normal(shape), -CUT, CUT)
            done += block
            yield self.scene.sigma * (v if self.mixed is None else np.matmul(self.mixed, v))

    def estimates(self, signals: Signals, moved: Array) -> tuple[Array, NDArray[np.bool_]]:
        """E for displacements (D, M, d) in Δx, (D, K, C, F), and whether its correction is safe."""
        s = self.points + self.ratio * moved
        if self.target >= 0:
            s = s - s[:, self.target : self.target + 1]
        volumes = self._volumes(s)
        if self.operator.form == NESTED:
            return self._nested(signals, s, volumes)
        s, volumes = s[:, self.near], volumes[:, self.near]
        g = self._terms(s)
        means = {key: (volumes * g(key)).sum(axis=1) for key in self.keys}
        health = Health()
        rows = self.operator.coefficients(means, self.dim, partial(solve, health=health))
        well = np.broadcast_to(np.asarray(health.condition) <= MOST_CONDITION, len(s))
        weights = np.stack(
            [sum(np.asarray(c)[..., None] * g(key) for key, c in row.items()) for row in rows]
        )
        difference = signals.difference(s)
        own = (difference.T * 0.0 + signals.own.T).T
        if self.operator.uses_difference:
            parts_ = np.einsum("cdb,kfdb->dkcf", volumes * weights, difference)
        elif self.operator.form == SYMMETRIC:
            mine = (
                volumes if self.target < 0 else volumes[:, np.flatnonzero(self.near == self.target)]
            )
            parts_ = np.einsum("cdb,kfdb->dkcf", volumes**2 / mine * weights, difference + own)
            parts_ = parts_ + np.einsum("cdb,kfdb->dkcf", mine * weights, own)
        else:
            parts_ = np.einsum("cdb,kfdb->dkcf", volumes * weights, difference + own)
        return np.asarray(parts_), well.copy()

    def _terms(self, s: Array) -> Any:
        """g of a key at offsets (…, d), computed once."""
        q = np.sqrt((s * s).sum(axis=-1))
        factor = cache(lambda k: factor_values(self.kernel, k, q, self.dim))
        return cache(
            lambda key: sum(c * monomial(s, beta) * factor(k) for c, beta, k in parts(key))
        )

    def _volumes(self, s: Array) -> Array:
        """V, (D, M), right where it is needed."""
        volumes = np.full(s.shape[:2], self.ratio**self.dim)
        if self.volume == "cell":
            x = s[:, :, 0]
            order = np.argsort(x, axis=1)
            along = np.take_along_axis(x, order, 1)
            sizes = np.zeros_like(along)
            sizes[:, 1:-1] = 0.5 * (along[:, 2:] - along[:, :-2])
            np.put_along_axis(volumes, order, sizes, 1)
        elif self.volume == "summation":
            square: Any = 0.0
            for axis in range(self.dim):  # far quicker than arrays of vectors
                x = s[:, :, axis]
                gap = x.take(self.j, axis=1) - x.take(self.own, axis=1)
                square = square + gap * gap
            density = _sums(factor_values(self.kernel, VALUE, np.sqrt(square), self.dim), self.i)
            volumes[:, self.seen] = 1.0 / density
        return volumes

    def _nested(
        self, signals: Signals, s: Array, volumes: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        gradient = self.operator.gradient
        at = np.concatenate([s[:, self.near], np.zeros((len(s), 1, self.dim))], axis=1)
        g = self._terms(s[:, self.c] - at[:, self.b])
        v = volumes[:, self.c]
        places = at.shape[:2]
        means = {key: _sums(v * g(key), self.b).ravel() for key in self.keys}
        health = Health()
        rows = gradient.coefficients(means, self.dim, partial(solve, health=health))
        well = _spread(np.asarray(health.condition) <= MOST_CONDITION, places)
        w = [
            v * sum(_spread(c, places)[:, self.b] * g(key) for key, c in row.items())
            for row in rows
        ]
        outer = self.b == len(self.near)
        values = signals.difference(s)
        axes = self.operator.axes(self.dim)
        result = np.zeros((len(s), values.shape[0], len(axes), values.shape[1]))
        for k, f in np.ndindex(*values.shape[:2]):
            inside = np.concatenate([values[k, f][:, self.near], np.zeros((len(s), 1))], axis=1)
            difference = values[k, f][:, self.c] - inside[:, self.b]
            inner = [_sums(x * difference, self.b) for x in w]
            rise = [x[:, :-1] - x[:, -1:] for x in inner]
            for c, row in enumerate(axes):
                for i, j in row:
                    result[:, k, c, f] += (w[i][:, outer] * rise[j]).sum(axis=1)
        inside_ = (at**2).sum(axis=2) <= float(self.kernel.support) ** 2  # others are not seen
        return result, (well | ~inside_).all(axis=1)


def _sums(x: Array, place: NDArray[Any]) -> Array:
    """Σ over the entries of each place, (D, P) to (D, B); `place` is sorted and complete."""
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    return np.asarray(np.add.reduceat(x, starts, axis=1))


def _spread(c: Any, places: tuple[int, ...]) -> Array:
    """A coefficient at every place of every draw, (D, B)."""
    return np.broadcast_to(c, (places[0] * places[1],)).reshape(places)
