"""A cart on a rail with a pole hinged to it."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from statebook.models.base import Model


@dataclass(frozen=True)
class CartPole(Model):
    """A cart on a rail with a pole hinged to it.

    The pole is a point mass at L/2 from the pin, so that its inertia about the pin is
    m_pole L^2 / 4; with h = m_pole L / 2,

    (m_cart + m_pole) p'' - h sin(theta) theta'' - h cos(theta) omega^2 = u1,
    -h sin(theta) p'' + (m_pole L^2 / 4) theta'' + h g cos(theta) = u2.

    The state is (p, theta, v, omega), the inputs are the force on the cart and a torque
    on the pole.

    Parameters
    ----------
    m_cart, m_pole : float > 0 [kg]
    L : float > 0 [m]
        Length of the pole; its mass is at half of it.
    g : float >= 0 [m/s^2]

    References
    ----------
    Euler-Lagrange equations; chapter 08 derives them.

    Examples
    --------
    >>> CartPole().dynamics([0.0, 0.0, 0.0, 0.0])
    array([  0. ,   0. ,   0. , -19.6])
    """

    m_cart: float = 1.0
    m_pole: float = 1.0
    L: float = 1.0
    g: float = 9.8
    states: ClassVar[tuple[str, ...]] = ("p", "theta", "v", "omega")
    inputs: ClassVar[tuple[str, ...]] = ("force", "torque")

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        _, theta, v, omega = x
        sine, cosine = np.sin(theta), np.cos(theta)
        h = self.m_pole * self.L / 2
        total, inertia = self.m_cart + self.m_pole, self.m_pole * self.L**2 / 4
        # The mass matrix is [[total, -h sine], [-h sine, inertia]]; d is its determinant.
        d = self.m_cart * inertia + (h * cosine) ** 2
        force = u[0] + h * omega**2 * cosine
        torque = u[1] - h * self.g * cosine
        acceleration = (inertia * force + h * sine * torque) / d
        return v, omega, acceleration, (h * sine * force + total * torque) / d

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and potential energy [J], zero at rest with a level pole."""
        (_, theta, v, omega), _ = self._arguments(x)
        h = self.m_pole * self.L / 2
        sideways = (self.m_cart + self.m_pole) * v**2 / 2 - h * np.sin(theta) * v * omega
        turning = self.m_pole * self.L**2 / 4 * omega**2 / 2
        return sideways + turning + h * self.g * np.sin(theta)
