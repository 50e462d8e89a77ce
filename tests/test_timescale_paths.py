"""Paths as people have them: many corners, uneven knots, high degrees, cut motions."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from scipy.interpolate import PPoly, make_interp_spline

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
