"""Values of somebody's kernel, called where they matter."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphtrunc.audit import signatures
from sphtrunc.audit.signatures import Signature

Array = NDArray[np.floating[Any]]
Function = Callable[[Array, float], Array]  # (q, h) -> h^d W, in float64

MAX_RANGE = 64.0  # a kernel that has not vanished by then has no end
DOUBLE, SINGLE = 2.0**-53, 2.0**-24  # rounding units
#: where the dependence on h is looked at; of two of them, 2h and h² could not be told apart
SMOOTHING_LENGTHS = (1.0, 0.5, 2.0, 3.0)


@dataclass(frozen=True)
class Scaled:
    """Values at one smoothing length, scaled as if they were right.

    q: (n,) r/h; w: (n,) h^d W; dw: (n,) h^(d+1) dW/dr; d2w: (n,) h^(d+2) d²W/dr², or None. For a
    right kernel they do not depend on h. The errors are what the decimals of a table leave open.
    """

    h: float
    q: Array
    w: Array
    dw: Array | None
    d2w: Array | None
    error: Array
    derivative_error: Array
    second_error: Array


@dataclass(frozen=True)
class Samples:
    """A kernel's values in one dimension, q = r/h with the h of whoever wrote it.

    q: (n,) increasing, from 0 on; w: (n,) h^d W; dw: (n,) h^(d+1) dW/dr, d2w: (n,) h^(d+2) d²W/dr²,
        or None
    unit: the rounding unit of the values; error: (n,) what the decimals of a table leave open
    support: the largest q with a value and the smallest one without (equal where bisected)
    declared: precision of the type that came back, DOUBLE or SINGLE
    function: to ask for more values, if there is a callable
    h: the smoothing length they were taken at; None where they do not depend on one
    scaled: values at several smoothing lengths, the first of them h; signature: how it was called
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
    d2w: Array | None = None
    second_error: Array = field(default_factory=lambda: np.zeros(0))
    h: float | None = None
    scaled: tuple[Scaled, ...] = ()
    signature: str = ""
    notes: tuple[str, ...] = ()


def load(path: str, dim: int = 3) -> Callable[..., Any]:
    """The callable that 'package.module:name' or 'package.module:Class.method' names.

    The current directory is searched first, as by `python -m`. The module is imported and nothing
    else of it is called; a method of a class is taken from an instance made without arguments, or
    with `dim` where the class has such an argument.

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
        raise ValueError(f"python: cannot import {module_name!r}: {said(error)}") from None
    for name in names:
        owner = found
        try:
            if inspect.isclass(owner) and inspect.isfunction(inspect.getattr_static(owner, name)):
                owner = _instance(owner, dim)
            found = getattr(owner, name)
        except (Exception, SystemExit) as error:
            raise ValueError(f"python: {path!r}: {said(error)}") from None
    if not callable(found):
        raise ValueError(f"python: {path!r} is a {type(found).__name__}, expected a callable")
    return found  # type: ignore[no-any-return]


def _instance(owner: type, dim: int) -> Any:
    try:
        takes_dim = "dim" in inspect.signature(owner).parameters
    except (TypeError, ValueError):
        takes_dim = False
    return owner(dim=dim) if takes_dim else owner()


class Caller:
    """A callable asked for arrays of values: at once if it can take them, one by one if not."""

    def __init__(
        self, function: Callable[..., Any], signature: Signature, dim: int, order: int, what: str
    ):
        self._function, self.signature, self._dim = function, signature, dim
        self._order, self._what = order, what
        self.scalar = False
        self.declared = DOUBLE

    def scaled(self, q: Array, h: float = 1.0) -> Array:
        """h^(d+order) times its values; they are that already where it takes no h."""
        values = self(q, h)
        return values * h ** (self._dim + self._order) if self.signature.takes_h else values

    def __call__(self, q: Array, h: float = 1.0) -> Array:
        if not self.scalar:
            try:
                return self._checked(self._call(q, h), q)
            except ValueError:
                self.scalar = True
        results = [self._call(float(x), h) for x in q]
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

    def _call(self, q: Any, h: float) -> Any:
        distance = q * h if self.signature.takes_r else q
        if isinstance(distance, np.ndarray):
            distance = distance.copy()
        given, named = self.signature.arguments(distance, h, self._dim)
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                result = self._function(*given, **named)
        except (Exception, SystemExit) as error:
            where = "" if isinstance(q, np.ndarray) else f" at q = {q:.6g}"
            at_h = f", h = {h:g}" if where and self.signature.takes_h else ""
            raise ValueError(f"{self._what}: raised {said(error)}{where}{at_h}") from None
        if "grad" in self.signature.meanings:
            place = self.signature.meanings.index("grad")
            return (given or list(named.values()))[place][0]
        return result

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
    signature: str | None = None,
    derivative: Callable[..., Any] | None = None,
    second_derivative: Callable[..., Any] | None = None,
    points: int = 2000,
    support: float | None = None,
) -> Samples:
    """Call W, dW/dr and d²W/dr² (of w(q): dw/dq and d²w/dq²) where a fault would show.

    signature: as in `signatures.given`, for all of them; None: each by the names of its arguments.
    Evenly over the support, closely about its edge, which is found by bisection, and, of callables
    that take h, at three more h. A callable that takes only numbers is asked at a quarter of the
    points, one by one.

    Raises ValueError for whatever the callable does wrong, in one line.
    """
    given = None if signature is None else signatures.given(signature)

    def caller(one: Callable[..., Any], order: int, what: str) -> Caller:
        return Caller(one, given or signatures.of(one, what), dim, order, what)

    kernel = caller(function, 0, "the kernel")
    slope = caller(derivative, 1, "the derivative") if derivative is not None else None
    bend = (
        caller(second_derivative, 2, "the second derivative")
        if second_derivative is not None
        else None
    )
    callers = [one for one in (kernel, slope, bend) if one is not None]
    try:
        low, high = _edge(kernel.scaled) if support is None else (support, support)
    except ValueError as error:
        raise ValueError(f"{error}; it was called as {kernel.signature.described()}") from None
    points = min(points, 500) if kernel.scalar else points
    spread = (np.arange(points) + 0.5) / points
    edge = 1 - 2.0 ** -np.arange(2.0, 12.0)
    q = np.unique(np.concatenate([[0.0], spread * high, edge * high]))
    w = kernel.scaled(q)
    declared = kernel.declared
    dw, d2w = (
        None if one is None else np.concatenate([[0.0], one.scaled(q[1:])]) for one in (slope, bend)
    )
    depends = any(one.signature.takes_h for one in callers)
    probes = q[1 :: max(1, len(q) // 48)]
    if support is None:
        # beyond the support as well: an end that is a length, not a ratio, shows there
        probes = np.concatenate([probes, high * np.array([1.03, 1.2, 1.7, 2.5])])
    nothing, none = np.zeros_like(probes), np.zeros_like(w)
    scaled = []
    for h in SMOOTHING_LENGTHS if depends else ():
        one, two = (None if f is None else f.scaled(probes, h) for f in (slope, bend))
        scaled.append(
            Scaled(h, probes, kernel.scaled(probes, h), one, two, nothing, nothing, nothing)
        )
    return Samples(
        q=q,
        w=w,
        dw=dw,
        d2w=d2w,
        unit=SINGLE if declared == SINGLE else DOUBLE,
        error=none,
        derivative_error=none,
        second_error=none,
        support=(low, high),
        declared=declared,
        function=kernel.scaled,
        h=1.0 if depends else None,
        scaled=tuple(scaled),
        signature="; ".join(dict.fromkeys(one.signature.described() for one in callers)),
    )


def _edge(function: Function) -> tuple[float, float]:
    """The last q with a value and the next float, which has none."""
    coarse = np.concatenate([[0.0], np.arange(1, 1025) * (MAX_RANGE / 1024)])
    w = function(coarse, 1.0)
    inside = np.nonzero(w)[0]
    if not len(inside):
        raise ValueError(
            "the kernel: is zero everywhere; is a constant such as 2/3 an integer division there,"
            " which gives 0?"
        )
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


def said(error: BaseException) -> str:
    """An exception in one line."""
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
