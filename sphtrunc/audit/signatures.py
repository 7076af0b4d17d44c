"""How a callable wants its distance, its smoothing length and its dimension: by name, or as said.

Codes write `W(r, h)`, `w(q)`, `kernel(xij, rij, h)`, `gradient(xij, rij, h, grad)`. Each argument
has a meaning, MEANINGS, by which it is recognised where the caller does not say.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

#: meaning: the names it goes by, in lower case
MEANINGS: dict[str, tuple[str, ...]] = {
    "q": ("q", "u", "s"),
    "r": ("r", "rij", "r_ij", "rad", "radius", "dist", "distance", "separation"),
    "h": ("h", "hij", "h_ij", "hi", "h_i", "hsml", "smoothing_length", "smoothinglength", "hsm"),
    "dim": ("dim", "dims", "ndim", "n_dim", "ndims", "dimension", "dimensions", "nd"),
    "xij": ("xij", "x_ij", "rvec", "r_vec", "pos_ij"),
    "grad": ("grad", "gradient", "gradw"),
}
_MEANING = {name: meaning for meaning, names in MEANINGS.items() for name in names}
EXAMPLES = '"W(r,h)", "W(r,h,dim)", "w(q)", "w(q,dim)" or "kernel(xij,rij,h)"'
_CALL = re.compile(r"\s*\w+\s*\(\s*(\w+(?:\s*,\s*\w+)*)\s*\)\s*", re.ASCII)


@dataclass(frozen=True)
class Signature:
    """The arguments of a callable in their order, what each means, and how that is known.

    names: as its author writes them; meanings: keys of MEANINGS; keyword: passed by name, because
    others, left at their defaults, stand between; said: given, not read off the callable
    """

    names: tuple[str, ...]
    meanings: tuple[str, ...]
    keyword: bool
    said: bool

    @property
    def takes_h(self) -> bool:
        """Whether its values are W(r, h), in units of h^−d; otherwise they are h^d W."""
        return "h" in self.meanings

    @property
    def takes_r(self) -> bool:
        """Whether its distance is r; otherwise it is q = r/h."""
        return "q" not in self.meanings

    def arguments(self, distance: Any, h: float, dim: int) -> tuple[list[Any], dict[str, Any]]:
        """Positional and keyword arguments; the separation points along the first axis."""
        values = {"q": distance, "r": distance, "h": h, "dim": dim}
        given: list[Any] = []
        for meaning in self.meanings:
            if meaning == "xij":
                given.append([distance, 0.0 * distance, 0.0 * distance])
            elif meaning == "grad":
                given.append([0.0, 0.0, 0.0])
            else:
                given.append(values[meaning])
        if self.keyword:
            return [], dict(zip(self.names, given, strict=True))
        return given, {}

    def __str__(self) -> str:
        return f"({', '.join(self.names)})"

    def described(self) -> str:
        """In words: what is passed, and whether the caller said so."""
        words = {
            "q": "r/h",
            "r": "the distance",
            "h": "the smoothing length",
            "dim": "the dimension",
            "xij": "the separation",
            "grad": "the gradient to be filled",
        }
        parts = [
            f"{name} is {words[meaning]}"
            for name, meaning in zip(self.names, self.meanings, strict=True)
            if name != meaning or meaning in ("xij", "grad")
        ]
        told = f"{self}" + (": " if parts else "") + ", ".join(parts)
        return told if self.said else f"{told} (assumed; say another by `signature`)"


def given(text: str) -> Signature:
    """The signature that a text says: 'W(r,h)', 'w(q,dim)', 'kernel(xij,rij,h)', in any order.

    Raises ValueError where it is none, or an argument is of no meaning.
    """
    match = _CALL.fullmatch(text[:100])
    names = tuple(n.strip() for n in match.group(1).split(",")) if match else ()
    meanings = tuple(_MEANING.get(name.lower(), "") for name in names)
    if not names or "" in meanings or not _sufficient(meanings):
        raise ValueError(
            f"signature: got {text[:60]!r}, expected {EXAMPLES}: one distance, q or r, and each"
            " argument once"
        )
    return Signature(names, meanings, False, True)


def of(function: Callable[..., Any], what: str) -> Signature:
    """The signature of a callable, from the names of its arguments.

    What cannot be read is called as w(q). A single argument is q, and so is a distance without h;
    two whose names say nothing are r and h. Arguments of no known name keep their defaults.

    Raises ValueError where the names do not say enough.
    """
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):
        return Signature(("q",), ("q",), False, False)
    usable = [p for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    required = [p for p in usable if p.default is p.empty]
    if not usable:
        return Signature(("q",), ("q",), False, False)
    meant = {p.name: _MEANING.get(p.name.lower(), "") for p in usable}
    unknown = [p.name for p in required if not meant[p.name]]
    if len(unknown) == 1 and not {"q", "r", "xij"} & set(meant.values()):
        meant[unknown.pop()] = "r" if "h" in meant.values() else "q"
    elif len(unknown) == len(required) == 2 and not any(meant.values()):
        meant |= dict(zip(unknown, ("r", "h"), strict=True))
        unknown = []
    if not {"h", "xij"} & set(meant.values()):
        # a distance alone is one in units of h
        meant = {name: "q" if meaning == "r" else meaning for name, meaning in meant.items()}
    known = [p for p in usable if meant[p.name]]
    names, meanings = (tuple(x) for x in ([p.name for p in known], [meant[p.name] for p in known]))
    if unknown or not _sufficient(meanings):
        shown = ", ".join(p.name for p in usable)[:80]
        raise ValueError(
            f"{what}: of its arguments ({shown}) it is not clear which are the distance and the"
            f" smoothing length; say it with a signature in its order, {EXAMPLES}"
        )
    keyword = names != tuple(p.name for p in usable[: len(names)]) or any(
        p.kind is p.KEYWORD_ONLY for p in known
    )
    return Signature(names, meanings, keyword, False)


def _sufficient(meanings: Sequence[str]) -> bool:
    """One distance (a vector comes beside r), and nothing twice."""
    distances = ("q" in meanings) + ("r" in meanings)
    alone = "xij" in meanings and "q" not in meanings
    return len(set(meanings)) == len(meanings) and (distances == 1 or (not distances and alone))
