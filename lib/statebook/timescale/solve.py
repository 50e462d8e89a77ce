"""The fastest profile: where the grid must be finer, and the search for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit, TorqueLimit
from statebook.timescale.profile import Profile
from statebook.timescale.rows import MARGIN
from statebook.timescale.stages import StuckError, fastest_profile

_LOOK = np.array([0.02, 0.25, 0.5, 0.75, 0.98])  # where in an interval slack is looked for
_ENDS = np.array([0.0, 0.5, 1.0])
_ACTIVE = 0.7  # a limit used this much is taken for the one the profile follows
_PARTS = 4  # an interval is split into at most so many
_MISFIT = 1e-3  # part of a torque limit by which polynomials may miss the torque


def refine(
    limits: Sequence[Limit], profile: Profile, tolerance: float
) -> tuple[Grid, np.ndarray, np.ndarray]:
    """Split the intervals where time is lost, and those in which torques change too fast.

    On the fastest motion some limit is reached at every instant: time is lost where none is.

    Returns
    -------
    grid : Grid
    curvature : array, shape (N,)
        Of the profile in each new interval, as in `Profile`.
    scale : array, shape (N,)
        Size of s'^2.
    """
    x, u = profile.x(_LOOK), profile.u(_LOOK)
    use = np.max([limit.use(profile.grid, _LOOK, u, x).max(axis=2) for limit in limits], axis=0)
    lost = np.diff(profile.times) * np.clip(1 - use, 0, 1).mean(axis=0)
    allowed = tolerance * profile.duration / len(lost)
    parts = np.clip(np.ceil(np.sqrt(lost / allowed)), 1, _PARTS).astype(int)
    parts[_bottlenecks(profile)] = _PARTS
    for limit in limits:
        if isinstance(limit, TorqueLimit):
            parts[limit.misfit(profile.grid, profile.u, profile.x) > _MISFIT] = _PARTS
    grid, parent, left, right = profile.grid.split(parts)
    z = left + np.multiply.outer(_ENDS, right - left)
    bulge, chord = profile.bulge[parent], (profile.x1 - profile.x0)[parent]
    x = np.maximum(profile.x0[parent] + chord * z - bulge * z * (1 - z), 0.0)
    u = (chord - bulge * (1 - 2 * z)) / (2 * profile.grid.h[parent])
    mean = np.maximum((x[0] + x[2]) / 2, 1e-300)
    curvature = np.clip(_bulge(limits, profile, grid, parent, u, x) / mean, -1.0, 1.0)
    return grid, curvature, profile.controllable[1, parent, 0]


def _bottlenecks(profile: Profile) -> np.ndarray:
    """Return whether the profile leaves the controllable set's edge in or beside an interval.

    There it turns from braking to gaining speed. A little time lost at such a place is lost on
    the whole way down to it and up from it.
    """
    edge = profile.controllable[1] * (1 - 1e-6)
    leaves = (profile.x0 >= edge[:, 0]) & (profile.x1 < edge[:, 1])
    beside = leaves.copy()
    beside[1:] |= leaves[:-1]
    beside[:-1] |= leaves[1:]
    return beside


def _bulge(
    limits: Sequence[Limit],
    profile: Profile,
    grid: Grid,
    parent: np.ndarray,
    u: np.ndarray,
    x: np.ndarray,
) -> np.ndarray:
    """Return the bend of the profile, h^2 ds''/ds, that follows the limit nearest to its bound.

    It is kept between those which the neighbours on both sides suggest, or 0. Without a limit to
    follow it is the smaller of these, 0 if they disagree in sign: s'' jumps there.
    """
    before, after = (slope[parent] * grid.h**2 for slope in _slopes(profile))
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    bulge = np.where(before * after > 0, smaller, 0.0)
    low, high = np.minimum(np.minimum(before, after), 0), np.maximum(np.maximum(before, after), 0)
    best = np.full(len(bulge), _ACTIVE)
    for limit in limits:
        use, wanted = limit.follow(grid, _ENDS, u, x)
        better = (use > best) & np.isfinite(wanted)
        bulge = np.where(better, np.clip(wanted, low, high), bulge)
        best = np.where(better, use, best)
    return bulge


def _slopes(profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Return the differences quotients of s'' to the interval before and to the one after.

    At the ends of a section both are the one there is; 0 if there is none.
    """
    grid = profile.grid
    u = (profile.x1 - profile.x0) / (2 * grid.h)
    slope = np.diff(u) / ((grid.h[1:] + grid.h[:-1]) / 2)
    before, after = np.append(0.0, slope), np.append(slope, 0.0)
    for part in grid.sections:
        if part.last - part.first == 1:
            before[part.first] = after[part.first] = 0.0
        else:
            before[part.first] = after[part.first]
            after[part.last - 1] = before[part.last - 1]
    return before, after


PASSES = 8
_INTERVALS = 20000  # no grid is refined beyond this
_LARGEST_MARGIN = 1e-5  # by which controllable sets are narrowed against rounding
_SEARCH = 3000  # intervals of the finest grid on which a first solution is looked for
_CONVERGENCE = 3.0  # a refinement divides the gap to the optimum by at least 1 + this


def fastest(limits: Sequence[Limit], grid: Grid, tolerance: float) -> tuple[Profile, float]:
    """Solve and refine until the gap to the optimum is below the tolerance, by estimate."""
    profile, safe = _started(limits, grid)
    gap = np.inf
    for _ in range(PASSES):
        before, was_safe = profile.duration, safe
        profile, safe = _solved(limits, *refine(limits, profile, tolerance))
        if safe and was_safe:
            gap = abs(before - profile.duration) / profile.duration / _CONVERGENCE
            if gap <= tolerance or len(profile.x0) > _INTERVALS:
                return profile, float(gap)
    if not safe:
        fastest_profile(limits, profile.grid, profile.curvature, profile.controllable[1, :, 0])
    return profile, float(gap)


def _started(limits: Sequence[Limit], grid: Grid) -> tuple[Profile, bool]:
    """Solve on the first grid, or on the finer one that a solution needs if there is one."""
    scale = _first_scale(limits, grid)
    while True:
        try:
            return _solved(limits, grid, np.zeros(len(scale)), scale)
        except StuckError:
            if len(scale) > _SEARCH:
                raise
        grid, parent, _, _ = grid.split(np.full(len(scale), 4))
        scale = scale[parent]


def _solved(
    limits: Sequence[Limit], grid: Grid, curvature: np.ndarray, scale: np.ndarray
) -> tuple[Profile, bool]:
    """Solve the stages; where no motion is safe on this grid, return a sketch of one.

    The second result tells which: a sketch serves to refine the grid, on which then a safe motion
    may exist.
    """
    try:
        return solve(limits, grid, curvature, scale, sketch=False), True
    except StuckError:
        return solve(limits, grid, curvature, scale, sketch=True), False


def solve(
    limits: Sequence[Limit],
    grid: Grid,
    curvature: np.ndarray,
    scale: np.ndarray,
    sketch: bool,
    slowest: bool = False,
) -> Profile:
    """Solve the stages, with a better scale or more room for rounding where it is needed."""
    margin = MARGIN
    while True:
        try:
            profile = fastest_profile(limits, grid, curvature, scale, margin, sketch, slowest)
        except StuckError:
            if margin > _LARGEST_MARGIN / 10:
                raise
            margin *= 100
            continue
        reach = profile.controllable[1, :, 0]
        if np.all((reach < 1e3 * scale) & (reach > 1e-3 * scale)):
            return profile
        scale = reach


def _first_scale(limits: Sequence[Limit], grid: Grid) -> np.ndarray:
    """Guess the size of s'^2 in each interval, from velocities and the way left to brake."""
    middle = np.array([0.25, 0.75])
    count = len(grid.h)
    cap = np.full(count, np.inf)
    rates = np.full((2, count), np.inf)  # of braking and of gaining speed
    for limit in limits:
        a, b, _ = limit.terms(grid, middle, np.ones(count))
        with np.errstate(divide="ignore", over="ignore"):
            if limit.squared:
                cap = np.minimum(cap, (limit.scale**2 / np.abs(b)).min(axis=(0, 2)))
            elif a is not None:
                rate = limit.scale / np.abs(a)
                for i, (up, down) in enumerate(
                    [(limit.lower, limit.upper), (limit.upper, limit.lower)]
                ):
                    bounded = np.isfinite(np.where(a > 0, up, down)) & (a != 0)
                    best = np.where(bounded, rate, np.inf).min(axis=(0, 2))
                    rates[i] = np.minimum(rates[i], best)
    unbounded = np.flatnonzero(~np.isfinite(rates).all(axis=0))
    if len(unbounded):
        raise ValueError(
            "the limits leave the acceleration along the path unbounded at s = "
            f"{grid.s[unbounded[0]]:g}: bound that of a joint that moves there, or its torque, on "
            "both sides"
        )
    scale = np.empty(count)
    for part in grid.sections:
        inside = slice(part.first, part.last)
        way = np.cumsum((2 * grid.h * rates[0])[inside][::-1])[::-1]
        scale[inside] = np.minimum(way, cap[inside])
    return scale
