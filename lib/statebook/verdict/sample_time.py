"""How slowly a state feedback may be sampled."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.verdict.blocks import EPS, rounding
from statebook.verdict.judgement import ASYMPTOTICALLY_STABLE, judge
from statebook.verdict.linear_part import as_matrix, continuous_part

# Degree of the interpolants, and how many of their last coefficients tell that they suffice.
_DEGREE = 32
_TAIL = 4
_RESOLVED = 1e-11
# The decay exp(-40) after which a mode of the plant is dead.
_DEAD = 40.0
_MAX_PIECES = 100_000
# Roots this near the real axis, in half lengths of a piece, may be real ones, nearly double.
_NEARLY_REAL = 1e-3
# A spectral radius this near 1 at its peak touches the circle.
_TOUCH = 1e-11
# Modes this near, relatively, alias.
_SAME = 1e-9

Loop = Callable[[np.ndarray], np.ndarray]


def critical_sample_time(
    system_or_A: Any,
    B: Any = None,
    K: Any = None,
    x0: Any = None,
    u0: Any = None,
    *,
    t: float | None = None,
) -> float:
    """Largest sample time below which sampled feedback is stable.

    The supremum of h such that for every sample time in (0, h) the plant x' = A x + B u under
    u = -K x_k, held between samples, is asymptotically stable: all eigenvalues of
    ``M(h) = Ad(h) - Bd(h) K`` inside the unit circle, Ad and Bd by "zoh".

    Parameters
    ----------
    system_or_A : array of shape (n, n), control.StateSpace, or any system of `as_system`
        The plant's matrix, a linear system, or a nonlinear one with its equilibrium x0.
    B : array, shape (n, m)
        Beside a matrix; a system has its own.
    K : array, shape (m, n)
        Gain of the state feedback.
    x0, u0 : array, shape (n,) and (m,), optional
        Equilibrium of a nonlinear system; u0 = None means zeros.
    t : float, optional [s]
        The time at which a system that depends on it is frozen; required for one.

    Returns
    -------
    float
        The critical sample time [s]: 0 if A - B K is not asymptotically stable (so that fast
        sampling does not help), inf if every sample time will do.

    Raises
    ------
    NotAnEquilibriumError
        If x0 is no equilibrium.
    TypeError, ValueError
        If a shape is wrong, an entry is not finite, B or K is missing, or the system is in
        discrete time.
    RuntimeError
        If the search did not come to an end.

    Notes
    -----
    ``F(h) = det(I - M(h) (x) M(h))`` over symmetric tensors, the product of ``1 - z_i z_j``
    over all pairs of eigenvalues of M(h), i = j among them, is an entire function that
    vanishes where a real or a complex eigenvalue reaches the circle. Its zeros are found
    piece by piece, as those of Chebyshev interpolants of degree 32. A piece is as long as the
    frequencies in F allow the interpolant to be exact to rounding: so a window of growth is
    found however narrow it is. A stable plant is followed until exp(h A) has died out and M no
    longer changes; any other is followed until the loop is unstable.

    References
    ----------
    Astrom and Wittenmark, *Computer-Controlled Systems*, section 3.2; Saydy, Tits and Abed,
    Mathematics of Control, Signals and Systems 3 (1990) 345 (guardian maps); Boyd, SIAM J.
    Numer. Anal. 40 (2002) 1666 (zeros of Chebyshev interpolants).

    Examples
    --------
    >>> round(critical_sample_time([[0.0]], [[1.0]], [[4.0]]), 12)
    0.5
    >>> round(critical_sample_time([[0, 1], [-100, -0.2]], [[0], [1]], [[0, 0.5]]), 9)
    0.305222101
    """
    part = continuous_part(system_or_A, x0, u0, t)
    A = part.A
    if part.B is None and B is None:
        raise ValueError("B is required beside a matrix: it says how u acts on x'")
    if part.B is not None and B is not None:
        raise ValueError("B belongs to a matrix; a system has its own: write K=...")
    B = _validate.array("B", as_matrix(B), (len(A), None)) if part.B is None else part.B
    if K is None:
        raise ValueError("K is required: the gain of u = -K x")
    K = _validate.array("K", as_matrix(K), (B.shape[1], len(A)))
    closed = A - B @ K
    if judge(closed, discrete=False).verdict != ASYMPTOTICALLY_STABLE:
        return 0.0
    if len(A) == 0:
        return float("inf")
    return _first_crossing(A, B, K, float(np.abs(np.linalg.eigvals(closed)).max()))


def _first_crossing(A: np.ndarray, B: np.ndarray, K: np.ndarray, rate: float) -> float:
    n, m = B.shape
    plant = np.linalg.eigvals(A)
    generator = np.block([[A, B], [np.zeros((m, n + m))]])
    # Chebyshev points of the first kind on [0, 1], ascending.
    nodes = (1 - np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))) / 2
    length = 1 / max(rate, float(np.abs(plant).max()))
    is_real = np.isrealobj(A) and np.isrealobj(B) and np.isrealobj(K)

    @lru_cache(maxsize=8)
    def steps(length: float) -> np.ndarray:
        return scipy.linalg.expm(generator * (length * nodes)[:, None, None])

    def loop(E: np.ndarray) -> np.ndarray:
        return E[..., :n, :n] - E[..., :n, n:] @ K

    def excess(h: float) -> float:
        M = loop(scipy.linalg.expm(generator * h))
        return float(np.abs(np.linalg.eigvals(M)).max() - 1)

    start = 0.0
    for _ in range(_MAX_PIECES):
        # Invariant: no eigenvalue has reached the circle up to start.
        alive = plant[-plant.real * start < _DEAD]
        if len(alive) == 0:
            return float("inf")
        length = min(length, _DEGREE / 2 / max(float(np.abs(alive.imag).max()), 1e-300))
        with np.errstate(all="ignore"):
            E = scipy.linalg.expm(generator * start) @ steps(length)
            digits = rounding(1 + np.abs(E).max() * (1 + m * np.abs(K).max(initial=0.0)), n)
            values, noise = _product(loop(E), rate * (start + length * nodes), is_real, digits)
        # Chebyshev coefficients; the points are ascending.
        coefficients = scipy.fft.dct(values[::-1], type=2) / len(values)
        coefficients[0] /= 2
        size = np.abs(coefficients)
        if not size[-_TAIL:].max() <= max(_RESOLVED * size.max(), noise):
            length /= 2
            if start + length == start:
                break
            continue
        for position, width in _candidates(coefficients):
            crossing = _examined(excess, start, length, position, width)
            if crossing is not None:
                return _at_alias(plant, crossing)
        end = start + length
        if excess(end) >= 0:
            return float(scipy.optimize.brentq(excess, start, end, xtol=1e-300, rtol=1e-14))
        start = end
        if size[_DEGREE // 2 :].max() <= max(_RESOLVED * size.max(), noise):
            length *= 2
    raise RuntimeError(
        f"no sample time up to {start:.3g} s was unstable, and the plant's modes have not died"
        " out; examine the eigenvalues of discretize_many(A, B, dt) yourself"
    )


def _product(
    M: np.ndarray, time: np.ndarray, is_real: bool, digits: float
) -> tuple[np.ndarray, float]:
    """Product of 1 - z_i z_j over all pairs, each divided by 1 - exp(-time), and its rounding.

    The division keeps it from vanishing at 0, where all eigenvalues are 1. Complex matrices
    have the pairs of z_i and conj(z_j) instead.
    """
    if not np.isfinite(M).all():
        return np.full(len(M), np.nan), 0.0
    z = np.linalg.eigvals(M)
    rows, columns = np.triu_indices(M.shape[-1])
    scale = -np.expm1(-time)[:, None]
    pairs = z[:, rows] * (z[:, columns] if is_real else z[:, columns].conj())
    factors = (1 - pairs) / scale
    if not is_real:
        factors = np.where(rows == columns, factors, np.abs(factors) ** 2)
    values = np.prod(factors, axis=1).real
    error = digits * (1 + np.abs(pairs)) / scale / np.maximum(np.abs(factors), EPS)
    return values, float(np.max(np.abs(values) * error.sum(axis=1)))


def _candidates(coefficients: np.ndarray) -> list[tuple[float, float]]:
    """Real roots, or nearly real ones, as positions in [0, 1] and their uncertainty."""
    size = np.abs(coefficients)
    kept = coefficients[: np.flatnonzero(size > 1e-3 * _RESOLVED * size.max())[-1] + 1]
    roots = np.polynomial.chebyshev.chebroots(kept).astype(complex)
    near = (np.abs(roots.imag) <= _NEARLY_REAL) & (np.abs(roots.real) <= 1 + _NEARLY_REAL)
    roots = roots[near][np.argsort(roots[near].real)]
    return [(float(z.real + 1) / 2, max(float(abs(z.imag)), 1e-6)) for z in roots]


def _examined(
    excess: Callable[[float], float], start: float, length: float, position: float, width: float
) -> float | None:
    """First sample time near a zero at which the circle is reached, or None."""
    low = max(start + length * (position - 2 * width), start)
    high = start + length * (position + 2 * width)
    peak = scipy.optimize.minimize_scalar(
        lambda h: -excess(h), bounds=(low, high), method="bounded", options={"xatol": 0.0}
    ).x
    peak = max((low, peak, high), key=excess)
    if excess(peak) < -_TOUCH:
        return None
    if excess(low) >= 0:
        low = start
    if excess(peak) <= 0 or low >= peak or excess(low) >= 0:
        return float(peak)
    return float(scipy.optimize.brentq(excess, low, peak, xtol=1e-300, rtol=1e-14))


def _at_alias(plant: np.ndarray, crossing: float) -> float:
    """A touching at which two modes of the plant that do not decay alias, to the last digit.

    There sampling loses controllability, and the circle is touched, maybe without a crossing.
    """
    scale = np.abs(plant).max(initial=0.0)
    lasting = plant[plant.real >= -_SAME * scale]
    difference = (lasting[:, None] - lasting)[np.triu_indices(len(lasting), 1)]
    frequency = np.abs(difference.imag)[np.abs(difference.real) <= _SAME * scale]
    periods = 2 * np.pi / frequency[frequency > _SAME * scale]
    times = periods * np.maximum(np.round(crossing / periods), 1)
    near = times[np.abs(times - crossing) <= 1e-7 * crossing]
    return float(near.min()) if len(near) else crossing
