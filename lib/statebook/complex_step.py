"""The complex step, unchecked, and the Jacobians that a search can do with."""

import warnings
from collections.abc import Callable

import numpy as np

COMPLEX_STEP = 1e-40  # relative to the scale of a variable
CHUNK = 1024  # points that a cache holds, and of arrays that cost no new pages
ALONE = 64  # points, up to which every column is checked alone

Evaluate = Callable[[np.ndarray], np.ndarray]


def step_scale(z: np.ndarray) -> np.ndarray:
    """Return the size of a variation of z: its own size, and 1 where it is zero."""
    size = np.abs(z)
    return np.where(size > 1e-14, size, 1.0)


def complex_step(
    f: Evaluate, z: np.ndarray, s: np.ndarray, columns: np.ndarray, step: float = COMPLEX_STEP
) -> np.ndarray | None:
    """Return Im f(z + i h e_j) / h, (n, c, N), unchecked; None where f is real-only."""
    k, N, c = *z.shape, len(columns)
    h = step * s[columns]
    # One call for all columns if they are few; large batches are faster in parts.
    width, length = (c, N) if N <= ALONE else (1, CHUNK)
    J: np.ndarray | None = None
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        for first in range(0, N, length):
            some = slice(first, first + length)
            shifted = np.repeat(z[:, None, some].astype(complex), width, axis=1)
            for a in range(0, c, width):
                chosen, part = columns[a : a + width], h[a : a + width, some]
                shifted.imag[chosen, np.arange(width)] = part
                try:
                    result = f(shifted.reshape(k, -1))
                except Exception:  # whatever f does with numbers it was not written for
                    return None
                if result.dtype != complex:  # real, or too short for the step
                    return None
                if J is None:
                    J = np.empty((len(result), c, N))
                change = result.imag.reshape(-1, width, part.shape[1])
                np.divide(change, part, out=J[:, a : a + width, some])
                shifted.imag[chosen] = 0.0
    return J


def search_jacobian(f: Evaluate, z: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return d f / d z at one point z (k,), fast and not verified; NaN where undefined.

    By complex step, if that agrees with differences along one direction, or by differences of
    steps of 1e-6 s.
    """
    with np.errstate(all="ignore"):
        direction = s * np.random.default_rng(z.size).uniform(0.5, 1.0, z.size)
        exact = complex_step(f, z[:, None], s[:, None], np.arange(z.size))
        if exact is not None:
            steps = np.array([2e-5, -2e-5, 1e-5, -1e-5])
            values = f(z[:, None] + direction[:, None] * steps).T.astype(float)
            J = exact[..., 0]
            slope = (values[::2] - values[1::2]) / (2 * steps[::2, None])
            found, size = (4 * slope[1] - slope[0]) / 3, np.abs(J) @ direction
            allowed = 1e-3 * size + 2 * np.abs(slope[1] - slope[0]) + 1e-9 * np.abs(values[0])
            if (np.abs(J @ direction - found) <= allowed).all():
                return J
        h = 1e-6 * np.diag(s)
        sides = f(z[:, None] + np.concatenate([h, -h], axis=1)).astype(float)
        return (sides[:, : z.size] - sides[:, z.size :]) / (2e-6 * s)
