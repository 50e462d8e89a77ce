"""Derivatives that are exact to rounding, or known not to be.

The complex step d f / d z_j = Im f(z + i h e_j) / h has no cancellation, but fails in
silence where f is not analytic: it halves the derivative of ``x |x|`` and finds zero for a
table look-up. So every column is compared with central differences over a range of
steps, which have an error estimate of their own, and is taken from adaptive differences
where the two disagree.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import scipy

from statebook.errors import KinkError

_STEPS = 10.0 ** -np.arange(1, 10)  # relative to abs(z_j), or absolute at 0
_COMPLEX_STEP = 1e-40
_EPS = float(np.finfo(float).eps)

Evaluate = Callable[[np.ndarray], np.ndarray]


class InexactDerivativeWarning(UserWarning):
    """A derivative had to be taken by differences; the message gives its error."""


def step_scale(z: np.ndarray) -> np.ndarray:
    """Return the size of a variation of z: its own size, and 1 where it is zero."""
    size = np.abs(z)
    return np.where(size > 1e-14, size, 1.0)


def derivative(f: Evaluate, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate f at each column of z.

    Parameters
    ----------
    f : callable
        Maps (k, N) to (n, N), column by column, and returns NaN where it is undefined.
    z : array, shape (k, N)

    Returns
    -------
    J : array, shape (N, n, k)
    error : array, shape (N, n, k)
        Estimated absolute error; 0 where the complex step is exact to rounding.

    Raises
    ------
    KinkError
        f has no derivative at one of the points.

    References
    ----------
    W. Squire and G. Trapp, SIAM Review 40 (1998), 110-112 (complex step).

    Examples
    --------
    >>> derivative(np.sin, np.array([[0.0]]))[0]
    array([[[1.]]])
    """
    f0 = f(z)
    columns = [_column(f, z, f0, j) for j in range(z.shape[0])]
    if not columns:
        empty = np.zeros((z.shape[1], f0.shape[0], 0))
        return empty, empty
    J, error = (np.stack(part, axis=-1).swapaxes(0, 1) for part in zip(*columns, strict=True))
    return J, error


def _column(f: Evaluate, z: np.ndarray, f0: np.ndarray, j: int) -> tuple[np.ndarray, np.ndarray]:
    """Return d f / d z_j and its error estimate, each (n, N)."""
    value, error, step, rate = _differences(f, z, f0, j)
    exact = _complex_step(f, z, j)
    if exact is not None:  # what the step leaves of a zero derivative, as of x^3 at 0, is zero
        exact = np.where(np.abs(exact) < _COMPLEX_STEP**0.5 * rate, 0.0, exact)
    if exact is not None and (np.abs(exact - value) <= 10 * error + 1e-8 * np.abs(exact)).all():
        return exact, np.zeros_like(exact)
    # A large first step is the more accurate one unless a kink lies within it.
    for first_step in (np.broadcast_to(step_scale(z[j]) / 4, step.shape), 4 * step):
        refined, refined_error = _adaptive(f, z, j, first_step)
        better = refined_error < error
        value, error = np.where(better, refined, value), np.where(better, refined_error, error)
    if (error > 1e-4 * rate).any():
        raise KinkError(
            f"no derivative could be determined with respect to component {j} of (x, u):"
            f" the differences do not settle (error estimate {error.max():.1g});"
            " move the point away from the discontinuity"
        )
    value = np.where(np.abs(value) <= error, 0.0, value)  # nothing tells it from zero
    return value, np.maximum(error, _EPS * np.abs(value))


def _complex_step(f: Evaluate, z: np.ndarray, j: int) -> np.ndarray | None:
    """Return the complex-step derivative (n, N), or None where f is real-only."""
    h = _COMPLEX_STEP * step_scale(z[j])
    shifted = z.astype(complex)
    shifted[j] += 1j * h
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        try:
            result = f(shifted)
        except (TypeError, np.exceptions.ComplexWarning):
            return None
    return result.imag / h if np.iscomplexobj(result) else None


def _differences(
    f: Evaluate, z: np.ndarray, f0: np.ndarray, j: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the best central differences (n, N), errors and steps, and f over z_j in size."""
    K, N = _STEPS.size, z.shape[1]
    h = _STEPS[:, None] * step_scale(z[j])
    shifts = np.zeros((z.shape[0], 2, K, N))
    shifts[j, 0], shifts[j, 1] = h, -h
    values = f((z[:, None, None] + shifts).reshape(z.shape[0], -1)).reshape(-1, 2, K, N)
    up, down = values[:, 0], values[:, 1]
    with np.errstate(invalid="ignore"):
        size = np.nanmax(np.abs(values), axis=(1, 2))[:, None]
        central = (up - down) / (2 * h)
        noise = 4 * _EPS * (size + np.abs(central * z[j])) / h
        _refuse_kink(np.abs(up - 2 * f0[:, None] + down) / h, np.abs(central), noise, j)
        # Neighbouring steps differ by the truncation error of the larger one.
        error = np.abs(np.diff(central, axis=1)) + noise[:, 1:]
    error = np.where(np.isnan(error), np.inf, error)
    best = np.argmin(error, axis=1)[:, None]
    if np.isinf(np.take_along_axis(error, best, axis=1)).any():
        raise KinkError(
            f"no derivative with respect to component {j} of (x, u): the function is undefined"
            " on at least one side of the point"
        )
    value, estimate = (np.take_along_axis(a, best, axis=1)[:, 0] for a in (central[:, 1:], error))
    rate = np.maximum(np.abs(value), size[:, 0] / step_scale(z[j]))
    return value, estimate, h[1:][best[:, 0], np.arange(N)], rate


def _refuse_kink(jump: np.ndarray, slope: np.ndarray, noise: np.ndarray, j: int) -> None:
    """Raise where the one-sided derivatives differ by an amount that does not shrink with h.

    All are (n, K, N), over steps that fall by a factor of ten. The difference of the
    one-sided slopes falls like h where f is smooth and stays where it has a kink.
    """
    smaller, larger = jump[:, 1:], jump[:, :-1]
    significant = smaller > np.maximum(1e3 * noise, 1e-7 * slope)[:, 1:]
    kink = (smaller > 0.7 * larger) & significant
    # A kink near the point shows at large steps only; one at the point shows at small ones.
    lasting = kink[:, 2:5].all(axis=1)
    if lasting.any():
        raise KinkError(
            f"no derivative with respect to component {j} of (x, u): the slopes on both sides"
            f" differ by {jump[:, 4][lasting].max():.3g}; move the point away from the kink"
        )


def _adaptive(
    f: Evaluate, z: np.ndarray, j: int, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return adaptive differences (n, N) and their error estimates, point by point."""
    value, error = np.empty(step.shape), np.empty(step.shape)
    for i, k in np.ndindex(*step.shape):

        def component(t: np.ndarray, i: int = i, k: int = k) -> np.ndarray:
            points = np.repeat(z[:, k : k + 1], t.size, axis=1)
            points[j] = np.ravel(t)
            return f(points)[i].reshape(t.shape)

        result = scipy.differentiate.derivative(
            component, z[j, k], initial_step=4 * step[i, k], order=4
        )
        found = np.isfinite(result.df) and np.isfinite(result.error)
        value[i, k], error[i, k] = (result.df, result.error) if found else (0.0, np.inf)
    return value, error
