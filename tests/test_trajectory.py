"""Trajectories: interpolation, angles, controls, files and python-control's responses."""

import copy
import dataclasses
import functools
import pickle

import control
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import statebook as sb

ControlTrajectory = sb.ControlTrajectory
FINITE = st.floats(-1e6, 1e6)


def oscillator(x):
    return np.stack([x[1], -x[0]])


def circle_at(t):
    return np.array([np.cos(t), -np.sin(t)])


# --- what a trajectory is


def test_properties():
    trajectory = sb.Trajectory([1, 2, 4], [[0, 1, 2], [3, 4, 5]], [[7, 8]])
    assert (trajectory.n, trajectory.m, trajectory.duration) == (2, 1, 3.0)
    assert trajectory.control_hold == "interval"
    assert trajectory.state_labels == ("x[0]", "x[1]")
    assert trajectory.input_labels == ("u[0]",)
    assert repr(trajectory) == "Trajectory(n=2, m=1, 3 times over [1, 4] s)"
    assert sb.Trajectory([0], [[0]]).control_hold is None
    assert sb.Trajectory([0, 1], [[0, 1]], [[0, 1]]).control_hold == "time"


def test_batch_repr():
    trajectory = sb.Trajectory([0], np.zeros((2, 5, 1)))
    assert repr(trajectory) == "Trajectory(a batch of 5, n=2, m=0, 1 time over [0, 0] s)"


def test_arrays_are_copies_and_cannot_be_written():
    states = np.zeros((1, 2))
    trajectory = sb.Trajectory([0, 1], states, [[0]])
    states[0, 0] = 5
    assert trajectory.states[0, 0] == 0
    for array in (trajectory.times, trajectory.states, trajectory.controls):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"times": [0, 1, 1]}, ValueError, "times must increase, got 1 before 1"),
        ({"times": []}, ValueError, "times must hold at least 1 times, got 0"),
        ({"times": [0, 1, np.inf]}, ValueError, "times must be finite"),
        ({"states": [0, 1, 2]}, ValueError, r"states must have shape \(n, 3\)"),
        ({"states": [[0, 1]]}, ValueError, r"one state for each time, got \(1, 2\)"),
        ({"states": [[0, 1, np.nan]]}, ValueError, "states must be finite"),
        ({"states": [[0, 1, 2j]]}, TypeError, "states must be real"),
        ({"controls": [[1]]}, ValueError, r"one per interval, got \(1, 1\)"),
        ({"controls": [1, 2, 3]}, ValueError, "controls must have shape"),
        ({"circle": (1,)}, ValueError, r"circle must hold indices below n = 1, got \(1,\)"),
        ({"circle": (0.5,)}, TypeError, "circle must be an integer"),
        ({"state_labels": ("a", "b")}, ValueError, "state_labels must be 1 names"),
        ({"state_labels": "a"}, ValueError, "state_labels must be 1 names"),
        ({"input_labels": ("a",)}, ValueError, "input_labels must be 0 names"),
    ],
)
def test_bad_arguments(arguments, error, message):
    good = {"times": [0, 1, 2], "states": [[0, 1, 2]]}
    with pytest.raises(error, match=message):
        sb.Trajectory(**(good | arguments))


# --- interpolation


@settings(max_examples=40, deadline=None)
@given(states=arrays(float, (2, 5), elements=FINITE), t=st.floats(0, 4))
def test_linear_interpolation_agrees_with_numpy(states, t):
    times = np.array([0, 0.5, 1, 3, 4])
    expected = [np.interp(t, times, row) for row in states]
    assert np.allclose(sb.Trajectory(times, states)(t), expected, rtol=1e-9, atol=1e-7)


@settings(max_examples=40, deadline=None)
@given(states=arrays(float, (2, 3, 4), elements=FINITE))
def test_samples_are_exact_also_the_last(states):
    times = np.array([0.1, 0.2, 0.7, 1.1])
    trajectory = sb.Trajectory(times, states, circle=(1,))
    assert np.array_equal(trajectory(times), states)
    assert np.array_equal(trajectory(1.1), states[..., -1])
    cubic = trajectory.at(times, "cubic", system=lambda x: 0.01 * oscillator(x))
    assert np.array_equal(cubic, states)


def test_shapes_of_interpolation():
    one = sb.Trajectory([0, 1], np.zeros((2, 2)))
    many = sb.Trajectory([0, 1], np.zeros((2, 3, 2)))
    assert one(0.5).shape == (2,)
    assert one([0.1, 0.2, 0.3, 0.4]).shape == (2, 4)
    assert many(0.5).shape == (2, 3)
    assert many([0.1, 0.2, 0.3, 0.4]).shape == (2, 3, 4)
    assert many.at([0.1, 0.2], "cubic", system=oscillator).shape == (2, 3, 2)
    assert sb.Trajectory([2], [[5.0]])(2).tolist() == [5.0]


@pytest.mark.parametrize("t", [-0.01, 2.01, np.nan, [0.5, 3]])
def test_times_outside_are_refused(t):
    with pytest.raises(ValueError, match="t must be"):
        sb.Trajectory([0, 2], [[0, 1]])(t)


def test_a_time_beyond_the_end_by_rounding_is_the_end():
    trajectory = sb.Trajectory([0, 0.3], [[0, 1]])
    assert trajectory(0.1 + 0.2).tolist() == [1.0]
    assert 0.1 + 0.2 > 0.3


@pytest.mark.parametrize("size", [1e-9, 1e9])
@pytest.mark.parametrize("ends", [(-4.0, 1.0), (1.0, 4.0)])
def test_rounding_is_in_units_of_the_times(size, ends):
    start, end = np.array(ends) * size
    trajectory = sb.Trajectory([start, end], [[3.0, 5.0]])
    assert trajectory([start - 1e-13 * size, end + 1e-13 * size]).tolist() == [[3.0, 5.0]]
    for t in (start - 1e-10 * size, end + 1e-10 * size):
        with pytest.raises(ValueError, match="t must be within"):
            trajectory(t)


@pytest.mark.parametrize(("kind", "order"), [("linear", 2), ("cubic", 4)])
def test_order_of_interpolation(kind, order):
    counts, errors = [10, 20, 40], []
    t = np.linspace(0, 2, 777)
    for count in counts:
        times = np.linspace(0, 2, count + 1)
        trajectory = sb.Trajectory(times, circle_at(times))
        system = oscillator if kind == "cubic" else None
        errors.append(np.abs(trajectory.at(t, kind, system=system) - circle_at(t)).max())
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(order, abs=0.1)


def test_cubic_equals_scipys_hermite_spline():
    times = np.array([0, 0.3, 1.0, 1.2])
    trajectory = sb.Trajectory(times, circle_at(times))
    spline = scipy.interpolate.CubicHermiteSpline(
        times, trajectory.states.T, oscillator(trajectory.states).T
    )
    t = np.linspace(0, 1.2, 50)
    assert np.allclose(trajectory.at(t, "cubic", system=oscillator), spline(t).T, rtol=1e-13)


def test_cubic_with_held_controls_takes_the_slope_of_each_side():
    # A parabola in each interval, with a kink of the velocity's slope in between: exact.
    trajectory = sb.simulate(
        lambda x, u: np.stack([x[1], u[0]]),
        [0, 1],
        ControlTrajectory.piecewise_constant([0, 1, 3], [2, -3]),
        times=[0, 1, 3],
    )
    held = sb.Trajectory(trajectory.times, trajectory.states, [[2, -3]])
    value = held.at([0.5, 2.0], "cubic", system=lambda x, u: np.stack([x[1], u[0]]))
    assert np.allclose(value, [[0.75, 2 + 3 - 1.5], [2, 0]], atol=1e-12)


def test_cubic_of_a_time_varying_python_control_system():
    sys = control.nlsys(lambda t, x, u, params: np.array([3 * t**2]), states=1, inputs=0)
    trajectory = sb.Trajectory([0, 1, 2], [[0, 1, 8]])
    t = np.linspace(0, 2, 9)
    assert np.allclose(trajectory.at(t, "cubic", system=sys)[0], t**3, atol=1e-13)


def test_cubic_needs_a_continuous_system():
    trajectory = sb.Trajectory([0, 1], [[0, 1]])
    with pytest.raises(ValueError, match="give system="):
        trajectory.at(0.5, "cubic")
    with pytest.raises(ValueError, match="continuous-time system, got dt = True"):
        trajectory.at(0.5, "cubic", system=sb.as_system(lambda x: x, [0.0], dt=True))
    with pytest.raises(ValueError, match="kind must be one of dense, linear, cubic"):
        trajectory.at(0.5, "quintic")


# --- angles


def test_angles_take_the_shorter_way_round():
    times, theta = [0, 1, 2], np.array([3.0, -3.0, 3.1])
    line = sb.Trajectory(times, [theta, theta])
    circle = sb.Trajectory(times, [theta, theta], circle=(0,))
    assert line(0.5)[0] == 0
    assert circle(0.5)[1] == 0
    assert circle(0.5)[0] == pytest.approx(np.pi)
    assert circle(1.0)[0] == -3.0
    assert circle(2.0)[0] == 3.1


@settings(max_examples=40, deadline=None)
@given(
    angles=arrays(float, 6, elements=st.floats(-1.5, 1.5)),
    turns=arrays(int, 6, elements=st.integers(-2, 2)),
    t=st.floats(0, 5),
)
def test_full_turns_of_a_sample_do_not_matter(angles, turns, t):
    plain = sb.Trajectory(np.arange(6), [angles])
    turned = sb.Trajectory(np.arange(6), [angles + 2 * np.pi * turns], circle=(0,))
    difference = turned(t)[0] - plain(t)[0]
    assert abs(difference - 2 * np.pi * round(difference / (2 * np.pi))) < 1e-12


def test_cubic_on_the_circle():
    times = np.linspace(0, 6, 13)
    theta = 1.1 * times
    wrapped = (theta + np.pi) % (2 * np.pi) - np.pi
    trajectory = sb.Trajectory(times, [wrapped], circle=(0,))
    value = trajectory.at(np.linspace(0, 6, 77), "cubic", system=lambda x: 0 * x + 1.1)[0]
    difference = value - 1.1 * np.linspace(0, 6, 77)
    assert np.allclose(np.exp(1j * difference), 1, atol=1e-12)


# --- controls, resampling, paths


def test_controls_between_samples():
    per_time = sb.Trajectory([0, 1, 2], [[0, 0, 0]], [[0, 2, 6]])
    held = sb.Trajectory([0, 1, 2], [[0, 0, 0]], [[2, 6]])
    assert per_time.control_at([0, 0.5, 1.5, 2]).tolist() == [[0, 1, 4, 6]]
    assert held.control_at([0, 0.5, 1, 2]).tolist() == [[2, 2, 6, 6]]
    assert held.control_at(1.5).tolist() == [6]
    with pytest.raises(ValueError, match="no controls"):
        sb.Trajectory([0, 1], [[0, 0]]).control_at(0)


def test_resample():
    trajectory = sb.Trajectory([0, 1, 2], [[0, 2, 2]], [[1, 3, 5]], state_labels=("p",))
    finer = trajectory.resample([0.5, 1, 1.75])
    assert finer.states.tolist() == [[1, 2, 2]]
    assert finer.controls.tolist() == [[2, 3, 4.5]]
    assert finer.state_labels == ("p",)
    held = sb.Trajectory([0, 1, 2], [[0, 2, 2]], [[1, 3]]).resample([0, 0.5, 1, 2])
    assert held.control_hold == "interval"
    assert held.controls.tolist() == [[1, 1, 3]]
    times = np.linspace(0, 1, 5)
    cubic = sb.Trajectory(times, circle_at(times)).resample([0.1, 0.9], "cubic", system=oscillator)
    assert np.allclose(cubic.states, circle_at(cubic.times), atol=2e-4)


def test_path_forgets_times_and_waiting():
    quick = sb.Trajectory([0, 1, 2], [[0, 1, 1], [0, 0, 2]])
    slow = sb.Trajectory([0, 5, 6, 9], [[0, 1, 1, 1], [0, 0, 0, 2]])
    assert quick.path().tolist() == slow.path().tolist() == [[0, 1, 1], [0, 0, 2]]
    with pytest.raises(ValueError, match="path takes one trajectory, got a batch of 2"):
        sb.Trajectory([0], np.zeros((1, 2, 1))).path()


@pytest.mark.parametrize("held", [True, False])
def test_control_space_restores_the_states(held):
    times = np.array([0, 0.5, 1.2, 2.0])
    values = np.array([[1.0, -2.0, 0.5, 1.0]])[:, : 3 if held else 4]
    form = ControlTrajectory.piecewise_constant if held else ControlTrajectory.piecewise_linear
    first = sb.simulate(sb.Pendulum(), [0.1, 0.0], form(times, values), times=times)
    stored = sb.Trajectory(times, first.states, values)
    x0, u = stored.to_control_space()
    again = sb.simulate(sb.Pendulum(), x0, u, times=times)
    assert np.array_equal(again.states, first.states)
    assert np.array_equal(u.breakpoints, times)


# --- exchange


@settings(max_examples=40, deadline=None)
@given(
    states=arrays(float, (2, 4), elements=st.floats(allow_nan=False, allow_infinity=False)),
    count=st.sampled_from([0, 3, 4]),
)
def test_csv_round_trip(states, count, tmp_path_factory):
    controls = np.arange(2.0 * count).reshape(2, count) / 3 if count else None
    path = tmp_path_factory.mktemp("csv") / "run.csv"
    labels = ("angle, wrapped", 'the "rate"')
    trajectory = sb.Trajectory(np.arange(4) / 3, states, controls, (0,), labels)
    trajectory.to_csv(path)
    again = sb.Trajectory.from_csv(path, circle=(0,))
    assert np.array_equal(again.times, trajectory.times)
    assert np.array_equal(again.states, states)
    assert again.control_hold == trajectory.control_hold
    if count:
        assert np.array_equal(again.controls, controls)
    assert again.state_labels == labels
    assert again.input_labels == trajectory.input_labels
    assert again.circle == (0,)


def test_csv_of_one_sample(tmp_path):
    sb.Trajectory([2], [[5]], np.zeros((1, 0))).to_csv(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().split() == ["t,x:x[0],u:u[0]", "2.0,5.0,"]
    again = sb.Trajectory.from_csv(tmp_path / "a.csv")
    assert again.controls.shape == (1, 0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must have the columns"),
        ("t,x:a\n", "must have the columns"),
        ("a,b\n0,1\n", "must have the columns"),
        ("t,u:a,x:b\n0,1,2\n", "must have the columns"),
        ("t,x:a\n0,b\n", "must hold numbers in full rows"),
        ("t,x:a\n0,1\n1\n", "must hold numbers in full rows"),
        ("t,x:a,u:b\n0,1,\n1,2,3\n", "must hold numbers in full rows"),
    ],
)
def test_wrong_files(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        sb.Trajectory.from_csv(tmp_path / "a.csv")


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("m", [0, 1, 2])
def test_response_round_trip(batch, m):
    rng = np.random.default_rng(0)
    controls = rng.normal(size=(m, *batch, 4)) if m else None
    labels = ("p", "v"), tuple("ab"[:m])
    first = sb.Trajectory(
        [0, 1, 2, 3], rng.normal(size=(2, *batch, 4)), controls, (), labels[0], labels[1]
    )
    response = first.to_response()
    assert isinstance(response, control.TimeResponseData)
    assert np.array_equal(response.states, first.states)
    assert np.array_equal(response.outputs, first.states)
    again = sb.Trajectory.from_response(response)
    assert np.array_equal(again.times, first.times)
    assert np.array_equal(again.states, first.states)
    assert (again.state_labels, again.input_labels) == labels
    if m:
        assert np.array_equal(again.controls, controls)


def test_response_repeats_the_last_held_control():
    response = sb.Trajectory([0, 1, 2], [[0, 1, 2]], [[5, 6]]).to_response()
    assert response.inputs.tolist() == [[5, 6, 6]]


def test_responses_of_python_control():
    sys = control.ss([[0, 1], [-10, -1]], [[0], [1]], [[1, 0]], 0)
    forced = control.forced_response(sys, np.linspace(0, 1, 11), np.ones(11), return_x=True)
    trajectory = sb.Trajectory.from_response(forced)
    assert (trajectory.n, trajectory.m) == (2, 1)
    ours = sb.simulate(sys, [0, 0], 1.0, times=trajectory.times)
    assert np.allclose(ours.states, trajectory.states, atol=1e-7)
    step = sb.Trajectory.from_response(control.step_response(sys, np.linspace(0, 1, 11)))
    assert np.allclose(step.states.reshape(2, -1), trajectory.states, atol=1e-10)
    initial = sb.Trajectory.from_response(control.initial_response(sys, [0, 1], [1.0, 0.0]))
    assert initial.states[:, 0].ravel().tolist() == [1, 0]
    with pytest.raises(ValueError, match="response must contain states"):
        sb.Trajectory.from_response(control.TimeResponseData([0, 1], [0, 1], issiso=True))


# --- control trajectories


def test_forms_of_control():
    times = np.array([0, 1, 3])
    constant = ControlTrajectory.piecewise_constant(times, [[1, 2], [3, 4]])
    assert constant(0.5).tolist() == [1, 3]
    assert constant([0, 1, 3]).tolist() == [[1, 2, 2], [3, 4, 4]]
    linear = ControlTrajectory.piecewise_linear(times, [[1, 3, 7], [0, 0, 2]])
    assert linear([0.5, 2, 3]).tolist() == [[2, 5, 7], [0, 1, 2]]
    cubic = ControlTrajectory.polynomial([[1, 0, 0, 2], [0, 1, 0, 0]], 3, t0=1)
    assert cubic([1, 2, 4]).tolist() == [[1, 3, 55], [0, 1, 3]]
    t = np.linspace(0, 3, 6)
    spline = ControlTrajectory.spline(t, np.sin(t), bc_type="natural")
    reference = scipy.interpolate.CubicSpline(t, np.sin(t), bc_type="natural")
    assert np.allclose(spline(t[:-1] + 0.2)[0], reference(t[:-1] + 0.2), atol=1e-14)
    assert (constant.m, cubic.m, spline.m) == (2, 2, 1)
    assert (constant.duration, cubic.duration) == (3, 3)
    assert repr(spline) == "ControlTrajectory(m=1, 5 pieces of degree 3 over [0, 3] s)"


@settings(max_examples=40, deadline=None)
@given(coefficients=arrays(float, (3, 4, 2), elements=FINITE), t=arrays(float, 5, elements=FINITE))
def test_control_agrees_with_ppoly(coefficients, t):
    breaks = np.array([-1e6, -3, 0, 2.5, 1e6])
    curve = scipy.interpolate.PPoly(coefficients, breaks)
    assert np.allclose(ControlTrajectory.from_ppoly(curve)(t), curve(t).T, rtol=1e-9)


def test_limits_from_both_sides_of_a_breakpoint():
    u = ControlTrajectory.piecewise_constant([0, 1, 2], [5, 7])
    assert u(1.0).tolist() == [7]
    assert u.on_piece(0, 1.0).tolist() == [5]
    assert u.on_piece(0, np.array([0.1, 0.2, 0.3])).tolist() == [[5, 5, 5]]


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: ControlTrajectory([0, 1], [[1.0]]), ValueError, "coefficients must have shape"),
        (lambda: ControlTrajectory([0, 1], np.ones((0, 1, 1))), ValueError, "degree"),
        (lambda: ControlTrajectory([0], np.ones((1, 1, 1))), ValueError, "breakpoints must hold"),
        (
            lambda: ControlTrajectory.piecewise_constant([0, 1], [1, 2]),
            ValueError,
            r"values must have shape \(1,\) or \(m, 1\), got \(1, 2\)",
        ),
        (lambda: ControlTrajectory.piecewise_linear([0, 1], [1]), ValueError, "values must"),
        (lambda: ControlTrajectory.piecewise_linear([0, 0], [1, 2]), ValueError, "times must"),
        (lambda: ControlTrajectory.polynomial([1], 0), ValueError, "duration must be"),
        (lambda: ControlTrajectory.polynomial([], 1), ValueError, "coefficients must have"),
        (lambda: ControlTrajectory.spline([0, 1], [1, np.nan]), ValueError, "values must be fin"),
        (lambda: ControlTrajectory.from_ppoly(np.sin), TypeError, "curve must be a scipy"),
        (lambda: ControlTrajectory.polynomial([1], 1)(1.5), ValueError, r"t must be within \[0, 1"),
    ],
)
def test_wrong_controls(make, error, message):
    with pytest.raises(error, match=message):
        make()


# --- what a run knows between its samples

RUN = sb.ControlTrajectory.piecewise_constant([0, 0.7, 1.4], [3.0, -3.0])


@pytest.mark.parametrize("method", ["RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA"])
@pytest.mark.parametrize("batch", [False, True])
def test_between_samples_the_solvers_own_output(method, batch):
    x0 = [[1.0, -0.5, 2.0], [0.0, 0.3, 0.1]] if batch else [1.0, 0.0]
    run = sb.simulate(sb.Pendulum(), x0, times=[0, 4.0, 9.0], method=method)
    t = np.linspace(0, 9, 91)
    truth = sb.simulate(sb.Pendulum(), x0, times=t, method="DOP853", rtol=1e-12, atol=1e-13)
    assert np.abs(run(t) - truth.states).max() < 5e-5
    assert np.abs(run.at(t, "linear") - truth.states).max() > 0.5
    assert np.array_equal(run(run.times), run.states)
    assert np.array_equal(run(4.0), run.states[..., 1])
    assert run(2.5).shape == run.states.shape[:-1]
    assert np.array_equal(run.at(t), run.at(t, "dense"))


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau"])
def test_the_event_that_ends_a_run_is_a_sample_like_others(method):
    for height in np.linspace(-1.4, -0.4, 6):
        above = functools.partial(lambda height, x: x[0] - height, height)
        above.terminal = True
        run = sb.simulate(sb.Pendulum(), [0.0, 0.0], duration=9.0, events=above, method=method)
        assert len(run.events) == 1
        assert np.array_equal(run(run.times[-1]), run.states[:, -1])
        between = run.times[-2:].mean()
        both = run([between, run.times[-1]])
        assert np.array_equal(both, np.stack([run(between), run.states[:, -1]], axis=1))


def test_dense_output_survives_resampling_and_pickling_but_not_replacing():
    run = sb.simulate(sb.Pendulum(), [1.0, 0.0], RUN, times=[0, 1.0, 1.4])
    finer = run.resample(np.linspace(0.1, 1.3, 13))
    assert np.array_equal(finer(0.55), run(0.55))
    assert np.array_equal(finer.controls, run.control_at(finer.times))
    for again in (pickle.loads(pickle.dumps(run)), copy.deepcopy(run)):
        assert np.array_equal(again(0.123), run(0.123))
        assert np.array_equal(again.control_at(0.69), run.control_at(0.69))
        with pytest.raises(ValueError, match="read-only"):
            again.states[0, 0] = 1
    doubled = dataclasses.replace(run, states=2 * run.states)
    assert np.array_equal(doubled(0.5), run.at(0.5, "linear") * 2)
    with pytest.raises(ValueError, match='kind "dense" needs'):
        doubled.at(0.5, "dense")


def test_held_controls_are_held_beside_a_switch_too():
    run = sb.simulate(sb.Pendulum(), [1.0, 0.0], RUN)
    near = np.nextafter(0.7, 0)
    t = [0.0, 0.69, 0.6999999, near - 1e-12, 0.7, 0.7000001, 1.4]
    assert run.control_at(t).tolist() == [[3, 3, 3, 3, -3, -3, -3]]
    constant = sb.simulate(sb.Pendulum(), np.zeros((2, 2)), [[1.0, 2.0]], duration=1.0)
    assert constant.control_at(0.123).tolist() == [[1.0, 2.0]]
    assert constant.control_at([0.1, 0.2]).shape == (1, 2, 2)


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(["constant", "linear", "spline", "number"]),
    start=st.floats(0, 0.5),
    samples=st.integers(2, 30),
    method=st.sampled_from(["RK45", "DOP853", "LSODA"]),
)
def test_a_replay_repeats_a_run_to_rounding(kind, start, samples, method):
    breaks = np.array([0, 0.55, 0.6, 1.3, 2.0])
    values = np.array([1.0, -2.0, 0.5, 3.0, 0.1])
    u = {
        "constant": ControlTrajectory.piecewise_constant(breaks, values[:-1]),
        "linear": ControlTrajectory.piecewise_linear(breaks, values),
        "spline": ControlTrajectory.spline(breaks, values),
        "number": 0.7,
    }[kind]
    times = np.linspace(start, 1.9, samples)
    run = sb.simulate(sb.Pendulum(), [0.4, 0.0], u, times=times, method=method)
    x0, plan = run.to_control_space()
    again = sb.simulate(sb.Pendulum(), x0, plan, times=times, method=method)
    # LSODA's steps and orders hang on the last digit: its replay is as near as its tolerance.
    assert np.abs(again.states - run.states).max() < (2e-6 if method == "LSODA" else 1e-7)
    if kind in ("constant", "number") and start == 0:
        assert np.array_equal(again.states, run.states)
    whole = sb.simulate(sb.Pendulum(), x0, plan, method=method)
    assert np.allclose(whole.times[[0, -1]], times[[0, -1]])
    t = np.linspace(start, 1.9, 50)
    assert np.allclose(plan(t), run.control_at(t), atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(coefficients=arrays(float, (4, 3, 2), elements=st.floats(-9, 9)), ends=st.data())
def test_a_part_of_a_control(coefficients, ends):
    u = ControlTrajectory([0, 1, 2.5, 3], coefficients)
    start = ends.draw(st.floats(0, 2.9))
    end = ends.draw(st.floats(start + 0.05, 3))
    part = u.between(start, end)
    assert part.breakpoints[[0, -1]].tolist() == [start, end]
    t = np.linspace(start, end, 40)[1:-1]
    t = t[np.abs(t[:, None] - u.breakpoints).min(axis=1) > 1e-9]
    assert np.allclose(part(t), u(t), atol=1e-10)
    with pytest.raises(ValueError, match="must be within"):
        u.between(0, 3.1)


@pytest.mark.parametrize(
    "t", [0.1 * 3, 0.03 * 11, 1000.33, 1000 + 11 * 0.03, np.nextafter(0.33, 0), 0.33]
)
def test_a_time_below_a_switch_by_rounding_is_the_switch(t):
    switch = round(float(t), 9)
    u = ControlTrajectory.piecewise_constant([0, switch, 2000], [1, 2])
    assert u(t).tolist() == [2.0]
    assert u(switch - 1e-6).tolist() == [1.0]


def test_results_are_equal_to_themselves_alone():
    run, other = (sb.simulate(sb.Pendulum(), [1.0, 0.0], RUN) for _ in range(2))
    assert run == run
    assert run != other
    assert RUN == RUN
    assert RUN != ControlTrajectory.piecewise_constant([0, 0.7, 1.4], [3.0, -3.0])
    assert len({run, other, RUN}) == 3


@pytest.mark.parametrize(
    "make", [lambda: RUN, lambda: ControlTrajectory.spline([0, 1, 2], [1, 2, 9])]
)
def test_control_trajectories_pickle(make):
    u = pickle.loads(pickle.dumps(make()))
    assert np.array_equal(u.coefficients, make().coefficients)
    with pytest.raises(ValueError, match="read-only"):
        u.breakpoints[0] = 1


def test_errors_pickle():
    with pytest.raises(sb.DivergenceError) as caught:
        sb.simulate(lambda x: x**2, [1.0], duration=2.0)
    again = pickle.loads(pickle.dumps(caught.value))
    assert type(again) is sb.DivergenceError
    assert str(again) == str(caught.value)
    assert (again.time, again.state) == (caught.value.time, caught.value.state)
    assert np.array_equal(again.trajectory(0.5), caught.value.trajectory(0.5))
    path = sb.InfeasiblePathError("no", constraint="speed", s=0.5)
    again = pickle.loads(pickle.dumps(path))
    assert (str(again), again.constraint, again.s) == ("no", "speed", 0.5)
    for kind in (sb.KinkError, sb.NotAnEquilibriumError, sb.EquilibriumNotFoundError):
        assert str(pickle.loads(pickle.dumps(kind("why")))) == "why"


# --- step characteristics


def test_step_info_is_python_controls():
    # x'' = 4 (3 - x) - 1.2 x': damping ratio 0.3, from 1 to 3.
    run = sb.simulate(
        lambda x: np.stack([x[1], 4 * (3 - x[0]) - 1.2 * x[1]]), [1.0, 0.0], duration=30.0
    )
    info = run.step_info("x[0]")
    step = control.step_info(control.tf([4], [1, 1.2, 4]), T=np.linspace(0, 30, 3001))
    assert info["Overshoot"] == pytest.approx(100 * np.exp(-np.pi * 0.3 / np.sqrt(0.91)), rel=1e-3)
    assert info["Peak"] == pytest.approx(2 * step["Peak"], rel=1e-4)
    for name in ("RiseTime", "SettlingTime", "PeakTime"):
        assert info[name] == pytest.approx(step[name], abs=0.03)


def test_step_info_of_a_first_order_lag_in_closed_form():
    run = sb.simulate(lambda x: (5.0 - x) / 2, [1.0], times=np.linspace(0, 40, 5))
    info = run.step_info(final=5.0)
    assert info["RiseTime"] == pytest.approx(2 * np.log(9), abs=0.03)
    assert info["SettlingTime"] == pytest.approx(2 * np.log(50), abs=0.03)
    assert info["SteadyStateValue"] == pytest.approx(4.0)
    assert run.step_info(final=5.0, SettlingTimeThreshold=0.1)["SettlingTime"] == pytest.approx(
        2 * np.log(10), abs=0.03
    )
    down = sb.simulate(lambda x: -x, [1.0], duration=20.0).step_info()
    assert down["RiseTime"] == pytest.approx(np.log(9), abs=0.02)
    assert down["Overshoot"] == 0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"state": 2}, ValueError, "state must be below n = 2"),
        ({"state": "speed"}, ValueError, r"state must be one of x\[0\], x\[1\]"),
        ({"state": 0.5}, TypeError, "state must be an integer"),
        ({"state": 1}, ValueError, r"x\[1\] ends where it starts, at 0: no step"),
        ({"final": np.nan}, ValueError, "final must be finite"),
    ],
)
def test_step_info_of_what_is_none(arguments, error, message):
    run = sb.Trajectory([0, 1, 2], [[0, 1, 2], [0, 3, 0]])
    with pytest.raises(error, match=message):
        run.step_info(**arguments)
