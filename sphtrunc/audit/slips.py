"""Slips that leave a constant wrong by a factor: each predicts it, and is as likely as it is usual.

W = c h^−d w(r/h) integrates to c/c_right. Every slip is tried, none is believed for being the first
that fits: those that give the factor found are ranked in bits, what is half as usual costing one
more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import product
from math import floor, isclose, pi
from typing import Any

import numpy as np
from sympy import Expr, Integer, Rational
from sympy import pi as exact_pi

from sphtrunc.audit import faults
from sphtrunc.audit.analytic import Analytic
from sphtrunc.audit.constants import number
from sphtrunc.audit.forms import LENGTHS, UNIT_1D, forms
from sphtrunc.audit.identification import Exact, exact, known_constants
from sphtrunc.audit.recognition import Match, conventions
from sphtrunc.kernels.kernel import SPHERE, Kernel

#: constants that were printed wrongly and copied since: (kernel, dimension, constant of its shape)
MISPRINTS: tuple[tuple[str, int, Expr], ...] = (
    ("quintic-spline", 1, Integer(120)),
    ("quintic-spline", 2, 1 / (478 * exact_pi)),
    ("quintic-spline", 3, 3 / (359 * exact_pi)),
)

#: what π is taken for
ROUGH_PI: dict[str, float] = {
    "22/7": 22 / 7,
    "3": 3.0,
    **{text: float(text) for text in ("3.1", "3.14", "3.142", "3.1416", "3.14159", "3.141593")},
    "355/113": 355 / 113,
}


AS_WRITTEN = "as it is written"
USUAL_SUPPORTS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)  # in units of what codes call h


@dataclass(frozen=True)
class Slip:
    """A class of fault, words, the factor by which the integral is wrong, and its bits."""

    kind: str
    words: str
    factor: float
    bits: float


def constant_slips(match: Match, dim: int, h: float | None = None) -> list[Slip]:
    """Every slip that is thought of, likeliest first; factors of 1 are left out.

    h: the smoothing length at which the values were taken, where its power could not be seen.
    """
    found = [*_general(match, dim, h)]
    if isinstance(match.shape, Kernel):
        found += [*_of_kernel(match, match.shape, dim)]
    found = [slip for slip in found if not isclose(slip.factor, 1.0, rel_tol=1e-12)]
    return sorted(found, key=lambda slip: slip.bits)


def normalisations(match: Match) -> dict[int, float]:
    """c_right of the shape as matched, in the author's h, for every dimension."""
    shape = match.shape
    stretch = match.scale if isinstance(shape, Analytic) else float(shape.support) / match.support
    return {d: float(number(shape.normalisation(d))) * stretch**d for d in (1, 2, 3)}


def _general(match: Match, dim: int, h: float | None) -> Iterator[Slip]:
    """Slips that any shape may suffer."""
    right = normalisations(match)
    for other in (1, 2, 3):
        if other != dim:
            words = f"the constant of {other}D used in {dim}D"
            yield Slip(faults.OTHER_DIMENSION, words, right[other] / right[dim], 1.2)
    if dim == 1:
        words = "the constant comes from the integral over r > 0 alone: twice the right one"
        yield Slip(faults.HALF_RANGE, words, 2.0, 1.0)
        words = "half the right constant: the range was counted twice"
        yield Slip(faults.HALF_RANGE, words, 0.5, 2.0)
    else:
        words = "twice the right constant: a factor 1/2 is lost, or half the range was integrated"
        yield Slip(faults.HALF_RANGE, words, 2.0, 1.8)
        words = "half the right constant: a factor 1/2 too many, or the range counted twice"
        yield Slip(faults.HALF_RANGE, words, 0.5, 2.0)
    for halves, bits in ((2, 1.1), (-2, 1.1), (1, 2.0), (-1, 2.0), (4, 3.0), (-4, 3.0), (3, 3.0),
                         (-3, 3.0)):  # fmt: skip
        power = {2: "π", 1: "√π", 4: "π²", 3: "π√π"}[abs(halves)]
        lost = "too many" if halves > 0 else "is lost"
        yield Slip(faults.FACTOR_PI, f"a factor {power} {lost}", pi ** (halves / 2), bits)
    yield from _rough_pi(match, dim)
    if h is not None and h != 1:
        for n in (1, -1, 2, -2, 3, -3):
            words = f"a factor h^{n} too many (h = {h:g}): its power of h is wrong"
            yield Slip(faults.POWER_OF_H, words, h**n, 1.5 + 0.2 * abs(n))


def _rough_pi(match: Match, dim: int) -> Iterator[Slip]:
    """π^p taken with a rough π, p being its power in the constant."""
    own = exact(match.shape.normalisation(dim))
    if own is None or not own.halves:
        return
    for text, rough in ROUGH_PI.items():
        words = f"π was taken as {text}"
        yield Slip(faults.ROUNDED, words, (rough / pi) ** (own.halves / 2), 1.5)


def _of_kernel(match: Match, kernel: Kernel, dim: int) -> Iterator[Slip]:
    """Slips of a polynomial kernel, whose constants and forms are rational."""
    stretch = float(kernel.support) / match.support
    sigma = {d: float(number(kernel.normalisation(d))) for d in (1, 2, 3)}
    right = sigma[dim] * stretch**dim
    for name, where, constant in MISPRINTS:
        if name == kernel.name and where == dim:
            words = f"a widely copied misprint: {constant} for {kernel.normalisation(dim)}"
            yield Slip(faults.MISPRINT, words, float(number(constant)) / sigma[dim], 0.0)
    for what, support in conventions(kernel, dim):
        bits = 1.4 + next(b for w, b in LENGTHS.values() if w == what)
        for other in (1, 2, 3):
            words = f"the constant is the one for a support of {support:.7g}h"
            words += f" (h being {what})" if what != "h" else ""
            words += f" in {other}D" if other != dim else ""
            factor = sigma[other] * (float(kernel.support) / support) ** other / right
            same = isclose(support, match.support, rel_tol=1e-9)
            if not same:
                yield Slip(
                    faults.CONVENTION if other == dim else faults.OTHER_DIMENSION,
                    f"{words}, but it is {match.support:.7g}h here",
                    factor,
                    bits + 3.0 * (other != dim),
                )
    usual = {support for _, support in conventions(kernel, dim)}
    for ends in USUAL_SUPPORTS:
        if not any(isclose(ends, s, rel_tol=1e-9) for s in (*usual, match.support)):
            words = f"the constant is the one for a support of {ends:g}h, but it is"
            words += f" {match.support:.7g}h here"
            yield Slip(faults.CONVENTION, words, (match.support / ends) ** dim, 3.2)
    yield from _powers_of_support(match, kernel)
    yield from _volume_elements(kernel, dim, stretch)
    scales = written_scales(match, kernel, dim)
    yield from _other_forms(scales, usual_scales(match, kernel, dim))
    for words, (scale, odd) in scales.items():
        constant = right * scale
        told = "the reciprocal of the right constant"
        told += "" if words == AS_WRITTEN or scale == 1 else f" ({words})"
        yield Slip(faults.RECIPROCAL, told, 1 / constant**2, 2.5 + odd)
    yield from _integer_divisions(match, kernel, dim, scales)


def written_scales(match: Match, kernel: Kernel, dim: int) -> dict[str, tuple[float, float]]:
    """The forms in which the kernel may be written here: words -> (s, bits).

    Of values, any; of a formula the one in which it stands.
    """
    if match.written is None:
        return usual_scales(match, kernel, dim)
    scale = float(number(match.written.normalisation(dim))) / normalisations(match)[dim]
    return {AS_WRITTEN: (scale, 0.0)}


def usual_scales(match: Match, kernel: Kernel, dim: int) -> dict[str, tuple[float, float]]:
    """The forms that are met, with the author's h: words -> (s, bits)."""
    lengths = [
        length
        for length, support in (("h", kernel.support), ("support", Rational(1)))
        if isclose(float(support), match.support, rel_tol=1e-9)
    ]
    found: dict[str, tuple[float, float]] = {}
    for length in lengths or ["two-sigma"]:
        for form in forms(kernel, length):
            found.setdefault(form.words, (float(form.scale), form.odd))
    if dim > 1:
        own = float(number(kernel.normalisation(1))) * float(kernel.support) / match.support
        found[UNIT_1D] = (1 / own, 0.7)
    return found


def _powers_of_support(match: Match, kernel: Kernel) -> Iterator[Slip]:
    for kappa in {match.support, float(kernel.support)} - {1.0}:
        for power in (1, -1, 2, -2, 3, -3):
            words = f"a factor {kappa:.7g}^{power} too many, the support to the power {power}"
            yield Slip(faults.POWER_OF_SUPPORT, words, kappa**power, 2.6 + 0.3 * abs(power))


def _volume_elements(kernel: Kernel, dim: int, stretch: float) -> Iterator[Slip]:
    """1/(S ∫ w q^p dq) with the surface S, or the power p, of another dimension, or without S."""
    radial = {p: float(kernel._radial(kernel.pieces, p)) for p in (0, 1, 2)}
    surfaces: dict[str, float] = {str(s): float(number(s)) for s in SPHERE.values()}
    mine = surfaces[str(SPHERE[dim])] * radial[dim - 1]
    for name, surface in {**surfaces, "1": 1.0}.items():
        for power in (0, 1, 2):
            if name == str(SPHERE[power + 1]) or not radial[power]:
                continue  # right, or right in another dimension
            element = ("1", "q", "q²")[power]
            words = f"the constant is 1/({name} ∫ w {element} dq)"
            if power != dim - 1:
                words += f": the volume element of {dim}D has q^{dim - 1}"
                kind = faults.MISSING_Q if power < dim - 1 else faults.SURPLUS_Q
            else:
                words += f": the sphere's surface is {SPHERE[dim]} in {dim}D"
                kind = faults.OTHER_DIMENSION
            usual = name == str(SPHERE[dim])
            factor = mine / (surface * radial[power]) * stretch ** (power + 1 - dim)
            yield Slip(kind, words, factor, 2.2 + 1.5 * (not usual))


def _other_forms(
    scales: dict[str, tuple[float, float]], usual: dict[str, tuple[float, float]]
) -> Iterator[Slip]:
    """The constant of one form beside the shape of another."""
    for (here, (a, odd)), (other, (b, odder)) in product(scales.items(), usual.items()):
        words = f"the constant is that of another form, a {_brief(other)}"
        words += "" if here == AS_WRITTEN else f", where the shape is a {_brief(here)}"
        yield Slip(faults.OTHER_FORM, words, b / a, 2.0 + odd + odder)


def _brief(words: str) -> str:
    return {
        "constant": "shape as in the catalogue",
        "value at the origin": "shape with w(0) = 1",
    }.get(words, words.removeprefix("constant for a "))


def _integer_divisions(
    match: Match, kernel: Kernel, dim: int, scales: dict[str, tuple[float, float]]
) -> Iterator[Slip]:
    """p/q of the constant taken as a whole number."""
    own = exact(kernel.normalisation(dim))
    stretch = Fraction(float(kernel.support) / match.support).limit_denominator(64)
    for words, (scale, odd) in scales.items():
        simple = Fraction(scale).limit_denominator(1 << 20)
        if own is None or not isclose(float(simple), scale, rel_tol=1e-12):
            continue
        factor = own.factor * stretch**dim * simple
        whole = floor(factor)
        if whole and whole != factor:
            told = f"{factor} became {whole}, divided as whole numbers"
            told += f" (in the {words})" if words != AS_WRITTEN and scale != 1 else ""
            yield Slip(faults.INTEGER_DIVISION, told, whole / float(factor), 2.2 + odd)


@lru_cache(maxsize=4)
def _logs(dim: int) -> tuple[tuple[Any, ...], Any]:
    known = known_constants()
    return known, np.log([k.value for k in known])


def borrowed(match: Match, dim: int, factor: float, error: float) -> tuple[list[Slip], int]:
    """Constants of other kernels that give the factor, and how many were tried."""
    if not isinstance(match.shape, Kernel) or not factor > 0:
        return [], 0
    kernel = match.shape
    right = normalisations(match)[dim]
    known, logs = _logs(dim)
    found = []
    scales = written_scales(match, kernel, dim)
    for words, (scale, odd) in scales.items():
        here = np.abs(logs - np.log(right * scale * factor)) <= max(error, 1e-13)
        for k in (known[i] for i in np.nonzero(here)[0]):
            if k.kernel == kernel.name:
                continue
            told = f"the constant of {k.kernel} in {k.dim}D, {k.convention}, {k.form}"
            told += "" if words == AS_WRITTEN or scale == 1 else f", beside a {_brief(words)}"
            bits = 2.5 + k.bits + odd + 2.0 * (k.dim != dim)
            bits += 1.0 * (not _ends_at(k.support, match.support))
            found.append(Slip(faults.OTHER_CONSTANT, told, factor, bits))
    return sorted(found, key=lambda slip: slip.bits), len(scales) * len(known)


def _ends_at(support: Exact | float | None, here: float) -> bool:
    return support is not None and isclose(float(support), here, rel_tol=1e-9)


def pairs(slips: list[Slip]) -> Iterator[Slip]:
    """Two of the usual ones at once."""
    usual = [s for s in slips if s.bits <= 2.0 and s.kind != faults.ROUNDED]
    for i, one in enumerate(usual):
        for other in usual[i + 1 :]:
            if one.kind != other.kind:
                yield Slip(
                    one.kind,
                    f"{one.words}, and {other.words}",
                    one.factor * other.factor,
                    one.bits + other.bits + 2.0,
                )
