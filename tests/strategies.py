"""What tests draw from: operators; random kernels, ratios, offsets; texts that mean no good."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from itertools import pairwise, product

from hypothesis import strategies as st
from oracle import Shape, added, integral, multiplied

from sphtrunc import Kernel
from sphtrunc.operators import operator as tables
from sphtrunc.operators.operator import Operator

#: operators of every sort on scalar fields
OPERATORS = [
    Operator("value"),
    Operator("value", "difference"),
    Operator("value", "difference", "shepard"),
    Operator("gradient"),
    Operator("gradient", "difference"),
    Operator("gradient", "symmetric"),
    Operator("gradient", "standard", "shepard"),
    Operator("gradient", "difference", "csph"),
    Operator("gradient", "standard", "rkpm-1"),
    Operator("gradient", "standard", "rkpm-2"),
    Operator("laplacian", "brookshaw"),
    Operator("laplacian", "difference"),
    Operator("laplacian", "fatehi-manzari"),
    Operator("hessian", "difference"),
    Operator("laplacian", "nested"),
]


def operators(dim: int) -> list[Operator]:
    """Every operator that there is in this dimension: all that is not refused."""
    found = []
    for name, (_, forms) in tables.OPERATORS.items():
        for form, correction in product(forms, tables.CORRECTIONS):
            with suppress(ValueError):
                operator = Operator(name, form, correction)
                operator.components(dim)
                found.append(operator)
    return found


def rationals(low: int = -4, high: int = 4, denominator: int = 12) -> st.SearchStrategy[Fraction]:
    """Fractions between two integers."""
    return st.fractions(low, high, max_denominator=denominator)


#: Δx/h: any positive rational small enough that some neighbours lie within a support of 1 or more
ratios = st.fractions(Fraction(1, 8), Fraction(1), max_denominator=40)

#: θ: the offset of the lattice in units of Δx
offsets = st.fractions(-1, 1, max_denominator=24)


@st.composite
def knot_lists(draw: st.DrawFn, most: int = 6) -> list[Fraction]:
    """0 = k₀ < … < κ <= 6, one to `most` pieces."""
    steps = draw(
        st.lists(st.fractions(Fraction(1, 6), 1, max_denominator=6), min_size=1, max_size=most)
    )
    knots = [Fraction(0)]
    for step in steps:
        knots.append(knots[-1] + step)
    return knots


@st.composite
def shapes(draw: st.DrawFn, degree: int = 9, most: int = 6) -> Shape:
    """Knots and coefficients of a shape whose 1D, 2D and 3D integrals do not vanish.

    Three families: independent pieces (jumps everywhere), truncated powers Σ c_j (k_j − q)₊^n
    (continuous if n > 0), and either with even powers only.
    """
    knots = draw(knot_lists(most))
    family = draw(st.sampled_from(["pieces", "even pieces", "powers", "even powers"]))
    top = draw(st.integers(0, degree))
    coefficient = rationals()
    if family.endswith("pieces"):
        pieces = []
        for _ in knots[1:]:
            piece = draw(st.lists(coefficient, min_size=1, max_size=top + 1))
            if family.startswith("even"):
                piece = [c if i % 2 == 0 else Fraction(0) for i, c in enumerate(piece)]
            pieces.append(piece)
    else:
        even = family.startswith("even")
        pieces = [[Fraction(0)] * (degree + 1) for _ in knots[1:]]
        for j, knot in enumerate(knots[1:]):
            c = draw(coefficient)
            n = draw(st.integers(0, top // 2 if even else top))
            # (k² − q²)^n or (k − q)^n, added to every piece inside the knot
            power = [Fraction(1)]
            factor = [knot**2, Fraction(0), Fraction(-1)] if even else [knot, Fraction(-1)]
            for _ in range(n):
                power = multiplied(power, factor)
            for piece in pieces[: j + 1]:
                for i, value in enumerate(power):
                    piece[i] += c * value
    if not all(integral(Shape(knots, pieces), d) for d in range(3)):
        pieces[0] = [pieces[0][0] + Fraction(101), *pieces[0][1:]]
    if not all(integral(Shape(knots, pieces), d) for d in range(3)):
        knots, pieces = [Fraction(0), Fraction(1)], [[Fraction(1)]]
    return Shape(knots, pieces)


@st.composite
def kernels(draw: st.DrawFn, degree: int = 9, most: int = 6) -> Kernel:
    """Random rational kernels: 1 to `most` pieces, with and without odd powers and jumps."""
    return Kernel(*draw(shapes(degree, most)), name="random")


@st.composite
def positive_shapes(draw: st.DrawFn, degree: int = 9, most: int = 4) -> Shape:
    """Shapes that are positive inside the support: Bernstein polynomials with weights >= 0.

    Weights of zero at either end let a piece vanish there to any order.
    """
    knots = draw(knot_lists(most))
    pieces = []
    for a, b in pairwise(knots):
        n = draw(st.integers(0, degree))
        weights = draw(
            st.lists(
                st.one_of(st.just(Fraction(0)), st.fractions(0, 3, max_denominator=8)),
                min_size=n + 1,
                max_size=n + 1,
            ).filter(any)
        )
        piece = [Fraction(0)]
        for i, weight in enumerate(weights):
            term = [weight]
            for _ in range(i):
                term = multiplied(term, [-a, Fraction(1)])
            for _ in range(n - i):
                term = multiplied(term, [b, Fraction(-1)])
            piece = added(piece, term)
        pieces.append(piece)
    return Shape(knots, pieces)


FRAGMENTS = [
    *"0123456789q.;:+-*/^()[]{},=_ '\"\\\n\t%#@!&|<>~`$?eEjλ²½٣０\x00",
    *[
        "..",
        "**",
        "pos(",
        "0..2:",
        "(2-q)",
        "^3",
        "1/0",
        "0/0",
        "9**9**9",
        "q**(10**9)",
        "--",
        "+-",
    ],
    *["__import__('os').system('id')", "exec(", "eval(", "open(", "lambda q:", "import os", "nan"],
    *[
        "inf",
        "1e400",
        "q.diff()",
        "Symbol('q')",
        "cubic-spline",
        "b-spline:",
        "polynomial:",
        ".toml",
    ],
    *["0.1", "1/3", "2..1:", "0..1:", "pos(q)", "pos(pos(q))", ".json", "None", "__class__"],
]

#: anything: text of every kind, and fragments of formulas and of code in any order
hostile_texts = st.one_of(
    st.text(max_size=60),
    st.lists(st.sampled_from(FRAGMENTS), max_size=14).map("".join),
)
