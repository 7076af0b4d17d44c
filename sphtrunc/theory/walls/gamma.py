"""γ, the part of a kernel that lies in the fluid, and its slope: planes, channels, corners, balls.

    γ = ∫_fluid Ŵ d^d s = 1 − ∫ (S_d q^{d−1} Ŵ) f(q) dq,

f(q) the share of the sphere of radius q about the target that lies beyond the boundary, itself a
function of the distance alone. Beside a plane and between two planes γ is exact; at a corner, a
sphere and a cylinder f is in closed form (in 3D an integral over latitudes of that in 2D), and γ is
integrated in floats to 13 digits, between any two radii where f or the kernel is not smooth.

γ of the particles of a snapshot tells where its surface is; a sum that is divided by γ is
normalised (see `theory.remedies`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from math import acos, asin, fsum, hypot, pi, sin, sqrt
from typing import Any, NamedTuple

from sympy import Expr, Rational

from sphtrunc.kernels.arguments import dimension, rational
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key
from sphtrunc.theory.lattice_sums import real_context
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.theory.walls.half_space import beyond, odd, plane
from sphtrunc.theory.walls.moments import nodes, settled
from sphtrunc.theory.walls.orders import precise

Share = Callable[[float], float]  # radius -> the part of the circle, or sphere, beyond the boundary


class Gamma(NamedTuple):
    """γ and ∂γ/∂η, η the distance from the boundary in h (at a corner: from each wall); exact, or
    floats."""

    value: Any
    slope: tuple[Any, ...]


def beside_plane(kernel: Kernel, dim: int, eta: object) -> Gamma:
    """Exactly; the slope is the marginal kernel.

    >>> from sphtrunc import kernel
    >>> beside_plane(kernel("cubic-spline"), 3, "1/2").value
    3119/3840
    """
    at, zero = _distance(eta, "eta"), unit(dimension(dim), 0, 0)
    return Gamma(1 - beyond(kernel, (zero, zero), at), (plane(kernel, (zero, zero), at),))


def between_planes(kernel: Kernel, dim: int, eta: object, other: object) -> Gamma:
    """In a channel, narrower than the support or not, exactly; slopes with respect to each wall."""
    walls = [beside_plane(kernel, dim, x) for x in (eta, other)]
    return Gamma(walls[0].value + walls[1].value - 1, (walls[0].slope[0], walls[1].slope[0]))


def channel_moments(
    kernel: Kernel, operator: Operator, dim: int, degree: int, eta: object, other: object
) -> dict[MultiIndex, Any]:
    """The moments for Δx/h → 0 between walls at s₁ = −η and s₁ = η′, by the algebra of the
    operator: exact in 1D and 3D, and without a correction in 2D."""
    low, high = _distance(eta, "eta"), _distance(other, "other")
    digits = dim == 2 and not operator.uncorrected

    def cut(key: Key) -> Any:
        below, above = (_number(beyond(kernel, key, x), digits) for x in (low, high))
        whole = _number(continuous_sum(kernel, key), digits)
        return whole - above + (below if odd(key) else -below)

    sums = {key: cut(key) for key in operator.needed(dim, degree)}
    found = operator.correct(sums, dim, degree)
    return {alpha: settled(value) for alpha, value in found.items()}


def in_corner(kernel: Kernel, dim: int, eta: object, other: object) -> Gamma:
    """In the right angle of two walls, at η and η′ from them, in 2D or 3D."""
    a, b = float(_distance(eta, "eta")), float(_distance(other, "other"))
    reach = hypot(a, b)

    def share(q: float) -> float:
        """Of the circle, behind both walls."""
        return (acos(a / q) - asin(b / q)) / (2 * pi) if q > reach else 0.0

    def slope(near: float) -> Share:
        """Its slope with the distance of one wall."""
        return lambda q: -1 / (2 * pi * sqrt(q**2 - near**2)) if q > reach else 0.0

    walls = [beside_plane(kernel, dim, x) for x in (eta, other)]
    both = _integral(kernel, dim, share, [reach])
    value = float(walls[0].value) + float(walls[1].value) - 1 + both
    slopes = [
        float(wall.slope[0]) + _integral(kernel, dim, slope(near), [reach])
        for wall, near in zip(walls, (a, b), strict=True)
    ]
    return Gamma(value, tuple(slopes))


def beside_sphere(
    kernel: Kernel, dim: int, eta: object, radius: object, *, inside: bool = False
) -> Gamma:
    """Outside a ball of this radius in h (in 2D a disc), or inside it."""
    return _round(kernel, dimension(dim), eta, radius, inside, cylinder=False)


def beside_cylinder(kernel: Kernel, eta: object, radius: object, *, inside: bool = False) -> Gamma:
    """Outside a round cylinder of this radius in h in 3D, or inside it."""
    return _round(kernel, 3, eta, radius, inside, cylinder=True)


def _round(
    kernel: Kernel, dim: int, eta: object, radius: object, inside: bool, cylinder: bool
) -> Gamma:
    """Directions at a cosine above c from that to the boundary lie beyond it."""
    distance, size = _distance(eta, "eta"), _distance(radius, "radius")
    if dim == 1 or size == 0 or (inside and distance >= size):
        raise ValueError(
            f"radius: got {size} in {dim}D at a distance of {distance}, expected a positive radius"
            " in 2D or 3D, larger than the distance inside"
        )
    sign = -1 if inside else 1
    near, r = float(distance), float(size)
    d = r + sign * near
    flat = dim == 2 or cylinder

    def cosine(q: float) -> float:
        """(q² + d² − r²)/(2qd), d² − r² without cancellation."""
        return sign * (q**2 + sign * near * (d + r)) / (2 * q * d)

    def share(q: float) -> float:
        c = max(min(cosine(q), 1.0), -1.0)
        return acos(c) / pi if flat else (1 - c) / 2

    def slope(q: float) -> float:
        c = cosine(q)
        if abs(c) >= 1:
            return 0.0
        rise = (d**2 - q**2 + r**2) / (2 * q * d**2)  # of c with η, on either side
        return -rise / (pi * sqrt((1 - c) * (1 + c))) if flat else -rise / 2

    lifted = flat and dim == 3
    value = 1 - _integral(kernel, dim, share, [near, r + d], lifted)
    return Gamma(value, (-_integral(kernel, dim, slope, [near, r + d], lifted),))


# ------------------------------------------------------------------------------------- integration


def _integral(
    kernel: Kernel, dim: int, share: Share, edges: Sequence[float], lifted: bool | None = None
) -> float:
    """∫ S_d q^{d−1} Ŵ f dq.

    lifted: the share is that of circles about an axis, f₃(q) = ∫_0^{π/2} sin θ f(q sin θ) dθ that
        of the sphere (default: in 3D); edges: where f is not smooth
    """
    knots = [float(k) for k in kernel.knots]
    pieces = [[float(c) for c in reversed(piece)] for piece in kernel.coefficients()]
    power = dim - 1

    def over_latitudes(q: float) -> float:
        marks = [asin(e / q) for e in edges if 0 < e < q]
        return fsum(w * sin(t) * share(q * sin(t)) for t, w in _rule(0.0, pi / 2, marks))

    seen = over_latitudes if (dim == 3 if lifted is None else lifted) else share

    def term(q: float) -> float:
        piece = pieces[next(i for i, k in enumerate(knots[1:]) if q <= k)]
        w = 0.0
        for c in piece:
            w = w * q + c
        return q**power * w * seen(q)

    total = fsum(w * term(q) for q, w in _rule(0.0, knots[-1], [*knots, *edges]))
    return total / float(kernel._mass(dim))


def _rule(low: float, high: float, marks: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Nodes and weights between the marks, for functions with square roots at them."""
    line = sorted({low, high, *(m for m in marks if low < m < high)})
    for a, b in pairwise(line):
        for x, w in _unit_rule():
            yield (a + b) / 2 + (b - a) / 2 * x, (b - a) / 2 * w


@cache
def _unit_rule() -> tuple[tuple[float, float], ...]:
    ctx = real_context()
    return tuple((float(x), float(w)) for x, w in nodes([-ctx.one, ctx.one], []))


def _distance(value: object, name: str) -> Rational:
    found = rational(value, name)
    if found < 0:
        raise ValueError(f"{name}: got {found}, expected a number >= 0")
    return found


def _number(x: Expr, digits: bool) -> Any:
    return precise(x) if digits else x
