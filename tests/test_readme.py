"""README.md is true: its set-up commands are two, and its other commands run and print."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from sphtrunc.cli import main

README = Path(__file__).parent.parent / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line.startswith("sphtrunc ")]


def test_two_commands_do_all_the_set_up():
    setup = [line for line in TEXT.splitlines() if line.startswith("python3 -m venv ")]
    assert len(setup) == 2
    assert setup[0].endswith("sphtrunc derive --kernel cubic-spline")
    assert "pytest" in setup[1]
    assert TEXT.splitlines().index(setup[1]) < 30  # on the first screen


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_readme_runs(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(shlex.split(command)[1:])
    assert stop.value.code == 0
    assert capsys.readouterr().out or list(tmp_path.iterdir())


PYTHON = re.findall(r"^```python\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("code", PYTHON)
def test_the_python_of_the_readme_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(README), "exec"), {})
