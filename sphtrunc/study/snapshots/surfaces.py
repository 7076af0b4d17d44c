"""Surfaces: how far away a plane one is, by γ = ΣVW, and what it makes of every sum."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.kernels.factors import factor_values
from sphtrunc.operators.terms import VALUE, Key, monomial, parts

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel

_MOST_SPREAD = 0.03  # of γ by disorder: more than that is boundaries
_ACROSS, _ALONG, _ANGLES = 40, 32, 16  # nodes of the half space, good to 1e-4 of the whole
_BLOCK = 64  # targets at a time


def surface_distance(kernel: Kernel, dim: int, gamma: Array) -> Array:
    """How far away the plane surface is that leaves γ of the kernel on this side, in units of h:
    ∫_{t <= z} w₁(t) dt = γ, w₁ the kernel integrated over the plane; negative beyond the surface,
    infinite inside, where γ is within five times its own spread (the median distance of γ from its
    median, at most 0.03) of 1."""
    support = float(kernel.support)
    t = np.linspace(0.0, support, 513)
    fine = np.linspace(0.0, support, 4097)
    if dim == 1:
        projected = factor_values(kernel, VALUE, fine, dim)
    else:
        # ∫ w(√(t² + y²)) dy in 2D, 2π ∫_t^κ w r dr in 3D
        y = fine if dim == 2 else None
        projected = np.empty_like(fine)
        for i, at in enumerate(fine):
            if y is not None:
                inside = factor_values(kernel, VALUE, np.hypot(at, t), dim)
                projected[i] = 2.0 * np.trapezoid(inside, t)
            else:
                r = np.linspace(at, support, 257)
                inside = factor_values(kernel, VALUE, r, dim)
                projected[i] = 2.0 * np.pi * np.trapezoid(inside * r, r)
    half = np.concatenate([[0.0], np.cumsum(0.5 * (projected[1:] + projected[:-1]) * fine[1])])
    z = np.concatenate([-fine[:0:-1], fine])
    share = np.concatenate([0.5 - half[:0:-1], 0.5 + half])
    found = np.interp(gamma, share, z)
    spread = min(1.4826 * float(np.median(np.abs(gamma - np.median(gamma)))), _MOST_SPREAD)
    return np.where(gamma > 1.0 - max(0.02, 5.0 * spread), np.inf, found)


def half_space_sums(
    kernel: Kernel, keys: Iterable[Key], normal: Array, distance: Array
) -> dict[Key, Array]:
    """m[δ, α] with the sum replaced by the integral over the half space s·n > −η, (T,) each.

    normal: (T, d) unit vectors n into the fluid; distance: (T,) η in units of h, below the support
    """
    keys = list(keys)
    found = {key: np.zeros(distance.size) for key in keys}
    for first in range(0, distance.size, _BLOCK):
        part = slice(first, first + _BLOCK)
        s, weight = _half_ball(float(kernel.support), normal[part], distance[part])
        q = np.sqrt((s * s).sum(axis=-1))
        flat = q.reshape(-1)
        factors = {
            k: weight * factor_values(kernel, k, flat, normal.shape[1]).reshape(q.shape)
            for k in {k for key in keys for _, _, k in parts(key)}
        }
        for key in keys:
            terms = (float(c) * (monomial(s, beta) * factors[k]) for c, beta, k in parts(key))
            found[key][part] = sum(term.sum(axis=1) for term in terms)
    return found


def _half_ball(support: float, normal: Array, distance: Array) -> tuple[Array, Array]:
    """Nodes (T, M, d) and weights (T, M) of the support cut by the plane: Gauss along n from −η to
    κ, and in the planes across it."""
    dim = normal.shape[1]
    low = -np.minimum(distance, support)[:, None]
    t, w = np.polynomial.legendre.leggauss(_ACROSS)
    z = low + 0.5 * (support - low) * (1.0 + t)
    across = 0.5 * (support - low) * w
    if dim == 1:
        return (z * normal)[:, :, None], across
    radius = np.sqrt(np.maximum(support**2 - z * z, 0.0))
    t, w = np.polynomial.legendre.leggauss(_ALONG)
    if dim == 2:
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        p = radius[:, :, None] * t
        weight = across[:, :, None] * radius[:, :, None] * w
        s = z[:, :, None, None] * normal[:, None, None] + p[..., None] * tangent[:, None, None]
        return s.reshape(len(s), -1, 2), weight.reshape(len(s), -1)
    phi = (np.arange(_ANGLES) + 0.5) * (2.0 * np.pi / _ANGLES)
    helper = np.eye(3)[np.abs(normal).argmin(axis=1)]
    one = np.cross(normal, helper)
    one /= np.sqrt((one * one).sum(axis=1))[:, None]
    two = np.cross(normal, one)
    rim = np.cos(phi)[:, None] * one[:, None] + np.sin(phi)[:, None] * two[:, None]
    p = 0.5 * radius[:, :, None] * (1.0 + t)
    weight = across[:, :, None] * 0.5 * radius[:, :, None] * w * p * (2.0 * np.pi / _ANGLES)
    s = (
        z[:, :, None, None, None] * normal[:, None, None, None]
        + p[..., None, None] * rim[:, None, None]
    )
    weight = np.broadcast_to(weight[..., None], s.shape[:-1])
    return s.reshape(len(s), -1, 3), weight.reshape(len(s), -1)
