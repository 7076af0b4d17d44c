"""The structure factor of a scene, and what it predicts for explicit particles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.engine import volumes
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.particles import Particles
from sphtrunc.scenes.probes import Probes
from sphtrunc.theory.disorder.spectral_law import predict_errors_from, predict_from
from sphtrunc.theory.disorder.structure_factor import StructureFactor, displaced, measured

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel
    from sphtrunc.operators.operator import Operator
    from sphtrunc.scenes.scene import Scene
    from sphtrunc.theory.disorder.prediction import Prediction
    from sphtrunc.theory.field_error import Split
    from sphtrunc.theory.fields import Signals


def structure_factor(scene: Scene | Probes, *, reach: float | None = None) -> StructureFactor:
    """S(k) of a scene: in closed form for a lattice, displaced or not; measured for particles in a
    periodic box, every mode up to kΔx = reach (default: 40, 16, 10 in 1D, 2D, 3D), and, smeared,
    for free particles.

    Raises ValueError for graded spacing, which is not homogeneous, and as `measured` does.
    """
    if isinstance(scene, Jittered):
        return displaced(scene.lattice.kind, scene.sigma, scene.distribution)
    if isinstance(scene, Lattice):
        return displaced(scene.kind, 0.0)
    if isinstance(scene, Probes):
        return structure_factor(scene.home, reach=reach)
    if not isinstance(scene, Particles):
        raise ValueError(
            "scene: graded particles are not homogeneous and have no structure factor; expected a"
            " lattice, displaced or not, or particles"
        )
    return measured(scene.x, scene.period, reach=reach)


def _weighted(scene: Particles | Probes, kernel: Kernel) -> tuple[StructureFactor, float, str]:
    """S of what the particles fill, with their volumes; Δx/h; and where the targets are.

    Volumes by summation are the ones that they have, so that nothing is to first order in them.

    Raises ValueError where there is no theory.
    """
    at = "random" if isinstance(scene, Probes) else "particles"
    home = scene.home if isinstance(scene, Probes) else scene
    if home.period is None:
        raise ValueError(
            "scene: there is no theory for explicit particles without a periodic box; expected a"
            " period"
        )
    if not np.all(home.h == home.h[0]):
        raise ValueError(
            "scene: there is no theory for explicit particles that differ in h; expected one h"
        )
    name = f"structure factor {kernel!r}" if home.given is None else "structure factor"
    if name not in home._trees:
        home._trees[name] = measured(home.x, home.period, volumes=volumes(home, kernel))
    spacing = float(np.prod(home.period) / home.population) ** (1.0 / home.dim)
    return home._trees[name], spacing / float(home.h[0]), at


def predict_explicit(
    scene: Particles | Probes, kernel: Kernel | str, operator: Operator, degree: int = 3
) -> Prediction:
    """Predicted mean and standard deviation of the moments of the first component, for all points
    of the box, or for its particles.

    Raises ValueError where there is no theory: no box, unequal h, a form that the structure factor
    does not cover.
    """
    shape = parse_kernel(kernel)
    factor, ratio, at = _weighted(scene, shape)
    return predict_from(shape, operator, factor, ratio, at=at, degree=degree)


def predict_explicit_errors(
    scene: Particles | Probes,
    kernel: Kernel | str,
    operator: Operator,
    signals: Signals,
    precision: str = "plain",
) -> list[Split]:
    """The predicted error for each of K signals, likewise."""
    shape: Any = parse_kernel(kernel)
    factor, ratio, at = _weighted(scene, shape)
    return predict_errors_from(
        shape, operator, factor, ratio, signals, at=at, precision=precision
    )
