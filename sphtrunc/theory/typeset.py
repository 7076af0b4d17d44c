"""Typesetting of a derivation: as text for a terminal, as LaTeX for a paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from math import isfinite
from typing import TYPE_CHECKING, Any

from sympy import Expr, Poly, Rational, latex

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.gaussian import Gaussian
from sphtrunc.operators.moments import label
from sphtrunc.operators.operator import NESTED, Operator

if TYPE_CHECKING:
    from sphtrunc.theory.derivation import Derivation, Varying

WIDTH = 100  # columns of a terminal
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_SUBSCRIPT = str.maketrans("0123456789-", "₀₁₂₃₄₅₆₇₈₉₋")
_PRIMES = {0: "", 1: "′", 2: "″", 3: "‴"}


def text(d: Derivation) -> str:
    """What a person reads first; at most 100 columns, deterministic."""
    blocks = [
        _kernel_text(d),
        _smoothness_text(d),
        _smoothing_text(d),
        _varying_text(d.varying, d.dim) if d.varying is not None else "",
        _discretisation_text(d) if d.dim == 1 and d.varying is None else "",
        _aliasing_text(d) if d.aliasing is not None else "",
        _table_text(d) if d.discrete is not None else "",
        _scatter_text(d) if d.scatter is not None else "",
    ]
    return "\n\n".join(block for block in blocks if block)


def _kernel_text(d: Derivation) -> str:
    kernel, dim = d.kernel, d.dim
    reach = "infinite" if kernel.boundary_smoothness == float("inf") else f"{kernel.support}h"
    lines = [f"{kernel.name}: W(r, h) = σ h{_power(-dim)} w(q), q = r/h, support {reach}"]
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
        f"Ŵ(0) = {_plain(sigma * kernel.central(dim))}",
        f"∫s²Ŵ = {_plain(kernel.moment(2, dim))}",
    ]
    return "\n".join([*lines, *_wrapped(constants, "  ", "   ")])


def _smoothness_text(d: Derivation) -> str:
    kernel = d.kernel
    at = kernel.knot_smoothness()
    least = min(at.values())
    limiting = {knot for knot, n in at.items() if n == least}
    if d.dim > 1:
        order = None if d.aliasing is None else d.aliasing.order
        limiting = set() if order is None else {Rational(p) for p, _ in order.limits}
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
        limits = "  ← limits the order" if knot in limiting else ""
        lines.append(f"  q = {knot!s:<6} {place:<9} {says}{limits}")
    return "\n".join(lines)


def _smoothing_text(d: Derivation) -> str:
    rows = d.smoothing_error
    name = _estimate(d.operator, d.dim)
    exact = _derivative(d.operator.derivatives, d.operator, d.dim)
    terms = [exact]
    for n, p, c in rows:
        terms.append(_signed(_product(c, [_h(p), _derivative(n, d.operator, d.dim)])))
    terms.append("+ …")
    head = f"Smoothing error of the {_title(d.operator)}, {d.dim}D: "
    head += (
        f"order h{_power(d.orders.smoothing)}"
        if d.orders.smoothing
        else "it does not vanish with h"
    )
    return "\n".join([head, *_wrapped(terms, f"  {name} = ", " ")])


def _varying_text(v: Varying, dim: int) -> str:
    slope = ", ".join(str(g) for g in v.gradient)
    lines = [
        f"With h(x) = h (1 + g·s), g = {slope if dim == 1 else f'({slope})'}, rule {v.rule}: the"
        " continuous limit"
    ]
    for alpha, value in v.limit.values.items():
        text = str(value) if isinstance(value, Rational) else f"{float(value):.12f}"
        powers = [
            _signed(_product(c, ["g" + (_power(n) if n > 1 else "")] if n else []))
            for n, c in enumerate(v.series.get(alpha, ()))
            if c != 0
        ]
        shown = "" if isinstance(value, Rational) else " ".join([*powers, "+ …"]).removeprefix("+ ")
        lines.append(f"  M({label(alpha)})".ljust(12) + f"{text:<18}{shown}".rstrip())
    return "\n".join(lines)


def _discretisation_text(d: Derivation) -> str:
    if isinstance(d.kernel, Gaussian):
        return _gaussian_text(d, d.kernel)
    generic, aligned = d.orders.generic, d.orders.aligned
    kappa = 2 * d.kernel.support
    lines = ["Discretisation error of uniform particles, exact at every ratio"]
    if not d.own_terms:
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
    if not d.operator.uncorrected:
        what = "corrected" if d.operator.form != NESTED else "nested"
        lines.append(f"  the {what} moments are rational functions of the sums m[δ, k] below")
    shown = _leading_terms(d)
    if shown:
        lines.append("  leading terms, with B̃ₙ the periodic Bernoulli polynomials:")
        lines += shown
        powers = {t.dx_power for t in d.own_terms}
        lines.append(
            f"  and {len(d.own_terms)} terms in all, up to (Δx/h){_power(max(powers))}:"
            " --format json has them"
        )
    return "\n".join(lines)


def _gaussian_text(d: Derivation, kernel: Gaussian) -> str:
    text = "Discretisation error of uniform particles: exp(−π² h²/Δx²), smaller than any power"
    if kernel.cut is None:
        return text
    jump = float(kernel.edge_jump(1))
    return (
        f"{text}, but for the cut:\n  Ŵ jumps by {jump:.3g} at q = {kernel.cut}, an error of"
        " order Δx/h (second at the aligned ratios) times that jump,\n  which overtakes below"
        f" Δx/h = π/{kernel.cut}, where exp(−π² h²/Δx²) = exp(−{kernel.cut}²)"
    )


def _leading_terms(d: Derivation) -> list[str]:
    lines: list[str] = []
    plain = d.operator.uncorrected
    for (term, k), (n, left) in d.leading_terms.items():
        name = f"M{_sub(k)}" if plain else f"m[{_sum_label(term)}, {k}]"
        parts = [_signed(_product(c, [_wave(n, p, d.offset)])) for p, c in left.items()]
        parts[0] = parts[0].removeprefix("+ ")
        parts[-1] += "] + …"
        lines += _wrapped(parts, f"    {name} − limit = (Δx/h){_power(n)} [", " ")
        if len(lines) > 12:
            break
    return lines


def _aliasing_text(d: Derivation) -> str:
    """The order of the error on a lattice, the shells it comes from, and the other lattices."""
    found = d.aliasing
    assert found is not None
    name = f"M({label(found.moment)})"
    lines = [f"Discretisation error on a lattice, leading moment {name}:"]
    if found.order is not None:
        power = found.order.power
        lines[0] += (
            f" order (Δx/h){f'^({power})' if power.denominator > 1 else _superscript(power)}"
        )
        limits = [f"Ŵ{_primes(m)} at q = {p}" for p, m in found.order.limits]
        lines += _wrapped(limits, "  from what jumps first: ", ", ")
    elif isinstance(d.kernel, Gaussian) and d.kernel.cut is None and d.operator.uncorrected:
        lines[0] += " falls faster than any power"
    if found.shells:
        lines.append(
            "  shells of the reciprocal lattice, |G| h, vectors, what they add to the moment:"
        )
        lines += [f"  {s.length:<10.5g}{s.count:<6d}{s.contribution: .6e}" for s in found.shells]
        rest = f"at most {found.tail:.1e}" if isfinite(found.tail) else "no bound is known"
        lines.append(f"  all others: {rest}")
    if found.ranking:
        lines.append("  at equal number density, the most accurate lattice first:")
        lines += [
            f"  {r.lattice:<10}{r.error:.4e}   shortest |G| Δx {r.shortest:.4f}, {r.count} vectors"
            for r in found.ranking
        ]
    return "\n".join(lines)


def _table_text(d: Derivation) -> str:
    assert d.discrete is not None
    where = f"θ = {d.offset}"
    if d.dim > 1:
        offset = f", offset ({', '.join(map(str, d.shift))})" if any(d.shift) else ""
        where = f"{d.lattice} lattice{offset}"
    if d.volume != "constant":
        where += f", volumes {d.volume}"
    title = (
        f"Discrete moments at Δx/h = {d.dx_over_h}, {where}"
        "\n  (smoothing: limit − exact value; discretisation: M − limit)"
    )
    rows = [("k", "M_k", "exact value", "smoothing", "discretisation")]
    limit_error = d.continuous.error
    for alpha, value in (d.discrete - d.continuous).items():
        exact = d.discrete.exact.get(alpha, 0)
        if d.dim > 1 and not any((exact, d.discrete[alpha], limit_error[alpha])):
            continue  # in 1D the zeros are shown, in space there are too many
        rows.append(
            (
                label(alpha),
                _number(d.discrete[alpha]),
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


def _scatter_text(d: Derivation) -> str:
    scatter = d.scatter
    assert scatter is not None
    lines = [
        f"Moments of particles displaced by σ = {scatter.jitter or 0:g} Δx, {scatter.distribution}",
        *_wrapped([*scatter.how.split(" ")], "  by ", " "),
    ]
    alike = max(map(len, d.alike), default=1) > 1
    lines.append(
        "  k          mean                 standard deviation" + "   equal by symmetry" * alike
    )
    for first, *others in d.alike:
        row = f"  {label(first):<9}  {scatter.mean[first]:<19.12g}  {scatter.std[first]:<18.6g}"
        names = [label(alpha) for alpha in others]
        lines += [line.rstrip() for line in _wrapped(["", *names], row, "   ")]
    return "\n".join(lines)


# -- LaTeX --------------------------------------------------------------------------------


def fragment(d: Derivation) -> str:
    """A fragment for a document with amsmath: the kernel, the error and the moments."""
    kernel, dim = d.kernel, d.dim
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
        f"\\[\n{smoothing(d)}\n\\]",
    ]
    lines = _discretisation_latex(d)
    if lines:
        parts.append("\\begin{align*}\n" + " \\\\\n".join(lines) + "\n\\end{align*}")
    if d.discrete is not None:
        rows = [rf"M_{{{k}}} &= {latex(d.discrete[k])}" for k in d.discretisation]
        ratio = latex(d.dx_over_h)
        parts.append(
            rf"With $\Delta x/h = {ratio}$, $\theta = {latex(d.offset)}$:"
            "\n\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"
        )
    return "\n".join(parts)


def smoothing(d: Derivation) -> str:
    second = r"\nabla^{2} A" if d.operator.name == "laplacian" else r"\nabla\nabla A"
    field = {0: "A", 1: r"\nabla A", 2: second}
    if d.dim == 1:
        field = {0: "A", 1: "A'", 2: "A''"}
    exact = field[d.operator.derivatives]
    text = rf"\langle {exact} \rangle = {exact}"
    for n, p, c in d.smoothing_error:
        of = f"A^{{({n})}}" if d.dim == 1 else rf"\nabla^{{{p}}} {exact}"
        of = exact if p == 0 else f"h^{{{p}}} {of}"
        text += f" {'-' if c < 0 else '+'} {latex(abs(c))} {of}"
    return text + r" + \cdots"


def _discretisation_latex(d: Derivation) -> list[str]:
    lines = []
    plain = d.operator.uncorrected
    for (term, k), terms in d.terms_by_sum.items():
        name = f"M_{{{k}}}" if plain else f"m_{{{_sum_label(term)},{k}}}"
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


def sum_name(term: Any) -> str:
    return term if isinstance(term, str) else ("value", "gradient", "hessian")[sum(term)]


def _sum_label(term: Any) -> str:
    return term if isinstance(term, str) else str(sum(term))


def finite(value: float) -> int | str:
    return "infinite" if value == float("inf") else int(value)


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
    return "" if n == 1 else _superscript(n)


def _superscript(n: object) -> str:
    return str(n).translate(_SUPERSCRIPT)


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
        return _decimal(fraction(value))
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
