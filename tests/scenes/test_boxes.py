"""Boxes: particles between walls against what is derived for planes, channels and corners."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sphtrunc import jittered, kernel, lattice, measure
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.boxes import box
from sphtrunc.theory.walls.gamma import channel_moments, in_corner

VALUE = Operator("value")


@pytest.mark.parametrize(
    "operator", [VALUE, Operator("gradient"), Operator("gradient", "difference", "csph")], ids=str
)
def test_a_channel_is_what_fine_particles_tend_to(operator: Operator) -> None:
    """Second order: half-way. The width is 5/4, less than the support of 4."""
    alpha = (2,) if operator.derivatives else (0,)
    limit = channel_moments(kernel("cubic-spline"), operator, 1, 2, "3/16", "17/16")[alpha]
    gaps = []
    for n in (10, 30):
        slab = box(lattice(1, dx_over_h=f"1/{4 * n // 5}"), [n])
        assert slab.sides == pytest.approx([1.25], rel=1e-15)
        target = int(np.argmin(abs(slab.particles.x[0] - 3 / 16)))
        found = measure(slab.particles, "cubic-spline", operator, moments=2, targets=[target])
        gaps.append(float(found.moments[alpha][0]) - float(limit))
    assert gaps[0] / gaps[1] == pytest.approx(9, rel=0.1)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_corner_holds_the_part_of_the_kernel_that_is_derived(dim: int) -> None:
    """Σ W V of a particle at 3/8 from both walls is γ there, to second order in Δx/h."""
    gamma = in_corner(kernel("wendland-c4"), dim, "3/8", "3/8").value
    gaps = []
    for n in (4, 12):
        walled = [True, True, False][:dim]
        made = box(lattice(dim, dx_over_h=f"1/{n}"), [3 * n, 3 * n, 5 * n][:dim], walled=walled)
        apart = abs(made.particles.x[:2] - 3 / 8).sum(axis=0)
        found = measure(
            made.particles, "wendland-c4", VALUE, moments=0, targets=[int(apart.argmin())]
        )
        gaps.append(float(found.moments[(0,) * dim][0]) - gamma)
    assert gaps[0] / gaps[1] == pytest.approx(9, rel=0.1)


def test_a_particle_on_walls_counts_in_part() -> None:
    """Half on a face, a quarter on an edge: the volume of the box is the sum of its parts."""
    made = box(lattice(2, dx_over_h="1/2"), [5, 4], at="particle")
    assert made.particles.given is not None
    assert made.particles.given.sum() == pytest.approx(float(np.prod(made.sides)), rel=1e-14)
    assert sorted(set(made.particles.given)) == [0.0625, 0.125, 0.25]


def test_far_from_the_walls_of_a_slab_it_is_the_lattice() -> None:
    made = box(lattice(2, "hexagonal", "1/2"), [40, 20], walled=[True, False])
    inner = made.targets(2.5, np.inf)
    found: Any = measure(made.particles, "cubic-spline", VALUE, moments=0, targets=inner)
    endless = measure(lattice(2, "hexagonal", "1/2"), "cubic-spline", VALUE, moments=0)
    assert inner.size > 20
    assert found.moments[(0, 0)] == pytest.approx(float(endless.moments[(0, 0)][0]), rel=1e-13)
    near = measure(made.particles, "cubic-spline", VALUE, moments=0, targets=made.targets(0, 0.4))
    assert near.moments[(0, 0)].max() < 0.9


def test_displaced_particles_keep_their_number_and_move_by_sigma() -> None:
    scene = jittered(lattice(2, dx_over_h="1/2"), 0.05, seed=3)
    moved, still = box(scene, [30, 30]), box(scene.lattice, [30, 30])
    assert moved.particles.population == still.particles.population == 900
    assert (moved.particles.x - still.particles.x).std() == pytest.approx(0.025, rel=0.05)
    assert box(scene, [30, 30], walled=[False, False]).distance.min() == np.inf


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"planes": [3]}, "expected 2 entries"),
        ({"planes": [0, 3]}, "expected 1 or more"),
        ({"planes": [3, 4], "walled": [False, True]}, "no period of hexagonal"),
        ({"planes": [4, 4], "at": 1}, "at: got 1"),
    ],
)
def test_bad_boxes(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        box(lattice(2, "hexagonal"), **given)
    with pytest.raises(ValueError, match="displaced particles are not on a wall"):
        box(jittered(lattice(1), 0.1), [9], at="particle")
