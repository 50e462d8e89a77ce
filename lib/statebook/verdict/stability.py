"""The stability verdict of a matrix, a linear system or an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.derivatives import derivative
from statebook.linearization import linearize
from statebook.systems import as_system
from statebook.verdict.clusters import (
    EPS,
    Block,
    Cluster,
    assemble,
    clusters,
    decompose,
    margin,
    rounding,
    shared_jordan_points,
    sharpened,
    weak_components,
    with_comparable_couplings,
)
from statebook.verdict.level_sets import boundary_distance
from statebook.verdict.maps import sorting
from statebook.verdict.report import StabilityReport, format_complex, modes_of

ASYMPTOTICALLY_STABLE = "asymptotically stable"
MARGINALLY_STABLE = "marginally stable"
UNSTABLE = "unstable"


@dataclass(frozen=True)
class Judgement:
    """A verdict on a matrix, before it is put in words and order.

    `margin` is that of the worst eigenvalue: 0 on the boundary, inf if there is none. `doubt`
    is whether rounding could change the verdict.
    """

    verdict: str
    reason: str
    eigenvalues: np.ndarray
    participations: np.ndarray
    margin: float
    doubt: bool = False


def judge(
    A: np.ndarray, discrete: bool, *, precision: float = EPS, check_distance: bool = True
) -> Judgement:
    """Judge a square matrix, known to a relative precision."""
    if len(A) == 0:
        reason = "it has no states, so there is nothing that could grow."
        nothing = np.zeros(0, complex)
        return Judgement(ASYMPTOTICALLY_STABLE, reason, nothing, np.zeros((0, 0)), np.inf)
    blocks = decompose(A, precision)
    found = clusters(blocks, discrete)
    values, margins, certain = _locate(blocks, found, discrete)
    worst = int(np.argmin(margins))
    doubt = any(not cluster.clear for cluster in found)
    edge = "the unit circle" if discrete else "the imaginary axis"
    if margins[worst] < 0:
        verdict = UNSTABLE
        side = "outside" if discrete else "to the right of"
        where = show(values[worst], values)
        reason = f"the eigenvalue {where} lies {-margins[worst]:.4g} {side} {edge}."
        # One that is beyond for certain settles the matter.
        doubt = not np.any(certain & (margins < 0))
    elif margins[worst] == 0:
        shared = shared_jordan_points(A, blocks, found)
        jordan = [point for point, _ in shared]
        jordan += [cluster.point for cluster in found if cluster.defective]
        doubt = doubt or any(not clear for _, clear in shared)
        verdict = UNSTABLE if jordan else MARGINALLY_STABLE
        there = np.array(jordan) if jordan else values[margins == 0]
        listed = ", ".join(dict.fromkeys(show(z, values) for z in there[sorting(there)]))
        chain = "with a Jordan block" if jordan else "without a Jordan block"
        reason = f"{listed} on {edge} (to within rounding) {chain}, and none beyond."
    else:
        verdict = ASYMPTOTICALLY_STABLE
        side = "inside" if discrete else "to the left of"
        reason = f"all eigenvalues lie {side} {edge}, by {margins[worst]:.4g} or more."
        if check_distance and not doubt:
            doubt = any(
                _too_close(A[np.ix_(index, index)], discrete, precision)
                for index in weak_components(A)
            )
    if doubt:
        reason += (
            " But this is undecidable in double precision: a perturbation as small as rounding"
            " could change it, and the verdict is a best guess."
        )
    shares = _participations(A, blocks)
    return Judgement(verdict, reason, values, shares, float(margins[worst]), doubt)


def _locate(
    blocks: list[Block], found: list[Cluster], discrete: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigenvalues without their blur, their margins, and which are certain."""
    start = np.concatenate([[0], np.cumsum([len(block.index) for block in blocks])])
    values = np.concatenate([sharpened(block) for block in blocks])
    margins = margin(values, discrete)
    certain = np.ones(len(values), dtype=bool)
    for cluster in found:
        place = start[cluster.block] + cluster.members
        values[place] = cluster.point
        # On the boundary the margin is 0, where abs(point) may round to a neighbour of 1.
        margins[place] = margin(cluster.point, discrete) if cluster.side else 0.0
        certain[place] = False
    return values, margins, certain


def _too_close(A: np.ndarray, discrete: bool, precision: float) -> bool:
    """Whether a stable matrix is within rounding of instability, in the best of units."""
    blocks = decompose(A)
    if len(blocks) == 1:
        candidates = [blocks[0].matrix]
    else:
        candidates = [
            scipy.linalg.matrix_balance(A)[0],
            with_comparable_couplings(A, blocks, discrete),
        ]

    def close(B: np.ndarray) -> bool:
        norm = float(np.linalg.norm(B, 2))
        tol = rounding(max(norm, 1.0) if discrete else norm, len(B), precision)
        return boundary_distance(B, discrete, tol) <= tol

    return all(close(B) for B in candidates)


def _participations(A: np.ndarray, blocks: list[Block]) -> np.ndarray:
    """Share abs(w_k v_k) of state k in each mode; w and v its left and right eigenvectors."""
    T, Q, _ = assemble(A, blocks)
    _, W, V = scipy.linalg.eig(T, left=True, right=True)
    products = np.abs((Q @ W) * (Q @ V))
    # In a long Jordan chain the products underflow; each mode then counts as its block's own.
    own = scipy.linalg.block_diag(*[np.ones(block.T.shape) for block in blocks])
    products = np.where(products.sum(axis=0) > 0, products, own)
    shares = np.empty_like(products)
    shares[np.concatenate([block.index for block in blocks])] = products
    return shares / shares.sum(axis=0)


def show(value: complex, among: np.ndarray) -> str:
    """An eigenvalue in words, rounded against the largest."""
    return format_complex(complex(value), float(np.abs(among).max()))


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
        A = _validate.square("system_or_A", system_or_A)
        subject, linear, precision = "matrix", True, EPS
        states = tuple(f"x[{i}]" for i in range(len(A)))
    else:
        A, precision, dt, linear, states = _linear_part(system_or_A, x0, u0, dt)
        subject = "state matrix" if linear else "Jacobian matrix"
    discrete = _validate.is_discrete(dt)
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
        _validate.is_discrete(dt)
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
