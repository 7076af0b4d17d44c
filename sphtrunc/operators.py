"""Operators: what an SPH sum stands for, as algebra on discrete sums of the kernel.

Everything is built from the base sums of an uncorrected kernel,

    m[δ, α] = (−1)^{|δ|} Σ_b V_b s_b^α ∂^δ Ŵ(s_b),        s = (x_b − x_a)/h,

which are exact numbers in the theory and arrays over targets in an experiment. A corrected weight
is a combination of the same kernel terms, w_b = Σ c[δ, γ] s_b^γ (−1)^{|δ|} ∂^δ Ŵ(s_b) V_b, so its
moments are M_α = Σ c[δ, γ] m[δ, α + γ]: the coefficients c are found once, from the sums, and serve
moments and fields, numbers and arrays alike.

Corrections: Shepard (1968) doi:10.1145/800186.810616; CSPH: Randles & Libersky (1996)
doi:10.1016/S0045-7825(96)01090-0, Bonet & Lok (1999) doi:10.1016/S0045-7825(99)00051-1; RKPM: Liu,
Jun & Zhang (1995) doi:10.1002/fld.1650200824.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sphtrunc.moments import MultiIndex, add, multi_indices, unit

Key = tuple[MultiIndex, MultiIndex]  # (δ, α)
Sums = Mapping[Key, Any]
Solver = Callable[[Sequence[Sequence[Any]], Sequence[Sequence[Any]]], list[list[Any]]]

#: operator: number of derivatives
DERIVATIVES = {"value": 0, "gradient": 1}
FORMS = ("standard", "difference")
CORRECTIONS = ("none", "shepard", "csph", "csph-shepard", "rkpm-1", "rkpm-2", "rkpm-3")


@dataclass(frozen=True)
class Operator:
    """An SPH estimate of A or of its gradient.

    name: "value" Σ A_b W V, or "gradient" −Σ A_b ∇W(x_b − x_a) V
    form: "standard", or "difference" with A_b − A_a in place of A_b (and A_a added to a value)
    correction: "none"; "shepard" divides the kernel by Σ W V; "csph" multiplies the gradient by the
        inverse of Σ_b ∇W (x_b − x_a) V ("csph-shepard": of the kernel that Shepard's has divided);
        "rkpm-m" multiplies the kernel by the polynomial of degree m that makes the estimate exact
        for polynomials of degree m. Gradients of corrected kernels are exact derivatives with
        respect to the point of evaluation; Shepard's is RKPM of degree 0.

    Raises ValueError for an unknown name, or a correction that does not apply.
    """

    name: str = "gradient"
    form: str = "standard"
    correction: str = "none"

    def __post_init__(self) -> None:
        _choice("operator", self.name, DERIVATIVES)
        _choice("form", self.form, FORMS)
        _choice("correction", self.correction, CORRECTIONS)
        if self.name == "value" and self.correction.startswith("csph"):
            raise ValueError(
                f"correction: {self.correction} corrects a gradient, not a value;"
                " expected none, shepard or rkpm-1 to rkpm-3"
            )

    @property
    def derivatives(self) -> int:
        """k, the number of derivatives that the estimate stands for."""
        return DERIVATIVES[self.name]

    @property
    def polynomial_degree(self) -> int | None:
        """m of the polynomial that multiplies the kernel (0 for Shepard); None if there is none."""
        if self.correction.startswith("rkpm-"):
            return int(self.correction.removeprefix("rkpm-"))
        return 0 if self.correction.endswith("shepard") else None

    @property
    def consistency(self) -> int:
        """The degree up to which polynomials are exact on any arrangement; −1 if none is."""
        if self.correction.startswith("csph"):
            return 1 if self.form == "difference" or "shepard" in self.correction else -1
        if self.polynomial_degree is not None:
            return self.polynomial_degree
        return 0 if self.form == "difference" else -1

    def target(self, dim: int, axis: int = 0) -> dict[MultiIndex, int]:
        """The moments of an estimate without error; those not named are 0."""
        return {unit(dim, axis, self.derivatives): 1}

    def needed(self, dim: int, degree: int) -> list[Key]:
        """The base sums that moments up to `degree` of every component need, and no others."""
        zero = unit(dim, 0, 0)
        slopes = [unit(dim, i) for i in range(dim)] if self.derivatives else []
        m = self.polynomial_degree
        kernels = [zero] if m is not None or not slopes else []
        reach = max(degree + (m or 0), 2 * (m or 0))
        if self.correction.startswith("csph"):
            reach = max(reach, 1 + (m or 0))
        alphas = list(multi_indices(dim, reach))
        return [(delta, alpha) for delta in (*kernels, *slopes) for alpha in alphas]

    def coefficients(self, sums: Sums, dim: int, solve: Solver | None = None) -> list[dict[Key, Any]]:
        """c[δ, γ] for each component of the estimate: one for a value, `dim` for a gradient.

        `solve(matrix, columns)` solves a linear system; the default is exact elimination, which
        raises ValueError where the correction matrix is singular.
        """
        solve = solve or eliminate
        zero = unit(dim, 0, 0)
        m = self.polynomial_degree
        if self.derivatives == 0:
            return [{(zero, zero): 1} if m is None else _reproducing(sums, dim, m, None, solve)]
        axes = range(dim)
        parts: list[dict[Key, Any]] = [
            {(unit(dim, i), zero): 1} if m is None else _reproducing(sums, dim, m, i, solve)
            for i in axes
        ]
        if self.correction.startswith("csph"):
            slopes = [[combine(part, sums, unit(dim, j)) for j in axes] for part in parts]
            identity = [[int(i == j) for j in axes] for i in axes]
            inverse = solve(slopes, identity)
            keys = list(dict.fromkeys(key for part in parts for key in part))
            parts = [
                {
                    key: sum(inverse[i][k] * parts[k][key] for k in axes if key in parts[k])
                    for key in keys
                }
                for i in axes
            ]
        return parts

    def correct(
        self, sums: Sums, dim: int, degree: int, axis: int = 0, solve: Solver | None = None
    ) -> dict[MultiIndex, Any]:
        """The moments M_α, |α| <= degree, of the component `axis`, from the base sums."""
        part = self.coefficients(sums, dim, solve)[axis if self.derivatives else 0]
        moments = {alpha: combine(part, sums, alpha) for alpha in multi_indices(dim, degree)}
        if self.form == "difference":
            moments[unit(dim, 0, 0)] = 1 - min(self.derivatives, 1)
        return moments


def combine(part: Mapping[Key, Any], sums: Sums, alpha: MultiIndex) -> Any:
    """M_α = Σ c[δ, γ] m[δ, α + γ]."""
    return sum(c * sums[delta, add(alpha, gamma)] for (delta, gamma), c in part.items())


def _reproducing(
    sums: Sums, dim: int, degree: int, axis: int | None, solve: Solver
) -> dict[Key, Any]:
    """Coefficients of the RKPM kernel W Σ_j c_j s^{α_j}, or of its exact derivative along `axis`.

    The moment matrix P_jk = m[0, α_j + α_k] gives P c = e₀. With respect to the evaluation point,
    ∂ᵢ(s^α W) = −αᵢ s^{α−eᵢ} W − s^α ∂ᵢW (in units of 1/h), and P ∂ᵢc = −(∂ᵢP) c.
    """
    zero = unit(dim, 0, 0)
    basis = list(multi_indices(dim, degree))
    matrix = [[sums[zero, add(a, b)] for b in basis] for a in basis]
    c = [row[0] for row in solve(matrix, [[int(a == zero)] for a in basis])]
    if axis is None:
        return {(zero, a): c_a for a, c_a in zip(basis, c, strict=True)}
    e = unit(dim, axis)

    def slope(alpha: MultiIndex) -> Any:
        lower = alpha[axis] * sums[zero, _lowered(alpha, axis)] if alpha[axis] else 0
        return sums[e, alpha] - lower

    right = [[-sum(slope(add(a, b)) * x for b, x in zip(basis, c, strict=True))] for a in basis]
    dc = [row[0] for row in solve(matrix, right)]
    part: dict[Key, Any] = {(e, a): c_a for a, c_a in zip(basis, c, strict=True)}
    for a, c_a, dc_a in zip(basis, c, dc, strict=True):
        part[zero, a] = part.get((zero, a), 0) + dc_a
        if a[axis]:
            lower = zero, _lowered(a, axis)
            part[lower] = part.get(lower, 0) - a[axis] * c_a
    return part


def _lowered(alpha: MultiIndex, axis: int) -> MultiIndex:
    return tuple(n - (i == axis) for i, n in enumerate(alpha))


def eliminate(matrix: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Solve matrix · X = columns by elimination in any exact field; ValueError if singular."""
    n = len(matrix)
    rows = [[*a, *b] for a, b in zip(matrix, columns, strict=True)]
    for i in range(n):
        pivot = next((r for r in range(i, n) if rows[r][i] != 0), None)
        if pivot is None:
            raise ValueError(
                "correction: its moment matrix is singular here: too few neighbours, or neighbours"
                " on one line or plane; expected a smaller Δx/h, or a lower correction"
            )
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for r in range(n):
            if r != i and rows[r][i] != 0:
                factor = rows[r][i]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i], strict=True)]
    return [row[n:] for row in rows]


def _choice(argument: str, value: object, allowed: object) -> None:
    names = list(allowed)  # type: ignore[call-overload]
    if value not in names:
        raise ValueError(f"{argument}: got {value!r}, expected one of {', '.join(names)}")
