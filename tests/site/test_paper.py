"""The paper has the form that its journal asks for, and cites what it lists."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "notebooks" / "paper"
TEXT = (FOLDER / "paper.md").read_text(encoding="utf-8")
BODY = TEXT.split("---\n", 2)[2]

#: in 2026: joss.readthedocs.io, "JOSS Paper Format"
SECTIONS = [
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "AI usage disclosure",
    "Acknowledgements",
    "References",
]


def test_sections_and_length():
    assert re.findall(r"^# (.*)$", BODY, flags=re.MULTILINE) == SECTIONS
    assert 750 <= len(BODY.split()) <= 1750


def test_what_is_cited_is_listed_and_the_reverse():
    listed = set(re.findall(r"^@article\{(\w+),", (FOLDER / "paper.bib").read_text("utf-8"), re.M))
    assert set(re.findall(r"@(\w+)", BODY)) == listed


def test_figures_are_there_and_referred_to():
    figures = re.findall(r"\\label\{(fig:\w+)\}\]\(([^)]+)\)", BODY)
    assert len(figures) == 2
    for label, path in figures:
        assert (FOLDER / path).is_file()
        assert f"\\autoref{{{label}}}" in BODY
