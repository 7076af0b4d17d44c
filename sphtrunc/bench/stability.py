"""Stability: the numerics under stress. For each case the true rounding error, from sums in 60
digits, beside the bound that was reported; where digits are lost the bound says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log10
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array
from sphtrunc.bench.report import Table
from sphtrunc.experiment.engine import available, pair_sums
from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.one_pass import estimates
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.moments import multi_indices, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.particles import Particles, particles

SINGLE = 2.0**-24  # relative error of positions in single precision
_TARGETS = 6


@dataclass(frozen=True)
class Case:
    """Particles, what they are known to (quantum), and the same ones as they truly are."""

    name: str
    parameter: float
    scene: Particles
    kernel: str = "cubic-spline"
    quantum: float = 0.0
    true: Particles | None = None
    field: float = 1.0


def stability(quick: bool) -> Iterator[Table]:
    """Sums of explicit particles, corrections, and the floor of a sinusoid's gradient."""
    yield _sums(quick)
    yield _corrections()
    yield _floor(quick)


# ----------------------------------------------------------------------- sums against 60 digits


def cases(quick: bool) -> Iterator[Case]:
    """Clouds of particles with everything that hurts."""
    rng = np.random.default_rng(7)
    step = 3 if quick else 1
    for offset in [0.0, 1.0, 1e3, 1e6, 1e9, 1e12][::step]:
        x, volume = _cloud(3, 5, rng)
        yield Case("coordinates from", offset, particles(x.T + offset, h=1.3, volume=volume))
    for offset in [0.0, 1.0, 1e2, 1e4][::step]:
        x, volume = _cloud(3, 5, rng)
        single = (x + offset).astype(np.float32)
        yield Case(
            "single precision from",
            offset,
            particles(single.T, h=1.3, volume=volume),
            quantum=SINGLE,
            true=particles((x + offset).T, h=1.3, volume=volume),
        )
    for gap in [1e-4, 1e-8, 1e-12, 1e-16, 1e-30, 1e-100][::step]:
        for name in ("cubic-spline", "spiky"):
            x, volume = _cloud(2, 5, rng)
            x -= x[:, :1]
            x[:, 1] = (gap, 0.5 * gap)
            yield Case(
                f"two particles apart by ({name})",
                gap,
                particles(x.T, h=1.3, volume=volume),
                name,
            )
    for thin in [1e-2, 1e-6, 1e-12][::step]:
        x, volume = _cloud(3, 5, rng)
        x[2] *= thin
        yield Case("flattened by", thin, particles(x.T, h=1.3, volume=volume))
    for ratio in [0.02, 0.1, 0.5, 1.0, 1.9, 3.0][::step]:
        x = ratio * (np.arange(401.0) + 0.2 * rng.standard_normal(401))
        yield Case("Δx/h", ratio, particles(x, h=1.0, volume=ratio))
    for power in [-1000, -300, 300, 1000][::step]:
        x, volume = _cloud(1, 30, rng)
        h = 2.0**power
        yield Case("h = 2^", float(power), particles(x[0] * h, h=1.3 * h, volume=volume * h))
    for power in [-1060, -1000, 1000][::step]:
        x, volume = _cloud(2, 5, rng)
        yield Case(
            "a field of 2^", float(power), particles(x.T, h=1.3, volume=volume), field=2.0**power
        )
    for name in ("b-spline:20", "polynomial:20", "wendland-c8", "polynomial:-1", "hyperbolic"):
        x, volume = _cloud(3, 5, rng)
        kernel = parse_kernel(name)
        h = 2.6 / float(kernel.support)
        yield Case(f"kernel {name}", h, particles(x.T, h=h, volume=volume), name)


def _cloud(dim: int, side: int, rng: np.random.Generator) -> tuple[Array, Array]:
    grid = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij")).reshape(dim, -1)
    x: Array = grid + 0.2 * rng.standard_normal(grid.shape)
    return x, np.asarray(rng.uniform(0.5, 1.5, x.shape[1]))


def against_truth(case: Case, engine: str, precision: str) -> tuple[float, float, float, bool]:
    """Largest true error, its bound, the size of the sums, and whether every bound held: all
    moments of the standard gradient up to degree 2 at a few targets."""
    kernel = parse_kernel(case.kernel)
    dim = case.scene.dim
    targets = np.arange(min(_TARGETS, case.scene.population))
    if case.name == "Δx/h":
        targets += 200
    alphas = list(multi_indices(dim, 2))
    keys = [(unit(dim, 0), alpha) for alpha in alphas]
    found = pair_sums(
        case.scene,
        kernel,
        keys,
        fields=np.full(case.scene.population, case.field),
        field_keys=keys,
        targets=targets,
        precision=precision,
        bound=True,
        quantum=case.quantum,
        engine=engine,
    )
    exact = measure(
        case.true or case.scene, kernel, "gradient", moments=2, targets=targets, precision="exact"
    )
    assert found.fields_bound is not None
    used = exact.used  # without neighbours there is nothing to compare
    errors, bounds, sizes = [], [], []
    for alpha, key in zip(alphas, keys, strict=True):
        truth = exact.moments.values[alpha] * case.field
        values, bound = found.fields[key][0, used], found.fields_bound[key][0, used]
        errors.append(np.abs(values - truth))
        bounds.append(bound + 2.0 * UNIT * np.abs(truth))  # the reference is rounded, too
        sizes.append(np.abs(truth))
    error, bound, size = (np.stack(rows) for rows in (errors, bounds, sizes))
    held = bool(np.all(error <= bound)) and bool(np.all(np.isfinite(found.fields[keys[0]])))
    return float(error.max()), float(bound.max()), float(size.max()), held


def _sums(quick: bool) -> Table:
    rows: list[tuple[Any, ...]] = []
    for case in cases(quick):
        for engine in available():
            for precision in ("plain", "compensated"):
                label = f"{case.name} [{engine}, {precision}]"
                try:
                    error, bound, size, held = against_truth(case, engine, precision)
                except ValueError as refusal:
                    rows.append((label, case.parameter, None, None, None, None, str(refusal)[:40]))
                    continue
                digits = -log10(bound / size) if bound > 0 and size > 0 else 16.0
                ratio = bound / error if error > 0 else None
                rows.append(
                    (
                        label,
                        case.parameter,
                        error,
                        bound,
                        ratio,
                        digits,
                        "held" if held else "VIOLATED",
                    )
                )
    return Table(
        "sums of explicit particles against 60 digits",
        ("case", "parameter", "error", "bound", "bound/error", "digits left", "verdict"),
        rows,
        "digits left: what the bound vouches for, of the largest of the sums",
    )


# ---------------------------------------------------------------------------------- corrections


def _corrections() -> Table:
    """A linear field's gradient on clouds that are flattened until the matrix is singular."""
    rows: list[tuple[Any, ...]] = []
    rng = np.random.default_rng(11)
    x, volume = _cloud(2, 8, rng)
    kernel = parse_kernel("cubic-spline")
    for thin in 10.0 ** -np.arange(0.0, 17.0, 2.0):
        for shear in (0.0, 1.0):
            y = np.stack([x[0], thin * x[1] + shear * x[0]])
            scene = particles(y.T, h=2.6, volume=volume)
            for correction in ("csph", "rkpm-1"):
                form = "difference" if correction == "csph" else "standard"
                operator = Operator("gradient", form, correction)
                found = estimates(scene, kernel, operator, y, engine="numpy")
                good = ~found.flagged
                extent = np.array([1.0, max(thin, shear)])
                error = np.abs(found.values[:, :, good] / 2.6 - np.eye(2)[:, :, None])
                error *= extent[None, :, None] / extent[:, None, None]
                condition = float(found.condition.max())
                allowed = 64.0 * UNIT * found.condition[good] * found.neighbours[good]
                rows.append(
                    (
                        f"{correction}, flattened{' and sheared' if shear else ''}",
                        float(thin),
                        condition,
                        int(found.flagged.sum()),
                        float(error.max()) if error.size else None,
                        "held" if np.all(error <= allowed) else "VIOLATED",
                    )
                )
    return Table(
        "corrections next to singular: the gradients of the coordinates",
        ("case", "parameter", "condition", "flagged of 64", "error of the others", "verdict"),
        rows,
        "error: relative to the extent of the cloud along each axis; held: below 64 u times the"
        " condition that is reported and the number of neighbours",
    )


# ----------------------------------------------------------------------------------------- floor


def floor(h_over_lambda: float, dx_over_h: float, form: str) -> tuple[float, float]:
    """Largest rounding error of the gradient of a sinusoid at jittered particles in 1D, relative to
    the gradient, found by sums in twice the precision; and the bound that was reported."""
    scene = jittered(lattice(1, "uniform", dx_over_h), 0.2)
    field = sinusoid(h_over_lambda)
    options: dict[str, Any] = {"form": form, "targets": 64}
    kernel = parse_kernel("cubic-spline")
    plain = measure(scene, kernel, "gradient", field, bound=True, **options)
    wide = measure(scene, kernel, "gradient", field, precision="extended", **options)
    assert plain.errors is not None
    assert wide.errors is not None
    assert plain.error_bound is not None
    error = np.abs(plain.errors - wide.errors)
    return float(error.max()), float(plain.rounding_bound or 0.0)


def _floor(quick: bool) -> Table:
    rows: list[tuple[Any, ...]] = []
    powers = (0, 4, 8, 12) if quick else range(0, 13, 2)
    for form in ("standard", "difference"):
        for power in powers:
            for ratio in (0.02, 0.5, 1.5) if quick else (0.02, 0.1, 0.3, 0.5, 0.7, 1.0, 1.5, 1.9):
                error, bound = floor(10.0**-power, ratio, form)
                held = "held" if error <= bound else "VIOLATED"
                rows.append(
                    (
                        form,
                        10.0**-power,
                        ratio,
                        error,
                        bound,
                        bound / error if error else None,
                        held,
                    )
                )
    return Table(
        "floor of the gradient of a sinusoid, jittered particles in 1D",
        ("form", "h/λ", "Δx/h", "error", "bound", "bound/error", "verdict"),
        rows,
    )
