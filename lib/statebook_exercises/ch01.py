"""Exercises of chapter 01, state and control."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

G = 9.8

# ---- 01.1: the cart of the chapter, m = 2 kg, kp = 18 N/m ----


def _push(rng: np.random.Generator) -> dict[str, float]:
    return {"d": round(float(rng.uniform(0.7, 1.4)), 2), "t": round(float(rng.uniform(2.5, 4)), 1)}


# ---- 01.2 ----


def _pendulum(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(0.3, 0.8)), 2),
        "L": round(float(rng.uniform(0.3, 0.8)), 2),
        "theta": round(float(rng.uniform(0.3, 1.1)), 2),
        "omega": round(float(rng.uniform(2, 4)), 1),
        "u": round(float(rng.uniform(0.5, 2)), 1),
    }


def _rates(p: Parameters, gravity: float = -1.0, power: int = 2) -> np.ndarray:
    torque = p.u + gravity * p.m * G * p.L * np.cos(p.theta)
    return np.array([p.omega, torque / (p.m * p.L**power)])


# ---- 01.3: a car that carries an arm ----


def _machine(rng: np.random.Generator) -> dict[str, int]:
    joints = int(rng.integers(3, 30))
    return {"joints": joints, "slow": int(rng.integers(1, joints))}


def _count(p: Parameters, *, angles: int = 2, slow: int = 1, car: int = 3) -> np.ndarray:
    return np.array([angles * p.joints + slow * p.slow + car, p.joints + 2], dtype=float)


# ---- 01.4 ----


def _tracking(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(1.5, 4)), 1),
        "kp": round(float(rng.uniform(5, 15)), 1),
        "kd": round(float(rng.uniform(4, 9)), 1),
    }


def _law(p: Parameters, ahead: float = 1.0, damper: float = 1.0, mass: bool = True) -> Any:
    """Feed ahead times the plan's force, and pull towards it."""

    def force(x: Any, plan: Any) -> float:
        inertia = p.m if mass else 1.0
        pulls = p.kp * (plan[0] - x[0]) + damper * p.kd * (plan[1] - x[1])
        return float(ahead * inertia * plan[2] + pulls)

    return force


def _moments(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(rng.uniform(-1, 1, 2), rng.uniform(-2, 2, 3)) for _ in range(12)]


# ---- 01.5 ----

OFFSET, OVERSHOOT, NEAR = 0.01, 0.02, 0.02  # m


def _cart(rng: np.random.Generator) -> dict[str, float]:
    m, d = round(float(rng.uniform(1, 4)), 1), round(float(rng.uniform(0.1, 0.4)), 2)
    limit = round(d / OFFSET * float(rng.uniform(1.5, 2)), 1)
    # Six time constants of critical damping at the lower end of kp, rounded up.
    return {"m": m, "d": d, "limit": limit, "T": round(8 * float(np.sqrt(m * OFFSET / d)) + 0.1, 1)}


def _gains(p: Parameters) -> np.ndarray:
    """Between the two bounds of kp, and critical damping."""
    kp = np.sqrt(p.d / OFFSET * p.limit)
    return np.array([kp, 2 * np.sqrt(kp * p.m)])


YIELDS = "the push holds it off by d / kp, and 0.01 m are allowed"
FORCE = "and the motor's limit is"
PAST = "m too far on the way, and 0.02 m are allowed: more damping"
LATE = "m are allowed by then: is the damper too strong?"
GROWS = "the damper pushes in the direction of motion: the error grows"


def _judge_gains(answer: Any, p: Parameters) -> str:
    kp, kd = map(float, answer)
    if kd <= 0:
        return GROWS
    if kp <= 0 or p.d / kp > OFFSET:
        return YIELDS
    A = np.array([[0.0, 1.0], [-kp / p.m, -kd / p.m]])
    times = np.linspace(0, 2 * p.T, 401)
    step = scipy.linalg.expm(A * times[1])
    left = [np.array([-1.0 - p.d / kp, 0.0])]  # of the error against where it ends
    for _ in times[1:]:
        left.append(step @ left[-1])
    error = np.array(left)[:, 0] + p.d / kp
    force = -kp * error - kd * np.array(left)[:, 1]
    if beyond(np.abs(force).max(), p.limit):
        return f"the force reaches {np.abs(force).max():.3g} N, {FORCE} {p.limit:g} N"
    if error.max() > OVERSHOOT:
        return f"the cart goes {error.max():.3g} {PAST}"
    far = np.abs(error[times >= p.T]).max()
    return f"after {p.T:g} s it is {far:.3g} m off; {NEAR:g} {LATE}" if far > NEAR else ""


# ---- 01.6 ----

PERIOD = 0.02  # s


def _race(rng: np.random.Generator) -> dict[str, float]:
    m, limit = round(float(rng.uniform(1, 3)), 1), round(float(rng.uniform(4, 9)), 1)
    D = round(float(rng.uniform(0.8, 1.5)), 2)
    fastest = 2 * np.sqrt(m * D / limit)  # full force forwards, then backwards
    return {"m": m, "limit": limit, "D": D, "T": round(2.2 * float(fastest), 2)}


STRONG = "N, and the limit is"
MISSED = "m from the goal, and 0.03 m are allowed"
STAYS = "and after another second it is"


def _judge_policy(answer: Any, p: Parameters) -> str:
    cart = sb.Particle(m=p.m)
    for share in (0.0, 0.1, -0.1):
        seen: list[float] = []

        def policy(x: np.ndarray, t: float, seen: list[float] = seen) -> Any:
            u = answer(x, t)
            seen.append(float(np.max(np.abs(u), initial=0.0)))
            return np.clip(u, -p.limit, p.limit)

        def pushed(x: np.ndarray, u: np.ndarray, d: float = share * p.limit) -> np.ndarray:
            return cart.dynamics(x, np.asarray(u) + d)

        run = sb.simulate_clocked(
            pushed, [0.0, 0.0], policy, period=PERIOD, duration=p.T + 1, samples=1
        )
        if max(seen) > p.limit * (1 + 1e-9):
            return f"your force reaches {max(seen):.3g} {STRONG} {p.limit:g} N"
        late = np.abs(run.states[0, run.times >= p.T] - p.D)
        if late.max() > 0.03:
            return (
                f"with a push of {share * p.limit:.2g} N it is {late[0]:.2g} m off after {p.T:g} s,"
                f" {STAYS} {late[-1]:.2g} {MISSED} all along"
            )
    return ""


def _springs(p: Parameters, offset: float = 0.02) -> Callable[..., Any]:
    """A spring and a damper to the goal, as strong as a push of a tenth of the limit asks for."""
    kp = 0.1 * p.limit / offset
    kd = 2 * np.sqrt(kp * p.m) * 1.1

    def policy(x: Any, t: float) -> float:
        # Never faster than can be braked with nine tenths of the force.
        away = p.D - x[0]
        fastest = np.sqrt(2 * 0.7 * p.limit / p.m * abs(away))
        wanted = np.clip(kp / kd * away, -fastest, fastest)
        return float(np.clip(kd * (wanted - x[1]), -p.limit, p.limit))

    return policy


def _plan_alone(p: Parameters) -> Callable[..., Any]:
    """Full force forwards for half of the time, then backwards."""
    half = np.sqrt(p.m * p.D / p.limit)
    return lambda x, t: p.limit * (t < half) - p.limit * (half <= t < 2 * half)


EXERCISES = (
    Exercise(
        "01.1",
        "How far does the plan drift?",
        "read off",
        5,
        _push,
        lambda p: p.d * p.t**2 / 4,
        (
            Slip(
                "that is the drift under the push of the figure; yours is another",
                lambda p: 0.3 * p.t**2 / 4,
            ),
            Slip(
                "that is where the cart is; its error is the distance from the plan, which ends at"
                " 1 m",
                lambda p: 1 + p.d * p.t**2 / 4,
            ),
            Slip("that is the offset of the policies, d / kp", lambda p: p.d / 18),
            Slip(
                "a constant force makes a parabola: twice the time, four times the drift",
                lambda p: p.d * p.t / 2,
            ),
            Slip(
                "half: the velocity grows from 0, so on the way it is half of the last one",
                lambda p: p.d * p.t**2 / 2,
            ),
        ),
        rtol=0.05,
    ),
    Exercise(
        "01.2",
        "What f returns",
        "compute",
        10,
        _pendulum,
        _rates,
        (
            Slip(
                "gravity pulls towards hanging: at theta = 0 the pendulum falls",
                lambda p: _rates(p, gravity=1.0),
            ),
            Slip(
                "a torque is divided by the moment of inertia, m L^2",
                lambda p: _rates(p, power=1),
            ),
            Slip("the order of the rates is that of the state", lambda p: _rates(p)[::-1]),
            Slip(
                "the first number of f is how fast the angle changes",
                lambda p: np.array([p.theta, _rates(p)[1]]),
            ),
            Slip("where is gravity?", lambda p: _rates(p, gravity=0.0)),
        ),
    ),
    Exercise(
        "01.3",
        "Count",
        "derive",
        15,
        _machine,
        _count,
        (
            Slip(
                "the angles alone do not decide the future: an arm that moves goes on moving",
                lambda p: _count(p, angles=1),
            ),
            Slip(
                "a slow motor has a memory: its torque now, which the command does not tell",
                lambda p: _count(p, slow=0),
            ),
            Slip(
                "the car's speed and steering angle are chosen at each moment: they are controls",
                lambda p: _count(p, car=5),
            ),
            Slip("where is the car's heading?", lambda p: _count(p, car=2)),
            Slip("first the states, then the controls", lambda p: _count(p)[::-1]),
        ),
        points=2,
        rtol=1e-6,
    ),
    Exercise(
        "01.4",
        "A cart that fights its plan",
        "debug",
        15,
        _tracking,
        _law,
        (
            Slip(
                "one mistake is left: the damper must pull towards the plan's velocity",
                lambda p: _law(p, damper=-1.0),
            ),
            Slip(
                "one mistake is left: the plan gives an acceleration, the motor a force",
                lambda p: _law(p, mass=False),
            ),
            Slip(
                "both mistakes are still there: look at the damper's sign, and at the units",
                lambda p: _law(p, damper=-1.0, mass=False),
            ),
            Slip(
                "the plan's own force is missing: the cart would always lag behind",
                lambda p: _law(p, ahead=0.0),
            ),
        ),
        points=2,
        inputs=_moments,
    ),
    Exercise(
        "01.5",
        "A spring and a damper",
        "design",
        20,
        _cart,
        _gains,
        (
            Slip(YIELDS, lambda p: _gains(p) * [0.3, 1.0]),
            Slip(FORCE, lambda p: _gains(p) * [3.0, 1.7]),
            Slip(PAST, lambda p: _gains(p) * [1.0, 0.3]),
            Slip(LATE, lambda p: _gains(p) * [1.0, 4.0]),
            Slip(GROWS, lambda p: _gains(p) * [1.0, -1.0]),
        ),
        points=3,
        judge=_judge_gains,
    ),
    Exercise(
        "01.6",
        "There in time, whatever pushes",
        "play",
        15,
        _race,
        _springs,
        (
            Slip(MISSED, _plan_alone),
            Slip(STRONG, lambda p: lambda x, t: 100 * (p.D - x[0]) - 20 * x[1]),
            Slip(MISSED, lambda p: lambda x, t: 0.5 * p.limit * (p.D - x[0]) / p.D),
        ),
        points=3,
        judge=_judge_policy,
    ),
)
