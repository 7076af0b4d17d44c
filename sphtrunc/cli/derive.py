"""sphtrunc derive: the truncation error of a kernel, exactly."""

from __future__ import annotations

import click

from sphtrunc.cli import options
from sphtrunc.operators import CORRECTIONS, DERIVATIVES, FORMS
from sphtrunc.output import emit
from sphtrunc.theory import derive


@click.command(name="derive")
@options.kernel
@options.dim
@click.option(
    "--operator",
    type=click.Choice(list(DERIVATIVES)),
    default="gradient",
    show_default=True,
    help="What is estimated.",
)
@click.option(
    "--form",
    type=click.Choice(FORMS),
    default="standard",
    show_default=True,
    help="A_b, or A_b - A_a, in the sum.",
)
@click.option(
    "--correction",
    type=click.Choice(CORRECTIONS),
    default="none",
    show_default=True,
    help="Consistency correction.",
)
@click.option(
    "--degree", type=int, default=5, show_default=True, help="Highest moment M_k to derive."
)
@click.option(
    "--dx-over-h", metavar="P/Q", help="Particle spacing over smoothing length, exact (1D)."
)
@click.option(
    "--offset",
    metavar="P/Q",
    default="0",
    show_default=True,
    help="Distance of the target from a particle, in Δx (1D).",
)
@options.formats("text", "latex", "json")
@options.output
def command(
    kernel: str,
    dim: int,
    operator: str,
    form: str,
    correction: str,
    degree: int,
    dx_over_h: str | None,
    offset: str,
    format_: str,
    output: str | None,
) -> None:
    """Derive the truncation error of a kernel: smoothing and discretisation, exactly.

    \b
    sphtrunc derive --kernel cubic-spline
    sphtrunc derive --kernel wendland-c2 --dim 3
    sphtrunc derive --kernel 'pos(2-q)^3 - 4*pos(1-q)^3' --dx-over-h 10/13 --format json
    """
    result = derive(
        kernel,
        operator,
        form=form,
        correction=correction,
        dim=dim,
        degree=degree,
        dx_over_h=dx_over_h,
        offset=offset,
    )
    render = {"text": result.to_text, "latex": result.to_latex, "json": result.to_json}
    emit(render[format_](), output)
