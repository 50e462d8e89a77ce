"""The verdict on a matrix, from its clusters of eigenvalues, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from statebook.verdict.blocks import (
    EPS,
    Block,
    assemble,
    balanced,
    decompose,
    rounding,
    spectral_norm,
    weak_components,
    with_comparable_couplings,
)
from statebook.verdict.clusters import Cluster, clusters, shared_jordan_points
from statebook.verdict.level_sets import is_near_boundary, margin
from statebook.verdict.words import format_complex, sorting

ASYMPTOTICALLY_STABLE = "asymptotically stable"
MARGINALLY_STABLE = "marginally stable"
UNSTABLE = "unstable"


@dataclass(frozen=True)
class Judgement:
    """A verdict on a matrix, before it is put in words and order.

    `margin` is that of the worst eigenvalue: 0 on the boundary, inf if there is none; rounding
    may move it by `tolerance`. `doubt` is whether that could change the verdict. `jordan` are
    the boundary points with a Jordan block.
    """

    verdict: str
    reason: str
    eigenvalues: np.ndarray
    participations: np.ndarray
    margin: float
    tolerance: float = 0.0
    doubt: bool = False
    jordan: tuple[complex, ...] = ()


@np.errstate(over="ignore")
def judge(
    A: np.ndarray, discrete: bool, *, precision: float = EPS, check_distance: bool = True
) -> Judgement:
    """Judge a square matrix, known to a relative precision."""
    if len(A) == 0:
        reason = "it has no states, so there is nothing that could grow."
        nothing = np.zeros(0, complex)
        return Judgement(ASYMPTOTICALLY_STABLE, reason, nothing, np.zeros((0, 0)), np.inf)
    blocks = decompose(A, precision)
    spreads, found = clusters(blocks, discrete)
    values, margins, certain = _locate(blocks, found, discrete)
    worst = int(np.argmin(margins))
    size = float(margins[worst])
    tolerance = float(spreads[margins == size].max())
    doubt = not certain.all()
    jordan: list[complex] = []
    if size < 0:
        verdict = UNSTABLE
        # One that is beyond for certain settles the matter.
        beyond = certain & (margins < 0)
        if len(blocks) > 1:
            beyond &= -margins > _whole_rounding(A, blocks, discrete, precision)
        doubt = not beyond.any()
    elif size == 0:
        shared = shared_jordan_points(A, blocks, found)
        jordan = [point for point, _ in shared]
        jordan += [cluster.point for cluster in found if cluster.defective]
        doubt = doubt or any(not clear for _, clear in shared)
        verdict = UNSTABLE if jordan else MARGINALLY_STABLE
    else:
        verdict = ASYMPTOTICALLY_STABLE
        # Beyond what the clusters prove, unless one is all, the distance to instability decides.
        if check_distance and (len(blocks) > 1 or (doubt and len(found[0].members) < len(A))):
            doubt = any(
                all(is_near_boundary(*one) for one in _in_best_units(A, part, discrete, precision))
                for part in weak_components(A, blocks)
            )
        tolerance = max(tolerance, size) if doubt and check_distance else tolerance
    if not doubt and size != 0:
        tolerance = min(tolerance, abs(size))  # the sign is certain, however loose the bound
    there = np.array(jordan) if jordan else values[margins == size]
    reason = explain(verdict, there, size, tolerance, values, discrete)
    if doubt:
        reason += (
            " But this is undecidable in double precision: the margin is known to within"
            f" tolerance, {tolerance:.2g}, a perturbation as small as rounding could change the"
            " verdict, and it is a best guess."
        )
    shares = _participations(blocks, found)
    return Judgement(verdict, reason, values, shares, size, tolerance, doubt, tuple(jordan))


def explain(
    verdict: str,
    worst: np.ndarray,
    size: float,
    tolerance: float,
    values: np.ndarray,
    discrete: bool,
    exact: bool = False,
) -> str:
    """A verdict in words: where the worst eigenvalues are, and how far from the boundary."""
    edge = "the unit circle" if discrete else "the imaginary axis"
    scale = float(np.abs(values).max())
    if size > 0:
        side = "inside" if discrete else "to the left of"
        return f"all eigenvalues lie {side} {edge}, by {size:.4g} or more."
    if size < 0:
        side = "outside" if discrete else "to the right of"
        # Of the worst one no digit that the margin needs may be rounded away.
        where = format_complex(complex(worst[0]), min(scale, 1e8 * -size))
        return f"the eigenvalue {where} lies {-size:.4g} {side} {edge}."
    points = worst[sorting(worst)]
    listed = ", ".join(dict.fromkeys(format_complex(complex(z), scale) for z in points))
    how = "exactly" if exact else f"to within tolerance, {tolerance:.2g}"
    chain = "with a Jordan block" if verdict == UNSTABLE else "without a Jordan block"
    return f"{listed} on {edge} ({how}) {chain}, and none beyond."


def _locate(
    blocks: list[Block], found: list[Cluster], discrete: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigenvalues without their blur, their margins, and which are certain."""
    start = np.cumsum([0, *(len(block.index) for block in blocks)])
    values = np.concatenate([block.T.diagonal() for block in blocks])
    certain = np.ones(len(values), dtype=bool)
    on_boundary = np.zeros(len(values), dtype=bool)
    for cluster in found:
        place = start[cluster.block] + cluster.members
        values[place] = cluster.point if cluster.single else values[place]
        certain[place] = cluster.clear
        # The margin there is 0, where abs(point) may round to a neighbour of 1.
        on_boundary[place] = cluster.side == 0
    return values, np.where(on_boundary, 0.0, margin(values, discrete)), certain


def _in_best_units(
    A: np.ndarray, blocks: list[Block], discrete: bool, precision: float
) -> list[tuple[np.ndarray, bool, float]]:
    """Blocks together in two choices of units, the first in Schur form, and rounding in each."""
    T, Q, _ = assemble(A, blocks)
    candidates = [T]
    if len(blocks) > 1:
        B = with_comparable_couplings(A, blocks, discrete)
        index = np.concatenate([block.index for block in blocks])
        candidates = [np.triu(Q.conj().T @ B @ Q), balanced(A[np.ix_(index, index)], permute=1)[0]]
    floor = 1.0 if discrete else 0.0
    radii = (rounding(max(spectral_norm(B), floor), len(B), precision) for B in candidates)
    return [(B, discrete, radius) for B, radius in zip(candidates, radii, strict=True)]


def _whole_rounding(
    A: np.ndarray, blocks: list[Block], discrete: bool, precision: float
) -> np.ndarray:
    """Rounding, for each eigenvalue, of all that its block is coupled to, in the best of units."""
    size = np.zeros(len(A))
    for part in weak_components(A, blocks):
        index = np.concatenate([block.index for block in part])
        size[index] = min(radius for *_, radius in _in_best_units(A, part, discrete, precision))
    return size[np.concatenate([block.index for block in blocks])]


def _participations(blocks: list[Block], found: list[Cluster]) -> np.ndarray:
    """Share abs(w_k v_k) of state k in each mode; w and v its left and right eigenvectors.

    Where v and w of the whole matrix meet, in the mode's own block, they are the block's. Of a
    cluster it is the share in the invariant subspace, the diagonal of the spectral projector.
    """
    products = []
    for block in blocks:
        right, dual = block.modes
        products.append(np.abs((block.Q @ right) * (dual @ block.Q.conj().T).T))
    for cluster in found:
        products[cluster.block][:, cluster.members] = cluster.share[:, None]
    shares = scipy.linalg.block_diag(*[product / product.sum(axis=0) for product in products])
    return shares[np.argsort(np.concatenate([block.index for block in blocks]))]
