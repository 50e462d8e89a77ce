"""What every feedback law stands on: its limit, its loop, and what it refuses."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from statebook import _validate
from statebook.derivatives import InexactDerivativeWarning
from statebook.probes import depends_on_time
from statebook.residuals import labels_among
from statebook.systems import System
from statebook.verdict.stability import stability


def saturate(u: np.ndarray, limit: float | None) -> np.ndarray:
    """Clip a control to plus and minus a limit, if there is one."""
    return u if limit is None else np.clip(u, -limit, limit)


def columns(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return a vector so that it broadcasts against a state or a batch of states."""
    return values if like.ndim == 1 else values[:, None]


def state_of(x: Any, n: int) -> np.ndarray:
    """Return a state (n,) or a batch (n, N) as an array; it need not be finite."""
    x = np.asarray(x)
    if x.dtype.kind not in "biufc" or x.ndim not in (1, 2) or len(x) != n:
        raise ValueError(f"x must be numbers of shape ({n},) or ({n}, N), got {x!r}")
    return x


def rows_of(name: str, wanted: Any, labels: Sequence[str]) -> np.ndarray:
    """Return the matrix C of C x, from labels of states or from C itself."""
    if np.ndim(wanted) and not all(isinstance(label, str) for label in wanted):
        return _validate.real_array(name, wanted, (None, len(labels)))
    return np.eye(len(labels))[[labels.index(x) for x in labels_among(name, wanted, labels)]]


def unwound(error: np.ndarray, u: np.ndarray, Ki: np.ndarray, limit: float | None) -> np.ndarray:
    """Return the rate of the integrals z of u = ... - Ki z, with those at a limit held.

    While an input is at its limit, integrals that push it on are held (anti-windup by
    conditional integration).
    """
    if limit is None:
        return error
    winding = (np.abs(u) >= limit) & ((u * -(Ki @ error)).real > 0)
    return np.where((Ki != 0).T @ winding, 0.0, error)


def closed_loop(
    system: System, rate: Callable[..., Any], memories: Mapping[str, int], law: str
) -> System:
    """Return a system with memories of a law, numbers of them by name, as further states."""
    further = (f"{name}{i + 1}" for name, number in memories.items() for i in range(number))
    states, name = (*system.states, *further), f"{system.name} with {law}"
    return replace(system, rate=rate, states=states, name=name, linear=False, source=None)


def require_timeless(system: System, x: np.ndarray, u: np.ndarray) -> None:
    """Refuse a system that depends on the time: its gains would hold for one time only."""
    if system.timed and depends_on_time(system.rate, x, u):
        raise ValueError(
            f"system must not depend on the time, but {system.name} does; hold it at one time t0,"
            " lambda x, u: f(x, u, t0)"
        )


def require_stable(loop: System, x0: np.ndarray, gains: str) -> None:
    """Refuse a loop that is not asymptotically stable."""
    with warnings.catch_warnings():  # the verdict counts the error of differences in
        warnings.simplefilter("ignore", InexactDerivativeWarning)
        report = stability(loop, x0)
    if report.verdict != "asymptotically stable":
        raise ValueError(f"{gains} do not stabilize the target: {report.reason}")


def limit_of(value: Any, u0: np.ndarray, what: str) -> float | None:
    """Return a limit, None or more than the control that holds a place."""
    if value is None:
        return None
    limit, largest = _validate.positive("limit", value), np.abs(u0).max(initial=0.0)
    if limit <= largest:
        rest = ", which leaves nothing to correct with" if limit == largest else ""
        raise ValueError(
            f"limit must be at least {largest:.4g} to hold {what}, got {limit:g}{rest}"
        )
    return limit


def matrix_of(name: str, value: Any, shape: tuple[int, int]) -> np.ndarray:
    """Return a matrix (m, p), from its diagonal or one number for all of it if m = p."""
    m, p = shape
    matrix = _validate.real_array(name, value)
    if m == p and matrix.shape in ((), (m,)):
        return np.diag(np.broadcast_to(matrix, (m,)))
    if matrix.shape != shape:
        also = f", be its diagonal of shape ({m},) or a number" if m == p else ""
        raise ValueError(f"{name} must have shape {shape}{also}, got {matrix.shape}")
    return matrix
