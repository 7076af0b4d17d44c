"""Docstrings as they are written here, as pages: a sentence with its formula, then a table of the
arguments with their shapes and units, then what is raised.

A docstring is plain text. A paragraph of lines `name: what it is` (or `name, name: …`, continued
on indented lines) describes arguments of a function or fields of a result, and becomes a table with
their types and defaults; `>>>` lines stay; `single backticks` are code, and link where they name
something public; formulas are drawn (`formulas`).
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from typing import Any

from formulas import islands, tex

import sphtrunc

_ENTRY = re.compile(r"([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*): (?=\S)")
_SHAPE = re.compile(r"\((?:[A-Za-z0-9]+, ?)+[A-Za-z0-9]*\)")
_CODE = re.compile(r"`([^`]+)`|(\"[^\"\n]*\"|'[^'\n]*[0-9][^'\n]*')")
_ARGUMENTS = ("Argument", "Type", "Default", "What it is")
_FIELDS = ("Field", "Type", "What it is")


def process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Rewrites the lines of a docstring as reStructuredText, in place."""
    known = described(obj)
    out: list[str] = []
    for block in paragraphs(lines):
        rows = entries(block, known)
        if rows:
            out += table(rows, known, callable(obj) and not inspect.isclass(obj))
        elif block[0].startswith(">>>"):
            out += block
        elif block[0].startswith("Raises "):
            out += ["**Raises** " + sentence(" ".join(block).removeprefix("Raises "))]
        else:
            out += [sentence("\n".join(block))]
        out.append("")
    lines[:] = "\n".join(out).splitlines()


def described(obj: Any) -> dict[str, tuple[str, str]]:
    """name -> (type, default): arguments of a function, fields and properties of a class."""
    found: dict[str, tuple[str, str]] = {}
    if inspect.isclass(obj):
        if dataclasses.is_dataclass(obj):
            found = {f.name: (str(f.type), "") for f in dataclasses.fields(obj)}
        found |= {name: ("", "") for name in dir(obj) if not name.startswith("_")} | found
    try:
        parameters = inspect.signature(obj).parameters.values()
    except (TypeError, ValueError):
        return found
    for p in parameters:
        kind = "" if p.annotation is p.empty else str(p.annotation)
        default = "" if p.default is p.empty else repr(p.default)
        found.setdefault(p.name, (kind, default))
    return found


def paragraphs(lines: list[str]) -> list[list[str]]:
    """Blocks between blank lines; a doctest is one of its own."""
    text = textwrap.dedent("\n".join(lines)).strip("\n")
    return [block.splitlines() for block in re.split(r"\n\s*\n", text) if block.strip()]


def entries(block: list[str], known: dict[str, Any]) -> list[tuple[list[str], str]]:
    """(names, what they are) of a paragraph that describes arguments; empty for any other.

    A line may hold several, `a: this; b: that`.
    """
    rows: list[tuple[list[str], str]] = []
    for line in block:
        start = _ENTRY.match(line)
        if start and set(start[1].split(", ")) & set(known):
            for part in re.split(r"; (?=[A-Za-z_][\w, ]*: )", line):
                head = _ENTRY.match(part)
                if head and set(head[1].split(", ")) & set(known):
                    rows.append((head[1].split(", "), part[head.end() :]))
                else:
                    rows[-1] = (rows[-1][0], f"{rows[-1][1]}; {part}")
        elif rows:
            rows[-1] = (rows[-1][0], f"{rows[-1][1]} {line.strip()}")
        else:
            return []
    return rows


def table(
    rows: list[tuple[list[str], str]], known: dict[str, tuple[str, str]], arguments: bool
) -> list[str]:
    """A list-table of arguments (with defaults) or of the fields of a result."""
    head = _ARGUMENTS if arguments else _FIELDS
    widths = "18 22 14 46" if arguments else "20 24 56"
    kind = "arguments" if arguments else "fields"
    out = [
        ".. list-table::",
        "   :header-rows: 1",
        f"   :widths: {widths}",
        f"   :class: {kind}",
        "",
    ]
    out += _row(head)
    if arguments:
        told = {name for names, _ in rows for name in names}
        rows = [*rows, *(([name], "") for name in known if name not in told)]
    for names, text in rows:
        kinds = dict.fromkeys(known.get(n, ("", ""))[0] for n in names)
        cells = [", ".join(f"``{n}``" for n in names), ", ".join(f"``{k}``" for k in kinds if k)]
        if arguments:
            defaults = dict.fromkeys(known.get(n, ("", ""))[1] for n in names)
            cells.append(", ".join(f"``{d}``" for d in defaults if d))
        out += _row((*cells, sentence(text)))
    return out


def _row(cells: tuple[str, ...]) -> list[str]:
    return [f"   {'*' if i == 0 else ' '} - {cell}".rstrip() for i, cell in enumerate(cells)]


def sentence(text: str) -> str:
    """Plain text as reStructuredText: formulas, code and shapes of arrays are set as such."""
    plain = _CODE.split(text)[::3]
    code = [_code(found[1] or found[2]) for found in _CODE.finditer(text)]
    return "".join(_plain(a) + b for a, b in zip(plain, [*code, ""], strict=True))


def _code(text: str) -> str:
    name = text.removeprefix("sphtrunc.")
    if name in sphtrunc.__all__ and name != "__version__":
        return rf"\ :py:obj:`~sphtrunc.{name}`\ "
    return rf"\ ``{text}``\ "


def _plain(text: str) -> str:
    out = []
    for i, part in enumerate(re.split(f"({_SHAPE.pattern})", text)):
        if i % 2:
            out.append(rf"\ ``{part}``\ ")
            continue
        for formula, piece in islands(part):
            out.append(rf"\ :math:`{tex(piece)}`\ " if formula else _escaped(piece))
    return "".join(out)


def _escaped(text: str) -> str:
    """Characters that reStructuredText would read as its own, made harmless."""
    return re.sub(r"([\\*|_`])", r"\\\1", text)
