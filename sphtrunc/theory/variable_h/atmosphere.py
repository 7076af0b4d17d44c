"""An isothermal atmosphere, ρ = e^{−x/L}, P = c²ρ, h ∝ ρ^{−1/d}: the error of six rules, exactly.

Everything is a power series in ε = h/L: the densities and Ω of the neighbours, their h, and the
moments of every rule (`theory.variable_h.moments`). The acceleration c²/L comes out with an error
of order ε², in units of c²/L: a fraction times μ₂ = R₂/d for each rule. Every form converges; which
is best depends on the dimension. Hernquist (1993, doi:10.1086/172587) found the terms of ∂W/∂h to
matter at 10 %: that is a matter of energy, not of the order of the acceleration.

Ω itself, 1 + (h/dρ) ∂ρ/∂h of the summation, is 1 + Σ_n c_n R_{2n} (2n/d) h^{2n} ∇^{2n}ρ/ρ whatever
∇h is, over the same series without its factor 2n/d: Ω − 1 = (R₂/d²) h²∇²ρ/ρ + O(h⁴).
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import factorial
from typing import Any

from sympy import Rational

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.h_rules import FORCE_RULES
from sphtrunc.operators.moments import unit
from sphtrunc.operators.terms import Key
from sphtrunc.theory.variable_h.moments import orders

_RULE_OF = {"a": "gather", "b": "scatter", "mean": "mean"}
_ORDER = 3  # in ε: the acceleration itself is of order 1, its error of order 3

Series = list[Any]  # coefficients of powers of ε


def acceleration_errors(kernel: Kernel, dim: int) -> dict[str, Rational]:
    """rule: error of the acceleration in units of μ₂ (h/L)² c²/L, to leading order, exactly; the
    density is the summation with h_a."""
    mu = fraction(kernel.moment(2, dim)) / dim
    found = {}
    for rule in FORCE_RULES:
        if rule != "constant":
            error = _acceleration(kernel, dim, rule)[_ORDER] / mu
            found[rule] = Rational(error.numerator, error.denominator)
    return found


def _acceleration(kernel: Kernel, dim: int, rule: str) -> Series:
    """a h/c² in powers of ε. With ρ_a = 1: −Q_a ⟨∂ρ⟩ − ⟨∂(ρQ)⟩, Q = 1/(ρ_est Ω) of either end."""
    own, other = FORCE_RULES[rule]
    excess = _density_excess(kernel, dim)
    if rule == "grad-h":
        excess += omega_slope(kernel, dim)
    atmosphere = [Fraction((-1) ** n, factorial(n)) for n in range(_ORDER + 1)]  # of e^{−εs}
    first = _gradient(kernel, dim, own, atmosphere)
    # ρQ = 1 − excess ε² e^{2εs/d}
    second = _gradient(kernel, dim, other, [Fraction(1), *[Fraction(0)] * _ORDER])
    rest = [Fraction(2, dim) ** n / factorial(n) for n in range(_ORDER + 1)]
    third = _gradient(kernel, dim, other, rest)
    return [
        -first[n] - second[n] + excess * ((first[n - 2] + third[n - 2]) if n >= 2 else 0)
        for n in range(_ORDER + 1)
    ]


def _gradient(
    kernel: Kernel, dim: int, sides: tuple[tuple[str, float], ...], field: Series
) -> Series:
    """⟨∂₁f⟩ h of f = Σ field_n (εs₁)ⁿ, in powers of ε."""
    result: Series = [Fraction(0)] * (_ORDER + 1)
    e = unit(dim, 0)
    for side, share in sides:
        for n, f in enumerate(field):
            for j, m in enumerate(_moment(kernel, (e, unit(dim, 0, n)), side)):
                if n + j <= _ORDER:
                    result[n + j] += Fraction(share) * f * m
    return result


@cache
def _moment(kernel: Kernel, key: Key, side: str) -> tuple[Any, ...]:
    """A moment with h = h_a e^{εs₁/d}, in powers of ε."""
    dim = len(key[1])
    profile = {unit(dim, 0, n): Fraction(1, dim**n * factorial(n)) for n in range(1, _ORDER + 1)}
    return tuple(orders(kernel, key, profile, _RULE_OF[side], _ORDER))


def _density_excess(kernel: Kernel, dim: int) -> Any:
    """κ of ρ_est = ρ (1 + κε²), the summation with h_a."""
    return _moment(kernel, (unit(dim, 0, 0), unit(dim, 0, 2)), "a")[0] / 2


def omega_slope(kernel: Kernel, dim: int) -> Any:
    """(Ω − 1) ρ/(h²∇²ρ) to leading order, R₂/d², from Ω = Σ_i m[e_i, e_i]/(dρ)."""
    two = unit(dim, 0, 2)
    total: Any = Fraction(0)
    for i in range(dim):
        alpha = tuple(a + b for a, b in zip(unit(dim, i), two, strict=True))
        total += _moment(kernel, (unit(dim, i), alpha), "a")[0]
    return total / (2 * dim) - _density_excess(kernel, dim)
