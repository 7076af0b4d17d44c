"""Second derivatives, lattices in space and disorder in `derive`: exact limits, particle sums by
hand in fractions, and what the command line and its JSON say."""

from __future__ import annotations

import json
from fractions import Fraction
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import mass, mean_value, shape_of
from sympy import Rational, bernoulli, factorial

from sphtrunc import derive, kernel, lattice, measure
from sphtrunc.cli import group
from sphtrunc.kernels.catalogue import names

SMOOTH = [n for n in names() if kernel(n).smoothness >= 1 and not n.startswith("b-spline:1")]


def by_hand(name: str, ratio: Fraction, offset: Fraction) -> dict[str, list[Fraction]]:
    """1D sums in fractions from the definitions, moments 0 … 5."""
    shape = shape_of(kernel(name))
    sigma = 1 / mass(shape)
    reach = int(shape.knots[-1] / ratio) + 2
    s = [(j + offset) * ratio for j in range(-reach, reach + 1)]
    direct = [sum(ratio * x**k * sigma * mean_value(shape, x, 2) for x in s) for k in range(6)]
    others = [x for x in s if x]
    slope = {x: -sigma * mean_value(shape, x, 1) / x for x in others}
    brookshaw = [2 * sum(ratio * x**k * slope[x] for x in others) for k in range(6)]

    def gradient(f: Any) -> Fraction:
        first = sum(ratio * x * x * slope[x] for x in others)
        return sum(ratio * x * slope[x] * f(x) for x in others) / first

    def inner(f: Any) -> Fraction:
        g = gradient(f)
        return sum(2 * ratio * slope[x] * (f(x) - x * g) for x in others)

    scale = 2 / inner(lambda x: x * x)
    fatehi = [scale * inner(lambda x, k=k: x**k) for k in range(1, 6)]
    return {"direct": direct, "brookshaw": brookshaw, "fatehi-manzari": [Fraction(0), *fatehi]}


@settings(max_examples=60)
@given(
    st.sampled_from(SMOOTH),
    st.fractions(Fraction(1, 8), Fraction(9, 10), max_denominator=30),
    st.sampled_from([Fraction(0), Fraction(1, 2), Fraction(2, 7)]),
)
def test_one_dimension_in_fractions(name: str, ratio: Fraction, offset: Fraction) -> None:
    exact = by_hand(name, ratio, offset)
    for form, values in exact.items():
        derived = derive(name, "laplacian", form=form, dx_over_h=ratio, offset=offset).discrete
        assert derived is not None
        first = 0 if form == "direct" else 1
        mine = [Fraction(str(derived[k])) for k in range(first, 6)]
        assert mine == values[first:]


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "polynomial:4", "gaussian"])
def test_brookshaw_has_half_the_smoothing_error(name: str, dim: int) -> None:
    """R₂/(4d) against R₂/(2d), and the whole series c_n 2(2n+d−2) R_{2n−2} (theory of the form)."""
    shape = kernel(name)
    half = derive(name, "laplacian", form="brookshaw", dim=dim, degree=6).smoothing_error
    full = derive(name, "laplacian", dim=dim, degree=6).smoothing_error
    r2, r4 = shape.moment(2, dim), shape.moment(4, dim)
    assert half[0] == (4, 2, r2 / (4 * dim))
    assert full[0] == (4, 2, r2 / (2 * dim))
    c3 = Rational(1, 2**3 * factorial(3) * dim * (dim + 2) * (dim + 4))
    assert half[1] == (6, 4, c3 * 2 * (4 + dim) * r4)
    assert full[1] == (6, 4, r4 / (2**2 * 2 * dim * (dim + 2)))


@pytest.mark.parametrize("beta", [2, 4, 6])
def test_the_aligned_special_case(beta: int) -> None:
    """(Δx/h)^{β+2} B_{β+2}/(β+2)! (1 − 2^{−β−1}) [2κ Ŵ^{(β+2)} + 2(β+1) Ŵ^{(β+1)}] at the edge."""
    shape = kernel(f"polynomial:{beta}")
    n = beta + 2
    piece = shape.pieces[0]
    edge = [shape.normalisation(1) * piece.diff((piece.gen, m)).eval(2) for m in (n, n - 1)]
    exact = bernoulli(n) / factorial(n) * (1 - Rational(1, 2) ** (beta + 1))
    exact *= 4 * edge[0] + 2 * (beta + 1) * edge[1]
    terms = [t for t in derive(shape, degree=1).terms if t.moment == 1 and t.dx_power <= n]
    by_power = {
        m: sum(t.coefficient * bernoulli(m, Rational(1, 2)) for t in terms if t.dx_power == m)
        for m in {t.dx_power for t in terms}
    }
    assert {m: c for m, c in by_power.items() if c} == {n: exact}


def run(*arguments: str) -> Any:
    done = CliRunner().invoke(group, ["derive", *arguments])
    assert done.exit_code == 0, done.output
    return done.output


def test_command_line_and_json() -> None:
    text = run("-k", "wendland-c2", "--dim", "3", "--lattice", "bcc", "--dx-over-h", "1/2")
    assert "bcc lattice" in text
    assert max(map(len, text.splitlines())) <= 101
    options = ("-k", "cubic-spline", "--dim", "3", "--dx-over-h", "7/10", "--jitter", "0.05")
    data = json.loads(run(*options, "--format", "json"))
    row = data["predicted"]["moments"]["1,0,0"]
    assert set(row) == {"mean", "std"}
    assert 0.9 < row["mean"] < 1.1
    assert 0 < row["std"] < 0.1
    assert data["lattice"] == "cubic"
    still = json.loads(run("-k", "cubic-spline", "--dx-over-h", "10/13", "--format", "json"))
    assert still["predicted"]["moments"]["1"] == {"mean": 29200 / 28561, "std": 0.0}
    options = ("-k", "polynomial:4", "--dim", "3", "--dx-over-h", "1", "--degree", "1")
    exact = json.loads(run(*options, "--format", "json"))
    assert exact["discrete_moments"]["1,0,0"] == "6711705/(2097152*pi)"
    table = run("-k", "gaussian:3", "--operator", "laplacian", "--form", "brookshaw")
    assert "overtakes below" in table


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--dim", "2", "--lattice", "cubic", "--dx-over-h", "1/2"], "square, hexagonal"),
        (["--lattice", "uniform"], "dx-over-h"),
        (["--dim", "2", "--dx-over-h", "5"], "did you mean h/Δx"),
        (["--jitter", "0.1"], "dx-over-h"),
        (["--dx-over-h", "1/2", "--jitter", "-1"], "from 0 to 10"),
        (["--dim", "3", "--dx-over-h", "1/500"], "neighbours"),
        (["--dim", "2", "--dx-over-h", "1/2", "--offset", "1/2"], "one per axis"),
        (["--dim", "2", "--dx-over-h", "1/2", "--volume", "cell"], "summation"),
        (["--dx-over-h", "3/2", "--correction", "rkpm-3", "--dim", "2"], "singular"),
    ],
)
def test_bad_input(arguments: list[str], says: str) -> None:
    done = CliRunner().invoke(group, ["derive", "-k", "cubic-spline", *arguments])
    assert isinstance(done.exception, (ValueError, SystemExit))
    assert says in str(done.exception)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["spiky", "b-spline:2", "0..2: (2-q)^3"])
def test_where_the_slope_does_not_vanish_at_the_origin(name: str, dim: int) -> None:
    """w′(0) ≠ 0: at a particle ∂ᵢ²Ŵ ~ w′(0)/q has no value in the plane and in space, which is said
    and not summed; beside one, in 1D, and for kernels with w′(0) = 0 there is one."""
    scene = lattice(dim, None, "3/4")
    beside = lattice(dim, None, "3/4", [Fraction(1, 3)] * dim)
    with pytest.raises(ValueError, match=f"do not exist at the particle itself in {dim}D"):
        measure(scene, name, "laplacian")
    with pytest.raises(ValueError, match="has no second derivative at q = 0"):
        derive(name, "laplacian", dim=dim, dx_over_h="3/4")
    assert measure(beside, name, "laplacian", moments=2).flagged == 0
    assert measure(scene, "cubic-spline", "laplacian", moments=2).flagged == 0
    assert measure(lattice(1, None, "3/4"), name, "laplacian", moments=2).flagged == 0
