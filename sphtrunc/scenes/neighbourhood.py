"""The neighbours of a block of targets, as arrays, and the volumes that depend on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sphtrunc.arithmetic.precision import for_volumes
from sphtrunc.arithmetic.summation import UNIT, Array, dd_add, dd_neg
from sphtrunc.kernels.values import kernel_values

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

Indices: TypeAlias = NDArray[np.int64]
Stretches: TypeAlias = tuple[Any, ...]  # h_a/h of each kernel of a pair, None where that is 1
Both: TypeAlias = tuple[Any, Any]  # values, and what is wanted beside them or None

CELLS = 1 << 15  # candidates of one block: the arrays of a block stay in the second-level cache
EDGE = 1.0 + 1e-12  # what is looked at beyond the support: the kernel decides what is inside


@dataclass(frozen=True, kw_only=True)
class Ghosts:
    """The rows of a neighbourhood that lie beyond a wall, and where their values are read.

    kind: "mirror", "odd" or "dummy"
    rows: (N, 1) whether it is a ghost
    wall: s₁ of the wall, and what is to be added to it, numbers or (1, T) each
    image: (N, 1) s₁ of what a ghost is the image of, of a fluid particle its own; None for dummies
    beside: of the images, as of `Beside`
    """

    kind: str
    rows: NDArray[np.bool_]
    wall: tuple[Any, Any]
    image: Array | None = None
    beside: Array | None = None


class Beside(NamedTuple):
    """What an arithmetic wants beside the floats of a neighbourhood, in shapes that broadcast to
    theirs: the digits that follow, or bounds of what they are off by."""

    offset: Array
    volume: Array
    stretch: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Neighbourhood:
    """The neighbours of a block of T targets, padded to N rows; d dimensions.

    offset: (d, N, T) s = (x_b − x_a)/h; rows of padding lie outside the support
    volume: V_b/h^d, broadcasts to (N, T)
    target: (T,) which targets these are
    particle: (N, T) which particles the rows are, −1 for padding; explicit particles only
    stretch: (N, T) h_a/h_ab where every particle has an h of its own, else None
    mean_kernel: whether a pair takes the mean of two kernels, with h_a and with h_ab
    h: smoothing length of the target, (T,) or 1
    beside: what the arithmetic that was asked for wants besides, None where floats are enough
    ghosts: which rows lie beyond a wall, if there is one with ghosts
    """

    offset: Array
    volume: Array
    target: Indices
    particle: Indices | None = None
    stretch: Array | None = None
    mean_kernel: bool = False
    h: Array | float = 1.0
    beside: Beside | None = None
    ghosts: Ghosts | None = None

    def offsets(self, number: Any) -> list[Any]:
        """Along each axis, in the arithmetic that was asked for."""
        if self.beside is None:
            return [number.number(x) for x in self.offset]
        each = zip(self.offset, self.beside.offset, strict=True)
        return [number.number(x, beside, beside) for x, beside in each]

    def volumes(self, number: Any) -> Any:
        """Likewise."""
        beside = None if self.beside is None else self.beside.volume
        return number.number(self.volume, beside, beside)

    def stretches(self, number: Any) -> Stretches:
        """h_a/h of each of the kernels that a pair takes in equal shares, likewise."""
        if self.stretch is None:
            return (None,)
        beside = None if self.beside is None else self.beside.stretch
        there = number.number(self.stretch, beside, beside)
        return (None, there) if self.mean_kernel else (there,)

    @property
    def distance(self) -> Array:
        """|x_b − x_a| over the h, or the larger h, of the pair, (N, T)."""
        distance = np.sqrt(sum(x * x for x in self.offset))
        if self.stretch is None:
            return np.asarray(distance)
        return np.asarray(
            distance * (np.minimum(self.stretch, 1.0) if self.mean_kernel else self.stretch)
        )


def compact(near: NDArray[np.bool_], arrays: dict[str, Array], far: float) -> dict[str, Array]:
    """Move the rows that are near, (N, T), to the front, in their order, and cut the rest off.

    Arrays are (N, T); padding is 0, or `far` in the array named "s0".
    """
    targets = near.shape[1]
    rank = np.cumsum(near, axis=0, dtype=np.int32)
    rows = int(rank[-1].max()) if rank.size else 0
    kept = np.flatnonzero(near)
    to = (rank.reshape(-1)[kept] - 1).astype(np.int64)
    to *= targets
    to += kept % targets
    result = {}
    for name, values in arrays.items():
        out = np.full(rows * targets, far if name == "s0" else 0.0)
        out[to] = values.reshape(-1)[kept]
        result[name] = out.reshape(rows, targets)
    return result


def wanted(number: Any, low: Any) -> Any:
    """Of digits that follow floats, what an arithmetic wants: them, or a bound of their size."""
    return low if number.wide else np.abs(low) * EDGE


def assemble(
    number: Any,
    volume_rule: str,
    constant: tuple[float, float],
    offset: Array,
    beside: list[Array],
    target: Indices,
    kernel: Kernel,
    reach: int = 1,
) -> Neighbourhood:
    """A neighbourhood from candidates (d, N, T): volumes, and the candidates that count, those
    within so many supports; beside: along each axis what `number` wants, if anything."""
    dim, support = offset.shape[0], float(kernel.support)
    arrays = {f"s{i}": s for i, s in enumerate(offset)}
    arrays |= {f"beside{i}": s for i, s in enumerate(beside)}
    if volume_rule == "cell":
        order = np.argsort(offset[0], axis=0, kind="stable")
        arrays = {n: np.take_along_axis(a, order, axis=0) for n, a in arrays.items()}
        arrays |= cells(number, arrays)
    distance = arrays["s0"] * arrays["s0"]
    for i in range(1, dim):
        distance += arrays[f"s{i}"] * arrays[f"s{i}"]
    near = distance <= (reach * support * EDGE) ** 2
    if volume_rule == "cell":
        near[[0, -1]] = False  # no cell: it ends outside the candidates
    far = (3.0 * reach - 1.0) * support + 1.0
    kept = compact(near, arrays, far)
    volume = kept.get("volume", np.full((1, 1), constant[0]))
    more = kept.get("more", wanted(number, np.full((1, 1), constant[1])))
    packed = np.stack([kept[f"s{i}"] for i in range(dim)])
    if volume_rule == "summation":
        wide = distance <= ((reach + 1) * support * EDGE) ** 2
        around = compact(wide, arrays, far + 3.0 * support)
        here, there = (
            [(a[f"s{i}"], a.get(f"beside{i}")) for i in range(dim)] for a in (kept, around)
        )
        volume, more = summed(number, here, there, kernel)
    return Neighbourhood(
        offset=packed,
        volume=volume,
        target=target,
        beside=Beside(np.stack([kept[f"beside{i}"] for i in range(dim)]), more) if beside else None,
    )


def cells(number: Any, arrays: dict[str, Array]) -> dict[str, Array]:
    """Volumes of 1D particles in order, (N, T): half the distance between the two neighbours; and
    what `number` wants beside them."""
    s = arrays["s0"]
    volume = np.zeros_like(s)
    volume[1:-1] = 0.5 * (s[2:] - s[:-2])
    result = {"volume": volume}
    if number.wide:
        low = arrays["beside0"]
        hi, lo = dd_add((s[2:], low[2:]), dd_neg((s[:-2], low[:-2])))
        result["more"] = np.zeros_like(s)
        volume[1:-1], result["more"][1:-1] = 0.5 * hi, 0.5 * lo
    elif number.bounded:
        error = arrays["beside0"]
        bound = np.zeros_like(s)
        bound[1:-1] = 0.5 * (error[2:] + error[:-2])
        result["more"] = (bound + UNIT * volume) * (1.0 + 1e-9)
    return result


def summed(
    number: Any, offset: list[Both], around: list[Both], kernel: Kernel
) -> tuple[Array, Array]:
    """Summation volumes m/ρ_b = 1/Σ_c Ŵ(s_c − s_b) in units of h^d, for equal masses, and what
    `number` wants beside them, (N, T).

    offset: along each axis, of the particles b, (N, T); around: of every particle within reach of
    them, (M, T); values, and what is wanted beside them
    """
    number = for_volumes(number)
    volume, rest = np.empty((2, *offset[0][0].shape))
    others = [number.number(x, b, b) for x, b in around]
    for b in range(len(volume)):
        rows = [[x if x is None else x[b] for x in one] for one in offset]
        here = [number.number(x, beside, beside) for x, beside in rows]
        s = [c - a for c, a in zip(others, here, strict=True)]
        density = number.total(kernel_values(number, kernel, number.length(s), 0, len(s)))
        own = number.ratio(number.number(np.ones(1)), density)
        own = number.drop(own, number.value(density) <= 0.0)
        volume[b], rest[b] = number.value(own), number.rest(own)
    return volume, rest
