"""For the test-suites of other codes: an exact oracle in one line.

>>> from sphtrunc.testing import assert_kernel
>>> def hat(q):
...     return max(0.0, 1.0 - q)
>>> assert_kernel(hat, "b-spline:2", dim=1).clean
True
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from sphtrunc.audit import Audit, audit
from sphtrunc.audit.recognition import same_shape
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy


def assert_kernel(
    function: Callable[..., Any] | str,
    kernel: Kernel | str,
    dim: int,
    signature: str | None = None,
    derivative: Callable[..., Any] | str | None = None,
    support: object = None,
    second_derivative: Callable[..., Any] | str | None = None,
) -> Audit:
    """Raise AssertionError unless the callable is that kernel, normalised, with those derivatives.

    signature: "w(q)", "W(r,h)", …; None: by the names of the arguments. Of callables that take h
        the powers of h are checked, in W and in the derivatives
    support: of the callable in units of its h, as a number, "1" or "5/2"; None: any

    The message is the whole audit. Returns the audit, for its other findings.

    Raises ValueError where the callable cannot be used at all.
    """
    wanted = parse_kernel(kernel)
    report = audit(function, dim, signature, derivative, second_derivative=second_derivative)
    problems = [f"{f.kind}: {f.message}" for f in report.faults]
    if report.kernel != wanted.name and not _same(report.kernel, wanted):
        problems.append(f"it is {report.kernel or 'not recognised'}, not {wanted.name}")
    if support is not None:
        from sphtrunc.kernels.arguments import rational

        end = support if isinstance(support, float) else float(rational(support, "support"))
        if abs(report.support / end - 1) > 1e-6:
            problems.append(f"its support is {report.support:.9g}h, not {end:.9g}h")
    if problems:
        raise AssertionError("; ".join(problems) + "\n" + report.to_text())
    return report


def _same(name: str, wanted: Kernel) -> bool:
    try:
        return same_shape(parse_kernel(name), wanted)
    except ValueError:
        return False


def kernels(
    most_pieces: int = 4, most_degree: int = 6, continuous: bool = True
) -> SearchStrategy[Kernel]:
    """A Hypothesis strategy of exact kernels: random knots and rational pieces, normalisable.

    continuous: w is continuous, and vanishes at the edge of its support.
    """
    from hypothesis import strategies as st
    from sympy import QQ, Poly

    from sphtrunc.kernels.piecewise import q

    fractions = st.fractions(min_value=-4, max_value=4, max_denominator=12)

    @st.composite
    def drawn(draw: Any) -> Kernel:
        count = draw(st.integers(1, most_pieces))
        gaps = draw(
            st.lists(
                st.fractions(min_value="1/4", max_value=2, max_denominator=6),
                min_size=count,
                max_size=count,
            )
        )
        knots = [sum(gaps[:i], start=type(gaps[0])(0)) for i in range(count + 1)]
        pieces: list[Poly] = []
        value = Poly(0, q, domain=QQ)
        for end in reversed(knots[1:]):
            table = draw(st.lists(fractions, min_size=1, max_size=most_degree + 1))
            piece = Poly([_exact(c) for c in table], q, domain=QQ)
            if continuous:  # every piece ends where the next one begins
                piece = piece + value.eval(_exact(end)) - piece.eval(_exact(end))
            pieces.insert(0, piece)
            value = piece
        shape = _built(knots, pieces)
        from hypothesis import assume

        assume(shape is not None)
        return shape  # type: ignore[return-value]

    return drawn()


def _exact(value: Any) -> Any:
    from sympy import Rational

    return Rational(value.numerator, value.denominator)


def _built(knots: list[Any], pieces: list[Any]) -> Kernel | None:
    try:
        kernel = Kernel(knots, pieces, name="drawn")
        for dim in (1, 2, 3):
            kernel.normalisation(dim)
    except ValueError:
        return None
    return kernel
