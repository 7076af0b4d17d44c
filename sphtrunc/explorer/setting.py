"""The numbers of a setting of the page, from the theory of this package.

Moments M_n along the first axis, the parts of the rms error of a wave along it, and h/Δx in every
convention. Disorder is of first order in the displacements u_b of all particles, as on the page,

    Var = σ² Σ_b |∂E/∂u_b|²,

which differs by O(σ²) of itself from the averages over displacements of any size in `measure`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from math import pi, sqrt
from typing import Any
from urllib.parse import parse_qsl, urlencode

from sphtrunc.arithmetic.rational import exact
from sphtrunc.explorer.tables import START
from sphtrunc.kernels.conventions import convert
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.moments import unit
from sphtrunc.operators.operator import Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import DEFAULT, KINDS, sites


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What the controls of the page say.

    kernel: a name or a formula; lattice: by default that of the dimension; numbers: exact texts
    such as "5/6" or "0.05", or anything else that `Fraction` takes

    Raises ValueError for what is out of range.
    """

    kernel: str = START["kernel"]
    dim: int = 3
    lattice: str = ""
    form: str = START["form"]
    correction: str = START["correction"]
    dx_over_h: Fraction = Fraction(5, 6)
    h_over_lambda: Fraction = Fraction(1, 20)
    jitter: Fraction = Fraction(0)

    def __post_init__(self) -> None:
        if self.dim not in DEFAULT:
            raise ValueError(f"dim: got {self.dim!r}, expected 1, 2 or 3")
        if not self.lattice:
            object.__setattr__(self, "lattice", DEFAULT[self.dim])
        allowed = [kind for kind, data in KINDS.items() if data.dim == self.dim]
        if self.lattice not in allowed:
            raise ValueError(
                f"lattice: got {self.lattice!r}, expected one of {', '.join(allowed)} in"
                f" {self.dim}D"
            )
        for name in ("dx_over_h", "h_over_lambda", "jitter"):
            shown = name.replace("_", "-")
            value = exact(getattr(self, name), shown)
            if value < 0 or (value == 0 and name != "jitter"):
                raise ValueError(f"{shown}: got {value}, expected a positive number")
            object.__setattr__(self, name, value)
        self.operator.require_pairs(not self.jitter and self.around.paired)

    @property
    def operator(self) -> Operator:
        """The gradient of that form and correction."""
        return Operator("gradient", self.form, self.correction)

    @property
    def around(self) -> Arrangement:
        """The particles of the lattice around one of them, before they are displaced."""
        return Arrangement(self.lattice, self.dx_over_h)

    @property
    def shape(self) -> Kernel:
        """The kernel, which is a piecewise polynomial.

        Raises ValueError where it is not.
        """
        found = parse_kernel(self.kernel)
        if not isinstance(found, Kernel):
            raise ValueError(f"kernel: the page knows polynomials, {found.name} is none")
        return found

    @property
    def link(self) -> str:
        """What stands after # in the page's address."""
        words = {f.name.replace("_", "-"): str(getattr(self, f.name)) for f in fields(self)}
        return urlencode(words, safe="/:*()^;")


def setting(link: str) -> Setting:
    """The setting of a link to the page, or of what stands after its #; what is not said is as the
    page starts.

    >>> setting("explorer.html#dim=2&dx-over-h=0.5").lattice
    'square'

    Raises ValueError for an unknown key, or a value that is not allowed.
    """
    said = dict(parse_qsl(link.rpartition("#")[2], keep_blank_values=True))
    known = [f.name.replace("_", "-") for f in fields(Setting)]
    for key in said:
        if key not in known:
            raise ValueError(f"link: got {key[:40]!r}, expected {', '.join(known)}")
    given: dict[str, Any] = {key.replace("-", "_"): value.strip() for key, value in said.items()}
    if "dim" in given:
        if given["dim"] not in ("1", "2", "3"):
            raise ValueError(f"dim: got {given['dim'][:40]!r}, expected 1, 2 or 3")
        given["dim"] = int(given["dim"])
    elif given.get("lattice") in KINDS:
        given["dim"] = KINDS[given["lattice"]].dim
    return Setting(**given)


def numbers(at: Setting) -> dict[str, Any]:
    """Every number that the page shows for a setting.

    particles: within the support, the target counted; moments, spreads: M_n along the first axis,
    n = 0 … 3, and their standard deviations; error: total, smoothing, discretisation and disorder,
    rms over phases and displacements, relative to the largest gradient of the wave; conventions:
    name -> value, lengths in Δx, None where the kernel has no such number.

    Raises ValueError where there are too few particles for the correction.
    """
    import numpy as np

    from sphtrunc.theory.disorder.propagation import propagate
    from sphtrunc.theory.disorder.sampling import slopes_of
    from sphtrunc.theory.disorder.sensitivities import FirstNeighbours
    from sphtrunc.theory.field_error import predict_fields
    from sphtrunc.theory.fields import Waves
    from sphtrunc.theory.lattice_sums import lattice_moments

    kernel, operator, scene = at.shape, at.operator, at.around
    kappa = 2 * pi * float(at.h_over_lambda)
    along = [unit(at.dim, 0, n) for n in range(4)]
    means = lattice_moments(kernel, operator, scene, 3, exact=False)
    wave = Waves(np.array([kappa]), np.eye(at.dim)[0])
    still = predict_fields(kernel, operator, scene, wave)[0]
    sigma, spreads, disorder = float(at.jitter), [0.0] * 4, 0.0
    if sigma:
        slopes, _ = propagate(kernel, operator, scene, 3)
        spreads = [sigma * float(np.linalg.norm(slopes[alpha])) for alpha in along]
        moved = slopes_of(FirstNeighbours(kernel, scene), operator, wave).values()
        disorder = sigma * sqrt(sum(float((g * g).sum()) for g in moved)) / (sqrt(2) * kappa)
    reach = float(kernel.support) / float(at.dx_over_h)
    lattice_error = sqrt(max(still.total**2 - still.rounding**2, 0.0))
    resolution = convert(kernel, at.dim, dx_over_h=at.dx_over_h).to_dict()
    return {
        "particles": sites(at.lattice, reach, scene.offset).shape[1],
        "moments": [float(means[alpha]) for alpha in along],
        "spreads": spreads,
        "error": {
            "total": sqrt(lattice_error**2 + disorder**2),
            "smoothing": still.smoothing,
            "discretisation": still.discretisation,
            "disorder": disorder,
        },
        "conventions": {name: row["value"] for name, row in resolution.items()},
    }


def document(at: Setting) -> dict[str, Any]:
    """The setting and its numbers, ready for JSON."""
    words = {
        name.replace("_", "-"): str(value) if isinstance(value, Fraction) else value
        for name, value in asdict(at).items()
    }
    return {"setting": words, **numbers(at)}
