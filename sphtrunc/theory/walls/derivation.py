"""A derivation beside a wall: the same result as without, of a support that a plane cuts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from sympy import QQ, Expr, Rational, factor

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import rational
from sphtrunc.operators.moments import Moments, MultiIndex, label, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.walls import PLACES, Wall
from sphtrunc.theory.orders import Orders
from sphtrunc.theory.walls.half_space import ETA, beyond_pieces, cut_pieces, cut_sum
from sphtrunc.theory.walls.moments import (
    HalfSpace,
    cut_lattice_sums,
    cut_moments,
    in_layers,
    moments_of,
    require,
    wall_lattice_moments,
    wall_terms,
)
from sphtrunc.theory.walls.orders import wall_order, wall_response

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.theory.derivation import Derivation

BEYOND = {
    "none": "nothing",
    "mirror": "images with the value of their original, A(s*)",
    "odd": "images with the value 2 A_wall − A(s*)",
    "dummy": "dummy particles with the Shepard mean of the fluid around them",
}


@dataclass(frozen=True)
class WallView:
    """What a derivation beside a wall has besides: see `sphtrunc.theory.walls.moments`.

    wall: where it is, None where η is left open
    at: where it lies in the lattice, in words, None without a lattice
    kernel_moments: k -> ∫_{−η} s₁^k Ŵ, an exact number or a function of `marginal.ETA`, in pieces
    pieces: (from, to, moments) for every interval of an open η: the moments as functions of it
    """

    wall: Wall | None
    at: str | None
    ghosts: str
    kernel_moments: Mapping[int, Any]
    pieces: tuple[tuple[Rational, Rational, Mapping[MultiIndex, Expr]], ...] = ()

    def to_dict(self, limit: Moments) -> dict[str, Any]:
        """The entries of schema `sphtrunc.derive/1` that a wall changes or adds."""
        eta = "eta" if self.wall is None else str(self.wall.eta)
        where: dict[str, Any] = {"eta": eta, "at": self.at, "ghosts": self.ghosts}
        if self.wall is not None:
            where["weight"] = str(self.wall.share)
            limits: Any = limit.to_dict()
        else:
            limits = {
                label(alpha): [
                    {"from": str(a), "to": str(b), "value": str(values[alpha])}
                    for a, b, values in self.pieces
                ]
                for alpha in limit.values
            }
        return {
            "wall": where,
            "kernel_moments": {str(k): _shown(m) for k, m in self.kernel_moments.items()},
            "limit_moments": limits,
        }


def beside(
    interior: Derivation,
    wall: object,
    *,
    at: object = None,
    ghosts: str = "none",
    weight: object = None,
    dx_over_h: Expr | None = None,
    shift: tuple[Rational, ...],
    lattice: str,
) -> Derivation:
    """The derivation without a wall, with one at distance η from the target.

    wall: η, or "eta" to leave it open
    at: where the wall is in the lattice: "particle", "half-way", or the steps of its planes from
        the wall to the first one; None: where the offset puts it
    ghosts: "none", "mirror", "odd" or "dummy"
    weight: what part of a particle on the wall counts (default 1/2, completed by its image)

    Raises ValueError for a bad argument.
    """
    require(interior.kernel, interior.operator)
    if wall == "eta":
        if dx_over_h is not None or at is not None or weight is not None:
            raise ValueError(
                "wall: with an open distance there is no lattice; expected --wall P/Q with"
                " --dx-over-h, --wall-at and --wall-weight"
            )
        return _open(interior, Wall(fraction(Rational(0)), ghosts=ghosts))
    if weight is not None and ghosts != "none":
        raise ValueError(
            f"wall-weight: with {ghosts} ghosts a particle on the wall counts once; expected none"
        )
    share = rational("1/2" if weight is None else weight, "wall-weight")
    eta = rational(wall, "wall")
    place = None
    if at is not None:
        place = fraction(rational(PLACES.get(str(at), at), "wall-at"))
    if dx_over_h is None and (at is not None or weight is not None):
        raise ValueError("wall-at, wall-weight: these need a lattice, expected dx-over-h as well")
    return _placed(
        interior, Wall(fraction(eta), place, ghosts, fraction(share)), dx_over_h, shift, lattice
    )


def _placed(
    interior: Derivation,
    wall: Wall,
    ratio: Expr | None,
    shift: tuple[Rational, ...],
    lattice: str,
) -> Derivation:
    operator, dim, degree = interior.operator, interior.dim, interior.degree
    kernel = require(interior.kernel, operator)
    eta = Rational(wall.eta.numerator, wall.eta.denominator)
    needed = operator.needed(dim, degree)
    linear = dim == 1 and not in_layers(operator, wall.ghosts) and wall.ghosts == "none"
    terms = tuple(wall_terms(kernel, needed, eta)) if linear else ()
    discrete, where, offset = None, None, tuple(fraction(x) for x in shift)
    if ratio is not None:
        if not ratio.is_Rational:
            raise ValueError(f"dx-over-h: got {ratio}, expected a rational ratio beside a wall")
        scene = Arrangement(lattice, fraction(ratio), offset).beside(wall)
        offset, where = scene.offset, _place(scene.wall_phase % 1)
        if linear:
            theta = Rational(offset[0].numerator, offset[0].denominator)
            share = Rational(wall.share.numerator, wall.share.denominator)
            sums = cut_lattice_sums(kernel, needed, eta, ratio, theta, share)
            values = operator.correct(sums, dim, degree)
        else:
            values = wall_lattice_moments(kernel, operator, scene, degree)
        if not any(values.values()):
            raise ValueError(
                f"dx-over-h: got {ratio}, and no particle is inside the support of"
                f" {kernel.support}h; expected a smaller ratio (did you mean h/Δx?)"
            )
        discrete = _as_moments(values, operator, dim, "derived")
    limit = _as_moments(cut_moments(kernel, operator, dim, degree, wall), operator, dim)
    return replace(
        interior,
        limit=limit,
        terms=terms,
        dx_over_h=ratio,
        offset=Rational(offset[0].numerator, offset[0].denominator),
        shift=tuple(Rational(x.numerator, x.denominator) for x in offset),
        lattice=lattice,
        discrete=discrete,
        find_orders=lambda: _orders(kernel, operator, dim, degree, wall, limit),
        wall=WallView(
            wall,
            where,
            wall.ghosts,
            {k: cut_sum(kernel, _power(dim, k), eta) for k in range(degree + 1)},
        ),
    )


def _orders(
    kernel: Kernel, operator: Operator, dim: int, degree: int, wall: Wall, limit: Moments
) -> Orders:
    """Of the limit, and of what the place of the wall in the lattice does."""
    order = limit.order
    if order is None:
        order = degree + 1 - operator.derivatives
    if in_layers(operator, wall.ghosts):
        return Orders(order, None, None)
    responses = cache(lambda n: wall_response(kernel, operator, dim, degree, wall, n))
    return Orders(order, wall_order(responses, False), wall_order(responses, True))


def _open(interior: Derivation, wall: Wall) -> Derivation:
    operator, dim, degree = interior.operator, interior.dim, interior.degree
    kernel = require(interior.kernel, operator)
    if in_layers(operator, wall.ghosts):
        raise ValueError(
            "wall: the moments of dummies and of the nested form are integrals of ratios, with no"
            " closed form in η; expected a number"
        )
    pieces = tuple(
        (a, b, open_moments(kernel, operator, dim, degree, wall.ghosts, i))
        for i, (a, b) in enumerate(pairwise(kernel.knots))
    )
    whole = _as_moments(pieces[0][2], operator, dim)
    moments = {k: cut_pieces(kernel, _power(dim, k)) for k in range(degree + 1)}
    return replace(
        interior,
        limit=whole,
        terms=(),
        find_orders=lambda: _orders(kernel, operator, dim, degree, wall, whole),
        wall=WallView(None, None, wall.ghosts, moments, pieces),
    )


def open_moments(
    kernel: Kernel, operator: Operator, dim: int, degree: int, ghosts: str, piece: int
) -> dict[MultiIndex, Expr]:
    """The moments as functions of η on one of the intervals between knots: polynomials, or ratios
    of polynomials behind a correction, in 1D and 3D.

    Raises ValueError for corrections where the base sums have roots and logarithms.
    """
    refusal = (
        f"wall: in {dim}D the sums of this operator have roots and logarithms of η, and its"
        " correction divides by them: there is no short form; expected a number"
    )
    if dim == 2 and not operator.uncorrected:
        raise ValueError(refusal)
    needed = operator.needed(dim, degree)
    sides: list[dict[Key, Any]] = [{key: cut_pieces(kernel, key)[piece][2] for key in needed}]
    if ghosts != "none":
        sides.append({key: beyond_pieces(kernel, key)[piece][2] for key in needed})
    closed = all(e.is_rational_function(ETA) for side in sides for e in side.values())
    if not closed and not operator.uncorrected:
        raise ValueError(refusal)
    at: Any = ETA
    field = QQ.frac_field(ETA)
    if closed:
        at = field.gens[0]
        sides = [{key: field.from_sympy(e) for key, e in side.items()} for side in sides]
    fluid = HalfSpace(lambda _: sides[0], lambda _: sides[-1], lambda *_: [])
    found = moments_of(operator, dim, degree, 0, at, ghosts, fluid)
    if closed:
        found = {alpha: field.to_sympy(field(value)) for alpha, value in found.items()}
    return {
        alpha: (Rational(0) + value).expand() if operator.uncorrected else factor(value)
        for alpha, value in found.items()
    }


def _as_moments(
    values: Mapping[MultiIndex, Any],
    operator: Operator,
    dim: int,
    provenance: str = "continuous limit",
) -> Moments:
    return Moments(values, operator.target(dim), operator.derivatives, provenance)


def _power(dim: int, k: int) -> Key:
    return unit(dim, 0, 0), unit(dim, 0, k)


def _place(phase: Any) -> str:
    names = {value: name for name, value in PLACES.items()}
    return names.get(phase, str(phase))


def _shown(value: Any) -> Any:
    if not isinstance(value, list):
        return str(value)
    return [{"from": str(a), "to": str(b), "value": str(e)} for a, b, e in value]
