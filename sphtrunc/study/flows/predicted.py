"""The predicted error of a solution: L e = −τ, τ from theory, on the particles of a lattice between
two plane walls, displaced or not.

τ of a row is that of its plane: Σ_α M_α u^{(α)}/α! − f with the exact discrete moments of the
lattice beside a wall (`theory.walls`). By linearity the error has parts: *smoothing*, from the
limits of the moments; *discretisation*, from what the lattice adds to them; *wall*, from what the
nearness of the wall adds to those.

Displacements ξ of every particle, independent and of variance σ², change L and what the wall adds
to it. With D_c = ∂L/∂ξ_c and S_c = ∂²L/∂ξ_c² (acting on the values of the fluid and of the wall),
u the solution on the lattice and G = L⁻¹ there,

    u₁ = −Σ_c ξ_c G D_c u,        ⟨u₂⟩ = −σ² G Σ_c (½ S_c u − D_c G D_c u),

so that the error has a spread, of covariance σ² Σ_c e_c e_cᵀ with e_c = −G D_c u − ∂_c u (it is the
particle that has moved), and a shift of its mean, ⟨u₂⟩ − ½σ² ∂²u for the same reason. It does
not fall with the number of particles: at that level a form stalls. Its second term is the feedback
of an operator on its own error; for symmetric forms it is as large as the first.

The series is one in ε = rms of Σ_c ξ_c G D_c v over that of v, the largest for waves v that change
sign from particle to particle: where these are nearly without resistance, as in forms made of ∇²W,
it is not small, and averages over displacements of other seeds take the place of the series. Where
it is larger still, some arrangements are all but singular, and there is no average.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.operators.operator import NESTED
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.sites import units
from sphtrunc.scenes.walls import PLACES, Wall
from sphtrunc.study.flows.enclosure import planes
from sphtrunc.study.flows.steady import Solver, system
from sphtrunc.theory.lattice_sums import lattice_moments
from sphtrunc.theory.limit import continuous_sum
from sphtrunc.theory.walls.moments import wall_lattice_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.scenes.lattice import Lattice
    from sphtrunc.study.flows.cases import Case
    from sphtrunc.study.flows.enclosure import Enclosure
    from sphtrunc.study.flows.steady import System

STEP = 1e-3  # of the differences of matrices, in Δx
SMALL = 0.25  # ε up to which two orders in σ are taken
DRAWS = 8  # of displacements, beyond
RARE = 10.0  # of the median of a mean square: a draw above shows that averages are of rare events
#: supports through which a particle reaches a row by way of a ghost, beside its own
_LEVELS = {"none": 0, "mirror": 0, "dummy": 1, "extrapolate": 2}
EXACT = "exact moments of the lattice beside the wall"


@dataclass(frozen=True, eq=False)
class Setting:
    """A channel as it was asked for: see `planes`."""

    scene: Lattice | Jittered
    kernel: Kernel
    operator: Operator
    counts: tuple[int, ...]
    wall: str
    at: object

    @property
    def home(self) -> Lattice:
        """The lattice."""
        return self.scene.lattice if isinstance(self.scene, Jittered) else self.scene

    @property
    def reach(self) -> int:
        """Supports that a row sees."""
        return 2 if self.operator.form == NESTED else 1

    @property
    def place(self) -> Fraction:
        """Steps from a wall to the first plane."""
        usual = "particle" if self.wall == "none" else "half-way"
        chosen: Any = usual if self.at is None else self.at
        return Fraction(PLACES.get(str(chosen), chosen))

    def enclosure(self, moved: Array | None = None) -> Enclosure:
        """Its particles."""
        walled = [True] + [False] * (len(self.counts) - 1)
        return planes(
            self.scene, self.kernel, self.counts, walled, self.wall,
            at=self.at, reach=self.reach, moved=moved,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Predicted:
    """The predicted error along the channel, plane by plane, (N,), in the size of the velocity.

    smoothing, discretisation, wall: parts of the error on the lattice; shift: of its mean by
    disorder; spread: standard deviation by disorder
    how: what the disorder rests on; known_to: the part of the total that this leaves open; scatter:
    the standard deviation of the rms error of one arrangement, as a part of it
    """

    smoothing: Array
    discretisation: Array
    wall: Array
    shift: Array
    spread: Array
    how: str
    known_to: float
    scatter: float
    weights: Array = field(repr=False)

    @property
    def mean(self) -> Array:
        """Of the error, (N,)."""
        return self.smoothing + self.discretisation + self.wall + self.shift

    def rms(self, part: Array) -> float:
        """Over the unknown velocities."""
        return float(np.sqrt(np.average(part**2, weights=self.weights)))

    @property
    def total(self) -> float:
        """The rms error."""
        return float(np.sqrt(np.average(self.mean**2 + self.spread**2, weights=self.weights)))

    @property
    def parts(self) -> dict[str, float]:
        """name -> rms of each part alone."""
        rows = {
            "smoothing": self.smoothing,
            "discretisation": self.discretisation,
            "wall": self.wall,
            "shift": self.shift,
            "spread": self.spread,
        }
        return {name: self.rms(row) for name, row in rows.items()}

    @property
    def dominant(self) -> str:
        """The largest part; "none" where all are rounding."""
        name, size = max(self.parts.items(), key=lambda row: row[1])
        return name if size > 0 else "none"


def truncation(setting: Setting, case: Case) -> dict[str, Array]:
    """τ, plane by plane, (N,): parts "smoothing", "discretisation" and "wall".

    Raises ValueError where theory has no moments: for lines extrapolated beyond a wall, dummies
    that lie where no image does, the nested form with ghosts, and channels so narrow that a row
    sees both walls.
    """
    home, operator, kernel = setting.home, setting.operator, setting.kernel
    if setting.wall == "extrapolate":
        raise ValueError("there is no theory of moments beside an extrapolated wall")
    if setting.wall == "dummy" and setting.place not in (0, Fraction(1, 2)):
        raise ValueError(
            "the dummies of a wall that is neither half-way nor at particles are no images of the"
            " fluid, which the theory of their flow needs"
        )
    if not case.derivatives:
        raise ValueError(f"there is no theory for the walls of {case.name}, beside one plane only")
    n, dim = setting.counts[0], home.dim
    step = units(home.kind)[0] * home.dx_over_h
    width = (n - 1 + 2 * setting.place) * step
    h = 1.0 / float(width)
    degree = len(case.derivatives) - 1
    if 2 * setting.reach * float(kernel.support) > float(width):
        raise ValueError("a row sees both walls, for which there is no theory; expected a larger N")
    bulk = _floats(lattice_moments(kernel, operator, home, degree, exact=False))
    limits = operator.correct(
        {key: continuous_sum(kernel, key) for key in operator.needed(dim, degree)}, dim, degree
    )
    far = _floats(limits)
    rows: dict[str, list[float]] = {"smoothing": [], "discretisation": [], "wall": []}
    known: dict[Fraction, dict[Any, float]] = {}
    for plane in range(n):
        left, right = (Fraction(k) + setting.place for k in (plane, n - 1 - plane))
        eta = min(left, right) * step
        field_ = case.taylor(float(left * step / width), h, dim)
        near = bulk
        if eta < setting.reach * fraction(kernel.support):
            if eta not in known:
                known[eta] = _beside(setting, eta, degree)
            near = known[eta]
            if right < left:  # the wall is on the other side
                near = {alpha: m * (-1) ** alpha[0] for alpha, m in near.items()}

        def estimate(moments: dict[Any, float], values: Any = field_) -> float:
            return float(sum(c * moments[alpha] for alpha, c in values.items())) / h**2

        rows["smoothing"].append(estimate(far) - case.forcing)
        rows["discretisation"].append(estimate(bulk) - estimate(far))
        rows["wall"].append(estimate(near) - estimate(bulk))
    return {name: np.array(row) for name, row in rows.items()}


def _floats(moments: dict[Any, Any]) -> dict[Any, float]:
    return {alpha: float(m) for alpha, m in moments.items()}


def _beside(setting: Setting, eta: Fraction, degree: int) -> dict[Any, float]:
    """The moments at a distance η h from the wall at 0, whose values are given."""
    home = setting.home

    def moments(ghosts: str) -> dict[Any, float]:
        beside = home.beside(Wall(eta, setting.place % 1, ghosts))
        return _floats(
            wall_lattice_moments(setting.kernel, setting.operator, beside, degree, exact=False)
        )

    if setting.wall == "none":
        return moments("none")
    odd = moments("odd")
    if setting.wall == "mirror":
        return odd
    # 2 A_w − mean = (2 A_w − A*) + A* − mean, on the same ghosts
    even, mean = moments("mirror"), moments("dummy")
    return {alpha: m + even[alpha] - mean[alpha] for alpha, m in odd.items()}


def predict(
    setting: Setting, case: Case, enclosure: Enclosure, still: System, solver: Solver, u: Array
) -> Predicted:
    """The error of a case; enclosure, still, solver, u: its lattice, L there, L⁻¹, the solution.

    Raises ValueError as `truncation` does.
    """
    plane = enclosure.index[0, still.free]
    count = setting.counts[0]
    tau = truncation(setting, case)
    parts = {name: _planes(-solver(row[plane]), plane, count) for name, row in tau.items()}
    kept = np.bincount(plane, minlength=count).astype(float)
    none = np.zeros(count)
    if not (isinstance(setting.scene, Jittered) and setting.scene.sigma):
        return Predicted(
            **parts, shift=none, spread=none, how=EXACT, known_to=0.0, scatter=0.0, weights=kept
        )
    error = np.sum(list(parts.values()), axis=0)
    shift, spread, small, together = disorder(setting, case, enclosure, still, solver, u)
    if small <= SMALL:
        how, known = f"two orders in σ, ε = {small:.2g}", small**2
        mean = kept * (error + shift) / kept.sum()
        square = np.average((error + shift) ** 2 + spread**2, weights=kept)
        # of the mean square: of what is the same along the walls, which alone does not average out
        variance = 4.0 * mean @ together @ mean + 2.0 * np.sum(together**2) / count**2
        scatter = float(0.5 * variance**0.5 / square)
    else:
        shift, spread, scatter = sampled(setting, case, plane, error)
        known = 3.0 * scatter / DRAWS**0.5
        how = f"averages over {DRAWS} other displacements, as ε = {small:.2g} is not small"
    return Predicted(
        **parts, shift=shift, spread=spread, how=how, known_to=known, scatter=scatter, weights=kept
    )


def sampled(
    setting: Setting, case: Case, plane: NDArray[np.int64], still: Array
) -> tuple[Array, Array, float]:
    """Shift and spread, (N,), over displacements of other seeds, and the standard deviation of the
    rms error as a part of it; still: the error on the lattice, (N,).

    Raises ValueError where a few draws have all of the error.
    """
    scene = setting.scene
    assert isinstance(scene, Jittered)
    count = setting.counts[0]
    total, squares, sizes = np.zeros(count), np.zeros(count), []
    for draw in range(1, DRAWS + 1):
        other = replace(setting, scene=replace(scene, seed=scene.seed + draw))
        enclosure = other.enclosure()
        found = system(enclosure, setting.kernel, setting.operator, case.u)
        u = Solver(found.matrix, enclosure.dim)(case.forcing - found.known)
        error = u - case.u(enclosure.x[:, found.free])
        total += _planes(error, plane, count)
        squares += _planes(error**2, plane, count)
        sizes.append(float(np.mean(error**2)))
    mean = total / DRAWS
    spread = np.sqrt(np.maximum(squares / DRAWS - mean**2, 0.0))
    if max(sizes) > RARE * np.median(sizes):
        low, high = min(sizes) ** 0.5, max(sizes) ** 0.5
        raise ValueError(
            f"of {DRAWS} other displacements some make the operator all but singular (errors from"
            f" {low:.2g} to {high:.2g}), so that there is no average"
        )
    scatter = 0.5 * float(np.std(sizes, ddof=1) / np.mean(sizes))
    return np.where(squares > 0, mean - still, 0.0), spread, scatter


def _planes(values: Array, plane: NDArray[np.int64], count: int) -> Array:
    """The mean over every plane, 0 where a plane has no unknown."""
    size = np.bincount(plane, minlength=count)
    return np.asarray(np.bincount(plane, weights=values, minlength=count) / np.maximum(size, 1))


def disorder(
    setting: Setting, case: Case, enclosure: Enclosure, still: System, solver: Solver, u: Array
) -> tuple[Array, Array, float, Array]:
    """Shift and spread of the error by displacements, plane by plane, (N,), ε, and the covariance
    of the means of planes, (N, N).

    One particle of every plane is moved, planes in turn that are too far apart to share a row, and
    all others are its translations.
    Raises ValueError for displacements that are not independent.
    """
    scene = setting.scene
    assert isinstance(scene, Jittered)
    if scene.distribution == "blue":
        raise ValueError("there is no theory of a solution for blue displacements, only for others")
    free, count, spacing = still.free, setting.counts[0], enclosure.spacing
    plane = enclosure.index[0, free]
    _, first = np.unique(plane, return_index=True)
    movers = free[first]  # one of every plane
    levels = _LEVELS[setting.wall] + setting.reach
    reach = levels * (float(setting.kernel.support) * enclosure.h + spacing)
    stride = int(2 * reach / (float(units(setting.home.kind)[0]) * spacing)) + 2
    rough = _sawteeth(enclosure.index[:, free])
    mean, square, echo = np.zeros(count), np.zeros(count), np.zeros(rough.shape[1])
    together = np.zeros((count, count))
    size = np.maximum(np.bincount(plane, minlength=count), 1)
    for color, axis in product(range(min(stride, count)), range(enclosure.dim)):
        chosen = movers[enclosure.index[0, movers] % stride == color]
        if chosen.size == 0:
            continue
        near = _distances(enclosure, free, chosen)
        owner, rows = near.argmin(axis=1), near.min(axis=1) <= reach
        moved = np.zeros_like(enclosure.x)
        moved[axis, chosen] = STEP
        up, down = (
            system(setting.enclosure(way), setting.kernel, setting.operator, case.u, free[rows])
            for way in (moved, -moved)
        )
        slope = (up.matrix - down.matrix) / (2 * STEP)
        climb = slope @ u + (up.known - down.known) / (2 * STEP)
        bend = up.matrix @ u + up.known + down.matrix @ u + down.known - 2 * case.forcing
        bend /= STEP**2
        test = slope @ rough
        for k, particle in enumerate(chosen):
            own = owner[rows] == k
            right = np.zeros(free.size)
            right[rows] = np.where(own, climb, 0.0)
            answer = -solver(right)
            back = np.where(own, 0.5 * bend + slope @ answer, 0.0)
            # what all particles of a plane do to a row, one does to all rows of a plane
            mean += np.bincount(plane[rows], weights=back, minlength=count)
            if axis == 0:  # the exact velocity at the place where the particle has gone
                at = enclosure.x[0, [particle]]
                answer[np.searchsorted(free, particle)] -= spacing * case.derivatives[1](at)[0]
            square += np.bincount(plane, weights=answer**2, minlength=count)
            level = np.bincount(plane, weights=answer, minlength=count) / np.sqrt(size)
            together += np.outer(level, level)
            push = np.zeros((free.size, rough.shape[1]))
            push[rows] = np.where(own[:, None], test, 0.0)
            echo += (solver(push) ** 2).sum(axis=0) / movers.size
    sigma = scene.sigma
    shift = -(sigma**2) * solver(mean[plane])
    if len(case.derivatives) > 2:  # the mean of the exact velocity where the particles have gone
        shift -= 0.5 * (sigma * spacing) ** 2 * case.derivatives[2](enclosure.x[0, free])
    shift = _planes(shift, plane, count)
    return shift, sigma * np.sqrt(square), sigma * float(echo.max()) ** 0.5, sigma**2 * together


def _sawteeth(index: NDArray[np.int64]) -> Array:
    """Waves that change sign from particle to particle along some of the axes, and one that looks
    random, (n, 2^d)."""
    signs = 1.0 - 2.0 * (index % 2)
    waves = [np.where(np.sin(1.0 + np.arange(index.shape[1]) ** 2) > 0, 1.0, -1.0)]
    for axes in product((False, True), repeat=len(index)):
        if any(axes):
            waves.append(np.prod(signs[list(axes)], axis=0))
    return np.stack(waves, axis=1)


def _distances(enclosure: Enclosure, rows: NDArray[np.int64], others: NDArray[np.int64]) -> Array:
    """Between particles of the fluid, (rows, others), to the nearest image along periodic axes."""
    s = enclosure.x[:, rows][:, :, None] - enclosure.x[:, others][:, None, :]
    period = enclosure.particles.period
    if period is not None:
        for axis in np.flatnonzero(np.isfinite(period)):
            s[axis] -= period[axis] * np.rint(s[axis] / period[axis])
    return np.asarray(np.sqrt((s * s).sum(axis=0)))
