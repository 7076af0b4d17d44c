"""How many functions stand between a command and the arithmetic of a kernel.

A command is run on a small case and every call within the package is seen. Where a chain has grown
longer than it is today it is printed; where one has become shorter, so should the number here.
"""

from __future__ import annotations

import sys
import threading
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

import sphtrunc
from sphtrunc.cli import main

ROOT = Path(sphtrunc.__file__).parent
#: functions entered from the command on, the command and the kernel's function among them
MOST = {"measure": 9, "derive": 5}
#: that read text, or know names, and evaluate nothing
READING = ("kernels.parse", "kernels.catalogue", "kernels.arguments")
#: the rooms where something is found out, which typesetting shows
DERIVING = ("theory.deriving", "theory.limit", "theory.euler_maclaurin", "theory.lattice_sums")
DERIVING += ("theory.orders", "theory.reciprocal_sums", "theory.aliasing", "theory.disorder")
DERIVING += ("theory.symmetry",)


@cache
def function(code: CodeType) -> str:
    """kernels.values.kernel_values for a function of sphtrunc/kernels/values.py; nothing for what
    is not of the package, or has no name."""
    path = Path(code.co_filename)
    if not path.is_relative_to(ROOT) or code.co_name.startswith("<"):
        return ""
    return ".".join((*path.relative_to(ROOT).with_suffix("").parts, code.co_name))


def stack(frame: FrameType | None) -> list[str]:
    """The functions of the package that have been entered, the outermost first."""
    found = []
    while frame is not None:
        found.append(function(frame.f_code))
        frame = frame.f_back
    return [name for name in found[::-1] if name]


def chains(arguments: list[str], rooms: tuple[str, ...]) -> list[list[str]]:
    """Of every call in these rooms the functions entered from the command on, it first; of a thread
    with those of whoever waits for it before them."""
    found: dict[tuple[str, ...], None] = {}
    home = threading.main_thread().ident

    def look(frame: FrameType, event: str, _: Any) -> None:
        if event != "call" or not function(frame.f_code).startswith(rooms):
            return
        chain = stack(frame)
        if threading.get_ident() != home:
            chain = stack(sys._current_frames()[home or 0]) + chain
        starts = [
            n for n, name in enumerate(chain) if name.startswith("cli.") and "main" not in name
        ]
        found.setdefault(tuple(chain[starts[0] :] if starts else ()))

    kept = sys.getprofile()
    threading.setprofile(look)
    sys.setprofile(look)
    try:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
    finally:
        sys.setprofile(kept)
        threading.setprofile(None)  # type: ignore[arg-type]
    assert not ended.value.code
    return [list(chain) for chain in found if chain]


def kernel_calls(arguments: list[str]) -> list[list[str]]:
    """The chains that end with the first function of a kernel that is no reading."""
    return [
        chain
        for chain in chains(arguments, ("kernels.",))
        if chain[-1].startswith("kernels.")
        and not any(name.startswith("kernels.") for name in chain[:-1])
        and not chain[-1].startswith(READING)
    ]


@pytest.mark.parametrize(
    "arguments",
    [
        "derive --kernel cubic-spline --dx-over-h 1/2",
        "measure --kernel cubic-spline --dx-over-h 10/13 --no-predict --workers 1",
    ],
)
def test_the_kernel_is_reached_in_few_steps(
    arguments: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = kernel_calls(arguments.split())
    capsys.readouterr()
    assert len(found) > 2
    longest = max(found, key=len)
    most = MOST[arguments.split()[0]]
    assert len(longest) <= most, f"{len(longest)} functions:\n  " + "\n  ".join(longest)
    assert len(longest) == most, f"only {len(longest)} functions now: write it above"


@pytest.mark.parametrize(
    "arguments",
    [
        "derive --kernel cubic-spline --dx-over-h 1/2",
        "derive --kernel cubic-spline --dx-over-h 1/2 --format latex",
        "derive --kernel wendland-c2 --dim 3 --lattice bcc --dx-over-h 1/2 --degree 3",
        "derive --kernel wendland-c2 --dim 2 --dx-over-h 3/5 --jitter 0.05 --degree 2",
    ],
)
def test_typesetting_derives_nothing(arguments: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is found out while it is being written down."""
    found = chains(arguments.split(), (*DERIVING, "theory.typeset"))
    capsys.readouterr()
    assert any(chain[-1].startswith("theory.typeset") for chain in found)
    assert any(chain[-1].startswith(DERIVING) for chain in found)
    late = [
        chain
        for chain in found
        if chain[-1].startswith(DERIVING)
        and any(writer.startswith("theory.typeset") for writer in chain)
    ]
    assert not late, "\n  ".join(late[0])
