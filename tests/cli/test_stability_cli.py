"""`sphtrunc stability` as a user calls it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from sphtrunc.cli import main

CUBIC = ("--kernel", "cubic-spline")


def out(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["stability", *arguments])
    captured = capsys.readouterr()
    assert ended.value.code == 0, captured.err
    return captured.out


def document(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    found = json.loads(out(capsys, *arguments, "--format", "json"))
    assert isinstance(found, dict)
    return found


def test_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(
        capsys, *CUBIC, "--dim", "1", "--dx-over-h", "5/6", "--form", "symmetric",
        "--pressure", "3/5", "--k", "1/2",
    )  # fmt: skip
    assert found["schema"] == "sphtrunc.stability/1"
    (mode,) = found["modes"]
    assert mode["k"] == ["1/2"]
    assert mode["omega2"] == ["6410988/3034205"]
    assert mode["branch"] == ["longitudinal"]
    assert mode["growth_rate"] == [0.0]
    assert found["sound_speed2"] == "644805/606841"
    assert "/" in found["dispersion"]
    assert found["courant"]["leapfrog"] == pytest.approx(1.301075631, abs=5e-10)
    assert found["courant"]["rk2"] == 0.0
    assert found["worst"]["branch"] == "longitudinal"
    assert found["stable"] == {"longitudinal": True}
    assert {"kernel", "dim", "lattice", "form", "remedy", "pressure", "volume", "dx_over_h"} < set(
        found
    )


@pytest.mark.parametrize(
    ("form", "value"),
    [("grad-h", "14078556/3721925"), ("difference", "656100/606841"), ("csph", "43740/41287")],
)
def test_forms(capsys: pytest.CaptureFixture[str], form: str, value: str) -> None:
    found = document(
        capsys, *CUBIC, "--dx-over-h", "5/6", "--form", form, "--pressure", "3/5", "--k", "1/2"
    )
    assert found["modes"][0]["omega2"] == [value]


def test_without_a_wave_the_named_points_are_given(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(
        capsys, *CUBIC, "--dim", "2", "--lattice", "square", "--dx-over-h", "5/6",
        "--pressure", "3/5",
    )  # fmt: skip
    assert [mode["k"] for mode in found["modes"]] == [["1", "0"], ["1", "1"]]
    assert all(len(mode["omega2"]) == 2 for mode in found["modes"])
    assert set(found["branches"]) == {"longitudinal", "transverse"}
    assert found["ranges"].keys() == found["branches"].keys()


def test_waves_in_space(capsys: pytest.CaptureFixture[str]) -> None:
    """In π/Δx, one number an axis; a point of the zone by its name; sc is the simple cubic."""
    found = document(
        capsys, *CUBIC, "--dim", "3", "--lattice", "sc", "--dx-over-h", "5/6",
        "--pressure", "3/5", "--k", "1,1/2,1/2", "--k", "R",
    )  # fmt: skip
    assert found["lattice"] == "sc"
    first, second = found["modes"]
    assert [round(v, 12) for v in first["omega2"]] == [
        -0.078865508601,
        0.213370962646,
        0.486002848071,
    ]
    assert first["growth_rate"][0] == pytest.approx(0.078865508601**0.5, rel=1e-11)
    assert second["k"] == ["1", "1", "1"]
    assert found["stable"]["transverse"] is False


def test_pairing(capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, *CUBIC, "--dim", "3", "--lattice", "fcc", "--pairing")
    assert round(found["pairing"]["neighbours"], 10) == 64.1156512426
    assert found["pairing"]["point"] == "W"
    assert found["pressure"] == "3/5"
    text = out(capsys, "--kernel", "wendland-c2", "--dim", "3", "--lattice", "fcc", "--pairing")
    assert "No pairing: the longitudinal branch is stable up to 1000 neighbours" in text


def test_text_says_which_branch(capsys: pytest.CaptureFixture[str]) -> None:
    text = out(
        capsys, *CUBIC, "--dim", "3", "--lattice", "fcc", "--neighbours", "57", "--pressure", "3/5"
    )
    assert "57 neighbours" in text
    assert "Longitudinal (neighbours along the wave): stable." in text
    assert "Transverse (shear of the lattice): UNSTABLE" in text
    assert "RK2 and Euler have no stable step" in text
    pulled = out(capsys, *CUBIC, "--dx-over-h", "5/6", "--pressure", "-1/10")
    assert "UNSTABLE, the tensile instability" in pulled
    assert "-1296/3895" in pulled


def test_remedies(capsys: pytest.CaptureFixture[str]) -> None:
    pull = (*CUBIC, "--dx-over-h", "5/6", "--pressure", "-1/10")
    assert document(capsys, *pull)["stable"] == {"longitudinal": False}
    held = document(capsys, *pull, "--remedy", "artificial-stress:113/1463", "--k", "1")
    assert held["modes"][0]["omega2"] == ["0"]
    assert held["remedy"] == "artificial-stress:113/1463"
    lagrangian = document(capsys, *pull, "--remedy", "total-lagrangian")
    assert lagrangian["form"] == "total-lagrangian"
    assert lagrangian["zero_modes"] == [["1"]]
    staggered = document(capsys, *pull, "--remedy", "stress-points", "--k", "1")
    assert staggered["modes"][0]["omega2"] == [str_of(11, 10, 35, 72)]


def str_of(a: int, b: int, c: int, d: int) -> str:
    """(a/b)(c/d)² as text."""
    from fractions import Fraction

    return str(Fraction(a, b) * Fraction(c, d) ** 2)


def test_a_map_is_three_files(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    shown = out(capsys, *CUBIC, "--map", str(tmp_path / "swegle"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["swegle.csv", "swegle.png", "swegle.svg"]
    assert shown.count("swegle") == 3
    rows = list(csv.DictReader((tmp_path / "swegle.csv").read_text().splitlines()))
    assert len(rows) == 100 * 100
    assert {row["kind"] for row in rows} == {"field"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "got no resolution, expected one of --dx-over-h and --neighbours"),
        (("--dx-over-h", "1", "--neighbours", "4"), "got both --dx-over-h and --neighbours"),
        (("--dx-over-h", "3"), "no neighbour is inside the support of 2h"),
        (("--dim", "3", "--dx-over-h", "1/20"), "are inside the support, at most 20000 are taken"),
        (("--dx-over-h", "-1"), "dx-over-h: got -1, expected a positive number"),
        (("--neighbours", "1/2"), "neighbours: got 1/2, expected a number between"),
        (("--dx-over-h", "1", "--k", "3/2"), "outside the zone of the lattice uniform"),
        (("--dx-over-h", "1", "--k", "0"), "k: got 0, which moves all particles alike"),
        (("--dx-over-h", "1", "--k", "1,0"), "expected 1 number in π/Δx"),
        (("--dx-over-h", "1", "--k", "W"), "no point 'W', expected one of X"),
        (("--dx-over-h", "1", "--k", "1e400"), "k: got '1e400'"),
        (("--dx-over-h", "1", "--lattice", "fcc"), "lattice: got 'fcc' in 1D"),
        (
            ("--dim", "3", "--lattice", "hcp", "--form", "csph", "--dx-over-h", "4/5"),
            "form: csph has no formula on hcp",
        ),
        (("--dim", "2", "--form", "stress-points", "--dx-over-h", "4/5"), "expected --dim 1"),
        (("--dx-over-h", "1", "--remedy", "hope"), "remedy: got 'hope', expected one of"),
        (("--dx-over-h", "1", "--remedy", "artificial-stress"), "artificial-stress:EPS"),
        (("--dx-over-h", "1", "--remedy", "artificial-stress:-1"), "got ε = -1, expected ε >= 0"),
        (
            ("--dx-over-h", "1", "--remedy", "stress-points", "--form", "grad-h"),
            "stress-points is a form of its own, in place of grad-h",
        ),
        (
            ("--dx-over-h", "1", "--remedy", "artificial-stress:1/5", "--form", "grad-h"),
            "artificial stress belongs to the form symmetric",
        ),
        (("--dx-over-h", "1", "--pressure", "nan"), "pressure: got 'nan'"),
        (
            ("--dx-over-h", "1", "--form", "grad-h", "--volume", "constant"),
            "whose h follows the summed density",
        ),
        (("--pairing", "--dx-over-h", "1"), "--pairing looks at all of them: without --dx-over-h"),
        (("--pairing", "--pressure", "-1"), "pairing: got p = -1, expected a pressure"),
        (("--pairing", "--form", "csph"), "the pressure holds no particles apart"),
        (("--map", "x", "--pressure", "1"), "--map looks at all of them: without --pressure"),
        (("--map", "x", "--format", "json"), "--map writes its own files"),
        (("--map", "x", "--pairing"), "got --pairing and --map, expected one of them"),
        (("--map", "."), "expected the name of files to write"),
    ],
)
def test_bad_input_ends_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["stability", *CUBIC, *arguments])
    captured = capsys.readouterr()
    assert ended.value.code == 2
    assert captured.out == ""
    assert captured.err.startswith("Error: ")
    assert captured.err.count("\n") == 1
    assert message in captured.err


def test_convert_knows_the_limit(capsys: pytest.CaptureFixture[str]) -> None:
    """57.9 neighbours of the cubic spline are below 64.1, 100 are not; a line has no limit."""

    def said(*arguments: str) -> str:
        with pytest.raises(SystemExit) as ended:
            main(["convert", *arguments, "--pairing"])
        captured = capsys.readouterr()
        return f"{ended.value.code} {captured.out}{captured.err}"

    assert "pair from 64.1157 neighbours on: this is below" in said(
        *CUBIC, "--dim", "3", "--hfact", "1.2"
    )
    assert "pair from 64.1157 neighbours on: beyond that" in said(
        *CUBIC, "--dim", "3", "--neighbours", "100"
    )
    assert "no pairing at any number of neighbours up to 1000" in said(
        "--kernel", "wendland-c2", "--dim", "3", "--neighbours", "100"
    )
    assert '"pairing": 64.115' in said(*CUBIC, "--dim", "3", "--hdx", "1", "--format", "json")
    assert said(*CUBIC, "--hdx", "1").startswith("2 Error: pairing: is of particles in 2D and 3D")


def test_kernels_know_their_limits(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A column more, in every format; of two kernels here, as all of them take minutes."""
    monkeypatch.setattr("sphtrunc.cli.kernels.names", lambda: ["cubic-spline", "wendland-c2"])

    def listed(*arguments: str) -> list[str]:
        with pytest.raises(SystemExit):
            main(["kernels", "--dim", "3", "--pairing", *arguments])
        return capsys.readouterr().out.splitlines()

    _, head, cubic, wendland = listed()
    assert head.endswith("pairs from")
    assert cubic.endswith(" 64.1157")
    assert wendland.endswith(" none")
    assert [row["pairing"] is None for row in json.loads("".join(listed("--format", "json")))[
        "kernels"]] == [False, True]  # fmt: skip
    assert "pairs from" in listed("--format", "latex")[1]
