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

#: the layers, lowest first: a module stands on the layer of its folder, or of its own name
LAYERS = [
    {"arithmetic", "output", "version"},
    {"kernels", "operators"},
    {"scenes", "audit"},
    {"theory", "experiment"},
    {"study", "testing"},
    {"figures", "explorer"},
    {"bench"},
    {"cli"},
    {"__main__", ""},
]
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}


def folder_of(name: str) -> str:
    """theory.disorder.averages → theory; output → output; the package itself → the empty name."""
    return name.partition(".")[0]


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
        if str(node.module).partition(".")[0] == "sphtrunc":
            for alias in node.names:
                self._add(f"{node.module}.{alias.name}")
        else:
            self._add(str(node.module))

    def _add(self, module: str) -> None:
        (self.lazy if self._functions else self.loaded).add(module)


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


MODULES = {name_of(file): Imports(tree(file)) for file in FILES}


def inside(modules: set[str]) -> set[str]:
    """Of these imports, the modules of the package: `from a import b` counts as `a.b` if that is a
    module, else as `a`; the package itself, which hands on names, does not count."""
    found = set()
    for module in modules:
        name = module.removeprefix("sphtrunc.")
        if name != module:
            found.add(name if name in MODULES else name.rpartition(".")[0])
    return {n for n in found if n in MODULES and n}


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


def floors(names: set[str]) -> dict[str, int]:
    """On which floor of its folder each module stands: 1 above the highest it is loaded with."""
    found: dict[str, int] = {}

    def floor(name: str) -> int:
        if name not in found:
            below = inside(MODULES[name].loaded) & names
            found[name] = 1 + max((floor(other) for other in below), default=0)
        return found[name]

    for name in names:
        floor(name)
    return found


def modules_in(folder: str) -> list[str]:
    """The modules of a folder, of which there are some."""
    names = sorted(n for n in MODULES if folder_of(n) == folder)
    assert names, folder
    return names


def test_the_reader_reads() -> None:
    """It tells the three kinds of import apart."""
    text = "if TYPE_CHECKING:\n import a\nimport b\ndef f():\n import c\n from sphtrunc import d"
    imports = Imports(ast.parse(text))
    assert imports.loaded == {"b"}
    assert imports.lazy == {"c", "sphtrunc.d"}
    assert inside({"sphtrunc.kernels.parse.kernel", "sphtrunc.scenes", "sphtrunc", "numpy"}) == {
        "kernels.parse",
        "scenes",
    }
    assert "kernels.parse" in reachable("theory.deriving", lazy=False)
    assert "figures" in reachable("cli.figures", lazy=True)


def test_every_module_has_a_place() -> None:
    assert len(MODULES) > 90
    assert {folder_of(name) for name in MODULES} == set(RANK)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_form_no_circle(name: str) -> None:
    """Neither as modules are loaded nor later; the package hands on names of what is below it."""
    assert name not in reachable(name, lazy=True)


@pytest.mark.parametrize("name", sorted(set(MODULES) - {""}))
def test_imports_go_downward(name: str) -> None:
    """To lower layers or within the folder; theory and experiment stand side by side."""
    imports = MODULES[name]
    for other in inside(imports.loaded | imports.lazy):
        mine, theirs = folder_of(name), folder_of(other)
        assert mine == theirs or RANK[theirs] < RANK[mine], other


@pytest.mark.parametrize("folder", sorted(set(RANK) - {""}))
def test_a_folder_has_few_floors(folder: str) -> None:
    """Counted over the whole package: no module is loaded through more than nine of its folder."""
    names = set(modules_in(folder))
    most = max(floors(names).values())
    assert most <= 9, floors(names)


@pytest.mark.parametrize(("one", "other"), list(permutations(["theory", "experiment"])))
def test_theory_and_experiment_do_not_know_each_other(one: str, other: str) -> None:
    """By no path: not through what they import either."""
    for name in modules_in(one):
        assert not {n for n in reachable(name, lazy=True) if folder_of(n) == other}, name


def test_theory_sees_descriptions_of_scenes_alone() -> None:
    """Sites of lattices and where walls are, never arrays of neighbours."""
    for name in modules_in("theory"):
        seen = {n for n in reachable(name, lazy=True) if folder_of(n) == "scenes"}
        assert seen <= {"scenes", "scenes.arrangement", "scenes.sites", "scenes.walls"}, (
            name,
            seen,
        )


EXACT = [  # what `derive` in 1D runs with
    *(n for n in MODULES if folder_of(n) == "operators"),
    "kernels.kernel",
    "kernels.catalogue",
    "kernels.parse",
    "theory.deriving",
    "theory.derivation",
    "theory.limit",
    "theory.euler_maclaurin",
    "theory.orders",
]


@pytest.mark.parametrize("name", EXACT)
def test_exact_modules_load_without_arrays(name: str) -> None:
    assert outside(name) & {"numpy", "scipy", "matplotlib", "numba"} == set()


@pytest.mark.parametrize("folder", ["arithmetic", "scenes", "experiment"])
def test_sums_load_without_sympy(folder: str) -> None:
    for name in modules_in(folder):
        assert "sympy" not in outside(name), name


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
    assert loaded_by("import sphtrunc.arithmetic.summation") == {"numpy"}


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
