"""The models against their Lagrangians, energies and conventions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import statebook as sb

MODELS = [
    sb.Particle(m=2.3, dim=1),
    sb.Particle(m=0.7, dim=3),
    sb.Oscillator(m=1.7, stiffness=11.0, damping=0.4),
    sb.Pendulum(m=1.3, L=0.6, g=9.7, damping=0.2),
    sb.CartPole(m_cart=1.9, m_pole=0.35, L=0.8, g=9.7),
    sb.DubinsCar(L=2.4),
    sb.PlanarArm(lengths=(0.9, 0.55), masses=(2.1, 0.8), g=9.7),
]
each_model = pytest.mark.parametrize("model", MODELS, ids=lambda m: type(m).__name__)


def sample(model, seed=0, N=7):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(len(model.states), N)), rng.normal(size=(len(model.inputs), N))


def lagrangian_acceleration(q, lagrangian, forces):
    """Return functions of (q, v, u) for the accelerations, from the Lagrangian alone."""
    t = sp.symbols("t")
    functions = [sp.Function(f"q{i}")(t) for i in range(len(q))]
    velocities = [f.diff(t) for f in functions]
    L = lagrangian(functions, velocities)
    equations = [
        L.diff(v).diff(t) - L.diff(f) - force
        for f, v, force in zip(functions, velocities, forces(velocities), strict=True)
    ]
    accelerations = [f.diff(t, 2) for f in functions]
    solved = sp.solve(equations, accelerations, dict=True)[0]
    plain = {v: name for v, name in zip(velocities, sp.symbols(f"v:{len(q)}"), strict=True)}
    plain_q = {f: name for f, name in zip(functions, sp.symbols(f"p:{len(q)}"), strict=True)}
    expressions = [solved[a].subs(plain).subs(plain_q) for a in accelerations]
    arguments = [*plain_q.values(), *plain.values(), *U]
    return sp.lambdify(arguments, expressions, "numpy")


U = sp.symbols("u1 u2")


def pendulum(model):
    def lagrangian(q, v):
        x, y = model.L * sp.cos(q[0]), model.L * sp.sin(q[0])
        speed2 = x.diff("t") ** 2 + y.diff("t") ** 2
        return model.m * speed2 / 2 - model.m * model.g * y

    return lagrangian_acceleration([0], lagrangian, lambda v: [U[0] - model.damping * v[0]])


def cart_pole(model):
    def lagrangian(q, v):
        x = q[0] + model.L / 2 * sp.cos(q[1])
        y = model.L / 2 * sp.sin(q[1])
        speed2 = x.diff("t") ** 2 + y.diff("t") ** 2
        kinetic = model.m_cart * v[0] ** 2 / 2 + model.m_pole * speed2 / 2
        return kinetic - model.m_pole * model.g * y

    return lagrangian_acceleration([0, 1], lagrangian, lambda v: list(U))


def planar_arm(model):
    (l1, l2), (m1, m2) = model.lengths, model.masses

    def lagrangian(q, v):
        x1, y1 = l1 * sp.cos(q[0]), l1 * sp.sin(q[0])
        x2, y2 = x1 + l2 * sp.cos(q[0] + q[1]), y1 + l2 * sp.sin(q[0] + q[1])
        kinetic = m1 * (x1.diff("t") ** 2 + y1.diff("t") ** 2) / 2
        kinetic += m2 * (x2.diff("t") ** 2 + y2.diff("t") ** 2) / 2
        return kinetic - model.g * (m1 * y1 + m2 * y2)

    return lagrangian_acceleration([0, 1], lagrangian, lambda v: list(U))


@pytest.mark.parametrize(
    ("model", "derive"),
    [(MODELS[3], pendulum), (MODELS[4], cart_pole), (MODELS[6], planar_arm)],
    ids=["pendulum", "cart-pole", "planar arm"],
)
def test_accelerations_follow_from_the_lagrangian(model, derive):
    x, u = sample(model)
    second = u[1] if len(u) == 2 else 0
    expected = derive(model)(*x, u[0], second)
    half = len(model.states) // 2
    np.testing.assert_allclose(model.dynamics(x, u)[half:], np.array(expected), rtol=1e-11)


def test_particle_and_oscillator_equations():
    x, u = sample(MODELS[1])
    np.testing.assert_array_equal(MODELS[1].dynamics(x, u), np.vstack([x[3:], u / 0.7]))
    (p, v), u = sample(MODELS[2])
    expected = [v, (u[0] - 11 * p - 0.4 * v) / 1.7]
    np.testing.assert_allclose(MODELS[2].dynamics([p, v], u), expected, rtol=1e-15)


def test_car_drives_an_exact_arc():
    car, v, phi, t = sb.DubinsCar(L=2.4), 1.7, 0.3, 2.1
    turn = v / 2.4 * np.tan(phi)
    trajectory = sb.simulate(car, [0.4, -1.0, 0.2], [v, phi], times=[0.0, t], rtol=1e-11)
    end = 0.2 + turn * t
    radius = 2.4 / np.tan(phi)
    expected = [
        0.4 + radius * (np.sin(end) - np.sin(0.2)),
        -1.0 - radius * (np.cos(end) - np.cos(0.2)),
        end,
    ]
    np.testing.assert_allclose(trajectory.states[:, -1], expected, rtol=1e-9)


@each_model
def test_batch_gives_what_its_columns_give(model):
    x, u = sample(model)
    batch = model.dynamics(x, u)
    shared = model.dynamics(x, u[:, 0])
    for k in range(x.shape[1]):
        np.testing.assert_array_equal(batch[:, k], model.dynamics(x[:, k], u[:, k]))
        np.testing.assert_array_equal(shared[:, k], model.dynamics(x[:, k], u[:, 0]))


@each_model
def test_complex_arguments_pass_through(model):
    x, u = sample(model)
    h = 1e-20
    direction = np.ones_like(x)
    step = model.dynamics(x + 1j * h * direction, u).imag / h
    central = (model.dynamics(x + 1e-6 * direction, u) - model.dynamics(x - 1e-6, u)) / 2e-6
    np.testing.assert_allclose(step, central, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    "model", [m for m in MODELS if hasattr(m, "energy")], ids=lambda m: type(m).__name__
)
def test_energy_rate_is_the_power_put_in(model):
    x, u = sample(model)
    half = len(model.states) // 2
    h = 1e-30
    rate = model.energy(x + 1j * h * model.dynamics(x, u)).imag / h
    velocity = x[half:]
    power = (u * velocity[: len(u)]).sum(axis=0) - getattr(model, "damping", 0) * velocity[0] ** 2
    np.testing.assert_allclose(rate, power, rtol=1e-11, atol=1e-12)


def test_arm_inverse_dynamics_inverts_dynamics():
    arm = MODELS[6]
    x, u = sample(arm)
    acceleration = arm.dynamics(x, u)[2:]
    np.testing.assert_allclose(arm.inverse_dynamics(x[:2], x[2:], acceleration), u, rtol=1e-10)


def test_pendulum_hangs_below_and_stands_above():
    lean = 1e-3
    assert sb.Pendulum().dynamics([-np.pi / 2 + lean, 0])[1] < 0  # back to the bottom
    assert sb.Pendulum().dynamics([np.pi / 2 + lean, 0])[1] > 0  # away from the top


@each_model
def test_python_control_system_has_the_same_dynamics_and_labels(model):
    sys = model.to_nlsys()
    assert tuple(sys.state_labels) == model.states
    assert tuple(sys.input_labels) == model.inputs
    x, u = sample(model)
    np.testing.assert_array_equal(
        sys.dynamics(0, x[:, 0], u[:, 0]), model.dynamics(x[:, 0], u[:, 0])
    )


@each_model
def test_parameters_are_checked(model):
    for field in dataclasses.fields(model):
        for bad in (-1.0, np.nan, np.inf, "1", None, True, [1.0, 2.0, 3.0]):
            with pytest.raises((ValueError, TypeError), match=field.name):
                dataclasses.replace(model, **{field.name: bad})


@each_model
@given(data=st.data())
def test_any_shape_works_or_is_refused_by_name(model, data):
    n, m = len(model.states), len(model.inputs)
    shape = data.draw(st.lists(st.integers(0, 4), max_size=3).map(tuple), label="x's shape")
    u_shape = data.draw(st.lists(st.integers(0, 4), max_size=3).map(tuple), label="u's shape")
    x, u = np.full(shape, 0.3), np.full(u_shape, 0.2)
    fits = len(shape) in (1, 2) and shape[0] == n and u_shape in ((m,), (m, *shape[1:]))
    if fits:
        assert model.dynamics(x, u).shape == shape
    else:
        with pytest.raises(ValueError, match=r"^[xu] must have shape"):
            model.dynamics(x, u)


@pytest.mark.parametrize("bad", [[np.nan, 0], [np.inf, 0], ["a", "b"], [[1], [2, 3]], None])
def test_states_are_checked(bad):
    with pytest.raises((ValueError, TypeError), match="x must be"):
        sb.Pendulum().dynamics(bad)


@pytest.mark.parametrize("model", [sb.Pendulum, sb.CartPole, sb.PlanarArm])
def test_weight_is_that_of_the_earth_unless_said(model):
    assert model().g == 9.8
