"""Boundary layers: how far from a wall or a free surface the error is another than inside, and what
that makes of a domain.

Planes of particles at (m + ½) steps from the wall have the errors e_m, whatever is inside has e.
The layer is where e_m differs from e by more than a tenth; between two walls a length L apart the
mean square is e² + 2 Σ_m w (e_m² − e²)/L, w the distance of the planes, and what the layer adds is
its share of that.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from math import sqrt
from typing import Any

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import Moments
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.sites import units
from sphtrunc.scenes.walls import Wall
from sphtrunc.study.tuning import Problem, Setting
from sphtrunc.theory.field_error import Split, predict_waves
from sphtrunc.theory.limit import _smoothing_order
from sphtrunc.theory.walls.moments import cut_moments

DIFFERS = 0.1  # relative, from which on an error is that of the layer


@dataclass(frozen=True)
class BoundaryLayer:
    """The error near a wall, half-way between planes of particles and nothing beyond it.

    eta: distances of the planes in h, the nearest first; errors: there; inside: far away
    reach: the largest distance in h at which the error is another, 0 where there is none
    domain: L in λ; particles, error: the shares of the layer in the particles and in the mean
        square error between two walls L apart (negative where the layer has less); rms: of all
    order, order_inside: powers of h of the smoothing error on the wall and inside
    """

    eta: tuple[float, ...]
    errors: tuple[Split, ...]
    inside: Split
    reach: float
    domain: float
    particles: float
    error: float
    rms: float
    order: int
    order_inside: int

    def to_dict(self) -> dict[str, Any]:
        """All figures; errors with their parts beside their distances."""
        rows = [{"eta": eta, **asdict(one)} for eta, one in zip(self.eta, self.errors, strict=True)]
        return {**asdict(self), "errors": rows}


def boundary_layer(
    problem: Problem, kernel: Kernel, chosen: Setting, domain: float
) -> BoundaryLayer:
    """The boundary layer of a setting in a domain of L/λ = `domain` between two walls.

    Raises ValueError for walls that are less than two layers apart, and where there is no theory:
    other disorder than displaced lattices, and the nested form.
    """
    if problem.disorder is not None:
        raise ValueError(
            "wall: particles in disorder beside a wall are predicted from a displaced lattice;"
            " expected --jitter"
        )
    plain = problem.scene(chosen.dx_over_h)
    step = units(plain.kind)[0] * plain.dx_over_h
    x, widest = chosen.h_over_lambda, float(kernel.support) * chosen.h_over_lambda
    if not domain > 2.0 * widest:
        raise ValueError(
            f"box: got {domain:g} λ between two walls, expected more than two supports,"
            f" {2.0 * widest:.3g} λ"
        )
    eta: list[float] = []
    errors: list[Split] = []
    while (len(eta) + Fraction(1, 2)) * step < kernel.support:
        at = (len(eta) + Fraction(1, 2)) * step
        scene = plain.beside(Wall(at.limit_denominator(10**9)))
        errors += predict_waves(kernel, problem.operator, scene, [x])
        eta.append(float(at))
    inside = chosen.error
    differs = [abs(one.total / inside.total - 1.0) > DIFFERS for one in errors]
    reach = max((d for d, is_other in zip(eta, differs, strict=True) if is_other), default=0.0)
    width = 2.0 * float(step) * x / domain  # of a plane beside each wall, of the domain
    excess = width * sum(one.total**2 - inside.total**2 for one in errors)
    square = inside.total**2 + excess
    order_inside = _smoothing_order(kernel, problem.operator, problem.dim)
    return BoundaryLayer(
        tuple(eta),
        tuple(errors),
        inside,
        reach,
        domain,
        width * sum(d <= reach for d in eta),
        excess / square,
        sqrt(square),
        _order_on_wall(kernel, problem.operator, problem.dim, order_inside),
        order_inside,
    )


def _order_on_wall(kernel: Kernel, operator: Operator, dim: int, inside: int) -> int:
    """The power of h of the smoothing error of a target on the wall, at most that of one inside."""
    moments = cut_moments(kernel, operator, dim, inside + operator.derivatives, Wall(Fraction(0)))
    order = Moments(moments, operator.target(dim), operator.derivatives, "continuous limit").order
    return inside if order is None else order
