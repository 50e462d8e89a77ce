"""What a plain function can do, found by calling it."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from statebook.systems.system import brief


def arguments_of(f: Callable) -> tuple[int, int]:
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


def require_pure(f: Callable, arguments: tuple[np.ndarray, ...]) -> None:
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


def takes_batches(rate: Callable, x0: np.ndarray, u0: np.ndarray) -> bool:
    """Whether a batch of states and inputs gives what its columns give, one by one."""
    # Different columns, or a function that mixes them would pass; as many columns as
    # no other dimension has, or a transposed result would pass.
    weights = np.linspace(0, 1e-3, max(x0.size, u0.size) + 2)
    xs = x0[:, None] + (1 + np.abs(x0))[:, None] * weights
    us = u0[:, None] + (1 + np.abs(u0))[:, None] * weights
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            batch = np.asarray(rate(xs, us, 0.0))
            columns = [np.asarray(rate(*column, 0.0)) for column in zip(xs.T, us.T, strict=True)]
        except Exception:  # whatever a function does with an array it was not written for
            return False
    return (
        batch.shape == xs.shape
        and all(column.shape == x0.shape for column in columns)
        and np.allclose(batch, np.stack(columns, axis=1), rtol=1e-12, atol=0, equal_nan=True)
    )
