"""What a plain function can do, found by calling it."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from statebook._validate import brief


def arguments_of(f: Callable[..., Any]) -> tuple[int, int]:
    """Return how many of x, u the function requires and how many it accepts."""
    try:
        parameters = inspect.signature(f).parameters.values()
    except (TypeError, ValueError):  # built in C: nothing to read
        return 1, 2
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    required = sum(p.default is p.empty for p in positional)
    variadic = any(p.kind is p.VAR_POSITIONAL for p in parameters)
    if required > 2 or not (positional or variadic):
        raise TypeError(
            f"a system's function must take (x) or (x, u), got {required} required arguments;"
            " bind the others first (functools.partial)"
        )
    return max(required, 1), 2 if variadic else len(positional)


def require_pure(f: Callable[..., Any], arguments: tuple[np.ndarray, ...]) -> None:
    """Refuse a function that changes its arguments or remembers its last call."""
    copies = [a.copy() for a in arguments]
    first = np.array(f(*copies))
    _require_unchanged(arguments, copies)
    # An equilibrium at 0 hides both a memory (of 0) and x *= 2: call f beside it in between.
    beside = [a + 1e-3 * (1 + np.abs(a)) for a in arguments]
    copies = [a.copy() for a in beside]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            f(*copies)
        except (ValueError, ArithmeticError):  # outside its domain
            copies = beside
    _require_unchanged(beside, copies)
    second = np.array(f(*(a.copy() for a in arguments)))
    if first.dtype.kind in "biufc" and not np.array_equal(first, second, equal_nan=True):
        raise ValueError(
            "a system's function must depend on its arguments alone, but two calls at"
            f" x = {brief(arguments[0])} gave {brief(first)} and {brief(second)};"
            " make its memory part of the state"
        )


def _require_unchanged(arguments: Sequence[np.ndarray], copies: Sequence[np.ndarray]) -> None:
    if any((a != b).any() for a, b in zip(arguments, copies, strict=True)):
        raise ValueError(
            "a system's function must leave its arguments alone, but it changed one in place;"
            " work on a copy (x = x.copy())"
        )


def takes_batches(
    function: Callable[..., Any], *batches: np.ndarray, alone: Callable[..., Any], rtol: float
) -> bool:
    """Whether a function of batches gives what `alone` gives for their columns, one by one.

    Parameters
    ----------
    function : callable
        Called once with the batches; whatever it raises means no.
    *batches : array, shape (k, N)
        One batch for each argument. The columns should differ, or a function that mixes them up
        would pass; so should N from all other dimensions, or a transposed result would pass.
    alone : callable
        The same function for single columns (k,), which returns (r,).
    rtol : float
        Relative tolerance of the comparison.

    Examples
    --------
    >>> takes_batches(np.sin, np.eye(2, 3), alone=np.sin, rtol=1e-12)
    True
    >>> takes_batches(np.sort, np.eye(2, 3), alone=np.sort, rtol=1e-12)
    False
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            batch = np.array(function(*batches))
            columns = [np.array(alone(*c)) for c in zip(*(b.T for b in batches), strict=True)]
        except Exception:  # whatever a function does with an array it was not written for
            return False
    expected = np.stack(columns, axis=-1) if len({c.shape for c in columns}) == 1 else None
    return (
        expected is not None
        and batch.shape == expected.shape
        and bool(np.allclose(batch, expected, rtol=rtol, atol=0, equal_nan=True))
    )


def spread_beside(x: np.ndarray, number: int) -> np.ndarray:
    """Return `number` different columns beside x, (n, number), the first of them x."""
    return x[:, None] + (1 + np.abs(x))[:, None] * np.linspace(0, 1e-3, number)
