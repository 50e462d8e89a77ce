"""Jacobians against SymPy, equilibria and linearization against closed forms."""

from __future__ import annotations

import math
import warnings

import control
import numpy as np
import pytest
import sympy as sp

import statebook as sb
from statebook.derivatives import differentiate

MODELS = [
    sb.Particle(m=2.3, dim=2),
    sb.Oscillator(m=1.7, stiffness=11.0, damping=0.4),
    sb.Pendulum(m=1.3, L=0.6, g=9.7, damping=0.2),
    sb.CartPole(m_cart=1.9, m_pole=0.35, L=0.8, g=9.7),
    sb.DubinsCar(L=2.4),
    sb.PlanarArm(lengths=(0.9, 0.55), masses=(2.1, 0.8), g=9.7),
]


def symbolic_jacobians(rows, x, u):
    """Return functions for A and B of the symbolic rows of f."""
    f = sp.Matrix(rows)
    return [sp.lambdify([*x, *u], f.jacobian(list(z)), "mpmath") for z in (x, u)]


def model_rows(model, x, u):
    """Return f's rows as the model's own code computes them from symbols."""
    ufuncs = {"sin": sp.sin, "cos": sp.cos, "tan": sp.tan}
    with pytest.MonkeyPatch.context() as patch:
        for name, function in ufuncs.items():
            patch.setattr(np, name, function)
        return list(model._derivative(np.array(x), np.array(u)))


@pytest.mark.parametrize("model", MODELS, ids=lambda m: type(m).__name__)
def test_jacobians_agree_with_symbolic_ones(model):
    n, m = len(model.states), len(model.inputs)
    x, u = sp.symbols(f"x:{n}"), sp.symbols(f"u:{m}")
    exact = symbolic_jacobians(model_rows(model, x, u), x, u)
    rng = np.random.default_rng(3)
    points, inputs = rng.normal(size=(n, 20)), rng.normal(size=(m, 20))
    computed = sb.jacobians(model, points, inputs)
    for J, function in zip(computed, exact, strict=True):
        for k in range(20):
            expected = np.array(function(*points[:, k], *inputs[:, k]).tolist(), dtype=float)
            assert np.abs(J[k] - expected).max() <= 1e-13 * max(1, np.abs(expected).max())


def pvtol(x, u, m=4.0, J=0.0475, r=0.25, g=9.8, c=0.05):
    """The vectored-thrust aircraft of Astrom and Murray, Feedback Systems."""
    _, _, angle, vx, vy, spin = x
    sine, cosine = np.sin(angle), np.cos(angle)
    return [
        vx,
        vy,
        spin,
        (-c * vx + u[0] * cosine - u[1] * sine) / m,
        (-c * vy + u[0] * sine + u[1] * cosine) / m - g,
        r * u[0] / J,
    ]


def predator_prey(x, u, r=1.6, d=0.56, b=0.6, k=125.0, a=3.2, c=50.0):
    hares, lynxes = x
    eaten = a * hares * lynxes / (c + hares)
    return [(r + u[0]) * hares * (1 - hares / k) - eaten, b * eaten - d * lynxes]


def two_tanks(x, u, area=0.01, outlet=1e-4, g=9.81):
    flow1, flow2 = (outlet * (2 * g * level) ** 0.5 for level in x)
    return [(u[0] - flow1) / area, (flow1 - flow2) / area]


def double_pendulum(x, u, m=1.0, length=1.0, g=9.81):
    a, b, va, vb = x
    delta = a - b
    sine, cosine = np.sin(delta), np.cos(delta)
    denominator = length * (2 - cosine**2)
    ga, gb = g * np.sin(a), g * np.sin(b)
    return [
        va,
        vb,
        (gb * cosine - sine * (length * va**2 * cosine + length * vb**2) - 2 * ga) / denominator
        + u[0] / m,
        (2 * (ga * cosine - gb + length * va**2 * sine) + length * vb**2 * sine * cosine)
        / denominator,
    ]


@pytest.mark.parametrize(
    ("f", "x0", "u0"),
    [
        (pvtol, [0.3, -1.0, 0.4, 2.0, -0.7, 0.9], [1.5, 39.0]),
        (predator_prey, [20.6, 29.5], [0.1]),
        (two_tanks, [0.4, 0.15], [3e-4]),
        (double_pendulum, [0.7, -1.2, 2.0, -3.0], [0.6]),
    ],
)
def test_jacobians_of_systems_from_the_literature(f, x0, u0):
    x, u = sp.symbols(f"x:{len(x0)}"), sp.symbols(f"u:{len(u0)}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np, "sin", sp.sin)
        patch.setattr(np, "cos", sp.cos)
        rows = f(x, u)
    for J, function in zip(sb.jacobians(f, x0, u0), symbolic_jacobians(rows, x, u), strict=True):
        expected = np.array(function(*x0, *u0).tolist(), dtype=float)
        np.testing.assert_allclose(J, expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())


def in_zeros(x):
    result = np.zeros(2)
    result[0], result[1] = x[1], -9.8 * np.sin(x[0])
    return result


NOT_ANALYTIC = {
    "x |x|": (lambda x: x * abs(x), [1.0], [[2.0]]),
    "x |x| near its bend": (lambda x: x * abs(x), [1e-5], [[2e-5]]),
    "result built in np.zeros": (in_zeros, [0.3, 0.1], [[0, 1], [-9.8 * math.cos(0.3), 0]]),
    "math.sin": (
        lambda x: [x[1], -9.8 * math.sin(x[0])],
        [0.3, 0.1],
        [[0, 1], [-9.8 * math.cos(0.3), 0]],
    ),
    "table": (lambda x: np.interp(x, [0, 1, 2], [0, 1, 4]), [1.7], [[3.0]]),
    "table near a knot": (lambda x: np.interp(x, [0, 1, 2], [0, 1, 4]), [0.9999], [[1.0]]),
    "hypot": (lambda x: [np.hypot(x[0], x[1]), x[0]], [3.0, 4.0], [[0.6, 0.8], [1, 0]]),
    "arctan2": (lambda x: [np.arctan2(x[0], x[1]), x[0]], [3.0, 4.0], [[0.16, -0.12], [1, 0]]),
    "abs": (lambda x: abs(x), [-1e-6], [[-1.0]]),
    "modulus": (lambda x: [abs(x[0] + 1j * x[1]) ** 2, x[0]], [1.0, 2.0], [[2, 4], [1, 0]]),
    "real part": (lambda x: np.real(x) * x, [1.5], [[3.0]]),
}


@pytest.mark.parametrize(("f", "x0", "expected"), NOT_ANALYTIC.values(), ids=NOT_ANALYTIC)
def test_what_is_not_analytic_is_detected_and_still_right(f, x0, expected):
    with pytest.warns(sb.InexactDerivativeWarning, match="estimated error of"):
        A, _ = sb.jacobians(f, x0)
    np.testing.assert_allclose(A, expected, rtol=1e-9, atol=1e-10)


def test_the_warning_points_to_the_caller():
    with pytest.warns(sb.InexactDerivativeWarning) as caught:
        sb.jacobians(lambda x: x * abs(x), [1.0])
    assert [warning.filename for warning in caught] == [__file__]


def test_a_function_of_nothing_has_no_derivatives():
    J, error, *_ = differentiate(lambda z: np.zeros((2, 3)), np.zeros((0, 3)))
    assert J.shape == error.shape == (3, 2, 0)


ANALYTIC_PIECES = {
    "if": (lambda x: [x[0] ** 2 if x[0] > 0 else -x[0]], [0.3], [[0.6]]),
    "clip": (lambda x: np.clip(x, -1, 1), [0.5], [[1.0]]),
    "steep": (lambda x: np.tanh(1e6 * x), [0.0], [[1e6]]),
    "flat": (lambda x: x**3, [0.0], [[0.0]]),
}


@pytest.mark.parametrize(("f", "x0", "expected"), ANALYTIC_PIECES.values(), ids=ANALYTIC_PIECES)
def test_what_is_analytic_at_the_point_is_exact(f, x0, expected):
    np.testing.assert_allclose(sb.jacobians(f, x0)[0], expected, rtol=1e-14, atol=1e-70)


KINKS = {
    "abs": lambda x: abs(x),
    "sum with abs": lambda x: 1e6 * x + abs(x),
    "parabola with abs": lambda x: 30 * x**2 + abs(x),
    "if": lambda x: [x[0] ** 2 if x[0] > 0 else -x[0]],
    "step": lambda x: [1.0 if x[0] > 0 else -1.0],
    "sign": np.sign,
    "maximum": lambda x: np.maximum(x, 0),
    "square root": np.sqrt,
    "root of abs": lambda x: np.sqrt(abs(x)),
    "table at a knot": lambda x: np.interp(x, [-1, 0, 1], [0, 0, 4]),
}


@pytest.mark.parametrize("f", KINKS.values(), ids=KINKS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_kink_at_the_point_is_an_error(f):
    with pytest.raises(sb.KinkError, match="no derivative"):
        sb.jacobians(f, [0.0])


def test_linear_system_of_any_size_has_no_kink():
    rng = np.random.default_rng(0)
    for scale in (1e-9, 1.0, 1e9):
        M = scale * rng.normal(size=(6, 6))
        points = rng.normal(size=(6, 50)) * 10.0 ** rng.uniform(-6, 6, size=(6, 1))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            A, _ = sb.jacobians(lambda x, M=M: M @ x, points)
        assert np.abs(A - M).max() <= 1e-15 * np.abs(M).max()


def test_batches_and_shapes():
    model = sb.CartPole()
    x, u = np.random.default_rng(0).normal(size=(4, 5)), np.array([[1.0], [0.5]])
    A, B = sb.jacobians(model, x, u[:, 0])
    assert A.shape == (5, 4, 4) and B.shape == (5, 4, 2)
    alone = sb.jacobians(model, x[:, 3], u[:, 0])
    np.testing.assert_allclose(A[3], alone[0], rtol=1e-14)
    np.testing.assert_allclose(B[3], alone[1], rtol=1e-14)
    assert sb.jacobians(lambda x: -x, [1.0, 2.0])[1].shape == (2, 0)


def test_equilibria_of_the_pendulum():
    up = sb.find_equilibrium(sb.Pendulum(), [1.2, 0.1])
    np.testing.assert_allclose(up.x, [np.pi / 2, 0], atol=1e-15)
    assert (up.rank, up.unknowns) == (2, 2)
    held = sb.find_equilibrium(sb.Pendulum(m=2.0, L=0.5), [0.4, 0.3], fixed=["theta"])
    assert held.x[0] == 0.4
    assert held.u[0] == pytest.approx(2.0 * 9.8 * 0.5 * math.cos(0.4), rel=1e-14)


def test_equilibrium_that_is_not_isolated_says_so():
    cart = sb.find_equilibrium(sb.CartPole(), [0.3, 1.2, 0.1, 0.1])
    assert (cart.rank, cart.unknowns) == (3, 4)
    assert "not isolated" in repr(cart)


def test_equilibrium_in_discrete_time():
    found = sb.find_equilibrium(sb.as_system(np.cos, [1.0], dt=True), [0.5])
    assert found.x[0] == pytest.approx(0.7390851332151607, rel=1e-15)


@pytest.mark.parametrize(
    ("f", "guess", "exact"),
    [
        # Rows and unknowns of very different size: Newton's steps must finish the search.
        (
            lambda x: [1e8 * (x[0] ** 3 - 2), x[0] * x[1] - 1e-6],
            [1, 1],
            [2 ** (1 / 3), 1e-6 / 2 ** (1 / 3)],
        ),
        (lambda x: x**2 - 1e-20, [1e-9], [1e-10]),
        (lambda x: x**2 - 1e20, [1e9], [1e10]),
        (lambda x: [1 - x[0], 1e4 * (x[1] - x[0] ** 2)], [-1, 1], [1, 1]),  # Rosenbrock's valley
        (lambda x: np.expm1(40 * (x - 0.3)), [0.5], [0.3]),
        (lambda x: np.exp(x) - 1e8, [1], [8 * np.log(10)]),
    ],
)
def test_equilibria_to_the_last_digits(f, guess, exact):
    found = sb.find_equilibrium(f, guess)
    assert found.x == pytest.approx(exact, rel=1e-15)
    assert found.residual < 1e-15  # relative to the terms of f


@pytest.mark.parametrize("small", [1e-6, 1e-9])
def test_a_guess_near_zero_is_no_small_unit(small):
    assert sb.find_equilibrium(sb.Pendulum(), [small, small]).x[0] == pytest.approx(np.pi / 2)
    assert sb.find_equilibrium(lambda x: x**3 + x - 10, [small]).x == pytest.approx([2.0])


def test_no_equilibrium_raises():
    with pytest.raises(sb.EquilibriumNotFoundError, match="residual of 1"):
        sb.find_equilibrium(lambda x: x**2 + 1, [0.3])
    with pytest.raises(sb.EquilibriumNotFoundError):
        sb.find_equilibrium(sb.Pendulum(), [0.3, 0.0], [20.0])  # more than m g L


@pytest.mark.parametrize(
    ("fixed", "message"), [(["angle"], "got 'angle'"), (["theta", "omega", "torque"], "at least")]
)
def test_fixed_labels_are_checked(fixed, message):
    with pytest.raises(TypeError, match=r"write fixed=\['theta'\]"):
        sb.find_equilibrium(sb.Pendulum(), [0.3, 0.0], fixed="theta")
    with pytest.raises(ValueError, match=message):
        sb.find_equilibrium(sb.Pendulum(), [0.3, 0.0], fixed=fixed)


@pytest.mark.parametrize("units", [1.0, 1e6, 1e-6, 1e9, 1e-9])
def test_judgement_does_not_depend_on_units(units):
    def decay(x):
        return np.array([(x[1] * units - x[0]) * 1.0, (x[0] - 2 * x[1] * units) / units])

    sb.linearize(decay, [0.0, 0.0])
    with pytest.raises(sb.NotAnEquilibriumError):
        sb.linearize(decay, [1.0 * units, 0.0])
    with pytest.raises(sb.NotAnEquilibriumError):
        sb.linearize(decay, [1e-3 * units, 1e-3])


def test_terms_that_cancel_leave_their_rounding():
    sb.linearize(lambda x: 1e3 * np.cos(x) - 1e3 - x + (0.1 + 0.2 - 0.3) * 1e2, [0.0])


def test_computed_rest_is_rest():
    sb.linearize(sb.Pendulum(), [np.pi / 2, 2e-13])
    with pytest.raises(sb.NotAnEquilibriumError):
        sb.linearize(sb.Pendulum(), [np.pi / 2, 1e-9])


def test_refusal_names_the_residual():
    with pytest.raises(
        sb.NotAnEquilibriumError, match=r"\|f\(x0, u0\)\| = 9\.75 against a scale of 9\."
    ):
        sb.linearize(sb.Pendulum(), [0.1, 0.0])


def test_library_model_keeps_its_labels():
    sys = sb.linearize(sb.CartPole(), [0.2, np.pi / 2, 0, 0])
    assert sys.name == "CartPole_linearized"
    assert sys.state_labels == ["p", "theta", "v", "omega"]
    assert sys.input_labels == ["force", "torque"]
    expected = [[0, 0, 1, 0], [0, 0, 0, 1], [0, 9.8, 0, 0], [0, 39.2, 0, 0]]
    np.testing.assert_allclose(sys.A, expected, rtol=1e-14, atol=1e-14)


def test_python_control_system_keeps_labels_parameters_outputs_and_timebase():
    def step(t, x, u, params):
        return [x[0] + params["gain"] * u[0] * (1 + x[0])]

    sys = control.nlsys(
        step,
        lambda t, x, u, params: [x[0] ** 2 + 3 * u[0]],
        params={"gain": 0.5},
        states=["level"],
        inputs=["valve"],
        outputs=["reading"],
        dt=0.1,
        name="tank",
    )
    linear = sb.linearize(sys, [2.0], [0.0])
    assert (linear.name, linear.dt) == ("tank_linearized", 0.1)
    assert linear.state_labels == ["level"] and linear.input_labels == ["valve"]
    assert linear.output_labels == ["reading"]
    np.testing.assert_allclose(
        [linear.A, linear.B, linear.C, linear.D], [[[1.0]], [[1.5]], [[4.0]], [[3.0]]], rtol=1e-14
    )


def test_interconnected_system_drops_imaginary_parts_and_is_still_right():
    plant = sb.Pendulum(damping=0.1).to_nlsys()
    motor = control.ss([[-5.0]], [[5.0]], [[1.0]], 0, inputs="command", outputs="torque", name="m")
    sys = control.interconnect(
        [plant, motor], inputs=["command"], outputs=["theta", "omega"], name="loop"
    )
    with pytest.warns(sb.InexactDerivativeWarning):
        linear = sb.linearize(sys, [-np.pi / 2, 0, 0])
    expected = [[0, 1, 0], [-9.8, -0.1, 1], [0, 0, -5]]
    np.testing.assert_allclose(linear.A, expected, rtol=1e-9, atol=1e-9)


def test_system_without_inputs():
    sys = sb.linearize(lambda x: -2 * x, [0.0])
    assert sys.A == -2 and sys.input_labels == ["none"] and not sys.B.any()


@pytest.mark.parametrize(
    ("x0", "u0", "message"),
    [
        ([0, 0, 0], [0], "x0 must have shape"),
        ([0, 0], [0, 0], "u0 must have shape"),
        ([np.nan, 0], [0], "x0 must be finite"),
        ([1j, 0], [0], "x0 must be real"),
    ],
)
def test_bad_points_are_refused(x0, u0, message):
    for function in (sb.jacobians, sb.linearize):
        with pytest.raises((TypeError, ValueError), match=message):
            function(sb.Pendulum(), x0, u0)
    with pytest.raises((TypeError, ValueError), match=message.replace("0", "_guess", 1)):
        sb.find_equilibrium(sb.Pendulum(), x0, u0)  # in the words of its own signature
    with pytest.raises(ValueError, match=r"shape \(2,\), got \(2, 3\)"):
        sb.find_equilibrium(sb.Pendulum(), np.zeros((2, 3)))
