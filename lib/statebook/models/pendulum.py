"""A pendulum with a motor at its pin."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from statebook.models.base import Model


@dataclass(frozen=True)
class Pendulum(Model):
    """A point mass on a massless rod, driven by a torque at the pin.

    m L^2 theta'' = u - m g L cos(theta) - damping theta', with the state (theta, omega).

    Parameters
    ----------
    m : float > 0 [kg]
    L : float > 0 [m]
        Distance from the pin to the mass.
    g : float >= 0 [m/s^2]
    damping : float >= 0 [N m s/rad]

    References
    ----------
    Euler-Lagrange equation of T - V = m L^2 omega^2 / 2 - m g L sin(theta).

    Examples
    --------
    >>> Pendulum(m=2.0, L=0.5).dynamics([0.0, 0.0])
    array([  0. , -19.6])
    """

    m: float = 1.0
    L: float = 1.0
    g: float = 9.8
    damping: float = 0.0
    states: ClassVar[tuple[str, ...]] = ("theta", "omega")
    inputs: ClassVar[tuple[str, ...]] = ("torque",)

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        theta, omega = x
        torque = u[0] - self.m * self.g * self.L * np.cos(theta) - self.damping * omega
        return omega, torque / (self.m * self.L**2)

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and potential energy [J], zero at rest on the x axis."""
        (theta, omega), _ = self._arguments(x)
        return self.m * self.L**2 * omega**2 / 2 + self.m * self.g * self.L * np.sin(theta)
