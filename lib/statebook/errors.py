"""The failures a caller may want to catch."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from statebook.trajectory import Trajectory


class NotAnEquilibriumError(ValueError):
    """The point of linearization does not stay where it is."""


class EquilibriumNotFoundError(RuntimeError):
    """The search for an equilibrium ended without one."""


class KinkError(ValueError):
    """The function has no derivative at the point."""


class DivergenceError(RuntimeError):
    """A simulation left the finite numbers, or could go no further.

    Attributes
    ----------
    time : float [s]
        The last time reached.
    state : array, shape (n,) or (n, N)
        The state there.
    trajectory : Trajectory or None
        What was computed until then.
    """

    def __init__(
        self,
        message: str,
        *,
        time: float,
        state: np.ndarray,
        trajectory: Trajectory | None = None,
    ) -> None:
        super().__init__(message)
        self.time = time
        self.state = state
        self.trajectory = trajectory

    def __reduce__(self) -> tuple[Any, ...]:
        # The way of BaseException, the message alone, would not survive a pool of processes.
        rebuild = partial(type(self), time=self.time, state=self.state)
        return rebuild, self.args, self.__dict__


class InfeasiblePathError(ValueError):
    """No timing of the path satisfies the limits.

    Attributes
    ----------
    constraint : str
        The limit that cannot be met.
    s : float
        The path parameter where it cannot.
    """

    def __init__(self, message: str, *, constraint: str, s: float) -> None:
        super().__init__(message)
        self.constraint = constraint
        self.s = s

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), constraint=self.constraint, s=self.s), self.args, self.__dict__
