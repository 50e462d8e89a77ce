"""A caller's inverse dynamics: its shape found out, its form checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook.probes import takes_batches
from statebook.timescale.bounds import MISFIT, read_bounds
from statebook.timescale.friction import DRAG_LOSS, friction_form
from statebook.timescale.limits import TorqueLimit
from statebook.timescale.path import Path

_SAMPLES = 5
_FORM = 1e-7  # part of the motion's torques by which the form may be missed


def torque_limit(path: Path, torque: Any, inverse_dynamics: Any) -> TorqueLimit:
    """Check an inverse dynamics along a path and make a limit of it.

    Parameters
    ----------
    path : Path
    torque : number or array, shape (rows,) or (rows, 2)
        Bounds; an infinite one is none, and they need not enclose 0.
    inverse_dynamics : callable
        (q, qd, qdd) -> (rows,), and (rows, N) for a batch if it can.

    Raises
    ------
    TypeError, ValueError
        It is no function of this kind: not affine in qdd, not quadratic in qd, not finite.
    """
    if not callable(inverse_dynamics):
        raise TypeError(
            "inverse_dynamics must be a function (q, qd, qdd) -> torques where torque is given, "
            f"got {inverse_dynamics!r}"
        )
    s = np.linspace(path.s_start, path.s_end, _SAMPLES + 2)[1:-1]
    q, slope = path(s), path(s, 1)
    rows = _rows(inverse_dynamics, q[:, 0])
    dynamics = _vectorized(inverse_dynamics, q, slope, rows)
    lower, upper, along = read_bounds("torque", torque, rows, path, around_zero=False)
    _check_form(dynamics, q, slope)
    friction = friction_form(dynamics, q, slope)
    loss = (MISFIT if callable(torque) else 0.0) + (DRAG_LOSS if friction[1] else 0.0)
    return TorqueLimit("torque", lower, upper, dynamics, friction, along=along, loss=loss)


def _rows(function: Callable[..., Any], q: np.ndarray) -> int:
    """Return the number of rows of the function's values."""
    value = np.array(function(q, np.zeros_like(q), np.zeros_like(q)))
    if value.ndim != 1 or value.dtype.kind not in "iuf":
        raise ValueError(
            "inverse_dynamics must return a real vector (rows,) for q, qd, qdd of shape (dof,); "
            f"got shape {value.shape} of {value.dtype}"
        )
    return len(value)


def _vectorized(
    function: Callable[..., Any], q: np.ndarray, slope: np.ndarray, rows: int
) -> Callable[..., Any]:
    """Return the function for batches: itself if its batches agree with its single values."""

    def one_by_one(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return np.array(
            # Copied at once: it may be the function's own buffer.
            [np.array(function(q[:, i], qd[:, i], qdd[:, i])) for i in range(q.shape[1])],
            dtype=float,
        ).T.reshape(rows, q.shape[1])

    def finite(values: np.ndarray, q: np.ndarray) -> np.ndarray:
        bad = ~np.isfinite(values).all(axis=0)
        if bad.any():
            at = q[:, np.flatnonzero(bad)[0]]
            raise ValueError(
                f"inverse_dynamics must return finite torques; it does not at q = {at}"
            )
        return values

    if takes_batches(function, q, slope, slope[::-1], alone=function, rtol=1e-9):
        return lambda q, qd, qdd: finite(np.array(function(q, qd, qdd), dtype=float), q)
    return lambda q, qd, qdd: finite(one_by_one(q, qd, qdd), q)


def _check_form(dynamics: Callable[..., Any], q: np.ndarray, slope: np.ndarray) -> None:
    """Refuse what is not affine in qdd with a matrix free of qd."""
    size = np.abs(q).max() + np.abs(slope).max()
    still = np.zeros_like(q)
    static = dynamics(q, still, still)
    rounding = 1e-12 * np.abs(static).max() + 1e-300
    direction = slope / max(np.abs(slope).max(), 1e-300) + 0.1 * np.cos(np.arange(q.size)).reshape(
        q.shape
    )
    for scale in size * np.array([1e-3, 1.0, 1e3]):
        v = scale * direction
        forward = dynamics(q, v, still) - static
        once, both = dynamics(q, still, v) - static, dynamics(q, v, v) - static
        twice = dynamics(q, still, 2 * v) - static
        tolerance = _FORM * (np.abs(once).max() + np.abs(forward).max()) + rounding
        if max(np.abs(twice - 2 * once).max(), np.abs(both - once - forward).max()) > tolerance:
            raise ValueError("inverse_dynamics must be affine in qdd, with a matrix free of qd")
