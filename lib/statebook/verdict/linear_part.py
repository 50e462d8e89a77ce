"""The matrix that is judged: as it is, a system's own, or a Jacobian at an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from numbers import Number
from typing import Any

import numpy as np

from statebook import _validate
from statebook.linearization import jacobian_at_rest, warn_of_differences
from statebook.residuals import point
from statebook.systems import System, as_system, time_of
from statebook.verdict.blocks import EPS
from statebook.verdict.exact import RationalMatrix, as_rational


@dataclass(frozen=True)
class LinearPart:
    """Matrices with what is known of them.

    Attributes
    ----------
    A : array, shape (n, n)
    B : array, shape (n, m), or None
        None beside a bare matrix.
    rational : RationalMatrix or None
        A as the caller wrote it, where that is exact.
    precision : float
        Relative error of A.
    dt : float, bool or None
    states : tuple of str
    linear : bool
        A is the whole system, and not a Jacobian.
    system : System or None
        What A was computed from, at x0 and u0.
    x0, u0 : array, shape (n,) and (m,)
    t : float [s]
    source : control.StateSpace or None
        The linear system itself, if that was given.
    """

    A: np.ndarray
    B: np.ndarray | None
    rational: RationalMatrix | None
    precision: float
    dt: float | bool | None
    states: tuple[str, ...]
    linear: bool
    system: System | None = None
    x0: np.ndarray = field(default_factory=lambda: np.zeros(0))
    u0: np.ndarray = field(default_factory=lambda: np.zeros(0))
    t: float = 0.0
    source: Any = None


def as_matrix(value: Any) -> Any:
    """Return sparse matrices, data frames and matrices of other libraries as arrays or lists."""
    if isinstance(value, np.ndarray):
        return value
    ways = (getattr(value, name, None) for name in ("toarray", "to_numpy", "tolist", "__array__"))
    return next((way() for way in ways if way), value)


def linear_part(
    system_or_A: Any,
    x0: Any = None,
    u0: Any = None,
    *,
    dt: float | bool | None = None,
    t: float | None = None,
) -> LinearPart:
    """Return the matrix of a matrix, a linear system or an equilibrium.

    Parameters
    ----------
    system_or_A, x0, u0, dt, t
        As `stability` takes them.

    Returns
    -------
    LinearPart

    Raises
    ------
    NotAnEquilibriumError, TypeError, ValueError
        As `stability` does.
    """
    matrix = as_matrix(system_or_A)
    if isinstance(matrix, np.ndarray | list | tuple | str | Number):
        if x0 is not None or u0 is not None:
            raise ValueError("x0 and u0 belong to a nonlinear system; a matrix takes neither")
        if t is not None:
            raise ValueError("t belongs to a system that depends on the time; a matrix takes none")
        rational = as_rational(matrix)
        A = rational.floats() if rational else _validate.square("system_or_A", matrix)
        states = tuple(f"x[{i}]" for i in range(len(A)))
        return LinearPart(A, None, rational, EPS, dt, states, True)
    import control

    if dt is not None:
        _validate.is_discrete(dt)
    view = as_system(system_or_A, x0, u0, dt=dt)
    if isinstance(view.source, control.StateSpace):
        if x0 is not None:  # any point will do, but not a point of another space
            _validate.array("x0", x0, (view.n,))
        A, B = np.asarray(view.source.A), np.asarray(view.source.B)
        return LinearPart(A, B, None, EPS, view.dt, view.states, True, source=view.source)
    if x0 is None:
        if not view.linear:
            raise ValueError(
                "x0 is required: a nonlinear system's stability is that of one of its equilibria"
            )
        x0 = np.zeros(view.n)
    x, u = point(view, x0, u0, batch=False)
    t = time_of(view, x, u, t)
    if view.timed:  # what follows looks at this time alone
        rate = view.rate
        view = replace(view, rate=lambda x, u, _: rate(x, u, t), timed=False)
    J, error, inexact = jacobian_at_rest(view, x, u)
    warn_of_differences(view, error, inexact)
    A, B = J[:, : view.n], J[:, view.n :]
    precision = precision_of(A, error[:, : view.n])
    return LinearPart(A, B, None, precision, view.dt, view.states, view.linear, view, x, u, t)


def precision_of(A: np.ndarray, error: np.ndarray) -> float:
    """Return the relative error of a matrix whose entries have these errors."""
    size = float(np.linalg.norm(A))
    return max(EPS, float(np.linalg.norm(error)) / size) if size > 0 else EPS


def continuous_part(
    system_or_A: Any, x0: Any = None, u0: Any = None, t: float | None = None
) -> LinearPart:
    """Return the matrix of a system in continuous time; one in discrete time is refused."""
    part = linear_part(system_or_A, x0, u0, t=t)
    if _validate.is_discrete(part.dt):
        raise ValueError(
            f"system_or_A must be in continuous time, got a system with dt = {part.dt}"
        )
    return part
