"""The tool's motion along a path, from a caller's forward kinematics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook import _validate
from statebook.probes import takes_batches
from statebook.timescale.bounds import read_bounds
from statebook.timescale.curves import Fit, fit
from statebook.timescale.limits import (
    AccelerationLimit,
    AccelerationNormLimit,
    Limit,
    SpeedLimit,
    VelocityLimit,
)
from statebook.timescale.path import Path

_DEGREE = 7  # of the polynomials that stand for the tool's position
_TOLERANCE = 1e-7  # part of its derivatives by which these may miss them
_STILL = 1e-6  # a tool that moves by less than this part of its distance from 0 is held
_SMOOTH = 0.05  # a fit worse than this is no fit


def tool_limits(path: Path, speed: Any, acceleration: Any, kinematics: Any) -> list[Limit]:
    """Make limits of a tool's speed and acceleration along a path.

    The tool's position is fitted by polynomials of s, whose derivatives are the tool's to an
    error that is known; the limits leave room for it, and the audit counts it.

    Parameters
    ----------
    path : Path
    speed, acceleration : float, array or callable, optional
        See `read_bounds`. What holds for one row, a number for instance, bounds the Euclidean
        norm, everything else the axes one by one.
    kinematics : callable
        q -> (m,), or (dof, N) -> (m, N).

    Raises
    ------
    TypeError, ValueError
        The function is none of this kind, or not smooth along the path; limits without it, or
        the other way round.
    """
    if (speed is None and acceleration is None) != (kinematics is None):
        raise ValueError(
            "forward_kinematics and tool_speed or tool_acceleration must be given together"
        )
    if kinematics is None:
        return []
    found = _fit_tool(path, kinematics, (1,) if acceleration is None else (1, 2))
    axes = found.curve.c.shape[2]
    spread = np.ptp(path.curve.x)
    size = np.maximum(found.scale, found.scale[0].max() / [[1.0], [spread]][: len(found.scale)])
    slip = found.error.max(axis=1)
    off = np.divide(slip, size, out=np.zeros_like(slip), where=size > 0).max()
    limits: list[Limit] = []
    for name, value, each, norm in (
        ("tool_speed", speed, VelocityLimit, SpeedLimit),
        ("tool_acceleration", acceleration, AccelerationLimit, AccelerationNormLimit),
    ):
        if value is None:
            continue
        rows = _rows(value, axes, path)
        off_by = np.linalg.norm(slip, axis=1, keepdims=True) if rows == 1 else slip
        bounds = read_bounds(name, value, rows, path)._asdict()
        extra: dict[str, Any] = {"curve": found.curve, "slip": off_by, "margin": 2 * off}
        kind = norm if rows == 1 else each
        limits.append(kind(name.replace("_", " "), **bounds, **extra))
    return limits


def _rows(value: Any, axes: int, path: Path) -> int:
    """Return whether a limit is on the norm (1 row) or on the axes."""
    if callable(value):
        value = value(path.s_start)
    shape = np.shape(value)
    if shape == () or shape[0] == 1:
        return 1
    return axes if len(shape) > 1 or shape[0] == axes else 1


def _fit_tool(path: Path, kinematics: Callable[..., Any], orders: tuple[int, ...]) -> Fit:
    """Fit polynomials of s to the tool's position, for these of its derivatives."""
    if not callable(kinematics):
        raise TypeError(f"forward_kinematics must be a function q -> position, got {kinematics!r}")

    def alone(q: np.ndarray) -> np.ndarray:
        return _validate.real_array(
            "forward_kinematics(q)", np.array(kinematics(q.copy())), (None,)
        )

    s = np.linspace(path.s_start, path.s_end, 9)[1:-1]
    columns = path(s)
    axes = len(alone(columns[:, 0]))
    batched = takes_batches(lambda q: np.array(kinematics(q)), columns, alone=alone, rtol=1e-9)

    def position(s: np.ndarray) -> np.ndarray:
        q = path(np.clip(s, path.s_start, path.s_end))
        if batched:
            return _validate.real_array(
                "forward_kinematics(q)", np.array(kinematics(q)), (axes, q.shape[1])
            ).T
        return np.array([alone(column) for column in q.T])

    found = fit(position, path.curve.x, _DEGREE, _TOLERANCE, orders)
    still = _STILL * np.abs(found.curve.c[-1]).max() / np.ptp(path.curve.x) ** np.array(orders)
    found = found._replace(scale=np.maximum(found.scale, still[:, None]))
    size = max(found.scale[-1].max(), found.scale[0].max() / np.ptp(s) ** (len(orders) - 1), 1e-300)
    off = found.error[-1].max(axis=1) / size
    if off.max() > _SMOOTH:
        first, last = found.curve.x[off.argmax() + np.arange(2)]
        raise ValueError(
            f"forward_kinematics must be smooth, with derivatives up to order {orders[-1]} along "
            f"the path, and without noise; between s = {first:.6g} and {last:.6g} that one is "
            f"known to {off.max():.1g} of its size only"
        )
    return found
