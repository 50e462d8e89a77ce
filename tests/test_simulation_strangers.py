"""What strangers send to the rooms of simulation: right, or refused in words that help."""

from __future__ import annotations

import copy
import itertools
import math
import pickle
from concurrent.futures import ThreadPoolExecutor

import control
import numpy as np
import pytest

import statebook as sb

PARTICLE, START = sb.Particle(), [1.0, 0.0]
LAG = control.ss([[-1.0]], [[1.0]], [[1.0]], 0, name="lag")


# ---- policies ----


def swapped(t, x):
    return -x[:1]


def of_time(t):
    return np.sin(t)


def of_state(state):
    return -state[:1]


@pytest.mark.parametrize("policy", [swapped, of_time, of_state, np.poly1d([1, 0])])
@pytest.mark.parametrize(
    "run",
    [
        lambda u: sb.simulate(PARTICLE, START, u, duration=1),
        lambda u: sb.simulate_clocked(PARTICLE, START, u, period=0.1, duration=1),
        lambda u: sb.monte_carlo(PARTICLE, START, u, number=2, period=0.1, duration=1),
        lambda u: sb.delay_margin(PARTICLE, u, START),
    ],
)
def test_a_policy_of_other_arguments_is_refused_not_misread(run, policy):
    with pytest.raises(TypeError, match=r"(u|policy) must take \(x, t\), got a function of"):
        run(policy)


@pytest.mark.parametrize(
    "run",
    [
        lambda u: sb.simulate_clocked(PARTICLE, START, u, period=0.1, duration=2),
        lambda u: sb.simulate(PARTICLE, START, u, duration=2),
        lambda u: sb.simulate(sb.discretize(PARTICLE, 0.1), START, u, duration=2),
    ],
)
@pytest.mark.parametrize(
    "number",
    [lambda t: math.sqrt(0.45 - t), lambda t: math.log(0.45 - t), lambda t: 1 / (t < 0.4)],
)
def test_why_a_policy_has_no_value_is_told_with_time_and_state(run, number):
    with pytest.raises(sb.DivergenceError, match=r"(domain error|division by zero|expected a)"):
        run(lambda x, t: [number(t)])


@pytest.mark.parametrize("period", [None, 0.1])
def test_a_policy_whose_values_run_out(period):
    def run(u):
        if period:
            return sb.simulate_clocked(PARTICLE, START, u, period=period, duration=1)
        return sb.simulate(PARTICLE, START, u, duration=1)

    measured = iter([1.0] * 5)
    with pytest.raises(RuntimeError, match=r"u\(x, t\) had no further value at t = 0\."):
        run(lambda x, t: next(measured))


@pytest.mark.parametrize(
    "run",
    [
        lambda u: sb.monte_carlo(PARTICLE, START, u, number=2, period=0.1, duration=1),
        lambda u: sb.delay_margin(PARTICLE, u, START),
        lambda u: sb.simulate(PARTICLE, START, duration=1, events=u),
    ],
)
def test_no_domain_error_from_inside_at_the_start(run):
    with pytest.raises(ValueError, match=r"(?s)has no value at t = 0, x = .*math domain error"):
        run(lambda x, t: math.sqrt(-1.0))


def test_monte_carlo_asks_once_a_tick_from_the_start_on():
    for system in (PARTICLE, lambda x, u: [x[1], u[0]]):
        asked = []
        sb.monte_carlo(
            system,
            START,
            lambda x, t, asked=asked: (asked.append(t), -x[0])[1],
            number=2,
            period=0.1,
            duration=0.3,
        )
        assert asked == [0.0, 0.1, 0.2]


# ---- systems ----


class Slow(sb.Pendulum):
    """A pendulum whose time runs at half the speed."""

    def dynamics(self, x, u=None):
        return super().dynamics(x, u) / 2


class Biased(sb.Particle):
    def dynamics(self, x, u=None):
        return super().dynamics(x, u) + np.array([0.0, 1.0]).reshape(-1, *[1] * (np.ndim(x) - 1))


def test_a_model_with_dynamics_of_its_own_is_simulated_by_them():
    slow = sb.simulate(Slow(), [0.3, 0.0], duration=2.0)
    np.testing.assert_allclose(
        slow.states, sb.simulate(sb.Pendulum(), [0.3, 0.0], duration=1.0).states, atol=1e-7
    )
    run = sb.simulate_clocked(Biased(), np.zeros((2, 3)), [0.0], period=0.5, duration=1.0)
    np.testing.assert_allclose(run.states[:, :, -1].T, [[0.5, 1.0]] * 3, rtol=1e-9)


@pytest.mark.parametrize("kind", [sb.Particle, sb.Pendulum, control.StateSpace])
def test_a_class_is_no_system(kind):
    with pytest.raises(TypeError, match="system must be an instance, got the class"):
        sb.simulate(kind, START, duration=1)


def rate(x, u):
    return np.stack([x[1], u[0] - x[1]])


def push(t, x, u, params):
    return [x[1], u[0]]


SYSTEMS = {
    "model": lambda: sb.as_system(sb.Pendulum(damping=0.1)),
    "own dynamics": lambda: sb.as_system(Slow()),
    "state space": lambda: sb.as_system(LAG),
    "discrete": lambda: sb.as_system(sb.discretize(LAG, 0.1)),
    "function": lambda: sb.as_system(rate, START, [0.0]),
    "nonlinear": lambda: sb.as_system(control.nlsys(push, None, inputs=1, outputs=2, states=2)),
    "disturbed": lambda: sb.with_disturbance(LAG),
    "parameters": lambda: sb.with_parameters(PARTICLE, ["m"]),
    "regulated": lambda: sb.LQR(LAG, [0.0], tracked=[[1.0]], integral=1.0).loop,
    "PID": lambda: sb.PID(LAG, [3.0], 2.0, 1.0, 0.1).loop,
}


@pytest.mark.parametrize("kind", SYSTEMS)
def test_systems_pickle_and_are_copied(kind):
    system = SYSTEMS[kind]()
    x, u = np.linspace(0.5, 1.5, system.n), np.linspace(0.2, 0.3, system.m)
    for again in (pickle.loads(pickle.dumps(system)), copy.deepcopy(system)):
        assert (again.states, again.inputs, again.dt) == (system.states, system.inputs, system.dt)
        np.testing.assert_array_equal(again.dynamics(x, u), system.dynamics(x, u))


def test_linear_systems_and_reports_of_them_pickle_with_their_labels():
    lag = control.ss([[-1.0]], [[1.0]], [[2.0]], [[0.5]], 0.1, states="a", inputs="b", outputs="c")
    delayed = sb.with_input_delay(lag, 0.3)
    for sys in (lag, delayed, sb.linearize(sb.Pendulum(), [-np.pi / 2, 0.0])):
        again = pickle.loads(pickle.dumps(sys))
        assert (again.state_labels, again.input_labels) == (sys.state_labels, sys.input_labels)
        assert (again.output_labels, again.name, again.dt) == (sys.output_labels, sys.name, sys.dt)
        for name in "ABCD":
            np.testing.assert_array_equal(getattr(again, name), getattr(sys, name))
    report = sb.stability(sb.Pendulum(damping=0.1), [-np.pi / 2, 0.0])
    assert pickle.loads(pickle.dumps(report)).verdict == report.verdict


def test_what_does_not_pickle_is_named():
    system = sb.as_system(lambda x: -x, [1.0])
    with pytest.raises((AttributeError, pickle.PicklingError), match="<lambda>"):
        pickle.dumps(system)
    assert copy.deepcopy(system).dynamics([2.0]) == -2.0


@pytest.mark.parametrize("function", [sb.discretize, sb.with_input_delay])
def test_a_function_is_told_to_be_linearized_first(function):
    with pytest.raises(ValueError, match=r"sys must be linear; call linearize"):
        function(lambda x, u: -x + u, 0.1)


# ---- times ----


def test_numbers_of_single_precision_mean_their_decimals():
    tenth, asked = np.float32(0.1), []
    run = sb.simulate_clocked(
        PARTICLE, START, lambda x, t: (asked.append(t), 0.0)[1], period=tenth, duration=0.3
    )
    assert asked == [0.0, 0.1, 0.2] and run.times[-1] == 0.3
    noise = sb.HeldNoise(1.0, tenth, seed=1)
    pushed = sb.monte_carlo(
        PARTICLE, START, number=1, period=0.1, duration=0.3, disturbance=noise, G=[[0], [1]]
    )
    same = [sb.HeldNoise(1.0, 0.1, seed=1)(t)[0] for t in (0.0, 0.1, 0.2)]
    np.testing.assert_array_equal(pushed.controls[1, 0], same)
    assert sb.with_input_delay(sb.discretize(LAG, 0.1), np.float32(0.2)).nstates == 3
    assert sb.as_system(lambda x: x / 2, [1.0], dt=np.array(tenth)).dt == 0.1


def test_times_of_single_precision_are_samples():
    plant = sb.discretize(LAG, 0.1)
    times = np.arange(20, dtype=np.float32) * np.float32(0.1)
    run = sb.simulate(plant, [1.0], times=times)
    np.testing.assert_allclose(run.states[0], np.exp(-0.1 * np.arange(20)), rtol=1e-12)
    assert run.times[3] == 0.3
    with pytest.raises(ValueError, match=r"times must be whole samples of dt = 0\.1"):
        sb.simulate(plant, [1.0], times=[0.0, 0.1001])


# ---- events ----


def marked(**options):
    def high(x, t):
        return x[0] - 0.5

    vars(high).update(options)
    return high


@pytest.mark.parametrize(
    ("terminal", "found"), [(None, 3), (0, 3), (False, 3), (True, 1), (np.True_, 1), (2.0, 2)]
)
def test_what_ends_a_run_is_what_ends_it_in_scipy(terminal, found):
    run = sb.simulate(sb.Oscillator(), [1.0, 0.0], duration=8.0, events=marked(terminal=terminal))
    assert len(run.events) == found


@pytest.mark.parametrize("terminal", [1.5, -1, "yes", math.nan, [1, 2]])
def test_no_other_end_of_a_run(terminal):
    with pytest.raises(ValueError, match=r"terminal of event high must be a bool or a count|truth"):
        sb.simulate(sb.Oscillator(), [1.0, 0.0], duration=8.0, events=marked(terminal=terminal))


def test_an_event_of_the_time_alone_and_one_that_is_no_number():
    for alone in (lambda t: t - 1.5, lambda time: time - 1.5):
        run = sb.simulate(lambda x: -x, [1.0], duration=2.0, events=alone)
        assert [event.time for event in run.events] == pytest.approx([1.5])
    for bad in (lambda x, t: math.nan, lambda x, t: math.nan if t > 1 else -1.0):
        with pytest.raises(TypeError, match=r"must return one real number .* got array\(nan\)"):
            sb.simulate(lambda x: -x, [1.0], duration=2.0, events=bad)


# ---- delays, sweeps, checks, swings ----


def test_a_margin_is_that_of_an_equilibrium():
    with pytest.raises(sb.NotAnEquilibriumError, match="x0 is not an equilibrium"):
        sb.delay_margin(sb.Pendulum(), lambda x, t: -20 * x[:1] - 5 * x[1:], [0.0, 0.0])


def drawn(a, rng):
    return rng.normal()


def test_a_sweep_without_order_or_seed_is_refused():
    with ThreadPoolExecutor(1) as pool:
        for grid in ({"a": {1, 2}}, {"a": frozenset("xy")}, {"a": {}.keys()}):
            with pytest.raises(TypeError, match="grid must hold a sequence of values of a"):
                sb.sweep(lambda a: a, grid, executor=pool, progress=False)
        with pytest.raises(TypeError, match="seed is required for a function with a parameter rng"):
            sb.sweep(drawn, {"a": [1, 2]}, executor=pool, progress=False)


def test_exact_checks_of_integers_are_exact(capsys):
    for value, expected in itertools.product([2**60, 2**60 + 1], repeat=2):
        sb.check("large", value, expected, rtol=0)
        assert ("FAILED" in capsys.readouterr().out) == (value != expected)
    with pytest.raises(ValueError, match=r"claim: shapes \(2,\), \(3,\) must agree"):
        sb.check("claim", [1, 2], [1, 2, 3])
    with pytest.raises(AssertionError):
        sb.summary()


@pytest.mark.parametrize(("gain", "damping"), [(1e-3, 0.0), (1e-3, 0.05), (0.1, 0.05)])
def test_a_weak_swing_starts_without_chatter(gain, damping):
    swing = sb.SwingUp(sb.Pendulum(damping=damping), limit=2.0, gain=gain)
    calls = itertools.count()
    run = sb.simulate(
        swing.pendulum,
        [-np.pi / 2, 0.0],
        lambda x, t: (next(calls), swing(x, t))[1],
        duration=1.0,
        rtol=1e-5,
        atol=1e-7,
    )
    assert next(calls) < 3_000  # 200 steps of six, and those beside a turn
    assert np.abs(run.states[0] + np.pi / 2).max() > 0.1
