"""What a caller gives as a limit: numbers, arrays, functions of s."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy

from statebook.timescale.curves import fit
from statebook.timescale.path import Path

_CELLS = 64  # a function of s is looked at in at least so many pieces
_DEGREE = 3  # of the polynomials that stand for it
_MISFIT = 1e-4  # part of a bound by which these may be lower
_NEVER = 1e100  # stands for infinity where a row has no other bound
_NO_BOUND = 1e8  # times the largest bound of a row stands for infinity beside finite bounds


class Bounds(NamedTuple):
    """Bounds on R rows: the widest along the path, and how they vary if they do.

    `along` is a piecewise polynomial of s with 2 R columns, the lower bounds first; `loss` the
    part of the bounds that it may be lower.
    """

    lower: np.ndarray
    upper: np.ndarray
    along: Any = None
    loss: float = 0.0


def read_bounds(name: str, value: Any, rows: int, path: Path, around_zero: bool = True) -> Bounds:
    """Read a limit; infinity means none, and magnitudes v stand for the pair (-v, v).

    Parameters
    ----------
    name : str
        The argument's name, for messages.
    value : float, array or callable
        A number; shape (rows,); (rows, 2): lower and upper; (rows, N) or (rows, 2, N): at each of
        the path's N knots, linear in s between them ((N,) for one row); or a function of s that
        returns one of the first three.
    rows : int
    path : Path
    around_zero : bool
        Whether lower < 0 < upper must hold.

    Raises
    ------
    TypeError, ValueError
        It is none of these.
    """
    if callable(value):

        def at(s: np.float64) -> np.ndarray:
            given = _numbers(f"{name}(s)", value(s))
            return _pair(f"{name}(s)", given, rows, around_zero, f" at s = {s:.6g}")

        cells = np.union1d(path.curve.x, np.linspace(path.s_start, path.s_end, _CELLS + 1)[1:-1])
        values = np.array([at(s) for s in (cells[1:] + cells[:-1]) / 2])
        widest, reach = _reach(values)

        def finite(s: np.ndarray) -> np.ndarray:
            return np.clip([at(si) for si in s], -reach, reach)

        found = fit(finite, cells, _DEGREE, _MISFIT, (0,), rough=True)
        error = found.error[0]
        found.curve.c[-1] += np.repeat([1.0, -1.0], rows) * error
        loss = 2 * float((error / np.maximum(np.abs(found.curve.c[-1]), error)).max())
        return Bounds(widest[:rows], widest[rows:], found.curve, loss)
    given, knots = _numbers(name, value), path.waypoint_s
    count = len(knots)
    if given.shape == (count,) and rows == 1 != count:
        given = given[None]
    if given.shape not in ((rows, 2), (rows, count), (rows, 2, count)) or given.shape == (rows, 2):
        pair = _pair(
            name, given, rows, around_zero, "", f", ({rows}, {count}), ({rows}, 2, {count})"
        )
        return Bounds(pair[:rows], pair[rows:])
    values = np.array(
        [_pair(name, given[..., i], rows, around_zero, f" at waypoint {i}") for i in range(count)]
    )
    widest, reach = _reach(values)
    values = np.clip(values, -reach, reach)
    slopes = np.diff(values, axis=0) / np.diff(knots)[:, None]
    along = scipy.interpolate.PPoly(np.stack([slopes, values[:-1]]), knots)
    return Bounds(widest[:rows], widest[rows:], along)


def _reach(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the widest of bounds (N, 2 rows), and finite sizes that are as good as infinity.

    A column that is infinite all along stays so in the first.
    """
    rows = values.shape[1] // 2
    widest = np.concatenate([values[:, :rows].min(axis=0), values[:, rows:].max(axis=0)])
    finite = np.isfinite(values)
    largest = np.where(finite, np.abs(values), 0.0).max(axis=0)
    bounded = finite.any(axis=0)
    reach = np.where(bounded, _NO_BOUND * largest, _NEVER)
    return np.where(bounded, np.clip(widest, -reach, reach), widest), reach


def _numbers(name: str, value: Any) -> np.ndarray:
    """Return a copy of real numbers without NaN."""
    given = np.array(value)
    if given.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be made of real numbers, got {value!r}")
    if np.isnan(given).any():
        raise ValueError(f"{name} must not be NaN, got {value!r}")
    return given.astype(float)


def _pair(
    name: str, given: np.ndarray, rows: int, around_zero: bool, place: str, shapes: str = ""
) -> np.ndarray:
    """Return lower bounds, then upper ones, (2 rows,)."""
    if given.shape not in ((), (rows,), (rows, 2)):
        raise ValueError(
            f"{name} must be a number, or have shape ({rows},) or ({rows}, 2){shapes}; got "
            f"{given.shape}"
        )
    if np.any(given < 0) if given.ndim == 1 else given.ndim == 0 and given <= 0:
        raise ValueError(
            f"{name} must be greater than 0, or pairs (lower, upper), got {given}{place}"
        )
    lower, upper = (-given, given) if given.ndim < 2 else given.T
    lower, upper = np.broadcast_to(lower, rows), np.broadcast_to(upper, rows)
    for bad, rule in (
        (lower > upper, "lower <= upper"),
        ((lower > 0) | (upper < 0), "lower <= 0 <= upper, or no motion can begin and end"),
    )[: 1 + around_zero]:
        if bad.any():
            j = int(np.flatnonzero(bad)[0])
            raise ValueError(
                f"{name} must have {rule}; got ({lower[j]:g}, {upper[j]:g}) for row {j}{place}"
            )
    return np.concatenate([lower, upper])


def require_joints(name: str, value: Any, path: Path) -> None:
    """Explain limits for as many joints as the path has waypoints."""
    length, count = np.shape(value)[:1], path.waypoints
    if length == (count,) and count not in (0, path.dof) and path.dof > 1:
        raise ValueError(
            f"{name} is given for {count} joints, but the path has {path.dof} joints and {count} "
            "waypoints: Path.through takes one waypoint in each column; if each row is one, pass "
            "waypoints.T"
        )
