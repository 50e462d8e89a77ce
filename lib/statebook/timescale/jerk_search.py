"""The fastest motion within limits on joint jerk, by a sequence of quadratic programs.

The gridpoints of each are passed at equal times by the motion that the one before has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from statebook.errors import InfeasiblePathError
from statebook.timescale.grid import Grid, Section
from statebook.timescale.jerk import JerkProfile, rest_shape
from statebook.timescale.jerk_program import Motion, Stretch, Task, improved, infeasible, times_of
from statebook.timescale.limits import DENSE, Limit, TorqueLimit
from statebook.timescale.profile import Profile, audit
from statebook.timescale.rows import MARGIN

_FIRST, _LAST = 50, 1600  # intervals of the coarsest and of the finest grid of a section
_SEARCH = 200  # intervals of the finest grid on which a first motion is looked for
_STEPS = 10  # programs on one grid, at most
_SETTLED = 0.05  # part of the tolerance by which the time still changes at the last one
_STEADY = 0.98  # of the jerk at rest is used to the end of the piece that leaves it
_CANDIDATES = np.geomspace(1.0, 1e-10, 250)
_EXCESS = 1e-5  # part of the limits by which the last one may still exceed them
_BEND = 1e-9  # part of the slope that counts as p'' = 0
_WIDEST = 0.5  # margin of a limit, as part of it
_ROUNDING = 1e-12
_ATTEMPTS = 5  # to get rid of what is left over a limit


def limit_jerk(
    limits: Sequence[Limit], bounds: tuple[np.ndarray, np.ndarray], free: Profile, tolerance: float
) -> tuple[JerkProfile, float]:
    """Find the fastest motion that keeps limits on jerk too.

    Parameters
    ----------
    limits : sequence of Limit
    bounds : (array, array), shape (dof,)
        On the joint jerk, lower and upper.
    free : Profile
        The fastest motion without them.
    tolerance : float > 0
        The grid is refined until that changes the time by less.

    Returns
    -------
    profile : JerkProfile
    least : float
        An estimate of the least time, by refinement.

    Raises
    ------
    InfeasiblePathError
        With the speeds given at the ends no motion was found.
    """
    # A slower motion has less drag to brake with: it must do without.
    drags = [one for one in limits if isinstance(one, TorqueLimit) and one.lines]
    every = [*limits, *(replace(one, lines=None) for one in drags)]
    task = Task(every, *bounds)
    profiles, least = [], 0.0
    for section in free.grid.sections:
        stretch, motion = _started(task, free, section)
        profile, gap = _refined(task, stretch, motion, tolerance)
        profiles.append(profile)
        least += profile.duration * max(1 - gap, 0.0)
    return _joined(profiles, free), least


def _started(task: Task, free: Profile, section: Section) -> tuple[Stretch, Motion]:
    """Return a section with its intervals next to rests, and a first guess of the motion."""
    grid, inside = free.grid, slice(section.first, section.last)
    points = np.append(0.0, np.cumsum(grid.h[inside]))
    piece, first = np.unique(grid.piece[inside], return_index=True)
    knots = np.append(points[:-1][first], points[-1])
    path = replace(grid, piece=piece, offset=np.zeros(len(piece)), h=np.diff(knots), sections=())
    graded = knots[-1] * (1 - np.cos(np.linspace(0, np.pi, 4000))) / 2
    fine = np.unique(np.concatenate([points, graded[1:-1]]))
    x = np.interp(fine, points, np.append(free.x0[inside], free.x1[section.last - 1]))
    ends: list[tuple[int, float | None, float, float]] = []
    for at_end, speed in ((False, section.start), (True, section.end)):
        order = _order(path, at_end) if speed is None else int(speed == 0)
        if order:
            reach, peak = _rest_piece(task, path, at_end, order, knots[-1])
            way = knots[-1] - fine if at_end else fine
            np.minimum(x, peak * (way / reach) ** (2 - 2 * order / 3), out=x)
            ends.append((order, None, reach, peak))
        else:
            ends.append((0, speed, 0.0, np.inf))
    stretch = Stretch(path, knots, *zip(*ends, strict=True))
    return stretch, Motion(fine, x, np.gradient(x, fine) / 2)


def _order(path: Grid, at_end: bool) -> int:
    """Return 2 where p' = 0 and p'' is not at an end of the path, 0 where both are 0."""
    bend = np.abs(path.path(np.array([float(at_end)]), 2)[0, -at_end]) * path.h[-at_end]
    slope = np.abs(path.path(np.linspace(0, 1, 9), 1)[:, -at_end])
    return 2 if bend.max() > _BEND * slope.max() else 0


def _rest_piece(
    task: Task, path: Grid, at_end: bool, order: int, length: float
) -> tuple[float, float]:
    """Choose the length of the piece next to a rest, and the largest s'^2 at its inner end.

    On a straight line it is the whole phase of largest jerk: this ends where the acceleration
    reaches its limit, at half the largest speed, or after a twelfth of the way.
    """
    i = -1 if at_end else 0
    h = min(length / 12, path.h[i]) * _CANDIDATES
    every = np.full(len(h), path.piece[i])
    grid = replace(path, piece=every, offset=(path.h[i] - h) * at_end, h=h)
    shape = rest_shape(grid, np.full(len(h), order), np.full(len(h), at_end))
    peak = np.maximum(shape / task.upper, shape / task.lower).max(axis=(0, 2)) ** (-2 / 3)
    rate = peak**1.5 / h ** (3 - order)
    good = rate >= _STEADY * rate[-1]
    z = np.array([0.0 if at_end else 1.0])
    rise = (-1 if at_end else 1) * (1 - order / 3) * peak / h
    for limit in task.limits:
        use = limit.use(grid, z, rise[None], peak[None]).max(axis=(0, 2))
        good &= use <= (0.5 if limit.squared else 1.0)
    best = int(good.argmax()) if good.any() else len(h) - 1
    return float(h[best]), float(peak[best])


def _refined(
    task: Task, stretch: Stretch, motion: Motion, tolerance: float
) -> tuple[JerkProfile, float]:
    """Solve programs until the time settles, and refine the grid until that does not help.

    Returns the best profile that is within the limits, and its gap: finer grids are of first
    order, so that what the last one gained is what all others would, and half of it for safety.
    """
    best: JerkProfile | None = None
    gap, count = np.inf, max(_FIRST, 3 * len(stretch.path.h))
    first = True
    while True:
        motion = replace(_regridded(stretch, motion, count), excess=np.inf)
        last = np.inf
        for _ in range(_STEPS):
            try:
                motion = improved(task, stretch, motion, everything=first)
            except InfeasiblePathError:  # or rounding, on this grid
                if best is None and count >= _SEARCH and not np.isfinite(motion.excess):
                    raise
                break
            first = False
            duration = float(times_of(stretch, motion).sum())
            change, last = abs(last - duration), duration
            if motion.excess <= _EXCESS and change <= _SETTLED * tolerance * duration:
                break
        if motion.excess <= _EXCESS:
            profile = _certified(task, stretch, motion, tolerance)
            if profile is not None and best is not None:
                change = abs(best.duration / profile.duration - 1)
                gap = min(gap, 1.5 * change + 2 * _SETTLED * tolerance)
            if profile is not None and (best is None or profile.duration < best.duration):
                best = profile
        if gap <= tolerance or count >= (_LAST if best is not None else _SEARCH):
            if best is None:
                raise infeasible(*motion.culprit)
            return best, gap
        count *= 2


def _certified(
    task: Task, stretch: Stretch, motion: Motion, tolerance: float
) -> JerkProfile | None:
    """Return the profile of a motion that exceeds no limit; None if none is found.

    What exceeds a limit between the places where the program asks for it gets a margin there. The
    rest is slowed down if it may be.
    """
    margin = np.zeros(len(motion.r) - 1)
    for attempt in range(_ATTEMPTS):
        profile = _profile(task, stretch, motion)
        uses = audit(profile, task.limits)
        factor = max(use.factor for use in uses)
        slower = profile.slower(factor * (1 + _ROUNDING)) if factor > 1 else profile
        may = not any(stretch.speed) and audit(slower, task.limits).worst.use <= 1 + MARGIN
        if factor <= 1 + (_SETTLED * tolerance if may else MARGIN) or attempt == _ATTEMPTS - 1:
            break
        over = _excess(task, profile)
        margin += 1.2 * np.where(over > 0, over + MARGIN, 0.0)
        if not may and attempt:
            margin += 1.5 * (uses.worst.use - 1)
        try:
            motion = improved(task, stretch, motion, np.minimum(margin, _WIDEST))
        except InfeasiblePathError:
            break
    if may:
        return slower
    return profile if factor <= 1 + MARGIN else None


def _excess(task: Task, profile: JerkProfile) -> np.ndarray:
    """Return the part of the limits by which each interval exceeds one, (N,)."""
    z = np.linspace(0, 1, DENSE)
    u, x = profile.u(z), profile.x(z)
    uses = [limit.use(profile.grid, z, u, x).max(axis=(0, 2)) for limit in task.limits]
    return np.maximum(np.max([*uses, profile.jerk_use(z).max(axis=(0, 2))], axis=0) - 1, 0.0)


def _regridded(stretch: Stretch, motion: Motion, count: int) -> Motion:
    """Return the motion at new gridpoints, the knots of the path among them.

    Most are close where s' changes by a large factor, as the jerk then does while s'^2 is a
    quadratic: their density is sqrt(d/dt log s'), which loses least jerk on the whole. The others
    are passed at equal times, and shared equally by all pieces of the path: a short blend is
    passed in no time, and decides.
    """
    ends = stretch.reach[0], stretch.knots[-1] - stretch.reach[1]
    r = motion.r[(motion.r > ends[0]) & (motion.r < ends[1])]
    r = np.concatenate([[ends[0]], r, [ends[1]]])
    x = motion.at(r)
    speed = np.sqrt(np.maximum(x, 1e-12 * x.max()))
    times = np.append(0.0, np.cumsum(2 * np.diff(r) / (speed[1:] + speed[:-1])))
    knots = stretch.knots[1:-1]
    apart = 1e-6 * (ends[1] - ends[0]) / count
    inner = knots[(knots > ends[0] + apart) & (knots < ends[1] - apart)]
    passed = np.concatenate([[0.0], np.interp(inner, r, times), [times[-1]]])
    clock = times / times[-1] + np.interp(times, passed, np.linspace(0.0, 1.0, len(passed)))
    factors = np.cumsum(np.sqrt(np.abs(np.diff(np.log(speed))) * np.diff(times)))
    clock[1:] += 3 * factors / max(factors[-1], 1e-300)
    even = np.linspace(0.0, clock[-1], count + 1)
    if len(inner):
        nearest = np.abs(np.interp(inner, r, clock)[:, None] - even[1:-1]).min(axis=0)
        even = np.delete(even, 1 + np.flatnonzero(nearest < 0.4 * even[1]))
    nodes = np.unique(np.concatenate([np.interp(even, clock, r), inner]))
    x, u = motion.at(nodes), np.interp(nodes, motion.r, motion.u)
    x = np.maximum(x, 1e-12 * x.max())
    leaves, arrives = (int(order > 0) for order in stretch.order)
    x, u = (np.pad(values, (leaves, arrives)) for values in (x, u))
    first, last = stretch.knots[:leaves], stretch.knots[len(stretch.knots) - arrives :]
    nodes = np.concatenate([first, nodes, last])
    return Motion(nodes, x, u)


def _profile(task: Task, stretch: Stretch, motion: Motion) -> JerkProfile:
    """Return the profile of one section."""
    x = np.maximum(motion.x, 0.0)
    rest = np.zeros(len(x) - 1, dtype=int)
    rest[0], rest[-1] = stretch.order[0], -stretch.order[1]
    bulge = np.where(rest == 0, np.diff(motion.r) * np.diff(motion.u), 0.0)
    grid, sets = stretch.grid(motion.r), np.zeros((2, len(rest), 2))
    curvature = 2 * bulge / (x[:-1] + x[1:])
    return JerkProfile(
        grid, x[:-1], x[1:], np.diff(x), curvature, sets, rest, task.lower, task.upper
    )


def _joined(profiles: list[JerkProfile], free: Profile) -> JerkProfile:
    """Join the profiles of all sections; what is controllable is so without limits on jerk."""
    names = "x0", "x1", "rise", "curvature", "rest"
    parts = {name: np.concatenate([getattr(one, name) for one in profiles]) for name in names}
    cuts = np.cumsum([0, *(len(one.rest) for one in profiles)]).tolist()
    sections = tuple(
        section._replace(first=first, last=last)
        for section, first, last in zip(free.grid.sections, cuts[:-1], cuts[1:], strict=True)
    )
    piece, offset, h = (
        np.concatenate([getattr(one.grid, name) for one in profiles])
        for name in ("piece", "offset", "h")
    )
    grid = Grid(free.grid.pieces, piece, offset, h, sections)
    known, ends = (of.s_at(np.array([0.0, 1.0])).T for of in (free.grid, grid))
    sets = [np.interp(ends, known.ravel(), side.ravel()) for side in free.controllable]
    return replace(profiles[0], **parts, grid=grid, controllable=np.stack(sets))
