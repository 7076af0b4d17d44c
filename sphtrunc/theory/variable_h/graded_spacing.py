"""1D particles whose spacing varies slowly: Euler–Maclaurin along the numbers of the particles.

With x(ξ), dx/dξ = δ(x), particles at whole ξ + θ and volumes half-way to both neighbours,
V = δ (1 + (δ′² + δδ″)/6 + …), the sum over particles is a sum over ξ of equal steps:

    Σ V f = ∫ f (1 + (δ′² + δδ″)/6) dx + Σ_p Σ_n c δ(p)^n B̃_n(ξ_p − θ),        ξ_p = ∫₀^p dx/δ,

the knot terms of uniform spacing, each with the spacing and the phase that there are at its knot;
what is left out is smaller by a factor δ′. Good where the spacing changes by a few per cent from
one particle to the next. Where h has a gradient as well, H = 1 + g·s, a knot k lies at p = k H(p),
and with t = s/H, dt/ds = 1/H², its terms are H^{|α|−1−|δ|} c δ^n H^{−2(n−1)} B̃_n, to the same
order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cache, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from sympy.polys.appellseqs import bernoulli_poly

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import Key
from sphtrunc.theory.euler_maclaurin import euler_maclaurin
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.theory.variable_h.moments import derivatives_of
from sphtrunc.theory.variable_h.scenes import Slope, term_values

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array

_STEP = 1e-3  # of the differences of the spacing
_NODES = 24  # of a quadrature, for each piece of the kernel


def graded_moments(
    kernel: Kernel,
    operator: Operator,
    spacing: Callable[[Array], Array],
    at: float,
    offset: Fraction,
    degree: int,
    slope: Slope | None = None,
) -> dict[Any, float]:
    """The moments of the first component at one target, x/h = at, of particles of spacing
    δ(x/h) = Δx/h; slope: how h changes from particle to particle, if it does.

    Raises ValueError for nested forms, which see the spacing about every neighbour.
    """
    if operator.form == NESTED:
        raise ValueError("form: nested sums see the spacing of every neighbour; expected another")
    keys, theta, g = operator.needed(1, degree), float(offset), 0.0
    if slope is not None:
        slope.wider(kernel)
        g = float(slope.slopes[0])
    sums = _sums(kernel, keys, spacing, at, theta, g)
    if slope is not None and slope.rule == "mean-kernel":
        own = _sums(kernel, keys, spacing, at, theta, 0.0)
        sums = {key: 0.5 * (own[key] + value) for key, value in sums.items()}
    return {alpha: float(m) for alpha, m in operator.correct(sums, 1, degree).items()}


def _sums(
    kernel: Kernel,
    keys: Iterable[Key],
    spacing: Callable[[Array], Array],
    at: float,
    theta: float,
    g: float,
) -> dict[Key, float]:
    import numpy as np

    def delta(s: Any) -> Any:
        s = np.asarray(s, dtype=np.float64)
        return np.broadcast_to(np.asarray(spacing(at + s), dtype=np.float64), s.shape)

    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    ends = [float(knot) for knot in kernel.knots]
    s, w = [], []
    for a, b in pairwise(ends):
        for sign in (1.0, -1.0):
            low, high = (sign * k / (1.0 - sign * g * k) for k in (a, b))
            s.append(0.5 * (low + high) + 0.5 * (high - low) * nodes)
            w.append(0.5 * abs(high - low) * weights)
    points, areas = np.concatenate(s), np.concatenate(w)
    here, ahead, back = delta(points), delta(points + _STEP), delta(points - _STEP)
    slope, curve = (ahead - back) / (2.0 * _STEP), (ahead - 2.0 * here + back) / _STEP**2
    wider = areas * (slope**2 + here * curve) / 6.0
    width: dict[Any, float] = {}
    number: dict[Any, float] = {}
    stretch: dict[Any, float] = {}
    for knot in {x for k in kernel.knots for x in (k, -k)}:
        p = float(knot) / (1.0 - g * float(knot))
        stretch[knot] = 1.0 + g * p
        width[knot] = float(delta(np.array([p]))[0])
        number[knot] = float(np.sum(0.5 * p * weights / delta(0.5 * p * (1.0 + nodes))))
    sums = {}
    for key in keys:
        values = term_values(kernel, key, points[:, None], np.array([g]))
        total = float(areas @ values) if g else float(continuous_sum(kernel, key))
        total += float(wider @ values)
        power = key[1][0] - 1 - derivatives_of(key[0])
        for n, knot, c in _knot_terms(kernel, key):
            scale = c * width[knot] ** n * stretch[knot] ** (power - 2 * (n - 1))
            total += scale * _bernoulli(n, number[knot] - theta)
        sums[key] = total
    return sums


def _bernoulli(n: int, x: float) -> float:
    """B̃_n(x); at a jump of B̃_1 the mean."""
    x = x - float(int(x // 1))
    if n == 1 and min(x, 1.0 - x) < 1e-12:
        return 0.0
    value = 0.0
    for c in _coefficients(n):
        value = value * x + c
    return value


@cache
def _coefficients(n: int) -> tuple[float, ...]:
    """Of B_n, the highest first."""
    return tuple(float(c) for c in bernoulli_poly(n, polys=True).all_coeffs())


@lru_cache(maxsize=4096)
def _knot_terms(kernel: Kernel, key: Key) -> tuple[tuple[int, Any, float], ...]:
    return tuple((n, p, float(c)) for n, p, c in euler_maclaurin(kernel, key[0], key[1][0]))
