"""sphtrunc convert: h/Δx in every convention."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.kernels.conventions import CONVENTIONS, convert
from sphtrunc.output import emit
from sphtrunc.version import __version__


def _quantities(function: Callable[..., Any]) -> Callable[..., Any]:
    for name, data in reversed(CONVENTIONS.items()):
        function = click.option(f"--{name}", metavar="X", help=f"{data.says} ({data.who}).")(
            function
        )
    return function


@click.command(name="convert")
@options.kernel
@options.dim
@_quantities
@click.option(
    "--dx", metavar="X", default="1", help="Particle spacing, the unit of h, κh, 2σ, FWHM."
)
@click.option(
    "--pairing", is_flag=True, help="Say from how many neighbours particles pair, too (2D, 3D)."
)
@options.formats("text", "json")
@options.output
def command(
    kernel: str,
    dim: int,
    dx: str,
    pairing: bool,
    format_: str,
    output: str | None,
    **given: str | None,
) -> None:
    """Convert between the conventions for the smoothing length and the number of neighbours.

    Give one of them; numbers are taken exactly (1.2 is 6/5).

    \b
    sphtrunc convert --kernel cubic-spline --dim 3 --hfact 1.2
    sphtrunc convert --kernel wendland-c2 --dim 3 --neighbours 100
    sphtrunc convert --kernel cubic-spline --dim 2 --h 0.013 --dx 0.01 --format json
    """
    known = {name: value for name, value in given.items() if value is not None}
    if len(known) != 1:
        shown = ", ".join(f"--{name}" for name in CONVENTIONS)
        raise click.UsageError(f"got {len(known)} quantities, expected exactly one of {shown}")
    result = convert(kernel, dim, dx=dx, **known)
    limit = _limit(result.kernel, dim) if pairing else None
    if format_ == "text":
        said = [_pairing(float(result["neighbours"]), limit)] if pairing else []
        emit("\n".join([result.to_text(dx), *said]), output)
        return
    document = {
        "schema": "sphtrunc.convert/1",
        "kernel": result.kernel.name,
        "dim": dim,
        "dx": dx,
        "conventions": result.to_dict(dx),
        "version": __version__,
    }
    if pairing:
        document["pairing"] = limit
    emit(json.dumps(document, indent=1, ensure_ascii=False), output)


def _limit(kernel: Any, dim: int) -> float | None:
    """The number of neighbours from which particles pair; None where they do not."""
    from sphtrunc.study.pairing import pairing_limit

    if dim == 1:
        raise ValueError("pairing: is of particles in 2D and 3D; expected --dim 2 or 3")
    return pairing_limit(kernel, dim)


def _pairing(neighbours: float, limit: float | None) -> str:
    if limit is None:
        return "  no pairing at any number of neighbours up to 1000"
    side = "beyond that" if neighbours >= limit else "this is below"
    return f"  particles pair from {limit:.6g} neighbours on: {side}"
