"""Evaluate a function over a grid of parameters, on one machine or many."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack
from typing import Any

import numpy as np

_CHUNKS_PER_WORKER = 8  # enough for the work to even out, few enough to cost little
_WORKERS = 8  # guess for an executor that does not say how many it has


def sweep(
    function: Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    *,
    executor: Executor | None = None,
    progress: bool = True,
) -> np.ndarray:
    """Evaluate a function at every point of a parameter grid.

    Parameters
    ----------
    function : callable
        Called with one keyword argument per parameter; returns a number or an array of a
        shape that does not change. It must be picklable: defined in a module.
    grid : mapping of str to sequence
        Values of each parameter.
    executor : concurrent.futures.Executor, optional
        Where to run: a process pool by default; the executors of Dask
        (Client.get_executor) and mpi4py (MPIPoolExecutor) on a cluster.
    progress : bool
        Show a progress bar.

    Returns
    -------
    array, shape (len of each parameter's values, in order, then that of a result)

    Raises
    ------
    ValueError
        The grid is empty, or results differ in shape.
    RuntimeError
        The function raised; the message names the point.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> with ThreadPoolExecutor() as pool:
    ...     sweep(pow, {"base": [2, 3], "exp": [1, 2]}, executor=pool, progress=False)
    array([[2, 4],
           [3, 9]])
    """
    from tqdm.auto import tqdm

    shape = tuple(len(values) for values in grid.values())
    if not shape or 0 in shape:
        raise ValueError(f"grid must hold at least one value of each parameter, got {dict(grid)}")
    points = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    with ExitStack() as stack:
        if executor is None:
            executor = stack.enter_context(ProcessPoolExecutor())
        workers = getattr(executor, "_max_workers", None) or _WORKERS
        size = -(-len(points) // (workers * _CHUNKS_PER_WORKER))
        chunks = [points[i : i + size] for i in range(0, len(points), size)]
        futures = [executor.submit(_evaluate, function, chunk) for chunk in chunks]
        bar = stack.enter_context(tqdm(total=len(points), disable=not progress))
        results = []
        for future in futures:
            try:
                results += future.result()
            except BaseException:
                for other in futures:
                    other.cancel()
                raise
            bar.update(len(results) - bar.n)
    if len({np.shape(result) for result in results}) > 1:
        shapes = sorted({np.shape(result) for result in results})
        raise ValueError(f"function must return results of one shape, got {shapes}")
    stacked = np.array(results)
    return stacked.reshape(shape + stacked.shape[1:])


def _evaluate(function: Callable[..., Any], points: list[dict[str, Any]]) -> list[Any]:
    results = []
    for point in points:
        try:
            results.append(function(**point))
        except Exception as error:
            raise RuntimeError(f"the function failed at {point}: {error}") from error
    return results
