"""Exercises of chapter 11, linearization and eigenvalues."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

G = 9.8


def _arm(rng: np.random.Generator) -> dict[str, float]:
    """A double pendulum that is not the chapter's."""
    low, high = [0.4, 0.4, 0.8, 0.8], [0.8, 0.8, 2.5, 2.5]
    names = ("l1", "l2", "m1", "m2")
    sizes = dict(zip(names, rng.uniform(low, high).round(2).tolist(), strict=True))
    return {**sizes, "swing": round(float(rng.uniform(0.02, 0.09)), 3)}


def _ratios(p: Parameters) -> np.ndarray:
    """Second angle over first, in the slow and in the fast mode."""
    arm = sb.PlanarArm(lengths=(p.l1, p.l2), masses=(p.m1, p.m2), g=G)
    A, _ = sb.jacobians(arm, [-np.pi / 2, 0.0, 0.0, 0.0], [0.0, 0.0])
    squares, V = map(np.real, np.linalg.eig(A[2:, :2]))
    return (V[1] / V[0])[np.argsort(-squares)]


def _pendulum(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.4, 1.2)), 2),
        "L": round(float(rng.uniform(0.4, 0.75)), 2),
        "b": round(float(rng.uniform(0.1, 0.4)), 2),
        "angle": round(float(rng.uniform(0.3, 1.1)), 2),
    }


def _growth(p: Parameters, slope: float, friction: float = 1.0) -> float:
    """The larger root of J s^2 + b s - slope = 0."""
    return float(np.max(np.roots([p.m * p.L**2, friction * p.b, -slope]).real))


def _weight(p: Parameters) -> float:
    return p.m * G * p.L


def _drive(rng: np.random.Generator) -> dict[str, float]:
    return {
        "L": round(float(rng.uniform(2.2, 3.4)), 2),
        "speed": round(float(rng.uniform(4.0, 12.0)), 1),
        "heading": round(float(rng.uniform(0.3, 1.2)), 2),
        "steer": round(float(rng.uniform(0.15, 0.5)), 2),
    }


def _car(p: Parameters, turn: float, steered: float) -> np.ndarray:
    """df/du of the car, its last row as given."""
    return np.array([[np.cos(p.heading), 0.0], [np.sin(p.heading), 0.0], [turn, steered]])


def _car_right(p: Parameters) -> np.ndarray:
    return _car(p, np.tan(p.steer) / p.L, p.speed / (p.L * np.cos(p.steer) ** 2))


def _near(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    spread = rng.uniform([-0.3, -0.5], [0.3, 0.5], size=(10, 2))
    return [(row,) for row in np.array([p.angle, 0.0]) + spread]


def _tangent(
    p: Parameters, constant: float = 1.0, slope: float = 1.0, about: float = 1.0
) -> Callable[..., Any]:
    """The rate of a pendulum at rest without torque: f(x0) + A (x - x0), or a part of it."""
    pull, J = _weight(p), p.m * p.L**2

    def rate(x: np.ndarray) -> np.ndarray:
        dx = x - about * np.array([p.angle, 0.0])
        bent = -constant * pull * np.cos(p.angle) + slope * pull * np.sin(p.angle) * dx[0]
        return np.array([x[1], (bent - p.b * x[1]) / J])

    return rate


def _lagging(rng: np.random.Generator) -> dict[str, float]:
    p = Parameters(**_pendulum(rng), lag=round(float(rng.uniform(0.03, 0.07)), 3))
    tau = 8 / (1 / p.lag + p.b / (p.m * p.L**2))
    return {**vars(p), "tau": round(tau, 2)}


def _cubic(p: Parameters, kp: float, kd: float) -> list[float]:
    """J T s^3 + (J + b T) s^2 + (b - G T + kd) s + kp - G, with G = m g L."""
    J, pull = p.m * p.L**2, _weight(p)
    return [J * p.lag, J + p.b * p.lag, p.b - pull * p.lag + kd, kp - pull]


def _lag_gains(p: Parameters, zeta: float = 0.8) -> np.ndarray:
    """A pair of rate total / 4 and a real eigenvalue; their sum is fixed by the machine."""
    J = p.m * p.L**2
    total = 1 / p.lag + p.b / J
    pair = [1.0, 2 * zeta * total / 4, (total / 4) ** 2]
    wanted = J * p.lag * np.polymul(pair, [1.0, total - pair[1]])
    return np.array([wanted[3] + _weight(p), wanted[2] - p.b + _weight(p) * p.lag])


_WEAK = "it falls: gravity pulls harder than kp"
_LAGS = "a growing swing: with the lag of the motor this kp is too much for this kd"
_RINGS = "it is stable, but it rings: the smallest damping ratio is"
_SLOW = "it is stable, but slow: the largest time constant is"


def _judge_lag(answer: Any, p: Parameters) -> str:
    kp, kd = map(float, answer)
    if kp <= _weight(p):
        return f"{_WEAK} = {kp:.4g} N m/rad"
    s = np.roots(_cubic(p, kp, kd))
    if np.max(s.real) >= 0:
        return _LAGS
    zeta, tau = float(np.min(-s.real / np.abs(s))), float(1 / -np.max(s.real))
    if beyond(0.6, zeta):
        return f"{_RINGS} {zeta:.2g}, and 0.6 is asked for"
    if beyond(tau, p.tau):
        return f"{_SLOW} {tau:.3g} s, and {p.tau:g} s are allowed"
    return ""


def _leaning(rng: np.random.Generator) -> dict[str, float]:
    size = _pendulum(rng)
    return {"m": size["m"], "L": size["L"], "lean": round(float(rng.uniform(0.75, 1.1)), 2)}


_OUTWARDS = "it falls outwards at once: it needs a push towards the top"
_BACK = "it comes back towards the top, but not far enough, and falls again"
_OVER = "it comes back so fast that it goes over to the other side and falls there"


def _judge_push(answer: Any, p: Parameters) -> str:
    rate = float(answer)
    if abs(rate) > 50:
        return f"a rate of {rate:.3g} rad/s is that of a propeller; stay below 50"
    model = sb.Pendulum(m=p.m, L=p.L, g=G)
    top = np.array([np.pi / 2, 0.0])
    law = sb.LQR(model, top, Q=np.diag([4.0, 1.0]), R=[[0.1]], limit=0.5 * _weight(p))
    run = sb.simulate_clocked(
        model, [np.pi / 2 + p.lean, rate], law, period=0.02, duration=6.0, rtol=1e-6
    )
    lean = run.states[0] - np.pi / 2
    if np.abs(lean).max() < np.pi / 2 and abs(lean[-1]) < 0.05:
        return ""
    fallen = int(np.argmax(np.abs(lean) > np.pi / 2))
    if lean[fallen] < 0:
        return _OVER
    return _OUTWARDS if rate >= 0 else _BACK


def _return(p: Parameters) -> float:
    """The rate at which it would just come to rest at the top, without a motor."""
    return float(-2 * np.sqrt(G / p.L) * np.sin(p.lean / 2))


EXERCISES = (
    Exercise(
        "11.1",
        "A shape of the body",
        "read off",
        8,
        _arm,
        lambda p: float(_ratios(p)[1] * p.swing),
        (
            Slip(
                "that is the slow mode, in which both links go to the same side",
                lambda p: float(_ratios(p)[0] * p.swing),
            ),
            Slip(
                "that is the proportion of the two; how far when the first swings as far as yours?",
                lambda p: float(_ratios(p)[1]),
            ),
            Slip(
                "the shape is (first, second): you divided where you should multiply",
                lambda p: float(p.swing / _ratios(p)[1]),
            ),
        ),
        rtol=0.01,
    ),
    Exercise(
        "11.2",
        "How fast does it fall?",
        "compute",
        10,
        _pendulum,
        lambda p: _growth(p, _weight(p) * np.sin(p.angle)),
        (
            Slip(
                "the slope of the cosine is the sine: differentiate before you put the angle in",
                lambda p: _growth(p, _weight(p) * np.cos(p.angle)),
            ),
            Slip(
                "that is a pendulum that stands; yours is held at an angle",
                lambda p: _growth(p, _weight(p)),
            ),
            Slip("where is friction?", lambda p: _growth(p, _weight(p) * np.sin(p.angle), 0.0)),
            Slip(
                "friction acts against the motion",
                lambda p: _growth(p, _weight(p) * np.sin(p.angle), -1.0),
            ),
            Slip(
                "that is its time constant; the eigenvalue is asked for",
                lambda p: 1 / _growth(p, _weight(p) * np.sin(p.angle)),
            ),
        ),
    ),
    Exercise(
        "11.3",
        "What the steering does",
        "derive",
        15,
        _drive,
        _car_right,
        (
            Slip(
                "that is g(x0) of the form f(x) + g(x) u, the answer to unit controls; the car is"
                " not of that form: differentiate at your speed and steering angle",
                lambda p: _car(p, 0.0, 0.0),
            ),
            Slip(
                "the derivative of tan(phi) is 1 / cos(phi)^2",
                lambda p: _car(p, np.tan(p.steer) / p.L, p.speed / p.L),
            ),
            Slip(
                "the first column is the derivative by the speed: no speed is left in it",
                lambda p: _car_right(p) * [p.speed, 1.0],
            ),
            Slip(
                "the columns are derivatives by speed and by steering, in this order",
                lambda p: _car_right(p)[:, ::-1],
            ),
        ),
        points=2,
    ),
    Exercise(
        "11.4",
        "A linear model of nowhere",
        "debug",
        10,
        _pendulum,
        _tangent,
        (
            Slip(
                "that is right only at an equilibrium; here the pendulum falls although nothing"
                " deviates: what is f there?",
                lambda p: _tangent(p, constant=0.0),
            ),
            Slip(
                "A multiplies the deviation from the point, not the state itself",
                lambda p: _tangent(p, about=0.0),
            ),
            Slip("look at the sign of the slope", lambda p: _tangent(p, slope=-1.0)),
            Slip(
                "that is the constant alone: how does it change with the angle?",
                lambda p: _tangent(p, slope=0.0),
            ),
        ),
        points=2,
        inputs=_near,
    ),
    Exercise(
        "11.5",
        "Gains through a lag",
        "design",
        25,
        _lagging,
        _lag_gains,
        (
            Slip(_WEAK, lambda p: np.array([0.9, 1.0]) * _weight(p)),
            Slip(_LAGS, lambda p: _lag_gains(p) * [10.0, 1.0]),
            Slip(_RINGS, lambda p: _lag_gains(p, zeta=0.3)),
            Slip(_SLOW, lambda p: np.array([1.02 * _weight(p), _lag_gains(p)[1]])),
        ),
        points=3,
        judge=_judge_lag,
    ),
    Exercise(
        "11.6",
        "Caught in the fall",
        "play",
        15,
        _leaning,
        _return,
        (
            Slip(_OUTWARDS, lambda p: 0.0),
            Slip(_OUTWARDS, lambda p: -_return(p)),
            Slip(_BACK, lambda p: 0.15 * _return(p)),
            Slip(_OVER, lambda p: 2.5 * _return(p)),
        ),
        points=2,
        judge=_judge_push,
    ),
)
