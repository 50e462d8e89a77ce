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
    g, b, c = [], [], []
    for limit in limits:
        a1, b1, c1 = (
            None if m is None else m[0] for m in limit.terms(grid, middle, np.ones(len(s)))
        )
        if limit.squared:
            bound = np.broadcast_to(limit.squared_bounds(grid.path(middle, 1)), (1, *b1.shape))[0]
            sides = [(1.0, np.sqrt(bound) ** 2)]
        else:
            shift = 0.0 if c1 is None else c1
            sides = [(1.0, limit.upper - shift), (-1.0, shift - limit.lower)]
        for sign, bound in sides:
            size = np.broadcast_to(limit.scale ** (2 if limit.squared else 1), b1.shape)
            g.append(np.zeros_like(b1) if a1 is None else sign * a1 / size)
            b.append(sign * b1 / size)
            c.append(np.broadcast_to(bound, b1.shape) / size)
    g, b, c = (np.concatenate(m, axis=1) for m in (g, b, c))
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
            np.minimum(highest, np.nan_to_num(bound, nan=np.inf).min(axis=1), out=highest)
    return np.sqrt(np.maximum(highest, 0.0))
