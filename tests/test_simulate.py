"""Simulation against closed forms: every kind of system, control and solver."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook.simulation import simulate

SOLVERS = ("RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA")
A = np.array([[0.0, 1.0], [-10.0, -1.0]])
B = np.array([[0.0], [2.0]])


def pendulum(x, u):
    return np.stack([x[1], -9.8 * np.cos(x[0]) + u[0]])


def double_integrator(x, u):
    return np.stack([x[1], u[0]])


# --- closed forms


def test_defaults():
    trajectory = simulate(lambda x: -x, [1.0, 2.0], duration=3.0)
    assert np.array_equal(trajectory.times, np.linspace(0, 3, 201))
    assert trajectory.controls is None
    assert np.allclose(trajectory.states, [[1], [2]] * np.exp(-trajectory.times), rtol=1e-6)


@pytest.mark.parametrize("method", SOLVERS)
def test_matrix_exponential(method):
    trajectory = simulate(
        lambda x: A @ x, [1.0, -1.0], times=np.linspace(2.0, 5.0, 7), method=method
    )
    exact = np.array([scipy.linalg.expm(A * t) @ [1.0, -1.0] for t in trajectory.times - 2.0])
    assert np.abs(trajectory.states - exact.T).max() < 2e-6


def test_pendulum_against_elliptic_functions():
    # From the bottom with theta' = 2 w k: sin(phi / 2) = k sn(w t), phi = theta + pi / 2.
    model = sb.Pendulum(m=0.7, L=1.3, g=9.8)
    w, k = np.sqrt(9.8 / 1.3), 0.9
    trajectory = simulate(model, [-np.pi / 2, 2 * w * k], duration=6.0, rtol=1e-11, atol=1e-12)
    sn, cn, _, _ = scipy.special.ellipj(w * trajectory.times, k**2)
    exact = [2 * np.arcsin(k * sn) - np.pi / 2, 2 * w * k * cn]
    assert np.abs(trajectory.states - exact).max() < 1e-8
    assert trajectory.state_labels == tuple(model.states)
    assert trajectory.input_labels == tuple(model.inputs)
    assert not trajectory.controls.any()


@pytest.mark.parametrize("model", [sb.Pendulum(), sb.CartPole(m_cart=2.0, m_pole=0.5, L=1.5)])
def test_energy_is_conserved(model):
    x0 = 0.3 + 0.1 * np.arange(len(model.states))
    trajectory = simulate(model, x0, duration=5.0, method="DOP853", rtol=1e-12, atol=1e-12)
    energy = model.energy(trajectory.states)
    assert np.ptp(energy) < 1e-8 * np.abs(energy).max()


def test_particle_under_constant_force_is_exact():
    trajectory = simulate(sb.Particle(m=2.0), [0.0, 1.0], 3.0, times=[0, 1, 2.5])
    t = np.array([0, 1, 2.5])
    assert np.allclose(trajectory.states, [t + 0.75 * t**2, 1 + 1.5 * t], rtol=1e-14)
    assert trajectory.controls.tolist() == [[3.0, 3.0, 3.0]]


def test_python_control_systems_agree():
    import control

    sys = control.ss(A, B, np.eye(2), 0, states=["p", "v"], inputs=["f"])
    model = control.nlsys(lambda t, x, u, params: A @ x + B @ u + [0, t], states=2, inputs=1)
    linear = simulate(sys, [1.0, 0.0], 0.5, duration=2.0)
    x_rest = np.linalg.solve(A, -B[:, 0] * 0.5)
    exact = scipy.linalg.expm(2 * A) @ ([1.0, 0.0] - x_rest) + x_rest
    assert np.allclose(linear.states[:, -1], exact, atol=1e-8)
    assert (linear.state_labels, linear.input_labels) == (("p", "v"), ("f",))
    # The time reaches a system that depends on it: v' += t adds the particular solution.
    timed = simulate(model, [1.0, 0.0], 0.5, duration=2.0)
    M = np.zeros((4, 4))
    M[:2, :2], M[1, 2], M[2, 3] = A, 1, 1
    forced = scipy.linalg.expm(2 * M)[:2, 3]
    assert np.allclose(timed.states[:, -1], exact + forced, atol=1e-8)


# --- controls


def test_policy_of_state_and_time():
    # v' = -v + sin t from 0: v = (sin t - cos t + exp(-t)) / 2.
    trajectory = simulate(
        double_integrator, [0.0, 0.0], lambda x, t: -x[1] + np.sin(t), duration=4.0
    )
    t = trajectory.times
    v = (np.sin(t) - np.cos(t) + np.exp(-t)) / 2
    assert np.allclose(trajectory.states[1], v, atol=1e-7)
    assert np.allclose(trajectory.controls[0], np.sin(t) - v, atol=1e-7)


@pytest.mark.parametrize("method", SOLVERS)
def test_bang_bang_restarts_at_the_switch(method):
    u = sb.ControlTrajectory.piecewise_constant([0, 0.7, 1.4], [3.0, -3.0])
    trajectory = simulate(double_integrator, [0.0, 0.0], u, method=method)
    assert trajectory.times[-1] == 1.4
    assert np.allclose(trajectory.states[:, -1], [3 * 0.7**2, 0], atol=1e-7)
    half = simulate(double_integrator, [0.0, 0.0], u, times=[0, 0.7, 1.4], method=method)
    assert np.allclose(half.states[:, 1], [1.5 * 0.7**2, 2.1], atol=1e-7)
    assert half.controls.tolist() == [[3.0, -3.0, -3.0]]


@pytest.mark.parametrize("method", ["euler", "heun", "rk4", "dopri5", "semi_implicit_euler"])
def test_fixed_steps_end_at_breakpoints(method):
    # v is linear in time between the breakpoints: every method gets it to rounding.
    u = sb.ControlTrajectory.piecewise_constant([0, 0.35, 1], [2.0, -1.0])
    trajectory = simulate(
        double_integrator, [0.0, 1.0], u, times=np.linspace(0, 1, 6), method=method
    )
    t = trajectory.times
    v = 1 + 2 * np.minimum(t, 0.35) - np.maximum(t - 0.35, 0)
    assert np.allclose(trajectory.states[1], v, rtol=1e-14)


def test_many_switches():
    rng = np.random.default_rng(5)
    breaks, values = np.arange(41) / 10, rng.choice([-2.0, 2.0], 40)
    u = sb.ControlTrajectory.piecewise_constant(breaks, values)
    trajectory = simulate(double_integrator, [0.0, 0.0], u, times=breaks)
    v = np.concatenate([[0], np.cumsum(values) / 10])
    p = np.concatenate([[0], np.cumsum((v[1:] + v[:-1]) / 20)])
    assert np.allclose(trajectory.states, [p, v], atol=1e-12)


@pytest.mark.parametrize(
    "u",
    [
        sb.ControlTrajectory.polynomial([1, -2, 3], 2),
        scipy.interpolate.PPoly([[3.0], [-2.0], [1.0]], [0, 2]),
        scipy.interpolate.CubicSpline(
            np.linspace(0, 2, 5), 1 - 2 * np.linspace(0, 2, 5) + 3 * np.linspace(0, 2, 5) ** 2
        ),
        sb.ControlTrajectory.spline([0, 1, 2], [1, 2, 9]),
    ],
)
def test_polynomial_controls(u):
    trajectory = simulate(double_integrator, [0.0, 0.0], u)
    t = trajectory.times
    assert t[-1] == 2
    assert np.allclose(trajectory.states[1], t - t**2 + t**3, atol=1e-8)


def test_piecewise_linear_control_over_a_part_of_its_span():
    u = sb.ControlTrajectory.piecewise_linear([0, 1, 3], [0, 2, 0])
    trajectory = simulate(double_integrator, [0.0, 0.0], u, times=[0.5, 1, 2])
    assert np.allclose(trajectory.states[1], [0, 0.75, 2.25], atol=1e-12)


def test_controls_are_those_of_the_given_array():
    two = simulate(lambda x, u: u - x, [0.0, 0.0], [1.0, 2.0], duration=1.0)
    assert np.allclose(two.states[:, -1], [1 - np.exp(-1), 2 - 2 * np.exp(-1)])
    assert two.controls.shape == (2, 201)


# --- batches


@pytest.mark.parametrize("method", SOLVERS)
def test_one_mover_among_many_is_as_accurate_as_alone(method):
    N = 1000 if method in ("RK45", "DOP853") else 100
    x0 = np.zeros((2, N))
    x0[0] = -np.pi / 2
    x0[:, 7] = [-np.pi / 2, 6.0]
    times = np.linspace(0, 5, 11)
    options = {"times": times, "rtol": 1e-6, "atol": 1e-8}
    many = simulate(pendulum, x0, [0.0], method=method, **options)
    alone = simulate(pendulum, x0[:, 7], [0.0], method=method, **options)
    truth = simulate(pendulum, x0[:, 7], [0.0], times=times, rtol=1e-12, atol=1e-13)
    error = np.abs(many.states[:, 7] - truth.states).max()
    assert error < 1.5 * np.abs(alone.states - truth.states).max()
    resting = np.delete(many.states, 7, axis=1) - np.array([-np.pi / 2, 0])[:, None, None]
    assert np.abs(resting).max() < 1e-12


@settings(max_examples=20, deadline=None)
@given(
    n=st.integers(1, 3),
    m=st.integers(0, 3),
    batch=st.none() | st.integers(1, 4),
    count=st.integers(1, 4),
    kind=st.sampled_from(["none", "constant", "policy", "trajectory"]),
    method=st.sampled_from(["RK45", "rk4", "implicit_midpoint"]),
)
def test_shapes(n, m, batch, count, kind, method):
    C = np.arange(n * m).reshape(n, m) / 10
    system = sb.System(
        rate=lambda x, u, t: C @ u - x,
        states=tuple(f"s{i}" for i in range(n)),
        inputs=tuple(f"i{i}" for i in range(m)),
        batched=batch is not None,
    )
    u = {
        "none": None,
        "constant": np.ones(m),
        "policy": lambda x, t: t * np.arange(m),
        "trajectory": sb.ControlTrajectory.polynomial(np.ones((m, 2)), 1.0) if m else None,
    }[kind]
    x0 = np.ones((n,) if batch is None else (n, batch))
    times = np.linspace(0, 1, 4)[:count]
    result = simulate(system, x0, u, times=times, method=method)
    assert result.states.shape == (*x0.shape, count)
    assert np.array_equal(result.states[..., 0], x0)
    if m:
        assert result.controls.shape == (m, *x0.shape[1:], count)
    else:
        assert result.controls is None


@pytest.mark.parametrize(
    "policy",
    [
        lambda x, t: -2 * x[0] - x[1],  # (N,)
        lambda x, t: [-2 * x[0] - x[1]],  # (1, N)
        lambda x, t: -np.array([[2.0, 1.0]]) @ (x - np.zeros(2)),  # fails, or mixes up columns
        lambda x, t: -2 * x[0] - x[1] if x[0] > -9 else 0.0,  # takes no batch
    ],
)
@pytest.mark.parametrize("N", [1, 2, 3])
def test_policies_of_batches(policy, N):
    x0 = np.array([[1.0, 0.0, -2.0], [0.0, 0.5, 1.0]])[:, :N]
    many = simulate(double_integrator, x0, policy, duration=2.0)
    closed = np.array([[0.0, 1.0], [-2.0, -1.0]])
    assert np.allclose(many.states[..., -1], scipy.linalg.expm(2 * closed) @ x0, atol=1e-7)
    assert many.controls.shape == (1, N, 201)


@pytest.mark.parametrize("x0", [[[0.0, 0.3], [0.0, 0.2]], np.zeros((2, 2))])
def test_policy_that_subtracts_a_target_from_a_square_batch(x0):
    # (2, 2) - (2,) subtracts the target from rows, not from columns: it must be called alone.
    # At the origin that makes no difference yet.
    goal = np.array([1.0, 0.0])
    x0 = np.array(x0)
    many = simulate(double_integrator, x0, lambda x, t: -((x - goal) @ [2.0, 1.0]), duration=2.0)
    closed = scipy.linalg.expm(2 * np.array([[0.0, 1.0], [-2.0, -1.0]]))
    assert np.allclose(many.states[..., -1].T, (closed @ (x0.T - goal).T).T + goal, atol=1e-7)


def test_constant_controls_for_each_of_a_batch():
    many = simulate(double_integrator, np.zeros((2, 3)), [[1.0, 2.0, 3.0]], duration=1.0)
    assert np.allclose(many.states[1, :, -1], [1, 2, 3])


def test_batch_of_a_function_that_takes_none():
    many = simulate(lambda x: [x[1], -float(x[0])], np.eye(2), duration=1.0)
    c, s = np.cos(1), np.sin(1)
    assert np.allclose(many.states[..., -1], [[c, s], [-s, c]], atol=1e-7)


# --- discrete time


def test_discrete_time_iterates_the_map():
    import control

    sys = control.ss([[0.5, 1], [0, 0.9]], [[0], [1]], np.eye(2), 0, dt=0.1)
    trajectory = simulate(sys, [1.0, 0.0], lambda x, t: t, duration=0.3)
    assert np.allclose(trajectory.times, [0, 0.1, 0.2, 0.3])
    assert np.allclose(trajectory.states, [[1, 0.5, 0.25, 0.225], [0, 0, 0.1, 0.29]])
    assert np.allclose(trajectory.controls, [[0, 0.1, 0.2, 0.3]])
    few = simulate(sys, [1.0, 0.0], lambda x, t: t, times=[0, 0.3])
    assert np.allclose(few.states[:, 1], [0.225, 0.29])


def test_discrete_time_of_unit_step_and_a_batch():
    system = sb.as_system(lambda x: 2 * x, [1.0], dt=True)
    trajectory = simulate(system, [[1.0, 3.0]], duration=4)
    assert trajectory.states[0, :, -1].tolist() == [16.0, 48.0]
    assert len(trajectory.times) == 5
    with pytest.raises(
        ValueError, match=r"duration must be whole samples of dt = 1 apart, got 1.5"
    ):
        simulate(system, [1.0], duration=1.5)
    with pytest.raises(sb.DivergenceError) as caught:
        simulate(system, [1.0], duration=2000)
    assert caught.value.time == 1023
    assert caught.value.trajectory.states.shape == (1, 1024)


# --- divergence and trouble on the way


@pytest.mark.parametrize("method", SOLVERS)
def test_finite_escape_time(method):
    with pytest.raises(
        sb.DivergenceError, match=r"stopped at t = 1, x = .* of 201 samples"
    ) as caught:
        simulate(lambda x: x**2, [1.0], duration=2.0, method=method)
    error = caught.value
    assert error.time == pytest.approx(1, abs=1e-5)
    assert error.state[0] > 1e6
    t = error.trajectory.times[:95]
    assert len(t) == 95
    assert np.allclose(error.trajectory.states[0, :95], 1 / (1 - t), rtol=1e-4)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "LSODA"])
def test_overflow(method):
    with pytest.raises(sb.DivergenceError) as caught:
        simulate(lambda x: 1e3 * x, [1.0], times=[0, 0.5, 1], rtol=1e-3, method=method)
    assert caught.value.time == pytest.approx(np.log(np.finfo(float).max) / 1e3, rel=0.05)
    assert caught.value.trajectory.times.tolist() == [0, 0.5]
    assert np.isfinite(caught.value.state).all()


def test_one_of_a_batch_diverges():
    with pytest.raises(sb.DivergenceError) as caught:
        simulate(lambda x: x**2, [[-1.0, 1.0]], duration=2.0)
    assert caught.value.state.shape == (1, 2)
    assert caught.value.state[0, 0] == pytest.approx(-0.5, rel=1e-5)


@pytest.mark.parametrize("method", ["rk4", "backward_euler", "semi_implicit_euler"])
def test_fixed_steps_diverge(method):
    with pytest.raises(sb.DivergenceError) as caught:
        simulate(
            lambda x: np.stack([x[1], x[0] ** 3]), [1.0, 1.0], times=np.arange(50.0), method=method
        )
    assert caught.value.trajectory.times[-1] == caught.value.time


def test_a_control_that_stops_being_finite():
    with pytest.raises(sb.DivergenceError, match=r"u\(x, t\) is not finite at t = 1") as caught:
        simulate(double_integrator, [0.0, 0.0], lambda x, t: np.sqrt(1 - t), duration=2.0)
    assert caught.value.time == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("bad", [lambda x, t: np.nan, lambda x, t: 1.0 / (t - t)])
def test_a_control_that_fails_at_a_sample(bad):
    def policy(x, t):
        return bad(x, t) if t >= 1 else 1.0

    with pytest.raises(sb.DivergenceError, match=r"stopped at t = 1, .* 3 of 5 samples") as caught:
        simulate(double_integrator, [0, 0], policy, times=np.linspace(0, 2, 5), method="euler")
    assert caught.value.trajectory.controls is None
    assert caught.value.trajectory.states[1].tolist() == [0, 0.5, 1]


@pytest.mark.parametrize("method", [*SOLVERS, "rk4"])
def test_dynamics_that_are_not_finite_after_a_switch(method):
    u = sb.ControlTrajectory.piecewise_constant([0, 1, 2], [4, -4])
    with pytest.raises(sb.DivergenceError, match="dynamics are not finite at t = 1") as caught:
        simulate(lambda x, u: np.sqrt(u), [0.0], u, times=[0, 0.5, 1, 2], method=method)
    assert caught.value.time == 1
    assert np.allclose(caught.value.trajectory.states, [[0, 1, 2]], rtol=1e-6)


def test_a_python_overflow_is_a_divergence():
    import math

    with pytest.raises(sb.DivergenceError):
        simulate(lambda x: [math.exp(x[0])], [0.0], duration=2.0)


def test_chattering_is_named_instead_of_taking_forever():
    with pytest.raises(sb.DivergenceError, match="discontinuous") as caught:
        simulate(double_integrator, [1.0, 0.0], lambda x, t: -np.sign(x[0] + x[1]), duration=90.0)
    assert 0.5 < caught.value.time < 1


def test_a_policy_may_leave_its_domain_in_a_trial_step():
    # sqrt(h) is not a number where a trial step overshoots the empty tank; the tank never is.
    trajectory = simulate(lambda x: -np.sqrt(x), [1.0], times=np.linspace(0, 1.99, 5))
    assert np.allclose(trajectory.states[0], (1 - trajectory.times / 2) ** 2, atol=1e-8)


def test_samples_end_before_a_step_whose_interpolation_has_no_value():
    # DOP853 looks at places within a step, once it is made, for the sake of the samples there.
    asked, hole = [], []

    def f(x):
        asked.append(np.ravel(x)[0])
        return np.array([1.0, np.nan if asked[-1] in hole else 2 * x[0]])

    times = np.linspace(0, 3, 31)
    run = simulate(f, [0.0, 0.0], times=times, method="DOP853")
    assert np.allclose(run.states, [times, times**2])
    hole = asked[-3:]
    with pytest.raises(sb.DivergenceError, match="the interpolation is not finite") as caught:
        simulate(f, [0.0, 0.0], times=times, method="DOP853")
    run = caught.value.trajectory
    assert 1 < len(run.times) < 31 and max(run.times) < min(hole)
    assert np.allclose(run.states, [run.times, run.times**2])


@pytest.mark.parametrize("method", ["RK45", "Radau", "rk4"])
def test_the_callers_own_errors_come_through(method):
    def f(x):
        if x[0] < 0.5:
            raise ValueError("out of fuel")
        return -x

    with pytest.raises(ValueError, match="out of fuel"):
        simulate(f, [1.0], times=np.linspace(0, 2, 41), method=method)


# --- bad arguments


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"duration": None}, ValueError, "give either duration or times"),
        ({"times": [0, 1]}, ValueError, "give either duration or times, not both"),
        ({"duration": 0}, ValueError, "duration must be greater than 0"),
        ({"duration": np.nan}, ValueError, "duration must be finite"),
        ({"duration": None, "times": [0, 2, 1]}, ValueError, "times must increase, got 2 before 1"),
        ({"duration": None, "times": []}, ValueError, "times must hold at least 1"),
        ({"x0": [1.0, np.nan]}, ValueError, "x0 must be finite"),
        ({"x0": 1.0}, ValueError, r"x0 must have shape \(n,\) or \(n, N\), got \(\)"),
        ({"x0": [1.0, 1j]}, TypeError, "x0 must be real"),
        ({"x0": [1.0]}, ValueError, "x0 must have n = 2 rows"),
        ({"method": "RK54"}, ValueError, "method must be one of RK45"),
        ({"method": "rk4"}, ValueError, 'method "rk4" steps from time to time: give times'),
        ({"rtol": 0}, ValueError, "rtol must be greater than 0"),
        ({"atol": -1}, ValueError, "atol must be greater than 0"),
        ({"u": [1.0, 2.0]}, ValueError, r"u must have shape \(1,\), got \(2,\)"),
        ({"u": "a"}, TypeError, "u must be"),
        ({"u": np.inf}, ValueError, "u must be finite"),
        ({"u": lambda x, t: [1, 2]}, ValueError, r"u\(x, t\) must have shape \(1,\), got \(2,\)"),
        ({"u": lambda x, t: None}, TypeError, r"u\(x0, t0\) must be"),
        ({"u": lambda x, t: np.nan}, ValueError, r"u\(x0, t0\) must be finite"),
        ({"u": lambda x, t: [0] if t == 0 else 1j}, TypeError, r"u\(x, t\) must be real"),
        (
            {"u": sb.ControlTrajectory.piecewise_constant([0, 1], [1])},
            ValueError,
            r"u must cover the simulated times \[0, 2\], got a control trajectory over \[0, 1\]",
        ),
        (
            {"u": sb.ControlTrajectory.piecewise_constant([0, 2], [[1], [2]])},
            ValueError,
            "u must have m = 1 inputs, got a control trajectory of 2",
        ),
        ({"system": 3}, TypeError, "system must be"),
    ],
)
def test_bad_arguments(arguments, error, message):
    good = {"system": sb.Pendulum(), "x0": [1.0, 0.0], "duration": 2.0}
    with pytest.raises(error, match=message):
        simulate(**(good | arguments))


@pytest.mark.parametrize(
    ("f", "error", "message"),
    [
        (lambda x: [1.0, 2.0, 3.0], ValueError, r"must have shape \(2,\), got \(3,\)"),
        (lambda x: x * np.nan, ValueError, "must be finite"),
        (lambda x: 1j * x, TypeError, "complex"),
        (lambda x: None, TypeError, "must be an array of numbers"),
        (lambda x: x if x[0] < 2 else x[:1], ValueError, r"must have shape \(2,\), got \(1,\)"),
    ],
)
def test_dynamics_that_return_the_wrong_thing(f, error, message):
    with pytest.raises(error, match=message):
        simulate(f, [1.0, 0.0], duration=2.0)
