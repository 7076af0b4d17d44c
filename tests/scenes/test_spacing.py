"""λ of Antuono et al. (2014): nothing on lattices, and what a loop over quadrants finds."""

from __future__ import annotations

from math import atan2, pi
from typing import Any

import numpy as np
import pytest

from sphtrunc.scenes.spacing import disorder


def grid(cells: int, axes: Any, basis: Any) -> Any:
    """(d, n) sites of a lattice of unit cells `axes` (d, d) with a basis (m, d) in them."""
    axes, basis = np.atleast_2d(axes).astype(float), np.atleast_2d(basis).astype(float)
    index = np.stack(np.meshgrid(*[np.arange(cells)] * len(axes), indexing="ij"), axis=-1)
    return ((index.reshape(-1, 1, len(axes)) + basis).reshape(-1, len(axes)) @ axes).T


ROOT = np.sqrt(3.0)
LATTICES = {
    "uniform": (np.eye(1), [[0.0]]),
    "square": (np.eye(2), [[0.0, 0.0]]),
    "hexagonal": (np.diag([1.0, ROOT]), [[0.0, 0.0], [0.5, 0.5]]),
    "cubic": (np.eye(3), [[0.0, 0.0, 0.0]]),
    "bcc": (np.eye(3), [[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]),
    "fcc": (np.eye(3), [[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]]),
}


@pytest.mark.parametrize("name", LATTICES)
def test_lattices_have_no_disorder(name: str) -> None:
    axes, basis = LATTICES[name]
    cells = 12 if len(axes) < 3 else 6
    x = grid(cells, axes, basis)
    assert disorder(x, cells * np.diag(axes)) == pytest.approx(0.0, abs=1e-12)


def test_it_is_what_a_loop_over_quadrants_finds() -> None:
    rng = np.random.default_rng(4)
    x = rng.random((2, 90))
    found = []
    for a in range(90):
        s = x - x[:, [a]]
        s -= np.round(s)
        near = sorted((np.hypot(*s[:, b]), atan2(s[1, b], s[0, b])) for b in range(90) if b != a)
        first: dict[int, float] = {}
        for r, angle in near:
            first.setdefault(round((angle - near[0][1]) / (pi / 2)) % 4, r)
        assert len(first) == 4
        least, most = near[0][0], max(first.values())
        found.append((most - least) / (most + least))
    assert disorder(x, np.ones(2)) == pytest.approx(np.mean(found), rel=1e-12)


def test_in_one_dimension_it_is_the_two_sides() -> None:
    x = np.array([[0.0, 0.25, 0.5, 0.9]])
    sides = [(0.1, 0.25), (0.25, 0.25), (0.25, 0.4), (0.1, 0.4)]
    expected = np.mean([(b - a) / (b + a) for a, b in sides])
    assert disorder(x, np.ones(1)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_it_grows_with_the_displacement_and_does_not_know_directions(dim: int) -> None:
    rng = np.random.default_rng(dim)
    cells = {1: 400, 2: 24, 3: 9}[dim]
    x = grid(cells, np.eye(dim), np.zeros((1, dim)))
    u = rng.normal(size=x.shape)
    box = np.full(dim, float(cells))
    seen = [disorder(x + sigma * u, box) for sigma in (0.01, 0.02, 0.05, 0.1, 0.2)]
    assert np.all(np.diff(seen) > 0)
    assert seen[1] == pytest.approx(2 * seen[0], rel=0.05)
    turn = np.linalg.qr(rng.normal(size=(dim, dim)))[0]
    assert disorder(turn @ (x + 0.1 * u), None) == pytest.approx(disorder(x + 0.1 * u, None))
