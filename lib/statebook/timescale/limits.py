"""Limits: how a caller gives them, and what they ask of s'' and s'^2."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from statebook.errors import InfeasiblePathError
from statebook.timescale.bounds import read_bounds
from statebook.timescale.curves import on_grid
from statebook.timescale.grid import Grid
from statebook.timescale.path import Path

Terms = tuple[Any, np.ndarray, Any]  # a number stands for an array of it
SIDES = 32  # of the polygon in the half-disc of a norm
_THIRDS = np.linspace(0, 1, 4)
_ROUNDING = 1e-13  # part of the largest slope that is none
DENSE = 5  # points per interval at which torques are looked at


@dataclass(frozen=True, eq=False)
class Limit(ABC):
    """Bounds on rows of one quantity.

    Attributes
    ----------
    kind : str
        What is bounded, in the audit's words.
    lower, upper : array, shape (R,)
        The bounds; where they vary along the path, the widest.
    along : scipy.interpolate.PPoly, optional
        The bounds as functions of s, 2 R columns, where they vary.
    curve : scipy.interpolate.PPoly, optional
        The motion that is bounded where it is not that of the joints: that of a tool.
    slip : array, shape (2, R), optional
        Error of that curve's first and second derivative.
    margin : float
        Part of the bounds left to that error.
    loss : float
        Part of the duration that inner approximations of this limit may cost.
    """

    kind: str
    lower: np.ndarray
    upper: np.ndarray
    along: Any = field(default=None, kw_only=True)
    curve: Any = field(default=None, kw_only=True)
    slip: np.ndarray | None = field(default=None, kw_only=True)
    margin: float = field(default=0.0, kw_only=True)
    loss: float = field(default=0.0, kw_only=True)

    squared = False
    norm = False
    form = "{kind} of {of} {row}, {side} limit"

    @cached_property
    def scale(self) -> np.ndarray:
        """Size of each row's finite bounds, shape (R,); 1 where there is none."""
        bounds = np.abs(np.stack([self.lower, self.upper]))
        size = np.where(np.isfinite(bounds), bounds, 0.0).max(axis=0)
        return np.where(size > 0, size, 1.0)

    def degree(self, grid: Grid) -> int:
        """Degree along an interval where s'^2 is a quadratic in s."""
        degree = grid.degree if self.curve is None else len(self.curve.c) - 1
        along = 0 if self.along is None else len(self.along.c) - 1
        return max(degree, along) * (2 if self.squared else 1)

    @property
    def blur(self) -> float:
        """Part of the duration between what the rows allow and what is known to be impossible."""
        return 2 * self.margin + self.norm * (1 - float(np.cos(np.pi / (2 * SIDES)))) / 2

    def motion(self, grid: Grid, z: np.ndarray, derivative: int) -> np.ndarray:
        """Return a derivative with respect to s of what moves, (K, N, R)."""
        if self.curve is None:
            return grid.path(z, derivative)
        return on_grid(self.curve, grid, z, derivative)

    def bounds(self, grid: Grid, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds at fractions z of the intervals, (R,) or (K, N, R)."""
        if self.along is None:
            return self.lower, self.upper
        lower, upper = np.split(on_grid(self.along, grid, z, 0), 2, axis=2)
        return lower, upper

    def room(self, grid: Grid) -> np.ndarray | float:
        """Return the part of the bounds that the rows leave to errors, (1, N, R) or a number."""
        return self.margin

    @abstractmethod
    def terms(self, grid: Grid, z: np.ndarray) -> Terms:
        """Return a, b, c of a s'' + b s'^2 + c at fractions z, each (K, N, R) or 0."""

    def inequalities(self, grid: Grid, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return a, b, lower, upper: lower <= a s'' + b s'^2 <= upper at fractions z.

        They are (K, N, R), in units of the bounds; of a norm the rows are those of a polygon.
        """
        a, b, c = self.terms(grid, z)
        lower, upper = (bound - c for bound in self.bounds(grid, z))
        scale: Any = self.scale
        if self.squared:
            bound = self.squared_bounds(grid, z, lambda values: values[None])
            scale = np.clip(np.broadcast_to(bound, (1, *b.shape))[0], 1e-300, 1e300)
            lower, upper = -np.inf, scale
        elif self.norm:
            a, b = polygon(a, b)
            lower = -np.inf
        return tuple(np.broadcast_to(part / scale, b.shape) for part in (a, b, lower, upper))

    def name(self, row: int, side: str) -> str:
        """Name one bound for a message."""
        of = "joint" if self.curve is None else "axis"
        return self.form.format(kind=self.kind, of=of, row=row, side=side)

    def values(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the quantity for given s'' and s'^2, (K, N) each, as (K, N, R)."""
        a, b, c = self.terms(grid, z)
        return np.asarray(a * u[:, :, None] + b * x[:, :, None] + c)

    def use(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the part of the bounds that is used, 1 at a bound, as (K, N, R).

        Of a range that does not enclose 0 it is 1 plus the excess in units of the scale.
        """
        return self.part_used(self.values(grid, z, u, x), grid, z)

    def audited_use(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the same for the audit: from the caller's own function where there is one."""
        return self.use(grid, z, u, x)

    def part_used(self, value: np.ndarray, grid: Grid, z: np.ndarray) -> np.ndarray:
        """Return the part of the bounds that values (K, N, R) of the quantity use."""
        lowest, highest = self.bounds(grid, z)
        around = (lowest < 0) & (highest > 0)
        if around.all():
            return np.maximum(value / highest, value / lowest)
        upper, lower = np.where(around, highest, 1.0), np.where(around, lowest, -1.0)
        beyond = np.maximum(value - highest, lowest - value) / self.scale
        return np.where(around, np.maximum(value / upper, value / lower), 1 + beyond)

    def uncertainty(
        self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray
    ) -> np.ndarray | float:
        """Return the part of the bounds by which a fitted motion may be off, (R,)."""
        if self.slip is None:
            return 0.0
        lower, upper = self.bounds(grid, z)
        if self.squared:
            off = self.slip[0] * np.sqrt(x)[:, :, None]
        else:
            off = self.slip[0] * np.abs(u)[:, :, None] + self.slip[1] * x[:, :, None]
        return np.asarray((off / np.minimum(upper, -lower)).max(axis=(0, 1)))

    def follow(
        self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find the bend that keeps the profile at a bound.

        Parameters
        ----------
        grid : Grid
        z : array
            Left end, middle and right end: (0, 1/2, 1).
        u, x : array, shape (3, N)
            s'' and s'^2 there.

        Returns
        -------
        use : array, shape (N,)
            How much of its bound the row nearest to it uses in the middle.
        bulge : array, shape (N,)
            h^2 ds''/ds for which that row stays at its bound; not finite where none does.
        """
        a, b, lower, upper = self.inequalities(grid, z)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = a[1] * u[1, :, None] + b[1] * x[1, :, None]
            over, under = value - upper[1], lower[1] - value
            row = np.maximum(over, under).argmax(axis=1)
            i = np.arange(x.shape[1])
            a, b, lower, upper = (term[:, i, row] for term in (a, b, lower, upper))
            over, under = over[i, row], under[i, row]
            if self.squared:
                left, middle, right = upper / b
                return 1 + over, 2 * (left + right) - 4 * middle
            wanted = (np.where(over >= under, upper, lower) - b * x) / a
            wanted[:, a[0] * a[2] < 1e-3 * a[1] ** 2] = np.nan  # s'' does not decide there
            return 1 + np.maximum(over, under), grid.h * (wanted[2] - wanted[0])

    def squared_bounds(
        self, grid: Grid, z: np.ndarray, transform: Callable[..., Any]
    ) -> np.ndarray:
        """Return the bounds on a square at fractions z of the intervals.

        They broadcast to what a transform makes of (K, N, R): Bernstein coefficients, for instance.
        """
        return np.asarray(transform(self.bounds(grid, z)[1] ** 2))


class AccelerationLimit(Limit):
    """Accelerations p' u + p'' x."""

    def terms(self, grid: Grid, z: np.ndarray) -> Terms:
        return self.motion(grid, z, 1), self.motion(grid, z, 2), 0.0


class AccelerationNormLimit(AccelerationLimit):
    """Euclidean norm of the acceleration: the terms are its components, the bound is one.

    |v w + q x| <= r is a half-disc where x >= 0, cut down to an inscribed polygon.
    """

    norm = True
    form = "{kind}"

    def values(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(super().values(grid, z, u, x), axis=2, keepdims=True)


def blocked(name: str, s: float, why: str) -> InfeasiblePathError:
    """Return the error that names a limit and a place."""
    text = f"the path cannot be driven within the limits: at s = {s:.6g} the {name} {why}"
    return InfeasiblePathError(text, constraint=name, s=s)


def polygon(w: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows whose largest value is at least |w ŵ + x x̂| cos(pi / (2 SIDES)), x̂ >= 0.

    Of two vectors (..., m), one for each unknown, to SIDES rows (..., SIDES) of each.
    """
    length = np.linalg.norm(w, axis=-1, keepdims=True)
    direction = np.divide(w, length, out=np.zeros_like(w), where=length > 0)
    along = (direction * x).sum(axis=-1, keepdims=True)
    across = np.linalg.norm(x - along * direction, axis=-1, keepdims=True)
    angle = np.pi * (np.arange(SIDES) + 0.5) / SIDES
    return length * np.cos(angle), along * np.cos(angle) + across * np.sin(angle)


class VelocityLimit(Limit):
    """Squares of velocities p'^2 x; the sign of p' chooses the bound."""

    squared = True

    def terms(self, grid: Grid, z: np.ndarray) -> Terms:
        return 0.0, self.motion(grid, z, 1) ** 2, 0.0

    def values(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        return self.motion(grid, z, 1) * np.sqrt(x)[:, :, None]

    def squared_bounds(
        self, grid: Grid, z: np.ndarray, transform: Callable[..., Any]
    ) -> np.ndarray:
        lower, upper = (transform(bound**2) for bound in self.bounds(grid, z))
        if np.array_equal(upper, lower):
            return np.asarray(upper)
        slope = transform(self.motion(grid, z, 1))
        none = _ROUNDING * np.abs(slope).max(axis=(0, 1))
        forward, backward = (slope >= -none).all(axis=0), (slope <= none).all(axis=0)
        return np.where(forward, upper, np.where(backward, lower, np.minimum(upper, lower)))


class SpeedLimit(Limit):
    """Square of the Euclidean norm of the velocity."""

    squared = True
    form = "{kind}"

    def terms(self, grid: Grid, z: np.ndarray) -> Terms:
        return 0.0, (self.motion(grid, z, 1) ** 2).sum(axis=2, keepdims=True), 0.0

    def values(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(super().values(grid, z, u, x)))


@dataclass(frozen=True, eq=False)
class TorqueLimit(Limit):
    """Rows of an inverse dynamics, tau = a u + b x + c + k + d sqrt(x) along the path.

    Attributes
    ----------
    dynamics : callable or None
        (dof, N) each to (rows, N); for the audit.
    fitted : scipy.interpolate.PPoly
        a, b, c, k and d as functions of s, 5 R columns.
    friction : (bool, bool)
        Whether there is dry friction k, and viscous friction d.
    sliding : bool
        Whether dry friction counts.
    lines : callable, optional
        Grid to alpha, beta, distance (N,): the line in x that stands for sqrt(x).
    """

    dynamics: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None
    fitted: Any
    friction: tuple[bool, bool] = (False, False)
    sliding: bool = True
    lines: Callable[[Grid], tuple[np.ndarray, ...]] | None = None
    form = "{kind} of row {row}, {side} limit"

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"dynamics": None}  # a function of the caller: a lambda, perhaps

    def degree(self, grid: Grid) -> int:
        return len(self.fitted.c) + 1

    def parts(self, grid: Grid, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return a, b, c, k and d at fractions z of the intervals, each (K, N, R)."""
        a, b, c, k, d = np.split(on_grid(self.fitted, grid, z, 0), 5, axis=2)
        rate = 1 / grid.stretch[:, None]
        return a * rate, b * rate**2, c, k, d * rate

    def audited_use(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        if self.dynamics is None or not self.sliding:
            return self.use(grid, z, u, x)
        p, p1, p2 = (grid.path(z, i) for i in range(3))
        slope = _one_sided(p1, grid.path(np.array([0.5]), 1)[0]) if any(self.friction) else p1
        u, x = u[:, :, None], x[:, :, None]
        motion = p, slope * np.sqrt(x), p1 * u + p2 * x
        q, v, a = (np.moveaxis(y, -1, 0).reshape(p.shape[2], -1) for y in motion)
        values = np.moveaxis(self.dynamics(q, v, a).reshape(-1, *p.shape[:2]), 0, -1)
        return self.part_used(values, grid, z)

    def terms(self, grid: Grid, z: np.ndarray) -> Terms:
        a, b, c, k, d = self.parts(grid, z)
        if self.sliding:
            c = c + k
        if self.lines is not None:
            alpha, beta, _ = (line[:, None] for line in self.lines(grid))
            b, c = b + d * beta, c + d * alpha
        return a, b, c

    def room(self, grid: Grid) -> np.ndarray | float:
        if self.lines is None:
            return self.margin
        drag = np.abs(self.parts(grid, _THIRDS)[4]).max(axis=0, keepdims=True)
        return np.asarray(drag / self.scale * self.lines(grid)[2][:, None] + self.margin)

    def values(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        a, b, c, k, d = self.parts(grid, z)
        u, x = u[:, :, None], x[:, :, None]
        return a * u + b * x + c + (k if self.sliding else 0.0) + d * np.sqrt(x)


def kinematic_limits(
    velocity: Any, acceleration: Any, speed: Any, path: Path, acceleration_norm: Any = None
) -> list[Limit]:
    """Read the limits of joints that need no dynamics."""
    every = (
        ("velocity", velocity, path.dof, VelocityLimit, "velocity"),
        ("acceleration", acceleration, path.dof, AccelerationLimit, "acceleration"),
        ("speed", speed, 1, SpeedLimit, "speed"),
        ("acceleration_norm", acceleration_norm, 1, AccelerationNormLimit, "norm of acceleration"),
    )
    return [
        limit(kind, **read_bounds(name, value, rows, path)._asdict())
        for name, value, rows, limit, kind in every
        if value is not None
    ]


def _one_sided(slope: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return slopes (K, N, dof) with the signs they have inside their intervals; rounding is 0.

    middle (N, dof) is the slope there; no joint turns back inside.
    """
    largest = np.abs(slope).max(axis=(0, 1))
    sign = np.where(np.abs(slope).max(axis=0) > _ROUNDING * largest, np.sign(middle), 0.0)
    return sign * np.maximum(sign * slope, 1e-12 * largest)
