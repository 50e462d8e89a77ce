"""A car that rolls without slip."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from statebook.models.base import Model


@dataclass(frozen=True)
class DubinsCar(Model):
    """A car's rear axle, steered by its front wheels, without slip.

    x' = v cos(theta), y' = v sin(theta), theta' = (v / L) tan(phi).

    The state is (x, y, theta), the inputs are the speed v and the steering angle phi.

    Parameters
    ----------
    L : float > 0 [m]
        Distance between the axles.

    References
    ----------
    S. M. LaValle, Planning Algorithms, section 13.1.2.1 (the simple car).

    Examples
    --------
    >>> DubinsCar(L=2.0).dynamics([0.0, 0.0, 0.0], [3.0, 0.0])
    array([3., 0., 0.])
    """

    L: float = 1.0
    states: ClassVar[tuple[str, ...]] = ("x", "y", "theta")
    inputs: ClassVar[tuple[str, ...]] = ("v", "phi")

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        theta, (v, phi) = x[2], u
        return v * np.cos(theta), v * np.sin(theta), v / self.L * np.tan(phi)
