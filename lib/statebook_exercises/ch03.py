"""Exercises of chapter 03, integration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip

MU = 398_600.4418  # the Earth [km^3/s^2]


def _round(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


# ---- 03.1: the falling ball of the chapter ----


def _method(rng: np.random.Generator) -> dict[str, Any]:
    name = str(rng.choice(["heun", "rk4"]))
    low, high = (-3.2, -1.5) if name == "heun" else (-7.0, -3.8)
    return {"method": name, "error": _round(10 ** rng.uniform(low, high), 2)}


def _looks(name: str, error: float, m: float = 0.4, drag: float = 0.02, T: float = 2.0) -> float:
    """Evaluations that a method needs for an error, from its error in 24 steps and its order."""
    final = np.sqrt(m * 9.8 / drag)
    exact = -final * np.tanh(9.8 * T / final + np.arctanh(3.0 / final))
    method = sb.METHODS[name]
    fall = sb.integrate(lambda v, t: -9.8 + drag / m * v**2, -3.0, 24, T / 24, method=name)
    ratio = abs(fall[1][-1] - exact) / error
    return float(24 * method.stages * ratio ** (1 / method.order))


def _other(p: Parameters) -> str:
    return "rk4" if p.method == "heun" else "heun"


# ---- 03.2 ----


def _equation(rng: np.random.Generator) -> dict[str, float]:
    return {
        "a": round(float(rng.uniform(0.5, 3)), 1),
        "b": round(float(rng.uniform(1, 3)), 1),
        "x0": round(float(rng.uniform(1, 4)), 1),
        "dt": round(float(rng.uniform(0.1, 0.3)), 2),
    }


def _two_steps(p: Parameters, *, later: int = 0, step: float | None = None) -> float:
    """Two steps; with later = 1 their rates are taken at the end, step replaces dt before them."""
    x = p.x0
    for k in range(2):
        x += (p.dt if step is None else step) * (p.a * (k + later) * p.dt - p.b * x)
    return float(x)


# ---- 03.3 ----


def _rate(rng: np.random.Generator) -> dict[str, float]:
    return {"a": round(float(rng.uniform(1.2, 2.8)), 2)}


def _law(p: Parameters, factor: float, power: int, t: int, dt: int) -> Callable[..., Any]:
    """factor a^power t^t dt^dt."""
    return lambda time, step: factor * p.a**power * time**t * step**dt


def _times(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([0.5, 0.01], [3, 0.1], size=(12, 2)).tolist()]


# ---- 03.4 ----


def _thrown(rng: np.random.Generator) -> dict[str, float]:
    return {
        "v0": round(float(rng.uniform(5, 12)), 1),
        "g": round(float(rng.choice([1.62, 3.73, 8.87, 9.8])) + float(rng.uniform(0, 0.05)), 2),
    }


def _height(p: Parameters, *, steps: Callable[[float], int] = round, first: int = 0) -> Any:
    """Euler's height; with first = 1 the velocity is updated before it is used."""

    def height(T: float, dt: float) -> float:
        N = steps(T / dt)
        return float(p.v0 * N * dt - p.g * dt**2 * N * (N - 1 + 2 * first) / 2)

    return height


def _flights(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """Durations of whole steps; a division and int lose a step in most of them."""
    return [(0.3, 0.1), (0.6, 0.2), (0.7, 0.1), (1.2, 0.4), (0.5, 0.25), (1.4, 0.2)]


# ---- 03.5 ----

TOLERANCE, DURATION, MOST_STEPS = 0.02, 5.0, 20_000


def _spring(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.5, 2)), 2),
        "k": round(float(rng.uniform(5, 15)), 1),
        "b": round(float(rng.uniform(0.5, 1.2)), 2),
    }


def _error_of_step(p: Parameters, dt: float) -> float:
    """Largest error in position of Euler's motion from 1 m at rest [m]."""
    A = np.array([[0.0, 1.0], [-p.k / p.m, -p.b / p.m]])
    N = int(DURATION / dt + 1e-9)
    exact, euler = scipy.linalg.expm(A * dt), np.eye(2) + A * dt
    x = y = np.array([1.0, 0.0])
    largest = 0.0
    for _ in range(N):
        x, y = exact @ x, euler @ y
        largest = max(largest, abs(x[0] - y[0]))
    return float(largest)


def _step(p: Parameters) -> float:
    """A step whose error is four fifths of what is allowed."""
    low, high = DURATION / MOST_STEPS, p.b / p.k
    return float(
        scipy.optimize.brentq(
            lambda dt: _error_of_step(p, dt) - 0.8 * TOLERANCE, low, high, xtol=1e-7, rtol=1e-3
        )
    )


EXPLODES = "z lies outside the circle |1 + z| = 1: the computed motion grows"
TOO_LONG = "more than the 0.02 m allowed: Euler's error is proportional to the step"
TOO_SHORT = "a longer step would do: the specification asks for half of the allowed error at least"


def _judge_step(answer: Any, p: Parameters) -> str:
    dt = float(answer)
    if dt <= 0:
        return "a step is a positive time"
    if dt > p.b / p.k:
        return EXPLODES
    if dt * MOST_STEPS < DURATION:
        return TOO_SHORT
    error = _error_of_step(p, dt)
    if error > TOLERANCE:
        return f"the error reaches {error:.3g} m, {TOO_LONG}"
    return TOO_SHORT if error < TOLERANCE / 2 else ""


# ---- 03.6 ----

BUDGET, MISS = 80, 5.0  # steps, km


def _orbit(rng: np.random.Generator) -> dict[str, float]:
    return {
        "a": round(float(rng.uniform(24_000, 30_000))),
        "e": round(float(rng.uniform(0.68, 0.73)), 3),
    }


def _fall(x: np.ndarray, t: float) -> np.ndarray:
    return np.array([*x[2:], *(-MU * x[:2] / np.hypot(*x[:2]) ** 3)])


NOT_POSITIVE = "a step is a positive time"
SPENT = f"the {BUDGET} steps are used up before the turn is complete: longer steps somewhere"
MISSED = f"km from its start, and {MISS:g} km are allowed: where is the motion fast?"


def _judge_rule(answer: Any, p: Parameters) -> str:
    period = 2 * np.pi * np.sqrt(p.a**3 / MU)
    apogee = p.a * (1 + p.e)
    start = np.array([-apogee, 0.0, 0.0, -np.sqrt(MU * (2 / apogee - 1 / p.a))])
    x, t = start, 0.0
    for _ in range(BUDGET):
        step = float(np.asarray(answer(float(np.hypot(*x[:2])))))
        if not step > 0:
            return NOT_POSITIVE
        step = min(step, period - t)
        x = sb.integrate(_fall, x, 1, step)[1][-1]
        t += step
        if t >= period * (1 - 1e-12):
            miss = float(np.hypot(*(x[:2] - start[:2])))
            return f"the satellite ends {miss:.3g} {MISSED}" if miss > MISS else ""
    return SPENT


def _rule(p: Parameters, power: float = 1.5, share: float = 0.9) -> Callable[[float], float]:
    """Steps as r^power that need a share of the budget."""
    anomaly = np.linspace(0, 2 * np.pi, 2001)[:-1]
    r = p.a * (1 - p.e * np.cos(anomaly))
    density = r / p.a * np.sqrt(p.a**3 / MU) * r**-power  # dt = r / (a n) dE
    scale = float(np.mean(density) * 2 * np.pi / (share * BUDGET))
    return lambda distance: scale * distance**power


# ---- 03.7 ----


def _long_throw(rng: np.random.Generator) -> dict[str, float]:
    steps, dt = int(rng.integers(8, 20)), round(float(rng.uniform(0.05, 0.2)), 2)
    thrown = _thrown(rng)
    return {**thrown, "dt": dt, "T": round(steps * dt, 4)}


def _between(p: Parameters) -> float:
    """Largest |height - last sample|, just before a grid point."""
    t = p.dt * np.arange(round(p.T / p.dt))
    moved = p.v0 * p.dt - p.g * t * p.dt - p.g * p.dt**2 / 2
    return float(np.abs(moved - p.g * t * p.dt / 2).max())


# ---- 03.8 ----


def _ramp(rng: np.random.Generator) -> dict[str, float]:
    return {
        "b": round(float(rng.uniform(30, 90))),
        "u0": round(float(rng.uniform(2, 5)), 1),
        "s": round(float(rng.uniform(0.1, 0.6)), 2),
        "T": round(float(rng.uniform(2, 5)), 1),
        "dt": round(float(rng.choice([0.01, 0.02, 0.05])), 2),
    }


def _cost(p: Parameters) -> float:
    return float(p.b * p.s * p.T * p.dt / 2)


EXERCISES = (
    Exercise(
        "03.1",
        "How many looks?",
        "read off",
        5,
        _method,
        lambda p: _looks(p.method, p.error),
        (
            Slip(
                "that is the number of steps: each step looks more than once",
                lambda p: _looks(p.method, p.error) / sb.METHODS[p.method].stages,
            ),
            Slip(
                "that is the line of another method",
                lambda p: _looks(_other(p), p.error),
            ),
            Slip("that is Euler's line", lambda p: _looks("euler", p.error)),
        ),
        rtol=0.25,
    ),
    Exercise(
        "03.2",
        "Two steps by hand",
        "compute",
        10,
        _equation,
        _two_steps,
        (
            Slip(
                "the rate of a step is taken at its beginning, t_k, not at its end",
                lambda p: _two_steps(p, later=1),
            ),
            Slip("that is x_1; one more step", lambda p: p.x0 * (1 - p.b * p.dt)),
            Slip(
                "the rate has changed after the first step: look again, at x_1 and t_1",
                lambda p: p.x0 * (1 - 2 * p.b * p.dt),
            ),
            Slip(
                "a rate times a time is a change: where is dt?", lambda p: _two_steps(p, step=1.0)
            ),
        ),
    ),
    Exercise(
        "03.3",
        "The error of Heun's method",
        "derive",
        20,
        _rate,
        lambda p: _law(p, 1 / 6, 3, 1, 2),
        (
            Slip(
                "that is Euler's: Heun has one more term right", lambda p: _law(p, 1 / 2, 2, 1, 1)
            ),
            Slip(
                "that is the error of one step; there are t / dt steps",
                lambda p: _law(p, 1 / 6, 3, 0, 3),
            ),
            Slip(
                "the first term that is missing is that of z^3 in exp(z): what stands before it?",
                lambda p: _law(p, 1 / 2, 3, 1, 2),
            ),
            Slip(
                "of which power of z = a dt is the first missing term? a and dt come together",
                lambda p: _law(p, 1 / 6, 2, 1, 2),
            ),
        ),
        points=2,
        inputs=_times,
    ),
    Exercise(
        "03.4",
        "A loop that is short of breath",
        "debug",
        15,
        _thrown,
        _height,
        (
            Slip(
                "one mistake is left: Euler moves the ball with the velocity at the beginning of"
                " the step",
                lambda p: _height(p, first=1),
            ),
            Slip(
                "one mistake is left: int(0.3 / 0.1) is 2, so a step is missing",
                lambda p: _height(p, steps=int),
            ),
            Slip(
                "both mistakes are still there: count the steps, and see which velocity moves the"
                " ball",
                lambda p: _height(p, steps=int, first=1),
            ),
            Slip(
                "that is the exact parabola; Euler's height is asked for",
                lambda p: lambda T, dt: p.v0 * T - p.g * T**2 / 2,
            ),
        ),
        points=2,
        inputs=_flights,
    ),
    Exercise(
        "03.5",
        "Short enough, and no shorter",
        "design",
        20,
        _spring,
        _step,
        (
            Slip(EXPLODES, lambda p: 1.05 * p.b / p.k),
            Slip(TOO_LONG, lambda p: 0.9 * p.b / p.k),
            Slip(TOO_SHORT, lambda p: _step(p) / 4),
            Slip("a step is a positive time", lambda p: -_step(p)),
        ),
        points=3,
        judge=_judge_step,
    ),
    Exercise(
        "03.6",
        "Steps of your own",
        "play",
        20,
        _orbit,
        _rule,
        (
            Slip(MISSED, lambda p: lambda r: 2 * np.pi * np.sqrt(p.a**3 / MU) / (BUDGET - 1)),
            Slip(SPENT, lambda p: lambda r: 0.01 * np.sqrt(r**3 / MU)),
            Slip(NOT_POSITIVE, lambda p: lambda r: 0.0),
        ),
        points=3,
        judge=_judge_rule,
    ),
    Exercise(
        "03.7",
        "Which error?",
        "compute",
        10,
        _long_throw,
        lambda p: p.g * p.T * p.dt / 2,
        (
            Slip(
                "that holds the last computed height against the motion since then: even exact"
                " samples would have such an error. Compare at the grid points",
                _between,
            ),
            Slip("that is the error of one step; they add up", lambda p: p.g * p.dt**2 / 2),
            Slip(
                "a step misses half of g dt^2: on the way the velocity changes from 0 to g dt",
                lambda p: p.g * p.T * p.dt,
            ),
        ),
    ),
    Exercise(
        "03.8",
        "What the input costs",
        "compute",
        10,
        _ramp,
        _cost,
        (
            Slip(
                "a large Jacobian in u does no harm by itself; how fast does b u change?",
                lambda p: p.b * p.T * p.dt / 2,
            ),
            Slip(
                "the level of the input does no harm: with s = 0 Euler is exact",
                lambda p: p.b * p.u0 * p.T * p.dt / 2,
            ),
            Slip(
                "it would be 0 if Euler followed the rate to first order; it holds the rate for a"
                " step",
                lambda p: 0.0,
            ),
            Slip("that is the error of one step; they add up", lambda p: p.b * p.s * p.dt**2 / 2),
        ),
    ),
)
