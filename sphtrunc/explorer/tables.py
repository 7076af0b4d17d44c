"""The exact tables that the page computes from: rationals as text, whole numbers, and names.

Nothing is typed here that another file knows: shapes come from the catalogue, lattices from the
rules of `sphtrunc.scenes.sites`, forms from the operators, best paths from their exponents.
"""

from __future__ import annotations

from itertools import product
from typing import Any

from sphtrunc.kernels import parse
from sphtrunc.kernels.catalogue import named, names
from sphtrunc.kernels.conventions import CONVENTIONS
from sphtrunc.operators.operator import CORRECTIONS, OPERATORS, Operator
from sphtrunc.scenes.sites import DEFAULT, KINDS, in_pairs, units
from sphtrunc.study.tuning import exponents
from sphtrunc.version import __version__

Table = dict[str, Any]

MOST_NEIGHBOURS = {1: 100, 2: 400, 3: 1000}  # so that every curve is drawn while a slider moves
H_OVER_LAMBDA = (0.001, 0.5)
MOST_JITTER = 0.3  # σ/Δx: the page's disorder is of first order
START = {
    "kernel": "cubic-spline",
    "dim": "3",
    "lattice": "cubic",
    "form": "standard",
    "correction": "none",
    "dx-over-h": "5/6",
    "h-over-lambda": "0.05",
    "jitter": "0",
}


def tables() -> Table:
    """Everything the page knows, ready for JSON."""
    return {
        "schema": "sphtrunc.explorer/1",
        "version": __version__,
        "kernels": {name: _kernel(name) for name in names()},
        "lattices": {kind: _lattice(kind) for kind in KINDS},
        "default_lattice": {str(dim): kind for dim, kind in DEFAULT.items()},
        "forms": _forms(),
        "paths": _paths(),
        "conventions": {
            name: {"says": data.says, "who": data.who, "length": data.length}
            for name, data in CONVENTIONS.items()
        },
        "caps": {
            "length": parse.MAX_LENGTH,
            "nesting": parse.MAX_NESTING,
            "degree": parse.MAX_DEGREE,
            "digits": parse.MAX_DIGITS,
            "bits": parse.MAX_BITS,
            "pieces": parse.MAX_PIECES,
        },
        "most_neighbours": {str(dim): n for dim, n in MOST_NEIGHBOURS.items()},
        "h_over_lambda": list(H_OVER_LAMBDA),
        "most_jitter": MOST_JITTER,
        "start": START,
    }


def _kernel(name: str) -> Table:
    kernel = named(name)
    return {
        "knots": [str(knot) for knot in kernel.knots],
        "pieces": [[str(c) for c in piece] for piece in kernel.coefficients()],
        "source": kernel.source,
    }


def _lattice(kind: str) -> Table:
    """The period of a lattice along each axis, in its integer points, and the sites in it."""
    lattice = KINDS[kind]
    period = [_period(kind, axis) for axis in range(lattice.dim)]
    return {
        "dim": lattice.dim,
        "units": [float(unit) for unit in units(kind)],
        "period": period,
        "sites": [list(m) for m in product(*map(range, period)) if _contains(kind, m)],
        "pairs": in_pairs(kind, (0,) * lattice.dim),
    }


def _period(kind: str, axis: int) -> int:
    """The least step along an axis that takes sites to sites, and what is none to what is none."""
    dim = KINDS[kind].dim
    box = list(product(range(12), repeat=dim))

    def repeats(step: int) -> bool:
        def moved(m: tuple[int, ...]) -> tuple[int, ...]:
            return tuple(n + step * (i == axis) for i, n in enumerate(m))

        return all(_contains(kind, m) == _contains(kind, moved(m)) for m in box)

    return next(step for step in range(1, 13) if repeats(step))


def _contains(kind: str, point: tuple[int, ...]) -> bool:
    import numpy as np

    return bool(KINDS[kind].contains(np.array(point)[:, None])[0])


def _forms() -> dict[str, list[str]]:
    """form -> the corrections that apply to it."""
    found: dict[str, list[str]] = {}
    for form, correction in product(OPERATORS["gradient"][1], CORRECTIONS):
        try:
            Operator("gradient", form, correction)
        except ValueError:
            continue
        found.setdefault(form, []).append(correction)
    return found


def _paths() -> dict[str, dict[str, list[Table]]]:
    """form and correction -> dim -> the best path h ∝ Δx^p at fixed disorder, for β = −1, 0, and 1
    or more."""
    return {
        f"{form} {correction}": {
            str(dim): [
                {
                    "p": str(found.p),
                    "order": str(found.order),
                    "neighbours": str(found.neighbours),
                }
                for found in (
                    exponents(Operator("gradient", form, correction), dim, beta=beta)
                    for beta in (-1, 0, 1)
                )
            ]
            for dim in DEFAULT
        }
        for form, corrections in _forms().items()
        for correction in corrections
    }
