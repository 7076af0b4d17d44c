"""Figures of disordered particles: standard, difference and corrected forms in one and three
dimensions, and kinds of disorder of equal size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.figures.picture import Curve, Panel, Picture, measured, predicted, slope
from sphtrunc.figures.uniform import DX, H, named
from sphtrunc.kernels.conventions import BALL
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import FATEHI_MANZARI
from sphtrunc.scenes.graded import graded
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.study.structure import errors_by_structure
from sphtrunc.theory.field_error import Split, predict_waves
from sphtrunc.theory.fields import Waves

if TYPE_CHECKING:
    from sphtrunc.experiment.measurement import Measurement
    from sphtrunc.kernels.kernel import Kernel

ERROR = "rms error / largest exact gradient"
STANDARD = Operator("gradient")
DIFFERENCE = Operator("gradient", "difference")
CSPH = Operator("gradient", "difference", "csph")
RKPM = Operator("gradient", "standard", "rkpm-1")
SEED = 7
NEIGHBOURS = r"neighbours $N_{nb}$"
SPREAD = "the spread at particles is taken to be that between them"
BEYOND = "the prediction is to first order in the algebra of the correction"


def scene_at(
    dim: int,
    ratio: Fraction,
    sigma: float,
    distribution: str = "gaussian",
    volume: str = "constant",
) -> Any:
    """A jittered lattice, or the lattice itself; large enough for any number of targets."""
    extent = 2**20 if dim == 1 else 1000
    home = lattice(dim, dx_over_h=ratio, volume=volume, extent=extent)
    return jittered(home, sigma, distribution, SEED) if sigma else home


def splits(
    kernel: Kernel,
    operator: Operator,
    scene: Any,
    lengths: Sequence[float],
    precision: str = "plain",
) -> list[Split]:
    """Predicted errors and their parts."""
    return predict_waves(kernel, operator, scene, lengths, precision=precision)


def theory(kernel: Kernel, operator: Operator, scene: Any, lengths: Sequence[float]) -> list[float]:
    """Predicted rms errors."""
    return [split.total for split in splits(kernel, operator, scene, lengths)]


def points(
    label: str,
    x: Sequence[float],
    found: Sequence[Measurement],
    predictions: Sequence[float] | None,
    operator: Operator = STANDARD,
) -> Curve:
    """Measured points with their confidence intervals."""
    errors = [m.error for m in found]
    kept = [(a, e, i) for i, (a, e) in enumerate(zip(x, errors, strict=True)) if e is not None]
    return measured(
        label,
        [a for a, _, _ in kept],
        [e["rms"] for _, e, _ in kept],
        low=[e["rms_ci95"][0] for _, e, _ in kept],
        high=[e["rms_ci95"][1] for _, e, _ in kept],
        predicted=None if predictions is None else [predictions[i] for _, _, i in kept],
        floor=100 * UNIT / (2 * pi * min(x)),
        beyond="" if operator.correction == "none" and operator.form != FATEHI_MANZARI else BEYOND,
    )


def against_h(
    kernel: Kernel,
    cases: Sequence[tuple[str, Operator, Any]],
    fine: Sequence[float],
    coarse: Sequence[float],
    rtol: float,
) -> list[Curve]:
    """Curves and points against h/λ; a case is (label, operator, scene)."""
    curves: list[Curve] = []
    for label, operator, scene in cases:
        line = sorted({*fine, *coarse})  # the curve is drawn through every point
        at = dict(zip(line, theory(kernel, operator, scene, line), strict=True))
        curves.append(predicted(label, line, list(at.values())))
        ((row),) = waves(scene, kernel, [operator], coarse, rtol=rtol, seed=SEED, workers=2)
        curves.append(points(label, coarse, row, [at[x] for x in coarse], operator))
    return curves


def against_dx(
    kernel: Kernel,
    cases: Sequence[tuple[str, Operator, int, float]],
    length: float,
    fine: Sequence[Fraction],
    coarse: Sequence[Fraction],
    rtol: float,
    neighbours: bool = False,
) -> list[Curve]:
    """Curves and points against Δx/h, or against the number of neighbours; a case is (label,
    operator, dim, σ/Δx)."""
    curves: list[Curve] = []
    for label, operator, dim, sigma in cases:

        def x(ratio: Fraction, dim: int = dim) -> float:
            if not neighbours:
                return float(ratio)
            return float(BALL[dim]) * (float(kernel.support) / float(ratio)) ** dim

        line = sorted({*fine, *coarse})
        at = {r: theory(kernel, operator, scene_at(dim, r, sigma), [length])[0] for r in line}
        curves.append(predicted(label, [x(r) for r in line], list(at.values())))
        found = []
        for ratio in coarse:
            scene = scene_at(dim, ratio, sigma)
            ((one,),) = waves(scene, kernel, [operator], [length], rtol=rtol, seed=SEED, workers=2)
            found.append(one)
        expected = [at[r] for r in coarse]
        curves.append(points(label, [x(r) for r in coarse], found, expected, operator))
    return curves


def ratios(first: float, last: float, n: int) -> list[Fraction]:
    """n simple rationals, evenly in the logarithm."""
    return [Fraction(float(x)).limit_denominator(1000) for x in np.geomspace(first, last, n)]


def logs(first: float, last: float, n: int) -> list[float]:
    """n numbers, evenly in the logarithm."""
    return [float(x) for x in np.geomspace(first, last, n)]


def disorder_h(kernel: str | None, quick: bool) -> Picture:
    """σ/Δx from 0 to 0.2 at Δx/h = 4/11."""
    shape = parse_kernel(kernel or "polynomial:4")
    cases = [
        (rf"$\sigma/\Delta x = {s:g}$", STANDARD, scene_at(1, Fraction(4, 11), s))
        for s in (0.0, 0.001, 0.01, 0.05, 0.2)
    ]
    coarse = logs(1e-4, 0.5, 7 if quick else 15)
    curves = against_h(shape, cases, logs(1e-4, 0.5, 60), coarse, 0.02 if quick else 0.01)
    curves.append(slope(r"$\propto 1/h$", -1, (2e-4, 3e-3), (1e-3, 2e1)))
    panel = Panel(H, ERROR, tuple(curves), legend="upper right")
    caption = rf"Standard gradient, 1D, {named(shape)}, $\Delta x/h = 4/11$"
    return Picture("disorder-h", caption, (panel,))


def disorder_dx(kernel: str | None, quick: bool) -> Picture:
    """The same against Δx/h at h/λ = 0.022."""
    shape = parse_kernel(kernel or "polynomial:4")
    cases = [(rf"$\sigma/\Delta x = {s:g}$", STANDARD, 1, s) for s in (0.0, 0.001, 0.01, 0.05, 0.2)]
    curves = against_dx(
        shape,
        cases,
        0.022,
        ratios(0.1, 1.2, 200),
        ratios(0.1, 1.2, 6 if quick else 12),
        0.02 if quick else 0.01,
    )
    curves.append(slope(r"$\propto (\Delta x/h)^{3/2}$", 1.5, (0.11, 0.5), (0.2, 2.0)))
    panel = Panel(DX, ERROR, tuple(curves), legend="lower left", ylim=(2e-5, 20))
    caption = rf"Standard gradient, 1D, {named(shape)}, $h/\lambda = 0.022$"
    return Picture("disorder-dx", caption, (panel,))


def randomness(kernel: str | None, quick: bool) -> Picture:
    """Kinds of disorder of equal σ: independent, uniform, blue, relaxed, graded."""
    shape = parse_kernel(kernel or "polynomial:4")
    sigma, ratio = 0.1, Fraction(1, 2)
    fine, coarse = logs(1e-3, 0.4, 60), logs(1e-3, 0.4, 6 if quick else 12)
    rtol = 0.02 if quick else 0.01
    panels = []
    for title, operator in (("standard form", STANDARD), ("CSPH", CSPH)):
        cases = [
            (label, operator, scene_at(1, ratio, sigma, name))
            for label, name in (
                ("Gaussian", "gaussian"),
                ("uniform", "uniform"),
                ("blue noise", "blue"),
            )
        ]
        curves = against_h(shape, cases, fine, coarse, rtol)
        ring = relaxed(float(ratio), sigma, 2000 if quick else 20000)
        line = sorted({*fine, *coarse})
        signals = Waves(2 * pi * np.array(line), np.ones(1))
        found = errors_by_structure(ring, shape, operator, signals)
        at = {x: split.total for x, split in zip(line, found, strict=True)}
        curves.append(predicted("relaxed, from its S(k)", line, list(at.values())))
        (row,) = waves(ring, shape, [operator], coarse, seed=SEED, workers=2)
        seen = points("relaxed, from its S(k)", coarse, row, [at[x] for x in coarse], operator)
        curves.append(replace(seen, beyond=SPREAD))
        graded_line = waving(float(ratio), sigma, 100 if quick else 400)
        (row,) = waves(graded_line, shape, [operator], coarse, seed=SEED, workers=2)
        curves.append(points("graded (measured only)", coarse, row, None))
        panels.append(Panel(H, ERROR, tuple(curves), title=title))
    caption = rf"1D, {named(shape)}, $\Delta x/h = 1/2$, displacements of $\sigma/\Delta x = 0.1$"
    return Picture("randomness", caption, tuple(panels))


def relaxed(ratio: float, sigma: float, n: int, steps: int = 20) -> Any:
    """Particles on a ring that repel their neighbours from random places, rescaled to σ/Δx.

    A linear repulsion: each step moves a particle by a quarter of the difference of its two gaps.
    """
    from sphtrunc.scenes.particles import particles

    rng = np.random.default_rng(SEED)
    u = rng.normal(size=n)
    for _ in range(steps):
        u = u + 0.25 * (np.roll(u, 1) + np.roll(u, -1) - 2 * u)
    u *= sigma / u.std()
    x = ratio * (np.arange(n) + u)
    return particles(x[:, None] % (n * ratio), h=1.0, volume=np.full(n, ratio), period=n * ratio)


def waving(ratio: float, sigma: float, n: int) -> Any:
    """A smooth grading: displacements σ√2 sin(2πx/20h), so that their standard deviation is σΔx."""
    q = 2 * pi / 20
    amplitude = sigma * ratio * np.sqrt(2.0) * q
    return graded(
        lambda x: ratio / (1 - amplitude * np.cos(q * x)), x=np.linspace(0, 20, n, endpoint=False)
    )


def first_order(kernel: str | None, quick: bool) -> Picture:
    """Corrected against standard and difference forms at Δx/h = 0.7."""
    shape = parse_kernel(kernel or "polynomial:4")
    ratio, sigma = Fraction(7, 10), 0.05
    names = ("standard", "difference", "CSPH", "RKPM-1")
    cases = [
        (label, operator, scene_at(1, ratio, sigma))
        for label, operator in zip(names, (STANDARD, DIFFERENCE, CSPH, RKPM), strict=True)
    ]
    coarse = logs(1e-4, 0.4, 7 if quick else 14)
    curves = against_h(shape, cases, logs(1e-4, 0.4, 60), coarse, 0.02 if quick else 0.01)
    curves += [
        slope(r"$\propto 1/h$", -1, (2e-4, 3e-3), (1e-3, 30.0)),
        slope(r"$\propto h$", 1, (2e-4, 3e-3), (1e-3, 4e-5)),
    ]
    panel = Panel(H, ERROR, tuple(curves), legend="upper right")
    caption = rf"Gradient, 1D, {named(shape)}, $\Delta x/h = 0.7$, $\sigma/\Delta x = 0.05$"
    return Picture("first-order", caption, (panel,))


def three_d_standard(kernel: str | None, quick: bool) -> Picture:
    """σ/Δx = 0.2 in 3D against h/λ and against the number of neighbours."""
    shape = parse_kernel(kernel or "polynomial:4")
    chosen = [Fraction(1, 2), Fraction(7, 10), Fraction(1)]
    cases = [(rf"$\Delta x/h = {float(r):g}$", STANDARD, scene_at(3, r, 0.2)) for r in chosen]
    rtol = 0.03 if quick else 0.02
    left = against_h(shape, cases, logs(1e-3, 0.5, 80), logs(1e-3, 0.5, 6 if quick else 10), rtol)
    left.append(slope(r"$\propto 1/h$", -1, (2e-3, 2e-2), (1e-2, 10.0)))
    rows = [
        (rf"$h/\lambda = {length:g}$", length)
        for length in ((0.02, 0.2) if quick else (0.005, 0.02, 0.2))
    ]
    right: list[Curve] = []
    for label, length in rows:
        right += against_dx(
            shape,
            [(label, STANDARD, 3, 0.2)],
            length,
            ratios(0.45, 1.1, 12 if quick else 25),
            ratios(0.45, 1.1, 4 if quick else 7),
            rtol,
            neighbours=True,
        )
    right.append(slope(r"$\propto N_{nb}^{-5/6}$", -5 / 6, (60.0, 250.0), (100.0, 10.0)))
    panels = (
        Panel(H, ERROR, tuple(left), legend="upper right"),
        Panel(NEIGHBOURS, ERROR, tuple(right), legend="lower left", ylim=(0.03, 60)),
    )
    caption = rf"Standard gradient, 3D, {named(shape)}, $\sigma/\Delta x = 0.2$"
    return Picture("3d-standard", caption, panels)


def three_d_corrected(kernel: str | None, quick: bool) -> Picture:
    """Standard, difference and CSPH in 3D at σ/Δx = 0.2."""
    shape = parse_kernel(kernel or "polynomial:4")
    forms = [("standard", STANDARD), ("difference", DIFFERENCE), ("CSPH", CSPH), ("RKPM-1", RKPM)]
    rtol = 0.03 if quick else 0.02
    cases = [(label, operator, scene_at(3, Fraction(7, 10), 0.2)) for label, operator in forms]
    left = against_h(shape, cases, logs(1e-3, 0.5, 80), logs(1e-3, 0.5, 6 if quick else 10), rtol)
    left.append(slope(r"$\propto h$", 1, (2e-3, 2e-2), (1e-2, 3e-4)))
    right = against_dx(
        shape,
        [(label, operator, 3, 0.2) for label, operator in forms[:3]],
        0.02,
        ratios(0.45, 1.0, 10 if quick else 20),
        ratios(0.45, 1.0, 4 if quick else 7),
        rtol,
        neighbours=True,
    )
    panels = (
        Panel(H, ERROR, tuple(left), title=r"$\Delta x/h = 0.7$", legend="upper right"),
        Panel(NEIGHBOURS, ERROR, tuple(right), title=r"$h/\lambda = 0.02$", legend="best"),
    )
    caption = rf"Gradient, 3D, {named(shape)}, $\sigma/\Delta x = 0.2$"
    return Picture("3d-corrected", caption, panels)


def second_derivatives(kernel: str | None, quick: bool) -> Picture:
    """Forms of the Laplacian in 2D, uniform and disordered."""
    shape = parse_kernel(kernel or "polynomial:4")
    forms = {
        "W″, difference": Operator("laplacian", "difference"),
        "Brookshaw": Operator("laplacian", "brookshaw"),
        "Fatehi–Manzari": Operator("laplacian", "fatehi-manzari"),
        "RKPM-2": Operator("laplacian", "difference", "rkpm-2"),
    }
    if float(shape.dw(0.0)) != 0.0:  # no second derivative at the particle itself
        forms = {name: o for name, o in forms.items() if o.form in ("brookshaw", "fatehi-manzari")}
    coarse = logs(1e-3, 0.4, 6 if quick else 12)
    panels = []
    for title, sigma in (("uniform", 0.0), (r"$\sigma/\Delta x = 0.05$", 0.05)):
        cases = [(label, o, scene_at(2, Fraction(1, 2), sigma)) for label, o in forms.items()]
        curves = against_h(shape, cases, logs(1e-3, 0.4, 100), coarse, 0.02 if quick else 0.01)
        panels.append(Panel(H, "rms error / largest exact Laplacian", tuple(curves), title=title))
    caption = rf"Laplacian, 2D, {named(shape)}, $\Delta x/h = 1/2$"
    return Picture("second-derivatives", caption, tuple(panels))
