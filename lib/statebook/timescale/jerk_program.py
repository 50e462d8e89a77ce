"""The fastest motion within limits on joint jerk, by a sequence of quadratic programs.

The unknowns are s'^2 and s'' at gridpoints that the last motion passes at equal times. See
`jerk` for the form of the limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from statebook.errors import InfeasiblePathError
from statebook.timescale.grid import Grid, Section
from statebook.timescale.jerk import JerkProfile, rest_shape
from statebook.timescale.limits import DENSE, Limit, TorqueLimit, polygon
from statebook.timescale.profile import Profile, audit
from statebook.timescale.rows import MARGIN

_FIRST, _LAST = 50, 1600  # intervals of the coarsest and of the finest grid of a section
_SEARCH = 200  # intervals of the finest grid on which a first motion is looked for
_STEPS = 10  # programs on one grid, at most
_SETTLED = 0.05  # part of the tolerance by which the time still changes at the last one
_LOOK = (0.0, 0.5, 1.0)  # where in an interval limits are asked for
_IDLE = 0.5  # a limit used less than this by the last motion is left out of the next program
_LOWEST = 0.05  # part of s'^2 of the last motion below which the next one does not go
_STEADY = 0.98  # of the jerk at rest is used to the end of the piece that leaves it
_CANDIDATES = np.geomspace(1.0, 1e-10, 250)
_PENALTY = 100.0  # of what exceeds the limits, where near the last motion none keeps them
_EXCESS = 1e-5  # part of the limits by which the last one may still exceed them
_BEND = 1e-9  # part of the slope that counts as p'' = 0
_WIDEST = 0.5  # margin of a limit, as part of it
_ROUNDING = 1e-12
_ATTEMPTS = 5  # to get rid of what is left over a limit between the places of _LOOK


class _Task(NamedTuple):
    """All limits: those on s'' and s'^2, and the bounds on joint jerk."""

    limits: Sequence[Limit]
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A section of the path: both its ends at rest of an order, or at a given speed (order 0)."""

    path: Grid  # one interval per piece of the path
    knots: np.ndarray  # their ends, r from the start of the section
    order: tuple[int, int]
    speed: tuple[float | None, float | None]  # s'^2 where the order is 0; None leaves it free
    reach: tuple[float, float]  # length of the intervals next to the rests
    peak: tuple[float, float]  # largest s'^2 at their inner ends

    def grid(self, r: np.ndarray) -> Grid:
        """Return the grid with gridpoints r."""
        piece = np.searchsorted(self.knots, (r[1:] + r[:-1]) / 2) - 1
        return replace(
            self.path, piece=self.path.piece[piece], offset=r[:-1] - self.knots[piece], h=np.diff(r)
        )


@dataclass(frozen=True, eq=False)
class _Motion:
    """The squared speed x and the rate u = x'/2 at gridpoints r of a stretch."""

    r: np.ndarray
    x: np.ndarray
    u: np.ndarray
    excess: float = 0.0  # over the limits, as part of them
    culprit: tuple[str, float] = ("", 0.0)  # the limit that costs most, and where

    def at(self, r: np.ndarray) -> np.ndarray:
        """Return x at r, where it is a quadratic."""
        i = np.clip(np.searchsorted(self.r, r, side="right") - 1, 0, len(self.r) - 2)
        h = np.diff(self.r)[i]
        z = (r - self.r[i]) / h
        bend = (self.u[i + 1] - self.u[i]) * z**2
        return np.asarray(self.x[i] + h * (2 * z * self.u[i] + bend))


def limit_jerk(
    limits: Sequence[Limit],
    bounds: tuple[np.ndarray, np.ndarray],
    free: Profile,
    tolerance: float,
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
    task = _Task(every, *bounds)
    profiles, least = [], 0.0
    for section in free.grid.sections:
        stretch, motion = _started(task, free, section)
        profile, gap = _refined(task, stretch, motion, tolerance)
        profiles.append(profile)
        least += profile.duration * max(1 - gap, 0.0)
    return _joined(profiles, free), least


def _started(task: _Task, free: Profile, section: Section) -> tuple[_Stretch, _Motion]:
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
    stretch = _Stretch(path, knots, *zip(*ends, strict=True))
    return stretch, _Motion(fine, x, np.gradient(x, fine) / 2)


def _order(path: Grid, at_end: bool) -> int:
    """Return 2 where p' = 0 and p'' is not at an end of the path, 0 where both are 0."""
    bend = np.abs(path.path(np.array([float(at_end)]), 2)[0, -at_end]) * path.h[-at_end]
    slope = np.abs(path.path(np.linspace(0, 1, 9), 1)[:, -at_end])
    return 2 if bend.max() > _BEND * slope.max() else 0


def _rest_piece(
    task: _Task,
    path: Grid,
    at_end: bool,
    order: int,
    length: float,
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
    task: _Task, stretch: _Stretch, motion: _Motion, tolerance: float
) -> tuple[JerkProfile, float]:
    """Solve programs until the time settles, and refine the grid until that does not help.

    Returns the best profile that is within the limits, and its gap: finer grids are of first
    order, so that what the last one gained is what all others would, and half of it for safety.
    """
    best: JerkProfile | None = None
    gap, count = np.inf, max(_FIRST, 3 * len(stretch.path.h))
    first = True
    while True:
        motion = _regridded(stretch, motion, count)
        last = np.inf
        for _ in range(_STEPS):
            motion = _improved(task, stretch, motion, everything=first)
            first = False
            duration = _times(stretch, motion).sum()
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
                raise _infeasible(*motion.culprit)
            return best, gap
        count *= 2


def _certified(
    task: _Task, stretch: _Stretch, motion: _Motion, tolerance: float
) -> JerkProfile | None:
    """Return the profile of a motion that exceeds no limit; None if none is found.

    What exceeds a limit between the places of _LOOK gets a margin there. The rest is slowed down
    if it may be.
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
            motion = _improved(task, stretch, motion, np.minimum(margin, _WIDEST))
        except InfeasiblePathError:
            break
    if may:
        return slower
    return profile if factor <= 1 + MARGIN else None


def _excess(task: _Task, profile: JerkProfile) -> np.ndarray:
    """Return the part of the limits by which each interval exceeds one, (N,)."""
    z = np.linspace(0, 1, DENSE)
    u, x = profile.u(z), profile.x(z)
    uses = [limit.use(profile.grid, z, u, x).max(axis=(0, 2)) for limit in task.limits]
    return np.maximum(np.max([*uses, profile.jerk_use(z).max(axis=(0, 2))], axis=0) - 1, 0.0)


def _times(stretch: _Stretch, motion: _Motion) -> np.ndarray:
    """Return the time of each interval."""
    h, speed = np.diff(motion.r), np.sqrt(np.maximum(motion.x, 0.0))
    steps = 2 * h / (speed[1:] + speed[:-1])
    for i, j, order in ((0, 1, stretch.order[0]), (-1, -2, stretch.order[1])):
        if order:
            steps[i] = 3 * h[i] / (order * speed[j])
    return np.asarray(steps)


def _regridded(stretch: _Stretch, motion: _Motion, count: int) -> _Motion:
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
    nodes = np.interp(even, clock, r)
    nodes[0], nodes[-1] = ends
    nodes = np.unique(np.concatenate([nodes, inner]))
    x, u = motion.at(nodes), np.interp(nodes, motion.r, motion.u)
    x = np.maximum(x, 1e-12 * x.max())
    for at_end, order in enumerate(stretch.order):
        if order:
            nodes, x, u = (
                np.insert(values, len(values) if at_end else 0, end)
                for values, end in ((nodes, stretch.knots[-at_end]), (x, 0.0), (u, 0.0))
            )
    return _Motion(nodes, x, u)


class _Rows(NamedTuple):
    """Rows bend x''/2 + u s'' + x s'^2 <= bound of a limit at a fraction z, arrays (N, R)."""

    z: float
    bend: np.ndarray | float
    u: np.ndarray
    x: np.ndarray
    bound: np.ndarray
    limit: Limit | None
    side: str

    def name(self, row: int) -> str:
        """Name the limit of a row for a message."""
        if self.limit is not None:
            return self.limit.name(row, self.side)
        return f"jerk of joint {row}, {self.side} limit"


def _rows(
    task: _Task, grid: Grid, x: np.ndarray, u: np.ndarray, z: float, margin: np.ndarray
) -> Iterator[_Rows]:
    """Yield the rows of all limits at a fraction z of each interval, around a motion."""
    at, margin = np.array([z]), margin[:, None]
    for limit in task.limits:
        a, b, c = limit.terms(grid, at, np.maximum(x[:-1], x[1:]))
        if limit.squared:
            bound = np.broadcast_to(limit.squared_bounds(grid, at), b.shape)[0]
            room = np.broadcast_to(1 - margin - limit.margin, bound.shape)
            yield _Rows(z, 0.0, np.zeros_like(b[0]), b[0] / bound, room, limit, "upper")
            continue
        lower, upper = limit.bounds(grid, at)
        assert a is not None
        if limit.norm:
            a, b = polygon(a, b)
            lower = np.full_like(upper, -np.inf)
        c = np.zeros_like(b) if c is None else c
        for side, sign, bound in (("upper", 1, upper), ("lower", -1, lower)):
            room = np.broadcast_to(sign * (bound - c) / limit.scale - limit.room(grid), b.shape)[0]
            factor = sign / limit.scale
            yield _Rows(z, 0.0, factor * a[0], factor * b[0], room - margin, limit, side)
    p1, p2, p3 = (grid.path(at, k)[0] for k in (1, 2, 3))
    last = x[:-1] + grid.h * (2 * z * u[:-1] + z * z * (u[1:] - u[:-1]))
    last = np.maximum(last, np.minimum(x[:-1], x[1:]) / 4)[:, None]
    for side, bound in (("upper", task.upper), ("lower", task.lower)):
        root = np.sqrt(last) / (bound * (1 - margin))
        # root P <= 3/2 - s'^2 / (2 last), the tangent of sqrt(last) / s'
        full = np.where(np.isfinite(root) & (root != 0), 1.5, np.inf)
        yield _Rows(z, root * p1, 3 * root * p2, root * p3 + 0.5 / last, full, None, side)


@dataclass
class _Program:
    """Rows of a program in s'^2 and s'' at gridpoints, in units of x and u."""

    x: np.ndarray
    u: float
    entries: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    bounds: list[np.ndarray] = field(default_factory=list)
    names: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    rows: int = 0

    def add(
        self, x: Any, u: Any, bound: Any, name: Any = "", s: Any = None, soft: bool = False
    ) -> None:
        """Add rows: x and u are lists of pairs of gridpoints and coefficients there.

        Soft ones are relaxed by the last unknown.
        """
        bound = np.atleast_1d(np.asarray(bound, dtype=float))
        index = self.rows + np.arange(len(bound))
        for point, value in x:
            self.entries.append((index, point, value * self.x[point]))
        for point, value in u:
            self.entries.append((index, point + len(self.x), value * np.full(len(bound), self.u)))
        if soft:
            self.entries.append((index, np.array(2 * len(self.x)), np.array(-1.0)))
        self.rows += len(bound)
        self.bounds.append(bound)
        self.names.append(
            (
                np.broadcast_to(name, bound.shape),
                np.broadcast_to(np.nan if s is None else s, bound.shape),
            )
        )

    def add_used(
        self,
        rows: _Rows,
        left_out: np.ndarray,
        grid: Grid,
        x: np.ndarray,
        u: np.ndarray,
        part: float,
    ) -> None:
        """Move rows of which a motion uses more than a part from those left out to the program."""
        h, z = grid.h[:, None], rows.z
        at_left = rows.u * (1 - z) - rows.bend / h + rows.x * h * (2 * z - z * z)
        at_right = rows.u * z + rows.bend / h + rows.x * h * z * z
        value = rows.x * x[:-1, None] + at_left * u[:-1, None] + at_right * u[1:, None]
        i, row = np.nonzero(left_out & (value > part * rows.bound))
        left_out[i, row] = False
        names = np.array([rows.name(k) for k in range(value.shape[1])])
        self.add(
            [(i, rows.x[i, row])],
            [(i, at_left[i, row]), (i + 1, at_right[i, row])],
            rows.bound[i, row],
            names[row],
            grid.s[i],
            soft=True,
        )

    def culprit(self, dual: np.ndarray) -> tuple[str, float]:
        """Return the name and the place of the limit with the largest multiplier."""
        names, s = (np.concatenate(values) for values in zip(*self.names, strict=True))
        worst = int(np.where(names != "", np.abs(dual), 0.0).argmax())
        return str(names[worst]), float(s[worst])

    def matrix(self) -> Any:
        """Return all rows as a sparse matrix."""
        row, column, value = (
            np.concatenate([np.broadcast_to(entry[k], entry[0].shape) for entry in self.entries])
            for k in range(3)
        )
        shape = (self.rows, 2 * len(self.x) + 1)
        return scipy.sparse.csc_matrix((value, (row, column)), shape=shape)


def _improved(
    task: _Task,
    stretch: _Stretch,
    motion: _Motion,
    margin: np.ndarray | None = None,
    everything: bool = False,
) -> _Motion:
    """Solve one program around a motion, with a margin left of each limit in each interval."""
    margin = np.zeros(len(motion.r) - 1) if margin is None else margin
    leaves, arrives = (int(order > 0) for order in stretch.order)
    steps = _times(stretch, motion)
    r = motion.r[leaves : len(motion.r) - arrives]
    x, u = (values[leaves : len(values) - arrives] for values in (motion.x, motion.u))
    h, points = np.diff(r), np.arange(len(r))
    duration = steps.sum()
    program = _Program(x, 4 * (r[-1] - r[0]) / duration**2)
    left, right = points[:-1], points[1:]
    size = 1 / (h * program.u)
    program.add([(right, size), (left, -size)], [(left, -size * h), (right, -size * h)], 0 * size)
    for end, order in enumerate(stretch.order):
        at, speed = np.array([-end % len(r)]), stretch.speed[end]
        if order:
            link = (-1 if end else 1) * (1 - order / 3) / np.diff(motion.r)[-end]
            program.add([(at, -link / program.u)], [(at, 1 / program.u)], 0.0)
        elif speed is not None:
            program.add([(at, 1 / speed)], [], 1.0)
    equalities = program.rows
    program.add([(points, -1 / program.x)], [], np.full(len(r), -_LOWEST))
    program.add([], [], 0.0, soft=True)
    between = np.maximum(
        x[:-1] + 0.75 * u[:-1] * h + 0.25 * u[1:] * h, np.minimum(x[:-1], x[1:]) / 4
    )
    program.add(
        [(left, -1 / between)],
        [(left, -0.75 * h / between), (right, -0.25 * h / between)],
        np.full(len(h), -_LOWEST),
    )
    for end, order in enumerate(stretch.order):
        if order:
            at = np.array([-end % len(r)])
            top = stretch.peak[end] * (1 - margin[-end])
            program.add([(at, 1 / program.x[at])], [], top / program.x[at])
    grid = stretch.grid(r)
    weight = np.zeros(len(r))
    inner = steps[leaves : len(steps) - arrives]
    weight[:-1] += inner / 2
    weight[1:] += inner / 2
    weight[0] += steps[0] * leaves
    weight[-1] += steps[-1] * arrives
    weight /= duration
    inside = margin[leaves : len(margin) - arrives]
    groups = [rows for z in _LOOK for rows in _rows(task, grid, x, u, z, inside)]
    left_out = [np.isfinite(rows.bound) for rows in groups]
    part = -np.inf if everything else _IDLE
    solution = None
    for _ in range(_STEPS):
        before = program.rows
        for rows, mask in zip(groups, left_out, strict=True):
            program.add_used(rows, mask, grid, x, u, part)
        if part == 1 and program.rows == before:
            break
        # 1/sqrt(y) = 1 - (y - 1)/2 + 3/8 (y - 1)^2 + ...
        solution, dual = _solve(
            np.concatenate([0.75 * weight, np.zeros(len(r) + 1)]),
            np.concatenate([-1.25 * weight, np.zeros(len(r)), [_PENALTY]]),
            program.matrix(),
            np.concatenate(program.bounds),
            equalities,
        )
        culprit = program.culprit(dual)
        if solution is None:
            raise _infeasible(*culprit)
        x, u = solution[: len(r)] * program.x, solution[len(r) : -1] * program.u
        part = 1.0
    assert solution is not None
    ends = np.zeros(leaves), np.zeros(arrives)
    x, u = (np.concatenate([ends[0], values, ends[1]]) for values in (x, u))
    return _Motion(motion.r, x, u, float(solution[-1]), culprit)


def _infeasible(name: str, s: float) -> InfeasiblePathError:
    return InfeasiblePathError(
        f"the path cannot be driven within the limits: at s = {s:.6g} the {name} stands in the way "
        "of the speeds given for its ends. Raise that limit, or lower those speeds",
        constraint=name,
        s=s,
    )


def _solve(
    quadratic: np.ndarray,
    linear: np.ndarray,
    matrix: Any,
    bound: np.ndarray,
    equalities: int,
) -> tuple[np.ndarray | None, np.ndarray]:
    """Minimize q y^2/2 + l y over M y <= b, the first rows being equations.

    These are then fulfilled to rounding, by the smallest change of y.

    Returns
    -------
    solution : array or None
        None where there is none.
    dual : array
        Multipliers of the rows; where there is no solution the certificate of it.
    """
    clarabel = _clarabel()
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    cones = [
        clarabel.ZeroConeT(equalities),
        clarabel.NonnegativeConeT(matrix.shape[0] - equalities),
    ]
    hessian = scipy.sparse.diags(quadratic).tocsc()
    result = clarabel.DefaultSolver(hessian, linear, matrix, bound, cones, settings).solve()
    dual = np.array(result.z)
    if str(result.status) not in ("Solved", "AlmostSolved", "InsufficientProgress"):
        return None, dual
    y = np.array(result.x)
    equations = matrix[:equalities]
    normal = scipy.sparse.linalg.splu((equations @ equations.T).tocsc())
    for _ in range(2):
        y += equations.T @ normal.solve(bound[:equalities] - equations @ y)
    return y, dual


@cache
def _clarabel() -> Any:
    """Load the solver of quadratic programs."""
    try:
        import clarabel
    except ImportError as error:
        raise ImportError(
            "a jerk limit needs the package clarabel: pip install clarabel"
        ) from error
    return clarabel


def _profile(task: _Task, stretch: _Stretch, motion: _Motion) -> JerkProfile:
    """Return the profile of one section."""
    x = np.maximum(motion.x, 0.0)
    rest = np.zeros(len(x) - 1, dtype=int)
    rest[0], rest[-1] = stretch.order[0], -stretch.order[1]
    bulge = np.where(rest == 0, np.diff(motion.r) * np.diff(motion.u), 0.0)
    return JerkProfile(
        stretch.grid(motion.r),
        x[:-1],
        x[1:],
        2 * bulge / (x[:-1] + x[1:]),
        np.zeros((2, len(rest), 2)),
        rest=rest,
        lower=task.lower,
        upper=task.upper,
    )


def _joined(profiles: list[JerkProfile], free: Profile) -> JerkProfile:
    """Join the profiles of all sections; what is controllable is so without limits on jerk."""
    sections, sets, first = [], [], 0
    for section, profile in zip(free.grid.sections, profiles, strict=True):
        last = first + len(profile.rest)
        sections.append(section._replace(first=first, last=last))
        inside = slice(section.first, section.last)
        points, before = (
            np.append(0.0, np.cumsum(h)) for h in (profile.grid.h, free.grid.h[inside])
        )
        known = free.controllable[:, inside]
        sides = np.concatenate([known[:, :, 0], known[:, -1:, 1]], axis=1)
        at = np.stack([np.interp(points, before, side) for side in sides])
        sets.append(np.stack([at[:, :-1], at[:, 1:]], axis=2))
        first = last
    together = {
        name: np.concatenate([getattr(profile, name) for profile in profiles])
        for name in ("x0", "x1", "curvature", "rest")
    }
    piece, offset, h = (
        np.concatenate([getattr(profile.grid, name) for profile in profiles])
        for name in ("piece", "offset", "h")
    )
    return replace(
        profiles[0],
        **together,
        grid=Grid(free.grid.pieces, piece, offset, h, tuple(sections)),
        controllable=np.concatenate(sets, axis=1),
    )
