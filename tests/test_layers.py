"""The layers of the package, read from its source: who may import whom, what nobody may call."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from itertools import permutations
from pathlib import Path

import pytest

import sphtrunc

PACKAGE = Path(sphtrunc.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
HEAVY = ("sympy", "numpy", "scipy", "matplotlib", "numba")

#: the layers, lowest first; a module that is not named here stands where its imports put it
LAYERS = [
    {"kernel"},
    {"catalogue", "parse"},
    {"moments"},
    {"operators", "scene"},
    {"theory", "spectrum", "experiment"},
    {"disorder"},  # may use the spectrum of a kernel, but see below
    {"study"},
    {"bench", "plot", "audit"},
    {"cli"},
]
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}


def name_of(file: Path) -> str:
    """kernel.py → kernel; cli/derive.py → cli.derive; cli/__init__.py → cli."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


class Imports(ast.NodeVisitor):
    """What a module imports as it is loaded (`loaded`), and later inside functions (`lazy`)."""

    def __init__(self, tree: ast.AST) -> None:
        self.loaded: set[str] = set()
        self.lazy: set[str] = set()
        self._functions = 0
        self.visit(tree)

    def visit_If(self, node: ast.If) -> None:
        body = node.orelse if ast.unparse(node.test).endswith("TYPE_CHECKING") else node.body
        for child in [*body, *node.orelse]:
            self.visit(child)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._functions += 1
        self.generic_visit(node)
        self._functions -= 1

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            self._add(alias.name)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        assert node.level == 0, "absolute imports only"
        if node.module == "sphtrunc":
            for alias in node.names:
                self._add(f"sphtrunc.{alias.name}")
        else:
            self._add(str(node.module))

    def _add(self, module: str) -> None:
        (self.lazy if self._functions else self.loaded).add(module)


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


MODULES = {name_of(file): Imports(tree(file)) for file in FILES}


def inside(modules: set[str]) -> set[str]:
    """Of these imports, the modules of the package."""
    names = {m.removeprefix("sphtrunc.") for m in modules if m.startswith("sphtrunc.")}
    return {n for n in names if n in MODULES and n}


def reachable(name: str, *, lazy: bool) -> set[str]:
    """Everything in the package that `name` imports, directly or not."""
    seen: set[str] = set()
    waiting = [name]
    while waiting:
        imports = MODULES[waiting.pop()]
        found = inside(imports.loaded | imports.lazy if lazy else imports.loaded)
        waiting += found - seen
        seen |= found
    return seen


def outside(name: str) -> set[str]:
    """The packages that are loaded with a module, by itself or by what it imports."""
    return {
        module.partition(".")[0]
        for n in {name, *reachable(name, lazy=False)}
        for module in MODULES[n].loaded
    }


def test_the_reader_reads() -> None:
    """It tells the three kinds of import apart."""
    text = "if TYPE_CHECKING:\n import a\nimport b\ndef f():\n import c\n from sphtrunc import d"
    imports = Imports(ast.parse(text))
    assert imports.loaded == {"b"}
    assert imports.lazy == {"c", "sphtrunc.d"}
    assert {"kernel", "catalogue", "parse", "theory", "cli", "cli.derive"} <= set(MODULES)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_form_no_circle(name: str) -> None:
    assert name not in reachable(name, lazy=False)


@pytest.mark.parametrize("name", sorted(n for n in MODULES if n in RANK))
def test_imports_go_downward(name: str) -> None:
    """By whatever way, also through a module that has no place of its own in the picture."""
    for other in reachable(name, lazy=True) & set(RANK):
        assert RANK[other] < RANK[name] or (name, other) == ("parse", "catalogue"), other


@pytest.mark.parametrize(
    ("one", "other"),
    list(permutations(["theory", "disorder", "experiment"], 2)),
)
def test_theory_disorder_and_experiment_do_not_know_each_other(one: str, other: str) -> None:
    assert other not in reachable_or_none(one)


def reachable_or_none(name: str) -> set[str]:
    return reachable(name, lazy=True) if name in MODULES else set()


@pytest.mark.parametrize("name", ["kernel", "catalogue", "parse", "moments", "operators", "theory"])
def test_exact_modules_load_without_arrays(name: str) -> None:
    assert outside(name) & {"numpy", "scipy", "matplotlib", "numba"} == set()


@pytest.mark.parametrize("name", ["summation"])
def test_sums_load_without_sympy(name: str) -> None:
    assert "sympy" not in outside(name)


FORBIDDEN = {"sympify", "parse_expr", "lambdify", "Piecewise", "pickle", "__import__"}
#: as functions; Poly.eval and re.compile are methods
FORBIDDEN_FUNCTIONS = FORBIDDEN | {"eval", "exec", "compile"}


def names_in(module: ast.Module) -> set[str]:
    """Every name that is read or imported, and every attribute `x.name`, written as `.name`."""
    found = set()
    for node in ast.walk(module):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(f".{node.attr}")
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {part for alias in node.names for part in alias.name.split(".")}
    return found


@pytest.mark.parametrize("file", FILES, ids=name_of)
def test_no_text_is_ever_code(file: Path) -> None:
    found = names_in(tree(file))
    assert found & FORBIDDEN_FUNCTIONS == set()
    assert found & {f".{name}" for name in FORBIDDEN} == set()


@pytest.mark.parametrize("file", FILES, ids=name_of)
def test_no_text_becomes_a_polynomial_and_no_pickle_is_loaded(file: Path) -> None:
    for node in ast.walk(tree(file)):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Poly") and node.args:
            text = isinstance(node.args[0], ast.JoinedStr) or (
                isinstance(node.args[0], ast.Constant) and isinstance(node.args[0].value, str)
            )
            assert not text
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            assert ast.unparse(node.value) == "False"


def test_the_search_would_find_it() -> None:
    found = names_in(ast.parse("from sympy import lambdify as f; sp.sympify(x); eval('1')"))
    assert {"lambdify", ".sympify", "eval"} <= found


# -- what is loaded when ---------------------------------------------------------------------------


def loaded_by(code: str) -> set[str]:
    """The heavy packages in sys.modules after running this in a new interpreter."""
    tail = "import sys; print('|', *sorted({m.partition('.')[0] for m in sys.modules}))"
    run = subprocess.run(
        [sys.executable, "-c", f"{code}\n{tail}"],
        capture_output=True,
        text=True,
        check=True,
        cwd=PACKAGE.parent,
        timeout=60,
    )
    return set(run.stdout.rpartition("|")[2].split()) & set(HEAVY)


HELP = "from sphtrunc.cli import main\ntry:\n main(['--help'])\nexcept SystemExit: pass"


@pytest.mark.parametrize("code", ["import sphtrunc", "from sphtrunc import __version__", HELP])
def test_nothing_heavy_is_loaded_for_nothing(code: str) -> None:
    assert loaded_by(code) == set()


def test_the_probe_would_see_it() -> None:
    assert loaded_by("import sphtrunc; sphtrunc.Kernel") >= {"sympy"}


def test_exact_work_needs_no_arrays() -> None:
    code = "import sphtrunc; sphtrunc.derive('cubic-spline'); sphtrunc.kernel('pos(1-q)').moment(2)"
    assert loaded_by(code) == {"sympy"}


def test_sums_need_no_sympy() -> None:
    assert loaded_by("import sphtrunc.summation") == {"numpy"}


# -- public names ----------------------------------------------------------------------------------


def test_public_names() -> None:
    assert {"Kernel", "Moments", "Operator", "__version__", "derive", "kernel"} <= set(
        sphtrunc.__all__
    )
    assert sorted(sphtrunc.__all__) == dir(sphtrunc)
    for name in sphtrunc.__all__:
        assert getattr(sphtrunc, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'kernell'"):
        _ = sphtrunc.kernell


@pytest.mark.parametrize(
    "code",
    [
        "import sphtrunc; sphtrunc.kernel('lucy')",
        "from sphtrunc import Kernel, kernel; kernel('lucy')",
        "import sphtrunc.kernel; sphtrunc.kernel('lucy')",
        "from sphtrunc.kernel import Kernel; import sphtrunc; sphtrunc.kernel('lucy')",
        "from sphtrunc.catalogue import named; from sphtrunc import kernel; kernel('lucy')",
    ],
)
def test_kernel_is_the_function_in_whatever_order(code: str) -> None:
    """The module `sphtrunc.kernel` has the name of the function, which must win."""
    assert "sympy" in loaded_by(code)
