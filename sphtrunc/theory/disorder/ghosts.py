"""Ghosts of displaced particles: what displacements do to the moments beside a wall with images or
dummies beyond it.

A displaced particle stands twice in the sums, at its place and at that of its image, and a dummy
carries what the particles around it do; so the derivatives of a moment M_α(u) are taken of the
whole sum, by central differences: Var M_α = σ² Σ |∂M_α/∂u_b|², and the mean moves by
σ²/2 Σ ∂²M_α/∂u_b².
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from sphtrunc.kernels.factors import factor_values
from sphtrunc.operators.moments import MultiIndex, multi_indices, unit
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import VALUE, monomial, parts
from sphtrunc.theory.disorder.sensitivities import mixing

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.arrangement import Arrangement

_STEP = 1e-3  # of the differences, in Δx
_BLOCK = 1 << 20  # terms at a time


class Ghosted:
    """The particles that a target beside a wall sees, and their ghosts, at any displacements.

    index: (d, M) integer points of the particles; target: the row of the particle that is the
        target, −1 where the target does not move
    """

    def __init__(
        self,
        kernel: Kernel,
        operator: Operator,
        scene: Arrangement,
        degree: int,
        axis: int,
    ) -> None:
        import numpy as np

        assert scene.wall is not None
        self.kernel, self.operator, self.axis = kernel, operator, axis
        self.wall = wall = scene.wall
        self.dim, self.ratio = scene.dim, float(scene.dx_over_h)
        self.alphas = list(multi_indices(self.dim, degree))
        eta, support = float(wall.eta), float(kernel.support)
        dummy = wall.ghosts == "dummy"
        # an image within reach has its original within 2η + κ
        reach = 2.0 * support if dummy else support + 2.0 * eta
        around = replace(scene, wall=None).sites(reach / self.ratio + 1.0)
        fluid = around[0] >= -scene.wall_phase
        self.index = around[:, fluid]
        self.points, beyond = scene.positions(self.index), scene.positions(around[:, ~fluid])
        self.dummies = beyond[(beyond**2).sum(axis=1) <= (support + self.ratio) ** 2]
        self.target = int(np.argmin((self.points**2).sum(axis=1))) if scene.at_particle else -1

    def moments(self, moved: Array) -> dict[MultiIndex, Array]:
        """M_α, (D,), at displacements (D, M, d) in Δx."""
        import numpy as np

        from sphtrunc.arithmetic.linear_systems import Health
        from sphtrunc.arithmetic.small_systems import solve

        count = len(moved)
        own = moved[:, self.target] if self.target >= 0 else np.zeros((count, self.dim))
        s = self.points + self.ratio * (moved - own[:, None])
        there = -float(self.wall.eta) - self.ratio * own[:, :1]  # s₁ of the wall
        ghosts = s.copy()
        if self.wall.ghosts == "dummy":
            ghosts = self.dummies - self.ratio * own[:, None]
        else:
            ghosts[..., 0] = 2.0 * there - s[..., 0]
        every = np.concatenate([s, ghosts], axis=1)
        q = np.sqrt((every * every).sum(axis=-1))
        factor = cache(lambda k: factor_values(self.kernel, k, q, self.dim))
        volume = self.ratio**self.dim
        g = cache(
            lambda key: volume * sum(c * monomial(every, b) * factor(k) for c, b, k in parts(key))
        )
        operator, zero = self.operator, unit(self.dim, 0, 0)
        needed = [] if operator.uncorrected else operator.needed(self.dim, 0)
        sums = {key: g(key).sum(axis=1) for key in needed}
        rows = operator.coefficients(sums, self.dim, partial(solve, health=Health()))
        weights: Any = sum(np.asarray(c)[..., None] * g(key) for key, c in rows[self.axis].items())
        found = {}
        for alpha in self.alphas:
            here = monomial(s, alpha) + 0.0 * s[..., 0]
            values = [here, self._read(alpha, here, s, there, ghosts)]
            found[alpha] = (weights * np.concatenate(values, axis=1)).sum(axis=1)
        found[zero] = operator.zeroth(found[zero]) + 0.0 * found[zero]
        return found

    def _read(self, alpha: MultiIndex, here: Array, s: Array, there: Array, ghosts: Array) -> Array:
        """What the ghosts carry of s^α, which is `here` at the particles."""
        import numpy as np

        if self.wall.ghosts == "mirror":
            return np.asarray(here)
        if self.wall.ghosts == "odd":
            foot = s.copy()
            foot[..., 0] = there
            return np.asarray(2.0 * monomial(foot, alpha) - here)
        gap = s[:, None] - ghosts[:, :, None]
        weight = factor_values(self.kernel, VALUE, np.sqrt((gap * gap).sum(axis=-1)), self.dim)
        density = weight.sum(axis=2)
        mean = (weight * here[:, None]).sum(axis=2)
        return np.asarray(mean / np.where(density > 0.0, density, 1.0))

    def derivatives(self) -> tuple[dict[MultiIndex, Array], dict[MultiIndex, float]]:
        """∂M_α/∂u, (M, d), and Σ ∂²M_α/∂u²; displacements in Δx."""
        import numpy as np

        rows, dim = self.points.shape
        own = self.moments(np.zeros((1, rows, dim)))
        slopes = {alpha: np.zeros((rows, dim)) for alpha in self.alphas}
        curves = dict.fromkeys(self.alphas, 0.0)
        width = rows * (1 + (len(self.dummies) if self.wall.ghosts == "dummy" else 1))
        block = max(1, _BLOCK // width)
        places = [(b, i) for b in range(rows) for i in range(dim)]
        for first in range(0, len(places), block):
            some = places[first : first + block]
            moved = np.zeros((len(some), rows, dim))
            for n, (b, i) in enumerate(some):
                moved[n, b, i] = _STEP
            up, down = self.moments(moved), self.moments(-moved)
            for alpha in self.alphas:
                change = (up[alpha] - down[alpha]) / (2.0 * _STEP)
                bend = (up[alpha] + down[alpha] - 2.0 * own[alpha]) / _STEP**2
                curves[alpha] += float(np.sum(bend))
                for (b, i), value in zip(some, np.broadcast_to(change, len(some)), strict=True):
                    slopes[alpha][b, i] = value
        return slopes, curves


def moved_with_ghosts(
    kernel: Kernel, operator: Operator, scene: Arrangement, degree: int, axis: int
) -> tuple[dict[MultiIndex, float], dict[MultiIndex, float]]:
    """What displacements add to the mean of every moment, and its standard deviation."""
    seen = Ghosted(kernel, operator, scene, degree, axis)
    slopes, curves = seen.derivatives()
    mixed = mixing(scene, seen.index)
    shift, std = {}, {}
    for alpha, slope in slopes.items():
        row = slope if mixed is None else mixed.T @ slope
        std[alpha] = scene.sigma * float((row * row).sum()) ** 0.5
        shift[alpha] = 0.5 * scene.sigma**2 * curves[alpha] if mixed is None else 0.0
    return shift, std
