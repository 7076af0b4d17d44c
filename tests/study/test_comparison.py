"""What `measure` says of theory, and what it says where there is none."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from sphtrunc import compare
from sphtrunc.cli import group
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice


def measured(*arguments: str) -> Any:
    done = CliRunner().invoke(group, ["measure", "-k", "wendland-c2", *arguments])
    assert done.exit_code == 0, done.output
    return done.output


def test_every_figure_stands_beside_its_prediction() -> None:
    options = ("--dx-over-h", "3/5", "--jitter", "0.05", "--targets", "4000", "--format", "json")
    data = json.loads(measured(*options, "--moments", "1", "--h-over-lambda", "0.05"))
    predicted = data["predicted"]
    assert set(predicted["moments"]) == {"0", "1"}
    for row in predicted["moments"].values():
        assert 0.93 < row["std_ratio"] < 1.07
    error = predicted["error"]
    assert 0.95 < error["ratio"] < 1.05
    assert error["ratio"] == pytest.approx(data["error"]["rms"] / error["total"], rel=2.0**-53)
    assert "predicted" not in json.loads(measured(*options, "--no-predict"))


def test_on_a_lattice_the_ratio_is_one() -> None:
    text = measured("--dx-over-h", "10/13", "--h-over-lambda", "0.02")
    assert "measured/predicted 1.0000" in text
    assert "Predicted" not in measured("--dx-over-h", "10/13", "--no-predict")


def test_no_theory_is_said_plainly(tmp_path: Any) -> None:
    file = tmp_path / "x.csv"
    file.write_text("x\n" + "\n".join(str(0.1 * i) for i in range(40)) + "\n")
    text = measured("--particles", str(file), "--h", "0.2", "--moments", "1")
    assert "No prediction: scene: there is no theory for explicit particles" in text


def test_compare_reads_as_a_table() -> None:
    text = str(compare(jittered(lattice(1, "uniform", "1/2"), 0.02), "cubic-spline", targets=500))
    assert "spread measured/derived" in text
    assert "measured - derived" in str(compare(lattice(1, "uniform", "1/2"), "cubic-spline"))
