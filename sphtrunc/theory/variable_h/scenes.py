"""Predicted moments of lattices whose smoothing length has a gradient, displaced or not.

With h carried along, h_b = h_a (1 + g·s_b) wherever particle b was displaced to, a base sum is
Σ_b V g(s_b − s_a) as with one h, with another g. So to second order in the displacements its mean
is Σ V (g + σ²∇²g), and to first order its derivatives with respect to the particles are V∇g, and
−V Σ∇g for the target; what a correction makes of the sums has these times its own derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import sqrt
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.factors import factor_values
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.h_rules import require_rule, require_support, slope_share
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import Key, monomial, parts
from sphtrunc.theory.disorder.prediction import Prediction
from sphtrunc.theory.variable_h.moments import derivatives_of, lattice_sums_of, summed

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.scenes.arrangement import Arrangement

_NEAR, _FAR = 1e-5, 1e-3  # steps of first and second differences


def predict_varying(
    kernel: Kernel,
    operator: Operator,
    scene: Arrangement,
    gradient: Sequence[Fraction],
    rule: str,
    *,
    degree: int = 3,
) -> Prediction:
    """Mean and standard deviation of the moments of the first component, seen from a particle.

    Raises ValueError for blue displacements, which are not independent, nested forms, |g|κ >= 1,
    targets that are no particles and volumes that are not constant.
    """
    require_rule(rule)
    require_support(fraction(kernel.support), gradient, rule)
    Slope(tuple(gradient), rule).require(kernel, operator, scene)
    dim, distribution = scene.dim, scene.distribution
    if not scene.sigma:
        sums = lattice_sums_of(kernel, operator.needed(dim, degree), scene, gradient, rule)
        found = operator.correct(sums, dim, degree)
        mean = {alpha: float(m) for alpha, m in found.items()}
        return Prediction(0.0, distribution, mean, dict.fromkeys(mean, 0.0), "lattice sum")
    return _displaced(kernel, operator, scene, gradient, rule, degree)


def _displaced(
    kernel: Kernel,
    operator: Operator,
    scene: Arrangement,
    gradient: Sequence[Fraction],
    rule: str,
    degree: int,
) -> Prediction:
    import numpy as np

    dim, dx, sigma = scene.dim, float(scene.dx_over_h), scene.sigma
    slopes = np.array([float(slope_share(rule) * g) for g in gradient])
    steep = float(np.sqrt(slopes @ slopes)) * float(kernel.support)
    radius = float(kernel.support) / (1.0 - steep) / dx + 6.0 * sigma + 1.0
    points = scene.sites(radius)
    s = scene.positions(points)[np.any(points != 0, axis=0)]
    step, volume = sigma * dx, dx**dim
    keys = operator.needed(dim, degree)
    base: dict[Key, float] = {}
    moved: dict[Key, Array] = {}
    for key in keys:

        def g(at: Array, key: Key = key) -> Array:
            plain = term_values(kernel, key, at, slopes)
            if rule != "mean-kernel":
                return plain
            return np.asarray(0.5 * (plain + term_values(kernel, key, at, 0.0 * slopes)))

        here, slope, curved = g(s), np.empty_like(s), np.zeros(len(s))
        for axis in range(dim):
            e = np.eye(dim)[axis]
            slope[:, axis] = (g(s + _NEAR * e) - g(s - _NEAR * e)) / (2.0 * _NEAR)
            curved += (g(s + _FAR * e) - 2.0 * here + g(s - _FAR * e)) / _FAR**2
        own = float(g(np.zeros((1, dim)))[0])
        base[key] = volume * (own + float(np.sum(here + step**2 * curved)))
        moved[key] = volume * np.concatenate([slope, -slope.sum(axis=0)[None]])
    mean = operator.correct(base, dim, degree)
    sensitivity = _derivatives(lambda sums: operator.correct(sums, dim, degree), base)
    std = {}
    for alpha in mean:
        total: Any = sum(rows[alpha] * moved[key] for key, rows in sensitivity.items())
        std[alpha] = float(step * np.sqrt(np.sum(np.square(total))))
    for alpha in std:  # what the operator is made to be exact for, on any arrangement
        if sum(alpha) <= operator.consistency:
            std[alpha] = 0.0
    return Prediction(
        sigma,
        scene.distribution,
        {alpha: float(m) for alpha, m in mean.items()},
        std,
        "expansion in the displacements, h carried along",
    )


@dataclass(frozen=True)
class Slope:
    """h = h_a (1 + g·s) and a rule for whose h a pair takes."""

    gradient: tuple[Fraction, ...]
    rule: str

    def require(self, kernel: Kernel | Gaussian, operator: Operator, scene: Arrangement) -> None:
        """Raises ValueError for what has no theory: see `predict_varying`."""
        if not isinstance(kernel, Kernel):
            raise ValueError(
                "scene: with a gradient of h there is theory for polynomials,"
                f" {kernel.name} is none"
            )
        if operator.form == NESTED:
            raise ValueError("form: nested sums see every particle's own h; expected another form")
        if scene.volume != "constant" or not scene.at_particle or scene.wall is not None:
            raise ValueError(
                "scene: with a gradient of h there is theory for constant volumes, targets that are"
                " particles, and no wall"
            )
        if scene.sigma and scene.distribution == "blue":
            raise ValueError(
                "distribution: blue displacements depend on one another; expected gaussian"
            )

    def wider(self, kernel: Kernel | Gaussian) -> float:
        """How many supports of the target hold every particle that it sees.

        Raises ValueError where there is no end to it: |g|κ >= 1.
        """
        require_support(fraction(kernel.support), self.gradient, self.rule)
        steep = sqrt(sum(float(g) ** 2 for g in self.slopes))
        return 1.0 / (1.0 - steep * float(kernel.support))

    @property
    def slopes(self) -> tuple[Fraction, ...]:
        """The gradient of the h of a pair."""
        return tuple(slope_share(self.rule) * g for g in self.gradient)

    def term(self, kernel: Kernel | Gaussian, key: Key, s: Array) -> Array:
        """The term of a base sum at offsets s, (…, d)."""
        import numpy as np

        flat, none = s.reshape(-1, s.shape[-1]), np.zeros(s.shape[-1])
        values = term_values(kernel, key, flat, np.array([float(g) for g in self.slopes]))
        if self.rule == "mean-kernel":
            values = 0.5 * (values + term_values(kernel, key, flat, none))
        return np.asarray(values.reshape(s.shape[:-1]))

    def moment(self, kernel: Kernel, key: Key) -> Any:
        """The base sum for Δx/h → 0."""
        return summed(kernel, key, self.gradient, self.rule)


def term_values(kernel: Kernel | Gaussian, key: Key, s: Array, slopes: Array) -> Array:
    """H^{−d−k} s^α (−1)^k ∂^δŴ(s/H), (N,), 0 where H <= 0."""
    import numpy as np

    term, alpha = key
    dim = s.shape[1]
    stretch = 1.0 + s @ slopes
    inside = stretch > 0.0
    stretch = np.where(inside, stretch, 1.0)
    t = s / stretch[:, None]
    q = np.sqrt((t * t).sum(axis=1))
    total: Array = np.zeros(len(s))
    for c, beta, k in parts((term, unit(dim, 0, 0))):
        total += c * monomial(t, beta) * factor_values(kernel, k, q, dim)
    scaled = total * monomial(s, alpha) * stretch ** -float(dim + derivatives_of(term))
    return np.where(inside, scaled, 0.0)


def _derivatives(
    correct: Callable[[dict[Key, float]], dict[Any, Any]], base: dict[Key, float]
) -> dict[Key, dict[Any, float]]:
    """∂M_α/∂m[key] by central differences of the algebra of the correction."""
    found = {}
    for key, value in base.items():
        step = 1e-6 * max(1.0, abs(value))
        ahead, back = (correct({**base, key: value + sign * step}) for sign in (1.0, -1.0))
        found[key] = {alpha: float(ahead[alpha] - back[alpha]) / (2.0 * step) for alpha in ahead}
    return found
