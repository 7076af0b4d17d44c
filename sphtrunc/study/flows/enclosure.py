"""Enclosures: a fluid of particles between walls, and how a field is continued beyond them.

Whatever is beyond a wall, its values are linear in those of the fluid and in those of the wall,

    A_all = C A + D A_w(p),        p points of the walls,

so that a wall treatment is a pair of matrices and serves every operator. Beyond a wall with the
outward distance d > 0 of a ghost, its foot p on the wall:

    mirror        the odd image 2 A_w(p) − A(x*), in a corner ∏ᵢ (2Pᵢ − 1) A with Pᵢ the foot on the
                  i-th wall, which are `scenes.walls`' "odd" ghosts on any particles
    dummy         2 A_w(p) less the Shepard mean of the fluid around it (Adami, Hu & Adams 2012,
                  doi:10.1016/j.jcp.2012.05.005)
    extrapolate   A_w(p) − d g, g the slope of the line through A_w(p) that fits the fluid around p
                  best, weighted by the kernel: exact for linear fields (in the spirit of Takeda,
                  Miyama & Sekiya 1994, doi:10.1143/ptp/92.5.939, who take a line for every pair)
    none          nothing: supports are cut, and the particles on the walls have their values
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.scenes.boxes import box
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.particles import Particles, particles
from sphtrunc.scenes.sites import KINDS, units
from sphtrunc.scenes.walls import PLACES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.scenes.lattice import Lattice

    Flags = NDArray[np.bool_]
    Indices = NDArray[np.int64]

#: what may be beyond the walls of a flow
WALLS = ("none", "mirror", "dummy", "extrapolate")
FEWEST = 5  # particles across
ON_WALL = 1e-9  # of the width: a particle as near as that is on the wall


@dataclass(frozen=True, eq=False)
class Enclosure:
    """A fluid between walls and what is beyond; lengths in the width between the first two walls.

    particles: the fluid, the first `count` of them, and the ghosts; wall: of `WALLS`
    continued: C, CSR (n, count); points: p, (d, P); given: D, CSR (n, P)
    on_wall: (count,) fluid particles on a wall, whose values are the wall's
    spacing: Δx; index: (d, count) where the fluid is in its lattice
    """

    particles: Particles
    count: int
    wall: str
    continued: Any
    points: Array
    given: Any
    on_wall: Flags
    spacing: float
    index: Indices

    @property
    def dim(self) -> int:
        """d."""
        return self.particles.dim

    @property
    def x(self) -> Array:
        """Of the fluid, (d, count)."""
        return self.particles.x[:, : self.count]

    @property
    def h(self) -> float:
        """The smoothing length of all."""
        return float(self.particles.h[0])

    def wall_part(self, wall: Callable[[Array], Array]) -> Array:
        """D A_w, (n,), of wall values as a function of points (d, P)."""
        return np.asarray(self.given @ wall(self.points))


def planes(
    scene: Lattice | Jittered,
    kernel: Kernel,
    counts: Sequence[int],
    walled: Sequence[bool],
    wall: str,
    *,
    at: object = None,
    reach: int = 1,
    moved: Array | None = None,
) -> Enclosure:
    """So many planes of a lattice along each axis, displaced or not, between plane walls.

    walled: axes that end in walls at 0 and at their side; the others are periodic
    at: steps from a wall to the first plane: "half-way" (the default), "particle" (without ghosts),
        or a number
    reach: how many supports ghosts fill: 2 for the nested form
    moved: (d, n) displacements in Δx in place of the scene's, of particles that are on no wall

    Raises ValueError for what is out of range, and where nothing gives the flow the wall's values.
    """
    known(wall)
    home = scene.lattice if isinstance(scene, Jittered) else scene
    place: Any = PLACES.get(str(at), at) if at is not None else PLACES[_usual(wall)]
    made = box(home, counts, walled=walled, at=place)
    few = [n for n, end in zip(counts, walled, strict=True) if end and n < FEWEST]
    if few:
        raise ValueError(
            f"N: got {few[0]} particles across, expected {FEWEST} or more between two walls"
        )
    scale = 1.0 / float(made.sides[list(walled).index(True)] if any(walled) else made.sides[0])
    length = np.array([float(u * home.dx_over_h) for u in units(home.kind)])
    steps = np.array([float(place) if end else 0.0 for end in walled])
    x = made.particles.x
    m = np.rint(x.T / length - steps).astype(np.int64).T
    on_wall = made.distance < ON_WALL
    if moved is None and isinstance(scene, Jittered):
        moved = scene.displacement(m)
    if moved is not None:
        x = x + np.where(on_wall, 0.0, moved * float(home.dx_over_h))
    ends = np.where(made.walled, made.sides, np.inf)
    lost = np.count_nonzero(
        np.any(np.array(made.walled)[:, None] & ((x < 0.0) | (x > ends[:, None])), axis=0)
    )
    if lost:
        raise ValueError(
            f"jitter: {lost} particles are displaced beyond a wall; expected σ/Δx up to 0.1, or"
            " uniform displacements"
        )
    cell = float(home.dx_over_h) ** home.dim
    volume = made.particles.given
    assert volume is not None
    if wall == "none" and not on_wall.any() and any(walled):
        raise ValueError(
            "wall: with none beyond the walls and no particles on them nothing gives the flow its"
            " values there: the problem is pure Neumann, and its solution is free by a constant;"
            " expected wall-at particle, or mirror, dummy or extrapolate"
        )
    if wall != "none":  # images complete a particle on the wall
        volume = np.full(x.shape[1], cell)
    period = np.where(made.walled, np.inf, made.sides)
    far = reach * float(kernel.support)
    ghosts = np.empty((home.dim, 0))
    if wall in ("dummy", "extrapolate"):
        ghosts = _beyond(home, counts, walled, steps, length, far)
    fluid = particles(x.T, h=1.0, volume=volume, period=None if all(walled) else period)
    found = (
        _mirrored(fluid, ends, far, cell)
        if wall == "mirror"
        else with_dummies(fluid, kernel, ghosts, np.clip(ghosts, 0.0, ends[:, None]), wall, cell)
    )
    return scaled(found, scale, wall, on_wall, float(home.dx_over_h), m)


def _usual(wall: str) -> str:
    return "particle" if wall == "none" else "half-way"


def known(wall: str) -> None:
    """Raises ValueError for what is no wall."""
    if wall not in WALLS:
        raise ValueError(f"wall: got {wall!r}, expected one of {', '.join(WALLS)}")


@dataclass(frozen=True, eq=False)
class Beyond:
    """A fluid with its ghosts, before it is scaled; as in `Enclosure`."""

    particles: Particles
    count: int
    continued: Any
    points: Array
    given: Any


def scaled(
    found: Beyond, scale: float, wall: str, on_wall: Flags, spacing: float, index: Indices
) -> Enclosure:
    """The enclosure with all lengths times a number."""
    old = found.particles
    assert old.given is not None
    new = particles(
        old.x.T * scale,
        h=old.h * scale,
        volume=old.given * scale**old.dim,
        period=None if old.period is None else old.period * scale,
    )
    return Enclosure(
        particles=new,
        count=found.count,
        wall=wall,
        continued=found.continued,
        points=found.points * scale,
        given=found.given,
        on_wall=on_wall,
        spacing=spacing * scale,
        index=index,
    )


def reflections(x: Array, ends: Array, far: float) -> tuple[Array, Indices, Array]:
    """All images of particles (d, n) in walls at 0 and `ends`, infinite along open axes, that lie
    within `far` of them, in corners too: positions (d, G), of which particle (G,), and −1 or +1,
    (d, G), at which end an axis is reversed, 0 where it is not."""
    dim, n = x.shape
    found: list[tuple[Array, Indices, Array]] = []
    options = [(-1, 0, 1) if np.isfinite(end) else (0,) for end in ends]
    for faces in product(*options):
        if not any(faces):
            continue
        y, near = x.copy(), np.ones(n, dtype=bool)
        for axis, face in enumerate(faces):
            if face:
                wall = ends[axis] if face > 0 else 0.0
                depth = np.abs(x[axis] - wall)
                y[axis] = 2.0 * wall - x[axis]
                # a particle on the wall is its own image
                near &= (depth > ON_WALL * ends[axis]) & (depth <= far * (1 + ON_WALL))
        which = np.flatnonzero(near)
        row = np.repeat(np.array(faces, dtype=float)[:, None], which.size, axis=1)
        found.append((y[:, which], which.astype(np.int64), row))
    if not found:
        return np.empty((dim, 0)), np.empty(0, dtype=np.int64), np.empty((dim, 0))
    positions, sources, faces_of = zip(*found, strict=True)
    return (
        np.concatenate(positions, axis=1),
        np.concatenate(sources),
        np.concatenate(faces_of, axis=1),
    )


def feet(x: Array, ends: Array, faces: Array) -> list[tuple[Indices, float, Array]]:
    """∏ᵢ (2Pᵢ − 1) = Σ_S 2^{|S|} (−1)^{k−|S|} P_S over the sets S of walls that images (d, G) are
    reversed in: for every set of axes but the empty one, which images, the factor without its sign
    (−1)^k, and the feet P_S (d, ·) of x (d, G), the places of the originals."""
    dim = len(x)
    found = []
    for axes in chain.from_iterable(combinations(range(dim), k) for k in range(1, dim + 1)):
        which = np.flatnonzero(np.all(faces[list(axes)] != 0, axis=0))
        if which.size == 0:
            continue
        foot = x[:, which].copy()
        for axis in axes:
            foot[axis] = np.where(faces[axis, which] > 0, ends[axis], 0.0)
        found.append((which, (-2.0) ** len(axes), foot))
    return found


def _mirrored(fluid: Particles, ends: Array, far: float, cell: float | None) -> Beyond:
    """The fluid with its odd images; cell: their volume, None for that of their originals."""
    from scipy.sparse import csr_array

    n = fluid.population
    y, source, faces = reflections(fluid.x, ends, far)
    ghosts = y.shape[1]
    total = n + ghosts
    sign = np.prod(np.where(faces != 0, -1.0, 1.0), axis=0)
    columns = np.concatenate([np.arange(n), source])
    values = np.concatenate([np.ones(n), sign])
    continued = csr_array((values, (np.arange(total), columns)), shape=(total, n))
    parts = feet(fluid.x[:, source], ends, faces)
    row = np.concatenate([which + n for which, _, _ in parts] or [np.empty(0, dtype=np.int64)])
    factor = np.concatenate([sign[which] * c for which, c, _ in parts] or [np.empty(0)])
    points = np.concatenate([foot for _, _, foot in parts] or [np.empty((fluid.dim, 0))], axis=1)
    given = csr_array((factor, (row, np.arange(row.size))), shape=(total, row.size))
    assert fluid.given is not None
    volume = fluid.given[source] if cell is None else cell
    return Beyond(joined(fluid, y, volume), n, continued, points, given)


def joined(fluid: Particles, ghosts: Array, volume: Array | float) -> Particles:
    """The fluid and behind it ghosts (d, G), of one h."""
    assert fluid.given is not None
    return particles(
        np.concatenate([fluid.x, ghosts], axis=1).T,
        h=float(fluid.h[0]),
        volume=np.concatenate([fluid.given, np.broadcast_to(volume, ghosts.shape[1])]),
        period=fluid.period,
    )


def _beyond(
    home: Lattice,
    counts: Sequence[int],
    walled: Sequence[bool],
    steps: Array,
    length: Array,
    far: float,
) -> Array:
    """The lattice beyond its walls, (d, G), out to a distance, in h."""
    more = [int(np.ceil(far / u)) + 1 if end else 0 for u, end in zip(length, walled, strict=True)]
    axes = [np.arange(-k, n + k) for n, k in zip(counts, more, strict=True)]
    m = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")])
    outside = np.any((m < 0) | (m >= np.array(counts)[:, None]), axis=0)
    m = m[:, outside & KINDS[home.kind].contains(m)]
    return np.asarray((m + steps[:, None]) * length[:, None])


def with_dummies(
    fluid: Particles, kernel: Kernel, ghosts: Array, foot: Array, wall: str, cell: float
) -> Beyond:
    """The fluid with dummies (d, G), their feet on the wall (d, G), that carry 2 A_w less a Shepard
    mean, or the line through A_w; without any for wall "none"."""
    from scipy.sparse import csr_array, vstack

    n = fluid.population
    around = foot if wall == "extrapolate" else ghosts
    row, column, weight = seen(fluid, kernel, around)
    kept, row = np.unique(row, return_inverse=True)  # the others are seen by no fluid either
    ghosts, foot = ghosts[:, kept], foot[:, kept]
    count = kept.size
    if wall == "extrapolate":
        out = ghosts - foot
        depth = np.sqrt((out * out).sum(axis=0))
        inward = -((fluid.x[:, column] - foot[:, row]) * out[:, row]).sum(axis=0) / depth[row]
        moment = np.bincount(row, weights=weight * inward**2, minlength=count)
        slope = weight * inward * (depth / moment)[row]
        own = 1.0 + np.bincount(row, weights=slope, minlength=count)
        weight = slope
    else:
        weight = weight / np.bincount(row, weights=weight, minlength=count)[row]
        own = np.full(count, 2.0)
    ghost = csr_array((-weight, (row, column)), shape=(count, n))
    unit = csr_array((np.ones(n), (np.arange(n), np.arange(n))), shape=(n, n))
    at = np.arange(count)
    return Beyond(
        joined(fluid, ghosts, cell),
        n,
        csr_array(vstack([unit, ghost])) if count else unit,
        foot,
        csr_array((own, (n + at, at)), shape=(n + count, count)),
    )


def seen(fluid: Particles, kernel: Kernel, at: Array) -> tuple[Indices, Indices, Array]:
    """Pairs (place, fluid particle) within the support, and W V of them, for places (d, G)."""
    if at.shape[1] == 0:
        none = np.empty(0, dtype=np.int64)
        return none, none, np.empty(0)
    reach = float(kernel.support) * float(fluid.h[0])
    gap = fluid.x[:, :, None]  # periodic axes: the nearest image
    rows, columns, distances = [], [], []
    for first in range(0, at.shape[1], 256):
        s = gap - at[:, None, first : first + 256]
        if fluid.period is not None:
            for axis in np.flatnonzero(np.isfinite(fluid.period)):
                s[axis] -= fluid.period[axis] * np.rint(s[axis] / fluid.period[axis])
        square = (s * s).sum(axis=0)
        column, row = np.nonzero(square < reach * reach)
        rows.append(row + first)
        columns.append(column)
        distances.append(np.sqrt(square[column, row]))
    row, column = np.concatenate(rows), np.concatenate(columns)
    order = np.lexsort((column, row))
    row, column = row[order], column[order]
    q = np.concatenate(distances)[order] / float(fluid.h[0])
    assert fluid.given is not None
    return row, column, np.asarray(kernel.w(q, fluid.dim)) * fluid.given[column]


def bounded(
    scene: Particles, kernel: Kernel, wall: str, *, reach: int = 1
) -> tuple[Enclosure, int]:
    """Somebody's particles between two walls normal to the first axis, and how many are across: the
    ends of their periodic box, or, where the file has wall particles, half-way between these and
    the fluid. Dummies are the wall particles.

    Raises ValueError for particles without a box and walls, for dummies without wall particles, for
    volumes that are not given, and for fewer than 5 particles across.
    """
    known(wall)
    if scene.given is None:
        raise ValueError("particles: a flow needs a volume for each, m/ρ; got none")
    solid = scene.walls if scene.walls is not None else np.zeros(scene.population, dtype=bool)
    x, fluid_x = scene.x, scene.x[:, ~solid]
    if wall == "none":
        raise ValueError(
            "wall: no particles are on the walls, so that with none nothing gives the flow its"
            " values there: the problem is pure Neumann; expected mirror, dummy or extrapolate"
        )
    if wall in ("dummy", "extrapolate") and not solid.any():
        raise ValueError(
            f"wall: {wall} needs wall particles, and these have none; expected mirror, or a file"
            " with boundary particles"
        )
    period = scene.period
    if solid.any():
        low, high = float(fluid_x[0].min()), float(fluid_x[0].max())
        below, above = x[0, solid & (x[0] < low)], x[0, solid & (x[0] > high)]
        if not below.size or not above.size:
            raise ValueError(
                "particles: expected wall particles below and above the fluid along the first axis"
            )
        ends = 0.5 * (low + float(below.max())), 0.5 * (high + float(above.min()))
    elif period is not None and np.isfinite(period[0]):
        ends = 0.0, float(period[0])
        fluid_x = fluid_x.copy()
        fluid_x[0] = np.mod(fluid_x[0], ends[1])
    else:
        raise ValueError(
            "particles: no wall particles and no box along the first axis say where the walls are;"
            " expected either"
        )
    width = ends[1] - ends[0]
    spacing = float(np.median(scene.given[~solid]) ** (1.0 / scene.dim))
    across = round(width / spacing)
    if across < FEWEST:
        raise ValueError(f"particles: got {across} across, expected {FEWEST} or more")
    h = float(scene.h[0])
    if not np.all(scene.h == h):
        raise ValueError("particles: expected one smoothing length for all, as --h gives")
    unit = 1.0 / h
    shifted = fluid_x.copy()
    shifted[0] -= ends[0]
    open_ = np.full(scene.dim, np.inf)
    if period is not None:
        open_[1:] = period[1:] * unit
    fluid = particles(
        (shifted * unit).T, h=1.0, volume=scene.given[~solid] * unit**scene.dim,
        period=None if np.all(np.isinf(open_)) else open_,
    )  # fmt: skip
    box_ends = np.full(scene.dim, np.inf)
    box_ends[0] = width * unit
    far, cell = reach * float(kernel.support), (spacing * unit) ** scene.dim
    if wall == "mirror":
        found = _mirrored(fluid, box_ends, far, None)
    else:
        ghosts = x[:, solid].copy()
        ghosts[0] -= ends[0]
        ghosts *= unit
        found = with_dummies(
            fluid, kernel, ghosts, np.clip(ghosts, 0.0, box_ends[:, None]), wall, cell
        )
    count = fluid.population
    index = np.zeros((scene.dim, count), dtype=np.int64)
    index[0] = np.minimum((fluid.x[0] / box_ends[0] * across).astype(np.int64), across - 1)
    on_wall = np.zeros(count, dtype=bool)
    return scaled(found, h / width, wall, on_wall, spacing * unit, index), across
