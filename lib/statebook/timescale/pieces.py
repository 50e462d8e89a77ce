"""The curve as the stages see it: pieces of low degree, joined smoothly where it can be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from statebook.timescale.path import Path, horner

_DEGREE = 7  # of pieces; those of higher degree are cut until the rest is rounding
_TAIL = 1e-14  # part of the slope that is left out then
_CORNER = 1e-9  # a change of the direction of p' by this is a corner
_REST = 1e-11  # p' smaller than this part of its largest value in the piece is zero
_ROUNDING = 1e-13  # a movement, or a highest coefficient, this part of its scale is none


@dataclass(frozen=True, eq=False)
class Pieces:
    """Polynomials in r, N of them, each within one piece of the path's curve.

    Within a piece r is s times a stretch, chosen so that p'(r) is continuous where p'(s) only
    changes its length: there the motion need not stop.
    """

    coefficients: np.ndarray  # (k, N, dof), in r from the left end
    width: np.ndarray  # (N,), of r
    source: np.ndarray  # (N,), the piece of the path's curve
    begin: np.ndarray  # (N,), where in it, in s
    origin: np.ndarray  # (N,), s at the left end
    stretch: np.ndarray  # (N,), dr/ds
    moving: np.ndarray  # (N,), whether any joint moves
    rest: np.ndarray  # (2, N), whether p' = 0 at the left and the right end
    smooth: np.ndarray  # (N - 1,), whether p' goes on in its direction to the next piece


def smooth_pieces(path: Path, cuts: np.ndarray) -> Pieces:
    """Cut the curve where its degree is high, and at the given s; stretch it to arc length.

    Parameters
    ----------
    path : Path
    cuts : array, shape (M,)
        Values of s at which limits are not smooth.
    """
    knots = path.curve.x
    inside = apart(cuts, knots)
    source = np.concatenate([np.arange(len(knots) - 1), np.searchsorted(knots, inside) - 1])
    origin = np.concatenate([knots[:-1], inside])
    order = np.argsort(origin, kind="stable")
    source, origin = source[order], origin[order]
    end = np.append(origin[1:], knots[-1])
    coefficients, source, origin, end = _of_low_degree(path.curve.c, knots, source, origin, end)
    begin, width = origin - knots[source], end - origin
    c, largest, moving = _without_rounding(coefficients, width, source)
    count = len(width)
    piece, unit = np.arange(count), np.where(largest > 0, largest, 1.0)
    ends = np.stack([np.zeros(count), width])
    left, right = horner(c, piece, ends, 1) / unit
    powers = np.arange(len(c))[::-1, None, None]
    size = (powers * np.abs(c) * width[:, None] ** np.maximum(powers - 1, 0)).sum(axis=0) / unit
    size = size.max(axis=1)
    rest = np.stack([np.abs(v).max(axis=1) for v in (left, right)]) <= _REST * size
    before, after = right[:-1], left[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sum(before * after, axis=1) / np.sum(before * before, axis=1)
        off = np.abs(after - ratio[:, None] * before).max(axis=1)
        slack = _CORNER * np.abs(after).max(axis=1) + 1e-15 * (size[1:] + ratio * size[:-1])
        smooth = (ratio > 0) & (off <= slack) & moving[1:] & moving[:-1]
    cut = source[1:] == source[:-1]  # within a polynomial, whatever its rounding
    ratio[cut] = 1.0
    smooth |= cut & moving[1:] & moving[:-1]
    smooth &= ~rest[1, :-1] & ~rest[0, 1:]
    ratio[~smooth | (np.abs(ratio - 1) <= _CORNER)] = 1.0
    stretch = _running_product(ratio, smooth)
    c, width = c / stretch[:, None] ** powers, width * stretch
    return Pieces(c, width, source, begin, origin, stretch, moving, rest, smooth)


def apart(points: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the points between knots, in order, that are no knot and no other to rounding."""
    points = np.sort(points[(points > knots[0]) & (points < knots[-1])])
    right = np.searchsorted(knots, points)
    gaps = points - knots[right - 1], knots[right] - points, np.diff(points, prepend=-np.inf)
    return np.asarray(points[np.min(gaps, axis=0) > 1e-12 * (knots[-1] - knots[0])])


def _of_low_degree(
    c: np.ndarray, knots: np.ndarray, source: np.ndarray, origin: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Expand the curve about the left ends of pieces, which are halved until few terms count."""
    while True:
        begin = origin - knots[source]
        terms = [horner(c, source, begin, m) / math.factorial(m) for m in range(len(c))]
        local = np.stack(terms[::-1])
        whole = begin == 0
        local[:, whole] = c[:, source[whole]]
        if len(c) <= _DEGREE + 1:
            return local, source, origin, end
        powers = np.arange(len(c))[::-1, None, None]
        sizes = (powers * np.abs(local) * (end - origin)[:, None] ** powers).max(axis=2)
        tail = sizes[: -_DEGREE - 1].sum(axis=0)
        halve = (tail > _TAIL * sizes.max(axis=0)) & (end - origin > 1e-9 * (knots[-1] - knots[0]))
        if not halve.any():
            return local[-_DEGREE - 1 :], source, origin, end
        middle = (origin + end)[halve] / 2
        order = np.argsort(np.concatenate([origin, middle]), kind="stable")
        source = np.concatenate([source, source[halve]])[order]
        end = np.concatenate([np.where(halve, (origin + end) / 2, end), end[halve]])[order]
        origin = np.concatenate([origin, middle])[order]


def _without_rounding(
    c: np.ndarray, width: np.ndarray, source: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drop movements and degrees that are rounding.

    Returns
    -------
    coefficients : array, shape (k, N, dof)
    largest : array, shape (dof,)
        Of each joint's slope along the path.
    moving : array of bool, shape (N,)
    """
    powers = np.arange(len(c))[::-1, None, None]
    moves = np.abs(c) * width[:, None] ** powers
    slopes = (powers * moves / width[:, None]).max(axis=0)
    largest = slopes.max(axis=0)
    size = np.abs(c[-1]).max(axis=0)
    moved = moves[:-1].sum(axis=0)
    none = _ROUNDING * (size + moved.max(axis=0))
    still = moved <= none
    # Where some joint moves: of the whole piece of the curve; in a short part all moves are small.
    first = np.flatnonzero(np.diff(source, prepend=-1))
    whole = np.add.reduceat(moved, first)[source] <= none
    still &= whole | still.all(axis=1, keepdims=True)
    c = c.copy()
    c[:-1, still] = 0.0
    while len(c) > 2 and np.all(
        np.abs(c[0]) * width[:, None] ** (len(c) - 2) <= _ROUNDING * largest
    ):
        c = c[1:]  # a spline through points on a line, for instance
    return c, largest, ~still.all(axis=1)


def _running_product(ratio: np.ndarray, smooth: np.ndarray) -> np.ndarray:
    """Return the product of all ratios since the last place that is not smooth, (N,)."""
    total = np.concatenate([[0.0], np.cumsum(np.log(ratio))])
    start = np.concatenate([[0], np.where(smooth, 0, np.arange(1, len(total)))])
    return np.asarray(np.exp(total - total[np.maximum.accumulate(start)]))
