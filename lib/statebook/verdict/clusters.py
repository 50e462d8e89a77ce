"""Which eigenvalues lie on the stability boundary, and whether they are semisimple."""

from __future__ import annotations

from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from typing import Any

import numpy as np
import scipy

EPS = float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)
# Differences in the units of states are undone up to this ratio; more is no choice of units.
_UNIT_SPAN = 1e24


def rounding(norm: float, n: int, precision: float = EPS) -> float:
    """Norm of the perturbations to which n x n arithmetic is blind: 8 n eps norm."""
    return 8 * n * precision * norm


@dataclass(frozen=True)
class Block:
    """One strongly connected set of states, balanced, as ``matrix = Q T Q^H``.

    Attributes
    ----------
    index : array of int
        The states.
    matrix : array, shape (k, k)
        The balanced diagonal block.
    T, Q : array, shape (k, k), complex
        Its Schur form and basis.
    scale : array, shape (k,)
        Units of the balanced states.
    precision : float
        Relative error of the matrix: eps, or more if it was measured or differenced.
    """

    index: np.ndarray
    matrix: np.ndarray
    T: np.ndarray
    Q: np.ndarray
    scale: np.ndarray
    precision: float = EPS


def decompose(A: np.ndarray, precision: float = EPS) -> list[Block]:
    """Split a matrix into its irreducible diagonal blocks, block upper triangular in order.

    Zeros that are exact decouple exactly: the eigenvalues of a chain of integrators are then
    zeros, and not the cube root of rounding.
    """
    return [_block(A, index, precision) for index in _strong_components(A)]


def _strong_components(A: np.ndarray) -> list[np.ndarray]:
    count, labels = scipy.sparse.csgraph.connected_components(A != 0, connection="strong")
    before: dict[int, set[int]] = {label: set() for label in range(count)}
    for row, column in zip(labels[np.nonzero(A)[0]], labels[np.nonzero(A)[1]], strict=True):
        if row != column:
            before[column].add(row)
    return [np.flatnonzero(labels == label) for label in TopologicalSorter(before).static_order()]


def weak_components(A: np.ndarray) -> list[np.ndarray]:
    """States that share no coupling at all, in either direction, fall into different sets."""
    count, labels = scipy.sparse.csgraph.connected_components(A != 0, directed=False)
    return [np.flatnonzero(labels == label) for label in range(count)]


def _block(A: np.ndarray, index: np.ndarray, precision: float) -> Block:
    matrix, (scale, _) = scipy.linalg.matrix_balance(
        A[np.ix_(index, index)], permute=False, separate=True
    )
    if np.iscomplexobj(matrix):
        T, Q = scipy.linalg.schur(matrix, output="complex")
    else:
        R, Z = scipy.linalg.schur(matrix)
        T, Q = scipy.linalg.rsf2csf(R, Z)
        # Conjugate pairs exactly, from the standardized 2 x 2 blocks [[a, b], [c, a]], b c < 0.
        for k in np.flatnonzero(np.diag(R, -1)):
            omega = np.sqrt(abs(R[k, k + 1])) * np.sqrt(abs(R[k + 1, k]))
            T[k, k], T[k + 1, k + 1] = R[k, k] + 1j * omega, R[k, k] - 1j * omega
    return Block(index, matrix, T, Q, scale, precision)


def assemble(A: np.ndarray, blocks: list[Block]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return T = Q^H B Q, Q and B: the whole matrix, balanced, its blocks in Schur form."""
    index = np.concatenate([block.index for block in blocks])
    scale = np.concatenate([block.scale for block in blocks])
    B = A[np.ix_(index, index)] * (scale / scale[:, None])
    Q = scipy.linalg.block_diag(*[block.Q for block in blocks])
    T = np.triu(Q.conj().T @ B @ Q)
    end = 0
    for block in blocks:
        start, end = end, end + len(block.index)
        T[start:end, start:end] = block.T
    return T, Q, B


def with_comparable_couplings(A: np.ndarray, blocks: list[Block], discrete: bool) -> np.ndarray:
    """Choose units in which couplings between blocks are as large as the blocks.

    Balancing has no say on one-way couplings: it could make them as small as it liked. The
    units minimize the sum of squares of log(coupling / largest block), or of log(coupling) for
    a map, whose measure is the unit circle.
    """
    end = np.cumsum([len(block.index) for block in blocks])
    owner = np.searchsorted(end, np.arange(end[-1]), side="right")
    _, _, B = assemble(A, blocks)
    rows, columns = np.nonzero(B * (owner[:, None] != owner))
    if len(rows) == 0:
        return B
    logs = np.log(np.abs(B[rows, columns]))
    rate = 1.0 if discrete else max(np.linalg.norm(block.matrix, 2) for block in blocks)
    target = np.log(rate) if rate > 0 else logs.mean()
    equations = np.zeros((len(rows), len(blocks)))
    equations[np.arange(len(rows)), owner[rows]] += 1
    equations[np.arange(len(rows)), owner[columns]] -= 1
    normal = equations.T @ equations, equations.T @ (target - logs)
    unit = np.linalg.lstsq(*normal, rcond=None)[0]
    span = np.ptp(unit)
    if span > np.log(_UNIT_SPAN):
        unit *= np.log(_UNIT_SPAN) / span
    unit = np.exp2(np.round(unit / np.log(2)))[owner]
    return B * (unit[:, None] / unit)


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


def margin(eigenvalues: Any, discrete: bool) -> Any:
    """Distance of eigenvalues from the boundary, positive inside."""
    return 1 - np.abs(eigenvalues) if discrete else -np.real(eigenvalues)


def project(eigenvalues: Any, discrete: bool) -> Any:
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
        _cluster(number, block, members, discrete)
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


def _cluster(number: int, block: Block, members: np.ndarray, discrete: bool) -> Cluster:
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
