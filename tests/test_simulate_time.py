"""Simulation in time: pulses, switches, events, samples of a control, long runs, domains."""

import math
import pickle
import warnings

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook import simulate

SOLVERS = ("RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA")


def double_integrator(x, u):
    return np.stack([x[1], u[0]])


def fall(x):
    return np.stack([x[1], 0 * x[1] - 9.8])


def pulse(start, end, height=100.0):
    return lambda x, t: height if start <= t < end else 0.0


# --- pulses


@pytest.mark.parametrize("method", SOLVERS)
def test_no_pulse_longer_than_an_output_interval_is_missed(method):
    run = simulate(
        double_integrator, [0.0, 0.0], pulse(5.02, 5.08), duration=10.0, method=method
    )  # samples 0.05 apart
    v = 100 * 0.06
    assert run.states[:, -1] == pytest.approx([v * 4.92 + v * 0.03, v], rel=1e-5)


@settings(max_examples=20, deadline=None)
@given(
    start=st.floats(0.5, 8.0),
    width=st.floats(1.01, 5.0),
    height=st.sampled_from([-3.0, 1e-2, 50.0, 1e4]),
    gap=st.sampled_from([0.02, 0.1, 0.25]),
)
def test_pulses_of_any_place_width_and_height(start, width, height, gap):
    times = np.arange(round(10 / gap) + 1) * gap
    end = min(start + width * gap, 9.9)
    run = simulate(double_integrator, [0.0, 0.0], pulse(start, end, height), times=times)
    assert run.states[1, -1] == pytest.approx(height * (end - start), rel=1e-4)


@pytest.mark.parametrize("method", ["RK45", "LSODA", "BDF"])
def test_the_output_interval_is_the_one_at_the_pulse(method):
    times = [*np.linspace(0, 1, 11), 50.0, 100.0]
    run = simulate(double_integrator, [0.0, 0.0], pulse(0.52, 0.64), times=times, method=method)
    assert run.states[1, -1] == pytest.approx(12.0, rel=1e-5)


def test_a_pulse_inside_the_system_itself():
    sys = control.nlsys(lambda t, x, u, params: [x[1], pulse(5.02, 5.08)(x, t)], states=2, inputs=0)
    assert simulate(sys, [0.0, 0.0], duration=10.0).states[1, -1] == pytest.approx(6.0, rel=1e-5)


def test_a_pulse_in_a_function_of_the_time():
    def f(x, u, t):
        return [x[1], u[0] + pulse(5.02, 5.08)(x, t)]

    run = simulate(f, [0.0, 0.0], [0.5], duration=10.0)
    assert run.states[1, -1] == pytest.approx(5.0 + 6.0, rel=1e-5)


def test_a_pulse_on_a_batch():
    run = simulate(double_integrator, np.zeros((2, 3)), pulse(5.02, 5.08), duration=10.0)
    assert run.states[1, :, -1] == pytest.approx([6.0] * 3, rel=1e-5)


@pytest.mark.parametrize(
    "option", [{"max_step": 0.004}, {"switches": [5.0, 5.01]}, {"switches": [5.01, 5.0, 5.01]}]
)
def test_narrow_pulses_by_choice(option):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = simulate(double_integrator, [0.0, 0.0], pulse(5, 5.01), duration=10.0, **option)
    assert run.states[:, -1] == pytest.approx([4.995, 1.0], rel=1e-5)


def test_switches_are_exact_to_rounding():
    run = simulate(
        double_integrator, [0.0, 0.0], pulse(1 / 3, 2 / 3), times=[0, 1], switches=[1 / 3, 2 / 3]
    )
    v = 100 / 3
    assert run.states[:, -1] == pytest.approx([v * (1 / 3 + 1 / 6), v], rel=1e-13)


@pytest.mark.parametrize("method", ["RK45", "BDF", "rk4"])
def test_switches_where_nothing_changes_cost_nothing(method):
    calls = []

    def policy(x, t):
        calls.append(t)
        return [np.sin(t)]

    counts = []
    for switches in ([], [-1.0, 0.0, 1e-15, 2.0 - 1e-15, 2.0, 3.0]):
        calls.clear()
        simulate(
            double_integrator, [0.0, 0.0], policy, times=[0, 2], switches=switches, method=method
        )
        counts.append(len(calls))
    assert counts[0] == counts[1]


@pytest.mark.parametrize("method", SOLVERS)
def test_pulses_as_long_as_a_short_interval_between_long_ones(method):
    times = np.concatenate([[0.0, 4.9], np.arange(5.0, 5.45, 0.1), [10.0]])
    run = simulate(double_integrator, [0.0, 0.0], pulse(5.17, 5.27), times=times, method=method)
    # The speed is the pulse's area; 2e-3 is what a solver's step makes of its edges.
    assert run.states[1, -1] == pytest.approx(10.0, rel=2e-3)


@pytest.mark.parametrize("method", SOLVERS)
def test_a_returned_control_that_the_motion_did_not_feel_is_told(method):
    with pytest.warns(UserWarning, match="control returned at t = 5 is not one that the motion"):
        simulate(double_integrator, [0.0, 0.0], pulse(5, 5.001), duration=10.0, method=method)


def test_no_such_warning_without_a_reason():
    # A jump of the policy in x and in t, each at a sample; loose tolerances; a stiff loop.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(double_integrator, [0.0, 0.0], pulse(5.0, 6.0), duration=10.0)
        simulate(double_integrator, [0.0, 0.0], lambda x, t: 1.0 - (x[0] > 0.5), duration=3.0)
        simulate(sb.Pendulum(), [1, 0], lambda x, t: np.sin(9 * t), duration=9.0, rtol=1e-3)
        simulate(lambda x, u: 1e3 * (u - x), [1.0], lambda x, t: np.cos(t), duration=2.0)
        simulate(sb.Pendulum(), [1, 0], lambda x, t: -x[1], times=[0, 20.0])


# --- events


def stops(function, **attributes):
    for name, value in attributes.items():
        setattr(function, name, value)
    return function


@pytest.mark.parametrize("method", SOLVERS)
@pytest.mark.parametrize("order", [lambda t, y: y[0], lambda x, t: x[0], lambda x: x[0]])
def test_a_terminal_event_ends_the_run(method, order):
    ground = stops(order, terminal=True, direction=-1, label="ground")
    run = simulate(fall, [1.0, 0.0], duration=3.0, events=ground, method=method)
    hit = np.sqrt(2 / 9.8)
    (event,) = run.events
    assert (event.label, event.time) == ("ground", run.times[-1])
    assert event.time == pytest.approx(hit, rel=1e-6)
    assert np.array_equal(event.state, run.states[:, -1])
    assert run.states[:, -1] == pytest.approx([0.0, -9.8 * hit], abs=1e-6)
    assert run.times[-2] < hit


def test_events_as_in_scipy():
    import scipy

    def height(t, y):
        return y[0] + 0.2

    def height_too(x, t):
        return x[0] + 0.2

    for direction in (-1.0, 0.0, 1.0):
        for terminal in (False, True, 2, 3):
            for function in (height, height_too):
                stops(function, direction=direction, terminal=terminal)
            exact = scipy.integrate.solve_ivp(
                lambda t, y: [y[1], -y[0]], (0, 20), [1.0, 0.0], events=height,
                rtol=1e-8, atol=1e-10,
            )  # fmt: skip
            run = simulate(
                lambda x: np.stack([x[1], -x[0]]), [1.0, 0.0], duration=20.0, events=height_too
            )
            times = [event.time for event in run.events]
            assert times == pytest.approx(exact.t_events[0], rel=1e-6)
            assert run.times[-1] == pytest.approx(exact.t[-1], rel=1e-6)


def test_events_by_label_in_order_of_time():
    run = simulate(
        sb.Pendulum(),
        [0.0, 0.0],
        duration=4.0,
        events={"bottom": lambda x, t: x[0] + np.pi / 2, "turn": lambda x, t: x[1]},
    )
    labels = [event.label for event in run.events]
    assert labels[:4] == ["bottom", "turn", "bottom", "turn"]
    assert np.all(np.diff([event.time for event in run.events]) > 0)
    assert run.events[1].state == pytest.approx([-np.pi, 0], abs=1e-6)
    assert repr(run.events[0]) == f"Event(bottom at t = {run.events[0].time:.6g} s)"
    again = pickle.loads(pickle.dumps(run))
    assert [event.time for event in again.events] == [event.time for event in run.events]


def test_an_event_that_begins_at_zero_has_not_happened():
    run = simulate(fall, [0.0, 4.9], duration=3.0, events=lambda x, t: x[0])
    assert [event.time for event in run.events] == pytest.approx([1.0], rel=1e-6)


def test_events_after_a_switch_and_under_a_clock():
    u = sb.ControlTrajectory.piecewise_constant([0, 1, 3], [1.0, -1.0])
    back = stops(lambda x, t: x[0] - 0.75, direction=-1)
    run = simulate(double_integrator, [0.0, 0.0], u, events=back)  # in one step with its rise
    assert [e.time for e in run.events] == pytest.approx([2 + np.sqrt(0.5)])
    stop = stops(lambda x, t: x[0] - 1.0, terminal=True)
    clocked = sb.simulate_clocked(
        double_integrator, [0, 0], lambda x, t: 2.0, period=0.3, duration=3, events=stop
    )
    assert clocked.times[-1] == pytest.approx(1.0)
    assert clocked.controls.shape == (1, len(clocked.times) - 1)
    clocked = sb.simulate_clocked(
        double_integrator,
        [0, 0],
        lambda x, t: 2.0,
        period=0.3,
        duration=3,
        events=lambda x, t: t - 0.5,
    )  # negative at the start, and only there
    assert [e.time for e in clocked.events] == pytest.approx([0.5])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"events": 3}, TypeError, "events must be"),
        ({"events": [3]}, TypeError, r"events must be functions e\(x, t\), got 3"),
        ({"events": lambda x, t: x}, TypeError, "must return one real number"),
        ({"events": lambda x, t: x[0], "x0": np.zeros((2, 3))}, ValueError, "a batch of 3"),
        (
            {"events": lambda x, t: x[0], "method": "rk4", "times": [0, 1], "duration": None},
            ValueError,
            "events need continuous time",
        ),
        ({"max_step": 0}, ValueError, "max_step must be greater than 0"),
        ({"max_steps": -1}, ValueError, "max_steps must be greater than 0"),
        ({"switches": "a"}, TypeError, "switches must be"),
        ({"switches": 1.0}, ValueError, "switches must have shape"),
        ({"delay": -1}, ValueError, "delay must be at least 0"),
        ({"delay": np.inf}, ValueError, "delay must be finite"),
        ({"u_before": [1, 2]}, ValueError, r"u_before must have shape \(1,\)"),
        ({"atol": [1e-9, 1e-9, 1e-9]}, ValueError, r"atol must be a number or have shape \(2,\)"),
        ({"delay": 0.1, "method": "rk4", "times": [0, 1], "duration": None}, ValueError, "delay"),
    ],
)
def test_bad_arguments(arguments, error, message):
    good = {"system": double_integrator, "x0": [1.0, 0.0], "u": 0.0, "duration": 2.0}
    with pytest.raises(error, match=message):
        simulate(**(good | arguments))


# --- samples of a control


@pytest.mark.parametrize("system", [double_integrator, sb.Particle(), "control"])
def test_a_sampled_control_means_what_it_means_elsewhere(system):
    t = np.linspace(0, 5, 101)
    linear = control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0)
    system = linear if system == "control" else system
    run = simulate(system, [0.5, 0.0], np.sin(t), times=t)
    forced = control.forced_response(linear, t, np.sin(t), [0.5, 0.0])
    assert np.allclose(run.states, forced.outputs, atol=1e-9)
    assert np.array_equal(run.controls[0], np.sin(t))
    assert run.control_at(0.025) == pytest.approx(np.sin(0.05) / 2)


def test_samples_of_several_inputs_and_for_a_batch():
    t = np.linspace(0, 2, 21)
    u = np.stack([t, np.ones(21)])
    run = simulate(lambda x, u: u, [0.0, 0.0], u, times=t)
    assert run.states[:, -1] == pytest.approx([2.0, 2.0])
    many = simulate(double_integrator, np.zeros((2, 3)), t, times=t)
    assert many.states[1, :, -1] == pytest.approx([2.0] * 3)


def test_two_readings_of_an_array():
    held = simulate(lambda x, u: u - x, [0.0, 0.0], [1.0, 2.0], times=[0, 1])
    assert held.states[:, -1] == pytest.approx([1 - np.exp(-1), 2 - 2 * np.exp(-1)])
    sampled = simulate(double_integrator, [0.0, 0.0], [1.0, 2.0], times=[0, 1])
    assert sampled.states[:, -1] == pytest.approx([0.5 + 1 / 6, 1.5])
    for u in ([[1.0, 2.0]], [1.0, 2.0]):
        each = simulate(double_integrator, np.zeros((2, 2)), u, times=[0, 1])
        assert each.states[1, :, -1] == pytest.approx([1.0, 2.0])
    long = np.linspace(0, 1, 30_001)  # read as so many inputs it would not fit in memory
    few = simulate(double_integrator, [0.0, 0.0], long[::3000], times=long[::3000])
    assert few.states[1, -1] == pytest.approx(0.5)
    with pytest.raises(ValueError, match="reads only the first"):
        simulate(double_integrator, [0.0, 0.0], long, duration=1.0)


@pytest.mark.parametrize("system", [double_integrator, sb.Particle()])
def test_samples_without_their_times_are_refused(system):
    t = np.linspace(0, 5, 101)
    with pytest.raises(ValueError, match="times= of the same length"):
        simulate(system, [0, 0], np.sin(t), duration=5.0)
    with pytest.raises(ValueError, match=r"same length|one column for each"):
        simulate(system, [0, 0], np.sin(t), times=t[:50])


# --- discrete time


@pytest.mark.parametrize(("dt", "k"), [(0.03, 11), (0.1, 3), (0.7, 6), (1 / 3, 2), (1e-3, 999)])
def test_switching_at_a_tick_survives_rounding(dt, k):
    sys = control.ss([[0.5]], [[1.0]], [[1.0]], 0, dt=dt)
    switch = round(k * dt, 12) if dt != 1 / 3 else 2 / 3
    expected = (np.arange(k + 3) >= k).astype(float)
    span = (k + 2) * dt
    plan = sb.ControlTrajectory.piecewise_constant([0, switch, 2 * span], [0, 1])
    for u in (plan, lambda x, t: float(t >= switch)):
        run = simulate(sys, [0.0], u, times=dt * np.arange(k + 3))
        assert run.controls[0].tolist() == expected.tolist()
        assert len(simulate(sys, [0.0], u, duration=span).times) == k + 3


def test_discrete_runs_replay_exactly_also_between_their_samples():
    sys = control.ss([[0.5, 1], [0, 0.9]], [[0], [1]], np.eye(2), 0, dt=0.1)
    run = simulate(sys, [1.0, 0.0], lambda x, t: np.cos(9 * t) - x[1], times=[0, 0.5, 0.7, 1.1])
    again = simulate(sys, *run.to_control_space(), times=run.times)
    assert np.array_equal(again.states, run.states)


def test_delay_in_discrete_time_waits_whole_samples():
    sys = control.ss([[1.0]], [[1.0]], [[1.0]], 0, dt=0.1)
    run = simulate(sys, [0.0], lambda x, t: t, duration=0.6, delay=0.2, u_before=[7.0])
    assert run.controls[0] == pytest.approx([7, 7, 0, 0.1, 0.2, 0.3, 0.4])
    assert run.states[0] == pytest.approx([0, 7, 14, 14, 14.1, 14.3, 14.6])
    with pytest.raises(ValueError, match=r"delay must be whole samples of dt = 0.1, got 0.25"):
        simulate(sys, [0.0], 1.0, duration=1.0, delay=0.25)


# --- strangers' functions


def test_a_function_that_returns_its_own_buffer():
    rate, force = np.zeros(2), np.zeros(1)

    def f(x, u):
        rate[:] = x[1], u[0]
        return rate

    def policy(x, t):
        force[:] = -x[0]
        return force

    for method in (*SOLVERS, "rk4"):
        run = simulate(f, [1.0, 0.0], policy, times=np.linspace(0, np.pi, 99), method=method)
        assert run.states[:, -1] == pytest.approx([-1.0, 0.0], abs=1e-5)
        assert run.controls[0] == pytest.approx(-run.states[0])


@pytest.mark.parametrize(
    "f",
    [
        lambda x: [x[1], -x[0]],
        lambda x: (float(x[1]), -math.fsum([x[0]])),
        lambda x: np.array([x[1], -x[0]], dtype=object).astype(float),
        lambda x: np.array([[x[1], -x[0]]])[0],
    ],
)
def test_functions_that_return_lists_and_other_arrays(f):
    run = simulate(f, [1, 0], duration=np.pi)
    assert run.states[:, -1] == pytest.approx([-1.0, 0.0], abs=1e-6)


def test_a_batch_is_probed_in_all_its_columns():
    def mixes(x):  # right for the first columns alone
        return np.stack([x[1], np.where(np.all(x[0] > 0), -1.0, 1.0) * x[0]])

    x0 = np.array([[1.0, 2.0, -1.0], [0.0, 0.1, 0.0]])
    many = simulate(mixes, x0, times=[0, 0.5])
    for i in range(3):
        alone = simulate(mixes, x0[:, i], times=[0, 0.5])
        assert many.states[:, i, -1] == pytest.approx(alone.states[:, -1], abs=1e-9)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "BDF", "LSODA", "rk4"])
def test_leaving_the_domain_of_math_is_a_divergence_with_time_and_state(method):
    def empties(x):
        return [-math.sqrt(x[0]) - 0.1]

    with pytest.raises(sb.DivergenceError, match=r"stopped at t = 1\.5.*failed.*math domain") as e:
        simulate(empties, [1.0], times=np.linspace(0, 2, 21), method=method)
    assert e.value.time == pytest.approx(1.5, abs=0.1)
    with pytest.raises(sb.DivergenceError, match=r"u\(x, t\) failed at t = "):
        simulate(
            double_integrator,
            [0.0, 0.0],
            lambda x, t: math.log(1 - t),
            times=np.linspace(0, 2, 21),
            method=method,
        )


@pytest.mark.parametrize(
    ("f", "u", "message"),
    [
        (lambda x: [-math.sqrt(x[0])], None, r"dynamics have no value at t = 0, x = \[-1\.\]: "),
        (lambda x: [1 / (float(x[0]) + 1)], None, "dynamics have no value"),
        (lambda x: 1 / (x + 1), None, "dynamics.* must be finite, got inf"),
        (lambda x, u: u, lambda x, t: math.log(t), r"u\(x0, t0\) has no value at t = 0"),
        (lambda x, u: [np.sum(u)], None, r"u is required for this function f\(x, u\)"),
        (lambda x: x, 1.0, "u was given"),
    ],
)
def test_starts_outside_the_domain_and_words_of_simulate(f, u, message):
    with pytest.raises(ValueError, match=message) as error:
        simulate(f, [-1.0], u, duration=1.0)
    assert "u0" not in str(error.value)


def test_the_callers_own_errors_say_where():
    def f(x):
        if x[0] < 0.5:
            raise KeyError("table")
        return -x

    with pytest.raises(KeyError, match="table") as error:
        simulate(f, [1.0], duration=2.0)
    notes = getattr(error.value, "__notes__", ["in simulate, at t = 0.7"])  # Python 3.10 has none
    assert notes[0].startswith("in simulate, at t = 0.")


def test_tolerances_in_units_of_each_state():
    # Nanometres beside metres: only an atol of its own resolves the first.
    def f(x):
        return np.stack([1e-9 * np.cos(20 * x[1]), 0 * x[1] + 1])

    run = simulate(f, [0.0, 0.0], duration=3.0, atol=[1e-16, 1e-9])
    assert run.states[0] == pytest.approx(1e-9 * np.sin(20 * run.times) / 20, abs=1e-15)


# --- long runs


def test_long_runs_end_by_choice():
    with pytest.raises(sb.DivergenceError, match=r"it would take more than 2e\+06"):
        simulate(sb.Oscillator(), [1.0, 0.0], times=[0, 1e6], max_steps=2e6)
    stop = stops(lambda x, t: t - 500.0, terminal=True)
    with pytest.warns(UserWarning, match=r"with steps of .* it will take some 1e\+10 of them"):
        run = simulate(sb.Oscillator(), [1.0, 0.0], times=[0, 1e9], events=stop, max_steps=np.inf)
    assert run.times.tolist() == [0, 500.0]


def test_a_large_batch_keeps_its_samples_but_not_all_between(monkeypatch):
    monkeypatch.setattr("statebook.dense_output._MOST", 20_000)
    x0 = np.linspace(-1, 1, 80).reshape(2, 40)
    times = np.linspace(0, 6, 61)
    run = simulate(sb.Oscillator(), x0, times=times)
    exact = np.stack([[np.cos(times), np.sin(times)], [-np.sin(times), np.cos(times)]])
    assert np.allclose(run.states, np.einsum("ijt,jn->int", exact, x0), atol=1e-6)
    assert np.array_equal(run(times[7]), run.states[..., 7])
    assert run.at(0.05, "linear").shape == (2, 40)
    with pytest.raises(ValueError, match="were not kept"):
        run(0.05)
