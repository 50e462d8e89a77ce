"""Exercises of chapter 12, disturbances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip
from statebook_exercises.answers import NOT_A_NUMBER, beyond, one_number


def _sensor(rng: np.random.Generator) -> dict[str, float]:
    return {
        "b": round(float(rng.uniform(0.03, 0.08)), 3),
        "sigma": round(float(rng.uniform(0.4, 0.8)), 2),
    }


def _free(rng: np.random.Generator) -> dict[str, float]:
    return {
        "m": round(float(rng.uniform(3.0, 9.0)), 1),
        "q": round(float(rng.uniform(0.8, 2.5)), 2),
        "d": round(float(rng.uniform(0.4, 0.8)), 2),
    }


def _drift_time(p: Parameters, m: float, d: float, three: float = 3.0) -> float:
    """The t at which q t^3 / 3 m^2 is d^2, of m^2 and d^2."""
    return float((three * m * d / p.q) ** (1 / 3))


def _gains_drawn(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([3, 0.5], [20, 5], size=(10, 2)).tolist()]


def _variances(
    p: Parameters, position: Callable[..., float], velocity: Callable[..., float]
) -> Callable[..., Any]:
    return lambda kp, kd: np.sqrt([position(kp, kd), velocity(kp, kd)])


def _right_variances(p: Parameters) -> Callable[..., Any]:
    return _variances(p, lambda kp, kd: p.q / (2 * kd * kp), lambda kp, kd: p.q / (2 * kd * p.m))


def _draws(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    rows = np.stack([rng.standard_normal(10), rng.uniform(0.02, 0.3, 10)], axis=1)
    return [tuple(row) for row in rows.tolist()]


def peak(kp: float, kd: float, m: float, w_max: float) -> float:
    """How far a push within w_max can bring a cart under PD control."""
    rate2 = kp / m - (kd / (2 * m)) ** 2
    if rate2 <= 0:
        return w_max / kp  # the impulse response does not change its sign
    return float(w_max / kp / np.tanh(kd / (2 * m) * np.pi / np.sqrt(rate2) / 2))


def _measures(p: Parameters, kp: float, kd: float) -> np.ndarray:
    """Spread under gusts, the farthest under pushes, and the tremble of the force."""
    spread = np.sqrt(p.q / (2 * kd * kp))
    tremble = np.hypot(kp * p.sp, kd * p.sv)
    return np.array([spread, peak(kp, kd, p.m, p.w_max), tremble])


def _specification(rng: np.random.Generator) -> dict[str, float]:
    p = {
        "m": round(float(rng.uniform(2.5, 6.0)), 1),
        "q": round(float(rng.uniform(0.3, 0.9)), 2),
        "w_max": round(float(rng.uniform(1.0, 3.0)), 1),
        "sp": 0.02,
        "sv": 0.05,
    }
    rate = float(rng.uniform(2.0, 4.0))
    found = _measures(Parameters(**p), p["m"] * rate**2, 1.6 * p["m"] * rate)
    names = ("spread", "farthest", "tremble")
    return {**p, **{name: float(f"{1.15 * v:.3g}") for name, v in zip(names, found, strict=True)}}


def _best_gains(p: Parameters) -> np.ndarray:
    """Scan rates and damping ratios for the largest margin."""
    limits = np.array([p.spread, p.farthest, p.tremble])
    tried = [
        (p.m * rate**2, 2 * ratio * p.m * rate)
        for rate in np.linspace(1.5, 5.0, 71)
        for ratio in (0.6, 0.7, 0.8, 0.9)
    ]
    return np.array(min(tried, key=lambda gains: np.max(_measures(p, *gains) / limits)))


def _soft_gains(p: Parameters) -> np.ndarray:
    """Gains that the gusts allow, but too soft for a steady push."""
    kp = 0.98 * p.w_max / p.farthest
    return np.array([kp, 1.02 * p.q / (2 * kp * p.spread**2)])


def _judge_gains(answer: Any, p: Parameters) -> str:
    kp, kd = map(float, answer)
    if kp <= 0 or kd <= 0:
        return "both gains must be positive, or the cart runs away"
    spread, farthest, tremble = _measures(p, kp, kd)
    if beyond(tremble, p.tremble):
        return (
            "the sensor's noise makes the force tremble too much:"
            f" {tremble:.3g} N rms, and {p.tremble:g} N are allowed; lower the gains"
        )
    if beyond(spread, p.spread):
        return (
            f"the gusts spread it too far: {spread:.3g} m rms, and {p.spread:g} m are allowed;"
            " the variance is q / (2 kd kp)"
        )
    if beyond(farthest, p.farthest):
        return (
            f"the worst push brings it too far: {farthest:.3g} m, and {p.farthest:g} m are allowed;"
            " stiffness, or damping against resonance, is missing"
        )
    return ""


def _swinging(rng: np.random.Generator) -> dict[str, float]:
    m, rate = round(float(rng.uniform(1.5, 4.0)), 1), float(rng.uniform(2.0, 3.5))
    return {
        "m": m,
        "kp": round(m * rate**2, 1),
        "kd": round(2 * float(rng.uniform(0.12, 0.25)) * m * rate, 2),
        "w_max": round(float(rng.uniform(0.5, 1.5)), 2),
    }


def _judge_push(answer: Any, p: Parameters) -> str:
    h, x, farthest = 0.04, np.zeros(2), 0.0
    for k in range(400):
        w = one_number(answer(x.copy(), k * h))
        if np.isnan(w):
            return NOT_A_NUMBER
        if abs(w) > p.w_max * (1 + 1e-9):
            return f"your push is too strong: {abs(w):.3g} N, and w_max is {p.w_max:g} N"
        for _ in range(4):  # semi-implicit steps of 10 ms, good to a percent
            x[1] += h / 4 * (w - p.kp * x[0] - p.kd * x[1]) / p.m
            x[0] += h / 4 * x[1]
        farthest = max(farthest, abs(x[0]))
    share = farthest / peak(p.kp, p.kd, p.m, p.w_max)
    if share < 0.95:
        return (
            "not far enough: which sign of w adds energy? The power is w v."
            f" The cart comes to {share:.2f} of the bound, 0.95 is asked for"
        )
    return ""


EXERCISES = (
    Exercise(
        "12.1",
        "Where averaging stops to pay",
        "read off",
        5,
        _sensor,
        lambda p: (p.sigma / p.b) ** 2,
        (
            Slip(
                "the noise of an average falls with the root of n",
                lambda p: p.sigma / p.b,
            ),
            Slip("turned over: more noise needs more readings", lambda p: (p.b / p.sigma) ** 2),
            Slip("compare like with like: both squared", lambda p: p.sigma**2 / p.b),
            Slip("where is the bias?", lambda p: p.sigma**2),
        ),
        rtol=0.02,
    ),
    Exercise(
        "12.2",
        "Adrift",
        "compute",
        10,
        _free,
        lambda p: _drift_time(p, p.m**2, p.d**2),
        (
            Slip("that is when the velocity's variance is d^2", lambda p: p.m**2 * p.d**2 / p.q),
            Slip(
                "a force is divided by the mass: m^2 in the variance",
                lambda p: _drift_time(p, 1.0, p.d**2),
            ),
            Slip(
                "the mass counts squared in a variance",
                lambda p: _drift_time(p, p.m, p.d**2),
            ),
            Slip(
                "a variance is compared with d^2, not with d",
                lambda p: _drift_time(p, p.m**2, p.d),
            ),
            Slip(
                "the integral of (t - s)^2 is t^3 / 3",
                lambda p: _drift_time(p, p.m**2, p.d**2, 1.0),
            ),
        ),
        rtol=5e-3,
    ),
    Exercise(
        "12.3",
        "At rest under gusts",
        "derive",
        15,
        _free,
        _right_variances,
        (
            Slip(
                "those are variances: the answer is standard deviations",
                lambda p: lambda kp, kd: np.array([p.q / (2 * kd * kp), p.q / (2 * kd * p.m)]),
            ),
            Slip(
                "A P + P A' has every product twice: a 2 is missing",
                lambda p: _variances(
                    p, lambda kp, kd: p.q / (kd * kp), lambda kp, kd: p.q / (kd * p.m)
                ),
            ),
            Slip(
                "the mass cancels from the position: compare m v^2 with kp p^2",
                lambda p: _variances(
                    p, lambda kp, kd: p.q / (2 * kd * kp * p.m), lambda kp, kd: p.q / (2 * kd * p.m)
                ),
            ),
            Slip(
                "stiffness does not enter the velocity: only damping takes energy away",
                lambda p: _variances(
                    p, lambda kp, kd: p.q / (2 * kd * kp), lambda kp, kd: p.q / (2 * kp * p.m)
                ),
            ),
            Slip(
                "the position comes first, then the velocity",
                lambda p: lambda kp, kd: _right_variances(p)(kp, kd)[::-1],
            ),
            Slip(
                "w enters as w / m: G is (0, 1/m)",
                lambda p: lambda kp, kd: p.m * _right_variances(p)(kp, kd),
            ),
        ),
        points=2,
        inputs=_gains_drawn,
    ),
    Exercise(
        "12.4",
        "A finer clock calms the gusts",
        "debug",
        10,
        _free,
        lambda p: lambda z, h: np.sqrt(p.q / h) * z,
        (
            Slip(
                "the variance is still the same for every step: the spread depends on the clock",
                lambda p: lambda z, h: np.sqrt(p.q) * z,
            ),
            Slip(
                "the integral over h has the variance h^2 var w, and that must be q h",
                lambda p: lambda z, h: np.sqrt(p.q * h) * z,
            ),
            Slip(
                "q / h is the variance: the force is its root times z",
                lambda p: lambda z, h: p.q / h * z,
            ),
            Slip(
                "h belongs under the root: the variance goes as 1/h",
                lambda p: lambda z, h: np.sqrt(p.q) / h * z,
            ),
        ),
        points=2,
        inputs=_draws,
    ),
    Exercise(
        "12.5",
        "Gusts, pushes and a noisy sensor",
        "design",
        20,
        _specification,
        _best_gains,
        (
            Slip("makes the force tremble too much", lambda p: 3 * _best_gains(p)),
            Slip("the gusts spread it too far", lambda p: _best_gains(p) / 2),
            Slip("both gains must be positive", lambda p: [1.0, -1.0] * _best_gains(p)),
            Slip("the worst push brings it too far", lambda p: _soft_gains(p)),
        ),
        points=3,
        judge=_judge_gains,
    ),
    Exercise(
        "12.6",
        "Be the worst case",
        "play",
        20,
        _swinging,
        lambda p: lambda x, t: p.w_max if x[1] >= 0 else -p.w_max,
        (
            Slip("which sign of w adds energy", lambda p: lambda x, t: p.w_max),
            Slip(
                "not far enough",
                lambda p: lambda x, t: -p.w_max if x[1] >= 0 else p.w_max,
            ),
            Slip("not far enough", lambda p: lambda x, t: p.w_max if x[0] >= 0 else -p.w_max),
            Slip("your push is too strong", lambda p: lambda x, t: 2 * p.w_max),
            Slip(NOT_A_NUMBER, lambda p: lambda x, t: [p.w_max, np.nan]),
        ),
        points=3,
        judge=_judge_push,
    ),
)
