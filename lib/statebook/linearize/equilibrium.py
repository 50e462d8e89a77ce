"""Pairs (x, u) at which the state stays where it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook.derivatives import step_scale
from statebook.errors import EquilibriumNotFoundError, KinkError
from statebook.linearize.residual import jacobian_of_residual, judge, point, residual_of
from statebook.systems import System, as_system


@dataclass(frozen=True)
class Equilibrium:
    """A pair (x, u) at which the state stays where it is.

    Attributes
    ----------
    x, u : array, shape (n,) and (m,)
    residual : float
        abs(f(x, u)), or abs(f(x, u) - x) in discrete time, over the size of f's terms.
    rank : int
        Rank of the problem: the number of unknowns that the equations determine.
    unknowns : int
        Number of unknowns; more than the rank means that the equilibrium is not isolated.
    """

    x: np.ndarray
    u: np.ndarray
    residual: float
    rank: int
    unknowns: int

    def __repr__(self) -> str:
        x, u = (
            np.array2string(a + 0.0, precision=6, suppress_small=True) for a in (self.x, self.u)
        )
        kind = "isolated" if self.rank == self.unknowns else "not isolated"
        return f"Equilibrium(x={x}, u={u}, {kind}: rank {self.rank} of {self.unknowns} unknowns)"


def find_equilibrium(
    system: Any,
    x_guess: Any,
    u_guess: Any = None,
    *,
    fixed: Sequence[str] | None = None,
) -> Equilibrium:
    """Find an equilibrium near a guess.

    f(x, u) = 0 in continuous time, f(x, u) = x in discrete time.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x_guess : array, shape (n,)
    u_guess : array, shape (m,), optional
        Zeros if omitted.
    fixed : sequence of str, optional
        Labels of the states and inputs that keep the guess's value. By default all inputs;
        an empty sequence leaves everything free.

    Returns
    -------
    Equilibrium

    Raises
    ------
    EquilibriumNotFoundError
        The search ended at a point that is none; the message has it.
    TypeError, ValueError
        A label that the system does not have, a wrong shape, nothing left to solve for.

    Notes
    -----
    Where there are more unknowns than equations, the result is near the guess, not unique.

    Examples
    --------
    >>> import statebook as sb
    >>> find_equilibrium(sb.Pendulum(), [0.1, 0.0], fixed=["theta"]).u.round(3)
    array([9.751])
    """
    system = as_system(system, x_guess, u_guess)
    x, u = point(system, x_guess, u_guess, batch=False)
    labels = (*system.states, *system.inputs)
    if isinstance(fixed, str):
        raise TypeError(f"fixed must be a sequence of labels; write fixed=[{fixed!r}]")
    fixed = system.inputs if fixed is None else tuple(fixed)
    unknown_labels = [label for label in fixed if label not in labels]
    if unknown_labels:
        raise ValueError(f"fixed must hold labels among {labels}, got {unknown_labels[0]!r}")
    free = np.array([i for i, label in enumerate(labels) if label not in fixed], dtype=int)
    if free.size == 0 and system.n:
        raise ValueError("fixed must leave at least one state or input to solve for")
    z = np.concatenate([x, u])

    def residual(unknowns: np.ndarray) -> np.ndarray:
        point = z.copy()
        point[free] = unknowns
        return residual_of(system, point[: system.n], point[system.n :])

    solution = _solve(residual, z[free])
    z[free] = _polish(system, z, free, solution)
    x, u = z[: system.n], z[system.n :]
    size, allowed, scale = judge(system, x, u)
    if size > allowed:
        guess, x_end, u_end = (
            np.array2string(np.asarray(a), precision=4, threshold=8) for a in (x_guess, x, u)
        )
        raise EquilibriumNotFoundError(
            f"no equilibrium found from x_guess = {guess}: the search ended at x = {x_end},"
            f" u = {u_end} with a residual of {size:.3g} against a scale of {scale:.3g};"
            " try another guess or leave more labels out of fixed"
        )
    J = jacobian_of_residual(system, x, u)[:, free] * step_scale(z[free])
    return Equilibrium(x, u, size / scale if size else 0.0, _rank(J), int(free.size))


def _solve(residual: Callable[[np.ndarray], np.ndarray], guess: np.ndarray) -> np.ndarray:
    """Return the least-squares solution of residual(unknowns) = 0."""
    # The search ends where the gradient is small, which must not depend on the unit of f.
    size = np.abs(residual(guess)).max(initial=0.0) or 1.0
    with np.errstate(all="ignore"):
        return scipy.optimize.least_squares(
            lambda unknowns: residual(unknowns) / size,
            guess,
            jac="3-point",
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=10_000,
        ).x


def _polish(system: System, z: np.ndarray, free: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Return unknowns after Newton steps with exact derivatives, as long as they help."""
    best, n = unknowns, system.n
    point = z.copy()
    point[free] = best
    size = np.abs(residual_of(system, point[:n], point[n:])).max(initial=0.0)
    for _ in range(5):
        try:
            J = jacobian_of_residual(system, point[:n], point[n:])[:, free]
            r = residual_of(system, point[:n], point[n:])
            point[free] = best - np.linalg.lstsq(J, r, rcond=1e-10)[0]
            new = np.abs(residual_of(system, point[:n], point[n:])).max(initial=0.0)
        except (KinkError, ValueError):
            break  # the search's result stands
        if new >= size:
            break
        best, size = point[free].copy(), new
    return best


def _rank(J: np.ndarray) -> int:
    """Return the rank of J with rows in units of their own size."""
    rows = np.abs(J).max(axis=1, initial=0.0)
    return int(np.linalg.matrix_rank(J / np.where(rows > 0, rows, 1)[:, None], rtol=1e-8))
