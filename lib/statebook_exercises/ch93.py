"""Milestones of project 93: time a path for an arm with a payload, and track it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import scipy

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Rubric, Slip
from statebook_exercises.answers import Watched

G = 9.8
GRID = np.linspace(0.0, 1.0, 101)
SPARE = 1.03  # of each limit, between gridpoints
SLOW = 1.08  # of the shortest duration
CLOCK = 0.01  # [s]
LONG = 2.5  # a run on the bench [s]
STILL = 0.1  # [rad/s]
_FRAIL = "the error is not made up for"
# The arm, the limits and the waypoints of the leaderboard, the same for all.
BENCH = Parameters(
    l1=0.5, l2=0.4, m1=2.0, m2=1.0, payload=0.5, v1=2.5, v2=3.0, a1=15.0, a2=20.0, tau1=38.0,
    tau2=11.0, error=0.0,
)  # fmt: skip
WAYPOINTS = np.array([[0.2, 0.9, 1.3, 0.7], [1.0, 0.4, -0.6, -1.2]])  # [rad]


def _arm_of(rng: np.random.Generator) -> dict[str, float]:
    low, high = [0.4, 0.3, 1.2, 0.6, 0.4], [0.6, 0.45, 2.4, 1.2, 0.9]
    names = ("l1", "l2", "m1", "m2", "payload")
    return dict(zip(names, rng.uniform(low, high).round(2).tolist(), strict=True))


def _arm(
    p: Parameters, hand: float = 1.0, elbow: float = 0.0, gravity: float = 1.0
) -> sb.PlanarArm:
    """The arm with its payload; the arguments put shares of it elsewhere."""
    masses = (p.m1 + elbow * p.payload, p.m2 + hand * p.payload)
    return sb.PlanarArm((p.l1, p.l2), masses, G * gravity)


def _torques(p: Parameters, **parts: float) -> Callable[..., Any]:
    return _arm(p, **parts).inverse_dynamics


def _motions(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(rng.uniform(-3, 3, size=(3, 2))) for _ in range(12)]


def _line(rng: np.random.Generator) -> dict[str, float]:
    """A line that the hand can reach, to the right of the shoulder."""
    l1, l2 = rng.uniform([0.4, 0.3], [0.6, 0.4]).round(2).tolist()
    reach = l1 + l2
    low, high = [0.45, 0.45, 0.35, -0.35], [0.6, 0.6, 0.5, -0.2]
    places = (reach * rng.uniform(low, high)).round(2).tolist()
    return {"l1": l1, "l2": l2, **dict(zip(("xa", "ya", "xb", "yb"), places, strict=True))}


def _joints(
    p: Parameters, bent: float = -1.0, absolute: bool = False, inner: bool = False
) -> Callable[..., Any]:
    """Joint angles by s with the hand on the line; the arguments are slips."""

    def joints(s: Any) -> np.ndarray:
        x, y = p.xa + s * (p.xb - p.xa), p.ya + s * (p.yb - p.ya)
        cosine = (x**2 + y**2 - p.l1**2 - p.l2**2) / (2 * p.l1 * p.l2)
        q2 = bent * np.arccos(cosine)
        q1 = np.arctan2(y, x) - np.arctan2(p.l2 * np.sin(q2), p.l1 + p.l2 * np.cos(q2))
        q2 = q2 + q1 if absolute else q2
        return np.array([q1, np.pi + q2 if inner else q2])

    return joints


def _along(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [(float(s),) for s in rng.uniform(0, 1, size=12)]


def _limited(rng: np.random.Generator) -> dict[str, float]:
    """An arm near the bench's, with limits of its own and a payload known to some per cent."""
    drawn = {
        name: round(value * float(rng.uniform(0.9, 1.1)), 2)
        for name, value in vars(BENCH).items()
        if name != "error"
    }
    strength = float(rng.uniform(0.8, 0.9))  # so that torque is what counts
    drawn.update({name: round(strength * getattr(BENCH, name), 1) for name in ("tau1", "tau2")})
    return {**drawn, "error": round(float(rng.uniform(20, 35)), 1)}


def _limits(p: Parameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity, acceleration, and torque twice: with the lightest and the heaviest payload."""
    torque = np.array([p.tau1, p.tau2])
    return np.array([p.v1, p.v2]), np.array([p.a1, p.a2]), np.concatenate([torque, torque])


def _both(p: Parameters) -> Callable[..., np.ndarray]:
    """Torques with the lightest and with the heaviest payload, four rows."""
    light, heavy = (_arm(p, hand=1 + sign * p.error / 100) for sign in (-1, 1))
    return lambda *motion: np.concatenate([arm.inverse_dynamics(*motion) for arm in (light, heavy)])


def _path() -> sb.Path:
    return sb.Path.through(WAYPOINTS)


def timed(p: Parameters, share: float = 1.0) -> sb.TimedPath:
    """Return the bench's path timed within a share of the limits."""
    velocity, acceleration, torque = (share * limit for limit in _limits(p))
    return sb.time_scale(_path(), velocity, acceleration, torque=torque, inverse_dynamics=_both(p))


def _profile(p: Parameters, share: float = 0.97) -> np.ndarray:
    """s'^2 at the gridpoints."""
    motion = timed(p, share)
    return np.interp(GRID, motion.s, motion.sdot**2)


def _sure(p: Parameters) -> np.ndarray:
    """The profile of one who trusts the payload."""
    return _profile(Parameters(**{**vars(p), "error": 0.0}))


_REST = "the arm starts and ends at rest"


def _judge_profile(answer: Any, p: Parameters) -> str:
    z = np.asarray(answer, dtype=float)
    if max(abs(z[0]), abs(z[-1])) > 1e-9:
        return f"{_REST}: s'^2 must be 0 at both ends"
    if z[1:-1].min() <= 0 or z.max() > 1e4:
        return "s'^2 must be positive inside: the arm never stops on its way"
    path, gain = _path(), np.diff(z) / (2 * np.diff(GRID))  # s'' of each interval
    share = np.linspace(0, 1, 5)
    s = (GRID[:-1, None] + np.diff(GRID)[:, None] * share).ravel()
    zs = (z[:-1, None] + np.diff(z)[:, None] * share).ravel()
    rate, slope, bend = np.repeat(gain, 5), path(s, 1), path(s, 2)
    velocity, acceleration = slope * np.sqrt(zs), slope * rate + bend * zs
    torque = _both(p)(path(s), velocity, acceleration)
    names = ("velocity", "acceleration", "torque", "torque")
    use = np.concatenate([velocity, acceleration, torque])
    use = np.abs(use) / np.concatenate(_limits(p))[:, None]
    row, k = np.unravel_index(use.argmax(), use.shape)
    if use[row, k] > SPARE:
        load = "" if row < 4 else f" with the {'lightest' if row < 6 else 'heaviest'} payload"
        return (
            f"the {names[row // 2]} of joint {row % 2 + 1}{load} reaches {use[row, k]:.3f} of its"
            f" limit at s = {s[k]:.2f}"
        )
    duration = float((2 * np.diff(GRID) / (np.sqrt(z[:-1]) + np.sqrt(z[1:]))).sum())
    best = timed(p).duration
    if duration > SLOW * best:
        return (
            f"all limits are kept, and it takes {duration:.3f} s; {SLOW * best:.3f} s will do:"
            " where is no limit reached?"
        )
    return ""


def _errors(rng: np.random.Generator) -> dict[str, float]:
    """Errors of the payload [%], and the joints' friction [N m s/rad]."""
    error, friction = rng.uniform([12.0, 0.1], [25.0, 0.25]).round(2).tolist()
    return {"error": error, "friction": friction}


@cache
def _plan(share: float, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and (q, q', q'') of the bench's path, shape (3, 2, T)."""
    motion = timed(Parameters(**{**vars(BENCH), "error": error}), share)
    t = np.linspace(0, motion.duration, 400)
    return t, np.stack([motion.position(t), motion.velocity(t), motion.acceleration(t)])


def track(share: float = 0.85, stiffness: float = 400.0, error: float = 25.0) -> Callable[..., Any]:
    """Return a policy that follows the path timed within a share of the limits."""
    t_plan, plan = _plan(share, error)
    arm, limits = _arm(BENCH), _limits(BENCH)[2][:2]

    def policy(x: np.ndarray, t: float) -> np.ndarray:
        q, v, a = (np.array([np.interp(t, t_plan, row) for row in rows]) for rows in plan)
        if t >= t_plan[-1]:
            v, a = np.zeros(2), np.zeros(2)
        a = a + stiffness * (q - x[:2]) + 2 * np.sqrt(stiffness) * (v - x[2:])
        return np.clip(arm.inverse_dynamics(x[:2], x[2:], a), -limits, limits)

    return policy


def _run(law: Watched, payload: float, friction: float) -> sb.Trajectory:
    arm = _arm(BENCH, hand=payload)
    return sb.simulate_clocked(
        lambda x, u: arm.dynamics(x, u - friction * x[2:]),
        [*WAYPOINTS[:, 0], 0.0, 0.0],
        law,
        period=CLOCK,
        duration=LONG,
        samples=2,
        method="rk4",
    )


def _hand(q: np.ndarray) -> np.ndarray:
    return np.asarray(_arm(BENCH).positions(q)[1])


def _strays(run: sb.Trajectory) -> np.ndarray:
    """Distance of the hand from the path [mm]."""
    path = _hand(_path()(np.linspace(0, 1, 2001)))
    distance, _ = scipy.spatial.cKDTree(path.T).query(_hand(run.states[:2]).T)
    return 1e3 * np.asarray(distance)


def _away(run: sb.Trajectory, near: float) -> np.ndarray:
    """Whether the hand is farther than near [mm] from the end, or moves."""
    way = _hand(run.states[:2]) - _hand(WAYPOINTS[:, -1])[:, None]
    return (1e3 * np.hypot(*way) > near) | (np.abs(run.states[2:]).max(axis=0) > STILL)


def _misses(run: sb.Trajectory, near: float, wide: float) -> tuple[str, str]:
    """Return what is wrong with the arrival, and with the way, in mm."""
    last = 1e3 * np.hypot(*(_hand(run.states[:2, -1]) - _hand(WAYPOINTS[:, -1])))
    away = f"it ends {last:.1f} mm from the end of the path" if _away(run, near)[-1] else ""
    far = _strays(run).max()
    return away, f"the hand strays {far:.1f} mm, {wide:g} mm are allowed" if far > wide else ""


def _fast(run: sb.Trajectory) -> str:
    use = np.abs(run.states[2:]).max(axis=1) / _limits(BENCH)[0]
    if use.max() <= 1.0:
        return ""
    return f"joint {use.argmax() + 1} reaches {use.max():.3f} of its velocity limit"


def _rubric(answer: Any, p: Parameters) -> Rubric:
    law = Watched(answer, [BENCH.tau1, BENCH.tau2])
    run = _run(law, 1.0, 0.0)
    others = []
    for sign, friction in ((-1, 0.0), (1, 0.0), (-1, p.friction), (1, p.friction)):
        tried = _run(law, 1 + sign * p.error / 100, friction)
        name = f"so too with a payload {sign * p.error:+g} % and friction {friction:g} N m s/rad"
        trouble = " and ".join(filter(None, _misses(tried, 12.0, 20.0)))
        others.append((1, name, trouble and f"{_FRAIL}: {trouble}"))
    away, strays = _misses(run, 5.0, 10.0)
    torque = law.excess("N m")
    idle = away and "that counts where the hand arrives"
    rows = (
        (3, f"after {LONG:g} s the hand is at rest at the end of the path", away),
        (1, f"torques stay within {BENCH.tau1:g} and {BENCH.tau2:g} N m", torque or idle),
        (1, f"velocities stay within {BENCH.v1:g} and {BENCH.v2:g} rad/s", _fast(run) or idle),
        (1, "the hand keeps to the path", strays or idle),
        *others,
    )
    arrived = run.times[np.flatnonzero(_away(run, 5.0))[-1]]
    power = np.abs(np.asarray(run.controls) * run.states[2:, :-1]).sum(axis=0)
    work, far = power @ np.diff(run.times), _strays(run).max()
    return Rubric(rows, f"{arrived:.2f} s, {work:.1f} J, {far:.1f} mm from the path")


def _stronger(p: Parameters) -> Callable[..., Any]:
    law = track()
    return lambda x, t: 1.5 * law(x, t)


EXERCISES = (
    Exercise(
        "93.1",
        "Torques with a payload",
        "project",
        45,
        _arm_of,
        _torques,
        (
            Slip("where is the payload?", lambda p: _torques(p, hand=0.0)),
            Slip(
                "the payload is in the hand, not at the elbow",
                lambda p: _torques(p, hand=0.0, elbow=1.0),
            ),
            Slip(
                "the arm moves in a vertical plane: where is gravity?",
                lambda p: _torques(p, gravity=0.0),
            ),
            Slip("the payload counts once", lambda p: _torques(p, hand=2.0)),
        ),
        points=2,
        inputs=_motions,
    ),
    Exercise(
        "93.2",
        "The hand on a line",
        "project",
        75,
        _line,
        _joints,
        (
            Slip("that is the other elbow: q2 must be negative", lambda p: _joints(p, bent=1.0)),
            Slip(
                "the second angle counts from the first link", lambda p: _joints(p, absolute=True)
            ),
            Slip(
                "that is the angle inside the elbow: stretched, q2 is 0",
                lambda p: _joints(p, inner=True),
            ),
        ),
        points=2,
        inputs=_along,
    ),
    Exercise(
        "93.3",
        "As fast as every payload allows",
        "project",
        150,
        _limited,
        _profile,
        (
            Slip(_REST, lambda p: np.ones(101)),
            Slip("never stops", lambda p: np.zeros(101)),
            Slip("the heaviest payload", _sure),
            Slip("of its limit at s", lambda p: 1.2 * _profile(p)),
            Slip("where is no limit reached", lambda p: 0.7 * _profile(p)),
        ),
        points=4,
        judge=_judge_profile,
    ),
    Exercise(
        "93.4",
        "Track it, whatever it carries",
        "project",
        150,
        _errors,
        lambda p: track(),
        (
            Slip("mm from the end of the path", lambda p: lambda x, t: [0.0, 0.0]),
            Slip("it asks for", _stronger),
            Slip("of its velocity limit", lambda p: track(1.1)),
            Slip(_FRAIL, lambda p: track(stiffness=20.0)),
        ),
        points=10,
        judge=_rubric,
    ),
)
