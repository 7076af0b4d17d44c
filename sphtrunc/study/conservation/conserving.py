"""What is kept exactly, to which order, at what error: momentum equations side by side.

Conservation of momentum needs Σ_a F_a = 0 for every pressure; a force of no error for a constant
pressure needs Σ_b of the same matrix to vanish the other way round. On a lattice both hold by
symmetry. Displaced particles let one have either: the forms that conserve have an error of P₀/h,
and those that are consistent let momentum leak.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from sphtrunc.arithmetic.rational import exact
from sphtrunc.arithmetic.summation import Array
from sphtrunc.experiment.adapted_lengths import adapted, grad_h
from sphtrunc.experiment.conservation import Kept, Residual, combinations, kept
from sphtrunc.experiment.momentum import FORMS, State
from sphtrunc.experiment.pair_matrices import Cloud
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.scenes.jittered import Jittered, jittered
from sphtrunc.scenes.lattice import Lattice, lattice
from sphtrunc.scenes.particles import particles
from sphtrunc.study.conservation.force_errors import (
    Wave,
    displaced,
    measured_errors,
    predicted_errors,
    wave_of,
)
from sphtrunc.version import __version__

LENGTHS = ("constant", "adapted", "random")
_INSIDE = {1: 60.0, 2: 8.0, 3: 4.0}  # radius in Δx of the particles whose error is measured
_MOST = 200_000  # particles
_SPREAD = 2.0  # random h from 1/2 to 2


@dataclass(frozen=True)
class Row:
    """A form under a rule for h: what it keeps, and the error of its acceleration.

    measured: rms of |F/m + ∇P/ρ| over max |∇P|/ρ (None without a pressure to compare with)
    predicted: of the lattice and to first order in the displacements (None where there is none)
    order_h: power of h of the error at fixed Δx/h
    """

    kept: Kept
    measured: float | None
    predicted: float | None
    order_h: int

    def to_dict(self) -> dict[str, Any]:
        """One row of the schema."""
        one = self.kept
        return {
            "form": one.form,
            "correction": FORMS[one.form].correction,
            "h_rule": one.rule,
            "linear": one.linear.to_dict(),
            "angular": None if one.angular is None else one.angular.to_dict(),
            "energy": {"partner": one.partner, **one.energy.to_dict()},
            "acceleration_error": {
                "measured": self.measured,
                "predicted": self.predicted,
                "order_h": self.order_h,
            },
        }


@dataclass(frozen=True)
class Balance:
    """The table, and the settings that it belongs to."""

    settings: Mapping[str, Any]
    rows: tuple[Row, ...]

    def to_dict(self) -> dict[str, Any]:
        """The contract of schema `sphtrunc.conserve/1`."""
        rows = [row.to_dict() for row in self.rows]
        return {
            "schema": "sphtrunc.conserve/1",
            "settings": dict(self.settings),
            "rows": rows,
            "version": __version__,
        }

    def to_json(self) -> str:
        """`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)

    def to_text(self) -> str:
        """What a person reads first; at most 100 columns."""
        lines = [
            f"Conservation on {self.settings['particles']} particles: {self.settings['scene']}",
            "",
            f"{'form':<18}{'h rule':<12}{'momentum':>12}{'angular':>12}{'energy':>12}"
            f"{'error':>12}{'predicted':>12}{'order':>7}",
        ]
        for row in self.rows:
            one = row.kept
            shown = [_residual(r) for r in (one.linear, one.angular, one.energy)]
            errors = ["" if x is None else f"{x:.3e}" for x in (row.measured, row.predicted)]
            lines.append(
                f"{one.form:<18}{one.rule:<12}"
                + "".join(f"{text:>12}" for text in (*shown, *errors))
                + f"{f'h^{row.order_h}':>7}"
            )
        worst = max(
            r.bound
            for row in self.rows
            for r in (row.kept.linear, row.kept.angular, row.kept.energy)
            if r is not None
        )
        lines += ["", "Density rates that keep the energy (computed as the transposed force):"]
        lines += [
            f"  {row.kept.form:<18}{row.kept.rule:<12}" + _partner(row.kept) for row in self.rows
        ]
        lines += [
            "",
            f"exact: zero to the rounding of these sums, at most {worst:.0e} of what is added up.",
            "error: rms of the acceleration over the largest |∇P|/ρ, inside, over all phases of the"
            " wave;",
            "predicted to first order in the displacements; order: as h falls at this Δx/h.",
        ]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.to_text()


def _residual(one: Residual | None) -> str:
    if one is None:
        return "-"
    return "exact" if one.exact else f"{one.residual:.1e}"


def _partner(one: Kept) -> str:
    return one.partner or f"none of the catalogue; {one.tried} leaves {one.energy.residual:.1e}"


def conserve(
    kernel: Kernel | str,
    dim: int = 2,
    *,
    dx_over_h: object = "5/6",
    kind: str | None = None,
    jitter: object = "1/10",
    forms: Sequence[str] = (),
    rules: Sequence[str] = (),
    lengths: str = "constant",
    mass_spread: float = 1.0,
    radius: float | None = None,
    h_over_lambda: object = "1/50",
    background: float = 1.0,
    amplitude: float = 0.5,
    seed: int = 0,
    predict: bool = True,
    workers: int | None = None,
) -> Balance:
    """Momentum equations on a ball of displaced lattice particles: what each keeps, at what error.

    dx_over_h, kind, jitter, seed: the lattice and its displacements; radius: of the ball, in Δx
        (default: so that some hundred particles are far from the edge)
    forms, rules: those of `FORMS` and of `FORCE_RULES` (none: all that go with the lengths)
    lengths: "constant"; "adapted", h = (h/Δx) (m/ρ)^{1/d}, ρ the summation; "random", h/2 to 2h
    mass_spread: masses at random from 1/s to s
    h_over_lambda, background, amplitude: of the pressure P₀ + P₁ sin(2πx/λ)
    predict: also predict the errors, where masses are equal and h is not random

    Raises ValueError for bad arguments, and too large a ball.
    """
    kernel = parse_kernel(kernel)
    if not isinstance(kernel, Kernel):
        raise ValueError(f"kernel: bounds need a polynomial, {kernel.name} is none; expected one")
    if lengths not in LENGTHS:
        raise ValueError(f"lengths: got {lengths!r}, expected one of {', '.join(LENGTHS)}")
    if not 1.0 <= mass_spread <= 1e3:
        raise ValueError(f"mass-spread: got {mass_spread:g}, expected a ratio from 1 to 1000")
    home = lattice(dim, kind, dx_over_h)
    scene: Lattice | Jittered = home
    sigma = float(exact(jitter, "jitter"))
    if sigma:
        scene = jittered(home, sigma, seed=seed)
    wide = (1.0 if lengths == "constant" else 1.5 if lengths == "adapted" else _SPREAD) * float(
        kernel.support
    )
    margin = 2.0 * wide / float(home.dx_over_h) + 2.0
    size = _INSIDE[dim] + margin if radius is None else float(radius)
    if not margin < size or size**dim * 4.2 > _MOST:
        raise ValueError(
            f"radius: got {size:g} Δx, expected more than {ceil(margin)} Δx, two supports, and at"
            f" most {int((_MOST / 4.2) ** (1 / dim))} Δx"
        )
    x, distance = displaced(scene, size)
    n = x.shape[1]
    random = np.random.default_rng(seed)
    volume = float(home.dx_over_h) ** dim
    mass = volume * np.exp(random.uniform(-1.0, 1.0, n) * np.log(mass_spread))
    h, density = np.ones(n), mass / volume
    if lengths == "adapted":
        found = adapted(x.T, mass, kernel, eta=1.0 / float(home.dx_over_h), workers=workers)
        h, density = found.h, found.density
    elif lengths == "random":
        h = np.exp(random.uniform(-1.0, 1.0, n) * np.log(_SPREAD))
    wave = wave_of(float(exact(h_over_lambda, "h-over-lambda")), background, amplitude)
    state = State(Cloud(x, h, kernel, workers=workers), mass, density, wave.pressure(x))
    inside = distance <= (size - margin) * float(home.dx_over_h)
    pairs = _pairs(forms, rules, lengths != "constant")
    known: Sequence[float | None] = [None] * len(pairs)
    if predict and lengths != "random" and mass_spread == 1.0:
        known = predicted_errors(pairs, home, kernel, sigma, wave, lengths == "adapted")
    still = not isinstance(scene, Jittered)
    settings = {
        "kernel": kernel.name,
        "dim": dim,
        "particles": n,
        "inside": int(np.count_nonzero(inside)),
        "dx_over_h": str(home.dx_over_h),
        "lattice": home.kind,
        "jitter": sigma,
        "lengths": lengths,
        "mass_spread": float(mass_spread),
        "h_over_lambda": float(exact(h_over_lambda, "h-over-lambda")),
        "background": float(background),
        "amplitude": float(amplitude),
        "seed": seed,
    }
    settings["scene"] = (
        f"{kernel.name}, {home.kind} lattice, Δx/h = {home.dx_over_h}, jitter"
        f" {settings['jitter']:g} Δx, {lengths} h"
    )
    measured = measured_errors(state, pairs, wave, inside)
    return _table(state, pairs, measured, known, settings, still, seed)


def conserve_particles(
    kernel: Kernel | str,
    columns: Mapping[str, Any],
    *,
    h: float | None = None,
    period: object = None,
    wave: Wave | None = None,
    forms: Sequence[str] = (),
    rules: Sequence[str] = (),
    seed: int = 0,
    workers: int | None = None,
) -> Balance:
    """The same on somebody's particles.

    columns: x (n, d), mass, and any of h, density (default: the summation), pressure (default:
        P₀ + P₁ sin along the first axis, as of `wave`), velocity (d, n), with which the energy
        changes (default: normal numbers)
    wave: a pressure whose acceleration is known, to measure errors of; lengths as of x

    Raises ValueError for columns that are missing or bad.
    """
    kernel = parse_kernel(kernel)
    if not isinstance(kernel, Kernel):
        raise ValueError(f"kernel: bounds need a polynomial, {kernel.name} is none; expected one")
    if "mass" not in columns:
        raise ValueError("mass: the particles have none; expected a column mass")
    lengths = columns.get("h") if h is None else h
    if lengths is None:
        raise ValueError("h: the particles have no smoothing length; expected a column or --h H")
    made = particles(columns["x"], h=lengths, volume=columns["mass"], period=period)
    density = grad_h(made, kernel, workers)[0]
    if "density" in columns:
        density = particles(columns["x"], h=lengths, mass=columns["density"]).mass
    assert made.given is not None
    pressure: Array
    if "pressure" in columns:
        pressure = _finite("pressure", columns["pressure"], density.shape)
    elif wave is not None:
        pressure = wave.pressure(made.x)
    else:
        raise ValueError("pressure: the particles have none; expected a column pressure")
    cloud = Cloud(made.x, made.h, kernel, period=made.period, workers=workers)
    state = State(cloud, made.given, density, pressure)
    varying = not bool(np.all(made.h == made.h[0]))
    pairs = _pairs(forms, rules, varying)
    measured: Sequence[float | None] = [None] * len(pairs)
    if wave is not None:
        inside = np.ones(made.population, dtype=np.bool_)
        if made.period is None:
            margin = 2.0 * float(kernel.support) * made.h.max()
            low, high = made.x.min(axis=1) + margin, made.x.max(axis=1) - margin
            inside = np.all((low <= made.x.T) & (high >= made.x.T), axis=1)
        if np.any(inside):
            measured = measured_errors(state, pairs, wave, inside)
    settings = {
        "kernel": kernel.name,
        "dim": made.dim,
        "particles": made.population,
        "lengths": "varying" if varying else "constant",
        "scene": f"{kernel.name}, particles of a file, {'varying' if varying else 'constant'} h",
        "seed": seed,
    }
    velocity = None
    if "velocity" in columns:
        velocity = _finite("velocity", columns["velocity"], made.x.shape)
    none: Sequence[float | None] = [None] * len(pairs)
    return _table(state, pairs, measured, none, settings, False, seed, velocity)


def _finite(name: str, values: Any, shape: tuple[int, ...]) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise ValueError(f"{name}: got shape {found.shape}, expected finite numbers {shape}")
    return found


def _pairs(forms: Sequence[str], rules: Sequence[str], varying: bool) -> list[tuple[str, str]]:
    pairs = list(combinations(forms, rules, varying))
    if not pairs:
        allowed = dict.fromkeys(rule for _, rule in combinations(forms, (), varying))
        raise ValueError(
            f"h-rule: {', '.join(rules)} goes with none of these forms and lengths; expected"
            f" {', '.join(allowed)}"
        )
    return pairs


def _table(
    state: State,
    pairs: list[tuple[str, str]],
    measured: Sequence[float | None],
    predicted: Sequence[float | None],
    settings: Mapping[str, Any],
    still: bool,
    seed: int,
    velocity: Array | None = None,
) -> Balance:
    rows = []
    for one, error, known in zip(
        kept(state, pairs, velocity, seed), measured, predicted, strict=True
    ):
        form = FORMS[one.form]
        power = order(form.correction, form.degree(one.rule), still)
        rows.append(Row(one, error, known, power))
    return Balance(settings, tuple(rows))


def order(correction: str, consistency: int, still: bool) -> int:
    """The power of h of an acceleration's error at fixed Δx/h.

    Displaced particles: the degree up to which the form is exact, −1 if it is not for a constant.
    On a lattice its symmetry makes every form exact for constants and removes the odd moments: what
    is left is the first moment, 1 for a corrected gradient, and then h².
    """
    if not still:
        return consistency
    return 2 if correction != "none" else 0
