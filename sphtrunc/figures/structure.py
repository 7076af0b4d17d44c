"""Figures of kinds of disorder: structure factors, what they do to a sum over the particles, and
how it falls as particles relax."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np

from sphtrunc.experiment.glasses import glass
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.relaxation import relax, with_h
from sphtrunc.figures.picture import (
    Curve,
    Panel,
    Picture,
    measured,
    predicted,
    reference,
    slope,
)
from sphtrunc.figures.uniform import named
from sphtrunc.kernels.conventions import BALL
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.particles import particles
from sphtrunc.scenes.probes import probes
from sphtrunc.scenes.relaxed import Recipe
from sphtrunc.study.structure import predict_by_structure, structure_factor
from sphtrunc.theory.disorder.structure_factor import StructureFactor, displaced, poisson

GRADIENT = Operator("gradient")
SEED = 7
SHAKEN = 0.1  # σ/Δx of the displaced lattices
SHIFT = ("wendland-c2", 1.5)  # kernel and h/Δx of the shifted glass


def scattered(side: int, kind: str, seed: int = SEED) -> Any:
    """Particles in 2D in a periodic box, spacing 1: independent, or a square lattice displaced by
    σ/Δx = 0.1, "gaussian" or "blue"."""
    rng = np.random.default_rng([seed, len(kind)])  # a sample of its own for each
    if kind == "independent":
        return particles(rng.random((side**2, 2)) * side, h=1.0, volume=1.0, period=float(side))
    points = np.stack([a.ravel() for a in np.meshgrid(*[np.arange(side)] * 2, indexing="ij")])
    u = rng.normal(size=(2, side, side))
    if kind == "blue":
        around = sum(np.roll(u, s, axis) for s in (1, -1) for axis in (1, 2))
        u = (u - np.asarray(around) / 4) / sqrt(1.25)
    x = points + SHAKEN * u.reshape(2, -1)
    return particles(x.T, h=1.0, volume=1.0, period=float(side))


#: label, kind and S in closed form of what is made at random
RANDOM: list[tuple[str, str, StructureFactor]] = [
    ("independent", "independent", poisson(2)),
    (r"displaced, $\sigma = 0.1\,\Delta x$", "gaussian", displaced("square", SHAKEN)),
    ("displaced, blue noise", "blue", displaced("square", SHAKEN, "blue")),
]


def glasses(quick: bool) -> list[tuple[str, Any]]:
    """Label and particles of the two sorts of glass."""
    count, steps = (32**2, 100) if quick else (64**2, 300)
    repelled = Recipe(count=count, seed=SEED, steps=steps)
    shifted = replace(repelled, kernel=SHIFT[0], h_over_dx=SHIFT[1])
    return [
        ("glass, pair repulsion", glass(repelled).particles),
        (r"glass, SPH shifting", glass(shifted).particles),
    ]


def structure(kernel: str | None, quick: bool) -> Picture:
    """S(k) of each kind in 2D: in closed form and the mean over boxes, and of one box of each glass
    with its plateau."""
    curves: list[Curve] = []
    side, boxes = (32, 16) if quick else (64, 16)
    for label, kind, law in RANDOM:
        found = [
            off_peaks(structure_factor(scattered(side, kind, SEED + i), reach=5.5))
            for i in range(boxes)
        ]
        assert found[0].k is not None
        mean = replace(found[0], S=np.stack([np.asarray(one.S) for one in found]).mean(axis=0))
        k, S, _ = mean.radial(24)
        # where S is known itself, Σ S² is not halved
        _, theory, error = replace(mean, S=law(found[0].k)).radial(24)
        error = 1.96 * error * sqrt(2 / boxes)
        curves.append(predicted(label, k, theory))
        curves.append(measured(label, k, S, low=S - error, high=S + error, predicted=theory))
    for label, scene in glasses(quick):
        factor = structure_factor(scene)
        fit = factor.fit()
        k, S, error = factor.radial(24)
        label = f"{label}, $S_0$ = {fit.plateau:.1e}"
        curves.append(measured(label, k, S, low=S - 1.96 * error, high=S + 1.96 * error))
        ends = np.array([k[0], fit.upto])
        curves.append(reference("", ends, fit.plateau + 0 * ends))
    panel = Panel(r"$k\,\Delta x$", "structure factor $S(k)$", tuple(curves), legend="lower right")
    return Picture("structure", "Structure factors of five kinds of disorder, 2D", (panel,))


def off_peaks(factor: StructureFactor) -> StructureFactor:
    """The modes that are no reciprocal vectors of the square lattice."""
    assert factor.k is not None
    assert factor.S is not None
    turns = factor.k / (2 * np.pi)
    peak = np.all(np.abs(turns - np.rint(turns)) < 1e-6, axis=0)
    return StructureFactor(2, factor.by, k=factor.k[:, ~peak], S=factor.S[~peak])


def spread(
    scene: Any, kernel: Any, h: float, count: int, at: str = "random"
) -> tuple[float, float, float]:
    """Standard deviation of M_0 of the gradient, measured and its standard error, and predicted."""
    home = with_h(scene, h)
    chosen = probes(home, count, seed=SEED) if at == "random" else home
    values = measure(chosen, kernel, GRADIENT, moments=0, workers=2).moments.values[0, 0]
    x = values - values.mean()
    kurtosis = float((x**4).mean()) / max(float((x**2).mean()) ** 2, 1e-300)
    error = values.std() * sqrt(max(kurtosis - 1.0, 0.0) / (4 * values.size))
    found = predict_by_structure(chosen, kernel, GRADIENT, 0).std[0, 0]
    return float(values.std()), float(error), found


def disorder_kinds(kernel: str | None, quick: bool) -> Picture:
    """std of M_0 of the gradient between the particles, against neighbours, each kind in 2D."""
    shape = parse_kernel(kernel or "wendland-c2")
    support = float(shape.support)
    side = 32 if quick else 64
    most = min(4.5, 0.45 * side / support)
    fine = np.geomspace(1.1, most, 12 if quick else 20)
    coarse = np.geomspace(1.1, most, 4 if quick else 8)
    count = 2000 if quick else 6000
    curves: list[Curve] = []
    scenes = [(label, scattered(side, kind)) for label, kind, _ in RANDOM] + glasses(quick)
    for label, scene in scenes:
        line = sorted({*fine.tolist(), *coarse.tolist()})
        neighbours = {h: float(BALL[2]) * (support * h) ** 2 for h in line}
        predict_by_structure(scene, shape, GRADIENT, 0)  # S is measured once, whatever h
        theory = [
            predict_by_structure(probes(with_h(scene, h), 8), shape, GRADIENT, 0).std[0, 0]
            for h in line
        ]
        curves.append(predicted(label, [neighbours[h] for h in line], theory))
        rows = [spread(scene, shape, float(h), count) for h in coarse]
        expected = [dict(zip(line, theory, strict=True))[float(h)] for h in coarse]
        values = np.array([row[0] for row in rows])
        error = 1.96 * np.array([row[1] for row in rows])
        curves.append(
            measured(
                label,
                [neighbours[float(h)] for h in coarse],
                values,
                low=values - error,
                high=values + error,
                predicted=expected,
            )
        )
    for alpha, through in ((0, (40.0, 0.16)), (2, (40.0, 0.085))):
        q = (2 + alpha) / 2
        curves.append(
            slope(rf"$\alpha = {alpha}$", -q / 2, (40.0, 200.0), through)  # N_nb ∝ (h/Δx)²
        )
    panel = Panel(
        r"neighbours $N_{nb}$", r"std of $M_0$ of the gradient", tuple(curves), legend="lower left"
    )
    caption = f"Gradient noise between the particles, 2D, {named(shape)}"
    return Picture("disorder-kinds", caption, (panel,))


def relaxation(kernel: str | None, quick: bool) -> Picture:
    """std of M_0 at the particles and between them, against steps of relaxation, 2D."""
    shape = parse_kernel(kernel or "wendland-c2")
    steps = [1, 2, 4, 8, 16, 40] if quick else [1, 2, 4, 8, 16, 32, 64, 128]
    side, h = (24, 1.5) if quick else (48, 1.5)
    count = 2000 if quick else 8000
    rows: dict[str, list[tuple[float, float, float]]] = {"random": [], "particles": []}
    for n in steps:
        made = relax(
            Recipe(
                count=side**2,
                kernel=kernel or "wendland-c2",
                h_over_dx=h,
                seed=SEED,
                steps=n,
                residual=1e-12,
            )
        )
        for at, found in rows.items():
            found.append(spread(made.particles, shape, h, count, at))
    curves: list[Curve] = []
    for at, label in (("random", "between the particles"), ("particles", "at the particles")):
        values = np.array([row[0] for row in rows[at]])
        error = 1.96 * np.array([row[1] for row in rows[at]])
        theory = None
        if at == "random":
            theory = [row[2] for row in rows[at]]
            curves.append(predicted(label, steps, theory))
        curves.append(
            measured(
                label, steps, values, low=values - error, high=values + error, predicted=theory
            )
        )
    panel = Panel("steps", r"std of $M_0$ of the gradient", tuple(curves), legend="lower left")
    caption = rf"Shifting along $-\nabla\Sigma VW$, 2D, {named(shape)}, $h = 1.5\,\Delta x$"
    return Picture("relaxation", caption, (panel,))
