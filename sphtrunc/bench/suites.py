"""Run time against error: what an evaluation costs here, beside what this machine could do.

Every time is the median of repeated runs with its spread; what is compared is run in alternation,
so that ratios survive a busy machine. Suites return tables, ready to be read, saved or drawn.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from statistics import median
from typing import Any

from sphtrunc.bench.accuracy import precision, work_precision
from sphtrunc.bench.report import Report, Table, alternately, machine, spread
from sphtrunc.bench.speed import engine
from sphtrunc.bench.stability import stability
from sphtrunc.kernels.parse import kernel as parse_kernel

# --------------------------------------------------------------------------------------- derive


def derive(quick: bool) -> Iterator[Table]:
    """`sphtrunc derive` as a process, beside `import sympy`; derivations within a process."""
    command = [sys.executable, "-m", "sphtrunc", "derive", "--kernel"]
    names = ["cubic-spline", "wendland-c2"] if quick else list(_DERIVED)
    cases: dict[str, list[str]] = {"import sympy": [sys.executable, "-c", "import sympy"]}
    cases |= {name: [*command, name] for name in names}
    times = alternately(
        {
            name: partial(subprocess.run, line, capture_output=True, check=True)
            for name, line in cases.items()
        },
        3 if quick else 7,
        60.0,
    )
    base = median(times["import sympy"])
    whole = [(name, median(t), median(t) / base, 100 * spread(t)) for name, t in times.items()]
    yield Table("derive, whole process", ("kernel", "seconds", "ratio", "± %"), list(whole))
    from sphtrunc.theory.deriving import derive as derive_moments

    rows: list[tuple[Any, ...]] = []
    for name in names:
        for dim in (1, 2, 3):
            for degree in (3,) if quick else (3, 7):
                ratio = "10/13" if dim == 1 else None
                begin = time.perf_counter()
                derive_moments(parse_kernel(name), dim=dim, degree=degree, dx_over_h=ratio)
                rows.append((name, dim, degree, time.perf_counter() - begin))
    yield Table(
        "derive, within a process, first time", ("kernel", "dim", "degree", "seconds"), rows
    )


_DERIVED = (
    "cubic-spline",
    "quintic-spline",
    "b-spline:20",
    "wendland-c2",
    "wendland-c6",
    "polynomial:20",
)


# ------------------------------------------------------------------------------------ all of them

SUITES: dict[str, Callable[[bool], Iterable[Table]]] = {
    "engine": engine,
    "precision": precision,
    "work-precision": work_precision,
    "derive": derive,
    "stability": stability,
}


def bench(
    suites: Sequence[str] = (),
    *,
    quick: bool = False,
    each: Callable[[str, Table], None] | None = None,
) -> Report:
    """Run the suites (none named: all); quick: small ones, within a minute together.

    each: called with the name of the suite and every table as soon as it is there
    Raises ValueError for an unknown suite.
    """
    for name in suites:
        if name not in SUITES:
            raise ValueError(f"suite: got {name!r}, expected one of {', '.join(SUITES)}")
    started = time.perf_counter()
    tables: dict[str, list[Table]] = {name: [] for name in suites or SUITES}
    for name, found in tables.items():
        for table in SUITES[name](quick):
            found.append(table)
            if each is not None:
                each(name, table)
    return Report(machine(), tables, time.perf_counter() - started)
