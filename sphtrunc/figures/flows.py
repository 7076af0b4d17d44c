"""Figures of flows: the error of a solution against N, and the lid-driven cavity."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.figures.picture import Curve, Field, Panel, Picture, measured, predicted, slope
from sphtrunc.study.flows.cavity import published
from sphtrunc.study.flows.flow import flow
from sphtrunc.study.flows.results import Lid, Steady, Vortex

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.study.flows.cavity import Profile

SIGMA = "1/10"
RATIO = "2/3"
#: label: form, correction
FORMS = {
    "Brookshaw": ("brookshaw", "none"),
    "difference": ("difference", "none"),
    "direct": ("direct", "none"),
    "Fatehi-Manzari": ("fatehi-manzari", "none"),
    "difference, RKPM-2": ("difference", "rkpm-2"),
    "nested": ("nested", "none"),
}
ACROSS = "particles across, $N$"
ERROR = "rms error / largest velocity"
#: of the cavity: label: form, correction, σ/Δx
LIDS = {
    "corrected, displaced": ("difference", "rkpm-2", SIGMA),
    "uncorrected, uniform": ("brookshaw", "none", None),
    "uncorrected, displaced": ("brookshaw", "none", SIGMA),
}
SEED = 1


def flow_error(kernel: str | None, quick: bool) -> Picture:
    """The error of Poiseuille flow against N: uniform, beside bare walls, displaced; and the decay
    of the Taylor–Green vortex."""
    shape = kernel or "wendland-c2"
    fine = (16, 24, 40) if quick else (16, 20, 28, 40, 56, 80, 112, 160)
    coarse = (10, 14) if quick else (10, 14, 20, 28, 40)
    shaken: tuple[str, ...] = ("Brookshaw", "Fatehi-Manzari")
    if not quick:
        shaken = ("Brookshaw", "difference", "Fatehi-Manzari", "difference, RKPM-2")
    panels = (
        Panel(
            ACROSS,
            ERROR,
            (
                *_errors(shape, fine, ("Brookshaw", "difference", "Fatehi-Manzari", "direct",
                                       "difference, RKPM-2"), dim=1),
                slope("$N^{-2}$", -2, (16, 40), (16, 2e-3)),
            ),
            title="Poiseuille, uniform, mirrored walls",
            legend="lower left",
        ),
        Panel(
            ACROSS,
            ERROR,
            (
                *_errors(shape, fine, ("Brookshaw", "difference", "direct", "nested"), dim=1,
                         wall="none"),
                slope("$N^{-1}$", -1, (16, 40), (16, 0.2)),
            ),
            title="Poiseuille, uniform, bare walls (the corrected forms are exact)",
            legend="lower left",
        ),
        Panel(
            ACROSS,
            ERROR,
            (
                *_errors(shape, coarse, shaken, jitter=SIGMA),
                slope("$N^{-2}$", -2, (12, 30), (12, 4e-3)),
            ),
            title=r"Poiseuille, $\sigma/\Delta x = 0.1$, mirrored walls",
            legend="lower left",
        ),
        Panel(
            ACROSS,
            "relative error of the decay rate",
            tuple(_decays(shape, (12, 20) if quick else (12, 16, 24, 32, 48, 64))),
            title="Taylor-Green vortex, uniform",
            legend="lower left",
        ),
    )  # fmt: skip
    return Picture("flow-error", f"{shape}, Δx/h = {RATIO}: errors of solutions", panels)


def _errors(shape: str, numbers: Sequence[int], labels: Sequence[str], **given: Any) -> list[Curve]:
    """Predicted and measured rms errors of Poiseuille flow, form by form."""
    curves: list[Curve] = []
    for label in labels:
        form, correction = FORMS[label]
        found = [
            flow("poiseuille", shape, across=n, form=form, correction=correction, dx_over_h=RATIO,
                 **given)
            for n in numbers
        ]  # fmt: skip
        seen = [one.rms for one in found if isinstance(one, Steady)]
        theory = [one.predicted for one in found if isinstance(one, Steady)]
        known = [p for p in theory if p is not None]
        if len(known) < len(seen):  # no theory
            curves.append(measured(label, numbers, seen))
            continue
        expected = [p.total for p in known]
        width = np.array([2.0 * p.scatter + p.known_to for p in known])
        curves.append(predicted(label, numbers, expected))
        bars: dict[str, Any] = {}
        if width.any():
            bars = {"low": np.array(seen) / (1 + width), "high": np.array(seen) * (1 + width)}
        curves.append(measured(label, numbers, seen, predicted=expected, floor=1e-11, **bars))
    return curves


def _decays(shape: str, numbers: Sequence[int]) -> list[Curve]:
    """Predicted and measured errors of the decay rate, form by form."""
    curves: list[Curve] = []
    for label in ("Brookshaw", "difference", "Fatehi-Manzari", "difference, RKPM-2", "nested"):
        form, correction = FORMS[label]
        found = [
            flow("taylor-green", shape, across=n, form=form, correction=correction, dx_over_h=RATIO)
            for n in numbers
        ]
        decays = [one.decay for one in found if isinstance(one, Vortex)]
        theory = [d.predicted_error or 0.0 for d in decays]
        curves.append(predicted(label, numbers, theory))
        seen = [d.error for d in decays]
        curves.append(measured(label, numbers, seen, predicted=theory, floor=1e-11))
    return curves


@cache
def _lid(shape: str, side: int, reynolds: float, form: str, correction: str, sigma: Any) -> Lid:
    steps = [re for re in (100.0, 400.0) if re < reynolds]
    found = flow(
        "cavity", shape, across=side, form=form, correction=correction, jitter=sigma, seed=SEED,
        reynolds=[*steps, reynolds],
    )  # fmt: skip
    assert isinstance(found, Lid)
    return found


def _last(found: Lid) -> Profile:
    return found.cavity.profiles[-1]


def cavity_lines(kernel: str | None, quick: bool) -> Picture:
    """u and v on the centre lines, corrected and not, beside the published table."""
    shape = kernel or "wendland-c2"
    side, reynolds = (17, 100.0) if quick else (65, 1000.0)
    table, name = published()["ghia"], f"{reynolds:g}"
    panels = []
    for component, line, along in (
        ("u", "vertical centre line, $y$", table["y"]),
        ("v", "horizontal centre line, $x$", table["x"]),
    ):
        curves: list[Curve] = []
        for label, setting in LIDS.items():
            profile = _last(_lid(shape, side, reynolds, *setting))
            y = profile.u_line if component == "u" else profile.v_line
            curves.append(predicted(label, profile.along, y))
        curves.append(measured("Ghia, Ghia & Shin 1982", along, table[component][name]))
        panels.append(
            Panel(
                line, f"${component}$ / speed of the lid", tuple(curves), xscale="linear",
                yscale="linear", legend="upper left" if component == "u" else "lower left",
            )
        )  # fmt: skip
    return Picture(
        "cavity-lines",
        f"{shape}: the lid-driven cavity at Re {name} on {side}² particles, σ/Δx = 0.1",
        tuple(panels),
        note="lines: solved, points: published",
    )


def cavity_map(kernel: str | None, quick: bool) -> Picture:
    """Streamlines with the eddies of the corners, and the error of the velocity, corrected and not,
    against twice as many particles along each side, uniform and corrected."""
    shape = kernel or "wendland-c2"
    side, reynolds = (17, 100.0) if quick else (65, 1000.0)
    best = _lid(shape, 2 * side - 1, reynolds, "difference", "rkpm-2", None)
    line = np.linspace(0.0, 1.0, side)
    inner = line[1:-1]
    psi = np.abs(_on_grid(_last(best).psi, 2 * side - 1))[2:-2:2, 2:-2:2]
    panels = [
        _map(
            inner, np.maximum(psi, 1e-7).T, r"$\log_{10}|\psi|$", "streamlines, corrected, uniform"
        )
    ]
    for label in ("corrected, displaced", "uncorrected, displaced"):
        found = _lid(shape, side, reynolds, *LIDS[label])
        error = _velocity_error(found, best)
        panels.append(
            _map(inner, np.maximum(error, 1e-7).T, r"$\log_{10}$ error of the velocity", label)
        )
    return Picture(
        "cavity-map",
        f"{shape}: the lid-driven cavity at Re {reynolds:g}, {side}² particles against"
        f" {2 * side - 1}²",
        tuple(panels),
        note="contours twice a decade",
    )


def _on_grid(values: Array, side: int) -> Array:
    return values.reshape(side, side)


def _velocity_error(found: Lid, best: Lid) -> Array:
    """|velocity − that of the best| at the inner places of the coarse grid, (k, k); both by cubic
    interpolation between particles."""
    from scipy.interpolate import CloughTocher2DInterpolator

    side = found.cavity.side
    line = np.linspace(0.0, 1.0, side)[1:-1]
    x, y = np.meshgrid(line, line, indexing="ij")
    square = 0.0
    for name in ("u", "v"):
        there = CloughTocher2DInterpolator(found.cavity.x.T, getattr(_last(found), name))(x, y)
        fine = _on_grid(getattr(_last(best), name), best.cavity.side)[2:-2:2, 2:-2:2]
        square = square + (there - fine) ** 2
    return np.asarray(np.sqrt(square))


def _map(line: Array, z: Array, label: str, title: str) -> Panel:
    """A field over the square."""
    return Panel(
        "$x$", "$y$", (), title=title, xscale="linear", yscale="linear", legend=None,
        field=Field(line, line, z, label),
    )  # fmt: skip
