"""Aliasing: what a lattice in 2D or 3D adds to an estimate, and why: the power of Δx/h and the
knots of the kernel that it comes from, the shells of the reciprocal lattice, and how other lattices
of equal number density would do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.transform import terms
from sphtrunc.operators.moments import MultiIndex, label, multi_indices, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import BROOKSHAW, Key
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.lattice_sums import lattice_sums
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.theory.reciprocal_sums import Shell, poisson_sum, shortest

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian

SHELLS = 4  # of the reciprocal lattice that are told
SUMMED = 300  # and that are looked at, for the bound on the rest
MOST_NEIGHBOURS = 20_000  # up to which other lattices are tried


@dataclass(frozen=True)
class Rank:
    """A lattice among those of its dimension at equal number density.

    error: rms over the components of the leading moments, lattice less limit
    shortest, count: length of the shortest reciprocal vectors in 1/Δx, and their number
    """

    lattice: str
    error: float
    shortest: float
    count: int


@dataclass(frozen=True)
class Aliasing:
    """The discretisation error on a lattice, with its reasons.

    order: how the leading moment falls with Δx/h, and from which knots; None for corrected
        operators and kernels that are not piecewise polynomials
    moment: the leading moment α
    shells: what the first shells of reciprocal vectors add to M_α that is not zero; tail: a bound
        on what all the others add, inf where none is known (of shells: where there are none)
    ranking: the lattices, the most accurate first; empty without Δx/h
    """

    order: Order | None
    moment: MultiIndex
    shells: tuple[Shell, ...]
    tail: float
    ranking: tuple[Rank, ...]

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON; exact numbers are strings, a bound that is not known is None."""
        order = self.order
        return {
            "moment": label(self.moment),
            "order": None if order is None else str(order.power),
            "limits": [
                {"knot": str(knot), "derivative": m}
                for knot, m in (() if order is None else order.limits)
            ],
            "shells": [asdict(shell) for shell in self.shells],
            "tail": self.tail if isfinite(self.tail) else None,
            "ranking": [asdict(rank) for rank in self.ranking],
        }


def aliasing(
    kernel: Kernel | Gaussian,
    operator: Operator,
    dim: int,
    scene: Arrangement | None = None,
) -> Aliasing:
    """The reasons for the discretisation error of an operator on a lattice; without one, of its
    order alone."""
    degree = leading_degree(operator)
    moment = unit(dim, 0, degree)
    order = None
    if operator.uncorrected and isinstance(kernel, Kernel):
        derivatives = 1 if operator.form == BROOKSHAW else operator.derivatives
        order = lattice_order(kernel, dim, derivatives)
    if scene is None:
        return Aliasing(order, moment, (), inf, ())
    shells, tail = _shells(kernel, operator, scene, moment)
    ranks = tuple(ranking(kernel, operator, dim, scene.dx_over_h))
    return Aliasing(order, moment, shells, tail, ranks)


def leading_degree(operator: Operator) -> int:
    """The degree of the first moments that a lattice can falsify: those of lower degree are exact,
    or zero by symmetry."""
    least = max(operator.derivatives, operator.consistency + 1)
    if operator.correction.startswith("csph"):  # whose first moments are exact in any form
        least = max(least, 2)
    return least + (least - operator.derivatives) % 2


def _shells(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement,
    alpha: MultiIndex,
) -> tuple[tuple[Shell, ...], float]:
    """The first shells of M_α of the first component that are not zero, and a bound on the rest."""
    if not operator.uncorrected:
        return (), inf
    (part, *_), dim = operator.coefficients({}, len(alpha)), len(alpha)
    keys: dict[Key, float] = {
        (term, tuple(a + g for a, g in zip(alpha, gamma, strict=True))): float(c)
        for (term, gamma), c in part.items()
    }
    if operator.form == BROOKSHAW:  # −s₁² Ŵ′/q = −s₁ ∂₁Ŵ
        keys = {(unit(dim, 0), unit(dim, 0)): 2.0}
    try:
        sums = [(c, poisson_sum(kernel, key, scene, SUMMED)) for key, c in keys.items()]
    except ValueError:  # the kernel jumps: F does not describe what the particles sum
        return (), inf
    rows = [
        Shell(
            same[0].length,
            same[0].count,
            sum(c * s.contribution for (c, _), s in zip(sums, same, strict=True)),
        )
        for same in zip(*(series.shells for _, series in sums), strict=True)
    ]
    tail = sum(abs(c) * series.tail for c, series in sums)
    told = [row for row in rows if abs(row.contribution) > 1e-17][:SHELLS]
    rest = sum(abs(row.contribution) for row in rows) - sum(abs(row.contribution) for row in told)
    return tuple(told), tail + rest


def ranking(
    kernel: Kernel | Gaussian, operator: Operator, dim: int, dx_over_h: Fraction
) -> list[Rank]:
    """The lattices of a dimension at equal number density, the most accurate first, by direct sums
    seen from a particle. Empty where that is too many particles, or an operator does not exist."""
    degree = leading_degree(operator)
    keys = operator.needed(dim, degree)
    limit = {key: continuous_sum(kernel, key) for key in keys}
    rows = []
    for kind, data in KINDS.items():
        if data.dim != dim:
            continue
        home = Arrangement(kind, dx_over_h)
        if home.sites(float(kernel.support) / float(dx_over_h)).shape[1] > MOST_NEIGHBOURS:
            return []
        try:
            sums = lattice_sums(kernel, keys, home, exact=False)
            error = _difference(operator, sums, limit, dim, degree)
        except ValueError:  # a singular correction, a kernel without a second derivative at 0
            return []
        rows.append(Rank(kind, error, *shortest(kind)))
    return sorted(rows, key=lambda row: row.error)


def _difference(
    operator: Operator, sums: Mapping[Key, Any], limit: Mapping[Key, Any], dim: int, degree: int
) -> float:
    """Rms over the components of the differences of the moments of one degree."""
    alphas = [alpha for alpha in multi_indices(dim, degree) if sum(alpha) == degree]
    total, components = 0.0, len(operator.components(dim))
    for axis in range(components):
        there = operator.correct(sums, dim, degree, axis)
        tends = operator.correct(limit, dim, degree, axis)
        total += sum(float(there[alpha] - tends[alpha]) ** 2 for alpha in alphas)
    return sqrt(total / components)


@dataclass(frozen=True)
class Order:
    """How fast the lattice error of a kernel falls with Δx/h, and why.

    power: of Δx/h, at a generic ratio
    limits: (knot p in h, the derivative of Ŵ that is the first to jump there) of all that limit it
    oscillating: whether the phase p·h/Δx turns, so that special ratios may do better
    """

    power: Fraction
    limits: tuple[tuple[Fraction, int], ...]
    oscillating: bool

    def __str__(self) -> str:
        reasons = " and ".join(f"the jump of derivative {m} at q = {p}" for p, m in self.limits)
        return f"(dx/h)^{self.power}, from {reasons}"


def lattice_order(kernel: Kernel, dim: int = 1, derivatives: int = 1) -> Order:
    """The order in Δx/h of the leading moment of an estimate on a lattice, with its reason.

    derivatives: m = 0 of a value, M_0; 1 of a gradient, M_1, and of Brookshaw's Laplacian, M_2 =
        2 M_1; 2 of second derivatives by W″, M_2

    The sum over G ≠ 0 of ∂^m[k^m F](G), of F + (G/d) F′ for m = 1, and G ∝ h/Δx: the slowest power
    of k in it. A term k^{−a} of F oscillating with a knot p > 0 gains a factor k in every k ∂; one
    of the origin does not. In 2D the integral given at `decay` takes half a power off an
    oscillating term of the 3D transform and a whole one off the others. Where a derivative of w
    below the m-th jumps, that which the particles sum lacks its delta function and M does not
    converge: order 0.
    """
    dim = dimension(dim)
    candidates: dict[Fraction, Fraction] = {}
    for p, a in terms(kernel, 3 if dim == 2 else dim, 0):
        power = Fraction(a - derivatives if p else a)
        if dim == 2:
            power -= Fraction(1, 2) if p else 1
        candidates[p] = min(power, candidates.get(p, power))
    first: dict[Fraction, int] = {}
    for m in range(kernel.degree, -1, -1):
        first |= {fraction(p): m for p, jump in kernel.jumps(m).items() if jump and p >= 0}
    jumping = {p: Fraction(0) for p, m in first.items() if m < derivatives and (p or dim == 1)}
    candidates = jumping or candidates
    least = min(candidates.values())
    limits = tuple((p, first[p]) for p, power in sorted(candidates.items()) if power == least)
    return Order(least, limits, any(p for p, _ in limits))
