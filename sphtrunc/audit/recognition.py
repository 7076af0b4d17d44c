"""Which kernel samples are: one of the catalogue, an analytic one, or an unknown polynomial one.

A match is accepted only if it reproduces every sample within a bound: the rounding of any usual way
of writing the kernel, plus what the table leaves open, plus what the support leaves open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray
from sympy import Expr, Poly, Rational

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.audit.analytic import ANALYTIC, Analytic
from sphtrunc.audit.constants import DIGITS, number
from sphtrunc.audit.forms import LENGTHS
from sphtrunc.audit.reconstruction import fixed, magnitudes, reconstruct, values
from sphtrunc.audit.samples import DOUBLE, SINGLE, Samples, node_spacing
from sphtrunc.kernels import catalogue
from sphtrunc.kernels.conventions import half_width, lengths
from sphtrunc.kernels.kernel import Kernel

Array = NDArray[np.floating[Any]]

GRID = np.linspace(0, 0.75, 61)  # in units of the support: where shapes are told apart
TINY = {DOUBLE: 2.0**-1022, SINGLE: 2.0**-126}  # the least normal numbers: below, digits are lost
MOST_NOISE = 2e-3  # of the value at the origin: rounding that leaves room for other kernels
MOST_ERROR = 5e-2  # relative, of the amplitude: a bound wider than that agrees with anything
ALIKE = 0.03  # how far apart two profiles may be for a full comparison


@dataclass(frozen=True)
class Match:
    """A shape that reproduces the samples: w = amplitude · shape(q · scale).

    integral: ∫ W over its support, and its relative error; exact where the input was exact
    support: in units of the h of whoever wrote it, and its relative error
    """

    shape: Kernel | Analytic
    known: bool
    support: float
    support_error: float
    amplitude: float
    scale: float
    integral: Any
    integral_error: float
    unit: float
    written: Kernel | None = None  # as its author wrote it, where that is known
    whole: Match | None = None  # the kernel that goes on, where the support is cut off
    spacing: float = 0.0  # of the nodes, where the values are interpolated linearly between them

    @property
    def name(self) -> str:
        return self.shape.name

    def derivative(self, q: Array, order: int = 1) -> tuple[Array, Array]:
        """The derivative of W at q, of order 0, 1 or 2, and the rounding it may carry."""
        factor = self.amplitude * self.scale**order
        inside = q < self.support
        value, size = np.zeros_like(q), np.zeros_like(q)
        if isinstance(self.shape, Analytic):
            function = (self.shape.shape, self.shape.slope, self.shape.bend)[order]
            x = q[inside] * self.scale
            value[inside] = factor * function(x)
            size[inside] = np.abs(factor) * (1 + x**order) * 64
            return value, 2 * self.unit * size
        kernel, pieces = self.shape, derived(self.shape, order)
        points = fixed(q[inside], Fraction(self.support) / fraction(kernel.support))
        value[inside] = factor * values(kernel.knots, pieces, points)
        if any(not p.is_zero for p in pieces):
            slope = Kernel(kernel.knots, pieces)
            size[inside] = np.abs(factor) * magnitudes(slope, q[inside] * self.scale)
        return value, 2 * (4 * kernel.degree + 16) * self.unit * size


@cache
def derived(kernel: Kernel, order: int) -> tuple[Poly, ...]:
    """The pieces of the derivative of that order."""
    pieces = kernel.pieces
    for _ in range(order):
        pieces = tuple(p.diff() for p in pieces)
    return pieces


def recognise_samples(samples: Samples, dim: int) -> Match | None:
    """The kernel behind the samples, in the precision they have, or None.

    In double precision; then as a table interpolated linearly; then in single precision.
    """
    if samples.unit == DOUBLE:
        found = _in_precision(samples, dim, DOUBLE)
        if found is not None:
            return found
        spacing = node_spacing(samples)
        if spacing:
            found = _catalogued(samples, dim, DOUBLE, spacing, False)
            return replace(found, spacing=spacing) if found is not None else None
    return _in_precision(samples, dim, SINGLE)


def _in_precision(samples: Samples, dim: int, unit: float) -> Match | None:
    return (
        _catalogued(samples, dim, unit, 0.0, False)
        or _analytic(samples, dim, unit)
        or _catalogued(samples, dim, unit, 0.0, True)
        or _reconstructed(samples, dim, unit)
    )


def rounding(kernel: Kernel, q: Array, shape: Array, slope: Array, expanded: bool) -> Array:
    """How many units of the last place evaluating w(q) may cost: (4 degree + 16) times …

    … |w| + |q w′| where the kernel is written about its own zeros; … the sum of the sizes of its
    terms where it is expanded about 0 or in truncated powers.
    """
    size = magnitudes(kernel, q) if expanded else np.abs(shape) + np.abs(q * slope)
    return (4 * kernel.degree + 16) * size


@cache
def profiles(dim: int = 1) -> tuple[tuple[Kernel, Array], ...]:
    """Every shape of the catalogue once, with its values over the grid, 1 at the origin; of two
    names for one, that of the dimension comes first."""
    result: dict[Kernel, Array] = {}
    for name in sorted(catalogue.names(), key=lambda name: name.endswith("-1d") == (dim > 1)):
        kernel = catalogue.named(name)
        if kernel not in result:
            result[kernel] = profile(kernel)
    return tuple(result.items())


def profile(kernel: Kernel) -> Array:
    knots = [float(k) for k in kernel.knots]
    q = GRID * knots[-1]
    index = np.minimum(np.searchsorted(knots[1:], q), len(kernel.pieces) - 1)
    w = np.empty_like(q)
    for i, piece in enumerate(kernel.pieces):
        w[index == i] = np.polyval([float(c) for c in piece.all_coeffs()], q[index == i])
    return np.asarray(w / w[0])


def crossing(q: Array, w: Array) -> float:
    """Where w first falls to a half, between samples by a straight line; 0 if it does not."""
    below = np.nonzero(w < 0.5)[0]
    if not len(below) or below[0] == 0:
        return 0.0
    i = int(below[0])
    return float(q[i - 1] + (q[i] - q[i - 1]) * (w[i - 1] - 0.5) / (w[i - 1] - w[i]))


def _catalogued(
    samples: Samples, dim: int, unit: float, spacing: float, expanded: bool
) -> Match | None:
    top = samples.w[0] if samples.q[0] < 1e-9 * samples.q[-1] else samples.w[:3].max()
    if top == 0:
        return None
    low, high = samples.support
    middle = crossing(samples.q, samples.w / top)
    candidates = []
    for kernel, w in profiles(dim):
        guesses = [high] if math.isfinite(high) else [low]
        half = crossing(GRID, w)
        if middle and half and (not math.isfinite(high) or unit == SINGLE):
            # the table may end early, and the last values of a smooth edge underflow
            guesses += [middle / half] if low < middle / half < 2 * low else []
        for guess in guesses:
            seen = np.interp(GRID * guess, samples.q, samples.w) / top
            distance = float(np.max(np.abs(seen - w)))
            if distance < ALIKE:
                candidates.append((distance, guess, kernel))
    candidates.sort(key=lambda c: c[0])
    for _, guess, kernel in candidates[:8]:
        found = _matched(kernel, samples, guess, dim, unit, spacing, expanded)
        if found is not None:
            return replace(found, known=True)
    return None


def _matched(
    kernel: Kernel,
    samples: Samples,
    guess: float,
    dim: int,
    unit: float,
    spacing: float,
    expanded: bool,
) -> Match | None:
    low, high = samples.support
    bisected = math.isfinite(high) and high - low <= 4 * DOUBLE * high
    near: list[tuple[float, float]] = []
    if bisected:  # to a few units of the last place: the last values may have underflowed
        near = [(nice(high, 64 * DOUBLE), 2 * DOUBLE), (high, 64 * DOUBLE)]
    if not bisected or unit == SINGLE:
        fitted = _fit_support(kernel, samples, guess, unit, spacing, expanded)
        if fitted is not None:
            support, error = fitted
            usual = [*(end for _, end in conventions(kernel, dim)), nice(support, 1e-4)]
            close = [end for end in usual if abs(end - support) <= max(error, 1e-3) * support]
            near = [*((end, 2 * DOUBLE) for end in close), fitted, *near]
        else:  # a shape without slope says nothing about its support but what the samples do
            end = min(high, low + float(samples.q[-1] - samples.q[-2]))
            usual = [end for _, end in conventions(kernel, dim)]
            near += [(value, 2 * DOUBLE) for value in usual if low <= value <= end]
            near.append((low, max((end - low) / low, DOUBLE)))
    few = thinned(samples)
    for support, error in dict.fromkeys(near):
        if compare(kernel, few, support, error, dim, unit, spacing, expanded) is None:
            continue  # most candidates end here
        found = compare(kernel, samples, support, error, dim, unit, spacing, expanded)
        if found is not None:
            return found
    return None


def cut_off(samples: Samples, dim: int) -> Match | None:
    """The catalogue kernel that goes on beyond the last value, if there is one; `whole` is it.

    Its support may be any that a smoothing length gives it (see `conventions`).
    """
    low, high = samples.support
    if samples.w[0] == 0 or not math.isfinite(high):
        return None
    keep = samples.q <= low
    inside = replace(samples, q=samples.q[keep], w=samples.w[keep], error=samples.error[keep])
    few = thinned(inside)
    found: list[Match] = []
    for kernel, profile_ in profiles():
        for _, support in conventions(kernel, dim):
            if not high < support * (1 - 1e-9):
                continue
            near = few.q <= GRID[-1] * support
            seen = np.interp(few.q[near], GRID * support, profile_) * few.w[0]
            if np.max(np.abs(seen - few.w[near])) > ALIKE * abs(few.w[0]):
                continue
            for unit in sorted({samples.unit, SINGLE}):
                if compare(kernel, few, support, 2 * DOUBLE, dim, unit) is not None:
                    whole = compare(kernel, inside, support, 2 * DOUBLE, dim, unit)
                    found += [whole] if whole is not None else []
                    break
    if not found:
        return None
    whole = min(found, key=lambda match: (match.unit, match.name))
    return shortened(replace(whole, known=True), nice(high, 64 * DOUBLE), dim)


def shortened(whole: Match, end: float, dim: int) -> Match:
    """The same kernel up to `end`, in its author's h, and nothing beyond."""
    assert isinstance(whole.shape, Kernel)
    kernel = whole.shape
    ratio = Fraction(whole.support) / fraction(kernel.support)
    last = Fraction(end) / ratio
    at = Rational(last.numerator, last.denominator)
    knots = [k for k in kernel.knots if k < at]
    short = Kernel([*knots, at], kernel.pieces[: len(knots)], name=kernel.name)
    part = kernel.normalisation(dim) / short.normalisation(dim)
    integral = whole.integral * (part if isinstance(whole.integral, Expr) else number(part))
    return replace(whole, shape=short, support=end, integral=integral, whole=whole)


def thinned(samples: Samples) -> Samples:
    """About 60 of the samples."""
    part = slice(None, None, max(1, len(samples.q) // 60))
    return replace(samples, q=samples.q[part], w=samples.w[part], error=samples.error[part])


@cache
def conventions(kernel: Kernel, dim: int) -> tuple[tuple[str, float], ...]:
    """What a smoothing length may be, and the support in units of it."""
    support = float(kernel.support)
    found = [
        (LENGTHS[name][0], support / float(number(length)))
        for name, length in lengths(kernel, dim).items()
    ]
    half = float(half_width(kernel))
    if half:
        found += [(LENGTHS["fwhm"][0], support / (2 * half)), (LENGTHS["hwhm"][0], support / half)]
    return tuple(found)


def nice(value: float, error: float) -> float:
    """The nearest fraction of denominator at most 64, if it lies within the relative error."""
    simple = Fraction(value).limit_denominator(64)
    return float(simple) if abs(float(simple) - value) <= error * value else value


def _fit_support(
    kernel: Kernel, samples: Samples, guess: float, unit: float, spacing: float, expanded: bool
) -> tuple[float, float] | None:
    """The support and its relative error by weighted least squares in (amplitude, support)."""
    support = guess
    reach = samples.w != 0
    step = max(1, int(np.count_nonzero(reach)) // 200)
    q, w = samples.q[reach][::step], samples.w[reach][::step]
    error = samples.error[reach][::step]
    pieces = kernel.derivative()
    spread = 1.0
    for _ in range(8):
        inside = q < support * (1 - 1e-3)
        if np.count_nonzero(inside) < 8:
            return None
        x, y = q[inside], w[inside]
        ratio = Fraction(support) / fraction(kernel.support)
        points = fixed(x, ratio)
        shape = values(kernel.knots, kernel.pieces, points)
        slope = values(kernel.knots, pieces, points)
        amplitude = float(y @ shape / (shape @ shape))
        noise = (
            unit * rounding(kernel, x / float(ratio), shape, slope, expanded) * abs(amplitude)
            + error[inside]
            + _interpolation(kernel, amplitude, float(ratio), spacing)
            + TINY.get(unit, TINY[SINGLE])
        )
        rows = np.stack([shape / noise, -amplitude * slope * (x / float(ratio)) / noise], axis=1)
        orthogonal, triangle = np.linalg.qr(rows)
        if not abs(np.prod(np.diag(triangle))) > 0:
            return None
        change = np.linalg.solve(triangle, orthogonal.T @ ((y - amplitude * shape) / noise))
        inverse = np.linalg.inv(triangle)
        spread = float(16 * np.sqrt(np.sum(inverse[1] ** 2)))
        support *= 1 + float(np.clip(change[1], -0.1, 0.1))
        if abs(change[1]) < spread / 100 or abs(change[1]) < DOUBLE:
            break
    return support, max(spread, 4 * DOUBLE)


def _interpolation(kernel: Kernel, amplitude: float, ratio: float, spacing: float) -> float:
    """max |w″| Δ²/8, the error of linear interpolation between nodes Δ apart."""
    if not spacing:
        return 0.0
    curvature = [p.diff() for p in kernel.derivative()]
    points = np.linspace(0, float(kernel.support), 101)
    largest = float(np.max(np.abs(values(kernel.knots, curvature, fixed(points)))))
    return 1.1 * abs(amplitude) * largest * (spacing / ratio) ** 2 / 8


def compare(
    kernel: Kernel,
    samples: Samples,
    support: float,
    support_error: float,
    dim: int,
    unit: float,
    spacing: float = 0.0,
    expanded: bool = True,
) -> Match | None:
    """The kernel at that support, if some amplitude makes it agree with every sample."""
    ratio = Fraction(support) / fraction(kernel.support)
    inside = samples.q < support
    q, y = samples.q[inside], samples.w[inside]
    outside = samples.w[~inside]
    points = fixed(q, ratio)
    shape = values(kernel.knots, kernel.pieces, points)
    own = q / float(ratio)
    slope = values(kernel.knots, kernel.derivative(), points)
    guess = abs(float(y @ shape / (shape @ shape)))
    noise = guess * unit * rounding(kernel, own, shape, slope, expanded)
    if np.max(noise) > MOST_NOISE * guess * np.max(np.abs(shape)):
        return None
    noise += guess * np.abs(slope * own) * support_error + samples.error[inside]
    noise += _interpolation(kernel, guess, float(ratio), spacing) + TINY.get(unit, TINY[SINGLE])
    weight = shape / noise
    norm = math.fsum(weight * weight)
    amplitude = math.fsum(weight * (y / noise)) / norm
    error = float(np.sum(np.abs(weight))) / norm / abs(amplitude or 1.0) + 8 * DOUBLE
    away = np.ones(len(q), dtype=bool)
    for knot in kernel.knots[1:]:
        where = float(knot) * float(ratio)
        away &= np.abs(q - where) > max(8 * DOUBLE, support_error) * where
    off = np.abs(y - amplitude * shape) > 2 * noise
    if bool(np.any(off & away)) or error > MOST_ERROR:
        return None
    beyond = np.abs(outside) > 2 * samples.error[~inside] + np.max(noise)
    if bool(np.any(beyond[1:])):
        return None
    integral = _integral(kernel, amplitude, ratio, dim)
    total = error + dim * support_error
    scale = float(1 / ratio)
    return Match(kernel, False, support, support_error, amplitude, scale, integral, total, unit)


def _integral(kernel: Kernel, amplitude: float, ratio: Fraction, dim: int) -> Any:
    with mpmath.workdps(DIGITS):
        stretch = mpmath.mpf(ratio.numerator) / ratio.denominator
        return mpmath.mpf(amplitude) * stretch**dim / number(kernel.normalisation(dim))


def _reconstructed(samples: Samples, dim: int, unit: float) -> Match | None:
    low, high = samples.support
    bisected = math.isfinite(high) and high - low <= 4 * DOUBLE * high
    if np.any(samples.error > 64 * unit * np.max(np.abs(samples.w))):
        unit = float(2 * np.max(samples.error) / np.max(np.abs(samples.w)))
        if unit > 1e-4:
            return None
    support = nice(high, 4 * DOUBLE) if bisected else None
    recovered = reconstruct(samples.q, samples.w, unit, support)
    if recovered is None:
        return None
    if recovered[0]._radial(recovered[0].pieces, dim - 1) == 0:
        return None  # it cannot be normalised, and is judged by its values alone
    found = compare(recovered[0], samples, recovered[1], 2 * DOUBLE, dim, unit)
    return _in_own_units(found) if found is not None else None


def _in_own_units(match: Match) -> Match:
    """A reconstructed kernel written on the support that its author used, where that is simple."""
    simple = Fraction(match.support).limit_denominator(64)
    if float(simple) != match.support or not isinstance(match.shape, Kernel):
        return match
    kernel = match.shape.scaled(Rational(simple.numerator, simple.denominator))
    own = Kernel(kernel.knots, kernel.pieces, name="reconstructed")
    return replace(match, shape=own, scale=1.0)


def _analytic(samples: Samples, dim: int, unit: float) -> Match | None:
    low, high = samples.support
    support = nice(high, 4 * DOUBLE) if math.isfinite(high) else low
    inside = (samples.q < support) & (samples.w != 0)
    q, y, error = samples.q[inside], samples.w[inside], samples.error[inside]
    if len(q) < 16 or y[0] <= 0:
        return None
    for shape in ANALYTIC.values():
        scale = 1 / support
        if shape.name == "gaussian":
            middle = (y > 0) & (y < 0.8 * y[0]) & (y > 0.05 * y[0])
            if np.count_nonzero(middle) < 4:
                continue
            width = np.polyfit(q[middle] ** 2, np.log(y[middle]), 1)[0]
            if not width < 0:
                continue
            scale = nice(math.sqrt(-width), 1e-7)
            if scale**2 and abs(nice(-width, 1e-9) - (-width)) < 1e-9 * -width:
                scale = math.sqrt(nice(-width, 1e-9))
        model = shape.shape(q * scale)
        if not np.all(model[: max(4, len(q) // 3)] > TINY[SINGLE]):
            continue  # a Gaussian so narrow is none
        amplitude = float(np.median((y / np.maximum(model, TINY[SINGLE]))[: max(4, len(q) // 3)]))
        argument = (q * scale) ** 2 if shape.name == "gaussian" else np.full_like(q, 8.0)
        spare = 1e-12 if shape.name == "gaussian" and scale not in (1.0,) else 0.0
        noise = (
            abs(amplitude)
            * ((16 + 4 * argument) * 2 * unit + spare)
            * (np.abs(model) * (1 + argument) if shape.name == "gaussian" else 8.0)
        )
        if np.any(np.abs(y - amplitude * model) > noise + 2 * error + 5e-324):
            continue
        with mpmath.workdps(DIGITS):
            whole = mpmath.mpf(amplitude) / mpmath.mpf(scale) ** dim
            whole /= number(shape.normalisation(dim))
            if shape.name == "gaussian":
                reach = (mpmath.mpf(support) * scale) ** 2
                whole *= mpmath.gammainc(mpmath.mpf(dim) / 2, 0, reach, regularized=True)
        spread = float(np.max(noise[:4]) / abs(amplitude)) + 4 * unit
        return Match(
            shape, True, support, 2 * DOUBLE, amplitude, scale, whole, spread + dim * spare, unit
        )
    return None


def exact_match(kernel: Kernel, constant: Expr, error: float, dim: int) -> Match:
    """The match of a formula and its constant: nothing is sampled, the integral is exact."""
    integral = constant / kernel.normalisation(dim)
    amplitude = float(number(constant))
    support = float(kernel.support)
    for known, _ in profiles(dim):
        if same_shape(known, kernel):
            one = known.support / kernel.support
            factor = _top(kernel) / _top(known)
            size = amplitude * float(factor)
            return Match(
                known, True, support, 0.0, size, float(one), integral, error, DOUBLE, kernel
            )
    return Match(kernel, False, support, 0.0, amplitude, 1.0, integral, error, DOUBLE, kernel)


def same_shape(a: Kernel, b: Kernel) -> bool:
    """Equal up to scale and support, exactly."""
    if len(a.pieces) != len(b.pieces) or a.degree != b.degree:
        return False
    ratio = a.support / b.support
    if any(x != y * ratio for x, y in zip(a.knots, b.knots, strict=True)):
        return False
    scale = None
    for p, r in zip(a.pieces, b.pieces, strict=True):
        left, right = list(reversed(p.all_coeffs())), list(reversed(r.all_coeffs()))
        if len(left) != len(right):
            return False
        for power, (x, y) in enumerate(zip(left, right, strict=True)):
            x = x * ratio**power
            if (x == 0) != (y == 0):
                return False
            if x != 0:
                scale = scale if scale is not None else x / y
                if x != scale * y:
                    return False
    return True


def _top(kernel: Kernel) -> Rational:
    """The first coefficient of the first piece that is not zero, on a support of one."""
    table = list(reversed(kernel.pieces[0].all_coeffs()))
    power = next(i for i, c in enumerate(table) if c)
    return table[power] * kernel.support**power
