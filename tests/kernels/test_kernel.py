"""Exact kernels against fractions: the oracle starts from the numbers that made the kernel."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError
from fractions import Fraction
from itertools import pairwise
from math import factorial, inf

import pytest
import sympy
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle import Shape, continuous_derivatives, fraction, integral, jump
from strategies import knot_lists, shapes
from sympy import Poly, Rational, pi

from sphtrunc import Kernel, kernel
from sphtrunc.kernels.arguments import rational
from sphtrunc.kernels.piecewise import q


def pruned(shape: Shape) -> Shape:
    """Without the zero pieces beyond the support."""
    knots, pieces = list(shape[0]), list(shape[1])
    while not any(pieces[-1]):
        pieces.pop()
        knots.pop()
    return Shape(knots, pieces)


# -- identities ------------------------------------------------------------------------------------


@given(shapes(), st.sampled_from([1, 2, 3]))
def test_normalisation_and_moments(shape: Shape, dim: int) -> None:
    k = Kernel(*shape)
    mass = integral(shape, dim - 1)
    sphere = {1: 2, 2: 2 * pi, 3: 4 * pi}[dim]
    assert sympy.simplify(k.normalisation(dim) * sphere * Rational(str(mass)) - 1) == 0
    for n in range(8):
        assert fraction(k.moment(n, dim)) == integral(shape, n + dim - 1) / mass
    assert k.moment(0, dim) == 1


@given(shapes(), st.sampled_from([1, 2, 3]))
def test_gradient_moments(shape: Shape, dim: int) -> None:
    k = Kernel(*shape)
    mass = integral(shape, dim - 1)
    for n in range(8):
        expected = integral(shape, n + dim - 1, derivative=1) / mass
        if dim == 1 and n % 2 == 0:
            expected = Fraction(0)  # sⁿ Ŵ′ is odd
        assert fraction(k.gradient_moment(n, dim)) == expected


@given(shapes(), st.sampled_from([1, 2, 3]))
def test_gradient_moments_by_parts(shape: Shape, dim: int) -> None:
    """∫ |s|ⁿ⁻¹ s·∇Ŵ = −(n+d−1) ∫ |s|ⁿ⁻¹ Ŵ − Σ jumps of Ŵ |p|^{n+d−1}: nothing else is missing."""
    k = Kernel(*shape)
    mass = integral(shape, dim - 1)
    for n in (1, 3, 5):
        steps = sum(
            (jump(shape, i, 0) * x ** (n + dim - 1) for i, x in enumerate(shape[0]) if i),
            Fraction(0),
        )
        by_parts = -(n + dim - 1) * fraction(k.moment(n - 1, dim)) - steps / mass
        assert fraction(k.gradient_moment(n, dim)) == by_parts


@given(shapes())
def test_jumps_at_every_knot(shape: Shape) -> None:
    k = Kernel(*shape)
    sigma = 1 / (2 * integral(shape, 0))
    for m in range(12):
        found = {fraction(p): fraction(j) for p, j in k.jumps(m).items()}
        assert list(found) == sorted(found)
        assert set(found) <= {s * x for x in shape[0] for s in (-1, 1)}
        for i, x in enumerate(shape[0]):
            expected = sigma * jump(shape, i, m)
            assert found.get(x, 0) == expected
            if i:
                assert found.get(-x, 0) == (-1) ** (m + 1) * expected


@given(shapes())
def test_smoothness_of_every_knot(shape: Shape) -> None:
    k = Kernel(*shape)
    shape = pruned(shape)
    orders = {x: continuous_derivatives(shape, i) for i, x in enumerate(shape[0])}
    found = {fraction(p): o for p, o in k.knot_smoothness().items()}
    for x, order in orders.items():
        assert found.get(x, inf) == order
    assert k.smoothness == min(orders.values())
    assert k.boundary_smoothness == orders[shape[0][-1]]
    assert fraction(k.support) == shape[0][-1]
    assert k.degree == max(i for p in shape[1] for i, c in enumerate(p) if c)


@given(shapes(), st.fractions(Fraction(1, 5), 5, max_denominator=9))
def test_scaled(shape: Shape, support: Fraction) -> None:
    k = Kernel(*shape)
    scaled = k.scaled(support=support)
    ratio = support / fraction(k.support)
    assert fraction(scaled.support) == support
    for dim in (1, 2, 3):
        for n in range(5):
            expected = fraction(k.moment(n, dim)) * ratio**n
            assert fraction(scaled.moment(n, dim)) == expected
    assert scaled.boundary_smoothness == k.boundary_smoothness
    assert list(scaled.knot_smoothness().values()) == list(k.knot_smoothness().values())
    assert scaled.scaled(k.support) == k
    # the same W: jumps of the m-th derivative grow by ratio^-(m+1), and stay in their places
    for m in range(4):
        stretched = {fraction(p) * ratio: j for p, j in k.jumps(m).items()}
        for p, j in scaled.jumps(m).items():
            assert fraction(j) == fraction(stretched[fraction(p)]) / ratio ** (m + 1)


# -- a kernel is a value ---------------------------------------------------------------------------


@given(shapes(most=4), st.data())
def test_canonical_form(shape: Shape, data: st.DataObject) -> None:
    """However a kernel is cut and whatever zeros follow, it is the same kernel."""
    knots, pieces = shape
    k = Kernel(knots, pieces)
    cut = data.draw(st.integers(0, len(pieces) - 1))
    middle = (knots[cut] + knots[cut + 1]) / 2
    more = Kernel(
        [*knots[: cut + 1], middle, *knots[cut + 1 :], knots[-1] + 1],
        [*pieces[: cut + 1], *pieces[cut:], [0, 0]],
        name="other",
        source="elsewhere",
    )
    assert more == k
    assert hash(more) == hash(k)
    assert len({more, k}) == 1
    assert more.knots == k.knots
    for a, b in pairwise(k.pieces):
        assert a != b
    assert any(k.coefficients()[-1])


@given(shapes(most=3))
def test_every_spelling_of_the_numbers(shape: Shape) -> None:
    knots, pieces = shape
    texts = Kernel([str(x) for x in knots], [[str(c) for c in p] for p in pieces])
    exact = Kernel(
        [Rational(str(x)) for x in knots],
        [Poly([Rational(str(c)) for c in reversed(p)] or [0], q) for p in pieces],
    )
    assert texts == exact == Kernel(knots, pieces)


@given(shapes(most=3))
def test_coefficients_make_the_same_kernel(shape: Shape) -> None:
    k = Kernel(*shape)
    assert Kernel(k.knots, k.coefficients()) == k
    assert all(isinstance(c, Rational) for piece in k.coefficients() for c in piece)


@given(shapes(most=3))
@settings(max_examples=30)
def test_pickle_and_copy(shape: Shape) -> None:
    k = Kernel(*shape, name="mine", source="nowhere")
    for twin in (pickle.loads(pickle.dumps(k)), copy.copy(k), copy.deepcopy(k)):
        assert twin == k
        assert hash(twin) == hash(k)
        assert (twin.name, twin.source) == ("mine", "nowhere")
        assert twin.moment(2, 3) == k.moment(2, 3)


@given(knot_lists())
@settings(max_examples=30)
def test_a_coefficient_more_or_less_is_another_kernel(knots: list[Fraction]) -> None:
    one = Kernel(knots, [[1 + i] for i in range(len(knots) - 1)])
    other = Kernel(knots, [[1 + i, Fraction(i == 0, 1000)] for i in range(len(knots) - 1)])
    assert one != other
    assert one != "one"


@pytest.mark.parametrize("attribute", ["knots", "pieces", "name", "source", "support", "anything"])
def test_immutable(attribute: str) -> None:
    k = Kernel([0, 1], [[1]])
    with pytest.raises((FrozenInstanceError, AttributeError)):
        setattr(k, attribute, 1)
    with pytest.raises((FrozenInstanceError, AttributeError)):
        delattr(k, attribute)
    assert k == Kernel([0, 1], [[1]])


def test_input_is_not_shared() -> None:
    knots, pieces = [0, 1, 2], [[1, 2], [3]]
    k = Kernel(knots, pieces)
    before = hash(k)
    knots.append(5)
    pieces[0].append(7)
    assert (hash(k), k.degree, k.support) == (before, 1, 2)


# -- by hand ---------------------------------------------------------------------------------------


def test_top_hat() -> None:
    k = Kernel([0, 2], [[1]])
    assert (k.boundary_smoothness, k.smoothness, k.degree) == (-1, -1, 0)
    assert k.knot_smoothness() == {0: inf, 2: -1}
    assert k.normalisation(1) == Rational(1, 4)
    assert k.normalisation(2) == 1 / (4 * pi)
    assert k.normalisation(3) == 3 / (32 * pi)
    assert k.jumps(0) == {-2: Rational(1, 4), 0: 0, 2: -Rational(1, 4)}
    assert k.jumps(1) == {-2: 0, 0: 0, 2: 0}
    assert k.moment(2, 1) == Rational(4, 3)
    assert k.gradient_moment(1) == 0  # the delta functions at the edge are not part of it


def test_hat() -> None:
    k = Kernel([0, 1], [[1, -1]])
    assert (k.boundary_smoothness, k.smoothness) == (0, 0)
    assert k.knot_smoothness() == {0: 0, 1: 0}
    assert k.jumps(1) == {-1: 1, 0: -2, 1: 1}
    assert k.gradient_moment(1) == -1


def test_shell_with_a_hole() -> None:
    """A kernel that is zero in the middle."""
    k = Kernel([0, 1, 2], [[0], [1]])
    assert (k.degree, k.smoothness, k.knot_smoothness()[0]) == (0, -1, inf)
    assert k.moment(1, 1) == Rational(3, 2)


def test_cubic_spline_limits() -> None:
    """β counts the edge, smoothness all knots: Wendland's C2 has a |s|³ kink at 0 in 1D."""
    assert kernel("cubic-spline").knot_smoothness() == {0: 2, 1: 2, 2: 2}
    assert kernel("wendland-c2").knot_smoothness() == {0: 2, 2: 3}
    c2 = kernel("wendland-c2")
    assert (c2.boundary_smoothness, c2.smoothness) == (3, 2)
    assert c2.jumps(3)[Rational(0)] == factorial(3) * 2 * c2.normalisation(1) * Rational(5, 2)


def test_negative_kernels_are_normalised_too() -> None:
    assert Kernel([0, 1], [[-1]]).normalisation(1) == -Rational(1, 2)
    assert Kernel([0, 1], [[-1]]).moment(0, 3) == 1


# -- refusals --------------------------------------------------------------------------------------

BAD_KERNELS = [
    ([], [], "knots"),
    ([0], [], "knots"),
    ([1, 2], [[1]], "first of them 0"),
    ([0, 2, 1], [[1], [2]], "increasing"),
    ([0, 1, 1], [[1], [2]], "increasing"),
    ([0, -1], [[1]], "increasing"),
    ([0, 1], [[1], [2]], "pieces: got 2 for 2 knots"),
    ([0, 1, 2], [[1]], "pieces: got 1 for 3 knots"),
    ([0, 1], [[0, 0]], "every piece is zero"),
    ([0, 1], [[]], "every piece is zero"),
    ([0, 1.5], [[1]], "float is not exact"),
    ([0, 1], [[0.5]], '"1/2"'),
    ([0, 1], [[True]], "True"),
    ([0, 1], [[None]], "None"),
    ([0, 1], [[1j]], "1j"),
    ([0, 1], [["1e3"]], "1e3"),
    ([0, 1], [["１"]], "rational"),
    ([0, 1], [["1_0"]], "rational"),
    ([0, 1], [["1/0"]], "rational"),
    ([0, 1], [["__import__('os')"]], "rational"),
    ([0, 1], [[float("nan")]], "nan"),
    ([0, float("inf")], [[1]], "inf"),
    ([0, 1], [[sympy.pi]], "pi"),
    ([0, 1], [[sympy.Float("0.5")]], "rational"),
    ([0, 1], [["9" * 2000]], "..."),
    ([0, 1], ["12"], "pieces"),
    ([0, 1], [5], "pieces"),
    ([0, 1], [Poly(0.5 * q, q)], "rational coefficients"),
    ([0, 1], [Poly(sympy.sqrt(2) * q, q)], "rational coefficients"),
    ([0, 1], [Poly(sympy.Symbol("x"))], "sphtrunc.kernels.piecewise.q"),
]


@pytest.mark.parametrize(("knots", "pieces", "hint"), BAD_KERNELS)
def test_bad_kernels(knots: list[object], pieces: list[object], hint: str) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011 (the hint is looked for below)
        Kernel(knots, pieces)
    assert hint in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("dim", [0, 4, -1, 1.0, "1", None, True, 10**30])
def test_bad_dimension(dim: object) -> None:
    k = Kernel([0, 1], [[1]])
    for call in (k.normalisation, lambda d: k.moment(2, d), lambda d: k.w(0.5, d)):
        with pytest.raises(ValueError, match="dim"):
            call(dim)


@pytest.mark.parametrize("n", [-1, 0.5, "2", None, True, 1j])
def test_bad_count(n: object) -> None:
    k = Kernel([0, 1], [[1]])
    for call in (k.moment, k.gradient_moment, k.jumps):
        with pytest.raises(ValueError, match="whole number"):
            call(n)


@pytest.mark.parametrize("support", [0, -1, "0", 1.5, "x", None])
def test_bad_support(support: object) -> None:
    with pytest.raises(ValueError, match="support"):
        Kernel([0, 1], [[1]]).scaled(support=support)


def test_zero_integral_is_refused_where_it_matters() -> None:
    k = Kernel([0, 1, 2], [[1], [-1]])  # in 1D; not in 2D and 3D
    with pytest.raises(ValueError, match="in 1D is zero"):
        k.normalisation(1)
    with pytest.raises(ValueError, match="cannot be normalised"):
        k.w(0.5)
    assert k.normalisation(2) == -1 / (2 * pi)
    assert k.moment(0, 3) == 1


@given(st.fractions(max_denominator=10**6))
def test_rational_takes_every_exact_spelling(x: Fraction) -> None:
    spellings = [x, str(x), f" {x} ", Rational(x.numerator, x.denominator)]
    assert {fraction(rational(s)) for s in spellings} == {x}


@given(st.decimals(-1000, 1000, places=6, allow_nan=False))
def test_decimals_are_exact(x: object) -> None:
    text = f"{x:f}"
    assert fraction(rational(text)) == Fraction(text)


@given(st.floats())
def test_no_float_is_taken(x: float) -> None:
    assume(x == x)
    with pytest.raises(ValueError, match="expected a rational"):
        rational(x)
