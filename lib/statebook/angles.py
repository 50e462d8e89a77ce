"""Angles live on a circle: their difference is the short way round."""

from typing import Any

import numpy as np

from statebook import _validate


def wrap_angle(angle: Any) -> np.ndarray:
    """Return the angle in [-pi, pi) that points the same way.

    An angle inside is returned as it is. Others are reduced by multiples of the true 2 pi, as
    sin and cos do it: 1e16 points where sin(1e16) and cos(1e16) say.

    Parameters
    ----------
    angle : array, any shape [rad]
        The imaginary parts of a complex step pass through.

    Returns
    -------
    array, the same shape [rad]

    Raises
    ------
    TypeError, ValueError
        angle is not made of finite numbers: infinity points nowhere.

    Examples
    --------
    >>> wrap_angle([3.0, 1.5 * np.pi, -np.pi]).round(6)
    array([ 3.      , -1.570796, -3.141593])
    """
    angle = _validate.array("angle", angle)
    turned = np.arctan2(np.sin(angle.real), np.cos(angle.real))
    # arctan2 ends at +pi, where the circle begins again.
    turned = np.where(turned < np.pi, turned, -np.pi)
    turned = np.where((angle.real >= -np.pi) & (angle.real < np.pi), angle.real, turned)
    return (turned + 1j * angle.imag if np.iscomplexobj(angle) else turned)[()]
