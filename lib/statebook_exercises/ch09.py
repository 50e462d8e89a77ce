"""Exercises of chapter 09, the car."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

BACK, FRONT, HALF_WIDTH = 0.9, 0.8, 0.9  # the body beyond the axles, and its half width [m]
SPARE = 2.0  # degrees that the solution's steering stays below the limit


def _steered(rng: np.random.Generator) -> dict[str, float]:
    return {
        "L": round(float(rng.uniform(3.2, 5.8)), 2),
        "degrees": float(rng.choice([15, 20, 25, 30])),
    }


def _radius(p: Parameters) -> float:
    return float(p.L / np.tan(np.radians(p.degrees)))


def _street(rng: np.random.Generator) -> dict[str, float]:
    L = round(float(rng.uniform(2.2, 3.4)), 2)
    return {"L": L, "width": round(L * float(rng.uniform(2.8, 4.5)), 1)}


def _wheelbase(rng: np.random.Generator) -> dict[str, float]:
    return {"L": round(float(rng.uniform(1.6, 3.4)), 2)}


def _front_axle(
    p: Parameters,
    turned: float = 1.0,
    rate: Callable[[Any], Any] = np.sin,
    lever: Callable[[float], float] = lambda L: 1 / L,
) -> Callable[..., Any]:
    """The rates of the front axle's middle and of the heading; turned is the share of phi."""
    return lambda theta, v, phi: np.array(
        [
            v * np.cos(theta + turned * phi),
            v * np.sin(theta + turned * phi),
            v * lever(p.L) * rate(phi),
        ]
    )


def _drives(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-3, -2, -1], [3, 2, 1], size=(12, 3)).tolist()]


def _turn(radius: Callable[[Any], Any], side: float = 1.0) -> Callable[..., Any]:
    """The pose after an arc from the origin, by its radius."""

    def arc(v: Any, phi: Any, t: Any) -> np.ndarray:
        R = radius(phi)
        angle = v * t / R
        return np.array([R * np.sin(angle), side * R * (1 - np.cos(angle)), angle])

    return arc


def _arcs(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    sizes = rng.uniform([0.5, 0.1, 0.5], [1.5, 0.6, 2.0], size=(12, 3))
    signs = np.stack([rng.choice([-1, 1], 12), rng.choice([-1, 1], 12), np.ones(12)], axis=1)
    return [tuple(row) for row in (sizes * signs).tolist()]


def _narrow(rng: np.random.Generator) -> dict[str, float]:
    return {
        "L": round(float(rng.uniform(2.3, 3.1)), 2),
        "degrees": round(float(rng.uniform(24, 33)), 1),
        "step": round(float(rng.uniform(0.8, 1.6)), 2),
        "room": round(float(rng.uniform(0.7, 1.2)), 2),
    }


def _gain(h: float, p: Parameters) -> float:
    """The step to the side of one round of four moves of the length h [m]."""
    return float(h * np.sin(h / _radius(p)))


def _fewest(p: Parameters) -> int:
    return int(np.ceil(p.step / _gain(p.room, p)))


def _rounds(p: Parameters) -> np.ndarray:
    n = _fewest(p)
    return np.array([scipy.optimize.brentq(lambda h: n * _gain(h, p) - p.step, 0.0, p.room), n])


def _judge_rounds(answer: Any, p: Parameters) -> str:
    h, n = map(float, answer)
    if n < 1 or n != round(n) or n > 1000:
        return f"the number of rounds must be a whole one, from 1 to 1000, got {n:g}"
    if h <= 0 or beyond(h, p.room):
        return f"a move of {h:g} m is none for a room of {p.room:g} m"
    step = n * _gain(h, p)
    if abs(step - p.step) > 0.01 * p.step:
        return (
            f"the car ends {step:.3g} m to the side, {p.step:g} m are asked for; one round gains"
            " h sin(|kappa| h)"
        )
    if n > _fewest(p):
        return f"{n:g} rounds are {4 * n * h:.3g} m of driving; it can be done in fewer"
    return ""


def _gap(rng: np.random.Generator) -> dict[str, float]:
    L = round(float(rng.uniform(2.3, 3.0)), 2)
    degrees = round(float(rng.uniform(32, 38)), 1)
    p = Parameters(L=L, degrees=degrees - SPARE)
    # On the last arc the front corner runs on a circle; 0.2 m more than it needs.
    reach = np.hypot(_radius(p) + HALF_WIDTH, L + FRONT) + 0.2
    ahead = float(np.sqrt(reach**2 - (_radius(p) - HALF_WIDTH) ** 2))
    return {
        "L": L,
        "degrees": degrees,
        "step": round(float(rng.uniform(2.0, 2.5)), 2),
        "ahead": round(ahead, 2),
        "behind": 0.4,
    }


def parking(p: Parameters) -> np.ndarray:
    """Return forward, and back through two opposite arcs, as (distance, steering)."""
    phi = np.radians(p.degrees - SPARE)
    R = p.L / np.tan(phi)
    alpha = np.arccos(1 - p.step / (2 * R))
    return np.array([[2 * R * np.sin(alpha), 0.0], [-R * alpha, -phi], [-R * alpha, phi]])


def poses(pieces: np.ndarray, p: Parameters) -> np.ndarray:
    """Return poses (3, N) every few centimetres along pieces (distance, steering)."""
    placed = [np.zeros((3, 1))]
    for distance, phi in pieces:
        s = np.linspace(0, distance, 2 + int(abs(distance) / 0.03))
        start = placed[-1][:, -1:]
        half = s * np.tan(phi) / p.L / 2
        chord, mean = s * np.sinc(half / np.pi), start[2] + half
        placed.append(
            np.stack(
                [
                    start[0] + chord * np.cos(mean),
                    start[1] + chord * np.sin(mean),
                    start[2] + 2 * half,
                ]
            )
        )
    return np.concatenate(placed, axis=1)


def _touches(poses: np.ndarray, p: Parameters) -> str:
    """Return which of the two parked cars the body's outline comes into, or nothing."""
    along, across = np.linspace(-BACK, p.L + FRONT, 41), np.linspace(-HALF_WIDTH, HALF_WIDTH, 19)
    sides = [np.stack([along, 0 * along + y]) for y in (-HALF_WIDTH, HALF_WIDTH)]
    ends = [np.stack([0 * across + x, across]) for x in (-BACK, p.L + FRONT)]
    body = np.concatenate(sides + ends, axis=1)[:, :, None]
    c, s = np.cos(poses[2]), np.sin(poses[2])
    x, y = poses[0] + c * body[0] - s * body[1], poses[1] + s * body[0] + c * body[1]
    length = BACK + p.L + FRONT
    beside = np.abs(y + p.step) < HALF_WIDTH
    if (beside & (x > p.ahead) & (x < p.ahead + length)).any():
        return "in front"
    rear = (x < -BACK - p.behind) & (x > -BACK - p.behind - length)
    return "behind" if (beside & rear).any() else ""


def _judge_parking(answer: Any, p: Parameters) -> str:
    pieces = np.asarray(answer, dtype=float)
    most = float(np.degrees(np.abs(pieces[:, 1]).max()))
    if beyond(most, p.degrees):
        also = ": steering angles are asked for in radians" if most > 90 else ""
        return (
            f"the wheels turn by {most:.3g} degrees, and the limit is {p.degrees:g} degrees{also}"
        )
    if np.abs(pieces[:, 0]).sum() > 60:
        return f"{np.abs(pieces[:, 0]).sum():.3g} m of driving: 60 m are allowed"
    placed = poses(pieces, p)
    x, y, theta = placed[:, -1]
    if np.hypot(x, y + p.step) > 0.05 or abs(theta) > 0.03:
        return (
            f"the car ends at x = {x:.2f} m, y = {y:.2f} m, turned by {theta:.2f} rad; the goal is"
            f" (0, {-p.step:g}, 0), to 5 cm and 0.03 rad"
            + (": phi > 0 is to the left, and backwards too" if y > 0.05 else "")
        )
    where = _touches(placed, p)
    return f"the body touches a parked car on its way, the one {where}" if where else ""


EXERCISES = (
    Exercise(
        "09.1",
        "A bus on its circle",
        "read off",
        5,
        _steered,
        _radius,
        (
            Slip(
                "that is the chapter's car; the circle grows with the car",
                lambda p: 2.6 / np.tan(np.radians(p.degrees)),
            ),
            Slip(
                "1/(L tan(phi)) is no length: try it in centimetres",
                lambda p: 1 / (p.L * np.tan(np.radians(p.degrees))),
            ),
            Slip(
                "that is the circle of the front axle",
                lambda p: p.L / np.sin(np.radians(p.degrees)),
            ),
            Slip(
                "more steering, smaller circle: L tan(phi) does it the other way",
                lambda p: p.L * np.tan(np.radians(p.degrees)),
            ),
            Slip("that is the diameter", lambda p: 2 * _radius(p)),
        ),
        rtol=0.02,
    ),
    Exercise(
        "09.2",
        "A narrow street",
        "compute",
        5,
        _street,
        lambda p: np.arctan(2 * p.L / p.width),
        (
            Slip(
                "the width is two radii",
                lambda p: np.arctan(p.L / p.width),
            ),
            Slip(
                "that is for the front axle's circle",
                lambda p: np.arcsin(2 * p.L / p.width),
            ),
            Slip(
                "R = 1/(L tan(phi)) is no length; R = L/tan(phi)",
                lambda p: np.arctan(2 / (p.L * p.width)),
            ),
            Slip("that is the tangent of the angle", lambda p: 2 * p.L / p.width),
        ),
    ),
    Exercise(
        "09.3",
        "Steered from the front",
        "derive",
        15,
        _wheelbase,
        _front_axle,
        (
            Slip(
                "the front wheel's speed has a part along the car, v cos(phi), and one across it,"
                " v sin(phi): it is the one across that turns the car",
                lambda p: _front_axle(p, rate=np.tan),
            ),
            Slip(
                "the front axle moves along its wheels, and those are turned by phi",
                lambda p: _front_axle(p, turned=0.0),
            ),
            Slip(
                "that is the rear axle's equation; here v is the speed of the front wheel, along"
                " its own direction",
                lambda p: _front_axle(p, turned=0.0, rate=np.tan),
            ),
            Slip(
                "a positive phi turns the wheels to the left, counter-clockwise",
                lambda p: _front_axle(p, turned=-1.0),
            ),
            Slip(
                "v times L is no angular rate: check the units",
                lambda p: _front_axle(p, lever=lambda L: L),
            ),
        ),
        points=2,
        inputs=_drives,
    ),
    Exercise(
        "09.4",
        "An arc that goes astray",
        "debug",
        10,
        _wheelbase,
        lambda p: _turn(lambda phi: p.L / np.tan(phi)),
        (
            Slip(
                "the radius is right; which way does the car go with the wheels to the left?",
                lambda p: _turn(lambda phi: p.L / np.tan(phi), side=-1.0),
            ),
            Slip(
                "the side is right; how does the radius change with more steering?",
                lambda p: _turn(lambda phi: p.L * np.tan(phi)),
            ),
            Slip(
                "1/(L tan(phi)) is no length: check the units",
                lambda p: _turn(lambda phi: 1 / (p.L * np.tan(phi))),
            ),
            Slip(
                "two mistakes are left: the radius, and the side",
                lambda p: _turn(lambda phi: p.L * np.tan(phi), side=-1.0),
            ),
        ),
        points=2,
        inputs=_arcs,
    ),
    Exercise(
        "09.5",
        "A step to the side",
        "design",
        20,
        _narrow,
        _rounds,
        points=3,
        judge=_judge_rounds,
    ),
    Exercise(
        "09.6",
        "Park your own car",
        "play",
        20,
        _gap,
        parking,
        points=3,
        judge=_judge_parking,
    ),
)
