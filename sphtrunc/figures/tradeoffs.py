"""Figures of choices: SPH beside finite differences, the best h and Δx, forms and precisions, error
against work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from math import inf, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.figures.disorder import (
    CSPH,
    DIFFERENCE,
    ERROR,
    SEED,
    STANDARD,
    logs,
    points,
    ratios,
    scene_at,
    splits,
    theory,
)
from sphtrunc.figures.picture import Curve, Field, Panel, Picture, measured, predicted, reference
from sphtrunc.figures.uniform import DX, H, named, wave_error
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.study.tuning import Problem, Setting, best_at_particles

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

SIGMA = 0.1
OFFSET = r"$(x_b - x_a)/\Delta x$"


def stencils(kernel: str | None, quick: bool) -> Picture:
    """SPH weights beside central differences, and what they make of waves, uniform and not."""
    shape = parse_kernel(kernel or "polynomial:4")
    ratio = Fraction(7, 10)
    home, moved = scene_at(1, ratio, 0.0), scene_at(1, ratio, SIGMA)
    panels = [
        _weights(shape, home, "uniform"),
        _weights(shape, moved, rf"irregular, $\sigma/\Delta x = {SIGMA:g}$"),
        _wavenumbers(shape, quick),
        _irregular(shape, moved, ratio, quick),
    ]
    return Picture("stencils", f"Gradient weights in 1D, {named(shape)}", tuple(panels))


def _weights(kernel: Kernel, scene: Any, title: str) -> Panel:
    """w_b Δx of one target: the standard form, and the parabola through three particles."""
    block = scene.neighbourhood(np.array([5]), kernel)
    s = block.offset[0, :, 0]
    order = np.argsort(s)
    order = order[np.abs(s[order]) < float(kernel.support)]
    ratio = float(scene.dx_over_h)
    x = s[order] / ratio
    w = -np.sign(x) * kernel.dw(np.abs(s[order])) * ratio**2
    middle = int(np.argmin(np.abs(x)))
    a, b = x[middle - 1], x[middle + 1]
    difference = [-b / (a * (a - b)), -(a + b) / (a * b), -a / (b * (b - a))]
    curves = (
        measured(f"SPH, $\\Delta x/h = {ratio:g}$", x, w),
        measured("central difference", [a, 0.0, b], difference),
    )
    return Panel(
        OFFSET,
        r"$w_b\,\Delta x$",
        curves,
        title=title,
        xscale="linear",
        yscale="linear",
        legend="upper left",
    )


def _wavenumbers(kernel: Kernel, quick: bool) -> Panel:
    """Modified wavenumber K: what the gradient makes of e^{ikx}, over i."""
    k = np.linspace(0.01, 1.0, 40 if quick else 100)  # kΔx/π
    coarse = np.linspace(0.05, 0.95, 7 if quick else 13)
    curves: list[Curve] = [
        reference("exact", k[k < 0.8], k[k < 0.8]),
        predicted("central difference", k, np.sin(pi * k) / pi),
    ]
    for ratio in (Fraction(1, 2), Fraction(7, 10), Fraction(1)):
        label = rf"SPH, $\Delta x/h = {float(ratio):g}$"
        curves.append(predicted(label, k, _modified(kernel, ratio, k)))
        lengths = [float(v) / (2 * float(ratio)) for v in coarse]
        (row,) = waves(lattice(1, dx_over_h=ratio), kernel, [STANDARD], lengths)
        seen = []
        for one, v in zip(row, coarse, strict=True):
            assert one.errors is not None
            phase = 2 * pi * (np.arange(one.errors.shape[1]) + 0.5) / one.errors.shape[1]
            seen.append(v * (1 + 2 * float((one.errors[0] * np.cos(phase)).mean())))
        curves.append(measured(label, coarse, seen, predicted=_modified(kernel, ratio, coarse)))
    return Panel(
        r"$k\Delta x/\pi$",
        r"modified wavenumber $K\Delta x/\pi$",
        tuple(curves),
        title="uniform",
        xscale="linear",
        yscale="linear",
    )


def _modified(kernel: Kernel, ratio: Fraction, k: Any) -> list[float]:
    """K Δx/π at kΔx/π."""
    errors = wave_error(kernel, ratio, [float(v) / (2 * float(ratio)) for v in k])
    return [float(v) * (1 + e) for v, e in zip(k, errors, strict=True)]


def _irregular(kernel: Kernel, scene: Any, ratio: Fraction, quick: bool) -> Panel:
    """rms error on irregular spacing against kΔx/π."""
    fine, coarse = logs(0.02, 0.9, 50), logs(0.02, 0.9, 6 if quick else 12)
    curves: list[Curve] = []
    for label, operator in (("standard", STANDARD), ("difference", DIFFERENCE), ("CSPH", CSPH)):
        line = sorted({*fine, *coarse})
        lengths = [v / (2 * float(ratio)) for v in line]
        at = dict(zip(line, theory(kernel, operator, scene, lengths), strict=True))
        curves.append(predicted(label, line, list(at.values())))
        lengths = [v / (2 * float(ratio)) for v in coarse]
        rtol = 0.02 if quick else 0.01
        (row,) = waves(scene, kernel, [operator], lengths, rtol=rtol, seed=SEED, workers=2)
        curves.append(points(label, coarse, row, [at[v] for v in coarse], operator))
    index = np.arange(20000)
    u = scene.displacement(index[None])[0]
    x = index + u
    a, b = x[:-2] - x[1:-1], x[2:] - x[1:-1]
    error = []
    for v in coarse:
        k = pi * v
        wave = sum(
            c * np.exp(1j * k * s)
            for c, s in (
                (-b / (a * (a - b)), a),
                (-(a + b) / (a * b), 0.0),
                (-a / (b * (b - a)), b),
            )
        )
        error.append(float(np.sqrt((np.abs(wave / (1j * k) - 1) ** 2).mean() / 2)))
    curves.append(measured("central difference (measured only)", coarse, error))
    return Panel(
        r"$k\Delta x/\pi$",
        "rms error / largest exact gradient",
        tuple(curves),
        title=rf"irregular, $\sigma/\Delta x = {SIGMA:g}$, $\Delta x/h = {float(ratio):g}$",
    )


def tuning(kernel: str | None, quick: bool) -> Picture:
    """Contours of the total error over (h/λ, Δx/h) with the best path, and the error across it."""
    shape = parse_kernel(kernel or "wendland-c4")
    dim, sigma = 3, 0.05
    problem = Problem(dim, DIFFERENCE, sigma)
    x = np.geomspace(2e-3, 0.4, 25 if quick else 40)
    r = np.geomspace(0.35, 1.2, 10 if quick else 24)
    z = []
    for value in r:
        splits = problem.split(shape, float(value), [float(v) for v in x])
        assert splits is not None
        z.append([split.total for split in splits])
    counts = (8, 16, 32, 64, 128)
    best = [
        best_at_particles(problem, shape, float(n))
        for n in np.geomspace(8, 200, 8 if quick else 14)
    ]
    inside = [s for s in best if r[0] <= s.dx_over_h <= r[-1]]
    label = r"$\log_{10}$ rms error"
    contours = Field(x, r, np.array(z), label)
    path = predicted(
        r"best at given $\lambda/\Delta x$",
        [s.h_over_lambda for s in inside],
        [s.dx_over_h for s in inside],
    )
    lines = [
        reference(rf"$\lambda/\Delta x = {n}$", *_hyperbola(n, x, r))
        for n in (counts[0], counts[2], counts[4])
    ]
    left = Panel(H, DX, (path, *lines), field=contours, legend="upper right")
    right: list[Curve] = []
    for n in counts[:3]:
        label = rf"$\lambda/\Delta x = {n}$"
        coarse = ratios(0.4, 1.1, 4 if quick else 8)
        fine = sorted({*ratios(0.35, 1.2, 24 if quick else 40), *coarse})
        right.append(predicted(label, [float(v) for v in fine], _across(problem, shape, n, fine)))
        found = []
        for value in coarse:
            scene = scene_at(dim, value, sigma)
            length = [1 / (n * float(value))]
            rtol = 0.03 if quick else 0.02
            ((one,),) = waves(scene, shape, [DIFFERENCE], length, rtol=rtol, seed=SEED, workers=2)
            found.append(one)
        expected = _across(problem, shape, n, coarse)
        right.append(points(label, [float(v) for v in coarse], found, expected))
    panels = (left, Panel(DX, "rms error / largest exact gradient", tuple(right)))
    caption = rf"Difference form, 3D, {named(shape)}, $\sigma/\Delta x = {sigma:g}$"
    return Picture("tuning", caption, panels)


def _hyperbola(n: float, x: Any, r: Any) -> tuple[Any, Any]:
    """h/λ and Δx/h at one λ/Δx, within the axes."""
    inside = [(1 / (n * v), v) for v in r if x[0] <= 1 / (n * v) <= x[-1]]
    return [a for a, _ in inside], [b for _, b in inside]


def _across(problem: Problem, kernel: Kernel, n: float, values: Sequence[Fraction]) -> list[float]:
    result = []
    for value in values:
        splits = problem.split(kernel, float(value), [1 / (n * float(value))])
        assert splits is not None
        result.append(splits[0].total)
    return result


def round_off(kernel: str | None, quick: bool) -> Picture:
    """Rounding errors of the gradient against h/λ with their predicted floors, form by form, in
    plain, compensated and extended precision; and the whole error, which turns up there."""
    shape = parse_kernel(kernel or "quintic-spline")
    scene = jittered(lattice(1, dx_over_h="1/2"), 0.0)  # undisplaced, every target of its own phase
    fine, coarse = logs(1e-8, 0.1, 60), logs(1e-8, 0.1, 4 if quick else 8)
    panels = []
    for precision in ("plain", "compensated", "extended"):
        curves: list[Curve] = []
        for form in ("standard", "difference", "paired"):
            operator = Operator("gradient", form)
            seen = [rounding_error(scene, shape, operator, x, precision) for x in coarse]
            floors = [s.rounding for s in splits(shape, operator, scene, fine, precision)]
            expected = [s.rounding for s in splits(shape, operator, scene, coarse, precision)]
            curves.append(predicted(form, fine, floors))
            curves.append(measured(form, coarse, seen, predicted=expected, floor=inf))
        label = "rms rounding error / largest exact gradient"
        panels.append(Panel(H, label, tuple(curves), title=precision, legend="upper right"))
    whole: list[Curve] = []
    for form, precision in (
        ("standard", "plain"),
        ("difference", "plain"),
        ("standard", "extended"),
    ):
        operator, field = Operator("gradient", form), [sinusoid(x) for x in coarse]
        total = [s.total for s in splits(shape, operator, scene, fine, precision)]
        found = [
            measure(scene, shape, operator, one, targets=400, precision=precision) for one in field
        ]
        expected = [s.total for s in splits(shape, operator, scene, coarse, precision)]
        label = f"{form}, {precision}"
        whole.append(predicted(label, fine, total))
        whole.append(replace(points(label, coarse, found, expected), floor=inf))
    panels.append(Panel(H, ERROR, tuple(whole), title="whole error", legend="upper center"))
    caption = rf"Gradient of a sinusoid on a lattice in 1D, {named(shape)}, $\Delta x/h = 1/2$"
    note = "lines: derived floors, typical to within a factor of five; points: measured"
    return Picture("round-off", caption, tuple(panels), note)


def rounding_error(
    scene: Any, kernel: Kernel, operator: Operator, h_over_lambda: float, precision: str
) -> float:
    """The rms rounding error of a measurement, against more digits."""
    finer = "exact" if precision == "extended" else "extended"
    found = [
        measure(scene, kernel, operator, sinusoid(h_over_lambda), targets=64, precision=p)
        for p in (precision, finer)
    ]
    high, low = ([np.zeros(1) if x is None else x for x in (m.errors, m.errors_low)] for m in found)
    difference = (high[0] - low[0]) + (high[1] - low[1])
    return float(np.sqrt((difference**2).sum(axis=0).mean()))


def work_precision(kernel: str | None, quick: bool) -> Picture:
    """Error against pairs per λ^d along the best path: forms, and kernels."""
    dim, sigma = 2, 0.05
    chosen = kernel or "wendland-c4"
    counts = [float(n) for n in np.geomspace(6, 200, 5 if quick else 9)]
    forms = [("standard", STANDARD), ("difference", DIFFERENCE), ("CSPH", CSPH)]
    left: list[Curve] = []
    for label, operator in forms:
        left += _along(Problem(dim, operator, sigma), chosen, label, counts, quick)
    right: list[Curve] = []
    names = ["cubic-spline", "quintic-spline", "wendland-c2", "wendland-c6", "polynomial:4"]
    for name in names[:: 2 if quick else 1]:
        right += _along(Problem(dim, CSPH, sigma), name, name, counts, quick)
    work = r"pairs per $\lambda^2$"
    error = "rms error / largest exact gradient"
    panels = (
        Panel(work, error, tuple(left), title=f"forms, {chosen}"),
        Panel(work, error, tuple(right), title="kernels, CSPH"),
    )
    caption = (
        rf"2D, $\sigma/\Delta x = {sigma:g}$, the best $\Delta x/h$ for every number of particles"
    )
    return Picture("work-precision", caption, panels)


def _along(
    problem: Problem, kernel: str, label: str, counts: Sequence[float], quick: bool
) -> list[Curve]:
    shape = parse_kernel(kernel)
    best: list[Setting] = [best_at_particles(problem, shape, n) for n in counts]
    work = [s.cost for s in best]
    found = []
    for s in best:
        ratio = Fraction(s.dx_over_h).limit_denominator(10**6)
        scene = scene_at(problem.dim, ratio, problem.sigma)
        rtol = 0.03 if quick else 0.02
        ((one,),) = waves(
            scene, shape, [problem.operator], [s.h_over_lambda], rtol=rtol, seed=SEED, workers=2
        )
        found.append(one)
    errors = [s.error.total for s in best]
    return [
        predicted(label, work, errors),
        points(label, work, found, errors, problem.operator),
    ]
