"""Exercises of primer 80, eigenvalues and modes."""

from __future__ import annotations

from typing import Any

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond


def _tanks(rng: np.random.Generator) -> dict[str, float]:
    """Two tanks that are not the primer's."""
    return {
        "leak": round(float(rng.uniform(0.05, 0.25)), 3),
        "pipe": round(float(rng.uniform(0.3, 0.9)), 2),
    }


def _wagon(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(2.0, 9.0)), 1),
        "tau": round(float(rng.uniform(0.2, 0.8)), 2),
    }


_SLOW = "the envelope shrinks too slowly: its time constant is"
_RINGS = "it rings: the damping ratio is"
_CREEPS = "it creeps: the damping ratio is"
_FALLS = "spring and damper must both be positive"


def _judge_wagon(answer: Any, p: Parameters) -> str:
    k, d = map(float, answer)
    if k <= 0 or d <= 0:
        return f"{_FALLS}, got {k:g} and {d:g}"
    zeta = d / (2 * np.sqrt(k * p.m))
    if beyond(0.6, zeta):
        return f"{_RINGS} {zeta:.2g}; 0.6 to 0.9 is asked for"
    if beyond(zeta, 0.9):
        return f"{_CREEPS} {zeta:.2g}; 0.6 to 0.9 is asked for"
    tau = 2 * p.m / d
    if beyond(tau, p.tau):
        return f"{_SLOW} {tau:.3g} s, and {p.tau:g} s are allowed"
    return ""


def _spring(p: Parameters, zeta: float, quick: float = 1.2) -> np.ndarray:
    """Spring and damper of a damping ratio, quicker than asked for by a factor."""
    d = quick * 2 * p.m / p.tau
    return np.array([(d / (2 * zeta)) ** 2 / p.m, d])


EXERCISES = (
    Exercise(
        "80.1",
        "Levelling out",
        "compute",
        10,
        _tanks,
        lambda p: np.log(50) / (p.leak + 2 * p.pipe),
        (
            Slip(
                "that is the time constant: it leaves 37 %, not 2 %",
                lambda p: 1 / (p.leak + 2 * p.pipe),
            ),
            Slip(
                "that is the mode of equal levels; a difference also flows through the pipe",
                lambda p: np.log(50) / p.leak,
            ),
            Slip(
                "the pipe takes from one tank and gives to the other: it counts twice",
                lambda p: np.log(50) / (p.leak + p.pipe),
            ),
            Slip("the difference leaks as well", lambda p: np.log(50) / (2 * p.pipe)),
            Slip(
                "e^(-t) wants the natural logarithm",
                lambda p: np.log10(50) / (p.leak + 2 * p.pipe),
            ),
        ),
    ),
    Exercise(
        "80.2",
        "Spring and damper",
        "design",
        15,
        _wagon,
        lambda p: _spring(p, 0.75),
        (
            Slip(_RINGS, lambda p: _spring(p, 0.3)),
            Slip(_CREEPS, lambda p: _spring(p, 1.1)),
            Slip(_SLOW, lambda p: _spring(p, 0.75, quick=0.5)),
            Slip(_FALLS, lambda p: -_spring(p, 0.75)),
        ),
        points=2,
        judge=_judge_wagon,
    ),
)
