"""Exercises of chapter 15, time scaling by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

TICK = 0.02  # [s], of the clock that asks for an acceleration


def _road(rng: np.random.Generator) -> dict[str, float]:
    """A straight, a bend and a grip that are none of the chapter's."""
    return {
        "straight": round(float(rng.uniform(16, 26)), 1),
        "radius": round(float(rng.uniform(3.0, 4.5)), 2),
        "grip": round(float(rng.uniform(1.2, 1.9)), 2),
    }


def _bend_speed(p: Parameters) -> float:
    return float(np.sqrt(p.grip * p.radius))


def _peak(p: Parameters) -> float:
    return float(np.sqrt(p.grip * p.straight + _bend_speed(p) ** 2 / 2))


def _shuttle(rng: np.random.Generator) -> dict[str, float]:
    return {
        "d": round(float(rng.uniform(2, 4)), 2),
        "v_max": round(float(rng.uniform(0.8, 1.2)), 2),
        "a_max": round(float(rng.uniform(1.2, 1.9)), 2),
    }


def _curve(rng: np.random.Generator) -> dict[str, float]:
    return {
        "A": round(float(rng.uniform(0.5, 2.0)), 2),
        "B": round(float(rng.uniform(0.3, 1.5)), 2),
    }


def _motion(p: Parameters, combine: Callable[..., Any]) -> Callable[..., Any]:
    """Accelerations from p' and p'' at s, put together in some way."""

    def acceleration(s: float, s1: float, s2: float) -> Any:
        first = np.array([-p.A * np.sin(s), 2 * p.B * s])
        second = np.array([-p.A * np.cos(s), 2 * p.B])
        return combine(first, second, s1, s2)

    return acceleration


def _motions(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([0.2, 0.3, -2], [1.5, 2, 2], size=(12, 3)).tolist()]


def _step(p: Parameters, twice: float, side: Callable[..., Any]) -> Callable[..., Any]:
    """One step of a pass: z + twice ds times what the bend leaves of the grip."""
    return lambda z, k, ds: z + twice * ds * side(p.grip, k, z)


def _pythagoras(grip: float, k: float, z: float) -> Any:
    return np.sqrt(grip**2 - (k * z) ** 2)


def _steps(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """(z, k, ds): the bend takes a fourth to a half of the grip."""
    k = rng.uniform(0.2, 0.33, size=12)
    z = rng.uniform(0.55, 0.9, size=12) * p.grip / np.sqrt(k)
    return list(zip(z.tolist(), k.tolist(), rng.uniform(1, 4, size=12).tolist(), strict=True))


def _uneven(rng: np.random.Generator) -> dict[str, float]:
    return {
        "d": round(float(rng.uniform(4, 7)), 2),
        "v_max": round(float(rng.uniform(1.1, 1.6)), 2),
        "engine": round(float(rng.uniform(0.5, 0.8)), 2),
        "brake": round(float(rng.uniform(1.5, 2.4)), 2),
    }


def _ramps(p: Parameters, v: float) -> np.ndarray:
    """Speed, and the times of speeding up, cruising and braking over the distance."""
    up, down = v / p.engine, v / p.brake
    return np.array([v, up, p.d / v - (up + down) / 2, down])


def _judge_ramps(answer: Any, p: Parameters) -> str:
    v, up, cruise, down = map(float, answer)
    if v <= 0 or up <= 0 or down <= 0 or cruise < 0:
        return "the speed and both ramps must be positive, and the cruise not negative"
    if beyond(v, p.v_max):
        return f"{v:.4g} m/s is faster than the limit of {p.v_max:g} m/s"
    if beyond(v / up, p.engine):
        return f"the engine gives {p.engine:g} m/s^2; you ask it for {v / up:.3g}"
    if beyond(v / down, p.brake):
        return f"the brakes hold {p.brake:g} m/s^2; you ask them for {v / down:.3g}"
    way = v * (up / 2 + cruise + down / 2)
    if abs(way - p.d) > 0.002 * p.d:
        return (
            f"it stops after {way:.4g} m instead of {p.d:g} m: on a ramp the mean speed is half"
            " the top speed"
        )
    best = float(_ramps(p, p.v_max)[1:].sum())
    took = up + cruise + down
    if took > 1.01 * best:
        return (
            f"it takes {took:.4g} s, and 1 % above the least time is allowed: does it reach the"
            " speed limit, and are both ramps as steep as they may be?"
        )
    return ""


def _least_lap(p: Parameters) -> float:
    """From rest through the bend to the end of the second straight."""
    bend, a = _bend_speed(p), p.grip
    last = (np.sqrt(bend**2 + 2 * a * p.straight) - bend) / a
    return float((2 * _peak(p) - bend) / a + np.pi * p.radius / bend + last)


def _judge_driver(answer: Any, p: Parameters) -> str:
    s, v, t = 0.0, 0.0, 0.0
    first, last = p.straight, p.straight + np.pi * p.radius
    limit = 1.3 * _least_lap(p)
    while s < last + p.straight:
        u = float(answer(s, v))
        if abs(u) > p.grip * (1 + 1e-9):
            return f"at s = {s:.1f} m you ask for {u:.3g} m/s^2, and the tyres hold {p.grip:g}"
        faster = max(v + u * TICK, 0.0)
        side = max(v, faster) ** 2 / p.radius if first < s < last else 0.0
        if np.hypot(side, u) > 1.05 * p.grip:
            return (
                f"at s = {s:.1f} m, in the bend, the car is accelerated by"
                f" {np.hypot(side, u):.3g} m/s^2, and the tyres hold {p.grip:g}: brake before it"
            )
        s, v, t = s + TICK * (v + faster) / 2, faster, t + TICK
        if t > limit:
            return (
                f"after {t:.1f} s the car is at s = {s:.1f} m: the end is not reached in time; use"
                " all of the grip on the straights"
            )
    allowed = 1.08 * _least_lap(p)
    if t > allowed:
        return f"it takes {t:.2f} s; {allowed:.2f} s are allowed: brake later, or bend faster"
    return ""


def _driver(p: Parameters, bend: float = 0.98) -> Callable[..., Any]:
    """Full throttle below the braking curve, full braking above it, a steady bend."""

    def accelerate(s: float, v: float) -> float:
        speed, end = bend * _bend_speed(p), p.straight + np.pi * p.radius
        if s > end:
            return p.grip
        if s >= p.straight:
            return float(np.clip((speed - v) / TICK, -0.15 * p.grip, 0.15 * p.grip))
        ahead = max(p.straight - s - v * TICK, 0.0)
        return p.grip if v**2 < speed**2 + 1.96 * p.grip * ahead else -p.grip

    return accelerate


EXERCISES = (
    Exercise(
        "15.1",
        "Where throttle and brake meet",
        "read off",
        5,
        _road,
        _peak,
        (
            Slip(
                "that is the bend's own speed; the car may be faster before it",
                _bend_speed,
            ),
            Slip(
                "with that speed it arrives at the bend without having braked",
                lambda p: np.sqrt(2 * p.grip * p.straight),
            ),
            Slip(
                "that is where they meet, in metres: the answer is a speed",
                lambda p: p.straight / 2 + p.radius / 4,
            ),
            Slip(
                "from that speed it can still brake, but it starts at rest",
                lambda p: np.sqrt(p.grip * p.radius + 2 * p.grip * p.straight),
            ),
        ),
        rtol=0.03,
    ),
    Exercise(
        "15.2",
        "A trapezoid",
        "compute",
        5,
        _shuttle,
        lambda p: p.d / p.v_max + p.v_max / p.a_max,
        (
            Slip("that would start and end at full speed", lambda p: p.d / p.v_max),
            Slip(
                "that is a triangle: its top is faster than the limit",
                lambda p: 2 * np.sqrt(p.d / p.a_max),
            ),
            Slip(
                "the ramps cover some of the distance too; you have counted it twice",
                lambda p: p.d / p.v_max + 2 * p.v_max / p.a_max,
            ),
            Slip(
                "there are two ramps, each at half the speed on average",
                lambda p: p.d / p.v_max + p.v_max / p.a_max / 2,
            ),
        ),
    ),
    Exercise(
        "15.3",
        "The acceleration of a bead",
        "derive",
        15,
        _curve,
        lambda p: _motion(p, lambda first, second, s1, s2: second * s1**2 + first * s2),
        (
            Slip(
                "at a constant rate it would have no acceleration, not even in a bend",
                lambda p: _motion(p, lambda first, second, s1, s2: first * s2),
            ),
            Slip(
                "a bend taken twice as fast needs four times the acceleration",
                lambda p: _motion(p, lambda first, second, s1, s2: second * s1 + first * s2),
            ),
            Slip(
                "p' and p'' have changed places: which goes with s''?",
                lambda p: _motion(p, lambda first, second, s1, s2: first * s1**2 + second * s2),
            ),
            Slip(
                "speeding up on a straight needs an acceleration too",
                lambda p: _motion(p, lambda first, second, s1, s2: second * s1**2 + 0 * first),
            ),
        ),
        points=2,
        inputs=_motions,
    ),
    Exercise(
        "15.4",
        "A pass that gains too little",
        "debug",
        10,
        _road,
        lambda p: _step(p, 2, _pythagoras),
        (
            Slip(
                "z is a speed squared: how much does v^2 gain over ds at the acceleration a?",
                lambda p: _step(p, 1, _pythagoras),
            ),
            Slip(
                "what the bend takes is k z; square all of it",
                lambda p: _step(p, 2, lambda a, k, z: np.sqrt(a**2 - k * z**2)),
            ),
            Slip(
                "two mistakes are left: what z gains over ds, and what the bend takes",
                lambda p: _step(p, 1, lambda a, k, z: np.sqrt(a**2 - k * z**2)),
            ),
            Slip(
                "the two accelerations are at right angles: they add as squares",
                lambda p: _step(p, 2, lambda a, k, z: a - k * z),
            ),
            Slip(
                "in the bend not all of the grip is left",
                lambda p: _step(p, 2, lambda a, k, z: a),
            ),
        ),
        points=2,
        inputs=_steps,
    ),
    Exercise(
        "15.5",
        "An engine weaker than its brakes",
        "design",
        20,
        _uneven,
        lambda p: _ramps(p, p.v_max),
        (
            Slip(
                "on a ramp the mean speed is half",
                lambda p: [p.v_max, p.v_max / p.engine, p.d / p.v_max, p.v_max / p.brake],
            ),
            Slip(
                "the engine gives",
                lambda p: [
                    p.v_max,
                    p.v_max / p.brake,
                    p.d / p.v_max - p.v_max / p.brake,
                    p.v_max / p.brake,
                ],
            ),
            Slip("is faster than the limit", lambda p: _ramps(p, 1.05 * p.v_max)),
            Slip(
                "does it reach the speed limit",
                lambda p: [
                    p.v_max,
                    p.v_max / p.engine,
                    p.d / p.v_max - p.v_max / p.engine,
                    p.v_max / p.engine,
                ],
            ),
            Slip("does it reach the speed limit", lambda p: _ramps(p, 0.8 * p.v_max)),
            Slip("the brakes hold", lambda p: [p.v_max, p.v_max / p.engine, 1.0, 0.1]),
            Slip("must be positive", lambda p: [p.v_max, 1.0, -1.0, 1.0]),
        ),
        points=3,
        judge=_judge_ramps,
    ),
    Exercise(
        "15.6",
        "Drive the hairpin",
        "play",
        25,
        _road,
        _driver,
        (
            Slip("brake before it", lambda p: lambda s, v: p.grip),
            Slip("the end is not reached", lambda p: lambda s, v: 0.0),
            Slip("and the tyres hold", lambda p: lambda s, v: 2 * p.grip),
            Slip("brake later", lambda p: _driver(p, bend=0.75)),
        ),
        points=3,
        judge=_judge_driver,
    ),
)
