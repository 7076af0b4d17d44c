"""What commands that take long have in common: workers elsewhere, and a bar of how far it is."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import click


def dask(address: str, stack: ExitStack) -> Any:
    """The executor of a Dask scheduler, for as long as the stack is open."""
    try:
        from distributed import Client
    except ImportError:
        raise ValueError("dask: distributed is not installed; pip install distributed") from None
    try:
        connect: Any = Client  # untyped
        client = stack.enter_context(connect(address, timeout=10))
    except OSError as error:
        raise ValueError(f"dask: no scheduler at {address}: {error}") from None
    return client.get_executor(retries=3)


def bar(stack: ExitStack, label: str) -> Callable[[int, int], None] | None:
    """A progress bar with the time left, on a terminal only."""
    if not sys.stderr.isatty():
        return None
    shown: Any = None

    def update(done: int, expected: int) -> None:
        nonlocal shown
        if shown is None:
            shown = stack.enter_context(
                click.progressbar(length=expected, label=label, file=sys.stderr)
            )
        shown.update(done - shown.pos)

    return update


def memory(text: str) -> float:
    """Bytes that a text such as 512MB or 4GB says.

    Raises ValueError for anything else.
    """
    units = {"kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}
    number, unit = text[:-2].strip(), text[-2:]
    try:
        size = float(number) * units[unit]
    except (ValueError, KeyError):
        size = 0.0
    if not 0 < size < 1e18:
        raise ValueError(f"memory: got {text[:40]!r}, expected a size such as 512MB or 4GB")
    return size
