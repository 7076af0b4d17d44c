"""Comparison: what theory predicts for a scene, beside what is measured there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import factorial, prod, sqrt
from textwrap import wrap
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.experiment.fields import Polynomial, Sinusoid, polynomial
from sphtrunc.experiment.measurement import Measurement
from sphtrunc.experiment.measuring import measure
from sphtrunc.kernels.gaussian import Gaussian
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.moments import MultiIndex, label
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.graded import Graded
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.scene import Scene
from sphtrunc.scenes.smoothing_lengths import Sloped
from sphtrunc.study.structure import (
    by_structure,
    errors_by_structure,
    predict_by_structure,
    require_theory,
)
from sphtrunc.theory.disorder.prediction import Prediction, percent, predict
from sphtrunc.theory.field_error import Split, predict_fields
from sphtrunc.theory.fields import Signals, Taylor, Waves
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.theory.variable_h.graded_spacing import graded_moments
from sphtrunc.theory.variable_h.scenes import Slope, predict_varying


def of_lattice(scene: Scene) -> Arrangement:
    """The scene, which is a lattice, displaced or not.

    Raises ValueError, saying so, where there is no theory.
    """
    if isinstance(scene, Arrangement):
        return scene
    raise ValueError(
        "scene: there is no such theory for graded particles; expected a lattice, with or without"
        " jitter, or explicit particles in a periodic box"
    )


def predict_moments(
    scene: Scene, kernel: Kernel | str, operator: Operator, degree: int = 3
) -> Prediction:
    """Predicted mean and standard deviation of the moments of the first component.

    From the structure factor for explicit particles, and for targets that are not particles.

    Raises ValueError where there is no theory: see `of_lattice` and `structure`.
    """
    if by_structure(scene):
        return predict_by_structure(scene, kernel, operator, degree)
    if isinstance(scene, Sloped) and not isinstance(scene.base, Graded):
        return _predict_sloped(scene, parse_kernel(kernel), operator, degree)
    if _is_graded(scene):
        rows = _graded(scene, parse_kernel(kernel), operator, degree)
        mean = {a: float(np.mean([row[a] for row in rows])) for a in rows[0]}
        exact = operator.consistency  # up to this degree every row is the same but for rounding
        std = {a: float(np.std([row[a] for row in rows])) * (a[0] > exact) for a in rows[0]}
        return Prediction(0.0, "gaussian", mean, std, "local spacing, to first order in its slope")
    return predict(parse_kernel(kernel), operator, of_lattice(scene), degree=degree)


def _is_graded(scene: Scene) -> bool:
    return isinstance(getattr(scene, "base", scene), Graded)


def _slope(scene: Scene) -> Slope | None:
    return Slope(scene.gradient, scene.rule) if isinstance(scene, Sloped) else None


def _graded(
    scene: Scene, kernel: Kernel | Gaussian, operator: Operator, degree: int
) -> list[dict[MultiIndex, float]]:
    """The predicted moments at every target of a graded scene, h with a gradient or without."""
    if not isinstance(kernel, Kernel):
        raise ValueError(
            f"scene: for graded particles there is theory for polynomials, {kernel.name} is none"
        )
    base: Any = getattr(scene, "base", scene)
    return [
        graded_moments(kernel, operator, base.spacing, at, base.offset, degree, _slope(scene))
        for at in base.positions
    ]


_WAVE = 12  # moments that a wave is expanded in


def _graded_error(
    scene: Scene, kernel: Kernel | Gaussian, operator: Operator, field: Sinusoid | Polynomial
) -> Split:
    """The rms error over targets, and over the phase of a sinusoid, from the moments."""
    wave = isinstance(field, Sinusoid)
    k = operator.derivatives
    if isinstance(field, Sinusoid):
        kappa = complex(0.0, float(field.wave()[0]))
        taylor: dict[MultiIndex, complex] = {
            (n,): kappa**n / factorial(n) for n in range(_WAVE + 1)
        }
        largest = abs(kappa) ** k
    else:
        taylor = {alpha: complex(c) for alpha, c in field.coefficients.items()}
        largest = field.amplitude(k)
    degree = max(max(alpha) for alpha in taylor)
    rows = _graded(scene, kernel, operator, degree)
    target = operator.target(1)
    shape, slope = parse_kernel(kernel), _slope(scene)
    moment = continuous_sum if slope is None else slope.moment
    sums = {key: moment(shape, key) for key in operator.needed(1, degree)}
    limit = operator.correct(sums, 1, degree)

    def error(moments: Mapping[MultiIndex, Any]) -> complex:
        terms = (c * (float(moments[a]) - target.get(a, 0)) for a, c in taylor.items())
        return sum(terms, 0j) / (largest or 1.0)

    smooth = error(limit)
    found = np.array([error(row) for row in rows])
    share = sqrt(0.5) if wave else 1.0

    def rms(values: Any) -> float:
        return share * float(np.sqrt(np.mean(np.abs(values) ** 2)))

    return Split(rms(found), rms(smooth), rms(found - smooth), 0.0, 0.0)


def _predict_sloped(
    scene: Sloped, kernel: Kernel | Gaussian, operator: Operator, degree: int
) -> Prediction:
    if not isinstance(kernel, Kernel):
        raise ValueError(
            f"scene: with a gradient of h there is theory for polynomials, {kernel.name} is none"
        )
    base = of_lattice(scene.base)
    return predict_varying(kernel, operator, base, scene.gradient, scene.rule, degree=degree)


@dataclass(frozen=True)
class Comparison:
    """Measured less predicted moments, and how large the differences may be.

    difference: multi-index -> mean measured − mean predicted
    expected: its size: the rounding bound on a lattice, one standard error on disordered particles
    ratio: multi-index -> measured over predicted standard deviation; empty on a lattice
    """

    measured: Measurement
    predicted: Prediction
    difference: Mapping[MultiIndex, float]
    expected: Mapping[MultiIndex, float]
    ratio: Mapping[MultiIndex, float]

    def __str__(self) -> str:
        lines = [f"measured - derived ({self.predicted.how})"]
        for alpha, value in self.difference.items():
            text = f"  M({label(alpha)}): {value: .3e}, expected {self.expected[alpha]:.1e}"
            if alpha in self.ratio:
                text += f", spread measured/derived {self.ratio[alpha]:.3f}"
            lines.append(text)
        return "\n".join(lines)


def compare(
    scene: Scene,
    kernel: Kernel | str,
    operator: Operator | str = "gradient",
    *,
    form: str | None = None,
    correction: str = "none",
    degree: int = 3,
    targets: object = None,
    seed: int = 0,
) -> Comparison:
    """Measure the moments of an operator on a scene, derive them, and subtract.

    Raises ValueError where there is no theory (see `predict_moments`), and for bad arguments.
    """
    kernel = parse_kernel(kernel)
    if isinstance(operator, str):
        operator = Operator(operator, form, correction)
    predicted = predict_moments(scene, kernel, operator, degree)
    still = isinstance(getattr(scene, "base", scene), Lattice)
    measured = measure(
        scene, kernel, operator, moments=degree, targets=targets, seed=seed, bound=still
    )
    difference, expected, ratio = {}, {}, {}
    for alpha, values in measured.moments.values.items():
        difference[alpha] = float(values.mean()) - predicted.mean[alpha]
        if still and measured.moment_bound is not None:
            bound = float(measured.moment_bound[alpha].max())
            expected[alpha] = bound + UNIT * abs(predicted.mean[alpha])
        else:
            expected[alpha] = predicted.std[alpha] / sqrt(values.size)
            if predicted.std[alpha]:
                ratio[alpha] = float(values.std()) / predicted.std[alpha]
    return Comparison(measured, predicted, difference, expected, ratio)


def predict_error(
    kernel: Kernel | str,
    operator: Operator,
    scene: Scene,
    field: Sinusoid | Polynomial | Mapping[MultiIndex, float],
    precision: str = "plain",
) -> Split:
    """The predicted rms error of an estimate, all its components together, split into its parts.

    field: a sinusoid in any direction: rms over phases and displacements; or any field by its
        derivatives at the target, α -> h^{|α|} A^{(α)}, in units of h: a derivative taken in other
        units of length is to be multiplied by h^{|α|} in these. Those not named are zero. A
        polynomial is the same, with c_α = h^{|α|} A^{(α)}/α!.
    precision: in which the sums are evaluated, as for `measure`

    The error is relative to the largest exact derivative of the order of the operator, as `measure`
    has it: of a sinusoid over all phases, of other fields at the target (or to 1 if all are zero).

    Raises ValueError where there is no theory for the scene, and for fields of another kind.
    """
    kernel = parse_kernel(kernel)
    require_theory(scene)
    signals: Signals
    if isinstance(field, Sinusoid):
        wave = field.wave()
        kappa = np.linalg.norm(wave)
        signals = Waves(np.array([kappa]), wave / kappa)
    else:
        if isinstance(field, Mapping):
            field = polynomial(
                {a: v / prod(factorial(n) for n in a) for a, v in field.items()}, scene.dim
            )
        if not isinstance(field, Polynomial) or not field.coefficients:
            raise ValueError(
                f"field: no prediction for {type(field).__name__.lower()}, expected a sinusoid, a"
                " polynomial or a mapping from multi-indices to derivatives"
            )
        signals = Taylor([field.coefficients], field.amplitude(operator.derivatives))
    if _is_graded(scene):
        return _graded_error(scene, kernel, operator, field)
    if by_structure(scene):
        return errors_by_structure(scene, kernel, operator, signals, precision)[0]
    home = of_lattice(getattr(scene, "base", scene))
    return predict_fields(
        kernel, operator, home, signals, precision=precision, slope=_slope(scene)
    )[0]


def beside(
    measured: Measurement, scene: Scene, kernel: Kernel | str, operator: Operator, field: Any = None
) -> dict[str, Any]:
    """The prediction of every figure of a measurement, and their ratios, ready for JSON.

    "by": "structure factor" or "lattice", whichever it rests on;
    "moments": label -> mean, std and std_ratio (measured over predicted; None without a spread),
    and uncertainty, what the std is good to, where displacements were sampled; "error": the parts
    of the rms error, what it is good to, and its ratio, for a sinusoid or a polynomial; "how";
    "none": why there is no theory for the scene, or for the field.
    """
    try:
        degree = max((sum(a) for a in measured.moments.values), default=0)
        result: dict[str, Any] = {}
        source = "structure factor" if by_structure(scene) else "lattice"
        if measured.moments.values:
            found = predict_moments(scene, kernel, operator, degree)
            result = {"how": found.how, "moments": {}, "by": source}
            for alpha, values in measured.moments.values.items():
                std = found.std[alpha]
                ratio = float(values.std()) / std if std and values.size > 1 else None
                row = {"mean": found.mean[alpha], "std": std, "std_ratio": ratio}
                if found.uncertainty:
                    row["uncertainty"] = found.uncertainty.get(alpha, 0.0)
                result["moments"][label(alpha)] = row
        if field is not None:
            precision = measured.settings["precision"]
            split = predict_error(kernel, operator, scene, field, precision)
            error = measured.error
            ratio = error["rms"] / split.total if error and split.total else None
            result["error"] = {**asdict(split), "ratio": ratio}
    except ValueError as reason:
        return {"none": str(reason)}
    return result


def beside_text(prediction: Mapping[str, Any]) -> str:
    """The same for reading, at most 100 columns."""
    if "none" in prediction:
        return f"No prediction: {prediction['none']}"
    lines = []
    error = prediction.get("error")
    if error is not None:
        ratio = "" if error["ratio"] is None else f"; measured/predicted {error['ratio']:.4f}"
        known = f", good to {percent(error['uncertainty'])}" if error["uncertainty"] else ""
        lines.append(f"Predicted rms error {error['total']:.6e}{known}{ratio}")
        parts = ("smoothing", "discretisation", "disorder", "rounding")
        lines.append("  " + "   ".join(f"{name} {error[name]:.3e}" for name in parts))
    rows = prediction.get("moments")
    if rows:
        lines += wrap(f"Predicted moments ({prediction['how']})", 100, subsequent_indent="  ")
        lines.append("                        mean               std    measured/predicted std")
        for name, row in rows.items():
            ratio = "" if row["std_ratio"] is None else f"{row['std_ratio']:>22.4f}"
            lines.append(
                f"  M({name})".ljust(14) + f"{row['mean']:>20.13e}  {row['std']:>12.6e}{ratio}"
            )
    return "\n".join(lines)
