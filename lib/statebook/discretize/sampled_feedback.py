"""How fast a sampled state feedback must be."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.discretize.methods import one_step, pair
from statebook.stability.judge import ASYMPTOTICALLY_STABLE, judge

# The scan of sampled feedback: steps per period of the fastest living mode, growth of the step,
# the decay after which a mode is dead, when to give up, and how many steps to take at once.
_PER_PERIOD = 40
_STEP_GROWTH = 0.05
_DEAD = 40.0
_MAX_SCAN = 100_000
_CHUNK = 64
# Modes this near, relatively, alias; a spectral radius this near 1 is 1 where they do.
_SAME = 1e-9
_TOUCH = 1e-7


def critical_sample_time(A: Any, B: Any, K: Any) -> float:
    """Largest sample time below which sampled feedback is stable.

    The supremum of h such that for every sample time in (0, h) the plant x' = A x + B u under
    u = -K x_k, held between samples, is asymptotically stable: all eigenvalues of
    ``Ad(h) - Bd(h) K`` inside the unit circle, Ad and Bd by "zoh".

    Parameters
    ----------
    A : array, shape (n, n)
    B : array, shape (n, m)
    K : array, shape (m, n)
        Gain of the state feedback.

    Returns
    -------
    float
        The critical sample time [s]: 0 if A - B K is not asymptotically stable (so that fast
        sampling does not help), inf if none was found.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong or an entry is not finite.
    RuntimeError
        If the scan did not come to an end.

    Notes
    -----
    The condition is transcendental, so this is a search: the spectral radius is scanned with
    steps of 5 % of h, and of 1/40 of the period of the fastest oscillation in A that has not
    died out, and its first crossing of 1 is bracketed and solved to rounding; the sample times
    at which two lasting modes alias are looked at by themselves. A window of instability
    narrower than a step can escape. A stable A is scanned until exp(h A) has died
    out and the loop no longer changes; any other plant is scanned until it is unstable.

    References
    ----------
    Astrom and Wittenmark, *Computer-Controlled Systems*, section 3.2.

    Examples
    --------
    >>> round(critical_sample_time([[0.0]], [[1.0]], [[4.0]]), 12)
    0.5
    """
    A, B = pair(A, B, stack=False)
    K = _validate.array("K", K, (B.shape[1], A.shape[0]))
    closed = A - B @ K
    if judge(closed, discrete=False).verdict != ASYMPTOTICALLY_STABLE:
        return 0.0
    if len(A) == 0:
        return float("inf")

    def growth(h: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            Ad, Bd, _, _ = one_step(A, B, h[:, None, None], "zoh")
            loop = Ad - Bd @ K
        overflow = ~np.isfinite(loop).all(axis=(1, 2))
        radius = np.abs(np.linalg.eigvals(np.where(overflow[:, None, None], 0, loop))).max(axis=1)
        return np.where(overflow, np.inf, radius - 1)

    low = 0.0
    points = _scan(np.linalg.eigvals(A), np.linalg.eigvals(closed))
    while chunk := list(itertools.islice(points, _CHUNK)):
        # Invariant: stable at low and, as far as the scan has seen, before.
        h, aliased = (np.array(column) for column in zip(*chunk, strict=True))
        excess = growth(h)
        touching = aliased & (np.abs(excess) <= _TOUCH)
        for time, touches, grows in zip(h, touching, excess >= 0, strict=True):
            if touches:
                return float(time)
            if grows:
                return float(
                    scipy.optimize.brentq(
                        lambda t: growth(np.array([t]))[0], low, time, xtol=1e-300, rtol=1e-14
                    )
                )
            low = time
    return float("inf")


def _scan(open_loop: np.ndarray, closed_loop: np.ndarray) -> Iterator[tuple[float, bool]]:
    """Sample times to look at, ascending, and whether two lasting modes alias there."""
    periods = _pathological_periods(open_loop)
    h = 1e-3 / max(np.abs(open_loop).max(), np.abs(closed_loop).max())
    for _ in range(_MAX_SCAN):
        alive = open_loop[-open_loop.real * h < _DEAD]
        if len(alive) == 0:
            return
        frequency = np.abs(alive.imag).max()
        step = _STEP_GROWTH * h
        if frequency > 0:
            step = min(step, 2 * np.pi / frequency / _PER_PERIOD)
        lost = periods * np.floor((h + step) / periods)
        yield from ((float(time), True) for time in np.sort(lost[lost > h]))
        h += step
        if h not in lost:
            yield h, False
    raise RuntimeError(
        f"no sample time up to {h:.3g} s was unstable, and the plant's modes have not died out;"
        " examine the eigenvalues of discretize_many(A, B, dt) yourself"
    )


def _pathological_periods(eigenvalues: np.ndarray) -> np.ndarray:
    """Sample times whose multiples alias two modes of A that do not decay.

    There sampling loses controllability: the spectral radius touches 1, maybe without crossing.
    """
    scale = np.abs(eigenvalues).max(initial=0.0)
    lasting = eigenvalues[eigenvalues.real >= -_SAME * scale]
    difference = (lasting[:, None] - lasting)[np.triu_indices(len(lasting), 1)]
    frequency = np.abs(difference.imag)[np.abs(difference.real) <= _SAME * scale]
    return 2 * np.pi / np.unique(frequency[frequency > _SAME * scale])
