"""What judges read of a student's answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

NOT_A_NUMBER = "your function must return one finite number"


def one_number(value: Any) -> float:
    """Return a value as a number; NaN where it is not one finite number."""
    array = np.asarray(value, dtype=float)
    return float(array.item()) if array.size == 1 and np.isfinite(array).all() else np.nan


def beyond(value: float, limit: float) -> bool:
    """Tell whether a value is past a limit: by more than the digits that students type."""
    return bool(value > limit + 1e-3 * abs(limit))


class Watched:
    """A student's policy under limits, with what it asked for.

    Parameters
    ----------
    answer : callable
        answer(x, t), one number for each limit.
    limits : sequence of float
        Largest magnitudes; what goes beyond is clipped.

    Attributes
    ----------
    asked : array
        Largest magnitudes so far, before clipping.
    """

    def __init__(self, answer: Callable[..., Any], limits: Sequence[float]) -> None:
        self._answer = answer
        self.limits = np.array(limits, dtype=float)
        self.asked = np.zeros(len(self.limits))

    def __call__(self, x: np.ndarray, t: float) -> np.ndarray:
        u = np.ravel(np.asarray(self._answer(x, t), dtype=float))
        if u.shape != self.limits.shape or not np.isfinite(u).all():
            many = len(self.limits)
            count = "one finite number" if many == 1 else f"{many} finite numbers"
            raise ValueError(f"your policy must return {count}, got {u} at t = {t:.4g} s")
        self.asked = np.maximum(self.asked, np.abs(u))
        return np.clip(u, -self.limits, self.limits)

    def excess(self, unit: str) -> str:
        """Return which limit the policy asked to exceed, or nothing."""
        over = np.flatnonzero(self.asked > self.limits * (1 + 1e-9))
        if not over.size:
            return ""
        i = int(over[0])
        return f"it asks for {self.asked[i]:.3g} {unit}, the limit is {self.limits[i]:.3g} {unit}"
