"""Structure factors: modes against plain sums, closed forms against many boxes, fits against
arrangements whose exponent is known."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import pytest

from sphtrunc.theory.disorder.box_modes import amplitudes, half_space
from sphtrunc.theory.disorder.structure_factor import displaced, measured, poisson

SIDES = {1: [7.0], 2: [3.0, 4.5], 3: [2.0, 3.0, 2.5]}


def box(dim: int, count: int, seed: int) -> tuple[Any, Any]:
    """Independent points (d, N) in a box that is no cube."""
    period = np.array(SIDES[dim])
    return np.random.default_rng(seed).random((dim, count)) * period[:, None], period


@pytest.mark.parametrize("way", ["direct", "grid"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_modes_are_plain_sums(dim: int, way: str) -> None:
    """Σ w e^{−ik·x}: to rounding by products of matrices, to 1e-5 of √(N Σw²) by the grid."""
    x, period = box(dim, 50, 1)
    weights = np.random.default_rng(2).random(50) + 0.5
    n = half_space(period, 9.0)
    k = 2 * np.pi * n / period[:, None]
    plain = np.exp(-1j * (k.T @ x)) @ weights
    found = amplitudes(x - 3 * period[:, None], weights, period, n, way)
    size = sqrt(50 * float((weights**2).sum()))
    assert np.abs(found - plain).max() < (1e-12 if way == "direct" else 1e-5) * size


def test_half_space_has_one_of_each_pair() -> None:
    period = np.array([2.0, 3.0, 2.5])
    n = half_space(period, 8.0)
    k = 2 * np.pi * n / period[:, None]
    assert (k**2).sum(axis=0).max() <= 64.0
    both = {tuple(v) for v in n.T} | {tuple(-v) for v in n.T}
    assert len(both) == 2 * n.shape[1]
    assert (0, 0, 0) not in both
    volume = 4 / 3 * np.pi * 8**3 * period.prod() / (2 * np.pi) ** 3
    assert len(both) == pytest.approx(volume, rel=0.1)


@pytest.mark.parametrize("distribution", ["gaussian", "uniform", "blue"])
def test_displaced_squares_have_the_diffuse_part(distribution: str) -> None:
    """Means over boxes of |ρ_k|²/N at six modes off the Bragg peaks, within 4.5 standard errors."""
    side, sigma, boxes = 8, 0.25, 1500
    rng = np.random.default_rng(3)
    points = np.stack([a.ravel() for a in np.meshgrid(*[np.arange(side)] * 2, indexing="ij")])
    n = np.array([[1, 3, 5, 9, 11, 13], [0, 2, 5, 1, 3, 12]])
    k = 2 * np.pi * n / side
    power = np.empty((boxes, n.shape[1]))
    for i in range(boxes):
        if distribution == "uniform":
            u = rng.uniform(-sqrt(3), sqrt(3), (2, side, side))
        else:
            u = rng.normal(size=(2, side, side))
        if distribution == "blue":
            around = sum(np.roll(u, s, axis) for s in (1, -1) for axis in (1, 2)) / 4
            u = (u - around) / sqrt(1.25)
        x = points + sigma * u.reshape(2, -1)
        power[i] = np.abs(np.exp(-1j * (k.T @ x)).sum(axis=1)) ** 2 / side**2
    error = power.std(axis=0) / sqrt(boxes)
    expected = displaced("square", sigma, distribution)(k)
    assert np.all(np.abs(power.mean(axis=0) - expected) < 4.5 * error)
    assert np.all(error < 0.05 * expected)


@pytest.mark.parametrize(("kind", "peaks"), [("uniform", 4), ("hexagonal", 6), ("hcp", 14)])
def test_bragg_peaks_of_still_lattices(kind: str, peaks: int) -> None:
    """The strength of the shortest of them is 1 (hcp: |½ + ½e^{iφ}|²), of those of the lattice
    built from its sites."""
    factor = displaced(kind, 0.0)
    nodes = factor.nodes(14.0, 3.0)
    assert nodes.bragg.shape[1] >= peaks // 2
    assert np.abs(factor(nodes.k)).max() == 0.0
    from sphtrunc.scenes.sites import sites, units

    m = sites(
        kind, 60.0 if factor.dim == 1 else 25.0 if factor.dim == 2 else 9.0, _zero(factor.dim)
    )
    x = (m.T * np.array([float(u) for u in units(kind)])).T
    window = np.exp(-((x**2).sum(axis=0)) / (8.0 if factor.dim == 3 else 60.0))
    seen = np.abs(np.exp(-1j * (nodes.bragg.T @ x)) @ window) ** 2 / window.sum() ** 2
    np.testing.assert_allclose(2 * seen, nodes.strength, atol=0.02)


def _zero(dim: int) -> Any:
    from fractions import Fraction

    return (Fraction(0),) * dim


def test_nodes_integrate() -> None:
    """Δx^d ∫ f d^d k/(2π)^d of a Gaussian, in closed form and over a box with its tail."""
    for dim in (1, 2, 3):
        x, period = box(dim, 200, 4)
        for factor in (poisson(dim), measured(x, period, reach=5.0)):
            nodes = factor.nodes(12.0, 2.0)
            found = float((nodes.weight * np.exp(-0.5 * (nodes.k**2).sum(axis=0))).sum())
            less = 0.0 if factor.law is not None else 1 / 200  # the mode 0
            assert found + less == pytest.approx((2 * np.pi) ** (-dim / 2), rel=2e-3)


@pytest.mark.parametrize(
    ("kind", "sigma", "exponent"), [("square", 0.05, 2.0), ("cubic", 0.1, 2.0)]
)
def test_exponent_of_a_displaced_lattice(kind: str, sigma: float, exponent: float) -> None:
    dim, side = (2, 96) if kind == "square" else (3, 24)
    rng = np.random.default_rng(5)
    points = np.stack([a.ravel() for a in np.meshgrid(*[np.arange(side)] * dim, indexing="ij")])
    x = points + sigma * rng.normal(size=points.shape)
    fit = measured(x, np.full(dim, float(side)), reach=3.0).fit()
    assert fit.exponent is not None
    assert fit.exponent_error is not None
    assert abs(fit.exponent - exponent) < 4 * fit.exponent_error
    assert fit.exponent_error < 0.3


def test_plateau_and_exponent_of_independent_points() -> None:
    x, period = box(3, 6000, 6)
    factor = measured(x, period, reach=4.0)
    fit = factor.fit()
    assert abs(fit.plateau - 1) < 4 * fit.plateau_error
    assert fit.exponent is not None
    assert abs(fit.exponent) < 4 * (fit.exponent_error or 0)
    k, S, error = factor.radial(20)
    assert np.all(np.diff(k) > 0)
    assert np.mean(np.abs(S - 1) < 2 * error) > 0.8
    assert not factor.anisotropic


def test_a_lattice_has_no_exponent() -> None:
    points = np.stack([a.ravel() for a in np.meshgrid(*[np.arange(12.0)] * 2, indexing="ij")])
    fit = measured(points, np.full(2, 12.0), reach=3.0).fit()
    assert fit.exponent is None
    assert fit.plateau < 1e-20


def test_displacements_along_one_axis_are_seen_as_such() -> None:
    """Displaced along one axis only: S = 1 − e^{−σ²k₁²}, nothing across it."""
    rng = np.random.default_rng(7)
    x = np.stack([a.ravel() for a in np.meshgrid(*[np.arange(40.0)] * 2, indexing="ij")])
    x[0] += 0.2 * rng.normal(size=1600)
    factor = measured(x, np.full(2, 40.0), reach=5.0)
    assert factor.anisotropic
    (along, _), (across, _) = factor.directions()
    assert along > 1.5 > across


def test_volumes_weigh_the_particles() -> None:
    x, period = box(2, 30, 8)
    volumes = np.random.default_rng(9).random(30) + 0.2
    factor = measured(x, period, volumes=volumes, reach=6.0)
    k = factor.k / sqrt(period.prod() / 30)  # type: ignore[operator]
    rho = np.exp(-1j * (k.T @ x)) @ (volumes / volumes.mean())
    np.testing.assert_allclose(factor.S, np.abs(rho) ** 2 / 30, rtol=1e-10, atol=1e-12)
    own = np.exp(-1j * (k.T @ x)).sum(axis=1)
    np.testing.assert_allclose(factor.pairs, (rho * own.conj()).real / 30, atol=1e-12)
    assert factor.fill == pytest.approx(volumes.sum() / period.prod(), rel=1e-14)


def test_a_free_set_is_seen_through_a_taper() -> None:
    """Independent points in a box without its period: S = 1 within the errors of shells, and the
    resolution is said; no prediction is made of it."""
    x, _ = box(2, 4000, 10)
    factor = measured(x, reach=6.0)
    _, S, error = factor.radial(15)
    assert np.all(np.abs(S[1:] - 1) < 5 * error[1:])
    spacing = sqrt(np.ptp(x, axis=1).prod() / 4000)
    np.testing.assert_allclose(factor.blur, 2 * np.pi * spacing / np.ptp(x, axis=1))
    with pytest.raises(ValueError, match="expected a periodic box"):
        factor.nodes(10.0, 2.0)


@pytest.mark.parametrize(
    ("x", "period", "options", "says"),
    [
        (np.zeros((2, 20)), [1.0, 1.0], {}, "one place"),
        (np.random.default_rng(0).random((2, 3)), [1.0, 1.0], {}, "got 3, expected at least 8"),
        (np.random.default_rng(0).random((2, 20)), [0.5, 0.5], {}, "extend over"),
        (np.random.default_rng(0).random((3, 20)), [1.0] * 3, {"reach": 9e3}, "at most 2e\\+07"),
        (np.random.default_rng(0).random((3, 20)), [1.0] * 3, {"reach": -1.0}, "expected kΔx"),
    ],
)
def test_bad_particles_are_refused(x: Any, period: Any, options: Any, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        measured(x, np.array(period), **options)


def test_a_closed_form_has_no_modes_and_a_box_no_law() -> None:
    with pytest.raises(ValueError, match="closed form"):
        poisson(2).radial()
    x, period = box(2, 30, 8)
    with pytest.raises(ValueError, match="measured at the modes"):
        measured(x, period)(np.ones((2, 1)))
    with pytest.raises(ValueError, match="more than twice the support"):
        measured(x, period).nodes(10.0, 3.0)
