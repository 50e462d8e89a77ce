"""Linear analysis from end to end: closed forms against simulation, f(x, u) to a verdict."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pytest
import scipy

import statebook as sb

RANDOM = [(seed, singular) for seed in range(3) for singular in (False, True)]


def random_pair(seed, singular, n=3):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, 1))
    if singular:
        A[-1] = A[0] + A[1]
    return A, B, rng.normal(size=n)


def linear(A, B):
    return lambda x, u: A @ x + B @ u


# Closed forms as oracles


@pytest.mark.parametrize(("seed", "singular"), RANDOM)
def test_simulation_is_free_motion_plus_convolution(seed, singular):
    A, B, x0 = random_pair(seed, singular)
    times = np.linspace(0, 3, 7)
    run = sb.simulate(linear(A, B), x0, lambda x, t: [np.sin(2 * t**2)], times=times)
    for t, x in zip(times, run.states.T, strict=True):
        forced, _ = scipy.integrate.quad_vec(
            lambda s, t=t: scipy.linalg.expm((t - s) * A) @ B[:, 0] * np.sin(2 * s**2), 0, t
        )
        exact = scipy.linalg.expm(t * A) @ x0 + forced
        np.testing.assert_allclose(x, exact, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("seed", "singular"), RANDOM)
def test_zoh_system_follows_the_plant_under_held_inputs(seed, singular):
    A, B, x0 = random_pair(seed, singular)
    values = np.random.default_rng(9).normal(size=8)
    Ad, Bd = sb.discretize_many(A, B, 0.25)
    x = x0
    for u in values:
        x = Ad @ x + Bd[:, 0] * u
    held = sb.ControlTrajectory.piecewise_constant(0.25 * np.arange(9), values)
    moved = sb.simulate(linear(A, B), x0, held).states[:, -1]
    np.testing.assert_allclose(x, moved, rtol=1e-6, atol=1e-6)


# How far linearization holds

MODELS = [
    (sb.Pendulum(m=1.3, L=0.6, damping=0.2), [0.7, 0.0], [5.0]),
    (sb.CartPole(m_cart=1.9, m_pole=0.35, L=0.8), [0.1, 0.8, -0.3, 0.4], [0.5, 0.2]),
    (sb.DubinsCar(L=2.4), [1.0, -2.0, 0.6], [3.0, 0.35]),
    (sb.PlanarArm(lengths=(0.9, 0.55), masses=(2.1, 0.8)), [0.5, -1.0, 0.3, 0.2], [3.0, 1.0]),
]


@pytest.mark.parametrize(("model", "x0", "u0"), MODELS, ids=lambda m: type(m).__name__)
def test_taylor_remainder_is_of_second_order(model, x0, u0):
    x0, u0 = np.array(x0), np.array(u0)
    A, B = sb.jacobians(model, x0, u0)
    rng = np.random.default_rng(4)
    dx, du = rng.normal(size=x0.size), rng.normal(size=u0.size)
    sizes = 10.0 ** np.array([-4, -3, -2])
    remainders = [
        model.dynamics(x0 + d * dx, u0 + d * du) - model.dynamics(x0, u0) - d * (A @ dx + B @ du)
        for d in sizes
    ]
    slopes = np.diff(np.log10(np.linalg.norm(remainders, axis=1)))
    assert slopes == pytest.approx([2, 2], abs=0.05)


@pytest.mark.parametrize(("target", "order"), [(-np.pi / 2, 3), (-1.0, 2)])
def test_linear_simulation_errs_by_the_order_of_the_remainder(target, order):
    model, u0 = sb.Pendulum(damping=0.2), [9.8 * np.cos(target)]
    A = np.asarray(sb.linearize(model, [target, 0.0], u0).A)
    times, sizes = np.linspace(0, 2, 21), np.array([0.005, 0.01])
    starts = np.array([[target], [0.0]]) + np.array([[1.0], [0.0]]) * sizes
    run = sb.simulate(model, starts, u0, times=times, rtol=1e-11, atol=1e-13)
    exact = target + sizes[:, None] * scipy.linalg.expm(times[:, None, None] * A)[:, 0, 0]
    errors = np.abs(run.states[0] - exact).max(axis=1)
    assert np.log2(errors[1] / errors[0]) == pytest.approx(order, abs=0.05)


def test_lyapunov_ellipse_of_an_lqr_returns():
    """Where V falls on every smaller ellipse, each start returns; V grows at the saddle."""
    model, limit = sb.Pendulum(m=1.5, L=0.8), 6.0
    lqr = sb.LQR(model, [np.pi / 2, 0.0], limit=limit)
    turn = np.linspace(0, 2 * np.pi, 181)
    ring = np.linalg.inv(np.linalg.cholesky(lqr.S).T) @ np.stack([np.cos(turn), np.sin(turn)])
    center = np.array([[np.pi / 2], [0.0]])

    def growing(radius):
        dx = radius * ring
        f = model.dynamics(center + dx, lqr(center + dx, 0.0))
        return (np.einsum("iN,ij,jN->N", dx, lqr.S, f) >= 0).any()

    radius = next(r for r in np.linspace(0.05, 20, 800) if growing(r))
    saddle = np.arcsin(limit / (1.5 * 9.8 * 0.8))
    assert radius / np.sqrt(lqr.S[0, 0]) < saddle
    assert radius**2 >= lqr.level
    ends = sb.simulate(model, center + 0.98 * radius * ring, lqr, times=[0, 15.0], rtol=1e-6)
    np.testing.assert_allclose(ends.states[..., -1], np.broadcast_to(center, ring.shape), atol=1e-3)


def test_stability_boundary_from_a_map_is_that_of_routh_and_hurwitz():
    """s^3 + a s^2 + b s + c is stable for a, c > 0 and a b > c."""

    def companion(a, c, b=2.0):
        A = np.zeros((*a.shape, 3, 3))
        A[..., 0, 1] = A[..., 1, 2] = 1.0
        A[..., 2, 0], A[..., 2, 1], A[..., 2, 2] = -c, -b, -a
        return A

    a, c = np.linspace(-0.95, 3.05, 41), np.linspace(-0.93, 5.07, 61)
    stable = sb.eigenvalue_map(companion, a, c).real.max(axis=-1) < 0
    a, c = np.meshgrid(a, c, indexing="ij")
    assert np.array_equal(stable, (a > 0) & (c > 0) & (2 * a > c))


# From f(x, u) to a verdict


def two_tanks(x, u, area=0.01, outlet=1e-4, g=9.81):
    flow1, flow2 = (outlet * (2 * g * level) ** 0.5 for level in x)
    return [(u[0] - flow1) / area, (flow1 - flow2) / area]


def test_two_tanks_settle_at_the_level_and_the_rate_of_torricelli():
    inflow, outlet, area, g = 2e-4, 1e-4, 0.01, 9.81
    rest = sb.find_equilibrium(two_tanks, [0.1, 0.3], [inflow])
    level = (inflow / outlet) ** 2 / (2 * g)
    np.testing.assert_allclose(rest.x, level, rtol=1e-12)
    report = sb.stability(two_tanks, rest.x, rest.u)
    assert report.verdict == "asymptotically stable"
    # A double eigenvalue in a Jordan block comes out to the root of rounding.
    rate = outlet / area * np.sqrt(g / (2 * level))
    np.testing.assert_allclose(report.eigenvalues, -rate, rtol=1e-7)


@pytest.mark.parametrize(("fixed", "x", "u"), [(["u[0]"], None, 0.1), (["x[0]"], 0.6, None)])
def test_equilibria_of_a_map_with_its_input_or_its_state_held(fixed, x, u):
    """A harvested population, x_next = r x (1 - x) - u."""
    r = 2.8
    harvest = sb.as_system(lambda x, u: r * x * (1 - x) - u, [0.5], [0.0], dt=True)
    found = sb.find_equilibrium(harvest, [x or 0.7], [u or 0.0], fixed=fixed)
    x = x or ((r - 1) + np.sqrt((r - 1) ** 2 - 4 * r * u)) / (2 * r)
    assert found.x[0] == pytest.approx(x, rel=1e-12)
    assert found.u[0] == pytest.approx(r * x * (1 - x) - x, rel=1e-9)
    report = sb.stability(harvest, found.x, found.u)
    assert report.eigenvalues[0] == pytest.approx(r * (1 - 2 * x), rel=1e-9)


def test_error_of_the_size_of_the_distance_ends_stability():
    A = np.array([[-1.0, 5.0, 0.0], [0.0, -1.5, 5.0], [0.0, 0.0, -2.0]])
    distance = sb.distance_to_instability(A)
    U, s, Vh = np.linalg.svd(A)  # here the boundary point i omega = 0 is the nearest
    worst = -np.outer(U[:, -1], Vh[-1])
    assert s[-1] == pytest.approx(distance, rel=1e-9)
    assert sb.stability(A + 0.999 * distance * worst).verdict == "asymptotically stable"
    assert sb.stability(A + 1.001 * distance * worst).verdict == "unstable"


def test_page_on_own_models_shows_what_happens():
    page = Path(__file__).parents[1] / "book" / "own_model.md"
    result = doctest.testfile(str(page), module_relative=False)
    assert result.attempted > 10 and result.failed == 0


# Bad input, through every function that takes a model


def in_place(x, u):
    x *= 2
    return np.array([x[1], u[0] - x[0]])


class WithMemory:
    def __init__(self):
        self.integral = 0.0

    def __call__(self, x, u):
        self.integral += 0.01 * x[0]
        return np.array([x[1], u[0] - x[0] - self.integral])


BAD = {
    "changes x in place": (lambda: in_place, [0.1, 0.0], [0.1], "in place"),
    "keeps a state": (WithMemory, [0.1, 0.0], [0.1], "make its memory part of the state"),
    "too few rows": (lambda: lambda x, u: x[:1], [0.0, 0.0], [0.0], r"shape \(2,\), got \(1,\)"),
    "not finite": (lambda: lambda x, u: x / 0, [1.0, 0.0], [0.0], "finite"),
    "x0 too long": (sb.Pendulum, [0.0, 0.0, 0.0], [0.0], r"(x0|x_guess) must have shape \(2,\)"),
    "x0 not finite": (sb.Pendulum, [np.nan, 0.0], [0.0], "(x0|x_guess) must be finite"),
}


@pytest.mark.parametrize(
    "function", [sb.jacobians, sb.find_equilibrium, sb.linearize, sb.stability]
)
@pytest.mark.parametrize(("make", "x0", "u0", "message"), BAD.values(), ids=BAD)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bad_models_and_points_are_refused(function, make, x0, u0, message):
    with pytest.raises(ValueError, match=message):
        function(make(), x0, u0)


def test_timebase_of_a_function_must_make_sense():
    for dt in (-0.1, np.nan):
        with pytest.raises(ValueError, match="dt"):
            sb.stability(lambda x: -x, [0.0], dt=dt)
    with pytest.raises(ValueError, match="contradicts"):
        sb.stability(sb.Pendulum(), [np.pi / 2, 0.0], dt=0.1)
