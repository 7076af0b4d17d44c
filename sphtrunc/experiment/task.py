"""A task: what is to be measured, fixed for all blocks, and its description in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sphtrunc.experiment.fields import Field, Sinusoid
from sphtrunc.operators.moments import label
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.jittered import Jittered
from sphtrunc.scenes.lattice import Lattice
from sphtrunc.scenes.scene import Scene

if TYPE_CHECKING:
    from sphtrunc.kernels.kernel import Kernel

# ------------------------------------------------------------------------------- blocks of targets


@dataclass(frozen=True)
class Task:
    """What is to be measured, fixed for all blocks."""

    scene: Scene
    kernel: Kernel
    operator: Operator
    fields: tuple[Field, ...]
    degree: int | None
    seed: int
    precision: str
    bound: bool
    rtol: float | None = None

    @property
    def cells(self) -> int:
        """The number of pairs that are looked at for a target, about."""
        rows = max(1, self.scene.rows(self.kernel))
        alike = isinstance(self.scene, Lattice) and self.scene.wall is None
        return rows * rows if self.operator.form == NESTED and not alike else rows


def is_still(scene: Any) -> bool:
    """An undisplaced lattice, whose h may change from particle to particle: its one target is shown
    all phases of a wave."""
    return isinstance(getattr(scene, "base", scene), Lattice)


def is_wave(fields: tuple[Field, ...]) -> bool:
    return bool(fields) and all(isinstance(one, Sinusoid) for one in fields)


def described(task: Task) -> dict[str, Any]:
    """Every option as it was resolved."""
    scene: Any = task.scene
    carried = getattr(scene, "base", scene)
    base = carried if isinstance(carried, Arrangement) else None
    settings: dict[str, Any] = {
        "kernel": {
            "name": task.kernel.name,
            "support": str(task.kernel.support),
            "knots": [str(k) for k in task.kernel.knots],
            "pieces": [[str(c) for c in piece] for piece in task.kernel.coefficients()],
        },
        "dim": scene.dim,
        "operator": task.operator.name,
        "form": task.operator.form,
        "correction": task.operator.correction,
        "lattice": None if base is None else base.kind,
        "dx_over_h": None if base is None else str(base.dx_over_h),
        "offset": None if base is None else [str(o) for o in base.offset],
        "extent": None if base is None else base.extent,
        "jitter": 0.0 if base is None else base.sigma,
        "distribution": carried.distribution if isinstance(carried, Jittered) else None,
        "volume": scene.volume,
        "field": _field_text(task.fields),
        "h_over_lambda": getattr(task.fields[0], "h_over_lambda", None) if task.fields else None,
        "rtol": task.rtol,
        "degree": task.degree,
        "seed": task.seed,
        "precision": task.precision,
        "bound": task.bound,
    }
    if carried is not scene:
        settings["h_gradient"] = [str(g) for g in scene.gradient]
        settings["h_rule"] = scene.rule
    if base is not None and base.wall is not None:
        wall = base.wall
        settings["wall"] = {
            "eta": str(wall.eta),
            "at": str(base.wall_phase % 1),
            "ghosts": wall.ghosts,
            "weight": str(wall.share),
        }
    settings["scene"] = _scene_text(settings, carried)
    return settings


def _scene_text(settings: dict[str, Any], scene: Any) -> str:
    if settings["lattice"] is None:
        kind = type(scene).__name__.lower()
        return f"{kind}, {scene.population} targets, volume {scene.volume}"
    text = f"{settings['lattice']} lattice, Δx/h = {settings['dx_over_h']}"
    if any(o != "0" for o in settings["offset"]):
        text += f", offset {', '.join(settings['offset'])}"
    if settings["distribution"]:
        text += f", jitter {settings['jitter']:g} Δx ({settings['distribution']})"
    if "h_rule" in settings:
        slope = ", ".join(settings["h_gradient"])
        text += f", h = 1 + g·s, g = ({slope}), {settings['h_rule']}"
    if "wall" in settings:
        wall = settings["wall"]
        text += f", a wall at {wall['eta']} h, {wall['at']} steps before the first plane"
        text += f", ghosts {wall['ghosts']}"
    return text + f", volume {settings['volume']}"


def _field_text(fields: tuple[Any, ...]) -> str | None:
    if not fields:
        return None
    one = fields[0]
    if isinstance(one, Sinusoid):
        along = ", ".join(f"{n:g}" for n in one.direction)
        return f"sinusoid, h/λ = {one.h_over_lambda:g}, along ({along}), random phase"
    if hasattr(one, "coefficients"):
        terms = ", ".join(f"{label(a)}: {c:g}" for a, c in one.coefficients.items())
        return f"polynomial in the offset ({terms})"
    if hasattr(one, "width"):
        return f"Gaussian bump of width {one.width:g} h"
    return "values on the particles"
