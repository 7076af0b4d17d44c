"""Measurement: what an experiment found, its statistics, and how they are read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.summation import Array
from sphtrunc.operators.moments import Moments, MultiIndex, label
from sphtrunc.scenes.neighbourhood import Indices
from sphtrunc.version import __version__

if TYPE_CHECKING:
    pass

SIGMAS = 1.959963984540054  # of a normal distribution: 95 % lie within
PHASES = 720  # at which the one target of a lattice is shown a sinusoid


#: multi-index -> (T,)
Moment = Mapping[MultiIndex, Array]


@dataclass(frozen=True)
class Block:
    """What one block of T targets gave; arrays over targets.

    estimates: (C, T) components of the estimate, and errors: (C, T) less the exact derivative, both
        in units of A/h^k; None without a field (errors: without exact derivatives)
    moments: multi-index -> (T,) of each component; empty without any
    rest, moment_rest: what the arithmetic holds beside the values (of the errors, where there are
        any): bounds of the rounding errors, or the digits that follow
    pairs, neighbours: (T,) particles within the support, with and without those at the target
    condition: (T,) of the worst correction matrix
    """

    target: Indices
    estimates: Array | None
    errors: Array | None
    moments: tuple[Moment, ...]
    rest: Array | None
    moment_rest: tuple[Moment, ...] | None
    pairs: Indices
    neighbours: Indices
    condition: Array


@dataclass(frozen=True)
class Measurement:
    """A measured truncation error.

    settings: every option as it was resolved
    targets: how many were measured, and `target`: which
    pairs: particles within the support of these targets; pairs_full: of all particles of the scene
    corrections, bounds: correction matrices solved, bounds computed
    flagged: targets without neighbours or with a correction matrix too near to a singular one,
        which take no part in the statistics; first_flagged: (index, neighbours) of the first
    errors: (C, n) per target, relative to the largest exact derivative; None without a field
    errors_low: (C, n), the digits that follow those of the errors, in extended and exact precision
        (None for the phases of a lattice)
    estimates: (C, n) in units of A/h^k (explicit particles: of A/length^k); None without a field
    moments: measured M_α of the first component, arrays (n,) over targets; moments_of: of each
        component of what the operator stands for, for divergence and curl of the gradient
    rounding_bound: largest bound of the rounding error of an error figure, relative likewise;
        without a field, of a moment; None if not asked for
    error_bound: (C, n), and moment_bound: multi-index -> (n,), the bounds one by one
    interrupted: the run was stopped before its end
    """

    settings: dict[str, Any]
    target: Indices
    pairs: int
    pairs_full: int
    corrections: int
    bounds: int
    flagged: int
    first_flagged: tuple[int, int] | None
    condition: Array
    errors: Array | None
    errors_low: Array | None
    estimates: Array | None
    moments: Moments
    moments_of: tuple[Moments, ...]
    error_bound: Array | None
    moment_bound: Mapping[MultiIndex, Array] | None
    rounding_bound: float | None
    exact_statistics: bool
    interrupted: bool
    seconds: float

    @property
    def targets(self) -> int:
        """The number of targets measured."""
        return int(self.target.size)

    @property
    def used(self) -> Any:
        """Mask of the targets that were not flagged."""
        return np.isfinite(self.condition)

    @property
    def error(self) -> dict[str, Any] | None:
        """Statistics of the length of the error vector: rms, largest, percentiles, with 95 %
        confidence intervals; per component the rms. None without a field, or if every target was
        flagged."""
        if self.errors is None or not self.errors.shape[1]:
            return None
        size = float(np.abs(self.errors).max()) or 1.0  # squares must not overflow
        square = ((self.errors / size) ** 2).sum(axis=0)
        length = size * np.sqrt(square)
        result: dict[str, Any] = {}
        result["rms"], result["rms_ci95"] = self._rms(square, size)
        result["max"] = float(length.max())
        ordered = np.sort(length)
        for name, p in (("p50", 0.5), ("p99", 0.99)):
            result[name], result[f"{name}_ci95"] = self._percentile(ordered, p)
        result["components"] = [self._rms((e / size) ** 2, size)[0] for e in self.errors]
        return result

    def _rms(self, square: Array, size: float) -> tuple[float, list[float]]:
        mean = float(square.mean())
        spread = SIGMAS * float(square.std()) / sqrt(square.size)
        spread = 0.0 if self.exact_statistics else spread
        ends = [size * sqrt(max(mean - spread, 0.0)), size * sqrt(mean + spread)]
        return size * sqrt(mean), ends

    def _percentile(self, ordered: Array, p: float) -> tuple[float, list[float]]:
        """Order statistics; the interval from the binomial distribution of their ranks."""
        n = ordered.size
        value = float(ordered[min(n - 1, int(p * n))])
        if self.exact_statistics:
            return value, [value, value]
        spread = SIGMAS * sqrt(n * p * (1 - p))
        low, high = int(max(n * p - spread, 0)), int(min(n * p + spread + 1, n - 1))
        return value, [float(ordered[low]), float(ordered[high])]

    @property
    def explicit(self) -> bool:
        """Whether the scene is explicit particles, which somebody may want one by one."""
        return str(self.settings["scene"]).startswith("particles")

    @property
    def components(self) -> list[str]:
        """A name for each component of the estimates: x, y, z; xx, xy, …; or the operator's."""
        count = 0 if self.estimates is None else len(self.estimates)
        axes = "xyz"[: self.settings["dim"]]
        if self.settings["operator"] == "hessian":
            return [f"{a}{b}" for i, a in enumerate(axes) for b in axes[i:]]
        return list(axes) if count == len(axes) > 1 else [str(self.settings["operator"])]

    @property
    def estimate(self) -> list[dict[str, float]] | None:
        """Of every component of the estimates of explicit particles: mean, rms, extremes and
        quantiles over the targets, in units of A/length^k; None without a field or particles."""
        if self.estimates is None or not self.explicit:
            return None
        rows = []
        for values in self.estimates[:, self.used]:
            if not values.size:
                return None
            size = float(np.abs(values).max()) or 1.0  # squares must not overflow
            low, q1, median, q99, high = np.quantile(values, [0.0, 0.01, 0.5, 0.99, 1.0]).tolist()
            rows.append(
                {
                    "mean": size * float((values / size).mean()),
                    "rms": size * sqrt(float(((values / size) ** 2).mean())),
                    "min": low,
                    "p1": q1,
                    "p50": median,
                    "p99": q99,
                    "max": high,
                }
            )
        return rows

    @property
    def rows(self) -> list[str]:
        """A name for each component that has moments: x, y, z; xx, xy, …; or the operator's."""
        count, axes = len(self.moments_of), "xyz"[: self.settings["dim"]]
        if self.settings["operator"] == "hessian":
            return [f"{a}{b}" for i, a in enumerate(axes) for b in axes[i:]][:count]
        return list(axes) if count == len(axes) > 1 else [str(self.settings["operator"])]

    def moment_statistics(self, component: int = 0) -> dict[str, dict[str, Any]]:
        """ "0,0,0": mean, standard deviation over targets, 95 % confidence interval of the mean;
        of explicit particles 1 %, 50 % and 99 % quantiles, too."""
        result = {}
        for alpha, values in self.moments_of[component].values.items():
            if not values.size:
                continue
            mean, std = float(values.mean()), float(values.std())
            spread = 0.0 if self.exact_statistics else SIGMAS * std / sqrt(values.size)
            result[label(alpha)] = {
                "mean": mean,
                "std": 0.0 if self.exact_statistics else std,
                "ci95": [mean - spread, mean + spread],
            }
            if self.explicit:
                low, median, high = np.quantile(values, [0.01, 0.5, 0.99]).tolist()
                result[label(alpha)] |= {"p1": low, "p50": median, "p99": high}
        return result

    # -- how it is read ---------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """The contract of schema `sphtrunc.measure/1`."""
        first = self.first_flagged
        return {
            "schema": "sphtrunc.measure/1",
            **self.settings,
            "targets": self.targets,
            "pairs": self.pairs,
            "pairs_full": self.pairs_full,
            "corrections": self.corrections,
            "bounds": self.bounds,
            "flagged": self.flagged,
            "first_flagged": None if first is None else {"index": first[0], "neighbours": first[1]},
            "error": self.error,
            **({} if self.estimate is None else {"estimate": self.estimate}),
            "moments": self.moment_statistics(),
            **(
                {"moments_of": {c: self.moment_statistics(i) for i, c in enumerate(self.rows)}}
                if len(self.rows) > 1
                else {}
            ),
            "rounding_bound": self.rounding_bound,
            "interrupted": self.interrupted,
            "seconds": round(self.seconds, 3),
            "version": __version__,
        }

    def to_json(self) -> str:
        """`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)

    def to_csv(self) -> str:
        """One line per figure: quantity, value, standard deviation, confidence interval."""
        rows = ["quantity,value,std,ci95_low,ci95_high"]
        error = self.error
        if error is not None:
            for name in ("rms", "p50", "p99"):
                low, high = error[f"{name}_ci95"]
                rows.append(f"error_{name},{error[name]!r},,{low!r},{high!r}")
            rows.append(f"error_max,{error['max']!r},,,")
        for i, component in enumerate(self.rows):
            what = f"moment of {component}" if i else "moment"
            for key, row in self.moment_statistics(i).items():
                low, high = row["ci95"]
                name = key.replace(",", " ")
                rows.append(f"{what} {name},{row['mean']!r},{row['std']!r},{low!r},{high!r}")
        if self.rounding_bound is not None:
            rows.append(f"rounding_bound,{self.rounding_bound!r},,,")
        for name in ("targets", "pairs", "pairs_full", "flagged"):
            rows.append(f"{name},{getattr(self, name)},,,")
        if self.interrupted:
            rows.append("interrupted,true,,,")
        return "\n".join(rows)

    def to_text(self) -> str:
        """What a person reads first; at most 100 columns."""
        set_ = self.settings
        lines = [
            f"{set_['operator']} ({set_['form']} form, correction {set_['correction']})"
            f" with {set_['kernel']['name']}, {set_['dim']}D",
            f"  scene: {set_['scene']}",
            f"  field: {set_['field'] or 'none, moments only'}",
            f"  {self.targets} targets, {self.pairs} pairs evaluated"
            f" ({self.pairs_full:.3g} in the full scene), {self.seconds:.2f} s,"
            f" precision {set_['precision']}",
        ]
        if self.interrupted:
            lines.append("  interrupted: these are the targets measured so far")
        if self.first_flagged is not None:
            index, neighbours = self.first_flagged
            lines.append(
                f"  {self.flagged} targets flagged and left out (no neighbours, or a correction"
                f" matrix that is singular):\n    the first is target {index}, with {neighbours}"
                " neighbours"
            )
        error = self.error
        if error is not None:
            lines.append("Error, relative to the largest exact derivative")
            for name, says in (("rms", "rms"), ("p50", "median"), ("p99", "99 %")):
                low, high = error[f"{name}_ci95"]
                lines.append(f"  {says:<7} {error[name]:.6e}   [{low:.6e}, {high:.6e}] at 95 %")
            lines.append(f"  max     {error['max']:.6e}")
        elif set_["field"] and self.flagged < self.targets:
            lines.append("No error: no exact derivatives of these values are known, see --moments")
        if self.estimate is not None:
            lines.append(
                "Estimate      mean           rms            1 %            median         99 %"
            )
            for name, values in zip(self.components, self.estimate, strict=True):
                figures = [values[key] for key in ("mean", "rms", "p1", "p50", "p99")]
                lines.append(f"  {name:<10}" + "".join(f"{x:>14.6e} " for x in figures).rstrip())
        for i, component in enumerate(self.rows):
            rows = self.moment_statistics(i)
            lines += _moment_lines(rows, component if len(self.rows) > 1 else "")
        if self.rounding_bound is not None:
            lines.append(f"Rounding changes a figure by at most {self.rounding_bound:.3e}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.to_text()


def _moment_lines(rows: dict[str, dict[str, Any]], component: str) -> list[str]:
    """A table of moments, with their quantiles beside it where there are any."""
    if not rows:
        return []
    title = f"Discrete moments of {component}" if component else "Discrete moments"
    lines = [f"{title:<24}mean                      std    95 % of the mean"]
    for key, row in rows.items():
        low, high = row["ci95"]
        lines.append(
            f"  M({key})".ljust(14)
            + f"{row['mean']:>20.13e}  {row['std']:>15.6e}    [{low:.6e}, {high:.6e}]"
        )
    if "p1" in next(iter(rows.values())):
        lines.append("  over targets       1 %            median         99 %")
        lines += [
            f"  M({key})".ljust(14) + " ".join(f"{row[p]:>14.6e}" for p in ("p1", "p50", "p99"))
            for key, row in rows.items()
        ]
    return lines
