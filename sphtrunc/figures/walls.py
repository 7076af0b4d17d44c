"""Figures of walls, 1D: the error near one, what remedies leave, the place in the lattice."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import factorial, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.figures.picture import Curve, Panel, Picture, measured, predicted, slope
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.lattice import beside_wall, lattice
from sphtrunc.scenes.walls import Wall
from sphtrunc.theory.walls.moments import cut_moments, wall_lattice_moments

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

HALF = Fraction(1, 2)
DEGREE = 14  # of the moments that make the error of a wave
ETA = r"$\eta$, distance from the wall in $h$"

#: label: operator, ghosts, the moment of the leading error, its factor, its name
VALUES = [
    ("bare", Operator("value"), "none", 0, r"$A$"),
    ("shepard", Operator("value", "standard", "shepard"), "none", 1, r"$h\,A_n$"),
    ("rkpm-1", Operator("value", "standard", "rkpm-1"), "none", 2, r"$h^2A_{nn}$"),
    ("mirror", Operator("value"), "mirror", 1, r"$h\,A_n$"),
]
GRADIENTS = [
    ("bare", Operator("gradient"), "none", 0, r"$A/h$"),
    ("difference", Operator("gradient", "difference"), "none", 1, r"$A_n$"),
    ("csph", Operator("gradient", "difference", "csph"), "none", 2, r"$h\,A_{nn}$"),
    ("rkpm-1", Operator("gradient", "standard", "rkpm-1"), "none", 2, r"$h\,A_{nn}$"),
    ("mirror", Operator("gradient"), "mirror", 1, r"$A_n$"),
    ("odd", Operator("gradient"), "odd", 2, r"$h\,A_{nn}$"),
]


def _coefficient(operator: Operator, moments: Any, n: int) -> float:
    """(M_n − exact)/n!."""
    return float((moments[(n,)] - operator.target(1).get((n,), 0)) / factorial(n))


def wall_profile(kernel: str | None, quick: bool) -> Picture:
    """The coefficient of the leading error against the distance: derived, and on fine particles."""
    shape = parse_kernel(kernel or "cubic-spline")
    kappa = float(shape.support)
    ratio = Fraction(1, 16)
    line = [Fraction(i, 8 if quick else 40) for i in range(int(kappa * (8 if quick else 40)) + 1)]
    planes = range(0, int(kappa / float(ratio)), 8 if quick else 3)
    panels = []
    for title, rows in (("value", VALUES), ("gradient, normal to the wall", GRADIENTS)):
        curves: list[Curve] = []
        for label, operator, ghosts, n, unit in rows:
            y = [
                _coefficient(
                    operator, cut_moments(shape, operator, 1, n, Wall(eta, None, ghosts)), n
                )
                for eta in line
            ]
            name = f"{label}: {unit}"
            curves.append(predicted(name, [float(eta) for eta in line], y))
            x, seen, theory = [], [], []
            for m in planes:
                eta = (m + HALF) * ratio
                scene = beside_wall(lattice(1, dx_over_h=ratio), eta, at="half-way", ghosts=ghosts)
                found = measure(scene, shape, operator, moments=n).moments
                exact = wall_lattice_moments(shape, operator, scene, n)
                x.append(float(eta))
                seen.append(
                    float(_coefficient(operator, {k: v[0] for k, v in found.values.items()}, n))
                )
                theory.append(_coefficient(operator, exact, n))
            curves.append(measured(name, x, seen, predicted=theory, floor=1e-12))
        panels.append(
            Panel(
                ETA, "coefficient of the leading error", tuple(curves), title=title,
                xscale="linear", yscale="linear", legend="upper right",
            )
        )  # fmt: skip
    return Picture(
        "wall-profile",
        f"{shape.name} beside a wall: the leading error of each remedy (points: Δx/h = 1/16)",
        tuple(panels),
    )


def _beside(ratio: Fraction, wall: Wall) -> Arrangement:
    return Arrangement("uniform", ratio).beside(wall)


def _wave_error(
    shape: Kernel, operator: Operator, ratio: Fraction, wall: Wall, h_over_lambda: Sequence[float]
) -> list[float]:
    """The relative rms error of a wave over its phase, |Σ (ik)^n M_n/n! − exact|/√2."""
    moments = wall_lattice_moments(shape, operator, _beside(ratio, wall), DEGREE)
    errors = []
    for x in h_over_lambda:
        k = 2 * pi * x
        target = operator.target(1)
        total = sum(
            (1j * k) ** a[0] / factorial(a[0]) * float(m - target.get(a, 0))
            for a, m in moments.items()
        )
        errors.append(abs(total) / k**operator.derivatives / sqrt(2))
    return errors


def wall_convergence(kernel: str | None, quick: bool) -> Picture:
    """The error of a wave at the first particle against h/λ, remedy by remedy: orders −1 to 2."""
    shape = parse_kernel(kernel or "cubic-spline")
    ratio = Fraction(1, 4)
    lengths = np.geomspace(1e-3, 0.05, 5 if quick else 9)
    fine = np.geomspace(1e-3, 0.05, 40)
    panels = []
    for title, rows in (("value", VALUES), ("gradient", GRADIENTS)):
        curves: list[Curve] = []
        for label, operator, ghosts, _, _ in rows:
            wall = Wall(ratio / 2, HALF, ghosts)
            scene = beside_wall(lattice(1, dx_over_h=ratio), wall.eta, at=HALF, ghosts=ghosts)
            curves.append(
                predicted(label, fine, _wave_error(shape, operator, ratio, wall, fine.tolist()))
            )
            seen = []
            for x in lengths:
                found: Any = measure(scene, shape, operator, sinusoid(float(x), None, 1)).error
                seen.append(found["rms"])
            theory = _wave_error(shape, operator, ratio, wall, lengths.tolist())
            curves.append(measured(label, lengths, seen, predicted=theory, floor=1e-12))
        lines = {c.label: c.y for c in curves if c.kind == "predicted"}
        chosen = (
            [("shepard", 1), ("rkpm-1", 2)] if title == "value" else [("bare", -1), ("csph", 1)]
        )
        for label, power in chosen:
            curves.append(
                slope(f"$h^{{{power}}}$", power, (2e-3, 2e-2), (1e-3, 2 * lines[label][0]))
            )
        panels.append(Panel(r"$h/\lambda$", f"relative rms error of the {title}", tuple(curves)))
    return Picture(
        "wall-convergence",
        f"{shape.name}, Δx/h = 1/4, at the first particle, half a spacing from the wall",
        tuple(panels),
    )


def _added(
    shape: Kernel, operator: Operator, ratio: Fraction, places: Sequence[Fraction]
) -> list[float]:
    """M_0 at η = 1/2 less its limit, for every place of the wall in the lattice."""
    limit = cut_moments(shape, operator, 1, 0, Wall(HALF))[(0,)]
    return [
        float(wall_lattice_moments(shape, operator, _beside(ratio, Wall(HALF, p)), 0)[(0,)] - limit)
        for p in places
    ]


def wall_lattice(kernel: str | None, quick: bool) -> Picture:
    """What the place of the wall in the lattice adds, over one spacing, at three ratios."""
    shape = parse_kernel(kernel or "cubic-spline")
    panels = []
    for title, operator in (("value", Operator("value")), ("gradient", Operator("gradient"))):
        curves: list[Curve] = []
        for ratio in (Fraction(1, 2), Fraction(1, 4), Fraction(1, 8)):
            limit = cut_moments(shape, operator, 1, 0, Wall(HALF))[(0,)]

            places = [Fraction(2 * i + 1, 80) for i in range(40)]
            label = f"Δx/h = {ratio}"
            curves.append(
                predicted(label, [float(p) for p in places], _added(shape, operator, ratio, places))
            )
            some = places[2 :: 9 if quick else 4]
            seen = []
            for place in some:
                scene = beside_wall(lattice(1, dx_over_h=ratio), HALF, at=place)
                moment = measure(scene, shape, operator, moments=0).moments[(0,)]
                seen.append(float(moment[0]) - float(limit))
            theory = _added(shape, operator, ratio, some)
            curves.append(
                measured(label, [float(p) for p in some], seen, predicted=theory, floor=1e-12)
            )
        panels.append(
            Panel(
                "steps from the wall to the first particles", r"$M_0$ − limit", tuple(curves),
                title=title, xscale="linear", yscale="linear",
                legend="upper right" if title == "value" else "lower right",
            )
        )  # fmt: skip
    return Picture(
        "wall-lattice",
        f"{shape.name}, η = 1/2: the wall anywhere between two particles",
        tuple(panels),
    )
