"""Orders of the smoothing and discretisation error, read off exact coefficients."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import lcm
from typing import TYPE_CHECKING, Any, NamedTuple

from sympy import QQ, Rational

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex, unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import Key
from sphtrunc.theory.euler_maclaurin import KnotTerm, periodic_bernoulli, phased
from sphtrunc.theory.limit import _smoothing_order, continuous_sum

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian


class Orders(NamedTuple):
    """Orders of an error.

    smoothing: power of h of the leading smoothing error (0: it does not vanish with h)
    generic, aligned: power of Δx/h of the leading discretisation error, at a generic ratio and at
        Δx/h = 2κ/n, n odd (None: there is none, or it was not derived)
    """

    smoothing: int
    generic: int | None
    aligned: int | None


# -- orders ---------------------------------------------------------------------------------------


def _response(
    operator: Operator,
    continuous: Mapping[Key, Any],
    degree: int,
    who: str = "everyone",
) -> dict[MultiIndex, dict[Key, Any]]:
    """∂M_α/∂m[key] at the continuous limit, exactly: by a rational function of one symbol ε.

    who: whose sums: of "everyone", or in the nested form of the "target" or the "neighbours" alone
    """
    keys = list(continuous)
    if operator.uncorrected:
        part = operator.coefficients(continuous, 1)[0]
        moments = operator.correct(continuous, 1, degree)
        fixed = {unit(1, 0, 0)} if operator.uses_difference else set()
        return {
            alpha: {
                (delta, (alpha[0] + gamma[0],)): c
                for (delta, gamma), c in part.items()
                if alpha not in fixed
            }
            for alpha in moments
        }
    field = QQ.frac_field("epsilon")
    epsilon = field.gens[0]
    exact = {key: field(QQ.from_sympy(value)) for key, value in continuous.items()}
    result: dict[MultiIndex, dict[Key, Any]] = {}
    for key in keys:
        moved = {**exact, key: exact[key] + epsilon}
        own = exact if who == "neighbours" else moved
        seen = exact if who == "target" else moved
        moments = operator.correct(own, 1, degree, around=[(own, seen)])
        for alpha, value in moments.items():
            slope = field(value).diff(epsilon)
            if slope.numer.const():
                result.setdefault(alpha, {})[key] = QQ.to_sympy(
                    slope.numer.const() / slope.denom.const()
                )
    return result


def _orders(
    kernel: Kernel | Gaussian,
    operator: Operator,
    dim: int,
    degree: int,
    theta: Rational,
    terms: tuple[KnotTerm, ...],
) -> Orders:
    """Smoothing order, and the discretisation orders at generic and at aligned ratios.

    The latter to first order in the base sums, which decides for every power below twice the first.
    """
    smoothing = _smoothing_order(kernel, operator, dim)
    needed = operator.needed(dim, degree)
    if not terms:
        cut = not isinstance(kernel, Kernel) and kernel.cut is not None and dim == 1
        return Orders(smoothing, 1, 2) if cut else Orders(smoothing, None, None)
    continuous = {key: continuous_sum(kernel, key) for key in needed}
    views = [(theta, "everyone")]
    if operator.form == NESTED and theta != 0:
        views = [(theta, "target"), (Rational(0), "neighbours")]
    responses = [(at, _response(operator, continuous, degree, who)) for at, who in views]
    powers = sorted({t.dx_power for t in terms})
    horizon = powers[-1] + 1 if operator.uncorrected else 2 * powers[0]
    generic = aligned = None
    for n in (p for p in powers if p < horizon):
        rows = [
            (at, phased(row, n, at))
            for at, response in responses
            for row in _linear_terms(response, [t for t in terms if t.dx_power == n])
        ]
        rows = [(at, row) for at, row in rows if row]
        if rows and generic is None:
            generic = n
        if any(_survives_alignment(row, n, at, kernel.support) for at, row in rows):
            aligned = n
            break
    return Orders(smoothing, generic, aligned)


def _linear_terms(
    response: Mapping[MultiIndex, Mapping[Key, Any]], terms: Iterable[KnotTerm]
) -> list[dict[Rational, Any]]:
    """For each moment, knot -> coefficient of B̃_n(p h/Δx − θ) at one power n."""
    by_key: dict[Key, list[KnotTerm]] = {}
    for t in terms:
        by_key.setdefault((t.term, (t.moment,)), []).append(t)
    result = []
    for row in response.values():
        knots: dict[Rational, Any] = {}
        for key, slope in row.items():
            for t in by_key.get(key, ()):
                knots[t.knot] = knots.get(t.knot, 0) + slope * t.coefficient
        result.append(knots)
    return result


def _survives_alignment(
    row: Mapping[Rational, Any], n: int, theta: Rational, support: Rational
) -> bool:
    """Whether the term is non-zero for some odd N at Δx/h = 2κ/N, where p h/Δx = N p/(2κ)."""
    phases = {p: p / (2 * support) for p in row}
    period = lcm(*(int(x.q) for x in phases.values()))
    return any(
        sum(c * periodic_bernoulli(n, number * phases[p] - theta) for p, c in row.items()) != 0
        for number in range(1, 2 * period + 1, 2)
    )
