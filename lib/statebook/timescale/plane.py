"""The (s, s') plane: where the limits leave room for a motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from statebook.timescale.grid import Grid
from statebook.timescale.limits import Limit
from statebook.timescale.path import Path


def maximum_speeds(path: Path, limits: Sequence[Limit], s: np.ndarray) -> np.ndarray:
    """Return the largest s' for which some s'' satisfies all limits, shape (N,).

    Each limit is a half-plane g u + b x <= c. Two of them with g of opposite sign leave a u only
    if (b1/g1 + b2/abs(g2)) x <= c1/g1 + c2/abs(g2); the smallest such bound on x counts.
    """
    knots = path.curve.x
    piece = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
    grid = Grid(path.curve.c, knots, piece, s - knots[piece], np.zeros(len(s)), ())
    middle = np.zeros(1)
    gs, bs, cs = [], [], []
    for limit in limits:
        inertial, quadratic, static = limit.terms(grid, middle, np.ones(len(s)))
        slope = quadratic[0]
        if limit.squared:
            size = limit.scale**2
            sides = [(1.0, limit.squared_bounds(grid.path(middle, 1)))]
        else:
            size = limit.scale
            shift = np.zeros_like(slope) if static is None else static[0]
            sides = [(1.0, limit.upper - shift), (-1.0, shift - limit.lower)]
        for sign, bound in sides:
            gs.append(np.zeros_like(slope) if inertial is None else sign * inertial[0] / size)
            bs.append(sign * slope / size)
            cs.append(np.broadcast_to(bound / size, slope.shape))
    g, b, c = (np.concatenate(parts, axis=1) for parts in (gs, bs, cs))
    highest = np.full(len(s), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.abs(g) <= 1e-12 * np.abs(g).max(axis=0)
        direct = np.where(flat & (b > 0), c / b, np.inf)
        np.minimum(highest, direct.min(axis=1), out=highest)
        rise, fall = ~flat & (g > 0), ~flat & (g < 0)
        for k in range(g.shape[1]):
            pairs = rise[:, k, None] & fall
            slope = b[:, k, None] / g[:, k, None] + b / -g
            room = c[:, k, None] / g[:, k, None] + c / -g
            bound = np.where(pairs & (slope > 0), room / slope, np.inf)
            np.minimum(highest, bound.min(axis=1), out=highest)
    return np.sqrt(np.maximum(highest, 0.0))
