"""Exact derivatives of f(x, u), and the linear system beside an equilibrium."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook.derivatives import InexactDerivativeWarning, derivative
from statebook.equilibrium import jacobian, point, residual_size
from statebook.errors import NotAnEquilibriumError
from statebook.systems import System, as_system

if TYPE_CHECKING:
    import control


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
    x0, u0 = point(system, x0, u0)
    J, error = jacobian(system, x0, u0)
    if error.any():
        warnings.warn(
            f"{system.name} is not analytic at the point: its derivatives are adaptive"
            f" differences with an estimated error of {error.max():.1g}",
            InexactDerivativeWarning,
            stacklevel=2,
        )
    A, B = J[..., : system.n], J[..., system.n :]
    return (A[0], B[0]) if x0.ndim == u0.ndim == 1 else (A, B)


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
    x0, u0 = point(system, x0, u0, batch=False)
    size, allowed, scale = residual_size(system, x0, u0)
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
