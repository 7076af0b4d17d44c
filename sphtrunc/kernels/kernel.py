"""Exact kernels: a shape w(q), piecewise polynomial in q = r/h with rational coefficients.

In d dimensions the kernel is W(r, h) = σ_d h^{-d} w(r/h); its dimensionless form Ŵ(s) = σ_d w(|s|).
The shape has no dimension and no scale: every constant (σ_d, moments, jumps) is derived from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

from sympy import QQ, Poly, Rational, pi
from sympy import Expr as Expression

from sphtrunc.kernels.arguments import _listed, count, dimension, rational
from sphtrunc.kernels.piecewise import _piece, jumps, q, steps

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

#: surface of the unit sphere in d dimensions: ∫ f(|s|) d^d s = SPHERE[d] ∫ f(q) q^{d-1} dq
SPHERE: dict[int, Expression] = {1: Rational(2), 2: 2 * pi, 3: 4 * pi}


@dataclass(frozen=True)
class Kernel:
    """A kernel shape w(q): knots 0 = k₀ < … < κ and one polynomial in q between each pair.

    `pieces[i]` holds on [knots[i], knots[i+1]]; beyond the support κ the shape is zero. A piece is
    a SymPy Poly over QQ in `q`, or its coefficients, lowest degree first. Equal neighbouring pieces
    are merged and trailing zero pieces dropped, so that kernels compare (and hash) by value; name
    and source do not take part in the comparison. A kernel need be neither positive, nor continuous
    (top-hat: β = −1), nor smooth.

    >>> hat = Kernel([0, 1], [[1, -1]], name="hat")
    >>> hat.normalisation(1), hat.moment(2), hat.boundary_smoothness
    (1, 1/6, 0)

    Raises ValueError for knots that do not start at 0 or do not increase, for a number of pieces
    that does not fit, for floats, and for a shape that is zero everywhere.
    """

    knots: tuple[Rational, ...]
    pieces: tuple[Poly, ...]
    name: str = field(default="custom", compare=False)
    source: str = field(default="", compare=False)
    is_polynomial: ClassVar[bool] = True

    def __init__(
        self,
        knots: Sequence[object],
        pieces: Sequence[Poly | Sequence[object]],
        name: str = "custom",
        source: str = "",
    ) -> None:
        exact = [rational(k, "knots") for k in knots]
        if len(exact) < 2 or exact[0] != 0:
            raise ValueError(
                f"knots: got {_listed(exact)}, expected at least two, the first of them 0"
            )
        for a, b in pairwise(exact):
            if not a < b:
                raise ValueError(f"knots: {b} follows {a}, expected increasing knots")
        if len(pieces) != len(exact) - 1:
            raise ValueError(
                f"pieces: got {len(pieces)} for {len(exact)} knots, expected {len(exact) - 1}"
            )
        polynomials = [_piece(p) for p in pieces]
        while polynomials and polynomials[-1].is_zero:
            polynomials.pop()
            exact.pop()
        if not polynomials:
            raise ValueError("pieces: every piece is zero, expected a kernel that is not")
        kept_knots, kept_pieces = [exact[0]], [polynomials[0]]
        for knot, piece in zip(exact[1:], polynomials[1:], strict=False):
            if piece != kept_pieces[-1]:
                kept_knots.append(knot)
                kept_pieces.append(piece)
        object.__setattr__(self, "knots", (*kept_knots, exact[-1]))
        object.__setattr__(self, "pieces", tuple(kept_pieces))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "source", source)

    def __reduce__(self) -> tuple[type[Kernel], tuple[object, ...]]:
        """A Poly forgets its domain in a pickle, so the coefficients are pickled."""
        return Kernel, (self.knots, self.coefficients(), self.name, self.source)

    # -- exact ------------------------------------------------------------------------------------

    @property
    def support(self) -> Rational:
        """κ: the kernel vanishes for r > κh."""
        return self.knots[-1]

    @property
    def degree(self) -> int:
        """The highest degree of any piece."""
        return max(int(p.degree()) for p in self.pieces if not p.is_zero)

    def central(self, dim: int = 1) -> Rational:
        """w(0) of the shape, in whatever dimension."""
        return self.pieces[0].eval(0)

    @property
    def curved_at_0(self) -> bool:
        """Whether Ŵ″ exists at the origin in any dimension: w′(0) = 0."""
        return bool(self.pieces[0].diff().eval(0) == 0)

    def derivative(self) -> tuple[Poly, ...]:
        """The pieces of w′(q), knot by knot (without the delta functions of a jump)."""
        return tuple(p.diff(q) for p in self.pieces)

    def normalisation(self, dim: int = 1) -> Expression:
        """σ_d = 1 / ∫ w(|s|) d^d s: rational for d = 1, rational/π for d = 2 and 3.

        Raises ValueError where the integral is zero: such a shape cannot be normalised.
        """
        dim = dimension(dim)
        return 1 / (SPHERE[dim] * self._mass(dim))

    def moment(self, n: int, dim: int = 1) -> Rational:
        """Kernel moment ∫ |s|ⁿ Ŵ d^d s, in units of hⁿ: exact and rational in every dimension."""
        dim = dimension(dim)
        return self._radial(self.pieces, count(n, "n") + dim - 1) / self._mass(dim)

    def gradient_moment(self, n: int, dim: int = 1) -> Rational:
        """∫ |s|ⁿ⁻¹ s·∇Ŵ d^d s; in 1D this is ∫ sⁿ Ŵ′ ds for odd n (for even n that one is 0).

        It is the integral of the classical derivative, which is what particles sum: for a
        continuous kernel −(n+d−1) ∫ |s|ⁿ⁻¹ Ŵ d^d s; a jump of w leaves the difference.
        """
        dim, n = dimension(dim), count(n, "n")
        if dim == 1 and n % 2 == 0:
            return Rational(0)
        return self._radial(self.derivative(), n + dim - 1) / self._mass(dim)

    def jumps(self, derivative: int) -> dict[Rational, Rational]:
        """[Ŵ^{(m)}](p) = Ŵ^{(m)}(p⁺) − Ŵ^{(m)}(p⁻) at every knot p of the even 1D extension.

        The keys are −κ … 0 … κ; zeros are included.
        """
        at = _jumps(self)
        sigma = self.normalisation(1)
        if count(derivative, "derivative") >= len(at):
            return dict.fromkeys(at[0], Rational(0))
        return {knot: sigma * jump for knot, jump in at[derivative].items()}

    @property
    def boundary_smoothness(self) -> int:
        """β: the derivatives 0 … β vanish at the edge of the support (−1: w itself jumps there)."""
        return int(self.knot_smoothness()[self.support])

    @property
    def smoothness(self) -> int:
        """The even 1D extension is C^smoothness: the least order over all knots (−1: it jumps)."""
        return int(min(self.knot_smoothness().values()))

    def knot_smoothness(self) -> dict[Rational, int | float]:
        """For every knot p ≥ 0 of the even extension, how many derivatives are continuous there.

        inf where all of them are (an origin without odd powers of q).
        """
        at = _jumps(self)
        return {
            knot: next((m - 1 for m, jump in enumerate(at) if jump[knot]), float("inf"))
            for knot in self.knots
        }

    def scaled(self, support: object) -> Kernel:
        """The same kernel with its support at `support` times h instead of κ times h.

        >>> Kernel([0, 2], [[1, "-1/2"]]).scaled(support=1).knots
        (0, 1)
        """
        wanted = rational(support, "support")
        if wanted <= 0:
            raise ValueError(f"support: got {wanted}, expected a positive rational")
        ratio = self.support / wanted
        stretch = Poly(ratio * q, q, domain=QQ)
        return Kernel(
            [k / ratio for k in self.knots],
            [p.compose(stretch) for p in self.pieces],
            name=f"{self.name} with support {wanted}h",
            source=self.source,
        )

    def coefficients(self) -> tuple[tuple[Rational, ...], ...]:
        """The coefficients of each piece, lowest degree first."""
        return tuple(tuple(reversed(p.all_coeffs())) for p in self.pieces)

    def _mass(self, dim: int) -> Rational:
        return _mass(self, dim)

    def _radial(self, pieces: Sequence[Poly], power: int) -> Rational:
        """∫₀^κ qⁿ f(q) dq for f piecewise polynomial on the knots."""
        total = QQ(0)
        for a, b, piece in zip(self.knots, self.knots[1:], pieces, strict=False):
            low, high = QQ(int(a.p), int(a.q)), QQ(int(b.p), int(b.q))
            for n, c in enumerate(reversed(piece.rep.to_list()), start=power + 1):
                if c:
                    total += c * (high**n - low**n) / n
        return Rational(total.numerator, total.denominator)

    # -- floats -----------------------------------------------------------------------------------

    def w(self, q: ArrayLike, dim: int = 1) -> NDArray[np.floating[Any]]:
        """σ_d w(q): float64 (or float32 for float32 input), shape of q, in units of h^{-d}.

        To 4 units in the last place (8 above degree 11) wherever the kernel has one sign. At a
        knot where w jumps, the mean of both sides; 0 beyond the support.

        Raises ValueError for a q that is negative or not a number.
        """
        return self._evaluate(q, dim, 0)

    def dw(self, q: ArrayLike, dim: int = 1) -> NDArray[np.floating[Any]]:
        """σ_d w′(q), as `w`; at q = 0 the limit from the right."""
        return self._evaluate(q, dim, 1)

    def d2w(self, q: ArrayLike, dim: int = 1) -> NDArray[np.floating[Any]]:
        """σ_d w″(q), as `w`; at q = 0 the limit from the right."""
        return self._evaluate(q, dim, 2)

    def _evaluate(
        self, argument: ArrayLike, dim: int, derivative: int
    ) -> NDArray[np.floating[Any]]:
        from sphtrunc.kernels.floats import checked, evaluate, tabulate

        points = checked(argument)
        return evaluate(tabulate(self, dimension(dim), derivative), points)


@lru_cache(maxsize=1024)
def _mass(kernel: Kernel, dim: int) -> Rational:
    """∫₀^κ w q^{d−1} dq."""
    mass = kernel._radial(kernel.pieces, dim - 1)
    if mass == 0:
        raise ValueError(
            f"kernel {kernel.name!r}: its integral in {dim}D is zero, so it cannot be normalised"
        )
    return mass


@lru_cache(maxsize=256)
def _jumps(kernel: Kernel) -> list[dict[Rational, Rational]]:
    return jumps(kernel.knots, steps(kernel.knots, kernel.pieces), parity=1)
