"""Floats with a rigorous bound of everything that was rounded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any, ClassVar

import numpy as np

from sphtrunc.arithmetic import summation as sm
from sphtrunc.arithmetic.linear_systems import Health, Scaled, stacked
from sphtrunc.arithmetic.plain import Compensated, Plain
from sphtrunc.arithmetic.summation import TINY, UNIT, Array

SINE_ERROR = 4.0 * 2.0 * UNIT  # NumPy's sine and cosine: at most 4 units in the last place


class Ball:
    """All numbers middle + Σ_i parts_i ε_i + rest·ε with |ε| <= 1 (affine arithmetic: Stolfi & de
    Figueiredo 1997). Each sum over neighbours has an ε_i of its own, so that what the coefficients
    of a correction take from it and what the moments take from it can cancel. The middles are what
    plain arithmetic gives; radii are rounded themselves, for which SLACK makes up."""

    __array_ufunc__ = None
    __slots__ = ("middle", "parts", "rest")

    def __init__(self, middle: Any, rest: Any, parts: Mapping[int, Any] | None = None) -> None:
        self.middle, self.rest, self.parts = middle, rest, parts or {}

    @property
    def radius(self) -> Any:
        """The largest distance from the middle."""
        return sum((np.abs(c) for c in self.parts.values()), self.rest)

    def __getitem__(self, rows: Any) -> Ball:
        parts = {i: c[rows] for i, c in self.parts.items()}
        return Ball(self.middle[rows], self.rest[rows], parts)

    def __add__(self, other: Any) -> Ball:
        if isinstance(other, int) and other == 0:
            return self
        other = _ball(other)
        middle = self.middle + other.middle
        parts = dict(self.parts)
        for i, c in other.parts.items():
            parts[i] = parts[i] + c if i in parts else c
        return Ball(middle, self.rest + other.rest + UNIT * np.abs(middle), parts)

    __radd__ = __add__

    def __neg__(self) -> Ball:
        return Ball(-self.middle, self.rest, {i: -c for i, c in self.parts.items()})

    def __sub__(self, other: Any) -> Ball:
        return self.__add__(-_ball(other))

    def __rsub__(self, other: Any) -> Ball:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Ball:
        if isinstance(other, int) and other in (1, 2, -1, -2):
            parts = {i: c * other for i, c in self.parts.items()}
            return Ball(self.middle * other, self.rest * abs(other), parts)
        other = _ball(other)
        middle = self.middle * other.middle
        rest = np.abs(self.middle) * other.rest + np.abs(other.middle) * self.rest
        rest = rest + self.radius * other.radius + UNIT * np.abs(middle) + TINY
        parts = {i: c * other.middle for i, c in self.parts.items()}
        for i, c in other.parts.items():
            parts[i] = parts[i] + self.middle * c if i in parts else self.middle * c
        return Ball(middle, rest, parts)

    __rmul__ = __mul__


_symbols = count()


def _fresh(middle: Any, radius: Any) -> Ball:
    """A ball with an ε of its own."""
    return Ball(middle, np.zeros_like(radius), {next(_symbols): radius})


SLACK = 1.0 + 1e-9

#: Extended arithmetic errs by less than this part of the radius of a ball: each of its operations
#: to 2^-102 instead of 2^-53, for which series, Horner's rule and refinement leave 2^29
FINER = 2.0**-20


def _ball(x: Any) -> Ball:
    return (
        x if isinstance(x, Ball) else Ball(np.asarray(x, dtype=np.float64), np.zeros(np.shape(x)))
    )


@dataclass(frozen=True)
class Bounded:
    """Balls around the numbers of `base`."""

    base: Plain
    wide: ClassVar[bool] = False
    bounded: ClassVar[bool] = True

    def number(self, high: Any, low: Any = None, error: Any = None) -> Ball:
        middle = np.asarray(high, dtype=np.float64)
        radius = np.zeros_like(middle) if error is None else np.broadcast_to(error, middle.shape)
        return Ball(middle, radius)

    def length(self, s: list[Ball]) -> Ball:
        """|s|: off by at most the length of the radii, and by the roundings of the formula."""
        middle = self.base.length([x.middle for x in s])
        if len(s) == 1:
            return Ball(middle, s[0].radius)
        radius = np.sqrt(sum(x.radius * x.radius for x in s))
        return Ball(middle, radius * SLACK + (0.5 * len(s) + 1.5) * UNIT * middle)

    def directions(self, s: list[Ball], q: Ball) -> list[Ball]:
        """Whatever the error, components of a unit vector are off by 2 at most."""
        if len(s) == 1:
            sure = np.abs(s[0].middle) > s[0].radius
            sure |= (s[0].middle == 0.0) & (s[0].radius == 0.0)
            return [Ball(np.sign(s[0].middle), np.where(sure, 0.0, 2.0))]
        found = [self.ratio(x, q) for x in s]
        return [Ball(e.middle, np.minimum(e.radius, 2.0)) for e in found]

    def sincos(self, x: Ball) -> tuple[Ball, Ball]:
        sine, cosine = self.base.sincos(x.middle)
        return (
            Ball(sine, SINE_ERROR * np.abs(sine) + np.minimum(x.radius, 2.0)),
            Ball(cosine, SINE_ERROR * np.abs(cosine) + np.minimum(x.radius, 2.0)),
        )

    def total(self, x: Ball) -> Ball:
        value = self.base.total(x.middle)
        if isinstance(self.base, Compensated):
            size = sm.total(np.abs(x.middle)) * SLACK
            error = sm.compensated_dot_error(x.middle.shape[0], value, size)
        else:
            error = sm.total_error(x.middle)
        return _fresh(value, sm.total(x.radius) + error)

    def dot(self, x: Ball, y: Ball) -> Ball:
        if not isinstance(self.base, Compensated):
            return self.total(x * y)
        a, b, r, s = np.broadcast_arrays(x.middle, y.middle, x.radius, y.radius)
        value = self.base.dot(a, b)
        size = sm.total(np.abs(a * b)) * SLACK
        carried = sm.total(np.abs(a) * s + np.abs(b) * r + r * s)
        return _fresh(value, carried + sm.compensated_dot_error(a.shape[0], value, size))

    def ratio(self, x: Ball, y: Ball) -> Ball:
        """x/y, and 0 where y is exactly 0."""
        zero = (y.middle == 0.0) & (y.radius == 0.0)
        middle = self.base.ratio(x.middle, y.middle)
        least = np.maximum(np.abs(y.middle) - y.radius * SLACK, 0.0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            radius = (x.radius + np.abs(middle) * y.radius) / least + UNIT * np.abs(middle) + TINY
        return Ball(middle, np.where(zero, 0.0, np.where(least > 0.0, radius, np.inf)))

    def drop(self, x: Ball, where: Any) -> Ball:
        return Ball(np.where(where, 0.0, x.middle), np.where(where, 0.0, x.radius))

    def solve(self, matrix: Any, columns: Any, health: Health) -> Any:
        """For every A' and B' in the balls A and B: A'(X' − X) = B' − A'X. With R near the inverse
        the part of it that is linear in the ε_i is R(B_i − A_i X); all else is at most
        |R||rest| + e/(1 − e) max |R||B' − A'X| where ‖I − RA'‖ <= e < 1 in the row-sum norm (Rump
        2010, doi:10.1017/S096249291000005X, section 10)."""
        matrix = [[_ball(x) for x in row] for row in matrix]
        columns = [[_ball(x) for x in row] for row in columns]
        a, b = stacked(_each(matrix, "middle")), stacked(_each(columns, "middle"))
        ra, rb = stacked(_each(matrix, "rest")), stacked(_each(columns, "rest"))
        wide = stacked(_each(matrix, "radius"))
        scaled = Scaled(a, health)
        x, inverse = scaled.solve(b), scaled.inverse()
        n = a.shape[-1]
        gamma = sm.gamma(2 * n + 4)
        rounding = np.abs(b - a @ x) + gamma * (np.abs(b) + np.abs(a) @ np.abs(x))
        rest = np.abs(inverse) @ (rounding + rb + ra @ np.abs(x))
        parts, linear = {}, np.zeros_like(rest)
        for i in dict.fromkeys(i for row in (*matrix, *columns) for one in row for i in one.parts):
            moved = stacked([[one.parts.get(i, 0.0) for one in row] for row in columns])
            moved = moved - stacked([[one.parts.get(i, 0.0) for one in row] for row in matrix]) @ x
            parts[i] = inverse @ moved
            linear += np.abs(parts[i])
        off = np.abs(np.eye(n) - inverse @ a) + gamma * (np.eye(n) + np.abs(inverse) @ np.abs(a))
        e = (off + np.abs(inverse) @ wide).sum(axis=-1).max(axis=-1) * SLACK
        safe = np.where(e < 1.0, e, 0.0)
        with np.errstate(invalid="ignore"):  # where a radius is infinite already
            spread = (rest + linear).max(axis=-2, keepdims=True)
            spread = (safe / (1.0 - safe))[..., None, None] * spread
        radius = np.where((e < 1.0)[..., None, None], (rest + spread) * SLACK, np.inf)
        return [
            [
                Ball(x[..., i, j], radius[..., i, j], {k: c[..., i, j] for k, c in parts.items()})
                for j in range(x.shape[-1])
            ]
            for i in range(n)
        ]

    def value(self, x: Any) -> Array:
        return self.base.value(_ball(x).middle)

    def rest(self, x: Any) -> Array:
        """The radius."""
        return np.asarray(_ball(x).radius)


def _each(rows: Any, name: str) -> Any:
    return [[getattr(x, name) for x in row] for row in rows]
