"""Control trajectories u(t): piecewise constant, linear, polynomial, spline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.times import ReadOnly, increasing, interval_of, within


@dataclass(frozen=True, eq=False, repr=False)
class ControlTrajectory(ReadOnly):
    """A control u(t), polynomial between breakpoints.

    ``u(t) = sum_j coefficients[j, k] (t - t_k)^(degree - j)`` for ``t_k <= t < t_{k+1}``: at a
    breakpoint the later piece holds, at the last time the last piece.

    Parameters
    ----------
    breakpoints : array, shape (K + 1,), increasing [s]
        Ends of the K pieces.
    coefficients : array, shape (degree + 1, K, m)
        Highest power first, as in `scipy.interpolate.PPoly`.

    Examples
    --------
    >>> bang_bang = ControlTrajectory.piecewise_constant([0, 1, 2], [1, -1])
    >>> bang_bang
    ControlTrajectory(m=1, 2 pieces of degree 0 over [0, 2] s)
    >>> bang_bang([0.5, 1.0, 2.0]).tolist()
    [[1.0, -1.0, -1.0]]
    """

    breakpoints: np.ndarray
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        breakpoints = increasing("breakpoints", self.breakpoints, minimum=2)
        pieces = len(breakpoints) - 1
        coefficients = _validate.real_array("coefficients", self.coefficients, (None, pieces, None))
        if 0 in coefficients.shape:
            raise ValueError(
                f"coefficients must have shape (degree + 1, {pieces}, m), got {coefficients.shape}"
            )
        self._keep(breakpoints=breakpoints, coefficients=coefficients.copy())

    def __repr__(self) -> str:
        degree, pieces, m = (len(self.coefficients) - 1, *self.coefficients.shape[1:])
        count = f"{pieces} piece{'s' if pieces > 1 else ''}"
        start, end = self.breakpoints[[0, -1]]
        return f"ControlTrajectory(m={m}, {count} of degree {degree} over [{start:g}, {end:g}] s)"

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.coefficients.shape[2]

    @property
    def duration(self) -> float:
        """Time from the first breakpoint to the last [s]."""
        return float(self.breakpoints[-1] - self.breakpoints[0])

    def __call__(self, t: Any) -> np.ndarray:
        """Evaluate u(t).

        Parameters
        ----------
        t : float or array, shape (N,) [s]
            Times between the first and the last breakpoint.

        Returns
        -------
        array, shape (m,) or (m, N)

        Raises
        ------
        ValueError
            If a time is outside the breakpoints.
        """
        t = within("t", t, self.breakpoints)
        return self.on_piece(interval_of(t, self.breakpoints), t)

    def on_piece(self, k: Any, t: Any) -> np.ndarray:
        """Evaluate the polynomial of piece k, on its piece or beyond.

        This is how to get the limit from the left at a breakpoint.

        Parameters
        ----------
        k : int or array, shape (N,)
            Indices of pieces.
        t : float or array, shape (N,) [s]
            Times.

        Returns
        -------
        array, shape (m,) or (m, N)

        Examples
        --------
        >>> ControlTrajectory.piecewise_constant([0, 1, 2], [1, -1]).on_piece(0, 1.0)
        array([1.])
        """
        local = np.asarray(t - self.breakpoints[k])[..., None]
        value = 0.0 * local
        for coefficient in self.coefficients:
            value = value * local + coefficient[k]
        return np.asarray(value).T

    def between(self, start: float, end: float) -> ControlTrajectory:
        """The part of the control between two times.

        Parameters
        ----------
        start, end : float [s]
            Times between the first and the last breakpoint, in order.

        Returns
        -------
        ControlTrajectory

        Examples
        --------
        >>> ControlTrajectory.piecewise_linear([0, 1, 3], [0, 2, 0]).between(0.5, 2)
        ControlTrajectory(m=1, 2 pieces of degree 1 over [0.5, 2] s)
        """
        start, end = within("start, end", [start, end], self.breakpoints)
        breaks = self.breakpoints
        first = int(interval_of(np.float64(start), breaks))
        last = max(first, int(np.searchsorted(breaks, end)) - 1)
        breaks = np.concatenate([[start], breaks[first + 1 : last + 1], [end]])
        coefficients = self.coefficients[:, first : last + 1].copy()
        shift = start - self.breakpoints[first]
        for count in range(len(coefficients) - 1, 0, -1):  # Horner's scheme, about the new start
            for j in range(count):
                coefficients[j + 1, 0] += shift * coefficients[j, 0]
        return ControlTrajectory(breaks, coefficients)

    @classmethod
    def piecewise_constant(cls, times: Any, values: Any) -> ControlTrajectory:
        """A control that holds K values between K + 1 times.

        Parameters
        ----------
        times : array, shape (K + 1,), increasing [s]
            Ends of the intervals.
        values : array, shape (K,) or (m, K)
            The value of each interval.

        Returns
        -------
        ControlTrajectory

        Examples
        --------
        >>> ControlTrajectory.piecewise_constant([0, 1, 3], [5, 7])(2.0)
        array([7.])
        """
        times = increasing("times", times, minimum=2)
        return cls(times, _values(values, len(times) - 1).T[None])

    @classmethod
    def piecewise_linear(cls, times: Any, values: Any) -> ControlTrajectory:
        """A control that joins K + 1 values by straight lines.

        Parameters
        ----------
        times : array, shape (K + 1,), increasing [s]
        values : array, shape (K + 1,) or (m, K + 1)
            The value at each time.

        Returns
        -------
        ControlTrajectory

        Examples
        --------
        >>> ControlTrajectory.piecewise_linear([0, 1, 3], [0, 2, 0])(2.0)
        array([1.])
        """
        times = increasing("times", times, minimum=2)
        values = _values(values, len(times)).T
        slopes = np.diff(values, axis=0) / np.diff(times)[:, None]
        return cls(times, np.stack([slopes, values[:-1]]))

    @classmethod
    def polynomial(
        cls, coefficients: Any, duration: float, *, t0: float = 0.0
    ) -> ControlTrajectory:
        """A control that is one polynomial of the time since t0.

        ``u(t) = sum_j c_j (t - t0)^j`` on [t0, t0 + duration].

        Parameters
        ----------
        coefficients : array, shape (degree + 1,) or (m, degree + 1)
            Lowest power first, as in `numpy.polynomial`.
        duration : float > 0 [s]
        t0 : float [s]

        Returns
        -------
        ControlTrajectory

        Examples
        --------
        >>> ControlTrajectory.polynomial([1, 0, 3], duration=2)(2.0)
        array([13.])
        """
        duration = _validate.positive("duration", duration)
        t0 = _validate.number("t0", t0)
        coefficients = _values(coefficients, None, "coefficients")
        return cls(np.array([t0, t0 + duration]), coefficients[:, ::-1].T[:, None, :])

    @classmethod
    def spline(cls, times: Any, values: Any, *, bc_type: str = "not-a-knot") -> ControlTrajectory:
        """A control that is a cubic spline through values.

        Parameters
        ----------
        times : array, shape (K + 1,), increasing [s]
        values : array, shape (K + 1,) or (m, K + 1)
            The value at each time.
        bc_type : str
            End condition, as in `scipy.interpolate.CubicSpline`.

        Returns
        -------
        ControlTrajectory

        Examples
        --------
        >>> t = np.linspace(0, 3, 4)
        >>> np.round(ControlTrajectory.spline(t, t**3)(1.5), 12)
        array([3.375])
        """
        times = increasing("times", times, minimum=2)
        values = _values(values, len(times)).T
        return cls.from_ppoly(scipy.interpolate.CubicSpline(times, values, bc_type=bc_type))

    @classmethod
    def from_ppoly(cls, curve: scipy.interpolate.PPoly) -> ControlTrajectory:
        """The control of a SciPy piecewise polynomial.

        Parameters
        ----------
        curve : scipy.interpolate.PPoly
            Its ``c`` has shape (k, pieces) or (k, pieces, m).

        Returns
        -------
        ControlTrajectory

        Examples
        --------
        >>> curve = scipy.interpolate.PPoly([[1.0], [0.0]], [0.0, 2.0])
        >>> ControlTrajectory.from_ppoly(curve)(2.0)
        array([2.])
        """
        if not isinstance(curve, scipy.interpolate.PPoly):
            raise TypeError(
                f"curve must be a scipy.interpolate.PPoly, got {type(curve).__name__}; "
                "convert a BSpline with PPoly.from_spline"
            )
        return cls(curve.x, curve.c if curve.c.ndim > 2 else curve.c[..., None])


def _values(values: Any, count: int | None, name: str = "values") -> np.ndarray:
    values = _validate.real_array(name, values)
    values = values[None] if values.ndim == 1 else values
    if values.ndim != 2 or values.size == 0 or count not in (None, values.shape[1]):
        wanted = "any" if count is None else count
        raise ValueError(f"{name} must have shape ({wanted},) or (m, {wanted}), got {values.shape}")
    return values
