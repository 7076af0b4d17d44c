"""Small faults at random in the core, and whether the tests notice them.

    pip install '.[test,mutation]'
    python tests/mutation.py --seed 1 --mutants 20 --only kernels

One place after another is changed in a copy of the checkout (`<` to `<=`, `+` to `-`, 2 to 3, `and`
to `or`, …: the operators of Cosmic Ray), and the tests of its folder are run until one fails. What
survives is printed as a difference: write a test, or know why the change changes nothing. A run of
200 takes hours; the same seed draws the same places as long as the files are the same.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

HOME = Path(__file__).parents[1]
#: the core, and the tests that know it, the fastest first
TESTS = {
    "arithmetic": "tests/arithmetic tests/experiment",
    "kernels": "tests/kernels tests/theory/test_deriving.py tests/test_agreement.py",
    "operators": "tests/operators tests/theory/test_deriving.py tests/test_agreement.py",
    "scenes": "tests/scenes tests/test_agreement.py tests/experiment",
    "theory": "tests/theory tests/operators tests/test_agreement.py",
    "experiment": "tests/experiment tests/test_agreement.py",
    "study": "tests/study",
    "audit": "tests/audit",
}
#: changes that nobody would make by mistake, or that only concern annotations
IDLE = ("Bit", "Shift", "_Is", "Decorator", "Exception", "Variable")

Place = tuple[Path, tuple[int, int], tuple[int, int]]


def places(file: Path) -> dict[Place, list[tuple[str, int]]]:
    """Everywhere that something can be changed in a file: by what, and its how-manieth it is."""
    from cosmic_ray.ast import ast_nodes, get_ast_from_path
    from cosmic_ray.plugins import get_operator, operator_names

    found = defaultdict(list)
    nodes = list(ast_nodes(get_ast_from_path(file)))
    for name in operator_names():
        if any(part in name for part in IDLE):
            continue
        operator, number = get_operator(name)(), 0
        for node in nodes:
            for start, end in operator.mutation_positions(node):
                found[file, start, end].append((name, number))
                number += 1
    return dict(found)


def drawn(folders: list[str], mutants: int, seed: int) -> list[Any]:
    """So many changes: a place, each as likely as another, then one of what can be done to it."""
    from cosmic_ray.work_item import MutationSpec

    everywhere: dict[Place, list[tuple[str, int]]] = {}
    for folder in folders:
        for file in sorted(Path("sphtrunc", folder).rglob("*.py")):
            everywhere |= places(file)
    draw = random.Random(seed)
    chosen = draw.sample(sorted(everywhere), min(mutants, len(everywhere)))
    return [
        MutationSpec(file, name, number, start, end)
        for file, start, end in chosen
        for name, number in [draw.choice(everywhere[file, start, end])]
    ]


def main() -> int:
    from cosmic_ray.mutating import mutate_and_test
    from cosmic_ray.work_item import TestOutcome

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mutants", type=int, default=20)
    parser.add_argument("--only", choices=TESTS, action="append", help="a folder of the core")
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds for one change")
    given = parser.parse_args()
    results: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "checkout")
        skip = shutil.ignore_patterns(".*", "__pycache__")
        shutil.copytree(HOME, copy, ignore=skip)
        os.chdir(copy)
        os.environ["PYTHONPATH"] = str(copy)
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        for n, spec in enumerate(drawn(given.only or list(TESTS), given.mutants, given.seed), 1):
            # a compiled loop is kept for as long as its own file is the same
            os.environ["NUMBA_CACHE_DIR"] = str(Path(folder, f"numba-{n}"))
            tests = TESTS[spec.module_path.parts[1]]
            command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {tests}"
            result = mutate_and_test([spec], command, given.timeout)
            said = result.test_outcome.value if result.test_outcome else "no test"
            said = "timed out" if result.output == "timeout" else said
            results[said] += 1
            where = f"{spec.module_path}:{spec.start_pos[0]}"
            print(f"{n:4d} {said} {where} {spec.operator_name}", flush=True)
            if result.test_outcome == TestOutcome.SURVIVED:
                print(result.diff, flush=True)
    print(", ".join(f"{number} {name}" for name, number in sorted(results.items())))
    return int(results[TestOutcome.SURVIVED.value] > 0)


if __name__ == "__main__":
    sys.exit(main())
