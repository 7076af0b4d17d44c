"""sphtrunc sweep: the product of lists of options of measure, resumably."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import click

from sphtrunc.cli import running
from sphtrunc.output import emit
from sphtrunc.study.sweep import AXES, NUMERIC, Study, sweep, to_csv, values

_HELP = {
    "kernel": "A name, formula or file, as for derive; repeat it for several.",
    "dim": "Dimension.",
    "particles": "relaxed:glass,N=1024 or another recipe, for a lattice; repeat it for several.",
    "lattice": "uniform; square, hexagonal; cubic, bcc, fcc, hcp.",
    "dx-over-h": "Particle spacing over smoothing length.",
    "offset": "Position of the lattice relative to the target, in Δx; 'x y z' in space.",
    "jitter": "Random displacement σ/Δx.",
    "distribution": "gaussian, uniform or blue.",
    "volume": "constant, cell or summation.",
    "wall": "A plane wall or free surface, at these distances from the target in h.",
    "wall-at": "Where the lattice has it: particle, half-way, P/Q steps before the first plane.",
    "wall-weight": "What part of a particle on the wall counts.",
    "ghosts": "Beyond the wall: none, mirror, odd or dummy.",
    "operator": "name, name/form or name/form/correction, as gradient/difference/csph.",
    "form": "standard, difference, symmetric, paired, direct, brookshaw, fatehi-manzari, nested.",
    "correction": "none, shepard, csph, csph-shepard, rkpm-1 to rkpm-3.",
    "h-over-lambda": "Smoothing length over wavelength.",
}


_WHOLE = ("kernel", "particles")  # whose values hold commas


def _axes(function: Callable[..., Any]) -> Callable[..., Any]:
    for name in reversed(AXES):
        decorate = click.option(
            f"--{name}",
            multiple=True,
            metavar="SPEC" if name in _WHOLE else "LIST",
            help=f"{_HELP[name]}  [default: {AXES[name] or 'that of measure'}]",
        )
        function = decorate(function)
    return function


@click.command(name="sweep")
@_axes
@click.option("--targets", type=int, metavar="N", help="Targets of every disordered scene; or")
@click.option("--rtol", type=float, help="as many as make every rms known to this part. [0.02]")
@click.option("--seed", type=int, default=0, show_default=True, help="Of everything random.")
@click.option("--no-predict", is_flag=True, help="Leave the predictions out.")
@click.option("--workers", type=click.IntRange(1, 1024), default=1, help="Processes.  [default: 1]")
@click.option("--dask", metavar="HOST:PORT", help="Workers of this Dask scheduler instead.")
@click.option("-o", "--output", metavar="FILE", help="A .csv, .jsonl or .nc file.")
def command(
    targets: int | None,
    rtol: float | None,
    seed: int,
    no_predict: bool,
    workers: int,
    dask: str | None,
    output: str | None,
    **axes: tuple[str, ...],
) -> None:
    """Measure the error at every combination of the options, predictions beside.

    LIST is a,b,c or, for numbers, a range: first:last:n, or first:last:nlog in the logarithm.
    Stopped, in whatever way, the same command continues; the table is the same to the byte.

    \b
    sphtrunc sweep --h-over-lambda 1e-3:0.3:9log --dx-over-h 0.2,4/11 --jitter 0,0.05 -o table.csv
    sphtrunc sweep --wall 0:2:9 --wall-at half-way --ghosts none,mirror -o profile.csv
    sphtrunc sweep --kernel cubic-spline --kernel wendland-c2 --dim 3 --dx-over-h 0.7 \\
                   --operator gradient/standard,gradient/difference/csph --workers 2 -o table.csv
    """
    if targets is None and rtol is None:
        rtol = 0.02
    study = Study(
        axes={
            name: _values(name, given) for name in AXES if (given := axes[name.replace("-", "_")])
        },
        rtol=rtol,
        targets=targets,
        seed=seed,
        predict=not no_predict,
    )
    with ExitStack() as stack:
        executor = None if dask is None else stack.enter_context(running.dask(dask, stack))
        try:
            rows = sweep(
                study,
                output,
                executor=executor,
                workers=workers,
                progress=running.bar(stack, "scenes"),
            )
        except KeyboardInterrupt:
            kept = (
                "" if output is None else f"; {output}.journal keeps what is done, repeat to go on"
            )
            click.echo(f"interrupted{kept}", err=True)
            sys.exit(130)
    if output is None:
        emit(to_csv(rows).rstrip("\n"), None)


def _values(name: str, given: tuple[str, ...]) -> tuple[str, ...]:
    """All values of an axis; what may hold commas is one value each."""
    if name in _WHOLE:
        return given
    try:
        return tuple(v for text in given for v in values(text, name in NUMERIC))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
