"""Options that several commands share, so that they are spelled and explained the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

kernel: Decorator = click.option(
    "--kernel",
    "-k",
    required=True,
    metavar="SPEC",
    help="A name (see `sphtrunc kernels`), a formula such as '0..1: 1-q^2/2; 1..2: (2-q)^2/2' or"
    " 'pos(2-q)^3 - 4*pos(1-q)^3', or a .toml or .json file.",
)
dim: Decorator = click.option(
    "--dim", type=click.IntRange(1, 3), default=1, show_default=True, help="Dimension."
)
output: Decorator = click.option(
    "-o", "--output", metavar="FILE", help="Write to this file instead of the terminal."
)


def formats(*names: str) -> Decorator:
    """--format with the given choices, the first of them the default."""
    return click.option(
        "--format",
        "format_",
        type=click.Choice(names),
        default=names[0],
        show_default=True,
        help="How the result is written.",
    )
