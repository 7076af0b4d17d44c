"""Gaussian kernels, which are not piecewise polynomials: the same questions, the same names.

The shape is e^{−q²}, infinite or cut at 2h, 3h or 4h, or the super-Gaussian (d/2 + 1 − q²) e^{−q²},
whose second moment is zero (Gingold & Monaghan 1977, doi:10.1093/mnras/181.3.375; Monaghan 1992,
doi:10.1146/annurev.aa.30.090192.002551).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import e as euler
from typing import TYPE_CHECKING, Any, ClassVar

from sympy import Expr as Expression
from sympy import Integer, Rational, Symbol, erf, exp, gamma, pi, sqrt

from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.kernel import SPHERE
from sphtrunc.kernels.piecewise import q

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

#: where an infinite kernel is summed to: e^{−49} is 5e-22 of its middle
REACH = Rational(7)
CUTS = (2, 3, 4)
SOURCE = "Gingold & Monaghan (1977) doi:10.1093/mnras/181.3.375"
SUPER = "Monaghan (1992) doi:10.1146/annurev.aa.30.090192.002551"


_STEPS = (0, 1, 2, 1, 1)  # how often (1/q) d/dq acts on Ŵ in the radial factor f_k


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian kernel.

    cut: the support in h, or None where it is infinite
    renormalised: whether a cut kernel integrates to one; otherwise it keeps the constant π^{−d/2}
        of the infinite one and its integral falls short
    power: 0 for e^{−q²}, 1 for the super-Gaussian

    `support` of an infinite kernel is where sums over it end, REACH; nothing that a double can see
    lies beyond.
    """

    name: str
    cut: int | None = None
    renormalised: bool = True
    power: int = 0
    is_polynomial: ClassVar[bool] = False

    @property
    def source(self) -> str:
        """Where it was published."""
        return SUPER if self.power else SOURCE

    @property
    def support(self) -> Rational:
        """κ, or REACH."""
        return REACH if self.cut is None else Rational(self.cut)

    @property
    def knots(self) -> tuple[Rational, ...]:
        """0 and the support."""
        return (Rational(0), self.support)

    @property
    def boundary_smoothness(self) -> int | float:
        """β: infinite without an edge, −1 where the kernel is cut."""
        return float("inf") if self.cut is None else -1

    @property
    def smoothness(self) -> int | float:
        """The same: there are no other knots."""
        return self.boundary_smoothness

    @property
    def pieces(self) -> tuple[Any, ...]:
        """No polynomials."""
        return ()

    @property
    def curved_at_0(self) -> bool:
        """Ŵ″ exists at the origin."""
        return True

    def coefficients(self) -> tuple[tuple[Rational, ...], ...]:
        """None."""
        return ()

    @property
    def degree(self) -> int:
        """0: `jumps` is asked for derivatives up to here."""
        return 0

    def knot_smoothness(self) -> dict[Rational, int | float]:
        """Derivatives that are continuous at 0 and, of a cut kernel, at its edge."""
        edge: dict[Rational, int | float] = {} if self.cut is None else {self.support: -1}
        return {Rational(0): float("inf"), **edge}

    def jumps(self, derivative: int) -> dict[Rational, Expression]:
        """[Ŵ^{(m)}](±κ) in 1D; empty for an infinite kernel."""
        if self.cut is None:
            return {}
        s = Symbol("s")
        at = self.expression(1).subs(q, s).diff((s, derivative)) if derivative else exp(-(s**2))
        jump = -self.normalisation(1) * at.subs(s, self.cut)
        return {-self.support: -((-1) ** derivative) * jump, self.support: jump}

    def expression(self, dim: int) -> Expression:
        """The shape w(q)."""
        return (Rational(dim + 2, 2) - q**2 if self.power else 1) * exp(-(q**2))

    def formula(self, dim: int) -> str:
        """The shape as text."""
        return f"({Rational(dim + 2, 2)} − q²) exp(−q²)" if self.power else "exp(−q²)"

    def central(self, dim: int) -> Rational:
        """w(0)."""
        return Rational(dim + 2, 2) if self.power else Rational(1)

    def edge_jump(self, dim: int = 1) -> Expression:
        """[Ŵ](κ) = −σ_d e^{−κ²}, the jump at the cut; 0 for an infinite kernel.

        It is the coefficient of the first-order discretisation error that overtakes the
        exponentially small one of the infinite kernel.
        """
        if self.cut is None:
            return Integer(0)
        return -self.normalisation(dim) * exp(-(Integer(self.cut) ** 2))

    def normalisation(self, dim: int = 1) -> Expression:
        """σ_d, exactly."""
        dim = dimension(dim)
        if self.cut is not None and self.renormalised:
            return 1 / (SPHERE[dim] * self._radial(dim - 1))
        return pi ** Rational(-dim, 2)

    def moment(self, n: int, dim: int = 1) -> Expression:
        """∫ |s|ⁿ Ŵ d^d s, exactly: a rational, or with e and erf where the kernel is cut."""
        dim = dimension(dim)
        total = self.normalisation(dim) * SPHERE[dim] * self._shape(n + dim - 1, dim)
        return total.expand().simplify() if self.cut is None else total

    def gradient_moment(self, n: int, dim: int = 1) -> Expression:
        """∫ |s|ⁿ⁻¹ s·∇Ŵ d^d s, as `Kernel.gradient_moment`: the classical derivative."""
        dim = dimension(dim)
        if dim == 1 and n % 2 == 0:
            return Integer(0)
        slope = -(n + dim - 1) * self.moment(n - 1, dim)
        if self.cut is None:
            return slope
        edge = -self.edge_jump(dim) * SPHERE[dim] * Integer(self.cut) ** (n + dim - 1)
        return slope + edge

    def _radial(self, n: int) -> Expression:
        """∫₀^κ qⁿ e^{−q²} dq."""
        if self.cut is None:
            return gamma(Rational(n + 1, 2)) / 2
        k = Integer(self.cut)
        # I_n = (n−1)/2 I_{n−2} − k^{n−1} e^{−k²}/2
        value = sqrt(pi) / 2 * erf(k) if n % 2 == 0 else (1 - exp(-(k**2))) / 2
        for i in range(2 if n % 2 == 0 else 3, n + 1, 2):
            value = Rational(i - 1, 2) * value - k ** (i - 1) * exp(-(k**2)) / 2
        return value

    def radial_moment(self, k: int, n: int, dim: int) -> Expression:
        """∫ |s|ⁿ f_k d^d s (`sphtrunc.kernels.factors`); 0 where it diverges."""
        a = Rational(dim + 2, 2) if self.power else Integer(1)
        scale = Integer(1)
        for _ in range(_STEPS[k]):
            a, scale = a + self.power, -2 * scale
        power = n + dim - 1 - 2 * (k == 3)
        if power < 0:
            return Integer(0)
        total = a * self._radial(power)
        if self.power:
            total -= self._radial(power + 2)
        total *= scale * SPHERE[dim] * self.normalisation(dim)
        return total.expand().simplify() if self.cut is None else total

    def _shape(self, n: int, dim: int) -> Expression:
        if not self.power:
            return self._radial(n)
        return Rational(dim + 2, 2) * self._radial(n) - self._radial(n + 2)

    # -- floats -----------------------------------------------------------------------------------

    def w(self, q: ArrayLike, dim: int = 1) -> NDArray[np.floating[Any]]:
        """σ_d w(q) in float64, shape of q; half of it at the edge of a cut kernel, 0 beyond."""
        return self._evaluate(q, dim, 0)

    def dw(self, q: ArrayLike, dim: int = 1) -> NDArray[np.floating[Any]]:
        """σ_d w′(q), as `w`."""
        return self._evaluate(q, dim, 1)

    def d2w(self, q: ArrayLike, dim: int = 1) -> NDArray[np.floating[Any]]:
        """σ_d w″(q), as `w`."""
        return self._evaluate(q, dim, 2)

    def _evaluate(self, argument: ArrayLike, dim: int, order: int) -> NDArray[np.floating[Any]]:
        import numpy as np

        from sphtrunc.kernels.floats import checked

        q = checked(argument)
        dim = dimension(dim)
        x = np.minimum(q, 40.0)  # beyond, e^{−q²} is 0 anyway; keeps an infinite q from being NaN
        square = x * x
        a = float(Rational(dim + 2, 2)) if self.power else 1.0
        b = 1.0 if self.power else 0.0
        # (a − b q²) e^{−q²} and its derivatives
        if order == 0:
            value = a - b * square
        elif order == 1:
            value = -2.0 * x * (a + b - b * square)
        else:
            value = -2.0 * (a + b) + square * (4.0 * a + 10.0 * b) - 4.0 * b * square * square
        value = value * (np.exp(-square) * self._sigma(dim))
        if self.cut is not None:
            value = np.where(q > self.cut, 0.0, np.where(q == self.cut, 0.5 * value, value))
        return np.asarray(value, dtype=q.dtype)

    def _sigma(self, dim: int) -> float:
        return self._sigmas[dim]

    @cached_property
    def _sigmas(self) -> dict[int, float]:
        return {d: float(self.normalisation(d)) for d in (1, 2, 3)}

    def radial_mp(self, context: Any, k: int, q: Any, dim: int = 1) -> Any:
        """f_k of the shape (`sphtrunc.kernels.factors`), without σ_d, with mpmath numbers."""
        if self.cut is not None and q > self.cut:
            return context.zero
        square = q * q
        a = context.mpf(dim + 2) / 2 if self.power else context.one
        b = self.power
        scale = context.one
        for _ in range(_STEPS[k]):
            a, scale = a + b, -2 * scale
        value = scale * (a - b * square) * context.exp(-square)
        if k == 3:
            value /= square
        return value / 2 if self.cut is not None and q == self.cut else value

    def radial_values(
        self, k: int, q: NDArray[np.float64], dim: int, order: int
    ) -> NDArray[np.float64]:
        """The same functions in float64 with σ_d, or their f′/q (order 1), for q > 0."""
        import numpy as np

        u = q * q
        # D = (1/q) d/dq sends (a − b u) e^{−u} to −2 (a + b − b u) e^{−u}
        a, b = (dim + 2) / 2 if self.power else 1.0, float(self.power)
        scale = 1.0
        for _ in range(_STEPS[k] + (order if k != 3 else 0)):
            a, scale = a + b, -2.0 * scale
        value = scale * (a - b * u) * np.exp(-u)
        if k == 3:
            value = value / u
            if order:
                slope = -2.0 * scale * (a + b - b * u) * np.exp(-u)
                value = slope / u - 2.0 * value / u
        value = value * self._sigma(dim)
        if self.cut is not None:
            value = np.where(q > self.cut, 0.0, np.where(q == self.cut, 0.5 * value, value))
        return np.asarray(value)

    # -- spectrum ---------------------------------------------------------------------------------

    def radial(self, k: NDArray[np.float64], dim: int, m: int) -> NDArray[np.float64] | None:
        """Φ_m(k) of `sphtrunc.kernels.transform`; None for a cut kernel, which has no closed form.

        F = e^{−k²/4}, or (1 + k²/4) e^{−k²/4} for the super-Gaussian; −(1/k) d/dk halves e^{−k²/4}.
        """
        import numpy as np

        if self.cut is not None:
            return None
        u = k * k / 4
        return np.asarray((1.0 + self.power * (u - m)) * 0.5**m * np.exp(-u))

    def decay(self, dim: int, m: int) -> tuple[tuple[int, float], ...]:
        """A bound of |Φ_m| by powers, from k^n e^{−k²/4} <= (2n/e)^{n/2}; none for a cut kernel."""
        if self.cut is not None:
            return ()
        n = 60
        size = 0.5**m * (2 * n / euler) ** (n / 2)
        if not self.power:
            return ((n, size),)
        return ((n, size * (1 + m)), (n - 2, size / 4))


def named(name: str) -> Gaussian | None:
    """The Gaussian kernel of that name, None if it is not one.

    `gaussian`, `gaussian:3` (cut at 3h and normalised there), `gaussian:3:infinite` (cut, with the
    constant of the infinite kernel), `super-gaussian`.

    Raises ValueError for another cut.
    """
    key = name.strip().lower()
    if key == "gaussian":
        return Gaussian(key)
    if key == "super-gaussian":
        return Gaussian(key, power=1)
    family, colon, rest = key.partition(":")
    if family != "gaussian" or not colon:
        return None
    cut, _, constant = rest.partition(":")
    if cut in map(str, CUTS) and constant in ("", "infinite"):
        return Gaussian(key, cut=int(cut), renormalised=not constant)
    raise ValueError(
        f"kernel: got {name[:40]!r}, expected gaussian, gaussian:2, :3 or :4 (cut there and"
        " normalised), the same with :infinite (constant of the infinite kernel), or super-gaussian"
    )


def names() -> list[str]:
    """Every name that `named` knows."""
    cuts = [f"gaussian:{c}{s}" for c in CUTS for s in ("", ":infinite")]
    return ["gaussian", *cuts, "super-gaussian"]
