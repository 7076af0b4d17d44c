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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array
from sphtrunc.experiment.engine import one_pass, pairs_with_terms
from sphtrunc.operators.moments import unit
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.particles import particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.particles import Particles

#: side of a pair whose h the kernel takes: mode of the engine
SIDES = {"a": "gather", "b": "scatter", "mean": "mean"}
_SUMS = 96  # of one pass; more are taken in passes of one key each
#: factors are made in at most eight roundings; the engine allows at least u/2 for each product
_FACTORS = 1.0 + 2.0 * 8.0


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
    """What parts do to a field: (d, n) by axis, the bound of its rounding, and the sum of the sizes
    of the parts."""

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

    requests: (parts, field), the field (n,), or (d, n) where each part takes the component of its
        axis; targets: indices (T,) of the rows that are wanted, None for all
    Raises ValueError as the engine does.
    """
    at: Any = slice(None) if targets is None else np.asarray(targets)
    sources: dict[tuple[str, bytes, bytes], int] = {}  # (side, r, A or nothing) -> row
    rows: dict[str, list[Array]] = {}
    keys: dict[str, dict[int, dict[Key, None]]] = {}
    placed: list[list[int]] = []
    named = _Names()
    for parts, field in requests:
        columns = [field[i] for i in range(cloud.dim)] if field.ndim == 2 else [field] * cloud.dim
        places = []
        for part in parts:
            acted = columns[part.axis]
            name = (part.side, named(part.right), b"" if part.own else named(acted))
            if name not in sources:
                there = rows.setdefault(part.side, [])
                sources[name] = len(there)
                there.append(part.right if part.own else part.right * acted)
            keys.setdefault(part.side, {}).setdefault(sources[name], {})[part.key] = None
            places.append(sources[name])
        placed.append(places)
    sums: dict[tuple[str, Key, int], tuple[Array, Any]] = {}
    for side, fields in rows.items():
        sums |= _passes(cloud, side, fields, keys[side], bound, targets)
    result = []
    for (parts, field), places in zip(requests, placed, strict=True):
        value, error, size = np.zeros((3, cloud.dim, cloud.h[at].size))
        for part, place in zip(parts, places, strict=True):
            total, radius = sums[part.side, part.key, place]
            left = part.left[at]
            if part.own:
                left = left * (field if field.ndim == 1 else field[part.axis])[at]
            term = left * total
            value[part.axis] += term
            size[part.axis] += np.abs(term)
            if bound:
                error[part.axis] += np.abs(left) * radius * _FACTORS
        if bound:  # products and sums at the target
            error += (len(parts) + 12.0) * UNIT * size
        result.append(Action(value, error if bound else None, size))
    return result


class _Names:
    """Arrays by what they hold: forms make equal factors anew, which are to be summed once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Array, bytes]] = {}  # the array is kept, so its id stays its

    def __call__(self, array: Array) -> bytes:
        if id(array) not in self._known:
            data = np.ascontiguousarray(array).tobytes()
            self._known[id(array)] = array, blake2b(data, digest_size=16).digest()
        return self._known[id(array)][1]


def _passes(
    cloud: Cloud,
    side: str,
    fields: list[Array],
    keys: dict[int, dict[Key, None]],
    bound: bool,
    targets: Any,
) -> dict[tuple[str, Key, int], tuple[Array, Any]]:
    """The sums that are asked for on one side, in units of length, and their bounds."""
    scene = cloud.scene(side)
    every = list(dict.fromkeys(key for wanted in keys.values() for key in wanted))
    groups: list[tuple[list[int], list[Key]]] = [(sorted(keys), every)]
    if len(every) * len(fields) > _SUMS:
        groups = [([f for f in sorted(keys) if key in keys[f]], [key]) for key in every]
    found: dict[tuple[str, Key, int], tuple[Array, Any]] = {}
    for chosen, some in groups:
        done = one_pass(
            scene,
            cloud.kernel,
            (),
            fields=np.stack([fields[f] for f in chosen]),
            field_keys=some,
            bound=bound,
            targets=targets,
            workers=cloud.workers,
        ).sums()
        for key in some:
            scale = _length_power(cloud.h[done.targets], key)
            for row, f in enumerate(chosen):
                radius = None
                if bound:
                    assert done.fields_bound is not None
                    radius = done.fields_bound[key][row] * scale
                found[side, key, f] = done.fields[key][row] * scale, radius
    return found


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
