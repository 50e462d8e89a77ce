"""The time scaling itself, and why there is none where limits cannot be met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.errors import InfeasiblePathError
from statebook.timescale.grid import Grid, lay_grid
from statebook.timescale.limits import (
    DENSE,
    Limit,
    TorqueLimit,
    kinematic_limits,
    require_joints,
)
from statebook.timescale.path import Path
from statebook.timescale.profile import Profile, audit
from statebook.timescale.rows import MARGIN
from statebook.timescale.solve import PASSES, fastest, solve
from statebook.timescale.stages import StuckError
from statebook.timescale.timed_path import TimedPath
from statebook.timescale.torques import torque_limit

_COARSE = 48  # intervals of the first grid
_ENDS = np.array([0.0, 1.0])
_SMALL = 1e-9  # part of a scale that counts as 0
_ROUNDING = 1e-12  # of the audit; a motion that it slows down is then inside the limits


def time_scale(
    path: Path,
    velocity: Any = None,
    acceleration: Any = None,
    *,
    speed: float | None = None,
    torque: Any = None,
    inverse_dynamics: Any = None,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
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
    velocity, acceleration : float > 0 or array, shape (dof,) or (dof, 2), optional
        Bounds on each joint, one number for plus and minus or pairs (lower, upper) around 0;
        infinity stands for no bound.
    speed : float > 0, optional
        Bound on the Euclidean norm of the velocity.
    torque : float > 0 or array, shape (rows,) or (rows, 2), optional
        Bounds on the rows of the inverse dynamics.
    inverse_dynamics : callable, optional
        (q, qd, qdd) -> (rows,) or (rows, N): any number of rows, affine in qdd, quadratic in qd,
        without a jump along the path.
    start_speed, end_speed : float >= 0
        ds/dt at the ends. Where p' = 0 at an end the robot is at rest whatever s' is: there the
        default 0 leaves s' free.
    tolerance : float > 0
        Part of the duration by which the optimum may be missed, as estimated by refinement.

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
    limits = kinematic_limits(velocity, acceleration, speed, path.dof)
    if (torque is None) != (inverse_dynamics is None):
        raise ValueError("torque and inverse_dynamics must be given together")
    start_speed = _validate.non_negative("start_speed", start_speed)
    end_speed = _validate.non_negative("end_speed", end_speed)
    tolerance = _validate.positive("tolerance", tolerance)
    if torque is not None:
        limits.append(torque_limit(path, torque, inverse_dynamics))
    if not any(
        limit.kind in ("acceleration", "torque")
        and np.isfinite(np.concatenate([limit.lower, limit.upper])).any()
        for limit in limits
    ):
        raise ValueError(
            "give an acceleration or a torque limit: without one nothing bounds the acceleration, "
            "and the fastest motion starts with a jump"
        )
    grid, stops, skipped = lay_grid(path, start_speed, end_speed, _COARSE)
    limits = [_without_zeros(limit, grid) for limit in limits]
    _check_speed(path, limits, path.s_start, "start_speed", start_speed)
    _check_speed(path, limits, path.s_end, "end_speed", end_speed)
    try:
        profile, gap = fastest(limits, grid, tolerance)
        profile = _within_limits(limits, profile)
    except StuckError as stuck:
        raise explain(stuck) from None
    return TimedPath(path, stops, skipped, gap, profile, tuple(limits))


def _without_zeros(limit: Limit, grid: Grid) -> Limit:
    """Refuse bounds of 0 on what must not be 0; elsewhere put rounding in their place."""
    zero = np.stack([limit.lower == 0, limit.upper == 0])
    if limit.kind not in ("velocity", "acceleration") or not zero.any():
        return limit
    left, right = (slope / np.maximum(np.abs(slope).max(), 1e-300) for slope in grid.path(_ENDS, 1))
    moves = [(left, range(len(left))), (right, range(len(right)))]
    if limit.kind == "acceleration":  # only at the ends of sections must its sign be that of p'
        moves = [
            (left, [part.first for part in grid.sections if part.start == 0]),
            (-right, [part.last - 1 for part in grid.sections if part.end == 0]),
        ]
    for slope, intervals in moves:
        for side, sign, none in (("upper", 1, zero[1]), ("lower", -1, zero[0])):
            bad = [
                (i, j) for i in intervals for j in np.flatnonzero(none & (sign * slope[i] > _SMALL))
            ]
            if bad:
                i, j = bad[0]
                s = float(grid.s[i])
                raise InfeasiblePathError(
                    f"the path cannot be driven within the limits: the {limit.name(j, side)} is 0, "
                    f"and near s = {s:.6g} the joint must go beyond it",
                    constraint=limit.name(j, side),
                    s=s,
                )
    tiny = _SMALL * limit.scale
    return replace(
        limit,
        lower=np.where(zero[0], -tiny, limit.lower),
        upper=np.where(zero[1], tiny, limit.upper),
    )


def _check_speed(path: Path, limits: Sequence[Limit], s: float, name: str, speed: float) -> None:
    """Refuse a speed at an end of the path that exceeds a velocity limit there."""
    velocity = path(s, 1) * speed
    norm = np.array([np.linalg.norm(velocity)])
    for limit in limits:
        if limit.squared:
            value = velocity if limit.kind == "velocity" else norm
            use = np.maximum(value / limit.upper, value / limit.lower)
            row = int(use.argmax())
            if use[row] > 1 + MARGIN:
                side = "upper" if value[row] > 0 else "lower"
                raise InfeasiblePathError(
                    f"{name} = {speed:g} must keep the limits: it uses {use[row]:.4g} times the "
                    f"{limit.name(row, side)} at s = {s:g}",
                    constraint=limit.name(row, side),
                    s=s,
                )


def _within_limits(limits: Sequence[Limit], profile: Profile) -> Profile:
    """Audit the profile; slow it down by the rounding that is left, split it for torques."""
    torques = [limit for limit in limits if isinstance(limit, TorqueLimit)]
    if not torques:
        factor = max(
            use.use if use.limit != "acceleration" else np.sqrt(use.use)
            for use in audit(profile, limits)
        )
        return profile.slower(factor * (1 + _ROUNDING)) if factor > 1 else profile
    for _ in range(PASSES):
        if audit(profile, limits).worst.use <= 1 + MARGIN:
            return profile
        z = np.linspace(0, 1, DENSE)
        use = np.max(
            [t.use(profile.grid, z, profile.u(z), profile.x(z)).max(axis=(0, 2)) for t in torques],
            axis=0,
        )
        grid, parent, _, _ = profile.grid.split(np.where(use > 1, 2, 1))
        scale = profile.controllable[1, parent, 0]
        curvature = profile.curvature[parent] * (grid.h / profile.grid.h[parent]) ** 2
        profile = solve(limits, grid, curvature, scale, sketch=False)
    worst = audit(profile, limits).worst
    raise InfeasiblePathError(
        f"the {worst.limit} of row {worst.row} could not be kept within its limit at s = "
        f"{worst.s:.6g}: it jumps there, or changes too fast",
        constraint=f"{worst.limit} of row {worst.row}",
        s=worst.s,
    )


_JUMP = 1e-2  # part of a torque limit that is too much for the finest grids


def explain(stuck: StuckError) -> InfeasiblePathError:
    """Return the error that names the limit that cannot be met.

    At the interval that has no solution, the violation of all inequalities is made as small as it
    can be; the one with the largest multiplier is named.
    """
    grid, rows, i = stuck.grid, stuck.rows, stuck.interval

    def at_rest(z: np.ndarray) -> np.ndarray:
        return np.zeros((len(z), len(grid.h)))  # s'' and s'^2

    w, x, c = rows.w[i], rows.x[i], rows.c[i]
    low, high = stuck.following
    count = len(w)
    step = rows.step[i]
    ahead = [[step, 1, -1], [-step, -1, -1]]
    matrix = np.vstack([np.column_stack([w, x, -np.ones(count)]), ahead])
    bound = np.concatenate([-c, [high, -low]])
    fixed = (stuck.x, stuck.x) if stuck.x is not None else (0, None)
    result = scipy.optimize.linprog(
        [0, 0, 1], A_ub=matrix, b_ub=bound, bounds=[(None, None), fixed, (None, None)]
    )
    weights = -np.asarray(result.ineqlin.marginals)[:count]
    worst = int(np.argmax(weights))
    limit, row, side = rows.labels[worst]
    name = limit.name(row, side)
    s = float(grid.s[i])
    advice = "Raise that limit, or change the path or the speeds at its ends"
    if isinstance(limit, TorqueLimit) and limit.misfit(grid, at_rest, at_rest)[i] > _JUMP:
        advice = (
            "The torque of the robot at rest jumps there, or changes too fast: make it smooth, or "
            "time the path in two parts"
        )
    if stuck.x is None:
        reason = "no speed there lets the rest of the path be driven"
    else:
        reason = "there no motion that comes from the start can go on"
    return InfeasiblePathError(
        f"the path cannot be driven within the limits: at s = {s:.6g} the {name} stands in the "
        f"way; {reason}. {advice}",
        constraint=name,
        s=s,
    )
