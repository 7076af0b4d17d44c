"""Random settings of the explorer, what the package says of them, and the page's engine."""

from __future__ import annotations

import json
import random
from dataclasses import asdict
from fractions import Fraction
from functools import cache
from typing import Any

import quickjs

from sphtrunc.explorer.assembly import COMPUTING, script
from sphtrunc.explorer.setting import Setting, numbers
from sphtrunc.explorer.tables import tables
from sphtrunc.kernels.conventions import BALL
from sphtrunc.kernels.parse import kernel
from sphtrunc.scenes.sites import KINDS

TABLES = tables()
#: of every family, with and without inner knots, rough and smooth, short and wide, and typed
KERNELS = (
    "b-spline:2",
    "cubic-spline",
    "b-spline:9",
    "polynomial:1",
    "polynomial:20",
    "wendland-c2",
    "wendland-c6",
    "wendland-c4-1d",
    "core-triangle",
    "linear-quartic",
    "0..1/3: 1 - q; 1/3..3/2: (3/2-q)^3*24/49",
    "pos(7/4-q)^5 - 2*pos(1-q)^5",
)
COUNT = 200


@cache
def random_settings() -> list[Setting]:
    """COUNT settings, always the same: every form, correction, lattice and dimension is met."""
    rng = random.Random(19)
    found = []
    while len(found) < COUNT:
        form = rng.choice(list(TABLES["forms"]))
        dim = rng.choice([1, 2, 3])
        lattice = rng.choice([kind for kind, data in KINDS.items() if data.dim == dim])
        if form == "paired" and not TABLES["lattices"][lattice]["pairs"]:
            continue
        correction = rng.choice(TABLES["forms"][form])
        name = rng.choice(KERNELS)
        # enough particles for the correction, few enough for a test
        count = rng.uniform(*{1: (12, 40), 2: (40, 120), 3: (80, 130)}[dim])
        ratio = float(kernel(name).support) * (float(BALL[dim]) / count) ** (1 / dim)
        jitter = 0.0 if form == "paired" else rng.choice([0.0, rng.uniform(0.01, 0.3)])
        found.append(
            Setting(
                kernel=name,
                dim=dim,
                lattice=lattice,
                form=form,
                correction=correction,
                dx_over_h=Fraction(f"{ratio:.4f}"),
                h_over_lambda=Fraction(f"{10 ** rng.uniform(-2.5, -0.31):.5f}"),
                jitter=Fraction(f"{jitter:.3f}"),
            )
        )
    return found


def words(at: Setting) -> dict[str, str]:
    """The setting as the page has it: texts by their keys."""
    return {name.replace("_", "-"): str(value) for name, value in asdict(at).items()}


@cache
def expected(n: int) -> dict[str, Any]:
    """What the package says of the n-th random setting."""
    return numbers(random_settings()[n])


def flat(value: Any, name: str = "") -> dict[str, float | None]:
    """Nested numbers by their path."""
    if isinstance(value, dict):
        return {k: x for key, v in value.items() for k, x in flat(v, f"{name}.{key}").items()}
    if isinstance(value, list):
        return {k: x for i, v in enumerate(value) for k, x in flat(v, f"{name}.{i}").items()}
    return {name: value}


def apart(at: Setting, got: Any, wanted: Any) -> dict[str, tuple[float | None, float | None]]:
    """The numbers of a setting that differ by more than 1e-10 of themselves and by more than their
    rounding; and what is there in one of them only.

    Sums of some hundred terms of order ten are rounded by 1e-13, and the moment matrices of RKPM of
    degrees 2 and 3, with conditions up to 1e6, make 1e-10 of it.
    """
    one, other = flat(got), flat(wanted)
    rounding = 1e-10 if at.correction in ("rkpm-2", "rkpm-3") else 1e-13

    def alike(a: float | None, b: float | None) -> bool:
        return a is b if a is None or b is None else abs(a - b) <= 1e-10 * abs(b) + rounding

    names = one.keys() | other.keys()
    pairs = {name: (one.get(name), other.get(name)) for name in names}
    return {name: pair for name, pair in pairs.items() if not alike(*pair)}


class Engine:
    """The computing part of the page, in a JavaScript engine without a browser."""

    def __init__(self) -> None:
        self.context = quickjs.Context()
        self.context.eval("globalThis.URLSearchParams = class {};")  # a browser's, not needed here
        self.context.eval(script(COMPUTING))
        self.context.eval(
            "function called(name, text) {"
            " try { return JSON.stringify({ is: globalThis.eval(name)(...JSON.parse(text)) }); }"
            " catch (error) { return JSON.stringify({ refused: String(error.message) }); } }"
        )

    def define(self, code: str) -> None:
        """Add a function."""
        self.context.eval(code)

    def __call__(self, name: str, *arguments: Any) -> dict[str, Any]:
        """{"is": the result} or {"refused": the message of the error}."""
        return dict(json.loads(self.context.get("called")(name, json.dumps(arguments))))


@cache
def engine() -> Engine:
    return Engine()
