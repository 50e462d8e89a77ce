"""Exact derivatives of f(x, u) at any point."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from statebook.derivatives import InexactDerivativeWarning
from statebook.linearize.residual import jacobian, point
from statebook.systems import as_system


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
