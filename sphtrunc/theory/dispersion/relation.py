"""The dispersion relation of SPH: what a small wave of displacements does to particles at rest on a
lattice.

With displacements ξ exp(ik·X − iωt), ω² are the eigenvalues of D(k), in units of c²/h². For every
form of `sphtrunc.operators.forces` whose ends see the same gradient, with Φ = own + other,

    D = V² (∂Φ/∂ρ_b) S Sᵀ + V Φ T,      S = Σ ∇W sin k·r,   T = Σ ∇∇W (1 − cos k·r)      (ρ = c = 1)

since the density moves by iVS·ξ; the others add what their gradients change (Ω and h of grad-h, the
matrix of a correction). Pressures are p = P₀/(ρc²), ρ the density that the scheme itself has there.
The same algebra takes floats, fractions with roots of unity, and series in kh.

Sources: Swegle, Hicks & Attaway (1995) doi:10.1006/jcph.1995.1010; Morris (1996)
doi:10.1071/AS96097; Dehnen & Aly (2012) doi:10.1111/j.1365-2966.2012.21439.x; Price (2012)
doi:10.1016/j.jcp.2010.12.011.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sphtrunc.operators.forces import (
    CORRECTED,
    GRAD_H,
    PLAIN,
    REFERENCE,
    STAGGERED,
    ArtificialStress,
    Force,
)
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.dispersion.lattice_waves import LatticeWaves


class Tangent:
    """A number with its derivative: a + bε, ε² = 0, over any field."""

    __slots__ = ("slope", "value")

    def __init__(self, value: Any, slope: Any = 0) -> None:
        self.value, self.slope = value, slope

    def __neg__(self) -> Tangent:
        return Tangent(-self.value, -self.slope)

    def __add__(self, other: Any) -> Tangent:
        other = _tangent(other)
        return Tangent(self.value + other.value, self.slope + other.slope)

    def __sub__(self, other: Any) -> Tangent:
        return self + (-_tangent(other))

    def __mul__(self, other: Any) -> Tangent:
        other = _tangent(other)
        return Tangent(
            self.value * other.value, self.value * other.slope + self.slope * other.value
        )

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Any) -> Tangent:
        other = _tangent(other)
        ratio = self.value / other.value
        return Tangent(ratio, (self.slope - ratio * other.slope) / other.value)

    def __pow__(self, n: int) -> Tangent:
        return Tangent(self.value**n, n * self.value ** (n - 1) * self.slope)


def _tangent(value: Any) -> Tangent:
    return value if isinstance(value, Tangent) else Tangent(value)


@dataclass(frozen=True)
class Response:
    """The weights of a force about rest at pressure p, for ρ = c = 1: own and other, and what the
    density at the far end does to them, with P_b = p + (ρ_b − 1)."""

    own: Any
    other: Any
    own_slope: Any
    other_slope: Any

    @property
    def pull(self) -> Any:
        """Φ."""
        return self.own + self.other

    @property
    def slope(self) -> Any:
        """∂Φ/∂ρ_b."""
        return self.own_slope + self.other_slope


def respond(force: Force, pressure: Any) -> Response:
    """The response of a force; `pressure` from any field."""
    one = pressure * 0 + 1
    ends = (Tangent(pressure), Tangent(pressure, one), Tangent(one), Tangent(one, one))
    own, other = _tangent(force.own(*ends)), _tangent(force.other(*ends))
    return Response(own.value, other.value, own.slope, other.slope)


def require(
    force: Force, kind: str, stress: ArtificialStress | None = None, volume: str = "summation"
) -> None:
    """Raises ValueError where there is no formula for this form on this lattice."""
    if force.gradient == GRAD_H and volume != "summation":
        raise ValueError(
            f"volume: got {volume} for the form {force.name}, whose h follows the summed density;"
            " expected summation"
        )
    if volume == "corrected" and force.gradient != CORRECTED:
        raise ValueError(
            "volume: corrected is a density by the corrected divergence, which the form"
            f" {force.name} does not have; expected a csph form"
        )
    if force.gradient == STAGGERED and kind != "uniform":
        raise ValueError(
            f"form: {force.name} has stress points midway between neighbours on a line; on the"
            f" lattice {kind} it has no formula, expected --dim 1"
        )
    if KINDS[kind].turned is not None and force.gradient in (CORRECTED, REFERENCE):
        raise ValueError(
            f"form: {force.name} has no formula on {kind}, whose cell has two particles that a"
            " uniform strain moves against each other; expected fcc or bcc, or a form without"
            " correction"
        )
    if stress is not None and (force.name not in ("symmetric", "symmetric-product")):
        raise ValueError(
            f"remedy: artificial stress belongs to the form symmetric, not to {force.name}"
        )


def dynamical(
    force: Force,
    waves: LatticeWaves,
    pressure: Any,
    stress: ArtificialStress | None = None,
    spacing: Any = None,
    corrected: bool = False,
) -> Any:
    """D(k) in units of c²/h², (…, nd, nd), in the numbers of `waves`.

    pressure: p = P₀/(ρc²), in the same numbers; stress: artificial stress, which acts for p < 0;
    spacing: the kernel at the spacing Δp of the artificial stress, in the numbers of `waves`, which
    for stress points are those of the points midway; corrected: whether the density moves by the
    corrected divergence, δρ = iVS·ξ/M₁.
    """
    d = waves.dim
    rest = respond(force, pressure)
    out, into = waves.vector(waves.gradient)
    if force.gradient in (PLAIN, STAGGERED):
        matrix = rest.slope * (out @ into)
        if rest.pull != 0:
            matrix = matrix + rest.pull * waves.tensor(waves.hessian)
        if stress is not None and pressure < 0:
            matrix = matrix - stress.epsilon * _stressed(waves, rest, stress, spacing, into)
        return matrix
    if force.gradient == REFERENCE:  # the pressure of the reference state cancels
        return out @ into
    if force.gradient == GRAD_H:
        return _grad_h(waves, rest, out, into)
    if force.gradient == CORRECTED:
        first = -waves.total(waves.f1 * waves.squares) / d  # M₁ of the correction, C = 1/M₁
        if corrected:
            into = into / first
        matrix = rest.slope / first * (out @ into)
        if rest.pull != 0:
            matrix = matrix + rest.pull / first * waves.tensor(waves.hessian)
        if rest.other != 0:
            matrix = matrix - rest.other / first**2 * _corrected(waves, out, into)
        return matrix
    raise ValueError(f"form: {force.name} has an unknown gradient {force.gradient!r}")


def _stressed(
    waves: LatticeWaves, rest: Response, stress: ArtificialStress, spacing: Any, into: Any
) -> Any:
    """The terms of K = fⁿ∇W in place of ∇W, ∇K = fⁿ∇∇W + n f^{n−1} ∇W∇Wᵀ/W(Δp)."""
    n, f, g = stress.power, waves.f0 / spacing, waves.gradient
    steep = (f**n)[:, None, None] * waves.hessian
    bent = (n * f ** (n - 1) / spacing)[:, None, None] * g[:, :, None] * g[:, None, :]
    matrix = rest.pull * waves.tensor(steep + bent)
    if stress.frozen:
        return matrix
    out, _ = waves.vector((f**n)[:, None] * g)
    return matrix + rest.slope * (out @ into)


def damping(waves: LatticeWaves) -> Any:
    """Γ of artificial viscosity, linearised, in units of αc/h: ẍ = −Dx − αΓẋ with

        Γ = −V Σ (1 − cos k·r) ∇W rᵀ/r²

    for pairs that approach and that recede (Monaghan & Gingold 1983,
    doi:10.1016/0021-9991(83)90036-0).
    """
    s = waves.offsets
    return waves.tensor(-(waves.f1 / waves.squares)[:, None, None] * s[:, :, None] * s[:, None, :])


def _grad_h(waves: LatticeWaves, rest: Response, out: Any, into: Any) -> Any:
    """h = η (m/ρ)^{1/d}: δh = −(h/d) δρ/ρ, and Ω = 1 + (h/d) V Σ ∂_hW with all that it sees."""
    d, s, q2 = waves.dim, waves.offsets, waves.squares
    # ∂_hŴ = −(dŴ + qŴ′),   ∂²_hŴ = d(d+1)Ŵ + 2(d+1)qŴ′ + q²Ŵ″,   with Ŵ″ = f₁ + q²f₂
    grown = -(d * waves.f0 + q2 * waves.f1)
    again = d * (d + 1) * waves.f0 + (2 * d + 3) * q2 * waves.f1 + q2 * q2 * waves.f2
    first = waves.total(grown) - d * waves.home * waves.volume
    second = waves.total(again) + d * (d + 1) * waves.home * waves.volume
    omega = 1 + first / d
    grown_out, grown_into = waves.vector(-((d + 2) * waves.f1 + q2 * waves.f2)[:, None] * s)
    density = into / omega
    change = grown_into / d - (first * (d + 1) / d**2 + second / d**2) * density  # of Ω
    matrix = rest.slope / omega * (out @ density) - rest.other / omega**2 * (out @ change)
    matrix = matrix - rest.other / (omega * d) * (grown_out @ density)
    if rest.pull != 0:
        matrix = matrix + rest.pull / omega * waves.tensor(waves.hessian)
    return matrix


def _corrected(waves: LatticeWaves, out: Any, into: Any) -> Any:
    """Columns δB S, with B = Σ V (x_b − x_a)⊗∇_bW and ξ along each axis,

    δB = −V (S ξᵀ + Σ sin(k·r) r (H·ξ)) + δρ V Σ cos(k·r) ∇W rᵀ.
    """
    d, s = waves.dim, waves.offsets
    weight = waves.volume * waves.count
    bent = s[:, :, None, None] * waves.hessian[:, None, :, :]  # r_j H_il
    g = waves.gradient[:, :, None] * s[:, None, :]
    u = weight * (waves.sine @ bent.reshape(len(s), -1))
    y = weight * ((1 - waves.versine) @ g.reshape(len(s), -1))
    u = u.reshape(*u.shape[:-1], d, d, d)  # j, i, l
    y = y.reshape(*y.shape[:-1], d, d)
    S = out[..., 0]
    # (δB S)_i for ξ = e_l: −S_i S_l − Σ_j U_jil S_j + δρ_l Σ_j Y_ij S_j
    turned = (u * S[..., :, None, None]).sum(axis=-3)
    return -S[..., :, None] * S[..., None, :] - turned + (y @ S[..., :, None]) * into
