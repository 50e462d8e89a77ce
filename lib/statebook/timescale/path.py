"""Geometric paths p(s): piecewise polynomials in the path parameter s."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.timescale.blend import blended_polyline
from statebook.timescale.wrapping import unwrapped

_KINDS = ("cubic", "linear")
_SAME = 1e-8  # waypoints nearer to each other than this part of the path's extent are one


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A curve through the space of joint positions.

    Parameters
    ----------
    curve : scipy.interpolate.PPoly, BSpline or BPoly
        Positions as a function of the path parameter s; as a PPoly its coefficients have shape
        (k, pieces, dof). It must be continuous; where its direction jumps the motion will stop.

    Raises
    ------
    TypeError, ValueError
        If it is not such a curve, or it jumps.

    Examples
    --------
    >>> path = Path.through([[0.0, 1.0, 1.0], [0.0, 0.0, 2.0]])
    >>> path
    Path(dof=2, 2 pieces, s from 0 to 1)
    >>> path(0.5)
    array([1., 0.])
    """

    curve: Any
    _end: np.ndarray | None = field(default=None, kw_only=True)  # free of rounding
    _waypoints: np.ndarray | None = field(default=None, kw_only=True)  # s there

    def __post_init__(self) -> None:
        curve = _piecewise(self.curve)
        object.__setattr__(self, "curve", curve)
        if curve.c.ndim != 3 or curve.c.shape[2] == 0:
            raise ValueError(
                "curve must have coefficients of shape (k, pieces, dof), got "
                f"{curve.c.shape}; one joint needs values of shape (N, 1)"
            )
        coefficients = _validate.real_array("the curve's coefficients", curve.c)
        knots = _validate.real_array("the curve's knots", curve.x)
        if np.any(np.diff(knots) <= 0):
            raise ValueError("the curve's knots must increase")
        width = np.diff(knots)
        powers = width[:, None] ** np.arange(len(coefficients))[::-1, None, None]
        size = (np.abs(coefficients) * powers).max(axis=(0, 1))
        ends = self._horner(np.arange(len(width)), width, 0)
        jump = np.abs(ends[:, :-1] - coefficients[-1, 1:].T).T
        bad = np.flatnonzero((jump > 1e-9 * size + 1e-300).any(axis=1))
        if len(bad):
            raise ValueError(
                f"the curve must be continuous: at s = {knots[bad[0] + 1]:g} it jumps by "
                f"{jump[bad[0]].max():.3g}"
            )

    @classmethod
    def through(
        cls,
        waypoints: Any,
        *,
        kind: str = "cubic",
        bc_type: Any = "not-a-knot",
        s: Any = None,
        wrap: Any = None,
        blend: float | None = None,
    ) -> Path:
        """Return the path through waypoints.

        Parameters
        ----------
        waypoints : array, shape (dof, N), N >= 2
            Positions, one point in each column; consecutive ones may be equal, and those that
            repeat the one before to within 1e-8 of the path's extent count as equal. A straight
            piece between equal waypoints takes no time. A cubic spline leaves and returns to a
            point that it visits twice at different s.
        kind : str
            "cubic": a spline with two continuous derivatives. "linear": straight pieces, with
            a stop at each waypoint where the direction changes.
        bc_type : str or 2-tuple
            End conditions of the spline, as in ``scipy.interpolate.CubicSpline``.
        s : array, shape (N,), increasing, optional
            Path parameter at the waypoints; uniform on [0, 1] by default.
        wrap : bool or float, or array of these, shape (dof,), optional
            True for a joint on a circle, or the length of its turn if that is not 2 pi: each
            waypoint is then moved by whole turns to be the short way from the one before.
            Left out: no joint is, with a warning where the angles look as if one were.
        blend : float > 0, optional
            Round the corners of the straight pieces, with continuous curvature, so that no stop
            is needed: the largest Euclidean distance of the path from the polyline, and of the
            polyline from the path. s is then the part of the polyline's length. A corner that
            turns straight back stays a stop.

        Returns
        -------
        Path

        Raises
        ------
        TypeError, ValueError
            Fewer than two waypoints, or an argument of the wrong shape or value.

        Examples
        --------
        >>> Path.through([[0.0, 3.0]], s=[0.0, 2.0])(1.0)
        array([1.5])
        >>> corner = [[0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]
        >>> rounded = Path.through(corner, kind="linear", blend=0.05)
        >>> float(np.linalg.norm(rounded(0.5) - [1.0, 0.0]).round(12))
        0.05
        """
        points = _validate.real_array("waypoints", waypoints)
        if points.ndim != 2 or points.shape[0] == 0 or points.shape[1] < 2:
            raise ValueError(
                "waypoints must have shape (dof, N) with at least two waypoints, one in each "
                f"column; got {points.shape}"
            )
        points = unwrapped(points, wrap)
        _validate.choice("kind", kind, _KINDS)
        dof, count = points.shape
        _require_columns("s", np.shape(s), (count,), points)
        if blend is not None:
            blend = _validate.positive("blend", blend)
            if kind != "linear" or s is not None:
                raise ValueError(
                    "blend rounds the corners of straight pieces, along which s is their length: "
                    f'give it with kind="linear" and without s, got kind={kind!r}, s={s}'
                )
            return cls(blended_polyline(points, blend), _end=points[:, -1].copy())
        knots = np.linspace(0, 1, count) if s is None else _validate.real_array("s", s, (count,))
        if np.any(np.diff(knots) <= 0):
            raise ValueError(f"s must increase from waypoint to waypoint, got {knots}")
        end, marks = points[:, -1].copy(), knots
        if kind == "linear":
            points = _repeats_made_exact(points)
            slopes = (np.diff(points) / np.diff(knots)).T
            curve = scipy.interpolate.PPoly(np.stack([slopes, points[:, :-1].T]), knots)
        else:
            if not isinstance(bc_type, str):
                for condition in bc_type:
                    if not isinstance(condition, str):
                        vector = np.shape(condition[1])
                        _require_columns("a vector in bc_type", vector, (dof,), points)
            kept = _distinct(points, knots)
            knots = knots[kept]
            curve = scipy.interpolate.CubicSpline(knots, points[:, kept], axis=1, bc_type=bc_type)
            curve = scipy.interpolate.PPoly(np.moveaxis(curve.c, -1, 2).copy(), knots)
        return cls(curve, _end=end, _waypoints=marks)

    def __repr__(self) -> str:
        pieces = len(self.curve.x) - 1
        ends = f"s from {self.s_start:g} to {self.s_end:g}"
        return f"Path(dof={self.dof}, {pieces} piece{'s' if pieces > 1 else ''}, {ends})"

    @property
    def waypoints(self) -> int:
        """Number of the waypoints it was made through; 0 for a curve given as such."""
        return 0 if self._waypoints is None else len(self._waypoints)

    @property
    def waypoint_s(self) -> np.ndarray:
        """Path parameter at the waypoints, or at the knots of a curve given as such, (N,)."""
        return np.asarray(self.curve.x if self._waypoints is None else self._waypoints)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self.curve.c.shape[2])

    @property
    def s_start(self) -> float:
        """First value of the path parameter."""
        return float(self.curve.x[0])

    @property
    def s_end(self) -> float:
        """Last value of the path parameter."""
        return float(self.curve.x[-1])

    def __call__(self, s: Any, derivative: int = 0) -> np.ndarray:
        """Return the position, or a derivative of it with respect to s.

        Parameters
        ----------
        s : float or array, shape (N,)
            Between s_start and s_end.
        derivative : int >= 0
            At a knot where the derivative jumps: the one to the right.

        Returns
        -------
        array, shape (dof,) or (dof, N)

        Raises
        ------
        TypeError, ValueError
            s is not one or more numbers on the path.
        """
        s = _validate.real_array("s", s)
        _validate.integer("derivative", derivative)
        if s.ndim > 1 or np.any((s < self.s_start) | (s > self.s_end)):
            raise ValueError(
                f"s must be a number or a vector within [{self.s_start:g}, {self.s_end:g}], got {s}"
            )
        knots = self.curve.x
        piece = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
        value = self._horner(np.atleast_1d(piece), np.atleast_1d(s - knots[piece]), derivative)
        if derivative == 0 and self._end is not None:
            value[:, np.atleast_1d(s) == self.s_end] = self._end[:, None]
        return value if s.ndim else value[:, 0]

    def _horner(self, piece: np.ndarray, offset: np.ndarray, derivative: int) -> np.ndarray:
        """Return the derivative at offsets from the left knots of pieces, (dof, N)."""
        return horner(self.curve.c, piece, offset, derivative).T


def _piecewise(curve: Any) -> scipy.interpolate.PPoly:
    """Return a curve of SciPy as a piecewise polynomial; anything else is refused."""
    if isinstance(curve, scipy.interpolate.BSpline):
        knots = np.unique(curve.t[curve.k : len(curve.t) - curve.k])
        values = [curve(knots[:-1], m) / math.factorial(m) for m in range(curve.k + 1)]
        c = np.stack([np.moveaxis(value, curve.axis, 0) for value in values[::-1]])
        return scipy.interpolate.PPoly(c, knots)
    if isinstance(curve, scipy.interpolate.BPoly):
        return scipy.interpolate.PPoly.from_bernstein_basis(curve)
    if not isinstance(curve, scipy.interpolate.PPoly):
        raise TypeError(
            "curve must be a piecewise polynomial of scipy.interpolate: a PPoly, for instance a "
            f"CubicSpline, a BSpline or a BPoly; got {type(curve).__name__}. For waypoints use "
            "Path.through"
        )
    return curve


def _require_columns(
    name: str, shape: tuple[int, ...], wanted: tuple[int], points: np.ndarray
) -> None:
    """Explain a length that fits the other axis of the waypoints."""
    dof, count = points.shape
    if dof != count and shape == (count if wanted == (dof,) else dof,):
        raise ValueError(
            f"{name} must have shape {wanted}, got {shape}: waypoints of shape {points.shape} are "
            f"{count} points of {dof} joints, one in each column. If each row is a point, pass "
            "waypoints.T"
        )


def _near(points: np.ndarray) -> np.ndarray:
    """Return for each waypoint the first one that it repeats to within rounding, (N,)."""
    close = _SAME * np.ptp(points, axis=1) + 1e-14 * np.abs(points).max(axis=1)
    first = np.arange(points.shape[1])
    for i in np.flatnonzero((np.abs(np.diff(points)) <= close[:, None]).all(axis=0)) + 1:
        if np.all(np.abs(points[:, i] - points[:, first[i - 1]]) <= close):
            first[i] = first[i - 1]
    return first


def _distinct(points: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the indices of the waypoints that a spline can tell apart from the one before.

    Where both the point and its parameter are repeated to within rounding, the curvature of a
    spline through both is rounding divided by the square of their distance.
    """
    first = _near(points)
    same = (first < np.arange(len(knots))) & (knots - knots[first] <= _SAME * np.ptp(knots))
    kept = np.flatnonzero(~same)
    if same[-1] and len(kept) > 1:
        kept[-1] = len(knots) - 1
    return kept


def _repeats_made_exact(points: np.ndarray) -> np.ndarray:
    """Return the waypoints, those that repeat the one before to within rounding made equal."""
    first = _near(points)
    if first[-1] > 0:  # the end is kept
        first[first == first[-1]] = points.shape[1] - 1
    return points[:, first]


def horner(
    coefficients: np.ndarray, piece: np.ndarray, offset: np.ndarray, derivative: int
) -> np.ndarray:
    """Evaluate a derivative of a piecewise polynomial.

    Parameters
    ----------
    coefficients : array, shape (k, pieces, dof)
        As in ``scipy.interpolate.PPoly``.
    piece, offset : array, shape (N,) and (..., N), or an int and a float of NumPy
        The piece, and the distance from its left knot.
    derivative : int >= 0

    Returns
    -------
    array, shape (..., N, dof) or (dof,)
    """
    order = len(coefficients)
    value = np.zeros((*offset.shape, coefficients.shape[2]))
    for i, c in enumerate(coefficients[: max(order - derivative, 0)]):
        power = order - 1 - i
        if i:
            value *= offset[..., None]
        value += math.perm(power, derivative) * c[piece]
    return value
