"""Enclosures: what lies beyond walls, plane, in corners, curved, and of files."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sphtrunc import Operator, jittered, kernel, lattice, particles
from sphtrunc.study.flows.annulus import INNER, OUTER, annulus, slowest, velocity
from sphtrunc.study.flows.cases import CASES
from sphtrunc.study.flows.enclosure import bounded, planes
from sphtrunc.study.flows.steady import Solver, system

C2 = kernel("wendland-c2")
SQUARE = lattice(2, dx_over_h="2/3")
ROUNDED = 1e-13  # of values of size 1 and sums of a few tens of them


def everywhere(there: Any, field: Any) -> tuple[Any, Any]:
    """A field at the particles and ghosts as the walls continue it, and as it is."""
    found = there.continued @ field(there.x) + there.wall_part(field)
    return found, field(there.particles.x)


@pytest.mark.parametrize("moved", [SQUARE, jittered(SQUARE, "1/10", seed=4)])
def test_images_continue_what_is_linear_along_each_axis(moved: Any) -> None:
    """(2P₁ − 1)(2P₂ − 1) takes a + bx + cy + dxy to itself, in corners too; x² it does not."""
    there = planes(moved, C2, (8, 9), (True, True), "mirror")
    found, exact = everywhere(there, lambda x: 1 + 2 * x[0] - 3 * x[1] + 5 * x[0] * x[1])
    assert np.abs(found - exact).max() < 10 * ROUNDED
    corners = np.sum((there.particles.x < 0) | (there.particles.x > np.array([[1], [9 / 8]])), 0)
    assert np.count_nonzero(corners == 2) >= 4
    found, exact = everywhere(there, lambda x: x[0] ** 2)
    assert np.abs(found - exact).max() > 0.1


@pytest.mark.parametrize("moved", [SQUARE, jittered(SQUARE, "1/10", seed=4)])
def test_lines_through_the_wall_continue_what_is_linear(moved: Any) -> None:
    """Across a channel, exactly; dummies with Shepard means do not."""
    there = planes(moved, C2, (9, 8), (True, False), "extrapolate")
    found, exact = everywhere(there, lambda x: 2.0 - 3.0 * x[0])
    assert np.abs(found - exact).max() < 10 * ROUNDED
    dummies = planes(moved, C2, (9, 8), (True, False), "dummy")
    found, exact = everywhere(dummies, lambda x: 2.0 - 3.0 * x[0])
    assert 0.05 < np.abs(found - exact).max() < 1.0
    found, exact = everywhere(dummies, lambda x: np.full(x.shape[1], 7.0))
    assert np.abs(found - exact).max() < 10 * ROUNDED


def test_ghosts_fill_the_supports() -> None:
    """Every row between mirrors or dummies sees as many particles as in an endless lattice."""
    for wall in ("mirror", "dummy", "extrapolate"):
        there = planes(SQUARE, C2, (8, 8), (True, True), wall)
        gap = there.x[:, :, None] - there.particles.x[:, None, :]
        near = np.sqrt((gap**2).sum(axis=0)) < 0.97 * float(C2.support) * there.h
        assert set(near.sum(axis=1)) == {25}, wall  # i² + j² <= 8


def test_what_was_written_by_hand_as_a_file_gives_the_same_flow() -> None:
    """The lattice with its dummies as wall particles of a file."""
    operator = Operator("laplacian", "brookshaw")
    case = CASES["poiseuille"]
    there = planes(SQUARE, C2, (9, 7), (True, False), "dummy")
    x = there.particles.x * 5.0 + np.array([[3.0], [0.0]])
    walls = np.arange(x.shape[1]) >= there.count
    given = particles(
        x.T, h=there.h * 5.0, volume=there.spacing**2 * 25.0, period=there.particles.period * 5.0
    )
    read, across = bounded(replace(given, walls=walls), C2, "dummy")
    assert across == 9
    flows = []
    for one in (there, read):
        found = system(one, C2, operator, case.u)
        flows.append(Solver(found.matrix, 2)(case.forcing - found.known))
    assert np.abs(flows[0] - flows[1]).max() < 1e-11


def test_a_glass_between_mirrors_is_a_channel() -> None:
    from sphtrunc.experiment.glasses import glass
    from sphtrunc.scenes.relaxed import Recipe

    home = glass(Recipe(count=256, steps=60)).particles
    there, across = bounded(home, C2, "mirror")
    assert across == 16
    found, exact = everywhere(there, lambda x: 2.0 - 3.0 * x[0])
    assert np.abs(found - exact).max() < 10 * ROUNDED


def test_what_is_missing_is_said() -> None:
    box = particles(np.array([[0.5, 0.5]]), h=1.0, volume=1.0, period=8.0)
    free = particles(np.array([[0.5, 0.5]]), h=1.0, volume=1.0)
    for call, reason in (
        (lambda: planes(SQUARE, C2, (4, 8), (True, False), "mirror"), "got 4 particles across"),
        (lambda: planes(SQUARE, C2, (8, 8), (True, False), "glue"), "got 'glue', expected one of"),
        (
            lambda: planes(SQUARE, C2, (8, 8), (True, False), "none", at="half-way"),
            "pure Neumann",
        ),
        (
            lambda: planes(jittered(SQUARE, "2/5"), C2, (8, 30), (True, False), "mirror"),
            "particles are displaced beyond a wall",
        ),
        (lambda: annulus(SQUARE, C2, 8, "none"), "no particles of a lattice are on a circle"),
        (lambda: annulus(SQUARE, C2, 4, "mirror"), "got 4 particles across the gap"),
        (lambda: annulus(lattice(2, dx_over_h="1/3"), C2, 5, "mirror"), "middle of the inner"),
        (lambda: bounded(box, C2, "dummy"), "needs wall particles, and these have none"),
        (lambda: bounded(box, C2, "none"), "pure Neumann"),
        (lambda: bounded(free, C2, "mirror"), "say where the walls are"),
        (
            lambda: bounded(particles(np.zeros((1, 2)), h=1.0, period=8.0), C2, "mirror"),
            "needs a volume",
        ),
    ):
        with pytest.raises(ValueError, match=reason):
            call()


def test_a_particle_without_neighbours_is_named() -> None:
    small = lattice(2, dx_over_h="3")
    there = planes(small, C2, (8, 8), (True, False), "mirror")
    with pytest.raises(ValueError, match=r"64 of 64 particles have no neighbours .* particle 0 at"):
        system(there, C2, Operator("laplacian", "brookshaw"), CASES["couette"].u)


# -- curved walls ---------------------------------------------------------------------------------


def test_the_exact_flow_turns_with_the_walls_and_is_harmonic() -> None:
    """On the circles, and by second differences of the Cartesian components."""
    angle = np.linspace(0.0, 6.0, 13)
    unit = np.stack([np.cos(angle), np.sin(angle)])
    turn = np.stack([-unit[1], unit[0]])
    assert np.abs(velocity(INNER * unit) - turn).max() < 1e-15
    assert np.abs(velocity(OUTER * unit)).max() < 1e-15
    at, step = 1.4 * unit, 1e-3
    total = -4.0 * velocity(at)
    for axis in (0, 1):
        move = np.zeros((2, 1))
        move[axis] = step
        total = total + velocity(at + move) + velocity(at - move)
    assert np.abs(total / step**2).max() < 1e-4  # step² times fourth derivatives, and rounding


@pytest.mark.parametrize("wall", ["mirror", "dummy", "extrapolate"])
def test_the_error_in_an_annulus_falls(wall: str) -> None:
    """At least as N^−0.8 from 10 to 20 across, for a form that is exact for quadratic fields."""
    operator = Operator("laplacian", "fatehi-manzari")
    sizes = []
    for across in (10, 20):
        there = annulus(SQUARE, C2, across, wall)
        found = system(there, C2, operator, lambda x: velocity(x)[0])
        u = Solver(found.matrix, 2)(-found.known)
        sizes.append(float(np.sqrt(np.mean((u - velocity(there.x)[0]) ** 2))))
    assert sizes[1] < 0.02
    assert sizes[1] < sizes[0] * 2**-0.8


def test_the_slowest_transient_of_an_annulus() -> None:
    """3.1230309 = k of the first zero of the cross product of Bessel functions for a ratio of 2
    (Abramowitz & Stegun 1964, table 9.7)."""
    assert slowest() ** 0.5 == pytest.approx(3.1230309, abs=1e-7)
