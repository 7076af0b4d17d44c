"""Pictures of a benchmark: error against time, and rounding error against its bound."""

from __future__ import annotations

from collections.abc import Iterator

from sphtrunc.bench.report import Report, Table
from sphtrunc.figures.picture import Panel, Picture, measured, predicted


def pictures_of(report: Report) -> Iterator[Picture]:
    """What the suites of this report can show."""
    for name, tables in report.suites.items():
        if name == "work-precision":
            yield _work(tables)
        elif name == "stability":
            yield _floor(next(t for t in tables if "h/λ" in t.columns))
        elif name == "engine":
            yield _scaling(next(t for t in tables if "bytes a particle" in t.columns))


def _work(tables: list[Table]) -> Picture:
    """rms error against microseconds, a curve per form and correction, a panel per dimension."""
    panels = []
    for table in tables:
        if "front" not in table.columns:
            continue
        curves: dict[str, list[tuple[float, float]]] = {}
        for operator, _, _, error, seconds, *_ in table.rows:
            curves.setdefault(operator.split(", ", 1)[1], []).append((seconds, error))
        panels.append(
            Panel(
                "µs a target",
                "rms error of the gradient",
                tuple(
                    measured(label, *zip(*sorted(points), strict=True))
                    for label, points in curves.items()
                ),
                title=table.title[:2],
            )
        )
    return Picture(
        "work-precision",
        "Error of the gradient of a sinusoid against time, at fixed resolution",
        tuple(panels),
        note="the fastest of its form is on the left, the most accurate below",
    )


def _floor(table: Table) -> Picture:
    """Rounding error (points) and its bound (lines) against h/λ, one panel per form."""
    panels: list[Panel] = []
    for form in dict.fromkeys(row[0] for row in table.rows):
        curves = []
        for ratio in sorted({row[2] for row in table.rows}):
            rows = [row for row in table.rows if row[0] == form and row[2] == ratio]
            x = [row[1] for row in rows]
            curves += [
                predicted(f"Δx/h = {ratio:g}", x, [row[4] for row in rows]),
                measured(f"Δx/h = {ratio:g}", x, [row[3] for row in rows]),
            ]
        legend = None if panels else "best"  # the same curves in every panel
        panels.append(
            Panel("h/λ", "relative rounding error", tuple(curves), title=form, legend=legend)
        )
    caption = "Largest rounding error (points) and its bound (lines)"
    return Picture("floor", caption, tuple(panels), note="a point above its line is a violation")


def _scaling(table: Table) -> Picture:
    """Nanoseconds a pair against the number of particles."""
    x, y = [row[0] for row in table.rows], [row[2] for row in table.rows]
    panel = Panel("particles", "ns a pair", (measured("gradient, cubic spline", x, y),))
    return Picture(
        "engine-scaling",
        "Time per pair against the number of particles",
        (panel,),
        note="medians of three",
    )
