"""Exercises of 90, the errata: a page that is partly wrong, and a reading past the end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from statebook.grading.exercise import Exercise, Parameters, Slip

G = 9.8


def _sharp() -> float:
    """The largest (1 - cos phi) / phi, where tan(phi / 2) = phi."""
    return float(np.sin(scipy.optimize.brentq(lambda phi: np.tan(phi / 2) - phi, 2.0, 3.0)))


def _decay(p: Parameters, sine: float) -> float:
    """x(t) of x'' = -k x - c x' from (1, 0); the sine may be left out."""
    w = np.sqrt(p.k - p.c**2 / 4)
    return float(
        np.exp(-p.c * p.t / 2) * (np.cos(w * p.t) + sine * p.c / (2 * w) * np.sin(w * p.t))
    )


# Each statement: what holds, what is printed in its place, and the test that tells.
STATEMENTS: dict[str, tuple[Callable[[Parameters], Any], Callable[[Parameters], Any], str]] = {
    "a": (
        lambda p: p.u / (p.m * p.L**2) - G / p.L,
        lambda p: p.u / (p.m * p.L) + G,
        "without the torque, which way would it fall? And a moment of inertia is in kg m^2",
    ),
    "b": (
        lambda p: 2 * np.sqrt(p.m * p.d / p.f),
        lambda p: 2 * np.sqrt(p.d / p.f),
        "can it be the same for every mass? Test the units",
    ),
    "c": (
        lambda p: 2 * p.m * p.d / p.T**2,
        lambda p: p.m * p.d / p.T**2,
        "compare the work of the force with the kinetic energy at the end",
    ),
    "d": (
        lambda p: p.base / np.tan(p.phi),
        lambda p: 1 / (p.base * np.tan(p.phi)),
        "is that a length? A longer car needs more room",
    ),
    "e": (
        lambda p: _decay(p, 1.0),
        lambda p: _decay(p, 0.0),
        "which velocity does its solution have at t = 0?",
    ),
    "f": (
        lambda p: _sharp() * p.m * G * p.L,
        lambda p: p.m * G * p.L,
        "follow the energy on the way up: is the torque that holds it level needed?",
    ),
    "g": (
        lambda p: p.m * G * p.L / 2 * np.cos(p.q),
        lambda p: p.m * G * np.cos(p.q),
        "a torque is in newton metres: where is the lever?",
    ),
    "h": (
        lambda p: np.cos(p.t + p.q),
        lambda p: np.cos(p.t - p.q),
        "where is the point at t = 0, and just after?",
    ),
}


def _page(rng: np.random.Generator) -> dict[str, Any]:
    """Parameters, none of them 1, and eight numbers, three to five of which do not hold."""
    page: dict[str, Any] = {
        "m": round(float(rng.uniform(0.4, 0.8)), 2),
        "L": round(float(rng.uniform(0.3, 0.7)), 2),
        "u": round(float(rng.uniform(4.0, 7.0)), 1),
        "d": round(float(rng.uniform(1.5, 3.0)), 2),
        "f": round(float(rng.uniform(2.0, 4.0)), 1),
        "T": round(float(rng.uniform(1.5, 3.0)), 2),
        "base": round(float(rng.uniform(2.2, 3.4)), 2),
        "phi": round(float(rng.uniform(0.4, 0.6)), 2),
        "k": round(float(rng.uniform(8, 12)), 1),
        "c": round(float(rng.uniform(1.2, 1.8)), 2),
        "t": round(float(rng.uniform(0.3, 0.45)), 2),
        "q": round(float(rng.uniform(0.5, 1.0)), 2),
    }
    p = Parameters(**page)
    wrong = set(rng.choice(list(STATEMENTS), size=int(rng.integers(3, 6)), replace=False))
    page["claims"] = [
        float(f"{(printed if letter in wrong else right)(p):.4g}")
        for letter, (right, printed, _) in STATEMENTS.items()
    ]
    return page


def _holds(p: Parameters) -> np.ndarray:
    """1 for each statement that holds, to its four digits, and 0 for the others."""
    right = np.array([form(p) for form, _, _ in STATEMENTS.values()])
    return (np.abs(p.claims - right) <= 1e-3 * np.abs(right)).astype(float)


def _flipped(k: int) -> Callable[[Parameters], np.ndarray]:
    def answer(p: Parameters) -> np.ndarray:
        holds = _holds(p)
        holds[k] = 1 - holds[k]
        return holds

    return answer


def _judge_page(answer: Any, p: Parameters) -> str:
    if not np.isin(answer, (0, 1)).all():
        return "give 1 for each statement that holds and 0 for each that does not"
    off = np.flatnonzero(answer != _holds(p))
    if not len(off):
        return ""
    letter = list(STATEMENTS)[off[0]]
    more = "" if len(off) == 1 else f" ({len(off)} of the eight are not as you say)"
    return f"look again at {letter}: {STATEMENTS[letter][2]}{more}"


def _samples(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "dt": round(float(rng.uniform(0.15, 0.4)), 2),
        "samples": [round(float(x), 2) for x in rng.uniform(-2, 2, size=6)],
    }


def _reading(p: Parameters, weigh: Callable[[float], float]) -> Callable[..., Any]:
    """Samples read at t, the weight of the next one being some function of the part of a step."""

    def value(t: float) -> float:
        x = p.samples
        k = min(int(t / p.dt), len(x) - 2)
        return float(x[k] + weigh((t - k * p.dt) / p.dt) * (x[k + 1] - x[k]))

    return value


def _last_held(p: Parameters) -> Callable[..., Any]:
    """As it should be, but constant in the last interval."""
    inside = _reading(p, lambda part: part)
    return lambda t: inside(t) if t < (len(p.samples) - 2) * p.dt else float(p.samples[-1])


def _instants(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """Ten instants, two in the last interval, and both ends."""
    end = (len(p.samples) - 1) * p.dt
    times = [*rng.uniform(0, end, size=8), *rng.uniform(end - 0.8 * p.dt, end, size=2), 0.0, end]
    return [(float(t),) for t in times]


EXERCISES = (
    Exercise(
        "90.1",
        "An errata hunt",
        "debug",
        25,
        _page,
        _holds,
        (
            *(Slip(test, _flipped(k)) for k, (_, _, test) in enumerate(STATEMENTS.values())),
            Slip("give 1 for each statement that holds", lambda p: 2 + _holds(p)),
            Slip("of the eight are not as you say", lambda p: 1 - _holds(p)),
        ),
        points=4,
        judge=_judge_page,
    ),
    Exercise(
        "90.2",
        "Reading past the end",
        "debug",
        15,
        _samples,
        lambda p: _reading(p, lambda part: part),
        (
            Slip(
                "half a step on it should be half way to the next sample",
                lambda p: _reading(p, lambda part: part * p.dt),
            ),
            Slip(
                "between two samples it should change",
                lambda p: _reading(p, lambda part: float(part >= 1)),
            ),
            Slip(
                "between two samples it should not jump",
                lambda p: _reading(p, lambda part: float(part >= 0.5)),
            ),
            Slip(
                "in the last interval there is a next sample too",
                _last_held,
            ),
        ),
        points=2,
        inputs=_instants,
    ),
)
