"""Walls: cut moments in closed form, Euler–Maclaurin with a wall, ghosts, on lattices.

The oracle is a sum particle by particle in fractions that shares no code with what it judges: it
evaluates the pieces itself, and reads fields at places, not through moments.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st
from sympy import Rational

from sphtrunc import Kernel, kernel
from sphtrunc.theory.walls import (
    cut_lattice_sums,
)
from tests.strategies import kernels, ratios

DEEP = settings().max_examples if settings().max_examples > 1000 else None
HALF = Fraction(1, 2)


def examples(count: int) -> settings:
    """`count` of them in CI, more in the deep profile."""
    return settings(max_examples=DEEP or count)


def whole(x: Any) -> Fraction:
    return Fraction(int(x.p), int(x.q)) if isinstance(x, Rational) else Fraction(x)


# ------------------------------------------------------------------------------------- the oracle


class Direct:
    """A kernel in 1D as functions of s in fractions, normalised; at a knot the mean of sides."""

    def __init__(self, shape: Kernel) -> None:
        self.knots = [whole(k) for k in shape.knots]
        self.pieces = [[whole(c) for c in piece] for piece in shape.coefficients()]
        mass = sum(
            c * (b ** (i + 1) - a ** (i + 1)) / (i + 1)
            for a, b, piece in zip(self.knots, self.knots[1:], self.pieces, strict=False)
            for i, c in enumerate(piece)
        )
        self.pieces = [[c / (2 * mass) for c in piece] for piece in self.pieces]
        slopes = [[i * c for i, c in enumerate(piece)][1:] for piece in self.pieces]
        curves = [[i * c for i, c in enumerate(piece)][1:] for piece in slopes]
        self.rows = [self.pieces, slopes, curves]

    def at(self, s: Fraction, derivative: int) -> Fraction:
        """(−1)^δ Ŵ^(δ)(s)."""
        q = abs(s)
        sides = [
            piece
            for a, b, piece in zip(self.knots, self.knots[1:], self.rows[derivative], strict=False)
            if a <= q <= b
        ]
        if q == self.knots[-1]:
            sides.append([])
        if not sides or (s == 0 and derivative == 1):
            return Fraction(0)
        value = sum(
            (sum((c * q**i for i, c in enumerate(piece)), Fraction(0)) for piece in sides),
            Fraction(0),
        ) / len(sides)
        return -value if derivative == 1 and s > 0 else value


def fluid(
    eta: Fraction, ratio: Fraction, theta: Fraction, reach: Fraction, weight: Fraction
) -> list[tuple[Fraction, Fraction]]:
    """(s, share) of the particles between the wall and s = reach."""
    found = []
    for j in range(int((-reach - 1) / ratio - theta) - 2, int((reach + 1) / ratio - theta) + 3):
        s = (j + theta) * ratio
        if -eta <= s <= reach:
            found.append((s, weight if s == -eta else Fraction(1)))
    return found


# ----------------------------------------------------------------------- Euler–Maclaurin and a wall

etas = st.fractions(0, 3, max_denominator=30)


@examples(1000)
@given(
    kernels(degree=6, most=4),
    etas,
    st.one_of(st.sampled_from([Fraction(0), HALF]), st.fractions(0, 1, max_denominator=9)),
    ratios,
    st.integers(0, 2),
    st.integers(0, 4),
    st.sampled_from([HALF, Fraction(1)]),
)
@example(kernel("cubic-spline"), Fraction(0), Fraction(0), HALF, 1, 0, Fraction(1))  # on the target
@example(kernel("polynomial:-1"), Fraction(1), Fraction(0), HALF, 0, 0, HALF)  # a top-hat
@example(kernel("polynomial:-1"), Fraction(2), Fraction(0), HALF, 0, 0, HALF)  # cut at its edge
@example(kernel("spiky"), Fraction(0), Fraction(0), Fraction(1, 3), 1, 0, Fraction(1))
def test_euler_maclaurin_with_a_wall_is_the_sum_particle_by_particle(
    shape: Kernel,
    eta: Fraction,
    at: Fraction,
    ratio: Fraction,
    delta: int,
    k: int,
    weight: Fraction,
) -> None:
    """Equal as fractions: any kernel, distance, place of the wall in the lattice, ratio, moment."""
    theta = at - eta / ratio
    delta = delta if shape.smoothness >= 1 else min(delta, 1)
    key = (delta,), (k,)
    r, t, e, w = (Rational(x.numerator, x.denominator) for x in (ratio, theta, eta, weight))
    found = cut_lattice_sums(shape, [key], e, r, t, w)[key]
    direct = Direct(shape)
    expected = ratio * sum(
        (
            share * s**k * direct.at(s, delta)
            for s, share in fluid(eta, ratio, theta, direct.knots[-1], weight)
        ),
        Fraction(0),
    )
    assert whole(found) == expected
