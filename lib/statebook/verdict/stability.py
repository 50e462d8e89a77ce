"""The stability verdict of a matrix, a linear system or an equilibrium."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.linearization import linear_system
from statebook.verdict.exact import LARGEST, RationalMatrix, as_rational, judge_exactly
from statebook.verdict.families import family_of
from statebook.verdict.judgement import UNSTABLE, Judgement, judge
from statebook.verdict.linear_part import LinearPart, linear_part
from statebook.verdict.report import StabilityReport, modes_of
from statebook.verdict.words import sorting

if TYPE_CHECKING:
    import control

INCONCLUSIVE = "inconclusive"


def stability(
    system_or_A: Any,
    x0: Any = None,
    u0: Any = None,
    *,
    dt: float | bool | None = None,
    exact: bool | None = None,
    t: float | None = None,
) -> StabilityReport:
    """Decide stability, and say why.

    Of x' = A x (or x_next = A x): asymptotically stable if all eigenvalues are inside the left
    half-plane (unit disc), unstable if one is beyond its boundary or has a Jordan block on it,
    else marginally stable. Of an equilibrium of a nonlinear system by Lyapunov's indirect
    method: eigenvalues on the boundary and none beyond leave it inconclusive, but for those of
    a family of equilibria, which is stable, or along which the state drifts.

    Parameters
    ----------
    system_or_A : array of shape (n, n), control.StateSpace, or any system of `as_system`
        A matrix (of floats, integers, fractions, decimals or SymPy's rationals; an array, lists,
        a sparse matrix, a SymPy matrix or a data frame), a linear system, or a
        nonlinear system with its equilibrium x0.
    x0, u0 : array, shape (n,) and (m,), optional
        Equilibrium of a nonlinear system; u0 = None means zeros.
    dt : float, bool or None
        Marks a matrix or a plain function as discrete: None or 0 is continuous time, True or
        > 0 [s] discrete. Other systems know theirs.
    exact : bool, optional
        Prove the verdict in rational arithmetic, n <= 30. By default where the matrix is exact:
        integers, fractions, SymPy's rationals. True takes floats at their word too.
    t : float, optional [s]
        The time at which a system that depends on it is frozen; required for one.

    Returns
    -------
    StabilityReport
        Its ``tolerance`` is how far rounding (a perturbation of 8 n eps norm(A), after
        balancing) may move the margin. What is on the boundary is so to within tolerance; its
        ``reason`` says "undecidable in double precision" where the true margin may be of
        another sign, or farther off; the verdict is then the best guess.

    Raises
    ------
    NotAnEquilibriumError
        If x0 is no equilibrium.
    TypeError, ValueError
        If the matrix is not square or not finite, dt is negative or contradicts the system's
        timebase, a nonlinear system comes without x0, a SymPy entry is no rational number, or
        exact=True meets a computed Jacobian or more than 30 states.

    Notes
    -----
    The matrix is split into blocks that do not feed back into one another, where zeros are
    exact, and each block is balanced: units of states and time do not matter. Eigenvalues that
    a perturbation as large as rounding keeps apart are judged one by one; others, such as those
    of a Jordan block, together by their mean, if they are within rounding of one eigenvalue. A
    stable verdict is certain where no such perturbation ends stability.

    References
    ----------
    Khalil, *Nonlinear Systems*, sections 4.3 (indirect method) and 8.1 (center manifold);
    Antsaklis and Michel, *Linear Systems*, section 4.8; Golub and Van Loan, *Matrix
    Computations*, sections 7.2 and 7.6.

    Examples
    --------
    >>> stability([[0.0, 1.0], [-10.0, -1.0]]).verdict
    'asymptotically stable'
    >>> stability([[0, 1], [-1, 0]]).reason.split(". ")[-1]
    'Proved in exact arithmetic.'
    >>> stability(lambda x, u: [x[1], u[0] - x[1]], [0, 0], [0]).verdict
    'stable, along a family of dimension 1'
    """
    part = linear_part(system_or_A, x0, u0, dt=dt, t=t)
    discrete = _validate.is_discrete(part.dt)
    rational = _to_be_proved(part, exact)
    if rational is not None:
        judgement = judge_exactly(rational, discrete)
    else:
        judgement = judge(part.A, discrete, precision=part.precision)
    verdict = judgement.verdict
    if part.linear:
        subject = "matrix" if part.system is None else "state matrix"
        reason = f"The {subject} in {'discrete' if discrete else 'continuous'} time: "
        reason += judgement.reason
    else:
        verdict, reason = _of_equilibrium(part, judgement)
        reason = "Lyapunov's indirect method, on the Jacobian matrix: " + reason
    order = sorting(judgement.eigenvalues)
    eigenvalues = judgement.eigenvalues[order]
    modes = modes_of(eigenvalues, judgement.participations[:, order], discrete, part.dt)
    return StabilityReport(
        verdict, eigenvalues, judgement.margin, judgement.tolerance, reason, modes, part.dt,
        part.states, _linearization(part),
    )  # fmt: skip


def _linearization(part: LinearPart) -> control.StateSpace | None:
    """Return the linear system that was judged; None of a matrix, or of outputs with a kink."""
    if part.system is None:
        return part.source
    assert part.B is not None
    try:
        J = np.hstack([part.A, part.B])
        return linear_system(part.system, part.x0, part.u0, part.t, J)
    except ValueError:
        return None


def _to_be_proved(part: LinearPart, exact: bool | None) -> RationalMatrix | None:
    """Return the matrix in rational numbers if the verdict is to be exact."""
    if exact not in (None, True, False):
        raise TypeError(f"exact must be None, True or False, got {exact!r}")
    if exact is None:
        return part.rational if len(part.A) <= LARGEST else None
    if not exact or len(part.A) == 0:
        return None
    if part.system is not None:
        raise ValueError(
            f"exact=True is for matrices and control.StateSpace: the derivatives of"
            f" {part.system.name} are computed, and not exact; pass the matrix itself"
        )
    return part.rational or as_rational(part.A, floats=True)


def _of_equilibrium(part: LinearPart, judgement: Judgement) -> tuple[str, str]:
    """Verdict and reason where A is a Jacobian: silent on the boundary, but for families."""
    if judgement.margin != 0 and not judgement.doubt:
        return judgement.verdict, judgement.reason
    assert part.system is not None
    discrete = part.system.discrete
    family = family_of(part.system, part.x0, part.u0, part.A, judgement)
    if family is None:
        if judgement.margin != 0:
            return judgement.verdict, judgement.reason
        silent = " The linear part does not decide; the higher-order terms do."
        return INCONCLUSIVE, judgement.reason + silent
    zero = "1" if discrete else "0"
    k = family.dimension
    where = f"the eigenvalue {zero} belongs to a family of equilibria of dimension {k}, followed"
    where += " to a finite distance at this input; "
    if family.drifts:
        return UNSTABLE, where + "it has Jordan blocks all along, so the state drifts along it."
    rest = "there are no others"
    if np.isfinite(family.rest):
        side = "inside the unit circle" if discrete else "to the left of the imaginary axis"
        rest = f"all others lie {side}, by {family.rest:.4g} or more"
    rest += ". The state stays near and comes to rest on the family, not where it was."
    return f"stable, along a family of dimension {k}", where + rest
