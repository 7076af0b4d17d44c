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
from fractions import Fraction
from functools import cache, lru_cache, partial
from math import lcm
from typing import TYPE_CHECKING, Any

from sympy import QQ, Expr, Poly, Rational, factorial, floor, radsimp

from sphtrunc.bernoulli import fraction, periodic_bernoulli, phased, simple
from sphtrunc.derivation import Derivation, Orders, Term
from sphtrunc.kernel import Kernel, dimension, jumps, q, rational, steps
from sphtrunc.lattice import in_pairs
from sphtrunc.lattice_sums import continuous_sum, lattice_moments, laurent, parts
from sphtrunc.moments import Moments, MultiIndex, unit
from sphtrunc.operators import BROOKSHAW, FATEHI_MANZARI, NESTED, Around, Key, Operator
from sphtrunc.parse import kernel as parse_kernel

if TYPE_CHECKING:
    from sphtrunc.gaussian import Gaussian

_FIRST = {BROOKSHAW: 1, FATEHI_MANZARI: 3}  # the first k for which s^k Ŵ′/|s|, … has no pole
MAX_DEGREE = 40  # of the moments that are derived


def derive(
    kernel: Kernel | Gaussian | str,
    operator: Operator | str = "gradient",
    *,
    form: str | None = None,
    correction: str = "none",
    dim: int = 1,
    degree: int = 5,
    dx_over_h: object = None,
    offset: object = 0,
    lattice: str | None = None,
    volume: str = "constant",
) -> Derivation:
    """The truncation error of an SPH estimate, exactly.

    kernel: a Kernel, or any text that `sphtrunc.kernel` takes
    operator: an Operator, or its name together with `form` and `correction`
    dim: 1, 2 or 3
    degree: moments M_α up to |α| = degree
    dx_over_h: Δx/h, an exact number ("10/13", a Fraction, an algebraic SymPy number), or None for
        the error at any ratio
    offset: θ, the particles are at (j + θ)Δx from the target; in 2D and 3D one number per axis
    lattice: "square" (default in 2D), "hexagonal"; "cubic" (default in 3D), "bcc", "fcc", "hcp"
    volume: "constant", or "summation" (all particles alike, 1/Σ W)

    In 1D the discretisation error is known term by term at every ratio; elsewhere the moments at a
    given ratio are summed, exactly where the numbers are rational and to 30 digits where not.

    >>> derive("cubic-spline", dx_over_h="10/13").discrete[1]
    29200/28561

    Raises ValueError for a bad argument, for particles so far apart that the target has no
    neighbour, and where the matrix of the correction is singular.
    """
    kernel = parse_kernel(kernel)
    if isinstance(operator, str):
        operator = Operator(operator, form, correction)
    dim = dimension(dim)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"degree: got {degree!r}, expected a whole number from 0 to {MAX_DEGREE}")
    degree = max(degree, operator.derivatives)
    shift = _offset(offset, dim)
    theta = shift[0]
    ratio = None if dx_over_h is None else spacing(dx_over_h)
    kind = _lattice(lattice, dim, volume, ratio)
    operator.require_pairs(in_pairs(kind, shift))
    needed = operator.needed(dim, degree)
    continuous = {key: continuous_sum(kernel, key) for key in needed}
    limit = _moments(operator, continuous, dim, degree, "continuous limit")
    terms = _terms(kernel, needed) if dim == 1 and isinstance(kernel, Kernel) else ()
    discrete = None
    if ratio is not None:
        if dim == 1:
            _require_neighbours(kernel, ratio, theta)
        if dim == 1 and isinstance(kernel, Kernel) and volume == "constant":
            sums = euler_maclaurin_sums(continuous, terms, ratio, theta)
            around = None
            if operator.form == NESTED and theta != 0:
                home = euler_maclaurin_sums(continuous, terms, ratio, Rational(0))
                around = [(sums, home)]
            discrete = _moments(operator, sums, dim, degree, "derived", around)
        else:
            discrete = _summed(kernel, operator, kind, ratio, shift, volume, degree)
    return Derivation(
        kernel=kernel,
        operator=operator,
        dim=dim,
        degree=degree,
        limit=limit,
        terms=terms,
        dx_over_h=ratio,
        offset=theta,
        shift=shift,
        lattice=kind,
        volume=volume,
        discrete=discrete,
        find_orders=partial(_orders, kernel, operator, dim, degree, theta),
    )


def _offset(offset: object, dim: int) -> tuple[Rational, ...]:
    """One rational per axis; a single 0 stands for all."""
    given = list(offset) if isinstance(offset, (tuple, list)) else [offset]
    exact = [rational(value, "offset") for value in given]
    if len(exact) == 1 and exact[0] == 0:
        exact *= dim
    if len(exact) != dim:
        raise ValueError(f"offset: got {len(exact)} numbers, expected {dim}, one per axis")
    return tuple(exact)


def _lattice(lattice: str | None, dim: int, volume: str, ratio: Expr | None) -> str:
    from sphtrunc.lattice import DEFAULT, KINDS

    kind = DEFAULT[dim] if lattice is None else lattice
    names = [name for name, data in KINDS.items() if data.dim == dim]
    if kind not in names:
        raise ValueError(f"lattice: got {kind!r}, expected one of {', '.join(names)} in {dim}D")
    if volume not in ("constant", "cell", "summation") or (volume == "cell" and dim > 1):
        raise ValueError(f"volume: got {volume!r}, expected constant, summation or, in 1D, cell")
    if ratio is None and (lattice is not None or volume != "constant"):
        raise ValueError("lattice, volume: these need a ratio, expected dx-over-h as well")
    return kind


def rounded(m: Any) -> Expr:
    """A 50-digit number to 40 decimals and 30 digits."""
    from sympy import Float

    return Float(Rational(int(m.context.nint(m * 10**40)), 10**40), 30)


def _summed(
    kernel: Kernel | Gaussian,
    operator: Operator,
    kind: str,
    ratio: Expr,
    shift: tuple[Rational, ...],
    volume: str,
    degree: int,
) -> Moments:
    """The moments at a ratio, particle by particle; see `sphtrunc.lattice_sums`."""
    if not ratio.is_Rational:
        raise ValueError(f"dx-over-h: got {ratio}, expected a rational ratio for this sum")
    dim = len(shift)
    step = Fraction(int(ratio.p), int(ratio.q))
    offset = tuple(Fraction(int(x.p), int(x.q)) for x in shift)
    most = 200_000
    if float(kernel.support / ratio) ** dim > most:
        raise ValueError(
            f"dx-over-h: got {ratio}, a target has over {most} neighbours; expected a larger ratio"
        )
    linear = operator.uncorrected or (operator.form == NESTED and operator.correction == "none")
    found = lattice_moments(
        kernel, operator, kind, step, offset, degree, exact=linear, volume=volume
    )
    values = {a: m if isinstance(m, (int, Expr)) else rounded(m) for a, m in found.items()}
    return Moments(values, operator.target(dim), operator.derivatives, "derived")


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


# -- uniform particles in 1D ----------------------------------------------------------------------


def _terms(kernel: Kernel, needed: Iterable[Key]) -> tuple[Term, ...]:
    return tuple(
        Term(term, alpha[0], *row)
        for term, alpha in needed
        for row in euler_maclaurin(kernel, term, alpha[0])
    )


@lru_cache(maxsize=4096)
def euler_maclaurin(
    kernel: Kernel, term: Any, k: int
) -> tuple[tuple[int, Rational, Rational], ...]:
    """Rows (n, p, c) of the discretisation error of m[term, k], c ≠ 0.

    Δs Σ_j f(s_j) − ∫ f ds = Σ c Δs^n B̃_n(p/Δs − θ), f(s) = (−1)^δ s^k Ŵ^{(δ)}(s), or −s^k Ŵ′/|s|
    and −s^k Ŵ′/|s|³. Where such a term has a pole at the origin, k < 1 and k < 3, it belongs to a
    moment that difference forms do not have, and nothing is returned; else f is 0 there, as it
    should be without the particle at the target.
    """
    if k < _FIRST.get(term, 0):
        return ()
    parity = (-1) ** (k if isinstance(term, str) else k + term[0])
    sigma = kernel.normalisation(1)
    result = []
    for m, at in enumerate(jumps(kernel.knots, _steps(kernel, term, k), parity)):
        scale = sigma * (-1) ** m / factorial(m + 1)
        result += [(m + 1, p, scale * jump) for p, jump in at.items() if jump != 0]
    return tuple(result)


@lru_cache(maxsize=4096)
def _steps(kernel: Kernel, term: Any, k: int) -> list[list[Rational]]:
    """The steps of f at the knots: from its pieces, or from those of s^{k−1} times s = p + t."""
    if k > _FIRST.get(term, 0):
        lower = _steps(kernel, term, k - 1)
        return [
            [p * c + d for c, d in zip([*row, 0], [0, *row], strict=True)]
            for p, row in zip(kernel.knots, lower, strict=True)
        ]
    rows = parts((term, (k,)))
    pieces = []
    for i in range(len(kernel.pieces)):
        total: dict[int, Rational] = {}
        for c, (power,), name in rows:
            for j, x in laurent(kernel, name)[i].items():
                value = Rational(c * x.numerator, x.denominator)
                total[j + power] = total.get(j + power, Rational(0)) + value
        total = {j: c for j, c in total.items() if c}
        pieces.append(Poly({(j,): c for j, c in total.items()} or 0, q, domain=QQ))
    return steps(kernel.knots, pieces)


def euler_maclaurin_sums(
    continuous: Mapping[Key, Any], terms: Iterable[Term], ratio: Expr, theta: Rational
) -> dict[Key, Any]:
    """The base sums on the lattice: the integral and its Euler–Maclaurin terms."""
    sums = dict(continuous)
    power = cache(lambda n: simple(ratio**n))
    phase = cache(lambda p: fraction(p / ratio - theta))
    wave = cache(lambda n, p: simple(periodic_bernoulli(n, phase(p)) * power(n)))
    for term in terms:
        key = (term.term, (term.moment,))
        sums[key] += term.coefficient * wave(term.dx_power, term.knot)
    return {key: simple(value) for key, value in sums.items()}


def _require_neighbours(kernel: Kernel | Gaussian, ratio: Expr, theta: Rational) -> None:
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
    kernel: Kernel | Gaussian, operator: Operator, dim: int, degree: int, theta: Rational
) -> Orders:
    """Smoothing order, and the discretisation orders at generic and at aligned ratios.

    The latter to first order in the base sums, which decides for every power below twice the first.
    """
    smoothing = _smoothing_order(kernel, operator, dim)
    needed = operator.needed(dim, degree)
    terms = _terms(kernel, needed) if dim == 1 and isinstance(kernel, Kernel) else ()
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
    response: Mapping[MultiIndex, Mapping[Key, Any]], terms: Iterable[Term]
) -> list[dict[Rational, Any]]:
    """For each moment, knot -> coefficient of B̃_n(p h/Δx − θ) at one power n."""
    by_key: dict[Key, list[Term]] = {}
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
