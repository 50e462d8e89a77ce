"""Input delays: in simulation, in the linear verdict, and how much of it a loop bears."""

import control
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb

UP = [np.pi / 2, 0.0]


def double_integrator(x, u):
    return np.stack([x[1], u[0]])


# --- simulation


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "LSODA"])
def test_the_method_of_steps(method):
    # x' = -x(t - 1), with nothing arriving before 1: polynomials from unit to unit.
    times = np.array([0, 0.5, 1, 1.5, 2, 2.5, 3, 4])
    run = sb.simulate(
        lambda x, u: u, [1.0], lambda x, t: -x[0], times=times, delay=1.0, method=method
    )

    def exact(t):
        s = [(t - k) for k in range(5)]
        terms = [(-1) ** k * max(s[k], 0) ** k / np.prod(range(1, k + 1)) for k in range(1, 5)]
        return 1 + sum(terms)

    assert run.states[0] == pytest.approx([exact(t) for t in times], abs=1e-6)
    assert run.controls[0] == pytest.approx([0, 0, *(-exact(t - 1) for t in times[2:])], abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(delay=st.floats(0.01, 1.0), gap=st.sampled_from([0.05, 0.2]))
def test_plans_and_pulses_arrive_later_exactly(delay, gap):
    times = np.arange(round(3 / gap) + 1) * gap
    plan = sb.ControlTrajectory.piecewise_constant([0, 0.7, 3.0], [3.0, -1.0])
    run = sb.simulate(double_integrator, [0, 0], plan, times=times, delay=delay, u_before=[0.5])
    on, after = np.clip(times - delay, 0, 0.7), np.maximum(times - delay - 0.7, 0)
    v = 0.5 * np.minimum(times, delay) + 3 * on - after
    assert np.allclose(run.states[1], v, atol=1e-9)
    policy = sb.simulate(
        double_integrator,
        [0, 0],
        lambda x, t: 3.0 if t < 0.7 else -1.0,
        times=times,
        delay=delay,
        u_before=0.5,
        switches=[0.7],
    )
    assert np.allclose(policy.states, run.states, atol=1e-7)


def test_delay_of_a_ramp_replays():
    plan = sb.ControlTrajectory.polynomial([0.0, 1.0, -0.5], 3.0)
    run = sb.simulate(sb.Pendulum(), [1.0, 0.0], plan, delay=0.25)
    assert run.control_at(1.25) == pytest.approx([1 - 0.5])
    again = sb.simulate(sb.Pendulum(), *run.to_control_space(), times=run.times)
    assert np.array_equal(again.states, run.states)


def test_delay_of_a_batch_and_no_delay():
    x0 = np.array([[1.0, -0.5], [0.0, 0.2]])
    law = {"u": lambda x, t: -2 * x[0] - x[1], "duration": 4.0}
    many = sb.simulate(double_integrator, x0, delay=0.3, **law)
    for i in range(2):
        alone = sb.simulate(double_integrator, x0[:, i], delay=0.3, **law)
        assert np.allclose(many.states[:, i], alone.states, atol=1e-7)
    none = sb.simulate(double_integrator, x0, delay=1e-13, **law)
    assert np.allclose(none.states, sb.simulate(double_integrator, x0, **law).states, atol=1e-7)


# --- Pade


@pytest.mark.parametrize("order", [1, 3, 5, 10])
def test_pade_in_each_input(order):
    sys = control.ss(
        [[0, 1], [-3, -0.4]], [[0, 1], [2, 0.5]], np.eye(2), [[0, 0], [1, 0]],
        states=["p", "v"], inputs=["f", "g"],
    )  # fmt: skip
    late = sb.with_input_delay(sys, 0.3, order=order)
    assert late.state_labels[:2] == ["p", "v"]
    assert (late.input_labels, late.nstates) == (["f", "g"], 2 + 2 * order)
    for omega in (0.1, 1.0, 3.0):
        shift = np.exp(-0.3j * omega)
        error = np.abs(late(1j * omega) - sys(1j * omega) * shift).max()
        assert error < 3 * (0.3 * omega / 2) ** (2 * order + 1) + 1e-9


def test_waiting_in_discrete_time_is_exact():
    sys = control.ss([[0.5]], [[1.0]], [[1.0]], [[2.0]], dt=0.1)
    late = sb.with_input_delay(sys, 0.3)
    z = np.exp(0.4j)
    assert late(z) == pytest.approx(sys(z) / z**3)
    assert sb.with_input_delay(sys, 0.0)(z) == pytest.approx(sys(z))
    with pytest.raises(ValueError, match="delay must be whole samples"):
        sb.with_input_delay(sys, 0.25)


def test_no_delay_and_bad_arguments():
    sys = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    assert sb.with_input_delay(sys, 0)(2j) == pytest.approx(sys(2j))
    assert sb.with_input_delay(sb.Particle(), 0.1, order=2).nstates == 4
    for arguments, message in (
        ((sys, -1), "delay must be at least 0"),
        ((sb.Pendulum(), 0.1), "sys must be linear; call linearize"),
    ):
        with pytest.raises(ValueError, match=message):
            sb.with_input_delay(*arguments)
    for order in (0, 11):
        with pytest.raises(ValueError, match="order must be at"):
            sb.with_input_delay(sys, 0.1, order=order)


# --- the margin


@pytest.mark.parametrize(
    ("f", "policy", "n", "delay"),
    [
        # x' = -a x - b x(t - d): cos(omega d) = -a/b, omega^2 = b^2 - a^2.
        (lambda x, u: u, lambda x, t: -3 * x, 1, np.pi / 6),
        (lambda x, u: -x + u, lambda x, t: -2 * x, 1, np.arccos(-0.5) / np.sqrt(3)),
        (lambda x, u: x + u, lambda x, t: -2 * x, 1, np.arccos(0.5) / np.sqrt(3)),
        (lambda x, u: -2 * x + u, lambda x, t: -x, 1, np.inf),
        # Two independent loops: the slower bears more.
        (lambda x, u: u, lambda x, t: -np.array([1.0, 5.0]) * x, 2, np.pi / 10),
    ],
)
def test_margins_in_closed_form(f, policy, n, delay):
    margin = sb.delay_margin(f, policy, np.zeros(n), confirm=False)
    assert margin.delay == pytest.approx(delay, rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 4), scale=st.sampled_from([1e-3, 1.0, 1e4]))
def test_margins_against_python_controls_phase_margin(seed, n, scale):
    # One input: the smallest phase margin over all crossovers, divided by its frequency.
    rng = np.random.default_rng(seed)
    A, B = scale * rng.normal(size=(n, n)), rng.normal(size=(n, 1))
    K = np.asarray(control.lqr(A / scale, B, np.eye(n), np.eye(1))[0]) * scale
    margin = sb.delay_margin(
        lambda x, u: A @ x + B @ u, lambda x, t: -K @ x, np.zeros(n), confirm=False
    )
    loop = control.ss(A, B, K, 0)
    _, phases, _, _, crossovers, _ = control.stability_margins(loop, returnall=True)
    delays = np.deg2rad(phases % 360) / crossovers
    assert margin.delay == pytest.approx(min([np.inf, *delays]), rel=1e-5)


@pytest.mark.parametrize("gains", [[3.0], [1.0, 5.0], [5.0, 1.0]])
def test_the_confirmed_growth_is_that_of_the_characteristic_equation(gains):
    # x' = -k x(t - d) grows as Re s, where s = -k exp(-s d): s d = W(-k d), of Lambert.
    margin = sb.delay_margin(
        lambda x, u: u, lambda x, t: -np.array(gains) * x, np.zeros(len(gains))
    )
    late = np.array([0.95, 1.05]) * margin.delay
    exact = (scipy.special.lambertw(-max(gains) * late) / late).real
    assert margin.growth == pytest.approx(exact, rel=0.02)


def test_the_margin_is_confirmed_from_both_sides():
    pendulum = sb.Pendulum(m=0.8, L=1.2)
    law = sb.LQR(pendulum, UP)
    margin = sb.delay_margin(pendulum, law, UP)
    assert margin.growth[0] < 0 < margin.growth[1]
    assert "5 % more" in repr(margin)
    # The nonlinear loop, by simulation, and the linear one, by Pade.
    plant = sb.linearize(pendulum, UP, [0.0])
    for share, stable in ((0.93, True), (1.07, False)):
        run = sb.simulate(
            pendulum, [UP[0] + 1e-4, 0], law, duration=40.0, delay=share * margin.delay, rtol=1e-6
        )
        error = np.abs(run.states[0] - UP[0])
        assert (error[-40:].max() < 0.5 * error[60:100].max()) == stable
        late = sb.with_input_delay(plant, share * margin.delay)
        K = np.zeros((1, late.nstates))
        K[:, :2] = law.K
        closed = np.asarray(late.A) - np.asarray(late.B) @ K
        assert (sb.stability(closed).verdict == "asymptotically stable") == stable


def test_any_delay_and_loops_without_a_margin():
    margin = sb.delay_margin(lambda x, u: -2 * x + u, lambda x, t: -x, [0.0])
    assert repr(margin) == "DelayMargin(any delay)"
    with pytest.raises(ValueError, match="must be stable without a delay, but an eigenvalue"):
        sb.delay_margin(sb.Pendulum(), lambda x, t: 0.0, UP)
    with pytest.raises(ValueError, match="continuous time"):
        sb.delay_margin(control.ss([[0.5]], [[1.0]], 1, 0, dt=1), lambda x, t: -0.1 * x, [0.0])
    with pytest.raises(TypeError, match="policy must be a function"):
        sb.delay_margin(sb.Pendulum(), 3, UP)
