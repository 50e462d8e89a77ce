"""Increasing times: checks, and which interval a time falls into."""

from typing import Any

import numpy as np

from statebook import _validate

_ROUNDING = 4 * np.finfo(float).eps


class ReadOnly:
    """What holds arrays that nobody changes; out of a pickle too."""

    def _keep(self, **values: Any) -> None:
        for value in values.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        vars(self).update(values)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._keep(**state)


def increasing(name: str, times: Any, minimum: int) -> np.ndarray:
    """Check times: finite, increasing, at least so many; return a copy."""
    times = _validate.real_array(name, times, (None,)).copy()
    if len(times) < minimum:
        raise ValueError(f"{name} must hold at least {minimum} times, got {len(times)}")
    if np.any(np.diff(times) <= 0):
        k = int(np.argmax(np.diff(times) <= 0))
        raise ValueError(f"{name} must increase, got {times[k]:g} before {times[k + 1]:g}")
    return times


def within(name: str, t: Any, times: np.ndarray) -> np.ndarray:
    """Check that each t is inside the times, to rounding; return it moved inside."""
    t = _validate.real_array(name, t)
    slack = 1e-12 * max(np.abs(times[[0, -1]]).max(), times[-1] - times[0])
    outside = (t < times[0] - slack) | (t > times[-1] + slack)
    if np.any(outside):
        raise ValueError(
            f"{name} must be within [{times[0]:g}, {times[-1]:g}], got {t[outside].flat[0]:g}"
        )
    return np.clip(t, times[0], times[-1])


def interval_of(t: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Index k with times[k] <= t < times[k + 1], the last interval at the last time.

    A t below a time by rounding alone is that time: 11 * 0.03 is 0.33.
    """
    reached = np.searchsorted(times, t + _ROUNDING * np.abs(t), side="right")
    return np.clip(reached - 1, 0, max(len(times) - 2, 0))


def tick(start: float, dt: float, k: int) -> float:
    """The time start + k dt, free of rounding where it is a number of few digits."""
    t = float(start + k * dt)
    short = float(f"{t:.12g}")
    return short if abs(short - t) <= _ROUNDING * max(abs(t), abs(start)) else t


def whole_samples(
    name: str, spans: Any, dt: float | bool | None, got: str, rounding: float = 1e-9
) -> Any:
    """Return spans of time as whole samples; single precision is told by its rounding."""
    dt = float(dt or 1)
    counts = np.round(np.divide(spans, dt))
    allowed = np.minimum(rounding * np.maximum(dt, np.abs(spans)), 0.01 * dt)
    if np.any(np.abs(spans - counts * dt) > allowed):
        raise ValueError(f"{name} must be whole samples of dt = {dt:g}{got}")
    return counts
