"""Derivation: a derived truncation error, as exact data."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from sympy import Expr, Rational

from sphtrunc.kernels.gaussian import Gaussian
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import Moments, MultiIndex, label, unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.theory import typeset
from sphtrunc.theory.euler_maclaurin import KnotTerm, phased
from sphtrunc.theory.orders import Orders
from sphtrunc.theory.symmetry import classes
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.theory.aliasing import Aliasing
    from sphtrunc.theory.disorder.prediction import Prediction
    from sphtrunc.theory.walls.derivation import WallView


@dataclass(frozen=True)
class Varying:
    """The continuous limit where the smoothing length is h(x) = h_a (1 + g·s).

    gradient: g = dh/dx along each axis; rule: whose h a pair takes
    limit: the moments, exact where their series ends and to 30 digits elsewhere
    series: multi-index -> coefficients of powers of g, exactly; empty where g is not along x
    """

    gradient: tuple[Rational, ...]
    rule: str
    limit: Moments
    series: Mapping[MultiIndex, Sequence[Rational]]


@dataclass(frozen=True)
class Derivation:
    """The derived truncation error of one kernel and one operator.

    limit: moments for Δx/h → 0; their error is the smoothing error
    terms: the discretisation error of the base sums in 1D, each exact
    shift: the offset along every axis, of which `offset` is the first; lattice; volume: their rule
    discrete: the moments at the given Δx/h and offset (None without a ratio)
    find_orders, find_aliasing: derive `orders` and `aliasing` when they are first asked for
    scatter: mean and spread of the moments where the particles are displaced (None without jitter)
    varying: the limit with a gradient of h (None without one); `discrete` has it too, `terms` not
    wall: the plane that cuts the support (None without one)
    """

    kernel: Kernel | Gaussian
    operator: Operator
    dim: int
    degree: int
    limit: Moments
    terms: tuple[KnotTerm, ...]
    dx_over_h: Expr | None
    offset: Rational
    shift: tuple[Rational, ...]
    lattice: str
    volume: str
    discrete: Moments | None
    find_orders: Callable[[], Orders] = field(repr=False, compare=False)
    find_aliasing: Callable[[], Aliasing | None] = field(repr=False, compare=False)
    scatter: Prediction | None = None
    varying: Varying | None = None
    wall: WallView | None = None

    @cached_property
    def orders(self) -> Orders:
        """The orders of the error, read off exact coefficients."""
        return self.find_orders()

    @cached_property
    def aliasing(self) -> Aliasing | None:
        """The reasons for the discretisation error of a lattice in 2D and 3D; None in 1D, where
        `terms` say all."""
        return self.find_aliasing() if self.dim > 1 and self.varying is None else None

    @property
    def smoothing_error(self) -> list[tuple[int, int, Rational]]:
        """Rows (n, p, c): the estimate has the error c h^p A^{(n)} (in d > 1: c h^p ∇^p D A)."""
        k = self.operator.derivatives
        rows = []
        for alpha, c in self.limit.taylor().items():
            if alpha == unit(self.dim, 0, sum(alpha)) and c != 0:
                rows.append((sum(alpha), sum(alpha) - k, c))
        return rows

    @property
    def continuous(self) -> Moments:
        """The moments for Δx/h → 0, with the gradient of h where there is one."""
        return self.limit if self.varying is None else self.varying.limit

    @property
    def discretisation(self) -> dict[Any, Any]:
        """M_k at Δx/h minus its limit for Δx/h → 0; ValueError if no ratio was given."""
        if self.discrete is None:
            raise ValueError(
                "derivation: no ratio Δx/h was given, so there are no discrete moments"
            )
        differences = (self.discrete - self.continuous).items()
        return {alpha[0] if self.dim == 1 else alpha: value for alpha, value in differences}

    @property
    def own_terms(self) -> list[KnotTerm]:
        """The terms of the moments that the estimate has: not M_0 of a difference form (which a
        nested one takes at the neighbours, not at a target beside them)."""
        plain = self.operator.form != NESTED or self.offset == 0
        if self.operator.correction == "none" and self.operator.uses_difference and plain:
            return [t for t in self.terms if t.moment > 0]
        return list(self.terms)

    @property
    def terms_by_sum(self) -> dict[tuple[Any, int], list[KnotTerm]]:
        """`own_terms` of every base sum (term, moment)."""
        groups: dict[tuple[Any, int], list[KnotTerm]] = {}
        for t in self.own_terms:
            groups.setdefault((t.term, t.moment), []).append(t)
        return groups

    @cached_property
    def leading_terms(self) -> dict[tuple[Any, int], tuple[int, dict[Rational, Any]]]:
        """Of every base sum the first power n of Δx/h that is left at a generic ratio, and knot p
        -> coefficient of B̃_n(p h/Δx − θ) in it."""
        found = {}
        for key, terms in self.terms_by_sum.items():
            for n in sorted({t.dx_power for t in terms}):
                row = {t.knot: t.coefficient for t in terms if t.dx_power == n}
                left = phased(row, n, self.offset)
                if left:
                    found[key] = n, left
                    break
        return found

    @cached_property
    def alike(self) -> list[list[MultiIndex]]:
        """The moments of displaced particles that are not zero; those together that are equal by a
        symmetry of the lattice."""
        if self.scatter is None:
            return []
        shown = [a for a, mean in self.scatter.mean.items() if mean or self.scatter.std[a]]
        return classes(self.operator, self.lattice, self.shift, shown)

    # -- JSON -------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """The contract of schema `sphtrunc.derive/1`; every exact number is a string."""
        kernel, dim = self.kernel, self.dim
        sigma = kernel.normalisation(dim)
        orders = {
            "smoothing": self.orders.smoothing,
            "discretisation_generic": self.orders.generic,
            "discretisation_aligned": self.orders.aligned,
        }
        result: dict[str, Any] = {
            "schema": "sphtrunc.derive/1",
            "kernel": {
                "name": kernel.name,
                "source": kernel.source,
                "support": str(kernel.support),
                "knots": [str(k) for k in kernel.knots],
                "pieces": [[str(c) for c in piece] for piece in kernel.coefficients()],
            },
            "dim": dim,
            "operator": self.operator.name,
            "form": self.operator.form,
            "correction": self.operator.correction,
            "degree": self.degree,
            "normalisation": str(sigma),
            "w0": str(sigma * kernel.central(dim)),
            "boundary_smoothness": typeset.finite(kernel.boundary_smoothness),
            "smoothness": typeset.finite(kernel.smoothness),
            "jumps": [
                {"knot": str(knot), "derivative": m, "jump": str(jump)}
                for m in range(kernel.degree + 1)
                for knot, jump in kernel.jumps(m).items()
                if jump != 0
            ],
            "kernel_moments": {
                str(n): str(kernel.moment(n, dim)) for n in range(0, self.degree + 1, 2)
            },
            "gradient_moments": {
                str(n): str(kernel.gradient_moment(n, dim)) for n in range(1, self.degree + 1, 2)
            },
            "smoothing_error": [
                {"derivative": n, "h_power": p, "coefficient": str(c)}
                for n, p, c in self.smoothing_error
            ],
            "discretisation_terms": [
                {
                    "sum": typeset.sum_name(t.term),
                    "moment": t.moment,
                    "dx_power": t.dx_power,
                    "knot": str(t.knot),
                    "coefficient": str(t.coefficient),
                }
                for t in self.own_terms
            ],
            "orders": orders,
        }
        if self.varying is not None:
            result["h_gradient"] = [str(g) for g in self.varying.gradient]
            result["h_rule"] = self.varying.rule
            result["limit_moments"] = self.varying.limit.to_dict()
        if self.aliasing is not None:
            result["aliasing"] = self.aliasing.to_dict()
        if self.discrete is not None:
            result["dx_over_h"] = str(self.dx_over_h)
            result["offset"] = str(self.offset)
            if self.dim > 1:
                result["offset"] = [str(x) for x in self.shift]
            result["lattice"] = self.lattice
            result["volume"] = self.volume
            result["discrete_moments"] = self.discrete.to_dict()
            result["predicted"] = self._predicted()
        if self.wall is not None:
            result |= self.wall.to_dict(self.limit)
        return {**result, "version": __version__}

    def _predicted(self) -> dict[str, Any]:
        """Mean and standard deviation over targets: of the lattice itself, or under disorder."""
        assert self.discrete is not None
        if self.scatter is None:
            mean = {a: float(m) for a, m in self.discrete.values.items()}
            std = dict.fromkeys(mean, 0.0)
            more: dict[str, Any] = {"jitter": 0.0, "how": "lattice sum"}
        else:
            mean, std = dict(self.scatter.mean), dict(self.scatter.std)
            more = {
                "jitter": self.scatter.jitter,
                "distribution": self.scatter.distribution,
                "how": self.scatter.how,
            }
        rows = {label(a): {"mean": mean[a], "std": std[a]} for a in mean}
        if self.scatter is not None:
            for alpha, x in self.scatter.uncertainty.items():
                rows[label(alpha)]["uncertainty"] = x
        return {**more, "moments": rows}

    def to_json(self) -> str:
        """`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False)

    # -- for people -------------------------------------------------------------------------------

    def to_text(self) -> str:
        """What a person reads first; at most 100 columns, deterministic."""
        # all that is derived when it is first asked for is so before it is written down
        _ = self.orders, self.aliasing
        if self.wall is None:
            _ = self.leading_terms, self.alike
            return typeset.text(self)
        from sphtrunc.theory.walls.text import text

        return text(self)

    def __str__(self) -> str:
        return self.to_text()

    def to_latex(self) -> str:
        """A fragment for a document with amsmath: the kernel, the error and the moments."""
        return typeset.fragment(self)

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {typeset.smoothing(self)}$"
