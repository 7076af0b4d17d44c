"""Error map: where in somebody's own particles the sums are wrong, by how much, and why.

An estimate at particle a is Σ_α (h^{|α|−k}/α!) M_α ∂^αA whatever the field A is: the moments M_α of
the particle itself, less what they should be, are the coefficients of its truncation error. They
come from one pass over the pairs for all operators, forms and corrections together.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.linear_systems import MOST_CONDITION
from sphtrunc.kernels.arguments import count
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.moments import label, multi_indices
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.scene import Indices, every_target, sample
from sphtrunc.study.snapshots.surfaces import surface_distance
from sphtrunc.study.snapshots.target_sums import (
    Surface,
    asked,
    at_targets,
    derivatives_of,
    errors_of_field,
    exact_moments,
    name_of,
)
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.particles import Particles
    from sphtrunc.study.snapshots.target_sums import Asked

SCHEMA = "sphtrunc.map/1"
DEFAULT = (
    Operator("gradient", "standard"),
    Operator("gradient", "difference"),
    Operator("gradient", "symmetric"),
    Operator("gradient", "difference", "csph"),
)
SINGULAR, ALONE, UNCERTAIN = 1, 2, 4  # bits of `flag`
TRUSTED = 0.05  # own error of a predicted error, relative to it, above which it is not trusted
_WORST = 10
_BLOCK = 1 << 18  # targets whose lengths are taken at a time
_QUANTILES = (0.5, 0.9, 0.99, 1.0)


@dataclass(frozen=True, eq=False)
class FieldErrors:
    """What a field of the particles suffers: predicted errors of one estimate, (T, C).

    error: Σ_α (h^{|α|−k}/α!) (M_α − M_α^exact) ∂^αA, in units of A/length^k, and of it `smoothing`,
        the part that the kernel has on undisturbed particles everywhere, and `boundary`, what a
        plane surface at the distance that γ tells adds to that; the rest is `disorder`
    own: how far the prediction with derivatives of one order less is from it
    scale: the root mean square of the derivative that is estimated, over the targets
    """

    error: Array
    smoothing: Array
    boundary: Array
    own: Array
    scale: float

    @property
    def disorder(self) -> Array:
        """(T, C): what neither the kernel nor a surface explains: disorder and discretisation."""
        return np.asarray(self.error - self.smoothing - self.boundary)

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
        degree = self.alpha.sum(axis=1)
        found = {
            f"{'E' if not n else 'M'}{n}": np.empty(self.targets)
            for n in range(int(degree.max()) + 1)
        }
        for first in range(0, self.targets, _BLOCK):
            part = slice(first, first + _BLOCK)
            square = (self.moments[name][part] - self.exact[name]) ** 2
            for n, lengths in enumerate(found.values()):
                lengths[part] = np.sqrt(square[:, :, degree == n].sum(axis=(1, 2)))
        return found

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
                found[f"boundary_{field}_{name}"] = one.boundary
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
                    **{
                        f"{part}rms": float(np.sqrt((values[good] ** 2).mean()))
                        if good.any()
                        else None
                        for part, values in (
                            ("", one.error),
                            ("smoothing_", one.smoothing),
                            ("boundary_", one.boundary),
                            ("disorder_", one.disorder),
                        )
                    },
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
                f"Expected error of {field}: rms, and of it by smoothing, boundaries, disorder; rms"
                " of the derivative"
            )
            for name, row in rows.items():
                parts = ("rms", "smoothing_rms", "boundary_rms", "disorder_rms", "scale")
                figures = "".join(f"{row[part]:>13.4e}" for part in parts if row[part] is not None)
                lines.append(
                    f"  {name.replace('_', ' '):<36}{figures}   trusted at {row['trusted']:,}"
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
    found = Question.of(particles, kernel, estimates, degree, fields, targets, seed)
    options: dict[str, Any] = {"workers": workers, "engine": engine}
    return found.answered(at_targets(found.asked(**options)), options)


@dataclass(frozen=True, eq=False)
class Question:
    """What a map is made of, checked: `asked` is the work, `answered` what follows from it."""

    particles: Particles
    kernel: Kernel
    operators: tuple[Operator, ...]
    degree: int
    fields: Mapping[str, object]
    targets: Indices

    @classmethod
    def of(
        cls,
        particles: Particles,
        kernel: Kernel | str,
        estimates: Sequence[Operator],
        degree: int,
        fields: Mapping[str, object] | None,
        targets: int | None,
        seed: int,
    ) -> Question:
        """Arguments as for `error_map`, which raises what this does."""
        shape = parse_kernel(kernel)
        degree = count(degree, "degree")
        if not shape.is_polynomial:
            raise ValueError(
                f"kernel: {shape.name} has no compiled sums; expected a polynomial one"
            )
        operators = tuple(dict.fromkeys(estimates))
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
        return cls(particles, shape, operators, degree, known, chosen)

    def asked(self, **options: Any) -> Asked:
        """The work."""
        return asked(
            self.particles, self.kernel, self.operators, self.degree, self.targets,
            normals=bool(self.fields), **options,
        )  # fmt: skip

    def answered(self, found: Mapping[str, Any], options: Mapping[str, Any]) -> ErrorMap:
        """The map, from what `at_targets` says of all targets."""
        scene, chosen = self.particles, self.targets
        condition = np.asarray(found["condition"])
        gamma = np.asarray(found["gamma"])
        flag = np.where(condition <= MOST_CONDITION, 0, SINGULAR).astype(np.int64)
        flag |= np.where(found["others"] > 0, 0, ALONE)
        condition = np.where(condition <= MOST_CONDITION, condition, np.inf)
        distance = surface_distance(self.kernel, scene.dim, gamma)
        moments = {name_of(one): found[f"moments_{name_of(one)}"] for one in self.operators}
        errors: dict[str, dict[str, FieldErrors]] = {}
        if self.fields:
            surface = _surface(found["normal"], distance)
        for name, values in self.fields.items():
            known = derivatives_of(scene, self.kernel, values, self.degree, options)
            errors[name] = {}
            for one in self.operators:
                made = errors_of_field(
                    one, self.kernel, scene.h[chosen], moments[name_of(one)],
                    [d[:, chosen] for d in known], surface,
                )  # fmt: skip
                errors[name][name_of(one)] = FieldErrors(**made)
                flag |= np.where(errors[name][name_of(one)].trusted, 0, UNCERTAIN)
        return ErrorMap(
            kernel=self.kernel.name,
            target=chosen,
            x=scene.x[:, chosen].T,
            h=scene.h[chosen],
            alpha=np.array(list(multi_indices(scene.dim, self.degree))),
            moments=moments,
            exact={name_of(o): exact_moments(o, scene.dim, self.degree) for o in self.operators},
            gamma=gamma,
            distance=distance,
            condition=condition,
            flag=flag,
            fields=errors,
        )


def _surface(slope: Array, distance: Array) -> Surface:
    """Where there is a surface and its direction is known: n along h∇γ, which points inside."""
    length = np.sqrt((slope**2).sum(axis=1))
    which = np.flatnonzero(np.isfinite(distance) & (length > 0.0))
    return Surface(which, slope[which] / length[which, None], distance[which])
