"""Stability: which waves grow on a lattice, how fast, and from which number of neighbours on.

Two branches are told apart, because they mean different things. *Longitudinal*: neighbours along
the wave close up, which is pairing under pressure and the tensile instability under tension.
*Transverse*: the lattice shears, an elastic instability of that lattice, which every kernel has
somewhere, Wendland's too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from itertools import pairwise, product
from math import inf, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.kernels.conventions import BALL
from sphtrunc.theory.dispersion.brillouin import POINTS, directions, grid, scale, shortest
from sphtrunc.theory.dispersion.lattice_waves import Scan
from sphtrunc.theory.dispersion.modes import LONGITUDINAL, TRANSVERSE, Rest, Spectrum, eigenvalues
from sphtrunc.theory.dispersion.relation import damping

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel

    Array = NDArray[np.float64]

#: κ of a wave that stands for the limit of long ones
LONG = 1e-3
#: neighbours between which ranges are looked for
NEIGHBOURS = {1: (2.2, 16.0), 2: (8.0, 150.0), 3: (20.0, 400.0)}
#: divisions of the zone where many settings are looked at
COARSE = {1: 120, 2: 24, 3: 12}
SETTINGS = 80
_REFINED = 1e-8  # of κ
_NOISE = 1e-14  # of ω² in c²/h², or of the largest: what changes by less does not change
_FAR = 8.0  # steps, to which a parabola is believed


@dataclass(frozen=True)
class Found:
    """A mode of the zone.

    relative: ω²/(c²k²); omega2: ω² in c²/h²; growth_rate: in c/h; k: in π/Δx; wavelength: in Δx;
    point: the name of k in the zone, if it has one. In the limit of long waves along k, whose ω² is
    as small as k², omega2, growth_rate and wavelength are None.
    """

    relative: float
    omega2: float | None
    growth_rate: float | None
    k: tuple[float, ...]
    branch: str
    wavelength: float | None
    point: str | None = None


@dataclass(frozen=True)
class Range:
    """Where a branch is stable: from one Δx/h to another, and the neighbours there."""

    dx_over_h: tuple[float, float]
    neighbours: tuple[float, float]


@dataclass(frozen=True)
class Stability:
    """What is found of a setting.

    worst: the mode with the least ω²/(c²k²), and branches: that of each branch; fastest: the one
        that grows fastest, None where none grows
    stable: branch -> whether no wave grows; rounding: a bound of what rounding did to ω²
    highest: the largest ω² in c²/h², and highest_k where, in π/Δx
    ranges: branch -> where it is stable, all else equal
    zero_modes: κ of waves without any restoring force, see `Rest.zero_modes`
    """

    rest: Rest
    sound_speed2: Any
    dispersion: Any
    worst: Found
    branches: dict[str, Found]
    fastest: Found | None
    stable: dict[str, bool]
    highest: float
    highest_k: tuple[float, ...]
    rounding: float
    ranges: dict[str, list[Range]]
    zero_modes: list[tuple[Fraction, ...]]

    @property
    def courant(self) -> dict[str, float]:
        """The largest stable cΔt/h of waves that do not grow by themselves: leapfrog (and
        symplectic Euler) ωΔt < 2, RK4 ωΔt < 2√2; RK2 and Euler none without damping."""
        return courant(self.highest)


def courant(highest: float) -> dict[str, float]:
    """Of the largest ω² in c²/h²: integrator -> cΔt/h."""
    if highest <= 0:
        return {"leapfrog": inf, "rk2": 0.0, "rk4": inf}
    omega = sqrt(highest)
    return {"leapfrog": 2 / omega, "rk2": 0.0, "rk4": 2 * sqrt(2) / omega}


def viscous_step(rest: Rest, alpha: float) -> float:
    """The largest stable cΔt/h of kick and drift with artificial viscosity α taken explicitly: the
    first C at which a wave flips its sign without shrinking, C²D + 2αC Γ = 4.

    Raises ValueError for α < 0 and where no wave oscillates.
    """
    if not 0 <= alpha < inf:
        raise ValueError(f"viscosity: got α = {alpha}, expected α >= 0")
    scan = rest.scan(waves(rest.kind))

    def most(step: float) -> float:
        """4 minus the largest eigenvalue over the zone."""

        def flipped(kappa: Any) -> Array:
            lattice = scan.of(kappa).at(rest.kernel, float(rest.ratio), rest.volume)
            matrix = rest.matrix(lattice, float(rest.pressure))
            matrix = step * step * matrix + 2 * alpha * step * damping(lattice)
            return np.asarray(-eigenvalues(matrix).real.max(axis=-1))

        start = scan.kappa[int(flipped(scan.kappa).argmin())]
        return 4 + _refine(start, flipped, rest.kind)[0]

    highest = float(rest.frequencies(scan).omega2.max())
    end = 1.001 * courant(highest)["leapfrog"]
    if end == inf:
        raise ValueError("viscosity: no wave oscillates, so that none limits the time step")
    return root(most, (1e-3 * end, end))


def neighbours(kernel: Kernel | Gaussian, dim: int, ratio: float) -> float:
    """V_d (κh/Δx)^d, the target counted."""
    return float(float(BALL[dim]) * (float(kernel.support) / ratio) ** dim)


def ratio_of(kernel: Kernel | Gaussian, dim: int, count: float) -> float:
    """Δx/h with so many neighbours."""
    return float(kernel.support) * float((float(BALL[dim]) / count) ** (1 / dim))


# --------------------------------------------------------------------------------- one setting


def stability(rest: Rest, ranges: bool = True) -> Stability:
    """Looks at the whole zone, and closer where a branch is weakest and where ω² is largest.

    ranges: whether to look for the Δx/h between which each branch is stable, too
    """
    scan = rest.scan(waves(rest.kind))
    seen = rest.frequencies(scan)
    branches = {branch: _worst(rest, scan, seen, branch) for branch in branches_of(rest.dim)}
    stable = {
        b: bool((lowest(seen, b) >= -seen.rounding).all())
        and (w.omega2 is None or w.omega2 >= -seen.rounding)
        for b, w in branches.items()
    }
    highest, at = _refine(
        scan.kappa[int(seen.omega2.max(axis=1).argmax())],
        lambda kappa: -rest.frequencies(scan.of(kappa)).omega2.max(axis=1),
        rest.kind,
    )
    long_waves = rest.long_waves()
    return Stability(
        rest=rest,
        sound_speed2=long_waves.sound_speed2,
        dispersion=long_waves.dispersion,
        worst=min(branches.values(), key=lambda w: w.relative),
        branches=branches,
        fastest=None if all(stable.values()) else _fastest(rest, scan, seen),
        stable=stable,
        highest=-highest,
        highest_k=in_spacings(rest.kind, at),
        rounding=seen.rounding,
        ranges=stable_ranges(rest) if ranges else {},
        zero_modes=rest.zero_modes(),
    )


def branches_of(dim: int) -> tuple[str, ...]:
    """There is no transverse wave on a line."""
    return (LONGITUDINAL,) if dim == 1 else (LONGITUDINAL, TRANSVERSE)


@lru_cache(maxsize=16)
def waves(kind: str, divisions: int = 0) -> Any:
    """κ of long waves and of the whole zone, (K, d)."""
    return np.concatenate([LONG * directions(kind), grid(kind, divisions)])


def in_spacings(kind: str, kappa: Any) -> tuple[float, ...]:
    """κ as k in π/Δx."""
    # a flat extremum is found to the root of the rounding only
    return tuple(float(c) for c in (np.asarray(kappa) * scale(kind) / pi).round(7) + 0.0)


def lowest(seen: Spectrum, branch: str) -> Array:
    """The least ω² of a branch, (K,)."""
    along = seen.longitudinal if branch == LONGITUDINAL else ~seen.longitudinal
    return np.asarray(np.where(along, seen.omega2, np.inf).min(axis=1))


def _worst(rest: Rest, scan: Scan, seen: Spectrum, branch: str) -> Found:
    relative = lowest(seen, branch) / seen.k**2
    start = int(relative.argmin())
    if start < len(directions(rest.kind)):
        k = in_spacings(rest.kind, scan.kappa[start] / LONG)
        return Found(float(relative[start]), None, None, k, branch, None)

    def looked(kappa: Any) -> Array:
        found = rest.frequencies(scan.of(kappa))
        return np.asarray(lowest(found, branch) / found.k**2)

    _, at = _refine(scan.kappa[start], looked, rest.kind)
    return _found(rest, scan, at, branch)


def _fastest(rest: Rest, scan: Scan, seen: Spectrum) -> Found:
    def slowed(kappa: Any) -> Array:
        return np.asarray(-rest.frequencies(scan.of(kappa)).growth.max(axis=1))

    _, at = _refine(scan.kappa[int(seen.growth.max(axis=1).argmax())], slowed, rest.kind)
    found = rest.frequencies(scan.of(at[None]))
    along = bool(found.longitudinal[0, int(found.growth[0].argmax())])
    return _found(rest, scan, at, LONGITUDINAL if along else TRANSVERSE)


def _found(rest: Rest, scan: Scan, kappa: Any, branch: str) -> Found:
    """The lowest mode of a branch at κ."""
    seen = rest.frequencies(scan.of(kappa[None]))
    omega2 = float(lowest(seen, branch)[0])
    k = float(seen.k[0])
    return Found(
        relative=omega2 / k**2,
        omega2=omega2,
        growth_rate=sqrt(-omega2) if omega2 < -seen.rounding else 0.0,
        k=in_spacings(rest.kind, kappa),
        branch=branch,
        wavelength=2 * pi * float(1 / rest.ratio) / k,
        point=named(rest.kind, kappa),
    )


def named(kind: str, kappa: Any) -> str | None:
    """The name of the point of the zone, if it has one."""
    one_unit = len(set(np.round(scale(kind), 12))) == 1

    def plain(c: Any) -> Array:
        c = np.abs(np.asarray(c, dtype=float))
        return np.sort(c) if one_unit else c

    for name, place in POINTS[kind].items():
        if np.abs(plain([float(c) for c in place]) - plain(kappa)).max() < 1e-5:
            return name
    return None


def _refine(start: Array, function: Callable[[Any], Array], kind: str) -> tuple[float, Array]:
    """The least value near a wave, and κ there, brought back into the zone: of the neighbours of a
    point at a step, and of the least of the parabola through them, the lowest is next; the step is
    up to doubled by how far that was, and divided by four where none is lower."""
    dim = len(start)
    moves = np.array(list(product((-1.0, 0.0, 1.0), repeat=dim)))
    longest = step = 2.0 / COARSE[dim]
    place, value, guess = start, inf, np.zeros((1, dim))
    while step > _REFINED:
        tried = np.concatenate([moves, guess / step])
        near = shortest(kind, place + step * tried)
        found = function(np.where(np.abs(near).max(axis=1, keepdims=True) < LONG, place, near))
        best = int(found.argmin())
        guess = step * _parabola(moves, found[: len(moves)])
        factor = 0.25
        if found[best] < value - _NOISE * max(1.0, float(np.abs(found).max())):
            place, value = near[best], float(found[best])
            guess = guess - step * tried[best]
            factor = min(max(2.0 * float(np.abs(tried[best]).max()), 0.25), 2.0)
        step = min(factor * step, longest)
    return value, np.abs(place)


def _parabola(moves: Array, values: Array) -> Array:
    """Where the parabola through the values at the 3^d `moves` is least, `_FAR` away at most,
    (1, d); across a saddle, downhill on either side of it."""
    dim = moves.shape[1]
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    square = np.array([moves[:, i] * moves[:, j] for i, j in pairs]).T
    design = np.concatenate([np.ones((len(moves), 1)), moves, square], axis=1)
    fit = np.linalg.lstsq(design, values, rcond=None)[0]
    bend = np.zeros((dim, dim))
    for (i, j), c in zip(pairs, fit[1 + dim :], strict=True):
        bend[i, j] += c
        bend[j, i] += c
    curvature, axes = np.linalg.eigh(bend)
    slope = axes.T @ fit[1 : 1 + dim]
    size = np.maximum(np.abs(curvature), np.abs(slope) / _FAR)
    return np.asarray(-(axes @ np.divide(slope, size, out=np.zeros(dim), where=size > 0)))[None]


# ------------------------------------------------------------------------------- many settings


def stable_ranges(rest: Rest) -> dict[str, list[Range]]:
    """branch -> ranges of Δx/h where it is stable, everything else equal, on a grid of the zone;
    ends to a millionth."""
    low, high = (ratio_of(rest.kernel, rest.dim, n) for n in reversed(NEIGHBOURS[rest.dim]))
    if rest.stress is not None:
        high = min(high, 0.999 * float(rest.kernel.support) / float(rest.stress.spacing))
    scan = rest.scan(waves(rest.kind, COARSE[rest.dim]), float(rest.kernel.support) / low)

    def margins(r: float) -> dict[str, float]:
        seen = replace(rest, ratio=Fraction(r)).frequencies(scan)
        return {b: float(lowest(seen, b).min()) + seen.rounding for b in branches_of(rest.dim)}

    grid_ = [float(r) for r in np.geomspace(low, high, SETTINGS)]
    rows = [margins(r) for r in grid_]
    found: dict[str, list[Range]] = {}
    for branch in branches_of(rest.dim):
        stable = [row[branch] >= 0 for row in rows]
        edges = [
            root(
                partial(_margin, margins, branch), grid_[i : i + 2], [x[branch] for x in pair], 1e-6
            )
            for i, pair in enumerate(pairwise(rows))
            if stable[i] != stable[i + 1]
        ]
        if stable[0]:
            edges = [grid_[0], *edges]
        if stable[-1]:
            edges = [*edges, grid_[-1]]
        found[branch] = [_range(rest, a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return found


def _margin(margins: Callable[[float], dict[str, float]], branch: str, ratio: float) -> float:
    return margins(ratio)[branch]


def _range(rest: Rest, low: float, high: float) -> Range:
    counts = tuple(neighbours(rest.kernel, rest.dim, r) for r in (high, low))
    return Range((low, high), (counts[0], counts[1]))


@dataclass(frozen=True)
class Curve:
    """The weakest mode of both branches against the number of neighbours: ω²/(c²k²), (N,)."""

    neighbours: Array
    dx_over_h: Array
    longitudinal: Array
    transverse: Array | None
    rounding: Array


def curve(rest: Rest, counts: Sequence[float]) -> Curve:
    """min ω²/(c²k²) over the zone for each number of neighbours, everything else equal."""
    ratios = [ratio_of(rest.kernel, rest.dim, n) for n in counts]
    scan = rest.scan(waves(rest.kind), float(rest.kernel.support) / min(ratios))
    rows: dict[str, list[float]] = {branch: [] for branch in branches_of(rest.dim)}
    rounding = []
    for r in ratios:
        seen = replace(rest, ratio=Fraction(r)).frequencies(scan)
        for branch, row in rows.items():
            row.append(float((lowest(seen, branch) / seen.k**2).min()))
        rounding.append(float((seen.rounding / seen.k**2).max()))
    transverse = np.array(rows[TRANSVERSE]) if TRANSVERSE in rows else None
    return Curve(
        np.array(counts, dtype=float),
        np.array(ratios),
        np.array(rows[LONGITUDINAL]),
        transverse,
        np.array(rounding),
    )


def root(
    function: Callable[[float], float],
    ends: Sequence[float],
    values: Sequence[float] | None = None,
    close: float = 4e-16,
) -> float:
    """The sign change between two ends, relative to `close`: secants that keep the bracket
    (Illinois; Dowell & Jarratt 1971, doi:10.1007/BF01934364), every fourth time the middle.

    values: those at the ends, if known

    SciPy's does as well, and takes longer to be imported than a setting to be found.
    """
    (a, b), (fa, fb) = ends, values or [function(x) for x in ends]
    side = 0
    for turn in range(100):
        if abs(b - a) <= close * abs(b) or fa == fb:
            break
        c = (a + b) / 2 if turn % 4 == 3 else (fa * b - fb * a) / (fa - fb)
        fc = function(c)
        if fc == 0:
            return c
        if fc * fb > 0:
            b, fb = c, fc
            fa = fa / 2 if side == -1 else fa
            side = -1
        else:
            a, fa = c, fc
            fb = fb / 2 if side == 1 else fb
            side = 1
    return a if abs(fa) < abs(fb) else b


@dataclass(frozen=True)
class Map:
    """The largest growth rate over the zone, in c/h, for Δx/h (columns) and p (rows): (P, R);
    relative: min ω²/(c²k²) of the branch that is worst."""

    dx_over_h: Array
    pressure: Array
    growth_rate: Array
    relative: Array

    def to_csv(self) -> str:
        """dx_over_h, pressure, growth_rate, relative, one setting a line."""
        lines = ["dx_over_h,pressure,growth_rate,relative"]
        for i, p in enumerate(self.pressure):
            for j, r in enumerate(self.dx_over_h):
                lines.append(
                    f"{r:.17g},{p:.17g},{self.growth_rate[i, j]:.17g},{self.relative[i, j]:.17g}"
                )
        return "\n".join(lines) + "\n"


def stability_map(rest: Rest, ratios: Sequence[float], pressures: Sequence[float]) -> Map:
    """Every pair of Δx/h and p = P₀/(ρc²). D is a straight line in p >= 0 and in p < 0."""
    support = float(rest.kernel.support)
    scan = rest.scan(waves(rest.kind, COARSE[rest.dim]), support / min(ratios))
    p = np.asarray(pressures, dtype=float)
    shape = (len(p), len(ratios))
    rates, relative = np.zeros(shape), np.zeros(shape)
    for j, r in enumerate(ratios):
        at = replace(rest, ratio=Fraction(float(r)))
        lattice = scan.at(rest.kernel, float(r), rest.volume)
        line = []
        for sign in (1.0, -1.0):  # artificial stress sets in at once where tension begins
            one, two = (at.matrix(lattice, sign * x) for x in (1.0, 2.0))
            line.append((2 * one - two, two - one))
        tension = (p < 0)[:, None, None, None]
        none, slope = (np.where(tension, pull, press) for press, pull in zip(*line, strict=True))
        matrices = none + np.abs(p)[:, None, None, None] * slope
        values = eigenvalues(matrices)
        bound = at.rounding(lattice, p)[:, None, None]
        grown = np.abs(np.sqrt(values.astype(complex)).imag)
        rates[:, j] = np.where(values.real < -bound, grown, 0.0).max(axis=(1, 2))
        k2 = (scan.k / float(r)) ** 2
        relative[:, j] = (values.real / k2[:, None]).min(axis=(1, 2))
    return Map(np.asarray(ratios, dtype=float), p, rates, relative)
