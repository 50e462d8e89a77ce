"""A mass on a spring and a damper."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from statebook.models.base import Model


@dataclass(frozen=True)
class Oscillator(Model):
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

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        p, v = x
        return v, (u[0] - self.stiffness * p - self.damping * v) / self.m

    def energy(self, x: Any) -> np.ndarray:
        """Return kinetic and elastic energy [J], shape () or (N,)."""
        (p, v), _ = self._arguments(x)
        return self.m * v**2 / 2 + self.stiffness * p**2 / 2
