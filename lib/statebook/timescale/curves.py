"""Functions of s along a path, as piecewise polynomials whose error is checked."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import factorial
from typing import Any, NamedTuple

import numpy as np
import scipy

from statebook.timescale.grid import Grid
from statebook.timescale.path import horner

_DEPTH = 14  # halvings of a piece
_MOST = 4000  # pieces that are halved at a time
_RIPPLES = 200  # of those with jumps or kinks; more are ripples
_SPARE = 2  # Chebyshev coefficients beyond the degree, which show the error
_SAFETY = 3.0  # on the error, for the coefficients that were not looked at
_STALLED = 0.5  # halving a piece makes the error of a smooth function much smaller than this

Values = Callable[[np.ndarray], np.ndarray]


class Fit(NamedTuple):
    """A piecewise polynomial, and its error.

    Attributes
    ----------
    curve : scipy.interpolate.PPoly
        Coefficients of shape (degree + 1, pieces, rows).
    error : array, shape (orders, pieces, rows)
        Of each derivative that was asked for.
    scale : array, shape (orders, rows)
        Largest value of that derivative.
    """

    curve: Any
    error: np.ndarray
    scale: np.ndarray


@cache
def _matrices(degree: int) -> tuple[np.ndarray, ...]:
    """Return nodes in [0, 1], values to Chebyshev coefficients, these to powers."""
    number = degree + 1 + _SPARE
    nodes = np.polynomial.chebyshev.chebpts1(number)
    to_chebyshev = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, number - 1))
    to_powers = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        power = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[k, : k + 1])
        shifted = np.polynomial.Polynomial(power)(np.polynomial.Polynomial([-1.0, 2.0])).coef
        to_powers[: len(shifted), k] = shifted
    return (nodes + 1) / 2, to_chebyshev, to_powers


def fit(
    values: Values,
    knots: np.ndarray,
    degree: int,
    tolerance: float,
    orders: tuple[int, ...],
    *,
    rough: bool = False,
    stall: float = np.inf,
    floor: float = 0.0,
) -> Fit:
    """Fit polynomials to a function, in pieces as short as its derivatives need.

    On each piece the function is interpolated at Chebyshev points inside it; the coefficients
    beyond the degree are left out and bound the error. A piece is halved until that error is
    small in all derivatives, or no longer falls: that is the function's own noise.

    Parameters
    ----------
    values : callable
        (M,) to (M, rows).
    knots : array
        Where pieces must end.
    degree : int
    tolerance : float
        Part of a derivative's largest value by which it may be missed.
    orders : tuple of int <= 2
        The derivatives that count.
    rough : bool
        Whether the function may jump: the place is found by bisection and made a knot. The
        tolerance is then a part of its smallest value in the piece.
    stall : float
        An error that no longer falls is accepted below this part of the largest value.
    floor : float
        Largest values below this count as this.
    """
    nodes, to_chebyshev, to_powers = _matrices(degree)
    k = np.arange(degree + 1, degree + 1 + _SPARE)
    steepest = _SAFETY * np.stack([np.ones(_SPARE), k**2, k**2 * (k**2 - 1) / 3])[list(orders)]
    todo = np.stack([knots[:-1], knots[1:]], axis=1)
    before: tuple[np.ndarray, ...] = ()  # error, coefficients and left end of the pieces halved
    done: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    scale = np.zeros(0)
    for depth in range(_DEPTH + 1):
        start, h = todo[:, 0], np.diff(todo)
        sampled = values((todo[:, :1] + h * nodes).ravel()).reshape(len(todo), len(nodes), -1)
        chebyshev = np.matmul(to_chebyshev, sampled)
        tail = np.abs(chebyshev[:, degree + 1 :])
        powers = np.matmul(to_powers, chebyshev[:, : degree + 1])
        coefficients = powers / h[:, :, None] ** np.arange(degree + 1)[:, None]
        size = np.array(orders)[:, None, None]
        error = np.einsum("jk,pkr->jpr", steepest, tail) * (2 / h.T[:, :, None]) ** size
        if rough:
            scale = np.abs(sampled).min(axis=1)[None]
        elif not depth:
            c = coefficients[:, ::-1].swapaxes(0, 1)
            pieces = np.arange(len(todo))
            seen = [np.abs(horner(c, pieces, np.outer(nodes, h), order)) for order in orders]
            scale = np.maximum(np.array([s.max(axis=(0, 1)) for s in seen])[:, None], floor)
        open_ = error > tolerance * scale
        if depth and not rough:
            noisy = (error > _STALLED * before[0]).any(axis=0)
            noisy &= (before[0] <= stall * scale).all(axis=0)
            open_ &= ~noisy
            shifted = _expanded(before[1], start - before[2])
            coefficients = np.where(noisy[:, None], shifted, coefficients)
            error = np.where(noisy, before[0], error)
        go_on = depth < _DEPTH and len(start) < (_RIPPLES if rough else _MOST)
        unfinished = open_.any(axis=(0, 2)) & go_on
        done.append((start[~unfinished], coefficients[~unfinished], error[:, ~unfinished]))
        if not unfinished.any():
            break
        todo = todo[unfinished]
        cut = np.array([_jump(values, *piece) for piece in todo]) if rough else todo.mean(axis=1)
        todo = np.concatenate(
            [np.stack([todo[:, 0], cut], axis=1), np.stack([cut, todo[:, 1]], axis=1)]
        )
        before = (
            np.tile(error[:, unfinished], (1, 2, 1)),
            np.tile(coefficients[unfinished], (2, 1, 1)),
            np.tile(start[unfinished], 2),
        )
    left, coefficients, error = (
        np.concatenate(parts, axis=i // 2) for i, parts in enumerate(zip(*done, strict=True))
    )
    order = np.argsort(left)
    curve = scipy.interpolate.PPoly(
        coefficients[order, ::-1].swapaxes(0, 1).copy(), np.append(left[order], knots[-1])
    )
    return Fit(curve, error[:, order], scale.reshape(len(orders), -1) if not rough else scale[0])


def _expanded(coefficients: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return polynomials (P, degree + 1, rows), lowest power first, about other points (P,)."""
    c, pieces = coefficients[:, ::-1].swapaxes(0, 1), np.arange(len(offset))
    terms = [horner(c, pieces, offset, m) / factorial(m) for m in range(len(c))]
    return np.stack(terms, axis=1)


def _jump(values: Values, start: float, end: float) -> float:
    """Return where the function jumps within an interval, or its middle if it does not."""
    a, b = start, end
    at_a, at_b = values(np.array([a, b]))
    first = np.abs(at_b - at_a)
    while True:
        middle = (a + b) / 2
        if not a < middle < b:
            break
        at_middle = values(np.array([middle]))[0]
        if np.abs(at_middle - at_a).max() >= np.abs(at_b - at_middle).max():
            b, at_b = middle, at_middle
        else:
            a, at_a = middle, at_middle
    jumps = np.abs(at_b - at_a) > 0.1 * first
    inside = start < a and b < end
    return b if inside and (jumps & (first > 0)).any() else (start + end) / 2


def on_grid(curve: Any, grid: Grid, z: np.ndarray, derivative: int) -> np.ndarray:
    """Return a derivative of a curve at fractions z (K,) of a grid's intervals, (K, N, rows).

    No knot of the curve, a function of s, is inside an interval; the derivative is the grid's.
    """
    start, middle = grid.s_at(np.array([0.0, 0.5]))
    piece = np.clip(np.searchsorted(curve.x, middle, side="right") - 1, 0, len(curve.x) - 2)
    offset = start - curve.x[piece] + np.multiply.outer(z, grid.h / grid.stretch)
    offset = np.clip(offset, 0.0, np.diff(curve.x)[piece])  # free of rounding, where it is steep
    return horner(curve.c, piece, offset, derivative) / grid.stretch[:, None] ** derivative
