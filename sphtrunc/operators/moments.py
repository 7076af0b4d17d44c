"""Moments: the Taylor coefficients of an estimate, the one type that theory and experiment return.

⟨D A⟩ = Σ_α (h^{|α|−k}/α!) M_α A^{(α)}, k the number of derivatives in D, so the truncation error is
Σ_α (h^{|α|−k}/α!) (M_α − M_α^exact) A^{(α)}.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import factorial, prod
from typing import Any

MultiIndex = tuple[int, ...]


def multi_indices(dim: int, degree: int) -> Iterator[MultiIndex]:
    """All multi-indices of `dim` entries with |α| <= degree, by degree and then by axis.

    >>> list(multi_indices(2, 1))
    [(0, 0), (1, 0), (0, 1)]
    """
    for n in range(degree + 1):
        for axes in combinations_with_replacement(range(dim), n):
            yield tuple(axes.count(i) for i in range(dim))


def unit(dim: int, axis: int, n: int = 1) -> MultiIndex:
    """n e_axis: the multi-index with n at `axis` and 0 elsewhere."""
    return tuple(n * (i == axis) for i in range(dim))


def add(a: MultiIndex, b: MultiIndex) -> MultiIndex:
    """a + b, entry by entry."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def label(alpha: MultiIndex) -> str:
    """The multi-index as a key of a JSON object: "1" in 1D, "1,0,0" in 3D."""
    return ",".join(str(n) for n in alpha)


@dataclass(frozen=True)
class Moments:
    """Discrete moments M_α of an estimate, or their continuous limit.

    values: multi-index -> exact number, SymPy expression, float or array over targets
    exact: the values of an estimate without error; indices that are missing count as 0
    derivatives: the number k of derivatives that the estimate stands for
    provenance: how the values came about ("derived", "measured", …)
    """

    values: Mapping[MultiIndex, Any]
    exact: Mapping[MultiIndex, Any]
    derivatives: int
    provenance: str

    def __getitem__(self, alpha: int | MultiIndex) -> Any:
        return self.values[(alpha,) if isinstance(alpha, int) else alpha]

    @property
    def error(self) -> dict[MultiIndex, Any]:
        """M_α − M_α^exact for every α."""
        return {a: m - self.exact.get(a, 0) for a, m in self.values.items()}

    def taylor(self) -> dict[MultiIndex, Any]:
        """The error as coefficients of h^{|α|−k} A^{(α)}: (M_α − M_α^exact)/α!."""
        return {a: e / prod(factorial(n) for n in a) for a, e in self.error.items()}

    def leading(self) -> MultiIndex | None:
        """The first α, by degree, whose error is not exactly zero; None if there is none.

        Raises ValueError for floats, of which no order can be read off.
        """
        for a, e in self.error.items():
            if hasattr(e, "dtype") or isinstance(e, float):
                raise ValueError("moments: an order is read off exact numbers, these are floats")
            if e != 0:
                return a
        return None

    @property
    def order(self) -> int | None:
        """The power of h of the leading error, |α| − k; None where no error is left."""
        alpha = self.leading()
        return None if alpha is None else sum(alpha) - self.derivatives

    def __sub__(self, other: Moments) -> dict[MultiIndex, Any]:
        """Difference of the moments that both have: measured − derived."""
        return {a: m - other.values[a] for a, m in self.values.items() if a in other.values}

    def to_dict(self) -> dict[str, str]:
        """Multi-index, as text, to the value as text (exact numbers stay exact)."""
        return {label(a): str(m) for a, m in self.values.items()}

    def to_json(self) -> str:
        """`to_dict` as JSON."""
        return json.dumps(self.to_dict(), indent=1)

    def to_latex(self) -> str:
        r"""One line per moment, for an amsmath `aligned`."""
        from sympy import latex

        rows = [rf"M_{{{label(a)}}} &= {latex(m)}" for a, m in self.values.items()]
        return "\\begin{aligned}\n" + " \\\\\n".join(rows) + "\n\\end{aligned}"

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self.to_latex()}$"
