"""Controllers do what they promise, or refuse to be made."""

from __future__ import annotations

import pickle
import re

import control
import numpy as np
import pytest
import scipy
from hypothesis import example, given, settings
from hypothesis import strategies as st

import statebook as sb


@pytest.mark.parametrize(("distance", "m", "force"), [(1.0, 1.0, 1.0), (-3.0, 2.0, 0.7)])
def test_bang_bang_moves_from_rest_to_rest(distance, m, force):
    plan = sb.bang_bang(distance, m=m, force=force)
    end = sb.simulate(sb.Particle(m=m), [0.3, 0.0], plan).states[:, -1]
    np.testing.assert_allclose(end, [0.3 + distance, 0.0], atol=1e-8)
    assert plan.duration == pytest.approx(2 * np.sqrt(m * abs(distance) / force), rel=1e-15)


def test_pd_eigenvalues_are_those_of_the_characteristic_polynomial():
    kp, kd, m = 5.0, 1.3, 1.7
    policy = sb.PD(sb.Particle(m=m), target=[2.0], kp=kp, kd=kd)
    A, _ = sb.jacobians(lambda x: sb.Particle(m=m).dynamics(x, policy(x, 0.0)), [2.0, 0.0])
    expected = np.roots([m, kd, kp])
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(A)), np.sort(expected), rtol=1e-12)


def test_pd_holds_an_arm_against_gravity():
    arm = sb.PlanarArm(lengths=(0.9, 0.6), masses=(2.0, 1.0))
    policy = sb.PD(arm, target=[0.4, -0.9], kp=60.0, kd=25.0)
    np.testing.assert_allclose(policy.u0, arm.inverse_dynamics([0.4, -0.9], [0, 0], [0, 0]))
    end = sb.simulate(arm, [0.0, 0.0, 0.0, 0.0], policy, duration=12.0).states[:, -1]
    np.testing.assert_allclose(end, [0.4, -0.9, 0, 0], atol=1e-5)


def test_pd_saturates_and_takes_batches():
    policy = sb.PD(sb.Pendulum(), target=[np.pi / 2], kp=12.0, kd=3.0, limit=5.0)
    x = np.array([[0.0, 1.5, 3.0], [0.0, 0.1, 4.0]])
    u = policy(x, 0.0)
    assert u.shape == (1, 3) and np.abs(u).max() == 5.0
    for k in range(3):
        np.testing.assert_array_equal(policy(x[:, k], 0.0), u[:, k])


def test_pid_removes_a_constant_disturbance_and_pd_does_not():
    particle, push = sb.Particle(m=2.0), 0.8
    pid = sb.PID(particle, target=[1.0], kp=6.0, ki=3.0, kd=5.0)
    end = sb.simulate(pid.loop, [0, 0, 0], [push], duration=40.0).states[:, -1]
    np.testing.assert_allclose(end, [1.0, 0.0, push / 3.0], atol=1e-6)
    pd = sb.PD(particle, target=[1.0], kp=6.0, kd=5.0)
    disturbed = sb.simulate(particle, [0, 0], lambda x, t: pd(x, t) + push, duration=40.0)
    assert disturbed.states[0, -1] == pytest.approx(1.0 + push / 6.0, rel=1e-6)


LAG = control.ss(control.tf([1.0], [1.0, 3.0, 3.0, 1.0]), name="lag")
DIGITAL = sb.discretize(control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0), 0.5)
FEEDTHROUGH = control.ss([[-1.0]], [[1.0]], [[1.0]], [[1.0]])
LOOKING_AHEAD = control.nlsys(
    lambda t, x, u, p: -x + u, lambda t, x, u, p: x + u, states=1, inputs=1, outputs=1
)


def tank(x, u):
    return [u[0] - 0.5 * np.sqrt(x[0]), 0.5 * np.sqrt(x[0]) - 0.1 * x[1]]


def servo(tracked=("p",), **options):
    return sb.LQR(sb.Particle(), [0, 0], tracked=tracked, **options)


def rest_of(pid, start=None, disturbance=None, duration=60.0):
    """Return what is measured and the state at the end of the closed loop."""
    start = np.zeros(pid.loop.n) if start is None else start
    return sb.simulate(pid.loop, start, disturbance, duration=duration, rtol=1e-7).states[:, -1]


@pytest.mark.parametrize("target", [1.0, -3.0, 4e5])
def test_pid_of_a_measured_output_removes_a_disturbance(target):
    pid = sb.PID(LAG, [target], kp=2.0, ki=0.8, kd=1.0)
    assert pid.loop.states == ("x[0]", "x[1]", "x[2]", "z1", "f1")
    assert pid.filter_time == 0.05
    end = rest_of(pid, disturbance=[0.3 * target])
    np.testing.assert_allclose(LAG.C @ end[:3], [target], rtol=1e-6)
    assert end[3] * 0.8 == pytest.approx(0.3 * target, rel=1e-5)


def test_pid_of_a_plain_function_has_one_input_unless_a_guess_says_more():
    # Every input alike: what a function reads of u does not tell how many there are.
    pid = sb.PID(
        lambda x, u: [x[1], np.sum(u) - x[1]], [2.0], 3.0, 1.0, 0.0, outputs=[[1.0, 0.0]],
        x_guess=[2.0, 0.0],
    )  # fmt: skip
    assert pid.u0.shape == (1,) and pid.loop.m == 1
    assert rest_of(pid, disturbance=[0.5])[0] == pytest.approx(2.0, abs=1e-6)


def test_pid_is_the_transfer_function_with_a_filtered_derivative():
    kp, ki, kd, Tf = 2.0, 0.8, 1.0, 0.07
    pid = sb.PID(LAG, [0.0], kp=kp, ki=ki, kd=kd, filter_time=Tf)
    filtered = np.polymul([Tf, 1.0], [1.0, 0.0])  # s (Tf s + 1)
    law = np.polyadd(kp * filtered, [kd, ki * Tf, ki])
    poles = np.roots(np.polyadd(np.polymul([1.0, 3.0, 3.0, 1.0], filtered), law))
    found = sb.stability(pid.loop, np.zeros(5)).eigenvalues
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(poles), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("Tf", [0.02, 0.3])
def test_filtered_derivative_of_a_sampled_ramp_is_its_slope(Tf):
    dt = 0.5
    slope = 3.0
    plant = sb.discretize(LAG, dt)
    options = {"kp": 0.5, "ki": 0.01, "outputs": plant.C}
    digital = sb.PID(plant, [0.0], kd=0.1, filter_time=Tf, **options)
    without = sb.PID(plant, [0.0], kd=0.0, **options)
    state = np.zeros(5)
    for k in range(200):
        state[:3] = np.linalg.pinv(plant.C)[:, 0] * slope * dt * k  # y = slope t
        rate = (without(state[:4], 0.0) - digital(state, 0.0)) / 0.1
        state[4] = digital.loop.dynamics(state, [0.0])[4]
    assert rate[0] == pytest.approx(slope, rel=1e-9)


def test_pid_in_discrete_time_sums_and_reaches_its_target():
    plant = sb.discretize(LAG, 0.1)
    pid = sb.PID(plant, [5.0], kp=2.0, ki=0.8, kd=1.0, filter_time=0.4)
    assert pid.loop.dt == 0.1
    np.testing.assert_allclose(plant.C @ rest_of(pid, disturbance=[0.4])[:3], [5.0], rtol=1e-6)
    x = np.array([1.0, 2.0, -1.0, 0.5, 0.3])
    y = float((plant.C @ x[:3])[0])
    later = pid.loop.dynamics(x, [0.0])
    assert later[3] == pytest.approx(0.5 + 0.1 * (y - 5.0))
    assert later[4] == pytest.approx(y + np.exp(-0.1 / 0.4) * (0.3 - y))
    np.testing.assert_allclose(later[:3], plant.A @ x[:3] + plant.B @ pid(x, 0.0))
    unit = control.ss(plant.A, plant.B, plant.C, plant.D, True)
    later = sb.PID(unit, [5.0], kp=0.4, ki=0.01, kd=0.0).loop.dynamics(x[:4], [0.0])
    assert later[3] == pytest.approx(0.5 + (y - 5.0))


def test_pid_finds_what_holds_a_nonlinear_plant():
    pid = sb.PID(
        tank, [40.0], kp=0.3, ki=0.01, kd=0.0, outputs=["x[1]"], x_guess=[50.0, 30.0], u_guess=[3.0]
    )
    np.testing.assert_allclose(pid.x0, [64.0, 40.0], rtol=1e-9)
    np.testing.assert_allclose(pid.u0, [4.0], rtol=1e-9)
    assert rest_of(pid, [60.0, 35.0, 0.0], [0.1], 1500.0)[1] == pytest.approx(40.0, rel=1e-5)
    squared = control.nlsys(
        lambda t, x, u, p: -(x**3) + u, lambda t, x, u, p: x**2, states=1, inputs=1, outputs=1
    )
    pid = sb.PID(squared, [4.0], kp=2.0, ki=3.0, kd=0.0, x_guess=[1.5])
    np.testing.assert_allclose([pid.x0, pid.u0], [[2.0], [8.0]], rtol=1e-8)
    batch = np.array([[1.0, 2.0, 3.0], [0.0, 0.1, 0.2]])
    np.testing.assert_allclose(pid(batch, 0.0), [8.0 - 2.0 * (batch[0] ** 2 - 4) - 3.0 * batch[1]])


def test_pid_pairs_inputs_and_outputs():
    arm = sb.PlanarArm()
    pid = sb.PID(arm, [0.3, 0.4], kp=[80.0, 40.0], ki=[10.0, 5.0], kd=[30.0, 20.0])
    x = np.array([0.5, 0.1, 1.0, -2.0, 0.2, 0.3])
    expected = pid.u0 - [80 * 0.2 + 10 * 0.2 + 30, -40 * 0.3 + 5 * 0.3 - 40]
    np.testing.assert_allclose(pid(x, 0.0), expected)
    crossed = [[2.0, -1.0], [0.0, 1.0]]
    two = control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    pid = sb.PID(two, [1.0, 2.0], kp=crossed, ki=1.0, kd=0.0)
    np.testing.assert_allclose(pid([2.0, 5.0, 0, 0], 0.0), [1 - 2 * 1 + 3, 2 - 3])
    named = sb.PID(two, [2.0], [[0.0], [1.0]], [[0.0], [1.0]], [[0], [0]], outputs=["y[1]"])
    np.testing.assert_allclose(named.u0[1], 2.0)


@settings(deadline=None, max_examples=60)
@given(
    st.floats(0.1, 10), st.floats(0.05, 5), st.floats(-50, 50), st.floats(-50, 50),
    st.floats(0.3, 20),
)  # fmt: skip
def test_no_integral_grows_into_a_limit(kp, ki, x, z, limit):
    plant = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    pid = sb.PID(plant, [0.2], kp=kp, ki=ki, kd=0.0, limit=limit)
    u, rate = pid([x, z], 0.0)[0], pid.loop.dynamics([x, z], [0.0])
    wanted = 0.2 - kp * (x - 0.2) - ki * z
    assert u == np.clip(wanted, -limit, limit)
    assert rate[0] == pytest.approx(-x + u)
    growing = abs(u) == limit and -ki * (x - 0.2) * u > 0
    assert rate[1] == (0.0 if growing else pytest.approx(x - 0.2))


@pytest.mark.parametrize("far", [-30.0, 12.0])
def test_anti_windup_is_what_keeps_the_overshoot_small(far):
    pid = sb.PID(sb.Particle(), target=[0.0], kp=4.0, ki=1.0, kd=4.0, limit=1.0)

    def unguarded(y):
        q, v, z = y
        return [v, np.clip(-4 * q - 4 * v - z, -1, 1), q]

    guarded = sb.simulate(pid.loop, [far, 0, 0], [0.0], duration=60.0, rtol=1e-6).states[0]
    wound = sb.simulate(unguarded, [far, 0, 0], duration=60.0, rtol=1e-6).states[0]
    beyond = -np.sign(far)
    assert max(beyond * wound) > 4 * max(0.1, *(beyond * guarded))
    assert abs(guarded[-1]) < 1e-2


def test_pid_does_not_wind_up():
    far = [-30.0, 0.0, 0.0]
    pid = sb.PID(sb.Particle(), target=[0.0], kp=4.0, ki=1.0, kd=4.0, limit=1.0)
    x = sb.simulate(pid.loop, far, [0.0], duration=60.0, rtol=1e-6).states
    assert np.abs(x[2]).max() < 15.0  # unguarded, z grows past 100 on the way
    assert abs(x[0, -1]) < 1e-2


def test_lqr_solves_the_riccati_equation():
    cart, top = sb.CartPole(m_cart=1.5, m_pole=0.4, L=0.7), [0.2, np.pi / 2, 0, 0]
    Q, R = np.diag([2.0, 5.0, 0.1, 0.3]), np.diag([0.7, 9.0])
    regulator = sb.LQR(cart, top, Q=Q, R=R)
    A, B = sb.jacobians(cart, top)
    S = scipy.linalg.solve_continuous_are(A, B, Q, R)
    np.testing.assert_allclose(regulator.S, S, rtol=1e-8)
    np.testing.assert_allclose(regulator.K, np.linalg.solve(R, B.T @ S), rtol=1e-8)


def test_weights_are_matrices_diagonals_or_numbers():
    for Q, R in ((3.0, 0.5), ([3.0, 3.0], [0.5]), (3 * np.eye(2), [[0.5]])):
        K = sb.LQR(sb.Particle(), [0, 0], Q=Q, R=R).K
        np.testing.assert_allclose(
            K, control.lqr([[0, 1], [0, 0]], [[0], [1]], 3 * np.eye(2), 0.5)[0]
        )
    cart, top = sb.CartPole(), [0, np.pi / 2, 0, 0]
    both = sb.LQR(cart, top, Q=[1, 2, 3, 4], R=[0.1, 2.0]).K
    np.testing.assert_array_equal(
        both, sb.LQR(cart, top, Q=np.diag([1.0, 2, 3, 4]), R=np.diag([0.1, 2.0])).K
    )


PLANTS = {
    "particle": (sb.Particle(), [0, 0]),
    "sampled": (DIGITAL, [0, 0]),
    "oscillator": (sb.Oscillator(), [0, 0]),
    "pendulum": (sb.Pendulum(), [np.pi / 2, 0]),
    "damped": (sb.Oscillator(damping=0.5), [0, 0]),
    "cart": (sb.CartPole(), [0, np.pi / 2, 0, 0]),
    "chain": (control.ss(np.eye(3, k=1), np.eye(3)[:, 2:], np.eye(3), 0), [0, 0, 0]),
}


@pytest.mark.parametrize(
    ("plant", "Q", "mode"),
    [
        ("particle", [0, 1], "0"),
        ("particle", 0, "0"),
        ("sampled", [0, 1], "1"),
        ("oscillator", 0, "1j"),
        ("cart", [0, 1, 1, 1], "0"),
        ("chain", [0, 1, 1], "0"),
        ("chain", [0, 0, 1], "0"),
    ],
)
def test_weights_that_do_not_see_a_mode_are_refused(plant, Q, mode):
    with pytest.raises(ValueError, match=f"Q must see .* the mode {mode} of"):
        sb.LQR(*PLANTS[plant], Q=Q, R=1.0)


@pytest.mark.parametrize(
    ("plant", "Q"),
    [
        ("particle", [1, 0]),
        ("particle", [1e-12, 0]),
        ("sampled", [1, 0]),
        ("oscillator", [0, 1]),
        ("oscillator", [1, 0]),
        ("pendulum", 0),  # what grows is stabilized, seen or not
        ("damped", 0),
        ("chain", [1, 0, 0]),
        ("cart", [1, 0, 0, 0]),
    ],
)
def test_weights_that_see_enough_stabilize(plant, Q):
    system, x0 = PLANTS[plant]
    regulator = sb.LQR(system, x0, Q=Q, R=1.0)
    A, B = sb.jacobians(system, x0)
    assert sb.stability(A - B @ regulator.K, dt=sb.as_system(system).dt).spectral_margin > 0


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"Q": [1, -1e-3]}, "Q must be positive semidefinite"),
        ({"Q": [1e12, -1.0]}, "Q must be positive semidefinite"),
        ({"Q": [[1, 2], [2, 1]]}, "Q must be positive semidefinite"),
        ({"Q": [[1, 2], [0, 1]]}, "Q must be symmetric"),
        ({"Q": [1, 2, 3]}, r"Q must have shape \(2, 2\), be its diagonal"),
        ({"Q": np.nan}, "Q must be finite"),
        ({"R": 0.0}, "R must be positive definite"),
        ({"R": -1.0}, "R must be positive definite"),
        ({"R": [1, 2]}, r"R must have shape \(1, 1\)"),
        ({"R": "much"}, "R must be an array of numbers"),
    ],
)
def test_weights_that_are_none_are_refused(weights, message):
    with pytest.raises((TypeError, ValueError), match=message):
        sb.LQR(sb.Particle(), [0, 0], **weights)


def test_modes_that_no_input_moves_are_named():
    stuck = control.ss(np.diag([-1.0, 0.5, -2]), [[1.0], [0], [1]], np.eye(3), 0)
    with pytest.raises(ValueError, match=r"no gain stabilizes .* moves its mode 0\.5"):
        sb.LQR(stuck, [0, 0, 0])
    with pytest.raises(ValueError, match=r"no input moves its mode 0$"):
        sb.LQR(control.ss([[0.0]], [[0.0]], 1, 0), [0])
    decaying = control.ss(np.diag([-1.0, -1e-7, -2]), [[1.0], [0], [1]], np.eye(3), 0)
    assert not sb.LQR(decaying, [0, 0, 0], Q=[1, 0, 1]).K[0, 1]


@pytest.mark.parametrize(
    ("block", "dt", "mode"),
    [
        (np.eye(3, k=1), 0, "0"),
        (np.eye(3, k=1) + np.eye(3), 0.1, "1"),
        (np.eye(3, k=1) - np.eye(3), 0.1, "-1"),
        (np.diag([1.5, 0.2, -0.3]), 0.1, "1.5"),
        (np.diag([-1.25, 0.2, -0.3]), 0.1, "-1.25"),
        (np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 0.1]]), 0.1, r"0.6 [+-] 0.8j"),
    ],
)
def test_modes_that_no_input_moves_are_named_in_any_coordinates(block, dt, mode):
    # Rounding takes the eigenvalues of a Jordan block of three 1e-5 apart, but not their name.
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    A, B = np.zeros((5, 5)), np.zeros((5, 1))
    A[:3, :3], A[3:, 3:], B[3:] = block, [[-0.5, 0.3], [0.0, 0.4]], 1.0
    stuck = control.ss(turn @ A @ turn.T, turn @ B, np.eye(5), 0, dt)
    with pytest.raises(ValueError, match=rf"no input moves its mode {mode}$"):
        sb.LQR(stuck, np.zeros(5))


@pytest.mark.parametrize(("pole", "effect"), [(1e8, 1.0), (3.0, 1e-9), (0.2, 1e12)])
def test_units_of_the_input_do_not_decide_what_it_moves(pole, effect):
    gain = sb.LQR(lambda x, u: [pole * x[0] + effect * u[0]], [0.0], Q=0.0).K
    assert gain[0, 0] * effect == pytest.approx(2 * pole, rel=1e-6)  # mirrors the pole


def test_integral_action_is_that_of_python_control():
    A, B = np.array([[0, 1], [0, 0]]), np.array([[0], [1.0]])
    K, S, _ = control.lqr(
        control.ss(A, B, np.eye(2), 0),
        np.diag([1, 1, 2.0]),
        [[1.0]],
        integral_action=np.array([[1, 0]]),
    )
    regulator = servo(integral=2.0)
    np.testing.assert_allclose(regulator.K, K, rtol=1e-8)
    np.testing.assert_allclose(regulator.S, S, rtol=1e-8)
    Kd, _, _ = control.dlqr(
        DIGITAL, np.diag([1, 1, 2.0]), [[1.0]], integral_action=np.array([[1, 0]])
    )
    digital = sb.LQR(DIGITAL, [0, 0], tracked=[[1.0, 0.0]], integral=2.0)
    np.testing.assert_allclose(digital.K, Kd, rtol=1e-8)
    later = digital.loop.dynamics([1.0, 2.0, 3.0], [0.5])
    np.testing.assert_allclose(
        later, [*(DIGITAL.A @ [1, 2] + DIGITAL.B @ (digital([1, 2, 3], 0) + 0.5)), 4.0]
    )


def test_integral_action_removes_what_disturbs_and_the_reference_is_reached():
    cart, top = sb.CartPole(), [0, np.pi / 2, 0, 0]
    options = {"R": [1.0, 1.0], "tracked": ["p"], "reference": 2.0, "circle": ["theta"]}
    exact = sb.LQR(cart, top, integral=1.0, **options)
    assert exact.loop.states == ("p", "theta", "v", "omega", "z1")
    run = sb.simulate(exact.loop, [0, np.pi / 2 - 2 * np.pi, 0, 0, 0], [0.3, 0.1], duration=60.0)
    assert run.states[0, -1] == pytest.approx(2.0, abs=1e-5)
    plain = sb.LQR(cart, top, **options)
    np.testing.assert_allclose(
        sb.simulate(cart, top, plain, duration=60.0).states[:, -1],
        [2.0, np.pi / 2, 0, 0],
        atol=1e-4,
    )
    assert abs(sb.simulate(plain.loop, top, [0.3, 0.1], duration=60.0).states[0, -1] - 2.0) > 0.1


def test_a_reference_may_move_and_needs_its_own_input():
    sample = sb.Oscillator(damping=0.4)
    follower = sb.LQR(sample, [0, 0], tracked=["x"] if "x" in sample.states else [[1.0, 0.0]],
                      reference=lambda t: 1.0 if t < 30 else -2.0)  # fmt: skip
    for t, r in ((10.0, 1.0), (50.0, -2.0)):
        x, u = follower.target(t)
        assert x[0] == pytest.approx(r)
        np.testing.assert_allclose(sample.dynamics(x, u), 0, atol=1e-12)
        np.testing.assert_allclose(follower(x, t), u)
        assert follower.cost_to_go(x, t) == pytest.approx(0, abs=1e-20)
    ramp = sb.LQR(sb.Particle(), [0, 0], tracked=["p"], reference=lambda t: 3 + t)
    np.testing.assert_allclose(ramp.error([5.0, 1.0]), [2.0, 1.0])  # at t = 0
    assert ramp.cost_to_go([5.0, 1.0]) == ramp.cost_to_go([5.0, 1.0], 0.0)


def test_integrals_of_lqr_do_not_wind_up():
    regulator = servo(integral=1.0, limit=0.5)
    x = sb.simulate(regulator.loop, [-30, 0, 0], duration=80.0, rtol=1e-6).states
    assert np.abs(x[2]).max() < 4.0 and abs(x[0, -1]) < 1e-4
    rate = regulator.loop.dynamics([-30.0, 0.0, 0.0], [0.0])
    np.testing.assert_array_equal(rate, [0.0, 0.5, 0.0])


def test_output_feedback_by_a_kalman_filter_takes_a_few_lines():
    # Only the angle is measured; the filter and the regulator are python-control's.
    pendulum, top = sb.Pendulum(damping=0.1), np.array([np.pi / 2, 0.0])
    sys = sb.linearize(pendulum, top)
    K = sb.LQR(pendulum, top, R=0.1).K
    L, _, _ = control.lqe(sys.A, np.eye(2), sys.C[:1], np.diag([1e-4, 1e-2]), [[1e-4]])

    def loop(y):
        x, guess = y[:2], y[2:]
        u = -K @ guess
        innovation = x[:1] - top[0] - guess[:1]
        return np.concatenate([pendulum.dynamics(x, u), sys.A @ guess + sys.B @ u + L @ innovation])

    A = sys.A
    poles = np.concatenate([np.linalg.eigvals(M) for M in (A - sys.B @ K, A - L @ sys.C[:1])])
    found = sb.stability(loop, [*top, 0, 0]).eigenvalues
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(poles), rtol=1e-6)
    end = sb.simulate(loop, [np.pi / 2 + 0.2, 0, 0, 0], duration=20.0).states[:, -1]
    np.testing.assert_allclose(end, [*top, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    "make",
    [
        lambda: sb.PD(sb.Pendulum(), [np.pi / 2], kp=12.0, kd=3.0, limit=5.0),
        lambda: sb.PID(sb.Particle(), [1.0], kp=6.0, ki=2.0, kd=5.0),
        lambda: sb.PID(LAG, [1.0], kp=2.0, ki=0.8, kd=1.0),
        lambda: sb.LQR(sb.Pendulum(), [np.pi / 2, 0], circle=["theta"]),
        lambda: sb.LQR(DIGITAL, [0, 0], tracked=[[1.0, 0.0]], reference=1.0, integral=1.0),
        lambda: sb.SwingUp(sb.Pendulum(), 2.0),
        lambda: sb.HeldNoise([[1.0, 0.5], [0.5, 1.0]], 0.1, seed=1),
    ],
)
def test_controllers_pickle_and_are_equal_to_themselves_alone(make):
    first, second = make(), make()
    again = pickle.loads(pickle.dumps(first))
    assert first == first and first != second and first != again and len({first, second}) == 2
    if isinstance(first, sb.HeldNoise):
        np.testing.assert_array_equal(again(0.3, 4), first(0.3, 4))
        return
    number = first.K.shape[1] if isinstance(first, sb.LQR) else 2
    number = first.loop.n if isinstance(first, sb.PID) else number
    x = np.linspace(0.1, 0.6, number)
    np.testing.assert_array_equal(again(x, 0.0), first(x, 0.0))
    if hasattr(first, "loop"):
        assert again.loop.states == first.loop.states
        np.testing.assert_array_equal(again.loop.dynamics(x, [0.1]), first.loop.dynamics(x, [0.1]))


@settings(deadline=None, max_examples=200)
@given(st.floats(allow_nan=False, allow_infinity=False))
@example(-np.pi)
@example(np.pi)
@example(np.nextafter(-np.pi, -4))
@example(1e300)
@example(-1e-320)
def test_wrapped_angles_are_inside_and_point_the_same_way(angle):
    wrapped = sb.wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-15)
    assert sb.wrap_angle(wrapped) == wrapped
    if -np.pi <= angle < np.pi:
        assert wrapped == angle


def test_angles_of_any_shape_are_wrapped():
    angles = np.float32([[np.pi, -np.pi], [7.0, 100.0]])
    wrapped = sb.wrap_angle(angles)
    assert wrapped.shape == (2, 2) and (np.abs(wrapped) <= np.pi).all()
    turned = sb.wrap_angle(4.0 + 1e-30j)
    assert turned.real == pytest.approx(4.0 - 2 * np.pi) and turned.imag == 1e-30
    for bad in (np.inf, np.nan, "a", None, [[1], [1, 2]]):
        with pytest.raises((TypeError, ValueError), match="angle must be"):
            sb.wrap_angle(bad)


def test_lqr_in_discrete_time():
    plant = sb.discretize(control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0), 0.2)
    regulator = sb.LQR(plant, [0, 0])
    assert sb.stability(plant.A - plant.B @ regulator.K, dt=0.2).spectral_margin > 0


def test_cost_to_go_is_the_cost():
    regulator = sb.LQR(sb.Particle(m=1.4), [0, 0], Q=np.diag([1.0, 0.5]), R=[[2.0]])
    x0 = np.array([0.7, -0.4])
    run = sb.simulate(sb.Particle(m=1.4), x0, regulator, times=np.linspace(0, 40, 20001))
    rate = run.states[0] ** 2 + 0.5 * run.states[1] ** 2 + 2.0 * run.controls[0] ** 2
    cost = scipy.integrate.simpson(rate, x=run.times)
    assert regulator.cost_to_go(x0) == pytest.approx(cost, rel=1e-7)


def test_lqr_passes_a_complex_step():
    regulator = sb.LQR(sb.Pendulum(), [np.pi / 2, 0], circle=["theta"], limit=30.0)
    loop = sb.stability(lambda x: sb.Pendulum().dynamics(x, regulator(x, 0.0)), [np.pi / 2, 0])
    A, B = sb.jacobians(sb.Pendulum(), [np.pi / 2, 0])
    expected = np.linalg.eigvals(A - B @ regulator.K)
    np.testing.assert_allclose(np.sort(loop.eigenvalues), np.sort(expected), rtol=1e-12)


def test_lqr_takes_the_short_way_round_and_knows_its_level():
    regulator = sb.LQR(sb.Pendulum(), [np.pi / 2, 0], limit=3.0, circle=["theta"])
    np.testing.assert_allclose(regulator.error([np.pi / 2 - 2 * np.pi + 0.1, 0.2]), [0.1, 0.2])
    turn = np.linspace(0, 2 * np.pi, 2001)
    rim = np.linalg.cholesky(np.linalg.inv(regulator.S)) @ [np.cos(turn), np.sin(turn)]
    u = regulator.K @ rim * np.sqrt(regulator.level)
    assert np.abs(u).max() == pytest.approx(3.0, rel=1e-5)


def reach_of_full_torque(pendulum, limit):
    """Return how far from the bottom the full torque carries a swing, at most pi [rad]."""
    x, torque, best = np.array([-np.pi / 2, 0.0]), limit, 0.0

    def apex(t, x, u):
        return x[1] if t > 1e-3 else u

    def top(t, x, u):
        return abs(x[0] + np.pi / 2) - np.pi

    apex.terminal = top.terminal = True
    while True:
        run = scipy.integrate.solve_ivp(
            lambda t, x, u: pendulum.dynamics(x, [u]),
            [0, 100], x, events=[apex, top], args=(torque,), rtol=1e-8, atol=1e-10,
        )  # fmt: skip
        angle = abs(run.y[0, -1] + np.pi / 2)
        if len(run.t_events[1]) or angle <= best + 1e-6:
            return np.pi if len(run.t_events[1]) else max(angle, best)
        x, torque, best = np.array([run.y[0, -1], 0.0]), -torque, angle


@pytest.mark.parametrize(
    ("m", "L", "damping", "limit"),
    [(0.6, 0.5, 0.3, 1.8), (0.6, 0.5, 0.3, 6.0), (1.0, 1.0, 1.0, 4.3)],
)
def test_swing_up_overcomes_friction_wherever_the_full_torque_does(m, L, damping, limit):
    pendulum = sb.Pendulum(m=m, L=L, damping=damping)
    assert reach_of_full_torque(pendulum, limit) == np.pi
    swing = sb.SwingUp(pendulum, limit)
    run = sb.simulate(pendulum, [-np.pi / 2, 0.0], swing, duration=40.0, rtol=1e-5, atol=1e-8)
    assert np.abs(run.controls).max() <= limit
    assert np.abs(swing.catch.error(run.states[:, -1])).max() < 0.01


@pytest.mark.parametrize("damping", [0.1, 0.7])
def test_swing_up_is_refused_where_the_full_torque_does_not_reach_the_top(damping):
    pendulum = sb.Pendulum(m=0.8, L=0.7, damping=damping)
    # Between them: the work of a full turn against the friction of a fall, 8 b sqrt(g / L).
    balance = 4 / np.pi * damping * np.sqrt(9.8 / 0.7)
    for limit, works in ((0.9 * balance, False), (1.2 * balance, True)):
        reach = reach_of_full_torque(pendulum, limit)
        assert (reach == np.pi) == works
        if works:
            sb.SwingUp(pendulum, limit)
            continue
        with pytest.raises(ValueError, match=r"grows to (\d\.\d+) of the 3.14 rad") as caught:
            sb.SwingUp(pendulum, limit)
        told = float(re.search(r"grows to (\d\.\d+)", str(caught.value))[1])
        assert told == pytest.approx(reach, abs=2 * np.pi / 61)


@pytest.mark.parametrize("limit", [1.0, 2.5, 20.0])
def test_swing_up_stays_in_its_limit_and_at_the_top(limit):
    pendulum = sb.Pendulum(m=0.8, L=1.2)
    swing = sb.SwingUp(pendulum, limit)
    run = sb.simulate_clocked(
        pendulum, [-np.pi / 2, 0.0], swing, period=0.02, duration=40.0, rtol=1e-6
    )
    assert np.abs(run.controls).max() <= limit
    last_five_seconds = run.times >= run.times[-1] - 5.0
    assert np.abs(swing.catch.error(run.states[:, last_five_seconds])).max() < 0.01


def test_clocked_control_of_a_particle_is_the_exact_discrete_map():
    m, K, period = 1.6, np.array([[1.0, 1.5]]), 0.3
    run = sb.simulate_clocked(
        sb.Particle(m=m), [1.0, -0.5], lambda x, t: -K @ x, period=period, duration=3.0, samples=1
    )
    A = np.array([[1, period], [0, 1]]) - np.array([[period**2 / 2], [period]]) / m @ K
    expected = [np.linalg.matrix_power(A, k) @ [1.0, -0.5] for k in range(11)]
    np.testing.assert_allclose(run.states.T, expected, atol=1e-9)
    assert run.control_hold == "interval"


def test_clocked_policy_may_have_a_memory():
    calls = []
    sb.simulate_clocked(
        sb.Particle(), [0, 0], lambda x, t: (calls.append(t), [0.0])[1], period=0.5, duration=1.4
    )
    assert calls == [0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sb.bang_bang(0.0), "there already"),
        (lambda: sb.bang_bang(1.0, force=0.0), "force must be greater than 0"),
        (lambda: sb.bang_bang(1.0, m=-1.0), "m must be greater than 0"),
        (lambda: sb.PD(sb.Particle(), [0.0], kp=-1.0, kd=1.0), "do not stabilize"),
        (lambda: sb.PD(sb.Particle(), [0.0], kp=1.0, kd=0.0), "do not stabilize"),
        (lambda: sb.PD(sb.Pendulum(), [np.pi / 2], kp=9.7, kd=1.0), "do not stabilize"),
        (lambda: sb.PD(sb.Pendulum(), [0.0], kp=20, kd=2, limit=5), "at least 9.8 to hold"),
        (lambda: sb.PD(sb.Pendulum(), [0.0], kp=20, kd=2, limit=0), "limit must be greater"),
        (lambda: sb.PD(sb.CartPole(), [0.0, 0.0, 0.0], 1, 1), "target must have shape"),
        (lambda: sb.PD(sb.DubinsCar(), [0.0], 1, 1), "use LQR"),
        (lambda: sb.PID(sb.Particle(), [0.0], kp=1, ki=9, kd=1), "do not stabilize"),
        (lambda: sb.LQR(sb.DubinsCar(), [0, 0, 0]), "no gain stabilizes DubinsCar"),
        (lambda: sb.LQR(sb.Pendulum(), [0.3, 0]), "not an equilibrium"),
        (lambda: sb.LQR(sb.Pendulum(), [np.pi / 2, 0], circle=["angle"]), "got 'angle'"),
        (lambda: sb.LQR(sb.Pendulum(), [np.pi / 2, 0], Q=[[1.0]]), "Q must have shape"),
        (lambda: sb.SwingUp(sb.Pendulum(), limit=0.0), "limit must be greater than 0"),
        (lambda: sb.SwingUp(sb.Pendulum(damping=1.0), limit=2.0), "friction takes all"),
        (lambda: sb.SwingUp(sb.Pendulum(g=0.0), limit=2.0), "must have weight"),
        (lambda: sb.SwingUp(sb.Pendulum(), limit=2.0, gain=-1.0), "gain must be greater"),
        (lambda: sb.PD(sb.Pendulum(), [0.0], kp=20, kd=2, limit=9.8), "nothing to correct with"),
        (lambda: sb.PD(DIGITAL, [0.0], kp=1, kd=9.0), "outside the unit circle"),
        (lambda: sb.LQR(lambda x: -x, [0.0]), "must have inputs"),
        (lambda: sb.LQR(sb.Particle(), [0, 0], circle="p"), r"write circle=\['p'\]"),
        (lambda: sb.LQR(sb.Pendulum(), [0, 0], [9.8], limit=9.0), "at least 9.8 to hold x0"),
        (lambda: sb.LQR(sb.Particle(), [0, 0])([1.0], 0.0), r"shape \(2,\) or \(2, N\)"),
        (lambda: sb.LQR(sb.Particle(), [0, 0], reference=1.0), "tracked is required"),
        (lambda: sb.LQR(sb.Particle(), [0, 0], integral=1.0), "tracked is required"),
        (lambda: servo(reference=[1.0, 2.0]), "reference must have shape"),
        (lambda: servo(["v"], reference=1.0), "reference cannot be held"),
        (lambda: servo(["v"], integral=1.0), "no input moves its mode 0"),
        (lambda: servo(["p"], integral=-1.0), "integral must be positive semidefinite"),
        (lambda: servo(["q"], integral=1.0), r"tracked must hold labels among \('p', 'v'\)"),
        (lambda: servo(reference=lambda t: t, limit=1.0).level, "the reference moves"),
        (lambda: sb.PID(sb.Particle(), [0.0], kp=1, ki=9, kd=1), "kp = 1, ki = 9, kd = 1 do not"),
        (lambda: sb.PID(sb.Particle(), [0.0], 1, 1, 1, outputs=["q"]), "labels among"),
        (lambda: sb.PID(sb.Particle(), [0.0], 1, 1, 1, outputs="p"), "sequence of labels"),
        (lambda: sb.PID(sb.Particle(), [0.0], 0, 0, 1, outputs=["p"]), "filter_time is required"),
        (lambda: sb.PID(sb.Particle(), [0.0], 1, 1, 1, filter_time=0), "filter_time must be gre"),
        (lambda: sb.PID(sb.Particle(), [0.0], [1, 2], 1, 1), r"kp must have shape \(1, 1\)"),
        (lambda: sb.PID(sb.Particle(), [1.0], 6, 1, 5, outputs=["v"]), "target cannot be held"),
        (lambda: sb.PID(FEEDTHROUGH, [1.0], 1, 1, 0), "not depend on the inputs at once"),
        (lambda: sb.PID(LOOKING_AHEAD, [1.0], 1, 1, 0), "not depend on the inputs at once"),
        (lambda: sb.PID(tank, [4.0], 1, 1, 0, outputs=["x[0]"]), "x_guess is required"),
        (lambda: sb.PID(LAG, [1.0, 2.0], 1, 1, 0), "target must have shape"),
        (lambda: sb.PID(LAG, [1.0], 1, 1, 0, limit=0.9), "at least 1 to hold the target"),
        (lambda: sb.SwingUp(sb.Particle(), limit=2.0), "must be a Pendulum"),
    ],
)
def test_what_cannot_work_is_refused(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def test_a_moving_reference_makes_the_loop_depend_on_the_time():
    loop = sb.LQR(sb.Particle(), [0, 0], tracked=["p"], reference=np.sin, integral=1.0).loop
    with pytest.raises(ValueError, match="t is required"):
        sb.jacobians(loop, np.zeros(3), [0.0])


@pytest.mark.parametrize(
    "law",
    [
        lambda f: sb.LQR(f, [0, 0], [0]),
        lambda f: sb.PD(f, [0.0], 1.0, 1.0),
        lambda f: sb.PID(f, [0.0], 1.0, 0.1, 1.0),
        lambda f: sb.PID(f, [0.0], 1.0, 0.1, 1.0, outputs=[[1, 0]], x_guess=[0, 0]),
    ],
)
def test_a_plant_that_depends_on_the_time_is_refused_in_words_that_help(law):
    with pytest.raises(ValueError, match=r"not depend on the time, but .* t0"):
        law(lambda x, u, t: [x[1], u[0] - t * x[0]])


def test_a_turn_of_the_angle_alone_is_no_error():
    law = sb.LQR(sb.CartPole(), [0, np.pi / 2, 0, 0], R=[1.0, 1.0], circle=["theta"])
    assert law.wrapped == [1]
    x = np.array([0.2, 1.4, -0.1, 0.3])
    turn, way = 2 * np.pi * np.eye(4)[[1, 0]]
    np.testing.assert_allclose(law(x + turn, 0.0), law(x, 0.0), rtol=1e-9)
    np.testing.assert_allclose(law(x + way, 0.0), law(x, 0.0) - law.K @ way, rtol=1e-9)
