"""Paths as people have them: many corners, uneven knots, high degrees, cut motions."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly, make_interp_spline

import statebook as sb

pytest.importorskip("toppra")


def test_a_polyline_of_many_corners_stops_at_each() -> None:
    points = np.random.default_rng(0).normal(size=(3, 50))
    timed = sb.time_scale(sb.Path.through(points, kind="linear"), 1.0, 2.0)
    way = np.abs(np.diff(points)).max(axis=0)
    expected = np.where(way > 0.5, way + 0.5, 2 * np.sqrt(way / 2)).sum()
    assert len(timed.stops) == 48
    assert expected <= timed.duration < expected * (1 + 1e-3)


def test_a_line_through_waypoints_at_uneven_distances_has_no_stop() -> None:
    timed = sb.time_scale(sb.Path.through([[0, 1, 3, 3.5, 10.0]], kind="linear"), 2.0, 1.0)
    assert timed.stops == ()
    assert timed.duration == pytest.approx(10 / 2 + 2 / 1, rel=1e-3)
    t = np.linspace(0, timed.duration, 999)
    assert np.abs(np.diff(timed.velocity(t)[0])).max() < 1.001 * t[1]
    assert np.all(np.diff(timed.times) > 0)


@pytest.mark.parametrize("degree", [12, 16, 20])
def test_a_polynomial_of_high_degree_along_a_line(degree: int) -> None:
    # s^n + s from 0 to 2 on one joint: a straight line, however it is parametrized.
    powers = np.zeros((degree + 1, 1, 1))
    powers[0] = powers[-2] = 1.0
    timed = sb.time_scale(sb.Path(PPoly(powers, [0.0, 1.0])), 100.0, 1.0)
    assert timed.duration == pytest.approx(2 * np.sqrt(2), rel=1e-3)


def test_a_bspline_is_converted() -> None:
    points = np.random.default_rng(1).normal(size=(6, 2))
    spline = make_interp_spline(np.linspace(0, 1, 6), points)
    assert sb.Path(spline)(0.37) == pytest.approx(spline(0.37), rel=1e-12)


def test_rows_for_columns_are_explained() -> None:
    path = sb.Path.through(np.random.default_rng(2).normal(size=(9, 3)))
    with pytest.raises(ValueError, match=r"waypoints\.T"):
        sb.time_scale(path, [1.0, 1.0, 1.0], 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_left_of_a_motion_can_be_driven_from_its_own_speed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = sb.Path.through(rng.normal(size=(seed % 3 + 1, 5)))
    timed = sb.time_scale(path, 1.0, 1.0)
    for t in rng.uniform(0, timed.duration, 3):
        s, sdot, _ = timed.progress(t)
        knots = path.curve.x
        k = int(np.searchsorted(knots, s, side="right")) - 1
        c = path.curve.c[:, k:].copy()
        for order in range(len(c)):
            c[-1 - order, 0] = path(s, order) / math.factorial(order)
        rest = sb.Path(PPoly(c, np.append(s, knots[k + 1 :])))
        again = sb.time_scale(rest, 1.0, 1.0, start_speed=sdot)
        assert again.duration <= (timed.duration - t) + 1e-3 * timed.duration


def test_the_fastest_start_that_can_brake_is_feasible() -> None:
    path = sb.Path.through([[0.0, 0.7]])
    timed = sb.time_scale(path, 100.0, 13.0, start_speed=np.sqrt(2 * 13 / 0.7))
    assert timed.duration == pytest.approx(np.sqrt(2 * 0.7 / 13), rel=1e-6)


def test_a_smaller_tolerance_is_never_slower_and_the_gap_holds() -> None:
    path = sb.Path.through(np.random.default_rng(1).normal(size=(1, 30)))
    timed = [sb.time_scale(path, 1.0, 1.0, tolerance=t) for t in (1e-1, 1e-2, 1e-3, 1e-4)]
    durations = [one.duration for one in timed]
    assert sorted(durations, reverse=True) == durations
    for one in timed:
        assert one.duration * (1 - one.gap) <= durations[-1]


@pytest.mark.parametrize("slope", [0.1, 0.03, 0.003])
@pytest.mark.parametrize("tolerance", [0.1, 1e-3])
def test_the_gap_is_honest_where_the_slope_of_a_joint_falls(slope: float, tolerance: float) -> None:
    path = sb.Path(CubicHermiteSpline([0, 1], [[0.0], [3.0]], [[1.0], [slope]]))
    timed = sb.time_scale(path, acceleration=1.0, tolerance=tolerance)
    shortest = 2 * np.sqrt(3.0)  # whatever s is: half the way at full push, half at full brake
    assert timed.duration * (1 - timed.gap) <= shortest * (1 + 1e-9) <= timed.duration * (1 + 2e-9)


def test_a_buffer_single_precision_and_storage() -> None:
    buffer = np.zeros(1, dtype=np.float32)

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        buffer[:] = qdd + np.cos(q)
        return buffer

    timed = sb.time_scale(sb.Path.through([[0.0, 1.0]]), torque=3.0, inverse_dynamics=dynamics)
    t = np.linspace(0, timed.duration, 999)
    assert np.abs(timed.acceleration(t) + np.cos(timed.position(t))).max() <= 3 * (1 + 1e-6)
    stored = pickle.loads(pickle.dumps(timed))
    assert stored.duration == timed.duration
    assert repr(stored.audit()) == repr(timed.audit())


def test_bounds_of_zero() -> None:
    up, down = (sb.Path.through([[0.0, d], [1.0, 1.0]]) for d in (1.0, -1.0))
    limits = {"velocity": [[0, 1], [0, 0]], "acceleration": [1, 0]}
    assert sb.time_scale(up, **limits).duration == pytest.approx(2.0, rel=1e-3)
    with pytest.raises(sb.InfeasiblePathError) as caught:
        sb.time_scale(down, **limits)
    assert caught.value.constraint == "velocity of joint 0, lower limit"


def sampled_use(timed: sb.TimedPath, **bounds: Any) -> float:
    """Largest use of bounds (dof, 2), functions of s, in the middle of many short times.

    s is rounded, and steep bounds are given at one of its neighbours.
    """
    t = np.union1d(timed.times, np.linspace(0, timed.duration, 2000))
    t = (t[1:] + t[:-1]) / 2
    s = timed.progress(t)[0]
    worst = 0.0
    for name, bound in bounds.items():
        near = [s, np.nextafter(s, 0.0), np.nextafter(s, 2.0)]
        every = np.array([[bound(one) for one in places] for places in near])
        lower, upper = every[..., 0].min(axis=0).T, every[..., 1].max(axis=0).T
        values = getattr(timed, name)(t)
        worst = max(worst, float(np.maximum(values / lower, values / upper).max()))
    return worst


@pytest.mark.parametrize("least", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("which", ["velocity", "acceleration"])
def test_bounds_that_fall_steeply_between_waypoints(which: str, least: float) -> None:
    path = sb.Path.through([[0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 1.0, 0.5]], kind="cubic")
    steep = np.array([1e3, least, 1e3, 10 * least])
    given = {"velocity": np.full(4, 1e3), "acceleration": np.full(4, 1e3)} | {which: steep}
    both = {name: np.tile([-values, 2 * values], (2, 1, 1)) for name, values in given.items()}
    timed = sb.time_scale(path, **both)
    use = sampled_use(
        timed,
        **{
            name: lambda s, of=values: np.tile(
                np.interp(s, path.waypoint_s, of) * np.array([-1.0, 2.0]), (2, 1)
            )
            for name, values in given.items()
        },
    )
    assert 0.99 < use <= 1 + 1e-9


@pytest.mark.parametrize("near", [1e-7, 1e-10, 3e-12])
def test_bounds_at_waypoints_that_are_nearly_one(near: float) -> None:
    s = np.array([0.0, 0.3, 0.3 + near, 0.7, 1.0])
    path = sb.Path.through([[0.0, 1.0, 1.0, 0.0, 2.0], [0.0, 0.0, 0.0, 1.0, 1.0]], s=s)
    bound = np.array([1.0, 100.0, 1e-3, 0.5, 2.0])
    given = {"velocity": 100.0, "acceleration": np.tile(bound, (2, 1))}
    timed = sb.time_scale(path, **given, tolerance=0.02)

    def acceleration(s: float) -> np.ndarray:
        around = np.interp([s - 1e-15, s, s + 1e-15], path.waypoint_s, bound).max()
        return np.tile([-around, around], (2, 1))

    assert sampled_use(timed, acceleration=acceleration) <= 1 + 1e-6


@pytest.mark.parametrize("shortest", [1e-2, 1e-3, 1e-4])
def test_torques_along_pieces_of_unlike_lengths(shortest: float) -> None:
    rng = np.random.default_rng(3)
    widths = np.array([1.0, shortest, 2.0, 10 * shortest, 1.0])
    points, slopes = rng.normal(size=(6, 2)), rng.normal(size=(6, 2))
    knots = np.append(0.0, np.cumsum(widths))
    path = sb.Path(CubicHermiteSpline(knots, points, slopes))
    inertia, load = np.array([[3.0, 1.0], [1.0, 0.5]]), np.array([[8.0], [2.0]])

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        q, qd, qdd = (np.reshape(part, (2, -1)) for part in (q, qd, qdd))
        torque = inertia @ qdd + np.sin(q[::-1]) * qd**2 + load * np.cos(q)
        return torque[:, 0] if torque.shape[1] == 1 else torque

    limit = np.array([12.0, 4.0])
    timed = sb.time_scale(path, torque=limit, inverse_dynamics=dynamics, tolerance=0.02)
    t = np.linspace(0, timed.duration, 4001)
    used = np.abs(dynamics(timed.position(t), timed.velocity(t), timed.acceleration(t)))
    assert 0.99 < (used / limit[:, None]).max() <= 1 + 1e-6


@pytest.mark.parametrize("smaller", [1e-2, 1e-4, 1e-6])
def test_jerk_beside_bounds_of_which_one_is_far_smaller(smaller: float) -> None:
    path = sb.Path.through([[0.0, 1.0], [0.0, 0.3]])
    acceleration = [(-smaller, 10.0), (-2.0, 3.0)]
    timed = sb.time_scale(path, 5.0, acceleration, jerk=20.0, tolerance=0.1)
    use = sampled_use(timed, acceleration=lambda s: np.array(acceleration))
    assert 0.99 < use <= 1 + 1e-9


def test_a_piece_that_stands_still_takes_no_time_and_is_no_corner():
    ends = [(1, np.zeros(2)), (2, np.zeros(2))]
    points = np.array([[0.0, 1.0, 1.5, 1.2], [0.0, 0.5, 1.5, 2.2]]).T
    spline = CubicSpline(np.arange(4.0), points, bc_type=ends)
    still = np.concatenate([np.zeros((4, 1, 2)), spline.c], axis=1)
    alone = sb.time_scale(sb.Path(PPoly(spline.c, spline.x)), 1.0, 1.0)
    after = sb.time_scale(sb.Path(PPoly(still, np.append(-1.0, spline.x))), 1.0, 1.0)
    assert after.duration == pytest.approx(alone.duration, rel=1e-9)
