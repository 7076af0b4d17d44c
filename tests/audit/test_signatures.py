"""How callables are called: by the names of their arguments, or as they say; errors name q."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
import pytest

from sphtrunc.audit import audit, faults
from sphtrunc.audit.signatures import given, of
from sphtrunc.testing import assert_kernel


def w(r: float, h: float) -> float:
    """M4 in 3D."""
    q = r / h
    return (max(2 - q, 0.0) ** 3 / 4 - max(1 - q, 0.0) ** 3) / (pi * h**3)


def dw(r: float, h: float) -> float:
    q = r / h
    return (3 * max(1 - q, 0.0) ** 2 - 3 / 4 * max(2 - q, 0.0) ** 2) / (pi * h**4)


def gradient(xij: list[float], rij: float, h: float, grad: list[float]) -> None:
    """As PySPH writes it: into its last argument."""
    factor = dw(rij, h) / rij if rij > 1e-12 else 0.0
    for i in range(3):
        grad[i] = factor * xij[i]


class Spline:
    """As PySPH writes a kernel: made for a dimension, called with a separation first."""

    def __init__(self, dim: int = 1) -> None:
        self.constant = {1: 2 / 3, 2: 10 / (7 * pi), 3: 1 / pi}[dim]
        self.dim = dim

    def kernel(self, xij: Any = (0.0, 0, 0), rij: float = 1.0, h: float = 1.0) -> float:
        assert len(xij) == 3
        q = rij / h
        shape = max(2 - q, 0.0) ** 3 / 4 - max(1 - q, 0.0) ** 3
        return self.constant / h**self.dim * shape


WRITTEN: dict[str, tuple[Callable[..., Any], str]] = {
    "(r, h)": (lambda r, h: w(r, h), "(r, h)"),
    "(h, r)": (lambda h, r: w(r, h), "(h, r)"),
    "(q)": (lambda q: w(q, 1.0), "(q)"),
    "(x)": (lambda x: w(x, 1.0), "(x)"),
    "(a, b)": (lambda a, b: w(a, b), "(a, b)"),
    "(dist, hsml, ndim)": (lambda dist, hsml, ndim: w(dist, hsml) if ndim == 3 else 0.0, "(dist"),
    "(xij, rij, h)": (lambda xij, rij, h: w(rij, h), "(xij, rij, h)"),
    "(r, eps=0, h=1)": (lambda r, eps=0.0, h=1.0: w(r, h) + eps, "(r, h)"),
    "(r, *, h)": (lambda r, *, h: w(r, h), "(r, h)"),
    "(rij, h_ij)": (lambda rij, h_ij: w(rij, h_ij), "(rij, h_ij)"),
    "(*args)": (lambda *args: w(args[0], 1.0), "(q)"),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_arguments_are_known_by_their_names_and_that_is_said(name: str) -> None:
    function, said = WRITTEN[name]
    report = audit(function, 3)
    assert report.clean, report.to_text()
    assert report.kernel == "cubic-spline"
    assert report.signature.startswith(said)
    assert "assumed; say another by `signature`" in report.signature
    assert ("h^" in report.scaling) == ("h" in of(function, "it").meanings)


def test_a_kernel_and_its_gradient_as_pysph_writes_them() -> None:
    report = assert_kernel(lambda xij, rij, h: w(rij, h), "cubic-spline", 3, derivative=gradient)
    assert report.derivative == "the derivative of W"
    for dim in (1, 2, 3):
        assert audit(Spline(dim).kernel, dim).clean


def test_a_class_is_made_for_the_dimension(tmp_path: Any, monkeypatch: Any) -> None:
    (tmp_path / "of_pysph.py").write_text(
        "class Hat:\n"
        "    def __init__(self, dim=1):\n"
        "        self.c = {1: 1, 2: 3 / 3.141592653589793, 3: 3 / 3.141592653589793}[dim]\n"
        "        self.dim = dim\n"
        "    def kernel(self, xij=[0., 0, 0], rij=1.0, h=1.0):\n"
        "        return self.c / h**self.dim * max(1 - rij / h, 0.0)\n"
    )
    monkeypatch.chdir(tmp_path)
    for dim in (1, 2, 3):
        assert audit("of_pysph:Hat.kernel", dim).clean


def test_what_is_said_wins_over_the_names() -> None:
    """The first argument is called h, and is the distance."""
    wrong_names = lambda h, r: w(h, r)  # noqa: E731
    assert audit(wrong_names, 3, "W(r,h)").clean
    assert audit(lambda r: w(r, 1.0), 3, "w(q)").clean


@pytest.mark.parametrize(
    "text", ["W(x,h)", "W(r,q)", "W(r,r)", "W(h)", "W", "W(r,h", "W(r,h);x", "(r,h)"]
)
def test_a_signature_that_says_too_little_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"signature: got .* expected \"W\(r,h\)\""):
        given(text)


def test_arguments_that_say_too_little_are_asked_for() -> None:
    with pytest.raises(ValueError, match=r"of its arguments \(a, b, c\) it is not clear"):
        audit(lambda a, b, c: 0.0, 3)


def test_a_kernel_that_does_not_end_says_how_it_was_called() -> None:
    with pytest.raises(ValueError, match=r"called as \(r, h\).*say another by `signature`"):
        audit(lambda r, h: np.exp(-r / h / 100), 3)


def test_a_division_by_zero_names_its_place() -> None:
    with pytest.raises(ValueError, match=r"ZeroDivisionError: .* at q = 0, h = 1"):
        audit(lambda r, h: float(h) / float(r), 3)
    with pytest.raises(ValueError, match=r"the derivative: raised ZeroDivisionError.* at q = 2"):
        audit(w, 3, derivative=lambda r, h: dw(r, h) / (0.0 if r >= 2 * h else 1.0))


def test_a_derivative_by_q_is_told_from_one_by_r() -> None:
    """PySPH's dwdq is h times dW/dr."""
    (fault,) = audit(w, 3, derivative=lambda rij, h: dw(rij, h) * h).faults
    assert fault.kind == faults.POWER_OF_H
    assert "did you return dW/dq?" in fault.message
