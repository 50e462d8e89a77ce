"""Exercises of chapter 02, discrete time and stacking."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

# ---- 02.1: the cart of the chapter, m = 2 kg, kp = 18 N/m, kd = 12 N s/m, from 1 m ----


def _clock(rng: np.random.Generator) -> dict[str, float]:
    return {"h": round(float(rng.uniform(4, 15)), 1)}


def _gap(p: Parameters) -> float:
    """Largest gap [mm] of a control that is late by h / 2, to first order in h [ms].

    x'' + 6 x' + 9 x = 0 from 1 at rest has the double rate -3; e obeys e'' + 6 e' + 9 e =
    -u' / (2 m) with u = m x''.
    """
    t = np.linspace(0, 3, 30001)
    # e'' + 6 e' + 9 e = -x''' / 2 from rest, x = (1 + 3 t) exp(-3 t): x''' = 27 (2 - 3 t) exp(-3 t)
    e = -(13.5 * t**2 - 6.75 * t**3) * np.exp(-3 * t)
    return float(np.abs(e).max() * p.h)


# ---- 02.2, 02.4: a cart on a clock ----


def _cart(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(1, 4)), 1),
        "h": round(float(rng.uniform(0.1, 0.25)), 2),
        "kp": round(float(rng.uniform(5, 9)), 1),
        "kd": round(float(rng.uniform(3, 6)), 1),
        "p": round(float(rng.uniform(0.5, 2)), 1),
        "v": round(float(rng.uniform(0.4, 1.5)), 1),
    }


def _tick(
    p: Parameters, x: Any, half: float = 0.5, moved: bool = False, sign: float = -1
) -> tuple[float, float]:
    """One period; moved: the force for the velocity is computed anew, from the new position."""
    u = sign * (p.kp * x[0] + p.kd * x[1])
    q = x[0] + p.h * x[1] + half * p.h**2 / p.m * u
    if moved:
        u = sign * (p.kp * q + p.kd * x[1])
    return q, x[1] + p.h / p.m * u


def _after(p: Parameters, half: float = 0.5, moved: bool = False) -> Callable[[int], float]:
    def after(k: int) -> float:
        x = (p.p, p.v)
        for _ in range(k):
            x = _tick(p, x, half, moved)
        return x[0]

    return after


def _ticks(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(k,) for k in (1, 2, 3, 5, 8)]


# ---- 02.3: a mass on a hardening spring ----


def _spring(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.5, 0.9)), 2),
        "k": round(float(rng.uniform(2, 5)), 1),
        "b": round(float(rng.uniform(0.2, 0.8)), 2),
    }


def _stack(
    p: Parameters, top: str = "velocity", mass: bool = True, spring: float = 1.0, power: int = 3
) -> Callable[[Any, Any], Any]:
    def g(y: Any, u: Any) -> Any:
        x, v = y
        force = u - spring * p.k * x**power - p.b * v
        f = force / p.m if mass else force
        return np.array({"velocity": [v, f], "copy": [f, f], "turned": [f, v]}[top])

    return g


def _states(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(rng.uniform(-2, 2, 2), float(rng.uniform(-3, 3))) for _ in range(12)]


# ---- 02.5: gains for a slow clock ----

SETTLED, OVERSHOOT, LATEST = 0.02, 0.05, 12  # m, m, ticks


def _slow(rng: np.random.Generator) -> dict[str, float]:
    m, h = round(float(rng.uniform(1, 4)), 1), round(float(rng.uniform(0.2, 0.4)), 2)
    return {"m": m, "h": h, "limit": round(0.45 * m / h**2, 1)}


def _gains(p: Parameters, z: float = 0.45) -> np.ndarray:
    """Gains that put both eigenvalues of the loop on the clock at z."""
    kp = (1 - z) ** 2 * p.m / p.h**2
    return np.array([kp, (1 + kp * p.h**2 / (2 * p.m) - z**2) * p.m / p.h])


BREAKS = (
    "the loop on the clock is unstable: the force overreacts; see the bounds 2 m / kd, 2 kd / kp"
)
FORCE = "and the motor's limit is"
PAST = "m past the goal, and 0.05 m are allowed: more damping"
LATE = "it is still on its way after 12 ticks"


def _judge_gains(answer: Any, p: Parameters) -> str:
    kp, kd = map(float, answer)
    loop = np.array([_tick(Parameters(**{**vars(p), "kp": kp, "kd": kd}), e) for e in np.eye(2)]).T
    if np.abs(np.linalg.eigvals(loop)).max() >= 1:
        return BREAKS
    x, path = np.array([1.0, 0.0]), []
    for _ in range(LATEST + 100):
        path.append(x)
        x = loop @ x
    positions, forces = np.array(path)[:, 0], np.array(path) @ [kp, kd]
    largest = np.abs(forces).max()
    if beyond(largest, p.limit):
        return f"the force reaches {largest:.3g} N, {FORCE} {p.limit:g} N"
    if positions.min() < -OVERSHOOT:
        return f"the cart swings {-positions.min():.3g} {PAST}"
    far = np.abs(positions[LATEST:]).max()
    return f"{LATE}, {far:.3g} m off" if far > SETTLED else ""


# ---- 02.6: a ball against the wind ----

NEAR = 0.1  # m


def _throw(rng: np.random.Generator) -> dict[str, float]:
    p = {
        "m": round(float(rng.uniform(0.05, 0.09)), 3),
        "c": round(float(rng.uniform(0.02, 0.04)), 3),
        "wind": -round(float(rng.uniform(0.05, 0.15)), 2),
        "x": round(float(rng.uniform(7, 10)), 1),
        "y": round(float(rng.uniform(2, 4)), 1),
    }
    return {**p, "limit": round(1.04 * _least(Parameters(**p)), 2)}


def _aimed(p: Parameters, t: Any, wind: float | None = None) -> Any:
    """First velocity, in columns, of a ball from the origin that is at the target at time t."""
    tau = p.m / p.c
    last = np.array([(p.wind if wind is None else wind) / p.c, -9.8 * tau])[:, None]
    return last + (np.array([[p.x], [p.y]]) - last * t) / (tau * (1 - np.exp(-t / tau)))


TIMES = np.linspace(0.3, 4, 3701)


def _least(p: Parameters) -> float:
    return float(np.hypot(*_aimed(p, TIMES)).min())


def _slowest(p: Parameters, wind: float | None = None) -> np.ndarray:
    velocities = _aimed(p, TIMES, wind)
    return np.asarray(velocities[:, np.hypot(*velocities).argmin()])


FAST = "m/s, and the arm gives"
WIDE = "m, and 0.1 m are allowed: do wind, weight and drag all have their part and sign?"


def _judge_throw(answer: Any, p: Parameters) -> str:
    v = np.asarray(answer, dtype=float)
    if beyond(np.hypot(*v), p.limit):
        return (
            f"that is {np.hypot(*v):.4g} {FAST} {p.limit:g} m/s: neither the quickest flight nor a"
            " high one is the slowest throw; try times of arrival in between"
        )
    tau, t = p.m / p.c, np.linspace(0, 6, 6001)
    last = np.array([p.wind / p.c, -9.8 * tau])
    path = np.outer(last, t) + np.outer(v - last, tau * (1 - np.exp(-t / tau)))
    miss = float(np.hypot(path[0] - p.x, path[1] - p.y).min())
    return f"the ball misses the target by {miss:.2g} {WIDE}" if miss > NEAR else ""


def _in_vacuum(p: Parameters) -> np.ndarray:
    """The slowest throw without air: its speed has the square g (y + distance)."""
    distance = np.hypot(p.x, p.y)
    speed = np.sqrt(9.8 * (p.y + distance))
    angle = np.arctan2(p.y + distance, p.x)
    return np.array([speed * np.cos(angle), speed * np.sin(angle)])


EXERCISES = (
    Exercise(
        "02.1",
        "The price of a clock",
        "read off",
        5,
        _clock,
        _gap,
        (
            Slip(
                "the gap is proportional to h, not to its square: half the clock, half the gap",
                lambda p: _gap(p) * p.h / 20,
            ),
            Slip("that is the gap at 20 ms; how does it go with h?", lambda p: _gap(p) * 20 / p.h),
            Slip(
                "with a faster clock the gap is smaller",
                lambda p: _gap(p) * (20 / p.h) ** 2,
            ),
        ),
        rtol=0.1,
    ),
    Exercise(
        "02.2",
        "One tick",
        "compute",
        10,
        _cart,
        lambda p: np.array(_tick(p, (p.p, p.v))),
        (
            Slip(
                "under a constant force the position gains h^2 / (2 m) u as well",
                lambda p: np.array(_tick(p, (p.p, p.v), half=0.0)),
            ),
            Slip(
                "the position gains half of h^2 u / m: the velocity grows from its old value",
                lambda p: np.array(_tick(p, (p.p, p.v), half=1.0)),
            ),
            Slip(
                "the policy pulls back: both gains come with a minus",
                lambda p: np.array(_tick(p, (p.p, p.v), sign=1.0)),
            ),
            Slip(
                "the force is held for the whole period, also while the position changes",
                lambda p: np.array(_tick(p, (p.p, p.v), moved=True)),
            ),
        ),
    ),
    Exercise(
        "02.3",
        "Stack it",
        "derive",
        15,
        _spring,
        _stack,
        (
            Slip(
                "both halves are accelerations: the position changes at the rate of the velocity",
                lambda p: _stack(p, "copy"),
            ),
            Slip(
                "the halves are in the wrong order: y = (x, x'), so g = (x', x'')",
                lambda p: _stack(p, "turned"),
            ),
            Slip(
                "a force is not an acceleration: divide by the mass",
                lambda p: _stack(p, mass=False),
            ),
            Slip("the spring pulls back", lambda p: _stack(p, spring=-1.0)),
            Slip("this spring's force grows with the cube of x", lambda p: _stack(p, power=1)),
        ),
        points=2,
        inputs=_states,
    ),
    Exercise(
        "02.4",
        "A force that is not held",
        "debug",
        15,
        _cart,
        _after,
        (
            Slip(
                "one mistake is left: between ticks nobody looks, so the force stays what it was",
                lambda p: _after(p, moved=True),
            ),
            Slip(
                "one mistake is left: the position gains half of h^2 u / m",
                lambda p: _after(p, half=1.0),
            ),
            Slip(
                "both mistakes are still there: one in how the position moves, one in when the"
                " force is computed",
                lambda p: _after(p, half=1.0, moved=True),
            ),
        ),
        points=2,
        inputs=_ticks,
    ),
    Exercise(
        "02.5",
        "Gains for a slow clock",
        "design",
        20,
        _slow,
        _gains,
        (
            Slip(BREAKS, lambda p: np.array([p.m, 2.2 * p.m / p.h])),
            Slip(FORCE, lambda p: _gains(p, 0.05)),
            Slip(PAST, lambda p: _gains(p) * [1.0, 0.55]),
            Slip(LATE, lambda p: _gains(p, 0.8)),
        ),
        points=3,
        judge=_judge_gains,
    ),
    Exercise(
        "02.6",
        "Against the wind",
        "play",
        20,
        _throw,
        _slowest,
        (
            Slip(FAST, lambda p: _aimed(p, np.array([0.5]))[:, 0]),
            Slip(WIDE, _in_vacuum),
            Slip(WIDE, lambda p: _slowest(p, wind=0.0)),
        ),
        points=3,
        judge=_judge_throw,
    ),
)
