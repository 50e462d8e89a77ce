"""The (s, s') plane: where the limits leave room for a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit
from statebook.timescale.path import Path, horner
from statebook.timescale.profile import Audit, Profile, Use, audit, static_torques_hold

if TYPE_CHECKING:
    from statebook.trajectory import Trajectory


def maximum_speeds(path: Path, limits: Sequence[Limit], s: np.ndarray) -> np.ndarray:
    """Return the largest s' for which some s'' satisfies all limits, shape (N,).

    Each limit is a half-plane g u + b x <= c. Two of them with g of opposite sign leave a u only
    if (b1/g1 + b2/abs(g2)) x <= c1/g1 + c2/abs(g2); the smallest such bound on x counts.
    """
    knots = path.curve.x
    piece = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
    grid = Grid(path.curve.c, knots, piece, s - knots[piece], np.zeros(len(s)), ())
    middle = np.zeros(1)
    gs, bs, cs = [], [], []
    for limit in limits:
        inertial, quadratic, static = limit.terms(grid, middle, np.ones(len(s)))
        slope = quadratic[0]
        if limit.squared:
            size = limit.scale**2
            sides = [(1.0, limit.squared_bounds(grid.path(middle, 1)))]
        else:
            size = limit.scale
            shift = np.zeros_like(slope) if static is None else static[0]
            sides = [(1.0, limit.upper - shift), (-1.0, shift - limit.lower)]
        for sign, bound in sides:
            gs.append(np.zeros_like(slope) if inertial is None else sign * inertial[0] / size)
            bs.append(sign * slope / size)
            cs.append(np.broadcast_to(bound / size, slope.shape))
    g, b, c = (np.concatenate(parts, axis=1) for parts in (gs, bs, cs))
    highest = np.full(len(s), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.abs(g) <= 1e-12 * np.abs(g).max(axis=0)
        direct = np.where(flat & (b > 0), c / b, np.inf)
        np.minimum(highest, direct.min(axis=1), out=highest)
        rise, fall = ~flat & (g > 0), ~flat & (g < 0)
        for k in range(g.shape[1]):
            pairs = rise[:, k, None] & fall
            slope = b[:, k, None] / g[:, k, None] + b / -g
            room = c[:, k, None] / g[:, k, None] + c / -g
            bound = np.where(pairs & (slope > 0), room / slope, np.inf)
            np.minimum(highest, bound.min(axis=1), out=highest)
    return np.sqrt(np.maximum(highest, 0.0))


@dataclass(frozen=True, eq=False, repr=False)
class TimedPath:
    """A path with a time for each of its points, made by `time_scale`.

    Attributes
    ----------
    path : Path
    stops : tuple of float
        Values of s inside the path where p' jumps and the motion stops.
    skipped : tuple of (float, float)
        Intervals of s along which nothing moves; they take no time.
    gap : float
        Estimated part of the duration by which the optimum is shorter.

    Examples
    --------
    >>> from statebook import Path, time_scale
    >>> timed = time_scale(Path.through([[0.0, 1.0]]), acceleration=1.0)
    >>> timed
    TimedPath(duration=2 s, dof=1)
    >>> timed.position(1.0).round(6)
    array([0.5])
    """

    path: Path
    stops: tuple[float, ...]
    skipped: tuple[tuple[float, float], ...]
    gap: float
    _profile: Profile
    _limits: tuple[Limit, ...]

    def __repr__(self) -> str:
        stops = f", stops at s = {', '.join(f'{s:.4g}' for s in self.stops)}" if self.stops else ""
        return f"TimedPath(duration={self.duration:.6g} s, dof={self.path.dof}{stops})"

    @property
    def duration(self) -> float:
        """Time the motion takes [s]."""
        return self._profile.duration

    def position(self, t: Any) -> np.ndarray:
        """Return the joint positions, which are points of the path.

        Parameters
        ----------
        t : float or array, shape (N,) [s]
            Between 0 and the duration, both of which give the path's ends exactly; beyond them
            by 1e-9 of the duration is taken for rounding.

        Returns
        -------
        array, shape (dof,) or (dof, N)

        Raises
        ------
        TypeError, ValueError
            t is not one or more numbers within the motion.
        """
        t = self._times(t)
        value = np.empty((self.path.dof, t.size))
        if self.duration > 0:
            piece, offset, _, _ = self._along(t)
            value[:] = horner(self.path.curve.c, piece, offset, 0).T
        times = np.atleast_1d(t)
        value[:, times == 0] = self.path(self.path.s_start)[:, None]
        value[:, times == self.duration] = self.path(self.path.s_end)[:, None]
        return value if t.ndim else value[:, 0]

    def velocity(self, t: Any) -> np.ndarray:
        """Return the joint velocities p' s'; see `position` for the arguments."""
        return self._derivative(t, 1)

    def acceleration(self, t: Any) -> np.ndarray:
        """Return the joint accelerations p' s'' + p'' s'^2; see `position` for the arguments.

        Where it jumps: the one after the instant, at the end the last one.
        """
        return self._derivative(t, 2)

    def progress(self, t: Any) -> tuple[Any, Any, Any]:
        """Return s, s' and s'' at times t.

        Parameters
        ----------
        t : float or array, shape (N,) [s]

        Returns
        -------
        s, sdot, sddot : float or array, shape (N,)
        """
        t = self._times(t)
        if self.duration == 0:
            s = np.full(t.size, self.path.s_start)
            values = s, np.zeros(t.size), np.zeros(t.size)
        else:
            i, ds, speed, rate = self._profile.locate(np.atleast_1d(t))
            s = np.clip(self._profile.grid.s[i] + ds, self.path.s_start, self.path.s_end)
            values = s, speed, rate
        s, sdot, sddot = values
        return (s, sdot, sddot) if t.ndim else (float(s[0]), float(sdot[0]), float(sddot[0]))

    @cached_property
    def s(self) -> np.ndarray:
        """Gridpoints, shape (M,): the ends of all intervals.

        A gridpoint where s' jumps, because the robot is at rest there, comes twice.
        """
        grid = self._profile.grid
        return self._gridpoints(grid.s, grid.s + grid.h)

    @cached_property
    def sdot(self) -> np.ndarray:
        """Speed s' along the path at the gridpoints, shape (M,)."""
        return np.sqrt(self._gridpoints(self._profile.x0, self._profile.x1))

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the gridpoints, shape (M,) [s]."""
        times = self._profile.times
        return self._gridpoints(times[:-1], times[1:])

    @cached_property
    def controllable(self) -> np.ndarray:
        """Lowest and highest s' at the gridpoints from which the end can be reached, (2, M)."""
        sets = np.sqrt(self._profile.controllable)
        return np.stack([self._gridpoints(side[:, 0], side[:, 1]) for side in sets])

    def maximum_speed(self, s: Any) -> np.ndarray:
        """Return the maximum-velocity curve: the largest s' any s'' allows at s.

        Parameters
        ----------
        s : array, shape (N,)
            Between the ends of the path.

        Returns
        -------
        array, shape (N,)
            Infinite where no limit bounds s'.
        """
        s = _validate.real_array("s", s, (None,))
        self.path(s)  # refuses what is not on the path
        return maximum_speeds(self.path, self._limits, s)

    def audit(self) -> Audit:
        """Return the largest use of every limit over all time, and where it is.

        For velocity, acceleration and speed it is exact; torques are looked at on 17 points of
        each interval. `time_scale` has done this before it returned.
        """
        return self._audit

    @cached_property
    def _audit(self) -> Audit:
        if self.duration == 0:
            rows = [(limit.kind, row) for limit in self._limits for row in range(len(limit.upper))]
            return Audit(tuple(Use(*row, 0.0, 0.0, self.path.s_start, True) for row in rows))
        return audit(self._profile, self._limits)

    def slower(self, factor: float) -> TimedPath:
        """Return the same motion, uniformly slowed down.

        Velocities are divided by factor, accelerations by its square. Torques then lie between
        their old values and those of the robot at rest, so these must be within the limits.

        Parameters
        ----------
        factor : float >= 1
            New duration over the old one.

        Raises
        ------
        ValueError
            factor is below 1, or the robot at rest would exceed a torque limit.
        """
        if _validate.positive("factor", factor) < 1:
            raise ValueError(f"factor must be at least 1, got {factor:g}")
        if (
            factor > 1
            and self.duration > 0
            and not static_torques_hold(self._profile, self._limits)
        ):
            raise ValueError(
                "the motion cannot be slowed down: somewhere on the path the load of the robot at "
                "rest exceeds a torque limit"
            )
        return replace(self, _profile=self._profile.slower(factor))

    def to_trajectory(self, dt: float) -> Trajectory:
        """Return samples at multiples of dt, the last one at the end of the path.

        The motion is slowed down uniformly so that its duration is the next multiple of dt.

        Parameters
        ----------
        dt : float > 0 [s]

        Returns
        -------
        Trajectory
            States are positions, then velocities, (2 dof, T); controls the accelerations,
            (dof, T), one per time.

        Raises
        ------
        ValueError
            The motion cannot be slowed down: the speed at one of its ends is given, or the robot
            at rest would exceed a torque limit. Sample `position` at times of your own then.
        """
        from statebook.trajectory import Trajectory

        _validate.positive("dt", dt)
        steps = max(math.ceil(self.duration / dt * (1 - 1e-12)), 0)
        timed = self
        if self.duration > 0:
            factor = max(steps * dt / self.duration, 1.0)
            moving = np.abs(self.velocity(np.array([0.0, self.duration]))).max()
            peak = np.abs(self.velocity(self.times)).max()
            if factor > 1 + 1e-9 and moving > 1e-9 * peak:
                raise ValueError(
                    "slowing down to a multiple of dt would change the speeds given for the ends; "
                    f"choose dt so that {self.duration:.12g} s is a multiple of it, or sample "
                    "position(t) yourself"
                )
            timed = self.slower(factor)
        times = np.linspace(0.0, timed.duration, steps + 1)
        states = np.concatenate([timed.position(times), timed.velocity(times)])
        return Trajectory(dt * np.arange(steps + 1), states, timed.acceleration(times))

    def _times(self, t: Any) -> np.ndarray:
        """Check times, and put those that rounding has moved beyond the ends back there."""
        t = _validate.real_array("t", t)
        slack = 1e-9 * self.duration
        if t.ndim > 1 or np.any((t < -slack) | (t > self.duration + slack)):
            raise ValueError(
                f"t must be a number or a vector within [0, {self.duration:.9g}], the duration of "
                f"the motion, got {t}"
            )
        return np.clip(t, 0.0, self.duration)

    def _along(self, t: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the piece of the curve, the offset in it, s' and s'' at times t."""
        i, ds, speed, rate = self._profile.locate(np.atleast_1d(t))
        grid = self._profile.grid
        return grid.piece[i], grid.offset[i] + ds, speed, rate

    def _derivative(self, t: Any, order: int) -> np.ndarray:
        t = self._times(t)
        value = np.zeros((self.path.dof, t.size))
        if self.duration > 0:
            piece, offset, speed, rate = self._along(t)
            slope = horner(self.path.curve.c, piece, offset, 1)
            if order == 1:
                value = (slope * speed[:, None]).T
            else:
                bend = horner(self.path.curve.c, piece, offset, 2)
                value = (slope * rate[:, None] + bend * (speed**2)[:, None]).T
        return value if t.ndim else value[:, 0]

    def _gridpoints(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Join values at both ends of the intervals to one vector, section by section."""
        parts = [
            np.append(left[part.first : part.last], right[part.last - 1])
            for part in self._profile.grid.sections
        ]
        return np.concatenate(parts) if parts else np.zeros(0)
