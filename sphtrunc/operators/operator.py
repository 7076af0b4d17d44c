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

from dataclasses import dataclass
from math import factorial, prod
from typing import Any

from sphtrunc.arithmetic.elimination import eliminate
from sphtrunc.operators.corrections import (
    _fatehi_manzari,
    _renormalised,
    _reproducing,
    _times,
    _weighted,
    combine,
    shifted,
)
from sphtrunc.operators.moments import MultiIndex, multi_indices, unit
from sphtrunc.operators.terms import (
    BROOKSHAW,
    FATEHI_MANZARI,
    Around,
    Key,
    Reader,
    Solver,
    Sums,
    Term,
)

#: the form of A_b ρ_a/ρ_b + A_a ρ_b/ρ_a
SYMMETRIC = "symmetric"
#: the form that takes neighbours at ±s together
PAIRED = "paired"
#: the form that has no terms of its own: a gradient's, twice
NESTED = "nested"

#: operator: number of derivatives, forms (the first is the default)
OPERATORS = {
    "value": (0, ("standard", "difference")),
    "gradient": (1, ("standard", "difference", SYMMETRIC, PAIRED)),
    "divergence": (1, ("standard", "difference", SYMMETRIC, PAIRED)),
    "curl": (1, ("standard", "difference", SYMMETRIC, PAIRED)),
    "laplacian": (2, ("direct", "difference", BROOKSHAW, FATEHI_MANZARI, NESTED)),
    "hessian": (2, ("direct", "difference", NESTED)),
}
#: what the exact theory in `derive` covers
FORMS = ("standard", "difference")
UNCORRECTED = (SYMMETRIC, PAIRED, BROOKSHAW, FATEHI_MANZARI)
CORRECTIONS = ("none", "shepard", "csph", "csph-shepard", "rkpm-1", "rkpm-2", "rkpm-3")


@dataclass(frozen=True)
class Operator:
    """An SPH estimate of A or of its derivatives.

    name: "value" Σ A_b W V; "gradient" −Σ A_b ∇W(x_b − x_a) V, and with it "divergence" and "curl"
        of a vector; "laplacian" and "hessian" Σ A_b ∂ᵢ∂ⱼW V.
    form: "standard" ("direct" for second derivatives); "difference" with A_b − A_a in place of A_b
        (and A_a added to a value); "symmetric" with A_b ρ_a/ρ_b + A_a ρ_b/ρ_a, which conserves
        momentum; "paired" with half of A(s) − A(−s), which is the standard form where neighbours
        lie at ±s of the target, without the rounding of A itself; "brookshaw"
        2 Σ (A_b − A_a)(−W′/r) V (Brookshaw 1985, doi:10.1017/S1323358000018117; Morris, Fox & Zhu
        1997, doi:10.1006/jcph.1997.5776);
        "fatehi-manzari", the same less the part of ∇A (CSPH), contracted with the tensor that
        makes it exact for quadratic fields (2011, doi:10.1016/j.camwa.2010.12.028); "nested", the
        gradient of the gradient, ⟨∂ᵢ⟨∂ⱼA⟩⟩ with i <= j, both of them in the difference form and
        with the same correction (Chaniotis, Poulikakos & Koumoutsakos 2002,
        doi:10.1006/jcph.2002.7152, compare it with the others)
    correction: "none"; "shepard" divides the kernel by Σ W V; "csph" multiplies the gradient by the
        inverse of Σ_b ∇W (x_b − x_a) V ("csph-shepard": of the kernel that Shepard's has divided);
        "rkpm-m" multiplies the kernel by the polynomial of degree m that makes the estimate exact
        for polynomials of degree m. Derivatives of corrected kernels are exact derivatives with
        respect to the point of evaluation; Shepard's is RKPM of degree 0.

    Raises ValueError for an unknown name, or a correction that does not apply.
    """

    name: str = "gradient"
    form: str | None = None
    correction: str = "none"

    def __post_init__(self) -> None:
        _choice("operator", self.name, OPERATORS)
        forms = OPERATORS[self.name][1]
        if self.form is None:
            object.__setattr__(self, "form", forms[0])
        _choice("form", self.form, forms)
        _choice("correction", self.correction, CORRECTIONS)
        if self.derivatives != 1 and self.correction.startswith("csph") and self.form != NESTED:
            raise ValueError(
                f"correction: {self.correction} corrects a gradient, not a {self.name};"
                " expected none, shepard or rkpm-1 to rkpm-3"
            )
        if self.correction != "none" and self.form in UNCORRECTED:
            raise ValueError(
                f"correction: got {self.correction} for the form {self.form}, expected none"
            )

    @property
    def derivatives(self) -> int:
        """k, the number of derivatives that the estimate stands for."""
        return OPERATORS[self.name][0]

    @property
    def copies(self) -> int:
        """1 + c where the estimate sees A_b + c A_a, for equal densities: how much of a constant
        field it sees. 0 for differences, 1 for A_b alone, 2 for the symmetric form."""
        return {"standard": 1, "direct": 1, SYMMETRIC: 2}.get(str(self.form), 0)

    @property
    def uses_difference(self) -> bool:
        """The estimate sees differences of A only, not A_a itself."""
        return self.copies == 0

    @property
    def adds_own(self) -> bool:
        """A value in the difference form is A_a plus what the sum over the differences gives."""
        return self.derivatives == 0 and self.uses_difference

    def zeroth(self, moment: Any) -> Any:
        """M_0 of the estimate from that of its weights, for particles of equal density."""
        return int(self.adds_own) if self.uses_difference else self.copies * moment

    def require_pairs(self, present: bool) -> None:
        """Raises ValueError where the form needs neighbours at ±s, and they are not present."""
        if self.form == PAIRED and not present:
            raise ValueError(
                "form: paired takes the neighbours at s and −s together, and these particles are"
                " not in such pairs; expected an undisplaced lattice other than hcp with offset 0,"
                " or the form standard"
            )

    @property
    def uncorrected(self) -> bool:
        """The weights are the kernel's own, so that the base sums are the moments."""
        return self.correction == "none" and self.form not in (FATEHI_MANZARI, NESTED)

    @property
    def gradient(self) -> Operator:
        """The gradient that the nested form takes twice."""
        return Operator("gradient", "difference", self.correction)

    def axes(self, dim: int) -> list[list[tuple[int, int]]]:
        """For each component of a nested second derivative: the (i, j) of ⟨∂ᵢ⟨∂ⱼA⟩⟩, summed."""
        return [
            [tuple(i for i, n in enumerate(mu) for _ in range(n)) for mu in row]  # type: ignore[misc]
            for row in self.components(dim)
        ]

    @property
    def polynomial_degree(self) -> int | None:
        """m of the polynomial that multiplies the kernel (0 for Shepard); None if there is none."""
        if self.correction.startswith("rkpm-"):
            return int(self.correction.removeprefix("rkpm-"))
        return 0 if self.correction.endswith("shepard") else None

    @property
    def consistency(self) -> int:
        """The degree up to which polynomials are exact on any arrangement; −1 if none is."""
        if self.form == FATEHI_MANZARI:
            return 2
        if self.correction.startswith("csph"):
            return 1 if self.uses_difference or "shepard" in self.correction else -1
        if self.polynomial_degree is not None:
            return self.polynomial_degree
        return 0 if self.uses_difference else -1

    def components(self, dim: int) -> list[tuple[MultiIndex, ...]]:
        """The derivatives that each component of the estimate stands for, summed.

        One row for a value or a Laplacian, `dim` for a gradient (of which divergence and curl are
        made), the pairs i <= j for a Hessian. Raises ValueError for a curl in 1D.
        """
        axes = range(dim)
        if self.name == "curl" and dim == 1:
            raise ValueError("operator: there is no curl in 1D, expected dim 2 or 3")
        if self.name == "laplacian":
            return [tuple(unit(dim, i, 2) for i in axes)]
        return [(mu,) for mu in multi_indices(dim, self.derivatives) if sum(mu) == self.derivatives]

    def target(self, dim: int, axis: int = 0) -> dict[MultiIndex, int]:
        """The moments of an estimate without error; those not named are 0."""
        return {mu: prod(factorial(n) for n in mu) for mu in self.components(dim)[axis]}

    def needed(self, dim: int, degree: int) -> list[Key]:
        """The base sums that moments up to `degree` of every component need, and no others."""
        if self.form == NESTED:
            return self.gradient.needed(dim, degree)
        m = self.polynomial_degree
        terms: list[Term]
        if self.form == BROOKSHAW:
            terms, reach = [BROOKSHAW], degree
        elif self.form == FATEHI_MANZARI:
            terms = [FATEHI_MANZARI, *(unit(dim, i) for i in range(dim))]
            reach = max(degree, 2) + 2
        else:
            top = list(dict.fromkeys(mu for part in self.components(dim) for mu in part))
            below = [d for d in multi_indices(dim, self.derivatives) if d not in top]
            terms = [*(below if m is not None else ()), *top]
            reach = max(degree + (m or 0), 2 * (m or 0))
            if self.correction.startswith("csph"):
                reach = max(reach, 1 + (m or 0))
        alphas = list(multi_indices(dim, reach))
        return [(term, alpha) for term in terms for alpha in alphas]

    def coefficients(
        self, sums: Sums, dim: int, solve: Solver | None = None
    ) -> list[dict[Key, Any]]:
        """c[δ, γ] for each row of `components`; of the nested form for its gradient's, at a target.

        `solve(matrix, columns)` solves a linear system; the default is exact elimination, which
        raises ValueError where the correction matrix is singular.
        """
        solve = solve or eliminate
        zero = unit(dim, 0, 0)
        m = self.polynomial_degree
        if self.form == BROOKSHAW:
            return [{(BROOKSHAW, zero): 2}]
        if self.form == FATEHI_MANZARI:
            return [_fatehi_manzari(sums, dim, solve)]
        if self.form == NESTED:
            return self.gradient.coefficients(sums, dim, solve)
        rows = self.components(dim)
        if m is None:
            parts: list[dict[Key, Any]] = [{(mu, zero): 1 for mu in row} for row in rows]
        else:
            wanted = [mu for row in rows for mu in row]
            found = dict(zip(wanted, _reproducing(sums, dim, m, wanted, solve), strict=True))
            parts = [_weighted((1, found[mu]) for mu in row) for row in rows]
        if self.correction.startswith("csph"):
            parts = _renormalised(parts, sums, dim, solve)
        return parts

    def correct(
        self,
        sums: Sums,
        dim: int,
        degree: int,
        axis: int = 0,
        solve: Solver | None = None,
        around: Around | None = None,
        read: Reader | None = None,
    ) -> dict[MultiIndex, Any]:
        """The moments M_α, |α| <= degree, of the component `axis`, from the base sums (for the
        symmetric form: of particles of equal density).

        around: for the nested form, what the neighbours see: for each sort of particles the part
            of `sums` over these, and the sums at one of them; None where the target is a particle
            and all are alike
        read: Σ_b w_b ⟨s^α⟩_b from the coefficients of the weights, where the value of a particle is
            not that of the field at its place
        """
        read = read or (lambda part, alpha: combine(part, sums, alpha))
        if self.form == NESTED:
            return self._nested(sums, dim, degree, axis, solve, around or [(sums, sums)])
        part = self.coefficients(sums, dim, solve)[axis]
        moments = {alpha: read(part, alpha) for alpha in multi_indices(dim, degree)}
        zero = unit(dim, 0, 0)
        moments[zero] = self.zeroth(moments[zero])
        return moments

    def _nested(
        self,
        sums: Sums,
        dim: int,
        degree: int,
        axis: int,
        solve: Solver | None,
        around: Around,
    ) -> dict[MultiIndex, Any]:
        """M_α = Σ_b w_b (⟨∂ⱼ s^α⟩_b − ⟨∂ⱼ s^α⟩_a) with ⟨∂ⱼ s^α⟩_b = Σ_β C(α, β) s_b^{α−β} m^b_β."""
        alphas = list(multi_indices(dim, degree))
        gradient = self.gradient
        rows = gradient.coefficients(sums, dim, solve)

        def inner(at: Sums) -> list[dict[MultiIndex, Any]]:
            return [gradient.correct(at, dim, degree, j, solve) for j in range(dim)]

        own = inner(sums)
        sorts = [
            (
                [{a: combine(row, part, a) for a in alphas} for row in rows],
                own if at is sums else inner(at),
            )
            for part, at in around
        ]
        return {
            alpha: sum(
                sum(shifted(outer[i], slopes[j], alpha) for outer, slopes in sorts)
                - _times(combine(rows[i], sums, alphas[0]), own[j][alpha])
                for i, j in self.axes(dim)[axis]
            )
            for alpha in alphas
        }


def _choice(argument: str, value: object, allowed: object) -> None:
    names = list(allowed)  # type: ignore[call-overload]
    if value not in names:
        raise ValueError(f"{argument}: got {value!r}, expected one of {', '.join(names)}")
