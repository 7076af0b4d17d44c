"""The pair formula: what one neighbour adds to the sums of a target, written once for every number.

Everything that operators need of the particles is a combination of the radial sums

    R[k, β, f] = Σ_b V_b f_k(q_b) s_b^β A_b,      s = (x_b − x_a)/h_a,

f_k the radial factors of the kernel and A a field (1 for the moments; A_b − A_a on request). The
formula runs on NumPy arrays and on the SIMD lanes of the compiled engine, and on both with a
running bound of its own rounding error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.experiment.engine.bounds import Bounded, BoundedNumbers
from sphtrunc.kernels.factors import Radial, evaluate, radial
from sphtrunc.operators.moments import MultiIndex
from sphtrunc.operators.terms import CURVATURE, OTHERS, SLOPE, STEEP, VALUE, Key, parts

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

COUNT = (
    OTHERS + 1
)  # R[COUNT, 0]: particles within the support, and 2²⁶ times those not at the target
#: powers of h_a/h_ab beyond d that a factor carries where a pair has an h of its own
_STRETCH = {VALUE: 0, SLOPE: 2, CURVATURE: 4, STEEP: 4, COUNT: 0, OTHERS: 2}


class Term(NamedTuple):
    """One radial sum: factor k, monomial β, field (−1: none)."""

    k: int
    beta: MultiIndex
    field: int


@dataclass(frozen=True)
class Plan:
    """What a pass over the pairs sums; everything in it is fixed when the loop is compiled.

    factors: (k, radial factor) in use; terms: the sums; fields: how many
    groups: in place of the terms, sums of several of them each, without volumes: Σ_b Σ f_k s^β A_b
    room: not 0: of every group Σ_b A_b ε, A >= 0 its one field and ε at least what `room` roundings
        and those of the pair formula make of any f_k s^β among the terms
    difference: A_b − A_a in place of A_b
    mode: "one" (h of the target), "scatter", "mean" or "mean-kernel"
    low: positions are pairs of floats (images in a periodic box)
    compensated: sums carry their rounding errors; bound: sums carry a bound of all errors
    quantum: relative error that the positions came with; the bound carries it
    support: κ; even: no kernel factor needs q, q² will do
    """

    dim: int
    factors: tuple[tuple[int, Radial], ...]
    terms: tuple[Term, ...]
    fields: int
    difference: bool
    mode: str
    low: bool
    compensated: bool
    bound: bool
    quantum: float
    support: float
    even: bool
    groups: tuple[tuple[Term, ...], ...] = ()
    room: int = 0

    @property
    def sums(self) -> int:
        """How many there are."""
        return len(self.groups or self.terms)


def plan(
    kernel: Kernel,
    dim: int,
    terms: Iterable[Term],
    *,
    fields: int = 0,
    difference: bool = False,
    mode: str = "one",
    low: bool = False,
    compensated: bool = False,
    bound: bool = False,
    quantum: float = 0.0,
    groups: Iterable[tuple[Term, ...]] = (),
    room: int = 0,
) -> Plan:
    """The plan for these sums with this kernel."""
    terms, groups = tuple(dict.fromkeys(terms)), tuple(groups)
    every = terms if room else [*terms, *(t for group in groups for t in group)]
    used = {SLOPE if t.k == OTHERS else t.k for t in every} - {COUNT}
    factors = tuple((k, radial(kernel, dim, k)) for k in sorted(used))
    return Plan(
        dim=dim,
        factors=factors,
        terms=terms,
        fields=fields,
        difference=difference,
        mode=mode,
        low=low,
        compensated=compensated,
        bound=bound,
        quantum=quantum,
        support=float(kernel.support),
        even=all(f.even for _, f in factors),
        groups=groups,
        room=room,
    )


# ---------------------------------------------------------------- base sums out of radial sums


def needed_terms(keys: Iterable[Key], fields: int, field_keys: Iterable[Key]) -> list[Term]:
    """The radial sums behind base sums `keys` and field-weighted sums `field_keys`."""
    terms = [Term(k, beta, -1) for key in keys for _, beta, k in parts(key)]
    for f in range(fields):
        terms += [Term(k, beta, f) for key in field_keys for _, beta, k in parts(key)]
    return list(dict.fromkeys(terms))


def base_sum(key: Key, field: int, sums: Mapping[Term, Any]) -> Any:
    """m[δ, α], or with the field in every term, from the radial sums."""
    total: Any = None
    for c, beta, k in parts(key):
        part = sums[Term(k, beta, field)]
        part = part if c == 1 else c * part
        total = part if total is None else total + part
    return total


# ------------------------------------------------------------------------------ the formula


class Ends(NamedTuple):
    """A particle at one end of a pair: numbers, arrays or lanes.

    x, low: coordinates; volume: V_b (sources only); fields: A; per_h: 1/h
    """

    x: list[Any]
    low: list[Any]
    volume: Any
    fields: list[Any]
    per_h: Any


def row_counts(plan: Plan) -> tuple[int, int, int]:
    """Rows of the sources (x, low, V, A, 1/h), of what targets are (x, low, 1/h, A), and of the
    sums (themselves, their compensations, their bounds)."""
    places = plan.dim * (2 if plan.low else 1)
    own = plan.fields if plan.difference else 0
    per_term = 1 + int(plan.compensated) + int(plan.bound)
    sources = places + 1 + plan.fields + int(plan.mode != "one")
    return sources, places + 1 + own, per_term * plan.sums


def pair_terms(plan: Plan, number: Any, target: list[Any], source: list[Any]) -> list[Any]:
    """The contributions of pairs given as rows of numbers, as in `row_counts`."""
    d = plan.dim
    places = d * (2 if plan.low else 1)
    if plan.bound or plan.room:
        target = [Bounded(number, x, 0.0) for x in target]
        source = [Bounded(number, x, 0.0) for x in source]
        for per_h in (target[places], *(source[-1:] if plan.mode != "one" else [])):
            per_h.error = number.scale(per_h.value) * UNIT  # 1/h is rounded, what was given is not
        number = BoundedNumbers(number, plan.quantum)
    a = Ends(target[:d], target[d:places], None, target[places + 1 :], target[places])
    b = Ends(source[:d], source[d:places], source[places], source[places + 1 :], source[-1])
    return contributions(plan, number, a, b)


def _factors(
    plan: Plan, terms: list[Term], number: Any, squares: Any, stretch: Any
) -> dict[int, Any]:
    """The radial factors of a kernel of h, h_a/h = stretch (None: 1), at the squared distances."""
    seen = squares if stretch is None else squares * (stretch * stretch)
    q = None if plan.even else number.sqrt(seen)
    factors: dict[int, Any] = {}
    for k, f in plan.factors:
        factors[k] = evaluate(number, f, seen if f.even else q, squares)
    if any(t.k == OTHERS for t in terms):
        factors[OTHERS] = number.others(squares, factors[SLOPE])
    if any(t.k == COUNT for t in terms):
        edge = plan.support**2 if plan.even else plan.support
        factors[COUNT] = number.within(seen if plan.even else q, edge, squares)
    if stretch is not None:
        for k in factors:
            for _ in range(0 if k == COUNT else plan.dim + _STRETCH[k]):
                factors[k] = factors[k] * stretch
    return factors


def contributions(plan: Plan, number: Any, target: Ends, source: Ends) -> list[Any]:
    """V_b f_k(q) s^β A_b for every term of the plan."""
    s = []
    for i in range(plan.dim):
        d = number.difference(source.x[i], target.x[i])
        if plan.low:
            d = d + (source.low[i] - target.low[i])
        s.append(d * target.per_h)
    squares = s[0] * s[0]
    for s_i in s[1:]:
        squares = squares + s_i * s_i
    stretch = None
    if plan.mode in ("scatter", "mean-kernel"):
        stretch = source.per_h / target.per_h
    elif plan.mode == "mean":
        stretch = (source.per_h + source.per_h) / (source.per_h + target.per_h)
    if plan.groups and not plan.room:
        terms = [t for group in plan.groups for t in group]
    else:
        terms = list(plan.terms)
    factors = _factors(plan, terms, number, squares, stretch)
    if plan.mode == "mean-kernel":
        own = _factors(plan, terms, number, squares, None)
        factors = {
            k: number.larger(own[k], f) if k == COUNT else (own[k] + f) * 0.5
            for k, f in factors.items()
        }
    monomials: dict[MultiIndex, Any] = {}

    def monomial(beta: MultiIndex) -> Any:
        if beta not in monomials:
            axis = next(i for i, n in enumerate(beta) if n)
            lower = tuple(n - (i == axis) for i, n in enumerate(beta))
            monomials[beta] = monomial(lower) * s[axis] if any(lower) else s[axis]
        return monomials[beta]

    if plan.room:
        return _sizes(plan, number, factors, squares, source)
    if plan.groups:
        products = {
            (t.k, t.beta): factors[t.k] * monomial(t.beta) if any(t.beta) else factors[t.k]
            for t in terms
        }
        return [
            sum(
                (products[t.k, t.beta] * source.fields[t.field] for t in rest),
                products[first.k, first.beta] * source.fields[first.field]
                if first.field >= 0
                else products[first.k, first.beta],
            )
            for first, *rest in plan.groups
        ]
    weighted: dict[tuple[int, int], Any] = {}
    for t in plan.terms:
        if (t.k, t.field) not in weighted:
            weight = source.volume
            if t.k == COUNT:
                weight = 1.0
            elif t.field >= 0 and plan.difference:
                weight = (source.fields[t.field] - target.fields[t.field]) * weight
            elif t.field >= 0:
                weight = source.fields[t.field] * weight
            weighted[t.k, t.field] = factors[t.k] * weight
    return [
        weighted[t.k, t.field] * monomial(t.beta) if any(t.beta) else weighted[t.k, t.field]
        for t in plan.terms
    ]


def _sizes(
    plan: Plan, number: Any, factors: Mapping[int, Any], squares: Any, source: Ends
) -> list[Any]:
    """Σ_b A_b ε of every group. |s^β| is at most |s|^|β|, and each of its factors is rounded three
    times and takes part in one product."""
    plain = number.plain
    distance = plain.sqrt(squares.value + squares.error) * (1.0 + 4.0 * UNIT)
    largest: Any = None
    for k, degree in dict.fromkeys((t.k, sum(t.beta)) for t in plan.terms):
        f = factors[k]
        size = plain.size(f.value) * ((plan.room + 4 * degree) * UNIT) + f.error
        for _ in range(degree):
            size = size * distance
        largest = size if largest is None else plain.larger(largest, size)
    return [source.fields[group[0].field].value * largest for group in plan.groups]
