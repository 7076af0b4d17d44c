"""Variable smoothing length: the moments of sums whose particles carry an h of their own.

With h(x) = h_a H(s), s = (x − x_a)/h_a, H(0) = 1, a scatter sum uses Ŵ(s/H(s)) H^{−d−k}. In the
continuous limit, with m[δ, α] the base sums of constant h and k derivatives in their term,

    m_scatter[δ, α] = Σ_β [s^β] H(s)^{|α|+|β|−k} · m[δ, α + β],

[s^β] the coefficient of s^β: the Lagrange inversion of t = s/H(s), whose terms are of order
(h/L)^{|β|} where h varies over a length L. For linear h, H = 1 + g·s, the map is projective, the
series converges for |g|κ < 1, and in 1D it is Σ_j C(k′+j, j) g^j μ_{k′+j} for a value and
Σ_j C(k′+j−1, j) g^j (k′+j) μ_{k′+j−1} for a gradient. Of the other rules "gather" is H = 1,
"mean" is (1 + H)/2 in place of H, and "mean-kernel" the mean of gather and scatter: the sums are
linear in the kernel, so that every correction is the algebra that it always is.

Forms that use h_b or means of it: Hernquist & Katz (1989) doi:10.1086/191344; terms of ∂W/∂h:
Nelson & Papaloizou (1994) doi:10.1093/mnras/270.1.1, Springel & Hernquist (2002)
doi:10.1046/j.1365-8711.2002.05445.x.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import product
from math import comb, perm, prod
from typing import TYPE_CHECKING, Any

from sympy import QQ, Expr, Float, Rational

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import rational
from sphtrunc.kernels.factors import laurent, radial_moment
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.h_rules import require_rule, require_support, slope_share
from sphtrunc.operators.moments import Moments, MultiIndex, add, multi_indices, unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import BROOKSHAW, FATEHI_MANZARI, Key, parts
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.theory.derivation import Derivation, Varying
from sphtrunc.theory.lattice_sums import DIGITS, _at_origin, radial_values, real_context, rounded
from sphtrunc.theory.limit import continuous_sum

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian

Profile = Mapping[MultiIndex, Fraction]  # the Taylor coefficients of H; H(0) = 1

_DIGITS = 34  # to which a series is summed
_MOST = 20_000  # coefficients of a series


def linear(gradient: Sequence[Fraction]) -> Profile:
    """H = 1 + g·s."""
    dim = len(gradient)
    return {unit(dim, i): g for i, g in enumerate(gradient) if g}


def powers(profile: Profile, exponent: Fraction, dim: int, degree: int) -> dict[MultiIndex, Any]:
    """The coefficients of H^x up to a degree: u = H^x has H (s·∇u) = x u (s·∇H)."""
    result: dict[MultiIndex, Any] = {unit(dim, 0, 0): Fraction(1)}
    for beta in multi_indices(dim, degree):
        n = sum(beta)
        total: Any = Fraction(0)
        for tau, h in profile.items():
            rest = tuple(b - t for b, t in zip(beta, tau, strict=True))
            if min(rest) >= 0 and rest in result:
                total += ((exponent + 1) * sum(tau) - n) * h * result[rest]
        if n:
            result[beta] = total / n
    return result


def derivatives_of(term: Any) -> int:
    """k of the term: a kernel of length h scales it as h^{−d−k}."""
    return {BROOKSHAW: 2, FATEHI_MANZARI: 4}.get(term) or sum(term)


def _profile(profile: Profile, rule: str) -> Profile:
    """The H that a rule sees."""
    share = slope_share(rule)
    return {tau: share * c for tau, c in profile.items()}


def orders(
    kernel: Kernel | Gaussian, key: Key, profile: Profile, rule: str, degree: int
) -> list[Any]:
    """m[δ, α] under a rule, order by order in the variation of h: the part of degree |β| = 0, 1, …
    for any H with these Taylor coefficients."""
    term, alpha = key
    dim = len(alpha)
    own = _fraction(kernel, key)
    if rule == "gather" or not profile:
        return [own, *[Fraction(0)] * degree]
    seen = _profile(profile, rule)
    found: list[Any] = []
    for n in range(degree + 1):
        exponent = Fraction(sum(alpha) + n - derivatives_of(term))
        total: Any = Fraction(0)
        for beta, c in powers(seen, exponent, dim, n).items():
            if sum(beta) == n and c:
                total += c * _fraction(kernel, (term, add(alpha, beta)))
        found.append(total)
    if rule == "mean-kernel":
        found = [x / 2 for x in found]
        found[0] = own
    return found


@lru_cache(maxsize=65536)
def _fraction(kernel: Kernel | Gaussian, key: Key) -> Any:
    value = continuous_sum(kernel, key)
    return fraction(value) if isinstance(value, Rational) else value


def series(
    kernel: Kernel | Gaussian, operator: Operator, dim: int, rule: str, degree: int, order: int
) -> dict[MultiIndex, list[Rational]]:
    """The moments as power series in g, h = h_a (1 + g s₁): multi-index -> coefficients of
    g⁰ … g^order, exactly, of every operator and correction; [1, 0, 3/3] says M = 1 + 3μ₂g²."""
    require_rule(rule)
    if operator.form == NESTED:
        raise ValueError("form: nested sums see every particle's own h; expected another form")
    ring = QQ.frac_field("g")
    g = ring.gens[0]
    step = linear([Fraction(1)] + [Fraction(0)] * (dim - 1))
    sums = {}
    for key in operator.needed(dim, degree):
        rows = orders(kernel, key, step, rule, order)
        sums[key] = sum(
            (ring(QQ(c.numerator, c.denominator)) * g**n for n, c in enumerate(rows)), ring(0)
        )
    moments = operator.correct(sums, dim, degree)
    return {alpha: _taylor(ring(value), order) for alpha, value in moments.items()}


def _taylor(value: Any, order: int) -> list[Rational]:
    """Taylor coefficients of a rational function of one symbol whose denominator is not 0 at 0."""
    top = dict(value.numer.terms())
    bottom = dict(value.denom.terms())
    first = bottom[(0,)]
    out: list[Any] = []
    for n in range(order + 1):
        c = top.get((n,), QQ(0))
        c -= sum((bottom.get((n - m,), QQ(0)) * out[m] for m in range(n)), QQ(0))
        out.append(c / first)
    return [QQ.to_sympy(c) for c in out]


def limit_moments(
    kernel: Kernel | Gaussian,
    operator: Operator,
    gradient: Sequence[Fraction],
    rule: str,
    degree: int,
) -> Moments:
    """The moments in the continuous limit with h = h_a (1 + g·s): exact where the series ends, else
    to 30 digits.

    Raises ValueError unless |g|κ < 1: beyond that, a neighbour's support has no end.
    """
    dim = len(gradient)
    require_rule(rule)
    if operator.form == NESTED:
        raise ValueError("form: nested sums see every particle's own h; expected another form")
    require_support(_support(kernel), gradient, rule)
    found: list[dict[MultiIndex, Any]] = []
    for more in (0, 2):  # what does not depend on where the series are cut is exact
        sums = {
            key: _summed(kernel, key, gradient, rule, more) for key in operator.needed(dim, degree)
        }
        found.append(operator.correct(sums, dim, degree))
    values = {alpha: _number(first, first == found[1][alpha]) for alpha, first in found[0].items()}
    return Moments(values, operator.target(dim), operator.derivatives, "continuous limit")


def summed(kernel: Kernel, key: Key, gradient: Sequence[Fraction], rule: str) -> Fraction:
    """One base sum for linear h as a number to compute with: exact for constant h, and what the
    gradient adds to it to the digits of a float. The series is that of `_summed`."""
    own = Fraction(_fraction(kernel, key))
    if rule == "gather" or not any(gradient):
        return own
    share = slope_share(rule)
    slopes = tuple(share * g for g in gradient)
    reach = sum(float(g) ** 2 for g in slopes) ** 0.5 * float(kernel.support)
    p = sum(key[1]) + 1 - derivatives_of(key[0])
    size = float(_absolute(kernel, key))
    more, binomial, n = 0.0, 1.0, 0
    while p > 0 or n < -p:
        n += 1
        binomial *= (p + n - 1) / n
        more += binomial * float(_along(kernel, key, slopes, n))
        left = (
            abs(binomial) * reach**n * size / (1.0 - min(reach * max((p + n) / (n + 1), 1.0), 0.99))
        )
        if left < 1e-17 * max(abs(more), 1e-17 * size) or n > _MOST:
            break
    return own + Fraction(more) / (2 if rule == "mean-kernel" else 1)


def _support(kernel: Kernel | Gaussian) -> Fraction | None:
    return fraction(kernel.support) if isinstance(kernel, Kernel) else None


def _summed(
    kernel: Kernel | Gaussian, key: Key, gradient: Sequence[Fraction], rule: str, more: int
) -> Any:
    """The series of one base sum for linear h, cut where the rest is below 10^−_DIGITS.

    Term n is at most |C(x, n)| (|g|κ)^n ∫|t|^{|α|}|f|, x = |α| + n − k; |C(x, n)| = C(p+n−1, n),
    p = k... grows by (p + n)/(n + 1) at most, p = |α| + 1 − k.
    """
    own = _fraction(kernel, key)
    if rule == "gather" or not any(gradient):
        return _rational(own)
    assert isinstance(kernel, Kernel)
    term, alpha = key
    k = derivatives_of(term)
    share = slope_share(rule)
    slopes = tuple(share * g for g in gradient)
    # |g|κ, rounded up to a rational
    reach = Fraction(float(sum(g * g for g in slopes)) ** 0.5 * float(kernel.support))
    reach *= 1 + Fraction(1, 2**40)
    p = sum(alpha) + 1 - k
    size = _absolute(kernel, key)
    total, n, known, binomial = own, 0, Fraction(1), Fraction(1)
    limit = Fraction(1, 10**_DIGITS)
    while True:
        ratio = reach * max(Fraction(p + n, n + 1), Fraction(1)) if p > 0 else None
        if p <= 0 and n >= -p:  # C(x, n) = 0 from here on: the series has ended
            break
        if ratio is not None and ratio < 1 and known * size * ratio < limit * (1 - ratio):
            if more == 0:
                break
            more -= 1
        n += 1
        # (1 + g·s)^x at degree n: C(x, n) (g·s)^n with x = p + n − 1
        binomial = binomial * Fraction(p + n - 1, n)
        known = abs(binomial) * reach**n
        total += binomial * _along(kernel, key, slopes, n)
        if n > _MOST:
            raise ValueError("h-gradient: |g|κ is too near to 1 to be summed; expected a smaller g")
    if rule == "mean-kernel":
        total = (total + own) / 2
    return _rational(total)


def _along(kernel: Kernel, key: Key, slopes: tuple[Fraction, ...], n: int) -> Fraction:
    """∫ (term) (g·t)^n d^d t, the term with its t^α: Σ c ∫ t^β f(|t|) (g·t)^n."""
    total = Fraction(0)
    for c, beta, factor in parts(key):
        mean = mean_along(beta, slopes, n)
        if mean:
            radial = radial_moment(kernel, factor, sum(beta) + n, len(beta))
            total += c * mean * fraction(radial)
    return total


@lru_cache(maxsize=1 << 15)
def mean_along(beta: MultiIndex, slopes: tuple[Fraction, ...], n: int) -> Fraction:
    """The mean of e^β (g·e)^n over directions e: all ways to pair the factors, k of those of e^β
    with a g, over d(d+2)…(d+|β|+n−2)."""
    square = sum((g * g for g in slopes), Fraction(0))
    total = Fraction(0)
    for tau in product(*(range(b + 1) for b in beta)):
        k = sum(tau)
        left = [b - t for b, t in zip(beta, tau, strict=True)]
        if k > n or (n - k) % 2 or any(x % 2 for x in left):
            continue
        ways = Fraction(perm(n, k) * _pairings(n - k))
        for b, t, x, g in zip(beta, tau, left, slopes, strict=True):
            ways *= comb(b, t) * _pairings(x) * g**t
        total += ways * square ** ((n - k) // 2)
    dim = len(beta)
    return total / prod(range(dim, dim + sum(beta) + n, 2))


def _pairings(n: int) -> int:
    """(n − 1)!!, the ways to pair n things."""
    return prod(range(n - 1, 0, -2))


def _absolute(kernel: Kernel, key: Key) -> Fraction:
    """A bound of ∫ |t^α f| d^d t, f the term: Σ |coefficients| of each piece."""
    alpha = key[1]
    dim = len(alpha)
    total = Fraction(0)
    knots = [fraction(k) for k in kernel.knots]
    for c, beta, factor in parts(key):
        for a, b, piece in zip(knots, knots[1:], laurent(kernel, factor), strict=False):
            for j, x in piece.items():
                power = j + sum(beta) + dim
                if power > 0:
                    total += abs(c * x) * (b**power - a**power) / power
    mass = kernel.moment(0, dim) / kernel._mass(dim)
    return total * fraction(mass)


def _rational(value: Any) -> Any:
    return Rational(value.numerator, value.denominator) if isinstance(value, Fraction) else value


def _number(value: Any, exact: bool) -> Expr:
    """An exact number, or 30 digits of one."""
    if isinstance(value, int):
        return Rational(value)
    if exact or not isinstance(value, Rational):
        return value
    return Float(value, 30)


# ------------------------------------------------------------------------------------- lattices


def lattice_sums_of(
    kernel: Kernel,
    keys: Sequence[Key],
    scene: Arrangement,
    gradient: Sequence[Fraction],
    rule: str,
) -> dict[Key, Any]:
    """m[δ, α] over a lattice of constant volumes whose particles carry h_b = h_a (1 + g·s_b),
    particle by particle: exact where coordinates and distances are rational (always in 1D), else
    numbers of 50 digits.

    Raises ValueError unless |g|κ < 1.
    """
    require_support(fraction(kernel.support), gradient, rule)
    if rule == "mean-kernel":
        gather, scatter = (
            lattice_sums_of(kernel, keys, scene, gradient, one) for one in ("gather", "scatter")
        )
        return {key: (gather[key] + scatter[key]) / 2 for key in keys}
    dim, reach, dx_over_h = scene.dim, fraction(kernel.support), scene.dx_over_h
    slopes = [slope_share(rule) * g for g in gradient]
    steep = sum(float(g) ** 2 for g in slopes) ** 0.5 * float(reach)
    radius = float(reach / dx_over_h) / (1.0 - steep) * (1.0 + 1e-9)
    around: list[Any] = []  # (s, t = s/H, H) of every particle within its own support
    for s in scene.exact_positions(scene.sites(radius)):
        stretch = 1 + sum((g * x for g, x in zip(slopes, s, strict=True)), Fraction(0))
        if any(s) and stretch > 0 and sum(x * x for x in s) <= (reach * stretch) ** 2:
            around.append((s, [x / stretch for x in s], stretch))
    there = scene.at_particle
    squares = [sum((x * x for x in t), Fraction(0)) for _, t, _ in around]
    factors = {factor for key in keys for _, _, factor in parts(key)}
    found, rational = radial_values(kernel, factors, squares, True, dim)
    ctx = real_context()
    volume = dx_over_h**dim
    sigma = kernel.normalisation(dim)
    scale = sigma if rational else ctx.mpf(str(sigma.evalf(DIGITS + 10)))
    if not rational:
        around = [tuple(_wide(part, ctx) for part in one) for one in around]
    sums = {}
    for key in keys:
        term, alpha = key
        total: Any = Fraction(0) if rational else ctx.zero
        for c, beta, factor in parts((term, unit(dim, 0, 0))):
            for (s, t, stretch), value in zip(around, found[factor], strict=True):
                weight = c / stretch ** (dim + derivatives_of(term)) * value
                for x, y, n, m in zip(s, t, alpha, beta, strict=True):
                    weight *= x**n * y**m if n or m else 1
                total += weight
        size = volume if rational else _wide(volume, ctx)
        total = total * size + _at_origin(kernel, key, there, volume, rational)
        sums[key] = (_rational(total) if rational else total) * scale
    return sums


def _wide(value: Any, ctx: Any) -> Any:
    """Fractions as 50-digit numbers."""
    if isinstance(value, list):
        return [_wide(x, ctx) for x in value]
    return ctx.mpf(value.numerator) / value.denominator


# ---------------------------------------------------------------------------------- derivations


_SHOWN = 4  # powers of g that a derivation shows


def varying(derivation: Derivation, gradient: object, rule: str = "scatter") -> Derivation:
    """The derivation with h = h_a (1 + g·s): `Derivation.varying`, and its discrete moments if it
    has any.

    gradient: g = dh/dx, an exact number (along the first axis) or one for each axis; rule: of
    RULES. Raises ValueError for a bad argument, |g|κ >= 1, volumes that are not constant, and
    displaced particles.
    """
    require_rule(rule)
    slopes = _gradient(gradient, derivation.dim)
    kernel, operator = derivation.kernel, derivation.operator
    dim, degree = derivation.dim, derivation.degree
    limit = limit_moments(kernel, operator, slopes, rule, degree)
    discrete = derivation.discrete
    if derivation.scatter is not None:
        raise ValueError("jitter: got a gradient of h as well; expected one or the other")
    if discrete is not None and slope_share(rule) and any(slopes):
        if derivation.volume != "constant" or not isinstance(kernel, Kernel):
            raise ValueError(
                f"volume: got {derivation.volume}, expected constant with a gradient of h"
            )
        shift = tuple(fraction(x) for x in derivation.shift)
        scene = Arrangement(derivation.lattice, fraction(derivation.dx_over_h), shift)
        needed = operator.needed(dim, degree)
        sums = lattice_sums_of(kernel, needed, scene, slopes, rule)
        values = operator.correct(sums, dim, degree)
        discrete = replace(discrete, values={a: _shown(m) for a, m in values.items()})
    along = not any(slopes[1:])
    found = Varying(
        gradient=tuple(_rational(g) for g in slopes),
        rule=rule,
        limit=limit,
        series=series(kernel, operator, dim, rule, degree, _SHOWN) if along else {},
    )
    return replace(derivation, terms=(), discrete=discrete, varying=found)


def _shown(value: Any) -> Expr:
    """An exact number, or a 50-digit one to 30 digits."""
    if hasattr(value, "context"):
        return rounded(value)
    return Rational(value) if isinstance(value, int) else value


def _gradient(gradient: object, dim: int) -> list[Fraction]:
    given = list(gradient) if isinstance(gradient, (tuple, list)) else [gradient]
    exact = [rational(value, "h-gradient") for value in given]
    if len(exact) == 1:
        exact += [Rational(0)] * (dim - 1)
    if len(exact) != dim:
        raise ValueError(f"h-gradient: got {len(exact)} numbers, expected 1 or {dim}")
    return [fraction(g) for g in exact]
