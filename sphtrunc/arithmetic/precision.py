"""The levels of precision by name: plain, compensated, extended, exact."""

from __future__ import annotations

from typing import Any

from sphtrunc.arithmetic.bounded import Bounded
from sphtrunc.arithmetic.extended import Extended
from sphtrunc.arithmetic.plain import Compensated, Plain

PRECISIONS = ("plain", "compensated", "extended", "exact")


def arithmetic(precision: str, bound: bool = False) -> Any:
    """The arithmetic of a precision level, with a bound if asked for."""
    from sphtrunc.arithmetic.bounded import Bounded
    from sphtrunc.arithmetic.exact import Exact

    made: dict[str, Any] = {
        "plain": Plain(),
        "compensated": Compensated(),
        "extended": Extended(),
        "exact": Exact(),
    }
    if precision not in made:
        raise ValueError(f"precision: got {precision!r}, expected one of {', '.join(PRECISIONS)}")
    if not bound:
        return made[precision]
    if precision not in ("plain", "compensated"):
        raise ValueError(f"bound: bounds the precisions plain and compensated, not {precision}")
    return Bounded(made[precision])


def for_volumes(number: Any) -> Any:
    """In which volumes are summed, of whatever digits or bounds `number` wants beside them."""
    return number if number.wide else Bounded(Plain()) if number.bounded else Plain()
