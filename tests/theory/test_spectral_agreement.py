"""The law of disorder against Monte Carlo: a thousand and some cases of random process × kernel ×
operator × dimension, each within four standard errors and what the theory says that it neglects.

The points are drawn once for a process; the sums are made from W, W′ and W″ alone, corrections by
systems of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
import pytest

from sphtrunc import kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.theory.disorder.spectral_law import predict_from
from sphtrunc.theory.disorder.structure_factor import StructureFactor, displaced, poisson

KERNELS = (
    "wendland-c2", "cubic-spline", "lucy", "polynomial:4", "quintic-spline", "quartic-spline",
    "wendland-c4", "wendland-c6",
)  # fmt: skip
#: operator -> the moment that is looked at, along the first axis
OPERATORS = {
    Operator("value"): 0,
    Operator("gradient"): 0,
    Operator("gradient", "difference"): 1,
    Operator("gradient", "symmetric"): 2,
    Operator("laplacian", "brookshaw"): 2,
    Operator("laplacian", "difference"): 2,
    Operator("value", None, "shepard"): 2,
    Operator("gradient", "difference", "csph"): 2,
}
RATIO = 0.3  # Δx/h over the support: 3.3 Δx to its edge
REACH = 1 / RATIO
DRAWS = {1: 4000, 2: 1500, 3: 500}

Draw = Callable[[Any, int], Any]


def lattice(dim: int, sigma: float, kind: str = "gaussian", cell: Any = None) -> Draw:
    """Particles (n, N, d) of a displaced lattice about random points; `blue`: each displacement
    less the mean of those of its nearest neighbours."""
    sides = np.ones(dim) if cell is None else cell
    basis = np.zeros((1, dim)) if cell is None else np.array([[0.0, 0.0], [0.5, 0.5]])
    reach = [int(np.ceil((REACH + 5 * sigma) / side)) + 2 for side in sides]
    axes = [np.arange(-n, n + 1) for n in reach]
    shape = tuple(axis.size for axis in axes)
    index = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    sites = ((index[:, None] + basis) * sides).reshape(-1, dim)

    def draw(rng: Any, n: int) -> Any:
        offset = (rng.random((n, 1, dim)) - 0.5) * sides
        u = rng.normal(size=(n, len(sites), dim))
        if kind == "uniform":
            u = (2 * rng.random(u.shape) - 1) * sqrt(3)
        if kind == "blue":
            v = u.reshape(n, *shape, dim)
            near = [np.roll(v, s, 1 + i) for i in range(dim) for s in (1, -1)]
            u = (v - sum(near) / (2 * dim)).reshape(u.shape) / sqrt(1 + 1 / (2 * dim))
        return sites + offset + sigma * u

    return draw


def independent(dim: int) -> Draw:
    side = 2 * REACH + 0.5

    def draw(rng: Any, n: int) -> Any:
        count = rng.poisson(side**dim, n)
        x = (rng.random((n, count.max(), dim)) - 0.5) * side
        x[np.arange(count.max()) >= count[:, None]] = 99.0
        return x

    return draw


HEXAGON = np.array([1.0, sqrt(3)]) * sqrt(2 / sqrt(3))  # of area 2
PROCESSES: dict[tuple[int, str], tuple[StructureFactor, Draw]] = {
    (1, "poisson"): (poisson(1), independent(1)),
    (1, "0.05"): (displaced("uniform", 0.05), lattice(1, 0.05)),
    (1, "0.1"): (displaced("uniform", 0.1), lattice(1, 0.1)),
    (1, "0.2"): (displaced("uniform", 0.2), lattice(1, 0.2)),
    (1, "0.3"): (displaced("uniform", 0.3), lattice(1, 0.3)),
    (1, "0.2 uniform"): (displaced("uniform", 0.2, "uniform"), lattice(1, 0.2, "uniform")),
    (1, "0.1 blue"): (displaced("uniform", 0.1, "blue"), lattice(1, 0.1, "blue")),
    (1, "0.2 blue"): (displaced("uniform", 0.2, "blue"), lattice(1, 0.2, "blue")),
    (1, "0.3 blue"): (displaced("uniform", 0.3, "blue"), lattice(1, 0.3, "blue")),
    (2, "poisson"): (poisson(2), independent(2)),
    (2, "0.05"): (displaced("square", 0.05), lattice(2, 0.05)),
    (2, "0.2"): (displaced("square", 0.2), lattice(2, 0.2)),
    (2, "0.1 uniform"): (displaced("square", 0.1, "uniform"), lattice(2, 0.1, "uniform")),
    (2, "0.2 blue"): (displaced("square", 0.2, "blue"), lattice(2, 0.2, "blue")),
    (2, "0.1 hexagonal"): (displaced("hexagonal", 0.1), lattice(2, 0.1, cell=HEXAGON)),
    (3, "poisson"): (poisson(3), independent(3)),
    (3, "0.1"): (displaced("cubic", 0.1), lattice(3, 0.1)),
    (3, "0.3"): (displaced("cubic", 0.3), lattice(3, 0.3)),
}


def kernels_of(dim: int) -> tuple[str, ...]:
    return KERNELS[:5] if dim == 3 else KERNELS


def operators_of(process: str) -> list[Operator]:
    """Of independent particles none that is divided by what may be 0."""
    return [o for o in OPERATORS if process != "poisson" or o.correction == "none"]


def sums(name: str, x: Any, operators: list[Operator]) -> dict[Operator, Any]:
    """The moment of these operators about every one of the points, (n,), from (n, N, d) in Δx."""
    shape, dim = kernel(name), x.shape[2]
    support = float(shape.support)
    r = RATIO * support
    s = r * x
    q = np.sqrt((s**2).sum(axis=2))
    where = np.nonzero((q > 0) & (q < support))
    s, q = s[where], q[where]
    volume = r**dim
    w, dw, d2w = (volume * f(q, dim) for f in (shape.w, shape.dw, shape.d2w))

    def total(terms: Any) -> Any:
        return np.bincount(where[0], terms, len(x))

    first = s[:, 0]
    slope = -dw / q
    matrix = np.empty((len(x), dim, dim))
    second = np.empty((len(x), dim))
    for i in range(dim):
        second[:, i] = total(slope * s[:, i] * first**2)
        for j in range(dim):
            matrix[:, i, j] = total(slope * s[:, i] * s[:, j])
    made: dict[Operator, Callable[[], Any]] = dict(
        zip(
            OPERATORS,
            (
                lambda: total(w),
                lambda: total(slope * first),
                lambda: matrix[:, 0, 0],
                lambda: second[:, 0],
                lambda: total(2 * slope * first**2),
                lambda: total((d2w + (dim - 1) * dw / q) * first**2),
                lambda: total(w * first**2) / total(w),
                # rows of the matrix are components of the gradient
                lambda: np.linalg.solve(matrix, second[..., None])[:, 0, 0],
            ),
            strict=True,
        )
    )
    return {operator: made[operator]() for operator in operators}


def deviations(
    dim: int, process: str, kernels: tuple[str, ...], scale: float = 1.0
) -> list[tuple[float, str]]:
    """How far mean and spread of every case are from the law, in what is allowed of it."""
    factor, draw = PROCESSES[dim, process]
    x = draw(np.random.default_rng([1, dim, len(process)]), DRAWS[dim])
    n, found = len(x), []
    for name in kernels:
        ratio = RATIO * float(kernel(name).support)
        seen = sums(name, x, operators_of(process))
        for operator in operators_of(process):
            top = OPERATORS[operator]
            alpha = (top, *(0,) * (dim - 1))
            law = predict_from(kernel(name), operator, factor, ratio, degree=max(top, 1))
            mean, std = law.mean[alpha], scale * law.std[alpha]
            neglected = 0.0
            if operator.correction != "none":
                # to first order in the fluctuation of what it is divided by
                by = Operator("value") if operator.name == "value" else Operator("gradient")
                own = predict_from(kernel(name), by, factor, ratio, degree=1)
                part = (0,) * dim if operator.name == "value" else (1, *(0,) * (dim - 1))
                neglected = own.std[part]
            values = seen[operator]
            apart = values - values.mean()
            spread = float(apart.std())
            kurtosis = float((apart**4).mean()) / spread**4
            allowed = 4 * spread / sqrt(n) + neglected * (std + neglected * abs(mean))
            found.append((abs(values.mean() - mean) / allowed, f"mean, {name}, {operator}"))
            allowed = 4 * spread * sqrt((kurtosis - 1) / (4 * n)) + neglected * std
            found.append((abs(spread - std) / allowed, f"spread, {name}, {operator}"))
    return found


@pytest.mark.parametrize(("dim", "process"), PROCESSES)
def test_a_process(dim: int, process: str) -> None:
    found = deviations(dim, process, kernels_of(dim))
    assert not [(value, told) for value, told in found if value > 1]


def test_there_are_a_thousand_cases() -> None:
    assert sum(len(kernels_of(d)) * len(operators_of(p)) for d, p in PROCESSES) >= 1000


@pytest.mark.parametrize(("dim", "process"), [(1, "0.1"), (2, "0.05")])
def test_a_spread_that_is_off_would_be_seen(dim: int, process: str) -> None:
    """By a tenth: of most operators that are not corrected."""
    for scale in (0.9, 1.1):
        found = deviations(dim, process, KERNELS[:2], scale)
        spreads = [value for value, told in found if told.startswith("spread") and "none" in told]
        assert np.mean(np.array(spreads) > 1) > 0.8
