"""The path cut into intervals, and into sections between the places where it must stop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from statebook.timescale.path import Path, horner

_CORNER = 1e-9  # a jump of p' by this part of its largest value is a corner
_REST = 1e-11  # p' smaller than this part of its largest value is zero
_ROUNDING = 1e-13  # a movement, or a highest coefficient, this part of its scale is none


class Section(NamedTuple):
    """Intervals first to last - 1, and s'^2 at both ends: None leaves it free."""

    first: int
    last: int
    start: float | None
    end: float | None


@dataclass(frozen=True, eq=False)
class Grid:
    """Intervals [s, s + h] of the path, N of them, each within one piece of the curve."""

    coefficients: np.ndarray
    knots: np.ndarray
    piece: np.ndarray
    offset: np.ndarray
    h: np.ndarray
    sections: tuple[Section, ...]

    @property
    def degree(self) -> int:
        """Degree of the path's pieces."""
        return len(self.coefficients) - 1

    @property
    def s(self) -> np.ndarray:
        """Left ends of the intervals, shape (N,)."""
        return self.knots[self.piece] + self.offset

    def path(self, z: np.ndarray, derivative: int) -> np.ndarray:
        """Return a derivative of p at fractions z (K,) of the intervals, shape (K, N, dof)."""
        offset = self.offset + np.multiply.outer(z, self.h)
        return horner(self.coefficients, self.piece, offset, derivative)

    def split(self, counts: np.ndarray) -> tuple[Grid, np.ndarray, np.ndarray, np.ndarray]:
        """Cut interval i into counts[i] equal parts.

        Returns
        -------
        grid : Grid
        parent : array of int
            The interval each part comes from.
        left, right : array
            Where in its parent, as a fraction, it begins and ends.
        """
        parent = np.repeat(np.arange(len(counts)), counts)
        first = np.concatenate([[0], np.cumsum(counts)])
        index = np.arange(len(parent)) - first[parent]
        parts = counts[parent]
        sections = tuple(
            part._replace(first=int(first[part.first]), last=int(first[part.last]))
            for part in self.sections
        )
        left, right = index / parts, (index + 1) / parts
        grid = replace(
            self,
            piece=self.piece[parent],
            offset=self.offset[parent] + left * self.h[parent],
            h=self.h[parent] / parts,
            sections=sections,
        )
        return grid, parent, left, right


def lay_grid(
    path: Path, start_speed: float, end_speed: float, intervals: int
) -> tuple[Grid, tuple[float, ...], tuple[tuple[float, float], ...]]:
    """Find the sections of a path and cut them into about so many intervals.

    Returns
    -------
    grid : Grid
        With no interval where nothing moves along the whole path.
    stops : tuple of float
        Values of s inside the path where p' jumps, so that the motion must stop.
    skipped : tuple of (float, float)
        Intervals of s where nothing moves; they take no time.
    """
    coefficients, knots = path.curve.c, path.curve.x
    width = np.diff(knots)
    pieces = np.arange(len(width))
    sample = np.multiply.outer(np.linspace(0, 1, 2 * len(coefficients)), width)
    slope = horner(coefficients, pieces, sample, 1)
    largest = np.abs(slope).max(axis=(0, 1))
    while len(coefficients) > 2 and np.all(
        np.abs(coefficients[0]) * width[:, None] ** (len(coefficients) - 2) <= _ROUNDING * largest
    ):
        coefficients = coefficients[1:]  # a spline through points on a line, for instance
    size = np.abs(coefficients[-1]).max(axis=0)
    steps = np.abs(slope).max(axis=0) * width[:, None]
    moving = (steps > _ROUNDING * size + _ROUNDING * largest * (knots[-1] - knots[0])).any(axis=1)
    left, right = slope[0], slope[-1]
    rest_left, rest_right = ((np.abs(v) <= _REST * largest).all(axis=1) for v in (left, right))
    corner = (np.abs(right[:-1] - left[1:]) > _CORNER * largest).any(axis=1)

    kept = np.flatnonzero(moving)
    follows = kept[1:] == kept[:-1] + 1
    smooth = follows & ~rest_right[kept[:-1]] & ~rest_left[kept[1:]]
    smooth[smooth] = ~corner[kept[:-1][smooth]]
    bounds = np.concatenate([[0], np.flatnonzero(~smooth) + 1, [len(kept)]])
    sections = []
    for first, last in pairwise(bounds):
        if first < last:
            start = None if rest_left[kept[first]] else 0.0
            end = None if rest_right[kept[last - 1]] else 0.0
            sections.append(Section(int(first), int(last), start, end))
    _set_ends(path, sections, moving, start_speed, end_speed)

    jumps = kept[1:][~smooth]  # sections begin at the left knots of these pieces
    calm = rest_right[kept[:-1][~smooth]] & rest_left[jumps]
    stops = tuple(float(s) for s in knots[jumps[~calm]])
    coarse = Grid(coefficients, knots, kept, np.zeros(len(kept)), width[kept], tuple(sections))
    parts = max(1, -(-intervals // max(len(kept), 1)))
    return coarse.split(np.full(len(kept), parts))[0], stops, _runs(knots, ~moving)


def _set_ends(
    path: Path, sections: list[Section], moving: np.ndarray, start: float, end: float
) -> None:
    """Put the speeds at the ends of the path into its first and last section."""
    for name, speed, at_rest in (
        ("start_speed", start, not moving[0]),
        ("end_speed", end, not moving[-1]),
    ):
        if speed > 0 and at_rest:
            raise ValueError(
                f"{name} must be 0 on a path that begins or ends without moving, got {speed:g}"
            )
    if start > 0:
        sections[0] = sections[0]._replace(start=start**2)
    if end > 0:
        sections[-1] = sections[-1]._replace(end=end**2)


def _runs(knots: np.ndarray, still: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Return the intervals of s covered by consecutive pieces."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return tuple(
        (float(knots[a]), float(knots[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    )
