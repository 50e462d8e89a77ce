"""Derivatives of other people's functions: right, or refused with a reason."""

from __future__ import annotations

import math
import warnings

import control
import numpy as np
import pytest
import scipy

import statebook as sb
from statebook.derivatives import differentiate

WAVE = 2 * np.pi / 500e-9


def second_order(force):
    """Return x'' = force(x) - x' as a system of first order."""
    return lambda x: [x[1], force(x[0]) - x[1]]


# f, the point, A, its relative tolerance: scales of f that are far from those of the point.
SCALES = {
    "steep exponential": (lambda x: np.expm1(1000 * x), [0.0], [[1000]]),
    "narrow bell": (lambda x: x * np.exp(-((x / 1e-3) ** 2)), [0.0], [[1]]),
    "fast wave": (
        second_order(lambda x: -np.sin(2 * np.pi * 50 * x)),
        [0, 0],
        [[0, 1], [-100 * np.pi, -1]],
    ),
    "nanometres": (second_order(lambda x: -np.sin(WAVE * x)), [0, 0], [[0, 1], [-WAVE, -1]]),
    "very fast wave": (lambda x: np.sin(1e7 * x), [0.0], [[1e7]]),
    "very fast wave away": (lambda x: np.sin(1e7 * x), [1.0], [[1e7 * np.cos(1e7)]]),
    "diode": (
        lambda x: 1e-14 * np.expm1(x / 0.02585),
        [0.6],
        [[1e-14 / 0.02585 * np.exp(0.6 / 0.02585)]],
    ),
    "diode at rest": (lambda x: 1e-14 * np.expm1(x / 0.02585), [0.0], [[1e-14 / 0.02585]]),
    "pole one step away": (lambda x: -x / (0.1 + x), [0.0], [[-10]]),
    "pole close by": (lambda x: -x / (1e-4 + x), [0.0], [[-1e4]]),
    "narrow Lorentzian": (lambda x: x / (x**2 + 1e-8), [0.0], [[1e8]]),
    "logistic switch": (lambda x: 1 / (1 + np.exp(-(x - 0.5) / 1e-4)), [0.5], [[2500]]),
    "Coulomb": (lambda x: 1e-28 / x**2, [1e-10], [[-2e2]]),
    "huge rows": (
        lambda x: [1e200 * np.sin(x[0]), 1e-200 * x[1]],
        [0.3, 2.0],
        [[1e200 * np.cos(0.3), 0], [0, 1e-200]],
    ),
    "cancels in one term": (lambda x: (1e3 + x) - 1e3 * np.cos(x), [0.0], [[1]]),
}


@pytest.mark.parametrize(("f", "x0", "expected"), SCALES.values(), ids=SCALES)
def test_functions_on_any_scale_are_exact(f, x0, expected):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        A, _ = sb.jacobians(f, x0)
    np.testing.assert_allclose(A, expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    "f",
    [
        lambda x: 0.1 * x + 0.2 * x - 0.3 * x,
        lambda x: 1.1 * x - x - 0.1 * x,
        lambda x: (x + 1e6) - (x + 1e6),
    ],
)
@pytest.mark.parametrize("x0", [0.0, 0.7, -3.3e4])
def test_terms_of_a_linear_function_that_cancel_are_no_kink(f, x0):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        A, _ = sb.jacobians(f, [x0])
    assert abs(A[0, 0]) < 3e-16


SMALL_SHARES = {
    "wrong slope hidden in a large row": (
        lambda x: [1e9 * np.sin(x[0]) + x[1] * abs(x[1])],
        [0.7, 1.0],
        2.0,
    ),
    "and in noise": (lambda x: [1e13 * np.sin(x[0]) + x[1] * abs(x[1])], [0.7, 1.0], 2.0),
    "and small": (lambda x: [1e9 * np.sin(x[0]) + 1e-5 * x[1] * abs(x[1])], [0.7, 1.0], 2e-5),
    "table": (
        lambda x: [1e9 * x[0] ** 2 + np.interp(np.real(x[1]), [0, 1, 2], [0, 1, 4])],
        [0.7, 1.5],
        3.0,
    ),
    "half a slope on a constant": (
        lambda x: [1e8 * np.cos(x[0]) + x[1] * abs(x[1])],
        [0.0, 1e-3],
        2e-3,
    ),
}


@pytest.mark.parametrize(("f", "x0", "expected"), SMALL_SHARES.values(), ids=SMALL_SHARES)
def test_a_slope_that_is_small_in_its_row_is_right_within_its_error(f, x0, expected):
    n = len(x0)
    J, error, *_ = differentiate(
        lambda z: np.stack([np.array(f(c)) for c in z.T], axis=1), np.array(x0)[:, None]
    )
    assert J.shape == (1, 1, n)
    assert abs(J[0, 0, 1] - expected) <= 4 * error[0, 0, 1]
    assert 0 < error[0, 0, 1] <= 0.1 * expected


STAIRS = {
    "round": lambda x: np.round(x**2, 3),
    "floor": lambda x: np.floor(np.real(x)),
    "rounded beside a slope": lambda x: -x + np.round(x, 1),
    "quantizer": lambda x: 0.05 * np.round(x / 0.05),
    "integers": lambda x: [int(x[0] * 100) / 100],
    "nearest entry of a table": lambda x: [np.sin(np.arange(0, 9, 0.01))[int(x[0] / 0.01)]],
}


@pytest.mark.parametrize("f", STAIRS.values(), ids=STAIRS)
@pytest.mark.parametrize("x0", [0.323, 1.0011])
def test_stairs_are_refused_or_have_an_error_and_a_warning(f, x0):
    with pytest.warns(sb.InexactDerivativeWarning) as caught:
        try:
            A, _ = sb.jacobians(f, [x0])
        except sb.KinkError as error:
            warnings.warn(str(error), sb.InexactDerivativeWarning, stacklevel=1)
        else:
            assert A[0, 0] != 0  # the slope of the stairs, not of a tread
    assert caught


def test_what_is_flat_here_and_not_elsewhere_is_flat():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for f, x0 in [
            (lambda x: np.clip(x, -1, 1), 2.0),
            (lambda x: np.where(x > 0, 1.0, -1.0) + 0 * x, 0.3),
            (lambda x: np.sign(x) * np.maximum(abs(x) - 1e-3, 0), 0.0),
            (lambda x: np.where(x == 0, 0, np.exp(-1 / (x**2 + (x == 0)))), 0.0),
        ]:
            assert sb.jacobians(f, [x0])[0] == 0


def oscillator_in_short_precision(x):
    x = np.float32(x)
    return np.array([x[1], -np.sin(x[0]) - np.float32(0.1) * x[1]], dtype=np.float32)


@pytest.mark.parametrize(
    "f",
    [
        oscillator_in_short_precision,
        lambda x: oscillator_in_short_precision(x).astype(float),
        lambda x: [float(v) for v in oscillator_in_short_precision(x)],
    ],
)
@pytest.mark.parametrize("x0", [[0.3, 0.1], [0.0, 0.0], [-1.2, 0.7]])
@pytest.mark.filterwarnings("ignore::numpy.exceptions.ComplexWarning")
def test_short_precision_is_used_and_said(f, x0):
    with pytest.warns(sb.InexactDerivativeWarning):
        A, _ = sb.jacobians(f, x0)
    np.testing.assert_allclose(A, [[0, 1], [-np.cos(x0[0]), -0.1]], rtol=0, atol=2e-5)


def test_a_function_that_returns_its_own_buffer():
    buffer = np.zeros(2)

    def f(x):
        buffer[0], buffer[1] = x[1], -math.sin(x[0])
        return buffer

    with pytest.warns(sb.InexactDerivativeWarning):
        A, _ = sb.jacobians(f, [0.3, 0.1])
    np.testing.assert_allclose(A, [[0, 1], [-np.cos(0.3), 0]], atol=1e-11)
    sys = control.nlsys(lambda t, x, u, params: f(x), states=2, inputs=1)
    batch = sb.as_system(sys).dynamics(np.array([[0.1, 0.2], [0.3, 0.4]]), [0.0])
    np.testing.assert_allclose(batch, [[0.3, 0.4], -np.sin([0.1, 0.2])])


def not_complex(x):
    if np.iscomplexobj(x):
        raise NotImplementedError("a symbol of another library")
    return [math.exp(-x[0])]


REAL_ONLY = {
    "raises what it likes": (not_complex, [0.5], [[-math.exp(-0.5)]]),
    "solves an equation": (
        lambda x: [scipy.optimize.brentq(lambda y: y**3 + y - x[0], -9, 9, xtol=1e-15)],
        [1.0],
        [[1 / (1 + 3 * 0.6823278038280193**2)]],
    ),
    "math": (lambda x: [math.tanh(3 * x[0])], [0.2], [[3 / math.cosh(0.6) ** 2]]),
    "math on nanometres": (lambda x: [math.sin(WAVE * x[0])], [0.0], [[WAVE]]),
    "spline": (
        lambda x: [float(scipy.interpolate.CubicSpline([0, 1, 2, 3], [0, 1, 8, 27])(x[0]))],
        [1.5],
        [[6.75]],
    ),
}


@pytest.mark.parametrize(("f", "x0", "expected"), REAL_ONLY.values(), ids=REAL_ONLY)
def test_real_only_functions_have_differences_and_a_warning(f, x0, expected):
    with pytest.warns(sb.InexactDerivativeWarning):
        A, _ = sb.jacobians(f, x0)
    np.testing.assert_allclose(A, expected, rtol=1e-9)


def test_real_only_functions_cost_six_evaluations_a_column():
    calls = [0]

    def ring(x):
        calls[0] += 1
        return [math.sin(x[i]) * x[(i + 1) % 30] - x[i] for i in range(30)]

    with pytest.warns(sb.InexactDerivativeWarning):
        sb.jacobians(ring, np.linspace(0.1, 1.0, 30))
    assert calls[0] <= 6 * 30 + 12  # and what as_system asks


NO_DERIVATIVE = {
    "flat power": lambda x: np.abs(x) ** 1.2 * np.sign(x),
    "abs beside a parabola": lambda x: 1e6 * x**2 + abs(x),
    "abs beside a quartic": lambda x: 1e6 * x**4 + abs(x),
    "abs beside a slope": lambda x: 1e6 * x + abs(x),
    "relay": lambda x: np.sign(x),
    "switch": lambda x: np.where(x > 0, 1.0, -1.0),
    "logarithm": lambda x: np.log(np.abs(x) + (x == 0)) * x,
}


@pytest.mark.parametrize("f", NO_DERIVATIVE.values(), ids=NO_DERIVATIVE)
def test_no_derivative_at_the_point(f):
    with pytest.raises(sb.KinkError, match=r"respect to x\[0\]"):
        sb.jacobians(f, [0.0])


def test_a_derivative_that_is_not_continuous_is_right_or_refused():
    def f(x):
        return [x[0] ** 2 * np.sin(1 / x[0]) if x[0] != 0 else 0 * x[0]]

    assert abs(sb.jacobians(f, [0.0])[0][0, 0]) < 1e-12


def saturated(x, u):
    return [x[1], np.clip(u[0], -1, 1) - np.sin(x[0]) + 0.5 * abs(u[1])]


def test_a_kink_in_one_input_does_not_refuse_the_others():
    with pytest.raises(
        sb.KinkError, match=r"slope of row 1 is -0\.5.* below .* 0\.5.* above"
    ) as kink:
        sb.jacobians(saturated, [0, 0], [0.3, 0.0])
    assert "u[1]" in str(kink.value) and "inputs=" in str(kink.value)
    A, B = sb.jacobians(saturated, [0, 0], [0.3, 0.0], inputs=["u[0]"])
    np.testing.assert_allclose(A, [[0, 1], [-1, 0]])
    np.testing.assert_allclose(B, [[0], [1]])
    A, B = sb.jacobians(saturated, [0, 0], [0.3, 0.0], states=["x[1]"], inputs=[])
    np.testing.assert_allclose(A, [[1], [0]])
    assert B.shape == (2, 0)
    linear = sb.linearize(saturated, [0, 0], [0.0, 0.0], inputs=["u[0]"])
    assert linear.input_labels == ["u[0]"] and linear.B.tolist() == [[0], [1]]
    held = sb.linearize(sb.CartPole(), [0, np.pi / 2, 0, 0], states=["theta", "omega"])
    assert held.state_labels == held.output_labels == ["theta", "omega"]
    np.testing.assert_allclose(held.A, [[0, 1], [39.2, 0]], rtol=1e-12)


def test_a_saturation_is_linear_inside_and_refused_at_its_edge():
    for level, slope in [(0.999, 1), (1.001, 0), (-0.9, 1), (-30.0, 0)]:
        _, B = sb.jacobians(saturated, [0, 0], [level, 1.0], inputs=["u[0]"])
        assert B[1, 0] == slope
    with pytest.raises(sb.KinkError, match=r"is 1.* below the point and 0 above.*to take one side"):
        sb.jacobians(saturated, [0, 0], [1.0, 1.0])


def test_scale_of_a_variable():
    A, _ = sb.jacobians(lambda x: np.sin(WAVE * x), [0.0], scale={"x[0]": 1e-8})
    assert A[0, 0] == pytest.approx(WAVE, rel=1e-14)
    for bad, message in [
        ({"y": 1.0}, "must hold labels"),
        ({"x[0]": 0.0}, "greater than 0"),
        (1.0, "must map labels"),
    ]:
        with pytest.raises((TypeError, ValueError), match=message):
            sb.jacobians(lambda x: -x, [0.0], scale=bad)


def test_many_points_are_each_checked():
    rng = np.random.default_rng(5)
    points = rng.normal(size=(2, 500))

    def f(x):  # analytic on one side only
        return np.array([x[1], np.where(np.real(x[0]) < 0, x[0] * abs(x[0]), x[0] ** 2)])

    with pytest.warns(sb.InexactDerivativeWarning):
        A, _ = sb.jacobians(f, points)
    np.testing.assert_allclose(A[:, 1, 0], 2 * abs(points[0]), rtol=1e-9)
    np.testing.assert_array_equal(A[:, 0], np.tile([0.0, 1.0], (500, 1)))


def test_many_points_agree_with_single_ones():
    rng = np.random.default_rng(6)
    x, u = rng.normal(size=(4, 300)), rng.normal(size=(2, 300))
    A, B = sb.jacobians(sb.CartPole(), x, u)
    for k in range(0, 300, 29):
        alone = sb.jacobians(sb.CartPole(), x[:, k], u[:, k])
        np.testing.assert_allclose(A[k], alone[0], rtol=1e-14, atol=1e-15)
        np.testing.assert_allclose(B[k], alone[1], rtol=1e-14, atol=1e-15)


def test_verdicts_on_fast_waves():
    for force, slope in [
        (lambda x: -np.sin(2 * np.pi * 50 * x), -100 * np.pi),
        (lambda x: np.sin(WAVE * x), WAVE),
    ]:
        report = sb.stability(second_order(force), [0.0, 0.0])
        assert report.verdict == ("unstable" if slope > 0 else "asymptotically stable")
        expected = np.roots([1, 1, -slope])
        np.testing.assert_allclose(
            np.sort_complex(report.eigenvalues), np.sort_complex(expected), rtol=1e-12
        )


def torque_driven_arm(x):
    """Six links; its torques are rounded, and the mass matrix makes much of that."""
    lengths = np.array([0.5, 0.45, 0.35, 0.3, 0.2, 0.15])
    masses = np.array([6.0, 4.0, 3.0, 2.0, 1.5, 0.7])
    angles, rates = np.cumsum(x[:6]), np.cumsum(x[6:])
    carried, links = np.cumsum(masses[::-1])[::-1], np.arange(6)
    weights = carried[np.maximum.outer(links, links)] * np.outer(lengths, lengths)
    apart = np.subtract.outer(angles, angles)
    bias = weights * np.sin(apart) @ rates**2 + carried * 9.8 * lengths * np.cos(angles)
    accelerations = np.linalg.solve(weights * np.cos(apart), -bias)
    return np.concatenate([x[6:], np.diff(accelerations, prepend=0.0)])


def test_noise_that_grows_as_steps_shrink_is_no_kink():
    start = np.array([1.2, -0.6, 0.3, -0.7, -0.3, -0.4, *np.zeros(6)])
    A, _ = sb.jacobians(torque_driven_arm, start)
    # At rest the torques of motion are quadratic in the rates: no slope.
    assert np.abs(A[6:, 6:]).max() < 1e-9
    assert A[:6, 6:] == pytest.approx(np.eye(6), abs=1e-15)


@pytest.mark.parametrize("seed", range(12))
def test_a_product_of_matrices_that_rounds_each_column_its_own_way_has_a_derivative(seed):
    """Machines on a network, at rest: what is left of the powers there is rounding alone."""
    rng = np.random.default_rng(seed)
    n = 4
    Y = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    Y = Y + Y.T
    E, M, delta = rng.uniform(0.9, 1.2, n), rng.uniform(2, 8, n), rng.uniform(-1, 1, n)

    def column(a, like):
        return a.reshape(-1, *[1] * (np.ndim(like) - 1))

    def power(angle):
        V = column(E, angle) * np.exp(1j * np.real(angle))
        return np.real(V * np.conj(Y @ V))

    def rate(x, u, t):
        angle, speed = x[:n], np.real(x[n:])
        given = column(power(delta), angle)
        return np.concatenate([speed, (given - power(angle) - 0.1 * speed) / column(M, angle)])

    machines = sb.System(rate, tuple(f"x{k}" for k in range(2 * n)), ())
    with pytest.warns(sb.InexactDerivativeWarning):
        A, _ = sb.jacobians(machines, np.concatenate([delta, np.zeros(n)]), [])[:2]
    V = E * np.exp(1j * delta)
    flow = np.real(np.diag(1j * V * np.conj(Y @ V)) + V[:, None] * np.conj(Y * (1j * V)))
    expected = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-flow / M[:, None], -0.1 * np.diag(1 / M)]]
    )
    np.testing.assert_allclose(A, expected, atol=1e-9)


def test_a_row_that_saturates_has_a_slope_as_good_as_its_error():
    weights = np.array([[30.0, -4.0], [0.5, 1.0]])
    x0 = np.array([1.0, -1.5])
    start = np.tanh(weights @ x0)

    def network(x):
        return np.tanh(weights @ np.real(x)) - start

    with pytest.warns(sb.InexactDerivativeWarning):
        A, _ = sb.jacobians(network, x0)[:2]
    np.testing.assert_allclose(A, (1 - start**2)[:, None] * weights, atol=1e-9)


def of_columns(f):
    """Return a function of one column as one of many."""
    return lambda z: np.stack([np.array(f(column)) for column in z.T], axis=1)


def test_an_exact_slope_that_noise_hides_stands_with_what_differences_know_of_it():
    J, error, *_ = differentiate(
        of_columns(lambda x: [1e13 * np.sin(x[0]) + x[1]]), np.array([[0.7], [1.0]])
    )
    assert J[0, 0, 1] == 1.0
    assert 1e-4 < error[0, 0, 1] < 0.1  # 1e13 is rounded by 1e-3


def test_a_slope_that_is_rounding_beside_its_row_is_exact():
    J, error, *_ = differentiate(
        of_columns(lambda x: [1e9 * np.sin(x[0]) + 1e-7 * x[1]]), np.array([[0.7], [1.0]])
    )
    assert J[0, 0, 1] == 1e-7 and error[0, 0, 1] == 0.0


def test_points_of_unlike_size_do_not_share_their_noise():
    def wave(z):
        return np.array([[size * math.sin(WAVE * x) for x, size in z.T]])

    sizes = np.array([1e12, 1.0])
    J, error, *_ = differentiate(wave, np.array([[0.0, 0.0], sizes]), [0])
    np.testing.assert_allclose(J[:, 0, 0], WAVE * sizes, rtol=1e-9)
    assert (error[:, 0, 0] <= 1e-9 * WAVE * sizes).all()


def test_a_small_relay_is_a_jump_whatever_the_scale_of_its_variable():
    with pytest.raises(sb.KinkError, match="slope of row 0"):
        differentiate(
            lambda z: 1e-5 * np.sign(np.real(z)), np.zeros((1, 1)), scale=np.full((1, 1), 1e-3)
        )


def test_a_point_among_many_costs_seven_evaluations_where_differences_settle():
    asked = [0]

    def growth(z):
        asked[0] += z.shape[1]
        return np.exp(8 * z)

    z = np.linspace(-1, 1, 500)[None]
    J, error, *_ = differentiate(growth, z, scale=np.ones(z.shape))
    np.testing.assert_allclose(J[:, 0, 0], 8 * np.exp(8 * z[0]), rtol=1e-14)
    assert not error.any() and asked[0] <= 7 * 500
