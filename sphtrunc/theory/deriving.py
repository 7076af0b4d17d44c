"""Theory: the exact moments of an estimate, as integrals and as lattice sums.

1D, uniform spacing: for f piecewise polynomial with compact support, on the lattice s_j = (j+θ)Δs,
with B̃_n the periodic Bernoulli polynomials and [f^{(m)}](p) the jumps at all knots p,

    Δs Σ_j f(s_j) = ∫ f ds + Σ_m (−1)^m Δs^{m+1}/(m+1)! Σ_p B̃_{m+1}(p/Δs − θ) [f^{(m)}](p),

exactly: the sum over m ends at the degree of f (Euler–Maclaurin; Ralston 1965, Quinlan, Basa &
Lastiwka 2006, doi:10.1002/nme.1617, for the knots at the edge). A particle on a jump counts with
the mean of both sides, B̃_1(integer) = 0.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

from sympy import Expr, Rational, floor, radsimp

from sphtrunc.arithmetic.rational import fraction
from sphtrunc.kernels.arguments import dimension, rational
from sphtrunc.kernels.kernel import Kernel
from sphtrunc.kernels.parse import kernel as parse_kernel
from sphtrunc.operators.moments import Moments
from sphtrunc.operators.operator import NESTED, Operator
from sphtrunc.scenes.arrangement import Arrangement
from sphtrunc.scenes.sites import in_pairs, lattice_of
from sphtrunc.theory.derivation import Derivation
from sphtrunc.theory.euler_maclaurin import KnotTerm, euler_maclaurin, euler_maclaurin_sums
from sphtrunc.theory.lattice_sums import lattice_moments, rounded
from sphtrunc.theory.limit import _moments, continuous_sum
from sphtrunc.theory.orders import _orders

if TYPE_CHECKING:
    from sphtrunc.kernels.gaussian import Gaussian
    from sphtrunc.theory.aliasing import Aliasing
    from sphtrunc.theory.disorder.prediction import Prediction

MAX_DEGREE = 40  # of the moments that are derived


def derive(
    kernel: Kernel | Gaussian | str,
    operator: Operator | str = "gradient",
    *,
    form: str | None = None,
    correction: str = "none",
    dim: int = 1,
    degree: int = 5,
    dx_over_h: object = None,
    offset: object = 0,
    lattice: str | None = None,
    volume: str = "constant",
    jitter: object = None,
    distribution: str = "gaussian",
    h_gradient: object = None,
    h_rule: str = "scatter",
    wall: object = None,
    wall_at: object = None,
    wall_weight: object = None,
    ghosts: str = "none",
) -> Derivation:
    """The truncation error of an SPH estimate, exactly.

    kernel: a Kernel, or any text that `sphtrunc.kernel` takes
    operator: an Operator, or its name together with `form` and `correction`
    dim: 1, 2 or 3
    degree: moments M_α up to |α| = degree
    dx_over_h: Δx/h, an exact number ("10/13", a Fraction, an algebraic SymPy number), or None for
        the error at any ratio
    offset: θ, the particles are at (j + θ)Δx from the target; in 2D and 3D one number per axis
    lattice: "square" (default in 2D), "hexagonal"; "cubic" (default in 3D), "bcc", "fcc", "hcp"
    volume: "constant", or "summation" (all particles alike, 1/Σ W)
    jitter, distribution: σ/Δx along each axis, 0 to 10, and "gaussian", "uniform" or "blue": adds
        `scatter`, mean and spread of the moments when every particle is displaced at random
    h_gradient, h_rule: h(x) = h_a (1 + g·s), g one number (along the first axis) or one per axis,
        and whose h a pair takes, "gather", "scatter", "mean" or "mean-kernel": adds `varying`
    wall: η, the distance of the target in h from a plane wall or a free surface normal to the first
        axis, or "eta" for the moments as functions of it
    wall_at: where the lattice has the wall: "particle", "half-way" or the steps to the first plane
        of particles; None: where the offset puts it
    wall_weight: what part of a particle on the wall counts, 1/2 unless given
    ghosts: beyond the wall: "none", "mirror", "odd" (2 A_wall − A) or "dummy" (Shepard means)

    In 1D the discretisation error is known term by term at every ratio; elsewhere the moments at a
    given ratio are summed, exactly where the numbers are rational and to 30 digits where not.

    >>> derive("cubic-spline", dx_over_h="10/13").discrete[1]
    29200/28561

    Raises ValueError for a bad argument, for particles so far apart that the target has no
    neighbour, and where the matrix of the correction is singular.
    """
    kernel = parse_kernel(kernel)
    if isinstance(operator, str):
        operator = Operator(operator, form, correction)
    dim = dimension(dim)
    if isinstance(degree, bool) or not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"degree: got {degree!r}, expected a whole number from 0 to {MAX_DEGREE}")
    degree = max(degree, operator.derivatives)
    shift = _offset(offset, dim)
    theta = shift[0]
    ratio = None if dx_over_h is None else spacing(dx_over_h)
    kind = lattice_of(dim, lattice, volume)
    if ratio is None and (lattice is not None or volume != "constant"):
        raise ValueError("lattice, volume: these need a ratio, expected dx-over-h as well")
    if wall is not None:
        if jitter is not None or volume != "constant" or h_gradient is not None:
            raise ValueError(
                "wall: displaced particles, summed volumes and a varying h beside a wall are not"
                " derived here; expected no jitter, no h-gradient, and volume constant"
            )
        from sphtrunc.theory.walls.derivation import beside

        return beside(
            derive(kernel, operator, dim=dim, degree=degree),
            wall,
            at=wall_at,
            ghosts=ghosts,
            weight=wall_weight,
            dx_over_h=ratio,
            shift=shift,
            lattice=kind,
        )
    if wall_at is not None or wall_weight is not None or ghosts != "none":
        raise ValueError(
            "wall-at, wall-weight, ghosts: belong to a wall; expected --wall η as well"
        )
    operator.require_pairs(in_pairs(kind, shift))
    needed = operator.needed(dim, degree)
    continuous = {key: continuous_sum(kernel, key) for key in needed}
    limit = _moments(operator, continuous, dim, degree, "continuous limit")
    terms: tuple[KnotTerm, ...] = ()
    if dim == 1 and isinstance(kernel, Kernel):
        terms = tuple(
            KnotTerm(term, alpha[0], *row)
            for term, alpha in needed
            for row in euler_maclaurin(kernel, term, alpha[0])
        )
    discrete = scene = None
    if ratio is not None and ratio.is_Rational:
        scene = Arrangement(kind, fraction(ratio), tuple(fraction(x) for x in shift), volume)
    if ratio is not None:
        if dim == 1:
            _require_neighbours(kernel, ratio, theta)
        if dim == 1 and isinstance(kernel, Kernel) and volume == "constant":
            sums = euler_maclaurin_sums(continuous, terms, ratio, theta)
            around = None
            if operator.form == NESTED and theta != 0:
                home = euler_maclaurin_sums(continuous, terms, ratio, Rational(0))
                around = [(sums, home)]
            discrete = _moments(operator, sums, dim, degree, "derived", around)
        else:
            discrete = _summed(kernel, operator, scene, ratio, degree)
    result = Derivation(
        kernel=kernel,
        operator=operator,
        dim=dim,
        degree=degree,
        limit=limit,
        terms=terms,
        dx_over_h=ratio,
        offset=theta,
        shift=shift,
        lattice=kind,
        volume=volume,
        discrete=discrete,
        find_orders=partial(_orders, kernel, operator, dim, degree, theta, terms),
        find_aliasing=partial(_explained, kernel, operator, dim, scene),
        scatter=None
        if jitter is None
        else _scattered(kernel, operator, scene, min(degree, 6), jitter, distribution),
    )
    if h_gradient is None:
        return result
    from sphtrunc.theory.variable_h.moments import varying

    return varying(result, h_gradient, h_rule)


def _offset(offset: object, dim: int) -> tuple[Rational, ...]:
    """One rational per axis; a single 0 stands for all."""
    given = list(offset) if isinstance(offset, (tuple, list)) else [offset]
    exact = [rational(value, "offset") for value in given]
    if len(exact) == 1 and exact[0] == 0:
        exact *= dim
    if len(exact) != dim:
        raise ValueError(f"offset: got {len(exact)} numbers, expected {dim}, one per axis")
    return tuple(exact)


def _summed(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement | None,
    ratio: Expr,
    degree: int,
) -> Moments:
    """The moments at a ratio, particle by particle; see `sphtrunc.theory.lattice_sums`."""
    if scene is None:
        raise ValueError(f"dx-over-h: got {ratio}, expected a rational ratio for this sum")
    dim, most = scene.dim, 200_000
    if float(kernel.support / ratio) ** dim > most:
        raise ValueError(
            f"dx-over-h: got {ratio}, a target has over {most} neighbours; expected a larger ratio"
        )
    linear = operator.uncorrected or (operator.form == NESTED and operator.correction == "none")
    found = lattice_moments(kernel, operator, scene, degree, exact=linear)
    values = {a: m if isinstance(m, (int, Expr)) else rounded(m) for a, m in found.items()}
    return Moments(values, operator.target(dim), operator.derivatives, "derived")


def spacing(value: object) -> Expr:
    """Δx/h as an exact positive number: a rational, or a real algebraic SymPy expression."""
    if isinstance(value, Expr) and not isinstance(value, Rational):
        if not (value.is_algebraic and value.is_positive):
            raise ValueError(f"dx_over_h: got {value}, expected a positive algebraic number")
        return radsimp(value)
    ratio = rational(value, "dx-over-h")
    if ratio <= 0:
        raise ValueError(f"dx-over-h: got {ratio}, expected a positive rational")
    return ratio


def _require_neighbours(kernel: Kernel | Gaussian, ratio: Expr, theta: Rational) -> None:
    """At least one particle other than the target strictly inside the support."""
    nearest = min(abs(j + theta) for j in (-floor(theta), -floor(theta) - 1))
    if nearest == 0:
        nearest = Rational(1)
    if not nearest * ratio < kernel.support:
        raise ValueError(
            f"dx-over-h: got {ratio}, and the nearest particle is not inside the support of"
            f" {kernel.support}h; expected a ratio below {kernel.support / nearest}"
            " (did you mean h/Δx?)"
        )


def _explained(
    kernel: Kernel | Gaussian, operator: Operator, dim: int, scene: Arrangement | None
) -> Aliasing:
    """The reasons for the discretisation error in 2D and 3D."""
    from sphtrunc.theory.aliasing import aliasing

    return aliasing(kernel, operator, dim, scene)


def _scattered(
    kernel: Kernel | Gaussian,
    operator: Operator,
    scene: Arrangement | None,
    degree: int,
    jitter: object,
    distribution: str,
) -> Prediction:
    """Mean and spread of the moments when particles are displaced by σ/Δx along each axis."""
    from sphtrunc.theory.disorder.prediction import predict

    sigma = float(rational(jitter if isinstance(jitter, str) else Fraction(str(jitter)), "jitter"))
    if not 0 <= sigma <= 10:
        raise ValueError(f"jitter: got {sigma:g}, expected a standard deviation σ/Δx from 0 to 10")
    if scene is None:
        raise ValueError("jitter: needs a rational ratio, expected dx-over-h as well")
    scene = replace(scene, sigma=sigma, distribution=distribution)
    return predict(kernel, operator, scene, degree=degree)
