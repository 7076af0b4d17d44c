"""Beside a wall: what is measured on particles less what is derived, on lattices with every remedy
within the computed rounding bound, on displaced particles within four standard errors."""

from __future__ import annotations

from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sympy import Rational

from sphtrunc import Kernel, jittered, kernel, lattice, measure
from sphtrunc.experiment.fields import Polynomial
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.lattice import beside_wall
from sphtrunc.scenes.sites import KINDS
from sphtrunc.scenes.walls import GHOSTS
from sphtrunc.study.comparison import compare
from sphtrunc.theory.walls.moments import wall_lattice_moments
from sphtrunc.theory.walls.remedies import by_gamma, semi_analytic, semi_analytic_response

DEEP = settings().max_examples if settings().max_examples > 1000 else None

OPERATORS = [
    Operator("value"),
    Operator("value", "difference"),
    Operator("gradient"),
    Operator("gradient", "symmetric"),
    Operator("laplacian", "brookshaw"),
    Operator("laplacian", "direct"),
    Operator("value", "standard", "shepard"),
    Operator("gradient", "difference", "csph"),
    Operator("gradient", "standard", "rkpm-1"),
    Operator("value", "standard", "rkpm-2"),
    Operator("laplacian", "fatehi-manzari"),
]
LOW = {1: Fraction(1, 5), 2: Fraction(1, 2), 3: Fraction(4, 5)}


def outside(
    scene: Any, shape: Kernel, operator: Operator, measured: Kernel | None = None
) -> list[Any]:
    """The moments whose difference is not within the bound."""
    derived = wall_lattice_moments(shape, operator, scene, 2, exact=False)
    found = measure(scene, measured or shape, operator, moments=2, bound=True, workers=1)
    bounds: Any = found.moment_bound
    assert set(derived) == set(found.moments.values)
    return [
        alpha
        for alpha, value in derived.items()
        if not abs(value - float(found.moments[alpha][0])) <= float(bounds[alpha][0])
    ]


@st.composite
def walled(draw: st.DrawFn) -> Any:
    """Half spaces of every lattice, the wall anywhere in the cell, the target anywhere."""
    kind = draw(st.sampled_from(["uniform", "uniform", "square", "hexagonal", "cubic", "bcc"]))
    dim = KINDS[kind].dim
    ratio = draw(st.fractions(LOW[dim], Fraction(9, 10), max_denominator=24))
    at = draw(st.sampled_from(["particle", "half-way", "2/7"]))
    ghosts = draw(st.sampled_from(GHOSTS if dim < 3 else GHOSTS[:3]))
    eta = draw(st.fractions(0, Fraction(3, 2), max_denominator=10))
    if ghosts == "dummy":
        eta += ratio  # else the farthest dummies may see no fluid, which is refused
    return beside_wall(lattice(dim, kind, ratio), eta, at=at, ghosts=ghosts)


@settings(max_examples=DEEP or 80)
@given(walled(), st.sampled_from(OPERATORS), st.sampled_from(["wendland-c4", "quintic-spline"]))
@example(
    beside_wall(lattice(1, dx_over_h="1/5"), 0, at="particle", ghosts="mirror"),
    OPERATORS[0],
    "wendland-c4",
)  # the target on the wall is its own image
def test_moments_on_lattices(scene: Any, operator: Operator, name: str) -> None:
    assert outside(scene, kernel(name), operator) == []


@pytest.mark.parametrize("form", ["none", "csph"])
@pytest.mark.parametrize("kind", ["uniform", "square"])
def test_gradients_of_gradients(kind: str, form: str) -> None:
    scene = beside_wall(lattice(KINDS[kind].dim, kind, "3/5"), "1/3", at="half-way")
    assert outside(scene, kernel("wendland-c4"), Operator("laplacian", "nested", form)) == []


@pytest.mark.parametrize("ghosts", GHOSTS)
@pytest.mark.parametrize("operator", [OPERATORS[0], OPERATORS[2], OPERATORS[7]], ids=str)
def test_a_slightly_wrong_kernel_is_seen(operator: Operator, ghosts: str) -> None:
    """One coefficient of the measured kernel changed by one part in 10¹²."""
    shape = kernel("wendland-c4")
    first = list(shape.coefficients()[0])
    first[4] = first[4] * (1 + Fraction(1, 10**12))
    scene = beside_wall(lattice(2, "square", "1/2"), "2/7", at="2/7", ghosts=ghosts)
    assert outside(scene, shape, operator, Kernel(shape.knots, [first])) != []


def assert_within_errors(found: Any, dim: int, targets: int) -> None:
    """Means within 4.6 standard errors, spreads within 4 of a spread, and the next order in σ."""
    largest = max(found.predicted.std.values())
    compared = [a for a, std in found.predicted.std.items() if std > 1e-3 * largest]
    assert len(compared) >= dim
    for alpha in compared:
        measured, std = found.measured.moments[alpha], found.predicted.std[alpha]
        kurtosis = max(3.0, float(((measured - measured.mean()) ** 4).mean() / measured.var() ** 2))
        assert abs(found.difference[alpha]) < 4.6 * std / sqrt(targets) + 0.03 * std
        assert abs(found.ratio[alpha] - 1) < 4 * sqrt((kurtosis - 1) / (4 * targets)) + 0.04


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("operator", [OPERATORS[2], OPERATORS[7], OPERATORS[8]], ids=str)
def test_displaced_particles(dim: int, operator: Operator) -> None:
    """Means within 4 standard errors, spreads within those of a spread and the next order in σ."""
    targets = {1: 3000, 2: 1200, 3: 200}[dim]
    ratio = {1: "3/10", 2: "2/3", 3: "4/5"}[dim]
    scene = jittered(beside_wall(lattice(dim, dx_over_h=ratio), "1/3", at="half-way"), 0.04, seed=9)
    found = compare(scene, "wendland-c4", operator, degree=2, targets=targets)
    assert_within_errors(found, dim, targets)


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("ghosts", GHOSTS[1:])
@pytest.mark.parametrize("operator", [OPERATORS[0], OPERATORS[2], OPERATORS[7]], ids=str)
def test_displaced_particles_with_ghosts(operator: Operator, ghosts: str, dim: int) -> None:
    """As without: images and means of what is displaced move with it."""
    targets, ratio = {1: (3000, "3/10"), 2: (1200, "2/3")}[dim]
    home = beside_wall(lattice(dim, dx_over_h=ratio), "4/5", at="half-way", ghosts=ghosts)
    found = compare(
        jittered(home, 0.03, seed=9), "wendland-c4", operator, degree=2, targets=targets
    )
    assert_within_errors(found, dim, targets)


@pytest.mark.parametrize("ghosts", GHOSTS[1:])
def test_ghosts_of_displaced_particles_one_by_one(ghosts: str) -> None:
    """Particles of a target put down one after the other, reflected, and summed with Ŵ itself: 40
    terms of a few roundings each."""
    shape, dx, eta = kernel("wendland-c4"), 2 / 3, 4 / 5
    home = beside_wall(lattice(2, dx_over_h="2/3"), "4/5", at="half-way", ghosts=ghosts)
    scene = jittered(home, 0.05, seed=4)
    found = measure(scene, shape, "value", moments=1, targets=np.array([7, 123]))
    for n, target in enumerate((7, 123)):
        origin = scene.origin(np.array([target]))
        m = np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-8, 9), indexing="ij")).reshape(2, -1)
        start = np.array([float(o) for o in home.offset])[:, None]
        place = dx * (m + start)
        fluid = place[0] > -eta
        moves = bool(np.any(start) == 0)
        own = scene.displacement(origin) * moves
        x = place[:, fluid] + dx * (scene.displacement(m[:, fluid] + origin) - own)
        wall = -eta - dx * own[0]
        images = x.copy()
        images[0] = 2 * wall - x[0]
        carried = {"mirror": x[0], "odd": 2 * wall - x[0]}.get(ghosts)
        if carried is None:
            images = place[:, ~fluid] - dx * own
            near = shape.w(np.hypot(*(x[:, :, None] - images[:, None])), 2)
            carried = (near * x[0][:, None]).sum(axis=0) / np.maximum(near.sum(axis=0), 1e-300)
        here, there = (shape.w(np.hypot(*p), 2) * dx**2 for p in (x, images))
        value = (here * x[0]).sum() + (there * carried).sum()
        assert abs(found.moments[1, 0][n] - value) < 1e-13
        assert abs(found.moments[0, 0][n] - here.sum() - there.sum()) < 1e-13


@pytest.mark.parametrize("ghosts", GHOSTS)
def test_fields_are_read_where_ghosts_read_them(ghosts: str) -> None:
    """The error of a polynomial is Σ c_α (M_α − M_α^exact) of what is derived."""
    scene = beside_wall(lattice(1, "uniform", "1/3"), "1/2", at="half-way", ghosts=ghosts)
    operator = Operator("gradient")
    field = Polynomial({(0,): 0.5, (1,): 1.0, (2,): 0.75})  # errors are relative to A′ = 1
    found: Any = measure(scene, "cubic-spline", operator, field)
    derived = wall_lattice_moments(kernel("cubic-spline"), operator, scene, 2)
    expected = sum(c * float(derived[a] - int(a == (1,))) for a, c in field.coefficients.items())
    assert float(np.ravel(found.errors)[0]) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize(("dim", "name"), [(1, "cubic-spline"), (2, "wendland-c2")])
@pytest.mark.parametrize(
    "operator",
    [Operator("value"), Operator("gradient"), Operator("laplacian", "brookshaw")],
    ids=str,
)
def test_normalised_by_gamma(dim: int, name: str, operator: Operator) -> None:
    """Sums on particles, γ and the terms of the wall as integrals: what is measured less the limit
    is c B₂(½) (Δx/h)² with the derived c, and the rest falls as the fourth power, or in 2D and for
    the knots of the kernel faster than the third."""
    shape, eta = kernel(name), Rational(1, 2)
    limit = semi_analytic(shape, operator, dim, 2, eta)
    response = semi_analytic_response(shape, operator, dim, 2, eta, 2)
    assert response is not None
    rests = []
    for n in (9, 27):
        ratio = Fraction(1, n)  # the wall is half-way, and so is the edge
        scene = beside_wall(lattice(dim, dx_over_h=ratio), Fraction(1, 2), at="half-way")
        found = measure(scene, shape, operator, moments=2, workers=1).moments
        sums = {alpha: float(m[0]) for alpha, m in found.values.items()}
        seen = by_gamma(shape, operator, sums, eta)
        effect = {alpha: float(c) / -12 * float(ratio) ** 2 for alpha, c in response.items()}
        off = {alpha: seen[alpha] - float(limit[alpha]) for alpha in seen}
        assert max(map(abs, off.values())) > 1e-4 / n  # there is something to see
        rests.append(max(abs(off[alpha] - effect[alpha]) for alpha in off))
    assert rests[1] < rests[0] / 3**2.9
    assert rests[1] < 1e-5


def test_no_wall_no_cost() -> None:
    """A lattice without a wall has neither ghosts nor volumes of its own."""
    block = lattice(2, "square", "1/2").neighbourhood(np.zeros(1, np.int64), kernel("lucy"))
    assert block.ghosts is None
    assert block.volume.shape == (1, 1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"eta": -1}, "wall: got η = -1"),
        ({"eta": "x"}, "wall: got 'x'"),
        ({"eta": 1, "at": "3/2"}, "wall-at: got 3/2"),
        ({"eta": 1, "ghosts": "none at all"}, "ghosts: got 'none at all'"),
        ({"eta": 1, "weight": 2}, "wall-weight: got 2"),
        ({"eta": 1, "weight": 1, "ghosts": "odd"}, "wall-weight: with odd ghosts"),
    ],
)
def test_bad_walls(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        beside_wall(lattice(1), **given)


def test_what_has_no_images() -> None:
    """Displaced particles, summed volumes, exact sums, the nested and the paired form."""
    mirrored = beside_wall(lattice(1), 1, at="half-way", ghosts="mirror")
    with pytest.raises(ValueError, match="a displaced particle is not on the wall"):
        jittered(beside_wall(lattice(1), 1, at="particle"), 0.1)
    with pytest.raises(ValueError, match="got volumes summation"):
        beside_wall(lattice(1, volume="summation"), 1)
    with pytest.raises(ValueError, match="exact sums have no ghosts"):
        measure(mirrored, "lucy", moments=1, precision="exact")
    with pytest.raises(ValueError, match="gradients at the ghosts"):
        measure(mirrored, "lucy", Operator("laplacian", "nested"), moments=1)
    with pytest.raises(ValueError, match="paired takes the neighbours"):
        measure(mirrored, "lucy", Operator("gradient", "paired"), moments=1)
    near = beside_wall(lattice(1, dx_over_h="1/2"), 0, at="half-way", ghosts="dummy")
    with pytest.raises(ValueError, match="the farthest dummies see no fluid"):
        measure(near, "lucy", moments=1)
    with pytest.raises(ValueError, match="with wall-at 0 the lattice is at"):
        beside_wall(lattice(1, offset="1/3"), 1, at="particle")
