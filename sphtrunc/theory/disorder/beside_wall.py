"""Disorder beside a wall: displaced particles of a lattice that a plane cuts, each on the side of
its site.

Var M_α = σ² Σ_b |∂M_α/∂x_b|² over the particles that are left, through corrections, whose means
are those beside the wall; to order σ⁴ where they are few and the kernel is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING

from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.walls import Wall
from sphtrunc.theory.disorder.ghosts import Ghosted
from sphtrunc.theory.disorder.prediction import SECOND_ORDER, Prediction
from sphtrunc.theory.disorder.propagation import propagate
from sphtrunc.theory.disorder.sensitivities import Stencil, is_smooth, mixing, second_order
from sphtrunc.theory.walls.moments import wall_lattice_moments

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


def predict_beside_wall(
    kernel: Kernel,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    wall: Wall,
    *,
    sigma: float = 0.0,
    distribution: str = "gaussian",
    degree: int = 3,
    axis: int = 0,
) -> Prediction:
    """Mean and standard deviation of the moments beside a wall, as `predict` gives them without.

    Raises ValueError for displaced particles on the wall, or in the nested form.
    """
    offset, phase = wall.placed(kind, dx_over_h, offset)
    values = wall_lattice_moments(
        kernel, operator, kind, dx_over_h, offset, degree, wall, axis=axis, exact=False
    )
    mean = {alpha: float(m) for alpha, m in values.items()}
    if sigma == 0:
        still = dict.fromkeys(mean, 0.0)
        return Prediction(sigma, distribution, mean, still, "lattice sum on one side of a wall")
    if operator.form == NESTED:
        raise ValueError(
            "jitter: beside a wall there is no theory for the nested form; expected another form"
        )
    if phase.denominator == 1 and wall.share != 1:
        raise ValueError(
            "jitter: a displaced particle is not on the wall; expected wall-weight 1, or wall-at"
            " half-way"
        )
    if wall.ghosts != "none":
        return _with_ghosts(
            Ghosted(kernel, operator, kind, dx_over_h, offset, wall, degree, axis),
            kind,
            mean,
            sigma,
            distribution,
        )
    first = ceil(-phase)
    arguments = (kernel, operator, kind, dx_over_h, offset, "constant", degree, axis)
    slopes, index = propagate(*arguments, first=first)
    mixed = mixing(kind, index, distribution)
    by_source = {a: row if mixed is None else mixed.T @ row for a, row in slopes.items()}
    variance = {a: sigma**2 * float((row * row).sum()) for a, row in by_source.items()}
    how = "first-order propagation through the lattice"
    s = Stencil(kernel, kind, dx_over_h, offset, "constant", first=first).s
    few = mixed is None and index.size <= SECOND_ORDER
    if few and is_smooth(kernel, operator, s, sigma * float(dx_over_h)):
        how = "second-order propagation through the lattice"
        excess = -1.2 if distribution == "uniform" else 0.0
        shape = (index.shape[1], index.shape[0])
        second = second_order(lambda at: propagate(*arguments, at, first)[0], shape, excess)
        variance = {a: max(v + sigma**4 * second[a][1], 0.0) for a, v in variance.items()}
        mean |= {a: m + sigma**2 * second[a][0] for a, m in mean.items()}
    std = {a: v**0.5 for a, v in variance.items()}
    return Prediction(sigma, distribution, mean, std, f"{how} on one side of a wall")


def _with_ghosts(
    seen: Ghosted, kind: str, still: dict[MultiIndex, float], sigma: float, distribution: str
) -> Prediction:
    """Where images and dummies follow the particles."""
    slopes, curves = seen.derivatives()
    mixed = mixing(kind, seen.index, distribution)
    mean, std = {}, {}
    for alpha, value in still.items():
        row = slopes[alpha] if mixed is None else mixed.T @ slopes[alpha]
        std[alpha] = sigma * float((row * row).sum()) ** 0.5
        mean[alpha] = value + (0.5 * sigma**2 * curves[alpha] if mixed is None else 0.0)
    how = f"propagation through the lattice and its {seen.wall.ghosts} ghosts beside a wall"
    return Prediction(sigma, distribution, mean, std, how)
