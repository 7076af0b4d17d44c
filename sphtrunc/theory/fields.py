"""Fields that theory applies an estimate to: their values as a form sees them, their derivatives at
the target, and the error that is left for Δx/h → 0.

Offsets s are in units of h, and so are derivatives; K signals of F parts each go together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from math import factorial, prod, sqrt
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.operators.corrections import shifted
from sphtrunc.operators.moments import MultiIndex, add, multi_indices, unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import Key, lowered, monomial
from sphtrunc.theory.limit import continuous_sum

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel

_SERIES = 60  # terms of the continuous limit
MOST_TERMS = 400  # derivatives of a wave where another direction counts

Moment: TypeAlias = Callable[[Key], Any]  # base sums for Δx/h → 0, m[δ, α]


@dataclass(frozen=True, eq=False)
class Waves:
    """cos k·s and sin k·s (F = 2), k = κ n: the two parts of a sinusoid of any phase.

    kappa: (K,) wavenumbers in 1/h; direction: n, (d,), of unit length
    """

    kappa: Array
    direction: Array

    @property
    def own(self) -> Array:
        """The values at the target, (K, F)."""
        return np.tile([1.0, 0.0], (len(self.kappa), 1))

    def difference(self, s: Array) -> Array:
        """f(s) − f(0), (K, F, …), at offsets s (…, d)."""
        phase = np.multiply.outer(self.kappa, s @ self.direction)
        return np.stack([-2.0 * np.sin(0.5 * phase) ** 2, np.sin(phase)], axis=1)

    def gradient(self, s: Array) -> Array:
        """∇f, (K, F, …, d)."""
        phase = np.multiply.outer(self.kappa, s @ self.direction)
        slope = np.stack([-np.sin(phase), np.cos(phase)], axis=1)
        return np.multiply.outer((slope.T * self.kappa).T, self.direction)

    def derivative(self, mu: MultiIndex) -> Array:
        """∂^μ f at the target, (K, F)."""
        n = sum(mu)
        turn = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[n % 4]
        size = self.kappa**n * np.prod(self.direction**mu)
        return np.asarray(np.multiply.outer(size, np.array(turn)))

    def size(self, order: int) -> Array:
        """What the root of Σ E² is to be divided by, (K,): the mean over phases is a half of it."""
        return sqrt(2.0) * self.kappa**order

    def limit_error(
        self, kernel: Kernel | Gaussian, operator: Operator, moment: Moment | None = None
    ) -> Array:
        """E for Δx/h → 0 less the exact derivative, (K, C, F): that along the first axis, rotated,
        as kernels are isotropic; where the base sums are others, the series of the wave itself."""
        if moment is not None:
            return self._series(kernel, operator, moment)
        dim, n = len(self.direction), self.direction
        ahead = Waves(self.kappa, np.eye(dim)[0])
        axis = [unit(dim, 0, m) for m in range(_SERIES)]
        found = _limit_error(kernel, operator, dim, {mu: ahead.derivative(mu) for mu in axis})
        if operator.derivatives == 1:
            return found[:, :1] * n[:, None]
        if operator.name != "hessian" or dim == 1:
            return found
        rows = [mu for (mu,) in operator.components(dim)]
        along, across = (found[:, rows.index(unit(dim, i, 2))] for i in (0, 1))
        turned = [np.prod(n**mu) * (along - across) + (max(mu) == 2) * across for mu in rows]
        return np.stack(turned, axis=1)

    def _series(self, kernel: Kernel | Gaussian, operator: Operator, moment: Moment) -> Array:
        """Where there is a direction besides that of the wave: up to the derivatives that no longer
        add a digit.

        Raises ValueError for waves so short that there are too many of them.
        """
        dim, reach = len(self.direction), float(self.kappa.max()) * float(kernel.support)
        degree, term = 2, reach**2 / 2
        while term > 2.0**-50 * max(1.0, reach**2):
            degree += 1
            term *= reach / degree
        along = [i for i, n in enumerate(self.direction) if n]
        alphas = [
            alpha
            for alpha in multi_indices(dim, degree)
            if all(i in along or not n for i, n in enumerate(alpha))
        ]
        if degree > _SERIES or len(alphas) > MOST_TERMS:
            raise ValueError(
                f"h_over_lambda: a wave with kκh = {reach:.3g} beside a wall, or with a gradient of"
                " h, is not predicted; expected a longer one, or one along an axis"
            )
        derivatives = {alpha: self.derivative(alpha) for alpha in alphas}
        return _limit_error(kernel, operator, dim, derivatives, moment)


@dataclass(frozen=True, eq=False)
class Taylor:
    """Polynomials Σ c_α s^α, F = 1: c_α = h^{|α|} A^{(α)}/α! of any field.

    coefficients: of each of the K; scale: what errors are relative to
    """

    coefficients: Sequence[Mapping[MultiIndex, float]]
    scale: float = 1.0

    @property
    def own(self) -> Array:
        """The values at the target, (K, 1)."""
        return np.array(
            [[sum(c for alpha, c in one.items() if not any(alpha))] for one in self.coefficients]
        )

    def difference(self, s: Array) -> Array:
        """f(s) − f(0), (K, F, …), at offsets s (…, d)."""
        total = np.zeros((len(self.coefficients), 1, *s.shape[:-1]))
        for one, result in zip(self.coefficients, total[:, 0], strict=True):
            for alpha, c in one.items():
                if any(alpha):
                    result += c * monomial(s, alpha)
        return total

    def gradient(self, s: Array) -> Array:
        """∇f, (K, F, …, d)."""
        total = np.zeros((len(self.coefficients), 1, *s.shape))
        for one, result in zip(self.coefficients, total[:, 0], strict=True):
            for alpha, c in one.items():
                for i, n in enumerate(alpha):
                    if n:
                        result[..., i] += c * n * monomial(s, lowered(alpha, i))
        return total

    def derivative(self, mu: MultiIndex) -> Array:
        """∂^μ f at the target, (K, F)."""
        factor = float(prod(factorial(n) for n in mu))
        return np.array([[one.get(mu, 0.0) * factor] for one in self.coefficients])

    def size(self, order: int) -> Array:
        """What the root of Σ E² is to be divided by, (K,)."""
        return np.full(len(self.coefficients), self.scale)

    def limit_error(
        self, kernel: Kernel | Gaussian, operator: Operator, moment: Moment | None = None
    ) -> Array:
        """E for Δx/h → 0 less the exact derivative, (K, C, F); moment: base sums, if others."""
        alphas = dict.fromkeys(alpha for one in self.coefficients for alpha in one)
        dim = len(next(iter(alphas)))
        derivatives = {alpha: self.derivative(alpha) for alpha in alphas}
        return _limit_error(kernel, operator, dim, derivatives, moment)


Signals: TypeAlias = Waves | Taylor


def _limit_error(
    kernel: Kernel | Gaussian,
    operator: Operator,
    dim: int,
    derivatives: Mapping[MultiIndex, Array],
    moment: Moment | None = None,
) -> Array:
    """Σ_μ (limit M_μ/μ! − exact) A^{(μ)}, (K, C, F): E for Δx/h → 0 less the exact derivative, from
    the derivatives (K, F) of the signal at the target. The differences are exact, so that a small
    error keeps its digits."""
    alphas = tuple(derivatives)
    if moment is None:
        rows = _limit_errors(kernel, operator, dim, alphas)
    else:
        rows = _errors_of(moment, operator, dim, alphas)
    none = np.zeros_like(next(iter(derivatives.values())))
    return np.stack(
        [sum((x * row[mu] for mu, x in derivatives.items()), none) for row in rows], axis=1
    )


@lru_cache(maxsize=256)
def _limit_errors(
    kernel: Kernel | Gaussian, operator: Operator, dim: int, alphas: tuple[MultiIndex, ...]
) -> list[dict[MultiIndex, float]]:
    """limit M_μ/μ! − exact of every component: exact differences, rounded once, for a polynomial
    kernel."""

    def moment(key: Key) -> Any:
        value = continuous_sum(kernel, key)
        return fraction(value) if kernel.is_polynomial else float(value)

    return _errors_of(moment, operator, dim, alphas)


def _errors_of(
    moment: Moment, operator: Operator, dim: int, alphas: tuple[MultiIndex, ...]
) -> list[dict[MultiIndex, float]]:
    """M_μ/μ! − exact of every component, from the base sums; rounded once."""
    zero, moment = unit(dim, 0, 0), cache(moment)
    means = {key: moment(key) for key in operator.needed(dim, 0)}
    wanted = list(alphas)
    if operator.form == NESTED:
        wanted = [mu for alpha in alphas for mu in product(*(range(n + 1) for n in alpha))]
    rows = []
    for part in operator.coefficients(means, dim):
        row: dict[MultiIndex, Any] = {}
        for alpha in wanted:
            row[alpha] = sum(
                c * moment((term, add(alpha, gamma))) for (term, gamma), c in part.items()
            )
            if alpha == zero:
                row[alpha] *= operator.copies
        rows.append(row)
    if operator.form == NESTED:
        rows = [
            {mu: sum(shifted(rows[i], rows[j], mu) for i, j in row) for mu in alphas}
            for row in operator.axes(dim)
        ]
    result = []
    for row, target in zip(rows, operator.components(dim), strict=True):
        exact = () if operator.adds_own else target
        result.append(
            {mu: float(row[mu] / prod(map(factorial, mu)) - (mu in exact)) for mu in alphas}
        )
    return result
