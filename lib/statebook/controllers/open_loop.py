"""Controls that are planned in advance."""

import numpy as np

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory


def bang_bang(distance: float, *, m: float = 1.0, force: float = 1.0) -> ControlTrajectory:
    """Plan the fastest rest-to-rest move of a particle.

    Full force for half of the time, full braking for the other half; the move takes
    2 sqrt(m abs(distance) / force).

    Parameters
    ----------
    distance : float, not 0 [m]
        Signed.
    m : float > 0 [kg]
    force : float > 0 [N]
        Largest magnitude of the force.

    Returns
    -------
    ControlTrajectory

    Raises
    ------
    TypeError, ValueError
        There is nowhere to go, or nothing to go with: no force moves nothing.

    References
    ----------
    A. E. Bryson and Y.-C. Ho, Applied Optimal Control, section 3.9.

    Examples
    --------
    >>> bang_bang(2.0, m=3.0, force=6.0).breakpoints
    array([0., 1., 2.])
    """
    distance = _validate.number("distance", distance)
    if distance == 0:
        raise ValueError("distance must not be 0: the particle is there already")
    m, force = _validate.positive("m", m), _validate.positive("force", force)
    half = np.sqrt(m * abs(distance) / force)
    push = np.copysign(force, distance)
    return ControlTrajectory.piecewise_constant([0, half, 2 * half], [push, -push])
