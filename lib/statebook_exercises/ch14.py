"""Exercises of chapter 14, trajectories."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import NOT_A_NUMBER, beyond, one_number


def _errors(rng: np.random.Generator) -> dict[str, float]:
    order, size = float(rng.uniform(1.6, 3.4)), float(rng.uniform(0.01, 0.09))
    return {
        "coarse": 0.2,
        "fine": 0.05,
        "error_coarse": float(f"{size:.3g}"),
        "error_fine": float(f"{size * 4**-order:.3g}"),
    }


def _order(p: Parameters) -> float:
    return float(np.log(p.error_coarse / p.error_fine) / np.log(p.coarse / p.fine))


def _storage(rng: np.random.Generator) -> dict[str, float]:
    return {
        "largest": round(float(rng.uniform(3.0, 15.0)), 1),
        "error": round(float(rng.uniform(0.5, 3.0)), 1),
    }


def _joined(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """Samples at uneven times, asked for in between, at a sample, and at the last one."""
    times = np.cumsum(rng.uniform(0.2, 1.0, 6)) + p.shift
    values = rng.uniform(-2, 2, 6)
    asked = [*rng.uniform(times[0], times[-1], 6), times[2], times[-1]]
    return [(times.copy(), values.copy(), float(t)) for t in asked]


def _between(
    rule: Callable[[np.ndarray, np.ndarray, float, int], float],
) -> Callable[[Parameters], Callable[..., float]]:
    """Return an interpolation that applies a rule in the segment k that holds t."""

    def interpolate(times: Any, values: Any, t: float) -> float:
        times, values = np.asarray(times), np.asarray(values)
        k = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2))
        return float(rule(times, values, t, k))

    return lambda p: interpolate


def _line(times: np.ndarray, x: np.ndarray, t: float, k: int) -> float:
    part = (t - times[k]) / (times[k + 1] - times[k])
    return float(x[k] + part * (x[k + 1] - x[k]))


def _even(p: Parameters) -> Callable[..., float]:
    """Straight lines, as if the samples were evenly spaced."""
    return lambda times, values, t: float(
        np.interp(t, np.linspace(times[0], times[-1], len(times)), values)
    )


def _wheel(rng: np.random.Generator) -> dict[str, float]:
    return {"speed": round(float(rng.uniform(3.0, 5.5)), 2), "first": round(rng.uniform(-3, 3), 2)}


def _turns(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    found = []
    for sign in (1, -1, 1, -1):
        times = np.cumsum(rng.uniform(0.1, 0.5, 8))
        angles = p.first + sign * p.speed * times + rng.uniform(-0.1, 0.1, 8)
        found.append((times, np.asarray(sb.wrap_angle(angles))))
    return found


def _speeds(
    law: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Callable[[Parameters], Callable[..., Any]]:
    """Return the function (times, angles) -> law(steps of time, steps of angle)."""
    return lambda p: lambda times, angles: law(np.diff(times), np.diff(angles))


def _decay(rng: np.random.Generator) -> dict[str, float]:
    rate = round(float(rng.uniform(0.8, 3.0)), 2)
    return {"rate": rate, "T": round(5 / rate, 2), "error": 0.01}


def _shares(p: Parameters) -> np.ndarray:
    """Nine times with equal shares of the integral of sqrt(p'') = rate exp(-rate t / 2)."""
    share = np.linspace(0, 1, 9) * (1 - np.exp(-p.rate * p.T / 2))
    times = -2 / p.rate * np.log1p(-share)
    times[-1] = p.T
    return np.asarray(times)


def _judge_samples(answer: Any, p: Parameters) -> str:
    times = np.asarray(answer, dtype=float)
    if not np.all(np.diff(times) > 0):
        return "the times must increase"
    if abs(times[0]) > 1e-9 or abs(times[-1] - p.T) > 1e-6:
        return f"the first time must be 0 and the last T, {p.T:g} s"
    fine = np.linspace(0, p.T, 20001)
    missed = np.abs(np.interp(fine, times, np.exp(-p.rate * times)) - np.exp(-p.rate * fine))
    if beyond(missed.max(), p.error):
        return (
            "the straight lines miss the motion by more than allowed:"
            f" {missed.max():.3g} m near {fine[np.argmax(missed)]:.2f} s, and {p.error:g} m are"
            " allowed; spend the samples where the curve bends"
        )
    return ""


def _corner(rng: np.random.Generator) -> dict[str, float]:
    first, second = (round(float(rng.uniform(0.6, 2.5)), 1) for _ in range(2))
    limit = round(float(rng.uniform(0.8, 3.0)), 1)
    needed = 2 * (np.sqrt(first) + np.sqrt(second)) / np.sqrt(limit)
    return {"first": first, "second": second, "limit": limit, "T": round(1.1 * needed, 2)}


def _legs(p: Parameters) -> Callable[[float], float]:
    """Half of each leg's time speeding up, half slowing down."""
    roots = np.sqrt([p.first, p.second])
    middle = p.T * roots[0] / roots.sum()

    def clock(t: float) -> float:
        start, length, duration = (
            (0.0, p.first, middle) if t < middle else (p.first, p.second, p.T - middle)
        )
        f = (t - (0.0 if t < middle else middle)) / duration
        return float(start + length * (2 * f**2 if f < 0.5 else 1 - 2 * (1 - f) ** 2))

    return clock


def _judge_clock(answer: Any, p: Parameters) -> str:
    times = np.linspace(0, p.T, 401)
    s = np.array([one_number(answer(float(t))) for t in times])
    if np.isnan(s).any():
        return NOT_A_NUMBER
    whole = p.first + p.second
    if abs(s[0]) > 1e-6 or abs(s[-1] - whole) > 1e-6:
        return f"the clock must begin at s = 0 and end at s = {whole:g} m, at the time T"
    if np.diff(s).min() < -1e-9:
        return "the clock runs backwards: s must not fall"
    s = np.concatenate([np.zeros(2), s, np.full(2, whole)])  # at rest before and after
    places = np.stack([np.minimum(s, p.first), np.maximum(s - p.first, 0)])
    felt = np.hypot(*np.diff(places, 2)) / (p.T / 400) ** 2
    if felt.max() > 1.02 * p.limit:
        k = int(np.argmax(felt > 1.02 * p.limit))  # the first
        if abs(s[k + 1] - p.first) < 0.05 * whole:
            return (
                "too fast round the corner: there the direction of the velocity jumps, and only"
                " one speed allows that"
            )
        return (
            f"the acceleration is too large: {felt[k]:.3g} m/s^2 at s = {s[k + 1]:.2f} m,"
            f" and {p.limit:g} m/s^2 are allowed"
        )
    return ""


EXERCISES = (
    Exercise(
        "14.1",
        "An order from two errors",
        "read off",
        5,
        _errors,
        _order,
        (
            Slip(
                "that is the ratio of the errors: the order is a slope in a log-log plot",
                lambda p: p.error_coarse / p.error_fine,
            ),
            Slip(
                "the step became four times smaller, not two times",
                lambda p: float(np.log2(p.error_coarse / p.error_fine)),
            ),
            Slip("turned over: rise over run", lambda p: 1 / _order(p)),
            Slip(
                "divide by the logarithm of the steps' ratio",
                lambda p: float(np.log(p.error_coarse / p.error_fine)),
            ),
        ),
        rtol=0.02,
    ),
    Exercise(
        "14.2",
        "How far apart",
        "compute",
        5,
        _storage,
        lambda p: np.sqrt(8 * p.error * 1e-3 / p.largest),
        (
            Slip("the bound holds the step squared", lambda p: 8 * p.error * 1e-3 / p.largest),
            Slip(
                "the error of a chord is an eighth of dt^2 max|p''|, not a half",
                lambda p: np.sqrt(2 * p.error * 1e-3 / p.largest),
            ),
            Slip("where is the 8?", lambda p: np.sqrt(p.error * 1e-3 / p.largest)),
            Slip(
                "the error is given in millimetres",
                lambda p: np.sqrt(8 * p.error / p.largest),
            ),
            Slip(
                "turned over: a sharper bend needs a smaller step",
                lambda p: np.sqrt(8 * p.largest * p.error * 1e-3),
            ),
        ),
        rtol=0.01,
    ),
    Exercise(
        "14.3",
        "Between uneven samples",
        "derive",
        15,
        lambda rng: {"shift": round(float(rng.uniform(0.5, 5.0)), 2)},
        _between(_line),
        (
            Slip("the samples are not evenly spaced: divide by this segment's own time", _even),
            Slip(
                "that holds the sample before; a straight line goes on to the next",
                _between(lambda times, x, t, k: x[k + 1] if t == times[-1] else x[k]),
            ),
            Slip(
                "that is the nearest sample",
                lambda p: lambda times, x, t: float(x[np.argmin(np.abs(np.asarray(times) - t))]),
            ),
            Slip(
                "the fraction runs the wrong way: at t_k it is 0",
                _between(lambda times, x, t, k: x[k] + x[k + 1] - _line(times, x, t, k)),
            ),
        ),
        points=2,
        inputs=_joined,
    ),
    Exercise(
        "14.4",
        "A tachometer that jumps",
        "debug",
        10,
        _wheel,
        _speeds(lambda dt, step: sb.wrap_angle(step) / dt),
        (
            Slip(
                "where the angle jumps from pi to -pi the wheel goes on: take the short way",
                _speeds(lambda dt, step: step / dt),
            ),
            Slip(
                "a step of an angle is wrapped, not a speed: wrap before you divide",
                _speeds(lambda dt, step: sb.wrap_angle(step / dt)),
            ),
            Slip(
                "the wheel may turn backwards: keep the sign",
                _speeds(lambda dt, step: np.abs(sb.wrap_angle(step)) / dt),
            ),
            Slip(
                "the samples are not evenly spaced: each step has its own time",
                _speeds(lambda dt, step: sb.wrap_angle(step) / dt.mean()),
            ),
            Slip(
                "not every step is positive: a wheel may turn backwards",
                _speeds(lambda dt, step: np.mod(step, 2 * np.pi) / dt),
            ),
        ),
        points=2,
        inputs=_turns,
    ),
    Exercise(
        "14.5",
        "Nine samples",
        "design",
        20,
        _decay,
        _shares,
        (
            Slip("spend the samples where the curve bends", lambda p: np.linspace(0, p.T, 9)),
            Slip("spend the samples where the curve bends", lambda p: p.T - _shares(p)[::-1]),
            Slip("the times must increase", lambda p: _shares(p)[::-1]),
            Slip("the first time must be 0", lambda p: 0.9 * _shares(p)),
        ),
        points=3,
        judge=_judge_samples,
    ),
    Exercise(
        "14.6",
        "Round the corner in time",
        "play",
        25,
        _corner,
        _legs,
        (
            Slip(
                "the acceleration is too large",
                lambda p: lambda t: (p.first + p.second) * t / p.T,
            ),
            Slip(
                "too fast round the corner",
                lambda p: (
                    lambda t: (p.first + p.second) * (3 * (t / p.T) ** 2 - 2 * (t / p.T) ** 3)
                ),
            ),
            Slip("the clock must begin at s = 0 and end at", lambda p: lambda t: 0.5 * _legs(p)(t)),
            Slip("the clock must begin at s = 0 and end at", lambda p: lambda t: t),
        ),
        points=3,
        judge=_judge_clock,
    ),
)
