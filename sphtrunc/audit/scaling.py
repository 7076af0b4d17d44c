"""How W and its derivatives depend on h: W ∝ h^−d, dW/dr ∝ h^−(d+1), d²W/dr² ∝ h^−(d+2) at fixed q.

Values come scaled by those powers (see `samples.Scaled`), so that of a right kernel they are the
same for every h; what is left over, h^p, is the fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sphtrunc.audit import faults
from sphtrunc.audit.faults import Fault
from sphtrunc.audit.samples import Array, Samples, Scaled

WHAT = ("W", "dW", "d²W")
RELEVANT = 1e-2  # of the largest value: below, rounding and interpolation are what one sees
#: powers that codes mistake are whole or half numbers: what is closer to one than this is that one
NEAR = 0.1
INTERPOLATED = 0.1  # how far values taken between the rows of a table may be off, relatively
CALLED = 1e-3  # the same at equal q, of values of which the smallest are RELEVANT: single precision


@dataclass(frozen=True)
class Scaling:
    """What was seen of one of W, dW, d²W (order 0, 1, 2).

    power: the power of h, or None where it is none; expected: the right one
    lengths: the h that were looked at; where: a q and an h at which it is no power
    """

    order: int
    power: float | None
    expected: int
    lengths: tuple[float, ...]
    where: tuple[float, float] | None = None

    @property
    def right(self) -> bool:
        """Whether it is the right power."""
        return self.power == self.expected

    @property
    def surplus(self) -> float:
        """How much the power exceeds the right one; 0 where there is none."""
        return 0.0 if self.power is None else self.power - self.expected

    def said(self) -> str:
        """W ∝ h^−3."""
        if self.power is None:
            return f"{WHAT[self.order]} no power of h"
        return f"{WHAT[self.order]} ∝ h^{_signed(self.power)}"


def scalings(samples: Samples, dim: int) -> tuple[Scaling, ...]:
    """The power of h in W, dW and d²W, as far as there are two smoothing lengths to see it."""
    first, *others = samples.scaled or (None,)
    if first is None or not others:
        return ()
    found = []
    for order in range(3):
        if _values(first, order) is not None:
            found.append(_scaling(first, others, order, dim))
    return tuple(found)


def _scaling(first: Scaled, others: list[Scaled], order: int, dim: int) -> Scaling:
    expected = -(dim + order)
    lengths = tuple(sorted([first.h, *(one.h for one in others)]))
    powers: list[float] = []
    for one in others:
        seen = _surplus(first, one, order)
        if isinstance(seen, tuple):
            return Scaling(order, None, expected, lengths, seen)
        powers.append(seen)
    typical = float(np.median(powers))
    slacks = [_tolerance(first, one) / abs(math.log(one.h / first.h)) for one in others]
    for one, power, slack in zip(others, powers, slacks, strict=True):
        if abs(power - typical) > 2 * slack:
            return Scaling(order, None, expected, lengths, (0.0, one.h))
    simple = round(2 * typical) / 2
    surplus = simple if abs(simple - typical) < max(NEAR, min(slacks)) else typical
    return Scaling(order, expected + surplus, expected, lengths)


def _surplus(first: Scaled, one: Scaled, order: int) -> float | tuple[float, float]:
    """p of the h^p by which two smoothing lengths differ; or (q, h) where no factor is common."""
    reference, values = _at(first, one.q, order), _values(one, order)
    assert values is not None
    top = float(np.max(np.abs(reference)))
    big = (np.abs(reference) > RELEVANT * top) & (one.q > 0)
    if not np.any(big):
        return 0.0
    ratio = values[big] / reference[big]
    middle = float(np.median(ratio))
    if not middle > 0:
        return (float(one.q[big][int(np.argmin(ratio))]), one.h)
    tolerance = _tolerance(first, one)
    room = tolerance * np.maximum(np.abs(reference), RELEVANT * top)
    room = middle * (room + _blur(first, one.q, order)) + _blur(one, one.q, order)
    off = np.abs(values - middle * reference) > room
    if np.count_nonzero(off) > (0 if tolerance == CALLED else len(off) // 8):
        return (float(one.q[int(np.argmax(np.abs(values - middle * reference)))]), one.h)
    return math.log(middle) / math.log(one.h / first.h)


def _tolerance(first: Scaled, one: Scaled) -> float:
    return CALLED if _same(one.q, first.q) else INTERPOLATED


def _same(a: Array, b: Array) -> bool:
    return a.shape == b.shape and bool(np.all(np.abs(a - b) <= 1e-12 * np.abs(b)))


def _values(one: Scaled, order: int) -> Array | None:
    return (one.w, one.dw, one.d2w)[order]


def _at(first: Scaled, q: Array, order: int) -> Array:
    """The values of the first smoothing length at q: there, or by straight lines between rows."""
    values = _values(first, order)
    assert values is not None
    return values if _same(q, first.q) else np.interp(q, first.q, values, right=0.0)


def _blur(one: Scaled, q: Array, order: int) -> Array:
    """What the decimals leave open, at q."""
    error = (one.error, one.derivative_error, one.second_error)[order]
    return error if _same(q, one.q) else np.interp(q, one.q, error)


def explain_scaling(order: int, seen: Sequence[Scaling]) -> list[Fault]:
    """What is wrong with the power of h in W, dW or d²W; nothing where W has the same surplus."""
    found = []
    for one in seen:
        if one.order != order or one.right:
            continue
        if one.power is None:
            found.append(_no_power(one))
        elif order == 0 or not any(s.order == 0 and s.surplus == one.surplus for s in seen):
            likewise = [s for s in seen if order == 0 and s.order and s.surplus == one.surplus]
            found.append(_wrong_power(one, likewise))
    return found


def _no_power(one: Scaling) -> Fault:
    q, h = one.where or (0.0, 0.0)
    lengths = ", ".join(f"{x:g}" for x in one.lengths)
    if not q:
        return Fault(
            faults.POWER_OF_H,
            f"{WHAT[one.order]} is no power of h at fixed r/h, looked at for h = {lengths};"
            f" it should be h^{one.expected}",
        )
    return Fault(
        faults.NOT_SIMILAR,
        f"{WHAT[one.order]} is not h^{one.expected} times a function of r/h: at h = {h:g} it"
        f" differs from that near q = {q:.4g}; is a length written there that is no multiple of h?",
        f"looked at for h = {lengths}",
    )


def _wrong_power(one: Scaling, likewise: Sequence[Scaling]) -> Fault:
    assert one.power is not None
    name = WHAT[one.order]
    hint = ""
    if one.order and one.surplus == 1:
        hint = "; did you return dW/dq?" if one.order == 1 else "; is one factor 1/h missing?"
    elif one.order == 2 and one.surplus == 2:
        hint = "; did you return d²W/dq²?"
    elif one.order and one.surplus == -1:
        hint = "; is 1/h multiplied once too often?"
    elif one.order == 0 and one.power in (-1, -2, -3):
        hint = f"; {_signed(one.power)} is that of {-one.power:g}D"
    elif one.order == 0 and one.power == 0:
        hint = "; is the factor 1/h^d missing?"
    also = "".join(f", in {WHAT[s.order]} likewise {_signed(s.power)}" for s in likewise)
    lengths = ", ".join(f"{x:g}" for x in one.lengths)
    return Fault(
        faults.POWER_OF_H,
        f"power of h in {name}: {_signed(one.power)}, should be {_signed(one.expected)}"
        f"{also}{hint}",
        f"seen at h = {lengths}" if lengths else "as it is written",
    )


def _signed(power: float | None) -> str:
    return "none" if power is None else f"{power:.4g}".replace("-", "−")
