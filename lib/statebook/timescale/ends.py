"""The ends of a motion, its pauses, and a time that is given for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.errors import InfeasiblePathError
from statebook.timescale.jerk import JerkProfile
from statebook.timescale.limits import Limit, TorqueLimit
from statebook.timescale.path import Path
from statebook.timescale.profile import Profile, audit
from statebook.timescale.rows import MARGIN
from statebook.timescale.solve import solve

_TANGENT = 1e-6  # part of a velocity that may point off the path
_ROUNDING = 1e-12  # part of a time by which it may be late and still be that of a pause
_SLOWEST = -700.0  # logarithm of the smallest part of the fastest motion that is mixed in


def speed_at_end(path: Path, name: str, speed: Any, velocity: Any) -> float:
    """Return s' at an end, given as it is or by the velocities of the joints.

    Parameters
    ----------
    path : Path
    name : str
        "start" or "end".
    speed : float >= 0
    velocity : array, shape (dof,), or None
        Along p' there: p' s'.

    Raises
    ------
    TypeError, ValueError
        Both are given, or the velocity is not along the path.
    """
    speed = _validate.non_negative(f"{name}_speed", speed)
    if velocity is None:
        return speed
    if speed > 0:
        raise ValueError(f"give {name}_speed or {name}_velocity, not both")
    velocity = _validate.real_array(f"{name}_velocity", velocity, (path.dof,))
    slope = path(path.s_start if name == "start" else path.s_end, 1)
    square = float(slope @ slope)
    speed = float(slope @ velocity) / square if square > 0 else 0.0
    off = np.linalg.norm(velocity - speed * slope)
    if speed < 0 or off > _TANGENT * np.linalg.norm(velocity):
        raise ValueError(
            f"{name}_velocity must point forward along the path, whose direction there is "
            f"p' = {_validate.brief(slope)}; got {_validate.brief(velocity)}. A spline takes a "
            "direction at its ends by bc_type"
        )
    return speed


@dataclass(frozen=True, eq=False)
class Pauses:
    """Rests of a motion: when they begin, on a clock that stands still in them, and how long."""

    begin: np.ndarray = field(default_factory=lambda: np.zeros(0))
    length: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def moving(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the time in motion at times t, and whether t is in a pause."""
        if not len(self.length):
            return t, np.zeros(t.shape, dtype=bool)
        over = np.concatenate([[0.0], np.cumsum(self.length)])
        past = np.searchsorted(self.begin + over[1:], t, side="right")
        coming = np.append(self.begin, np.inf)[past]
        return np.minimum(t - over[past], coming), t - over[past] >= coming

    def clock(self, moving: np.ndarray) -> np.ndarray:
        """Return when a time in motion is reached first."""
        over = np.concatenate([[0.0], np.cumsum(self.length)])
        begin = self.begin * (1 + _ROUNDING)
        return np.asarray(moving + over[np.searchsorted(begin, moving, side="left")])

    def slower(self, factor: float) -> Pauses:
        """Return the pauses of the motion that takes factor times as long, longer themselves."""
        return Pauses(self.begin * factor, self.length * factor)


def read_dwell(path: Path, dwell: Any, start_speed: float, end_speed: float) -> np.ndarray:
    """Return how long the motion is to pause at each waypoint, shape (N,)."""
    count = len(path.waypoint_s)
    times = np.zeros(count)
    if isinstance(dwell, Mapping):
        for index, value in dwell.items():
            if _validate.integer("the waypoint of a dwell", index, minimum=-count) >= count:
                raise ValueError(f"the waypoint of a dwell must be below {count}, got {index}")
            times[index] = _validate.non_negative("dwell", value)
    elif dwell is not None:
        times = _validate.real_array("dwell", dwell, (count,))
    if np.any(times < 0):
        raise ValueError(f"dwell must be at least 0, got {dwell!r}")
    for name, speed, pause in (("start", start_speed, times[0]), ("end", end_speed, times[-1])):
        if pause > 0 < speed:
            raise ValueError(f"{name}_speed must be 0 where the motion pauses, got {speed:g}")
    return times


def take(
    limits: Sequence[Limit], profile: Profile, duration: float, pause: float, s_end: float
) -> Profile:
    """Return a motion of a given duration, pauses included, with the same speeds at the ends.

    The limits are convex in s'' and s'^2: a mixture of the fastest motion and of a slow one is
    within them.

    Raises
    ------
    InfeasiblePathError
        The duration is out of reach.
    """
    refused = partial(InfeasiblePathError, constraint="duration", s=s_end)
    wanted, shortest = duration - pause, profile.duration
    if wanted < shortest * (1 - 1e-12):
        raise refused(
            f"duration must be at least {shortest + pause:.9g} s, the time of the fastest motion; "
            f"got {duration:g}"
        )
    if wanted <= shortest:
        return profile
    if isinstance(profile, JerkProfile):  # jerk is not convex in them
        slower = profile.slower(wanted / shortest)
        given = profile.grid.sections[0].start or profile.grid.sections[-1].end
        if given or audit(slower, limits).worst.use > 1 + MARGIN:
            raise refused(
                "with a jerk limit a given duration is reached by slowing the motion down "
                "uniformly, which changes speeds given for the ends and must not exceed torque "
                f"limits: here only {shortest + pause:.9g} s is possible; got {duration:g}"
            )
        return slower
    # A slower motion has less drag to brake with: it must do without.
    torques = [one for one in limits if isinstance(one, TorqueLimit) and one.lines]
    every = [*limits, *(replace(one, lines=None) for one in torques)]
    top = profile.controllable[1].T
    slow = solve(every, profile.grid, profile.curvature, top, slowest=True)

    def mixture(logarithm: float) -> Profile:
        part = np.exp(logarithm)
        names = ("x0", "x1", "rise")
        mixed = {n: (1 - part) * getattr(slow, n) + part * getattr(profile, n) for n in names}
        return replace(profile, **mixed)

    def late(logarithm: float) -> float:
        return float(np.log(mixture(logarithm).duration / wanted))

    if late(_SLOWEST) < 0:
        longest = mixture(_SLOWEST).duration + pause
        raise refused(
            f"duration must be at most {longest:.9g} s: with these limits, and these speeds at the "
            f"ends, no motion is slower; got {duration:g}"
        )
    return mixture(scipy.optimize.brentq(late, _SLOWEST, 0.0, xtol=1e-15))
