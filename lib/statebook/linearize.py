"""Equilibria and exact linearization of any system."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from statebook import _validate
from statebook.derivatives import InexactDerivativeWarning, derivative, step_scale
from statebook.errors import EquilibriumNotFoundError, KinkError, NotAnEquilibriumError
from statebook.systems import System, as_system

if TYPE_CHECKING:
    import control

_TOLERANCE = 1e-8  # of a residual, against the size of f's terms
_ROUNDING = 1e-12


def jacobians(f: Any, x0: Any, u0: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate f(x, u) with respect to x and u.

    A = d f / d x, B = d f / d u, by complex step where f is analytic, which is checked.
    Elsewhere by adaptive differences, with a warning that gives the error.

    Parameters
    ----------
    f : system
        Whatever as_system takes.
    x0 : array, shape (n,) or (n, N)
        The point, any point: it need not be an equilibrium.
    u0 : array, shape (m,) or (m, N), optional
        Zeros if omitted.

    Returns
    -------
    A : array, shape (n, n) or (N, n, n)
    B : array, shape (n, m) or (N, n, m)

    Raises
    ------
    KinkError
        f has no derivative at the point.
    TypeError, ValueError
        x0, u0 or what f returns has the wrong type or shape, or is not finite.

    Warns
    -----
    InexactDerivativeWarning
        f is not analytic, so that adaptive differences were used.

    Examples
    --------
    >>> A, B = jacobians(lambda x, u: [x[1], u[0] - 3 * x[0]], [0, 0], [0])
    >>> A
    array([[ 0.,  1.],
           [-3.,  0.]])
    """
    system = as_system(f, x0, u0)
    x0, u0 = _point(system, x0, u0)
    J, error = _jacobian(system, x0, u0)
    if error.any():
        warnings.warn(
            f"{system.name} is not analytic at the point: its derivatives are adaptive"
            f" differences with an estimated error of {error.max():.1g}",
            InexactDerivativeWarning,
            stacklevel=2,
        )
    A, B = J[..., : system.n], J[..., system.n :]
    return (A[0], B[0]) if x0.ndim == u0.ndim == 1 else (A, B)


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
    x, u = _point(system, x_guess, u_guess, batch=False)
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
        return _residual(system, point[: system.n], point[system.n :])

    solution = _solve(residual, z[free])
    z[free] = _polish(system, z, free, solution)
    x, u = z[: system.n], z[system.n :]
    size, allowed, scale = _judge(system, x, u)
    if size > allowed:
        guess, x_end, u_end = (
            np.array2string(np.asarray(a), precision=4, threshold=8) for a in (x_guess, x, u)
        )
        raise EquilibriumNotFoundError(
            f"no equilibrium found from x_guess = {guess}: the search ended at x = {x_end},"
            f" u = {u_end} with a residual of {size:.3g} against a scale of {scale:.3g};"
            " try another guess or leave more labels out of fixed"
        )
    J = _jacobian_of_residual(system, x, u)[:, free] * step_scale(z[free])
    return Equilibrium(x, u, size / scale if size else 0.0, _rank(J), int(free.size))


def linearize(system: Any, x0: Any, u0: Any = None) -> control.StateSpace:
    """Linearize a system at an equilibrium.

    d x' = A d x + B d u with the exact Jacobians of f at (x0, u0), and likewise for the
    outputs of a python-control system; those of others are their states.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x0 : array, shape (n,)
    u0 : array, shape (m,), optional
        Zeros if omitted.

    Returns
    -------
    control.StateSpace
        With the labels and the timebase of the system, named after it. One without inputs
        gets an input "none" of no effect: python-control has no systems without inputs.

    Raises
    ------
    NotAnEquilibriumError
        f(x0, u0) is not 0 (or not x0, in discrete time).
    KinkError
        f has no derivative at the point.
    TypeError, ValueError
        x0 or u0 has the wrong type or shape, or is not finite.

    References
    ----------
    H. K. Khalil, Nonlinear Systems, 3rd ed., section 4.3.

    Examples
    --------
    >>> import statebook as sb
    >>> linearize(sb.Pendulum(g=9.8), [sb.pi / 2, 0]).A
    array([[0. , 1. ],
           [9.8, 0. ]])
    """
    import control

    system = as_system(system, x0, u0)
    x0, u0 = _point(system, x0, u0, batch=False)
    size, allowed, scale = _judge(system, x0, u0)
    if size > allowed:
        raise NotAnEquilibriumError(
            f"x0 is not an equilibrium: |f(x0, u0){' - x0' if system.discrete else ''}| ="
            f" {size:.3g} against a scale of {scale:.3g}; call find_equilibrium first, or use"
            " jacobians for the affine model"
        )
    A, B = jacobians(system, x0, u0)
    outputs, C, D = _output_map(system, x0, u0)
    inputs = list(system.inputs)
    if not inputs:
        inputs, B, D = ["none"], np.zeros((system.n, 1)), np.zeros((len(outputs), 1))
    labels = {"states": list(system.states), "inputs": inputs, "outputs": outputs}
    return control.ss(A, B, C, D, system.dt, **labels, name=f"{system.name}_linearized")


def _output_map(
    system: System, x0: np.ndarray, u0: np.ndarray
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the labels of the outputs and their derivatives C and D."""
    sys = system.source
    if not hasattr(sys, "output_labels"):
        return list(system.states), np.eye(system.n), np.zeros((system.n, system.m))

    def evaluate(z: np.ndarray) -> np.ndarray:
        columns = [sys.output(0.0, c[: system.n], c[system.n :]) for c in z.T]
        return np.stack([np.asarray(y) for y in columns], axis=1)

    J, _ = derivative(evaluate, np.concatenate([x0, u0])[:, None])
    return list(sys.output_labels), J[0][:, : system.n], J[0][:, system.n :]


def _point(
    system: System, x0: Any, u0: Any, *, batch: bool = True
) -> tuple[np.ndarray, np.ndarray]:
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


def _jacobian(system: System, x0: np.ndarray, u0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative with respect to (x, u), (N, n, n + m), and its error."""
    system.dynamics(x0, u0 if u0.ndim <= x0.ndim else u0[:, 0])  # reports what is wrong with f
    x, u = (a[:, None] if a.ndim == 1 else a for a in (x0, u0))
    N = max(x.shape[1], u.shape[1])
    z = np.concatenate([np.repeat(a, N // a.shape[1], axis=1) for a in (x, u)])
    return derivative(lambda z: system.probe(z[: system.n], z[system.n :]), z)


def _residual(system: System, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return system.dynamics(x, u) - (x if system.discrete else 0.0)


def _jacobian_of_residual(system: System, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    J = _jacobian(system, x, u)[0][0]
    return J - np.eye(*J.shape) if system.discrete else J


def _judge(system: System, x: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """Return the residual of the worst row, what is allowed there, and the size of its terms.

    The terms of row i are J_ij z_j, and what f_i reaches at displaced points. The former
    allow a residual; of the latter only the rounding, as far away terms may be large. Both
    scale with the units of f_i.
    """
    residual = np.abs(_residual(system, x, u))
    if not residual.any():
        return 0.0, 0.0, 0.0
    z = np.concatenate([x, u])
    # What is rounding beside the other components is a zero that was computed.
    negligible = np.abs(z) <= _ROUNDING * np.abs(z).max()
    displaced = z[:, None] + np.diag(np.where(negligible, 1.0, 0.1 * np.abs(z)))
    values = np.abs(system.probe(displaced[: system.n], displaced[system.n :]))
    reach = np.nan_to_num(values, posinf=0.0).max(axis=1, initial=0.0)
    terms = np.abs(_jacobian_of_residual(system, x, u)) @ np.abs(z)
    allowed = _TOLERANCE * terms + _ROUNDING * reach
    worst = np.argmax(np.where(residual > 0, residual / np.maximum(allowed, 1e-300), 0.0))
    return float(residual[worst]), float(allowed[worst]), float(max(terms[worst], reach[worst]))


def _solve(residual: Any, guess: np.ndarray) -> np.ndarray:
    """Return the least-squares solution of residual(unknowns) = 0."""
    with np.errstate(all="ignore"):
        return scipy.optimize.least_squares(
            residual, guess, jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15
        ).x


def _polish(system: System, z: np.ndarray, free: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Return unknowns after Newton steps with exact derivatives, as long as they help."""
    best, n = unknowns, system.n
    point = z.copy()
    point[free] = best
    size = np.abs(_residual(system, point[:n], point[n:])).max(initial=0.0)
    for _ in range(5):
        try:
            J = _jacobian_of_residual(system, point[:n], point[n:])[:, free]
            r = _residual(system, point[:n], point[n:])
            point[free] = best - np.linalg.lstsq(J, r, rcond=1e-10)[0]
            new = np.abs(_residual(system, point[:n], point[n:])).max(initial=0.0)
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
