"""γ: exact beside planes; at corners, spheres and cylinders against integration in other
coordinates, against symmetry, and in the limit of a plane."""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import Any

import pytest
from scipy.integrate import dblquad
from sympy import Rational

from sphtrunc import kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.walls import Wall
from sphtrunc.theory.walls.gamma import (
    beside_cylinder,
    beside_plane,
    beside_sphere,
    between_planes,
    channel_moments,
    in_corner,
)
from sphtrunc.theory.walls.moments import cut_moments

R = Rational
PAIRS = [("cubic-spline", 2), ("cubic-spline", 3), ("wendland-c2", 2), ("quintic-spline", 3)]


@pytest.mark.parametrize(
    ("name", "dim", "eta", "gamma", "slope"),
    [
        ("cubic-spline", 3, "1/2", "3119/3840", "39/80"),
        ("cubic-spline", 3, "1", "29/30", "3/20"),
        ("cubic-spline", 1, "1/2", "307/384", "23/48"),
        ("wendland-c2", 3, "1/2", "108473/131072", "8019/16384"),
        ("wendland-c2-1d", 1, "1", "121/128", "25/128"),
    ],
)
def test_planes_are_exact(name: str, dim: int, eta: str, gamma: str, slope: str) -> None:
    found = beside_plane(kernel(name), dim, eta)
    assert (found.value, *found.slope) == (R(gamma), R(slope))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_channels(dim: int) -> None:
    """γ is the zeroth moment between two walls; a wall out of reach is none."""
    shape = kernel("cubic-spline")
    found = between_planes(shape, dim, "1/3", "4/5")
    zero = (0,) * dim
    assert channel_moments(shape, Operator("value"), dim, 0, "1/3", "4/5")[zero] == found.value
    assert between_planes(shape, dim, "1/3", 2).value == beside_plane(shape, dim, "1/3").value


@pytest.mark.parametrize(
    "operator",
    [
        Operator("gradient"),
        Operator("gradient", "difference", "csph"),
        Operator("laplacian", "brookshaw"),
    ],
    ids=str,
)
def test_moments_in_a_channel(operator: Operator) -> None:
    """One wall out of reach: those of a half space. Turned about: odd moments of the other sign."""
    shape = kernel("quartic-spline")
    half = cut_moments(shape, operator, 1, 3, Wall(R(2, 5)))  # type: ignore[arg-type]
    assert channel_moments(shape, operator, 1, 3, "2/5", "5/2") == half
    one = channel_moments(shape, operator, 1, 3, "2/5", "1/2")
    other = channel_moments(shape, operator, 1, 3, "1/2", "2/5")
    parity = operator.derivatives
    assert all(other[a] == (-1) ** (a[0] + parity) * m for a, m in one.items())


@pytest.mark.parametrize(("name", "dim"), PAIRS)
def test_corners(name: str, dim: int) -> None:
    """On one wall half of the other's γ; on both a quarter; beyond reach a plane; 13 digits."""
    shape = kernel(name)
    plane = float(beside_plane(shape, dim, "1/2").value)
    assert in_corner(shape, dim, 0, 0).value == pytest.approx(0.25, abs=1e-13)
    assert in_corner(shape, dim, 0, "1/2").value == pytest.approx(plane / 2, abs=1e-13)
    assert in_corner(shape, dim, "1/2", shape.support).value == pytest.approx(plane, abs=1e-13)
    one, other = in_corner(shape, dim, "1/2", "1/3"), in_corner(shape, dim, "1/3", "1/2")
    assert one.value == pytest.approx(other.value, abs=1e-14)
    assert one.slope == pytest.approx(other.slope[::-1], abs=1e-13)


def polar(name: str, dim: int, radius: float, distance: float) -> float:
    """∫ Ŵ over a ball by polar coordinates about its own centre, at `distance` from the target."""
    shape = kernel(name)
    sigma = float(shape.normalisation(dim))
    pieces = [[float(c) for c in piece] for piece in shape.coefficients()]
    knots = [float(k) for k in shape.knots]

    def w(q: float) -> float:
        i = next((i for i, k in enumerate(knots[1:]) if q <= k), None)
        return 0.0 if i is None else sum(c * q**j for j, c in enumerate(pieces[i]))

    def over(phi: float, rho: float) -> float:
        q = sqrt(max(rho**2 + distance**2 - 2 * rho * distance * cos(phi), 0.0))
        around = 2 * rho if dim == 2 else 2 * pi * rho**2 * sin(phi)
        return around * sigma * w(q)

    return float(dblquad(over, 0, radius, 0, pi, epsabs=1e-9, epsrel=1e-9)[0])


@pytest.mark.parametrize(("name", "dim"), PAIRS[:3])
def test_spheres_and_discs(name: str, dim: int) -> None:
    shape = kernel(name)
    outside = beside_sphere(shape, dim, "1/2", "4/5").value
    assert outside == pytest.approx(1 - polar(name, dim, 0.8, 1.3), abs=3e-8)
    inside = beside_sphere(shape, dim, "1/2", "6/5", inside=True).value
    assert inside == pytest.approx(polar(name, dim, 1.2, 0.7), abs=3e-8)


SHAPES: dict[str, Any] = {
    "disc": lambda *a, **k: beside_sphere(kernel("wendland-c2"), 2, *a, **k),
    "ball": lambda *a, **k: beside_sphere(kernel("cubic-spline"), 3, *a, **k),
    "cylinder": lambda *a, **k: beside_cylinder(kernel("cubic-spline"), *a, **k),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("inside", [False, True])
def test_a_large_radius_is_a_plane(name: str, inside: bool) -> None:
    """The difference is of first order in 1/R, from above outside and from below inside."""
    found = SHAPES[name]
    shape = kernel("wendland-c2" if name == "disc" else "cubic-spline")
    plane = beside_plane(shape, 2 if name == "disc" else 3, "1/2")
    gaps = [float(plane.value) - found("1/2", r, inside=inside).value for r in (200, 400)]
    assert gaps[0] / gaps[1] == pytest.approx(2, rel=0.02)
    assert (gaps[1] > 0) == inside
    far = found("1/2", 10**10, inside=inside)
    assert far.value == pytest.approx(float(plane.value), abs=1e-10)
    assert far.slope[0] == pytest.approx(float(plane.slope[0]), abs=1e-9)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("inside", [False, True])
def test_slopes(name: str, inside: bool) -> None:
    """Central differences."""
    found = SHAPES[name]
    up, down = (found(f"{5000 + i}/10000", 3, inside=inside).value for i in (1, -1))
    assert found("1/2", 3, inside=inside).slope[0] == pytest.approx((up - down) / 2e-4, abs=1e-7)


def test_bad_places() -> None:
    shape = kernel("lucy")
    with pytest.raises(ValueError, match="eta: got -1, expected a number >= 0"):
        beside_plane(shape, 2, -1)
    with pytest.raises(ValueError, match="radius: got 1 in 2D at a distance of 1"):
        beside_sphere(shape, 2, 1, 1, inside=True)
    with pytest.raises(ValueError, match="radius: got 2 in 1D"):
        beside_sphere(shape, 1, 1, 2)
