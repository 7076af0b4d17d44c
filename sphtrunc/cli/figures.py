"""sphtrunc figures: every figure as PNG, SVG and CSV."""

from __future__ import annotations

import click

from sphtrunc.figures import FIGURES, make, names


@click.command(name="figures")
@click.argument("wanted", nargs=-1, metavar="[NAME ...]")
@click.option("--out", metavar="DIR", default="figures", show_default=True, help="Where to.")
@click.option("--quick", is_flag=True, help="Fewer points and targets, for a look.")
@click.option("--kernel", "-k", metavar="SPEC", help="Draw them for this kernel.")
@click.option("--list", "listing", is_flag=True, help="List the names and stop.")
def command(
    wanted: tuple[str, ...], out: str, quick: bool, kernel: str | None, listing: bool
) -> None:
    """Draw the figures: what was measured, and what was derived, through it.

    Each comes as NAME.png, NAME.svg and NAME.csv; without a name all are drawn.

    \b
    sphtrunc figures --quick --out figures
    sphtrunc figures uniform-smoothing --kernel wendland-c4-1d --out figures
    """
    if listing:
        for name, (_, says) in FIGURES.items():
            click.echo(f"{name:<24} {says}")
        return
    from sphtrunc.plot import save

    for name in names(wanted):
        picture = make(name, kernel, quick)
        save(picture, out)
        compared, off = picture.agreement()
        said = f", {compared - len(off)} of {compared} points on their curves" if compared else ""
        click.echo(f"{out}/{name}.png, .svg, .csv{said}")
