"""Equilibria and trim points: found to the last digits, or refused with a reason."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
import scipy.optimize

import statebook as sb
from statebook.invariants import invariants


@pytest.mark.parametrize(
    "system",
    [
        lambda x: [x[1], -x[0] - x[1]],
        control.ss([[0, 1], [-1, -1]], [[0], [1]], np.eye(2), 0),
        sb.Oscillator(damping=1),
        lambda x: [1e-9 * x[1], -1e-3 * x[0] - x[1]],
        lambda x: [math.sinh(x[1]), -x[0] - math.tanh(x[1])],
    ],
)
@pytest.mark.parametrize("guess", [[0.1, 0.0], [1e-3, 1e2], [-50.0, 2e-9]])
def test_the_origin_is_found_from_anywhere(system, guess):
    found = sb.find_equilibrium(system, guess)
    np.testing.assert_allclose(found.x, [0, 0], atol=1e-14)
    assert found.rank == found.unknowns == 2 and not found.degenerate


def test_the_origin_of_random_stable_systems():
    rng = np.random.default_rng(2)
    for _ in range(60):
        n = int(rng.integers(1, 9))
        A = rng.normal(size=(n, n))
        A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.01, 1)) * np.eye(n)
        guess = rng.normal(size=n) * 10 ** rng.uniform(-3, 3)
        found = sb.find_equilibrium(lambda x, A=A: A @ x, guess)
        assert np.abs(found.x).max() <= 1e-12 * np.abs(guess).max()


@pytest.mark.parametrize(
    ("f", "guess", "u", "exact"),
    [
        (lambda x, u: u - np.sqrt(x), [30.0], [1.0], [1.0]),
        (lambda x, u: [u[0] - math.sqrt(x[0])], [30.0], [1.0], [1.0]),
        (lambda x: np.log(x) - 1, [20.0], None, [np.e]),
        (lambda x: [math.log(x[0]) - 1], [20.0], None, [np.e]),
        (lambda x: [1 / math.sqrt(1 - x[0] ** 2) - 2], [0.01], None, [math.sqrt(0.75)]),
        (lambda x: x**1.5 - 8, [900.0], None, [4.0]),
        (lambda x: [math.acos(x[0]) - 1], [-0.99], None, [math.cos(1)]),
    ],
)
def test_steps_that_leave_the_domain_are_shortened(f, guess, u, exact):
    assert sb.find_equilibrium(f, guess, u).x == pytest.approx(exact, rel=1e-14)


DEGENERATE = {
    "cubic": (lambda x: -(x**3), [0.7], 0.0, 1e-12),
    "fifth power": (lambda x: -(x**5), [2.0], 0.0, 1e-12),
    "square": (lambda x: -((x - 1) ** 2), [0.3], 1.0, 1e-12),
    "square from afar": (lambda x: -((x - 1) ** 2), [50.0], 1.0, 1e-12),
    "square in noise": (lambda x: -(x * x - 2 * x + 1 + 1e-16), [0.3], 1.0, 1e-7),
    "cubic in noise": (lambda x: -(x**3 - 3 * x**2 + 3 * x - 1), [1.7], 1.0, 1e-4),
    "versed sine": (lambda x: np.cos(x) - 1, [0.4], 0.0, 1e-7),
}


@pytest.mark.parametrize(("f", "guess", "exact", "atol"), DEGENERATE.values(), ids=DEGENERATE)
@pytest.mark.filterwarnings("ignore::statebook.InexactDerivativeWarning")  # of noise
def test_degenerate_zeros_are_found_and_called_degenerate(f, guess, exact, atol):
    found = sb.find_equilibrium(f, guess)
    assert found.x == pytest.approx([exact], abs=atol)
    assert found.degenerate and found.rank == 0
    assert "degenerate" in repr(found)
    assert sb.stability(f, found.x).verdict not in ("asymptotically stable", "unstable")


def test_degenerate_in_one_direction_of_two():
    found = sb.find_equilibrium(lambda x: [x[1] - x[0], -((x[0] + x[1]) ** 3)], [0.5, 0.2])
    np.testing.assert_allclose(found.x, 0, atol=1e-12)
    assert (found.degenerate, found.rank, found.unknowns) == (True, 1, 2)


@pytest.mark.parametrize(
    "f",
    [
        lambda x: (x - 1) ** 2 + 1e-16,
        lambda x: x**2 + 1e-12,
        lambda x: 1 / (1 + x**2),
        lambda x: 1 + x**4,
        lambda x: np.cosh(x) - 0.999999,
    ],
)
@pytest.mark.parametrize("guess", [0.3, 3.0, 10.0])
def test_what_only_comes_close_is_no_equilibrium(f, guess):
    with pytest.raises(sb.EquilibriumNotFoundError, match="the search ended at"):
        sb.find_equilibrium(f, [guess])


def line(x, u):
    return [x[0] + 1000 * u[0] - 1]


def test_the_nearest_of_many_in_units_of_the_guess():
    found = sb.find_equilibrium(line, [3.0], [5.0], fixed=[])
    np.testing.assert_allclose([*found.x, *found.u], [2.998199280648, -0.001998199281], rtol=1e-9)
    both = sb.find_equilibrium(lambda x: [x[0] + 1000 * x[1] - 1, 0.0], [3.0, 5.0])
    np.testing.assert_allclose(both.x, [2.998199280648, -0.001998199281], rtol=1e-9)
    # In the same unit: along the normal (1, 1000).
    found = sb.find_equilibrium(line, [3.0], [5.0], fixed=[], scale={"x[0]": 1.0, "u[0]": 1.0})
    away = (3 + 5000 - 1) / (1 + 1e6)
    np.testing.assert_allclose([*found.x, *found.u], [3 - away, 5 - 1000 * away], rtol=1e-9)


@pytest.mark.parametrize("guess", [(3.0, 4.0), (0.03, 0.04), (-0.3, 0.4), (6.0, -8.0)])
def test_the_nearest_on_a_circle(guess):
    def circle(x, u):
        return [x[0] ** 2 + u[0] ** 2 - 1]

    scale = {"x[0]": 1.0, "u[0]": 1.0}
    found = sb.find_equilibrium(circle, guess[:1], guess[1:], fixed=[], scale=scale)
    np.testing.assert_allclose([*found.x, *found.u], np.array(guess) / np.hypot(*guess), rtol=1e-8)
    assert found.free == ("x[0]", "u[0]")


def quadrotor(x, u, m=0.5, g=9.81, inertia=(0.02, 0.02, 0.04)):
    """A quadrotor with Euler angles (Beard, Quadrotor Dynamics and Control, 2008)."""
    _, _, _, vx, vy, vz, roll, pitch, yaw, p, q, r = x
    sr, cr, sp, cp, sy, cy = (f(a) for a in (roll, pitch, yaw) for f in (np.sin, np.cos))
    a, b, c = inertia
    return [
        vx,
        vy,
        vz,
        u[0] / m * (cr * sp * cy + sr * sy),
        u[0] / m * (cr * sp * sy - sr * cy),
        u[0] / m * cr * cp - g,
        p + (sr * q + cr * r) * sp / cp,
        cr * q - sr * r,
        (sr * q + cr * r) / cp,
        (u[1] + (b - c) * q * r) / a,
        (u[2] + (c - a) * p * r) / b,
        (u[3] + (a - b) * p * q) / c,
    ]


def test_what_does_not_enter_stays_at_the_guess_exactly():
    guess = [1.0, 2.0, 3.0, 0.1, 0.2, 0.1, 0.05, -0.1, 0.7, 0.1, 0.1, 0.1]
    found = sb.find_equilibrium(quadrotor, guess, [3.0, 0.1, 0.1, 0.1], fixed=[])
    assert found.x[[0, 1, 2, 8]].tolist() == [1.0, 2.0, 3.0, 0.7]
    np.testing.assert_allclose(found.x[[3, 4, 5, 6, 7, 9, 10, 11]], 0, atol=1e-9)
    np.testing.assert_allclose(found.u, [4.905, 0, 0, 0], atol=1e-9)
    assert found.free == ("x[0]", "x[1]", "x[2]", "x[8]")
    assert (found.rank, found.unknowns, found.degenerate) == (12, 16, False)


def attitude(x, u, inertia=(1.0, 2.0, 3.0)):
    """A rigid body, its attitude a quaternion, whose norm is conserved."""
    q0, q1, q2, q3, a, b, c = x
    A, B, C = inertia
    return [
        -0.5 * (q1 * a + q2 * b + q3 * c),
        0.5 * (q0 * a + q2 * c - q3 * b),
        0.5 * (q0 * b - q1 * c + q3 * a),
        0.5 * (q0 * c + q1 * b - q2 * a),
        (u[0] - (C - B) * b * c) / A,
        (u[1] - (A - C) * a * c) / B,
        (u[2] - (B - A) * a * b) / C,
    ]


def test_the_norm_of_a_quaternion_is_kept():
    guess = [0.8, 0.6, 0.0, 0.0, 0.3, -0.2, 0.1]
    found = sb.find_equilibrium(attitude, guess, [0, 0, 0])
    np.testing.assert_allclose(found.x, [0.8, 0.6, 0, 0, 0, 0, 0], atol=1e-9)
    assert np.linalg.norm(found.x[:4]) == pytest.approx(1.0, rel=1e-12)


def test_mass_in_a_reaction_is_kept():
    found = sb.find_equilibrium(lambda x: [x[1] - x[0], x[0] - x[1]], [3.0, 1.0])
    np.testing.assert_allclose(found.x, [2, 2], rtol=1e-12)

    def binding(x, on=2.0, off=1.0):  # A + B <-> C conserves A + C and B + C
        rate = on * x[0] * x[1] - off * x[2]
        return [-rate, -rate, rate]

    found = sb.find_equilibrium(binding, [1.0, 2.0, 0.5])
    assert found.x[0] + found.x[2] == pytest.approx(1.5, rel=1e-12)
    assert found.x[1] + found.x[2] == pytest.approx(2.5, rel=1e-12)
    assert 2 * found.x[0] * found.x[1] == pytest.approx(found.x[2], rel=1e-12)


def test_what_no_equilibrium_keeps_is_not_kept():
    found = sb.find_equilibrium(sb.Particle(dim=1), [2.0, 0.3])
    assert found.x.tolist() == [2.0, 0.0]


def glider(x, u, m=1200.0, g=9.81, area=16.0, rho=1.225):
    """Longitudinal flight: position, height, speed, path angle; thrust and lift coefficient."""
    _, _, v, gamma = x
    pressure = 0.5 * rho * v**2 * area
    drag = pressure * (0.03 + 0.05 * u[1] ** 2)
    return [
        v * np.cos(gamma),
        v * np.sin(gamma),
        (u[0] - drag) / m - g * np.sin(gamma),
        (pressure * u[1] / m - g * np.cos(gamma)) / v,
    ]


def test_trim_of_level_flight_and_of_a_climb():
    level = sb.find_equilibrium(
        glider, [0, 500.0, 60.0, 0.0], [1000.0, 0.3], fixed=[], derivative={"x[0]": 60.0}
    )
    lift = 1200 * 9.81 / (0.5 * 1.225 * 3600 * 16)
    thrust = 0.5 * 1.225 * 3600 * 16 * (0.03 + 0.05 * lift**2)
    np.testing.assert_allclose(level.x, [0, 500, 60, 0], atol=1e-9)
    np.testing.assert_allclose(level.u, [thrust, lift], rtol=1e-12)
    assert level.free == ("x[0]", "x[1]")
    climb = sb.find_equilibrium(
        glider,
        [0, 500.0, 60.0, 0.0],
        [1000.0, 0.3],
        fixed=["x[2]"],
        derivative={"x[0]": None, "x[1]": 3.0},
    )
    assert 60 * math.sin(climb.x[3]) == pytest.approx(3.0)
    np.testing.assert_allclose(glider(climb.x, climb.u)[2:], 0, atol=1e-12)


def test_trim_of_an_output_within_bounds():
    tank = control.nlsys(
        lambda t, x, u, params: [u[0] - np.sqrt(x[0]), np.sqrt(x[0]) - np.sqrt(x[1])],
        lambda t, x, u, params: [x[0] + x[1]],
        states=["upper", "lower"],
        inputs=["flow"],
        outputs=["volume"],
    )
    found = sb.find_equilibrium(tank, [1.0, 3.0], [1.0], fixed=[], outputs={"volume": 8.0})
    np.testing.assert_allclose([*found.x, *found.u], [4, 4, 2], rtol=1e-12)
    bounded = sb.find_equilibrium(tank, [5.0, 3.0], [1.0], fixed=[], bounds={"upper": (4.5, 9.0)})
    assert bounded.x[0] >= 4.5
    assert bounded.u[0] == pytest.approx(math.sqrt(bounded.x[0]))
    with pytest.raises(sb.EquilibriumNotFoundError):
        sb.find_equilibrium(tank, [5.0, 3.0], [1.0], bounds={"upper": (4.5, 9.0)})


def test_a_tolerance_accepts_what_noise_does_not():
    def rough(x):
        return [math.floor(1e6 * (2 - x[0])) / 1e6 + 3e-7]

    with pytest.raises(sb.EquilibriumNotFoundError):
        sb.find_equilibrium(rough, [2.5])
    assert sb.find_equilibrium(rough, [2.5], tolerance=1e-5).x[0] == pytest.approx(2, abs=2e-5)


def test_small_numbers_are_shown():
    assert "4.77e-07" in repr(sb.find_equilibrium(lambda x: x - 4.77e-7, [1.0]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"derivative": {"speed": 1.0}}, "derivative must hold labels among"),
        ({"derivative": 3.0}, "derivative must map labels"),
        ({"derivative": {"theta": "fast"}}, r"derivative\['theta'\] must be a real number"),
        ({"outputs": {"theta": 1.0}}, "none of its own"),
        ({"bounds": {"theta": 1.0}}, r"bounds\['theta'\] must be \(low, high\)"),
        ({"bounds": {"theta": (2.0, 3.0)}}, "guess of theta must lie within"),
        ({"bounds": [(0, 1)]}, "bounds must map labels"),
        ({"scale": {"theta": -1.0}}, "greater than 0"),
        ({"tolerance": -1.0}, "tolerance must be at least 0"),
        ({"t": "now"}, "t must be a real number"),
        ({"fixed": 3}, "fixed must be a sequence of labels"),
    ],
)
def test_bad_arguments_are_refused_before_the_search(arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        sb.find_equilibrium(sb.Pendulum(), [0.3, 0.0], **arguments)


def test_a_guess_outside_the_domain_is_refused():
    with pytest.raises(ValueError, match="finite"):
        with np.errstate(invalid="ignore"):
            sb.find_equilibrium(lambda x: np.sqrt(x) - 1, [-1.0])


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
def test_a_rotation_conserves_the_radius_alone(discrete, size):
    c, s = np.cos(0.7), np.sin(0.7)
    change = np.array([[c - 1, -s], [s, c - 1]] if discrete else [[0.0, -2.0], [2.0, 0.0]])
    found = invariants(lambda x, u: change @ x, size * np.array([0.6, 0.9]), 2, [], discrete)
    assert found.P.shape == (1, 2, 2)
    np.testing.assert_allclose(found.P[0] / found.P[0, 0, 0], np.eye(2), atol=1e-9)
    np.testing.assert_allclose(found.a, 0, atol=1e-9 * size)


@pytest.mark.parametrize(
    ("a", "b", "guess"), [(10.0, 1.0, (7.0, 2.0)), (30.0, 1.0, (3.0, 5.0)), (3.0, 1.0, (1.0, 0.2))]
)
def test_the_nearest_on_an_ellipse(a, b, guess):
    def ellipse(x):
        return [(x[0] / a) ** 2 + (x[1] / b) ** 2 - 1, 0 * x[1]]

    found = sb.find_equilibrium(ellipse, guess, scale={"x[0]": 1.0, "x[1]": 1.0})

    # Lagrange: the nearest point is (a^2 p / (a^2 + l), b^2 q / (b^2 + l)).
    def excess(multiplier):
        return sum((s * g / (s * s + multiplier)) ** 2 for s, g in zip((a, b), guess, strict=True))

    root = scipy.optimize.brentq(lambda m: excess(m) - 1, -b * b + 1e-9, 1e6, xtol=1e-14)
    expected = [s * s * g / (s * s + root) for s, g in zip((a, b), guess, strict=True)]
    np.testing.assert_allclose(found.x, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_what_is_zero_but_for_rounding_is_shown_as_zero(seed):
    rng = np.random.default_rng(seed)
    M, x0 = rng.normal(size=(4, 4)), np.array([0.3, 0.0, -1.2, 0.0])
    found = sb.find_equilibrium(lambda x: M @ np.sin(x) - M @ np.sin(x0), x0 + 0.1)
    assert repr(found).startswith("Equilibrium(x=[0.3 0 -1.2 0], u=[], isolated")


def test_what_is_small_but_no_rounding_stays():
    found = sb.find_equilibrium(lambda x: [x[0] - 1e-19, 1e-9 * (x[1] - 2)], [0.1, 1.0])
    assert found.x.tolist() == [1e-19, 2.0]
