"""Checks of covariance matrices: each error names the argument and the property it lacks."""

from __future__ import annotations

from typing import Any

import numpy as np

from statebook import _validate

_ROUNDING = 1e-10  # relative to the largest entry or eigenvalue


def covariance_matrix(name: str, value: Any, size: int | None = None) -> np.ndarray:
    """Return a symmetric, positive semidefinite matrix.

    Parameters
    ----------
    name : str
        The argument's name, for the error message.
    value : float or array, shape (n, n)
        A number is a 1 x 1 matrix.
    size : int, optional
        The required n.

    Returns
    -------
    array, shape (n, n)
        Exactly symmetric.

    Raises
    ------
    TypeError, ValueError
        It is not real, square, of that size, symmetric or positive semidefinite.

    Examples
    --------
    >>> covariance_matrix("Q", 4.0)
    array([[4.]])
    """
    matrix = np.atleast_2d(_validate.real_array(name, value))
    n = len(matrix) if size is None else size
    if matrix.shape != (n, n) or n == 0:
        wanted = "(n, n)" if size is None else f"({n}, {n})"
        raise ValueError(f"{name} must be a covariance of shape {wanted}, got {matrix.shape}")
    if np.abs(matrix - matrix.T).max() > _ROUNDING * np.abs(matrix).max():
        raise ValueError(
            f"{name} must be symmetric, got {matrix.tolist()}; "
            "if rounding made it so, pass (P + P.T) / 2"
        )
    matrix = (matrix + matrix.T) / 2
    eigenvalues = np.linalg.eigvalsh(matrix)
    if eigenvalues[0] < -_ROUNDING * np.abs(eigenvalues).max():
        raise ValueError(
            f"{name} must be positive semidefinite: a variance cannot be negative, "
            f"got the eigenvalue {eigenvalues[0]:.4g}"
        )
    return matrix


def square_root(matrix: np.ndarray) -> np.ndarray:
    """Return the symmetric root S of a covariance, S S = matrix; it may be singular.

    Unlike a factor made of eigenvectors, it has no sign that could differ between machines.

    Parameters
    ----------
    matrix : array, shape (n, n), symmetric and positive semidefinite

    Returns
    -------
    array, shape (n, n)

    Examples
    --------
    >>> square_root(np.array([[4.0, 0.0], [0.0, 0.0]])).tolist()
    [[2.0, 0.0], [0.0, 0.0]]
    """
    values, vectors = np.linalg.eigh(matrix)
    values = np.where(values > _ROUNDING * values[-1], values, 0.0)
    return (vectors * np.sqrt(values)) @ vectors.T
