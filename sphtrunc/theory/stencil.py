"""Stencils: an estimate on a lattice as a finite-difference formula, Σ_b w_b A(x + s_b).

A stencil is a value. Its moments are Σ w s^α; its symbol Σ w e^{ik·s}, which of a gradient is i
times the modified wavenumber; the product of two, Σ_b Σ_c w_b v_c A(x + s_b + t_c), is an estimate
of an estimate, so that the nested form is made of products of gradients:

    ⟨∂ᵢ⟨∂ⱼA⟩⟩_a = Σ_b λ_b (⟨∂ⱼA⟩_b − ⟨∂ⱼA⟩_a)    is    λ @ G_b − (Σ λ) G_a.

The numbers are those of `lattice_sums`: exact rationals where coordinates, distances and the
kernel's constant are rational, as always in 1D; else 50 digits. What displacements do to the nested
form does not come out of a product, which no longer knows the particles between: see
`sphtrunc.theory.disorder.nested`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import prod
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.moments import MultiIndex, unit
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.operators.terms import parts
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.lattice_sums import (
    DIGITS,
    _at_origin,
    lattice_sums,
    radial_values,
    real_context,
)

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.scenes.arrangement import Arrangement

Offset = tuple[Fraction, ...]


@dataclass(frozen=True)
class Stencil:
    """weights: offset s in h -> w, in h^{−k} for a derivative of order k."""

    weights: Mapping[Offset, Any]

    def moment(self, alpha: MultiIndex) -> Any:
        """M_α = Σ w s^α."""
        return sum(
            w * prod((x**n for x, n in zip(s, alpha, strict=True)), start=Fraction(1))
            for s, w in self.weights.items()
        )

    def symbol(self, k: Sequence[Any]) -> Any:
        """Σ w e^{ik·s} at a wave vector in 1/h, in 50 digits."""
        ctx = real_context()
        waves = (sum(n * ctx.mpf(x) for n, x in zip(s, k, strict=True)) for s in self.weights)
        return ctx.fdot(
            (w, ctx.expj(at)) for at, w in zip(waves, self.weights.values(), strict=True)
        )

    def __add__(self, other: Stencil) -> Stencil:
        return _gathered([*self.weights.items(), *other.weights.items()])

    def __mul__(self, factor: Any) -> Stencil:
        return Stencil({s: factor * w for s, w in self.weights.items()})

    def __matmul__(self, other: Stencil) -> Stencil:
        """The estimate by this one of what the other gives at every one of its places."""
        return _gathered(
            (tuple(x + y for x, y in zip(s, t, strict=True)), w * v)
            for s, w in self.weights.items()
            for t, v in other.weights.items()
        )


def _gathered(rows: Iterable[tuple[Offset, Any]]) -> Stencil:
    """Weights of equal offsets together."""
    weights: dict[Offset, Any] = {}
    for s, w in rows:
        weights[s] = weights[s] + w if s in weights else w
    return Stencil(weights)


def stencils(kernel: Kernel | Gaussian, operator: Operator, scene: Arrangement) -> list[Stencil]:
    """The stencil of every component of an operator on a lattice without displacements.

    Raises ValueError as `lattice_sums` does, where the matrix of a correction is singular, beside
    a wall, and in the nested form for particles that differ in what they see.
    """
    if scene.wall is not None or scene.sigma:
        raise ValueError("scene: a stencil is that of an endless lattice; expected no wall, jitter")
    operator.require_pairs(scene.paired)
    if operator.form == NESTED:
        if KINDS[scene.kind].turned is not None:
            raise ValueError(
                f"lattice: the neighbours of a particle of {scene.kind} differ in what they see;"
                " expected another lattice, or another form"
            )
        outer = _sampled(kernel, operator.gradient, scene)
        inner = stencils(kernel, operator.gradient, scene.seen_from())
        here = stencils(kernel, operator.gradient, scene)
        return [
            _sum(outer[i] @ inner[j] + here[j] * -sum(outer[i].weights.values()) for i, j in row)
            for row in operator.axes(scene.dim)
        ]
    own = (Fraction(0),) * scene.dim
    return [
        one + Stencil({own: (operator.copies - 1) * sum(one.weights.values()) + operator.adds_own})
        for one in _sampled(kernel, operator, scene)
    ]


def _sum(some: Iterable[Stencil]) -> Stencil:
    return _gathered(row for one in some for row in one.weights.items())


def _sampled(kernel: Kernel | Gaussian, operator: Operator, scene: Arrangement) -> list[Stencil]:
    """w_b = V_b g(s_b) of every component, with which the form sees A_b alone."""
    dim, ctx = scene.dim, real_context()
    support, sigma = fraction(kernel.support), kernel.normalisation(dim)
    points = scene.exact_positions(scene.sites(float(support / scene.dx_over_h)))
    lengths = [(tuple(s), sum((x * x for x in s), Fraction(0))) for s in points]
    around, squares = zip(*(row for row in lengths if 0 < row[1] <= support**2), strict=True)
    needed = operator.needed(dim, 0)
    sums = {} if operator.uncorrected else lattice_sums(kernel, needed, scene)
    factors = {k for key in needed for _, _, k in parts(key)}
    exact = isinstance(kernel, Kernel) and sigma.is_Rational
    radial, exact = radial_values(kernel, factors, squares, exact, dim)

    def number(x: Any) -> Any:
        if not hasattr(x, "evalf"):
            return x
        return fraction(x) if exact else ctx.mpf(str(x.evalf(DIGITS + 10)))

    volume = number(sigma) * scene.dx_over_h**dim
    if scene.volume == "summation":
        plain, zero = replace(scene, volume="constant"), (unit(dim, 0, 0),) * 2
        volume = volume / number(lattice_sums(kernel, [zero], plain.seen_from())[zero])
    result = []
    for part in operator.coefficients(sums, dim):
        weights = {}
        for n, s in enumerate(around):
            weights[s] = volume * sum(
                number(c) * sign * prod(x**p for x, p in zip(s, beta, strict=True)) * radial[k][n]
                for key, c in part.items()
                for sign, beta, k in parts(key)
            )
        if any(r2 == 0 for _, r2 in lengths):
            at = sum(
                number(c) * _at_origin(kernel, key, True, Fraction(1), exact)
                for key, c in part.items()
            )
            weights[(Fraction(0),) * dim] = volume * at
        result.append(Stencil(weights))
    return result
