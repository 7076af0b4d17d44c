"""The structure factor of a scene, and what it predicts for explicit particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.arithmetic.rational import exact
from sphtrunc.experiment.engine import volumes
from sphtrunc.experiment.glasses import glass
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.particles import Particles
from sphtrunc.scenes.probes import Probes
from sphtrunc.scenes.relaxed import Recipe
from sphtrunc.scenes.sites import DEFAULT
from sphtrunc.theory.disorder.spectral_law import predict_errors_from, predict_from
from sphtrunc.theory.disorder.structure_factor import (
    StructureFactor,
    displaced,
    measured,
    poisson,
)
from sphtrunc.theory.fields import Waves

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.scenes.scene import Scene
    from sphtrunc.theory.disorder.prediction import Prediction
    from sphtrunc.theory.field_error import Split
    from sphtrunc.theory.fields import Signals


def structure_factor(scene: Scene, *, reach: float | None = None) -> StructureFactor:
    """S(k) of a scene: in closed form for a lattice, displaced or not; measured for particles in a
    periodic box, every mode up to kΔx = reach (default: 40, 16, 10 in 1D, 2D, 3D), and, smeared,
    for free particles.

    Raises ValueError for graded spacing, which is not homogeneous, and as `measured` does.
    """
    if isinstance(scene, Arrangement):
        return displaced(scene.kind, scene.sigma, scene.distribution)
    if isinstance(scene, Probes):
        return structure_factor(scene.home, reach=reach)
    if not isinstance(scene, Particles):
        raise ValueError(
            "scene: graded particles are not homogeneous and have no structure factor; expected a"
            " lattice, displaced or not, or particles"
        )
    closed = scene.period is not None and bool(np.all(np.isfinite(scene.period)))
    return measured(scene.x, scene.period if closed else None, reach=reach)


@dataclass(frozen=True, eq=False)
class Place:
    """A part of a set whose density varies.

    low, size: (d,) of the part; spacing: Δx in it, Δx^d = its volume over its particles
    factor: S(k) there, in units of that spacing
    """

    low: NDArray[np.float64]
    size: NDArray[np.float64]
    spacing: float
    factor: StructureFactor


def local_structure(
    scene: Particles, parts: int | Sequence[int], *, reach: float | None = None
) -> list[Place]:
    """S(k) in sub-boxes of particles whose density varies slowly, so many along each axis.

    Particles count by their volumes, where these are given, which takes the slope of the density
    out of S; each part is looked at through a Hann window, and S is smeared over 2π over its size:
    it is the disorder of the part, and what is slower than that, such as a profile that the
    particles miss, is not in it.

    Raises ValueError for parts with fewer than 64 particles.
    """
    counts = np.broadcast_to(np.asarray(parts), (scene.dim,))
    if counts.dtype.kind not in "iu" or not np.all(counts >= 1):
        raise ValueError(f"local: got {parts!r}, expected how many parts along each axis")
    x = scene.x
    low, size = x.min(axis=1), np.ptp(x, axis=1) * (1 + 1e-12)
    if scene.period is not None:
        closed = np.isfinite(scene.period)
        period = np.where(closed, scene.period, 1.0)
        x = np.where(closed[:, None], np.mod(x, period[:, None]), x)
        low, size = np.where(closed, 0.0, low), np.where(closed, scene.period, size)
    size = size / counts
    weights = np.ones(scene.population) if scene.given is None else scene.given
    found = []
    for index in np.ndindex(*counts.tolist()):
        corner = low + size * index
        s = x - corner[:, None]
        inside = np.all((s >= 0) & (s < size[:, None]), axis=0)
        number = int(np.count_nonzero(inside))
        if number < _FEWEST:
            raise ValueError(
                f"local: a part has {number} particles, expected at least {_FEWEST}; fewer parts"
            )
        factor = measured(x[:, inside], volumes=weights[inside], reach=reach)
        spacing = float(np.prod(size) / number) ** (1.0 / scene.dim)
        found.append(Place(corner, size, spacing, factor))
    return found


_FEWEST = 64  # particles of a sub-box
GLASS = {1: 1024, 2: 1024, 3: 4096}  # particles of the glass that stands for all
STEPS = 150


def disorder(
    text: str, dim: int, scene: Particles | None = None
) -> tuple[StructureFactor, Fraction]:
    """(S in closed form, α of S ∝ k^α at long waves) of jitter:0.1, poisson or glass, a glass of
    pair repulsion made for that; or of the particles of `scene`.

    Raises ValueError for anything else.
    """
    sort, _, size = text.partition(":")
    if scene is None and sort == "jitter":
        sigma = float(exact(size, "disorder"))
        return displaced(DEFAULT[dim], sigma), Fraction(2)
    if scene is None and text == "poisson":
        return poisson(dim), Fraction(0)
    if scene is None and text != "glass":
        raise ValueError(
            f"disorder: got {text[:40]!r}, expected jitter:0.1, glass, poisson or a file"
        )
    home = scene or glass(Recipe(count=GLASS[dim], dim=dim, steps=STEPS)).particles
    if home.dim != dim:
        raise ValueError(f"disorder: {text[:40]} is {home.dim}D, expected {dim}D")
    found = structure_factor(home)
    return found.smoothed(), found.fit().power


def by_structure(scene: Scene) -> bool:
    """Predictions for the scene rest on its structure factor: explicit particles, and points of
    space anywhere among those of a lattice."""
    return isinstance(scene, (Particles, Probes)) or getattr(scene, "anywhere", False)


def _described(scene: Any, kernel: Kernel) -> tuple[StructureFactor, dict[str, Any]]:
    """S, and Δx/h, the rule for volumes and where the targets are, as the law takes them.

    For explicit particles S is that of what they fill, with the volumes that they have, by
    summation too: nothing is to first order in them then.

    Raises ValueError where there is no theory.
    """
    if isinstance(scene, Jittered):
        ratio, volume = float(scene.dx_over_h), scene.volume
        return structure_factor(scene), {"dx_over_h": ratio, "volume": volume, "at": "random"}
    require_theory(scene)
    at = "random" if isinstance(scene, Probes) else "particles"
    home: Particles = getattr(scene, "home", scene)
    known = home._trees
    name = "structure factor"
    if name not in known or (home.given is None and known.get(f"{name} for") != kernel):
        known[f"{name} for"] = kernel
        known[name] = measured(home.x, home.period, volumes=volumes(home, kernel))
    assert home.period is not None
    spacing = float(np.prod(home.period) / home.population) ** (1.0 / home.dim)
    return known[name], {"dx_over_h": spacing / float(home.h[0]), "at": at}


def require_theory(scene: Any) -> None:
    """Raises ValueError for explicit particles without a box, or that differ in h."""
    home = getattr(scene, "home", scene)
    if not isinstance(home, Particles):
        return
    if home.period is None or not np.all(np.isfinite(home.period)):
        raise ValueError(
            "scene: there is no theory for explicit particles without a periodic box; expected a"
            " period"
        )
    if not np.all(home.h == home.h[0]):
        raise ValueError(
            "scene: there is no theory for explicit particles that differ in h; expected one h"
        )


def predict_by_structure(
    scene: Scene, kernel: Kernel | str, operator: Operator, degree: int = 3
) -> Prediction:
    """Predicted mean and standard deviation of the moments of the first component, over all points
    of space, or over the particles.

    Raises ValueError where there is no theory: no box, unequal h, a form that the structure factor
    does not cover.
    """
    shape = parse_kernel(kernel)
    factor, options = _described(scene, shape)
    return predict_from(shape, operator, factor, degree=degree, **options)


def errors_by_structure(
    scene: Scene,
    kernel: Kernel | str,
    operator: Operator,
    signals: Signals,
    precision: str = "plain",
) -> list[Split]:
    """The predicted error for each of K signals, likewise."""
    shape: Any = parse_kernel(kernel)
    factor, options = _described(scene, shape)
    return predict_errors_from(
        shape, operator, factor, signals=signals, precision=precision, **options
    )


def waves_by_structure(
    scene: Scene, kernel: Kernel | str, operator: Operator, h_over_lambda: Sequence[float]
) -> list[Split]:
    """The predicted error for sinusoids along the first axis, one for every h/λ."""
    kappa = 2 * np.pi * np.asarray(h_over_lambda, dtype=np.float64)
    signals = Waves(kappa, np.eye(scene.dim)[0])
    return errors_by_structure(scene, kernel, operator, signals)
