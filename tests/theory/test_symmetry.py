"""Classes of equal moments, against the group of the lattice and against the predicted figures."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from itertools import permutations, product

import pytest

from sphtrunc import derive
from sphtrunc.kernels.parse import kernel
from sphtrunc.operators.moments import label, multi_indices
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.disorder.propagation import propagate
from sphtrunc.theory.symmetry import classes
from tests.strategies import OPERATORS

CSPH = Operator("gradient", "difference", "csph")


def names(found):
    return {frozenset(group) for group in found}


def test_moments_of_the_standard_gradient_are_those_of_one_function_of_every_index():
    """g_α = −s^{α+e₁} Ŵ′/q: in 3D a class is a set of exponents, whatever their order."""
    alphas = list(multi_indices(3, 5))
    expected: dict[tuple[int, ...], set[tuple[int, ...]]] = {}
    for a, b, c in alphas:
        expected.setdefault(tuple(sorted((a + 1, b, c))), set()).add((a, b, c))
    assert len(expected) == 22
    for kind in ("cubic", "bcc", "fcc"):
        found = classes(Operator("gradient"), kind, (0, 0, 0), alphas)
        assert names(found) == {frozenset(group) for group in expected.values()}


def test_a_corrected_gradient_turns_about_its_own_axis_only():
    alphas = list(multi_indices(3, 3))
    for component in range(3):
        b, c = (i for i in range(3) if i != component)
        expected = {
            frozenset({alpha, tuple(alpha[{b: c, c: b}.get(i, i)] for i in range(3))})
            for alpha in alphas
        }
        assert names(classes(CSPH, "cubic", (0, 0, 0), alphas, component)) == expected


def test_what_takes_a_symmetry_away():
    """An offset along one axis, and lattices whose axes differ."""
    laplacian, alphas = Operator("laplacian"), list(multi_indices(3, 2))
    third = Fraction(1, 3)
    whole = {frozenset(set(permutations(alpha))) for alpha in alphas}
    assert names(classes(laplacian, "fcc", (third,) * 3, alphas)) == whole
    assert {(1, 0, 0), (0, 0, 1)} in names(classes(laplacian, "cubic", (0, third, 0), alphas))
    single = {frozenset({alpha}) for alpha in alphas}
    assert names(classes(laplacian, "hcp", (0, 0, 0), alphas)) == single
    flat = list(multi_indices(2, 3))
    assert len(classes(laplacian, "hexagonal", (0, 0), flat)) == len(flat)


@pytest.mark.parametrize("kind", ["square", "cubic", "fcc"])
def test_members_of_a_class_have_the_same_spread(kind):
    """In every operator, to the rounding of some 10³ terms of size 1; volumes that vary as well."""
    dim = KINDS[kind].dim
    shape, zero = kernel("wendland-c4"), (Fraction(0),) * dim
    alphas = list(multi_indices(dim, 3))
    merged = 0
    for operator, volume in product(OPERATORS, ("constant", "summation")):
        if dim == 3 and (operator.form == "nested" or volume == "summation"):
            continue
        scene = Arrangement(kind, Fraction(6, 5), volume=volume)
        slopes, _ = propagate(shape, operator, scene, 3)
        spread = {alpha: float((row**2).sum()) ** 0.5 for alpha, row in slopes.items()}
        for first, *others in classes(operator, kind, zero, alphas):
            for alpha in others:
                merged += 1
                assert abs(spread[alpha] - spread[first]) <= 1e-12, (operator, alpha)
    assert merged > 50


def test_the_text_has_a_row_per_class_and_json_has_all():
    found = derive("wendland-c2", dim=3, dx_over_h="4/5", jitter=0.1)
    text = found.to_text().partition("Moments of particles displaced")[2]
    rows = [line for line in text.splitlines() if re.match(r"  \d,\d,\d ", line)]
    named = re.findall(r"\d,\d,\d", text)
    everything = [label(alpha) for alpha in multi_indices(3, 5)]
    assert len(everything) == 56
    assert len(rows) == 22
    assert sorted(named) == sorted(everything)
    assert max(map(len, text.splitlines())) <= 100
    moments = json.loads(found.to_json())["predicted"]["moments"]
    assert list(moments) == everything
    for row in rows:
        first, mean, std, *others = row.split()
        for name in (first, *others):
            assert moments[name]["mean"] == pytest.approx(float(mean), rel=1e-11, abs=1e-15)
            assert moments[name]["std"] == pytest.approx(float(std), rel=1e-5)
