"""A point mass driven by a force."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from statebook import _validate
from statebook.models.base import Model


@dataclass(frozen=True)
class Particle(Model):
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
        vars(self).update(m=_validate.positive("m", self.m))
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

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
        return (*x[self.dim :], *(u / self.m))

    def energy(self, x: Any) -> np.ndarray:
        """Return the kinetic energy ``m |v|^2 / 2`` [J], shape () or (N,)."""
        x, _ = self._arguments(x)
        return self.m / 2 * (x[self.dim :] ** 2).sum(axis=0)
