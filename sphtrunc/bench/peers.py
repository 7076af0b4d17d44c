"""Peers: what others do on the same particles, for a race in one run."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np


def query_pairs(x: Any, h: float, field: Any) -> Any:
    """The gradient with a pair list from SciPy's k-d tree and whole NumPy arrays, cubic spline."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(x).query_pairs(2.0 * h, output_type="ndarray")
    i, j = pairs[:, 0], pairs[:, 1]
    d = [x[j, axis] - x[i, axis] for axis in range(3)]
    r = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    q = r / h
    slope = np.where(q < 1.0, 2.25 * q * q - 3.0 * q, -0.75 * np.maximum(2.0 - q, 0.0) ** 2)
    slope /= np.pi * h**4 * r
    n = len(x)
    out = np.empty((3, n))
    for axis in range(3):
        term = slope * d[axis]
        out[axis] = np.bincount(j, term * field[i], n) - np.bincount(i, term * field[j], n)
    return out


def has_pysph() -> bool:
    """PySPH, which compiles its loops, is installed."""
    return find_spec("pysph") is not None


def pysph(x: Any, h: float, field: Any) -> Callable[[], Any]:
    """The same by PySPH (Ramachandran et al. 2021, doi:10.1145/3460773): linked lists and a loop
    compiled to C with OpenMP; compiled here, run by what is returned."""
    from compyle.api import get_config
    from pysph.base.kernels import CubicSpline
    from pysph.base.nnps import LinkedListNNPS
    from pysph.base.utils import get_particle_array
    from pysph.sph.acceleration_eval import AccelerationEval
    from pysph.sph.sph_compiler import SPHCompiler

    from sphtrunc.bench.pysph_gradient import Gradient

    get_config().use_openmp = True
    ones = np.ones(len(x))
    axes = {name: np.ascontiguousarray(row) for name, row in zip("xyz", x.T, strict=True)}
    values = {"h": h * ones, "V": ones, "A": field, "gx": 0.0, "gy": 0.0, "gz": 0.0}
    fluid = get_particle_array(name="fluid", **axes, **values)
    loop = AccelerationEval([fluid], [Gradient("fluid", ["fluid"])], CubicSpline(dim=3))
    SPHCompiler(loop, None).compile()

    def run() -> Any:
        loop.set_nnps(LinkedListNNPS(dim=3, particles=[fluid], radius_scale=2.0))
        loop.compute(0.0, 0.1)
        return np.stack([fluid.gx, fluid.gy, fluid.gz])

    return run
