"""Limits that vary along the path, limits of a tool and of norms, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import PPoly

import statebook as sb
from statebook.timescale import bernstein
from statebook.timescale.curves import fit

pytest.importorskip("toppra")

LINE = sb.Path.through([[0.0, 1.0]])
ANGLE = np.linspace(0, 2 * np.pi, 121)
CIRCLE = sb.Path.through([np.cos(ANGLE), np.sin(ANGLE)], s=ANGLE)
LINKS = (1.0, 0.7)


def dense(timed: sb.TimedPath, count: int = 20_001) -> tuple[np.ndarray, ...]:
    t = np.linspace(0, timed.duration, count)
    s = np.asarray(timed.progress(t)[0])
    return s, timed.position(t), timed.velocity(t), timed.acceleration(t)


def hand(q: np.ndarray) -> np.ndarray:
    """The end of a two-link arm in the plane."""
    first, second = q[0], q[0] + q[1]
    a, b = LINKS
    return np.array(
        [a * np.cos(first) + b * np.cos(second), a * np.sin(first) + b * np.sin(second)]
    )


def hand_motion(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and acceleration of the hand, link by link."""
    velocity, acceleration = np.zeros_like(q), np.zeros_like(q)
    for length, angle, rate, change in zip(
        LINKS, np.cumsum(q, axis=0), np.cumsum(qd, axis=0), np.cumsum(qdd, axis=0), strict=True
    ):
        along, across = np.array([np.cos(angle), np.sin(angle)]), None
        across = np.array([-np.sin(angle), np.cos(angle)])
        velocity += length * rate * across
        acceleration += length * (change * across - rate**2 * along)
    return velocity, acceleration


# Along the path


@pytest.mark.parametrize(
    "velocity",
    [
        lambda s: 1 + s,
        lambda s: [[-9.0, 1 + s]],
        [[[-9.0, -8.0, -7.0], [1.0, 1.5, 2.0]]],
        [[1.0, 1.5, 2.0]],
        [1.0, 1.5, 2.0],
    ],
)
def test_a_velocity_limit_that_grows_with_s(velocity: Any) -> None:
    """Dt = ds/(1 + s) takes ln 2, and two ramps a little more."""
    path = sb.Path.through([[0.0, 0.5, 1.0]])
    timed = sb.time_scale(path, velocity, acceleration=1e5)
    assert np.log(2) < timed.duration < np.log(2) * 1.001 + 3e-5
    s, _, v, _ = dense(timed)
    assert np.max(v[0] / (1 + s)) <= 1 + 1e-9
    assert timed.audit().worst.use == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("place", [0.5, 1 / 3, 0.612345])
def test_a_zone_in_which_the_velocity_is_less(place: float) -> None:
    """The jump is found to rounding: on neither side is the limit broken, and no time is lost."""

    def limit(s: float) -> float:
        return 1.0 if s < place else 0.25

    timed = sb.time_scale(LINE, limit, acceleration=1e6)
    assert timed.duration == pytest.approx(place + (1 - place) / 0.25, rel=1e-3)
    s, _, v, _ = dense(timed)
    away = np.abs(s - place) > 1e-9
    assert np.max(v[0][away] / np.where(s < place, 1.0, 0.25)[away]) <= 1 + 1e-9


def test_an_acceleration_limit_that_grows_with_s() -> None:
    """With x = s'^2: x' = 2 (1 + s) up to 2 s + s^2 = 3/2, then x' = -2 (1 + s)."""
    timed = sb.time_scale(LINE, acceleration=lambda s: 1 + s)
    switch = np.sqrt(2.5) - 1
    up = quad(lambda r: 2 / np.sqrt(2 + r * r), 0, np.sqrt(switch))[0]
    down = quad(lambda r: 2 / np.sqrt(4 - r * r), 0, np.sqrt(1 - switch))[0]
    assert up + down < timed.duration < (up + down) * (1 + timed.gap) + 1e-9
    assert timed.gap < 2e-3
    s, _, _, a = dense(timed)
    assert np.max(np.abs(a[0]) / (1 + s)) <= 1 + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_the_audit_of_limits_that_vary(seed: int) -> None:
    """Its largest use is what dense samples find, of speeds and accelerations of all joints."""
    rng = np.random.default_rng(seed)
    path = sb.Path.through(rng.uniform(-1, 1, (3, 6)))
    phase = rng.uniform(0, 6, (3, 2))

    def bound(s: float) -> np.ndarray:
        wave = 1 + 0.5 * np.sin(7 * s + phase)
        return np.stack([-wave[:, 0], 2 * wave[:, 1]], axis=1)

    knots = rng.uniform(1, 3, (3, 6))
    speed = np.array([2.0, 1.0, 2.0, 0.5, 2.0, 3.0])
    timed = sb.time_scale(path, bound, knots, speed=speed)
    s, _, v, a = dense(timed)
    pairs = np.array([bound(x) for x in s])
    uses = [np.max(np.maximum(v / pairs[..., 1].T, v / pairs[..., 0].T), axis=1)]
    at = np.linspace(0, 1, 6)
    uses.append(np.array([np.max(np.abs(a[i]) / np.interp(s, at, knots[i])) for i in range(3)]))
    uses.append(np.max(np.linalg.norm(v, axis=0) / np.interp(s, at, speed), keepdims=True))
    found = np.array([use.use for use in timed.audit()])
    assert found == pytest.approx(np.concatenate(uses), rel=5e-3)
    assert found.max() <= 1 + 1e-12
    assert all(use.exact for use in timed.audit())


def test_no_bound_in_a_part_of_the_path() -> None:
    """Free to s = 1/2, then at most 1 with an acceleration of 1: it is reached by braking."""
    timed = sb.time_scale(LINE, lambda s: np.inf if s < 0.5 else 0.5, acceleration=1.0)
    # Up to x = 2 s, down to x = 1/4 at 1/2: the peak is x = 5/8; then 0.5, then braking.
    peak = np.sqrt(5 / 8)
    ramps = peak + (peak - 0.5) + 0.5
    assert timed.duration == pytest.approx(ramps + (0.5 - 0.125) / 0.5, rel=1e-3)


def test_torque_limits_that_vary() -> None:
    """Where the load is held with nothing to spare the path is blocked, and the place named."""

    def load(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + 1.0

    timed = sb.time_scale(LINE, torque=lambda s: 2 - 0.5 * s, inverse_dynamics=load)
    s, q, v, a = dense(timed)
    assert np.max(np.abs(load(q, v, a)[0]) / (2 - 0.5 * s)) <= 1 + 1e-8
    weak = [[1.2, 0.5, 0.5, 0.5, 2.0]]
    path = sb.Path.through([np.linspace(0, 1, 5)])
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(path, torque=weak, inverse_dynamics=load)
    assert caught.value.constraint == "torque of row 0, upper limit"
    assert 0 < caught.value.s < 0.9


# Norms


@pytest.mark.parametrize("bound", [0.5, 3.0])
def test_the_norm_of_the_acceleration_on_a_circle(bound: float) -> None:
    """With x = s'^2 and |(x'/2, x)| <= A: x = A sin 2 s up to s = pi/4, then x = A."""
    timed = sb.time_scale(CIRCLE, acceleration_norm=bound)
    ramp = quad(lambda r: 2 * r / np.sqrt(np.sin(2 * r * r)), 0, np.sqrt(np.pi / 4))[0]
    exact = (2 * ramp + 1.5 * np.pi) / np.sqrt(bound)
    assert exact * 0.9999 < timed.duration < exact * 1.002
    acceleration = dense(timed)[3]
    assert np.linalg.norm(acceleration, axis=0).max() <= bound * (1 + 1e-9)
    assert timed.audit().worst.limit == "norm of acceleration"
    assert timed.audit().worst.use == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("dof", [1, 2, 6])
def test_the_norm_of_the_acceleration_on_a_line_in_any_direction(dof: int) -> None:
    step = np.random.default_rng(dof).normal(size=(dof, 1))
    timed = sb.time_scale(sb.Path.through(step * [0.0, 1.0]), acceleration_norm=2.0)
    exact = 2 * np.sqrt(np.linalg.norm(step) / 2)
    assert exact <= timed.duration <= exact * 1.0015


def test_norms_do_not_depend_on_the_axes() -> None:
    points = np.random.default_rng(5).uniform(-1, 1, (3, 5))
    turn = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))[0]
    limits = {"acceleration_norm": 1.0, "speed": lambda s: 0.4 + s}
    times = [sb.time_scale(sb.Path.through(p), **limits).duration for p in (points, turn @ points)]
    assert times[0] == pytest.approx(times[1], rel=2e-3)


# Tool


@pytest.mark.parametrize(
    "limits",
    [
        {"tool_speed": 0.3},
        {"tool_speed": [0.3, 0.2]},
        {"tool_speed": [[-0.3, 0.1], [-0.2, 0.4]]},
        {"tool_acceleration": 0.8},
        {"tool_acceleration": [0.8, 0.4]},
        {"tool_speed": lambda s: 0.2 + 0.3 * s, "tool_acceleration": [1.0, 1.0, 0.5, 1.0, 1.0]},
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_the_hand_of_an_arm(limits: dict, seed: int) -> None:
    path = sb.Path.through(np.random.default_rng(seed).uniform(-2, 2, (2, 5)))
    timed = sb.time_scale(path, 3.0, 30.0, forward_kinematics=hand, **limits)
    s, *motion = dense(timed)
    used = {}
    for name, value in zip(("speed", "acceleration"), hand_motion(*motion), strict=True):
        bound = limits.get(f"tool_{name}")
        if bound is None:
            continue
        shape = np.shape(bound)
        if callable(bound) or shape in ((), (5,)):
            at = np.array([bound(x) for x in s]) if callable(bound) else bound
            at = np.interp(s, np.linspace(0, 1, 5), bound) if shape == (5,) else at
            used[name] = np.max(np.linalg.norm(value, axis=0) / at, keepdims=True)
        else:
            pair = np.array(bound).T if len(shape) == 2 else np.stack([-np.array(bound), bound])
            used[name] = np.max(np.maximum(value.T / pair[1], value.T / pair[0]), axis=0)
        assert used[name].max() <= 1 + 1e-8
        found = [use.use for use in timed.audit() if use.limit == f"tool {name}"]
        assert found == pytest.approx(used[name], rel=1e-3)
    assert max(use.max() for use in used.values()) > 0.998


def test_a_tool_that_is_linear_in_the_joints() -> None:
    """The path of the tool, limited like joints, takes as long."""
    points = np.random.default_rng(7).uniform(-1, 1, (3, 5))
    matrix = np.random.default_rng(8).normal(size=(2, 3))
    bounds = np.array([0.7, 1.1])
    tool = sb.time_scale(
        sb.Path.through(points),
        tool_speed=bounds,
        tool_acceleration=2 * bounds,
        forward_kinematics=lambda q: matrix @ q,
    )
    joints = sb.time_scale(sb.Path.through(matrix @ points), bounds, 2 * bounds)
    assert tool.duration == pytest.approx(joints.duration, rel=2e-3)


class Robot:
    """Forward kinematics in one buffer that is used again and again."""

    def __init__(self) -> None:
        self.place = np.zeros(2)

    def __call__(self, q: np.ndarray) -> np.ndarray:
        if q.shape != (2,):
            raise TypeError("one configuration at a time")
        self.place[:] = hand(np.asarray(q, dtype=float))
        return self.place


@pytest.mark.parametrize("kinematics", [Robot(), lambda q: hand(q).tolist()])
def test_whatever_the_forward_kinematics_returns(kinematics: Callable) -> None:
    path = sb.Path.through(np.random.default_rng(0).uniform(-2, 2, (2, 5)))
    limits = {"tool_speed": 0.3, "tool_acceleration": 2.0}
    plain = sb.time_scale(path, 3.0, 30.0, forward_kinematics=hand, **limits)
    other = sb.time_scale(path, 3.0, 30.0, forward_kinematics=kinematics, **limits)
    assert other.duration == pytest.approx(plain.duration, rel=1e-12)


def test_a_tool_in_single_precision() -> None:
    """Its second derivative is known to less; the limit holds by what it is known to."""
    path = sb.Path.through(np.random.default_rng(0).uniform(-2, 2, (2, 4)))
    with pytest.warns(UserWarning, match="tolerance"):
        timed = sb.time_scale(
            path,
            3.0,
            30.0,
            tool_acceleration=2.0,
            forward_kinematics=lambda q: hand(q).astype(np.float32),
        )
    acceleration = hand_motion(*dense(timed)[1:])[1]
    assert 0.97 < np.linalg.norm(acceleration, axis=0).max() / 2 <= 1


def test_joints_that_move_while_the_tool_rests() -> None:
    """A wrist turns about the tool: what bounds the joints is all there is."""
    timed = sb.time_scale(
        LINE, 1.0, 2.0, tool_speed=0.1, tool_acceleration=0.1, forward_kinematics=lambda q: 0 * q
    )
    assert timed.duration == pytest.approx(1.5, rel=1e-4)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"velocity": [1.0, 2.0, 3.0, 4.0]}, ValueError, r"shape \(2,\) or \(2, 2\)"),
        ({"velocity": [[1, 2, 3], [1, -2, 3]]}, ValueError, "waypoint 1"),
        ({"velocity": lambda s: [1.0] * 3}, ValueError, r"velocity\(s\) must be a number"),
        ({"velocity": lambda s: np.nan}, ValueError, r"velocity\(s\) must not be NaN"),
        ({"velocity": lambda s: 0.5 - s}, ValueError, r"greater than 0.* at s = "),
        ({"velocity": lambda s: None}, TypeError, "real numbers"),
        ({"speed": lambda s: [1.0, 2.0]}, ValueError, r"speed\(s\)"),
        ({"acceleration_norm": -1.0}, ValueError, "acceleration_norm must be greater than 0"),
        ({"tool_speed": 1.0}, ValueError, "given together"),
        ({"forward_kinematics": hand}, ValueError, "given together"),
        ({"tool_speed": 1.0, "forward_kinematics": 3}, TypeError, "function q"),
        ({"tool_speed": 1.0, "forward_kinematics": lambda q: None}, TypeError, "numbers"),
        ({"tool_speed": 1.0, "forward_kinematics": lambda q: q[0]}, ValueError, "shape"),
        ({"tool_speed": 1.0, "forward_kinematics": lambda q: q * np.nan}, ValueError, "finite"),
        ({"tool_speed": [1, 2, 3, 4], "forward_kinematics": hand}, ValueError, "tool_speed"),
        (
            {"tool_acceleration": 1.0, "forward_kinematics": lambda q: np.abs(q - 0.4)},
            ValueError,
            r"smooth.* between s = 0\.25 and 0\.5",
        ),
    ],
)
def test_bad_limits(options: dict, error: type, message: str) -> None:
    path = sb.Path.through([[0.0, 0.6, 1.0], [0.0, 0.3, 1.0]])
    with pytest.raises(error, match=message):
        sb.time_scale(path, **{"acceleration": 1.0, **options})


@pytest.mark.parametrize(
    ("options", "constraint"),
    [
        ({"tool_speed": 1.0, "start_speed": 2.0}, "tool speed"),
        ({"tool_speed": [1.0, 9.0], "end_speed": 2.0}, "tool speed of axis 0, upper limit"),
        ({"tool_acceleration": 0.1, "start_speed": 1.0}, "tool acceleration"),
        (
            {"tool_acceleration": [9.0, 0.1], "start_speed": 1.0},
            "tool acceleration of axis 1, lower limit",
        ),
        ({"acceleration_norm": 0.1, "start_speed": 1.0}, "norm of acceleration"),
        (
            {"velocity": lambda s: 3.0 - 2.5 * s, "end_speed": 1.0},
            "velocity of joint 0, upper limit",
        ),
    ],
)
def test_the_limit_that_stands_in_the_way_is_named(options: dict, constraint: str) -> None:
    path = sb.Path.through([[0.0, 1.0], [0.0, 1.0]])
    if any(name.startswith("tool") for name in options):
        options = {**options, "forward_kinematics": lambda q: q}
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(path, acceleration=50.0, **options)
    assert caught.value.constraint == constraint


# Parts


def test_fitted_derivatives_have_honest_errors() -> None:
    def wave(s: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(9 * s), np.exp(s)], axis=1)

    s = np.linspace(0, 1, 4001)[:-1]
    slope, bend = (
        np.stack([9 * np.cos(9 * s), np.exp(s)]),
        np.stack([-81 * np.sin(9 * s), np.exp(s)]),
    )
    for precision, largest in ((np.float64, 1e-5), (np.float32, 5.0)):
        found = fit(
            lambda s, p=precision: wave(s).astype(p).astype(float),
            np.array([0, 1.0]),
            7,
            1e-7,
            (1, 2),
        )
        for order, exact in enumerate((slope, bend)):
            off = np.abs(found.curve(s, order + 1).T - exact).max(axis=1)
            claimed = found.error[order].max(axis=0)
            assert np.all(off <= claimed)
            assert claimed.max() < largest


def test_the_largest_ratio_of_polynomials() -> None:
    rng = np.random.default_rng(1)
    top, below = rng.normal(size=(6, 40, 3)), rng.uniform(0.2, 2, (6, 40, 3))
    ratio, member, place = bernstein.ratio_maxima(top, below)
    values = bernstein.to_values(5, np.linspace(0, 1, 20_001))
    sampled = np.max(
        [
            bernstein.along(values, top[:, [i]]) / bernstein.along(values, below[:, [i]])
            for i in range(40)
        ],
        axis=(0, 1, 2),
    )
    assert np.all(ratio >= sampled * (1 - 1e-12))
    assert ratio == pytest.approx(sampled, rel=1e-6)
    for row in range(3):
        at = bernstein.to_values(5, place[row : row + 1])[0]
        both = [at @ part[:, member[row], row] for part in (top, below)]
        assert both[0] / both[1] == pytest.approx(ratio[row], rel=1e-9)


def test_limits_hold_on_a_path_made_of_pieces_of_high_degree() -> None:
    path = sb.Path(PPoly(np.random.default_rng(3).normal(size=(12, 1, 2)), [0.0, 1.0]))
    timed = sb.time_scale(
        path, 1.0, acceleration_norm=3.0, tool_speed=0.5, forward_kinematics=np.sin
    )
    _, q, v, a = dense(timed)
    assert np.linalg.norm(a, axis=0).max() <= 3 * (1 + 1e-9)
    assert np.linalg.norm(np.cos(q) * v, axis=0).max() <= 0.5 * (1 + 1e-8)


@pytest.mark.parametrize("ratio", [1e3, 1e6, 1e9])
def test_a_joint_that_turns_back_and_may_be_far_faster_one_way(ratio: float) -> None:
    """Up with 1, down with 1,000 and more, which is never reached: the sum of both in closed form.

    1 m up at v = 1, a = 1000 both ways; down again by a ramp up and one down.
    """
    path = sb.Path.through([[0.0, 1.0, 0.0]], kind="linear")
    timed = sb.time_scale(path, velocity=[[-ratio, 1.0]], acceleration=1e3)
    assert timed.duration == pytest.approx(1 + 1e-3 + 2 / np.sqrt(1e3), rel=1e-3)
    curve = sb.Path.through([[0.0, 1.0, 0.3, 0.8]])
    timed = sb.time_scale(curve, velocity=[[-ratio, 1.0]], acceleration=1e3)
    assert timed.gap <= 1e-3
    q = timed.position(np.linspace(0, timed.duration, 200_001))[0]
    up = np.maximum(np.diff(q), 0.0).sum()
    assert timed.duration > up


def test_a_short_move_beside_steep_pieces_is_made() -> None:
    """p' is 1e6 in a short piece, and s from 0 to 37: 1e-7 is still a movement."""
    s, q = np.array([0.0, 1e-6, 30.0, 37.0]), np.array([0.0, 1.0, 1.0, 1.0 + 1e-7])
    curve = PPoly(np.stack([np.diff(q) / np.diff(s), q[:-1]])[:, :, None], s)
    timed = sb.time_scale(sb.Path(curve), acceleration=1.0)
    assert timed.duration == pytest.approx(2 + 2 * np.sqrt(1e-7), rel=1e-6)
    t = np.linspace(0, timed.duration, 100_001)
    assert np.abs(np.diff(timed.position(t)[0])).max() < 1e-3


def test_a_tool_that_is_held() -> None:
    path = sb.Path.through([[0, 1, 3, 2], [0, 2, 1, 0.5]])

    def held(q: np.ndarray) -> np.ndarray:
        return np.array([0.1, 0.2, 0.3])

    free = sb.time_scale(path, 1.0, 2.0)
    for limit in ({"tool_speed": 1.0}, {"tool_acceleration": 1.0}):
        timed = sb.time_scale(path, 1.0, 2.0, **limit, forward_kinematics=held)
        assert timed.duration == pytest.approx(free.duration, rel=1e-6)


def test_a_torque_without_an_axis_and_a_limit_that_needs_numbers_of_numpy() -> None:
    path = sb.Path.through([[0.0, 1.0, 3.0]])
    vector, number = (
        sb.time_scale(path, torque=5.0, inverse_dynamics=lambda q, qd, qdd, of=of: 2 * qdd[of])
        for of in (slice(0, 1), 0)
    )
    assert number.duration == pytest.approx(vector.duration, rel=1e-9)
    own = sb.time_scale(path, lambda s: np.ones(s.shape), 2.0)
    assert own.duration == pytest.approx(sb.time_scale(path, 1.0, 2.0).duration, rel=1e-3)


def test_infinity_for_one_joint_is_no_arithmetic_with_it() -> None:
    path = sb.Path.through([[0, 1, 3, 2], [0, 2, 1, 0.5]])
    free = [[-np.inf, np.inf], [-2, 2]]
    timed = sb.time_scale(path, velocity=[np.inf, 1], acceleration=free)
    large = sb.time_scale(path, velocity=[1e12, 1], acceleration=[1e12, 2])
    assert timed.duration == pytest.approx(large.duration, rel=1e-3)


def test_bounds_for_another_number_of_waypoints_are_refused():
    path = sb.Path.through(np.array([[0.0, 1.0, 0.5, 2.0, 1.0], [0.0, 0.2, 0.1, 0.5, 1.0]]))
    with pytest.raises(ValueError, match=r"velocity .*shape"):
        sb.time_scale(path, np.ones((2, 3)), 1.0)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_bound_of_zero_in_the_way_is_named_in_any_unit(unit):
    path = sb.Path.through(unit * np.array([[0.0, 1.0, 2.0]]))
    with pytest.raises(sb.InfeasiblePathError, match=r"velocity.* is 0, and near s = "):
        sb.time_scale(path, unit * np.array([[-1.0, 0.0]]), unit)
