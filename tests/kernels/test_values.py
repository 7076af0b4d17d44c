"""Values of kernels in numbers with a bound: whatever a ball holds has its value in the result."""

from __future__ import annotations

from fractions import Fraction
from math import nextafter

import numpy as np
import pytest
from oracle import fraction, mass, one_sided, shape_of

from sphtrunc import derive, kernel, lattice, measure
from sphtrunc.arithmetic.bounded import Ball, Bounded
from sphtrunc.arithmetic.plain import Plain
from sphtrunc.kernels.values import kernel_values

#: that jump, or whose slope or curvature jumps, at the edge or inside; knots that no float can say
ROUGH = [
    *("polynomial:-1", "polynomial:0", "polynomial:1", "b-spline:2", "cubic-spline"),
    *("core-triangle", "0..1/3: 1-q; 1/3..1: (1-q)^2*3/2", "0..1: 2-q; 1..2: 3*(2-q)"),
]
RADII = [0.0, 2.0**-90, 2.0**-60, 2.0**-54, 2.0**-53, 3 * 2.0**-53, 1e-14, 1e-9]


@pytest.mark.parametrize("name", ROUGH)
@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize("radius", RADII)
def test_a_ball_at_a_knot_holds_the_values_of_both_sides(name, derivative, radius) -> None:
    """Middles on the floats around each knot, however little is known to be missing of them."""
    k = kernel(name)
    shape = shape_of(k)
    for knot in shape.knots[1:]:
        middle = float(knot)
        below, above = nextafter(middle, 0.0), nextafter(middle, 9.0)
        for q in (nextafter(below, 0.0), below, middle, above, nextafter(above, 9.0)):
            ball = kernel_values(
                Bounded(Plain()), k, Ball(np.array([q]), np.array([radius])), derivative, 1
            )
            low, high = Fraction(q) - Fraction(radius), Fraction(q) + Fraction(radius)
            inside = [(low, 1), (low, -1), (high, 1), (high, -1)]
            inside += [(knot, 1), (knot, -1)] * (low < knot < high)
            if low == high == knot:  # known exactly: the mean of both sides
                sides = [one_sided(shape, knot, side, derivative) for side in (1, -1)]
                truths = [sum(sides) / 2]
            else:  # on an end that is a knot, what lies within the ball
                truths = [
                    one_sided(shape, x, side, derivative)
                    for x, side in inside
                    if not (x == knot == high and side > 0) and not (x == knot == low and side < 0)
                ]
            value, bound = Fraction(float(ball.middle[0])), Fraction(float(ball.radius[0]))
            for truth in truths:
                assert abs(truth / mass(shape) - value) <= bound


@pytest.mark.parametrize(
    "missing", [Fraction(1, 10**20), Fraction(-1, 10**20), Fraction(1, 10**17)]
)
@pytest.mark.parametrize(
    ("name", "operator"),
    [("polynomial:-1", "value"), ("polynomial:0", "gradient"), ("b-spline:2", "gradient")],
)
def test_a_particle_beside_the_edge_by_less_than_a_rounding(name, operator, missing) -> None:
    """Its place is rounded to the very edge, where kernel or slope jump: inside or outside, and not
    the mean of both, is the truth, and the bound says that this is not known."""
    ratio = Fraction(1, 2) + missing
    assert float(2 * ratio) == 1.0
    found = measure(lattice(1, None, ratio), name, operator, moments=1, bound=True)
    derived = derive(name, operator, dx_over_h=ratio, degree=1).discrete
    assert derived is not None
    assert found.moment_bound is not None
    for k in (0, 1):
        gap = abs(Fraction(float(found.moments[k,][0])) - fraction(derived[k]))
        assert gap <= Fraction(float(found.moment_bound[k,][0]))
