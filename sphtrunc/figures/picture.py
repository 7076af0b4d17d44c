"""Pictures as data: curves with their predictions, drawn and tabulated from the same numbers.

A picture knows which of its points were measured and what was derived for them, so that "the curve
goes through the points" is a test and not an impression. Every line differs in dash and marker as
well as in colour: nothing is lost in grey.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.output import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

PREDICTED, MEASURED, REFERENCE = "predicted", "measured", "reference"
KINDS = (PREDICTED, MEASURED, REFERENCE)
CHANCE = "one 95 % interval in twenty misses by chance"
COLUMNS = ("panel", "label", "kind", "x", "y", "low", "high", "predicted")

#: dark and light alternate, so that neighbours differ in grey too
COLOURS = ("#0b3c5d", "#e08e0b", "#a4243b", "#3aa6b9", "#5b3a8c", "#7fb069", "#7a5230", "#9aa0a6")
DASHES: tuple[Any, ...] = (
    "-",
    "--",
    "-.",
    (0, (1, 1.2)),
    (0, (6, 1.5, 1, 1.5, 1, 1.5)),
    (0, (8, 3)),
    ":",
    "-",
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

WIDTH, HEIGHT, DPI = 6.4, 4.6, 150  # of one panel, in inches; the CSV holds every digit


@dataclass(frozen=True, eq=False)
class Curve:
    """Points that belong together. Arrays are (n,); labels pair what is derived with what is seen.

    kind: "predicted" (a line), "measured" (points), "reference" (a slope, named beside its line)
    low, high: 95 % confidence interval of y, (n,), measured points only
    predicted: what theory says at the same x, (n,), measured points only
    floor: what rounding alone may do to y; points below it are not compared
    beyond: what the prediction leaves out, the reason where a point is off it
    """

    label: str
    kind: str
    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None
    predicted: Floats | None = None
    floor: float = 0.0
    beyond: str = ""


@dataclass(frozen=True)
class Panel:
    """One pair of axes; `legend` is where it goes, None for nowhere."""

    xlabel: str
    ylabel: str
    curves: tuple[Curve, ...]
    title: str = ""
    xscale: str = "log"
    yscale: str = "log"
    ylim: tuple[float, float] | None = None
    legend: Any = "best"
    field: Field | None = None


@dataclass(frozen=True, eq=False)
class Field:
    """Contours below the curves: z on the grid x × y, (len(y), len(x)); levels of log10 z."""

    x: Floats
    y: Floats
    z: Floats
    label: str


@dataclass(frozen=True)
class Picture:
    """A figure: a name for its files, a caption, and panels side by side."""

    name: str
    caption: str
    panels: tuple[Panel, ...]
    note: str = ""

    def measured(self) -> Iterator[tuple[int, Curve]]:
        """(panel, curve) of all measured curves that have a prediction."""
        for number, panel in enumerate(self.panels):
            for curve in panel.curves:
                if curve.kind == MEASURED and curve.predicted is not None:
                    yield number, curve

    def agreement(self, within: float = 0.05) -> tuple[int, list[dict[str, Any]]]:
        """How many measured points were compared, and those off their prediction, with the reason:
        further than `within` of it and with a confidence interval that does not hold it."""
        compared, off = 0, []
        for number, curve in self.measured():
            assert curve.predicted is not None
            for i, (x, y, p) in enumerate(zip(curve.x, curve.y, curve.predicted, strict=True)):
                if abs(y) <= curve.floor:
                    continue
                compared += 1
                low = y if curve.low is None else curve.low[i]
                high = y if curve.high is None else curve.high[i]
                if abs(y - p) > within * abs(p) and not low <= p <= high:
                    reason = curve.beyond or ("unexplained" if curve.low is None else CHANCE)
                    row = {"panel": number, "label": curve.label, "x": x, "y": y, "predicted": p}
                    off.append({**row, "reason": reason})
        return compared, off

    def to_csv(self) -> str:
        """Every point, one a line: panel, label, kind, x, y, low, high, predicted."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(COLUMNS)
        for number, panel in enumerate(self.panels):
            for curve in panel.curves:
                for i in range(len(curve.x)):
                    more = [
                        "" if values is None else repr(float(values[i]))
                        for values in (curve.low, curve.high, curve.predicted)
                    ]
                    x, y = repr(float(curve.x[i])), repr(float(curve.y[i]))
                    writer.writerow([number, curve.label, curve.kind, x, y, *more])
            if panel.field is not None:
                for j, y in enumerate(panel.field.y):
                    for i, x in enumerate(panel.field.x):
                        z = repr(float(panel.field.z[j, i]))
                        row = [repr(float(x)), repr(float(y)), "", "", z]
                        writer.writerow([number, panel.field.label, "field", *row])
        return out.getvalue()


def predicted(label: str, x: ArrayLike, y: ArrayLike) -> Curve:
    """A line."""
    return Curve(label, PREDICTED, _array(x), _array(y))


def measured(
    label: str,
    x: ArrayLike,
    y: ArrayLike,
    *,
    low: ArrayLike | None = None,
    high: ArrayLike | None = None,
    predicted: ArrayLike | None = None,
    floor: float = 0.0,
    beyond: str = "",
) -> Curve:
    """Points, with confidence intervals and predictions if there are any."""
    below, above, theory = (None if v is None else _array(v) for v in (low, high, predicted))
    return Curve(label, MEASURED, _array(x), _array(y), below, above, theory, floor, beyond)


def reference(label: str, x: ArrayLike, y: ArrayLike) -> Curve:
    """A slope to compare with, drawn thin and named at its right end."""
    return Curve(label, REFERENCE, _array(x), _array(y))


def slope(label: str, power: float, x: tuple[float, float], through: tuple[float, float]) -> Curve:
    """y ∝ x^power through a point, from x[0] to x[1]."""
    ends = np.array(x)
    return reference(label, ends, through[1] * (ends / through[0]) ** power)


def _array(values: ArrayLike) -> Floats:
    return np.atleast_1d(np.asarray(values, dtype=np.float64))


# ---------------------------------------------------------------------------------------- drawing


def draw(picture: Picture) -> Figure:
    """The picture as a matplotlib Figure, outside pyplot: nothing global is touched. Notebooks,
    which know the figures of pyplot alone, are told how to show it.

    Raises ValueError, with what to install, where matplotlib is missing.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError:
        raise ValueError(
            "figures: matplotlib is not installed; install it with: pip install 'sphtrunc[plot]'"
        ) from None
    with rc_context(_STYLE):
        columns = min(2, len(picture.panels))
        rows = -(-len(picture.panels) // columns)
        figure = Figure(
            figsize=(WIDTH * columns, HEIGHT * rows + 0.55), dpi=DPI, layout="constrained"
        )
        grid = figure.subplots(rows, columns, squeeze=False)
        axes = list(grid.flat)
        for spare in axes[len(picture.panels) :]:
            spare.set_axis_off()
        for axis, panel in zip(axes, picture.panels, strict=False):
            _panel(axis, panel)
        figure.suptitle(picture.caption, fontsize=11)
        kinds = {curve.kind for panel in picture.panels for curve in panel.curves}
        note = picture.note or ("lines: derived, points: measured" if MEASURED in kinds else "")
        if note:
            figure.supxlabel(note, fontsize=8, color="#444444", x=0.99, ha="right")
    figure._repr_png_ = lambda: _saved(figure, "png")  # type: ignore[attr-defined]
    return figure


_STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.labelsize": 11,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.framealpha": 0.9,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.5,
    "svg.hashsalt": "sphtrunc",
    "svg.fonttype": "path",
    "mathtext.fontset": "dejavusans",
}


def _panel(axis: Axes, panel: Panel) -> None:
    axis.set_xscale(panel.xscale)
    axis.set_yscale(panel.yscale)
    if panel.field is not None:
        _contours(axis, panel.field)
    labels = list(dict.fromkeys(c.label for c in panel.curves if c.kind != REFERENCE))
    for curve in panel.curves:
        x, y = _positive(curve, panel)
        if curve.kind == REFERENCE:
            axis.plot(x, y, color="#555555", linewidth=0.9, linestyle=(0, (4, 2)), zorder=1.5)
            axis.annotate(
                curve.label,
                (x[-1], y[-1]),
                xytext=(3, 2),
                textcoords="offset points",
                fontsize=9,
                color="#333333",
            )
            continue
        look = labels.index(curve.label)
        colour = COLOURS[look % len(COLOURS)]
        if curve.kind == PREDICTED:
            axis.plot(x, y, color=colour, linestyle=DASHES[look % len(DASHES)], zorder=2)
            continue
        bars = None
        if curve.low is not None and curve.high is not None:
            bars = np.maximum(np.stack([y - curve.low, curve.high - y]), 0.0)
        axis.errorbar(
            x,
            y,
            yerr=bars,
            color=colour,
            linestyle="none",
            marker=MARKERS[look % len(MARKERS)],
            markersize=_size(look),
            markerfacecolor="none",  # what lies beneath stays visible
            markeredgewidth=1.2,
            elinewidth=1.0,
            capsize=2.0,
            zorder=3,
        )
    axis.set_xlabel(panel.xlabel)
    axis.set_ylabel(panel.ylabel)
    if panel.title:
        axis.set_title(panel.title, fontsize=10)
    if panel.ylim is not None:
        axis.set_ylim(*panel.ylim)
    if panel.xscale == "log":
        _ticks(axis.xaxis, *axis.get_xlim())
    if panel.yscale == "log":
        _ticks(axis.yaxis, *axis.get_ylim())
    if labels and panel.legend is not None:
        axis.legend(handles=_handles(labels, panel.curves), loc=panel.legend)


def _ticks(axis: Any, low: float, high: float) -> None:
    """Plain numbers on an axis of less than two decades, where powers of ten are too far apart."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    if not 0 < low < high < 60 * low:
        return
    steps = (1, 2, 3, 4, 6, 8) if high < 12 * low else (1, 2, 4)
    decades = range(floor(log10(low)), ceil(log10(high)))
    ticks = [m * 10.0**e for e in decades for m in steps if low <= m * 10.0**e <= high]
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_formatter(NullFormatter())


def _positive(curve: Curve, panel: Panel) -> tuple[Floats, Floats]:
    """What a logarithmic axis can show: sizes, with gaps where there is nothing."""
    y = np.abs(curve.y) if panel.yscale == "log" else curve.y
    return curve.x, np.where(y > 0, y, np.nan) if panel.yscale == "log" else y


def _size(look: int) -> float:
    """Later markers are smaller, so that coinciding points are seen as such."""
    return (8.5, 7.0, 6.0, 5.0, 4.5, 4.0, 3.5, 3.0)[look % 8]


def _handles(labels: Sequence[str], curves: Sequence[Curve]) -> list[Any]:
    """One entry a label: its line, its marker, or both."""
    from matplotlib.lines import Line2D

    entries = []
    for look, label in enumerate(labels):
        kinds = {c.kind for c in curves if c.label == label}
        entries.append(
            Line2D(
                [],
                [],
                label=label,
                color=COLOURS[look % len(COLOURS)],
                linestyle=DASHES[look % len(DASHES)] if PREDICTED in kinds else "none",
                marker=MARKERS[look % len(MARKERS)] if MEASURED in kinds else "",
                markersize=_size(look),
                markerfacecolor="none",
                markeredgewidth=1.2,
            )
        )
    return entries


def _contours(axis: Axes, field: Field) -> None:
    level = np.log10(field.z)
    steps = np.arange(np.floor(level.min()), np.ceil(level.max()) + 0.5, 0.5)
    filled = axis.contourf(field.x, field.y, level, levels=steps, cmap="Greys_r", alpha=0.55)
    lines = axis.contour(
        field.x, field.y, level, levels=steps, colors="#333333", linewidths=0.6, linestyles="-"
    )
    whole = [v for v in steps if v % 1 == 0 and level.min() < v < level.max()]
    for text in axis.clabel(lines, whole, fmt=lambda v: f"$10^{{{v:.0f}}}$", fontsize=8):
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0})
        text.set_zorder(4)
    figure = axis.get_figure()
    assert figure is not None
    figure.colorbar(filled, ax=axis, label=field.label, format="%.1f")


def save(picture: Picture, out: str | Path) -> list[Path]:
    """Write NAME.png, NAME.svg and NAME.csv into the folder `out` (made if missing), each whole.

    Raises ValueError where that is not possible.
    """
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"out {folder}: {error.strerror or error}") from None
    written = [folder / f"{picture.name}.csv"]
    write_atomically(written[0], picture.to_csv())
    figure = draw(picture)
    for kind in _METADATA:
        written.append(folder / f"{picture.name}.{kind}")
        write_atomically(written[-1], _saved(figure, kind))
    return written


#: what a file would say of its making, left out: the same bytes every time
_METADATA: dict[str, dict[str, Any]] = {"png": {"Software": None}, "svg": {"Date": None}}


def _saved(figure: Figure, kind: str) -> bytes:
    """The figure as a file of this kind."""
    from matplotlib import rc_context

    data = io.BytesIO()
    with rc_context(_STYLE):
        figure.savefig(data, format=kind, metadata=_METADATA[kind])
    return data.getvalue()
