"""The page's own numbers, in a JavaScript engine, are those of the package."""

from __future__ import annotations

import random
from fractions import Fraction
from itertools import pairwise
from math import pi

import numpy as np
import pytest

from sphtrunc import derive, predict_error, sinusoid
from sphtrunc import lattice as lattice_of
from sphtrunc.explorer.setting import Setting, numbers
from sphtrunc.kernels.catalogue import named, names
from sphtrunc.kernels.parse import kernel
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.sites import KINDS, sites, units
from tests.explorer.settings import TABLES, apart, engine, words


def test_every_kernel_of_the_catalogue():
    """w and three derivatives, exactly rounded but for a few units; constants, moments, β."""
    assert list(TABLES["kernels"]) == names()
    engine().define(
        "function kernelValues(name, points, dims) { const k = kernelOf(name); return {"
        " values: points.map((q) => [0, 1, 2, 3].map((n) => k.shape(q, n))),"
        " beta: k.boundarySmoothness,"
        " constants: dims.map((d) => [k.normalisation(d), k.moment(2, d).toNumber(),"
        " k.moment(4, d).toNumber()]) }; }"
    )
    rng = random.Random(3)
    for name in names():
        exact = named(name)
        places = [Fraction(rng.randint(0, 1 << 20), 1 << 20) * 2 for _ in range(12)]
        points = [float(x * Fraction(str(exact.support)) / 2) for x in places]
        got = engine()("kernelValues", name, points, [1, 2, 3])["is"]
        assert got["beta"] == exact.boundary_smoothness, name
        for dim, row in zip((1, 2, 3), got["constants"], strict=True):
            wanted = [exact.normalisation(dim), exact.moment(2, dim), exact.moment(4, dim)]
            assert row == pytest.approx([float(x) for x in wanted], rel=1e-15), name
        for n in range(4):
            pieces = [piece.diff((piece.gen, n)) for piece in exact.pieces]
            largest = max(abs(float(p.eval(k))) for p, k in zip(pieces, exact.knots, strict=False))
            for q, row in zip(points, got["values"], strict=True):
                here = next(i for i, k in enumerate(exact.knots[1:]) if q <= float(k))
                value = float(pieces[here].eval(Fraction(q)))
                assert row[n] == pytest.approx(value, rel=1e-12, abs=1e-13 * largest), (name, q, n)


@pytest.mark.parametrize("kind", list(KINDS))
def test_lattices_are_those_of_the_package(kind):
    engine().define(
        "function neighboursOf(kind, r, reach) {"
        " return neighbours(TABLES.lattices[kind], r, reach); }"
    )
    got = engine()("neighboursOf", kind, 0.7, 3.1)["is"]
    index = sites(kind, 3.1 / 0.7, (Fraction(0),) * KINDS[kind].dim)
    wanted = 0.7 * (index.T * np.array([float(u) for u in units(kind)]))
    assert len(got) == len(wanted) > 2 * KINDS[kind].dim
    np.testing.assert_allclose(sorted(got), sorted(wanted.tolist()), rtol=0, atol=1e-14)


# -- formulas ------------------------------------------------------------------------------------

READ = [
    "0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4",
    "0..1: 1 - q;",
    "0 .. 1.5 : .5 - q/3",
    "pos(2-q)^3 - 4*pos(1-q)^3",
    "pos(2-q)**3 - 4*pos(1-q)**3",
    "-(-pos(1-q))*2/3",
    "0..1/2+1/2: --q - -(2)",
    "0..1: 1; 1..2: 0",
    "0..1: 1-q; 1..2: 1-q; 2..3: -1",
    "pos((2-q)/3)*pos(2-q)",
]
REFUSED = [
    "",
    "q",
    "1-q",
    "0..1: 1-q; 2..3: q",
    "0..0: 1",
    "0..2: 0",
    "1..2: 1",
    "0..q: 1",
    "0..1: 1/(1-q)",
    "0..1: 1/0",
    "0..1: q^(2)",
    "0..1: q^-1",
    "0..1: q^65",
    "0..1: (1-q",
    "0..1: 1-q)",
    "0..1 1-q",
    "0..1: alert(1)",
    "0..1: q;; 1..2: q",
    "0..1: pos(1-q)",
    "pos(1-q^2)",
    "pos(pos(1-q))",
    "pos(1-q) + 1",
    "0..1: 1e3",
    "__proto__",
    "constructor",
    "'><script>alert(1)</script>",
    "0..1: σ",
    "(" * 70 + "q" + ")" * 70,
    "0..1: 9^64^64",
    "0..1: ((q^8)^8)*q",
    "0..1: " + "1" * 1001,
    "0..1: (" + "9" * 900 + ")^20",
    "0..1: " + "q+" * 3000 + "q",
    ";".join(f"{i}..{i + 1}: {i + 1}" for i in range(33)),
]


def _pieces(text: str) -> dict[str, object]:
    """Knots and pieces of the page's reader, as texts, equal neighbours merged."""
    engine().define(
        "function read(text) { const k = kernelOf(text); return {"
        " knots: k.knots.map(String), pieces: k.pieces.map((p) => p.map(String)) }; }"
    )
    got = engine()("read", text)
    if "is" in got:
        knots, pieces = got["is"]["knots"], got["is"]["pieces"]
        kept = [i for i, (a, b) in enumerate(pairwise(pieces)) if a == b]
        for i in reversed(kept):
            del knots[i + 1], pieces[i + 1]
    return got


@pytest.mark.parametrize("text", READ)
def test_formulas_are_read_as_the_package_reads_them(text):
    exact = kernel(text)
    got = _pieces(text)["is"]
    assert got["knots"] == [str(k) for k in exact.knots]
    wanted = [[str(c) for c in piece] for piece in exact.coefficients()]
    assert [piece or ["0"] for piece in got["pieces"]] == wanted


@pytest.mark.parametrize("text", REFUSED, ids=lambda text: text[:24] or "empty")
def test_what_the_package_refuses_the_page_refuses(text):
    with pytest.raises(ValueError, match=":"):
        kernel(text)
    got = _pieces(text)
    assert set(got) == {"refused"}
    assert 10 < len(got["refused"]) < 250


def _written(rng: random.Random, depth: int) -> str:
    """A random expression, most of them well formed."""
    if depth == 0 or rng.random() < 0.2:
        return rng.choice(
            ["q", "q", "2", "1/3", "0.25", "pos(2-q)", "pos(1-q)", "(q", ")", "*"][:8]
            if rng.random() < 0.98
            else ["(q", ")", "*", "^2"]
        )
    one, other = _written(rng, depth - 1), _written(rng, depth - 1)
    return rng.choice(
        [f"{one}+{other}", f"{one}-{other}", f"({one})*({other})", f"({one})^{rng.randint(0, 3)}",
         f"-{one}", f"({one})/{rng.randint(0, 4)}"]
    )  # fmt: skip


def test_random_texts_are_read_or_refused_alike():
    rng = random.Random(5)
    read = 0
    for _ in range(300):
        body = _written(rng, 3)
        text = rng.choice([f"0..1: {body}", f"0..1: {body}; 1..2: {body}", f"({body})*pos(2-q)"])
        got = _pieces(text)
        try:
            exact = kernel(text)
        except ValueError:
            assert "refused" in got, text
            continue
        assert "is" in got, (text, got)
        assert got["is"]["knots"] == [str(k) for k in exact.knots], text
        wanted = [[str(c) for c in piece] for piece in exact.coefficients()]
        assert [piece or ["0"] for piece in got["is"]["pieces"]] == wanted, text
        read += 1
    assert 100 < read < 290


# -- what the numbers mean -----------------------------------------------------------------------


def test_particles_on_a_jump_count_by_half():
    """The hat's slope jumps at its knots, where particles are at Δx/h = 1/2: exactly 1."""
    at = Setting(kernel="b-spline:2", dim=1, dx_over_h="1/2")
    assert derive("b-spline:2", dx_over_h="1/2").discrete[1] == 1
    assert engine()("numbersOf", words(at))["is"]["moments"][1] == 1


@pytest.mark.parametrize(
    ("setting", "match"),
    [
        ({"dx-over-h": "0"}, "dx-over-h"),
        ({"dx-over-h": "much"}, "dx-over-h"),
        ({"h-over-lambda": "7"}, "h-over-lambda"),
        ({"jitter": "-1"}, "jitter"),
        ({"dim": "4"}, "dim"),
        ({"lattice": "hexagonal"}, "lattice"),
        ({"form": "constructor"}, "form"),
        ({"form": "paired", "jitter": "0.1"}, "paired"),
        ({"form": "symmetric", "correction": "csph"}, "correction"),
        ({"correction": "rkpm-3", "dx-over-h": "1.5"}, "singular"),
        ({"kernel": "0..1: 1 - 2*q", "dim": "1", "lattice": "uniform"}, "integral"),
    ],
)  # fmt: skip
def test_the_page_refuses_with_a_sentence(setting, match):
    got = engine()("numbersOf", {**TABLES["start"], **setting})
    assert set(got) == {"refused"}
    assert match in got["refused"]


@pytest.mark.parametrize("form", ["standard", "difference"])
def test_first_order_is_the_limit_of_small_displacements(form):
    """Averages over displacements of any size tend to it: 1e-3 apart at most at σ = 0.004 Δx."""
    at = Setting(kernel="wendland-c4", dim=2, dx_over_h="0.6", form=form, jitter="0.004")
    scene = jittered(lattice_of(2, "square", "0.6"), 0.004)
    split = predict_error(at.shape, at.operator, scene, sinusoid(0.05, dim=2))
    got = numbers(at)["error"]
    assert got["disorder"] == pytest.approx(split.disorder, rel=1e-3)
    assert got["smoothing"] == split.smoothing
    assert got["total"] == pytest.approx(split.total, rel=1e-3)


def test_sums_that_are_zero_by_symmetry_keep_their_derivatives():
    """On fcc many base sums cancel exactly, and still change with displacements."""
    at = Setting(
        kernel="polynomial:1",
        lattice="fcc",
        form="difference",
        correction="rkpm-3",
        dx_over_h="1839/2500",
        h_over_lambda="441/50000",
        jitter="277/1000",
    )
    assert not apart(at, engine()("numbersOf", words(at))["is"], numbers(at))


TRIED = [
    ("cubic-spline", 1, "0.4"),
    ("cubic-spline", 2, "0.7"),
    ("cubic-spline", 3, "5/6"),
    ("wendland-c4", 2, "0.6"),
]


@pytest.mark.parametrize(("name", "dim", "ratio"), TRIED)
@pytest.mark.parametrize("form", ["standard", "difference"])
def test_what_first_order_is_good_to(name, dim, ratio, form):
    """As the page says: 6 % of averages over displacements of up to 0.1 Δx, 20 % up to 0.3 Δx."""
    for sigma, good in (("0.1", 0.06), ("0.3", 0.2)):
        at = Setting(kernel=name, dim=dim, dx_over_h=ratio, form=form, jitter=sigma)
        scene = jittered(lattice_of(dim, at.lattice, ratio), float(sigma))
        split = predict_error(at.shape, at.operator, scene, sinusoid(0.05, dim=dim))
        assert numbers(at)["error"]["disorder"] == pytest.approx(split.disorder, rel=good)


def test_the_smoothing_error_is_that_of_the_transform():
    """1 − F(k) over √2, the mean over phases; F = (2 sin(k/2)/k)⁴ for the cubic spline."""
    k = 2 * pi * 0.05
    wanted = (1 - (2 * np.sin(k / 2) / k) ** 4) / 2**0.5
    at = Setting(kernel="cubic-spline", dim=1, dx_over_h="1/2", h_over_lambda="0.05")
    got = engine()("numbersOf", words(at))["is"]
    assert got["error"]["smoothing"] == pytest.approx(wanted, rel=1e-13)
