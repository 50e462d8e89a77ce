"""Exercises of chapter 10, linear systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

TICKS = 8  # until when the particle of 10.6 is to be at rest
SAMPLES = 2.5  # that 10.5 asks for in a period


def _record(rng: np.random.Generator) -> dict[str, float]:
    return {
        "sigma": round(float(rng.uniform(0.15, 0.4)), 3),
        "omega": round(float(rng.uniform(2.6, 5.2)), 2),
    }


# What a rhythm is off by, and why.
_RHYTHMS = {
    "that is turns a second; one turn is 2 pi": 1 / (2 * np.pi),
    "between two maxima lies one period, not half of one": 0.5,
    "between two maxima lies one period; you count every zero": 2.0,
}


def _judge_mode(answer: Any, p: Parameters) -> str:
    sigma, omega = map(float, answer)
    if abs(omega * p.omega / (2 * np.pi) - 1) < 0.02:
        return "the second number is the period; asked is the rhythm, 2 pi over it"
    for hint, factor in _RHYTHMS.items():
        if abs(omega / p.omega - factor) < 0.02 * factor:
            return hint
    if abs(omega / p.omega - 1) > 0.02:
        return "the rhythm is not within 2 %: count periods between two maxima far apart"
    if abs(sigma * p.sigma - 1) < 0.1:
        return "the first number is a time; asked is the rate, one over it"
    if abs(sigma / p.sigma + 1) < 0.1:
        return "sigma counts as positive: the motion dies as exp(-sigma t)"
    if abs(sigma / p.sigma - 1) > 0.1:
        return "the decay is not within 10 %: compare the heights of two maxima far apart"
    return ""


def _times(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(t,) for t in rng.uniform(0.2, 3.0, size=8).tolist()]


def _rolling(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.6, 1.8)), 2),
        "c": round(float(rng.uniform(0.5, 1.6)), 2),
    }


def _coast(
    p: Parameters, way: Callable[[float, Any], Any], corner: float = 0.0
) -> Callable[..., Any]:
    """A matrix [[1, way(a, t)], [corner, exp(-a t)]] with a = c / m."""
    a = p.c / p.m
    return lambda t: np.array([[1.0, way(a, t)], [corner, np.exp(-a * t)]])


def _two(rng: np.random.Generator) -> dict[str, float]:
    """Two different carts between walls; spring 12 is the one between them."""
    return {
        "m1": round(float(rng.uniform(0.8, 1.6)), 2),
        "m2": round(float(rng.uniform(1.8, 3.0)), 2),
        "k1": round(float(rng.uniform(20, 30)), 1),
        "k12": round(float(rng.uniform(5, 9)), 1),
        "k2": round(float(rng.uniform(11, 16)), 1),
    }


def _mass(rng: np.random.Generator) -> dict[str, float]:
    return {"m": round(float(rng.uniform(0.4, 3.2)), 2)}


def _held(m: float, half: float = 0.5, own: float = 1.0) -> Callable[..., Any]:
    """A particle's [A_d, B_d]; half and own are factors of B_d's two entries."""
    return lambda h: np.array([[1.0, h, half * h**2 / m], [0.0, 1.0, own * h / m]])


def _steps(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(h,) for h in rng.uniform(0.05, 0.7, size=8).tolist()]


def _equal(rng: np.random.Generator) -> dict[str, float]:
    """The chapter's two carts with other masses and springs, and a tick of the computer."""
    return {
        "m": round(float(rng.uniform(0.5, 1.5)), 2),
        "k": round(float(rng.uniform(10, 30)), 1),
        "tick": 0.01,
    }


def _longest(p: Parameters, springs: float = 3.0, samples: float = SAMPLES) -> float:
    """The longest whole number of ticks with so many samples a period of sqrt(springs k / m)."""
    period = 2 * np.pi / np.sqrt(springs * p.k / p.m)
    return float(p.tick * np.floor(period / samples / p.tick))


def _clocked(rng: np.random.Generator) -> dict[str, float]:
    m, h = round(float(rng.uniform(0.5, 2.5)), 2), round(float(rng.uniform(0.2, 0.5)), 2)
    return {"m": m, "h": h, "limit": round(1.2 * m / h**2, 1)}


def _judge_gains(answer: Any, p: Parameters) -> str:
    K = np.asarray(answer, dtype=float)[None, :]
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1 / p.m]])
    Ad, Bd = sb.discretize_many(A, B, p.h)
    radius = np.abs(np.linalg.eigvals(Ad - Bd @ K)).max()
    if radius >= 1:
        return (
            f"the loop has an eigenvalue of size {radius:.3g}: on this clock the motion grows;"
            f" k_D must be below 2 m/h = {2 * p.m / p.h:.3g} and above k_P h/2"
        )
    x, largest = np.array([1.0, 0.0]), 0.0
    for _ in range(TICKS):
        u = -K @ x
        largest = max(largest, float(np.abs(u).max()))
        x = Ad @ x + Bd @ u
    if beyond(largest, p.limit):
        return f"the force reaches {largest:.3g} N, and the limit is {p.limit:g} N"
    if np.abs(x * [1.0, p.h]).max() > 0.01:
        return (
            f"after {TICKS} ticks it is still {abs(x[0]):.2g} m away, at {abs(x[1]):.2g} m/s: the"
            " eigenvalues of A_d - B_d K must be smaller"
        )
    return ""


EXERCISES = (
    Exercise(
        "10.1",
        "A record of one mode",
        "read off",
        10,
        _record,
        lambda p: np.array([p.sigma, p.omega]),
        judge=_judge_mode,
    ),
    Exercise(
        "10.2",
        "Rolling to a stop",
        "derive",
        15,
        _rolling,
        lambda p: _coast(p, lambda a, t: (1 - np.exp(-a * t)) / a),
        (
            Slip(
                "the particle does not keep its speed: how far does it roll while it slows down?",
                lambda p: _coast(p, lambda a, t: t),
            ),
            Slip(
                "the integral of exp(-a t) has a factor 1/a",
                lambda p: _coast(p, lambda a, t: 1 - np.exp(-a * t)),
            ),
            Slip(
                "the exponential of a matrix is not that of its entries: use the series, or solve"
                " for v first",
                lambda p: lambda t: np.exp(np.array([[0.0, t], [0.0, -p.c / p.m * t]])),
            ),
            Slip(
                "that is the speed t * exp(-a t); the place is the integral of the speed",
                lambda p: _coast(p, lambda a, t: t * np.exp(-a * t)),
            ),
        ),
        points=2,
        inputs=_times,
    ),
    Exercise(
        "10.3",
        "A cart that rests",
        "compute",
        10,
        _two,
        lambda p: np.sqrt((p.k12 + p.k2) / p.m2),
        (
            Slip("cart 2 hangs on two springs", lambda p: np.sqrt(p.k2 / p.m2)),
            Slip("cart 2 hangs on two springs, also the wall's", lambda p: np.sqrt(p.k12 / p.m2)),
            Slip(
                "that is cart 1 with cart 2 held: there it is cart 2 that rests",
                lambda p: np.sqrt((p.k1 + p.k12) / p.m1),
            ),
            Slip(
                "that is turns a second; asked is rad/s",
                lambda p: np.sqrt((p.k12 + p.k2) / p.m2) / 2 / np.pi,
            ),
            Slip("where is the square root?", lambda p: (p.k12 + p.k2) / p.m2),
        ),
    ),
    Exercise(
        "10.4",
        "A discretization off by a little",
        "debug",
        10,
        _mass,
        lambda p: _held(p.m),
        (
            Slip(
                "the speed is right now; how far does a steady push carry in h seconds from rest?",
                lambda p: _held(p.m, half=1.0),
            ),
            Slip(
                "the place is right now; a heavy one gains less speed",
                lambda p: _held(p.m, own=p.m),
            ),
            Slip(
                "two mistakes are left, both in B_d",
                lambda p: _held(p.m, half=1.0, own=p.m),
            ),
            Slip(
                "that is Euler's method: a push moves the place in the same interval",
                lambda p: _held(p.m, half=0.0),
            ),
        ),
        points=2,
        inputs=_steps,
    ),
    Exercise(
        "10.5",
        "A clock that sees both modes",
        "design",
        15,
        _equal,
        _longest,
        (
            Slip(
                "that sees the slow mode; the fast one sets the clock",
                lambda p: _longest(p, springs=1.0),
            ),
            Slip(
                "against each other, the carts halve the middle spring: 3 k in all",
                lambda p: _longest(p, springs=2.0),
            ),
            Slip(
                "with two samples a period all of them may fall on zeros: that clock is blind",
                lambda p: _longest(p, samples=2.0),
            ),
            Slip(
                "1/omega is the time of one radian; a period is 2 pi of them",
                lambda p: _longest(p, samples=2 * np.pi * SAMPLES),
            ),
        ),
        points=2,
        rtol=1e-6,
    ),
    Exercise(
        "10.6",
        "At rest in eight ticks",
        "play",
        20,
        _clocked,
        lambda p: np.array([p.m / p.h**2, 1.5 * p.m / p.h]),
        points=3,
        judge=_judge_gains,
    ),
)
