"""sphtrunc tune: which h and Δx to take."""

from __future__ import annotations

import json
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import click

from sphtrunc.cli import options
from sphtrunc.output import emit, wrapped
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.study.tuning import Setting

PARTS = ("smoothing", "discretisation", "disorder", "rounding")


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
@click.option(
    "--disorder",
    metavar="KIND",
    help="In place of --jitter: jitter:0.1, glass, poisson, or a FILE of particles.",
)
@click.option("--period", metavar="L", help="Side of the periodic box of that file, or Lx,Ly,Lz.")
@click.option("--error", type=float, help="Wanted: this relative error at λ, at the least cost.")
@click.option("--particles-per-wavelength", type=float, metavar="N", help="Given: λ/Δx.")
@click.option("--particles", type=float, metavar="N", help="Given: particles in the box.")
@click.option("--pairs", type=float, metavar="N", help="Given: pairs in a volume λ^d.")
@click.option("--seconds", type=float, metavar="T", help="Given: time of a step over the box.")
@click.option(
    "--pairs-per-second", type=float, default=2e8, help="Speed of the code.  [default: 2e8]"
)
@click.option("--box", type=float, default=1.0, help="Side of the box, in λ.  [default: 1]")
@click.option(
    "--wall",
    is_flag=True,
    help="Also how far from a wall its error reaches, and its share between walls a box apart.",
)
@click.option(
    "--now",
    metavar="NAME=X",
    help="The present setting, in any convention of convert: hdx=1.2, neighbours=57, eta=1.23 …",
)
@click.option(
    "--table", metavar="FILE", help="Explain runs: a CSV of dx (or n in the box), h, error."
)
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
                  --now hdx=1.2 --wall --box 10
    sphtrunc tune --kernel cubic-spline --jitter 0.05 --table runs.csv --wavelength 0.1
    """
    document = _document(given)
    if given["format_"] == "json":
        emit(json.dumps(document, indent=1, ensure_ascii=False), given["output"])
    else:
        emit(_text(document), given["output"])


def _document(given: dict[str, Any]) -> dict[str, Any]:
    from sphtrunc.kernels.parse import kernel as parse_kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.study.boundary_layer import boundary_layer
    from sphtrunc.study.plateaus import advice
    from sphtrunc.study.tuning import (
        MOST_NEIGHBOURS,
        Problem,
        best_at_cost,
        best_at_error,
        best_at_particles,
        exponents,
        setting,
    )

    operator = Operator(given["operator"], given["form"], given["correction"])
    problem = Problem(given["dim"], operator, given["jitter"], lattice=given["lattice"])
    dim = problem.dim
    exact, alpha = exponents(operator, dim), ""
    if given["disorder"] is None and given["period"] is not None:
        raise ValueError("period: belongs to --disorder FILE; expected that as well")
    if given["disorder"] is not None:
        problem, exact, alpha = _disordered(given, problem)
    document: dict[str, Any] = {
        "schema": "sphtrunc.tune/1",
        "dim": dim,
        "operator": operator.name,
        "form": operator.form,
        "correction": operator.correction,
        "jitter": problem.sigma,
        **({} if problem.disorder is None else {"disorder": problem.disorder.by, "alpha": alpha}),
        "path": {
            "h": str(exact.p),
            "error": str(exact.order),
            "neighbours": str(exact.neighbours),
        },
        "version": __version__,
    }
    kernels = [parse_kernel(name) for name in given["kernels"]]
    wanted = [name for name in _AIMS if given[name] is not None]
    if len(wanted) + (given["table"] is not None) != 1:
        aims = ", ".join("--" + name.replace("_", "-") for name in (*_AIMS, "table"))
        got = " and ".join("--" + name.replace("_", "-") for name in wanted)
        raise click.UsageError(
            f"got {got + ' and --table' * (given['table'] is not None) or 'no aim'}, expected"
            f" exactly one of {aims}"
        )
    if given["table"] is not None:
        if len(kernels) > 1 or given["now"] is not None:
            raise click.UsageError("--table explains runs of one kernel, without --now")
        if given["wall"]:
            raise click.UsageError("--table explains runs, which have no --wall")
        return {**document, "kernel": kernels[0].name, **_runs(given, problem, kernels[0])}
    (aim,) = wanted
    box, value = given["box"], given[aim]
    if not box > 0 or not value > 0 or not given["pairs_per_second"] > 0:
        raise ValueError(f"{aim}, box: got {value:g} and {box:g}, expected positive numbers")
    first = kernels[0]
    most = [_most_neighbours(kernel, dim) for kernel in kernels]
    if aim == "error":
        best = best_at_error(problem, first, value, most[0])
    elif aim in ("pairs", "seconds"):
        cost = value if aim == "pairs" else value * given["pairs_per_second"] / box**dim
        best = best_at_cost(problem, first, cost, most[0])
    else:
        n = value if aim == "particles_per_wavelength" else value ** (1 / dim) / box
        best = best_at_particles(problem, first, n, most[0])
    others = zip(kernels[1:], most[1:], strict=True)
    found = [best, *(best_at_cost(problem, k, best.cost, n) for k, n in others)]
    rows = [_with_pairing(s, k, dim) for s, k in zip(found, kernels, strict=True)]
    rows.sort(key=lambda row: row["error"]["total"])
    document["recommended"] = rows
    document["most_neighbours"] = MOST_NEIGHBOURS[dim]
    document["pairs_per_second"] = given["pairs_per_second"]
    document["seconds"] = best.cost * box**dim / given["pairs_per_second"]
    if given["wall"]:
        layer = boundary_layer(problem, first, best, box)
        document["wall"] = {"kernel": first.name, "at": "half-way", **layer.to_dict()}
    if given["now"] is not None:
        ratio = _present(given["now"], first, dim)
        now = setting(problem, first, ratio, 1 / (best.particles * ratio))
        document["now"] = {"given": given["now"], **_with_pairing(now, first, dim)}
        document["advice"] = advice(problem, now.dominant)
        equal = {
            "error": best_at_particles(problem, first, now.particles, most[0]),
            "at_equal_cost": best_at_cost(problem, first, now.cost, most[0]),
        }
        document["loss"] = {
            name: now.error.total / least.error.total for name, least in equal.items()
        }
    return document


def _disordered(given: dict[str, Any], problem: Any) -> tuple[Any, Any, str]:
    """The problem with disorder of another kind than a jitter, its exponents, and α of S ∝ k^α."""
    from dataclasses import replace

    from sphtrunc.cli.structure import scene
    from sphtrunc.study.structure import disorder
    from sphtrunc.study.tuning import exponents

    text = given["disorder"]
    if given["jitter"] or given["lattice"] is not None:
        raise ValueError("disorder: got --jitter or --lattice as well, expected one or the other")
    if text.startswith("jitter:"):
        from sphtrunc.arithmetic.rational import exact

        sigma = float(exact(text.partition(":")[2], "disorder"))
        return replace(problem, sigma=sigma), exponents(problem.operator, problem.dim), "2"
    if given["table"] is not None:
        raise ValueError("disorder: runs of a table are explained by a jitter; expected --jitter")
    if text in ("glass", "poisson") and given["period"] is not None:
        raise ValueError(f"period: belongs to a file, not to {text}")
    home = None if text in ("glass", "poisson") else scene(text, given["period"])
    found, alpha = disorder(text, problem.dim, home)
    path = exponents(problem.operator, problem.dim, alpha)
    return replace(problem, disorder=found), path, str(alpha)


def _most_neighbours(kernel: Any, dim: int) -> float:
    """Neighbours that are looked at: fewer than let particles pair."""
    from sphtrunc.study.pairing import pairing_limit

    limit = pairing_limit(kernel, dim)
    return float("inf") if limit is None else (1 - 1e-6) * limit


def _with_pairing(chosen: Setting, kernel: Any, dim: int) -> dict[str, Any]:
    """A setting as data, with the neighbours from which its particles pair, and whether they do."""
    from sphtrunc.study.pairing import pairing_limit

    limit = pairing_limit(kernel, dim)
    pairs = limit is not None and chosen.neighbours >= limit
    return {**chosen.to_dict(), "pairing_limit": limit, "pairs": pairs}


def _present(text: str, kernel: Any, dim: int) -> float:
    """Δx/h of NAME=VALUE."""
    from sphtrunc.kernels.conventions import convert

    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"now: got {text[:40]!r}, expected NAME=VALUE such as hdx=1.2")
    return float(convert(kernel, dim, **{name.strip(): value.strip()})["dx-over-h"])


_AIMS = ("error", "particles_per_wavelength", "particles", "pairs", "seconds")


def _runs(given: dict[str, Any], problem: Any, kernel: Any) -> dict[str, Any]:
    """The runs of a table, and what is found of them."""
    from sphtrunc.study.plateaus import explain, explanations, findings, read_table

    rows = read_table(given["table"], problem.dim, given["wavelength"], given["box"])
    runs = explain(problem, kernel, rows)
    found = explanations(problem, kernel, runs)
    return {
        "runs": runs,
        "explanations": [model.to_dict() for model in found],
        "findings": findings(problem, kernel, runs, found),
    }


_HEAD = (
    f"{'kernel':<13}{'Δx/h':>7}{'h/λ':>8}{'λ/Δx':>7}{'neighb.':>8}{'pairs':>10}{'error':>9}"
    "   smooth. discret. disorder rounding"
)


def _line(row: dict[str, Any]) -> str:
    error = row["error"]
    parts = " ".join(f"{error[part]:>8.1e}" for part in PARTS)
    return (
        f"{row['kernel'][:12]:<13}{row['dx_over_h']:>7.4f}{row['h_over_lambda']:>8.4g}"
        f"{row['particles']:>7.4g}{row['neighbours']:>8.4g}{row['cost']:>10.3g}"
        f"{error['total']:>9.2e}  {parts}"
    )


def _share(x: float) -> str:
    """A relative error as it is said."""
    return f"{100 * x:.{2 if x < 1 else 3}g} %" if 1e-5 <= x < 10 else f"{x:.2g}"


def _count(x: float) -> str:
    return f"{x:.3g}" if x < 1000 else f"{x:.0f}" if x < 1e6 else f"{x:.2e}"


def _made_of(error: dict[str, float]) -> str:
    """The parts that matter, the largest first."""
    parts = sorted(PARTS, key=lambda part: -error[part])
    said = ", ".join(f"{n} {_share(error[n])}" for n in parts if error[n] > 0.05 * error[parts[0]])
    opposed = error["total"] < 0.95 * error[parts[0]]
    return said + (" (of opposite signs)" if opposed else "")


def _text(document: dict[str, Any]) -> str:
    from sphtrunc.study.plateaus import power_text

    dim = document["dim"]
    corrected = "" if document["correction"] == "none" else f", {document['correction']}"
    lines = [
        f"{document['operator']}, {document['form']} form{corrected}, {dim}D,"
        f" particles {_kind(document)}",
        "",
    ]
    if "runs" in document:
        lines += _table(document["runs"])
        for model in document["explanations"]:
            if model["runs"] != document["runs"]:
                lines += ["", f"With {model['name']}:", *_table(model["runs"])]
        return "\n".join([*lines, "", *wrapped(document["findings"])])
    best = document["recommended"][0]
    found = [
        f"Take {best['kernel']} with h = {1 / best['dx_over_h']:.3g} Δx: Δx/h ="
        f" {best['dx_over_h']:.3g}, {_count(best['neighbours'])} neighbours"
        f"{_until(best['pairing_limit'])}, and"
        f" {best['particles']:.3g} particles per wavelength, so h = {best['h_over_lambda']:.3g} λ.",
        f"Its error at λ is {_share(best['error']['total'])} (rms, of the largest exact value):"
        f" {_made_of(best['error'])}.",
        f"It takes {_count(best['cost'])} pairs per λ{'  ²³'[dim].strip()}:"
        f" {document['seconds']:.2g} s for the box at {document['pairs_per_second']:.3g} pairs/s.",
    ]
    found += _limited(best, dim)
    if best["neighbours"] > 0.97 * document["most_neighbours"]:
        found.append(
            f"No more neighbours than {document['most_neighbours']} are looked at: with the same"
            " particles and still more the error may fall further."
        )
    if document["jitter"] or "disorder" in document:
        path = {name: Fraction(text) for name, text in document["path"].items()}
        found.append(
            f"Finer particles: keep h ∝ {power_text('Δx', path['h'])}; then the error falls as"
            f" {power_text('Δx', path['error'])} and neighbours grow as"
            f" {power_text('N', path['neighbours'])}"
            f"{'' if best['pairing_limit'] is None else ', up to those that pair'}."
        )
    if "alpha" in document:
        alpha = Fraction(document["alpha"])
        waves = f"S ∝ {power_text('k', alpha)}" if alpha else "S is level"
        found.append(
            f"At long waves its {waves}: with more neighbours for the same particles the noise"
            f" falls only as {power_text('(Δx/h)', (dim + alpha) / 2)}."
        )
    if "wall" in document:
        found += _layer(document["wall"], document["recommended"])
    lines += [*wrapped(found), "", _HEAD, *(_line(row) for row in document["recommended"])]
    if "now" in document:
        now, loss = document["now"], document["loss"]
        lines += [_line({**now, "kernel": "now"}), ""]
        lines += wrapped(
            [
                f"Now ({now['given']}, {now['kernel']}, as many particles): the error is"
                f" {_share(now['error']['total'])}, {loss['error']:.3g} times the least for these"
                f" particles and {loss['at_equal_cost']:.3g} times the least for these"
                f" pairs{' without pairing' if now['pairs'] else ''}."
                f" It is mostly {now['dominant']}. {document['advice']}",
                *(
                    [
                        f"Warning: with {_count(now['neighbours'])} neighbours, as now, particles"
                        f" pair in a fluid under pressure. {_sign(now, dim)}"
                    ]
                    if now["pairs"]
                    else []
                ),
            ]
        )
    return "\n".join(lines)


def _layer(wall: dict[str, Any], rows: list[dict[str, Any]]) -> list[str]:
    """What a wall does to the error of the setting of its kernel."""
    (own,) = (row for row in rows if row["kernel"] == wall["kernel"])
    x, inside = own["h_over_lambda"], wall["inside"]["total"]
    first = wall["errors"][0]["total"]
    if not wall["reach"]:
        return ["A wall, with nothing beyond it, changes the error by less than a tenth."]
    particles, share, rms = (_share(wall[name]) for name in ("particles", "error", "rms"))
    text = (
        f"Beside a wall, with nothing beyond it, the error of {wall['kernel']} is another up to"
        f" {wall['reach']:.3g} h = {wall['reach'] * x:.3g} λ: {_share(first)} at the first"
        f" particle, {first / inside:.3g} times that inside. Between two walls"
        f" {wall['domain']:g} λ apart the layers hold {particles} of the particles and {share} of"
        f" the mean square error, which is {rms} rms."
    )
    order, order_inside = wall["order"], wall["order_inside"]
    if order < order_inside:
        grows = 1 + 2 * (order - order_inside)
        how = "falls" if grows > 0 else "grows"
        text += (
            f" On the wall its smoothing error goes as h^{order}, inside as h^{order_inside}: of"
            f" that the share {how} as h^{grows} until the layers have all of it."
            " What remedies leave: sphtrunc wall."
        )
    return [text]


def _kind(document: dict[str, Any]) -> str:
    if "disorder" in document:
        return f"in disorder ({document['disorder']})"
    sigma = document["jitter"]
    return f"displaced by σ/Δx = {sigma:g}" if sigma else "on a lattice"


def _limited(row: dict[str, Any], dim: int) -> list[str]:
    """What keeps a setting from more neighbours, where that is pairing."""
    limit = row["pairing_limit"]
    if limit is None or row["neighbours"] < 0.97 * limit:
        return []
    other = "wendland-c2-1d" if dim == 1 else "wendland-c2"
    return [
        f"No more are recommended: with {_count(limit)} neighbours particles pair in a fluid under"
        f" pressure. {_sign(row, dim)} Wendland's kernels have no such limit: compare --kernel"
        f" {other}."
    ]


def _until(limit: float | None) -> str:
    return "" if limit is None else f" (particles pair from {_count(limit)} on)"


def _sign(row: dict[str, Any], dim: int) -> str:
    """Why a kernel has a pairing limit."""
    return (
        f"The Fourier transform of {row['kernel']} changes sign in {dim}D, and holds them apart up"
        f" to {_count(row['pairing_limit'])} neighbours."
    )


def _table(runs: list[dict[str, Any]]) -> list[str]:
    lines = [
        f"{'Δx/λ':>9}{'h/λ':>9}{'neighb.':>8}{'error':>10}{'predicted':>10}"
        "   smooth. discret. disorder rounding  mostly"
    ]
    for run in runs:
        error = "-" if run["error"] is None else f"{run['error']:.2e}"
        parts = " ".join(f"{run[part]:>8.1e}" for part in PARTS)
        lines.append(
            f"{run['dx_over_lambda']:>9.3g}{run['h_over_lambda']:>9.3g}{run['neighbours']:>8.4g}"
            f"{error:>10}{run['predicted']:>10.2e}  {parts}  {run['dominant']}"
        )
    return lines
