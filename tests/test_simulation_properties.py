"""Properties of all that moves in time: simulation, sampling, controllers, noise, sweeps.

Every public name of these rooms has one here, against an oracle; the last test says which has not.
"""

from __future__ import annotations

import contextlib
import copy
import io
import math
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import statebook as sb

ROOMS = (
    "angles checking control_trajectory controllers delays events integration runge_kutta sampling"
    " simulation sweeping systems trajectory uncertainty"
).split()
PROVEN: set[str] = set()

small = settings(deadline=None, derandomize=True, max_examples=15)
few = settings(deadline=None, derandomize=True, max_examples=6)
seeds = st.integers(0, 2**32 - 1)
positive = st.floats(0.1, 10.0)


def proves(*names):
    """Note the public names that a property is about."""
    PROVEN.update(names)
    return lambda test: test


def linear(seed, n=2, m=1, unstable=0.5):
    """Return A and B of a random linear system that grows by exp(unstable t) at most."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() - unstable) * np.eye(n)
    return A, rng.normal(size=(n, m)), rng


def held(A, B, dt):
    """Return exp(A dt) and the response to an input that is held for dt."""
    n, m = B.shape
    E = scipy.linalg.expm(np.block([[A * dt, B * dt], [np.zeros((m, n + m))]]))
    return E[:n, :n], E[:n, n:]


# ---- simulate ----


@small
@given(
    seeds, st.sampled_from(["RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA"]), st.integers(1, 3)
)
@proves("simulate", "Trajectory")
def test_linear_systems_follow_the_matrix_exponential(seed, method, n):
    A, B, rng = linear(seed, n, 2)
    x0, u = rng.normal(size=n), rng.normal(size=2)
    times = np.sort(rng.uniform(0, 2, 4))
    run = sb.simulate(
        lambda x, u: A @ x + B @ u, x0, u, times=times, method=method, rtol=1e-7, atol=1e-9
    )
    # Between the samples too: its own interpolation is as exact as they are.
    for t in (*times, times[0] + 0.37 * np.ptp(times)):
        Ad, Bd = held(A, B, t - times[0])
        np.testing.assert_allclose(run(t), Ad @ x0 + Bd @ u, rtol=1e-4, atol=1e-5)


@small
@given(seeds, st.floats(-1e3, 1e3), st.sampled_from([1e-6, 1.0, 1e5]), st.floats(0.2, 0.8))
@proves("simulate")
def test_runs_continue_and_know_neither_the_hour_nor_the_units(seed, shift, unit, part):
    pendulum, x0 = sb.Pendulum(damping=0.3), np.random.default_rng(seed).normal(size=2)
    times = np.array([0.0, part, 1.0])
    whole = sb.simulate(pendulum, x0, [0.5], times=times)
    later = sb.simulate(pendulum, x0, [0.5], times=times + shift)
    np.testing.assert_allclose(later.states, whole.states, rtol=1e-7, atol=1e-7)
    rest = sb.simulate(pendulum, whole(part), [0.5], times=times[1:])
    np.testing.assert_allclose(rest.states[:, -1], whole.states[:, -1], rtol=1e-6, atol=1e-7)
    other = sb.simulate(
        lambda x, u: unit * pendulum.dynamics(x / unit, u),
        unit * x0,
        [0.5],
        times=times,
        atol=1e-10 * unit,
    )
    np.testing.assert_allclose(other.states / unit, whole.states, rtol=1e-12, atol=1e-12)


@small
@given(seeds, st.integers(1, 4))
@proves("simulate")
def test_a_batch_is_its_columns(seed, N):
    rng = np.random.default_rng(seed)
    x0, gain = rng.normal(size=(2, N)), rng.normal(size=(1, 2))
    together = sb.simulate(sb.Pendulum(), x0, lambda x, t: gain @ x, duration=0.5)
    for i, start in enumerate(x0.T):
        alone = sb.simulate(sb.Pendulum(), start, lambda x, t: gain @ x, duration=0.5)
        np.testing.assert_allclose(together.states[:, i], alone.states, rtol=1e-6, atol=1e-7)


@small
@given(seeds, st.sampled_from([0.03, 0.1, 1 / 3, True]), st.integers(1, 30))
@proves("simulate", "discretize")
def test_discrete_time_is_a_power_of_the_map(seed, dt, count):
    A, B, rng = linear(seed, 2, 1, 0.0)
    x0, step = rng.normal(size=2), float(dt)
    Ad, Bd = held(A, B, step)
    sys = control.ss(Ad, Bd, np.eye(2), 0, dt)
    run = sb.simulate(sys, x0, duration=count * step)
    assert len(run.times) == count + 1
    expected = np.linalg.matrix_power(Ad, count) @ x0
    np.testing.assert_allclose(run.states[:, -1], expected, rtol=1e-9, atol=1e-12)
    if dt is not True:
        found = sb.discretize(control.ss(A, B, np.eye(2), 0), dt)
        np.testing.assert_allclose(np.hstack([found.A, found.B]), np.hstack([Ad, Bd]), rtol=1e-9)


@small
@given(st.floats(0.5, 3.0), st.floats(-0.9, 0.9), st.sampled_from([-1, 0, 1]))
@proves("Event", "simulate")
def test_events_are_where_the_motion_passes(omega, level, direction):
    def passing(x, t):
        return x[0] - level

    passing.direction = direction
    run = sb.simulate(
        sb.Oscillator(stiffness=omega**2), [1.0, 0.0], duration=2 * np.pi / omega, events=passing
    )
    falls = math.acos(level) / omega
    known = {-1: [falls], 0: [falls, 2 * np.pi / omega - falls], 1: [2 * np.pi / omega - falls]}
    assert [event.time for event in run.events] == pytest.approx(known[direction], abs=1e-6)
    assert {event.label for event in run.events} == {"passing"}
    assert all(abs(event.state[0] - level) < 1e-7 for event in run.events)


@small
@given(st.floats(0.5, 20.0))
@proves("simulate", "DivergenceError")
def test_a_finite_escape_is_an_error_with_the_way_there(x0):
    with pytest.raises(sb.DivergenceError) as caught:
        sb.simulate(lambda x: x**2, [x0], duration=4 / x0)
    for error in (caught.value, pickle.loads(pickle.dumps(caught.value))):
        assert error.time == pytest.approx(1 / x0, rel=1e-6)
        run = error.trajectory
        before = run.times < 0.9 / x0
        exact = x0 / (1 - x0 * run.times[before])
        np.testing.assert_allclose(run.states[0, before], exact, rtol=1e-5)


# ---- controls and trajectories ----


@small
@given(seeds, st.integers(2, 6), st.sampled_from(["piecewise_constant", "piecewise_linear"]))
@proves("ControlTrajectory", "Trajectory", "simulate")
def test_an_integrator_integrates_its_control_and_a_replay_repeats_it(seed, count, form):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.05, 1.0, count))
    values = rng.normal(size=(2, count - (form == "piecewise_constant")))
    u = getattr(sb.ControlTrajectory, form)(times, values)
    run = sb.simulate(lambda x, u: 1.0 * u, [1.0, -1.0], u)
    weights = np.diff(times)
    mean = values if form == "piecewise_constant" else (values[:, 1:] + values[:, :-1]) / 2
    np.testing.assert_allclose(run.states[:, -1], [1, -1] + mean @ weights, rtol=1e-12, atol=1e-12)
    x0, again = run.to_control_space()
    replayed = sb.simulate(lambda x, u: 1.0 * u, x0, again, times=run.times)
    np.testing.assert_allclose(replayed.states, run.states, rtol=0, atol=1e-12)
    inside = rng.uniform(times[0], times[-1], 20)
    np.testing.assert_array_equal(run.control_at(inside), u(inside))


@pytest.mark.parametrize(("form", "order"), [("held", 1), ("linear", 2), ("spline", 4)])
@proves("ControlTrajectory")
def test_orders_of_sampled_controls(form, order):
    errors = []
    for count in (16, 32, 64):
        times = np.linspace(0, 2, count + 1)
        u = {
            "held": lambda t: sb.ControlTrajectory.piecewise_constant(t, np.exp(np.sin(t[:-1]))),
            "linear": lambda t: sb.ControlTrajectory.piecewise_linear(t, np.exp(np.sin(t))),
            "spline": lambda t: sb.ControlTrajectory.spline(t, np.exp(np.sin(t))),
        }[form](times)
        fine = np.linspace(0, 2, 1001)
        errors.append(np.abs(u(fine)[0] - np.exp(np.sin(fine))).max())
    slope = np.polyfit(np.log([16, 32, 64]), np.log(errors), 1)[0]
    assert -slope == pytest.approx(order, abs=0.3)


@small
@given(hnp.arrays(float, (2, 5), elements=st.floats(-1e3, 1e3)), st.floats(0, 4))
@proves("Trajectory")
def test_trajectories_survive_what_is_done_to_them(states, t):
    run = sb.Trajectory(np.arange(5), states, states[:1, :4], circle=(1,))
    for again in (run.resample(run.times), copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        np.testing.assert_array_equal(again.states, run.states)
        np.testing.assert_array_equal(again(t), run(t))
        np.testing.assert_array_equal(again.control_at(t), run.control_at(t))
    assert run.control_at(t) == states[0, min(int(t), 3)]
    back = sb.Trajectory.from_response(run.to_response())
    np.testing.assert_array_equal(back.states, run.states)


@small
@given(st.floats(-100, 100).filter(lambda d: abs(d) > 1e-3), positive, positive)
@proves("bang_bang")
def test_the_fastest_move_arrives_at_rest(distance, m, force):
    run = sb.simulate(sb.Particle(m=m), [0.0, 0.0], sb.bang_bang(distance, m=m, force=force))
    np.testing.assert_allclose(run.states[:, -1], [distance, 0], atol=1e-9 * abs(distance) + 1e-12)


@small
@given(hnp.arrays(float, hnp.array_shapes(max_dims=2, max_side=4), elements=st.floats(-1e9, 1e9)))
@proves("wrap_angle")
def test_wrapped_angles(angles):
    wrapped = sb.wrap_angle(angles)
    assert np.all((-np.pi <= wrapped) & (wrapped < np.pi))
    np.testing.assert_array_equal(sb.wrap_angle(wrapped), wrapped)
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-15)


# ---- clocks and sampling ----


@small
@given(seeds, st.floats(0.05, 0.3), st.integers(0, 2))
@proves("simulate_clocked")
def test_a_clocked_loop_is_the_map_of_held_inputs(seed, period, late):
    A, B, rng = linear(seed)
    gain, x0 = rng.normal(size=(1, 2)), rng.normal(size=2)
    run = sb.simulate_clocked(
        control.ss(A, B, np.eye(2), 0),
        x0,
        lambda x, t: gain @ x,
        period=period,
        duration=6 * period,
        samples=2,
        delay=late * period,
        rtol=1e-10,
        atol=1e-12,
    )
    Ad, Bd = held(A, B, period)
    states = [x0]
    for k in range(6):
        u = gain @ states[k - late] if k >= late else np.zeros(1)
        states.append(Ad @ states[k] + Bd @ u)
        assert run.controls[:, 2 * k] == pytest.approx(u, rel=1e-7, abs=1e-9)
    np.testing.assert_allclose(run.states[:, ::2].T, states, rtol=1e-7, atol=1e-8)


@small
@given(seeds, st.sampled_from(["zoh", "foh", "euler", "backward_euler", "tustin"]), positive)
@proves("discretize", "discretize_many", "map_eigenvalues")
def test_one_discretization_of_one_or_many_and_its_eigenvalues(seed, method, scale):
    A, B, _ = linear(seed, 3, 2, -0.1)
    dt = 0.1 * scale
    Ad, Bd = sb.discretize_many(np.stack([A, 2 * A]), np.stack([B, B]), dt, method)
    sys = sb.discretize(control.ss(A, B, np.eye(3), 0), dt, method)
    np.testing.assert_allclose(np.hstack([sys.A, sys.B]), np.hstack([Ad[0], Bd[0]]), atol=1e-9)
    # The same plant twice as fast, sampled twice as often.
    np.testing.assert_allclose(
        sb.discretize_many(2 * A, B, dt / 2, method)[0], Ad[0], rtol=1e-9, atol=1e-12
    )
    expected = sb.map_eigenvalues(np.linalg.eigvals(A), dt, method)
    for z in np.linalg.eigvals(Ad[0]):
        assert np.abs(expected - z).min() < 1e-6


@small
@given(seeds, st.sampled_from([*sb.METHODS]), st.floats(0.01, 0.3), st.integers(1, 9))
@proves("integrate", "integrate_euler", "METHODS", "ButcherTableau")
@proves("amplification_matrix", "stability_function")
def test_fixed_steps_of_linear_systems_are_powers_of_one_matrix(seed, method, dt, N):
    A, _, rng = linear(seed, 3, 1, 0.0)
    x0 = rng.normal(size=3)
    M = sb.amplification_matrix(A, dt, method)
    expected = np.linalg.matrix_power(M, N) @ x0
    _, xs = sb.integrate(lambda x, t: A @ x, x0, N, dt, method=method)
    np.testing.assert_allclose(xs[-1], expected, rtol=1e-9, atol=1e-10)
    if method == "euler":
        np.testing.assert_array_equal(sb.integrate_euler(lambda x, t: A @ x, x0, N, dt)[1], xs)
    growth = sb.stability_function(method, dt * np.linalg.eigvals(A))
    for z in np.linalg.eigvals(M):
        assert np.abs(growth - z).min() < 1e-7
    tableau = sb.METHODS[method]
    assert sum(tableau.b) == 1  # consistent, and of its order on exp
    assert abs(tableau.stability_function(1e-2) - np.exp(1e-2)) < 2 * 1e-2 ** (tableau.order + 1)
    again = replace(tableau, name="again")
    assert isinstance(again, sb.ButcherTableau) and again.stages == tableau.stages


# ---- systems ----


@small
@given(seeds, st.integers(1, 3), st.integers(1, 2))
@proves("System", "as_system")
def test_one_system_in_many_forms(seed, n, m):
    A, B, rng = linear(seed, n, m)
    x, u = rng.normal(size=(n, 3)), rng.normal(size=(m, 3))
    ss = control.ss(A, B, np.eye(n), 0)
    forms = [
        sb.as_system(ss),
        sb.as_system(lambda x, u: A @ x + B @ u, x, u),
        sb.as_system(lambda x, u, t: list(A @ x + B @ u), x[:, 0], u[:, 0]),
        sb.as_system(
            control.nlsys(lambda t, x, u, p: A @ x + B @ u, None, inputs=m, outputs=n, states=n)
        ),
        copy.deepcopy(sb.as_system(ss)),
        pickle.loads(pickle.dumps(sb.as_system(ss))),
        sb.as_system(sb.with_disturbance(ss, np.zeros((n, 0)))),
    ]
    for system in forms:
        assert isinstance(system, sb.System) and (system.n, system.m) == (n, m)
        np.testing.assert_allclose(system.dynamics(x, u), A @ x + B @ u, rtol=1e-12, atol=1e-12)


# ---- delays ----


@few
@given(st.floats(0.1, 20.0), st.floats(-0.9, 0.9))
@proves("delay_margin", "DelayMargin")
def test_delay_margins_in_closed_form(k, a):
    # x' = a k x - k x(t - delay): omega = k sqrt(1 - a^2), cos(omega delay) = a.
    margin = sb.delay_margin(lambda x, u: a * k * x + u, lambda x, t: -k * x, [0.0], confirm=False)
    omega = k * math.sqrt(1 - a**2)
    assert isinstance(margin, sb.DelayMargin)
    assert margin.omega == pytest.approx(omega, rel=1e-6)
    assert margin.delay == pytest.approx(math.acos(a) / omega, rel=1e-6)


@small
@given(seeds, st.floats(0.01, 1.0), st.integers(1, 8))
@proves("with_input_delay")
def test_pade_turns_and_does_not_stretch(seed, delay, order):
    A, B, _ = linear(seed, 2, 1, -0.5)
    plant = control.ss(A, B, [[1.0, 0.5]], 0)
    late = sb.with_input_delay(plant, delay, order=order)
    for omega in (0.0, 0.3 / delay):
        turned = late(1j * omega) / plant(1j * omega)
        assert abs(turned) == pytest.approx(1, abs=1e-6)
        # The first term that Pade leaves out.
        rest = math.factorial(order) ** 2 / math.factorial(2 * order)
        rest *= (omega * delay) ** (2 * order + 1) / math.factorial(2 * order + 1)
        assert abs(turned - np.exp(-1j * omega * delay)) < 3 * rest + 1e-7


# ---- controllers ----


@few
@given(seeds, st.sampled_from([None, 0.1]), st.floats(0.01, 100), st.sampled_from([1e-3, 1e3]))
@proves("LQR")
def test_the_regulator_solves_riccatis_equation_in_any_units(seed, dt, weight, unit):
    A, B, rng = linear(seed, 2, 1, 0.3)
    if dt:
        A, B = held(A, B, dt)
    C = rng.normal(size=(2, 2))
    Q, R = C @ C.T, np.array([[weight]])
    lqr = sb.LQR(control.ss(A, B, np.eye(2), 0, dt or 0), [0, 0], Q=Q, R=R)
    K, S = lqr.K, lqr.S
    if dt:
        residual = A.T @ S @ A - S - A.T @ S @ B @ K + Q
        assert np.abs(np.linalg.eigvals(A - B @ K)).max() < 1
    else:
        residual = A.T @ S + S @ A - K.T @ R @ K + Q
        assert np.linalg.eigvals(A - B @ K).real.max() < 0
    assert np.abs(residual).max() < 1e-8 * np.abs(S).max()
    scaled = sb.LQR(control.ss(A, B, np.eye(2), 0, dt or 0), [0, 0], Q=7 * Q, R=7 * R)
    np.testing.assert_allclose(scaled.K, K, rtol=1e-7, atol=1e-9)
    T = np.diag([unit, 1.0])  # another unit of the first state
    inverse = np.diag([1 / unit, 1.0])
    other = control.ss(T @ A @ inverse, T @ B, np.eye(2), 0, dt or 0)
    moved = sb.LQR(other, [0, 0], Q=inverse @ Q @ inverse, R=R)
    np.testing.assert_allclose(moved.K @ T, K, rtol=1e-5, atol=1e-7)
    x = rng.normal(size=2)
    assert float(sb.LQR(other, [0, 0], limit=0.1)(x, 0.0)[0]) <= 0.1


@few
@given(positive, positive, positive, st.floats(-100, 100), st.floats(-5, 5))
@proves("PD", "PID")
def test_pd_and_pid_hold_their_target_against_what_disturbs(m, kp, kd, target, push):
    plant, ki = sb.Particle(m=m), 0.5 * kp * kd / m
    pd = sb.PD(plant, [target], kp, kd)
    s = np.roots([m, kd, kp])
    for x in ([target, 0.0], [target + 1, 0.0], [target, 1.0]):
        expected = -kp * (x[0] - target) - kd * x[1]
        assert pd(x, 0.0)[0] == pytest.approx(expected, rel=1e-9, abs=1e-9 * kp * abs(target))
    assert s.real.max() < 0
    pid = sb.PID(plant, [target], kp, ki, kd)
    rest = [target, 0.0, push / ki]  # the integral carries the disturbance
    for loop in (
        pid.loop,
        pickle.loads(pickle.dumps(pid)).loop,
        pickle.loads(pickle.dumps(pid.loop)),
    ):
        np.testing.assert_allclose(loop.dynamics(rest, [push]), 0, atol=1e-9 * (1 + abs(target)))


@few
@given(st.floats(0.3, 20.0), st.floats(1e-3, 100.0), seeds)
@proves("SwingUp")
def test_a_swing_pumps_within_its_limit(limit, gain, seed):
    swing = sb.SwingUp(sb.Pendulum(), limit, gain)
    x = np.random.default_rng(seed).normal(scale=3.0, size=(2, 50))
    u = swing(x, 0.0)
    assert np.abs(u).max() <= limit
    np.testing.assert_allclose(u, np.stack([swing(c, 0.0) for c in x.T], axis=1), atol=1e-12)
    free = swing.catch.cost_to_go(x) >= swing.catch.level
    below = free & (swing.pendulum.energy(x) < 9.8)
    assert np.all(u[0, below] * x[1, below] >= 0)
    assert np.all(u[0, free & ~below] * x[1, free & ~below] <= 0)
    assert swing([-np.pi / 2, 0.0], 0.0)[0] == limit


def plan(t):
    omega = 2 * np.pi / 1.52
    return omega**2 / 2 * np.cos(omega * t) if t < 1.5 * 1.52 else 0.0


CAUGHT = sb.CartPoleSwingUp(sb.CartPole(), plan, 2.0, limit=40.0, track=(-0.5, 2.5))


@small
@given(seeds, st.floats(0, 4), st.floats(-20, 20))
@proves("CartPoleSwingUp", "cart_force")
def test_the_cart_gets_its_acceleration_within_the_limit(seed, t, acceleration):
    x = np.random.default_rng(seed).normal(size=(4, 5))
    force = sb.cart_force(CAUGHT.cartpole, x, acceleration)
    moved = CAUGHT.cartpole.dynamics(x, np.stack([force, 0 * force]))
    np.testing.assert_allclose(moved[2], acceleration, rtol=1e-9, atol=1e-9)
    u = CAUGHT(x, t)
    assert np.abs(u[0]).max() <= 40 and not u[1].any()
    np.testing.assert_allclose(u, np.stack([CAUGHT(c, t) for c in x.T], axis=1), atol=1e-9)


# ---- noise ----


@small
@given(seeds, st.integers(1, 3), st.floats(-4, 4), st.floats(-3, 2))
@proves("discretize_noise")
def test_discretized_noise_satisfies_lyapunovs_equation_and_adds_up(seed, n, stiff, time):
    A, G, rng = linear(seed, n, 2, -0.1)
    A, dt = A * 10.0**stiff, 10.0 ** (time - stiff)
    root = rng.normal(size=(2, 1))  # a singular intensity
    Q = root @ root.T
    Qd = sb.discretize_noise(A, G, Q, dt)
    np.testing.assert_array_equal(Qd, Qd.T)
    size = np.abs(Qd).max()
    assert np.linalg.eigvalsh(Qd).min() > -1e-12 * size
    F, M = scipy.linalg.expm(A * dt), G @ Q @ G.T
    residual = A @ Qd + Qd @ A.T + M - F @ M @ F.T
    assert np.abs(residual).max() < 1e-10 * (np.abs(A).max() * size + np.abs(M).max())
    half, Fh = sb.discretize_noise(A, G, Q, dt / 2), scipy.linalg.expm(A * dt / 2)
    np.testing.assert_allclose(half + Fh @ half @ Fh.T, Qd, rtol=1e-8, atol=1e-10 * size)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    if time < 0:  # short enough for a rule of 20 points
        at = [scipy.linalg.expm(A * dt * (1 + z) / 2) @ G @ root for z in nodes]
        integral = sum(w * dt / 2 * g @ g.T for g, w in zip(at, weights, strict=True))
        np.testing.assert_allclose(Qd, integral, rtol=1e-8, atol=1e-10 * size)


@small
@given(seeds, st.integers(0, 10**6), st.floats(0.01, 100.0))
@proves("HeldNoise")
def test_noise_scales_shifts_and_begins_alike(seed, tick, size):
    noise = sb.HeldNoise([[2.0, 1.0], [1.0, 3.0]], 0.1, seed=seed)
    wide = sb.HeldNoise(size**2 * noise.covariance, 0.1, seed=seed, bias=[1.0, -1.0])
    t = tick * 0.1
    values = noise(t, 5)
    np.testing.assert_array_equal(noise(t + 0.05, 3), values[:, :3])
    np.testing.assert_allclose(wide(t, 5), size * values + [[1.0], [-1.0]], rtol=1e-9, atol=1e-9)
    white = sb.HeldNoise.white(noise.covariance, 0.1, seed=seed)
    np.testing.assert_allclose(white(t, 5), values / math.sqrt(0.1), rtol=1e-9)


@few
@given(seeds, st.integers(1, 4), st.floats(0.5, 1.5))
@proves("monte_carlo", "with_disturbance", "with_actuation_error", "with_measurement_error")
def test_many_trajectories_are_the_maps_of_their_own_noise(seed, number, gain):
    A, B, rng = linear(seed, 2, 1, 0.0)
    K, x0 = rng.normal(size=(1, 2)), rng.normal(size=2)
    push, seen, done = (
        sb.HeldNoise(C, 0.1, seed=seed + i) for i, C in enumerate([np.eye(2), np.eye(2), 1.0])
    )
    policy = sb.with_actuation_error(
        sb.with_measurement_error(lambda x, t: -K @ x, seen), done, gain=gain
    )
    plant = control.ss(A, B, np.eye(2), 0)
    run = sb.monte_carlo(
        plant, x0, policy, number=number, period=0.1, duration=0.4, disturbance=push,
        rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    Ad, Bd = held(A, np.hstack([B, np.eye(2)]), 0.1)
    x = np.repeat(x0[:, None], number, axis=1)
    for k in range(4):
        t = 0.1 * k
        u = -gain * K @ (x + seen(t, number)) + done(t, number)
        x = Ad @ x + Bd @ np.concatenate([u, push(t, number)])
    np.testing.assert_allclose(run.states[:, :, -1], x, rtol=1e-6, atol=1e-8)


@few
@given(seeds, st.integers(2, 6), st.integers(1, 3))
@proves("monte_carlo", "Moments")
def test_moments_in_blocks_are_those_of_all_trajectories(seed, number, chunk):
    A, _, rng = linear(seed, 2, 1, 0.0)
    x0 = rng.normal(size=(2, number))
    push = sb.HeldNoise(np.eye(2), 0.1, seed=seed)
    options = {"number": number, "period": 0.1, "duration": 0.2, "disturbance": push}
    whole = sb.monte_carlo(control.ss(A, np.zeros((2, 1)), np.eye(2), 0), x0, **options)
    moments = sb.monte_carlo(
        control.ss(A, np.zeros((2, 1)), np.eye(2), 0),
        x0, **options, reduce="moments", chunk=chunk, progress=False,
    )  # fmt: skip
    assert isinstance(moments, sb.Moments) and moments.number == number
    np.testing.assert_allclose(moments.mean, whole.states.mean(axis=1), rtol=1e-6, atol=1e-7)
    for k in range(3):
        expected = np.cov(whole.states[:, :, k])
        np.testing.assert_allclose(moments.covariance[..., k], expected, rtol=1e-5, atol=1e-7)


@small
@given(seeds, st.integers(1, 3))
@proves("consistency")
def test_consistency_does_not_depend_on_the_coordinates(seed, n):
    rng = np.random.default_rng(seed)
    T, errors = rng.normal(size=(n, n)) + 3 * np.eye(n), rng.normal(size=(n, 20))
    p = sb.consistency(errors, np.eye(n))
    assert 0 <= p <= 1
    assert sb.consistency(T @ errors, T @ T.T) == pytest.approx(p, rel=1e-6, abs=1e-12)
    total = (errors**2).sum()
    tails = scipy.stats.chi2.cdf(total, 20 * n), scipy.stats.chi2.sf(total, 20 * n)
    assert p == pytest.approx(2 * min(tails), rel=1e-9)


@small
@given(seeds, positive, positive)
@proves("with_parameters")
def test_parameters_as_states_are_those_of_the_model(seed, L, damping):
    x = np.random.default_rng(seed).normal(size=2)
    wide = sb.with_parameters(sb.Pendulum(), ["L", "damping"])
    expected = sb.Pendulum(L=L, damping=damping).dynamics(x, [0.5])
    found = wide.dynamics([*x, L, damping], [0.5])
    np.testing.assert_allclose(found, [*expected, 0, 0], rtol=1e-12, atol=1e-12)


# ---- sweeps and checks ----


@small
@given(st.integers(1, 7), st.integers(1, 5), st.integers(1, 9), st.integers(1, 3))
@proves("sweep")
def test_a_sweep_is_a_loop_wherever_and_in_whatever_portions_it_runs(a, b, chunk, workers):
    grid = {"a": range(a), "b": np.linspace(0, 1, b)}
    expected = [[[i, i + x] for x in grid["b"]] for i in grid["a"]]
    with ThreadPoolExecutor(workers) as pool:
        options = {"executor": pool, "progress": False, "chunk": chunk}
        found = sb.sweep(lambda a, b: [a, a + b], grid, **options)
        total = sb.sweep(lambda a, b: a + b, grid, **options, reduce=(lambda s, r: s + r, 0.0))
    np.testing.assert_array_equal(found, expected)
    assert total == pytest.approx(sum(i + x for i in grid["a"] for x in grid["b"]))


@small
@given(st.floats(-1e6, 1e6), st.floats(-1e-3, 1e-3), st.sampled_from(["==", "<", ">", "differs"]))
@proves("check", "summary")
def test_a_check_holds_exactly_where_its_relation_does(value, shift, relation):
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        with contextlib.suppress(AssertionError):
            sb.summary()
        sb.check("claim", value + shift, value, relation=relation, rtol=1e-9, atol=1e-4)
        close = abs(value + shift - value) <= 1e-4 + 1e-9 * abs(value)
        holds = {
            "==": close,
            "differs": not close,
            "<": value + shift < value,
            ">": value + shift > value,
        }[relation]
        if holds:
            sb.summary()
        else:
            with pytest.raises(AssertionError, match="1 of 1 checks failed"):
                sb.summary()
    assert ("FAILED" not in said.getvalue()) == holds


# ---- whatever a caller sends ----

DOCUMENTED = (TypeError, ValueError, RuntimeError)  # DivergenceError is a RuntimeError
anything = st.one_of(
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.complex128, np.bool_]),
        hnp.array_shapes(min_dims=0, max_dims=3, max_side=3),
    ),
    st.floats(-3, 3),
    st.sampled_from([None, "", "a", np.nan, np.inf, -1, 0, True, [], {}, [[1], [1, 2]], object()]),
)
PLANT = control.ss([[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], np.eye(2), 0)
FUNCTIONS = {
    "simulate x0": lambda a: sb.simulate(sb.Particle(), a, duration=0.1),
    "simulate u": lambda a: sb.simulate(sb.Particle(), [1.0, 0.0], a, duration=0.1),
    "simulate times": lambda a: sb.simulate(sb.Particle(), [1.0, 0.0], times=a),
    "simulate atol": lambda a: sb.simulate(sb.Particle(), [1.0, 0.0], duration=0.1, atol=a),
    "simulate switches": lambda a: sb.simulate(sb.Particle(), [1.0, 0.0], duration=1, switches=a),
    "simulate events": lambda a: sb.simulate(
        sb.Particle(), [1.0, 0.0], duration=0.1, events=lambda x, t: a
    ),
    "simulate policy": lambda a: sb.simulate(
        sb.Particle(), [1.0, 0.0], lambda x, t: a, duration=0.1
    ),
    "simulate dynamics": lambda a: sb.simulate(lambda x: a, [1.0, 0.0], duration=0.1),
    "simulate_clocked": lambda a: sb.simulate_clocked(
        sb.Particle(), [1.0, 0.0], lambda x, t: a, period=0.1, duration=0.2
    ),
    "Trajectory": lambda a: sb.Trajectory(np.arange(2), a),
    "ControlTrajectory": lambda a: sb.ControlTrajectory.piecewise_linear([0, 1], a),
    "discretize_noise": lambda a: sb.discretize_noise(-np.eye(2), np.eye(2), a, 0.1),
    "HeldNoise": lambda a: sb.HeldNoise(a, 0.1, seed=1)(0.0),
    "consistency": lambda a: sb.consistency([1.0, 2.0], a),
    "monte_carlo": lambda a: sb.monte_carlo(
        sb.Particle(), [1.0, 0.0], a, number=2, period=0.1, duration=0.1
    ),
    "LQR": lambda a: sb.LQR(PLANT, [0, 0], Q=a),
    "PID": lambda a: sb.PID(PLANT, [1.0], a, 0.5, 0.0, outputs=["y[0]"]),
    "wrap_angle": sb.wrap_angle,
    "with_input_delay": lambda a: sb.with_input_delay(PLANT, a),
    "map_eigenvalues": lambda a: sb.map_eigenvalues(a, 0.1),
    "sweep": lambda a: sb.sweep(lambda a: a, {"a": a}, executor=POOL, progress=False),
}
POOL = ThreadPoolExecutor(1)


@settings(deadline=None, derandomize=True, max_examples=150)
@given(st.sampled_from([*FUNCTIONS]), anything)
def test_anything_works_or_raises_what_is_documented(name, argument):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            result = FUNCTIONS[name](argument)
        except DOCUMENTED as error:
            assert str(error) and "math domain" not in str(error).split(":")[0]
            return
    if isinstance(result, sb.Trajectory):
        assert np.isfinite(result.states).all()
    elif isinstance(result, np.ndarray) and name not in ("sweep", "map_eigenvalues"):
        assert np.isfinite(result).all()


def test_every_public_name_of_these_rooms_has_a_property():
    stub = Path(sb.__file__).with_name("__init__.pyi").read_text(encoding="utf-8")
    lines = [line.split() for line in stub.splitlines() if line.startswith("from .")]
    public = {line[3] for line in lines if line[1].split(".")[1] in ROOMS}
    assert len(public) > 35
    assert public - PROVEN == set()
