"""Stencils: the neighbours of a target on a lattice, with what their displacements change.

Numbers carry their derivatives with respect to the displacements, through sums, volumes and the
algebra of the corrections.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from sphtrunc.kernel import Kernel
from sphtrunc.lattice_sums import laurent, parts
from sphtrunc.operators import Key, Operator

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sphtrunc.gaussian import Gaussian

    Array = NDArray[np.float64]


class Dual:
    """A number with its derivative with respect to every displacement: value + slope·u."""

    __slots__ = ("slope", "value")
    __array_priority__ = 1000

    def __init__(self, value: float, slope: Any) -> None:
        self.value, self.slope = value, slope

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + float(other), self.slope)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> Dual:
        return self.__add__(-other)

    def __rsub__(self, other: Any) -> Dual:
        return self.__neg__().__add__(other)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(
                self.value * other.value, self.value * other.slope + other.value * self.slope
            )
        return Dual(self.value * float(other), self.slope * float(other))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            ratio = self.value / other.value
            return Dual(ratio, (self.slope - ratio * other.slope) / other.value)
        return Dual(self.value / float(other), self.slope / float(other))

    def __rtruediv__(self, other: Any) -> Dual:
        ratio = float(other) / self.value
        return Dual(ratio, -ratio / self.value * self.slope)


def dual_solve(
    matrix: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]]
) -> list[list[Any]]:
    """X with A X = B, and ∂X = A⁻¹ (∂B − ∂A X); ValueError where A is singular."""
    import numpy as np

    shape = next(x.slope.shape for row in (*matrix, *columns) for x in row if isinstance(x, Dual))

    def values(rows: Sequence[Sequence[Any]]) -> Array:
        return np.array([[x.value if isinstance(x, Dual) else float(x) for x in r] for r in rows])

    def slopes(rows: Sequence[Sequence[Any]]) -> Array:
        return np.array(
            [[x.slope if isinstance(x, Dual) else np.zeros(shape) for x in r] for r in rows]
        )

    a, b = values(matrix), values(columns)
    scale = 1.0 / np.sqrt(np.maximum(np.abs(a).max(axis=1), 1e-300))
    if np.linalg.cond(a * scale[:, None] * scale) > 1e12:
        raise ValueError(
            "correction: its moment matrix is singular on this lattice; expected a smaller Δx/h, or"
            " a lower correction"
        )
    x = np.linalg.solve(a, b)
    rest = slopes(columns) - np.einsum("ij...,jk->ik...", slopes(matrix), x)
    dx = np.linalg.solve(a, rest.reshape(len(a), -1)).reshape(rest.shape)
    return [
        [Dual(float(v), d) for v, d in zip(*row, strict=True)] for row in zip(x, dx, strict=True)
    ]


class Terms:
    """The terms of base sums at offsets s, (N, d), from a target; itself: (N,) where it is."""

    def __init__(self, kernel: Kernel | Gaussian, s: Array, itself: NDArray[np.bool_]) -> None:
        import numpy as np

        self.kernel, self.s, self.itself = kernel, s, itself
        self.q = np.sqrt((s * s).sum(axis=1))
        self._radial: dict[tuple[str, int], Array] = {}

    def _radial_at(self, name: str, order: int) -> Array:
        import numpy as np

        if (name, order) not in self._radial:
            dim = self.s.shape[1]
            value = np.zeros_like(self.q)
            away = ~self.itself
            value[away] = radial_values(self.kernel, name, self.q[away], dim, order)
            if self.itself.any() and order == 0 and name in ("w", "w1"):
                value[self.itself] = origin_value(self.kernel, name, dim)
            self._radial[name, order] = value
        return self._radial[name, order]

    def sampled(self, key: Key) -> tuple[Array, Array]:
        """g and ∇g of the term of a base sum, (N,) and (N, d)."""
        import numpy as np

        s = self.s
        g, slope = np.zeros_like(self.q), np.zeros_like(s)
        for c, beta, name in parts(key):
            f, df = self._radial_at(name, 0), self._radial_at(name, 1)
            monomial = np.prod(s ** np.array(beta), axis=1)
            value = c * monomial * f
            if isinstance(key[0], str):
                value[self.itself] = 0.0
            g += value
            for i, n in enumerate(beta):
                slope[:, i] += c * monomial * df * s[:, i]
                if n:
                    lowered = tuple(m - (j == i) for j, m in enumerate(beta))
                    slope[:, i] += c * n * np.prod(s ** np.array(lowered), axis=1) * f
        return g, slope

    def laplacian(self, key: Key) -> Array:
        """∇²g of the term of a base sum, (N,); 0 at the target itself.

        ∇²(s^β f) = f ∇²s^β + s^β [(2|β| + d) f′/q + q² (f′/q)′/q].
        """
        import numpy as np

        s, dim = self.s, self.s.shape[1]
        total: Array = np.zeros_like(self.q)
        for c, beta, name in parts(key):
            f, df, ddf = (self._radial_at(name, order) for order in range(3))
            monomial = np.prod(s ** np.array(beta), axis=1)
            total += c * monomial * ((2 * sum(beta) + dim) * df + self.q**2 * ddf)
            for i, n in enumerate(beta):
                if n > 1:
                    lowered = tuple(m - 2 * (j == i) for j, m in enumerate(beta))
                    total += c * n * (n - 1) * np.prod(s ** np.array(lowered), axis=1) * f
        total[self.itself] = 0.0
        return total


class Stencil:
    """The neighbours of one target on a lattice, with what their displacements change.

    index: (d, N) integer points; s: (N, d) offsets in h; target: the row of the particle that is
    the target itself, −1 where the target is not a particle (an offset) and does not move.
    """

    def __init__(
        self,
        kernel: Kernel | Gaussian,
        kind: str,
        dx_over_h: Fraction,
        offset: Sequence[Fraction],
        volume: str,
        moved: Array | None = None,
    ) -> None:
        """moved: displacements, (N, d) in Δx, at which everything is evaluated."""
        import numpy as np

        from sphtrunc.lattice import sites, units

        self.kernel, self.dim, self.ratio = kernel, len(offset), float(dx_over_h)
        reach = (2.0 if volume == "summation" else 1.0) * float(kernel.support) / self.ratio
        self.index = sites(kind, reach + (1.5 if volume == "cell" else 0.0), tuple(offset))
        unit_length = np.array([float(u) for u in units(kind)])
        s = self.ratio * (self.index.T * unit_length + np.array([float(o) for o in offset]))
        self.target = int(np.argmin((s * s).sum(axis=1))) if not any(offset) else -1
        if moved is not None:
            s += self.ratio * moved
            if self.target >= 0:
                s -= s[self.target].copy()
        self.s = s
        self.volumes, self.variation = volumes_of(kernel, s, self.ratio, self.dim, volume)
        self._terms = Terms(kernel, s, np.arange(len(s)) == self.target)

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


def origin_value(kernel: Kernel | Gaussian, name: str, dim: int) -> float:
    if name == "w":
        return float(kernel.w(0.0, dim))
    if isinstance(kernel, Kernel):
        value = laurent(kernel, name)[0].get(0, Fraction(0))
        return float(value) * float(kernel.normalisation(dim))
    return float(kernel.d2w(0.0, dim))


def volumes_of(
    kernel: Kernel | Gaussian, s: Array, ratio: float, dim: int, rule: str, reach: int = 1
) -> tuple[Array, Callable[[Array], Array] | None]:
    """V_b within so many supports, and how Σ_b g_b δV_b depends on the displacements, as a function
    of g."""
    import numpy as np

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
        slope[near] = radial_values(kernel, "w1", q[near], dim)
        gradient = slope[:, :, None] * pair

        def summed(g: Array) -> Array:
            """V_b = 1/Σ_c Ŵ(s_c − s_b): δV_b = −V_b² Σ_c ∇Ŵ(s_c − s_b)·(δs_c − δs_b)."""
            weight = -ratio * (g * volumes**2)[inner]
            moved = np.einsum("b,bci->ci", weight, gradient)
            moved[inner] -= weight[:, None] * gradient.sum(axis=1)
            return np.asarray(moved)

        return volumes, summed
    return volumes, None


def radial_values(
    kernel: Kernel | Gaussian, name: str, q: Array, dim: int, order: int = 0
) -> Array:
    """f(q) σ_d, or f′(q)/q for order 1, for q > 0; means at the knots, 0 beyond the support."""
    import numpy as np

    if not isinstance(kernel, Kernel):
        return kernel.radial_values(name, q, dim, order)
    result = np.zeros_like(q)
    knots = [float(k) for k in kernel.knots]
    for a, b, piece in zip(knots, knots[1:], laurent(kernel, name), strict=False):
        terms = {i: float(c) for i, c in piece.items()}
        for _ in range(order):
            terms = {i - 2: i * c for i, c in terms.items() if i}
        if not terms:
            continue
        inside = (q >= a) & (q <= b)
        x = q[inside]
        low = min(terms)
        value = np.zeros_like(x)
        for i in range(max(terms), low - 1, -1):
            value = value * x + terms.get(i, 0.0)
        value = value * x**low
        edge = (x == b) | ((x == a) & (a > 0))
        result[inside] += np.where(edge, 0.5, 1.0) * value
    return np.asarray(result * float(kernel.normalisation(dim)))
