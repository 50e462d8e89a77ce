"""Exercises of chapter 08, the cart-pole."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip

G = 9.8
LEAN = 0.1  # at the start of 08.5 [rad]
CLOCK = 0.06  # its period [s]
NO_TORQUE = 1e9  # the price of a torque at the pin


def _pole(rng: np.random.Generator) -> dict[str, float]:
    return {"L": round(float(rng.uniform(0.3, 0.8)), 2)}


def _machine(rng: np.random.Generator) -> dict[str, float]:
    """A cart and a pole that are none of the chapter's."""
    return {
        "m_cart": round(float(rng.uniform(0.8, 1.4)), 2),
        "m_pole": round(float(rng.uniform(0.2, 0.4)), 2),
        "L": round(float(rng.uniform(0.6, 0.9)), 2),
    }


def _falling(p: Parameters, lever: float = 0.5, gravity: float = G) -> float:
    """The rate at which a pole falls from a free cart, its mass at lever L [1/s]."""
    return float(np.sqrt(gravity / (lever * p.L) * (p.m_cart + p.m_pole) / p.m_cart))


def _share(rng: np.random.Generator) -> dict[str, float]:
    return {
        "L": round(float(rng.uniform(1.2, 1.9)), 2),
        "share": round(float(rng.uniform(0.6, 0.8)), 2),
    }


def _turned(
    pull: Callable[[Any], Any], weight: Callable[[Any], Any], lever: float, gravity: float = G
) -> Callable[..., Any]:
    """theta'' on a cart with a given acceleration: (a pull - g weight) / lever."""
    return lambda theta, a: (a * pull(theta) - gravity * weight(theta)) / lever


def _angles(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-3, -6], [3, 6], size=(12, 2)).tolist()]


def _motions(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-3, -4, -6], [3, 4, 6], size=(12, 3)).tolist()]


def _drive(p: Parameters, lever: float = 0.5, swing: float = 1.0) -> Callable[..., Any]:
    """The force for a given acceleration; swing is the sign before omega^2."""

    def force(theta: Any, omega: Any, a: Any) -> Any:
        turned = 2 / p.L * (a * np.sin(theta) - G * np.cos(theta))
        pole = turned * np.sin(theta) + swing * omega**2 * np.cos(theta)
        return (p.m_cart + p.m_pole) * a - p.m_pole * lever * p.L * pole

    return force


def _top() -> np.ndarray:
    return np.array([0.0, np.pi / 2, 0.0, 0.0])


def regulator(p: Parameters, price: float = 0.1) -> np.ndarray:
    """Return gains (p, theta, v, omega) of an LQR whose force has a price."""
    machine = sb.CartPole(p.m_cart, p.m_pole, p.L, G)
    return np.asarray(sb.LQR(machine, _top(), Q=[1, 10, 1, 1], R=[price, NO_TORQUE]).K[0])


def _judge_gains(answer: Any, p: Parameters) -> str:
    K = np.asarray(answer, dtype=float)
    machine = sb.CartPole(p.m_cart, p.m_pole, p.L, G)
    critical = sb.critical_sample_time(machine, K=np.stack([K, 0 * K]), x0=_top())
    if critical == 0:
        return (
            "these gains do not hold the pole even without a clock; the law is"
            " force = -K (p, theta - pi/2, v, omega)"
        )
    if critical < 1.5 * CLOCK:
        return (
            f"with these gains the critical period is {1e3 * critical:.3g} ms: a clock of"
            f" {1e3 * CLOCK:g} ms is too near. Weaker gains stand a slower clock"
        )
    run = sb.simulate_clocked(
        machine,
        np.add(_top(), [0.0, LEAN, 0.0, 0.0]),
        lambda x, t: np.array([-K @ (x - _top()), 0.0]),
        period=CLOCK,
        duration=4.0,
    )
    way, late = np.abs(run.states[0]).max(), np.abs(run.states[1, run.times >= 2] - np.pi / 2).max()
    if way > 0.3:
        return f"the cart goes {way:.3g} m; 0.3 m are allowed"
    if late > 0.01:
        return f"after 2 s the pole still leans by {late:.3g} rad; 0.01 rad are allowed"
    last = abs(float(run.states[0, -1]))
    if last > 0.02:
        return f"after 4 s the cart is still {last:.3g} m from its place; 0.02 m are allowed"
    return ""


def _scaled(rng: np.random.Generator) -> dict[str, float]:
    """A machine that is the chapter's on another scale, with its room and its force."""
    m_pole, L = round(float(rng.uniform(0.2, 0.4)), 2), round(float(rng.uniform(0.4, 0.7)), 2)
    return {
        "m_cart": round(3 * m_pole, 2),
        "m_pole": m_pole,
        "L": L,
        "amplitude": round(L / 2, 3),
        "limit": round(60 * m_pole, 1),
    }


def _judge_swing(answer: Any, p: Parameters) -> str:
    T, switch = map(float, answer)
    if not 0.1 <= T <= 10 or not 0.1 <= switch <= 10:
        return f"period and switch must lie between 0.1 and 10 s, got {T:g} and {switch:g} s"
    L, total = p.L, p.m_cart + p.m_pole
    try:
        sb.CartPoleSwingUp(
            sb.CartPole(p.m_cart, p.m_pole, L, G),
            lambda t: (
                p.amplitude * (2 * np.pi / T) ** 2 * np.cos(2 * np.pi * t / T) * (t < 1.5 * T)
            ),
            switch,
            limit=p.limit,
            track=(-0.5 * L, 2 * L),
            target=L,
            Q=np.diag([1 / L**2, 10, 1 / L, L]),
            R=[[0.04 / total**2]],
        )
    except sb.DivergenceError:
        return "the cart runs away after a pole that is lost"
    except ValueError as error:
        # What else the library proposes is not the student's to choose.
        return f"{str(error).partition(';')[0]}: try another period or another switch"
    return ""


EXERCISES = (
    Exercise(
        "08.1",
        "The end of a range",
        "read off",
        10,
        _pole,
        lambda p: 1.525 * np.sqrt(p.L),
        (
            Slip(
                "that is the end for the chapter's pole of 1 m; the equation holds g T^2 / L",
                lambda p: 1.525,
            ),
            Slip("T^2 goes with L, not T", lambda p: 1.525 * p.L),
            Slip("a shorter pole is quicker, not slower", lambda p: 1.525 / np.sqrt(p.L)),
            Slip(
                "that is the other end of the range, where it begins",
                lambda p: 1.001 * np.sqrt(p.L),
            ),
            Slip(
                "that belongs to a doubled gravity: the printed equations have a torque that is a"
                " force",
                lambda p: 1.29 * np.sqrt(p.L),
            ),
        ),
        rtol=0.02,
    ),
    Exercise(
        "08.2",
        "How fast it falls",
        "compute",
        10,
        _machine,
        _falling,
        (
            Slip("the mass sits halfway up, at L/2", lambda p: _falling(p, lever=1.0)),
            Slip(
                "that holds for a cart that is clamped; this one is pushed away by the pole",
                lambda p: np.sqrt(2 * G / p.L),
            ),
            Slip("that is the time of one factor e; asked is the rate", lambda p: 1 / _falling(p)),
            Slip("delta'' is the rate squared", lambda p: _falling(p) ** 2),
            Slip(
                "gravity's torque is m_2 g L/2 cos(theta): a factor L/2 is missing",
                lambda p: _falling(p, gravity=2 * G / p.L),
            ),
        ),
    ),
    Exercise(
        "08.3",
        "A force that misses",
        "debug",
        15,
        _machine,
        _drive,
        (
            Slip("the lever of the mass is L/2", lambda p: _drive(p, lever=1.0)),
            Slip(
                "which way does a turning mass pull at its pin? Look at the sign of omega^2",
                lambda p: _drive(p, swing=-1.0),
            ),
            Slip(
                "two mistakes are left: the lever of the mass, and a sign",
                lambda p: _drive(p, lever=1.0, swing=-1.0),
            ),
            Slip(
                "that moves a cart without a pole",
                lambda p: lambda theta, omega, a: (p.m_cart + p.m_pole) * a,
            ),
        ),
        points=2,
        inputs=_motions,
    ),
    Exercise(
        "08.4",
        "A mass anywhere on the pole",
        "derive",
        15,
        _share,
        lambda p: _turned(np.sin, np.cos, p.share * p.L),
        (
            Slip(
                "that has the mass at the end of the pole, at L",
                lambda p: _turned(np.sin, np.cos, p.L),
            ),
            Slip(
                "that has the mass halfway up, at L/2", lambda p: _turned(np.sin, np.cos, p.L / 2)
            ),
            Slip(
                "gravity is divided twice by a length: its torque is m g times a lever",
                lambda p: _turned(np.sin, np.cos, p.share * p.L, G / (p.share * p.L)),
            ),
            Slip(
                "sine and cosine: at theta = 0 the pole is level, and gravity pulls it hardest",
                lambda p: _turned(np.cos, np.sin, p.share * p.L),
            ),
            Slip(
                "gravity has the wrong sign: at theta = 0, without a, the mass falls",
                lambda p: _turned(np.sin, np.cos, p.share * p.L, -G),
            ),
            Slip(
                "a cart that speeds up to the right leaves an upright pole behind, to the left:"
                " there theta grows",
                lambda p: _turned(lambda b: -np.sin(b), np.cos, p.share * p.L),
            ),
        ),
        points=2,
        inputs=_angles,
    ),
    Exercise(
        "08.5",
        "Gains for a slow clock",
        "design",
        20,
        _machine,
        regulator,
        points=3,
        judge=_judge_gains,
    ),
    Exercise(
        "08.6",
        "Up, and caught",
        "play",
        20,
        _scaled,
        lambda p: np.array([1.52, 2.0]) * np.sqrt(p.L),
        points=3,
        judge=_judge_swing,
    ),
)
