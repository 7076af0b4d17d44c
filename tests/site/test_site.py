"""The site's own code: the constants on every kernel's page, its table, docstrings, links.

The site itself is built by .ci/run, with warnings as errors, and its links are read there.
"""

from __future__ import annotations

import doctest
import inspect
import re
import sys
from importlib import import_module
from itertools import product
from math import isclose, pi
from pathlib import Path

import pytest
from click.testing import CliRunner
from mpmath import mp, mpf
from mpmath.calculus.quadrature import GaussLegendre
from oracle import horner, shape_of

import sphtrunc
from sphtrunc.cli import COMMANDS
from sphtrunc.cli.kernels import command
from sphtrunc.kernels.catalogue import named, names

ROOT = Path(__file__).parents[2]
SITE = ROOT / "notebooks" / "site"
sys.path.insert(0, str(SITE))

import docstrings  # noqa: E402
import formulas  # noqa: E402
import kernel_pages  # noqa: E402
import links  # noqa: E402

# ------------------------------------------------------------------------------- pages of kernels

_CELL = re.compile(r"\$(-?) ?(?:\\frac\{(\d+)\}\{(\d*) ?(\\pi)?\}|(\d+))\$")


def number(cell: str) -> mpf:
    """What a cell of a table says: a fraction, perhaps over π, an integer or digits."""
    if found := _CELL.fullmatch(cell):
        sign, top, bottom, over_pi, whole = found.groups()
        value = mpf(whole) if whole else mpf(top) / (mpf(bottom or 1) * (mp.pi if over_pi else 1))
        return -value if sign else value
    return mpf(cell.removeprefix("≈ "))


def rows(section: str) -> list[list[str]]:
    """The cells of every row of the tables of a section, without their heads."""
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    rules = [i for i, line in enumerate(cells) if line[0] == "---"]
    return [line for i, line in enumerate(cells) if i not in rules and i + 1 not in rules]


def nodes(kernel: sphtrunc.Kernel) -> list[tuple[mpf, mpf]]:
    """(q, weight × w(q)) of a Gauss-Legendre rule between all knots, exact up to degree 95."""
    table = GaussLegendre(mp).calc_nodes(5, mp.prec)
    shape = shape_of(kernel)
    found = []
    for a, b, piece in zip(shape.knots, shape.knots[1:], shape.pieces, strict=False):
        middle, half = exact(a + b) / 2, exact(b - a) / 2
        coefficients = [exact(c) for c in piece]
        for x, weight in table:
            q = middle + half * x
            found.append((q, half * weight * horner(coefficients, q)))
    return found


@pytest.mark.parametrize("name", names())
def test_constants_of_a_page_are_those_of_an_independent_integration(name):
    """σ, Ŵ(0), R_n, c, 2σ, the width at half maximum, the series of F, and F, by mpmath."""
    kernel = named(name)
    with mp.workdps(60):  # wide splines cancel: some twenty digits are lost
        rule = nodes(kernel)
        central = exact(shape_of(kernel).pieces[0][0])
        printed = rows(kernel_pages.constants_section(kernel))
        series = {row[0]: row[1:] for row in rows(kernel_pages.transform_section(kernel))}
        for dim in (1, 2, 3):
            mass = sum(v * q ** (dim - 1) for q, v in rule)

            def moment(n, dim=dim, mass=mass):
                return sum(v * q ** (n + dim - 1) for q, v in rule) / mass

            sigma = 1 / (SPHERE[dim]() * mass)
            wanted = [sigma, sigma * central, *(moment(n) for n in (1, 2, 4, 6, 8))]
            wanted += [moment(2) / (2 * dim), 2 * mp.sqrt(moment(2) / dim)]
            for row, value in zip(printed, wanted, strict=False):
                assert agrees(row[dim], value), (row[0], dim, row[dim], value)
            ladder = mpf(1)
            for n in (1, 2, 3, 4):
                ladder *= -mpf(2 * n * (dim + 2 * n - 2))
                assert agrees(series[f"{dim}D"][n - 1], moment(2 * n) / ladder), (dim, n)
            for wave in ("0.02", "0.05", "0.1", "0.2"):
                k = 2 * mp.pi * mpf(wave)
                with mp.workdps(20):
                    f = sum(v * q ** (dim - 1) * WAVE[dim](k * q) for q, v in rule) / mass
                assert mp.almosteq(mpf(series[wave][dim - 1]), 1 - f, rel_eps=5.1e-4), (wave, dim)
        width = printed[-1][1]
        if width != "none":
            half = mpf(width) / 2
            below, above = (value_at(kernel, half * (1 + e)) for e in (mpf("1e-8"), -mpf("1e-8")))
            assert below < central / 2 < above


def exact(x: object) -> mpf:
    return mpf(x.numerator) / x.denominator


def agrees(cell: str, value: mpf) -> bool:
    """To all digits that are shown: fractions entirely, decimals to half of their last one."""
    if cell.startswith("$"):
        return mp.almosteq(number(cell), value, rel_eps=mpf(10) ** -27)
    digits = len(cell.removeprefix("≈ ").split("e")[0].replace(".", "").lstrip("0-"))
    return abs(number(cell) - value) <= abs(value) * mpf(10) ** (1 - max(digits, 8)) / 2 * 1.01


def value_at(kernel: sphtrunc.Kernel, q: mpf) -> mpf:
    shape = shape_of(kernel)
    for b, piece in zip(shape.knots[1:], shape.pieces, strict=True):
        if q <= exact(b):
            return horner([exact(c) for c in piece], q)
    return mpf(0)


SPHERE = {1: lambda: mpf(2), 2: lambda: 2 * mp.pi, 3: lambda: 4 * mp.pi}
WAVE = {1: mp.cos, 2: lambda x: mp.besselj(0, x), 3: mp.sinc}


def test_a_wrong_constant_would_be_seen():
    """The comparison is sharp: a fraction off by one in its numerator, a digit off by one."""
    with mp.workdps(30):
        assert agrees(r"$\frac{31}{49}$", mpf(31) / 49)
        assert not agrees(r"$\frac{31}{49}$", mpf(31000001) / 49000000)
        assert agrees("1.44470345", mpf("1.444703448"))
        assert not agrees("1.44470346", mpf("1.444703448"))
        assert agrees(r"$\frac{10}{7 \pi}$", 10 / (7 * mp.pi))
        assert not agrees(r"$- \frac{1}{6}$", mpf(1) / 6)


@pytest.mark.parametrize("name", names())
def test_the_commands_of_a_page_are_about_its_kernel(name):
    """By name and by pieces, but for one whose pieces are longer than what is read."""
    section = kernel_pages.shape_section(named(name))
    given = re.findall(r"--kernel (?:'([^']+)'|(\S+))", section)
    assert len(given) == 2 - (name == "b-spline:19")
    for pieces, called in given:
        assert sphtrunc.kernel(pieces or called) == named(name)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_table_is_that_of_the_command(dim):
    printed = CliRunner().invoke(command, ["--dim", str(dim)]).output.splitlines()[1:]
    shown = kernel_pages.catalogue().partition(f"{{tab-item}} {dim}D")[2].partition(":::")[0]
    cells = [line[2:-2].split(" | ") for line in shown.splitlines() if line.startswith("| ")]
    cells = [[re.sub(r"\[(.*)\]\(.*\)", r"\1", cell) for cell in row] for row in cells]
    del cells[1]  # the rule below the head
    assert cells == [re.split(r"\s{2,}|(?<=\S) (?=β)", line.strip()) for line in printed]


def test_addresses_differ():
    assert len({kernel_pages.slug(name) for name in names()}) == len(names())


def test_the_error_on_a_lattice_is_that_of_a_plain_sum():
    """M₁ of Σ −s ∂Ŵ/∂s V on fcc from its unit cell, cubic spline, h = 1.2 Δx."""
    found = kernel_pages.lattice_errors(named("cubic-spline"))[3, "fcc"][1]
    h, cell = 1.2, 4 ** (1 / 3)  # Δx = 1: a cube of side 4^(1/3) holds four particles
    total = 0.0
    for i, j, k in product(range(-3, 4), repeat=3):
        for u, v, w in ((0, 0, 0), (0, 0.5, 0.5), (0.5, 0, 0.5), (0.5, 0.5, 0)):
            x, y, z = (cell * (a + b) / h for a, b in ((i, u), (j, v), (k, w)))
            q = (x * x + y * y + z * z) ** 0.5
            if 0 < q < 2:
                slope = -3 * q + 2.25 * q * q if q < 1 else -0.75 * (2 - q) ** 2
                total -= x * x / q * slope / pi / h**3
    assert isclose(total - 1, found, abs_tol=1e-13)


def test_users_and_their_h():
    cubic = kernel_pages.users_section(named("cubic-spline"))
    assert re.search(r"FleCSPH .* \| 1D, 2D, 3D \| 1 h \| support \|", cubic)
    assert re.search(r"astromartini .* \| 3D \| 1.384367 h \| fwhm \|", cubic)
    assert "In the [audit" not in kernel_pages.users_section(named("b-spline:19"))


# ---------------------------------------------------------------------------------------- the API


def documented() -> list[tuple[str, object]]:
    """Every object that a page of the API names, with the members of the classes."""
    found = []
    for page in sorted((SITE / "api").glob("*.md")):
        for name in re.findall(r"auto(?:function|class):: (\S+)", page.read_text("utf-8")):
            module, _, attribute = name.rpartition(".")
            found.append((name, getattr(import_module(module), attribute)))
    for name, thing in list(found):
        if inspect.isclass(thing):
            for key, member in vars(thing).items():
                if not key.startswith("_") and getattr(member, "__doc__", None):
                    found.append((f"{name}.{key}", member))
    return found


def test_every_public_name_has_a_place():
    names_there = {name for name, _ in documented()}
    assert {f"sphtrunc.{n}" for n in sphtrunc.__all__ if n != "__version__"} <= names_there


def test_no_word_of_a_docstring_is_lost_and_every_formula_is_known():
    seen = 0
    for name, thing in documented():
        text = inspect.getdoc(thing) or ""
        pieces = formulas.islands(text)
        assert "".join(piece for _, piece in pieces) == text, name
        for is_formula, piece in pieces:
            if is_formula:
                assert formulas.tex(piece).isascii(), (name, piece)
                seen += 1
    assert seen > 100


def test_arguments_become_a_table():
    lines = (inspect.getdoc(sphtrunc.measure) or "").splitlines()
    docstrings.process(None, "function", "measure", sphtrunc.measure, None, lines)
    text = "\n".join(lines)
    for name in inspect.signature(sphtrunc.measure).parameters:
        assert f"``{name}``" in text
    assert ":math:`M_\\alpha`" in text
    assert "**Raises** ValueError" in text


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("∫ |s|ⁿ⁻¹ s·∇Ŵ d^d s", r"\int  |s|^{n-1} s\cdot \nabla \hat W  d^d s"),
        ("√(1 + 1/z)", r"\sqrt{1 + 1/z}"),
        ("M_α^exact", r"M_\alpha ^{\mathrm{exact}}"),
    ],
)
def test_a_formula_in_tex(text, wanted):
    assert formulas.tex(text) == wanted


def test_a_sign_that_is_not_known_is_refused():
    with pytest.raises(ValueError, match="no TeX for ℵ"):
        formulas.tex("ℵ = 1")


# ---------------------------------------------------------------------------------------- the pages


def test_twenty_questions_with_a_command_each():
    questions = (SITE / "how-do-i.md").read_text("utf-8").split("\n## ")[1:]
    assert len(questions) >= 20
    for question in questions:
        assert question.partition("\n")[0].endswith("?")
        assert re.search(r"^(\$ )?sphtrunc ", question, flags=re.MULTILINE), question


def test_every_command_and_notebook_is_on_the_site():
    guide = (SITE / "guide.md").read_text("utf-8")
    assert sorted(re.findall(r"^\.\./guide/(\S+)$", guide, re.MULTILINE)) == sorted(COMMANDS)
    listed = (SITE / "notebooks.md").read_text("utf-8")
    notebooks = {path.stem for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert {*re.findall(r"^\.\./(\S+)$", listed, re.MULTILINE), "errata"} == notebooks


def test_the_front_page_leads_to_error_command_and_explanation_in_one_click():
    text = (ROOT / "notebooks" / "index.md").read_text("utf-8")
    error, command, explanation = re.findall(r"^:link: (.*)$", text, re.MULTILINE)
    assert error.startswith("explorer.html#kernel=cubic-spline&")
    for page in (command, explanation):
        assert (ROOT / "notebooks" / f"{page}.md").is_file()


def test_what_contributing_names_is_there():
    text = (SITE / "contributing.md").read_text("utf-8")
    paths = re.findall(r"`((?:sphtrunc|tests|notebooks)/[\w./-]+|\.ci/run)`", text)
    assert len(paths) > 8
    for path in paths:
        assert (ROOT / path).exists() or "NAME" in path, path


@pytest.mark.parametrize("module", [formulas, kernel_pages])
def test_examples_in_docstrings(module):
    ran = doctest.testmod(module)
    assert ran.failed == 0
    assert ran.attempted >= 2


def test_links_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "style.css").write_text("@font-face { src: url(font.woff2) }", encoding="utf-8")
    (tmp_path / "index.html").write_text(
        '<link rel="stylesheet" href="style.css"><a href="a/b.html#here">x</a>'
        '<a href="https://doi.org/10.1002/nme.1617">y</a><a href="#top">z</a><h1 id="top"></h1>',
        encoding="utf-8",
    )
    (tmp_path / "a" / "b.html").write_text(
        '<p id="here"></p><a href="../index.html#there">x</a><a href="c.html">y</a>'
        '<script src="https://cdn.example.org/x.js"></script><a href="javascript:x()">z</a>',
        encoding="utf-8",
    )
    assert list(links.broken(tmp_path)) == [
        "a/b.html: ../index.html#there: no such anchor",
        "a/b.html: c.html: no such file",
        "a/b.html: javascript:x(): an address of no known kind",
        "a/b.html loads https://cdn.example.org/x.js: it is on another host",
        "style.css loads font.woff2: no such file",
    ]
    assert links.main(str(tmp_path)) == 1


def test_a_folder_without_pages_is_no_site(tmp_path):
    assert list(links.broken(tmp_path)) == [f"{tmp_path}: no page in it"]
