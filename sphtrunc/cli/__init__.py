"""The command line: one file per command, imported when that command is called."""

from __future__ import annotations

import gc
import sys
from importlib import import_module

import click

from sphtrunc.version import __version__

#: command: its line in `sphtrunc --help`; the command itself is `command` in the module of its name
COMMANDS = {
    "derive": "The truncation error of a kernel, exactly.",
    "measure": "The discrete sums themselves, on particles.",
    "inspect": "What is in a file of particles, and which kernel made its densities.",
    "conserve": "What each momentum equation keeps, and at what error.",
    "map": "Where in the particles of a file the sums are wrong, by how much, and why.",
    "kernels": "The catalogue of kernels and their constants.",
    "sweep": "Measure every combination of lists of options, resumably.",
    "tune": "Which h and Δx to take, and what limits the error.",
    "wall": "What every remedy leaves of the error near a wall.",
    "figures": "Every figure, measured points and derived curves.",
    "convert": "Smoothing length, support, neighbours, 2σ, FWHM: from one to the others.",
    "structure": "The structure factor of particles: how they are disordered.",
    "relax": "Particles that have moved apart: periodic glasses.",
    "audit": "Check anybody's kernel: constant, derivative, smoothing length.",
    "identify": "Recognise a constant: which kernel, dimension and convention.",
    "export": "Golden values of a kernel for the tests of other codes.",
    "bench": "Run time against error, on this machine.",
    "stability": "Which waves grow on a lattice: pairing, tension, time steps.",
    "flow": "From the truncation error to the error of a solution: viscous flows.",
    "explore": "A page for the browser that computes the error of any setting.",
    "info": "Versions, extras and cores, for a report of a bug.",
}


class LazyGroup(click.Group):
    """A group that imports a command only to run it, so that --help needs neither of the layers."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        gc.disable()  # an import leaves no garbage; looking for it, then and at the end, takes time
        try:
            command = import_module(f"sphtrunc.cli.{cmd_name}").command
        finally:
            gc.freeze()
            gc.enable()
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="sphtrunc")
def group() -> None:
    """Truncation error of Smoothed Particle Hydrodynamics: derived exactly, measured on particles.

    Start with: sphtrunc derive --kernel cubic-spline
    """


def main(arguments: list[str] | None = None) -> None:
    """Run a command; whatever is wrong with the input ends in one line and exit status 2."""
    try:
        status = group.main(args=arguments, prog_name="sphtrunc", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        status = 0
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "sphtrunc"
        _fail(f"{error.format_message()} (see '{where} --help')")
    except click.ClickException as error:
        _fail(error.format_message())
    except click.Abort:
        click.echo("interrupted", err=True)
        sys.exit(130)
    except ValueError as error:
        _fail(str(error))
    except BrokenPipeError:
        sys.stderr.close()  # the reader of a pipe has gone: nothing left to say
        sys.exit(1)
    sys.exit(status if isinstance(status, int) else 0)


def _fail(message: str) -> None:
    click.echo("Error: " + " ".join(message.split()), err=True)
    sys.exit(2)
