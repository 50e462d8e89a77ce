"""A finer grid: more intervals where time is lost, and a better shape of the profile in each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit, TorqueLimit
from statebook.timescale.profile import Profile

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
    middle = grid.s + grid.h / 2
    u = (profile.x1 - profile.x0) / (2 * grid.h)
    slope = np.diff(u) / np.diff(middle)
    before, after = np.append(0.0, slope), np.append(slope, 0.0)
    for part in grid.sections:
        if part.last - part.first == 1:
            before[part.first] = after[part.first] = 0.0
        else:
            before[part.first] = after[part.first]
            after[part.last - 1] = before[part.last - 1]
    return before, after
