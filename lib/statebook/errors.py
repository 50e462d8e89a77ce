"""The failures a caller may want to catch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from statebook.trajectory import Trajectory


class _Kept:
    """Errors that keep their attributes when they are pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).__new__, (type(self), *self.args), self.__dict__  # type: ignore


class NotAnEquilibriumError(ValueError):
    """The point of linearization does not stay where it is."""


class EquilibriumNotFoundError(RuntimeError):
    """The search for an equilibrium ended without one."""


class KinkError(ValueError):
    """The function has no derivative at the point."""


class DivergenceError(_Kept, RuntimeError):
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
        self, message: str, *, time: float, state: np.ndarray, trajectory: Trajectory | None = None
    ) -> None:
        super().__init__(message)
        self.time = time
        self.state = state
        self.trajectory = trajectory


class InfeasiblePathError(_Kept, ValueError):
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


def outside_domain(error: Exception) -> bool:
    """Whether a function raised because a number is outside its domain: 1 / 0, math.sqrt(-1).

    NumPy returns inf or NaN there; Python's numbers and ``math`` raise.
    """
    of_math = isinstance(error, ValueError) and str(error).startswith(("math ", "expected a "))
    return of_math or isinstance(error, ArithmeticError)
