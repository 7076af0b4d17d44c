"""sphtrunc explore and sphtrunc info."""

from __future__ import annotations

import json
from importlib.metadata import version

import pytest

from sphtrunc.cli import main
from sphtrunc.cli.info import information
from sphtrunc.explorer.assembly import page
from sphtrunc.explorer.setting import Setting, numbers, setting


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    streams = capsys.readouterr()
    return int(stop.value.code or 0), streams.out, streams.err


def test_the_page_is_written(tmp_path, capsys):
    file = tmp_path / "mine.html"
    status, out, _ = run(capsys, "explore", "-o", str(file))
    assert status == 0
    assert file.read_text(encoding="utf-8") == page()
    assert out.startswith(f"{file}: ")


def test_numbers_of_a_link_as_text_and_json(capsys):
    link = "file:///x/explorer.html#kernel=wendland-c2&dim=2&dx-over-h=0.7&jitter=0.05"
    wanted = numbers(setting(link))
    status, out, _ = run(capsys, "explore", "--numbers", link, "--format", "json")
    assert status == 0
    document = json.loads(out)
    assert {key: document[key] for key in wanted} == wanted
    assert document["schema"] == "sphtrunc.explore/1"
    assert document["setting"]["lattice"] == "square"
    status, out, _ = run(capsys, "explore", "--numbers", link)
    assert f"total           {wanted['error']['total']:.12e}" in out
    assert f"{wanted['moments'][1] - 1:.12e}" in out


@pytest.mark.parametrize("seen", [0, 1])
def test_open_shows_the_link(seen, tmp_path, capsys, monkeypatch):
    addresses = []
    monkeypatch.setattr("click.launch", lambda url: addresses.append(url) or seen)
    file = tmp_path / "e.html"
    status, _, err = run(capsys, "explore", "-o", str(file), "--open", "dim=2&dx-over-h=3/4")
    (address,) = addresses
    assert setting(address) == Setting(dim=2, dx_over_h="3/4")
    assert status == 2 * seen
    assert ("no browser" in err) == bool(seen)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["--numbers", "kernels=lucy"], "link: got 'kernels'"),
        (["--numbers", "kernel=no-such"], "unknown name"),
        (["--numbers", "kernel=gaussian"], "polynomials"),
        (["--numbers", "dim=4"], "dim: got '4'"),
        (["--numbers", "dim=2&lattice=fcc"], "lattice: got 'fcc'"),
        (["--numbers", "dx-over-h=0"], "dx-over-h: got 0"),
        (["--numbers", "jitter=a"], "jitter: got 'a'"),
        (["--numbers", "form=paired&jitter=0.1"], "paired"),
        (["--numbers", "correction=csph&form=symmetric"], "correction"),
        (["--numbers", "correction=rkpm-3&dx-over-h=1.5"], "singular"),
        (["--numbers", "--open"], "one of them"),
        (["--format", "json"], "--numbers"),
        (["dim=2"], "--open or --numbers"),
        (["-o", "/no/such/folder/e.html"], "No such file"),
    ],
)
def test_refusals_are_one_line(arguments, match, capsys):
    status, _, err = run(capsys, "explore", *arguments)
    assert status == 2
    assert match in err
    assert err.count("\n") == 1


def test_info_says_what_is_installed(capsys):
    status, out, _ = run(capsys, "info", "--format", "json")
    assert status == 0
    found = json.loads(out)
    assert found == information()
    assert found["schema"] == "sphtrunc.info/1"
    for name in ("sympy", "numpy", "scipy", "click", "lark", "mpmath"):
        assert found["packages"][name] == version(name)
    assert found["extras"]["test"] == []
    assert found["cores"] >= 1
    status, out, _ = run(capsys, "info")
    assert version("numpy") in out


def test_info_names_what_an_extra_lacks(capsys, monkeypatch):
    """As where Numba is not installed: the engine's loops have no cache."""
    from sphtrunc.cli import info

    installed = info._version
    monkeypatch.setattr(info, "_version", lambda name: None if name == "numba" else installed(name))
    found = information()
    assert found["extras"]["fast"] == ["numba"]
    assert found["packages"]["numba"] is None
    assert found["cache"] is None
    _, out, _ = run(capsys, "info")
    assert "without numba" in out
    assert "sphtrunc[fast]" in out


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("sphtrunc exp", {"plain,export", "plain,explore"}),
        ("sphtrunc info --form", {"plain,--format"}),
    ],
)
def test_a_shell_completes_commands_and_options(words, offered, capsys, monkeypatch):
    """As click's lines for bash ask for it (the guide's page of info)."""
    monkeypatch.setenv("_SPHTRUNC_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    _, out, _ = run(capsys)
    assert set(out.split()) == offered
