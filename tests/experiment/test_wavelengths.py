"""Many wavelengths at once give the figures of one measurement each."""

from __future__ import annotations

from math import exp, pi

import numpy as np
import pytest
from strategies import OPERATORS

from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.wavelengths import LONGEST, waves
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice

LENGTHS = (1e-4, 0.02, 0.3, 1.5)  # the last is beyond the series
UNIT = 2.0**-53


def tolerance(h_over_lambda: float, derivatives: int) -> float:
    """Rounding of both ways, relative to k^m: 40 terms of sizes up to e^{kκ} in the series, Σ|w| at
    most 100 for the kernels and corrections here, up to 400 neighbours in a sum of 2^9 folds."""
    k = 2 * pi * h_over_lambda
    return 40 * UNIT * exp(min(2 * k, LONGEST)) * 100 / min(1.0, k) ** derivatives


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("sigma", [None, 0.1])
def test_the_figures_are_those_of_measure(dim, sigma):
    scene = lattice(dim, dx_over_h="0.7")
    targets = None
    if sigma is not None:
        scene, targets = jittered(scene, sigma, seed=3), 40
    table = waves(scene, "polynomial:4", OPERATORS, LENGTHS, targets=targets, seed=5)
    for operator, row in zip(OPERATORS, table, strict=True):
        for length, found in zip(LENGTHS, row, strict=True):
            field = sinusoid(length, dim=dim)
            alone = measure(scene, "polynomial:4", operator, field, targets=targets, seed=5)
            assert found.errors.shape == alone.errors.shape
            off = np.abs(found.errors - alone.errors).max()
            assert off <= tolerance(length, operator.derivatives), (operator, length)
            assert (found.targets, found.pairs, found.flagged) == (
                alone.targets,
                alone.pairs,
                alone.flagged,
            )
            assert found.settings == alone.settings


@pytest.mark.parametrize("volume", ["cell", "summation"])
def test_volumes_and_graded_spacing(volume):
    scene = jittered(lattice(1, dx_over_h="0.5", volume=volume), 0.1)
    operators = [Operator("gradient"), Operator("gradient", "symmetric")]
    scenes = [scene, graded(lambda x: 0.5 + 0.1 * np.sin(x), x=[0.0, 1.0, 2.0])]
    for one in scenes:
        targets = 30 if one is scene else None
        if one is not scene:
            operators = operators[:1]
        table = waves(one, "cubic-spline", operators, [0.05, 0.2], targets=targets)
        for operator, row in zip(operators, table, strict=True):
            for length, found in zip((0.05, 0.2), row, strict=True):
                alone = measure(one, "cubic-spline", operator, sinusoid(length), targets=targets)
                off = np.abs(found.errors - alone.errors).max()
                assert off <= tolerance(length, 1)


def test_targets_are_as_many_as_the_hardest_point_needs():
    scene = jittered(lattice(1, dx_over_h="0.5", extent=10**6), 0.1)
    ((easy, hard),) = waves(scene, "cubic-spline", [Operator("gradient")], [0.3, 0.001], rtol=0.02)
    assert easy.targets == hard.targets > 2048
    low, high = hard.error["rms_ci95"]
    assert (high - low) / 2 <= 0.02 * hard.error["rms"]


def test_threads_do_not_matter():
    scene = jittered(lattice(2, dx_over_h="0.6"), 0.1)
    operators = [Operator("gradient", "difference", "csph")]
    one = waves(scene, "cubic-spline", operators, [0.01], targets=3000)
    two = waves(scene, "cubic-spline", operators, [0.01], targets=3000, workers=2)
    assert np.array_equal(one[0][0].errors, two[0][0].errors)


def test_small_wavenumbers_keep_their_digits():
    # CSPH: error ½ h A″ M_2 …; at h/λ = 1e-9 the difference of two gradients would have lost it
    scene = jittered(lattice(1, dx_over_h="0.7"), 0.1)
    operators = [Operator("gradient", "difference", "csph")]
    ((far, near),) = waves(scene, "polynomial:4", operators, [1e-9, 1e-5], targets=500)
    ratio = near.error["rms"] / far.error["rms"]
    assert abs(ratio - 1e4) < 1  # the next order is smaller by 1e-5


def test_vector_operators_are_told():
    with pytest.raises(ValueError, match="divergence"):
        waves(lattice(2, dx_over_h="0.5"), "cubic-spline", [Operator("divergence")], [0.1])
