"""Runs in blocks: the same numbers wherever they are simulated, kept or folded."""

from __future__ import annotations

from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from clusterable import gusty, leaping
from statebook.uncertainty.noise import PAGE, counted_from
from test_sweep import Inline

STARTS = np.linspace(0.5, 2.0, 37)[None, :]


def decaying(number=37, **options):
    """Return runs that end at their starts times exp(-0.5)."""
    return sb.monte_carlo(
        decay,
        STARTS[:, :number],
        number=number,
        period=0.25,
        duration=0.5,
        progress=False,
        **options,
    )


def decay(x):
    return -x


def still(x):
    return 0 * x


def leap(x):
    """Blow up before t = 1 where x begins above 1."""
    return leaping(x)


def ends(run):
    return run.states[0, :, -1]


@pytest.mark.parametrize("chunk", [1, 5, 36, 37, 100])
def test_runs_come_in_order(chunk):
    run = decaying(executor=Inline(), chunk=chunk)
    np.testing.assert_allclose(ends(run), STARTS[0] * np.exp(-0.5), rtol=1e-7)
    whole = decaying()
    np.testing.assert_array_equal(run.times, whole.times)
    assert repr(run) == repr(whole) and run.controls is None


@pytest.mark.parametrize("method", ["RK45", "rk4"])
def test_the_same_numbers_on_any_executor(method):
    options = {"number": 50, "method": method, "chunk": 8}
    whole, here = gusty(number=50, method=method), gusty(executor=Inline(), **options)
    assert (here.state_labels, here.input_labels) == (whole.state_labels, whole.input_labels)
    for pool in (ThreadPoolExecutor(3), ProcessPoolExecutor(2)):
        with pool:
            there = gusty(executor=pool, **options)
        np.testing.assert_array_equal(there.states, here.states)
        np.testing.assert_array_equal(there.controls, here.controls)
    np.testing.assert_allclose(here.states, whole.states, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(here.controls, whole.controls, rtol=1e-6, atol=1e-6)
    by_default = [gusty(number=50, executor=pool) for pool in (Inline(), ThreadPoolExecutor(5))]
    np.testing.assert_array_equal(*(run.states for run in by_default))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 3 * PAGE), st.integers(1, PAGE + 5), st.integers(0, 9))
def test_a_trajectory_has_its_own_noise_in_any_block(first, number, tick):
    noise = sb.HeldNoise(1.0, 0.1, seed=8)
    t = 0.1 * tick
    with counted_from(first):
        block = noise(t, number)
    assert noise(t, number).tolist() == noise(t, first + number)[:, :number].tolist()
    np.testing.assert_array_equal(block, noise(t, first + number)[:, first:])


def test_pages_of_noise_are_independent():
    values = sb.HeldNoise(1.0, 0.1, seed=8)(0.3, 4 * PAGE).reshape(4, PAGE)
    off = np.corrcoef(values)[np.triu_indices(4, 1)]
    assert np.abs(off).max() < 6 / np.sqrt(PAGE) and len(np.unique(values)) == values.size


def test_moments_are_those_of_the_runs():
    kept = gusty(number=101)
    found = gusty(number=101, executor=Inline(), chunk=7, reduce="moments")
    np.testing.assert_array_equal(found.times, kept.times)
    np.testing.assert_allclose(found.mean, kept.states.mean(axis=1), atol=1e-7)
    for k in (3, -1):
        expected = np.cov(kept.states[:, :, k])
        np.testing.assert_allclose(found.covariance[..., k], expected, rtol=1e-6, atol=1e-8)
    assert repr(found) == "Moments(101 runs, n=2, 6 times over [0, 0.5] s)"


def test_moments_of_a_gusty_particle_are_their_closed_form():
    number = 3 * PAGE + 1  # over pages
    found = gusty(number=number, reduce="moments", method="rk4")
    assert found.number == number
    t = found.times[-1]
    steps = round(t / 0.1)
    exact = np.array([[t**3 / 3 * (1 - 1 / (4 * steps**2)), t**2 / 2], [t**2 / 2, t]]) * 0.5
    spread = np.sqrt((exact**2 + np.outer(np.diag(exact), np.diag(exact))) / number)
    assert (np.abs(found.covariance[..., -1] - exact) < 6 * spread).all()
    assert (np.abs(found.mean[:, -1]) < 6 * np.sqrt(np.diag(exact) / number)).all()


def test_moments_far_from_zero_lose_nothing():
    starts = 1e8 + np.random.default_rng(4).normal(size=(2, 211))
    found = sb.monte_carlo(
        still, starts, number=211, period=1.0, duration=1.0, chunk=13, reduce="moments",
        progress=False,
    )  # fmt: skip
    np.testing.assert_allclose(found.covariance[..., -1], np.cov(starts), rtol=1e-6, atol=1e-8)


def test_a_reduction_of_ones_own_is_folded_in_order():
    def digits(total, value):
        return 1000 * total + value

    def first(run):
        return round(10 * run.states[0, 0, 0])

    total = decaying(executor=ThreadPoolExecutor(4), chunk=10, reduce=(first, digits))
    assert total == int("".join(f"{round(10 * STARTS[0, i]):03}" for i in (0, 10, 20, 30)))
    assert decaying(reduce=(ends, in_place)).shape == (1,)


def in_place(total, value):
    total += value
    return total


@pytest.mark.parametrize("pool", [Inline, ProcessPoolExecutor])
def test_a_run_that_fails_is_named(pool):
    starts = np.where(np.arange(60) == 37, 5.0, 0.1)[None, :]
    noise = sb.HeldNoise(0.0, 0.5, seed=11)
    call = {"number": 60, "period": 0.5, "duration": 1.0, "disturbance": noise, "progress": False}
    with pytest.raises(
        RuntimeError, match=r"run 37 from x0 = \[5\.\], noise of seed 11, failed: D"
    ):
        sb.monte_carlo(leap, starts, executor=pool(), chunk=25, **call)


def test_a_policy_that_fails_in_one_run_alone_is_named():
    def policy(x, t):
        if (x[0] > 0.99).any():
            raise ArithmeticError("too far")
        return 0 * x[:1]

    starts = np.linspace(0, 1, 30) * [[1.0], [0.0]]
    with pytest.raises(RuntimeError, match=r"(?s)run 29 from x0 = .*no value at t = 0, .*too far"):
        sb.monte_carlo(
            sb.Particle(), starts, policy, number=30, period=0.1, duration=0.2, chunk=9,
            progress=False,
        )  # fmt: skip


def test_runs_that_fail_together_are_named_together():
    def policy(x, t):
        if x.shape[1] > 3:
            raise ValueError("too many")
        return 0 * x[:1]

    with pytest.raises(RuntimeError, match=r"run 8 to 11 failed: ValueError: too many"):
        sb.monte_carlo(
            sb.Particle(), np.zeros((2, 12)), policy, number=12, period=0.1, duration=0.2,
            executor=FailingFirst(), chunk=4, progress=False,
        )  # fmt: skip


class FailingFirst(Inline):
    """Runs the last task alone."""

    def submit(self, function, *arguments):
        if arguments[2:] and arguments[2] < 2:
            return Future()
        return super().submit(function, *arguments)


@pytest.mark.parametrize("reduce", [None, "moments", (ends, np.add)])
def test_an_interrupted_call_goes_on_with_the_same_numbers(tmp_path, monkeypatch, reduce):
    from statebook.uncertainty import monte_carlo as room

    simulated, done = room._simulated, []

    def counting(errors, options, start):
        if len(done) == 5:
            raise KeyboardInterrupt
        done.append(start)
        return simulated(errors, options, start)

    options = {"number": 40, "chunk": 4, "reduce": reduce, "executor": Inline()}
    whole = gusty(**options)
    monkeypatch.setattr(room, "_simulated", counting)
    with pytest.raises(KeyboardInterrupt):
        gusty(**options, cache=tmp_path / "runs.npz")
    done[:] = [None] * 6
    again = gusty(**options, cache=tmp_path / "runs.npz")
    assert len(done) == 6 + 5
    if reduce == "moments":
        np.testing.assert_array_equal(again.covariance, whole.covariance)
    else:
        again, whole = ((r.states if reduce is None else r) for r in (again, whole))
        np.testing.assert_array_equal(again, whole)
    with pytest.raises(ValueError, match="is of another function"):
        gusty(**{**options, "seed": 2}, cache=tmp_path / "runs.npz")


class Drawing:
    """A policy that draws from a generator of its own."""

    def __init__(self):
        self.rng = np.random.default_rng(1)

    def __call__(self, x, t):
        return self.rng.normal(size=(1, x.shape[1]))

    def act(self, x, t):
        return self(x, t)


RNG = np.random.default_rng(2)


@pytest.mark.parametrize(
    ("policy", "name"),
    [
        (Drawing(), "rng"),
        (Drawing().act, "rng"),
        (lambda x, t: RNG.normal(size=(1, x.shape[1])), "RNG"),
        (sb.with_actuation_error(Drawing(), sb.HeldNoise(1.0, 0.1, seed=1)), "rng"),
    ],
)
def test_a_generator_that_blocks_would_repeat_is_refused(policy, name):
    call = {"number": 4, "period": 0.1, "duration": 0.2, "progress": False}
    sb.monte_carlo(sb.Particle(), [0.0, 0.0], policy, **call)  # all at once: nothing repeats
    with pytest.raises(ValueError, match=rf"policy must not draw from the generator {name}: each"):
        sb.monte_carlo(sb.Particle(), [0.0, 0.0], policy, chunk=2, **call)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"reduce": "mean"}, ValueError, "reduce must be one of moments"),
        ({"reduce": np.add}, TypeError, r'"moments" or \(statistic, merge\)'),
        ({"reduce": (ends, 0)}, TypeError, r'"moments" or \(statistic, merge\)'),
        ({"reduce": "moments", "number": 1}, ValueError, "number must be at least 2"),
        ({"chunk": 0}, ValueError, "chunk must be at least 1"),
        ({"chunk": 2.5}, TypeError, "chunk must be"),
        ({"executor": ThreadPoolExecutor}, TypeError, "executor must be a"),
        ({"cache": "missing/c"}, FileNotFoundError, "missing"),
        ({"reduce": (lambda run: None, max), "chunk": 9}, TypeError, "must return a number"),
    ],
)
def test_what_cannot_work_is_refused(options, error, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        decaying(**options)


def test_progress_is_shown_unless_not_wanted(capsys):
    gusty(number=6, chunk=2, progress=True)
    assert "3/3" in capsys.readouterr().err
    gusty(number=6, chunk=2)
    gusty(number=6, progress=True)
    assert capsys.readouterr().err == ""
