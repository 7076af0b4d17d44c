"""sphtrunc wall: what every remedy leaves of the error near a wall."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.theory.walls.remedies import Row


@click.command(name="wall")
@options.kernel
@options.dim
@click.option(
    "--eta",
    metavar="LIST",
    help="Distances from the wall in h, as 0,1/4,1.  [default: 0, 1/4, 1/2, 1, the support]",
)
@click.option(
    "--remedy",
    "remedy",
    metavar="NAMES",
    help="Of them only these, as shepard,csph,mirror.  [default: all]",
)
@options.formats("text", "json", "csv")
@options.output
def command(
    kernel: str,
    dim: int,
    eta: str | None,
    remedy: str | None,
    format_: str,
    output: str | None,
) -> None:
    """What remains of the error near a wall or a free surface, remedy by remedy.

    \b
    sphtrunc wall --kernel cubic-spline
    sphtrunc wall --kernel wendland-c2 --dim 3 --eta 0,1/2 --remedy bare,shepard,csph
    sphtrunc wall --kernel quintic-spline --dim 2 --format json
    """
    from sphtrunc.kernels.parse import kernel as parse_kernel
    from sphtrunc.theory.walls.remedies import remedies

    shape = parse_kernel(kernel)
    found = remedies(
        shape,
        dim,
        None if eta is None else [part.strip() for part in eta.split(",")],
        None if remedy is None else [part.strip() for part in remedy.split(",")],
    )
    rows = list(_shown_as_found(found))
    if format_ == "json":
        text = to_json(shape, dim, rows)
    elif format_ == "csv":
        text = to_csv(rows)
    else:
        text = to_text(shape, dim, rows)
    emit(text, output)


def _shown_as_found(rows: Iterable[Row]) -> Iterable[Row]:
    """On a terminal, where the table has got to."""
    if not sys.stderr.isatty():
        yield from rows
        return
    for row in rows:
        note = f"η = {row.eta}: {row.operator}, {row.remedy}"
        click.echo(f"\r{note:<60}", nl=False, err=True)
        yield row
    click.echo(f"\r{'':<60}\r", nl=False, err=True)


def to_json(kernel: Any, dim: int, rows: Sequence[Row]) -> str:
    """The contract of schema `sphtrunc.wall/1`."""
    from sphtrunc.theory.walls.remedies import REMEDIES

    result = {
        "schema": "sphtrunc.wall/1",
        "kernel": kernel.name,
        "dim": dim,
        "remedies": {name: REMEDIES[name].says for name in dict.fromkeys(r.remedy for r in rows)},
        "rows": [row.to_dict() for row in rows],
        "advice": advice(rows),
        "version": __version__,
    }
    return json.dumps(result, indent=1, ensure_ascii=False)


def to_csv(rows: Sequence[Row]) -> str:
    """One line a row, with a header."""
    import csv
    import io

    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0].to_dict()) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.to_dict() for row in rows)
    return text.getvalue().rstrip("\n")


def to_text(kernel: Any, dim: int, rows: Sequence[Row]) -> str:
    """A table for each operator, a line for each remedy, a column for each distance; at most 100
    columns."""
    from sphtrunc.theory.walls.remedies import REMEDIES

    etas = list(dict.fromkeys(row.eta for row in rows))
    used = list(dict.fromkeys(row.remedy for row in rows))
    lines = [
        f"Errors at a distance η h from a plane wall or a free surface: {kernel.name}, {dim}D",
        "n is the normal of the wall, t along it; in 3D each of the two",
    ]
    for operator, component in dict.fromkeys((r.operator, r.component) for r in rows):
        own = [r for r in rows if (r.operator, r.component) == (operator, component)]
        title = operator if component == "all" else f"{operator}, {component}"
        cells = {
            name: [_cell([r for r in own if r.remedy == name and r.eta == eta]) for eta in etas]
            for name in dict.fromkeys(r.remedy for r in own)
        }
        for part in _columns(cells, etas):
            lines += ["", *_table(title, part)]
    lines += ["", "Remedies"]
    lines += [f"  {name:<15} {REMEDIES[name].says}" for name in used]
    lines += ["", *advice(rows)]
    if any(r.remedy == "mirror" for r in rows):
        lines.append(
            "mirror gains an order, or two, where ∂A/∂n = 0 on the wall, as its images say."
        )
    lines += [
        "A wall anywhere in the lattice adds errors of first order in Δx/h; half-way between"
        " particles,",
        "or at particles of which half counts, of second order, whatever the kernel.",
    ]
    return "\n".join(lines)


def _columns(cells: dict[str, list[str]], etas: Sequence[Any]) -> list[list[list[str]]]:
    """The table in parts that are at most 100 columns wide, the remedy first in each."""
    heads = [f"η = {eta}" for eta in etas]
    wide = [max(len(x) for x in [h, *(c[i] for c in cells.values())]) for i, h in enumerate(heads)]
    parts: list[list[int]] = [[]]
    for i, width in enumerate(wide):
        if parts[-1] and 23 + sum(wide[j] + 3 for j in parts[-1]) + width > 100:
            parts.append([])
        parts[-1].append(i)
    return [
        [
            ["", *(heads[i].ljust(wide[i]) for i in part)],
            *([name, *(row[i].ljust(wide[i]) for i in part)] for name, row in cells.items()),
        ]
        for part in parts
    ]


def _table(title: str, part: list[list[str]]) -> list[str]:
    head, *body = part
    rows = [[title, *head[1:]], *([f"  {name}", *cells] for name, *cells in body)]
    return ["   ".join([f"{first:<20}", *rest]).rstrip() for first, *rest in rows]


def _cell(rows: Sequence[Row]) -> str:
    """The leading errors: "0.2333 h A_n"."""
    if not rows:
        return ""
    if rows[0].order_h is None:
        return "exact"
    terms: list[str] = []
    for row in rows:
        value = float(row.coefficient)
        sign = "−" if value < 0 else "+" if terms else ""
        power = {0: "", 1: "h "}.get(row.order_h or 0, f"h^{row.order_h} ")
        terms.append(f"{sign}{' ' if terms else ''}{abs(value):.4g} {power}{row.derivative}")
    return " ".join(terms)


def advice(rows: Sequence[Row]) -> list[str]:
    """For each estimate the remedies that converge as h goes to 0 at every distance that was asked
    for, the cheapest, and that of the highest order."""
    from sphtrunc.theory.walls.remedies import REMEDIES

    lines = []
    for operator, component in dict.fromkeys((r.operator, r.component) for r in rows):
        own = [r for r in rows if (r.operator, r.component) == (operator, component)]
        least = {
            name: min(
                (r.order_h for r in own if r.remedy == name and r.order_h is not None), default=99
            )
            for name in REMEDIES
            if any(r.remedy == name for r in own)
        }
        good = [name for name, order in least.items() if order >= 1]
        title = operator if component == "all" else f"{component} {operator}"
        text = f"For the {title} none of these converges as h goes to 0"
        if good:
            best = max(good, key=lambda name: (least[name], -good.index(name)))
            text = f"For the {title} take {good[0]} (order {least[good[0]]})"
            if least[best] > least[good[0]]:
                text += f", or {best} (order {least[best]})"
        bad = [name for name, order in least.items() if order < 0]
        if bad:
            text += f"; {_and(bad)} grow{'s' if len(bad) == 1 else ''} as 1/h"
        lines.append(text + ".")
    return lines


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
