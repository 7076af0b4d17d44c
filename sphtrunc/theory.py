"""Theory: the exact moments of an estimate, as integrals and as lattice sums.

1D, uniform spacing: for f piecewise polynomial with compact support, on the lattice s_j = (j+θ)Δs,
with B̃_n the periodic Bernoulli polynomials and [f^{(m)}](p) the jumps at all knots p,

    Δs Σ_j f(s_j) = ∫ f ds + Σ_m (−1)^m Δs^{m+1}/(m+1)! Σ_p B̃_{m+1}(p/Δs − θ) [f^{(m)}](p),

exactly: the sum over m ends at the degree of f (Euler–Maclaurin; Ralston 1965, Quinlan, Lastiwka &
Basa 2006, doi:10.1002/nme.1617, for the knots at the edge). A particle on a jump counts with the
mean of both sides, B̃_1(integer) = 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache, partial
from math import lcm, prod
from typing import Any

from sympy import QQ, Expr, Poly, Rational, factorial, factorial2, floor, radsimp

from sphtrunc.bernoulli import fraction, periodic_bernoulli, phased, simple
from sphtrunc.derivation import Derivation, Orders, Term
from sphtrunc.kernel import Kernel, dimension, jumps, q, rational
from sphtrunc.moments import Moments, MultiIndex, unit
from sphtrunc.operators import DERIVATIVES, FORMS, Key, Operator
from sphtrunc.parse import kernel as parse_kernel

MAX_DEGREE = 40  # of the moments that are derived


def derive(
    kernel: Kernel | str,
    operator: Operator | str = "gradient",
    *,
    form: str = "standard",
    correction: str = "none",
    dim: int = 1,
    degree: int = 5,
    dx_over_h: object = None,
    offset: object = 0,
) -> Derivation:
    """The truncation error of an SPH estimate, exactly.

    kernel: a Kernel, or any text that `sphtrunc.kernel` takes
    operator: an Operator, or "value" or "gradient" together with `form` and `correction`
    dim: 1, 2 or 3; the discretisation error is that of uniform particles in 1D
    degree: moments M_α up to |α| = degree
    dx_over_h: Δx/h, an exact number ("10/13", a Fraction, an algebraic SymPy number), or None for
        the error at any ratio
    offset: θ, the particles are at (j + θ)Δx from the target

    >>> derive("cubic-spline", dx_over_h="10/13").discrete[1]
    29200/28561

    Raises ValueError for a bad argument, for particles so far apart that the target has no
    neighbour, and where the matrix of the correction is singular.
    """
    kernel = parse_kernel(kernel)
    if isinstance(operator, str):
        operator = Operator(operator, form, correction)
    if operator.name not in DERIVATIVES or operator.form not in FORMS:
        raise ValueError(
            f"operator: got {operator.name}, form {operator.form}; the theory covers"
            f" {', '.join(DERIVATIVES)} in the forms {', '.join(FORMS)}"
        )
    dim = dimension(dim)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"degree: got {degree!r}, expected a whole number from 0 to {MAX_DEGREE}")
    degree = max(degree, operator.derivatives)
    theta = rational(offset, "offset")
    ratio = None if dx_over_h is None else spacing(dx_over_h)
    if dim > 1 and (ratio is not None or theta != 0):
        raise ValueError(
            f"dx-over-h, offset: got a lattice in {dim}D, expected --dim 1; in 2D and 3D the"
            " continuous moments and the smoothing error are derived"
        )
    needed = operator.needed(dim, degree)
    continuous = {key: continuous_sum(kernel, *key) for key in needed}
    limit = _moments(operator, continuous, dim, degree, "continuous limit")
    terms = _terms(kernel, needed) if dim == 1 else ()
    discrete = None
    if ratio is not None:
        _require_neighbours(kernel, ratio, theta)
        discrete = _moments(
            operator, lattice_sums(continuous, terms, ratio, theta), dim, degree, "derived"
        )
    return Derivation(
        kernel=kernel,
        operator=operator,
        dim=dim,
        degree=degree,
        limit=limit,
        terms=terms,
        dx_over_h=ratio,
        offset=theta,
        discrete=discrete,
        find_orders=partial(_orders, kernel, operator, dim, degree, theta),
    )


def spacing(value: object) -> Expr:
    """Δx/h as an exact positive number: a rational, or a real algebraic SymPy expression."""
    if isinstance(value, Expr) and not isinstance(value, Rational):
        if not (value.is_algebraic and value.is_positive):
            raise ValueError(f"dx_over_h: got {value}, expected a positive algebraic number")
        return radsimp(value)
    ratio = rational(value, "dx-over-h")
    if ratio <= 0:
        raise ValueError(f"dx-over-h: got {ratio}, expected a positive rational")
    return ratio


# -- continuous moments -------------------------------------------------------------------------


def continuous_sum(kernel: Kernel, delta: Any, alpha: MultiIndex) -> Rational:
    """m[δ, α] with the sum replaced by the integral: (−1)^{|δ|} ∫ s^α ∂^δ Ŵ d^d s.

    By isotropy ∫ s^{2a} g(|s|) = ∏(2a_i − 1)!!/[d(d+2)…(d+2n−2)] ∫ |s|^{2n} g, n = Σ a_i.
    """
    dim, n, order = len(alpha), sum(alpha), sum(delta)
    gamma = tuple(a + b for a, b in zip(alpha, delta, strict=True))
    if any(g % 2 for g in gamma):
        return Rational(0)
    angular = prod(factorial2(g - 1) for g in gamma) / prod(
        Rational(dim + 2 * i) for i in range(sum(gamma) // 2)
    )
    if order == 0:
        return angular * kernel.moment(n, dim)
    return -angular * kernel.gradient_moment(n, dim)


def _moments(
    operator: Operator, sums: Mapping[Key, Any], dim: int, degree: int, provenance: str
) -> Moments:
    values = operator.correct(sums, dim, degree)
    return Moments(values, operator.target(dim), operator.derivatives, provenance)


def _smoothing_order(kernel: Kernel, operator: Operator, dim: int) -> int:
    """The power of h of the first smoothing error that is not zero, read off exact coefficients."""
    degree = operator.derivatives + 2
    while True:
        sums = {key: continuous_sum(kernel, *key) for key in operator.needed(dim, degree)}
        order = _moments(operator, sums, dim, degree, "").order
        if order is not None:
            return order
        degree += 2  # ends: R_{2n} of a kernel of compact support cannot vanish for all n


# -- uniform particles in 1D ----------------------------------------------------------------------


def _terms(kernel: Kernel, needed: Iterable[Key]) -> tuple[Term, ...]:
    return tuple(
        Term(delta[0], alpha[0], *row)
        for delta, alpha in needed
        for row in euler_maclaurin(kernel, delta[0], alpha[0])
    )


@cache
def euler_maclaurin(
    kernel: Kernel, derivative: int, k: int
) -> tuple[tuple[int, Rational, Rational], ...]:
    """Rows (n, p, c) of the discretisation error of m[derivative, k], c ≠ 0.

    Δs Σ_j f(s_j) − ∫ f ds = Σ c Δs^n B̃_n(p/Δs − θ), f(s) = (−1)^derivative s^k Ŵ^{(derivative)}(s).
    """
    factor = Poly((-1) ** derivative * q**k, q, domain=QQ)
    pieces = list(kernel.pieces)
    for _ in range(derivative):
        pieces = [p.diff(q) for p in pieces]
    pieces = [factor * p for p in pieces]
    parity = (-1) ** (derivative + k)
    sigma = kernel.normalisation(1)
    rows = []
    for m, at in enumerate(jumps(kernel.knots, pieces, parity)):
        scale = sigma * (-1) ** m / factorial(m + 1)
        rows += [(m + 1, p, scale * jump) for p, jump in at.items() if jump != 0]
    return tuple(rows)


def lattice_sums(
    continuous: Mapping[Key, Any], terms: Iterable[Term], ratio: Expr, theta: Rational
) -> dict[Key, Any]:
    """The base sums on the lattice: the integral and its Euler–Maclaurin terms."""
    sums = dict(continuous)
    power = cache(lambda n: simple(ratio**n))
    phase = cache(lambda p: fraction(p / ratio - theta))
    wave = cache(lambda n, p: simple(periodic_bernoulli(n, phase(p)) * power(n)))
    for term in terms:
        key = ((term.derivative,), (term.moment,))
        sums[key] += term.coefficient * wave(term.dx_power, term.knot)
    return {key: simple(value) for key, value in sums.items()}


def _require_neighbours(kernel: Kernel, ratio: Expr, theta: Rational) -> None:
    """At least one particle other than the target strictly inside the support."""
    nearest = min(abs(j + theta) for j in (-floor(theta), -floor(theta) - 1))
    if nearest == 0:
        nearest = Rational(1)
    if not nearest * ratio < kernel.support:
        raise ValueError(
            f"dx-over-h: got {ratio}, and the nearest particle is not inside the support of"
            f" {kernel.support}h; expected a ratio below {kernel.support / nearest}"
            " (did you mean h/Δx?)"
        )


# -- orders ---------------------------------------------------------------------------------------


def _response(
    operator: Operator, continuous: Mapping[Key, Any], degree: int
) -> dict[MultiIndex, dict[Key, Any]]:
    """∂M_α/∂m[key] at the continuous limit, exactly: by a rational function of one symbol ε."""
    keys = list(continuous)
    if operator.polynomial_degree is None and not operator.correction.startswith("csph"):
        part = operator.coefficients(continuous, 1)[0]
        moments = operator.correct(continuous, 1, degree)
        fixed = {unit(1, 0, 0)} if operator.form == "difference" else set()
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
        moments = operator.correct({**exact, key: exact[key] + epsilon}, 1, degree)
        for alpha, value in moments.items():
            slope = field(value).diff(epsilon)
            if slope.numer.const():
                result.setdefault(alpha, {})[key] = QQ.to_sympy(
                    slope.numer.const() / slope.denom.const()
                )
    return result


def _orders(kernel: Kernel, operator: Operator, dim: int, degree: int, theta: Rational) -> Orders:
    """Smoothing order, and the discretisation orders at generic and at aligned ratios.

    The latter to first order in the base sums, which decides for every power below twice the first.
    """
    smoothing = _smoothing_order(kernel, operator, dim)
    needed = operator.needed(dim, degree)
    terms = _terms(kernel, needed) if dim == 1 else ()
    if not terms:
        return Orders(smoothing, None, None)
    continuous = {key: continuous_sum(kernel, *key) for key in needed}
    response = _response(operator, continuous, degree)
    powers = sorted({t.dx_power for t in terms})
    horizon = powers[-1] + 1 if _is_linear(operator) else 2 * powers[0]
    generic = aligned = None
    for n in (p for p in powers if p < horizon):
        rows = [
            phased(row, n, theta)
            for row in _linear_terms(response, [t for t in terms if t.dx_power == n])
        ]
        rows = [row for row in rows if row]
        if rows and generic is None:
            generic = n
        if any(_survives_alignment(row, n, theta, kernel.support) for row in rows):
            aligned = n
            break
    return Orders(smoothing, generic, aligned)


def _is_linear(operator: Operator) -> bool:
    return operator.correction == "none"


def _linear_terms(
    response: Mapping[MultiIndex, Mapping[Key, Any]], terms: Iterable[Term]
) -> list[dict[Rational, Any]]:
    """For each moment, knot -> coefficient of B̃_n(p h/Δx − θ) at one power n."""
    by_key: dict[Key, list[Term]] = {}
    for t in terms:
        by_key.setdefault(((t.derivative,), (t.moment,)), []).append(t)
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
