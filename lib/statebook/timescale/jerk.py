"""Limits on joint jerk: p' s''' + 3 p'' s' s'' + p''' s'^3 along a path.

In x(s) = s'^2 the joint jerk is sqrt(x) P with P = p' x''/2 + 3/2 p'' x' + p''' x, linear in x. A
bound reads P <= J / sqrt(x), whose right side is convex in x: its tangent at any motion lies
below it, so that a quadratic program in x gives a motion that keeps the bound. Each is the
starting point of the next, until the time settles. From a rest no motion with s'' linear in s
leaves with s'' = 0: there the first piece is s ~ t^(3/m), m the order of the first derivative of
p that is not 0; for m = 1 that is constant s'''.

References
----------
F. Debrouwere et al., Time-Optimal Path Following for Robots With Convex-Concave Constraints Using
Sequential Convex Programming, IEEE Transactions on Robotics 29 (2013).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from statebook.timescale import bernstein
from statebook.timescale.bounds import read_bounds
from statebook.timescale.grid import Grid, Section
from statebook.timescale.path import Path
from statebook.timescale.profile import Profile, Use, Warp, travel_time

_BEND = 1e-9  # a jump of p'' by this part of its size is one


@dataclass(frozen=True, eq=False)
class JerkProfile(Profile):
    """A profile with bounded jerk; pieces next to a rest are powers of time.

    rest (N,) is 0 where s'^2 is a quadratic, +m where the interval leaves a rest of order m and
    -m where it arrives at one; the jerk bounds have shape (dof,).
    """

    rest: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @cached_property
    def _ends(self) -> tuple[np.ndarray, ...]:
        """Return of each interval at rest index, order, whether it arrives, h and peak."""
        index = np.flatnonzero(self.rest)
        peak = np.maximum(self.x0, self.x1)[index]
        return index, np.abs(self.rest[index]), self.rest[index] < 0, self.grid.h[index], peak

    @cached_property
    def steps(self) -> np.ndarray:
        index, order, _, h, peak = self._ends
        steps = travel_time(self.grid.h, self.x0, self.x1, self.bulge)
        steps[index] = 3 * h / (order * np.sqrt(peak))
        return steps

    def x(self, z: np.ndarray) -> np.ndarray:
        x = super().x(z)
        x[:, self._ends[0]] = self._leaving(z[:, None])[0]
        return x

    def u(self, z: np.ndarray) -> np.ndarray:
        u = super().u(z)
        u[:, self._ends[0]] = self._leaving(z[:, None])[1]
        return u

    def _leaving(self, z: np.ndarray, member: Any = slice(None)) -> tuple[np.ndarray, ...]:
        """Return s'^2, s'' and s''' at fractions of the intervals at rest.

        At rest s'' is 0, for p' s'' is; so is p' s''' there if that is infinite.
        """
        _, order, arrives, h, peak = (part[member] for part in self._ends)
        y, power = np.where(arrives, 1 - z, z), 2 - 2 * order / 3
        away, sign = np.where(y > 0, y, 1.0), np.where(arrives, -1.0, 1.0) * (y > 0)
        rate = sign * power / 2 * peak / h * away ** (power - 1)
        third = power * (power - 1) / 2 * peak**1.5 / h**2 * away ** (1.0 - order)
        return peak * y**power, rate, third

    def time_at(self, interval: np.ndarray, z: np.ndarray) -> np.ndarray:
        rest = self.rest[interval]
        power = np.abs(rest) / 3
        part = np.where(rest > 0, z**power, 1 - (1 - z) ** power)
        at_rest = self.times[interval] + part * self.steps[interval]
        return np.where(rest == 0, super().time_at(interval, z), at_rest)

    def locate(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        i, ds, speed, u = super().locate(t)
        at_rest = np.flatnonzero(self.rest[i])
        if len(at_rest):
            j = i[at_rest]
            member = np.searchsorted(self._ends[0], j)
            _, order, arrives, h, _ = (part[member] for part in self._ends)
            part = np.clip((t[at_rest] - self.times[j]) / self.steps[j], 0.0, 1.0)
            # At a rest of order 2 s'' is infinite and p' 0: look so near that p does not move.
            y = np.maximum(np.where(arrives, 1 - part, part), np.where(order > 1, 1e-6, 0.0))
            z = np.where(arrives, 1 - y ** (3 / order), y ** (3 / order))
            ds[at_rest] = h * z
            x, u[at_rest], _ = self._leaving(z, member)
            speed[at_rest] = np.sqrt(x)
        return i, ds, speed, u

    def locate_one(self, t: float) -> tuple[int, float, float, float]:
        i, ds, speed, u = self.locate(np.array([t]))
        return int(i[0]), float(ds[0]), float(speed[0]), float(u[0])

    def third(self, i: Any, ds: Any, speed: Any) -> np.ndarray:
        third = np.array(super().third(i, ds, speed))
        at_rest = self.rest[i] != 0
        if at_rest.any():
            j = np.asarray(i)[at_rest]
            member = np.searchsorted(self._ends[0], j)
            z = np.asarray(ds)[at_rest] / self.grid.h[j]
            third[at_rest] = self._leaving(z, member)[2]
        return third

    def parts(self) -> list[tuple[Profile, np.ndarray, Warp, int]]:
        parts: list[tuple[Profile, np.ndarray, Warp, int]] = []
        for chosen, warp, order in (
            (self.rest == 0, lambda y: y, 1),
            (self.rest > 0, lambda y: y**3, 3),
            (self.rest < 0, lambda y: 1 - (1 - y) ** 3, 3),
        ):
            index = np.flatnonzero(chosen)
            if len(index):
                parts.append((self.take(index), index, warp, order))
        return parts

    def take(self, index: np.ndarray) -> JerkProfile:
        """Return the intervals of an index as a profile of their own."""
        names = "x0", "x1", "rise", "curvature", "rest"
        parts = {name: getattr(self, name)[index] for name in names}
        sets = self.controllable[:, index]
        return replace(self, grid=self.grid.part(index), controllable=sets, **parts)

    def jerk_use(self, z: np.ndarray) -> np.ndarray:
        """Return the part of the jerk limits that is used at fractions z, (K, N, dof)."""
        p1, p2, p3 = (self.grid.path(z, k) for k in (1, 2, 3))
        x, u = self.x(z), self.u(z)
        rate = self._rate * np.sqrt(x)
        rate[:, self._ends[0]] = self._leaving(z[:, None])[2]
        bend, twist = 3 * np.sqrt(x) * u, np.sqrt(x) ** 3
        jerk = p1 * rate[:, :, None] + p2 * bend[:, :, None] + p3 * twist[:, :, None]
        return np.maximum(jerk / self.upper, jerk / self.lower)

    def further_uses(self) -> list[Use]:
        """Return the largest use of each joint's jerk limit, exact to rounding."""
        best = np.zeros(len(self.upper))
        places: list[tuple[int, float]] = [(0, 0.0)] * len(best)
        for index in (np.flatnonzero(self.rest == 0), self._ends[0]):
            if not len(index):
                continue
            square, sign = self.take(index)._jerks()
            for bound, side in ((self.upper, 1), (self.lower, -1)):
                use, interval, z = bernstein.maxima(square / bound**2, side * sign)
                for row in np.flatnonzero(use > best):
                    best[row] = use[row]
                    places[row] = int(index[interval[row]]), float(z[row])
        return [
            Use("jerk", row, float(use), *self.where(*place), True)
            for row, (use, place) in enumerate(zip(np.sqrt(best), places, strict=True))
        ]

    def _jerks(self) -> tuple[np.ndarray, np.ndarray]:
        """Return Bernstein coefficients of jerk^2 and of its sign: all at rest, or none."""
        if self.rest.any():
            _, order, arrives, _, peak = self._ends
            sign = rest_shape(self.grid, order, arrives) * (peak**1.5)[:, None]
            degree = 2 * len(sign) - 2
            z = bernstein.nodes(degree)
            square = bernstein.along(bernstein.to_values(len(sign) - 1, z), sign) ** 2
            return bernstein.along(bernstein.from_values(degree), square), sign
        degree = max(2 * self.grid.degree, 2)
        z = bernstein.nodes(degree)
        p1, p2, p3 = (self.grid.path(z, k) for k in (1, 2, 3))
        x, u = self.x(z)[:, :, None], self.u(z)[:, :, None]
        sign = p1 * self._rate[:, None] + 3 * p2 * u + p3 * x
        to_bernstein = bernstein.from_values(degree)
        return bernstein.along(to_bernstein, x * sign**2), bernstein.along(to_bernstein, sign)


def rest_shape(grid: Grid, order: np.ndarray, arrives: np.ndarray) -> np.ndarray:
    """Return Bernstein coefficients of jerk over peak^(3/2) in intervals that end at a rest.

    With y the fraction of the way from the rest and x = peak y^(2 - 2 m/3), it is a polynomial.
    """
    degree = max(grid.degree - 1, 1)
    z = (np.arange(degree + 1) + 0.5) / (degree + 1)
    to_bernstein = np.linalg.inv(bernstein.to_values(degree, z))
    y = np.where(arrives, 1 - z[:, None], z[:, None])
    power, h = 2 - 2 * order / 3, grid.h
    p1, p2, p3 = (grid.path(z, k) for k in (1, 2, 3))
    rate = power * (power - 1) / 2 * y ** (1.0 - order) / h**2
    middle = np.where(arrives, -1.5, 1.5) * power * y ** (2.0 - order) / h
    jerk = p1 * rate[:, :, None] + p2 * middle[:, :, None] + p3 * (y ** (3.0 - order))[:, :, None]
    return np.asarray(bernstein.along(to_bernstein, jerk))


def read_jerk(jerk: Any, path: Path, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Read the limits of the joints' jerk, lower and upper, (dof,) each.

    Raises
    ------
    TypeError, ValueError
        They are none, vary along the path, or are 0 for a joint that moves.
    """
    lower, upper, along, _ = read_bounds("jerk", jerk, path.dof, path)
    if along is not None:
        raise ValueError(
            "jerk must be the same all along the path: a number, or one or two per joint"
        )
    moves = (grid.pieces.coefficients[:-1] != 0).any(axis=(0, 1))
    for j in np.flatnonzero((lower == 0) | (upper == 0)):
        if moves[j]:
            raise ValueError(
                f"jerk must have lower < 0 < upper where a joint moves, got ({lower[j]:g}, "
                f"{upper[j]:g}) for joint {j}"
            )
    return np.where(moves, lower, -1.0), np.where(moves, upper, 1.0)


def stop_at_bends(grid: Grid) -> tuple[Grid, tuple[float, ...]]:
    """Cut sections where p'' jumps: there no motion but one at rest has a finite jerk.

    Returns
    -------
    grid : Grid
    stops : tuple of float
        Values of s.
    """
    ends = np.array([0.0, 1.0])
    bend = grid.path(ends, 2)
    slope = np.abs(grid.path(ends, 1)).max(axis=(0, 1))
    within = np.diff(grid.piece, prepend=grid.piece[0]) != 0
    within[[section.first for section in grid.sections]] = False
    index = np.flatnonzero(within)
    widths = grid.pieces.width[grid.piece]
    narrow = np.minimum(widths[index - 1], widths[index])[:, None]
    size = np.abs(bend).max(axis=(0, 1)) + slope / narrow
    jumps = np.abs(bend[0, index] - bend[1, index - 1]) > _BEND * size
    cuts = index[jumps.any(axis=1)]
    sections = []
    for section in grid.sections:
        inside = cuts[(cuts > section.first) & (cuts < section.last)]
        bounds = [section.first, *inside.tolist(), section.last]
        for first, last in pairwise(bounds):
            start = section.start if first == section.first else 0.0
            end = section.end if last == section.last else 0.0
            sections.append(Section(first, last, start, end))
    return replace(grid, sections=tuple(sections)), tuple(float(s) for s in grid.s[cuts])
