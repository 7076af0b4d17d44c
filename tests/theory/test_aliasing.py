"""The discretisation error on lattices and its reasons: orders attained and not exceeded, shells
that add up to the direct sum, lattices ranked."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from sphtrunc import derive, kernel
from sphtrunc.cli import group
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.aliasing import aliasing, leading_degree, ranking
from sphtrunc.theory.lattice_sums import lattice_sums
from sphtrunc.theory.limit import continuous_sum

VALUE, GRADIENT, CSPH = Operator("value"), Operator(), Operator("gradient", "standard", "csph")
BROOKSHAW, DIRECT = Operator("laplacian", "brookshaw"), Operator("laplacian")


def error(name: str, operator: Operator, kind: str, ratio: Fraction, offset: Any = None) -> float:
    """Leading moment less its limit, by direct sums of 50 digits."""
    shape, dim = kernel(name), KINDS[kind].dim
    degree = leading_degree(operator)
    keys = operator.needed(dim, degree)
    scene = Arrangement(kind, ratio, offset or ())
    there = operator.correct(lattice_sums(shape, keys, scene, False), dim, degree)
    limit = operator.correct({key: continuous_sum(shape, key) for key in keys}, dim, degree)
    alpha = unit(dim, 0, degree)
    return float(there[alpha] - limit[alpha])


@pytest.mark.parametrize(
    ("operator", "degree"),
    [
        (VALUE, 0), (Operator("value", "difference"), 2), (GRADIENT, 1), (CSPH, 3), (BROOKSHAW, 2),
        (Operator("gradient", "standard", "rkpm-1"), 3), (Operator("hessian"), 2),
        (Operator("laplacian", "fatehi-manzari"), 4),
    ],
)  # fmt: skip
def test_the_first_moment_that_a_lattice_can_falsify(operator: Operator, degree: int) -> None:
    assert leading_degree(operator) == degree


@pytest.mark.parametrize(
    ("operator", "name", "kind"),
    [
        (VALUE, "cubic-spline", "square"),
        (VALUE, "wendland-c2", "cubic"),
        (BROOKSHAW, "polynomial:2", "hexagonal"),
        (BROOKSHAW, "cubic-spline", "bcc"),
        (DIRECT, "polynomial:4", "square"),
        (Operator("hessian"), "polynomial:4", "hexagonal"),
    ],
    ids=str,
)
def test_order_is_attained_and_not_exceeded(operator: Operator, name: str, kind: str) -> None:
    """The largest error over a window of ratios, halved, falls with the power that is told."""

    def largest(centre: Fraction) -> float:
        ratios = [centre * (1 + Fraction(i, 40)) for i in range(12)]
        return max(abs(error(name, operator, kind, ratio)) for ratio in ratios)

    dim = KINDS[kind].dim
    order = aliasing(kernel(name), operator, dim).order
    assert order is not None
    measured = np.log2(largest(Fraction(1, 4)) / largest(Fraction(1, 8)))
    assert abs(measured - float(order.power)) < 0.5


@pytest.mark.parametrize("kind", [k for k in KINDS if KINDS[k].dim > 1])
def test_the_shells_add_up_to_the_direct_sum(kind: str) -> None:
    """Within the bound on all others, which drops below what the shells themselves add."""
    dim = KINDS[kind].dim
    tight = []
    for operator, name, offset in product(
        (VALUE, Operator("value", "difference"), GRADIENT, BROOKSHAW, DIRECT),
        ("wendland-c6", "polynomial:4"),
        ((Fraction(0),) * dim, tuple(Fraction(i + 1, 7) for i in range(dim))),
    ):
        found = aliasing(kernel(name), operator, dim, Arrangement(kind, Fraction(3, 4), offset))
        told = sum(shell.contribution for shell in found.shells)
        rest = abs(error(name, operator, kind, Fraction(3, 4), offset) - told)
        assert rest <= found.tail + 1e-12
        tight.append(found.tail < abs(told))
    assert sum(tight) > len(tight) / 2


def test_ranking() -> None:
    """At equal number density bcc and hexagonal have the longest shortest reciprocal vectors, and
    are the most accurate for smooth kernels; the figures are those of the direct sums."""
    three = ranking(kernel("wendland-c4"), GRADIENT, 3, Fraction(1, 2))
    assert three[0].lattice == "bcc"
    two = ranking(kernel("wendland-c4"), VALUE, 2, Fraction(4, 5))
    assert [r.lattice for r in two] == ["hexagonal", "square"]
    for rank in [r for r in three if r.lattice != "hcp"]:  # all axes alike
        one = abs(error("wendland-c4", GRADIENT, rank.lattice, Fraction(1, 2)))
        assert rank.error == pytest.approx(one, rel=1e-12)
    assert all(r.error > 0 for r in ranking(kernel("wendland-c4"), CSPH, 3, Fraction(3, 5)))
    assert ranking(kernel("wendland-c4"), GRADIENT, 3, Fraction(1, 40)) == []
    assert ranking(kernel("spiky"), DIRECT, 3, Fraction(1, 2)) == []


def derived(name: str, **options: Any) -> Any:
    return derive(name, **options)


def test_what_derive_says() -> None:
    text = derived("cubic-spline", dim=3, lattice="bcc", dx_over_h="1/2").to_text()
    assert "order (Δx/h)⁴" in text
    assert "Ŵ‴ at q = 1, Ŵ‴ at q = 2" in text
    assert "14.105    12" in text  # 2π√2/2^{1/3}·2, the twelve (110) of bcc
    assert "at equal number density" in text
    assert max(map(len, text.splitlines())) <= 100
    marked = [line for line in text.splitlines() if "limits the order" in line]
    assert [line.split()[2] for line in marked] == ["1", "2"]
    assert "(Δx/h)^(9/2)" in derived("wendland-c2", dim=2).to_text()
    assert "falls faster than any power" in derived("gaussian", dim=2).to_text()
    assert "no bound is known" in derived("polynomial:0", dim=2, dx_over_h="1/2").to_text()
    data = json.loads(derived("cubic-spline", dim=3, lattice="bcc", dx_over_h="1/2").to_json())
    found = data["aliasing"]
    assert found["order"] == "4"
    assert found["limits"] == [{"knot": "1", "derivative": 3}, {"knot": "2", "derivative": 3}]
    assert {row["lattice"] for row in found["ranking"]} == {"cubic", "bcc", "fcc", "hcp"}
    assert found["shells"][0]["count"] == 12
    assert 0 < found["tail"] < 0.01
    done = CliRunner().invoke(group, ["derive", "-k", "cubic-spline", "--dim", "2"])
    assert "order (Δx/h)^(7/2)" in done.output
