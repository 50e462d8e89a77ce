"""Many trajectories of one system under independent errors."""

import functools
import math
import os
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory
from statebook.policies import as_plan, at_start
from statebook.simulation import simulate_clocked
from statebook.sweeping import generator_outside, sweep
from statebook.systems import System, as_system
from statebook.times import ReadOnly
from statebook.trajectory import Trajectory
from statebook.uncertainty.error_models import control_of, with_disturbance
from statebook.uncertainty.noise import PAGE, HeldNoise, counted_from

_BLOCKS = 64  # at least, so that many workers have something to do
_NUMBERS = 2**22  # in a block at most


@dataclass(frozen=True, eq=False, repr=False)
class Moments(ReadOnly):
    """Mean and covariance of runs that were not kept.

    Parameters
    ----------
    number : int > 1
        N, the number of runs.
    times : array, shape (T,) [s]
    mean : array, shape (n, T)
    covariance : array, shape (n, n, T)
        Unbiased: divided by N - 1.

    References
    ----------
    Chan, Golub and LeVeque, The American Statistician 37 (1983) 242 (sums of parts, joined
    without the cancellation of sums of squares).

    Examples
    --------
    >>> Moments(3, np.zeros(1), np.zeros((2, 1)), np.zeros((2, 2, 1)))
    Moments(3 runs, n=2, 1 times over [0, 0] s)
    """

    number: int
    times: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray

    def __post_init__(self) -> None:
        self._keep(**vars(self))

    def __repr__(self) -> str:
        count, (start, end) = len(self.times), self.times[[0, -1]]
        n = len(self.mean)
        return f"Moments({self.number} runs, n={n}, {count} times over [{start:g}, {end:g}] s)"


def monte_carlo(
    system: Any,
    x0: Any,
    policy: Any = None,
    *,
    number: int,
    period: float,
    duration: float,
    disturbance: Any = None,
    G: Any = None,
    samples: int = 1,
    method: str = "RK45",
    rtol: float = 1e-8,
    atol: float = 1e-10,
    executor: Executor | None = None,
    chunk: int | None = None,
    reduce: Any = None,
    cache: str | os.PathLike[str] | None = None,
    progress: bool = True,
) -> Any:
    """Simulate many trajectories under independent errors.

    At each tick the policy, with the errors wrapped round it, sees the states; its controls and
    the disturbance are held until the next tick, so that the solver meets no jump. All runs
    advance together, by arrays; given one of `executor`, `chunk`, `reduce` and `cache`, in blocks
    that `sweep` hands out. The noise of a run is that of its number, in whichever block.

    Parameters
    ----------
    system : system
        Whatever as_system takes, with or without inputs. In discrete time the period is its
        sample time.
    x0 : array, shape (n,) or (n, N)
        One initial state for all, or one a trajectory.
    policy : callable, array (m,) or ControlTrajectory, optional
        u(x, t) for batches (n, N), or what is held; zero if omitted. Wrapped in
        `with_measurement_error` and `with_actuation_error` where it meets such errors.
    number : int > 0
        N, the number of trajectories.
    period : float > 0 [s]
        Of the clock.
    duration : float > 0 [s]
        Rounded up to whole periods.
    disturbance : HeldNoise or callable, optional
        w in x' = f(x, u) + G w; a function w(x, t) returns (q,) or (q, N). White noise needs
        the period of the clock, so that none of it is skipped.
    G : array, shape (n, q), optional
        Where the disturbance enters; the identity if omitted.
    samples : int > 0
        Stored samples a period.
    method : str
        As in simulate; "rk4" and "euler" make one step a sample.
    rtol, atol : float > 0
        As in simulate.
    executor : concurrent.futures.Executor, optional
        Where to run blocks, as in `sweep`: processes, Dask, MPI.
    chunk : int > 0, optional
        Runs a block. By default at most 8192 and at least 64 blocks. With the same chunk the
        results are the same numbers on any executor; another one changes a solver's steps, and
        so the results within its tolerance.
    reduce : "moments" or (statistic, merge), optional
        For more runs than memory holds. "moments" keeps the mean and the covariance. Of your own:
        statistic(run) gets the Trajectory of a block where it was simulated and returns a number
        or an array; total = merge(total, next) in the order of the runs.
    cache : path, optional
        As in `sweep`: the same call goes on from there.
    progress : bool
        Show a progress bar over the blocks.

    Returns
    -------
    Trajectory, or Moments, or what merge returned last
        States (n, N, T) and the inputs (u, w) that acted, one an interval.

    Raises
    ------
    DivergenceError
        As simulate.
    RuntimeError
        In blocks: a run failed, and the message names it, its start and the seed; or a worker
        died.
    TypeError, ValueError
        An argument has the wrong type or shape, or the noise is held for less than a period or
        for a fraction of one. In blocks, random numbers come from a generator instead of a
        HeldNoise: each block would repeat them.

    Examples
    --------
    >>> import statebook as sb
    >>> gusts = sb.HeldNoise.white(0.5, 0.1, seed=1)
    >>> run = sb.monte_carlo(sb.Particle(m=2.0), [0, 0], number=400, period=0.1, duration=3.0,
    ...                      disturbance=gusts, G=[[0], [0.5]])
    >>> run
    Trajectory(a batch of 400, n=2, m=2, 31 times over [0, 3] s)
    >>> sb.consistency(run.states[:1, :, -1], 0.5 * 3.0**3 / 3 / 2.0**2) > 1e-8
    True
    >>> sb.monte_carlo(sb.Particle(m=2.0), [0, 0], number=40, period=0.1, duration=3.0,
    ...                disturbance=gusts, G=[[0], [0.5]], reduce="moments", progress=False)
    Moments(40 runs, n=2, 31 times over [0, 3] s)
    """
    number = _validate.integer("number", number, 1)
    period = _validate.positive("period", period)
    x0 = _validate.real_array("x0", x0)
    if x0.ndim not in (1, 2) or (x0.ndim == 2 and x0.shape[1] != number):
        raise ValueError(f"x0 must have shape (n,) or (n, {number}), got {x0.shape}")
    start = x0.copy() if x0.ndim == 2 else np.broadcast_to(x0[:, None], (len(x0), number))
    options: dict[str, Any] = {"period": period, "duration": duration, "samples": samples}
    options |= {"method": method, "rtol": rtol, "atol": atol}
    policy = as_plan("policy", policy)
    errors = (system, policy, disturbance, G)
    if executor is None and chunk is None and reduce is None and cache is None:
        return _simulated(errors, options, start)
    for name, value in zip(("system", "policy", "disturbance"), errors, strict=False):
        if generator := generator_outside(value):
            raise ValueError(
                f"{name} must not draw from the generator {generator}: each block would repeat"
                " its numbers; take them from a HeldNoise"
            )
    one = start[:, :1]
    known = _disturbed(errors, one, period, _first_control(policy, one))[0]
    ticks = math.ceil(_validate.positive("duration", duration) / period * (1 - 1e-12))
    count = ticks * _validate.integer("samples", samples, 1) + 1
    if chunk is None:
        chunk = min(PAGE, -(-number // _BLOCKS), _NUMBERS // ((known.n + known.m) * count) or 1)
    chunk = min(_validate.integer("chunk", chunk, 1), number)
    statistic, fold = _reduction(reduce, number)
    firsts = [*range(0, number, chunk)]
    if fold is None:  # of one size: the last block begins early
        firsts[-1] = number - chunk
    blocks = [_Runs(first, start[:, first : first + chunk]) for first in firsts]
    block, grid = functools.partial(_block, errors, options, statistic), {"runs": blocks}
    with nullcontext(executor) if executor else ThreadPoolExecutor(1) as pool:
        found = sweep(
            block, grid, executor=pool, progress=progress, chunk=1, reduce=fold, cache=cache
        )
    if reduce == "moments":
        times, mean, products = found[0], found[2 : known.n + 2], found[known.n + 2 :]
        covariance = products.reshape(known.n, known.n, count) / (number - 1)
        return Moments(number, times, mean, covariance)
    if fold is not None:
        return found
    times, states, controls = np.split(found, [count, count * (1 + known.n * chunk)], axis=1)
    x, u, labels = _side_by_side(states, firsts, (known.n, chunk, count)), None, None
    if known.m:
        u, labels = _side_by_side(controls, firsts, (known.m, chunk, count - 1)), known.inputs
    return Trajectory(times[0], x, u, state_labels=known.states, input_labels=labels)


_Errors = tuple[Any, Any, Any, Any]  # system, policy, disturbance, G


class _Runs(NamedTuple):
    first: int
    start: np.ndarray

    def __repr__(self) -> str:
        last = self.first + self.start.shape[1] - 1
        return f"{self.first}" + (f" to {last}" if last > self.first else "")


def _simulated(errors: _Errors, options: dict[str, Any], start: np.ndarray) -> Trajectory:
    _, policy, disturbance, _ = errors
    first = _first_control(policy, start)
    system, m = _disturbed(errors, start, options["period"], first)

    def inputs(x: np.ndarray, t: float) -> np.ndarray:
        # One call a tick: the first told how many inputs there are.
        now = first.pop() if first else policy
        u = np.zeros((m, x.shape[1])) if policy is None else control_of(now, x, t, m)
        if disturbance is None:
            return u
        q = system.m - m
        held = isinstance(disturbance, HeldNoise)
        w = disturbance(t, x.shape[1]) if held else control_of(disturbance, x, t, q, "disturbance")
        return np.concatenate([u, w])

    return replace(simulate_clocked(system, start, inputs, **options))  # the samples alone


def _block(errors: _Errors, options: dict[str, Any], statistic: Any, runs: _Runs) -> np.ndarray:
    """Simulate a block of runs; where it fails, find a run that does so alone."""
    first, start = runs
    try:
        with counted_from(first):
            run = _simulated(errors, options, start)
    except Exception as error:
        half = start.shape[1] // 2
        for part in (_Runs(first, start[:, :half]), _Runs(first + half, start[:, half:])):
            if half:
                _block(errors, options, id, part)
        seed = getattr(errors[2], "seed", None)
        alone = f" from x0 = {start[:, 0]}, noise of seed {seed}," if not half else ""
        said = f"run {runs}{alone} failed: {type(error).__name__}: {error}"
        raise RuntimeError(said) from error
    return statistic(run)


def _all(run: Trajectory) -> np.ndarray:
    controls = [] if run.controls is None else [run.controls.ravel()]
    return np.concatenate([run.times, run.states.ravel(), *controls])


def _side_by_side(found: np.ndarray, firsts: list[int], shape: tuple[int, int, int]) -> np.ndarray:
    whole = np.empty((shape[0], firsts[-1] + shape[1], shape[2]))
    for first, block in zip(firsts, found, strict=True):
        whole[:, first : first + shape[1]] = block.reshape(shape)
    return whole


def _reduction(reduce: Any, number: int) -> tuple[Any, Any]:
    """Return the statistic of a block, and how `sweep` folds it, if it does."""
    if reduce is None:
        return _all, None
    if isinstance(reduce, str):
        _validate.choice("reduce", reduce, ("moments",))
        _validate.integer("number", number, 2)
        reduce = _moments, _joined
    if not (isinstance(reduce, tuple) and len(reduce) == 2 and all(map(callable, reduce))):
        raise TypeError(f'reduce must be "moments" or (statistic, merge), got {reduce!r}')
    statistic, merge = reduce
    fold = functools.update_wrapper(functools.partial(_folded, merge), merge)
    return statistic, (fold, np.empty(0))


def _folded(merge: Any, total: np.ndarray, value: np.ndarray) -> Any:
    return merge(total, value) if np.size(total) else value.copy()


def _moments(run: Trajectory) -> np.ndarray:
    """Return rows of the times, the number, the means and the products of deviations."""
    mean = run.states.mean(axis=1)
    d = run.states - mean[:, None]
    products = np.einsum("iNt,jNt->ijt", d, d).reshape(-1, len(run.times))
    number = np.full_like(run.times, run.states.shape[1])
    return np.concatenate([[run.times, number], mean, products])


def _joined(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    n = math.isqrt(len(a) - 2)  # of n + n^2 rows
    shift = b[2 : n + 2] - a[2 : n + 2]
    number = a[1] + b[1]
    products = (shift[:, None] * shift).reshape(n * n, -1) * (a[1] * b[1] / number)
    mean = a[2 : n + 2] + shift * (b[1] / number)
    return np.concatenate([[a[0], number], mean, a[n + 2 :] + b[n + 2 :] + products])


def _first_control(policy: Any, start: np.ndarray) -> list[np.ndarray]:
    """What a policy returns at the start; nothing for a plan, or for none."""
    asked = callable(policy) and not isinstance(policy, ControlTrajectory)
    return [at_start("policy(x0, 0)", policy, start, 0.0)] if asked else []


def _disturbed(
    errors: _Errors, start: np.ndarray, period: float, first: list[np.ndarray]
) -> tuple[System, int]:
    """Return the system with the inputs (u, w), and how many u are."""
    system, policy, disturbance, G = errors
    value, u = first[0] if first else policy, None
    if isinstance(value, ControlTrajectory):
        u = np.zeros(value.m)
    elif value is not None:
        # One number a trajectory is a single input.
        single = np.ndim(value) == 0 or (bool(first) and value.shape == start.shape[1:])
        u = np.zeros(1 if single else len(value))
    # Of a plain function, the states and a control tell n and m.
    system = as_system(system, start[:, 0], u, names=("x0", "policy"))
    if len(start) != system.n:
        raise ValueError(
            f"x0 must have shape ({system.n},) or ({system.n}, N), got {len(start)} rows"
        )
    if policy is not None and not system.m:
        raise ValueError(f"policy must be left out: {system.name} has no inputs")
    if disturbance is None:
        if G is not None:
            raise ValueError("G was given without a disturbance: give both, or neither")
        return system, system.m
    disturbed = with_disturbance(system, G)
    if isinstance(disturbance, HeldNoise):
        _check_noise(disturbance, period, disturbed.m - system.m)
    return disturbed, system.m


def _check_noise(noise: HeldNoise, period: float, q: int) -> None:
    if noise.size != q:
        raise ValueError(
            f"disturbance must have the {q} components that G has columns, got {noise.size}"
        )
    ratio = noise.period / period
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ValueError(
            f"disturbance must be held for a whole number of periods of {period:g} s, got "
            f"{noise.period:g} s: what a clock skips or cuts has another variance"
        )
