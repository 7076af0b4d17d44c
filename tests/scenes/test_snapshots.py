"""Files of SPH codes: every format and every variation of it is read as it was written."""

from __future__ import annotations

import sys
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import sphtrunc
from sphtrunc.scenes.snapshots.columns import assigned, chosen, meaning
from sphtrunc.scenes.snapshots.formats import read
from tests.scenes import written

C = written.cloud()


@pytest.mark.parametrize("name", written.FORMATS)
def test_a_file_is_read_as_it_was_written(name, tmp_path):
    path, kept = written.write(tmp_path, name, C)
    found = read(path)
    assert (found.dim, found.count, found.axes) == (3, C.n, ("x", "y", "z"))
    np.testing.assert_array_equal(found.x.T, kept.x)
    h = np.full(C.n, C.h[0]) if name.startswith("bi4") else kept.h
    np.testing.assert_array_equal(found.fields["h"], h)
    mass = np.full(C.n, C.m[0]) if name in ("gadget", "bi4") else kept.m
    np.testing.assert_array_equal(found.fields["mass"], mass)
    if name == "phantom":
        density = C.m * (1.2 / C.h) ** 3
        np.testing.assert_allclose(found.fields["density"], density, rtol=4e-16)
    else:
        rho = kept.rho if "bi4" not in name else C.single().rho
        np.testing.assert_array_equal(found.fields["density"], rho)
    assert sum(found.counts.values()) >= C.n


@pytest.mark.parametrize("name", [n for n in written.FORMATS if "two" not in n and n != "arepo"])
def test_velocities_are_vectors_along_the_axes(name, tmp_path):
    path, kept = written.write(tmp_path, name, C)
    single = kept.single() if name.startswith(("swift", "bi4")) else kept
    np.testing.assert_array_equal(read(path).fields["velocity"].T, single.v)


@pytest.mark.parametrize("name", written.FORMATS)
def test_particles_of_a_plane_are_in_two_dimensions(name, tmp_path):
    flat = written.cloud(side=6, dim=2)
    path, kept = written.write(tmp_path, name, flat)
    found = read(path)
    assert found.axes == ("x", "y")
    assert any("z = 0 throughout" in note for note in found.notes)
    np.testing.assert_array_equal(found.x.T, kept.x[:, :2])
    assert read(path, dim=2).dim == 2
    for wrong in (1, 3):
        with pytest.raises(ValueError, match=f"dim: got {wrong}, .*z = 0 throughout.*in 2D"):
            read(path, dim=wrong)


def test_a_plane_of_x_and_z_keeps_its_axes(tmp_path):
    flat = written.cloud(side=6, dim=2)
    turned = replace(flat, x=flat.x[:, [0, 2, 1]], v=flat.v[:, [0, 2, 1]])
    written.bi4(tmp_path / "p.bi4", turned, double=True)
    found = read(tmp_path / "p.bi4")
    assert found.axes == ("x", "z")
    np.testing.assert_array_equal(found.fields["velocity"].T, flat.single().v[:, :2])


# ------------------------------------------------------------------------- what codes do each


def test_header_masses_types_and_units_of_gadget(tmp_path):
    path = tmp_path / "g.hdf5"
    written.gadget(path, C, cosmology=True)
    notes = " ".join(read(path).notes)
    assert "comoving, at scale factor 0.5" in notes
    assert "factors 1/h, h = 0.7" in notes
    assert "does not say whether the box is periodic" in notes
    assert "single precision" in notes
    with pytest.raises(ValueError, match="no particles of type 1, only 0"):
        read(path, type="1")
    assert read(path, period="none").period is None
    np.testing.assert_array_equal(read(path).period, [1, 1, 1])


def test_a_missing_piece_of_a_snapshot_is_missed(tmp_path):
    path = tmp_path / "g.0.hdf5"
    written.gadget_pieces(path, C)
    (tmp_path / "g.1.hdf5").unlink()
    with pytest.raises(ValueError, match=r"one of 2 files, and g\.1\.hdf5 is missing"):
        read(path)
    path.rename(tmp_path / "alone.hdf5")
    with pytest.raises(ValueError, match=r"its name is not NAME\.0\.hdf5"):
        read(tmp_path / "alone.hdf5")


def test_boundary_particles_are_sources_and_dead_ones_are_left_out(tmp_path):
    types = np.where(np.arange(C.n) % 3 == 0, 3, 1)
    dead = replace(C, h=np.where(np.arange(C.n) == 7, -0.2, C.h))
    written.phantom(tmp_path / "p.h5", dead, types=types)
    found = read(tmp_path / "p.h5")
    keep = np.arange(C.n) != 7
    assert found.counts == {"gas": int((types == 1).sum()), "boundary": int((types == 3).sum())}
    np.testing.assert_array_equal(found.target, types[keep] == 1)
    assert any("1 dead" in note for note in found.notes)
    scene = read(tmp_path / "p.h5", period="none").particles()
    assert scene.population == C.n - 1
    measured = sphtrunc.measure(scene, "cubic-spline", moments=1, targets="all")
    np.testing.assert_array_equal(measured.target, np.flatnonzero(types[keep] == 1))


def test_native_dumps_of_phantom_are_what_sarracen_reads(tmp_path, monkeypatch):
    """Its frames have a column for each coordinate, and the header in `params`."""
    columns = {"x": C.x[:, 0], "y": C.x[:, 1], "z": C.x[:, 2], "h": C.h}
    header = {"hfact": 1.2, "nparttot": C.n, "massoftype": C.m[0], "xmin": 0.0, "xmax": 1.0}

    class Frame(dict):
        columns = property(list)
        params = property(lambda self: header)

    module = SimpleNamespace(read_phantom=lambda path, **options: [Frame(columns), "sinks"])
    monkeypatch.setitem(sys.modules, "sarracen", module)
    (tmp_path / "dump_00000").write_bytes(b"\x1c\0\0\0\x61\xed\0\0" + bytes(99))
    found = read(tmp_path / "dump_00000")
    assert (found.format, found.counts, found.box) == ("phantom", {"gas": C.n}, None)
    np.testing.assert_array_equal(found.x.T, C.x)
    np.testing.assert_allclose(found.fields["density"], C.m * (1.2 / C.h) ** 3, rtol=4e-16)


@pytest.mark.parametrize("writer", [written.pysph_hdf5, written.pysph_npz])
def test_particle_arrays_of_pysph(writer, tmp_path):
    path = tmp_path / ("p.npz" if writer is written.pysph_npz else "p.hdf5")
    writer(path, C, walls=9)
    found = read(path)
    assert found.counts == {"fluid": C.n - 9, "solid": 9}
    assert found.target.sum() == C.n - 9
    assert read(path, type="solid").count == 9
    with pytest.raises(ValueError, match="there is no array 'gas', only fluid, solid"):
        read(path, type="gas")


def test_the_period_of_dualsphysics_is_along_its_axes(tmp_path):
    written.bi4(tmp_path / "p.bi4", C, periodic=True)
    np.testing.assert_array_equal(read(tmp_path / "p.bi4").period, [1.0, 1.0, np.inf])
    with pytest.raises(ValueError, match=r"type: got 'gas', and there are \{'fixed': 5"):
        read(tmp_path / "p.bi4", type="gas")
    assert read(tmp_path / "p.bi4", type="fluid").count == C.n - 5


def test_scaled_coordinates_and_types_of_lammps(tmp_path):
    moved = replace(C, x=C.x * 4 - 2, low=-2.0, box=4.0)
    written.lammps(tmp_path / "a.dump", moved, scaled=True, types=2)
    found = read(tmp_path / "a.dump")
    np.testing.assert_allclose(found.x.T, moved.x, rtol=0, atol=4 * 2.0**-52)
    assert found.counts == {"1": C.n // 2, "2": C.n // 2}
    np.testing.assert_array_equal(found.period, [4, 4, np.inf])
    assert read(tmp_path / "a.dump", type="2").count == C.n // 2


def test_the_last_step_of_sph_exa_is_read(tmp_path):
    written.sph_exa(tmp_path / "s.h5", C, steps=11, periodic=0)
    found = read(tmp_path / "s.h5")
    assert "Step#10, the last of 11 steps" in found.notes
    assert found.period is None
    np.testing.assert_array_equal(found.x.T, C.x)


def test_particles_outside_a_periodic_box_are_taken_at_their_images(tmp_path):
    outside = C.x.copy()
    outside[3, 0] -= 1.0
    outside[5, 2] += 2.0
    written.swift(tmp_path / "s.hdf5", replace(C, x=outside))
    found = read(tmp_path / "s.hdf5")
    assert any(note.startswith("2 particles lie outside") for note in found.notes)
    np.testing.assert_allclose(found.x.T, C.x, rtol=0, atol=2.0**-51)


def test_a_box_that_is_not_that_of_the_particles_is_refused(tmp_path):
    written.swift(tmp_path / "s.hdf5", replace(C, box=1e-300))
    with pytest.raises(ValueError, match="expected the box of these particles"):
        read(tmp_path / "s.hdf5")


# ------------------------------------------------------------------------------------- columns


@pytest.mark.parametrize(
    ("name", "components", "expected"),
    [
        ("x", 1, "x"), ("X", 1, "x"), ("x[m]", 1, "x"), ("Points:0", 1, "x"), ("pos_x", 1, "x"),
        ("Points_2", 1, "z"), ("Coordinates", 3, "position"), ("x", 3, "position"),
        ("hsml", 1, "h"), ("smoothing_length", 1, "h"), ("SmoothingLengths", 1, "h"),
        ("m", 1, "mass"), ("Masses", 1, "mass"), ("rho", 1, "density"), ("Density", 1, "density"),
        ("Rhop", 1, "density"), ("c_rho", 1, "density"), ("P", 1, "pressure"),
        ("u", 1, "energy"), ("v", 3, "velocity"), ("v_y", 1, "velocity.1"),
        ("Velocity:2", 1, "velocity.2"), ("ParticleIDs", 1, "id"), ("potential", 1, None),
    ],
)  # fmt: skip
def test_names_of_columns(name, components, expected):
    assert meaning(name, components) == expected


def test_columns_that_mean_the_same_are_asked_for(tmp_path):
    text = "x,y,rho,density,h\n" + "\n".join(f"{i},{i % 3},1,2,2" for i in range(9))
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="rho, density all mean density; say which"):
        read(path)
    assert read(path, columns=chosen("rho=density")).fields["density"][0] == 2.0
    assert read(path, columns=chosen("density=rho")).fields["density"][0] == 1.0
    with pytest.raises(ValueError, match="no such column; there are x, y"):
        read(path, columns=chosen("h=hsml"))
    for wrong in ("h", "h=", "colour=x", "=x"):
        with pytest.raises(ValueError, match="expected quantity=NAME"):
            chosen(wrong)


def test_a_choice_overrules_the_table_of_names():
    columns = dict.fromkeys(("x", "pos_x", "y", "hsml", "weight"), 1)
    found, ignored = assigned(columns, chosen("x=pos_x,m=weight"))
    assert found == {"x": "pos_x", "mass": "weight", "y": "y", "h": "hsml"}
    assert ignored == ["x"]


def test_further_columns_and_an_index_are_no_trouble(tmp_path):
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{i},{i},0.5,{i % 2},7" for i in range(6))
    path.write_text(f",x,h,y,potential\n{rows}\n", encoding="utf-8")
    found = read(path)
    assert found.ignored == ("potential",)
    assert found.axes == ("x", "y")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x;h\n0,5;1\n1,5;1\n", r"line 2, column 'x': '0,5' is not .*a decimal comma\? write 0.5"),
        ("x,h\n0,5,0,1\n1,5,0,1\n", r"line 2 has 4 entries, expected 2; a decimal comma\?"),
        ("x,h\n0,1\n1,nan\n", "h: nan in row 2, column 'h'"),
        ("x,h\n0,1\ninf,1\n", "x: inf in row 2, column 'x'"),
        ("x,h\n0,1\n1,0\n", "h: 0 in row 2, column 'h', and 0 more; expected positive"),
        ("x,m\n0,-1\n1,-1\n", "mass: -1 in row 1, column 'm', and 1 more; expected positive"),
        ("x,h\n0,1\n1\n", "line 3 has 1 entries, expected 2"),
        ("x,x\n0,1\n1,2\n", "a name appears twice"),
        ("1,2\n3,4\n", "expected a header"),
        ("x,h\n", "at least one particle"),
        ("a,b\n1,2\n3,4\n", "no column holds positions; there are a, b"),
        ("x,h\n1,2\n1,2\n", "all particles are at one place, x = 1"),
        ("", "it is empty"),
        ("x,h\n0,one\n", "'one' is not a number"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_table_is_said(text, message, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read(path)


def test_smoothing_lengths_from_somewhere_else_are_said(tmp_path):
    written.npz(tmp_path / "a.npz", C)
    found = read(tmp_path / "a.npz", h=0.5)
    assert "h = 0.5 as given; that of the file is not used" in found.notes
    assert np.all(found.particles().h == 0.5)
    np.save(tmp_path / "a.npy", C.x)
    with pytest.raises(ValueError, match="the file has no smoothing length; expected --h H"):
        sphtrunc.snapshot(tmp_path / "a.npy")
    assert sphtrunc.snapshot(tmp_path / "a.npy", h=0.3).dim == 3


def test_records_of_numpy_are_columns(tmp_path):
    records = np.zeros(C.n, dtype=[("x", "f8"), ("y", "f4"), ("z", "f8"), ("hsml", "f8")])
    records["x"], records["y"], records["z"] = C.x.T
    records["hsml"] = C.h
    np.save(tmp_path / "a.npy", records)
    found = read(tmp_path / "a.npy")
    np.testing.assert_array_equal(found.x[2], C.x[:, 2])
    np.testing.assert_array_equal(found.fields["h"], C.h)


# ---------------------------------------------------------------------------------- coincidences


def test_coincident_particles_are_counted_modulo_the_period(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,h\n" + "\n".join(f"{i / 10},0.12" for i in range(11)), encoding="utf-8")
    assert sphtrunc.snapshot(path).population == 11
    with pytest.raises(ValueError, match=r"1 of 11 are where another one is, modulo the period"):
        sphtrunc.snapshot(path, period=1.0)
    with pytest.raises(ValueError, match="the first are 0 and 10, counted from 0"):
        sphtrunc.snapshot(path, period=1.0)
    assert sphtrunc.snapshot(path, period=1.0, allow_duplicates=True).population == 11


def test_coincident_particles_in_an_open_box(tmp_path):
    twice = np.concatenate([C.x, C.x[[4, 4, 9]]])
    np.savez(tmp_path / "a.npz", x=twice, h=0.3)
    with pytest.raises(ValueError, match=f"3 of {C.n + 3} .* the first are 4 and {C.n}"):
        sphtrunc.snapshot(tmp_path / "a.npz")


# ------------------------------------------------------------------------ boxes with open axes


def test_a_slab_is_a_periodic_box_along_some_axes(tmp_path):
    """Against the sum over all images, pair by pair."""
    slab = written.cloud(side=5, seed=4)
    np.savez(tmp_path / "a.npz", x=slab.x * [1, 1, 0.8], h=0.22, volume=0.008 * 0.8)
    scene = sphtrunc.snapshot(tmp_path / "a.npz", period=[1, 1, np.inf])
    kernel = sphtrunc.kernel("wendland-c2")
    for engine in ("numpy", "numba"):
        sums = sphtrunc.pair_sums(scene, kernel, [((0, 0, 0), (0, 0, 0))], engine=engine)
        expected = np.zeros(scene.population)
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                shift = np.array([i, j, 0])
                d = scene.x.T[:, None] - scene.x.T[None] - shift
                q = np.sqrt((d**2).sum(axis=2)) / 0.22
                w = 21 / (16 * np.pi) * np.clip(1 - q / 2, 0, None) ** 4 * (1 + 2 * q)
                expected += 0.008 * 0.8 / 0.22**3 * w.sum(axis=1)
        found = sums.base[(0, 0, 0), (0, 0, 0)]
        np.testing.assert_allclose(found, expected, rtol=1e-13)
    measured = sphtrunc.measure(scene, kernel, operator="value", moments=0, targets="all")
    np.testing.assert_allclose(
        np.asarray(measured.moments[(0, 0, 0)]).reshape(-1), expected, rtol=1e-13
    )
    exact = sphtrunc.measure(
        scene, kernel, operator="value", moments=0, targets=[0, 7], precision="exact"
    )
    np.testing.assert_allclose(
        np.asarray(exact.moments[(0, 0, 0)]).reshape(-1), expected[[0, 7]], rtol=1e-13
    )


def test_a_box_that_is_open_along_all_axes_is_none():
    x = np.random.default_rng(1).random((20, 2))
    assert sphtrunc.particles(x, h=0.1, period=[np.inf, np.inf]).period is None
    with pytest.raises(ValueError, match="period"):
        sphtrunc.particles(x, h=0.1, period=[-np.inf, 1])


# ------------------------------------------------------------------------------ hostile files


def test_links_out_of_a_file_are_not_followed(tmp_path):
    written.gadget(tmp_path / "other.hdf5", C)
    path = tmp_path / "s.hdf5"
    for make in (
        lambda gas: gas.__setitem__("Coordinates", h5py.ExternalLink("other.hdf5", "/PartType0")),
        lambda gas: gas.__setitem__("Coordinates", h5py.SoftLink("/Header")),
        lambda gas: gas.create_dataset(
            "Coordinates", (4, 3), "f4", external=[(str(tmp_path / "other.hdf5"), 0, 48)]
        ),
        lambda gas: gas.create_virtual_dataset(
            "Coordinates",
            _virtual(tmp_path / "other.hdf5"),
        ),
    ):
        with h5py.File(path, "w") as f:
            f.create_group("Header").attrs["BoxSize"] = 0.0
            make(f.create_group("PartType0"))
        with pytest.raises(ValueError, match=r"not followed|no Coordinates"):
            read(path)
    with h5py.File(path, "w") as f:
        f.create_group("Header")
        f["PartType0"] = h5py.ExternalLink("other.hdf5", "/PartType0")
    with pytest.raises(ValueError, match="links are not followed"):
        read(path)


def _virtual(path):
    layout = h5py.VirtualLayout((4, 3), "f4")
    layout[:] = h5py.VirtualSource(path, "PartType0/Coordinates", (C.n, 3))[:4]
    return layout


def test_sizes_that_no_file_holds_are_not_believed(tmp_path):
    path = tmp_path / "s.hdf5"
    with h5py.File(path, "w") as f:
        f.create_group("Header").attrs["BoxSize"] = 0.0
        gas = f.create_group("PartType0")
        gas.create_dataset("Coordinates", (10**12, 3), "f8", chunks=(1024, 3))
    with pytest.raises(ValueError, match="claims 3,000,000,000,000 numbers and holds none"):
        read(path)
    with h5py.File(path, "w") as f:
        f.create_group("Header").attrs["BoxSize"] = 0.0
        gas = f.create_group("PartType0")
        data = gas.create_dataset("Coordinates", (10**10, 3), "f8", chunks=(1024, 3))
        data[:4] = 1.0
    with pytest.raises(ValueError, match="more than a file of this size holds"):
        read(path)
    (tmp_path / "a.vtk").write_bytes(
        b"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 1000000000000 double\n"
    )
    with pytest.raises(ValueError, match="more than a file of this size holds"):
        read(tmp_path / "a.vtk")


def test_bombs_are_not_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("x.npy", b"\0" * (1 << 27))
    with pytest.raises(ValueError, match="more than a file of this size holds"):
        read(tmp_path / "a.npz")
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 9))
    (tmp_path / "a.vtp").write_text(
        f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e0 "lol">{entities}]><VTKFile>&e8;</VTKFile>',
        encoding="utf-8",
    )
    with pytest.raises(ValueError, match="declares entities"):
        read(tmp_path / "a.vtp")


def test_pickles_run_nothing(tmp_path):
    class Harm:
        def __reduce__(self):
            return (open, (str(tmp_path / "harm"), "w"))

    np.savez(tmp_path / "a.npz", version=2, particles={"fluid": Harm()}, solver_data={})
    with pytest.raises(ValueError, match=r"which is not run"):
        read(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", x=np.array([Harm()], dtype=object))
    with pytest.raises(ValueError, match="pickled objects, which are not read"):
        read(tmp_path / "b.npz")
    assert not (tmp_path / "harm").exists()


def test_what_is_no_file_of_particles_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no such file"):
        read(tmp_path / "none.hdf5")
    with pytest.raises(ValueError, match="no regular file"):
        read(tmp_path)
    (tmp_path / "a.bin").write_bytes(bytes(range(256)) * 8)
    with pytest.raises(ValueError, match="unknown format"):
        read(tmp_path / "a.bin")
    with h5py.File(tmp_path / "a.h5", "w") as f:
        f["numbers"] = np.arange(3)
    with pytest.raises(ValueError, match="unknown layout: it has numbers"):
        read(tmp_path / "a.h5")
    (tmp_path / "native").write_bytes(b"\x1c\0\0\0\x61\xed\0\0\x04\0\0\0" + bytes(100))
    with pytest.raises(ValueError, match="sarracen"):
        read(tmp_path / "native")
