"""A flow by its name: its particles, its system, its solution, and the prediction beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sphtrunc.arithmetic.rational import exact
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.boxes import box
from sphtrunc.scenes.jittered import Jittered, jittered
from sphtrunc.scenes.lattice import lattice as make_lattice
from sphtrunc.scenes.particles import Particles, particles
from sphtrunc.study.flows.annulus import annulus, velocity
from sphtrunc.study.flows.annulus import slowest as annulus_slowest
from sphtrunc.study.flows.cases import CASES, Case
from sphtrunc.study.flows.cavity import Estimates, cavity
from sphtrunc.study.flows.enclosure import Enclosure, bounded, planes
from sphtrunc.study.flows.predicted import Predicted, Setting, predict
from sphtrunc.study.flows.results import FLOWS, Asked, Lid, Steady, Vortex
from sphtrunc.study.flows.steady import (
    SINGULAR,
    Mode,
    Solver,
    System,
    amplification,
    roughness,
    slowest,
    system,
)
from sphtrunc.study.flows.vortex import decay, fewest_along

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array
    from sphtrunc.scenes.lattice import Lattice

MODES = 3  # of the slowest transients


def flow(
    name: str,
    kernel: Kernel | str,
    *,
    across: int | None = None,
    along: int | None = None,
    dim: int | None = None,
    lattice: str | None = None,
    dx_over_h: object = None,
    form: str | None = None,
    correction: str | None = None,
    gradient_form: str | None = None,
    gradient_correction: str | None = None,
    wall: str | None = None,
    wall_at: object = None,
    jitter: object = None,
    distribution: str = "gaussian",
    seed: int = 0,
    scene: Particles | None = None,
    reynolds: Sequence[float] | None = None,
    progress: Callable[[float, int], None] | None = None,
) -> Steady | Vortex | Lid:
    """Solve a flow on frozen particles and say how wrong it is, and why.

    name: of `FLOWS`; across: particles between the walls, or along a side (default: 40, cavity 65);
        along: planes along periodic axes (default: `across` on displaced particles, else the
        fewest); dim: default 2
    form, correction: of the Laplacian (default: brookshaw; difference with rkpm-2 in the cavity);
        gradient_form, gradient_correction: cavity only (default: difference, csph where the
        Laplacian is exact for quadratic fields, else none)
    wall: of `enclosure.WALLS` (default: mirror); wall_at: steps from a wall to the first plane
    dx_over_h: default 2/3, in the cavity 10/13
    jitter, distribution, seed: displacements of the lattice, σ/Δx
    scene: particles in place of a lattice: in a periodic box for taylor-green; else between walls
        at the ends of the box, or before the wall particles of a file
    reynolds: cavity only, default 100, 400, 1000; progress: called with Re and Newton's steps

    Raises ValueError for what does not apply or is out of range, and where a system is singular.
    """
    if name not in FLOWS:
        raise ValueError(f"flow: got {name!r}, expected one of {', '.join(FLOWS)}")
    shape = parse_kernel(kernel)
    if not isinstance(shape, Kernel):
        raise ValueError(
            f"kernel: {shape.name} has no compiled sums, of which matrices are made; expected a"
            " polynomial one"
        )
    _require_meant(
        name,
        {
            "along": along,
            "wall": wall,
            "wall-at": wall_at,
            "gradient-form": gradient_form,
            "gradient-correction": gradient_correction,
            "re": reynolds,
            "particles": scene,
        },
    )
    dims = FLOWS[name][1]
    dim = (scene.dim if scene is not None else 2) if dim is None else dim
    if dim not in dims:
        raise ValueError(f"dim: got {dim} for {name}, expected {' or '.join(str(d) for d in dims)}")
    if form is None:
        form = "difference" if name == "cavity" and correction is None else "brookshaw"
        correction = correction or ("rkpm-2" if name == "cavity" else None)
    operator = Operator("laplacian", form, correction or "none")
    lattice_only = {
        "across": across, "along": along, "lattice": lattice, "dx-over-h": dx_over_h,
        "jitter": jitter, "wall-at": wall_at,
    }  # fmt: skip
    for argument, value in lattice_only.items():
        if scene is not None and value is not None:
            raise ValueError(f"{argument}: particles were given, which are where they are")
    if dx_over_h is None:
        dx_over_h = "10/13" if name == "cavity" else "2/3"
    home = make_lattice(dim, lattice, dx_over_h)
    moved: Lattice | Jittered = home
    if jitter is not None:
        moved = jittered(home, jitter, distribution, seed)
    if across is None:
        across = 65 if name == "cavity" else 40
    wall = None if name == "taylor-green" else wall or "mirror"
    asked = Asked(
        name, shape.name, dim, home.kind, across, 0, float(home.dx_over_h),
        getattr(moved, "sigma", 0.0), distribution, seed, form, operator.correction, wall,
    )  # fmt: skip
    if name == "cavity":
        return _cavity(
            asked, shape, operator, moved, (gradient_form, gradient_correction), reynolds, progress
        )
    if name == "taylor-green":
        return _vortex(asked, shape, operator, moved, scene)
    if name == "rotating-couette":
        return _rotating(asked, shape, operator, moved)
    if scene is not None:
        return _on_given(asked, shape, operator, scene)
    return _channel(asked, shape, operator, moved, along, wall_at)


_ONLY = {
    "along": ("poiseuille", "couette", "duct"),
    "wall": ("poiseuille", "couette", "duct", "rotating-couette"),
    "wall-at": ("poiseuille", "couette", "duct"),
    "gradient-form": ("cavity",),
    "gradient-correction": ("cavity",),
    "re": ("cavity",),
    "particles": ("poiseuille", "couette", "taylor-green"),
}


def _require_meant(name: str, given: dict[str, object]) -> None:
    """No argument is silently ignored."""
    for argument, value in given.items():
        if value is not None and name not in _ONLY[argument]:
            raise ValueError(
                f"{argument}: has no meaning for {name}, only for {', '.join(_ONLY[argument])}"
            )


def _reach(operator: Operator) -> int:
    return 2 if operator.form == NESTED else 1


def _channel(
    asked: Asked,
    kernel: Kernel,
    operator: Operator,
    scene: Lattice | Jittered,
    along: int | None,
    at: object,
) -> Steady:
    case = CASES[asked.flow]
    counts = _counts(asked, kernel, along, case.walls)
    assert asked.wall is not None
    place = None if at is None else (at if str(at) in ("particle", "half-way") else exact(at, "at"))
    setting = Setting(scene, kernel, operator, counts, asked.wall, place)
    start = time.perf_counter()
    if case.walls == 1:
        enclosure = setting.enclosure()
    else:
        walled = [axis < case.walls for axis in range(asked.dim)]
        enclosure = planes(scene, kernel, counts, walled, asked.wall, at=place, reach=setting.reach)
    found = _solved(asked, case, enclosure, kernel, operator, start)
    if case.walls > 1:
        return _with(found, None, f"there is no theory for the corners of a {case.name}")
    try:
        still, base = found, enclosure
        if isinstance(scene, Jittered) and scene.sigma:
            lattice_setting = Setting(setting.home, kernel, operator, counts, asked.wall, place)
            base = lattice_setting.enclosure()
            still = _solved(asked, case, base, kernel, operator, start, bare=True)
        expected = predict(setting, case, base, still.system, still.solver, still.u)
        return _with(found, expected, "")
    except ValueError as reason:
        return _with(found, None, str(reason))


def _counts(asked: Asked, kernel: Kernel, along: int | None, walls: int) -> tuple[int, ...]:
    """Planes along each axis."""
    few = fewest_along(kernel, asked.dx_over_h, 1)
    usual = max(few, asked.across) if asked.jitter else few
    if asked.lattice not in ("uniform", "square", "cubic"):  # periods of the others
        few, usual = few + -few % 6, usual + -usual % 6
    chosen = usual if along is None else along
    if along is not None and along < few:
        raise ValueError(
            f"along: got {along}, expected {few} or more, so that no particle meets its own image"
        )
    return tuple(asked.across if axis < walls else chosen for axis in range(asked.dim))


@dataclass(frozen=True, eq=False)
class _Solved:
    """A flow before it is compared."""

    asked: Asked
    case: Case
    enclosure: Enclosure
    system: System
    solver: Solver
    u: Array
    modes: list[Mode]
    seconds: dict[str, float]


def _solved(
    asked: Asked,
    case: Case,
    enclosure: Enclosure,
    kernel: Kernel,
    operator: Operator,
    start: float,
    bare: bool = False,
) -> _Solved:
    found = system(enclosure, kernel, operator, case.u)
    made = time.perf_counter()
    solver = Solver(found.matrix, asked.dim)
    u = solver(case.forcing - found.known)
    clock = {"matrix": made - start, "solution": time.perf_counter() - made}
    modes = [] if bare else slowest(solver, MODES)
    return _Solved(asked, case, enclosure, found, solver, u, modes, clock)


def _with(found: _Solved, expected: Predicted | None, none: str) -> Steady:
    case, enclosure, free = found.case, found.enclosure, found.system.free
    x = enclosure.x[:, free]
    true = case.u(x)
    error = found.u - true
    matrix = found.system.matrix
    stored = matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes
    asked = _counted(found.asked, enclosure.count)
    return Steady(
        asked=asked,
        rms=float(np.sqrt(np.mean(error**2))),
        largest=float(np.abs(error).max()),
        mean=float(error.mean()),
        x=x,
        exact=true,
        solution=found.u,
        predicted=expected,
        none=none,
        amplification=amplification(found.solver),
        exact_amplification=1.0 / case.slowest,
        slowest=[mode.value for mode in found.modes],
        exact_slowest=case.slowest,
        singular=_singular(found, case.slowest),
        bytes=int(stored + 16 * found.solver.entries),
        seconds=found.seconds,
    )


def _counted(asked: Asked, count: int) -> Asked:
    return replace(asked, particles=count)


def _singular(found: _Solved, expected: float) -> str:
    """What is wrong with the smallest eigenvalue: too small, or of a mode that is no smooth one."""
    if not found.modes:
        return ""
    mode = found.modes[0]
    if abs(mode.value) >= 0.5 * expected and mode.value.real > 0:
        return ""
    index = found.enclosure.index[:, found.system.free]
    rough = roughness(mode.vector, index)
    kind = "sawtooth" if rough.max() > 0.5 else "smooth"
    shown = ", ".join(f"{r:.2f}" for r in rough)
    what = "singular" if abs(mode.value) < SINGULAR * expected else "nearly singular"
    if mode.value.real < 0 and abs(mode.value) >= SINGULAR * expected:
        what = "indefinite"
    return (
        f"the operator is {what}: the smallest eigenvalue of −L is {mode.value.real:.3g},"
        f" expected {expected:.3g}; its mode is a {kind} (it changes sign between {shown} of the"
        " neighbours along each axis)"
    )


def _rotating(
    asked: Asked, kernel: Kernel, operator: Operator, scene: Lattice | Jittered
) -> Steady:
    start = time.perf_counter()
    assert asked.wall is not None
    enclosure = annulus(scene, kernel, asked.across, asked.wall, reach=_reach(operator))
    parts = [_component(axis) for axis in (0, 1)]
    found = _solved(asked, parts[0], enclosure, kernel, operator, start)
    other = system(enclosure, kernel, operator, parts[1].u)
    x = enclosure.x
    v = np.stack([found.u, found.solver(-other.known)])
    turn = np.stack([-x[1], x[0]]) / np.sqrt((x * x).sum(axis=0))
    around = (v * turn).sum(axis=0)
    along = Case(
        asked.flow, FLOWS[asked.flow][0], 1,
        lambda at: (velocity(at) * np.stack([-at[1], at[0]])).sum(axis=0)
        / np.sqrt((at * at).sum(axis=0)),
        0.0, annulus_slowest(),
    )  # fmt: skip
    whole = _Solved(
        asked, along, enclosure, found.system, found.solver, around, found.modes, found.seconds
    )
    return _with(whole, None, "there is no theory beside walls with a curvature")


def _component(axis: int) -> Case:
    return Case("rotating-couette", "", 1, lambda at: velocity(at)[axis], 0.0, annulus_slowest())


def _on_given(asked: Asked, kernel: Kernel, operator: Operator, scene: Particles) -> Steady:
    """A plane flow on somebody's particles."""
    start = time.perf_counter()
    case = CASES[asked.flow]
    assert asked.wall is not None
    enclosure, across = bounded(scene, kernel, asked.wall, reach=_reach(operator))
    asked = replace(asked, across=across, lattice="given")
    found = _solved(asked, case, enclosure, kernel, operator, start)
    return _with(found, None, "there is theory for lattices, displaced or not, only")


def _vortex(
    asked: Asked,
    kernel: Kernel,
    operator: Operator,
    scene: Lattice | Jittered,
    given: Particles | None,
) -> Vortex:
    start = time.perf_counter()
    home = None
    if given is None:
        n = asked.across
        few = fewest_along(kernel, asked.dx_over_h, 1)
        if n < few:
            raise ValueError(
                f"N: got {n} particles across, expected {few} or more, so that no particle meets"
                " its own image"
            )
        counts = [n + n % 2 if asked.lattice == "hexagonal" else n] * 2
        made = box(scene, counts, walled=[False, False])
        given = _unit(made.particles)
        home = scene if not isinstance(scene, Jittered) else None
    else:
        given = _unit(given)
        spacing = float((np.prod(given.period) / given.population) ** 0.5)  # type: ignore[arg-type]
        asked = replace(
            asked, lattice="given", across=round(1.0 / spacing),
            dx_over_h=spacing / float(given.h[0]),
        )  # fmt: skip
    found = decay(given, kernel, operator, home)
    return Vortex(_counted(asked, given.population), found, time.perf_counter() - start)


def _unit(scene: Particles) -> Particles:
    """The particles in a box whose first side is 1."""
    if scene.period is None or not np.all(np.isfinite(scene.period)) or scene.dim != 2:
        raise ValueError(
            "particles: taylor-green needs a periodic box of two dimensions, as"
            " relaxed:glass,N=1024; or give --period"
        )
    scale = 1.0 / float(scene.period[0])
    volume = scene.given if scene.given is not None else scene.volume
    if not isinstance(volume, str):
        volume = volume * scale**2
    return particles(
        scene.x.T * scale,
        h=scene.h * scale,
        volume=volume,
        mass=None if not isinstance(volume, str) else scene.mass,
        period=scene.period * scale,
    )


def _cavity(
    asked: Asked,
    kernel: Kernel,
    operator: Operator,
    scene: Lattice | Jittered,
    gradient: tuple[str | None, str | None],
    reynolds: Sequence[float] | None,
    progress: Callable[[float, int], None] | None,
) -> Lid:
    if asked.lattice != "square":
        raise ValueError(f"lattice: got {asked.lattice} for the cavity, expected square")
    corrected = operator.consistency >= 1
    form, correction = gradient
    if form is None:
        form = "difference"
    if correction is None:
        correction = "csph" if corrected else "none"
    slope = Operator("gradient", form, correction)
    found = cavity(
        kernel,
        Estimates(operator, slope),
        asked.across,
        asked.dx_over_h,
        (100.0, 400.0, 1000.0) if reynolds is None else reynolds,
        displacement=scene.displacement if isinstance(scene, Jittered) else None,
        progress=progress,
    )
    return Lid(_counted(asked, found.x.shape[1]), slope, found)
