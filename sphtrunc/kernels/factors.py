"""Radial factors of a kernel: what is left of Ŵ and its derivatives when the offsets are taken out.

    f₀ = Ŵ(q),   f₁ = Ŵ′/q,   f₂ = f₁′/q = (Ŵ″ − Ŵ′/q)/q²,   f₃ = Ŵ′/q³
    ∂ᵢŴ = f₁ sᵢ,   ∂ᵢ∂ⱼŴ = f₁ δᵢⱼ + f₂ sᵢsⱼ

so a sum over particles needs neither a direction nor, where the kernel is even in q, a square root:
then the factors are polynomials in q². Each piece is p(x)/x^pole, p expanded exactly about an end
of the piece at which it vanishes, else about the outer one, and rounded once.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.rational import fraction

if TYPE_CHECKING:
    from sympy import Poly, Rational

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel


_DIGITS = 60
VALUE, SLOPE, CURVATURE, STEEP = 0, 1, 2, 3  # k of f_k


@dataclass(frozen=True)
class Piece:
    """p(x)/x^pole up to x = end, with p = t^power Σ_i coefficients[i] t^i.

    errors: bounds of what rounding took off the coefficients;
    t = centre − x (as the sum of two floats), or x itself where the centre is 0. `vanishes`: the
    factor is continuous and zero from `end` on, and p vanishes there, so that t need only be cut.
    mean: the value at x = end where the factor jumps there and `end` is a float, else None.
    """

    end: float
    centre: float
    centre_low: float
    power: int
    coefficients: tuple[float, ...]
    errors: tuple[float, ...]
    pole: int
    vanishes: bool
    mean: float | None


@dataclass(frozen=True)
class Radial:
    """f_k in x = q², if `even`, or x = q: pieces from the inside out, zero beyond the last."""

    even: bool
    pieces: tuple[Piece, ...]


@lru_cache(maxsize=256)
def radial(kernel: Kernel, dim: int, k: int) -> Radial:
    """The radial factor f_k of the kernel in `dim` dimensions, σ_d included, as floats."""
    from mpmath import mp, workdps
    from sympy import QQ, Poly, Rational

    from sphtrunc.kernels.piecewise import q, valuation

    even = all(not c or not n % 2 for piece in kernel.pieces for (n,), c in piece.terms())
    laurent = [_laurent(piece, k) for piece in kernel.pieces]
    ends = [knot**2 if even else knot for knot in kernel.knots]
    if even:
        laurent = [(Poly(p.all_coeffs()[::2], q, domain=QQ), pole // 2) for p, pole in laurent]
    pieces = []
    with workdps(_DIGITS):
        sigma = 1 / ({1: 2, 2: 2 * mp.pi, 3: 4 * mp.pi}[dim] * _mp(kernel._mass(dim)))
        for i, (p, pole) in enumerate(laurent):
            a, b = ends[i], ends[i + 1]
            outer = laurent[i + 1] if i + 1 < len(laurent) else (Poly(0, q, domain=QQ), 0)
            here = p.eval(b) / b**pole
            jump = here != outer[0].eval(b) / b ** outer[1]
            last = i + 1 == len(laurent)
            at_b, at_a = valuation(p, b), valuation(p, a)
            centre = a if at_a and not at_b else b
            power = 0 if p.is_zero else int(at_a if centre == a else at_b)
            local = list(reversed(p.shift(centre).all_coeffs()))[power:]
            if centre:  # in powers of t = centre − x
                local = [c * (-1) ** (n + power) for n, c in enumerate(local)]
            mean = None
            if jump and Rational(*float(b).as_integer_ratio()) == b:
                mean = float(sigma * _mp((here + outer[0].eval(b) / b ** outer[1]) / 2))
            high = float(centre)
            wide = [sigma * _mp(c) for c in local]
            pieces.append(
                Piece(
                    end=float(b),
                    centre=high,
                    centre_low=float(centre - Rational(*high.as_integer_ratio())),
                    power=power,
                    coefficients=tuple(float(c) for c in wide),
                    errors=tuple(float(abs(c - float(c)) * (1 + mp.mpf(2) ** -40)) for c in wide),
                    pole=pole,
                    vanishes=last and centre == b and power > 0,
                    mean=mean,
                )
            )
    return Radial(even, tuple(pieces))


def _laurent(piece: Poly, k: int) -> tuple[Poly, int]:
    """f_k of one piece as (p, pole), f_k = p(q)/q^pole, no common factor q."""
    from sympy import QQ, Poly

    from sphtrunc.kernels.piecewise import q

    x = Poly(q, q, domain=QQ)
    slope = piece.diff()
    p, pole = {
        VALUE: (piece, 0),
        SLOPE: (slope, 1),
        CURVATURE: (x * slope.diff() - slope, 3),
        STEEP: (slope, 3),
    }[k]
    while pole and not p.is_zero and p.eval(0) == 0:
        p, pole = p.quo(x), pole - 1
    return (p, pole) if not p.is_zero else (p, 0)


def _mp(value: Rational) -> Any:
    from mpmath import mp

    return mp.mpf(int(value.p)) / int(value.q)


Laurent = dict[int, Fraction]  # power of q -> coefficient


@lru_cache(maxsize=512)
def laurent(kernel: Kernel, name: str) -> tuple[Laurent, ...]:
    """A radial function of the shape w (without σ_d), piece by piece."""
    pieces = [{j: fraction(c) for j, c in enumerate(piece) if c} for piece in kernel.coefficients()]
    for _ in range(0 if name == "w" else 2 if name == "w2" else 1):
        pieces = [{j - 2: j * c for j, c in piece.items() if j} for piece in pieces]
    if name == "w3":
        pieces = [{j - 2: c for j, c in piece.items()} for piece in pieces]
    return tuple(pieces)


@lru_cache(maxsize=2048)
def _radial_moment(kernel: Kernel | Gaussian, name: str, n: int, dim: int) -> Any:
    """∫ |s|ⁿ f d^d s for a radial function (of Ŵ, with σ_d)."""
    from sphtrunc.kernels.kernel import Kernel

    if not isinstance(kernel, Kernel):
        return kernel.radial_moment(name, n, dim)
    from sympy import Rational

    total = Fraction(0)
    knots = [fraction(k) for k in kernel.knots]
    for a, b, piece in zip(knots, knots[1:], laurent(kernel, name), strict=False):
        for j, c in piece.items():
            power = j + n + dim
            if power == 0 or (power < 0 and not a):
                return Rational(0)
            total += c * (b**power - a**power) / power
    mass = kernel.moment(0, dim) / kernel._mass(dim)
    return Rational(total.numerator, total.denominator) * mass


def origin_value(kernel: Kernel | Gaussian, name: str, dim: int) -> float:
    from sphtrunc.kernels.kernel import Kernel

    if name == "w":
        return float(kernel.w(0.0, dim))
    if isinstance(kernel, Kernel):
        value = laurent(kernel, name)[0].get(0, Fraction(0))
        return float(value) * float(kernel.normalisation(dim))
    return float(kernel.d2w(0.0, dim))


def radial_values(
    kernel: Kernel | Gaussian, name: str, q: Array, dim: int, order: int = 0
) -> Array:
    """f(q) σ_d, or f′(q)/q for order 1, for q > 0; means at the knots, 0 beyond the support."""
    import numpy as np

    from sphtrunc.kernels.kernel import Kernel

    if not isinstance(kernel, Kernel):
        return kernel.radial_values(name, q, dim, order)
    result = np.zeros_like(q)
    knots = [float(k) for k in kernel.knots]
    for a, b, piece in zip(knots, knots[1:], laurent(kernel, name), strict=False):
        terms = {i: float(c) for i, c in piece.items()}
        for _ in range(order):
            terms = {i - 2: i * c for i, c in terms.items() if i}
        if not terms:
            continue
        inside = (q >= a) & (q <= b)
        x = q[inside]
        low = min(terms)
        value = np.zeros_like(x)
        for i in range(max(terms), low - 1, -1):
            value = value * x + terms.get(i, 0.0)
        value = value * x**low
        edge = (x == b) | ((x == a) & (a > 0))
        result[inside] += np.where(edge, 0.5, 1.0) * value
    return np.asarray(result * float(kernel.normalisation(dim)))
