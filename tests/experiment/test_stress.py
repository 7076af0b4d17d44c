"""The numerics under stress: every reported bound holds, nothing is NaN in silence, and where
digits are lost the result says so. The references are sums in 60 digits, or exact rationals."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest

import sphtrunc
from sphtrunc.bench import accuracy, peers, speed, stability, suites
from sphtrunc.cli import main
from sphtrunc.experiment.engine import pair_sums
from sphtrunc.scenes.particles import particles

CASES = list(stability.cases(quick=False))
LABELS = [f"{case.name} {case.parameter:g}" for case in CASES]
COMPILED = [
    case
    for case in CASES
    if case.kernel == "cubic-spline" and case.scene.dim == 3 and not case.quantum
]


@pytest.mark.parametrize("precision", ["plain", "compensated"])
@pytest.mark.parametrize("case", CASES, ids=LABELS)
def test_sums_stay_within_their_bound(case, precision) -> None:
    error, bound, size, held = stability.against_truth(case, "numpy", precision)
    assert held
    assert np.isfinite([error, bound, size]).all()


@pytest.mark.parametrize("case", COMPILED, ids=[f"{c.name} {c.parameter:g}" for c in COMPILED])
def test_compiled_sums_stay_within_their_bound(case) -> None:
    error, bound, size, held = stability.against_truth(case, "numba", "plain")
    assert held
    assert np.isfinite([error, bound, size]).all()


def test_bounds_are_tight_where_nothing_is_lost() -> None:
    ratios = []
    for case in CASES:
        if case.name in ("coordinates from", "Δx/h", "flattened by"):
            error, bound, _, _ = stability.against_truth(case, "numpy", "plain")
            ratios.append(bound / error)
    assert np.median(ratios) < 50


@pytest.mark.parametrize("offset", [0.0, 1e2, 1e4])
def test_single_precision_carries_its_quantum(offset) -> None:
    """With the quantum the bound covers the true positions; without it, it does not."""
    case = next(c for c in CASES if c.name == "single precision from" and c.parameter == offset)
    error, bound, _, held = stability.against_truth(case, "numpy", "plain")
    assert held
    assert error > 1e-9
    blind = stability.Case(case.name, offset, case.scene, case.kernel, 0.0, case.true)
    assert not stability.against_truth(blind, "numpy", "plain")[3]
    assert bound < 1e3 * error


def test_no_bound_is_claimed_that_a_wrong_sum_would_meet() -> None:
    """Moving one particle by 1e-12 h breaks the bound: the comparison can fail."""
    case = next(c for c in CASES if c.name == "coordinates from")
    x = case.scene.x.T.copy()
    x[1] += 1e-12
    moved = particles(x, h=1.3, volume=case.scene.given)
    wrong = stability.Case(case.name, 0.0, case.scene, true=moved)
    assert not stability.against_truth(wrong, "numpy", "plain")[3]


def test_corrections_next_to_singular_are_accurate_or_flagged() -> None:
    table = stability._corrections()
    verdict, flagged, condition = (
        [row[table.columns.index(name)] for row in table.rows]
        for name in ("verdict", "flagged of 64", "condition")
    )
    assert set(verdict) == {"held"}
    assert all(f == 64 for f, c in zip(flagged, condition, strict=True) if c > 1e15)
    assert all(f == 0 for f, c in zip(flagged, condition, strict=True) if c < 1e11)
    assert max(flagged) == 64
    assert min(flagged) == 0


@pytest.mark.parametrize("form", ["standard", "difference"])
@pytest.mark.parametrize("power", [0, 4, 8, 12])
@pytest.mark.parametrize("ratio", [0.02, 0.5, 1.9])
def test_the_floor_of_a_sinusoid_is_bounded(form, power, ratio) -> None:
    error, bound = stability.floor(10.0**-power, ratio, form)
    assert 0 < error <= bound
    if form == "standard":  # u A/h: digits are lost, and the bound says how many
        assert error > 1e-3 * 2.0**-53 * 10.0**power
    else:
        assert bound < 1e-13


def test_nothing_overflows_in_silence() -> None:
    x = np.arange(10.0)
    kernel = sphtrunc.kernel("cubic-spline")
    keys = [((1,), (0,))]
    for volume, field in ((1e300, 1e300), (1e-300, 1e300), (1e300, 1e-300)):
        scene = particles(x, h=1.3, volume=volume)
        values = np.full(10, field)
        if volume * field == np.inf:
            with pytest.raises(ValueError, match="overflow"):
                pair_sums(scene, kernel, keys, fields=values, field_keys=keys)
        else:
            found = pair_sums(scene, kernel, keys, fields=values, field_keys=keys, bound=True)
            assert np.isfinite(found.fields[keys[0]]).all()
            assert np.isfinite(found.fields_bound[keys[0]]).all()


# ------------------------------------------------------------------------------- the benchmark


@pytest.mark.parametrize("condition", [1e8, 1e16, 1e24])
def test_ill_conditioned_sums_are_what_they_are_called(condition) -> None:
    a, b, exact = accuracy.ill_conditioned(100, condition, 5)
    terms = [Fraction(x) * Fraction(y) for x, y in zip(a, b, strict=True)]
    assert sum(terms) == exact
    assert sum(abs(t) for t in terms) / abs(exact) > condition / 1e3


def test_the_front_holds_what_nothing_beats() -> None:
    points = [(1.0, 5.0), (2.0, 2.0), (2.0, 3.0), (4.0, 1.0), (5.0, 1.0)]
    assert accuracy.pareto(points) == {0, 1, 3}


def test_the_pair_list_that_we_race_against_is_right() -> None:
    scene = speed.box(7, 1.2)
    field = np.sin(scene.x[0])
    found = speed._once(scene, field).values[0] / 1.2
    other = peers.query_pairs(np.ascontiguousarray(scene.x.T), 1.2, field)
    assert np.abs(found - other).max() < 1e-13


def test_bench_reports_what_was_asked_for(capsys, tmp_path) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["bench", "--quick", "--suite", "precision", "--format", "json"])
    assert stop.value.code == 0
    report = json.loads(capsys.readouterr().out)
    assert report["schema"] == "sphtrunc.bench/1"
    assert list(report["suites"]) == ["precision"]
    assert {"processor", "cores", "python"} <= set(report["machine"])
    known = report["suites"]["precision"][0]
    worst = {
        (row[0], row[1] > 1e12): row[known["columns"].index("largest error")]
        for row in known["rows"]
    }
    assert worst["exact (fractions)", True] == 0
    assert worst["compensated", False] < 1e-15 < worst["plain", False]


def test_an_unknown_suite_is_refused() -> None:
    with pytest.raises(ValueError, match="suite: got 'speed', expected one of engine"):
        suites.bench(["speed"])
