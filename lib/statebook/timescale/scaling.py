"""The time scaling itself, and why there is none where limits cannot be met."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.errors import InfeasiblePathError
from statebook.timescale.bounds import require_joints
from statebook.timescale.ceiling import ceiling
from statebook.timescale.ends import Pauses, read_dwell, speed_at_end, take
from statebook.timescale.friction import at_rest, rests, settle
from statebook.timescale.grid import Grid, lay_grid
from statebook.timescale.jerk import read_jerk, stop_at_bends
from statebook.timescale.jerk_search import limit_jerk
from statebook.timescale.limits import Limit, TorqueLimit, blocked, kinematic_limits
from statebook.timescale.path import Path
from statebook.timescale.profile import Profile, audit
from statebook.timescale.rows import MARGIN
from statebook.timescale.solve import PASSES, fastest, solve
from statebook.timescale.stages import StuckError
from statebook.timescale.timed_path import TimedPath
from statebook.timescale.tool import tool_limits
from statebook.timescale.torques import torque_limit

_COARSE = 192  # intervals of the first grid
_ENDS = np.array([0.0, 1.0])
_SMALL = 1e-9  # part of a scale that counts as 0
_ROUNDING = 1e-12  # of the audit; a motion that it slows down is then inside the limits


def time_scale(
    path: Path,
    velocity: Any = None,
    acceleration: Any = None,
    *,
    speed: Any = None,
    acceleration_norm: Any = None,
    jerk: Any = None,
    torque: Any = None,
    inverse_dynamics: Any = None,
    tool_speed: Any = None,
    tool_acceleration: Any = None,
    forward_kinematics: Any = None,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
    start_velocity: Any = None,
    end_velocity: Any = None,
    duration: float | None = None,
    dwell: Any = None,
    tolerance: float = 1e-3,
) -> TimedPath:
    """Time a path as fast as limits allow, inside them always.

    On q(t) = p(s(t)): q' = p' s', q'' = p' s'' + p'' s'^2, tau = a(s) s'' + b(s) s'^2 + c(s).
    In each interval of a grid s'^2 is a quadratic in s; limits hold between gridpoints too, by
    construction, and the result is audited before it is returned.

    Parameters
    ----------
    path : Path
        Where its direction jumps the motion stops (`TimedPath.stops`); pieces along which nothing
        moves are skipped (`TimedPath.skipped`).
    velocity, acceleration : float > 0, array or callable, optional
        Bounds on each joint: one number for plus and minus; shape (dof,), or (dof, 2) for pairs
        (lower, upper) around 0; (dof, N) or (dof, 2, N) at each of N waypoints, linear in s
        between them; or a function of s that returns one of the first three. Infinity stands for
        no bound. A function is looked at in 64 pieces of the path; it may jump.
    speed, acceleration_norm : float > 0, array, shape (N,), or callable, optional
        Bound on the Euclidean norm of the velocity, and of the acceleration.
    jerk : float > 0 or array, shape (dof,) or (dof, 2), optional
        Bounds on q''' of each joint, one number for plus and minus or pairs (lower, upper) around
        0. Accelerations are then continuous, and 0 at rest; where p'' jumps the motion stops too.
        Where a speed is given for an end the acceleration there is free. The motion is one that
        no small change makes faster, and its gap an estimate.
    torque : float > 0, array or callable, optional
        Bounds on the rows of the inverse dynamics, given like those of joints; they need not
        enclose 0.
    inverse_dynamics : callable, optional
        (q, qd, qdd) -> (rows,) or (rows, N): any number of rows, affine in qdd, quadratic in qd,
        without a jump along the path.
    tool_speed, tool_acceleration : float > 0, array or callable, optional
        Bounds on the motion of the tool: a number, or (N,) at the waypoints, on the Euclidean
        norm; shape (m,), (m, 2), (m, N) or (m, 2, N) on each axis.
    forward_kinematics : callable
        q -> (m,) or (m, N), the tool's position, smooth along the path.
    start_speed, end_speed : float >= 0
        ds/dt at the ends. Where p' = 0 at an end the robot is at rest whatever s' is: there the
        default 0 leaves s' free.
    start_velocity, end_velocity : array, shape (dof,), optional
        Velocities of the joints at the ends instead: along the path, as it takes no others.
    duration : float > 0, optional
        Time the motion is to take, pauses included, in place of the shortest one.
    dwell : array, shape (N,), or mapping, optional
        How long the motion rests at each of N waypoints, or {index of waypoint: time} [s].
    tolerance : float > 0
        Part of the duration by which the optimum may be missed. Where it cannot be met within
        some seconds, a warning says what was reached (`TimedPath.gap`).

    Returns
    -------
    TimedPath

    Raises
    ------
    InfeasiblePathError
        No motion along the path satisfies the limits; it names the limit and the place.
    TypeError, ValueError
        An argument is wrong, or nothing bounds the acceleration.

    References
    ----------
    K. M. Lynch, F. C. Park, Modern Robotics, section 9.4.

    Examples
    --------
    >>> from statebook import Path, time_scale
    >>> path = Path.through([[0.0, 1.0], [0.0, 0.5]])
    >>> timed = time_scale(path, velocity=1.0, acceleration=2.0)
    >>> round(timed.duration, 6), round(timed.audit().worst.use, 6)
    (1.5, 1.0)
    """
    if not isinstance(path, Path):
        raise TypeError(f"path must be a Path; make one with Path.through, got {path!r}")
    for name, value in (("velocity", velocity), ("acceleration", acceleration)):
        require_joints(name, value, path)
    limits = kinematic_limits(velocity, acceleration, speed, path, acceleration_norm)
    limits += tool_limits(path, tool_speed, tool_acceleration, forward_kinematics)
    if (torque is None) != (inverse_dynamics is None):
        raise ValueError("torque and inverse_dynamics must be given together")
    start_speed = speed_at_end(path, "start", start_speed, start_velocity)
    end_speed = speed_at_end(path, "end", end_speed, end_velocity)
    pauses = read_dwell(path, dwell, start_speed, end_speed)
    if duration is not None:
        duration = _validate.positive("duration", duration)
    tolerance = _validate.positive("tolerance", tolerance)
    if torque is not None:
        limits.append(torque_limit(path, torque, inverse_dynamics))
    if not any(
        limit.kind.endswith(("acceleration", "torque"))
        and np.isfinite(np.concatenate([limit.lower, limit.upper])).any()
        for limit in limits
    ):
        raise ValueError(
            "give an acceleration or a torque limit: without one nothing bounds the acceleration, "
            "and the fastest motion starts with a jump"
        )
    cuts = [curve.x for limit in limits for curve in (limit.along, limit.curve) if curve]
    cuts += [limit.fitted.x for limit in limits if isinstance(limit, TorqueLimit)]
    halts = path.waypoint_s[pauses > 0]
    dry = [one for one in limits if isinstance(one, TorqueLimit) and one.friction[0]]
    laid = partial(lay_grid, path, start_speed, end_speed, _COARSE, halts=halts)
    grid, stops, skipped = laid(cuts=np.concatenate([[], *cuts]))
    if dry:
        windows = rests(grid)
        limits += [at_rest(one, path, windows) for one in dry]
        grid, _, _ = laid(cuts=np.concatenate([*cuts, windows.ravel()]))
    limits = [_without_zeros(limit, grid) for limit in limits]
    places = [("start_speed", path.s_start, start_speed), ("end_speed", path.s_end, end_speed)]
    for name, s, given in places:
        if given > 0:
            _check_place(grid, limits, s, f"{name} = {given:g}", given)
    for s in halts:
        _check_place(grid, limits, float(s), "a dwell", 0.0)
    if jerk is not None:
        bounds = read_jerk(jerk, path, grid)
        grid, bends = stop_at_bends(grid)
        stops = tuple(sorted((*stops, *bends)))
    try:
        loss = max(limit.loss for limit in limits)
        enough = max(tolerance - loss, tolerance / 4, *(1.5 * limit.blur for limit in limits))
        limits, profile, least = settle(
            limits, enough, lambda given, tolerance: fastest(given, grid, tolerance)
        )
        least *= 1 - loss
        profile = _within_limits(limits, profile)
        if jerk is not None:
            profile, least = limit_jerk(limits, bounds, profile, tolerance)
    except StuckError as stuck:
        raise explain(stuck) from None
    gap = max(1 - least / profile.duration, 0.0)
    if gap > tolerance:
        most = "about" if jerk is not None else "at most"
        warnings.warn(
            f"tolerance = {tolerance:g} could not be met on this path: the motion found takes "
            f"{most} {gap:.2g} of its duration more than the fastest one (the gap)",
            stacklevel=2,
        )
    if duration is not None:
        profile = take(limits, profile, duration, float(pauses.sum()), path.s_end)
        gap = max(1 - least / profile.duration, 0.0)
    timed = TimedPath(path, stops, skipped, gap, profile, tuple(limits))
    begin = np.atleast_1d(timed.time_at(halts))
    return replace(timed, _pauses=Pauses(begin, pauses[pauses > 0]))


def _without_zeros(limit: Limit, grid: Grid) -> Limit:
    """Refuse bounds of 0 on what must not be 0; elsewhere put rounding in their place."""
    zero = {"upper": limit.upper == 0, "lower": limit.lower == 0}
    if limit.kind not in ("velocity", "acceleration") or not np.any(list(zero.values())):
        return limit
    slopes = grid.path(_ENDS, 1)
    left, right = slopes / np.maximum(np.abs(slopes).max(axis=(1, 2), keepdims=True), 1e-300)
    first = last = np.arange(len(left))
    if limit.kind == "acceleration":  # only at the ends of sections must its sign be that of p'
        first = np.array([part.first for part in grid.sections if part.start == 0], dtype=int)
        last = np.array([part.last - 1 for part in grid.sections if part.end == 0], dtype=int)
        right = -right
    moves, at = np.concatenate([left[first], right[last]]), grid.s[np.append(first, last)]
    for side, sign in (("upper", 1), ("lower", -1)):
        for i, j in np.argwhere(zero[side] & (sign * moves > _SMALL))[:1].tolist():
            raise InfeasiblePathError(
                f"the path cannot be driven within the limits: the {limit.name(j, side)} is 0, "
                f"and near s = {at[i]:.6g} the joint must go beyond it",
                constraint=limit.name(j, side),
                s=float(at[i]),
            )
    tiny = _SMALL * limit.scale
    return replace(
        limit,
        lower=np.where(zero["lower"], -tiny, limit.lower),
        upper=np.where(zero["upper"], tiny, limit.upper),
    )


def _check_place(grid: Grid, limits: Sequence[Limit], s: float, cause: str, speed: float) -> None:
    """Refuse a given speed that exceeds a velocity limit, or a rest that exceeds a torque limit."""
    grid, middle = grid.at(np.array([s])), np.zeros(1)
    x = ((speed * grid.stretch) ** 2)[None]
    for limit in limits:
        if limit.squared or (speed == 0 and isinstance(limit, TorqueLimit)):
            use = limit.use(grid, middle, np.zeros_like(x), x)[0, 0]
            row = int(use.argmax())
            if use[row] > 1 + MARGIN:
                lower, upper = (np.ravel(bound)[row] for bound in limit.bounds(grid, middle))
                value = limit.values(grid, middle, np.zeros_like(x), x)[0, 0, row]
                above = value - upper > lower - value
                name = limit.name(row, "upper" if above else "lower")
                raise InfeasiblePathError(
                    f"{cause} must keep the limits: it uses {use[row]:.4g} times the {name} at "
                    f"s = {s:g}",
                    constraint=name,
                    s=s,
                )


def _within_limits(limits: Sequence[Limit], profile: Profile) -> Profile:
    """Audit the profile; slow it down by the rounding that is left, leave more room for torques."""
    loaded = any(isinstance(limit, TorqueLimit) for limit in limits)
    for attempt in range(PASSES + 1):
        uses = audit(profile, limits)
        worst, excess = uses.worst, uses.worst.use - 1
        if excess <= MARGIN * (loaded or attempt == PASSES):
            return profile
        if loaded:
            if attempt:  # polynomials miss the torques, or a tool, by more than was seen
                limits = [
                    replace(one, margin=one.margin + 2 * excess)
                    if isinstance(one, TorqueLimit) or one.slip is not None
                    else one
                    for one in limits
                ]
            top = ceiling(limits, profile.grid).x
            profile = solve(limits, profile.grid, profile.curvature, top)
        else:  # on very short intervals the rounding is another each time
            factor = max(use.factor for use in uses)
            profile = profile.slower(factor ** (1 + attempt) * (1 + _ROUNDING))
    raise InfeasiblePathError(
        f"the {worst.limit} of row {worst.row} could not be kept within its limit at s = "
        f"{worst.s:.6g}: it jumps there, or changes too fast",
        constraint=f"{worst.limit} of row {worst.row}",
        s=worst.s,
    )


def explain(stuck: StuckError) -> InfeasiblePathError:
    """Return the error that names the limit that cannot be met.

    At the interval that has no solution, the violation of all inequalities is made as small as it
    can be; the one with the largest multiplier is named.
    """
    rows, i = stuck.rows, stuck.interval
    low, high = stuck.following
    count, step = rows.w.shape[1], rows.step[i]
    every = np.column_stack([rows.w[i], rows.x[i], -np.ones(count)])
    matrix = np.vstack([every, [[step, 1, -1], [-step, -1, -1]]])
    bound = np.concatenate([-rows.c[i], [high, -low]])
    fixed = (stuck.x, stuck.x) if stuck.x is not None else (0, None)
    result = scipy.optimize.linprog(
        [0, 0, 1], A_ub=matrix, b_ub=bound, bounds=[(None, None), fixed, (None, None)]
    )
    worst = int(np.argmin(result.ineqlin.marginals[:count]))
    limit, row, side = rows.labels[rows.which[i, worst]]
    reason = "there no motion that comes from the start can go on"
    if stuck.x is None:
        reason = "no speed there lets the rest of the path be driven"
    return blocked(
        limit.name(row, side),
        float(stuck.grid.s[i]),
        f"stands in the way; {reason}. Raise that limit, or change the path or the speeds at its "
        "ends",
    )
