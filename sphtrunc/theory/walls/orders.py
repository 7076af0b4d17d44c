"""Orders at a wall: what its place in the lattice does to the moments, term by term.

Over planes of particles a base sum is a sum in one dimension of the plane integral f_⊥(z), with the
wall as a knot: m = ∫ f + Σ_n (−1)^{n−1}/n! f_⊥^{(n−1)}(−η⁺) B̃_n(−φ) (Δx/h)^n + what the knots of
the kernel add, φ the steps of planes from the wall to the first one. f_⊥ is known in closed form in
every dimension, and with it ∂M_α/∂((Δx/h)^n B̃_n(−φ)), through any correction, by numbers that
carry their slope: exactly where the base sums are rational, else in 50 digits.
"""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import Any

from sympy import QQ, Expr, Rational, zoo

from sphtrunc.arithmetic.dual import Dual
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.walls import Wall
from sphtrunc.theory.lattice_sums import real_context
from sphtrunc.theory.walls.half_space import (
    ETA,
    cut_sum,
    has_pole,
    odd,
    per_distance,
    plane,
    plane_pieces,
)
from sphtrunc.theory.walls.moments import HalfSpace, in_layers, moments_of, settled

MOST = 6  # the highest power of Δx/h that is looked at


def slope_at(kernel: Kernel, key: Key, z: Rational, m: int) -> Any:
    """f_⊥^{(m)}(z⁺): on the fluid's side of a wall at z."""
    at = abs(z)
    if at == 0 and has_pole(kernel, key):
        return Rational(0)  # of a moment that difference forms do not have
    if at == 0 and len(key[1]) == 2:
        return _flat_slope(kernel, key, m)
    here = [e for a, b, e in plane_pieces(kernel, key) if (a <= at < b if z >= 0 else a < at <= b)]
    if not here:
        return Rational(0)
    slope = here[0].diff(ETA, m)
    value = slope.subs(ETA, at)
    return -value if z < 0 and odd(key) != bool(m % 2) else value


def _flat_slope(kernel: Kernel, key: Key, m: int) -> Any:
    """The same at z = 0 in 2D, where f_⊥ is a constant, a linear term and what is smaller,
    z² ln z included: derivatives that need not exist are infinite here."""
    if m > 1:
        return zoo
    return per_distance(kernel, key) if m else plane(kernel, key, Rational(0))


def wall_response(
    kernel: Kernel, operator: Operator, dim: int, degree: int, wall: Wall, n: int, axis: int = 0
) -> dict[MultiIndex, Any] | None:
    """c_α of M_α = limit + c_α B̃_n(−φ) (Δx/h)^n + …, to first order in the base sums; None where
    there is no such power: f_⊥ has z² ln z at η = 0, or sums over planes are multiplied, as for
    dummies and the nested form."""
    if in_layers(operator, wall.ghosts):
        return None
    eta: Any = Rational(wall.eta.numerator, wall.eta.denominator)
    scale = Rational((-1) ** (n - 1), factorial(n))
    keys = operator.needed(dim, degree)
    sides = [eta] if wall.ghosts == "none" else [eta, -eta]  # of the target, of its image
    pairs = [
        {key: (cut_sum(kernel, key, x), scale * slope_at(kernel, key, -x, n - 1)) for key in keys}
        for x in sides
    ]
    numbers = [x for side in pairs for pair in side.values() for x in pair]
    if not all(x.is_finite for x in numbers):
        return None
    exact = all(x.is_Rational for x in numbers)
    make = QQ.from_sympy if exact else precise
    sums = [{key: Dual(*map(make, pair)) for key, pair in side.items()} for side in pairs]
    fluid = HalfSpace(lambda _: sums[0], lambda _: sums[-1], lambda *_: [])
    found = moments_of(operator, dim, degree, axis, make(eta), wall.ghosts, fluid)
    slopes = {a: m.slope if isinstance(m, Dual) else 0 * m for a, m in found.items()}
    if exact:
        return {alpha: QQ.to_sympy(QQ(slope)) for alpha, slope in slopes.items()}
    return {alpha: settled(slope) for alpha, slope in slopes.items()}


def precise(x: Expr) -> Any:
    """An exact number in 50 digits."""
    return real_context().mpf(str(x.evalf(60)))


def wall_order(
    responses: Callable[[int], dict[MultiIndex, Any] | None],
    aligned: bool,
    alpha: MultiIndex | None = None,
) -> int | None:
    """The power of Δx/h of the first term of a wall in M_α, in any moment for None; None if there
    is none up to MOST, or no power.

    responses: `wall_response` as a function of n
    aligned: the wall is at particles, of which half counts, or half-way, where odd powers vanish
    """
    for n in range(2 if aligned else 1, MOST + 1, 2 if aligned else 1):
        found = responses(n)
        if found is None:
            return None
        if any(found.values()) if alpha is None else found[alpha] != 0:
            return n
    return None
