"""The linear-quadratic regulator at an equilibrium."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from statebook import _validate
from statebook.angles import wrap_angle
from statebook.controllers.arrays import columns, saturate
from statebook.linearize import linearize
from statebook.systems import as_system


@dataclass(frozen=True)
class LQR:
    """Linear-quadratic regulator at an equilibrium.

    u = u0 - K (x - x0), clipped to the limit, with the K that minimizes the integral (in
    discrete time the sum) of dx' Q dx + du' R du.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x0, u0 : array, shape (n,) and (m,)
        The equilibrium; u0 None is zeros.
    Q, R : array, shape (n, n) and (m, m)
        Symmetric weights, Q positive semidefinite, R positive definite.
    limit : float > 0, optional
        Largest magnitude of each input.
    circle : sequence of str
        Labels of states that are angles: their error is the short way round.

    Attributes
    ----------
    K : array, shape (m, n)
    S : array, shape (n, n)
        The cost to go is dx' S dx.
    wrapped : list of int
        Indices of the states in circle.
    level : float
        Below this cost to go no input reaches its limit; inf without a limit.

    Raises
    ------
    NotAnEquilibriumError
        As linearize.
    TypeError, ValueError
        No gain stabilizes, or an argument has the wrong type or shape.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., section 7.5.

    Examples
    --------
    >>> import statebook as sb
    >>> LQR(sb.Particle(), [0, 0], Q=np.diag([1.0, 0.0]), R=[[1.0]]).K.round(6)
    array([[1.      , 1.414214]])
    """

    system: Any
    x0: Any
    u0: Any = None
    Q: Any = None
    R: Any = None
    limit: float | None = None
    circle: Sequence[str] = ()
    K: np.ndarray = field(init=False)
    S: np.ndarray = field(init=False, repr=False)
    wrapped: list[int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        import control

        system = as_system(self.system, self.x0, self.u0)
        n, m = system.n, system.m
        limit = None if self.limit is None else _validate.positive("limit", self.limit)
        weights = [
            np.eye(size) if weight is None else _validate.real_array(name, weight, (size, size))
            for name, weight, size in (("Q", self.Q, n), ("R", self.R, m))
        ]
        absent = [label for label in self.circle if label not in system.states]
        if absent:
            raise ValueError(f"circle must hold labels among {system.states}, got {absent[0]!r}")
        sys = linearize(system, self.x0, self.u0)
        solve = control.dlqr if system.discrete else control.lqr
        try:
            K, S, _ = solve(sys, *weights)
        except (ValueError, np.linalg.LinAlgError, control.ControlArgument) as error:
            raise ValueError(f"no gain stabilizes {system.name} at x0: {error}") from error
        u0 = np.zeros(m) if self.u0 is None else _validate.real_array("u0", self.u0, (m,))
        for name, value in {
            "x0": _validate.real_array("x0", self.x0, (n,)),
            "u0": u0,
            "limit": limit,
            "K": np.asarray(K),
            "S": np.asarray(S),
            "wrapped": [system.states.index(label) for label in self.circle],
        }.items():
            object.__setattr__(self, name, value)

    def error(self, x: Any) -> np.ndarray:
        """Return x - x0 with angles the short way round, shape (n,) or (n, N)."""
        x = np.asarray(x)
        error = x - columns(self.x0, x)
        error[self.wrapped] = wrap_angle(error[self.wrapped])
        return error

    def cost_to_go(self, x: Any) -> np.ndarray:
        """Return dx' S dx, shape () or (N,)."""
        error = self.error(x)
        return np.einsum("i...,ij,j...->...", error, self.S, error)

    @property
    def level(self) -> float:
        """The cost to go below which no input reaches its limit."""
        if self.limit is None:
            return np.inf
        spans = np.einsum("ij,jk,ik->i", self.K, np.linalg.inv(self.S), self.K)
        return float(((self.limit - np.abs(self.u0)) ** 2 / spans).min())

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (m,) or (m, N)."""
        error = self.error(x)
        return saturate(columns(self.u0, error) - self.K @ error, self.limit)
