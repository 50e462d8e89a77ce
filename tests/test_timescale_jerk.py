"""Limits on jerk, and rounded corners, against closed forms and dense samples."""

from __future__ import annotations

import doctest
import pathlib
import warnings

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, PPoly

import statebook as sb
from statebook.timescale import jerk_search
from statebook.timescale.jerk_program import Motion

pytest.importorskip("toppra")
pytest.importorskip("clarabel")


def rest_to_rest(d: float, v: float, a: float, j: float) -> float:
    """Time of a point that moves by d from rest to rest with |q'| <= v, |q''| <= a, |q'''| <= j.

    Speed is gained in a time T_a: t1 at the largest jerk, t2 at the largest acceleration, t1.
    """

    def gain(peak: float) -> float:
        return peak / a + a / j if peak * j > a * a else 2 * np.sqrt(peak / j)

    if v * gain(v) <= d:  # there is a phase at the largest speed
        return d / v + gain(v)
    low, high = 0.0, v
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if middle * gain(middle) < d else (low, middle)
    return 2 * gain(low)


@pytest.mark.parametrize(
    ("d", "v", "a", "j"),
    [
        (1.0, 1.0, 2.0, 10.0),  # all seven phases
        (1.0, 10.0, 20.0, 10.0),  # jerk alone
        (3.0, 0.5, 2.0, 10.0),  # far at the largest speed
        (1.0, 1.0, 100.0, 10.0),  # no phase of largest acceleration
        (1e-4, 1.0, 1.0, 1.0),  # small
        (1000.0, 3.0, 0.1, 200.0),  # hardly bounded by jerk
        (2.0, 5.0, 1.0, 3.0),  # no phase at the largest speed
    ],
)
def test_straight_line_takes_the_time_of_the_closed_form(
    d: float, v: float, a: float, j: float
) -> None:
    timed = sb.time_scale(sb.Path.through([[0.0, d]]), v, a, jerk=j)
    expected = rest_to_rest(d, v, a, j)
    assert expected * (1 - 1e-9) <= timed.duration <= expected * 1.002
    assert timed.duration * (1 - timed.gap) <= expected * (1 + 1e-6)


def test_straight_line_in_space_is_one_joint_with_the_least_ratio() -> None:
    step, v, a, j = np.array([0.5, -2.0, 1.0]), [1.0, 2.0, 3.0], [4.0, 3.0, 5.0], [9.0, 30.0, 8.0]
    timed = sb.time_scale(sb.Path.through(np.stack([0 * step, step], axis=1)), v, a, jerk=j)
    scalar = (np.min(np.array(limit) / np.abs(step)) for limit in (v, a, j))
    assert timed.duration == pytest.approx(rest_to_rest(1.0, *scalar), rel=2e-3)


def test_jerk_of_any_size_changes_units_only() -> None:
    rng = np.random.default_rng(4)
    points = rng.normal(size=(2, 4))
    base = sb.time_scale(sb.Path.through(points), 1.0, 3.0, jerk=12.0).duration
    for size, rate in ((1e-5, 1e3), (1e4, 1e-2)):
        path = sb.Path.through(points * size, s=np.linspace(0, 7 * size, 4))
        limits = size * rate * np.array([1.0, 3.0 * rate, 12.0 * rate**2])
        timed = sb.time_scale(path, limits[0], limits[1], jerk=limits[2])
        assert timed.duration * rate == pytest.approx(base, rel=1e-3)


CASES = {
    "cubic": lambda p: sb.Path.through(p),
    "clamped": lambda p: sb.Path.through(p, bc_type="clamped"),
    "linear": lambda p: sb.Path.through(p, kind="linear"),
    "blend": lambda p: sb.Path.through(p, kind="linear", blend=0.2),
    "hermite": lambda p: sb.Path(
        PPoly(*(lambda c: (c.c, c.x))(CubicHermiteSpline(np.arange(p.shape[1]), p.T, p.T[::-1])))
    ),
}


@pytest.mark.parametrize("kind", CASES)
def test_motion_is_within_its_limits_and_the_audit_says_so(kind: str) -> None:
    rng = np.random.default_rng(2)
    path = CASES[kind](rng.normal(size=(3, 4)))
    a, j = np.array([[-4.0, 3.0]] * 3), np.array([[-15.0, 25.0]] * 3)
    timed = sb.time_scale(path, 2.0, a, jerk=j, tolerance=3e-3)
    t = np.linspace(0, timed.duration, 40001)
    jerk = timed.jerk(t)
    used = np.maximum(jerk / j[:, 1:], jerk / j[:, :1]).max(axis=1)
    audited = [use.use for use in timed.audit() if use.limit == "jerk"]
    assert timed.audit().worst.use <= 1
    assert max(audited) > 0.99
    assert used == pytest.approx(audited, abs=2e-3)
    # Accelerations are continuous and 0 at rest: their differences are bounded by the jerk.
    acceleration = timed.acceleration(t)
    slope = np.diff(acceleration, axis=1) / t[1]
    assert np.maximum(slope / j[:, 1:], slope / j[:, :1]).max() <= 1 + 1e-6
    assert np.abs(acceleration[:, [0, -1]]).max() < 1e-4
    # They are the derivatives of what position and velocity return.
    for k, value in enumerate((timed.position(t), timed.velocity(t), acceleration)):
        rate = (timed.velocity, timed.acceleration, timed.jerk)[k]((t[1:] + t[:-1]) / 2)
        error = np.abs(np.diff(value, axis=1) / t[1] - rate)
        assert np.quantile(error, 0.99) < 1e-3 * np.abs(rate).max()


def test_audit_fails_where_the_limit_is_lowered() -> None:
    from dataclasses import replace

    timed = sb.time_scale(sb.Path.through([[0, 1, 0], [0, 1, 2]]), 1.0, 2.0, jerk=[9.0, 8.0])
    lower = replace(timed._profile, upper=0.9 * timed._profile.upper)
    use = {(u.limit, u.row): u.use for u in replace(timed, _profile=lower).audit()}
    assert use["jerk", 0] == pytest.approx(1 / 0.9, rel=1e-2)
    worst = timed.audit().uses[-1]
    assert abs(timed.jerk(worst.time)[1]) == pytest.approx(8.0 * worst.use, rel=1e-2)


def test_slower_divides_jerk_by_the_cube() -> None:
    timed = sb.time_scale(sb.Path.through([[0, 1, 0], [0, 1, 2]]), 1.0, 2.0, jerk=8.0)
    slow = timed.slower(2.0)
    t = np.linspace(0.01, 0.99, 50) * timed.duration
    assert slow.jerk(2 * t) == pytest.approx(timed.jerk(t) / 8, rel=1e-6, abs=1e-9)
    given = sb.time_scale(sb.Path.through([[0.0, 1.0]]), 1.0, 2.0, jerk=8.0, duration=4.0)
    assert given.duration == pytest.approx(4.0)


def test_jerk_that_does_not_bind_costs_next_to_nothing() -> None:
    path = sb.Path.through([[0, 1, 0.5], [0, 1, 2]])
    free = sb.time_scale(path, 1.0, 2.0).duration
    # Each of the few ramps of the acceleration, by up to 4 in no time, takes 4 / 1e4 s.
    assert free < sb.time_scale(path, 1.0, 2.0, jerk=1e4).duration < free * 1.003


def test_a_jump_of_the_curvature_is_a_stop() -> None:
    path = CASES["hermite"](np.array([[0.0, 1.0, 3.0], [0.0, 2.0, 2.0]]))
    assert sb.time_scale(path, 1.0, 2.0).stops == ()
    timed = sb.time_scale(path, 1.0, 2.0, jerk=10.0)
    assert timed.stops == (1.0,)
    at = timed.time_at(1.0)
    assert np.abs(timed.velocity(at)).max() < 1e-9
    assert np.abs(timed.acceleration(at)).max() < 1e-6


def test_speeds_at_the_ends_are_kept() -> None:
    path = sb.Path.through([[0, 1, 0.5], [0, 1, 2]])
    timed = sb.time_scale(path, 2.0, 4.0, jerk=20.0, start_speed=0.3, end_speed=0.2)
    assert timed.velocity(0.0) == pytest.approx(0.3 * path(0.0, 1))
    assert timed.velocity(timed.duration) == pytest.approx(0.2 * path(1.0, 1))
    assert timed.audit().worst.use <= 1 + 1e-8


def test_torque_under_gravity_is_kept_with_a_jerk_limit() -> None:
    def torque(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + 9.0 * np.cos(q)

    timed = sb.time_scale(
        sb.Path.through([[-1.5, 0.2, 1.5]]), torque=9.5, inverse_dynamics=torque, jerk=60.0
    )
    t = np.linspace(0, timed.duration, 5001)
    tau = torque(timed.position(t), timed.velocity(t), timed.acceleration(t))
    assert np.abs(tau).max() <= 9.5 * (1 + 1e-8)
    assert max(u.use for u in timed.audit() if u.limit == "jerk") > 0.98


def test_finer_grids_gain_no_more_than_the_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    path = sb.Path.through(np.random.default_rng(6).normal(size=(2, 5)))
    timed = sb.time_scale(path, 2.0, 5.0, jerk=15.0, tolerance=3e-3)
    monkeypatch.setattr(jerk_search, "_FIRST", 400)
    fine = sb.time_scale(path, 2.0, 5.0, jerk=15.0, tolerance=3e-3)
    assert timed.duration * (1 - timed.gap) <= fine.duration <= timed.duration


@pytest.mark.parametrize(
    ("jerk", "message"),
    [
        (0.0, "jerk must be greater than 0"),
        ([1.0, 2.0], r"jerk must be a number, or have shape \(1,\)"),
        ([(1.0, 2.0)], "lower <= 0 <= upper"),
        ("fast", "jerk must be made of real numbers"),
        (float("nan"), "jerk must not be NaN"),
        ([0.0], "lower < 0 < upper where a joint moves"),
        (lambda s: 1.0, "jerk must be the same all along the path"),
        ([[1.0, 2.0, 3.0]], "jerk must be the same all along the path"),
    ],
)
def test_bad_jerk_limits(jerk: object, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        sb.time_scale(sb.Path.through([[0.0, 1.0, 3.0]]), 1.0, 1.0, jerk=jerk)


def test_speed_that_jerk_cannot_stop_is_refused_by_name() -> None:
    with pytest.raises(sb.InfeasiblePathError, match="jerk of joint 0") as caught:
        sb.time_scale(
            sb.Path.through([[0.0, 1.0]]), 10.0, 1000.0, jerk=1.0, start_speed=9.0, end_speed=0.0
        )
    assert "jerk of joint 0" in caught.value.constraint


# Rounded corners


def distance(points: np.ndarray, polyline: np.ndarray) -> np.ndarray:
    """Distance of points (dof, M) from a polyline through (dof, N)."""
    best = np.full(points.shape[1], np.inf)
    for a, b in zip(polyline.T[:-1], polyline.T[1:], strict=True):
        length = max(float((b - a) @ (b - a)), 1e-300)
        part = np.clip((points.T - a) @ (b - a) / length, 0, 1)
        best = np.minimum(best, np.linalg.norm(points.T - a - part[:, None] * (b - a), axis=1))
    return best


@pytest.mark.parametrize("seed", range(12))
def test_blend_stays_within_its_distance_both_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dof, count = int(rng.integers(2, 7)), int(rng.integers(3, 9))
    points = rng.normal(size=(dof, count)) * 10 ** rng.uniform(-3, 3)
    if seed % 3 == 0:
        points = np.repeat(points, 2, axis=1)  # repeated waypoints
    blend = np.abs(points).max() * 10 ** rng.uniform(-3, 0.3)
    path = sb.Path.through(points, kind="linear", blend=blend)
    at = np.union1d(np.linspace(0, 1, 4001), path.curve.x)
    at = np.union1d(at, (path.curve.x[1:] + path.curve.x[:-1]) / 2)
    curve = path(at)
    assert distance(curve, points).max() <= blend * (1 + 1e-9)
    nearest = [np.linalg.norm(curve - corner[:, None], axis=0).min() for corner in points.T]
    assert max(nearest) <= blend * (1 + 1e-6)
    # p, p' and p'' are continuous, and the ends are those of the polyline.
    for order in range(3):
        left = (
            path._horner(np.arange(len(path.curve.x) - 2), np.diff(path.curve.x)[:-1], order)
            if hasattr(path, "_horner")
            else path(path.curve.x[1:-1] - 1e-12, order)
        )
        right = path(path.curve.x[1:-1], order)
        assert np.abs(left - right).max() <= 1e-6 * np.abs(path(at, order)).max()
    assert path(0.0) == pytest.approx(points[:, 0])
    assert np.array_equal(path(1.0), points[:, -1])


def test_blend_reaches_its_distance_where_there_is_room() -> None:
    # Half a turn less than t: the middle of the blend is 3/8 l sin(t/2) from the corner.
    for turn in (0.2, 1.5, 3.0):
        corner = np.array([[-1.0, 0.0, np.cos(turn)], [0.0, 0.0, np.sin(turn)]])
        path = sb.Path.through(corner, kind="linear", blend=0.01)
        assert np.linalg.norm(path(0.5)) == pytest.approx(0.01, rel=1e-9)


def test_rounded_corners_need_no_stop_and_less_time() -> None:
    points = np.array([[0.0, 1.0, 1.0, 2.0], [0.0, 0.0, 1.0, 1.0]])
    for jerk in (None, 20.0):
        stopping = sb.time_scale(sb.Path.through(points, kind="linear"), 1.0, 2.0, jerk=jerk)
        rounded = sb.time_scale(
            sb.Path.through(points, kind="linear", blend=0.05), 1.0, 2.0, jerk=jerk, tolerance=5e-3
        )
        assert len(stopping.stops) == 2
        assert rounded.stops == ()
        assert rounded.duration < 0.92 * stopping.duration


def test_corners_that_turn_straight_back_stay_stops() -> None:
    path = sb.Path.through([[0.0, 1.0, 0.0, -2.0]], kind="linear", blend=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        timed = sb.time_scale(path, 1.0, 2.0)
    assert timed.stops == pytest.approx((0.25,))
    assert timed.duration == pytest.approx(1.5 + 3.5, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"blend": 0.0}, "blend must be"),
        ({"blend": -1.0}, "blend must be"),
        ({"blend": "wide"}, "blend must be"),
        ({"blend": 0.1, "kind": "cubic"}, 'give it with kind="linear"'),
        ({"blend": 0.1, "s": [0.0, 1.0, 3.0]}, "without s"),
    ],
)
def test_bad_blends(arguments: dict, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        sb.Path.through([[0.0, 1.0, 1.0], [0.0, 0.0, 1.0]], **{"kind": "linear", **arguments})
    with pytest.raises(ValueError, match="must differ"):
        sb.Path.through([[1.0, 1.0]], kind="linear", blend=0.1)


def test_page_on_own_paths_shows_what_happens(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = pathlib.Path(__file__).parents[1] / "book" / "time_your_path.md"
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(page), module_relative=False)
    assert result.attempted > 30 and result.failed == 0
    rows = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    # What a controller gets agrees with itself: velocities are differences of positions.
    step = np.diff(rows[:, 1:8], axis=0) / 0.001
    mean = (rows[1:, 8:15] + rows[:-1, 8:15]) / 2
    assert step == pytest.approx(mean, abs=1e-4)
    assert (tmp_path / "motion.png").stat().st_size > 10_000


def test_the_squared_speed_between_gridpoints_is_the_integral_of_its_rate():
    r, u = np.array([0.0, 1.0, 3.0]), np.array([0.0, 1.0, -0.5])
    x = np.concatenate([[0.5], 0.5 + np.cumsum((u[1:] + u[:-1]) * np.diff(r))])
    at = np.linspace(0.0, 3.0, 13)
    # x' = 2 u, and u is linear in r between gridpoints.
    expected = [
        0.5 + 2 * np.trapezoid(np.interp(s := np.linspace(0, e, 6001), r, u), s) for e in at
    ]
    np.testing.assert_allclose(Motion(r, x, u).at(at), expected, atol=1e-6)
