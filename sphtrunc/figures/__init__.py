"""The figures: every result of the theory with measured points beside it, for any kernel."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphtrunc.figures.picture import Picture

#: name of a figure: (module, what it shows)
FIGURES = {
    "kernels": ("uniform", "Kernels, their derivatives and their Fourier transforms."),
    "uniform-smoothing": ("uniform", "Error against h/λ at several Δx/h, uniform particles."),
    "uniform-discretisation": (
        "uniform",
        "Error against Δx/h at several h/λ, and an edge formula.",
    ),
    "kernel-comparison": ("uniform", "Error against Δx/h at h/λ = 0.0018 for many kernels."),
    "disorder-h": ("disorder", "Error against h/λ for σ/Δx from 0 to 0.2."),
    "disorder-dx": ("disorder", "Error against Δx/h for σ/Δx from 0 to 0.2."),
    "randomness": ("disorder", "Gaussian, uniform, blue, relaxed and graded particles, equal σ."),
    "structure": ("structure", "S(k) of independent, displaced and relaxed particles."),
    "disorder-kinds": ("structure", "Gradient noise against neighbours, each kind of disorder."),
    "relaxation": ("structure", "Gradient noise at and between particles as they relax."),
    "first-order": ("disorder", "CSPH and RKPM-1 against standard and difference forms."),
    "3d-standard": ("disorder", "3D, σ/Δx = 0.2, against h/λ and neighbours."),
    "3d-corrected": ("disorder", "The same for corrected forms."),
    "stencils": ("tradeoffs", "Weights beside central differences; modified wavenumbers."),
    "tuning": ("tradeoffs", "Total error over (h/λ, Δx/h) with the best path."),
    "second-derivatives": ("disorder", "Forms of the Laplacian, uniform and disordered."),
    "round-off": ("tradeoffs", "Rounding of three forms in three precisions, and its floors."),
    "work-precision": ("tradeoffs", "Error against pairs, along the best path."),
    "dispersion": ("stability", "Sound on a lattice: forms and pressures, and the limit."),
    "tensile": ("stability", "Growth under tension over Δx/h and P₀, and in runs."),
    "pairing": ("stability", "The weakest waves against neighbours, both branches, on fcc."),
    "remedies": ("stability", "Artificial stress, total Lagrangian, stress points."),
    "wall-profile": ("walls", "Leading errors against the distance from a wall, each remedy."),
    "wall-convergence": ("walls", "Error against h/λ beside a wall, orders −1 to 2."),
    "wall-lattice": ("walls", "What the place of a wall in the lattice adds."),
    "time-step": ("stability", "The largest stable time step of leapfrog."),
    "conservation": ("conserving", "Momentum error against truncation error, form by form."),
    "variable-h": ("conserving", "Moments with a gradient of h; six rules in an atmosphere."),
    "density-drift": ("conserving", "Summed against integrated density, six ways to step."),
    "flow-error": ("flows", "Error of flows against N, form by form, uniform and displaced."),
    "cavity-lines": ("flows", "The cavity's centre lines, corrected or not, beside Ghia et al."),
    "cavity-map": ("flows", "Streamlines of the cavity, and where its velocity is wrong."),
}


def make(name: str, kernel: str | None = None, quick: bool = False) -> Picture:
    """The figure of that name, for another kernel than its own if one is given.

    quick: fewer points and targets, for a look; the curves are the same.

    Raises ValueError for an unknown name.
    """
    if name not in FIGURES:
        raise ValueError(f"figure: got {name!r}, expected one of {', '.join(FIGURES)}")
    module = import_module(f"sphtrunc.figures.{FIGURES[name][0]}")
    picture: Picture = getattr(module, name.replace("-", "_").replace("3d", "three_d"))(
        kernel, quick
    )
    return picture


def names(wanted: Sequence[str] = ()) -> list[str]:
    """All names, or those wanted, checked."""
    for name in wanted:
        if name not in FIGURES:
            raise ValueError(f"figure: got {name!r}, expected one of {', '.join(FIGURES)}")
    return list(wanted or FIGURES)
