"""The workbook's physical systems, one frozen dataclass each.

States are positions, then velocities. Angles are counter-clockwise from the +x axis:
a pendulum hangs at -pi/2 and stands at +pi/2. Units are SI. Every ``dynamics(x, u)``
takes one state (n,) or a batch (n, N), real or complex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from statebook import _validate

if TYPE_CHECKING:
    import control


class _Model:
    """What all models share: checked parameters, checked arguments, conversion."""

    states: ClassVar[tuple[str, ...]]
    inputs: ClassVar[tuple[str, ...]]
    linear: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            may_vanish = field.name in ("damping", "g")
            check = _validate.non_negative if may_vanish else _validate.positive
            self._set(field.name, check(field.name, getattr(self, field.name)))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)  # how a frozen dataclass normalizes a field

    def _arguments(self, x: Any, u: Any = None) -> tuple[np.ndarray, np.ndarray]:
        return _validate.state_and_input(x, u, len(self.states), len(self.inputs))

    def dynamics(self, x: Any, u: Any = None) -> np.ndarray:
        """Evaluate x' = f(x, u).

        Parameters
        ----------
        x : array, shape (n,) or (n, N)
        u : array, shape (m,) or (m, N), optional
            Zeros if omitted.

        Returns
        -------
        array, shape (n,) or (n, N)

        Raises
        ------
        TypeError, ValueError
            x or u is not made of finite numbers, or has another shape.
        """
        x, u = self._arguments(x, u)
        rows = self._derivative(x, u)
        return np.stack([row + np.zeros(x.shape[1:]) for row in rows])

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
        """Return the rows of f(x, u); a row that does not depend on x may be one number."""
        raise TypeError(f"{type(self).__name__} has no equations of motion")

    def to_nlsys(self) -> control.NonlinearIOSystem:
        """Convert to a python-control system with the same labels.

        Returns
        -------
        control.NonlinearIOSystem
            Its outputs are its states.

        Examples
        --------
        >>> Pendulum().to_nlsys().state_labels
        ['theta', 'omega']
        """
        import control

        return control.nlsys(
            lambda t, x, u, params: self.dynamics(x, u),
            states=list(self.states),
            inputs=list(self.inputs),
            outputs=list(self.states),
            name=type(self).__name__.lower(),
        )


@dataclass(frozen=True)
class Particle(_Model):
    """A point mass driven by a force, in 1, 2 or 3 dimensions.

    p'' = u / m, with the state (p, v).

    Parameters
    ----------
    m : float > 0 [kg]
        Mass.
    dim : int, 1 to 3
        Dimensions of p; there are 2 dim states and dim inputs.

    References
    ----------
    Newton's second law.

    Examples
    --------
    >>> Particle(m=2.0).dynamics([0.0, 3.0], [8.0])
    array([3., 4.])
    """

    m: float = 1.0
    dim: int = 1
    linear: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._set("m", _validate.positive("m", self.m))
        if _validate.integer("dim", self.dim, 1) > 3:
            raise ValueError(f"dim must be 1, 2 or 3, got {self.dim}")

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Positions, then velocities."""
        return (*self._numbered("p"), *self._numbered("v"))

    @property
    def inputs(self) -> tuple[str, ...]:  # type: ignore[override]
        """One force a dimension."""
        return self._numbered("force")

    def _numbered(self, label: str) -> tuple[str, ...]:
        return (label,) if self.dim == 1 else tuple(f"{label}{i + 1}" for i in range(self.dim))

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
        return [*x[self.dim :], *(u / self.m)]

    def energy(self, x: Any) -> np.ndarray:
        """Return the kinetic energy ``m |v|^2 / 2`` [J], shape () or (N,)."""
        x, _ = self._arguments(x)
        return self.m / 2 * (x[self.dim :] ** 2).sum(axis=0)


@dataclass(frozen=True)
class Oscillator(_Model):
    """A mass on a spring and a damper, driven by a force.

    m p'' = u - stiffness p - damping p', with the state (p, v).

    Parameters
    ----------
    m : float > 0 [kg]
    stiffness : float > 0 [N/m]
    damping : float >= 0 [N s/m]

    References
    ----------
    Newton's second law with Hooke's law.

    Examples
    --------
    >>> Oscillator(m=1.0, stiffness=10.0, damping=1.0).dynamics([1.0, 0.5])
    array([  0.5, -10.5])
    """

    m: float = 1.0
    stiffness: float = 1.0
    damping: float = 0.0
    states: ClassVar[tuple[str, ...]] = ("p", "v")
    inputs: ClassVar[tuple[str, ...]] = ("force",)
    linear: ClassVar[bool] = True

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
        p, v = x
        return v, (u[0] - self.stiffness * p - self.damping * v) / self.m

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and elastic energy [J], shape () or (N,)."""
        (p, v), _ = self._arguments(x)
        return self.m * v**2 / 2 + self.stiffness * p**2 / 2


@dataclass(frozen=True)
class Pendulum(_Model):
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

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
        theta, omega = x
        torque = u[0] - self.m * self.g * self.L * np.cos(theta) - self.damping * omega
        return omega, torque / (self.m * self.L**2)

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and potential energy [J], zero at rest on the x axis."""
        (theta, omega), _ = self._arguments(x)
        return self.m * self.L**2 * omega**2 / 2 + self.m * self.g * self.L * np.sin(theta)


@dataclass(frozen=True)
class CartPole(_Model):
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

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
        _, theta, v, omega = x
        sine, cosine = np.sin(theta), np.cos(theta)
        h = self.m_pole * self.L / 2
        total, inertia = self.m_cart + self.m_pole, self.m_pole * self.L**2 / 4
        # The mass matrix is [[total, -h sine], [-h sine, inertia]]; d is its determinant.
        d = self.m_cart * inertia + (h * cosine) ** 2
        force = u[0] + h * omega**2 * cosine
        torque = u[1] - h * self.g * cosine
        return (
            v,
            omega,
            (inertia * force + h * sine * torque) / d,
            (h * sine * force + total * torque) / d,
        )

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and potential energy [J], zero at rest with a level pole."""
        (_, theta, v, omega), _ = self._arguments(x)
        h = self.m_pole * self.L / 2
        kinetic = (
            (self.m_cart + self.m_pole) * v**2 / 2
            - h * np.sin(theta) * v * omega
            + self.m_pole * self.L**2 / 4 * omega**2 / 2
        )
        return kinetic + h * self.g * np.sin(theta)


@dataclass(frozen=True)
class DubinsCar(_Model):
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

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
        theta, (v, phi) = x[2], u
        return v * np.cos(theta), v * np.sin(theta), v / self.L * np.tan(phi)


@dataclass(frozen=True)
class PlanarArm(_Model):
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
            self._set(name, tuple(_validate.positive(f"{name}[{i}]", pair[i]) for i in (0, 1)))
        self._set("g", _validate.non_negative("g", self.g))

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
        return (
            -coriolis * (2 * v[0] + v[1]) * v[1] + (m1 + m2) * self.g * l1 * np.cos(q[0]) + hand,
            coriolis * v[0] ** 2 + hand,
        )

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
        q = _validate.array("q", q)
        if q.ndim not in (1, 2) or q.shape[0] != 2:
            raise ValueError(f"q must have shape (2,) or (2, N), got {q.shape}")
        v, a = _validate.array("qd", qd, q.shape), _validate.array("qdd", qdd, q.shape)
        m11, m12, m22 = self._mass_matrix(q[1])
        b1, b2 = self._bias(q, v)
        return np.stack([m11 * a[0] + m12 * a[1] + b1, m12 * a[0] + m22 * a[1] + b2])

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> Sequence[np.ndarray]:
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
        q = _validate.array("q", q)
        if q.ndim not in (1, 2) or q.shape[0] != 2:
            raise ValueError(f"q must have shape (2,) or (2, N), got {q.shape}")
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
