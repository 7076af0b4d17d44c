"""README.md, guide and site are true: their commands run and print what they show."""

from __future__ import annotations

import csv
import doctest
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from sphtrunc.cli import COMMANDS, main

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
GUIDE = ROOT / "notebooks" / "guide"
PAGES = [README, *sorted(GUIDE.glob("*.md"))]
SITE = [
    ROOT / "notebooks" / path
    for path in ("index.md", "site/how-do-i.md", "site/truncation-error.md", "site/api/index.md")
]
TEXT = README.read_text(encoding="utf-8")

FENCE = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
STATUS = re.compile(r"# exit status (\d)$")
LENIENT = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def blocks(text: str) -> list[tuple[str, str, str]]:
    """(language, name of a file or "", what is inside) of every fenced block."""
    return FENCE.findall(text)


def commands(kind: str, inside: str) -> Iterator[tuple[str, str | None]]:
    """(command, the output that is shown) of a block of commands; None where none is shown."""
    if kind == "sh":
        yield from ((line, None) for line in inside.splitlines() if line.startswith("sphtrunc "))
    elif kind == "console":
        for entry in re.split(r"^\$ ", inside, flags=re.MULTILINE)[1:]:
            command, _, output = entry.replace("\\\n", "").partition("\n")
            yield command, output


def differences(wanted: str, got: str) -> str:
    """What a reader would see that is not so; empty where all is as shown. "..." stands for
    anything, and lines may be broken elsewhere."""
    if doctest.OutputChecker().check_output(wanted, got, LENIENT):
        return ""
    return f"shown:\n{wanted}\nprinted:\n{got}"


def run(command: str, shown: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    """The command ends as stated, and prints what is shown or writes a file."""
    before = {path: path.stat().st_mtime_ns for path in Path.cwd().rglob("*")}
    with pytest.raises(SystemExit) as stop:
        main(shlex.split(command, comments=True)[1:])
    streams = capsys.readouterr()
    printed = streams.out + streams.err
    wrote = {path: path.stat().st_mtime_ns for path in Path.cwd().rglob("*")} != before
    stated = STATUS.search(command)
    assert stop.value.code == int(stated[1] if stated else 0), (command, printed)
    assert printed or wrote, command
    if shown is not None and (shown.strip() or printed.strip()):
        assert not differences(shown, printed), f"{command}\n{differences(shown, printed)}"


def keys(text: str) -> tuple[str, list[str]]:
    """What stands under `## Keys`: the file that is spoken of first, and the keys in the first
    column of the table."""
    _, _, rest = text.partition("\n## Keys\n")
    section = rest.partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]+`) \|", section, flags=re.MULTILINE)
    named = re.findall(r"`([\w./-]+\.(?:json|csv))`", section)
    return named[0] if named else "", [k for row in rows for k in re.findall(r"`([^`]+)`", row)]


def keys_of(path: Path) -> list[str]:
    """The keys of a JSON object (of the first of several), or the columns of a CSV table."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".csv":
        return next(csv.reader(text.splitlines()))
    document = json.loads(text)
    return list(document[0] if isinstance(document, list) else document)


def test_two_commands_do_all_the_set_up():
    setup = [line for line in TEXT.splitlines() if line.startswith("python3 -m venv ")]
    assert len(setup) == 2
    assert setup[0].endswith("sphtrunc derive --kernel cubic-spline")
    assert "pytest" in setup[1]
    assert TEXT.splitlines().index(setup[1]) < 30  # on the first screen


def test_every_command_has_a_page_and_the_readme_leads_to_it():
    assert [path.stem for path in PAGES[1:]] == sorted(COMMANDS)
    for name in COMMANDS:
        assert f"(notebooks/guide/{name}.md)" in TEXT


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (page.parent / target).exists(), target


@pytest.mark.parametrize(
    "page", [*PAGES, *SITE], ids=lambda page: f"{page.parent.stem}/{page.stem}"
)
def test_a_page_is_true(page, tmp_path, monkeypatch, capsys):
    """Its files are written, its commands run and its Python executed, in the order of the page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    text = page.read_text(encoding="utf-8")
    space: dict[str, object] = {}
    ran = 0
    for kind, name, inside in blocks(text):
        if name:
            Path(name).write_text(inside, encoding="utf-8")
            continue
        for command, shown in commands(kind, inside):
            run(command, shown, capsys)
            ran += 1
        if kind == "python":
            exec(compile(inside, str(page), "exec"), {})
            capsys.readouterr()
            ran += 1
        elif kind == "pycon":
            test = doctest.DocTestParser().get_doctest(inside, space, page.name, str(page), 0)
            failures: list[str] = []
            runner = doctest.DocTestRunner(optionflags=LENIENT)
            runner.run(test, out=failures.append, clear_globs=False)
            space |= test.globs
            assert not failures, "".join(failures)
            ran += 1
    assert ran
    if page.parent == GUIDE:
        file, explained = keys(text)
        assert sorted(explained) == sorted(keys_of(tmp_path / file))


def test_a_page_that_is_not_true_is_found(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (entry,) = commands("console", "$ sphtrunc kernels --dim 3\nKernels in 3D: ...\n... 9/10 ...\n")
    run(*entry, capsys)
    for wrong in ("Kernels in 2D: ...\n", "Kernels in 3D: ...\n... 9/11 ...\n", ""):
        with pytest.raises(AssertionError, match="shown:"):
            run(entry[0], wrong, capsys)
    with pytest.raises(AssertionError, match="kernels"):
        run("sphtrunc kernels # exit status 1", None, capsys)
    page = (
        "`z.csv`\n## Keys\n\nOf `x.json`:\n\n| `a`, `b` | x |\n| `c` | y |\n"
        "\n## More\n\n| `d` | z |\n"
    )
    assert keys(page) == ("x.json", ["a", "b", "c"])
