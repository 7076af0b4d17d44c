"""Scenes against brute force, known crystals and exact rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sphtrunc
from sphtrunc.arithmetic.bounded import Bounded
from sphtrunc.arithmetic.extended import Extended
from sphtrunc.arithmetic.plain import Plain
from sphtrunc.arithmetic.rational import exact
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import Jittered, jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.neighbourhood import Neighbourhood
from sphtrunc.scenes.particles import particles
from sphtrunc.scenes.scene import sample
from sphtrunc.scenes.sites import KINDS, sites, units

CUBIC = sphtrunc.kernel("cubic-spline")
ZERO = np.array([0])


def lengths(block: Neighbourhood) -> np.ndarray:
    return np.sqrt((block.offset**2).sum(axis=0))


def brute(scene: Jittered, target: int, cells: int) -> np.ndarray:
    """Offsets of every particle of a wide cube of integer points, (d, n), in units of h."""
    kind = scene.lattice.kind
    axes = np.meshgrid(*[np.arange(-cells, cells + 1)] * scene.dim, indexing="ij")
    m = np.stack([a.reshape(-1) for a in axes])
    m = m[:, KINDS[kind].contains(m)]
    origin = scene.origin(np.array([target]))
    u = scene.displacement(m + origin) - scene.displacement(origin)
    scale = np.array([float(v) for v in units(kind)])[:, None]
    return (m * scale + u) * float(scene.lattice.dx_over_h)


# ------------------------------------------------------------------------------------- lattices

SHELLS = {  # coordination shells: (squared distance / nearest squared, number); any crystallography
    "uniform": [(1, 2), (4, 2), (9, 2)],
    "square": [(1, 4), (2, 4), (4, 4), (5, 8)],
    "hexagonal": [(1, 6), (3, 6), (4, 6), (7, 12)],
    "cubic": [(1, 6), (2, 12), (3, 8), (4, 6), (5, 24)],
    "bcc": [(1, 8), (Fraction(4, 3), 6), (Fraction(8, 3), 12), (Fraction(11, 3), 24)],
    "fcc": [(1, 12), (2, 6), (3, 24), (4, 12), (5, 24)],
    "hcp": [(1, 12), (2, 6), (Fraction(8, 3), 2), (3, 18), (Fraction(11, 3), 12)],
}
NEAREST = {  # nearest-neighbour distance at one particle a unit volume
    "uniform": 1.0,
    "square": 1.0,
    "hexagonal": (4 / 3) ** 0.25,
    "cubic": 1.0,
    "bcc": 3**0.5 / 2 ** (2 / 3),
    "fcc": 2 ** (1 / 6),
    "hcp": 2 ** (1 / 6),
}


@pytest.mark.parametrize("kind", KINDS)
def test_lattices_are_the_crystals_they_are_called(kind: str) -> None:
    dim = KINDS[kind].dim
    block = lattice(dim, kind, "1/4").neighbourhood(ZERO, CUBIC)
    r2 = np.sort((lengths(block)[:, 0] * 4 / NEAREST[kind]) ** 2)
    assert r2[0] == 0
    assert np.array_equal(block.volume, [[0.25**dim]])
    first = 1
    for square, number in SHELLS[kind]:
        shell = r2[first : first + number]
        assert np.allclose(shell, float(square), rtol=1e-12)
        first += number
    assert r2[first] > float(SHELLS[kind][-1][0]) * 1.05


@pytest.mark.parametrize("kind", KINDS)
def test_one_particle_a_unit_volume(kind: str) -> None:
    primitive = np.array(KINDS[kind].primitive, dtype=float)
    unit = np.array([float(u) for u in units(kind)])
    per_cell = 2 if kind == "hcp" else 1
    assert abs(np.linalg.det(primitive * unit)) == pytest.approx(per_cell, rel=1e-14)
    dim, reach = KINDS[kind].dim, {1: 1000.0, 2: 60.0, 3: 16.0}[KINDS[kind].dim]
    count = sites(kind, reach, (Fraction(0),) * dim).shape[1]
    ball = {1: 2 * reach, 2: np.pi * reach**2, 3: 4 / 3 * np.pi * reach**3}[dim]
    assert abs(count / ball - 1) < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_nearest_steps_are_the_nearest(kind: str) -> None:
    unit = np.array([float(u) for u in units(kind)])
    for step in KINDS[kind].nearest:
        assert np.linalg.norm(np.array(step) * unit) == pytest.approx(NEAREST[kind], rel=1e-14)
    assert len(KINDS[kind].nearest) in (0, SHELLS[kind][0][1])


rationals = st.fractions(Fraction(1, 40), Fraction(3, 2), max_denominator=97)


@settings(max_examples=60)
@given(rationals, st.fractions(-1, 1, max_denominator=50))
def test_uniform_offsets_are_correctly_rounded(ratio: Fraction, theta: Fraction) -> None:
    scene = lattice(1, None, ratio, theta)
    block = scene.neighbourhood(ZERO, CUBIC, Extended())
    j = np.arange(-200, 200)
    truth = [(int(i) + theta) * ratio for i in j]
    inside = [s for s in truth if abs(s) <= 2]
    plain = scene.neighbourhood(ZERO, CUBIC)
    assert plain.offset[0, :, 0].tolist() == [float(s) for s in inside]
    assert block.beside is not None
    for s, hi, lo in zip(inside, block.offset[0, :, 0], block.beside.offset[0, :, 0], strict=True):
        assert abs(Fraction(hi) + Fraction(lo) - s) <= abs(s) * Fraction(1, 2**105)
    exact, volume = scene.exact_neighbourhood(0, CUBIC)
    assert exact[0].tolist() == inside
    assert set(volume) == {ratio}


@pytest.mark.parametrize("kind", ["square", "hexagonal", "cubic", "bcc", "fcc", "hcp"])
def test_offsets_in_space_are_correctly_rounded(kind: str) -> None:
    dim = KINDS[kind].dim
    shift = (Fraction(1, 3), Fraction(1, 7), Fraction(-2, 5))[:dim]
    scene = lattice(dim, kind, "7/10", shift)
    block = scene.neighbourhood(ZERO, CUBIC, Bounded(Plain()))
    exact, _ = scene.exact_neighbourhood(0, CUBIC)
    assert exact.shape == block.offset.shape[:2]
    assert np.array_equal(exact.astype(float), block.offset[:, :, 0])
    assert block.beside is not None
    for s, x, e in zip(
        exact.ravel(), block.offset.ravel(), block.beside.offset.ravel(), strict=True
    ):
        assert abs(s - Fraction(x)) <= Fraction(e)


def test_what_a_text_says_is_what_is_used() -> None:
    assert lattice(1, None, "0.7").dx_over_h == Fraction(7, 10)
    assert exact("1e-8", "h_over_lambda") == Fraction(1, 10**8)
    assert exact(" -.5E+2 ", "offset") == -50
    assert lattice(1, None, 0.7).dx_over_h == Fraction(0.7) != Fraction(7, 10)
    assert lattice(1, None, np.float64(0.5)).dx_over_h == Fraction(1, 2)


# ------------------------------------------------------------------------------------- jittered

SCENES = [
    (kind, distribution, sigma)
    for kind in KINDS
    for distribution in ("gaussian", "uniform", "blue")
    for sigma in (0.05, 0.3)
    if KINDS[kind].nearest or distribution != "blue"
]


@pytest.mark.parametrize(("kind", "distribution", "sigma"), SCENES)
def test_no_neighbour_is_missed_and_none_is_made_up(
    kind: str, distribution: str, sigma: float
) -> None:
    dim = KINDS[kind].dim
    scene = jittered(lattice(dim, kind, "3/4", extent=50), sigma, distribution, seed=9)
    target = np.array([0, 7, scene.population - 1])
    block = scene.neighbourhood(target, CUBIC)
    r = lengths(block)
    for t, one in enumerate(target):
        everything = brute(scene, int(one), 12)
        truth = np.sort(np.sqrt((everything**2).sum(axis=0)))
        truth = truth[truth <= 2]
        found = np.sort(r[:, t][r[:, t] <= 2])
        assert found.size == truth.size
        assert np.abs(found - truth).max() < 1e-13


def test_a_scene_is_the_same_in_any_order_and_any_block() -> None:
    scene = jittered(lattice(3, None, "3/5"), 0.2, seed=4)
    target = np.array([5, 999_999_999, 123_456, 7, 0])
    block = scene.neighbourhood(target, CUBIC)
    for t, one in enumerate(target):
        alone = scene.neighbourhood(np.array([one]), CUBIC)
        rows = alone.offset.shape[1]
        assert np.array_equal(alone.offset[:, :, 0], block.offset[:, :rows, t])
        assert np.all(lengths(block)[rows:, t] > 2)


def test_a_pair_is_seen_alike_from_both_ends() -> None:
    """s_ab = −s_ba: displacements belong to particles, not to neighbourhoods."""
    scene = jittered(lattice(2, "hexagonal", "3/5", extent=100), 0.2, seed=4)
    target = np.array([5050, 5051, 5150])
    block = scene.neighbourhood(target, CUBIC)
    step = scene.origin(target)[:, 1:] - scene.origin(target)[:, :1]
    u = scene.displacement(scene.origin(target))
    unit = np.array([float(v) for v in units("hexagonal")])
    for k in (0, 1):
        s = (step[:, k] * unit + u[:, k + 1] - u[:, 0]) * 0.6
        forward = np.abs(block.offset[:, :, 0] - s[:, None]).max(axis=0).min()
        backward = np.abs(block.offset[:, :, k + 1] + s[:, None]).max(axis=0).min()
        assert max(forward, backward) < 1e-15


@pytest.mark.parametrize("distribution", ["gaussian", "uniform", "blue"])
@pytest.mark.parametrize("kind", ["uniform", "square", "hexagonal", "cubic", "fcc"])
def test_displacements_have_the_asked_standard_deviation(kind: str, distribution: str) -> None:
    dim = KINDS[kind].dim
    scene = jittered(lattice(dim, kind), 0.2, distribution)
    side = round(300_000 ** (1 / dim))
    index = scene.origin(np.arange(side**dim))
    big = jittered(lattice(dim, kind, extent=side), 0.2, distribution)
    index = big.origin(np.arange(side**dim))
    u = big.displacement(index)
    n = u.size
    assert abs(u.mean()) < 5 * 0.2 / np.sqrt(n)
    assert abs((u**2).mean() / 0.04 - 1) < 5 * 2 / np.sqrt(n)
    assert np.abs(u).max() <= scene.largest


def test_blue_noise_has_its_spectrum() -> None:
    """1D: (v_n − (v_{n−1} + v_{n+1})/2)/√(3/2) has covariances 1, −2/3, 1/6, 0, …"""
    scene = jittered(lattice(1), 1.0, "blue", seed=3)
    u = scene.displacement(np.arange(1_000_000)[None])[0]
    for lag, truth in enumerate([1, -2 / 3, 1 / 6, 0, 0]):
        assert abs(np.mean(u[lag:] * u[: u.size - lag]) - truth) < 0.006


@pytest.mark.parametrize(("dim", "kind"), [(1, "uniform"), (2, "hexagonal"), (3, "cubic")])
@pytest.mark.parametrize("theta", [0, "1/3"])
def test_jittered_offsets_are_within_their_bounds(dim: int, kind: str, theta: object) -> None:
    shift = [theta] * dim
    scene = jittered(lattice(dim, kind, "7/10", shift, extent=1000), 0.2, seed=1)
    targets = sample(scene, 0, 12, 0)
    block = scene.neighbourhood(targets, CUBIC, Bounded(Plain()))
    fine = scene.neighbourhood(targets, CUBIC, Extended())
    assert block.beside is not None
    assert fine.beside is not None
    worst = []
    for t, one in enumerate(targets):
        exact, _ = scene.exact_neighbourhood(int(one), CUBIC)
        truth = {tuple(float(c) for c in s): s for s in exact.T}
        seen = 0
        for j in np.flatnonzero(lengths(block)[:, t] <= 2):
            s = block.offset[:, j, t]
            near = min(truth, key=lambda c: sum(abs(a - b) for a, b in zip(c, s, strict=True)))
            for axis in range(dim):
                gap = abs(truth[near][axis] - Fraction(s[axis]))
                assert gap <= Fraction(block.beside.offset[axis, j, t])
                worst.append(float(gap))
                pair = Fraction(fine.offset[axis, j, t]) + Fraction(fine.beside.offset[axis, j, t])
                assert abs(truth[near][axis] - pair) < Fraction(1, 2**98)
            seen += 1
        assert seen == len(truth)
    assert max(worst) > 0


def test_cell_volumes_are_half_the_distance_between_the_neighbours() -> None:
    scene = jittered(lattice(1, None, "2/5", volume="cell", extent=500), 0.4, seed=2)
    targets = np.arange(40)
    block = scene.neighbourhood(targets, CUBIC, Bounded(Plain()))
    fine = scene.neighbourhood(targets, CUBIC, Extended())
    for t, one in enumerate(targets):
        x = np.sort(brute(scene, int(one), 60)[0])
        inside = np.flatnonzero(np.abs(x) <= 2)
        rows = np.abs(block.offset[0, :, t]) <= 2
        near = block.offset[0, rows, t] - x[inside]
        assert np.abs(near).max() <= 64 * 2.0**-53  # indices up to 60, rounded once, times Δx/h
        halves = block.volume[rows, t] - (x[inside + 1] - x[inside - 1]) / 2
        assert np.abs(halves).max() <= 64 * 2.0**-53
        exact, volume = scene.exact_neighbourhood(int(one), CUBIC)
        assert exact.shape[1] == inside.size
        assert block.beside is not None
        assert fine.beside is not None
        for v, got, low, e in zip(
            volume,
            block.volume[rows, t],
            fine.beside.volume[rows, t] + (fine.volume[rows, t] - block.volume[rows, t]),
            block.beside.volume[rows, t],
            strict=True,
        ):
            assert abs(v - Fraction(got)) <= Fraction(e)
            assert abs(v - Fraction(got) - Fraction(low)) < Fraction(1, 2**90)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_summation_volumes(dim: int) -> None:
    scene = jittered(lattice(dim, None, "4/5", volume="summation", extent=90), 0.2, seed=2)
    targets = np.array([0, 11, 80])
    block = scene.neighbourhood(targets, CUBIC)
    for t, one in enumerate(targets):
        x = brute(scene, int(one), 8)
        for j in np.flatnonzero(lengths(block)[:, t] <= 2)[::5]:
            d = np.sqrt(((x - block.offset[:, j, t][:, None]) ** 2).sum(axis=0))
            assert block.volume[j, t] == pytest.approx(1 / CUBIC.w(d, dim).sum(), rel=1e-12)


def test_summation_volume_of_a_lattice_makes_the_kernel_sum_to_one() -> None:
    block = lattice(3, "fcc", "3/4", volume="summation").neighbourhood(ZERO, CUBIC)
    assert (CUBIC.w(lengths(block), 3) * block.volume).sum() == pytest.approx(1, rel=1e-14)


# --------------------------------------------------------------------------------------- graded


def test_graded_with_constant_spacing_is_the_lattice() -> None:
    block = graded(lambda x: 0.4 + 0.0 * x, [0.0, 3.5], "1/3").neighbourhood(
        np.array([0, 1]), CUBIC
    )
    truth = np.array([s for s in (np.arange(-20, 20) + 1 / 3) * 0.4 if abs(s) <= 2])
    for t in (0, 1):
        s = np.sort(block.offset[0, np.abs(block.offset[0, :, t]) <= 2, t])
        assert np.allclose(s, truth, rtol=0, atol=1e-14)
    assert np.allclose(block.volume[np.abs(block.offset[0]) <= 2], 0.4, rtol=1e-13)


def test_graded_spacing_follows_its_map() -> None:
    """dx/dξ = c e^{g x} has x(ξ) = −ln(e^{−g x₀} − g c ξ)/g."""
    c, g, x0 = 0.2, 0.25, 0.7
    scene = graded(lambda x: c * np.exp(g * x), x0)
    block = scene.neighbourhood(ZERO, CUBIC)
    xi = np.arange(-14, 10)
    truth = -np.log(np.exp(-g * x0) - g * c * xi) / g - x0
    inside = np.abs(truth) <= 2
    kept = np.abs(block.offset[0, :, 0]) <= 2
    order = np.argsort(block.offset[0, kept, 0])
    assert np.allclose(block.offset[0, kept, 0][order], truth[inside], rtol=0, atol=1e-11)
    middles = (truth[1:] + truth[:-1]) / 2
    cells = np.diff(middles)[inside[1:-1]]
    assert np.allclose(block.volume[kept, 0][order], cells, rtol=0, atol=1e-11)


# ------------------------------------------------------------------------------------ explicit


def cloud(dim: int, n: int = 120, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((n, dim))


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("mode", ["gather", "scatter", "mean"])
@pytest.mark.parametrize("period", [None, 1.0])
def test_explicit_neighbours_against_all_pairs(dim: int, mode: str, period: float | None) -> None:
    x = cloud(dim)
    h = 0.06 + 0.06 * np.random.default_rng(1).random(len(x))
    scene = particles(x, h=h, volume=1 / len(x), mode=mode, period=period)
    targets = np.array([3, 0, 77, 119])
    block = scene.neighbourhood(targets, CUBIC)
    for t, a in enumerate(targets):
        d = x - x[a]
        if period is not None:
            d -= np.round(d)
        r = np.sqrt((d**2).sum(axis=1))
        pair = {"gather": np.full(len(x), h[a]), "scatter": h, "mean": (h[a] + h) / 2}[mode]
        truth = set(np.flatnonzero(r < 2 * pair * (1 - 1e-9)))
        assert block.particle is not None
        stretch = np.ones_like(block.volume) if block.stretch is None else block.stretch
        q = np.sqrt((block.offset[:, :, t] ** 2).sum(axis=0)) * stretch[:, t]
        found = block.particle[:, t][(q < 2 * (1 - 1e-9)) & (block.particle[:, t] >= 0)]
        assert set(found) == truth
        for b, s in zip(block.particle[:, t], block.offset[:, :, t].T, strict=True):
            if b in truth:
                assert np.allclose(s, d[b] / h[a], rtol=1e-12, atol=1e-12)
        padding = block.particle[:, t] < 0
        assert np.all(block.volume[padding, t] == 0)
        assert np.all(block.offset[0, padding, t] > 2)


def test_coordinates_far_away_lose_nothing_that_they_have() -> None:
    x = np.array([1e12, 1e12 + 0.5, 1e12 + 1.0])
    block = particles(x, h=1.0, volume=0.5).neighbourhood(np.array([1]), CUBIC)
    assert sorted(block.offset[0, :, 0]) == [-0.5, 0.0, 0.5]


def test_explicit_cells_and_sums() -> None:
    x = np.array([0.0, 1.0, 1.5, 3.0])
    cells = particles(x, h=1.0, volume="cell")
    block = cells.neighbourhood(np.array([1]), CUBIC)
    assert block.volume[:, 0].tolist() == [1.0, 0.75, 1.0, 1.5]
    ring = particles(x, h=0.5, volume="cell", period=4.0).neighbourhood(np.array([0]), CUBIC)
    assert sorted(ring.volume[:, 0]) == [1.5, 2.0, 2.5]
    summed = particles(x, h=1.0, mass=[1.0, 2.0, 3.0, 4.0])
    block = summed.neighbourhood(np.array([1]), CUBIC)
    mass = np.array([1.0, 2.0, 3.0, 4.0])
    density = (mass * CUBIC.w(np.abs(x[:, None] - x), 1)).sum(axis=1)
    assert np.allclose(block.volume[:, 0], mass / density, rtol=1e-14)
    both = particles(x, h=1.0, mass=mass, density=density).neighbourhood(np.array([1]), CUBIC)
    assert np.allclose(both.volume, block.volume, rtol=1e-14)


def test_explicit_exact_and_extended_agree() -> None:
    scene = particles(cloud(2), h=0.2, volume=0.01, period=[1.0, 1.0])
    exact, volume = scene.exact_neighbourhood(5, CUBIC)
    fine = scene.neighbourhood(np.array([5]), CUBIC, Extended())
    assert fine.beside is not None
    pairs = sorted(
        (Fraction(h[0]) + Fraction(lo[0]), Fraction(h[1]) + Fraction(lo[1]))
        for h, lo in zip(fine.offset[:, :, 0].T, fine.beside.offset[:, :, 0].T, strict=True)
        if h @ h <= 4
    )
    truth = sorted(map(tuple, exact.T))
    assert len(pairs) == len(truth)
    for a, b in zip(pairs, truth, strict=True):
        assert max(abs(a[0] - b[0]), abs(a[1] - b[1])) < Fraction(1, 2**96)
    assert set(volume) == {Fraction(0.01) / Fraction(0.2) ** 2}


# ------------------------------------------------------------------------------------ bad input

NAN, INF = float("nan"), float("inf")
BAD = {
    "dim": lambda: lattice(4),
    "kind": lambda: lattice(2, "cubic"),
    "ratio zero": lambda: lattice(1, None, 0),
    "ratio negative": lambda: lattice(1, None, "-1/2"),
    "ratio text": lambda: lattice(1, None, "a/b"),
    "ratio by zero": lambda: lattice(1, None, "1/0"),
    "ratio nan": lambda: lattice(1, None, NAN),
    "ratio inf": lambda: lattice(1, None, INF),
    "ratio huge power": lambda: lattice(1, None, "1e999999999"),
    "ratio bool": lambda: lattice(1, None, True),
    "offset number": lambda: lattice(3, None, "1/2", "1/3"),
    "offset length": lambda: lattice(3, None, "1/2", [0, 0]),
    "offset nan": lambda: lattice(1, None, "1/2", NAN),
    "offset far": lambda: lattice(1, None, "1/2", 10**9),
    "volume": lambda: lattice(1, None, "1/2", volume="voronoi"),
    "cells in 2D": lambda: lattice(2, None, "1/2", volume="cell"),
    "extent": lambda: lattice(1, None, "1/2", extent=0),
    "extent float": lambda: lattice(1, None, "1/2", extent=2.5),
    "jitter negative": lambda: jittered(lattice(), -0.1),
    "jitter nan": lambda: jittered(lattice(), NAN),
    "jitter text": lambda: jittered(lattice(), "x"),
    "distribution": lambda: jittered(lattice(), 0.1, "white"),
    "blue hcp": lambda: jittered(lattice(3, "hcp"), 0.1, "blue"),
    "seed": lambda: jittered(lattice(), 0.1, seed=-1),
    "seed float": lambda: jittered(lattice(), 0.1, seed=1.5),
    "spacing": lambda: graded(0.5),
    "spacing negative": lambda: graded(lambda x: -1.0 + 0 * x).neighbourhood(ZERO, CUBIC),
    "spacing nan": lambda: graded(lambda x: NAN * x).neighbourhood(ZERO, CUBIC),
    "spacing shape": lambda: graded(lambda x: np.ones(7)).neighbourhood(ZERO, CUBIC),
    "targets nan": lambda: graded(lambda x: 1 + 0 * x, [NAN]),
    "targets none": lambda: graded(lambda x: 1 + 0 * x, []),
    "no neighbour": lambda: lattice(1, None, 3).neighbourhood(ZERO, CUBIC),
    "too many": lambda: lattice(3, None, "1/500").neighbourhood(ZERO, CUBIC),
    "x shape": lambda: particles(np.zeros((2, 2, 2)), h=1, volume=1),
    "x four": lambda: particles(np.zeros((2, 4)), h=1, volume=1),
    "x empty": lambda: particles([], h=1, volume=1),
    "x nan": lambda: particles([0.0, NAN], h=1, volume=1),
    "x inf": lambda: particles([0.0, INF], h=1, volume=1),
    "x text": lambda: particles(["a", "b"], h=1, volume=1),
    "x object": lambda: particles([None, 1], h=1, volume=1),
    "x complex": lambda: particles([1j, 1], h=1, volume=1),
    "x ragged": lambda: particles([[1, 2], [3]], h=1, volume=1),
    "h zero": lambda: particles([0.0, 1.0], h=0, volume=1),
    "h negative": lambda: particles([0.0, 1.0], h=[1, -1], volume=1),
    "h nan": lambda: particles([0.0, 1.0], h=NAN, volume=1),
    "h shape": lambda: particles([0.0, 1.0], h=[1, 1, 1], volume=1),
    "volume zero": lambda: particles([0.0, 1.0], h=1, volume=0),
    "volume shape": lambda: particles([0.0, 1.0], h=1, volume=[1, 2, 3]),
    "volume name": lambda: particles([0.0, 1.0], h=1, volume="voronoi"),
    "volume and mass": lambda: particles([0.0, 1.0], h=1, volume=1, mass=1),
    "density alone": lambda: particles([0.0, 1.0], h=1, density=1),
    "cells in space": lambda: particles(np.zeros((3, 2)), h=1, volume="cell"),
    "one cell": lambda: particles([0.0], h=1, volume="cell"),
    "mode": lambda: particles([0.0, 1.0], h=1, volume=1, mode="both"),
    "period": lambda: particles([0.0, 1.0], h=1, volume=1, period=-1),
    "period shape": lambda: particles([0.0, 1.0], h=1, volume=1, period=[1, 1]),
    "period small": lambda: particles([0.0, 1.0], h=1, volume=1, period=3.9).neighbourhood(
        ZERO, CUBIC
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_scenes_say_what_is_wrong(case: str) -> None:
    with pytest.raises(ValueError, match=r"^[a-z_]+: .*") as caught:
        BAD[case]()
    assert len(str(caught.value)) > 20
