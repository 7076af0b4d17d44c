"""Values of somebody's kernel: called where it matters, or read from a table."""

from __future__ import annotations

import csv
import importlib
import inspect
import io
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Function = Callable[[Array, float], Array]  # (q, h) -> h^d W, in float64

MAX_FILE = 1 << 24  # bytes of a table
MAX_RANGE = 64.0  # a kernel that has not vanished by then has no end
LEAST_POINTS = 16
DOUBLE, SINGLE = 2.0**-53, 2.0**-24  # rounding units
SINGLE_DIGITS = 5e-11  # half a unit of the tenth digit: single precision is written with nine
SIGNATURE = re.compile(r"\s*\w+\s*\(\s*([a-z]+(?:\s*,\s*[a-z]+)*)\s*\)\s*", re.ASCII)


@dataclass(frozen=True)
class Samples:
    """A kernel's values in one dimension, q = r/h with the h of whoever wrote it.

    q: (n,) increasing, from 0 on; w: (n,) h^d W; dw: (n,) h^(d+1) dW/dr, or None
    unit: the rounding unit of the values; error: (n,) what the decimals of a table leave open
    support: the largest q with a value and the smallest one without (equal where bisected)
    declared: precision of the type that came back, DOUBLE or SINGLE
    function: to ask for more values, if there is a callable
    """

    q: Array
    w: Array
    dw: Array | None
    unit: float
    error: Array
    derivative_error: Array
    support: tuple[float, float]
    declared: float
    function: Function | None
    power_of_h: float | None  # W ∝ h^power at fixed q, if the callable takes h and it is not −d


def load(path: str) -> Callable[..., Any]:
    """The callable that 'package.module:name' or 'package.module:Class.method' names.

    The current directory is searched first, as by `python -m`. The module is imported and nothing
    else of it is called; a method of a class is taken from an instance made without arguments.

    Raises ValueError where it does not exist or cannot be called.
    """
    module_name, colon, attributes = path.partition(":")
    names = attributes.split(".")
    if not colon or not all(n.isidentifier() for n in [*module_name.split("."), *names]):
        raise ValueError(f"python: got {path!r}, expected package.module:function")
    here = os.getcwd()
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        found: Any = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        raise ValueError(f"python: cannot import {module_name!r}: {_said(error)}") from None
    for name in names:
        owner = found
        try:
            if inspect.isclass(owner) and inspect.isfunction(inspect.getattr_static(owner, name)):
                owner = owner()
            found = getattr(owner, name)
        except (Exception, SystemExit) as error:
            raise ValueError(f"python: {path!r}: {_said(error)}") from None
    if not callable(found):
        raise ValueError(f"python: {path!r} is a {type(found).__name__}, expected a callable")
    return found  # type: ignore[no-any-return]


def arguments(signature: str) -> tuple[str, ...]:
    """The argument names of 'W(r,h)', 'W(r,h,dim)', 'w(q)', 'w(q,dim)', 'W(q,h)' in any order."""
    match = SIGNATURE.fullmatch(signature[:100])
    names = tuple(n.strip() for n in match.group(1).split(",")) if match else ()
    fine = len(set(names)) == len(names) and set(names) <= {"q", "r", "h", "dim"}
    if not fine or ("q" in names) == ("r" in names):
        raise ValueError(
            f'signature: got {signature[:60]!r}, expected "W(r,h)", "W(r,h,dim)", "w(q)" or'
            ' "w(q,dim)"'
        )
    return names


class Caller:
    """A callable asked for arrays of values: at once if it can take them, one by one if not."""

    def __init__(self, function: Callable[..., Any], names: Sequence[str], dim: int, what: str):
        self._function, self._names, self._dim, self._what = function, names, dim, what
        self._scalar = False
        self.declared = DOUBLE

    def __call__(self, q: Array, h: float = 1.0) -> Array:
        if not self._scalar:
            try:
                return self._checked(self._call(q * h if "r" in self._names else q.copy(), h), q)
            except ValueError:
                self._scalar = True
        r = q * h if "r" in self._names else q
        results = [self._call(float(x), h) for x in r]
        kinds = {np.asarray(v).dtype.kind for v in results}
        if kinds <= {"i", "u"} and any(results):
            raise ValueError(f"{self._what}: returned integers, expected real numbers")
        if any(np.ndim(v) for v in results):
            raise ValueError(
                f"{self._what}: returned an array of shape {np.shape(results[0])} for one number"
            )
        if kinds <= {"i", "u", "f", "b"}:
            kept = [v for v in results if np.asarray(v).dtype.kind == "f"]
            dtype = np.result_type(*{np.asarray(v).dtype for v in kept}) if kept else np.float64
            return self._checked(np.array(results, dtype=dtype), q)
        odd = next(v for v in results if np.asarray(v).dtype.kind not in "iufb")
        raise ValueError(f"{self._what}: returned {_kind(odd)}, expected real numbers")

    def _call(self, x: Any, h: float) -> Any:
        given = {"q": x, "r": x, "h": h, "dim": self._dim}
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                return self._function(*[given[name] for name in self._names])
        except (Exception, SystemExit) as error:
            raise ValueError(f"{self._what}: raised {_said(error)}") from None

    def _checked(self, result: Any, q: Array) -> Array:
        try:
            values = np.asarray(getattr(result, "value", result))
        except Exception as error:
            raise ValueError(f"{self._what}: returned {_kind(result)}: {error}") from None
        if values.dtype.kind != "f":
            raise ValueError(f"{self._what}: returned {_kind(result)}, expected real numbers")
        if values.shape != q.shape:
            raise ValueError(
                f"{self._what}: returned shape {values.shape} for {q.shape[0]} distances,"
                f" expected {q.shape}"
            )
        if not np.isfinite(values).all():
            where = float(q[np.nonzero(~np.isfinite(values))[0][0]])
            raise ValueError(f"{self._what}: returned NaN or infinity at q = {where:.6g}")
        self.declared = DOUBLE if values.dtype.itemsize >= 8 else SINGLE
        return values.astype(np.float64)


def from_callable(
    function: Callable[..., Any],
    dim: int,
    signature: str = "w(q)",
    derivative: Callable[..., Any] | None = None,
    points: int = 2000,
    support: float | None = None,
) -> Samples:
    """Call W (and dW/dr, or dw/dq for w(q)) where a fault would show.

    Evenly over the support, closely about its edge, which is found by bisection, and at a second
    h, to see the power of h. Where the callable takes arrays it is called a few times; where it
    takes only numbers, at a quarter of the points, one by one.

    Raises ValueError for whatever the callable does wrong, in one line.
    """
    names = arguments(signature)
    call = Caller(function, names, dim, "the kernel")

    def scaled(q: Array, h: float = 1.0) -> Array:
        values = call(q, h)
        return values * h**dim if "h" in names else values

    low, high = _edge(scaled) if support is None else (support, support)
    if call._scalar:
        points = min(points, 500)
    spread = (np.arange(points) + 0.5) / points
    edge = 1 - 2.0 ** -np.arange(2.0, 12.0)
    q = np.unique(np.concatenate([[0.0], spread * high, edge * high]))
    w = scaled(q)
    dw, declared = None, call.declared
    if derivative is not None:
        slope = Caller(derivative, names, dim, "the derivative")
        dw = np.concatenate([[0.0], slope(q[1:])])
    power = None
    if "h" in names:
        there = q[(q > 0) & (np.abs(w) > 1e-3 * np.max(np.abs(w)))][::50]
        ratio = float(np.median(call(there, 2.0) / call(there, 1.0)))
        found = math.log2(ratio) if ratio > 0 else math.nan
        if not abs(found + dim) < 1e-3:
            power = found
    unit = SINGLE if declared == SINGLE else DOUBLE
    none = np.zeros_like(w)
    return Samples(q, w, dw, unit, none, none, (low, high), declared, scaled, power)


def _edge(function: Function) -> tuple[float, float]:
    """The last q with a value and the next float, which has none."""
    coarse = np.concatenate([[0.0], np.arange(1, 1025) * (MAX_RANGE / 1024)])
    w = function(coarse, 1.0)
    inside = np.nonzero(w)[0]
    if not len(inside):
        raise ValueError("the kernel: is zero everywhere")
    last = int(inside[-1])
    if last == len(coarse) - 1:
        raise ValueError(
            f"the kernel: has not vanished at q = {MAX_RANGE:g}; if its caller cuts it off, say"
            " where: --support 2"
        )
    low, high = float(coarse[last]), float(coarse[last + 1])
    while True:
        probes = np.linspace(low, high, 33)
        w = function(probes, 1.0)
        at = int(np.nonzero(w)[0][-1]) if np.any(w) else 0
        new = float(probes[at]), float(probes[min(at + 1, 32)])
        if new == (low, high) or new[0] == new[1]:
            return low, high
        low, high = new


def from_table(path: str | Path, dim: int) -> Samples:
    """A table: CSV with a header, or NPZ, with columns q (or r and h), W and optionally dW.

    Decimals are taken to be rounded at their last digit. NPZ files are read without pickle.

    Raises ValueError, naming the file, where columns are missing, doubled, unsorted or too short.
    """
    file = Path(path)
    columns = _read_npz(file) if file.suffix.lower() == ".npz" else _read_csv(file)
    q, errors = _distances(columns, file)
    w, error = columns["w"]
    if len(q) < LEAST_POINTS:
        raise ValueError(f"table {file}: {len(q)} points, expected at least {LEAST_POINTS}")
    for name, (values, _) in columns.items():
        if values.shape != q.shape or values.ndim != 1:
            raise ValueError(f"table {file}: column {name!r} is of shape {values.shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"table {file}: column {name!r} holds NaN or infinity")
    if q[0] < 0 or not np.all(np.diff(q) > 0):
        at = 0 if q[0] < 0 else int(np.argmax(np.diff(q) <= 0)) + 1
        what = "repeats" if at and q[at] == q[at - 1] else "falls" if at else "starts below zero"
        raise ValueError(f"table {file}: q {what} at point {at + 1}, expected increasing distances")
    h = columns["h"][0] if "h" in columns else np.ones_like(q)
    w, error = w * h**dim, error * h**dim
    slope = columns.get("dw")
    dw, slope_error = (
        (slope[0] * h ** (dim + 1), slope[1] * h ** (dim + 1)) if slope else (None, error)
    )
    inside = np.nonzero(w)[0]
    if not len(inside):
        raise ValueError(f"table {file}: W is zero everywhere")
    last = int(inside[-1])
    end = float(q[last + 1]) if last + 1 < len(q) else math.inf
    # written from single precision: exactly its values, or no more digits than it has
    some = w != 0
    single = bool(np.all(w.astype(np.float32) == w)) or bool(
        np.median(error[some] / np.abs(w[some])) > SINGLE_DIGITS
    )
    unit = SINGLE if single else DOUBLE
    if dw is not None and errors.any():
        slope_error = slope_error + errors * np.max(np.abs(np.gradient(dw, q)))
    if errors.any():
        error = error + errors * np.abs(np.gradient(w, q)) + errors**2
    return Samples(q, w, dw, unit, error, slope_error, (float(q[last]), end), unit, None, None)


def _distances(columns: dict[str, tuple[Array, Array]], file: Path) -> tuple[Array, Array]:
    if "w" not in columns:
        raise ValueError(f"table {file}: no column W among {sorted(columns)}")
    if "q" in columns:
        return columns["q"]
    if "r" in columns and "h" in columns:
        h = columns["h"][0]
        if not np.all(h > 0):
            raise ValueError(f"table {file}: h must be positive")
        return columns["r"][0] / h, columns["r"][1] / h
    raise ValueError(f"table {file}: no column q, nor r and h, among {sorted(columns)}")


def _read_npz(file: Path) -> dict[str, tuple[Array, Array]]:
    _readable(file)
    try:
        with np.load(file, allow_pickle=False) as archive:
            found = {str(name).strip().lower(): archive[name] for name in archive.files}
    except Exception as error:
        raise ValueError(f"table {file}: not a readable NPZ file: {_said(error)}") from None
    for name, values in found.items():
        if values.dtype.kind not in "iuf":
            raise ValueError(f"table {file}: column {name!r} is of type {values.dtype}")
    return {
        name: (v.astype(np.float64), np.zeros(v.shape, dtype=np.float64))
        for name, v in found.items()
    }


def _read_csv(file: Path) -> dict[str, tuple[Array, Array]]:
    _readable(file)
    try:
        rows = [r for r in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))) if r]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"table {file}: {_said(error)}") from None
    if not rows:
        raise ValueError(f"table {file}: empty")
    header = [name.strip().lstrip("#").strip().lower() for name in rows[0]]
    if len(set(header)) != len(header):
        raise ValueError(f"table {file}: column {header[0]!r} or another appears twice")
    columns: dict[str, tuple[list[float], list[float]]] = {n: ([], []) for n in header}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise ValueError(
                f"table {file}: line {number} has {len(row)} columns, not {len(header)}"
            )
        for name, text in zip(header, row, strict=True):
            try:
                columns[name][0].append(float(text))
            except ValueError:
                raise ValueError(
                    f"table {file}: line {number}, column {name!r}: {text[:20]!r} is not a number"
                ) from None
            columns[name][1].append(_last_digit(text))
    # a column with all the digits of doubles somewhere has them everywhere: 0.25 is then exact
    return {
        name: (np.array(v), np.array(e) * (0.0 if 0.0 in e else 1.0))
        for name, (v, e) in columns.items()
    }


def _last_digit(text: str) -> float:
    """Half a unit of the last digit of a decimal; 0 where it has the digits of a double."""
    mantissa, _, exponent = text.strip().lower().partition("e")
    digits = mantissa.lstrip("+-").replace(".", "").lstrip("0")
    if len(digits) >= 15:
        return 0.0
    decimals = len(mantissa.partition(".")[2])
    # a short decimal such as 0.5 may be exact or rounded: it is allowed to be either
    return float(0.5 * 10.0 ** (int(exponent or 0) - decimals))


def _readable(file: Path) -> None:
    if not file.is_file():
        raise ValueError(f"table {file}: no such file")
    if file.stat().st_size > MAX_FILE:
        raise ValueError(f"table {file}: larger than {MAX_FILE} bytes")


def _said(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:150]}" if text else type(error).__name__


def _kind(value: Any) -> str:
    dtype = getattr(value, "dtype", None)
    if dtype is None:
        return f"an object of type {type(value).__name__}"
    return "integers" if dtype.kind in "iu" else f"an array of type {dtype}"


def node_spacing(samples: Samples) -> float:
    """The distance of nodes between which the callable is a straight line; 0 if it is not."""
    if samples.function is None:
        return 0.0
    end, top = samples.support[1], float(np.max(np.abs(samples.w)))
    q = (np.arange(256) + 0.37) / 257 * end
    step = end * 2.0**-16
    bend = np.abs(
        samples.function(q - step, 1.0)
        - 2 * samples.function(q, 1.0)
        + samples.function(q + step, 1.0)
    )
    straight = bend < 16 * samples.unit * top
    curved = np.abs(np.gradient(np.gradient(samples.w, samples.q), samples.q)) * step**2
    if np.mean(straight) < 0.6 or np.mean(curved > 64 * samples.unit * top) < 0.3:
        return 0.0
    fine = np.linspace(0.2, 0.5, 40_001) * end
    bend = np.abs(np.diff(samples.function(fine, 1.0), 2))
    kinks = np.nonzero(bend > 64 * samples.unit * top)[0]
    kinks = kinks[np.concatenate([[True], np.diff(kinks) > 2])]
    if len(kinks) < 4:
        return 0.0
    return float(np.max(np.diff(kinks)) * (fine[1] - fine[0]))
