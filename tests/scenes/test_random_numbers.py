"""The counter-based generator: statistics of bits, neighbours, seeds and distributions."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from sphtrunc.scenes import random_numbers as jitter

N = 1 << 15


def standard_lines() -> dict[str, np.ndarray]:
    """Places as scenes visit them: runs along each axis, a cube, and a diagonal."""
    run = np.arange(-N // 2, N // 2)
    zero = np.zeros_like(run)
    cube = np.stack(np.meshgrid(*[np.arange(50)] * 3, indexing="ij")).reshape(3, -1)
    return {
        "x": jitter.place(np.stack([run])),
        "y": jitter.place(np.stack([zero, run])),
        "z": jitter.place(np.stack([zero, zero, run])),
        "cube": jitter.place(cube),
        "diagonal": jitter.place(np.stack([run, run, run])),
    }


LINES = standard_lines()


@pytest.mark.parametrize("line", LINES)
@pytest.mark.parametrize("seed", [0, 1, 2**63])
def test_every_bit_is_fair_and_no_two_agree(line: str, seed: int) -> None:
    bits = jitter.noise(LINES[line], seed)
    n = bits.size
    plane = ((bits[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)).astype(np.float64)
    signs = 2 * plane - 1
    assert np.abs(signs.mean(axis=0)).max() * np.sqrt(n) < 5.0
    correlation = signs.T @ signs / n - np.eye(64)
    assert np.abs(correlation).max() * np.sqrt(n) < 5.5


@pytest.mark.parametrize("line", LINES)
def test_words_are_uniform(line: str) -> None:
    bits = jitter.noise(LINES[line], 3)
    for shift in (0, 21, 42, 52):
        counts = np.bincount(((bits >> np.uint64(shift)) & np.uint64(1023)).astype(int))
        assert stats.chisquare(counts).pvalue > 1e-5


def test_every_input_bit_flips_every_output_bit_half_of_the_time() -> None:
    rng = np.random.default_rng(0)
    places = rng.integers(0, 2**63, 4000, dtype=np.uint64)
    base = jitter.noise(places, 5)
    for bit in range(63):
        flipped = base ^ jitter.noise(places ^ np.uint64(1 << bit), 5)
        rate = ((flipped[:, None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)).mean(axis=0)
        assert np.abs(rate - 0.5).max() < 5.5 * 0.5 / np.sqrt(4000)


@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
@pytest.mark.parametrize("line", LINES)
def test_neighbours_axes_and_seeds_are_uncorrelated(distribution: str, line: str) -> None:
    bits = jitter.noise(LINES[line], 7)
    other = jitter.noise(LINES[line], 8)
    u = [jitter.component(bits, axis, distribution) for axis in range(3)]
    v = jitter.component(other, 0, distribution)
    root = np.sqrt(bits.size)
    for lag in (1, 2, 3, 50, 51, 2500):
        assert abs(np.mean(u[0][lag:] * u[0][:-lag])) * root < 4.5
    for a, b in pairwise([*u, v]):
        assert abs(np.mean(a * b)) * root < 4.5
    spectrum = np.abs(np.fft.rfft(u[0])[1:]) ** 2 / bits.size
    assert spectrum.max() < 2.0 * np.log(bits.size)


@pytest.mark.parametrize("distribution", ["gaussian", "uniform"])
def test_distribution_over_all_its_values(distribution: str) -> None:
    """All 2^21 values, not a sample: mean, variance and range are what they are said to be."""
    every = np.arange(2**jitter.BITS, dtype=np.uint64)
    u = jitter.component(every, 0, distribution)
    assert abs(u.mean()) < 1e-12
    assert abs((u * u).mean() - 1.0) < 1e-11
    assert np.abs(u).max() <= jitter.largest(distribution) * (1 + 1e-15)
    for axis in (1, 2):
        moved = jitter.component(every << np.uint64(jitter.BITS * axis), axis, distribution)
        assert np.array_equal(moved, u)


def test_the_gaussian_is_gaussian() -> None:
    every = np.arange(2**jitter.BITS, dtype=np.uint64)
    u = np.sort(jitter.component(every, 0, "gaussian"))
    assert stats.kstest(u, "norm").statistic < 5e-5
    assert abs((u**4).mean() - 3.0) < 3e-4
    assert jitter.largest("gaussian") == pytest.approx(jitter.CUT, rel=2e-3)


def test_uniform01_is_uniform_and_open() -> None:
    u = jitter.uniform01(LINES["cube"], 0, 3)
    assert u.min() > 0
    assert u.max() < 1
    assert stats.kstest(u, "uniform").pvalue > 1e-4


@pytest.mark.parametrize("size", [1, 2, 3, 5, 16, 17, 1000, 4097])
def test_permutation_visits_everything_once(size: int) -> None:
    seen = jitter.permuted(np.arange(size), size, 1)
    assert sorted(seen) == list(range(size))
    assert np.array_equal(seen[: size // 2], jitter.permuted(np.arange(size // 2), size, 1))


def test_permutation_samples_fairly() -> None:
    size = 10**9
    seen = jitter.permuted(np.arange(20_000), size, 2)
    assert np.unique(seen).size == 20_000
    assert stats.kstest(seen / size, "uniform").pvalue > 1e-4
    assert abs(np.corrcoef(seen[1:], seen[:-1])[0, 1]) < 4.5 / np.sqrt(20_000)
