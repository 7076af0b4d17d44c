"""Speed of the pair engines on explicit particles, from raw arrays to the result: beside the limits
of the machine and other codes, and what it saves to leave out what is not asked for.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from typing import Any

import numpy as np

import sphtrunc.bench.peers as peers
from sphtrunc.bench.report import Table, alternately, spread
from sphtrunc.experiment.engine import available, pair_sums, threads
from sphtrunc.experiment.fields import sinusoid
from sphtrunc.experiment.measurement import Measurement
from sphtrunc.experiment.measuring import measure
from sphtrunc.experiment.one_pass import estimates
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.jittered import jittered
from sphtrunc.scenes.lattice import lattice
from sphtrunc.scenes.particles import Particles, particles


def box(side: int, h: float, *, sigma: float = 0.2, dim: int = 3, seed: int = 0) -> Particles:
    """A cubic lattice of side^dim particles, spacing 1, displaced at random by sigma."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij")).reshape(dim, -1)
    x = grid + sigma * rng.standard_normal(grid.shape)
    return particles(x.T, h=h, volume=1.0)


def engine(quick: bool) -> Iterator[Table]:
    """The pair engines on explicit particles, from raw arrays to the result."""
    side, repeats = (40, 3) if quick else (100, 7)
    if available()[0] == "numba":
        yield _first_call()
    for h in (1.2, 1.5) if quick else (1.2, 1.5, 2.0):
        yield _tasks(side, h, repeats)
    for h in (1.2,) if quick else (1.2, 1.5, 2.0):
        yield _peers(30 if quick else 100, h, 1 if quick else 3)
    yield _scaling(quick)
    yield _crowding(20 if quick else 46, repeats)
    yield _workers(side, repeats)
    yield _limits(side, repeats)
    yield _skipping(side, repeats)
    yield _sampling(16 if quick else 32)


def _once(
    scene: Particles,
    field: Any,
    name: str = "cubic-spline",
    operator: Operator | None = None,
    **options: Any,
) -> Any:
    """One evaluation as a user would: a scene from arrays, then the operator."""
    fresh = particles(scene.x.T, h=scene.h[0], volume=1.0)
    return estimates(fresh, parse_kernel(name), operator or Operator("gradient"), field, **options)


def _tasks(side: int, h: float, repeats: int) -> Table:
    scene = box(side, h)
    field = np.sin(0.1 * scene.x[0])
    csph = Operator("gradient", "difference", "csph")
    tasks: dict[str, Callable[[], Any]] = {
        "gradient, cubic-spline": lambda: _once(scene, field),
        "gradient, wendland-c2": lambda: _once(scene, field, "wendland-c2"),
        "gradient, polynomial:4": lambda: _once(scene, field, "polynomial:4"),
        "CSPH, cubic-spline": lambda: _once(scene, field, operator=csph),
        "compensated, cubic-spline": lambda: _once(scene, field, precision="compensated"),
        "5 fields, cubic-spline": lambda: _once(scene, np.stack([field] * 5)),
    }
    neighbours = float(_once(scene, field).neighbours.mean())
    for task in tasks.values():
        task()
    times = alternately(tasks, repeats)
    first = median(times["gradient, cubic-spline"])
    pairs = scene.population * neighbours
    return Table(
        f"{side}³ particles jittered by 0.2 Δx, h = {h} Δx, {neighbours:.0f} neighbours",
        ("task", "seconds", "best", "± %", "ratio", "ns a pair", "particles/s"),
        [
            (
                name,
                median(t),
                min(t),
                100 * spread(t),
                median(t) / first,
                1e9 * median(t) / pairs,
                scene.population / median(t),
            )
            for name, t in times.items()
        ],
        f"medians of {len(times['CSPH, cubic-spline'])}, from raw arrays to result, all cores",
    )


def _scaling(quick: bool) -> Table:
    rows = []
    for side in (10, 22, 46) if quick else (10, 22, 46, 100, 160, 215):
        scene = box(side, 1.2)
        field = np.sin(0.1 * scene.x[0])
        found = _once(scene, field, engine=available()[0])
        times = alternately({"": partial(_once, scene, field, engine=available()[0])}, 3, 10.0)[""]
        pairs = float(found.neighbours.sum())
        rows.append(
            (
                scene.population,
                median(times),
                1e9 * median(times) / pairs,
                _memory(scene, field),
            )
        )
    return Table(
        "scaling with the number of particles, h = 1.2 Δx",
        ("particles", "seconds", "ns a pair", "bytes a particle"),
        rows,
        "bytes: all arrays at the peak, the scene and the result included",
    )


def _memory(scene: Particles, field: Any) -> float:
    """Bytes per particle that an evaluation holds at its peak beyond what it was given."""
    import tracemalloc

    tracemalloc.start()
    try:
        _once(scene, field, engine=available()[0])
        return float(tracemalloc.get_traced_memory()[1]) / scene.population
    finally:
        tracemalloc.stop()


def _crowding(side: int, repeats: int) -> Table:
    rows = []
    for h in (0.97, 1.2, 1.5, 2.0, 2.5):
        scene = box(side, h)
        field = np.sin(0.1 * scene.x[0])
        found = _once(scene, field, engine=available()[0])
        times = alternately(
            {"": partial(_once, scene, field, engine=available()[0])}, repeats, 5.0
        )[""]
        pairs = float(found.neighbours.sum())
        rows.append((h, pairs / scene.population, median(times), 1e9 * median(times) / pairs))
    return Table(
        f"scaling with the number of neighbours, {side}³ particles",
        ("h/Δx", "neighbours", "seconds", "ns a pair"),
        rows,
    )


def _workers(side: int, repeats: int) -> Table:
    scene = box(side, 1.5)
    field = np.sin(0.1 * scene.x[0])
    counts = [1, *range(2, threads(None) + 1, max(1, threads(None) // 4))]
    tasks: dict[str, Callable[[], Any]] = {
        str(w): partial(_once, scene, field, workers=w, engine=available()[0]) for w in counts
    }
    times = alternately(tasks, repeats)
    alone = median(times["1"])
    rows = [(int(w), median(t), alone / median(t)) for w, t in times.items()]
    return Table("scaling with threads, h = 1.5 Δx", ("threads", "seconds", "gain"), rows)


def _limits(side: int, repeats: int) -> Table:
    """What this machine can do: every candidate a neighbour (arithmetic), a copy (streaming)."""
    scene = box(side, 1.2)
    field = np.sin(0.1 * scene.x[0])
    rng = np.random.default_rng(1)
    crowd = particles(rng.uniform(0.0, 1.0, (4096, 3)), h=1.0, volume=1.0)
    crowd_field = rng.standard_normal(4096)
    block = np.empty((5, scene.population))
    copy = np.empty_like(block)
    options: dict[str, Any] = {"workers": 1, "engine": available()[0]}
    tasks: dict[str, Callable[[], Any]] = {
        "the engine, one thread": lambda: _once(scene, field, **options),
        "arithmetic: all candidates are neighbours": lambda: _once(crowd, crowd_field, **options),
        "streaming: copy x, V, A": lambda: np.copyto(copy, block),
    }
    pairs = {
        name: float(_once(*case).neighbours.sum())
        for name, case in zip(tasks, ((scene, field), (crowd, crowd_field)), strict=False)
    }
    times = alternately(tasks, repeats)
    rows: list[tuple[Any, ...]] = []
    for name, t in times.items():
        per_pair = 1e9 * median(t) / pairs[name] if name in pairs else None
        rate = None if name in pairs else 80.0 * scene.population / median(t) / 1e9
        rows.append((name, median(t), per_pair, rate))
    return Table(
        "limits of this machine, one thread", ("what", "seconds", "ns a pair", "GB/s"), rows
    )


def _peers(side: int, h: float, repeats: int) -> Table:
    scene = box(side, h)
    x, field = np.ascontiguousarray(scene.x.T), np.sin(0.1 * scene.x[0])
    tasks: dict[str, Callable[[], Any]] = {
        f"sphtrunc, {name}": partial(_once, scene, field, engine=name) for name in available()
    }
    others: dict[str, Callable[[], Any]] = {
        "SciPy query_pairs and NumPy": partial(peers.query_pairs, x, h, field)
    }
    left_out = ""
    if peers.has_pysph():
        try:
            others["PySPH"] = peers.pysph(x, h, field)
        except (Exception, SystemExit) as error:  # no compiler, or no OpenMP: it ends the process
            left_out = f"; PySPH left out: {type(error).__name__}"
    found = _once(scene, field).values[0] / h
    off = {
        name: float(np.abs(found - other()).max() / np.abs(found).max())
        for name, other in others.items()
    }
    times = alternately(tasks | others, repeats, 60.0)
    base = median(times[f"sphtrunc, {available()[0]}"])
    return Table(
        f"against others on the same {side}³ particles, gradient, cubic spline, h = {h} Δx",
        ("what", "seconds", "± %", "ratio", "difference"),
        [
            (name, median(t), 100 * spread(t), median(t) / base, off.get(name))
            for name, t in times.items()
        ],
        "from raw arrays to the result, all cores; difference: largest, relative to the largest"
        f" component{left_out}",
    )


def _skipping(side: int, repeats: int) -> Table:
    """What is not done when it is not needed, and what it would have cost."""
    scene = box(side, 1.2)
    kernel = parse_kernel("cubic-spline")
    field = np.sin(0.1 * scene.x[0])
    gradient = Operator("gradient").needed(3, 0)
    every = Operator("gradient", "standard", "rkpm-1").needed(3, 1)
    some = np.arange(0, scene.population, 100)

    def sums(keys: Any, **options: Any) -> Callable[[], Any]:
        return lambda: pair_sums(
            scene, kernel, keys, fields=field, field_keys=gradient, engine=available()[0], **options
        )

    cases = {
        "targets: 1 % of them": (sums([], targets=some), sums([])),
        "corrections and their sums": (sums([]), sums(every)),
        "bounds": (sums([]), sums([], bound=True)),
        "compensated sums": (sums([]), sums([], precision="compensated")),
    }
    rows = []
    for name, (without, with_) in cases.items():
        without(), with_()
        times = alternately({"without": without, "with": with_}, repeats, 10.0)
        a, b = median(times["without"]), median(times["with"])
        rows.append((name, a, b, b / a))
    return Table(
        "skipping: what is not asked for is not done",
        ("what", "skipped", "done", "ratio"),
        rows,
    )


def _sampling(side: int) -> Table:
    """Targets of scenes that are rules: those that are needed, and all of them."""
    kernel, wave = parse_kernel("cubic-spline"), sinusoid(0.02, dim=3)
    still = lattice(3, "cubic", "1/2", extent=side)
    moved = jittered(still, 0.2)
    cases: dict[str, tuple[Callable[[], Measurement], Callable[[], Measurement]]] = {
        "uniform: one target stands for all": (
            lambda: measure(still, kernel, field=wave),
            lambda: measure(jittered(still, 0.0), kernel, field=wave, targets="all"),
        ),
        "jittered: as many targets as 5 % need": (
            lambda: measure(moved, kernel, field=wave, rtol=0.05),
            lambda: measure(moved, kernel, field=wave, targets="all"),
        ),
    }
    rows = []
    for name, (needed, full) in cases.items():
        found = needed()
        times = alternately({"needed": needed, "full": full}, 3, 20.0)
        a, b = median(times["needed"]), median(times["full"])
        rows.append((name, found.targets, side**3, found.pairs, found.pairs_full, a, b, b / a))
    return Table(
        f"skipping: targets of a scene of {side}³ particles, Δx/h = 1/2",
        ("what", "targets", "of", "pairs", "of", "skipped", "done", "ratio"),
        rows,
    )


def _first_call() -> Table:
    """Seconds of the first gradient in a process, compiled there and then, and from the cache."""
    code = (
        "import time; import numpy as np, numba; from sphtrunc.bench import speed;"
        "s = speed.box(12, 1.2); f = s.x[0].copy(); start = time.perf_counter();"
        "speed._once(s, f, engine='numba', workers=1); print(time.perf_counter() - start)"
    )
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        seconds = [
            float(
                subprocess.run(
                    [sys.executable, "-c", code],
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout
            )
            for _ in range(4)
        ]
    rows = [("compiled", seconds[0]), ("from the cache", median(seconds[1:]))]
    return Table("the first call of a process", ("how", "seconds"), rows)
