"""The lid-driven cavity, steady, on its particles: streamfunction and vorticity.

    −∇²ψ = ω,     u ∂ω/∂x + v ∂ω/∂y = ∇²ω/Re,     u = ∂ψ/∂y,  v = −∂ψ/∂x,

on the unit square, ψ = 0 on the walls, u = 1 on the lid y = 1. Every derivative is the matrix of an
estimate. ψ is continued evenly beyond the walls, with its slope at the lid, ψ(1 + d) = ψ(1 − d) +
2d, so that the first equation on a wall *is* the no-slip condition (Thom 1933,
doi:10.1098/rspa.1933.0146, for whatever estimate); ω oddly about its value on the wall, as an
`Enclosure`'s mirror does. Both have smooth unknowns where velocity and pressure on the same
particles have a null space. Newton's method with one sparse factorisation for as many steps as it
is good for, and continuation in Re.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.matrices import weights
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.particles import particles
from sphtrunc.study.flows.enclosure import feet, reflections

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.kernels.kernel import Kernel

FEWEST = 9  # particles along a side
STEPS = 14  # of Newton's method at one Re
TOLERANCE = 1e-9  # of the last step in ψ
FORCING = 1e-3  # to which a step of Newton's method is solved where the factors are old
ROUNDS = 25  # of lgmres with old factors, beyond which they are made anew
PIVOT = 1e-3  # of a column, from which the diagonal is taken
SMALLEST = 1.02  # ratio of two Re, below which continuation gives up
LINE = 4001  # points at which a spline through a profile is looked at
WEIGHTLESS = 1e-30  # volume of a point where fields are read, in Δx²


@dataclass(frozen=True)
class Estimates:
    """Which matrices stand for derivatives."""

    laplacian: Operator
    gradient: Operator

    @property
    def reach(self) -> int:
        """Supports that a row sees."""
        return 2 if self.laplacian.form == NESTED else 1


@dataclass(frozen=True, eq=False)
class Profile:
    """The steady flow at one Re.

    psi, omega, u, v: at the particles, (n,); along: places on the centre lines, (k,); u_line: u on
    x = 1/2, v_line: v on y = 1/2, (k,); steps: of Newton's method
    """

    re: float
    psi: Array
    omega: Array
    u: Array
    v: Array
    along: Array
    u_line: Array
    v_line: Array
    steps: int

    @property
    def extrema(self) -> dict[str, float]:
        """u_min on x = 1/2, v_max and v_min on y = 1/2, of cubic splines through the lines."""
        from scipy.interpolate import CubicSpline

        fine = np.linspace(0.0, 1.0, LINE)
        u, v = (CubicSpline(self.along, line)(fine) for line in (self.u_line, self.v_line))
        return {"u_min": float(u.min()), "v_max": float(v.max()), "v_min": float(v.min())}

    def at(self, name: str, places: Array) -> Array:
        """u or v on its centre line."""
        from scipy.interpolate import CubicSpline

        line = self.u_line if name == "u" else self.v_line
        return np.asarray(CubicSpline(self.along, line)(places))


@dataclass(frozen=True, eq=False)
class Cavity:
    """Steady flows in a cavity at growing Re.

    x: (2, n); profiles: as far as they go; stopped: the Re at which Newton's method failed, None
    where it did not; unknowns, entries: of the linear systems, and of a factorisation;
    factorisations: how many; seconds: "matrices", "newton" and "factorisation", of one
    """

    x: Array
    side: int
    profiles: list[Profile]
    stopped: float | None
    unknowns: int
    entries: int
    factorisations: int
    seconds: dict[str, float]


@cache
def published() -> dict[str, Any]:
    """The published values: see the file."""
    text = files("sphtrunc.study.flows").joinpath("cavity.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def cavity(
    kernel: Kernel,
    estimates: Estimates,
    side: int,
    dx_over_h: float,
    reynolds: Sequence[float],
    *,
    displacement: Callable[[NDArray[np.int64]], Array] | None = None,
    progress: Callable[[float, int], None] | None = None,
) -> Cavity:
    """The steady flow on side × side particles, those at the edge on the walls.

    reynolds: at which a flow is kept, growing
    displacement: u (d, n) in Δx at lattice points, of the particles that are on no wall
    progress: called with Re and the steps of Newton's method at it

    Raises ValueError for fewer than 9 particles along a side, for Re that are not positive and
    growing, and as `weights` does.
    """
    if side < FEWEST:
        raise ValueError(f"N: got {side} particles along a side, expected {FEWEST} or more")
    wanted = [float(re) for re in reynolds]
    if not wanted or wanted != sorted(set(wanted)) or not 0 < wanted[0] <= wanted[-1] <= 1e5:
        raise ValueError(f"re: got {wanted}, expected growing numbers above 0, 100000 at most")
    start = time.perf_counter()
    fluid = _Square(kernel, estimates, side, dx_over_h, displacement)
    clock = {"matrices": time.perf_counter() - start}
    newton = _Newton(fluid)
    start = time.perf_counter()
    profiles: list[Profile] = []
    stopped = None
    psi, omega = np.zeros((2, fluid.count))
    reached = 0.0
    for re in wanted:
        target = re
        while reached < re:
            found = newton.at(target, psi, omega)
            if found is None:
                # the middle of the two in size; from rest, a fifth
                target = (reached * target) ** 0.5 if reached else target / 5.0
                if (reached and target < SMALLEST * reached) or target < 1e-3:
                    stopped = re
                    break
                continue
            psi, omega, steps = found
            reached, target = target, re
            if progress is not None:
                progress(reached, steps)
        if stopped is not None:
            break
        profiles.append(fluid.profile(re, psi, omega, steps))
    clock["newton"] = time.perf_counter() - start
    clock["factorisation"] = newton.seconds / max(newton.count, 1)
    return Cavity(
        fluid.x, side, profiles, stopped, newton.unknowns, newton.entries, newton.count, clock
    )


class _Square:
    """The particles of the cavity and the matrices on them."""

    def __init__(
        self,
        kernel: Kernel,
        estimates: Estimates,
        side: int,
        dx_over_h: float,
        displacement: Callable[[NDArray[np.int64]], Array] | None,
    ) -> None:
        self.kernel, self.side = kernel, side
        self.spacing = 1.0 / (side - 1)
        self.h = self.spacing / dx_over_h
        steps = np.arange(side, dtype=np.int64)
        index = np.stack([a.ravel() for a in np.meshgrid(steps, steps, indexing="ij")])
        self.on_wall = np.any((index == 0) | (index == side - 1), axis=0)
        x = np.asarray(index * self.spacing)
        if displacement is not None:
            x = x + np.where(self.on_wall, 0.0, displacement(index) * self.spacing)
        self.x: Array = x
        self.count = x.shape[1]
        far = estimates.reach * float(kernel.support) * self.h
        if far >= 0.5:
            raise ValueError(
                f"dx_over_h: a row reaches {far:.3g} of the cavity, expected less than half;"
                " expected more particles, or a smaller h"
            )
        y, source, faces = reflections(self.x, np.ones(2), far)
        even, rise = self._even(y, source, faces)
        odd = self._odd(source, faces)
        scene = particles(np.concatenate([x, y], axis=1).T, h=self.h, volume=self.spacing**2)
        rows = np.arange(self.count)
        ahead, across = (
            weights(scene, kernel, estimates.gradient, axis=axis, targets=rows) for axis in (0, 1)
        )
        laplacian = weights(scene, kernel, estimates.laplacian, targets=rows)
        self.u, self.u_lid = (across @ even).tocsr(), across @ rise
        self.v, self.v_lid = (-(ahead @ even)).tocsr(), -(ahead @ rise)
        self.psi, self.psi_lid = (laplacian @ even).tocsr(), laplacian @ rise
        self.ahead, self.across = (ahead @ odd).tocsr(), (across @ odd).tocsr()
        self.omega = (laplacian @ odd).tocsr()

    def _even(self, y: Array, source: NDArray[np.int64], faces: Array) -> tuple[Any, Array]:
        """ψ at the particles and their images: matrix, and what the lid adds."""
        from scipy.sparse import csr_array

        total = self.count + y.shape[1]
        column = np.concatenate([np.arange(self.count), source])
        matrix = csr_array((np.ones(total), (np.arange(total), column)), shape=(total, self.count))
        rise = np.zeros(total)
        rise[self.count :] = np.where(faces[1] > 0, 2.0 * (y[1] - 1.0), 0.0)
        return matrix, rise

    def _odd(self, source: NDArray[np.int64], faces: Array) -> Any:
        """ω at the particles and their images, with ω on the walls between their particles."""
        from scipy.sparse import csr_array

        n, total = self.count, self.count + source.size
        sign = np.prod(np.where(faces != 0, -1.0, 1.0), axis=0)
        column = np.concatenate([np.arange(n), source])
        values = np.concatenate([np.ones(n), sign])
        matrix = csr_array((values, (np.arange(total), column)), shape=(total, n))
        for which, factor, foot in feet(self.x[:, source], np.ones(2), faces):
            place = foot / self.spacing
            low = np.clip(np.floor(place + 1e-9), 0, self.side - 2).astype(np.int64)
            part = np.clip(place - low, 0.0, 1.0)
            part[np.abs(part) < 1e-9] = 0.0
            for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
                weight = np.abs(1 - i - part[0]) * np.abs(1 - j - part[1])
                some = weight > 1e-9
                at = (low[0] + i) * self.side + low[1] + j
                entry = (sign[which] * factor * weight)[some]
                matrix = matrix + csr_array((entry, (n + which[some], at[some])), shape=(total, n))
        return csr_array(matrix)

    def profile(self, re: float, psi: Array, omega: Array, steps: int) -> Profile:
        """What is kept of a solution."""
        u, v = self.u @ psi + self.u_lid, self.v @ psi + self.v_lid
        lid = self.x[1] == 1.0
        u = np.where(self.on_wall, lid.astype(float), u)
        v = np.where(self.on_wall, 0.0, v)
        along = np.linspace(0.0, 1.0, self.side)
        half = np.full(self.side, 0.5)
        down, level = self._read(np.stack([half, along])), self._read(np.stack([along, half]))
        return Profile(re, psi, omega, u, v, along, down @ u, level @ v, steps)

    def _read(self, places: Array) -> Any:
        """A matrix that takes fields at the particles to points (2, k): RKPM-2, or the value itself
        where a particle is there."""
        from scipy.sparse import csr_array

        k = places.shape[1]
        volume = np.full(self.count + k, self.spacing**2)
        volume[self.count :] *= WEIGHTLESS
        scene = particles(
            np.concatenate([self.x, places], axis=1).T, h=max(self.h, 1.2 * self.spacing),
            volume=volume,
        )  # fmt: skip
        value = Operator("value", "standard", "rkpm-2")
        rows = weights(scene, self.kernel, value, targets=self.count + np.arange(k))
        matrix = rows[:, : self.count].tolil()
        gap = np.abs(self.x[:, :, None] - places[:, None, :]).max(axis=0)
        for column, row in zip(*np.nonzero(gap < 1e-12), strict=True):
            matrix[row] = 0.0
            matrix[row, column] = 1.0
        return csr_array(matrix)


class _Newton:
    """Newton's method for (ψ inside, ω everywhere), a particle's unknowns side by side.

    Rows and unknowns are scaled such that all are of the size of ψ/Δx² on a lattice, so that the
    diagonal may be taken as pivot.
    """

    def __init__(self, fluid: _Square) -> None:
        from scipy.sparse import csr_array

        self.fluid = fluid
        n = fluid.count
        every = np.arange(n)
        self.inside = np.flatnonzero(~fluid.on_wall)
        m = self.inside.size
        self.unknowns = n + m
        self.count, self.entries, self.seconds = 0, 0, 0.0
        self._factors: Any = None
        self.take = csr_array((np.ones(m), (self.inside, np.arange(m))), shape=(n, m))
        self.order = np.argsort(np.concatenate([2 * self.inside, 2 * every + 1]))
        rows = np.concatenate([2 * every + fluid.on_wall, 2 * self.inside + 1])
        self.rows = np.argsort(rows)

    def _scales(self, re: float) -> tuple[Array, Array]:
        """Of rows and of unknowns."""
        n, m, a = self.fluid.count, self.inside.size, self.fluid.spacing**2
        rows = np.concatenate([np.full(n, a), np.full(m, re * a * a)])
        unknowns = np.concatenate([np.ones(m), np.full(n, 1.0 / a)])
        return rows[self.rows], unknowns[self.order]

    def _residual(self, re: float, psi: Array, omega: Array) -> Array:
        f = self.fluid
        u, v = f.u @ psi + f.u_lid, f.v @ psi + f.v_lid
        turned = f.psi @ psi + f.psi_lid + omega
        carried = u * (f.ahead @ omega) + v * (f.across @ omega) - (f.omega @ omega) / re
        return np.concatenate([turned, carried[self.inside]])[self.rows]

    def _jacobian(self, re: float, psi: Array, omega: Array) -> Any:
        from scipy.sparse import block_array, diags_array, eye_array

        f = self.fluid
        u, v = f.u @ psi + f.u_lid, f.v @ psi + f.v_lid
        by_psi = diags_array(f.ahead @ omega) @ f.u + diags_array(f.across @ omega) @ f.v
        by_omega = diags_array(u) @ f.ahead + diags_array(v) @ f.across - f.omega / re
        blocks = [
            [f.psi @ self.take, eye_array(f.count)],
            [by_psi.tocsr()[self.inside] @ self.take, by_omega.tocsr()[self.inside]],
        ]
        whole = block_array(blocks, format="csr")[self.rows][:, self.order]
        left, right = self._scales(re)
        return (diags_array(left) @ whole @ diags_array(right)).tocsc()

    def at(self, re: float, psi: Array, omega: Array) -> tuple[Array, Array, int] | None:
        """The solution nearest to a start, and the steps that it took; None where it is not found.

        A step that would double the residual is refused.
        """
        psi, omega = psi.copy(), omega.copy()
        left, right = self._scales(re)
        residual = left * self._residual(re, psi, omega)
        first = float(np.abs(residual).max())
        for step in range(1, STEPS + 1):
            jacobian = self._jacobian(re, psi, omega)
            change = np.zeros(self.unknowns)
            change[self.order] = right * self._solve(jacobian, -residual)
            m = self.inside.size
            psi[self.inside] += change[:m]
            omega += change[m:]
            residual = left * self._residual(re, psi, omega)
            size = float(np.abs(residual).max())
            if not np.isfinite(size) or size > 1e3 * max(first, 1.0):
                return None
            if float(np.abs(change[:m]).max()) < TOLERANCE:
                return psi, omega, step
        return None

    def _solve(self, jacobian: Any, right: Array) -> Array:
        """By lgmres with the last factors while they are good for it, else by new ones."""
        from scipy.sparse.linalg import LinearOperator, lgmres, splu

        if self._factors is not None:
            close = LinearOperator(jacobian.shape, self._factors.solve, dtype=float)
            x, failed = lgmres(
                jacobian, right, M=close, rtol=FORCING, atol=0.0, maxiter=2, inner_m=ROUNDS
            )
            if not failed:
                return np.asarray(x)
        start = time.perf_counter()
        self._factors = splu(
            jacobian, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=PIVOT,
            options={"SymmetricMode": True},
        )  # fmt: skip
        self.seconds += time.perf_counter() - start
        self.count += 1
        self.entries = int(self._factors.nnz)
        return np.asarray(self._factors.solve(right))
