"""as_system sees every kind of system alike, and knows the traps."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
import scipy.linalg
import sympy

import statebook as sb


def swing(x, u):
    return np.array([x[1], u[0] - 9.8 * np.cos(x[0])])


def unbatched(x, u):
    return np.array([x[1], -9.8])  # cannot take a batch: rows of different shapes


def transposing(x, u):
    return np.array([x[1], -x[0]]).T


def mixing(x, u):
    return x - x.mean() if x.ndim == 2 else x - x.mean() * 0 - np.mean(x)


X, U = np.array([[0.1, 0.5, -0.2], [1.0, 0.0, 2.0]]), np.array([[0.3, -0.4, 0.7]])


def as_each_kind():
    pendulum = sb.Pendulum()
    linear = control.ss([[0, 1], [-2, -3]], [[0], [1]], np.eye(2), 0, name="linear")
    return [
        pendulum,
        pendulum.to_nlsys(),
        linear,
        swing,
        lambda x, u: [x[1], u[0] - 9.8 * math.cos(x[0])],
        sb.as_system(pendulum),
        unbatched,
        transposing,
        mixing,
    ]


@pytest.mark.parametrize("system", as_each_kind(), ids=lambda s: type(s).__name__)
def test_batch_gives_what_its_columns_give(system):
    system = sb.as_system(system, X, U)
    assert (system.n, system.m) == (2, 1)
    for u in (U, U[:, 0]):
        columns = [system.dynamics(X[:, k], u if u.ndim == 1 else u[:, k]) for k in range(3)]
        np.testing.assert_allclose(system.dynamics(X, u), np.stack(columns, axis=1), rtol=1e-13)


def test_one_input_serves_a_batch_whose_function_stacks_rows():
    system = sb.as_system(lambda x, u: np.array([x[1], u[0]]), X, U)
    assert system.batched
    np.testing.assert_array_equal(system.dynamics(X, [0.5]), [X[1], [0.5] * 3])


@pytest.mark.parametrize("function", [unbatched, transposing, mixing])
def test_function_that_cannot_take_a_batch_is_called_by_columns(function):
    assert not sb.as_system(function, X, U).batched
    assert sb.as_system(swing, X, U).batched


def test_python_control_system_is_never_called_with_a_batch():
    assert not sb.as_system(sb.Pendulum().to_nlsys()).batched


def test_time_dependent_python_control_system_gets_the_time():
    sys = control.nlsys(lambda t, x, u, params: [t * x[0]], states=1, inputs=1)
    assert sb.as_system(sys).dynamics([2.0], [0.0], t=3.0) == 6.0


@pytest.mark.parametrize(("dt", "discrete"), [(None, False), (0, False), (True, True), (0.1, True)])
def test_timebase_of_a_function(dt, discrete):
    system = sb.as_system(lambda x: x / 2, [1.0], dt=dt)
    assert system.discrete is discrete and system.dt == dt


def test_timebase_of_a_python_control_system_wins_or_is_contradicted():
    sys = control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1)
    assert sb.as_system(sys).dt == 0.1
    assert sb.as_system(sys, dt=0.1).discrete
    for contradiction in (0.2, True, 0):
        with pytest.raises(ValueError, match="contradicts the timebase"):
            sb.as_system(sys, dt=contradiction)
    with pytest.raises(ValueError, match="contradicts the timebase"):
        sb.as_system(sb.Pendulum(), dt=0.1)


def test_a_default_for_u_makes_it_optional():
    def f(x, u=(0.0,)):
        return [u[0] - x[0]]

    assert sb.as_system(f, [1.0]).m == 0
    assert sb.as_system(f, [1.0], [2.0]).dynamics([1.0], [5.0]) == 4.0


def test_caller_arrays_stay_as_they_are():
    def clip(x):
        if x[0] > 1:
            x[0] = 1  # only where the probe does not look
        return -x

    x = np.array([2.0])
    sb.as_system(clip, [0.5]).dynamics(x)
    assert x[0] == 2.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sb.as_system("pendulum"), "must be a library model, a function"),
        (lambda: sb.as_system(control.tf([1], [1, 1])), "state space"),
        (lambda: sb.as_system(swing), "x0 is required"),
        (lambda: sb.as_system(lambda x, u: -x + u, [0, 0, 0]), "u0 is required"),
        (lambda: sb.as_system(lambda x: x, [0, 0], [1]), "takes x alone"),
        (lambda: sb.as_system(lambda x, u, t, p: x, [0, 0], [1]), "4 required arguments"),
        (lambda: sb.as_system(lambda x: x, [np.nan]), "x0 must be finite"),
        (lambda: sb.as_system(lambda x: x, [[[1.0]]]), r"x0 must have shape \(n,\)"),
        (lambda: sb.as_system(lambda x: x, [1.0], dt=-0.1), "dt must be"),
        (lambda: sb.as_system(lambda x: x.__imul__(2), [1.0]), "changed one in place"),
        (lambda: sb.as_system(swing, [0, 0], [0]).dynamics([0, 0, 0]), "x must have shape"),
        (lambda: sb.as_system(swing, [0, 0], [0]).dynamics([0, 0], [1, 2]), "u must have shape"),
        (lambda: sb.as_system(lambda x: x[:1], [0, 0]).dynamics([0, 0]), r"got \(1,\), at x"),
        (lambda: sb.as_system(lambda x: x / 0 * 1j, [1]).dynamics([1]), "must be finite"),
        (lambda: sb.as_system(lambda x: None, [1]).dynamics([1]), "array of numbers"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bad_input_is_refused_by_name(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def test_function_with_a_memory_is_refused():
    calls = []

    def counting(x):
        calls.append(1)
        return x * len(calls)

    with pytest.raises(ValueError, match="part of the state"):
        sb.as_system(counting, [1.0])


# Time


def forced(x, u, t):
    return [x[1], np.sin(t) * np.cos(x[0]) - x[0] + u[0]]


def test_a_system_that_depends_on_time_is_analysed_at_a_stated_time():
    sys = control.nlsys(lambda t, x, u, params: forced(x, u, t), states=2, inputs=1)
    for system in (forced, sys):
        for function in (sb.jacobians, sb.linearize, sb.find_equilibrium):
            with pytest.raises(ValueError, match="t is required"):
                function(system, [0.0, 0.0], [0.0])
        A, _ = sb.jacobians(system, [0.3, 0.0], [0.0], t=2.0)
        np.testing.assert_allclose(A[1], [-1 - np.sin(2.0) * np.sin(0.3), 0], rtol=1e-14)
        rest = sb.find_equilibrium(system, [0.3, 0.0], [0.0], t=2.0)
        assert rest.x[0] == pytest.approx(np.sin(2.0) * np.cos(rest.x[0]), rel=1e-14)
        linear = sb.linearize(system, rest.x, [0.0], t=2.0)
        np.testing.assert_allclose(linear.A[1, 0], -1 - np.sin(2.0) * np.sin(rest.x[0]))


@pytest.mark.parametrize(
    "f",
    [
        lambda x, u, t: [t * x[0]],
        lambda x, u, t: [-x[0] + (t > 5)],
        lambda x, u, t=0.0: [-x[0] * np.exp(-t)],
        lambda x, u, t: [-x[0] + u[0] * t],
    ],
)
def test_what_vanishes_at_the_point_depends_on_time_all_the_same(f):
    with pytest.raises(ValueError, match="t is required: function depends on the time"):
        sb.jacobians(f, [0.0], [0.0])


@pytest.mark.parametrize("x0", [1.0, -1.0, 2.5])
def test_time_is_seen_where_what_it_multiplies_vanishes(x0):
    with pytest.raises(ValueError, match="t is required: function depends on the time"):
        sb.jacobians(lambda x, u, t: [t * (x[0] - x0)], [x0], [])


def test_a_time_that_does_not_matter_is_not_asked_for():
    A, B = sb.jacobians(lambda x, u, t: [x[1], u[0] - x[0]], [0, 0], [0])
    assert A.tolist() == [[0, 1], [-1, 0]] and B.tolist() == [[0], [1]]
    sb.linearize(sb.Pendulum().to_nlsys(), [np.pi / 2, 0])


@pytest.mark.parametrize(
    "f",
    [
        lambda t, x: [x[1], -x[0]],
        lambda t, x, u: [x[1], u[0]],
        lambda time, y: -y,
        lambda time_s, state: [state[1], -state[0]],
        lambda t_, x: [x[1], -x[0]],
        lambda x, t: [x[1], -x[0]],
    ],
)
def test_the_time_in_another_place_is_recognized_and_named(f):
    for function in (sb.jacobians, sb.linearize, sb.find_equilibrium):
        with pytest.raises(TypeError, match="the time in another place; write lambda x, u, t: f"):
            function(f, [0.0, 0.0])


# Inputs that are not given


@pytest.mark.parametrize(
    ("f", "m"),
    [
        (lambda x, u: [x[1], u[0] - x[0]], 1),
        (lambda x, u: [x[1] + u[1], u[0] - x[0]], 2),
        (lambda x, u: x @ np.eye(2) + np.ones((2, 3)) @ u, 3),
        (lambda x, u: -x, 0),
        (lambda x, u, t: -x, 0),
    ],
)
def test_a_function_is_asked_how_many_inputs_it_takes(f, m):
    assert sb.as_system(f, [0.3, 0.1]).m == m
    assert sb.jacobians(f, [0.3, 0.1])[1].shape == (2, m)


def test_a_ragged_return_is_explained():
    for function in (sb.jacobians, sb.linearize, sb.find_equilibrium):
        with pytest.raises(TypeError, match=r"shapes \(\), \(1,\); in row 1 write u\[0\]"):
            function(lambda x, u: [x[1], -np.sin(x[0]) + u], [0.0, 0.0], [0.0])


class Metres:
    """A number with a unit, which no array of floats takes."""

    shape = ()

    def __init__(self, value):
        self.value = value

    def __array__(self, dtype=None, copy=None):
        raise ValueError("strip the unit first")


def test_numbers_that_make_no_array_are_named():
    for function in (sb.jacobians, sb.linearize, sb.find_equilibrium):
        with pytest.raises(TypeError, match=r"one number for each state, got .*strip the unit"):
            function(lambda x: [Metres(x[1]), Metres(-x[0])], [0.0, 0.0])


def test_a_column_is_a_state_as_sympy_and_matrix_products_write_it():
    x, v, u = sympy.symbols("x v u")
    symbolic = sympy.lambdify([[x, v], [u]], sympy.Matrix([v, u - sympy.sin(x) - v / 5]))
    A, B = np.array([[0.0, 1.0], [-2.0, -0.2]]), np.array([[0.0], [1.0]])
    report = sb.linearize(symbolic, [0.0, 0.0], [0.0])
    np.testing.assert_allclose(report.A, [[0, 1], [-1, -0.2]], atol=1e-12)

    def product(x, u):
        return A @ x.reshape(2, 1) + B @ u.reshape(1, 1)

    def columns(x, u):  # a batch of columns, shape (n, 1, N)
        return (A @ x + B @ u)[:, None]

    def policy(x, t):
        return -np.array([[0.0, 1.0]]) @ x.reshape(2, 1)

    run = sb.simulate(product, [1.0, 0.0], policy, times=[0.0, 2.0])
    closed = scipy.linalg.expm(2.0 * (A - B @ [[0.0, 1.0]]))[:, 0]
    np.testing.assert_allclose(run.states[:, -1], closed, rtol=1e-5)
    assert not sb.as_system(product, X, U).batched
    system = sb.as_system(columns, X, U)
    assert system.batched
    np.testing.assert_allclose(system.dynamics(X, U), A @ X + B @ U, rtol=1e-15)
    with pytest.raises(ValueError, match=r"shape \(2,\), got \(1, 2\)"):  # a row is another thing
        sb.as_system(lambda x: x[None], [1.0, 2.0]).dynamics([1.0, 2.0])


def test_functions_built_in_c_take_x_and_u():
    pushed = sb.as_system(np.add, [1.0, 2.0], [0.5, 0.5])  # built in C
    assert not pushed.timed
    np.testing.assert_array_equal(pushed.dynamics([1.0, 2.0], [3.0, -1.0]), [4.0, 1.0])
    np.testing.assert_array_equal(sb.as_system(np.negative, [1.0]).dynamics([3.0]), [-3.0])
