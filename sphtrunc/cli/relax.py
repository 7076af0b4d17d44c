"""sphtrunc relax: particles that have moved apart, a glass."""

from __future__ import annotations

import json
import sys
from typing import Any

import click

from sphtrunc.output import emit
from sphtrunc.version import __version__


@click.command(name="relax")
@click.option("--number", "-n", "count", type=int, required=True, metavar="N", help="Particles.")
@click.option("--dim", type=click.IntRange(1, 3), default=2, show_default=True, help="Dimension.")
@click.option(
    "--kernel",
    "-k",
    metavar="SPEC",
    help="Shift along −∇ΣVW with this kernel.  [default: pair repulsion within 1.6 Δx]",
)
@click.option("--h-over-dx", metavar="X", help="Its smoothing length over Δx.")
@click.option(
    "--start",
    type=click.Choice(("jittered", "random")),
    default="jittered",
    show_default=True,
    help="From a lattice displaced by σ/Δx = 0.5, or from random places.",
)
@click.option(
    "--contrast",
    type=float,
    default=0.0,
    help="c of a density profile 1 + c cos(2πx/L).  [default: 0]",
)
@click.option(
    "--residual",
    type=float,
    default=1e-3,
    show_default=True,
    help="Stop where the rms of |h∇ΣVW| is less.",
)
@click.option("--steps", type=int, default=400, show_default=True, help="At most so many.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the start.")
@click.option("--workers", type=int, help="Threads; results do not depend on it.")
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="The particles, lengths in Δx: .npz, .csv, .vtp, .hdf5 (as Gadget has it); or .json: how"
    " regular they are.",
)
@click.option("--format", "format_", type=click.Choice(("text", "json")), default="text")
def command(**given: Any) -> int:
    """Make a periodic glass, and say how regular it is. Lengths are in Δx.

    \b
    sphtrunc relax --number 4096 --dim 2 -o glass.npz
    sphtrunc relax -n 4096 --dim 3 -k wendland-c2 --h-over-dx 1.5 --seed 1 -o glass.hdf5
    sphtrunc structure glass.npz --period 64
    """
    from sphtrunc.arithmetic.rational import exact
    from sphtrunc.experiment.glasses import glass
    from sphtrunc.experiment.relaxation import regularity
    from sphtrunc.scenes.particle_files import check, write
    from sphtrunc.scenes.relaxed import Recipe

    h, output = given["h_over_dx"], given["output"]
    summary = output is not None and output.lower().endswith(".json")
    if output is not None and not summary:
        check(output)
    recipe = Recipe(
        count=given["count"],
        dim=given["dim"],
        kernel=given["kernel"],
        h_over_dx=None if h is None else float(exact(h, "h-over-dx")),
        seed=given["seed"],
        start=given["start"],
        residual=given["residual"],
        steps=given["steps"],
        contrast=given["contrast"],
    )
    made = glass(recipe, workers=given["workers"], progress=_progress())
    document = {
        "schema": "sphtrunc.relax/1",
        "recipe": str(recipe),
        "period": [recipe.side] * recipe.dim,
        "steps": int(made.history.size) - 1,
        "residual": made.residual,
        "converged": made.converged,
        **regularity(made.particles, recipe.shape),
        "version": __version__,
    }
    report = json.dumps(document, indent=1)
    if summary:
        emit(report, output)
    elif output is not None:
        write(made.particles, output)
    emit(report if given["format_"] == "json" else _text(document), None)
    return 0


def _text(found: dict[str, Any]) -> str:
    state = "relaxed" if found["converged"] else "not yet relaxed (more --steps)"
    return "\n".join(
        [
            f"{found['recipe']}: {state} after {found['steps']} steps",
            f"  box side {found['period'][0]:.17g} Δx",
            f"  rms of |h∇ΣVW|     {found['gradient']:.3e}",
            f"  ΣVW                {found['density']:.6f} ± {found['density_std']:.1e}",
            f"  nearest neighbour  {found['nearest']:.4f} ± {found['nearest_std']:.4f} Δx",
            f"  disorder λ         {found['disorder']:.4f}",
        ]
    )


def _progress() -> Any:
    """The residual as it falls, on a terminal; nothing in a pipe."""
    if not sys.stderr.isatty():
        return None

    def show(step: int, residual: float) -> None:
        click.echo(f"\rstep {step}: residual {residual:.2e} ", nl=False, err=True)

    return show
