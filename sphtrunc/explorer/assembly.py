"""The page, from its sources and the exact tables: one file, without a request to anywhere."""

from __future__ import annotations

import json
from base64 import b64encode
from hashlib import sha256
from importlib.resources import files
from string import Template

from sphtrunc.explorer.tables import tables
from sphtrunc.version import __version__

#: the part that computes, in the order of its layers, then the part that draws
COMPUTING = (
    "rational",
    "formula",
    "kernel",
    "lattice",
    "traced",
    "operator",
    "estimate",
    "setting",
)
DRAWING = ("drawing", "figures", "commands", "controls")


def source(name: str) -> str:
    """The text of a file of the page."""
    return files("sphtrunc.explorer").joinpath("page", name).read_text(encoding="utf-8")


def script(names: tuple[str, ...]) -> str:
    """The tables and the named sources as one script."""
    # in a script of a page, "</" would end it
    data = json.dumps(tables(), ensure_ascii=False, separators=(",", ":")).replace("</", "<\\/")
    return "\n".join(
        ['"use strict";', f"const TABLES = {data};", *(source(f"{n}.js") for n in names)]
    )


def page() -> str:
    """The page as HTML. Its policy lets it run this script and style and load nothing at all."""
    style, code = source("explorer.css"), script((*COMPUTING, *DRAWING))
    policy = (
        f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(code)}"
    )
    return Template(source("explorer.html")).substitute(
        version=__version__, policy=policy, style=style, script=code
    )


def _hash(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"
