"""sphtrunc export: golden values for the tests of other codes."""

from __future__ import annotations

import click

from sphtrunc.audit.golden import FORMATS, export
from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="export")
@options.kernel
@options.dim
@click.option("--points", type=int, default=200, show_default=True, help="Rows of the table.")
@click.option(
    "--digits",
    type=click.Choice(["17", "30"]),
    default="17",
    show_default=True,
    help="Significant digits; 17 determine a double.",
)
@options.formats(*FORMATS)
@options.output
def command(
    kernel: str, dim: int, points: int, digits: str, format_: str, output: str | None
) -> None:
    """Write golden values: q, W, W′, W″ and kernel moments, exact and correctly rounded.

    \b
    sphtrunc export --kernel quintic-spline --dim 3 -o golden.json
    sphtrunc export --kernel wendland-c2 --dim 2 --points 50 --format c -o golden.h
    """
    emit(export(kernel, dim, points, int(digits), format_), output)
