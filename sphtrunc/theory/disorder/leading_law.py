"""The leading law of disorder, std(M) = (σ/Δx)(Δx/h)^{1+d/2} ‖∇g‖ for Δx/h → 0, from exact norms of
the test functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.factors import Laurent, laurent
from sphtrunc.kernels.kernel import SPHERE, Kernel
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key, Row, angular, parts

if TYPE_CHECKING:
    from sympy import Expr


def moment_rows(part: Mapping[Key, Any], alpha: MultiIndex) -> list[Row]:
    """The function that a moment samples, M_α = V Σ_b g(s_b), as rows c s^β f(q)."""
    return [
        (c * sign, beta, k)
        for (term, gamma), c in part.items()
        for sign, beta, k in parts((term, tuple(a + g for a, g in zip(alpha, gamma, strict=True))))
    ]


# ----------------------------------------------------------------------------------- leading law


def leading_coefficient(
    kernel: Kernel, operator: Operator, alpha: MultiIndex, axis: int = 0
) -> Expr:
    """‖∇g_α‖₂² exactly; std(M_α) = (σ/Δx) (Δx/h)^{1+d/2} ‖∇g_α‖₂ to leading order in σ and Δx/h.

    For operators without correction and constant volumes. oo where g jumps: its spread then falls
    more slowly with σ than linearly.

    Raises ValueError for a corrected operator.
    """
    if not operator.uncorrected:
        raise ValueError(
            f"correction: the leading law is that of uncorrected weights, got"
            f" {operator.correction}; expected none, or `predict`, which propagates"
        )
    dim = dimension(len(alpha))
    part = operator.coefficients({}, dim)[axis]
    copies = 1 if any(alpha) else operator.copies
    if not copies:
        from sympy import Integer

        return Integer(0)
    return copies**2 * gradient_norm(kernel, tuple(moment_rows(part, alpha)))


@lru_cache(maxsize=512)
def gradient_norm(kernel: Kernel, rows: tuple[Row, ...]) -> Expr:
    """∫ |∇g|² d^d s for g = Σ c s^β f(q), exactly: a rational times a power of π, and logarithms
    only where a Laurent polynomial leaves a 1/q; oo where g jumps."""
    from sympy import oo

    dim = len(rows[0][1])
    if _jumps(kernel, rows):
        return oo
    integrand: list[Laurent] = [{} for _ in kernel.pieces]
    for (c, beta, f), (d, gamma, g) in product(rows, rows):
        total = tuple(a + b for a, b in zip(beta, gamma, strict=True))
        size, other = sum(beta), sum(gamma)
        first = sum(
            (
                a * b * angular(_less(total, i))
                for i, (a, b) in enumerate(zip(beta, gamma, strict=True))
                if a and b
            ),
            Fraction(0),
        )
        rest = angular(total)
        for piece, pf, pg in zip(integrand, laurent(kernel, f), laurent(kernel, g), strict=True):
            for (i, x), (j, y) in product(pf.items(), pg.items()):
                # f = q^i: f′/q = i q^{i−2}
                factor = first + rest * (size * j + other * i + i * j)
                power = i + j + size + other - 2 + dim - 1
                piece[power] = piece.get(power, Fraction(0)) + c * d * x * y * factor
    return _integral(kernel, integrand, dim)


@lru_cache(maxsize=512)
def squared_norm(kernel: Kernel, rows: tuple[Row, ...]) -> Expr:
    """∫ g² d^d s for g = Σ c s^β f(q), exactly: Var = (Δx/h)^d ∫ g² over independent particles."""
    dim = len(rows[0][1])
    integrand: list[Laurent] = [{} for _ in kernel.pieces]
    for (c, beta, f), (d, gamma, g) in product(rows, rows):
        total = tuple(a + b for a, b in zip(beta, gamma, strict=True))
        mean = angular(total)
        for piece, pf, pg in zip(integrand, laurent(kernel, f), laurent(kernel, g), strict=True):
            for (i, x), (j, y) in product(pf.items(), pg.items()):
                power = i + j + sum(total) + dim - 1
                piece[power] = piece.get(power, Fraction(0)) + c * d * x * y * mean
    return _integral(kernel, integrand, dim)


def _integral(kernel: Kernel, integrand: Sequence[Laurent], dim: int) -> Expr:
    """∫ of a Laurent polynomial for each piece (with q^{d−1} in it) over all space; oo where it
    diverges at the origin."""
    from sympy import Rational, log, oo

    value = Rational(0)
    knots = kernel.knots
    for a, b, piece in zip(knots, knots[1:], integrand, strict=False):
        for power, c in piece.items():
            if not c:
                continue
            exact = Rational(c.numerator, c.denominator)
            if power >= 0 or (power < -1 and a):
                value += exact * (b ** (power + 1) - a ** (power + 1)) / (power + 1)
            elif power == -1 and a:
                value += exact * log(b / a)
            else:
                return oo
    return value * SPHERE[dim] * kernel.normalisation(dim) ** 2


def _less(total: MultiIndex, axis: int) -> MultiIndex:
    return tuple(n - 2 * (i == axis) for i, n in enumerate(total))


def _jumps(kernel: Kernel, rows: Sequence[Row]) -> bool:
    """Whether g is discontinuous at a knot (in 1D also at the origin)."""
    from sympy import Rational

    for n, knot in enumerate(kernel.knots):
        at = fraction(knot)
        by_beta: dict[MultiIndex, Fraction] = {}
        for c, beta, k in rows:
            pieces = [{}, *laurent(kernel, k), {}]
            left, right = pieces[n], pieces[n + 1]
            if at:
                step = sum((x * at**i for i, x in right.items()), Fraction(0)) - sum(
                    (x * at**i for i, x in left.items()), Fraction(0)
                )
            elif len(beta) == 1 and sum(beta) % 2:
                step = right.get(-sum(beta), Fraction(0))
            else:
                step = Fraction(0)
            value = Fraction(c) if not isinstance(c, Rational) else fraction(c)
            key = beta if len(beta) > 1 else (0,)
            weight = at ** sum(beta) if len(beta) == 1 and at else 1
            by_beta[key] = by_beta.get(key, Fraction(0)) + value * step * weight
        if any(by_beta.values()):
            return True
    return False
