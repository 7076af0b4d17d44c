"""A page per kernel of the catalogue, and the table of all, written from exact data.

Nothing on a page was typed: its pieces come from the catalogue, its constants from the pieces, the
figures of its floats from tests/kernels/ulp.csv, and who uses it from notebooks/verification.md.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from fractions import Fraction
from functools import lru_cache
from math import pi
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from sympy import latex

from sphtrunc import Kernel, derive
from sphtrunc.cli.kernels import HEAD, row, short
from sphtrunc.kernels.catalogue import named, names
from sphtrunc.kernels.conventions import CONVENTIONS, half_width, lengths
from sphtrunc.kernels.parse import MAX_LENGTH
from sphtrunc.kernels.transform import smoothing_error, terms, transform

ROOT = Path(__file__).parents[2]
FOLDER = Path(__file__).parent / "kernels"
DIMS = (1, 2, 3)
LATTICES = ((1, "uniform"), (2, "square"), (2, "hexagonal"), (3, "cubic"), (3, "fcc"))
#: h/Δx of the tables
RATIOS = tuple(Fraction(r) for r in ("1", "6/5", "13/10", "3/2", "7/4", "2", "5/2"))
WAVES = ("1/50", "1/20", "1/10", "1/5")  # h/λ
MOST_NEIGHBOURS = 2000  # in the support, up to which a lattice is summed
BALL = {1: 2.0, 2: pi, 3: 4 * pi / 3}
MOST_TYPESET = 9  # degree up to which the pieces are drawn as formulas
LINEAR, SEMILOG = ("linear", "linear"), ("linear", "log")
ORIGIN, INTERIOR, EDGE = "origin", "interior", "edge"


def write(app: Any) -> None:
    """Every page into site/kernels, before Sphinx looks for its sources; those that are newer than
    all that they are made of are left alone."""
    FOLDER.mkdir(exist_ok=True)
    made_of = [Path(__file__), ROOT / "tests/kernels/ulp.csv", ROOT / "notebooks/verification.md"]
    made_of += (ROOT / "sphtrunc").rglob("*.py")
    newest = max(path.stat().st_mtime for path in made_of)
    old = [n for n in names() if not _newer(FOLDER / f"{slug(n)}.md", newest)]
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        list(pool.map(write_page, old))
    if old:
        (FOLDER / "index.md").write_text(catalogue(), encoding="utf-8")


def _newer(path: Path, when: float) -> bool:
    return path.exists() and path.stat().st_mtime > when


def write_page(name: str) -> None:
    """NAME.svg and NAME.md."""
    kernel = kernels()[name]
    lattice = lattice_errors(kernel)
    draw(kernel, lattice, FOLDER / f"{slug(name)}.svg")
    (FOLDER / f"{slug(name)}.md").write_text(page(kernel, lattice), encoding="utf-8")


def slug(name: str) -> str:
    """The name as part of an address.

    >>> slug("polynomial:-1"), slug("b-spline:7")
    ('polynomial-minus-1', 'b-spline-7')
    """
    return name.replace(":-", "-minus-").replace(":", "-")


# ------------------------------------------------------------------------------------------- pages


def catalogue() -> str:
    """The table of `sphtrunc kernels`, of its own rows, in one, two and three dimensions."""
    parts = [
        "---\nhtml_theme.sidebar_secondary.remove: true\n---\n\n# Kernels\n",
        f"The {len(kernels())} kernels of the catalogue. Nothing in it but shapes was typed: every"
        " constant is derived from the pieces. The columns are those of"
        " [`sphtrunc kernels`](../../guide/kernels.md), where they are explained.\n",
        "::::{tab-set}",
    ]
    for dim in DIMS:
        rows = []
        for kernel in kernels().values():
            name, *values = row(kernel, dim).values()
            rows.append([f"[{name}]({slug(str(name))}.md)", *(short(v) for v in values)])
        parts += [f":::{{tab-item}} {dim}D", table(HEAD, rows), ":::"]
    listed = "\n".join(map(slug, kernels()))
    parts += ["::::\n", f"```{{toctree}}\n:hidden:\n\n{listed}\n```"]
    return "\n".join(parts) + "\n"


def page(kernel: Kernel, lattice: dict[tuple[int, str], list[float]]) -> str:
    """All that is known of a kernel; `lattice` as `lattice_errors` has it."""
    sections = [
        shape_section(kernel),
        constants_section(kernel),
        knots_section(kernel),
        transform_section(kernel),
        lattice_section(lattice),
        floats_section(kernel.name),
        users_section(kernel),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def shape_section(kernel: Kernel) -> str:
    """What it is: the name, the source, the pieces, the picture."""
    same = [n for n, other in kernels().items() if n != kernel.name and other == kernel]
    links = " and ".join(f"[{n}]({slug(n)}.md)" for n in same)
    cases = " \\\\\n".join(
        f"{_polynomial(piece)} & {latex(a)} \\le q \\le {latex(b)}"
        for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.coefficients(), strict=False)
    )
    shown = f"$$\nw(q) = \\begin{{cases}}\n{cases}\n\\end{{cases}}\n$$"
    pieces = formula(kernel)
    by_pieces = f"sphtrunc derive --kernel '{pieces}'\n" if len(pieces) <= MAX_LENGTH else ""
    said = [
        f"# {kernel.name}",
        f"{_linked(kernel.source)}." + (f" The same shape as {links}." if same else ""),
        "$W(r, h) = \\sigma_d h^{-d}\\, w(r/h)$, zero beyond the support of"
        f" {_h(kernel.support)}; between knots a polynomial of degree {kernel.degree} in $q$:",
        *([shown] if kernel.degree <= MOST_TYPESET else []),
        f'<a href="../../explorer.html#kernel={kernel.name}&dim=3&dx-over-h=5/6">Open it in the'
        " explorer</a>, at h = 1.2 Δx; or in the terminal, by its name or by its pieces:",
        f"```sh\nsphtrunc derive --kernel {kernel.name} --dim 3 --dx-over-h 5/6\n{by_pieces}```",
        f"![The kernel and two derivatives; its transform; its error on lattices]"
        f"({slug(kernel.name)}.svg)",
    ]
    return "\n\n".join(said)


def formula(kernel: Kernel) -> str:
    """The pieces in the grammar of `sphtrunc.kernel`, which reads them back.

    >>> formula(named("spiky"))
    '0..2: 8 - 12*q + 6*q^2 - q^3'
    """
    parts = []
    for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.coefficients(), strict=False):
        text = ""
        for n, c in enumerate(piece):
            if not c and len(piece) > 1:
                continue
            size = "*".join(
                ([str(abs(c))] if abs(c) != 1 or not n else [])
                + ([f"q^{n}" if n > 1 else "q"] if n else [])
            )
            sign = "-" if c < 0 else "+"
            text += f" {sign} {size}" if text else size if c >= 0 else f"-{size}"
        parts.append(f"{a}..{b}: {text}")
    return "; ".join(parts)


def constants_section(kernel: Kernel) -> str:
    """What follows from the pieces, exactly, in one, two and three dimensions."""
    rows = [[label, *(_tex(of(kernel, dim)) for dim in DIMS)] for label, of in CONSTANTS.items()]
    rows.append(["$2\\sigma/h$, which some codes call h", *(_two_sigma(kernel, d) for d in DIMS)])
    width = float(2 * half_width(kernel))
    rows.append(["full width at half maximum$/h$", *[f"{width:.9g}" if width else "none"] * 3])
    return f"## Constants\n\n{table(('', '1D', '2D', '3D'), rows)}"


#: what a row of the table of constants says -> the exact number
CONSTANTS: dict[str, Callable[[Kernel, int], Any]] = {
    "$\\sigma$, the constant of the shape above": lambda k, d: k.normalisation(d),
    "$\\hat W(0)$": lambda k, d: k.normalisation(d) * k.central(),
    **{
        f"$R_{n} = \\int s^{n} \\hat W\\, d^d s$": lambda k, d, n=n: k.moment(n, d)
        for n in (1, 2, 4, 6, 8)
    },
    "$c$ of the smoothing error $c\\, h^2 \\nabla^2 A$": lambda k, d: k.moment(2, d) / (2 * d),
}


def knots_section(kernel: Kernel) -> str:
    """Where it is not smooth: the first derivative that jumps, at every knot."""
    rows = []
    for knot, smooth in kernel.knot_smoothness().items():
        kind = ORIGIN if knot == 0 else EDGE if knot == kernel.support else INTERIOR
        if smooth == float("inf"):
            rows.append([f"{knot}", kind, "all", "", ""])
        else:
            first = int(smooth) + 1
            jump = kernel.jumps(first)[knot]
            rows.append([f"{knot}", kind, f"{smooth}", f"{first}", _tex(jump)])
    head = ("knot $q$", "", "continuous derivatives", "first that jumps", "its jump in 1D")
    return (
        "## Smoothness\n\n"
        f"$\\beta$ = {kernel.boundary_smoothness} at the edge of the support,"
        f" {kernel.smoothness} over all knots: the least smooth of them limits the order of a sum"
        f" over particles. −1 is a jump of the kernel itself.\n\n{table(head, rows)}"
    )


def transform_section(kernel: Kernel) -> str:
    """F(k): its series, how it decays, and what it costs a wave."""
    series = [[f"{d}D", *(_tex(_coefficient(kernel, d, n)) for n in (1, 2, 3, 4))] for d in DIMS]
    decay = [f"{d}D as $k^{{-{min(a for _, a in terms(kernel, d))}}}$" for d in (1, 3)]
    costs = []
    for text in WAVES:
        k = [2 * pi * float(Fraction(text))]
        costs.append(
            [_decimal(text), *(f"{float(smoothing_error(kernel, k, d)[0]):.4g}" for d in DIMS)]
        )
    return "\n\n".join(
        [
            "## Fourier transform",
            "$F(k) = \\int \\hat W e^{-i k\\cdot s}\\, d^d s = 1 + f_1 k^2 + f_2 k^4 + \\dots$"
            f" with $k$ in units of $1/h$; for large $k$ it falls in {' and in '.join(decay)}.",
            table(("", "$f_1$", "$f_2$", "$f_3$", "$f_4$"), series),
            "What smoothing takes from a wave of length $\\lambda$, the part $1 - F$ of value and"
            " gradient:",
            table(("$h/\\lambda$", "1D", "2D", "3D"), costs),
        ]
    )


def lattice_section(lattice: dict[tuple[int, str], list[float]]) -> str:
    """M₁ − 1: how wrong the gradient of a straight line is on uniform particles."""
    rows = [
        [f"{dim}D {kind}", *(_signed(error) for error in errors)]
        for (dim, kind), errors in lattice.items()
    ]
    head = ("$h/\\Delta x$", *(_decimal(str(r)) for r in RATIOS))
    return (
        "## On lattices\n\n"
        "The relative error of the standard gradient of a straight line, $M_1 - 1$: no refinement"
        " at constant $h/\\Delta x$ removes it. Empty where the support holds no neighbour, or more"
        f" than {MOST_NEIGHBOURS}.\n\n" + table(head, rows)
    )


def floats_section(name: str) -> str:
    """What was recorded of its floats."""
    rows = []
    for function, meaning in (("w", "W"), ("dw", "W′"), ("d2w", "W″")):
        for dtype in ("float64", "float32"):
            worst = [ulps()[name, str(d), dtype, function] for d in DIMS]
            rows.append([meaning, dtype, *(f"{float(x):.3g}" for x in worst)])
    return (
        "## In floating point\n\n"
        "The largest error against exact rational arithmetic, recorded with"
        " `tests/kernels/ulp_table.py`: of W in units in the last place, of W′ and W″ in units of"
        " the machine precision times the sum of the absolute terms of the polynomial.\n\n"
        + table(("", "precision", "1D", "2D", "3D"), rows)
    )


def users_section(kernel: Kernel) -> str:
    """Who uses it, as far as it was audited, and what they call h."""
    met: dict[tuple[str, str, str], list[str]] = {}
    for subject, dim, name, support in audited():
        if kernels().get(name) == kernel:
            theirs = _their_h(kernel, int(dim), support)
            met.setdefault((subject, support, theirs), []).append(f"{dim}D")
    said = {
        name: f"{CONVENTIONS[name].says}: {_linked(CONVENTIONS[name].who)}"
        for name in ("h", "support", "two-sigma", "fwhm")
    }
    names_of_h = [
        ["h", *["1"] * 3, said["h"]],
        ["support", *[str(kernel.support)] * 3, said["support"]],
    ]
    names_of_h.append(["two-sigma", *(_two_sigma(kernel, d) for d in DIMS), said["two-sigma"]])
    width = float(2 * half_width(kernel))
    if width:
        names_of_h.append(["fwhm", *[f"{width:.9g}"] * 3, said["fwhm"]])
    parts = [
        "## Who uses it, and what they call h",
        "A code that says h may mean any of these lengths, given in units of the h of this page;"
        " [`sphtrunc convert`](../../guide/convert.md) turns one into another.",
        table(("name", "1D", "2D", "3D", "what it is, where it is met"), names_of_h),
    ]
    if met:
        rows = [
            [subject, ", ".join(dims), support, theirs]
            for (subject, support, theirs), dims in met.items()
        ]
        parts += [
            "In the [audit of public codes](../verification.md):",
            table(("code and version", "dimensions", "support", "its h is"), rows),
        ]
    return "\n\n".join(parts)


# ----------------------------------------------------------------------------------------- the data


def lattice_errors(kernel: Kernel) -> dict[tuple[int, str], list[float]]:
    """(dim, lattice) -> M₁ − 1 at every h/Δx of RATIOS, NaN for none or too many neighbours."""
    found = {}
    for dim, kind in LATTICES:
        errors = []
        for ratio in RATIOS:
            if BALL[dim] * float(kernel.support * ratio) ** dim > MOST_NEIGHBOURS:
                errors.append(float("nan"))
                continue
            try:
                derived = derive(
                    kernel, dim=dim, degree=1, dx_over_h=1 / ratio, lattice=_kind(kind)
                )
            except ValueError:
                errors.append(float("nan"))
                continue
            assert derived.discrete is not None
            errors.append(float(derived.discrete.error[(1,) + (0,) * (dim - 1)]))
        found[dim, kind] = errors
    return found


def _kind(kind: str) -> str | None:
    return None if kind == "uniform" else kind


def _coefficient(kernel: Kernel, dim: int, n: int) -> Any:
    """f_n = (−1)ⁿ R_{2n}/(2ⁿ n! d(d+2)…(d+2n−2)) of F = Σ f_n k^{2n}."""
    ladder = 1
    for j in range(n):
        ladder *= 2 * (j + 1) * (dim + 2 * j)
    return (-1) ** n * kernel.moment(2 * n, dim) / ladder


@lru_cache(maxsize=1)
def ulps() -> dict[tuple[str, str, str, str], str]:
    """(kernel, dim, precision, function) -> largest error, as it was recorded."""
    with open(ROOT / "tests/kernels/ulp.csv", encoding="utf-8", newline="") as file:
        return {
            (r["kernel"], r["dim"], r["dtype"], r["function"]): r["max"]
            for r in csv.DictReader(file)
        }


@lru_cache(maxsize=1)
def audited() -> list[tuple[str, str, str, str]]:
    """(subject, dim, kernel, support) of every row of notebooks/verification.md."""
    text = (ROOT / "notebooks/verification.md").read_text(encoding="utf-8")
    found = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) == 6 and re.fullmatch("[123]", cells[1]):
            found.append((cells[0], cells[1], cells[2], cells[3]))
    return found


@lru_cache(maxsize=1)
def kernels() -> dict[str, Kernel]:
    """The catalogue, made once."""
    return {name: named(name) for name in names()}


def _their_h(kernel: Kernel, dim: int, support: str) -> str:
    """The name of the length that a code calls h whose support is `support`, in its own h."""
    with suppress(ValueError):
        theirs = float(kernel.support) / float(support.removesuffix(" h"))
        known = {name: float(length) for name, length in lengths(kernel, dim).items()}
        known["fwhm"] = float(2 * half_width(kernel))
        for name, length in known.items():
            if abs(theirs - length) < 1e-6 * theirs:
                return name
        return f"{theirs:.7g} h"
    return ""


# ----------------------------------------------------------------------------------------- pictures


def draw(kernel: Kernel, lattice: dict[tuple[int, str], list[float]], path: Path) -> None:
    """The shape with two derivatives, |F|, 1 − F and M₁ − 1, as SVG; always the same bytes."""
    from matplotlib import rc_context

    from sphtrunc.figures import picture as pictures

    s = np.linspace(0.0, float(kernel.support), 241)
    shapes = []
    for label, values in (("W", kernel.w(s)), ("W′", kernel.dw(s)), ("W″", kernel.d2w(s))):
        largest = float(np.abs(values).max())
        if largest:
            shapes.append(pictures.predicted(f"{label} / {largest:.4g}", s, values / largest))
    k = np.linspace(0.0, 12 * pi, 481)
    spectra = [pictures.predicted(f"{d}D", k / pi, np.abs(transform(kernel, k, d))) for d in DIMS]
    ratios = np.array([float(r) for r in RATIOS])
    errors = [
        pictures.Curve(f"{dim}D {kind}", pictures.MEASURED, ratios, np.abs(np.array(values)))
        for (dim, kind), values in lattice.items()
    ]
    waves = np.geomspace(0.005, 0.5, 81)
    costs = [
        pictures.predicted(f"{d}D", waves, np.abs(smoothing_error(kernel, 2 * pi * waves, d)))
        for d in DIMS
    ]
    panels = (
        pictures.Panel("$q = r/h$", "in 1D, each / its largest", tuple(shapes), "", *LINEAR),
        pictures.Panel(r"$kh/\pi$", "$|F(kh)|$", tuple(spectra), "", *SEMILOG, (1e-9, 2.0)),
        pictures.Panel(r"$h/\lambda$", "smoothing error $|1 - F|$", tuple(costs)),
        pictures.Panel(r"$h/\Delta x$", "$|M_1 - 1|$ on lattices", tuple(errors), "", *SEMILOG),
    )
    figure = pictures.draw(pictures.Picture("", kernel.name, panels, note=" "))
    figure.set_layout_engine(None)  # the places of four panels are known
    figure.subplots_adjust(0.07, 0.065, 0.99, 0.94, wspace=0.16, hspace=0.19)
    with rc_context({"svg.hashsalt": kernel.name, "svg.fonttype": "path"}):
        figure.savefig(path, format="svg", metadata={"Date": None})


# ------------------------------------------------------------------------------------------ writing


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; columns of short entries, which are numbers, to the right."""
    lines = [list(head), *map(list, rows)]
    wide = [max(len(line[i]) for line in lines[1:]) > 30 for i in range(len(lines[0]))]
    lines.insert(1, ["---" if i == 0 or far else "--:" for i, far in enumerate(wide)])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _tex(value: Any) -> str:
    """An exact number where it is short, else its first fifteen digits."""
    return f"${latex(value)}$" if len(str(value)) <= 24 else f"≈ {float(value):.15g}"


def _polynomial(coefficients: Iterable[Any]) -> str:
    """Σ c_n qⁿ in TeX, lowest power first."""
    text = ""
    for n, c in enumerate(coefficients):
        if c:
            power = f"q^{{{n}}}" if n > 1 else "q" if n else ""
            size = "" if abs(c) == 1 and n else latex(abs(c))
            text += f"{'-' if c < 0 else '+' if text else ''} {size} {power}"
    return text.strip() or "0"


def _two_sigma(kernel: Kernel, dim: int) -> str:
    exact = lengths(kernel, dim).get("two-sigma")
    return "none" if exact is None else f"{float(exact):.9g}"


def _h(length: Any) -> str:
    return f"${length}\\,h$" if length != 1 else "$h$"


def _decimal(text: str) -> str:
    return f"{float(Fraction(text)):g}"


def _signed(value: float) -> str:
    if value != value:
        return ""
    return f"{value:+.2e}".replace("-", "−") if value else "0"


def _linked(source: str) -> str:
    """DOIs as links."""
    return re.sub(r"doi:(\S+?)(?=[;,]|\s|$)", r"[doi:\1](https://doi.org/\1)", source)
