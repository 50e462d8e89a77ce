"""The stability verdict of a matrix, a linear system or an equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np

from statebook import _validate
from statebook.derivatives import derivative
from statebook.linearize import linearize
from statebook.stability.blocks import EPS
from statebook.stability.judge import is_discrete, judge, square
from statebook.stability.maps import sorting
from statebook.stability.report import StabilityReport, modes_of
from statebook.systems import as_system

INCONCLUSIVE = "inconclusive"


def stability(
    system_or_A: Any, x0: Any = None, u0: Any = None, *, dt: float | bool | None = None
) -> StabilityReport:
    """Decide stability, and say why.

    Of x' = A x (or x_next = A x): asymptotically stable if all eigenvalues are inside the left
    half-plane (unit disc), unstable if one is beyond its boundary or has a Jordan block on it,
    else marginally stable. Of an equilibrium of a nonlinear system by Lyapunov's indirect
    method: eigenvalues on the boundary and none beyond leave it inconclusive.

    Parameters
    ----------
    system_or_A : array of shape (n, n), control.StateSpace, or any system of `as_system`
        A matrix, a linear system, or a nonlinear system with its equilibrium x0.
    x0, u0 : array, shape (n,) and (m,), optional
        Equilibrium of a nonlinear system; u0 = None means zeros.
    dt : float, bool or None
        Marks a matrix or a plain function as discrete: None or 0 is continuous time, True or
        > 0 [s] discrete. Other systems know theirs.

    Returns
    -------
    StabilityReport
        Its ``reason`` says "undecidable in double precision" where a perturbation as small as
        rounding (8 n eps norm(A), after balancing) could change the verdict of a system that is
        not on the boundary by construction; the verdict is then the best guess.

    Raises
    ------
    NotAnEquilibriumError
        If x0 is no equilibrium.
    TypeError, ValueError
        If the matrix is not square or not finite, dt is negative or contradicts the system's
        timebase, or a nonlinear system comes without x0.

    Notes
    -----
    The matrix is split into blocks that do not feed back into one another, where zeros are
    exact, and each block is balanced: units of states and time do not matter. An eigenvalue is
    on the boundary if the boundary point nearest to it is in the pseudospectrum of rounding,
    and clusters of such eigenvalues are judged by their mean, which a Jordan block does not
    blur. Among them, couplings above rounding are Jordan blocks.

    References
    ----------
    Khalil, *Nonlinear Systems*, section 4.3 (indirect method); Antsaklis and Michel, *Linear
    Systems*, section 4.8; Golub and Van Loan, *Matrix Computations*, sections 7.2 and 7.6.

    Examples
    --------
    >>> stability([[0.0, 1.0], [-10.0, -1.0]]).verdict
    'asymptotically stable'
    >>> stability([[0.0, 1.0], [0.0, 0.0]]).verdict
    'unstable'
    """
    if _is_matrix(system_or_A):
        if x0 is not None or u0 is not None:
            raise ValueError("x0 and u0 belong to a nonlinear system; a matrix takes neither")
        A = square("system_or_A", system_or_A)
        subject, linear, precision = "matrix", True, EPS
        states = tuple(f"x[{i}]" for i in range(len(A)))
    else:
        A, precision, dt, linear, states = _linear_part(system_or_A, x0, u0, dt)
        subject = "state matrix" if linear else "Jacobian matrix"
    discrete = is_discrete(dt)
    judgement = judge(A, discrete, precision=precision)
    verdict = judgement.verdict
    reason = f"The {subject} in {'discrete' if discrete else 'continuous'} time: "
    if not linear:
        reason = f"Lyapunov's indirect method, on the {subject}: "
    reason += judgement.reason
    if not linear and judgement.margin == 0:
        verdict = INCONCLUSIVE
        reason += " The linear part does not decide; the higher-order terms do."
    order = sorting(judgement.eigenvalues)
    eigenvalues = judgement.eigenvalues[order]
    modes = modes_of(eigenvalues, judgement.participations[:, order], discrete, dt)
    return StabilityReport(verdict, eigenvalues, judgement.margin, reason, modes, dt, states)


def _is_matrix(value: Any) -> bool:
    return isinstance(value, np.ndarray | list | tuple) or np.isscalar(value)


def _linear_part(
    system: Any, x0: Any, u0: Any, dt: float | bool | None
) -> tuple[np.ndarray, float, float | bool | None, bool, tuple[str, ...]]:
    """Return A, its relative precision, dt, whether the system is linear, and state labels."""
    import control

    if dt is not None:
        is_discrete(dt)
    view = as_system(system, x0, u0, dt=dt)
    if isinstance(view.source, control.StateSpace):
        if x0 is not None:  # any point will do, but not a point of another space
            _validate.array("x0", x0, (view.n,))
        return np.asarray(view.source.A), EPS, view.dt, True, view.states
    if x0 is None:
        if not view.linear:
            raise ValueError(
                "x0 is required: a nonlinear system's stability is that of one of its equilibria"
            )
        x0 = np.zeros(view.n)
    A = np.asarray(linearize(view, x0, u0).A)
    u = np.zeros(view.m) if u0 is None else np.asarray(u0, dtype=float)
    _, error = derivative(
        lambda x: view.probe(x, np.repeat(u[:, None], x.shape[1], axis=1)),
        np.asarray(x0, dtype=float)[:, None],
    )
    size = float(np.linalg.norm(A))
    precision = max(EPS, float(np.linalg.norm(error)) / size) if size > 0 else EPS
    return A, precision, view.dt, view.linear, view.states
