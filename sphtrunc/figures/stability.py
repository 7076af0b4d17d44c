"""Figures of stability: dispersion, tension, pairing, remedies, time steps.

Lines are the dispersion relation; points are the accelerations of periodic particles, linearised by
a complex step, and growth in runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import ceil, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.experiment.accelerations import cell, fluid_on, growth_rate, wave_matrix
from sphtrunc.figures.picture import Curve, Field, Panel, Picture, measured, predicted
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.forces import ArtificialStress, force
from sphtrunc.scenes.sites import units
from sphtrunc.study.stability import courant, lowest, ratio_of, stability_map, waves
from sphtrunc.theory.dispersion.brillouin import inside, scale
from sphtrunc.theory.dispersion.modes import LONGITUDINAL, TRANSVERSE, Rest, continuous, eigenvalues

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.kernels.kernel import Kernel

    Array = NDArray[np.float64]

K = r"$k\Delta x/\pi$"
RELATIVE = r"$\omega^2/(c^2k^2)$"
RATE = r"growth rate / $(c/h)$"
DX = r"$\Delta x/h$"
TENSION = r"tension $-P_0/(\rho c^2)$"
#: what a growth rate is drawn as where nothing grows
CALM = 1e-2


def _rest(kernel: Kernel | Gaussian, ratio: Fraction, p: Fraction | int, **more: Any) -> Rest:
    kind, form = more.pop("kind", "uniform"), more.pop("form", "symmetric")
    return Rest(kernel, kind, ratio, force(form), Fraction(p), **more)


def _relative(rest: Rest, k: Array) -> Array:
    """ω²/(c²k²) of the least mode at k in π/Δx on a line."""
    seen = rest.frequencies(rest.scan(k[:, None]))
    return np.asarray(seen.omega2.min(axis=1) / seen.k**2)


def _box(rest: Rest, whole: int) -> tuple[int, ...]:
    """Rectangular cells along each axis: a multiple of `whole`, more than twice the support."""
    reach = 2.001 * float(rest.kernel.support) / float(rest.ratio)
    size = [c * float(u) for c, u in zip(cell(rest.kind), units(rest.kind), strict=True)]
    return tuple(whole * ceil(reach / (s * whole)) for s in size)


def _fluid(rest: Rest, whole: int) -> tuple[Any, Any]:
    return fluid_on(
        rest.kernel,
        rest.kind,
        rest.ratio,
        rest.force,
        rest.pressure,
        cells=_box(rest, whole),
        stress=rest.stress,
        density=rest.volume,
    )


def _seen(rest: Rest, kappa: Sequence[Fraction]) -> Any:
    """ω² of one wave from the accelerations, in c²/h², (nd,)."""
    whole = max((c * n / 2).denominator for c, n in zip(kappa, cell(rest.kind), strict=True))
    fluid, site = _fluid(rest, whole)
    k = np.array([float(c) for c in kappa]) * scale(rest.kind)
    matrix = wave_matrix(fluid, k, site)
    return eigenvalues(matrix.real if rest.dim == 1 else matrix) / float(rest.ratio) ** 2


def _seen_relative(rest: Rest, k: Sequence[Fraction]) -> list[float]:
    """ω²/(c²k²) from the accelerations, at k in π/Δx on a line."""
    return [
        float(_seen(rest, (c,)).min()) / (float(c * Fraction(np.pi)) / float(rest.ratio)) ** 2
        for c in k
    ]


def _wavenumbers(quick: bool) -> tuple[Array, list[Fraction]]:
    line = np.linspace(0.005, 1.0, 80 if quick else 200)
    return line, [Fraction(j, 12) for j in range(2, 13, 4 if quick else 2)]


def _named(shape: Kernel | Gaussian, ratio: Fraction, more: str = "") -> str:
    return rf"1D, {shape.name}, $\Delta x/h = {ratio.numerator}/{ratio.denominator}${more}"


def dispersion(kernel: str | None, quick: bool) -> Picture:
    """ω²/(c²k²) against k for forms and for pressures, with the continuous limit."""
    shape = parse_kernel(kernel or "cubic-spline")
    ratio = Fraction(5, 6)
    line, points = _wavenumbers(quick)

    def curves(rows: dict[str, Rest]) -> list[Curve]:
        found: list[Curve] = []
        for label, rest in rows.items():
            at = np.array([float(c) for c in points])
            found.append(predicted(label, line, _relative(rest, line)))
            seen = _seen_relative(rest, points)
            found.append(measured(label, at, seen, predicted=_relative(rest, at), floor=1e-12))
        return found

    forms = {
        f"{form}, p = {p}": _rest(shape, ratio, Fraction(p), form=form)
        for form, p in (
            ("symmetric", "1"),
            ("grad-h", "1"),
            ("csph-symmetric", "1"),
            ("difference", "1"),
            ("csph", "1"),
        )
    }
    pressures = {f"p = {p}": _rest(shape, ratio, Fraction(p)) for p in ("0", "3/5", "1", "-1/2")}
    kh = tuple(float(v) for v in line * np.pi / float(ratio))
    limits = [
        predicted(f"continuous limit, p = {p}", line, continuous(shape, 1, p, kh)) for p in (0, 1)
    ]
    panels = tuple(
        Panel(
            K,
            RELATIVE,
            tuple(rows),
            title=title,
            xscale="linear",
            yscale="linear",
            legend="lower left",
        )
        for title, rows in (
            ("forms", curves(forms)),
            ("symmetric form, pressures", [*curves(pressures), *limits]),
        )
    )
    return Picture("dispersion", _named(shape, ratio), panels)


def _field(rest: Rest, quick: bool) -> Field:
    """Growth over Δx/h × P₀."""
    n = 40 if quick else 100
    most = 0.95 * float(rest.kernel.support)
    if rest.dim == 1:
        ratios = np.linspace(0.3, min(1.5, most), n)
    else:
        most_, least = (200, 20) if rest.dim == 3 else (80, 8)
        ends = [ratio_of(rest.kernel, rest.dim, count) for count in (most_, least)]
        ratios = np.linspace(ends[0], ends[1], n)
    found = stability_map(
        rest, [float(r) for r in ratios], [float(p) for p in np.linspace(-1.0, 0.5, n)]
    )
    rates = np.maximum(found.growth_rate, CALM)
    return Field(found.dx_over_h, found.pressure, rates, r"$\log_{10}$ growth rate $/(c/h)$")


def map_of(rest: Rest, name: str) -> Picture:
    """The map of one form: growth over Δx/h × P₀."""
    panel = Panel(
        DX,
        r"$P_0/(\rho c^2)$",
        (),
        title="the fastest growing wave",
        xscale="linear",
        yscale="linear",
        field=_field(rest, quick=False),
    )
    where = "sc" if rest.kind == "cubic" else rest.kind
    return Picture(name, f"{rest.kernel.name}, {where}, form {rest.force.name}", (panel,))


def _growth(rest: Rest) -> float:
    """The largest growth rate over the zone, in c/h."""
    return float(rest.frequencies(rest.scan(waves(rest.kind))).growth.max())


def _run(rest: Rest) -> tuple[float, float]:
    """The growth rate of the fastest wave with a short period, seen in a run, and derived."""
    kappa = [Fraction(j, 12) for j in range(1, 13)]
    rates = rest.frequencies(rest.scan([[float(c)] for c in kappa])).growth[:, 0]
    fastest = kappa[int(rates.argmax())]
    fluid, _ = _fluid(rest, (fastest / 2).denominator)
    shape = np.cos(fluid.start * float(fastest) * np.pi)
    rate = float(rates.max())
    seen = growth_rate(fluid, shape, 0.05 / (rate * float(rest.ratio)), factor=10)
    return seen / float(rest.ratio), rate


def tensile(kernel: str | None, quick: bool) -> Picture:
    """Swegle's map: growth over Δx/h × P₀, and cuts through it with growth seen in runs."""
    shape = parse_kernel(kernel or "cubic-spline")
    base = _rest(shape, Fraction(5, 6), -1)
    chart = Panel(
        DX,
        r"$P_0/(\rho c^2)$",
        (),
        title="growth rate of the fastest wave",
        xscale="linear",
        yscale="linear",
        field=_field(base, quick),
    )
    most = min(1.5, 0.95 * float(shape.support))
    line = [Fraction(float(r)).limit_denominator(1000) for r in np.linspace(0.3, most, 60)]
    points = [Fraction(float(r)).limit_denominator(60) for r in np.linspace(0.5, most, 4)]
    curves: list[Curve] = []
    for p in (Fraction(-1, 10), Fraction(-1)):
        label = rf"$P_0 = {float(p):g}\,\rho c^2$"
        row = [_growth(replace(base, ratio=r, pressure=p)) for r in line]
        curves.append(predicted(label, [float(r) for r in line], row))
        settings = [replace(base, ratio=r, pressure=p) for r in points]
        runs = [_run(one) for one in settings if _growth(one) > 0.05]
        at = [float(one.ratio) for one in settings if _growth(one) > 0.05]
        curves.append(
            measured(label, at, [s for s, _ in runs], predicted=[derived for _, derived in runs])
        )
    cuts = Panel(DX, RATE, tuple(curves), title="cuts", xscale="linear", legend="lower right",
                 ylim=(0.1, 5))  # fmt: skip
    return Picture("tensile", f"Tensile instability in 1D, {shape.name}", (chart, cuts))


def pairing(kernel: str | None, quick: bool) -> Picture:
    """The weakest waves of a small box against the number of neighbours, on fcc."""
    names = {
        "cubic-spline": "M4",
        "quartic-spline": "M5",
        "quintic-spline": "M6",
        "wendland-c2": "C2",
        "wendland-c4": "C4",
        "wendland-c6": "C6",
    }
    if kernel is not None:
        names = {kernel: parse_kernel(kernel).name}
    elif quick:
        names = {name: names[name] for name in ("cubic-spline", "wendland-c2")}
    halves = [
        tuple(Fraction(j, 2) for j in row)
        for row in product(range(3), repeat=3)
        if any(row) and list(row) == sorted(row, reverse=True)
    ]
    kappa = [k for k in halves if inside("fcc", k)]
    line = np.geomspace(30, 300, 60 if quick else 150)
    points = (75,) if quick else (50, 75, 110)
    curves: dict[str, list[Curve]] = {LONGITUDINAL: [], TRANSVERSE: []}
    for name, label in names.items():
        shape = parse_kernel(name)
        rest = _rest(shape, Fraction(5, 6), Fraction(3, 5), kind="fcc")
        scan = rest.scan(
            [[float(c) for c in k] for k in kappa],
            float(shape.support) / ratio_of(shape, 3, line[-1]),
        )

        def at(count: float, rest: Rest = rest, scan: Any = scan) -> Any:
            ratio = Fraction(ratio_of(rest.kernel, 3, count))
            return replace(rest, ratio=ratio).frequencies(scan)

        for branch, rows in curves.items():
            values = [float((lowest(at(n), branch) / at(n).k ** 2).min()) for n in line]
            rows.append(predicted(label, line, values))
            seen, derived = [], []
            for n in points:
                found = at(n)
                one = int((lowest(found, branch) / found.k**2).argmin())
                value = float(lowest(found, branch)[one])
                exact = replace(rest, ratio=Fraction(ratio_of(shape, 3, n)))
                answer = _seen(exact, kappa[one])
                k2 = float(found.k[one]) ** 2
                seen.append(float(answer[np.abs(answer - value).argmin()]) / k2)
                derived.append(value / k2)
            rows.append(measured(label, points, seen, predicted=derived, floor=1e-9))
    panels = tuple(
        Panel(
            "neighbours",
            f"least {RELATIVE}",
            tuple(rows),
            title=f"{branch}: " + ("pairing below 0" if branch == LONGITUDINAL else "shear of fcc"),
            yscale="linear",
            ylim=limits,
            legend="upper right",
        )
        for (branch, rows), limits in zip(
            curves.items(), ((-0.01, 0.04), (-0.06, 0.06)), strict=True
        )
    )
    return Picture("pairing", r"fcc, $P_0 = 3/5\,\rho c^2$: waves of a small box", panels)


def remedies(kernel: str | None, quick: bool) -> Picture:
    """What holds particles under tension, and growth with and without it."""
    shape = parse_kernel(kernel or "cubic-spline")
    ratio, p = Fraction(5, 6), Fraction(-1, 5)
    line, points = _wavenumbers(quick)
    rows = {
        "none": _rest(shape, ratio, p),
        r"artificial stress, $\epsilon = 0.05$": _rest(
            shape, ratio, p, stress=ArtificialStress(Fraction(1, 20))
        ),
        r"artificial stress, $\epsilon = 0.2$": _rest(
            shape, ratio, p, stress=ArtificialStress(Fraction(1, 5))
        ),
        "total Lagrangian": _rest(shape, ratio, p, form="total-lagrangian"),
        "stress points": _rest(shape, ratio, p, form="stress-points"),
    }
    at = np.array([float(c) for c in points])
    left: list[Curve] = []
    for label, rest in rows.items():
        left.append(predicted(label, line, _relative(rest, line)))
        seen = _seen_relative(rest, points)
        left.append(measured(label, at, seen, predicted=_relative(rest, at), floor=1e-12))
    tension = np.geomspace(0.01, 3, 30 if quick else 60)
    some = [Fraction(1, 50), Fraction(1, 5), Fraction(2)]
    right: list[Curve] = []
    for label, rest in list(rows.items())[:2]:
        rates = [_growth(replace(rest, pressure=-Fraction(float(t)))) for t in tension]
        right.append(predicted(label, tension, rates))
        runs = [_run(replace(rest, pressure=-t)) for t in some]
        right.append(
            measured(
                label,
                [float(t) for t in some],
                [s for s, _ in runs],
                predicted=[derived for _, derived in runs],
            )
        )
    panels = (
        Panel(K, RELATIVE, tuple(left), title=r"$P_0 = -0.2\,\rho c^2$", xscale="linear",
              yscale="linear", legend="lower left"),
        Panel(TENSION, RATE, tuple(right), title="growth in runs", legend="upper left"),
    )  # fmt: skip
    return Picture("remedies", _named(shape, ratio), panels)


def time_step(kernel: str | None, quick: bool) -> Picture:
    """The largest cΔt/h of leapfrog against Δx/h, for pressures and for kernels."""
    shape = parse_kernel(kernel or "cubic-spline")
    scan_of = [Fraction(j, 20) for j in range(1, 21)]
    kappa = np.array([[float(c)] for c in scan_of])

    def curves(rows: dict[str, Rest]) -> list[Curve]:
        found: list[Curve] = []
        for label, rest in rows.items():
            most = min(1.5, 0.95 * float(rest.kernel.support))
            ratios = [Fraction(float(r)).limit_denominator(50) for r in np.linspace(0.5, most, 5)]
            line = sorted({*map(float, ratios), *np.linspace(0.4, most, 40 if quick else 120)})
            values = []
            for r in line:
                one = replace(rest, ratio=Fraction(float(r)))
                values.append(
                    _step(float(one.frequencies(one.scan(waves("uniform"))).omega2.max()))
                )
            found.append(predicted(label, line, values))
            seen, derived = [], []
            for r in ratios:
                one = replace(rest, ratio=r)
                omega2 = one.frequencies(one.scan(kappa)).omega2[:, 0]
                top = scan_of[int(omega2.argmax())]
                seen.append(_step(float(_seen(one, (top,)).max())))
                derived.append(_step(float(omega2.max())))
            found.append(measured(label, [float(r) for r in ratios], seen, predicted=derived))
        return found

    pressures = {f"p = {p}": _rest(shape, Fraction(5, 6), Fraction(p)) for p in ("0", "3/5", "1")}
    others = ["cubic-spline", "quintic-spline", "wendland-c2-1d", "wendland-c4-1d"]
    names = list(dict.fromkeys([shape.name if kernel is None else kernel, *others]))[:4]
    kernels = {
        parse_kernel(name).name: _rest(parse_kernel(name), Fraction(5, 6), Fraction(3, 5))
        for name in names
    }
    panels = tuple(
        Panel(
            DX,
            r"$c\Delta t/h$",
            tuple(rows),
            title=title,
            xscale="linear",
            yscale="linear",
            ylim=limits,
            legend=place,
        )
        for title, rows, limits, place in (
            (f"{shape.name}, pressures", curves(pressures), None, "upper left"),
            (r"kernels, $P_0 = 3/5\,\rho c^2$", curves(kernels), (0.7, 2.0), "upper right"),
        )
    )
    return Picture("time-step", "Leapfrog in 1D: the largest stable time step", panels)


def _step(highest: float) -> float:
    return courant(highest)["leapfrog"] if highest > 0 else sqrt(4 / 1e-12)
