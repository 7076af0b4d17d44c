"""First neighbours: those of a target on a lattice, with what their displacements change.

Numbers carry their derivatives with respect to the displacements, through sums, volumes and the
algebra of the corrections.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from sphtrunc.arithmetic.dual import Dual, dual_solve
from sphtrunc.kernels.factors import factor_values
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.operators.terms import SLOPE, Key, lowered, monomial, parts

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.scenes.arrangement import Arrangement


class Terms:
    """The terms of base sums at offsets s, (N, d), from a target; itself: (N,) where it is."""

    def __init__(self, kernel: Kernel | Gaussian, s: Array, itself: NDArray[np.bool_]) -> None:
        import numpy as np

        self.kernel, self.s, self.itself = kernel, s, itself
        self.q = np.sqrt((s * s).sum(axis=1))
        self._factors: dict[tuple[int, int], Array] = {}

    def _factor(self, k: int, order: int) -> Array:
        """D^order f_k at every offset; at the target itself only what a sum sees there."""
        import numpy as np

        if (k, order) not in self._factors:
            q = np.where(self.itself, 0.0, self.q)
            self._factors[k, order] = factor_values(self.kernel, k, q, self.s.shape[1], order)
        return self._factors[k, order]

    def sampled(self, key: Key) -> tuple[Array, Array]:
        """g and ∇g of the term of a base sum, (N,) and (N, d)."""
        import numpy as np

        s = self.s
        g, slope = np.zeros_like(self.q), np.zeros_like(s)
        for c, beta, k in parts(key):
            f, df = self._factor(k, 0), self._factor(k, 1)
            whole = monomial(s, beta)
            g += c * whole * f
            for i, n in enumerate(beta):
                slope[:, i] += c * whole * df * s[:, i]
                if n:
                    slope[:, i] += c * n * monomial(s, lowered(beta, i)) * f
        return g, slope


class FirstNeighbours:
    """The neighbours of one target on a lattice, with what their displacements change.

    index: (d, N) integer points; s: (N, d) offsets in h; target: the row of the particle that is
    the target itself, −1 where the target is not a particle (an offset) and does not move.
    """

    def __init__(
        self,
        kernel: Kernel | Gaussian,
        scene: Arrangement,
        moved: Array | None = None,
    ) -> None:
        """moved: displacements, (N, d) in Δx, at which everything is evaluated."""
        import numpy as np

        self.kernel, self.dim, self.ratio = kernel, scene.dim, float(scene.dx_over_h)
        self.index, self.s, self.target = around(kernel, scene, 1, moved)
        self.volumes, self.variation = volumes_of(kernel, self.s, scene)
        self._terms = Terms(kernel, self.s, np.arange(len(self.s)) == self.target)

    def sampled(self, key: Key) -> tuple[Array, Array]:
        """g_b and ∇g_b of the term of a base sum, (N,) and (N, d)."""
        return self._terms.sampled(key)

    def total(self, g: Array, slope: Array, power: int = 1) -> Dual:
        """Σ_b V_b g_b and its derivatives with respect to displacements in Δx.

        power: n of V_bⁿ V_a^{1−n} in place of V_b: the symmetric form of particles of equal mass
        has V_b ρ_a/ρ_b = V_b²/V_a before A_b, and V_b ρ_b/ρ_a = V_a before A_a.
        """
        if self.variation is None:
            volumes = self.volumes
        elif power == 1 or self.target >= 0:
            own = self.volumes[self.target]
            volumes = self.volumes**power * own ** (1 - power)
        else:
            raise ValueError("form: symmetric needs a target that is a particle; expected offset 0")
        value = float(volumes @ g)
        moves = self.ratio * volumes[:, None] * slope
        if self.target >= 0:
            moves[self.target] = 0.0
            moves[self.target] -= moves.sum(axis=0)
        if self.variation is not None:
            varied = power * volumes / self.volumes * g
            if power != 1:
                varied[self.target] += (1 - power) * value / own
            moves = moves + self.variation(varied)
        return Dual(value, moves)

    def base_sum(self, key: Key, power: int = 1) -> Dual:
        """m[δ, α]."""
        return self.total(*self.sampled(key), power)


def dual_coefficients(
    operator: Operator, means: Mapping[Key, Dual], dim: int
) -> list[dict[Key, Dual]]:
    """c_key of every component, with their slopes."""
    import numpy as np

    none = np.zeros_like(next(iter(means.values())).slope) if means else 0.0
    return [
        {key: c if isinstance(c, Dual) else Dual(float(c), none) for key, c in part.items()}
        for part in operator.coefficients(means, dim, dual_solve)
    ]


def around(
    kernel: Kernel | Gaussian, scene: Arrangement, reach: int, moved: Array | None
) -> tuple[NDArray[Any], Array, int]:
    """The particles that an estimate depends on, whose sums reach so many supports: integer points
    (d, N), offsets (N, d) in h, and the row of the target, −1 where it is no particle.

    moved: their displacements, (N, d) in Δx
    """
    import numpy as np

    reach += scene.volume == "summation"
    radius = reach * float(kernel.support) / float(scene.dx_over_h)
    index = scene.sites(radius + (1.5 if scene.volume == "cell" else 0.0))
    s = scene.positions(index)
    target = int(np.argmin((s * s).sum(axis=1))) if scene.at_particle else -1
    if moved is not None:
        s += float(scene.dx_over_h) * moved
        if target >= 0:
            s -= s[target].copy()
    return index, s, target


def volumes_of(
    kernel: Kernel | Gaussian, s: Array, scene: Arrangement, reach: int = 1
) -> tuple[Array, Callable[[Array], Array] | None]:
    """V_b within so many supports, and how Σ_b g_b δV_b depends on the displacements, as a function
    of g."""
    import numpy as np

    ratio, dim, rule = float(scene.dx_over_h), scene.dim, scene.volume
    volumes = np.full(len(s), ratio**dim)
    if rule == "cell":
        order = np.argsort(s[:, 0])
        volumes[order[1:-1]] = 0.5 * (s[order[2:], 0] - s[order[:-2], 0])

        def cells(g: Array) -> Array:
            """V_b = (x_{b+1} − x_{b−1})/2: particle b widens b−1 and narrows b+1."""
            h = g[order]
            slope = np.zeros((len(s), 1))
            slope[order[1:-1], 0] = 0.5 * ratio * (h[:-2] - h[2:])
            return slope

        return volumes, cells
    if rule == "summation":
        support = float(kernel.support)
        inner = (s * s).sum(axis=1) <= (reach * support * (1 + 1e-9)) ** 2
        pair = s[None, :, :] - s[inner][:, None, :]  # (b, c): s_c − s_b
        q = np.sqrt((pair * pair).sum(axis=2))
        near = (q > 0) & (q <= support)
        density = np.zeros_like(q)
        density[q <= support] = kernel.w(q[q <= support], dim)
        volumes[inner] = 1.0 / density.sum(axis=1)
        slope = np.zeros_like(q)
        slope[near] = factor_values(kernel, SLOPE, q[near], dim)
        gradient = slope[:, :, None] * pair

        def summed(g: Array) -> Array:
            """V_b = 1/Σ_c Ŵ(s_c − s_b): δV_b = −V_b² Σ_c ∇Ŵ(s_c − s_b)·(δs_c − δs_b)."""
            weight = -ratio * (g * volumes**2)[inner]
            moved = np.einsum("b,bci->ci", weight, gradient)
            moved[inner] -= weight[:, None] * gradient.sum(axis=1)
            return np.asarray(moved)

        return volumes, summed
    return volumes, None


def mixing(scene: Arrangement, index: NDArray[Any]) -> Array | None:
    """F with u = F v, v independent and of unit variance, for particles at integer points, (N, K);
    None where the displacements u are independent themselves.

    Blue displacements are u_n = (v_n − mean v over the z nearest)/√(1 + 1/z).
    """
    import numpy as np

    from sphtrunc.scenes.sites import KINDS

    if scene.distribution != "blue":
        return None
    steps = KINDS[scene.kind].nearest
    if not steps:
        raise ValueError(
            f"distribution: blue needs the same neighbours at every site, {scene.kind} has two"
            " sorts; expected gaussian or uniform, or another lattice"
        )
    scale = (1.0 + 1.0 / len(steps)) ** -0.5
    taps = [((0,) * scene.dim, scale), *((e, -scale / len(steps)) for e in steps)]
    places = np.concatenate([index.T + np.array(step) for step, _ in taps])
    _, inverse = np.unique(places, axis=0, return_inverse=True)
    columns = inverse.reshape(len(taps), -1)
    weights = np.zeros((index.shape[1], int(columns.max()) + 1))
    for row, (_, factor) in zip(columns, taps, strict=True):
        weights[np.arange(index.shape[1]), row] += factor
    return weights


def is_smooth(kernel: Kernel | Gaussian, operator: Operator, s: Array, spread: float) -> bool:
    """Whether the three derivatives of the terms that the second order needs exist where
    displacements of that standard deviation, in h, take most particles at s, (N, d)."""
    import numpy as np

    terms = {t for t, _ in operator.needed(s.shape[1], 0)}
    top = max(sum(term) if isinstance(term, tuple) else 1 for term in terms)
    smoothness = kernel.knot_smoothness()
    rough = [float(knot) for knot, n in smoothness.items() if knot and n < top + 2]
    q = np.sqrt((s * s).sum(axis=1))
    return all(np.abs(q - knot).min() > 2.5 * spread for knot in rough)


def second_order(
    slopes: Callable[[Array | None], Mapping[tuple[int, ...], Array]],
    shape: tuple[int, ...],
    excess: float,
) -> dict[tuple[int, ...], tuple[float, float]]:
    """What the second and third derivatives H, T of figures M by independent u add: Σ H_kk/2 to the
    mean (times σ²), Σ H_kl²/2 + Σ M_k T_kll + (kurtosis − 3) Σ H_kk²/4 to the variance (times σ⁴).
    Both are differences of the slopes on both sides."""
    import numpy as np

    step = 1e-3
    size = shape[0] * shape[1]
    here = slopes(None)
    curved: dict[tuple[int, ...], list[Array]] = {alpha: [] for alpha in here}
    third = {alpha: np.zeros(size) for alpha in here}
    for direction in np.eye(size):
        moved = step * direction.reshape(shape)
        up, down = slopes(moved), slopes(-moved)
        for alpha, middle in here.items():
            curved[alpha].append((up[alpha] - down[alpha]).ravel() / (2 * step))
            third[alpha] += (up[alpha] + down[alpha] - 2 * middle).ravel() / step**2
    result = {}
    for alpha, rows in curved.items():
        h = np.array(rows)
        own = np.diag(h)
        cross = float(here[alpha].ravel() @ third[alpha])
        variance = 0.5 * float((h * h).sum()) + cross + 0.25 * excess * float((own * own).sum())
        result[alpha] = 0.5 * float(own.sum()), variance
    return result
