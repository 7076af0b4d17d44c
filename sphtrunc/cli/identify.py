"""sphtrunc identify: recognise a kernel's constant."""

from __future__ import annotations

import click

from sphtrunc.audit.identification import identify
from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="identify")
@click.argument("constant")
@options.formats("text", "json")
@options.output
def command(constant: str, format_: str, output: str | None) -> None:
    """Recognise a constant: its exact form, the kernel it belongs to, and near misses.

    CONSTANT is a decimal or an expression in pi; 1/(pi*h^3) says its dimension as well.

    \b
    sphtrunc identify 0.0026599711937
    sphtrunc identify '16/pi'
    """
    found = identify(constant)
    emit(found.to_json() if format_ == "json" else found.to_text(), output)
