"""The Fourier modes of particles in a box: ρ_k = Σ_b w_b e^{−ik·x_b}, k = 2π n/L, n whole numbers.

Two ways, of the same numbers: direct sums, which separate, e^{ik·x} = ∏ e^{ik_i x_i}, so that they
are products of matrices; and, where that takes too long, a non-uniform fast Fourier transform:
weights spread over a grid by a short window, one FFT, and the window divided out again (Dutt &
Rokhlin 1993, doi:10.1137/0914081; the window is that of Barnett, Magland & af Klinteberg 2019,
doi:10.1137/18M120885X).
"""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

WIDTH = 7  # points of the window along each axis
FINER = 2.0  # the grid is so many times finer than the modes need
SHAPE = 2.3 * WIDTH  # β of the window e^{β(√(1−z²)−1)}
ERROR = 1e-5  # of ρ_k by the grid, relative to √(N Σ w²): what the window leaves, with room
BLOCK = 1 << 14  # particles at a time
MOST_DIRECT = 2e9  # products of a direct sum, beyond which the grid is faster


def half_space(period: Array, reach: float) -> Any:
    """Whole numbers n (d, M) of the modes 0 < |k| <= reach, one of k and −k."""
    most = [int(reach * side / (2 * np.pi) * (1 + 1e-12)) for side in period]
    axes = [np.arange(most[0] + 1), *(np.arange(-m, m + 1) for m in most[1:])]
    n = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")])
    k = 2 * np.pi * n / period[:, None]
    kept = (k * k).sum(axis=0) <= (reach * (1 + 1e-12)) ** 2
    n = n[:, kept]
    leading = np.sign(n[0])
    for row in n[1:]:
        leading = np.where(leading == 0, np.sign(row), leading)
    return n[:, leading > 0]


def amplitudes(x: Array, weights: Array, period: Array, n: Any, way: str | None = None) -> Any:
    """ρ_k at the modes n (d, M), of particles x (d, N) in a box `period` (d,), complex (M,).

    way: "direct" or "grid"; None: the grid where direct sums take long
    """
    most = [int(np.abs(row).max(initial=0)) for row in n]
    if way is None:
        cost = x.shape[1] * (most[0] + 1) * prod(2.0 * m + 1 for m in most[1:])
        way = "grid" if cost > MOST_DIRECT else "direct"
    u = x / period[:, None]
    return (_gridded if way == "grid" else _direct)(u - np.floor(u), weights, n, most)


def _direct(u: Array, weights: Array, n: Any, most: list[int]) -> Any:
    """By products of matrices, a block of particles at a time."""
    low = [0, *(-m for m in most[1:])]
    total: Any = 0.0
    for first in range(0, u.shape[1], BLOCK):
        part = slice(first, first + BLOCK)
        waves = [
            np.exp(-2j * np.pi * np.outer(np.arange(a, m + 1), row[part]))
            for a, m, row in zip(low, most, u, strict=True)
        ]
        waves[0] = waves[0] * weights[part]
        if len(waves) == 1:
            total = total + waves[0].sum(axis=1)
        elif len(waves) == 2:
            total = total + waves[0] @ waves[1].T
        else:
            total = total + np.stack([(row * waves[1]) @ waves[2].T for row in waves[0]])
    return total[tuple(row - a for row, a in zip(n, low, strict=True))]


def _gridded(u: Array, weights: Array, n: Any, most: list[int]) -> Any:
    """By the non-uniform FFT."""
    from scipy import fft

    size = [fft.next_fast_len(max(int(FINER * (2 * m + 1)), 2 * WIDTH), real=True) for m in most]
    grid = np.zeros(prod(size))
    steps = np.indices((WIDTH,) * len(size)).reshape(len(size), -1)
    for first in range(0, u.shape[1], BLOCK):
        part = slice(first, first + BLOCK)
        places, windows = [], []
        for count, row in zip(size, u, strict=True):
            at = row[part] * count
            start = np.ceil(at - WIDTH / 2).astype(np.int64)
            z = (start + np.arange(WIDTH)[:, None] - at) / (WIDTH / 2)
            windows.append(np.exp(SHAPE * (np.sqrt(np.maximum(1.0 - z * z, 0.0)) - 1.0)))
            places.append((start + np.arange(WIDTH)[:, None]) % count)
        value: Any = weights[part]
        place: Any = 0
        for axis, count in enumerate(size):
            value = value * windows[axis][steps[axis]]
            place = place * count + places[axis][steps[axis]]
        np.add.at(grid, place.ravel(), value.ravel())
    modes = fft.rfftn(grid.reshape(size))
    # the last axis has no negative numbers: ρ_{−k} is the conjugate
    turned = n[-1] < 0
    m = np.where(turned, -n, n)
    found = modes[tuple(row % count for row, count in zip(m, size, strict=True))]
    found = np.where(turned, found.conj(), found)
    for row, count in zip(n, size, strict=True):
        found = found / _window_transform(np.arange(np.abs(row).max() + 1) / count)[np.abs(row)]
    return found


def _window_transform(f: Array) -> Array:
    """∫ e^{β(√(1−(2t/w)²)−1)} cos 2πft dt over the window, f in cycles per grid step."""
    t, w = np.polynomial.legendre.leggauss(60)
    half = WIDTH / 2
    window = w * half * np.exp(SHAPE * (np.sqrt(1.0 - t * t) - 1.0))
    return np.asarray(np.cos(2 * np.pi * np.multiply.outer(f, t * half)) @ window)


def tapered(x: Array, reach: float, weights: Array | None = None) -> tuple[Any, Any, Array, float]:
    """(k, ρ_k, blur, Σ w²) of a free set under a Hann window over its bounding box: what the mean
    density itself shows through the window is taken out.

    weights: (N,) of the particles, such as volumes that make the density even; None: 1

    k: (d, M) on the grid of the box; blur: 2π/L along each axis: features narrower than twice that
    are smeared, and modes nearer to 0 than that are left out
    """
    low, high = x.min(axis=1), x.max(axis=1)
    side = (high - low) * (1 + 1e-12)
    if not np.all(side > 0):
        raise ValueError("particles: they lie in a plane or a line, expected a set with a volume")
    u = (x - low[:, None]) / side[:, None]
    window = np.prod(0.5 - 0.5 * np.cos(2 * np.pi * u), axis=0)
    if weights is not None:
        window = window * weights
    n = half_space(side, reach)
    seen = amplitudes(x - low[:, None], window, side, n)
    # the Hann window itself has the modes −1, 0, 1 along each axis: ½, and −¼ at ±1
    mean = np.ones(n.shape[1])
    for row in n:
        mean = mean * np.where(row == 0, 0.5, np.where(np.abs(row) == 1, -0.25, 0.0))
    total = window.sum() / 0.5 ** len(side)
    seen = seen - total * mean
    kept = np.abs(n).max(axis=0) > 1
    k = 2 * np.pi * n / side[:, None]
    return k[:, kept], seen[kept], 2 * np.pi / side, float((window**2).sum())
