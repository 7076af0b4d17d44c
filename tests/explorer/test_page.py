"""The page: what is in it, and what a browser shows, where there is one."""

from __future__ import annotations

import html
import json
import re
import shlex
import shutil
import subprocess
from base64 import b64encode
from functools import cache
from hashlib import sha256
from pathlib import Path

import pytest

from sphtrunc.cli import main
from sphtrunc.explorer.assembly import COMPUTING, DRAWING, page, source
from sphtrunc.explorer.setting import numbers, setting
from tests.explorer.settings import apart, expected, random_settings, words

BROWSERS = [name for name in ("chromium", "google-chrome") if shutil.which(name)]
DRIVER = Path(__file__).with_name("driver.js").read_text(encoding="utf-8")
CATCHER = (
    "const ERRORS = [];"
    "addEventListener('error', (e) => ERRORS.push(e.message));"
    "addEventListener('unhandledrejection', (e) => ERRORS.push(String(e.reason)));"
    "addEventListener('securitypolicyviolation', (e) => ERRORS.push(e.violatedDirective));"
)
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


def hashed(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


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


#: a frame of a width that a window of its own cannot have, which writes down what it is told
FRAME = (
    "<iframe src='driven.html' width='{}' height='900'></iframe><pre></pre><script>"
    "onmessage = (e) => {{ document.querySelector('pre').textContent = e.data; }};</script>"
)


def driven(browser: str, folder: Path, settings: list[dict[str, str]], width: int) -> dict:
    """What the page shows for the settings, in a browser of that width."""
    code = f"const SETTINGS = {json.dumps(settings)};\n{DRIVER}"
    text = page().replace("script-src ", f"script-src {hashed(CATCHER)} {hashed(code)} ")
    text = text.replace("<style>", f"<script>{CATCHER}</script><style>", 1)
    text = text.replace("</body>", f"<script>{code}</script></body>")
    (folder / "driven.html").write_text(text, encoding="utf-8")
    file = folder / "frame.html"
    file.write_text(FRAME.format(width), encoding="utf-8")
    run = subprocess.run(
        [browser, *FLAGS, f"--user-data-dir={folder / 'profile'}", "--window-size=1600,900",
         f"--virtual-time-budget={1_000_000}", "--dump-dom", file.as_uri()],
        capture_output=True, text=True, check=True, timeout=600,
    )  # fmt: skip
    found = re.search(r"<pre>(.+?)</pre>", run.stdout, flags=re.DOTALL)
    assert found, run.stdout[:2000]
    return dict(json.loads(html.unescape(found[1])))


@cache
def visit(browser: str, folder: Path) -> dict:
    return driven(browser, folder, [words(at) for at in random_settings()], 1400)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("browser")


@pytest.mark.parametrize("browser", BROWSERS)
def test_a_person_who_sets_the_controls_sees_the_packages_numbers(browser, folder):
    found = visit(browser, folder)
    assert found["errors"] == []
    for n, (at, got) in enumerate(zip(random_settings(), found["settings"], strict=True)):
        assert (got["state"], got["problem"]) == ("ready", ""), at
        wanted = {k: v for k, v in expected(n).items() if k != "particles"}
        assert not apart(at, {k: got[k] for k in wanted}, wanted), at
        assert setting(got["hash"]) == at
        assert f"{expected(n)['particles']} particles" in got["summary"]
        assert len(got["curves"]) >= 10
        assert min(got["curves"]) > 10


@pytest.mark.parametrize("browser", BROWSERS)
def test_start_links_and_what_is_refused(browser, folder):
    found = visit(browser, folder)
    assert not apart(
        setting(""), {"error": found["start"]["error"]}, {"error": numbers(setting(""))["error"]}
    )
    assert found["refused"]["state"] == "refused"
    assert found["refused"]["problem"].startswith("kernel: unexpected")
    linked = setting("#kernel=spiky&dim=2")
    assert found["linked"]["state"] == "ready"
    assert not apart(
        linked, {"error": found["linked"]["error"]}, {"error": numbers(linked)["error"]}
    )


@pytest.mark.parametrize("browser", BROWSERS)
@pytest.mark.parametrize("n", [0, 11])
def test_what_the_page_says_to_type_gives_its_numbers(
    browser, n, folder, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    found = visit(browser, folder)["settings"][n]
    explore, derive, measure, convert, python = found["commands"]
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
    found = driven(browser, tmp_path, [], width)["manners"]
    assert found["unnamed"] == found["doubled"] == found["requests"] == []
    assert found["live"] == 2
    assert [role for role, _ in found["pictures"]] == ["img"] * 5
    assert min(length for _, length in found["pictures"]) > 60
    assert found["width"] == width
    assert found["overflow"] <= 0
