"""Each operation on numbers with a bound: never wrong by more, and sometimes by almost as much."""

from __future__ import annotations

import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from sphtrunc.arithmetic.arrays import ArrayNumbers
from sphtrunc.arithmetic.bounded import Ball
from sphtrunc.experiment.engine.bounds import Bounded, BoundedNumbers


def balls(x: Any, y: Any, operation: Callable[..., Any], dx: Any, dy: Any) -> tuple[Any, Any]:
    found = operation(Ball(x, dx), Ball(y, dy))
    return found.middle, found.radius


def pairs(x: Any, y: Any, operation: Callable[..., Any], dx: Any, dy: Any) -> tuple[Any, Any]:
    numbers = ArrayNumbers()
    found = operation(Bounded(numbers, x, dx), Bounded(numbers, y, dy))
    return found.value, found.error * (1 + 1e-15 * dx.any())  # rounded themselves


CASES = [(way, op) for way in (balls, pairs) for op in (operator.add, operator.sub, operator.mul)]
CASES += [(pairs, operator.truediv)]
cases = pytest.mark.parametrize(("way", "operation"), CASES)


@cases
def test_a_rounding_attains_its_bound(way: Any, operation: Callable[..., Any]) -> None:
    """Of exact numbers, 4,000 pairs at random: the worst is wrong by more than nine tenths of the
    bound, so that no bound of half the size would do."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(1, 2, 4000), rng.uniform(1, 2, 4000) * 2.0 ** rng.integers(-3, 4, 4000)
    worst = Fraction(0)
    for a, b, value, bound in zip(x, y, *way(x, y, operation, 0 * x, 0 * y), strict=True):
        error = abs(operation(Fraction(a), Fraction(b)) - Fraction(float(value)))
        assert error <= Fraction(float(bound))
        worst = max(worst, error / Fraction(float(bound)))
    assert worst > Fraction(9, 10)


@cases
def test_errors_of_what_goes_in_are_carried(way: Any, operation: Callable[..., Any]) -> None:
    """The exact results of what the operands may be, at the ends of their intervals."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(1, 2, 500), rng.uniform(1, 2, 500)
    dx, dy = (10.0 ** rng.uniform(-18, -3, 500) for _ in range(2))
    values, bounds = way(x, y, operation, dx, dy)
    for a, b, da, db, value, bound in zip(x, y, dx, dy, values, bounds, strict=True):
        worst = max(
            abs(
                operation(Fraction(a) + i * Fraction(da), Fraction(b) + j * Fraction(db))
                - Fraction(float(value))
            )
            for i in (-1, 1)
            for j in (-1, 1)
        )
        # and no wider than by what is of second order in them, and a rounding below 4
        assert worst <= Fraction(float(bound)) <= worst * Fraction(101, 100) + Fraction(1, 2**51)


def test_a_root_attains_its_bound() -> None:
    numbers = BoundedNumbers(ArrayNumbers())
    x = np.random.default_rng(3).uniform(1, 4, 4000)
    found = numbers.sqrt(Bounded(numbers.plain, x, 0.0 * x))
    worst = 0.0
    for square, root, bound in zip(x, found.value, found.error, strict=True):
        rest = Fraction(square) - Fraction(float(root)) ** 2  # (√x − r)(√x + r)
        error = abs(rest) / (2 * Fraction(float(root)))
        assert error <= Fraction(float(bound)) * (1 + Fraction(1, 2**40))
        worst = max(worst, float(error / Fraction(float(bound))))
    assert worst > 0.9
