"""sphtrunc: the truncation error of Smoothed Particle Hydrodynamics, derived and measured.

Theory and experiment return the same type, the discrete moments of an estimate.
They agree when the difference is zero.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.experiment.adapted_lengths import adapted as adapted
    from sphtrunc.experiment.engine import pair_sums as pair_sums
    from sphtrunc.experiment.fields import field as field
    from sphtrunc.experiment.fields import polynomial as polynomial
    from sphtrunc.experiment.fields import sinusoid as sinusoid
    from sphtrunc.experiment.matrices import weights as weights
    from sphtrunc.experiment.measurement import Measurement as Measurement
    from sphtrunc.experiment.measuring import measure as measure
    from sphtrunc.kernels.kernel import Kernel as Kernel
    from sphtrunc.kernels.parse import kernel as kernel
    from sphtrunc.operators.moments import Moments as Moments
    from sphtrunc.operators.operator import Operator as Operator
    from sphtrunc.scenes.boxes import box as box
    from sphtrunc.scenes.graded import graded as graded
    from sphtrunc.scenes.jittered import jittered as jittered
    from sphtrunc.scenes.lattice import beside_wall as beside_wall
    from sphtrunc.scenes.lattice import lattice as lattice
    from sphtrunc.scenes.particles import particles as particles
    from sphtrunc.scenes.smoothing_lengths import sloped as sloped
    from sphtrunc.scenes.snapshots.formats import snapshot as snapshot
    from sphtrunc.study.comparison import compare as compare
    from sphtrunc.study.comparison import predict_error as predict_error
    from sphtrunc.study.conservation.conserving import conserve as conserve
    from sphtrunc.study.flows.flow import flow as flow
    from sphtrunc.study.snapshots.error_map import error_map as error_map
    from sphtrunc.study.structure import structure_factor as structure_factor
    from sphtrunc.theory.derivation import Derivation as Derivation
    from sphtrunc.theory.deriving import derive as derive
    from sphtrunc.theory.walls.remedies import remedies as remedies

# name: module; imported on first use, so that `import sphtrunc` costs nothing
_PUBLIC = {
    "Derivation": "theory.derivation",
    "Kernel": "kernels.kernel",
    "Measurement": "experiment.measurement",
    "Moments": "operators.moments",
    "Operator": "operators.operator",
    "adapted": "experiment.adapted_lengths",
    "beside_wall": "scenes.lattice",
    "box": "scenes.boxes",
    "compare": "study.comparison",
    "conserve": "study.conservation.conserving",
    "derive": "theory.deriving",
    "error_map": "study.snapshots.error_map",
    "field": "experiment.fields",
    "flow": "study.flows.flow",
    "graded": "scenes.graded",
    "jittered": "scenes.jittered",
    "kernel": "kernels.parse",
    "lattice": "scenes.lattice",
    "measure": "experiment.measuring",
    "pair_sums": "experiment.engine",
    "particles": "scenes.particles",
    "polynomial": "experiment.fields",
    "predict_error": "study.comparison",
    "remedies": "theory.walls.remedies",
    "sinusoid": "experiment.fields",
    "sloped": "scenes.smoothing_lengths",
    "snapshot": "scenes.snapshots.formats",
    "structure_factor": "study.structure",
    "weights": "experiment.matrices",
}

__all__ = [
    "__version__",
    *_PUBLIC,
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        value = getattr(import_module(f"sphtrunc.{_PUBLIC[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'sphtrunc' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
