"""Exercises of chapter 06, force, torque and the particle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond


def _move(rng: np.random.Generator) -> dict[str, float]:
    """A move from rest to rest."""
    return {
        "m": round(float(rng.uniform(1.5, 6.0)), 2),
        "d": round(float(rng.uniform(2.0, 9.0)), 2),
        "limit": round(float(rng.uniform(2.5, 8.0)), 2),
    }


def _fastest(p: Parameters) -> float:
    return float(2 * np.sqrt(p.m * p.d / p.limit))


def _throw(rng: np.random.Generator) -> dict[str, float]:
    """A particle that moves against a constant force."""
    return {
        "m": round(float(rng.uniform(1.5, 3.0)), 2),
        "p0": round(float(rng.uniform(0.5, 0.9)), 2),
        "v0": round(float(rng.uniform(2.0, 2.8)), 2),
        "u": round(float(rng.uniform(3.0, 6.0)), 2),
    }


def _turn(p: Parameters, share: float = 0.5, mass: float | None = None) -> float:
    return float(p.p0 + share * (p.m if mass is None else mass) * p.v0**2 / p.u)


def _smooth(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(1.5, 6.0)), 2),
        "d": round(float(rng.uniform(2.0, 9.0)), 2),
        "T": round(float(rng.uniform(1.5, 4.0)), 2),
    }


def _times(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(float(t),) for t in rng.uniform(0.0, p.T, size=8)]


def _force(
    p: Parameters, *, mass: bool = True, power: int = 2, order: int = 2, sign: float = 1.0
) -> Callable[[float], float]:
    """The mass times a derivative of d (3 s^2 - 2 s^3), s = t/T, over a power of T."""
    motion = np.polynomial.Polynomial([0, 0, 3, -2]).deriv(order)
    scale = sign * (p.m if mass else 1.0) * p.d / p.T**power
    return lambda t: float(scale * motion(t / p.T))


def _target(rng: np.random.Generator) -> dict[str, float]:
    move = _move(rng)
    return {**move, "within": round(7.0 * float(np.sqrt(move["m"] * move["d"] / move["limit"])), 1)}


def _critical(p: Parameters) -> np.ndarray:
    """As stiff as the limit allows, nearly, and critically damped."""
    kp = 0.9 * p.limit / p.d
    return np.array([kp, 2 * np.sqrt(p.m * kp)])


def _judge_gains(answer: Any, p: Parameters) -> str:
    kp, kd = map(float, answer)
    if kp <= 0 or kd <= 0:
        return "both gains must be positive, or it does not converge"
    if beyond(kp * p.d, p.limit):
        return f"at the start the force is kp d = {kp * p.d:.3g} N, and the limit is {p.limit:g} N"
    A = np.array([[0.0, 1.0], [-kp / p.m, -kd / p.m]])
    run = sb.simulate(lambda x: A @ x, [-p.d, 0.0], times=np.linspace(0, 3 * p.within, 601))
    off = run.states[0] / p.d
    largest = np.abs(kp * run.states[0] + kd * run.states[1]).max()
    if largest > p.limit * (1 + 1e-6):
        return f"the force reaches {largest:.3g} N, and the limit is {p.limit:g} N"
    if off.max() > 0.02:
        return f"it overshoots by {100 * off.max():.3g} % of the way; 2 % are allowed"
    late = np.abs(off[run.times >= p.within]).max()
    if late > 0.05:
        return (
            f"after {p.within:g} s it is still {100 * late:.3g} % of the way off; 5 % are allowed:"
            " too little stiffness, or so much damping that it creeps"
        )
    return ""


def _judge_policy(answer: Any, p: Parameters) -> str:
    seen = []

    def policy(x: np.ndarray, t: float) -> Any:
        u = answer(x, t)
        seen.append(float(np.max(np.abs(u), initial=0.0)))
        return np.clip(u, -p.limit, p.limit)

    heavy = sb.Particle(m=1.1 * p.m)
    duration = 1.6 * _fastest(p)
    run = sb.simulate_clocked(heavy, [0.0, 0.0], policy, period=0.02, duration=duration)
    if max(seen) > p.limit * (1 + 1e-9):
        return f"your force reaches {max(seen):.3g} N, and the limit is {p.limit:g} N"
    place, speed = run.states[:, -1]
    if abs(place - p.d) > 0.03 * p.d:
        why = "it brakes too late" if place > p.d else "it is too slow, or brakes too early"
        return (
            f"after {duration:.2f} s it is at {place:.3g} m, not at {p.d:g} m: {why}; the mass is"
            " not the one you were told, so look at the state"
        )
    if abs(speed) > 0.05 * p.limit * _fastest(p) / p.m:
        return f"it is there after {duration:.2f} s, but moving, at {speed:.3g} m/s"
    return ""


def _plan(p: Parameters) -> Callable[..., Any]:
    """Push and brake by the clock."""
    T = _fastest(p)
    return lambda x, t: p.limit * ((t < T / 2) - float(T / 2 <= t < T))


def _braking(p: Parameters) -> Callable[..., Any]:
    """Follow the speed from which three quarters of the limit would stop it in time."""

    def policy(x: Any, t: float) -> float:
        off = p.d - x[0]
        speed = np.sign(off) * np.sqrt(1.5 * p.limit / p.m * abs(off))
        return float(np.clip(20 * p.m * (speed - x[1]), -p.limit, p.limit))

    return policy


def _pivot(rng: np.random.Generator) -> dict[str, float]:
    return {
        "x": round(float(rng.uniform(0.3, 1.2)), 2),
        "y": round(float(rng.uniform(0.3, 1.2)), 2),
    }


def _forces(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(rng.uniform(-2, 2, size=(2, 2))) for _ in range(8)]


def _torque(
    p: Parameters, *, pivot: float = 1.0, second: float = -1.0, sign: float = 1.0
) -> Callable[..., float]:
    def torque(r: Any, F: Any) -> float:
        a, b = r[0] - pivot * p.x, r[1] - pivot * p.y
        return float(sign * (a * F[1] + second * b * F[0]))

    return torque


def _product(p: Parameters) -> Callable[..., float]:
    """Sizes alone, as if the force were at a right angle."""
    return lambda r, F: float(np.hypot(r[0] - p.x, r[1] - p.y) * np.hypot(*F))


def _door(rng: np.random.Generator) -> dict[str, float]:
    width = round(float(rng.uniform(0.7, 1.1)), 2)
    return {
        "M": round(float(rng.uniform(12.0, 30.0)), 1),
        "w": width,
        "handle": round(width - float(rng.uniform(0.06, 0.12)), 2),
        "F": round(float(rng.uniform(8.0, 20.0)), 1),
    }


def _opening(
    p: Parameters, share: float = 1 / 3, lever: float | None = None, turn: float = np.pi
) -> float:
    """The time of a right angle: turn is twice the angle."""
    alpha = p.F * (lever or p.handle) / (share * p.M * p.w**2)
    return float(np.sqrt(turn / alpha))


EXERCISES = (
    Exercise(
        "06.1",
        "The fastest move",
        "compute",
        5,
        _move,
        _fastest,
        (
            Slip(
                "that is the time of 1 kg; a heavier mass takes longer",
                lambda p: 2 * np.sqrt(p.d / p.limit),
            ),
            Slip(
                "that is the time of pushing; the braking takes as long",
                lambda p: np.sqrt(p.m * p.d / p.limit),
            ),
            Slip(
                "that is pushing all the way: it would arrive moving",
                lambda p: np.sqrt(2 * p.m * p.d / p.limit),
            ),
            Slip("where is the square root?", lambda p: 4 * p.m * p.d / p.limit),
        ),
    ),
    Exercise(
        "06.2",
        "Where it turns back",
        "read off",
        5,
        _throw,
        _turn,
        (
            Slip("p grows by m v^2 / (2 u): the 1/2 is missing", lambda p: _turn(p, share=1.0)),
            Slip("that is the way it makes; it starts at p0", lambda p: _turn(p) - p.p0),
            Slip("where is the mass?", lambda p: _turn(p, mass=1.0)),
            Slip("it moves to the right first", lambda p: _turn(p, share=-0.5)),
        ),
        rtol=0.02,
    ),
    Exercise(
        "06.3",
        "The force of a motion",
        "derive",
        10,
        _smooth,
        _force,
        (
            Slip(
                "that is the acceleration; the force is m times it", lambda p: _force(p, mass=False)
            ),
            Slip(
                "each derivative in t brings a factor 1/T: two of them",
                lambda p: _force(p, power=1),
            ),
            Slip(
                "you differentiated in s and forgot that s = t/T",
                lambda p: _force(p, power=0),
            ),
            Slip(
                "that is m times the velocity; differentiate once more",
                lambda p: _force(p, power=1, order=1),
            ),
            Slip("it must push first and brake later", lambda p: _force(p, sign=-1.0)),
        ),
        points=2,
        inputs=_times,
    ),
    Exercise(
        "06.4",
        "Gains within a limit",
        "design",
        20,
        _target,
        _critical,
        (
            Slip("both gains must be positive", lambda p: _critical(p) * [1, -1]),
            Slip("at the start the force is kp d", lambda p: _critical(p) * [2, 1.5]),
            Slip("it overshoots by", lambda p: _critical(p) * [1, 0.5]),
            Slip("too little stiffness", lambda p: _critical(p) * [1, 4]),
            Slip("so much damping that it creeps", lambda p: _critical(p) * [0.1, 0.32]),
        ),
        points=3,
        judge=_judge_gains,
    ),
    Exercise(
        "06.5",
        "Fast, and not fooled",
        "play",
        20,
        _move,
        _braking,
        (
            Slip("look at the state", _plan),
            Slip("but moving", lambda p: lambda x, t: 2.2 / 4 / 1.6**2 * p.limit),
            Slip("look at the state", lambda p: lambda x, t: 0.0),
            Slip("and the limit is", lambda p: lambda x, t: 2 * p.limit),
        ),
        points=3,
        judge=_judge_policy,
    ),
    Exercise(
        "06.6",
        "A torque that is not one",
        "debug",
        10,
        _pivot,
        _torque,
        (
            Slip(
                "r must be measured from the pivot, not from the origin",
                lambda p: _torque(p, pivot=0.0),
            ),
            Slip("r x F = r_x F_y - r_y F_x: a minus", lambda p: _torque(p, second=1.0)),
            Slip(
                "two mistakes: from where is r measured, and which sign has r_y F_x?",
                lambda p: _torque(p, pivot=0.0, second=1.0),
            ),
            Slip("counter-clockwise is positive", lambda p: _torque(p, sign=-1.0)),
            Slip("only the part of F at a right angle to r turns it", _product),
        ),
        points=2,
        inputs=_forces,
    ),
    Exercise(
        "06.7",
        "A door",
        "compute",
        10,
        _door,
        _opening,
        (
            Slip("a door is no point mass at its edge: I = M w^2 / 3", lambda p: _opening(p, 1.0)),
            Slip("the moment arm reaches to the handle", lambda p: _opening(p, lever=p.w)),
            Slip(
                "angle = alpha t^2 / 2: the 1/2 is missing",
                lambda p: _opening(p, turn=np.pi / 2),
            ),
            Slip("angles in radians", lambda p: _opening(p, turn=180.0)),
        ),
    ),
)
