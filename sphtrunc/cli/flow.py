"""sphtrunc flow: the error of a solution, measured and predicted, on frozen particles."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from sphtrunc.cli import options
from sphtrunc.operators.operator import CORRECTIONS, OPERATORS
from sphtrunc.output import emit, wrapped
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.study.flows.results import Lid, Steady, Vortex

NAMES = ("poiseuille", "couette", "duct", "rotating-couette", "taylor-green", "cavity")


@click.command(name="flow")
@click.argument("name", type=click.Choice(NAMES), metavar="NAME")
@options.kernel
@click.option("--dim", type=click.IntRange(1, 3), help="Dimension.  [default: 2]")
@click.option(
    "--across", "-n", type=int, metavar="N",
    help="Particles between the walls, or along a side.  [default: 40; cavity: 65]",
)  # fmt: skip
@click.option(
    "--along", type=int, metavar="M",
    help="Planes along periodic axes.  [default: the fewest; N of displaced particles]",
)  # fmt: skip
@options.lattice
@click.option(
    "--dx-over-h", metavar="P/Q",
    help="Particle spacing over smoothing length.  [default: 2/3; cavity: 10/13]",
)  # fmt: skip
@options.jitter
@options.distribution
@click.option("--seed", type=int, default=0, show_default=True, help="Of the displacements.")
@click.option(
    "--form", type=click.Choice(OPERATORS["laplacian"][1]),
    help="Of the Laplacian.  [default: brookshaw; cavity: difference]",
)  # fmt: skip
@click.option(
    "--correction", type=click.Choice(CORRECTIONS),
    help="Of the Laplacian.  [default: none; cavity: rkpm-2]",
)  # fmt: skip
@click.option(
    "--gradient-form", type=click.Choice(OPERATORS["gradient"][1]),
    help="Of the gradients of the cavity.  [default: difference]",
)  # fmt: skip
@click.option(
    "--gradient-correction", type=click.Choice(CORRECTIONS),
    help="Of the same.  [default: csph with a corrected Laplacian, else none]",
)  # fmt: skip
@click.option(
    "--wall", type=click.Choice(("none", "mirror", "dummy", "extrapolate")),
    help="Beyond the walls: nothing, images 2 A_wall - A, dummies with Shepard means, lines through"
    " A_wall.  [default: mirror]",
)  # fmt: skip
@options.wall_at
@click.option(
    "--particles", metavar="FILE",
    help="Particles in place of a lattice: a file that `sphtrunc inspect` reads, or"
    " relaxed:glass,N=1024 (see relax).",
)  # fmt: skip
@options.snapshot
@click.option("--re", "reynolds", metavar="LIST", help="Of the cavity.  [default: 100,400,1000]")
@options.formats("text", "json")
@options.output
def command(**given: Any) -> int:
    """Solve a viscous flow with the matrices of the operators, and say how wrong it is, and why.

    NAME is poiseuille, couette, duct, rotating-couette, taylor-green or cavity. The error e of a
    solution obeys L e = -τ with τ the truncation error: it is predicted from τ, and measured.

    \b
    sphtrunc flow poiseuille --kernel wendland-c2
    sphtrunc flow poiseuille --kernel wendland-c2 --jitter 0.1 --form fatehi-manzari
    sphtrunc flow taylor-green --kernel wendland-c2 --across 32 --particles relaxed:glass,N=1024
    sphtrunc flow cavity --kernel wendland-c2 --across 65 --re 100,400,1000
    """
    from sphtrunc.study.flows.flow import flow
    from sphtrunc.study.flows.results import Lid, Steady

    scene = _scene(given)
    found = flow(
        given["name"],
        given["kernel"],
        across=given["across"],
        along=given["along"],
        dim=given["dim"],
        lattice=given["lattice"],
        dx_over_h=given["dx_over_h"],
        form=given["form"],
        correction=given["correction"],
        gradient_form=given["gradient_form"],
        gradient_correction=given["gradient_correction"],
        wall=given["wall"],
        wall_at=given["wall_at"],
        jitter=given["jitter"],
        distribution=given["distribution"],
        seed=given["seed"],
        scene=scene,
        reynolds=_reynolds(given["reynolds"]),
        progress=_progress(),
    )
    if isinstance(found, Steady):
        document, lines = steady_document(found), steady_text(found)
    elif isinstance(found, Lid):
        document, lines = lid_document(found), lid_text(found)
    else:
        document, lines = vortex_document(found), vortex_text(found)
    text = "\n".join(lines)
    if given["format_"] == "json":
        head = {"schema": "sphtrunc.flow/1", "version": __version__}
        text = json.dumps({**head, **document}, indent=1, ensure_ascii=False)
    emit(text, given["output"])
    return 0


def _scene(given: dict[str, Any]) -> Any:
    """The particles of a file or of a recipe; None for a lattice."""
    import numpy as np

    name = given["particles"]
    read_by = {"type": given["kind"], "columns": given["columns"], "period": given["period"]}
    if name is None:
        for option, value in {**read_by, "h": given["length"]}.items():
            if value is not None:
                raise ValueError(f"{option}: belongs to --particles")
        return None
    if not name.startswith("relaxed:"):
        from sphtrunc.scenes.snapshots.formats import read

        found = read(name, **options.read_as(given))
        for note in found.notes:
            click.echo(f"note: {note}", err=True)
        return found.particles()
    from dataclasses import replace

    from sphtrunc.experiment.glasses import glass
    from sphtrunc.scenes.relaxed import recipe

    for option, value in read_by.items():
        if value is not None:
            raise ValueError(f"{option}: a relaxed scene has its own box; expected none")
    scene = glass(recipe(name, given["dim"])).particles
    h = options.positive("h", given["length"])
    return scene if h is None else replace(scene, h=np.full(scene.population, h), _trees={})


def _reynolds(text: str | None) -> list[float] | None:
    from sphtrunc.arithmetic.rational import exact

    return None if text is None else [float(exact(part, "re")) for part in text.split(",")]


def _progress() -> Any:
    """Continuation as it goes, on a terminal; nothing in a pipe."""
    if not sys.stderr.isatty():
        return None

    def show(re: float, steps: int) -> None:
        click.echo(f"\rRe {re:g}: {steps} steps ", nl=False, err=True)

    return show


def _asked(found: Steady | Vortex | Lid) -> dict[str, Any]:
    return asdict(found.asked)


def _head(found: Steady | Vortex | Lid) -> list[str]:
    """What was solved, on what."""
    from sphtrunc.study.flows.results import FLOWS

    a = found.asked
    where = "given particles" if a.lattice == "given" else f"{a.lattice} lattice"
    shaken = f", displaced by σ/Δx = {a.jitter:g} ({a.distribution})" if a.jitter else ""
    beyond = "" if a.wall is None else f", walls: {a.wall}"
    corrected = "" if a.correction == "none" else f", {a.correction}"
    return [
        f"{a.flow}: {FLOWS[a.flow][0]}",
        f"{a.kernel}, {a.form}{corrected}, Δx/h = {a.dx_over_h:.6g}, {a.dim}D {where}{shaken}:"
        f" {a.across} across, {a.particles} particles{beyond}",
    ]


def steady_document(found: Steady) -> dict[str, Any]:
    """The keys of a steady flow in schema `sphtrunc.flow/1`."""
    expected = found.predicted
    predicted = None
    if expected is not None:
        predicted = {
            "rms": expected.total,
            **expected.parts,
            "dominant": expected.dominant,
            "how": expected.how,
            "known_to": expected.known_to,
            "scatter": expected.scatter,
        }
    return {
        **_asked(found),
        "error": {"rms": found.rms, "largest": found.largest, "mean": found.mean},
        "predicted": predicted,
        "prediction_none": found.none,
        "ratio": found.ratio,
        "amplification": found.amplification,
        "exact_amplification": found.exact_amplification,
        "slowest": [[rate.real, rate.imag] for rate in found.slowest],
        "exact_slowest": found.exact_slowest,
        "singular": found.singular,
        "profile": {name: row.tolist() for name, row in found.profile().items()},
        "bytes": found.bytes,
        "seconds": found.seconds,
    }


def steady_text(found: Steady) -> list[str]:
    """For reading, at most 100 columns."""
    from sphtrunc.theory.disorder.prediction import percent

    lines = [
        *_head(found),
        f"Error of the solution: rms {found.rms:.4e}, largest {found.largest:.3e}, mean"
        f" {found.mean:.3e} of the largest velocity.",
    ]
    expected = found.predicted
    if expected is None:
        lines.append(f"No prediction: {found.none}.")
    else:
        ratio = (
            "both are rounding" if found.ratio is None else f"measured/predicted {found.ratio:.4f}"
        )
        good = ""
        if expected.known_to:
            good = f", good to {percent(expected.known_to)}, and one arrangement scatters by"
            good += f" {percent(expected.scatter)}"
        lines.append(f"Predicted rms error {expected.total:.4e}{good}; {ratio} ({expected.how}).")
        parts = [f"{name} {size:.3e}" for name, size in expected.parts.items() if size]
        if parts:
            lines.append("  " + "   ".join(parts))
        if expected.dominant != "none":
            lines.append(f"  most of it is {_MEANING[expected.dominant]}")
    if found.amplification is not None:
        times = found.amplification / found.exact_amplification
        lines.append(
            f"Amplification ‖L⁻¹‖ = {found.amplification:.5g} width², {times:.5g} times"
            " the exact one."
        )
    if found.slowest:
        first, *others = (f"{rate.real:.5g}" for rate in found.slowest)
        off = 100 * (found.slowest[0].real / found.exact_slowest - 1)
        lines.append(
            f"The slowest transient decays with {first} ν, exact {found.exact_slowest:.5g} ν"
            f" ({off:+.3g} %); then {', '.join(others)}."
        )
    if found.singular:
        lines.append(f"Do not trust this solution: {found.singular}.")
    return wrapped(lines)


_MEANING = {
    "smoothing": "smoothing: the limit of the sums has it",
    "discretisation": "discretisation: the lattice has it, whatever its size",
    "wall": "of the wall: supports that reach beyond it",
    "shift": "the shift of the mean by disorder: it does not fall with the number of particles",
    "spread": "the spread by disorder",
}


def vortex_document(found: Vortex) -> dict[str, Any]:
    """The keys of a vortex in schema `sphtrunc.flow/1`."""
    d = found.decay
    return {
        **_asked(found),
        "exact": d.exact,
        "rate": d.rate,
        "error": d.error,
        "quotient": d.quotient,
        "likeness": d.likeness,
        "spread": list(d.spread),
        "predicted": d.predicted,
        "predicted_error": d.predicted_error,
        "prediction_none": d.none,
        "seconds": found.seconds,
    }


def vortex_text(found: Vortex) -> list[str]:
    """For reading, at most 100 columns."""
    d = found.decay
    lines = [
        *_head(found),
        f"It decays with {d.rate:.10g} ν, exact {d.exact:.10g} ν: relative error {d.error:.6e}.",
    ]
    if d.predicted is None or d.predicted_error is None:
        lines.append(f"No prediction: {d.none}.")
    else:
        lines.append(
            f"Predicted by the symbol of the operator: {d.predicted_error:.6e}, different by"
            f" {abs(d.error - d.predicted_error):.1e}."
        )
    low, high = (100 * (rate / d.exact - 1) for rate in d.spread)
    lines.append(
        f"The four vortices that are one in the continuum: {low:+.4f} % to {high:+.4f} %; it begins"
        f" with {100 * (d.quotient / d.exact - 1):+.4f} %."
    )
    return wrapped(lines)


def lid_document(found: Lid) -> dict[str, Any]:
    """The keys of a cavity in schema `sphtrunc.flow/1`."""
    c = found.cavity
    return {
        **_asked(found),
        "gradient_form": found.gradient.form,
        "gradient_correction": found.gradient.correction,
        "extrema": found.compared(),
        "stopped": c.stopped,
        "profiles": [
            {
                "re": p.re,
                "steps": p.steps,
                "psi_min": float(p.psi.min()),
                "along": p.along.tolist(),
                "u": p.u_line.tolist(),
                "v": p.v_line.tolist(),
            }
            for p in c.profiles
        ],
        "unknowns": c.unknowns,
        "factor_entries": c.entries,
        "factorisations": c.factorisations,
        "seconds": c.seconds,
    }


def lid_text(found: Lid) -> list[str]:
    """For reading, at most 100 columns."""
    from sphtrunc.study.flows.cavity import published

    c = found.cavity
    lines = [
        *_head(found),
        f"gradients: {found.gradient.form}"
        + ("" if found.gradient.correction == "none" else f", {found.gradient.correction}"),
    ]
    rows = ["", f"{'Re':>6}  extremum   value        from Ghia et al.   from Botella & Peyret"]
    for row in found.compared():
        others = [
            "" if row[key] is None else f"{100 * row[key]:+.2f} %"
            for key in ("from_ghia", "from_botella_peyret")
        ]
        rows.append(
            f"{row['re']:>6g}  {row['extremum']:<9}  {row['value']:+.5f}     {others[0]:<16}"
            f"   {others[1]}".rstrip()
        )
    ghia, fine = (published()[name]["source"] for name in ("ghia", "botella-peyret"))
    after = [
        "u on the vertical, v on the horizontal centre line.",
        f"Ghia et al.: {ghia}.",
        f"Botella & Peyret: {fine}.",
    ]
    if c.stopped is not None:
        last = c.profiles[-1].re if c.profiles else 0
        after.insert(
            0,
            f"Newton's method stopped before Re = {c.stopped:g}; the last flow kept is at Re ="
            f" {last:g}." if c.profiles else
            f"Newton's method stopped before Re = {c.stopped:g}, and there is no flow before it.",
        )  # fmt: skip
    return [*wrapped(lines), *rows, "", *wrapped(after)]
