"""The profile x(s) = s'^2 of a motion along a grid, and its exact times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from statebook.timescale.grid import Grid


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
    return 2 * h / speeds * _quotient(inverse, root)


def _quotient(value: np.ndarray, argument: np.ndarray) -> np.ndarray:
    """Return f(y) / y for functions with f'(0) = 1, which have no cancellation there."""
    return np.divide(value, argument, out=np.ones_like(argument), where=argument > 0)


@dataclass(frozen=True, eq=False)
class Profile:
    """s'^2 at the ends of each interval of a grid, and the shape in between.

    In interval i, s'^2 = x0 (1 - z) + x1 z - curvature (x0 + x1)/2 z (1 - z). The controllable
    set holds the s'^2 from which the end can be reached within the limits.
    """

    grid: Grid
    x0: np.ndarray
    x1: np.ndarray
    curvature: np.ndarray
    controllable: np.ndarray  # (2, N, 2): lowest and highest, interval, left and right end

    @cached_property
    def bulge(self) -> np.ndarray:
        """Twice the difference quotient that bends the profile: h^2 times ds''/ds."""
        return self.curvature * (self.x0 + self.x1) / 2

    @cached_property
    def times(self) -> np.ndarray:
        """Time at the ends of the intervals, shape (N + 1,)."""
        steps = travel_time(self.grid.h, self.x0, self.x1, self.bulge)
        return np.concatenate([[0.0], np.cumsum(steps)])

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
        return (self.x1 - self.x0 - self.bulge * (1 - 2 * z[:, None])) / (2 * self.grid.h)

    def time_at(self, interval: int, z: float) -> float:
        """Return the time at a fraction of an interval."""
        if z == 0:
            return float(self.times[interval])
        x = self.x(np.array([z]))[0, interval]
        bulge = self.bulge[interval] * z * z
        step = travel_time(z * self.grid.h[interval], self.x0[interval], x, bulge)
        return float(self.times[interval] + step)

    def locate(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the interval, s minus its left end, s' and s'' at times t (M,)."""
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.x0) - 1)
        t = t - self.times[i]
        h, v0 = self.grid.h[i], np.sqrt(self.x0[i])
        u0 = (self.x1 - self.x0 - self.bulge)[i] / (2 * h)
        rate = self.bulge[i] / h**2
        omega = np.sqrt(np.abs(rate))
        half = omega * t / 2
        up = rate > 0
        sinh = np.where(up, np.sinh(np.where(up, half, 0.0)), np.sin(half))
        cosh = np.where(up, np.cosh(np.where(up, half, 0.0)), np.cos(half))
        sinc = _quotient(sinh, half) * t / 2
        ds = np.clip(2 * sinc * (v0 * cosh + u0 * sinc), 0.0, h)
        speed = v0 * (cosh**2 + rate * sinc**2) + 2 * u0 * sinc * cosh
        return i, ds, np.maximum(speed, 0.0), u0 + rate * ds

    def slower(self, factor: float) -> Profile:
        """Return the profile of the same motion that takes factor times as long."""
        return replace(self, x0=self.x0 / factor**2, x1=self.x1 / factor**2)
