"""sphtrunc derive: the truncation error of a kernel, exactly."""

from __future__ import annotations

import click

from sphtrunc.cli import options
from sphtrunc.operators.h_rules import RULES
from sphtrunc.output import emit
from sphtrunc.theory.deriving import derive


@click.command(name="derive")
@options.kernel
@options.dim
@options.estimate
@click.option(
    "--degree", type=int, default=5, show_default=True, help="Highest moment M_k to derive."
)
@options.dx_over_h
@options.offset
@options.lattice
@options.jitter
@options.distribution
@click.option(
    "--volume",
    type=click.Choice(("constant", "cell", "summation")),
    default="constant",
    show_default=True,
    help="Volume of a particle: Δx^d, half-way to the neighbours (1D), or m/ρ.",
)
@click.option("--h-gradient", metavar="G", help="dh/dx, one number or gx,gy,gz: h(x) = h + G·x.")
@click.option(
    "--h-rule",
    type=click.Choice(RULES),
    help="Whose h a pair takes.  [default: scatter]",
)
@options.wall
@options.wall_at
@options.wall_weight
@options.ghosts
@options.formats("text", "latex", "json")
@options.output
def command(
    kernel: str,
    dim: int,
    operator: str,
    form: str | None,
    correction: str,
    degree: int,
    dx_over_h: str | None,
    offset: str,
    lattice: str | None,
    jitter: str | None,
    distribution: str,
    volume: str,
    h_gradient: str | None,
    h_rule: str | None,
    wall: str | None,
    wall_at: str | None,
    wall_weight: str | None,
    ghosts: str,
    format_: str,
    output: str | None,
) -> None:
    """Derive the truncation error of a kernel: smoothing and discretisation, exactly.

    \b
    sphtrunc derive --kernel cubic-spline
    sphtrunc derive --kernel wendland-c2 --dim 3 --lattice bcc --dx-over-h 1/2
    sphtrunc derive --kernel 'pos(2-q)^3 - 4*pos(1-q)^3' --dx-over-h 10/13 --format json
    sphtrunc derive --kernel wendland-c2 --dim 2 --dx-over-h 0.6 --jitter 0.05
    sphtrunc derive --kernel cubic-spline --h-gradient 1/5 --h-rule scatter
    sphtrunc derive --kernel cubic-spline --dx-over-h 1/2 --wall 1/4 --wall-at half-way
    sphtrunc derive --kernel cubic-spline --dim 3 --correction csph --form difference --wall
    """
    if h_rule is not None and h_gradient is None:
        raise ValueError("h-rule: nothing varies; expected --h-gradient G as well")
    result = derive(
        kernel,
        operator,
        form=form,
        correction=correction,
        dim=dim,
        degree=degree,
        dx_over_h=dx_over_h,
        offset=offset.split(",") if "," in offset else offset,
        lattice=lattice,
        volume=volume,
        jitter=jitter,
        distribution=distribution,
        h_gradient=h_gradient.split(",") if h_gradient and "," in h_gradient else h_gradient,
        h_rule=h_rule or "scatter",
        wall=wall,
        wall_at=wall_at,
        wall_weight=wall_weight,
        ghosts=ghosts,
    )
    render = {"text": result.to_text, "latex": result.to_latex, "json": result.to_json}
    emit(render[format_](), output)
