"""Walls: cut moments in closed form, Euler–Maclaurin with a wall, ghosts, on lattices.

The oracle is a sum particle by particle in fractions that shares no code with what it judges: it
evaluates the pieces itself, and reads fields at places, not through moments.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import kernels, ratios
from sympy import Rational, log, pi

from sphtrunc import Kernel, derive, kernel
from sphtrunc.kernels.catalogue import names
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.walls import GHOSTS, Wall
from sphtrunc.theory.walls.half_space import (
    ETA,
    cut_pieces,
    cut_sum,
    marginal,
    moment_pieces,
    plane,
)
from sphtrunc.theory.walls.moments import cut_lattice_sums, cut_moments, wall_lattice_moments
from sphtrunc.theory.walls.orders import wall_order, wall_response
from sphtrunc.theory.walls.remedies import REMEDIES, remedies

DEEP = settings().max_examples if settings().max_examples > 1000 else None
HALF = Fraction(1, 2)
R = Rational


def examples(count: int) -> settings:
    """`count` of them in CI, more in the deep profile."""
    return settings(max_examples=DEEP or count)


def whole(x: Any) -> Fraction:
    return Fraction(int(x.p), int(x.q)) if isinstance(x, Rational) else Fraction(x)


# ------------------------------------------------------------------------------------- the oracle


class Direct:
    """A kernel in 1D as functions of s in fractions, normalised; at a knot the mean of sides."""

    def __init__(self, shape: Kernel) -> None:
        self.knots = [whole(k) for k in shape.knots]
        self.pieces = [[whole(c) for c in piece] for piece in shape.coefficients()]
        mass = sum(
            c * (b ** (i + 1) - a ** (i + 1)) / (i + 1)
            for a, b, piece in zip(self.knots, self.knots[1:], self.pieces, strict=False)
            for i, c in enumerate(piece)
        )
        self.pieces = [[c / (2 * mass) for c in piece] for piece in self.pieces]
        slopes = [[i * c for i, c in enumerate(piece)][1:] for piece in self.pieces]
        curves = [[i * c for i, c in enumerate(piece)][1:] for piece in slopes]
        self.rows = [self.pieces, slopes, curves]

    def at(self, s: Fraction, derivative: int) -> Fraction:
        """(−1)^δ Ŵ^(δ)(s)."""
        q = abs(s)
        sides = [
            piece
            for a, b, piece in zip(self.knots, self.knots[1:], self.rows[derivative], strict=False)
            if a <= q <= b
        ]
        if q == self.knots[-1]:
            sides.append([])
        if not sides or (s == 0 and derivative == 1):
            return Fraction(0)
        value = sum(
            (sum((c * q**i for i, c in enumerate(piece)), Fraction(0)) for piece in sides),
            Fraction(0),
        ) / len(sides)
        return -value if derivative == 1 and s > 0 else value


def fluid(
    eta: Fraction, ratio: Fraction, theta: Fraction, reach: Fraction, weight: Fraction
) -> list[tuple[Fraction, Fraction]]:
    """(s, share) of the particles between the wall and s = reach."""
    found = []
    for j in range(int((-reach - 1) / ratio - theta) - 2, int((reach + 1) / ratio - theta) + 3):
        s = (j + theta) * ratio
        if -eta <= s <= reach:
            found.append((s, weight if s == -eta else Fraction(1)))
    return found


# ----------------------------------------------------------------------- Euler–Maclaurin and a wall

etas = st.fractions(0, 3, max_denominator=30)


@examples(1000)
@given(
    kernels(degree=5, most=3),
    etas,
    st.one_of(st.sampled_from([Fraction(0), HALF]), st.fractions(0, 1, max_denominator=9)),
    ratios,
    st.integers(0, 2),
    st.integers(0, 4),
    st.sampled_from([HALF, Fraction(1)]),
)
@example(kernel("cubic-spline"), Fraction(0), Fraction(0), HALF, 1, 0, Fraction(1))  # on the target
@example(kernel("polynomial:-1"), Fraction(1), Fraction(0), HALF, 0, 0, HALF)  # a top-hat
@example(kernel("polynomial:-1"), Fraction(2), Fraction(0), HALF, 0, 0, HALF)  # cut at its edge
@example(kernel("spiky"), Fraction(0), Fraction(0), Fraction(1, 3), 1, 0, Fraction(1))
def test_euler_maclaurin_with_a_wall_is_the_sum_particle_by_particle(
    shape: Kernel,
    eta: Fraction,
    at: Fraction,
    ratio: Fraction,
    delta: int,
    k: int,
    weight: Fraction,
) -> None:
    """Equal as fractions: any kernel, distance, place of the wall in the lattice, ratio, moment."""
    theta = at - eta / ratio
    delta = delta if shape.smoothness >= 1 else min(delta, 1)
    key = (delta,), (k,)
    r, t, e, w = (Rational(x.numerator, x.denominator) for x in (ratio, theta, eta, weight))
    found = cut_lattice_sums(shape, [key], e, r, t, w)[key]
    direct = Direct(shape)
    expected = ratio * sum(
        (
            share * s**k * direct.at(s, delta)
            for s, share in fluid(eta, ratio, theta, direct.knots[-1], weight)
        ),
        Fraction(0),
    )
    assert whole(found) == expected


@pytest.mark.parametrize("operator", ["value", "gradient"])
@pytest.mark.parametrize("at", ["particle", "half-way", "2/7"])
def test_knots_and_planes_are_the_same_sum(operator: str, at: str) -> None:
    """Two derivations of the same exact numbers: by the knots, and plane by plane."""
    shape = kernel("quintic-spline")
    found = derive(shape, operator, degree=3, dx_over_h="4/7", wall="5/9", wall_at=at)
    place = {"particle": Fraction(0), "half-way": HALF, "2/7": Fraction(2, 7)}[at]
    scene = Arrangement("uniform", Fraction(4, 7)).beside(Wall(Fraction(5, 9), place))
    planes = wall_lattice_moments(shape, Operator(operator), scene, 3)
    assert found.discrete is not None
    assert dict(found.discrete.values) == planes


# ------------------------------------------------------------------------------------- closed forms


def radial(shape: Kernel, dim: int) -> tuple[list[Any], list[Any], Any]:
    """Knots, pieces and σ_d of a kernel in mpmath."""
    knots = [mpmath.mpf(int(k.p)) / int(k.q) for k in shape.knots]
    pieces = [[mpmath.mpf(int(c.p)) / int(c.q) for c in p] for p in shape.coefficients()]
    mass = sum(
        c * (b ** (i + dim) - a ** (i + dim)) / (i + dim)
        for a, b, piece in zip(knots, knots[1:], pieces, strict=False)
        for i, c in enumerate(piece)
    )
    return knots, pieces, 1 / ({1: 2, 2: 2 * mpmath.pi, 3: 4 * mpmath.pi}[dim] * mass)


@pytest.mark.parametrize("name", names())
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_marginal_of_every_kernel(name: str, dim: int) -> None:
    """Against integration over the plane with mpmath, across it, knot by knot: 14 digits."""
    shape = kernel(name)
    at = R(7, 22) * shape.support
    with mpmath.workdps(25):
        knots, pieces, sigma = radial(shape, dim)
        z = mpmath.mpf(int(at.p)) / int(at.q)

        def w(q: Any) -> Any:
            piece = next((p for b, p in zip(knots[1:], pieces, strict=True) if q <= b), [0])
            return mpmath.polyval(list(reversed(piece)), q)

        ends = [mpmath.sqrt(k**2 - z**2) for k in knots if k > z]
        if dim == 1:
            expected = sigma * w(z)
        else:
            across = [2, 2 * mpmath.pi][dim - 2]
            expected = (
                across
                * sigma
                * mpmath.quad(lambda x: w(mpmath.sqrt(x**2 + z**2)) * x ** (dim - 2), [0, *ends])
            )
        zero = unit(dim, 0, 0)
        found = mpmath.mpf(str(plane(shape, (zero, zero), at).evalf(25)))
        assert abs(found - expected) <= mpmath.mpf(10) ** -14 * abs(sigma * w(mpmath.mpf(0)))


@pytest.mark.parametrize("name", [n for n in names() if len(kernel(n).pieces) <= 4])
def test_moments_are_integrals_of_the_marginal(name: str) -> None:
    """d m_k/dη = (−η)^k Ŵ_⊥(η), polynomial by polynomial, and at η = κ nothing is cut."""
    shape = kernel(name)
    for dim, k in ((1, 3), (3, 1)):
        pieces = moment_pieces(shape, k, dim)
        for (_, _, m), (_, _, w) in zip(pieces, marginal(shape, dim), strict=True):
            assert (m.diff(ETA) - (-ETA) ** k * w).expand() == 0
        far = cut_sum(shape, (unit(dim, 0, 0), unit(dim, 0, k)), shape.support + 1)
        assert pieces[-1][2].subs(ETA, shape.support) == far


@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "linear-quartic"])
@pytest.mark.parametrize("key", [((0, 0), (1, 2)), ((1, 0), (2, 0)), ((0, 1), (1, 1))])
def test_sums_in_two_dimensions_are_integrals_over_planes(name: str, key: Any) -> None:
    """The slope of roots, arcosh and arccos is the plane integral at −η, and at κ nothing is."""
    shape, eta = kernel(name), R(3, 7)
    pieces = cut_pieces(shape, key)
    slope = pieces[0][2].diff(ETA).subs(ETA, eta) - plane(shape, key, -eta)
    assert abs(slope.evalf(30, chop=False)) < 1e-25
    edge = pieces[-1][2].subs(ETA, shape.support) - cut_sum(shape, key, shape.support + 1)
    assert abs(edge.evalf(30)) < 1e-25


def test_a_sum_in_two_dimensions() -> None:
    """∫ s₁ s₂² Ŵ over z > −η against integration in polar coordinates."""
    shape, eta = kernel("cubic-spline"), R(3, 7)
    with mpmath.workdps(16):
        knots, pieces, sigma = radial(shape, 2)
        e = mpmath.mpf(3) / 7

        def over(q: Any) -> Any:
            i = next(i for i, b in enumerate(knots[1:]) if q <= b)
            w = mpmath.polyval(list(reversed(pieces[i])), q)
            # of cos t sin² t from 0 to the angle where cos t = −η/q
            return 2 * sigma * w * q**4 * mpmath.sin(mpmath.acos(-e / q)) ** 3 / 3

        expected = mpmath.quad(over, [e, 1, 2])
        found = mpmath.mpf(str(cut_sum(shape, ((0, 0), (1, 2)), eta).evalf(20)))
        assert abs(found - expected) < mpmath.mpf(10) ** -14


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_fifty_digits_are_those_of_the_exact_number(dim: int) -> None:
    shape, ctx = kernel("quartic-spline"), mpmath.mp.clone()
    ctx.dps = 50
    for key in Operator("laplacian", "direct").needed(dim, 1):
        for eta in (R(0), R(4, 9), R(-4, 9)):
            exact = cut_sum(shape, key, eta)
            assert abs(
                cut_sum(shape, key, ctx.mpf(eta.p) / eta.q) - ctx.mpf(str(exact.evalf(55)))
            ) < (ctx.mpf(10) ** -44)


#: (kernel, dim, η): Ŵ_⊥, m₀, m₁, M_n, M_2n/M_n of a gradient
TABLE = {
    ("cubic-spline", 1, 0): ("2/3", "1/2", "7/30", "1/2", "14/15"),
    ("cubic-spline", 1, HALF): ("23/48", "307/384", "13/80", "215/384", "854/1075"),
    ("cubic-spline", 1, 1): ("1/6", "23/24", "1/20", "19/24", "32/95"),
    ("wendland-c2-1d", 1, 0): ("5/8", "1/2", "1/4", "1/2", "1"),
    ("wendland-c2-1d", 1, HALF): (
        "945/2048", "3205/4096", "2997/16384", "565/1024", "1971/2260"
    ),
    ("wendland-c2-1d", 1, 1): ("25/128", "121/128", "17/256", "3/4", "7/16"),
    ("cubic-spline", 3, 0): ("7/10", "1/2", "31/140", "1/2", "31/35"),
    ("cubic-spline", 3, HALF): (
        "39/80", "3119/3840", "2651/17920", "2183/3840", "11229/15281"
    ),
    ("cubic-spline", 3, 1): ("3/20", "29/30", "11/280", "49/60", "96/343"),
    ("wendland-c2", 3, 0): ("3/4", "1/2", "5/24", "1/2", "5/6"),
    ("wendland-c2", 3, HALF): (
        "8019/16384", "108473/131072", "69255/524288", "76397/131072", "101331/152794"
    ),
    ("wendland-c2", 3, 1): ("33/256", "499/512", "181/6144", "433/512", "577/2598"),
}  # fmt: skip


@pytest.mark.parametrize("place", TABLE, ids=str)
def test_moments_of_the_cut_support(place: Any) -> None:
    """Computed by an independent prototype in fractions. γ = m₀ of the cubic spline in 3D, at a
    quarter and a half of its support: 3119/3840, 29/30."""
    name, dim, eta = place
    shape, at = kernel(name), R(Fraction(eta).numerator, Fraction(eta).denominator)
    zero, one, two = (unit(dim, 0, n) for n in range(3))
    normal = cut_sum(shape, (one, one), at)
    found = [
        plane(shape, (zero, zero), at),
        cut_sum(shape, (zero, zero), at),
        cut_sum(shape, (zero, one), at),
        normal,
        cut_sum(shape, (one, two), at) / normal,
    ]
    assert found == [R(x) for x in TABLE[place]]
    assert cut_sum(shape, (one, zero), at) == found[0]


#: (kernel, η), 2D: the same, and P₂ of RKPM-1, of a prototype in floats; digits as printed
FLAT = {
    ("cubic-spline", 0): (
        None, 0.5, 0.22736420442, 0.5, 0.90945681767, -0.2191199199
    ),
    ("cubic-spline", HALF): (
        0.48393342826, 0.80579671046, 0.15517085241, 0.56382999633, 0.76499133548, 0.10694930151
    ),
    ("cubic-spline", 1): (
        0.15862294424, 0.96255783573, 0.044516114095, 0.80393489149, 0.30805376785, 0.26309827283
    ),
    ("wendland-c2", 0): (
        None, 0.5, 0.21220659079, 0.5, 0.84882636316, -0.19361762253
    ),
    ("wendland-c2", HALF): (
        0.48373139796, 0.8234969143, 0.13697944466, 0.58163121532, 0.67893835202, 0.10595760908
    ),
    ("wendland-c2", 1): (
        0.13633059941, 0.97149093704, 0.033327501758, 0.83516033763, 0.24304985975, 0.23954428425
    ),
}  # fmt: skip
MARGINAL_ON_WALL = {"cubic-spline": R(15, 7) / pi, "wendland-c2": R(7, 3) / pi}


@pytest.mark.parametrize("place", FLAT, ids=str)
def test_moments_of_the_cut_support_in_two_dimensions(place: Any) -> None:
    """Within half a unit of the last of the ten digits that all of them have."""
    name, eta = place
    shape, at = kernel(name), R(Fraction(eta).numerator, Fraction(eta).denominator)
    zero, one, two = (unit(2, 0, n) for n in range(3))
    normal = cut_sum(shape, (one, one), at)
    on_plane = plane(shape, (zero, zero), at)
    found = [
        on_plane,
        cut_sum(shape, (zero, zero), at),
        cut_sum(shape, (zero, one), at),
        normal,
        cut_sum(shape, (one, two), at) / normal,
        2 * rows(name, 2, str(at), "rkpm-1")["value", "all", "rkpm-1", "A_nn"][1],
    ]
    wanted = [MARGINAL_ON_WALL[name].evalf(15) if x is None else x for x in FLAT[place]]
    for value, printed in zip(found, wanted, strict=True):
        assert abs(float(value) - float(printed)) <= 5e-11
    assert at != 0 or (on_plane - MARGINAL_ON_WALL[name]).equals(0)


def test_the_marginal_kernel_in_words() -> None:
    cubic, wendland = (marginal(kernel(n), 3) for n in ("cubic-spline", "wendland-c2"))
    e = ETA
    assert (cubic[0][2] - (14 - 20 * e**2 + 15 * e**4 - 6 * e**5) / 20).expand() == 0
    assert (cubic[1][2] - (2 - e) ** 4 * (1 + 2 * e) / 20).expand() == 0
    assert (wendland[0][2] - 3 * (2 - e) ** 5 * (4 * e**2 + 5 * e + 2) / 256).expand() == 0
    zero = (0, 0)
    assert plane(kernel("cubic-spline"), (zero, zero), R(0)) == 15 / (7 * pi)
    assert plane(kernel("wendland-c2"), (zero, zero), R(0)) == 7 / (3 * pi)


@pytest.mark.parametrize("name", ["quartic-spline", "wendland-c4-1d", "polynomial:1", "spiky"])
@pytest.mark.parametrize("dim", [1, 3])
def test_a_gradient_is_its_value_by_parts(name: str, dim: int) -> None:
    """M_kn = (−η)^k Ŵ_⊥(η) + k m_{k−1}, as functions of η."""
    shape = kernel(name)
    for k in (1, 2):
        slopes = cut_pieces(shape, (unit(dim, 0), unit(dim, 0, k)))
        lower, planes = moment_pieces(shape, k - 1, dim), marginal(shape, dim)
        for (_, _, slope), (_, _, m), (_, _, w) in zip(slopes, lower, planes, strict=True):
            assert (slope - (-ETA) ** k * w - k * m).expand() == 0


# ------------------------------------------------------------------------------------------- ghosts


def places(kind: str, eta: Fraction, s: Fraction) -> list[tuple[int, Fraction]]:
    """Where the ghost at s reads the field, and how often."""
    image = -2 * eta - s
    return [(1, image)] if kind == "mirror" else [(2, -eta), (-1, image)]


@examples(120)
@given(
    st.sampled_from(["cubic-spline", "wendland-c2-1d", "polynomial:2", "spiky"]),
    st.sampled_from(["mirror", "odd"]),
    st.sampled_from(["value", "shepard", "gradient", "brookshaw"]),
    st.fractions(0, 2, max_denominator=12),
    st.sampled_from([Fraction(0), HALF, Fraction(1, 3), Fraction(4, 5)]),
    st.fractions(Fraction(1, 6), Fraction(3, 4), max_denominator=12),
    st.integers(1, 4),
)
def test_images_are_summed_particle_by_particle(
    name: str, ghosts: str, sort: str, eta: Fraction, at: Fraction, ratio: Fraction, k: int
) -> None:
    """As fractions: the ghosts as particles, that read s^k where their original is."""
    operator = {
        "value": Operator("value"),
        "shepard": Operator("value", "standard", "shepard"),
        "gradient": Operator("gradient"),
        "brookshaw": Operator("laplacian", "brookshaw"),
    }[sort]
    shape = kernel(name)
    scene = Arrangement("uniform", ratio).beside(Wall(eta, at, ghosts))
    found = wall_lattice_moments(shape, operator, scene, k)[(k,)]
    direct = Direct(shape)

    def weight(s: Fraction) -> Fraction:
        if sort == "brookshaw":
            return 2 * direct.at(s, 1) / s if s else Fraction(0)
        return direct.at(s, 1 if sort == "gradient" else 0)

    own = fluid(eta, ratio, at - eta / ratio, direct.knots[-1] + 2 * eta, HALF)
    total = sum(share * weight(s) * s**k for s, share in own)
    mass = sum(share * weight(s) for s, share in own)
    for s, share in own:
        image = -2 * eta - s
        mass += share * weight(image)
        total += share * weight(image) * sum(n * x**k for n, x in places(ghosts, eta, image))
    assert whole(found) == (total / mass if sort == "shepard" else ratio * total)


@examples(25)
@given(
    st.sampled_from(["cubic-spline", "wendland-c2-1d"]),
    st.sampled_from(["value", "gradient"]),
    st.integers(0, 3),
    st.sampled_from([Fraction(0), HALF, Fraction(1, 3)]),
    st.fractions(Fraction(1, 5), Fraction(1, 2), max_denominator=9),
    st.integers(1, 3),
)
def test_dummies_have_means_of_the_fluid(
    name: str, sort: str, plane_of_target: int, at: Fraction, ratio: Fraction, k: int
) -> None:
    """As fractions, of a target that is a particle: every dummy has its own Shepard mean."""
    shape, eta = kernel(name), (plane_of_target + at) * ratio
    scene = Arrangement("uniform", ratio).beside(Wall(eta, at, "dummy"))
    found = wall_lattice_moments(shape, Operator(sort), scene, k)[(k,)]
    direct, delta = Direct(shape), int(sort == "gradient")
    kappa = direct.knots[-1]
    own = [s for s, _ in fluid(eta, ratio, Fraction(0), 3 * kappa, Fraction(1))]
    total = sum(direct.at(s, delta) * s**k for s in own)
    j = 1
    while (dummy := min(own) - j * ratio) >= -kappa:
        near = [(direct.at(c - dummy, 0), c) for c in own]
        density = sum(w for w, _ in near)
        mean = sum(w * c**k for w, c in near) / density if density else Fraction(0)
        total += direct.at(dummy, delta) * mean
        j += 1
    assert whole(found) == ratio * total


def test_a_mirror_of_an_even_lattice_is_the_lattice() -> None:
    """Half-way and at a particle the images continue the lattice: Σ W V is that of the interior."""
    shape = kernel("wendland-c4-1d")
    for at in (Fraction(0), HALF):
        scene = Arrangement("uniform", HALF).beside(Wall((2 + at) * HALF, at, "mirror"))
        found = wall_lattice_moments(shape, Operator("value"), scene, 0)
        interior = derive(shape, "value", degree=0, dx_over_h="1/2").discrete
        assert interior is not None
        assert found[(0,)] == interior[0]


# ------------------------------------------------------------------------ the limit, and its orders


@pytest.mark.parametrize("ghosts", GHOSTS[:3])
@pytest.mark.parametrize("dim", [1, 3])
@pytest.mark.parametrize(
    "operator",
    [
        Operator("value"),
        Operator("gradient", "difference", "csph"),
        Operator("gradient", "standard", "rkpm-1"),
        Operator("value", "standard", "shepard"),
    ],
    ids=str,
)
def test_functions_of_the_distance(operator: Operator, dim: int, ghosts: str) -> None:
    """With η open the moments are functions, whose values are those at a given η."""
    found = derive("cubic-spline", operator, dim=dim, degree=2, wall="eta", ghosts=ghosts)
    assert found.wall is not None
    for (low, high, moments), eta in zip(found.wall.pieces, ("2/7", "5/4"), strict=True):
        assert low < R(eta) < high
        at = derive("cubic-spline", operator, dim=dim, degree=2, wall=eta, ghosts=ghosts).limit
        assert {a: m.subs(ETA, R(eta)) for a, m in moments.items()} == dict(at.values)


CASES = [
    (Operator("value"), "none"),
    (Operator("gradient"), "none"),
    (Operator("gradient", "difference", "csph"), "none"),
    (Operator("value", "standard", "rkpm-1"), "none"),
    (Operator("laplacian", "brookshaw"), "mirror"),
    (Operator("gradient"), "odd"),
]


@pytest.mark.parametrize(("operator", "ghosts"), CASES, ids=str)
@pytest.mark.parametrize("at", [HALF, Fraction(0), Fraction(1, 5)])
def test_the_order_in_the_spacing_is_reached_and_not_exceeded(
    operator: Operator, ghosts: str, at: Fraction
) -> None:
    """First order anywhere, second where the wall is half-way or at particles, with the coefficient
    that is derived: a power too much or too few would be a factor of two between the ratios."""
    shape, alpha, eta = kernel("quintic-spline"), (2,), Fraction(3, 7)
    wall = Wall(eta, at, ghosts)

    def response(n: int) -> Any:
        return wall_response(shape, operator, 1, 2, wall, n)

    aligned = (2 * at).denominator == 1
    order = wall_order(response, aligned, alpha)
    assert order == (1 if not aligned else 4 if ghosts == "odd" else 2)
    limit = cut_moments(shape, operator, 1, 2, wall)[alpha]
    bernoulli = {
        (1, Fraction(1, 5)): R(3, 10),
        (2, HALF): R(-1, 12),
        (2, Fraction(0)): R(1, 6),
        (4, HALF): R(7, 240),
        (4, Fraction(0)): R(-1, 30),
    }[order, at]
    seen = []
    for ratio in (Fraction(1, 20), Fraction(1, 40)):
        moments = wall_lattice_moments(
            shape, operator, Arrangement("uniform", ratio).beside(wall), 2
        )
        step = R(ratio.numerator, ratio.denominator)
        seen.append(float((moments[alpha] - limit) / (response(order)[alpha] * bernoulli)))
        seen[-1] /= float(step**order)
    assert abs(seen[0] - 1) < 0.06
    assert abs(seen[1] - 1) < 0.03


def test_integrals_over_layers_are_limits_of_sums() -> None:
    """Dummies and the nested form: what is integrated is what fine particles tend to."""
    shape = kernel("cubic-spline")
    for operator, ghosts in (
        (Operator("value"), "dummy"),
        (Operator("laplacian", "nested"), "none"),
    ):
        wall = Wall(HALF, HALF, ghosts)
        limit = cut_moments(shape, operator, 1, 2, wall)[(2,)]
        far, near = (
            wall_lattice_moments(shape, operator, Arrangement("uniform", r).beside(wall), 2)[(2,)]
            - limit
            for r in (Fraction(1, 15), Fraction(1, 30))
        )
        assert 3.4 < float(far / near) < 4.6


# ------------------------------------------------------------------------------------- remedies


def rows(name: str, dim: int, eta: str, *chosen: str) -> dict[Any, Any]:
    """(operator, component, remedy, derivative) -> (order, coefficient)."""
    return {
        (r.operator, r.component, r.remedy, r.derivative): (r.order_h, r.coefficient)
        for r in remedies(kernel(name), dim, [eta], chosen or None)
    }


def test_what_each_remedy_leaves_at_the_wall() -> None:
    """Cubic spline in 1D at η = 0, by an independent prototype."""
    exact = [n for n in REMEDIES if n != "dummy"]
    found = rows("cubic-spline", 1, "0", *exact)
    expected = {
        ("value", "all", "bare", "A"): (0, "-1/2"),
        ("value", "all", "shepard", "A_n"): (1, "7/15"),
        ("value", "all", "rkpm-1", "A_nn"): (2, "-3/26"),
        ("value", "all", "mirror", "A_n"): (1, "7/15"),
        ("value", "all", "odd", ""): (None, "0"),
        ("gradient", "normal", "bare", "A"): (-1, "2/3"),
        ("gradient", "normal", "difference", "A_n"): (0, "-1/2"),
        ("gradient", "normal", "csph", "A_nn"): (1, "7/15"),
        ("gradient", "normal", "gamma", "A_nn"): (1, "7/15"),
        ("gradient", "normal", "rkpm-1", "A_nn"): (1, "75/169"),
        ("gradient", "normal", "mirror", "A_n"): (0, "-1"),
        ("gradient", "normal", "odd", "A_nn"): (1, "7/15"),
        ("laplacian", "all", "bare", "A_n"): (-1, "4/3"),
        ("laplacian", "all", "mirror", "A_n"): (-1, "8/3"),
        ("laplacian", "all", "odd", "A_nn"): (0, "-1"),
    }
    for place, (order, coefficient) in expected.items():
        assert found[place] == (order, R(coefficient)), place
    third = found["value", "all", "rkpm-2", "A_nnn"], found["gradient", "normal", "rkpm-2", "A_nnn"]
    assert [order for order, _ in third] == [3, 2]
    assert float(third[0][1]) == pytest.approx(0.1176488872 / 6, rel=1e-9)
    assert float(third[1][1]) == pytest.approx(-0.8693116211 / 6, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "dim", "eta", "place", "coefficient"),
    [
        ("wendland-c2-1d", 1, "0", ("gradient", "normal", "rkpm-1", "A_nn"), "1180/2541"),
        ("cubic-spline", 1, "1", ("value", "all", "rkpm-1", "A_nn"), "15943/117201"),
        ("cubic-spline", 1, "1", ("gradient", "normal", "rkpm-1", "A_nn"), "65111380/654098781"),
        ("cubic-spline", 3, "0", ("gradient", "normal", "rkpm-1", "A_nn"), "1306487/3108972"),
        ("wendland-c2", 3, "0", ("gradient", "normal", "rkpm-1", "A_nn"), "98496/246895"),
        ("cubic-spline", 3, "1", ("value", "all", "rkpm-1", "A_nn"), "87139/685844"),
        ("wendland-c2", 3, "0", ("gradient", "tangential", "csph", "A_nt"), "5/12"),
        ("wendland-c2-1d", 1, "1/2", ("laplacian", "all", "mirror", "A_n"), "405/512"),
        ("wendland-c2-1d", 1, "1/2", ("laplacian", "all", "odd", "A_nn"), "-243/1024"),
        ("cubic-spline", 3, "1/2", ("laplacian", "all", "mirror", "A_n"), "239/320"),
        ("cubic-spline", 3, "1/2", ("laplacian", "all", "odd", "A_nn"), "-145/768"),
        ("wendland-c2", 3, "1/2", ("laplacian", "all", "mirror", "A_n"), "729/1024"),
        ("wendland-c2", 3, "1/2", ("laplacian", "all", "odd", "A_nn"), "-10935/65536"),
    ],
)  # fmt: skip
def test_coefficients_away_from_the_wall(
    name: str, dim: int, eta: str, place: Any, coefficient: str
) -> None:
    assert rows(name, dim, eta, place[2])[place][1] == R(coefficient)


def test_logarithms_are_exact_too() -> None:
    found = rows("cubic-spline", 1, "1/2", "mirror", "odd")
    assert (found["laplacian", "all", "mirror", "A_n"][1] - 4 * (R(85, 96) - log(2))).expand() == 0
    assert (found["laplacian", "all", "odd", "A_nn"][1] + log(2) - R(31, 64)).expand() == 0


def test_far_from_the_wall_every_remedy_is_the_interior() -> None:
    names_ = [n for n in REMEDIES if n not in ("rkpm-2", "dummy")]
    interior = {("value", "A_nn"), ("value", "A_tt")}
    found = rows("cubic-spline", 3, "2", *names_)
    for (operator, _, _, derivative), (order, coefficient) in found.items():
        assert order == 2
        assert operator != "value" or (operator, derivative) in interior
        assert coefficient > 0
    for name in names_[:3]:
        assert found["value", "all", name, "A_nn"][1] == R(3, 20)
        assert found["value", "all", name, "A_tt"][1] == R(3, 20)
