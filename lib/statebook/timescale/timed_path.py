"""A path with a time for each of its points: what is asked of a timed motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.timescale.ceiling import maximum_speeds
from statebook.timescale.ends import Pauses
from statebook.timescale.limits import Limit
from statebook.timescale.path import Path, horner
from statebook.timescale.profile import Audit, Profile, audit
from statebook.timescale.rows import MARGIN

if TYPE_CHECKING:
    from statebook.trajectory import Trajectory


@dataclass(frozen=True, eq=False, repr=False)
class TimedPath:
    """A path with a time for each of its points, made by `time_scale`.

    Attributes
    ----------
    path : Path
    stops : tuple of float
        Values of s inside the path where its direction jumps and the motion stops.
    skipped : tuple of (float, float)
        Intervals of s along which nothing moves; they take no time.
    gap : float
        Part of the duration by which the optimum is shorter at most: a bound, no estimate.

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
    _pauses: Pauses = field(default_factory=Pauses)

    def __getstate__(self) -> dict[str, Any]:
        self.audit()  # while the caller's functions are there
        return self.__dict__

    def __repr__(self) -> str:
        stops = f", stops at s = {', '.join(f'{s:.4g}' for s in self.stops)}" if self.stops else ""
        return f"TimedPath(duration={self.duration:.6g} s, dof={self.path.dof}{stops})"

    @property
    def duration(self) -> float:
        """Time the motion takes, pauses included [s]."""
        return self._profile.duration + float(self._pauses.length.sum())

    def time_at(self, s: Any) -> Any:
        """Return when the motion arrives at s.

        Parameters
        ----------
        s : float or array, shape (N,)
            Between the ends of the path. Where nothing moves: when that part is reached.

        Returns
        -------
        float or array, shape (N,) [s]

        Examples
        --------
        >>> from statebook import Path, time_scale
        >>> timed = time_scale(Path.through([[0.0, 1.0]]), acceleration=1.0)
        >>> round(timed.time_at(0.5), 6)
        1.0
        """
        s = _validate.real_array("s", s)
        self.path(s)  # refuses what is not on the path
        places = self._profile.grid.find(np.atleast_1d(s))
        times = self._pauses.clock(self._profile.time_at(*places))
        return times if s.ndim else float(times[0])

    @cached_property
    def arrival_times(self) -> np.ndarray:
        """When the motion arrives at the waypoints, `Path.waypoint_s`, shape (N,) [s]."""
        return np.asarray(self.time_at(self.path.waypoint_s))

    def position(self, t: Any) -> np.ndarray:
        """Return the joint positions, which are points of the path.

        Parameters
        ----------
        t : float or array, shape (N,) [s]
            Between 0 and the duration, both of which give the path's ends exactly; beyond them
            by 1e-7 of the duration, the rounding of single precision, is taken for it.

        Returns
        -------
        array, shape (dof,) or (dof, N)

        Raises
        ------
        TypeError, ValueError
            t is not one or more numbers within the motion.
        """
        t = self._times(t)
        value = self._derivative(t, 0)
        if t.ndim:
            value[:, t == self.duration] = self.path(self.path.s_end)[:, None]
        return value if t.ndim or t < self.duration else self.path(self.path.s_end)

    def velocity(self, t: Any) -> np.ndarray:
        """Return the joint velocities p' s'; see `position` for the arguments."""
        return self._derivative(self._times(t), 1)

    def acceleration(self, t: Any) -> np.ndarray:
        """Return the joint accelerations p' s'' + p'' s'^2; see `position` for the arguments.

        Where it jumps: the one after the instant, at the end the last one.
        """
        return self._derivative(self._times(t), 2)

    def jerk(self, t: Any) -> np.ndarray:
        """Return the joint jerks p' s''' + 3 p'' s' s'' + p''' s'^3; see `position`.

        Where it jumps: the one after the instant, at the end the last one.
        """
        return self._derivative(self._times(t), 3)

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
        moving, paused = self._pauses.moving(np.atleast_1d(t))
        i, ds, speed, rate = self._profile.locate(moving)
        grid = self._profile.grid
        k = grid.piece[i]
        stretch = grid.pieces.stretch[k]
        s = grid.pieces.origin[k] + (grid.offset[i] + ds) / stretch
        s = np.clip(s, self.path.s_start, self.path.s_end)
        sdot, sddot = (np.where(paused, 0.0, part / stretch) for part in (speed, rate))
        return (s, sdot, sddot) if t.ndim else (float(s[0]), float(sdot[0]), float(sddot[0]))

    @cached_property
    def s(self) -> np.ndarray:
        """Gridpoints, shape (M,): the ends of the intervals in which s'' is linear in s."""
        return self._gridpoints(*self._profile.grid.s_at(np.array([0.0, 1.0])))

    @cached_property
    def sdot(self) -> np.ndarray:
        """Speed s' along the path at the gridpoints, shape (M,).

        Where s' jumps, because the robot is at rest or p' changes its length: the one before.
        """
        stretch = self._profile.grid.stretch
        return self._gridpoints(*(np.sqrt([self._profile.x0, self._profile.x1]) / stretch))

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the gridpoints, shape (M,), strictly increasing [s]."""
        times = self._profile.times
        return self._pauses.clock(self._gridpoints(times[:-1], times[1:]))

    @cached_property
    def controllable(self) -> np.ndarray:
        """Lowest and highest s' at the gridpoints from which the end can be reached, (2, M)."""
        sets = np.sqrt(self._profile.controllable) / self._profile.grid.stretch[:, None]
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
        return maximum_speeds(self._limits, self._profile.grid, s)

    def audit(self) -> Audit:
        """Return the largest use of every limit over all time, and where it is.

        For velocity, acceleration and speed it is exact; torques are looked at on 5 points of
        each interval. `time_scale` has done this before it returned.
        """
        return self._audit

    @cached_property
    def _audit(self) -> Audit:
        found = audit(self._profile, self._limits)
        clock = self._pauses.clock
        return Audit(tuple(replace(u, time=float(clock(np.array(u.time)))) for u in found))

    def slower(self, factor: float) -> TimedPath:
        """Return the same motion, uniformly slowed down.

        Velocities are divided by factor, accelerations by its square; pauses are factor times
        as long. Without viscous friction torques then lie between their old values and those of
        the robot at rest. The result is audited.

        Parameters
        ----------
        factor : float >= 1
            New duration over the old one.

        Raises
        ------
        ValueError
            factor is below 1, or a torque limit would be exceeded: by the load of the robot at
            rest, or by friction.
        """
        if _validate.positive("factor", factor) < 1:
            raise ValueError(f"factor must be at least 1, got {factor:g}")
        slowed = self._slowed(factor)
        if slowed is None:
            raise ValueError(
                "the motion cannot be slowed down: somewhere on the path the load of the robot at "
                "rest, or driven slowly, exceeds a torque limit"
            )
        return slowed

    def to_trajectory(self, dt: float) -> Trajectory:
        """Return samples at multiples of dt, the last one at the end of the path.

        The motion is slowed down uniformly so that its duration is the next multiple of dt. Where
        that would change the speed given for an end, or the robot at rest would exceed a torque
        limit, it is not, and the last step is shorter than dt.

        Parameters
        ----------
        dt : float > 0 [s]

        Returns
        -------
        Trajectory
            States are positions, then velocities, (2 dof, T); controls the accelerations,
            (dof, T), one per time.
        """
        from statebook.trajectory import Trajectory

        _validate.positive("dt", dt)
        steps = math.ceil(self.duration / dt * (1 - 1e-12))
        timed = self
        ends = np.abs(self.velocity(np.array([0.0, self.duration]))).max()
        at_rest = ends <= 1e-9 * np.abs(self.velocity(self.times)).max()
        if at_rest:
            timed = self._slowed(max(steps * dt / self.duration, 1.0)) or self
        times = np.minimum(dt * np.arange(steps + 1), timed.duration)
        times[-1] = timed.duration
        states = np.concatenate([timed.position(times), timed.velocity(times)])
        return Trajectory(times, states, timed.acceleration(times))

    def _slowed(self, factor: float) -> TimedPath | None:
        """Return the motion slowed down, or None where that breaks a limit."""
        profile, pauses = self._profile.slower(factor), self._pauses.slower(factor)
        slowed = replace(self, _profile=profile, _pauses=pauses)
        worst = slowed.audit().worst.use
        return slowed if worst <= max(1 + MARGIN, self.audit().worst.use) else None

    def _times(self, t: Any) -> np.ndarray:
        """Check times, and put those that rounding has moved beyond the ends back there."""
        t = _validate.real_array("t", t)
        slack = 1e-7 * self.duration
        if t.ndim > 1 or not np.all((t >= -slack) & (t <= self.duration + slack)):
            raise ValueError(
                f"t must be a number or a vector within [0, {self.duration:.9g}], the duration of "
                f"the motion, got {t}"
            )
        return np.minimum(np.maximum(t, 0.0), self.duration)

    def _derivative(self, t: np.ndarray, order: int) -> np.ndarray:
        """Return the position or a derivative of it at times t, (dof,) or (dof, N)."""
        moving, paused = self._pauses.moving(t)
        if order and not t.ndim and paused:
            return np.zeros(self.path.dof)
        profile = self._profile
        i, ds, speed, rate = profile.locate(moving) if t.ndim else profile.locate_one(float(moving))
        grid = self._profile.grid
        k, pieces, c = grid.piece[i], grid.pieces, self.path.curve.c
        stretch, source = pieces.stretch[k], pieces.source[k]
        offset = pieces.begin[k] + (grid.offset[i] + ds) / stretch
        if not order:
            return horner(c, source, offset, 0).T
        # of p', p'' ...
        rates: list[Any] = [speed] if order == 1 else [rate, speed**2]
        if order == 3:
            rates = [profile.third(i, ds, speed), 3 * speed * rate, speed**3]
        value = np.zeros((*np.shape(i), self.path.dof))
        for n, factor in enumerate(rates, 1):
            value += np.asarray(factor / stretch**n)[..., None] * horner(c, source, offset, n)
        if t.ndim:
            value[paused] = 0.0
        return value.T

    def _gridpoints(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return values at the gridpoints, given those at both ends of the intervals."""
        takes_time = np.diff(self._profile.times) > 0
        return np.append(left[0], right[takes_time])
