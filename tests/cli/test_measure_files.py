"""measure on the files that people have: dimension, columns, duplicates, single targets, units."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import sphtrunc
from sphtrunc.cli import main

BASE = ["measure", "--kernel", "wendland-c2"]


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run measure in an empty folder: what it printed, said, and its status."""
    monkeypatch.chdir(tmp_path)

    def measure(*options: str) -> tuple[str, str, int]:
        with pytest.raises(SystemExit) as stop:
            main([*BASE, *options])
        streams = capsys.readouterr()
        return streams.out, streams.err, stop.value.code

    return measure


def cells(side: int, dim: int) -> np.ndarray:
    grid = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(*[grid] * dim, indexing="ij"), axis=-1).reshape(-1, dim)


def first_moment(x: np.ndarray, h: float) -> float:
    """M(1,0,0) of the gradient of the first particle in a periodic unit box, Wendland's
    C2 in 3D (21/(16π) (1 − q/2)⁴ (1 + 2q)), pair by pair, with volumes 1/Σ_b W."""
    d = x - x[0]
    d -= np.round(d)
    q = np.sqrt((d**2).sum(axis=1)) / h
    slope = 21 / (16 * np.pi) * -5 * q * np.clip(1 - q / 2, 0, None) ** 3
    with np.errstate(invalid="ignore"):
        terms = np.where(q > 0, slope * (d[:, 0] / h) ** 2 / q, 0.0)
    density = 21 / (16 * np.pi) * (np.clip(1 - q / 2, 0, None) ** 4 * (1 + 2 * q)).sum()
    return float(-terms.sum() / density)


def test_coordinates_in_arrays_of_their_own_are_three_dimensions(run):
    x = cells(8, 3)
    np.savez("a.npz", x=x[:, 0], y=x[:, 1], z=x[:, 2], h=0.2)
    for options in (["--dim", "3"], []):
        out, _, _ = run("--particles", "a.npz", "--period", "1", "--format", "json", *options)
        data = json.loads(out)
        assert data["dim"] == 3
        expected = first_moment(x, 0.2)
        assert expected == pytest.approx(0.9971866, abs=5e-8)
        assert data["moments"]["1,0,0"]["mean"] == pytest.approx(expected, rel=1e-13)
    out, err, status = run("--particles", "a.npz", "--dim", "1")
    assert (out, status) == ("", 2)
    assert "they are in 3D" in err


def test_a_constant_coordinate_is_said_and_no_dimension(run):
    x = cells(10, 2)
    rows = "\n".join(f"{a!r},{b!r},0.0,0.15,0.01" for a, b in x.tolist())
    Path("a.csv").write_text(f"x,y,z,h,volume\n{rows}\n", encoding="utf-8")
    out, err, _ = run("--particles", "a.csv", "--dim", "2", "--period", "1")
    assert "2D" in out
    assert "z = 0 throughout" in err
    _, err, status = run("--particles", "a.csv", "--dim", "3", "--period", "1")
    assert status == 2
    assert "they are in 2D" in err


def test_names_of_codes_and_masses(run):
    """m and rho are read, by whatever name; the volume is m/ρ."""
    x = cells(10, 2)
    np.savez("a.npz", Coordinates=x, hsml=0.15, m=0.02, Density=2.0, potential=x[:, 0])
    out, err, _ = run("--particles", "a.npz", "--period", "1", "--format", "json")
    data = json.loads(out)
    assert data["volume"] == "given"
    assert "columns potential are not used" in err
    assert data["moments"]["1,0"]["mean"] == pytest.approx(1.0, abs=0.1)


def test_h_of_the_command_wins_and_it_is_said(run):
    np.savez("a.npz", x=cells(10, 2), h=0.15, volume=0.01)
    one = json.loads(run("--particles", "a.npz", "--period", "1", "--format", "json")[0])
    out, err, _ = run("--particles", "a.npz", "--period", "1", "--h", "0.2", "--format", "json")
    assert "h = 0.2 as given; that of the file is not used" in err
    assert json.loads(out)["moments"]["1,0"]["mean"] != one["moments"]["1,0"]["mean"]


def test_coincident_particles_have_to_be_allowed(run):
    rows = "\n".join(f"{i / 10},0.12" for i in range(11))
    Path("a.csv").write_text(f"x,h\n{rows}\n", encoding="utf-8")
    out, err, status = run("--particles", "a.csv", "--period", "1", "--volume", "cell")
    assert (out, status) == ("", 2)
    assert "1 of 11 are where another one is, modulo the period; the first are 0 and 10" in err
    _, err, status = run("--particles", "a.csv", "--period", "1", "--allow-duplicates")
    assert status == 0
    assert "warning: particles: 1 of 11 are where another one is, modulo the period" in err
    assert "the first are 0 and 10" in err


def test_a_slab_is_periodic_along_some_axes(run):
    x = cells(8, 3)
    np.savez("a.npz", x=x, h=0.2, volume=1 / 512)
    out, _, _ = run("--particles", "a.npz", "--period", "1,1,inf", "--format", "json")
    slab = json.loads(out)["moments"]["1,0,0"]
    out, _, _ = run("--particles", "a.npz", "--period", "1,1,9", "--format", "json")
    wide = json.loads(out)["moments"]["1,0,0"]
    for name in ("mean", "std", "p1", "p50"):
        assert slab[name] == pytest.approx(wide[name], rel=1e-12)
    assert slab["std"] > 0.01  # the surfaces


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_estimates_are_printed_and_written_target_by_target(suffix, run):
    x = cells(12, 2)
    values = 3 * x[:, 0] - 2 * x[:, 1]
    np.savez("a.npz", x=x, h=0.12, volume=1 / 144, pressure=values)
    out, _, _ = run(
        "--particles", "a.npz", "--field", "pressure", "--form", "difference", "--correction",
        "csph", "--moments", "1", "-o", f"t.{suffix}",
    )  # fmt: skip
    line = next(row.split() for row in out.splitlines() if row.startswith("  x "))
    assert [float(v) for v in line[1:]] == pytest.approx([3.0] * 5, rel=1e-11)
    if suffix == "npz":
        table = dict(np.load("t.npz"))
    else:
        with open("t.csv", newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        table = {n: np.array([float(r[i]) for r in rows[1:]]) for i, n in enumerate(rows[0])}
    np.testing.assert_array_equal(np.stack([table["x"], table["y"]], axis=1), x)
    np.testing.assert_allclose(table["estimate x"], 3.0, rtol=1e-12)
    np.testing.assert_allclose(table["estimate y"], -2.0, rtol=1e-12)
    np.testing.assert_allclose(table["M(1,0)"], 1.0, rtol=1e-12)
    assert not table["flagged"].any()


def test_flagged_targets_have_no_figures(run):
    x = np.concatenate([cells(8, 2), [[9.0, 9.0]]])
    np.savez("a.npz", x=x, h=0.16, volume=1 / 64, values=x[:, 0])
    run("--particles", "a.npz", "--field", "values", "--correction", "csph", "-o", "t.csv")
    with open("t.csv", newline="", encoding="utf-8") as file:
        *_, last = csv.DictReader(file)
    assert (last["flagged"], last["estimate x"]) == ("1", "")


def test_surfaces_are_not_hidden_in_a_mean(run):
    """Quantiles of the moments: inside 1, at a free surface about half of it."""
    np.savez("a.npz", x=cells(16, 2), h=1.2 / 16, volume=1 / 256)
    out, _, _ = run("--particles", "a.npz", "--operator", "value", "--format", "json")
    found = json.loads(out)["moments"]["0,0"]
    assert found["p50"] == pytest.approx(1.0, abs=0.02)
    assert found["p1"] < 0.7 < found["mean"] < found["p99"]


def test_a_table_of_targets_belongs_to_a_file(run):
    _, err, status = run("--dx-over-h", "1/2", "-o", "t.csv")
    assert status == 2
    assert "belongs to --particles FILE" in err


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("engine", ["numpy", "numba"])
def test_units_do_not_matter(dim, engine):
    """From 1e-150 to 1e150 the sums are those in the unit of h, to the rounding of the input."""
    rng = np.random.default_rng(3)
    x = cells(64 if dim == 1 else 12, dim)
    x = x + rng.normal(scale=0.01, size=x.shape)
    kernel = sphtrunc.kernel("cubic-spline")
    one = (1,) + (0,) * (dim - 1)
    found = []
    for unit in (1.0, 2.0**-498, 2.0**-300, 2.0**300, 2.0**498):
        h = 0.13 * unit
        scene = sphtrunc.particles(x * unit, h=h, volume=1 / len(x) * unit**dim, period=2 * unit)
        sums = sphtrunc.pair_sums(scene, kernel, [(one, one)], engine=engine)
        found.append(sums.base[one, one])
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
    assert np.all(found[0] > 0.2)


def test_a_small_unit_changes_no_figure(run):
    x = np.random.default_rng(5).random((200, 1))
    for unit, name in ((1.0, "a"), (1e-160, "b")):
        np.savez(f"{name}.npz", x=x * unit, h=0.05 * unit, volume=0.005 * unit)
    data = [json.loads(run("--particles", f"{name}.npz", "--format", "json")[0]) for name in "ab"]
    for alpha, row in data[0]["moments"].items():
        assert data[1]["moments"][alpha]["mean"] == pytest.approx(row["mean"], rel=1e-12, abs=1e-14)


def every_moment(x, h, mass, density, form: str, component: str, alpha: tuple[int, int]):
    """M_α of one component at every particle of an open plane, pair by pair: Wendland's C2 in 2D,
    7/(4π) (1 − q/2)⁴ (1 + 2q), with volumes m/ρ."""
    s = (x[None, :, :] - x[:, None, :]) / h  # from a to b
    q = np.sqrt((s**2).sum(axis=2))
    volume = mass / density / h**2
    weight = 7 / (4 * np.pi) * 5 * np.clip(1 - q / 2, 0, None) ** 3 * volume[None, :]
    axis = dict(zip("xy", np.moveaxis(weight[:, :, None] * s, 2, 0), strict=True))  # −V ∂W
    field = s[:, :, 0] ** alpha[0] * s[:, :, 1] ** alpha[1]  # of a at c
    ratio = density[:, None] / density[None, :]
    if form == "standard":
        return (axis[component] * field).sum(axis=1)
    if form == "symmetric":
        own = float(not any(alpha))
        return (axis[component] * (field * ratio + own / ratio)).sum(axis=1)
    outer, inner = (axis[name] for name in component)
    rows = []
    for a in range(len(x)):
        slope = (inner * (field[a][None, :] - field[a][:, None])).sum(axis=1)  # at every b
        rows.append((outer[a] * (slope - slope[a])).sum())
    return np.array(rows)


@pytest.mark.parametrize(
    ("operator", "form", "components"),
    [
        ("gradient", "standard", ("x", "y")),
        ("divergence", "symmetric", ("x", "y")),
        ("gradient", "symmetric", ("x", "y")),
        ("hessian", "nested", ("xx", "xy", "yy")),
    ],
)
def test_every_component_has_moments(operator, form, components, run):
    random = np.random.default_rng(7)
    x = cells(5, 2) + random.uniform(-0.04, 0.04, (25, 2))
    mass, density = random.uniform(0.03, 0.05, 25), random.uniform(0.8, 1.2, 25)
    rows = zip(*x.T, mass, density, strict=True)
    text = "\n".join(",".join(map(repr, map(float, row))) for row in rows)
    Path("a.csv").write_text(f"x,y,mass,density\n{text}\n", encoding="utf-8")
    options = ("--particles", "a.csv", "--h", "0.3", "--operator", operator, "--form", form)
    out, _, _ = run(*options, "--moments", "2", "--format", "json")
    data = json.loads(out)
    assert tuple(data["moments_of"]) == components
    assert data["moments_of"][components[0]] == data["moments"]
    run(*options, "--moments", "2", "-o", "each.npz")
    each = np.load("each.npz")
    for i, component in enumerate(components):
        for alpha in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
            expected = every_moment(x, 0.3, mass, density, form, component, alpha)
            name = f"M({alpha[0]},{alpha[1]})" + (f" of {component}" if i else "")
            assert each[name] == pytest.approx(expected, rel=1e-12, abs=1e-13)
            row = data["moments_of"][component][f"{alpha[0]},{alpha[1]}"]
            assert row["mean"] == pytest.approx(expected.mean(), rel=1e-12, abs=1e-13)
            assert row["p50"] == pytest.approx(np.median(expected), rel=1e-12, abs=1e-13)
            assert row["p1"] <= row["p50"] <= row["p99"]


def test_the_components_of_a_table_are_named(run):
    np.savez("a.npz", x=cells(6, 2)[:, 0], y=cells(6, 2)[:, 1], h=0.3)
    out, _, _ = run("--particles", "a.npz", "--moments", "1")
    assert "Discrete moments of x" in out
    assert "Discrete moments of y" in out
    assert out.count("median") == 2
    table, _, _ = run("--particles", "a.npz", "--moments", "1", "--format", "csv")
    names = [row[0] for row in csv.reader(table.splitlines())]
    assert {"moment 1 0", "moment of y 0 1"} < set(names)
