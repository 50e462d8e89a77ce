"""Ends, pauses and given times of motions, and joints on a circle."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import statebook as sb
from statebook.timescale.ends import Pauses

pytest.importorskip("toppra")

LINE = sb.Path.through([[0.0, 4.0]], s=[0.0, 2.0])
BEND = sb.Path.through([[0, 1, 2, 1.0], [0, 1, 0, 1]])
ENDS = {"acceleration": 1.5, "start_speed": 0.5, "end_speed": 1.0}


# A given duration


@pytest.mark.parametrize("factor", [1.0, 1.0001, 1.1, 3.0, 100.0, 1e6])
@pytest.mark.parametrize("options", [ENDS, {"acceleration": 1.5}])
def test_a_given_duration_keeps_the_ends(factor: float, options: dict) -> None:
    """p' = 2: the joint begins with 1 and ends with 2, however slow it is in between."""
    shortest = sb.time_scale(LINE, **options).duration
    timed = sb.time_scale(LINE, duration=factor * shortest, **options)
    assert timed.duration == pytest.approx(factor * shortest, rel=1e-12)
    ends = timed.velocity(np.array([0.0, timed.duration]))[0]
    assert ends == pytest.approx([1.0, 2.0] if "start_speed" in options else [0.0, 0.0])
    assert timed.position(timed.duration)[0] == 4.0
    t = np.linspace(0, timed.duration, 5001)
    assert np.abs(timed.acceleration(t)).max() <= 1.5 * (1 + 1e-12)
    assert timed.audit().worst.use <= 1 + 1e-12
    assert 0 <= timed.gap <= 1 - (1 - 1e-3) / factor + 1e-9


def test_from_rest_to_rest_a_given_duration_is_the_motion_slowed_down() -> None:
    fast = sb.time_scale(BEND, 2.0, 3.0)
    slow = sb.time_scale(BEND, 2.0, 3.0, duration=2 * fast.duration)
    t = np.linspace(0, fast.duration, 101)
    assert slow.position(2 * t) == pytest.approx(fast.position(t), abs=1e-9)


def test_durations_out_of_reach() -> None:
    shortest = sb.time_scale(LINE, **ENDS).duration
    with pytest.raises(sb.InfeasiblePathError, match=r"at least 1\.887") as caught:
        sb.time_scale(LINE, duration=0.99 * shortest, **ENDS)
    assert caught.value.constraint == "duration"
    # Up a slope that only momentum climbs there is a slowest motion too.
    hill: dict[str, Any] = {
        "torque": 1.0,
        "inverse_dynamics": lambda q, qd, qdd: qdd + 1.2,
        "start_speed": 4.0,
    }
    path = sb.Path.through([[0.0, 1.0]])
    fast = sb.time_scale(path, end_speed=3.7, **hill)
    with pytest.raises(sb.InfeasiblePathError, match="at most") as caught:
        sb.time_scale(path, end_speed=3.7, duration=2 * fast.duration, **hill)
    assert caught.value.constraint == "duration"
    # x = s'^2 falls from 16 by 0.4 to 4.4: a fall to 13.69 leaves some room, not much.
    timed = sb.time_scale(path, end_speed=3.7, duration=1.01 * fast.duration, **hill)
    assert timed.audit().worst.use <= 1 + 1e-8


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, np.inf])
def test_durations_that_are_none(duration: float) -> None:
    with pytest.raises(ValueError, match="duration must be"):
        sb.time_scale(LINE, acceleration=1.0, duration=duration)


# Velocities at the ends


def test_velocities_of_the_joints_at_the_ends() -> None:
    first, last = 0.2 * BEND(0.0, 1), 0.1 * BEND(1.0, 1)
    timed = sb.time_scale(BEND, 9.0, 9.0, start_velocity=first, end_velocity=last)
    assert timed.velocity(0.0) == pytest.approx(first)
    assert timed.velocity(timed.duration) == pytest.approx(last)
    same = sb.time_scale(BEND, 9.0, 9.0, start_speed=0.2, end_speed=0.1)
    assert timed.duration == pytest.approx(same.duration, rel=1e-9)
    still = sb.time_scale(BEND, 9.0, 9.0, start_velocity=[0.0, 0.0])
    assert still.velocity(0.0) == pytest.approx([0, 0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start_velocity": [1.0, 0.0]}, "start_velocity must point forward along the path"),
        ({"end_velocity": -0.1 * BEND(1.0, 1)}, "end_velocity must point forward"),
        ({"end_velocity": [1.0, 1.0, 1.0]}, r"shape \(2,\)"),
        ({"start_velocity": [np.nan, 1.0]}, "finite"),
        ({"start_velocity": BEND(0.0, 1), "start_speed": 1.0}, "not both"),
    ],
)
def test_velocities_that_are_none(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sb.time_scale(BEND, 9.0, 9.0, **options)


def test_a_velocity_where_the_path_begins_at_rest() -> None:
    path = sb.Path.through([[0, 0], [0, 1], [0, 0]], bc_type="clamped")
    with pytest.raises(ValueError, match="point forward"):
        sb.time_scale(path, 9.0, 9.0, start_velocity=[0.0, 1.0, 0.0])


# Times of places


def test_the_time_of_a_place_inverts_the_progress() -> None:
    timed = sb.time_scale(BEND, 2.0, 3.0)
    s = np.linspace(0, 1, 1001)
    assert timed.progress(timed.time_at(s))[0] == pytest.approx(s, abs=1e-9)
    assert timed.time_at(0.0) == 0
    assert timed.time_at(1.0) == pytest.approx(timed.duration, rel=1e-14)
    assert timed.time_at(0.4) == pytest.approx(timed.time_at(np.array([0.4]))[0])
    for wrong in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match="s must be"):
            timed.time_at(wrong)


def test_arrivals_in_closed_form() -> None:
    """Triangles of speed over 2 with a = 1, apart by a waypoint that is repeated."""
    path = sb.Path.through([[0.0, 1.0, 2.0, 2.0, 4.0]], kind="linear")
    timed = sb.time_scale(path, acceleration=1.0)
    root = np.sqrt(2)
    assert timed.arrival_times == pytest.approx(root * np.array([0, 1, 2, 2, 4]), abs=3e-3)
    assert timed.position(timed.arrival_times)[0] == pytest.approx([0, 1, 2, 2, 4], abs=1e-6)


def test_waypoints_that_are_dropped_have_times() -> None:
    points = np.array([[0.0, 1.0, 1.0 + 1e-13, 2.0]])
    timed = sb.time_scale(sb.Path.through(points), 2.0, 3.0, dwell={2: 0.5})
    assert len(timed.arrival_times) == 4
    assert np.all(np.diff(timed.arrival_times) >= 0)


# Pauses


def test_dwells_stop_the_motion_and_lengthen_it() -> None:
    dwell = np.array([0.2, 0.5, 0.0, 0.3])
    timed = sb.time_scale(BEND, 2.0, 3.0, dwell=dwell)
    parts = [sb.time_scale(BEND, 2.0, 3.0).path, timed.path]
    assert parts[0] is BEND and parts[1] is BEND
    assert timed.stops == pytest.approx([1 / 3])
    arrive = timed.arrival_times
    assert arrive[0] == 0 and arrive[-1] == pytest.approx(timed.duration - 0.3)
    for waypoint in (0, 1, 3):
        there = BEND(BEND.waypoint_s[waypoint])
        for t in arrive[waypoint] + dwell[waypoint] * np.array([0.0, 0.3, 0.9]):
            assert timed.position(t) == pytest.approx(there, abs=1e-9)
            assert np.abs(timed.velocity(t)).max() < 1e-6
        middle = arrive[waypoint] + 0.5 * dwell[waypoint]
        assert np.all(timed.acceleration(middle) == 0)
        assert timed.progress(middle)[1:] == (0, 0)
    between = np.array([0.1, 0.4, 0.6]) + arrive[1] + dwell[1]
    assert np.all(np.abs(timed.velocity(between)).max(axis=0) > 0)
    t = np.linspace(0, timed.duration, 4001)
    assert np.array_equal(timed.position(t)[:, 17], timed.position(t[17]))
    step = np.linalg.norm(np.diff(timed.position(t)), axis=0).max()
    assert step <= np.sqrt(8) * t[1] * (1 + 1e-9)  # it goes on where it stopped


def test_a_motion_with_a_dwell_takes_its_parts_and_the_dwell() -> None:
    path = sb.Path.through([[0.0, 1.0, 3.0]], kind="linear")
    timed = sb.time_scale(path, acceleration=1.0, dwell={1: 0.7})
    assert timed.duration == pytest.approx(2 + 2 * np.sqrt(2) + 0.7, rel=1e-3)
    longer = sb.time_scale(path, acceleration=1.0, dwell={1: 0.7}, duration=9.0)
    assert longer.duration == pytest.approx(9.0, rel=1e-12)
    assert longer.time_at(0.500001) - longer.time_at(0.5) > 0.7
    for factor in np.linspace(1.0, 3.0, 41):  # whatever the rounding, it arrives before it pauses
        slower = timed.slower(factor)
        assert slower.duration == pytest.approx(factor * timed.duration)
        assert slower.arrival_times == pytest.approx(factor * timed.arrival_times)
    again = pickle.loads(pickle.dumps(timed))
    assert again.duration == timed.duration


def test_samples_and_audit_of_a_motion_with_pauses() -> None:
    timed = sb.time_scale(BEND, 2.0, 3.0, dwell={1: 0.5, 2: 0.25})
    samples = timed.to_trajectory(0.01)
    still = np.abs(samples.states[2:]).max(axis=0) < 1e-9
    assert np.count_nonzero(still) >= 70
    assert np.all(np.diff(timed.times) > 0)
    for use in timed.audit():
        assert timed.progress(use.time)[0] == pytest.approx(use.s, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"dwell": [0.1, 0.2]}, ValueError, r"shape \(4,\)"),
        ({"dwell": [0, -1.0, 0, 0]}, ValueError, "dwell must be at least 0"),
        ({"dwell": {4: 1.0}}, ValueError, "below 4"),
        ({"dwell": {0.5: 1.0}}, TypeError, "integer"),
        ({"dwell": {1: np.inf}}, ValueError, "dwell must be"),
        ({"dwell": {0: 1.0}, "start_speed": 0.1}, ValueError, "start_speed must be 0"),
        ({"dwell": {-1: 1.0}, "end_speed": 0.1}, ValueError, "end_speed must be 0"),
    ],
)
def test_dwells_that_are_none(options: dict, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        sb.time_scale(BEND, 2.0, 3.0, **options)


def test_a_dwell_where_the_load_cannot_be_held() -> None:
    def load(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return qdd + 2.0

    with pytest.raises(sb.InfeasiblePathError, match="a dwell") as caught:
        sb.time_scale(
            sb.Path.through([[0.0, 1.0]]),
            torque=[[3.0, 5.0]],
            inverse_dynamics=load,
            dwell={0: 1.0},
        )
    assert caught.value.constraint == "torque of row 0, lower limit"


def test_the_clock_of_pauses() -> None:
    pauses = Pauses(np.array([0.0, 1.0, 1.0, 4.0]), np.array([0.5, 0.25, 0.25, 1.0]))
    t = np.array([0.0, 0.2, 0.6, 1.5, 1.6, 1.9, 2.5, 5.5, 6.0])
    moving, paused = pauses.moving(t)
    assert moving == pytest.approx([0, 0, 0.1, 1, 1, 1, 1.5, 4, 4])
    assert paused.tolist() == [True, True, False, True, True, True, False, True, False]
    assert pauses.clock(np.array([0.0, 0.1, 1.0, 1.5, 4.0])) == pytest.approx([0, 0.6, 1.5, 2.5, 5])


# Joints on a circle


def test_a_joint_on_a_circle_goes_the_short_way() -> None:
    path = sb.Path.through([[3.1, -3.1]], wrap=True)
    assert path(1.0)[0] - path(0.0)[0] == pytest.approx(2 * np.pi - 6.2)
    back = sb.Path.through([[-3.1, 3.1]], wrap=True)
    assert back(1.0)[0] == pytest.approx(3.1 - 2 * np.pi)
    long = sb.Path.through([[3.1, -3.1], [0.0, 6.0]], wrap=[False, False])
    assert long(1.0) == pytest.approx([-3.1, 6.0])
    mixed = sb.Path.through([[170.0, -170.0], [3.1, -3.1], [0.0, 9.0]], wrap=[360.0, 2 * np.pi, 0])
    assert mixed(1.0) == pytest.approx([190.0, 2 * np.pi - 3.1, 9.0])


def test_many_turns_are_unwrapped() -> None:
    angle = np.linspace(0, 40, 60)
    folded = np.angle(np.exp(1j * angle))
    path = sb.Path.through([folded], wrap=True)
    assert path(path.waypoint_s) == pytest.approx(angle[None])


@pytest.mark.parametrize(
    ("points", "warns"),
    [
        ([[3.1, -3.1]], True),
        ([[2.5, 3.0, -2.9, -2.5], [0, 1, 2, 3.0]], True),
        ([[0.0, 3.0, 6.2]], False),  # no angle of [-pi, pi]
        ([[3.1, 0.0, -3.1]], False),  # comes back the way it went
        ([[1.0, -1.0], [2.0, -2.0]], False),
    ],
)
def test_a_warning_where_a_turn_looks_meant(points: list, warns: bool) -> None:
    if warns:
        with pytest.warns(UserWarning, match=r"joint 0 turns by .* wrap=True"):
            sb.Path.through(points)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sb.Path.through(points, wrap=False)
        if not warns:
            sb.Path.through(points)


@pytest.mark.parametrize(
    ("wrap", "error", "message"),
    [
        ("yes", TypeError, "wrap"),
        ([True, False], ValueError, r"shape \(1,\)"),
        (-1.0, ValueError, "at least 0"),
        (np.nan, ValueError, "finite"),
    ],
)
def test_wraps_that_are_none(wrap: Any, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        sb.Path.through([[0.0, 1.0]], wrap=wrap)


def test_the_part_of_a_motion_along_a_path_that_nearly_stops() -> None:
    """p' falls by 5,000 within a short piece: the first grid is far too coarse for the ends."""
    s = np.array([0.0, 0.00034762, 0.07485096, 0.08192275])
    q = np.array([0.0, -0.01113233, -0.15696814, -0.01161679])
    slope = np.array([-60.0586617, -0.0111166917, 0.00720704318, 24.2099151])
    path = sb.Path(CubicHermiteSpline(s, q[:, None], slope[:, None]))
    limits = {"velocity": [[-0.244, 27.0]], "acceleration": [[-1.88e-3, 2.032e-4]]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the tolerance
        timed = sb.time_scale(path, **limits, start_speed=3.54e-05, end_speed=3.174e-04)
    assert timed.audit().worst.use <= 1 + 1e-9
    assert timed.velocity([0.0, timed.duration])[0] == pytest.approx(
        slope[[0, -1]] * [3.54e-05, 3.174e-04], rel=1e-6
    )


def test_given_speeds_at_a_velocity_limit_with_limited_jerk() -> None:
    path = sb.Path.through([[0, 1, 2, 4], [0, 1, 0, 1]])  # p' = 10 at both ends
    timed = sb.time_scale(path, 1, 2, jerk=10, start_speed=0.1, end_speed=0.1)
    assert timed.velocity([0.0, timed.duration])[1] == pytest.approx([1, 1], rel=1e-9)
    assert timed.audit().worst.use <= 1 + 1e-9


@pytest.mark.parametrize(
    "limits",
    [
        {"velocity": 1.0, "acceleration": 2.0, "speed": 1.5, "acceleration_norm": 3.0},
        {"velocity": 1.0, "acceleration": 2.0, "jerk": 9.0},
        {"torque": 2.0, "inverse_dynamics": lambda q, qd, qdd: qdd * 1.0},
    ],
    ids=lambda limits: list(limits)[-1],
)
def test_a_motion_half_as_fast_needs_half_the_slowing_down(limits: dict) -> None:
    timed = sb.time_scale(sb.Path.through([[0.0, 1.0, 0.3], [0.0, 0.5, 2.0]]), **limits)
    uses = list(zip(timed.audit(), timed.slower(2.0).audit(), strict=True))
    assert len(uses) > 1
    for full, half in uses:
        assert half.factor == pytest.approx(full.factor / 2, rel=1e-6)
