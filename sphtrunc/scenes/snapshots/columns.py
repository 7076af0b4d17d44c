"""The names that codes give to positions, smoothing lengths, masses, densities and the rest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

AXES = ("x", "y", "z")

#: quantity: (components, 0 for any number of them; the names of its columns, simplified)
QUANTITIES: dict[str, tuple[int, tuple[str, ...]]] = {
    "position": (3, ("position", "positions", "pos", "posd", "coordinates", "coords", "points",
                     "xyz", "r", "x")),
    "x": (1, ("x", "xpos", "xu", "rx", "xcoord", "xcoordinate")),
    "y": (1, ("y", "ypos", "yu", "ry", "ycoord", "ycoordinate")),
    "z": (1, ("z", "zpos", "zu", "rz", "zcoord", "zcoordinate")),
    "h": (1, ("h", "hsml", "hsmooth", "smoothinglength", "smoothinglengths", "smoothlength",
              "smoothl")),
    "volume": (1, ("volume", "volumes", "vol", "volumetricmeasure")),
    "mass": (1, ("m", "mass", "masses", "particlemass")),
    "density": (1, ("rho", "density", "densities", "rhop", "crho", "massdensity")),
    "pressure": (1, ("p", "press", "pressure", "pressures")),
    "energy": (1, ("u", "internalenergy", "internalenergies", "thermalenergy",
                   "specificinternalenergy")),
    "velocity": (3, ("v", "vel", "velocity", "velocities", "vxyz")),
    "acceleration": (3, ("a", "acc", "ace", "acceleration", "accelerations", "axyz")),
    "values": (0, ("values", "value")),
    "id": (1, ("id", "ids", "particleids", "particleid", "idp", "gid", "originalid")),
}  # fmt: skip

#: vector: what its components are called before or after the axis, as in vx or velocity_x
_STEMS = {"velocity": ("v", "vel"), "acceleration": ("a", "acc")}


def simplified(name: str) -> str:
    """The name without its unit, its case and everything that is no letter or digit.

    >>> [simplified(name) for name in ("x[m]", "Points:0", "pos_x", " Rho (kg/m3)")]
    ['x', 'points0', 'posx', 'rho']
    """
    bare = re.sub(r"[\[(].*$", "", name.strip().lower()) or name.lower()
    return "".join(c for c in bare if c.isalnum())


def meaning(name: str, components: int = 1) -> str | None:
    """The quantity that a column of this name holds: one of QUANTITIES, or one of their components
    as velocity.0; None where the name says nothing.

    >>> meaning("Points:2"), meaning("vel_y"), meaning("Velocities", 3), meaning("potential")
    ('z', 'velocity.1', 'velocity', None)
    """
    plain = simplified(name)
    for quantity, (width, names) in QUANTITIES.items():
        if plain in names and (width == 0 or (width > 1) == (components > 1)):
            return quantity
    for quantity, (width, names) in QUANTITIES.items():
        if width < 2 or components > 1:
            continue
        for stem in (*names, *_STEMS.get(quantity, ())):
            for axis, letter in enumerate(AXES):
                if plain in (f"{stem}{letter}", f"{letter}{stem}", f"{stem}{axis}"):
                    return AXES[axis] if quantity == "position" else f"{quantity}.{axis}"
    return None


def chosen(text: str) -> dict[str, str]:
    """What `--columns x=pos_x,h=hsml` says: quantity -> the name of its column.

    >>> chosen("x=pos_x,rho=dens")
    {'x': 'pos_x', 'density': 'dens'}

    Raises ValueError for anything else.
    """
    found = {}
    for entry in text.split(","):
        wanted, equals, name = (part.strip() for part in entry.partition("="))
        quantity = meaning(wanted) or meaning(wanted, 3)
        if not equals or not name or quantity is None:
            raise ValueError(
                f"columns: got {entry[:40]!r}, expected quantity=NAME such as x=pos_x; quantities"
                f" are {', '.join(QUANTITIES)}"
            )
        found[quantity] = name
    return found


def assigned(
    columns: Mapping[str, int], choice: Mapping[str, str]
) -> tuple[dict[str, str], list[str]]:
    """quantity (or component of one) -> the name of its column, and the columns left over.

    columns: name -> number of components; choice: what the user said of them

    Raises ValueError where a choice is no column, and where several columns mean the same.
    """
    for quantity, name in choice.items():
        if name not in columns:
            raise ValueError(
                f"columns: {quantity}={name[:40]}: no such column; there are {listed(columns)}"
            )
    candidates: dict[str, list[str]] = {}
    for name, components in columns.items():
        said = meaning(name, components)
        if said is not None and name not in choice.values():
            candidates.setdefault(said, []).append(name)
    found = dict(choice)
    for quantity, names in candidates.items():
        whole = quantity.partition(".")[0]
        if quantity in found or (quantity in AXES and "position" in found) or whole in choice:
            continue
        if quantity == "position" and any(axis in choice for axis in AXES):
            continue
        if len(names) > 1 and quantity != "id":
            raise ValueError(
                f"columns: {listed(names)} all mean {quantity}; say which,"
                f" --columns {quantity}={names[0]}"
            )
        found[quantity] = names[0]
    if "position" in found and any(axis in found for axis in AXES) and not choice:
        both = [found["position"], *(found[a] for a in AXES if a in found)]
        raise ValueError(
            f"columns: {listed(both)} all hold positions; say which,"
            f" --columns position={found['position']}"
        )
    return found, [name for name in columns if name not in found.values()]


def listed(names: Iterable[str], most: int = 12) -> str:
    """Names for a message."""
    some: Sequence[str] = [name[:40] for name in names]
    return ", ".join(some[:most]) + (", …" if len(some) > most else "")
