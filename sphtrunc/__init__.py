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
    from sphtrunc.kernel import Kernel as Kernel
    from sphtrunc.moments import Moments as Moments
    from sphtrunc.operators import Operator as Operator
    from sphtrunc.parse import kernel as kernel
    from sphtrunc.theory import derive as derive

__version__ = "0.1.0"

# name: module; imported on first use, so that `import sphtrunc` costs nothing
_PUBLIC = {
    "Derivation": "derivation",
    "Kernel": "kernel",
    "Moments": "moments",
    "Operator": "operators",
    "compare": "comparison",
    "derive": "theory",
    "kernel": "parse",
    "predict_error": "comparison",
}

__all__ = [
    "Derivation",
    "Kernel",
    "Moments",
    "Operator",
    "__version__",
    "compare",
    "derive",
    "kernel",
    "predict_error",
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
