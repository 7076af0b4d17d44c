"""From samples to an exact piecewise polynomial: rational coefficients and knots, verified.

The samples are cut into segments that one polynomial fits within their noise; the coefficients of
each are recognised one by one, the surest first, as the simplest fraction inside its confidence
interval (the others are fitted again after each); knots are rational roots of the difference of
neighbouring pieces. What comes out is only accepted if it reproduces every sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sympy import QQ, Poly, Rational

from sphtrunc.audit.constants import significance, simplest_between
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import q

Array = NDArray[np.floating[Any]]
Wide = NDArray[np.floating[Any]]  # np.longdouble

BITS = 256  # of the fixed-point numbers in which exact polynomials are evaluated
DEGREES = (3, 5, 8, 12)  # tried in turn: with the right one there are few segments
MOST_PIECES = 8
CHANCE = 0.02  # of a fraction so simple lying in the interval by accident
#: what noise may look like, in units of the last place: relative to the value, or to the maximum
NOISES = ((16.0, 0.02), (512.0, 0.5), (16.0, 64.0))


def fixed(x: Array, unit: Fraction | float = 1) -> list[int]:
    """x/unit as integers in units of 2^-256 (x and unit are taken as exact)."""
    scale = Fraction(unit)
    up, down = scale.denominator << BITS, scale.numerator
    ratios = (float(v).as_integer_ratio() for v in x)
    return [(n * up) // (m * down) for n, m in ratios]


def values(
    knots: Sequence[Rational], pieces: Sequence[Poly], points: Sequence[int], outside: float = 0.0
) -> Array:
    """The piecewise polynomial at fixed-point points, in integer arithmetic, rounded once."""
    ends = [(int(k.p) << BITS) // int(k.q) for k in knots[1:]]
    tables = [[(int(c.p) << BITS) // int(c.q) for c in piece.all_coeffs()] for piece in pieces]
    one = 1 << BITS
    result = np.full(len(points), outside)
    for i, point in enumerate(points):
        for end, table in zip(ends, tables, strict=True):
            if point <= end:
                total = 0
                for c in table:
                    total = ((total * point) >> BITS) + c
                result[i] = total / one
                break
    return result


def magnitudes(kernel: Kernel, u: Array) -> Array:
    """What the terms of the kernel add up to, whatever way it is written: bounds its rounding.

    The larger of Σ|a_j| u^j, expanded about 0, and of the sum of its truncated powers,
    Σ_knots |p_left − p_right|, each expanded about its knot.
    """
    knots = [float(k) for k in kernel.knots]
    expanded, powers = np.zeros_like(u), np.zeros_like(u)
    index = np.minimum(np.searchsorted(knots[1:], u), len(kernel.pieces) - 1)
    for i, piece in enumerate(kernel.pieces):
        here = index == i
        table = [abs(float(c)) for c in piece.all_coeffs()]
        expanded[here] = np.polyval(table, u[here])
    zero = Poly(0, q, domain=QQ)
    for knot, left, right in zip(
        kernel.knots[1:], kernel.pieces, (*kernel.pieces[1:], zero), strict=True
    ):
        step = [abs(float(c)) for c in (left - right).shift(knot).all_coeffs()]
        inside = u <= float(knot)
        powers[inside] += np.polyval(step, float(knot) - u[inside])
    return np.maximum(expanded, powers)


def reconstruct(
    x: Array, y: Array, unit: float = 2.0**-53, support: float | None = None, scale: float = 0.0
) -> tuple[Kernel, float] | None:
    """The piecewise polynomial with rational knots and coefficients behind samples, or None.

    x: (n,) increasing, x >= 0; y: (n,) values, each with a relative error of a few `unit`.
    Where the support is not given it is found between the last value that is not zero and the next
    sample. scale: what the coefficients are rational multiples of; 0: the value at the origin.

    The kernel, whose support is 1 (its knots are fractions of the support) and whose value is 1 at
    the origin, or y / scale where a scale is given; and the support in units of x.
    """
    inside = np.nonzero(y)[0]
    if len(inside) < 16:
        return None
    last = int(inside[-1])
    supports = [support] if support is not None else _supports(x, last)
    for wanted in supports:
        keep = x < wanted
        u, v = x[keep].astype(np.longdouble) / wanted, y[keep].astype(np.longdouble)
        for noise in NOISES if wanted == supports[0] else NOISES[:1]:
            for degree in DEGREES:
                found = _pieces(u, v, unit, noise, degree, scale)
                if found is not None:
                    kernel, size = found
                    if agrees(kernel, x[keep], v, wanted, size, unit):
                        return kernel, wanted
    return None


def _supports(x: Array, last: int) -> list[float]:
    """Simple numbers between the last sample inside and the first outside, simplest first."""
    low = Fraction(float(x[last]))
    high = Fraction(float(x[last + 1])) if last + 1 < len(x) else low + 3 * (low / (last + 1))
    found: list[Fraction] = []
    ranges = [(low, high)]
    while ranges and len(found) < 3:
        a, b = ranges.pop(0)
        middle = simplest_between(a, b)
        found.append(middle)
        tiny = (high - low) / 2**20
        ranges += [(a, middle - tiny)] if a < middle - tiny else []
        ranges += [(middle + tiny, b)] if middle + tiny < b else []
    return [float(f) for f in sorted(found, key=lambda f: f.denominator)]


def bound(kernel: Kernel, u: Array, unit: float) -> Array:
    """The rounding error of evaluating w(u) in any usual form: (4 degree + 16) roundings a term."""
    return (4 * kernel.degree + 16) * unit * magnitudes(kernel, u)


def agrees(kernel: Kernel, x: Array, y: Array, support: float, size: float, unit: float) -> bool:
    """Whether size · w(x/support) reproduces all the samples within the rounding bound."""
    u = x / support
    model = size * values(kernel.knots, kernel.pieces, fixed(x, support))
    off = np.abs(y - model) > 2 * abs(size) * bound(kernel, u, unit)
    jumps = [float(k) for k in kernel.knots]
    at_knot = np.min(np.abs(u[:, None] - np.array(jumps)), axis=1) < 4 * unit
    return not bool(np.any(off & ~at_knot))


def _pieces(
    u: Array, y: Array, unit: float, noise: tuple[float, float], degree: int, scale: float
) -> tuple[Kernel, float] | None:
    size_of = np.abs(y)
    tolerance = unit * (noise[0] * size_of + noise[1] * np.max(size_of))
    size, start = scale, 0
    knots, pieces = [Rational(0)], list[Poly]()
    reached = 0
    while start < len(u):
        if len(pieces) == MOST_PIECES:
            return None
        stop = _longest(u, y, tolerance, degree, start)
        if stop is None:
            return None
        clean = stop if stop == len(u) else max(start + degree + 2, stop - (stop - start) // 4)
        part = slice(start, clean)
        exact = _recognise(u[part], y[part], tolerance[part], degree, size, unit)
        if exact is None:
            return None
        size, piece = exact
        if pieces:
            knots.append(
                _knot(piece - pieces[-1], *map(float, (u[reached], u[start], u[start - 1])))
            )
        pieces.append(piece)
        off = ~_near(piece, u[start:], y[start:], size, unit)
        reached, start = clean - 1, start + (int(np.argmax(off)) if off.any() else len(off))
    try:
        return Kernel([*knots, Rational(1)], pieces, name="reconstructed"), size
    except ValueError:
        return None


def _near(piece: Poly, u: Array, y: Array, size: float, unit: float) -> NDArray[np.bool_]:
    """Where size · piece(u) is y within the rounding bound."""
    if piece.is_zero:
        zero: NDArray[np.bool_] = np.equal(y, 0)
        return zero
    alone = Kernel([0, 1], [piece])
    model = size * values(alone.knots, alone.pieces, fixed(u))
    near: NDArray[np.bool_] = np.abs(y - model) <= 2 * abs(size) * bound(alone, u, unit)
    return near


def _longest(u: Array, y: Array, tolerance: Array, degree: int, start: int) -> int | None:
    """The end of the longest run of samples from `start` that one polynomial fits."""
    good, bad = start + 2 * (degree + 2), len(u)

    def fits(stop: int) -> bool:
        return _fits(u[start:stop], y[start:stop], tolerance[start:stop], degree)

    if good > len(u) or not fits(good):
        return None
    if fits(len(u)):
        return len(u)
    while bad - good > 1:
        middle = (good + bad) // 2
        good, bad = (middle, bad) if fits(middle) else (good, middle)
    return good


def _fits(u: Array, y: Array, tolerance: Array, degree: int) -> bool:
    """Whether a polynomial passes through the samples (through 200 of them, the last included)."""
    some = slice(None, None, -max(1, len(u) // 200))
    u, y, tolerance = u[some], y[some], tolerance[some]
    middle, half = (u[0] + u[-1]) / 2, (u[-1] - u[0]) / 2
    basis = np.polynomial.chebyshev.chebvander((u - middle) / half, degree)
    orthogonal, _ = _orthogonal(basis / tolerance[:, None])
    target = y / tolerance
    for _ in range(2):  # the second projection removes the rounding of the first
        target = target - orthogonal @ (orthogonal.T @ target)
    return bool(np.max(np.abs(target)) <= 1)


def _orthogonal(columns: Wide) -> tuple[Wide, Wide]:
    """Q and R of the columns by Gram–Schmidt, twice over, in extended precision."""
    left = columns.copy()
    count = left.shape[1]
    right = np.eye(count, dtype=np.longdouble)
    for j in range(count):
        column = left[:, j]
        for _ in range(2):
            overlap = left[:, :j].T @ column
            column = column - left[:, :j] @ overlap
            right[:j, j] = right[:j, j] + overlap
        right[j, j] = np.sqrt(column @ column)
        left[:, j] = column / right[j, j]
    return left, right


def _recognise(
    u: Array, y: Array, tolerance: Array, degree: int, scale: float, unit: float
) -> tuple[float, Poly] | None:
    """The scale (if it was 0, the value at u = 0) and the exact polynomial y/scale on a segment.

    In powers of 1 − u first: at the edge of the support the low ones vanish.
    """
    for edge in (True, False):
        found = _peel(u, y, tolerance, degree, scale, edge)
        if found is not None and _near(found[1], u, y, found[0], unit).all():
            return found
    return None


def _peel(
    u: Array, y: Array, tolerance: Array, degree: int, scale: float, edge: bool
) -> tuple[float, Poly] | None:
    t = 1 - u if edge else u
    powers = np.vander(t, degree + 1, increasing=True)
    size = scale or _at_origin(powers, y, tolerance, edge)
    if not size:
        return None
    known: dict[int, Fraction] = {}
    target, noise = y / size, tolerance / abs(size)
    while len(known) <= degree:
        free = [j for j in range(degree + 1) if j not in known]
        rest = target.copy()
        for j, c in known.items():
            rest -= np.longdouble(c.numerator) / np.longdouble(c.denominator) * powers[:, j]
        basis = powers[:, free] / noise[:, None]
        lengths = np.sqrt(np.sum(basis**2, axis=0))
        orthogonal, triangle = _orthogonal(basis / lengths)
        if not np.all(np.diag(triangle) > 0):
            return None
        inverse = _inverse(triangle) @ orthogonal.T / lengths[:, None]
        estimate = inverse @ (rest / noise)
        spread = 6 * np.sqrt(np.sum(inverse**2, axis=1)) + 2.0**-52 * np.abs(estimate)
        best: tuple[float, int, Fraction] | None = None
        for position, j in enumerate(free):
            value = Fraction(*estimate[position].as_integer_ratio())
            width = Fraction(float(spread[position]))
            simple = simplest_between(value - width, value + width)
            chance = significance(simple, width)
            if best is None or chance < best[0]:
                best = (chance, j, simple)
        if best is None or best[0] > CHANCE:
            return None
        known[best[1]] = best[2]
    exact = [Rational(known[j].numerator, known[j].denominator) for j in range(degree + 1)]
    local = Poly(exact[::-1], q, domain=QQ)
    return size, local.compose(Poly(1 - q, q, domain=QQ)) if edge else local


def _at_origin(powers: Wide, y: Wide, tolerance: Wide, edge: bool) -> Any:
    """The value at u = 0 of the polynomial that fits best, in powers of 1 − u or of u."""
    orthogonal, triangle = _orthogonal(powers / tolerance[:, None])
    if not np.all(np.diag(triangle) > 0):
        return 0.0
    weights = _inverse(triangle) @ (orthogonal.T @ (y / tolerance))
    return weights.sum() if edge else weights[0]


def _inverse(triangle: Wide) -> Wide:
    """The inverse of an upper triangular matrix, row by row from below."""
    count = len(triangle)
    result = np.zeros_like(triangle)
    for i in range(count - 1, -1, -1):
        result[i, i] = 1
        result[i] = (result[i] - triangle[i, i + 1 :] @ result[i + 1 :]) / triangle[i, i]
    return result


def _knot(step: Poly, low: float, high: float, before: float) -> Rational:
    """The rational root of the difference of two pieces in the bracket, of highest multiplicity."""
    roots: dict[Any, int] = step.ground_roots()
    inside = {r: m for r, m in roots.items() if low <= float(r) <= high}
    if inside:
        best = max(inside, key=lambda r: inside[r])
        return Rational(best.p, best.q)
    simple = simplest_between(Fraction(before), Fraction(high))  # the function jumps there
    return Rational(simple.numerator, simple.denominator)
