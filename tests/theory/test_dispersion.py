"""The dispersion relation in exact arithmetic: reference values, identities, limits."""

from __future__ import annotations

from fractions import Fraction
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sympy import QQ, Poly, Rational, Symbol

from sphtrunc import kernel
from sphtrunc.kernels.transform import transform
from sphtrunc.operators.forces import FORCES, ArtificialStress, force
from sphtrunc.scenes.sites import KINDS, units
from sphtrunc.theory.dispersion.brillouin import (
    POINTS,
    grid,
    halves,
    inside,
    point,
    reciprocal,
    shortest,
)
from sphtrunc.theory.dispersion.lattice_waves import Scan, exact_wave, long_wave, reduced, turns
from sphtrunc.theory.dispersion.modes import (
    LONGITUDINAL,
    TRANSVERSE,
    Rest,
    continuous,
    growth,
    written,
)
from sphtrunc.theory.dispersion.relation import dynamical

CUBIC = kernel("cubic-spline")
F = Fraction


def rest(
    name: str = "cubic-spline",
    kind: str = "uniform",
    ratio: str = "5/6",
    form: str = "symmetric",
    p: str = "0",
    **more: object,
) -> Rest:
    return Rest(kernel(name), kind, F(ratio), force(form), F(p), **more)


def exact(setting: Rest, *k: str) -> list[str | None]:
    return [m.exact for m in setting.modes(tuple(F(c) for c in k))]


# -- reference values: derived by hand and by complex-step linearisation elsewhere -----------------

FRACTIONS = {
    ("5/6", "1/2", "3/5"): ("6410988/3034205", "14078556/3721925", "656100/606841"),
    ("5/6", "2/3", "1"): ("51597/14801", "23740101/3721925", "243/361"),
    ("5/6", "1", "1"): ("2592/779", "864/265", "0"),
    ("10/13", "1/2", "3/5"): (
        "21204092/10267445",
        "150435181/38901700",
        "2044900/2053489",
    ),
}


@pytest.mark.parametrize(("setting", "values"), FRACTIONS.items(), ids=map(str, FRACTIONS))
def test_frequencies_in_1d_are_fractions(setting: tuple[str, ...], values: tuple[str, ...]) -> None:
    ratio, k, p = setting
    for form, value in zip(("symmetric", "grad-h", "difference"), values, strict=True):
        assert exact(rest(ratio=ratio, form=form, p=p), k) == [value]


LONG_WAVES = {  # Δx/h: (c_eff²/c², A) at p = 0 and at p = 1
    "1": ("1", "-1/6", "1", "1/12"),
    "5/6": ("632025/606841", "-1925/11448", "653325/606841", "-69475/3763152"),
    "10/13": ("2131600/2053489", "-6350/37011", "1880800/2053489", "31475/4767828"),
    "2/3": ("3600/3721", "-22/135", "2256/3721", "86/1269"),
    "1/2": ("1", "-1/6", "1", "1/48"),
}


@pytest.mark.parametrize(("ratio", "values"), LONG_WAVES.items())
def test_long_waves_in_1d_are_fractions(ratio: str, values: tuple[str, ...]) -> None:
    found = [rest(ratio=ratio, p=p).long_waves() for p in ("0", "1")]
    assert tuple(str(x) for f in found for x in (f.sound_speed2, f.dispersion)) == values


def test_sound_between_two_pressures() -> None:
    assert str(rest(p="3/5").long_waves().sound_speed2) == "644805/606841"


DECIMALS = [
    ("cubic-spline", "square", "5/6", ("1", "1/2"), "symmetric", (0.278161218171, 1.063280162305)),
    ("cubic-spline", "square", "5/6", ("1", "1/2"), "grad-h", (0.384293594737, 1.072900238017)),
    ("wendland-c2", "square", "5/6", ("1", "1/2"), "symmetric", (0.556818715440, 1.941825266469)),
    ("wendland-c2", "square", "5/6", ("1", "1/2"), "grad-h", (0.744786397832, 2.050822044226)),
    (
        "cubic-spline",
        "cubic",
        "5/6",
        ("1", "1/2", "1/2"),
        "symmetric",
        (-0.078865508601, 0.213370962646, 0.486002848071),
    ),
    (
        "cubic-spline",
        "cubic",
        "5/6",
        ("1", "1/2", "1/2"),
        "grad-h",
        (-0.080401622970, 0.275154557681, 0.495469038949),
    ),
    (
        "quintic-spline",
        "cubic",
        "10/13",
        ("1/2",) * 3,
        "symmetric",
        (0.003514558284, 0.003514558284, 0.568504793846),
    ),
    (
        "quintic-spline",
        "cubic",
        "10/13",
        ("1/2",) * 3,
        "grad-h",
        (0.003514716850, 0.003514716850, 0.622225889298),
    ),
]


@pytest.mark.parametrize("row", DECIMALS, ids=lambda row: f"{row[0]} {row[1]} {row[4]}")
def test_frequencies_in_space_to_the_digits_given(row: tuple) -> None:
    """From 50 digits; and the floats of a scan within their own bound of them."""
    name, kind, ratio, k, form, values = row
    setting = rest(name, kind, ratio, form, "3/5")
    kappa = tuple(F(c) for c in k)
    modes = setting.modes(kappa)
    assert [round(m.omega2, 12) for m in modes] == list(values)
    scan = setting.frequencies(setting.scan([[float(c) for c in kappa]]))
    assert np.abs(scan.omega2[0] - [m.omega2 for m in modes]).max() <= scan.rounding
    assert scan.rounding < 1e-10


# -- identities --------------------------------------------------------------------------------

ratios = st.fractions(F(2, 5), F(3, 2), max_denominator=12)
fractions = st.fractions(-2, 2, max_denominator=5)
turns_ = st.fractions(F(1, 7), 1, max_denominator=7)


def direct(name: str, ratio: Fraction, k: float) -> tuple[float, float]:
    """V S and V T of the table in 1D, from kernel values and the definition alone."""
    shape = kernel(name)
    n = int(float(shape.support) / float(ratio)) + 1
    s = [float(ratio) * j for j in range(1, n + 1)]
    rho = float(shape.w(0.0)) + 2 * sum(float(shape.w(x)) for x in s)
    big_s = 2 * sum(float(shape.dw(x)) * sin(pi * k * x / float(ratio)) for x in s) / rho
    big_t = 2 * sum(float(shape.d2w(x)) * (1 - cos(pi * k * x / float(ratio))) for x in s) / rho
    return big_s, big_t


@given(
    name=st.sampled_from(["cubic-spline", "quintic-spline", "wendland-c4-1d", "polynomial:3"]),
    ratio=ratios,
    k=turns_,
    p=fractions,
)
def test_the_rows_of_the_table_in_1d(name: str, ratio: Fraction, k: Fraction, p: Fraction) -> None:
    """D = (1 − 2p) S² + 2p T for every symmetric form, S² for difference and total Lagrangian,
    S²/M₁ for CSPH: exact numbers of the package against sums of 64-bit floats."""
    assume(ratio < kernel(name).support)
    s, t = direct(name, ratio, float(k))
    size = abs(1 - 2 * float(p)) * s * s + 2 * abs(float(p) * t) + 1e-3
    symmetric = (1 - 2 * float(p)) * s * s + 2 * float(p) * t
    for form, value in {
        "symmetric": symmetric,
        "symmetric-product": symmetric,
        "difference": s * s,
        "total-lagrangian": s * s,
    }.items():
        (mode,) = Rest(kernel(name), "uniform", ratio, force(form), p).modes((k,))
        assert mode.exact is not None
        assert abs(mode.omega2 - value) <= 1e-11 * size


@given(form=st.sampled_from(sorted(FORCES)), ratio=ratios, k=turns_, p=fractions)
def test_exact_numbers_are_those_of_50_digits(
    form: str, ratio: Fraction, k: Fraction, p: Fraction
) -> None:
    """Both are rounded once, to the nearest float."""
    setting = Rest(CUBIC, "uniform", ratio, force(form), p)
    (one,), (other,) = setting.modes((k,)), setting.modes((k,), exact=False)
    assert one.exact is not None
    assert other.exact is None
    assert one.omega2 == other.omega2


@given(order=st.sampled_from([8, 24, 40, 56]), j=st.integers(0, 80))
def test_roots_of_unity(order: int, j: int) -> None:
    """sin² + cos² = 1 and the normal form of a cosine, by its value."""
    turn = F(2 * j, order)
    arithmetic = turns(order)
    sine, cosine = arithmetic.sine(turn), arithmetic.cosine(turn)
    assert reduced(sine**2 + cosine**2 - 1, order) == 0
    assert reduced(arithmetic.versine(turn) + cosine - 1, order) == 0
    text = written(reduced(cosine, order), order)
    value = 0.0
    for part in text.replace("- ", "-").replace("+ ", "").split():
        sign = -1 if part.startswith("-") else 1
        size, _, angle = part.lstrip("-").rpartition("cos(")
        if not angle.endswith(")"):
            value += sign * float(F(part.lstrip("-")))
        else:
            top, _, bottom = angle[:-1].partition("pi/")
            turn_ = float(F(top.rstrip("*") or "1") / F(bottom))
            value += sign * (float(F(size.rstrip("*"))) if size else 1.0) * cos(pi * turn_)
    assert value == pytest.approx(cos(2 * pi * j / order), abs=4e-15)


@given(
    kind=st.sampled_from(["square", "hexagonal", "cubic", "bcc", "fcc"]),
    p=st.sampled_from([F(0), F(3, 5), F(-1, 3)]),
    form=st.sampled_from(["symmetric", "grad-h", "difference", "csph", "csph-symmetric"]),
    seed=st.integers(0, 10**6),
)
def test_waves_that_particles_cannot_tell_apart_have_the_same_frequencies(
    kind: str, p: Fraction, form: str, seed: int
) -> None:
    random = np.random.default_rng(seed)
    b = np.array([[float(c) for c in row] for row in reciprocal(kind)])
    k = random.uniform(-0.5, 0.5, len(b)) @ b
    moved = k + random.integers(-2, 3, len(b)) @ b
    setting = Rest(CUBIC, kind, F(4, 5), force(form), p)
    seen = setting.frequencies(setting.scan([k, moved, -k]))
    assert np.abs(seen.omega2[1] - seen.omega2[0]).max() <= 2 * seen.rounding
    assert np.abs(seen.omega2[2] - seen.omega2[0]).max() <= 2 * seen.rounding


def test_in_1d_csph_divides_by_the_moment_once_or_twice() -> None:
    """D = S²/M₁ with M₁ = −V Σ s Ŵ′, in fractions; S²/M₁² with the corrected divergence."""
    wave, order = exact_wave(CUBIC, "uniform", F(5, 6), (F(1, 3),), "summation")
    plain = reduced(dynamical(force("difference"), wave, QQ(0))[0, 0], order)
    csph = reduced(dynamical(force("csph"), wave, QQ(0))[0, 0], order)
    first = -wave.total(wave.f1 * wave.squares)
    assert csph * first == plain
    assert first != 1
    moved = dynamical(force("csph"), wave, QQ(0), corrected=True)[0, 0]
    assert reduced(moved, order) * first**2 == plain


# -- the tensile instability ---------------------------------------------------------------------

TENSILE = {
    "cubic-spline": {
        "3/10": "6/25",
        "1/3": "8/9",
        "2/5": "0",
        "1/2": "0",
        "3/5": "0",
        "2/3": "0",
        "7/10": "14/25",
        "10/13": "320/169",
        "5/6": "10/3",
        "1": "8",
        "5/4": "15/2",
        "3/2": "6",
    },
    "wendland-c2-1d": {
        "1/2": "15/16",
        "3/5": "9/10",
        "2/3": "0",
        "3/2": "225/32",
    },
}


@pytest.mark.parametrize(
    ("name", "ratio", "value"), [(n, r, v) for n, row in TENSILE.items() for r, v in row.items()]
)
def test_tensile_sums(name: str, ratio: str, value: str) -> None:
    """A = 4 Δs Σ_odd Ŵ″ at k = π/Δx, where S = 0: ω²h² = A P₀/ρ, whatever c is."""
    for p in ("1", "-1/10"):
        found = exact(rest(name, ratio=ratio, p=p, volume="constant"), "1")
        assert F(found[0]) == F(value) * F(p)


WENDLAND_DECIMALS = {"3/10": 0.16875, "1/3": 0.4166667, "10/13": 1.0923987, "1": 3.75}


@pytest.mark.parametrize(("ratio", "value"), WENDLAND_DECIMALS.items())
def test_tensile_sums_of_wendland_to_the_digits_given(ratio: str, value: float) -> None:
    (found,) = exact(rest("wendland-c2-1d", ratio=ratio, p="1", volume="constant"), "1")
    assert round(float(F(found)), 7) == value


@pytest.mark.parametrize("m", range(1, 8))
def test_the_tensile_sum_of_the_cubic_spline_vanishes_on_whole_intervals(m: int) -> None:
    """Σ_odd Ŵ″(jx) is the zero polynomial of x on 2/(4m+1) <= x <= 2/(4m−1), where no neighbour
    crosses a knot, and is not zero beyond both ends."""
    x = Symbol("x")
    second = [p.diff().diff() for p in CUBIC.pieces]

    def sum_on(low: Fraction, high: Fraction) -> Poly:
        middle = (low + high) / 2
        total = Poly(0, x, domain=QQ)
        for j in range(1, 8 * m + 20, 2):
            q = j * middle
            if q < 2:
                piece = second[0 if q < 1 else 1]
                scaled = Poly(Rational(j) * x, x, domain=QQ)
                total += Poly(piece.as_expr().subs(piece.gen, x), x, domain=QQ).compose(scaled)
        return total

    low, high = F(2, 4 * m + 1), F(2, 4 * m - 1)
    knots = {F(k, j) for k in (1, 2) for j in range(1, 8 * m + 20, 2)}
    assert not any(low < knot < high for knot in knots)
    assert sum_on(low, high).is_zero
    below = max(knot for knot in knots if knot < low)
    above = min(knot for knot in knots if knot > high)
    assert not sum_on(below, low).is_zero
    assert not sum_on(high, above).is_zero


def test_slight_tension_is_harmless_where_the_sum_vanishes() -> None:
    """Δx/h = 3/5: near k = π/Δx, ω² = (a + b p) ε² with the root p = −3/620."""
    wave, order = exact_wave(CUBIC, "uniform", F(3, 5), (F(1, 360),), "summation")
    assert order == 8 * 360
    # the coefficient of ε², ε = π − kΔx, from sin jk = ∓ sin jε and cos jk = ∓ cos jε for odd/even
    shape = wave.offsets[:, 0] / QQ(3, 5)
    signs = [(-1) ** abs(int(j)) for j in shape]
    s1 = sum(sign * g * j for sign, g, j in zip(signs, wave.gradient[:, 0], shape, strict=True))
    h = wave.hessian[:, 0, 0]
    t2 = sum(sign * value * j**2 for sign, value, j in zip(signs, h, shape, strict=True)) / 2
    v = wave.volume
    # (1 − 2p) V² s1² + 2p V t2 = 0
    root = -(v * s1**2) / (2 * (t2 - v * s1**2))
    assert F(int(root.numerator), int(root.denominator)) == F(-3, 620)


# -- remedies --------------------------------------------------------------------------------------

NEEDED = {"5/6": "113/1463", "10/13": "997/19147", "1": "1/7", "2/3": "0"}


@pytest.mark.parametrize(("ratio", "needed"), NEEDED.items())
def test_the_artificial_stress_that_is_needed(ratio: str, needed: str) -> None:
    """ω² at k = π/Δx is zero at ε* exactly, whatever the tension; a little more holds."""
    for p in ("-1/20", "-1"):
        at = rest(ratio=ratio, p=p, stress=ArtificialStress(F(needed)))
        assert exact(at, "1") == ["0"]
        more = rest(ratio=ratio, p=p, stress=ArtificialStress(F(needed) + F(1, 1000)))
        assert F(exact(more, "1")[0]) > 0
    none = rest(ratio=ratio, p="1", stress=ArtificialStress(F(needed)))
    assert exact(none, "1") == exact(rest(ratio=ratio, p="1"), "1")


def test_the_price_of_artificial_stress_is_the_sound_speed() -> None:
    plain = rest(p="-1/5").long_waves().sound_speed2
    held = rest(p="-1/5", stress=ArtificialStress(F(1, 5))).long_waves().sound_speed2
    assert round(float(plain), 4) == 1.0345
    assert round(float(held), 4) == 1.0860


STAGGERED = {  # Δx/h: Δs S_½h, Δs Σ Ŵ″ of the stress points at k = π/Δx
    "5/6": ("-35/72", "0"),
    "10/13": ("-50/169", "20/169"),
    "1": ("-1", "0"),
    "2/3": ("-2/27", "4/9"),
}


@pytest.mark.parametrize(("ratio", "sums"), STAGGERED.items())
def test_stress_points_have_no_hourglass(ratio: str, sums: tuple[str, str]) -> None:
    """ω² = (1 − p) S_½² + p Σ Ŵ″ at k = π/Δx."""
    slope, bend = map(F, sums)
    for p in (F(0), F(-3), F(1, 2)):
        (found,) = exact(rest(ratio=ratio, form="stress-points", p=str(p)), "1")
        assert F(found) == (1 - p) * slope**2 + p * bend
    assert F(exact(rest(ratio=ratio, form="stress-points"), "1")[0]) > 0


def test_tension_that_stress_points_still_do_not_bear() -> None:
    for ratio, limit in (("2/3", -0.0125), ("10/13", -2.84)):
        slope, bend = map(F, STAGGERED[ratio])
        root = slope**2 / (slope**2 - bend)
        assert float(root) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("form", ["total-lagrangian", "difference", "csph"])
@pytest.mark.parametrize("kind", ["uniform", "square", "hexagonal", "cubic", "bcc", "fcc"])
def test_zero_energy_modes_are_listed_and_are_zero(form: str, kind: str) -> None:
    setting = rest(kind=kind, form=form, p="-2")
    listed = setting.zero_modes()
    assert len(listed) == 2 ** KINDS[kind].dim - 1
    scan = setting.scan([[float(c) for c in kappa] for kappa in listed])
    seen = setting.frequencies(scan)
    assert np.abs(seen.omega2).max() <= seen.rounding
    assert rest(kind=kind, p="-2").zero_modes() == []


def test_the_pressure_cancels_in_the_reference_state() -> None:
    values = {exact(rest(form="total-lagrangian", p=p), "2/3")[0] for p in ("0", "-5", "7/3")}
    assert values == {"243/361"}


# -- the continuous limit --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["uniform", "square", "hexagonal", "cubic", "bcc", "fcc"])
@pytest.mark.parametrize("p", ["0", "3/5", "1", "-1/4"])
def test_many_neighbours_give_the_continuous_relation(kind: str, p: str) -> None:
    """(1 − 2p) F² + 2p F along k, nothing across, as Δx/h → 0; far from it at Δx/h = 5/6."""
    dim = KINDS[kind].dim
    kh = 1.5
    axis = pi / float(units(kind)[0])
    errors = []
    for ratio in ("5/6", "1/5"):
        setting = rest("wendland-c4", kind, ratio, p=p)
        kappa = [kh * float(F(ratio)) / axis, *[0.0] * (dim - 1)]
        seen = setting.frequencies(setting.scan([kappa]))
        f = float(transform(kernel("wendland-c4"), kh, dim))
        limit = (1 - 2 * float(F(p))) * f * f + 2 * float(F(p)) * f
        (same,) = continuous(kernel("wendland-c4"), dim, float(F(p)), (kh,))
        assert same == pytest.approx(limit, rel=1e-14)
        along = float(seen.omega2[0][seen.longitudinal[0]][0]) / kh**2
        across = [float(x) / kh**2 for x in seen.omega2[0][~seen.longitudinal[0]]]
        errors.append(max(abs(along - limit), *map(abs, across), 0.0))
    assert errors[1] < 1e-4
    assert errors[1] < errors[0] / 20


def test_without_pressure_sound_is_the_transform() -> None:
    """p = 0 and many neighbours: ω/(ck) = F, so A = −μ₂/2 = −1/6 for the cubic spline in 1D."""
    assert rest(ratio="1/2").long_waves().dispersion == F(-1, 6)
    series = long_wave(CUBIC, "uniform", F(1, 2), "summation")
    assert series is not None
    assert series.exact


# -- the zone --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_reciprocal_vectors_and_named_points(kind: str) -> None:
    for i, b in enumerate(reciprocal(kind)):
        for j, step in enumerate(KINDS[kind].primitive):
            assert sum(c * n for c, n in zip(b, step, strict=True)) == 2 * (i == j)
    for name in POINTS[kind]:
        assert inside(kind, point(kind, name))
    assert not inside(kind, reciprocal(kind)[0])
    assert all(inside(kind, k) for k in halves(kind))


@pytest.mark.parametrize("kind", ["square", "hexagonal", "cubic", "bcc", "fcc"])
def test_the_grid_holds_every_frequency_of_the_zone(kind: str) -> None:
    """A random wave of a coarse grid has its frequencies among those of the reduced grid."""
    setting = rest(kind=kind, ratio="4/5", p="3/5")
    n = 6
    b = np.array([[float(c) for c in row] for row in reciprocal(kind)])
    some = np.random.default_rng(5).integers(0, n, (12, len(b)))
    some[0] = 1
    some = some[some.any(axis=1)]
    full = setting.frequencies(setting.scan(some / n @ b))
    kept = setting.frequencies(setting.scan(grid(kind, n)))
    for row in full.omega2:
        assert np.abs(kept.omega2 - row).max(axis=1).min() <= 4 * full.rounding
    assert len(grid(kind, n)) < n ** len(b) / 2
    assert np.abs(shortest(kind, some / n @ b)).max() <= 2


def test_branches_where_they_meet() -> None:
    """On a cubic axis through a degenerate point one mode is longitudinal, the others are not."""
    modes = rest(kind="fcc", p="3/5").modes(point("fcc", "W"))
    assert sorted(m.branch for m in modes) == [LONGITUDINAL, TRANSVERSE, TRANSVERSE]
    (along,) = [m for m in modes if m.branch == LONGITUDINAL]
    assert abs(along.polarisation[0]) > 0.9


def test_growth_of_complex_frequencies() -> None:
    assert growth(-4.0) == 2
    assert growth(4.0) == 0
    assert growth(2j) == pytest.approx(1, rel=1e-15)


# -- what cannot be ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ratio": "-1"}, "dx-over-h: got -1, expected a positive number"),
        ({"ratio": "3"}, "no neighbour is inside the support of 2h"),
        ({"kind": "hcp", "form": "csph", "ratio": "4/5"}, "form: csph has no formula on hcp"),
        ({"kind": "square", "form": "stress-points"}, "expected --dim 1"),
        ({"form": "grad-h", "volume": "constant"}, "whose h follows the summed density"),
        ({"volume": "cell"}, "volume: got 'cell', expected one of summation, constant, corrected"),
        ({"volume": "corrected"}, "does not have; expected a csph form"),
        (
            {"form": "grad-h", "stress": ArtificialStress(1)},
            "artificial stress belongs to the form symmetric",
        ),
        ({"ratio": "9/4", "stress": ArtificialStress(1)}, "the kernel is zero at Δp"),
    ],
)
def test_what_has_no_formula_is_said(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rest(**arguments).modes((F(1), F(0), F(0))[: KINDS[arguments.get("kind", "uniform")].dim])


def test_a_wave_must_move_something() -> None:
    with pytest.raises(ValueError, match="k: got 0"):
        rest().modes((F(0),))
    with pytest.raises(ValueError, match="no point 'Q', expected one of X, L, W, K, U"):
        point("fcc", "Q")
    with pytest.raises(ValueError, match="no neighbour"):
        Scan("uniform", [[0.5]], 3).at(CUBIC, 2.5, "summation")


@pytest.mark.parametrize("form", ["symmetric", "grad-h", "difference"])
@pytest.mark.parametrize("p", ["0", "3/5"])
def test_long_waves_where_the_cell_has_two_particles(form: str, p: str) -> None:
    """hcp: the acoustic branch of 50 digits is that of floats at a small k, to its own k²h² term
    (which low optical modes make large: only the trend is asked for)."""
    setting = rest("wendland-c4", "hcp", "3/5", form, p)
    found = setting.long_waves()
    seen = setting.frequencies(setting.scan([[1e-3, 0.0, 0.0]]))
    relative = seen.omega2[0] / seen.k[0] ** 2
    error = seen.rounding / seen.k[0] ** 2 + 10 * abs(found.dispersion) * seen.k[0] ** 2
    assert np.abs(relative - found.sound_speed2).min() <= error < 1e-2
    modes = setting.modes(point("hcp", "K"))
    assert sorted(m.branch for m in modes).count(LONGITUDINAL) == 2
