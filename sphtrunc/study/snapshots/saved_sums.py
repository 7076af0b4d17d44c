"""Saved sums: which kernel, and which meaning of h, made the densities and accelerations of a file.

A code that sums ρ_a = Σ_b m_b W(x_a − x_b, h_a) saves what it summed. The median over targets of
|Σ_b m_b W_ab/ρ_a − 1| is as small as the precision of the file for the kernel and the support that
it was summed with, and the discretisation error of the density, 10⁻³ or so, for all others. Of
accelerations the same is asked of Σ_b m_b (g_a + g_b) ∇W_ab, g = P/ρ²: another kernel may stand
there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from sympy import Rational

from sphtrunc.kernels.catalogue import named, names
from sphtrunc.kernels.conventions import BALL, two_sigma
from sphtrunc.kernels.factors import factor_values
from sphtrunc.operators.terms import SLOPE, VALUE

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.particles import Particles
    from sphtrunc.scenes.snapshots.snapshot import Snapshot

#: residual up to which a pair is said to have made the densities: right pairs left 1e-7 to 6e-6 in
#: eight files of four codes, wrong ones 3e-4 and more, or hundreds of times what the right one left
FITS = 5e-5
#: of accelerations: between 7e-5 and 0.1, and viscosity or gravity leave more than that
FORCES_FIT = 2e-3
#: how many times better than the next a pair has to be; squared where the next is within the limit,
#: since on a lattice all wide kernels give nearly the same density
_CLEAR = 10.0
_TINY, _AWAY = 2.0**-1000, 2.0**-500
_MOST_NEIGHBOURS = 4096  # of a support that a code could have used
_LEAST_NEIGHBOURS = 4
_SCREENED, _FORCES_SCREENED = 64, 16  # targets that all candidates are tried on
_TARGETS = 512  # and the best of them
_HOPELESS = 0.1  # what no other h of a pair makes good
_BEST = 8
_DEGREE = 3  # of the unknown P/ρ² as a polynomial in ρ, where no pressure is saved
MODES = ("gather", "mean", "scatter")

#: (kernel, support/h) -> residual
Judge = Callable[[Any, float], float]


@dataclass(frozen=True)
class Candidate:
    """A kernel whose support is `support_over_h` times the saved h, and how well it fits.

    mode: whose h a pair takes, gather h_a, scatter h_b, mean (h_a + h_b)/2
    """

    kernel: str
    support_over_h: float
    residual: float
    mode: str = "gather"

    def to_dict(self) -> dict[str, Any]:
        """kernel, support_over_h, residual, mode."""
        return dict(self.__dict__)


@dataclass(frozen=True)
class Identification:
    """best: the pair with the smallest residual; next: the best with another kernel or support;
    fits: whether best is the one that made the sums, and no other could have."""

    best: Candidate
    next: Candidate
    fits: bool

    def to_dict(self) -> dict[str, Any] | None:
        """The keys of the best, and `next`; None where nothing fits."""
        return {**self.best.to_dict(), "next": self.next.to_dict()} if self.fits else None


@cache
def _shapes(dim: int) -> list[Kernel]:
    """The catalogue, each shape once under its best known name in that dimension."""
    found: dict[Any, Kernel] = {}
    for name in sorted(names(), key=lambda name: name.endswith("-1d") == (dim > 1)):
        kernel = named(name)
        head = kernel.coefficients()[0][0]
        scale = float(kernel.support)
        # rounded: the same shape on 2h and 3h, or with another factor, is the same
        shape = tuple(
            round(float(c / head) * scale**i, 9)
            for piece in kernel.coefficients()
            for i, c in enumerate(piece)
        ) + tuple(round(float(knot) / scale, 9) for knot in kernel.knots)
        found.setdefault(shape, kernel)
    return list(found.values())


@cache
def conventions(kernel: Kernel, dim: int) -> list[float]:
    """What the support of a kernel may be in units of what a code calls h: κ, where h is that of
    the kernel as it is written here; 1, 2, 3; κ/(2σ/h) (Dehnen & Aly 2012); κ/(FWHM/h)."""
    support = float(kernel.support)
    found = [support, 1.0, 2.0, 3.0, support / float(two_sigma(kernel, dim).evalf(17))]
    q = np.linspace(0.0, support, 4097) + _AWAY
    half = factor_values(kernel, VALUE, q, dim)
    below = np.flatnonzero(half < 0.5 * half[0])
    if below.size and below[0] > 0 and half[0] > 0:
        low, high = q[below[0] - 1], q[below[0]]
        for _ in range(60):
            middle = 0.5 * (low + high)
            inside = float(factor_values(kernel, VALUE, np.array([middle]), dim)[0])
            low, high = (middle, high) if inside >= 0.5 * half[0] else (low, middle)
        found.append(support / (2.0 * low))
    return sorted({float(ratio) for ratio in found})


class _Pairs:
    """The neighbours of T targets, the nearest first: a support is a number of rows.

    s: (d, N, T) offsets and u: (N, T) distances in units of h_a; particle: (N, T)
    stretch: (N, T) h of the pair over h_a, None where that is 1
    """

    def __init__(self, scene: Particles, targets: Any, reach: float, mode: str) -> None:
        everything = named("polynomial:-1").scaled(support=Rational(reach))
        block = scene.around(targets, everything)
        assert block.particle is not None
        # a particle is its own neighbour, at a distance that no limit at 0 is taken for
        u = np.sqrt((block.offset**2).sum(axis=0)) + _AWAY
        order = np.argsort(u, axis=0, kind="stable")
        self.u = np.take_along_axis(u, order, 0)
        self.particle = np.take_along_axis(block.particle, order, 0)
        self.s = np.stack([np.take_along_axis(axis, order, 0) for axis in block.offset])
        self.h, self.targets = scene.h[targets], targets
        self.mass = np.where(self.particle < 0, 0.0, scene.mass[self.particle])
        self.nearest = self.u.min(axis=1)  # of every row
        own, other = self.h, scene.h[self.particle]
        self.stretch: Array | None = None
        if mode != "gather":
            self.stretch = other / own if mode == "scatter" else 0.5 * (own + other) / own

    def factor(self, kernel: Kernel, dim: int, k: int, ratio: float) -> Array:
        """f_k of the kernel whose support is ratio·h, (rows within it, T), in units of h_a."""
        per = float(kernel.support) / ratio
        q, scale = self.u * per, np.asarray(per)
        if self.stretch is None:
            q = q[: int(np.searchsorted(self.nearest, ratio, side="right"))]
        else:
            scale = per / self.stretch
            q = self.u * scale
        power = dim if k == VALUE else dim + 2
        return np.asarray(factor_values(kernel, k, q, dim) * scale**power)


def density_residual(
    pairs: _Pairs, density: Array, kernel: Kernel, dim: int, ratio: float, weighed: bool = True
) -> float:
    """The median over targets of |Σ_b m_b W_ab/ρ_a − 1|; of equal masses that are not known
    (`weighed` is false), with the mass that makes the median of the quotients 1."""
    factor = pairs.factor(kernel, dim, VALUE, ratio)
    summed = np.einsum("nt,nt->t", factor, pairs.mass[: len(factor)]) / pairs.h**dim
    quotient = summed / density[pairs.targets]
    if not weighed:
        middle = float(np.median(quotient))
        quotient = quotient / (middle if middle > 0 else 1.0)
    return float(np.median(np.abs(quotient - 1.0)))


def identify_density(snapshot: Snapshot, scene: Particles) -> Identification | None:
    """Which kernel, support and mode made the saved densities, of particles of equal mass where the
    file has no masses; None where there is no density, or where no support of the catalogue could
    be one."""
    density = snapshot.fields.get("density")
    weighed = "mass" in snapshot.fields
    if density is None:
        return None

    def judge(pairs: _Pairs) -> Judge:
        return lambda kernel, ratio: density_residual(
            pairs, density, kernel, scene.dim, ratio, weighed
        )

    return _identified(snapshot, scene, judge, FITS, _SCREENED)


def identify_forces(snapshot: Snapshot, scene: Particles) -> Identification | None:
    """Which kernel made the saved accelerations: those of pressure alone,
    −Σ_b m_b (g_a + g_b) ∇W_ab, g = P/ρ² of the saved pressure, or else any polynomial of degree 3
    in the saved density. None where there are no accelerations or densities."""
    known = snapshot.fields
    if "acceleration" not in known or "density" not in known:
        return None
    density, acceleration = known["density"], known["acceleration"]
    if not np.any(acceleration[:, snapshot.target]):
        return None
    if "pressure" in known:
        basis = [known["pressure"] / density**2]
    else:
        t = density / density.mean() - 1.0
        t = t / max(float(np.abs(t).max()), _TINY)
        basis = [t**n for n in range(_DEGREE + 1)]

    def judge(pairs: _Pairs) -> Judge:
        weights = np.stack(
            [pairs.mass * (g[pairs.targets] + g[pairs.particle]) * pairs.s for g in basis]
        )
        return lambda kernel, ratio: _force_residual(pairs, weights, acceleration, kernel, ratio)

    return _identified(snapshot, scene, judge, FORCES_FIT, _FORCES_SCREENED)


def _force_residual(
    pairs: _Pairs,
    weights: Array,
    acceleration: Array,
    kernel: Kernel,
    ratio: float,
) -> float:
    """The median of what the best combination of the basis leaves of the accelerations.

    weights: (J, d, N, T) m_b (g_a + g_b) s of every function g of the basis
    """
    dim, n = weights.shape[1], weights.shape[3]
    factor = pairs.factor(kernel, dim, SLOPE, ratio)
    sums = np.einsum("nt,jdnt->jdt", factor, weights[:, :, : len(factor)])
    columns = (sums / pairs.h ** (dim + 1)).reshape(len(weights), -1)
    wanted = acceleration[:, pairs.targets]
    sizes = np.sqrt((columns**2).sum(axis=1))
    if not np.any(sizes > 0):
        return 1.0
    matrix = (columns[sizes > 0] / sizes[sizes > 0][:, None]).T
    found = matrix @ np.linalg.lstsq(matrix, wanted.reshape(-1), rcond=None)[0]
    left = np.sqrt(((found.reshape(dim, n) - wanted) ** 2).sum(axis=0))
    return float(np.median(left) / max(float(np.median(np.sqrt((wanted**2).sum(axis=0)))), _TINY))


def _identified(
    snapshot: Snapshot,
    scene: Particles,
    judge: Callable[[_Pairs], Judge],
    limit: float,
    screened: int,
) -> Identification | None:
    candidates = list(_candidates(snapshot, scene))
    if len(candidates) < 2:
        return None
    among = np.flatnonzero(snapshot.target)
    targets = among[np.linspace(0, among.size - 1, min(_TARGETS, among.size)).astype(np.int64)]
    few = targets[:: max(1, targets.size // screened)]
    reach = max(ratio for _, ratio in candidates)
    found = None
    for mode in MODES if not np.all(scene.h == scene.h[0]) else MODES[:1]:
        wide = reach if mode == "gather" else reach * float(scene.h.max() / scene.h[targets].min())
        some = _Pairs(scene, few, _reach(wide, snapshot, scene), mode)
        residual = judge(some)
        ranks = sorted((residual(*one), i) for i, one in enumerate(candidates))
        best = [candidates[i] for _, i in ranks[:_BEST]]
        if ranks[0][0] <= _HOPELESS:
            wide *= max(ratio for _, ratio in best) / reach
            residual = judge(_Pairs(scene, targets, _reach(wide, snapshot, scene), mode))
        exact = sorted((residual(kernel, ratio), kernel.name, ratio) for kernel, ratio in best)
        first, second = (Candidate(k, ratio, r, mode) for r, k, ratio in exact[:2])
        clear = _CLEAR if second.residual > limit else _CLEAR**2
        fits = first.residual <= limit and second.residual > clear * first.residual
        if found is None or fits:
            found = Identification(first, second, fits)
        if fits or first.residual > _HOPELESS:
            break
    return found


def _reach(ratio: float, snapshot: Snapshot, scene: Particles) -> float:
    """How far to look, in units of h: not so far that a particle would meet its own image."""
    if snapshot.period is None:
        return ratio
    return min(ratio, 0.499 * float(snapshot.period.min() / scene.h.max()))


def _candidates(snapshot: Snapshot, scene: Particles) -> Iterator[tuple[Kernel, float]]:
    """Every kernel of the catalogue with every support that a code could have used here."""
    known = snapshot.fields
    dim = scene.dim
    if "mass" in known and "density" in known:
        per_volume = known["density"] / known["mass"]
    else:
        extent = np.ptp(scene.x, axis=1)
        per_volume = np.full(scene.population, scene.population / float(np.prod(extent)))
    around = float(np.median(per_volume * scene.h**dim)) * float(BALL[dim].evalf())
    least = (_LEAST_NEIGHBOURS / around) ** (1.0 / dim)
    most = _reach((_MOST_NEIGHBOURS / around) ** (1.0 / dim), snapshot, scene)
    for kernel in _shapes(dim):
        for ratio in conventions(kernel, dim):
            if least <= ratio <= most:
                yield kernel, ratio


def named_otherwise(header: str | None, kernels: Iterable[str]) -> bool:
    """Whether the header of a file names a kernel that none of these is.

    >>> named_otherwise("Cubic spline (M4)", ["cubic-spline"])
    False
    >>> named_otherwise("Wendland C2", ["lucy"])
    True
    """
    if header is None:
        return False
    words = header.lower().replace("-", " ").replace("_", " ")
    for key, kernel in _HEADERS.items():
        if all(word in words for word in key.split()):
            return kernel not in kernels
    return False


#: words of a header -> the kernel that they mean; the first whose words are all there
_HEADERS = {
    "cubic spline": "cubic-spline",
    "quartic spline": "quartic-spline",
    "quintic spline": "quintic-spline",
    "wendland c2": "wendland-c2",
    "wendland c4": "wendland-c4",
    "wendland c6": "wendland-c6",
    "quintic": "quintic-spline",
    "cubic": "cubic-spline",
}
