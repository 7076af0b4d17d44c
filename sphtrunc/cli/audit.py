"""sphtrunc audit: check anybody's kernel."""

from __future__ import annotations

import json
import sys

import click

from sphtrunc.audit import MARKDOWN_HEAD, Audit, audit, audit_formula, audit_list, audit_table
from sphtrunc.cli import options
from sphtrunc.output import emit


@click.command(name="audit")
@click.option(
    "--python", "callable_", metavar="MODULE:NAME", help="A callable, or a method of a class."
)
@click.option(
    "--signature",
    metavar="TEXT",
    help='How it is called: "W(r,h)", "W(r,h,dim)", "w(q)", "w(q,dim)", "kernel(xij,rij,h)"; w(q)'
    " is h^d W.  [default: by the names of its arguments]",
)
@click.option(
    "--derivative",
    metavar="MODULE:NAME",
    help="Its derivative: dW/dr, or dw/dq of a w(q); for --formula, pieces in q.",
)
@click.option(
    "--second-derivative",
    "second",
    metavar="MODULE:NAME",
    help="Its second derivative, likewise.",
)
@click.option(
    "--table", metavar="FILE", help="CSV or NPZ with columns q (or r and h), W, and dW, d2W."
)
@click.option(
    "--formula", metavar="SPEC", help="A kernel as for --kernel, gaussian, double-cosine."
)
@click.option(
    "--constant",
    metavar="TEXT",
    help="The constant that goes with --formula; with h, as in 1/(pi*h^3), its power is checked.",
)
@click.option(
    "--derivative-constant",
    metavar="TEXT",
    help="The constant of the derivative of --formula, where it is another: 1/(pi*h^4).",
)
@click.option("--second-constant", metavar="TEXT", help="That of its second derivative.")
@click.option("--list", "list_", metavar="FILE", help="A TOML list of kernels.")
@click.option(
    "--support", metavar="NUMBER", help="Where the caller cuts it off, in units of its h."
)
@click.option(
    "--dim",
    "dims",
    type=click.IntRange(1, 3),
    multiple=True,
    help="Dimension; may be repeated.  [default: 3]",
)
@options.formats("text", "json", "markdown")
@options.output
def command(
    callable_: str | None,
    signature: str | None,
    derivative: str | None,
    second: str | None,
    table: str | None,
    formula: str | None,
    constant: str | None,
    derivative_constant: str | None,
    second_constant: str | None,
    list_: str | None,
    support: str | None,
    dims: tuple[int, ...],
    format_: str,
    output: str | None,
) -> None:
    """Check a kernel: which one it is, its constant, its derivative, its smoothing length.

    Exit status: 0 clean, 1 faults found, 2 unusable input. Only the named callable is executed.

    \b
    sphtrunc audit --formula quintic-spline --constant '3/(359*pi)' --dim 3
    sphtrunc audit --python mycode.kernels:W --derivative mycode.kernels:dW --dim 2 --dim 3
    sphtrunc audit --table kernel.csv --dim 3 --format markdown
    """
    ways = {"--python": callable_, "--table": table, "--formula": formula, "--list": list_}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) != 1:
        raise ValueError("audit: give one of --python, --table, --formula and --list")
    if (formula is None) != (constant is None):
        raise ValueError("audit: --formula and --constant go together")
    _refuse_unused(
        given[0],
        {
            "--signature": (signature, ("--python",)),
            "--derivative": (derivative, ("--python", "--formula")),
            "--second-derivative": (second, ("--python", "--formula")),
            "--support": (support, ("--python", "--formula")),
            "--derivative-constant": (derivative_constant, ("--formula",)),
            "--second-constant": (second_constant, ("--formula",)),
            "--dim": (dims or None, ("--python", "--table", "--formula")),
        },
    )
    reports: list[Audit] = []
    if list_ is not None:
        reports = audit_list(list_)
    for dim in () if list_ is not None else dims or (3,):
        if callable_ is not None:
            end = _number(support)
            reports.append(
                audit(callable_, dim, signature, derivative, end, second_derivative=second)
            )
        elif table is not None:
            reports.append(audit_table(table, dim))
        elif formula is not None and constant is not None:
            reports.append(
                audit_formula(
                    formula,
                    constant,
                    dim,
                    derivative,
                    support,
                    derivative_constant=derivative_constant,
                    second_derivative=second,
                    second_constant=second_constant,
                )
            )
    emit(_rendered(reports, format_), output)
    sys.exit(0 if all(report.clean for report in reports) else 1)


def _refuse_unused(way: str, options_: dict[str, tuple[object, tuple[str, ...]]]) -> None:
    for name, (value, ways) in options_.items():
        if value is not None and way not in ways:
            raise ValueError(f"audit: {name} goes with {' or '.join(ways)}, not with {way}")


def _number(support: str | None) -> float | None:
    if support is None:
        return None
    try:
        value = float(support)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e6:
        raise ValueError(f"support: got {support[:40]!r}, expected a positive number")
    return value


def _rendered(reports: list[Audit], format_: str) -> str:
    if format_ == "json":
        return json.dumps([r.to_dict() for r in reports], indent=2, ensure_ascii=False)
    if format_ == "markdown":
        return "\n".join([MARKDOWN_HEAD, *(r.to_markdown() for r in reports)])
    return "\n\n".join(r.to_text() for r in reports)
