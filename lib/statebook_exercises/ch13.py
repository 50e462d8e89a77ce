"""Exercises of chapter 13, estimation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import NOT_A_NUMBER, beyond, one_number


def _sensor(rng: np.random.Generator) -> dict[str, float]:
    return {
        "sigma": round(float(rng.uniform(0.05, 0.15)), 3),
        "h": round(float(rng.uniform(0.02, 0.06)), 3),
    }


def _claims(rng: np.random.Generator) -> dict[str, float]:
    return {"nees": round(float(rng.uniform(5.0, 30.0)), 1)}


def _step(
    gain: Callable[[float, float], float], left: Callable[[float, float, float], float]
) -> Callable[[Parameters], Callable[..., Any]]:
    """Return the function (x, P, z) -> (x + L (z - x), what is left of P)."""

    def made(p: Parameters) -> Callable[..., Any]:
        r = p.sigma**2

        def correct(x: float, P: float, z: float) -> Any:
            L = gain(P, r)
            return np.array([x + L * (z - x), left(P, L, r)])

        return correct

    return made


def _gain(P: float, r: float) -> float:
    return P / (P + r)


def _readings(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    low, high = [-1, 0.2 * p.sigma**2, -1], [1, 5 * p.sigma**2, 1]
    return [tuple(row) for row in rng.uniform(low, high, size=(10, 3)).tolist()]


def _cart(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.6, 1.4)), 2),
        "q": round(float(rng.uniform(0.5, 1.5)), 2),
        "h": round(float(rng.uniform(0.2, 0.5)), 2),
    }


def _model(m: float, q: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """One step of a cart, and the covariance that gusts add in it."""
    F = np.array([[1.0, h], [0.0, 1.0]])
    return F, q / m**2 * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])


def _predicted(
    law: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
) -> Callable[[Parameters], Callable[..., Any]]:
    """Return the function P -> law(F, P, Q) of a student's cart."""

    def made(p: Parameters) -> Callable[..., Any]:
        F, Q = _model(p.m, p.q, p.h)
        return lambda P: law(F, np.asarray(P), Q)

    return made


def _covariances(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    roots = rng.standard_normal((6, 2, 2))
    return [(root @ root.T,) for root in roots]


def _settled(m: float, q: float, sigma: float, h: float) -> float:
    """The deviation of the velocity at which the Kalman filter settles, before a reading."""
    F, Q = _model(m, q, h)
    P = scipy.linalg.solve_discrete_are(F.T, np.array([[1.0], [0.0]]), Q, [[sigma**2]])
    return float(np.sqrt(P[1, 1]))


def _demand(rng: np.random.Generator) -> dict[str, float]:
    m, q = round(float(rng.uniform(1.0, 4.0)), 1), round(float(rng.uniform(0.1, 0.6)), 2)
    sigma = round(float(rng.uniform(0.02, 0.08)), 3)
    h = float(rng.uniform(0.1, 0.4))
    return {"m": m, "q": q, "sigma": sigma, "limit": float(f"{_settled(m, q, sigma, h):.3g}")}


def _longest(p: Parameters) -> float:
    """The longest time between readings that keeps the limit."""
    return float(
        scipy.optimize.brentq(lambda h: _settled(p.m, p.q, p.sigma, h) - p.limit, 0.005, 2.0)
    )


def _judge_time(answer: Any, p: Parameters) -> str:
    h = float(answer)
    if not 1e-3 <= h <= 10:
        return "the time between readings must be positive, between 0.001 and 10 s"
    found = _settled(p.m, p.q, p.sigma, h)
    if beyond(found, p.limit):
        return (
            f"too seldom: the velocity is known to {found:.3g} m/s before a reading,"
            f" and {p.limit:g} m/s are allowed"
        )
    if h < 0.9 * _longest(p):
        return (
            f"too often: the velocity is known to {found:.3g} m/s, and the limit allows readings"
            " more than 10 % farther apart"
        )
    return ""


def _scale(rng: np.random.Generator) -> dict[str, float]:
    p = {
        "m": round(float(rng.uniform(1.0, 5.0)), 1),
        "track": round(float(rng.uniform(0.8, 2.0)), 1),
        "sigma": round(float(rng.uniform(0.02, 0.06)), 3),
    }
    force = 4 * p["m"] * p["track"]  # the edge is 1 s away
    edge = 41 * (0.9 * p["track"]) ** 2  # of 50 readings, those at rest at 0.9 of the track
    target = 1.15 * p["sigma"] * p["m"] / np.sqrt(edge)
    return {**p, "limit": round(force, 1), "target": float(f"{target:.3g}")}


TICK = 0.05  # of the experiment of 13.6, which lasts 5 s [s]


def _judge_experiment(answer: Any, p: Parameters) -> str:
    x, v, information = 0.0, 0.0, 0.0
    for k in range(101):
        if k and k % 2 == 0:  # p = (a double integral of u) / m, so dp/dm = -p / m
            information += (x / p.m / p.sigma) ** 2
        u = one_number(answer(k * TICK))
        if np.isnan(u):
            return NOT_A_NUMBER
        if abs(u) > p.limit * (1 + 1e-9):
            return f"your force is too large: {abs(u):.3g} N, and the limit is {p.limit:g} N"
        x, v = x + v * TICK + u / p.m * TICK**2 / 2, v + u / p.m * TICK
        if beyond(abs(x), p.track):
            return f"the cart leaves the track at {k * TICK:.2f} s"
    if information == 0:
        return "without a force the readings say nothing about the mass"
    found = 1 / np.sqrt(information)
    if beyond(found, p.target):
        return (
            f"the mass is known to {found:.3g} kg only, and {p.target:g} kg are asked for;"
            " dp/dm = -p/m: where on the track does a reading tell most?"
        )
    return ""


def _experiment(p: Parameters) -> Callable[[float], float]:
    """Go to 0.9 of the track as fast as whole ticks allow, and stay there."""
    goal = 0.9 * p.track
    half = np.ceil(np.sqrt(goal * p.m / p.limit) / TICK) * TICK
    force = p.m * goal / half**2

    def u(t: float) -> float:
        if t > 2 * half - TICK / 2:
            return 0.0
        return float(force if t < half - TICK / 2 else -force)

    return u


EXERCISES = (
    Exercise(
        "13.1",
        "Differences",
        "compute",
        5,
        _sensor,
        lambda p: np.sqrt(2) * p.sigma / p.h,
        (
            Slip("two readings, two errors: their variances add", lambda p: p.sigma / p.h),
            Slip("variances add, deviations do not", lambda p: 2 * p.sigma / p.h),
            Slip("that is the variance", lambda p: 2 * p.sigma**2 / p.h**2),
            Slip("divide by the time between the readings", lambda p: np.sqrt(2) * p.sigma),
            Slip(
                "the variances of independent errors add, even in a mean or a difference",
                lambda p: p.sigma / np.sqrt(2) / p.h,
            ),
        ),
        rtol=5e-3,
    ),
    Exercise(
        "13.2",
        "How much too sure",
        "read off",
        5,
        _claims,
        lambda p: np.sqrt(p.nees / 2),
        (
            Slip(
                "that is the factor of the variances: the question is for deviations",
                lambda p: p.nees / 2,
            ),
            Slip(
                "a right filter has the mean NEES 2, not 1, with two states",
                lambda p: np.sqrt(p.nees),
            ),
            Slip("that is the NEES itself", lambda p: p.nees),
            Slip("turned over: its true errors are larger", lambda p: np.sqrt(2 / p.nees)),
        ),
        rtol=0.01,
    ),
    Exercise(
        "13.3",
        "One correction",
        "derive",
        15,
        lambda rng: {"sigma": round(float(rng.uniform(0.1, 0.6)), 2)},
        _step(_gain, lambda P, L, r: P - L * P),
        (
            Slip(
                "the gain is turned over: a good sensor, r small, must be believed",
                _step(lambda P, r: r / (P + r), lambda P, L, r: P - L * P),
            ),
            Slip(
                "the reading has told something: P must shrink",
                _step(_gain, lambda P, L, r: P),
            ),
            Slip("P must shrink, not grow", _step(_gain, lambda P, L, r: P + L * P)),
            Slip(
                "r is the variance of the sensor, sigma^2",
                lambda p: _step(_gain, lambda P, L, r: P - L * P)(
                    Parameters(sigma=np.sqrt(p.sigma))
                ),
            ),
            Slip(
                "P is a variance: it shrinks by the factor 1 - L, not by its square",
                _step(_gain, lambda P, L, r: (1 - L) ** 2 * P),
            ),
        ),
        points=2,
        inputs=_readings,
    ),
    Exercise(
        "13.4",
        "A filter too sure of itself",
        "debug",
        10,
        _cart,
        _predicted(lambda F, P, Q: F @ P @ F.T + Q),
        (
            Slip(
                "the gusts are missing: without Q the filter grows surer with every step",
                _predicted(lambda F, P, Q: F @ P @ F.T),
            ),
            Slip(
                "x -> F x carries P to F P F', not to F' P F",
                _predicted(lambda F, P, Q: F.T @ P @ F + Q),
            ),
            Slip(
                "two mistakes are left: F' P F, and no gusts",
                _predicted(lambda F, P, Q: F.T @ P @ F),
            ),
            Slip("gusts add to what is not known", _predicted(lambda F, P, Q: F @ P @ F.T - Q)),
            Slip("the errors move with the cart", _predicted(lambda F, P, Q: P + Q)),
        ),
        points=2,
        inputs=_covariances,
    ),
    Exercise(
        "13.5",
        "As few readings as will do",
        "design",
        20,
        _demand,
        lambda p: 0.97 * _longest(p),
        (
            Slip("too seldom", lambda p: 1.5 * _longest(p)),
            Slip("too often", lambda p: 0.5 * _longest(p)),
            Slip("must be positive", lambda p: -1.0),
        ),
        points=3,
        judge=_judge_time,
    ),
    Exercise(
        "13.6",
        "Weigh it",
        "play",
        25,
        _scale,
        _experiment,
        (
            Slip("the readings say nothing about the mass", lambda p: lambda t: 0.0),
            Slip("the cart leaves the track", lambda p: lambda t: p.limit),
            Slip("your force is too large", lambda p: lambda t: 1.5 * p.limit),
            Slip(
                "where on the track does a reading tell most",
                lambda p: lambda t: p.limit * np.cos(7 * t),
            ),
        ),
        points=3,
        judge=_judge_experiment,
    ),
)
