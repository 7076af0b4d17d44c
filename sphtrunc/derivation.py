"""Derivation: a derived truncation error, and how it is read: as text, LaTeX or JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

from sympy import Expr, Poly, Rational, latex

from sphtrunc import __version__
from sphtrunc.bernoulli import phased
from sphtrunc.gaussian import Gaussian
from sphtrunc.kernel import Kernel
from sphtrunc.moments import Moments, MultiIndex, label, unit
from sphtrunc.operators import FATEHI_MANZARI, Operator

WIDTH = 100  # columns of a terminal
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_SUBSCRIPT = str.maketrans("0123456789-", "₀₁₂₃₄₅₆₇₈₉₋")
_PRIMES = {0: "", 1: "′", 2: "″", 3: "‴"}


@dataclass(frozen=True)
class Term:
    """One term of the discretisation error of a base sum in 1D.

    It adds coefficient · (Δx/h)^dx_power · B̃_dx_power(knot·h/Δx − θ) to m[term, moment]
    (see `sphtrunc.operators`); for an operator without correction that sum is M_moment itself.
    """

    term: Any
    moment: int
    dx_power: int
    knot: Rational
    coefficient: Rational


class Orders(NamedTuple):
    """Orders of an error.

    smoothing: power of h of the leading smoothing error (0: it does not vanish with h)
    generic, aligned: power of Δx/h of the leading discretisation error, at a generic ratio and at
        Δx/h = 2κ/n, n odd (None: there is none, or it was not derived)
    """

    smoothing: int
    generic: int | None
    aligned: int | None


@dataclass(frozen=True)
class Scatter:
    """Moments over the targets of a disordered scene.

    jitter: σ/Δx; distribution: of the displacements; mean, std: multi-index -> float
    how: the level of the theory behind them
    """

    jitter: float
    distribution: str
    mean: Mapping[MultiIndex, float]
    std: Mapping[MultiIndex, float]
    how: str


@dataclass(frozen=True)
class Derivation:
    """The derived truncation error of one kernel and one operator.

    limit: moments for Δx/h → 0; their error is the smoothing error
    terms: the discretisation error of the base sums in 1D, each exact
    shift: the offset along every axis, of which `offset` is the first; lattice; volume: their rule
    discrete: the moments at the given Δx/h and offset (None without a ratio)
    scatter: their mean and spread where the particles are displaced, if that was asked for
    find_orders: derives `orders` when they are first asked for
    """

    kernel: Kernel | Gaussian
    operator: Operator
    dim: int
    degree: int
    limit: Moments
    terms: tuple[Term, ...]
    dx_over_h: Expr | None
    offset: Rational
    shift: tuple[Rational, ...]
    lattice: str
    volume: str
    discrete: Moments | None
    find_orders: Callable[[], Orders] = field(repr=False, compare=False)
    scatter: Scatter | None = None

    @cached_property
    def orders(self) -> Orders:
        """The orders of the error, read off exact coefficients."""
        return self.find_orders()

    @property
    def smoothing_error(self) -> list[tuple[int, int, Rational]]:
        """Rows (n, p, c): the estimate has the error c h^p A^{(n)} (in d > 1: c h^p ∇^p D A)."""
        k = self.operator.derivatives
        rows = []
        for alpha, c in self.limit.taylor().items():
            if alpha == unit(self.dim, 0, sum(alpha)) and c != 0:
                rows.append((sum(alpha), sum(alpha) - k, c))
        return rows

    @property
    def discretisation(self) -> dict[Any, Any]:
        """M_k at Δx/h minus its limit for Δx/h → 0; ValueError if no ratio was given."""
        if self.discrete is None:
            raise ValueError(
                "derivation: no ratio Δx/h was given, so there are no discrete moments"
            )
        differences = (self.discrete - self.limit).items()
        return {alpha[0] if self.dim == 1 else alpha: value for alpha, value in differences}

    @property
    def _plain(self) -> bool:
        """The weights are the kernel's own, so that the sums are the moments."""
        return self.operator.correction == "none" and self.operator.form != FATEHI_MANZARI

    @property
    def _own_terms(self) -> list[Term]:
        """The terms of the moments that the estimate has: not M_0 of a difference form."""
        if self.operator.correction == "none" and self.operator.uses_difference:
            return [t for t in self.terms if t.moment > 0]
        return list(self.terms)

    # -- JSON -------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """The contract of schema `sphtrunc.derive/1`; every exact number is a string."""
        kernel, dim = self.kernel, self.dim
        sigma = kernel.normalisation(dim)
        orders = {
            "smoothing": self.orders.smoothing,
            "discretisation_generic": self.orders.generic,
            "discretisation_aligned": self.orders.aligned,
        }
        result: dict[str, Any] = {
            "schema": "sphtrunc.derive/1",
            "kernel": {
                "name": kernel.name,
                "source": kernel.source,
                "support": str(kernel.support),
                "knots": [str(k) for k in kernel.knots],
                "pieces": [[str(c) for c in piece] for piece in kernel.coefficients()],
            },
            "dim": dim,
            "operator": self.operator.name,
            "form": self.operator.form,
            "correction": self.operator.correction,
            "degree": self.degree,
            "normalisation": str(sigma),
            "w0": str(sigma * _central(kernel, dim)),
            "boundary_smoothness": _finite(kernel.boundary_smoothness),
            "smoothness": _finite(kernel.smoothness),
            "jumps": [
                {"knot": str(knot), "derivative": m, "jump": str(jump)}
                for m in range(kernel.degree + 1)
                for knot, jump in kernel.jumps(m).items()
                if jump != 0
            ],
            "kernel_moments": {
                str(n): str(kernel.moment(n, dim)) for n in range(0, self.degree + 1, 2)
            },
            "gradient_moments": {
                str(n): str(kernel.gradient_moment(n, dim)) for n in range(1, self.degree + 1, 2)
            },
            "smoothing_error": [
                {"derivative": n, "h_power": p, "coefficient": str(c)}
                for n, p, c in self.smoothing_error
            ],
            "discretisation_terms": [
                {
                    "sum": _sum_name(t.term),
                    "moment": t.moment,
                    "dx_power": t.dx_power,
                    "knot": str(t.knot),
                    "coefficient": str(t.coefficient),
                }
                for t in self._own_terms
            ],
            "orders": orders,
        }
        if self.discrete is not None:
            result["dx_over_h"] = str(self.dx_over_h)
            result["offset"] = str(self.offset)
            if self.dim > 1:
                result["offset"] = [str(x) for x in self.shift]
            result["lattice"] = self.lattice
            result["volume"] = self.volume
            result["discrete_moments"] = self.discrete.to_dict()
            result["predicted"] = self._predicted()
        return {**result, "version": __version__}

    def _predicted(self) -> dict[str, Any]:
        """Mean and standard deviation over targets: of the lattice itself, or under disorder."""
        assert self.discrete is not None
        if self.scatter is None:
            mean = {a: float(m) for a, m in self.discrete.values.items()}
            std = dict.fromkeys(mean, 0.0)
            more: dict[str, Any] = {"jitter": 0.0, "how": "lattice sum"}
        else:
            mean, std = dict(self.scatter.mean), dict(self.scatter.std)
            more = {
                "jitter": self.scatter.jitter,
                "distribution": self.scatter.distribution,
                "how": self.scatter.how,
            }
        return {**more, "moments": {label(a): {"mean": mean[a], "std": std[a]} for a in mean}}

    def to_json(self) -> str:
        """`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False)

    # -- text -------------------------------------------------------------------------------------

    def to_text(self) -> str:
        """What a person reads first; at most 100 columns, deterministic."""
        blocks = [
            self._kernel_text(),
            self._smoothness_text(),
            self._smoothing_text(),
            self._discretisation_text() if self.dim == 1 else "",
            self._table_text() if self.discrete is not None else "",
            self._scatter_text() if self.scatter is not None else "",
        ]
        return "\n\n".join(block for block in blocks if block)

    def __str__(self) -> str:
        return self.to_text()

    def _kernel_text(self) -> str:
        kernel, dim = self.kernel, self.dim
        lines = [
            f"{kernel.name}: W(r, h) = σ h{_power(-dim)} w(q), q = r/h, support {_reach(kernel)}"
        ]
        if kernel.source:
            lines += _wrapped([kernel.source], "  ", " ")
        if isinstance(kernel, Gaussian):
            lines.append(f"  w = {kernel.formula(dim)}")
        bounds = [f"{a} ≤ q ≤ {b}" for a, b in zip(kernel.knots, kernel.knots[1:], strict=False)]
        wide = max(len(b) for b in bounds)
        for bound, piece in zip(bounds, kernel.pieces, strict=bool(kernel.pieces)):
            head = f"  {bound:<{wide}}  w = "
            lines += _wrapped(_polynomial_terms(piece), head, " ")
        sigma = kernel.normalisation(dim)
        constants = [
            f"σ = {_plain(sigma)} in {dim}D",
            f"Ŵ(0) = {_plain(sigma * _central(kernel, dim))}",
            f"∫s²Ŵ = {_plain(kernel.moment(2, dim))}",
        ]
        return "\n".join([*lines, *_wrapped(constants, "  ", "   ")])

    def _smoothness_text(self) -> str:
        kernel = self.kernel
        at = kernel.knot_smoothness()
        least = min(at.values())
        lines = [
            f"Smoothness: β = {kernel.boundary_smoothness} at the edge,"
            f" {kernel.smoothness} over all knots"
        ]
        if least == float("inf"):
            return "Smoothness: all derivatives are continuous, and there is no edge"
        for knot, n in at.items():
            place = "origin" if knot == 0 else "edge" if knot == kernel.support else "interior"
            first = int(n) + 1 if n != float("inf") else None
            if first is None:
                says = "all derivatives continuous"
            else:
                jump = kernel.jumps(first)[knot]
                says = f"Ŵ{_primes(first)} is the first to jump, by {_number(jump)} in 1D"
            limits = "  ← limits the order" if n == least else ""
            lines.append(f"  q = {knot!s:<6} {place:<9} {says}{limits}")
        return "\n".join(lines)

    def _smoothing_text(self) -> str:
        rows = self.smoothing_error
        name = _estimate(self.operator, self.dim)
        exact = _derivative(self.operator.derivatives, self.operator, self.dim)
        terms = [exact]
        for n, p, c in rows:
            terms.append(_signed(_product(c, [_h(p), _derivative(n, self.operator, self.dim)])))
        terms.append("+ …")
        head = f"Smoothing error of the {_title(self.operator)}, {self.dim}D: "
        head += (
            f"order h{_power(self.orders.smoothing)}"
            if self.orders.smoothing
            else "it does not vanish with h"
        )
        return "\n".join([head, *_wrapped(terms, f"  {name} = ", " ")])

    def _discretisation_text(self) -> str:
        if isinstance(self.kernel, Gaussian):
            return self._gaussian_text(self.kernel)
        generic, aligned = self.orders.generic, self.orders.aligned
        kappa = 2 * self.kernel.support
        lines = ["Discretisation error of uniform particles, exact at every ratio"]
        if not self._own_terms:
            lines[0] += ": there is none"
        elif generic is None:
            lines[0] += ": none to first order"
        else:
            lines.append(f"  order (Δx/h){_power(generic)} at a generic ratio")
            if aligned is None:
                lines.append(f"  none at the aligned ratios Δx/h = {kappa}/n, n odd")
            else:
                lines.append(
                    f"  order (Δx/h){_power(aligned)} at the aligned ratios Δx/h = {kappa}/n, n odd"
                )
        if not self._plain:
            lines.append("  the corrected moments are rational functions of the sums m[δ, k] below")
        shown = self._leading_terms()
        if shown:
            lines.append("  leading terms, with B̃ₙ the periodic Bernoulli polynomials:")
            lines += shown
            powers = {t.dx_power for t in self._own_terms}
            lines.append(
                f"  and {len(self._own_terms)} terms in all, up to (Δx/h){_power(max(powers))}:"
                " --format json has them"
            )
        return "\n".join(lines)

    def _gaussian_text(self, kernel: Gaussian) -> str:
        text = "Discretisation error of uniform particles: exp(−π² h²/Δx²), smaller than any power"
        if kernel.cut is None:
            return text
        jump = float(kernel.edge_jump(1))
        return (
            f"{text}, but for the cut:\n  Ŵ jumps by {jump:.3g} at q = {kernel.cut}, an error of"
            " order Δx/h (second at the aligned ratios) times that jump,\n  which overtakes below"
            f" Δx/h = π/{kernel.cut}, where exp(−π² h²/Δx²) = exp(−{kernel.cut}²)"
        )

    def _leading_terms(self) -> list[str]:
        lines: list[str] = []
        plain = self._plain
        for (derivative, k), terms in self._grouped().items():
            name = f"M{_sub(k)}" if plain else f"m[{derivative}, {k}]"
            for n in sorted({t.dx_power for t in terms}):
                row = {t.knot: t.coefficient for t in terms if t.dx_power == n}
                left = phased(row, n, self.offset)
                if left:
                    parts = [
                        _signed(_product(c, [_wave(n, p, self.offset)])) for p, c in left.items()
                    ]
                    parts[0] = parts[0].removeprefix("+ ")
                    parts[-1] += "] + …"
                    lines += _wrapped(parts, f"    {name} − limit = (Δx/h){_power(n)} [", " ")
                    break
            if len(lines) > 12:
                break
        return lines

    def _grouped(self) -> dict[tuple[str, int], list[Term]]:
        groups: dict[tuple[str, int], list[Term]] = {}
        for t in self._own_terms:
            groups.setdefault((_sum_label(t.term), t.moment), []).append(t)
        return groups

    def _table_text(self) -> str:
        assert self.discrete is not None
        where = f"θ = {self.offset}"
        if self.dim > 1:
            offset = f", offset ({', '.join(map(str, self.shift))})" if any(self.shift) else ""
            where = f"{self.lattice} lattice{offset}"
        if self.volume != "constant":
            where += f", volumes {self.volume}"
        title = (
            f"Discrete moments at Δx/h = {self.dx_over_h}, {where}"
            " (smoothing: limit − exact value; discretisation: M − limit)"
        )
        rows = [("k", "M_k", "exact value", "smoothing", "discretisation")]
        limit_error = self.limit.error
        for alpha, value in (self.discrete - self.limit).items():
            exact = self.discrete.exact.get(alpha, 0)
            if self.dim > 1 and not any((exact, self.discrete[alpha], limit_error[alpha])):
                continue  # in 1D the zeros are shown, in space there are too many
            rows.append(
                (
                    label(alpha),
                    _number(self.discrete[alpha]),
                    str(exact),
                    _number(limit_error[alpha]),
                    _number(value),
                )
            )
        widths = [max(len(row[i]) for row in rows) for i in range(5)]
        return "\n".join(
            [
                title,
                *(
                    "  " + "  ".join(f"{c:>{w}}" for c, w in zip(r, widths, strict=True)).rstrip()
                    for r in rows
                ),
            ]
        )

    def _scatter_text(self) -> str:
        scatter = self.scatter
        assert scatter is not None
        lines = [
            f"Moments of particles displaced by σ = {scatter.jitter:g} Δx, {scatter.distribution}"
            f" ({scatter.how})",
            "  k          mean                 standard deviation",
        ]
        for alpha, mean in scatter.mean.items():
            if mean or scatter.std[alpha]:
                lines.append(f"  {label(alpha):<9}  {mean:<19.12g}  {scatter.std[alpha]:.6g}")
        return "\n".join(lines)

    # -- LaTeX ------------------------------------------------------------------------------------

    def to_latex(self) -> str:
        """A fragment for a document with amsmath: the kernel, the error and the moments."""
        kernel, dim = self.kernel, self.dim
        cases = " \\\\\n".join(
            rf"{latex(piece.as_expr())} & {latex(a)} \le q \le {latex(b)}"
            for a, b, piece in zip(kernel.knots, kernel.knots[1:], kernel.pieces, strict=False)
        )
        if isinstance(kernel, Gaussian):
            cases = rf"{latex(kernel.expression(dim))} & q \le {latex(kernel.support)}"
        sigma = latex(kernel.normalisation(dim))
        parts = [
            "\\[\n"
            rf"W(r, h) = \frac{{\sigma}}{{h^{{{dim}}}}}\, w(q), \quad q = \frac{{r}}{{h}}, \quad"
            rf" \sigma = {sigma}, \quad w(q) = \begin{{cases}}"
            f"\n{cases} \\\\\n"
            rf"0 & q > {latex(kernel.support)}"
            "\n\\end{cases}\n\\]",
            f"\\[\n{self._smoothing_latex()}\n\\]",
        ]
        lines = self._discretisation_latex()
        if lines:
            parts.append("\\begin{align*}\n" + " \\\\\n".join(lines) + "\n\\end{align*}")
        if self.discrete is not None:
            rows = [rf"M_{{{k}}} &= {latex(self.discrete[k])}" for k in self.discretisation]
            ratio = latex(self.dx_over_h)
            parts.append(
                rf"With $\Delta x/h = {ratio}$, $\theta = {latex(self.offset)}$:"
                "\n\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"
            )
        return "\n".join(parts)

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {self._smoothing_latex()}$"

    def _smoothing_latex(self) -> str:
        second = r"\nabla^{2} A" if self.operator.name == "laplacian" else r"\nabla\nabla A"
        field = {0: "A", 1: r"\nabla A", 2: second}
        if self.dim == 1:
            field = {0: "A", 1: "A'", 2: "A''"}
        exact = field[self.operator.derivatives]
        text = rf"\langle {exact} \rangle = {exact}"
        for n, p, c in self.smoothing_error:
            of = f"A^{{({n})}}" if self.dim == 1 else rf"\nabla^{{{p}}} {exact}"
            of = exact if p == 0 else f"h^{{{p}}} {of}"
            text += f" {'-' if c < 0 else '+'} {latex(abs(c))} {of}"
        return text + r" + \cdots"

    def _discretisation_latex(self) -> list[str]:
        lines = []
        plain = self._plain
        for (derivative, k), terms in self._grouped().items():
            name = f"M_{{{k}}}" if plain else f"m_{{{derivative},{k}}}"
            for i, n in enumerate(sorted({t.dx_power for t in terms})):
                inner = " ".join(
                    rf"{'-' if t.coefficient < 0 else '+'} {latex(abs(t.coefficient))}"
                    rf" \widetilde{{B}}_{{{n}}}\!\left({_phase(t.knot)}\right)"
                    for t in terms
                    if t.dx_power == n
                ).removeprefix("+ ")
                head = rf"{name} - \lim {name} &= " if i == 0 else "&\\quad + "
                lines.append(
                    rf"{head}\left(\frac{{\Delta x}}{{h}}\right)^{{{n}}} \Bigl[ {inner} \Bigr]"
                )
        return lines


# -- writing ------------------------------------------------------------------------------------


def _wave(n: int, knot: Rational, theta: Rational) -> str:
    """B̃ₙ(p h/Δx − θ)."""
    factor = {1: "", -1: "−"}.get(knot, f"{knot} ".replace("-", "−"))
    shift = "" if theta == 0 else f" {'−' if theta > 0 else '+'} {abs(theta)}"
    argument = f"{factor}h/Δx{shift}" if knot else shift.strip().replace("− ", "−") or "0"
    return f"B̃{_sub(n)}({argument})"


def _phase(knot: Rational) -> str:
    if knot == 0:
        return r"-\theta"
    factor = {1: "", -1: "-"}.get(knot, latex(knot))
    return rf"{factor} \tfrac{{h}}{{\Delta x}} - \theta"


def _sum_name(term: Any) -> str:
    return term if isinstance(term, str) else ("value", "gradient", "hessian")[sum(term)]


def _sum_label(term: Any) -> str:
    return term if isinstance(term, str) else str(sum(term))


def _finite(value: float) -> int | str:
    return "infinite" if value == float("inf") else int(value)


def _reach(kernel: Any) -> str:
    return f"{kernel.support}h" if kernel.boundary_smoothness != float("inf") else "infinite"


def _central(kernel: Kernel | Gaussian, dim: int) -> Any:
    """w(0) of the shape."""
    return kernel.central(dim) if isinstance(kernel, Gaussian) else kernel.pieces[0].eval(0)


def _title(operator: Operator) -> str:
    corrected = "" if operator.correction == "none" else f", {operator.correction}"
    return f"{operator.name} ({operator.form} form{corrected})"


def _estimate(operator: Operator, dim: int) -> str:
    return f"⟨{_derivative(operator.derivatives, operator, dim)}⟩"


def _derivative(n: int, operator: Operator, dim: int) -> str:
    if dim == 1:
        return f"A{_primes(n)}"
    if operator.name == "laplacian":
        return f"∇{_power(n)}A"
    even = n - operator.derivatives
    laplacians = f"∇{_power(even)}" if even else ""
    return f"{laplacians}{'∇' * operator.derivatives}A"


def _primes(n: int) -> str:
    return _PRIMES.get(n, f"⁽{str(n).translate(_SUPERSCRIPT)}⁾")


def _power(n: int) -> str:
    return "" if n == 1 else str(n).translate(_SUPERSCRIPT)


def _sub(n: int) -> str:
    return str(n).translate(_SUBSCRIPT)


def _h(p: int) -> str:
    return f"h{_power(p)}" if p else ""


def _plain(value: Expr) -> str:
    return str(value).replace("**", "^").replace("*", "·").replace("pi", "π")


def _number(value: Expr) -> str:
    """The exact number if it is short, else its first digits."""
    text = str(value)
    if len(text) <= 20:
        return text
    if value.is_Rational:
        return _decimal(Fraction(int(value.p), int(value.q)))
    return f"{value.evalf(13)}"


def _decimal(value: Fraction) -> str:
    """12 significant digits; no overflow however long the fraction is."""
    exponent = 0
    if value:
        size = abs(value)
        exponent = len(str(size.numerator)) - len(str(size.denominator))
        if size < Fraction(10) ** exponent:
            exponent -= 1
    if -5 < exponent < 12:
        return f"{float(value):.12g}"
    digits = float(value / Fraction(10) ** exponent)
    return f"{digits:.12g}e{exponent:+03d}"


def _product(c: Expr, factors: Iterable[str]) -> str:
    """Coefficient and factors, without a factor of one."""
    words = [f for f in factors if f]
    number = _number(c)
    if words and number in ("1", "-1"):
        number = number.removesuffix("1")
        return number + " ".join(words)
    if "/" in number and words:
        sign = "-" if number.startswith("-") else ""
        number = f"{sign}({number.removeprefix('-')})"
    return " ".join([number, *words])


def _signed(text: str) -> str:
    return f"− {text.removeprefix('-')}" if text.startswith("-") else f"+ {text}"


def _polynomial_terms(piece: Poly) -> list[str]:
    terms = []
    for (m,), c in reversed(piece.terms()):
        power = f"q{_power(m)}" if m else ""
        number = str(abs(c)) if abs(c) != 1 or not m else ""
        terms.append(f"{'−' if c < 0 else '+'} {' '.join(x for x in (number, power) if x)}")
    first = terms[0]
    terms[0] = first.removeprefix("+ ") if first.startswith("+") else "−" + first[2:]
    return terms


def _wrapped(parts: Sequence[str], head: str, join: str) -> list[str]:
    """The parts behind the head, broken between parts so that no line passes the width."""
    lines, line = [], head
    for i, part in enumerate(parts):
        glue = "" if line.endswith(("= ", "[")) or not line.strip() or i == 0 else join
        if len(line) + len(glue) + len(part) > WIDTH and line.strip() and i:
            lines.append(line)
            line, glue = " " * min(len(head), 30), ""
        while len(line) + len(glue) + len(part) > WIDTH and len(line) < WIDTH - 10:
            cut = WIDTH - len(line) - len(glue)
            space = part.rfind(" ", 0, cut)
            cut = space if space > 0 else cut
            lines.append(line + glue + part[:cut])
            part, line, glue = part[cut:].lstrip(), " " * min(len(head), 30), ""
        line += glue + part
    return [*lines, line]
