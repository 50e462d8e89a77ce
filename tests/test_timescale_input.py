"""What time scaling does with arguments that are wrong, and with limits that cannot be met."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PPoly

import statebook as sb

pytest.importorskip("toppra")

LINE = sb.Path.through([[0.0, 1.0], [0.0, 2.0]])


def gravity(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    return qdd + 5 * np.cos(q)


@pytest.mark.parametrize(
    ("waypoints", "options", "error", "message"),
    [
        ([[1.0], [2.0]], {}, ValueError, "at least two waypoints"),
        ([1.0, 2.0], {}, ValueError, r"shape \(dof, N\)"),
        ([[0.0, np.nan]], {}, ValueError, "finite"),
        ([[0.0, 1j]], {}, TypeError, "real"),
        ([["a", "b"]], {}, TypeError, "numbers"),
        ([[0.0, 1.0, 1.0]], {"s": [0, 1, 1]}, ValueError, "s must increase"),
        ([[0.0, 1.0]], {"s": [0, 1, 2]}, ValueError, "shape"),
        ([[0.0, 1.0]], {"kind": "quintic"}, ValueError, "cubic, linear"),
    ],
)
def test_waypoints(waypoints: Any, options: dict, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        sb.Path.through(waypoints, **options)


@pytest.mark.parametrize(
    ("curve", "error", "message"),
    [
        (np.sin, TypeError, "PPoly"),
        (CubicSpline([0, 1, 2], [0, 1, 0]), ValueError, r"\(k, pieces, dof\)"),
        (PPoly(np.array([[[1.0], [1.0]], [[0.0], [5.0]]]), [0, 1, 2]), ValueError, "continuous"),
        (PPoly(np.full((2, 1, 1), np.nan), [0, 1]), ValueError, "finite"),
        (PPoly(np.ones((2, 1, 1)), [1, 0]), ValueError, "increase"),
    ],
)
def test_curves(curve: Any, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        sb.Path(curve)


@pytest.mark.parametrize("width", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("jump", [0.0, 1e-11, 1e-7])
def test_a_jump_of_a_curve_is_one_whatever_the_knots(width: float, jump: float) -> None:
    first, second = [1.0, -3.0, 3.0, 0.0], [0.0, 0.0, 2.0, 1.0 + jump]
    powers = width ** np.arange(3, -1, -1)[:, None]
    curve = PPoly((np.array([first, second]).T / powers)[:, :, None], width * np.arange(3))
    if jump < 1e-9:
        assert sb.Path(curve)(2 * width)[0] == pytest.approx(3)
    else:
        with pytest.raises(ValueError, match="continuous"):
            sb.Path(curve)


@pytest.mark.parametrize("s", [-0.1, 1.1, np.nan, [[0.5]]])
def test_places_off_the_path(s: Any) -> None:
    with pytest.raises(ValueError, match="s must be"):
        LINE(s)


def test_the_path_is_what_scipy_says() -> None:
    points = np.array([[0, 1, 0.5, 2], [1, 0, 0, 3.0]])
    spline = CubicSpline(np.linspace(0, 1, 4), points.T, bc_type="natural")
    path = sb.Path.through(points, bc_type="natural")
    s = np.linspace(0, 1, 50)
    for i in range(4):
        assert path(s, i) == pytest.approx(spline(s, i).T, abs=1e-9)
    assert path(0.3) == pytest.approx(spline(0.3))
    assert np.array_equal(path(np.array([0.0, 1.0])), points[:, [0, -1]])


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"velocity": [[1, -1], [-1, 1]]}, "lower <= upper"),
        ({"velocity": [[0.1, 1], [-1, 1]]}, "lower <= 0 <= upper"),
        ({"acceleration": [[-1, -0.1], [-1, 1]]}, "lower <= 0 <= upper"),
        ({"velocity": 0}, "greater than 0"),
        ({"acceleration": -1}, "greater than 0"),
        ({"velocity": [1, 2, 3]}, r"shape \(2,\) or \(2, 2\)"),
        ({"velocity": np.nan}, "NaN"),
        ({"speed": 0.0}, "speed must be greater than 0"),
        ({"tolerance": 0.0}, "tolerance must be greater than 0"),
        ({"start_speed": -1.0}, "start_speed must be at least 0"),
        ({"acceleration": None}, "nothing bounds the acceleration"),
        ({"acceleration": None, "speed": 1.0}, "nothing bounds the acceleration"),
        ({"acceleration": np.inf}, "nothing bounds the acceleration"),
        ({"torque": 1.0}, "given together"),
        ({"inverse_dynamics": gravity}, "given together"),
        ({"torque": [1, 2, 3], "inverse_dynamics": gravity}, r"shape \(2,\)"),
    ],
)
def test_limits(limits: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sb.time_scale(LINE, **{"acceleration": 1.0, **limits})


def test_a_moving_joint_that_nothing_holds() -> None:
    path = sb.Path.through([[0, 1.0], [0, 0]], kind="linear")
    with pytest.raises(ValueError, match="unbounded at s = 0"):
        sb.time_scale(path, 1.0, [np.inf, 1.0])
    with pytest.raises(ValueError, match="unbounded at s = 0"):
        sb.time_scale(LINE, torque=1.0, inverse_dynamics=lambda q, qd, qdd: 0 * qdd)


@pytest.mark.parametrize("path", [[[0.0, 1.0]], None, 3.0])
def test_not_a_path(path: Any) -> None:
    with pytest.raises(TypeError, match=r"Path\.through"):
        sb.time_scale(path, 1.0, 1.0)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda q, qd, qdd: qdd + 0.1 * np.tanh(qd / 1e-3), "quadratic in qd"),
        (lambda q, qd, qdd: qdd + 0.1 * np.exp(-(qd**2)) * np.sign(qd), "quadratic in qd"),
        (lambda q, qd, qdd: qdd + 0.1 * np.abs(qd) ** 3, "quadratic in qd"),
        (lambda q, qd, qdd: qdd**3, "affine in qdd"),
        (lambda q, qd, qdd: qdd * (1 + qd**2), "affine in qdd"),
        (lambda q, qd, qdd: qdd * np.nan, "finite"),
        (lambda q, qd, qdd: None, "real vector"),
        (lambda q, qd, qdd: qdd[0], "real vector"),
    ],
)
def test_inverse_dynamics_of_another_form(function: Callable, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sb.time_scale(LINE, torque=6.0, inverse_dynamics=function)


def test_inverse_dynamics_that_is_no_function() -> None:
    with pytest.raises(TypeError, match="function"):
        sb.time_scale(LINE, torque=6.0, inverse_dynamics=3.0)


@pytest.mark.parametrize("t", [-0.1, 1e9, np.nan, [[0.0]]])
def test_times_outside_the_motion(t: Any) -> None:
    timed = sb.time_scale(LINE, 1.0, 1.0)
    with pytest.raises(ValueError, match="t must be"):
        timed.position(t)


def test_rounding_at_the_ends_of_the_motion() -> None:
    timed = sb.time_scale(LINE, 1.0, 1.0)
    duration = timed.duration
    beyond = np.array([-0.9e-7, 1 + 0.9e-7]) * duration
    assert np.array_equal(timed.position(beyond), timed.position(np.array([0.0, duration])))
    assert np.array_equal(timed.position(np.float32(duration)), timed.position(duration))
    for t in (-1.1e-7 * duration, (1 + 1.1e-7) * duration):
        with pytest.raises(ValueError, match="t must be"):
            timed.position(t)


# Failure explained


@pytest.mark.parametrize("name", ["start_speed", "end_speed"])
def test_an_end_speed_above_a_velocity_limit(name: str) -> None:
    with pytest.raises(sb.InfeasiblePathError, match=f"{name} = 3") as caught:
        sb.time_scale(LINE, 1.0, 1.0, **{name: 3.0})
    assert caught.value.constraint == "velocity of joint 1, upper limit"
    assert caught.value.s == float(name == "end_speed")
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(LINE, acceleration=1.0, speed=1.0, **{name: 3.0})
    assert caught.value.constraint == "speed"


@pytest.mark.parametrize(
    ("speeds", "constraint"),
    [
        ({"start_speed": 1.01}, "acceleration of joint 1, lower limit"),
        ({"end_speed": 1.01}, "acceleration of joint 1, upper limit"),
    ],
)
def test_end_speeds_out_of_reach(speeds: dict, constraint: str) -> None:
    """Joint 1 moves 2 at s' = 1: v^2/2 = 2 is what an acceleration of 1 takes away."""
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(LINE, 100.0, 1.0, **speeds)
    assert caught.value.constraint == constraint
    assert caught.value.s == pytest.approx(1.0, abs=0.05)
    reachable = {name: 0.9999 for name in speeds}
    assert sb.time_scale(LINE, 100.0, 1.0, **reachable).duration == pytest.approx(2, rel=1e-3)


@pytest.mark.parametrize("seed", range(24))
def test_the_side_of_the_limit_that_end_speeds_break(seed: int) -> None:
    """More speed to lose, or to gain, than the acceleration can: v0^2 - v1^2 > 2 a d."""
    rng = np.random.default_rng(seed)
    distance, a = 10 ** rng.uniform(-2, 2, 2)
    least = np.sqrt(2 * a / distance)
    slow = least * rng.uniform(0.05, 2)
    fast = np.hypot(slow, least) * rng.uniform(1.001, 1.5)
    side, speeds = ("lower", (fast, slow)) if seed % 2 else ("upper", (slow, fast))
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(
            sb.Path.through([[0.0, distance]]),
            acceleration=a,
            start_speed=speeds[0],
            end_speed=speeds[1],
        )
    assert caught.value.constraint == f"acceleration of joint 0, {side} limit"


def test_a_load_too_heavy_to_hold() -> None:
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(LINE, torque=4.5, inverse_dynamics=gravity)
    assert caught.value.constraint == "torque of row 0, upper limit"
    assert caught.value.s == 0  # cos q = 1 there


def test_a_stop_where_the_load_is_too_heavy() -> None:
    """A corner forces a stop where only momentum could carry the load."""
    angles = np.array([-np.pi / 2, 0.0, np.pi / 2])
    through = sb.Path.through([angles], kind="linear")
    assert sb.time_scale(through, torque=4.6, inverse_dynamics=gravity).duration > 0
    corner = sb.Path.through([angles, [0, 0, 1]], kind="linear")
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(
            corner, torque=4.6, inverse_dynamics=lambda q, qd, qdd: gravity(q, qd, qdd)[:1]
        )
    assert caught.value.constraint == "torque of row 0, upper limit"
    assert caught.value.s == pytest.approx(0.5, abs=0.05)


def test_torque_ranges_that_do_not_enclose_zero() -> None:
    timed = sb.time_scale(
        LINE, torque=[[3.0, 5.0]], inverse_dynamics=lambda q, qd, qdd: 4 + qdd[:1]
    )
    assert timed.duration == pytest.approx(2.0, rel=1e-5)
    with pytest.raises(sb.InfeasiblePathError, match="row 0"):
        sb.time_scale(LINE, torque=[[3.0, 5.0]], inverse_dynamics=lambda q, qd, qdd: qdd[:1])


def test_one_sided_rows() -> None:
    rows = [[-np.inf, 0.5], [-0.5, np.inf]]
    timed = sb.time_scale(LINE, 10.0, 1.0, torque=rows, inverse_dynamics=lambda q, qd, qdd: qdd)
    assert timed.audit().worst.use <= 1 + 1e-9
    t = np.linspace(0, timed.duration, 999)
    assert timed.acceleration(t)[0].max() == pytest.approx(0.5, rel=1e-6)
    assert timed.acceleration(t)[1].min() == pytest.approx(-0.5, rel=1e-6)


def test_end_speed_on_a_path_that_ends_without_moving() -> None:
    path = sb.Path.through([[0, 1, 1.0]], kind="linear")
    with pytest.raises(ValueError, match="without moving"):
        sb.time_scale(path, 1.0, 1.0, end_speed=0.1)


number = st.floats(-10, 10, allow_nan=False).map(lambda x: round(x, 2))


@settings(max_examples=60, deadline=None)
@given(
    points=st.integers(1, 3).flatmap(
        lambda dof: st.lists(st.tuples(*[number] * dof), min_size=2, max_size=6)
    ),
    kind=st.sampled_from(["cubic", "linear"]),
    bc_type=st.sampled_from(["not-a-knot", "clamped", "natural"]),
    exponent=st.integers(-6, 6),
)
def test_whatever_the_waypoints(points: list, kind: str, bc_type: str, exponent: int) -> None:
    """Repeated points, straight runs, reversals and all: solved, within limits, on the path."""
    waypoints = 10.0**exponent * np.array(points, dtype=float).T
    path = sb.Path.through(waypoints, kind=kind, bc_type=bc_type)
    v, a = 3.0, 0.7
    if np.ptp(waypoints, axis=1).max() == 0:
        with pytest.raises(ValueError, match="must move"):
            sb.time_scale(path, v, a)
        return
    timed = sb.time_scale(path, v, a)
    assert np.array_equal(timed.position(0.0), waypoints[:, 0])
    assert np.array_equal(timed.position(timed.duration), waypoints[:, -1])
    t = np.linspace(0, timed.duration, 2001)
    assert np.abs(timed.velocity(t)).max() <= v * (1 + 1e-9)
    assert np.abs(timed.acceleration(t)).max() <= a * (1 + 1e-9)
    assert timed.audit().worst.use <= 1 + 1e-12
