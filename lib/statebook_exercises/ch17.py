"""Exercises of chapter 17, the capstone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import beyond

G = 9.8


def _shares(rng: np.random.Generator) -> dict[str, float]:
    return {
        "quickest": round(float(rng.uniform(0.8, 2.4)), 2),
        "kept": round(float(rng.uniform(0.25, 0.45)), 2),
    }


def _tick(rng: np.random.Generator) -> dict[str, float]:
    """One tick of an axis whose error is a single number."""
    low, high = [0.8, 0.3, 2.0, 0.5, 5.0], [0.99, 0.9, 9.0, 3.0, 20.0]
    return dict(
        zip(("a", "b", "q", "r", "s"), rng.uniform(low, high).round(2).tolist(), strict=True)
    )


def _back(p: Parameters, r: float = 1.0, q: float = 1.0, closed: float = 1.0) -> np.ndarray:
    """K and S one tick earlier; the factors leave a part out."""
    K = p.b * p.s * p.a / (r * p.r + p.b**2 * p.s)
    return np.array([K, q * p.q + p.a * p.s * (p.a - closed * p.b * K)])


def _crane(rng: np.random.Generator) -> dict[str, float]:
    return {
        "M": round(float(rng.uniform(2.0, 6.0)), 1),
        "m": round(float(rng.uniform(0.5, 1.8)), 2),
        "rope": round(float(rng.uniform(1.2, 3.5)), 2),
    }


def _force(p: Parameters, both: float = 1.0, snap: float = 1.0) -> Callable[..., Any]:
    """(M + m) y2 + M l / g y4 with the load's mass counted both times, and a factor of y4."""
    return lambda y2, y4: (p.M + both * p.m) * y2 + snap * p.M * p.rope / G * y4


def _courses(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-2, -8], [2, 8], size=(10, 2)).tolist()]


def _loop(rng: np.random.Generator) -> dict[str, float]:
    low, high = [0.02, 3.0, 2.5, 0.1, 0.02], [0.05, 8.0, 5.0, 0.4, 0.08]
    h, kp, kd, push, sensor = rng.uniform(low, high).round(3).tolist()
    return {"h": h, "kp": kp, "kd": kd, "push": push, "sensor": sensor}


def _spread(
    p: Parameters,
    gain: float = 1.0,
    tick: bool = True,
    read: bool = True,
    twice: bool = True,
    seen: str = "through K",
) -> Callable[..., Any]:
    """One step of the covariance; the arguments change or leave out a part."""
    h = p.h
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h**2 / 2], [h]])
    K = np.array([[p.kp, p.kd]])
    F = A - gain * B @ K
    push = p.push**2 / (h if tick else 1.0)
    sensor = np.eye(2) * p.sensor**2 / (h if read else 1.0)

    def step(P: np.ndarray) -> np.ndarray:
        moved = F @ P @ F.T if twice else F @ P
        added = B @ K @ sensor @ K.T @ B.T if seen == "through K" else sensor * (seen == "direct")
        return moved + push * B @ B.T + added

    return step


def _covariances(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    roots = rng.normal(scale=0.02, size=(8, 2, 2))
    return [(root @ root.T,) for root in roots]


def _axis(rng: np.random.Generator) -> dict[str, float]:
    """An axis with a limited force; what is asked for can be met with a share of 0.75."""
    m, way, limit = (round(float(v), 2) for v in rng.uniform([1.0, 0.6, 15], [3.0, 1.4, 30]))
    push, slow = round(float(rng.uniform(0.1, 0.3)), 2), float(rng.uniform(4.0, 8.0))
    rate = 1.2 * slow  # here the feedback may take 0.2 of the limit
    sensor = 0.04 * limit / (m * np.sqrt(rate**4 + 4 * rate**2 * 25))
    return {
        "m": m,
        "way": way,
        "limit": limit,
        "push": push,
        "sensor": round(float(sensor), 6),
        "longest": round(2 * np.sqrt(m * way / (0.68 * limit)), 3),
        "widest": round(1e3 * push / (2 * m * slow**1.5), 3),
    }


def _asked(p: Parameters, rate: float) -> float:
    """Five standard deviations of the feedback m (r^2 n_p + 2 r n_v), as a share of the limit."""
    return float(5 * p.m * np.hypot(rate**2, 2 * rate * 5) * p.sensor / p.limit)


def _slow(p: Parameters) -> float:
    """The rate at which the spread is just what is allowed."""
    return float((1e3 * p.push / (2 * p.m * p.widest)) ** (2 / 3))


_LONG = "the plan takes too long"
_WIDE = "the position strays too far"
_MORE = "plan and feedback together ask for more than the motor has"
_NONSENSE = "the share lies between 0 and 1, and the rate is positive"


def _judge_margin(answer: Any, p: Parameters) -> str:
    share, rate = map(float, answer)
    if not (0 < share <= 1 and 0 < rate < 1e3):
        return _NONSENSE
    longest = 2 * np.sqrt(p.m * p.way / (share * p.limit))
    if beyond(longest, p.longest):
        return f"{_LONG}: {longest:.3g} s, and {p.longest:g} s are allowed"
    spread = 1e3 * p.push / (2 * p.m * rate**1.5)
    if beyond(spread, p.widest):
        return f"{_WIDE}: {spread:.3g} mm, and {p.widest:g} mm are allowed"
    if share + _asked(p, rate) > 1:
        return f"{_MORE}: {share:.3g} + {_asked(p, rate):.3g} of the limit"
    return ""


def _cart(rng: np.random.Generator) -> dict[str, float]:
    low, high = [0.8, 0.2, 0.7, 0.7, 9.0], [1.6, 0.6, 1.4, 1.3, 14.0]
    names = ("m_cart", "m_pole", "L", "way", "limit")
    return dict(zip(names, rng.uniform(low, high).round(2).tolist(), strict=True))


def _peak(p: Parameters, T: float) -> float:
    """Largest force of the motion that leans first, as in the exercise."""
    cart = sb.CartPole(m_cart=p.m_cart, m_pole=p.m_pole, L=p.L, g=G)
    bump = np.polynomial.Polynomial([0, 0, 0, 0, 1, -4, 6, -4, 1])
    shape = -p.way / (G * T**2) * bump.deriv() / bump.integ()(1)
    s = np.linspace(0, 1, 401)

    def motion(amplitude: float) -> tuple[np.ndarray, np.ndarray]:
        lean = amplitude * shape
        phi, bend = lean(s), lean.deriv(2)(s) / T**2
        a = (p.L / 2 * bend - G * np.sin(phi)) / np.cos(phi)
        v = scipy.integrate.cumulative_simpson(a, x=s * T, initial=0)
        place = scipy.integrate.cumulative_simpson(v, x=s * T, initial=0)
        return np.stack([place, np.pi / 2 + phi, v, lean.deriv()(s) / T]), a

    amplitude = scipy.optimize.brentq(lambda k: motion(k)[0][0, -1] - p.way, 0.3, 1.7)
    return float(np.abs(sb.cart_force(cart, *motion(amplitude))).max())


def _shortest(p: Parameters) -> float:
    return float(scipy.optimize.brentq(lambda T: _peak(p, T) - p.limit, 1.2, 6.0, xtol=1e-6))


_STRONG = "the force would exceed the limit"
_LAZY = "it arrives, but it could be quicker by more than 3 %"
_BEYOND = "the duration lies between 1 s and 10 s"


def _judge_quick(answer: Any, p: Parameters) -> str:
    T = float(answer)
    if not 1 <= T <= 10:
        return f"{_BEYOND}, got {T:g}"
    if _peak(p, T) > 1.001 * p.limit:
        return f"{_STRONG} of {p.limit:g} N"
    return _LAZY if _peak(p, T / 1.03) < p.limit else ""


EXERCISES = (
    Exercise(
        "17.1",
        "The price of a margin",
        "compute",
        8,
        _shares,
        lambda p: p.quickest / np.sqrt(1 - p.kept),
        (
            Slip(
                "torques grow with the square of the speed: a square root is missing",
                lambda p: p.quickest / (1 - p.kept),
            ),
            Slip(
                "that would be the time with the kept share alone",
                lambda p: p.quickest / np.sqrt(p.kept),
            ),
            Slip("less torque makes the plan longer", lambda p: p.quickest * np.sqrt(1 - p.kept)),
            Slip(
                "a tangent at no margin: yours is too large for it",
                lambda p: p.quickest * (1 + p.kept / 2),
            ),
        ),
    ),
    Exercise(
        "17.2",
        "One tick backwards",
        "compute",
        10,
        _tick,
        _back,
        (
            Slip(
                "where is the price of control, R?",
                lambda p: _back(p, r=0.0),
            ),
            Slip("the cost of the error at this tick, Q, is missing", lambda p: _back(p, q=0.0)),
            Slip(
                "S of the loop without feedback: A - B K is missing",
                lambda p: _back(p, closed=0.0),
            ),
            Slip("A - B K, not A + B K", lambda p: _back(p, closed=-1.0)),
            Slip("first the gain, then the cost", lambda p: _back(p)[::-1]),
        ),
        points=2,
    ),
    Exercise(
        "17.3",
        "The force that a load asks for",
        "derive",
        20,
        _crane,
        _force,
        (
            Slip(
                "that is the upright pole: a load that hangs swings the other way",
                lambda p: _force(p, snap=-1.0),
            ),
            Slip("the trolley carries the load as well", lambda p: _force(p, both=0.0)),
            Slip(
                "that is a rigid load: the rope's swing, in the fourth derivative, is missing",
                lambda p: _force(p, snap=0.0),
            ),
            Slip(
                "only the trolley feels the fourth derivative: the load's own acceleration is y''",
                lambda p: _force(p, snap=(p.M + p.m) / p.M),
            ),
        ),
        points=2,
        inputs=_courses,
    ),
    Exercise(
        "17.4",
        "A prediction that is too good",
        "debug",
        15,
        _loop,
        _spread,
        (
            Slip(
                "the sensors' errors do not move the axis by themselves: they act through K and B",
                lambda p: _spread(p, seen="direct"),
            ),
            Slip("the sensors' errors are missing", lambda p: _spread(p, seen="none")),
            Slip(
                "a noise given by its integral is held for a tick: its variance is divided by h",
                lambda p: _spread(p, tick=False, read=False),
            ),
            Slip(
                "the sensors' errors too are held for a tick: their variance is divided by h",
                lambda p: _spread(p, read=False),
            ),
            Slip(
                "two mistakes are left: the variances over a tick, and the way of the sensors'"
                " errors",
                lambda p: _spread(p, tick=False, read=False, seen="direct"),
            ),
            Slip("feedback subtracts: F = A - B K", lambda p: _spread(p, gain=-1.0)),
            Slip(
                "a covariance is transformed on both sides: F P F'",
                lambda p: _spread(p, twice=False),
            ),
        ),
        points=2,
        rtol=1e-3,
        inputs=_covariances,
    ),
    Exercise(
        "17.5",
        "Choose the margin",
        "design",
        25,
        _axis,
        lambda p: np.array([0.74, 1.05 * _slow(p)]),
        (
            Slip(_LONG, lambda p: np.array([0.5, 1.05 * _slow(p)])),
            Slip(_WIDE, lambda p: np.array([0.74, 0.7 * _slow(p)])),
            Slip(_MORE, lambda p: np.array([1.0, 1.05 * _slow(p)])),
            Slip(_MORE, lambda p: np.array([0.74, 3.0 * _slow(p)])),
            Slip(_NONSENSE, lambda p: np.array([74.0, _slow(p)])),
        ),
        points=3,
        judge=_judge_margin,
    ),
    Exercise(
        "17.6",
        "As quick as the force allows",
        "play",
        20,
        _cart,
        _shortest,
        (
            Slip(_STRONG, lambda p: 0.9 * _shortest(p)),
            Slip(_LAZY, lambda p: 1.2 * _shortest(p)),
            Slip(_BEYOND, lambda p: 0.2),
        ),
        points=3,
        judge=_judge_quick,
    ),
)
