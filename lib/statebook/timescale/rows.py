"""The linear inequalities of each interval of a grid.

In an interval the unknowns are x = s'^2 at its left end and w, its increase to the right end,
both divided by a scale. Values of a limit along the interval are polynomials whose Bernstein
coefficients are affine in (w, x); as the polynomial lies between them, the inequalities for the
coefficients make the limit hold everywhere, not at the gridpoints alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from statebook.timescale import bernstein
from statebook.timescale.grid import Grid
from statebook.timescale.limits import SIDES, Limit, polygon

MARGIN = 1e-9  # of every limit, left to rounding
FREE = 1e6  # bound on s'^2, in units of the scale, where nothing else binds it
_LEAST = 1e-14  # part of the largest bound in an interval that is the unit of the least


_BLOCK = 1000  # intervals at a time


@dataclass(frozen=True, eq=False)
class Rows:
    """Inequalities w ŵ + x x̂ + c <= 0 of each interval, (N, M); labels[which] name them.

    x̂ is s'^2 at the left end in units of the scale, x̂ + step ŵ at the right end.
    """

    step: np.ndarray
    w: np.ndarray
    x: np.ndarray
    c: np.ndarray
    which: np.ndarray
    labels: tuple[tuple[Limit, int, str], ...]


def stage_rows(
    limits: Sequence[Limit], grid: Grid, curvature: np.ndarray, scale: np.ndarray, top: np.ndarray
) -> Rows:
    """Return the inequalities of all intervals, each of unit gradient.

    Those that hold for every s'^2 below top, (2, N) at the ends of the intervals, are left out;
    for want of another in their place they say 0 <= 1.
    """
    parts = []
    for first in range(0, len(grid.h), _BLOCK):
        block = slice(first, first + _BLOCK)
        args = curvature[block], scale[block], top[:, block] / scale[block]
        part, labels = _block_rows(limits, grid.part(block), *args)
        parts.append(part)
    width = max(part[0].shape[1] for part in parts)
    w, x, c, idle, which = (
        np.concatenate(
            [np.pad(m, [(0, 0), (0, width - m.shape[1])], constant_values=none) for m in blocks]
        )
        for blocks, none in zip(zip(*parts, strict=True), (0, 0, -1, True, 0), strict=True)
    )
    # Balance both unknowns, by powers of two, for the solver adds steps up and takes differences
    # again; and scale rows to unit gradient, as its tolerance needs.
    c = np.maximum(c, -1e100)  # an infinite bound
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(idle | (w == 0), np.inf, (np.abs(x) + np.abs(c)) / np.abs(w)).min(axis=1)
        step = np.exp2(np.clip(np.round(np.log2(reach)), -20, 0))
    w *= step[:, None]
    size = np.hypot(w, x)
    factor = np.where(idle, 0.0, 1 / np.where(idle | (size == 0), 1.0, size))
    return Rows(step, w * factor, x * factor, np.where(idle, -1.0, c * factor), which, labels)


def _block_rows(
    limits: Sequence[Limit], grid: Grid, curvature: np.ndarray, scale: np.ndarray, top: np.ndarray
) -> tuple[tuple[np.ndarray, ...], tuple[tuple[Limit, int, str], ...]]:
    """Return w, x, c, whether they are idle and which they are, (N, M), and all labels."""
    ws, xs, cs, labels = [], [], [], []
    for limit in limits:
        degree = limit.degree(grid)
        z = bernstein.nodes(degree)
        transform = partial(_transformed, bernstein.from_values(degree))
        a, b, c = limit.terms(grid, z)
        fraction = z[:, None]
        rho = curvature / 2
        # x(z) = scale (x x̂ + w ŵ) and s'' = scale (dx x̂ + dw ŵ)/(2 h), coefficients by z:
        w = b * (scale * (fraction - rho * fraction * (1 - fraction)))[:, :, None]
        x = b * (scale * (1 - 2 * rho * fraction * (1 - fraction)))[:, :, None]
        rate = scale / (2 * grid.h)
        w += a * (rate * (1 - rho * (1 - 2 * fraction)))[:, :, None]
        x += a * (rate * (-2 * rho * (1 - 2 * fraction)))[:, :, None]
        w, x = transform(w), transform(x)
        labelled = list(range(w.shape[2]))
        if limit.squared:
            bounds = [("upper", 1.0, limit.squared_bounds(grid, z, transform))]
        else:
            lower, upper = map(transform, limit.bounds(grid, z))
            bounds = [("upper", 1.0, upper), ("lower", -1.0, lower)]
        if limit.norm:
            w, x = polygon(w, x)
            bounds = [("upper", 1.0, upper * np.cos(np.pi / (2 * SIDES)))]
            labelled = [0] * SIDES
        room = limit.room(grid)
        for side, sign, bound in bounds:
            size = limit.scale
            if np.ndim(c) == 0:  # each inequality's own: a bound may fall steeply in an interval
                size = np.abs(bound)
                size = np.maximum(size, _LEAST * size.max(axis=0)) if bound.ndim == 3 else size
            with np.errstate(invalid="ignore"):
                constant = sign * (transform(c) - bound) / size
            constant = np.where(np.isnan(constant), -1.0, constant) + room
            ws.append(_by_interval(w * (sign / size)))
            xs.append(_by_interval(x * (sign / size)))
            cs.append(_by_interval(np.broadcast_to(constant, w.shape)))
            labels += [(limit, row, side) for _ in range(len(w)) for row in labelled]
    w, x, c = np.concatenate(ws, 1), np.concatenate(xs, 1), np.concatenate(cs, 1) + MARGIN
    left, right = top[:, :, None]
    idle = np.maximum(x - w, 0) * left + np.maximum(w, 0) * right <= -c
    count = int((~idle).sum(axis=1).max(initial=1))
    which = np.argsort(idle, axis=1, kind="stable")[:, :count]
    w, x, c, idle = (np.take_along_axis(m, which, 1) for m in (w, x, c, idle))
    return (w, x, c, idle, which), tuple(labels)


def _transformed(matrix: np.ndarray, values: Any) -> Any:
    """Return Bernstein coefficients of values (K, N, R); what is constant stays as it is."""
    return bernstein.along(matrix, values) if np.ndim(values) == 3 else values


def _by_interval(values: np.ndarray) -> np.ndarray:
    """Turn (K, N, R) into (N, K R)."""
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)
