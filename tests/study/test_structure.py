"""Predictions for explicit particles against sums over all points of their box, by code of its own;
and what `measure` and `compare` say of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sphtrunc import compare, kernel, measure, particles, predict_error, sinusoid, structure_factor
from sphtrunc.experiment.fields import polynomial
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.probes import probes
from sphtrunc.study.comparison import beside, predict_moments
from sphtrunc.study.structure import local_structure

SIDE = {1: 24, 2: 9, 3: 6}
POINTS = {1: 600, 2: 48, 3: 15}
PLAIN = [
    Operator("value"),
    Operator("gradient"),
    Operator("gradient", "difference"),
    Operator("gradient", "symmetric"),
    Operator("laplacian", "brookshaw"),
    Operator("laplacian", "difference"),
]


def shaken(dim: int, sigma: float, seed: int) -> Any:
    """Displaced cubic points (N, d), spacing 1, in the box of side SIDE."""
    axes = [np.arange(SIDE[dim]) + 0.5] * dim
    points = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], 1)
    return (points + sigma * np.random.default_rng(seed).normal(size=points.shape)) % SIDE[dim]


def everywhere(dim: int) -> Any:
    """Points (T, d) of an even grid over the box."""
    axis = (np.arange(POINTS[dim]) + 0.37) * SIDE[dim] / POINTS[dim]
    return np.stack([a.ravel() for a in np.meshgrid(*[axis] * dim, indexing="ij")], 1)


def direct(name: str, operator: Operator, x: Any, at: Any, h: float, volume: Any, top: int) -> Any:
    """{α: M_α at the points}, |α| <= top along the first axis, from w, w′ and w″ alone."""
    shape, dim = kernel(name), x.shape[1]
    side = SIDE[dim]
    s = ((x[None] - at[:, None] + side / 2) % side - side / 2) / h  # (points, particles, d)
    q = np.sqrt((s**2).sum(axis=2))
    v = np.where((q > 1e-12) & (q < float(shape.support)), volume / h**dim, 0.0)
    q = np.maximum(q, 1e-12)
    if operator.name == "value":
        g = v * shape.w(q, dim)
    elif operator.name == "gradient":
        g = -v * shape.dw(q, dim) * s[..., 0] / q
    elif operator.form == "brookshaw":
        g = -2 * v * shape.dw(q, dim) / q
    else:
        g = v * (shape.d2w(q, dim) + (dim - 1) * shape.dw(q, dim) / q)
    found = {(n, *(0,) * (dim - 1)): (g * s[..., 0] ** n).sum(axis=1) for n in range(top + 1)}
    if operator.form == "symmetric":
        found[(0,) * dim] *= 2
    return found


@settings(max_examples=60)
@given(
    name=st.sampled_from(["cubic-spline", "quintic-spline", "wendland-c2", "polynomial:4"]),
    operator=st.sampled_from(PLAIN),
    dim=st.sampled_from([1, 1, 2]),
    h=st.sampled_from([1.1, 1.3, 1.45]),
    sigma=st.sampled_from([0.02, 0.1, 0.3, 2.0]),
    seed=st.integers(0, 2**31),
)
def test_all_points_of_a_box(
    name: str, operator: Operator, dim: int, h: float, sigma: float, seed: int
) -> None:
    """Mean and spread over an even grid of points are those over its modes, whatever the process:
    to 1 %, for the modes of a rough kernel beyond those that are measured and those that the grid
    folds back."""
    x = shaken(dim, sigma, seed)
    shape = kernel(name)
    if operator.name == "laplacian" and name == "cubic-spline" and operator.form != "brookshaw":
        name, shape = "quintic-spline", kernel("quintic-spline")
    top = 2
    scene = particles(x, h=h, volume=1.0, period=float(SIDE[dim]))
    if 2 * float(shape.support) * h >= SIDE[dim]:
        with pytest.raises(ValueError, match="more than twice the support"):
            predict_moments(probes(scene, 8), shape, operator, top)
        return
    found = predict_moments(probes(scene, 8), shape, operator, top)
    seen = direct(name, operator, x, everywhere(dim), h, 1.0, top)
    for alpha, values in seen.items():
        if sum(alpha) <= operator.consistency:
            assert found.std[alpha] == 0.0
            continue
        scale = max(abs(found.mean[alpha]), found.std[alpha])
        assert abs(values.mean() - found.mean[alpha]) < 1e-3 * scale
        assert values.std() == pytest.approx(found.std[alpha], rel=0.01)


def test_all_points_in_space() -> None:
    x = shaken(3, 0.15, 3)
    scene = particles(x, h=1.3, volume=1.0, period=6.0)
    for operator in PLAIN[:3]:
        found = predict_moments(probes(scene, 8), "wendland-c2", operator, 2)
        seen = direct("wendland-c2", operator, x, everywhere(3), 1.3, 1.0, 2)
        for alpha, values in seen.items():
            if sum(alpha) > operator.consistency:
                assert values.std() == pytest.approx(found.std[alpha], rel=0.02)


def test_a_wrong_structure_factor_would_be_seen() -> None:
    """The spread of another box of the same process is off by more than the tolerance."""
    first, other = (
        predict_moments(
            probes(particles(shaken(2, 0.1, seed), h=1.3, volume=1.0, period=9.0), 8),
            "wendland-c2",
            PLAIN[1],
            2,
        )
        for seed in (1, 2)
    )
    assert max(abs(first.std[a] / other.std[a] - 1) for a in first.std) > 0.03


@pytest.mark.parametrize("at", ["random", "particles"])
def test_given_and_summed_volumes(at: str) -> None:
    """The weighted structure factor, with volumes of any kind, to 1 % at random points; at
    particles the mean is exact."""
    x, h = shaken(2, 0.15, 4), 1.3
    shape = kernel("wendland-c2")
    given_volumes = 1 + 0.3 * np.random.default_rng(5).random(81)
    gap = (x[:, None] - x[None] + 4.5) % 9 - 4.5
    summed = 1 / (shape.w(np.sqrt((gap**2).sum(2)) / h, 2).sum(1) / h**2)
    for volume, values in ((given_volumes, given_volumes), ("summation", summed)):
        scene = particles(x, h=h, volume=volume, period=9.0)
        targets = everywhere(2) if at == "random" else x
        chosen = probes(scene, 8) if at == "random" else scene
        found = predict_moments(chosen, shape, PLAIN[1], 2)
        seen = direct("wendland-c2", PLAIN[1], x, targets, h, values, 2)
        one = (1, 0)
        assert seen[one].mean() == pytest.approx(found.mean[one], rel=1e-4)
        if at == "random":
            for alpha, row in seen.items():
                assert row.std() == pytest.approx(found.std[alpha], rel=0.01)
        else:
            assert abs(seen[one].mean() - 1) > 0.005
            assert "between the particles" in found.how


@pytest.mark.parametrize(
    "operator",
    [
        Operator("value", "difference", "shepard"),
        Operator("gradient", "difference", "csph"),
        Operator("gradient", "standard", "rkpm-1"),
    ],
)
def test_corrected_operators_to_first_order(operator: Operator) -> None:
    """The leading moments at random points within 5 % at σ/Δx = 0.05, where the nonlinear part of a
    correction is small; of `measure`, which solves for every target."""
    scene = particles(shaken(2, 0.05, 6), h=1.4, volume=1.0, period=9.0)
    chosen = probes(scene, 4000, seed=1)
    degree = operator.consistency + 1
    seen = measure(chosen, "wendland-c2", operator, moments=degree)
    found = predict_moments(chosen, "wendland-c2", operator, degree)
    for alpha, values in seen.moments.values.items():
        if sum(alpha) == degree:
            assert values.std() == pytest.approx(found.std[alpha], rel=0.05)
            assert abs(values.mean() - found.mean[alpha]) < 0.1 * found.std[alpha] + 0.02 * abs(
                found.mean[alpha]
            )


def test_errors_of_waves_and_polynomials() -> None:
    """rms over points and phases, of standard, difference and CSPH gradients, and of a polynomial;
    within 4 % of `measure` at 4000 points."""
    scene = particles(shaken(2, 0.1, 7), h=1.4, volume=1.0, period=9.0)
    chosen = probes(scene, 4000, seed=2)
    for operator in (PLAIN[1], PLAIN[2], Operator("gradient", "difference", "csph"), PLAIN[4]):
        for field in (sinusoid(0.08, [1, 2], 2), polynomial({(1, 0): 1.0, (2, 0): 0.3}, 2)):
            seen = measure(chosen, "wendland-c2", operator, field).error
            assert seen is not None
            found = predict_error("wendland-c2", operator, chosen, field)
            assert seen["rms"] == pytest.approx(found.total, rel=0.04)
            assert found.discretisation == 0.0


@pytest.mark.parametrize(("kind", "dim"), [("hexagonal", 2), ("hcp", 3), ("uniform", 1)])
@pytest.mark.parametrize("sigma", [0.0, 0.1])
def test_points_of_space_between_the_particles_of_a_rule(kind: str, dim: int, sigma: float) -> None:
    """Targets anywhere: diffuse part and Bragg peaks together, within four standard errors."""
    home = lattice(dim, kind, "3/4", extent={1: 10**5, 2: 300, 3: 60}[dim])
    scene = jittered(home, sigma, seed=3, anywhere=True)
    seen = measure(scene, "cubic-spline", PLAIN[1], moments=1, targets=4000)
    found = predict_moments(scene, "cubic-spline", PLAIN[1], 1)
    for alpha, values in seen.moments.values.items():
        x = values - values.mean()
        kurtosis = float((x**4).mean()) / float((x**2).mean()) ** 2
        error = 4 * np.sqrt(max(kurtosis - 1, 0.3) / (4 * 4000))
        assert abs(values.std() / found.std[alpha] - 1) < error + 0.01
        assert abs(values.mean() - found.mean[alpha]) < 4 * found.std[alpha] / np.sqrt(4000)


def test_compare_and_measure_say_where_it_comes_from() -> None:
    scene = particles(shaken(2, 0.1, 8), h=1.4, volume=1.0, period=9.0)
    found = compare(scene, "wendland-c2", "gradient", degree=1)
    assert "structure factor" in str(found)
    assert found.difference[1, 0] == pytest.approx(0.0, abs=2e-4)
    row = beside(found.measured, scene, "wendland-c2", PLAIN[1])
    assert row["by"] == "structure factor"
    assert set(row["moments"]) == {"0,0", "1,0", "0,1"}


def test_graded_particles_have_a_structure_factor_in_each_part() -> None:
    """Half of the box twice as dense and displaced five times as much, in its own Δx: S of every
    part is 1 − e^{−σ²k²} of its own displacements. The whole has another."""
    rng = np.random.default_rng(6)
    parts, volumes = [], []
    for low, side, sigma in ((0.0, 48, 0.05), (24.0, 34, 0.25)):
        dx = 24.0 / side
        axes = np.meshgrid(np.arange(side), np.arange(2 * side), indexing="ij")
        x = (np.stack([a.ravel() for a in axes]) + 0.5) * dx
        x = x + sigma * dx * rng.normal(size=x.shape)
        x[0] = np.mod(x[0], 24.0) + low
        parts.append(x)
        volumes.append(np.full(x.shape[1], dx * dx))
    scene = particles(
        np.concatenate(parts, axis=1).T, h=1.0, volume=np.concatenate(volumes), period=48.0
    )
    found = local_structure(scene, (2, 2))
    assert len(found) == 4
    for one in found:
        sigma = 0.05 if one.low[0] == 0.0 else 0.25
        assert one.spacing == pytest.approx(24.0 / (48 if sigma == 0.05 else 34), rel=0.01)
        k, S, error = one.factor.radial(12)
        inside = (k > 1.0) & (k < 4.5)
        expected = 1 - np.exp(-((sigma * k) ** 2))
        assert np.all(np.abs(S - expected)[inside] < 4 * error[inside] + 0.02 * expected[inside])
        assert inside.sum() >= 4
    with pytest.raises(ValueError, match="expected at least 64; fewer parts"):
        local_structure(scene, 20)
    with pytest.raises(ValueError, match="expected how many parts"):
        local_structure(scene, 0)


def test_scenes_and_their_structure_factor() -> None:
    home = lattice(2, "square", "1/2")
    k = np.array([[0.5], [0.2]])
    assert structure_factor(home)(k)[0] == 0.0
    assert structure_factor(jittered(home, 0.2))(k)[0] == pytest.approx(
        1 - np.exp(-0.04 * 0.29), rel=1e-14
    )
    scene = particles(shaken(2, 0.1, 8), h=1.4, volume=1.0, period=9.0)
    assert structure_factor(probes(scene, 3)).particles == 81
    with pytest.raises(ValueError, match="graded"):
        structure_factor(graded(lambda x: 0.5 + 0.01 * x))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"h": 1.0, "volume": 1.0}, "without a periodic box"),
        ({"h": np.linspace(1, 1.1, 81), "volume": 1.0, "period": 9.0}, "differ in h"),
    ],
)
def test_what_is_not_known_is_said(options: Any, says: str) -> None:
    scene = particles(shaken(2, 0.1, 8), **options)
    with pytest.raises(ValueError, match=says):
        predict_moments(scene, "wendland-c2", PLAIN[1])
    with pytest.raises(ValueError, match="random points need"):
        probes(scene)
