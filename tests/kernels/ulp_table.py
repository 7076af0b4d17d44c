"""How far the floating-point kernels are from the exact ones: writes tests/kernels/ulp.csv.

    python tests/kernels/ulp_table.py [--points 100000] [--only NAME ...] [-o tests/kernels/ulp.csv]

A row for every catalogue name, dimension, precision and function (w, dw, d2w): the number of
points, the largest error and the q where it occurs (hexadecimal, hence exact). The unit is

    w          the distance between floats at the exact value ("ULP"; the smallest subnormal below
               the normal range),
    dw, d2w    eps Σ|c_i t^i|, with c_i the exact coefficients of the piece about its outer end b,
               t = b − q, and eps = 2^-52 (float64) or 2^-23 (float32).

The points are all floats next to the knots, distances to the knots from 2^-1074 to 1 on a
logarithmic scale, binary fractions of every piece and their neighbours, tiny and huge q, and
uniformly random ones in the support. The oracle works in integers: q = N 2^-E is a rational, so
Horner's rule from the kernel's exact coefficients has no rounding at all; π carries 400 bits. At a
knot where the function jumps, the value meant is the mean of both sides. Some minutes on one core.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from fractions import Fraction
from itertools import pairwise
from math import gcd, inf, lcm, ulp
from pathlib import Path

import numpy as np
from mpmath import mp, workprec
from oracle import Shape, differentiated, expanded, mass, one_sided, shape_of

from sphtrunc import Kernel, kernel
from sphtrunc.kernels.catalogue import names

TABLE = Path(__file__).parent / "ulp.csv"
FIELDS = ["kernel", "dim", "dtype", "function", "points", "max", "worst_q"]
FUNCTIONS = {"w": 0, "dw": 1, "d2w": 2}
DTYPES = {"float64": np.float64, "float32": np.float32}
PI_BITS = 400


def inverse_pi() -> int:
    """2^PI_BITS / π as an integer."""
    with workprec(PI_BITS + 40):
        return int(mp.floor(mp.mpf(2) ** PI_BITS / mp.pi))


class Exact:
    """One derivative of one kernel, evaluated without rounding; in any dimension."""

    def __init__(self, shape: Kernel, derivative: int) -> None:
        given = shape_of(shape)
        self.knots = given.knots
        self.mass = {d: mass(given, d) for d in (1, 2, 3)}
        self.pieces = [differentiated(p, derivative) for p in given.pieces]
        self.local = [
            [float(abs(c)) for c in expanded(p, b)]
            for p, b in zip(self.pieces, self.knots[1:], strict=True)
        ]
        self.scale = lcm(*(c.denominator for p in self.pieces for c in p))
        self.whole = [[int(c * self.scale) for c in p] for p in self.pieces]

    def rational(self, q: float) -> Fraction:
        """The function (not normalised) at one float; the mean of both sides at a knot."""
        if q == inf:
            return Fraction(0)
        x = Fraction(q)
        shape = Shape(self.knots, self.pieces)
        right = one_sided(shape, x, 1)
        return right if x == 0 else (right + one_sided(shape, x, -1)) / 2

    def numerators(self, points: np.ndarray) -> tuple[list[int], list[int]]:
        """Integers n, e with the function at points[k] equal to n[k] / (2 scale 2^{e[k]})."""
        numerators, exponents = [], []
        floats = points.tolist()
        for q in floats:
            if q == inf:
                numerators.append(0)
                exponents.append(0)
                continue
            n, denominator = q.as_integer_ratio()
            e = denominator.bit_length() - 1
            i = self._index(q)
            if i < 0:
                x = self.rational(q) * 2 * self.scale
                shift = x.denominator.bit_length() - 1
                numerators.append(x.numerator)
                exponents.append(shift)
                continue
            if i == len(self.whole):
                numerators.append(0)
                exponents.append(0)
                continue
            total, shift = 0, 0
            for c in reversed(self.whole[i]):
                total = total * n + (c << shift)
                shift += e
            numerators.append(2 * total)
            exponents.append(shift - e)
        return numerators, exponents

    def _index(self, q: float) -> int:
        """The piece that holds q, the number of pieces beyond the support, −1 on a knot."""
        for i, knot in enumerate(self.knots[1:]):
            if q < knot:
                return i
            if q == knot:
                return -1
        return len(self.whole)

    def terms(self, points: np.ndarray, sigma: float) -> np.ndarray:
        """σ Σ|c_i t^i| of the local expansion; on a knot the larger side's."""
        ends = [float(k) for k in self.knots]
        rests = [float(k - Fraction(end)) for k, end in zip(self.knots, ends, strict=True)]
        result = np.zeros(points.shape)
        q = points.astype(np.float64)
        for i, coefficients in enumerate(self.local):
            a, b = np.nextafter(ends[i], -inf), np.nextafter(ends[i + 1], inf)
            inside = (q >= a) & (q <= b)
            t = np.abs((ends[i + 1] - q[inside]) + rests[i + 1])
            total = np.zeros_like(t)
            for c in reversed(coefficients):
                total = total * t + sigma * c
            result[inside] = np.maximum(result[inside], total)
        return result


def errors(
    exact: Exact, points: np.ndarray, computed: dict[int, np.ndarray], in_terms: bool
) -> dict[int, np.ndarray]:
    """The error of each computed value, in eps Σ|terms| or in ULP, for each dimension."""
    single = points.dtype == np.float32
    eps, smallest = (2.0**-23, 2.0**-149) if single else (2.0**-52, 2.0**-1074)
    numerators, exponents = exact.numerators(points)
    result = {}
    for dim, values in computed.items():
        mass = exact.mass[dim]
        pi_scaled, pi_bits = (1, 0) if dim == 1 else (inverse_pi(), PI_BITS)
        factor, divisor = mass.denominator * pi_scaled, 2 * exact.scale * mass.numerator
        common = gcd(factor, divisor)
        factor, divisor = factor // common, divisor // common
        if divisor < 0:
            factor, divisor = -factor, -divisor
        distances = []
        for n, e, y in zip(numerators, exponents, values.tolist(), strict=True):
            target, below = n * factor, divisor << (e + pi_bits)
            top, bottom = y.as_integer_ratio()
            difference = abs(top * below - target * bottom)
            if in_terms:
                distances.append(difference / (below * bottom))
            else:
                near = abs(target / below)
                unit = max(ulp(near), smallest)
                if single:
                    unit = max(float(np.spacing(np.float32(near))), smallest)
                unit_top, unit_bottom = unit.as_integer_ratio()
                distances.append(difference * unit_bottom / (below * bottom * unit_top))
        distance = np.array(distances)
        if in_terms:
            sigma = abs(float(1 / mass)) / (1 if dim == 1 else np.pi)
            distance /= np.maximum(eps * exact.terms(points, sigma), smallest)
        result[dim] = distance
    return result


def sample(shape: Kernel, dtype: type, count: int, seed: int = 0, parts: int = 64) -> np.ndarray:
    """At least `count` points q ≥ 0 where floating-point kernels go wrong, if they do."""
    generator = np.random.default_rng(seed)
    knots = [float(k) for k in shape.knots]
    edge = knots[-1]
    near: list[np.ndarray] = [np.array([0.0, inf, 1e30, 2 * edge])]
    smallest, tiny = (2.0**-149, 2.0**-126) if dtype is np.float32 else (2.0**-1074, 2.0**-1022)
    near.append(np.array([1, 2, 3]) * smallest)
    near.append(np.array([tiny, 3 * tiny, 1e-30, 1e-20, 1e-10, 1e-5]))
    steps = np.arange(-6, 7)
    anchors = set(knots[1:])
    for a, b in pairwise(knots):
        anchors.update((a + (b - a) * np.arange(1, parts) / parts).tolist())
    for anchor in sorted(anchors):
        rounded = dtype(anchor)
        near.append((float(rounded) + steps * float(np.spacing(rounded))).astype(np.float64))
    logarithmic = max(16, count // (8 * len(knots)))
    for knot in knots:
        distance = 2.0 ** generator.uniform(-54 if dtype is np.float64 else -26, 0, logarithmic)
        near.append(np.concatenate([knot - distance, knot + distance]))
    special = np.concatenate(near).astype(dtype)
    special = special[special >= 0]
    rest = generator.uniform(0, edge * 1.001, max(0, count - special.size)).astype(dtype)
    return np.concatenate([special, rest])


def rows(name: str, dtype: str, count: int, seed: int = 0) -> list[dict[str, object]]:
    """The rows of the table for one kernel in one precision."""
    shape = kernel(name)
    points = sample(shape, DTYPES[dtype], count, seed)
    result: list[dict[str, object]] = []
    for function, derivative in FUNCTIONS.items():
        computed = {d: getattr(shape, function)(points, d) for d in (1, 2, 3)}
        for dim, error in errors(
            Exact(shape, derivative), points, computed, derivative > 0
        ).items():
            worst = int(np.argmax(error))
            result.append(
                dict(
                    zip(
                        FIELDS,
                        [
                            name,
                            dim,
                            dtype,
                            function,
                            points.size,
                            f"{error[worst]:.3f}",
                            float(points[worst]).hex(),
                        ],
                        strict=True,
                    )
                )
            )
    return result


def bound(name: str, function: str) -> float:
    """The largest error allowed, in the units of the table."""
    if function == "w" and kernel(name).degree > 11:
        return 8
    return 4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--only", nargs="*", help="kernel names instead of the whole catalogue")
    parser.add_argument("-o", "--output", type=Path, default=TABLE)
    arguments = parser.parse_args()
    started, worst = time.monotonic(), dict.fromkeys(FUNCTIONS, (0.0, ""))
    table = []
    for name in arguments.only or names():
        for dtype in DTYPES:
            for row in rows(name, dtype, arguments.points):
                table.append(row)
                seen = float(str(row["max"]))
                worst[str(row["function"])] = max(
                    worst[str(row["function"])],
                    (seen, f"{row['kernel']} {row['dim']}D {row['dtype']}"),
                )
                if seen > bound(name, str(row["function"])):
                    print("over the bound:", row, file=sys.stderr)
    with arguments.output.open("w", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    print(f"{len(table)} rows in {time.monotonic() - started:.0f} s; largest: {worst}")


if __name__ == "__main__":
    main()
