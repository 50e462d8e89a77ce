"""Exercises of chapter 16, time-optimal paths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

G = 9.8
CURVE = np.array([[0.3, 0.9, 1.2, 0.6], [0.5, -0.3, -1.2, -0.4]])  # waypoints of 16.5 [rad]


def _rows(rng: np.random.Generator) -> dict[str, float]:
    """Two limits |a s'' + b z| <= 1 with slopes of opposite signs."""
    return {
        "a1": round(float(rng.uniform(0.2, 0.35)), 2),
        "b1": round(float(rng.uniform(0.35, 0.5)), 2),
        "a2": round(float(rng.uniform(0.25, 0.5)), 2),
        "b2": -round(float(rng.uniform(0.15, 0.25)), 2),
    }


def _top(p: Parameters) -> np.ndarray:
    """The highest point (s'', z) of the polygon: row 1 at its upper, row 2 at its lower bound."""
    return np.linalg.solve([[p.a1, p.b1], [p.a2, p.b2]], [1.0, -1.0])


def _pair(rng: np.random.Generator) -> dict[str, float]:
    """Two joints: the first is sluggish, the second slow."""
    return {
        "d1": round(float(rng.uniform(0.5, 0.8)), 2),
        "d2": round(float(rng.uniform(1.2, 1.6)), 2),
        "v1": round(float(rng.uniform(1.5, 2.0)), 2),
        "v2": round(float(rng.uniform(0.8, 1.0)), 2),
        "a1": round(float(rng.uniform(0.8, 1.2)), 2),
        "a2": round(float(rng.uniform(4.0, 6.0)), 2),
    }


def _trapezoid(rate: float, gain: float) -> float:
    """Time from s = 0 to 1, at rest at both, with s' and s'' bounded."""
    if rate**2 >= gain:
        return float(2 / np.sqrt(gain))
    return 1 / rate + rate / gain


def _together(p: Parameters) -> float:
    return _trapezoid(min(p.v1 / p.d1, p.v2 / p.d2), min(p.a1 / p.d1, p.a2 / p.d2))


def _alone(p: Parameters) -> tuple[float, float]:
    return (
        _trapezoid(p.v1 / p.d1, p.a1 / p.d1),
        _trapezoid(p.v2 / p.d2, p.a2 / p.d2),
    )


def _swing(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.4, 1.4)), 2),
        "L": round(float(rng.uniform(0.3, 0.7)), 2),
        "A": round(float(rng.uniform(1.2, 2.2)), 2),
    }


def _coefficients(p: Parameters, combine: Callable[..., Any]) -> Callable[..., Any]:
    """(a, b, c) at s from inertia, weight, theta, theta' and theta'' there."""

    def at(s: float) -> Any:
        theta = -np.pi / 2 + p.A * s**2
        return np.array(
            combine(p.m * p.L**2, p.m * G * p.L, theta, 2 * p.A * s, 2 * p.A), dtype=float
        )

    return at


def _places(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(s,) for s in rng.uniform(0.1, 1.2, size=12).tolist()]


def _motor(rng: np.random.Generator) -> dict[str, float]:
    return {"limit": round(float(rng.uniform(2, 4)), 2)}


def _highest(
    p: Parameters, twice: float = 2.0, low: bool = True, weight: float = 1.0
) -> Callable[..., Any]:
    """The highest z of one stage of the backward pass."""

    def highest(a: float, b: float, c: float, step: float, z_next: float) -> float:
        rows = [[a, b], [-a, -b], [twice * step, 1], [-twice * step, -1]]
        right = [p.limit - weight * c, p.limit + weight * c if low else 1e3, z_next, 0.0]
        found = scipy.optimize.linprog([0, -1], rows, right, bounds=[(-50, 50), (0, None)])
        return float(found.x[1])

    return highest


def _stages(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """(a, b, c, step, z_next): the last binds from below, the others from both sides."""
    low = [1.0, -1.0, -1.0, 0.02, 0.4]
    high = [3.0, 1.0, 1.0, 0.05, 2.0]
    return [tuple(row) for row in rng.uniform(low, high, size=(12, 5)).tolist()]


def _arm(rng: np.random.Generator) -> dict[str, float]:
    """An arm with equal links, a time and a sum of torques; they scale with its size."""
    length = round(float(rng.uniform(0.45, 0.75)), 2)
    mass = round(float(rng.uniform(1.2, 2.8)), 1)
    return {
        "L": length,
        "m": mass,
        "longest": round(float(0.9 * np.sqrt(length / 0.6)), 3),
        "budget": round(43.4 * length / 0.6 * mass / 2, 2),
    }


def _motors(p: Parameters, first: float, second: float) -> np.ndarray:
    """Torques as multiples of what holds the arm out level."""
    weights = G * p.L * np.array([p.m + 0.5 * p.m, 0.5 * p.m])
    weights[0] += G * p.L * 0.5 * p.m  # the second mass is two links away from the first joint
    return np.array([first, second]) * weights


def _judge_motors(answer: Any, p: Parameters) -> str:
    if np.any(answer <= 0):
        return "a motor's torque must be positive"
    total = float(np.sum(answer))
    if beyond(total, p.budget):
        return f"together the motors have {total:.4g} N m, and {p.budget:g} N m are in the budget"
    arm = sb.PlanarArm(lengths=(p.L, p.L), masses=(p.m, p.m / 2))
    try:
        timed = sb.time_scale(
            sb.Path.through(CURVE), torque=answer, inverse_dynamics=arm.inverse_dynamics
        )
    except sb.InfeasiblePathError as error:
        joint = "joint 1" if "row 0" in error.constraint else "joint 2"
        return (
            f"these motors cannot drive the path: at s = {error.s:.2f} the motor of {joint} is too"
            " weak"
        )
    if beyond(timed.duration, p.longest):
        return (
            f"it takes {timed.duration:.3f} s, and {p.longest:g} s are allowed: which motor is at"
            " its limit most of the time?"
        )
    return ""


def _reach(rng: np.random.Generator) -> dict[str, float]:
    """A point to pass, and on which side the elbow is at both ends."""
    radius, angle = float(rng.uniform(0.75, 0.95)), float(rng.uniform(0.5, 1.0))
    return {
        "x": round(radius * np.cos(angle), 3),
        "y": round(radius * np.sin(angle), 3),
        "side": int(rng.choice([-1, 1])),
        "bend": round(float(rng.uniform(0.6, 0.9)), 2),
    }


REACHER = sb.PlanarArm(lengths=(0.6, 0.5), masses=(2.0, 1.0))


def _elbow(p: Parameters, side: float) -> np.ndarray:
    """The pose whose hand is at the point, with the elbow on one side."""
    cosine = (p.x**2 + p.y**2 - 0.6**2 - 0.5**2) / (2 * 0.6 * 0.5)
    q2 = side * np.arccos(cosine)
    q1 = np.arctan2(p.y, p.x) - np.arctan2(0.5 * np.sin(q2), 0.6 + 0.5 * np.cos(q2))
    return np.array([q1, q2])


def _time_through(p: Parameters, pose: np.ndarray) -> float:
    ends = np.array([[0.0, p.bend * p.side], [1.5, p.bend * p.side]])
    path = sb.Path.through(np.stack([ends[0], pose, ends[1]], axis=1))
    return sb.time_scale(path, velocity=2.0, acceleration=5.0).duration


def _judge_pose(answer: Any, p: Parameters) -> str:
    if np.abs(answer).max() > 10:
        return "angles are in radians: no more than a few"
    hand = REACHER.positions(answer)[1]
    off = float(np.hypot(hand[0] - p.x, hand[1] - p.y))
    if off > 0.02:
        return (
            f"the hand is {off:.3g} m away from the point; 0.02 m are allowed. The second angle"
            " counts from the first link"
        )
    took = _time_through(p, answer)
    least = _time_through(p, _elbow(p, p.side))
    if took > 1.1 * least:
        return (
            f"it takes {took:.2f} s, much longer than needed: the hand reaches the point in two"
            " poses of the arm"
        )
    return ""


EXERCISES = (
    Exercise(
        "16.1",
        "The top of a polygon",
        "read off",
        5,
        _rows,
        _top,
        (
            Slip(
                "that is the highest place without an acceleration along the path; another s''"
                " allows more speed",
                lambda p: [0.0, min(1 / p.b1, -1 / p.b2)],
            ),
            Slip("s'' first, then z", lambda p: _top(p)[::-1]),
            Slip(
                "that is the corner at rest: the largest acceleration, not the largest speed",
                lambda p: [min(1 / p.a1, 1 / p.a2), 0.0],
            ),
            Slip(
                "the answer is z = s'^2, not s'",
                lambda p: [_top(p)[0], np.sqrt(_top(p)[1])],
            ),
        ),
        rtol=0.04,
    ),
    Exercise(
        "16.2",
        "Two joints, one motion",
        "compute",
        10,
        _pair,
        _together,
        (
            Slip(
                "the joints move at the same time, not one after the other",
                lambda p: sum(_alone(p)),
            ),
            Slip(
                "the first joint alone would be that quick: which joint bounds s'?",
                lambda p: _alone(p)[0],
            ),
            Slip(
                "the second joint alone would be that quick: which joint bounds s''?",
                lambda p: _alone(p)[1],
            ),
            Slip(
                "the tighter of two limits counts, not the looser",
                lambda p: _trapezoid(max(p.v1 / p.d1, p.v2 / p.d2), max(p.a1 / p.d1, p.a2 / p.d2)),
            ),
        ),
        points=1,
    ),
    Exercise(
        "16.3",
        "Three coefficients",
        "derive",
        15,
        _swing,
        lambda p: _coefficients(p, lambda J, w, q, q1, q2: [J * q1, J * q2, w * np.cos(q)]),
        (
            Slip(
                "a constant s' is no constant rate of theta: what does theta'' add?",
                lambda p: _coefficients(p, lambda J, w, q, q1, q2: [J * q1, 0, w * np.cos(q)]),
            ),
            Slip(
                "a belongs to s'', b to s'^2",
                lambda p: _coefficients(p, lambda J, w, q, q1, q2: [J * q2, J * q1, w * np.cos(q)]),
            ),
            Slip(
                "theta is counted from the x axis: gravity's lever is L cos(theta)",
                lambda p: _coefficients(p, lambda J, w, q, q1, q2: [J * q1, J * q2, w * np.sin(q)]),
            ),
            Slip(
                "the moment of inertia of a point mass is m L^2",
                lambda p: _coefficients(
                    p, lambda J, w, q, q1, q2: [J / p.L * q1, J / p.L * q2, w * np.cos(q)]
                ),
            ),
            Slip(
                "the motor works against gravity: at theta = 0 it must pull upwards",
                lambda p: _coefficients(
                    p, lambda J, w, q, q1, q2: [J * q1, J * q2, -w * np.cos(q)]
                ),
            ),
        ),
        points=2,
        inputs=_places,
    ),
    Exercise(
        "16.4",
        "A stage that promises too much",
        "debug",
        15,
        _motor,
        _highest,
        (
            Slip(
                "over a step z changes by 2 s'' ds: test it on a start from rest",
                lambda p: _highest(p, twice=1.0),
            ),
            Slip(
                "a motor has a limit in the other direction too, and braking uses it",
                lambda p: _highest(p, low=False),
            ),
            Slip(
                "two mistakes: the step, and the motor's other direction",
                lambda p: _highest(p, twice=1.0, low=False),
            ),
            Slip("where is the weight c?", lambda p: _highest(p, weight=0.0)),
        ),
        points=2,
        inputs=_stages,
    ),
    Exercise(
        "16.5",
        "The smallest motors",
        "design",
        20,
        _arm,
        lambda p: _motors(p, 1.385, 1.72),
        (
            Slip("cannot drive the path", lambda p: _motors(p, 1.2, 0.7)),
            Slip("are in the budget", lambda p: _motors(p, 2.0, 2.0)),
            Slip("which motor is at its limit", lambda p: _motors(p, 1.1, 2.5)),
            Slip("which motor is at its limit", lambda p: _motors(p, 1.5, 1.2)),
            Slip("must be positive", lambda p: -_motors(p, 1.3, 1.7)),
        ),
        points=3,
        judge=_judge_motors,
    ),
    Exercise(
        "16.6",
        "Past a point, in time",
        "play",
        20,
        _reach,
        lambda p: _elbow(p, p.side),
        (
            Slip("in two poses of the arm", lambda p: _elbow(p, -p.side)),
            Slip("away from the point", lambda p: _elbow(p, p.side) + np.array([0.2, 0.0])),
            Slip("angles are in radians", lambda p: np.degrees(_elbow(p, p.side))),
            Slip("away from the point", lambda p: [p.x, p.y]),
        ),
        points=3,
        judge=_judge_pose,
    ),
)
