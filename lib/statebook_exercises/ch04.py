"""Exercises of chapter 04, stability and equilibria."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

G = 9.8


def _places(rng: np.random.Generator) -> dict[str, float]:
    """Three level places, a valley on either side of a hill, and a start beside the hill."""
    hill = round(float(rng.uniform(-0.4, 0.4)), 2)
    left = round(hill - float(rng.uniform(0.9, 1.6)), 2)
    right = round(hill + float(rng.uniform(0.9, 1.6)), 2)
    side = float(rng.choice([-1.0, 1.0]))
    return {
        "left": left,
        "hill": hill,
        "right": right,
        "start": round(hill + side * float(rng.uniform(0.08, 0.2)), 2),
    }


def _valley(p: Parameters, sign: float = 1.0) -> float:
    """The valley on the side of the start; sign -1 gives the other one."""
    return float(p.right if sign * (p.start - p.hill) > 0 else p.left)


def _motor(rng: np.random.Generator) -> dict[str, float]:
    m = round(float(rng.uniform(0.4, 1.2)), 2)
    L = round(float(rng.uniform(0.4, 0.7)), 2)
    return {"m": m, "L": L, "u": round(float(rng.uniform(0.3, 0.8)) * m * G * L, 2)}


def _ratio(p: Parameters) -> float:
    return float(p.u / (p.m * G * p.L))


def _point(rng: np.random.Generator) -> dict[str, float]:
    return {
        "x1": round(float(rng.uniform(0.5, 2.0)), 2),
        "x2": round(float(rng.uniform(-2.0, -0.5)), 2),
    }


def _tracks(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    point = np.array([[p.x1], [p.x2]])
    return [(point + rng.normal(size=(2, 9)),) for _ in range(8)]


def _excursion(
    p: Parameters,
    *,
    centre: bool = True,
    pick: Callable[[np.ndarray], Any] = np.max,
    relative: bool = True,
    rows: int = 2,
) -> Callable[[Any], Any]:
    """The largest distance from the point, over the first one."""

    def measure(track: Any) -> Any:
        off = np.asarray(track, dtype=float) - centre * np.array([[p.x1], [p.x2]])
        distance = np.linalg.norm(off[:rows], axis=0)
        return pick(distance) / (distance[0] if relative else 1.0)

    return measure


_FOUR = ("van der pol", "roundabout", "oscillator", "damped")


def _order(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "order": [_FOUR[i] for i in rng.permutation(4)],
        "mu": round(float(rng.uniform(0.5, 2.0)), 2),
    }


def _marked(*names: str) -> Callable[[Parameters], np.ndarray]:
    """1 for the named systems in the student's order, 0 for the others."""
    return lambda p: np.array([1.0 if name in names else 0.0 for name in p.order])


def _population(rng: np.random.Generator) -> dict[str, float]:
    r = round(float(rng.uniform(3.3, 3.7)), 2)
    return {"r": r, "least": round(1.25 / r, 3)}


def _judge_harvest(answer: Any, p: Parameters) -> str:
    q = float(answer)
    slope = 2 - p.r + q
    if q < 0:
        return "a harvest takes animals away: the share cannot be negative"
    if slope >= 1:
        return "so large a harvest leaves no animals: x* = 1 - (1 + q)/r is not positive any more"
    if slope <= -1:
        return (
            f"it does not settle: at rest the slope of the map is {slope:.2f}, and each step"
            " multiplies an error by it"
        )
    if beyond(abs(slope) ** 8, 0.01):
        return (
            f"it settles too slowly: after 8 steps {abs(slope) ** 8:.2g} of an error is left, and"
            " 0.01 is allowed"
        )
    rest = 1 - (1 + q) / p.r
    if beyond(p.least, rest):
        return f"the population rests at {rest:.3f}, and {p.least:g} is the least allowed"
    return ""


def _pose(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.4, 1.2)), 2),
        "L": round(float(rng.uniform(0.4, 0.7)), 2),
        "b": round(float(rng.uniform(0.05, 0.2)), 3),
        "theta": round(float(rng.uniform(0.3, 1.2) * rng.choice([-1, 1])), 2),
    }


def _linear(
    p: Parameters,
    sign: float = 1.0,
    shape: Callable[[float], float] = np.sin,
    inertia: float | None = None,
) -> np.ndarray:
    friction = p.b / (inertia or p.m * p.L**2)
    return np.array([[0.0, 1.0], [sign * G / p.L * shape(p.theta), -friction]])


def _level(rng: np.random.Generator) -> dict[str, float]:
    return {
        "L": round(float(rng.uniform(0.4, 1.2)), 2),
        "theta": round(float(rng.uniform(0.5, 0.9)), 2),
    }


def _throw(p: Parameters, factor: float = 2.0) -> float:
    return -float(np.sqrt(factor * G / p.L * (p.theta - np.sin(p.theta))))


EXERCISES = (
    Exercise(
        "04.1",
        "A landscape",
        "read off",
        5,
        _places,
        _valley,
        (
            Slip(
                "that place is level, but it is a hill: beside it f points away",
                lambda p: p.hill,
            ),
            Slip(
                "that valley lies beyond the hill; look at the sign of f where the marble starts",
                lambda p: _valley(p, -1.0),
            ),
            Slip(
                "that is where it starts; f is not 0 there, so it does not stay",
                lambda p: p.start,
            ),
        ),
        rtol=0.02,
    ),
    Exercise(
        "04.2",
        "A torque and two poses",
        "compute",
        5,
        _motor,
        lambda p: -np.arccos(_ratio(p)),
        (
            Slip(
                "that torque does hold it there, but above the level, where it is unstable",
                lambda p: np.arccos(_ratio(p)),
            ),
            Slip(
                "the angle counts from the x axis: the lever of the weight is L cos(theta)",
                lambda p: np.arcsin(_ratio(p)),
            ),
            Slip(
                "a weight is no torque: where is its moment arm?",
                lambda p: -np.arccos(p.u / (p.m * G)),
            ),
            Slip("hanging needs no torque at all", lambda p: -np.pi / 2),
        ),
    ),
    Exercise(
        "04.3",
        "A stable roundabout?",
        "debug",
        10,
        _point,
        _excursion,
        (
            Slip(
                "the last distance tells about attraction; stability asks for the largest one",
                lambda p: _excursion(p, pick=lambda d: d[-1]),
            ),
            Slip(
                "distances are measured from the point, not from the origin",
                lambda p: _excursion(p, centre=False),
            ),
            Slip(
                "two mistakes: which point is it measured from, and which of the distances counts?",
                lambda p: _excursion(p, centre=False, pick=lambda d: d[-1]),
            ),
            Slip("a distance takes both components", lambda p: _excursion(p, rows=1)),
            Slip("divide by the push, the first distance", lambda p: _excursion(p, relative=False)),
        ),
        points=2,
        inputs=_tracks,
    ),
    Exercise(
        "04.4",
        "Four words",
        "read off",
        10,
        _order,
        _marked("oscillator", "damped"),
        (
            Slip(
                "bounded is not stable: Van der Pol leaves every small neighbourhood, whatever"
                " the push",
                _marked(*_FOUR),
            ),
            Slip(
                "attractive is not stable: on its way the roundabout goes to the far side",
                _marked("roundabout", "damped"),
            ),
            Slip(
                "attractive is not stable, though the damped oscillator is both; and stable need"
                " not be attractive",
                _marked("roundabout", "oscillator", "damped"),
            ),
            Slip(
                "that one is asymptotically stable; Lyapunov stable asks for less: to stay near",
                _marked("damped"),
            ),
            Slip(
                "bounded is not stable, for one; and look at the roundabout",
                _marked("van der pol", "oscillator", "damped"),
            ),
        ),
    ),
    Exercise(
        "04.5",
        "A harvest that settles",
        "design",
        20,
        _population,
        lambda p: p.r - 2.4,
        (
            Slip("it does not settle", lambda p: 0.0),
            Slip("it settles too slowly", lambda p: p.r - 2.75),
            Slip("is the least allowed", lambda p: p.r - 2.0),
            Slip("leaves no animals", lambda p: p.r - 0.9),
            Slip("cannot be negative", lambda p: -0.5),
        ),
        points=3,
        judge=_judge_harvest,
    ),
    Exercise(
        "04.6",
        "Beside a held pose",
        "derive",
        15,
        _pose,
        _linear,
        (
            Slip(
                "the sign of gravity: below the level, theta* < 0, it must pull back",
                lambda p: _linear(p, sign=-1.0),
            ),
            Slip(
                "differentiate: the slope of -cos(theta) is sin(theta)",
                lambda p: _linear(p, sign=-1.0, shape=np.cos),
            ),
            Slip(
                "friction is a torque: divide it by the moment of inertia, m L^2",
                lambda p: _linear(p, inertia=p.m * p.L),
            ),
            Slip(
                "friction acts against the motion",
                lambda p: _linear(p) * np.array([[1, 1], [1, -1]]),
            ),
            Slip("where is friction?", lambda p: _linear(p) * np.array([[1, 1], [1, 0]])),
        ),
        points=2,
    ),
    Exercise(
        "04.7",
        "The one throw",
        "play",
        15,
        _level,
        _throw,
        (
            Slip("that throw goes up; throw it down", lambda p: -_throw(p)),
            Slip(
                "that would do without the motor; its torque does work too",
                lambda p: -float(np.sqrt(2 * G / p.L * (1 - np.cos(p.theta)))),
            ),
            Slip("half the rate squared is the energy: a 2 is missing", lambda p: _throw(p, 1.0)),
            Slip(
                "theta^3/6 is theta - sin(theta) near the level only; yours starts higher",
                lambda p: -float(np.sqrt(G / p.L * p.theta**3 / 3)),
            ),
            Slip("let go at rest, it climbs away", lambda p: 0.0),
        ),
        points=2,
    ),
)
