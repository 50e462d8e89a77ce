"""Friction along a path: what kind it is, and what can be done about each.

Driven at qd = p' v, v = s' > 0, an inverse dynamics with friction is

    tau = a(s) s'' + b(s) v^2 + c(s) + k(s) + d(s) v

with k from the signs of p' (Coulomb), d from viscous friction, and v |v| within b. k is added to
c; it jumps where a joint turns back, and is not there at rest. v is concave in x = v^2: in each
interval it is replaced by a line between its chord and the parallel tangent over the range of x
of the motion found before, with room for half the distance of the two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit, TorqueLimit
from statebook.timescale.path import Path
from statebook.timescale.profile import Profile

_FORM = 1e-7  # part of the torques by which the form may be missed
_WINDOW = 1e-9  # part of the path beside a rest that counts as being there
_IDLE = 1e8  # times the scale of a bound stands for none
_BAND = 0.03  # relative change of s'^2 for which the lines are made
DRAG_LOSS = _BAND**2 / 8  # of the time, at most, where drag takes all the torque
_REST = 1e-6  # part of the largest s'^2 in an interval that is none
_ROUNDS = 12
_LOOSE = 0.03  # tolerance of the first rounds
_LOOK = np.array([1e-9, 0.25, 0.5, 0.75, 1 - 1e-9])  # in intervals


def friction_form(
    dynamics: Callable[..., np.ndarray], q: np.ndarray, slope: np.ndarray, noise: float
) -> tuple[bool, bool]:
    """Return whether there is dry and viscous friction; refuse what is of another form.

    Parameters
    ----------
    dynamics : callable
        (dof, N) each to (rows, N).
    q, slope : array, shape (dof, N)
        Points of the path, and p' there.
    noise : float
        Part of the torques that is the function's own rounding.

    Raises
    ------
    ValueError
        The torque is not k + d v + b v^2 in the speed along the path.
    """
    still = np.zeros_like(q)
    static = dynamics(q, still, still)
    unit = (np.abs(q).max() + np.abs(slope).max()) / max(np.abs(slope).max(), 1e-300)
    speeds = 10.0 ** np.arange(-3, 4)
    torques = np.array([dynamics(q, unit * v * slope, still) - static for v in speeds])
    powers = speeds[:, None] ** np.arange(3)
    some = [0, 3, 6]
    parts = np.linalg.solve(powers[some], torques[some].reshape(3, -1))
    sizes = powers[:, :, None] * np.abs(parts)
    allowed = max(_FORM, 10 * noise) * sizes.sum(axis=1).max(axis=1) + 1e-300
    # Noise in the term of one speed is magnified at higher ones.
    allowed += (1e-12 + 10 * noise * np.maximum(speeds, 1)) * np.abs(static).max()
    off = np.abs(powers @ parts - torques.reshape(len(speeds), -1)).max(axis=1)
    if np.any(off > allowed):
        raise ValueError(
            "inverse_dynamics must be quadratic in qd, up to friction that depends on the signs of "
            "qd (Coulomb) or is proportional to qd (viscous); friction of another kind cannot be "
            "time-scaled this way: leave it out and lower the limits by its size"
        )
    dry, viscous = (sizes[:, :2].max(axis=2) > allowed[:, None]).any(axis=0)
    return bool(dry), bool(viscous)


def reversals(path: Path) -> np.ndarray:
    """Return the places where a joint turns back: dry friction jumps there."""
    roots = path.curve.derivative().roots(discontinuity=True, extrapolate=False)
    return np.concatenate([r[np.isfinite(r)] for r in np.atleast_1d(roots)])


def rests(grid: Grid) -> np.ndarray:
    """Return the bounds of short intervals beside the places where the robot rests, (R, 2)."""
    left, right = grid.s_at(np.array([0.0, 1.0]))
    width = _WINDOW * (right[-1] - left[0])
    begin = [left[part.first] for part in grid.sections if not part.start]
    end = [right[part.last - 1] for part in grid.sections if not part.end]
    return np.array([(s, s + width) for s in begin] + [(s - width, s) for s in end]).reshape(-1, 2)


def at_rest(limit: TorqueLimit, path: Path, windows: np.ndarray) -> TorqueLimit:
    """Return the limit without dry friction, which a robot at rest has not.

    It binds beside the rests alone.
    """
    knots = np.unique(np.concatenate([[path.s_start, path.s_end], windows.ravel()]))
    middle = (knots[1:] + knots[:-1]) / 2
    resting = ((middle[:, None] > windows[:, 0]) & (middle[:, None] < windows[:, 1])).any(axis=1)
    none = _IDLE * np.tile(limit.scale, 2) * np.repeat([-1.0, 1.0], len(limit.scale))
    bounds = np.tile(none, (len(middle), 1))
    given = np.concatenate([limit.lower, limit.upper])
    inside = given if limit.along is None else limit.along(middle[resting])
    bounds[resting] = np.clip(np.where(np.isfinite(given), inside, none), -abs(none), abs(none))
    along = scipy.interpolate.PPoly(bounds[None], knots)
    return replace(
        limit, kind="torque at rest", sliding=False, along=along, loss=float(np.sqrt(_WINDOW))
    )


def _first_speed(limit: TorqueLimit, grid: Grid) -> np.ndarray:
    """Guess s'^2 (5, N): viscous friction takes a quarter of what torque there is."""
    _, _, c, dry, drag = limit.parts(grid, _LOOK)
    lower, upper = limit.bounds(grid, _LOOK)
    room = np.minimum(upper - c - dry, c + dry - lower)
    room = np.clip(room, 1e-3 * limit.scale, limit.scale)
    with np.errstate(divide="ignore"):
        speed = (room / (4 * np.abs(drag))).min(axis=(0, 2))
    return np.tile(np.where(np.isfinite(speed), speed, 1.0) ** 2, (len(_LOOK), 1))


def _speed_of(profile: Profile, grid: Grid) -> np.ndarray:
    """Return s'^2 (5, N) of a motion on another grid of the same path."""
    i, z = profile.grid.find(grid.s_at(_LOOK))
    bend = profile.bulge[i] * z * (1 - z)
    return np.maximum(profile.x0[i] * (1 - z) + profile.x1[i] * z - bend, 0.0)


def drag_lines(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lines alpha + beta x beside v = sqrt(x), and how far they may be off.

    Parameters
    ----------
    x : array, shape (K, N)
        s'^2 at places of each interval: the line is good to its distance in the range of these,
        widened by a band, and at no x lower than v by more than that.

    Returns
    -------
    alpha, beta, distance : array, shape (N,)
    """
    v0, v1 = np.sqrt(_band(x))
    beta = 1 / (v0 + v1)
    distance = (v1 - v0) ** 2 * beta / 8
    return v0 - beta * v0**2 + distance, beta, distance


def _band(x: np.ndarray) -> np.ndarray:
    """Return the range (2, N) around values of s'^2 (K, N); it begins at 0 beside a rest."""
    low, high = x.min(axis=0), x.max(axis=0) * (1 + _BAND) + 1e-300
    return np.stack([np.where(low < _REST * high, 0.0, low * (1 - _BAND)), high])


def settle(
    limits: Sequence[Limit],
    tolerance: float,
    solve: Callable[[Sequence[Limit], float], tuple[Profile, float]],
) -> tuple[list[Limit], Profile, float]:
    """Solve, with viscous friction linearized about the last motion, until the motion stays.

    Parameters
    ----------
    limits : sequence of Limit
    tolerance : float
    solve : callable
        Limits and a tolerance to the fastest motion and a bound on its time from below.

    Returns
    -------
    limits : list of Limit
        With lines that hold for the motion.
    profile : Profile
    least : float
        The least time of motions for which these lines hold.
    """
    current = list(limits)
    viscous = [one for one in current if isinstance(one, TorqueLimit) and one.friction[1]]
    if not viscous:
        return current, *solve(current, tolerance)
    speed: Callable[[Grid], np.ndarray] = partial(_first_speed, viscous[0])
    for first in (True, False):
        for _ in range(_ROUNDS):
            lines = partial(_lines, speed)
            current = [replace(one, lines=lines) if one in viscous else one for one in limits]
            profile, least = solve(current, max(tolerance, _LOOSE) if first else tolerance)
            x, (low, high) = profile.x(_LOOK), _band(speed(profile.grid))
            speed = partial(_speed_of, profile)
            near = x == np.clip(x, low, high)
            if near.all() or (first and near.mean() > 0.9):
                break
    return current, profile, least


def _lines(speed: Callable[[Grid], np.ndarray], grid: Grid) -> tuple[np.ndarray, ...]:
    return drag_lines(speed(grid))
