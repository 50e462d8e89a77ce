"""Time scaling with friction against closed forms, and with the caller's own function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import statebook as sb
from statebook.timescale.friction import drag_lines, friction_form, reversals

pytest.importorskip("toppra")

LINE = sb.Path.through([[0.0, 1.0]])
ARM = sb.PlanarArm(lengths=(0.5, 0.4), masses=(2.0, 1.0))
LOAD = np.array([40.0, 15.0])


def largest_use(timed: sb.TimedPath, dynamics: Callable[..., Any], bound: Any) -> float:
    """Of torques at many times, the ends among them, where the robot is at rest."""
    t = np.linspace(0, timed.duration, 20_001)
    tau = dynamics(timed.position(t), timed.velocity(t), timed.acceleration(t))
    return float(np.max(np.abs(tau) / np.reshape(bound, (-1, 1))))


def arm_with(
    dry: float = 0.0, drag: float = 0.0, viscous: float = 0.0
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        friction = dry * np.sign(qd) + drag * qd * np.abs(qd) + viscous * qd
        return np.asarray(ARM.inverse_dynamics(q, qd, qdd) + friction)

    return dynamics


@pytest.mark.parametrize("dry", [0.05, 0.3, 0.8])
@pytest.mark.parametrize("mass", [1.0, 1e-3])
def test_coulomb_friction_shifts_the_load(dry: float, mass: float) -> None:
    """It takes from the drive and adds to the brake: rates (1 - dry)/m and (1 + dry)/m."""

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return mass * qdd + dry * np.sign(qd)

    timed = sb.time_scale(LINE, torque=1.0, inverse_dynamics=dynamics)
    up, down = (1 - dry) / mass, (1 + dry) / mass
    peak = np.sqrt(2 / (1 / up + 1 / down))
    exact = peak / up + peak / down
    assert exact < timed.duration < exact * (1 + 1e-3)
    assert 1 - exact / timed.duration <= timed.gap <= 1e-3
    # At rest there is no friction to brake with: the last instant counts too.
    assert largest_use(timed, dynamics, 1.0) <= 1 + 1e-7


def quadratic_drag(k: float) -> float:
    """Least time over 1 with abs(a + k v |v|) <= 1: x' = 2 (1 - k x), then -2 (1 + k x)."""

    def up(s: float) -> float:
        return (1 - np.exp(-2 * k * s)) / k

    def down(s: float) -> float:
        return (np.exp(2 * k * (1 - s)) - 1) / k

    switch = brentq(lambda s: up(s) - down(s), 0, 1)
    first = quad(lambda r: 2 * r / np.sqrt(up(r * r)), 0, np.sqrt(switch))[0]
    return first + quad(lambda r: 2 * r / np.sqrt(down(1 - r * r)), 0, np.sqrt(1 - switch))[0]


@pytest.mark.parametrize("k", [0.1, 2.0, 20.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_friction_that_grows_with_the_square(k: float, sign: int) -> None:
    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + k * qd * np.abs(qd)

    path = sb.Path.through([[0.0, sign]])
    timed = sb.time_scale(path, torque=1.0, inverse_dynamics=dynamics)
    exact = quadratic_drag(k)
    assert exact * (1 - 1e-9) < timed.duration < exact * (1 + 1e-3)
    assert largest_use(timed, dynamics, 1.0) <= 1 + 1e-7


def viscous_drag(d: float, limit: float = 1.0) -> tuple[float, float]:
    """Least time over a distance of 1 with abs(a + d v) <= limit, and the time of full drive."""
    full = limit / d

    def missing(t: float) -> float:
        v = full * (1 - np.exp(-d * t))
        way = full * t - v / d
        return way + v / d - full * np.log(1 + v / full) / d - 1

    t = brentq(missing, 1e-9, 1e6)
    return t + np.log(1 + (1 - np.exp(-d * t))) / d, t


@pytest.mark.parametrize("d", [1e-3, 0.1, 1.0, 5.0])
def test_viscous_friction(d: float) -> None:
    """Up to a terminal velocity, and with its help down again; certified with the function."""

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + d * qd

    timed = sb.time_scale(LINE, torque=1.0, inverse_dynamics=dynamics)
    exact, _ = viscous_drag(d)
    assert exact * (1 - 1e-9) < timed.duration < exact * (1 + 1e-3)
    assert 1 - exact / timed.duration <= timed.gap + 1e-9
    assert largest_use(timed, dynamics, 1.0) <= 1 + 1e-7
    assert timed.audit().worst.use <= 1 + 1e-9


@pytest.mark.parametrize(
    "friction",
    [{"dry": 2.0}, {"drag": 3.0}, {"viscous": 3.0}, {"dry": 1.0, "drag": 1.0, "viscous": 2.0}],
)
@pytest.mark.parametrize("seed", range(2))
def test_an_arm_whose_joints_turn_back(friction: dict, seed: int) -> None:
    """Its own function confirms the torques, and full torque is used."""
    path = sb.Path.through(np.random.default_rng(seed).uniform(-2, 2, (2, 4)))
    assert len(reversals(path))
    dynamics = arm_with(**friction)
    timed = sb.time_scale(path, torque=LOAD, inverse_dynamics=dynamics)
    assert largest_use(timed, dynamics, LOAD) <= 1 + 2e-6
    t = np.linspace(0, timed.duration, 2001)
    motion = timed.position(t), timed.velocity(t), timed.acceleration(t)
    used = np.max(np.abs(dynamics(*motion)) / LOAD[:, None], axis=0)
    assert np.median(used) > 0.995


def test_friction_holds_back_and_lets_down() -> None:
    """A load of 1.5 of the torque comes down where friction carries a part of it."""

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd - 1.2 + 0.5 * np.sign(qd)

    with pytest.raises(sb.InfeasiblePathError) as caught:  # at rest nothing carries it
        sb.time_scale(LINE, torque=1.0, inverse_dynamics=dynamics)
    assert caught.value.constraint == "torque at rest of row 0, lower limit"
    assert caught.value.s == pytest.approx(0, abs=1e-3) or caught.value.s == pytest.approx(
        1, abs=1e-3
    )
    moving = sb.time_scale(
        LINE, torque=1.0, inverse_dynamics=dynamics, start_speed=1.0, end_speed=1.0
    )
    assert largest_use(moving, dynamics, 1.0) <= 1 + 1e-8


def test_dry_friction_where_the_motion_pauses_and_where_joints_rest() -> None:
    """Pauses cost two ramps and no more; a joint that stands still has no friction."""

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + 0.3 * np.sign(qd)

    path = sb.Path.through([[0.0, 1.0, 2.0, 3.0], [1.0, 1.0, 1.0, 1.0]])
    dwell = {1: 0.5, 2: 0.1}
    timed = sb.time_scale(path, torque=1.0, inverse_dynamics=dynamics, dwell=dwell)
    peak = np.sqrt(2 / (1 / 0.7 + 1 / 1.3))
    assert timed.duration == pytest.approx(0.6 + 3 * peak * (1 / 0.7 + 1 / 1.3), rel=1e-3)
    assert largest_use(timed, dynamics, 1.0) <= 1 + 1e-7
    # p' = 0 at both ends: friction is there as soon as the joints move.
    calm = sb.Path.through([[0, 0], [0, 1], [0, 0]], bc_type="clamped")
    timed = sb.time_scale(calm, torque=3.0, inverse_dynamics=dynamics)
    assert largest_use(timed, dynamics, 3.0) <= 1 + 1e-7


def test_a_motion_with_viscous_friction_that_takes_longer() -> None:
    """With less drag to brake with: certified, and the speeds at the ends are kept."""

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + 2.0 * qd

    for speeds in ({}, {"start_speed": 0.4, "end_speed": 0.3}):
        for duration in (3.5, 6.0, 50.0):
            timed = sb.time_scale(
                LINE, torque=1.0, inverse_dynamics=dynamics, duration=duration, **speeds
            )
            assert timed.duration == pytest.approx(duration, rel=1e-12)
            assert largest_use(timed, dynamics, 1.0) <= 1 + 1e-8
            ends = timed.velocity(np.array([0.0, duration]))[0]
            assert ends == pytest.approx(list(speeds.values()) or [0, 0], abs=1e-9)


def test_slowing_down_what_drag_brakes() -> None:
    """Half as fast there is half the drag and a quarter of the acceleration: audited."""

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + 5.0 * qd

    timed = sb.time_scale(LINE, torque=1.0, inverse_dynamics=dynamics)
    for factor in (1.0, 1.001, 1.5, 3.0):
        slower = timed.slower(factor)
        assert largest_use(slower, dynamics, 1.0) <= 1 + 1e-7
        assert slower.duration == pytest.approx(factor * timed.duration)


# Parts


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("dry", [0.0, 1e-3])
@pytest.mark.parametrize("viscous", [0.0, 1e-3])
def test_friction_is_found_at_every_scale(size: float, dry: float, viscous: float) -> None:
    """Beside a quadratic term the others show at low speed only."""
    s = np.linspace(0.1, 0.9, 5)
    q, slope = size * np.array([s, s**2]), size * np.array([np.ones(5), 2 * s])

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd / size + qd**2 / size**2 + dry * np.sign(qd) + viscous * qd / size + 3.0

    assert friction_form(dynamics, q, slope, 0.0) == (dry > 0, viscous > 0)


def test_lines_beside_the_root() -> None:
    """Above v less their distance everywhere; within it over the range of x."""
    x = np.random.default_rng(0).uniform(0, 5, (5, 50))
    x[0, :5] = 0.0
    alpha, beta, distance = drag_lines(x)
    for place in np.linspace(0, 1, 21):
        inside = x.min(axis=0) + place * np.ptp(x, axis=0)
        off = alpha + beta * inside - np.sqrt(inside)
        assert np.all(np.abs(off) <= distance * (1 + 1e-9))
    far = np.linspace(0, 50, 500)[:, None]
    assert np.all(alpha + beta * far - np.sqrt(far) >= -distance * (1 + 1e-9))


def test_places_where_joints_turn_back() -> None:
    path = sb.Path.through([[0.0, 1.0, 0.0], [0.0, 1.0, 2.0]])
    assert reversals(path) == pytest.approx([0.5])
