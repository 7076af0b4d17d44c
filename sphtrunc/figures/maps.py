"""Maps: an error map as a picture, one panel for each quantity, the worst particles marked."""

from __future__ import annotations

import io
from math import ceil, floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.output import write_atomically
from sphtrunc.study.snapshots.map_files import shown

if TYPE_CHECKING:
    from sphtrunc.study.snapshots.error_map import ErrorMap

SUFFIXES = (".png", ".svg", ".pdf")
_PANELS = 6
_MARKED = 10
_WIDTH = 4.2  # of a panel, in inches


def draw(found: ErrorMap, path: str | Path) -> None:
    """γ, the lengths of the moment errors, and the errors of fields, over the particles: in 1D
    against x, in 2D in the plane, in 3D in a slice of two smoothing lengths through the middle.

    Raises ValueError where matplotlib is missing, for another suffix than .png, .svg or .pdf, and
    where the file cannot be written.
    """
    suffix = Path(path).suffix
    if suffix not in SUFFIXES:
        raise ValueError(f"picture {path}: expected a name ending in {', '.join(SUFFIXES)}")
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ValueError(
            "picture: needs matplotlib; install it with pip install 'sphtrunc[plot]'"
        ) from None
    panels = _panels(found)
    columns = min(3, len(panels))
    rows = ceil(len(panels) / columns)
    x, inside, said = _seen(found)
    shape = np.ptp(x[inside], axis=0)
    aspect = float(shape[-1] / (shape[0] or 1.0)) if x.shape[1] > 1 else 0.8
    height = float(np.clip(0.8 * _WIDTH * aspect + 0.7, 1.8, 6.0))
    figure = Figure(figsize=(_WIDTH * columns, height * rows + 0.4), layout="constrained")
    for i, (title, values, logarithmic) in enumerate(panels):
        axes = figure.add_subplot(rows, columns, i + 1)
        _panel(figure, axes, x[inside], values[inside], title, logarithmic)
    figure.suptitle(f"{found.kernel}, {found.targets:,} particles{said}", fontsize=11)
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix[1:], dpi=150)
    write_atomically(path, buffer.getvalue())


def _panels(found: ErrorMap) -> list[tuple[str, Any, bool]]:
    """(title, values, whether on a logarithmic scale): no quantity twice, none that is zero."""
    panels: list[tuple[str, Any, bool]] = [("γ = ΣVW", found.gamma, False)]
    arrays = shown(found)
    errors = [name for name in arrays if name.startswith("error of")]
    moments = [name for name in arrays if name[:2] in ("E0", "M1", "M2")]
    for name in [*moments[:2], *errors, *moments[2:]]:
        values = arrays[name]
        if float(np.median(values)) < 1e-10 or len(panels) == _PANELS:
            continue
        if any(np.array_equal(values, other) for _, other, _ in panels):
            continue
        panels.append((name.replace("_", " "), values, True))
    return panels


def _seen(found: ErrorMap) -> tuple[Any, Any, str]:
    """Coordinates in the picture, which targets are in it, and what to say of that."""
    x = found.x
    if x.shape[1] < 3:
        return x, np.ones(len(x), bool), ""
    middle = 0.5 * (x[:, 2].min() + x[:, 2].max())
    thick = float(np.median(found.h))
    inside = np.abs(x[:, 2] - middle) <= thick
    return x[:, :2], inside, f"; slice z = {middle:.4g} ± {thick:.2g}"


def _panel(figure: Any, axes: Any, x: Any, values: Any, title: str, logarithmic: bool) -> None:
    from matplotlib.colors import LogNorm, Normalize

    axes.set_title(title, fontsize=8)
    if x.shape[1] == 1:
        axes.plot(x[:, 0], values, ".", markersize=3, color="#0b3c5d")
        axes.set_yscale("log" if logarithmic else "linear")
        axes.set_xlabel("x")
        return
    low, high = np.quantile(values, [0.01, 0.999]) if values.size else (0.0, 1.0)
    if logarithmic:
        norm: Any = LogNorm(max(low, 1e-4 * high, 1e-300), max(high, 1e-299))
    else:
        norm = Normalize(low, high)
    # as large as the particles are apart, so that they cover the plane
    extent = np.ptp(x, axis=0).max() or 1.0
    size = np.clip((0.9 * 3.0 * 72 / np.sqrt(max(len(x), 1))) ** 2, 0.3, 60)
    order = np.argsort(values if logarithmic else np.abs(values - 1.0), kind="stable")
    drawn = axes.scatter(
        *x[order].T, c=values[order], s=size, norm=norm, cmap="cividis", linewidths=0
    )
    worst = order[-_MARKED:]
    axes.scatter(*x[worst].T, s=size + 60, facecolors="none", edgecolors="#c1121f", linewidths=1.1)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    bar = figure.colorbar(drawn, ax=axes, shrink=0.85)
    bar.ax.tick_params(which="both", labelsize=6)
    _scale_bar(axes, x, extent)


def _scale_bar(axes: Any, x: Any, extent: float) -> None:
    """A bar of a round length below the particles."""
    power = 10.0 ** floor(log10(0.3 * extent))
    length = next(n * power for n in (2.0, 1.0, 0.5) if n * power <= 0.3 * extent)
    left, depth = x[:, 0].min(), max(0.12 * float(np.ptp(x[:, 1])), 0.03 * extent)
    bottom = x[:, 1].min() - depth
    axes.plot([left, left + length], [bottom, bottom], "-", color="black", linewidth=2.5)
    axes.text(left + length, bottom, f"  {length:g}", va="center", fontsize=7)
    axes.set_ylim(bottom - depth, x[:, 1].max() + depth)
