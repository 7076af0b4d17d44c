"""Figures of conservation: momentum against error, lengths that vary, densities that drift
apart."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from sphtrunc.experiment.measuring import measure
from sphtrunc.figures.picture import Curve, Panel, Picture, measured, predicted, slope
from sphtrunc.figures.uniform import H, named
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.smoothing_lengths import sloped
from sphtrunc.study.conservation.atmosphere import atmosphere_errors
from sphtrunc.study.conservation.conserving import conserve
from sphtrunc.study.conservation.density_drift import SCHEMES, drift, predicted_drift, tube
from sphtrunc.theory.variable_h.atmosphere import acceleration_errors
from sphtrunc.theory.variable_h.moments import limit_moments

SHOWN = ("symmetric", "difference", "csph", "csph-symmetric", "rkpm-strong", "rkpm-galerkin")
SIGMA = "1/50"
BEYOND = "the sample of particles, and terms of the next order in their displacements"


def _polynomial(kernel: str | None, default: str) -> Kernel:
    shape = parse_kernel(kernel or default)
    if not isinstance(shape, Kernel):
        raise ValueError(f"kernel: this figure needs a polynomial, {shape.name} is none")
    return shape


def conservation(kernel: str | None, quick: bool) -> Picture:
    """Momentum error against truncation error, and the latter against h, form by form."""
    shape = _polynomial(kernel, "wendland-c2")
    lengths = [0.1, 0.01] if quick else [0.1, 0.05, 0.02, 0.01, 0.005, 0.002]
    tables = [
        conserve(shape, 2, forms=SHOWN, jitter=SIGMA, h_over_lambda=x, radius=24.0) for x in lengths
    ]
    plane: list[Curve] = []
    against: list[Curve] = []
    for i, name in enumerate(SHOWN):
        rows = [table.rows[i] for table in tables]
        errors = np.array([row.measured for row in rows])
        known = np.array([row.predicted for row in rows])
        leaks = [max(row.kept.linear.residual, 1e-18) for row in rows]
        plane.append(measured(name, errors, leaks))
        against.append(predicted(name, lengths, known))
        against.append(measured(name, lengths, errors, predicted=known, beyond=BEYOND))
    return Picture(
        "conservation",
        f"Momentum equations on displaced particles, 2D, {named(shape)},"
        r" $\Delta x/h = 5/6$, $\sigma/\Delta x = 0.02$",
        (
            Panel(
                r"error of the acceleration / $\max|\nabla P|/\rho$",
                r"$|\sum m\,a| / \sum|m\,a|$",
                tuple(plane),
                title="what is kept against what is right",
                legend="center left",
            ),
            Panel(H, "error of the acceleration", tuple(against), title="error", legend=None),
        ),
        note="Forms at the bottom keep momentum to the rounding; their error grows as h falls.",
    )


def variable_h(kernel: str | None, quick: bool) -> Picture:
    """Moments of a gradient against the gradient of h, and the six rules in an atmosphere."""
    shape = _polynomial(kernel, "b-spline:12")
    cubic = _polynomial(None, "cubic-spline")
    fine = np.linspace(0.02, 0.4, 20)
    coarse = np.linspace(0.05, 0.4, 4 if quick else 8)
    curves: list[Curve] = []
    for rule in ("scatter", "mean"):
        for k, text in ((1, r"$M_1 - 1$"), (2, r"$M_2$")):
            label = f"{text}, {rule}"
            truth = [_limit(cubic, rule, g, k) for g in fine]
            curves.append(predicted(label, fine, truth))
            seen = []
            for g in coarse:
                scene = sloped(lattice(1, dx_over_h="1/16"), Fraction(str(round(g, 6))), rule)
                found = measure(scene, cubic, Operator("gradient"), moments=2)
                seen.append(float(found.moments[k][0]) - float(k == 1))
            at = np.array([_limit(cubic, rule, g, k) for g in coarse])
            curves.append(measured(label, coarse, seen, predicted=at))
    derived = acceleration_errors(shape, 1)
    steps = np.array([0.005, 0.01, 0.02]) if quick else np.array([0.005, 0.01, 0.015, 0.02, 0.03])
    found_at = [atmosphere_errors(shape, 1, float(e), 0.5) for e in steps]
    six: list[Curve] = []
    for rule, value in derived.items():
        level = np.full(steps.size, float(value))
        six.append(predicted(rule, steps, level))
        seen = [found[rule] for found in found_at]
        six.append(
            measured(rule, steps, seen, predicted=level, beyond="terms of the next order in h/L")
        )
    return Picture(
        "variable-h",
        "Smoothing lengths that vary: the moments of a gradient (cubic spline, 1D), and the error"
        f" of the acceleration in an isothermal atmosphere (1D, {named(shape)})",
        (
            Panel(r"$g = dh/dx$", "moment", tuple(curves), title="linear h", xscale="linear"),
            Panel(
                r"$h/L$",
                r"error / $\mu_2 (h/L)^2 c^2/L$",
                tuple(six),
                title=r"$h \propto \rho^{-1}$",
                xscale="linear",
                yscale="linear",
                ylim=(-4.6, 3.4),
                legend="upper center",
            ),
        ),
    )


def _limit(kernel: Kernel, rule: str, g: float, k: int) -> float:
    slopes = [Fraction(str(round(g, 6)))]
    return float(limit_moments(kernel, Operator("gradient"), slopes, rule, k)[k]) - float(k == 1)


def density_drift(kernel: str | None, quick: bool) -> Picture:
    """Summed against integrated density after a fixed time, six ways to step."""
    setting = tube(kernel or "quintic-spline")
    steps = [160, 320] if quick else [20, 40, 80, 160, 320]
    times = [0.4 / n for n in steps]
    curves: list[Curve] = []
    for scheme in SCHEMES:
        seen = [float(np.abs(drift(setting, scheme, n)).max()) for n in steps]
        truth = [predicted_drift(setting, scheme, n) for n in steps]
        known = [float(np.abs(one).max()) for one in truth if one is not None]
        if known:
            curves.append(predicted(scheme, times, known))
            reason = "terms of the next order in the step"
            at = np.array(known)
            curves.append(measured(scheme, times, seen, predicted=at, beyond=reason))
        else:
            curves.append(measured(scheme, times, seen))
    curves.append(slope(r"$\Delta t^4$", 4.0, (times[-1], times[0]), (times[0], seen[0] / 3.0)))
    return Picture(
        "density-drift",
        f"Summed against integrated density, 1D, {named(setting.kernel)}, $h = \\Delta x$ = 1/40",
        (Panel(r"$\Delta t$", r"$\max|\rho - \sum m W|$ at $t = 0.4$", tuple(curves)),),
    )
