"""Runge-Kutta methods and fixed-step integration, against closed forms."""

import math
from dataclasses import replace
from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook.runge_kutta import METHODS, amplification_matrix, stability_function

EXPLICIT = ("euler", "midpoint", "heun", "rk4", "dopri5")
ALL = (*METHODS, "semi_implicit_euler")
OSCILLATOR = np.array([[0.0, 1.0], [-10.0, -1.0]])


def linear(A):
    return lambda x, t: A @ x


# --- Euler's method as the source prints it


def test_euler_by_hand():
    ts, xs = sb.integrate_euler(lambda x, t: np.array([x[1], t]), [1.0, 2.0], 3, 0.5, t0=1)
    assert ts.tolist() == [1.0, 1.5, 2.0, 2.5]
    assert xs.tolist() == [[1.0, 2.0], [2.0, 2.5], [3.25, 3.25], [4.875, 4.25]]


def test_times_do_not_drift():
    ts, _ = sb.integrate_euler(lambda x, t: 0 * x, [0.0], 1000, 0.1, t0=3.0)
    assert np.array_equal(ts, 3.0 + 0.1 * np.arange(1001))
    added = np.cumsum(np.full(1000, 0.1))[-1]  # Python 3.12 and newer sum without the drift
    assert ts[-1] != 3.0 + added


@pytest.mark.parametrize("dt", [0.025, 0.05, 0.1, 0.2])
def test_euler_error_of_a_falling_particle(dt):
    # y_k = 10 t - g t (t - dt) / 2: too high by g t dt / 2 at every step.
    g = 9.8
    ts, xs = sb.integrate_euler(
        lambda x, t: np.array([x[2], x[3], 0.0, -g]), [0, 0, 1, 10], round(2 / dt), dt
    )
    exact = 10 * ts - g * ts**2 / 2
    assert np.allclose(xs[:, 1] - exact, g * ts * dt / 2, atol=1e-12)
    assert np.allclose(xs[:, 0], ts, atol=1e-12)


def test_initial_state_alone_and_without_a_call():
    ts, xs = sb.integrate(lambda x, t: pytest.fail("called"), [1.0, 2.0], 0, 0.1, t0=5)
    assert ts.tolist() == [5.0]
    assert xs.tolist() == [[1.0, 2.0]]


# --- orders of convergence


def slope(method, f, x0, exact, steps=(40, 60, 90, 135)):
    errors = [
        np.abs(sb.integrate(f, x0, N, 1.0 / N, method=method)[1][-1] - exact).max() for N in steps
    ]
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


def decay(x, t):
    """Nonlinear and time-varying; from 1 the solution is 1 / (1 + t^2)."""
    return -2 * t * x**2


def rotate(x, t):
    """The solution from (1, 0) is at the angle t + t^2 / 2 on the unit circle."""
    return (1 + t) * np.array([-x[1], x[0]])


ROTATED = [np.cos(1.5), np.sin(1.5)]


@pytest.mark.parametrize("method", METHODS)
def test_fitted_order(method):
    order = slope(method, decay, [1.0], 0.5)
    assert order == pytest.approx(METHODS[method].order, abs=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_fitted_order_of_a_system(method):
    order = slope(method, rotate, [1.0, 0.0], ROTATED)
    assert order == pytest.approx(METHODS[method].order, abs=0.1)


def test_fitted_order_of_semi_implicit_euler():
    order = slope("semi_implicit_euler", linear(OSCILLATOR), [1.0, 0.0], exact=damped(1.0))
    assert order == pytest.approx(1, abs=0.1)


def damped(t):
    w, decay = np.sqrt(9.75), np.exp(-t / 2)
    return [
        decay * (np.cos(w * t) + np.sin(w * t) / (2 * w)),
        -10 / w * decay * np.sin(w * t),
    ]


def test_embedded_solution_has_order_four():
    pair = METHODS["dopri5"]
    embedded = replace(pair, name="embedded", b=pair.b_embedded, order=4, b_embedded=None)
    order = slope(embedded, rotate, [1.0, 0.0], ROTATED, (20, 30, 45, 68))
    assert order == pytest.approx(4, abs=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_polynomials_in_time_are_integrated_exactly(method):
    for degree in range(METHODS[method].order):
        ts, xs = sb.integrate(
            lambda x, t, q=degree: [(q + 1) * t**q], [0.0], 7, 0.25, t0=1.0, method=method
        )
        assert np.allclose(xs[:, 0], ts ** (degree + 1) - 1, rtol=1e-13)


# --- stability functions and amplification matrices


def test_a_method_cannot_be_changed_by_accident():
    with pytest.raises(ValueError, match="read-only"):
        METHODS["rk4"].numerator[0] = 2.0
    with pytest.raises(TypeError):
        METHODS["rk4"] = METHODS["euler"]


@pytest.mark.parametrize("method", EXPLICIT)
def test_stability_polynomial_starts_as_the_exponential(method):
    tableau = METHODS[method]
    taylor = [1 / factorial(k) for k in range(tableau.order + 1)]
    assert tableau.numerator[: tableau.order + 1].tolist() == taylor
    assert tableau.denominator.tolist() == [1.0]
    assert tableau.explicit


def test_known_rational_stability_functions():
    assert METHODS["backward_euler"].denominator.tolist() == [1.0, -1.0]
    assert METHODS["implicit_midpoint"].numerator.tolist() == [1.0, 0.5]
    assert METHODS["implicit_midpoint"].denominator.tolist() == [1.0, -0.5]
    assert METHODS["dopri5"].numerator[-1] == 1 / 600


@pytest.mark.parametrize("method", METHODS)
def test_stability_function_against_its_other_formula(method):
    # R(z) = 1 + z b^T (I - z A)^-1 e
    tableau = METHODS[method]
    A, b = np.array(tableau.A, float), np.array(tableau.b, float)
    rng = np.random.default_rng(1)
    for z in rng.normal(size=20) * 3 + 1j * rng.normal(size=20) * 3:
        other = 1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * A, np.ones(len(b)))
        assert stability_function(method, z) == pytest.approx(other, rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_stability_function_is_one_step(method):
    for z in (-0.7, 0.3 + 1.1j):
        _, xs = sb.integrate(lambda x, t, z=z: z / 0.2 * x, 1.0 + 0j, 1, 0.2, method=method)
        assert xs[1] == pytest.approx(stability_function(method, z), rel=1e-10)
        assert amplification_matrix([[z / 0.2]], 0.2, method)[0, 0] == pytest.approx(xs[1])


@pytest.mark.parametrize("method", ALL)
def test_amplification_matrix_is_one_step(method):
    A = np.random.default_rng(2).normal(size=(4, 4))
    columns = [sb.integrate(linear(A), column, 1, 0.3, method=method)[1][1] for column in np.eye(4)]
    assert np.allclose(amplification_matrix(A, 0.3, method), np.array(columns).T, atol=1e-11)


@pytest.mark.parametrize("method", ALL)
def test_amplification_matrices_of_stacks(method):
    rng = np.random.default_rng(3)
    A, dt = rng.normal(size=(3, 1, 4, 4)), np.array([0.1, 0.2])
    many = amplification_matrix(A, dt, method)
    assert many.shape == (3, 2, 4, 4)
    for i in range(3):
        for j in range(2):
            assert np.allclose(many[i, j], amplification_matrix(A[i, 0], dt[j], method))


def test_stability_function_at_a_pole_is_infinite():
    assert stability_function("backward_euler", 1.0) == np.inf
    values = stability_function("implicit_midpoint", np.array([2.0, 0.0]))
    assert values.tolist() == [np.inf, 1.0]
    with pytest.raises(ValueError, match="pole"):
        amplification_matrix([[5.0]], 0.2, "backward_euler")


def test_semi_implicit_euler_has_no_stability_function():
    with pytest.raises(ValueError, match="amplification_matrix"):
        stability_function("semi_implicit_euler", 1.0)


def test_semi_implicit_euler_is_symplectic_and_moves_velocities_first():
    matrix = amplification_matrix([[0, 1], [-1, 0]], 0.5, "semi_implicit_euler")
    assert np.linalg.det(matrix) == pytest.approx(1)
    assert matrix.tolist() == [[0.75, 0.5], [-0.5, 1.0]]


def test_a_tableau_of_ones_own():
    ralston = sb.ButcherTableau("ralston", [[0, 0], ["2/3", 0]], ["1/4", "3/4"], [0, "2/3"], 2)
    assert ralston.A[1][0] == Fraction(2, 3)
    assert ralston.numerator.tolist() == [1, 1, 0.5]
    assert slope(ralston, decay, [1.0], 0.5) == pytest.approx(2, abs=0.1)
    assert ralston == replace(ralston, c=[0, Fraction(2, 3)])


def test_a_fully_implicit_tableau_of_two_stages():
    # Gauss's method of order 4; its R(z) is the Pade approximant (2, 2) of exp(z).
    r = 3**0.5 / 6
    gauss = sb.ButcherTableau(
        "gauss2", [[0.25, 0.25 - r], [0.25 + r, 0.25]], [0.5, 0.5], [0.5 - r, 0.5 + r], 4
    )
    assert np.allclose(gauss.numerator, [1, 1 / 2, 1 / 12], rtol=1e-15)
    assert np.allclose(gauss.denominator, [1, -1 / 2, 1 / 12], rtol=1e-15)
    order = slope(gauss, decay, [1.0], 0.5, (8, 12, 18))
    assert order == pytest.approx(4, abs=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"b": [1, 2]}, "length"),
        ({"A": [["x"]]}, "A must hold finite numbers"),
        ({"c": [np.nan]}, "c must hold finite numbers"),
        ({"order": 0}, "order"),
    ],
)
def test_wrong_tableaus(change, message):
    fields = {"name": "one", "A": [[0]], "b": [1], "c": [0], "order": 1} | change
    with pytest.raises((ValueError, TypeError), match=message):
        sb.ButcherTableau(**fields)


# --- physics


def test_euler_multiplies_the_pure_oscillators_radius_each_step():
    _, xs = sb.integrate_euler(lambda x, t: np.array([x[1], -x[0]]), [1.0, 0.0], 80, 0.1)
    assert np.allclose(np.hypot(*xs.T), (1 + 0.1**2) ** (np.arange(81) / 2), rtol=1e-13)


def test_implicit_midpoint_keeps_the_pure_oscillators_radius():
    _, xs = sb.integrate(
        lambda x, t: np.array([x[1], -x[0]]), [1.0, 0.0], 200, 0.5, method="implicit_midpoint"
    )
    assert np.allclose(np.hypot(*xs.T), 1, atol=1e-12)


def test_semi_implicit_euler_stays_bounded_where_euler_does_not():
    f = linear(np.array([[0.0, 1.0], [-1.0, 0.0]]))
    _, xs = sb.integrate(f, [1.0, 0.0], 5000, 1.9, method="semi_implicit_euler")
    assert np.abs(xs).max() < 5
    with pytest.raises(sb.DivergenceError):
        sb.integrate_euler(f, [1.0, 0.0], 5000, 1.9)


@pytest.mark.parametrize("method", ["backward_euler", "implicit_midpoint"])
@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1e12])
def test_implicit_steps_do_not_depend_on_units(method, unit):
    def states(unit):
        decay = sb.integrate(
            lambda x, t: [-(x[0] ** 2) / unit, x[0] - x[1]], [unit, 0.0], 5, 0.5, method=method
        )
        return decay[1]

    assert states(unit) / unit == pytest.approx(states(1.0), rel=1e-11)
    if method == "backward_euler":
        assert states(1.0)[1, 0] == pytest.approx(np.sqrt(3) - 1)  # y + y^2/2 = 1


@pytest.mark.parametrize("start", [0.0, 1e-13, 1e-6])
def test_a_state_near_zero_is_no_small_unit(start):
    _, xs = sb.integrate(lambda x, t: 1e6 * (1 - x), [start], 1, 0.1, method="backward_euler")
    assert xs[1, 0] == pytest.approx((start + 1e5) / (1 + 1e5), rel=1e-12)


def test_backward_euler_on_a_stiff_system():
    # x' = -1e6 (x - cos t) - sin t has the solution cos t; the error is dt / (2e6) at most.
    ts, xs = sb.integrate(
        lambda x, t: -1e6 * (x - np.cos(t)) - np.sin(t), [1.0], 50, 0.1, method="backward_euler"
    )
    assert np.abs(xs[:, 0] - np.cos(ts)).max() < 5e-8


# --- shapes


@pytest.mark.parametrize("method", ALL)
def test_batch_equals_its_columns(method):
    def f(x, t):
        return np.stack([x[1], -9.8 * np.cos(x[0]) + np.sin(t)])

    x0 = np.array([[0.1, -1.0, 2.0], [0.0, 0.5, -0.5]])
    _, many = sb.integrate(f, x0, 20, 0.05, method=method)
    assert many.shape == (21, 2, 3)
    for k in range(3):
        _, one = sb.integrate(f, x0[:, k], 20, 0.05, method=method)
        assert np.allclose(many[:, :, k], one, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_a_number_is_a_state(method):
    ts, xs = sb.integrate(lambda x, t: -x, 2, 100, 0.01, method=method)
    assert xs.shape == (101,)
    assert np.allclose(xs, 2 * np.exp(-ts), rtol=1e-2)


@settings(max_examples=40, deadline=None)
@given(
    split=st.integers(0, 12),
    dt=st.sampled_from([0.125, 0.25, 0.5]),
    t0=st.integers(-4, 4),
    method=st.sampled_from(ALL),
)
def test_integration_can_be_interrupted(split, dt, t0, method):
    # With a dyadic step the times are exact, and so is the equality.
    def f(x, t):
        return np.array([x[1], np.sin(t) - x[0]])

    ts, xs = sb.integrate(f, [1.0, 0.0], 12, dt, t0, method=method)
    ta, xa = sb.integrate(f, [1.0, 0.0], split, dt, t0, method=method)
    tb, xb = sb.integrate(f, xa[-1], 12 - split, dt, ta[-1], method=method)
    assert np.array_equal(np.concatenate([ta, tb[1:]]), ts)
    assert np.array_equal(np.concatenate([xa, xb[1:]]), xs)


@pytest.mark.parametrize("method", ALL)
def test_a_function_that_works_in_place_does_no_harm(method):
    def f(x, t):
        x *= -1
        return x

    _, harmed = sb.integrate(f, [1.0, 2.0], 3, 0.5, method=method)
    _, plain = sb.integrate(lambda x, t: -x, [1.0, 2.0], 3, 0.5, method=method)
    assert np.array_equal(harmed, plain)


# --- failures


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"dt": 0}, ValueError, "dt must be greater than 0, got 0"),
        ({"dt": -0.1}, ValueError, "dt must be greater than 0"),
        ({"N": -1}, ValueError, "N must be at least 0, got -1"),
        ({"N": 2.5}, TypeError, "N must be an integer"),
        ({"x0": [np.nan]}, ValueError, "x0 must be finite"),
        ({"x0": ["a"]}, TypeError, "x0 must be an array of numbers"),
        ({"t0": np.inf}, ValueError, "t0 must be finite"),
        ({"method": "rk5"}, ValueError, "method must be one of euler, .*semi_implicit_euler"),
        ({"method": "semi_implicit_euler"}, ValueError, "as many positions as velocities"),
        ({"f": 3}, TypeError, "f must be a function"),
        ({"f": lambda x, t: [1.0, 2.0]}, ValueError, r"shape of x, \(1,\), got \(2,\)"),
        ({"f": lambda x, t: None}, TypeError, "must return numbers, got array"),
        ({"f": lambda x, t: 1j * x}, TypeError, "complex"),
        ({"f": lambda x, t: x * np.nan}, ValueError, r"f\(x0, t0\) must be finite"),
    ],
)
def test_bad_arguments(arguments, error, message):
    good = {"f": lambda x, t: -x, "x0": [1.0], "N": 3, "dt": 0.1}
    with pytest.raises(error, match=message):
        sb.integrate(**(good | arguments))


def test_divergence_says_when_and_keeps_what_it_computed():
    with pytest.raises(
        sb.DivergenceError, match=r"at t = 2\.1, .*; 21 of 100 steps are in"
    ) as caught:
        sb.integrate_euler(lambda x, t: x**2, [1.0], 100, 0.1)
    error = caught.value
    assert error.time == pytest.approx(2.1)
    assert error.trajectory.times[-1] == error.time
    assert np.array_equal(error.trajectory.states[:, -1], error.state)
    assert error.trajectory.states[0, 1] == 1.1


def test_nan_later_is_reported_with_its_time():
    with pytest.raises(sb.DivergenceError) as caught:
        sb.integrate(lambda x, t: np.sqrt(0.45 - t) * x, [1.0], 10, 0.1, method="euler")
    assert caught.value.time == 0.5


@pytest.mark.parametrize("x0", [1.0, [1.0], [[1.0, 2.0]], 1 + 1j])
def test_divergence_of_every_shape(x0):
    with pytest.raises(sb.DivergenceError):
        sb.integrate(lambda x, t: x**3, x0, 50, 1.0)


def test_an_implicit_step_without_solution():
    # x = 1 + dt (x^2 + 1) has no real solution for this step.
    with pytest.raises(sb.DivergenceError, match="not solved; try a smaller dt"):
        sb.integrate(lambda x, t: x**2 + 1, [1.0], 1, 1.0, method="backward_euler")


@pytest.mark.parametrize(
    ("A", "dt", "message"),
    [
        (np.zeros((2, 3)), 0.1, "A must have shape"),
        ([1.0], 0.1, "A must have shape"),
        (np.eye(2), 0.0, "dt must be positive"),
        (np.eye(3), 0.1, "as many positions as velocities"),
    ],
)
def test_bad_arguments_of_amplification_matrix(A, dt, message):
    with pytest.raises(ValueError, match=message):
        amplification_matrix(A, dt, "semi_implicit_euler")


@pytest.mark.parametrize("method", ["euler", "rk4", "implicit_midpoint"])
def test_leaving_the_domain_of_math_says_when_and_where(method):
    with pytest.raises(sb.DivergenceError, match=r"stopped at t = .* failed \(math") as caught:
        sb.integrate(lambda x, t: [-math.sqrt(x[0]) - 0.1], [1.0], 40, 0.1, method=method)
    assert caught.value.time == pytest.approx(1.5, abs=0.2)
    assert caught.value.trajectory.times[-1] == caught.value.time
    with pytest.raises(ValueError, match=r"no value in the first step, from t = 0, x = \[-1\.\]"):
        sb.integrate(lambda x, t: [-math.sqrt(x[0])], [-1.0], 4, 0.1, method=method)
