"""One quadratic program of the sequence that finds the fastest motion within jerk limits.

The unknowns are s'^2 and s'' at gridpoints; `jerk` has the form of the limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from statebook.errors import InfeasiblePathError
from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit

_STEPS = 10  # times that rows are added, at most
_LOOK = (0.0, 0.5, 1.0)  # where in an interval limits are asked for
_IDLE = 0.5  # a limit used less than this by the last motion is left out of the next program
_LOWEST = 0.05  # part of s'^2 of the last motion below which the next one does not go
_PENALTY = 100.0  # of what exceeds the limits, where near the last motion none keeps them


class Task(NamedTuple):
    """All limits: those on s'' and s'^2, and the bounds on joint jerk."""

    limits: Sequence[Limit]
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True, eq=False)
class Stretch:
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
class Motion:
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


def times_of(stretch: Stretch, motion: Motion) -> np.ndarray:
    """Return the time of each interval."""
    h, speed = np.diff(motion.r), np.sqrt(np.maximum(motion.x, 0.0))
    steps = 2 * h / (speed[1:] + speed[:-1])
    for i, j, order in ((0, 1, stretch.order[0]), (-1, -2, stretch.order[1])):
        if order:
            steps[i] = 3 * h[i] / (order * speed[j])
    return np.asarray(steps)


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
    task: Task, grid: Grid, x: np.ndarray, u: np.ndarray, z: float, margin: np.ndarray
) -> Iterator[_Rows]:
    """Yield the rows of all limits at a fraction z of each interval, around a motion."""
    at, margin = np.array([z]), margin[:, None]
    for limit in task.limits:
        a, b, lower, upper = (part[0] for part in limit.inequalities(grid, at))
        room = np.broadcast_to(limit.room(grid), (1, *b.shape))[0] + margin
        yield _Rows(z, 0.0, a, b, upper - room, limit, "upper")
        yield _Rows(z, 0.0, -a, -b, -lower - room, limit, "lower")
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
        self, x: Any, u: Any, bound: Any, name: Any = "", s: Any = np.nan, soft: bool = False
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
        self.names.append((np.broadcast_to(name, bound.shape), np.broadcast_to(s, bound.shape)))

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


def improved(
    task: Task,
    stretch: Stretch,
    motion: Motion,
    margin: np.ndarray | None = None,
    everything: bool = False,
) -> Motion:
    """Solve one program around a motion, with a margin left of each limit in each interval."""
    margin = np.zeros(len(motion.r) - 1) if margin is None else margin
    leaves, arrives = (int(order > 0) for order in stretch.order)
    steps = times_of(stretch, motion)
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
            raise infeasible(*culprit)
        x, u = solution[: len(r)] * program.x, solution[len(r) : -1] * program.u
        part = 1.0
    assert solution is not None
    ends = np.zeros(leaves), np.zeros(arrives)
    x, u = (np.concatenate([ends[0], values, ends[1]]) for values in (x, u))
    return Motion(motion.r, x, u, float(solution[-1]), culprit)


def infeasible(name: str, s: float) -> InfeasiblePathError:
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
    y = np.array(result.x)
    if "Infeasible" in str(result.status) or not np.isfinite(y).all():
        return None, dual
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
