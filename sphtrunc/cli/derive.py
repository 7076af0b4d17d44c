"""sphtrunc derive: the truncation error of a kernel, exactly."""

from __future__ import annotations

import click

from sphtrunc.cli import options
from sphtrunc.operators import CORRECTIONS, OPERATORS
from sphtrunc.output import emit
from sphtrunc.theory import derive

_FORMS = tuple(dict.fromkeys(form for _, forms in OPERATORS.values() for form in forms))


@click.command(name="derive")
@options.kernel
@options.dim
@click.option(
    "--operator",
    type=click.Choice(list(OPERATORS)),
    default="gradient",
    show_default=True,
    help="What is estimated.",
)
@click.option("--form", type=click.Choice(_FORMS), help="Form of the sum.  [default: A_b as it is]")
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
@click.option("--dx-over-h", metavar="P/Q", help="Particle spacing over smoothing length, exact.")
@click.option(
    "--offset",
    metavar="P/Q",
    default="0",
    show_default=True,
    help="Position of the lattice relative to the target, in Δx; x,y,z in space.",
)
@click.option(
    "--lattice",
    metavar="KIND",
    help="uniform; square, hexagonal; cubic, bcc, fcc, hcp.  [default: uniform, square, cubic]",
)
@click.option("--jitter", metavar="SIGMA", help="Displaced particles, σ/Δx along each axis.")
@click.option(
    "--distribution",
    type=click.Choice(("gaussian", "uniform", "blue")),
    default="gaussian",
    show_default=True,
    help="Of the displacements.",
)
@click.option(
    "--volume",
    type=click.Choice(("constant", "cell", "summation")),
    default="constant",
    show_default=True,
    help="Volume of a particle: Δx^d, half-way to the neighbours (1D), or m/ρ.",
)
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
    format_: str,
    output: str | None,
) -> None:
    """Derive the truncation error of a kernel: smoothing and discretisation, exactly.

    \b
    sphtrunc derive --kernel cubic-spline
    sphtrunc derive --kernel wendland-c2 --dim 3 --lattice bcc --dx-over-h 1/2
    sphtrunc derive --kernel 'pos(2-q)^3 - 4*pos(1-q)^3' --dx-over-h 10/13 --format json
    sphtrunc derive --kernel wendland-c2 --dim 2 --dx-over-h 0.6 --jitter 0.05
    """
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
    )
    if jitter is not None:
        from sphtrunc.disorder import scattered

        result = scattered(result, jitter, distribution)
    render = {"text": result.to_text, "latex": result.to_latex, "json": result.to_json}
    emit(render[format_](), output)
