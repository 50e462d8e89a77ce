"""Polylines with rounded corners: straight pieces and quartic blends between them."""

from __future__ import annotations

import numpy as np
import scipy

_STRAIGHT = 1e-10  # a turn by less is none
_REVERSAL = 1e-6  # a turn that misses half a turn by less reverses: the motion must stop there
_HEIGHT = 3 / 16  # of the smoothed ramp where the ramp has its kink
_BLEND = np.array([-1 / 16, 1 / 4, 0, 0])  # w^4, w^3, w^2, w^1 of the ramp on 0 <= w <= 2


def blended_polyline(points: np.ndarray, tolerance: float) -> scipy.interpolate.PPoly:
    """Round the corners of a polyline with continuous curvature.

    With unit directions e0, e1 before and after a corner P, and w from 0 to 2, the blend is

        p = P + l ((w - 1) e0 + r(w) (e1 - e0)),  r'' = 3/4 w (2 - w),  r(0) = r'(0) = 0,

    so that r(2) = r'(2) = 1: p, p' and p'' join the straight pieces. Before the middle, w <= 1,
    it keeps a distance of at most l r(w) abs(e1 - e0) from the first straight piece, after it by
    symmetry from the second, and r(1) = 3/16 is the largest. That is also the distance of the
    corner from the middle of the blend. Hence l = 16 tolerance / (3 abs(e1 - e0)), or less where
    straight pieces are too short for two blends.

    Parameters
    ----------
    points : array, shape (dof, N)
        Waypoints. A corner that turns back by half a turn stays, the motion stops there.
    tolerance : float > 0
        Largest Euclidean distance between polyline and curve.

    Returns
    -------
    scipy.interpolate.PPoly
        On [0, 1]; s is the part of the polyline's length.
    """
    steps = np.diff(points.T, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moving = lengths > 1e-13 * max(np.abs(points).max(), 1e-300)
    if not moving.any():
        raise ValueError("waypoints must differ from each other for a blend: the path is a point")
    corners = np.concatenate([points.T[:1], points.T[1:][moving]])
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    unit = steps / lengths[:, None]
    turn = np.linalg.norm(np.diff(unit, axis=0), axis=1)
    rounded = (turn > _STRAIGHT) & (turn < 2 - _REVERSAL**2 / 4)
    wanted = np.zeros(len(lengths) + 1)
    wanted[1:-1][rounded] = tolerance / (_HEIGHT * turn[rounded])
    before, after = wanted[:-1], wanted[1:]
    room = np.inf * np.ones(len(wanted))
    room[:-1] = np.maximum(lengths / 2, lengths - after)
    room[1:] = np.minimum(room[1:], np.maximum(lengths / 2, lengths - before))
    half = np.minimum(wanted, room)

    coefficients, widths = [], []
    for i, length in enumerate(lengths):
        straight = length - half[i] - half[i + 1]
        if straight > 1e-12 * length:
            piece = np.zeros((5, points.shape[0]))
            piece[3], piece[4] = unit[i], corners[i] + half[i] * unit[i]
            coefficients.append(piece)
            widths.append(straight)
        if (size := half[i + 1]) > 0:
            piece = np.zeros((5, points.shape[0]))
            piece[:4] = np.multiply.outer(_BLEND, unit[i + 1] - unit[i])
            piece[:4] *= (size / size ** np.arange(4, 0, -1))[:, None]
            piece[3] += unit[i]
            piece[4] = corners[i + 1] - size * unit[i]
            coefficients.append(piece)
            widths.append(2 * size)
    total = sum(widths)
    knots = np.concatenate([[0.0], np.cumsum(widths) / total])
    knots[-1] = 1.0
    scale = total ** np.arange(4, -1, -1)
    return scipy.interpolate.PPoly(np.stack(coefficients, axis=1) * scale[:, None, None], knots)
