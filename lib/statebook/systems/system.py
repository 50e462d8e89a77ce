"""A state-space system with labels and a timebase."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from statebook import _validate


@dataclass(frozen=True)
class System:
    """A state-space system with labels and a timebase.

    Attributes
    ----------
    states, inputs : tuple of str
        Labels; their numbers are n and m.
    dt : float, bool or None
        None or 0 is continuous time, True or > 0 [s] discrete, as in python-control.
    linear : bool
        The system declares itself linear in x and u.
    name : str
        A name for messages and figures.
    source : object
        What the system was made from.
    """

    rate: Callable[[Any, Any, float], Any] = field(repr=False)
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    dt: float | bool | None = None
    linear: bool = False
    name: str = "system"
    source: Any = field(default=None, repr=False)
    batched: bool = True

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def discrete(self) -> bool:
        """Whether f is a map from one sample to the next."""
        return self.dt is not None and (self.dt is True or self.dt > 0)

    def dynamics(self, x: Any, u: Any = None, t: float = 0.0) -> np.ndarray:
        """Evaluate f(x, u) at one state or a batch of states.

        Parameters
        ----------
        x : array, shape (n,) or (n, N)
        u : array, shape (m,) or (m, N), optional
            Zeros if omitted.
        t : float [s]
            Time, for a python-control system that depends on it.

        Returns
        -------
        array, shape (n,) or (n, N)

        Raises
        ------
        TypeError, ValueError
            An argument, or what f returned, has the wrong type, shape or is not finite.

        Examples
        --------
        >>> import statebook as sb
        >>> sb.as_system(lambda x: -2 * x, [1.0]).dynamics([3.0])
        array([-6.])
        """
        x, u = _validate.state_and_input(x, u, self.n, self.m)
        if x.ndim > u.ndim:  # one input for all: a function need not know that case
            u = np.repeat(u[:, None], x.shape[1], axis=1)
        if x.ndim == 1 or self.batched:
            return self._check(self.rate(x, u, t), x)
        columns = [self._check(self.rate(*xu, t), xu[0]) for xu in zip(x.T, u.T, strict=True)]
        return np.stack(columns, axis=1) if columns else np.empty(x.shape)

    def probe(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Evaluate f at a batch that may leave its domain.

        Parameters
        ----------
        x, u : array, shape (n, N) and (m, N)

        Returns
        -------
        array, shape (n, N)
            NaN in the columns where f is undefined or raises an arithmetic error.

        Examples
        --------
        >>> import statebook as sb
        >>> sb.as_system(lambda x: 1 / x, [1.0]).probe(np.array([[0.5, 2.0]]), np.empty((0, 2)))
        array([[2. , 0.5]])
        """
        with np.errstate(all="ignore"):
            if self.batched:
                return np.asarray(self.rate(x, u, 0.0))
            columns = []
            for column in zip(x.T, u.T, strict=True):
                try:
                    columns.append(np.asarray(self.rate(*column, 0.0)))
                except (ValueError, ArithmeticError):  # math.sqrt(-1), 1 / 0
                    columns.append(np.full(self.n, np.nan))
            return np.stack(columns, axis=1)

    def _check(self, value: Any, x: np.ndarray) -> np.ndarray:
        try:
            return _validate.array("dynamics(x, u)", value, x.shape)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}, at x = {brief(x)}") from None


def brief(x: np.ndarray) -> str:
    """Return an array in a form short enough for a message."""
    return np.array2string(x, precision=4, threshold=8)
