"""Which eigenvalues lie on the stability boundary, and whether they are semisimple."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from statebook.stability.blocks import TINY, Block, assemble, rounding

# A Jordan coupling this many times above rounding is beyond doubt.
_CLEAR = 1e3
# Eigenvalues farther apart than this, relative to the largest, are not one blurred eigenvalue.
_BLUR = 1e-2


@dataclass(frozen=True)
class Cluster:
    """Eigenvalues of one block that rounding can move onto the boundary.

    Attributes
    ----------
    block : int
        Number of the block.
    members : array of int
        Their places on the diagonal of the block's Schur form.
    point : complex
        Where they are, without the blur: their mean, or the boundary if the mean is on it.
    side : int
        -1 inside, 0 on the boundary, 1 beyond: where their mean is.
    defective : bool
        They have a Jordan block of size two or more.
    clear : bool
        Rounding cannot change side and defective.
    spread : float
        Uncertainty of the mean.
    """

    block: int
    members: np.ndarray
    point: complex
    side: int
    defective: bool
    clear: bool
    spread: float


def margin(eigenvalues, discrete: bool):
    """Distance of eigenvalues from the boundary, positive inside."""
    return 1 - np.abs(eigenvalues) if discrete else -np.real(eigenvalues)


def project(eigenvalues, discrete: bool):
    """Nearest points of the boundary: the imaginary axis or the unit circle."""
    if not discrete:
        return 1j * np.imag(eigenvalues)
    radius = np.abs(eigenvalues)
    return np.where(radius > 0, eigenvalues, 1.0) / np.where(radius > 0, radius, 1.0)


def tolerance(block: Block, discrete: bool) -> float:
    """Rounding of a balanced block; a map has the size of the unit circle at least."""
    norm = float(np.linalg.norm(block.matrix, 2))
    return rounding(max(norm, 1.0) if discrete else norm, len(block.index), block.precision)


def clusters(blocks: list[Block], discrete: bool) -> list[Cluster]:
    """Find the boundary clusters of every block."""
    return [
        _judge(number, block, members, discrete)
        for number, block in enumerate(blocks)
        for members in _groups(block.T, tolerance(block, discrete), discrete)
    ]


def _groups(T: np.ndarray, tol: float, discrete: bool) -> list[np.ndarray]:
    """Eigenvalues that share a piece of the pseudospectrum of rounding with the boundary.

    A Jordan block of size k leaves a cluster of radius eps^(1/k), but at every point p of it
    and between it and the boundary the smallest singular value of T - p I is at rounding.
    """
    eigenvalues = np.diag(T)
    points = project(eigenvalues, discrete)
    near = [_linked(T, value, p, tol) for value, p in zip(eigenvalues, points, strict=True)]
    members = np.flatnonzero(near)
    members = members[np.argsort(np.angle(points[members]) if discrete else points[members].imag)]
    groups: list[list[int]] = []
    for place in members.tolist():
        if groups and _linked(T, points[groups[-1][-1]], points[place], tol):
            groups[-1].append(place)
        else:
            groups.append([place])
    if (
        discrete
        and len(groups) > 1
        and _linked(T, points[groups[-1][-1]], points[groups[0][0]], tol)
    ):
        groups[0] = groups.pop() + groups[0]
    return [np.array(group) for group in groups]


def sharpened(block: Block) -> np.ndarray:
    """Eigenvalues of a block, those that rounding blurs into one another put at their mean.

    A double eigenvalue comes out as two, sqrt(eps) apart, in a way that depends on the machine;
    their mean does not.
    """
    values = np.diag(block.T).copy()
    tol = tolerance(block, discrete=False)
    near = np.abs(values[:, None] - values) <= _BLUR * np.abs(values).max()
    links = np.zeros(near.shape, dtype=bool)
    for i, j in zip(*np.nonzero(np.triu(near, 1)), strict=True):
        links[i, j] = _linked(block.T, values[i], values[j], tol)
    count, labels = scipy.sparse.csgraph.connected_components(links, directed=False)
    for label in range(count):
        members = labels == label
        mean = complex(values[members].mean())
        if np.isrealobj(block.matrix) and abs(mean.imag) <= 1e-3 * np.ptp(values[members].imag):
            mean = complex(mean.real)
        if members.sum() > 1:
            values[members] = mean
    return values


def _linked(T: np.ndarray, start: complex, end: complex, tol: float) -> bool:
    """Whether the way from one point to another stays where rounding may put eigenvalues."""
    return all(_gap(T, start + t * (end - start)) <= tol for t in (0.5, 1.0, 0.25, 0.75))


def _gap(T: np.ndarray, point: complex) -> float:
    """LAPACK's estimate of 1 / norm(inverse of T - point I), about the smallest singular value."""
    shifted = T - point * np.eye(len(T))
    return float(scipy.linalg.lapack.ztrcon(shifted)[0] * np.linalg.norm(shifted, 1))


def _judge(number: int, block: Block, members: np.ndarray, discrete: bool) -> Cluster:
    tol, k, p = tolerance(block, discrete), len(block.index), len(members)
    mean = complex(np.diag(block.T)[members].mean())
    point = complex(project(mean, discrete))
    T, Q = _leading(block, members)
    Z = np.zeros((p, 0))
    if p < k:
        Z = scipy.linalg.solve_sylvester(T[:p, :p], -T[p:, p:], T[:p, p:])
    projector = Q[:, :p] @ np.hstack([np.eye(p), Z]) @ Q.conj().T
    # First order: the mean moves by trace(projector E) / p, entries of E being rounding errors.
    size = np.abs(Q) @ np.abs(T) @ np.abs(Q).T
    moved = rounding(float(np.sum(np.abs(projector).T * size)) / p, k, block.precision)
    if discrete:
        moved = max(moved, rounding(1.0, k, block.precision))
    spread = tol * float(np.linalg.norm(projector, 2))
    # The entries of a graded matrix may keep a simple eigenvalue far sharper than the norm of
    # rounding does; the mean of several is no sharper than rounding in the sum.
    blur = moved if p == 1 else max(moved, tol / (8 * k))
    if abs(mean - point) > blur:
        side = -1 if margin(mean, discrete) > 0 else 1
        return Cluster(number, members, mean, side, False, False, spread)
    couplings = np.linalg.svd(T[:p, :p] - point * np.eye(p), compute_uv=False)
    lost = couplings <= spread
    if p == 1 or lost.all():
        return Cluster(number, members, point, 0, False, abs(mean - point) <= moved, spread)
    clear = lost.sum() <= 1 and bool(couplings[-2] > _CLEAR * spread)
    return Cluster(number, members, point, 0, True, clear, spread)


def _leading(block: Block, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Schur form of a block with some eigenvalues moved to the front."""
    select = np.zeros(len(block.T), dtype=np.int32)
    select[members] = 1
    T, Q, *_ = scipy.linalg.lapack.ztrsen(select, block.T, block.Q, job="N")
    return T, Q


def shared_jordan_points(
    A: np.ndarray, blocks: list[Block], found: list[Cluster]
) -> list[tuple[complex, bool]]:
    """Boundary points at which a coupling between blocks makes a Jordan block.

    The clusters are semisimple by themselves, so the null space of G = A - point I is as
    large as they are together if and only if the Schur complement
    ``S = G_mm - G_mo G_oo^-1 G_om`` vanishes (m their directions, o all others). It comes with
    each point whether S is clearly more than rounding of the whole matrix.
    """
    points = []
    rest = [cluster for cluster in found if cluster.side == 0 and not cluster.defective]
    while rest:
        first, *rest = rest
        group = [first] + [c for c in rest if abs(c.point - first.point) <= c.spread + first.spread]
        rest = [c for c in rest if not any(c is member for member in group)]
        strength = _coupling(A, blocks, group) if len(group) > 1 else 0.0
        if strength > 0:
            points.append((first.point, strength > rounding(1.0, len(A))))
    return points


def _coupling(A: np.ndarray, blocks: list[Block], group: list[Cluster]) -> float:
    """Largest entry of S, relative to the norm of A; 0 if all are rounding of their own terms."""
    blocks = list(blocks)
    for cluster in group:
        block = blocks[cluster.block]
        T, Q = _leading(block, cluster.members)
        blocks[cluster.block] = replace(block, T=T, Q=Q)
    T, Q, B = assemble(A, blocks)
    start = np.concatenate([[0], np.cumsum([len(block.index) for block in blocks])])
    m = np.concatenate([start[c.block] + np.arange(len(c.members)) for c in group])
    o = np.setdiff1d(np.arange(len(T)), m)
    home = np.searchsorted(start, m, side="right")
    G = T - group[0].point * np.eye(len(T))
    size = np.abs(Q).T @ np.abs(B) @ np.abs(Q)
    # An eigenvalue elsewhere that is blurred onto the point must not divide by zero.
    inverse = scipy.linalg.solve_triangular(G[np.ix_(o, o)] + TINY * np.eye(len(o)), np.eye(len(o)))
    S = G[np.ix_(m, m)] - G[np.ix_(m, o)] @ inverse @ G[np.ix_(o, m)]
    bound = size[np.ix_(m, m)] + size[np.ix_(m, o)] @ np.abs(inverse) @ size[np.ix_(o, m)]
    real = np.abs(S) > rounding(1.0, len(T), blocks[0].precision) * bound
    entries = np.abs(S)[real & (home[:, None] != home)]
    return float(entries.max(initial=0.0) / np.linalg.norm(B)) if len(entries) else 0.0
