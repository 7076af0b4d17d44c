"""Rules for a smoothing length that varies: whose h the kernel of a pair takes.

gather: h_a of the target; scatter: h_b of the neighbour; mean: (h_a + h_b)/2; mean-kernel: the mean
of the kernels of both (Hernquist & Katz 1989, doi:10.1086/191344). Forces have two more, in which
each end of a pair sees its own: no-omega and, with the terms of ∂W/∂h, grad-h (Springel & Hernquist
2002, doi:10.1046/j.1365-8711.2002.05445.x).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

#: rules that a sum can take
RULES = ("gather", "scatter", "mean", "mean-kernel")

Sides = tuple[tuple[str, float], ...]  # particles whose h the kernel takes, each with its share

_A: Sides = (("a", 1.0),)
_B: Sides = (("b", 1.0),)
_MEAN: Sides = (("mean", 1.0),)
_BOTH: Sides = (("a", 0.5), ("b", 0.5))

#: rule: sides of the gradients K_a and K_b that the two ends of a force see
FORCE_RULES: dict[str, tuple[Sides, Sides]] = {
    "constant": (_MEAN, _MEAN),
    "gather": (_A, _A),
    "scatter": (_B, _B),
    "mean": (_MEAN, _MEAN),
    "mean-kernel": (_BOTH, _BOTH),
    "no-omega": (_A, _B),
    "grad-h": (_A, _B),
}


def slope_share(rule: str) -> Fraction:
    """What of the slope of h the rule's largest kernel sees."""
    return {"gather": Fraction(0), "mean": Fraction(1, 2)}.get(rule, Fraction(1))


def require_rule(rule: object) -> None:
    """Raises ValueError for a rule that there is not."""
    if rule not in RULES:
        raise ValueError(f"h-rule: got {rule!r}, expected one of {', '.join(RULES)}")


def require_support(support: Fraction | None, gradient: Sequence[Fraction], rule: str) -> None:
    """Raises ValueError where a neighbour's support has no end: |g|κ >= 1 for h = h_a (1 + g·s),
    or no support at all (None)."""
    share = slope_share(rule)
    if not share or not any(gradient):
        return
    if support is None:
        raise ValueError(
            "h-gradient: the kernel has no edge, so that h(x) = 0 is inside its support; expected"
            " a kernel of compact support, or the rule gather"
        )
    steep = sum(g * g for g in gradient)
    if steep * (share * support) ** 2 >= 1:
        raise ValueError(
            f"h-gradient: got |g| = {float(steep) ** 0.5:g} with a support of {support} h, expected"
            f" |g| below {1 / (share * support)}: from there on h grows as fast as the distance,"
            " and a support has no end"
        )
