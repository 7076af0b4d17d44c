"""Remedies: what each of the usual answers to a wall leaves of the error, as rows of one table.

At distance η from the wall an estimate has the leading errors

    Σ_α c_α h^{|α|−k} A^{(α)},        c_α = (M_α − M_α^exact)/α!,

of the lowest |α| where any is left: −1, 0, 1, 2, … is the order in h. The place of the wall in the
lattice adds c′_α (Δx/h)^n to M_α. Every coefficient is read off the moments of this folder, and
every remedy but one is an operator of the package; the one is the normalisation by γ = m₀ with the
terms of the wall that the divergence theorem leaves, where A and its slope are known on it
(Kulasegaram, Bonet, Lewis & Profit 2004, doi:10.1007/s00466-003-0534-0; Ferrand et al. 2013,
doi:10.1002/fld.3666):

    value     (1/γ) Σ A_b W V
    gradient  (1/γ) [−Σ A_b ∇W V − n ∫_wall A Ŵ]
    Laplacian (1/γ) [2 Σ (A_b − A_a)(−W′/r) V − ∫_wall (n·∇A_a + n·∇A) Ŵ]
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import factorial, prod
from typing import TYPE_CHECKING, Any, NamedTuple

from sympy import Expr, Rational

from sphtrunc.kernels.arguments import dimension, rational
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.corrections import combine
from sphtrunc.operators.moments import MultiIndex, multi_indices, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.walls import Wall
from sphtrunc.theory.euler_maclaurin import periodic_bernoulli
from sphtrunc.theory.walls.half_space import cut_sum, plane
from sphtrunc.theory.walls.moments import cut_moments, in_layers, require
from sphtrunc.theory.walls.orders import slope_at, wall_order, wall_response

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian


class Remedy(NamedTuple):
    """forms: operator -> form and correction; ghosts: beyond the wall; says: what it is"""

    says: str
    forms: Mapping[str, tuple[str, str]]
    ghosts: str = "none"


PLAIN = {
    "value": ("standard", "none"),
    "gradient": ("standard", "none"),
    "laplacian": ("brookshaw", "none"),
}
GAMMA = "gamma"
#: by what they cost: nothing, one more sum, a matrix for every particle, particles beyond the wall
REMEDIES: dict[str, Remedy] = {
    "bare": Remedy("the sums as they are", PLAIN),
    "difference": Remedy(
        "A_b − A_a in place of A_b",
        {"value": ("difference", "none"), "gradient": ("difference", "none")},
    ),
    "shepard": Remedy(
        "divided by Σ W V", {"value": ("standard", "shepard"), "gradient": ("standard", "shepard")}
    ),
    GAMMA: Remedy("divided by γ, with the terms of the wall, where A and ∂A/∂n are known", PLAIN),
    "csph": Remedy("gradient renormalised by its own matrix", {"gradient": ("difference", "csph")}),
    "rkpm-1": Remedy(
        "exact for linear fields", dict.fromkeys(("value", "gradient"), ("standard", "rkpm-1"))
    ),
    "fatehi-manzari": Remedy(
        "Laplacian, exact for quadratic fields", {"laplacian": ("fatehi-manzari", "none")}
    ),
    "rkpm-2": Remedy(
        "exact for quadratic fields",
        {
            "value": ("standard", "rkpm-2"),
            "gradient": ("standard", "rkpm-2"),
            "laplacian": ("direct", "rkpm-2"),
        },
    ),
    "mirror": Remedy("images with A (free slip, no flux)", PLAIN, "mirror"),
    "odd": Remedy("images with 2 A_wall − A (no slip, a given value)", PLAIN, "odd"),
    "dummy": Remedy("dummy particles with Shepard means of the fluid", PLAIN, "dummy"),
}


@dataclass(frozen=True)
class Row:
    """One leading error: coefficient · h^order_h · A^(alpha); order and alpha are None where there
    is none, in any degree that is looked at.

    order_dx, order_dx_aligned: power of Δx/h of what the place of the wall adds to this moment, at
        any place, and at particles of which half counts or half-way (None: none, or not derived)
    dx_coefficient: of the latter, half-way, in units of h^order_h A^(alpha)
    """

    eta: Rational
    operator: str
    component: str
    remedy: str
    order_h: int | None
    alpha: MultiIndex | None
    coefficient: Expr
    order_dx: int | None
    order_dx_aligned: int | None
    dx_coefficient: Expr | None

    @property
    def derivative(self) -> str:
        """A, A_n, A_nt, …: n normal to the wall, t along it."""
        return "" if self.alpha is None else named(self.alpha)

    def to_dict(self) -> dict[str, Any]:
        """An entry of schema `sphtrunc.wall/1`; exact numbers are strings."""
        return {
            "eta": str(self.eta),
            "operator": self.operator,
            "component": self.component,
            "remedy": self.remedy,
            "order_h": self.order_h,
            "derivative": self.derivative,
            "coefficient": str(self.coefficient),
            "order_dx": self.order_dx,
            "order_dx_aligned": self.order_dx_aligned,
            "dx_coefficient": None if self.dx_coefficient is None else str(self.dx_coefficient),
        }


def named(alpha: MultiIndex) -> str:
    """The derivative of A: A, A_n, A_tt, …; in 3D the two tangents are t and b."""
    index = "".join(axis * n for axis, n in zip("ntb", alpha, strict=False))
    return f"A_{index}" if index else "A"


def remedies(
    kernel: Kernel | Gaussian | str,
    dim: int = 1,
    etas: Iterable[object] | None = None,
    names: Iterable[str] | None = None,
) -> Iterator[Row]:
    """Every remedy's leading errors of value, gradient and Laplacian, row by row.

    kernel: a Kernel, or any text that `sphtrunc.kernel` takes
    etas: distances from the wall in h, exact numbers; default 0, 1/4, 1/2, 1 and κ
    names: of REMEDIES; default all of them

    Raises ValueError for a bad argument.
    """
    dim = dimension(dim)
    shape = require(parse_kernel(kernel), Operator())
    given = ["0", "1/4", "1/2", "1", shape.support] if etas is None else list(etas)
    distances = list(dict.fromkeys(rational(eta, "eta") for eta in given))
    if not all(eta >= 0 for eta in distances):
        raise ValueError(f"eta: got {min(distances)}, expected distances >= 0")
    chosen = list(REMEDIES) if names is None else list(names)
    for name in chosen:
        if name not in REMEDIES:
            raise ValueError(f"remedy: got {name!r}, expected one of {', '.join(REMEDIES)}")
    for eta in distances:
        for operator in PLAIN:
            parts = [("normal", 0), ("tangential", 1)] if operator == "gradient" else [("all", 0)]
            for component, axis in parts[:dim]:
                for name in chosen:
                    form = REMEDIES[name].forms.get(operator)
                    if form is None or (form[0] == "direct" and shape.smoothness < 1):
                        continue
                    yield from _rows(shape, dim, eta, operator, component, axis, name)


def _rows(
    kernel: Kernel, dim: int, eta: Rational, name: str, component: str, axis: int, remedy: str
) -> Iterator[Row]:
    form, correction = REMEDIES[remedy].forms[name]
    operator = Operator(name, form, correction)
    wall = Wall(Fraction(int(eta.p), int(eta.q)), ghosts=REMEDIES[remedy].ghosts)
    target = operator.target(dim, axis)
    k = operator.derivatives
    exact = operator.consistency if wall.ghosts == "none" and remedy != GAMMA else -1
    for degree in range(max(1, k, exact + 1), k + 5):
        if remedy == GAMMA:
            moments = semi_analytic(kernel, operator, dim, degree, eta, axis)
        else:
            moments = cut_moments(kernel, operator, dim, degree, wall, axis)
        errors = {a: m - target.get(a, 0) for a, m in moments.items()}
        left = [a for a, e in errors.items() if e != 0]
        if left:
            break
    else:
        yield Row(eta, name, component, remedy, None, None, Rational(0), None, None, None)
        return

    @cache
    def responses(n: int) -> dict[MultiIndex, Any] | None:
        if remedy == GAMMA:
            return semi_analytic_response(kernel, operator, dim, degree, eta, n, axis)
        return wall_response(kernel, operator, dim, degree, wall, n, axis)

    order = sum(left[0])
    for alpha in left:
        if sum(alpha) != order or alpha[1:] != tuple(sorted(alpha[1:], reverse=True)):
            continue  # the other tangent has the same
        scale = prod(factorial(n) for n in alpha)
        generic = aligned = effect = None
        if not in_layers(operator, wall.ghosts) and eta < kernel.support:
            generic = wall_order(responses, False, alpha)
            aligned = wall_order(responses, True, alpha)
        if aligned is not None and (found := responses(aligned)) is not None:
            effect = found[alpha] * periodic_bernoulli(aligned, Rational(1, 2)) / scale
        yield Row(
            eta, name, component, remedy, order - k, alpha, errors[alpha] / scale,
            generic, aligned, effect,
        )  # fmt: skip


# ------------------------------------------------------------------------- the exception: by γ


def semi_analytic(
    kernel: Kernel, operator: Operator, dim: int, degree: int, eta: Rational, axis: int = 0
) -> dict[MultiIndex, Any]:
    """The moments of the estimate that is normalised by γ, for Δx/h → 0."""
    sums = {key: cut_sum(kernel, key, eta) for key in operator.needed(dim, degree)}
    moments = operator.correct(sums, dim, degree, axis)
    return by_gamma(kernel, operator, moments, eta, axis)


def by_gamma(
    kernel: Kernel,
    operator: Operator,
    moments: Mapping[MultiIndex, Any],
    eta: Rational,
    axis: int = 0,
) -> dict[MultiIndex, Any]:
    """The moments of an estimate normalised by γ from those of its sums, derived or measured: the
    terms of the wall and γ are integrals whatever the particles are."""
    dim = len(next(iter(moments)))
    zero, normal = unit(dim, 0, 0), unit(dim, 0)
    gamma = cut_sum(kernel, (zero, zero), eta)
    measured = not all(isinstance(m, Expr) for m in moments.values())

    def number(x: Any) -> Any:
        return float(x) if measured else x

    found = {}

    def on_wall(alpha: MultiIndex) -> Any:
        return plane(kernel, (zero, alpha), -eta)

    for alpha, moment in moments.items():
        term: Any = Rational(0)
        if operator.name == "gradient" and axis == 0:
            term = on_wall(alpha)
        elif operator.name == "laplacian" and alpha[0]:
            lower = tuple(n - m for n, m in zip(alpha, normal, strict=True))
            own = on_wall(zero) if alpha == normal else 0
            term = own + alpha[0] * on_wall(lower)
        found[alpha] = (moment - number(term)) / number(gamma)
    return found


def semi_analytic_response(
    kernel: Kernel, operator: Operator, dim: int, degree: int, eta: Rational, n: int, axis: int = 0
) -> dict[MultiIndex, Any] | None:
    """As `wall_response`: γ and the terms of the wall are integrals, whatever the particles."""
    zero = unit(dim, 0, 0)
    gamma = cut_sum(kernel, (zero, zero), eta)
    scale = Rational((-1) ** (n - 1), factorial(n))
    sums: dict[Key, Any] = {
        key: scale * slope_at(kernel, key, -eta, n - 1) for key in operator.needed(dim, degree)
    }
    if not all(slope.is_finite for slope in sums.values()):
        return None
    part = operator.coefficients(sums, dim)[axis]
    found = {alpha: combine(part, sums, alpha) / gamma for alpha in multi_indices(dim, degree)}
    return {**found, zero: Rational(0)} if operator.uses_difference else found
