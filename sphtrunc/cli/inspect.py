"""sphtrunc inspect: what is in a file of particles, and which kernel made its densities."""

from __future__ import annotations

from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="inspect")
@click.argument("file", metavar="FILE")
@options.dim_of_file
@options.snapshot
@options.formats("text", "json")
@options.output
def command(**given: Any) -> None:
    """Say what is in a file that an SPH code wrote, and with which kernel and h it was summed.

    \b
    sphtrunc inspect snapshot_010.hdf5
    sphtrunc inspect particles.csv --columns x=pos_x,y=pos_y,h=hsml --period 1,1
    """
    from sphtrunc.study.snapshots.contents import inspect

    found = inspect(given["file"], **options.read_as(given))
    emit(found.to_json() if given["format_"] == "json" else found.to_text(), given["output"])
