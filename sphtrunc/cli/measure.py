"""sphtrunc measure: the discrete sums themselves, on particles."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="measure")
@options.kernel
@options.dim
@options.estimate
@options.lattice
@options.dx_over_h
@options.offset
@options.jitter
@options.distribution
@click.option(
    "--extent",
    type=int,
    help="Particles along each axis of the scene.  [default: 10^6, 10^4, 10^3 in 1D, 2D, 3D]",
)
@click.option(
    "--volume",
    type=click.Choice(("constant", "cell", "summation")),
    help="Volume of a particle: Δx^d, half-way to the neighbours (1D), or m/ρ.",
)
@click.option("--h-gradient", metavar="G", help="dh/dx, one number or gx,gy,gz: h(x) = h + G·x.")
@click.option(
    "--h-rule",
    type=click.Choice(("gather", "scatter", "mean")),
    help="Whose h a pair takes.  [default: scatter with --h-gradient, gather of a file]",
)
@options.wall_number
@options.wall_at
@options.wall_weight
@options.ghosts
@click.option(
    "--particles",
    metavar="FILE",
    help="Particles from .npz, .csv or .npy instead, or relaxed:glass,N=4096 (see relax).",
)
@click.option(
    "--at",
    type=click.Choice(("particles", "random")),
    default="particles",
    show_default=True,
    help="Targets: the particles, or points of space at random.",
)
@click.option("--h", "length", metavar="H", help="Smoothing length, if the file has none.")
@click.option("--period", metavar="L", help="Side of a periodic box, L or Lx,Ly,Lz.")
@click.option("--h-over-lambda", metavar="X", help="Apply it to sinusoids of wavelength λ.")
@click.option("--direction", metavar="X,Y,Z", help="Of the sinusoids.  [default: first axis]")
@click.option(
    "--field",
    "spec",
    metavar="SPEC",
    help="sinusoid:h/λ, bump:width or 'polynomial:1 + 2 x^2 y' (lengths in h); values (of a file).",
)
@click.option("--moments", type=int, metavar="K", help="Measure discrete moments up to degree K.")
@click.option("--targets", metavar="N", help="How many targets, or all.")
@click.option("--rtol", type=float, help="As many targets as make the error known to this part.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of everything random.")
@click.option(
    "--precision",
    type=click.Choice(("plain", "compensated", "extended", "exact")),
    default="plain",
    show_default=True,
    help="How terms and sums are evaluated.",
)
@click.option("--bound", is_flag=True, help="Bound the rounding error rigorously.")
@click.option("--workers", type=int, help="Threads; results do not depend on it.")
@click.option("--no-predict", is_flag=True, help="Leave out what theory predicts.")
@options.formats("text", "json", "csv")
@options.output
def command(**given: Any) -> int:
    """Measure the truncation error of an SPH sum on particles.

    \b
    sphtrunc measure --kernel cubic-spline --dx-over-h 10/13
    sphtrunc measure --kernel wendland-c2 --dim 3 --dx-over-h 0.6 --jitter 0.2 \\
                     --correction csph --form difference --h-over-lambda 0.02 --rtol 0.01
    sphtrunc measure --kernel cubic-spline --particles snapshot.npz --field values
    sphtrunc measure --kernel cubic-spline --dx-over-h 1/2 --wall 1/4 --wall-at half-way \\
                     --ghosts mirror
    """
    from sphtrunc.experiment.measuring import measure

    scene, values = _scene(given)
    field = _field(given, scene.dim, values)
    result = measure(
        scene,
        given["kernel"],
        given["operator"],
        field,
        form=given["form"],
        correction=given["correction"],
        moments=given["moments"],
        targets=_targets(given["targets"]),
        rtol=given["rtol"],
        seed=given["seed"],
        precision=given["precision"],
        bound=given["bound"],
        workers=given["workers"],
        progress=_bar(),
    )
    render = {"text": result.to_text, "json": result.to_json, "csv": result.to_csv}
    text = render[given["format_"]]()
    if not given["no_predict"] and given["format_"] != "csv":
        text = _predicted(given, result, scene, field, text)
    emit(text, given["output"])
    return 130 if result.interrupted else 0


def _predicted(given: dict[str, Any], result: Any, scene: Any, field: Any, text: str) -> str:
    """The rendered measurement with its prediction."""
    from sphtrunc.operators.operator import Operator
    from sphtrunc.study.comparison import beside, beside_text

    operator = Operator(given["operator"], given["form"], given["correction"])
    found = beside(result, scene, given["kernel"], operator, field)
    if given["format_"] == "text":
        return f"{text}\n{beside_text(found)}"
    data = {**json.loads(text), "predicted": found}
    return json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)


def _scene(given: dict[str, Any]) -> tuple[Any, Any]:
    """The scene that the options ask for, and the values that came with the particles."""
    from sphtrunc.scenes.jittered import jittered
    from sphtrunc.scenes.lattice import lattice

    if given["particles"] is not None:
        for name in ("lattice", "dx_over_h", "jitter", "extent", "offset", "h_gradient", "wall"):
            if given[name] not in (None, "0"):
                option = name.replace("_", "-")
                raise ValueError(f"{option}: a file of particles has none; expected one or other")
        home, values = _read(given)
        return _between(given, home), values
    for name, option in (("length", "h"), ("period", "period")):
        if given[name] is not None:
            raise ValueError(f"{option}: belongs to --particles FILE; lattices have --dx-over-h")
    if given["dx_over_h"] is None:
        raise ValueError("dx-over-h: missing; expected a ratio such as 10/13, or --particles FILE")
    offset = given["offset"]
    made = lattice(
        given["dim"],
        given["lattice"],
        given["dx_over_h"],
        offset.split(",") if "," in offset else offset,
        volume=given["volume"] or "constant",
        extent=given["extent"],
    )
    if given["wall"] is not None:
        from sphtrunc.scenes.lattice import beside_wall

        made = beside_wall(
            made,
            given["wall"],
            at=given["wall_at"],
            ghosts=given["ghosts"],
            weight=given["wall_weight"],
        )
    elif given["wall_at"] or given["wall_weight"] or given["ghosts"] != "none":
        raise ValueError("wall-at, wall-weight, ghosts: belong to a wall; expected --wall η as well")
    if given["at"] == "random":
        if offset != "0":
            raise ValueError("at: random points have every offset; expected no --offset with them")
        if given["wall"] is not None or given["h_gradient"] is not None:
            raise ValueError(
                "at: random points go neither with --wall nor with --h-gradient; expected particles"
            )
        sigma = given["jitter"] or "0"
        return jittered(made, sigma, given["distribution"], given["seed"], anywhere=True), None
    if given["jitter"] is None:
        if given["volume"] == "cell":
            raise ValueError("volume: cells of a lattice are Δx^d; expected constant, or --jitter")
        return _with_lengths(given, made), None
    moved = jittered(made, given["jitter"], given["distribution"], given["seed"])
    return _with_lengths(given, moved), None


def _with_lengths(given: dict[str, Any], scene: Any) -> Any:
    """The scene with the gradient of h that the options ask for."""
    slope = given["h_gradient"]
    if slope is None:
        if given["h_rule"] is not None:
            raise ValueError("h-rule: nothing varies; expected --h-gradient G, or a file with h")
        return scene
    from sphtrunc.scenes.smoothing_lengths import sloped

    return sloped(scene, slope.split(",") if "," in slope else slope, given["h_rule"] or "scatter")


def _between(given: dict[str, Any], home: Any) -> Any:
    """The particles, or points between them."""
    from sphtrunc.scenes.probes import POINTS, probes

    if given["at"] == "particles":
        return home
    count = _targets(given["targets"])
    given["targets"] = None
    return probes(home, count if isinstance(count, int) else POINTS, given["seed"])


def _read(given: dict[str, Any]) -> tuple[Any, Any]:
    """Particles from a file: .npy (x), .npz (x, h, volume, mass, density, values) or .csv with a
    header of x, y, z, h, volume, mass, density, values."""
    from sphtrunc.scenes.files import read
    from sphtrunc.scenes.particles import particles

    if given["particles"].startswith("relaxed:"):
        return _relaxed(given), None
    columns: dict[str, Any] = dict(read(given["particles"]))
    values = columns.pop("values", None)
    h = columns.pop("h", None)
    if given["length"] is not None:
        from sphtrunc.arithmetic.rational import exact

        h = float(exact(given["length"], "h"))
    if h is None:
        raise ValueError("h: the file has no smoothing length; expected --h H")
    if given["volume"] is not None:
        columns = {"x": columns["x"], "volume": given["volume"]}
    period = None
    if given["period"] is not None:
        from sphtrunc.arithmetic.rational import exact

        sides = [float(exact(side, "period")) for side in given["period"].split(",")]
        period = sides if len(sides) > 1 else sides[0]
    if given["volume"] == "constant":
        columns["volume"] = _share(columns["x"], period)
    mode = given["h_rule"] or "gather"
    return particles(columns.pop("x"), h=h, period=period, mode=mode, **columns), values


def _share(x: Any, period: Any) -> float:
    """The volume of the box over the number of particles."""
    import numpy as np

    if period is None:
        raise ValueError("volume: constant is that of the box over the number; expected a period")
    n, dim = len(x), 1 if np.ndim(x) == 1 else np.shape(x)[1]
    return float(np.prod(np.broadcast_to(period, (dim,)))) / n


def _relaxed(given: dict[str, Any]) -> Any:
    """A glass made by its recipe; lengths in Δx."""
    from dataclasses import replace

    import numpy as np

    from sphtrunc.arithmetic.rational import exact
    from sphtrunc.experiment.relaxation import glass
    from sphtrunc.scenes.relaxed import recipe

    if given["period"] is not None:
        raise ValueError("period: a relaxed scene has its own box; expected no --period")
    scene = glass(recipe(given["particles"])).particles
    if given["length"] is not None:
        h = float(exact(given["length"], "h"))
        scene = replace(scene, h=np.full(scene.population, h), _trees={})
    if given["volume"] in ("cell", "summation"):
        scene = replace(scene, given=None, volume=given["volume"], _trees={})
    return scene


def _field(given: dict[str, Any], dim: int, values: Any) -> Any:
    from sphtrunc.arithmetic.rational import exact
    from sphtrunc.experiment.fields import Values, field, sinusoid

    spec = given["spec"]
    if given["h_over_lambda"] is not None:
        if spec is not None:
            raise ValueError("field: got --field and --h-over-lambda, expected one of them")
        along = given["direction"]
        direction = along and [float(exact(n, "direction")) for n in along.split(",")]
        return sinusoid(given["h_over_lambda"], direction, dim)
    if given["direction"] is not None:
        raise ValueError("direction: belongs to --h-over-lambda")
    if spec == "values":
        if values is None:
            raise ValueError("field: no values in the file; expected a column 'values'")
        return [Values(v) for v in values.T] if values.ndim == 2 else Values(values)
    return None if spec is None else field(spec, dim)


def _targets(text: str | None) -> Any:
    if text is None or text == "all":
        return text
    if not text.isascii() or not text.isdigit() or len(text) > 12:
        raise ValueError(f"targets: got {text[:40]!r}, expected a number or all")
    return int(text)


def _bar() -> Callable[[int, int], None] | None:
    """A progress bar on a terminal, for runs of more than a second; none in a pipe."""
    if not sys.stderr.isatty():
        return None
    started = time.monotonic()
    bar: Any = None

    def update(done: int, expected: int) -> None:
        nonlocal bar
        if bar is None:
            if time.monotonic() - started < 1.0 or done >= expected:
                return
            bar = click.progressbar(length=expected, label="targets", file=sys.stderr)
        bar.length = expected
        bar.update(done - bar.pos)
        if done >= expected:
            bar.render_finish()

    return update
