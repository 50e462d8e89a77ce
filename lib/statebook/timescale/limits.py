"""Limits: how a caller gives them, and what they ask of s'' and s'^2."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from statebook import _validate
from statebook.timescale import bernstein
from statebook.timescale.grid import Grid
from statebook.timescale.path import Path

Terms = tuple[np.ndarray | None, np.ndarray, np.ndarray | None]
TORQUE_DEGREE = 6  # of the polynomials that stand for torques within an interval
DENSE = 17  # points per interval at which torques are looked at


@dataclass(frozen=True, eq=False)
class Limit(ABC):
    """Bounds on rows of one quantity: rows R, lower and upper of shape (R,)."""

    kind: str
    lower: np.ndarray
    upper: np.ndarray

    squared = False

    @property
    def scale(self) -> np.ndarray:
        """Size of each row's finite bounds, shape (R,); 1 where there is none."""
        bounds = np.abs(np.stack([self.lower, self.upper]))
        size = np.where(np.isfinite(bounds), bounds, 0.0).max(axis=0)
        return np.where(size > 0, size, 1.0)

    @abstractmethod
    def degree(self, grid: Grid) -> int:
        """Degree along an interval where s'^2 is a quadratic in s."""

    @abstractmethod
    def terms(self, grid: Grid, z: np.ndarray, speed: np.ndarray) -> Terms:
        """Return a, b, c at fractions z of the intervals, each (K, N, R) or None for zero.

        speed (N,) is a typical s'^2; only rounding depends on it.
        """

    def name(self, row: int, side: str) -> str:
        """Name one bound for a message."""
        return f"{self.kind} of joint {row}, {side} limit"

    def values(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the quantity for given s'' and s'^2, (K, N) each, as (K, N, R)."""
        a, b, c = self.terms(grid, z, x.max(axis=0))
        value = b * x[:, :, None]
        if a is not None:
            value += a * u[:, :, None]
        return value if c is None else value + c

    def use(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the part of the bounds that is used, 1 at a bound, as (K, N, R).

        Of a range that does not enclose 0 it is 1 plus the excess in units of the scale.
        """
        value = self.values(grid, z, u, x)
        around = (self.lower < 0) & (self.upper > 0)
        upper, lower = np.where(around, self.upper, 1.0), np.where(around, self.lower, -1.0)
        beyond = np.maximum(value - self.upper, self.lower - value) / self.scale
        return np.where(around, np.maximum(value / upper, value / lower), 1 + beyond)

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
        a, b, c = self.terms(grid, z, x.max(axis=0))
        interval = np.arange(x.shape[1])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if a is None:
                bound = np.broadcast_to(self.squared_bounds(grid.path(z, 1)), b.shape[1:])
                use = np.sqrt(b[1] * x[1, :, None] / bound)
                row = use.argmax(axis=1)
                wanted = bound[interval, row] / b[:, interval, row]
                return use[interval, row], 2 * (wanted[0] + wanted[2]) - 4 * wanted[1]
            c = np.zeros_like(b) if c is None else c
            value = a[1] * u[1, :, None] + b[1] * x[1, :, None] + c[1]
            over, under = (value - self.upper) / self.scale, (self.lower - value) / self.scale
            row = np.maximum(over, under).argmax(axis=1)
            over, under = over[interval, row], under[interval, row]
            bound = np.where(over >= under, self.upper[row], self.lower[row])
            a, b, c = (term[:, interval, row] for term in (a, b, c))
            wanted = (bound - b * x - c) / a
            wanted[:, a[0] * a[2] < 1e-3 * a[1] ** 2] = np.nan  # s'' does not decide there
            return 1 + np.maximum(over, under), grid.h * (wanted[2] - wanted[0])

    def squared_bounds(self, slope: np.ndarray) -> np.ndarray:
        """Return the bound on a square where p' has values or Bernstein coefficients slope.

        slope is (K, N, dof); the result broadcasts to (N, R).
        """
        return self.upper**2


class AccelerationLimit(Limit):
    """Joint accelerations p' u + p'' x."""

    def degree(self, grid: Grid) -> int:
        return grid.degree

    def terms(self, grid: Grid, z: np.ndarray, speed: np.ndarray) -> Terms:
        return grid.path(z, 1), grid.path(z, 2), None


class VelocityLimit(Limit):
    """Squares of joint velocities p'^2 x; the sign of p' chooses the bound."""

    squared = True

    def degree(self, grid: Grid) -> int:
        return 2 * grid.degree

    def terms(self, grid: Grid, z: np.ndarray, speed: np.ndarray) -> Terms:
        return None, grid.path(z, 1) ** 2, None

    def squared_bounds(self, slope: np.ndarray) -> np.ndarray:
        upper, lower = self.upper**2, self.lower**2
        if np.array_equal(upper, lower):
            return upper
        forward, backward = (slope >= 0).all(axis=0), (slope <= 0).all(axis=0)
        return np.where(forward, upper, np.where(backward, lower, np.minimum(upper, lower)))

    def use(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        value = grid.path(z, 1) * np.sqrt(x)[:, :, None]
        return np.maximum(value / self.upper, value / self.lower)


class SpeedLimit(Limit):
    """Square of the Euclidean norm of the velocity."""

    squared = True

    def degree(self, grid: Grid) -> int:
        return 2 * grid.degree

    def terms(self, grid: Grid, z: np.ndarray, speed: np.ndarray) -> Terms:
        return None, (grid.path(z, 1) ** 2).sum(axis=2, keepdims=True), None

    def use(self, grid: Grid, z: np.ndarray, u: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.sqrt(self.values(grid, z, u, x)) / self.upper

    def name(self, row: int, side: str) -> str:
        return "speed"


@dataclass(frozen=True, eq=False)
class TorqueLimit(Limit):
    """Rows of an inverse dynamics, tau = a u + b x + c along the path."""

    dynamics: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

    def degree(self, grid: Grid) -> int:
        return TORQUE_DEGREE

    def terms(self, grid: Grid, z: np.ndarray, speed: np.ndarray) -> Terms:
        p, p1, p2 = (grid.path(z, i) for i in range(3))
        shape = p.shape[:2]
        x = np.broadcast_to(np.where(speed > 0, speed, 1.0)[:, None], (*shape, 1))
        q, v, a, b = (
            np.moveaxis(y, -1, 0).reshape(p.shape[2], -1)
            for y in (p, p1 * np.sqrt(x), p1 * x, p2 * x)
        )
        still = np.zeros_like(q)
        c = self.dynamics(q, still, still)
        rows = (self.dynamics(q, still, a) - c, self.dynamics(q, v, b) - c, c)
        inertial, centrifugal, static = (
            np.moveaxis(tau.reshape(-1, *shape), 0, -1) for tau in rows
        )
        return inertial / x, centrifugal / x, static

    def name(self, row: int, side: str) -> str:
        return f"torque of row {row}, {side} limit"

    def misfit(self, grid: Grid, u: Callable[..., Any], x: Callable[..., Any]) -> np.ndarray:
        """Return the part of the bounds by which polynomials miss the torques, (N,).

        u and x give s'' and s'^2, (K, N), at fractions z (K,) of the intervals.
        """
        nodes, dense = bernstein.nodes(TORQUE_DEGREE), np.linspace(0, 1, DENSE)
        known, actual = (self.values(grid, z, u(z), x(z)) for z in (nodes, dense))
        between = bernstein.to_values(TORQUE_DEGREE, dense) @ bernstein.from_values(TORQUE_DEGREE)
        off = np.abs(bernstein.along(between, known) - actual) / self.scale
        return np.asarray(off.max(axis=(0, 2)))


def bounds(name: str, value: Any, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Read a limit given as a number, (rows,) or (rows, 2); infinity means none.

    A number or a vector of magnitudes stands for -value and value.
    """
    given = np.asarray(value)
    if given.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be made of real numbers, got {value!r}")
    if given.shape not in ((), (rows,), (rows, 2)):
        raise ValueError(
            f"{name} must be a number, or have shape ({rows},) or ({rows}, 2), got {given.shape}"
        )
    given = given.astype(float)
    if np.isnan(given).any():
        raise ValueError(f"{name} must not be NaN, got {value!r}")
    if given.ndim == 2:
        lower, upper = given[:, 0].copy(), given[:, 1].copy()
        if np.any(lower > upper):
            row = int(np.flatnonzero(lower > upper)[0])
            raise ValueError(
                f"{name} must have lower <= upper, got ({lower[row]:g}, {upper[row]:g}) for "
                f"joint {row}"
            )
        return lower, upper
    upper = np.broadcast_to(given, rows).copy()
    if np.any(upper < 0) or (given.ndim == 0 and given == 0):
        raise ValueError(f"{name} must be greater than 0, or pairs (lower, upper), got {value!r}")
    return -upper, upper


def require_joints(name: str, value: Any, path: Path) -> None:
    """Explain limits for as many joints as the path has waypoints."""
    length, count = np.shape(value)[:1], path.waypoints
    if length == (count,) and count not in (0, path.dof):
        raise ValueError(
            f"{name} is given for {count} joints, but the path has {path.dof} joints and {count} "
            "waypoints: Path.through takes one waypoint in each column; if each row is one, pass "
            "waypoints.T"
        )


def joint_bounds(name: str, value: Any, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """Read a velocity or acceleration limit: the bounds must allow standing still."""
    lower, upper = bounds(name, value, dof)
    bad = np.flatnonzero((lower > 0) | (upper < 0))
    if len(bad):
        j = int(bad[0])
        raise ValueError(
            f"{name} must have lower <= 0 <= upper, or no motion can begin and end; got "
            f"({lower[j]:g}, {upper[j]:g}) for joint {j}"
        )
    return lower, upper


def kinematic_limits(velocity: Any, acceleration: Any, speed: Any, dof: int) -> list[Limit]:
    """Read the limits that need no dynamics."""
    limits: list[Limit] = []
    if velocity is not None:
        limits.append(VelocityLimit("velocity", *joint_bounds("velocity", velocity, dof)))
    if acceleration is not None:
        pair = joint_bounds("acceleration", acceleration, dof)
        limits.append(AccelerationLimit("acceleration", *pair))
    if speed is not None:
        bound = np.array([_validate.positive("speed", speed)])
        limits.append(SpeedLimit("speed", -bound, bound))
    return limits
