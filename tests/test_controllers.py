"""Controllers do what they promise, or refuse to be made."""

from __future__ import annotations

import control
import numpy as np
import pytest
import scipy

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
        (lambda: sb.SwingUp(sb.Pendulum(damping=1.0), limit=2.0), "friction torque"),
        (lambda: sb.SwingUp(sb.Particle(), limit=2.0), "must be a Pendulum"),
    ],
)
def test_what_cannot_work_is_refused(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()
