"""Signals: the fields that theory applies an estimate to, with their values as a form sees them,
their derivatives at the target, and what the estimate tends to for Δx/h → 0.

Offsets s are in units of h, and so are derivatives; K signals of F parts each go together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from math import factorial, prod, sqrt
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sphtrunc.kernels.factors import radial_values
from sphtrunc.kernels.kernel import SPHERE
from sphtrunc.operators.corrections import shifted
from sphtrunc.operators.moments import MultiIndex, add, unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import Key, angular, parts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.kernel import Kernel

    Array = NDArray[np.float64]

_SERIES = 60  # terms of the continuous limit


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

    def laplacian(self, s: Array) -> Array:
        """∇²f, (K, F, …)."""
        value = (self.difference(s).T + self.own.T).T
        return np.asarray((value.T * -(self.kappa**2)).T)

    def derivative(self, mu: MultiIndex) -> Array:
        """∂^μ f at the target, (K, F)."""
        n = sum(mu)
        turn = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[n % 4]
        size = self.kappa**n * np.prod(self.direction**mu)
        return np.asarray(np.multiply.outer(size, np.array(turn)))

    def size(self, order: int) -> Array:
        """What the root of Σ E² is to be divided by, (K,): the mean over phases is a half of it."""
        return sqrt(2.0) * self.kappa**order

    def limit(self, kernel: Kernel, operator: Operator) -> Array:
        """E for Δx/h → 0, (K, C, F): that along the first axis, turned; kernels are isotropic."""
        dim, n = len(self.direction), self.direction
        ahead = Waves(self.kappa, np.eye(dim)[0])
        axis = [unit(dim, 0, m) for m in range(_SERIES)]
        found = _limit(kernel, operator, dim, {mu: ahead.derivative(mu) for mu in axis})
        if operator.derivatives == 1:
            return found[:, :1] * n[:, None]
        if operator.name != "hessian" or dim == 1:
            return found
        rows = [mu for (mu,) in operator.components(dim)]
        along, across = (found[:, rows.index(unit(dim, i, 2))] for i in (0, 1))
        turned = [np.prod(n**mu) * (along - across) + (max(mu) == 2) * across for mu in rows]
        return np.stack(turned, axis=1)


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
                    result += c * np.prod(s**alpha, axis=-1)
        return total

    def gradient(self, s: Array) -> Array:
        """∇f, (K, F, …, d)."""
        total = np.zeros((len(self.coefficients), 1, *s.shape))
        for one, result in zip(self.coefficients, total[:, 0], strict=True):
            for alpha, c in one.items():
                for i, n in enumerate(alpha):
                    if n:
                        lower = tuple(m - (j == i) for j, m in enumerate(alpha))
                        result[..., i] += c * n * np.prod(s**lower, axis=-1)
        return total

    def laplacian(self, s: Array) -> Array:
        """∇²f, (K, F, …)."""
        total = np.zeros((len(self.coefficients), 1, *s.shape[:-1]))
        for one, result in zip(self.coefficients, total[:, 0], strict=True):
            for alpha, c in one.items():
                for i, n in enumerate(alpha):
                    if n > 1:
                        lower = tuple(m - 2 * (j == i) for j, m in enumerate(alpha))
                        result += c * n * (n - 1) * np.prod(s**lower, axis=-1)
        return total

    def derivative(self, mu: MultiIndex) -> Array:
        """∂^μ f at the target, (K, F)."""
        factor = float(prod(factorial(n) for n in mu))
        return np.array([[one.get(mu, 0.0) * factor] for one in self.coefficients])

    def size(self, order: int) -> Array:
        """What the root of Σ E² is to be divided by, (K,)."""
        return np.full(len(self.coefficients), self.scale)

    def limit(self, kernel: Kernel, operator: Operator) -> Array:
        """E for Δx/h → 0, (K, C, F)."""
        alphas = dict.fromkeys(alpha for one in self.coefficients for alpha in one)
        dim = len(next(iter(alphas)))
        return _limit(kernel, operator, dim, {alpha: self.derivative(alpha) for alpha in alphas})


Signals: TypeAlias = Waves | Taylor


def _limit(
    kernel: Kernel, operator: Operator, dim: int, derivatives: Mapping[MultiIndex, Array]
) -> Array:
    """E for Δx/h → 0, (K, C, F), from the derivatives (K, F) of the signal at the target."""
    moment = _integral(kernel, dim)
    zero = unit(dim, 0, 0)
    means = {key: moment(key) for key in operator.needed(dim, 0)}
    alphas = list(derivatives)
    if operator.form == NESTED:
        alphas = [mu for alpha in derivatives for mu in product(*(range(n + 1) for n in alpha))]
    rows = []
    for part in operator.coefficients(means, dim):
        row = {}
        for alpha in alphas:
            row[alpha] = sum(
                float(c) * moment((term, add(alpha, gamma))) for (term, gamma), c in part.items()
            )
            if alpha == zero and operator.uses_difference:
                row[alpha] = 0.0
            elif alpha == zero and operator.form == "symmetric":
                row[alpha] *= 2.0
        rows.append(row)
    if operator.form == NESTED:
        rows = [
            {mu: sum(shifted(rows[i], rows[j], mu) for i, j in row) for mu in derivatives}
            for row in operator.axes(dim)
        ]
    return np.stack(
        [
            sum(x / prod(factorial(n) for n in mu) * row[mu] for mu, x in derivatives.items())
            for row in rows
        ],
        axis=1,
    )


@cache
def _integral(kernel: Kernel, dim: int) -> Any:
    """key -> its continuous base sum ∫ g_key d^d s, by Gauss quadrature of the radial part."""
    t, w = np.polynomial.legendre.leggauss(64)
    knots = [float(x) for x in kernel.knots]
    pairs = list(pairwise(knots))
    q = np.concatenate([a + (b - a) / 2 * (1 + t) for a, b in pairs])
    weight = np.concatenate([(b - a) / 2 * w for a, b in pairs])
    sphere = float(SPHERE[dim])

    @cache
    def radial(name: str) -> Array:
        return np.asarray(radial_values(kernel, name, q, dim) * weight * sphere)

    @cache
    def moment(key: Key) -> float:
        total = 0.0
        for c, beta, name in parts(key):
            angle = float(angular(beta))
            if angle:
                total += c * angle * float((radial(name) * q ** (sum(beta) + dim - 1)).sum())
        return total

    return moment
