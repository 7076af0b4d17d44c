"""Plateaus: why the error of somebody's runs stops falling, from the predicted parts of it.

A model of the runs is a disorder σ/Δx and the length of the wave that matters. It explains them if
measured and predicted errors are alike and change alike with Δx; only such a model gives advice.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
LITTLE = 0.05  # a part of an error that is not worth an explanation
TRIED = 5  # of the runs
STEEP = 0.5  # powers of Δx that differ by more are those of different parts, which are integers
WAVES = np.geomspace(16.0, 1 / 16, 33)  # wavelengths that are tried, in λ


def explain(
    problem: Problem,
    kernel: Kernel | str,
    rows: Sequence[tuple[float, float, float]],
    wave: float = 1.0,
) -> list[Run]:
    """What dominates the error of somebody's runs: rows (Δx/λ, h/λ, error), error nan if not known.

    wave: the length of the wave that matters, in λ.

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
        here = setting(problem, shape, dx / h, h / wave)
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


def _order(runs: Sequence[Run], column: str, where: str = "dx_over_lambda") -> float | None:
    """The power of Δx along these runs, as far as another column is known."""
    known = [(log(r["dx_over_lambda"]), log(r[column])) for r in runs if r[column] and r[where]]
    if len({x for x, _ in known}) < 2:
        return None
    x, y = zip(*known, strict=True)
    return float(np.polyfit(x, y, 1)[0])


@dataclass(frozen=True)
class Explanation:
    """A model with which the predicted errors are those of the runs.

    wave: the length of the wave that matters, in λ; runs: as from `explain`, with that model
    """

    problem: Problem
    wave: float
    runs: list[Run]

    @property
    def widest(self) -> float:
        """The largest factor between measured and predicted errors, either way."""
        ratios = _ratios(self.runs)
        return max(max(ratios), 1 / min(ratios))

    @property
    def fits(self) -> bool:
        """Errors are alike, and so is the power of Δx as far as the runs tell it."""
        orders = [_order(self.runs, column, "error") for column in ("error", "predicted")]
        if orders[0] is None or orders[1] is None:
            return self.widest <= ALIKE
        lengths = [log(run["dx_over_lambda"]) for run in self.runs if run["error"]]
        allowed = max(STEEP, log(1.5) / (max(lengths) - min(lengths)))
        return self.widest <= ALIKE and abs(orders[0] - orders[1]) <= allowed

    @property
    def name(self) -> str:
        """What is to be given for it."""
        if self.wave != 1:
            return f"a wave of {self.wave:.2g} λ"
        return f"--jitter {self.problem.sigma:.2g}"

    def to_dict(self) -> dict[str, Any]:
        """The model, and the runs with it."""
        return {
            "name": self.name,
            "jitter": self.problem.sigma,
            "wavelength": self.wave,
            "factor": self.widest,
            "runs": self.runs,
        }


def explanations(problem: Problem, kernel: Kernel | str, runs: Sequence[Run]) -> list[Explanation]:
    """The models that explain the runs: the problem as it is given; if that does not, another
    disorder and another wavelength, the better one first. Empty where no error is known."""
    shape = parse_kernel(kernel)
    known = [run for run in runs if run["error"]]
    if not known:
        return []
    given = Explanation(problem, 1.0, list(runs))
    if given.fits:
        return [given]
    rows = [
        (
            r["dx_over_lambda"],
            r["h_over_lambda"],
            float("nan") if r["error"] is None else r["error"],
        )
        for r in runs
    ]
    tried = [*known[:: -(-len(known) // TRIED)], known[-1]]
    found = []
    sigma, wave = _disorder_of(problem, shape, tried), _wave_of(problem, shape, tried)
    if sigma is not None:
        other = replace(problem, sigma=sigma)
        found.append(Explanation(other, 1.0, explain(other, shape, rows)))
    if wave is not None:
        found.append(Explanation(problem, wave, explain(problem, shape, rows, wave)))
    several = len({run["dx_over_lambda"] for run in known}) > 1  # one run is met by either
    return sorted((e for e in found if e.fits), key=lambda e: several * e.widest)


def findings(
    problem: Problem,
    kernel: Kernel | str,
    runs: Sequence[Run],
    found: Sequence[Explanation] | None = None,
) -> list[str]:
    """The same in sentences: which model explains the runs, if any, what dominates where by that
    model, and what to change; where two do, the run that would decide between them.

    found: the `explanations`, where they are at hand
    """
    if not any(run["error"] for run in runs):
        return _parts(problem, runs)
    found = explanations(problem, kernel, runs) if found is None else found
    if not found:
        return [
            f"{_apart(runs)}, and no other λ and no disorder explains that: look for an error that"
            " is not the estimate's (in time, at boundaries, in the reference), or another norm;"
            f" here it is the rms error over the largest exact value.{_evidence(problem, runs)}"
        ]
    first, *others = found
    if first.problem == problem and first.wave == 1:
        agree = f"Measured and predicted agree within a factor {first.widest:.3g}"
        return [f"{agree}: this explains the runs.", *_parts(problem, runs)]
    known = f"{problem.sigma:g}" if first.wave == 1 else "λ"
    said = [
        f"{_apart(runs)}; {first.name} in place of {known} would explain that."
        f"{_slopes(first, runs)}",
        *_parts(first.problem, first.runs),
    ]
    for other in others:
        part = other.runs[-1]["dominant"]
        said.append(
            f"The errors agree as well with {other.name}, where they are mostly {part}."
            f" {_decisive(kernel, first, other)}"
        )
    return said


def _parts(problem: Problem, runs: Sequence[Run]) -> list[str]:
    """What dominates where, and what to change."""
    said = []
    for dominant, group in groupby(runs, key=lambda run: str(run["dominant"])):
        members = list(group)
        first, last = (f"{members[i]['dx_over_lambda']:.3g}" for i in (0, -1))
        where = f"Δx/λ = {first}" if first == last else f"Δx/λ from {first} to {last}"
        orders = [_order(members, column) for column in ("error", "predicted")]
        text = f"{where}: {dominant} dominates"
        if orders[0] is not None and orders[1] is not None:
            text += f"; the error goes as {_power(orders[0])}, predicted {_power(orders[1])}"
        level = orders[1] is not None and abs(orders[1]) < 0.25
        said.append(f"{text}. {advice(problem, dominant, level)}")
    return said


def _power(order: float) -> str:
    return f"Δx^{round(order, 1) + 0.0:g}"


def _ratios(runs: Sequence[Run]) -> list[float]:
    return [run["error"] / run["predicted"] for run in runs if run["error"]]


def _apart(runs: Sequence[Run]) -> str:
    """How far the errors are from the predicted ones."""
    ratios = _ratios(runs)
    typical = exp(float(np.median(np.log(ratios))))
    if len(ratios) == 1:
        return f"The error is {typical:.2g} times the predicted"
    return (
        f"The errors are {typical:.2g} times the predicted in the median, from {min(ratios):.2g} to"
        f" {max(ratios):.2g}"
    )


def _slopes(found: Explanation, runs: Sequence[Run]) -> str:
    """The powers of Δx as evidence."""
    seen, before, now = (
        _order(rows, column, "error")
        for rows, column in ((runs, "error"), (runs, "predicted"), (found.runs, "predicted"))
    )
    if seen is None or before is None or now is None:
        return ""
    return (
        f" They go as {_power(seen)}, as predicted with it, {_power(now)}, rather than without,"
        f" {_power(before)}."
    )


def _evidence(problem: Problem, runs: Sequence[Run]) -> str:
    """The powers of Δx beside those of the parts, where Δx/h is the same in all runs."""
    seen = _order(runs, "error")
    ratios = [run["dx_over_lambda"] / run["h_over_lambda"] for run in runs]
    if seen is None or max(ratios) > 1.01 * min(ratios):
        return ""
    smoothing = smoothing_power(problem.operator)
    return (
        f" They go as {_power(seen)}; at this Δx/h smoothing goes as Δx^{smoothing}, discretisation"
        f" as Δx^0, disorder as Δx^{_disorder_power(problem.operator)}."
    )


def _decisive(kernel: Kernel | str, first: Explanation, other: Explanation) -> str:
    """The run, finer or with more neighbours than the finest, of which two models say the most
    different errors, each further from the other than errors that are alike."""
    shape = parse_kernel(kernel)
    finest = first.runs[-1]
    dx, h = finest["dx_over_lambda"], finest["h_over_lambda"]
    found = []
    for finer, less in ((2, 2), (4, 4), (2, 1), (4, 2)):  # Δx and h divided by so much
        ratio = dx / finer * less / h
        errors = [
            setting(model.problem, shape, ratio, h / less / model.wave).error.total
            for model in (first, other)
        ]
        found.append((abs(log(errors[0] / errors[1])), finer, less, errors))
        if found[-1][0] > 2 * log(ALIKE):
            break
    _, finer, less, errors = max(found)
    return (
        f"To decide, a run with Δx/λ = {dx / finer:.3g} and h/λ = {h / less:.3g}: its error is"
        f" {errors[0]:.2g} by {first.name} and {errors[1]:.2g} by {other.name}."
    )


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
    power = _disorder_power(operator)
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


def _disorder_power(operator: Operator) -> int:
    """Of h at a fixed Δx/h."""
    return operator.consistency + 1 - operator.derivatives


def power_text(base: str, power: Fraction) -> str:
    """A power as it is read: Δx, Δx^2 or Δx^(2/5)."""
    if power == 1:
        return base
    return f"{base}^{power}" if power.denominator == 1 else f"{base}^({power})"


def _disorder_of(problem: Problem, kernel: Kernel, runs: Sequence[Run]) -> float | None:
    """The σ/Δx at which the median of measured over predicted is one, 0 where it is not more
    without any disorder, None where it is more with all."""

    def median(sigma: float) -> float | None:
        other = replace(problem, sigma=sigma)
        found = []
        for run in runs:
            dx, h = run["dx_over_lambda"], run["h_over_lambda"]
            splits = other.split(kernel, dx / h, [h])
            if splits is None:
                return None
            found.append(log(run["error"] / splits[0].total))
        return float(np.median(found))

    none = median(0.0)
    if none is not None and none < LITTLE:
        return 0.0
    low, high = log(LEAST), log(MOST)
    for _ in range(14):
        middle = 0.5 * (low + high)
        found = median(exp(middle))
        if found is None or found < 0:
            high = middle
        else:
            low = middle
    return exp(low) if exp(low) < 0.99 * MOST else None


def _wave_of(problem: Problem, kernel: Kernel, runs: Sequence[Run]) -> float | None:
    """The length of a wave, in λ and nearest to it, with which the errors are alike, if there is
    one."""

    def misfit(waves: Any) -> Any:
        worst = np.zeros(len(waves))
        for run in runs:
            dx, h = run["dx_over_lambda"], run["h_over_lambda"]
            splits = problem.split(kernel, dx / h, [float(h / wave) for wave in waves])
            if splits is None:
                return np.full(len(waves), np.inf)
            off = np.abs(np.log(run["error"] / np.array([split.total for split in splits])))
            seen = np.maximum(h, dx) <= 0.5 * waves  # as `tune` has it: two particles, two lengths
            worst = np.maximum(worst, np.where(seen, off, np.inf))
        return worst

    off = misfit(WAVES)
    sides = np.concatenate([[np.inf], off, [np.inf]])
    valley = (off <= sides[:-2]) & (off <= sides[2:]) & (off <= log(ALIKE))
    if not valley.any():
        return None
    place = min(np.flatnonzero(valley), key=lambda i: abs(log(WAVES[i])))
    near = WAVES[place] * np.geomspace(WAVES[0] / WAVES[1], WAVES[1] / WAVES[0], 33)
    return float(near[int(np.argmin(misfit(near)))])


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
