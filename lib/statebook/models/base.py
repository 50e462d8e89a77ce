"""What all models share: checked parameters, checked arguments, conversion."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from statebook import _validate

if TYPE_CHECKING:
    import control


class Model:
    """What all models share: checked parameters, checked arguments, conversion."""

    states: ClassVar[tuple[str, ...]]
    inputs: ClassVar[tuple[str, ...]]
    linear: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            may_vanish = field.name in ("damping", "g")
            check = _validate.non_negative if may_vanish else _validate.positive
            vars(self)[field.name] = check(field.name, getattr(self, field.name))

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
        return self.rate(*self._arguments(x, u))

    def rate(self, x: np.ndarray, u: np.ndarray, t: float = 0.0) -> np.ndarray:
        """Evaluate x' = f(x, u) for arrays that need no check, as in a simulation.

        Parameters
        ----------
        x : array, shape (n,) or (n, N)
        u : array, shape (m,) or (m, N)
        t : float [s]
            No model depends on it.

        Returns
        -------
        array, shape (n,) or (n, N)

        Examples
        --------
        >>> import statebook as sb
        >>> sb.Particle(m=2.0).rate(np.array([0.0, 1.0]), np.array([3.0]))
        array([1. , 1.5])
        """
        value = np.empty(x.shape, x.dtype if x.dtype is u.dtype else np.result_type(x, u))
        for i, row in enumerate(self._derivative(x, u)):
            value[i] = row
        return value

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, ...]:
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
        >>> import statebook as sb
        >>> sb.Pendulum().to_nlsys().state_labels
        ['theta', 'omega']
        """
        import control

        states, name = list(self.states), type(self).__name__.lower()
        labels = {"states": states, "inputs": list(self.inputs), "outputs": states, "name": name}
        return control.nlsys(lambda t, x, u, params: self.dynamics(x, u), **labels)
