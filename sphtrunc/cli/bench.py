"""sphtrunc bench: run time against error, on this machine."""

from __future__ import annotations

import click

from sphtrunc.bench import SUITES, bench
from sphtrunc.bench.report import Table, heading, machine
from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="bench")
@click.option(
    "--suite",
    "suites",
    multiple=True,
    type=click.Choice(list(SUITES)),
    help="Which one; may be repeated. Default: all.",
)
@click.option("--quick", is_flag=True, help="Small cases, within a minute.")
@click.option("--pictures", metavar="DIR", help="Also draw what can be drawn (needs matplotlib).")
@options.formats("text", "json")
@options.output
def command(
    suites: tuple[str, ...], quick: bool, pictures: str | None, format_: str, output: str | None
) -> None:
    """Time the engines, the precisions, the operators and the derivations; break the numerics.

    Medians with their spread; what is compared is run in alternation on this machine.

    \b
    sphtrunc bench --quick
    sphtrunc bench --suite stability --quick --format json
    """
    shown: list[str] = []

    def show(suite: str, table: Table) -> None:
        """As soon as it is there: a full run takes many minutes."""
        if suite not in shown:
            shown.append(suite)
            click.echo(f"== {suite} ==\n")
        click.echo(f"{table.to_text()}\n")

    at_once = format_ == "text" and output is None
    if at_once:
        click.echo(f"{heading(machine())}\n")
    report = bench(suites, quick=quick, each=show if at_once else None)
    if at_once:
        click.echo(f"{report.seconds:.0f} s in all")
    else:
        emit(report.to_text() if format_ == "text" else report.to_json(), output)
    if pictures is not None:
        from sphtrunc.bench.pictures import pictures_of
        from sphtrunc.figures.picture import save

        for picture in pictures_of(report):
            for path in save(picture, pictures):
                click.echo(str(path), err=True)
