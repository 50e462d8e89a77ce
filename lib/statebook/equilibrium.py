"""Pairs (x, u) at which the state stays where it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.derivatives import derivative, step_scale
from statebook.errors import EquilibriumNotFoundError, KinkError
from statebook.systems import System, as_system

TOLERANCE = 1e-8  # of a residual, against the size of f's terms
ROUNDING = 1e-12


def point(system: System, x0: Any, u0: Any, *, batch: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return x0 and u0 as checked real arrays; u0 None is zeros."""
    x0 = _validate.real_array("x0", x0)
    u0 = np.zeros(system.m) if u0 is None else _validate.real_array("u0", u0)
    for name, value, rows in (("x0", x0, system.n), ("u0", u0, system.m)):
        if value.ndim not in ((1, 2) if batch else (1,)) or value.shape[0] != rows:
            also = f" or ({rows}, N)" if batch else ""
            raise ValueError(f"{name} must have shape ({rows},){also}, got {value.shape}")
    if x0.ndim == u0.ndim == 2 and x0.shape[1] != u0.shape[1]:
        raise ValueError(f"x0 and u0 must agree in N, got {x0.shape} and {u0.shape}")
    return x0, u0


def jacobian(system: System, x0: np.ndarray, u0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative with respect to (x, u), (N, n, n + m), and its error."""
    system.dynamics(x0, u0 if u0.ndim <= x0.ndim else u0[:, 0])  # reports what is wrong with f
    x, u = (a[:, None] if a.ndim == 1 else a for a in (x0, u0))
    N = max(x.shape[1], u.shape[1])
    z = np.concatenate([np.repeat(a, N // a.shape[1], axis=1) for a in (x, u)])
    return derivative(lambda z: system.probe(z[: system.n], z[system.n :]), z)


def residual_of(system: System, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return system.dynamics(x, u) - (x if system.discrete else 0.0)


def jacobian_of_residual(system: System, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    J = jacobian(system, x, u)[0][0]
    return J - np.eye(*J.shape) if system.discrete else J


def residual_size(system: System, x: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """Return the residual of the worst row, what is allowed there, and the size of its terms.

    The terms of row i are J_ij z_j, and what f_i reaches at displaced points. The former
    allow a residual; of the latter only the rounding, as far away terms may be large. Both
    scale with the units of f_i.
    """
    residual = np.abs(residual_of(system, x, u))
    if not residual.any():
        return 0.0, 0.0, 0.0
    z = np.concatenate([x, u])
    # What is rounding beside the other components is a zero that was computed.
    negligible = np.abs(z) <= ROUNDING * np.abs(z).max()
    displaced = z[:, None] + np.diag(np.where(negligible, 1.0, 0.1 * np.abs(z)))
    values = np.abs(system.probe(displaced[: system.n], displaced[system.n :]))
    reach = np.nan_to_num(values, posinf=0.0).max(axis=1, initial=0.0)
    terms = np.abs(jacobian_of_residual(system, x, u)) @ np.abs(z)
    allowed = TOLERANCE * terms + ROUNDING * reach
    worst = np.argmax(np.where(residual > 0, residual / np.maximum(allowed, 1e-300), 0.0))
    return float(residual[worst]), float(allowed[worst]), float(max(terms[worst], reach[worst]))


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
    size, allowed, scale = residual_size(system, x, u)
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
