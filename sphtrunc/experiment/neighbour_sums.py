"""The discrete sums of one block of targets, written once for every arithmetic: floats, floats with
a bound, pairs of floats, 60 digits. Neighbours run along axis 0, targets along axis 1.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.bounded import Ball
from sphtrunc.arithmetic.extended import Pair
from sphtrunc.arithmetic.linear_systems import Health
from sphtrunc.kernels.values import kernel_values
from sphtrunc.operators.corrections import combine
from sphtrunc.operators.moments import MultiIndex, add, multi_indices, unit
from sphtrunc.operators.operator import SYMMETRIC, Operator
from sphtrunc.operators.terms import BROOKSHAW, FATEHI_MANZARI, Key
from sphtrunc.scenes.neighbourhood import Stretches

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel


class Weights:
    """The terms of an operator at the neighbours of T targets, (N, T), in the arithmetic `number`,
    and sums of them.

    s: offsets along each axis, (N, T); volume: V/h^d; stretches: of `Neighbourhood`
    terms: (−1)^{|δ|} V ∂^δ Ŵ, −V Ŵ′/q, −V Ŵ′/q³, whatever the operator needs
    """

    def __init__(
        self,
        number: Any,
        s: list[Any],
        volume: Any,
        kernel: Kernel,
        operator: Operator,
        stretches: Stretches = (None,),
    ) -> None:
        self.number, self.s, self.kernel, self.operator = number, s, kernel, operator
        self._monomials: dict[MultiIndex, Any] = {}
        self.terms: dict[Any, Any] = {}
        dim, q = len(s), number.length(s)
        each = []  # (h_a/h, q h_a/h, V (h_a/h)^d) of the kernels that a pair takes in equal shares
        for stretch in stretches:
            weight = volume
            for _ in range(0 if stretch is None else dim):
                weight = weight * stretch
            each.append((stretch, q if stretch is None else q * stretch, weight))
        needed = list(dict.fromkeys(term for term, _ in operator.needed(dim, 0)))
        orders = {1 if isinstance(term, str) else sum(term) for term in needed}
        values: dict[int, Any] = {}  # V Ŵ^(k)
        for k in sorted(orders | {1} if max(orders) else orders):
            found = []
            for stretch, argument, weight in each:
                one = kernel_values(number, kernel, argument, k, dim) * weight
                for _ in range(0 if stretch is None else k):
                    one = one * stretch
                found.append(one)
            values[k] = found[0] if len(found) == 1 else (found[0] + found[1]) * 0.5
        slope, axes = (-values[1], number.directions(s, q)) if 1 in values else (None, [])
        for term in needed:
            if term in (BROOKSHAW, FATEHI_MANZARI):
                self.terms[term] = number.ratio(slope, q)
                if term == FATEHI_MANZARI:
                    self.terms[term] = number.ratio(number.ratio(self.terms[term], q), q)
            elif sum(term) == 1:
                self.terms[term] = slope * axes[term.index(1)]
            elif sum(term) == 0 or dim == 1:
                self.terms[term] = values[sum(term)]
            else:
                self.terms[term] = self._second(q, slope, values[2], axes, term)

    def _second(self, q: Any, slope: Any, curvature: Any, axes: list[Any], term: MultiIndex) -> Any:
        """V ∂ᵢ∂ⱼŴ = V [Ŵ″ eᵢeⱼ + (Ŵ′/q)(δᵢⱼ − eᵢeⱼ)]; at the target itself δᵢⱼ Ŵ″(0)."""
        i, j = (k for k, n in enumerate(term) for _ in range(n))
        both = axes[i] * axes[j]
        around = self.number.ratio(slope, q)  # −V Ŵ′/q
        at_target = _zero(q)
        result = curvature * both - around * (float(i == j) - both)
        if not np.any(at_target):
            return result
        if i == j and not self.kernel.curved_at_0:
            raise ValueError(
                f"form: the second derivatives of {self.kernel.name} do not exist at the particle"
                f" itself in {len(axes)}D; expected the form difference or brookshaw"
            )
        own = curvature if i == j else 0 * curvature
        return self.number.drop(result, at_target) + self.number.drop(own, ~at_target)

    def monomial(self, alpha: MultiIndex) -> Any:
        """s^α, and the number 1 for α = 0."""
        if not any(alpha):
            return 1
        if alpha not in self._monomials:
            axis = next(i for i, n in enumerate(alpha) if n)
            lower = tuple(n - (i == axis) for i, n in enumerate(alpha))
            s = self.s[axis]
            self._monomials[alpha] = self.monomial(lower) * s if any(lower) else s
        return self._monomials[alpha]

    def total(self, key: Key, factor: Any = None) -> Any:
        """Σ_b s^α (term)_b factor_b."""
        term, alpha = key
        weight = self.terms[term]
        if any(alpha):
            weight = weight * self.monomial(alpha)
        return self.number.total(weight) if factor is None else self.number.dot(weight, factor)

    def coefficients(self, health: Health) -> tuple[list[dict[Key, Any]], dict[Key, Any]]:
        """`Operator.coefficients` at the targets, and the sums that they are made of."""
        dim, operator = len(self.s), self.operator
        sums: dict[Key, Any] = {}
        if not operator.uncorrected:
            sums = {key: self.total(key) for key in operator.needed(dim, 0)}
        solve = partial(self.number.solve, health=health)
        return operator.coefficients(sums, dim, solve), sums


def estimate(
    weights: Weights, degree: int | None, fields: list[Any], health: Health, density: Any = None
) -> tuple[list[Any], dict[MultiIndex, Any]]:
    """Components of the estimate, and moments of the first of them up to `degree`.

    fields: samples, one for a scalar, d for a vector; density: ρ_a/ρ_b for the symmetric form
    """
    found, moments = evaluated(weights, degree, fields, health, density, components=1)
    return found, moments[0] if moments else {}


def evaluated(
    weights: Weights,
    degree: int | None,
    fields: list[Any],
    health: Health,
    density: Any = None,
    components: int | None = None,
) -> tuple[list[Any], list[dict[MultiIndex, Any]]]:
    """Components of the estimate, and moments up to `degree` of each of its weights: all of them,
    or the first `components`; arguments as of `estimate`."""
    number, operator, dim = weights.number, weights.operator, len(weights.s)
    parts, sums = weights.coefficients(health)
    factor = density if operator.form == SYMMETRIC else None
    moments = [
        _moments(weights, part, sums, degree, factor)
        for part in parts[:components]
        if degree is not None
    ]
    for found in moments if operator.uses_difference else ():
        found[unit(dim, 0, 0)] = number.number(
            np.full(_targets(weights.s), float(operator.adds_own))
        )
    estimates = [applied(weights, parts, one, density) for one in fields]
    return _contracted(operator, estimates, fields, dim), moments


def _moments(
    weights: Weights, part: dict[Key, Any], sums: dict[Key, Any], degree: int, density: Any
) -> dict[MultiIndex, Any]:
    """The moments of one component; what is summed for them is kept in `sums`."""
    number, operator, dim = weights.number, weights.operator, len(weights.s)
    moments: dict[MultiIndex, Any] = {}
    for alpha in multi_indices(dim, degree):
        for term, gamma in part:
            key = term, add(alpha, gamma)
            if key not in sums:
                sums[key] = weights.total(key, density)
        moments[alpha] = combine(part, sums, alpha)
    zero = unit(dim, 0, 0)
    if density is None:
        moments[zero] = operator.zeroth(moments[zero])
    else:
        back = number.ratio(number.number(np.ones(1)), density)
        moments[zero] = moments[zero] + sum(weights.total(key, back) for key in part)
    return moments


def applied(
    weights: Weights, parts: list[dict[Key, Any]], one: Any, density: Any = None
) -> list[Any]:
    """The components of the sums over a sampled field, (T,) each."""
    operator = weights.operator
    seen = one.difference
    if operator.form == SYMMETRIC:
        seen = _symmetric(weights.number, one, density)
    elif not operator.uses_difference:
        seen = one.difference + one.own
    keys = dict.fromkeys(key for part in parts for key in part)
    at = {key: weights.total(key, seen) for key in keys}
    return [sum(c * at[key] for key, c in part.items()) for part in parts]


def moments_by_fields(
    weights: Weights, fields: dict[MultiIndex, Any], health: Health
) -> list[dict[MultiIndex, Any]]:
    """The moments of every component as what it gives for s^α, sampled: where particles carry other
    values than those of the field at their place."""
    operator = weights.operator
    parts, _ = weights.coefficients(health)
    found = {alpha: applied(weights, parts, one) for alpha, one in fields.items()}
    moments = [{alpha: row[c] for alpha, row in found.items()} for c in range(len(parts))]
    for one in moments if operator.uses_difference else ():
        one[unit(len(weights.s), 0, 0)] = weights.number.number(
            np.full(_targets(weights.s), float(operator.adds_own))
        )
    return moments


def _targets(s: list[Any]) -> tuple[int, ...]:
    shape = (s[0].middle if isinstance(s[0], Ball) else getattr(s[0], "high", s[0])).shape
    return tuple(shape[1:])


def _zero(q: Any) -> Any:
    """Where q is exactly 0."""
    if isinstance(q, Ball):
        return (q.middle == 0.0) & (q.radius == 0.0)
    return (q.high if isinstance(q, Pair) else q) == 0


def _symmetric(number: Any, one: Any, density: Any) -> Any:
    """A_b ρ_a/ρ_b + A_a ρ_b/ρ_a."""
    if density is None:
        return one.difference + one.own + one.own
    back = number.ratio(number.number(np.ones(1)), density)
    return (one.difference + one.own) * density + one.own * back


def _contracted(
    operator: Operator, found: list[list[Any]], fields: list[Any], dim: int
) -> list[Any]:
    """Components of the operator from estimates [field component][derivative component]."""
    if not fields:
        return []
    if operator.name == "divergence":
        return [sum((found[i][i] for i in range(1, dim)), found[0][0])]
    if operator.name == "curl":
        if dim == 2:
            return [found[1][0] - found[0][1]]
        return [found[(i + 2) % 3][(i + 1) % 3] - found[(i + 1) % 3][(i + 2) % 3] for i in range(3)]
    parts = list(found[0])
    if operator.adds_own:
        return [parts[0] + fields[0].own]
    return parts


def exact_derivatives(operator: Operator, fields: list[Any], dim: int) -> list[Any] | None:
    """What the components of the estimate stand for, from the samples."""
    if any(one.derivatives is None for one in fields):
        return None
    rows = Operator("gradient").components(dim) if operator.derivatives == 1 else []
    rows = rows or operator.components(dim)
    try:
        found = [
            [sum((one.derivatives[mu] for mu in row[1:]), one.derivatives[row[0]]) for row in rows]
            for one in fields
        ]
    except KeyError:
        return None
    return _contracted(Operator(operator.name), found, fields, dim) if found else None
