"""Exercises of chapter 07, the pendulum."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

G = 9.8


def _size(rng: np.random.Generator) -> dict[str, float]:
    """A pendulum that is none of the chapter's."""
    return {
        "m": round(float(rng.uniform(0.3, 0.9)), 2),
        "L": round(float(rng.uniform(0.3, 0.45)), 2),
        "b": round(float(rng.uniform(0.02, 0.09)), 3),
    }


def _weight(p: Parameters) -> float:
    return p.m * G * p.L


def _sharp() -> float:
    """The largest (1 - cos phi) / phi: where the line touches the cosine, tan(phi / 2) = phi."""
    return float(np.sin(scipy.optimize.brentq(lambda phi: np.tan(phi / 2) - phi, 2.0, 3.0)))


def _law(inertia: float, gravity: Callable[[Any], Any], friction: float) -> Callable[..., Any]:
    """theta'' as a function of (theta, omega, u): (u + gravity - friction omega) / inertia."""
    return lambda theta, omega, u: (u + gravity(theta) - friction * omega) / inertia


def _pull(p: Parameters, size: float = 1.0, shape: Callable[[Any], Any] = np.cos) -> Any:
    """Gravity's torque, -size m g L shape(theta)."""
    return lambda theta: -size * _weight(p) * shape(theta)


def _accelerations(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-3, -4, -2], [3, 4, 2], size=(12, 3)).tolist()]


def _states(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(row,) for row in rng.uniform([-3, -4], [3, 4], size=(12, 2))]


def _energy(p: Parameters, kinetic: float, height: Callable[[Any], Any]) -> Callable[..., Any]:
    return lambda x: kinetic * x[1] ** 2 + _weight(p) * height(x[0])


def _limits(rng: np.random.Generator) -> dict[str, float]:
    size = _size(rng)
    return {**size, "limit": round(1.6 * size["m"] * G * size["L"], 2)}


def _gains(p: Parameters) -> np.ndarray:
    """Stiffness 1.6 m g L beyond gravity's, and critical damping."""
    return np.array([2.6 * _weight(p), 2 * np.sqrt(1.6 * _weight(p) * p.m * p.L**2) - p.b])


def _judge_gains(answer: Any, p: Parameters) -> str:
    kp, kd = map(float, answer)
    if kp <= _weight(p):
        return (
            f"kp = {kp:g} is no more than m g L: beside the top gravity pulls away harder than"
            " the controller pulls back"
        )
    if kd <= -p.b:
        return "kd pushes in the direction of motion: the swing grows"
    model = sb.Pendulum(m=p.m, L=p.L, g=G, damping=p.b)
    run = sb.simulate(
        model,
        [np.pi / 2 + 0.3, 0.0],
        lambda x, t: -kp * (x[:1] - np.pi / 2) - kd * x[1:],
        duration=3.0,
    )
    largest = np.abs(np.asarray(run.controls)).max()
    if beyond(largest, p.limit):
        return f"the torque reaches {largest:.3g} N m, and the motor's limit is {p.limit:g} N m"
    past = np.pi / 2 - run.states[0].min()
    if past > 0.03:
        return f"it overshoots by {past:.3g} rad; 0.03 rad are allowed: more damping"
    late = np.abs(run.states[0, run.times >= 1.5] - np.pi / 2).max()
    if late > 0.03:
        return (
            f"after 1.5 s it is still {late:.3g} rad off; 0.03 rad are allowed: too little"
            " stiffness, or so much damping that it creeps"
        )
    return ""


def _weak(rng: np.random.Generator) -> dict[str, float]:
    size = {**_size(rng), "b": 0.0}
    return {**size, "limit": round(0.45 * size["m"] * G * size["L"], 2)}


def _judge_policy(answer: Any, p: Parameters) -> str:
    model = sb.Pendulum(m=p.m, L=p.L, g=G)
    seen = []

    def policy(x: np.ndarray, t: float) -> Any:
        u = answer(x, t)
        seen.append(float(np.max(np.abs(u), initial=0.0)))
        return np.clip(u, -p.limit, p.limit)  # a huge torque would spin for ever

    run = sb.simulate_clocked(model, [-np.pi / 2, 0.0], policy, period=0.02, duration=10.0)
    if max(seen) > p.limit * (1 + 1e-9):
        return f"your torque reaches {max(seen):.3g} N m, and the limit is {p.limit:g} N m"
    highest = float(np.sin(run.states[0]).max())
    if highest < 0.95:
        return (
            f"in 10 s the mass comes up to {highest:.2f} L; 0.95 L is asked for. Which sign of the"
            " torque adds energy? The power is u omega"
        )
    return ""


def _pump(p: Parameters) -> Callable[..., Any]:
    """The whole torque, in the direction of the motion."""
    return lambda x, t: p.limit if x[1] >= 0 else -p.limit


EXERCISES = (
    Exercise(
        "07.1",
        "One swing is enough",
        "read off",
        5,
        _size,
        lambda p: _sharp() * _weight(p),
        (
            Slip(
                "that torque holds the mass at the height of the pin; it gathers speed on the way,"
                " so less will do",
                _weight,
            ),
            Slip("that is the torque ratio: the answer is a torque", lambda p: _sharp()),
            Slip(
                "work equals height at the very top only; look at what happens on the way there",
                lambda p: 2 / np.pi * _weight(p),
            ),
            Slip("a mass is not a weight: where is g?", lambda p: _sharp() * p.m * p.L),
        ),
        rtol=0.02,
    ),
    Exercise(
        "07.2",
        "A small swing",
        "compute",
        5,
        _size,
        lambda p: 2 * np.pi * np.sqrt(p.L / G),
        (
            Slip("that is the rate omega_0, in rad/s", lambda p: np.sqrt(G / p.L)),
            Slip("that is the time of one radian: a swing is 2 pi", lambda p: np.sqrt(p.L / G)),
            Slip("that is the number of swings a second", lambda p: np.sqrt(G / p.L) / 2 / np.pi),
            Slip(
                "L/g turned over: a longer pendulum swings more slowly",
                lambda p: 2 * np.pi * np.sqrt(G / p.L),
            ),
            Slip("where is the square root?", lambda p: 2 * np.pi * p.L / G),
        ),
    ),
    Exercise(
        "07.3",
        "The equation of motion",
        "derive",
        15,
        _size,
        lambda p: _law(p.m * p.L**2, _pull(p), p.b),
        (
            Slip(
                "a torque is divided by the moment of inertia, m L^2; m L has the wrong unit",
                lambda p: _law(p.m * p.L, _pull(p), p.b),
            ),
            Slip(
                "u is divided by the moment of inertia, m L^2; u / (m L) has the wrong unit",
                lambda p: _law(p.m * p.L, _pull(p, 1 / p.L), p.b / p.L),
            ),
            Slip(
                "two mistakes: m L is no moment of inertia, and gravity pulls towards hanging",
                lambda p: _law(p.m * p.L, _pull(p, -1.0), 0.0),
            ),
            Slip(
                "gravity has the wrong sign: at theta = 0 the mass falls, theta'' < 0",
                lambda p: _law(p.m * p.L**2, _pull(p, -1.0), p.b),
            ),
            Slip(
                "theta is counted from the x axis: gravity's lever is L cos(theta)",
                lambda p: _law(p.m * p.L**2, _pull(p, shape=np.sin), p.b),
            ),
            Slip(
                "friction acts against the motion",
                lambda p: _law(p.m * p.L**2, _pull(p), -p.b),
            ),
            Slip("where is friction?", lambda p: _law(p.m * p.L**2, _pull(p), 0.0)),
        ),
        points=2,
        inputs=_accelerations,
    ),
    Exercise(
        "07.4",
        "An energy that grows by itself",
        "debug",
        10,
        _size,
        lambda p: _energy(p, p.m * p.L**2 / 2, np.sin),
        (
            Slip(
                "the 1/2 of kinetic energy is missing", lambda p: _energy(p, p.m * p.L**2, np.sin)
            ),
            Slip(
                "the speed of the mass is L omega: squared, that is L^2 omega^2",
                lambda p: _energy(p, p.m * p.L / 2, np.sin),
            ),
            Slip(
                "the height of the mass is L sin(theta), as theta is counted from the x axis",
                lambda p: _energy(p, p.m * p.L**2 / 2, lambda a: -np.cos(a)),
            ),
            Slip(
                "two mistakes are left: the speed of the mass, and its height",
                lambda p: _energy(p, p.m * p.L / 2, lambda a: -np.cos(a)),
            ),
            Slip(
                "potential energy grows upwards",
                lambda p: _energy(p, p.m * p.L**2 / 2, lambda a: -np.sin(a)),
            ),
        ),
        points=2,
        inputs=_states,
    ),
    Exercise(
        "07.5",
        "Gains for a specification",
        "design",
        20,
        _limits,
        _gains,
        points=3,
        judge=_judge_gains,
    ),
    Exercise(
        "07.6",
        "Up with a weak motor",
        "play",
        20,
        _weak,
        _pump,
        points=3,
        judge=_judge_policy,
    ),
)
