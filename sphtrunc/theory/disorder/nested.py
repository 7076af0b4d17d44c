"""Second neighbours: the nested form on a lattice, applied to any field, and what displacements of
the particles do to it.

Seen from the target, with λ_b = V_b w_i(s_b) and G_b = Σ_c V_c w_j(s_c − s_b) (A_c − A_b),

    D = Σ_b λ_b (G_b − G_a),    ∂D/∂s_p = Σ_b ∂λ_b/∂s_p (G_b − G_a) + Σ_b λ_b ∂(G_b − G_a)/∂s_p,

over pairs (b, c) that are listed once. The weights of a corrected gradient depend on base sums, and
their slopes with respect to these are carried on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.dual import Dual
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import Key
from sphtrunc.scenes.sites import KINDS
from sphtrunc.theory.disorder.sensitivities import (
    Terms,
    around,
    dual_coefficients,
    volumes_of,
)
from sphtrunc.theory.fields import Signals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.arrangement import Arrangement

_CHUNK = 1 << 22  # distances looked at together


class SecondNeighbours:
    """The particles that the nested form reaches from one target on a lattice.

    index: (d, M) integer points; s: (M, d) offsets in h; target: the row of the particle that is
    the target, −1 at an offset
    """

    def __init__(
        self,
        kernel: Kernel | Gaussian,
        operator: Operator,
        scene: Arrangement,
        moved: Array | None = None,
    ) -> None:
        """moved: displacements, (M, d) in Δx, at which everything is evaluated."""
        self.operator, self.dim, self.ratio = operator, scene.dim, float(scene.dx_over_h)
        self.index, self.s, self.target = around(kernel, scene, 2, moved)
        self.volumes, self.variation = volumes_of(kernel, self.s, scene, 2)
        s, square = self.s, (float(kernel.support) * (1 + 1e-9)) ** 2
        self.near = np.flatnonzero((s * s).sum(axis=1) <= square)
        # the places where a gradient is taken: at every neighbour b, and last at the target
        at = np.concatenate([s[self.near], np.zeros((1, self.dim))])
        self.b, self.c = pairs_within(s, at, square)
        self.outer = self.b == len(self.near)
        t = s[self.c] - at[self.b]
        itself = (t == 0.0).all(axis=1)
        self.terms = terms = Terms(kernel, t, itself)
        gradient = operator.gradient
        keys = gradient.needed(self.dim, 0)
        self.keys = [] if gradient.uncorrected else keys
        places = np.arange(len(at))
        if moved is None:  # one neighbour of each sort stands for all
            turned = KINDS[scene.kind].turned
            sort = np.zeros(len(self.near), dtype=np.int64)
            if turned is not None:
                sort += turned(self.index[:, self.near])
            _, first, places = np.unique([*sort, 2], return_index=True, return_inverse=True)
        else:
            first = places
        self.first, self.sort = first, places  # a place of each sort, the sort of each place
        self.g = {key: terms.sampled(key) for key in keys}
        rows = [self.coefficients(int(place)) for place in first]
        for key in (key for row in rows[0] for key in row):
            if key not in self.g:
                self.g[key] = terms.sampled(key)
        #: per axis and key: c at every place, and its slopes with respect to the base sums
        self.value: list[dict[Key, Array]] = []
        self.slope: list[dict[Key, Array]] = []
        for j in range(self.dim):
            found = {key: [row[j][key] for row in rows] for key in rows[0][j]}
            self.value.append(
                {key: np.array([x.value for x in row])[places] for key, row in found.items()}
            )
            self.slope.append(
                {key: np.array([x.slope for x in row])[places] for key, row in found.items()}
            )
        self.w = [self._weighted(j, 0) for j in range(self.dim)]
        self.dw = [self._weighted(j, 1) for j in range(self.dim)]

    def coefficients(self, place: int, change: Sequence[float] = ()) -> list[dict[Key, Any]]:
        """The coefficients of the gradient at a place, with base sums changed by so much, and their
        slopes with respect to these."""
        pairs = np.flatnonzero(self.b == place)
        v = self.volumes[self.c[pairs]]
        more, slopes = change or [0.0] * len(self.keys), np.eye(len(self.keys))
        means = {
            key: Dual(float(v @ self.g[key][0][pairs]) + x, slope)
            for key, x, slope in zip(self.keys, more, slopes, strict=True)
        }
        return dual_coefficients(self.operator.gradient, means, self.dim)

    def _weighted(self, j: int, order: int) -> Array:
        """w_j for every pair, (P,), or its gradient, (P, d)."""
        return np.asarray(
            sum(
                c[self.b] * self.g[key][0] if order == 0 else c[self.b, None] * self.g[key][1]
                for key, c in self.value[j].items()
            )
        )

    def _sum(self, x: Array) -> Array:
        """Σ_c V_c x at every place."""
        return binned(self.b, self.volumes[self.c] * x, len(self.near) + 1)

    def estimate(self, signals: Signals) -> tuple[Array, Array]:
        """The estimates, (K, C, F), and √Σ of the squares of their terms."""
        values = signals.difference(self.s)
        rows = self.operator.axes(self.dim)
        parts = np.zeros((len(values), len(rows), values.shape[1]))
        squares = np.zeros_like(parts)
        for k, f in np.ndindex(*values.shape[:2]):
            difference = self.differences(values[k, f])
            for c, row in enumerate(rows):
                for i, j in row:
                    term = self.w[j] * difference
                    g = self._sum(term)
                    size = self._sum(self.volumes[self.c] * term**2)
                    weight = self.volumes[self.near] * self.w[i][self.outer]
                    parts[k, c, f] += float(weight @ (g[:-1] - g[-1]))
                    squares[k, c, f] += float(weight**2 @ (size[:-1] + g[:-1] ** 2))
        return parts, np.sqrt(squares)

    def slopes(self, signals: Signals) -> dict[tuple[int, ...], Array]:
        """∂E/∂u for displacements u in Δx, (M, d), of every signal, component and part."""
        values, ahead = signals.difference(self.s), signals.gradient(self.s)
        return {
            (k, c, f): slope
            for k, f in np.ndindex(*values.shape[:2])
            for c, slope in enumerate(self._moved(self.differences(values[k, f]), ahead[k, f]))
        }

    def differences(self, values: Array) -> Array:
        """A_c − A_b for every pair, from A less its value at the target, (M,)."""
        inside = np.concatenate([values[self.near], [0.0]])
        return np.asarray(values[self.c] - inside[self.b])

    def _moved(self, difference: Array, gradient: Array) -> list[Array]:
        """∂D/∂u, (M, d), of every component; gradient: ∇A, (M, d)."""
        result = []
        for row in self.operator.axes(self.dim):
            force = np.zeros_like(self.s)
            by_volume = np.zeros(len(self.s))
            for i, j in row:
                self._add(i, j, difference, gradient, force, by_volume)
            moves = self.ratio * force
            if self.target >= 0:
                moves[self.target] = 0.0
                moves[self.target] = -moves.sum(axis=0)
            result.append(moves if self.variation is None else moves + self.variation(by_volume))
        return result

    def _add(
        self, i: int, j: int, difference: Array, gradient: Array, force: Array, by_volume: Array
    ) -> None:
        """Add ∂D/∂s and ∂D/∂V of ⟨∂ᵢ⟨∂ⱼA⟩⟩."""
        v, near, c, b, outer = self.volumes, self.near, self.c, self.b, self.outer
        g = self._sum(self.w[j] * difference)
        rise = g[:-1] - g[-1]
        weight = v[near] * self.w[i][outer]
        weight = np.concatenate([weight, [-weight.sum()]])[b]
        psi = self.w[j] * difference
        dpsi = self.dw[j] * difference[:, None]
        for key, slope in self.slope[j].items() if self.keys else ():
            seen = self._sum(self.g[key][0] * difference)
            for m, other in enumerate(self.keys):
                y = (slope[:, m] * seen)[b]
                psi = psi + y * self.g[other][0]
                dpsi = dpsi + y[:, None] * self.g[other][1]
        by_volume += binned(c, weight * psi, len(v))
        at_b = near[b[~outer]]
        for axis in range(self.dim):
            own = weight * v[c]
            at_c = own * (dpsi[:, axis] + self.w[j] * gradient[c, axis])
            force[:, axis] += binned(c, at_c, len(v))
            there = own[~outer] * self.w[j][~outer] * gradient[at_b, axis]
            there += own[~outer] * dpsi[~outer, axis]
            force[:, axis] -= binned(at_b, there, len(v))
        psi, dpsi = self.w[i][outer] * rise, self.dw[i][outer] * rise[:, None]
        for key, slope in self.slope[i].items() if self.keys else ():
            seen_here = float(v[near] @ (self.g[key][0][outer] * rise))
            for m, other in enumerate(self.keys):
                y_here = float(slope[-1, m]) * seen_here
                psi = psi + y_here * self.g[other][0][outer]
                dpsi = dpsi + y_here * self.g[other][1][outer]
        by_volume[near] += psi
        force[near] += v[near, None] * dpsi


def binned(at: NDArray[Any], x: Array, count: int) -> Array:
    """Σ x over the entries of each of `count` places."""
    return np.asarray(np.bincount(at, weights=x, minlength=count), dtype=np.float64)


def pairs_within(s: Array, at: Array, reach: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """(b, c) with |s_c − at_b|² <= reach, by b."""
    step = max(1, _CHUNK // len(s))
    found = []
    for first in range(0, len(at), step):
        square: Any = 0.0
        for axis in range(s.shape[1]):
            gap = s[:, axis] - at[first : first + step, None, axis]
            square = square + gap * gap
        b, c = np.nonzero(square <= reach)
        found.append((b + first, c))
    return np.concatenate([b for b, _ in found]), np.concatenate([c for _, c in found])
