"""Milestones of project 91: swing a cart's pole up and catch it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Rubric, Slip
from statebook_exercises.answers import Watched

G = 9.8
CLOCK = 0.02  # [s]
NO_TORQUE = 1e9  # the price of a torque at the pin
TOP = np.array([0.0, np.pi / 2, 0.0, 0.0])
BOTTOM = np.array([0.0, -np.pi / 2, 0.0, 0.0])
# The machine of the leaderboard, the same for all.
BENCH = Parameters(m_cart=1.0, m_pole=0.3, L=1.0, limit=8.0, half=0.7)
STANDING = 8.0  # when it must stand at the latest [s]
LONG = 10.0  # a run on the bench [s]
NEAR = 0.1  # from upright [rad], and from the middle [m]


def _machine(rng: np.random.Generator) -> dict[str, float]:
    """A machine with the bench's proportions, roughly."""
    m_cart, share, L = rng.uniform([0.8, 0.24, 0.7], [1.6, 0.34, 1.3]).round(2).tolist()
    m_pole = round(share * m_cart, 2)
    return {
        "m_cart": m_cart,
        "m_pole": m_pole,
        "L": L,
        "limit": round(6.2 * (m_cart + m_pole), 1),
        "half": round(0.75 * L, 2),
    }


def _leaning(rng: np.random.Generator) -> dict[str, float]:
    return {**_machine(rng), "lean": round(float(rng.uniform(0.18, 0.26)), 2)}


def _errors(rng: np.random.Generator) -> dict[str, float]:
    """Errors of the pole's mass and of its length [%]."""
    mass, length = rng.uniform([6.0, 2.0], [10.0, 4.0]).round(1).tolist()
    return {"mass_error": mass, "length_error": length}


def _cart_pole(p: Parameters) -> sb.CartPole:
    return sb.CartPole(p.m_cart, p.m_pole, p.L, G)


def _power(
    p: Parameters, lever: float = 0.5, part: Callable[[Any], Any] = np.sin, sign: float = 1.0
) -> Callable[..., Any]:
    """What an acceleration of the pin does to the pole's energy [W]."""
    return lambda theta, omega, a: sign * p.m_pole * lever * p.L * part(theta) * omega * a


def _motions(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-3, -5, -5], [3, 5, 5], size=(12, 3)).tolist()]


def _gains(p: Parameters, price: float = 0.1) -> np.ndarray:
    law = sb.LQR(_cart_pole(p), TOP, Q=[4, 10, 1, 1], R=[price, NO_TORQUE])
    return np.asarray(law.K[0])


def _run(p: Parameters, x0: np.ndarray, policy: Watched, duration: float) -> sb.Trajectory:
    return sb.simulate_clocked(
        _cart_pole(p),
        x0,
        lambda x, t: np.append(policy(x, t), 0.0),
        period=CLOCK,
        duration=duration,
        samples=2,
        method="rk4",
    )


def _lean(run: sb.Trajectory) -> np.ndarray:
    return np.abs(sb.wrap_angle(run.states[1] - np.pi / 2))


def _off_track(run: sb.Trajectory, p: Parameters, samples: int | None = None) -> str:
    way = float(np.abs(run.states[0, :samples]).max())
    return f"the cart reaches {way:.3g} m, the track ends at {p.half:g} m" if way > p.half else ""


_FALLS = "the pole falls"
_FRAIL = "the error is not made up for"


def _judge_catch(answer: Any, p: Parameters) -> str:
    K = np.clip(np.asarray(answer, dtype=float), -1e4, 1e4)
    law = Watched(lambda x, t: -K @ (x - TOP), [p.limit])
    run = _run(p, np.add(TOP, [0.0, p.lean, 0.0, 0.0]), law, 5.0)
    if _lean(run).max() > 1.0:
        return (
            f"{_FALLS}: the law is force = -K (p, theta - pi/2, v, omega), cut at {p.limit:g} N;"
            " have a look at the signs, and at how hard it pushes first"
        )
    if trouble := _off_track(run, p):
        return trouble
    late = run.times >= 3.0
    lean, place = _lean(run)[late].max(), np.abs(run.states[0])[late].max()
    if lean > 0.02:
        return f"after 3 s the pole still leans by {lean:.3g} rad; 0.02 rad are allowed"
    if place > 0.05:
        return f"after 3 s the cart is still {place:.3g} m from the middle; 0.05 m are allowed"
    return ""


def swing_up(
    p: Parameters, pump: float = 4.0, spring: float = 8.0, catch: float = 6.0
) -> Callable[..., Any]:
    """Return a policy that pumps energy, keeps to the middle, and catches the pole.

    Accelerations [m/s^2] that pump, and that a metre from the middle calls for; and the LQR's
    cost to go below which it catches.
    """
    machine, total = _cart_pole(p), p.m_cart + p.m_pole
    law = sb.LQR(machine, TOP, Q=[4, 10, 1, 1], R=[0.1, NO_TORQUE])
    K, S, arm = law.K[0], law.S, p.L / 2

    def policy(x: np.ndarray, t: float) -> float:
        place, theta, v, omega = x
        off = np.array([place, sb.wrap_angle(theta - np.pi / 2), v, omega])
        if off @ S @ off < catch:
            return float(np.clip(-K @ off, -p.limit, p.limit))
        lack = G * arm * (1 - np.sin(theta)) - arm**2 * omega**2 / 2
        a = np.clip(20 * lack * omega * np.sin(theta), -pump, pump)
        a = pump if t < 0.3 else a - spring / p.L * place - 2 / np.sqrt(p.L) * v
        turning = (a * np.sin(theta) - G * np.cos(theta)) / arm
        pole = turning * np.sin(theta) + omega**2 * np.cos(theta)
        return float(np.clip(total * a - p.m_pole * arm * pole, -p.limit, p.limit))

    return policy


def _judge_swing(answer: Any, p: Parameters) -> str:
    law = Watched(answer, [p.limit])
    run = _run(p, BOTTOM, law, 10.0)
    # Whatever happens after it has been up is the next milestone's concern.
    up = (_lean(run) < 0.3) & (np.abs(run.states[3]) < 2.5 / np.sqrt(p.L))
    if not up.any():
        return (
            f"in 10 s the pole is never up and slow; it comes to {_lean(run).min():.2f} rad from"
            " upright. In which direction must the cart accelerate to add energy?"
        )
    return law.excess("N") or _off_track(run, p, int(up.argmax()) + 1)


def _harder(p: Parameters) -> Callable[..., Any]:
    law = swing_up(p)
    return lambda x, t: 3 * law(x, t)


def _standing(run: sb.Trajectory) -> float:
    """Time from which on the pole stands, the cart in the middle [s]."""
    away = (_lean(run) > NEAR) | (np.abs(run.states[0]) > NEAR)
    return float(run.times[np.flatnonzero(away)[-1]])


def _falls(run: sb.Trajectory) -> str:
    if _standing(run) <= STANDING:
        return ""
    late = run.times >= STANDING
    lean, place = _lean(run)[late].max(), np.abs(run.states[0])[late].max()
    return f"after {STANDING:g} s the pole is {lean:.2f} rad and the cart {place:.2f} m off"


def _rubric(answer: Any, p: Parameters) -> Rubric:
    law = Watched(answer, [BENCH.limit])
    run = _run(BENCH, BOTTOM, law, LONG)
    others = []
    for mass, length in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        other = Parameters(**vars(BENCH))
        other.m_pole *= 1 + mass * p.mass_error / 100
        other.L *= 1 + length * p.length_error / 100
        tried = _run(other, BOTTOM, law, LONG)
        name = f"so too with a mass of {other.m_pole:.3f} kg and a length of {other.L:.3f} m"
        trouble = _falls(tried) or _off_track(tried, BENCH)
        others.append((1, name, trouble and f"{_FRAIL}: {trouble}"))
    fallen = _falls(run)
    idle = fallen and "that counts where the pole stands"
    rows = (
        (3, f"after {STANDING:g} s the pole stands, the cart in the middle", fallen),
        (1, f"the force stays within {BENCH.limit:g} N", law.excess("N") or idle),
        (2, f"the cart stays within {BENCH.half:g} m", _off_track(run, BENCH) or idle),
        *others,
    )
    work = np.abs(np.asarray(run.controls)[0] * run.states[2, :-1]) @ np.diff(run.times)
    spare = BENCH.half - np.abs(run.states[0]).max()
    score = f"{_standing(run):.2f} s to stand, {work:.1f} J, {spare:.2f} m to spare"
    return Rubric(rows, score)


def _replayed(p: Parameters) -> Callable[..., Any]:
    """The forces of the good run, whatever happens."""
    run = _run(BENCH, BOTTOM, Watched(swing_up(BENCH), [BENCH.limit]), 4.0)
    forces = np.asarray(run.controls)[0, ::2]
    return lambda x, t: forces[min(round(t / CLOCK), len(forces) - 1)]


EXERCISES = (
    Exercise(
        "91.1",
        "What pumps the pole",
        "project",
        45,
        _machine,
        _power,
        (
            Slip("the mass sits halfway up, at L/2", lambda p: _power(p, lever=1.0)),
            Slip(
                "sine and cosine: when the pole hangs, its mass moves sideways, as the cart does",
                lambda p: _power(p, part=np.cos),
            ),
            Slip(
                "look at the sign: seen from the cart, the mass is pushed by -m a",
                lambda p: _power(p, sign=-1.0),
            ),
            Slip(
                "two mistakes: the sign, and sine and cosine",
                lambda p: _power(p, part=np.cos, sign=-1.0),
            ),
        ),
        points=2,
        inputs=_motions,
    ),
    Exercise(
        "91.2",
        "The catch",
        "project",
        75,
        _leaning,
        _gains,
        (
            Slip(_FALLS, lambda p: -_gains(p)),
            Slip(_FALLS, lambda p: _gains(p) * [1, 0.2, 1, 1]),
            Slip("the track ends", lambda p: _gains(p) * [0, 1, 0, 1]),
            Slip("after 3 s", lambda p: _gains(p) * [0.2, 1, 1, 1]),
        ),
        points=3,
        judge=_judge_catch,
    ),
    Exercise(
        "91.3",
        "Up, on your machine",
        "project",
        120,
        _machine,
        swing_up,
        (
            Slip("never up and slow", lambda p: lambda x, t: 0.0),
            Slip("to add energy", lambda p: swing_up(p, pump=-4.0)),
            Slip("the track ends", lambda p: swing_up(p, spring=0.0)),
            Slip("the limit is", _harder),
        ),
        points=3,
        judge=_judge_swing,
    ),
    Exercise(
        "91.4",
        "Up, caught, and robust",
        "project",
        180,
        _errors,
        lambda p: swing_up(BENCH),
        (
            Slip("the pole is 3.14 rad", lambda p: lambda x, t: 0.0),
            Slip("the limit is 8 N", lambda p: lambda x, t: 9.0 if t < 0.1 else 0.0),
            Slip("the track ends at 0.7 m", lambda p: swing_up(BENCH, pump=5.0, spring=0.0)),
            Slip(_FRAIL, _replayed),
        ),
        points=10,
        judge=_rubric,
    ),
)
