"""Swing a pendulum, or the pole of a cart, up and catch it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from statebook import _validate
from statebook.angles import wrap_angle
from statebook.controllers.feedback import state_of
from statebook.controllers.lqr import LQR
from statebook.models.cart_pole import CartPole
from statebook.models.pendulum import Pendulum
from statebook.simulation import simulate
from statebook.systems import System
from statebook.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class SwingUp:
    """Swing-up of a pendulum under a torque limit.

    Until the LQR at the top can catch the pendulum without reaching the limit, the torque
    drives the energy E to that of the top, m g L, and what friction takes on the way there:
    u = limit sat(gain (m g L + W - E) omega). W = 4 damping sqrt(g / L) (1 - sin(phi / 2)), phi
    the angle from the bottom in the direction of motion, is the work of friction up to the top
    at the speeds of a swing that ends there.

    Parameters
    ----------
    pendulum : Pendulum
    limit : float > 0 [N m]
        Largest magnitude of the torque.
    gain : float > 0 [1/(W s)]
        How soon the pumping torque saturates: a small one pumps slowly, and against friction
        not up to the top.

    Attributes
    ----------
    catch : LQR
        The regulator at the top.

    Raises
    ------
    TypeError, ValueError
        There is no torque, or the friction takes all that the torque can give before the swing
        reaches the top.

    Notes
    -----
    E' = u omega - damping omega^2: a torque in the direction of motion pumps. In the lowest
    hundredth of the height, where the law gives little, the torque of a start is added, full at
    rest at the bottom. With friction the law is
    tried: from rest at any angle, the next swing must go higher or be caught.

    References
    ----------
    K. J. Astrom and K. Furuta, Swinging up a pendulum by energy control, Automatica 36
    (2000), 287-295.

    Examples
    --------
    >>> swing = SwingUp(Pendulum(), limit=2.0)
    >>> swing([-np.pi / 2, 0.0], 0.0), swing([-np.pi / 2, 1.0], 0.0)
    (array([2.]), array([2.]))
    """

    pendulum: Pendulum
    limit: float
    gain: float = 10.0
    catch: LQR = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _validate.instance("pendulum", self.pendulum, Pendulum)
        limit = _validate.positive("limit", self.limit)
        _validate.positive("gain", self.gain)
        if self.pendulum.g == 0:
            raise ValueError("pendulum must have weight to swing, got g = 0; LQR alone moves it")
        catch = LQR(self.pendulum, [np.pi / 2, 0.0], limit=limit, circle=("theta",))
        vars(self).update(catch=catch)
        if self.pendulum.damping > 0:
            self._require_growth()

    def _require_growth(self) -> None:
        """Try the full torque on the model, at rest at angles from the bottom to the top."""
        pendulum = self.pendulum
        angles = np.linspace(0.0, np.pi, _ANGLES)[1:-1]
        start = np.stack([-np.pi / 2 - angles, 0.0 * angles])
        start = start[:, ~self._caught(start)]
        # No torque within the limit carries a swing higher than the full one.
        duration = 2 * np.pi * _PERIODS * np.sqrt(pendulum.L / pendulum.g)
        run = simulate(pendulum, start, [self.limit], duration=duration, rtol=1e-7)
        before, after = -np.pi / 2 - start[0], (run.states[0] + np.pi / 2).max(axis=1)
        if np.any(after <= before):
            ends = before[np.argmax(after <= before)]
            raise ValueError(
                f"limit must be larger, got {self.limit:g}: a swing under the full torque grows to"
                f" {ends:.3g} of the {np.pi:.3g} rad from the bottom to the top, then friction"
                " takes all that the torque gives"
            )

    def _caught(self, x: np.ndarray) -> np.ndarray:
        # Half of the catching level: the region is invariant for the linear loop alone.
        return self.catch.cost_to_go(x) < self.catch.level / 2

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (1,) or (1, N)."""
        x, pendulum = state_of(x, 2), self.pendulum
        ahead = wrap_angle(x[0] + np.pi / 2) * np.sign(x[1])
        friction = 4 * pendulum.damping * np.sqrt(pendulum.g / pendulum.L) * (1 - np.sin(ahead / 2))
        weight, energy = pendulum.m * pendulum.g * pendulum.L, pendulum.energy(x)
        pump = self.gain * (weight - energy + friction) * x[1]
        # A jump at rest alone would chatter: the start fades with the height, and pushes on.
        start = np.maximum(0.0, 1 - (weight + energy) / (2 * weight * _START))
        pump += np.where(x[1] < 0, -self.limit, self.limit) * start
        pump = np.clip(pump, -self.limit, self.limit)
        return np.where(self._caught(x), self.catch(x, t), pump[None])


_SETTLING = 8.0  # [s] after the switch, in which the trial must come to rest
_SETTLED = 0.01  # [rad], [rad/s]
_SAMPLES = 401
_ANGLES = 62  # the bottom and the top among them
_START = 0.01  # of the height of the top, below which the torque starts the swing
_PERIODS = 2  # of small swings: within them the longest of these half swings ends


def cart_force(cartpole: CartPole, x: Any, acceleration: Any) -> np.ndarray:
    """Find the force that gives a cart an acceleration.

    The accelerations are affine in the force, p'' = f(x, 0) + (f(x, 1) - f(x, 0)) u; without
    torque at the pin the pole then moves as its pin does.

    Parameters
    ----------
    cartpole : CartPole
    x : array, shape (4,) or (4, N)
    acceleration : float or array, shape (N,) [m/s^2]
        Wanted p''.

    Returns
    -------
    array, shape () or (N,) [N]

    Raises
    ------
    TypeError, ValueError
        An argument has the wrong type or shape.

    References
    ----------
    M. W. Spong, The swing up control problem for the acrobot, IEEE Control Systems Magazine
    15 (1995), 49-55 (collocated partial feedback linearization).

    Examples
    --------
    >>> cart_force(CartPole(m_cart=2.0, m_pole=1.0), [0.0, -np.pi / 2, 0.0, 0.0], 3.0).round(9)
    np.float64(6.0)
    """
    _validate.instance("cartpole", cartpole, CartPole)
    idle = cartpole.dynamics(x, [0.0, 0.0])[2]
    acceleration = _validate.array("acceleration", acceleration)
    if acceleration.shape not in ((), (1,), idle.shape):
        raise ValueError(
            f"acceleration must be a number or have shape {idle.shape}, got {acceleration.shape}"
        )
    return (acceleration - idle) / (cartpole.dynamics(x, [1.0, 0.0])[2] - idle)


def _without_torque(cartpole: CartPole, x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
    return cartpole.dynamics(x, np.stack([u[0], 0.0 * u[0]]))


@dataclass(frozen=True, eq=False)
class CartPoleSwingUp:
    """Swing a pole up by a planned motion of its cart, then catch it.

    Before the switch the force is that of the plan, p'' = acceleration(t), clipped to the
    limit; from then on an LQR holds the pole up with the cart at the target. The plan is
    tried on the model before it is accepted.

    Parameters
    ----------
    cartpole : CartPole
    acceleration : callable
        Planned p'' [m/s^2] as a function of time [s].
    switch : float > 0 [s]
        Time at which the LQR takes over.
    limit : float > 0 [N]
        Largest magnitude of the force.
    track : (float, float) [m]
        Ends of the track, increasing.
    start : float [m]
        Where the cart is when the plan begins, on the track; the pole hangs at rest.
    target : float, optional [m]
        Where the cart stays in the end, on the track; its middle if omitted.
    Q, R : array, shape (4, 4) and (1, 1), optional
        Weights of the LQR.

    Attributes
    ----------
    catch : LQR
        The regulator at the top; its one input is the force.
    trial : Trajectory
        The run on the model that showed that the plan works.

    Raises
    ------
    DivergenceError
        The trial leaves the finite numbers.
    TypeError, ValueError
        The plan needs more force or more track than there is, or the pole is not caught
        within 8 s.

    Examples
    --------
    >>> omega = 2 * np.pi / 1.52
    >>> def plan(t):
    ...     return omega**2 / 2 * np.cos(omega * t) if t < 1.5 * 1.52 else 0.0
    >>> swing = CartPoleSwingUp(CartPole(), plan, 2.0, limit=40.0, track=(-0.5, 2.5))
    >>> swing.trial.states[1, -1].round(2)  # upright
    np.float64(1.57)
    """

    cartpole: CartPole
    acceleration: Callable[[float], float]
    switch: float
    limit: float
    track: tuple[float, float]
    start: float = 0.0
    target: float | None = None
    Q: Any = None
    R: Any = None
    catch: LQR = field(init=False, repr=False)
    trial: Trajectory = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _validate.instance("cartpole", self.cartpole, CartPole)
        if not callable(self.acceleration):
            raise TypeError(f"acceleration must be a function of time, got {self.acceleration!r}")
        _validate.positive("switch", self.switch)
        _validate.positive("limit", self.limit)
        low, high = _validate.interval("track", self.track)
        target = (low + high) / 2 if self.target is None else self.target
        for name, place in (("start", self.start), ("target", target)):
            if not low <= _validate.number(name, place) <= high:
                raise ValueError(
                    f"{name} must be on the track [{low:g}, {high:g}] m, got {place:g} m"
                )
        rate, name = partial(_without_torque, self.cartpole), "cartpole without torque"
        system = System(rate, CartPole.states, CartPole.inputs[:1], name=name)
        at_top = [target, np.pi / 2, 0.0, 0.0]
        catch = LQR(system, at_top, Q=self.Q, R=self.R, limit=self.limit, circle=("theta",))
        vars(self).update(catch=catch)
        vars(self).update(trial=self._try())

    def _try(self) -> Trajectory:
        hanging = [self.start, -np.pi / 2, 0.0, 0.0]
        plan, catch = (np.linspace(0.0, end, _SAMPLES) for end in (self.switch, _SETTLING))
        times = np.concatenate([plan, self.switch + catch[1:]])

        def law(x: np.ndarray, t: float) -> np.ndarray:
            return self._planned(x, t) if t < self.switch else self(x, t)

        run = simulate(self.cartpole, hanging, law, times=times, switches=[self.switch])
        swing = run.states[:, :_SAMPLES]
        needed = max(abs(self._planned(*xt)[0]) for xt in zip(swing.T, plan.tolist(), strict=True))
        if needed > self.limit:
            raise ValueError(f"the plan needs {needed:.4g} N, the limit is {self.limit:g} N")
        self._require_track("the plan", swing[0])
        _, angle, _, rate = self.catch.error(run.states[:, -1])
        if max(abs(angle), abs(rate)) > _SETTLED:
            raise ValueError(
                f"the pole is not caught: {_SETTLING:g} s after the switch it is {angle:.3g} rad "
                f"from upright at {rate:.3g} rad/s; switch at another time or allow more force"
            )
        # Of a pole that is lost the cart's way says nothing: it runs after it, ever farther.
        self._require_track("the catch", run.states[0])
        return run

    def _require_track(self, name: str, places: np.ndarray) -> None:
        low, high = self.track
        lowest, highest = places.min(), places.max()
        if lowest < low or highest > high:
            raise ValueError(
                f"{name} takes the cart over [{lowest:.4g}, {highest:.4g}] m, "
                f"the track is [{low:g}, {high:g}] m"
            )

    def _planned(self, x: np.ndarray, t: float) -> np.ndarray:
        force = cart_force(self.cartpole, x, self.acceleration(t))
        return np.stack([force, 0.0 * force])

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t) = (force, 0), shape (2,) or (2, N)."""
        x = np.asarray(x, dtype=float)
        if t < self.switch:
            return np.clip(self._planned(x, t), -self.limit, self.limit)
        force = self.catch(x, t)[0]
        return np.stack([force, 0.0 * force])
