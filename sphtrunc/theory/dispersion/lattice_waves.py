"""Sums of a kernel over a lattice that carries a plane wave of displacements.

For the wave ξ exp(ik·X), r over the neighbours of a particle and any weights g (a vector) and H (a
tensor) of the neighbour,

    vector    S = Σ g sin k·r            tensor    T = Σ H (1 − cos k·r) = Σ 2H sin²(k·r/2)

On a lattice with two particles in the cell S and T are blocks between sublattices, with
−i exp(ik·r) in place of the sine. Lengths are in h throughout.

Three arithmetics share the sums and everything that is made of them: float arrays over many waves;
polynomials in ζ = exp(2πi/n), where all phases are rational turns and all values of the kernel
rational; numbers of 50 digits elsewhere. A fourth, polynomials in kh, gives the series of long
waves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from math import lcm
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from sympy import QQ, Symbol, cyclotomic_poly
from sympy.polys.rings import ring

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.factors import factor_values
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.terms import CURVATURE, SLOPE, VALUE
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import KINDS, sites, units
from sphtrunc.theory.dispersion.brillouin import scale
from sphtrunc.theory.lattice_sums import _radial, _shells, real_context

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian

#: roots of unity up to this order are calculated with exactly
MOST_TURNS = 4096
#: rows of phases that a scan holds for each wave
MOST_NEIGHBOURS = 20_000
#: the power of kh up to which long waves are expanded
DEGREE = 6

#: what a `LatticeWaves` has made of its neighbours alone
_OF_NO_WAVE = ("squares", "gradient", "hessian")

_ring, _z = ring("z", QQ)


class Phases(NamedTuple):
    """How an arithmetic takes sin, cos and 1 − cos of the phase of a neighbour, and a fraction.

    The phase is given as a fraction of a half turn (or as the offset along the wave, for series).
    """

    sine: Callable[[Any], Any]
    cosine: Callable[[Any], Any]
    versine: Callable[[Any], Any]
    number: Callable[[Fraction], Any]


@dataclass(frozen=True, eq=False)
class LatticeWaves:
    """A lattice with a wave on it. Arrays of floats, or of exact numbers (dtype object).

    offsets: (M, d) of the neighbours of a particle, without itself, in h
    f0, f1, f2: (M,), the radial factors Ŵ, Ŵ′/q and (Ŵ″ − Ŵ′/q)/q²; home: Ŵ(0); with or without
        σ_d, which then is in `volume`, V/h^d
    sine, versine: (…, M), None where there is no wave yet
    other: (M,), on the other sublattice, None where there is only one
    count: 2 where one of each pair of neighbours at ±r is left out
    exact: whether the numbers are polynomials over ℚ
    """

    offsets: Any
    f0: Any
    f1: Any
    f2: Any
    home: Any
    volume: Any
    sine: Any = None
    versine: Any = None
    other: Any = None
    count: int = 1
    exact: bool = False

    def under(self, sine: Any, versine: Any) -> LatticeWaves:
        """The same lattice under other waves; the derivatives of the kernel are not made again."""
        waves = replace(self, sine=sine, versine=versine)
        waves.__dict__.update({name: getattr(self, name) for name in _OF_NO_WAVE})
        return waves

    @property
    def dim(self) -> int:
        """d."""
        return int(self.offsets.shape[1])

    @property
    def sites(self) -> int:
        """Particles in the primitive cell."""
        return 1 if self.other is None else 2

    @cached_property
    def squares(self) -> Any:
        """q², (M,)."""
        return (self.offsets * self.offsets).sum(axis=1)

    @property
    def _weight(self) -> Any:
        return self.volume * self.count

    @cached_property
    def gradient(self) -> Any:
        """∇Ŵ, (M, d)."""
        return self.f1[:, None] * self.offsets

    @cached_property
    def hessian(self) -> Any:
        """∇∇Ŵ, (M, d, d)."""
        s = self.offsets
        unit = np.eye(self.dim, dtype=int)
        return (
            self.f1[:, None, None] * unit + self.f2[:, None, None] * s[:, :, None] * s[:, None, :]
        )

    def total(self, weights: Any) -> Any:
        """V Σ g, any shape (M, …)."""
        return self._weight * weights.sum(axis=0)

    def vector(self, weights: Any) -> tuple[Any, Any]:
        """V S of weights (M, d), twice: as a matrix from the density of a site to the force on
        another, (…, nd, n), and from displacements to density, (…, n, nd)."""
        if self.other is None:
            s = self._weight * (self.sine @ weights)
            return s[..., :, None], s[..., None, :]
        same = self.sine[..., ~self.other] @ weights[~self.other]
        turn = self.sine[..., self.other] - 1j * (1 - self.versine[..., self.other])
        across = turn @ weights[self.other]
        rows = [[same, across], [np.conj(across), same]]
        out = np.concatenate([np.stack(row, axis=-1) for row in rows], axis=-2)
        into = np.stack([np.concatenate(row, axis=-1) for row in rows], axis=-2)
        return self.volume * out, self.volume * into

    def tensor(self, weights: Any) -> Any:
        """V T of weights (M, d, d), (…, nd, nd)."""
        d = self.dim
        flat = weights.reshape(len(weights), d * d)
        if self.other is None:
            t = self.versine @ flat
            return self._weight * t.reshape(*t.shape[:-1], d, d)
        here, there = ~self.other, self.other
        same = self.versine[..., here] @ flat[here] + flat[there].sum(axis=0)
        turn = 1 - self.versine[..., there] + 1j * self.sine[..., there]
        across = -(turn @ flat[there])
        blocks = [
            [x.reshape(*x.shape[:-1], d, d) for x in row]
            for row in ([same + 0j, across], [np.conj(across), same + 0j])
        ]
        return self.volume * np.block(blocks)

    def cosine_sum(self, weights: Any) -> Any:
        """V Σ g cos k·r, for one wave and one particle in the cell, any shape (M, …)."""
        flat = weights.reshape(len(weights), -1)
        return self._weight * ((1 - self.versine) @ flat).reshape(weights.shape[1:])

    def sine_sum(self, weights: Any) -> Any:
        """V Σ g sin k·r, likewise."""
        flat = weights.reshape(len(weights), -1)
        return self._weight * (self.sine @ flat).reshape(weights.shape[1:])


# --------------------------------------------------------------------------------- many waves


@lru_cache(maxsize=16)
def _around(kind: str, reach: float, staggered: bool) -> tuple[Any, Any, Any]:
    """Integer points m (d, M) by distance, positions (M, d) in Δx, and which lie on the other
    sublattice; of two neighbours at ±r one."""
    dim = KINDS[kind].dim
    m = sites(kind, reach, (Fraction(0),) * dim)
    rule = KINDS[kind].turned
    other = None if rule is None else np.asarray(rule(m))
    keep = np.any(m != 0, axis=0) | staggered
    if rule is None:
        first = np.zeros(m.shape[1])
        for row in m + 0.5 * staggered:
            first = np.where(first == 0, np.sign(row), first)
        keep &= first > 0
    place = m + 0.5 * staggered
    r = place.T * np.array([float(u) for u in units(kind)])
    order = np.flatnonzero(keep)
    if order.size > MOST_NEIGHBOURS:
        raise ValueError(
            f"dx-over-h: {order.size} neighbours or pairs of them are inside the support, at most"
            f" {MOST_NEIGHBOURS} are taken over a whole zone; expected a larger Δx/h"
        )
    order = order[np.argsort((r[order] ** 2).sum(axis=1), kind="stable")]
    return place[:, order], r[order], None if other is None else other[order]


class Scan:
    """Many waves on one lattice at any Δx/h: the phases are those of integer points, so they are
    taken once.

    kappa: (K, d), see `brillouin`; reach: the largest support/Δx that will be asked for
    staggered: the neighbours are the points midway between particles on a line, which move with the
        mean of their two
    """

    def __init__(self, kind: str, kappa: Any, reach: float, staggered: bool = False) -> None:
        self.kind, self.staggered, self.reach = kind, staggered, reach
        self.kappa = np.asarray(kappa, dtype=float)
        #: the last Δx/h, and the lattice at it, which other waves share
        self._last: list[tuple[Any, LatticeWaves]] = []
        m, self.r, self.other = _around(kind, reach, staggered)
        self.distance = np.sqrt((self.r**2).sum(axis=1))
        turns = self.kappa @ m  # in half turns
        turns -= 2 * np.rint(turns / 2)
        self.sine = np.sin(np.pi * turns)
        self.versine = 2 * np.sin(np.pi / 2 * turns) ** 2
        if staggered:  # 1 − cos(kΔx/2) cos k·r
            half = 2 * np.sin(np.pi / 4 * self.kappa) ** 2
            self.versine = half + (1 - half) * self.versine

    def of(self, kappa: Any) -> Scan:
        """Other waves on the same particles."""
        other = Scan(self.kind, kappa, self.reach, self.staggered)
        other._last = self._last
        return other

    @property
    def k(self) -> Any:
        """|k|Δx, (K,)."""
        return np.sqrt(((self.kappa * scale(self.kind)) ** 2).sum(axis=1))

    @property
    def direction(self) -> Any:
        """k/|k|, (K, d)."""
        return self.kappa * scale(self.kind) / self.k[:, None]

    def at(self, kernel: Kernel | Gaussian, ratio: float, volume: str) -> LatticeWaves:
        """The sums at Δx/h = ratio. volume: "summation", 1/ΣW, or "constant", Δx^d.

        Raises ValueError where the kernel reaches no neighbour.
        """
        given = (kernel, ratio, volume)
        if not self._last or self._last[0][0] != given:
            self._last[:] = [(given, self._still(*given))]
        still = self._last[0][1]
        n = len(still.offsets)
        return still.under(self.sine[:, :n], self.versine[:, :n])

    def _still(self, kernel: Kernel | Gaussian, ratio: float, volume: str) -> LatticeWaves:
        """The lattice without a wave."""
        dim = self.r.shape[1]
        n = int(np.searchsorted(self.distance, float(kernel.support) / ratio * (1 + 1e-15)))
        if n == 0:
            raise ValueError(_no_neighbours(f"{ratio:g}", kernel))
        s, q = ratio * self.r[:n], ratio * self.distance[:n]
        pair = 2 if self.other is None else 1
        f0, f1, f2 = (factor_values(kernel, k, q, dim) for k in (VALUE, SLOPE, CURVATURE))
        home = float(kernel.w(0.0, dim))
        density = home + pair * float(f0.sum())
        return LatticeWaves(
            offsets=s,
            f0=f0,
            f1=f1,
            f2=f2,
            home=home,
            volume=1 / density if volume == "summation" and not self.staggered else ratio**dim,
            other=None if self.other is None else self.other[:n],
            count=pair,
        )


def _no_neighbours(ratio: str, kernel: Kernel | Gaussian) -> str:
    return (
        f"dx-over-h: got {ratio}, and no neighbour is inside the support of {kernel.support}h;"
        " expected a smaller ratio (did you mean h/Δx?)"
    )


# ------------------------------------------------------------------------------------- one wave


@lru_cache(maxsize=64)
def turns(order: int) -> Phases:
    """Arithmetic in ℚ(ζ), ζ = exp(2πi/order), with 8 a divisor of the order: polynomials in ζ,
    which `reduced` brings to their normal form."""
    half, quarter = order // 2, 3 * order // 4  # −1, and −i = 1/i

    def power(turn: Fraction) -> int:
        return int(turn * half) % order

    def sine(turn: Fraction) -> Any:
        j = power(turn)
        return (_z ** ((j + quarter) % order) - _z ** ((quarter - j) % order)) / 2

    def cosine(turn: Fraction) -> Any:
        j = power(turn)
        return (_z**j + _z ** (-j % order)) / 2

    return Phases(sine, cosine, lambda turn: 1 - cosine(turn), _rational)


def reduced(value: Any, order: int) -> Any:
    """The normal form of a polynomial in ζ: of degree below φ(order)."""
    folded = _ring.zero
    for (power,), c in _ring(value).terms():
        folded += c * _z ** (power % order)
    return folded.rem(_cyclotomic(order))


@lru_cache(maxsize=64)
def _cyclotomic(order: int) -> Any:
    x = Symbol("z")
    return _ring.from_dense(
        [QQ(int(c)) for c in cyclotomic_poly(order, x, polys=True).all_coeffs()]
    )


def _rational(value: Fraction) -> Any:
    return QQ(value.numerator, value.denominator)


def _expanded(start: int) -> Callable[[Any], Any]:
    """sin (start 1) or 1 − cos (start 2) of x·offset, as a polynomial in x = kh."""

    def series(offset: Fraction) -> Any:
        total, term = _ring.zero, QQ(1)
        t = _rational(offset)
        for n in range(1, DEGREE + 1):
            term = term * t / n
            if n >= start and (n - start) % 2 == 0:
                total += (-1) ** ((n - start) // 2) * term * _z**n
        return total

    return series


LONG = Phases(_expanded(1), lambda s: 1 - _expanded(2)(s), _expanded(2), _rational)


def _digits(ctx: Any) -> Phases:
    def number(value: Fraction) -> Any:
        return ctx.mpf(value.numerator) / value.denominator

    return Phases(
        lambda turn: ctx.sinpi(turn),
        lambda turn: ctx.cospi(turn),
        lambda turn: 2 * ctx.sinpi(turn / 2) ** 2,
        number,
    )


def exact_wave(
    kernel: Kernel | Gaussian,
    kind: str,
    ratio: Fraction,
    kappa: Sequence[Fraction],
    volume: str,
    staggered: bool = False,
) -> tuple[LatticeWaves, int] | None:
    """One wave in exact arithmetic, and the order of its ζ; None where there is none.

    Raises ValueError where the kernel reaches no neighbour.
    """
    order = 8 * lcm(*(c.denominator for c in kappa))
    if order > MOST_TURNS or not _has_rational_sums(kernel, kind, volume):
        return None
    found = _one(kernel, kind, ratio, kappa, volume, turns(order), True, staggered)
    return None if found is None else (found, order)


def long_wave(
    kernel: Kernel | Gaussian, kind: str, ratio: Fraction, volume: str, staggered: bool = False
) -> LatticeWaves | None:
    """The series of a long wave along the first axis in kh, exactly; None where there is none.

    Raises ValueError where the kernel reaches no neighbour.
    """
    if not _has_rational_sums(kernel, kind, volume):
        return None
    along = (ratio, *(Fraction(0),) * (KINDS[kind].dim - 1))
    return _one(kernel, kind, ratio, along, volume, LONG, True, staggered)


def precise_wave(
    kernel: Kernel | Gaussian,
    kind: str,
    ratio: Fraction,
    kappa: Sequence[Any],
    volume: str,
    staggered: bool = False,
) -> LatticeWaves:
    """One wave in 50 digits (kappa: fractions, or numbers of `real_context`).

    Raises ValueError where the kernel reaches no neighbour.
    """
    wave = _one(kernel, kind, ratio, kappa, volume, _digits(real_context()), False, staggered)
    assert wave is not None
    return wave


def _has_rational_sums(kernel: Kernel | Gaussian, kind: str, volume: str) -> bool:
    """Rational coordinates, a polynomial kernel, and no π left of σ_d."""
    rational = all(n == 1 for _, _, n in KINDS[kind].units)
    return rational and isinstance(kernel, Kernel) and (volume == "summation" or
                                                         KINDS[kind].dim == 1)  # fmt: skip


def _one(
    kernel: Kernel | Gaussian,
    kind: str,
    ratio: Fraction,
    kappa: Sequence[Any],
    volume: str,
    phases: Phases,
    exact: bool,
    staggered: bool,
) -> LatticeWaves | None:
    found = _still(kernel, kind, ratio, volume, exact, staggered)
    if found is None:
        return None
    m, still = found
    bottom = 2 if staggered else 1  # the unit of m
    along = [sum(c * n for c, n in zip(kappa, row, strict=True)) / bottom for row in m]
    versines = [phases.versine(t) for t in along]
    if staggered:  # 1 − cos(kΔx/2) cos k·r
        half = phases.cosine(kappa[0] / 2)
        versines = [1 - half * (1 - v) for v in versines]
    sines = [phases.sine(t) for t in along]
    return still.under(np.array(sines, dtype=object), np.array(versines, dtype=object))


@lru_cache(maxsize=8)
def _still(
    kernel: Kernel | Gaussian, kind: str, ratio: Fraction, volume: str, exact: bool, staggered: bool
) -> tuple[list[list[int]], LatticeWaves] | None:
    """The lattice without a wave in numbers of many digits, and its integer points; None where
    exact ones are wanted and there are none. Digits are many: of two neighbours at ±r one, where
    both are alike."""
    dim = KINDS[kind].dim
    ctx = real_context()
    number = _rational if exact else _digits(ctx).number
    shift = Fraction(1, 2) if staggered else Fraction(0)
    shells = _shells(Arrangement(kind, ratio, (shift,) * dim), fraction(kernel.support))
    if shells.x.shape[1] == 0 or all(q2 >= fraction(kernel.support) ** 2 for q2 in shells.squares):
        raise ValueError(_no_neighbours(str(ratio), kernel))
    shell_of = np.repeat(
        np.arange(len(shells.starts)), np.diff([*shells.starts, shells.x.shape[1]])
    )
    m = [[int(c) for c in row] for row in shells.x.T]
    rule = KINDS[kind].turned
    paired = rule is None and not exact
    rows = list(range(len(m)))
    if paired:
        rows = [i for i in rows if next(c for c in m[i] if c) > 0]
    per_point = {}
    for k in (VALUE, SLOPE, CURVATURE):
        values = _radial(kernel, k, shells.squares, exact, dim)
        if values is None:
            return None
        numbers = [number(v) if exact else v for v in values]
        per_point[k] = np.array([numbers[shell_of[i]] for i in rows], dtype=object)
    m = [m[i] for i in rows]
    step = [number(u * ratio) for u in shells.step]
    s = np.array([[c * u for c, u in zip(row, step, strict=True)] for row in m], dtype=object)
    count = 2 if paired else 1
    if isinstance(kernel, Kernel):
        home = number(fraction(kernel.central()))
    else:
        home = kernel.radial_mp(ctx, VALUE, ctx.zero, dim)
    if volume == "summation" and not staggered:
        cell = 1 / (home + count * per_point[VALUE].sum())
    else:
        sigma = kernel.normalisation(dim)
        cell = number(ratio**dim) * (
            number(fraction(sigma)) if exact else ctx.mpf(str(sigma.evalf(60)))
        )
    still = LatticeWaves(
        offsets=s,
        f0=per_point[VALUE],
        f1=per_point[SLOPE],
        f2=per_point[CURVATURE],
        home=home,
        volume=cell,
        other=None if rule is None else np.asarray(rule(np.array(m).T)),
        count=count,
        exact=exact,
    )
    return m, still
