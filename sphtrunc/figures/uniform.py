"""Figures of uniform particles in 1D: nothing is random, every point lies on its curve."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import factorial, log10, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.experiment.wavelengths import waves
from sphtrunc.figures.picture import Curve, Panel, Picture, measured, predicted, slope
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.kernels.transform import transform
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.lattice import lattice
from sphtrunc.theory.field_error import predict_waves
from sphtrunc.theory.stencil import stencils

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

ERROR = "rms error of the gradient / largest exact gradient"
H = r"$h/\lambda$"
DX = r"$\Delta x/h$"


def uniform_error(kernel: Kernel, ratio: Fraction, h_over_lambda: Sequence[float]) -> list[float]:
    """The rms over the phase of the relative error of the gradient of a sinusoid, |K/k − 1|/√2."""
    return [abs(e) / sqrt(2) for e in wave_error(kernel, ratio, h_over_lambda)]


def wave_error(kernel: Kernel, ratio: Fraction, h_over_lambda: Sequence[float]) -> list[float]:
    """K/k − 1, the relative error of the modified wavenumber: the symbol of the gradient's stencil
    is iK."""
    (stencil,) = stencils(kernel, Operator("gradient"), Arrangement("uniform", ratio))
    lengths = (2 * pi * x for x in h_over_lambda)
    return [float(stencil.symbol([k]).imag / k - 1) for k in lengths]


def seen(
    kernel: Kernel, ratio: Fraction, h_over_lambda: Sequence[float]
) -> tuple[list[float], float]:
    """Measured rms errors on a uniform lattice, and what rounding alone may make of them."""
    (row,) = waves(lattice(1, dx_over_h=ratio), kernel, [Operator("gradient")], h_over_lambda)
    errors = [float(m.error["rms"]) for m in row if m.error is not None]
    here = Arrangement("uniform", ratio)
    splits = predict_waves(kernel, Operator("gradient"), here, [min(h_over_lambda)])
    return errors, 5 * splits[0].rounding


def kernels(kernel: str | None, quick: bool) -> Picture:
    """Ŵ, Ŵ′, Ŵ″ in 1D and |F(kh)|."""
    chosen = ["cubic-spline", "quintic-spline", "polynomial:4", "wendland-c4-1d"]
    if kernel is not None:
        chosen = [kernel, *(name for name in chosen if name != kernel)][:4]
    shapes = [parse_kernel(name) for name in chosen]
    s = np.linspace(-1, 1, 101 if quick else 401)
    panels = []
    places = ("upper right", "upper right", "lower right")
    for method, label, place in zip(
        ("w", "dw", "d2w"), (r"$\hat W$", r"$\hat W'$", r"$\hat W''$"), places, strict=True
    ):
        curves = []
        for shape in shapes:
            x = s * float(shape.support)
            y = getattr(shape, method)(np.abs(x))
            curves.append(predicted(shape.name, x, y * np.sign(x) if method == "dw" else y))
        panels.append(
            Panel(
                r"$s = (x - x_a)/h$",
                label,
                tuple(curves),
                xscale="linear",
                yscale="linear",
                legend=place,
            )
        )
    k = np.linspace(0.0, 14 * pi, 201 if quick else 1201)
    curves = [predicted(shape.name, k / pi, np.abs(transform(shape, k))) for shape in shapes]
    panels.append(
        Panel(
            r"$kh/\pi$",
            r"$|F(kh)|$",
            tuple(curves),
            xscale="linear",
            ylim=(1e-9, 2),
            legend="upper right",
        )
    )
    return Picture("kernels", "Kernels in 1D and their Fourier transforms", tuple(panels))


def uniform_smoothing(kernel: str | None, quick: bool) -> Picture:
    """Error against h/λ at several Δx/h."""
    shape = parse_kernel(kernel or "polynomial:4")
    kappa = fraction(shape.support)
    ratios = [2 * kappa / n for n in (5, 7, 9, 11, 20)]
    fine = [float(x) for x in np.geomspace(1e-4, 0.5, 120 if quick else 200)]
    coarse = [float(x) for x in np.geomspace(1e-4, 0.5, 8 if quick else 19)]
    curves: list[Curve] = []
    for ratio in ratios:
        label = rf"$\Delta x/h = {_short(ratio)}$"
        line = sorted({*fine, *coarse})  # the curve is drawn through every point
        at = dict(zip(line, uniform_error(shape, ratio, line), strict=True))
        curves.append(predicted(label, line, list(at.values())))
        found, floor = seen(shape, ratio, coarse)
        expected = [at[x] for x in coarse]
        curves.append(measured(label, coarse, found, predicted=expected, floor=floor))
    level = 0.2 * float(shape.moment(2, 1)) / 2 / sqrt(2)
    curves.append(slope(r"$\propto h^2$", 2, (6e-3, 6e-2), (1e-2, level * (2 * pi * 1e-2) ** 2)))
    panel = Panel(H, ERROR, tuple(curves), legend="lower right")
    return Picture("uniform-smoothing", f"Uniform particles in 1D, {named(shape)}", (panel,))


def uniform_discretisation(kernel: str | None, quick: bool) -> Picture:
    """Error against Δx/h at several h/λ, aligned and generic ratios, and the edge-only formula."""
    shape = parse_kernel(kernel or "polynomial:4")
    kappa = fraction(shape.support)
    span = (Fraction(1, 5), Fraction(3, 4) * kappa)
    lengths = [0.001, 0.01, 0.1]
    generic = _ratios(span, 8 if quick else 16)
    fine = sorted({*_ratios(span, 300 if quick else 600), *generic})
    aligned = [r for n in range(1, 60, 2) if span[0] <= (r := 2 * kappa / n) <= span[1]]
    aligned = aligned[:: 3 if quick else 1]
    curves: list[Curve] = []
    for length in lengths:
        curves.append(
            predicted(
                rf"generic ratio, $h/\lambda = {length:g}$",
                [float(r) for r in fine],
                [uniform_error(shape, r, [length])[0] for r in fine],
            )
        )
        curves.append(_points(shape, generic, length, rf"generic ratio, $h/\lambda = {length:g}$"))
    for length in lengths[:1]:
        curves.append(
            _points(shape, aligned, length, rf"$\Delta x/h = 2\kappa/n$, $h/\lambda = {length:g}$")
        )
    if shape.boundary_smoothness < 100:  # an infinite Gaussian has no edge
        edge = [abs(edge_term(shape, float(r))) / sqrt(2) for r in fine]
        label = r"$2\kappa/n$: leading term of the edge alone"
        curves.append(predicted(label, [float(r) for r in fine], edge))
    panel = Panel(DX, ERROR, tuple(curves), ylim=(1e-8, 10), legend="upper left")
    caption = f"Uniform particles in 1D, {named(shape)}"
    return Picture("uniform-discretisation", caption, (panel,))


def edge_term(kernel: Kernel, ratio: float) -> float:
    """The leading term of M_1 − 1 at Δx/h = 2κ/n, n odd, from the edge of the support alone,

        (Δx/h)^{β+2} B_{β+2}/(β+2)! (1 − 2^{−β−1}) [2κ Ŵ^{(β+2)}(κ) + 2(β+1) Ŵ^{(β+1)}(κ)],

    which is zero for odd β and knows nothing of interior knots (Quinlan, Basa & Lastiwka 2006,
    doi:10.1002/nme.1617).
    """
    from sympy import bernoulli

    beta, kappa = kernel.boundary_smoothness, kernel.support
    inner = {m: -kernel.jumps(m)[kappa] for m in (beta + 1, beta + 2)}  # Ŵ^{(m)}(κ⁻)
    bracket = 2 * kappa * inner[beta + 2] + 2 * (beta + 1) * inner[beta + 1]
    factor = bernoulli(beta + 2) / factorial(beta + 2) * (1 - 2.0 ** (-beta - 1))
    return float(factor * bracket) * ratio ** (beta + 2)


def kernel_comparison(kernel: str | None, quick: bool) -> Picture:
    """Error against Δx/h at h/λ = 0.0018 for many kernels."""
    families = {
        "B-splines": ["b-spline:3", "cubic-spline", "quartic-spline", "quintic-spline"],
        "polynomials": [f"polynomial:{beta}" for beta in (0, 1, 2, 4, 6)],
        "Gaussian": ["gaussian", "gaussian:2", "gaussian:3"],
        "Wendland": ["wendland-c2-1d", "wendland-c4-1d", "wendland-c6-1d", "wendland-c2"],
    }
    if kernel is not None:
        families = {"own": [kernel], **families}
    span = (Fraction(1, 5), Fraction(7, 5))
    coarse = _ratios(span, 7 if quick else 15)
    fine = sorted({*_ratios(span, 200 if quick else 400), *coarse})
    panels = []
    for family, members in families.items():
        curves: list[Curve] = []
        for name in members:
            shape = parse_kernel(name)
            curves.append(
                predicted(
                    shape.name,
                    [float(r) for r in fine],
                    [uniform_error(shape, r, [0.0018])[0] for r in fine],
                )
            )
            curves.append(_points(shape, coarse, 0.0018, shape.name))
        panels.append(
            Panel(DX, ERROR, tuple(curves), title=family, legend="lower right", ylim=(1e-7, 2))
        )
    caption = r"Uniform particles in 1D, $h/\lambda = 0.0018$"
    return Picture("kernel-comparison", caption, tuple(panels))


def _points(kernel: Kernel, ratios: Sequence[Fraction], length: float, label: str) -> Curve:
    found = [seen(kernel, r, [length]) for r in ratios]
    return measured(
        label,
        [float(r) for r in ratios],
        [errors[0] for errors, _ in found],
        predicted=[uniform_error(kernel, r, [length])[0] for r in ratios],
        floor=max(floor for _, floor in found),
    )


def _ratios(span: tuple[Fraction, Fraction], n: int) -> list[Fraction]:
    """n rationals, evenly in the logarithm."""
    exponents = np.linspace(log10(span[0]), log10(span[1]), n)
    return [Fraction(10**x).limit_denominator(10**6) for x in exponents]


def named(kernel: Kernel) -> str:
    """The kernel as a caption has room for it."""
    name, _, beta = kernel.name.partition(":")
    if name == "polynomial" and beta.isdigit():
        return rf"{kernel.name}, $(4 - q^2)^{{{int(beta) + 1}}}$"
    return kernel.name if len(kernel.name) <= 40 else f"{kernel.name[:39]}…"


def _short(ratio: Fraction) -> str:
    return f"{ratio.numerator}/{ratio.denominator}" if ratio.denominator > 1 else f"{ratio}"
