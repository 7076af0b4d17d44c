"""The continuous limit Δx/h → 0: integrals of the base sums, and the moments they give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sympy import Rational

from sphtrunc.kernels.factors import radial_moment
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import Moments
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Around, Key, angular, parts

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian


# -- continuous moments -------------------------------------------------------------------------


def _moments(
    operator: Operator,
    sums: Mapping[Key, Any],
    dim: int,
    degree: int,
    provenance: str,
    around: Around | None = None,
) -> Moments:
    values = operator.correct(sums, dim, degree, around=around)
    return Moments(values, operator.target(dim), operator.derivatives, provenance)


def _smoothing_order(kernel: Kernel | Gaussian, operator: Operator, dim: int) -> int:
    """The power of h of the first smoothing error that is not zero, read off exact coefficients."""
    degree = operator.derivatives + 2
    while True:
        sums = {key: continuous_sum(kernel, key) for key in operator.needed(dim, degree)}
        order = _moments(operator, sums, dim, degree, "").order
        if order is not None:
            return order
        degree += 2  # ends: R_{2n} of a kernel of compact support cannot vanish for all n


def continuous_sum(kernel: Kernel | Gaussian, key: Key) -> Any:
    """m[δ, α] with the sum replaced by the integral, (−1)^{|δ|} ∫ s^α ∂^δ Ŵ d^d s, exactly.

    By isotropy ∫ s^β f(|s|) = angular(β) ∫ |s|^{|β|} f. An integral with a 1/q in it belongs to a
    moment that difference forms do not have, M_0; it is given as 0.
    """
    total: Any = Rational(0)
    for c, beta, k in parts(key):
        mean = angular(beta)
        if mean:
            weight = Rational(c * mean.numerator, mean.denominator)
            total += weight * radial_moment(kernel, k, sum(beta), len(beta))
    return total
