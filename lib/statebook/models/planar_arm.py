"""An arm of two links in a vertical plane."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from statebook import _validate
from statebook.models.base import Model


@dataclass(frozen=True)
class PlanarArm(Model):
    """Two links in a vertical plane with masses at their ends.

    M(q) q'' + c(q, q') + g(q) = u. The first angle is from the +x axis, the second from
    the first link, both counter-clockwise. The state is (q1, q2, v1, v2), the inputs are
    the joint torques.

    Parameters
    ----------
    lengths : (float, float) > 0 [m]
    masses : (float, float) > 0 [kg]
        At the elbow and at the hand.
    g : float >= 0 [m/s^2]
        0 for an arm in a horizontal plane.

    References
    ----------
    R. M. Murray, Z. Li, S. S. Sastry, A Mathematical Introduction to Robotic
    Manipulation, section 4.2.3, with all mass at the link ends.

    Examples
    --------
    >>> arm = PlanarArm(lengths=(1.0, 1.0), masses=(1.0, 1.0), g=10.0)
    >>> arm.inverse_dynamics([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    array([30., 10.])
    """

    lengths: tuple[float, float] = (1.0, 1.0)
    masses: tuple[float, float] = (1.0, 1.0)
    g: float = 9.8
    states: ClassVar[tuple[str, ...]] = ("q1", "q2", "v1", "v2")
    inputs: ClassVar[tuple[str, ...]] = ("torque1", "torque2")

    def __post_init__(self) -> None:
        for name in ("lengths", "masses"):
            pair = getattr(self, name)
            if np.shape(pair) != (2,):
                raise ValueError(f"{name} must be two numbers, got {pair!r}")
            vars(self)[name] = tuple(_validate.positive(f"{name}[{i}]", pair[i]) for i in (0, 1))
        vars(self).update(g=_validate.non_negative("g", self.g))

    def _mass_matrix(self, q2: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return M11, M12 = M21 and M22."""
        (l1, l2), (m1, m2) = self.lengths, self.masses
        cross = m2 * (l2**2 + l1 * l2 * np.cos(q2))
        return m1 * l1**2 + m2 * l1**2 + 2 * cross - m2 * l2**2, cross, m2 * l2**2

    def _bias(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the torques c + g that the motion and gravity need without acceleration."""
        (l1, l2), (m1, m2) = self.lengths, self.masses
        coriolis = m2 * l1 * l2 * np.sin(q[1])
        hand = m2 * self.g * l2 * np.cos(q[0] + q[1])
        elbow = -coriolis * (2 * v[0] + v[1]) * v[1] + (m1 + m2) * self.g * l1 * np.cos(q[0])
        return elbow + hand, coriolis * v[0] ** 2 + hand

    def inverse_dynamics(self, q: Any, qd: Any, qdd: Any) -> np.ndarray:
        """Return the torques that give the joints an acceleration.

        Parameters
        ----------
        q, qd, qdd : array, shape (2,) or (2, N) [rad, rad/s, rad/s^2]

        Returns
        -------
        array, shape (2,) or (2, N) [N m]

        Raises
        ------
        TypeError, ValueError
            An argument is not made of finite numbers, or has another shape than q.
        """
        q = _validate.vectors("q", q, 2)
        v, a = _validate.array("qd", qd, q.shape), _validate.array("qdd", qdd, q.shape)
        m11, m12, m22 = self._mass_matrix(q[1])
        b1, b2 = self._bias(q, v)
        return np.stack([m11 * a[0] + m12 * a[1] + b1, m12 * a[0] + m22 * a[1] + b2])

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        q, v = x[:2], x[2:]
        m11, m12, m22 = self._mass_matrix(q[1])
        b1, b2 = self._bias(q, v)
        t1, t2 = u[0] - b1, u[1] - b2
        d = m11 * m22 - m12**2
        return v[0], v[1], (m22 * t1 - m12 * t2) / d, (m11 * t2 - m12 * t1) / d

    def positions(self, q: Any) -> np.ndarray:
        """Return where elbow and hand are.

        Parameters
        ----------
        q : array, shape (2,) or (2, N) [rad]

        Returns
        -------
        array, shape (2, 2) or (2, 2, N) [m]
            First index: elbow, hand; second: x, y.

        Examples
        --------
        >>> PlanarArm(lengths=(2.0, 1.0)).positions([0.0, 0.0])
        array([[2., 0.],
               [3., 0.]])
        """
        q = _validate.vectors("q", q, 2)
        l1, l2 = self.lengths
        elbow = l1 * np.stack([np.cos(q[0]), np.sin(q[0])])
        forearm = l2 * np.stack([np.cos(q[0] + q[1]), np.sin(q[0] + q[1])])
        return np.stack([elbow, elbow + forearm])

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and potential energy [J], zero at rest stretched along +x."""
        x, _ = self._arguments(x)
        m11, m12, m22 = self._mass_matrix(x[1])
        kinetic = m11 * x[2] ** 2 / 2 + m12 * x[2] * x[3] + m22 * x[3] ** 2 / 2
        heights = self.positions(x[:2])[:, 1]
        return kinetic + self.g * (self.masses[0] * heights[0] + self.masses[1] * heights[1])
