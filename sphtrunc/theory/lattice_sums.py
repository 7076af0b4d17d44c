"""Base sums of a kernel over a lattice, point by point: exact rationals where the lattice and the
kernel allow it, numbers of 50 digits elsewhere.

Every term that particles sum is a polynomial in s times a radial function of q = |s|,

    ∂ᵢŴ = sᵢ w₁,   ∂ᵢ∂ⱼŴ = δᵢⱼ w₁ + sᵢ sⱼ w₂,   w₁ = Ŵ′/q,   w₂ = w₁′/q,   w₃ = Ŵ′/q³,

and on each piece of a kernel these are Laurent polynomials in q. Points at equal distance share the
radial value; what is left, Σ s^β over a shell, is a sum of integers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache, lru_cache
from math import lcm, prod
from typing import TYPE_CHECKING, Any

from sympy import Expr, Float, Rational

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.factors import laurent
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import SLOPE, VALUE, Key, parts
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS, metric, sites, units

if TYPE_CHECKING:
    import numpy as np

    from sphtrunc.kernels.gaussian import Gaussian

Planes = tuple[int | None, int | None]  # from an index along the first axis to another

DIGITS = 50
_FINE = 192  # bits of a coordinate that is not rational


@cache
def real_context() -> Any:
    """An mpmath context of DIGITS digits, apart from the one that everybody shares."""
    from mpmath import mp

    context = mp.clone()
    context.dps = DIGITS
    return context


def rounded(m: Any, decimals: int = 40) -> Expr:
    """A 50-digit number to so many decimals, and ten digits fewer."""
    scale = 10**decimals
    return Float(Rational(int(m.context.nint(m * scale)), scale), decimals - 10)


def lattice_sums(
    kernel: Kernel | Gaussian,
    keys: Iterable[Key],
    scene: Arrangement,
    exact: bool = True,
    turned: bool | None = None,
    planes: Planes | None = None,
) -> dict[Key, Any]:
    """m[δ, α] = (−1)^{|δ|} Σ_b V_b s_b^α ∂^δ Ŵ(s_b) for every key, over one stencil without
    displacements; V_b = (Δx/h)^d, or of volumes by summation 1/Σ Ŵ.

    turned: only over the sites of the second sublattice (`Kind.turned`), or of the first; None:
        over all of them
    planes: only over the sites from one index along the first axis to another; None: no end

    A sum is an exact SymPy number where all coordinates are rational and only
    rational radial values occur (always in 1D; for kernels even in q on square and cubic lattices)
    and `exact` is asked for, else a 50-digit number of `real_context`. Sums that vanish by a mirror
    symmetry are exact zeros and are not summed. A particle at the origin takes part in terms
    without a direction: Ŵ(0), and the second derivative of a kernel that is smooth there.

    Raises ValueError for a kernel that has no second derivative at a particle at the origin.
    """
    keys = list(keys)
    dim = scene.dim
    if scene.volume == "summation":
        zero = ((0,) * dim,) * 2
        plain = replace(scene, volume="constant")
        density = lattice_sums(kernel, [zero], plain.seen_from(), exact)[zero]
        sums = lattice_sums(kernel, keys, plain, exact, turned)
        return {key: value / density for key, value in sums.items()}
    shells = _shells(scene, fraction(kernel.support), turned, planes)
    rational = shells.rational and exact and isinstance(kernel, Kernel)
    factors = {k for key in keys for _, _, k in parts(key)}
    radial, rational = radial_values(kernel, factors, shells.squares, rational, dim)
    ctx = real_context()
    sigma = kernel.normalisation(dim)
    scale: Any = sigma
    if not rational:
        scale = ctx.mpf(str(sigma.evalf(DIGITS + 10)))
    dx_over_h = scene.dx_over_h
    cell = dx_over_h**dim

    @cache
    def total(beta: MultiIndex, k: int) -> Any:
        counts = shells.moments(beta)
        if counts is None:
            return 0
        values = radial[k]
        steps = prod((shells.step[i] * dx_over_h) ** n for i, n in enumerate(beta)) * cell
        if rational:
            return Fraction(steps) * sum(
                (Fraction(n) * v for n, v in zip(counts, values, strict=True) if n), Fraction(0)
            )
        return (
            ctx.fdot((n, v) for n, v in zip(counts, values, strict=True) if n)
            * ctx.mpf(steps.numerator)
            / steps.denominator
        )

    result: dict[Key, Any] = {}
    for key in keys:
        value = sum(c * total(beta, k) for c, beta, k in parts(key))
        value = value + _at_origin(kernel, key, shells.at_origin, cell, rational)
        if isinstance(value, Fraction):
            value = Rational(value.numerator, value.denominator)
        result[key] = value * scale if value != 0 else Rational(0)
    return result


class _Shells:
    """A stencil without the particle at the origin, by distance.

    squares: exact q² of every shell; step: unit of the integer coordinates along each axis, in Δx;
    rational: whether the coordinates are what they say (else they are rounded to _FINE bits).
    """

    def __init__(
        self,
        scene: Arrangement,
        support: Fraction,
        turned: bool | None,
        planes: Planes | None,
    ) -> None:
        import numpy as np

        kind, ratio, offset = scene.kind, scene.dx_over_h, scene.offset
        m = sites(kind, float(support / ratio), offset)
        rule = KINDS[kind].turned
        if rule is not None and turned is not None:
            m = m[:, rule(m) == turned]
        if planes is not None:
            first, last = planes
            m = m[:, (m[0] >= (m[0] if first is None else first))
                  & (m[0] <= (m[0] if last is None else last))]  # fmt: skip
        unit_lengths = units(kind)
        roots = KINDS[kind].units
        self.rational = all(n == 1 for _, _, n in roots)
        dim = len(roots)
        x: np.ndarray[Any, Any]
        if self.rational or not any(offset):
            bottom = lcm(*((o / u).denominator for o, u in zip(offset, unit_lengths, strict=True)))
            shift = [int(o / u * bottom) for o, u in zip(offset, unit_lengths, strict=True)]
            x = m * bottom + np.array(shift, dtype=np.int64)[:, None]
            self.step = tuple(u / bottom for u in unit_lengths)
            weight = metric(roots)
        else:
            self.step = (Fraction(1, 1 << _FINE),) * dim
            x = np.array(
                [
                    [round((int(k) * u + o) * (1 << _FINE)) for k in row]
                    for row, u, o in zip(m, unit_lengths, offset, strict=True)
                ],
                dtype=object,
            )
            weight = (1,) * dim
        length = sum(w * row * row for w, row in zip(weight, x, strict=True))
        scale = (self.step[0] * ratio) ** 2 / weight[0]
        self.at_origin = bool(np.any(length == 0))
        order = np.argsort(length, kind="stable")
        order = order[[length[i] > 0 and length[i] * scale <= support**2 for i in order]]
        self.x = x[:, order]
        sorted_lengths = [int(v) for v in length[order]]
        starts = [i for i, v in enumerate(sorted_lengths) if i == 0 or v != sorted_lengths[i - 1]]
        self.starts = np.array(starts, dtype=np.intp)
        self.squares = tuple(sorted_lengths[i] * scale for i in starts)
        # no axis is special
        self.alike = planes is None and len(set(roots)) == 1 and len(set(offset)) == 1
        points = {tuple(int(v) for v in p) for p in self.x.T}
        self.mirrors = tuple(
            all(tuple(-v if j == i else v for j, v in enumerate(p)) in points for p in points)
            for i in range(dim)
        )
        self._cache: dict[MultiIndex, list[int] | None] = {}

    def moments(self, beta: MultiIndex) -> list[int] | None:
        """Σ x^β over each shell, as integers; None where a mirror makes all of them zero."""
        import numpy as np

        if any(n % 2 and mirror for n, mirror in zip(beta, self.mirrors, strict=True)):
            return None
        key = tuple(sorted(beta)) if self.alike else beta
        if key not in self._cache:
            if not self.squares:
                self._cache[key] = []
                return self._cache[key]
            largest = max(1, int(max(abs(v) for v in self.x.ravel())))
            fits = largest ** sum(key) * self.x.shape[1] < 2**62
            x = self.x if fits else self.x.astype(object)
            product: Any = np.ones(x.shape[1], dtype=x.dtype)
            for row, n in zip(x, key, strict=True):
                for _ in range(n):
                    product = product * row
            self._cache[key] = [int(v) for v in np.add.reduceat(product, self.starts)]
        return self._cache[key]


def _shells(
    scene: Arrangement,
    support: Fraction,
    turned: bool | None = None,
    planes: Planes | None = None,
) -> _Shells:
    """The same whatever the volumes and displacements are."""
    sites_of = Arrangement(scene.kind, scene.dx_over_h, scene.offset)
    return _found(sites_of, support, turned, planes)


_found = lru_cache(maxsize=64)(_Shells)


def lattice_moments(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    degree: int,
    *,
    axis: int = 0,
    exact: bool = True,
) -> dict[MultiIndex, Any]:
    """The moments M_α, |α| <= degree, of one component of an operator on a lattice.

    Arguments and numbers as of `lattice_sums`; of the nested form the moments are products of sums.

    Raises ValueError as that does, where no particle is inside the support, and where the matrix of
    a correction is singular.
    """
    dim = scene.dim
    keys = operator.needed(dim, degree)
    sums = lattice_sums(kernel, keys, scene, exact)
    support = fraction(kernel.support)
    near = _shells(scene, support).squares
    if not any(sums.values()) and all(square >= support**2 for square in near):
        raise ValueError(
            f"dx-over-h: got {scene.dx_over_h}, and no particle is inside the support of"
            f" {kernel.support}h; expected a smaller ratio (did you mean h/Δx?)"
        )
    around = None
    if operator.form == NESTED:
        seen = lattice_sums(kernel, keys, scene.seen_from(), exact)
        if KINDS[scene.kind].turned is None:
            around = [(sums, seen)]
        else:
            part = [lattice_sums(kernel, keys, scene, exact, turned) for turned in (False, True)]
            about = {
                (delta, alpha): (-1) ** (sum(delta) + sum(alpha)) * value
                for (delta, alpha), value in seen.items()
            }
            around = [(part[0], seen), (part[1], about)]
    return operator.correct(sums, dim, degree, axis, around=around)


def radial_values(
    kernel: Kernel | Gaussian,
    factors: Iterable[int],
    squares: Sequence[Fraction],
    exact: bool,
    dim: int,
) -> tuple[dict[int, list[Any]], bool]:
    """f_k(q) on every shell, without σ_d: rationals where they are asked for and all are, which is
    told; else numbers of 50 digits."""
    found = {k: _radial(kernel, k, squares, exact, dim) for k in factors}
    values = {k: row for k, row in found.items() if row is not None}
    if len(values) < len(found):
        return radial_values(kernel, found, squares, False, dim)
    return values, exact


def _radial(
    kernel: Kernel | Gaussian, k: int, squares: Sequence[Fraction], rational: bool, dim: int
) -> list[Any] | None:
    """f(q) on every shell, without σ_d; None where rational ones are wanted and there are none.

    At a knot the mean of both sides.
    """
    ctx = real_context()
    if not isinstance(kernel, Kernel):
        return [kernel.radial_mp(ctx, k, ctx.sqrt(ctx.mpf(s.numerator) / s.denominator), dim)
                for s in squares]  # fmt: skip
    knots = [fraction(k) for k in kernel.knots]
    pieces = [*laurent(kernel, k), {}]
    result: list[Any] = []
    for square in squares:
        i = sum(square > k**2 for k in knots[1:])
        sides = [pieces[i]]
        if i < len(knots) - 1 and square == knots[i + 1] ** 2:
            sides.append(pieces[i + 1])
        total: Any = Fraction(0) if rational else ctx.zero
        root: Any = None
        for piece in sides:
            for j, c in piece.items():
                if j % 2 and root is None:
                    root = _exact_root(square) if rational else None
                    if rational and root is None:
                        return None
                if rational:
                    total += c * square ** ((j - j % 2) // 2) * (root if j % 2 else 1)
        if not rational:
            q = ctx.sqrt(ctx.mpf(square.numerator) / square.denominator)
            for piece in sides:
                if piece:
                    low = min(piece)
                    value = ctx.zero
                    for j in range(max(piece), low - 1, -1):
                        c = piece.get(j, Fraction(0))
                        value = value * q + ctx.mpf(c.numerator) / c.denominator
                    total += value * q**low
        result.append(total / len(sides))
    return result


def _exact_root(square: Fraction) -> Fraction | None:
    from math import isqrt

    top, bottom = isqrt(square.numerator), isqrt(square.denominator)
    if top * top == square.numerator and bottom * bottom == square.denominator:
        return Fraction(top, bottom)
    return None


def _at_origin(
    kernel: Kernel | Gaussian, key: Key, there: bool, volume: Fraction, rational: bool
) -> Any:
    """What the particle at s = 0 adds: Ŵ(0), or ∂ᵢ²Ŵ(0) = w₁(0) where that exists."""
    term, alpha = key
    if not there or any(alpha) or isinstance(term, str) or any(n % 2 for n in term):
        return 0
    ctx = real_context()
    second = sum(term) == 2
    if isinstance(kernel, Kernel):
        piece = laurent(kernel, SLOPE if second else VALUE)[0]
        if second and len(alpha) > 1 and min(piece, default=0) < 0:
            raise ValueError(
                f"kernel {kernel.name!r} has no second derivative at q = 0, where a particle lies;"
                " expected a form of differences, brookshaw or fatehi-manzari, or an offset"
            )
        value: Any = piece.get(0, Fraction(0)) * volume
        return value if rational else ctx.mpf(value.numerator) / value.denominator
    value = kernel.radial_mp(ctx, SLOPE if second else VALUE, ctx.zero, len(alpha))
    return value * volume.numerator / volume.denominator
