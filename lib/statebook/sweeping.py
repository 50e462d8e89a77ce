"""Evaluate a function over a grid of parameters, on one machine or many."""

import hashlib
import inspect
import itertools
import math
import multiprocessing
import os
import pickle
import pkgutil
import random
import signal
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, ProcessPoolExecutor, wait
from contextlib import ExitStack
from functools import partial
from typing import Any, cast

import numpy as np

from statebook import _validate
from statebook.checkpoint import Checkpoint, stacked
from statebook.variants import variant

_CHUNKS_PER_WORKER = 8  # enough for the work to even out, few enough to cost little
_WORKERS = 8  # guess for an executor that does not say how many it has
_LARGEST = 10_000  # points a task, so that what is on its way stays small
_GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
_AHEAD = 4  # times as many tasks may be on their way
_SAID = "the function failed at ", "function must return "  # by _evaluate, not an executor
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
    reduce: tuple[Callable[[Any, Any], Any], Any] | None = None,
    cache: str | os.PathLike[str] | None = None,
) -> Any:
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
    reduce : (function, initial), optional
        Results are not kept: total = function(total, result), from initial on, in the order of
        the grid. The memory is that of some tasks, for 1e7 points too.
    cache : path, optional
        File of what is done, written every second or so and where the sweep ends, for whatever
        reason: the same call goes on from there, with that chunk. The code of the function is not
        looked at: delete the file if you change it.

    Returns
    -------
    array, shape (len of each parameter's values, in order, then that of a result)
        With `reduce`, its total.

    Raises
    ------
    TypeError, ValueError
        The grid is empty or no mapping, results differ in shape or are no arrays, the function
        cannot be sent to a process, or draws its random numbers from a generator outside of it,
        which every process would repeat. The cache is of another sweep.
    RuntimeError
        The function raised, or a worker died; the message names the point. Points that wait are
        cancelled.
    OSError
        The cache cannot be written. Later, when results would be lost, that is a warning.

    Notes
    -----
    Processes that are copies of one another would draw the same numbers from numpy.random and
    random: there they are seeded anew for each task.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> with ThreadPoolExecutor() as pool:
    ...     sweep(pow, {"base": [2, 3], "exp": [1, 2]}, executor=pool, progress=False)
    array([[2, 4],
           [3, 9]])
    """
    from tqdm.auto import tqdm

    shape = _shape(grid)
    # Whatever has an index as it is: it may be long.
    grid = {k: v if isinstance(v, range | np.ndarray) else list(v) for k, v in grid.items()}
    number = math.prod(shape)
    entropy = _entropy(function, grid, seed)
    if not (executor is None or isinstance(executor, Executor)):
        raise TypeError(f"executor must be a concurrent.futures.Executor, got {executor!r}")
    processes = executor is None or isinstance(executor, ProcessPoolExecutor)
    if processes:
        _require_module(function)
    else:
        _require_import(executor, sweep, function, model)
    if model is not None:
        variant(model, _point(grid, 0))  # says what is wrong with a name
        function = partial(_of_variant, function, model)
    if processes or cache is not None:
        key = _digests(function, grid)
    with ExitStack() as stack:
        board: Any = None
        if executor is None:
            shared = multiprocessing.get_context().Array("q", 2 + 2 * (os.cpu_count() or 1))
            board = shared.get_obj()
            executor = ProcessPoolExecutor(initializer=_join, initargs=(shared,))
            stack.callback(executor.shutdown, cancel_futures=True)
        many = _CHUNKS_PER_WORKER * (getattr(executor, "_max_workers", None) or _WORKERS)
        size = min(_LARGEST, -(-number // many)) if chunk is None else chunk
        done = Checkpoint(_validate.integer("chunk", size, 1), reduce)
        if cache is not None:
            done.keep_in(cache, {**key, "seed": str(seed)})
            stack.callback(done.save)
        missing = done.missing(number)
        begun = number - sum(map(len, missing))
        bar = stack.enter_context(tqdm(total=number, initial=begun, disable=not progress))
        pending: dict[Any, range] = {}
        workers: list[Any] = []
        try:
            while True:
                # Loop invariant: the first point that is missing is on its way.
                held = len(done.ready) if reduce and pending else 0
                while missing and len(pending) + held < _AHEAD * many:
                    part = missing.popleft()
                    points = [_point(grid, i) for i in part]
                    future = executor.submit(_evaluate, function, points, part.start, entropy)
                    pending[future] = part
                if not pending:
                    return done.result(shape)
                workers = workers or multiprocessing.active_children()
                ended = wait(pending, return_when=FIRST_COMPLETED).done
                # What succeeded is kept first.
                for future in sorted(ended, key=lambda f: f.cancelled() or bool(f.exception())):
                    part = pending[future]
                    try:
                        found = future.result()
                    except Exception as error:
                        if str(error).startswith(_SAID):
                            raise
                        parts = [part]
                        if isinstance(error, BrokenExecutor):
                            executor.shutdown()  # by now all others were terminated
                            parts = [*pending.values()]
                        message = _death(grid, itertools.chain(*parts), board, workers)
                        raise RuntimeError(message) from error
                    done.add(part.start, found)
                    del pending[future]
                    bar.update(len(part))
        except BaseException:
            if board is not None:
                board[0] = 1  # who is at work ends after its point
            for other in pending:
                other.cancel()
            raise


def _of_variant(function: Callable[..., Any], model: Any, /, **values: Any) -> Any:
    drawn = isinstance(values.get("rng"), np.random.Generator)
    rng = {"rng": values.pop("rng")} if drawn else {}
    return function(variant(model, values), **rng)


def _shape(grid: Any) -> tuple[int, ...]:
    if not isinstance(grid, Mapping):
        raise TypeError(f"grid must map parameters to their values, got {type(grid).__name__}")
    for name, values in grid.items():
        # A set has no order that results could follow.
        sized = hasattr(values, "__getitem__") and getattr(values, "ndim", 1) > 0
        if isinstance(values, str | bytes) or not sized:
            raise TypeError(f"grid must hold a sequence of values of {name}, got {values!r}")
    shape = tuple(len(values) for values in grid.values())
    if not shape or 0 in shape:
        raise ValueError(f"grid must hold at least one value of each parameter, got {dict(grid)}")
    return shape


def _point(grid: Mapping[str, Any], index: int) -> dict[str, Any]:
    """Return the point at an index; the last parameter runs first."""
    places = np.unravel_index(index, [*map(len, grid.values())])
    return {name: grid[name][place] for name, place in zip(grid, places, strict=True)}


def _entropy(function: Any, grid: Mapping[str, Any], seed: int | None) -> tuple[int, bool]:
    """Return what all random numbers follow from, and whether the function gets a generator."""
    if not callable(function):
        raise TypeError(f"function must be callable, got {function!r}")
    try:
        rng = None if "rng" in grid else inspect.signature(function).parameters.get("rng")
    except (TypeError, ValueError):  # built in C: nothing to read
        rng = None
    if name := generator_outside(function):
        raise ValueError(
            f"function must not draw from the generator {name} outside of it: each process"
            " would repeat its numbers; give the function a parameter rng, and sweep a seed="
        )
    if seed is not None and rng is None:
        raise TypeError("seed is for a function with a parameter rng, which this one has not")
    if seed is None:
        if rng and rng.default is rng.empty:
            raise TypeError("seed is required for a function with a parameter rng: give an integer")
        return cast(int, np.random.SeedSequence().entropy), False
    return _validate.integer("seed", seed), True


def generator_outside(function: Any) -> str | None:
    """Name a random generator that a function takes from around.

    Looked for in its arguments by functools.partial, its defaults, its closure, its module, and
    so on in what it calls there.

    Parameters
    ----------
    function : callable

    Returns
    -------
    str or None

    Examples
    --------
    >>> generator_outside(np.random.default_rng(1).normal)
    '__self__'
    """
    known, waiting = {}, [("", function)]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, _GENERATORS):
            return name
        if id(value) not in known:
            known[id(value)] = value
            waiting += _parts(value)
    return None


def _parts(value: Any) -> list[tuple[str, Any]]:
    """Names and values that a function, an object or a partial holds, or takes from around."""
    if isinstance(value, partial):
        return [*value.keywords.items(), *((repr(a), a) for a in value.args), ("", value.func)]
    if inspect.ismethod(value):
        return [("__self__", value.__self__), ("", value.__func__)]
    if not inspect.isfunction(value):
        skip = inspect.ismodule(value) or inspect.isclass(value)
        return [] if skip else [*getattr(value, "__dict__", {}).items()]
    parameters = inspect.signature(value).parameters
    around = inspect.getclosurevars(value)
    of_module = [
        (name, v)
        for name, v in around.globals.items()
        if getattr(v, "__module__", None) == value.__module__ or isinstance(v, _GENERATORS)
    ]
    return [*((k, p.default) for k, p in parameters.items()), *around.nonlocals.items(), *of_module]


def _module(value: Any) -> str | None:
    return getattr(getattr(value, "func", value), "__module__", None)


def _require_module(function: Any) -> None:
    forked = multiprocessing.get_context().get_start_method() == "fork"
    script = hasattr(sys.modules["__main__"], "__file__")
    if not (forked or script) and _module(function) == "__main__":
        raise TypeError(f"function must not come from a notebook or a prompt here: {_ELSEWHERE}")


def _require_import(executor: Any, *used: Any) -> None:
    """Have a worker import what its tasks name: one that cannot load a task may end in silence."""
    for name in {_module(value): None for value in used if _module(value)}:
        try:
            executor.submit(pkgutil.resolve_name, f"{name}:__name__").result()
        except Exception as error:
            said = f"executor's workers cannot import {name} ({error}): start them with the folder"
            raise ImportError(f"{said} of that module in their PYTHONPATH") from error


def _digests(function: Any, grid: dict[str, Any]) -> dict[str, str]:
    """Refuse what another process could not receive, before it dies of it; return its digests."""
    digests = {}
    for name, value in (("function", function), ("grid", grid)):
        try:
            digests[name] = hashlib.sha256(pickle.dumps(value, protocol=5)).hexdigest()
        except Exception as error:
            said = f"{name} cannot be sent to a process ({error}): {_ELSEWHERE}"
            raise TypeError(said) from error
    return digests


_board: Any = None  # in a worker: whether to stop, how many joined, for each its id and point
_seat = 0


def _join(shared: Any) -> None:
    global _board, _seat
    _board = shared.get_obj()
    with shared.get_lock():
        _board[1] += 1
        _seat = 2 * _board[1]
    _board[_seat] = os.getpid()


def _evaluate(
    function: Callable[..., Any],
    points: list[dict[str, Any]],
    first: int,
    entropy: tuple[int, bool],
) -> np.ndarray:
    if multiprocessing.parent_process() is not None:
        seed = np.random.SeedSequence(entropy[0], spawn_key=(first,))
        np.random.seed(seed.generate_state(4))  # noqa: NPY002 (others may draw from it)
        random.seed(int(seed.generate_state(1)[0]))
    results = []
    for index, point in enumerate(points, start=first):
        if _board is not None:
            if _board[0]:
                break
            _board[_seat + 1] = index + 1
        rng = {}
        if entropy[1]:
            seed = np.random.SeedSequence(entropy[0], spawn_key=(index,))
            rng = {"rng": np.random.default_rng(seed)}
        try:
            result = np.asarray(function(**point, **rng))
        except (Exception, SystemExit) as error:
            said = f"{type(error).__name__}: {error}"
            raise RuntimeError(f"the function failed at {point}: {said}") from error
        if result.dtype.kind not in "biufcUS":
            raise TypeError(f"function must return a number or an array, got {result!r} at {point}")
        results.append(result)
    if _board is not None:
        _board[_seat + 1] = 0
    return stacked(results)


def _death(grid: Mapping[str, Any], lost: Iterable[int], board: Any, workers: Sequence[Any]) -> str:
    """Say which worker died of what, and at which point as far as that is known."""
    dead = {p.pid: p.exitcode for p in workers if p.exitcode not in (None, -signal.SIGTERM)}
    who = ", ".join(f"{pid} (exit code {code})" for pid, code in dead.items()) if board else ""
    if board:
        at = {board[i]: board[i + 1] - 1 for i in range(2, len(board), 2) if board[i + 1]}
        lost = [at[pid] for pid in dead if pid in at] or [*at.values()] or lost
    shown = [str(_point(grid, i)) for i in itertools.islice(lost, 9)]
    shown[8:] = ["..."] * len(shown[8:])
    return (
        f"worker process {who + ' ' if who else ''}died at {', '.join(shown)}: killed, out of"
        " memory or crashed in compiled code; a script must call sweep under if __name__ =="
        ' "__main__":, and executor=ThreadPoolExecutor() keeps all in one process'
    )
