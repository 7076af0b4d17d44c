"""sphtrunc kernels: the catalogue, with every constant derived."""

from __future__ import annotations

import json

import click

from sphtrunc.cli import options
from sphtrunc.kernels.catalogue import named, names
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.output import emit
from sphtrunc.version import __version__

#: the columns of the table
HEAD = ("kernel", "support", "β", "smooth", "σ", "W(0)", "∫s²W", "smoothing h²")


@click.command(name="kernels")
@options.dim
@click.option(
    "--pairing",
    is_flag=True,
    help="Also the number of neighbours from which particles pair (2D and 3D; takes minutes).",
)
@options.formats("text", "latex", "json")
@options.output
def command(dim: int, pairing: bool, format_: str, output: str | None) -> None:
    """List the kernels of the catalogue with their constants in the given dimension.

    σ is the normalisation of the shape as written, W(0) the kernel at the centre for h = 1, ∫s²W
    its second moment, and the last column c the leading smoothing error c h² ∇²A of a value.
    """
    if pairing and dim == 1:
        raise ValueError("pairing: is of particles in 2D and 3D; expected --dim 2 or 3")
    catalogue = [named(name) for name in names()]
    render = {"text": _text, "latex": _latex, "json": _json}
    emit(render[format_](catalogue, dim, pairing), output)


def row(kernel: Kernel, dim: int, pairing: bool = False) -> dict[str, object]:
    """What the table says of a kernel: its name, then a value for every other entry of HEAD."""
    sigma = kernel.normalisation(dim)
    second = kernel.moment(2, dim)
    values = {
        "name": kernel.name,
        "support": kernel.support,
        "boundary_smoothness": kernel.boundary_smoothness,
        "smoothness": kernel.smoothness,
        "normalisation": sigma,
        "w0": sigma * kernel.central(),
        "second_moment": second,
        "smoothing_coefficient": second / (2 * dim),
    }
    if pairing:
        from sphtrunc.study.pairing import pairing_limit

        values["pairing"] = pairing_limit(kernel, dim)
    return values


def _text(catalogue: list[Kernel], dim: int, pairing: bool) -> str:
    rows = [(*HEAD, "pairs from") if pairing else HEAD]
    for kernel in catalogue:
        name, *values = row(kernel, dim, pairing).values()
        rows.append((str(name), *(short(v) for v in values)))  # type: ignore[arg-type]
    widths = [max(len(cells[i]) for cells in rows) for i in range(len(rows[0]))]
    lines = [
        f"{cells[0]:<{widths[0]}}  "
        + "  ".join(f"{c:>{w}}" for c, w in zip(cells[1:], widths[1:], strict=True))
        for cells in rows
    ]
    return "\n".join(
        [
            f"Kernels in {dim}D: W(r, h) = σ h^-{dim} w(r/h); ≈ where the fraction is long",
            *lines,
        ]
    )


def _latex(catalogue: list[Kernel], dim: int, pairing: bool) -> str:
    from sympy import latex

    head = (
        r"kernel & $\kappa$ & $\beta$ & smoothness & $\sigma$ & $W(0)$"
        r" & $\int s^2 \hat W$ & $c$"
    )
    lines = []
    for kernel in catalogue:
        name, *values = row(kernel, dim, pairing).values()
        shown = ["--" if v is None else f"${latex(v)}$" for v in values]
        lines.append(" & ".join([str(name), *shown]) + r" \\")
    more = " & pairs from" if pairing else ""
    columns = "l" + "r" * (7 + pairing)
    top = rf"\begin{{tabular}}{{{columns}}}"
    return "\n".join([top, rf"{head}{more} \\ \hline", *lines, r"\end{tabular}"])


def _json(catalogue: list[Kernel], dim: int, pairing: bool) -> str:
    rows = [
        {
            **{
                k: v if v is None or isinstance(v, int | float | str) else str(v)
                for k, v in row(kernel, dim, pairing).items()
            },
            "source": kernel.source,
        }
        for kernel in catalogue
    ]
    return json.dumps(
        {"schema": "sphtrunc.kernels/1", "dim": dim, "kernels": rows, "version": __version__},
        indent=1,
        ensure_ascii=False,
    )


def short(value: object) -> str:
    """An exact value in at most 14 characters, else its first nine digits."""
    if value is None or isinstance(value, float):
        return "none" if value is None else f"{value:.4f}"
    text = str(value).replace("*", "·").replace("pi", "π")
    return text if len(text) <= 14 else f"≈{float(value):.9g}"  # type: ignore[arg-type]
