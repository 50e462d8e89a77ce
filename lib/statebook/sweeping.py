"""Evaluate a function over a grid of parameters, on one machine or many."""

from __future__ import annotations

import inspect
import itertools
import multiprocessing
import os
import pickle
import random
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np

from statebook import _validate
from statebook.variants import variant

_CHUNKS_PER_WORKER = 8  # enough for the work to even out, few enough to cost little
_WORKERS = 8  # guess for an executor that does not say how many it has
_ELSEWHERE = (
    "define it with def at the top of a module that can be imported, or give"
    " executor=ThreadPoolExecutor()"
)


def sweep(
    function: Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    *,
    executor: Executor | None = None,
    progress: bool = True,
    chunk: int | None = None,
    seed: int | None = None,
    model: Any = None,
) -> np.ndarray:
    """Evaluate a function at every point of a parameter grid.

    Parameters
    ----------
    function : callable
        Called with one keyword argument per parameter; returns a number, a text or an array of a
        shape that does not change. For processes it must be picklable: defined in a module.
    grid : mapping of str to sequence
        Values of each parameter.
    executor : concurrent.futures.Executor, optional
        Where to run: a process pool by default; the executors of Dask
        (Client.get_executor) and mpi4py (MPIPoolExecutor) on a cluster.
    progress : bool
        Show a progress bar.
    chunk : int > 0, optional
        Points a task: 1 for points of minutes, so that all workers end together, more for points
        of microseconds. By default 8 tasks a worker.
    seed : int >= 0, optional
        For a function with a parameter rng: it gets a numpy.random.Generator of its own at each
        point, the same on any executor.
    model : dataclass, control.NonlinearIOSystem or callable, optional
        What the parameters belong to, as in `eigenvalue_locus`: the function then gets, as its
        only argument, the model with these values.

    Returns
    -------
    array, shape (len of each parameter's values, in order, then that of a result)

    Raises
    ------
    TypeError, ValueError
        The grid is empty or no mapping, results differ in shape or are no arrays, the function
        cannot be sent to a process, or draws its random numbers from a generator outside of it,
        which every process would repeat.
    RuntimeError
        The function raised, or a worker died; the message names the point. Points that wait are
        cancelled.

    Notes
    -----
    Processes that are copies of one another would draw the same numbers from numpy.random and
    random: there they are seeded anew at each point.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> with ThreadPoolExecutor() as pool:
    ...     sweep(pow, {"base": [2, 3], "exp": [1, 2]}, executor=pool, progress=False)
    array([[2, 4],
           [3, 9]])
    """
    from tqdm.auto import tqdm

    points, shape = _points(grid)
    entropy = _entropy(function, grid, seed)
    if model is not None:
        variant(model, points[0])  # says what is wrong with a name
        function = partial(_of_variant, function, model)
    if not (executor is None or isinstance(executor, Executor)):
        raise TypeError(f"executor must be a concurrent.futures.Executor, got {executor!r}")
    if executor is None or isinstance(executor, ProcessPoolExecutor):
        _require_portable(function, {name: list(values) for name, values in grid.items()})
    with ExitStack() as stack:
        board = None
        if executor is None:
            board = multiprocessing.get_context().Array("q", 1 + len(points), lock=False)
            executor = ProcessPoolExecutor(initializer=_join, initargs=(board,))
            stack.callback(executor.shutdown, cancel_futures=True)
        if chunk is None:
            number = getattr(executor, "_max_workers", None) or _WORKERS
            chunk = -(-len(points) // (number * _CHUNKS_PER_WORKER))
        size = _validate.integer("chunk", chunk, 1)
        starts = range(0, len(points), size)
        tasks = [(function, points[i : i + size], i, entropy) for i in starts]
        futures = {executor.submit(_evaluate, *task): task[2] for task in tasks}
        bar = stack.enter_context(tqdm(total=len(points), disable=not progress))
        workers = multiprocessing.active_children()
        results: list[Any] = [None] * len(points)
        try:
            for future in as_completed(futures):
                i, found = futures[future], future.result()
                results[i : i + len(found)] = found
                bar.update(len(found))
        except BrokenProcessPool as error:
            executor.shutdown()  # by now all others were terminated
            missing = [i for i, result in enumerate(results) if result is None]
            raise RuntimeError(_death(points, missing, board, workers)) from error
        except BaseException:
            if board is not None:
                board[0] = 1  # who is at work ends after its point
            for other in futures:
                other.cancel()
            raise
    shapes = sorted({np.shape(result) for result in results})
    if len(shapes) > 1:
        raise ValueError(f"function must return results of one shape, got {shapes}")
    stacked = np.array(results)
    return stacked.reshape(shape + stacked.shape[1:])


def _of_variant(function: Callable[..., Any], model: Any, /, **values: Any) -> Any:
    drawn = isinstance(values.get("rng"), np.random.Generator)
    rng = {"rng": values.pop("rng")} if drawn else {}
    return function(variant(model, values), **rng)


def _points(grid: Any) -> tuple[list[dict[str, Any]], tuple[int, ...]]:
    """Return all points of the grid in order, and its shape."""
    if not isinstance(grid, Mapping):
        raise TypeError(f"grid must map parameters to their values, got {type(grid).__name__}")
    for name, values in grid.items():
        sized = hasattr(values, "__len__") and getattr(values, "ndim", 1) > 0
        if isinstance(values, str | bytes) or not sized:
            raise TypeError(f"grid must hold a sequence of values of {name}, got {values!r}")
    shape = tuple(len(values) for values in grid.values())
    if not shape or 0 in shape:
        raise ValueError(f"grid must hold at least one value of each parameter, got {dict(grid)}")
    rows = itertools.product(*grid.values())
    return [dict(zip(grid, values, strict=True)) for values in rows], shape


def _entropy(function: Any, grid: Mapping[str, Any], seed: int | None) -> tuple[int, bool]:
    """Return what all random numbers follow from, and whether the function gets a generator."""
    if not callable(function):
        raise TypeError(f"function must be callable, got {function!r}")
    try:
        wants = "rng" in inspect.signature(function).parameters and "rng" not in grid
    except (TypeError, ValueError):  # built in C: nothing to read
        wants = False
    for name, value in _outside(function):
        if isinstance(value, np.random.Generator | np.random.RandomState | random.Random):
            raise ValueError(
                f"function must not draw from the generator {name} outside of it: each process"
                " would repeat its numbers; give the function a parameter rng, and sweep a seed="
            )
    if seed is not None and not wants:
        raise TypeError("seed is for a function with a parameter rng, which this one has not")
    if seed is None:
        return int.from_bytes(np.random.default_rng().bytes(16), "little"), False
    return _validate.integer("seed", seed), True


def _outside(function: Any, known: tuple[Any, ...] = ()) -> list[tuple[str, Any]]:
    """Names and values that a function, and those of its module that it calls, take from around."""
    found: list[tuple[str, Any]] = []
    while hasattr(function, "func"):  # functools.partial
        found += [*function.keywords.items(), *((repr(a), a) for a in function.args)]
        function = function.func
    function = getattr(function, "__func__", function)
    if inspect.isfunction(function) and function not in known:
        parameters = inspect.signature(function).parameters
        found += [(name, p.default) for name, p in parameters.items()]
        around = inspect.getclosurevars(function)
        found += [*around.globals.items(), *around.nonlocals.items()]
        for _, value in found.copy():
            if getattr(value, "__module__", None) == function.__module__:
                found += _outside(value, (*known, function))
    return found


def _require_portable(function: Any, grid: dict[str, Any]) -> None:
    """Refuse what another process could not receive, before it dies of it."""
    main = sys.modules["__main__"]
    inner = getattr(function, "func", function)
    forked = multiprocessing.get_context().get_start_method() == "fork"
    if not (forked or hasattr(main, "__file__")) and getattr(inner, "__module__", "") == "__main__":
        raise TypeError(f"function must not come from a notebook or a prompt here: {_ELSEWHERE}")
    for name, value in (("function", function), ("grid", grid)):
        try:
            pickle.dumps(value)
        except Exception as error:
            raise TypeError(
                f"{name} cannot be sent to a process ({error}): {_ELSEWHERE}"
            ) from error


_board: Any = None  # in a worker: whether to stop, then who is at work on each point


def _join(board: Any) -> None:
    global _board
    _board = board


def _evaluate(
    function: Callable[..., Any], points: list[dict[str, Any]], first: int, entropy: Any
) -> list[np.ndarray]:
    results = []
    for index, point in enumerate(points, start=first):
        if _board is not None:
            if _board[0]:
                break
            _board[1 + index] = os.getpid()
        seed = np.random.SeedSequence(entropy[0], spawn_key=(index,))
        rng = {"rng": np.random.default_rng(seed)} if entropy[1] else {}
        if multiprocessing.parent_process() is not None:
            np.random.seed(seed.generate_state(4))  # noqa: NPY002 (others may draw from it)
            random.seed(int(seed.generate_state(1)[0]))
        try:
            result = np.asarray(function(**point, **rng))
        except (Exception, SystemExit) as error:
            said = f"{type(error).__name__}: {error}"
            raise RuntimeError(f"the function failed at {point}: {said}") from error
        if result.dtype.kind not in "biufcUS":
            raise TypeError(f"function must return a number or an array, got {result!r} at {point}")
        results.append(result)
        if _board is not None:
            _board[1 + index] = 0
    return results


def _death(
    points: list[dict[str, Any]], missing: list[int], board: Any, workers: Sequence[Any]
) -> str:
    """Say which worker died of what, and at which point as far as that is known."""
    dead = {p.pid: p.exitcode for p in workers if p.exitcode not in (None, -signal.SIGTERM)}
    who = ", ".join(f"{pid} (exit code {code})" for pid, code in dead.items()) if board else ""
    if board:
        begun = [i for i in missing if board[1 + i]]
        missing = [i for i in begun if board[1 + i] in dead] or begun or missing
    shown = ", ".join(str(points[i]) for i in missing[:8]) + (", ..." if len(missing) > 8 else "")
    return (
        f"worker process {who + ' ' if who else ''}died at {shown}: killed, out of memory or"
        ' crashed in compiled code; a script must call sweep under if __name__ == "__main__":,'
        " and executor=ThreadPoolExecutor() keeps all in one process"
    )
