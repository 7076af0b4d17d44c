"""Fields: what the operators are applied to, evaluated from the offset to the target.

Fields have `own`, what is drawn for a target; `at`, a `Sample` around it; and `between`, the
difference A(s + t) − A(s) between two particles near it.

A_b − A_a is never the difference of two values: with x = k·s, a = sin φ, c = cos φ, a sinusoid has
A_b − A_a = 2 sin(x/2) [c cos(x/2) − a sin(x/2)], to the last digit however small h/λ is. Lengths
are in units of h; the derivatives returned are with respect to s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import comb, factorial, pi, prod
from typing import Any, TypeAlias

import numpy as np

from sphtrunc.arithmetic.rational import exact
from sphtrunc.arithmetic.summation import Array
from sphtrunc.operators.moments import MultiIndex, multi_indices
from sphtrunc.scenes.neighbourhood import Neighbourhood
from sphtrunc.scenes.random_numbers import Indices, uniform01


@dataclass(frozen=True)
class Sample:
    """A scalar field around T targets.

    difference: (N, T) A_b − A_a, in the arithmetic asked for; or half of A(s) − A(−s), the odd
        part of the field
    own: (T,) A_a, likewise
    derivatives: multi-index -> (T,) exact derivative at the target, or None where unknown
    """

    difference: Any
    own: Any
    derivatives: Mapping[MultiIndex, Any] | None


@dataclass(frozen=True)
class Sinusoid:
    """A = sin(φ + k·s), |k| = 2π h/λ, φ uniform at random for every target."""

    h_over_lambda: float
    direction: tuple[float, ...]

    def amplitude(self, derivatives: int) -> float:
        """The largest derivative of this order."""
        return float(np.linalg.norm(self.wave())) ** derivatives

    def wave(self) -> Array:
        """k in units of 1/h; the field is defined by these floats."""
        n = np.array(self.direction)
        return np.asarray(2.0 * pi * self.h_over_lambda * (n / np.linalg.norm(n)))

    def own(self, target: Indices, seed: int, component: int = 0) -> tuple[Array, Array]:
        """sin φ and cos φ, (T,); component: of a vector, each has a phase of its own."""
        phi = 2.0 * pi * uniform01(target.astype(np.uint64), seed, 200 + component)
        return np.sin(phi), np.cos(phi)

    def _phase(self, number: Any, s: list[Any], part: float = 1.0) -> Any:
        """k·s, or a part of it."""
        return sum(number.number(part * k) * x for k, x in zip(self.wave(), s, strict=True))

    def _difference(self, number: Any, s: list[Any], a: Any, c: Any, odd: bool = False) -> Any:
        sine, cosine = number.sincos(self._phase(number, s, 0.5))
        return 2 * (sine * (c * cosine if odd else c * cosine - a * sine))

    def between(self, number: Any, s: list[Any], t: list[Any], own: Any, pair: Any) -> Any:
        """A(s + t) − A(s)."""
        a, c = number.number(own[0]), number.number(own[1])
        sine, cosine = number.sincos(self._phase(number, s))
        return self._difference(number, t, a * cosine + c * sine, c * cosine - a * sine)

    def at(
        self,
        number: Any,
        block: Neighbourhood,
        s: list[Any],
        own: tuple[Any, Any],
        odd: bool = False,
    ) -> Sample:
        """Sample for given sin φ and cos φ; the odd part is cos φ sin k·s."""
        k = self.wave()
        a, c = number.number(own[0]), number.number(own[1])
        difference = self._difference(number, s, a, c, odd)
        derivatives = {}
        for mu in multi_indices(len(k), 2):
            n = sum(mu)
            value = [a, c, -a][n]
            for k_i, m in zip(k, mu, strict=True):
                for _ in range(m):
                    value = value * number.number(k_i)
            derivatives[mu] = value
        return Sample(difference, a, derivatives)


@dataclass(frozen=True)
class Polynomial:
    """A = Σ c_α s^α in the offset from the target."""

    coefficients: Mapping[MultiIndex, float]

    def own(self, target: Indices, seed: int, component: int = 0) -> None:
        """Nothing is drawn."""

    def amplitude(self, derivatives: int) -> float:
        """The largest derivative of this order at the target, or 1 if they are all zero."""
        values = [
            abs(c) * prod(factorial(n) for n in a)
            for a, c in self.coefficients.items()
            if sum(a) == derivatives
        ]
        return max(values, default=0.0) or 1.0

    def between(self, number: Any, s: list[Any], t: list[Any], own: Any, pair: Any) -> Any:
        """A(s + t) − A(s) = Σ c_α Σ_{0 < β <= α} C(α, β) s^{α−β} t^β."""
        total: Any = 0 * t[0] * (0 * s[0])
        for alpha, c in self.coefficients.items():
            for beta in product(*(range(n + 1) for n in alpha)):
                if not any(beta):
                    continue
                ways = prod(comb(n, m) for n, m in zip(alpha, beta, strict=True))
                term = number.number(c) * ways
                for s_i, t_i, n, m in zip(s, t, alpha, beta, strict=True):
                    for factor in (*[s_i] * (n - m), *[t_i] * m):
                        term = term * factor
                total = total + term
        return total

    def at(
        self, number: Any, block: Neighbourhood, s: list[Any], own: Any, odd: bool = False
    ) -> Sample:
        """Sample; the same at every target."""
        difference, at_target = 0 * s[0], 0.0
        for alpha, c in self.coefficients.items():
            if sum(alpha) == 0:
                at_target += c
                continue
            if odd and sum(alpha) % 2 == 0:
                continue
            term = number.number(c)
            for s_i, n in zip(s, alpha, strict=True):
                for _ in range(n):
                    term = term * s_i
            difference = difference + term
        derivatives = {
            mu: number.number(
                self.coefficients.get(mu, 0.0) * float(prod(factorial(n) for n in mu))
            )
            for mu in multi_indices(len(s), 2)
        }
        return Sample(difference, number.number(at_target), derivatives)


@dataclass(frozen=True)
class Bump:
    """A = exp(−|x|²/2w²), seen from a random place within 2w of its middle; w in units of h."""

    width: float
    dim: int

    def amplitude(self, derivatives: int) -> float:
        """The largest derivative of this order along a line through the middle."""
        return float([1.0, np.exp(-0.5), 1.0][derivatives] / self.width**derivatives)

    def own(self, target: Indices, seed: int, component: int = 0) -> Array:
        """x/w of the targets, (d, T)."""
        draws = [
            uniform01(target.astype(np.uint64), seed, 300 + 3 * component + i)
            for i in range(self.dim)
        ]
        return np.stack([4.0 * u - 2.0 for u in draws])

    def _steps(self, s: list[Any], x: list[Any]) -> tuple[Any, Any]:
        """x·z and |z|²/2 for z = s/w: A falls by the exponential of their sum on the way from x."""
        if not isinstance(s[0], np.ndarray) or s[0].dtype == object:
            raise ValueError(
                "field: a bump is evaluated in plain or compensated precision, no bound"
            )
        z = [s_i / self.width for s_i in s]
        along = sum(z_i * x_i for z_i, x_i in zip(z, x, strict=True))
        return along, 0.5 * sum(z_i * z_i for z_i in z)

    def between(self, number: Any, s: list[Any], t: list[Any], own: Any, pair: Any) -> Any:
        """A(s + t) − A(s); plain and compensated arithmetic only."""
        x = [x_i + s_i / self.width for x_i, s_i in zip(own, s, strict=True)]
        along, half = self._steps(t, x)
        return np.exp(-0.5 * sum(x_i * x_i for x_i in x)) * np.expm1(-(along + half))

    def at(
        self, number: Any, block: Neighbourhood, s: list[Any], own: Any, odd: bool = False
    ) -> Sample:
        """Sample around the places x/w in `own`; plain and compensated arithmetic only."""
        along, half = self._steps(s, own)
        value = np.exp(-0.5 * sum(x_i * x_i for x_i in own))
        derivatives = {}
        for mu in multi_indices(len(s), 2):
            factor: Any = 1.0
            for x_i, n in zip(own, mu, strict=True):
                factor = factor * [1.0, -x_i, x_i * x_i - 1.0][n]
            derivatives[mu] = value * factor / self.width ** sum(mu)
        rest = np.expm1(-(along + half))
        if odd:  # −e^{−half} sinh along, which would overflow
            size = np.abs(along)
            rest = 0.5 * np.sign(along) * np.exp(size - half) * np.expm1(-2.0 * size)
        return Sample(value * rest, value, derivatives)


@dataclass(frozen=True, eq=False)
class Values:
    """Values on explicit particles, (n,), with exact derivatives at them where they are known."""

    values: Array
    derivatives: Mapping[MultiIndex, Array] | None = None

    def own(self, target: Indices, seed: int, component: int = 0) -> None:
        """Nothing is drawn."""

    def amplitude(self, derivatives: int) -> float:
        """The largest exact derivative known, or 1."""
        known = self.derivatives or {}
        sizes = [float(np.abs(v).max()) for mu, v in known.items() if sum(mu) == derivatives]
        return max(sizes, default=0.0) or 1.0

    def between(self, number: Any, s: list[Any], t: list[Any], own: Any, pair: Any) -> Any:
        """A_c − A_b for the particles (c, b) of the pair."""
        c, b = pair
        return number.number(self.values[np.maximum(c, 0)]) - number.number(self.values[b])

    def at(
        self, number: Any, block: Neighbourhood, s: list[Any], own: Any, odd: bool = False
    ) -> Sample:
        """Sample; differences of the values given, which have no odd part."""
        assert block.particle is not None
        assert not odd
        b = number.number(self.values[np.maximum(block.particle, 0)])
        a = number.number(self.values[block.target])
        derivatives = None
        if self.derivatives is not None:
            derivatives = {
                mu: v[block.target] * block.h ** sum(mu) for mu, v in self.derivatives.items()
            }
        return Sample(b - a, a, derivatives)


Field: TypeAlias = Sinusoid | Polynomial | Bump | Values


def sinusoid(h_over_lambda: object, direction: object = None, dim: int = 1) -> Sinusoid:
    """A unit sinusoid of wavelength λ along `direction` (default: the first axis).

    Raises ValueError for h/λ that is not positive and finite or a direction without length.
    """
    ratio = float(exact(h_over_lambda, "h_over_lambda"))
    if not 1e-200 < ratio < 1e3:
        raise ValueError(
            f"h_over_lambda: got {ratio:g}, expected a ratio h/λ above 0 and below 1000"
        )
    if direction is None:
        direction = (1.0,) + (0.0,) * (dim - 1)
    n = np.asarray(direction, dtype=np.float64)
    if n.shape != (dim,) or not np.all(np.isfinite(n)) or not np.any(n):
        raise ValueError(f"direction: expected {dim} finite numbers, not all of them zero")
    return Sinusoid(ratio, tuple(n.tolist()))


def polynomial(coefficients: Mapping[MultiIndex, float], dim: int) -> Polynomial:
    """Σ c_α s^α; keys are multi-indices of `dim` entries.

    Raises ValueError for keys or coefficients that are not what they should be.
    """
    for alpha, c in coefficients.items():
        if len(alpha) != dim or any(n < 0 or n > 40 for n in alpha) or not np.isfinite(c):
            raise ValueError(
                f"field: got {c} for {alpha}, expected finite coefficients of multi-indices of"
                f" {dim} entries from 0 to 40"
            )
    return Polynomial({a: float(c) for a, c in coefficients.items()})


def field(spec: str, dim: int) -> Field:
    """A field from its text: "sinusoid:h/λ[:nx,ny,nz]", "bump:w" or "polynomial:2 x^2 y - 1".

    A polynomial is a sum of terms, each a decimal number and powers of x, y, z (offsets from the
    target in units of h). Raises ValueError for anything else.
    """
    kind, _, rest = spec.strip().partition(":")
    if kind == "sinusoid":
        ratio, _, along = rest.partition(":")
        direction = [float(exact(v, "direction")) for v in along.split(",")] if along else None
        return sinusoid(ratio, direction, dim)
    if kind == "bump":
        width = float(exact(rest, "field"))
        if not 1e-3 <= width <= 1e9:
            raise ValueError(f"field: got a bump of width {width:g}, expected 0.001 to 1e9 (in h)")
        return Bump(width, dim)
    if kind == "polynomial":
        return polynomial(_terms(rest, dim), dim)
    raise ValueError(
        f"field: got {spec[:60]!r}, expected sinusoid:h/λ, bump:width or polynomial:terms"
    )


def _terms(text: str, dim: int) -> dict[MultiIndex, float]:
    """Coefficients from "1 + 2 x^2 y - z"."""
    import re

    if len(text) > 1000:
        raise ValueError("field: a polynomial of at most 1000 characters is expected")
    result: dict[MultiIndex, float] = {}
    term = r"([+-]?)((?:\d+\.?\d*|\.\d+)?)((?:[*]?[xyz](?:\^\d{1,2})?)*)"
    compact = re.sub(r"\s+", "", text)
    kept = [found for found in re.findall(term, compact) if found[1] or found[2]]
    signed = all(sign for sign, _, _ in kept[1:])
    if not kept or not signed or "".join(map("".join, kept)) != compact:
        raise ValueError(f"field: cannot read the polynomial {text[:60]!r}; example: 1 + 2 x^2 y")
    for sign, number, powers in kept:
        alpha = [0] * 3
        for letter, power in re.findall(r"([xyz])(?:\^(\d+))?", powers):
            alpha["xyz".index(letter)] += int(power or 1)
        if any(alpha[dim:]):
            raise ValueError(f"field: {powers.strip()} has a variable that {dim}D does not have")
        key = tuple(alpha[:dim])
        value = float(number or 1) * (-1.0 if sign == "-" else 1.0)
        result[key] = result.get(key, 0.0) + value
    return result
