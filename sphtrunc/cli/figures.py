"""sphtrunc figures: every figure as PNG, SVG and CSV."""

from __future__ import annotations

import click

from sphtrunc.figures import FIGURES, make, names


@click.command(name="figures")
@click.argument("wanted", nargs=-1, metavar="[NAME ...]")
@click.option("--out", metavar="DIR", default="figures", show_default=True, help="Where to.")
@click.option("--quick", is_flag=True, help="Fewer points and targets, for a look.")
@click.option("--kernel", "-k", metavar="SPEC", help="Draw them for this kernel.")
@click.option("--check", is_flag=True, help="End with status 1 if more than 5 % of points are off.")
@click.option("--list", "listing", is_flag=True, help="List the names and stop.")
def command(
    wanted: tuple[str, ...], out: str, quick: bool, kernel: str | None, check: bool, listing: bool
) -> int:
    """Draw the figures: what was measured, and what was derived, through it.

    Each comes as NAME.png, NAME.svg and NAME.csv; without a name all are drawn. Points further than
    5 % from their curve, with an interval that does not hold it, are listed with the reason.

    \b
    sphtrunc figures --quick --out figures
    sphtrunc figures uniform-smoothing --kernel wendland-c4-1d --out figures
    """
    if listing:
        for name, (_, says) in FIGURES.items():
            click.echo(f"{name:<24} {says}")
        return 0
    from sphtrunc.figures.picture import save

    compared, off = 0, 0
    for name in names(wanted):
        picture = make(name, kernel, quick)
        save(picture, out)
        points, astray = picture.agreement()
        said = f", {points - len(astray)} of {points} points on their curves" if points else ""
        click.echo(f"{out}/{name}.png, .svg, .csv{said}")
        for row in astray:
            click.echo(
                f"  off: panel {row['panel'] + 1}, {row['label']} at {row['x']:.4g}: measured"
                f" {row['y']:.4g}, predicted {row['predicted']:.4g}"
                f" ({100 * (row['y'] / row['predicted'] - 1):+.1f} %): {row['reason']}"
            )
        compared, off = compared + points, off + len(astray)
    if compared:
        click.echo(
            f"{compared - off} of {compared} points ({100 * (1 - off / compared):.1f} %) lie within"
            " 5 % or the 95 % confidence interval of their prediction"
        )
    return int(check and 20 * off > compared)
