"""Exercises of chapter 05, when the integrator lies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip

G = 9.8


def _spring(rng: np.random.Generator) -> dict[str, float]:
    """An underdamped spring, and a time."""
    m, k = round(float(rng.uniform(0.5, 3.0)), 2), round(float(rng.uniform(8.0, 40.0)), 1)
    ratio = float(rng.uniform(0.3, 0.5))  # of critical damping
    c = round(2 * ratio * np.sqrt(m * k), 2)
    period = 2 * np.pi / np.sqrt(k / m * (1 - ratio**2))
    return {"m": m, "k": k, "c": c, "t": round(float(rng.uniform(0.3, 0.45) * period), 2)}


def _rates(p: Parameters) -> tuple[float, float]:
    """The decay and the frequency of a spring."""
    sigma = p.c / (2 * p.m)
    return sigma, float(np.sqrt(p.k / p.m - sigma**2))


def _place(p: Parameters, sine: float = 1.0, decay: float = 1.0, free: bool = False) -> float:
    """Where the mass is at the time t, from rest at 1 m."""
    sigma, omega = _rates(p)
    omega = float(np.sqrt(p.k / p.m)) if free else omega
    turn = np.cos(omega * p.t) + sine * sigma / omega * np.sin(omega * p.t)
    return float(np.exp(-decay * sigma * p.t) * turn)


def _slowest(p: Parameters) -> float:
    return 2 / float(np.hypot(*_rates(p)))


def _amplitude(p: Parameters, sign: float = 1.0) -> float:
    """Euler's amplitude at h = c/k: the map turns by an angle with the cosine 1 - h c / 2 m."""
    cosine = 1 - p.c**2 / (2 * p.m * p.k)
    return float(np.sqrt(2 / (1 + sign * cosine)))


def _oscillator(rng: np.random.Generator) -> dict[str, float]:
    return {"w": round(float(rng.uniform(0.6, 2.5)), 2)}


def _moves(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-2, -2, 0.05], [2, 2, 0.4], size=(10, 3)).tolist()]


def _step(
    p: Parameters, *, fresh: bool = True, sign: float = 1.0, frequency: bool = True
) -> Callable[..., Any]:
    """Move y first, then x with the new y."""
    w = p.w if frequency else 1.0

    def move(x: float, y: float, h: float) -> np.ndarray:
        after = y + h * w * x
        return np.array([x - sign * h * w * (after if fresh else y), after])

    return move


def _x_first(p: Parameters) -> Callable[..., Any]:
    def move(x: float, y: float, h: float) -> np.ndarray:
        after = x - h * p.w * y
        return np.array([after, y + h * p.w * after])

    return move


def _circle(rng: np.random.Generator) -> dict[str, float]:
    return {
        "r": round(float(rng.uniform(0.6, 2.4)), 2),
        "theta": round(float(rng.uniform(0.4, 1.2)), 2),
        "t": round(float(rng.uniform(0.5, 1.8)), 2),
    }


def _turned(p: Parameters, angle: float) -> np.ndarray:
    return np.array([p.r * np.cos(angle), p.r * np.sin(angle)])


def _damper(rng: np.random.Generator) -> dict[str, float]:
    """A spring with a damper so strong that one mode is fast and one slow."""
    m, k = round(float(rng.uniform(0.3, 0.8)), 2), round(float(rng.uniform(10.0, 30.0)), 1)
    c = round(float(rng.uniform(3.0, 5.0) * np.sqrt(m * k)), 1)
    fast = (c + np.sqrt(c**2 - 4 * m * k)) / (2 * m)
    return {"m": m, "k": k, "c": c, "steps": int(np.ceil(5.0 * fast / (0.85 * 2.785)))}


def _modes(p: Parameters) -> np.ndarray:
    """The sizes of both eigenvalues, the fast one first."""
    return np.abs(np.roots([p.m, p.c, p.k]))


def _limit(p: Parameters) -> float:
    A = np.array([[0.0, 1.0], [-p.k / p.m, -p.c / p.m]])
    return float(sb.critical_step(A, "rk4"))


def _judge_step(answer: Any, p: Parameters) -> str:
    h = float(answer)
    if h <= 0:
        return "a step must be positive"
    if 5.0 / h > p.steps * (1 + 1e-9):
        return f"5 s take {np.ceil(5.0 / h):.0f} of these steps, and you have {p.steps}"
    if h > _limit(p):
        growth = abs(np.polyval([1 / 24, 1 / 6, 1 / 2, 1, 1], -h * _modes(p).max()))
        return (
            f"the fast mode grows by {growth:.3g} per step: too long a step for it is too long"
            " for all"
        )
    return ""


def _standing(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.3, 0.9)), 2),
        "L": round(float(rng.uniform(0.4, 0.9)), 2),
        "b": round(float(rng.uniform(0.1, 0.4)), 2),
    }


def _rise(p: Parameters) -> float:
    """The rate at which the standing pendulum begins to fall [1/s]."""
    return float(np.max(np.roots([p.m * p.L**2, p.b, -p.m * G * p.L])))


def _judge_lie(answer: Any, p: Parameters) -> str:
    h = float(answer)
    if h <= 0:
        return "a step must be positive"
    if h < 2 / _rise(p):
        return (
            f"with this step it falls: each step multiplies its angle by"
            f" {1 / abs(1 - h * _rise(p)):.3g}"
        )
    if h > 2.1 / _rise(p):
        return "it stands, but it would with a shorter step too; find one within 5 % of the least"
    return ""


EXERCISES = (
    Exercise(
        "05.1",
        "The true motion",
        "compute",
        10,
        _spring,
        _place,
        (
            Slip(
                "your formula starts with a velocity: let go at rest, it needs a sine term",
                lambda p: _place(p, sine=0.0),
            ),
            Slip(
                "the sine has the wrong sign: p'(0) must be 0",
                lambda p: _place(p, sine=-1.0),
            ),
            Slip("where is the decay?", lambda p: _place(p, decay=0.0)),
            Slip(
                "the damper slows the oscillation: its frequency is not sqrt(k/m)",
                lambda p: _place(p, free=True),
            ),
            Slip("the decay rate is c/(2m), half of c/m", lambda p: _place(p, decay=2.0)),
        ),
        points=2,
    ),
    Exercise(
        "05.2",
        "Euler's longest step",
        "compute",
        5,
        _spring,
        lambda p: p.c / p.k,
        (
            Slip("that is a rate, not a time", lambda p: p.k / p.c),
            Slip(
                "that is 2 over the size of lambda, right for a real eigenvalue; yours are complex",
                _slowest,
            ),
            Slip(
                "|1 + h lambda|^2 = 1 - h c/m + h^2 k/m must be 1, not 0",
                lambda p: p.c / (2 * p.k),
            ),
            Slip("that is the time constant of the decay", lambda p: 2 * p.m / p.c),
        ),
    ),
    Exercise(
        "05.3",
        "How far it swings for ever",
        "derive",
        15,
        _spring,
        _amplitude,
        (
            Slip(
                "Euler's first step leaves the mass where it is and gives it a velocity: it must"
                " swing further than its start",
                lambda p: 1.0,
            ),
            Slip(
                "close: the angle per step has the cosine 1 - h c/(2m); check 2/(1 + cos)",
                lambda p: _amplitude(p, -1.0),
            ),
            Slip("the square root is missing", lambda p: _amplitude(p) ** 2),
            Slip("turn the fraction over: it is more than 1", lambda p: 1 / _amplitude(p)),
        ),
        points=3,
    ),
    Exercise(
        "05.4",
        "An integrator that should not spiral",
        "debug",
        10,
        _oscillator,
        _step,
        (
            Slip(
                "that is Euler's method, and it spirals outward: x must use the new y",
                lambda p: _step(p, fresh=False),
            ),
            Slip("y first, then x: this moves x first", _x_first),
            Slip("the sign: x' = -w y", lambda p: _step(p, sign=-1.0)),
            Slip("where is w?", lambda p: _step(p, frequency=False)),
        ),
        points=2,
        inputs=_moves,
    ),
    Exercise(
        "05.5",
        "A place on the circle",
        "read off",
        5,
        _circle,
        lambda p: _turned(p, p.t + p.theta),
        (
            Slip(
                "that motion starts at the angle -theta: the phase is t + theta",
                lambda p: _turned(p, p.t - p.theta),
            ),
            Slip("where does it start? You forgot theta", lambda p: _turned(p, p.t)),
            Slip("x' = -y, y' = x turns counter-clockwise", lambda p: _turned(p, p.theta - p.t)),
        ),
        rtol=0.02,
    ),
    Exercise(
        "05.6",
        "A stiff damper on a budget",
        "design",
        20,
        _damper,
        lambda p: 0.95 * _limit(p),
        (
            Slip("too long a step for it is too long for all", lambda p: 2.785 / _modes(p).min()),
            Slip("too long a step for it is too long for all", lambda p: 1.1 * _limit(p)),
            Slip("5 s take", lambda p: 0.5 * _limit(p)),
            Slip("a step must be positive", lambda p: -0.1),
        ),
        points=3,
        judge=_judge_step,
    ),
    Exercise(
        "05.7",
        "The shortest lie",
        "play",
        15,
        _standing,
        lambda p: 2.04 / _rise(p),
        (
            Slip("with this step it falls", lambda p: 1.5 / _rise(p)),
            Slip("with this step it falls", lambda p: 0.05),
            Slip("it would with a shorter step too", lambda p: 3 / _rise(p)),
            Slip("a step must be positive", lambda p: 0.0),
        ),
        points=2,
        judge=_judge_lie,
    ),
)
