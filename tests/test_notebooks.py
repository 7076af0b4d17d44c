"""Every notebook runs from top to bottom, shows what it shows, and ends in assertions.

The code cells are run in order in one namespace, as a kernel would, and the last expression of a
cell is rendered as a notebook would; warnings are errors.
"""

from __future__ import annotations

import ast
import io
import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
OURS = [
    "01-derive",
    "02-uniform",
    "03-disorder",
    "04-consistency",
    "05-three-dimensions",
    "06-second-derivatives",
    "07-tuning",
    "08-snapshots",
    "09-flows",
    "10-walls",
    "11-stability",
    "12-conservation",
]


def cells(path: Path, kind: str) -> list[str]:
    document = json.loads(path.read_text(encoding="utf-8"))
    return ["".join(c["source"]) for c in document["cells"] if c["cell_type"] == kind]


def render(value: object) -> None:
    """What a notebook would show of the last expression of a cell."""
    if hasattr(value, "savefig"):
        value.savefig(io.BytesIO(), format="png")
    elif hasattr(value, "_repr_latex_"):
        assert value._repr_latex_()
    else:
        assert repr(value)


def test_the_notebooks_are_there():
    assert {path.stem for path in NOTEBOOKS} >= set(OURS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_light_and_ends_in_assertions(path):
    document = json.loads(path.read_text(encoding="utf-8"))
    for cell in document["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
    assert document["cells"][0]["cell_type"] == "markdown"
    last = ast.parse(cells(path, "code")[-1])
    assert any(isinstance(node, ast.Assert) for node in ast.walk(last))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, monkeypatch, capsys):
    monkeypatch.chdir(FOLDER)
    space: dict[str, object] = {"__name__": "__main__"}
    for number, source in enumerate(cells(path, "code")):
        tree = ast.parse(source)
        last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
        where = f"{path.name}, code cell {number}"
        exec(compile(tree, where, "exec"), space)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), where, "eval"), space)
            if value is not None:
                render(value)
    capsys.readouterr()
