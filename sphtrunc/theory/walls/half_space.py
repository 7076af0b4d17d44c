"""Half spaces: what a kernel has on one side of a plane, exactly.

For a radial function f a plane at z = η cuts the sphere of radius q at the cosine c = η/q, so that

    B(η) = ∫_{s₁>η} s^β f(|s|) d^d s = S_d ∫_η^κ q^{|β|+d−1} f(q) C_β(η/q) dq,

C_β(c) the mean of e^β over the directions e, of those with e₁ > c: a constant in 1D, a polynomial
in 3D, arccos c and √(1−c²) times polynomials in 2D. Where f is a Laurent polynomial on each piece,
so is the integral, plus logarithms of knots where a power of q is −1, and in 2D inverse hyperbolic
cosines, arccosines and roots: every number here is a finite sum of such terms with rational
coefficients, at a rational η and as a function of η between two knots.

−B′(z) is the integral over the plane at z (for f = Ŵ the *marginal kernel* Ŵ_⊥); what a wall at
distance η from the target leaves of a moment is the interior moment less (−1)^{β₁} B(η).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache, partial
from math import comb
from typing import Any, NamedTuple

import sympy
from sympy import QQ, Expr, Rational, Symbol

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.factors import laurent
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import unit
from sphtrunc.operators.terms import Key, angular, parts
from sphtrunc.theory.lattice_sums import real_context
from sphtrunc.theory.limit import continuous_sum

#: the distance of the target from the wall, in h, where it is left open
ETA = Symbol("eta", positive=True)

Pieces = list[tuple[Rational, Rational, Expr]]
Terms = dict[tuple[str, Any], Any]  # (function, knot) -> coefficient


class Arithmetic(NamedTuple):
    """The kind of number that η is: a rational, a symbol, or 50 digits.

    eta: as a coefficient; make: a Fraction as a coefficient; finish: a coefficient as a number of
    the kind that is returned; argument: η as such; functions: where log, acosh, acos, sqrt, pi are
    """

    eta: Any
    make: Callable[[Fraction], Any]
    finish: Callable[[Any], Any]
    argument: Any
    functions: Any


#: functions of a knot k and of η, of which every number here is a combination
FUNCTIONS: dict[str, Callable[[Any, Any, Any], Any]] = {
    "1": lambda f, k, eta: 1,
    "1/pi": lambda f, k, eta: 1 / f.pi,
    "log": lambda f, k, eta: f.log(k / eta),
    "acosh": lambda f, k, eta: f.acosh(k / eta) / f.pi,
    "acos": lambda f, k, eta: f.acos(eta / k) / f.pi,
    "root": lambda f, k, eta: f.sqrt(k**2 - eta**2) / f.pi,
}


# ---------------------------------------------------------------------------------- what is asked


def beyond(kernel: Kernel, key: Key, eta: Any) -> Any:
    """(−1)^{|δ|} ∫_{s₁>η} s^α ∂^δ Ŵ d^d s for η >= 0 and key = (δ, α).

    eta: a SymPy Rational, for an exact number, or an mpmath number, for one of 50 digits

    An integral that diverges, as η = 0 lies on a pole, is given as 0: it belongs to a moment that
    difference forms do not have.
    """
    if isinstance(eta, Rational):
        return _exactly(kernel, key, eta, _beyond)
    return _assembled(_beyond(kernel, key, _piece(kernel, eta), _digits(eta)), _digits(eta))


def plane(kernel: Kernel, key: Key, z: Any) -> Any:
    """(−1)^{|δ|} ∫ s^α ∂^δ Ŵ over the plane s₁ = z; in 1D the function itself. Numbers as of
    `beyond`; at a knot the limit from outside."""
    at = abs(z)
    if isinstance(z, Rational):
        value = _exactly(kernel, key, at, _plane)
    else:
        value = _assembled(_plane(kernel, key, _piece(kernel, at), _digits(at)), _digits(at))
    return -value if z < 0 and odd(key) else value


def per_distance(kernel: Kernel, key: Key) -> Any:
    """The slope of `plane` at 0⁺ in 2D and 3D: that of its terms with one power of s₁."""
    return _exactly(kernel, key, Rational(0), _LOWERED)


def cut_sum(kernel: Kernel, key: Key, eta: Any) -> Any:
    """m[δ, α] of a target at distance η from a wall, the sum replaced by the integral over s₁ > −η.

    eta: as of `beyond`, negative for a target on the other side of the wall
    """
    if eta < 0:
        return beyond(kernel, key, -eta)
    if has_pole(kernel, key):
        return 0 * eta
    outside = beyond(kernel, key, eta)
    whole = continuous_sum(kernel, key)
    if not isinstance(eta, Rational):
        whole = _digits(eta).make(Fraction(int(whole.p), int(whole.q)))
    return whole + outside if odd(key) else whole - outside


def beyond_pieces(kernel: Kernel, key: Key) -> Pieces:
    """`beyond` as a function of η, as (from, to, expression in ETA) between any two knots."""
    return list(_open(kernel, key, _beyond))


def plane_pieces(kernel: Kernel, key: Key) -> Pieces:
    """`plane` as a function of z > 0, likewise."""
    return list(_open(kernel, key, _plane))


def cut_pieces(kernel: Kernel, key: Key) -> Pieces:
    """`cut_sum` as a function of η >= 0, likewise."""
    if has_pole(kernel, key):
        return [(a, b, Rational(0)) for a, b, _ in beyond_pieces(kernel, key)]
    whole, sign = continuous_sum(kernel, key), -1 if odd(key) else 1
    return [(a, b, (whole - sign * e).expand()) for a, b, e in beyond_pieces(kernel, key)]


def moment_pieces(kernel: Kernel, k: int, dim: int = 1) -> Pieces:
    """m_k(η) = ∫_{−η}^κ z^k Ŵ_⊥(z) dz as a function of η, (from, to, expression in ETA) between any
    two knots; a polynomial for d = 1 and 3.

    >>> from sphtrunc import kernel
    >>> moment_pieces(kernel("cubic-spline"), 0)[0][2]
    eta**4/8 - eta**3/3 + 2*eta/3 + 1/2
    """
    return cut_pieces(kernel, (unit(dimension(dim), 0, 0), unit(dim, 0, k)))


def marginal(kernel: Kernel, dim: int = 1) -> Pieces:
    """The marginal kernel Ŵ_⊥(η), the integral of Ŵ over a plane at distance η, likewise: in 1D Ŵ
    itself, in 2D 2∫_η^κ qŴ/√(q²−η²) dq, in 3D 2π∫_η^κ qŴ dq.

    >>> from sphtrunc import kernel
    >>> marginal(kernel("wendland-c2"), 3)[0][2].subs(ETA, 0)
    3/4
    """
    zero = unit(dimension(dim), 0, 0)
    return plane_pieces(kernel, (zero, zero))


def odd(key: Key) -> bool:
    """The term changes sign with s₁."""
    delta, alpha = key
    return bool((alpha[0] + (0 if isinstance(delta, str) else delta[0])) % 2)


def has_pole(kernel: Kernel, key: Key) -> bool:
    """A 1/q is integrated: the sum belongs to a moment that difference forms do not have, and the
    interior gives it as 0 (`limit.continuous_sum`)."""
    return any(
        power == 0 or (power < 0 and i == 0)
        for _, beta, name in parts(key)
        for i, piece in enumerate(laurent(kernel, name))
        for power in (j + sum(beta) + len(beta) for j in piece)
    )


# ------------------------------------------------------------------------------- kinds of numbers


@lru_cache(maxsize=1 << 14)
def _exactly(kernel: Kernel, key: Key, eta: Rational, find: Callable[..., Terms]) -> Any:
    number = Arithmetic(
        eta=QQ.from_sympy(eta),
        make=lambda x: QQ(x.numerator, x.denominator),
        finish=QQ.to_sympy,
        argument=eta,
        functions=sympy,
    )
    return _assembled(find(kernel, key, _piece(kernel, eta), number), number)


@lru_cache(maxsize=4096)
def _open(kernel: Kernel, key: Key, find: Callable[..., Terms]) -> tuple[Any, ...]:
    field = QQ.frac_field(ETA)
    number = Arithmetic(
        eta=field.gens[0],
        make=lambda x: field(QQ(x.numerator, x.denominator)),
        finish=lambda c: field.to_sympy(c).expand(),
        argument=ETA,
        functions=sympy,
    )
    knots = kernel.knots
    return tuple(
        (knots[i], knots[i + 1], _assembled(find(kernel, key, i, number), number))
        for i in range(len(kernel.pieces))
    )


def _digits(eta: Any) -> Arithmetic:
    ctx = real_context()
    return Arithmetic(
        eta=eta,
        make=lambda x: ctx.mpf(x.numerator) / x.denominator,
        finish=lambda c: c,
        argument=eta,
        functions=ctx,
    )


def _assembled(terms: Terms, number: Arithmetic) -> Any:
    exact = number.functions is sympy
    total: Any = Rational(0) if exact else number.functions.zero
    for (name, knot), c in terms.items():
        if c:
            k = knot if exact or knot is None else number.make(fraction(knot))
            value = FUNCTIONS[name](number.functions, k, number.argument)
            total += number.finish(c) * value
    if exact and any(name == "log" for name, _ in terms):
        return sympy.expand_log(total.expand(), force=True)
    return total


def _piece(kernel: Kernel, eta: Any) -> int:
    """The piece on which η lies, of two the outer one."""
    return sum(bool(int(k.q) * eta >= int(k.p)) for k in kernel.knots[1:])


# ------------------------------------------------------------------------------------- integrals


def _rows(kernel: Kernel, key: Key, first: int) -> Iterator[tuple[Any, ...]]:
    """(c, b, a, j, i) for every term c s₁^b |s_t|^a q^j of the pieces i >= first, s_t averaged over
    its directions, of the shape w divided by its mass."""
    dim = len(key[1])
    mass = fraction(kernel._mass(dim))
    for c, beta, name in parts(key):
        mean = angular(beta[1:])
        if mean:
            for i, piece in enumerate(laurent(kernel, name)):
                if i >= first:
                    for j, w in piece.items():
                        yield c * mean * w / mass, beta[0], sum(beta[1:]), j, i


def _add(terms: Terms, name: str, knot: Any, value: Any) -> None:
    place = name, knot
    terms[place] = terms[place] + value if place in terms else value


def _power(
    terms: Terms, number: Arithmetic, c: Any, e: int, low: Rational | None, high: Rational
) -> None:
    """Adds c ∫ q^e dq from a knot, or from η for None, to a knot."""
    for knot, sign in ((high, 1), (low, -1)):
        if e == -1:
            if knot is not None:
                _add(terms, "log", knot, sign * c)
        else:
            q = number.eta if knot is None else number.make(fraction(knot))
            if q != 0:
                _add(terms, "1", None, c * q ** (e + 1) * number.make(Fraction(sign, e + 1)))


def _over_root(
    terms: Terms, number: Arithmetic, c: Any, e: int, low: Rational | None, high: Rational
) -> None:
    """Adds c/π ∫ q^e/√(q²−η²) dq, from a knot or η to a knot, for η > 0; the primitive is 0 at η.

    With K_e this primitive, e K_e = q^{e−1} √(q²−η²) + (e−1) η² K_{e−2}; K_0 = arcosh(q/η),
    K_{−1} = arccos(η/q)/η.
    """
    eta = number.eta
    for knot, sign in ((high, 1), (low, -1)):
        if knot is None:
            continue
        q, factor, n = number.make(fraction(knot)), c * number.make(Fraction(sign)), e
        while n not in (0, -1):
            if n > 0:
                _add(terms, "root", knot, factor * q ** (n - 1) * number.make(Fraction(1, n)))
                factor = factor * eta**2 * number.make(Fraction(n - 1, n))
                n -= 2
                if n < 0:
                    break
            else:
                _add(
                    terms,
                    "root",
                    knot,
                    factor * number.make(Fraction(-1, n + 1)) * q ** (n + 1) / eta**2,
                )
                factor = factor * number.make(Fraction(n + 2, n + 1)) / eta**2
                n += 2
                if n == 0:
                    break
        else:
            if n == 0:
                _add(terms, "acosh", knot, factor)
            else:
                _add(terms, "acos", knot, factor / eta)


def _beyond(kernel: Kernel, key: Key, first: int, number: Arithmetic) -> Terms:
    """B(η), η on the piece `first`."""
    terms: Terms = {}
    dim, eta = len(key[1]), number.eta
    for c, b, a, j, i in _rows(kernel, key, first):
        low, high = (None if i == first else kernel.knots[i]), kernel.knots[i + 1]
        e = b + a + dim - 1 + j
        if eta == 0:
            low = kernel.knots[i]
            if e < 0 and (not low or e == -1):
                return {}
        if dim == 1:
            _power(terms, number, number.make(c / 2), e, low, high)
        elif dim == 3:
            for p, t in _spherical(b, a).items():
                if not p or eta != 0:
                    _power(terms, number, number.make(c * t) * eta**p, e - p, low, high)
        else:
            arc, roots = _circular(b, a)
            if eta == 0:
                _power(terms, number, number.make(c * arc / 2), e, low, high)
                half: Terms = {}
                _power(half, number, number.make(c * roots.get(0, Fraction(0))), e, low, high)
                for value in half.values():
                    _add(terms, "1/pi", None, value)
                continue
            if arc:
                if e == -1:
                    return {}
                for knot, sign in ((high, 1), (low, -1)):
                    if knot is not None:
                        scale = number.make(c * arc * sign / (e + 1))
                        q = number.make(fraction(knot))
                        _add(terms, "acos", knot, scale * q ** (e + 1))
                _over_root(terms, number, number.make(-c * arc / (e + 1)) * eta, e, low, high)
            for p, t in roots.items():
                scale = number.make(c * t) * eta**p
                _over_root(terms, number, scale, e - p + 1, low, high)
                _over_root(terms, number, -scale * eta**2, e - p - 1, low, high)
    return terms


def _plane(
    kernel: Kernel, key: Key, first: int, number: Arithmetic, lowered: bool = False
) -> Terms:
    """The integral over the plane at η > 0, or 0⁺, η on the piece `first`.

    lowered: of the terms with one power of s₁ alone, and without it
    """
    terms: Terms = {}
    dim, eta = len(key[1]), number.eta
    for c, b, a, j, i in _rows(kernel, key, first):
        if lowered:
            if b != 1:
                continue
            b = 0
        if b and eta == 0 and not (dim == 1 and b + j == 0):
            continue
        if dim == 1:
            if i == first:
                _add(terms, "1", None, number.make(c / 2) * (eta ** (b + j) if b + j else 1))
            continue
        low, high = (None if i == first else kernel.knots[i]), kernel.knots[i + 1]
        for n in range(a // 2 + 1 if dim == 3 or a else 1):  # (q² − η²)^{a/2}
            scale = number.make(c * comb(a // 2, n) * (-1) ** n)
            if n or b:
                if eta == 0:
                    continue
                scale = scale * eta ** (2 * n + b)
            e = j + 1 + a - 2 * n
            if dim == 3:
                _power(terms, number, scale * number.make(Fraction(1, 2)), e, low, high)
            elif eta == 0:
                part: Terms = {}
                _power(part, number, scale, e - 1, low, high)
                for (name, knot), value in part.items():
                    _add(terms, "1/pi" if name == "1" else name, knot, value)
            else:
                _over_root(terms, number, scale, e, low, high)
    return terms


@lru_cache(maxsize=256)
def _spherical(b: int, a: int) -> dict[int, Fraction]:
    """½ ∫_c^1 μ^b (1−μ²)^{a/2} dμ as a polynomial in c: power -> coefficient."""
    result: dict[int, Fraction] = {}
    for n in range(a // 2 + 1):
        t = Fraction((-1) ** n * comb(a // 2, n), 2 * (b + 2 * n + 1))
        result[0] = result.get(0, Fraction(0)) + t
        result[b + 2 * n + 1] = result.get(b + 2 * n + 1, Fraction(0)) - t
    return result


@lru_cache(maxsize=256)
def _circular(b: int, a: int) -> tuple[Fraction, dict[int, Fraction]]:
    """∫_c^1 μ^b (1−μ²)^{(a−1)/2} dμ as (x, p): x arccos c + √(1−c²) Σ p_n c^n.

    With J_b = ∫_c^1 μ^b/√(1−μ²) dμ, b J_b = (b−1) J_{b−2} + c^{b−1} √(1−c²).
    """
    arc, roots = Fraction(0), dict[int, Fraction]()
    for n in range(a // 2 + 1):
        factor, m = Fraction((-1) ** n * comb(a // 2, n)), b + 2 * n
        while m > 0:
            roots[m - 1] = roots.get(m - 1, Fraction(0)) + factor / m
            factor, m = factor * Fraction(m - 1, m), m - 2
        if m == 0:
            arc += factor
    return arc, roots


_LOWERED = partial(_plane, lowered=True)
