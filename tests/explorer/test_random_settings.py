"""Numbers of 200 random settings: the package's, those of the page's script in a JavaScript engine,
and what a browser shows to whoever sets the controls, where there is one."""

from __future__ import annotations

import pytest

from sphtrunc.explorer.setting import setting
from sphtrunc.operators.operator import CORRECTIONS, OPERATORS
from sphtrunc.scenes.sites import KINDS
from tests.explorer.browser import BROWSERS, driven
from tests.explorer.settings import COUNT, apart, engine, expected, random_settings, words

CHUNKS = 5


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_the_page_agrees_with_the_package(chunk, tmp_path):
    some = range(chunk, COUNT, CHUNKS)
    ats = [random_settings()[n] for n in some]
    for n, at in zip(some, ats, strict=True):
        got = engine()("numbersOf", words(at))
        assert "is" in got, (at, got)
        assert not apart(at, got["is"], expected(n)), at
    for browser in BROWSERS:
        found = driven(browser, tmp_path, [words(at) for at in ats])
        assert found["errors"] == []
        for n, at, got in zip(some, ats, found["settings"], strict=True):
            assert (got["state"], got["problem"]) == ("ready", ""), at
            wanted = {k: v for k, v in expected(n).items() if k != "particles"}
            assert not apart(at, {k: got[k] for k in wanted}, wanted), at
            assert setting(got["hash"]) == at
            assert f"{expected(n)['particles']} particles" in got["summary"]
            assert len(got["curves"]) == 4  # the kernel, two totals and the path
            assert min(got["curves"]) > 10


def test_the_random_settings_meet_everything():
    found = random_settings()
    assert len(found) == COUNT
    assert {at.lattice for at in found} == set(KINDS)
    assert {at.form for at in found} == set(OPERATORS["gradient"][1])
    assert {at.correction for at in found} == set(CORRECTIONS)
    assert 0.3 < sum(at.jitter > 0 for at in found) / COUNT < 0.7


def test_a_wrong_number_is_found():
    at = random_settings()[0]
    wanted = {"moments": [0.0, 0.98], "error": {"total": 1e-2}}
    assert not apart(at, wanted, wanted)
    assert apart(at, {"moments": [0.0, 0.98], "error": {"total": 1e-2 * (1 + 1e-7)}}, wanted) == {
        ".error.total": (1e-2 * (1 + 1e-7), 1e-2)
    }
    assert set(apart(at, {"moments": [0.0, 0.98]}, wanted)) == {".error.total"}
