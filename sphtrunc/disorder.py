"""Disorder: predicted mean and spread of discrete moments when particles are displaced at random.

Every particle of a lattice moves by u, independent, of standard deviation σ along each axis (in Δx
here), the target too unless it sits at an offset. Four levels, from the formula to the particles:

- the leading law for Δx/h → 0, std(M) = (σ/Δx) (Δx/h)^{1+d/2} ‖∇g‖₂, where g is the function that
  the particles sample; ‖∇g‖₂ is exact for piecewise polynomials;
- for Gaussian displacements of any size and constant volumes, mean and variance in closed form:
  every term of the reciprocal sum is damped by the Debye–Waller factor (Debye 1913,
  doi:10.1002/andp.19133480105), and V ∫ |ĝ|² (1 − e^{−σ²k²}) d^d k/(2π)^d is the variance;
- propagation through the lattice, Var = σ² Σ_b |∂M/∂x_b|², for any operator, correction and rule
  for the volumes, by carrying ∂/∂x_b with every number; to order σ⁴ where there are few neighbours
  and none is near a knot where the kernel is too rough for that (of the nested form always the
  mean, see `sphtrunc.curvature`);
- for independent displacements and constant volumes, averages over the displacements of every
  particle, of any size (`sphtrunc.response`), to first order in the algebra of a correction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

from sphtrunc.curvature import mean_shift
from sphtrunc.kernel import SPHERE, Kernel, dimension, rational
from sphtrunc.lattice import in_pairs
from sphtrunc.lattice_sums import Laurent, angular, lattice_moments, laurent, parts
from sphtrunc.moments import MultiIndex, unit
from sphtrunc.operators import NESTED, Key, Operator
from sphtrunc.propagation import is_smooth, mixing, propagate, second_order
from sphtrunc.response import scattered_moments
from sphtrunc.second_neighbours import SecondNeighbours
from sphtrunc.signals import Taylor
from sphtrunc.stencil import Stencil, radial_values

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from sympy import Expr

    from sphtrunc.derivation import Derivation
    from sphtrunc.gaussian import Gaussian

    Array = NDArray[np.float64]

SECOND_ORDER = 240  # displacements, up to which second derivatives are taken; a sixth where every
# neighbour has a correction of its own
LARGE = 0.1  # σ/Δx from which the closed form, where there is one, is better than two orders in σ

Row = tuple[Any, MultiIndex, str]  # (c, β, f): c s^β f(q), see `sphtrunc.lattice_sums`


@dataclass(frozen=True)
class Prediction:
    """Predicted moments of an estimate over the targets of a disordered scene.

    mean, std: multi-index -> float
    how: the level of theory behind them, in a few words
    """

    mean: Mapping[MultiIndex, float]
    std: Mapping[MultiIndex, float]
    how: str


def predict(
    kernel: Kernel | Gaussian,
    operator: Operator,
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    *,
    sigma: float = 0.0,
    distribution: str = "gaussian",
    volume: str = "constant",
    degree: int = 3,
    axis: int = 0,
) -> Prediction:
    """Mean and standard deviation of the moments M_α, |α| <= degree, of one component.

    kind, dx_over_h, offset: the lattice, and where it lies relative to the target, in Δx
    sigma: σ/Δx along each axis; distribution: "gaussian", "uniform" or "blue"
    volume: "constant", "cell" (1D) or "summation"

    Raises ValueError for a correction whose matrix is singular on this lattice.
    """
    operator.require_pairs(not sigma and in_pairs(kind, offset))
    dim = len(offset)
    values = lattice_moments(
        kernel, operator, kind, dx_over_h, offset, degree, axis=axis, exact=False, volume=volume
    )
    mean = {alpha: float(m) for alpha, m in values.items()}
    if sigma == 0:
        return Prediction(mean, dict.fromkeys(mean, 0.0), "lattice sum")
    arguments = (kernel, operator, kind, dx_over_h, offset, volume, degree, axis)
    slopes, index = propagate(*arguments)
    mixed = mixing(kind, index, distribution)
    by_source = {a: row if mixed is None else mixed.T @ row for a, row in slopes.items()}
    variance = {a: sigma**2 * float((row * row).sum()) for a, row in by_source.items()}
    how = "first-order propagation through the lattice"
    # what is zero by a mirror symmetry of the lattice stays so, and so does what a form has exactly
    moving = [a for a, m in values.items() if m != 0 or any(offset)]
    if operator.uses_difference:
        moving = [a for a in moving if any(a)]
    size = (index.shape[1], dim)
    s = Stencil(kernel, kind, dx_over_h, offset, "constant").s
    smooth = is_smooth(kernel, operator, s, sigma * float(dx_over_h))
    nested = operator.form == NESTED
    independent = volume == "constant" and distribution != "blue" and not nested
    most = SECOND_ORDER // 6 if nested and operator.correction != "none" else SECOND_ORDER
    if size[0] * dim <= most and smooth and not (independent and sigma > LARGE):
        how = "second-order propagation through the lattice"
        excess = -1.2 if distribution == "uniform" else 0.0
        second = second_order(lambda at: propagate(*arguments, at)[0], size, mixed, excess)
        variance = {a: max(v + sigma**4 * second[a][1], 0.0) for a, v in variance.items()}
        mean |= {a: mean[a] + sigma**2 * second[a][0] for a in moving}
    elif independent:
        alphas = [a for a in variance if any(a) or not operator.uses_difference]
        found = scattered_moments(
            kernel, operator, kind, dx_over_h, offset, alphas, sigma, distribution, axis
        )
        if found is not None:
            how = "displacements of any size, particle by particle"
            variance |= {a: v for a, (_, v) in found.items()}
            mean |= {a: found[a][0] for a in moving}
    elif nested and distribution != "blue":
        seen = SecondNeighbours(kernel, operator, kind, dx_over_h, offset, volume)
        shift = mean_shift(kernel, seen, Taylor([{a: 1.0} for a in moving]), sigma)
        if shift is not None:
            how += "; its mean to second order"
            mean |= {a: mean[a] + float(x) for a, x in zip(moving, shift[:, axis, 0], strict=True)}
    elif not smooth:
        how += "; rough, as particles lie near knots where the kernel is not smooth"
    if operator.uncorrected and independent and distribution == "gaussian":
        part = operator.coefficients({}, dim)[axis]
        for alpha in moving:
            rows = moment_rows(part, alpha)
            damped = gaussian_shift(kernel, rows, kind, dx_over_h, offset, sigma)
            mean[alpha] = float(values[alpha]) + _copies(operator, alpha) * damped
        if how.startswith("first"):
            how = "closed form for Gaussian displacements"
            for alpha in variance:
                rows = moment_rows(part, alpha)
                variance[alpha] *= finite_ratio(kernel, rows, float(dx_over_h) * sigma, dim) ** 2
    return Prediction(mean, {a: v**0.5 for a, v in variance.items()}, how)


def _copies(operator: Operator, alpha: MultiIndex) -> int:
    """The symmetric form of equal densities has A_b + A_a: its M_0 is twice that of A_b alone."""
    return 2 if operator.form == "symmetric" and not any(alpha) else 1


def moment_rows(part: Mapping[Key, Any], alpha: MultiIndex) -> list[Row]:
    """The function that a moment samples, M_α = V Σ_b g(s_b), as rows c s^β f(q)."""
    return [
        (c * sign, beta, name)
        for (term, gamma), c in part.items()
        for sign, beta, name in parts(
            (term, tuple(a + g for a, g in zip(alpha, gamma, strict=True)))
        )
    ]


# ----------------------------------------------------------------------------------- leading law


def leading_coefficient(
    kernel: Kernel, operator: Operator, alpha: MultiIndex, axis: int = 0
) -> Expr:
    """‖∇g_α‖₂² exactly; std(M_α) = (σ/Δx) (Δx/h)^{1+d/2} ‖∇g_α‖₂ to leading order in σ and Δx/h.

    For operators without correction and constant volumes. oo where g jumps: its spread then falls
    more slowly with σ than linearly.

    Raises ValueError for a corrected operator.
    """
    if not operator.uncorrected:
        raise ValueError(
            f"correction: the leading law is that of uncorrected weights, got"
            f" {operator.correction}; expected none, or `predict`, which propagates"
        )
    dim = dimension(len(alpha))
    part = operator.coefficients({}, dim)[axis]
    if operator.uses_difference and not any(alpha):
        from sympy import Integer

        return Integer(0)
    return _copies(operator, alpha) ** 2 * gradient_norm(kernel, tuple(moment_rows(part, alpha)))


@lru_cache(maxsize=512)
def gradient_norm(kernel: Kernel, rows: tuple[Row, ...]) -> Expr:
    """∫ |∇g|² d^d s for g = Σ c s^β f(q), exactly: a rational times a power of π, and logarithms
    only where a Laurent polynomial leaves a 1/q."""
    from sympy import Rational, log, oo

    dim = len(rows[0][1])
    if _jumps(kernel, rows):
        return oo
    integrand: list[Laurent] = [{} for _ in kernel.pieces]
    for (c, beta, f), (d, gamma, g) in product(rows, rows):
        total = tuple(a + b for a, b in zip(beta, gamma, strict=True))
        size, other = sum(beta), sum(gamma)
        first = sum(
            (
                a * b * angular(_less(total, i))
                for i, (a, b) in enumerate(zip(beta, gamma, strict=True))
                if a and b
            ),
            Fraction(0),
        )
        rest = angular(total)
        for piece, pf, pg in zip(integrand, laurent(kernel, f), laurent(kernel, g), strict=True):
            for (i, x), (j, y) in product(pf.items(), pg.items()):
                # f = q^i: f′/q = i q^{i−2}
                factor = first + rest * (size * j + other * i + i * j)
                power = i + j + size + other - 2 + dim - 1
                piece[power] = piece.get(power, Fraction(0)) + c * d * x * y * factor
    value = Rational(0)
    knots = kernel.knots
    for a, b, piece in zip(knots, knots[1:], integrand, strict=False):
        for power, c in piece.items():
            if not c:
                continue
            exact = Rational(c.numerator, c.denominator)
            if power >= 0 or (power < -1 and a):
                value += exact * (b ** (power + 1) - a ** (power + 1)) / (power + 1)
            elif power == -1 and a:
                value += exact * log(b / a)
            else:
                return oo
    return value * SPHERE[dim] * kernel.normalisation(dim) ** 2


def _less(total: MultiIndex, axis: int) -> MultiIndex:
    return tuple(n - 2 * (i == axis) for i, n in enumerate(total))


def _jumps(kernel: Kernel, rows: Sequence[Row]) -> bool:
    """Whether g is discontinuous at a knot (in 1D also at the origin)."""
    from sympy import Rational

    for n, knot in enumerate(kernel.knots):
        at = Fraction(int(knot.p), int(knot.q))
        by_beta: dict[MultiIndex, Fraction] = {}
        for c, beta, name in rows:
            pieces = [{}, *laurent(kernel, name), {}]
            left, right = pieces[n], pieces[n + 1]
            if at:
                step = sum((x * at**i for i, x in right.items()), Fraction(0)) - sum(
                    (x * at**i for i, x in left.items()), Fraction(0)
                )
            elif len(beta) == 1 and sum(beta) % 2:
                step = right.get(-sum(beta), Fraction(0))
            else:
                step = Fraction(0)
            value = Fraction(c) if not isinstance(c, Rational) else Fraction(int(c.p), int(c.q))
            key = beta if len(beta) > 1 else (0,)
            weight = at ** sum(beta) if len(beta) == 1 and at else 1
            by_beta[key] = by_beta.get(key, Fraction(0)) + value * step * weight
        if any(by_beta.values()):
            return True
    return False


# ------------------------------------------------------------------------ finite Gaussian disorder


def finite_ratio(kernel: Kernel | Gaussian, rows: Sequence[Row], sigma: float, dim: int) -> float:
    """√[∫|ĝ|²(1 − e^{−σ²k²}) / ∫|ĝ|² σ²k²], how far the spread stays behind the leading law;
    σ in units of h. 1 where the law does not apply (its integral diverges) or no closed form of the
    function is at hand."""
    import numpy as np

    x, weight = _correlation(kernel, tuple(rows), dim)
    if x is None:
        return 1.0
    k2 = x * x
    full = float((weight * -np.expm1(-(sigma**2) * k2)).sum())
    first = float((weight * sigma**2 * k2).sum())
    return float(np.sqrt(full / first)) if first > 0 else 1.0


@lru_cache(maxsize=256)
def _correlation(
    kernel: Kernel | Gaussian, rows: tuple[Row, ...], dim: int
) -> tuple[Array | None, Array]:
    """Nodes k and weights of ∫ |ĝ(k)|² d^d k, averaged over a set of directions."""
    import numpy as np

    from sphtrunc.spectrum import radial

    if getattr(kernel, "smoothness", 0) < 1:
        return None, np.zeros(0)
    table = _symbol(rows)
    if table is None:
        return None, np.zeros(0)
    reach = 160.0 / min(float(kernel.support), 3.0)
    t, w = np.polynomial.legendre.leggauss(24)
    edges = np.linspace(0.0, reach, 33)
    half = np.diff(edges) / 2
    k = (edges[:-1, None] + half[:, None] * (1 + t)).ravel()
    weight = (half[:, None] * w).ravel() * k ** (dim - 1)
    powers: dict[int, Any] = {m: radial(kernel, k, dim, m) for m in {m for _, m in table}}
    total = np.zeros_like(k)
    for ((gamma, m), c), ((delta, n), e) in product(table.items(), table.items()):
        both = tuple(a + b for a, b in zip(gamma, delta, strict=True))
        angle = float(angular(both))
        if angle:
            factor = (c * np.conj(e)).real * angle
            total += factor * k ** sum(both) * powers[m] * powers[n]
    return k, weight * total


def _symbol(rows: Sequence[Row]) -> dict[tuple[MultiIndex, int], complex] | None:
    """ĝ for terms made of Ŵ and its gradient; None for others."""
    from sphtrunc.poisson import symbol

    result: dict[tuple[MultiIndex, int], complex] = {}
    for c, beta, name in rows:
        dim = len(beta)
        if name == "w":
            key = (unit(dim, 0, 0), beta)
        elif name == "w1" and any(beta):
            axis = next(i for i, n in enumerate(beta) if n)
            lower = tuple(n - (i == axis) for i, n in enumerate(beta))
            key, c = (unit(dim, axis), lower), -c
        else:
            return None
        for entry, value in symbol(*key).items():
            result[entry] = result.get(entry, 0) + complex(c) * value
    return result


def gaussian_shift(
    kernel: Kernel | Gaussian,
    rows: Sequence[Row],
    kind: str,
    dx_over_h: Fraction,
    offset: Sequence[Fraction],
    sigma: float,
) -> float:
    """What Gaussian displacements add to the mean of a moment: the reciprocal terms, damped by
    e^{−σ²G²} (e^{−σ²G²/2} at a target that does not move), less undamped; and the particle at the
    target, which does not move relative to it, taken out of the damping."""
    import numpy as np

    from sphtrunc.poisson import shells_of

    table = _symbol(rows)
    dim = len(offset)
    if table is None or getattr(kernel, "smoothness", 0) < 1:
        return 0.0
    moving = not any(offset)
    spread = sigma * float(dx_over_h) * (2.0**0.5 if moving else 1.0)
    lengths, values, _ = shells_of(kernel, table, kind, dx_over_h, offset, 60)
    shift = float((values * np.expm1(-0.5 * (spread * lengths) ** 2)).sum())
    if moving:
        own = float(dx_over_h) ** dim
        shift -= own * (
            _smeared(kernel, tuple(rows), dim, spread) - _smeared(kernel, tuple(rows), dim, 0.0)
        )
    return shift


def _smeared(kernel: Kernel | Gaussian, rows: tuple[Row, ...], dim: int, spread: float) -> float:
    """The mean of g over a Gaussian of that width around the origin."""
    import numpy as np

    rows = tuple(row for row in rows if not any(n % 2 for n in row[1]))
    if not rows:
        return 0.0
    if spread == 0:
        return float(
            sum(c * kernel.w(0.0, dim) for c, beta, name in rows if name == "w" and not any(beta))
        )
    t, w = np.polynomial.legendre.leggauss(40)
    inner = (float(k) for k in kernel.knots if 0 < k < 9 * spread)
    cuts = sorted({0.0, 9.0 * spread, *inner})
    total = 0.0
    for a, b in pairwise(cuts):
        q = a + (b - a) / 2 * (1 + t)
        weight = (b - a) / 2 * w * q ** (dim - 1) * np.exp(-0.5 * (q / spread) ** 2)
        weight *= float(SPHERE[dim]) / (2 * np.pi * spread**2) ** (dim / 2)
        for c, beta, name in rows:
            f = radial_values(kernel, name, q, dim)
            total += float(c) * float(angular(beta)) * float((weight * q ** sum(beta) * f).sum())
    return total


def scattered(derivation: Derivation, jitter: object, distribution: str = "gaussian") -> Derivation:
    """The derivation with `scatter`: mean and spread of its moments when the particles of its
    lattice are displaced by σ/Δx = jitter along each axis.

    Raises ValueError where the derivation has no ratio Δx/h, and for a jitter that is not between 0
    and 10.
    """
    from sphtrunc.derivation import Scatter

    sigma = float(rational(jitter if isinstance(jitter, str) else Fraction(str(jitter)), "jitter"))
    if not 0 <= sigma <= 10:
        raise ValueError(f"jitter: got {sigma:g}, expected a standard deviation σ/Δx from 0 to 10")
    if derivation.dx_over_h is None or not derivation.dx_over_h.is_Rational:
        raise ValueError("jitter: needs a rational ratio, expected dx-over-h as well")
    ratio = derivation.dx_over_h
    found = predict(
        derivation.kernel,
        derivation.operator,
        derivation.lattice,
        Fraction(int(ratio.p), int(ratio.q)),
        tuple(Fraction(int(x.p), int(x.q)) for x in derivation.shift),
        sigma=sigma,
        distribution=distribution,
        volume=derivation.volume,
        degree=min(derivation.degree, 6),
    )
    return replace(
        derivation, scatter=Scatter(sigma, distribution, found.mean, found.std, found.how)
    )
