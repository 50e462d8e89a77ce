"""The fastest profile: where the grid must be finer, and the search for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from statebook.timescale.ceiling import ceiling
from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit
from statebook.timescale.profile import Profile
from statebook.timescale.rows import FREE
from statebook.timescale.stages import NARROWING, StuckError, fastest_profile

_LOOK = np.array([0.02, 0.25, 0.5, 0.75, 0.98])  # where in an interval slack is looked for
_ENDS = np.array([0.0, 0.5, 1.0])
_ACTIVE = 0.7  # a limit used this much is taken for the one the profile follows
_PARTS = 4  # an interval is split into at most so many


def refine(
    limits: Sequence[Limit],
    profile: Profile,
    least: np.ndarray,
    stuck: bool = False,
    narrow: bool = False,
) -> tuple[Grid, np.ndarray]:
    """Split the intervals where time is lost, or not known not to be.

    On the fastest motion some limit is reached at every instant: time is lost where none is.

    Parameters
    ----------
    limits : sequence of Limit
    profile : Profile
    least : array, shape (N,)
        Times of the intervals that no motion is below.
    stuck : bool
        Whether no motion was found on the grid: then all intervals are split.
    narrow : bool
        Whether only those are split where the motion has to be slow.

    Returns
    -------
    grid : Grid
    curvature : array, shape (N,)
        Of the profile in each new interval, as in `Profile`.
    """
    x, u = profile.x(_LOOK), profile.u(_LOOK)
    use = np.max([limit.use(profile.grid, _LOOK, u, x).max(axis=2) for limit in limits], axis=0)
    times = np.diff(profile.times)
    lost = np.maximum(times * np.clip(1 - use, 0, 1).mean(axis=0), times - least)
    allowed = max(float(lost.sum()), 1e-12 * profile.duration) / (_GAIN * len(lost))
    parts = np.clip(np.ceil(np.sqrt(lost / allowed)), 1 + stuck, _PARTS).astype(int)
    parts = np.where(_bottlenecks(profile), _PARTS, 1 if narrow else parts)
    grid, parent, left, right = profile.grid.split(parts)
    z = left + np.multiply.outer(_ENDS, right - left)
    bend, chord = profile.bulge[parent], profile.rise[parent]
    x = np.maximum(profile.x0[parent] + chord * z - bend * z * (1 - z), 0.0)
    u = (chord - bend * (1 - 2 * z)) / (2 * profile.grid.h[parent])
    mean = np.maximum((x[0] + x[2]) / 2, 1e-300)
    # The bend h^2 ds''/ds follows the limit nearest to its bound, kept between those which the
    # neighbours on both sides suggest, or 0. Without a limit to follow it is the smaller of these,
    # 0 if they disagree in sign: s'' jumps there.
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
    return grid, np.clip(bulge / mean, -1.0, 1.0)


def _bottlenecks(profile: Profile) -> np.ndarray:
    """Return whether the profile leaves the controllable set's edge in or beside an interval.

    There it turns from braking to gaining speed. A little time lost at such a place is lost on
    the whole way down to it and up from it.
    """
    edge = profile.controllable[1] * (1 - 1e-6)
    leaves = (profile.x0 >= edge[:, 0]) & (profile.x1 < edge[:, 1])
    return np.convolve(leaves, [1, 1, 1])[1:-1] > 0


def _slopes(profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Return the differences quotients of s'' to the interval before and to the one after.

    At the ends of a section both are the one there is; 0 if there is none.
    """
    grid = profile.grid
    u = profile.rise / (2 * grid.h)
    slope = np.diff(u) / ((grid.h[1:] + grid.h[:-1]) / 2)
    before, after = np.append(0.0, slope), np.append(slope, 0.0)
    for part in grid.sections:
        if part.last - part.first == 1:
            before[part.first] = after[part.first] = 0.0
        else:
            before[part.first] = after[part.first]
            after[part.last - 1] = before[part.last - 1]
    return before, after


PASSES = 8  # of splitting for torques
_GAIN = 3.0  # a refinement divides the time lost by about so much
_WORK = 8000.0  # rows that are solved in all for each interval of a first grid, at most
_SMALLEST = 1000  # intervals: a smaller first grid counts as one of these
_OVERHEAD = 110  # of an interval, in rows
_LARGEST_NARROWING = 1e-5  # of controllable sets against rounding
_RANGE = 1e3  # of s'^2 in an interval, beyond which its smaller end gives the scale
_NAMED = 400  # intervals on which the place of a refusal is looked for
_SEARCH = 6000  # intervals of the finest grid on which a first solution is looked for


def fastest(limits: Sequence[Limit], grid: Grid, tolerance: float) -> tuple[Profile, float]:
    """Solve and refine until the duration is near the least one, or the work too much.

    Grids do not depend on the tolerance: a smaller one goes on where a larger one ends.

    Returns
    -------
    profile : Profile
        The fastest motion found.
    least : float
        No motion takes less time.
    """
    _require_bounded(limits, grid)
    rows = sum(2 * len(limit.upper) * (limit.degree(grid) + 1) for limit in limits)
    curvature = np.zeros(len(grid.h))
    best, least, tries = None, 0.0, 0
    work = _WORK * max(len(grid.h), _SMALLEST)
    while True:
        top = ceiling(limits, grid)
        least = max(least, top.duration)
        guide: Profile | None = None
        try:
            guide = solve(limits, grid, curvature, top.x)
            best = guide if best is None or guide.duration < best.duration else best
        except StuckError:
            guide = _without_start(limits, grid, curvature, top.x)
            tries += guide is not None
            over = work < 0 if guide else len(grid.h) > _SEARCH
            if best is None and (over or not top.possible):
                fine, parent, *_ = grid.split(np.full(len(grid.h), max(_NAMED // len(grid.h), 1)))
                flat = np.zeros(len(fine.h))
                solve(limits, fine, flat, top.x[:, parent], every_row=True)  # raises what is named
                raise
        stuck = best is None and guide is None
        narrow = best is None and not stuck and tries % 3 > 0
        if guide is None:
            x = np.maximum(top.x, 1e-300)
            sets = np.stack([0 * x.T, x.T])
            guide = Profile(grid, x[0], x[1], x[1] - x[0], np.zeros(len(grid.h)), sets)
        work -= len(grid.h) * (_OVERHEAD + rows)
        if best is not None and least >= best.duration * (1 - tolerance):
            return best, least
        grid, curvature = refine(limits, guide, top.times, stuck, narrow)
        if best is not None and len(grid.h) * (_OVERHEAD + rows) > work:
            return best, least


def _without_start(
    limits: Sequence[Limit], grid: Grid, curvature: np.ndarray, top: np.ndarray
) -> Profile | None:
    """Return the fastest motion that begins no faster than it must, None if there is none.

    If there is, the grid is too coarse for the speed that is given.
    """
    free = [p._replace(start=p.start and None, end=p.end and None) for p in grid.sections]
    try:
        found = solve(limits, replace(grid, sections=tuple(free)), curvature, top)
        return replace(found, grid=grid)
    except StuckError:
        return None


def solve(
    limits: Sequence[Limit],
    grid: Grid,
    curvature: np.ndarray,
    top: np.ndarray,
    slowest: bool = False,
    every_row: bool = False,
) -> Profile:
    """Solve the stages, with a better scale or more room for rounding where it is needed."""
    narrowing, rescalings = NARROWING, 3
    smaller, scale = np.sort(top, axis=0)
    near = np.where(smaller > 0, np.minimum(scale, _RANGE * smaller), scale)
    scale = np.where(scale > 0, near, 1)
    top = np.full_like(top, 1e100) if every_row else np.minimum(top, FREE * scale)
    while True:
        stuck = None
        try:
            profile = fastest_profile(limits, grid, curvature, scale, top, narrowing, slowest)
            reach = profile.controllable[1].max(axis=1)
        except StuckError as error:
            stuck, reach = error, error.reach
        if rescalings == 0 or np.all((reach > scale / _RANGE) | (reach == 0)):
            if stuck is None:
                return profile
            if narrowing > _LARGEST_NARROWING / 10:
                raise stuck
            narrowing *= 100
        else:
            rescalings -= 1
            scale = np.where(reach > 0, reach, scale)


def _require_bounded(limits: Sequence[Limit], grid: Grid) -> None:
    """Refuse limits that leave the acceleration along the path unbounded somewhere."""
    z = np.array([0.25, 0.75])
    bounded = np.zeros((2, len(grid.h)), dtype=bool)
    for limit in limits:
        a, _, lower, upper = limit.inequalities(grid, z)
        up, down = np.isfinite(upper), np.isfinite(lower) | limit.norm
        for i, (ahead, back) in enumerate(((up, down), (down, up))):
            bounded[i] |= (np.where(a > 0, ahead, back) & (a != 0)).any(axis=(0, 2))
    if not bounded.all():
        raise ValueError(
            "the limits leave the acceleration along the path unbounded at s = "
            f"{grid.s[~bounded.all(axis=0)][0]:g}: bound that of a joint that moves there, or its "
            "torque, on both sides"
        )
