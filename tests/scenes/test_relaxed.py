"""Recipes of glasses: what they say, what they refuse, and where they start."""

from __future__ import annotations

import numpy as np
import pytest

from sphtrunc.scenes.relaxed import Recipe, recipe


def test_a_recipe_is_read_as_it_is_written() -> None:
    text = "relaxed:glass,N=4096,kernel=wendland-c2,h_over_dx=1.5,seed=1"
    made = recipe(text)
    assert made == Recipe(count=4096, kernel="wendland-c2", h_over_dx=1.5, seed=1)
    assert str(made) == text
    assert recipe(str(recipe("glass,N=512,dim=3,start=random"))).start == "random"
    assert (recipe("glass,N=64").h, recipe("glass,N=64").side) == (1.6, 8.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("relaxed:gas,N=64", "relaxed: got 'gas', expected glass"),
        ("relaxed:glass", "no number of particles"),
        ("relaxed:glass,N=5", "N: got 5, expected a whole number from 8"),
        ("relaxed:glass,N=many", "N: got 'many', expected a whole number"),
        ("relaxed:glass,N=1000", "expected 1024 or 1089, or start=random"),
        ("relaxed:glass,N=64,dim=4", "dim: got 4, expected 1, 2 or 3"),
        ("relaxed:glass,N=64,shape=cubic", "expected NAME=VALUE of N, dim"),
        ("relaxed:glass,N=64,kernel=cubic-spline", "expected both, or neither"),
        ("relaxed:glass,N=64,h_over_dx=x", "h_over_dx: got 'x', expected a number"),
        ("relaxed:glass,N=64,h_over_dx=-1,kernel=lucy", "expected about 1.5"),
        ("relaxed:glass,N=64,start=cold", "start: got 'cold', expected one of jittered, random"),
        ("relaxed:glass,N=64,residual=0", "residual: got 0.0"),
        ("relaxed:glass,N=64,contrast=1", "contrast: got 1.0"),
        ("relaxed:glass,N=64,seed=99999999999999999999", "seed: got"),
    ],
)
def test_other_recipes_are_refused(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        recipe(text)


@pytest.mark.parametrize("start", ["jittered", "random"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_starts_fill_the_box_and_depend_on_the_seed(dim: int, start: str) -> None:
    made = Recipe(count=4096, dim=dim, start=start, seed=3)
    x = made.begin()
    assert x.shape == (dim, 4096)
    assert x.min() >= 0
    assert x.max() < made.side
    assert np.array_equal(x, Recipe(count=4096, dim=dim, start=start, seed=3).begin())
    assert not np.array_equal(x, Recipe(count=4096, dim=dim, start=start, seed=4).begin())
    counts = np.histogram(x[0], 8, (0, made.side))[0]
    assert np.abs(counts - 512).max() < (120 if start == "random" else 60)


def test_a_profile_is_there_from_the_start() -> None:
    """Particles between 0 and L/4, by ∫(1 + c cos 2πx/L): ¼ + c/2π of all."""
    made = Recipe(count=10000, contrast=0.4)
    x = made.begin()[0] / made.side
    assert np.mean(x < 0.25) == pytest.approx(0.25 + 0.4 / (2 * np.pi), abs=0.005)
    assert np.mean(np.abs(x - 0.5) < 0.25) == pytest.approx(0.5 - 0.4 / np.pi, abs=0.005)
