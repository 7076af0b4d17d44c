"""What the tests compare with: kernels as plain fractions, and crystals from their unit cells.

Nothing here is taken from sphtrunc but the numbers that a kernel was made of. A shape is a
piecewise polynomial w(q) on 0 <= q <= κ, continued as an even function and by zero; at a knot it is
the mean of both sides. Lattices are built from basis vectors and the places in the cell (Kittel,
Introduction to Solid State Physics, chapter 1), not from integer points that satisfy a congruence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import pairwise, product
from math import comb, floor, inf, perm
from typing import Any, NamedTuple

from mpmath import mp

Piece = Sequence[Fraction]  # coefficients, lowest degree first


class Shape(NamedTuple):
    """0 = k₀ < … < κ, and the polynomial between each two of them."""

    knots: Sequence[Fraction]
    pieces: Sequence[Piece]


def fraction(x: object) -> Fraction:
    """A rational number of SymPy, through its text."""
    return Fraction(str(x))


def shape_of(kernel: Any) -> Shape:
    """The numbers that a kernel was made of."""
    return Shape(
        tuple(fraction(x) for x in kernel.knots),
        tuple(tuple(fraction(c) for c in piece) for piece in kernel.coefficients()),
    )


# ------------------------------------------------------------------------------------- polynomials


def horner(piece: Sequence[Any], x: Any) -> Any:
    """Σ c_i x^i, of whatever numbers."""
    total = 0 * x
    for c in reversed(piece):
        total = total * x + c
    return total


def differentiated(piece: Piece, times: int = 1) -> Piece:
    if not times:
        return piece
    return [c * perm(i, times) for i, c in enumerate(piece)][times:] or [Fraction(0)]


def expanded(piece: Piece, b: Fraction) -> list[Fraction]:
    """The coefficients in powers of t = b − q."""
    return [
        (-1) ** j * sum(c * comb(i, j) * b ** (i - j) for i, c in enumerate(piece) if i >= j)
        for j in range(len(piece))
    ]


def multiplied(p: Piece, r: Piece) -> list[Fraction]:
    found = [Fraction(0)] * (len(p) + len(r) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(r):
            found[i + j] += a * b
    return found


def added(p: Piece, r: Piece) -> list[Fraction]:
    longer, shorter = (p, r) if len(p) >= len(r) else (r, p)
    return [c + (shorter[i] if i < len(shorter) else 0) for i, c in enumerate(longer)]


# ------------------------------------------------------------------------------------------ shapes


def integral(shape: Shape, power: int, derivative: int = 0) -> Fraction:
    """∫₀^κ q^power w^{(derivative)}(q) dq, without what stands at jumps."""
    total = Fraction(0)
    for (a, b), piece in zip(pairwise(shape.knots), shape.pieces, strict=True):
        for i, c in enumerate(differentiated(piece, derivative)):
            n = i + power + 1
            total += c * (b**n - a**n) / n
    return total


def mass(shape: Shape, dim: int = 1) -> Fraction:
    """∫ w d^d s, but for the factor π of the plane and of space."""
    return (2, 2, 4)[dim - 1] * integral(shape, dim - 1)


def one_sided(shape: Shape, x: Fraction, side: int, derivative: int = 0) -> Fraction:
    """The limit at x >= 0 from above (side = 1) or from below (−1); zero beyond the support."""
    for (a, b), piece in zip(pairwise(shape.knots), shape.pieces, strict=True):
        if a < x < b or (x == a and side > 0) or (x == b and side < 0):
            return Fraction(horner(differentiated(piece, derivative), x))
    if x == 0:  # from below: that of the even function
        return (-1) ** derivative * one_sided(shape, x, 1, derivative)
    return Fraction(0)


def mean_value(shape: Shape, s: Fraction, derivative: int = 0) -> Fraction:
    """w^{(derivative)}(s) of the even function, the mean of both sides; not normalised."""
    x = abs(s)
    mean = one_sided(shape, x, 1, derivative)
    if x in shape.knots:
        mean = (mean + one_sided(shape, x, -1, derivative)) / 2
    return mean if s >= 0 else (-1) ** derivative * mean


def jump(shape: Shape, index: int, derivative: int) -> Fraction:
    """[w^{(derivative)}] of the even function at the knot with this index; not normalised."""
    x = shape.knots[index]
    return one_sided(shape, x, 1, derivative) - one_sided(shape, x, -1, derivative)


def continuous_derivatives(shape: Shape, index: int) -> float:
    """How many at this knot: −1 if w itself jumps, inf if all are continuous."""
    degree = max(len(p) for p in shape.pieces)
    return next((m - 1 for m in range(degree) if jump(shape, index, m)), inf)


def line_sum(
    shape: Shape, derivative: int, power: int, dx: Fraction, theta: Fraction = Fraction(0)
) -> Fraction:
    """(−1)^m Δs Σ_j s_j^power Ŵ^{(m)}(s_j) over s_j = (j + θ)Δs, with Ŵ = w/∫w and m = derivative:
    what Euler and Maclaurin are asked about, particle by particle."""
    reach = shape.knots[-1]
    total = Fraction(0)
    for j in range(floor(-reach / dx - theta), floor(reach / dx - theta) + 2):
        s = (j + theta) * dx
        total += s**power * mean_value(shape, s, derivative)
    return (-1) ** derivative * dx * total / mass(shape)


# --------------------------------------------------------------------------------------- crystals


#: every lattice there is, and its dimension
CRYSTALS = {
    "uniform": 1,
    "square": 2,
    "hexagonal": 2,
    "cubic": 3,
    "bcc": 3,
    "fcc": 3,
    "hcp": 3,
}


class Crystal(NamedTuple):
    """Basis vectors and the places in the cell, in units of the lattice constant; `sites` in a cell
    of this volume, so that the constant for one site a unit volume is (sites/volume)^{1/d}."""

    basis: Any
    places: Any
    volume: Any


def crystal(kind: str) -> Crystal:
    """The conventional cell, in the digits of the day."""
    half, third, root = mp.mpf(1) / 2, mp.mpf(1) / 3, mp.sqrt
    if kind == "uniform":
        return Crystal([[1]], [[0]], 1)
    if kind == "square":
        return Crystal([[1, 0], [0, 1]], [[0, 0]], 1)
    if kind == "hexagonal":  # one row of neighbours along x
        return Crystal([[1, 0], [half, root(3) / 2]], [[0, 0]], root(3) / 2)
    if kind == "hcp":  # layers A B A B, one upon the hollows of the other: c = a √(8/3)
        c = root(mp.mpf(8) / 3)
        basis = [[1, 0, 0], [half, root(3) / 2, 0], [0, 0, c]]
        return Crystal(basis, [[0, 0, 0], [third, third, half]], root(3) / 2 * c)
    cube = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    places = {
        "cubic": [[0, 0, 0]],
        "bcc": [[0, 0, 0], [half, half, half]],
        "fcc": [[0, 0, 0], [half, half, 0], [half, 0, half], [0, half, half]],
    }
    return Crystal(cube, places[kind], 1)


def sites(kind: str, reach: Any, offset: Sequence[Fraction] = ()) -> Iterator[list[Any]]:
    """Places of the particles within `reach` of the target, one a unit volume; lengths in Δx.

    offset: of the lattice relative to the target
    """
    cell = crystal(kind)
    basis, dim = cell.basis, len(cell.basis)
    constant = mp.root(mp.mpf(len(cell.places)) / cell.volume, dim)
    shift = [number(o) for o in offset] or [mp.zero] * dim
    # no basis vector is shorter than 1 nor closer than 60° to another: 1/sin 60° < 1.2
    most = int(1.2 * (reach + mp.norm(shift)) / constant) + 2
    for index in product(range(-most, most + 1), repeat=dim):
        for place in cell.places:
            steps = [n + p for n, p in zip(index, place, strict=True)]
            x = [
                shift[i] + constant * mp.fsum(n * e[i] for n, e in zip(steps, basis, strict=True))
                for i in range(dim)
            ]
            if mp.fsum(v * v for v in x) <= reach**2:
                yield x


def number(x: Fraction) -> Any:
    return mp.mpf(x.numerator) / x.denominator


# ------------------------------------------------------------------------------- terms of the sums


def normalised(shape: Shape, dim: int) -> Any:
    """σ_d: 1/∫ w d^d s, π and all."""
    return 1 / (number(mass(shape, dim)) * (1 if dim == 1 else mp.pi))


def terms(shape: Shape) -> Callable[[Any, Sequence[Any]], Any]:
    """(δ, s) -> (−1)^{|δ|} ∂^δ w(|s|) in the digits of the day, |δ| <= 2; −w′/q for "brookshaw" and
    −w′/q³ for "fatehi-manzari". Not normalised. What has no value at s = 0 is 0 there."""
    pieces = [
        (number(end), [[number(c) for c in differentiated(piece, m)] for m in range(3)])
        for end, piece in zip(shape.knots[1:], shape.pieces, strict=True)
    ]

    def term(delta: Any, s: Sequence[Any]) -> Any:
        square = mp.fsum(x * x for x in s)
        inside = next((p for end, p in pieces if square < end**2), None)
        if inside is None:
            return mp.zero
        q = mp.sqrt(square)
        w, dw, d2w = (horner(p, q) for p in inside)
        if isinstance(delta, str):
            return mp.zero if q == 0 else -dw / q ** {"brookshaw": 1, "fatehi-manzari": 3}[delta]
        if sum(delta) == 0:
            return w
        if sum(delta) == 1:
            return mp.zero if q == 0 else -dw * s[delta.index(1)] / q
        i, j = (axis for axis, times in enumerate(delta) for _ in range(times))
        if q == 0:
            return d2w * (i == j)
        along = s[i] * s[j] / square
        return d2w * along + dw / q * ((i == j) - along)

    return term


def monomial(s: Sequence[Any], alpha: Sequence[int]) -> Any:
    return mp.fprod(x**n for x, n in zip(s, alpha, strict=True))
