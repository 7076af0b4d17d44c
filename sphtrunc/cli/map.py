"""sphtrunc map: where in the particles of a file the sums are wrong, by how much, and why."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Any

import click

from sphtrunc.cli import options, running
from sphtrunc.output import emit


@click.command(name="map")
@click.argument("file", metavar="FILE")
@click.option(
    "--kernel",
    "-k",
    metavar="SPEC",
    help="As for `sphtrunc measure`.  [default: the one that made the densities of the file]",
)
@click.option(
    "--support-over-h",
    metavar="X",
    help="Support in units of the h of the file.  [default: that of the kernel as written here]",
)
@click.option(
    "--estimate",
    "estimates",
    multiple=True,
    metavar="OPERATOR/FORM/CORRECTION",
    help="Which sums, such as gradient/difference/csph; again for more.  [default: four gradients]",
)
@click.option("--degree", type=int, default=2, show_default=True, help="Of the moments.")
@click.option(
    "--field", "names", multiple=True, metavar="NAME", help="Expected errors of this field too."
)
@click.option("--targets", type=int, metavar="N", help="So many, drawn at random.  [default: all]")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the targets drawn.")
@click.option("--workers", type=int, help="Threads; results do not depend on it.")
@click.option(
    "--memory",
    metavar="SIZE",
    help="Take slabs whose sums fit into this, such as 512MB, one after the other into the output;"
    " stopped, the same command continues.  [default: all at once]",
)
@click.option(
    "--processes", type=click.IntRange(1, 1024), help="Slabs side by side in so many processes."
)
@click.option("--dask", metavar="HOST:PORT", help="Workers of this Dask scheduler instead.")
@options.dim_of_file
@options.snapshot
@click.option("--allow-duplicates", is_flag=True, help="Take particles that coincide.")
@click.option("--picture", metavar="FILE", help="Draw it: .png, .svg or .pdf.")
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="All of it: .npz, .csv, .hdf5, .vtp; .json: the summary.",
)
@options.formats("text", "json")
def command(**given: Any) -> None:
    """Map the truncation error over the particles of a file: the moments of every sum at every one.

    \b
    sphtrunc map snapshot_010.hdf5 -o map.vtp --picture map.png
    sphtrunc map particles.csv --kernel wendland-c2 --estimate gradient/difference/csph \\
                 --field pressure -o map.npz
    sphtrunc map large.hdf5 --memory 2GB --processes 4 -o map.hdf5
    """
    from sphtrunc.scenes.snapshots.formats import read
    from sphtrunc.study.snapshots.error_map import DEFAULT, error_map

    found = read(given["file"], **options.read_as(given))
    for note in found.notes:
        click.echo(f"note: {note}", err=True)
    if given["allow_duplicates"] and (duplicates := found.duplicates()):
        click.echo(f"warning: {duplicates}", err=True)
    kernel, h = _kernel(given, found)
    scene = found.particles(h=h, allow_duplicates=given["allow_duplicates"])
    fields: dict[str, Any] = {}
    for name in given["names"]:
        if name not in found.fields:
            known = ", ".join(found.fields)
            raise ValueError(f"field: the file has no {name[:40]}; there are {known}")
        values = found.fields[name]
        rows = [values] if values.ndim == 1 else list(values)
        for row, axis in zip(rows, found.axes if len(rows) > 1 else ("",), strict=False):
            fields[f"{name}.{axis}" if axis else name] = row
    options_: dict[str, Any] = {
        "degree": given["degree"],
        "fields": fields,
        "targets": given["targets"],
        "seed": given["seed"],
        "workers": given["workers"],
    }
    estimates = [_operator(text) for text in given["estimates"]] or DEFAULT
    with ExitStack() as stack:
        if any(given[name] is not None for name in ("memory", "processes", "dask")):
            result = _in_slabs(given, scene, kernel, estimates, options_, stack)
        else:
            result = error_map(scene, kernel, estimates, **options_)
            if given["output"] is not None:
                from sphtrunc.study.snapshots.map_files import write

                write(result, given["output"])
        if given["picture"] is not None:
            from sphtrunc.figures.maps import draw

            draw(result, given["picture"])
        emit(result.to_json() if given["format_"] == "json" else result.to_text(), None)


def _in_slabs(
    given: dict[str, Any],
    scene: Any,
    kernel: Any,
    estimates: Any,
    options_: dict[str, Any],
    stack: ExitStack,
) -> Any:
    """The map, slab by slab into the output."""
    from sphtrunc.study.snapshots.slabs import MEMORY, map_in_slabs

    output, address = given["output"], given["dask"]
    if output is None:
        raise ValueError("memory: slabs go into a file; expected -o FILE")
    if given["processes"] is not None and given["workers"] is None:
        options_["workers"] = 1
    try:
        return stack.enter_context(
            map_in_slabs(
                scene,
                kernel,
                estimates,
                output=output,
                memory=MEMORY if given["memory"] is None else running.memory(given["memory"]),
                processes=given["processes"] or 1,
                executor=None if address is None else running.dask(address, stack),
                progress=running.bar(stack, "slabs"),
                **options_,
            )
        )
    except KeyboardInterrupt:
        kept = f"{output}.journal and .slabs keep what is done, repeat to go on"
        click.echo(f"interrupted; {kept}", err=True)
        sys.exit(130)


def _kernel(given: dict[str, Any], found: Any) -> tuple[Any, Any]:
    """The kernel, and h of the particles as that kernel means it."""
    from sphtrunc.kernels.parse import kernel as parse_kernel

    h = found.fields.get("h")
    ratio = options.positive("support-over-h", given["support_over_h"])
    name = given["kernel"]
    if name is None:
        from sphtrunc.study.snapshots.saved_sums import identify_density

        if h is None:
            raise ValueError("kernel: the file has no h to identify it by; expected --kernel, --h")
        pair = identify_density(found, found.particles(allow_duplicates=True))
        if pair is None or not pair.fits:
            raise ValueError(
                "kernel: the densities of the file do not tell which it is (see `sphtrunc"
                " inspect`); expected --kernel"
            )
        name, ratio = pair.best.kernel, ratio or pair.best.support_over_h
        click.echo(f"note: kernel {name}, support {ratio:.7g} h, from the densities", err=True)
    kernel = parse_kernel(name)
    if h is None or ratio is None:
        return kernel, h
    return kernel, h * (ratio / float(kernel.support))


def _operator(text: str) -> Any:
    from sphtrunc.operators.operator import Operator

    parts = text.split("/")
    if len(parts) > 3:
        raise ValueError(f"estimate: got {text[:60]!r}, expected operator/form/correction")
    name, form, correction = [*parts, "", ""][:3]
    return Operator(name, form or None, correction or "none")
