"""The verdict on a matrix: where its eigenvalues lie, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.stability import blocks as bl
from statebook.stability import boundary as bd
from statebook.stability.level_sets import boundary_distance
from statebook.stability.maps import sorting
from statebook.stability.report import format_complex

ASYMPTOTICALLY_STABLE = "asymptotically stable"
MARGINALLY_STABLE = "marginally stable"
UNSTABLE = "unstable"


def square(name: str, A: Any) -> np.ndarray:
    """Return a matrix as a finite square array."""
    A = _validate.array(name, A)
    if A.ndim != 2 or A.shape[0] != A.shape[1]:
        raise ValueError(f"{name} must be a square matrix of shape (n, n), got {A.shape}")
    return A


def is_discrete(dt: float | bool | None) -> bool:
    """Whether a timebase is discrete; a negative one is refused."""
    if dt is None or dt is True:
        return dt is True
    return _validate.non_negative("dt", dt) > 0


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
    A: np.ndarray, discrete: bool, *, precision: float = bl.EPS, check_distance: bool = True
) -> Judgement:
    """Judge a square matrix, known to a relative precision."""
    if len(A) == 0:
        reason = "it has no states, so there is nothing that could grow."
        nothing = np.zeros(0, complex)
        return Judgement(ASYMPTOTICALLY_STABLE, reason, nothing, np.zeros((0, 0)), np.inf)
    blocks = bl.decompose(A, precision)
    found = bd.clusters(blocks, discrete)
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
        shared = bd.shared_jordan_points(A, blocks, found)
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
                for index in bl.weak_components(A)
            )
    if doubt:
        reason += (
            " But this is undecidable in double precision: a perturbation as small as rounding"
            " could change it, and the verdict is a best guess."
        )
    shares = _participations(A, blocks)
    return Judgement(verdict, reason, values, shares, float(margins[worst]), doubt)


def _locate(
    blocks: list[bl.Block], found: list[bd.Cluster], discrete: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigenvalues without their blur, their margins, and which are certain."""
    start = np.concatenate([[0], np.cumsum([len(block.index) for block in blocks])])
    values = np.concatenate([bd.sharpened(block) for block in blocks])
    margins = bd.margin(values, discrete)
    certain = np.ones(len(values), dtype=bool)
    for cluster in found:
        place = start[cluster.block] + cluster.members
        values[place] = cluster.point
        # On the boundary the margin is 0, where abs(point) may round to a neighbour of 1.
        margins[place] = bd.margin(cluster.point, discrete) if cluster.side else 0.0
        certain[place] = False
    return values, margins, certain


def _too_close(A: np.ndarray, discrete: bool, precision: float) -> bool:
    """Whether a stable matrix is within rounding of instability, in the best of units."""
    blocks = bl.decompose(A)
    if len(blocks) == 1:
        candidates = [blocks[0].matrix]
    else:
        candidates = [
            scipy.linalg.matrix_balance(A)[0],
            bl.with_comparable_couplings(A, blocks, discrete),
        ]

    def close(B: np.ndarray) -> bool:
        norm = float(np.linalg.norm(B, 2))
        tol = bl.rounding(max(norm, 1.0) if discrete else norm, len(B), precision)
        return boundary_distance(B, discrete, tol) <= tol

    return all(close(B) for B in candidates)


def _participations(A: np.ndarray, blocks: list[bl.Block]) -> np.ndarray:
    """Share abs(w_k v_k) of state k in each mode; w and v its left and right eigenvectors."""
    T, Q, _ = bl.assemble(A, blocks)
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
