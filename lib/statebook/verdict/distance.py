"""How far a stable matrix is from an unstable one."""

from __future__ import annotations

from typing import Any

from statebook import _validate
from statebook.verdict.judgement import ASYMPTOTICALLY_STABLE, judge
from statebook.verdict.level_sets import boundary_distance
from statebook.verdict.linear_part import linear_part


def distance_to_instability(
    system_or_A: Any,
    x0: Any = None,
    u0: Any = None,
    *,
    dt: float | bool | None = None,
    t: float | None = None,
) -> float:
    """Size of the smallest perturbation that ends stability.

    ``min over omega of sigma_min(A - i omega I)`` in continuous time and ``min over theta of
    sigma_min(A - exp(i theta) I)`` in discrete time: the 2-norm of the smallest complex E for
    which A + E has an eigenvalue on the boundary. Eigenvalues alone can be far off it.

    Parameters
    ----------
    system_or_A : array of shape (n, n), control.StateSpace, or any system of `as_system`
        Real or complex matrix, or a system whose matrix or Jacobian is taken, in the units of
        its states: the distance depends on them.
    x0, u0 : array, shape (n,) and (m,), optional
        Equilibrium of a nonlinear system; u0 = None means zeros.
    dt : float, bool or None
        Marks a matrix or a plain function as discrete: None or 0 is continuous time, True or
        > 0 [s] discrete. Other systems know theirs.
    t : float, optional [s]
        The time at which a system that depends on it is frozen; required for one.

    Returns
    -------
    float
        The distance; 0 for a matrix that is not asymptotically stable, inf for an empty one.

    Raises
    ------
    NotAnEquilibriumError
        If x0 is no equilibrium.
    TypeError, ValueError
        If A is not a square matrix of finite numbers, dt is negative or contradicts the
        system's timebase, or a nonlinear system comes without x0.

    References
    ----------
    Byers, SIAM J. Sci. Stat. Comput. 9 (1988) 875; Boyd and Balakrishnan, Systems and Control
    Letters 15 (1990) 1; Trefethen and Embree, *Spectra and Pseudospectra*, section 49.

    Examples
    --------
    >>> distance_to_instability([[-1.0, 0.0], [0.0, -3.0]])
    1.0
    >>> distance_to_instability([[-1.0, 100.0], [0.0, -3.0]]) < 0.03
    True
    """
    part = linear_part(system_or_A, x0, u0, dt=dt, t=t)
    A, discrete = part.A, _validate.is_discrete(part.dt)
    if len(A) == 0:
        return float("inf")
    if judge(A, discrete, check_distance=False).verdict != ASYMPTOTICALLY_STABLE:
        return 0.0
    return boundary_distance(A, discrete)
