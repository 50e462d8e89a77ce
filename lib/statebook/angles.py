"""Angles live on a circle: their difference is the short way round."""

from __future__ import annotations

from typing import Any

import numpy as np


def wrap_angle(angle: Any) -> np.ndarray:
    """Return the angle in [-pi, pi) that points the same way.

    Parameters
    ----------
    angle : array, any shape [rad]

    Returns
    -------
    array, the same shape [rad]

    Examples
    --------
    >>> float(wrap_angle(1.5 * np.pi)) == -0.5 * np.pi
    True
    """
    angle = np.asarray(angle)
    # By the real part, so that a complex step passes through.
    return angle - 2 * np.pi * np.floor((angle.real + np.pi) / (2 * np.pi))
