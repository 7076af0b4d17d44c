"""Conservation: what a momentum equation keeps on given particles, to the rounding or not at all.

For forces F_a on particles at x_a: the residuals of Σ F, of Σ x × F (about the mean position), and
of the energy rate Σ v·F + Σ (m P/ρ²) ρ̇ beside a density rate, each over the sum of the sizes of
what is added up. Every residual comes with a rigorous bound of what rounding can make of zero:
"exact" says that the residual is below it. Which rate a form has for its partner is not tried but
computed: the transposed matrix is compared with the rates of the catalogue, factor by factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from math import fsum
from typing import Any

import numpy as np

from sphtrunc.arithmetic.summation import UNIT, Array
from sphtrunc.experiment.momentum import FORMS, State, partner, parts_of, rates
from sphtrunc.experiment.pair_matrices import Action, Part, act, same
from sphtrunc.operators.forces import CORRECTED
from sphtrunc.operators.h_rules import FORCE_RULES

_CHUNK = 1 << 13  # particles at a time, which stay in the caches
_COMPARED = 4096  # particles whose factors tell which matrix is another's transpose


@dataclass(frozen=True)
class Residual:
    """|Σ …|/Σ|…|, and the most that rounding makes of it where it is zero."""

    residual: float
    bound: float

    @property
    def exact(self) -> bool:
        """Zero, as far as these numbers can say."""
        return self.residual <= self.bound

    def to_dict(self) -> dict[str, Any]:
        """residual, bound, exact."""
        return {"residual": self.residual, "bound": self.bound, "exact": self.exact}


@dataclass(frozen=True)
class Kept:
    """What one form keeps under one rule for h.

    angular: None in 1D and in a periodic box; partner: the density rate that is its adjoint, None
    where the catalogue has none; energy: beside the partner, or beside `tried` without one
    force: what the form does to the pressure, (d, n)
    """

    form: str
    rule: str
    linear: Residual
    angular: Residual | None
    partner: str | None
    tried: str
    energy: Residual
    force: Array


def kept(
    state: State,
    pairs: Sequence[tuple[str, str]],
    velocity: Array | None = None,
    seed: int = 0,
) -> list[Kept]:
    """The residuals of forms under rules for h, pairs (form, rule), on the particles of a state.

    velocity: (d, n), with which the energy changes; None: independent normal numbers, of which any
        bilinear form that is not zero makes something
    Raises ValueError for a form that the rule does not go with.
    """
    if velocity is None:
        velocity = np.random.default_rng(seed).normal(size=(state.dim, state.cloud.count))
    forces: list[list[Part]] = []
    chosen: list[tuple[str | None, str, list[Part]]] = []
    for name, rule in pairs:
        _require(name, rule)
        parts = parts_of(state, name, rule)
        forces.append(parts)
        chosen.append(_partner(state, name, rule))
    requests: list[tuple[list[Part], Array]] = [(parts, state.pressure) for parts in forces]
    requests += [(parts, velocity) for _, _, parts in chosen]
    # the matrices of the corrections once more, for the bounds of their sums
    corrected = dict.fromkeys(
        FORCE_RULES[rule][0] for name, rule in pairs if _gradient(name) == CORRECTED
    )
    for sides in corrected:
        requests += state.moment_matrix(sides)
    done = act(state.cloud, requests, bound=True)
    columns = iter(done[2 * len(pairs) :])
    off = {sides: state.deviation(sides, [*islice(columns, state.dim)]) for sides in corrected}
    found = []
    for i, (name, rule) in enumerate(pairs):
        force, rate = done[i], done[len(pairs) + i]
        known, tried, _ = chosen[i]
        shift, turn = _defect(state, name, off.get(FORCE_RULES[rule][0]))
        found.append(
            Kept(
                form=name,
                rule=rule,
                linear=_linear(force, shift),
                angular=_angular(state, force, shift, turn),
                partner=known,
                tried=tried,
                energy=_energy(state, force, rate, velocity),
                force=force.value,
            )
        )
    return found


def _require(name: str, rule: str) -> None:
    if name not in FORMS:
        raise ValueError(f"form: got {name!r}, expected one of {', '.join(FORMS)}")
    allowed = dict.fromkeys((*FORMS[name].rules(False), *FORMS[name].rules(True)))
    if rule not in allowed:
        raise ValueError(
            f"h-rule: got {rule!r} for the form {name}, expected one of {', '.join(allowed)}"
        )


def _partner(state: State, name: str, rule: str) -> tuple[str | None, str, list[Part]]:
    """(name of the adjoint rate or None, name of the rate to try, its parts). Factors are functions
    of the particle, the same for all: some thousand of them are compared."""
    few = state.some(slice(None, None, max(1, state.cloud.count // _COMPARED)))
    transposed = partner(few, parts_of(few, name, rule))
    candidates = rates(few, name, rule)
    known = next((n for n, rows in candidates.items() if same(transposed, rows())), None)
    tried = known or next(iter(candidates))
    return known, tried, rates(state, name, rule)[tried]()


def _gradient(name: str) -> str | None:
    force = FORMS[name].force
    return None if force is None else force.gradient


def _defect(state: State, name: str, off: Array | None) -> tuple[Array | float, Array | float]:
    """(n,) each: the force and the couple that the rounding of a correction leaves.

    off: how far C B may be from 1
    """
    if FORMS[name].force is None:
        rest = state.volume * np.abs(state.pressure) * state.reproducing[1]
        return rest / state.cloud.h, 2.0 * rest
    if _gradient(name) == CORRECTED:
        assert off is not None
        return 0.0, 2.0 * state.volume * np.abs(state.pressure) * off
    return 0.0, 0.0


def _total(terms: Callable[[slice], Array], count: int) -> float:
    """Σ of terms that are made a part of the particles at a time, in the widest floats that the
    machine has, and parts without error: of pairwise sums in ordinary ones, 10⁻¹⁵ of what is added
    up, far below the bounds."""
    sums: list[float] = []
    for first in range(0, count, _CHUNK):
        part = np.sum(terms(slice(first, first + _CHUNK)), dtype=np.longdouble)
        sums += [float(part), float(part - np.longdouble(float(part)))]
    return fsum(sums)


def _sum(terms: Callable[[slice], Any], count: int) -> float:
    """Σ of positive terms, likewise."""
    parts = (slice(first, first + _CHUNK) for first in range(0, count, _CHUNK))
    return fsum(float(np.sum(terms(part))) for part in parts)


def _linear(force: Action, shift: Array | float) -> Residual:
    assert force.bound is not None
    n = force.value.shape[1]
    worst = max(abs(_total(row.__getitem__, n)) for row in force.value)
    bound = float(max(row.sum() for row in force.bound) + np.sum(shift))
    return _relative(worst, bound, float(force.size.sum()))


def _angular(
    state: State, force: Action, shift: Array | float, turn: Array | float
) -> Residual | None:
    """Σ x × F about the mean position."""
    if state.dim == 1 or state.cloud.period is not None:
        return None
    assert force.bound is not None
    x, value, error, sizes = state.cloud.x, force.value, force.bound, force.size
    middle, n = x.mean(axis=1)[:, None], state.cloud.count
    push, couple = np.broadcast_to(shift, (n,)), np.broadcast_to(turn, (n,))
    planes = [(0, 1)] if state.dim == 2 else [(1, 2), (2, 0), (0, 1)]
    worst = bound = size = 0.0
    for i, j in planes:

        def torque(part: slice, i: int = i, j: int = j) -> Array:
            arm = x[:, part] - middle
            return np.asarray(arm[i] * value[j, part] - arm[j] * value[i, part])

        def whole(part: slice, i: int = i, j: int = j) -> Array:
            span = np.abs(x[:, part] - middle)
            return np.asarray(span[i] * sizes[j, part] + span[j] * sizes[i, part])

        def off(part: slice, i: int = i, j: int = j) -> Array:
            span = np.abs(x[:, part] - middle)
            # of the arm, and of the product with it
            rounded = 4.0 * UNIT * span + UNIT * np.abs(x[:, part])
            total = span[i] * (error[j, part] + push[part])
            total += span[j] * (error[i, part] + push[part])
            total += rounded[i] * sizes[j, part] + rounded[j] * sizes[i, part]
            return np.asarray(total + couple[part])

        worst = max(worst, abs(_total(torque, n)))
        size += _sum(whole, n)
        bound = max(bound, _sum(off, n))
    return _relative(worst, bound, size)


def _energy(state: State, force: Action, rate: Action, velocity: Array) -> Residual:
    assert force.bound is not None
    assert rate.bound is not None
    weight, n = state.per_square * state.pressure, state.cloud.count

    def both(one: Array, other: Array, size: bool) -> Callable[[slice], Array]:
        """v·one and (mP/ρ²)·other, or their sizes."""

        def terms(part: slice) -> Array:
            v, w = velocity[:, part], weight[part]
            if size:
                v, w = np.abs(v), np.abs(w)
            return np.concatenate([v * one[:, part], w * other[:, part]])

        return terms

    size = _sum(both(force.size, rate.size, True), n)
    bound = _sum(both(force.bound, rate.bound, True), n) + 8.0 * UNIT * size
    return _relative(abs(_total(both(force.value, rate.value, False), n)), bound, size)


def _relative(value: float, bound: float, size: float) -> Residual:
    if size == 0.0:
        return Residual(0.0, 0.0)
    return Residual(value / size, bound * (1.0 + 1e-9) / size)


def combinations(
    forms: Sequence[str], rules: Sequence[str], varying: bool
) -> Iterator[tuple[str, str]]:
    """Every form with every rule that it goes with, of those asked for (none: all)."""
    for name in forms or FORMS:
        _require(name, FORMS[name].rules(False)[0] if name in FORMS else "")
        for rule in FORMS[name].rules(varying):
            if not rules or rule in rules:
                yield name, rule
