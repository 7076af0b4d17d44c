"""`sphtrunc flow` as a user calls it, and `sphtrunc.flow`."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import sphtrunc
from sphtrunc.cli import flow as command
from sphtrunc.cli import main
from sphtrunc.operators.operator import OPERATORS
from sphtrunc.study.flows.enclosure import WALLS
from sphtrunc.study.flows.results import FLOWS, Vortex

C2 = ("--kernel", "wendland-c2")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main(["flow", *arguments])
    out, err = capsys.readouterr()
    return int(end.value.code or 0), out, err


def document(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    status, out, err = run(capsys, *arguments, "--format", "json")
    assert status == 0, err
    found = json.loads(out)
    assert found["schema"] == "sphtrunc.flow/1"
    return dict(found)


def test_the_command_knows_what_there_is() -> None:
    assert set(command.NAMES) == set(FLOWS)
    options = {option.name: option for option in command.command.params}
    assert tuple(options["wall"].type.choices) == WALLS  # type: ignore[attr-defined]
    assert tuple(options["form"].type.choices) == OPERATORS["laplacian"][1]  # type: ignore[attr-defined]


def test_a_steady_flow(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("poiseuille", *C2, "--across", "16", "--dim", "1")
    found = document(capsys, *arguments)
    assert found["ratio"] == pytest.approx(1.0, abs=1e-9)
    parts = found["predicted"]
    assert parts["smoothing"] == parts["shift"] == parts["spread"] == 0.0
    assert parts["rms"] == pytest.approx(found["error"]["rms"], rel=1e-9)
    profile = found["profile"]
    assert len(profile["x"]) == found["particles"] == 16
    assert np.allclose(profile["x"], (np.arange(16) + 0.5) / 16, atol=1e-14)
    assert np.allclose(profile["error"], profile["predicted_error"], atol=1e-11)
    assert found["exact_amplification"] == pytest.approx(1 / found["exact_slowest"], rel=1e-14)
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "measured/predicted 1.0000" in out
    assert max(map(len, out.splitlines())) <= 100


def test_a_vortex(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, "taylor-green", *C2, "--across", "12")
    assert found["error"] == pytest.approx(found["predicted_error"], abs=1e-11)
    assert found["wall"] is None
    glass = "relaxed:glass,N=144,steps=10"
    found = document(capsys, "taylor-green", *C2, "--particles", glass, "--h", "1.5")
    assert found["lattice"] == "given"
    assert found["dx_over_h"] == pytest.approx(2 / 3, rel=1e-14)
    assert found["predicted"] is None
    assert "only on lattices" in found["prediction_none"]


def test_a_cavity(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ("cavity", *C2, "--across", "13", "--re", "10,100")
    found = document(capsys, *arguments)
    assert [row["re"] for row in found["extrema"]] == [10.0] * 3 + [100.0] * 3
    assert found["extrema"][0]["ghia"] is None
    last = found["extrema"][3]
    assert last["from_ghia"] == pytest.approx(last["value"] / -0.2109 - 1, abs=1e-14)
    assert found["stopped"] is None
    assert (found["gradient_form"], found["gradient_correction"]) == ("difference", "csph")
    profile = found["profiles"][1]
    assert profile["u"][0] == pytest.approx(0.0, abs=1e-12)
    assert profile["u"][-1] == pytest.approx(1.0, abs=1e-12)
    bare = ("--form", "brookshaw", "--gradient-form", "standard")
    found = document(capsys, *arguments[:5], "--re", "10", *bare)
    assert (found["form"], found["gradient_form"]) == ("brookshaw", "standard")
    assert found["gradient_correction"] == "none"
    monkeypatch.setattr("sphtrunc.study.flows.cavity._Newton.at", lambda *_: None)
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "Newton's method stopped before Re = 10, and there is no flow before it." in out


def test_given_particles_between_walls(capsys: pytest.CaptureFixture[str], tmp_path: Any) -> None:
    """A table with boundary particles is a channel between dummies."""
    from sphtrunc.study.flows.enclosure import planes

    there = planes(sphtrunc.lattice(2, dx_over_h="2/3"), sphtrunc.kernel("wendland-c2"), (9, 7),
                   (True, False), "dummy")  # fmt: skip
    volume = there.spacing**2
    rows = [
        f"{x!r},{y!r},{there.h!r},{volume!r}" for x, y in (map(float, point) for point in there.x.T)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["x,y,h,volume", *rows]))
    arguments = ("poiseuille", *C2, "--particles", str(tmp_path / "a.csv"), "--period")
    found = document(capsys, *arguments, f"1,{7 / 9!r}")
    assert found["across"] == 9
    assert found["particles"] == 63
    status, _, err = run(capsys, *arguments, f"inf,{7 / 9!r}")
    assert status == 2
    assert "say where the walls are" in err


def test_a_file_as_pysph_writes_it(tmp_path: Any) -> None:
    """The vortex on the particles of an .npz of PySPH decays as on the lattice that they are."""
    line = (np.arange(12) + 0.5) / 12
    x, y = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    arrays = {
        "x": x,
        "y": y,
        "z": 0 * x,
        "h": np.full(144, 1 / 8),
        "m": np.full(144, 1 / 144),
        "rho": np.ones(144),
        "u": np.sin(x),
        "v": 0 * x,
        "w": 0 * x,
        "p": 0 * x,
    }
    fluid = {
        "arrays": arrays,
        "properties": {name: {"name": name, "type": "double"} for name in arrays},
        "constants": {},
        "output_property_arrays": list(arrays),
    }
    np.savez(tmp_path / "tg_0.npz", version=2, particles={"fluid": fluid}, solver_data={"t": 0.0})
    given = sphtrunc.snapshot(tmp_path / "tg_0.npz", period=1.0)
    assert given.dim == 2
    found, exact = (
        sphtrunc.flow("taylor-green", "wendland-c2", **options)
        for options in ({"scene": given}, {"across": 12})
    )
    assert isinstance(found, Vortex)
    assert isinstance(exact, Vortex)
    assert found.decay.rate == pytest.approx(exact.decay.rate, rel=1e-12)


def test_the_duct_and_the_annulus(capsys: pytest.CaptureFixture[str]) -> None:
    """White (2006): the duct's velocity is 1 in the middle; errors fall."""
    sizes = [
        document(capsys, "duct", *C2, "--across", n, "--form", "fatehi-manzari")["error"]["rms"]
        for n in ("8", "16")
    ]
    assert sizes[1] < 0.35 * sizes[0]
    found = document(capsys, "rotating-couette", *C2, "--across", "10")
    assert found["error"]["rms"] < 0.03
    assert len(found["profile"]["x"]) == 10
    assert "curvature" in found["prediction_none"]


def test_the_duct_in_space_is_solved_by_iteration(monkeypatch: pytest.MonkeyPatch) -> None:
    direct = sphtrunc.flow("duct", "wendland-c2", dim=3, across=8)
    monkeypatch.setattr("sphtrunc.study.flows.steady.DIRECT", 10)
    iterated = sphtrunc.flow("duct", "wendland-c2", dim=3, across=8)
    assert np.abs(iterated.solution - direct.solution).max() < 1e-8
    assert iterated.amplification is None
    assert iterated.slowest == []


def test_a_singular_operator_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("poiseuille", *C2, "--dim", "1", "--form", "nested")
    found = document(capsys, *arguments)
    assert "sawtooth" in found["singular"]
    assert abs(found["slowest"][0][0]) < 1e-9
    _, out, _ = run(capsys, *arguments)
    assert "Do not trust this solution: the operator is singular" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("poiseuille", "-n", "4"), "got 4 particles across, expected 5 or more"),
        (("poiseuille", "--dx-over-h", "3"), "have no neighbours within the support"),
        (("poiseuille", "--re", "100"), "re: has no meaning for poiseuille, only for cavity"),
        (("cavity", "--wall", "none"), "wall: has no meaning for cavity"),
        (("taylor-green", "--along", "9"), "along: has no meaning"),
        (("poiseuille", "--wall", "none", "--wall-at", "half-way"), "pure Neumann"),
        (("poiseuille", "--along", "3"), "so that no particle meets its own image"),
        (("taylor-green", "-n", "5"), "meets its own image"),
        (("duct", "--dim", "1"), "dim: got 1 for duct, expected 2 or 3"),
        (("cavity", "--re", "100,10"), "growing numbers above 0"),
        (("cavity", "--re", "x"), "re: "),
        (("cavity", "--lattice", "hexagonal", "-n", "13"), "expected square"),
        (("poiseuille", "--h", "1"), "h: belongs to --particles"),
        (("poiseuille", "--wall", "dummy", "--particles", "relaxed:glass,N=144,steps=5"),
         "dummy needs wall particles, and these have none"),
        (("poiseuille", "-n", "9", "--particles", "relaxed:glass,N=144,steps=5"),
         "across: particles were given"),
        (("taylor-green", "--particles", "relaxed:glass,N=144,steps=5", "--period", "3"),
         "period: a relaxed scene has its own box"),
        (("poiseuille", "--form", "brookshaw", "--correction", "rkpm-1"), "expected none"),
    ],
)  # fmt: skip
def test_mistakes_end_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    status, out, err = run(capsys, *arguments, *C2)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_an_unknown_flow_and_kernels_without_matrices_are_refused() -> None:
    with pytest.raises(ValueError, match="kernel: gaussian has no compiled sums"):
        sphtrunc.flow("couette", "gaussian")
    with pytest.raises(ValueError, match="flow: got 'jet', expected one of poiseuille"):
        sphtrunc.flow("jet", "wendland-c2")
