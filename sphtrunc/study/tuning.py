"""Tuning: which h and Δx to take, from the predicted parts of the error.

At wavelength λ an estimate is described by r = Δx/h and x = h/λ. Its cost is the number of pairs in
a volume λ^d, C = V_d κ^d x^{−d} r^{−2d}; particles alone are λ/Δx = 1/(r x) in each direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from functools import partial
from math import exp, inf, log
from typing import Any

import numpy as np

from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.conventions import BALL
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import DEFAULT
from sphtrunc.theory.disorder.sampling import ENOUGH
from sphtrunc.theory.disorder.spectral_law import predict_errors_from
from sphtrunc.theory.disorder.structure_factor import StructureFactor
from sphtrunc.theory.field_error import Split, predict_waves
from sphtrunc.theory.fields import Waves

PARTS = ("smoothing", "discretisation", "disorder", "rounding")
MOST_NEIGHBOURS = {1: 200, 2: 1000, 3: 4000}
GRID = {1: 129, 2: 49, 3: 33}  # values of Δx/h that are looked at first: dips are narrow in 1D
ROUGHLY = 0.03  # to which sampled errors are known where they are only compared
LENGTHS = 25  # values of h/λ that are looked at for a wanted error
LONGEST, SHORTEST = 0.5, 1e-5  # h/λ
COARSEST = 0.5  # Δx/λ: a wave is not seen by less than two particles
FINEST = 10**6  # Δx/h is a rational of at most this denominator


@dataclass(frozen=True)
class Problem:
    """What is estimated, on which particles.

    sigma, distribution: displacements, σ/Δx along each axis; lattice: which lattice is displaced
    disorder: in place of these, a structure factor in closed form; targets are particles

    Raises ValueError for what the prediction does not cover.
    """

    dim: int = 1
    operator: Operator = field(default_factory=Operator)
    sigma: float = 0.0
    distribution: str = "gaussian"
    lattice: str | None = None
    disorder: StructureFactor | None = None

    def __post_init__(self) -> None:
        dimension(self.dim)
        if not 0 <= self.sigma <= 1:
            raise ValueError(f"jitter: got {self.sigma:g}, expected σ/Δx from 0 to 1")

    def predict(
        self, kernel: Kernel, r: float, lengths: Sequence[float], enough: float = ENOUGH
    ) -> list[Split]:
        """The predicted error at Δx/h = r for every h/λ; where it is sampled, good to `enough`.

        Raises ValueError where there is none.
        """
        if self.disorder is not None:
            waves = Waves(2 * np.pi * np.asarray(lengths), np.eye(self.dim)[0])
            return predict_errors_from(
                kernel, self.operator, self.disorder, r, waves, at="particles"
            )
        return predict_waves(kernel, self.operator, self.scene(r), lengths, enough=enough)

    def scene(self, r: float) -> Arrangement:
        """The displaced lattice at Δx/h = r."""
        return Arrangement(
            self.lattice or DEFAULT[self.dim],
            Fraction(r).limit_denominator(FINEST),
            sigma=self.sigma,
            distribution=self.distribution,
        )

    def split(
        self, kernel: Kernel, r: float, lengths: Sequence[float], enough: float = ENOUGH
    ) -> list[Split] | None:
        """The same, None where a correction is singular or no neighbour is left."""
        try:
            return self.predict(kernel, r, lengths, enough)
        except ValueError:
            return None


@dataclass(frozen=True)
class Setting:
    """A choice of h and Δx, and what it gives.

    neighbours: particles in the support; cost: pairs in a volume λ^d; particles: λ/Δx
    """

    kernel: str
    dx_over_h: float
    h_over_lambda: float
    neighbours: float
    particles: float
    cost: float
    error: Split

    @property
    def dominant(self) -> str:
        """The largest part of the error."""
        return max(PARTS, key=lambda part: float(getattr(self.error, part)))

    def to_dict(self) -> dict[str, Any]:
        """All figures, the parts of the error beside them."""
        return {**asdict(self), "dominant": self.dominant}


def setting(problem: Problem, kernel: Kernel, r: float, x: float) -> Setting:
    """The setting at Δx/h = r and h/λ = x, with its predicted error.

    Raises ValueError where the estimate does not exist there.
    """
    try:
        (split,) = problem.predict(kernel, r, [x])
    except ValueError as reason:
        raise ValueError(f"no prediction for {kernel.name} at Δx/h = {r:g}: {reason}") from None
    neighbours = _neighbours(problem, kernel, r)
    particles = 1 / (r * x)
    cost = particles**problem.dim * neighbours
    return Setting(kernel.name, r, x, neighbours, particles, cost, split)


def _neighbours(problem: Problem, kernel: Kernel, r: float) -> float:
    return float(BALL[problem.dim]) * (float(kernel.support) / r) ** problem.dim


# ------------------------------------------------------------------------------- the best setting


def best_at_particles(
    problem: Problem, kernel: Kernel | str, particles: float, most: float = inf
) -> Setting:
    """The least error with λ/Δx given: the best number of neighbours for the particles there are,
    `most` at most.

    Raises ValueError where there is none within h/λ from 1e-5 to 0.5.
    """
    shape = parse_kernel(kernel)
    if not particles > 0:
        raise ValueError(f"particles: got {particles:g}, expected a positive number λ/Δx")
    return _least(problem, shape, lambda r: 1 / (particles * r), _grid(problem, shape, most))


def best_at_cost(problem: Problem, kernel: Kernel | str, cost: float, most: float = inf) -> Setting:
    """The least error with the number of pairs in a volume λ^d given, with `most` neighbours at
    most.

    Raises ValueError where there is none within h/λ from 1e-5 to 0.5.
    """
    shape = parse_kernel(kernel)
    if not cost > 0:
        raise ValueError(f"cost: got {cost:g}, expected a positive number of pairs")
    dim = problem.dim
    factor = float(BALL[dim]) ** (1 / dim) * float(shape.support) / cost ** (1 / dim)
    return _least(problem, shape, lambda r: factor / r**2, _grid(problem, shape, most))


def best_at_error(
    problem: Problem, kernel: Kernel | str, error: float, most: float = inf
) -> Setting:
    """The least cost with which the error at λ is not larger than wanted, with `most` neighbours at
    most.

    Raises ValueError where no setting within h/λ from 1e-5 to 0.5 reaches it.
    """
    shape = parse_kernel(kernel)
    if not 0 < error < 1:
        raise ValueError(f"error: got {error:g}, expected a relative error between 0 and 1")

    def cost(logarithm: float, enough: float = ENOUGH) -> float:
        x = _longest(problem, shape, exp(logarithm), error, enough)
        return inf if x is None else -log(x) - 2 * logarithm

    grid = _grid(problem, shape, most)
    logarithm = _minimum(cost, grid, partial(cost, enough=ROUGHLY))
    x = _longest(problem, shape, exp(logarithm), error, ENOUGH)
    if x is None:
        raise ValueError(
            f"error: {error:g} is not reached by {shape.name} with at most"
            f" {_neighbours(problem, shape, exp(grid[0])):.4g} neighbours; expected a larger error,"
            f" less disorder, {'another kernel, ' * (most < MOST_NEIGHBOURS[problem.dim])}or a form"
            " of higher consistency"
        )
    return setting(problem, shape, exp(logarithm), x)


def _longest(
    problem: Problem, kernel: Kernel, r: float, error: float, enough: float
) -> float | None:
    """The largest h/λ at which the error is not larger than wanted, to 0.2 %; None if there is none
    between the limits. Where errors are rough, the last step is that of a power law."""
    lengths = np.geomspace(SHORTEST, min(LONGEST, COARSEST / r), LENGTHS)
    while True:
        splits = problem.split(kernel, r, [float(x) for x in lengths], enough)
        fit = [i for i, s in enumerate(splits or ()) if s.total <= error]
        if not fit:
            return None
        last = fit[-1]
        if last + 1 == len(lengths) or lengths[1] < 1.002 * lengths[0]:
            return float(lengths[last])
        ends = lengths[last : last + 2]
        if enough > ENOUGH and lengths[1] < 1.2 * lengths[0]:
            below, above = (log(s.total) for s in (splits or ())[last : last + 2])
            return float(ends[0] * (ends[1] / ends[0]) ** ((log(error) - below) / (above - below)))
        lengths = np.geomspace(ends[0], ends[1], 5)


def _least(
    problem: Problem, kernel: Kernel, x: Callable[[float], float], grid: Sequence[float]
) -> Setting:
    def error(logarithm: float, enough: float = ENOUGH) -> float:
        r = exp(logarithm)
        if not SHORTEST <= x(r) <= min(LONGEST, COARSEST / r * (1 + 1e-9)):
            return inf
        splits = problem.split(kernel, r, [x(r)], enough)
        return inf if splits is None else splits[0].total

    r = exp(_minimum(error, grid, partial(error, enough=ROUGHLY)))
    if error(log(r)) == inf:
        raise ValueError(
            f"tune: no setting of {kernel.name} with at most"
            f" {_neighbours(problem, kernel, exp(grid[0])):.4g} neighbours has h/λ between"
            f" {SHORTEST:g} and {LONGEST:g} and two particles per wavelength; expected another"
            " number of particles or pairs"
        )
    return setting(problem, kernel, r, x(r))


def _grid(problem: Problem, kernel: Kernel, most: float) -> list[float]:
    """Logarithms of Δx/h from the most neighbours to hardly any.

    Raises ValueError where there is no prediction even with many neighbours.
    """
    problem.predict(kernel, float(kernel.support) / 6, [0.05])
    dim = problem.dim
    kappa = float(kernel.support)
    least = kappa * (float(BALL[dim]) / min(most, MOST_NEIGHBOURS[dim])) ** (1 / dim)
    return [float(v) for v in np.linspace(log(least), log(0.95 * kappa), GRID[dim])]


def _minimum(
    function: Callable[[float], float],
    grid: Sequence[float],
    roughly: Callable[[float], float] | None = None,
) -> float:
    """Where the function is least: on the grid, then on finer ones around its lowest valleys.

    roughly: the function as it may be taken on the grid, if that is cheaper
    """
    values = [inf, *((roughly or function)(v) for v in grid), inf]
    valleys = [
        (values[i], grid[i - 1])
        for i in range(1, len(grid) + 1)
        if values[i - 1] >= values[i] <= values[i + 1]
    ]
    found = []
    for value, place in sorted(valleys)[:2]:
        value = function(place) if roughly else value
        step = (grid[1] - grid[0]) / 2
        for _ in range(5):
            near = [(value, place)]
            for v in (place - step, place + step):
                if grid[0] <= v <= grid[-1]:
                    near.append((function(v), v))
            value, place = min(near)
            step /= 2
        found.append((value, place))
    return min(found)[1]


# ------------------------------------------------------------------------------------ convergence


@dataclass(frozen=True)
class Exponents:
    """h ∝ Δx^p balances smoothing against disorder; the error then is ∝ Δx^order, and the number
    of neighbours ∝ N^neighbours (Zhu, Hernquist & Li 2015, doi:10.1088/0004-637X/800/1/6, found
    0.4 to 0.5 empirically)."""

    p: Fraction
    order: Fraction
    neighbours: Fraction


def exponents(
    operator: Operator, dim: int, alpha: Fraction | int = 2, beta: int | None = None
) -> Exponents:
    """The best path at fixed disorder, exactly.

    Smoothing is ∝ h^s, the leading random error ∝ h^{j−m} (Δx/h)^q, with m the derivatives, j the
    degree of the first polynomial that is not reproduced on disordered particles. For S ∝ k^α

        q = min((d + α)/2, β + 1 + (d−1)/2),   p = q/(q + s − j + m)

    alpha: 2 for displaced lattices, 0 for independent particles and the plateau of a glass
    beta: boundary smoothness of the kernel, whose lattice error is the ceiling; None: smooth enough

    Raises ValueError for a negative α.
    """
    dim = dimension(dim)
    if alpha < 0:
        raise ValueError(f"alpha: got {alpha}, expected an exponent of S(k) from 0")
    j = operator.consistency + 1
    s = smoothing_power(operator)
    q = Fraction(dim + alpha) / 2
    if beta is not None:
        q = min(q, beta + 1 + Fraction(dim - 1, 2))
    p = q / (q + s - j + operator.derivatives)
    return Exponents(p, s * p, 1 - p)


def smoothing_power(operator: Operator) -> int:
    """Of h, in the continuous limit of a symmetric kernel: 2, and 4 for RKPM-2 and RKPM-3."""
    degree = operator.polynomial_degree or 0
    return 4 if degree >= 2 else 2


def walk(
    problem: Problem, kernel: Kernel | str, particles: Sequence[float]
) -> tuple[list[Setting], float, float]:
    """The best setting for each λ/Δx, and the exponents p of h ∝ Δx^p and of the error that a
    straight line through them has."""
    settings = [best_at_particles(problem, kernel, n) for n in particles]
    dx = np.log([1 / s.particles for s in settings])
    h = np.log([s.h_over_lambda for s in settings])
    error = np.log([s.error.total for s in settings])
    return settings, float(np.polyfit(dx, h, 1)[0]), float(np.polyfit(dx, error, 1)[0])
