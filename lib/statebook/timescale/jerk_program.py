"""One quadratic program of the sequence that finds the fastest motion within jerk limits.

The unknowns are s'^2 and s'' at gridpoints; `jerk` has the form of the limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from statebook.errors import InfeasiblePathError
from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit, TorqueLimit, blocked

_STEPS = 10  # times that rows are added, at most
_LOOK = (0.0, 0.5, 1.0)  # where in an interval limits are asked for
_IDLE = 0.5  # a limit used less than this by the last motion is left out of the next program
_LOWEST = 0.05  # part of s'^2 of the last motion below which the next one does not go
_PENALTY = 100.0  # of what exceeds the limits, where near the last motion none keeps them
_ITERATIONS = 50  # the motion is within the limits after each; ill-scaled programs go on for ever


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


def _rows(
    task: Task, grid: Grid, x: np.ndarray, u: np.ndarray, z: float, margin: Any, given: Any
) -> Iterator[tuple[Any, ...]]:
    """Yield rows of all limits at a fraction z of each interval, around a motion, and names.

    The rows are square x + left u0 + right u1 <= bound, four (N, R), in s'^2 at the left end and
    s'' at both. At ends whose speed is given this is known to be within its limits.
    """
    known = np.zeros((len(x) - 1, 1), dtype=bool)
    known[0] = given[0] and z == 0
    known[-1] |= given[1] and z == 1
    at, h, margin = np.array([z]), grid.h[:, None], margin[:, None]

    def ends(bend: Any, rate: Any, square: Any, bound: np.ndarray) -> tuple[np.ndarray, ...]:
        left = rate * (1 - z) - bend / h + square * h * (2 * z - z * z)
        return square, left, rate * z + bend / h + square * h * z * z, bound

    for limit in task.limits:
        a, b, lower, upper = (part[0] for part in limit.inequalities(grid, at))
        room = np.broadcast_to(limit.room(grid), (1, *b.shape))[0] + margin
        for side, sign, bound in (("upper", 1, upper), ("lower", -1, -lower)):
            names = [limit.name(row, side) for row in range(b.shape[1])]
            bound = np.where(known & limit.squared, np.inf, bound)
            own = np.isfinite(bound) & (bound > 0) & (not isinstance(limit, TorqueLimit))
            unit = np.where(own, bound, 1.0)  # of two bounds on a row one may be far smaller
            yield *ends(0.0, sign * a / unit, sign * b / unit, bound / unit - room), names
    p1, p2, p3 = (grid.path(at, k)[0] for k in (1, 2, 3))
    last = x[:-1] + grid.h * (2 * z * u[:-1] + z * z * (u[1:] - u[:-1]))
    last = np.maximum(last, np.minimum(x[:-1], x[1:]) / 4)[:, None]
    for side, bound in (("upper", task.upper), ("lower", task.lower)):
        root = np.sqrt(last) / (bound * (1 - margin))
        # root P <= 3/2 - s'^2 / (2 last), the tangent of sqrt(last) / s'
        full = np.where(np.isfinite(root) & (root != 0), 1.5, np.inf)
        names = [f"jerk of joint {row}, {side} limit" for row in range(len(bound))]
        yield *ends(root * p1, 3 * root * p2, root * p3 + 0.5 / last, full), names


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
    steps, inside = times_of(stretch, motion), slice(leaves, len(motion.r) - arrives)
    r, x, u = motion.r[inside], motion.x[inside], motion.u[inside]
    h, duration = np.diff(r), steps.sum()
    unit = 4 * (r[-1] - r[0]) / duration**2
    count = len(r)
    # The unknowns are s'^2 and s'' in units, and what exceeds the limits.
    every = scipy.sparse.eye_array(2 * count + 1, format="csr")
    at_x = scipy.sparse.diags_array(x) @ every[:count]
    at_u, excess = unit * every[count:-1], every[-1:]
    blocks: list[Any] = []
    bounds: list[np.ndarray] = []

    def add(rows: Any, bound: Any, size: Any = 1.0) -> None:
        """Add rows <= bound, both times a size."""
        sizes = np.broadcast_to(size, rows.shape[0])
        blocks.append(scipy.sparse.diags_array(sizes) @ rows)
        bounds.append(bound * sizes)

    length = scipy.sparse.diags_array(h)
    add(at_x[1:] - at_x[:-1] - length @ (at_u[:-1] + at_u[1:]), 0.0, 1 / (h * unit))
    ends = list(zip((0, -1), stretch.order, stretch.speed, stretch.peak, strict=True))
    for end, order, speed, _ in ends:
        at = np.array([end])
        if order:
            link = (-1 if end else 1) * (1 - order / 3) / np.diff(motion.r)[end]
            add(at_u[at] - link * at_x[at], 0.0, 1 / unit)
        elif speed is not None:
            add(at_x[at], speed, 1 / speed)
    equalities = sum(len(bound) for bound in bounds)
    add(-at_x, -_LOWEST * x, 1 / x)
    add(-excess, 0.0)
    between = np.maximum(
        x[:-1] + 0.75 * u[:-1] * h + 0.25 * u[1:] * h, np.minimum(x[:-1], x[1:]) / 4
    )
    middle = at_x[:-1] + length @ (0.75 * at_u[:-1] + 0.25 * at_u[1:])
    add(-middle, -_LOWEST * between, 1 / between)
    for end, order, _, peak in ends:
        if order:
            add(at_x[np.array([end])], peak * (1 - margin[end]), 1 / x[end])
    fixed = sum(len(bound) for bound in bounds)
    grid = stretch.grid(r)
    inner = steps[leaves : len(steps) - arrives]
    inner = np.concatenate([[2 * steps[0] * leaves], inner, [2 * steps[-1] * arrives]])
    weight = (inner[1:] + inner[:-1]) / (2 * duration)
    margin = margin[leaves : len(margin) - arrives]
    given = [speed is not None and speed > 0 for speed in stretch.speed]
    parts = [part for z in _LOOK for part in _rows(task, grid, x, u, z, margin, given)]
    rows = [np.concatenate([part[k] for part in parts], axis=1) for k in range(4)]
    names = [name for part in parts for name in part[4]]
    left_out = np.isfinite(rows[-1])
    part, named = -np.inf if everything else _IDLE, list[tuple[str, float]]()
    for _ in range(_STEPS):
        value = rows[0] * x[:-1, None] + rows[1] * u[:-1, None] + rows[2] * u[1:, None]
        i, row = np.nonzero(left_out & (value > part * rows[3]))
        if part == 1 and not len(i):
            break
        left_out[i, row] = False
        used = zip((at_x, at_u, at_u), (i, i, i + 1), rows, strict=False)
        terms = [scipy.sparse.diags_array(value[i, row]) @ of[at] for of, at, value in used]
        add(sum(terms[1:], terms[0]) - excess[0 * i], rows[3][i, row])
        named += [(names[k], s) for k, s in zip(row, grid.s[i].tolist(), strict=True)]
        # 1/sqrt(y) = 1 - (y - 1)/2 + 3/8 (y - 1)^2 + ...
        solution, dual = _solve(
            np.concatenate([0.75 * weight, np.zeros(len(r) + 1)]),
            np.concatenate([-1.25 * weight, np.zeros(len(r)), [_PENALTY]]),
            scipy.sparse.vstack(blocks, format="csc"),
            np.concatenate(bounds),
            equalities,
        )
        culprit = named[int(np.argmax(np.abs(dual[fixed:])))]
        if np.isnan(solution).any():
            raise infeasible(*culprit)
        x, u, part = at_x @ solution, at_u @ solution, 1.0
    x, u = (np.pad(values, (leaves, arrives)) for values in (x, u))
    return Motion(motion.r, x, u, float(solution[-1]), culprit)


def infeasible(name: str, s: float) -> InfeasiblePathError:
    why = "stands in the way of the speeds given for its ends. Raise that limit, or lower those"
    return blocked(name, s, f"{why} speeds")


def _solve(
    quadratic: np.ndarray, linear: np.ndarray, matrix: Any, bound: np.ndarray, equalities: int
) -> tuple[np.ndarray, np.ndarray]:
    """Minimize q y^2/2 + l y over M y <= b, the first rows being equations.

    These are then fulfilled to rounding, by the smallest change of y.

    Returns
    -------
    solution : array
        NaN where there is none.
    dual : array
        Multipliers of the rows; where there is no solution the certificate of it.
    """
    clarabel = _clarabel()
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.max_iter = _ITERATIONS
    inequalities = matrix.shape[0] - equalities
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(inequalities)]
    hessian = scipy.sparse.diags(quadratic).tocsc()
    result = clarabel.DefaultSolver(hessian, linear, matrix, bound, cones, settings).solve()
    dual = np.array(result.z)
    y = np.array(result.x)
    if "Infeasible" in str(result.status) or not np.isfinite(y).all():
        return np.full_like(y, np.nan), dual
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
