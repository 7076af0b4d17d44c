"""Judging without an exact form: the integral by quadrature, derivatives by differences."""

from __future__ import annotations

import numpy as np

from sphtrunc.audit import faults
from sphtrunc.audit.constants import number
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.samples import DOUBLE, Array, Samples
from sphtrunc.kernels.kernel import SPHERE

NAME = ("W", "dW", "d²W")


def wrong_integral(whole: float, error: float, samples: Samples, dim: int) -> Fault | None:
    """The integral differs from one by more than its error."""
    if abs(whole - 1) <= max(error, 1e-9, 64 * samples.unit):
        return None
    return Fault(
        faults.WRONG_CONSTANT,
        f"it integrates to {whole:.8g} ± {error:.1g} in {dim}D, not to 1",
        "nothing more can be said: no exact form was recognised, and no kernel cut off",
    )


def quadrature(samples: Samples, dim: int) -> tuple[float, float]:
    """∫ W and its error, by halving the step."""
    surface = float(number(SPHERE[dim]))
    if samples.function is None:
        f = surface * samples.w * samples.q ** (dim - 1)
        fine = float(np.trapezoid(f, samples.q)) + f[0] * samples.q[0] / dim
        half = float(np.trapezoid(f[::2], samples.q[::2])) + f[0] * samples.q[0] / dim
        spread = surface * float(np.trapezoid(samples.error * samples.q ** (dim - 1), samples.q))
        return fine, abs(fine - half) + spread
    nodes, weights = np.polynomial.legendre.leggauss(6)
    sums = []
    for cells in (60, 120):
        edges = np.linspace(0, samples.support[1], cells + 1)
        half_width = np.diff(edges)[:, None] / 2
        x = (edges[:-1, None] + edges[1:, None]) / 2 + half_width * nodes
        w = samples.function(x.reshape(-1), 1.0).reshape(x.shape)
        sums.append(surface * float(np.sum(w * x ** (dim - 1) * weights * half_width)))
    return sums[1], 2 * abs(sums[1] - sums[0]) + 1e-13


def wrong_derivative(samples: Samples, order: int) -> Fault | None:
    """∫ dW between samples against the differences of W, by the trapezoid rule and its error.

    A second derivative is compared with the first, or, where there is none, not at all.
    """
    below = (samples.w, samples.dw)[order - 1]
    above = (samples.dw, samples.d2w)[order - 1]
    if above is None or below is None:
        return None
    keep = (samples.q > 0) & (samples.q < samples.support[0])
    q, w, dw = samples.q[keep], below[keep], above[keep]
    steps = np.diff(q)
    trapezoid = steps * (dw[1:] + dw[:-1]) / 2
    bend = np.abs(np.gradient(np.gradient(dw, q), q))
    room = steps**3 * np.maximum(bend[1:], bend[:-1]) / 6 + steps * np.max(np.abs(dw)) * 1e-5
    off = np.abs(np.diff(w) - trapezoid) > room + 64 * samples.unit * np.max(np.abs(w))
    if np.count_nonzero(off) <= len(off) // 20:
        return None
    at = int(np.argmax(off))
    return Fault(
        faults.WRONG_DERIVATIVE,
        f"{NAME[order]} is not the derivative of {NAME[order - 1]} near q = {q[at]:.4g}",
    )


def signs(samples: Samples) -> tuple[bool, bool]:
    """Whether W is positive and whether it falls monotonically, within rounding."""
    top = float(np.max(np.abs(samples.w)))
    inside: Array = samples.w[samples.q <= samples.support[0]]
    return (
        bool(np.all(samples.w >= -8 * DOUBLE * top)),
        bool(np.all(np.diff(inside) <= 8 * samples.unit * top)),
    )
