"""Contents: what is in a file of particles, and which kernel its densities were summed with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphtrunc.scenes.snapshots.formats import read
from sphtrunc.scenes.snapshots.snapshot import Snapshot
from sphtrunc.scenes.spacing import Spacing, spacing, tree
from sphtrunc.study.snapshots.saved_sums import (
    FITS,
    FORCES_FIT,
    Identification,
    identify_density,
    identify_forces,
    named_otherwise,
)
from sphtrunc.version import __version__

if TYPE_CHECKING:
    from sphtrunc.arithmetic.summation import Array

SCHEMA = "sphtrunc.inspect/1"
_COUNTED = 4096  # targets whose neighbours are counted
_QUANTILES = {"min": 0.0, "1%": 0.01, "median": 0.5, "99%": 0.99, "max": 1.0}


@dataclass(frozen=True, eq=False)
class Contents:
    """What `inspect` found. Lengths are in the unit of the file.

    spacing: distances to the nearest neighbours; identified: of the densities, and forces: of the
    accelerations, None where there are none; why: a sentence on each
    neighbours: quantiles of the particles within `support_over_h`·h, the particle counted
    h_over_dx: quantiles of h (ρ/m)^(1/d), or of h over the distance to the nearest neighbour
    """

    path: str
    snapshot: Snapshot
    spacing: Spacing
    identified: Identification | None
    forces: Identification | None
    why: Mapping[str, str]
    neighbours: Mapping[str, float] | None
    h_over_dx: Mapping[str, float] | None

    def to_dict(self) -> dict[str, Any]:
        """The keys of `inspect --format json`."""
        it = self.snapshot
        box = None
        if it.box is not None:
            box = {
                "low": it.box.low.tolist(),
                "size": it.box.size.tolist(),
                "periodic": it.box.periodic.tolist(),
            }
        columns = {**dict(zip(it.axes, it.x, strict=True)), **it.fields}
        named = None if self.identified is None else self.identified.to_dict()
        return {
            "schema": SCHEMA,
            "sphtrunc": __version__,
            "file": Path(self.path).name,
            "format": it.format,
            "code": it.code,
            "dim": it.dim,
            "axes": list(it.axes),
            "particles": dict(it.counts),
            "read": it.count,
            "targets": int(np.count_nonzero(it.target)),
            "box": box,
            "fields": {
                name: {"min": float(values.min()), "max": float(values.max())}
                for name, values in columns.items()
            },
            "ignored": list(it.ignored),
            "spacing": {"min": self.spacing.least, "median": self.spacing.median},
            "pairs_close": self.spacing.close,
            "duplicates": self.spacing.coincident,
            "h_over_dx": self.h_over_dx,
            "neighbours": self.neighbours,
            "identified": named,
            "closest": None if self.identified is None else self.identified.best.to_dict(),
            "gradient": None if self.forces is None else self.forces.to_dict(),
            "header_kernel": it.kernel,
            "agrees": _agrees(self),
            "why": dict(self.why),
            "notes": list(it.notes),
        }

    def to_json(self) -> str:
        """Schema sphtrunc.inspect/1."""
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)

    def to_text(self) -> str:
        """What a person wants to know of the file."""
        it = self.snapshot
        kinds = ", ".join(f"{count:,} {name}" for name, count in it.counts.items())
        if list(it.counts) == ["0"]:
            kinds = f"{it.count:,}"
        lines = [
            f"{Path(self.path).name}: {it.format}, {it.code or 'code not told'}, {it.dim}D",
            f"  particles   {kinds}; {np.count_nonzero(it.target):,} targets",
        ]
        if it.box is not None:
            sides = " × ".join(f"{side:.6g}" for side in it.box.size)
            along = [a for a, p in zip(it.axes, it.box.periodic, strict=True) if p]
            said = f"periodic along {', '.join(along)}" if along else "open"
            low = ", ".join(f"{x:.6g}" for x in it.box.low)
            lines.append(f"  box         {sides} from ({low}), {said}")
        columns = {**dict(zip(it.axes, it.x, strict=True)), **it.fields}
        for i, (name, values) in enumerate(columns.items()):
            head = "fields" if not i else ""
            lines.append(
                f"  {head:<11} {name:<12} {float(values.min()):>13.6g} … {float(values.max()):.6g}"
            )
        if it.ignored:
            lines.append(f"  ignored     {', '.join(it.ignored)}")
        found = self.spacing
        lines += [
            f"  spacing     to the nearest neighbour: least {found.least:.4g}, median"
            f" {found.median:.4g}",
            f"              {found.close:,} pairs closer than half of the median;"
            f" {found.coincident:,} particles coincide with another",
        ]
        if self.h_over_dx is not None:
            shown = ", ".join(f"{name} {value:.4g}" for name, value in self.h_over_dx.items())
            lines.append(f"  h/Δx        {shown}")
        if self.neighbours is not None:
            counts = dict(self.neighbours)
            reach = counts.pop("support_over_h")
            shown = ", ".join(f"{name} {value:.4g}" for name, value in counts.items())
            lines.append(f"  neighbours  within {reach:.7g} h: {shown}")
        lines += [f"  {name:<11} {said}" for name, said in self.why.items()]
        lines += [f"  note        {note}" for note in it.notes]
        return "\n".join(lines)


def inspect(
    path: str | Path,
    *,
    type: str | None = None,
    dim: int | None = None,
    columns: Mapping[str, str] | None = None,
    period: object = None,
    h: float | None = None,
) -> Contents:
    """What is in a file of particles.

    Arguments as for `snapshot`; duplicates are counted, not refused.

    Raises ValueError, naming the file and the reason, for a file that cannot be read whole.
    """
    found = read(path, type=type, dim=dim, columns=columns, period=period, h=h)
    if found.count < 2:
        raise ValueError(f"{str(path)[:200]}: it has one particle; expected neighbours")
    distances = spacing(found.x, found.period)
    density, forces, ratios = None, None, None
    if "h" in found.fields:
        scene = found.particles(allow_duplicates=True)
        density, forces = identify_density(found, scene), identify_forces(found, scene)
        dx = _spacings(found, distances)
        if dx is not None:
            ratios = _quantiles((found.fields["h"] / dx)[found.target])
    contents = Contents(str(path), found, distances, density, forces, {}, None, ratios)
    return replace(contents, why=_why(contents), neighbours=_neighbours(found, density))


def _quantiles(values: Array) -> dict[str, float]:
    found = np.quantile(values, list(_QUANTILES.values()))
    return dict(zip(_QUANTILES, found.tolist(), strict=True))


def _spacings(snapshot: Snapshot, distances: Spacing) -> Array | None:
    """Δx of every particle: the root of its volume, or the typical distance to a neighbour."""
    known = snapshot.fields
    if "volume" in known:
        return np.asarray(known["volume"] ** (1.0 / snapshot.dim))
    if "mass" in known and "density" in known:
        return np.asarray((known["mass"] / known["density"]) ** (1.0 / snapshot.dim))
    return np.full(snapshot.count, distances.median) if distances.median > 0 else None


def _neighbours(snapshot: Snapshot, density: Identification | None) -> dict[str, float] | None:
    """How many particles the support of the kernel holds; 2h where it is not known."""
    if "h" not in snapshot.fields:
        return None
    ratio = density.best.support_over_h if density is not None and density.fits else 2.0
    near, unit, _ = tree(snapshot.x, snapshot.period)
    among = np.flatnonzero(snapshot.target)
    among = among[np.linspace(0, among.size - 1, min(_COUNTED, among.size)).astype(np.int64)]
    radius = ratio * snapshot.fields["h"][among] * unit
    period = snapshot.period
    if period is not None and 2.0 * float(radius.max()) >= float(period.min()) * unit:
        return None
    counts = near.query_ball_point(near.data[among], radius, return_length=True)
    return {"support_over_h": ratio, **_quantiles(np.asarray(counts, dtype=np.float64))}


def _agrees(contents: Contents) -> bool | None:
    """Whether the header names the kernel that was found; None where one of the two is missing."""
    named, found = contents.snapshot.kernel, contents.identified
    if named is None or found is None or not found.fits:
        return None
    return not named_otherwise(named, [found.best.kernel])


def _why(contents: Contents) -> dict[str, str]:
    """A sentence on what was identified, or on why nothing was."""
    it, known = contents.snapshot, contents.snapshot.fields
    said = {}
    if "h" not in known:
        said["kernel"] = "not identified: the file has no smoothing length; --h H gives one"
    elif "density" not in known:
        said["kernel"] = "not identified: the file has no density"
    elif contents.identified is None:
        said["kernel"] = "not identified: no support of the catalogue fits between the particles"
    else:
        said["kernel"] = _sentence(contents.identified, "densities", FITS)
        if "mass" not in known:
            said["kernel"] += "; the file has no masses: they are taken as equal"
    if contents.forces is not None:
        said["gradient"] = _sentence(contents.forces, "accelerations", FORCES_FIT)
        said |= _apart(contents.identified, contents.forces)
    agrees = _agrees(contents)
    if it.kernel is not None:
        verdict = {
            True: "as found",
            False: "the densities say otherwise: they were summed with another kernel",
            None: "not checked",
        }[agrees]
        said["header"] = f"names {it.kernel!r}: {verdict}"
    return said


def _apart(density: Identification | None, forces: Identification) -> dict[str, str]:
    """Of two identified kernels that are not the same, that they are not."""
    if density is None or not (density.fits and forces.fits):
        return {}
    one, other = density.best, forces.best
    if (one.kernel, one.support_over_h) == (other.kernel, other.support_over_h):
        return {}
    told = (
        f"W of the densities is {one.kernel}, W′ of the accelerations is that of {other.kernel}:"
        " what the forces conserve is no energy of these densities"
    )
    return {"operators": told}


def _sentence(found: Identification, what: str, limit: float) -> str:
    best, other = found.best, found.next
    pair = f"{best.kernel}, support {best.support_over_h:.7g} h"
    second = f"{other.kernel}, {other.support_over_h:.7g} h: {other.residual:.1e}"
    how = "" if best.mode == "gather" else f", {best.mode} of the two h"
    if found.fits:
        return f"{pair}{how} (residual {best.residual:.1e}; next {second})"
    if best.residual <= limit:
        return (
            f"not identified: several kernels give the {what} ({pair}: {best.residual:.1e};"
            f" {second}), as they do on a lattice"
        )
    reason = {
        "densities": "they evolved by the continuity equation, come from an equation of state, or"
        " from a kernel that is not in the catalogue",
        "accelerations": "there is more in them than pressure, such as viscosity or gravity",
    }[what]
    nearest = f"nearest {pair}: {best.residual:.1e}"
    return f"not identified: no kernel gives the {what} ({nearest}): {reason}"
