"""Limits as a caller gives them: a number, one per row, or pairs."""

from __future__ import annotations

from typing import Any

import numpy as np

from statebook import _validate
from statebook.timescale.limits import AccelerationLimit, Limit, SpeedLimit, VelocityLimit


def bounds(name: str, value: Any, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Read a limit given as a number, (rows,) or (rows, 2); infinity means none.

    A number or a vector of magnitudes stands for -value and value.
    """
    given = np.asarray(value)
    if given.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be made of real numbers, got {value!r}")
    if given.shape not in ((), (rows,), (rows, 2)):
        raise ValueError(
            f"{name} must be a number, or have shape ({rows},) or ({rows}, 2), got {given.shape}"
        )
    given = given.astype(float)
    if np.isnan(given).any():
        raise ValueError(f"{name} must not be NaN, got {value!r}")
    if given.ndim == 2:
        lower, upper = given[:, 0].copy(), given[:, 1].copy()
        if np.any(lower > upper):
            row = int(np.flatnonzero(lower > upper)[0])
            raise ValueError(
                f"{name} must have lower <= upper, got ({lower[row]:g}, {upper[row]:g}) for "
                f"joint {row}"
            )
        return lower, upper
    upper = np.broadcast_to(given, rows).copy()
    if np.any(upper <= 0):
        raise ValueError(f"{name} must be greater than 0, or pairs (lower, upper), got {value!r}")
    return -upper, upper


def joint_bounds(name: str, value: Any, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """Read a velocity or acceleration limit: the bounds must enclose 0."""
    lower, upper = bounds(name, value, dof)
    bad = np.flatnonzero((lower >= 0) | (upper <= 0))
    if len(bad):
        j = int(bad[0])
        raise ValueError(
            f"{name} must have lower < 0 < upper, or no motion can begin and end; got "
            f"({lower[j]:g}, {upper[j]:g}) for joint {j}"
        )
    return lower, upper


def kinematic_limits(velocity: Any, acceleration: Any, speed: Any, dof: int) -> list[Limit]:
    """Read the limits that need no dynamics."""
    limits: list[Limit] = []
    if velocity is not None:
        limits.append(VelocityLimit("velocity", *joint_bounds("velocity", velocity, dof)))
    if acceleration is not None:
        pair = joint_bounds("acceleration", acceleration, dof)
        limits.append(AccelerationLimit("acceleration", *pair))
    if speed is not None:
        bound = np.array([_validate.positive("speed", speed)])
        limits.append(SpeedLimit("speed", -bound, bound))
    return limits
