"""Radial factors of a kernel: what is left of Ŵ and its derivatives when the offsets are taken out.

    f₀ = Ŵ(q),   f₁ = Ŵ′/q,   f₂ = f₁′/q = (Ŵ″ − Ŵ′/q)/q²,   f₃ = Ŵ′/q³,   f₄ = f₁
    ∂ᵢŴ = f₁ sᵢ,   ∂ᵢ∂ⱼŴ = f₁ δᵢⱼ + f₂ sᵢsⱼ

f₃ and f₄ leave the target itself out: they are 0 at q = 0, as is any factor with a pole there. A
sum over particles needs neither a direction nor, where the kernel is even in q, a square root: then
the factors are polynomials in q². Each piece is p(x)/x^pole, p expanded exactly about an end of the
piece at which it vanishes, else about the outer one, and rounded once: theory, stencils, lattice
sums and the pair engine all evaluate these, and no digit is lost at the edge of the support.
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
_STEPS = (0, 1, 2, 1, 1)  # how often D = (1/q) d/dq acts on Ŵ in f_k


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
    """A factor in x = q², if `even`, or x = q: pieces from the inside out, zero beyond the last."""

    even: bool
    pieces: tuple[Piece, ...]


@lru_cache(maxsize=256)
def radial(kernel: Kernel, dim: int, k: int, order: int = 0) -> Radial:
    """D^order f_k of the kernel in `dim` dimensions, D = (1/q) d/dq, σ_d included, as floats."""
    from mpmath import mp, workdps
    from sympy import QQ, Poly, Rational

    from sphtrunc.kernels.piecewise import q, valuation

    even = all(not c or not n % 2 for piece in kernel.pieces for (n,), c in piece.terms())
    laurent = [_laurent(piece, k, order) for piece in kernel.pieces]
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


def _laurent(piece: Poly, k: int, order: int) -> tuple[Poly, int]:
    """D^order f_k of one piece as (p, pole), p(q)/q^pole, no common factor q."""
    from sympy import QQ, Poly

    from sphtrunc.kernels.piecewise import q

    x = Poly(q, q, domain=QQ)
    p, pole = piece, 0
    for step in range(_STEPS[k] + order):
        p, pole = x * p.diff() - pole * p, pole + 2  # D(p/q^n) = (q p′ − n p)/q^{n+2}
        if step == 0 and k == 3:
            pole += 2
    while pole and not p.is_zero and p.eval(0) == 0:
        p, pole = p.quo(x), pole - 1
    return (p, pole) if not p.is_zero else (p, 0)


def _mp(value: Rational) -> Any:
    from mpmath import mp

    return mp.mpf(int(value.p)) / int(value.q)


def evaluate(number: Any, f: Radial, x: Any, squares: Any) -> Any:
    """The factor at x (q, or q² for an even kernel), the piece picked without a branch.

    number: the functions of arrays or of lanes (`sphtrunc.arithmetic.arrays`); squares: |s|², 0 at
    the target, where a factor with a pole is 0
    """
    value: Any = None
    for piece in reversed(f.pieces):
        inner = _piece(number, piece, x, squares)
        if value is None and piece.vanishes:
            value = inner
            continue
        value = number.pick(x, piece.end, inner, 0.0 if value is None else value, piece.mean)
    return value


def _piece(number: Any, piece: Piece, x: Any, squares: Any) -> Any:
    """t^m Σ c_i t^i / x^pole."""
    t = x
    if piece.centre:
        t = number.constant(piece.centre) - x
        if piece.centre_low:
            t = t + piece.centre_low
        if piece.vanishes:
            t = number.positive(t)
    value: Any = None
    for c, error in reversed(list(zip(piece.coefficients, piece.errors, strict=True))):
        if value is None:
            value = number.constant(c, error)
        else:
            value = value * t + number.constant(c, error) if c else value * t
    value = number.constant(0.0) if value is None else value
    if piece.power:
        value = value * power(t, piece.power)
    if piece.pole:
        value = number.others(squares, value / power(x, piece.pole))
    return value


def power(t: Any, n: int) -> Any:
    """t^n, n >= 1, by repeated squaring."""
    result: Any = None
    while n:
        if n & 1:
            result = t if result is None else result * t
        n >>= 1
        if n:
            t = t * t
    return result


def factor_values(kernel: Kernel | Gaussian, k: int, q: Array, dim: int, order: int = 0) -> Array:
    """D^order f_k at distances q, of any shape, in units of h^{−d}: D = (1/q) d/dq, σ_d included.

    At a knot where it jumps, the mean of both sides; 0 beyond the support. At q = 0 Ŵ(0) and, for
    f₁, Ŵ″(0), which is its limit where Ŵ′(0) = 0; 0 for everything else.
    """
    import numpy as np

    from sphtrunc.arithmetic.arrays import ArrayNumbers
    from sphtrunc.kernels.kernel import Kernel

    away = q > 0
    if isinstance(kernel, Kernel):
        table = radial(kernel, dim, k, order)
        x = np.where(away, q, 1.0)
        squares = x * x
        result = evaluate(ArrayNumbers(), table, squares if table.even else x, squares)
        result = np.where(away, result, 0.0)
    else:
        result = np.zeros_like(q)
        result[away] = kernel.radial_values(k, q[away], dim, order)
    if k < 2 and not order and not away.all():
        result[~away] = (kernel.w, kernel.d2w)[k](0.0, dim)
    return np.asarray(result)


Laurent = dict[int, Fraction]  # power of q -> coefficient


@lru_cache(maxsize=512)
def laurent(kernel: Kernel, k: int) -> tuple[Laurent, ...]:
    """f_k of the shape w (without σ_d), exactly, piece by piece."""
    pieces = [{j: fraction(c) for j, c in enumerate(piece) if c} for piece in kernel.coefficients()]
    for _ in range(_STEPS[k]):
        pieces = [{j - 2: j * c for j, c in piece.items() if j} for piece in pieces]
    if k == 3:
        pieces = [{j - 2: c for j, c in piece.items()} for piece in pieces]
    return tuple(pieces)


@lru_cache(maxsize=2048)
def radial_moment(kernel: Kernel | Gaussian, k: int, n: int, dim: int) -> Any:
    """∫ |s|ⁿ f_k d^d s, with σ_d: exact; 0 where it diverges at the origin."""
    from sphtrunc.kernels.kernel import Kernel

    if not isinstance(kernel, Kernel):
        return kernel.radial_moment(k, n, dim)
    from sympy import Rational

    total = Fraction(0)
    knots = [fraction(k) for k in kernel.knots]
    for a, b, piece in zip(knots, knots[1:], laurent(kernel, k), strict=False):
        for j, c in piece.items():
            power = j + n + dim
            if power == 0 or (power < 0 and not a):
                return Rational(0)
            total += c * (b**power - a**power) / power
    mass = kernel.moment(0, dim) / kernel._mass(dim)
    return Rational(total.numerator, total.denominator) * mass
