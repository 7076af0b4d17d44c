"""Walls: the moments of an estimate whose support is cut by a plane, exactly.

The target lies at distance ηh from a plane wall (or a free surface), particles where s₁ > −η. To
Euler–Maclaurin's sum a wall is one more knot, at p = −η, where f jumps from 0 to f(−η⁺):

    Δs Σ_{s_j>−η} f(s_j) = ∫_{−η} f ds
                         + Σ_m (−1)^m Δs^{m+1}/(m+1)! Σ_{p>=−η} B̃_{m+1}(p/Δs − θ) [f^{(m)}](p),

again finite and exact. A particle *on* the wall counts half (B̃₁(0) = 0) unless one is told
otherwise. The first term of the wall is of order Δx/h, of second order where the wall is half-way
between particles or, with that half, at one: so near a wall the smoothness of the kernel no longer
decides the order.

All the rest is the algebra of `sphtrunc.operators` on these sums. What lies beyond the wall is
empty, or ghosts whose value is a combination of values in the fluid: at s they carry moments
G_β = ⟨(s′ − s)^β⟩ of the places s′ where the field is read,

    mirror   A(s*), s* the image of s:                   G_β = D^{β₁}, D = −2(η + s₁) (0 if β_t ≠ 0)
    odd      2 A_w − A(s*), A_w on the wall between:      G_β = 2 (D/2)^{β₁} − D^{β₁}
    dummy    the Shepard mean of the fluid around it (Adami, Hu & Adams 2012,
             doi:10.1016/j.jcp.2012.05.005):              G_β = the moments of that mean

With mirrored ghosts every sum over them is a sum over the fluid again, seen from −η.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import ceil, comb, floor
from typing import TYPE_CHECKING, Any, NamedTuple

from sympy import Expr, Rational

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.corrections import below, shifted
from sphtrunc.operators.moments import MultiIndex, add
from sphtrunc.operators.operator import NESTED, PAIRED, Operator
from sphtrunc.operators.terms import FATEHI_MANZARI, Key, Sums
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS, units
from sphtrunc.scenes.walls import Wall
from sphtrunc.theory.euler_maclaurin import (
    KnotTerm,
    euler_maclaurin,
    fractional_part,
    periodic_bernoulli,
    simple,
)
from sphtrunc.theory.lattice_sums import lattice_sums, real_context, rounded
from sphtrunc.theory.walls.half_space import cut_sum, odd, plane

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian

#: of which dummy particles take their value
EXTRAPOLATION = Operator("value", "standard", "shepard")


# -------------------------------------------------------------------------------- sums in 1D


def wall_terms(kernel: Kernel, needed: Iterable[Key], eta: Rational) -> list[KnotTerm]:
    """The discretisation error of cut base sums in 1D: that of the knots inside, and of the wall.

    f is zero outside its support, so that f^{(m)}(−η⁺) is made by the jumps at the knots p <= −η
    that the wall cuts off: Σ_p Σ_{n>=m} [f^{(n)}](p) (−η−p)^{n−m}/(n−m)!.
    """
    found = []
    for term, (k,) in needed:
        cut: dict[int, Rational] = {}
        for power, knot, c in euler_maclaurin(kernel, term, k):
            if knot > -eta:
                found.append(KnotTerm(term, k, power, knot, c))
                continue
            for lower in range(1, power + 1):
                # c_n = (−1)^{n−1}/n! times the jump of the derivative n − 1
                scale = Rational((-1) ** (power - lower) * comb(power, lower))
                cut[lower] = cut.get(lower, 0) + c * scale * (-eta - knot) ** (power - lower)
        found += [KnotTerm(term, k, n, -eta, c) for n, c in sorted(cut.items()) if c != 0]
    return found


def cut_lattice_sums(
    kernel: Kernel,
    needed: Sequence[Key],
    eta: Rational,
    dx_over_h: Expr,
    theta: Expr,
    weight: Rational,
) -> dict[Key, Any]:
    """The base sums over the particles s_j = (j + θ) Δx/h > −η in 1D, by integral and knots.

    weight: what part of a particle at −η counts, with the mean of f on both sides
    """
    sums = {key: cut_sum(kernel, key, eta) for key in needed}
    power = cache(lambda n: simple(dx_over_h**n))
    wave = cache(
        lambda n, p: periodic_bernoulli(n, fractional_part(p / dx_over_h - theta)) * power(n)
    )
    hit = (-eta / dx_over_h - theta).is_integer
    for term in wall_terms(kernel, needed, eta):
        key = term.term, (term.moment,)
        sums[key] += term.coefficient * wave(term.dx_power, term.knot)
        if hit and term.knot == -eta and term.dx_power == 1:
            sums[key] += (weight - Rational(1, 2)) * dx_over_h * term.coefficient
    if hit:
        for term, (k,) in needed:
            for n, knot, c in euler_maclaurin(kernel, term, k):
                if n == 1 and knot == -eta:  # f jumps there: half of c is not the particle's
                    sums[term, (k,)] -= weight * dx_over_h * c / 2
    return {key: simple(value) for key, value in sums.items()}


# ------------------------------------------------------------------- any dimension, any operator


class HalfSpace(NamedTuple):
    """Sums over the fluid, as functions of the keys that are wanted: lattice sums, or integrals.

    own: seen from the target; image: seen from its image, at −η
    layers(keys, seen, beyond): for every plane of particles parallel to the wall, of the fluid or
        beyond the wall, its part of the sums `keys`, and the sums `seen` over the fluid seen from
        one of its particles
    """

    own: Callable[[Sequence[Key]], dict[Key, Any]]
    image: Callable[[Sequence[Key]], dict[Key, Any]]
    layers: Callable[[Sequence[Key], Sequence[Key], bool], list[tuple[Sums, Sums]]]


def moments_of(
    operator: Operator, dim: int, degree: int, axis: int, eta: Any, ghosts: str, fluid: HalfSpace
) -> dict[MultiIndex, Any]:
    """The moments M_α, |α| <= degree, of the component `axis`: the operator's own algebra."""
    needed = operator.needed(dim, degree)
    own = fluid.own(needed)
    if ghosts == "none":
        around = fluid.layers(needed, needed, False) if operator.form == NESTED else None
        return operator.correct(own, dim, degree, axis, around=around)
    if operator.form == NESTED:
        raise ValueError(
            "ghosts: the nested form has gradients at the ghosts as well, which are not given by"
            " their values; expected none, or the form brookshaw"
        )
    if ghosts == "dummy":
        keys = EXTRAPOLATION.needed(dim, degree)
        layers = [
            (part, EXTRAPOLATION.correct(seen, dim, degree))
            for part, seen in fluid.layers(needed, keys, True)
        ]
        there = {key: sum(part[key] for part, _ in layers) for key in needed}
    else:
        there = {key: -value if odd(key) else value for key, value in fluid.image(needed).items()}
        layers = []

    def ghost(key: Key, alpha: MultiIndex) -> Any:
        """Σ over the ghosts of a term, times what they carry of s^α."""
        delta, gamma = key
        if ghosts == "dummy":
            return sum(
                shifted(_raised(part, delta, gamma, alpha), moments, alpha)
                for part, moments in layers
            )
        n, across = alpha[0], alpha[1:]
        return sum(
            c * there[delta, add(gamma, (k, *across))]
            for k, c in enumerate(_image(ghosts, eta, n))
            if c != 0
        )

    def read(part: Mapping[Key, Any], alpha: MultiIndex) -> Any:
        return sum(
            c * (own[delta, add(alpha, gamma)] + ghost((delta, gamma), alpha))
            for (delta, gamma), c in part.items()
        )

    total = {key: own[key] + there[key] for key in needed}
    return operator.correct(total, dim, degree, axis, read=read)


def _image(ghosts: str, eta: Any, n: int) -> list[Any]:
    """What a ghost at s₁ carries of s₁ⁿ, as a polynomial in s₁: (−2η−s₁)ⁿ, or 2(−η)ⁿ less that."""
    image = [(-1) ** k * comb(n, k) * (-2 * eta) ** (n - k) for k in range(n + 1)]
    if ghosts == "mirror":
        return image
    return [2 * (-eta) ** n - image[0], *(-c for c in image[1:])]


def _raised(part: Sums, delta: Any, gamma: MultiIndex, most: MultiIndex) -> dict[MultiIndex, Any]:
    """α -> the sum (δ, γ + α), for every α <= most."""
    return {alpha: part[delta, add(gamma, alpha)] for alpha in below(most)}


# ------------------------------------------------------------------------------------- the limit


def cut_moments(
    kernel: Kernel,
    operator: Operator,
    dim: int,
    degree: int,
    wall: Wall,
    axis: int = 0,
    exact: bool = True,
) -> dict[MultiIndex, Any]:
    """The moments for Δx/h → 0: exact in 1D and 3D, and in 2D without a correction, where no
    sums over planes are multiplied (as for dummies and the nested form, of 15 digits); else of 30.

    Raises ValueError as the algebra of the operator does.
    """
    require(kernel, operator)
    eta: Any = Rational(wall.eta.numerator, wall.eta.denominator)
    layered = in_layers(operator, wall.ghosts)
    closed = is_rational(operator, dim) or (dim == 2 and operator.uncorrected)
    if layered or not closed or not exact:
        eta = real_context().mpf(wall.eta.numerator) / wall.eta.denominator

    def sums(keys: Iterable[Key], distance: Any) -> dict[Key, Any]:
        return {key: cut_sum(kernel, key, distance) for key in keys}

    def layers(keys: Sequence[Key], seen: Sequence[Key], outside: bool) -> list[tuple[Sums, Sums]]:
        reach = [-eta, kernel.support] if not outside else [-kernel.support, -eta]
        knots = [sign * k for k in kernel.knots for sign in (1, -1)]
        return [
            ({key: w * plane(kernel, key, z) for key in keys}, sums(seen, eta + z))
            for z, w in nodes(reach, [*knots, *(k - eta for k in knots)])
        ]

    fluid = HalfSpace(lambda keys: sums(keys, eta), lambda keys: sums(keys, -eta), layers)
    found = moments_of(operator, dim, degree, axis, eta, wall.ghosts, fluid)
    return {alpha: settled(value, 25 if layered else 40) for alpha, value in found.items()}


def is_rational(operator: Operator, dim: int) -> bool:
    """The sums of the operator over a half space at a rational distance are rational: no roots, as
    in 2D, and no logarithms."""
    return dim == 1 or (dim == 3 and operator.form != FATEHI_MANZARI)


def cut_number(kernel: Kernel, operator: Operator, key: Key, eta: Fraction) -> Any:
    """`cut_sum` as a number to compute with: a Fraction where it is one, else of 50 digits."""
    if is_rational(operator, len(key[1])):
        return fraction(cut_sum(kernel, key, Rational(eta.numerator, eta.denominator)))
    return cut_sum(kernel, key, real_context().mpf(eta.numerator) / eta.denominator)


def nodes(ends: Sequence[Any], knots: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    """Nodes and weights of an integral from one end to the other, of a function that is analytic
    between the knots and has half-integer powers there at worst: Gauss–Legendre in t on
    z = (a+b)/2 − (b−a)/2 cos πt."""
    from mpmath.calculus.quadrature import GaussLegendre

    ctx = real_context()
    a, b = (ctx.mpf(str(x)) if isinstance(x, Rational) else x for x in ends)
    inner = {_digits_of(k) for k in knots}
    line = sorted({a, b, *(k for k in inner if a < k < b)})
    rule = GaussLegendre(ctx).calc_nodes(4, ctx.prec)
    for low, high in pairwise(line):
        if high - low < ctx.mpf(10) ** -30:
            continue
        for x, w in rule:
            angle = ctx.pi * (x + 1) / 2
            half = (high - low) / 2
            z = (low + high) / 2 - half * ctx.cos(angle)
            yield z, w * half * ctx.sin(angle) * ctx.pi / 2


def _digits_of(x: Any) -> Any:
    ctx = real_context()
    return ctx.mpf(int(x.p)) / int(x.q) if isinstance(x, Rational) else x


def settled(value: Any, decimals: int = 40) -> Any:
    """An exact number as it is, one of 50 digits as `rounded`, and 0 where that is 0."""
    if isinstance(value, (int, Expr)):
        return value
    return rounded(value, decimals) or Rational(0)


def in_layers(operator: Operator, ghosts: str) -> bool:
    """Sums over planes of particles are multiplied by what these see: dummies, the nested form."""
    return ghosts == "dummy" or operator.form == NESTED


# ------------------------------------------------------------------------------------ on a lattice


def wall_lattice_moments(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    degree: int,
    *,
    axis: int = 0,
    exact: bool = True,
) -> dict[MultiIndex, Any]:
    """The moments M_α, |α| <= degree, over the particles of a lattice on one side of a wall, plane
    by plane; arguments and numbers as of `lattice_sums.lattice_moments`.

    Ghosts are images of the particles, or dummies that continue the lattice.
    Raises ValueError where no particle is inside the support, and where the matrix of a correction
    is singular.
    """
    kernel = require(kernel, operator)
    if scene.wall is None:
        raise ValueError("wall: expected an arrangement beside one")
    wall, dx_over_h, shift, phase = scene.wall, scene.dx_over_h, scene.offset, scene.wall_phase
    layered = in_layers(operator, wall.ghosts)
    if layered and KINDS[scene.kind].turned is not None:
        raise ValueError(
            f"lattice: the particles of one plane of {scene.kind} differ in what they see; expected"
            " another lattice, or no dummies and no nested form"
        )
    exact = exact and (len(shift) == 1 or (operator.uncorrected and not layered))
    support = fraction(kernel.support)
    scene.require_seen(support)
    share = wall.share

    def some(keys: Sequence[Key], at: Sequence[Fraction], planes: Any) -> dict[Key, Any]:
        return lattice_sums(kernel, keys, scene.seen_from(at), exact, planes=planes)

    def total(keys: Sequence[Key], at: Sequence[Fraction], phi: Fraction) -> dict[Key, Any]:
        first = floor(-phi) + 1
        sums = some(keys, at, (first, None))
        if phi.denominator == 1:
            on = some(keys, at, (first - 1, first - 1))
            sums = {key: value + share * on[key] for key, value in sums.items()}
        return sums

    def layers(keys: Sequence[Key], seen: Sequence[Key], outside: bool) -> list[tuple[Sums, Sums]]:
        step, reach = units(scene.kind)[0], support / dx_over_h
        found: list[tuple[Sums, Sums]] = []
        home = (Fraction(0),) * len(shift)
        for m in range(ceil((-reach - shift[0]) / step), floor((reach - shift[0]) / step) + 1):
            if (m + phase < 0) == outside:
                part = some(keys, shift, (m, m))
                if m + phase == 0:
                    part = {key: share * value for key, value in part.items()}
                if any(value != 0 for value in part.values()):
                    found.append((part, total(seen, home, m + phase)))
        return found

    image = (shift[0] + 2 * wall.eta / dx_over_h, *shift[1:])
    fluid = HalfSpace(
        lambda keys: total(keys, shift, phase), lambda keys: total(keys, image, phase), layers
    )
    eta = Rational(wall.eta.numerator, wall.eta.denominator)
    found = moments_of(operator, len(shift), degree, axis, eta, wall.ghosts, fluid)
    return {alpha: settled(value) for alpha, value in found.items()}


def require(kernel: object, operator: Operator) -> Kernel:
    """The kernel; raises ValueError for one, or for a form, that has no theory near a wall."""
    if not isinstance(kernel, Kernel):
        raise ValueError(
            "wall: only piecewise polynomial kernels are cut exactly; expected another kernel"
        )
    if operator.form == PAIRED:
        raise ValueError(
            "form: paired takes the neighbours at s and −s together, and near a wall there are no"
            " such pairs; expected the form standard"
        )
    return kernel
