"""sphtrunc structure: the structure factor of particles."""

from __future__ import annotations

import json
from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit
from sphtrunc.version import __version__


@click.command(name="structure")
@click.argument("particles", metavar="FILE")
@click.option(
    "--period", metavar="L", help="Box in place of the file's: L or Lx,Ly,Lz; none: no period."
)
@click.option("--columns", metavar="Q=NAME,…", help="What columns hold, as for measure.")
@click.option("--type", "kind", metavar="TYPE", help="Which particles of a file.")
@click.option(
    "--reach", type=float, metavar="K", help="Up to kΔx = K.  [default: 40, 16, 10 in 1D, 2D, 3D]"
)
@click.option("--bins", type=click.IntRange(4, 1000), default=40, show_default=True, help="Shells.")
@click.option(
    "--local",
    metavar="N",
    help="S in sub-boxes too, N along each axis or N,M,…, where the density varies slowly.",
)
@options.formats("text", "json", "csv")
@options.output
def command(particles: str, **given: Any) -> None:
    """S(k) of particles in a file, shell by shell, with its exponent and plateau at long waves.

    FILE is a snapshot or a table, or a recipe such as relaxed:glass,N=4096 (see relax).

    \b
    sphtrunc structure glass.npz --period 1
    sphtrunc structure glass.npz --period 1,1,2 --format json -o structure.json
    """
    from sphtrunc.study.structure import local_structure, structure_factor

    if given["local"] is not None and given["format_"] == "csv":
        raise ValueError("local: a table has one S(k); expected --format text or json")
    home = scene(particles, given["period"], given["columns"], given["kind"])
    factor = structure_factor(home, reach=given["reach"])
    k, S, error = factor.radial(given["bins"])
    render = {"text": _text, "json": _json, "csv": _csv}[given["format_"]]
    text = render(factor, k, S, error)
    if given["local"] is not None:
        places = local_structure(home, _parts(given["local"], home.dim), reach=given["reach"])
        text = _with_places(text, places, given["bins"], given["format_"])
    emit(text, given["output"])


def _parts(text: str, dim: int) -> list[int]:
    """How many sub-boxes along each axis."""
    counts = text.split(",")
    if len(counts) not in (1, dim) or not all(
        c.isascii() and c.isdigit() and 0 < int(c) < 10_000 for c in counts
    ):
        raise ValueError(f"local: got {text[:40]!r}, expected a whole number, or {dim} of them")
    return [int(c) for c in counts] * (dim if len(counts) == 1 else 1)


def _with_places(text: str, places: Any, bins: int, form: str) -> str:
    """The report with what is found in each sub-box."""
    if form == "json":
        document = json.loads(text)
        document["local"] = [_place(one, bins) for one in places]
        return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    lines = ["In sub-boxes, each in its own Δx: particles, Δx, mean of S at long waves, exponent"]
    for one in places:
        fit = one.factor.fit()
        where = ", ".join(f"{x:.4g}" for x in one.low)
        exponent = (
            "  –" if fit.exponent is None else f"{fit.exponent:.2f} ± {fit.exponent_error:.2f}"
        )
        lines.append(
            f"  from ({where}): {one.factor.particles:>7} {one.spacing:>9.4f}"
            f" {fit.plateau:>11.3e}  {exponent}"
        )
    return "\n".join([text, *lines])


def _place(one: Any, bins: int) -> dict[str, Any]:
    return {
        "low": one.low.tolist(),
        "size": one.size.tolist(),
        "particles": one.factor.particles,
        "dx": one.spacing,
        **_curve(one.factor.fit(), *one.factor.radial(bins)),
    }


def _curve(fit: Any, k: Any, S: Any, error: Any) -> dict[str, Any]:
    """S(k) with its errors, and what is fitted to it."""
    return {
        "k_dx": k.tolist(),
        "S": S.tolist(),
        "error": error.tolist(),
        "exponent": fit.exponent,
        "exponent_error": fit.exponent_error,
        "plateau": fit.plateau,
        "plateau_error": fit.plateau_error,
    }


def scene(
    source: str, period: str | None, columns: str | None = None, kind: str | None = None
) -> Any:
    """The particles of a file or of a recipe, of which only the places count."""
    from sphtrunc.scenes.relaxed import PREFIX

    if source.startswith(PREFIX):
        from sphtrunc.experiment.glasses import glass
        from sphtrunc.scenes.relaxed import recipe

        for name, value in (("period", period), ("columns", columns), ("type", kind)):
            if value is not None:
                raise ValueError(f"{name}: belongs to a file; a relaxed scene has its own box")
        return glass(recipe(source)).particles
    from sphtrunc.scenes.snapshots.columns import chosen
    from sphtrunc.scenes.snapshots.formats import read

    found = read(
        source,
        type=kind,
        columns=None if columns is None else chosen(columns),
        period=options.period(period),
    )
    for note in found.notes:
        click.echo(f"note: {note}", err=True)
    return found.particles(h=1.0)


def _json(factor: Any, k: Any, S: Any, error: Any) -> str:
    fit = factor.fit()
    document = {
        "schema": "sphtrunc.structure/1",
        "by": factor.by,
        "dim": factor.dim,
        "particles": factor.particles,
        "modes": int(factor.k.shape[1]),
        **_curve(fit, k, S, error),
        "fitted_up_to_k_dx": fit.upto,
        "fitted_modes": fit.modes,
        "directions": [{"ratio": value, "error": spread} for value, spread in factor.directions()],
        "anisotropic": factor.anisotropic,
        "blur": None if factor.blur is None else factor.blur.tolist(),
        "version": __version__,
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)


def _csv(factor: Any, k: Any, S: Any, error: Any) -> str:
    rows = (f"{a!r},{b!r},{c!r}" for a, b, c in zip(*map(_floats, (k, S, error)), strict=True))
    return "\n".join(["k_dx,S,error", *rows])


def _floats(values: Any) -> list[float]:
    return [float(v) for v in values]


def _text(factor: Any, k: Any, S: Any, error: Any) -> str:
    fit = factor.fit()
    lines = [
        f"S(k) of {factor.particles} particles in {factor.dim}D, {factor.by}:"
        f" {factor.k.shape[1]} modes up to kΔx = {factor.reach:g}",
    ]
    if factor.blur is not None:
        blur = ", ".join(f"{v:.2g}" for v in factor.blur)
        lines.append(
            f"  a free set: smeared over kΔx = {blur}; edges and gradients of density show as a"
            " rise to small k"
        )
    over = f"over {fit.modes} modes up to kΔx = {fit.upto:.3g}"
    if fit.exponent is None:
        lines.append(f"Long waves, {over}: S = {fit.plateau:.3g}, no exponent")
    else:
        lines.append(
            f"Long waves, {over}: S ∝ k^{fit.exponent:.2f} (± {fit.exponent_error:.2f}), mean"
            f" {fit.plateau:.4g} (± {fit.plateau_error:.1g})"
        )
    if factor.anisotropic:
        shown = ", ".join(f"{value:.3f} ± {spread:.3f}" for value, spread in factor.directions())
        lines.append(f"Not the same in all directions: along the axes {shown} of the mean")
    lines.append("        kΔx             S         error")
    rows = zip(k, S, error, strict=True)
    lines += [f"{a:>11.4f}  {b:>12.5e}  {c:>12.2e}" for a, b, c in rows]
    return "\n".join(lines)
