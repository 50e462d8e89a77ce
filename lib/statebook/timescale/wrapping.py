"""Joints on a circle: which way round a path goes."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

_SHORT = np.pi / 4  # steps of a joint that moves on after a jump of nearly a turn


def unwrapped(points: np.ndarray, wrap: Any) -> np.ndarray:
    """Return waypoints (dof, N) moved by whole turns, each the short way from the one before.

    Parameters
    ----------
    points : array, shape (dof, N)
    wrap : bool or float, or array of these, shape (dof,), or None
        Whether a joint is on a circle; a number is the length of its turn, True 2 pi. None: no
        joint is, with a warning where the angles look as if one were.

    Raises
    ------
    TypeError, ValueError
        wrap is none of these.
    """
    if wrap is None:
        _warn(points)
        return points
    given = np.array(wrap)
    if given.dtype.kind not in "biuf":
        raise TypeError(f"wrap must be made of True, False or lengths of a turn, got {wrap!r}")
    if given.shape not in ((), (len(points),)):
        raise ValueError(
            f"wrap must be one value or have shape ({len(points)},), one for each joint; got "
            f"{given.shape}"
        )
    turn = np.broadcast_to(given * (2 * np.pi if given.dtype.kind == "b" else 1.0), len(points))
    if not np.all(np.isfinite(turn) & (turn >= 0)):
        raise ValueError(f"wrap must be finite and at least 0, got {wrap!r}")
    points = points.copy()
    for joint in np.flatnonzero(turn > 0):
        turns = np.round(np.diff(points[joint]) / turn[joint])
        points[joint, 1:] -= turn[joint] * np.cumsum(turns)
    return points


def _warn(points: np.ndarray) -> None:
    """Warn of joints within [-pi, pi] that jump by nearly a turn and else move in short steps."""
    steps = np.abs(np.diff(points))
    short = np.minimum(steps, np.abs(2 * np.pi - steps))
    turns = (np.abs(points).max(axis=1) <= np.pi) & (steps.max(axis=1) >= 2 * np.pi - _SHORT)
    for joint in np.flatnonzero(turns & (short.max(axis=1) <= _SHORT)):
        step = int(steps[joint].argmax())
        warnings.warn(
            f"joint {joint} turns by {steps[joint, step]:.3g} between waypoints {step} and "
            f"{step + 1}, the long way round; give wrap=True if it is on a circle, or wrap=False "
            "if it is not",
            stacklevel=4,
        )
