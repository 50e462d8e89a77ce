"""Solve, look where time is lost, refine there, solve again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit
from statebook.timescale.profile import Profile
from statebook.timescale.refine import refine
from statebook.timescale.rows import MARGIN
from statebook.timescale.stages import StuckError, fastest_profile

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
) -> Profile:
    """Solve the stages, with a better scale or more room for rounding where it is needed."""
    margin = MARGIN
    while True:
        try:
            profile = fastest_profile(limits, grid, curvature, scale, margin, sketch)
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
