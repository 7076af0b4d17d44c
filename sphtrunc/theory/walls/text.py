"""The text of a derivation beside a wall."""

from __future__ import annotations

from collections.abc import Mapping
from math import factorial, prod
from typing import TYPE_CHECKING, Any

from sphtrunc.operators.moments import MultiIndex
from sphtrunc.theory.typeset import (
    _h,
    _kernel_text,
    _number,
    _plain,
    _power,
    _product,
    _signed,
    _sub,
    _table_text,
    _title,
    _wrapped,
)
from sphtrunc.theory.walls.derivation import BEYOND
from sphtrunc.theory.walls.remedies import named

if TYPE_CHECKING:
    from sympy import Expr

    from sphtrunc.theory.derivation import Derivation

PLACED = {"particle": "at a plane of particles", "half-way": "half-way between planes of particles"}


def text(d: Derivation) -> str:
    """As `typeset.text`: the kernel, the wall and its errors, the moments at a ratio."""
    table = _table_text(d) if d.discrete is not None else ""
    return "\n\n".join(block for block in (_kernel_text(d), _wall_text(d), table) if block)


def _wall_text(d: Derivation) -> str:
    """Where the wall is, the moments of what it leaves, and the error; at most 100 columns."""
    view = d.wall
    assert view is not None
    if view.wall is None:
        head = "A plane wall, normal to the first axis, at η h from the target"
    else:
        head = f"A plane wall, normal to the first axis, at {view.wall.eta} h from the target"
    lines = [head, f"  beyond it: {BEYOND[view.ghosts]}"]
    if view.wall is None:
        return "\n".join([*lines, *_intervals(d)])
    if view.at is not None:
        lines.append(f"  {PLACED.get(view.at, f'{view.at} of a step before a plane of particles')}")
    moments = [f"m{_sub(k)} = {_number(m)}" for k, m in view.kernel_moments.items() if k < 4]
    lines += _wrapped(moments, "  what is left of the kernel, ∫ sⁿ Ŵ: ", "   ")
    order = d.orders
    terms = [
        _signed(_product(c, [_h(sum(alpha) - d.operator.derivatives), named(alpha)]))
        for alpha, c in leading_terms(d).items()
    ]
    head = f"Error of the {_title(d.operator)}, {d.dim}D: "
    head += f"order h{_power(order.smoothing)}" if order.smoothing else "it does not vanish with h"
    lines += ["", head]
    lines += _wrapped([*terms, "+ …"], "  error = ", " ") if terms else []
    if order.generic is not None:
        lines.append(
            "  the place of the wall in the lattice adds errors of order"
            f" (Δx/h){_power(order.generic)}"
        )
        if order.aligned is not None and order.aligned != order.generic:
            lines.append(
                f"  and of order (Δx/h){_power(order.aligned)} where it is half-way, or at"
                " particles of which half counts"
            )
    return "\n".join(lines)


def leading_terms(d: Derivation) -> Mapping[MultiIndex, Any]:
    """The coefficients of the two lowest degrees that have any, α -> (M_α − exact)/α!."""
    taylor = {a: e / prod(factorial(n) for n in a) for a, e in d.limit.error.items() if e != 0}
    degrees = sorted({sum(a) for a in taylor})[:2]
    return {a: c for a, c in taylor.items() if sum(a) in degrees}


def _polynomial(value: Expr) -> str:
    return _plain(value).replace("eta", "η")


def _intervals(d: Derivation) -> list[str]:
    assert d.wall is not None
    lines = []
    for i, (low, high, moments) in enumerate(d.wall.pieces):
        lines += ["", f"{low} ≤ η ≤ {high}, m{_sub(0)} … the moments ∫ sⁿ Ŵ of what is left"]
        for k, pieces in d.wall.kernel_moments.items():
            lines += _wrapped([_polynomial(pieces[i][2])], f"  m{_sub(k)} = ", " ")
        for alpha, value in moments.items():
            if value != 0 or d.dim == 1:
                label = ",".join(map(str, alpha))
                lines += _wrapped([_polynomial(value)], f"  M_{label} = ", " ")
    return lines
