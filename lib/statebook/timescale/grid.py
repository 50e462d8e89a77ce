"""The path cut into intervals, and into sections between the places where it must stop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from statebook.timescale.path import Path, horner
from statebook.timescale.pieces import Pieces, smooth_pieces

_FEWEST = 2  # intervals of a section that begins and ends at rest


class Section(NamedTuple):
    """Intervals first to last - 1, and the squared speed at both ends: None leaves it free."""

    first: int
    last: int
    start: float | None
    end: float | None


@dataclass(frozen=True, eq=False)
class Grid:
    """Intervals [r, r + h] of the path, N of them, each within one of its pieces."""

    pieces: Pieces
    piece: np.ndarray
    offset: np.ndarray
    h: np.ndarray
    sections: tuple[Section, ...]

    @property
    def degree(self) -> int:
        """Degree of the path's pieces."""
        return len(self.pieces.coefficients) - 1

    @property
    def stretch(self) -> np.ndarray:
        """Rate dr/ds in the intervals, shape (N,)."""
        return self.pieces.stretch[self.piece]

    @property
    def s(self) -> np.ndarray:
        """The path parameter at the left ends of the intervals, shape (N,)."""
        return self.s_at(np.zeros(1))[0]

    def s_at(self, z: np.ndarray) -> np.ndarray:
        """Return the path parameter at fractions z (K,) of the intervals, shape (K, N)."""
        offset = (self.offset + np.multiply.outer(z, self.h)) / self.stretch
        return self.pieces.origin[self.piece] + offset

    def find(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the intervals that hold values of the path parameter, and the fractions of them.

        Where nothing moves: the end of the interval before.
        """
        start, end = self.s_at(np.array([0.0, 1.0]))
        i = np.maximum(np.searchsorted(start, s, side="right") - 1, 0)
        return i, np.clip((s - start[i]) / (end[i] - start[i]), 0.0, 1.0)

    def path(self, z: np.ndarray, derivative: int) -> np.ndarray:
        """Return a derivative of p(r) at fractions z (K,) of the intervals, shape (K, N, dof)."""
        offset = self.offset + np.multiply.outer(z, self.h)
        return horner(self.pieces.coefficients, self.piece, offset, derivative)

    def at(self, s: np.ndarray) -> Grid:
        """Return intervals of no length at values s (M,) of the path parameter."""
        origin = self.pieces.origin
        piece = np.clip(np.searchsorted(origin, s, side="right") - 1, 0, len(origin) - 1)
        offset = (s - origin[piece]) * self.pieces.stretch[piece]
        return replace(self, piece=piece, offset=offset, h=np.zeros(len(s)), sections=())

    def part(self, intervals: slice | np.ndarray) -> Grid:
        """Return some of the intervals, without their sections."""
        piece, offset, h = (values[intervals] for values in (self.piece, self.offset, self.h))
        return Grid(self.pieces, piece, offset, h, ())

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
        offset = self.offset[parent] + left * self.h[parent]
        grid = Grid(self.pieces, self.piece[parent], offset, self.h[parent] / parts, sections)
        return grid, parent, left, right


def lay_grid(
    path: Path,
    start_speed: float,
    end_speed: float,
    intervals: int,
    cuts: np.ndarray | None = None,
    halts: np.ndarray | None = None,
) -> tuple[Grid, tuple[float, ...], tuple[tuple[float, float], ...]]:
    """Find the sections of a path and cut them into about so many intervals.

    Returns
    -------
    grid : Grid
        With no interval where nothing moves along the whole path.
    stops : tuple of float
        Values of s inside the path where its direction jumps or it halts, so that it must stop.
    skipped : tuple of (float, float)
        Intervals of s where nothing moves; they take no time.
    """
    halts = np.zeros(0) if halts is None else halts
    pieces = smooth_pieces(path, halts if cuts is None else np.concatenate([halts, cuts]))
    kept = np.flatnonzero(pieces.moving)
    if not len(kept):
        raise ValueError("the path must move: all its points are the same, to within rounding")
    follows = kept[1:] == kept[:-1] + 1
    smooth = follows & pieces.smooth[kept[:-1]]
    joints = pieces.origin[kept[1:], None]
    near = 2e-12 * (path.s_end - path.s_start)
    smooth &= (np.abs(joints - halts) > near).all(axis=1)
    bounds = np.concatenate([[0], np.flatnonzero(~smooth) + 1, [len(kept)]])
    rest_left, rest_right = pieces.rest[:, kept]
    rests = zip(rest_left[bounds[:-1]], rest_right[bounds[1:] - 1], strict=True)
    sections = [
        Section(*ends, *(None if rest else 0.0 for rest in at_rest))
        for ends, at_rest in zip(pairwise(bounds.tolist()), rests, strict=True)
    ]
    _set_ends(pieces, sections, start_speed, end_speed)
    calm = rest_right[:-1] & rest_left[1:]
    stops = tuple(float(s) for s in pieces.origin[kept[1:][~smooth & ~calm]])
    ends = np.append(pieces.origin[1:], path.s_end)
    width = pieces.width[kept]
    coarse = Grid(pieces, kept, np.zeros(len(kept)), width, tuple(sections))
    counts = np.full(len(kept), max(1, -(-intervals // len(kept))))
    for part in sections:
        if part.start == 0 and part.end == 0 and part.last - part.first < _FEWEST:
            counts[part.first : part.last] = np.maximum(counts[part.first], _FEWEST)
    return coarse.split(counts)[0], stops, _runs(pieces.origin, ends, ~pieces.moving)


def _set_ends(pieces: Pieces, sections: list[Section], start: float, end: float) -> None:
    """Put the speeds at the ends of the path into its first and last section."""
    for name, speed, k in (("start", start, 0), ("end", end, -1)):
        if speed > 0 and not pieces.moving[k]:
            raise ValueError(
                f"{name}_speed must be 0 on a path that begins or ends without moving, got "
                f"{speed:g}"
            )
        if speed > 0:
            sections[k] = sections[k]._replace(**{name: (speed * pieces.stretch[k]) ** 2})


def _runs(
    left: np.ndarray, right: np.ndarray, still: np.ndarray
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of s covered by consecutive pieces."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return tuple(
        (float(left[a]), float(right[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    )
