"""The motion s(t) along a path, and the audit of its limits."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np

from statebook.timescale import bernstein
from statebook.timescale.grid import Grid
from statebook.timescale.limits import DENSE, Limit, TorqueLimit, VelocityLimit

Kind = TypeVar("Kind", bound="Profile")
Warp = Callable[[np.ndarray], np.ndarray]


def travel_time(h: np.ndarray, x0: np.ndarray, x1: np.ndarray, bulge: np.ndarray) -> np.ndarray:
    """Return the time over an interval where s'^2 is quadratic in s.

    With x(z) = x0 (1 - z) + x1 z - bulge z (1 - z) on [0, 1], s'' is linear in s, so that s(t)
    is made of exponentials (bulge > 0) or sines, and with r = sqrt(abs(bulge)) the time is
    2 h / r atanh(r / (sqrt(x0) + sqrt(x1))), or the same with atan.

    Parameters
    ----------
    h : array, shape (N,), > 0
        Length of the interval.
    x0, x1, bulge : array, shape (N,)
        x0 + x1 > 0, bulge < (sqrt(x0) + sqrt(x1))^2.

    Returns
    -------
    array, shape (N,) [s]
    """
    speeds = np.sqrt(x0) + np.sqrt(x1)
    root = np.sqrt(np.abs(bulge)) / speeds
    upward = bulge > 0
    inverse = np.where(upward, np.arctanh(np.where(upward, root, 0.0)), np.arctan(root))
    quotient = np.divide(inverse, root, out=np.ones_like(root), where=root > 0)
    return np.asarray(2 * h / speeds * quotient)


def _advance(lib: Any, x0: Any, u0: Any, rate: Any, t: Any) -> tuple[Any, Any, Any]:
    """Return s, s' and s'' after a time t from s = 0, s'^2 = x0, s'' = u0; s'' = u0 + rate s.

    With complex numbers the exponentials of rate > 0 and the sines of rate < 0 are one formula.
    """
    half = lib.sqrt(rate + 0j) * (t / 2) + 1e-300
    cosh, sinc = lib.cosh(half).real, (lib.sinh(half) / half).real * (t / 2)
    v0 = lib.sqrt(x0).real
    s = 2 * sinc * (v0 * cosh + u0 * sinc)
    return s, v0 * (cosh**2 + rate * sinc**2) + 2 * u0 * sinc * cosh, u0 + rate * s


@dataclass(frozen=True, eq=False)
class Profile:
    """s'^2 at the ends of each interval of a grid, and the shape in between.

    In interval i, s'^2 = x0 (1 - z) + x1 z - curvature (x0 + x1)/2 z (1 - z). The controllable
    set holds the s'^2 from which the end can be reached within the limits.
    """

    grid: Grid
    x0: np.ndarray
    x1: np.ndarray
    rise: np.ndarray  # x1 - x0, which would be rounding on very short intervals
    curvature: np.ndarray
    controllable: np.ndarray  # (2, N, 2): lowest and highest, interval, left and right end

    @cached_property
    def bulge(self) -> np.ndarray:
        """Twice the difference quotient that bends the profile: h^2 times ds''/ds."""
        return self.curvature * (self.x0 + self.x1) / 2

    @cached_property
    def steps(self) -> np.ndarray:
        """Time each interval takes, shape (N,)."""
        return travel_time(self.grid.h, self.x0, self.x1, self.bulge)

    @cached_property
    def times(self) -> np.ndarray:
        """Time at the ends of the intervals, shape (N + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.steps)])

    @property
    def duration(self) -> float:
        """Total time."""
        return float(self.times[-1])

    def x(self, z: np.ndarray) -> np.ndarray:
        """Return s'^2 at fractions z (K,) of the intervals, shape (K, N)."""
        z = z[:, None]
        return np.maximum(self.x0 * (1 - z) + self.x1 * z - self.bulge * z * (1 - z), 0.0)

    def u(self, z: np.ndarray) -> np.ndarray:
        """Return s'' at fractions z (K,) of the intervals, shape (K, N)."""
        return (self.rise - self.bulge * (1 - 2 * z[:, None])) / (2 * self.grid.h)

    def time_at(self, interval: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the times at fractions z (M,) of intervals (M,)."""
        x0, x1, bulge = self.x0[interval], self.x1[interval], self.bulge[interval]
        x = np.maximum(x0 * (1 - z) + x1 * z - bulge * z * (1 - z), 0.0)
        inside = z > 0
        x0, x = np.where(inside, x0, 1.0), np.where(inside, x, 1.0)
        step = travel_time(z * self.grid.h[interval], x0, x, bulge * z * z)
        return np.asarray(self.times[interval] + step)

    def where(self, interval: int, z: float) -> tuple[float, float]:
        """Return the time and the path parameter at a fraction of an interval."""
        time = self.time_at(np.array([interval]), np.array([z]))[0]
        return float(time), float(self.grid.s_at(np.array([z]))[0, interval])

    def locate(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the interval, s minus its left end, s' and s'' at times t (M,)."""
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.x0) - 1)
        ds, speed, u = _advance(np, self.x0[i], self._first_u[i], self._rate[i], t - self.times[i])
        return i, np.clip(ds, 0.0, self.grid.h[i]), np.maximum(speed, 0.0), u

    def locate_one(self, t: float) -> tuple[int, float, float, float]:
        """Return the same for a single time, without the cost of arrays."""
        i = min(max(int(self.times.searchsorted(t, side="right")) - 1, 0), len(self.x0) - 1)
        start = (self.x0[i], self._first_u[i], self._rate[i], t - self.times[i])
        ds, speed, u = _advance(cmath, *(float(value) for value in start))
        return i, min(max(ds, 0.0), float(self.grid.h[i])), max(speed, 0.0), u

    @cached_property
    def _first_u(self) -> np.ndarray:
        """The rate s'' at the left ends of the intervals."""
        return (self.rise - self.bulge) / (2 * self.grid.h)

    @cached_property
    def _rate(self) -> np.ndarray:
        """Slope ds''/ds in the intervals."""
        return self.bulge / self.grid.h**2

    def third(self, i: Any, ds: Any, speed: Any) -> np.ndarray:
        """Return s''' in intervals i (M,), with what `locate` returns."""
        return np.asarray(self._rate[i] * speed)

    def parts(self) -> list[tuple[Profile, np.ndarray, Warp, int]]:
        """Return the profile in parts in which limits are polynomials.

        Of each part: the profile, the intervals it consists of, the function of [0, 1] that gives
        the fraction z of an interval, and by how much it multiplies the degree.
        """
        return [(self, np.arange(len(self.x0)), lambda y: y, 1)]

    def further_uses(self) -> list[Use]:
        """Return the largest uses of limits that are not bounds on s'' and s'^2."""
        return []

    def slower(self: Kind, factor: float) -> Kind:
        """Return the profile of the same motion that takes factor times as long."""
        squares = {name: getattr(self, name) / factor**2 for name in ("x0", "x1", "rise")}
        return replace(self, **squares)


_HIGHEST = 30  # degree of polynomials in powers of time whose coefficients are not rounding
_SAME = 1e-6  # uses that differ by less are the same use


@dataclass(frozen=True)
class Use:
    """The largest use of one limit.

    Attributes
    ----------
    limit : str
        "velocity", "acceleration", "speed", "norm of acceleration", "torque", or one of the
        first four with "tool" before it.
    row : int
        Joint, axis of the tool, or row of the torques.
    use : float
        The quantity over its bound at the worst instant: at most 1 if the limit holds. Of a
        torque range that does not enclose 0: 1 plus the excess over the larger bound.
    time, s : float
        When and where, the first time.
    exact : bool
        True if it is the maximum over all time to rounding; False for torques, which are looked
        at on 5 points of each interval.
        With a jerk limit also False for limits of high degree, as of a tool, which are looked at
        so in the intervals next to rests.
    """

    limit: str
    row: int
    use: float
    time: float
    s: float
    exact: bool

    @property
    def factor(self) -> float:
        """How much longer a uniformly slower motion takes that just keeps the limit."""
        powers = {"acceleration": 1 / 2, "torque": 1 / 2, "jerk": 1 / 3}
        return float(self.use ** powers.get(self.limit.split()[-1], 1.0))


@dataclass(frozen=True)
class Audit:
    """The largest use of every limit over a whole motion.

    Attributes
    ----------
    uses : tuple of Use
        One per limit and joint.
    """

    uses: tuple[Use, ...]

    @property
    def worst(self) -> Use:
        """The limit that is used most."""
        return max(self.uses, key=lambda use: use.use)

    def __iter__(self) -> Iterator[Use]:
        return iter(self.uses)

    def __len__(self) -> int:
        return len(self.uses)

    def __repr__(self) -> str:
        lines = ["limit                 row    use       time         s"]
        for u in self.uses:
            lines.append(
                f"{u.limit:<20}{u.row:>5}{u.use + 0.0:>7.4f}{u.time + 0.0:>11.4g}{u.s + 0.0:>10.4g}"
            )
        return "\n".join(lines)


def audit(profile: Profile, limits: Sequence[Limit]) -> Audit:
    """Find the largest use of every limit.

    Velocities and accelerations are polynomials of s in each interval; their maxima are enclosed
    to rounding by their Bernstein coefficients, which bound them. Torques are not polynomials:
    they are looked at on dense points.
    """
    uses: list[Use] = []
    for limit in limits:
        exact = not isinstance(limit, TorqueLimit)
        found, sure = [], exact
        for part, index, warp, order in profile.parts():
            degree = limit.degree(part.grid) * (2 if limit.norm else 1) * order
            known = exact and (order == 1 or degree <= _HIGHEST)
            sure &= known
            y = bernstein.nodes(degree) if known else np.linspace(0, 1, DENSE)
            z = warp(y)
            u, x = part.u(z), part.x(z)
            sampled = limit.audited_use(part.grid, z, u, x)
            highest, places = _maxima(part, limit, y, warp) if known else (sampled.max((0, 1)), [])
            highest = highest + limit.uncertainty(part.grid, z, u, x)
            found.append((sampled, highest, places, index, z))
        for row in range(len(found[0][1])):
            use = max(highest[row] for _, highest, _, _, _ in found)
            # Limits are reached again and again: name the first time, whatever the rounding.
            first = []
            for sampled, highest, places, index, z in found:
                reached = sampled[:, :, row].T >= use - _SAME * abs(use)
                if reached.any():
                    i, k = np.unravel_index(reached.argmax(), reached.shape)
                    place = int(index[i]), float(z[k])
                elif highest[row] == use:
                    place = int(index[places[row][0]]), places[row][1]
                else:
                    continue
                first.append((*profile.where(*place), use))
            time, s, _ = min(first)
            uses.append(Use(limit.kind, row, float(use), time, s, sure))
    return Audit(tuple(uses + profile.further_uses()))


def _maxima(
    profile: Profile, limit: Limit, y: np.ndarray, warp: Warp
) -> tuple[np.ndarray, list[tuple[int, float]]]:
    """Return the largest use of each row, and the interval and the fraction of it where it is."""
    transform, z = partial(bernstein.along, bernstein.from_values(len(y) - 1)), warp(y)
    a, b, _ = limit.terms(profile.grid, z)
    values = a * profile.u(z)[:, :, None] + b * profile.x(z)[:, :, None]
    lower, upper = limit.bounds(profile.grid, z)
    if limit.norm:
        values = (values**2).sum(axis=2, keepdims=True)
    coefficients = transform(values)
    power = 2 if limit.squared or limit.norm else 1
    sides: list[Any] = [(coefficients, upper**power, None), (-coefficients, -lower, None)]
    sides = sides[: 3 - power]
    if isinstance(limit, VelocityLimit) and not np.array_equal(upper, -lower):
        slope = transform(limit.motion(profile.grid, z, 1))
        sides = [(coefficients, upper**2, slope), (coefficients, lower**2, -slope)]
    found = [
        bernstein.maxima(part / bound, sign)
        if bound.ndim == 1
        else bernstein.ratio_maxima(part, transform(np.minimum(bound, 1e300)), sign)
        for part, bound, sign in sides
    ]
    use, interval, fraction = (np.stack(values) for values in zip(*found, strict=True))
    side, rows = use.argmax(axis=0), np.arange(use.shape[1])
    highest = np.maximum(use[side, rows], 0.0)
    fractions = warp(fraction[side, rows]).tolist()
    places = list(zip(interval[side, rows].tolist(), fractions, strict=True))
    return highest ** (1 / power), places
