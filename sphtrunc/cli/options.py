"""Options that several commands share, so that they are spelled and explained the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from sphtrunc.operators.operator import CORRECTIONS, OPERATORS
from sphtrunc.scenes.walls import GHOSTS

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
dx_over_h: Decorator = click.option(
    "--dx-over-h", metavar="P/Q", help="Particle spacing over smoothing length."
)
lattice: Decorator = click.option(
    "--lattice",
    metavar="KIND",
    help="uniform; square, hexagonal; cubic, bcc, fcc, hcp.  [default: uniform, square, cubic]",
)
offset: Decorator = click.option(
    "--offset",
    metavar="P/Q",
    default="0",
    show_default=True,
    help="Position of the lattice relative to the target, in Δx; x,y,z in space.",
)
jitter: Decorator = click.option(
    "--jitter", metavar="SIGMA", help="Displace particles at random, σ/Δx along each axis."
)
distribution: Decorator = click.option(
    "--distribution",
    type=click.Choice(("gaussian", "uniform", "blue")),
    default="gaussian",
    show_default=True,
    help="Of the displacements.",
)
wall: Decorator = click.option(
    "--wall",
    metavar="[ETA]",
    is_flag=False,
    flag_value="eta",
    help="A plane wall or free surface, at this distance from the target in h; to derive it as"
    " functions of the distance, without a number.",
)
wall_at: Decorator = click.option(
    "--wall-at",
    metavar="PLACE",
    help="Where the lattice has the wall: particle, half-way, or P/Q steps before the first plane.",
)
wall_weight: Decorator = click.option(
    "--wall-weight",
    metavar="P/Q",
    help="What part of a particle on the wall counts.  [default: 1/2]",
)
ghosts: Decorator = click.option(
    "--ghosts",
    type=click.Choice(GHOSTS),
    default="none",
    show_default=True,
    help="Beyond the wall: nothing, images with A or 2 A_wall - A, dummies with Shepard means.",
)


def estimate(command: Callable[..., Any]) -> Callable[..., Any]:
    """--operator, --form and --correction: which SPH sum."""
    forms = dict.fromkeys(form for _, forms in OPERATORS.values() for form in forms)
    for option in (
        click.option(
            "--correction",
            type=click.Choice(CORRECTIONS),
            default="none",
            show_default=True,
            help="Consistency correction.",
        ),
        click.option(
            "--form",
            type=click.Choice(tuple(forms)),
            help="Form of the sum.  [default: A_b as it is]",
        ),
        click.option(
            "--operator",
            type=click.Choice(list(OPERATORS)),
            default="gradient",
            show_default=True,
            help="What is estimated.",
        ),
    ):
        command = option(command)
    return command


dim_of_file: Decorator = click.option(
    "--dim", type=click.IntRange(1, 3), help="What the dimension of the file has to be."
)


def snapshot(command: Callable[..., Any]) -> Callable[..., Any]:
    """--type, --columns, --period and --h: how a file of particles is understood."""
    for option in (
        click.option(
            "--h", "length", metavar="H", help="Smoothing length of all, in place of the file's."
        ),
        click.option(
            "--period",
            metavar="L",
            help="Box in place of the file's: L or Lx,Ly,Lz, inf along open axes; none: no period.",
        ),
        click.option(
            "--columns",
            metavar="Q=NAME,…",
            help="What columns hold, where their names do not say it: x=pos_x,h=hsml.",
        ),
        click.option(
            "--type", "kind", metavar="TYPE", help="Which particles of a file.  [default: type 0]"
        ),
    ):
        command = option(command)
    return command


def read_as(given: dict[str, Any]) -> dict[str, Any]:
    """The arguments of `sphtrunc.snapshot` that the options of `snapshot` stand for."""
    from sphtrunc.scenes.snapshots.columns import chosen

    columns = given["columns"]
    return {
        "type": given["kind"],
        "dim": given["dim"],
        "columns": None if columns is None else chosen(columns),
        "period": period(given["period"]),
        "h": positive("h", given["length"]),
    }


def period(text: str | None) -> Any:
    """L, Lx,Ly,Lz with inf along open axes, or none."""
    from math import inf

    from sphtrunc.arithmetic.rational import exact

    if text is None or text == "none":
        return text
    return [inf if side == "inf" else float(exact(side, "period")) for side in text.split(",")]


def positive(name: str, text: str | None) -> float | None:
    """A positive number, None where none was given."""
    from sphtrunc.arithmetic.rational import exact

    if text is None:
        return None
    value = float(exact(text, name))
    if not value > 0:
        raise ValueError(f"{name}: got {text[:40]}, expected a positive number")
    return value


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
