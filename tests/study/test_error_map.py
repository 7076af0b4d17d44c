"""Error maps: the moments of every particle, what they mean for a field, and their files."""

from __future__ import annotations

import csv
import json

import h5py
import numpy as np
import pytest

import sphtrunc
from sphtrunc import Operator
from sphtrunc.cli import main
from sphtrunc.scenes.particle_files import vtp
from sphtrunc.study.snapshots.error_map import DEFAULT, error_map
from sphtrunc.study.snapshots.map_files import write
from sphtrunc.study.snapshots.surfaces import half_space_sums, surface_distance

KERNEL = sphtrunc.kernel("wendland-c2")
SECOND = (Operator("laplacian", "brookshaw"), Operator("hessian", "difference", "rkpm-2"))


def jittered(side: int, dim: int, sigma: float = 0.1, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    grid = (np.arange(side) + 0.5) / side
    x = np.stack(np.meshgrid(*[grid] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return (x + rng.normal(scale=sigma / side, size=x.shape)) % 1.0


@pytest.fixture(scope="module")
def lattice(tmp_path_factory):
    """A jittered lattice that was written to a file and read back."""
    path = tmp_path_factory.mktemp("map") / "lattice.npz"
    x = jittered(12, 2)
    np.savez(path, x=x, h=0.13, m=1 / len(x), rho=1 + 0.1 * x[:, 0])
    return sphtrunc.snapshot(path, period=1.0)


@pytest.mark.parametrize(
    "operator", [*DEFAULT, *SECOND, Operator("value", None, "shepard")], ids=str
)
def test_moments_are_those_of_measure_to_the_rounding_bound(operator, lattice):
    """`measure` in compensated arithmetic, pair by pair; c u Σ|w||s|^α of the weights, c the number
    of neighbours and of operations for each, times the condition of the correction."""
    found = error_map(lattice, KERNEL, [operator], degree=3)
    (moments,) = found.moments.values()
    measured = sphtrunc.measure(
        lattice, KERNEL, operator, moments=3, targets="all", precision="compensated"
    )
    h = float(lattice.h[0])
    w = abs(sphtrunc.weights(lattice, KERNEL, operator).toarray()) * h**operator.derivatives
    d = lattice.x[:, None, :] - lattice.x[:, :, None]
    s = np.abs(d - np.round(d)) / h
    operations = 32 + (w > 0).sum(axis=1)
    for i, alpha in enumerate(map(tuple, found.alpha.tolist())):
        size = (w * s[0] ** alpha[0] * s[1] ** alpha[1]).sum(axis=1)
        bound = 2.0**-53 * operations * (1.0 + found.condition) * size
        assert np.all(np.abs(moments[:, 0, i] - measured.moments.values[alpha]) <= bound), alpha


@pytest.mark.parametrize("operator", [*DEFAULT, *SECOND], ids=str)
def test_all_components_are_those_of_the_matrix(operator):
    """Free particles: the matrix of the operator applied to (x − x_a)^α."""
    x = jittered(6, 2, seed=5)
    scene = sphtrunc.particles(x, h=0.25, mass=np.full(36, 1 / 36), density=1 + x[:, 1])
    found = error_map(scene, KERNEL, [operator], degree=2)
    (moments,) = found.moments.values()
    k = operator.derivatives
    for c in range(moments.shape[1]):
        w = sphtrunc.weights(scene, KERNEL, operator, axis=c)
        for i, alpha in enumerate(found.alpha):
            powers = ((x[None] - x[:, None]) / 0.25) ** alpha
            expected = 0.25**k * np.array([w[[a]] @ powers[a].prod(axis=1) for a in range(36)])
            size = 0.25**k * abs(w).sum(axis=1).max() * 4.0 ** alpha.sum()
            np.testing.assert_allclose(moments[:, c, i], expected[:, 0], rtol=0, atol=1e-13 * size)


def test_some_targets_are_the_same_as_all(lattice):
    whole = error_map(lattice, KERNEL)
    some = error_map(lattice, KERNEL, targets=20, seed=3)
    assert some.targets == 20
    for name, values in some.moments.items():
        np.testing.assert_array_equal(values, whole.moments[name][some.target])
    np.testing.assert_array_equal(some.gamma, whole.gamma[some.target])


def test_walls_of_a_file_are_no_targets(tmp_path):
    x = jittered(8, 2)
    with h5py.File(tmp_path / "p.hdf5", "w") as f:
        f.create_group("solver_data")
        for name, part in (("fluid", x[:48]), ("wall", x[48:])):
            arrays = f.create_group(f"particles/{name}/arrays")
            arrays["x"], arrays["y"] = part.T
            arrays["h"] = np.full(len(part), 0.2)
    found = error_map(sphtrunc.snapshot(tmp_path / "p.hdf5"), KERNEL)
    np.testing.assert_array_equal(found.target, np.arange(48))


# ------------------------------------------------------------------------------ errors of a field


def test_the_predicted_error_of_a_sinusoid_is_its_error():
    """To 5 % at 90 % of the particles and more, h/λ <= 0.05; where it is trusted, nearly always."""
    side = 30
    x = jittered(side, 2, seed=7)
    h = 1.5 / side
    scene = sphtrunc.particles(x, h=h, volume=1 / len(x), period=1.0)
    wave = 2 * np.pi
    values = np.sin(wave * x[:, 0])
    found = error_map(scene, KERNEL, fields={"A": values})
    for operator in DEFAULT:
        name = f"{operator.name}_{operator.form}_{operator.correction}"
        w = [sphtrunc.weights(scene, KERNEL, operator, axis=c) @ values for c in range(2)]
        true = np.stack([w[0] - wave * np.cos(wave * x[:, 0]), w[1]], axis=1)
        one = found.fields["A"][name]
        relative = np.linalg.norm(one.error - true, axis=1) / np.linalg.norm(true, axis=1)
        assert np.mean(relative <= 0.05) >= 0.9, name
        assert np.mean(relative[one.trusted] <= 0.05) >= 0.98, name
        assert np.mean(one.trusted) >= 0.8, name
        rms = np.sqrt(np.mean((wave * np.cos(wave * x[:, 0])) ** 2))
        assert one.scale == pytest.approx(rms, rel=0.01)
    csph = found.fields["A"]["gradient_difference_csph"]
    # what is left of CSPH on a regular lattice is the smoothing error, h²M₃/6 A‴
    assert np.linalg.norm(csph.smoothing) == pytest.approx(np.linalg.norm(csph.error), rel=0.2)


def test_a_field_that_is_not_resolved_is_not_trusted():
    x = jittered(16, 2)
    scene = sphtrunc.particles(x, h=0.1, volume=1 / len(x), period=1.0)
    noise = np.random.default_rng(2).normal(size=len(x))
    found = error_map(scene, KERNEL, fields={"noise": noise})
    assert np.mean(found.flag & 4 > 0) > 0.9


# --------------------------------------------------------------------------------------- surfaces


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_gamma_tells_the_distance_to_a_plane_surface(dim):
    """The share of the kernel on this side of a plane, summed over a fine lattice."""
    fine = np.arange(-2, 2, 0.04) + 0.02
    s = np.stack(np.meshgrid(*[fine] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    w = KERNEL.w(np.sqrt((s**2).sum(axis=1)), dim) * 0.04**dim
    distances = np.array([0.0, 0.12, 0.24, -0.4])
    gamma = np.array([w[s[:, 0] < z].sum() for z in distances]) / w.sum()
    np.testing.assert_allclose(surface_distance(KERNEL, dim, gamma), distances, atol=3e-3)


@pytest.mark.parametrize(
    ("name", "dim", "expected"),
    [
        ("cubic-spline", 1, (307 / 384, 23 / 48, 13 / 80, 215 / 384)),
        ("wendland-c2", 2, (0.8234969143, 0.48373139796, 0.13697944466, 0.58163121532)),
        ("wendland-c2", 3, (108473 / 131072, 8019 / 16384, 69255 / 524288, 76397 / 131072)),
    ],
)
def test_sums_over_half_a_space(name, dim, expected):
    """∫W, −∫∂ₙW, ∫sₙW and −∫sₙ∂ₙW at half an h from a plane, along an axis and in a turned frame;
    in 1D integrals of the pieces, in 2D and 3D of the kernel that is integrated over the plane."""
    zero, one = (0,) * dim, (1,) + (0,) * (dim - 1)
    keys = [(zero, zero), (one, zero), (zero, one), (one, one)]
    turned = np.full(dim, dim**-0.5)
    normal = np.stack([np.eye(dim)[0], turned])
    found = half_space_sums(sphtrunc.kernel(name), keys, normal, np.array([0.5, 0.5]))
    for key, value in zip(keys, expected, strict=True):
        assert found[key][0] == pytest.approx(value, abs=1e-4)
    assert found[keys[0]][1] == pytest.approx(expected[0], abs=1e-4)
    assert found[keys[1]][1] == pytest.approx(expected[1] * turned[0], abs=1e-4)


def test_what_a_surface_does_is_told_apart_from_disorder():
    """A strip with two free surfaces and hardly any disorder: of the error of the gradient of y
    nearly all is of the boundary there, nothing of it inside; the parts add up to the whole."""
    side, h = 32, 1.8 / 32
    x = jittered(side, 2, sigma=0.005, seed=2)
    x = x[x[:, 1] < 0.5]
    scene = sphtrunc.particles(x, h=h, volume=side**-2.0, period=[1.0, np.inf])
    found = error_map(scene, KERNEL, DEFAULT[:2], fields={"y": 1 + x[:, 1]})
    for one in found.fields["y"].values():
        left = np.linalg.norm(one.disorder, axis=1)
        whole = np.linalg.norm(one.error, axis=1)
        at = found.distance < 0.8
        assert at.sum() >= 2 * side
        assert np.sqrt((left[at] ** 2).mean()) < 0.15 * np.sqrt((whole[at] ** 2).mean())
        inside = np.isinf(found.distance)
        assert inside.sum() > 5 * side
        assert not one.boundary[inside].any()
        np.testing.assert_allclose(one.smoothing + one.boundary + one.disorder, one.error)


def test_a_linear_field_has_no_smoothing_error_up_to_the_surface():
    """Where a support is cut, RKPM of degree 3 is as good as singular: what it makes of rounding is
    not taken for derivatives."""
    x = jittered(24, 2, sigma=0.05)
    scene = sphtrunc.particles(x, h=1.3 / 24, volume=24.0**-2)
    found = error_map(scene, KERNEL, fields={"p": 1e5 - 1e4 * x[:, 1]})
    for one in found.fields["p"].values():
        assert one.scale == pytest.approx(1e4, rel=1e-9)
        assert np.abs(one.smoothing).max() < 1e-9 * one.scale
    assert np.abs(found.fields["p"]["gradient_difference_csph"].error).max() < 1e-9 * one.scale
    standard = found.fields["p"]["gradient_standard_none"]
    for c in range(2):
        w = sphtrunc.weights(scene, KERNEL, DEFAULT[0], axis=c)
        true = w @ (1e5 - 1e4 * x[:, 1]) + 1e4 * c
        np.testing.assert_allclose(standard.error[:, c], true, rtol=0, atol=1e-6 * abs(true).max())


def test_a_free_surface_is_found_and_dominates(tmp_path):
    x = jittered(16, 2, sigma=0.05) * [1.0, 0.5]
    scene = sphtrunc.particles(x, h=0.1, mass=np.full(256, 0.5 / 256), density=np.ones(256))
    found = error_map(scene, KERNEL)
    inside = np.all((x > 0.2) & (x < [0.8, 0.3]), axis=1)
    edge = (x[:, 0] < 0.05) | (x[:, 0] > 0.95)
    assert np.all(np.isinf(found.distance[inside]))
    assert np.all(np.isfinite(found.distance[edge]))
    assert found.says().startswith("boundaries dominate")
    assert "csph is exact for linear fields" in found.says()


def test_a_particle_alone_is_flagged():
    x = np.concatenate([jittered(6, 2), [[9.0, 9.0]]])
    scene = sphtrunc.particles(x, h=0.3, volume=1 / 36)
    found = error_map(scene, KERNEL)
    assert found.flag[-1] & 2
    assert found.flag[-1] & 1
    assert not np.any(found.flag[:-1])
    assert found.to_dict()["flagged"] == 1


# ------------------------------------------------------------------------------------------ files


def test_files_hold_what_the_map_holds(lattice, tmp_path):
    found = error_map(lattice, KERNEL, fields={"rho": lattice.fields["density"]})
    for name in ("map.npz", "map.hdf5", "map.csv", "map.vtp"):
        write(found, tmp_path / name)
    arrays = found.arrays()
    npz = np.load(tmp_path / "map.npz")
    assert {"x", "alpha", "gamma", "condition", "flag"} <= set(npz.files)
    assert npz["moments_gradient_difference_csph"].shape == (144, 2, len(npz["alpha"]))
    with h5py.File(tmp_path / "map.hdf5") as hdf:
        for key, values in arrays.items():
            np.testing.assert_array_equal(npz[key], values)
            np.testing.assert_array_equal(hdf[key][()], values)
    with open(tmp_path / "map.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["gamma"]) for row in rows] == found.gamma.tolist()
    column = "gradient_difference_csph[1] M(0,1)"
    assert float(rows[5][column]) == pytest.approx(1.0, abs=1e-12)
    back = sphtrunc.snapshot(tmp_path / "map.vtp", h=0.1)
    np.testing.assert_array_equal(back.x, lattice.x)
    with pytest.raises(ValueError, match=r"expected a name ending in \.npz, \.csv"):
        write(found, tmp_path / "map.xlsx")


def test_points_for_paraview_carry_their_numbers(tmp_path):
    x = np.random.default_rng(1).random((7, 3))
    (tmp_path / "a.vtp").write_bytes(vtp(x, {"density": x[:, 0] + 1, 'a<b & "c"': x[:, 1]}))
    found = sphtrunc.snapshot(tmp_path / "a.vtp", h=1.0)
    np.testing.assert_array_equal(found.fields["density"], x[:, 0] + 1)


# --------------------------------------------------------------------------------- command line


def run(capsys, *options):
    with pytest.raises(SystemExit) as stop:
        main(["map", *options])
    streams = capsys.readouterr()
    return streams.out, streams.err, stop.value.code


def test_the_command_finds_the_kernel_and_writes(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    x = jittered(6, 3, sigma=0.2)
    d = x[:, None] - x[None]
    u = np.sqrt(((d - np.round(d)) ** 2).sum(axis=2)) / 0.35
    w = 21 / (2 * np.pi) * np.clip(1 - u, 0, None) ** 4 * (1 + 4 * u) / 0.35**3
    rho = w.sum(axis=1) / 216
    np.savez("a.npz", x=x, h=0.35, m=np.full(216, 1 / 216), rho=rho)
    out, err, status = run(
        capsys, "a.npz", "--period", "1", "-o", "map.npz", "--picture",
        "map.png", "--format", "json",
    )  # fmt: skip
    assert status == 0
    assert "kernel wendland-c2, support 1 h, from the densities" in err
    data = json.loads(out)
    assert data["schema"] == "sphtrunc.map/1"
    assert len(data["worst"]) == 10
    gamma = np.load("map.npz")["gamma"]
    np.testing.assert_allclose(gamma, (w / 216 / rho[None]).sum(axis=1), rtol=1e-12)
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("dim", [1, 2])
def test_pictures_in_other_dimensions(dim, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    x = jittered(12, dim)
    np.savez("a.npz", x=x, h=0.2, pressure=x[:, 0] ** 2)
    out, _, status = run(
        capsys, "a.npz", "-k", "cubic-spline", "--field", "pressure", "--picture", "map.svg"
    )
    assert status == 0
    assert "Worst particles" in out
    assert "Expected error of pressure" in out
    assert "<svg" in (tmp_path / "map.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["a.npz"], "the densities of the file do not tell which it is"),
        (["a.npz", "-k", "cubic-spline", "--estimate", "gradient/nested"], "form: got 'nested'"),
        (["a.npz", "-k", "cubic-spline", "--estimate", "laplacian/nested"], "nested form"),
        (["a.npz", "-k", "cubic-spline", "--estimate", "a/b/c/d"], "operator/form/correction"),
        (["a.npz", "-k", "cubic-spline", "--field", "heat"], "the file has no heat; there are h"),
        (["a.npz", "-k", "cubic-spline", "--degree", "99"], "expected 1 to 8"),
        (["a.npz", "-k", "cubic-spline", "--targets", "0"], "expected at least 1"),
        (["a.npz", "-k", "cubic-spline", "-o", "a.txt"], "expected a name ending in"),
        (["a.npz", "-k", "cubic-spline", "--picture", "a.txt"], "expected a name ending in"),
        (["a.npz", "-k", "gaussian"], "expected a polynomial one"),
    ],
)
def test_a_wrong_option_is_one_line(options, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.savez("a.npz", x=jittered(6, 2), h=0.2)
    out, err, status = run(capsys, *options)
    assert (out, status) == ("", 2)
    assert message in err
    assert err.count("\n") == 1
