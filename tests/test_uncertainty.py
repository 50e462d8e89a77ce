"""Errors have the statistics they claim, are reproducible, and bad ones are refused.

Every random check is seeded. A threshold of ALARM on a p-value, or 6 standard deviations, would
reject a right program for one seed in 10^9 (5 x 10^8 for 6): below 10^-6 for the file.
"""

from __future__ import annotations

import pickle

import control
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook.uncertainty.noise import covariance_matrix, square_root

ALARM = 1e-9
Q = 0.6  # intensity [N^2 s]
M = 1.7  # mass [kg]
PUSH = [[0.0], [1 / M]]


def pushed(period, *, duration=3.0, number=4000, seed=3, noise=None):
    noise = sb.HeldNoise.white(Q, period, seed=seed) if noise is None else noise
    return sb.monte_carlo(
        sb.Particle(m=M),
        [0.0, 0.0],
        number=number,
        period=period,
        duration=duration,
        disturbance=noise,
        G=PUSH,
        method="rk4",
    )


# Noise


def test_noise_has_its_covariance_and_bias():
    covariance = np.array([[2.0, -0.9], [-0.9, 0.5]])
    noise = sb.HeldNoise(covariance, 0.1, seed=5, bias=[1.0, -3.0])
    values = noise(0.0, number=20_000)
    assert sb.consistency(values - [[1.0], [-3.0]], covariance) > ALARM
    mean_error = values.mean(axis=1) - [1.0, -3.0]
    assert sb.consistency(mean_error, covariance / 20_000) > ALARM
    assert sb.consistency(values, covariance) < ALARM  # with the bias left in
    for k, j in ((0, 0), (0, 1), (1, 1)):
        found = np.cov(values)[k, j]
        spread = np.sqrt((covariance[k, k] * covariance[j, j] + covariance[k, j] ** 2) / 20_000)
        assert abs(found - covariance[k, j]) < 6 * spread


def test_noise_is_a_function_of_seed_time_and_trajectory_alone():
    noise = sb.HeldNoise(1.0, 0.1, seed=8)
    again = sb.HeldNoise(1.0, 0.1, seed=8)
    late = again(1.23, number=7)
    np.testing.assert_array_equal(noise(0.5, number=7), again(0.5, number=7))
    np.testing.assert_array_equal(noise(1.23, number=3), late[:, :3])
    assert (noise(0.5, number=3) != sb.HeldNoise(1.0, 0.1, seed=9)(0.5, number=3)).all()
    assert (noise(0.5, number=3) != noise(0.6, number=3)).all()


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 10**6), st.floats(1e-3, 10.0))
def test_a_tick_belongs_to_the_period_that_it_begins(k, period):
    noise = sb.HeldNoise(1.0, period, seed=1)
    value = noise(k * period)
    np.testing.assert_array_equal(noise((k + 0.5) * period), value)
    assert noise((k + 1) * period) != value


def test_generators_give_seeds():
    first, second = np.random.default_rng(4), np.random.default_rng(4)
    noises = [sb.HeldNoise(1.0, 0.1, seed=first) for _ in range(2)]
    assert noises[0](0.0) != noises[1](0.0)
    assert sb.HeldNoise(1.0, 0.1, seed=second)(0.0) == noises[0](0.0)


def test_singular_covariances_are_allowed():
    noise = sb.HeldNoise([[4.0, 2.0], [2.0, 1.0]], 0.1, seed=2)
    values = noise(0.0, number=50)
    np.testing.assert_allclose(values[0], 2 * values[1], atol=1e-6)
    assert (sb.HeldNoise(np.zeros((2, 2)), 0.1, seed=2)(0.0, 5) == 0).all()


# The right scaling with the time step


def test_variance_of_a_pushed_particle_is_its_closed_form():
    run = pushed(0.1)
    t = run.times[1:]
    for k in (4, 14, 29):
        assert sb.consistency(run.states[:1, :, k + 1], Q * t[k] ** 3 / 3 / M**2) > ALARM
        assert sb.consistency(run.states[1:, :, k + 1], Q * t[k] / M**2) > ALARM
        # The check has power: half of the noise, or a mass of 1, would be seen.
        assert sb.consistency(run.states[1:, :, k + 1], Q * t[k] / M**2 / 2) < ALARM
        assert sb.consistency(run.states[1:, :, k + 1], Q * t[k]) < ALARM


@pytest.mark.parametrize("period", [0.4, 0.2, 0.1, 0.05])
def test_shorter_periods_leave_the_statistics_unchanged(period):
    end = pushed(period, duration=2.0, number=3000).states[:, :, -1]
    # A force held for K periods falls short of white noise by 1 / 4 K^2 in the position.
    covariance = sb.discretize_noise([[0, 1], [0, 0]], PUSH, Q, 2.0)
    covariance[0, 0] *= 1 - (period / 2.0) ** 2 / 4
    assert sb.consistency(end, covariance) > ALARM


def test_unscaled_noise_is_found_out():
    ends = [
        pushed(h, duration=2.0, number=3000, noise=sb.HeldNoise(Q / 0.2, h, seed=3)).states[
            1, :, -1
        ]
        for h in (0.2, 0.1)
    ]
    right = Q * 2.0 / M**2
    assert sb.consistency(ends[0][None], right) > ALARM
    assert sb.consistency(ends[1][None], right) < ALARM
    assert sb.consistency(ends[1][None], right / 2) > ALARM


def test_noise_held_over_several_ticks():
    noise = sb.HeldNoise.white(Q, 0.2, seed=3)
    coarse, fine = pushed(0.2, number=50), pushed(0.05, number=50, noise=noise)
    np.testing.assert_allclose(fine.states[:, :, ::4], coarse.states, atol=1e-9)


def test_feedback_bounds_the_variance_at_the_lyapunov_equation():
    policy = sb.PD(sb.Particle(m=M), [0.0], kp=5.0, kd=4.0)
    h, number = 0.05, 3000
    run = sb.monte_carlo(
        sb.Particle(m=M),
        [0.0, 0.0],
        policy,
        number=number,
        period=h,
        duration=8.0,
        disturbance=sb.HeldNoise.white(Q, h, seed=6),
        G=PUSH,
        method="rk4",
    )
    A = np.array([[0, 1], [0, 0]])
    Ad, Bd = sb.discretize_many(A, PUSH, h)
    loop = Ad - Bd @ [[5.0, 4.0]]
    P = scipy.linalg.solve_discrete_lyapunov(loop, Bd @ Bd.T * Q / h)
    assert sb.consistency(run.states[:, :, -1], P) > ALARM
    assert sb.consistency(pushed(h, duration=8.0, number=number).states[:, :, -1], P) < ALARM


def test_discretized_noise_is_the_integral_and_adds_up():
    rng = np.random.default_rng(2)
    A, G, half = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 2))
    intensity = half @ half.T

    def integrand(s):
        F = scipy.linalg.expm(A * s) @ G
        return F @ intensity @ F.T

    expected = scipy.integrate.quad_vec(integrand, 0, 0.7)[0]
    Qd = sb.discretize_noise(A, G, intensity, 0.7)
    np.testing.assert_allclose(Qd, expected, rtol=1e-9)
    step = scipy.linalg.expm(A * 0.7)
    np.testing.assert_allclose(
        step @ Qd @ step.T + Qd, sb.discretize_noise(A, G, intensity, 1.4), rtol=1e-9
    )


def integral_by_quadrature(A, G, Q, dt):
    """The covariance by quadrature over stretches that grow from the fastest mode's."""
    fastest = max(1e-12, np.abs(np.linalg.eigvals(A)).max())
    ends = np.array([0.0, *np.geomspace(min(dt, 0.01 / fastest), dt, 160)])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    half = np.diff(ends)[:, None] / 2
    times, weights = (ends[:-1, None] + half * (1 + nodes)).ravel(), (half * weights).ravel()
    F = scipy.linalg.expm(A * times[:, None, None]) @ G
    return np.einsum("k,kij,jl,kml->im", weights, F, Q, F)


STIFF = {
    "two modes": ([[-1, 0], [0, -50]], np.eye(2), 1.0),
    "fast": ([[-1000]], [[1]], 1.0),
    "actuator": ([[-1, 1], [0, -1e5]], [[0], [1]], 3.0),
    "servo": ([[0, 1, 0], [-100, -0.2, 1], [0, 0, -1e4]], [[0], [0], [1]], 10.0),
    "unstable beside stiff": ([[1.0, 3], [2, -500]], [[1], [1]], 5.0),
    "creeping": ([[-1e-9, 1], [0, -1e3]], [[1], [1]], 1e-3),
    "short": ([[-2, 1], [0, -3]], [[0], [1]], 1e-9),
}


@pytest.mark.parametrize("name", STIFF)
def test_noise_of_stiff_plants_is_the_integral(name):
    A, G, dt = STIFF[name]
    Q = 2.0 * np.eye(len(G[0]))
    Qd = sb.discretize_noise(A, G, Q, dt)
    expected = integral_by_quadrature(np.array(A), np.array(G), Q, dt)
    deviations = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        Qd / np.outer(deviations, deviations), expected / np.outer(deviations, deviations),
        rtol=0, atol=1e-8,  # expm by squarings, which the quadrature needs, is no better
    )  # fmt: skip
    np.testing.assert_allclose(np.diag(Qd), np.diag(expected), rtol=1e-8)


@pytest.mark.parametrize("dt", [1e-12, 1.0, 1e4, 1e300])
def test_noise_of_any_time_is_its_closed_form(dt):
    for rate in (1e-6, 1.0, 1e8):
        Qd = sb.discretize_noise([[-rate]], [[2.0]], 3.0, dt)
        assert Qd[0, 0] == pytest.approx(-np.expm1(-2 * rate * dt) / (2 * rate) * 12, rel=1e-12)
    P = scipy.linalg.solve_continuous_lyapunov([[-1.0, 5.0], [0.0, -300.0]], -np.eye(2))
    late = sb.discretize_noise([[-1.0, 5.0], [0.0, -300.0]], np.eye(2), np.eye(2), 1e6)
    np.testing.assert_allclose(late, P, rtol=1e-12)


@settings(deadline=None, max_examples=150)
@given(st.integers(1, 5), st.integers(0, 10**6), st.floats(-6, 6), st.floats(-6, 3))
def test_discretized_noise_is_a_covariance(n, seed, scale, time):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) * 10.0**scale
    A -= (np.linalg.eigvals(A).real.max() + 10.0**scale * 0.01) * np.eye(n)  # stable
    units = 10.0 ** rng.uniform(-8, 8, n)
    A = units[:, None] * A / units
    G = units[:, None] * rng.normal(size=(n, 1))
    Qd = sb.discretize_noise(A, G, 2.0, 10.0**time)
    assert (Qd == Qd.T).all()
    size = np.sqrt(np.diag(Qd))
    assert np.linalg.eigvalsh(Qd / np.outer(size, size)).min() > -1e-14 * n
    sb.HeldNoise(Qd, 1.0, seed=1)
    F = scipy.linalg.expm(A * 10.0**time)
    doubled = sb.discretize_noise(A, G, 2.0, 2 * 10.0**time)
    np.testing.assert_allclose(
        (Qd + F @ Qd @ F.T) / np.outer(size, size), doubled / np.outer(size, size), atol=1e-6
    )


def test_noise_of_what_grows_beyond_numbers_is_refused():
    with pytest.raises(ValueError, match="dt must be shorter: after 1000 s"):
        sb.discretize_noise([[1.0]], [[1.0]], 1.0, 1e3)
    assert sb.discretize_noise([[1.0]], [[1.0]], 0.0, 1.0) == 0


def test_small_variances_beside_large_ones_are_kept():
    covariance = np.diag([1e12, 1e-12])
    values = sb.HeldNoise(covariance, 0.1, seed=5)(0.0, number=20_000)
    assert sb.consistency(values[1:], 1e-12) > ALARM
    with pytest.raises(ValueError, match="positive semidefinite"):
        sb.HeldNoise(np.diag([1e12, -1e-3]), 0.1, seed=5)
    rounded = np.array([[1.0, 0.0], [0.0, -1e-17]])
    assert (sb.HeldNoise(rounded, 0.1, seed=1)(0.0, 5)[1] == 0).all()


@settings(deadline=None, max_examples=100)
@given(st.integers(1, 5), st.integers(0, 10**6))
def test_roots_of_covariances_in_any_units(n, seed):
    rng = np.random.default_rng(seed)
    units = 10.0 ** rng.uniform(-8, 8, n)
    factor = units[:, None] * rng.normal(size=(n, rng.integers(1, n + 1)))
    covariance = factor @ factor.T
    S = square_root(covariance_matrix("P", covariance))
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        S @ S.T / np.outer(size, size), covariance / np.outer(size, size), atol=1e-8
    )


# Wrappers


def test_disturbance_is_added_to_any_system():
    G = np.array([[0.0], [0.0], [1.0], [-2.0]])
    cart = sb.CartPole()
    for system in (cart, cart.to_nlsys(), sb.as_system(cart)):
        gusty = sb.with_disturbance(system, G)
        x = np.random.default_rng(1).normal(size=(4, 6))
        u, w = np.ones((2, 6)), np.linspace(-1, 1, 6)[None]
        expected = cart.dynamics(x, u) + G @ w
        np.testing.assert_allclose(gusty.dynamics(x, np.concatenate([u, w])), expected)
        one = gusty.dynamics(x[:, 2], np.array([1, 1, w[0, 2]]))
        np.testing.assert_allclose(one, expected[:, 2])
    _, B = sb.jacobians(sb.with_disturbance(cart, G), np.zeros(4))
    np.testing.assert_allclose(B[:, 2:], G, atol=1e-12)


def test_discrete_systems_take_noise_a_sample():
    plant = control.ss([[0.8]], [[0.0]], [[1.0]], [[0.0]], 0.5)
    run = sb.monte_carlo(
        plant,
        [0.0],
        number=4000,
        period=0.5,
        duration=20.0,
        disturbance=sb.HeldNoise(0.3, 0.5, seed=4),
    )
    assert sb.consistency(run.states[:, :, -1], 0.3 / (1 - 0.64)) > ALARM


def test_actuation_error_is_gain_bias_and_noise():
    push = sb.HeldNoise.white(Q, 0.1, seed=1, bias=0.5)
    run = sb.monte_carlo(
        sb.Particle(m=M),
        [0.0, 0.0],
        sb.with_actuation_error(lambda x, t: 2.0, push, gain=0.9),
        number=2000,
        period=0.1,
        duration=1.5,
    )
    mean = (0.9 * 2.0 + 0.5) / M * np.array([[1.5**2 / 2], [1.5]])
    spread = sb.discretize_noise([[0, 1], [0, 0]], PUSH, Q, 1.5)
    end = run.states[:, :, -1]
    assert sb.consistency(end - mean, spread) > ALARM
    assert sb.consistency(end.mean(axis=1) - mean[:, 0], spread / 2000) > ALARM
    faithful = 2.0 / M * np.array([[1.5**2 / 2], [1.5]])
    assert sb.consistency(end.mean(axis=1) - faithful[:, 0], spread / 2000) < ALARM


def test_plans_may_be_wrapped():
    plan = sb.bang_bang(1.0, m=M, force=2.0)
    exact = sb.HeldNoise(0.0, 1.0, seed=1)
    run = sb.monte_carlo(
        sb.Particle(m=M),
        [0.0, 0.0],
        sb.with_actuation_error(plan, exact, gain=0.8),
        number=2,
        period=plan.duration / 20,
        duration=plan.duration,
    )
    np.testing.assert_allclose(run.states[:, 1, -1], [0.8, 0.0], atol=1e-8)
    assert run.controls.shape == (1, 2, 20) and run.input_labels == ("force",)


def test_constants_are_held():
    run = sb.monte_carlo(sb.Particle(m=M), [0.0, 0.0], [3.0], number=2, period=0.5, duration=2.0)
    np.testing.assert_allclose(run.states[:, 1, -1], [6.0 / M, 6.0 / M], atol=1e-8)


def test_measurement_error_becomes_control_noise():
    K, R = np.array([[6.0, 3.0]]), np.diag([0.01, 0.04])
    h, number = 0.1, 4000
    policy = sb.with_measurement_error(lambda x, t: -K @ x, sb.HeldNoise(R, h, seed=12))
    run = sb.monte_carlo(
        sb.Particle(m=M), [0.0, 0.0], policy, number=number, period=h, duration=6.0
    )
    Ad, Bd = sb.discretize_many([[0, 1], [0, 0]], PUSH, h)
    P = scipy.linalg.solve_discrete_lyapunov(Ad - Bd @ K, Bd @ K @ R @ K.T @ Bd.T)
    assert sb.consistency(run.states[:, :, -2], P) > ALARM
    assert sb.consistency(run.controls[:, :, -1], K @ (P + R) @ K.T) > ALARM
    assert sb.consistency(run.controls[:, :, -1], K @ P @ K.T) < ALARM


def test_parameters_become_states():
    rng = np.random.default_rng(3)
    system = sb.with_parameters(sb.Pendulum(damping=0.1), ["m", "L"])
    assert system.states == ("theta", "omega", "m", "L") and system.inputs == ("torque",)
    x = np.concatenate([rng.normal(size=(2, 5)), rng.uniform(0.5, 2, (2, 5))])
    rate = system.dynamics(x, np.full((1, 5), 0.7))
    for k in range(5):
        exact = sb.Pendulum(m=x[2, k], L=x[3, k], damping=0.1).dynamics(x[:2, k], [0.7])
        np.testing.assert_allclose(rate[:, k], [*exact, 0, 0], rtol=1e-12)
    A, _ = sb.jacobians(sb.with_parameters(sb.Particle(), ["m"]), [0.3, 0.1, M], [0.9])
    np.testing.assert_allclose(A, [[0, 1, 0], [0, 0, -0.9 / M**2], [0, 0, 0]], atol=1e-12)


def test_results_are_reproducible_and_trajectories_independent_of_their_number():
    few, many = pushed(0.2, number=3), pushed(0.2, number=10)
    np.testing.assert_allclose(few.states, many.states[:, :3], atol=1e-9)
    np.testing.assert_array_equal(many.states, pushed(0.2, number=10).states)
    np.testing.assert_array_equal(few.controls, many.controls[:, :3])


def test_monte_carlo_without_errors_is_the_clocked_simulation():
    policy = sb.PD(sb.Particle(m=M), [1.0], kp=5.0, kd=4.0)
    run = sb.monte_carlo(
        sb.Particle(m=M), [0, 0], policy, number=2, period=0.1, duration=1.0, samples=3
    )
    alone = sb.simulate_clocked(
        sb.Particle(m=M), [0, 0], policy, period=0.1, duration=1.0, samples=3
    )
    np.testing.assert_allclose(run.states[:, 1], alone.states, atol=1e-9)
    assert run.state_labels == ("p", "v")


def test_disturbances_may_be_functions_of_the_state():
    # Against the motion with force 0.4: friction, which stops a mass of 1.7 at 1 m/s in 4.25 s.
    run = sb.monte_carlo(
        sb.Particle(m=M),
        [0.0, 1.0],
        number=2,
        period=0.05,
        duration=4.0,
        disturbance=lambda x, t: -0.4 * np.sign(x[1:]),
        G=PUSH,
    )
    np.testing.assert_allclose(run.states[1, :, -1], 1 - 0.4 / M * 4.0, atol=1e-8)


def test_systems_without_inputs_and_plain_functions():
    decay = sb.monte_carlo(lambda x: -x, [1.0], number=3, period=0.1, duration=1.05, samples=2)
    assert decay.controls is None and decay.states.shape == (1, 3, 23)
    np.testing.assert_allclose(decay.times, np.arange(23) * 0.05)
    np.testing.assert_allclose(decay.states[0, 1], np.exp(-decay.times), rtol=1e-7)
    pushed = sb.monte_carlo(
        lambda x: -x, [1.0], number=4000, period=0.05, duration=3.0, method="rk4",
        disturbance=sb.HeldNoise.white(Q, 0.05, seed=3),
    )  # fmt: skip
    Ad = np.exp(-0.05)
    variance = Q / 0.05 * (1 - Ad) ** 2 * (1 - Ad**120) / (1 - Ad**2)
    assert sb.consistency(pushed.states[:, :, -1] - np.exp(-3.0), variance) > ALARM
    assert pushed.input_labels == ("w[0]",)
    starts = np.array([[1.0, 2.0]])
    halved = sb.monte_carlo(control.ss(0.5, [[0.0]], 1, 0, 1.0), starts, number=2, period=1.0,
                            duration=3.0)  # fmt: skip
    np.testing.assert_allclose(halved.states[:, :, -1], starts / 8)


@pytest.mark.parametrize("pushed", [False, True])
@pytest.mark.parametrize(
    ("period", "duration", "ticks"),
    [(0.1, 0.3, 3), (0.1, 0.7, 7), (0.1, 1.0, 10), (0.1, 1.1, 11), (1 / 3, 5.0, 15), (0.5, 1.1, 3)],
)
def test_a_duration_of_whole_periods_is_not_rounded_up(period, duration, ticks, pushed):
    noise = {"disturbance": sb.HeldNoise(1.0, period, seed=1)} if pushed else {}
    run = sb.monte_carlo(
        lambda x: -x, [1.0], number=2, period=period, duration=duration, method="rk4", **noise
    )
    assert len(run.times) == 1 + ticks
    assert run.times[-1] == pytest.approx(ticks * period, rel=1e-15)


def test_a_disturbed_batch_is_evaluated_at_once():
    shapes = []

    def f(x, u):
        shapes.append(np.shape(x))
        return np.stack([x[1], u[0] - x[0]])

    gusty = sb.with_disturbance(sb.as_system(f, [0.0, 0.0], [0.0]), G=[[0.0], [2.0]])
    shapes.clear()
    x, inputs = np.arange(10.0).reshape(2, 5), np.arange(10.0).reshape(2, 5) - 3
    rates = gusty.dynamics(x, inputs)
    np.testing.assert_array_equal(rates, [x[1], inputs[0] - x[0] + 2 * inputs[1]])
    assert shapes == [(2, 5)]


@pytest.mark.parametrize(
    "policy",
    [
        lambda x, t: 1 - x[0],
        lambda x, t: 1 - x[:1],
        [1.0],
        1.0,
        sb.ControlTrajectory.piecewise_constant([0, 2], [1.0]),
    ],
)
def test_plain_functions_learn_their_inputs_from_the_policy(policy):
    run = sb.monte_carlo(
        lambda x, u: [x[1], u[0] / M], [0.0, 0.0], policy, number=3, period=0.1, duration=1.0
    )
    known = sb.monte_carlo(sb.Particle(m=M), [0.0, 0.0], policy, number=3, period=0.1, duration=1.0)
    np.testing.assert_allclose(run.states, known.states, atol=1e-9)
    two = sb.monte_carlo(
        lambda x, u: u, [0.0, 0.0], lambda x, t: [1.0, 2.0], number=3, period=0.1, duration=1.0
    )
    np.testing.assert_allclose(two.states[:, 1, -1], [1.0, 2.0])


def test_tolerances_are_passed_on():
    def error(**tolerances):
        run = sb.monte_carlo(
            sb.Oscillator(), [1.0, 0.0], number=1, period=5.0, duration=5.0, **tolerances
        )
        return abs(run.states[0, 0, -1] - np.cos(5.0))

    coarse, default, fine = error(rtol=1e-3, atol=1e-3), error(), error(rtol=1e-11, atol=1e-13)
    assert 1e-6 < coarse and 1e-10 < default < 1e-6 and fine < 1e-9
    loose = error(rtol=1e-12, atol=1e-3)
    assert loose > default


def test_wrapped_systems_and_policies_pickle():
    noise = sb.HeldNoise(np.eye(2), 0.1, seed=1)
    for policy in (
        sb.with_measurement_error(np.add, noise),
        sb.with_actuation_error(np.add, noise, gain=0.5),
    ):
        again = pickle.loads(pickle.dumps(policy))
        x = np.ones((2, 3))
        np.testing.assert_array_equal(again(x, 0.2), policy(x, 0.2))


def test_seeds_of_a_generator_are_long():
    generator = np.random.default_rng(4)
    seeds = {sb.HeldNoise(1.0, 0.1, seed=generator).seed for _ in range(100)}
    assert len(seeds) == 100 and max(seeds) > 2**100


# Consistency


def test_consistency_is_uniform_under_its_hypothesis():
    rng, P = np.random.default_rng(7), np.array([[2.0, 0.5], [0.5, 1.0]])
    root = np.linalg.cholesky(P)
    values = [sb.consistency(root @ rng.normal(size=(2, 5)), P) for _ in range(2000)]
    assert scipy.stats.kstest(values, "uniform").pvalue > ALARM


def test_consistency_sees_errors_too_large_and_too_small():
    errors = np.random.default_rng(1).normal(size=(3, 500))
    assert sb.consistency(errors, np.eye(3)) > ALARM
    assert sb.consistency(errors, 0.5 * np.eye(3)) < ALARM
    assert sb.consistency(errors, 2.0 * np.eye(3)) < ALARM


# Bad input

BAD_COVARIANCES = [
    ([[1.0, 0.5], [0.2, 1.0]], "symmetric"),
    ([[1.0, 2.0], [2.0, 1.0]], "positive semidefinite"),
    (-1.0, "positive semidefinite"),
    ([[1.0, 0.0]], "shape"),
    ([[[1.0]]], "shape"),
    ([[np.nan]], "finite"),
    ([[1j]], "real"),
    ("much", "numbers"),
]


@pytest.mark.parametrize("bad", [bad for bad, _ in BAD_COVARIANCES])
@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("covariance", lambda P: sb.HeldNoise(P, 0.1, seed=1)),
        ("intensity", lambda P: sb.HeldNoise.white(P, 0.1, seed=1)),
        ("intensity", lambda P: sb.discretize_noise(np.eye(2), np.eye(2), P, 0.1)),
        ("covariance", lambda P: sb.consistency(np.ones((len(np.atleast_1d(P)), 3)), P)),
    ],
)
def test_bad_covariances_are_refused_by_name(name, call, bad):
    with pytest.raises((TypeError, ValueError), match=f"^{name} must"):
        call(bad)


def test_bad_covariances_say_why():
    for bad, why in BAD_COVARIANCES:
        with pytest.raises((TypeError, ValueError), match=why):
            sb.HeldNoise(bad, 0.1, seed=1)


NOISE = sb.HeldNoise(1.0, 0.1, seed=1)


@pytest.mark.parametrize(
    ("error", "match", "call"),
    [
        (TypeError, "seed", lambda: sb.HeldNoise(1.0, 0.1)),
        (TypeError, "seed is required", lambda: sb.HeldNoise(1.0, 0.1, seed=None)),
        (TypeError, "seed", lambda: sb.HeldNoise.white(1.0, 0.1)),
        (TypeError, "seed must be an integer", lambda: sb.HeldNoise(1.0, 0.1, seed=1.5)),
        (ValueError, "seed must be at least 0", lambda: sb.HeldNoise(1.0, 0.1, seed=-1)),
        (ValueError, "period must be greater than 0", lambda: sb.HeldNoise(1.0, 0.0, seed=1)),
        (ValueError, "bias must", lambda: sb.HeldNoise(1.0, 0.1, seed=1, bias=[1, 2])),
        (ValueError, "t must be at least 0", lambda: NOISE(-0.1)),
        (ValueError, "number must be at least 1", lambda: NOISE(0.1, 0)),
        (ValueError, r"covariance .* shape \(2, 2\)", lambda: sb.consistency([1.0, 2.0], 1.0)),
        (ValueError, "positive definite", lambda: sb.consistency([1.0], 0.0)),
        (ValueError, "errors must", lambda: sb.consistency(1.0, 1.0)),
        (ValueError, "A must", lambda: sb.discretize_noise(np.eye(0), np.eye(0), 1.0, 1.0)),
        (ValueError, "G must", lambda: sb.with_disturbance(sb.Particle(), [[1.0]])),
        (ValueError, "G was given", lambda: pushed_with(G=PUSH)),
        (ValueError, "whole number of periods", lambda: skipping_noise()),
        (ValueError, "disturbance must have the 2", lambda: pushed_with(disturbance=NOISE)),
        (ValueError, "x0 must", lambda: pushed_with(x0=[0.0])),
        (ValueError, r"x0 must .* \(n,\) or \(n, 3\)", lambda: pushed_with(x0=np.ones((2, 2)))),
        (ValueError, "rtol must be greater than 0", lambda: pushed_with(rtol=0)),
        (ValueError, "samples must be at least 1", lambda: pushed_with(samples=0)),
        (ValueError, "period must be greater", lambda: pushed_with(period=0.0)),
        (ValueError, "method must be one of", lambda: pushed_with(method="rk5")),
        (TypeError, r"disturbance\(x, t\) must", lambda: pushed_with(disturbance="a", G=PUSH)),
        (ValueError, "policy was given", lambda: undriven(policy=[1.0])),
        (ValueError, "policy is required", lambda: undriven(lambda x, u: [np.sum(u)])),
        (ValueError, "number must", lambda: pushed_with(number=0)),
        (ValueError, r"policy\(x, t\) must", lambda: pushed_with(policy=lambda x, t: [1, 2])),
        (TypeError, "noise must be a HeldNoise", lambda: sb.with_measurement_error(abs, 0.1)),
        (ValueError, "gain must", lambda: sb.with_actuation_error(abs, NOISE, gain=[1, 2])),
        (ValueError, "size of the state", lambda: noise_for_another_state()),
        (TypeError, "library model", lambda: sb.with_parameters(lambda x: x, ["m"])),
        (ValueError, "names must be one of m", lambda: sb.with_parameters(sb.Particle(), ["mass"])),
        (TypeError, "sequence", lambda: sb.with_parameters(sb.Particle(), "m")),
        (ValueError, "m must be greater", lambda: negative_mass()),
    ],
)  # fmt: skip
def test_bad_input_is_refused_by_name(error, match, call):
    with pytest.raises(error, match=match):
        call()


def pushed_with(x0=(0.0, 0.0), policy=None, number=3, period=0.1, **options):
    return sb.monte_carlo(
        sb.Particle(), x0, policy, number=number, period=period, duration=1.0, **options
    )


def undriven(system=lambda x: -x, policy=None):
    return sb.monte_carlo(system, [1.0], policy, number=2, period=0.1, duration=1.0)


def skipping_noise():
    return pushed_with(disturbance=NOISE, G=PUSH, period=0.25)


def noise_for_another_state():
    return sb.with_measurement_error(lambda x, t: x, NOISE)(np.ones((2, 3)), 0.0)


def negative_mass():
    return sb.with_parameters(sb.Particle(), ["m"]).dynamics([0.0, 0.0, -1.0])


def test_a_single_state_does_not_tell_its_trajectory():
    misled = sb.with_measurement_error(lambda x, t: -x[:1], sb.HeldNoise(np.eye(2), 0.1, seed=1))
    with pytest.raises(ValueError, match="monte_carlo"):
        sb.simulate(sb.Particle(), np.zeros((2, 3)), misled, duration=1.0)


def test_a_disturbance_does_not_hide_that_a_system_depends_on_the_time():
    fading = sb.as_system(lambda x, u, t: [u[0] - (1 + t) * x[0]], [0.0], [0.0])
    with pytest.raises(ValueError, match="t is required"):
        sb.jacobians(sb.with_disturbance(fading), [0.0], [0.0, 0.0])
