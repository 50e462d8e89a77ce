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
from typing import Any, NamedTuple

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
        self.reach: np.ndarray  # largest s'^2 in the intervals from which the end is reached


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
    floors = slowest or any(limit.kind == "torque" for limit in limits)
    stages = _Stages(_stage_solver(rows), scale.tolist(), rows.step.tolist(), top.tolist())
    sets = np.zeros((2, len(scale), 2))
    x0, x1, rise = x = np.zeros((3, len(scale)))
    for section in grid.sections:
        try:
            found = stages.controllable(section, floors, margin)
            for side, values in zip(sets, found, strict=True):
                side[section.first : section.last] = np.stack([values[:-1], values[1:]], axis=1)
            stages.drive(section, *found, x, slowest)
        except StuckError as stuck:
            stuck.grid, stuck.rows, stuck.reach = grid, rows, sets[1].max(axis=1)
            raise
    return Profile(grid, x0, x1, rise, curvature, sets)


class _Stages(NamedTuple):
    """The programs of all intervals; scale, step and the bounds on s'^2 at the ends of each."""

    solve: Callable[..., Any]
    units: list[float]
    steps: list[float]
    tops: list[list[float]]

    def controllable(
        self, section: Section, floors: bool, margin: float
    ) -> tuple[list[float], list[float]]:
        """Return the lowest and highest s'^2 at each gridpoint that the end allows.

        Loop invariant: from every x in [low[i], high[i]] some w leads into [low[i+1], high[i+1]].
        Without torque limits a slower motion is always allowed: low stays 0.
        """
        last = section.last - 1
        top = section.end
        if top is None:
            w, x = self.solve(last, None, -np.array([self.steps[last], 1.0]), 0.0, _NAN, 0.0, FREE)
            if w != w:
                raise StuckError(last, None, (0.0, FREE))
            top = (x + self.steps[last] * w) * self.units[last] * (1 - margin)
            top = min(top, self.tops[1][last])
        lows, highs = [section.end if floors and section.end else 0.0], [top]
        solve = self.solve
        for i in range(last, section.first - 1, -1):
            unit = self.units[i]
            following = lows[-1] / unit, highs[-1] / unit
            top = solve(i, None, _FASTEST_LEFT, 0.0, _NAN, *following)[1]
            if not top >= 0:
                raise StuckError(i, None, following)
            highs.append(min(top * unit * (1 - margin), self.tops[0][i]))
            low = 0.0
            if floors:
                bottom = solve(i, None, _SLOWEST_LEFT, 0.0, _NAN, *following)[1]
                bottom = bottom if bottom <= top else top  # rounding, where both are the same
                if bottom > _STANDSTILL:
                    low = min(bottom * unit * (1 + margin), highs[-1])
            lows.append(low)
        return lows[::-1], highs[::-1]

    def drive(
        self, section: Section, low: list[float], high: list[float], x: np.ndarray, slowest: bool
    ) -> None:
        """Fill in the fastest motion through a section: from each x the largest next one.

        The slowest is filled in the same way, with the smallest.
        """
        direction = -_FASTEST_RIGHT if slowest else _FASTEST_RIGHT
        speed = (low if slowest else high)[0] if section.start is None else section.start
        too_slow = speed < low[0] * (1 - _SAME)
        if too_slow or speed > high[0] * (1 + _SAME):
            raise self.obstacle(section, speed, too_slow)
        speed = min(max(speed, low[0]), high[0])
        ranges = zip(low[1:], high[1:], strict=True)
        for i, (least, most) in enumerate(ranges, section.first):
            unit = self.units[i]
            here, following = speed / unit, (least / unit, most / unit)
            w = self.solve(i, None, direction, here, here, *following)[0]
            if w != w:
                raise StuckError(i, here, following)
            rise = w * self.steps[i] * unit
            after = min(max(speed + rise, least), most)
            x[:, i] = speed, after, rise if after == speed + rise else after - speed
            speed = after
        if section.end is not None and speed < section.end * (1 - _SAME):
            raise StuckError(i, here, (section.end / unit, section.end / unit))

    def obstacle(self, section: Section, speed: float, too_slow: bool) -> StuckError:
        """Find the place where a start that is too slow or too fast becomes impossible.

        A motion that tries to be fast, or slow, with no regard for what follows gets stuck there.
        """
        direction = _FASTEST_RIGHT if too_slow else -_FASTEST_RIGHT
        for i in range(section.first, section.last):
            unit = self.units[i]
            here, following = speed / unit, (0.0, FREE)
            if i == section.last - 1 and section.end is not None:
                following = (section.end / unit, section.end / unit)
            w = self.solve(i, None, direction, here, here, *following)[0]
            if w != w:
                break
            speed = max(speed + w * self.steps[i] * unit, 0.0)
        return StuckError(i, here, following)
