"""Eigenvalues over grids of parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from statebook import _validate
from statebook.verdict.followed import Followed, Sample
from statebook.verdict.words import sort_eigenvalues


def eigenvalue_map(
    function: Any,
    *grids: Any,
    x0: Any = None,
    u0: Any = None,
    dt: float | bool | None = None,
    t: float | None = None,
    trim: Mapping[str, Any] | None = None,
) -> np.ndarray:
    """Eigenvalues of a matrix or a model that depends on parameters.

    Parameters
    ----------
    function : callable, or a model beside a mapping
        ``function(*parameters)``, called with one array per grid, all of the shape of the
        whole grid; it returns matrices of shape (\\*grid shape, n, n). It is called once, and
        once more, on a small grid, where sizes agree so that axes could be confused.
    *grids : array, shape (N,)
        Values of each parameter, one after another in the result's axes ("ij" order). Or one
        mapping of a model's parameters to their values, as `eigenvalue_locus` takes it, one
        parameter or more; the model is then linearized at its equilibrium at each point.
    x0, u0, dt, t, trim
        Of a model, as `eigenvalue_locus` takes them: the equilibrium at the first point, from
        which the others are found, each from its neighbour.

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
    >>> import statebook as sb
    >>> eigenvalue_map(sb.Pendulum(g=9.0), {"L": [1.0, 4.0]}, x0=[-sb.pi / 2, 0]).imag.round(9)
    array([[ 3. , -3. ],
           [ 1.5, -1.5]])
    """
    if len(grids) == 1 and isinstance(grids[0], Mapping):
        return _of_model(Followed(function, tuple(grids[0]), x0, u0, dt, t, trim), grids[0])
    if any(given is not None for given in (x0, u0, dt, t, trim)):
        raise TypeError('x0, u0, dt, t and trim belong to a model: map {"parameter": values}')
    if not callable(function):
        raise TypeError(f"function must be callable, got {type(function).__name__}")
    if not grids:
        raise ValueError("grids: at least one vector of parameter values is required, got none")
    vectors = [_validate.array(f"grid {k}", grid, (None,)) for k, grid in enumerate(grids)]
    parameters = np.meshgrid(*vectors, indexing="ij")
    shape = parameters[0].shape
    matrices = _validate.array("function's result", function(*parameters))
    if matrices.shape[:-2] != shape or matrices.shape[-1] != matrices.shape[-2]:
        raise ValueError(_wrong_shape(shape, matrices.shape))
    if len({*shape, matrices.shape[-1]}) <= len(shape) and matrices.size:
        _require_order(function, vectors, matrices.shape[-1])
    return sort_eigenvalues(np.linalg.eigvals(matrices))


def _of_model(followed: Followed, grid: Mapping[str, Any]) -> np.ndarray:
    """Return the eigenvalues of a model, following its equilibrium from point to point."""
    vectors = [_validate.array(f"grid[{n!r}]", v, (None,)).tolist() for n, v in grid.items()]
    shape = tuple(map(len, vectors))
    if not all(shape):
        raise ValueError(f"grid must hold at least one value of each parameter, got {dict(grid)}")
    found: dict[tuple[int, ...], Sample] = {}
    for index in np.ndindex(shape):
        moved = max((axis for axis, i in enumerate(index) if i), default=0)
        beside = tuple(i - (axis == moved) for axis, i in enumerate(index))
        values = {name: v[i] for name, v, i in zip(grid, vectors, index, strict=True)}
        found[index] = followed.at(values, found.get(beside))
    followed.warn()
    eigenvalues = np.stack([sample.eigenvalues for sample in found.values()])
    return sort_eigenvalues(eigenvalues.reshape(*shape, -1))


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
