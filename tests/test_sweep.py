"""sweep gives what a loop gives, wherever it runs, and says what went wrong where."""

from __future__ import annotations

import functools
import math
import os
import pickle
import pkgutil
import random
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook import sweeping


def polar(radius, angle):
    return np.array([radius * np.cos(angle), radius * np.sin(angle)])


def ragged(size):
    return np.zeros(size)


def failing(x):
    return 1 / x


def leaving(x):
    raise SystemExit(x)


def nothing(x):
    return None


def diverging(x):
    return sb.simulate(lambda y: y**2, [x], duration=10.0).states[0, -1]


def dying(x):
    if x == 5:
        os._exit(3)
    return x


def old_numbers(x):
    return np.array([np.random.uniform(), random.random()])  # noqa: NPY002


def new_numbers(x, rng):
    return rng.uniform(size=2)


def noisy_end(x, rng):
    noise = sb.HeldNoise.white(x, 0.1, seed=rng)
    run = sb.monte_carlo(
        sb.Particle(), [0, 0], number=1, period=0.1, duration=0.5, disturbance=noise,
        G=[[0], [1]], method="rk4",
    )  # fmt: skip
    return run.states[0, 0, -1]


GENERATOR = np.random.default_rng(1)


def repeating(x):
    return GENERATOR.uniform() + x


def through_another(x):
    return repeating(x)


class Inline(Executor):
    """Runs at once, and counts what was asked of it."""

    def __init__(self):
        self.chunks = []

    def submit(self, function, *arguments):
        if function is not pkgutil.resolve_name:
            self.chunks.append(len(arguments[1]))
        future = Future()
        try:
            future.set_result(function(*arguments))
        except BaseException as error:
            future.set_exception(error)
        return future


class Waiting(Inline):
    """Runs the last task alone; the others wait for ever."""

    def __init__(self, last):
        super().__init__()
        self.last, self.waiting = last, []

    def submit(self, function, *arguments):
        if arguments[2:3] in ((), (self.last,)):
            return super().submit(function, *arguments)
        self.waiting.append(Future())
        return self.waiting[-1]


GRID = {"radius": [1.0, 2.0, 3.0], "angle": np.linspace(0, 1, 5)}


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor, None])
def test_order_and_shape(pool):
    executor = pool and pool(max_workers=2)
    result = sb.sweep(polar, GRID, executor=executor, progress=False)
    assert result.shape == (3, 5, 2)
    for i, j in np.ndindex(3, 5):
        expected = polar(GRID["radius"][i], GRID["angle"][j])
        np.testing.assert_array_equal(result[i, j], expected)
    if executor:
        executor.shutdown()


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 40), st.integers(1, 7), st.integers(1, 50))
def test_any_grid_and_chunk_is_a_loop(a, b, chunk):
    grid = {"base": range(a), "exp": np.arange(b)}
    pool = Inline()
    result = sb.sweep(pow, grid, executor=pool, progress=False, chunk=chunk)
    np.testing.assert_array_equal(result, [[x**y for y in range(b)] for x in range(a)])
    assert sum(pool.chunks) == a * b and set(pool.chunks[:-1]) <= {chunk}
    assert len(pool.chunks) == math.ceil(a * b / chunk)


@pytest.mark.parametrize(("points", "size"), [(640, 10), (641, 11), (1, 1), (64, 1)])
def test_chunks_are_eight_a_worker(points, size):
    pool = Inline()
    sb.sweep(abs_of, {"x": range(points)}, executor=pool, progress=False)
    assert max(pool.chunks) == size


def abs_of(x):
    return abs(x)


def test_progress_is_shown_unless_not_wanted(capsys):
    sb.sweep(abs_of, {"x": range(30)}, executor=Inline(), progress=False)
    assert capsys.readouterr().err == ""
    sb.sweep(abs_of, {"x": range(30)}, executor=Inline())
    assert "30/30" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("function", "grid", "message"),
    [
        (failing, [2, 1, 0], r"failed at \{'x': 0\}: ZeroDivisionError: division by zero"),
        (failing, ["a"], r"failed at \{'x': 'a'\}: TypeError: unsupported"),
        (leaving, [7], r"failed at \{'x': 7\}: SystemExit: 7"),
        (diverging, [0.01, 3.0], r"failed at \{'x': 3.0\}: DivergenceError: simulation"),
    ],
)
@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_failure_names_the_point(pool, function, grid, message):
    with pool(max_workers=1) as executor:
        with pytest.raises(RuntimeError, match=message):
            sb.sweep(function, {"x": grid}, executor=executor, progress=False)


def test_failure_cancels_what_waits():
    pool = Waiting(last=3)
    with pytest.raises(RuntimeError, match="failed at"):
        sb.sweep(failing, {"x": [1, 2, 3, 0]}, executor=pool, progress=False, chunk=1)
    assert len(pool.waiting) == 3 and all(future.cancelled() for future in pool.waiting)


def slow_but_first(x, folder):
    (folder / str(x)).touch()
    if x == 0:
        raise ValueError("no")
    return x + sum(range(200_000))


def test_failure_stops_workers_at_their_next_point(tmp_path):
    with pytest.raises(RuntimeError, match="'x': 0"):
        sb.sweep(
            slow_but_first, {"x": range(2000), "folder": [tmp_path]}, progress=False, chunk=400
        )
    assert len(list(tmp_path.iterdir())) < 1000  # a worker left alone does its 400


def test_a_dead_worker_is_named_with_its_point():
    with pytest.raises(
        RuntimeError, match=r"worker process \d+ \(exit code 3\) died at \{'x': 5\}: k"
    ):
        sb.sweep(dying, {"x": range(40)}, progress=False, chunk=4)
    with ProcessPoolExecutor(1) as pool:
        with pytest.raises(RuntimeError, match=r"died at \{'x': 0\}, \{'x': 1\}, .*\.\.\.: killed"):
            sb.sweep(dying, {"x": range(40)}, executor=pool, progress=False, chunk=40)


def test_a_worker_shows_its_point_while_it_is_at_it(monkeypatch):
    before = [0, 2, 4711, 8, 4712, 0, 0, 0]  # to stop, how many, and of each its id and point
    board, seen = before.copy(), []
    monkeypatch.setattr(sweeping, "_board", board)
    monkeypatch.setattr(sweeping, "_seat", 4)
    points = [{"x": 5}, {"x": 6}]
    sweeping._evaluate(lambda x: seen.append(board.copy()) or x, points, 5, (0, False))
    assert seen == [[0, 2, 4711, 8, 4712, 1 + x, 0, 0] for x in (5, 6)]
    assert board == before


def test_processes_do_not_repeat_random_numbers():
    grid = {"x": range(24)}
    drawn = sb.sweep(old_numbers, grid, progress=False, chunk=1)
    assert len(np.unique(drawn)) == 48
    again = sb.sweep(old_numbers, grid, progress=False, chunk=1)
    assert not np.isin(drawn, again).any()


def test_a_seed_gives_each_point_numbers_of_its_own_wherever_it_runs():
    grid = {"x": range(1, 9)}
    drawn = sb.sweep(new_numbers, grid, seed=4, executor=Inline(), progress=False)
    assert len(np.unique(drawn)) == 16
    with ProcessPoolExecutor(2) as pool:
        options = {"executor": pool, "progress": False}
        for chunk in (1, 3):
            elsewhere = sb.sweep(new_numbers, grid, seed=4, chunk=chunk, **options)
            np.testing.assert_array_equal(elsewhere, drawn)
        other = sb.sweep(new_numbers, grid, seed=5, **options)
        assert not np.isin(other, drawn).any()
        assert len(np.unique(sb.sweep(noisy_end, grid, seed=1, **options))) == 8
    first = np.random.default_rng(np.random.SeedSequence(4, spawn_key=(0,))).uniform(size=2)
    np.testing.assert_array_equal(drawn[0], first)


@pytest.mark.parametrize(
    "function",
    [
        repeating,
        through_another,
        functools.partial(new_numbers, rng=GENERATOR),
        functools.partial(new_numbers, rng=np.random.RandomState(1)),
    ],
)
def test_a_generator_that_processes_would_repeat_is_refused(function):
    with pytest.raises(ValueError, match=r"must not draw from the generator (GENERATOR|rng)"):
        sb.sweep(function, {"x": [1]}, progress=False)


@pytest.mark.parametrize(
    ("function", "grid", "options", "error", "message"),
    [
        (abs_of, {}, {}, ValueError, "at least one value"),
        (abs_of, {"x": []}, {}, ValueError, "at least one value"),
        (abs_of, [1, 2], {}, TypeError, "grid must map parameters"),
        (abs_of, {"x": 3}, {}, TypeError, "sequence of values of x, got 3"),
        (abs_of, {"x": "abc"}, {}, TypeError, "sequence of values of x, got 'abc'"),
        (abs_of, {"x": np.array(3)}, {}, TypeError, "sequence of values of x"),
        (3, {"x": [1]}, {}, TypeError, "function must be callable"),
        (abs_of, {"x": [1]}, {"executor": ThreadPoolExecutor}, TypeError, "executor must be"),
        (abs_of, {"x": [1]}, {"chunk": 0}, ValueError, "chunk must be at least 1"),
        (abs_of, {"x": [1]}, {"seed": 3}, TypeError, "parameter rng"),
        (new_numbers, {"x": [1]}, {"seed": -3}, ValueError, "seed must be at least 0"),
        (ragged, {"size": [1, 2]}, {}, ValueError, r"one shape, got \[\(1,\), \(2,\)\]"),
        (nothing, {"x": [1]}, {}, TypeError, "must return a number or an array, got .*None"),
        (lambda x: x, {"x": [1]}, {"executor": None}, TypeError, "function cannot be sent .* def"),
        (abs_of, {"x": [lambda: 1]}, {"executor": None}, TypeError, "grid cannot be sent"),
        (abs_of, {"x": [2, lambda: 1]}, {"executor": None}, TypeError, "grid cannot be sent"),
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused(function, grid, options, error, message):
    with pytest.raises(error, match=message):
        sb.sweep(function, grid, **{"executor": Inline(), "progress": False} | options)


def test_errors_survive_a_process():
    run = sb.simulate(lambda x: -x, [1.0], duration=1.0)
    divergence = sb.DivergenceError("far", time=2.0, state=np.array([1.0]), trajectory=run)
    divergence.add_note("a note") if hasattr(divergence, "add_note") else None
    again = pickle.loads(pickle.dumps(divergence))
    assert (str(again), again.time, again.state) == ("far", 2.0, [1.0])
    assert getattr(again, "__notes__", 0) == getattr(divergence, "__notes__", 0)
    np.testing.assert_array_equal(again.trajectory.states, run.states)
    infeasible = sb.InfeasiblePathError("no", constraint="torque", s=0.3)
    again = pickle.loads(pickle.dumps(infeasible))
    assert (str(again), again.constraint, again.s) == ("no", "torque", 0.3)
