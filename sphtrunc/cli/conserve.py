"""sphtrunc conserve: what each momentum equation keeps, and at what error."""

from __future__ import annotations

from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.operators.forces import FORCES
from sphtrunc.operators.h_rules import FORCE_RULES
from sphtrunc.output import emit

_FORMS = (
    *(name for name in FORCES if name not in ("total-lagrangian", "stress-points")),
    "rkpm-strong",
    "rkpm-galerkin",
)


@click.command(name="conserve")
@options.kernel
@click.option("--dim", type=click.IntRange(1, 3), help="Dimension.  [default: 2, or the file's]")
@click.option(
    "--form",
    "forms",
    multiple=True,
    type=click.Choice(_FORMS),
    help="A momentum equation; may be given again.  [default: all]",
)
@click.option(
    "--h-rule",
    "rules",
    multiple=True,
    type=click.Choice(tuple(FORCE_RULES)),
    help="Whose h the kernel takes; may be given again.  [default: all]",
)
@click.option(
    "--lengths",
    type=click.Choice(("constant", "adapted", "random")),
    default="constant",
    show_default=True,
    help="h: one for all; h ∝ (m/ρ)^{1/d}, solved; at random from h/2 to 2h.",
)
@click.option("--dx-over-h", metavar="P/Q", help="Spacing over smoothing length.  [default: 5/6]")
@options.lattice
@click.option("--jitter", metavar="SIGMA", help="Displacements, σ/Δx.  [default: 0.1]")
@click.option("--mass-spread", type=float, help="Masses at random from 1/S to S.  [default: 1]")
@click.option("--radius", type=float, help="Of the ball of particles, in Δx.")
@click.option("--h-over-lambda", metavar="X", help="Of the wave in the pressure.  [default: 0.02]")
@click.option("--particles", metavar="FILE", help="Particles of a code, or a table, instead.")
@options.snapshot
@click.option("--seed", type=int, default=0, show_default=True, help="Of everything random.")
@click.option("--workers", type=int, help="Threads; results do not depend on it.")
@click.option("--no-predict", is_flag=True, help="Leave out what theory predicts.")
@options.formats("text", "json")
@options.output
def command(**given: Any) -> None:
    """Which forms keep momentum, angular momentum and energy exactly, and at what error.

    \b
    sphtrunc conserve --kernel wendland-c2
    sphtrunc conserve --kernel cubic-spline --dim 3 --lengths adapted --form symmetric --form grad-h
    sphtrunc conserve --kernel cubic-spline --particles snapshot.npz
    """
    result = _on_file(given) if given["particles"] is not None else _on_lattice(given)
    emit(result.to_json() if given["format_"] == "json" else result.to_text(), given["output"])


def _on_lattice(given: dict[str, Any]) -> Any:
    from sphtrunc.study.conservation.conserving import conserve

    for name in ("length", "period", "columns", "kind"):
        if given[name] is not None:
            option = {"length": "h", "kind": "type"}.get(name, name)
            raise ValueError(f"{option}: belongs to --particles FILE; lattices have --dx-over-h")
    named = {
        "dx_over_h": given["dx_over_h"],
        "kind": given["lattice"],
        "jitter": given["jitter"],
        "mass_spread": given["mass_spread"],
        "radius": given["radius"],
        "h_over_lambda": given["h_over_lambda"],
    }
    return conserve(
        given["kernel"],
        given["dim"] or 2,
        forms=given["forms"],
        rules=given["rules"],
        lengths=given["lengths"],
        seed=given["seed"],
        workers=given["workers"],
        predict=not given["no_predict"],
        **{name: value for name, value in named.items() if value is not None},
    )


def _on_file(given: dict[str, Any]) -> Any:
    from sphtrunc.scenes.snapshots.formats import read
    from sphtrunc.study.conservation.conserving import conserve_particles

    for name in ("dx_over_h", "lattice", "jitter", "mass_spread", "radius", "h_over_lambda"):
        if given[name] is not None:
            option = name.replace("_", "-")
            raise ValueError(f"{option}: a file of particles has none; expected one or the other")
    if given["lengths"] != "constant":
        raise ValueError("lengths: particles of a file have theirs; expected a column h, or --h H")
    found = read(given["particles"], **options.read_as(given))
    scene = found.particles()
    wanted = ("mass", "density", "pressure", "velocity")
    columns = {name: found.fields[name] for name in wanted if name in found.fields}
    for note in found.notes:
        click.echo(f"note: {note}", err=True)
    return conserve_particles(
        given["kernel"],
        {**columns, "x": scene.x.T, "h": scene.h},
        period=scene.period,
        forms=given["forms"],
        rules=given["rules"],
        seed=given["seed"],
        workers=given["workers"],
    )
