"""The Fourier transform of a kernel, F(k) = ∫ Ŵ(s) e^{−ik·s} d^d s, with k in units of 1/h.

Everything is built on one family of entire functions of k²,

    Φ_m(k) = (−(1/k) d/dk)^m F(k),   F = Φ_0,   F′ = −k Φ_1,   F″ = −Φ_1 + k² Φ_2,

because every Cartesian derivative of a radial function is a polynomial in k times Φ_m. Each step of
−(1/k) d/dk is also a step of two dimensions: the transform in 3D is 2π Φ_1 of the one in 1D.

Three ways to a value, none of which cancels where it is used:
- the power series Φ_m = Σ_n (−k²)^n … R_{2(n+m)} of exact kernel moments for kκ ≤ 1;
- in 1D and 3D, for large k, the closed form: integration by parts turns the transform into the
  jumps of the kernel, Σ_{p,a} c_{pa} k^{−a} Re(i^a e^{ikp}) with rational c_{pa} and knots p;
- between them, and in 2D (where it is a Bessel integral), Gauss–Legendre quadrature between knots.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import factorial, gamma, pi, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import jumps, steps

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from sphtrunc.kernels.gaussian import Gaussian

    Floats = NDArray[np.float64]

#: {(knot p >= 0, power a): c} stands for Σ c k^{−a} Re(i^a e^{ikp})
Terms = dict[tuple[Fraction, int], Fraction]

_PHASE = 12.0  # k times half the width of a quadrature panel
_BLOCK = 1 << 18  # entries of the matrix of k times nodes


# ------------------------------------------------------------------------------------ the transform


def transform(
    kernel: Kernel | Gaussian, k: ArrayLike, dim: int = 1, derivative: int = 0
) -> NDArray[np.float64]:
    """F(k), F′(k) or F″(k) (derivative 0, 1, 2) in float64, shape of k; F(0) = 1.

    To 1e-14 of ∫|Ŵ| |s|^derivative, which for a kernel of one sign is 1e-14 relative to F(0).

    Raises ValueError for a k that is not a finite real number and for other derivatives.
    """
    points = _checked(k)
    if derivative == 0:
        return radial(kernel, points, dim, 0)
    first = radial(kernel, points, dim, 1)
    if derivative == 1:
        return np.asarray(-points * first)
    if derivative == 2:
        return np.asarray(points * points * radial(kernel, points, dim, 2) - first)
    raise ValueError(f"derivative: got {derivative!r}, expected 0, 1 or 2")


def smoothing_error(kernel: Kernel | Gaussian, k: ArrayLike, dim: int = 1) -> NDArray[np.float64]:
    """1 − F(kh), the relative smoothing error of value and gradient for a wave of wavenumber k.

    Keeps its relative accuracy as k → 0, where it is R_2 k²/(2d).
    """
    given = np.abs(_checked(k))
    points = given.reshape(-1)
    result = 1.0 - radial(kernel, points, dim, 0)
    small = points * kernel_scale(kernel) <= 1.0
    coefficients = _series(kernel, dimension(dim), 0)
    u = points[small] ** 2
    value = np.zeros_like(u)
    for c in reversed(coefficients[1:]):
        value = (value + c) * u
    result[small] = -value
    return result.reshape(given.shape)


def radial(kernel: Kernel | Gaussian, k: ArrayLike, dim: int, m: int = 0) -> NDArray[np.float64]:
    """Φ_m(k) = (−(1/k) d/dk)^m F(k) in float64, shape of k; see the head of this file.

    Φ_{−1} is the transform of −Ŵ′/q, whose gradient is −k F.
    """
    points = np.abs(_checked(k))
    dim = dimension(dim)
    if m == -1:
        return _quadrature(kernel, points.reshape(-1), dim, m).reshape(points.shape)
    closed = getattr(kernel, "radial", None)
    if closed is not None:
        values = closed(points, dim, m)
        if values is not None:
            return np.asarray(values)
    flat = points.reshape(-1)
    result = np.empty_like(flat)
    small = flat * kernel_scale(kernel) <= 1.0
    large = flat >= _crossover(kernel, dim, m)
    u = flat[small] ** 2
    value = np.zeros_like(u)
    for c in reversed(_series(kernel, dim, m)):
        value = value * u + c
    result[small] = value
    if isinstance(kernel, Kernel) and large.any():
        result[large] = _closed(kernel, flat[large], dim, m)
    between = ~(small | large)
    if between.any():
        result[between] = _quadrature(kernel, flat[between], dim, m)
    return result.reshape(points.shape)


def transform_mp(
    kernel: Kernel, k: object, dim: int = 1, derivative: int = 0, digits: int = 30
) -> Any:
    """F(k), F′(k) or F″(k) as an mpmath number, right to `digits` digits relative to F(0).

    The same power series as at small k, with as many more digits as it cancels.
    """
    from mpmath import mp

    dim = dimension(dim)
    if derivative not in (0, 1, 2):
        raise ValueError(f"derivative: got {derivative!r}, expected 0, 1 or 2")
    with mp.workdps(20):
        reach = abs(float(mp.mpf(k))) * float(kernel.support)
    guard = int(0.4343 * reach) + 20 + 2 * derivative
    terms = int(1.5 * reach + 1.2 * digits) + 20
    with mp.workdps(digits + guard):
        u = mp.mpf(k) ** 2
        ladder = mp.mpf(1)  # (−k²)ⁿ / (2ⁿ n! d(d+2)…)
        total = mp.mpf(0)
        for n, r in zip(range(terms), _moments_mp(kernel, dim), strict=False):
            falling = prod(range(2 * n - derivative + 1, 2 * n + 1))
            total += falling * r * ladder
            ladder *= -u / (2 * (n + 1) * (dim + 2 * n))
        if derivative:
            total = (
                total / mp.mpf(k) ** derivative
                if k
                else -_mp(kernel.moment(2, dim)) / dim * (derivative == 2)
            )
    with mp.workdps(digits):
        return +total


def _moments_mp(kernel: Kernel, dim: int) -> Iterator[Any]:
    """∫ |s|^{2n} Ŵ, n = 0, 1, …, in the present precision of mpmath."""
    mass = _mp(kernel.moment(0, dim)) / _mp(kernel._mass(dim))
    rows = [
        [sign * _mp(c) * _mp(end) ** (j + dim), j + dim, _mp(end) ** 2]
        for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.coefficients(), strict=False)
        for sign, end in ((-1, a), (1, b))
        for j, c in enumerate(piece)
        if c and end
    ]
    while True:
        yield mass * sum(value / power for value, power, _ in rows)
        for row in rows:
            row[0] *= row[2]
            row[1] += 2


def _mp(value: Any) -> Any:
    from mpmath import mp

    return mp.mpf(int(value.p)) / int(value.q)


def _checked(k: ArrayLike) -> Floats:
    points = np.asarray(k)
    if points.dtype.kind not in "iuf":
        raise ValueError(f"k: got an array of type {points.dtype}, expected real numbers")
    points = points.astype(np.float64)
    if not np.isfinite(points).all():
        raise ValueError("k: got NaN or an infinite value, expected finite wavenumbers in 1/h")
    return points


# ---------------------------------------------------------------------------------- the three ways


def _ladder(dim: int, n: int) -> int:
    """d (d+2) … (d+2n−2)."""
    return prod(range(dim, dim + 2 * n, 2))


def kernel_scale(kernel: Kernel | Gaussian) -> float:
    """The length, in h, that decides how small a wavenumber is small."""
    return float(kernel.support) if np.isfinite(float(kernel.support)) else 2.0


@lru_cache(maxsize=256)
def _series(kernel: Kernel | Gaussian, dim: int, m: int) -> tuple[float, ...]:
    """Coefficients of Φ_m in k²: (−1)^n (n+m)!/n! 2^m R_{2(n+m)} / (2^{n+m}(n+m)! d(d+2)…)."""
    result = []
    for n in range(14):
        total = n + m
        r = float(kernel.moment(2 * total, dim))
        result.append((-1) ** n * r / (2**n * factorial(n) * _ladder(dim, total)))
    return tuple(result)


@lru_cache(maxsize=256)
def terms(kernel: Kernel, dim: int, m: int = 0) -> Terms:
    """Φ_m(k) in closed form for d = 1 and 3, as exact terms c k^{−a} Re(i^a e^{ikp}).

    In 1D ∫ f e^{−iks} ds = Σ_a (i/k)^a Σ_p [f^{(a−1)}](p) e^{ikp} over all knots of the even
    extension; −(1/k) d/dk sends the term (p, a) to −a (p, a+2) − p (p, a+1).
    """
    if dim == 2:
        raise ValueError("dim: the transform of a piecewise polynomial is elementary in 1D and 3D")
    from sympy import pi as exact_pi

    factor = kernel.normalisation(dim) * (1 if dim == 1 else 2 * exact_pi)
    result: Terms = {}
    for a, at in enumerate(jumps(kernel.knots, steps(kernel.knots, kernel.pieces), 1), start=1):
        for p, jump in at.items():
            if p >= 0 and jump:
                c = fraction(factor * jump)
                result[fraction(p), a] = c if p == 0 else 2 * c
    for _ in range(m + (dim == 3)):
        result = _lowered(result)
    return result


def _lowered(terms: Terms) -> Terms:
    """−(1/k) d/dk of the sum."""
    result: Terms = {}
    for (p, a), c in terms.items():
        for key, value in (((p, a + 2), -a * c), ((p, a + 1), -p * c)):
            total = result.pop(key, Fraction(0)) + value
            if total:
                result[key] = total
    return result


@lru_cache(maxsize=256)
def _crossover(kernel: Kernel | Gaussian, dim: int, m: int) -> float:
    """The least k from which the terms of the closed form are too small to cancel."""
    if dim == 2 or not isinstance(kernel, Kernel):
        return float("inf")
    allowed = 8.0 * float(kernel.support) ** (2 * m) / _ladder(dim, m)
    sizes = [(float(p), a, abs(float(c))) for (p, a), c in terms(kernel, dim, m).items()]
    low, high = 0.0, 1.0
    while sum(c * (4 + a + high * p) * high**-a for p, a, c in sizes) > allowed:
        low, high = high, 2 * high
    for _ in range(20):
        k = (low + high) / 2
        if k and sum(c * (4 + a + k * p) * k**-a for p, a, c in sizes) <= allowed:
            high = k
        else:
            low = k
    return high


def _closed(kernel: Kernel, k: Floats, dim: int, m: int) -> Floats:
    table = terms(kernel, dim, m)
    inverse = 1.0 / k
    result = np.zeros_like(k)
    for p in sorted({p for p, _ in table}):
        powers = {a: float(c) for (x, a), c in table.items() if x == p}
        real, imaginary = np.zeros_like(k), np.zeros_like(k)
        for a in range(max(powers), 0, -1):
            real, imaginary = real * inverse, imaginary * inverse
            c = powers.get(a, 0.0)
            if a % 2:  # i^a e^{ix}: real part −sin x for a = 1, sin x for a = 3
                imaginary += c if a % 4 == 3 else -c
            else:
                real += c if a % 4 == 0 else -c
        x = k * float(p)
        result += (np.cos(x) * real + np.sin(x) * imaginary) * inverse
    return result


def _quadrature(kernel: Kernel | Gaussian, k: Floats, dim: int, m: int) -> Floats:
    """SPHERE_d ∫ q^{d−1+2m} Ŵ Λ_{d+2m}(kq) dq / (d(d+2)…), panel by panel between the knots; for
    m = −1 of −Ŵ′/q with m = 0."""
    result = np.empty_like(k)
    octave = np.ceil(np.log2(np.maximum(k, 1e-300)))
    for exponent in np.unique(octave):
        here = np.flatnonzero(octave == exponent)
        x, weight = _nodes(kernel, dim, m, float(2.0**exponent))
        step = max(1, _BLOCK // len(x))
        for start in range(0, len(here), step):
            part = here[start : start + step]
            result[part] = _lambda(dim + 2 * max(m, 0), np.multiply.outer(k[part], x)) @ weight
    return result


@lru_cache(maxsize=64)
def _nodes(kernel: Kernel | Gaussian, dim: int, m: int, k: float) -> tuple[Floats, Floats]:
    degree = getattr(kernel, "degree", 40)
    t, weight = np.polynomial.legendre.leggauss(26 + (degree + dim + 2 * m) // 2)
    knots = [float(x) for x in kernel.knots]
    nodes, weights = [], []
    for a, b in pairwise(knots):
        count = max(1, int(np.ceil(k * (b - a) / (2 * _PHASE))))
        edges = np.linspace(a, b, count + 1)
        half = np.diff(edges) / 2
        nodes.append((edges[:-1, None] + half[:, None] * (1 + t)).ravel())
        weights.append((half[:, None] * weight).ravel())
    x, w = np.concatenate(nodes), np.concatenate(weights)
    sphere = {1: 2.0, 2: 2 * pi, 3: 4 * pi}[dim] / _ladder(dim, max(m, 0))
    if m < 0:
        return x, -w * kernel.dw(x, dim) * x ** (dim - 2) * sphere
    return x, w * kernel.w(x, dim) * x ** (dim - 1 + 2 * m) * sphere


def _lambda(nu: int, x: Floats) -> Floats:
    """₀F₁(; ν/2; −x²/4): cos x, J₀(x), sin(x)/x and on, the mean of e^{ix·n} over the unit sphere
    of ν dimensions."""
    from scipy import special

    if nu == 1:
        return np.asarray(np.cos(x))
    if nu == 2:
        return np.asarray(special.j0(x))
    if nu == 3:
        return np.asarray(np.sinc(x / pi))
    result = np.ones_like(x)
    small = x < 1.0
    z = -0.25 * x[small] ** 2
    term, total = np.ones_like(z), np.ones_like(z)
    for n in range(1, 14):
        term = term * z / (n * (nu / 2 + n - 1))
        total = total + term
    result[small] = total
    y = x[~small]
    order = nu / 2 - 1
    if nu % 2:
        bessel = np.sqrt(2 * y / pi) * special.spherical_jn((nu - 3) // 2, y)
    else:
        bessel = special.jv(order, y)
    result[~small] = gamma(nu / 2) * (2.0 / y) ** order * bessel
    return result


# ------------------------------------------------------------------------------------------- decay


@lru_cache(maxsize=256)
def decay(kernel: Kernel, dim: int, m: int = 0) -> tuple[tuple[int, float], ...]:
    """A bound |Φ_m(k)| <= Σ C k^{−a} for k > 0, as pairs (a, C), from the exact jumps.

    In 2D through Φ_m^{2D}(k²) = (1/2π) ∫₀^∞ Φ_m^{3D}(k²+z) z^{−1/2} dz (of the same Ŵ), which turns
    k^{−a} into B(½, (a−1)/2)/(2π) k^{1−a}; that neglects the oscillation and gives away k^{1/2}.
    """
    dim = dimension(dim)
    sizes: dict[int, float] = {}
    factor = 1.0
    if dim == 2:
        factor = float(kernel.normalisation(2) / kernel.normalisation(3))
    for (_, a), c in terms(kernel, 3 if dim == 2 else dim, m).items():
        if dim == 2:
            beta = gamma(0.5) * gamma((a - 1) / 2) / gamma(a / 2)
            sizes[a - 1] = sizes.get(a - 1, 0.0) + abs(float(c)) * factor * beta / (2 * pi)
        else:
            sizes[a] = sizes.get(a, 0.0) + abs(float(c))
    return tuple((a, c * (1 + 1e-12)) for a, c in sorted(sizes.items()))
