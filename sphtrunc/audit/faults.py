"""The classes of fault; a fault says what it is here, how surely, and what else it may be."""

from __future__ import annotations

from dataclasses import dataclass

HALF_RANGE = "half-range integral"
POWER_OF_SUPPORT = "wrong power of the support"
POWER_OF_H = "wrong power of h"
NOT_SIMILAR = "not a function of r/h"
OTHER_DIMENSION = "constant of another dimension"
TRUNCATION = "truncated range"
CUT = "cut support"
MISPRINT = "misprint"
INTEGER_DIVISION = "integer division"
OTHER_DERIVATIVE = "derivative of another kernel"
OTHER_FUNCTION = "another function of the kernel"
MISSING_Q = "missing factor q"
SURPLUS_Q = "factor q too many"
CONVENTION = "convention mismatch"
SINGLE_PRECISION = "single precision"
ROUNDED = "rounded constant"
OTHER_CONSTANT = "constant of another kernel"
OTHER_FORM = "constant of another form"
RECIPROCAL = "reciprocal constant"
FACTOR_PI = "factor of pi"
SIGN = "wrong sign"
WRONG_CONSTANT = "wrong constant"
WRONG_DERIVATIVE = "wrong derivative"
DISCONTINUOUS = "discontinuous"
MIXED = "another kernel than the other sums"


@dataclass(frozen=True)
class Fault:
    """A class of fault, and in words what it is here.

    surely: what was tried and how many explanations remain; also: the others, likeliest first
    """

    kind: str
    message: str
    surely: str = ""
    also: tuple[str, ...] = ()
