"""sphtrunc tune: which h and Δx to take."""

from __future__ import annotations

import json
from textwrap import wrap
from typing import Any

import click

from sphtrunc import __version__
from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="tune")
@click.option(
    "--kernel",
    "-k",
    "kernels",
    multiple=True,
    required=True,
    metavar="SPEC",
    help="As for derive; repeat it to compare several at equal cost.",
)
@options.dim
@options.estimate
@click.option("--lattice", metavar="KIND", help="Which lattice is disordered.")
@click.option("--jitter", type=float, default=0.0, help="Disorder σ/Δx.  [default: 0]")
@click.option("--error", type=float, help="Wanted: this relative error at λ, at the least cost.")
@click.option("--particles-per-wavelength", type=float, metavar="N", help="Given: λ/Δx.")
@click.option("--particles", type=float, metavar="N", help="Given: particles in the box.")
@click.option("--pairs", type=float, metavar="N", help="Given: pairs in a volume λ^d.")
@click.option("--seconds", type=float, metavar="T", help="Given: time of a step over the box.")
@click.option(
    "--pairs-per-second", type=float, default=2e8, help="Speed of the code.  [default: 2e8]"
)
@click.option("--box", type=float, default=1.0, help="Side of the box in λ.  [default: 1]")
@click.option(
    "--now",
    metavar="NAME=X",
    help="The present setting, in any convention of convert: hdx=1.2, neighbours=57, eta=1.23 …",
)
@click.option("--table", metavar="FILE", help="Explain runs: a CSV of dx (or n), h and error.")
@click.option("--wavelength", type=float, default=1.0, help="λ in the unit of the table.")
@options.formats("text", "json")
@options.output
def command(**given: Any) -> None:
    """Recommend Δx/h and h/λ, with the predicted parts of the error and what they cost.

    \b
    sphtrunc tune --kernel wendland-c2 --dim 3 --jitter 0.1 --particles-per-wavelength 20
    sphtrunc tune --kernel cubic-spline --kernel wendland-c4 --dim 2 --jitter 0.05 --error 0.01 \\
                  --form difference --correction csph
    sphtrunc tune --kernel cubic-spline --dim 3 --jitter 0.1 --particles-per-wavelength 20 \\
                  --now hdx=1.2
    sphtrunc tune --kernel cubic-spline --jitter 0.05 --table runs.csv --wavelength 0.1
    """
    document = _document(given)
    if given["format_"] == "json":
        emit(json.dumps(document, indent=1, ensure_ascii=False), given["output"])
    else:
        emit(_text(document), given["output"])


def _document(given: dict[str, Any]) -> dict[str, Any]:
    from sphtrunc.operators import Operator
    from sphtrunc.parse import kernel as parse_kernel
    from sphtrunc.tuning import (
        Problem,
        best_at_cost,
        best_at_error,
        best_at_particles,
        explain,
        exponents,
        read_table,
        setting,
    )

    operator = Operator(given["operator"], given["form"], given["correction"])
    problem = Problem(given["dim"], operator, given["jitter"], lattice=given["lattice"])
    dim = problem.dim
    exact = exponents(operator, dim)
    document: dict[str, Any] = {
        "schema": "sphtrunc.tune/1",
        "dim": dim,
        "operator": operator.name,
        "form": operator.form,
        "correction": operator.correction,
        "jitter": problem.sigma,
        "path": {
            "h": str(exact.p),
            "error": str(exact.order),
            "neighbours": str(exact.neighbours),
        },
        "version": __version__,
    }
    kernels = [parse_kernel(name) for name in given["kernels"]]
    if given["table"] is not None:
        rows = read_table(given["table"], dim, given["wavelength"])
        return {**document, "kernel": kernels[0].name, "runs": explain(problem, kernels[0], rows)}
    wanted = [n for n in ("error", "particles_per_wavelength", "particles", "pairs", "seconds")
              if given[n] is not None]  # fmt: skip
    if len(wanted) != 1:
        raise click.UsageError(
            f"got {len(wanted)} aims, expected one of --error, --particles-per-wavelength,"
            " --particles, --pairs, --seconds, or --table FILE"
        )
    (aim,) = wanted
    box, value = given["box"], given[aim]
    if not box > 0 or not value > 0 or not given["pairs_per_second"] > 0:
        raise ValueError(f"{aim}, box: got {value:g} and {box:g}, expected positive numbers")
    first = kernels[0]
    if aim == "error":
        best = best_at_error(problem, first, value)
    elif aim in ("pairs", "seconds"):
        cost = value if aim == "pairs" else value * given["pairs_per_second"] / box**dim
        best = best_at_cost(problem, first, cost)
    else:
        n = value if aim == "particles_per_wavelength" else value ** (1 / dim) / box
        best = best_at_particles(problem, first, n)
    found = [best, *(best_at_cost(problem, k, best.cost) for k in kernels[1:])]
    document["recommended"] = [s.to_dict() for s in sorted(found, key=lambda s: s.error.total)]
    document["seconds"] = best.cost * box**dim / given["pairs_per_second"]
    if given["now"] is not None:
        ratio = _present(given["now"], first, dim)
        now = setting(problem, first, ratio, 1 / (best.particles * ratio))
        document["now"] = now.to_dict()
        document["loss"] = {
            "error": now.error.total / best_at_particles(problem, first, now.particles).error.total,
            "at_equal_cost": now.error.total / best_at_cost(problem, first, now.cost).error.total,
        }
    return document


def _present(text: str, kernel: Any, dim: int) -> float:
    """Δx/h of NAME=VALUE."""
    from sphtrunc.convention import convert

    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"now: got {text[:40]!r}, expected NAME=VALUE such as hdx=1.2")
    return float(convert(kernel, dim, **{name.strip(): value.strip()})["dx-over-h"])


_HEAD = (
    f"{'kernel':<13}{'Δx/h':>7}{'h/λ':>8}{'λ/Δx':>7}{'neighb.':>8}{'pairs/λ^d':>10}{'error':>9}"
    "  =smooth.  discret. disorder rounding"
)


def _line(row: dict[str, Any]) -> str:
    error = row["error"]
    parts = " ".join(
        f"{error[n]:>8.1e}" for n in ("smoothing", "discretisation", "disorder", "rounding")
    )
    return (
        f"{row['kernel'][:12]:<13}{row['dx_over_h']:>7.4f}{row['h_over_lambda']:>8.4g}"
        f"{row['particles']:>7.4g}{row['neighbours']:>8.4g}{row['cost']:>10.3g}"
        f"{error['total']:>9.2e}  {parts}"
    )


def _text(document: dict[str, Any]) -> str:
    path = document["path"]
    lines = [
        f"{document['operator']} ({document['form']} form, correction {document['correction']}),"
        f" {document['dim']}D, disorder σ/Δx = {document['jitter']:g}",
    ]
    if "runs" in document:
        lines.append(
            f"{'Δx/λ':>9}{'h/λ':>10}{'neighb.':>9}{'error':>11}{'predicted':>11}  dominated by"
        )
        for run in document["runs"]:
            lines.append(
                f"{run['dx_over_lambda']:>9.4g}{run['h_over_lambda']:>10.4g}{run['neighbours']:>9.4g}"
                f"{run['error']:>11.3e}{run['predicted']:>11.3e}  {run['dominant']}"
            )
        advice = dict.fromkeys((run["dominant"], run["advice"]) for run in document["runs"])
        for part, says in advice:
            lines += wrap(f"{part}: {says}", 100, subsequent_indent="  ")
        return "\n".join(lines)
    lines += [_HEAD, *(_line(row) for row in document["recommended"])]
    lines.append(f"One evaluation of the box: about {document['seconds']:.3g} s")
    if "now" in document:
        lines += ["Now, at the same number of particles", _line(document["now"])]
        loss = document["loss"]
        lines += [
            f"  error {loss['error']:.2f} times the least for these particles,"
            f" {loss['at_equal_cost']:.2f} times the least for these pairs",
            f"  dominated by {document['now']['dominant']}",
        ]
    if document["jitter"]:
        lines.append(
            f"Path at this disorder: h ∝ Δx^{path['h']}, error ∝ Δx^{path['error']},"
            f" neighbours ∝ N^{path['neighbours']}"
        )
    return "\n".join(lines)
