"""The law of disorder for any arrangement of particles: mean and spread of a sum from S(k).

For a sum M = V Σ_b ψ(s_b) about a random point, whatever the process (Campbell's theorem, and its
Bartlett spectrum),

    E M = ∫ ψ,      Var M = Δx^d ∫ |ψ̂(k)|² S(k) d^d k/(2π)^d,

and in a periodic box, over all points of it, the same with the sum over its modes k ≠ 0 in place of
the integral: Parseval's theorem, without any approximation. Seen from the particles the mean is

    ⟨M⟩ = ∫ ψ + Δx^d ∫ ψ̂(k) S(k) d^d k/(2π)^d,

exactly, with the particle itself in the sum. The spread is taken to be the same as between them:
what it differs by is a third cumulant, of the density at the target and the sum twice, which is not
known from S. On glasses of pair repulsion and of shifting, in 2D and 3D, it is found to be 0.85 to
1.2 times that for moments of degree 2 of plain gradients and of CSPH, 0.8 to 1 for those of degree
1 where h is 1.5 Δx and more and down to 0.5 below, and 0.45 to 1 for the gradient of RKPM-1; and
the sum that relaxation drives to zero, M_0 of a gradient, is much smaller on particles that were
relaxed with the same kernel.

Test functions: a moment of any operator is a function of base sums m (`sphtrunc.operators`), and to
first order in their fluctuations M ≈ M(m̄) + Σ ∂M/∂m (m − m̄), so that ψ = Σ_key (∂M/∂m_key) g_key;
of corrected operators a part of the spread is neglected that is about as large as the fluctuation
of what is divided by, relative to its mean. For the first moments of uncorrected gradients

    M_0: |ĝ|² = k₁²F²,   M_{e₁}: (F + k₁²F′/k)²,   M_{e₂}: (k₁k₂F′/k)²,

for CSPH ψ = g₂ on symmetric neighbours, and for the gradient of RKPM-1 ∂₁[(s₁² − μ₂)Ŵ], whose
transform is of third order in k. Volumes 1/ΣW, of summation, multiply |ψ̂|² by (1 − F)²: they take
long waves out of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from math import inf, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.dual import Dual, dual_solve
from sphtrunc.kernels.arguments import dimension
from sphtrunc.kernels.transform import kernel_scale, radial
from sphtrunc.operators.moments import MultiIndex, add
from sphtrunc.operators.operator import NESTED, PAIRED, Operator
from sphtrunc.operators.terms import BROOKSHAW, FATEHI_MANZARI, Key
from sphtrunc.theory.disorder.prediction import Prediction
from sphtrunc.theory.disorder.sensitivities import dual_coefficients
from sphtrunc.theory.field_error import Split, floor
from sphtrunc.theory.fields import Signals, Waves
from sphtrunc.theory.reciprocal_sums import Symbol, monomial_derivatives, symbol

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.theory.disorder.structure_factor import Nodes, StructureFactor

    Array = NDArray[np.float64]

FARTHEST = {1: 320.0, 2: 100.0, 3: 160.0}  # of k in 1/h times the support (at most 3), up to which
# transforms are integrated
STEP = 0.2  # of the table of a transform, in units of one over the support
BLOCK = 1 << 16  # nodes at a time
PLACES = ("random", "particles")
VOLUMES = ("constant", "summation")
AT_PARTICLES = (
    "the spread is that between the particles; on glasses it is found to be 0.8 to 1.2 times it"
    " on them, 0.45 to 1 times it for RKPM-1 or h below 1.5 Δx, and far less for M(0) of a gradient"
    " where they were relaxed with this kernel"
)


def predict_from(
    kernel: Kernel | Gaussian,
    operator: Operator,
    factor: StructureFactor,
    dx_over_h: float,
    *,
    at: str = "random",
    volume: str = "constant",
    degree: int = 3,
    axis: int = 0,
) -> Prediction:
    """Mean and standard deviation of the moments M_α, |α| <= degree, of one component.

    at: "random", over all points of space (for a lattice, over its offsets too: its Bragg peaks are
        in the spread), or "particles"
    volume: "constant", as `factor` weighs them, or "summation", 1/Σ W, to first order

    Raises ValueError for a nested or paired form, kernels too rough for an operator, for singular
    corrections, and for what `StructureFactor.nodes` refuses.
    """
    sums = _Sums(kernel, operator, factor, float(dx_over_h), at, volume)
    keys = operator.needed(factor.dim, degree)
    moments = operator.correct(sums.duals(keys), factor.dim, degree, axis, dual_solve)
    mean, std = {}, {}
    for alpha, moment in moments.items():
        if not isinstance(moment, Dual) or sum(alpha) <= operator.consistency:
            # the same on any arrangement
            mean[alpha], std[alpha] = float(operator.target(factor.dim, axis).get(alpha, 0)), 0.0
        else:
            mean[alpha] = float(moment.value)
            rows = zip(moment.slope, keys, strict=True)
            std[alpha] = sums.variance(_waves((c, key, _ALONE) for c, key in rows)) ** 0.5
    how = f"structure factor, {factor.by}"
    if at == "particles":
        how += f"; {AT_PARTICLES}"
    if volume == "summation":
        how += "; volumes to first order"
    return Prediction(None, None, mean, std, how)


def predict_errors_from(
    kernel: Kernel,
    operator: Operator,
    factor: StructureFactor,
    dx_over_h: float,
    signals: Signals,
    *,
    at: str = "random",
    volume: str = "constant",
    precision: str = "plain",
) -> list[Split]:
    """The rms error of an estimate, all components together, for each of K signals; its parts and
    what it is relative to as for `predict_fields`.

    A wave e^{iq·s} turns g into g e^{iq·s}, and ĝ(k) into ĝ(k − q). Raises ValueError as above, and
    for vector operators.
    """
    if operator.name in ("divergence", "curl"):
        raise ValueError(f"operator: no prediction for {operator.name}, expected a scalar operator")
    sums = _Sums(kernel, operator, factor, float(dx_over_h), at, volume)
    keys = [] if operator.uncorrected else operator.needed(sums.dim, 0)
    rows = dual_coefficients(operator, sums.duals(keys), sums.dim)
    targets = [
        _complex(sum(signals.derivative(mu) for mu in row)) for row in operator.components(sums.dim)
    ]
    limits = np.moveaxis(signals.limit_error(kernel, operator), 1, 0)
    neighbours = max(2, int(sums.neighbours))
    result = []
    for i, scale in enumerate(1.0 / signals.size(operator.derivatives)):
        seen = _seen(operator, signals, i)
        smooth = error = apart = spread = rounded = 0.0
        for part, target, limit in zip(rows, targets, map(_complex, limits), strict=True):
            exact = 0.0 if operator.adds_own else target[i]
            means = {key: sums.mean(_waves((c, key, seen) for c in (1.0,))) for key in part}
            mean = sum(x.value * means[key] for key, x in part.items())
            psi = _waves((x.value, key, seen) for key, x in part.items())
            for key, x in part.items():
                slopes = zip(np.atleast_1d(x.slope), keys, strict=False)
                psi = _waves(((c * means[key], other, _ALONE) for c, other in slopes), psi)
            variance, noise = sums.variance(psi), sums.variance(psi, flat=True)
            smooth += abs(limit[i]) ** 2
            error += abs(mean - exact) ** 2
            apart += abs(mean - exact - limit[i]) ** 2
            spread += variance
            rounding = floor(np.array(noise**0.5), np.array(abs(mean)), neighbours, precision)
            rounded += float(rounding) ** 2
        columns = (error + spread + rounded, smooth, 0.0, apart + spread, rounded)
        result.append(Split(*(float(scale) * float(x) ** 0.5 for x in columns)))
    return result


def _complex(parts: Any) -> Any:
    """The parts of a signal, (K, F), as one number: that of cosine and sine is e^{iq·s}."""
    return parts[:, 0] + 1j * parts[:, 1] if parts.shape[1] == 2 else parts[:, 0] + 0j


Wave = tuple[float, ...] | None  # q of e^{iq·s}, in 1/h
Seen = list[tuple[complex, MultiIndex | None, Wave]]  # Σ c s^α e^{iq·s}; no α: 1
_ALONE: Seen = [(1.0, None, None)]


def _seen(operator: Operator, signals: Signals, i: int) -> Seen:
    """A signal as the form sees it, for equal densities."""
    copies = operator.copies - 1.0  # of the own value, beside those in A_b
    if isinstance(signals, Waves):
        wave = tuple(float(x) for x in signals.kappa[i] * signals.direction)
        seen: Seen = [(1.0, None, wave)]
        return [*seen, (copies, None, None)] if copies else seen
    return [
        (c * (1.0 if any(alpha) else 1.0 + copies), alpha, None)
        for alpha, c in signals.coefficients[i].items()
    ]


# ---------------------------------------------------------------------------- sums over the nodes


Terms = dict[Wave, Symbol]  # ψ̂(k) = Σ_q table_q(k − q)


class _Sums:
    """The base sums of a kernel over an arrangement: means, and the spread of what is made of them.
    Lengths in h."""

    def __init__(
        self,
        kernel: Kernel | Gaussian,
        operator: Operator,
        factor: StructureFactor,
        ratio: float,
        at: str,
        volume: str,
    ) -> None:
        _check(kernel, operator, factor, at, volume)
        if not 0 < ratio < inf:
            raise ValueError(f"dx_over_h: got {ratio!r}, expected a positive ratio Δx/h")
        self.kernel, self.dim, self.at, self.fill = kernel, factor.dim, at, factor.fill
        self.smoothed = volume == "summation"
        support = float(kernel.support)
        farthest = FARTHEST[self.dim] / min(support, 3.0)
        nodes: Nodes = factor.nodes(farthest * ratio, support / ratio)
        self.k, self.bragg = nodes.k / ratio, nodes.bragg / ratio
        self.weight = nodes.weight
        self.S, self.pairs, self.strength = nodes.S, nodes.pairs, nodes.strength
        self.neighbours = _ball(self.dim) * (support / ratio) ** self.dim
        if self.smoothed:
            rise = 1.0 - interpolated(kernel, self._length(self.k), self.dim, 0)
            smooth = 1.0 - rise
            # ⟨V_b⟩/Δx^d, to the order that S knows: δV/V = −(δ∗W)/n at a particle
            self.fill *= 1.0 - float((self.weight * smooth * rise * self.S).sum())
            self.filter: Array | None = rise**2
            self.edge: Array | None = None
            if self.bragg.size:
                self.edge = (1.0 - interpolated(kernel, self._length(self.bragg), self.dim, 0)) ** 2
        else:
            self.filter = self.edge = None

    @staticmethod
    def _length(k: Array) -> Array:
        return np.asarray(np.sqrt((k * k).sum(axis=0)))

    def duals(self, keys: Sequence[Key]) -> dict[Key, Dual]:
        """m̄_key, carrying the index of its fluctuation."""
        each = np.eye(len(keys))
        means = [self.mean(_waves([(1.0, key, _ALONE)])).real for key in keys]
        return {key: Dual(m, row) for key, m, row in zip(keys, means, each, strict=True)}

    def mean(self, terms: Terms) -> complex:
        """E V Σ_b ψ(s_b), seen from where the targets are."""
        zero = np.zeros((self.dim, 1))
        total = complex(self._at(terms, zero)[0]) * self.fill
        if self.at == "particles":
            for k, weight in ((self.k, self.weight * self.pairs), (self.bragg, self.strength)):
                for share, sign in self._signs(terms):
                    for part, value in self._blocks(terms, sign * k):
                        found = complex((weight[part] * value).sum()) * share * self.fill
                        total += found if share < 1.0 else found.real
        return total

    def variance(self, terms: Terms, flat: bool = False) -> float:
        """Var of V Σ_b ψ(s_b); flat: as if S were 1."""
        total = 0.0
        S = np.ones_like(self.S) if flat else self.S
        if self.filter is not None:
            S = S * self.filter
        peaks = self.strength if self.edge is None else self.strength * self.edge
        bragg = self.at == "random" and not flat
        for k, weight in ((self.k, self.weight * S), *([(self.bragg, peaks)] if bragg else [])):
            for share, sign in self._signs(terms):
                for part, value in self._blocks(terms, sign * k):
                    square = value.real**2 + value.imag**2
                    total += share * float((weight[part] * square).sum())
        return total * self.fill**2

    @staticmethod
    def _signs(terms: Terms) -> list[tuple[float, float]]:
        """Share and sign of k: where ψ is real, ψ̂(−k) is the conjugate of ψ̂(k)."""
        shifted = any(q is not None for q in terms)
        return [(0.5, 1.0), (0.5, -1.0)] if shifted else [(1.0, 1.0)]

    def _blocks(self, terms: Terms, k: Array) -> Iterator[tuple[slice, Any]]:
        for first in range(0, k.shape[1], BLOCK):
            part = slice(first, first + BLOCK)
            yield part, self._at(terms, k[:, part])

    def _at(self, terms: Terms, k: Array) -> Any:
        """ψ̂ at k (d, M), complex (M,)."""
        total = np.zeros(k.shape[1], dtype=complex)
        for q, table in terms.items():
            moved = k if q is None else k - np.array(q)[:, None]
            total += evaluate(self.kernel, table, moved)
        return total


def evaluate(kernel: Kernel | Gaussian, table: Symbol, k: Array) -> Any:
    """Σ c k^γ Φ_m(|k|) at k (d, M) in 1/h, complex (M,)."""
    dim = k.shape[0]
    length = np.sqrt((k * k).sum(axis=0))
    real, imaginary = np.zeros(k.shape[1]), np.zeros(k.shape[1])
    for m in {m for _, m in table}:
        f = interpolated(kernel, length, dim, m)
        polynomial: dict[bool, Any] = {}
        for (gamma, order), c in table.items():
            if order != m:
                continue
            for odd, size in ((False, c.real), (True, c.imag)):
                if size:
                    monomial = prod(
                        (row for row, n in zip(k, gamma, strict=True) for _ in range(n)), start=size
                    )
                    polynomial[odd] = polynomial.get(odd, 0.0) + monomial
        real += polynomial.get(False, 0.0) * f
        imaginary += polynomial.get(True, 0.0) * f
    return real + 1j * imaginary


def interpolated(kernel: Kernel | Gaussian, k: Array, dim: int, m: int) -> Array:
    """Φ_m(|k|), by quintic Hermite interpolation in a table: to about 1e-8 of its envelope."""
    table = _hermite(kernel, dim, m)
    at = k * (kernel_scale(kernel) / STEP)
    if k.size and float(at.max()) > table.shape[1] - 1:
        return radial(kernel, k, dim, m)
    i = np.minimum(at.astype(np.int64), table.shape[1] - 2)
    total = np.zeros_like(k)
    for end, t in ((0, at - i), (1, 1.0 - (at - i))):
        value, slope, curvature = table[:, i + end]
        rest = (1.0 - t) ** 3
        toward = -t if end else t
        total += rest * (
            value * (1.0 + t * (3.0 + 6.0 * t))
            + toward * slope * (1.0 + 3.0 * t)
            + 0.5 * t * t * curvature
        )
    return total


@lru_cache(maxsize=64)
def _hermite(kernel: Kernel | Gaussian, dim: int, m: int) -> Array:
    """Φ_m, Φ_m′ = −k Φ_{m+1} and Φ_m″ at multiples of the step, in units of it, (3, n)."""
    step = STEP / kernel_scale(kernel)
    first, second, third = (_tabulated(kernel, dim, m + i) for i in range(3))
    k = step * np.arange(first.size)
    return np.stack([first, -step * k * second, step**2 * (k * k * third - second)])


@lru_cache(maxsize=64)
def _tabulated(kernel: Kernel | Gaussian, dim: int, m: int) -> Array:
    """Φ_m at multiples of the step."""
    support = kernel_scale(kernel)
    step = STEP / support
    count = int(1.3 * FARTHEST[dim] / min(support, 3.0) / step)
    return radial(kernel, step * np.arange(count), dim, m)


def _waves(rows: Iterable[tuple[complex, Key, Seen]], terms: Terms | None = None) -> Terms:
    """Σ c g_key(s) f(s) for fields f as forms see them, added to `terms`."""
    result: Terms = {} if terms is None else terms
    for c, (term, gamma), seen in rows:
        for factor, alpha, q in seen if c else []:
            table = result.setdefault(q, {})
            key = term, gamma if alpha is None else add(gamma, alpha)
            for entry, value in _table(key).items():
                table[entry] = table.get(entry, 0) + c * factor * value
    return result


def _table(key: Key) -> Symbol:
    """ĝ of the term of a base sum, as Σ c k^γ Φ_m.

    That of Brookshaw is −s^α Ŵ′/q, and −s Ŵ′/q = −∇Ŵ: its own transform B has −B′/k = F, so that
    every derivative of it is one of F.
    """
    term, alpha = key
    if term == BROOKSHAW:  # of −Ŵ′/q it is Φ_{−1}
        return {
            (gamma, m - 1): 1j ** (sum(alpha) % 4) * c
            for (gamma, m), c in monomial_derivatives(alpha).items()
        }
    return symbol(term, alpha)


def _check(
    kernel: Kernel | Gaussian, operator: Operator, factor: StructureFactor, at: str, volume: str
) -> None:
    dimension(factor.dim)
    if at not in PLACES:
        raise ValueError(f"at: got {at!r}, expected random or particles")
    if volume not in VOLUMES:
        raise ValueError(
            f"volume: no prediction from a structure factor for {volume!r}, expected constant or"
            " summation"
        )
    if operator.form in (NESTED, PAIRED, FATEHI_MANZARI):
        raise ValueError(
            f"form: no prediction from a structure factor for the {operator.form} form; expected"
            " another form"
        )
    if operator.form == "symmetric" and volume == "summation":
        raise ValueError(
            "form: no prediction from a structure factor for the symmetric form with summed"
            " volumes, which divides by them; expected another form"
        )
    smooth = getattr(kernel, "smoothness", inf)
    if operator.derivatives > smooth + 1:
        raise ValueError(
            f"kernel {kernel.name!r}: its derivative number {operator.derivatives - 1} jumps, so"
            " that the transform is not that of what particles sum; expected a smoother kernel"
        )


def _ball(dim: int) -> float:
    return {1: 2.0, 2: np.pi, 3: 4 * np.pi / 3}[dim]
