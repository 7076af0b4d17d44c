"""Pair matrices in factors: linear maps of fields on particles, and their transposes, exactly.

Every SPH force and rate is a sum of parts

    (Q A)_a = l_a Σ_b r_b K(a, b) A_b      or, where the part is its own particle's,
    (Q A)_a = l_a Σ_b r_b K(a, b) A_a,     K(a, b) = (−1)^{|δ|} x^γ ∂^δW(x, h),  x = x_b − x_a,

with h of particle a, of b, or their mean. K of h_a at (b, a) is (−1)^{|δ|+|γ|} K of h_b at (a, b):
the transpose of a part is a part, with the factors l and r exchanged. Nothing is listed of what
belongs to what: an adjoint is computed.

Sums run on the pair engine, with a bound of all rounding if asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array
from sphtrunc.experiment.engine import Grouped, grouped, pairs_with_terms, sizes
from sphtrunc.operators.moments import unit
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.particles import particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.particles import Particles

#: side of a pair whose h the kernel takes: mode of the engine
SIDES = {"a": "gather", "b": "scatter", "mean": "mean"}
_SUMS = 96  # of one pass
_CHUNK = 1 << 13  # targets
_FACTORS = 24  # roundings that factors l and r, fields times them, and scales are made in, at most


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a pair matrix; axis: which component it belongs to, of the result where a scalar
    is acted on, of the field where a vector is; left, right: (n,) l and r; own: see above."""

    axis: int
    side: str
    key: Key
    left: Array
    right: Array
    own: bool

    @property
    def transposed(self) -> Part:
        """The part of the transposed matrix."""
        if self.own:
            return self
        delta, gamma = self.key
        sign = (-1.0) ** (sum(delta) + sum(gamma))
        side = {"a": "b", "b": "a", "mean": "mean"}[self.side]
        return replace(self, side=side, left=sign * self.right, right=self.left)

    def scaled(self, factor: Array | float) -> Part:
        """The part with factor·l in place of l."""
        return replace(self, left=factor * self.left)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Free or periodic particles on which parts act. x: (d, n); h: (n,)."""

    x: Array
    h: Array
    kernel: Kernel
    period: Array | None = None
    workers: int | None = None

    @property
    def dim(self) -> int:
        return int(self.x.shape[0])

    @property
    def count(self) -> int:
        return int(self.x.shape[1])

    def scene(self, side: str) -> Particles:
        """The particles with unit weights, as the engine takes them."""
        return particles(self.x.T, h=self.h, volume=1.0, period=self.period, mode=SIDES[side])


@dataclass(frozen=True)
class Action:
    """What parts do to a field: (d, n), or (1, n) where a vector becomes a scalar; the bound of
    its rounding; and the sum of the sizes of what is added up."""

    value: Array
    bound: Array | None
    size: Array


def act(
    cloud: Cloud,
    requests: Sequence[tuple[Sequence[Part], Array]],
    *,
    bound: bool = False,
    targets: Any = None,
) -> list[Action]:
    """Parts applied to fields, all in as few passes over the pairs as there are sides.

    What has a factor l in common is one sum over the neighbours, whatever it consists of, and what
    several requests have in common is summed once. Bounds come from a pass of their own, of sizes
    alone (see `engine.sizes`).

    requests: (parts, field), the field (n,), or (d, n) where each part takes the component of its
        axis; targets: indices (T,) of the rows that are wanted, None for all
    Raises ValueError as the engine does.
    """
    at: Any = slice(None) if targets is None else np.asarray(targets)
    work, count = _Work(), cloud.h[at].size
    placed = [[*_sums_of(work, parts, field, i)] for i, (parts, field) in enumerate(requests)]
    sums = {side: work.summed(cloud, side, bound, targets) for side in work.groups}
    shapes = [(cloud.dim if field.ndim == 1 else 1, count) for _, field in requests]
    result = [Action(*(np.zeros(shape) for _ in range(3))) for shape in shapes]
    for first in range(0, count, _CHUNK):  # little at a time, which stays in the caches
        part = slice(first, first + _CHUNK)
        here = part if targets is None else at[part]
        found = {side: one.block(part) for side, one in sums.items()}
        for (_, field), rows, done in zip(requests, placed, result, strict=True):
            for own, axis, left, place in rows:
                values, radii = found[place.side]
                factor = left[here]
                if own:
                    factor = factor * (field if field.ndim == 1 else field[axis])[here]
                term, row = factor * values[place.number], min(axis, len(done.value) - 1)
                done.value[row, part] += term
                done.size[row, part] += np.abs(term, out=term)
                if radii is not None:
                    assert done.bound is not None
                    done.bound[row, part] += np.abs(factor) * radii(place.number)
            if done.bound is not None:  # products and sums at the target
                done.bound[:, part] += (len(rows) + 12.0) * UNIT * done.size[:, part]
    return [done if bound else replace(done, bound=None) for done in result]


class _Place(NamedTuple):
    """Where a sum is: number of a group on a side."""

    side: str
    number: int


def _sums_of(
    work: _Work, parts: Sequence[Part], field: Array, request: int
) -> Iterator[tuple[bool, int, Array, _Place]]:
    """(own, axis, left, where the sum is) of what a request consists of: parts of one factor l."""
    groups: dict[tuple[Any, ...], list[Part]] = {}
    for part in parts:
        # the axes of a vector that is acted on are added up, but for those of the particle's own
        axis = part.axis if field.ndim == 1 or part.own else -1
        delta, gamma = part.key
        order = sum(delta), sum(gamma)
        name = part.side, part.own, axis, order, work.names(part.left)
        groups.setdefault(name, []).append(part)
    for (side, own, axis, _, _), some in groups.items():
        columns: dict[Key, list[Array]] = {}
        for part in some:
            column = part.right
            if not own:
                column = work.product(part.right, field if field.ndim == 1 else field[part.axis])
            columns.setdefault(part.key, []).append(column)
        place = _Place(side, work.group(side, columns, (request, own)))
        yield own, max(axis, 0), some[0].left, place


class _Summed(NamedTuple):
    """The sums of a side: of the engine, the powers of h that take them to units of length, h (T,),
    and for each of them where the bound is, its row and a factor."""

    done: list[Grouped]
    powers: list[int]
    h: Array
    radii: list[tuple[Grouped, int, float]] | None = None

    def block(self, part: slice) -> tuple[Array, Callable[[int], Array] | None]:
        """Of some targets, (G, T), and the bound of every one of them.

        Raises ValueError where they overflow.
        """
        h = self.h[part]
        scale = {p: h ** float(p) for p in set(self.powers)}
        values = np.concatenate([one.block(part) for one in self.done])
        with np.errstate(over="ignore", invalid="ignore"):
            for row, power in zip(values, self.powers, strict=True):
                row *= scale[power]
        if not np.isfinite(values).all():
            raise ValueError("fields: the sums overflow; expected smaller values")
        if self.radii is None:
            return values, None
        radii = self.radii
        read = {i: one.block(part) for i, one in {id(one): one for one, _, _ in radii}.items()}

        def radius(number: int) -> Array:
            one, row, factor = radii[number]
            return np.asarray(read[id(one)][row] * (factor * scale[self.powers[number]]))

        return values, radius


class _Work:
    """What is to be summed on each side: columns of numbers, and groups of (key, column).

    groups: side -> (key, number of a column) of every sum, and the requests that it is part of
    """

    def __init__(self) -> None:
        self.names = _Names()
        self.groups: dict[str, dict[frozenset[tuple[Key, int]], set[Any]]] = {}
        self.columns: dict[int, tuple[Array, list[Array]]] = {}  # name -> column, what it adds up
        self._products: dict[tuple[int, int], Array] = {}

    def product(self, right: Array, field: Array) -> Array:
        """r·A, once for the same two."""
        name = self.names(right), self.names(field)
        if name not in self._products:
            self._products[name] = right * field
        return self._products[name]

    def group(self, side: str, columns: Mapping[Key, list[Array]], use: Any) -> int:
        """The number of the sum of these columns, each with its key."""
        found = set()
        for key, some in columns.items():
            column = some[0] if len(some) == 1 else np.sum(some, axis=0)
            name = self.names(column)
            self.columns.setdefault(name, (column, some))
            found.add((key, name))
        groups = self.groups.setdefault(side, {})
        groups.setdefault(frozenset(found), set()).add(use)
        return list(groups).index(frozenset(found))

    def summed(self, cloud: Cloud, side: str, bound: bool, targets: Any) -> _Summed:
        """Every sum of a side, and the bounds of their rounding."""
        scene, groups = cloud.scene(side), self.groups[side]
        options = {"targets": targets, "workers": cloud.workers}
        ordered = [sorted(group) for group in groups]
        done = []
        for first in range(0, len(ordered), _SUMS):
            some = ordered[first : first + _SUMS]
            names = list(dict.fromkeys(name for group in some for _, name in group))
            rows = [[(key, names.index(name)) for key, name in group] for group in some]
            fields = [self.columns[name][0] for name in names]
            done.append(grouped(scene, cloud.kernel, fields, rows, **options))
        powers = [sum(group[0][0][1]) - sum(group[0][0][0]) for group in ordered]
        h = cloud.h if targets is None else cloud.h[targets]
        found = _Summed(done, powers, h)
        if bound:
            neighbours = max(one.neighbours for one in done)
            found = found._replace(radii=self._radii(scene, cloud, side, neighbours, options))
        return found

    def _radii(
        self, scene: Particles, cloud: Cloud, side: str, neighbours: int, options: dict[str, Any]
    ) -> list[tuple[Grouped, int, float]]:
        """Bounds of the sums, in units of h: where they are, and a factor. Sums of the same
        requests have one in common.

        Roundings: each of the neighbours and of the group adds one, and factors and scales are made
        in at most _FACTORS. Where all have one h, |s^γ| <= κ^|γ|, and the sizes of a kernel's term
        do for its moments.
        """
        groups, zero = self.groups[side], unit(cloud.dim, 0, 0)
        ordered = [sorted(group) for group in groups]
        classes: dict[Any, list[int]] = {}
        factor = [1.0] * len(ordered)
        for number, uses in enumerate(groups.values()):
            delta, gamma = ordered[number][0][0]
            degree = sum(gamma)
            if scene.one_h:
                factor[number], degree = (float(cloud.kernel.support) * 1.001) ** degree, 0
            classes.setdefault((sum(delta), degree, frozenset(uses)), []).append(number)
        result: dict[int, tuple[Grouped, int, float]] = {}
        longest = max(len(group) for group in ordered)
        room = 1 << (neighbours + longest + _FACTORS - 1).bit_length()
        for order in dict.fromkeys(name[:2] for name in classes):
            mine = [numbers for name, numbers in classes.items() if name[:2] == order]
            keys = dict.fromkeys(
                (delta, gamma if order[1] else zero)
                for numbers in mine
                for i in numbers
                for (delta, gamma), _ in ordered[i]
            )
            fields = [
                np.maximum.reduce([self._magnitude(ordered[i]) for i in numbers])
                for numbers in mine
            ]
            bounds = sizes(scene, cloud.kernel, fields, keys, room, **options)
            for row, numbers in enumerate(mine):
                result |= {i: (bounds, row, factor[i]) for i in numbers}
        return [result[i] for i in range(len(ordered))]

    def _magnitude(self, group: list[tuple[Key, int]]) -> Array:
        """Σ |columns|, and what they add up, of a group."""
        total: Any = 0.0
        for _, name in group:
            for column in self.columns[name][1]:
                total = total + np.abs(column)
        return np.asarray(total)


class _Names:
    """Numbers of arrays, equal for arrays that hold the same: forms make equal factors anew, which
    are to be summed once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Array, int]] = {}  # the array is kept, so its id stays its
        self._alike: dict[bytes, list[tuple[Array, int]]] = {}  # by a sample of their numbers

    def __call__(self, array: Array) -> int:
        if id(array) not in self._known:
            sample = np.ascontiguousarray(array[:: max(1, array.size // 64)]).tobytes()
            others = self._alike.setdefault(sample, [])
            name = next((n for other, n in others if np.array_equal(other, array)), None)
            if name is None:
                name = len(self._known)
                others.append((array, name))
            self._known[id(array)] = array, name
        return self._known[id(array)][1]


def _length_power(h: Array, key: Key) -> Array:
    """h^{|γ|−|δ|}, which takes sums in units of h to units of length."""
    n = sum(key[1]) - sum(key[0])
    result = np.ones_like(h)
    for _ in range(abs(n)):
        result = result * h if n > 0 else result / h
    return result


def adjoint(parts: Sequence[Part]) -> list[Part]:
    """The transposed matrix."""
    return [part.transposed for part in parts]


def scaled(parts: Sequence[Part], factor: Array | float) -> list[Part]:
    """factor_a times every row."""
    return [part.scaled(factor) for part in parts]


def matrix(cloud: Cloud, parts: Sequence[Part], axis: int) -> Any:
    """The component `axis` as a scipy.sparse CSR array (n, n), pair by pair."""
    from scipy.sparse import csr_array, diags_array

    n = cloud.count
    total = csr_array((n, n))
    for part in parts:
        if part.axis != axis:
            continue
        scene = cloud.scene(part.side)
        row, column, terms = pairs_with_terms(scene, cloud.kernel, [part.key], np.arange(n))
        entries = terms[part.key] * _length_power(cloud.h, part.key)[row]
        entries = part.left[row] * entries * part.right[column]
        one = csr_array((entries, (row, column)), shape=(n, n))
        total = total + (diags_array(one.sum(axis=1)) if part.own else one)
    return csr_array(total)


def same(first: Sequence[Part], second: Sequence[Part]) -> bool:
    """Are these the same matrix, factor by factor? Factors may differ by a constant that moves from
    one to the other, and by the roundings that made them; parts whose sides a scalar h makes equal
    are to be written alike."""

    def named(parts: Sequence[Part]) -> dict[Any, list[Part]]:
        found: dict[Any, list[Part]] = {}
        for part in parts:
            if np.any(part.left) and np.any(part.right):
                found.setdefault((part.axis, part.side, part.key, part.own), []).append(part)
        return found

    one, two = named(first), named(second)
    if one.keys() != two.keys():
        return False
    for name, parts in one.items():
        left = list(two[name])
        for part in parts:
            match = next((other for other in left if _alike(part, other)), None)
            if match is None:
                return False
            left.remove(match)
        if left:
            return False
    return True


def _alike(one: Part, two: Part) -> bool:
    """l_a r_b of both equal, to the roundings of eight operations each."""
    at, to = np.argmax(np.abs(one.left)), np.argmax(np.abs(one.right))
    if not two.left[at] or not two.right[to]:
        return False
    u, v = one.left / one.left[at], two.left / two.left[at]
    r, s = one.right * one.left[at], two.right * two.left[at]
    slack = 64.0 * UNIT
    return bool(
        np.all(np.abs(u - v) <= slack * (np.abs(u) + np.abs(v)))
        and np.all(np.abs(r - s) <= slack * (np.abs(r) + np.abs(s)))
    )


def gradient_parts(side: str, axis: int, dim: int, left: Array, right: Array, *, own: bool) -> Part:
    """l_a Σ_b r_b ∂_axis W(x_a − x_b) with respect to x_a, acting on A_b or on A_a."""
    zero = unit(dim, 0, 0)
    return Part(axis, side, (unit(dim, axis), zero), left, right, own)
