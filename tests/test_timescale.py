"""Time scaling against closed forms, dense samples and changes of units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly

import statebook as sb
from statebook.timescale import scaling
from statebook.timescale.profile import audit

pytest.importorskip("toppra")


def excess(values: np.ndarray, bounds: np.ndarray) -> float:
    """Largest relative violation of bounds (dof, 2) by values (dof, M)."""
    return float(np.maximum(values / bounds[:, 1:], values / bounds[:, :1]).max() - 1)


def random_case(seed: int) -> tuple[sb.Path, np.ndarray, np.ndarray]:
    """A path of 1-7 joints, of any size, with asymmetric limits now and then."""
    rng = np.random.default_rng(seed)
    dof, count = seed % 7 + 1, int(rng.integers(2, 9))
    size, rate = 10 ** rng.uniform(-4, 3), 10 ** rng.uniform(-2, 2)
    s = np.cumsum(rng.uniform(0.3, 1, count)) * 10 ** rng.uniform(-3, 3)
    points = size * rng.normal(size=(count, dof))
    if seed % 4 == 3:
        curve = CubicHermiteSpline(s, points, rng.normal(size=points.shape) * size / np.ptp(s))
    else:
        curve = CubicSpline(s, points, bc_type=("not-a-knot", "clamped", "natural")[seed % 3])
    upper = rng.uniform(0.5, 2, (2, dof))
    lower = -rng.uniform(0.5, 2, (2, dof)) if seed % 2 else -upper
    v = size * rate * 10 ** rng.uniform(-1, 1) * np.stack([lower[0], upper[0]], axis=1)
    a = size * rate**2 * np.stack([lower[1], upper[1]], axis=1)
    return sb.Path(PPoly(curve.c, curve.x)), v, a


# Closed forms


def test_rest_to_rest_takes_two_root_d_over_a() -> None:
    timed = sb.time_scale(sb.Path.through([[1.0, 4.0]]), acceleration=0.7)
    assert timed.duration == pytest.approx(2 * np.sqrt(3 / 0.7), rel=1e-6)
    # Half-way at half-time, at the peak velocity.
    assert timed.position(timed.duration / 2)[0] == pytest.approx(2.5, abs=1e-4)
    assert timed.velocity(timed.duration / 2)[0] == pytest.approx(np.sqrt(3 * 0.7), rel=1e-3)


@pytest.mark.parametrize(
    ("d", "v", "up", "down"), [(10, 3, 4, 4), (-10, 3, 4, 4), (5, 2, 3, 0.5), (1e-6, 1e-3, 7, 2)]
)
def test_trapezoid(d: float, v: float, up: float, down: float) -> None:
    bounds = [(-down, up)] if d > 0 else [(-up, down)]
    timed = sb.time_scale(sb.Path.through([[0.0, d]]), v, bounds, tolerance=1e-4)
    expected = abs(d) / v + v / (2 * up) + v / (2 * down)
    assert timed.duration == pytest.approx(expected, rel=1e-4)
    assert timed.duration >= expected * (1 - 1e-12)


def test_triangle_with_asymmetric_acceleration() -> None:
    timed = sb.time_scale(sb.Path.through([[0.0, 2.0]]), acceleration=[(-1.0, 3.0)])
    peak = np.sqrt(2 * 2 / (1 / 3 + 1))
    assert timed.duration == pytest.approx(peak / 3 + peak, rel=1e-4)


def test_given_end_speeds() -> None:
    # d = v0 t + a t^2/2 first, then braking to v1: peak^2 = (2 a d + v0^2 + v1^2)/2.
    timed = sb.time_scale(
        sb.Path.through([[0.0, 4.0]], s=[0.0, 2.0]), acceleration=1.5, start_speed=0.5, end_speed=1
    )
    peak = np.sqrt((2 * 1.5 * 4 + 1 + 4) / 2)
    assert timed.duration == pytest.approx((2 * peak - 1 - 2) / 1.5, rel=1e-5)
    assert timed.velocity(0.0)[0] == pytest.approx(1.0, rel=1e-12)
    assert timed.velocity(timed.duration)[0] == pytest.approx(2.0, rel=1e-9)
    assert timed.progress(0.0)[1] == pytest.approx(0.5, rel=1e-12)


def circle(radius: float, turns: float = 1.0) -> sb.Path:
    """A circle by a fine cubic spline, s the angle."""
    angle = np.linspace(0, 2 * np.pi * turns, int(80 * turns) + 1)
    return sb.Path.through(radius * np.array([np.cos(angle), np.sin(angle)]), s=angle)


def test_circle_at_the_speed_of_its_centripetal_acceleration() -> None:
    # A friction circle of radius a as an inner polygon of 16 sides: s' = sqrt(a / R) within it.
    radius, a, sides = 2.0, 3.0, 16
    angle = 2 * np.pi * np.arange(sides) / sides
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    timed = sb.time_scale(
        circle(radius),
        torque=np.stack([np.full(sides, -np.inf), np.full(sides, a * np.cos(np.pi / sides))], 1),
        inverse_dynamics=lambda q, qd, qdd: normals @ qdd,
    )
    speed = np.hypot(*timed.velocity(np.linspace(0, timed.duration, 2001)))
    assert np.sqrt(a * radius * np.cos(np.pi / sides)) * 0.99 < speed.max() < np.sqrt(a * radius)
    friction = np.hypot(*timed.acceleration(np.linspace(0, timed.duration, 2001)))
    assert friction.max() <= a * (1 + 1e-8)


def test_speed_limit_bounds_the_norm() -> None:
    timed = sb.time_scale(circle(1.0, 2.0), acceleration=100.0, speed=0.8)
    speed = np.hypot(*timed.velocity(np.linspace(0, timed.duration, 20001)))
    assert speed.max() == pytest.approx(0.8, rel=1e-6)
    assert speed.max() <= 0.8 * (1 + 1e-12)
    ramps = 0.8 / 100
    assert timed.duration == pytest.approx(4 * np.pi / 0.8 + ramps, rel=1e-3)


def test_maximum_speed_on_a_circle() -> None:
    # Both joints bounded by a: |u tangent - x normal| <= a per axis; at 45 degrees both bind.
    timed = sb.time_scale(circle(1.0), velocity=5.0, acceleration=2.0)
    curve = timed.maximum_speed(np.array([0.0, np.pi / 4, np.pi]))
    # The spline's curvature is the circle's to 0.3 % at its ends.
    assert curve == pytest.approx([np.sqrt(2), np.sqrt(2 * np.sqrt(2)), np.sqrt(2)], rel=4e-3)


def test_maximum_speed_where_bounds_differ_with_the_direction() -> None:
    for waypoints, expected in (([0.0, 1.0], 5.0), ([0.0, -1.0], 2.0)):
        path = sb.Path.through([waypoints], kind="linear")
        timed = sb.time_scale(path, velocity=[(-2.0, 5.0)], acceleration=1.0)
        assert timed.maximum_speed(np.array([0.2, 0.7])) == pytest.approx([expected] * 2)


def test_clamped_spline_between_two_points_is_a_straight_line() -> None:
    path = sb.Path.through([[0, 0], [0, 1], [0, 0]], bc_type="clamped")
    timed = sb.time_scale(path, 100.0, 100.0)
    assert timed.duration == pytest.approx(0.2, rel=1e-3)
    assert timed.duration > 0.2
    assert timed.sdot[0] > 0  # p' = 0 there: s' is free, up to p'' s'^2 = 100 with p'' = 6
    assert timed.controllable[1, [0, -1]] == pytest.approx(np.sqrt([100 / 6] * 2), rel=1e-6)
    assert np.abs(timed.velocity(0.0)).max() == 0


# Torque


PENDULUM = (1.3, 0.7, 9.81)


def pendulum_torque(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    m, length, g = PENDULUM
    return m * length**2 * qdd + m * g * length * np.cos(q)


@pytest.mark.parametrize("load", [0.5, 0.98, 1.11])
@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_pendulum_driven_up_under_gravity(load: float, kind: str) -> None:
    """The static load reaches this part of the limit; above 1 momentum carries it through."""
    m, length, g = PENDULUM
    torque = m * g * length / load
    angles = [-np.pi / 2, -0.6, 0.5, np.pi / 2]
    path = sb.Path.through([angles], kind=kind, s=angles)
    timed = sb.time_scale(path, torque=torque, inverse_dynamics=pendulum_torque)
    t = np.linspace(0, timed.duration, 100_001)
    used = pendulum_torque(timed.position(t), timed.velocity(t), timed.acceleration(t))
    assert np.abs(used).max() <= torque * (1 + 1e-8)
    # Work and energy: m L^2 q'^2/2 + m g L sin q = work.
    q, v, tau = timed.position(t)[0], timed.velocity(t)[0], used[0]
    work = np.concatenate([[0], np.cumsum((tau[1:] * v[1:] + tau[:-1] * v[:-1]) / 2) * t[1]])
    energy = m * length**2 * v**2 / 2 + m * g * length * (np.sin(q) + 1)
    assert np.abs(work - energy).max() < 1e-3 * m * g * length
    if load > 1:
        with pytest.raises(ValueError, match="rest"):
            timed.slower(1.5)
        assert timed.to_trajectory(0.013).times[-1] == timed.duration  # its last step is shorter


def test_the_lowest_speed_that_carries_a_pendulum_over_its_load() -> None:
    """Up to the angle from which full torque lifts it, the work that is missing on the way."""
    m, length, g = PENDULUM
    load = m * g * length
    torque = load / 1.11
    angles = np.array([-np.pi / 2, np.pi / 2])
    path = sb.Path.through([angles], s=angles)
    timed = sb.time_scale(path, torque=torque, inverse_dynamics=pendulum_torque, tolerance=1e-5)
    easy = np.arccos(1 / 1.11)
    missing = load * (np.sin(easy) - np.sin(timed.s)) - torque * (easy - timed.s)
    square = np.where(timed.s < easy, 2 * np.maximum(missing, 0) / (m * length**2), 0)
    assert square.max() > 1
    assert timed.controllable[0] ** 2 == pytest.approx(square, abs=0.15)  # on intervals of pi/48
    assert np.all(timed.controllable[0] <= timed.sdot)


def test_a_short_motion_under_a_load_cannot_be_slowed_down_either() -> None:
    angles = [-1.5, -0.6, 0.5, 1.5]
    timed = sb.time_scale(
        sb.Path.through([angles], kind="linear", s=angles),
        torque=900.0,
        inverse_dynamics=lambda q, qd, qdd: qdd + 1000 * np.cos(q),
    )
    assert timed.duration < 1
    with pytest.raises(ValueError, match="rest"):
        timed.slower(1.5)


def test_pendulum_time_by_quadrature() -> None:
    """Full torque up to the switch, then full braking: the energy gives q'(q)."""
    m, length, g = PENDULUM
    torque = 2.0 * m * g * length
    path = sb.Path.through([[-np.pi / 2, np.pi / 2]])
    timed = sb.time_scale(path, torque=torque, inverse_dynamics=pendulum_torque)
    q = -np.pi / 2 + np.pi * (1 - np.cos(np.linspace(0, np.pi, 400_002)[1:-1])) / 2
    up = torque * (q + np.pi / 2) - m * g * length * (np.sin(q) + 1)
    down = torque * (np.pi / 2 - q) + m * g * length * (1 - np.sin(q))
    speed = np.sqrt(2 * np.minimum(up, down) / (m * length**2))
    angle = np.linspace(0, np.pi, 400_002)[1:-1]
    integrand = np.pi / 2 * np.sin(angle) / speed
    expected = np.sum((integrand[1:] + integrand[:-1]) / 2) * (angle[1] - angle[0])
    assert timed.duration == pytest.approx(expected, rel=5e-4)


def test_pendulum_threshold_torque_by_bisection() -> None:
    """Without swinging back: the largest (1 - cos x)/x, at x = tan(x/2) = 2.3311, is 0.72461."""
    m, length, g = PENDULUM
    path = sb.Path.through([[-np.pi / 2, np.pi / 2]])
    low, high = 0.6, 0.9
    while high - low > 1e-3:
        middle = (low + high) / 2
        try:
            sb.time_scale(path, torque=middle * m * g * length, inverse_dynamics=pendulum_torque)
            high = middle
        except sb.InfeasiblePathError as error:
            low = middle
            assert error.constraint == "torque of row 0, upper limit"
            assert 0.4 < error.s < 0.8  # where the load is heavy
    assert high == pytest.approx(0.724611, abs=2e-3)


@pytest.mark.parametrize(("part", "angle"), [(0.3, 0.619567), (0.5, 1.109144), (0.6, 1.425720)])
def test_refusal_is_where_the_motor_has_given_no_energy_any_more(part: float, angle: float) -> None:
    """That is the smallest x > 0 with 1 - cos x = part x, an angle from hanging."""
    m, length, g = PENDULUM
    assert 1 - np.cos(angle) == pytest.approx(part * angle, rel=1e-5)
    with pytest.raises(sb.InfeasiblePathError, match="torque of row 0, upper") as caught:
        sb.time_scale(
            sb.Path.through([[-np.pi / 2, np.pi / 2]]),
            torque=part * m * g * length,
            inverse_dynamics=pendulum_torque,
        )
    assert caught.value.s == pytest.approx(angle / np.pi, abs=0.01)


@pytest.mark.parametrize("seed", range(6))
def test_arm_torques(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = sb.PlanarArm(lengths=(0.5, 0.4), masses=(2.0, 1.0), g=9.81 * (seed % 2))
    path = sb.Path.through(rng.uniform(-2, 2, (2, 4)))
    limit = np.array([40.0, 15.0])
    timed = sb.time_scale(path, torque=limit, inverse_dynamics=arm.inverse_dynamics)
    t = np.linspace(0, timed.duration, 50_001)
    motion = timed.position(t), timed.velocity(t), timed.acceleration(t)
    used = np.abs(arm.inverse_dynamics(*motion)) / limit[:, None]
    assert used.max() <= 1 + 1e-6
    assert np.median(used.max(axis=0)) > 0.999  # bang-bang: one limit is always reached
    audit = timed.audit()
    assert [u.use for u in audit] == pytest.approx(used.max(axis=1), abs=2e-3)
    assert not audit.worst.exact


def test_inverse_dynamics_for_single_vectors_only() -> None:
    arm = sb.PlanarArm()

    def single(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return arm.inverse_dynamics([float(q[0]), float(q[1])], qd, qdd)

    path = sb.Path.through([[0.0, 1.0], [0.5, -0.5]])
    durations = [
        sb.time_scale(path, torque=80.0, inverse_dynamics=f).duration
        for f in (single, arm.inverse_dynamics)
    ]
    assert durations[0] == pytest.approx(durations[1], rel=1e-9)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3])
@pytest.mark.parametrize("height", [0.8, 0.3, -0.8])
@pytest.mark.parametrize("width", [2e-3, 2e-2, 0.1])
def test_a_torque_that_changes_fast(width: float, height: float, tolerance: float) -> None:
    """Full torque up to the switch, full braking after it; a narrow load on the way up."""

    def load(q: np.ndarray) -> np.ndarray:
        return height * np.exp(-(((q - 0.237) / width) ** 2))

    timed = sb.time_scale(
        sb.Path.through([[0.0, 1.0]]),
        torque=1.0,
        inverse_dynamics=lambda q, qd, qdd: qdd + load(q),
        tolerance=tolerance,
    )
    t = np.linspace(0, timed.duration, 100_001)
    assert np.abs(timed.acceleration(t) + load(timed.position(t))).max() <= 1 + 1e-6
    s = (1 - np.cos(np.linspace(0, np.pi, 200_002))) / 2
    work = np.concatenate([[0], np.cumsum(np.diff(s) * (load(s[1:]) + load(s[:-1])) / 2)])
    speed = np.sqrt(2 * np.minimum(s - work, (1 - s) + (work[-1] - work)))[1:-1]
    fastest = np.sum(np.sin(np.linspace(0, np.pi, 200_002))[1:-1] / speed) * np.pi / 200_001 / 2
    assert fastest * (1 - 1e-5) < timed.duration < fastest * (1 + tolerance)


@pytest.mark.parametrize("place", [0.1, 0.4])
@pytest.mark.parametrize("height", [0.3, -0.8])
def test_a_torque_that_jumps_is_named_so(place: float, height: float) -> None:
    with pytest.raises(sb.InfeasiblePathError, match="jumps there") as caught:
        sb.time_scale(
            sb.Path.through([[0.0, 1.0]]),
            torque=1.0,
            inverse_dynamics=lambda q, qd, qdd: qdd + height * (q > place),
        )
    assert caught.value.s == pytest.approx(place, abs=1e-5)


@pytest.mark.parametrize("rate", [2e3, 1e4])
def test_a_ripple_finer_than_the_grid_is_kept_within_the_limit(rate: float) -> None:
    """Too small for the choice of the grid, and too large to be left to rounding."""
    timed = sb.time_scale(
        sb.Path.through([[0.0, 1.0]]),
        torque=1.0,
        inverse_dynamics=lambda q, qd, qdd: qdd + 1e-4 * np.sin(rate * q),
    )
    assert timed.audit().worst.use <= 1 + 1e-9
    assert 2 - 4e-4 < timed.duration < 2.002


def test_what_the_audit_refuses_is_mended_or_not_returned(monkeypatch: Any) -> None:
    path = sb.Path.through([[0.0, 1.0]])
    timed = sb.time_scale(path, torque=1.0, inverse_dynamics=lambda q, qd, qdd: qdd + 0.1 * q)
    hasty = timed._profile.slower(0.9)
    limits = timed._limits
    assert audit(hasty, limits).worst.use == pytest.approx(1 / 0.81, rel=0.1)
    mended = scaling._within_limits(limits, hasty)
    assert audit(mended, limits).worst.use <= 1 + 1e-9
    assert mended.duration == pytest.approx(timed.duration, rel=1e-3)
    path, v, a = random_case(4)
    timed = sb.time_scale(path, v, a)
    slowed = scaling._within_limits(timed._limits, timed._profile.slower(0.9))
    assert 1 - 1e-11 < audit(slowed, timed._limits).worst.use <= 1
    monkeypatch.setattr(scaling, "PASSES", 0)
    with pytest.raises(sb.InfeasiblePathError, match="could not be kept") as caught:
        scaling._within_limits(limits, hasty)
    assert caught.value.constraint == "torque of row 0"
    assert caught.value.s == audit(hasty, limits).worst.s


# Limits hold


@pytest.mark.parametrize("seed", range(21))
def test_limits_hold_at_every_instant(seed: int) -> None:
    path, v, a = random_case(seed)
    timed = sb.time_scale(path, v, a)
    t = np.linspace(0, timed.duration, 20_001)
    velocity, acceleration, position = timed.velocity(t), timed.acceleration(t), timed.position(t)
    assert excess(velocity, v) <= 1e-9
    assert excess(acceleration, a) <= 1e-9
    # The mean acceleration between two instants cannot exceed the limits either.
    rounding = 1e-15 * np.abs(velocity).max() / t[1] / np.abs(a).min()
    assert excess(np.diff(velocity) / t[1], a) <= 1e-9 + rounding
    size = np.abs(position).max()
    s, sdot, _ = timed.progress(t)
    assert np.abs(position - path(s)).max() <= 1e-12 * size
    assert np.all(np.diff(s) > 0)
    assert np.abs(np.diff(s) / t[1] - (sdot[1:] + sdot[:-1]) / 2).max() < 5e-2 * sdot.max()
    assert np.array_equal(position[:, 0], path(path.s_start))
    assert np.array_equal(position[:, -1], path(path.s_end))
    assert np.abs(velocity[:, [0, -1]]).max() <= 1e-9 * np.abs(velocity).max()
    audit = timed.audit()
    assert audit.worst.use <= 1 + 1e-12
    dense = {
        "velocity": np.maximum(velocity / v[:, 1:], velocity / v[:, :1]).max(axis=1),
        "acceleration": np.maximum(acceleration / a[:, 1:], acceleration / a[:, :1]).max(axis=1),
    }
    for use in audit:
        # Never less than the samples; and reached where it says.
        assert use.use >= dense[use.limit][use.row] * (1 - 1e-9)
        near = use.time + 1e-5 * timed.duration * np.linspace(-1, 1, 401)
        near = near[(near >= 0) & (near <= timed.duration)]
        values = getattr(timed, use.limit)(near)[use.row]
        low, high = (v if use.limit == "velocity" else a)[use.row]
        assert np.maximum(values / high, values / low).max() == pytest.approx(use.use, rel=1e-2)
        assert path.s_start <= use.s <= path.s_end


@pytest.mark.parametrize("seed", [0, 5, 9, 11])
def test_the_gap_is_within_the_tolerance(seed: int) -> None:
    path, v, a = random_case(seed)
    coarse, fine = (sb.time_scale(path, v, a, tolerance=t).duration for t in (1e-3, 3e-5))
    assert 0 <= coarse / fine - 1 < 1e-3


def test_some_limit_is_reached_at_almost_every_instant() -> None:
    path, v, a = random_case(2)
    timed = sb.time_scale(path, v, a, tolerance=1e-4)
    t = np.linspace(0, timed.duration, 5001)
    use = [
        np.maximum(values / bounds[:, 1:], values / bounds[:, :1]).max(axis=0)
        for values, bounds in ((timed.velocity(t), v), (timed.acceleration(t), a))
    ]
    assert np.quantile(np.max(use, axis=0), 0.05) > 0.99


def test_the_profile_stays_in_the_controllable_set_under_the_maximum_speed() -> None:
    path, v, a = random_case(8)
    timed = sb.time_scale(path, v, a)
    low, high = timed.controllable
    assert np.all(low <= timed.sdot) and np.all(timed.sdot <= high * (1 + 1e-9))
    assert np.all(high[:-1] <= timed.maximum_speed(timed.s[:-1]) * (1 + 1e-6))
    assert timed.times[-1] == timed.duration and timed.s[0] == path.s_start


# Changes of units


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_durations_do_not_depend_on_units(seed: int) -> None:
    path, v, a = random_case(seed)
    curve, duration = path.curve, sb.time_scale(path, v, a).duration
    for k in (1e3, 1e-3):
        powers = np.arange(len(curve.c))[::-1, None, None]
        stretched = sb.Path(PPoly(curve.c / k**powers, curve.x * k))
        assert sb.time_scale(stretched, v, a).duration == pytest.approx(duration, rel=1e-6)
    for k in (1e-4, 1e4):
        faster = sb.time_scale(path, v * k, a * k**2)
        assert faster.duration * k == pytest.approx(duration, rel=1e-6)
        larger = sb.time_scale(sb.Path(PPoly(curve.c * k, curve.x)), v * k, a * k)
        assert larger.duration == pytest.approx(duration, rel=1e-6)


def test_reversed_path_takes_as_long() -> None:
    path = sb.Path.through([[0, 1, 3, 2.0], [0, -1, 0, 1.0]])
    back = sb.Path.through([[2.0, 3, 1, 0], [1.0, 0, -1, 0]])
    durations = [sb.time_scale(p, 1.0, 2.0, tolerance=1e-4).duration for p in (path, back)]
    assert durations[0] == pytest.approx(durations[1], rel=2e-4)


# What the result can do


def test_slower_divides_velocity_and_acceleration() -> None:
    timed = sb.time_scale(sb.Path.through([[0, 1, 0.5], [0, 1, 2]]), 1.0, 2.0)
    slow = timed.slower(2.0)
    t = np.linspace(0, timed.duration, 101)[:-1]
    assert slow.duration == pytest.approx(2 * timed.duration, rel=1e-12)
    assert slow.position(2 * t) == pytest.approx(timed.position(t), abs=1e-9)
    assert slow.velocity(2 * t) == pytest.approx(timed.velocity(t) / 2, abs=1e-9)
    assert slow.audit().worst.use == pytest.approx(0.5, rel=1e-6)
    with pytest.raises(ValueError, match="at least 1"):
        timed.slower(0.5)


def test_the_audit_finds_a_motion_made_too_fast() -> None:
    timed = sb.time_scale(sb.Path.through([[0, 1, 0.5], [0, 1, 2]]), 1.0, 2.0)
    object.__setattr__(timed, "_profile", timed._profile.slower(0.9))
    uses = {(u.limit, u.row): u.use for u in timed.audit()}
    assert uses["velocity", 1] == pytest.approx(1 / 0.9, rel=1e-6)
    assert timed.audit().worst.use == pytest.approx(1 / 0.81, rel=1e-6)


def test_to_trajectory_ends_on_a_multiple_of_dt() -> None:
    timed = sb.time_scale(sb.Path.through([[0, 1, 0.5], [0, 1, 2]]), 1.0, 2.0)
    trajectory = timed.to_trajectory(0.01)
    steps = len(trajectory.times) - 1
    assert steps * 0.01 - timed.duration < 0.01
    assert trajectory.times[-1] == pytest.approx(steps * 0.01)
    assert trajectory.states[:, 0] == pytest.approx([0, 0, 0, 0], abs=1e-12)
    assert trajectory.states[:, -1] == pytest.approx([0.5, 2, 0, 0], abs=1e-12)
    assert trajectory.controls is not None and np.abs(trajectory.controls).max() <= 2.0
    # The states move as their velocities and accelerations say.
    q, v = trajectory.states[:2], trajectory.states[2:]
    assert np.abs(np.diff(q) - 0.005 * (v[:, 1:] + v[:, :-1])).max() < 0.01**2 * 2


def test_to_trajectory_keeps_given_end_speeds() -> None:
    timed = sb.time_scale(sb.Path.through([[0.0, 1.0]]), 1.0, 1.0, start_speed=0.5)
    trajectory = timed.to_trajectory(0.1)
    assert trajectory.states[1, 0] == pytest.approx(0.5)
    assert trajectory.times[:-1] == pytest.approx(0.1 * np.arange(17))
    assert trajectory.times[-1] == timed.duration == pytest.approx(1.625)
    assert trajectory.states[:, -1] == pytest.approx([1, 0], abs=1e-12)


def test_a_corner_is_a_stop_and_a_pause_takes_no_time() -> None:
    corner = sb.time_scale(sb.Path.through([[0, 1, 1], [0, 0, 1]], kind="linear"), 10.0, 1.0)
    assert corner.duration == pytest.approx(4.0, rel=1e-6) and corner.stops == (0.5,)
    assert "stops at s = 0.5" in repr(corner)
    assert np.abs(corner.velocity(2.0)).max() < 1e-6
    pause = sb.time_scale(sb.Path.through([[0, 1, 1, 2]], kind="linear"), 10.0, 1.0)
    assert pause.duration == pytest.approx(4.0, rel=1e-6)
    assert pause.skipped == ((pytest.approx(1 / 3), pytest.approx(2 / 3)),)
    t = np.linspace(0, pause.duration, 1001)
    assert np.abs(np.diff(pause.position(t))).max() < 1e-2
    straight = sb.time_scale(sb.Path.through([[0, 1, 2]], kind="linear"), 10.0, 1.0)
    assert straight.stops == ()
    assert straight.duration == pytest.approx(2 * np.sqrt(2), rel=1e-6)


def test_a_reversal_does_not_cost_a_full_stop() -> None:
    # Out and back on one joint: the acceleration is kept through the turn.
    timed = sb.time_scale(sb.Path.through([[0.0, 1.0, 0.0]]), acceleration=1.0, tolerance=1e-4)
    # Up, braking through the turn and on, then braking to rest: 1 + sqrt(2)... by symmetry
    # each half is d/2 up to sqrt(a d), then down: total 4 sqrt(d / a).
    assert timed.duration == pytest.approx(4.0, rel=1e-4)
    assert timed.stops == ()


def test_a_path_that_does_not_move_is_refused() -> None:
    with pytest.raises(ValueError, match="must move"):
        sb.time_scale(sb.Path.through([[0.3, 0.3, 0.3], [1, 1, 1]]), 1.0, 1.0)


def test_quintic_path() -> None:
    # The minimum-jerk polynomial in s along a straight line: the same line, the same time.
    curve = PPoly(np.array([6.0, -15, 10, 0, 0, 0]).reshape(6, 1, 1), [0, 1])
    timed = sb.time_scale(sb.Path(curve), 10.0, 1.0)
    assert 2 <= timed.duration < 2.002
    assert np.abs(timed.acceleration(np.linspace(0, timed.duration, 9999))).max() <= 1 + 1e-9


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1e6])
def test_tiny_and_huge_paths(size: float) -> None:
    timed = sb.time_scale(sb.Path.through(size * np.array([[0, 1, 0.5, 3.0]])), 1.0, 1.0)
    assert 0 < timed.duration < np.inf
    assert timed.audit().worst.use == pytest.approx(1.0, rel=1e-6)
