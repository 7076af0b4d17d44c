"""sphtrunc: the truncation error of Smoothed Particle Hydrodynamics, derived and measured.

Theory and experiment return the same type, the discrete moments of an estimate.
They agree when the difference is zero.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphtrunc.comparison import compare as compare
    from sphtrunc.comparison import predict_error as predict_error
    from sphtrunc.derivation import Derivation as Derivation
    from sphtrunc.engine import pair_sums as pair_sums
    from sphtrunc.estimates import weights as weights
    from sphtrunc.experiment import measure as measure
    from sphtrunc.fields import field as field
    from sphtrunc.fields import polynomial as polynomial
    from sphtrunc.fields import sinusoid as sinusoid
    from sphtrunc.kernel import Kernel as Kernel
    from sphtrunc.measurement import Measurement as Measurement
    from sphtrunc.moments import Moments as Moments
    from sphtrunc.operators import Operator as Operator
    from sphtrunc.parse import kernel as kernel
    from sphtrunc.particles import particles as particles
    from sphtrunc.scene import graded as graded
    from sphtrunc.scene import jittered as jittered
    from sphtrunc.scene import lattice as lattice
    from sphtrunc.theory import derive as derive

__version__ = "0.1.0"

# name: module; imported on first use, so that `import sphtrunc` costs nothing
_PUBLIC = {
    "Derivation": "derivation",
    "Kernel": "kernel",
    "Measurement": "measurement",
    "Moments": "moments",
    "Operator": "operators",
    "compare": "comparison",
    "derive": "theory",
    "field": "fields",
    "graded": "scene",
    "jittered": "scene",
    "kernel": "parse",
    "lattice": "scene",
    "measure": "experiment",
    "pair_sums": "engine",
    "particles": "particles",
    "polynomial": "fields",
    "predict_error": "comparison",
    "sinusoid": "fields",
    "weights": "estimates",
}

__all__ = [
    "Derivation",
    "Kernel",
    "Measurement",
    "Moments",
    "Operator",
    "__version__",
    "compare",
    "derive",
    "field",
    "graded",
    "jittered",
    "kernel",
    "lattice",
    "measure",
    "pair_sums",
    "particles",
    "polynomial",
    "predict_error",
    "sinusoid",
    "weights",
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        value = getattr(import_module(f"sphtrunc.{_PUBLIC[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'sphtrunc' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


class _Package(ModuleType):
    """Keeps `sphtrunc.kernel` the function: importing a submodule would set the name to it."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _PUBLIC and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
