"""The Taylor–Green vortex: eigenvalues of matrices against symbols."""

from __future__ import annotations

from fractions import Fraction
from math import pi

import numpy as np
import pytest

from sphtrunc import Operator, kernel
from sphtrunc.arithmetic.summation import UNIT
from sphtrunc.study.flows.flow import flow
from sphtrunc.study.flows.results import Vortex
from sphtrunc.study.flows.vortex import symbol

FORMS = [
    ("brookshaw", "none"),
    ("difference", "none"),
    ("direct", "none"),
    ("direct", "shepard"),
    ("fatehi-manzari", "none"),
    ("difference", "rkpm-2"),
    ("nested", "none"),
    ("nested", "csph"),
]


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
@pytest.mark.parametrize("form", FORMS, ids="-".join)
def test_the_rate_on_a_lattice_is_the_symbol(form: tuple, lattice: str) -> None:
    """To the rounding of rows whose entries are as large as 1/Δx²."""
    found = flow("taylor-green", "wendland-c2", across=16, form=form[0], correction=form[1],
                 lattice=lattice)  # fmt: skip
    assert isinstance(found, Vortex)
    decay = found.decay
    assert decay.predicted is not None
    largest = 4.0 * 16.0**2 * (8.0 if form[0] == "nested" else 2.0)  # of Σ|w|
    bound = 64.0 * UNIT * largest
    assert abs(decay.rate - decay.predicted) < 64.0 * bound
    assert abs(decay.error) > 1e-4  # there is something to agree on


def test_the_symbol_of_one_pair_by_hand() -> None:
    """1D, cubic spline, Δx/h = 5/6, Brookshaw: 2 Σ V (−W′/q) (cos κs − 1), two neighbours."""
    from sphtrunc import lattice

    ratio = Fraction(5, 6)
    scene = lattice(1, dx_over_h=ratio)
    total = 0.0
    for j in (1, 2):
        q = float(j * ratio)
        slope = (-2 * q + 1.5 * q * q) if q < 1 else -0.5 * (2 - q) ** 2
        total += 2 * float(ratio) * 2 * (-slope / q) * (np.cos(0.3 * q) - 1) * (1 / 1.0)
    found = symbol(kernel("cubic-spline"), Operator("laplacian", "brookshaw"), scene,
                   np.array([0.3]))  # fmt: skip
    # the kernel is 2/3 (1 − 3q²/2 + 3q³/4), 1/6 (2 − q)³ in 1D
    assert found == pytest.approx(total, rel=1e-14)


def test_disorder_splits_four_vortices() -> None:
    found = flow("taylor-green", "wendland-c2", across=16, jitter="1/10")
    assert isinstance(found, Vortex)
    low, high = found.decay.spread
    assert low < found.decay.rate <= high
    assert high - low > 1e-3 * found.decay.exact
    assert found.decay.predicted is None
    assert found.decay.exact == pytest.approx(8 * pi**2, rel=1e-15)
    assert 0 < found.decay.likeness <= 1
