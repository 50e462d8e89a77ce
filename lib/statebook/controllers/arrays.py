"""What feedback laws do to arrays."""

from __future__ import annotations

import numpy as np


def saturate(u: np.ndarray, limit: float | None) -> np.ndarray:
    """Clip a control to plus and minus a limit, if there is one."""
    return u if limit is None else np.clip(u, -limit, limit)


def columns(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return a vector so that it broadcasts against a state or a batch of states."""
    return values if like.ndim == 1 else values[:, None]
