"""Plateaus: why the error of somebody's runs stops falling, from the predicted parts of it."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from fractions import Fraction
from itertools import groupby
from math import exp, isfinite, log
from pathlib import Path
from typing import Any

import numpy as np

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.study.tuning import PARTS, Problem, exponents, setting, smoothing_power

Run = dict[str, Any]

ALIKE = 2.0  # measured over predicted, either way: norms of an error differ by as much
LEAST, MOST = 1e-4, 0.6  # σ/Δx that are tried on runs whose disorder is not known
TRIED = 5  # of the runs


def explain(
    problem: Problem, kernel: Kernel | str, rows: Sequence[tuple[float, float, float]]
) -> list[Run]:
    """What dominates the error of somebody's runs: rows (Δx/λ, h/λ, error), error nan if not known.

    In the order of falling Δx, each with its predicted error and parts, the part that dominates,
    and `order` and `predicted_order`, the power of Δx with which the error changed since the run
    before, None where there is none.

    Raises ValueError for lengths that are not positive, or too few neighbours.
    """
    shape = parse_kernel(kernel)
    runs: list[Run] = []
    for dx, h, error in sorted(rows, key=lambda row: -row[0]):
        if not (0 < dx < float("inf") and 0 < h < float("inf")):
            raise ValueError(f"table: got Δx = {dx:g}, h = {h:g}, expected positive lengths")
        here = setting(problem, shape, dx / h, h)
        run = {
            "dx_over_lambda": dx,
            "h_over_lambda": h,
            "neighbours": here.neighbours,
            "error": error if isfinite(error) else None,
            "predicted": here.error.total,
            **{part: getattr(here.error, part) for part in PARTS},
            "dominant": here.dominant,
        }
        before = runs[-1:]
        run["order"] = _order([*before, run], "error")
        run["predicted_order"] = _order([*before, run], "predicted")
        runs.append(run)
    return runs


def _order(runs: Sequence[Run], column: str) -> float | None:
    """The power of Δx along these runs."""
    known = [(log(r["dx_over_lambda"]), log(r[column])) for r in runs if r[column]]
    if len({x for x, _ in known}) < 2:
        return None
    x, y = zip(*known, strict=True)
    return float(np.polyfit(x, y, 1)[0])


def findings(problem: Problem, kernel: Kernel | str, runs: Sequence[Run]) -> list[str]:
    """The same in sentences: whether the prediction explains the runs at all, what dominates where,
    and what to change."""
    said = _trust(problem, parse_kernel(kernel), runs)
    for dominant, group in groupby(runs, key=lambda run: str(run["dominant"])):
        members = list(group)
        first, last = (f"{members[i]['dx_over_lambda']:.3g}" for i in (0, -1))
        where = f"Δx/λ = {first}" if first == last else f"Δx/λ from {first} to {last}"
        orders = [_order(members, column) for column in ("error", "predicted")]
        text = f"{where}: {dominant} dominates"
        if orders[0] is not None and orders[1] is not None:
            seen, predicted = (
                f"Δx^{round(order, 1) + 0.0:g}" for order in orders if order is not None
            )
            text += f"; the error goes as {seen}, predicted {predicted}"
        level = orders[1] is not None and abs(orders[1]) < 0.25
        said.append(f"{text}. {advice(problem, dominant, level)}")
    return said


def advice(problem: Problem, part: str, level: bool = False) -> str:
    """What a part of the error does and what to change. level: it is seen not to fall."""
    if part == "smoothing":
        power = smoothing_power(problem.operator)
        return (
            f"It falls as h^{power}: take a smaller h (at the same Δx/h, so with more particles),"
            " or a kernel of smaller second moment, until another part takes over."
        )
    if part == "discretisation":
        plateau = "A plateau: at this Δx/h refinement does not lower it. " if level else ""
        return (
            f"{plateau}It is that of the kernel's sum on a lattice: take more neighbours (a smaller"
            " Δx/h), or a smoother kernel."
        )
    if part == "rounding":
        return (
            "The digits of double precision end here: take a larger h, the difference form, or"
            " compensated sums and offsets in place of coordinates."
        )
    return _disorder(problem.operator, problem.dim)


def _disorder(operator: Operator, dim: int) -> str:
    """Disorder is ∝ h^{j−m}, j the degree of the first polynomial that is not reproduced."""
    power = operator.consistency + 1 - operator.derivatives
    if power < 0:
        grows = "1/h" if power == -1 else f"1/h^{-power}"
        text = f"At a fixed number of neighbours it grows as {grows}: refinement makes it worse."
    elif power == 0:
        text = "A plateau: at a fixed number of neighbours refinement does not lower it."
    else:
        text = f"At a fixed number of neighbours it falls as {'h' if power == 1 else f'h^{power}'}."
    better = {
        ("gradient", -1): "the difference form (it stays level) or CSPH (it falls as h)",
        ("gradient", 0): "CSPH or RKPM-1 (it falls as h)",
        ("laplacian", 0): "fatehi-manzari or RKPM-2",
    }.get((operator.name, operator.consistency), "a form that is consistent of higher order")
    path = exponents(operator, dim)
    return (
        f"{text} Take {better}, particles in better order, or neighbours that grow as"
        f" {power_text('N', path.neighbours)}, which is h ∝ {power_text('Δx', path.p)}."
    )


def power_text(base: str, power: Fraction) -> str:
    """A power as it is read: Δx, Δx^2 or Δx^(2/5)."""
    if power == 1:
        return base
    return f"{base}^{power}" if power.denominator == 1 else f"{base}^({power})"


def _trust(problem: Problem, kernel: Kernel, runs: Sequence[Run]) -> list[str]:
    """Whether measured and predicted errors are alike, and which disorder would make them so."""
    known = [run for run in runs if run["error"]]
    if not known:
        return []
    ratios = [run["error"] / run["predicted"] for run in known]
    typical = exp(float(np.median(np.log(ratios))))
    widest = max(max(ratios), 1 / min(ratios))
    if widest <= ALIKE:
        return [
            f"Measured and predicted agree within a factor {widest:.3g}: this explains the runs."
        ]
    several = len(ratios) > 1
    text = f"The {'errors are' if several else 'error is'} {typical:.2g} times the predicted" + (
        f" in the median, from {min(ratios):.2g} to {max(ratios):.2g}" if several else ""
    )
    sigma = _explaining(problem, kernel, known)
    if sigma is not None:
        return [f"{text}; --jitter {sigma:.2g} in place of {problem.sigma:g} would explain that."]
    return [
        f"{text}, and no disorder explains that: look for an error that is not the estimate's (in"
        " time, at boundaries, in the reference), another λ, or another norm; here it is the rms"
        " error over the largest exact value."
    ]


def _explaining(problem: Problem, kernel: Kernel, runs: Sequence[Run]) -> float | None:
    """The σ/Δx at which the median of measured over predicted is one, if all are alike there."""
    step = -(-len(runs) // TRIED)
    tried = [*runs[::step], runs[-1]]

    def ratios(sigma: float) -> list[float] | None:
        other = Problem(problem.dim, problem.operator, sigma, problem.distribution, problem.lattice)
        found = []
        for run in tried:
            dx, h = run["dx_over_lambda"], run["h_over_lambda"]
            splits = other.split(kernel, dx / h, [h])
            if splits is None:
                return None
            found.append(log(run["error"] / splits[0].total))
        return found

    low, high = log(LEAST), log(MOST)
    for _ in range(14):
        middle = 0.5 * (low + high)
        found = ratios(exp(middle))
        if found is None or float(np.median(found)) < 0:
            high = middle
        else:
            low = middle
    found = ratios(exp(low))
    alike = found is not None and max(abs(x) for x in found) <= log(ALIKE)
    return exp(low) if alike and exp(low) < 0.99 * MOST else None


def read_table(
    file: str | Path, dim: int, wavelength: float = 1.0, box: float = 1.0
) -> list[tuple[float, float, float]]:
    """Rows (Δx/λ, h/λ, error) of a CSV table with the columns dx (or n, the number of particles in
    a box whose side is `box` λ), h and error; dx and h in the unit of `wavelength`.

    Raises ValueError for a table that cannot be read, with the line.
    """
    for name, value in (("wavelength", wavelength), ("box", box)):
        if not 0 < value < float("inf"):
            raise ValueError(f"{name}: got {value:g}, expected a positive length")
    try:
        text = Path(file).read_text(encoding="utf-8-sig")
    except OSError as failure:
        raise ValueError(f"table {file}: {failure.strerror or failure}") from None
    except UnicodeDecodeError:
        raise ValueError(f"table {file}: it is not text; expected CSV in UTF-8") from None
    reader = csv.DictReader(text.splitlines(), skipinitialspace=True)
    names = {name.strip().lower(): name for name in reader.fieldnames or [] if name}
    if "h" not in names or not {"dx", "n"} & set(names):
        shown = ", ".join(names) or "none"
        raise ValueError(f"table {file}: got columns {shown[:80]}, expected dx (or n), h and error")
    rows: list[tuple[float, float, float]] = []
    for number, row in enumerate(reader, start=2):
        try:
            h = float(row[names["h"]]) / wavelength
            if "dx" in names:
                dx = float(row[names["dx"]]) / wavelength
            else:
                dx = box * float(row[names["n"]]) ** (-1 / dim)
            said = (row[names["error"]] or "").strip() if "error" in names else ""
            error = float(said) if said else float("nan")
        except (TypeError, ValueError, ZeroDivisionError, OverflowError):
            raise ValueError(f"table {file}: line {number} is not a row of numbers") from None
        if not (isinstance(dx, float) and dx > 0 and h > 0 and not error < 0):
            raise ValueError(
                f"table {file}: line {number}: expected positive lengths and an error of 0 or more"
            )
        rows.append((dx, h, error))
    if not rows:
        raise ValueError(f"table {file}: expected at least one row")
    return rows
