"""Swing a torque-limited pendulum up by pumping energy, then catch it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from statebook import _validate
from statebook.controllers.lqr import LQR
from statebook.models import Pendulum


@dataclass(frozen=True)
class SwingUp:
    """Swing-up of a pendulum under a torque limit.

    Until the LQR at the top can catch the pendulum without reaching the limit, the torque
    drives the energy E to that of the top, m g L: u = limit sat(gain (m g L - E) omega).

    Parameters
    ----------
    pendulum : Pendulum
    limit : float > 0 [N m]
        Largest magnitude of the torque.
    gain : float > 0 [1/(W s)]
        How soon the pumping torque saturates.

    Attributes
    ----------
    catch : LQR
        The regulator at the top.

    Raises
    ------
    TypeError, ValueError
        There is no torque, or the friction takes all that the torque can give.

    Notes
    -----
    E' = u omega - damping omega^2: a torque in the direction of motion pumps. At rest at the
    bottom, where the law gives nothing, it starts with the full torque.

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
        if not isinstance(self.pendulum, Pendulum):
            raise TypeError(f"pendulum must be a Pendulum, got {type(self.pendulum).__name__}")
        limit = _validate.positive("limit", self.limit)
        _validate.positive("gain", self.gain)
        # Just below the top the pendulum passes the bottom at omega^2 = 4 g / L.
        fastest = 2 * np.sqrt(self.pendulum.g / self.pendulum.L)
        if limit <= self.pendulum.damping * fastest:
            raise ValueError(
                f"limit must exceed the friction torque {self.pendulum.damping * fastest:.4g} of a"
                f" swing that reaches the top, got {limit:g}"
            )
        catch = LQR(self.pendulum, [np.pi / 2, 0.0], limit=limit, circle=("theta",))
        object.__setattr__(self, "catch", catch)

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (1,) or (1, N)."""
        x = np.asarray(x, dtype=float)
        top = self.pendulum.m * self.pendulum.g * self.pendulum.L
        lack = top - self.pendulum.energy(x)
        # Half of the catching level: the region is invariant for the linear loop alone.
        caught = self.catch.cost_to_go(x) < self.catch.level / 2
        pump = np.clip(self.gain * lack * x[1], -self.limit, self.limit)
        still = (np.abs(x[1]) < 1e-6) & (lack > 0)
        pump = np.where(still, self.limit, pump)
        return np.where(caught, self.catch(x, t), pump[None])
