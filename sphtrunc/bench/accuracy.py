"""Accuracy for its price: precisions on sums of known answer, and error against seconds for
kernels, corrections and resolutions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from math import fsum
from statistics import median
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import Array, compensated_dot, dd, dd_mul, dd_total, dot
from sphtrunc.bench.report import Table, alternately
from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.study.tuning import exponents

# ------------------------------------------------------------------------------------ precision


def ill_conditioned(n: int, condition: float, seed: int = 0) -> tuple[Array, Array, Fraction]:
    """A dot product of about this condition, and its exact value: random terms with a wide range
    of exponents, the second half chosen to cancel the first (after Ogita, Rump & Oishi 2005)."""
    rng = np.random.default_rng(seed)
    half = n // 2
    width = np.log2(condition) / 2.0
    powers = np.rint(rng.uniform(0.0, width, half))
    a = rng.uniform(-1.0, 1.0, half) * 2.0**powers
    b = rng.uniform(-1.0, 1.0, half) * 2.0**powers
    exact = sum((Fraction(x) * Fraction(y) for x, y in zip(a, b, strict=True)), Fraction(0))
    left, right = a.tolist(), b.tolist()
    for _ in range(n - half):
        x = float(rng.uniform(0.5, 1.0)) * 2.0 ** float(np.rint(rng.uniform(0.0, width)))
        left.append(x)
        right.append((float(rng.uniform(-1.0, 1.0)) - float(exact)) / x)
        exact += Fraction(x) * Fraction(right[-1])
    return np.array(left), np.array(right), exact


def precision(quick: bool) -> Iterator[Table]:
    """Levels of precision on sums of known answer and on real SPH sums."""
    yield _known(64 if quick else 256)
    yield _real(quick)


def _known(n: int) -> Table:
    rows: list[tuple[Any, ...]] = []
    for condition in (1e0, 1e8, 1e16, 1e24):
        sums = [ill_conditioned(n, condition, seed) for seed in range(32)]
        a = np.stack([x for x, _, _ in sums], axis=1)
        b = np.stack([y for _, y, _ in sums], axis=1)
        exact = [value for _, _, value in sums]
        size = [
            sum(abs(Fraction(x) * Fraction(y)) for x, y in zip(p, q, strict=True)) / abs(e)
            for p, q, e in sums
        ]
        tasks = {name: partial(how, a, b) for name, how in _HOW.items()}
        times = alternately(tasks, 5, 4.0)
        base = median(times["plain"])
        for name, task in tasks.items():
            values = task()
            error = [float(abs((_exactly(v) - e) / e)) for v, e in zip(values, exact, strict=True)]
            t = median(times[name])
            rows.append((name, float(max(size)), max(error), median(error), 1e6 * t / 32, t / base))
    return Table(
        f"dot products of {n} terms with a known answer",
        ("how", "condition", "largest error", "median", "µs a sum", "ratio"),
        rows,
        "relative errors over 32 sums; condition: Σ|terms|/|sum|",
    )


def _fractions(a: Array, b: Array) -> list[Fraction]:
    return [
        sum((Fraction(x) * Fraction(y) for x, y in zip(p, q, strict=True)), Fraction(0))
        for p, q in zip(a.T.tolist(), b.T.tolist(), strict=True)
    ]


def _exactly(value: Any) -> Fraction:
    if isinstance(value, Fraction):
        return value
    if isinstance(value, np.longdouble):
        high = float(value)
        return Fraction(high) + Fraction(float(value - np.longdouble(high)))
    return Fraction(float(value))


def _mp_dot(a: Array, b: Array) -> list[Any]:
    from mpmath import fdot, mpf, workdps

    with workdps(50):
        return [
            fdot([mpf(x) for x in p], [mpf(y) for y in q])
            for p, q in zip(a.T.tolist(), b.T.tolist(), strict=True)
        ]


_HOW: dict[str, Callable[[Array, Array], Any]] = {
    "plain": dot,
    "compensated": compensated_dot,
    "extended": lambda a, b: dd_total(dd_mul(dd(a), dd(b)))[0],
    "numpy.einsum": lambda a, b: np.einsum("ij,ij->j", a, b),
    "math.fsum of products": lambda a, b: [fsum(column) for column in (a * b).T],
    "longdouble": lambda a, b: (a.astype(np.longdouble) * b.astype(np.longdouble)).sum(axis=0),
    "exact (fractions)": _fractions,
    "mpmath, 50 digits": _mp_dot,
}


def _real(quick: bool) -> Table:
    """The gradient of a sinusoid: what each level leaves of the rounding error, and its price."""
    rows: list[tuple[Any, ...]] = []
    kernel = parse_kernel("cubic-spline")
    count = 200 if quick else 1000
    for dim in (1, 3):
        scene = jittered(lattice(dim, None, "1/2"), 0.2)
        for form in ("standard", "difference"):
            for h_over_lambda in (1e-2, 1e-6):
                field = sinusoid(h_over_lambda, dim=dim)
                options: dict[str, Any] = {"form": form, "targets": count, "workers": 1}
                best = measure(
                    scene, kernel, "gradient", field, precision="extended", **options
                ).errors
                assert best is not None
                found: dict[str, Any] = {}
                tasks = {
                    name: _keeping(found, name, scene, kernel, field, options)
                    for name in ("plain", "compensated", "extended")
                }
                times = alternately(tasks, 3)
                base = median(times["plain"])
                for name in tasks:
                    errors = found[name].errors
                    rounding = np.abs(errors - best)
                    rows.append(
                        (
                            f"{dim}D {form}, {name}",
                            h_over_lambda,
                            float(np.sqrt((errors**2).sum(axis=0).mean())),
                            float(rounding.max()) if name != "extended" else None,
                            1e6 * median(times[name]) / count,
                            median(times[name]) / base,
                        )
                    )
    return Table(
        "real sums: the gradient of a sinusoid, Δx/h = 1/2, σ/Δx = 0.2",
        ("case", "h/λ", "error", "of it rounding", "µs a target", "ratio"),
        rows,
        "the terms carry the rounding, not the sum: compensated gains where they cancel, extended"
        " everywhere",
    )


def _keeping(
    found: dict[str, Any], level: str, scene: Any, kernel: Any, field: Any, options: dict[str, Any]
) -> Callable[[], None]:
    """Measure at this level and keep what was found under its name."""

    def run() -> None:
        found[level] = measure(scene, kernel, "gradient", field, precision=level, **options)

    return run


# -------------------------------------------------------------------------------- work-precision


def work_precision(quick: bool) -> Iterator[Table]:
    """Error against seconds at fixed resolution, and against resolution along the best path."""
    for dim in (1, 2, 3):
        yield _fixed(dim, quick)
    for dim in (2, 3):
        yield _path(dim, quick)


def _fixed(dim: int, quick: bool) -> Table:
    """At a fixed number of particles a wavelength: kernels × corrections × Δx/h."""
    kernels = ("cubic-spline", "wendland-c2") if quick else _KERNELS
    targets = 200 if quick else 1000
    rows: list[tuple[Any, ...]] = []
    for name in kernels:
        kernel = parse_kernel(name if dim > 1 or not name.startswith("wendland") else f"{name}-1d")
        for form, correction in _FORMS:
            for ratio in ("3/10", "1/2", "7/10") if dim < 3 else ("1/2", "7/10"):
                scene = jittered(lattice(dim, None, ratio), 0.2)
                field = sinusoid(1.0 / (20.0 * float(Fraction(ratio))), dim=dim)
                operator = Operator("gradient", form, correction)
                measured = [
                    measure(scene, kernel, operator, field, targets=targets, workers=1)
                    for _ in range(2 if quick else 5)
                ]
                found, times = measured[0], [one.seconds for one in measured]
                error = found.error
                assert error is not None
                pairs = found.pairs / targets
                rows.append(
                    (
                        f"{kernel.name}, {form}, {correction}",
                        ratio,
                        pairs,
                        error["rms"],
                        1e6 * median(times) / targets,
                        error["rms"] / pairs,
                    )
                )
    front = pareto([(row[4], row[3]) for row in rows])
    return Table(
        f"{dim}D gradient of a sinusoid, 20 particles a wavelength, σ/Δx = 0.2",
        (
            "operator",
            "Δx/h",
            "neighbours",
            "rms error",
            "µs a target",
            "error a neighbour",
            "front",
        ),
        [(*row, "*" if i in front else "") for i, row in enumerate(rows)],
        "front: nothing else is both faster and more accurate",
    )


_KERNELS = ("cubic-spline", "quintic-spline", "wendland-c2", "wendland-c4", "polynomial:4")
_FORMS = (
    ("standard", "none"),
    ("difference", "none"),
    ("difference", "csph"),
    ("standard", "rkpm-1"),
)


def _path(dim: int, quick: bool) -> Table:
    """Along h ∝ Δx^p, the best balance of smoothing and disorder, from Δx/h = 0.7 at λ/Δx = 10."""
    kernel = parse_kernel("cubic-spline")
    targets = 100 if quick else 1000
    rows: list[tuple[Any, ...]] = []
    for form, correction in _FORMS[:3]:
        operator = Operator("gradient", form, correction)
        p = float(exponents(operator, dim).p)
        for refined in (1, 2, 4) if quick else (1, 2, 4, 8):
            ratio = 0.7 * float(refined) ** (p - 1.0)
            dx = 0.1 / refined
            scene = jittered(lattice(dim, None, Fraction(ratio).limit_denominator(1000)), 0.2)
            field = sinusoid(dx / ratio, dim=dim)
            found = measure(scene, kernel, operator, field, targets=targets, workers=1)
            error = found.error
            assert error is not None
            rows.append(
                (
                    f"{form}, {correction}",
                    refined * 10,
                    ratio,
                    found.pairs / targets,
                    error["rms"],
                    1e6 * found.seconds / targets,
                )
            )
    return Table(
        f"{dim}D along the best path, cubic spline, σ/Δx = 0.2",
        ("operator", "λ/Δx", "Δx/h", "neighbours", "rms error", "µs a target"),
        rows,
    )


def pareto(points: list[tuple[float, float]]) -> set[int]:
    """Which points no other one beats in one coordinate without losing in the other."""
    return {
        i
        for i, (x, y) in enumerate(points)
        if not any((u <= x and v <= y) and (u < x or v < y) for u, v in points)
    }
