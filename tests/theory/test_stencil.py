"""Stencils as values: their moments are those that are derived, products are the nested form, and
the symbol of a gradient is what it makes of a wave."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil, floor

import mpmath
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle import Shape, fraction, mass, mean_value, shape_of
from strategies import offsets

from sphtrunc import derive, kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.theory.stencil import stencils

DEEP = settings().max_examples if settings().max_examples > 1000 else None
NAMES = ("cubic-spline", "quintic-spline", "wendland-c2-1d", "polynomial:2")
RATIOS = st.fractions(Fraction(1, 4), Fraction(4, 5), max_denominator=12)


def gradient(shape: Shape, dx: Fraction, theta: Fraction) -> dict[Fraction, Fraction]:
    """s -> −Δx Ŵ′(s), by hand."""
    reach = shape.knots[-1]
    found = {}
    for j in range(ceil(-reach / dx - theta), floor(reach / dx - theta) + 1):
        s = (j + theta) * dx
        found[s] = -dx * mean_value(shape, s, 1) / mass(shape)
    return found


def renormalised(weights: dict[Fraction, Fraction]) -> dict[Fraction, Fraction]:
    first = sum(w * s for s, w in weights.items())
    assume(first)
    return {s: w / first for s, w in weights.items()}


@pytest.mark.parametrize("correction", ["none", "csph"])
@settings(max_examples=DEEP or 20)
@given(st.sampled_from(NAMES), RATIOS, st.just(Fraction(0)) | offsets)
def test_two_gradients_convolved_are_the_nested_form(
    correction: str, name: str, dx: Fraction, theta: Fraction
) -> None:
    """Σ_b λ_b (G_b − G_a), one stencil laid upon the other in fractions, is what is derived."""
    shape = shape_of(kernel(name))
    here, there = gradient(shape, dx, theta), gradient(shape, dx, Fraction(0))
    if correction == "csph":
        here, there = renormalised(here), renormalised(there)
    derived = derive(
        kernel(name), "laplacian", form="nested", correction=correction, degree=4,
        dx_over_h=dx, offset=theta,
    ).discrete  # fmt: skip
    (mine,) = stencils(
        kernel(name), Operator("laplacian", "nested", correction),
        Arrangement("uniform", dx, (theta,)),
    )  # fmt: skip

    def inner(around: dict[Fraction, Fraction], at: Fraction, own: Fraction, n: int) -> Fraction:
        """⟨∂ s^n⟩ at a place: Σ_c w_c ((at + s_c)^n − own^n)."""
        return sum((w * ((at + s) ** n - own**n) for s, w in around.items()), Fraction(0))

    zero = Fraction(0)
    for n in range(5):
        nested = sum(
            w * (inner(there, s, s, n) - inner(here, zero, zero, n)) for s, w in here.items()
        )
        assert fraction(derived[n]) == nested == mine.moment((n,))


@pytest.mark.parametrize("offset", ["0", "1/3"])
@pytest.mark.parametrize(
    "operator",
    [
        Operator("value"),
        Operator("value", "difference", "shepard"),
        Operator("gradient", "symmetric"),
        Operator("gradient", "standard", "rkpm-1"),
        Operator("laplacian", "brookshaw"),
        Operator("laplacian", "fatehi-manzari"),
    ],
    ids=str,
)
def test_moments_of_a_stencil_are_those_derived(operator: Operator, offset: str) -> None:
    """By Euler–Maclaurin at the knots, and here weight by weight: the same fractions."""
    derived = derive("quintic-spline", operator, degree=4, dx_over_h="3/5", offset=offset).discrete
    scene = Arrangement("uniform", Fraction(3, 5), (Fraction(offset),))
    (mine,) = stencils(kernel("quintic-spline"), operator, scene)
    assert [fraction(derived[n]) for n in range(5)] == [mine.moment((n,)) for n in range(5)]


@pytest.mark.parametrize(("kind", "place"), [("hexagonal", ()), ("cubic", ()), ("square", (1, 2))])
def test_a_nested_hessian_in_space(kind: str, place: Sequence[int]) -> None:
    """To 40 digits, of all components: the product against the algebra of moments."""
    offset = tuple(Fraction(n, 7) for n in place)
    scene = Arrangement(kind, Fraction(1), offset)
    operator, shape = Operator("hessian", "nested"), kernel("wendland-c2")
    derived = derive(
        shape, operator, dim=scene.dim, lattice=kind, degree=3, dx_over_h=1,
        offset=tuple(map(str, offset)) or 0,
    ).discrete  # fmt: skip
    first = stencils(shape, operator, scene)[0]
    with mpmath.workdps(50):
        for alpha, value in derived.values.items():
            difference = mpmath.mpf(str(value.evalf(45) if value else 0)) - first.moment(alpha)
            assert abs(difference) < mpmath.mpf(10) ** -28


def test_the_symbol_is_the_transform_and_its_aliases() -> None:
    """Of a Gaussian, whose aliases are known in closed form: Poisson's sum of (k + G) F(k + G),
    F = e^{−k²/4}."""
    ratio, k, shape = Fraction(4, 5), mpmath.mpf("0.7"), kernel("gaussian")
    (mine,) = stencils(shape, Operator("gradient"), Arrangement("uniform", ratio))
    with mpmath.workdps(40):
        step = 2 * mpmath.pi * 5 / 4
        exact = mpmath.fsum((k + n * step) * mpmath.exp(-((k + n * step) ** 2) / 4)
                            for n in range(-9, 10))  # fmt: skip
        found = mine.symbol([k])
        assert abs(found.real) < mpmath.mpf(10) ** -45
        # beyond its reach κ: Σ Δx |Ŵ′| on both sides, at most 2 (Ŵ(κ) + Δx |Ŵ′(κ)|)
        end = mpmath.mpf(str(shape.support))
        left = 2 * mpmath.exp(-(end**2)) / mpmath.sqrt(mpmath.pi) * (1 + 2 * end * 4 / 5)
        assert abs(found.imag - exact) < left < mpmath.mpf(10) ** -19
    value = mine + mine * -1
    assert value.moment((1,)) == 0


def test_what_a_stencil_is_not() -> None:
    shape = kernel("cubic-spline")
    with pytest.raises(ValueError, match="no wall, jitter"):
        stencils(shape, Operator(), Arrangement("uniform", Fraction(1, 2), sigma=0.1))
    with pytest.raises(ValueError, match="hcp differ in what they see"):
        stencils(shape, Operator("laplacian", "nested"), Arrangement("hcp", Fraction(1)))
    scene = Arrangement("uniform", Fraction(1, 2), (Fraction(1, 3),))
    with pytest.raises(ValueError, match="paired takes the neighbours"):
        stencils(shape, Operator("gradient", "paired"), scene)
