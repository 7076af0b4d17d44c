"""The page: what is in it, and how it is used in a browser, where there is one."""

from __future__ import annotations

import json
import re
import shlex

import pytest

from sphtrunc.cli import main
from sphtrunc.explorer.assembly import COMPUTING, DRAWING, page, source
from sphtrunc.explorer.setting import numbers, setting
from tests.explorer.browser import BROWSERS, driven, hashed
from tests.explorer.settings import apart, expected, random_settings, words


def test_it_is_one_file_that_asks_nobody():
    text = page()
    assert len(text.encode()) <= 1_000_000
    assert not re.search(r"\b(?:src|srcset|action|formaction|ping|poster)\s*=", text)
    assert re.findall(r'href="([^"]*)"', text) == ["data:,", "#results-start"]
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket|importScripts", text)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    (style,) = re.findall(r"<style>(.*?)</style>", text, flags=re.DOTALL)
    (code,) = re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL)
    assert policy == (
        f"default-src 'none'; img-src data:; style-src {hashed(style)}; script-src {hashed(code)}"
    )


@pytest.mark.parametrize("name", [*COMPUTING, *DRAWING])
def test_what_is_typed_is_neither_code_nor_markup(name):
    text = source(f"{name}.js")
    assert not re.search(
        r"\beval\b|\bFunction\b|innerHTML|outerHTML|insertAdjacent|document\.write", text
    )
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize("browser", BROWSERS)
def test_start_links_refusals_and_what_to_type(browser, tmp_path, monkeypatch, capsys):
    """The commands and the Python that the page shows run, and give its numbers."""
    n = 11
    found = driven(browser, tmp_path, [words(random_settings()[n])])
    start, linked = setting(""), setting("#kernel=spiky&dim=2")
    for at, name in ((start, "start"), (linked, "linked")):
        assert not apart(at, {"error": found[name]["error"]}, {"error": numbers(at)["error"]})
    assert found["linked"]["state"] == "ready"
    assert found["refused"]["state"] == "refused"
    assert found["refused"]["problem"].startswith("kernel: unexpected")
    monkeypatch.chdir(tmp_path)
    explore, derive, measure, convert, python = found["settings"][0]["commands"]
    for command in (derive, f"{measure} --targets 20", convert):
        with pytest.raises(SystemExit) as stop:
            main(shlex.split(command)[1:])
        assert stop.value.code == 0, command
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main([*shlex.split(explore)[1:], "--format", "json"])
    printed = json.loads(capsys.readouterr().out)
    assert {k: printed[k] for k in expected(n)} == expected(n)
    exec(compile(python, "page", "exec"), {})
    assert capsys.readouterr().out.strip() == str(expected(n))


@pytest.mark.parametrize("browser", BROWSERS)
@pytest.mark.parametrize("width", [380, 1400])
def test_manners(browser, width, tmp_path):
    """Every control has a name, every picture words; nothing is wider than the window."""
    found = driven(browser, tmp_path, [], width)
    manners = found["manners"]
    assert found["errors"] == manners["unnamed"] == manners["doubled"] == manners["requests"] == []
    assert manners["live"] == 2
    assert [role for role, _ in manners["pictures"]] == ["img"] * 5
    assert min(length for _, length in manners["pictures"]) > 60
    assert manners["width"] == width
    assert manners["overflow"] <= 0
