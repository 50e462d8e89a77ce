"""The fastest profile on a grid: one small linear program per interval, solved by TOPP-RA.

References
----------
H. Pham, Q.-C. Pham, A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis, IEEE Transactions on Robotics 34 (2018).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from statebook.timescale.grid import Grid, Section
from statebook.timescale.limits import Limit
from statebook.timescale.profile import Profile
from statebook.timescale.rows import FREE, Rows, stage_rows

_BLOCK = 24  # rows handed over at a time: toppra multiplies each block by a square matrix
NARROWING = 1e-11  # of the controllable sets, for the solver's rounding
_SAME = 1e-8  # part by which a given s'^2 may be missed: it may be the fastest that can brake
_STANDSTILL = 1e-11  # s'^2, in units of the scale, that is the solver's rounding of 0
_NAN = float("nan")
_FASTEST_LEFT = np.array([1e-9, -1.0])  # toppra minimizes this times (w, x)
_SLOWEST_LEFT = np.array([-1e-9, 1.0])
_FASTEST_RIGHT = np.array([-1.0, 0.0])


class StuckError(Exception):
    """A stage has no solution: an interval, x̂ at its left end if given, the range after it."""

    def __init__(self, interval: int, x: float | None, following: tuple[float, float]) -> None:
        super().__init__(interval, x, following)
        self.interval, self.x, self.following = interval, x, following
        self.grid: Grid
        self.rows: Rows


@cache
def _toppra() -> tuple[Any, Any]:
    """Load toppra's stage program and its interface to constraints."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # SyntaxWarnings of its first compilation
            from toppra.constraint import LinearConstraint
            from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper
    except ImportError as error:
        raise ImportError("time_scale needs the package toppra: pip install toppra") from error

    class Block(LinearConstraint):  # type: ignore[misc]
        """Some columns of the rows, in toppra's form F (a u + b x + c) <= g with F = 1."""

        def __init__(self, w: np.ndarray, x: np.ndarray, c: np.ndarray) -> None:
            super().__init__()
            self.identical = True
            columns = w.shape[1]
            self.parameters = (w, x, c, np.eye(columns), np.zeros(columns), None, None)

        def compute_constraint_params(self, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
            return self.parameters

    return seidelWrapper, Block


def _stage_solver(rows: Rows) -> Callable[..., Any]:
    """Return toppra's function for one stage; its x_next = x + 2 delta w."""
    wrapper, block = _toppra()
    columns = rows.w.shape[1]
    last = np.zeros((1, columns))
    w, x, c = (np.concatenate([m, last]) for m in (rows.w, rows.x, rows.c))
    blocks = [
        block(*(np.ascontiguousarray(m[:, i : i + _BLOCK]) for m in (w, x, c)))
        for i in range(0, columns, _BLOCK)
    ]
    grid = np.append(0.0, np.cumsum(rows.step / 2))
    return wrapper(blocks, None, grid, True).solve_stagewise_optim


def fastest_profile(
    limits: Sequence[Limit],
    grid: Grid,
    curvature: np.ndarray,
    scale: np.ndarray,
    top: np.ndarray,
    margin: float = NARROWING,
    slowest: bool = False,
) -> Profile:
    """Solve all stages: backward the controllable sets, forward the fastest motion in them.

    Or a slow one, that goes to the lowest speed in them at every stage.

    No motion is above top, s'^2 at both ends of the intervals, (2, N). The controllable sets
    are narrowed by a margin for the solver's rounding, so that the forward pass does not get
    stuck.

    Raises
    ------
    StuckError
        No motion satisfies the limits.
    """
    rows = stage_rows(limits, grid, curvature, scale, top)
    solve = _stage_solver(rows)
    floors = slowest or any(limit.kind == "torque" for limit in limits)
    sets = np.zeros((2, len(scale), 2))
    x = np.zeros((2, len(scale)))
    units, steps, tops = scale.tolist(), rows.step.tolist(), top.tolist()
    for section in grid.sections:
        try:
            low, high = _controllable(solve, section, units, steps, tops, floors, margin)
            _drive(solve, section, units, steps, low, high, x, slowest)
        except StuckError as stuck:
            stuck.grid, stuck.rows = grid, rows
            raise
        inside = slice(section.first, section.last)
        sets[0, inside] = np.stack([low[:-1], low[1:]], axis=1)
        sets[1, inside] = np.stack([high[:-1], high[1:]], axis=1)
    return Profile(grid, x[0], x[1], curvature, sets)


def _controllable(
    solve: Callable[..., Any],
    section: Section,
    units: list[float],
    steps: list[float],
    tops: list[list[float]],
    floors: bool,
    margin: float,
) -> tuple[list[float], list[float]]:
    """Return the lowest and highest s'^2 at each gridpoint that the end allows.

    Loop invariant: from every x in [low[i], high[i]] some w leads into [low[i+1], high[i+1]].
    Without torque limits a slower motion is always allowed: low stays 0.
    """
    count = section.last - section.first
    low, high = [0.0] * (count + 1), [0.0] * (count + 1)
    if section.end is None:
        stage = section.last - 1
        w, x = solve(stage, None, -np.array([steps[stage], 1.0]), 0.0, _NAN, 0.0, FREE)
        if w != w:
            raise StuckError(stage, None, (0.0, FREE))
        high[count] = min((x + steps[stage] * w) * units[stage] * (1 - margin), tops[1][stage])
    else:
        high[count] = section.end
        low[count] = section.end if floors else 0.0
    for i in range(count - 1, -1, -1):
        stage = section.first + i
        unit = units[stage]
        following = (low[i + 1] / unit, high[i + 1] / unit)
        top = solve(stage, None, _FASTEST_LEFT, 0.0, _NAN, *following)[1]
        if not top >= 0:
            raise StuckError(stage, None, following)
        high[i] = min(top * unit * (1 - margin), tops[0][stage])
        if floors:
            bottom = solve(stage, None, _SLOWEST_LEFT, 0.0, _NAN, *following)[1]
            if not bottom <= top:  # rounding, where both are the same
                bottom = top
            low[i] = min(bottom * unit * (1 + margin), high[i]) if bottom > _STANDSTILL else 0.0
    return low, high


def _drive(
    solve: Callable[..., Any],
    section: Section,
    units: list[float],
    steps: list[float],
    low: list[float],
    high: list[float],
    x: np.ndarray,
    slowest: bool,
) -> None:
    """Fill in the fastest motion through a section: from each x the largest next one.

    The slowest is filled in the same way, with the smallest.
    """
    direction = -_FASTEST_RIGHT if slowest else _FASTEST_RIGHT
    speed = (low if slowest else high)[0] if section.start is None else section.start
    too_slow = speed < low[0] * (1 - _SAME)
    if too_slow or speed > high[0] * (1 + _SAME):
        raise _obstacle(solve, section, units, steps, speed, too_slow)
    speed = min(max(speed, low[0]), high[0])
    for i in range(section.last - section.first):
        stage = section.first + i
        unit = units[stage]
        here = speed / unit
        w = solve(stage, None, direction, here, here, low[i + 1] / unit, high[i + 1] / unit)[0]
        if w != w:
            raise StuckError(stage, here, (low[i + 1] / unit, high[i + 1] / unit))
        x[0, stage] = speed
        speed = min(max(speed + w * steps[stage] * unit, low[i + 1]), high[i + 1])
        x[1, stage] = speed
    if section.end is not None and speed < section.end * (1 - _SAME):
        stage = section.last - 1
        raise StuckError(stage, x[0, stage] / units[stage], (section.end / units[stage],) * 2)


def _obstacle(
    solve: Callable[..., Any],
    section: Section,
    units: list[float],
    steps: list[float],
    speed: float,
    too_slow: bool,
) -> StuckError:
    """Find the place where a start that is too slow or too fast becomes impossible.

    A motion that tries to be fast, or slow, with no regard for what follows gets stuck there.
    """
    direction = _FASTEST_RIGHT if too_slow else -_FASTEST_RIGHT
    for stage in range(section.first, section.last):
        unit = units[stage]
        here, following = speed / unit, (0.0, FREE)
        if stage == section.last - 1 and section.end is not None:
            following = (section.end / unit, section.end / unit)
        w = solve(stage, None, direction, here, here, *following)[0]
        if w != w:
            break
        speed = max(speed + w * steps[stage] * unit, 0.0)
    return StuckError(stage, here, following)
