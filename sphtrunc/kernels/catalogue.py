"""The standard kernels as data: a shape and a reference each, and no constants.

Kernels that their authors write on a support of 1h are written here on 2h, the convention of the
rest; `Kernel.scaled(support=1)` turns them back. Left out: Read's HOCT4, whose innermost knot is
irrational, (60 − √826)/146 of the support, when its decimal constants are derived from the
conditions they stand for (w′(0) = 0, w″ = 0 at the knot, A = 16/5, B = −94/5).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb
from re import findall, fullmatch

from sympy import QQ, Expr, Poly, Rational

from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.piecewise import q

_WENDLAND = "Wendland (1995) doi:10.1007/BF02123482"
_DEHNEN = f"{_WENDLAND}; Dehnen & Aly (2012) doi:10.1111/j.1365-2966.2012.21439.x"
_POLYNOMIAL = "Quinlan, Basa & Lastiwka (2006) doi:10.1002/nme.1617"
_SPLINE = "Schoenberg (1946) doi:10.1090/qam/15914"
_MONAGHAN = "Monaghan & Lattanzio (1985) Astron. Astrophys. 149:135"
_MORRIS = "Morris, Fox & Zhu (1997) doi:10.1006/jcph.1997.5776"
_MUELLER = "Müller, Charypar & Gross (2003) doi:10.2312/SCA03/154-159"
_CORE = (
    "Thomas & Couchman (1992) doi:10.1093/mnras/257.1.11;"
    " Read, Hayfield & Agertz (2010) doi:10.1111/j.1365-2966.2010.16577.x"
)

_x = q / 2  # distance in units of a support of 2h
_CUBIC = (1 - 3 * q**2 / 2 + 3 * q**3 / 4, (2 - q) ** 3 / 4)
_L = Rational(7, 10)  # width of the quartic part of the linear quartic kernel, whose core is 3/10


#: name: (knots, pieces, reference)
SHAPES: dict[str, tuple[Sequence[object], Sequence[Expr], str]] = {
    "wendland-c2": ([0, 2], [(1 - _x) ** 4 * (1 + 4 * _x)], _DEHNEN),
    "wendland-c4": ([0, 2], [(1 - _x) ** 6 * (3 + 18 * _x + 35 * _x**2) / 3], _DEHNEN),
    "wendland-c6": ([0, 2], [(1 - _x) ** 8 * (1 + 8 * _x + 25 * _x**2 + 32 * _x**3)], _DEHNEN),
    "wendland-c8": (
        [0, 2],
        [(1 - _x) ** 10 * (5 + 50 * _x + 210 * _x**2 + 450 * _x**3 + 429 * _x**4) / 5],
        _WENDLAND,
    ),
    "wendland-c2-1d": ([0, 2], [(1 - _x) ** 3 * (1 + 3 * _x)], _DEHNEN),
    "wendland-c4-1d": ([0, 2], [(1 - _x) ** 5 * (1 + 5 * _x + 8 * _x**2)], _DEHNEN),
    "wendland-c6-1d": (
        [0, 2],
        [(1 - _x) ** 7 * (1 + 7 * _x + 19 * _x**2 + 21 * _x**3)],
        _DEHNEN,
    ),
    "lucy": ([0, 2], [(1 - _x) ** 3 * (1 + 3 * _x)], "Lucy (1977) doi:10.1086/112164"),
    "johnson-quadratic": (
        [0, 2],
        [(2 - q) ** 2],
        "Johnson, Stryk & Beissel (1996) doi:10.1016/S0045-7825(96)01089-4",
    ),
    "spiky": ([0, 2], [(2 - q) ** 3], "Desbrun & Gascuel (1996) doi:10.1007/978-3-7091-7486-9_5"),
    "hyperbolic": (
        [0, 1, 2],
        [6 - 6 * q + q**3, (2 - q) ** 3],
        "Yang, Peng & Liu (2014) doi:10.1016/j.apm.2013.12.001",
    ),
    "core-triangle": ([0, "2/3", 1, 2], [Rational(11, 9) - q, *_CUBIC], _CORE),
    "linear-quartic": (
        [0, "3/5", 2],
        [Rational(13, 20) - _x, (1 - _x) ** 3 / _L**2 - (1 - _x) ** 4 / (2 * _L**3)],
        "Valcke, De Rijcke, Rödiger & Dejonghe (2010) doi:10.1111/j.1365-2966.2010.17127.x,"
        " constants from their conditions at the knot 3/10 of the support",
    ),
}

#: name: (family, parameter, reference of the member)
ALIASES: dict[str, tuple[str, str]] = {
    "cubic-spline": ("b-spline:4", f"{_SPLINE}; {_MONAGHAN}"),
    "quartic-spline": ("b-spline:5", f"{_SPLINE}; {_MORRIS}"),
    "quintic-spline": ("b-spline:6", f"{_SPLINE}; {_MORRIS}"),
    "poly6": ("polynomial:2", _MUELLER),
    "thomas-couchman": ("core-triangle", _CORE),
}

#: family: (first member, last member)
FAMILIES: dict[str, tuple[int, int]] = {"b-spline": (2, 20), "polynomial": (-1, 20)}


def names() -> list[str]:
    """Every name in the catalogue: shapes, aliases and all members of the families."""
    members = [f"{f}:{n}" for f, (first, last) in FAMILIES.items() for n in range(first, last + 1)]
    return [*ALIASES, *members, *SHAPES]


def named(name: str) -> Kernel:
    """The catalogue kernel of that name, as in `names()`.

    >>> named("cubic-spline").normalisation(3)
    1/pi

    Raises ValueError for an unknown name, with the nearest one.
    """
    key = name.strip().lower()
    if key in ALIASES:
        target, source = ALIASES[key]
        kernel = named(target)
        return Kernel(kernel.knots, kernel.pieces, name=key, source=source)
    if key in SHAPES:
        knots, pieces, source = SHAPES[key]
        polynomials = [Poly(piece, q, domain=QQ) for piece in pieces]
        return Kernel(knots, polynomials, name=key, source=source)
    family, colon, number = key.partition(":")
    if family in FAMILIES and colon:
        first, last = FAMILIES[family]
        if fullmatch("-?[0-9]{1,2}", number) and first <= (n := int(number)) <= last:
            return _b_spline(n) if family == "b-spline" else _polynomial(n)
        raise ValueError(
            f"kernel: got {_short(name)}, expected {family}:N with N from {first} to {last}"
        )
    if key == "hoct4":
        raise ValueError(
            "kernel: hoct4 has an irrational knot, (60 - sqrt(826))/146 of its support, and is not"
            " in the catalogue; core-triangle is its rational relative"
        )
    raise ValueError(f"kernel: unknown name {_short(name)}{_nearest(name)}")


def _b_spline(n: int) -> Kernel:
    """M_n: Σ_j (−1)^j C(n, j) (n/2 − j − q)₊^{n−1}; the cubic with its customary factor 1/4."""
    ends = [Rational(n, 2) - j for j in range((n + 1) // 2)]  # n/2, n/2 − 1, … > 0
    factor = Rational(1, 4) if n == 4 else Rational(1)
    powers = [
        Poly(factor * (-1) ** j * comb(n, j), q, domain=QQ) * Poly(end - q, q, domain=QQ) ** (n - 1)
        for j, end in enumerate(ends)
    ]
    pieces = [sum(powers[: j + 1], Poly(0, q, domain=QQ)) for j in range(len(ends))]
    return Kernel([0, *reversed(ends)], pieces[::-1], name=f"b-spline:{n}", source=_SPLINE)


def _polynomial(beta: int) -> Kernel:
    """(4 − q²)^{β+1}, of boundary smoothness β."""
    shape = Poly(4 - q**2, q, domain=QQ) ** (beta + 1)
    return Kernel([0, 2], [shape], name=f"polynomial:{beta}", source=_POLYNOMIAL)


def _short(name: str) -> str:
    return repr(name if len(name) <= 40 else name[:37] + "...")


def _nearest(name: str) -> str:
    near = suggestion(name)
    if near and near != name.strip().lower():
        return f"; did you mean {near}? `sphtrunc kernels` lists them all"
    return "; `sphtrunc kernels` lists them all, or write a formula such as '0..2: (2-q)^3'"


#: what codes and papers call them, as words in any order -> the name here
KNOWN_AS: dict[str, str] = {
    "m 4": "cubic-spline", "m 5": "quartic-spline", "m 6": "quintic-spline",
    "wendland quintic": "wendland-c2", "wendland quintic c 4": "wendland-c4",
    "wendland quintic c 6": "wendland-c6", "wendland 2": "wendland-c2", "wendland 4": "wendland-c4",
    "wendland 6": "wendland-c6", "wendland 8": "wendland-c8", "gauss": "gaussian",
    "desbrun": "spiky", "mueller": "poly6", "top hat": "polynomial:-1",
    "tophat": "polynomial:-1", "hat": "b-spline:2", "epanechnikov": "polynomial:0",
    "quadratic": "johnson-quadratic",
}  # fmt: skip


def suggestion(name: str) -> str:
    """The name that was probably meant, or "": by its words in any order, then by its letters.

    >>> suggestion("Wendland2C"), suggestion("wendland"), suggestion("QuinticSpline")
    ('wendland-c2', 'wendland-c2', 'quintic-spline')
    """
    from difflib import SequenceMatcher

    words = _words(name[:80]) - {"kernel", "function", "sph"}
    usual = {family: f"{family}:N" for family in FAMILIES}
    usual |= {n: n for n in (*ALIASES, *SHAPES, "gaussian", "super-gaussian", *names())} | KNOWN_AS
    for text, meant in usual.items():
        if words and words == _words(text):
            return meant
    usual = {text: meant for text, meant in usual.items() if text not in KNOWN_AS}
    within = [meant for text, meant in usual.items() if words and words <= _words(text)]
    if within:
        return within[0]
    ranked = [(SequenceMatcher(None, name.lower()[:80], text).ratio(), text) for text in usual]
    ratio = max(ratio for ratio, _ in ranked)
    return usual[next(text for r, text in ranked if r == ratio)] if ratio >= 0.5 else ""


def _words(text: str) -> set[str]:
    """Runs of letters and of digits, in lower case; a capital begins a word."""
    return {word.lower() for word in findall("[A-Z]?[a-z]+|[A-Z]+|[0-9]+", text)}
