"""Error map: where in somebody's own particles the sums are wrong, by how much, and why.

An estimate at particle a is Σ_α (h^{|α|−k}/α!) M_α ∂^αA whatever the field A is: the moments M_α of
the particle itself, less what they should be, are the coefficients of its truncation error. They
come from one pass over the pairs for all operators, forms and corrections together.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from math import factorial, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import MOST_CONDITION, Health
from sphtrunc.arithmetic.small_systems import solve
from sphtrunc.experiment.engine import one_pass, threads, volumes
from sphtrunc.experiment.one_pass import estimates as estimated
from sphtrunc.kernels.arguments import count
from sphtrunc.kernels.factors import factor_values
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.corrections import combine
from sphtrunc.operators.moments import MultiIndex, add, label, multi_indices, unit
from sphtrunc.operators.operator import NESTED, SYMMETRIC, Operator
from sphtrunc.operators.terms import VALUE, Key
from sphtrunc.scenes.scene import Indices, every_target, sample
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.particles import Particles

SCHEMA = "sphtrunc.map/1"
DEFAULT = (
    Operator("gradient", "standard"),
    Operator("gradient", "difference"),
    Operator("gradient", "symmetric"),
    Operator("gradient", "difference", "csph"),
)
SINGULAR, ALONE, UNCERTAIN = 1, 2, 4  # bits of `flag`
TRUSTED = 0.05  # own error of a predicted error, relative to it, above which it is not trusted
_NUMBERS = 1 << 19  # sums that are held at once while corrections are solved
_WORST = 10
_MOST_SPREAD = 0.03  # of γ by disorder: more than that is boundaries
_QUANTILES = (0.5, 0.9, 0.99, 1.0)


@dataclass(frozen=True, eq=False)
class FieldErrors:
    """What a field of the particles suffers: predicted errors of one estimate, (T, C).

    error: Σ_α (h^{|α|−k}/α!) (M_α − M_α^exact) ∂^αA, in units of A/length^k, and of it `smoothing`,
        the part that the kernel has on undisturbed particles everywhere; the rest is disorder and
        boundaries
    own: how far the prediction with derivatives of one order less is from it
    scale: the root mean square of the derivative that is estimated, over the targets
    """

    error: Array
    smoothing: Array
    own: Array
    scale: float

    @property
    def trusted(self) -> Array:
        """(T,) where the two predictions are as near to each other as TRUSTED says."""
        apart = np.sqrt((self.own**2).sum(axis=1))
        return np.asarray(apart <= TRUSTED * np.sqrt((self.error**2).sum(axis=1)))


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Moments at T targets, and what follows from them.

    target: (T,) which particles; x: (T, d); h: (T,); alpha: (A, d) multi-indices
    moments: name -> (T, C, A), C components in the order of `Operator.components`, in units of h;
        exact: name -> (C, A), what they should be
    gamma: (T,) Σ_b V_b W_ab; distance: (T,) to the plane surface that such a γ means, in units
        of h, infinite inside
    condition: (T,) of the worst correction matrix; flag: (T,) 1 where a correction is singular,
        2 where there is no neighbour, 4 where the predicted error of the field is not trusted
    fields: name of the field, name of the estimate -> its errors
    """

    kernel: str
    target: Indices
    x: Array
    h: Array
    alpha: Array
    moments: Mapping[str, Array]
    exact: Mapping[str, Array]
    gamma: Array
    distance: Array
    condition: Array
    flag: Indices
    fields: Mapping[str, Mapping[str, FieldErrors]]

    @property
    def targets(self) -> int:
        """T."""
        return int(self.target.size)

    def sizes(self, name: str) -> dict[str, Array]:
        """Of one estimate, the length of the moment errors of each degree, (T,): E0 of degree 0, M1
        of degree 1, less what it should be, and so on."""
        error = self.moments[name] - self.exact[name]
        degree = self.alpha.sum(axis=1)
        return {
            f"{'E' if not n else 'M'}{n}": np.sqrt((error[:, :, degree == n] ** 2).sum(axis=(1, 2)))
            for n in range(int(degree.max()) + 1)
        }

    def arrays(self) -> dict[str, Any]:
        """The contract of `map -o FILE.npz`: x, h, particle, alpha, gamma, distance, condition,
        flag, moments_<operator>_<form>_<correction>, and error_<field>_<estimate>."""
        found: dict[str, Any] = {
            "x": self.x,
            "h": self.h,
            "particle": self.target,
            "alpha": self.alpha,
            "gamma": self.gamma,
            "distance": self.distance,
            "condition": self.condition,
            "flag": self.flag,
        }
        found |= {f"moments_{name}": values for name, values in self.moments.items()}
        for field, rows in self.fields.items():
            for name, one in rows.items():
                found[f"error_{field}_{name}"] = one.error
                found[f"smoothing_{field}_{name}"] = one.smoothing
                found[f"own_{field}_{name}"] = one.own
        return found

    def columns(self) -> dict[str, Any]:
        """One column for each number of a target: a table."""
        found: dict[str, Any] = {"particle": self.target}
        found |= {"xyz"[i]: axis for i, axis in enumerate(self.x.T)}
        found |= {"h": self.h, "gamma": self.gamma, "distance": self.distance}
        found |= {"condition": self.condition, "flag": self.flag}
        for name, values in self.moments.items():
            for c in range(values.shape[1]):
                for i, alpha in enumerate(self.alpha):
                    found[f"{name}[{c}] M({label(tuple(alpha.tolist()))})"] = values[:, c, i]
        for field, rows in self.fields.items():
            for name, one in rows.items():
                for c in range(one.error.shape[1]):
                    found[f"error of {field} {name}[{c}]"] = one.error[:, c]
        return found

    def to_pandas(self) -> Any:
        """The columns as a DataFrame."""
        import pandas as pd

        return pd.DataFrame(self.columns())

    def to_dict(self) -> dict[str, Any]:
        """Quantiles of the moment errors, the worst particles, and what dominates."""
        good = (self.flag & (SINGULAR | ALONE)) == 0
        rows = {}
        for name in self.moments:
            sizes = {degree: values[good] for degree, values in self.sizes(name).items()}
            rows[name] = {
                degree: {
                    "max" if q == 1.0 else f"p{100 * q:g}": float(np.quantile(values, q))
                    for q in _QUANTILES
                }
                for degree, values in sizes.items()
                if values.size
            }
        fields = {
            field: {
                name: {
                    "rms": float(np.sqrt((one.error[good] ** 2).mean())) if good.any() else None,
                    "smoothing_rms": float(np.sqrt((one.smoothing[good] ** 2).mean()))
                    if good.any()
                    else None,
                    "scale": one.scale,
                    "trusted": int(np.count_nonzero(one.trusted & good)),
                }
                for name, one in rows_.items()
            }
            for field, rows_ in self.fields.items()
        }
        return {
            "schema": SCHEMA,
            "sphtrunc": __version__,
            "kernel": self.kernel,
            "dim": int(self.x.shape[1]),
            "targets": self.targets,
            "flagged": int(np.count_nonzero(~good)),
            "surface": int(np.count_nonzero(np.isfinite(self.distance))),
            "moments": rows,
            "fields": fields,
            "worst": self.worst(),
            "says": self.says(),
        }

    def worst(self) -> list[dict[str, Any]]:
        """The particles whose first estimate sees most of a constant or is furthest from exact for
        a linear field, the worst first."""
        name = next(iter(self.moments))
        sizes = self.sizes(name)
        size = np.maximum(sizes["E0"], sizes.get("M1", sizes["E0"]))
        return [
            {
                "particle": int(self.target[i]),
                "x": self.x[i].tolist(),
                **{degree: float(values[i]) for degree, values in sizes.items()},
                "gamma": float(self.gamma[i]),
                "flag": int(self.flag[i]),
            }
            for i in np.argsort(-size, kind="stable")[:_WORST]
        ]

    def says(self) -> str:
        """What dominates and what to change."""
        name = next(iter(self.moments))
        sizes = self.sizes(name)
        surface = np.isfinite(self.distance)
        part = float(surface.mean())
        inside = sizes["E0"][~surface]
        at_surface = sizes["E0"][surface]
        lost = [n for n in self.moments if n != name and np.median(self.sizes(n)["M1"]) < 1e-6]
        better = f"; {lost[0].replace('_', ' ')} is exact for linear fields here" if lost else ""
        if part > 0.0 and at_surface.size and inside.size:
            ratio = float(np.median(at_surface)) / max(float(np.median(inside)), 1e-300)
            if ratio > 3.0:
                return (
                    f"boundaries dominate: at the {part:.0%} of the targets whose support is cut,"
                    f" the gradient of a constant is {ratio:.3g} times that inside{better}"
                )
        return (
            "disorder dominates: the gradient of a constant is"
            f" {float(np.median(sizes['E0'])):.2e}/h at the median particle; more neighbours or a"
            f" more regular arrangement make it smaller{better}"
        )

    def to_json(self) -> str:
        """Schema sphtrunc.map/1: the summary, not the arrays."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)

    def to_text(self) -> str:
        """The summary for a person."""
        data = self.to_dict()
        lines = [
            f"{self.targets:,} targets with {self.kernel}, {data['dim']}D; {data['flagged']:,}"
            f" flagged, {data['surface']:,} with a support that is cut (γ = ΣVW)",
            "Moment errors (lengths, in units of h)" + "median         90 %".rjust(31)
            + "99 %          max".rjust(28),
        ]  # fmt: skip
        for name, rows in data["moments"].items():
            for i, (degree, row) in enumerate(rows.items()):
                head = name.replace("_", " ") if not i else ""
                figures = "".join(f"{value:>14.4e}" for value in row.values())
                lines.append(f"  {head:<40} {degree:<4}{figures}")
        for field, rows in data["fields"].items():
            lines.append(
                f"Expected error of {field} (rms; of it smoothing; scale of the derivative)"
            )
            for name, row in rows.items():
                lines.append(
                    f"  {name.replace('_', ' '):<40}     {row['rms']:>14.4e}"
                    f"{row['smoothing_rms']:>14.4e}{row['scale']:>14.4e}"
                    f"   trusted at {row['trusted']:,}"
                )
        lines.append("Worst particles")
        for row in data["worst"]:
            where = ", ".join(f"{x:.5g}" for x in row["x"])
            lines.append(
                f"  {row['particle']:>9}  ({where})  E0 {row['E0']:.3e}  M1 {row['M1']:.3e}"
                f"  γ {row['gamma']:.4f}"
            )
        lines.append(data["says"])
        return "\n".join(lines)


def error_map(
    particles: Particles,
    kernel: Kernel | str,
    estimates: Sequence[Operator] = DEFAULT,
    *,
    degree: int = 2,
    fields: Mapping[str, object] | None = None,
    targets: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    engine: str | None = None,
) -> ErrorMap:
    """The moments of every estimate at every target of explicit particles.

    estimates: operators, forms and corrections; degree: of the moments
    fields: name -> values (n,) of which the expected error is wanted too; adds moments up to k + 2
    targets: so many, drawn at random; None for all

    Raises ValueError as `pair_sums` does, and for the nested form, whose moments need the
    neighbours' (`measure` has them).
    """
    kernel = parse_kernel(kernel)
    degree = count(degree, "degree")
    if not kernel.is_polynomial:
        raise ValueError(f"kernel: {kernel.name} has no compiled sums; expected a polynomial one")
    operators = list(dict.fromkeys(estimates))
    if not operators:
        raise ValueError("estimates: got none, expected at least one operator")
    for one in operators:
        one.require_pairs(False)
        if one.form == NESTED:
            raise ValueError("form: moments of the nested form are measured by `measure` alone")
    known = dict(fields or {})
    if known:
        degree = max(degree, max(one.derivatives for one in operators) + 2)
    if not 1 <= degree <= 8:
        raise ValueError(f"degree: got {degree}, expected 1 to 8")
    chosen = every_target(particles)
    if targets is not None and targets < chosen.size:
        if targets < 1:
            raise ValueError(f"targets: got {targets}, expected at least 1")
        chosen = np.sort(sample(particles, 0, targets, seed))
    options = {"workers": workers, "engine": engine}
    found = _moments(particles, kernel, operators, degree, chosen, options)
    gamma, condition, moments, exact, others = found
    flag = np.where(condition <= MOST_CONDITION, 0, SINGULAR).astype(np.int64)
    flag |= np.where(others > 0, 0, ALONE)
    condition = np.where(condition <= MOST_CONDITION, condition, np.inf)
    alphas = list(multi_indices(particles.dim, degree))
    errors: dict[str, dict[str, FieldErrors]] = {}
    for name, values in known.items():
        derivatives = _derivatives(particles, kernel, values, degree, options)
        errors[name] = {}
        for one in operators:
            made = _field_errors(
                one, kernel, particles.h[chosen], alphas, moments[_name(one)],
                exact[_name(one)], [d[:, chosen] for d in derivatives],
            )  # fmt: skip
            errors[name][_name(one)] = made
            flag |= np.where(made.trusted, 0, UNCERTAIN)
    return ErrorMap(
        kernel=kernel.name,
        target=chosen,
        x=particles.x[:, chosen].T,
        h=particles.h[chosen],
        alpha=np.array(alphas),
        moments=moments,
        exact=exact,
        gamma=gamma,
        distance=surface_distance(kernel, particles.dim, gamma),
        condition=condition,
        flag=flag,
        fields=errors,
    )


def _name(operator: Operator) -> str:
    return f"{operator.name}_{operator.form}_{operator.correction}"


def _moments(
    scene: Particles,
    kernel: Kernel,
    operators: Sequence[Operator],
    degree: int,
    chosen: Indices,
    options: Mapping[str, Any],
) -> tuple[Array, Array, dict[str, Array], dict[str, Array], Indices]:
    """γ, condition, moments and what they should be of every operator, and neighbours, from one
    pass over the pairs."""
    dim = scene.dim
    zero = unit(dim, 0, 0)
    alphas = list(multi_indices(dim, degree))
    keys: dict[Key, None] = {(zero, zero): None}
    weighted: dict[Key, None] = {}
    for one in operators:
        shape = _structure(one, dim)
        needed = {
            (delta, add(alpha, gamma)): None
            for part in shape
            for delta, gamma in part
            for alpha in alphas
        }
        if one.form == SYMMETRIC:
            weighted |= needed
        else:
            keys |= needed
        if not one.uncorrected:
            keys |= dict.fromkeys(one.needed(dim, 0))
    fields: Any = ()
    density = np.ones(scene.population)
    if weighted:
        density = scene.mass / volumes(scene, kernel)
        fields = np.stack([1.0 / density, density])
    everyone = chosen.size == scene.population
    summed = one_pass(
        scene, kernel, keys, fields=fields, field_keys=weighted,
        targets=None if everyone else chosen, **options,
    )  # fmt: skip
    gamma, condition = np.empty(chosen.size), np.zeros(chosen.size)
    others = np.empty(chosen.size, dtype=np.int64)
    moments: dict[str, Array] = {
        _name(one): np.empty((chosen.size, len(one.components(dim)), len(alphas)))
        for one in operators
    }

    def finish(first: int) -> None:
        part = slice(first, first + block)
        sums = summed.sums(part)
        gamma[part], others[part] = sums.base[zero, zero], sums.others
        own = density[chosen[part]]
        for one in operators:
            health = Health()
            rows = one.coefficients(sums.base, dim, partial(solve, health=health))
            condition[part] = np.maximum(condition[part], health.condition)
            into = moments[_name(one)]
            for c, row in enumerate(rows):
                for i, alpha in enumerate(alphas):
                    if one.form == SYMMETRIC:
                        seen = {key: values[0] for key, values in sums.fields.items()}
                        into[part, c, i] = own * combine(row, seen, alpha)
                    else:
                        into[part, c, i] = combine(row, sums.base, alpha)
                if one.form == SYMMETRIC:
                    back = {key: values[1] for key, values in sums.fields.items()}
                    into[part, c, 0] += combine(row, back, zero) / own
                elif one.uses_difference:
                    into[part, c, 0] = float(one.adds_own)

    block = max(1, min(1 << 15, _NUMBERS // summed.rows.shape[1]))
    with ThreadPoolExecutor(threads(options.get("workers"))) as pool:
        list(pool.map(finish, range(0, chosen.size, block)))
    exact: dict[str, Array] = {}
    for one in operators:
        should = [one.target(dim, c) for c in range(len(one.components(dim)))]
        exact[_name(one)] = np.array([[float(t.get(a, 0)) for a in alphas] for t in should])
    return gamma, condition, moments, exact, others


def _structure(operator: Operator, dim: int) -> list[dict[Key, Any]]:
    """Which (δ, γ) the components are made of: the coefficients, of whatever value."""
    ones = dict.fromkeys(operator.needed(dim, 0), 1.0)
    return operator.coefficients(
        ones, dim, lambda matrix, columns: [[1.0] * len(columns[0]) for _ in matrix]
    )


# ------------------------------------------------------------------------------ errors of a field


def _derivatives(
    scene: Particles, kernel: Kernel, values: object, degree: int, options: Mapping[str, Any]
) -> list[Array]:
    """∂^αA of every α up to the degree at all particles, (A, n), from gradients of gradients with
    RKPM of degree 3, and the same of degree 2."""
    dim = scene.dim
    alphas = list(multi_indices(dim, degree))
    found = []
    for order in ("rkpm-3", "rkpm-2"):
        gradient = Operator("gradient", "difference", order)
        known: dict[MultiIndex, Array] = {alphas[0]: np.asarray(values, dtype=np.float64)}
        for n in range(degree):
            lower = [alpha for alpha in alphas if sum(alpha) == n]
            made = estimated(
                scene, kernel, gradient, np.stack([known[alpha] for alpha in lower]), **options
            )
            slopes = np.where(np.isfinite(made.values), made.values, 0.0) / scene.h
            parts: dict[MultiIndex, list[Array]] = {}
            for row, alpha in zip(slopes, lower, strict=True):
                for axis in range(dim):
                    parts.setdefault(add(alpha, unit(dim, axis)), []).append(row[axis])
            known |= {alpha: np.mean(rows, axis=0) for alpha, rows in parts.items()}
        found.append(np.stack([known[alpha] for alpha in alphas]))
    return found


def _field_errors(
    operator: Operator,
    kernel: Kernel,
    h: Array,
    alphas: Sequence[MultiIndex],
    moments: Array,
    exact: Array,
    derivatives: Sequence[Array],
) -> FieldErrors:
    k, dim = operator.derivatives, len(alphas[0])
    degree = max(map(sum, alphas))
    powers = np.stack([h ** (sum(a) - k) / prod(map(factorial, a)) for a in alphas])
    predicted = [np.einsum("tca,at->tc", moments - exact, powers * d) for d in derivatives]
    sums = {key: continuous_sum(kernel, key) for key in operator.needed(dim, degree)}
    limit = [operator.correct(sums, dim, degree, c) for c in range(exact.shape[0])]
    smooth = np.array([[float(row[a]) for a in alphas] for row in limit]) - exact
    smoothing = np.einsum("ca,at->tc", smooth, powers * derivatives[0])
    true = np.einsum("ca,at->tc", exact, powers * derivatives[0])
    return FieldErrors(
        error=predicted[0],
        smoothing=smoothing,
        own=predicted[1] - predicted[0],
        scale=float(np.sqrt((true**2).sum(axis=1).mean())),
    )


# --------------------------------------------------------------------------------------- surfaces


def surface_distance(kernel: Kernel, dim: int, gamma: Array) -> Array:
    """How far away the plane surface is that leaves γ of the kernel on this side, in units of h:
    ∫_{t <= z} w₁(t) dt = γ, w₁ the kernel integrated over the plane; negative beyond the surface,
    infinite inside, where γ is within five times its own spread (the median distance of γ from its
    median, at most 0.03) of 1."""
    support = float(kernel.support)
    t = np.linspace(0.0, support, 513)
    fine = np.linspace(0.0, support, 4097)
    if dim == 1:
        projected = factor_values(kernel, VALUE, fine, dim)
    else:
        # ∫ w(√(t² + y²)) dy in 2D, 2π ∫_t^κ w r dr in 3D
        y = fine if dim == 2 else None
        projected = np.empty_like(fine)
        for i, at in enumerate(fine):
            if y is not None:
                inside = factor_values(kernel, VALUE, np.hypot(at, t), dim)
                projected[i] = 2.0 * np.trapezoid(inside, t)
            else:
                r = np.linspace(at, support, 257)
                inside = factor_values(kernel, VALUE, r, dim)
                projected[i] = 2.0 * np.pi * np.trapezoid(inside * r, r)
    half = np.concatenate([[0.0], np.cumsum(0.5 * (projected[1:] + projected[:-1]) * fine[1])])
    z = np.concatenate([-fine[:0:-1], fine])
    share = np.concatenate([0.5 - half[:0:-1], 0.5 + half])
    found = np.interp(gamma, share, z)
    spread = min(1.4826 * float(np.median(np.abs(gamma - np.median(gamma)))), _MOST_SPREAD)
    return np.where(gamma > 1.0 - max(0.02, 5.0 * spread), np.inf, found)
