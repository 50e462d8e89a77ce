"""Polynomials on [0, 1] in Bernstein form: their coefficients bound their values."""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

_LEVELS = 50  # halvings of [0, 1] before a point is narrower than rounding
_ROUNDING = 1e-13


@cache
def nodes(degree: int) -> np.ndarray:
    """Return degree + 1 points that determine a polynomial on [0, 1]."""
    return np.linspace(0.0, 1.0, degree + 1) if degree else np.array([0.5])


@cache
def from_values(degree: int) -> np.ndarray:
    """Return the matrix from values at the nodes to Bernstein coefficients."""
    return np.linalg.inv(to_values(degree, nodes(degree)))


def to_values(degree: int, z: np.ndarray) -> np.ndarray:
    """Return the matrix from Bernstein coefficients to values at points z."""
    z = z[:, None]
    k = np.arange(degree + 1)
    binomials = np.array([comb(degree, int(i)) for i in k])
    return np.asarray(binomials * z**k * (1 - z) ** (degree - k))


@cache
def _halves(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices to the coefficients on [0, 1/2] and on [1/2, 1] (de Casteljau)."""
    left = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        left[i, : i + 1] = [comb(i, k) / 2**i for k in range(i + 1)]
    return left, left[::-1, ::-1].copy()


def along(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Multiply the first axis of values by a matrix."""
    return (matrix @ values.reshape(len(values), -1)).reshape(len(matrix), *values.shape[1:])


def maxima(
    coefficients: np.ndarray, sign: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the largest value of many families of polynomials on [0, 1].

    A polynomial lies under its largest Bernstein coefficient and reaches its first and last
    one. Halving the interval where the two differ, and dropping what lies under a value
    already reached, encloses the maximum to rounding: no sampling, no root finding.

    Parameters
    ----------
    coefficients : array, shape (degree + 1, N, R)
        N polynomials of each of R families.
    sign : array, shape (any, N, R), optional
        Bernstein coefficients of polynomials of which only the parts where they are positive
        count.

    Returns
    -------
    value, polynomial, z : array, shape (R,)
        For each family the largest value (-inf if nothing counts), whose it is, and where.
    """
    count, families = coefficients.shape[1:]
    boxes = coefficients.reshape(len(coefficients), -1)
    positive = None if sign is None else sign.reshape(len(sign), -1)
    member, family = np.divmod(np.arange(count * families), families)
    start, width = np.zeros(boxes.shape[1]), 1.0
    value = np.full(families, -np.inf)
    where = np.zeros(families, dtype=int)
    place = np.zeros(families)
    left, right = _halves(len(boxes) - 1)
    for _ in range(_LEVELS):
        for end in (0, -1):
            reached = boxes[end]
            if positive is not None:
                reached = np.where(positive[end] > 0, reached, -np.inf)
            if width == 1.0:
                best = reached.reshape(count, families).argmax(axis=0) * families
                best += np.arange(families)
            else:
                best = np.lexsort((reached, family))
                best = best[np.flatnonzero(np.diff(family[best], append=families))]
            best = best[reached[best] > value[family[best]]]
            row = family[best]
            value[row], where[row] = reached[best], member[best]
            place[row] = start[best] + (width if end else 0.0)
        floor = np.maximum(value, -np.finfo(float).max)[family]
        keep = boxes.max(axis=0) > floor + _ROUNDING * np.minimum(np.abs(floor), 1e300)
        if positive is not None:
            keep &= positive.max(axis=0) > 0
        if not keep.any():
            break
        boxes, member, family, start = boxes[:, keep], member[keep], family[keep], start[keep]
        boxes = np.concatenate([left @ boxes, right @ boxes], axis=1)
        if positive is not None:
            halves = _halves(len(positive) - 1)
            positive = np.concatenate([half @ positive[:, keep] for half in halves], axis=1)
        width /= 2
        member, family = np.tile(member, 2), np.tile(family, 2)
        start = np.concatenate([start, start + width])
    return value, where, place


def ratio_maxima(
    numerators: np.ndarray, denominators: np.ndarray, sign: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the largest ratio of polynomials on [0, 1], as `maxima` does for polynomials.

    The ratio is below r where numerator - r denominator < 0; from the place where this is largest
    r rises to the ratio there, until nothing is left (Dinkelbach's algorithm).

    Parameters
    ----------
    numerators, denominators : array, shape (degree + 1, N, R)
        Bernstein coefficients; the denominators are positive.
    sign : array, optional
        As in `maxima`.
    """
    degree, rows = len(numerators) - 1, np.arange(numerators.shape[2])
    ratio = np.zeros(len(rows))
    value, member, place = maxima(numerators, sign)
    for _ in range(_LEVELS):
        basis = to_values(degree, place).T
        at = [(basis * part[:, member, rows]).sum(axis=0) for part in (numerators, denominators)]
        better = np.where(np.isfinite(value), at[0] / at[1], -np.inf)
        if np.all(better <= ratio * (1 + _ROUNDING)):
            break
        ratio = np.maximum(ratio, better)
        value, member, place = maxima(numerators - ratio * denominators, sign)
    return ratio, member, place
