"""sphtrunc measure: the discrete sums themselves, on particles."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import click

from sphtrunc.cli import options
from sphtrunc.operators.h_rules import RULES
from sphtrunc.output import emit


@click.command(name="measure")
@options.kernel
@click.option(
    "--dim",
    type=click.IntRange(1, 3),
    help="Dimension; of a file: what it has to be.  [default: 1; of a file: its own]",
)
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
    type=click.Choice(RULES),
    help="Whose h a pair takes.  [default: scatter with --h-gradient, gather of a file]",
)
@options.wall
@options.wall_at
@options.wall_weight
@options.ghosts
@click.option(
    "--particles",
    metavar="FILE",
    help="Particles of a file instead, as `sphtrunc inspect` reads, or relaxed:glass,N=4096 (see"
    " relax).",
)
@click.option(
    "--at",
    type=click.Choice(("particles", "random")),
    default="particles",
    show_default=True,
    help="Targets: the particles, or points of space at random.",
)
@options.snapshot
@click.option("--allow-duplicates", is_flag=True, help="Take particles that coincide.")
@click.option("--h-over-lambda", metavar="X", help="Apply it to sinusoids of wavelength λ.")
@click.option("--direction", metavar="X,Y,Z", help="Of the sinusoids.  [default: first axis]")
@click.option(
    "--field",
    "spec",
    metavar="SPEC",
    help="sinusoid:h/λ, bump:width or 'polynomial:1 + 2 x^2 y' (lengths in h); of a file: values,"
    " density, pressure, velocity, ….",
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
    sphtrunc measure --kernel cubic-spline --particles snapshot.hdf5 --field pressure -o targets.csv
    sphtrunc measure --kernel cubic-spline --dx-over-h 1/2 --wall 1/4 --wall-at half-way \\
                     --ghosts mirror

    With -o NAME.csv or NAME.npz the figures are printed, and what was measured at every target is
    written to the file.
    """
    from sphtrunc.experiment.measuring import measure

    scene = _scene(given)
    field = _field(given, scene)
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
    output = given["output"]
    if output is not None and given["format_"] == "text" and output.endswith((".csv", ".npz")):
        from sphtrunc.experiment.targets import write

        write(result, scene, output)
        output = None
    emit(text, output)
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


def _scene(given: dict[str, Any]) -> Any:
    """The scene that the options ask for."""
    from sphtrunc.scenes.jittered import jittered
    from sphtrunc.scenes.lattice import lattice

    if given["particles"] is not None:
        for name in ("lattice", "dx_over_h", "jitter", "extent", "offset", "h_gradient", "wall"):
            if given[name] not in (None, "0"):
                option = name.replace("_", "-")
                raise ValueError(f"{option}: a file of particles has none; expected one or other")
        return _between(given, _read(given))
    for name in ("length", "period", "columns", "kind", "allow_duplicates"):
        if given[name] not in (None, False):
            option = {"length": "h", "kind": "type"}.get(name, name.replace("_", "-"))
            raise ValueError(f"{option}: belongs to --particles FILE; lattices have --dx-over-h")
    if given["dx_over_h"] is None:
        raise ValueError("dx-over-h: missing; expected a ratio such as 10/13, or --particles FILE")
    offset = given["offset"]
    made = lattice(
        given["dim"] or 1,
        given["lattice"],
        given["dx_over_h"],
        offset.split(",") if "," in offset else offset,
        volume=given["volume"] or "constant",
        extent=given["extent"],
    )
    if given["wall"] is not None:
        if given["wall"] == "eta":
            raise ValueError("wall: particles are somewhere; expected --wall with a distance in h")
        from sphtrunc.scenes.lattice import beside_wall

        made = beside_wall(
            made,
            given["wall"],
            at=given["wall_at"],
            ghosts=given["ghosts"],
            weight=given["wall_weight"],
        )
    elif given["wall_at"] or given["wall_weight"] or given["ghosts"] != "none":
        raise ValueError("wall-at, wall-weight, ghosts: need a wall; expected --wall η as well")
    if given["at"] == "random":
        if offset != "0":
            raise ValueError("at: random points have every offset; expected no --offset with them")
        if given["wall"] is not None or given["h_gradient"] is not None:
            raise ValueError(
                "at: random points go neither with --wall nor with --h-gradient; expected particles"
            )
        sigma = given["jitter"] or "0"
        return jittered(made, sigma, given["distribution"], given["seed"], anywhere=True)
    if given["jitter"] is None:
        if given["volume"] == "cell":
            raise ValueError("volume: cells of a lattice are Δx^d; expected constant, or --jitter")
        return _with_lengths(given, made)
    moved = jittered(made, given["jitter"], given["distribution"], given["seed"])
    return _with_lengths(given, moved)


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


def _read(given: dict[str, Any]) -> Any:
    """The particles of a file; what was decided about them is said on the terminal."""
    from sphtrunc.scenes.snapshots.formats import read

    if given["particles"].startswith("relaxed:"):
        return _relaxed(given)
    found = read(given["particles"], **options.read_as(given))
    scene = found.particles(
        volume=given["volume"],
        mode=given["h_rule"] or "gather",
        allow_duplicates=given["allow_duplicates"],
    )
    for note in found.notes:
        click.echo(f"note: {note}", err=True)
    if given["allow_duplicates"] and (duplicates := found.duplicates()):
        click.echo(f"warning: {duplicates}", err=True)
    if found.ignored:
        click.echo(f"note: columns {', '.join(found.ignored)} are not used", err=True)
    return scene


def _relaxed(given: dict[str, Any]) -> Any:
    """A glass made by its recipe; lengths in Δx."""
    from dataclasses import replace

    import numpy as np

    from sphtrunc.experiment.glasses import glass
    from sphtrunc.scenes.relaxed import recipe

    for name in ("period", "columns", "kind", "h_rule"):
        if given[name] is not None:
            option = {"kind": "type", "h_rule": "h-rule"}.get(name, name)
            raise ValueError(f"{option}: a relaxed scene has its own box and h; expected none")
    scene = glass(recipe(given["particles"])).particles
    h = options.positive("h", given["length"])
    if h is not None:
        scene = replace(scene, h=np.full(scene.population, h), _trees={})
    if given["volume"] in ("cell", "summation"):
        scene = replace(scene, given=None, volume=given["volume"], _trees={})
    return scene


def _field(given: dict[str, Any], scene: Any) -> Any:
    from sphtrunc.arithmetic.rational import exact
    from sphtrunc.experiment.fields import Values, field, sinusoid

    spec = given["spec"]
    if given["h_over_lambda"] is not None:
        if spec is not None:
            raise ValueError("field: got --field and --h-over-lambda, expected one of them")
        along = given["direction"]
        direction = along and [float(exact(n, "direction")) for n in along.split(",")]
        return sinusoid(given["h_over_lambda"], direction, scene.dim)
    if given["direction"] is not None:
        raise ValueError("direction: belongs to --h-over-lambda")
    known = getattr(scene, "fields", {})
    if spec in known:
        values = known[spec]
        return [Values(v) for v in values] if values.ndim == 2 else Values(values)
    if spec == "values":
        raise ValueError("field: no values in the file; expected a column 'values'")
    return None if spec is None else field(spec, scene.dim)


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
