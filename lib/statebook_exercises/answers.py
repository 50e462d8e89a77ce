"""What judges read of a student's answer."""

from __future__ import annotations

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
