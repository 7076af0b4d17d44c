"""`sphtrunc derive` and `sphtrunc kernels` as a user types them, in a process of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest
from click.testing import CliRunner
from sympy import Rational, bernoulli, floor

from sphtrunc import derive, kernel
from sphtrunc.cli import main
from sphtrunc.kernels.catalogue import names
from sphtrunc.version import __version__


def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sphtrunc", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        cwd=cwd,
    )


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """The same within this process: exit status, standard output, standard error."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    captured = capsys.readouterr()
    return int(stop.value.code or 0), captured.out, captured.err


def test_the_main_job():
    done = run("derive", "--kernel", "cubic-spline")
    assert done.returncode == 0
    assert done.stderr == ""
    for part in ("β = 2", "σ = 2/3 in 1D", "(1/6) h² A‴", "(Δx/h)³"):
        assert part in done.stdout


@pytest.mark.parametrize("name", [*names()])
def test_text_fits_a_terminal_and_is_deterministic(capsys, name):
    status, first, _ = call(capsys, "derive", "--kernel", name, "--dx-over-h", "10/23")
    assert status == 0
    assert max(len(line) for line in first.splitlines()) <= 100
    assert call(capsys, "derive", "--kernel", name, "--dx-over-h", "10/23")[1] == first


CONTRACT = [
    "schema",
    "kernel",
    "dim",
    "operator",
    "form",
    "correction",
    "normalisation",
    "w0",
    "boundary_smoothness",
    "smoothness",
    "jumps",
    "kernel_moments",
    "gradient_moments",
    "smoothing_error",
    "discretisation_terms",
    "orders",
    "version",
]


@pytest.mark.parametrize("name", ["cubic-spline", "wendland-c2", "b-spline:20", "core-triangle"])
def test_json_is_a_contract_from_which_the_moments_follow(capsys, name):
    """A reader of the JSON alone gets the discrete moments from the terms, exactly."""
    support = kernel(name).support
    ratio, theta = support * Rational(5, 23), Rational(1, 3)
    status, out, _ = call(
        capsys,
        *("derive", "--kernel", name, "--dx-over-h", str(ratio), "--offset", str(theta)),
        *("--format", "json"),
    )
    data = json.loads(out)
    assert status == 0
    assert [key for key in CONTRACT if key not in data] == []
    assert data["schema"] == "sphtrunc.derive/1"
    assert data["version"] == __version__
    assert data["orders"]["smoothing"] == 2

    def wave(n: int, x: Rational) -> Rational:
        x -= floor(x)
        return Rational(0) if (n, x) == (1, 0) else bernoulli(n, x)

    gradient = {int(k): Rational(v) for k, v in data["gradient_moments"].items()}
    for k, value in data["discrete_moments"].items():
        total = -gradient.get(int(k), Rational(0)) + sum(
            Rational(t["coefficient"])
            * ratio ** t["dx_power"]
            * wave(t["dx_power"], Rational(t["knot"]) / ratio - theta)
            for t in data["discretisation_terms"]
            if t["moment"] == int(k)
        )
        assert total == Rational(value)


def test_json_of_every_number_is_exact_text(capsys):
    _, out, _ = call(capsys, "derive", "-k", "wendland-c4", "--dim", "3", "--format", "json")
    data = json.loads(out, parse_float=lambda text: pytest.fail(f"a float: {text}"))
    assert data["normalisation"] == "495/(256*pi)"
    assert data["kernel_moments"]["2"] == "8/13"
    assert data["discretisation_terms"] == []


def test_latex_is_balanced(capsys):
    _, out, _ = call(
        capsys, "derive", "-k", "quintic-spline", "--dx-over-h", "1/2", "--format", "latex"
    )
    assert out.count("{") == out.count("}")
    for environment in ("cases", "align*"):
        begun, ended = (out.count(rf"\{word}{{{environment}}}") for word in ("begin", "end"))
        assert begun == ended > 0


def test_a_derivation_shows_itself_in_a_notebook():
    derived = derive("cubic-spline", dx_over_h="1/2")
    assert r"\frac{1}{6} h^{2} A^{(3)}" in derived._repr_latex_()
    assert "M_{1}" in derived.discrete._repr_latex_()


@pytest.mark.parametrize("dim", ["1", "2", "3"])
@pytest.mark.parametrize("form", ["text", "latex", "json"])
def test_kernels_lists_the_whole_catalogue(capsys, dim, form):
    status, out, _ = call(capsys, "kernels", "--dim", dim, "--format", form)
    assert status == 0
    assert [name for name in names() if name not in out] == []
    assert form == "latex" or max(len(line) for line in out.splitlines()) <= 200


def test_kernels_json(capsys):
    _, out, _ = call(capsys, "kernels", "--dim", "2", "--format", "json")
    data = json.loads(out)
    rows = {row["name"]: row for row in data["kernels"]}
    assert data["schema"] == "sphtrunc.kernels/1"
    assert rows["quintic-spline"]["normalisation"] == "7/(478*pi)"
    assert Fraction(rows["cubic-spline"]["smoothing_coefficient"]) == Fraction(31, 49) / 4


def test_output_goes_whole_into_a_file(tmp_path, capsys):
    target = tmp_path / "derived.json"
    target.write_text("old")
    status, out, _ = call(capsys, "derive", "-k", "lucy", "--format", "json", "-o", str(target))
    assert (status, out) == (0, "")
    assert json.loads(target.read_text())["kernel"]["name"] == "lucy"
    assert [p.name for p in tmp_path.iterdir()] == ["derived.json"]


def test_a_kernel_of_ones_own(tmp_path, capsys):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nsource = "me"\nknots = [0, 1, 2]\n'
        'pieces = ["1 - 3/2*q^2 + 0.75*q^3", [2, -3, "3/2", "-1/4"]]\n'
    )
    texts = [
        "0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4",
        "pos(2-q)^3/4 - pos(1-q)^3",
        str(tmp_path / "mine.toml"),
        "cubic-spline",
    ]
    moments = []
    for text in texts:
        status, out, _ = call(
            capsys, "derive", "-k", text, "--dx-over-h", "10/13", "--format", "json"
        )
        assert status == 0
        moments.append(json.loads(out)["discrete_moments"])
    assert all(m == moments[0] for m in moments)
    assert moments[0]["1"] == "29200/28561"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("derive -k cubic-splin", "did you mean cubic-spline"),
        ("derive -k cubic-spline --dx-over-h 0", "positive"),
        ("derive -k cubic-spline --dx-over-h 3.5", "did you mean h/Δx"),
        ("derive -k cubic-spline --dx-over-h half", "expected a rational"),
        ("derive -k cubic-spline --dx-over-h 1e-1", "expected a rational"),
        ("derive -k cubic-spline --dx-over-h 1/0", "expected a rational"),
        ("derive -k cubic-spline --dim 4", "--dim"),
        ("derive -k cubic-spline --operator rotation", "--operator"),
        ("derive -k cubic-spline --operator value --correction csph", "corrects a gradient"),
        ("derive -k cubic-spline --correction rkpm-3 --dx-over-h 3/2", "singular"),
        ("derive -k nothing.toml", "No such file"),
        ("derive", "--kernel"),
        ("derive -k cubic-spline -o /no/such/folder/file", "/no/such/folder"),
        ("derive -k cubic-spline extra", "extra"),
        ("deriv", "deriv"),
        ("derive -k 0..2:9**9**9", "unexpected"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(capsys, arguments, says):
    status, out, err = call(capsys, *arguments.split())
    assert (status, out) == (2, "")
    assert says in err
    assert len(err.splitlines()) == 1


def test_no_traceback_reaches_a_user():
    done = run("derive", "--kernel", "__import__('os').system('echo pwned')")
    assert done.returncode == 2
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_help_of_every_command():
    from sphtrunc.cli import COMMANDS, group

    runner = CliRunner()
    for name in COMMANDS:
        shown = runner.invoke(group, [name, "--help"])
        assert shown.exit_code == 0
        assert "Usage" in shown.output
