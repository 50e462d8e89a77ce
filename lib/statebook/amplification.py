"""The matrix that one step of a method makes of x' = A x."""

from __future__ import annotations

import numpy as np

from statebook import _validate
from statebook.runge_kutta import SEMI_IMPLICIT_EULER, ButcherTableau, as_tableau


def amplification_matrix(A: np.ndarray, dt: float | np.ndarray, method: str | ButcherTableau):
    """The matrix M of one step x_next = M x of a method on x' = A x.

    ``M = R(dt A)``, the stability function of the method with z replaced by a matrix.
    "semi_implicit_euler" takes the first half of the state for positions q and the second for
    velocities v: ``v_next = v + dt f_v(q, v)``, then ``q_next = q + dt f_q(q, v_next)``.

    Parameters
    ----------
    A : array, shape (..., n, n)
        One matrix or a stack of them.
    dt : float > 0 [s], or array of them
        Step; an array broadcasts against the stack.
    method : str or ButcherTableau
        A name in `METHODS`, "semi_implicit_euler", or a tableau.

    Returns
    -------
    array, shape (..., n, n)
        One-step matrices.

    Raises
    ------
    ValueError
        If A is not square, dt is not positive, n is odd for "semi_implicit_euler", or an
        implicit method has no solution because dt times an eigenvalue is a pole of R.

    Examples
    --------
    >>> amplification_matrix([[0.0, 1.0], [-4.0, 0.0]], 0.5, "semi_implicit_euler").tolist()
    [[0.0, 0.5], [-2.0, 1.0]]
    """
    A = np.asarray(_validate.array("A", A))
    if A.ndim < 2 or A.shape[-1] != A.shape[-2]:
        raise ValueError(f"A must have shape (..., n, n), got {A.shape}")
    dt = np.asarray(_validate.array("dt", dt))
    if np.iscomplexobj(dt) or np.any(dt <= 0):
        raise ValueError(f"dt must be positive, got {dt}")
    Z = dt[..., None, None] * A
    identity = np.broadcast_to(np.eye(A.shape[-1]), Z.shape)
    if method == SEMI_IMPLICIT_EULER:
        half = A.shape[-1] // 2
        if A.shape[-1] % 2:
            raise ValueError(
                f"{SEMI_IMPLICIT_EULER} needs as many positions as velocities, got A {A.shape}"
            )
        kick, drift = identity.copy(), identity.copy()
        kick[..., half:, :] += Z[..., half:, :]
        drift[..., :half, :] += Z[..., :half, :]
        return drift @ kick
    tableau = as_tableau(method)
    top = _matrix_polynomial(tableau.numerator, Z, identity)
    if tableau.explicit:
        return top
    try:
        return np.linalg.solve(_matrix_polynomial(tableau.denominator, Z, identity), top)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"{tableau.name} has no step here: dt times an eigenvalue of A is a pole of R(z); "
            "change dt"
        ) from error


def _matrix_polynomial(coefficients: np.ndarray, Z: np.ndarray, identity: np.ndarray):
    result = coefficients[-1] * identity
    for coefficient in coefficients[-2::-1]:
        result = result @ Z + coefficient * identity
    return result
