"""Radial factors of a kernel: what is left of Ŵ and its derivatives when the offsets are taken out.

    f₀ = Ŵ(q),   f₁ = Ŵ′/q,   f₂ = f₁′/q = (Ŵ″ − Ŵ′/q)/q²,   f₃ = Ŵ′/q³
    ∂ᵢŴ = f₁ sᵢ,   ∂ᵢ∂ⱼŴ = f₁ δᵢⱼ + f₂ sᵢsⱼ

so a sum over particles needs neither a direction nor, where the kernel is even in q, a square root:
then the factors are polynomials in q². Each piece is p(x)/x^pole, p expanded exactly about an end
of the piece at which it vanishes, else about the outer one, and rounded once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from mpmath import mp, workdps
from sympy import QQ, Poly, Rational

from sphtrunc.kernel import q, valuation

if TYPE_CHECKING:
    from sphtrunc.kernel import Kernel

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
    return mp.mpf(int(value.p)) / int(value.q)
