"""Random numbers that are a pure function of (seed, place): the same in whatever order, block or
thread they are visited. A 64-bit finaliser is applied twice to the packed place, keyed by the seed.

Displacements u are in units of the standard deviation: every component has mean 0 and variance 1.
"""

from __future__ import annotations

from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from sphtrunc.arithmetic.summation import Array

Bits = NDArray[np.uint64]
Indices = NDArray[np.int64]

DISTRIBUTIONS = ("gaussian", "uniform", "blue")
BITS = 21  # of each of three components
MOST_INDICES = 2 ** (BITS - 1)  # along one axis
CUT = 4.0  # the Gaussian ends at this many standard deviations

_FIELD = 2**BITS - 1
_FINE = 9  # bits within a stratum of the tabulated Gaussian
_STRATA = 2 ** (BITS - _FINE)


def _mix(z: Bits) -> Bits:
    """The finaliser of SplitMix64 (Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195), in
    place: a bijection of the 64-bit integers in which every input bit reaches every output bit."""
    t = z >> np.uint64(30)
    z ^= t
    z *= np.uint64(0xBF58476D1CE4E5B9)
    np.right_shift(z, np.uint64(27), out=t)
    z ^= t
    z *= np.uint64(0x94D049BB133111EB)
    np.right_shift(z, np.uint64(31), out=t)
    z ^= t
    return z


@lru_cache(maxsize=64)
def _keys(seed: int, purpose: int) -> tuple[np.uint64, np.uint64]:
    golden = 0x9E3779B97F4A7C15
    state = [((2 * seed + 1) * golden + (purpose + i) * 0xD1342543DE82EF95) % 2**64 for i in (0, 7)]
    first, second = _mix(_mix(np.array(state, dtype=np.uint64)))
    return first, second


def noise(place: Bits, seed: int, purpose: int = 0) -> Bits:
    """64 random bits for every place (shape kept); independent for different purposes."""
    first, second = _keys(seed, purpose)
    z = place + first
    _mix(z)
    z += second
    return _mix(z)


def uniform01(place: Bits, seed: int, purpose: int) -> Array:
    """Uniform numbers in (0, 1), 52 bits, never 0 or 1."""
    return ((noise(place, seed, purpose) >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52


def place(index: Indices) -> Bits:
    """One word per particle from its lattice indices, shape (d, …): m₀ + 2²¹ m₁ + 2⁴² m₂.

    It is linear, so the place of a neighbour is the sum of two places, and different for all
    particles within 2²⁰ of the origin along each axis.
    """
    packed = np.zeros(index.shape[1:], dtype=np.int64)
    for axis, m in enumerate(index):
        packed += m << (BITS * axis)
    return packed.view(np.uint64)


@lru_cache(maxsize=1)
def _gaussian_table() -> tuple[Array, Array, float]:
    """Start and slope of each stratum, and the largest value.

    The Gaussian quantile function at 4096 equal probabilities, linear between them, closed at
    ±CUT and scaled to unit variance; its kurtosis is 2.9998 instead of 3.
    """
    normal = NormalDist()
    inner = [normal.inv_cdf(i / _STRATA) for i in range(1, _STRATA)]
    knots = np.array([-CUT, *inner, CUT])
    knots = (knots - knots[::-1]) / 2.0
    a, b = knots[:-1], knots[1:]
    step = (b - a) / 2**_FINE
    # values lie at the middles of 2^9 equal steps: variance of the stratum less that of a step
    variance = np.mean((a * a + a * b + b * b) / 3.0 - step * step / 12.0)
    scale = 1.0 / np.sqrt(variance)
    return (a + 0.5 * step) * scale, step * scale, float((CUT - step[0] / 2.0) * scale)


def largest(distribution: str) -> float:
    """Largest |u| of a component that can occur before any filter, in standard deviations."""
    return 3.0**0.5 if distribution == "uniform" else _gaussian_table()[2]


def component(bits: Bits, axis: int, distribution: str) -> Array:
    """The displacement along one axis, of unit variance, from 21 of the 63 low bits."""
    cell = (bits >> np.uint64(BITS * axis)).view(np.int64)
    if distribution == "uniform":
        cell &= _FIELD
        value = cell.astype(np.float64)
        value += 0.5 - 2.0 ** (BITS - 1)
        value *= 2.0 * 3.0**0.5 / 2.0**BITS
        return np.asarray(value)
    start, step, _ = _gaussian_table()
    value = (cell & (2**_FINE - 1)).astype(np.float64)
    cell >>= _FINE
    cell &= _STRATA - 1
    value *= step.take(cell, mode="clip")
    value += start.take(cell, mode="clip")
    return np.asarray(value)


def permuted(k: Indices, size: int, seed: int) -> Indices:
    """The k-th element of a pseudo-random permutation of 0 … size − 1.

    A four-round Feistel network on the next even power of two, walked until it falls inside
    (Black & Rogaway 2002, doi:10.1007/3-540-45760-7_9): a random sample without repetition whose
    first n elements do not depend on how many more are drawn.
    """
    half = max(1, ((size - 1).bit_length() + 1) // 2)
    mask = np.uint64(2**half - 1)
    shift = np.uint64(half)

    def shuffle(z: Bits) -> Bits:
        left, right = z >> shift, z & mask
        for purpose in range(100, 104):
            left, right = right, left ^ (noise(right, seed, purpose) & mask)
        return (left << shift) | right

    out = shuffle(k.astype(np.uint64))
    outside = np.flatnonzero(out >= np.uint64(size))
    while outside.size:
        out[outside] = shuffle(out[outside])
        outside = outside[out[outside] >= np.uint64(size)]
    return out.astype(np.int64)
