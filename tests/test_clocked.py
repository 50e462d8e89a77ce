"""A sampled controller: its ticks, its delays, what it leaves behind."""

import control
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook import simulate_clocked

A = np.array([[0.0, 1.0], [-2.0, -0.3]])
B = np.array([[0.0], [1.5]])
K = np.array([[1.0, 0.7]])


def plant(x, u):
    return A @ x + B @ u


def over(h):
    """Exact map of the plant under a held input: x, u -> x after h."""
    M = np.zeros((3, 3))
    M[:2, :2], M[:2, 2:] = A, B
    E = scipy.linalg.expm(M * h)
    return E[:2, :2], E[:2, 2:]


def test_one_call_a_tick_from_the_start_on():
    calls = []

    def policy(x, t):
        calls.append((t, x.copy()))
        return [float(len(calls))]

    run = simulate_clocked(plant, [1.0, 0.0], policy, period=0.1, duration=0.72, samples=3)
    assert [t for t, _ in calls] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    assert run.controls[0, ::3].tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    for k, (t, x) in enumerate(calls):
        assert run.times[3 * k] == t
        assert np.allclose(run.states[:, 3 * k], x, atol=1e-14)


@settings(max_examples=25, deadline=None)
@given(
    period=st.sampled_from([0.1, 0.25, 1 / 3]),
    parts=st.integers(0, 9),  # quarters of a period of delay
    samples=st.integers(1, 3),
    method=st.sampled_from(["RK45", "DOP853", "LSODA"]),
)
def test_computation_delays_of_whole_and_part_ticks(period, parts, samples, method):
    delay, ticks, before = parts * period / 4, 6, -0.4
    run = simulate_clocked(
        plant,
        [1.0, 0.0],
        lambda x, t: -K @ x,
        period=period,
        duration=ticks * period,
        samples=samples,
        delay=delay,
        u_before=before,
        method=method,
    )
    # The exact maps, quarter by quarter.
    Ad, Bd = over(period / 4)
    x, commands, acting = np.array([1.0, 0.0]), [], np.array([before])
    for quarter in range(4 * ticks):
        if quarter % 4 == 0:
            assert np.allclose(run(quarter / 4 * period), x, atol=1e-6)
            commands.append((quarter + parts, -K @ x))
        for when, command in commands:
            if when == quarter:
                acting = command
        assert np.allclose(run.control_at((quarter + 0.5) / 4 * period), acting, atol=1e-6)
        x = Ad @ x + Bd @ acting
    assert np.allclose(run.states[:, -1], x, atol=1e-6)
    assert run.control_hold == "interval"


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1])
def test_a_replay_repeats_the_run_to_rounding(delay):
    run = simulate_clocked(
        sb.Pendulum(), [1.0, 0.0], lambda x, t: -5 * x[1:], period=0.1, duration=3.0, delay=delay
    )
    again = sb.simulate(sb.Pendulum(), *run.to_control_space(), times=run.times)
    assert np.abs(again.states - run.states).max() < 1e-13


@pytest.mark.parametrize("shape", ["(N,)", "(1, N)", "(1,)"])
@pytest.mark.parametrize("system", [plant, sb.Particle()])
def test_a_batch_is_seen_as_a_whole(shape, system):
    x0 = np.array([[1.0, 0.0, -2.0], [0.0, 0.5, 1.0]])
    policy = {
        "(N,)": lambda x, t: -x[0] - x[1],
        "(1, N)": lambda x, t: [-x[0] - x[1]],
        "(1,)": lambda x, t: [1.0],
    }[shape]
    many = simulate_clocked(system, x0, policy, period=0.2, duration=1.0)
    assert many.controls.shape == (1, 3, 20)
    for i in range(3):
        alone = simulate_clocked(system, x0[:, i], policy, period=0.2, duration=1.0)
        assert np.allclose(many.states[:, i], alone.states, atol=1e-7)
        assert np.allclose(many.controls[:, i], alone.controls, atol=1e-7)


def test_a_batch_of_two_inputs():
    x0 = np.zeros((2, 4))
    run = simulate_clocked(
        lambda x, u: u, x0, lambda x, t: np.ones((2, 4)) * t, period=0.5, duration=1.0
    )
    assert np.allclose(run.states[..., -1], 0.25)
    assert run.control_at(0.75).shape == (2, 4)


def test_labels_and_dense_output():
    run = simulate_clocked(sb.Pendulum(), [1.0, 0.0], lambda x, t: 0.0, period=0.5, duration=2.0)
    free = sb.simulate(sb.Pendulum(), [1.0, 0.0], duration=2.0)
    assert (run.state_labels, run.input_labels) == (("theta", "omega"), ("torque",))
    assert np.allclose(run(free.times), free.states, atol=1e-6)


@pytest.mark.parametrize(
    "policy", [sb.ControlTrajectory.piecewise_linear([0, 2], [0, 4]), lambda x, t: 2 * t]
)
def test_control_trajectories_are_sampled_at_the_ticks(policy):
    run = simulate_clocked(sb.Particle(), [0, 0], policy, period=0.5, duration=2.0, samples=1)
    assert run.controls[0] == pytest.approx([0, 1, 2, 3])
    assert run.states[1, -1] == pytest.approx(3.0)
    held = simulate_clocked(sb.Particle(), [0, 0], [2.0], period=0.5, duration=2.0)
    assert held.states[1, -1] == pytest.approx(4.0)


def test_the_whole_run_is_kept_on_divergence():
    with pytest.raises(sb.DivergenceError) as caught:
        simulate_clocked(lambda x, u: x**2 + u, [1.0], lambda x, t: 0.0, period=0.1, duration=2.0)
    run = caught.value.trajectory
    assert run.times[-1] == pytest.approx(1.0, abs=0.03)
    before = run.times < 0.95
    assert np.allclose(run.states[0, before], 1 / (1 - run.times[before]), rtol=1e-5)
    assert run.controls.shape == (1, len(run.times) - 1)
    assert run(0.123) == pytest.approx(1 / (1 - 0.123))


@pytest.mark.parametrize("method", ["euler", "rk4"])
def test_fixed_steps_make_one_a_sample(method):
    run = simulate_clocked(
        plant, [1.0, 0.0], lambda x, t: -K @ x, period=0.2, duration=1.0, samples=5, method=method
    )
    x = np.array([1.0, 0.0])
    for k in range(25):
        if k % 5 == 0:
            u = -K @ x
        _, xs = sb.integrate(lambda x, t, u=u: plant(x, u), x, 1, 0.04, method=method)
        x = xs[-1]
    assert np.allclose(run.states[:, -1], x, rtol=1e-12)


def test_a_plant_in_discrete_time():
    sys = control.ss([[1.0]], [[1.0]], [[1.0]], 0, dt=0.1)
    calls = []

    def policy(x, t):
        calls.append(t)
        return -0.5 * x

    run = simulate_clocked(sys, [1.0], policy, period=0.2, duration=0.6, samples=2, delay=0.1)
    assert calls == [0.0, 0.2, 0.4]
    # u = 0, -0.5, -0.5, -0.25, ...: what was seen at 0, 0.2, acts a sample later.
    assert run.controls[0] == pytest.approx([0, -0.5, -0.5, -0.25, -0.25, 0.125])
    assert run.states[0] == pytest.approx([1, 1, 0.5, 0, -0.25, -0.5, -0.375])
    prompt = simulate_clocked(sys, [1.0], policy, period=0.2, duration=0.4, samples=2)
    assert prompt.controls[0] == pytest.approx([-0.5, -0.5, 0, 0])
    assert prompt.states[0] == pytest.approx([1, 0.5, 0, 0, 0])
    with pytest.raises(ValueError, match=r"period / samples must be whole samples of dt = 0.1"):
        simulate_clocked(sys, [1.0], policy, period=0.2, duration=0.6, samples=4)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"period": 0}, ValueError, "period must be greater than 0"),
        ({"duration": np.nan}, ValueError, "duration must be finite"),
        ({"samples": 0}, ValueError, "samples must be at least 1"),
        ({"samples": 1.5}, TypeError, "samples must be an integer"),
        ({"delay": -0.1}, ValueError, "delay must be at least 0"),
        ({"x0": [np.nan, 0]}, ValueError, "x0 must be finite"),
        ({"x0": [1.0, 0, 0]}, ValueError, "x0 must have n = 2 rows"),
        ({"policy": lambda x, t: [1, 2]}, ValueError, r"policy\(x, t\) must have shape \(1,\)"),
        ({"policy": lambda x, t: np.nan}, ValueError, r"policy\(x0, 0\) must be finite"),
        ({"policy": lambda x, t: None}, TypeError, r"policy\(x0, 0\) must be"),
        ({"policy": "bang"}, TypeError, r"policy\(x0, 0\) must be"),
        ({"u_before": [1, 2]}, ValueError, r"u_before must have shape \(1,\)"),
        ({"method": "RK54"}, ValueError, "method must be one of"),
        ({"rtol": -1}, ValueError, "rtol must be greater than 0"),
    ],
)
def test_bad_arguments(arguments, error, message):
    good = {"system": sb.Pendulum(), "x0": [1.0, 0.0], "policy": 0.0, "period": 1, "duration": 2}
    calls = []
    with pytest.raises(error, match=message):
        simulate_clocked(**(good | arguments))
    assert not calls


def test_a_policy_that_fails_later_is_a_divergence():
    with pytest.raises(sb.DivergenceError, match=r"u\(x, t\) is not finite at t = 0.5") as caught:
        simulate_clocked(
            plant, [1, 0], lambda x, t: np.nan if t > 0.4 else 1.0, period=0.25, duration=2.0
        )
    assert caught.value.trajectory.times[-1] == 0.5
