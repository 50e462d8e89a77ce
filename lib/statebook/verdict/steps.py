"""How large a step of a method may be."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from statebook.runge_kutta import (
    SEMI_IMPLICIT_EULER,
    ButcherTableau,
    amplification_matrix,
    as_tableau,
)
from statebook.verdict.blocks import EPS
from statebook.verdict.judgement import UNSTABLE, judge
from statebook.verdict.linear_part import continuous_part

# Polynomial coefficients below this share of their terms are rounding of a zero.
_CANCELLED = 64 * EPS
# Roots nearer than this, relatively, are one multiple root.
_SAME_ROOT = 1e-6
# The search for complex pairs that cross the unit circle: steps times norm(A), and how many.
_SCAN_RANGE = (1e-4, 1e4)
_SCAN_POINTS = 2000
_GROWTH = 1e-10


def critical_step(
    system_or_A: Any,
    method: str | ButcherTableau,
    x0: Any = None,
    u0: Any = None,
    *,
    t: float | None = None,
) -> float:
    """Largest step below which a method keeps solutions bounded.

    The supremum of h such that with every step in (0, h) all numerical solutions of x' = A x
    are bounded: ``abs(R(h lambda)) <= 1`` for each eigenvalue lambda of A, and no Jordan block
    on the unit circle. Found from the roots of the polynomial
    ``abs(N(h lambda))^2 - abs(D(h lambda))^2`` in h, where R = N / D.

    Parameters
    ----------
    system_or_A : array of shape (n, n), control.StateSpace, or any system of `as_system`
        Real or complex matrix [1/s], a linear system, or a nonlinear one with its equilibrium
        x0, whose Jacobian is taken.
    method : str or ButcherTableau
        A name in `METHODS`, a tableau, or "semi_implicit_euler" (n even; the first half of the
        state are positions).
    x0, u0 : array, shape (n,) and (m,), optional
        Equilibrium of a nonlinear system; u0 = None means zeros.
    t : float, optional [s]
        The time at which a system that depends on it is frozen; required for one.

    Returns
    -------
    float
        The critical step [s]: 0 if steps however small let a solution grow (an unstable A
        among them), inf if no step does. It is a supremum: the step itself may be unstable.

    Raises
    ------
    NotAnEquilibriumError
        If x0 is no equilibrium.
    TypeError, ValueError
        If A is not a square matrix of finite numbers, the system is in discrete time, the
        method is unknown, or n is odd for "semi_implicit_euler".

    Notes
    -----
    For "semi_implicit_euler" the one-step matrix is ``I + h A + h^2 P A (I - P) A`` with P the
    projector on positions. The steps at which it has the eigenvalue 1 or -1 are eigenvalues of
    matrix pencils and as accurate; a complex pair that leaves the circle is looked for on a
    grid of 2000 steps from 1e-4 to 1e4 over the norm of A and then bracketed, so that an
    interval of growth narrower than the grid can escape.

    References
    ----------
    Hairer and Wanner, *Solving Ordinary Differential Equations II*, section IV.2; Hairer,
    Lubich and Wanner, *Geometric Numerical Integration*, section I.5.2.

    Examples
    --------
    >>> round(critical_step([[0.0, 1.0], [-10.0, -1.0]], "euler"), 12)
    0.1
    >>> critical_step([[0.0, 1.0], [-1.0, 0.0]], "euler")
    0.0
    >>> critical_step([[0.0, 1.0], [-1.0, 0.0]], "implicit_midpoint")
    inf
    """
    A = continuous_part(system_or_A, x0, u0, t).A
    tableau = None if method == SEMI_IMPLICIT_EULER else as_tableau(method)
    if tableau is None and len(A) % 2:
        raise ValueError(
            f"{SEMI_IMPLICIT_EULER} needs as many positions as velocities, got n = {len(A)}"
        )
    judgement = judge(A, discrete=False, check_distance=False)
    if judgement.verdict == UNSTABLE:
        # A consistent method follows a growing solution if its steps are small.
        return 0.0
    if len(A) == 0 or not np.any(judgement.eigenvalues):
        return float("inf")
    if tableau is None:
        return _of_partitioned(A, float(np.abs(judgement.eigenvalues).max()))
    found = [_of_eigenvalue(value, tableau) for value in judgement.eigenvalues.tolist() if value]
    limit = min(limit for limit, _ in found)
    touched = {h for _, touches in found for h in touches if h < limit}
    unbounded = [h for h in touched if _grows(amplification_matrix(A, h, tableau))]
    return float(min([limit, *unbounded]))


def _of_eigenvalue(value: complex, tableau: ButcherTableau) -> tuple[float, list[float]]:
    """Critical step of one eigenvalue, and all steps at which abs(R) is 1."""
    size = abs(value)
    length = 2 * max(len(tableau.numerator), len(tableau.denominator)) - 1
    # In r = h abs(value): r^j direction^j, by products that are exact for 1, -1, 1j and -1j.
    powers = np.cumprod([1.0, *[value / size] * length])
    excess, terms = np.zeros(length), np.zeros(length)
    for parts, sign in ((tableau.numerator, 1), (tableau.denominator, -1)):
        along = np.asarray(parts, dtype=float) * powers[: len(parts)]
        square_of = np.convolve(along, along.conj()).real
        excess[: len(square_of)] += sign * square_of
        terms[: len(square_of)] += np.convolve(np.abs(along), np.abs(along))
    excess[np.abs(excess) <= _CANCELLED * terms] = 0
    if not excess.any():
        return float("inf"), []
    polynomial = np.polynomial.Polynomial(np.trim_zeros(excess))
    roots = _positive_roots(polynomial)
    ends = pairwise([0.0, *roots, 3 * max([1.0, *roots])])
    limits = (root for root, after in ends if polynomial((root + after) / 2) > 0)
    return next(limits, np.inf) / size, [root / size for root in roots]


def _positive_roots(polynomial: np.polynomial.Polynomial) -> list[float]:
    """Distinct positive real roots of a polynomial, ascending, refined by Newton's method."""
    found = polynomial.roots().astype(complex)
    real = found.real[(found.real > 0) & (np.abs(found.imag) <= _SAME_ROOT * found.real)]
    real.sort()
    apart = 1 + np.flatnonzero(np.diff(real) > _SAME_ROOT * real[1:])
    roots = []
    for group in np.split(real, apart) if real.size else []:
        # A root of multiplicity k is blurred, but it is a simple root of derivative k - 1.
        simple = polynomial.deriv(len(group) - 1)
        slope = simple.deriv()
        r = float(np.mean(group))
        for _ in range(3):
            step = float(simple(r) / slope(r)) if slope(r) else np.inf
            if abs(step) <= _SAME_ROOT * r:
                r -= step
        roots.append(r)
    return roots


def _grows(M: np.ndarray) -> bool:
    """Whether a computed matrix grows beyond doubt: a coupling of 1e-17 in it is rounding."""
    judgement = judge(M, discrete=True, check_distance=False)
    return judgement.verdict == UNSTABLE and not judgement.doubt


def _of_partitioned(A: np.ndarray, rate: float) -> float:
    n = len(A)
    A = scipy.linalg.matrix_balance(A, permute=False)[0] / rate
    positions = np.arange(n) < n // 2
    twice = (positions[:, None] * A) @ (~positions[:, None] * A)

    def one_step(h: np.ndarray) -> np.ndarray:
        return np.eye(n) + h[:, None, None] * A + h[:, None, None] ** 2 * twice

    def growth(h: float) -> float:
        return float(np.abs(np.linalg.eigvals(one_step(np.array([h])))).max()) - 1

    # Eigenvalue 1: det(A + h twice) = 0. Eigenvalue -1: det(2 I + h A + h^2 twice) = 0. With
    # 1/h for h both are linear eigenvalue problems; a zero 1/h is no step.
    companion = np.block([[np.zeros((n, n)), np.eye(n)], [-twice / 2, -A / 2]])
    inverse = np.concatenate([scipy.linalg.eigvals(-twice, A), np.linalg.eigvals(companion)])
    inverse = inverse[np.isfinite(inverse) & (np.abs(inverse.imag) <= _SAME_ROOT * np.abs(inverse))]
    crossings = np.unique(1 / inverse.real[inverse.real > 1 / _SCAN_RANGE[1]])
    between = (crossings[1:] + crossings[:-1]) / 2
    grid = np.unique(np.concatenate([np.geomspace(*_SCAN_RANGE, _SCAN_POINTS), between]))
    radius = np.abs(np.linalg.eigvals(one_step(grid))).max(axis=1) - 1
    first = int(np.argmax(radius > _GROWTH))
    if radius[first] <= _GROWTH:
        limit = float("inf")
    elif first == 0:
        return 0.0
    else:
        low, high = grid[first - 1 : first + 1]
        # On the circle growth is rounding of either sign: aim at the threshold instead of at 0.
        aim = 0.0 if growth(low) < -_GROWTH else _GROWTH
        limit = float(scipy.optimize.brentq(lambda h: growth(h) - aim, low, high, xtol=1e-15))
        snapped = crossings[np.abs(crossings - limit) <= _SAME_ROOT * limit]
        if len(snapped):
            limit = float(snapped[0])
        elif growth(limit / 2) > _GROWTH / 1e3:
            # The growth is a power of h, below the threshold at first: there is no safe step.
            return 0.0
    below = crossings[crossings < limit]
    return min([limit, *(float(h) for h in below if _grows(one_step(np.array([h]))[0]))]) / rate
