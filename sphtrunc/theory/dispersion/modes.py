"""Modes: what the dispersion relation says of one setting, exactly or in floats over many waves.

A setting is particles at rest: a kernel, a lattice and Δx/h, a form of the force and a pressure.
Frequencies are ω² in units of c²/h², growth rates √(−ω²) in c/h.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from sympy import QQ, Rational
from sympy import sqrt as exact_root

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.forces import PLAIN, REFERENCE, STAGGERED, ArtificialStress, Force
from sphtrunc.operators.terms import VALUE
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.dispersion.brillouin import halves, scale
from sphtrunc.theory.dispersion.lattice_waves import (
    LatticeWaves,
    Scan,
    exact_wave,
    long_wave,
    precise_wave,
    reduced,
)
from sphtrunc.theory.dispersion.relation import dynamical, require, respond
from sphtrunc.theory.lattice_sums import real_context

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.gaussian import Gaussian

    Array = NDArray[np.float64]

LONGITUDINAL, TRANSVERSE = "longitudinal", "transverse"
VOLUMES = ("summation", "constant", "corrected")
_EQUAL = 1e-6  # of the largest entry: eigenvalues that a tilt by 1e-9 of it may have to tell apart


@dataclass(frozen=True)
class Rest:
    """Particles of equal mass at rest on a lattice, under a uniform pressure.

    kernel, kind, ratio: the kernel, a lattice of `scenes.sites`, Δx/h
    force: a form of `operators.forces`; pressure: p = P₀/(ρc²)
    stress: artificial stress, which acts for p < 0; not at p = 0, where its force has a kink
    volume: "summation", ρ = Σ m W; "constant", ρ = m/Δx^d, as a density that is integrated from
        there keeps it (and as stress points have it); "corrected", integrated by the corrected
        divergence of a csph form

    Raises ValueError for Δx/h <= 0, an unknown volume, and a lattice on which the form has no
    formula; what is asked of it does so where no neighbour is inside the support.
    """

    kernel: Kernel | Gaussian
    kind: str
    ratio: Fraction
    force: Force
    pressure: Fraction = Fraction(0)
    stress: ArtificialStress | None = None
    volume: str = "summation"

    def __post_init__(self) -> None:
        if self.ratio <= 0:
            raise ValueError(f"dx-over-h: got {self.ratio}, expected a positive number")
        if self.volume not in VOLUMES:
            raise ValueError(f"volume: got {self.volume!r}, expected one of {', '.join(VOLUMES)}")
        require(self.force, self.kind, self.stress, self.volume)
        if self.stress is not None and self.stress.spacing * self.ratio >= self.kernel.support:
            raise ValueError(
                f"remedy: the kernel is zero at Δp = {self.stress.spacing} Δx; expected Δx/h below"
                f" {fraction(self.kernel.support) / self.stress.spacing}"
            )

    @property
    def dim(self) -> int:
        """d."""
        return KINDS[self.kind].dim

    @property
    def staggered(self) -> bool:
        """Whether the force acts from stress points."""
        return self.force.gradient == STAGGERED

    def matrix(self, waves: LatticeWaves, pressure: Any) -> Any:
        """D(k) at a pressure in the numbers of `waves`."""
        if self.stress is None:
            moved = self.volume == "corrected"
            return dynamical(self.force, waves, pressure, corrected=moved)
        epsilon = Fraction(self.stress.epsilon)
        number = _number if waves.exact else float if waves.offsets.dtype != object else _wide
        stress = replace(self.stress, epsilon=number(epsilon))
        return dynamical(self.force, waves, pressure, stress, self._at_spacing(waves))

    def _at_spacing(self, waves: LatticeWaves) -> Any:
        """The kernel at Δp, in the numbers of `waves`."""
        assert self.stress is not None
        place = Fraction(self.stress.spacing) * self.ratio
        if waves.offsets.dtype != object:
            return float(self.kernel.w(float(place), self.dim))
        if not isinstance(self.kernel, Kernel):
            ctx = real_context()
            return self.kernel.radial_mp(ctx, VALUE, ctx.mpf(place.numerator) / place.denominator,
                                         self.dim)  # fmt: skip
        piece = next(
            p for p, k in zip(self.kernel.pieces, self.kernel.knots[1:], strict=True) if place < k
        )
        value = fraction(piece.eval(Rational(place.numerator, place.denominator)))
        return _number(value) if waves.exact else _wide(value)

    # -- many waves, in floats ---------------------------------------------------------------------

    def scan(self, kappa: Any, reach: float = 0.0) -> Scan:
        """Waves to look at, (K, d), for this lattice and Δx/h down to support/reach."""
        most = max(reach, float(self.kernel.support) / float(self.ratio))
        return Scan(self.kind, kappa, most * (1 + 1e-12), self.staggered)

    def frequencies(self, scan: Scan) -> Spectrum:
        """ω² of all waves of a scan, in floats."""
        waves = scan.at(self.kernel, float(self.ratio), self.volume)
        p = float(self.pressure)
        bound = float(self.rounding(waves, p))
        return spectrum(self.matrix(waves, p), scan, float(self.ratio), bound)

    def rounding(self, waves: LatticeWaves, pressure: Any) -> Any:
        """A bound of what rounding does to an ω², for a pressure or an array of them: γ of the sums
        times the sizes of their terms.

        A term g sin k·r has at most 30 roundings (8 of the kernel and of its argument, 8 of the
        phase, products), and its size is taken without the sine; M of them add M.
        """
        rest = respond(self.force, pressure)
        v = waves.volume * waves.count
        size = np.sqrt(waves.squares)
        slope = v * float(np.abs(waves.f1 * size).sum())
        bend = v * float((np.abs(waves.f1) + np.abs(waves.f2) * waves.squares).sum())
        changing = self.force.gradient not in (PLAIN, STAGGERED, REFERENCE)
        terms = np.abs(rest.slope) * slope**2 + 2 * np.abs(rest.pull) * bend
        return 2 * (len(size) + 64) * UNIT * (waves.dim + 2 if changing else 1) * terms

    # -- one wave ----------------------------------------------------------------------------------

    def modes(self, kappa: Sequence[Fraction], exact: bool = True) -> list[Mode]:
        """The modes of one wave, ω² increasing: exactly where all is rational (and `exact` is asked
        for), else from 50 digits.

        Raises ValueError for k = 0.
        """
        if not any(kappa):
            raise ValueError("k: got 0, which moves all particles alike; expected a wave")
        found = None
        given = (self.kernel, self.kind, self.ratio)
        if exact:
            found = exact_wave(*given, kappa, self.volume, self.staggered)
        if found is not None:
            waves, order = found
            matrix = self.matrix(waves, _number(self.pressure))
            entries = [[reduced(entry, order) for entry in row] for row in matrix]
            values = [[_decimal(entry, order) for entry in row] for row in entries]
            texts = _exact_eigenvalues(entries, order)
        else:
            waves = precise_wave(*given, kappa, self.volume, self.staggered)
            values = self.matrix(waves, _wide(self.pressure)).tolist()
            texts = {}
        return _modes(values, texts, self.kind, kappa)

    def long_waves(self) -> LongWaves:
        """What is left for k → 0, along the first axis."""
        waves = long_wave(self.kernel, self.kind, self.ratio, self.volume, self.staggered)
        if waves is not None:
            series = dict(self.matrix(waves, _number(self.pressure))[0, 0].terms())
            c2, fourth = (_back(series.get((n,), QQ(0))) for n in (2, 4))
            return LongWaves(c2, fourth / (2 * c2) if c2 else None)
        # ω²/k² at kh = ε and 2ε, whose difference is 3ε² of the next term
        ctx = real_context()
        small = ctx.mpf(10) ** -10
        rates = []
        for k in (small, 2 * small):
            kappa = [k * float(self.ratio) / scale(self.kind)[0], *[ctx.zero] * (self.dim - 1)]
            length = kappa[0] * _wide_unit(self.kind) / _wide(self.ratio)  # kh
            waves = precise_wave(
                self.kernel, self.kind, self.ratio, kappa, self.volume, self.staggered
            )
            matrix = self.matrix(waves, _wide(self.pressure)).tolist()
            rates.append((_acoustic(matrix, self.dim) / length**2, length**2))
        (low, at), (high, further) = rates
        bend = (high - low) / (further - at)
        c2 = low - bend * at
        return LongWaves(float(c2), float(bend / (2 * c2)) if c2 else None)

    def zero_modes(self) -> list[tuple[Fraction, ...]]:
        """κ of the waves without any restoring force: S(k) = 0 in a form without stiffness.

        They are those that only change sign from site to site, 2k a reciprocal vector. Every
        transverse wave is one too.
        """
        stiff = self.force.gradient != REFERENCE and respond(self.force, self.pressure).pull != 0
        one_site = KINDS[self.kind].turned is None
        return halves(self.kind) if one_site and not stiff and not self.staggered else []


@dataclass(frozen=True)
class LongWaves:
    """ω/(ck) = c_eff/c (1 + A k²h² + …) for k → 0.

    sound_speed2: c_eff²/c²; dispersion: A, None where c_eff = 0. Fractions where exact.
    """

    sound_speed2: Any
    dispersion: Any


@dataclass(frozen=True)
class Mode:
    """One mode of one wave. omega2: ω² in c²/h², the nearest float; exact: as text, or None;
    growth: the growth rate in c/h; polarisation: displacement of each particle of the cell."""

    omega2: float
    exact: str | None
    growth: float
    branch: str
    polarisation: tuple[float, ...]


class Spectrum(NamedTuple):
    """ω² of many waves: omega2 (K, nd), longitudinal (K, nd); growth (K, nd); k: (K,), |k|h;
    rounding: a bound of what rounding did to any ω²."""

    omega2: Array
    longitudinal: Any
    growth: Array
    k: Array
    rounding: float


def spectrum(matrix: Any, scan: Scan, ratio: float, rounding: float) -> Spectrum:
    """Eigenvalues and branches of matrices (K, nd, nd)."""
    values, along = _eigen(matrix, scan.direction)
    return Spectrum(values.real, along, growth(values), scan.k / ratio, rounding)


def growth(omega2: Any) -> Any:
    """Im ω of the faster growing one of ±ω."""
    return np.abs(np.sqrt(np.asarray(omega2).astype(complex)).imag)


def eigenvalues(matrix: Any) -> Any:
    """Of matrices (…, n, n), (…, n), by their real parts; real where the matrices are Hermitian, or
    where what is imaginary can be the rounding of a defective one, the root of u."""
    if matrix.shape[-1] == 1:
        return matrix[..., 0].real
    size = np.abs(matrix).max()
    if _hermitian(matrix, size):
        return np.linalg.eigvalsh(matrix)
    values = np.sort_complex(np.linalg.eigvals(matrix))
    return values.real if np.abs(values.imag).max() <= 10 * sqrt(UNIT) * size else values


def _hermitian(matrix: Any, size: Any) -> bool:
    return bool(np.abs(matrix - np.conj(np.swapaxes(matrix, -1, -2))).max() <= 1e-12 * size)


def _eigen(matrix: Any, direction: Array) -> tuple[Any, Any]:
    """Eigenvalues, (K, nd) increasing, and which are longitudinal: the one (of every particle in
    the cell) that moves most along k. Where branches meet, what can be is taken along k."""
    d = direction.shape[1]
    if d == 1:
        values = eigenvalues(matrix)
        return values, np.ones(values.shape, dtype=bool)
    cells = matrix.shape[-1] // d
    size = np.abs(matrix).max(axis=(-1, -2))
    push = np.tile(direction, cells)  # tells equal eigenvalues apart
    if _hermitian(matrix, size.max()):
        values, vectors = np.linalg.eigh(matrix)
        equal = np.diff(values, axis=1).min(axis=1) <= _EQUAL * size
        tilted = _tilted(matrix[equal], size[equal], push[equal])
        vectors[equal] = np.linalg.eigh(tilted)[1]
    else:
        values = eigenvalues(matrix)
        moved, vectors = np.linalg.eig(_tilted(matrix, size, push))
        order = np.argsort(moved.real, axis=1)
        vectors = np.take_along_axis(vectors, order[:, None, :], axis=2)
    parts = vectors.reshape(len(matrix), cells, d, -1)
    share = (np.abs(np.einsum("kcdm,kd->kcm", parts, direction)) ** 2).sum(axis=1)
    rank = np.argsort(np.argsort(-share, axis=1, kind="stable"), axis=1)
    return values, rank < cells


def _tilted(matrix: Any, size: Any, push: Any) -> Any:
    """Matrices in which what moves along k costs a little more."""
    return matrix + 1e-9 * size[:, None, None] * push[:, :, None] * push[:, None, :]


# ------------------------------------------------------------------------------------ one wave


def _number(value: Any) -> Any:
    value = Fraction(value)
    return QQ(value.numerator, value.denominator)


def _back(value: Any) -> Fraction:
    return Fraction(int(value.numerator), int(value.denominator))


def _wide(value: Any) -> Any:
    value = Fraction(value)
    return real_context().mpf(value.numerator) / value.denominator


def _wide_unit(kind: str) -> Any:
    """π/u of the first axis, in 50 digits."""
    from sphtrunc.scenes.sites import units

    return real_context().pi / _wide(units(kind)[0])


def _decimal(entry: Any, order: int) -> Any:
    ctx = real_context()
    return ctx.fsum(
        _wide(_back(c)) * ctx.cospi(ctx.mpf(2 * power) / order) for (power,), c in entry.terms()
    )


def written(entry: Any, order: int) -> str:
    """A real number of ℚ(ζ) in its normal form: a fraction, or a sum of cosines."""
    angles: dict[Fraction, Fraction] = {}
    for (power,), c in sorted(entry.terms()):
        turn, sign = Fraction(2 * power, order), 1  # cos(π turn), brought to the first quadrant
        if turn > 1:
            turn = 2 - turn
        if turn > Fraction(1, 2):
            turn, sign = 1 - turn, -1
        angles[turn] = angles.get(turn, Fraction(0)) + sign * _back(c)
    parts = []
    for turn, value in sorted(angles.items()):
        top, bottom = turn.numerator, turn.denominator
        if turn == 0:
            parts.append(str(value))
        elif value and turn != Fraction(1, 2):
            angle = "pi" if top == 1 else f"{top}*pi"
            size = "" if abs(value) == 1 else f"{abs(value)}*"
            parts.append(f"{'-' if value < 0 else '+'} {size}cos({angle}/{bottom})")
    text = " ".join(parts) or "0"
    return text.removeprefix("+ ") if text[0] == "+" else re.sub("^- ", "-", text)


def _exact_eigenvalues(entries: list[list[Any]], order: int) -> dict[float, str]:
    """Eigenvalues that can be written: value -> text."""
    n = len(entries)
    texts: dict[float, str] = {}
    left = set(range(n))
    while left:
        block = {min(left)}
        while True:
            wider = {j for i in block for j in range(n) if entries[i][j] or entries[j][i]} | block
            if wider == block:
                break
            block = wider
        left -= block
        rows = sorted(block)
        if len(rows) == 1:
            entry = entries[rows[0]][rows[0]]
            texts[float(_decimal(entry, order))] = written(entry, order)
        elif len(rows) == 2:
            (a, b), (c, d) = ([entries[i][j] for j in rows] for i in rows)
            half = reduced((a + d) / 2, order)
            under = reduced(((a - d) / 2) ** 2 + b * c, order)
            if half.is_ground and under.is_ground:
                middle, square = (_rational(x) for x in (half, under))
                for sign in (-1, 1):
                    value = middle + sign * exact_root(square)
                    texts[float(value)] = str(value)
    return texts


def _rational(entry: Any) -> Any:
    value = _back(entry.coeff(1)) if entry else Fraction(0)
    return Rational(value.numerator, value.denominator)


def _eigenvalues(matrix: list[list[Any]]) -> list[Any]:
    """In 50 digits; of a matrix that is not symmetric, those of real part and what is left."""
    ctx = real_context()
    n = len(matrix)
    if n == 1:
        return [ctx.mpf(matrix[0][0].real)]
    size = max(abs(x) for row in matrix for x in row)
    skew = max(abs(matrix[i][j] - ctx.conj(matrix[j][i])) for i in range(n) for j in range(n))
    if skew <= size * ctx.mpf(10) ** -40:
        complex_ = any(ctx.im(x) != 0 for row in matrix for x in row)
        solve = ctx.eighe if complex_ else ctx.eigsy
        return sorted(ctx.re(x) for x in solve(_cleaned(matrix), eigvals_only=True))
    values, _ = ctx.eig(ctx.matrix(matrix))
    return sorted((x if abs(ctx.im(x)) > size * ctx.mpf(10) ** -20 else ctx.re(x) for x in values),
                  key=lambda x: ctx.re(x))  # fmt: skip


def _cleaned(matrix: list[list[Any]]) -> Any:
    """A Hermitian matrix without what rounding left of it on the diagonal and across."""
    ctx = real_context()
    n = len(matrix)
    return ctx.matrix(
        [
            [ctx.re(matrix[i][i]) if i == j else matrix[i][j] if i < j else ctx.conj(matrix[j][i])
             for j in range(n)]
            for i in range(n)
        ]
    )  # fmt: skip


def _acoustic(matrix: list[list[Any]], dim: int) -> Any:
    """The eigenvalue of the mode in which all particles of the cell move along the first axis."""
    if len(matrix) == dim:
        return matrix[0][0]  # by symmetry the other axes do not take part
    values, vectors = real_context().eighe(_cleaned(matrix))
    n = len(matrix)
    shares = [abs(sum(vectors[i, j] for i in range(0, n, dim))) for j in range(n)]
    return values[max(range(n), key=lambda j: shares[j])]


def _modes(
    values: list[list[Any]], texts: dict[float, str], kind: str, kappa: Sequence[Any]
) -> list[Mode]:
    size = max(abs(x) for row in values for x in row)
    none = (1 + size) * real_context().mpf(10) ** -40  # what is left of zero in 50 digits
    found = [x if abs(x) > none else x * 0 for x in _eigenvalues(values)]
    k = np.array([float(c) for c in kappa]) * scale(kind)
    direction = (k / sqrt(float(k @ k)))[None, :]
    floats = np.array([[complex(x) for x in row] for row in values])[None]
    if not np.abs(floats.imag).any():
        floats = floats.real
    _, along = _eigen(floats, direction)
    vectors = _polarisations(floats[0], direction[0])
    return [
        Mode(
            omega2=float(value.real),
            exact=_nearest(texts, float(value.real)),
            growth=float(growth(complex(value))),
            branch=LONGITUDINAL if longitudinal else TRANSVERSE,
            polarisation=tuple(float(x) for x in vector),
        )
        for value, longitudinal, vector in zip(found, along[0], vectors, strict=True)
    ]


def _polarisations(matrix: Any, direction: Array) -> Any:
    """Unit displacements of the modes, largest component positive (real parts)."""
    push = np.tile(direction, len(matrix) // len(direction))
    tilted = matrix + 1e-9 * np.abs(matrix).max() * np.outer(push, push)
    values, vectors = np.linalg.eig(tilted)
    rows = vectors[:, np.argsort(values.real)].T
    top = rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)]
    return (rows * (np.conj(top) / np.abs(top))[:, None]).real


def _nearest(texts: dict[float, str], value: float) -> str | None:
    """The text of the eigenvalue, which rounding has moved by an ulp at most."""
    for known, text in texts.items():
        if abs(known - value) <= 1e-14 * max(1.0, abs(value)):
            return text
    return None


@lru_cache(maxsize=8)
def continuous(kernel: Kernel | Gaussian, dim: int, p: float, k: tuple[float, ...]) -> Array:
    """ω²/(c²k²) of the longitudinal wave without particles, (1 − 2p) F² + 2p F at kh = k; the
    transverse one has none."""
    from sphtrunc.kernels.transform import transform

    f = transform(kernel, np.asarray(k), dim)
    return np.asarray((1 - 2 * p) * f * f + 2 * p * f)
