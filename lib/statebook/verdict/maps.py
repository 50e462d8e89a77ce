"""Eigenvalues over grids of parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook import _validate


def eigenvalue_map(function: Callable[..., Any], *grids: Any) -> np.ndarray:
    """Eigenvalues of a matrix that depends on parameters.

    Parameters
    ----------
    function : callable
        ``function(*parameters)``, called with one array per grid, all of the shape of the
        whole grid; it returns matrices of shape (\\*grid shape, n, n). It is called once, and
        once more, on a small grid, where sizes agree so that axes could be confused.
    *grids : array, shape (N,)
        Values of each parameter, one after another in the result's axes ("ij" order).

    Returns
    -------
    array, shape (\\*grid shape, n), complex
        Eigenvalues in the order of `sort_eigenvalues`: decreasing real part, then decreasing
        imaginary part.

    Raises
    ------
    TypeError, ValueError
        If a grid is not a vector, or the function's result has the wrong shape, its axes in
        a wrong order, or is not finite.

    Examples
    --------
    >>> def oscillator(k, c):
    ...     A = np.zeros((*k.shape, 2, 2))
    ...     A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1, -k, -c
    ...     return A
    >>> eigenvalue_map(oscillator, [1.0, 4.0], [0.0]).imag.round(9).tolist()
    [[[1.0, -1.0]], [[2.0, -2.0]]]
    """
    if not grids:
        raise ValueError("grids: at least one vector of parameter values is required, got none")
    vectors = [_validate.array(f"grid {k}", grid, (None,)) for k, grid in enumerate(grids)]
    parameters = np.meshgrid(*vectors, indexing="ij")
    shape = parameters[0].shape
    matrices = _validate.array("function's result", function(*parameters))
    if matrices.shape[:-2] != shape or matrices.shape[-1] != matrices.shape[-2]:
        raise ValueError(_wrong_shape(shape, matrices.shape))
    axes = (*shape, matrices.shape[-1])
    if len(set(axes)) < len(axes) and matrices.size:
        _require_order(function, vectors, matrices.shape[-1])
    return sort_eigenvalues(np.linalg.eigvals(matrices))


def _wrong_shape(shape: tuple[int, ...], got: tuple[int, ...]) -> str:
    wanted = f"{(*shape, 'n', 'n')}".replace("'n'", "n")
    return (
        f"function must return matrices of shape {wanted}, got {got};"
        " fill A[..., i, j] of an array np.zeros((*parameter.shape, n, n))"
    )


def _require_order(function: Callable[..., Any], vectors: list[np.ndarray], n: int) -> None:
    """Refuse axes in a wrong order, which go unseen where sizes agree: on a grid of others."""
    sizes = range(n + 1, n + 1 + len(vectors))
    small = [np.resize(v, size) for v, size in zip(vectors, sizes, strict=True)]
    try:
        got = np.shape(function(*np.meshgrid(*small, indexing="ij")))
    except Exception:  # it may know its own grid only, and then cannot be asked
        return
    if got != (*sizes, n, n) and sorted(got) == sorted((*sizes, n, n)):
        raise ValueError(_wrong_shape(tuple(sizes), got))


def sort_eigenvalues(eigenvalues: np.ndarray) -> np.ndarray:
    """Sort along the last axis by decreasing real part, then imaginary part.

    Real parts that agree to 1e-9 of the largest eigenvalue count as equal, so that rounding
    does not shuffle conjugate pairs.
    """
    return np.take_along_axis(eigenvalues, sorting(eigenvalues), axis=-1).astype(complex)


def sorting(eigenvalues: np.ndarray) -> np.ndarray:
    """Indices that sort eigenvalues along the last axis."""
    scale = np.abs(eigenvalues).max(axis=-1, keepdims=True, initial=0.0)
    real = np.zeros(eigenvalues.shape)
    np.divide(eigenvalues.real, scale, out=real, where=scale > 0)
    return np.lexsort((-eigenvalues.imag, -np.round(real, 9)), axis=-1)
