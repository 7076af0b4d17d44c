"""Figures: all of them drawn, labelled, tabulated, and measured points on their curves."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sphtrunc.cli import main
from sphtrunc.figures import FIGURES, make
from sphtrunc.figures.picture import (
    COLOURS,
    COLUMNS,
    DASHES,
    MARKERS,
    MEASURED,
    PREDICTED,
    REFERENCE,
    Panel,
    Picture,
    draw,
    measured,
    predicted,
    save,
    slope,
)


def test_a_notebook_shows_a_figure():
    """As IPython asks an object of a kind that it does not know."""
    assert draw(make("kernels", quick=True))._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_drawn_labelled_and_tabulated(name, tmp_path):
    picture = make(name, quick=True)
    assert picture.name == name
    figure = draw(picture)
    axes = [axis for axis in figure.axes if axis.get_visible() and axis.axison]
    assert len(axes) >= len(picture.panels)
    for axis in axes[: len(picture.panels)]:
        assert axis.get_xlabel()
        assert axis.get_ylabel()
    for panel in picture.panels:
        looks = list(dict.fromkeys(c.label for c in panel.curves if c.kind != REFERENCE))
        assert len(looks) <= 8  # dashes and markers are all different
    written = save(picture, tmp_path)
    assert [path.suffix for path in written] == [".csv", ".png", ".svg"]
    assert all(path.stat().st_size > 1000 for path in written)
    rows = list(csv.reader(io.StringIO(written[0].read_text(encoding="utf-8"))))
    assert rows[0] == list(COLUMNS)
    points = sum(len(curve.x) for panel in picture.panels for curve in panel.curves)
    fields = sum(p.field.z.size for p in picture.panels if p.field is not None)
    assert len(rows) == 1 + points + fields
    for panel in picture.panels:
        for curve in panel.curves:
            assert np.isfinite(curve.x).all()
            assert np.isfinite(curve.y).all()
    compared, off = picture.agreement()
    assert compared == sum(
        int((np.abs(curve.y) > curve.floor).sum()) for _, curve in picture.measured()
    )
    assert len(off) <= 0.05 * compared, off  # of every figure, so of all of them


@pytest.mark.parametrize(
    ("name", "kernel"),
    [
        ("uniform-smoothing", "gaussian:3"),  # it jumps at the cut
        ("uniform-discretisation", "gaussian"),  # it has no edge
        ("stencils", "spiky"),  # it has a kink at the origin
        ("second-derivatives", "spiky"),  # and no second derivative there
        ("first-order", "gaussian"),
        ("disorder-dx", "0..1: 1-3/2*q^2+3/4*q^3; 1..2: (2-q)^3/4"),
    ],
)
def test_any_kernel_will_do(name, kernel):
    picture = make(name, kernel, quick=True)
    draw(picture)
    compared, off = picture.agreement()
    assert compared >= 20
    assert len(off) <= 0.1 * compared, off


def test_points_off_their_prediction_are_found():
    y = np.array([1.0, 1.04, 1.06, 1.2, 1e-20])
    points = measured(
        "a",
        np.arange(5) + 1.0,
        y,
        low=y - [0, 0, 0, 0.3, 0],
        high=y,
        predicted=[1.0, 1.0, 1.0, 1.0, 1.0],
        floor=1e-18,
    )
    picture = Picture("x", "x", (Panel("x", "y", (points,)),))
    compared, off = picture.agreement()
    assert compared == 4
    assert [row["x"] for row in off] == [3.0]
    assert "by chance" in off[0]["reason"]
    named = replace(points, beyond="because")
    _, off = Picture("x", "x", (Panel("x", "y", (named,)),)).agreement()
    assert [row["reason"] for row in off] == ["because"]


def test_points_off_are_listed_and_checked(tmp_path, capsys, monkeypatch):
    def drawn(y):
        points = measured("a", [1.0, 2.0], y, predicted=[1.0, 1.0], beyond="first order")
        picture = Picture("kernels", "x", (Panel("x", "y", (points,)),))
        monkeypatch.setattr("sphtrunc.cli.figures.make", lambda *_: picture)
        with pytest.raises(SystemExit) as stop:
            main(["figures", "kernels", "--check", "--out", str(tmp_path)])
        return stop.value.code, capsys.readouterr().out

    code, out = drawn([1.04, 0.96])
    assert code == 0
    assert "2 of 2 points (100.0 %) lie within" in out
    code, out = drawn([1.04, 1.1])
    assert code == 1
    assert "off: panel 1, a at 2: measured 1.1, predicted 1 (+10.0 %): first order" in out
    assert "1 of 2 points (50.0 %) lie within" in out


def test_curves_pass_through_their_points():
    """A point never seems to lie off a curve that was only drawn too coarsely."""
    for name in ("uniform-smoothing", "second-derivatives", "uniform-discretisation"):
        for panel in make(name, quick=True).panels:
            lines = {c.label: c for c in panel.curves if c.kind == PREDICTED}
            for curve in panel.curves:
                if curve.kind == MEASURED and curve.label in lines:
                    line = dict(zip(lines[curve.label].x, lines[curve.label].y, strict=True))
                    assert [line[x] for x in curve.x] == list(curve.predicted)


def test_neighbouring_looks_differ_in_grey():
    """By at least a fifth of the whole range, so that lines are told apart in print."""
    grey = [
        sum(w * int(c[i : i + 2], 16) for w, i in ((0.299, 1), (0.587, 3), (0.114, 5)))
        for c in COLOURS
    ]
    assert min(abs(a - b) for a, b in pairwise(grey[:6])) > 50
    assert len(set(map(str, DASHES[:6]))) == 6
    assert len(set(MARKERS)) == len(MARKERS) == len(COLOURS)


def test_a_slope_has_its_power():
    line = slope("h^3", 3, (1.0, 10.0), (1.0, 2.0))
    assert line.y.tolist() == pytest.approx([2.0, 2000.0], rel=1e-15)


def test_the_csv_keeps_every_digit():
    x = [0.1 + 0.2, 1 / 3]
    picture = Picture("x", "x", (Panel("x", "y", (predicted("a, b", x, [1e-17, 2.0]),)),))
    rows = list(csv.DictReader(io.StringIO(picture.to_csv())))
    assert [float(row["x"]) for row in rows] == x
    assert rows[0]["label"] == "a, b"
    assert rows[0]["low"] == ""


def test_pictures_are_the_same_to_the_byte(tmp_path):
    picture = make("kernels", quick=True)
    first = [path.read_bytes() for path in save(picture, tmp_path / "a")]
    second = [path.read_bytes() for path in save(picture, tmp_path / "b")]
    assert first == second


def test_smoothing_falls_as_h_squared_and_discretisation_stays_level():
    picture = make("uniform-smoothing", quick=True)
    curves = [c for c in picture.panels[0].curves if c.kind == MEASURED]
    coarse, fine = curves[0], curves[-1]
    low = coarse.x < 3e-3
    assert low.sum() >= 3
    spread = coarse.y[low].max() / coarse.y[low].min() - 1
    assert spread < 1e-2  # the plateau at Δx/h = 4/5
    steep = (fine.x > 5e-3) & (fine.x < 8e-2)
    assert steep.sum() >= 2
    power = np.polyfit(np.log(fine.x[steep]), np.log(fine.y[steep]), 1)[0]
    assert 1.9 < power < 2.1


def test_the_edge_term_is_the_special_case_of_the_exact_one():
    from fractions import Fraction

    from sphtrunc import derive
    from sphtrunc.figures.uniform import edge_term
    from sphtrunc.kernels.parse import kernel

    shape = kernel("polynomial:4")
    for n, within in ((11, 0.07), (41, 0.005)):
        exact = derive(shape, dx_over_h=Fraction(4, n)).discrete[1] - 1
        assert abs(edge_term(shape, 4 / n) / float(exact) - 1) < within
    assert edge_term(kernel("polynomial:3"), 0.4) == 0.0


def test_the_command(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["figures", "kernels", "--quick", "--kernel", "lucy", "--out", str(tmp_path / "f")])
    assert stop.value.code == 0
    assert sorted(p.name for p in (tmp_path / "f").iterdir()) == [
        "kernels.csv",
        "kernels.png",
        "kernels.svg",
    ]
    assert "lucy" in (tmp_path / "f" / "kernels.csv").read_text(encoding="utf-8")
    with pytest.raises(SystemExit) as stop:
        main(["figures", "nothing"])
    assert stop.value.code == 2
    assert "uniform-smoothing" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main(["figures", "--list"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert all(name in out for name in FIGURES)


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="out"):
        save(make("kernels", quick=True), tmp_path / "file" / "x")
