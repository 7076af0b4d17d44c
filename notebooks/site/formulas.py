"""Formulas as the docstrings write them, ∫ |s|ⁿ Ŵ d^d s, as TeX: \\int |s|^{n} \\hat W d^d s.

What is a formula in a sentence is a run of words that hold a sign of mathematics (σ, ∫, ′, a
subscript or power), with the numbers, letters and operators between them. A sign that is not known
here raises ValueError, so that no formula is half translated.
"""

from __future__ import annotations

import re

#: a sign and its name in TeX, in pairs
_NAMES = """
    α alpha β beta γ gamma δ delta ε varepsilon ζ zeta η eta θ theta κ kappa λ lambda μ mu ν nu ξ xi
    π pi ρ rho σ sigma τ tau φ varphi χ chi ψ psi ω omega Δ Delta Ω Omega Φ Phi Σ sum ∫ int ∇ nabla
    ∂ partial ∞ infty ≤ le ≥ ge ≠ ne ≈ approx ∝ propto → to · cdot × times … dots ± pm ⟨ langle
    ⟩ rangle
""".split()  # noqa: SIM905  legible so
SIGNS = {sign: rf"\{name} " for sign, name in zip(_NAMES[::2], _NAMES[1::2], strict=True)} | {
    "²": "^{2}",
    "³": "^{3}",
    "½": r"\tfrac12 ",
    "Ŵ": r"\hat W ",
    "−": "-",
    "%": r"\%",
}
SUPERSCRIPTS = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻⁽⁾ⁿᵏ", "0123456789+-()nk", strict=True)) | {"ᵅ": r"\alpha "}
SUBSCRIPTS = dict(zip("₀₁₂₃₄₅₆₇₈₉₊₋ₐₙₖᵢⱼ", "0123456789+-ankij", strict=True))
PRIMES = {"′": "'", "″": "''", "‴": "'''"}
COMBINING = {"\u0303": r"\tilde ", "\u0302": r"\hat ", "\u0304": r"\bar "}

_STRONG = re.compile(
    "["
    + "".join(set(SIGNS) - set("…·%→×−") | set(SUPERSCRIPTS) | set(SUBSCRIPTS) | set(PRIMES))
    + "".join(COMBINING)
    + r"√]|[A-Za-z]_[A-Za-zα-ω0-9]|[A-Za-z0-9)|]\^"
)
_WORDS = ("cos", "sin", "exp", "log", "mean", "max", "min")
_WEAK = re.compile(r"[\s\d=+\-−/·×<>≤≥…|.,()\[\]→{}]*")
_LETTER = re.compile(
    r"(?<![A-Za-z])[A-HJ-Zb-z](?![A-Za-z])|\b(?:" + "|".join(_WORDS) + r")\b|d[sx]"
)


def _strong(word: str) -> bool:
    names = re.sub(r"(?<=[_^])(?:[A-Za-z]+|\{[^{}]*\})", "", word)
    return bool(_STRONG.search(word)) and not re.search(r"[A-Za-z]{4,}|[\"'`:*]", names)


def _weak(word: str) -> bool:
    """A number, an operator or a single letter, which a formula may go on with."""
    return bool(_WEAK.fullmatch(_LETTER.sub("", word))) and "`" not in word


def islands(text: str) -> list[tuple[bool, str]]:
    """The text as pieces (is it a formula, what is written), in order.

    >>> islands("the moment ∫ |s|ⁿ Ŵ d^d s, in units of hⁿ")
    [(False, 'the moment '), (True, '∫ |s|ⁿ Ŵ d^d s'), (False, ', in units of '), (True, 'hⁿ')]
    """
    words = re.findall(r"\s+|\S+", text)
    pieces: list[tuple[bool, str]] = []
    at = 0
    while at < len(words):
        end = at
        while end < len(words):
            word = words[end].rstrip(",;:.")
            if not (_strong(word) or _weak(word)):
                break
            end += 1
            open_yet = _open("".join(words[at:end])) > _closed("".join(words[at:end]))
            if word != words[end - 1] and not open_yet:
                break
        run = words[at:end]
        if any(_strong(word) for word in run):
            pieces += _trimmed("".join(run))
            at = end
        else:
            end = max(end, at + 1)
            pieces.append((False, "".join(words[at:end])))
            at = end
    return _joined(pieces)


def _trimmed(run: str) -> list[tuple[bool, str]]:
    """A run without the blanks, stops and brackets around it that belong to the sentence."""
    before, core, after = "", run, ""
    while core:
        first, last = core[0], core[-1]
        if last in " \n,;:.=−-→<>([" or (last in ")]" and _open(core) < _closed(core)):
            core, after = core[:-1], last + after
        elif first in " \n,." or (first in "([" and _open(core) > _closed(core)):
            core, before = core[1:], before + first
        else:
            break
    return [(False, before), (bool(_STRONG.search(core)), core), (False, after)]


def _open(text: str) -> int:
    return text.count("(") + text.count("[")


def _closed(text: str) -> int:
    return text.count(")") + text.count("]")


def _joined(pieces: list[tuple[bool, str]]) -> list[tuple[bool, str]]:
    merged: list[tuple[bool, str]] = []
    for formula, text in pieces:
        if not text:
            continue
        if merged and not formula and not merged[-1][0]:
            merged[-1] = (False, merged[-1][1] + text)
        else:
            merged.append((formula, text))
    return merged


def tex(formula: str) -> str:
    """The formula as TeX.

    >>> tex("σ_d = 1 / ∫ w(|s|) d^d s")
    '\\\\sigma _d = 1 / \\\\int  w(|s|) d^d s'

    Raises ValueError for a sign that is not known.
    """
    text = re.sub(r"([_^])([A-Za-z]{2,})", r"\1{\\mathrm{\2}}", formula)
    text = re.sub(r"\b(cos|sin|exp|log|max|min)\b", r"\\\1 ", text)
    text = re.sub(r"\bmean\b", r"\\operatorname{mean}", text)
    text = re.sub(r"√\(([^()]*)\)", r"\\sqrt{\1}", text)
    text = re.sub(r"√(\w+)", r"\\sqrt{\1}", text)
    text = text.replace("->", "→")
    for table, sign in ((SUPERSCRIPTS, "^"), (SUBSCRIPTS, "_")):
        run = "[" + "".join(table) + "]+"
        text = re.sub(run, lambda m, t=table, s=sign: f"{s}{{{''.join(t[c] for c in m[0])}}}", text)
    text = re.sub(r"(.)([\u0302\u0303\u0304])", lambda m: f"{{{COMBINING[m[2]]}{m[1]}}}", text)
    signs = SIGNS | PRIMES
    out = "".join(signs.get(letter, letter) for letter in text)
    strange = sorted({letter for letter in out if not letter.isascii()})
    if strange:
        raise ValueError(f"formula {formula!r}: no TeX for {' '.join(strange)}")
    return out.replace("\n", " ").strip()
