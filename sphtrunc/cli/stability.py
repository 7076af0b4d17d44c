"""sphtrunc stability: which waves grow, and how large a time step may be."""

from __future__ import annotations

import json
from dataclasses import asdict
from fractions import Fraction
from math import pi, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from sphtrunc.cli import options
from sphtrunc.operators.forces import FORCES
from sphtrunc.output import emit, wrapped
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.study.pairing import Pairing
    from sphtrunc.study.stability import Found, Stability
    from sphtrunc.theory.dispersion.modes import Mode, Rest

REMEDIES = ("artificial-stress:EPS", "total-lagrangian", "stress-points")
_MEANING = {
    "longitudinal": "neighbours along the wave",
    "transverse": "shear of the lattice",
}


class Wave(NamedTuple):
    """k in π/Δx, text where it is exact; its name in the zone; its modes."""

    k: list[Any]
    point: str | None
    modes: list[Mode]


@click.command(name="stability")
@options.kernel
@options.dim
@options.dx_over_h
@click.option("--neighbours", metavar="N", help="In place of --dx-over-h, as for convert.")
@click.option(
    "--lattice",
    metavar="KIND",
    help="uniform; square, hexagonal; sc, bcc, fcc, hcp.  [default: uniform, square, sc; for"
    " --pairing hexagonal, fcc]",
)
@click.option(
    "--form",
    type=click.Choice(tuple(FORCES)),
    help="Form of the momentum equation.  [default: symmetric]",
)
@click.option(
    "--pressure",
    metavar="P/Q",
    help="P₀/(ρc²), negative for tension; 1/γ in a gas.  [default: 0; 3/5 for --pairing]",
)
@click.option("--remedy", metavar="NAME", help=f"{', '.join(REMEDIES)}, in place of a form.")
@click.option(
    "--volume",
    type=click.Choice(("summation", "constant", "corrected")),
    default="summation",
    show_default=True,
    help="Density: the sum Σ m W; or m/Δx^d, integrated by its rate, or by that of a csph form.",
)
@click.option(
    "--k",
    "-K",
    "waves",
    multiple=True,
    metavar="K",
    help="A wave in π/Δx, one number per axis as 1,1/2,0, or a point of the zone: X, W, L …;"
    " repeat it for several.",
)
@click.option(
    "--viscosity",
    metavar="ALPHA",
    help="Artificial viscosity α, taken explicitly: the time step with it, too.",
)
@click.option("--pairing", is_flag=True, help="The number of neighbours from which particles pair.")
@click.option(
    "--map",
    "stem",
    metavar="NAME",
    help="Growth over Δx/h × P₀: NAME.png, NAME.svg and NAME.csv.",
)
@options.formats("text", "json")
@options.output
def command(**given: Any) -> None:
    """Which waves of displacements grow on a lattice at rest, and the largest stable time step.

    Longitudinal modes that grow are pairing (under pressure) or the tensile instability (under
    tension); transverse ones are a shear of that lattice, weak and bound to it, and every kernel
    has them somewhere. Frequencies are in c/h, wavevectors in π/Δx; what is exact is a fraction.

    \b
    sphtrunc stability --kernel cubic-spline --dim 3 --neighbours 57 --pressure 3/5
    sphtrunc stability --kernel cubic-spline --dx-over-h 5/6 --pressure 3/5 --k 1/2 --format json
    sphtrunc stability --kernel wendland-c2 --dim 3 --pairing
    sphtrunc stability --kernel cubic-spline --dx-over-h 5/6 --pressure -1/10 \\
                       --remedy artificial-stress:1/5
    sphtrunc stability --kernel cubic-spline --map swegle
    """
    if given["pairing"] and given["stem"] is not None:
        raise click.UsageError("got --pairing and --map, expected one of them")
    rest, exact = _rest(given)
    if given["pairing"]:
        _only(given, "pairing")
        from sphtrunc.study.pairing import pairing

        found = pairing(rest)
        text, document = _pairing_text(rest, found), _pairing_document(rest, found)
    elif given["stem"] is not None:
        _only(given, "map")
        _draw(rest, given["stem"])
        return
    else:
        from sphtrunc.study.stability import named, stability

        kappas = [_wave(rest, wave) for wave in given["waves"]] or _points(rest)
        seen = stability(rest)
        modes = [Wave(k, named(rest.kind, kappa), rest.modes(kappa, exact)) for k, kappa in kappas]
        text, document = _text(seen, modes, exact), _document(seen, modes, exact)
        if given["viscosity"] is not None:
            step = _viscous(rest, given["viscosity"])
            document["courant"]["kick-drift"] = step
            document["viscosity"] = given["viscosity"]
            text += (
                f"\n\nTime step of kick and drift with viscosity α = {given['viscosity']}:"
                f" cΔt/h < {step:.6g}"
            )
    if given["format_"] == "json":
        emit(json.dumps(document, indent=1, ensure_ascii=False), given["output"])
    else:
        emit(text, given["output"])


def _only(given: dict[str, Any], task: str) -> None:
    """Options that say where to look have no meaning for what looks everywhere."""
    named = {
        "dx_over_h": "--dx-over-h",
        "neighbours": "--neighbours",
        "waves": "--k",
        "viscosity": "--viscosity",
    }
    if task == "map":
        named["pressure"] = "--pressure"
        if given["format_"] != "text" or given["output"] is not None:
            raise click.UsageError("--map writes its own files, without --format and --output")
    used = [option for name, option in named.items() if given[name]]
    if used:
        raise click.UsageError(f"--{task} looks at all of them: without {', '.join(used)}")


def _viscous(rest: Rest, alpha: str) -> float:
    from sphtrunc.arithmetic.rational import exact as rational
    from sphtrunc.study.stability import viscous_step

    return viscous_step(rest, float(rational(alpha, "viscosity")))


# ---------------------------------------------------------------------------------- what is asked


def _rest(given: dict[str, Any]) -> tuple[Rest, bool]:
    """The setting, and whether Δx/h is a fraction somebody wrote."""
    from sphtrunc.arithmetic.rational import exact as rational
    from sphtrunc.kernels.parse import kernel as parse_kernel
    from sphtrunc.operators.forces import force
    from sphtrunc.scenes.sites import DEFAULT, KINDS
    from sphtrunc.study.pairing import DENSEST, GAS
    from sphtrunc.study.stability import ratio_of
    from sphtrunc.theory.dispersion.modes import Rest

    kernel = parse_kernel(given["kernel"])
    dim = given["dim"]
    usual = DENSEST if given["pairing"] else DEFAULT
    kind = given["lattice"] or usual[dim]
    kind = "cubic" if kind == "sc" else kind
    fitting = [name for name, data in KINDS.items() if data.dim == dim]
    if kind not in fitting:
        raise ValueError(f"lattice: got {kind!r} in {dim}D, expected one of {', '.join(fitting)}")
    name, stress = _remedy(given["remedy"], given["form"])
    everywhere = given["pairing"] or given["stem"] is not None
    sizes = [given[n] for n in ("dx_over_h", "neighbours") if given[n] is not None]
    if len(sizes) != 1 and not everywhere:
        raise click.UsageError(
            f"got {'both --dx-over-h and --neighbours' if sizes else 'no resolution'}, expected"
            " one of --dx-over-h and --neighbours"
        )
    ratio = Fraction(5, 6)
    if given["dx_over_h"] is not None:
        ratio = rational(given["dx_over_h"], "dx-over-h")
    elif given["neighbours"] is not None:
        count = rational(given["neighbours"], "neighbours")
        if not 1 < count < 10**6:
            raise ValueError(f"neighbours: got {count}, expected a number between 1 and 10⁶")
        ratio = Fraction(ratio_of(kernel, dim, float(count)))
    default = GAS if given["pairing"] else Fraction(0)
    pressure = default if given["pressure"] is None else rational(given["pressure"], "pressure")
    if abs(pressure) > 10**6:
        raise ValueError(f"pressure: got {pressure}, expected P₀/(ρc²) between -10⁶ and 10⁶")
    rest = Rest(kernel, kind, ratio, force(name), pressure, stress, given["volume"])
    return rest, given["neighbours"] is None


def _remedy(remedy: str | None, form: str | None) -> tuple[str, Any]:
    """(form, artificial stress) of --form and --remedy."""
    from sphtrunc.arithmetic.rational import exact as rational
    from sphtrunc.operators.forces import ArtificialStress

    if remedy is None:
        return form or "symmetric", None
    name, colon, size = remedy.partition(":")
    if name == "artificial-stress":
        if not colon:
            raise ValueError("remedy: got artificial-stress, expected artificial-stress:EPS")
        return form or "symmetric", ArtificialStress(rational(size, "remedy"))
    if remedy not in REMEDIES:
        raise ValueError(f"remedy: got {remedy[:40]!r}, expected one of {', '.join(REMEDIES)}")
    if form not in (None, remedy):
        raise ValueError(f"remedy: {remedy} is a form of its own, in place of {form}; give one")
    return remedy, None


def _wave(rest: Rest, text: str) -> tuple[list[Any], tuple[Fraction, ...]]:
    """What was given, and κ."""
    from sphtrunc.arithmetic.rational import exact as rational
    from sphtrunc.scenes.sites import units
    from sphtrunc.theory.dispersion.brillouin import inside, point, scale, shortest

    text = text.strip()
    if text[:1].isalpha():
        return _shown(rest, point(rest.kind, text.upper()))
    parts = text.split(",")
    if len(parts) != rest.dim:
        raise ValueError(
            f"k: got {text[:60]!r}, expected {rest.dim} number{'s' * (rest.dim > 1)} in π/Δx,"
            f" such as {','.join(['1/2', '0', '0'][: rest.dim])}, or the name of a point"
        )
    k = [rational(part, "k") for part in parts]
    if not any(k):
        raise ValueError("k: got 0, which moves all particles alike; expected a wave")
    if max(abs(c) for c in k) > 1000:
        raise ValueError(f"k: got {text[:60]}, expected numbers in π/Δx up to a few")
    kappa = tuple(c * u for c, u in zip(k, units(rest.kind), strict=True))
    if not inside(rest.kind, kappa):
        import numpy as np

        short = shortest(rest.kind, np.array([[float(c) for c in kappa]]))[0]
        same = ",".join(f"{c:.6g}" for c in (short * scale(rest.kind) / pi).round(9) + 0.0)
        raise ValueError(
            f"k: got {text[:60]}, outside the zone of the lattice {rest.kind}: particles cannot"
            f" tell it from {same}"
        )
    return [str(c) for c in k], kappa


def _shown(rest: Rest, kappa: tuple[Fraction, ...]) -> tuple[list[Any], tuple[Fraction, ...]]:
    """k in π/Δx of κ: fractions where the lattice has rational units."""
    from sphtrunc.scenes.sites import KINDS, units

    rational = all(n == 1 for _, _, n in KINDS[rest.kind].units)
    k = [c / u for c, u in zip(kappa, units(rest.kind), strict=True)]
    return [str(c) if rational or not c else float(c) for c in k], kappa


def _points(rest: Rest) -> list[tuple[list[Any], tuple[Fraction, ...]]]:
    from sphtrunc.theory.dispersion.brillouin import POINTS, point

    return [_shown(rest, point(rest.kind, name)) for name in POINTS[rest.kind]]


# ----------------------------------------------------------------------------------- what is said


def _setting(rest: Rest, exact: bool = True) -> dict[str, Any]:
    return {
        "schema": "sphtrunc.stability/1",
        "kernel": rest.kernel.name,
        "dim": rest.dim,
        "lattice": _lattice(rest),
        "form": rest.force.name,
        "remedy": None if rest.stress is None else f"artificial-stress:{rest.stress.epsilon}",
        "pressure": str(rest.pressure),
        "volume": "constant" if rest.staggered else rest.volume,
    }


def _lattice(rest: Rest) -> str:
    return "sc" if rest.kind == "cubic" else rest.kind


def _exactly(value: Any) -> Any:
    """Text of a fraction, a float as it is."""
    return str(value) if isinstance(value, Fraction) else value


def _document(seen: Stability, modes: list[Wave], exact: bool) -> dict[str, Any]:
    from sphtrunc.study.stability import neighbours

    rest = seen.rest
    ratio = float(rest.ratio)
    return {
        **_setting(rest),
        "dx_over_h": str(rest.ratio) if exact else ratio,
        "neighbours": neighbours(rest.kernel, rest.dim, ratio),
        "modes": [
            {
                "k": wave.k,
                "point": wave.point,
                "omega2": [m.omega2 if m.exact is None else m.exact for m in wave.modes],
                "branch": [m.branch for m in wave.modes],
                "growth_rate": [m.growth for m in wave.modes],
                "polarisation": [list(m.polarisation) for m in wave.modes],
            }
            for wave in modes
        ],
        "sound_speed2": _plain(seen.sound_speed2, exact),
        "dispersion": _plain(seen.dispersion, exact),
        "worst": asdict(seen.worst),
        "branches": {name: asdict(found) for name, found in seen.branches.items()},
        "fastest": None if seen.fastest is None else asdict(seen.fastest),
        "stable": seen.stable,
        "ranges": {name: [asdict(r) for r in found] for name, found in seen.ranges.items()},
        "zero_modes": [_shown(rest, kappa)[0] for kappa in seen.zero_modes],
        "courant": {n: None if c == float("inf") else c for n, c in seen.courant.items()},
        "highest": {"omega2": seen.highest, "k": list(seen.highest_k)},
        "rounding": seen.rounding,
        "version": __version__,
    }


def _plain(value: Any, exact: bool) -> Any:
    """A fraction as text where Δx/h was one; where it was the float of some neighbours, a float."""
    if value is None:
        return None
    return _exactly(value) if exact else float(value)


def _pairing_document(rest: Rest, found: Pairing) -> dict[str, Any]:
    return {**_setting(rest), "pairing": asdict(found), "version": __version__}


def _head(rest: Rest) -> str:
    remedy = "" if rest.stress is None else f" with artificial stress ε = {rest.stress.epsilon}"
    return f"{rest.kernel.name} on {_lattice(rest)} ({rest.dim}D), form {rest.force.name}{remedy}"


def _pairing_text(rest: Rest, found: Pairing) -> str:
    head = f"{_head(rest)}, P₀ = {rest.pressure} ρc²"
    if found.neighbours is None or found.dx_over_h is None:
        return (
            f"{head}\nNo pairing: the longitudinal branch is stable up to {found.most:g}"
            " neighbours."
        )
    where = f"k = {_numbers(found.k)} π/Δx on a grid of the zone"
    if found.point:
        where = f"point {found.point}"
    return "\n".join(
        wrapped(
            [
                head,
                f"Particles pair from {found.neighbours:.12g} neighbours on (h ="
                f" {1 / found.dx_over_h:.6g} Δx): the longitudinal mode at {where} has no restoring"
                " force.",
            ]
        )
    )


def _numbers(k: Any) -> str:
    return ", ".join(f"{c:.4g}" for c in k)


def _text(seen: Stability, modes: list[Wave], exact: bool) -> str:
    from sphtrunc.study.stability import neighbours

    rest = seen.rest
    ratio = float(rest.ratio)
    spacing = str(rest.ratio) if exact else f"{ratio:.6g}"
    count = neighbours(rest.kernel, rest.dim, ratio)
    lines = [
        f"{_head(rest)}, P₀ = {rest.pressure} ρc²",
        f"Δx/h = {spacing}, {count:.4g} neighbours",
        "",
    ]
    sentences = [_sound(seen, exact)]
    sentences += [_branch(seen, branch) for branch in seen.branches]
    if seen.fastest is not None:
        found = seen.fastest
        assert found.growth_rate is not None
        assert found.wavelength is not None
        if found.growth_rate > 0:
            sentences.append(
                f"Fastest growth: {found.growth_rate:.4g} c/h ({found.growth_rate * ratio:.4g}"
                f" c/Δx), {found.branch}, wavelength {found.wavelength:.4g} Δx, k ="
                f" {_numbers(found.k)} π/Δx."
            )
    if seen.zero_modes:
        shown = "; ".join(_numbers(map(float, _shown(rest, k)[0])) for k in seen.zero_modes)
        also = "" if rest.dim == 1 else " So is every transverse wave."
        sentences.append(
            "Zero-energy modes, which nothing holds back: displacements that change sign from"
            f" particle to particle, k = {shown} π/Δx.{also}"
        )
    sentences.append(_time_step(seen))
    for branch, ranges in seen.ranges.items():
        shown = ", ".join(
            f"{r.dx_over_h[0]:.4g} to {r.dx_over_h[1]:.4g} ({r.neighbours[0]:.4g} to"
            f" {r.neighbours[1]:.4g} neighbours)"
            for r in ranges
        )
        sentences.append(f"Stable ({branch}), all else equal: Δx/h {shown or 'nowhere'}.")
    lines += wrapped(sentences)
    lines += ["", "modes (ω² in c²/h²):"]
    for wave in modes:
        point = f" (point {wave.point})" if wave.point else ""
        lines.append(f"  k = {', '.join(map(_short, wave.k))} π/Δx{point}")
        for m in wave.modes:
            rate = f", grows at {m.growth:.4g} c/h" if m.growth else ""
            value = f"{m.omega2:.12g}"
            value += f" = {m.exact}" if m.exact not in (None, value) else ""
            lines.append(f"    {m.branch:<13} ω² = {value}{rate}")
    return "\n".join(lines)


def _short(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def _sound(seen: Stability, exact: bool) -> str:
    c2 = float(seen.sound_speed2)
    axis = "" if seen.rest.dim == 1 else " along x"
    if c2 <= 0:
        return f"Long waves{axis}: no sound, c_eff² = {c2:.6g} c²."
    shown = f"c_eff² = {seen.sound_speed2} c², " if isinstance(
        seen.sound_speed2, Fraction) and exact else ""  # fmt: skip
    speed = sqrt(c2)
    bend = (
        "" if seen.dispersion is None else f"; ω/(c_eff k) = 1 {float(seen.dispersion):+.4g} k²h²"
    )
    return (
        f"Long waves{axis}: {shown}sound is {100 * abs(speed - 1):.3g} % too"
        f" {'fast' if speed >= 1 else 'slow'}{bend}."
        if abs(speed - 1) > 1e-12
        else f"Long waves{axis}: {shown}the sound speed is right{bend}."
    )


def _branch(seen: Stability, branch: str) -> str:
    found = seen.branches[branch]
    kind = _kind(seen, found)
    means = _MEANING[branch]
    if found.wavelength is None:
        where = f"in long waves along {_numbers(found.k)}"
    else:
        point = f" (point {found.point})" if found.point else ""
        where = f"at wavelength {found.wavelength:.4g} Δx, k = {_numbers(found.k)} π/Δx{point}"
    if not seen.stable[branch]:
        weak = " Weak: below 1 % of c²k²." if found.relative > -0.01 else ""
        return (
            f"{branch.capitalize()} ({means}): UNSTABLE, {kind}. ω² = {found.relative:.4g} c²k²"
            f" {where}.{weak}"
        )
    if abs(found.relative) * seen.rest.dim < 1e-9:
        return f"{branch.capitalize()} ({means}): neither stable nor unstable, ω² = 0 {where}."
    return (
        f"{branch.capitalize()} ({means}): stable. Weakest: ω² = {found.relative:.4g} c²k² {where}."
    )


def _kind(seen: Stability, found: Found) -> str:
    if found.branch == "transverse":
        return f"a shear of the lattice {_lattice(seen.rest)}, not pairing"
    if found.wavelength is None:
        return "without a speed of sound"
    return "pairing" if seen.rest.pressure > 0 else "the tensile instability"


def _time_step(seen: Stability) -> str:
    steps = seen.courant
    if steps["leapfrog"] == float("inf"):
        return "Time step: no wave oscillates, so none limits it."
    growing = "" if all(seen.stable.values()) else " (of the waves that do not grow)"
    return (
        f"Time step{growing}: cΔt/h < {steps['leapfrog']:.6g} with leapfrog, {steps['rk4']:.6g}"
        f" with RK4, set by k = {_numbers(seen.highest_k)} π/Δx; RK2 and Euler have no stable step"
        " without damping."
    )


def _draw(rest: Rest, stem: str) -> None:
    from pathlib import Path

    from sphtrunc.figures.picture import save
    from sphtrunc.figures.stability import map_of

    path = Path(stem)
    if not path.name:
        raise ValueError(f"map: got {stem!r}, expected the name of files to write")
    for written in save(map_of(rest, path.name), path.parent):
        click.echo(str(written))
