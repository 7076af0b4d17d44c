"""sphtrunc explore: a page that computes, and the numbers of its settings."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit, write_atomically
from sphtrunc.version import __version__


@click.command(name="explore")
@click.argument("link", default="")
@click.option(
    "-o", "--output", metavar="FILE", help="Where the page goes.  [default: explorer.html]"
)
@click.option("--open", "show", is_flag=True, help="Open it in the browser, at the link's setting.")
@click.option(
    "--numbers",
    "wanted",
    is_flag=True,
    help="Not the page, but what it shows for the link's setting, computed by this package.",
)
@options.formats("text", "json")
def command(link: str, output: str | None, show: bool, wanted: bool, format_: str) -> None:
    """Write the explorer, a page that shows the truncation error of any setting in a browser.

    One file without a request to anywhere: kernels of the catalogue or typed pieces, every lattice,
    form and correction. LINK is an address of that page, or what stands after its #.

    \b
    sphtrunc explore -o explorer.html
    sphtrunc explore --open 'kernel=wendland-c2&dim=3&dx-over-h=0.7'
    sphtrunc explore --numbers 'kernel=wendland-c2&dim=3&dx-over-h=0.7'
    """
    from sphtrunc.explorer.setting import document, setting

    at = setting(link)
    if wanted:
        if show:
            raise click.UsageError("--open shows the page and --numbers prints: give one of them")
        found = document(at)
        if format_ == "text":
            emit(_text(found), output)
        else:
            head = {"schema": "sphtrunc.explore/1", "version": __version__}
            emit(json.dumps({**head, **found}, indent=1, ensure_ascii=False), output)
        return
    if format_ != "text":
        raise click.UsageError("--format is of numbers: give --numbers as well")
    if link and not show:
        raise click.UsageError("a link is for --open or --numbers: give one of them")
    from sphtrunc.explorer.assembly import page

    path = Path(output or "explorer.html")
    html = page()
    write_atomically(path, html)
    click.echo(f"{path}: {math.ceil(len(html.encode()) / 1024)} KiB, for any browser")
    if show:
        address = path.resolve().as_uri() + f"#{at.link}"
        if click.launch(address):
            raise ValueError(f"open: no browser could be started; open {address}")


def _text(found: dict[str, Any]) -> str:
    at, error = found["setting"], found["error"]
    lines = [
        f"{at['kernel']} in {at['dim']}D on {at['lattice']}, Δx/h = {at['dx-over-h']}",
        f"  gradient, {at['form']} form, correction {at['correction']}",
        f"  {found['particles']} particles within the support, the target counted",
        f"Error of a wave at h/λ = {at['h-over-lambda']}, jitter {at['jitter']} Δx, in first order",
        *(f"  {part:<15} {value:.12e}" for part, value in error.items()),
        "Moments along the first axis       mean                   spread",
        *(
            f"  M{n}{' − 1' if n == 1 else '    '}   {mean - (n == 1): 27.12e}  {spread:22.12e}"
            for n, (mean, spread) in enumerate(zip(found["moments"], found["spreads"], strict=True))
        ),
        "The same h in other words, lengths in Δx",
        *(
            f"  {name:<15} {'none' if value is None else f'{value:.12g}'}"
            for name, value in found["conventions"].items()
        ),
    ]
    return "\n".join(lines)
