"""Walls on the command line: derive --wall, measure --wall, and the table of remedies."""

from __future__ import annotations

import json
from typing import Any

import pytest
from sympy import Rational

from sphtrunc.cli import main


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    out, err = capsys.readouterr()
    return int(end.value.code or 0), out, err


CONTRACT = (
    *("derive", "--kernel", "cubic-spline", "--dim", "1", "--wall", "5/13"),
    *("--wall-at", "half-way", "--dx-over-h", "10/13"),
)


def test_derive_keeps_its_schema(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, *CONTRACT, "--format", "json")
    found = json.loads(out)
    assert status == 0
    assert found["schema"] == "sphtrunc.derive/1"
    assert {k: found["wall"][k] for k in ("eta", "at", "ghosts")} == {
        "eta": "5/13",
        "at": "half-way",
        "ghosts": "none",
    }
    moments = found["discrete_moments"]
    assert [moments[k] for k in "012"] == ["1280/2197", "14600/28561", "14000/28561"]
    assert found["kernel_moments"]["0"] == "507367/685464"
    assert found["limit_moments"]["0"] == "7213/13182"
    assert found["orders"] == {
        "smoothing": -1,
        "discretisation_generic": 1,
        "discretisation_aligned": 2,
    }
    walls = [t for t in found["discretisation_terms"] if t["knot"] == "-5/13"]
    assert {t["dx_power"] for t in walls} >= {1, 2}


def test_an_open_distance_gives_polynomials(capsys: pytest.CaptureFixture[str]) -> None:
    command = ("derive", "--kernel", "cubic-spline", "--degree", "1", "--wall")
    _, out, _ = run(capsys, *command, "--format", "json")
    found = json.loads(out)
    assert found["wall"] == {"eta": "eta", "at": None, "ghosts": "none"}
    first, second = found["kernel_moments"]["0"]
    assert (first["from"], first["to"], second["to"]) == ("0", "1", "2")
    assert first["value"] == "eta**4/8 - eta**3/3 + 2*eta/3 + 1/2"
    assert found["limit_moments"]["0"][0]["value"] == "eta**3/2 - eta**2 + 2/3"
    _, text, _ = run(capsys, *command)
    assert "M_0 = η^3/2 - η^2 + 2/3" in text


def test_derive_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, *CONTRACT)
    assert status == 0
    assert "half-way between planes of particles" in out
    assert "order h⁻¹" in out
    assert max(map(len, out.splitlines())) <= 100


def test_the_table_of_remedies(capsys: pytest.CaptureFixture[str]) -> None:
    command = ("wall", "--kernel", "cubic-spline", "--remedy", "bare,shepard,csph,mirror,odd")
    status, out, _ = run(capsys, *command, "--format", "json")
    found = json.loads(out)
    assert (status, found["schema"]) == (0, "sphtrunc.wall/1")
    assert {row["eta"] for row in found["rows"]} == {"0", "1/4", "1/2", "1", "2"}
    rows: dict[Any, Any] = {
        (r["eta"], r["operator"], r["component"], r["remedy"]): r for r in found["rows"]
    }
    gradient = rows["0", "gradient", "normal", "csph"]
    assert (gradient["order_h"], gradient["coefficient"]) == (1, "7/15")
    assert rows["1", "gradient", "normal", "bare"]["coefficient"] == "1/6"
    assert all(Rational(r["coefficient"]) is not None for r in rows.values() if r["eta"] == "0")
    assert any("csph" in line for line in found["advice"])
    _, text, _ = run(capsys, *command)
    assert "bare and mirror grow as 1/h" in text
    assert max(map(len, text.splitlines())) <= 100
    _, csv, _ = run(capsys, *command, "--eta", "0", "--format", "csv")
    assert csv.startswith("eta,operator,component,remedy,order_h,")
    assert "0,gradient,normal,csph,1,A_nn,7/15" in csv


def test_measure_beside_a_wall(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(
        capsys, "measure", *CONTRACT[1:], "--moments", "2", "--ghosts", "none", "--format", "json"
    )
    found = json.loads(out)
    means = {k: m["mean"] for k, m in found["predicted"]["moments"].items()}
    assert means["0"] == pytest.approx(1280 / 2197, rel=1e-15)
    assert found["wall"]["eta"] == "5/13"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("derive", "--wall", "x"), "wall: got 'x'"),
        (("derive", "--wall-at", "particle"), "belong to a wall"),
        (("derive", "--wall", "1", "--wall-at", "particle"), "need a lattice"),
        (("derive", "--wall", "--dx-over-h", "1/2"), "there is no lattice"),
        (("derive", "--wall", "--ghosts", "dummy"), "no closed form in η"),
        (("derive", "--wall", "1", "--jitter", "0.1", "--dx-over-h", "1/2"), "no jitter"),
        (("derive", "--wall", "--dim", "2", "--correction", "rkpm-1"), "roots and logarithms"),
        (("derive", "--wall", "1", "--form", "paired"), "paired takes the neighbours"),
        (("wall", "--eta", "-1"), "eta: got -1"),
        (("wall", "--remedy", "magic"), "remedy: got 'magic', expected one of bare,"),
        (("measure", "--dx-over-h", "1/2", "--ghosts", "odd"), "a wall"),
        (("measure", "--dx-over-h", "1/2", "--wall"), "expected --wall with a distance"),
    ],
)
def test_mistakes_end_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    command, *rest = arguments
    status, out, err = run(capsys, command, "--kernel", "cubic-spline", *rest)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_a_kernel_without_pieces_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    status, _, err = run(capsys, "derive", "--kernel", "gaussian", "--wall", "1")
    assert status == 2
    assert "piecewise polynomial" in err
