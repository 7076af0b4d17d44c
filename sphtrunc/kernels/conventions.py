"""Conventions: the many names that codes give to one number, the ratio of h to Δx.

Everything is a constant of (kernel, dimension) times a power of h/Δx, so a conversion is exact
wherever those constants are: rational, a root of a rational, or an algebraic number.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mpmath
from sympy import QQ, Expr, Poly, Rational, log, pi, radsimp, root, sqrt

from sphtrunc.kernels.arguments import dimension, rational
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.kernels.piecewise import q

#: volume of the unit ball
BALL: dict[int, Expr] = {1: Rational(2), 2: pi, 3: 4 * pi / 3}


@dataclass(frozen=True)
class Convention:
    """says: what it is; who: where it is met; length: scales with Δx (else a pure number)."""

    says: str
    who: str
    length: bool = False


CONVENTIONS: dict[str, Convention] = {
    "h": Convention("smoothing length", "the h of W(r, h) as the kernel is written here", True),
    "support": Convention(
        "support radius κh", "Gadget (2005) doi:10.1111/j.1365-2966.2005.09655.x", True
    ),
    "two-sigma": Convention(
        "2σ, σ the standard deviation along an axis",
        "Dehnen & Aly (2012) doi:10.1111/j.1365-2966.2012.21439.x",
        True,
    ),
    "fwhm": Convention(
        "full width at half maximum", "MARTINI (2024) doi:10.21105/joss.06860", True
    ),
    "dx-over-h": Convention("Δx/h", "Quinlan, Basa & Lastiwka (2006) doi:10.1002/nme.1617"),
    "hdx": Convention("h/Δx", "PySPH"),
    "hfact": Convention("h (ρ/m)^(1/d), which is h/Δx", "Phantom (2018) doi:10.1017/pasa.2018.25"),
    "coefh": Convention("h/(√d Δx)", "DualSPHysics (2022) doi:10.1007/s40571-021-00404-2"),
    "eta": Convention("2σ/Δx", "SWIFT (2024) doi:10.1093/mnras/stae922; Dehnen & Aly (2012)"),
    "neighbours": Convention(
        "particles in the support, V_d (κh/Δx)^d",
        "Gadget, Gasoline and others; the target is counted",
    ),
}


@dataclass(frozen=True)
class Resolution:
    """h/Δx of a kernel in a dimension, read in any convention.

    >>> convert("cubic-spline", 3, hfact="1.2")["dx-over-h"]
    5/6
    """

    kernel: Kernel
    dim: int
    h_over_dx: Expr

    def __getitem__(self, convention: str) -> Expr:
        """The value in the convention, an exact SymPy number; lengths are in units of Δx."""
        factor, power = _law(self.kernel, self.dim, convention)
        return radsimp(factor * self.h_over_dx**power)

    def to_dict(self, dx: object = 1) -> dict[str, Any]:
        """convention -> {"exact", "value", "says", "who"}, lengths in the unit of `dx`.

        "exact" is None for the root of a polynomial without a closed form; both are None where the
        kernel has no such number (a top-hat has no half maximum).
        """
        scale = rational(dx, "dx")
        if scale <= 0:
            raise ValueError(f"dx: got {scale}, expected a positive particle spacing")
        rows = {}
        for name, data in CONVENTIONS.items():
            exact, value = None, None
            with suppress(ValueError):
                number = self[name] * (scale if data.length else 1)
                exact, value = _written(number), float(number.evalf(17))
            rows[name] = {"exact": exact, "value": value, "says": data.says, "who": data.who}
        return rows

    def to_text(self, dx: object = 1) -> str:
        """A table: convention, value, exact value where it is short, meaning."""
        unit = "Δx" if rational(dx, "dx") == 1 else "the unit of Δx"
        lines = [f"{self.kernel.name} in {self.dim}D; lengths in {unit}"]
        for name, row in self.to_dict(dx).items():
            exact = row["exact"] or ""
            shown = f"= {exact}" if exact and len(exact) <= 22 else ""
            value = "none" if row["value"] is None else f"{row['value']:.9g}"
            lines.append(f"  {name:<11} {value:>14}  {shown:<24}  {row['says']}")
        return "\n".join(lines)


def convert(kernel: Kernel | str, dim: int = 1, **given: object) -> Resolution:
    """The resolution that one convention says, to be read in every other.

    given: a name of CONVENTIONS (with _ for -) = an exact number such as "1.2", "5/6" or 57;
        lengths in units of Δx, except that `dx=…` beside them gives Δx in the same unit

    >>> convert("cubic-spline", 3, neighbours=57)["hdx"].evalf(6)
    1.19371

    Raises ValueError for anything else, for a value that is not positive, and for a kernel whose
    second moment is not positive where 2σ is asked for.
    """
    kernel = parse_kernel(kernel)
    dim = dimension(dim)
    dx = rational(given.pop("dx", 1), "dx")
    if dx <= 0:
        raise ValueError(f"dx: got {dx}, expected a positive particle spacing")
    named = {name.replace("_", "-"): value for name, value in given.items()}
    if len(named) != 1:
        raise ValueError(
            f"convert: got {len(named)} quantities, expected one of {', '.join(CONVENTIONS)}"
        )
    ((name, value),) = named.items()
    if name not in CONVENTIONS:
        raise ValueError(f"convert: got {name!r}, expected one of {', '.join(CONVENTIONS)}")
    exact = rational(value, name)
    if exact <= 0:
        raise ValueError(f"{name}: got {exact}, expected a positive number")
    if CONVENTIONS[name].length:
        exact = exact / dx
    factor, power = _law(kernel, dim, name)
    ratio = exact / factor
    return Resolution(kernel, dim, radsimp(1 / ratio if power == -1 else root(ratio, power)))


def _law(kernel: Kernel, dim: int, name: str) -> tuple[Expr, int]:
    """(c, p): the convention's number is c (h/Δx)^p."""
    laws: Mapping[str, Any] = {
        "h": lambda: (Rational(1), 1),
        "support": lambda: (kernel.support, 1),
        "two-sigma": lambda: (two_sigma(kernel, dim), 1),
        "fwhm": lambda: (fwhm(kernel), 1),
        "dx-over-h": lambda: (Rational(1), -1),
        "hdx": lambda: (Rational(1), 1),
        "hfact": lambda: (Rational(1), 1),
        "coefh": lambda: (1 / sqrt(dim), 1),
        "eta": lambda: (two_sigma(kernel, dim), 1),
        "neighbours": lambda: (BALL[dim] * kernel.support**dim, dim),
    }
    if name not in laws:
        raise ValueError(f"convention: got {name!r}, expected one of {', '.join(laws)}")
    factor, power = laws[name]()
    return factor, power


def two_sigma(kernel: Kernel, dim: int) -> Expr:
    """2σ/h with σ² = R_2/d, the variance of the kernel along an axis (Dehnen & Aly 2012, eq. 8).

    Raises ValueError where R_2 is not positive.
    """
    second = kernel.moment(2, dim)
    if second <= 0:
        raise ValueError(
            f"kernel {kernel.name!r}: its second moment in {dim}D is {second}, so it has no"
            " standard deviation; expected a kernel with a positive one"
        )
    return 2 * sqrt(second / dim)


def fwhm(kernel: Kernel) -> Expr:
    """Full width at half maximum over h: twice the least q with w(q) = w(0)/2, exactly.

    Raises ValueError where the kernel does not reach half of w(0) continuously.
    """
    if not kernel.pieces and kernel.support > sqrt(log(2)):  # a Gaussian, exp(−q²)
        return 2 * sqrt(log(2))
    for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.pieces, strict=False):
        level = Poly(piece - kernel.central() / 2, q, domain=QQ)
        if level.is_zero:
            break
        for found in level.real_roots():
            if a <= found <= b:
                return 2 * (found if found.is_Rational else _closed(level, found))
    raise ValueError(
        f"kernel {kernel.name!r}: it does not pass through half of its central value"
        " continuously, so it has no full width at half maximum"
    )


def lengths(kernel: Kernel, dim: int) -> dict[str, Expr]:
    """What codes call h, in units of the h here: those that the kernel has, as exact numbers.

    Without the widths at half maximum, which are roots of polynomials: see `half_width`.
    """
    found: dict[str, Expr] = {"h": Rational(1), "support": kernel.support}
    with suppress(ValueError):
        sigma = two_sigma(kernel, dim) / 2
        found |= {"two-sigma": 2 * sigma, "sigma": sigma}
    return found


@lru_cache(maxsize=256)
def half_width(kernel: Kernel, digits: int = 50) -> Any:
    """Half the full width at half maximum over h as an mpmath number; 0 where there is none."""
    if not kernel.pieces:
        with mpmath.workdps(digits):
            return mpmath.sqrt(mpmath.log(2)) if kernel.support > sqrt(log(2)) else mpmath.mpf(0)
    with mpmath.workdps(digits + 10):
        pieces = [[mpmath.mpf(c.p) / c.q for c in p.all_coeffs()] for p in kernel.pieces]
        level = pieces[0][-1] / 2
        if not level > 0:
            return mpmath.mpf(0)
        knots = [mpmath.mpf(k.p) / k.q for k in kernel.knots]
        ends = [mpmath.polyval(p, k) for p, k in zip(pieces, knots[1:], strict=True)]
        here = next((i for i, end in enumerate(ends) if end <= level), None)
        if here is None or mpmath.polyval(pieces[here], knots[here]) <= level:
            return mpmath.mpf(0)  # it jumps over the half, at its edge or before
        piece, low, high = pieces[here], knots[here], knots[here + 1]
        for _ in range(48):
            middle = (low + high) / 2
            above = mpmath.polyval(piece, middle) > level
            low, high = (middle, high) if above else (low, middle)
        root = (low + high) / 2
        for _ in range(3):  # Newton's digits double: 14, 28, 56, 112
            value, slope = mpmath.polyval(piece, root, derivative=True)
            root -= (value - level) / slope
        return +root


def _closed(level: Poly, found: Expr) -> Expr:
    """The root in square roots where its factor is quadratic, else as the algebraic number."""
    for factor, _ in level.factor_list()[1]:
        if factor.degree() == 2:
            for candidate in factor.all_roots():
                if candidate == found:
                    return candidate
    return found


def _written(value: Expr) -> str | None:
    """The exact value as text; None where it is the root of a polynomial without a closed form."""
    text = str(value)
    return None if "CRootOf" in text else text
