"""Texts and files to kernels: spellings that work, and 50,000 that must not do anything else."""

from __future__ import annotations

import json
import os
import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import FRAGMENTS, hostile_texts, shapes

from sphtrunc import Kernel, kernel
from sphtrunc.kernels.parse import (
    MAX_BITS,
    MAX_DEGREE,
    MAX_DIGITS,
    MAX_FILE,
    MAX_LENGTH,
    MAX_NESTING,
    MAX_PIECES,
)

# -- nothing is executed: Python reports what it does to an audit hook -----------------------------

_SEEN: list[str] = []
_WATCHING = False
_FORBIDDEN = ("exec", "compile", "import", "open", "os.", "subprocess.", "socket.", "ctypes.")


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if _WATCHING and event.startswith(_FORBIDDEN):
        _SEEN.append(f"{event} {arguments!r:.100}")


sys.addaudithook(_audit)


@contextmanager
def nothing_happens() -> Iterator[None]:
    """Fails if anything is compiled, executed, imported or opened inside."""
    global _WATCHING
    for text in ("cubic-splin", "0..1: q)", "pos(1-q)", "no-such-file.toml", "x" * 5000):
        outcome(text)  # imports what errors need
    _SEEN.clear()
    _WATCHING = True
    try:
        yield
    finally:
        _WATCHING = False
    assert _SEEN == []


def outcome(text: str) -> Kernel | str:
    """The kernel, or the message of the ValueError; any other exception passes through."""
    try:
        return kernel(text)
    except ValueError as error:
        return str(error) if type(error) is ValueError else f"{type(error).__name__}\n{error}"


#: how each message tells its reader what to do
ADVICE = ("expected", "write", "did you mean", "made of", "takes", "is not in the catalogue")


def check_message(message: str) -> None:
    assert len(message.splitlines()) == 1
    assert len(message) < 400
    assert any(word in message for word in (*ADVICE, "lists them all")), message


def test_the_hook_sees(tmp_path: Path) -> None:
    """It would notice: an eval, and the file that is opened on purpose."""
    with pytest.raises(AssertionError), nothing_happens():
        eval("1 + 1")
    file = tmp_path / "k.toml"
    file.write_text('knots = [0, 1]\npieces = ["1"]')
    with pytest.raises(AssertionError), nothing_happens():
        kernel(str(file))


# -- spellings -------------------------------------------------------------------------------------

CUBIC = [
    "0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4",
    "0..1: 1 - 3/2*q**2 + 3/4*q**3; 1..2: (2-q)**3/4;",
    "0..1:1-1.5*q^2+.75*q^3;1..2:.25*(2-q)^3",
    "0..2/2 : 1 - 3*q*q/2 + 3*q*q*q/4 ; 1..6/3 : (2 - q)*(2 - q)^2/4",
    "0 .. 1: +1 - -3/2 * -q^2 - -(3/4)*q^3;\n\t1 .. 2: -(q-2)^3/4",
    "pos(2-q)^3/4 - pos(1-q)^3",
    "1/4*(pos(2-q)^3 - 4*pos(1-q)^3)",
    "pos(1-q/2)^3*2 - pos(1-q)^3",
    "0.25*pos(2-q)^2*pos(2-q) - 1.0*pos(1-q)**3",
    "  0..1: (4 - 6*q^2 + 3*q^3)/4; 1..3/2: (2-q)^3/4; 3/2..2: (8-12*q+6*q^2-q^3)/4; 2..5: 0 ",
]


@pytest.mark.parametrize("text", CUBIC)
def test_the_cubic_spline_in_many_spellings(text: str) -> None:
    assert kernel(text) == kernel("cubic-spline")


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("0..2: (1-q/2)^4*(1+2*q)", "wendland-c2"),
        ("0..2: (4-q^2)^5", "polynomial:4"),
        ("0..2: 1", "polynomial:-1"),
        ("pos(2-q)^2", "johnson-quadratic"),
        ("pos(5/2-q)^4 - 5*pos(3/2-q)^4 + 10*pos(1/2-q)^4", "quartic-spline"),
        ("pos(3-q)^5 - 6*pos(2-q)^5 + 15*pos(1-q)^5", "quintic-spline"),
        ("pos(1-q)", "b-spline:2"),
        ("0..1: 6-6*q+q^3; 1..2: (2-q)^3", "hyperbolic"),
        ("0..2/3: 11/9-q; 2/3..1: 1-3/2*q^2+3/4*q^3; 1..2: (2-q)^3/4", "core-triangle"),
    ],
)
def test_formulas_of_the_catalogue(text: str, name: str) -> None:
    assert kernel(text) == kernel(name)


def test_thirds_are_exact() -> None:
    k = kernel("0..1/3: 1/3 + 0.1*q; 1/3..0.7: 2/7")
    assert k == Kernel(["0", "1/3", "7/10"], [["1/3", "1/10"], ["2/7"]])


def test_pos_may_grow_and_multiply() -> None:
    """pos of either slope, and a hole in the middle."""
    k = kernel("pos(q-1)*pos(2-q)")
    assert k == kernel("0..1: 0; 1..2: (q-1)*(2-q)")


@given(shapes())
def test_every_kernel_can_be_written(shape: tuple[list[Fraction], list[list[Fraction]]]) -> None:
    """str → Kernel, from coefficients that are printed here."""
    knots, pieces = shape
    text = "; ".join(
        f"{a}..{b}: " + " + ".join(f"({c})*q^{i}" for i, c in enumerate(piece))
        for a, b, piece in zip(knots, knots[1:], pieces, strict=False)
    )
    assert kernel(text) == Kernel(knots, pieces)


def test_a_kernel_passes_through() -> None:
    k = Kernel([0, 1], [[1]])
    assert kernel(k) is k


@pytest.mark.parametrize("spec", [None, 3, 1.5, b"cubic-spline", ["cubic-spline"], Path("a.toml")])
def test_other_types(spec: Any) -> None:
    with pytest.raises(ValueError, match="expected a Kernel or a text"):
        kernel(spec)


# -- refusals, each with its own message -----------------------------------------------------------

REFUSALS = [
    ("", "empty text"),
    ("   \n", "empty text"),
    ("0..1: 1 - q; 3/2..2: 1", "ends at 1 and the next starts at 3/2"),
    ("0..2: q; 1..3: q", "ends at 2 and the next starts at 1"),
    ("1..2: q", "first of them 0"),
    ("-1..1: 1", "first of them 0"),
    ("0..-1: 1", "increasing"),
    ("0..0: 1", "increasing"),
    ("0..1: 0", "every piece is zero"),
    ("0..q: 1", "a knot contains q"),
    ("q^2", "must say where it ends"),
    ("1", "must say where it ends"),
    ("(2-q)^3", "must say where it ends"),
    ("pos(2-q) + 1", "does not vanish beyond its last knot 2"),
    ("pos(q-2)", "does not vanish beyond"),
    ("pos(2-q)^0", "does not vanish beyond"),
    ("pos(4-q^2)", "linear in q"),
    ("pos(3)", "linear in q"),
    ("pos(pos(2-q))", "expected a polynomial there"),
    ("0..1: pos(1-q)", "expected a polynomial there"),
    ("0..1: 1/q", "division by an expression in q"),
    ("0..1: 1/(q-q)", "division by zero"),
    ("0..1/0: 1", "division by zero"),
    ("0..1: q^65", "exponent 65"),
    ("0..1: q^-1", "unexpected"),
    ("0..1: q^(2)", "unexpected"),
    ("0..1: q^1.5", "unexpected"),
    ("0..1: q^2^3", "unexpected"),
    ("0..1: q**(10**9)", "unexpected"),
    ("0..1: q^99999999999999999999", "exponent 99999999999999999999"),
    ("0..1: 9**9**9", "unexpected"),
    ("0..1: (q^8)^9", f"degree 72, expected at most {MAX_DEGREE}"),
    ("0..1: q^40*q^40", f"degree 80, expected at most {MAX_DEGREE}"),
    ("0..1: ((9^64)^64)", f"at most {MAX_BITS} bits"),
    ("0..1: 1/((9^64)^64)", f"at most {MAX_BITS} bits"),
    ("0..1: " + "9" * (MAX_DIGITS + 1), f"{MAX_DIGITS + 1} digits"),
    ("0..1: " + "q+" * MAX_LENGTH + "q", f"characters, expected at most {MAX_LENGTH}"),
    ("0..1: " + "(" * (MAX_NESTING + 1) + "q" + ")" * (MAX_NESTING + 1), "nested parentheses"),
    ("0..1: " + "(" * 2000, "2000 nested parentheses"),
    (";".join(f"{i}..{i + 1}: q^{i}" for i in range(MAX_PIECES + 1)), f"at most {MAX_PIECES}"),
    ("+".join(f"pos({i}-q)" for i in range(1, MAX_PIECES + 2)), f"at most {MAX_PIECES}"),
    ("0..1: λ", "U+03BB"),
    ("0..１: 1", "U+FF11"),
    ("0..1: q²", "U+00B2"),
    ("0..1: 1−q", "U+2212"),
    ("0..1: 1e3", "unexpected"),
    ("0..1: 0x10", "unexpected"),
    ("0..1: 1_0", "unexpected"),
    ("0..1: 2q", "unexpected"),
    ("0..1: (1-q", "at the end"),
    ("0..1: 1-q)", "unexpected"),
    ("0..1: 1-", "at the end"),
    ("0..1:", "at the end"),
    ("0..1", "at the end"),
    ("0..", "at the end"),
    ("..", "unexpected"),
    ("pos", "at the end"),
    ("pos(", "at the end"),
    ("cubic spline", "did you mean cubic-spline"),
    ("cubic-splin", "did you mean cubic-spline"),
    ("Wendland C2", "did you mean wendland-c2"),
    ("gauss", "lists them all"),
    ("no-such-file.toml", "No such file"),
    ("\x00.toml", "null"),
    ("x" * 1000 + ".json", "too long"),
]


@pytest.mark.parametrize(("text", "hint"), REFUSALS)
def test_refusals(text: str, hint: str) -> None:
    with nothing_happens():
        message = outcome(text)
    assert isinstance(message, str)
    assert hint in message
    check_message(message)


@pytest.mark.parametrize(
    "text",
    [
        "0..1: " + "+".join(["q"] * 2000),
        "0..1: " + "(" * MAX_NESTING + "q" + ")" * MAX_NESTING,
        "0..1: " + "-" * 4000 + "q",
        "0..1: q^64",
        "0..1: " + "9" * MAX_DIGITS,
        ";".join(f"{i}..{i + 1}: q^{i}" for i in range(MAX_PIECES)),
        "+".join(f"pos({1 + i % MAX_PIECES}-q)^63" for i in range(240)),
    ],
)
def test_the_largest_that_is_allowed(text: str) -> None:
    assert isinstance(kernel(text), Kernel)


# -- hostility -------------------------------------------------------------------------------------

_CODE = [
    "__import__('os').system('touch /tmp/owned')",
    "__import__('subprocess').run(['id'])",
    "exec('import os')",
    "eval('1')",
    "open('/etc/passwd').read()",
    "().__class__.__bases__[0].__subclasses__()",
    "q.__class__",
    "q.diff()",
    "Symbol('q')",
    "Integer(2)**q",
    "lambda q: q",
    "[q for q in range(10**9)]",
    "f'{q}'",
    "{q}",
    "print(1)",
    "import os",
    "os.system('id')",
    "globals()",
    "getattr(q, 'name')",
    "compile('1', '', 'eval')",
    "sin(q)",
    "exp(-q^2)",
    "sqrt(2)",
    "pi",
    "oo",
    "nan",
    "inf",
    "I",
    "E",
    "Piecewise((1, q<1))",
    "9**9**9",
    "9^9^9^9^9",
    "q**(10**9)",
    "(q+1)^64*(q+1)",
    "((((q+1)^64)^64)^64)^64",
    "1/0",
    "0/0",
    "1/(1-1)",
    "q/q",
    "q//2",
    "q%2",
    "q@q",
    "q and q",
    "q if q else q",
    "q := 1",
    "~q",
    "!q",
    "q!",
    "|q|",
    "q<1",
    "q==1",
    "'q'",
    '"q"',
    "`id`",
    "$(id)",
    "${HOME}",
    "; rm -rf /",
    "&& id",
    "| id",
    "<script>",
    "%s%n",
    "\\x71",
    "\\",
    "#",
    "q # comment",
    "q\x00",
    "\x1b[31mq",
    "\ud800",
    "\u202eq",
    "q\u0301",
    "٣*q",
    "½",
    "∞",
    "１",
    "²",
]
HOSTILE = [
    *_CODE,
    *(f"0..1: {code}" for code in _CODE),
    *(f"pos({code})" for code in _CODE),
    *(f"{code}.toml" for code in _CODE if "/" not in code),
    *[
        "../../../etc/passwd",
        "/dev/zero",
        "/dev/stdin",
        "/dev/zero.toml",
        "~/x.toml",
        "-",
        "--help",
    ],
    *["file:///etc/passwd", "http://example.org/k.toml", ".", "..", "...", "....", "/", "//"],
    *["!!python/object/apply:os.system ['id']", "{{7*7}}", "${7*7}", "cos\nsystem\n(S'id'\ntR."],
    *["(" * 4000, ")" * 4000, "-" * 4090 + "q", "q" * 4096, "1" * 4096, "pos" * 1000, "." * 4096],
    *["\n" * 100 + "q\n", "a\nb.toml", "a\rb", "q\u2028q", "0..1: \u2029q", "b-spline:\n4"],
]


def test_there_are_enough() -> None:
    assert len(set(HOSTILE)) >= 200


def test_hostile_texts() -> None:
    """Refused, each in one line that says what to do; nothing is run, imported or opened."""
    for text in HOSTILE:
        with nothing_happens():
            result = outcome(text)
        assert isinstance(result, str), text
        check_message(result)
    assert not Path("/tmp/owned").exists()


def test_fifty_thousand_random_texts() -> None:
    """Fragments of formulas and of code in any order."""
    generator = random.Random(20090401)
    formulas = [*"0123456789qqq..;:+-*/^()", "pos(", "..", "0..1:", "(2-q)", "^2", "; 1..2:"]

    def draw(alphabet: list[str], most: int) -> str:
        return "".join(generator.choices(alphabet, k=generator.randrange(1, most)))

    texts = [draw(FRAGMENTS, 13) for _ in range(35_000)] + [
        draw(formulas, 9) for _ in range(15_000)
    ]
    kernels = 0
    with nothing_happens():
        for text in texts:
            result = outcome(text)
            if isinstance(result, Kernel):
                kernels += 1
            else:
                check_message(result)
    assert len(texts) == 50_000
    assert kernels > 0


@given(hostile_texts)
def test_hostile_texts_by_search(text: str) -> None:
    result = outcome(text)
    if isinstance(result, str):
        check_message(result)


@given(st.text(max_size=5000))
def test_any_text(text: str) -> None:
    result = outcome(text)
    if isinstance(result, str):
        check_message(result)


# -- files -----------------------------------------------------------------------------------------

TOML = """
name = "mine"
source = "me (2024)"
knots = [0, 1, 2]
pieces = ["1 - 3/2*q^2 + 0.75*q^3", "(2-q)^3/4"]
"""


@pytest.mark.parametrize("suffix", [".toml", ".TOML"])
def test_toml(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"k{suffix}"
    file.write_text(TOML)
    k = kernel(str(file))
    assert k == kernel("cubic-spline")
    assert (k.name, k.source) == ("mine", "me (2024)")


def test_json(tmp_path: Path) -> None:
    file = tmp_path / "k.json"
    content = {"knots": ["0", 1, 2.0], "pieces": [[1, 0, -1.5, "3/4"], "(2-q)^3/4"]}
    file.write_text(json.dumps(content))
    k = kernel(str(file))
    assert k == kernel("cubic-spline")
    assert (k.name, k.source) == ("k", "")


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".toml", "knots = [0, 0.7]\npieces = [[0.1, -0.30000000000000001]]"),
        (".json", '{"knots": [0, 0.7], "pieces": [[0.1, -0.30000000000000001]]}'),
    ],
)
def test_decimals_in_files_are_exact(tmp_path: Path, suffix: str, text: str) -> None:
    file = tmp_path / f"k{suffix}"
    file.write_text(text)
    expected = Kernel([0, Fraction(7, 10)], [[Fraction(1, 10), -Fraction("0.30000000000000001")]])
    assert kernel(str(file)) == expected


GOOD = 'knots = [0, 1]\npieces = ["1"]\n'
BAD_FILES = [
    (".toml", "", "list of knots"),
    (".toml", "knots = [0, 1]", "list of pieces"),
    (".toml", GOOD + "normalisation = 1", "unknown key 'normalisation'"),
    (".toml", GOOD + "'a\\nb' = 1", "unknown key"),
    (".toml", GOOD + "knots = [0]", "malformed"),
    (".toml", "knots = [0, 1", "malformed"),
    (".toml", "knots = 1\npieces = 2", "list of knots"),
    (".toml", 'knots = "01"\npieces = ["1"]', "list of knots"),
    (".toml", 'knots = [0, [1]]\npieces = ["1"]', "knots"),
    (".toml", 'knots = [0, true]\npieces = ["1"]', "knots"),
    (".toml", 'knots = [0, inf]\npieces = ["1"]', "knots"),
    (".toml", 'knots = [0, nan]\npieces = ["1"]', "knots"),
    (".toml", 'knots = [0, 1e3]\npieces = ["1"]', "knots"),
    (".toml", 'knots = [0, 2024-01-01]\npieces = ["1"]', "knots"),
    (".toml", 'knots = [1, 2]\npieces = ["1"]', "first of them 0"),
    (".toml", 'knots = [0, 2, 1]\npieces = ["1", "1"]', "increasing"),
    (".toml", 'knots = [0, 1]\npieces = ["1", "2"]', "pieces: got 2"),
    (".toml", "knots = [0, 1]\npieces = [1]", "polynomial in q as text"),
    (".toml", "knots = [0, 1]\npieces = [{a = 1}]", "polynomial in q as text"),
    (".toml", 'knots = [0, 1]\npieces = ["0..1: q"]', "polynomial in q as text"),
    (".toml", 'knots = [0, 1]\npieces = ["pos(1-q)"]', "expected a polynomial there"),
    (".toml", "knots = [0, 1]\npieces = [\"__import__('os')\"]", "unexpected character"),
    (".toml", 'knots = [0, 1]\npieces = [""]', "at the end"),
    (".toml", 'knots = [0, 1]\npieces = ["sin(q)"]', "unexpected"),
    (".toml", 'knots = [0, 1]\npieces = [["q"]]', "pieces"),
    (".toml", "name = 3\n" + GOOD, "texts"),
    (".toml", "source = []\n" + GOOD, "texts"),
    (".toml", f"knots = [0, {'9' * 5000}]\npieces = ['1']", "malformed"),
    (".toml", f"knots = [0, {'9' * 4000}]\npieces = ['1']", "bits"),
    (".toml", f"knots = [0, 1]\npieces = [[{'0,' * 80}1]]", "degree 80"),
    (".toml", f"knots = [0, 1]\npieces = [{'[1],' * 5000}]", f"at most {MAX_PIECES}"),
    (".toml", f"knots = [{'0,' * 5000}]\npieces = [[1]]", "increasing"),
    (".toml", "knots = " + "[" * 9000 + "]" * 9000, "nested too deeply"),
    (".toml", "a.b.c = 1\n" + GOOD, "unknown key"),
    (".json", "", "malformed"),
    (".json", "[]", "a list"),
    (".json", "3", "expected an object"),
    (".json", "null", "expected an object"),
    (".json", '"cubic-spline"', "expected an object"),
    (".json", "{", "malformed"),
    (".json", '{"knots": [0, 1], "pieces": ["1"],}', "malformed"),
    (".json", '{"knots": [0, NaN], "pieces": ["1"]}', "NaN"),
    (".json", '{"knots": [0, -Infinity], "pieces": ["1"]}', "-Infinity"),
    (".json", '{"knots": [0, 1e400], "pieces": ["1"]}', "1e400"),
    (".json", '{"knots": [0, null], "pieces": ["1"]}', "None"),
    (".json", '{"knots": [0, 1], "pieces": [null]}', "polynomial in q as text"),
    (".json", '{"knots": [0, 1], "pieces": {"0": "1"}}', "list of pieces"),
    (".json", '{"knots": [0, %s], "pieces": ["1"]}' % ("9" * 5000), "5000 digits"),
    (".json", "[" * 100_000, "nested too deeply"),
    (".json", '{"a":' * 100_000, "nested too deeply"),
]


@pytest.mark.parametrize(("suffix", "text", "hint"), BAD_FILES)
def test_bad_files(tmp_path: Path, suffix: str, text: str, hint: str) -> None:
    file = tmp_path / f"k{suffix}"
    file.write_text(text)
    message = outcome(str(file))
    assert isinstance(message, str)
    assert hint in message
    check_message(message.replace(str(tmp_path), ""))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    assert "not a file" in str(outcome(str(folder)))
    missing = tmp_path / "missing.json"
    assert "No such file" in str(outcome(str(missing)))
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b'name = "\xe9"\n' + GOOD.encode())
    assert "malformed" in str(outcome(str(latin)))
    large = tmp_path / "large.toml"
    large.write_bytes(b"#" * (MAX_FILE + 1))
    assert f"{MAX_FILE + 1} bytes, expected at most {MAX_FILE}" in str(outcome(str(large)))
    endless = tmp_path / "endless.toml"
    endless.symlink_to("/dev/zero")
    assert "not a file" in str(outcome(str(endless)))
    loop = tmp_path / "loop.toml"
    loop.symlink_to(loop)
    assert "symbolic links" in str(outcome(str(loop)))
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    assert "not a file" in str(outcome(str(pipe)))


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_a_file_without_permission(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(GOOD)
    file.chmod(0)
    assert "Permission denied" in str(outcome(str(file)))


@given(st.binary(max_size=300), st.sampled_from([".toml", ".json"]))
def test_any_file(tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str) -> None:
    file = tmp_path_factory.getbasetemp() / f"any{suffix}"
    file.write_bytes(content)
    result = outcome(str(file))
    assert isinstance(result, str)
    check_message(result.replace(str(file.parent), ""))
