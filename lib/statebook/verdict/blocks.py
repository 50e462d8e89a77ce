"""A matrix in pieces that do not feed back into one another, balanced, in Schur form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

EPS = float(np.finfo(float).eps)
# Differences in the units of states are undone up to this ratio; more is no choice of units.
_UNIT_SPAN = 1e24


def rounding(norm: float, n: int, precision: float = EPS) -> float:
    """Norm of the perturbations to which n x n arithmetic is blind: 8 n eps norm."""
    return 8 * n * precision * norm


def inverse(V: np.ndarray) -> np.ndarray:
    """Inverse of V; rows that depend on one another come out huge, and are not refused."""
    try:
        X = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        X = np.full(V.shape, np.inf)
    if not np.isfinite(X).all():
        U, s, Vh = np.linalg.svd(V)
        X = (Vh.conj().T / np.maximum(s, EPS**4)) @ U.conj().T
    return X


def spectral_norm(A: np.ndarray) -> float:
    """Largest singular value."""
    return float(np.linalg.svd(A, compute_uv=False)[0]) if A.size else 0.0


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

    @cached_property
    def norm(self) -> float:
        """The 2-norm of the balanced block."""
        return spectral_norm(self.matrix)

    @cached_property
    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvectors of T, and the inverse of their matrix."""
        if len(self.T) == 1:
            return np.eye(1), np.eye(1)
        vectors = np.linalg.eig(self.T)[1]
        return vectors, inverse(vectors)

    @cached_property
    def size(self) -> np.ndarray:
        """Bound of the terms that make up each entry, where it is computed from T and Q."""
        Q = np.abs(self.Q)
        return Q @ np.abs(self.T) @ Q.T

    def tolerance(self, discrete: bool) -> float:
        """Rounding of the block; a map has the size of the unit circle at least."""
        norm = max(self.norm, 1.0) if discrete else self.norm
        return rounding(norm, len(self.index), self.precision)


def decompose(A: np.ndarray, precision: float = EPS) -> list[Block]:
    """Split a matrix into its irreducible diagonal blocks, block upper triangular in order.

    Zeros that are exact decouple exactly: the eigenvalues of a chain of integrators are then
    zeros, and not the cube root of rounding.
    """
    reached = _reachability(A != 0)
    if reached.all():
        return [_block(A, np.arange(len(A)), precision)]
    # A state that reaches another one reaches all that the other reaches, and more.
    first = np.argmax(reached & reached.T, axis=1)
    heads = np.unique(first)
    order = heads[np.argsort(-reached.sum(axis=1)[heads], kind="stable")]
    return [_block(A, np.flatnonzero(first == head), precision) for head in order]


def weak_components(A: np.ndarray, blocks: list[Block]) -> list[list[Block]]:
    """Blocks that share no coupling at all, in either direction, fall into different sets."""
    first = np.argmax(_reachability((A != 0) | (A.T != 0)), axis=1)
    return [[b for b in blocks if first[b.index[0]] == head] for head in np.unique(first)]


def _reachability(edges: np.ndarray) -> np.ndarray:
    """Which states feed into which, in any number of steps, by repeated squaring."""
    reached = edges | np.eye(len(edges), dtype=bool)
    while not reached.all():
        steps = reached.astype(np.float32)
        further = steps @ steps > 0
        if np.array_equal(further, reached):
            break
        reached = further
    return reached


def balanced(A: np.ndarray, permute: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A in units in which its rows are as large as its columns, and what LAPACK did."""
    gebal = scipy.linalg.lapack.zgebal if np.iscomplexobj(A) else scipy.linalg.lapack.dgebal
    matrix, _, _, scale, _ = gebal(A, scale=1, permute=permute)
    return matrix, scale


def _block(A: np.ndarray, index: np.ndarray, precision: float) -> Block:
    n = len(index)
    A = A[np.ix_(index, index)]
    if n == 1:
        return Block(index, A, A.astype(complex), np.eye(1, dtype=complex), np.ones(1), precision)
    matrix, scale = balanced(A, permute=0)
    if np.iscomplexobj(matrix):
        T, Q = scipy.linalg.schur(matrix, output="complex")
    else:
        R, *_, Z, _, _ = scipy.linalg.lapack.dgees(_no_order, matrix, lwork=40 * n)
        T, Q = R.astype(complex), Z.astype(complex)
        # Conjugate pairs exactly, from the standardized 2 x 2 blocks [[a, b], [c, a]], b c < 0.
        for k in np.flatnonzero(R.diagonal(-1)).tolist()[::-1]:
            a, b, c = R[k, k], R[k, k + 1], R[k + 1, k]
            omega = abs(b) ** 0.5 * abs(c) ** 0.5
            G = np.array([[-1j * omega / c, 1], [-1, 1j * omega / c]]) / np.hypot(omega / c, 1)
            pair = slice(k, k + 2)
            T[pair, k:] = G @ T[pair, k:]
            T[: k + 2, pair] = T[: k + 2, pair] @ G.conj().T
            Q[:, pair] = Q[:, pair] @ G.conj().T
            T[k, k], T[k + 1, k + 1], T[k + 1, k] = a + 1j * omega, a - 1j * omega, 0.0
    return Block(index, matrix, T, Q, scale, precision)


def _no_order(*eigenvalue: float) -> bool:
    return False


def assemble(A: np.ndarray, blocks: list[Block]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return T = Q^H B Q, Q and B: the whole matrix, balanced, its blocks in Schur form."""
    if len(blocks) == 1:
        return blocks[0].T, blocks[0].Q, blocks[0].matrix
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
    rate = 1.0 if discrete else max(block.norm for block in blocks)
    target = np.log(rate) if rate > 0 else logs.mean()
    normal, right = np.zeros((len(blocks), len(blocks))), np.zeros(len(blocks))
    for here, there, sign in ((owner[rows], owner[columns], 1), (owner[columns], owner[rows], -1)):
        np.add.at(normal, (here, here), 1)
        np.add.at(normal, (here, there), -1)
        np.add.at(right, here, sign * (target - logs))
    unit = np.linalg.lstsq(normal, right, rcond=None)[0]
    span = np.ptp(unit)
    if span > np.log(_UNIT_SPAN):
        unit *= np.log(_UNIT_SPAN) / span
    unit = np.exp2(np.round(unit / np.log(2)))[owner]
    return B * (unit[:, None] / unit)
